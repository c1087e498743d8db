//! Recovery: copies everything that is intact in a damaged database into a new one. The damaged database is only read.
//!
//! The pages are read without SQLite, so that a damaged page costs only its own content. A batch is taken if all its
//! rows are present and match its checksum. Samples of no batch (written by older versions, or the batch's own row is
//! lost) are taken as they are and counted separately. Lost samples become a gap (cause `source`), so that the
//! accounting of the new database is right. Samples are renumbered, because `seq` has no holes. Jobs and results are
//! not copied: they can be computed again.

mod cells;
mod image;
mod salvage;

use super::backup::NewFile;
use super::batch::{BatchRow, Run, StoredRow};
use super::check::{Finding, check};
use super::insert::insert;
use super::names::{check_note, printable};
use super::paths::wal_path;
use super::{SOFTWARE, StoreError, lock, schema};
use crate::clock::{Clock, SystemClock};
use cells::{get, named};
use image::Image;
use imu_core::sample::{Channel, ChannelSet, EventKind, EventRecord, Gap, GapCause, Record, Segment, Timebase};
use imu_core::units::NANOS_PER_SECOND;
use rusqlite::types::Value;
use rusqlite::{Connection, params};
use salvage::Salvage;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The column of table `capture` that holds the note; databases of older versions do not have it.
const NOTE: usize = 26;
/// Records written in one transaction.
const STEP: usize = 4000;
/// Samples of no batch that are examined together.
const PIECE: i64 = 4096;
/// The number of contested places of a batch for which both versions are tried.
const CONTESTED: usize = 8;
/// The maximum number of listed lost batches of each capture.
const LISTED: usize = 1000;

/// The outcome for one capture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Default)]
pub struct RecoveredCapture {
    /// Its id, before and after.
    pub id: i64,
    /// Its name.
    pub name: String,
    /// Number of samples in the new database.
    pub samples: u64,
    /// Of these, samples without a checksum.
    pub without_checksum: u64,
    /// Number of samples lost.
    pub samples_lost: u64,
    /// Number of batches taken.
    pub batches: u64,
    /// Number of batches lost.
    pub batches_lost: u64,
    /// First and last `seq`, in the damaged database, of batches that are lost; the first thousand.
    pub lost: Vec<(i64, i64)>,
    /// Number of gaps taken, without those that stand for lost samples.
    pub gaps: u64,
    /// Number of gaps lost, as far as the capture's own count shows.
    pub gaps_lost: u64,
    /// Number of events taken.
    pub events: u64,
    /// Number of segments lost; their samples are in segments that were made up.
    pub segments_lost: u64,
}

/// The outcome of a recovery.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RecoverReport {
    /// The damaged database.
    pub database: PathBuf,
    /// The new one.
    pub out: PathBuf,
    /// The captures.
    pub captures: Vec<RecoveredCapture>,
    /// Pages that should hold rows and cannot be read.
    pub damaged_pages: u64,
    /// Rows that cannot be read on pages that can.
    pub damaged_rows: u64,
    /// Frames of the log with a wrong checksum.
    pub damaged_frames: u64,
    /// The findings of a check of the damaged database, also if no row was lost.
    pub findings: Vec<Finding>,
}

impl RecoverReport {
    /// Returns whether anything is known to be lost or damaged.
    pub fn has_damage(&self) -> bool {
        !self.findings.is_empty()
            || self.damaged_pages + self.damaged_rows + self.damaged_frames > 0
            || self.captures.iter().any(|capture| {
                capture.samples_lost + capture.batches_lost + capture.gaps_lost + capture.segments_lost > 0
            })
    }
}

