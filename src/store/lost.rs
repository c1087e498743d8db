//! Lost: what happens when the database's file is deleted or replaced while it is open.
//!
//! The open file takes data that nobody will find again. So the path's file is compared with the open one now and then;
//! where they differ, what stands there (or a new file) takes what comes: the running capture goes on in it under its name,
//! numbered from 0, with its remaining duration and an event that says so. Nothing that was not committed is lost.
//!
//! While the connection is closed (after an I/O error) nothing holds the file: another one may then have its number, and the
//! same one another device and, on vfat and exfat, another number. So before it is opened again the database's own identity is
//! compared, in the file alone: beside another file the log that was left would destroy it.
//!
//! What takes the place may still be on its way there (`cp`): it is left alone while it changes, and what is refused as
//! damaged is looked at again ([`FileId::judged`]).

use super::captures::name_is_free;
use super::insert::{Inserted, timebase_from_name};
use super::{SOFTWARE, StoreError, schema};
use crate::sample::{Channel, EventKind, Gap, Record, Segment};
use rusqlite::{Connection, OpenFlags, OptionalExtension, params};
use std::collections::BTreeMap;
use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

type Id = (u64, u64);

/// Which file this process writes under a path. For the whole process, because SQLite's own bookkeeping is: a reader that
/// opened a file which has just taken the place of the written one would take the written one's log for its.
static WRITTEN: Mutex<BTreeMap<PathBuf, Id>> = Mutex::new(BTreeMap::new());

pub(super) fn written() -> MutexGuard<'static, BTreeMap<PathBuf, Id>> {
    WRITTEN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// To be asked between opening a connection, which opens the file, and its first read, which opens the log.
pub(super) fn refuse_replaced(path: &Path) -> Result<(), StoreError> {
    match written().get(path) {
        Some(id) if id_of(path) != Some(*id) => Err(StoreError::Lost {
            path: path.to_owned(),
            detail: "it is read again once another file takes its place",
        }),
        _ => Ok(()),
    }
}

fn id_of(path: &Path) -> Option<Id> {
    std::fs::metadata(path).ok().map(|file| (file.dev(), file.ino()))
}

/// What tells one log from the next in the same file: its header, with the salt.
const LOG_HEADER: usize = 32;

fn log_header(path: &Path) -> Option<[u8; LOG_HEADER]> {
    let mut header = [0; LOG_HEADER];
    std::fs::File::open(schema::wal_path(path)).ok()?.read_exact(&mut header).ok()?;
    Some(header)
}

/// Which files are open: the database, its log, its shared memory.
#[derive(Debug, Clone)]
pub(super) struct FileId {
    database: Option<Id>,
    remains: Vec<(PathBuf, Id)>,
    /// The log that stayed when the connection was closed after an error.
    log: Option<[u8; LOG_HEADER]>,
    /// The last batch that stood in the file itself then: what has fewer is an older copy, which that log would destroy.
    copied: i64,
    /// The path named another file, or none, while this one was still held.
    let_go: bool,
    /// What stood in its place when that was last looked at, and how often it was refused since it last changed.
    newcomer: Option<Stamp>,
    refusals: u32,
}

/// What changes while a file is written.
type Stamp = (u64, i64, i64);

fn stamp(path: &Path) -> Option<Stamp> {
    std::fs::metadata(path).ok().map(|file| (file.len(), file.mtime(), file.mtime_nsec()))
}

/// A file in a lost one's place that seems damaged is refused for good at this attempt: about a second lies between two, and
/// the queue holds half a minute.
const REFUSALS: u32 = 30;

/// What a file says of itself, its log left aside.
#[derive(Debug, PartialEq, Eq)]
enum Says {
    /// It is the database of this identity, with so many batches.
    Identity(String, i64),
    /// It is one of ours; who it is stands in its log.
    Ours,
    /// It is damaged or cannot be read now.
    Nothing,
    /// It is something else.
    Foreign,
}

