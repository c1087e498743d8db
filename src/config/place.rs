//! The places where the configuration and the data are searched for (docs/formats.md).

use super::ConfigError;
use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// The environment variables in use, so that tests need not change those of their own process.
#[derive(Debug, Clone, Default)]
pub struct Environment(HashMap<String, OsString>);

impl Environment {
    /// The names of these variables.
    pub const NAMES: [&'static str; 6] =
        ["VN100D_CONFIG", "VN100D_DATA_DIR", "STATE_DIRECTORY", "XDG_CONFIG_HOME", "XDG_STATE_HOME", "HOME"];

    /// Returns the variables of this process.
    pub fn from_process() -> Self {
        Self(
            Self::NAMES
                .into_iter()
                .filter_map(|name| std::env::var_os(name).map(|value| (name.to_owned(), value)))
                .collect(),
        )
    }

    /// Returns the given variables; for tests.
    pub fn of<'a>(variables: impl IntoIterator<Item = (&'a str, &'a str)>) -> Self {
        Self(variables.into_iter().map(|(name, value)| (name.to_owned(), value.into())).collect())
    }

    /// Returns the variable's value; an empty one counts as absent.
    fn path(&self, name: &str) -> Option<PathBuf> {
        self.0.get(name).filter(|value| !value.is_empty()).map(PathBuf::from)
    }

    /// Returns the directory that holds the database: `--data-dir`, `VN100D_DATA_DIR`, `$STATE_DIRECTORY`,
    /// `$XDG_STATE_HOME/vn100d`, `~/.local/state/vn100d`.
    ///
    /// # Errors
    /// [`ConfigError::NoDataDirectory`] if none of these is set.
    pub fn data_dir(&self, flag: Option<&Path>) -> Result<PathBuf, ConfigError> {
        flag.map(Path::to_owned)
            .or_else(|| self.path("VN100D_DATA_DIR"))
            .or_else(|| self.state_directory())
            .or_else(|| self.path("XDG_STATE_HOME").map(|home| home.join("vn100d")))
            .or_else(|| self.path("HOME").map(|home| home.join(".local/state/vn100d")))
            .ok_or(ConfigError::NoDataDirectory)
    }

    /// Returns whether the directory of the database was named: by `--data-dir` or its variables, or by systemd.
    pub fn names_data_dir(&self, flag: Option<&Path>) -> bool {
        flag.is_some() || self.path("VN100D_DATA_DIR").is_some() || self.state_directory().is_some()
    }

    /// Returns whether a configuration was named.
    pub fn names_config(&self, flag: Option<&Path>) -> bool {
        self.named_config(flag).is_some()
    }

    /// Returns the first of the state directories, which systemd separates by colons: it is the one of this program.
    fn state_directory(&self) -> Option<PathBuf> {
        let all = self.path("STATE_DIRECTORY")?;
        let first = all.to_str().and_then(|text| text.split(':').next()).map(PathBuf::from);
        first.filter(|path| !path.as_os_str().is_empty())
    }

    /// Returns the file that must exist because it was named: `--config`, `VN100D_CONFIG`.
    pub(super) fn named_config(&self, flag: Option<&Path>) -> Option<PathBuf> {
        flag.map(Path::to_owned).or_else(|| self.path("VN100D_CONFIG"))
    }

    /// Returns the candidate files, of which the first that exists is used.
    pub(super) fn searched_configs(&self) -> Vec<PathBuf> {
        let user = self
            .path("XDG_CONFIG_HOME")
            .or_else(|| self.path("HOME").map(|home| home.join(".config")))
            .map(|home| home.join("vn100d/vn100d.toml"));
        user.into_iter().chain([PathBuf::from("/etc/vn100d/vn100d.toml")]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_data_directory_is_the_first_that_is_named() {
        let all =
            [("VN100D_DATA_DIR", "/a"), ("STATE_DIRECTORY", "/b:/other"), ("XDG_STATE_HOME", "/c"), ("HOME", "/d")];
        let expected = ["/a", "/b", "/c/vn100d", "/d/.local/state/vn100d"];
        for (skip, expected) in expected.into_iter().enumerate() {
            let environment = Environment::of(all[skip..].iter().copied());
            assert_eq!(environment.data_dir(None).unwrap(), Path::new(expected));
            assert_eq!(environment.data_dir(Some(Path::new("/flag"))).unwrap(), Path::new("/flag"));
        }
        assert!(matches!(Environment::default().data_dir(None), Err(ConfigError::NoDataDirectory)));
        assert!(matches!(Environment::of([("HOME", "")]).data_dir(None), Err(ConfigError::NoDataDirectory)));
    }

    #[test]
    fn the_user_s_configuration_comes_before_the_system_s() {
        let searched = Environment::of([("XDG_CONFIG_HOME", "/x"), ("HOME", "/h")]).searched_configs();
        assert_eq!(searched, [Path::new("/x/vn100d/vn100d.toml"), Path::new("/etc/vn100d/vn100d.toml")]);
        let searched = Environment::of([("HOME", "/h")]).searched_configs();
        assert_eq!(searched[0], Path::new("/h/.config/vn100d/vn100d.toml"));
    }
}