/// Salvages the database at `path` into a new one at `out`.
///
/// # Errors
/// [`StoreError::NoDatabase`], [`StoreError::Locked`] if a daemon writes it, [`StoreError::Exists`], or the reason why
/// the new database cannot be written.
pub fn recover(path: &Path, out: &Path, replace: bool) -> Result<RecoverReport, StoreError> {
    if !path.is_file() {
        return Err(StoreError::NoDatabase(path.to_owned()));
    }
    lock::refuse_writer(path)?;
    let image =
        Image::open(path, &wal_path(path)).map_err(|source| StoreError::Read { path: path.to_owned(), source })?;
    let mut salvage = Salvage::of(image);
    let new = NewFile::beside(out, replace, path)?;
    let mut connection = schema::open_and_migrate(new.path(), None)?;
    // The file is synced as a whole at the end.
    connection.pragma_update(None, "synchronous", "OFF")?;
    let mut report = RecoverReport {
        database: path.to_owned(),
        out: out.to_owned(),
        captures: Vec::new(),
        damaged_pages: salvage.damaged_pages,
        damaged_rows: salvage.damaged_rows,
        damaged_frames: salvage.image.damaged_frames,
        // A schema version other than this program's is no damage.
        findings: check(path).map_or_else(|_| Vec::new(), |report| report.findings),
    };
    if salvage.image.pages == 0 {
        let message = "the file has less than a page, and its log has none: nothing of it can be read".to_owned();
        report.findings.push(Finding { check: "unreadable", capture: None, message });
    }
    let mut ids: std::collections::BTreeSet<i64> = salvage.captures.keys().copied().collect();
    ids.extend(salvage.places.keys());
    for id in ids {
        let row = salvage.captures.get(&id);
        if row.is_some_and(|row| get::<String>(row, 4).as_deref() != Some("live")) {
            continue;
        }
        report.captures.push(Rebuilt::new(&mut connection, &mut salvage, id)?.run()?);
    }
    connection.close().map_err(|(_, error)| error)?;
    schema::make_independent(new.path())?;
    new.finish()?;
    Ok(report)
}

/// One capture that is being copied into the new database.
struct Rebuilt<'a> {
    connection: &'a mut Connection,
    salvage: &'a mut Salvage,
    report: RecoveredCapture,
    pending: Vec<(i64, Record)>,
    row: Vec<Value>,
    /// End of the capture's sample numbers.
    end: i64,
    gaps: std::vec::IntoIter<Gap>,
    next_gap: Option<Gap>,
    /// The last sample taken, and its old segment.
    last: Option<StoredRow>,
    segment: Option<(i64, Segment)>,
    next_seq: u64,
    segments: u32,
    /// By how much the new `seq` is less than the old one, from which old `seq` on.
    shifts: Vec<(i64, i64)>,
}

impl<'a> Rebuilt<'a> {
    fn new(connection: &'a mut Connection, salvage: &'a mut Salvage, id: i64) -> Result<Self, StoreError> {
        let row = salvage.captures.get(&id).cloned().unwrap_or_default();
        let (integer, text) = (|column| get::<i64>(&row, column), |column| get::<String>(&row, column));
        let name = text(1).unwrap_or_else(|| format!("recovered-{id}"));
        let sql = "INSERT INTO capture (id, name, source, state, created_utc_ns, start_at_utc_ns, planned_duration_ns, \
                   started_utc_ns, rate_assumed, sensor, configuration, software, fingerprint, note) \
                   VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14)";
        let values = params![
            id,
            name,
            text(2).unwrap_or_else(|| "unknown".to_owned()),
            text(3).unwrap_or_else(|| "stopped".to_owned()),
            integer(5).unwrap_or_else(|| SystemClock.utc_ns()),
            integer(6),
            integer(7).filter(|ns| *ns > 0),
            integer(8),
            integer(11) == Some(1),
            text(18).filter(|json| is_json(json)),
            text(19).filter(|json| is_json(json)),
            text(20).unwrap_or_else(|| SOFTWARE.to_owned()),
            text(21),
            text(NOTE).and_then(|note| check_note(&printable(&note)).ok().flatten()),
        ];
        connection.execute(sql, values)?;
        let mut gaps: Vec<Gap> = salvage.gaps.get(&id).into_iter().flatten().filter_map(|row| gap_of(row)).collect();
        gaps.sort_by_key(|gap| (gap.before_seq, gap.from_utc_ns));
        let end = integer(13).unwrap_or_else(|| salvage.end_of(id));
        let expected_gaps = integer(15).unwrap_or(0) as u64;
        let report = RecoveredCapture {
            id,
            name,
            gaps: gaps.len() as u64,
            gaps_lost: expected_gaps.saturating_sub(gaps.len() as u64),
            ..RecoveredCapture::default()
        };
        let mut gaps = gaps.into_iter();
        let next_gap = gaps.next();
        Ok(Self {
            connection,
            salvage,
            report,
            pending: Vec::with_capacity(STEP + 8),
            row,
            end,
            gaps,
            next_gap,
            last: None,
            segment: None,
            next_seq: 0,
            segments: 0,
            shifts: Vec::new(),
        })
    }