fn says(path: &Path) -> Says {
    let uri = format!("file:{}?immutable=1", schema::uri_escaped(path));
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_URI;
    let Ok(connection) = Connection::open_with_flags(uri, flags) else { return Says::Nothing };
    match schema::refuse_foreign(&connection, path) {
        Ok(()) => {}
        // No database at all may be a damaged one.
        Err(StoreError::Foreign { found, .. }) if found != 0 => return Says::Foreign,
        Err(_) => return Says::Nothing,
    }
    let read = |row: &rusqlite::Row<'_>| Ok(Says::Identity(row.get(0)?, row.get(1)?));
    match connection.query_row("SELECT identity, batch FROM writer", [], read) {
        Ok(identity) => identity,
        Err(error) if schema::says_damaged(&error) => Says::Nothing,
        Err(_) => Says::Ours,
    }
}

impl FileId {
    pub(super) fn of(path: &Path) -> Self {
        Self {
            database: id_of(path),
            remains: Vec::new(),
            log: None,
            copied: 0,
            let_go: false,
            newcomer: None,
            refusals: 0,
        }
    }

    /// The file that this process writes from now on.
    pub(super) fn written(path: &Path) -> Self {
        let file = Self::of(path);
        match file.database {
            Some(id) => written().insert(path.to_owned(), id),
            None => written().remove(path),
        };
        file
    }

    /// Nothing is written any more.
    pub(super) fn forget(path: &Path) {
        written().remove(path);
    }

    /// Whether the path names another file, or none.
    pub(super) fn is_lost(&self, path: &Path) -> bool {
        match std::fs::metadata(path) {
            Ok(file) => Some((file.dev(), file.ino())) != self.database,
            Err(error) => error.kind() == std::io::ErrorKind::NotFound,
        }
    }

    /// As [`Self::is_lost`] where no connection holds the file.
    pub(super) fn is_replaced(&self, path: &Path, identity: &str) -> bool {
        let file = match std::fs::metadata(path) {
            Ok(file) => file,
            Err(error) => return error.kind() == std::io::ErrorKind::NotFound,
        };
        // A device may come back under another number, and so may a file of one that has no numbers of its own.
        let same_number = self.database.is_some_and(|(_, number)| number == file.ino());
        if file.len() == 0 || self.let_go && !same_number {
            return true;
        }
        match says(path) {
            Says::Identity(found, batch) => found != identity || batch < self.copied,
            Says::Foreign => true,
            // The number of a file that was let go may be given to the next one.
            Says::Ours | Says::Nothing => self.let_go || !same_number,
        }
    }

    /// Notes what stands in the lost file's place now.
    pub(super) fn look(&mut self, path: &Path) {
        self.newcomer = stamp(path);
    }

    /// Opens what stands in the lost file's place. None where it changes still: it may be a copy on its way. What seems
    /// damaged is refused only at the last of [`REFUSALS`] attempts that find it unchanged.
    pub(super) fn judged<T>(
        &mut self,
        path: &Path,
        open: impl FnOnce(&mut Self) -> Result<T, StoreError>,
    ) -> Result<Option<T>, StoreError> {
        let before = stamp(path);
        if before != std::mem::replace(&mut self.newcomer, before) {
            self.refusals = 0;
            return Ok(None);
        }
        match open(self) {
            Ok(opened) => Ok(Some(opened)),
            Err(error) if error.is_damage() => {
                self.refusals += 1;
                tracing::warn!(message = "What took the lost file's place cannot be used.", %error, self.refusals);
                if self.refusals < REFUSALS { Ok(None) } else { Err(error) }
            }
            Err(error) => {
                // The attempt itself may have changed it.
                self.look(path);
                Err(error)
            }
        }
    }

    /// The path names another database after all.
    pub(super) fn set_lost(&mut self) {
        (self.database, self.let_go) = (None, true);
    }

