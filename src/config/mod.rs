//! Configuration: a TOML file over built-in defaults, flags over the file.
//!
//! In: the text of one file, the flags of the command line, a few environment variables. Out: a [`Config`] in which
//! every value is in its range. Guarantees: an unknown key, a value of the wrong kind or out of range, and a listening
//! address that others can reach without a token are refused with file, line, key and the allowed values. Several files
//! are never merged: only the first that exists is used. The data directory is not a key: it determines the database of
//! a command, and must be the same for every command (docs/formats.md).

mod check;
mod error;
mod place;
mod sections;
mod source;
mod values;

pub use check::{ASCII_RATES_HZ, BAUDS, Refusal, TOKEN_LENGTH_MIN, check};
pub use error::{ConfigError, JOIN_GROUP, Place};
pub use place::Environment;
pub use sections::{
    CaptureConfig, Config, HttpConfig, LogConfig, NotifyConfig, ScheduleConfig, SensorConfig, ShareConfig,
    StorageConfig,
};
pub use values::{
    ASCII_TYPES, Baud, BinaryFields, Day, Device, FileMode, LogFormat, NightLength, Output, StartTime, Token, Webhook,
};

use source::Source;
use std::io::Read as _;
use std::net::SocketAddr;
use std::path::Path;

/// The values of the command line that override the file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Overrides {
    /// `--device`
    pub device: Option<String>,
    /// `--listen`
    pub listen: Option<SocketAddr>,
    /// A command that only queries needs no token. The file of the token, which only the daemon's user may be able to
    /// read, is then not read.
    pub without_token: bool,
}

/// Finds, reads and checks the configuration: `--config`, `VN100D_CONFIG`, `$XDG_CONFIG_HOME/vn100d/vn100d.toml`,
/// `/etc/vn100d/vn100d.toml`, else the defaults.
///
/// # Errors
/// [`ConfigError`]: exit code 78.
pub fn load(flag: Option<&Path>, environment: &Environment, overrides: &Overrides) -> Result<Config, ConfigError> {
    if let Some(file) = environment.named_config(flag) {
        let text = text_in(&file).map_err(|source| ConfigError::Read { file: file.clone(), source })?;
        return finish(&Source::new(&file, &text), overrides);
    }
    for file in environment.searched_configs() {
        match text_in(&file) {
            Ok(text) => return finish(&Source::new(&file, &text), overrides),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) if error.kind() == std::io::ErrorKind::NotADirectory => {}
            Err(source) => return Err(ConfigError::Read { file, source }),
        }
    }
    finish(&Source::new(Path::new(""), ""), overrides)
}

/// Reads and checks the text of a file.
///
/// # Errors
/// [`ConfigError`] with `file`, the line, the key and the allowed values.
pub fn parse(file: &Path, text: &str) -> Result<Config, ConfigError> {
    finish(&Source::new(file, text), &Overrides::default())
}

fn finish(source: &Source<'_>, overrides: &Overrides) -> Result<Config, ConfigError> {
    let mut config = source.read()?;
    if let Some(device) = &overrides.device {
        config.sensor.device = Device::parse(device).map_err(|allowed| ConfigError::Value {
            place: Place::Given,
            key: "sensor.device".to_owned(),
            found: format!("`{device}`"),
            allowed: format!("expected {allowed}"),
        })?;
    }
    if let Some(listen) = overrides.listen {
        config.http.listen = listen;
    }
    if !overrides.without_token {
        read_token(source, &mut config)?;
    }
    let from_file = !config.http.token_file.as_os_str().is_empty();
    check(&config).map_err(|refusal| ConfigError::Value {
        // The token of a file is not in the configuration, only the file's name.
        place: source.place(if refusal.key == "http.token" && from_file { "http.token-file" } else { refusal.key }),
        key: refusal.key.to_owned(),
        found: refusal.found,
        allowed: refusal.allowed,
    })?;
    if !overrides.without_token && !config.http.listen.ip().is_loopback() && config.http.token.is_empty() {
        let place = if overrides.listen.is_some() { Place::Given } else { source.place("http.listen") };
        return Err(ConfigError::TokenNeeded { place, listen: config.http.listen });
    }
    Ok(config)
}

/// The maximum size of a configuration or a token's file, in bytes.
const FILE_BYTES: u64 = 1 << 20;

/// Reads a small file. A pipe may never end and a device has no end, so that only a regular file is read.
fn text_in(file: &Path) -> std::io::Result<String> {
    let metadata = std::fs::metadata(file)?;
    let refuse = |reason| Err(std::io::Error::new(std::io::ErrorKind::InvalidInput, reason));
    if !metadata.is_file() {
        return refuse("expected a regular file");
    }
    if metadata.len() > FILE_BYTES {
        return refuse("expected a file of at most 1 MiB");
    }
    let mut text = String::new();
    // It may grow meanwhile.
    std::fs::File::open(file)?.take(FILE_BYTES).read_to_string(&mut text)?;
    Ok(text)
}

/// Reads the token from its separate file, so that the configuration may be readable by all users.
fn read_token(source: &Source<'_>, config: &mut Config) -> Result<(), ConfigError> {
    if config.http.token_file.as_os_str().is_empty() {
        return Ok(());
    }
    let place = source.place("http.token-file");
    if !config.http.token.is_empty() {
        return Err(ConfigError::Value {
            place,
            key: "http.token-file".to_owned(),
            found: format!("{}", config.http.token_file.display()),
            allowed: "`http.token` is set too: give one of them".to_owned(),
        });
    }
    let file = &config.http.token_file;
    let unreadable = |source| ConfigError::TokenFile { place: place.clone(), file: file.clone(), source };
    config.http.token = token_in(file).map_err(unreadable)?;
    if config.http.token.is_empty() {
        return Err(ConfigError::Value {
            place,
            key: "http.token-file".to_owned(),
            found: format!("{}, whose first line is empty", file.display()),
            allowed: "expected a file whose first line is the token".to_owned(),
        });
    }
    Ok(())
}

/// The path at which the package stores a token for this machine's users, readable by the group `vn100d`.
pub const MACHINE_TOKEN: &str = "/etc/vn100d/token";

/// Reads the token in a file, its first line.
///
/// # Errors
/// The error that the system reports.
pub fn token_in(file: &Path) -> std::io::Result<Token> {
    Ok(Token::new(text_in(file)?.lines().next().unwrap_or_default().trim()))
}

#[cfg(test)]
mod tests;
