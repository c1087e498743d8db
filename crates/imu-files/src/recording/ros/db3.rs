//! The messages of a ROS 2 bag in SQLite (`.db3`), one after another.
//!
//! Messages are read in the order of recording, some hundred rows at a time. Bags of ROS 2 Iron and later hold the
//! definitions of their messages; for older ones they are standard or given ([`super::definition`]).
//!
//! The file is not trusted. It is opened read-only, without anything that a schema could execute; views and triggers
//! have no rows of their own that could be read. A value longer than [`MESSAGE_BYTES`] is skipped, and so are
//! unreadable rows, up to the next readable one. A statement ends when the reading is cancelled. Format:
//! <https://github.com/ros2/rosbag2>, `rosbag2_storage_sqlite3`.

use super::super::error::{RecordingError, refused};
use super::super::input::Input;
use super::super::meter::Meter;
use super::layout::Encoding;
use super::{Connection, Entry, Messages};
use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::{Connection as Database, MAIN_DB, OpenFlags, params};
use std::collections::{HashMap, VecDeque};
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// The beginning of such a file.
pub(in crate::recording) const MAGIC: &[u8] = b"SQLite format 3\0";
/// Longest message that is kept.
const MESSAGE_BYTES: i64 = 1024 * 1024;
/// Messages read at a time.
const ROWS: i64 = 512;
/// The maximum number of topics that are examined.
const TOPICS_MAX: i64 = 4096;
/// The maximum number of holes after which reading continues.
const HOLES_MAX: u32 = 1000;
/// The number of steps of SQLite's virtual machine between checks whether the reading is still wanted.
const ASK_STEPS: i32 = 100_000;

/// A message as read.
struct Message {
    topic: i64,
    received_ns: i64,
    /// `None` if it is too long.
    data: Option<Vec<u8>>,
}

/// Reads a bag's messages.
pub(super) struct Db3Reader {
    path: PathBuf,
    meter: Rc<Meter>,
    database: Database,
    connections: VecDeque<Connection>,
    messages: VecDeque<Message>,
    /// Topics by their ids, which need not fit a connection's number.
    numbers: HashMap<i64, u32>,
    last_row: i64,
    /// The last existing row, if it can be determined.
    end_row: Option<i64>,
    holes: u32,
    /// The reason why nothing more can be read after the waiting messages.
    broken: Option<String>,
    ended: bool,
    current: Vec<u8>,
}

/// Checks that an SQLite file is a bag.
///
/// # Errors
/// [`RecordingError::NoBag`] with the tables that the file has.
pub(in crate::recording) fn check(input: &Input) -> Result<(), RecordingError> {
    let database = open(input)?;
    let fault = |error| fault(input.path(), &error);
    let mut statement =
        database.prepare("SELECT name FROM sqlite_schema WHERE type = 'table' LIMIT 64").map_err(fault)?;
    let names = statement.query_map([], |row| row.get::<_, String>(0)).map_err(fault)?;
    let names = names.collect::<Result<Vec<_>, _>>().map_err(fault)?;
    if ["topics", "messages"].iter().all(|wanted| names.iter().any(|name| name == wanted)) {
        return Ok(());
    }
    let found = if ["capture", "sample", "segment"].iter().all(|own| names.iter().any(|name| name == own)) {
        "this program's own database: name a capture in it, and its folder with --data-dir".to_owned()
    } else {
        let names: Vec<String> = names.iter().take(20).map(|name| name.chars().take(40).collect()).collect();
        format!(
            "an SQLite database with the tables {}",
            if names.is_empty() { "none".to_owned() } else { names.join(", ") }
        )
    };
    Err(RecordingError::NoBag { file: input.path().to_owned(), found })
}

fn fault(path: &Path, error: &rusqlite::Error) -> RecordingError {
    let is_damaged = matches!(
        error.sqlite_error_code(),
        Some(rusqlite::ErrorCode::DatabaseCorrupt | rusqlite::ErrorCode::NotADatabase)
    );
    let advice =
        if is_damaged { "; was it cut off? `sqlite3 FILE .recover | sqlite3 whole.db3` may save some" } else { "" };
    RecordingError::Database { file: path.to_owned(), reason: format!("{error}{advice}") }
}

/// Opens the file read-only.
fn open(input: &Input) -> Result<Database, RecordingError> {
    let path = input.path();
    let fault = |error| fault(path, &error);
    let database = match input.bytes() {
        Some(bytes) => {
            let mut database = Database::open_in_memory().map_err(fault)?;
            database.deserialize_read_exact(MAIN_DB, bytes, bytes.len(), true).map_err(fault)?;
            database
        }
        None => open_file(path).map_err(fault)?,
    };
    for (setting, on) in [
        (DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true),
        (DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false),
        (DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER, false),
        (DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW, false),
    ] {
        database.set_db_config(setting, on).map_err(fault)?;
    }
    // Otherwise SQLite reads beyond the end of a damaged page and finds different data each time.
    database.pragma_update(None, "cell_size_check", true).map_err(fault)?;
    // A message is truncated in SQL; a text (a definition) may be longer.
    database.set_limit(Limit::SQLITE_LIMIT_LENGTH, 64 << 20).map_err(fault)?;
    Ok(database)
}