    fn run(mut self) -> Result<RecoveredCapture, StoreError> {
        let id = self.report.id;
        self.channels()?;
        let batches: Vec<BatchRow> =
            self.salvage.batches.get(&id).map(|batches| batches.values().copied().collect()).unwrap_or_default();
        let mut next = 0;
        for batch in batches {
            // A row that contradicts the one before, or the capture, is itself damaged.
            if batch.first_seq < next || batch.first_seq + batch.count > self.end {
                continue;
            }
            self.uncovered(next, batch.first_seq)?;
            self.batch(&batch)?;
            next = batch.first_seq + batch.count;
        }
        self.uncovered(next, self.end)?;
        self.finish()
    }

    fn batch(&mut self, batch: &BatchRow) -> Result<(), StoreError> {
        let end = batch.first_seq + batch.count;
        let rows = self.salvage.samples(batch.capture_id, batch.first_seq, end);
        if let Some(rows) = intact(batch, &rows) {
            self.report.batches += 1;
            for row in rows {
                self.sample(row)?;
            }
        } else {
            self.report.batches_lost += 1;
            self.report.samples_lost += batch.count as u64;
            if self.report.lost.len() < LISTED {
                self.report.lost.push((batch.first_seq, end - 1));
            }
        }
        Ok(())
    }

    /// Copies samples that no batch covers.
    fn uncovered(&mut self, from: i64, to: i64) -> Result<(), StoreError> {
        let mut at = from;
        while at < to {
            let end = (at + PIECE).min(to);
            let rows = self.salvage.samples(self.report.id, at, end);
            self.report.samples_lost += ((end - at) as u64).saturating_sub(rows.len() as u64);
            self.report.without_checksum += rows.len() as u64;
            for row in rows.into_values().filter_map(|versions| versions.first().copied()) {
                self.sample(row)?;
            }
            at = end;
        }
        Ok(())
    }

    fn sample(&mut self, row: StoredRow) -> Result<(), StoreError> {
        let mut gaps = Vec::new();
        while let Some(gap) = self.next_gap.take_if(|gap| gap.before_seq as i64 <= row.seq) {
            gaps.push(gap);
            self.next_gap = self.gaps.next();
        }
        let known: u64 = gaps.iter().map(|gap| gap.missing).sum();
        let same = self.segment.as_ref().filter(|(old, _)| *old == row.segment_id).map(|(_, segment)| segment.clone());
        let segment = same.clone().unwrap_or_else(|| self.segment_of(&row));
        let lost = self.lost_before(&row, &segment, known);
        let begins = same.is_none() || lost.is_some() || !gaps.is_empty();
        let leading = self.segments == 0;
        // The rate of the segment before determines the count of a gap; at the beginning there is no such segment yet.
        for gap in gaps.into_iter().chain(lost).filter(|_| !leading).collect::<Vec<_>>() {
            self.push(Record::Gap(Gap { before_seq: self.next_seq, ..gap }))?;
        }
        if begins {
            self.segments += 1;
            let segment = Segment {
                number: self.segments,
                first_seq: self.next_seq,
                first_device_time_ns: row.device_time_ns.map(|ns| ns as u64),
                first_utc_ns: row.host_utc_ns,
                ..segment
            };
            self.segment = Some((row.segment_id, segment.clone()));
            self.push(Record::Segment(segment))?;
            if leading && row.seq > 0 {
                let started = get(&self.row, 8).filter(|ns| *ns <= row.host_utc_ns).unwrap_or(row.host_utc_ns);
                self.push(Record::Gap(self.gap_here(started, row.host_utc_ns, row.seq as u64)))?;
            }
        }
        let shift = row.seq - self.next_seq as i64;
        if self.shifts.last().is_none_or(|(_, last)| *last != shift) {
            self.shifts.push((row.seq, shift));
        }
        let record = Record::Sample { seq: self.next_seq, segment: self.segments, sample: row.to_sample() };
        self.next_seq += 1;
        self.report.samples += 1;
        self.last = Some(row);
        self.push(record)
    }

