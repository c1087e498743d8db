//! The trail of a capture: its segments, gaps, events and configurations.

use super::captures::{json_of, known};
use super::sql::{find, list, value};
use super::{Page, PageRequest, Reader, StoreError, UtcNs};
use imu_core::sample::{Channel, GapCause, Timebase};
use rusqlite::{Row, params};
use serde::Serialize;
use std::collections::BTreeMap;

/// A segment as the interfaces show it.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct SegmentRow {
    /// Number within the capture, from 1.
    pub segment: u32,
    /// One run of the sensor's clock, from 1: a reset begins a new epoch.
    pub epoch: u32,
    /// `seq` of its first sample.
    pub first_seq: u64,
    /// Number of its samples.
    pub samples: u64,
    /// Output rate in Hz.
    pub rate_hz: f64,
    /// The source of its times.
    pub timebase: Timebase,
    /// Its channels in column order.
    pub channels: Vec<Channel>,
    /// Time of its first sample.
    pub from: UtcNs,
    /// Time of its last sample; null if it has none yet.
    pub to: Option<UtcNs>,
    /// Device time of its first sample in ns.
    pub first_device_time_ns: Option<u64>,
    /// Device time of its last sample in ns.
    pub last_device_time_ns: Option<u64>,
}

/// A gap as the interfaces show it.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct GapRow {
    /// Time of the last sample before it.
    pub from: UtcNs,
    /// Time of the first sample after it.
    pub to: UtcNs,
    /// Number of missing samples.
    pub missing: u64,
    /// Whether the number follows from the sensor's own clock; otherwise from the host's.
    pub missing_exact: bool,
    /// Its cause.
    pub cause: GapCause,
    /// `seq` of the first sample after it.
    pub before_seq: u64,
    /// The sensor's clock before it in ns, if it lies within one epoch.
    pub from_device_ns: Option<u64>,
    /// The sensor's clock after it in ns.
    pub to_device_ns: Option<u64>,
}

/// An event as the interfaces show it.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct EventRow {
    /// The time of the event.
    pub at: UtcNs,
    /// Its kind, one of those that docs/formats.md lists.
    pub kind: String,
    /// One sentence for a person.
    pub message: String,
    /// Details for a program.
    #[schema(value_type = Option<Object>)]
    pub detail: Option<serde_json::Value>,
}

/// The number of samples missing before each sample: by the first sample behind a gap, the sum of all gaps up to it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Missing(Vec<(u64, u64)>);

impl Missing {
    /// Builds the sums from gaps in order: the first sample behind each, and how many it lacks.
    pub fn of(gaps: impl IntoIterator<Item = (u64, u64)>) -> Self {
        let mut sum = 0;
        let summed = |(before_seq, missing)| {
            sum += missing;
            (before_seq, sum)
        };
        Self(gaps.into_iter().map(summed).collect())
    }

    /// Returns the number of samples missing before the sample `seq`, over all gaps that lie before it or end at it.
    pub fn up_to(&self, seq: u64) -> u64 {
        let gaps = self.0.partition_point(|(before_seq, _)| *before_seq <= seq);
        gaps.checked_sub(1).and_then(|last| self.0.get(last)).map_or(0, |(_, sum)| *sum)
    }
}

impl Reader {
    /// Returns a capture's segments in order.
    ///
    /// # Errors
    /// [`StoreError::BadCursor`], or the error that the database reports.
    pub fn segments(&self, capture_id: i64, page: &PageRequest) -> Result<Page<SegmentRow>, StoreError> {
        let sql = "SELECT segment_id, epoch, first_seq, samples, rate_hz, timebase, channels, first_utc_ns, last_utc_ns, \
                   first_device_time_ns, last_device_time_ns FROM segment WHERE capture_id = ?1 AND segment_id > ?2 \
                   ORDER BY segment_id LIMIT ?3";
        self.page(sql, capture_id, page, "segments", |row| {
            let names: Vec<String> = serde_json::from_str(&row.get::<_, String>(6)?)?;
            let device = |index| row.get::<_, Option<i64>>(index).map(|ns| ns.map(|ns| ns as u64));
            Ok(SegmentRow {
                segment: row.get(0)?,
                epoch: row.get(1)?,
                first_seq: row.get::<_, i64>(2)? as u64,
                samples: row.get::<_, i64>(3)? as u64,
                rate_hz: row.get(4)?,
                timebase: known("segment.timebase", row.get(5)?)?,
                channels: names.iter().filter_map(|name| Channel::from_name(name)).collect(),
                from: UtcNs(row.get(7)?),
                to: row.get::<_, Option<i64>>(8)?.map(UtcNs),
                first_device_time_ns: device(9)?,
                last_device_time_ns: device(10)?,
            })
        })
    }

    /// Returns a segment.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] if samples belong to a segment that does not exist, or the error that the database
    /// reports.
    pub fn segment(&self, capture_id: i64, segment: u32) -> Result<SegmentRow, StoreError> {
        let before = i64::from(segment.saturating_sub(1));
        let rows = self.segments(capture_id, &PageRequest::one_after("segments", before))?.rows;
        rows.into_iter()
            .next()
            .filter(|row| row.segment == segment)
            .ok_or_else(|| StoreError::Damaged(format!("segment {segment} of capture {capture_id} is not there")))
    }

