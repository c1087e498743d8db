//! Opening: decides which files are databases of this program, checks their schema and sets the pragmas of connections.

use super::StoreError;
use super::check_at_start::at_start;
use super::damage::Damage;
use super::error::reports_damage;
use super::lock::Mark;
use super::paths::{uri_escaped, wal_path};
use super::written::{id_of, refuse_replaced, written};
use rusqlite::config::DbConfig;
use rusqlite::{Connection, OpenFlags};
use rusqlite_migration::{M, Migrations};
use std::ffi::OsStr;
use std::io::Read as _;
use std::os::unix::ffi::OsStrExt as _;
use std::path::Path;
use std::time::Duration;

/// `VN10` in ASCII: marks a SQLite file as a database of this program (PRAGMA application_id).
pub const APPLICATION_ID: i32 = 0x564E_3130;
/// First SQLite without the WAL-reset race (sqlite.org/wal.html#walresetbug).
const SQLITE_NEEDED: (i32, &str) = (3_051_003, "3.51.3");
/// The migrations in order, never edited after a release.
const MIGRATIONS: &[&str] = &[
    include_str!("../../migrations/0001_captures.sql"),
    include_str!("../../migrations/0002_jobs.sql"),
    include_str!("../../migrations/0003_accounting.sql"),
    include_str!("../../migrations/0004_batches.sql"),
    include_str!("../../migrations/0005_retention.sql"),
    include_str!("../../migrations/0006_job_software.sql"),
    include_str!("../../migrations/0007_utc_corrections.sql"),
    include_str!("../../migrations/0008_boot.sql"),
    include_str!("../../migrations/0009_models.sql"),
    include_str!("../../migrations/0010_references.sql"),
    include_str!("../../migrations/0011_notes.sql"),
];
/// How long the writer waits for a foreign lock before it reports it.
const WRITER_BUSY: Duration = Duration::from_millis(5000);
/// How long a reader waits.
const READER_BUSY: Duration = Duration::from_millis(2000);
/// The cache of a reader, KiB: it reads sequentially or looks up a row, and the system's own cache holds the rest.
const READER_CACHE_KIB: i64 = 256;
/// Statements that a connection keeps prepared.
const STATEMENTS: usize = 64;

/// Returns the newest schema version this program knows.
pub fn schema_version() -> i64 {
    MIGRATIONS.len() as i64
}

fn migrations() -> Migrations<'static> {
    Migrations::new(MIGRATIONS.iter().map(|sql| M::up(sql)).collect())
}

pub(super) fn check_sqlite() -> Result<(), StoreError> {
    if rusqlite::version_number() < SQLITE_NEEDED.0 {
        return Err(StoreError::SqliteTooOld { found: rusqlite::version(), needed: SQLITE_NEEDED.1 });
    }
    Ok(())
}

/// Returns the writer's connection to an existing or new database; its schema is upgraded.
///
/// A damaged database is not opened: until it has passed the check, only a connection that cannot write has touched it.
pub(super) fn open_and_migrate(path: &Path, mark: Option<&Mark>) -> Result<Connection, StoreError> {
    check_sqlite()?;
    let existing = std::fs::metadata(path).is_ok_and(|file| file.len() > 0);
    if existing {
        // A foreign file is examined through a connection that cannot write.
        let connection = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
        let ours = refuse_foreign(&connection, path).and_then(|()| refuse_newer(&connection, path));
        ours.map_err(|error| match error {
            StoreError::Sqlite(error) if reports_damage(&error) => Damage::Refused(error.to_string()).error(path),
            other => other,
        })?;
        connection.busy_timeout(WRITER_BUSY)?;
        at_start(&connection, path, mark)?;
    }
    let mut connection = writer_connection(path, OpenFlags::SQLITE_OPEN_CREATE)?;
    migrations().to_latest(&mut connection)?;
    Ok(connection)
}