    /// Returns the samples lost between the last sample and this one: counted by the sensor's clock if it spans the
    /// hole, else by the numbers.
    fn lost_before(&self, row: &StoredRow, segment: &Segment, known: u64) -> Option<Gap> {
        let last = self.last.as_ref()?;
        let (_, before) = self.segment.as_ref()?;
        let by_number = (row.seq - last.seq - 1).max(0) as u64;
        let same_clock = before.epoch == segment.epoch && before.rate_hz == segment.rate_hz;
        let span = last.device_time_ns.zip(row.device_time_ns).filter(|(from, to)| same_clock && from < to);
        let by_clock = span.map(|(from, to)| {
            let periods = (to - from) as f64 * segment.rate_hz / NANOS_PER_SECOND as f64;
            (periods.round() as u64).saturating_sub(1 + known)
        });
        // Within a segment no sample is missing, regardless of the clock's rounding.
        let contiguous = by_number == 0 && before.number == self.segments && self.segment.as_ref()?.0 == row.segment_id;
        let missing = by_clock.unwrap_or(by_number);
        (missing > 0 && !contiguous).then(|| Gap {
            device_ns: span.map(|(from, to)| (from as u64, to as u64)),
            ..self.gap_here(last.host_utc_ns, row.host_utc_ns, missing)
        })
    }

    /// Returns the gap of so many lost samples before the next one.
    fn gap_here(&self, from_utc_ns: i64, to_utc_ns: i64, missing: u64) -> Gap {
        let (before_seq, cause) = (self.next_seq, GapCause::Source);
        Gap { before_seq, from_utc_ns, to_utc_ns, device_ns: None, missing, missing_exact: true, cause }
    }

    /// Returns the segment that a sample's row names; a new one is made up if it is lost.
    fn segment_of(&mut self, row: &StoredRow) -> Segment {
        let id = self.report.id;
        if let Some(found) = self.salvage.segments.get(&id).and_then(|segments| segments.get(&row.segment_id)) {
            return Segment {
                number: 0,
                epoch: get(found, 2).unwrap_or(1).max(1),
                first_seq: 0,
                rate_hz: get(found, 5).unwrap_or(1.0),
                timebase: named(found, 6).unwrap_or(Timebase::Arrival),
                channels: names_of(found, 7),
                first_device_time_ns: None,
                first_utc_ns: 0,
                boot_id: None,
            };
        }
        self.report.segments_lost += 1;
        let like = self.segment.as_ref().map(|(_, segment)| segment.clone());
        let channels = Channel::ALL.into_iter().zip(row.values).filter(|(_, value)| value.is_some());
        Segment {
            number: 0,
            // It must not be joined to the segment before: nothing shows that the sensor's clock ran on.
            epoch: like.as_ref().map_or(1, |segment| segment.epoch + 1),
            first_seq: 0,
            rate_hz: like.map_or_else(|| self.rate_after(row), |segment| segment.rate_hz),
            timebase: if row.device_time_ns.is_some() { Timebase::Device } else { Timebase::Arrival },
            channels: channels.map(|(channel, _)| channel).collect(),
            first_device_time_ns: None,
            first_utc_ns: 0,
            boot_id: None,
        }
    }