    /// Closes the connection after an error, and notes what it leaves beside the file.
    pub(super) fn close(&mut self, path: &Path, connection: Connection) {
        // Before it is closed: a copy of the log that fails on the way may have reached no more than the system's memory.
        self.copied = match says(path) {
            Says::Identity(_, batch) => batch,
            _ => 0,
        };
        drop(connection);
        self.log = log_header(path);
        self.remains =
            [schema::shm_path(path)].into_iter().filter_map(|path| id_of(&path).map(|id| (path, id))).collect();
    }

    /// Closes the connection to the lost file, complete for whoever has it under another name, and notes which log and
    /// shared memory belonged to it.
    pub(super) fn let_go(&mut self, path: &Path, connection: Connection) {
        let beside = [schema::wal_path(path), schema::shm_path(path)];
        self.remains = beside.into_iter().filter_map(|path| id_of(&path).map(|id| (path, id))).collect();
        let copied = connection.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(()));
        if let Err(error) = copied {
            tracing::warn!(message = "The lost file could not be completed.", %error);
        }
        if let Err((_, error)) = connection.close() {
            tracing::warn!(message = "The lost file could not be closed.", %error);
        }
        (self.log, self.let_go) = (None, true);
        if let Err(error) = self.clear_remains(path) {
            tracing::warn!(message = "What a lost file left cannot be removed.", %error);
        }
    }

    /// Takes log and shared memory of the lost file away: with another file they would destroy it. A log that may hold
    /// what the lost file lacks is kept under another name.
    pub(super) fn clear_remains(&mut self, path: &Path) -> Result<(), StoreError> {
        if let Some(header) = self.log
            && log_header(path) == Some(header)
        {
            // A file that cannot be read now may be the very one that the log belongs to.
            if std::fs::metadata(path).is_ok_and(|file| file.len() > 0) && says(path) == Says::Nothing {
                let report = "it cannot be read beside the log that was left".to_owned();
                return Err(StoreError::RefusedDamaged { path: path.to_owned(), report });
            }
            let (log, aside) = (schema::wal_path(path), kept_log(path));
            std::fs::rename(&log, &aside).map_err(|source| StoreError::Create { path: aside.clone(), source })?;
            tracing::warn!(
                message = "The lost file's log is kept: beside that file, under its name and `-wal`, it completes it.",
                path = %aside.display()
            );
        }
        self.log = None;
        for (remains, id) in std::mem::take(&mut self.remains) {
            if id_of(&remains) == Some(id)
                && let Err(error) = std::fs::remove_file(&remains)
            {
                tracing::warn!(message = "What a lost file left cannot be removed.", path = %remains.display(), %error);
            }
        }
        Ok(())
    }
}

/// A name beside the database that nothing has.
fn kept_log(path: &Path) -> PathBuf {
    let numbered = |number: u32| {
        let mut name = path.as_os_str().to_owned();
        name.push(format!(".lost-{number}-wal"));
        PathBuf::from(name)
    };
    (1..).map(numbered).find(|name| !name.exists()).unwrap_or_else(|| numbered(0))
}

/// A capture of the lost file that goes on.
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
    segment: Option<Segment>,
}

/// How a capture's records are numbered in the new file.
#[derive(Debug, Clone, Default)]
struct Moved {
    to: i64,
    /// Samples that were acknowledged in files that are gone.
    base: u64,
    seq: Option<u64>,
    segments: u32,
    segment: Option<Segment>,
}

/// What was lost, and where it goes on.
#[derive(Debug, Default)]
pub(super) struct Lost {
    seeds: Vec<Seed>,
    moved: BTreeMap<i64, Moved>,
}

impl Lost {
    /// Notes the captures that run, from a file that is still open. What was noted before stands where it cannot be read.
    pub(super) fn note(&mut self, connection: &Connection) {
        match seeds(connection) {
            Ok(seeds) => self.seeds = seeds,
            Err(error) => tracing::warn!(message = "The captures that run cannot be read any more.", %error),
        }
    }