/// Returns the writer's connection to a database that must exist: used to reopen it after an error. Unless changed with
/// [`keep_log`], closing the connection leaves the log as it is, because the file may be damaged.
pub(super) fn reopen(path: &Path) -> Result<Connection, StoreError> {
    let connection = open_for_writing(path, OpenFlags::empty())?;
    keep_log(&connection, true)?;
    configure_writer(&connection)?;
    refuse_foreign(&connection, path)?;
    Ok(connection)
}

/// Sets whether closing the connection leaves the log as it is instead of copying it into the file.
pub(super) fn keep_log(connection: &Connection, keep: bool) -> Result<(), rusqlite::Error> {
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, keep).map(drop)
}

/// Makes a copy an independent database: it gets a new identity, and its log is emptied.
pub(super) fn make_independent(path: &Path) -> Result<(), StoreError> {
    let connection = writer_connection(path, OpenFlags::empty())?;
    connection.execute("UPDATE writer SET identity = lower(hex(randomblob(16)))", [])?;
    connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()))?;
    connection.close().map_err(|(_, error)| StoreError::Sqlite(error))
}

/// Returns a connection to a new database that does not outlive its process: nothing is synced.
pub(super) fn for_a_while(path: &Path) -> Result<Connection, StoreError> {
    let connection = open_and_migrate(path, None)?;
    connection.pragma_update(None, "synchronous", "OFF")?;
    Ok(connection)
}

/// Empties the log and truncates its file, if no reader prevents it; never waits.
pub(super) fn shrink_log(connection: &Connection) -> Result<(), rusqlite::Error> {
    connection.busy_timeout(Duration::ZERO)?;
    let emptied = connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()));
    connection.busy_timeout(WRITER_BUSY)?;
    emptied
}

fn writer_connection(path: &Path, more: OpenFlags) -> Result<Connection, StoreError> {
    let connection = open_for_writing(path, more)?;
    configure_writer(&connection)?;
    Ok(connection)
}

fn open_for_writing(path: &Path, more: OpenFlags) -> Result<Connection, rusqlite::Error> {
    Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX | more)
}

fn configure_writer(connection: &Connection) -> Result<(), rusqlite::Error> {
    connection.busy_timeout(WRITER_BUSY)?;
    // A new file has no pages yet: it takes the id before it takes WAL mode.
    if connection.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get::<_, i64>(0))? == 0 {
        // Before the first table: freed pages can then be given back to the file system in small steps.
        connection.pragma_update(None, "auto_vacuum", "INCREMENTAL")?;
        connection.pragma_update(None, "application_id", APPLICATION_ID)?;
    }
    connection.pragma_update(None, "journal_mode", "WAL")?;
    set_durability(connection, Durability::AtCommit)?;
    connection.pragma_update(None, "wal_autocheckpoint", 1000)?;
    connection.pragma_update(None, "journal_size_limit", 64 << 20)?;
    connection.pragma_update(None, "foreign_keys", true)?;
    common_pragmas(connection)
}

/// Returns whether a file is a database of captures, of any version. This is determined from SQLite's header (its first
/// 16 bytes, and the application's id in bytes 68 to 71, big endian). A file that this process writes is not opened: see
/// [`refuse_absent`].
pub(super) fn is_database(path: &Path) -> bool {
    if id_of(path).is_some_and(|id| written().values().any(|written| *written == id)) {
        return true;
    }
    let mut head = [0; 72];
    let read = path.is_file() && std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut head)).is_ok();
    read && head.starts_with(b"SQLite format 3\0") && head[68..] == APPLICATION_ID.to_be_bytes()
}

/// Returns whether a file is a database of captures, or one of the files that SQLite and this program keep beside it.
pub fn is_of_database(path: &Path) -> bool {
    const BESIDE: [&str; 4] = ["-wal", "-shm", "-journal", ".lock"];
    let name = path.as_os_str().as_bytes();
    let base = |suffix: &&str| name.strip_suffix(suffix.as_bytes()).map(|base| Path::new(OsStr::from_bytes(base)));
    is_database(path) || BESIDE.iter().filter_map(base).any(is_database)
}

/// The time at which the pages of a transaction reach the disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Durability {
    /// Before its commit returns.
    AtCommit,
    /// With the next transaction that is synced: a power loss before that undoes this transaction as a whole.
    Later,
}

