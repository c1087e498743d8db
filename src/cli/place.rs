//! Place: the database that a reading command uses if no data directory is named, and whether a daemon has the one that
//! is named.

use super::client::{self, ClientError};
use super::{CliError, Context, Failure, Overrides, failed};
use crate::config::{ConfigError, Environment};
use crate::store::{Reader, StoreError};
use anyhow::Context as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The database of the system's installation.
const SYSTEM: &str = "/var/lib/vn100d/vn100d.db";
/// How long a daemon may take to answer: it answers from memory.
pub(super) const PATIENCE: Duration = Duration::from_millis(500);

/// A database, and the other places at which a search looked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Place {
    database: PathBuf,
    /// Whose it is, in words; `None` if it is the user's own, or was named.
    whose: Option<String>,
    /// In words, in the order of the search; empty if the directory or the configuration was named.
    searched: Vec<String>,
}

impl Place {
    /// Returns a database that the user named.
    fn named(database: PathBuf) -> Self {
        Self { database, whose: None, searched: Vec::new() }
    }
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
    /// [`ConfigError`] if no directory is known, [`Failure::Unreachable`] if the daemon of a named configuration does
    /// not answer, and [`StoreError`], with the places that were searched.
    pub(super) fn reader(&self) -> anyhow::Result<Reader> {
        let place = self.place(true)?;
        let opened = Reader::open(&place.database);
        if matches!(opened, Err(StoreError::NoDatabase(_))) && !place.searched.is_empty() {
            return opened.with_context(|| format!("looked in vain for a database: {}", place.searched.join("; ")));
        }
        Ok(opened?)
    }

    /// Returns the database if it can be read, without a word about it.
    pub(super) fn quiet_reader(&self) -> Option<Reader> {
        Reader::open(&self.place(false).ok()?.database).ok()
    }

    /// Returns the path of the database that reading commands use.
    ///
    /// # Errors
    /// Those of [`Self::reader`], but for the [`StoreError`].
    pub(super) fn existing_database(&self) -> anyhow::Result<PathBuf> {
        Ok(self.place(true)?.database.clone())
    }

    /// Fails if a data directory was named, and the daemon at this address has another database than that directory's.
    ///
    /// # Errors
    /// [`ClientError`], or an error that names both databases.
    pub(super) fn refuse_another(&self, base_url: &str, patience: Duration) -> anyhow::Result<()> {
        if !Environment::from_process().names_data_dir(self.data_dir.as_deref()) {
            return Ok(());
        }
        let ours = self.database()?;
        let Some(theirs) = another_database(base_url, &ours, patience)? else { return Ok(()) };
        let (ours, theirs) = (ours.display(), theirs.display());
        Err(failed(format!(
            "the daemon at {base_url} has {theirs}, not {ours} of the data directory that was named: name the daemon's address \
             with --listen, or no data directory"
        )))
    }

    /// Returns the place. It is searched for once; with `aloud`, a remark about it is then printed on standard error.
    fn place(&self, aloud: bool) -> anyhow::Result<&Place> {
        if let Some(place) = self.place.get() {
            return Ok(place);
        }
        let (place, remark) = self.find_place()?;
        if let Some(remark) = remark.filter(|_| aloud) {
            eprintln!("note: {remark}");
        }
        Ok(self.place.get_or_init(|| place))
    }

    /// Returns the place, and a remark if it is not the user's own or if a running daemon has another database.
    fn find_place(&self) -> anyhow::Result<(Place, Option<String>)> {
        let environment = Environment::from_process();
        if environment.names_data_dir(self.data_dir.as_deref()) {
            return Ok((Place::named(self.database()?), None));
        }
        let named = environment.names_config(self.config.as_deref());
        let daemon = match self.running() {
            Err(error) if named => return Err(error.into()),
            // A configuration that is wrong names no daemon.
            daemon => daemon.unwrap_or_default(),
        };
        if named {
            return Ok((Place::named(of_named(daemon)?), None));
        }
        let place = search(self.database().ok(), daemon.as_ref(), Path::new(SYSTEM))?;
        let remark = remark(&place, daemon.as_ref());
        Ok((place, remark))
    }

