//! Unfinished captures: those that the last run of the daemon left, with the data that the accounting needs to resume them.

use super::captures::{CaptureState, json_of, known};
use super::sql::find;
use super::{Store, StoreError};
use imu_core::sample::{CaptureConfiguration, SensorDescription, Timebase};
use rusqlite::Connection;
use std::collections::BTreeMap;
use std::time::Duration;

/// A capture to be continued, with the data that the accounting needs to resume.
#[derive(Debug, Clone, PartialEq)]
pub struct Unfinished {
    /// Its id.
    pub id: i64,
    /// Its name.
    pub name: String,
    /// `Waiting` or `Capturing`.
    pub state: CaptureState,
    /// The sample time to record.
    pub planned: Option<Duration>,
    /// The planned start, UTC ns.
    pub start_at_utc_ns: Option<i64>,
    /// The actual start, UTC ns.
    pub started_utc_ns: Option<i64>,
    /// The sensor, as far as its description was read.
    pub sensor: SensorDescription,
    /// The sensor's configuration at the start.
    pub configuration: CaptureConfiguration,
    /// The last configured baud rate.
    pub baud: Option<u32>,
    /// Samples on disk; the next one's `seq`.
    pub samples: u64,
    /// Samples missing.
    pub missing: u64,
    /// Gaps recorded.
    pub gaps: u64,
    /// Valid measurements received, as of the last commit; `None` if they were not counted.
    pub received: Option<u64>,
    /// Received data that did not become samples, by cause.
    pub rejected: BTreeMap<String, u64>,
    /// Sample time so far, received and missing, ns.
    pub sample_time_ns: u64,
    /// Rate and timebase of the last segment.
    pub stream: Option<(f64, Timebase)>,
    /// Number of the last segment; 0 if there is none.
    pub segment: u32,
    /// Epoch of the last segment; 0 if there is none.
    pub epoch: u32,
    /// The boot of the host to which the last sample's monotonic time belongs, if known.
    pub boot_id: Option<String>,
    /// Device time of that epoch's first sample.
    pub epoch_first_device_ns: Option<u64>,
    /// Device, host monotonic and UTC time of the last sample.
    pub last: Option<(Option<u64>, u64, i64)>,
    /// Serial count of the last sample.
    pub last_sync_count: Option<u32>,
}

impl Store {
    /// Returns the captures that ran or waited when the program last ended, oldest first.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn unfinished(&self) -> Result<Vec<Unfinished>, StoreError> {
        self.execute(|transaction| {
            forget_open_gaps(transaction)?;
            unfinished(transaction)
        })
    }
}

/// Removes gaps whose next sample was not committed: they are measured again from the last committed sample.
fn forget_open_gaps(connection: &Connection) -> Result<(), StoreError> {
    let open = "capture_id = capture.id AND before_seq >= capture.samples";
    connection.execute(
        &format!(
            "UPDATE capture SET missing = missing - (SELECT CAST(total(missing) AS INTEGER) FROM gap WHERE {open}), \
             gaps = gaps - (SELECT count(*) FROM gap WHERE {open}), \
             sample_time_ns = max(0, sample_time_ns - coalesce(CAST(round((SELECT total(min(missing * 1e9 / \
             (SELECT rate_hz FROM segment WHERE capture_id = capture.id ORDER BY segment_id DESC LIMIT 1), \
             max(0, to_utc_ns - from_utc_ns))) FROM gap WHERE {open})) AS INTEGER), 0)) \
             WHERE state = 'capturing' AND lifecycle = 'live' AND EXISTS (SELECT 1 FROM gap WHERE {open})"
        ),
        [],
    )?;
    let sql = "DELETE FROM gap WHERE gap_id IN (SELECT gap_id FROM gap JOIN capture ON capture.id = gap.capture_id \
               WHERE state = 'capturing' AND lifecycle = 'live' AND before_seq >= samples)";
    connection.execute(sql, [])?;
    Ok(())
}