/// Sets the durability. It is set before each transaction, so that none inherits another's. In either mode the log is
/// synced before a checkpoint and the file after it, so that the file stays intact.
pub(super) fn set_durability(connection: &Connection, durability: Durability) -> Result<(), rusqlite::Error> {
    let synchronous = match durability {
        Durability::AtCommit => "FULL",
        Durability::Later => "NORMAL",
    };
    connection.pragma_update(None, "synchronous", synchronous)
}

/// Returns a connection that can only read. It never checkpoints: only the writer does.
pub(super) fn reader_connection(path: &Path) -> Result<Connection, StoreError> {
    check_sqlite()?;
    refuse_absent(path)?;
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let mut connection = Connection::open_with_flags(path, flags)?;
    refuse_replaced(path)?;
    connection.busy_timeout(READER_BUSY)?;
    if let Err(StoreError::Sqlite(error)) = refuse_foreign(&connection, path) {
        // WAL mode needs a shared-memory file. If none can be created and no log is left, the file itself is complete.
        // If this process writes it, that is true for a moment only.
        let log = wal_path(path);
        if written().contains_key(path) || std::fs::metadata(&log).is_ok_and(|file| file.len() > 0) {
            return Err(error.into());
        }
        let uri = format!("file:{}?immutable=1", uri_escaped(path));
        connection = Connection::open_with_flags(uri, flags | OpenFlags::SQLITE_OPEN_URI)?;
    }
    refuse_foreign(&connection, path)?;
    refuse_newer(&connection, path)?;
    let found = user_version(&connection)?;
    if found < schema_version() {
        return Err(StoreError::OlderSchema { path: path.to_owned(), found, expected: schema_version() });
    }
    connection.pragma_update(None, "query_only", true)?;
    connection.pragma_update(None, "cache_size", -READER_CACHE_KIB)?;
    connection.pragma_update(None, "wal_autocheckpoint", 0)?;
    common_pragmas(&connection)?;
    Ok(connection)
}

/// Fails if there is no database, or if this user may not read it: SQLite does not distinguish these.
///
/// The file is not opened for this. Closing any descriptor of a database drops all locks that SQLite holds on it for
/// this process (sqlite.org/howtocorrupt.html, 2.2): another process could then delete the log of the running writer.
fn refuse_absent(path: &Path) -> Result<(), StoreError> {
    let not_readable = || Err(StoreError::NotReadable(path.to_owned()));
    match std::fs::metadata(path) {
        Ok(file) if file.len() > 0 => {}
        Err(error) if error.kind() == std::io::ErrorKind::PermissionDenied => return not_readable(),
        _ => return Err(StoreError::NoDatabase(path.to_owned())),
    }
    match rustix::fs::access(path, rustix::fs::Access::READ_OK) {
        Err(rustix::io::Errno::ACCESS) => not_readable(),
        _ => Ok(()),
    }
}

fn common_pragmas(connection: &Connection) -> Result<(), rusqlite::Error> {
    connection.pragma_update(None, "cell_size_check", true)?;
    connection.pragma_update(None, "trusted_schema", false)?;
    connection.pragma_update(None, "mmap_size", 0)?;
    connection.pragma_update(None, "temp_store", "MEMORY")?;
    connection.set_prepared_statement_cache_capacity(STATEMENTS);
    Ok(())
}

fn user_version(connection: &Connection) -> Result<i64, StoreError> {
    Ok(connection.pragma_query_value(None, "user_version", |row| row.get(0))?)
}

pub(super) fn refuse_foreign(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    let foreign = |found| StoreError::Foreign { path: path.to_owned(), found, expected: APPLICATION_ID };
    let found: i32 = match connection.pragma_query_value(None, "application_id", |row| row.get(0)) {
        Err(error) if error.sqlite_error_code() == Some(rusqlite::ErrorCode::NotADatabase) => return Err(foreign(0)),
        other => other?,
    };
    if found == APPLICATION_ID { Ok(()) } else { Err(foreign(found)) }
}

