//! Checks in full whether the structure and the content of a database are intact, for `vn100d check`.

use super::batch::{batch_row, is_intact};
use super::check_at_start::truncated;
use super::error::reports_damage;
use super::sql::{find, list, value};
use super::{Reader, StoreError};
use rusqlite::{Connection, params};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The maximum number of listed findings of one kind.
const LISTED: usize = 100;
/// Batches read per query.
const PAGE: i64 = 1000;

/// A violation of a rule that must hold.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// The check: `integrity` `foreign_keys` `checksum` `samples` `segments` `gaps` `accounting` `unreadable` `log`.
    pub check: &'static str,
    /// The capture concerned.
    pub capture: Option<i64>,
    /// The finding in one sentence.
    pub message: String,
}

/// The result for one capture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CheckedCapture {
    /// Its id.
    pub id: i64,
    /// Its name.
    pub name: String,
    /// Samples, according to the capture's row.
    pub samples: u64,
    /// Missing samples, according to the capture's row.
    pub missing: u64,
    /// Batches whose checksum matches.
    pub batches: u64,
    /// Samples that belong to no batch: written by a version that kept no checksums.
    pub without_checksum: u64,
}

/// The result of a check.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CheckReport {
    /// The database.
    pub database: PathBuf,
    /// The captures.
    pub captures: Vec<CheckedCapture>,
    /// The violations; empty if there are none.
    pub findings: Vec<Finding>,
}

/// Checks the database at `path` in full. It only reads, and may run beside a daemon.
///
/// # Errors
/// [`StoreError`] if there is nothing that can be checked: no database, a foreign file, another schema.
pub fn check(path: &Path) -> Result<CheckReport, StoreError> {
    let mut report = CheckReport { database: path.to_owned(), captures: Vec::new(), findings: Vec::new() };
    let reader = match Reader::open(path) {
        Ok(reader) => reader,
        Err(StoreError::Sqlite(error)) if reports_damage(&error) => {
            report.add("unreadable", None, format!("the database cannot be opened: {error}"));
            return Ok(report);
        }
        Err(error) => return Err(error),
    };
    let connection = &reader.connection;
    if let Some(problem) = truncated(connection, path) {
        report.add("integrity", None, problem);
    }
    report.lines(connection, "integrity", "PRAGMA integrity_check(100)", |line| {
        (line != "ok").then(|| super::writer::one_line(line))
    });
    report.lines(
        connection,
        "foreign_keys",
        "SELECT printf('table %s, row %s refers to a row of %s that is not there', \"table\", rowid, parent) \
         FROM pragma_foreign_key_check LIMIT 100",
        |line| Some(line.to_owned()),
    );
    for id in report.ids(connection) {
        report.capture(&reader, id);
    }
    Ok(report)
}

impl CheckReport {
    /// Returns whether there are no findings.
    pub fn is_clean(&self) -> bool {
        self.findings.is_empty()
    }

    fn add(&mut self, check: &'static str, capture: Option<i64>, message: String) {
        let same = self.findings.iter().filter(|finding| finding.check == check && finding.capture == capture).count();
        if same < LISTED {
            self.findings.push(Finding { check, capture, message });
        }
    }

    fn lines(
        &mut self,
        connection: &Connection,
        check: &'static str,
        sql: &str,
        finding: impl Fn(&str) -> Option<String>,
    ) {
        let lines = || -> Result<Vec<String>, rusqlite::Error> {
            connection.prepare(sql)?.query_map([], |row| row.get(0))?.collect()
        };
        match lines() {
            Ok(lines) => lines.iter().filter_map(|line| finding(line)).for_each(|line| self.add(check, None, line)),
            Err(error) => self.add("unreadable", None, format!("the {check} check ended early: {error}")),
        }
    }

    fn ids(&mut self, connection: &Connection) -> Vec<i64> {
        let mut ids = Vec::new();
        let mut read = || -> Result<(), rusqlite::Error> {
            let mut statement = connection.prepare("SELECT id FROM capture WHERE lifecycle = 'live' ORDER BY id")?;
            let mut rows = statement.query([])?;
            while let Some(row) = rows.next()? {
                ids.push(row.get(0)?);
            }
            Ok(())
        };
        if let Err(error) = read() {
            self.add("unreadable", None, format!("the list of captures ends early: {error}"));
        }
        ids
    }

    fn capture(&mut self, reader: &Reader, id: i64) {
        let mut findings = Vec::new();
        match check_capture(&reader.connection, id, &mut |check, message| findings.push((check, message))) {
            Ok(Some(capture)) => {
                self.captures.push(capture);
                match reader.accounting_of_every_row(id) {
                    Ok(report) => findings.extend(report.violations.into_iter().map(|text| ("accounting", text))),
                    Err(StoreError::NoSuchCapture(_)) => {}
                    Err(error) => findings.push(("unreadable", format!("the accounting cannot be made: {error}"))),
                }
            }
            // The capture was deleted meanwhile.
            Ok(None) => findings.clear(),
            Err(error) => findings.push(("unreadable", format!("capture {id} cannot be read: {error}"))),
        }
        for (check, message) in findings {
            self.add(check, Some(id), message);
        }
    }
}

