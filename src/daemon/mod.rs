//! The daemon: connects the shells. It wires capture, store, jobs and HTTP together, and starts and stops them in
//! order.
//!
//! Start: the store first (a database that is locked or newer ends the program before anything is touched), then jobs,
//! capture and HTTP. Stop: imports are cancelled and the capture ends (the sensor's output is restored). Then jobs end,
//! then the store with everything that is queued, and HTTP last, so that the status is available to the end.

pub mod captures;
#[cfg(test)]
mod identities;
pub mod import;
pub mod notices;
pub mod publish;
mod reader;
mod reload;
pub mod retention;
pub mod schedule;
pub mod watchdog;

use crate::api;
use crate::capture::output::{Output, check_fit};
use crate::capture::recorder::ResumePoint;
use crate::capture::recorder_state::Sink;
use crate::capture::session::SessionOptions;
use crate::capture::task::{self, Progress, TaskCommand, TaskOptions};
use crate::clock::Clock;
use crate::config::{Baud, Config, Device};
use crate::control::{CaptureControl, CaptureRequest};
use crate::jobs::{JobError, Jobs, JobsOptions, Live, Place};
use crate::notify::{Notifier, Tap};
use crate::observe::{Metrics, RetentionStatus, SharedRecent, Status, Tally};
use crate::share::{Share, ShareError, ShareOptions, ShareTap};
use crate::store::{RecordSender, Refused, Store, StoreError, StoreOptions};
use imu_core::sample::{DiscardCause, Record, Sample};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

/// The time to restore the sensor's output.
const RESTORE: Duration = Duration::from_secs(4);
/// The time for an import to end: it checks every 64 KiB whether it is still wanted, and completes its last write.
const IMPORT_END: Duration = Duration::from_secs(1);
/// The interval at which the store's failures are examined.
const DISK_LOOK: Duration = Duration::from_millis(200);

/// Options of the daemon.
#[derive(Debug, Clone)]
pub struct Options {
    /// The database.
    pub database: PathBuf,
    /// The effective configuration; a changed one is applied as far as possible ([`reload`]).
    pub config: watch::Receiver<Config>,
    /// A capture to start at once, unless one is resumed.
    pub capture: Option<CaptureRequest>,
    /// The clock.
    pub clock: Arc<dyn Clock>,
}