    /// Returns the rate of the capture, or of the samples that follow, in Hz.
    fn rate_after(&mut self, row: &StoredRow) -> f64 {
        if let Some(rate_hz) = get(&self.row, 10).filter(|rate_hz| *rate_hz > 0.0) {
            return rate_hz;
        }
        let rows = self.salvage.samples(self.report.id, row.seq, row.seq + 100);
        let time = |row: &StoredRow| row.device_time_ns.unwrap_or(row.host_utc_ns);
        let times: Vec<i64> = rows.values().flatten().map(time).collect();
        let mut steps: Vec<i64> = times.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0).collect();
        steps.sort_unstable();
        steps.get(steps.len() / 2).map_or(1.0, |step| NANOS_PER_SECOND as f64 / *step as f64)
    }

    fn channels(&mut self) -> Result<(), StoreError> {
        for row in self.salvage.channels.iter().filter(|row| get(row, 0) == Some(self.report.id)) {
            let [name, unit, original_unit] = [1, 2, 4].map(|column| get::<String>(row, column));
            let (resolution, factor) = (get::<f64>(row, 3), get::<f64>(row, 5));
            if name.is_some() && unit.is_some() {
                let sql = "INSERT INTO channel (capture_id, channel, unit, resolution, original_unit, factor) \
                           VALUES (?1, ?2, ?3, ?4, ?5, ?6) ON CONFLICT DO NOTHING";
                self.connection.execute(sql, params![self.report.id, name, unit, resolution, original_unit, factor])?;
            }
        }
        Ok(())
    }

    fn push(&mut self, record: Record) -> Result<(), StoreError> {
        self.pending.push((self.report.id, record));
        if self.pending.len() >= STEP { self.write() } else { Ok(()) }
    }

    fn write(&mut self) -> Result<(), StoreError> {
        let transaction = self.connection.transaction()?;
        insert(&transaction, &self.pending, SystemClock.utc_ns(), 0)?;
        transaction.commit()?;
        self.pending.clear();
        Ok(())
    }

    fn finish(mut self) -> Result<RecoveredCapture, StoreError> {
        let id = self.report.id;
        let state = get(&self.row, 3).unwrap_or_else(|| "stopped".to_owned());
        let trailing: Vec<Gap> = self.next_gap.take().into_iter().chain(self.gaps.by_ref()).collect();
        if let Some((last, (_, segment))) = self.last.zip(self.segment.clone()) {
            let lost = (self.end - 1 - last.seq).max(0) as u64;
            // A capture that continues measures the gap since its last sample again.
            let until = last.host_utc_ns + ((lost + 1) as f64 * NANOS_PER_SECOND as f64 / segment.rate_hz) as i64;
            let end = Some(self.gap_here(last.host_utc_ns, until, lost))
                .filter(|gap| gap.missing > 0 && state != "capturing");
            for gap in trailing.into_iter().filter(|_| state != "capturing").chain(end) {
                self.push(Record::Gap(Gap { before_seq: self.next_seq, ..gap }))?;
            }
        }
        let rejected = self.salvage.rejected.iter().filter(|row| get(row, 0) == Some(id));
        let rejected: Vec<Record> = rejected
            .filter_map(|row| {
                let count = u64::try_from(get::<i64>(row, 2)?).ok()?;
                Some(Record::Discarded { cause: named(row, 1)?, count })
            })
            .collect();
        for record in rejected {
            self.push(record)?;
        }
        let lost = self.report.samples_lost;
        self.write()?;
        self.trail()?;
        if lost > 0 || self.row.is_empty() {
            let samples = imu_core::units::counted(self.report.samples, "sample", "samples");
            let message = format!("recovered from a damaged database: {samples} taken, {lost} lost");
            let event = EventRecord { utc_ns: SystemClock.utc_ns(), kind: EventKind::Warning, message, detail: None };
            self.push(Record::Event(event))?;
            self.write()?;
        }
        let sql = "UPDATE capture SET state = ?2, ended_utc_ns = ?3, pinned = ?4, rate_hz = coalesce(rate_hz, ?5) WHERE id = ?1";
        self.connection.execute(
            sql,
            params![
                id,
                state,
                get::<i64>(&self.row, 9),
                get(&self.row, 17) == Some(1),
                get::<f64>(&self.row, 10).filter(|rate_hz| *rate_hz > 0.0)
            ],
        )?;
        Ok(self.report)
    }

    /// Copies events and configurations.
    fn trail(&mut self) -> Result<(), StoreError> {
        let id = self.report.id;
        let transaction = self.connection.transaction()?;
        for row in self.salvage.events.values().filter(|row| get(row, 1) == Some(id)) {
            let detail = get::<String>(row, 5).filter(|json| is_json(json));
            let sql = "INSERT INTO event (capture_id, utc_ns, kind, message, detail) VALUES (?1, ?2, ?3, ?4, ?5)";
            transaction.execute(sql, params![id, row[2], row[3], row[4], detail])?;
            self.report.events += 1;
        }
        for row in self.salvage.configurations.values().filter(|row| get(row, 1) == Some(id)) {
            let before = get(row, 3).unwrap_or(0);
            let shift = self.shifts.iter().rev().find(|(from, _)| *from <= before).map_or(0, |(_, shift)| *shift);
            let before = (before - shift).clamp(0, self.next_seq as i64);
            let sql = "INSERT INTO configuration (capture_id, utc_ns, before_seq, registers) VALUES (?1, ?2, ?3, ?4)";
            transaction.execute(sql, params![id, row[2], before, row[4]])?;
        }
        transaction.commit()?;
        Ok(())
    }
}