    /// Returns civil time minus device time, ns, at the first sample of an epoch of the sensor's clock; `None` if its
    /// segments have no device time.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn epoch_offset_ns(&self, capture_id: i64, epoch: u32) -> Result<Option<i64>, StoreError> {
        let sql = "SELECT first_utc_ns - first_device_time_ns FROM segment WHERE capture_id = ?1 AND epoch = ?2 \
                   AND first_device_time_ns IS NOT NULL ORDER BY segment_id LIMIT 1";
        Ok(find(&self.connection, sql, params![capture_id, epoch], |row| row.get(0))?)
    }

    /// Returns the rate of one segment in Hz.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] if samples belong to a segment that does not exist, or the error that the database
    /// reports.
    pub fn segment_rate_hz(&self, capture_id: i64, segment: u32) -> Result<f64, StoreError> {
        let sql = "SELECT rate_hz FROM segment WHERE capture_id = ?1 AND segment_id = ?2";
        let found = find(&self.connection, sql, params![capture_id, segment], |row| row.get(0))?;
        found.ok_or_else(|| StoreError::Damaged(format!("segment {segment} of capture {capture_id} is not there")))
    }

    /// Returns the number of samples missing before the sample `seq`, over all gaps that lie before it.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn missing_before(&self, capture_id: i64, seq: u64) -> Result<u64, StoreError> {
        let sql = "SELECT coalesce(sum(missing), 0) FROM gap WHERE capture_id = ?1 AND before_seq < ?2";
        let missing: i64 = value(&self.connection, sql, params![capture_id, seq as i64])?;
        Ok(missing as u64)
    }

    /// Returns the number of samples missing before any sample, from one query: 16 bytes per gap.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn missing(&self, capture_id: i64) -> Result<Missing, StoreError> {
        let sql = "SELECT before_seq, missing FROM gap WHERE capture_id = ?1 ORDER BY before_seq";
        let gap = |row: &Row<'_>| Ok((row.get::<_, i64>(0)? as u64, row.get::<_, i64>(1)? as u64));
        Ok(Missing::of(list(&self.connection, sql, [capture_id], gap)?))
    }

    /// Returns the number of missing samples by the cause of their gaps.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn missing_by_cause(&self, capture_id: i64) -> Result<BTreeMap<String, u64>, StoreError> {
        let sql = "SELECT cause, sum(missing) FROM gap WHERE capture_id = ?1 GROUP BY cause";
        let entry = |row: &Row<'_>| Ok((row.get(0)?, row.get::<_, i64>(1)?.max(0) as u64));
        Ok(list(&self.connection, sql, [capture_id], entry)?.into_iter().collect())
    }

    /// Returns a capture's gaps in the order they were recorded.
    ///
    /// # Errors
    /// [`StoreError::BadCursor`], or the error that the database reports.
    pub fn gaps(&self, capture_id: i64, page: &PageRequest) -> Result<Page<GapRow>, StoreError> {
        // `+`: select by the key from the cursor on. With the index of captures each page would sort all the gaps of
        // its capture.
        let sql = "SELECT gap_id, from_utc_ns, to_utc_ns, missing, missing_exact, cause, before_seq, from_device_ns, \
                   to_device_ns FROM gap WHERE +capture_id = ?1 AND gap_id > ?2 ORDER BY gap_id LIMIT ?3";
        self.page(sql, capture_id, page, "gaps", |row| {
            let device = |index| row.get::<_, Option<i64>>(index).map(|ns| ns.map(|ns| ns as u64));
            Ok(GapRow {
                from: UtcNs(row.get(1)?),
                to: UtcNs(row.get(2)?),
                missing: row.get::<_, i64>(3)? as u64,
                missing_exact: row.get(4)?,
                cause: known("gap.cause", row.get(5)?)?,
                before_seq: row.get::<_, i64>(6)? as u64,
                from_device_ns: device(7)?,
                to_device_ns: device(8)?,
            })
        })
    }

    /// Returns a capture's events in the order they were recorded.
    ///
    /// # Errors
    /// [`StoreError::BadCursor`], or the error that the database reports.
    pub fn events(&self, capture_id: i64, page: &PageRequest) -> Result<Page<EventRow>, StoreError> {
        let sql = "SELECT event_id, utc_ns, kind, message, detail FROM event WHERE capture_id = ?1 AND event_id > ?2 \
                   ORDER BY event_id LIMIT ?3";
        self.page(sql, capture_id, page, "events", |row| {
            Ok(EventRow { at: UtcNs(row.get(1)?), kind: row.get(2)?, message: row.get(3)?, detail: json_of(row, 4)? })
        })
    }

    /// Returns the rows of a capture after the page's cursor; the first column is the key.
    fn page<T>(
        &self,
        sql: &str,
        capture_id: i64,
        page: &PageRequest,
        list: &str,
        read: impl Fn(&Row<'_>) -> Result<T, StoreError>,
    ) -> Result<Page<T>, StoreError> {
        let after = page.after(list)?.unwrap_or(-1);
        Page::read(&self.connection, sql, params![capture_id, after, page.limit() as i64 + 1], page, list, read)
    }
}
