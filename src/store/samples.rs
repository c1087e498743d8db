//! Samples: read in chunks, column by column.

use super::sql::find;
use super::{Reader, StoreError};
use imu_core::sample::Channel;
use rusqlite::types::ValueRef;
use rusqlite::{Row, params};
use std::ops::Range;

/// The maximum number of rows per query. Longer chunks are read in several queries, so that no read transaction lasts.
const ROWS_PER_QUERY: u64 = 65_536;

/// The range of samples in a capture: `first..=last`; a capture without samples has none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SeqRange {
    /// The first sample's `seq`.
    pub first: u64,
    /// The last sample's `seq`.
    pub last: u64,
}

/// The three clocks of a chunk's samples.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Times {
    /// The sensor's clock in ns, if it was sent.
    pub device_ns: Vec<Option<u64>>,
    /// The host's monotonic clock in ns.
    pub host_mono_ns: Vec<u64>,
    /// UTC in ns since 1970.
    pub host_utc_ns: Vec<i64>,
}

/// Consecutive samples, column by column; all columns have the same length.
#[derive(Debug, Clone, PartialEq)]
pub struct Chunk {
    /// `seq` of the first row; row i has `first_seq + i`.
    pub first_seq: u64,
    /// The number of each row's segment.
    pub segment: Vec<u32>,
    /// The requested channels, in the requested order.
    pub channels: Vec<Channel>,
    /// One column per channel, in the channel's unit; NaN if the sample has no value.
    pub columns: Vec<Vec<f64>>,
    /// The clocks, if requested.
    pub times: Option<Times>,
}

impl Chunk {
    fn new(first_seq: u64, channels: &[Channel], times: bool) -> Self {
        Self {
            first_seq,
            segment: Vec::new(),
            channels: channels.to_vec(),
            columns: vec![Vec::new(); channels.len()],
            times: times.then(Times::default),
        }
    }
    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.segment.len()
    }
    /// Returns whether the chunk is empty: the capture has no sample at or after the requested one.
    pub fn is_empty(&self) -> bool {
        self.segment.is_empty()
    }
    /// Returns the `seq` after the last row.
    pub fn next_seq(&self) -> u64 {
        self.first_seq + self.len() as u64
    }
}

/// Reads a range of samples with `read`, at most `most` at once, until the range or the samples end. What `read` takes
/// is the first sample and the maximum number of samples.
pub fn chunks<E>(
    range: Range<u64>,
    most: usize,
    mut read: impl FnMut(u64, usize) -> Result<Chunk, E>,
) -> impl Iterator<Item = Result<Chunk, E>> {
    let mut next_seq = range.start;
    std::iter::from_fn(move || {
        let limit = most.min(usize::try_from(range.end.saturating_sub(next_seq)).unwrap_or(most));
        let chunk = (limit > 0).then(|| read(next_seq, limit))?;
        next_seq = chunk.as_ref().map_or(range.end, Chunk::next_seq);
        Some(chunk).filter(|chunk| !chunk.as_ref().is_ok_and(Chunk::is_empty))
    })
}

impl Reader {
    /// Returns up to `limit` samples from `from_seq` on, without their times.
    ///
    /// # Errors
    /// The error that the database reports; a missing `seq` is [`StoreError::Damaged`].
    pub fn read_chunk(
        &self,
        capture_id: i64,
        from_seq: u64,
        limit: usize,
        channels: &[Channel],
    ) -> Result<Chunk, StoreError> {
        self.read(capture_id, from_seq, limit, channels, false)
    }

    /// Returns samples as [`Self::read_chunk`] does, with the three clocks.
    ///
    /// # Errors
    /// As [`Self::read_chunk`].
    pub fn read_samples(
        &self,
        capture_id: i64,
        from_seq: u64,
        limit: usize,
        channels: &[Channel],
    ) -> Result<Chunk, StoreError> {
        self.read(capture_id, from_seq, limit, channels, true)
    }

    fn read(
        &self,
        capture_id: i64,
        from_seq: u64,
        limit: usize,
        channels: &[Channel],
        times: bool,
    ) -> Result<Chunk, StoreError> {
        let mut sql = String::from("SELECT seq, segment_id");
        for channel in channels {
            sql.push_str(", ");
            sql.push_str(channel.name());
        }
        if times {
            sql.push_str(", device_time_ns, host_mono_ns, host_utc_ns");
        }
        sql.push_str(" FROM sample WHERE capture_id = ?1 AND seq >= ?2 AND seq < ?3 ORDER BY seq");
        let mut statement = self.connection.prepare_cached(&sql)?;
        let mut chunk = Chunk::new(from_seq, channels, times);
        let end = from_seq.saturating_add(limit as u64).min(i64::MAX as u64);
        while chunk.next_seq() < end {
            let (begin, stop) = (chunk.next_seq(), end.min(chunk.next_seq() + ROWS_PER_QUERY));
            let mut rows = statement.query(params![capture_id, begin as i64, stop as i64])?;
            while let Some(row) = rows.next()? {
                push(&mut chunk, row)?;
            }
            if chunk.next_seq() < stop {
                break;
            }
        }
        Ok(chunk)
    }

    /// Returns the first and last sample of a capture; `None` if it has none.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn seq_range(&self, capture_id: i64) -> Result<Option<SeqRange>, StoreError> {
        let end = |order: &str| -> Result<Option<i64>, StoreError> {
            let sql = format!("SELECT seq FROM sample WHERE capture_id = ?1 ORDER BY seq {order} LIMIT 1");
            Ok(find(&self.connection, &sql, [capture_id], |row| row.get(0))?)
        };
        Ok(match (end("ASC")?, end("DESC")?) {
            (Some(first), Some(last)) => Some(SeqRange { first: first as u64, last: last as u64 }),
            _ => None,
        })
    }

    /// Returns segment, device time and civil time of a sample.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] if the sample does not exist, or the error that the database reports.
    pub fn sample_clocks(&self, capture_id: i64, seq: u64) -> Result<(u32, Option<u64>, i64), StoreError> {
        let sql = "SELECT segment_id, device_time_ns, host_utc_ns FROM sample WHERE capture_id = ?1 AND seq = ?2";
        let read = |row: &Row<'_>| Ok((row.get(0)?, row.get::<_, Option<i64>>(1)?.map(|ns| ns as u64), row.get(2)?));
        let found = find(&self.connection, sql, params![capture_id, seq as i64], read)?;
        found.ok_or_else(|| StoreError::Damaged(format!("sample {seq} is not there")))
    }
}

fn push(chunk: &mut Chunk, row: &Row<'_>) -> Result<(), StoreError> {
    let seq = row.get_ref(0)?.as_i64().map_err(rusqlite::Error::from)? as u64;
    if seq != chunk.next_seq() {
        let report = format!("sample {} is not there, the next one is {seq}", chunk.next_seq());
        return Err(StoreError::Damaged(report));
    }
    chunk.segment.push(row.get(1)?);
    for (column, index) in chunk.columns.iter_mut().zip(2..) {
        column.push(match row.get_ref(index)? {
            ValueRef::Real(value) => value,
            _ => f64::NAN,
        });
    }
    if let Some(times) = &mut chunk.times {
        let first = 2 + chunk.columns.len();
        times.device_ns.push(row.get::<_, Option<i64>>(first)?.map(|ns| ns as u64));
        times.host_mono_ns.push(row.get::<_, i64>(first + 1)? as u64);
        times.host_utc_ns.push(row.get(first + 2)?);
    }
    Ok(())
}