type Found<'a> = &'a mut dyn FnMut(&'static str, String);

/// The counts in one segment's row.
struct SegmentCount {
    number: i64,
    first_seq: i64,
    samples: i64,
}

fn check_capture(connection: &Connection, id: i64, found: Found<'_>) -> Result<Option<CheckedCapture>, StoreError> {
    // One short transaction: the counters and the counted rows belong to the same instant, also while a daemon writes.
    let snapshot = connection.unchecked_transaction()?;
    let sql = "SELECT name, samples, missing, gaps, segments FROM capture WHERE id = ?1 AND lifecycle = 'live'";
    let row = find(&snapshot, sql, [id], |row| row.try_into())?;
    let Some((name, samples, missing, gaps, segments)): Option<(String, i64, i64, i64, i64)> = row else {
        return Ok(None);
    };
    let listed = segments_of(&snapshot, id)?;
    let sql = "SELECT count(*), coalesce(sum(missing), 0), coalesce(max(before_seq), 0) FROM gap WHERE capture_id = ?1";
    let (gap_count, gap_missing, last_gap): (i64, i64, i64) = snapshot.query_row(sql, [id], |row| row.try_into())?;
    let last_seq: Option<i64> = value(&snapshot, "SELECT max(seq) FROM sample WHERE capture_id = ?1", [id])?;
    drop(snapshot);

    if last_seq.map_or(0, |seq| seq + 1) != samples {
        let end = last_seq.map_or_else(|| "there is none".to_owned(), |seq| format!("the last is {seq}"));
        found("samples", format!("the capture counts {samples} samples, of its rows {end}"));
    }
    if listed.len() as i64 != segments {
        found("segments", format!("the capture counts {segments} segments, there are {}", listed.len()));
    }
    if (gap_count, gap_missing) != (gaps, missing) {
        found(
            "gaps",
            format!("the capture counts {missing} missing in {gaps} gaps, there are {gap_missing} in {gap_count}"),
        );
    }
    if last_gap > samples {
        found("gaps", format!("a gap lies before sample {last_gap}, beyond the {samples} that there are"));
    }
    check_segments(connection, id, samples, &listed, found);
    let mut capture =
        CheckedCapture { id, name, samples: samples as u64, missing: missing as u64, batches: 0, without_checksum: 0 };
    check_batches(connection, &mut capture, found)?;
    Ok(Some(capture))
}

fn segments_of(connection: &Connection, id: i64) -> Result<Vec<SegmentCount>, rusqlite::Error> {
    let sql = "SELECT segment_id, first_seq, samples FROM segment WHERE capture_id = ?1 ORDER BY segment_id";
    list(connection, sql, [id], |row| {
        Ok(SegmentCount { number: row.get(0)?, first_seq: row.get(1)?, samples: row.get(2)? })
    })
}

fn check_segments(connection: &Connection, id: i64, samples: i64, segments: &[SegmentCount], found: Found<'_>) {
    let mut next = 0;
    for segment in segments {
        let SegmentCount { number, first_seq, samples: count } = segment;
        if *first_seq != next {
            found("segments", format!("segment {number} begins at sample {first_seq}, not at {next}"));
        }
        next = first_seq + count;
        let sql = "SELECT count(*), count(*) FILTER (WHERE segment_id <> ?4) FROM sample \
                   WHERE capture_id = ?1 AND seq >= ?2 AND seq < ?3";
        let rows = find(connection, sql, params![id, first_seq, next, number], |row| row.try_into());
        match rows.map(Option::unwrap_or_default) {
            Ok((rows, foreign)) => {
                let (rows, foreign): (i64, i64) = (rows, foreign);
                if rows != *count || foreign > 0 {
                    found(
                        "samples",
                        format!(
                            "segment {number} counts {count} samples, there are {rows}, {foreign} of other segments"
                        ),
                    );
                }
            }
            Err(error) => found("unreadable", format!("samples of segment {number} cannot be read: {error}")),
        }
    }
    if next != samples {
        found("segments", format!("the segments hold {next} samples, the capture counts {samples}"));
    }
}

/// Checks every batch's checksum, and counts the samples between batches.
fn check_batches(connection: &Connection, capture: &mut CheckedCapture, found: Found<'_>) -> Result<(), StoreError> {
    let samples = capture.samples as i64;
    let mut next = 0;
    loop {
        let sql = "SELECT capture_id, first_seq, count, crc FROM batch WHERE capture_id = ?1 AND first_seq >= ?2 \
                   ORDER BY first_seq LIMIT ?3";
        let batches = list(connection, sql, params![capture.id, next, PAGE], batch_row)?;
        let Some(last) = batches.last() else { break };
        let after = last.first_seq + last.count;
        for batch in &batches {
            // Batches that were added after the counters were read are ignored.
            if batch.first_seq >= samples {
                break;
            }
            let (from, to) = (batch.first_seq, batch.first_seq + batch.count - 1);
            if from < next {
                found("checksum", format!("the batch of samples {from}–{to} overlaps the one before"));
            }
            capture.without_checksum += (from - next).max(0) as u64;
            next = to + 1;
            match is_intact(connection, batch) {
                Ok(true) => capture.batches += 1,
                Ok(false) => found("checksum", format!("samples {from}–{to} are not what was committed")),
                Err(error) => found("unreadable", format!("samples {from}–{to} cannot be read: {error}")),
            }
        }
        if after >= samples {
            break;
        }
        next = next.max(after);
    }
    capture.without_checksum += (samples - next).max(0) as u64;
    Ok(())
}
