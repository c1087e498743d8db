//! The reasons why a configuration was refused. All of these are exit code 78.

use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;

/// The origin of a value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// A line of a file, from 1.
    Line {
        /// The file.
        file: PathBuf,
        /// The line.
        line: usize,
    },
    /// The command line or the environment.
    Given,
    /// A built-in default that another value makes invalid.
    Default,
}

impl fmt::Display for Place {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line { file, line } => write!(formatter, "{}:{line}", file.display()),
            Self::Given => formatter.write_str("command line or environment"),
            Self::Default => formatter.write_str("built-in default"),
        }
    }
}

/// Returns a hint that explains how a user who may not read a token's file gets access.
fn token_hint(source: &std::io::Error) -> &'static str {
    if source.kind() == std::io::ErrorKind::PermissionDenied { JOIN_GROUP } else { "" }
}

/// The maximum number of characters of each end of a text from the file that a message has.
const END_CHARS: usize = 300;

/// Returns a text that comes from the file without the middle of a long one. Its end may be what a parser expected.
fn short(text: &str) -> String {
    let count = text.chars().count();
    if count <= 2 * END_CHARS {
        return text.to_owned();
    }
    let (head, tail) = (text.chars().take(END_CHARS), text.chars().skip(count - END_CHARS));
    head.chain(['…']).chain(tail).collect()
}

/// The remedy for a user who may not read the token that the package created.
pub const JOIN_GROUP: &str = "; the package's token is for the group vn100d: add yourself to it (`sudo usermod -aG vn100d \
                              $USER`) and log in again";

/// The reasons why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A file that was named explicitly cannot be read.
    #[error("cannot read the configuration {file}: {source}")]
    Read {
        /// The file.
        file: PathBuf,
        /// The error that the system reported.
        source: std::io::Error,
    },
    /// The text is not TOML.
    #[error("{file}:{line}: this is not TOML: {}", short(problem), file = file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The parser's message.
        problem: String,
    },
    /// A key that does not exist.
    #[error("{place}: there is no key `{}`: allowed here are {}", short(key), allowed.join(", "))]
    UnknownKey {
        /// The place of the key.
        place: Place,
        /// The key with its section.
        key: String,
        /// The keys of that section.
        allowed: Vec<String>,
    },
    /// An invalid value of a key.
    #[error("{place}: `{}` is {}: {}", short(key), short(found), short(allowed))]
    Value {
        /// The place of the value.
        place: Place,
        /// The key with its section.
        key: String,
        /// The value as written.
        found: String,
        /// The allowed values.
        allowed: String,
    },
    /// The interface would be open to anyone.
    #[error(
        "{place}: `http.listen` is {listen}, which others can reach: set `http.token` or `http.token-file`, or listen \
         on 127.0.0.1"
    )]
    TokenNeeded {
        /// The place of the address.
        place: Place,
        /// The address.
        listen: SocketAddr,
    },
    /// The token cannot be read.
    #[error("{place}: `http.token-file`: cannot read {file}: {source}{}", token_hint(source))]
    TokenFile {
        /// The place of the file's name.
        place: Place,
        /// The file.
        file: PathBuf,
        /// The error that the system reported.
        source: std::io::Error,
    },
    /// No data directory is configured.
    #[error(
        "there is no place for the data: give --data-dir, or set VN100D_DATA_DIR, STATE_DIRECTORY, XDG_STATE_HOME or HOME"
    )]
    NoDataDirectory,
}
