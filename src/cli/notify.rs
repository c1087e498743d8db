//! `vn100d notify`: sends a test message to the configured receivers once, and reports the result.

use super::{CliError, Context, Failure, Outcome, failed, print_json};
use crate::clock::{Clock as _, SystemClock};
use crate::config::Overrides;
use crate::daemon::notices;
use crate::notify::Notice;
use crate::observe::NotifyEvent;
use std::io::Write as _;

/// Tries every receiver once, without the daemon.
pub(super) fn run(context: &Context) -> anyhow::Result<Outcome> {
    let config = context.load(&Overrides { without_token: true, ..Overrides::default() })?;
    let options = notices::options(&config, &context.database()?);
    if options.receivers.is_empty() {
        return Err(CliError {
            failure: Failure::Configuration,
            message: "nobody is to be told: set `notify.command` or `notify.url` in the configuration".to_owned(),
        }
        .into());
    }
    let message = Notice::new(NotifyEvent::Test, SystemClock.utc_ns()).rendered(&options.sender);
    let mut outcomes = Vec::new();
    for receiver in &options.receivers {
        let outcome = receiver.attempt(&message, options.effort.timeout, || true);
        outcomes.push((receiver.shown().to_owned(), outcome.err().map(|error| error.to_string())));
    }
    if context.json {
        let list: Vec<_> = outcomes
            .iter()
            .map(|(receiver, error)| serde_json::json!({ "receiver": receiver, "sent": error.is_none(), "error": error }))
            .collect();
        print_json(&list)?;
    } else {
        for (receiver, error) in &outcomes {
            let outcome = error.as_ref().map_or("told".to_owned(), |error| format!("not told: {error}"));
            writeln!(std::io::stdout(), "{receiver}: {outcome}")?;
        }
    }
    let refused = outcomes.iter().filter(|(_, error)| error.is_some()).count();
    if refused > 0 {
        return Err(failed(format!("{refused} of {} receivers did not take the test message", outcomes.len())));
    }
    Ok(Outcome::Done)
}