/// Returns the batch's rows, if all are present and match its checksum. If several rows claim the same place, each is
/// tried.
fn intact(batch: &BatchRow, rows: &BTreeMap<i64, Vec<StoredRow>>) -> Option<Vec<StoredRow>> {
    if rows.len() as i64 != batch.count {
        return None;
    }
    let contested = rows.values().filter(|versions| versions.len() > 1).count();
    // Each bit of `choice` selects the first or the last version for one contested place.
    for choice in 0..1_u32 << contested.min(CONTESTED) {
        let mut bit = 0;
        let mut run = Run::new(batch.first_seq);
        let chosen = rows.values().filter_map(|versions| {
            if versions.len() == 1 {
                return versions.first();
            }
            let last = bit < CONTESTED && choice >> bit & 1 == 1;
            bit += 1;
            if last { versions.last() } else { versions.first() }
        });
        let chosen: Vec<StoredRow> = chosen.copied().collect();
        chosen.iter().for_each(|row| run.push(row));
        if run.crc() == batch.crc {
            return Some(chosen);
        }
    }
    None
}

fn is_json(text: &str) -> bool {
    serde_json::from_str::<serde_json::Value>(text).is_ok()
}

fn names_of(row: &[Value], column: usize) -> ChannelSet {
    let names = get::<String>(row, column).and_then(|json| serde_json::from_str::<Vec<String>>(&json).ok());
    names.iter().flatten().filter_map(|name| Channel::from_name(name)).collect()
}

fn gap_of(row: &[Value]) -> Option<Gap> {
    let unsigned = |column: usize| u64::try_from(get::<i64>(row, column)?).ok();
    Some(Gap {
        before_seq: unsigned(2)?,
        from_utc_ns: get(row, 3)?,
        to_utc_ns: get(row, 4)?,
        device_ns: get::<i64>(row, 5).zip(get::<i64>(row, 6)).map(|(from, to)| (from as u64, to as u64)),
        missing: unsigned(7)?,
        missing_exact: get(row, 8) == Some(1),
        cause: named(row, 9)?,
    })
}