fn refuse_newer(connection: &Connection, path: &Path) -> Result<(), StoreError> {
    let found = user_version(connection)?;
    if found > schema_version() {
        return Err(StoreError::NewerSchema { path: path.to_owned(), found, supported: schema_version() });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::file_id::FileId;
    use super::super::paths::shm_path;
    use super::*;
    use std::os::unix::fs::MetadataExt as _;

    #[test]
    fn the_migrations_can_be_applied() {
        migrations().validate().unwrap();
    }

    #[test]
    fn the_writer_has_the_pragmas_that_make_a_commit_durable() {
        let directory = tempfile::tempdir().unwrap();
        let connection = open_and_migrate(&directory.path().join("a.db"), None).unwrap();
        let text = |name| connection.pragma_query_value(None, name, |row| row.get::<_, String>(0)).unwrap();
        let number = |name| connection.pragma_query_value(None, name, |row| row.get::<_, i64>(0)).unwrap();
        assert_eq!(text("journal_mode"), "wal");
        assert_eq!(number("synchronous"), 2);
        assert_eq!(number("application_id"), i64::from(APPLICATION_ID));
        assert_eq!(number("user_version"), schema_version());
        assert_eq!(number("foreign_keys"), 1);
        assert_eq!(number("auto_vacuum"), 2, "space can be given back");
        assert_eq!(number("cell_size_check"), 1);
        assert_eq!(number("trusted_schema"), 0);
        assert_eq!(number("busy_timeout"), 5000);
    }

    #[test]
    fn a_reader_cannot_write() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a?b#c%.db");
        drop(open_and_migrate(&path, None).unwrap());
        let reader = reader_connection(&path).unwrap();
        assert!(reader.execute("UPDATE writer SET batch = 7", []).is_err());
        assert_eq!(reader.query_row("SELECT batch FROM writer", [], |row| row.get::<_, i64>(0)).unwrap(), 0);
    }

    #[test]
    fn a_file_that_this_process_writes_is_never_read_without_its_log() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.db");
        drop(open_and_migrate(&path, None).unwrap());
        // No shared memory can be made.
        std::os::unix::fs::symlink(directory.path().join("nowhere"), shm_path(&path)).unwrap();
        drop(reader_connection(&path).unwrap());
        FileId::written(&path);
        assert!(reader_connection(&path).is_err());
        FileId::forget(&path);
    }

    /// Returns whether this process has a lock on a file, as the system lists them. A list that is read while other locks come and
    /// go may lack one, so that it is read several times.
    fn is_locked(path: &Path) -> bool {
        const READS: usize = 50;
        let (process, file) = (std::process::id().to_string(), format!(":{}", path.metadata().unwrap().ino()));
        let is_own = |line: &str| {
            line.split_whitespace().any(|word| word == process)
                && line.split_whitespace().any(|word| word.ends_with(&file))
        };
        (0..READS).any(|_| std::fs::read_to_string("/proc/locks").unwrap().lines().any(is_own))
    }

    /// Without them the last connection of another process deletes the log of the running writer. A file that is closed costs a
    /// process all its locks on it.
    #[test]
    fn a_reader_leaves_the_writer_its_locks() {
        let world = crate::store::tests::World::new();
        world.complete("desk");
        let path = world.store.path().to_owned();
        assert!(is_locked(&path), "the writer has no lock");
        refuse_absent(&path).unwrap();
        assert!(is_locked(&path), "after the look whether it is there");
        assert!(is_of_database(&path) && is_of_database(&wal_path(&path)));
        assert!(is_locked(&path), "after the look at its first bytes");
        drop(reader_connection(&path).unwrap());
        assert!(is_locked(&path), "after a reader");
        world.store.close().unwrap();
    }

    #[test]
    fn a_pipe_is_no_database_and_is_not_waited_for() {
        let directory = tempfile::tempdir().unwrap();
        let pipe = directory.path().join("vn100d.db");
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR).unwrap();
        assert!(matches!(reader_connection(&pipe), Err(StoreError::NoDatabase(_))));
        assert!(!is_of_database(&pipe));
    }
}
