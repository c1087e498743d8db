//! `vn100d run`: the daemon in the foreground.

use super::args::RunArgs;
use super::hangup::Hangup;
use super::{Context, Outcome, sentence};
use crate::clock::{Clock, ScaledClock, SystemClock};
use crate::config::{LogFormat, Overrides};
use crate::control::CaptureRequest;
use crate::daemon::{self, Options};
use crate::observe::logging::{self, LogStyle};
use std::sync::Arc;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// Runs until SIGINT or SIGTERM (a second one ends at once), or until the terminal is gone ([`Hangup`]).
pub(super) fn run(context: &Context, args: &RunArgs) -> anyhow::Result<Outcome> {
    let listen = super::address(args.listen.as_deref())?;
    let overrides = Overrides { device: args.device.clone(), listen, ..Overrides::default() };
    let config = context.load(&overrides)?;
    logging::init(&config.log.level, LogStyle::of_process(config.log.format == LogFormat::Json))?;
    let clock: Arc<dyn Clock> =
        if args.speed == 1.0 { Arc::new(SystemClock) } else { Arc::new(ScaledClock::new(args.speed)) };
    let capture = args.capture.map(|duration| CaptureRequest { duration, ..CaptureRequest::default() });
    let (configuration, config) = watch::channel(config);
    let options = Options { database: context.database()?, config, capture, clock };
    let context = context.clone();
    let reload = move || match context.load(&overrides) {
        Ok(config) => drop(configuration.send_replace(config)),
        Err(error) => {
            tracing::error!("the configuration was not reloaded, the old one stays: {}", sentence(&error.into()));
        }
    };
    runtime()?.block_on(async {
        let stop = CancellationToken::new();
        stop_on_signal(stop.clone())?;
        Hangup::of_process(args.keep_on_hangup).heed(stop.clone(), reload)?;
        daemon::run(options, stop, |_| ()).await?;
        anyhow::Ok(())
    })?;
    Ok(Outcome::Done)
}

/// Returns the runtime of the daemon for everything except the reader, which has its own.
pub(super) fn runtime() -> std::io::Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).thread_name("vn100d").enable_all().build()
}

/// Lets SIGINT and SIGTERM stop the daemon; a second signal ends it without waiting.
pub(super) fn stop_on_signal(stop: CancellationToken) -> std::io::Result<()> {
    let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    tokio::spawn(async move {
        for turn in 0.. {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
            if turn > 0 {
                std::process::exit(130);
            }
            stop.cancel();
        }
    });
    Ok(())
}
