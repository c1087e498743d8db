//! Batches: which samples were committed together, and a checksum of their values.
//!
//! CRC-32 (IEEE 802.3, as zlib's) over the rows in the order of `seq`, each as 164 bytes, little-endian: a 32-bit mask
//! (bit i: channel i has a value; 14: device time; 15: sync count), then `seq`, `segment_id`, `device_time_ns`,
//! `host_mono_ns`, `host_utc_ns`, `sync_count` as 64-bit integers, then the 14 channels as 64-bit floats; NULL and −0
//! count as 0 (SQLite does not keep its sign).

use super::StoreError;
use super::sql::run;
use imu_core::sample::{Channel, Sample};
use rusqlite::{Connection, params};

const ROW_BYTES: usize = 4 + 6 * 8 + Channel::COUNT * 8;
const DEVICE_TIME: u32 = 1 << Channel::COUNT;
const SYNC_COUNT: u32 = 1 << (Channel::COUNT + 1);

/// One row of table `sample` as it is stored.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct StoredRow {
    pub(super) seq: i64,
    pub(super) segment_id: i64,
    pub(super) device_time_ns: Option<i64>,
    pub(super) host_mono_ns: i64,
    pub(super) host_utc_ns: i64,
    pub(super) values: [Option<f64>; Channel::COUNT],
    pub(super) sync_count: Option<i64>,
}

impl StoredRow {
    pub(super) fn of(seq: u64, segment: u32, sample: &Sample) -> Self {
        Self {
            seq: seq as i64,
            segment_id: i64::from(segment),
            device_time_ns: sample.device_time_ns.map(|ns| ns as i64),
            host_mono_ns: sample.host_mono_ns as i64,
            host_utc_ns: sample.host_utc_ns,
            values: Channel::ALL.map(|channel| sample.get(channel)),
            sync_count: sample.sync_count.map(i64::from),
        }
    }

    /// Returns the sample, if the row holds a valid one.
    pub(super) fn to_sample(self) -> Sample {
        let mut sample = Sample::at(self.host_mono_ns as u64, self.host_utc_ns);
        sample.device_time_ns = self.device_time_ns.map(|ns| ns as u64);
        sample.sync_count = self.sync_count.and_then(|count| u32::try_from(count).ok());
        for (channel, value) in Channel::ALL.into_iter().zip(self.values) {
            if let Some(value) = value {
                sample.set(channel, value);
            }
        }
        sample
    }

    fn bytes(&self) -> [u8; ROW_BYTES] {
        let mut bytes = [0; ROW_BYTES];
        let mut mask = 0;
        mask |= if self.device_time_ns.is_some() { DEVICE_TIME } else { 0 };
        mask |= if self.sync_count.is_some() { SYNC_COUNT } else { 0 };
        let integers = [
            self.seq,
            self.segment_id,
            self.device_time_ns.unwrap_or(0),
            self.host_mono_ns,
            self.host_utc_ns,
            self.sync_count.unwrap_or(0),
        ];
        for (place, integer) in bytes[4..].chunks_exact_mut(8).zip(integers) {
            place.copy_from_slice(&integer.to_le_bytes());
        }
        for (index, (place, value)) in bytes[52..].chunks_exact_mut(8).zip(self.values).enumerate() {
            if let Some(value) = value {
                mask |= 1 << index;
                // Adding 0 takes the sign from −0.
                place.copy_from_slice(&(value + 0.0).to_bits().to_le_bytes());
            }
        }
        bytes[..4].copy_from_slice(&mask.to_le_bytes());
        bytes
    }
}

/// Consecutive samples of one capture and the checksum so far.
#[derive(Debug, Clone)]
pub(super) struct Run {
    pub(super) first_seq: i64,
    pub(super) count: i64,
    hasher: crc32fast::Hasher,
}

impl Run {
    pub(super) fn new(first_seq: i64) -> Self {
        Self { first_seq, count: 0, hasher: crc32fast::Hasher::new() }
    }
    /// Returns the `seq` that continues the run.
    pub(super) fn next_seq(&self) -> i64 {
        self.first_seq + self.count
    }
    pub(super) fn push(&mut self, row: &StoredRow) {
        self.hasher.update(&row.bytes());
        self.count += 1;
    }
    pub(super) fn crc(&self) -> u32 {
        self.hasher.clone().finalize()
    }
    /// Writes the run as a row of table `batch`.
    pub(super) fn store(&self, connection: &Connection, capture_id: i64, number: i64) -> Result<(), StoreError> {
        let sql = "INSERT INTO batch (capture_id, first_seq, count, number, crc) VALUES (?1, ?2, ?3, ?4, ?5)";
        run(connection, sql, params![capture_id, self.first_seq, self.count, number, i64::from(self.crc())])?;
        Ok(())
    }
}