    /// Asks the daemon at the configured address for its database. `None` if the address is neither a loopback address
    /// nor unspecified (`0.0.0.0`, `::`): it may be another machine's.
    fn running(&self) -> Result<Option<Running>, ConfigError> {
        let config = self.load(&Overrides { without_token: true, ..Overrides::default() })?;
        let address = config.http.listen.ip().to_canonical();
        if !address.is_loopback() && !address.is_unspecified() {
            return Ok(None);
        }
        let base_url = format!("http://{}", config.http.listen);
        let database = database_of(&base_url, PATIENCE).ok().flatten();
        Ok(Some(Running { base_url, database }))
    }
}

/// Returns the path that the daemon at this address reports for its database.
fn database_of(base_url: &str, patience: Duration) -> Result<Option<PathBuf>, ClientError> {
    let status = client::get_within(base_url, "/v1/status", patience)?;
    Ok(status["storage"]["database"].as_str().map(PathBuf::from))
}

/// Returns the database of the daemon at this address if it is another one than `ours`.
///
/// # Errors
/// [`ClientError`].
pub(super) fn another_database(
    base_url: &str,
    ours: &Path,
    patience: Duration,
) -> Result<Option<PathBuf>, ClientError> {
    let theirs = database_of(base_url, patience)?.unwrap_or_default();
    // A daemon reports the path without links.
    let ours = ours.canonicalize().or_else(|_| std::path::absolute(ours)).unwrap_or_else(|_| ours.to_owned());
    Ok(Some(theirs).filter(|theirs| *theirs != ours))
}

/// Returns the database of the daemon of a named configuration.
fn of_named(daemon: Option<Running>) -> Result<PathBuf, CliError> {
    let why = match daemon {
        Some(Running { database: Some(database), .. }) => return Ok(database),
        Some(Running { base_url, database: None }) => format!("no daemon answers at {base_url}"),
        None => "`http.listen` of the configuration is no loopback address".to_owned(),
    };
    let message = format!("{why}, so that its database is not known: name the database's directory with --data-dir");
    Err(CliError { failure: Failure::Unreachable, message })
}

/// Returns whose database it is if it is not the user's own, and whether the daemon has another one.
fn remark(place: &Place, daemon: Option<&Running>) -> Option<String> {
    let ours = place.database.display();
    let other = daemon.and_then(|Running { base_url, database }| {
        let theirs = database.as_ref().filter(|theirs| **theirs != place.database)?;
        Some(format!("the daemon at {base_url} has another database (--data-dir {})", theirs.parent()?.display()))
    });
    let whose = place.whose.as_ref().map(|whose| format!(", the database of {whose}")).unwrap_or_default();
    let other = other.map(|other| format!("; {other}")).unwrap_or_default();
    (!whose.is_empty() || !other.is_empty()).then(|| format!("this reads {ours}{whose}{other}"))
}

/// Returns the first database that is there: the user's own, that of the running daemon, that of the system's
/// installation. If none is there, it is the user's own.
///
/// # Errors
/// [`ConfigError::NoDataDirectory`] with the places that were searched, if none is there and the user has no place.
fn search(own: Option<PathBuf>, daemon: Option<&Running>, system: &Path) -> anyhow::Result<Place> {
    let mut searched = Vec::new();
    // A file that may not be looked at is there: reading it then tells why not.
    let is_there = |path: &Path| !std::fs::metadata(path).is_err_and(|error| is_absent(&error));
    // The same file may have two names.
    let same = |a: &Path, b: &Path| a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b));
    let of_daemon = daemon.and_then(|daemon| daemon.database.as_deref());
    let whose_daemon = daemon.map(|daemon| format!("the daemon at {}", daemon.base_url));
    let places = [
        (own.as_deref(), None),
        (of_daemon, whose_daemon.clone()),
        (Some(system), Some("the system's installation".to_owned())),
    ];
    for (index, (path, whose)) in places.into_iter().enumerate() {
        match path {
            Some(path) if is_there(path) => {
                // The daemon's name for it, if that is the same file: then there is no other.
                let theirs = of_daemon.filter(|theirs| same(theirs, path));
                let whose = if theirs.is_some() && index > 0 { whose_daemon } else { whose };
                return Ok(Place { database: theirs.unwrap_or(path).to_owned(), whose, searched });
            }
            Some(path) if index == 1 => {
                searched.push(format!("{}, which {} has", path.display(), whose.unwrap_or_default()));
            }
            Some(path) => searched.push(path.display().to_string()),
            None if index == 1 => {
                searched.extend(daemon.map(|daemon| format!("no daemon answers at {}", daemon.base_url)));
            }
            None => {}
        }
    }
    match own {
        Some(database) => Ok(Place { database, whose: None, searched }),
        None => Err(ConfigError::NoDataDirectory)
            .with_context(|| format!("looked in vain for a database: {}", searched.join("; "))),
    }
}

