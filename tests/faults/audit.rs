//! Audit: the checks at the end of every fault test. Nothing is lost silently, torn or leaked.
//!
//! The oracle is the emulator's log: every frame that the sensor made, and its fate. The database must have each intact
//! frame as a row, inside a recorded gap, or counted as discarded. The number of missing samples of a gap must agree
//! with the sensor's clock and the log.

use crate::world::{Process, World, vn100d};
use rusqlite::types::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

/// The maximum private memory of the daemon, including a job's work space. The program's own pages are not counted: the
/// kernel can reclaim them, and a test build has more of them than a release.
const ANONYMOUS_MAX_BYTES: u64 = 48 << 20;

/// The most descriptors of the database: three of the writer, two of each reader that the pool keeps (16), and two of a
/// reader that is being opened or closed. How many readers the pool keeps depends on how many requests met.
const DATABASE_FDS_MAX: usize = 3 + 2 * 16 + 2;

/// A frame of the emulated sensor, from its log.
#[derive(Debug, Clone, PartialEq)]
pub struct Made {
    pub number: u64,
    pub tick: u64,
    pub device_time_ns: u64,
    /// The time at which the terminal had it, on the clock of `sample.host_mono_ns`.
    pub host_mono_ns: u64,
    pub fate: String,
}

impl Made {
    /// Returns whether a listener received it complete.
    pub fn is_intact(&self) -> bool {
        matches!(self.fate.as_str(), "sent" | "held" | "duplicated" | "reordered")
    }
}

/// A fault in the emulator's log, or its end.
#[derive(Debug, Clone, PartialEq)]
pub struct Happened {
    pub host_mono_ns: u64,
    pub what: String,
}

/// The emulator's log.
#[derive(Debug, Clone, Default)]
pub struct SensorLog {
    pub frames: Vec<Made>,
    pub events: Vec<Happened>,
}

impl SensorLog {
    pub fn read(path: &Path) -> Self {
        let text = std::fs::read_to_string(path).unwrap();
        let mut log = Self::default();
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            let words: Vec<&str> = line.split(' ').collect();
            let number = |index: usize| words[index].parse::<u64>().unwrap_or_else(|_| panic!("{line}"));
            if words[0] == "!" {
                log.events.push(Happened { host_mono_ns: number(2), what: words[3..].join(" ") });
            } else {
                log.frames.push(Made {
                    number: number(0),
                    tick: number(1),
                    device_time_ns: number(2),
                    host_mono_ns: number(3),
                    fate: words[5].to_owned(),
                });
            }
        }
        // In the order in which the sensor made them: a frame that is omitted is settled before one that still waits.
        log.frames.sort_by_key(|frame| frame.number);
        log
    }

    /// Returns the time of the last event of this kind.
    pub fn last(&self, what: &str) -> u64 {
        self.events
            .iter()
            .rev()
            .find(|event| event.what.starts_with(what))
            .unwrap_or_else(|| panic!("no {what}"))
            .host_mono_ns
    }

    pub fn count(&self, fate: &str) -> u64 {
        self.frames.iter().filter(|frame| frame.fate == fate).count() as u64
    }
}

/// The resources that a process holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Held {
    pub anonymous_bytes: u64,
    /// Descriptors, without those of the database.
    pub fds: usize,
    /// Descriptors of the database, its log and its index.
    pub database_fds: usize,
    pub threads: usize,
    /// Processor time used so far.
    pub cpu: Duration,
}

impl Held {
    pub fn of(pid: u32) -> Self {
        let threads = std::fs::read_dir(format!("/proc/{pid}/task")).map_or(0, Iterator::count);
        let (of_database, others): (Vec<_>, Vec<_>) = descriptors(pid)
            .into_iter()
            .partition(|link| [".db", ".db-wal", ".db-shm"].iter().any(|end| link.ends_with(end)));
        let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
        let anonymous = status.lines().find_map(|line| line.strip_prefix("RssAnon:"));
        let kilobytes = anonymous.and_then(|held| held.trim().trim_end_matches(" kB").parse::<u64>().ok()).unwrap_or(0);
        // Fields 14 and 15, counted behind the name in parentheses, in ticks of 10 ms.
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
        let ticks: u64 = fields.iter().skip(11).take(2).filter_map(|field| field.parse::<u64>().ok()).sum();
        Self {
            anonymous_bytes: kilobytes << 10,
            fds: others.len(),
            database_fds: of_database.len(),
            threads,
            cpu: Duration::from_millis(ticks * 10),
        }
    }
}

