//! Logging: to standard error, for a person at a terminal, for journald, or as JSON.

use std::io::IsTerminal;
use std::sync::OnceLock;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{EnvFilter, Layer as _, Registry, fmt, reload};

/// Changes the log level while the program runs.
static FILTER: OnceLock<reload::Handle<EnvFilter, Registry>> = OnceLock::new();

/// The reasons why logging could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum LoggingError {
    /// The directives are invalid.
    #[error(
        "`{0}` is not a log level: allowed are error, warn, info, debug, trace, off, or directives such as info,vn100d::capture=debug"
    )]
    Level(String),
    /// Logging was set up before.
    #[error("logging is set up already")]
    Twice,
}

/// The style of log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LogStyle {
    /// One JSON object per line.
    pub json: bool,
    /// Whether lines are coloured.
    pub ansi: bool,
    /// Whether each line begins with a time.
    pub time: bool,
}

impl LogStyle {
    /// Returns the style for this process's standard error: colours on a terminal that supports them, no times if
    /// journald adds its own (it sets `JOURNAL_STREAM`).
    pub fn of_process(json: bool) -> Self {
        let terminal = std::io::stderr().is_terminal() && std::env::var_os("TERM").is_none_or(|term| term != "dumb");
        Self::of(json, terminal, std::env::var_os("NO_COLOR").is_some(), std::env::var_os("JOURNAL_STREAM").is_some())
    }

    fn of(json: bool, terminal: bool, no_color: bool, journald: bool) -> Self {
        Self { json, ansi: terminal && !no_color && !json, time: json || terminal || !journald }
    }
}

/// Sends this process's log to standard error. A line that cannot be written, because the terminal was closed, is lost
/// without further effect.
///
/// # Errors
/// [`LoggingError`] if `level` is invalid or logging was set up before.
pub fn init(level: &str, style: LogStyle) -> Result<(), LoggingError> {
    let (filter, handle) = reload::Layer::new(filter(level)?);
    let lines = fmt::layer().with_writer(std::io::stderr).with_ansi(style.ansi).log_internal_errors(false);
    let lines = match (style.json, style.time) {
        (true, _) => lines.json().flatten_event(true).boxed(),
        (false, true) => lines.boxed(),
        (false, false) => lines.without_time().boxed(),
    };
    tracing_subscriber::registry().with(filter).with(lines).try_init().map_err(|_| LoggingError::Twice)?;
    // Logging is set up only once, so this cell is empty.
    let _ = FILTER.set(handle);
    Ok(())
}

/// Changes the log level from now on.
///
/// # Errors
/// [`LoggingError::Level`] if `level` is invalid.
pub fn set_level(level: &str) -> Result<(), LoggingError> {
    let filter = filter(level)?;
    // Without a log there is no level to change.
    let _ = FILTER.get().map(|handle| handle.reload(filter));
    Ok(())
}

fn filter(level: &str) -> Result<EnvFilter, LoggingError> {
    EnvFilter::try_new(level).map_err(|_| LoggingError::Level(level.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_gets_colours_and_journald_no_times() {
        assert_eq!(LogStyle::of(false, true, false, false), LogStyle { json: false, ansi: true, time: true });
        assert_eq!(LogStyle::of(false, true, true, false), LogStyle { json: false, ansi: false, time: true });
        assert_eq!(LogStyle::of(false, false, false, true), LogStyle { json: false, ansi: false, time: false });
        assert_eq!(LogStyle::of(false, false, false, false), LogStyle { json: false, ansi: false, time: true });
        assert_eq!(LogStyle::of(true, true, false, true), LogStyle { json: true, ansi: false, time: true });
    }

    #[test]
    fn an_invalid_level_is_refused() {
        let style = LogStyle::of(false, false, false, false);
        assert!(matches!(init("loud,=", style), Err(LoggingError::Level(_))));
    }
}
