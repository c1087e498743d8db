//! Reload: applies a changed configuration to the parts that support it while the daemon runs.
//!
//! The log's level, the schedule and the limits of retention take effect at once: both tasks are ended and started
//! again, as at a restart of the daemon, and the capture is unaffected. Every other changed key is reported as one that
//! requires a restart.

use super::{retention, schedule, session_options, watchdog};
use crate::clock::{self, Clock};
use crate::config::{self, Config};
use crate::control::CaptureControl;
use crate::jobs::Jobs;
use crate::notify::Tap;
use crate::observe::{RetentionStatus, ScheduleStatus, logging};
use crate::store::Store;
use serde_json::Value;
use std::sync::Arc;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

/// Runs retention and schedule with the present configuration.
#[derive(Debug)]
pub(super) struct Reloading {
    pub(super) store: Store,
    pub(super) jobs: Jobs,
    pub(super) control: CaptureControl,
    pub(super) tap: Tap,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) retention: watch::Sender<RetentionStatus>,
    pub(super) schedule: watch::Sender<Option<ScheduleStatus>>,
}

impl Reloading {
    /// Runs them until `stop`, and applies each new configuration as far as possible.
    pub(super) async fn run(self, mut configuration: watch::Receiver<Config>, stop: CancellationToken) {
        let mut effective = configuration.borrow_and_update().clone();
        loop {
            let part = stop.child_token();
            let mut tasks = self.begin(&effective, &part);
            let next = loop {
                // Once no new configuration can arrive, this one stays.
                tokio::select! {
                    Ok(()) = configuration.changed() => {}
                    () = stop.cancelled() => return,
                }
                watchdog::reloading();
                let wanted = configuration.borrow_and_update().clone();
                match taken(&effective, &wanted) {
                    Ok(next) => {
                        report(&effective, &next, &wanted);
                        if next != effective {
                            break next;
                        }
                    }
                    Err(reason) => tracing::error!("the configuration was not reloaded, the old one stays: {reason}"),
                }
                watchdog::notify(&[sd_notify::NotifyState::Ready]);
            };
            if let Err(error) = logging::set_level(&next.log.level) {
                tracing::error!(%error, "the log keeps its level");
            }
            part.cancel();
            while tasks.join_next().await.is_some() {}
            effective = next;
            watchdog::notify(&[sd_notify::NotifyState::Ready]);
        }
    }

    fn begin(&self, config: &Config, stop: &CancellationToken) -> JoinSet<()> {
        let mut tasks = JoinSet::new();
        let retention = retention::Retention {
            store: self.store.clone(),
            jobs: self.jobs.clone(),
            tap: self.tap.clone(),
            clock: Arc::clone(&self.clock),
            limits: retention::limits(config),
        };
        tasks.spawn(retention.run(self.retention.clone(), stop.clone()));
        match schedule::schedule(config) {
            Some(schedule) => {
                let scheduler = schedule::Scheduler {
                    store: self.store.clone(),
                    control: self.control.clone(),
                    tap: self.tap.clone(),
                    clock: Arc::clone(&self.clock),
                    zone: clock::local_offset_s,
                    schedule,
                };
                tasks.spawn(scheduler.run(self.schedule.clone(), stop.clone()));
            }
            None => drop(self.schedule.send_replace(None)),
        }
        tasks
    }
}

/// Returns the present configuration with the applicable parts of the wanted one.
///
/// # Errors
/// The reason why the wanted one is invalid, or contradicts a part that requires a restart.
fn taken(effective: &Config, wanted: &Config) -> Result<Config, String> {
    session_options(wanted).map_err(|error| error.to_string())?;
    let mut taken = effective.clone();
    taken.log.level.clone_from(&wanted.log.level);
    taken.schedule.clone_from(&wanted.schedule);
    taken.storage.keep_days = wanted.storage.keep_days;
    taken.storage.keep_mib = wanted.storage.keep_mib;
    taken.storage.delete_notice = wanted.storage.delete_notice;
    config::check(&taken).map_err(|refusal| {
        format!("`{}` is {} beside what needs a restart: {}", refusal.key, refusal.found, refusal.allowed)
    })?;
    Ok(taken)
}

/// Logs which changes take effect now, and which only after a restart.
fn report(before: &Config, now: &Config, wanted: &Config) {
    let (changed, waiting) = (differing(before, now), differing(now, wanted));
    if changed.is_empty() && waiting.is_empty() {
        tracing::info!("the configuration was read again: nothing has changed");
    }
    if !changed.is_empty() {
        tracing::info!("the configuration was reloaded, these keys take effect now: {}", changed.join(", "));
    }
    if !waiting.is_empty() {
        tracing::warn!("these keys of the configuration take effect after a restart: {}", waiting.join(", "));
    }
}

/// Returns the keys in which two configurations differ, with their sections, in alphabetical order.
fn differing(one: &Config, other: &Config) -> Vec<String> {
    let values = |config: &Config| serde_json::to_value(config).unwrap_or_default();
    let (values_of_one, values_of_other) = (values(one), values(other));
    let mut keys = Vec::new();
    for (section, inner) in values_of_one.as_object().into_iter().flatten() {
        let differs = |(key, value): &(&String, &Value)| values_of_other[section][key.as_str()] != **value;
        let inner = inner.as_object().into_iter().flatten().filter(differs);
        keys.extend(inner.map(|(key, _)| format!("{section}.{key}")));
    }
    // Secrets are not written out.
    let secrets =
        [("http.token", one.http.token != other.http.token), ("notify.url", one.notify.url != other.notify.url)];
    keys.extend(secrets.into_iter().filter(|(_, differs)| *differs).map(|(key, _)| key.to_owned()));
    keys.sort_unstable();
    keys.dedup();
    keys
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn read(text: &str) -> Config {
        config::parse(Path::new("x.toml"), text).unwrap()
    }

    #[test]
    fn what_can_be_taken_is_taken_and_the_rest_is_named() {
        let before = read("[http]\ntoken = \"0123456789abcdef\"\n[notify]\nurl = \"https://host/one\"");
        let wanted = read(
            "[http]\ntoken = \"0123456789abcdeg\"\n[notify]\nurl = \"https://host/two\"\n[log]\nlevel = \"debug\"\n\
             [storage]\nkeep-days = 7\nreserve-mib = 600\n[schedule]\nat = \"22:00\"\nduration = \"8h\"\n\
             [capture]\nduration = \"6h\"\n[share]\nlink = \"/run/vn100d/tty\"",
        );
        let now = taken(&before, &wanted).unwrap();
        assert_eq!(differing(&before, &now), ["log.level", "schedule.at", "schedule.duration", "storage.keep-days"]);
        let waiting = ["capture.duration", "http.token", "notify.url", "share.link", "storage.reserve-mib"];
        assert_eq!(differing(&now, &wanted), waiting);
        assert_eq!(taken(&now, &now), Ok(now));
    }

    #[test]
    fn what_is_wrong_or_does_not_go_with_what_stays_is_refused_as_a_whole() {
        let slow = read("[sensor]\nbaud = 9600\nrate-hz = 800.0");
        assert!(taken(&Config::default(), &slow).unwrap_err().contains("560000 bit/s"));
        // The night would use the duration that only a restart applies.
        let long = read("[capture]\nduration = \"30h\"");
        let nightly = read("[schedule]\nat = \"22:00\"");
        let refused = taken(&long, &nightly).unwrap_err();
        assert!(refused.contains("`capture.duration` is 30h beside what needs a restart"), "{refused}");
    }
}