fn unfinished(connection: &Connection) -> Result<Vec<Unfinished>, StoreError> {
    let mut statement = connection.prepare(
        "SELECT id, name, state, planned_duration_ns, start_at_utc_ns, started_utc_ns, sensor, configuration, samples, \
         missing, gaps, sample_time_ns, received, \
         (SELECT json_group_object(cause, count) FROM rejected WHERE capture_id = capture.id), \
         (SELECT json_extract(registers, '$.baud') FROM configuration WHERE capture_id = capture.id \
         ORDER BY configuration_id DESC LIMIT 1) FROM capture WHERE state IN ('waiting', 'capturing') AND lifecycle = 'live' ORDER BY id",
    )?;
    let mut rows = statement.query([])?;
    let mut captures = Vec::new();
    while let Some(row) = rows.next()? {
        let mut capture = Unfinished {
            id: row.get(0)?,
            name: row.get(1)?,
            state: known("capture.state", row.get(2)?)?,
            planned: row.get::<_, Option<i64>>(3)?.map(|ns| Duration::from_nanos(ns.max(0) as u64)),
            start_at_utc_ns: row.get(4)?,
            started_utc_ns: row.get(5)?,
            sensor: json_of(row, 6)?.unwrap_or_default(),
            configuration: json_of(row, 7)?.unwrap_or_default(),
            samples: row.get::<_, i64>(8)? as u64,
            missing: row.get::<_, i64>(9)? as u64,
            gaps: row.get::<_, i64>(10)? as u64,
            sample_time_ns: row.get::<_, i64>(11)? as u64,
            received: row.get::<_, Option<i64>>(12)?.map(|received| received as u64),
            rejected: serde_json::from_str(&row.get::<_, String>(13)?)?,
            // A value that is not a valid baud rate cannot be tried first.
            baud: row.get(14).ok().flatten(),
            stream: None,
            segment: 0,
            epoch: 0,
            boot_id: None,
            epoch_first_device_ns: None,
            last: None,
            last_sync_count: None,
        };
        add_position(connection, &mut capture)?;
        captures.push(capture);
    }
    Ok(captures)
}

fn add_position(connection: &Connection, capture: &mut Unfinished) -> Result<(), StoreError> {
    // The stream is that of the last sample: a segment may have been committed before its first one.
    let sql = "SELECT segment_id, epoch, coalesce(of_last.rate_hz, segment.rate_hz), \
               coalesce(of_last.timebase, segment.timebase), (SELECT first_device_time_ns FROM segment AS first \
               WHERE first.capture_id = segment.capture_id AND first.epoch = segment.epoch ORDER BY segment_id LIMIT 1) \
               FROM segment LEFT JOIN (SELECT rate_hz, timebase FROM segment WHERE capture_id = ?1 AND samples > 0 \
               ORDER BY segment_id DESC LIMIT 1) AS of_last ON true WHERE capture_id = ?1 ORDER BY segment_id DESC LIMIT 1";
    let found = find(connection, sql, [capture.id], |row| {
        Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get::<_, String>(3)?, row.get::<_, Option<i64>>(4)?))
    })?;
    if let Some((segment, epoch, rate_hz, timebase, first)) = found {
        capture.segment = segment;
        capture.epoch = epoch;
        capture.stream = Some((rate_hz, known("segment.timebase", timebase)?));
        capture.epoch_first_device_ns = first.map(|ns| ns as u64);
    }
    let sql = "SELECT device_time_ns, host_mono_ns, host_utc_ns, sync_count, (SELECT boot_id FROM segment WHERE segment.capture_id = sample.capture_id AND \
               segment.segment_id = sample.segment_id) FROM sample WHERE capture_id = ?1 ORDER BY seq DESC LIMIT 1";
    let found = find(connection, sql, [capture.id], |row| {
        let device: Option<i64> = row.get(0)?;
        let last = (device.map(|ns| ns as u64), row.get::<_, i64>(1)? as u64, row.get(2)?);
        Ok((Some(last), row.get(3)?, row.get(4)?))
    })?;
    (capture.last, capture.last_sync_count, capture.boot_id) = found.unwrap_or_default();
    if let Some((_, _, utc_ns)) = &mut capture.last {
        *utc_ns = super::utc::corrected(connection, capture.id, capture.samples.saturating_sub(1), *utc_ns)?;
    }
    Ok(())
}