/// A gap in the database.
#[derive(Debug, Clone, PartialEq)]
pub struct Gap {
    pub before_seq: i64,
    pub from_utc_ns: i64,
    pub to_utc_ns: i64,
    /// The device times at its ends, if one epoch spans it.
    pub device_ns: Option<(i64, i64)>,
    pub missing: i64,
    pub exact: bool,
    pub cause: String,
}

impl Gap {
    pub fn host_s(&self) -> f64 {
        (self.to_utc_ns - self.from_utc_ns) as f64 / 1e9
    }
}

/// The results of the audit, for the figures of a test.
#[derive(Debug)]
pub struct Audited {
    pub samples: u64,
    pub missing: u64,
    pub gaps: Vec<Gap>,
    pub segments: u64,
    pub rejected: BTreeMap<String, u64>,
    pub log: SensorLog,
    /// Host times of the rows, in order.
    pub row_mono_ns: Vec<u64>,
    pub held: Held,
}

impl Audited {
    /// Returns the time from an event in the sensor's log to the first row after it, s.
    pub fn resumed_after_s(&self, event: &str) -> f64 {
        let at = self.log.last(event);
        let first = self.row_mono_ns.iter().find(|row| **row > at).expect("a row after the event");
        (first - at) as f64 / 1e9
    }

    pub fn causes(&self) -> Vec<&str> {
        self.gaps.iter().map(|gap| gap.cause.as_str()).collect()
    }
}

/// Returns how many lines of a log contain all of these words.
pub fn lines_with(log: &str, words: &[&str]) -> usize {
    log.lines().filter(|line| words.iter().all(|word| line.contains(word))).count()
}

fn integer(value: &Value) -> i64 {
    match value {
        Value::Integer(integer) => *integer,
        other => panic!("{other:?} is no integer"),
    }
}

fn optional(value: &Value) -> Option<i64> {
    if *value == Value::Null { None } else { Some(integer(value)) }
}

fn text(value: &Value) -> String {
    match value {
        Value::Text(text) => text.clone(),
        other => panic!("{other:?} is no text"),
    }
}

impl World {
    /// Returns the number of samples that the status reports as committed.
    pub fn committed(&self) -> u64 {
        self.get("/v1/status")["capture"]["committed"].as_u64().unwrap_or(0)
    }

    /// Waits until the sensor streams and the capture holds `more` samples than now.
    pub fn until_more_samples(&self, more: u64, daemon: &Process) {
        let samples = || self.try_get("/v1/status").and_then(|status| status["capture"]["samples"].as_u64());
        let before = samples().unwrap_or(0);
        let enough = || samples().filter(|samples| *samples >= before + more);
        self.until("samples come", Duration::from_secs(30), enough, daemon);
    }

    /// Ends the capture and the daemon, and checks everything that can be checked.
    pub fn settle_and_audit(&self, daemon: &mut Process, sensor_log: &Path, baseline: Option<Held>) -> Audited {
        let acked = self.committed();
        let held = settled(daemon, baseline);
        if self.get("/v1/captures/latest")["state"] == "capturing" {
            let (code, body) = self.request("POST", "/v1/captures/latest/stop", "").unwrap();
            assert_eq!(code, 200, "{body}");
        }
        assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
        assert!(!daemon.log().contains("panicked"), "{}", daemon.log());
        let audited = self.audit(sensor_log, held);
        assert!(audited.samples >= acked, "{acked} samples were said to be safe, {} are there", audited.samples);
        audited
    }