/// Returns the log beside a bag that contains the data that its recorder had not yet moved into the bag when it was
/// killed; `None` if there is none, or the file is no database.
pub fn unmerged_log(file: &Path) -> Option<PathBuf> {
    let mut begin = Vec::new();
    std::fs::File::open(file).ok()?.take(MAGIC.len() as u64).read_to_end(&mut begin).ok()?;
    let mut log = file.as_os_str().to_owned();
    log.push("-wal");
    let log = PathBuf::from(log);
    (begin == MAGIC && std::fs::metadata(&log).is_ok_and(|log| log.len() > 0)).then_some(log)
}

/// Opens a bag. A bag whose recorder was killed may have a log beside it, which only an ordinary opening reads. If that
/// is impossible (a read-only folder), the file alone is used, provided that there is no log.
fn open_file(path: &Path) -> rusqlite::Result<Database> {
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX | OpenFlags::SQLITE_OPEN_URI;
    let mut text = String::new();
    for byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'/' | b'.' | b'-' | b'_' | b'0'..=b'9' | b'a'..=b'z' | b'A'..=b'Z' => text.push(char::from(*byte)),
            other => text.push_str(&format!("%{other:02X}")),
        }
    }
    let database = Database::open_with_flags(format!("file:{text}?mode=ro"), flags)?;
    let readable = database.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get::<_, i64>(0));
    match readable {
        // Never without a log that has content: messages would be missing without notice.
        Err(rusqlite::Error::SqliteFailure(error, _))
            if error.code == rusqlite::ErrorCode::CannotOpen && unmerged_log(path).is_none() =>
        {
            Database::open_with_flags(format!("file:{text}?mode=ro&immutable=1"), flags)
        }
        Err(error) if unmerged_log(path).is_some() => Err(error),
        _ => Ok(database),
    }
}