/// The reasons why the daemon did not run.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// The database returned an error.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The disk failed.
    #[error("the disk failed three times within a minute: see the log, and `vn100d check` once it is well again")]
    Disk,
    /// The background jobs could not be started.
    #[error(transparent)]
    Jobs(#[from] JobError),
    /// The reader of the serial line could not be started.
    #[error("a thread for the serial line cannot be started: {0}")]
    Reader(std::io::Error),
    /// The wanted output is impossible.
    #[error("{0}")]
    Output(String),
    /// The HTTP interface cannot listen.
    #[error("cannot listen on {address}: {source}; choose another address with --listen, or stop what listens there")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The error message of the system.
        source: std::io::Error,
    },
    /// The notifications cannot be set up.
    #[error("a thread for notifications cannot be started: {0}")]
    Notify(std::io::Error),
    /// The live data cannot be shared as configured.
    #[error(transparent)]
    Share(#[from] ShareError),
    /// The requested capture was refused.
    #[error(transparent)]
    Control(#[from] crate::control::ControlError),
}

/// The handle of a running daemon.
#[derive(Debug, Clone)]
pub struct Handle {
    /// The address on which HTTP listens.
    pub address: SocketAddr,
    /// The status.
    pub status: watch::Receiver<Status>,
    /// The control of the capture.
    pub control: CaptureControl,
}

/// The queue to the store, which counts the records put into it.
struct Counted {
    records: RecordSender,
    metrics: Arc<Metrics>,
    tally: publish::SharedTally,
    recent: SharedRecent,
    tap: Tap,
    share: ShareTap,
}

impl Sink for Counted {
    fn room(&self) -> usize {
        self.records.room()
    }
    fn put(&self, capture_id: i64, record: Record) -> Result<(), Box<Record>> {
        // The capture task is the only one that puts records: present room stays available.
        if self.records.room() == 0 {
            return Err(Box::new(record));
        }
        self.metrics.record(&record);
        if let Record::Gap(gap) = &record {
            self.tap.gap(capture_id, gap);
        }
        match self.records.try_send(capture_id, record) {
            Err(Refused::Full(record)) => Err(Box::new(record)),
            // A closed queue means that the daemon is ending; the status and the log report the unwritten records.
            Ok(()) | Err(Refused::Closed(_)) => Ok(()),
        }
    }
    fn is_closed(&self) -> bool {
        self.records.is_closed()
    }
    fn tally(&self, tally: Tally) {
        *self.tally.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(tally);
    }
    fn bytes(&self, bytes: &[u8]) {
        self.share.bytes(bytes);
    }
    fn seen(&self, sample: &Sample) {
        self.recent.note(sample);
        self.share.sample(sample);
    }
    fn woke(&self, late: std::time::Duration) {
        self.metrics.reader_woke(late.as_secs_f64());
    }
}

/// Runs the daemon until `stop` is cancelled. `ready` receives the handle once everything runs.
///
/// # Errors
/// [`DaemonError`] if it cannot start, or if the disk did not accept everything at the end.
pub async fn run(
    options: Options,
    stop: CancellationToken,
    ready: impl FnOnce(Handle) + Send,
) -> Result<(), DaemonError> {
    let Options { database, config: configuration, capture, clock } = options;
    let config = configuration.borrow().clone();
    let session = session_options(&config)?;
    let address = config.http.listen;
    let listener = api::listen(address).map_err(|source| DaemonError::Listen { address, source })?;
    let address = listener.local_addr().map_err(|source| DaemonError::Listen { address, source })?;
    let store_options = StoreOptions {
        queue: config.storage.queue_samples(),
        clock: Arc::clone(&clock),
        file_check: config.storage.file_check,
        wal_alarm_bytes: config.storage.wal_alarm_mib << 20,
    };
    let store = tokio::task::spawn_blocking(move || Store::open(&database, store_options))
        .await
        .map_err(|_| StoreError::Closed)??;
    tracing::info!(database = %store.path().display(), version = env!("CARGO_PKG_VERSION"), "vn100d starts");

    let jobs = Jobs::start(&store, JobsOptions { place: Place::Apart, ..JobsOptions::default() })?;
    let live = Arc::new(Live::new());
    let metrics = Arc::new(Metrics::default());
    let notifier = Notifier::start(notices::options(&config, store.path())).map_err(DaemonError::Notify)?;
    let tap = notifier.tap();
    let share = Share::start(share_options(&config))?;

    let (task_sender, task_receiver) = mpsc::channel(16);
    let (progress_sender, progress) = watch::channel(Progress::default());
    let turns = Arc::new(AtomicU64::new(0));
    let tally = publish::SharedTally::default();
    let recent = SharedRecent::default();
    let task_options = TaskOptions { device: device(&config), session, seed: clock.mono_ns() };
    let source = device(&config).unwrap_or_else(|| "serial port".to_owned());
    let (control, commands) = CaptureControl::pair();
    let mut keeper = captures::Keeper::new(store.clone(), jobs.clone(), task_sender.clone(), progress.clone(), source);
    // The capture exists before the port is opened: it loses none of the sensor's first messages.
    if !keeper.resume(&*clock).await?
        && let Some(request) = capture
    {
        keeper.start(request).await?;
    }
    let reader = reader::start(task::run(
        task_options,
        Arc::clone(&clock),
        Box::new(Counted {
            records: store.records(),
            metrics: Arc::clone(&metrics),
            tally: Arc::clone(&tally),
            recent: recent.clone(),
            tap: tap.clone(),
            share: share.tap(),
        }),
        task_receiver,
        progress_sender,
        Arc::clone(&turns),
    ))?;

    let keeping = tokio::spawn(keeper.run(commands, stop.child_token()));

    let (status_sender, status) = watch::channel(Status::default());
    let publishing = CancellationToken::new();
    let (retention_sender, retention) = watch::channel(RetentionStatus::default());
    let (schedule_sender, schedule) = watch::channel(None);
    let reloading = tokio::spawn(
        reload::Reloading {
            store: store.clone(),
            jobs: jobs.clone(),
            control: control.clone(),
            tap: tap.clone(),
            clock: Arc::clone(&clock),
            retention: retention_sender,
            schedule: schedule_sender,
        }
        .run(configuration, stop.child_token()),
    );
    let unattended = publish::Unattended { retention, schedule, notify: notifier.figures(), share: share.figures() };
    let publisher = tokio::spawn(publish::run(
        store.clone(),
        jobs.clone(),
        unattended,
        publish::Captured { progress: progress.clone(), tally },
        Arc::clone(&clock),
        status_sender,
        publishing.clone(),
    ));

    let serving = CancellationToken::new();
    let limits = api::Limits::fitting(open_files());
    let reserve_bytes = config.storage.reserve_bytes();
    let importer =
        Arc::new(import::DaemonImporter::new(store.clone(), jobs.clone(), Arc::clone(&clock), reserve_bytes));
    let router = api::router(api::ApiParts {
        loopback: config.http.listen.ip().is_loopback(),
        importer: Arc::clone(&importer) as Arc<dyn crate::control::Importer>,
        status: status.clone(),
        control: control.clone(),
        store: store.clone(),
        jobs: jobs.clone(),
        live: Arc::clone(&live),
        metrics: Arc::clone(&metrics),
        recent,
        clock: Arc::clone(&clock),
        // A configured token is always required, on loopback too: others may use this machine.
        token: (!config.http.token.is_empty()).then(|| config.http.token.secret().to_owned()),
        default_duration: config.capture.duration,
        reserve_bytes,
        limits,
    });
    let server = tokio::spawn(api::serve(listener, router, limits, metrics, serving.clone()));
    let warming = tokio::spawn(publish::keep_warm(store.clone(), live, status.clone(), publishing.clone()));
    let ends = tokio::spawn(notices::report_ends(store.clone(), tap, status.clone(), publishing.clone()));
    let notifying = tokio::spawn(notifier.run(status.clone(), Arc::clone(&clock), publishing.clone()));
    let feeder = tokio::spawn(watchdog::feed(turns, store.clone(), publishing.clone()));

    tracing::info!(%address, "HTTP answers");
    watchdog::notify(&[sd_notify::NotifyState::Ready]);
    ready(Handle { address, status, control });

    let disk_failed = tokio::select! {
        () = stop.cancelled() => false,
        () = disk_fails(&store) => true,
    };
    tracing::info!("vn100d stops");
    watchdog::notify(&[sd_notify::NotifyState::Stopping]);
    importer.call_off();
    // The task may be gone already; then there is nothing to stop.
    let _ = task_sender.send(TaskCommand::Shutdown).await;
    if tokio::time::timeout(RESTORE, reader).await.is_err() {
        tracing::warn!("the sensor did not take its previous output back in time");
    }
    drop(share);
    // A disk that refuses writes may delay the keeper; the store reports the unwritten records.
    let mut keeping = keeping;
    if tokio::time::timeout(RESTORE, &mut keeping).await.is_err() {
        keeping.abort();
    }
    reloading.abort();
    importer.ended(IMPORT_END).await;
    let closed = {
        let store = store.clone();
        let ending = move || {
            jobs.stop();
            store.close()
        };
        tokio::task::spawn_blocking(ending).await.map_err(|_| StoreError::Closed)
    };
    publishing.cancel();
    serving.cancel();
    let _ = tokio::join!(publisher, warming, feeder, server, ends, notifying);
    closed??;
    if disk_failed { Err(DaemonError::Disk) } else { Ok(()) }
}

/// Waits until the disk has failed too often.
async fn disk_fails(store: &Store) {
    while !store.progress().gives_up() {
        tokio::time::sleep(DISK_LOOK).await;
    }
    if store.progress().damaged {
        tracing::error!("the database is damaged: the daemon ends, and writes nothing more to it");
    } else {
        tracing::error!("the disk has failed three times within a minute: the daemon ends, so that it is started anew");
    }
}

/// Raises the number of files that this process may have open, as far as the system allows; returns it.
fn open_files() -> u64 {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let limit = getrlimit(Resource::Nofile);
    let wanted = Rlimit { current: limit.maximum, maximum: limit.maximum };
    // If the soft limit may not be raised, it stays.
    let limit = if setrlimit(Resource::Nofile, wanted).is_ok() { wanted } else { limit };
    limit.current.unwrap_or(u64::MAX)
}

/// Returns the configured port or pattern; `None` is the usual places.
pub fn device(config: &Config) -> Option<String> {
    match &config.sensor.device {
        Device::Auto => None,
        other => Some(other.to_string()),
    }
}

/// Returns where the live data is shared.
fn share_options(config: &Config) -> ShareOptions {
    let path = |path: &std::path::Path| (!path.as_os_str().is_empty()).then(|| path.to_owned());
    let share = &config.share;
    ShareOptions { link: path(&share.link), socket: path(&share.socket), mode: share.mode.bits() }
}

/// Returns the options of the session, after checking that the line can carry the output.
///
/// # Errors
/// [`DaemonError::Output`] with the calculation, if the wanted output does not fit the configured baud rate (with
/// `auto`: the highest that is tried).
pub fn session_options(config: &Config) -> Result<SessionOptions, DaemonError> {
    let refuse = DaemonError::Output;
    let sensor = &config.sensor;
    let output = match &sensor.output {
        crate::config::Output::Binary => Output::Binary {
            fields: sensor.binary_fields.to_string(),
            divisor: sensor.rate_divisor().map(u32::from).ok_or_else(|| {
                refuse(format!("binary output has no rate of {} Hz: it is 800 Hz / n", sensor.rate_hz))
            })?,
        },
        crate::config::Output::Ascii(message) => Output::Ascii {
            number: vn100_proto::AsciiType::from_header(message.as_bytes())
                .map(vn100_proto::AsciiType::id)
                .ok_or_else(|| refuse(format!("`{message}` is no ASCII message of a VN-100")))?,
            rate_hz: sensor.rate_hz as u32,
        },
        crate::config::Output::Keep => Output::Keep,
    };
    let bauds = match sensor.baud {
        Baud::Auto => sensor.bauds.clone(),
        Baud::Fixed(baud) => vec![baud],
    };
    if let (Some((kind, rate_hz)), Some(highest)) = (output.kind_and_rate(), bauds.iter().max()) {
        check_fit(kind, rate_hz, *highest).map_err(refuse)?;
    }
    Ok(SessionOptions { output, bauds, host_jitter_ns: 0 })
}

/// Returns the point at which an unfinished capture resumes. `boot_id` and `mono_ns` are the clock's present values.
/// Within one boot of the host its monotonic clock shows how long the daemon was absent; across boots only civil time
/// does.
fn resume_point(unfinished: &crate::store::Unfinished, boot_id: Option<&str>, mono_ns: u64) -> ResumePoint {
    let same_boot = boot_id.is_some() && unfinished.boot_id.as_deref() == boot_id;
    let discarded: std::collections::BTreeMap<DiscardCause, u64> = (unfinished.rejected.iter())
        .filter_map(|(cause, count)| Some((DiscardCause::from_name(cause).filter(|cause| cause.is_frame())?, *count)))
        .collect();
    ResumePoint {
        segments: unfinished.segment,
        epoch: unfinished.epoch,
        samples: unfinished.samples,
        // A capture from a version that did not count begins with its samples and discards.
        received: unfinished.received.unwrap_or_else(|| unfinished.samples + discarded.values().sum::<u64>()),
        discarded,
        missing: unfinished.missing,
        gaps: unfinished.gaps,
        elapsed_ns: unfinished.sample_time_ns,
        last: unfinished.last.map(|(device_time_ns, host_mono_ns, host_utc_ns)| {
            imu_core::sample::accounting::Position {
                device_time_ns,
                sync_count: unfinished.last_sync_count,
                host_mono_ns: if same_boot && host_mono_ns <= mono_ns { host_mono_ns } else { 0 },
                host_utc_ns,
            }
        }),
        rate_hz: unfinished.stream.map(|(rate_hz, _)| rate_hz),
        // A capture belongs to the first sensor of which it has samples.
        serial_number: unfinished.sensor.serial_number().filter(|_| unfinished.samples > 0).map(str::to_owned),
        baud: unfinished.baud,
        previous_output: unfinished.configuration.previous_output(),
    }
}
