//! Files that commands write: complete or not at all, never over an existing file without `--force`, and never over an
//! input.

use super::{CliError, Failure};
use crate::store::is_of_database;
use anyhow::Context as _;
use std::fs::{File, Permissions};
use std::io::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// Minimum number of bytes of a value: a digit and a comma, or one byte and its place in a row.
const LEAST_BYTES: u64 = 2;

/// A file to be written.
#[derive(Debug)]
pub(super) struct Output {
    path: PathBuf,
    to: To,
    force: bool,
}

#[derive(Debug)]
enum To {
    /// A temporary file beside the target, which takes its name at the end.
    Beside(NamedTempFile),
    /// A pipe or a device, which takes all data.
    Stream(File),
}

impl Output {
    /// Creates the output after checking that `path` may be written: it is not in `read`, it is not a database of
    /// captures, and the file does not exist or `force` is set.
    ///
    /// # Errors
    /// [`CliError`] for a file in the way; the system's error for the folder.
    pub(super) fn create(path: &Path, force: bool, read: &[&Path]) -> anyhow::Result<Self> {
        Self::create_by("--force", path, force, read)
    }

    /// Creates the output if another option replaces a file.
    ///
    /// # Errors
    /// The errors of [`Output::create`].
    pub(super) fn create_by(option: &str, path: &Path, force: bool, read: &[&Path]) -> anyhow::Result<Self> {
        let refuse = |failure, message| anyhow::Error::from(CliError { failure, message });
        let shown = path.display();
        if read.iter().any(|other| is_same(path, other)) {
            return Err(refuse(Failure::Usage, format!("{shown} is read: write to another file")));
        }
        if is_of_database(path) {
            let message = format!(
                "{shown} is a database of captures or belongs to one: {option} does not replace it, choose another name"
            );
            return Err(refuse(Failure::Usage, message));
        }
        let cannot = || format!("{shown} cannot be written");
        let to = match path.metadata() {
            Ok(found) if found.is_file() && !force => {
                let message = format!("{shown} exists already: choose another name, or say {option} to replace it");
                return Err(refuse(Failure::CannotCreate, message));
            }
            Ok(found) if !found.is_file() => To::Stream(File::create(path).with_context(cannot)?),
            _ => {
                let mut builder = tempfile::Builder::new();
                builder.prefix(".vn100d-").permissions(Permissions::from_mode(0o666));
                // The crate's own error names the temporary file, which the user does not know.
                let beside = || builder.tempfile_in(folder(path)).map_err(|error| error.kind().into());
                let made = folder(path).metadata().and_then(|_| beside());
                To::Beside(made.with_context(cannot)?)
            }
        };
        Ok(Self { path: path.to_owned(), to, force })
    }

    /// Returns the name.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the file to write to.
    pub(super) fn file(&self) -> &File {
        match &self.to {
            To::Beside(file) => file.as_file(),
            To::Stream(file) => file,
        }
    }

    /// Writes the whole file and gives it its name.
    ///
    /// # Errors
    /// The errors of [`Output::keep`], and an error if there is no room.
    pub(super) fn put(self, bytes: &[u8]) -> anyhow::Result<()> {
        let written = self.file().write_all(bytes);
        written.with_context(|| format!("{} cannot be written", self.path.display()))?;
        self.keep()
    }

    /// Gives the file its name, which makes it visible.
    ///
    /// # Errors
    /// The error that the system reports, also if the file was created meanwhile and `force` was not set.
    pub(super) fn keep(self) -> anyhow::Result<()> {
        let To::Beside(file) = self.to else { return Ok(()) };
        let kept = if self.force { file.persist(&self.path) } else { file.persist_noclobber(&self.path) };
        kept.map(drop)
            .map_err(|error| error.error)
            .with_context(|| format!("{} cannot be written", self.path.display()))
    }
}

/// Refuses so many values that they do not fit the disk of `path`.
///
/// # Errors
/// [`CliError`] with the needed and the free space.
pub(super) fn refuse_without_room(path: &Path, values: u64) -> anyhow::Result<()> {
    const GB: f64 = 1e9;
    // If the system does not report free space, writing will show it.
    let Ok(statistics) = rustix::fs::statvfs(folder(path)) else { return Ok(()) };
    let (free, needed) = (statistics.f_bavail.saturating_mul(statistics.f_frsize), values.saturating_mul(LEAST_BYTES));
    if needed <= free {
        return Ok(());
    }
    let message = format!(
        "{} would hold {values} values, at least {:.1} GB; {:.1} GB are free there",
        path.display(),
        needed as f64 / GB,
        free as f64 / GB
    );
    Err(CliError { failure: Failure::InputOutput, message }.into())
}

/// Returns whether two paths lead to the same file, whether it exists or not.
pub(super) fn is_same(one: &Path, other: &Path) -> bool {
    let place = |path: &Path| {
        path.canonicalize().ok().or_else(|| Some(folder(path).canonicalize().ok()?.join(path.file_name()?)))
    };
    one == other || place(one).is_some_and(|place_of_one| place(other) == Some(place_of_one))
}

fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_created_whole_and_only_if_none_exists_or_with_force() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.csv");
        let write = |force, text: &str| {
            let output = Output::create(&path, force, &[])?;
            output.file().write_all(text.as_bytes())?;
            output.keep()
        };
        drop(Output::create(&path, false, &[]).unwrap());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        write(false, "one").unwrap();
        assert!(write(false, "two").unwrap_err().to_string().contains("say --force to replace it"));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "one");
        write(true, "two").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "two");
        // A file that was created meanwhile stays.
        let (late, output) =
            (folder.path().join("late.csv"), Output::create(&folder.path().join("late.csv"), false, &[]));
        std::fs::write(&late, "theirs").unwrap();
        assert!(output.unwrap().keep().unwrap_err().to_string().contains("late.csv cannot be written"));
        assert_eq!(std::fs::read_to_string(&late).unwrap(), "theirs");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn what_is_read_is_known_by_any_of_its_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("model.json"), "{}").unwrap();
        std::os::unix::fs::symlink(path("model.json"), path("link")).unwrap();
        std::fs::create_dir(path("sub")).unwrap();
        for name in ["model.json", "link", "sub/../model.json"] {
            let refused = Output::create(&path(name), true, &[&path("model.json")]).unwrap_err();
            assert!(refused.to_string().contains("is read"), "{refused}");
        }
        assert!(is_same(&path("new.csv"), &path("sub/../new.csv")) && !is_same(&path("new.csv"), &path("sub/new.csv")));
    }

    #[test]
    fn a_folder_that_is_not_there_is_reported_by_the_name_that_was_given() {
        let refused = Output::create(Path::new("/nowhere/out.csv"), false, &[]).unwrap_err();
        assert_eq!(
            format!("{refused:#}"),
            "/nowhere/out.csv cannot be written: No such file or directory (os error 2)"
        );
        assert!(refuse_without_room(Path::new("out.csv"), 1000).is_ok());
        let refused = refuse_without_room(Path::new("out.csv"), u64::MAX).unwrap_err().to_string();
        assert!(refused.contains("out.csv would hold") && refused.contains("GB are free there"), "{refused}");
    }
}