    /// Makes the captures in the new file; answers the ids of those that could not keep theirs.
    pub(super) fn settle(
        &mut self,
        connection: &mut Connection,
        utc_ns: i64,
    ) -> Result<BTreeMap<i64, i64>, StoreError> {
        let transaction = connection.transaction()?;
        let mut moved = BTreeMap::new();
        for seed in &self.seeds {
            // The task knows a capture by its first id, however often its file was lost.
            let known = self.moved.iter().find(|(_, moved)| moved.to == seed.id).map_or(seed.id, |(id, _)| *id);
            let base = self.moved.get(&known).map_or(0, |moved| moved.base) + seed.samples as u64;
            let to = seed.create(&transaction, utc_ns)?;
            moved.insert(known, Moved { to, base, segment: seed.segment.clone(), ..Moved::default() });
        }
        transaction.commit()?;
        self.moved = moved;
        // They are made: a file that is lost next has its own.
        self.note(connection);
        Ok(self.moved.iter().filter(|(id, moved)| **id != moved.to).map(|(id, moved)| (*id, moved.to)).collect())
    }

    /// The records as the new file numbers them; borrowed where nothing was lost.
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

    /// What was inserted, by the ids that the task knows; acknowledged is also what files had that are gone.
    pub(super) fn named(&self, mut inserted: Inserted) -> Inserted {
        for (id, moved) in &self.moved {
            if let Some(samples) = inserted.committed.remove(&moved.to) {
                inserted.committed.insert(*id, samples + moved.base);
            }
        }
        inserted
    }

    /// What was acknowledged so far, in files that are gone.
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
                // In the middle of a segment: it goes on as the new file's first.
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
        let taken: bool = connection.query_row(taken, [self.id], |row| row.get(0))?;
        let mut name = self.name.clone();
        let mut number = 2;
        while !name_is_free(connection, &name)? {
            name = format!("{}-{number}", self.name);
            number += 1;
        }
        connection.execute(
            "INSERT INTO capture (id, name, source, state, created_utc_ns, start_at_utc_ns, planned_duration_ns, sensor, \
             configuration, software) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)",
            params![
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
            ],
        )?;
        let id = connection.last_insert_rowid();
        let message = format!(
            "the database file was deleted or replaced: {} earlier samples of this capture were in it",
            self.samples
        );
        connection.execute(
            "INSERT INTO event (capture_id, utc_ns, kind, message) VALUES (?1, ?2, ?3, ?4)",
            params![id, utc_ns, EventKind::Warning.name(), message],
        )?;
        Ok(id)
    }
}

fn seeds(connection: &Connection) -> Result<Vec<Seed>, StoreError> {
    let mut statement = connection.prepare(
        "SELECT id, name, source, state, start_at_utc_ns, planned_duration_ns, sample_time_ns, samples, sensor, \
         configuration FROM capture WHERE state IN ('waiting', 'capturing') AND lifecycle = 'live'",
    )?;
    let found: Result<Vec<Seed>, rusqlite::Error> = statement
        .query_map([], |row| {
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
                segment: None,
            })
        })?
        .collect();
    let mut found = found?;
    for seed in &mut found {
        seed.segment = last_segment(connection, seed.id)?;
    }
    Ok(found)
}