/// A row of table `batch`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct BatchRow {
    pub(super) capture_id: i64,
    pub(super) first_seq: i64,
    pub(super) count: i64,
    pub(super) crc: u32,
}

/// Columns that [`stored_row`] reads, in its order.
pub(super) const ROW_COLUMNS: &str = "seq, segment_id, device_time_ns, host_mono_ns, host_utc_ns, yaw, pitch, roll, \
    mag_x, mag_y, mag_z, accel_x, accel_y, accel_z, gyro_x, gyro_y, gyro_z, temperature, pressure, sync_count";

/// Returns the row that was read with [`ROW_COLUMNS`].
pub(super) fn stored_row(row: &rusqlite::Row<'_>) -> Result<StoredRow, rusqlite::Error> {
    let mut values = [None; Channel::COUNT];
    for (index, value) in values.iter_mut().enumerate() {
        *value = row.get(5 + index)?;
    }
    Ok(StoredRow {
        seq: row.get(0)?,
        segment_id: row.get(1)?,
        device_time_ns: row.get(2)?,
        host_mono_ns: row.get(3)?,
        host_utc_ns: row.get(4)?,
        values,
        sync_count: row.get(5 + Channel::COUNT)?,
    })
}

/// Returns the rows of a batch that are present, and their checksum.
fn run_of(connection: &Connection, batch: &BatchRow) -> Result<Run, rusqlite::Error> {
    let sql = format!("SELECT {ROW_COLUMNS} FROM sample WHERE capture_id = ?1 AND seq >= ?2 AND seq < ?3 ORDER BY seq");
    let mut statement = connection.prepare_cached(&sql)?;
    let mut rows = statement.query(params![batch.capture_id, batch.first_seq, batch.first_seq + batch.count])?;
    let mut run = Run::new(batch.first_seq);
    while let Some(row) = rows.next()? {
        run.push(&stored_row(row)?);
    }
    Ok(run)
}

/// Returns whether all rows of the batch are present with the values that were committed.
pub(super) fn is_intact(connection: &Connection, batch: &BatchRow) -> Result<bool, rusqlite::Error> {
    let run = run_of(connection, batch)?;
    Ok(run.count == batch.count && run.crc() == batch.crc)
}

/// Computes a new checksum for batches whose rows were changed on purpose. A batch that was damaged before stays
/// damaged.
pub(super) fn renew(connection: &Connection, batches: &[BatchRow]) -> Result<(), StoreError> {
    let mut update = connection.prepare_cached("UPDATE batch SET crc = ?3 WHERE capture_id = ?1 AND first_seq = ?2")?;
    for batch in batches {
        let run = run_of(connection, batch)?;
        update.execute(params![batch.capture_id, batch.first_seq, i64::from(run.crc())])?;
    }
    Ok(())
}

/// Returns a row of `SELECT capture_id, first_seq, count, crc`.
pub(super) fn batch_row(row: &rusqlite::Row<'_>) -> Result<BatchRow, rusqlite::Error> {
    Ok(BatchRow {
        capture_id: row.get(0)?,
        first_seq: row.get(1)?,
        count: row.get(2)?,
        crc: row.get::<_, i64>(3)? as u32,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Programs that check a database by other means rely on this layout (docs/data-model.md).
    #[test]
    fn a_row_has_the_bytes_that_the_documentation_states() {
        let mut row = StoredRow { seq: 1, segment_id: 2, host_mono_ns: 3, host_utc_ns: 4, ..StoredRow::default() };
        row.values[0] = Some(-0.0);
        row.values[13] = Some(1.5);
        row.sync_count = Some(5);
        let bytes = row.bytes();
        assert_eq!(bytes[..4], (1_u32 | 1 << 13 | 1 << 15).to_le_bytes());
        assert_eq!(bytes[4..12], 1_i64.to_le_bytes());
        assert_eq!(bytes[44..52], 5_i64.to_le_bytes());
        assert_eq!(bytes[52..60], [0; 8]);
        assert_eq!(bytes[156..164], 1.5_f64.to_le_bytes());
        let mut run = Run::new(1);
        run.push(&row);
        assert_eq!((run.next_seq(), run.crc()), (2, crc32fast::hash(&bytes)));
        // The check value of the standard: the polynomial is the documented one.
        assert_eq!(crc32fast::hash(b"123456789"), 0xCBF4_3926);
    }
}
