//! Accounting: reads a capture's numbers in one snapshot and passes them to [`imu_core::sample::audit`], which defines
//! what must hold.

use super::captures::known;
use super::sql::{find, list};
use super::{Reader, StoreError};
use imu_core::sample::audit::{CountFacts, GapFacts, Report, STRETCHES_SHOWN, SegmentFacts, audit_in_order};
use imu_core::sample::device_clock::ClockEstimate;
use imu_core::sample::{DiscardCause, Timebase};
use rusqlite::{CachedStatement, Connection, OptionalExtension, Row, params};
use serde::Serialize;
use std::collections::BTreeMap;

/// The sensor's clock against the host's in one epoch.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct DeviceClockRow {
    /// One run of the sensor's clock, from 1.
    pub epoch: u32,
    /// The last estimate of that epoch.
    #[serde(flatten)]
    pub estimate: ClockEstimate,
}

impl Reader {
    /// Checks whether the capture's numbers agree, as of the last commit. It reads a few rows per segment and gap: the
    /// number of samples follows from the first and last `seq`.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or the error that the database reports.
    pub fn accounting(&self, capture_id: i64) -> Result<Report, StoreError> {
        self.accounting_by(capture_id, false)
    }

    /// Checks as [`Self::accounting`] does, but counts every row, also per segment. This takes some tenths of a second
    /// for a night.
    ///
    /// # Errors
    /// As [`Self::accounting`].
    pub fn accounting_of_every_row(&self, capture_id: i64) -> Result<Report, StoreError> {
        self.accounting_by(capture_id, true)
    }

    /// Returns the sensor's clock against the host's, as last estimated in each epoch.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn device_clocks(&self, capture_id: i64) -> Result<Vec<DeviceClockRow>, StoreError> {
        let sql = "SELECT epoch, skew_ppm, skew_ppm_uncertainty, offset_s, latency_mean_ms, latency_max_ms, span_s \
                   FROM device_clock WHERE capture_id = ?1 ORDER BY epoch LIMIT ?2";
        let values = params![capture_id, STRETCHES_SHOWN as i64];
        Ok(list(&self.connection, sql, values, |row| {
            Ok(DeviceClockRow {
                epoch: row.get(0)?,
                estimate: ClockEstimate {
                    skew_ppm: row.get(1)?,
                    skew_ppm_uncertainty: row.get(2)?,
                    offset_s: row.get(3)?,
                    latency_mean_ms: row.get(4)?,
                    latency_max_ms: row.get(5)?,
                    span_s: row.get(6)?,
                },
            })
        })?)
    }

    fn accounting_by(&self, capture_id: i64, every_row: bool) -> Result<Report, StoreError> {
        // One snapshot: rows that are committed meanwhile appear in none of the numbers.
        let snapshot = self.connection.unchecked_transaction()?;
        let mut counts = counts(&snapshot, capture_id)?;
        if every_row {
            let sql = "SELECT count(*) FROM sample WHERE capture_id = ?1";
            counts.committed = snapshot.query_row(sql, [capture_id], |row| row.get::<_, i64>(0))? as u64;
        }
        // Row by row: a capture may have a million of either.
        let mut ticks = Ticks::new(&snapshot, capture_id, every_row)?;
        let mut segments = snapshot.prepare_cached(
            "SELECT segment_id, epoch, first_seq, samples, rate_hz, timebase FROM segment WHERE capture_id = ?1 \
             ORDER BY segment_id",
        )?;
        let mut gaps =
            snapshot.prepare_cached("SELECT before_seq, missing FROM gap WHERE capture_id = ?1 ORDER BY before_seq")?;
        let report = audit_in_order(
            segments.query_and_then([capture_id], |row| ticks.complete(segment_of(row)?))?,
            gaps.query_and_then([capture_id], gap_of)?,
            counts,
        );
        drop((segments, gaps, ticks));
        snapshot.finish()?;
        report
    }
}

fn counts(connection: &Connection, capture_id: i64) -> Result<CountFacts, StoreError> {
    let sql = "SELECT received, samples, missing, gaps, segments, \
               (SELECT json_group_object(cause, count) FROM rejected WHERE capture_id = capture.id), \
               (SELECT max(seq) FROM sample WHERE capture_id = capture.id) + 1 \
               - (SELECT min(seq) FROM sample WHERE capture_id = capture.id) \
               FROM capture WHERE id = ?1";
    let found = find(connection, sql, [capture_id], |row| {
        let count = |index| row.get::<_, i64>(index).map(|count| count as u64);
        Ok((
            row.get::<_, Option<i64>>(0)?,
            [count(1)?, count(2)?, count(3)?, count(4)?],
            row.get::<_, String>(5)?,
            row.get::<_, Option<i64>>(6)?.unwrap_or(0),
        ))
    })?;
    let Some((received, counters, rejected, rows)) = found else {
        return Err(StoreError::NoSuchCapture(capture_id.to_string()));
    };
    let mut discarded: BTreeMap<String, u64> = serde_json::from_str(&rejected)?;
    discarded.retain(|cause, _| DiscardCause::from_name(cause).is_some_and(DiscardCause::is_frame));
    Ok(CountFacts {
        received: received.map(|received| received as u64),
        committed: rows as u64,
        in_flight: 0,
        discarded,
        counters,
    })
}

fn segment_of(row: &Row<'_>) -> Result<SegmentFacts, StoreError> {
    Ok(SegmentFacts {
        number: row.get(0)?,
        epoch: row.get(1)?,
        first_seq: row.get::<_, i64>(2)? as u64,
        samples: row.get::<_, i64>(3)? as u64,
        rate_hz: row.get(4)?,
        timebase: known("segment.timebase", row.get(5)?)?,
        ticks: None,
    })
}