    /// Checks the database for consistency and against the sensor's log, when no process writes it.
    pub fn audit(&self, sensor_log: &Path, held: Held) -> Audited {
        assert_eq!(self.query("PRAGMA integrity_check"), [[Value::Text("ok".into())]]);
        assert!(self.query("PRAGMA foreign_key_check").is_empty());
        let check = vn100d(&["check", self.database().to_str().unwrap()]);
        assert_eq!(
            check.status.code(),
            Some(0),
            "{}{}",
            String::from_utf8_lossy(&check.stdout),
            String::from_utf8_lossy(&check.stderr)
        );
        let log = SensorLog::read(sensor_log);
        let capture = integer(&self.query("SELECT max(id) FROM capture WHERE lifecycle = 'live'")[0][0]);
        let of = |sql: &str| self.query(&sql.replace("CAPTURE", &capture.to_string()));
        let counts = &of("SELECT samples, missing, gaps, segments FROM capture WHERE id = CAPTURE")[0];
        let rejected = of("SELECT cause, count FROM rejected WHERE capture_id = CAPTURE")
            .iter()
            .map(|row| (text(&row[0]), integer(&row[1]) as u64))
            .collect::<BTreeMap<_, _>>();
        let gaps: Vec<Gap> = of("SELECT before_seq, from_utc_ns, to_utc_ns, from_device_ns, to_device_ns, missing, \
             missing_exact, cause FROM gap WHERE capture_id = CAPTURE ORDER BY before_seq, gap_id")
        .iter()
        .map(|row| Gap {
            before_seq: integer(&row[0]),
            from_utc_ns: integer(&row[1]),
            to_utc_ns: integer(&row[2]),
            device_ns: optional(&row[3]).zip(optional(&row[4])),
            missing: integer(&row[5]),
            exact: integer(&row[6]) == 1,
            cause: text(&row[7]),
        })
        .collect();
        let rows: Vec<Row> =
            of("SELECT sample.seq, segment.segment_id, epoch, device_time_ns, host_mono_ns, rate_hz, timebase \
             FROM sample JOIN segment USING (capture_id, segment_id) WHERE capture_id = CAPTURE ORDER BY seq")
            .iter()
            .map(|row| Row {
                seq: integer(&row[0]),
                epoch: integer(&row[2]),
                segment: integer(&row[1]),
                device_ns: optional(&row[3]).filter(|_| text(&row[6]) == "device"),
                host_mono_ns: integer(&row[4]) as u64,
                period_ns: match row[5] {
                    Value::Real(rate_hz) => 1e9 / rate_hz,
                    ref other => panic!("{other:?}"),
                },
            })
            .collect();

        // The counters and the rows agree, and the rows have no holes.
        let segments = integer(&of("SELECT count(*) FROM segment WHERE capture_id = CAPTURE")[0][0]);
        let missing: i64 = gaps.iter().map(|gap| gap.missing).sum();
        let expected = [rows.len() as i64, missing, gaps.len() as i64, segments].map(Value::Integer);
        assert_eq!(counts[..], expected[..], "samples, missing, gaps, segments");
        assert!(rows.iter().zip(0..).all(|(row, seq)| row.seq == seq), "seq runs from 0 without holes");

        check_epochs(&rows, &gaps);
        check_against_log(&rows, &gaps, &rejected, &log);
        let row_mono_ns = rows.iter().map(|row| row.host_mono_ns).collect();
        let (samples, missing) = (rows.len() as u64, missing as u64);
        Audited { samples, missing, gaps, segments: segments as u64, rejected, log, row_mono_ns, held }
    }
}

