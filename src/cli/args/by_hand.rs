//! Arguments of the commands that change the running daemon's captures.

use super::ClientArgs;
use super::complete;
use chrono::{DateTime, FixedOffset};
use clap::Args;
use imu_core::units::parse_duration;

/// Arguments of `start`.
#[derive(Debug, Args)]
pub struct StartArgs {
    /// Sample time to record, such as 5h (default: the daemon's configuration)
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    pub duration: Option<String>,
    /// Name of the capture, with a number if it is taken (default: date and time)
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// A note about it, such as "on foam, 23 °C"
    #[arg(long, value_name = "TEXT")]
    pub note: Option<String>,
    /// Begin at this time, RFC 3339 such as 2026-11-21T22:00:00+01:00 (default: now)
    #[arg(long, value_name = "T", value_parser = DateTime::parse_from_rfc3339)]
    pub at: Option<DateTime<FixedOffset>>,
    /// The daemon
    #[command(flatten)]
    pub client: ClientArgs,
}

/// Arguments of `stop`.
#[derive(Debug, Args)]
pub struct StopArgs {
    /// Id, name or `latest` (default: the capture that runs or waits)
    #[arg(value_name = "CAPTURE", add = complete::captures_of_daemon())]
    pub capture: Option<String>,
    /// The daemon
    #[command(flatten)]
    pub client: ClientArgs,
}

/// Arguments of `pin` and `unpin`.
#[derive(Debug, Args)]
pub struct PinArgs {
    /// Ids, names or `latest`
    #[arg(required = true, value_name = "CAPTURE", add = complete::captures_of_daemon())]
    pub captures: Vec<String>,
    /// The daemon
    #[command(flatten)]
    pub client: ClientArgs,
}

/// Arguments of `delete`.
#[derive(Debug, Args)]
pub struct DeleteArgs {
    /// Ids, names or `latest`
    #[arg(required = true, value_name = "CAPTURE", add = complete::captures_of_daemon())]
    pub captures: Vec<String>,
    /// Delete without asking; required if standard input is no terminal
    #[arg(long)]
    pub yes: bool,
    /// The daemon
    #[command(flatten)]
    pub client: ClientArgs,
}

/// Arguments of `rename`.
#[derive(Debug, Args)]
pub struct RenameArgs {
    /// Id, name or `latest`
    #[arg(value_name = "CAPTURE", add = complete::captures_of_daemon())]
    pub capture: String,
    /// The new name
    #[arg(value_name = "NAME")]
    pub name: String,
    /// The daemon
    #[command(flatten)]
    pub client: ClientArgs,
}

/// Arguments of `note`.
#[derive(Debug, Args)]
pub struct NoteArgs {
    /// Id, name or `latest`
    #[arg(value_name = "CAPTURE", add = complete::captures_of_daemon())]
    pub capture: String,
    /// The note, one line of at most 1000 characters; "" removes it
    #[arg(value_name = "TEXT")]
    pub text: String,
    /// The daemon
    #[command(flatten)]
    pub client: ClientArgs,
}

/// Returns the text if it is a duration: the daemon reads it again.
fn duration(text: &str) -> Result<String, String> {
    parse_duration(text).map(|_| text.to_owned()).map_err(|error| error.to_string())
}