fn gap_of(row: &Row<'_>) -> Result<GapFacts, StoreError> {
    Ok(GapFacts { before_seq: row.get::<_, i64>(0)? as u64, missing: row.get::<_, i64>(1)? as u64 })
}

/// The ticks of the samples in a segment, as opposed to the statements in the segment's row.
struct Ticks<'a> {
    capture_id: i64,
    at: CachedStatement<'a>,
    rows: Option<CachedStatement<'a>>,
}

impl<'a> Ticks<'a> {
    fn new(connection: &'a Connection, capture_id: i64, every_row: bool) -> Result<Self, StoreError> {
        let sql = "SELECT device_time_ns, sync_count FROM sample WHERE capture_id = ?1 AND seq = ?2";
        let at = connection.prepare_cached(sql)?;
        let sql = "SELECT count(*) FROM sample WHERE capture_id = ?1 AND seq >= ?2 AND seq < ?3 AND segment_id = ?4";
        let rows = every_row.then(|| connection.prepare_cached(sql)).transpose()?;
        Ok(Self { capture_id, at, rows })
    }

    /// Adds the first and last tick to the segment and, if every row is counted, the number of its rows.
    fn complete(&mut self, mut segment: SegmentFacts) -> Result<SegmentFacts, StoreError> {
        if let Some(rows) = &mut self.rows {
            let (from, to) = (segment.first_seq as i64, (segment.first_seq + segment.samples) as i64);
            let counted =
                rows.query_row(params![self.capture_id, from, to, segment.number], |row| row.get::<_, i64>(0));
            segment.samples = counted? as u64;
        }
        let column = match segment.timebase {
            Timebase::Device => 0,
            Timebase::SyncCounter => 1,
            Timebase::Arrival | Timebase::Stamps | Timebase::Rate => return Ok(segment),
        };
        if let Some(last) = segment.samples.checked_sub(1) {
            segment.ticks = self.tick(segment.first_seq, column)?.zip(self.tick(segment.first_seq + last, column)?);
        }
        Ok(segment)
    }

    fn tick(&mut self, seq: u64, column: usize) -> Result<Option<u64>, StoreError> {
        let values = params![self.capture_id, seq as i64];
        let found = self.at.query_row(values, |row| row.get::<_, Option<i64>>(column)).optional()?;
        Ok(found.flatten().map(|tick| tick as u64))
    }
}

#[cfg(test)]
mod tests {
    use crate::store::{CaptureState, NewCapture, Store, StoreOptions};
    use std::time::Instant;

    /// Returns the peak memory use of this process since the last call, in bytes.
    fn peak_memory() -> u64 {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
        let kib: u64 = line.trim().trim_end_matches(" kB").parse().unwrap();
        // proc(5): 5 resets the peak to the present use.
        std::fs::write("/proc/self/clear_refs", "5").unwrap();
        kib << 10
    }

    #[test]
    #[ignore = "the process's memory is measured: to be run alone, cargo test --release --lib a_million_segments -- --ignored"]
    fn a_million_segments_and_gaps_are_accounted_for_in_little_memory() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.db");
        let store = Store::open(&path, StoreOptions::default()).unwrap();
        let id = store.create_capture(NewCapture::new("test", CaptureState::Complete)).unwrap();
        store.close().unwrap();
        // Two samples per segment, three missing between two segments.
        rusqlite::Connection::open(&path)
            .unwrap()
            .execute_batch(
                "BEGIN;
                 CREATE TEMP TABLE n AS WITH RECURSIVE n (i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i < 999999)
                     SELECT i FROM n;
                 INSERT INTO segment (capture_id, segment_id, epoch, first_seq, samples, rate_hz, timebase, channels, first_utc_ns)
                     SELECT 1, i + 1, 1, 2 * i, 2, 40.0, 'device', '[]', 0 FROM n;
                 INSERT INTO sample (capture_id, segment_id, seq, device_time_ns, host_mono_ns, host_utc_ns)
                     SELECT 1, i + 1, 2 * i + j, (5 * i + j) * 25000000, 0, 0 FROM n, (SELECT 0 AS j UNION ALL SELECT 1);
                 INSERT INTO gap (capture_id, before_seq, from_utc_ns, to_utc_ns, missing, missing_exact, cause)
                     SELECT 1, 2 * i, 0, 0, 3, 1, 'silent' FROM n WHERE i > 0;
                 UPDATE capture SET samples = 2000000, missing = 2999997, gaps = 999999, segments = 1000000, received = 2000000;
                 COMMIT;",
            )
            .unwrap();
        let reader = crate::store::Reader::open(&path).unwrap();
        reader.device_clocks(id).unwrap();
        peak_memory();
        let before = peak_memory();
        let begun = Instant::now();
        let report = reader.accounting(id).unwrap();
        let (took, more) = (begun.elapsed(), peak_memory().saturating_sub(before));
        assert!(report.holds, "{:?}", report.violations);
        assert_eq!((report.expected, report.missing, report.stretches.len()), (4_999_997, 2_999_997, 1));
        println!("10^6 segments and gaps: {took:?}, {} KiB more", more >> 10);
        assert!(more < 8 << 20, "{more} bytes");
        let begun = Instant::now();
        assert!(reader.accounting_of_every_row(id).unwrap().holds);
        let more = peak_memory().saturating_sub(before);
        println!("every row: {:?}, {} KiB more", begun.elapsed(), more >> 10);
        assert!(more < 8 << 20, "{more} bytes");
    }
}
