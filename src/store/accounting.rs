//! Accounting: a capture's numbers, read in one snapshot and given to the one definition of what must hold
//! ([`crate::sample::audit`]).

use super::insert::timebase_from_name;
use super::{Reader, StoreError};
use crate::sample::audit::{CountFacts, GapFacts, Report, STRETCHES_SHOWN, SegmentFacts, audit};
use crate::sample::device_clock::ClockEstimate;
use crate::sample::{DiscardCause, Timebase};
use rusqlite::{Connection, OptionalExtension, params};
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
    /// Whether the capture's numbers agree, as of the last commit. A few rows per segment and gap are read: the number of
    /// samples follows from the first and last `seq`.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or what the database says.
    pub fn accounting(&self, capture_id: i64) -> Result<Report, StoreError> {
        self.accounting_by(capture_id, false)
    }

    /// The same with every row counted, per segment too: some tenths of a second for a night.
    ///
    /// # Errors
    /// As [`Self::accounting`].
    pub fn accounting_of_every_row(&self, capture_id: i64) -> Result<Report, StoreError> {
        self.accounting_by(capture_id, true)
    }

    /// The sensor's clock against the host's, as last estimated in each epoch.
    ///
    /// # Errors
    /// What the database says.
    pub fn device_clocks(&self, capture_id: i64) -> Result<Vec<DeviceClockRow>, StoreError> {
        let sql = "SELECT epoch, skew_ppm, skew_ppm_uncertainty, offset_s, latency_mean_ms, latency_max_ms, span_s \
                   FROM device_clock WHERE capture_id = ?1 ORDER BY epoch LIMIT ?2";
        let mut statement = self.connection.prepare_cached(sql)?;
        let rows = statement.query_map(params![capture_id, STRETCHES_SHOWN as i64], |row| {
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
        })?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    fn accounting_by(&self, capture_id: i64, every_row: bool) -> Result<Report, StoreError> {
        // One snapshot: what a commit adds meanwhile is in none of the numbers.
        let snapshot = self.connection.unchecked_transaction()?;
        let mut counts = counts(&snapshot, capture_id)?;
        let mut segments = segments(&snapshot, capture_id)?;
        if every_row {
            let (rows, by_segment) = count_rows(&snapshot, capture_id)?;
            counts.committed = rows;
            for segment in &mut segments {
                segment.samples = by_segment.get(&segment.number).copied().unwrap_or(0);
            }
        }
        add_ticks(&snapshot, capture_id, &mut segments)?;
        let gaps = gaps(&snapshot, capture_id)?;
        snapshot.finish()?;
        Ok(audit(&segments, &gaps, counts))
    }
}

fn counts(connection: &Connection, capture_id: i64) -> Result<CountFacts, StoreError> {
    let sql = "SELECT received, samples, missing, gaps, segments, \
               (SELECT json_group_object(cause, count) FROM rejected WHERE capture_id = capture.id), \
               (SELECT max(seq) + 1 - min(seq) FROM sample WHERE capture_id = capture.id) \
               FROM capture WHERE id = ?1";
    let found = connection
        .prepare_cached(sql)?
        .query_row([capture_id], |row| {
            let count = |index| row.get::<_, i64>(index).map(|count| count as u64);
            Ok((
                row.get::<_, Option<i64>>(0)?,
                [count(1)?, count(2)?, count(3)?, count(4)?],
                row.get::<_, String>(5)?,
                row.get::<_, Option<i64>>(6)?.unwrap_or(0),
            ))
        })
        .optional()?;
    let Some((received, counters, rejected, rows)) = found else {
        return Err(StoreError::NoSuchCapture { asked: capture_id.to_string() });
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

fn segments(connection: &Connection, capture_id: i64) -> Result<Vec<SegmentFacts>, StoreError> {
    let sql = "SELECT segment_id, epoch, first_seq, samples, rate_hz, timebase FROM segment WHERE capture_id = ?1 \
               ORDER BY segment_id";
    let mut statement = connection.prepare_cached(sql)?;
    let mut rows = statement.query([capture_id])?;
    let mut segments = Vec::new();
    while let Some(row) = rows.next()? {
        let timebase: String = row.get(5)?;
        segments.push(SegmentFacts {
            number: row.get(0)?,
            epoch: row.get(1)?,
            first_seq: row.get::<_, i64>(2)? as u64,
            samples: row.get::<_, i64>(3)? as u64,
            rate_hz: row.get(4)?,
            timebase: timebase_from_name(&timebase)
                .ok_or(StoreError::Unknown { column: "segment.timebase", found: timebase })?,
            ticks: None,
        });
    }
    Ok(segments)
}

/// The ticks come from the samples themselves, not from what the segment says of them.
fn add_ticks(connection: &Connection, capture_id: i64, segments: &mut [SegmentFacts]) -> Result<(), StoreError> {
    let mut statement = connection
        .prepare_cached("SELECT device_time_ns, sync_count FROM sample WHERE capture_id = ?1 AND seq = ?2")?;
    for segment in segments {
        let column = match segment.timebase {
            Timebase::Device => 0,
            Timebase::SyncCounter => 1,
            Timebase::Arrival | Timebase::Stamps | Timebase::Rate => continue,
        };
        let mut tick = |seq: u64| -> Result<Option<u64>, StoreError> {
            let found = statement.query_row(params![capture_id, seq as i64], |row| row.get::<_, Option<i64>>(column));
            Ok(found.optional()?.flatten().map(|tick| tick as u64))
        };
        if let Some(last) = segment.samples.checked_sub(1) {
            segment.ticks = tick(segment.first_seq)?.zip(tick(segment.first_seq + last)?);
        }
    }
    Ok(())
}

fn gaps(connection: &Connection, capture_id: i64) -> Result<Vec<GapFacts>, StoreError> {
    let mut statement =
        connection.prepare_cached("SELECT before_seq, missing FROM gap WHERE capture_id = ?1 ORDER BY gap_id")?;
    let rows = statement.query_map([capture_id], |row| {
        Ok(GapFacts { before_seq: row.get::<_, i64>(0)? as u64, missing: row.get::<_, i64>(1)? as u64 })
    })?;
    Ok(rows.collect::<Result<_, _>>()?)
}

fn count_rows(connection: &Connection, capture_id: i64) -> Result<(u64, BTreeMap<u32, u64>), StoreError> {
    let sql = "SELECT segment_id, count(*) FROM sample WHERE capture_id = ?1 GROUP BY segment_id";
    let mut statement = connection.prepare_cached(sql)?;
    let rows = statement.query_map([capture_id], |row| Ok((row.get(0)?, row.get::<_, i64>(1)? as u64)))?;
    let by_segment: BTreeMap<u32, u64> = rows.collect::<Result<_, _>>()?;
    Ok((by_segment.values().sum(), by_segment))
}