fn last_segment(connection: &Connection, id: i64) -> Result<Option<Segment>, StoreError> {
    let sql = "SELECT rate_hz, timebase, channels, epoch, boot_id FROM segment WHERE capture_id = ?1 ORDER BY segment_id DESC LIMIT 1";
    let row = connection
        .query_row(sql, [id], |row| {
            Ok((row.get::<_, f64>(0)?, row.get::<_, String>(1)?, row.get::<_, String>(2)?, row.get(3)?, row.get(4)?))
        })
        .optional()?;
    let Some((rate_hz, timebase, channels, epoch, boot_id)) = row else { return Ok(None) };
    let names: Vec<String> = serde_json::from_str(&channels)?;
    Ok(Some(Segment {
        number: 1,
        epoch,
        first_seq: 0,
        rate_hz,
        timebase: timebase_from_name(&timebase)
            .ok_or(StoreError::Unknown { column: "segment.timebase", found: timebase })?,
        channels: names.iter().filter_map(|name| Channel::from_name(name)).collect(),
        first_device_time_ns: None,
        first_utc_ns: 0,
        boot_id,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::StorageState;
    use crate::store::tests::{World, bare_writer, sample, segment};
    use crate::store::{
        CaptureFilter, CaptureState, NewCapture, PageRequest, Reader, Store, StoreOptions, check, progress,
    };
    use std::time::Duration;

    fn samples(id: i64, range: std::ops::Range<u64>) -> impl Iterator<Item = (i64, Record)> {
        range.map(move |seq| (id, sample(1, seq)))
    }

    /// A capture `night` of an hour with 100 samples, closed.
    fn night(world: &World) -> (PathBuf, i64) {
        let planned = Some(Duration::from_secs(3600));
        let new = NewCapture::new("pty", CaptureState::Capturing);
        let id = world.store.create_capture(NewCapture { name: Some("night".to_owned()), planned, ..new }).unwrap();
        world.send(id, [segment(1, 0)]);
        world.send(id, samples(id, 0..100).map(|(_, record)| record));
        world.store.close().unwrap();
        (world.store.path().to_owned(), id)
    }

    /// Another database with captures of its own.
    fn other(world: &World) -> PathBuf {
        let path = world.directory.path().join("other.db");
        let store = Store::open(&path, StoreOptions::default()).unwrap();
        for number in 1..=3 {
            let new = NewCapture::new("pty", CaptureState::Complete);
            let name = Some(format!("other {number}"));
            let id = store.create_capture(NewCapture { name, ..new }).unwrap();
            store.records().blocking_send(id, segment(1, 0)).unwrap();
            for (id, record) in samples(id, 0..1000) {
                store.records().blocking_send(id, record).unwrap();
            }
        }
        store.close().unwrap();
        path
    }

    /// Names and samples of what is in a database that is whole.
    fn content(path: &Path) -> Vec<(String, u64)> {
        assert_eq!(check(path).unwrap().findings, []);
        let reader = Reader::open(path).unwrap();
        let page = reader.captures(&CaptureFilter::default(), &PageRequest::default()).unwrap();
        page.rows.into_iter().map(|row| (row.name, row.samples)).collect()
    }

    fn others() -> Vec<(String, u64)> {
        (1..=3).rev().map(|number| (format!("other {number}"), 1000)).collect()
    }

    #[test]
    fn a_file_replaced_while_it_is_closed_takes_the_captures_and_never_the_old_log() {
        let world = World::new();
        let (path, id) = night(&world);
        let other = other(&world);
        // Whoever reads the old file keeps its log from being emptied.
        let reader = Reader::open(&path).unwrap();
        assert_eq!(reader.capture(id).unwrap().samples, 100);
        let (mut writer, progress) = bare_writer(&path, &world.directory.path().join("lock"));
        assert_eq!(writer.write_now(samples(id, 100..150)), 0);
        writer.pretend_io_error();
        assert!(log_header(&path).is_some(), "the log is there");
        let moved = world.directory.path().join("moved.db");
        std::fs::rename(&path, &moved).unwrap();
        std::fs::copy(&other, &path).unwrap();
        assert_eq!(writer.write_now(samples(id, 150..160)), 1, "first it is said");
        let seen = progress::locked(&progress).clone();
        assert_eq!((seen.committed[&id], seen.moved[&id]), (160, 4));
        let mut expected = others();
        expected.insert(0, ("night".to_owned(), 10));
        assert_eq!(content(&path), expected);
        let row = Reader::open(&path).unwrap().capture(4).unwrap();
        assert_eq!(row.state, CaptureState::Capturing);
        let planned = row.planned_duration_s.unwrap();
        assert!((planned - (3600.0 - 150.0 / 40.0)).abs() < 1e-6, "{planned} s are left");
        drop(reader);
        // What the old file lacks is in the log that was kept.
        let mut kept = path.as_os_str().to_owned();
        kept.push(".lost-1-wal");
        std::fs::rename(PathBuf::from(kept), schema::wal_path(&moved)).unwrap();
        assert_eq!(content(&moved), [("night".to_owned(), 150)]);
        // Lost again: each capture goes on once.
        writer.pretend_io_error();
        std::fs::remove_file(&path).unwrap();
        writer.write_now(samples(id, 160..165));
        assert_eq!(content(&path), [("night".to_owned(), 5)]);
        assert_eq!(progress::locked(&progress).committed[&id], 165);
    }

    #[test]
    fn another_database_in_a_file_of_the_same_number_is_another() {
        let world = World::new();
        let (path, id) = night(&world);
        let other = other(&world);
        let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
        writer.pretend_io_error();
        let number = id_of(&path);
        std::fs::write(&path, std::fs::read(other).unwrap()).unwrap();
        assert_eq!(id_of(&path), number);
        writer.write_now(samples(id, 100..110));
        let mut expected = others();
        expected.insert(0, ("night".to_owned(), 10));
        assert_eq!(content(&path), expected);
    }

    #[test]
    fn the_same_database_on_a_device_of_another_number_goes_on() {
        let world = World::new();
        let (path, id) = night(&world);
        let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
        let identity = super::super::writer::identity_of(&Reader::open(&path).unwrap().connection).unwrap();
        let (device, number) = id_of(&path).unwrap();
        let mut file = FileId::of(&path);
        file.database = Some((device + 1, number));
        assert!(!file.is_replaced(&path, &identity) && file.is_replaced(&path, "another"));
        file.database = Some((device, number + 1));
        assert!(!file.is_replaced(&path, &identity), "vfat numbers its files anew at each mount");
        file.copied = i64::MAX;
        assert!(file.is_replaced(&path, &identity), "an older copy is not the file that was written");
        (file.copied, file.let_go) = (0, true);
        assert!(file.is_replaced(&path, &identity), "the path named another file while this one was held");
        writer.pretend_io_error();
        assert_eq!(writer.write_now(samples(id, 100..110)), 0);
        assert_eq!(content(&path), [("night".to_owned(), 110)]);
    }

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

    /// The path's file again, under another number.
    fn renumber(path: &Path, content: &[u8]) {
        let (beside, number) = (path.with_extension("beside"), id_of(path));
        std::fs::write(&beside, content).unwrap();
        std::fs::rename(&beside, path).unwrap();
        assert_ne!(id_of(path), number);
    }

    #[test]
    fn the_same_database_under_another_number_keeps_its_own_log() {
        let world = World::new();
        let (path, id) = night(&world);
        let reader = Reader::open(&path).unwrap();
        assert_eq!(reader.capture(id).unwrap().samples, 100);
        let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
        assert_eq!(writer.write_now(samples(id, 100..150)), 0);
        writer.pretend_io_error();
        assert!(log_header(&path).is_some(), "the log is there");
        drop(reader.connection);
        renumber(&path, &std::fs::read(&path).unwrap());
        assert_eq!(writer.write_now(samples(id, 150..160)), 0);
        assert_eq!(content(&path), [("night".to_owned(), 160)]);
        assert!(!kept_log(&path).to_string_lossy().contains(".lost-2"), "no log was moved aside");
    }

    #[test]
    fn an_older_copy_of_the_same_database_never_takes_the_newer_log() {
        let world = World::new();
        let (path, id) = night(&world);
        let older = std::fs::read(&path).unwrap();
        let reader = Reader::open(&path).unwrap();
        assert_eq!(reader.capture(id).unwrap().samples, 100);
        let (mut writer, _) = bare_writer(&path, &world.directory.path().join("lock"));
        assert_eq!(writer.write_now(samples(id, 100..150)), 0);
        // What the log held goes into the file; it begins anew with what comes.
        let copied = schema::reopen(&path).unwrap();
        copied.query_row("PRAGMA wal_checkpoint(PASSIVE)", [], |_| Ok(())).unwrap();
        assert_eq!(writer.write_now(samples(id, 150..160)), 0);
        drop(copied);
        writer.pretend_io_error();
        assert!(log_header(&path).is_some(), "the log is there");
        renumber(&path, &older);
        assert_eq!(writer.write_now(samples(id, 160..170)), 1);
        assert_eq!(content(&path), [("night-2".to_owned(), 10), ("night".to_owned(), 100)]);
        assert!(kept_log(&path).to_string_lossy().contains(".lost-2"), "the log was kept");
    }

    #[test]
    fn a_copy_that_is_still_on_its_way_is_waited_for() {
        let world = World::new();
        let (path, id) = night(&world);
        let whole = std::fs::read(other(&world)).unwrap();
        let (mut writer, progress) = bare_writer(&path, &world.directory.path().join("lock"));
        writer.pretend_io_error();
        renumber(&path, &whole[..4096]);
        assert_eq!(writer.attempt(), StorageState::StorageLost);
        for part in 2..=10 {
            assert_eq!(writer.attempt(), StorageState::StorageLost, "{part}: {:?}", progress::locked(&progress));
            // The copy stands still for a while now and then.
            if part % 3 != 0 {
                std::fs::write(&path, &whole[..4096 * part]).unwrap();
            }
        }
        std::fs::write(&path, &whole).unwrap();
        assert_eq!(writer.attempt(), StorageState::StorageLost, "it has just changed");
        assert_eq!(writer.write_now(samples(id, 100..110)), 0);
        let mut expected = others();
        expected.insert(0, ("night".to_owned(), 10));
        assert_eq!(content(&path), expected);
    }

    #[test]
    fn half_a_file_that_stays_as_it_is_is_refused_in_the_end_and_the_log_stays() {
        let world = World::new();
        let (path, id) = night(&world);
        let whole = std::fs::read(other(&world)).unwrap();
        let reader = Reader::open(&path).unwrap();
        assert_eq!(reader.capture(id).unwrap().samples, 100);
        let (mut writer, progress) = bare_writer(&path, &world.directory.path().join("lock"));
        assert_eq!(writer.write_now(samples(id, 100..110)), 0);
        writer.pretend_io_error();
        let log = std::fs::read(schema::wal_path(&path)).unwrap();
        let garbage = vec![7; whole.len() / 2];
        renumber(&path, &garbage);
        for _ in 0..REFUSALS {
            assert_eq!(writer.attempt(), StorageState::StorageLost);
        }
        assert_eq!(writer.attempt(), StorageState::StorageError);
        let seen = progress::locked(&progress).clone();
        assert!(seen.damaged && seen.error.as_ref().is_some_and(|said| said.contains("damaged")), "{seen:?}");
        assert!(std::fs::read(&path).unwrap() == garbage);
        assert!(std::fs::read(schema::wal_path(&path)).unwrap() == log, "it may be that file's own");
    }

    #[test]
    fn a_log_that_is_taken_away_while_it_is_closed_ends_the_writing() {
        let world = World::new();
        let (path, id) = night(&world);
        let reader = Reader::open(&path).unwrap();
        assert_eq!(reader.capture(id).unwrap().samples, 100);
        let (mut writer, progress) = bare_writer(&path, &world.directory.path().join("lock"));
        writer.write_now(samples(id, 100..150));
        writer.pretend_io_error();
        drop(reader);
        std::fs::remove_file(schema::wal_path(&path)).unwrap();
        let before = std::fs::read(&path).unwrap();
        writer.write_now(samples(id, 150..160));
        let seen = progress::locked(&progress).clone();
        assert!(seen.damaged && seen.error.as_ref().is_some_and(|said| said.contains("-wal")), "{seen:?}");
        assert!(std::fs::read(&path).unwrap() == before);
    }
}