fn is_absent(error: &std::io::Error) -> bool {
    use std::io::ErrorKind::{NotADirectory, NotFound};
    matches!(error.kind(), NotFound | NotADirectory)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn daemon(database: Option<PathBuf>) -> Running {
        Running { base_url: "http://d".to_owned(), database }
    }

    #[test]
    fn the_first_database_that_is_there_is_used() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let daemon = daemon(Some(path("daemon")));
        let used = || search(Some(path("own")), Some(&daemon), &path("system")).unwrap();
        let none = used();
        assert_eq!((&none.database, &none.whose), (&path("own"), &None));
        let expected = [
            path("own"),
            format!("{}, which the daemon at http://d has", path("daemon").display()).into(),
            path("system"),
        ];
        assert_eq!(none.searched, expected.map(|path| path.display().to_string()));
        for (made, whose, reason) in [
            ("system", Some("the system's installation"), "the database of the system's installation; the daemon at"),
            ("daemon", Some("the daemon at http://d"), "the database of the daemon at http://d"),
            ("own", None, "own; the daemon at http://d has another database (--data-dir"),
        ] {
            std::fs::write(path(made), "").unwrap();
            let place = used();
            assert_eq!((&place.database, place.whose.as_deref()), (&path(made), whose));
            let remark = remark(&place, Some(&daemon)).unwrap();
            assert!(remark.contains(reason), "{remark}");
        }
        let silent = Running { database: None, ..daemon.clone() };
        let none = search(Some(path("nothing")), Some(&silent), &path("nowhere")).unwrap();
        assert!(none.searched.contains(&"no daemon answers at http://d".to_owned()), "{none:?}");
        let own = search(Some(path("own")), Some(&silent), &path("nowhere")).unwrap();
        assert_eq!(remark(&own, Some(&silent)), None);
    }

    #[test]
    fn without_a_place_of_the_user_s_own_the_others_are_searched() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let error = search(None, None, &path("system")).unwrap_err();
        assert!(matches!(error.downcast_ref(), Some(ConfigError::NoDataDirectory)), "{error:#}");
        assert!(error.to_string().contains("system"), "{error:#}");
        std::fs::write(path("system"), "").unwrap();
        assert_eq!(search(None, None, &path("system")).unwrap().database, path("system"));
        std::fs::write(path("daemon"), "").unwrap();
        let daemon = daemon(Some(path("daemon")));
        assert_eq!(search(None, Some(&daemon), &path("system")).unwrap().database, path("daemon"));
    }

    #[test]
    fn the_daemon_of_a_named_configuration_has_to_answer() {
        assert_eq!(of_named(Some(daemon(Some("/x".into())))).unwrap(), Path::new("/x"));
        for (silent, why) in [(Some(daemon(None)), "no daemon answers at http://d"), (None, "no loopback address")] {
            let error = of_named(silent).unwrap_err();
            assert_eq!(error.failure, Failure::Unreachable);
            assert!(error.message.contains(why) && error.message.contains("--data-dir"), "{}", error.message);
        }
    }

    #[test]
    fn a_database_with_two_names_is_no_other_one() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        std::fs::write(&real, "").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        let daemon = daemon(Some(real.clone()));
        let place = search(Some(link), Some(&daemon), Path::new("/nowhere")).unwrap();
        assert_eq!((&place.database, &place.whose), (&real, &None));
        assert_eq!(remark(&place, Some(&daemon)), None);
    }
}