impl Db3Reader {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        let meter = input.meter();
        let database = open(input)?;
        let asked = input.keep_on();
        database
            .progress_handler(ASK_STEPS, Some(move || !asked.is_wanted()))
            .map_err(|error| fault(input.path(), &error))?;
        let mut reader = Self {
            path: input.path().to_owned(),
            meter,
            database,
            connections: VecDeque::new(),
            messages: VecDeque::new(),
            numbers: HashMap::new(),
            last_row: i64::MIN,
            end_row: None,
            holes: 0,
            broken: None,
            ended: false,
            current: Vec::new(),
        };
        reader.read_topics().map_err(|error| fault(input.path(), &error))?;
        // In a damaged file it may not be readable.
        let end_row = reader.database.query_row("SELECT max(rowid) FROM messages", [], |row| row.get(0));
        reader.end_row = end_row.unwrap_or_default();
        Ok(reader)
    }

    fn read_topics(&mut self) -> rusqlite::Result<()> {
        let definitions = self.definitions().unwrap_or_default();
        let mut statement =
            self.database.prepare("SELECT id, name, type, serialization_format FROM topics ORDER BY id LIMIT ?1")?;
        let mut rows = statement.query([TOPICS_MAX])?;
        while let Some(row) = rows.next()? {
            let (id, topic): (i64, String) = (row.get(0)?, row.get(1)?);
            let (message_type, encoding): (String, String) = (row.get(2)?, row.get(3)?);
            let number = self.connections.len() as u32;
            self.numbers.insert(id, number);
            self.connections.push_back(Connection {
                number,
                topic,
                definition: definitions.get(&message_type).cloned().unwrap_or_default(),
                message_type,
                encoding: Encoding::from_name(&encoding),
            });
        }
        Ok(())
    }

    /// Returns the definitions of message types, if the bag has them.
    fn definitions(&self) -> rusqlite::Result<HashMap<String, String>> {
        let sql = "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = 'ros2msg' LIMIT ?1";
        let mut statement = self.database.prepare(sql)?;
        let rows = statement.query_map([TOPICS_MAX], |row| Ok((row.get(0)?, row.get(1)?)))?;
        rows.collect()
    }

    /// Reads the next rows; returns whether they were in order, which they may not be in a damaged database.
    fn fill(&mut self, wanted: &dyn Fn(u32) -> bool) -> rusqlite::Result<bool> {
        let filled = self.fill_from_cache(wanted);
        if filled.is_err() {
            // SQLite checks a page once: a page that stays in its cache would pass the next time.
            self.database.pragma_query(None, "shrink_memory", |_| Ok(()))?;
        }
        filled
    }

    fn fill_from_cache(&mut self, wanted: &dyn Fn(u32) -> bool) -> rusqlite::Result<bool> {
        // A topic of images beside the IMU's is not even read.
        let topics: Vec<String> =
            self.numbers.iter().filter(|(_, number)| wanted(**number)).map(|(id, _)| id.to_string()).collect();
        let sql = format!(
            "SELECT rowid, topic_id, timestamp, CASE WHEN length(data) <= {MESSAGE_BYTES} THEN data END FROM messages \
             WHERE rowid > ?1 AND topic_id IN ({}) ORDER BY rowid LIMIT {ROWS}",
            topics.join(",")
        );
        let mut statement = self.database.prepare_cached(&sql)?;
        let mut rows = statement.query(params![self.last_row])?;
        while let Some(row) = rows.next()? {
            let number: i64 = row.get(0)?;
            if number <= self.last_row {
                return Ok(false);
            }
            self.last_row = number;
            let data = row.get_ref(3)?.as_blob().ok().map(<[u8]>::to_vec);
            self.messages.push_back(Message { topic: row.get(1)?, received_ns: row.get(2)?, data });
        }
        self.ended = self.messages.is_empty();
        Ok(true)
    }

    /// Reads the next rows or, if some cannot be read, those behind them; returns a description of the skipped rows.
    fn read_on(&mut self, wanted: &dyn Fn(u32) -> bool) -> Option<String> {
        if self.broken.is_none() {
            self.broken = match self.fill(wanted) {
                Ok(true) => None,
                Ok(false) => Some("its rows are out of order".to_owned()),
                Err(error) => Some(error.to_string()),
            };
            if !self.messages.is_empty() {
                // Those come first.
                return None;
            }
        }
        let why = self.broken.take()?;
        let good = self.last_row.max(0);
        self.holes += 1;
        let found = if self.holes > HOLES_MAX { None } else { self.find_behind(good, wanted) };
        // The last attempt may have found nothing.
        self.ended = found.is_none();
        Some(match found {
            Some(found) => format!("rows {} to {found} cannot be read and are passed over: {why}", good + 1),
            None => format!("what lies behind row {good} was not read: {why} (`sqlite3 FILE .recover` may save some)"),
        })
    }

    /// Finds the first readable row behind this one, in steps that grow and then halve, and reads from there. Returns
    /// the last row that was skipped. Each reading begins behind the last: it cannot loop.
    fn find_behind(&mut self, good: i64, wanted: &dyn Fn(u32) -> bool) -> Option<i64> {
        let last_start = self.end_row.unwrap_or(i64::MAX).saturating_sub(1);
        let (mut bad, mut step) = (good, 1_i64);
        let mut start = loop {
            let start = good.saturating_add(step).min(last_start);
            if start <= bad || self.meter.check().is_err() {
                return None;
            }
            if self.begins(start, wanted) {
                break start;
            }
            bad = start;
            step = step.saturating_mul(2);
        };
        while start - bad > 1 {
            let middle = bad + (start - bad) / 2;
            if self.begins(middle, wanted) {
                start = middle;
            } else {
                bad = middle;
            }
        }
        self.begins(start, wanted).then_some(start)
    }

    /// Returns whether rows can be read from behind this one on; if so, they are read.
    fn begins(&mut self, row: i64, wanted: &dyn Fn(u32) -> bool) -> bool {
        self.messages.clear();
        self.last_row = row;
        // Rows before an error are valid.
        let _ = self.fill(wanted);
        !self.messages.is_empty()
    }
}

impl Messages for Db3Reader {
    fn check(&self) -> Result<(), RecordingError> {
        self.meter.check().map_err(|refusal| refused(&self.path, refusal))
    }

    fn next_entry(&mut self, wanted: &dyn Fn(u32) -> bool) -> Option<Entry<'_>> {
        if let Some(connection) = self.connections.pop_front() {
            return Some(Entry::Connection(connection));
        }
        if self.messages.is_empty()
            && !self.ended
            && let Some(what) = self.read_on(wanted)
        {
            return Some(Entry::Damaged { at: 0, what });
        }
        let Message { topic, received_ns, data } = self.messages.pop_front()?;
        let Some(data) = data else {
            return Some(Entry::Damaged {
                at: 0,
                what: format!("a message of topic {topic} that is no blob or too long"),
            });
        };
        self.current = data;
        let connection = self.numbers.get(&topic).copied().unwrap_or(u32::MAX);
        Some(Entry::Message { connection, received_ns, data: &self.current })
    }
}
