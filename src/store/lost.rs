//! Lost files: handles the deletion or replacement of the database's file while it is open.
//!
//! Data written to a deleted file cannot be found again. So the file at the path is compared with the open one from
//! time to time ([`FileId`](super::file_id::FileId)). If they differ, the file at the path (or a new file) receives the
//! data from then on. The running capture continues in it under its name, numbered from 0, with its remaining duration
//! and an event that reports the loss. Nothing that was not committed is lost.

use super::captures::known;
use super::insert::Inserted;
use super::names::numbered;
use super::sql::{find, list, value};
use super::{SOFTWARE, StoreError};
use imu_core::sample::{Channel, EventKind, Gap, Record, Segment};
use rusqlite::{Connection, params};
use std::collections::BTreeMap;

/// A capture of the lost file that continues.
#[derive(Debug, Clone)]
struct Seed {
    id: i64,
    name: String,
    source: String,
    state: String,
    start_at: Option<i64>,
    planned: Option<i64>,
    held: i64,
    samples: i64,
    sensor: Option<String>,
    configuration: Option<String>,
    note: Option<String>,
    segment: Option<Segment>,
}

/// The numbering of a capture's records in the new file.
#[derive(Debug, Clone, Default)]
struct Moved {
    to: i64,
    /// Samples that were acknowledged in earlier, lost files.
    base: u64,
    seq: Option<u64>,
    segments: u32,
    segment: Option<Segment>,
}

/// The record of the lost files, and of the captures that continue.
#[derive(Debug, Default)]
pub(super) struct Lost {
    seeds: Vec<Seed>,
    moved: BTreeMap<i64, Moved>,
}

impl Lost {
    /// Records the running captures, from a file that is still open. If the file cannot be read, the earlier record
    /// stays.
    pub(super) fn note(&mut self, connection: &Connection) {
        match seeds(connection) {
            Ok(seeds) => self.seeds = seeds,
            Err(error) => tracing::warn!(message = "The captures that run cannot be read any more.", %error),
        }
    }

    /// Creates the captures in the new file; returns the ids of those that could not keep their ids.
    pub(super) fn settle(
        &mut self,
        connection: &mut Connection,
        utc_ns: i64,
    ) -> Result<BTreeMap<i64, i64>, StoreError> {
        let transaction = connection.transaction()?;
        let mut moved = BTreeMap::new();
        for seed in &self.seeds {
            // The task knows a capture by its first id, however often the file was lost.
            let known = self.moved.iter().find(|(_, moved)| moved.to == seed.id).map_or(seed.id, |(id, _)| *id);
            let base = self.moved.get(&known).map_or(0, |moved| moved.base) + seed.samples as u64;
            let to = seed.create(&transaction, utc_ns)?;
            moved.insert(known, Moved { to, base, segment: seed.segment.clone(), ..Moved::default() });
        }
        transaction.commit()?;
        self.moved = moved;
        // The captures are created: the next lost file has its own.
        self.note(connection);
        Ok(self.moved.iter().filter(|(id, moved)| **id != moved.to).map(|(id, moved)| (*id, moved.to)).collect())
    }

    /// Returns the records as the new file numbers them; borrowed if no file was lost.
    pub(super) fn translated<'a>(&mut self, batch: &'a [(i64, Record)]) -> std::borrow::Cow<'a, [(i64, Record)]> {
        if self.moved.is_empty() {
            return std::borrow::Cow::Borrowed(batch);
        }
        let mut records = Vec::with_capacity(batch.len() + 1);
        for (id, record) in batch {
            match self.moved.get_mut(id) {
                Some(moved) => moved.translate(record, &mut records),
                None => records.push((*id, record.clone())),
            }
        }
        std::borrow::Cow::Owned(records)
    }

    /// Returns the inserted records by the ids that the task knows. Samples acknowledged in lost files are included.
    pub(super) fn named(&self, mut inserted: Inserted) -> Inserted {
        for (id, moved) in &self.moved {
            if let Some(samples) = inserted.committed.remove(&moved.to) {
                inserted.committed.insert(*id, samples + moved.base);
            }
        }
        inserted
    }

    /// Returns the number of samples acknowledged so far in lost files.
    pub(super) fn acknowledged(&self) -> BTreeMap<i64, u64> {
        self.moved.iter().map(|(id, moved)| (*id, moved.base)).collect()
    }
}

