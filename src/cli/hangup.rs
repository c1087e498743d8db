//! SIGHUP: the terminal was closed, the SSH session was lost, or a manager wants the configuration to be read again.

use std::sync::Arc;
use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

/// The meaning of SIGHUP for this process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Hangup {
    /// End cleanly, because the user would not know of a capture that continues.
    Stop,
    /// Continue: the user asked for that, or started the process by `nohup`.
    Ignore,
    /// Read the configuration again: systemd started the process.
    Reload,
}

impl Hangup {
    /// Returns the meaning for this process. `keep_on` is set if the user wants to continue.
    pub(super) fn of_process(keep_on: bool) -> Self {
        let has = |name| std::env::var_os(name).is_some();
        // A desktop's terminal is itself a service, whose id its shells inherit.
        let is_service = has("NOTIFY_SOCKET") || has("INVOCATION_ID") && std::fs::File::open("/dev/tty").is_err();
        Self::of(keep_on || Self::is_ignored(), is_service)
    }

    fn of(goes_on: bool, is_service: bool) -> Self {
        match (goes_on, is_service) {
            (true, _) => Self::Ignore,
            (false, true) => Self::Reload,
            (false, false) => Self::Stop,
        }
    }

    /// Returns whether the process was started with the signal ignored, as `nohup` does. Must be called before a
    /// handler is installed.
    pub(super) fn is_ignored() -> bool {
        std::fs::read_to_string("/proc/self/status").is_ok_and(|status| ignores_hangup(&status))
    }

    /// Acts on each signal from here on. A second one changes nothing: the shell passes one on, and the kernel sends another.
    ///
    /// # Errors
    /// The error that the system reports.
    pub(super) fn heed(
        self,
        stop: CancellationToken,
        reload: impl Fn() + Send + Sync + 'static,
    ) -> std::io::Result<()> {
        let mut hangup = signal(SignalKind::hangup())?;
        let reload = Arc::new(reload);
        tokio::spawn(async move {
            while hangup.recv().await.is_some() {
                match self {
                    Self::Stop => {
                        tracing::info!("the terminal is gone (SIGHUP): vn100d stops");
                        stop.cancel();
                    }
                    Self::Ignore => tracing::info!("the terminal is gone (SIGHUP): vn100d goes on"),
                    Self::Reload => {
                        let reload = Arc::clone(&reload);
                        tokio::task::spawn_blocking(move || reload());
                    }
                }
            }
        });
        Ok(())
    }
}

/// Returns whether a process with this `/proc/PID/status` ignores SIGHUP, the first bit of its mask.
fn ignores_hangup(status: &str) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whoever_asked_to_go_on_goes_on_and_a_service_reloads() {
        assert_eq!(Hangup::of(false, false), Hangup::Stop);
        assert_eq!(Hangup::of(false, true), Hangup::Reload);
        assert_eq!([false, true].map(|service| Hangup::of(true, service)), [Hangup::Ignore; 2]);
    }

    #[test]
    fn the_mask_shows_whether_the_signal_was_ignored() {
        // SIGPIPE alone, as Rust's runtime has it; with SIGHUP, as nohup; neither.
        assert!(!ignores_hangup("Name:\tvn100d\nSigIgn:\t0000000000001000\nSigCgt:\t0000000000000001\n"));
        assert!(ignores_hangup("SigIgn:\t0000000000001001\n"));
        assert!(!ignores_hangup("Name:\tvn100d\n"));
    }
}