/// Returns the daemon's memory, descriptors and threads, once they are back at the baseline.
fn settled(daemon: &Process, baseline: Option<Held>) -> Held {
    let deadline = Instant::now() + Duration::from_secs(20);
    loop {
        let held = Held::of(daemon.id());
        assert!(held.anonymous_bytes < ANONYMOUS_MAX_BYTES, "{} MiB", held.anonymous_bytes >> 20);
        let (fds, threads) = baseline.map_or((64, 64), |baseline| (baseline.fds, baseline.threads));
        if held.fds <= fds && held.database_fds <= DATABASE_FDS_MAX && held.threads <= threads {
            return held;
        }
        assert!(
            Instant::now() < deadline,
            "{held:?} ({}) instead of at most {fds} descriptors, {DATABASE_FDS_MAX} of the database and {threads} threads",
            descriptors(daemon.id()).join(", ")
        );
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Lists the descriptors of a process.
fn descriptors(pid: u32) -> Vec<String> {
    let entries = std::fs::read_dir(format!("/proc/{pid}/fd")).into_iter().flatten().flatten();
    let links = entries.filter_map(|entry| std::fs::read_link(entry.path()).ok());
    links.map(|link| link.display().to_string()).collect()
}

struct Row {
    seq: i64,
    segment: i64,
    epoch: i64,
    device_ns: Option<i64>,
    host_mono_ns: u64,
    period_ns: f64,
}

/// Checks that `expected = received + Σ gap.missing`, with `expected` from the first and last tick of each stretch of
/// one clock and rate.
fn check_epochs(rows: &[Row], gaps: &[Gap]) {
    for stretch in rows.chunk_by(|a, b| a.epoch == b.epoch && a.period_ns == b.period_ns) {
        let (first, last) = (&stretch[0], &stretch[stretch.len() - 1]);
        let (Some(from), Some(to)) = (first.device_ns, last.device_ns) else { continue };
        assert!(
            stretch.windows(2).all(|pair| pair[0].device_ns < pair[1].device_ns),
            "time runs forward within an epoch"
        );
        let expected = ((to - from) as f64 / first.period_ns).round() as i64 + 1;
        let within = |gap: &&Gap| gap.before_seq > first.seq && gap.before_seq <= last.seq;
        let inexact = gaps.iter().filter(within).filter(|gap| !gap.exact).count() as i64;
        let missing: i64 = gaps.iter().filter(within).map(|gap| gap.missing).sum();
        let found = stretch.len() as i64 + missing;
        assert!(
            (expected - found).abs() <= inexact,
            "epoch {}: {expected} expected, {found} accounted for",
            first.epoch
        );
    }
    // A step of more than a period is a gap, and a gap is between two segments.
    for pair in rows.windows(2).filter(|pair| pair[0].segment == pair[1].segment) {
        if let (Some(from), Some(to)) = (pair[0].device_ns, pair[1].device_ns) {
            let periods = (to - from) as f64 / pair[0].period_ns;
            assert!((0.5..1.5).contains(&periods), "{periods} periods before sample {} without a gap", pair[1].seq);
        }
    }
}

/// Checks that every row is a frame that the sensor sent, and that every intact frame is a row, inside a gap, or
/// counted as discarded. The missing samples of a gap within one epoch must agree with the sensor's clock, and must not
/// be fewer than those lost there in the log.
fn check_against_log(rows: &[Row], gaps: &[Gap], rejected: &BTreeMap<String, u64>, log: &SensorLog) {
    if rows.iter().any(|row| row.device_ns.is_none()) {
        // Without the sensor's time, neighbouring rows are indistinguishable: there must be no more rows than frames
        // sent.
        let intact = log.frames.iter().filter(|frame| frame.is_intact()).count();
        assert!(rows.len() <= intact, "{} rows of {intact} frames", rows.len());
        return;
    }
    let gap_before: BTreeMap<i64, &Gap> = gaps.iter().map(|gap| (gap.before_seq, gap)).collect();
    let duplicates = rejected.get("duplicate").copied().unwrap_or(0);
    let mut unaccounted = 0;
    let mut next = 0;
    let mut previous: Option<usize> = None;
    for (number, row) in rows.iter().enumerate() {
        let device_ns = row.device_ns.unwrap() as u64;
        // The frame comes after the last one, and was not sent after its arrival nor long before it.
        let fits = |frame: &Made| {
            frame.is_intact()
                && frame.device_time_ns == device_ns
                && frame.host_mono_ns < row.host_mono_ns + 1_000_000_000
                && row.host_mono_ns < frame.host_mono_ns + 120_000_000_000
        };
        let found = log.frames[next..].iter().position(fits);
        let index = next
            + found.unwrap_or_else(|| {
                let alike: Vec<&Made> = log.frames.iter().filter(|frame| frame.device_time_ns == device_ns).collect();
                let host_ns = row.host_mono_ns;
                panic!(
                    "sample {} at {device_ns} ns, heard at {host_ns}, was never sent; of that time are {alike:?}",
                    row.seq
                )
            });
        if let Some(previous) = previous {
            let between = &log.frames[previous + 1..index];
            match gap_before.get(&row.seq) {
                None => unaccounted += between.len() as u64,
                Some(Gap { device_ns: Some((from, to)), missing, .. }) => {
                    let instants = ((to - from) as f64 / row.period_ns).round() as i64 - 1;
                    assert_eq!(*missing, instants, "between {from} and {to} ns");
                    // Frames of the present output; those of another rate or format are not samples of it.
                    let lost = between.iter().filter(|frame| {
                        let steps = (frame.device_time_ns as f64 - *from as f64) / row.period_ns;
                        (steps - steps.round()).abs() < 1e-3
                    });
                    let lost = lost.count() as i64;
                    assert!(
                        lost <= *missing,
                        "{lost} frames were lost between {from} and {to} ns, {missing} are missing"
                    );
                }
                // Across two epochs only the host's monotonic clock counts, whatever happened to civil time and however
                // often the daemon was killed meanwhile.
                Some(gap) => {
                    let before = &rows[number - 1];
                    let away_ns = row.host_mono_ns.saturating_sub(before.host_mono_ns) as f64;
                    let missing_ns = gap.missing as f64 * row.period_ns;
                    assert!(
                        before.period_ns != row.period_ns || (missing_ns - away_ns).abs() < 0.5e9,
                        "{gap:?}: {:.3} s by the host's clock",
                        away_ns / 1e9
                    );
                }
            }
        }
        previous = Some(index);
        next = index + 1;
    }
    assert!(
        unaccounted <= duplicates,
        "{unaccounted} frames are neither a row nor in a gap, {duplicates} were discarded"
    );
}