impl Moved {
    fn translate(&mut self, record: &Record, records: &mut Vec<(i64, Record)>) {
        let to = self.to;
        let record = match record {
            Record::Sample { seq, segment, sample } => {
                if self.seq.is_none() {
                    self.seq = Some(*seq);
                    self.segments = segment.saturating_sub(1);
                }
                let base = self.seq.unwrap_or(0);
                // In the middle of a segment: it continues as the new file's first.
                if *seq == base
                    && let Some(segment) = &self.segment
                {
                    records.push((
                        to,
                        Record::Segment(Segment {
                            number: 1,
                            first_seq: 0,
                            first_device_time_ns: sample.device_time_ns,
                            first_utc_ns: sample.host_utc_ns,
                            ..segment.clone()
                        }),
                    ));
                }
                let seq = seq.saturating_sub(base);
                Record::Sample { seq, segment: segment.saturating_sub(self.segments), sample: sample.clone() }
            }
            Record::Segment(segment) => {
                if self.seq.is_none() {
                    self.seq = Some(segment.first_seq);
                    self.segments = segment.number.saturating_sub(1);
                    self.segment = None;
                }
                Record::Segment(Segment {
                    number: segment.number.saturating_sub(self.segments),
                    first_seq: segment.first_seq.saturating_sub(self.seq.unwrap_or(0)),
                    ..segment.clone()
                })
            }
            Record::Gap(gap) => {
                let before_seq = gap.before_seq.saturating_sub(self.seq.unwrap_or(gap.before_seq));
                Record::Gap(Gap { before_seq, ..gap.clone() })
            }
            Record::UtcSet { by_ns, before_utc_ns, boot_id, since_seq } => {
                let since_seq = since_seq.map(|since| since.saturating_sub(self.seq.unwrap_or(since)));
                Record::UtcSet { by_ns: *by_ns, before_utc_ns: *before_utc_ns, boot_id: boot_id.clone(), since_seq }
            }
            other => other.clone(),
        };
        records.push((to, record));
    }
}

impl Seed {
    fn create(&self, connection: &Connection, utc_ns: i64) -> Result<i64, StoreError> {
        let taken = "SELECT EXISTS (SELECT 1 FROM capture WHERE id = ?1)";
        let taken: bool = value(connection, taken, [self.id])?;
        let name = numbered(connection, &self.name)?;
        let sql = "INSERT INTO capture (id, name, source, state, created_utc_ns, start_at_utc_ns, planned_duration_ns, sensor, \
                   configuration, software, note) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11)";
        let values = params![
            (!taken).then_some(self.id),
            name,
            self.source,
            self.state,
            utc_ns,
            self.start_at,
            self.planned.map(|planned| (planned - self.held).max(1)),
            self.sensor,
            self.configuration,
            SOFTWARE,
            self.note,
        ];
        connection.execute(sql, values)?;
        let id = connection.last_insert_rowid();
        let message = format!(
            "the database file was deleted or replaced: {} earlier samples of this capture were in it",
            self.samples
        );
        let sql = "INSERT INTO event (capture_id, utc_ns, kind, message) VALUES (?1, ?2, ?3, ?4)";
        connection.execute(sql, params![id, utc_ns, EventKind::Warning.name(), message])?;
        Ok(id)
    }
}

fn seeds(connection: &Connection) -> Result<Vec<Seed>, StoreError> {
    let sql = "SELECT id, name, source, state, start_at_utc_ns, planned_duration_ns, sample_time_ns, samples, sensor, \
               configuration, note FROM capture WHERE state IN ('waiting', 'capturing') AND lifecycle = 'live'";
    let mut found = list(connection, sql, [], |row| {
        Ok(Seed {
            id: row.get(0)?,
            name: row.get(1)?,
            source: row.get(2)?,
            state: row.get(3)?,
            start_at: row.get(4)?,
            planned: row.get(5)?,
            held: row.get(6)?,
            samples: row.get(7)?,
            sensor: row.get(8)?,
            configuration: row.get(9)?,
            note: row.get(10)?,
            segment: None,
        })
    })?;
    for seed in &mut found {
        seed.segment = last_segment(connection, seed.id)?;
    }
    Ok(found)
}

fn last_segment(connection: &Connection, id: i64) -> Result<Option<Segment>, StoreError> {
    let sql = "SELECT rate_hz, timebase, channels, epoch, boot_id FROM segment WHERE capture_id = ?1 ORDER BY segment_id DESC LIMIT 1";
    let row = find(connection, sql, [id], |row| {
        Ok((row.get::<_, f64>(0)?, row.get::<_, String>(1)?, row.get::<_, String>(2)?, row.get(3)?, row.get(4)?))
    })?;
    let Some((rate_hz, timebase, channels, epoch, boot_id)) = row else { return Ok(None) };
    let names: Vec<String> = serde_json::from_str(&channels)?;
    Ok(Some(Segment {
        number: 1,
        epoch,
        first_seq: 0,
        rate_hz,
        timebase: known("segment.timebase", timebase)?,
        channels: names.iter().filter_map(|name| Channel::from_name(name)).collect(),
        first_device_time_ns: None,
        first_utc_ns: 0,
        boot_id,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::sample;

    #[test]
    fn where_the_clock_was_set_back_is_numbered_as_the_new_file_numbers_samples() {
        let set = |since| Record::UtcSet { by_ns: 1, before_utc_ns: 2, boot_id: None, since_seq: Some(since) };
        let mut moved = Moved { to: 7, ..Moved::default() };
        let mut records = Vec::new();
        for record in [set(90), sample(1, 100), set(90), set(130)] {
            moved.translate(&record, &mut records);
        }
        let sets: Vec<Record> =
            records.into_iter().map(|(_, record)| record).filter(|one| matches!(one, Record::UtcSet { .. })).collect();
        assert_eq!(sets, [set(0), set(0), set(30)], "0: the whole of what this file has of the boot");
    }
}
