//! Place: the database that a reading command uses if no data directory is named.

use super::{Context, Overrides, client};
use crate::config::{ConfigError, Environment};
use crate::store::{Reader, StoreError};
use anyhow::Context as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The database of the system's installation.
const SYSTEM: &str = "/var/lib/vn100d/vn100d.db";
/// How long a daemon may take to answer: it answers from memory.
const PATIENCE: Duration = Duration::from_millis(500);

/// A database, and the other places at which a search looked.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Place {
    database: PathBuf,
    /// In words, in the order of the search; empty if the directory was named.
    searched: Vec<String>,
}

/// A running daemon: its address, and its database if it answered.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Running {
    base_url: String,
    database: Option<PathBuf>,
}

impl Context {
    /// Returns the database for reading, also beside a running daemon.
    ///
    /// # Errors
    /// [`ConfigError`] if no directory is known, and [`StoreError`], with the places that were searched.
    pub(super) fn reader(&self) -> anyhow::Result<Reader> {
        let (place, note) = self.place()?;
        let opened = Reader::open(&place.database);
        if matches!(opened, Err(StoreError::NoDatabase(_))) && !place.searched.is_empty() {
            return opened.with_context(|| format!("looked in vain for a database: {}", place.searched.join("; ")));
        }
        let reader = opened?;
        if let Some(note) = note {
            eprintln!("note: {note}");
        }
        Ok(reader)
    }

    /// Returns the database if it can be read, without a word about it.
    pub(super) fn quiet_reader(&self) -> Option<Reader> {
        Reader::open(&self.place().ok()?.0.database).ok()
    }

    /// Returns the path of the database that reading commands use.
    ///
    /// # Errors
    /// [`ConfigError`] if no directory is known.
    pub(super) fn existing_database(&self) -> Result<PathBuf, ConfigError> {
        Ok(self.place()?.0.database)
    }

    /// Returns the place, and a remark if a running daemon has another database.
    fn place(&self) -> Result<(Place, Option<String>), ConfigError> {
        let environment = Environment::from_process();
        let own = self.database()?;
        if environment.names_data_dir(self.data_dir.as_deref()) {
            return Ok((Place { database: own, searched: Vec::new() }, None));
        }
        let daemon = self.running();
        let daemon_first = environment.names_config(self.config.as_deref());
        let place = search(own, daemon.as_ref(), Path::new(SYSTEM), daemon_first);
        let note = daemon.and_then(|daemon| other(&place, &daemon));
        Ok((place, note))
    }

    /// Asks the daemon at the configured address, if that is this machine, for its database. A configuration that is
    /// wrong names no daemon.
    fn running(&self) -> Option<Running> {
        let config = self.load(&Overrides { without_token: true, ..Overrides::default() }).ok()?;
        let address = config.http.listen.ip().to_canonical();
        if !address.is_loopback() && !address.is_unspecified() {
            return None;
        }
        let base_url = format!("http://{}", config.http.listen);
        let status = client::get_within(&base_url, "/v1/status", PATIENCE).ok();
        let database = status.and_then(|status| Some(PathBuf::from(status["storage"]["database"].as_str()?)));
        Some(Running { base_url, database })
    }
}

/// Returns a remark if the daemon has another database than this one.
fn other(place: &Place, Running { base_url, database }: &Running) -> Option<String> {
    let theirs = database.as_ref().filter(|theirs| **theirs != place.database)?;
    let (ours, directory) = (place.database.display(), theirs.parent()?.display());
    Some(format!("this reads {ours}; the daemon at {base_url} has another database (--data-dir {directory})"))
}

/// Returns the first database that is there: the user's own, that of the running daemon, that of the system's
/// installation; `daemon_first` exchanges the first two. If none is there, it is the user's own.
fn search(own: PathBuf, daemon: Option<&Running>, system: &Path, daemon_first: bool) -> Place {
    let mut searched = Vec::new();
    // A file that may not be looked at is there: reading it then tells why not.
    let is_there = |path: &Path| !std::fs::metadata(path).is_err_and(|error| is_absent(&error));
    // The same file may have two names.
    let same = |a: &Path, b: &Path| a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b));
    let of_daemon = daemon.and_then(|daemon| daemon.database.as_deref());
    let mut places = [(Some(own.as_path()), None), (of_daemon, daemon), (Some(system), None)];
    if daemon_first {
        places.swap(0, 1);
    }
    for (path, asked) in places {
        match (path, asked) {
            (Some(path), _) if is_there(path) => {
                // The daemon's name for it, if that is the same file: then there is no other.
                let named = of_daemon.filter(|theirs| same(theirs, path)).unwrap_or(path);
                return Place { database: named.to_owned(), searched };
            }
            (Some(path), None) => searched.push(path.display().to_string()),
            (Some(path), Some(daemon)) => {
                searched.push(format!("{}, which the daemon at {} has", path.display(), daemon.base_url));
            }
            (None, Some(daemon)) => searched.push(format!("no daemon answers at {}", daemon.base_url)),
            (None, None) => {}
        }
    }
    Place { database: own, searched }
}

fn is_absent(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{NotADirectory, NotFound};
    matches!(error.kind(), NotFound | NotADirectory)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_database_that_is_there_is_used() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let daemon = Running { base_url: "http://d".to_owned(), database: Some(path("daemon")) };
        let used = |daemon_first| search(path("own"), Some(&daemon), &path("system"), daemon_first).database;
        let none = search(path("own"), Some(&daemon), &path("system"), false);
        assert_eq!(none.database, path("own"));
        let expected = [
            path("own"),
            format!("{}, which the daemon at http://d has", path("daemon").display()).into(),
            path("system"),
        ];
        assert_eq!(none.searched, expected.map(|path| path.display().to_string()));
        for (made, first, named) in
            [("system", "system", "system"), ("daemon", "daemon", "daemon"), ("own", "own", "daemon")]
        {
            std::fs::write(path(made), "").unwrap();
            assert_eq!((used(false), used(true)), (path(first), path(named)));
        }
        let silent = Running { database: None, ..daemon.clone() };
        let none = search(path("nothing"), Some(&silent), &path("nowhere"), false);
        assert!(none.searched.contains(&"no daemon answers at http://d".to_owned()), "{none:?}");
    }

    #[test]
    fn a_database_with_two_names_is_no_other_one() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        std::fs::write(&real, "").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        let daemon = Running { base_url: "http://d".to_owned(), database: Some(real.clone()) };
        assert_eq!(search(link, Some(&daemon), Path::new("/nowhere"), false).database, real);
    }
}
