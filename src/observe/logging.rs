//! Logging: to standard error, for a person at a terminal, for journald, or as JSON.

use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format::FmtSpan;

/// Why logging could not be set up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LoggingError {
    /// The directives cannot be read.
    #[error(
        "`{found}` is not a log level: allowed are error, warn, info, debug, trace, off, or directives such as info,vn100d::capture=debug"
    )]
    Level {
        /// What was given.
        found: String,
    },
    /// It was set up before.
    #[error("logging is set up already")]
    Twice,
}

/// How lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LogStyle {
    /// One JSON object per line.
    pub json: bool,
    /// Colours.
    pub ansi: bool,
    /// A time in front of each line.
    pub time: bool,
}

impl LogStyle {
    /// The style for this process's standard error: colours on a terminal that wants them, no times where journald
    /// adds its own (it sets `JOURNAL_STREAM`).
    #[must_use]
    pub fn of_process(json: bool) -> Self {
        let terminal = std::io::stderr().is_terminal() && std::env::var_os("TERM").is_none_or(|term| term != "dumb");
        Self::of(json, terminal, std::env::var_os("NO_COLOR").is_some(), std::env::var_os("JOURNAL_STREAM").is_some())
    }

    fn of(json: bool, terminal: bool, no_color: bool, journald: bool) -> Self {
        Self { json, ansi: terminal && !no_color && !json, time: json || terminal || !journald }
    }
}

/// Sends this process's log to standard error.
///
/// # Errors
/// [`LoggingError`] where `level` is none or logging is set up already.
pub fn init(level: &str, style: LogStyle) -> Result<(), LoggingError> {
    let filter = EnvFilter::try_new(level).map_err(|_| LoggingError::Level { found: level.to_owned() })?;
    let lines = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(style.ansi)
        .with_span_events(FmtSpan::NONE);
    let outcome = match (style.json, style.time) {
        (true, _) => lines.json().flatten_event(true).try_init(),
        (false, true) => lines.try_init(),
        (false, false) => lines.without_time().try_init(),
    };
    outcome.map_err(|_| LoggingError::Twice)
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
    fn a_level_that_is_none_is_refused() {
        let style = LogStyle::of(false, false, false, false);
        assert!(matches!(init("loud,=", style), Err(LoggingError::Level { .. })));
    }
}
