//! Metrics: counters since the start, and their OpenMetrics text together with the status snapshot.
//!
//! In: every [`Record`] of the capture ([`Metrics::record`], one or two atomic additions), the counts of the HTTP
//! server, and, for each scrape, the [`Status`] and the writer's figures. Out: text. There is no global registry and no
//! thread: a scrape reads only memory, and is answered even if the disk hangs.

use super::Status;
use imu_core::sample::{DiscardCause, GapCause, Record};
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Metric, Registry};
use std::fmt;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use strum::VariantArray;

/// Media type of [`Metrics::render`]'s text (OpenMetrics 1.0, section "Text Format").
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

type GaugeF64 = Gauge<f64, AtomicU64>;

/// The writer's counts since the start. They are the store's own figures, so that this module does not depend on the
/// store.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WriterFigures {
    /// Commits of batches.
    pub commits: u64,
    /// Commits that failed.
    pub failures: u64,
    /// Samples on disk, of captures written since the start.
    pub committed: u64,
    /// Failures because another process held the database.
    pub busy: u64,
    /// Commits that took longer than a second.
    pub slow_commits: u64,
    /// The duration of the slowest commit, s.
    pub slowest_commit_s: f64,
    /// Records that the schema refused: faults of this program.
    pub refused: u64,
    /// Samples committed per second of the store's clock, averaged over half a minute. Forecasts use the captures'
    /// time, even if that is accelerated.
    pub samples_per_s: f64,
}

/// Counters of this process, all since its start.
#[derive(Debug, Default)]
pub struct Metrics {
    samples: AtomicU64,
    segments: AtomicU64,
    gaps: [AtomicU64; GapCause::ALL.len()],
    missing: [AtomicU64; GapCause::ALL.len()],
    discarded: [AtomicU64; DiscardCause::ALL.len()],
    requests: [AtomicU64; STATUS_CLASSES.len()],
    connections: AtomicI64,
    connections_accepted: AtomicU64,
    connections_refused: AtomicU64,
    accept_failures: AtomicU64,
    overloaded: AtomicU64,
    wakes: Wakes,
}

/// The delays with which the reader woke, s.
#[derive(Debug)]
struct Wakes(Histogram);

impl Default for Wakes {
    fn default() -> Self {
        Self(Histogram::new(WAKE_BUCKETS_S))
    }
}

const WAKE_BUCKETS_S: [f64; 10] = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0];

const STATUS_CLASSES: [&str; 5] = ["1xx", "2xx", "3xx", "4xx", "5xx"];

fn add(counter: &AtomicU64, by: u64) {
    counter.fetch_add(by, Ordering::Relaxed);
}

fn read(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}

impl Metrics {
    /// Counts a record of a capture.
    pub fn record(&self, record: &Record) {
        match record {
            Record::Sample { .. } => add(&self.samples, 1),
            Record::Segment(_) => add(&self.segments, 1),
            Record::Gap(gap) => {
                // GapCause::ALL is in the order of the enum's variants.
                if let Some(counter) = self.gaps.get(gap.cause as usize) {
                    add(counter, 1);
                }
                if let Some(counter) = self.missing.get(gap.cause as usize) {
                    add(counter, gap.missing);
                }
            }
            Record::Discarded { cause, count } => {
                if let Some(counter) = self.discarded.get(*cause as usize) {
                    add(counter, *count);
                }
            }
            Record::Event(_)
            | Record::Configuration(_)
            | Record::DeviceClock { .. }
            | Record::UtcSet { .. }
            | Record::Ended { .. } => {}
        }
    }

    /// Counts the delay, s, with which the capture's reader woke: the system's and this program's other work cause it.
    pub fn reader_woke(&self, late_s: f64) {
        self.wakes.0.observe(late_s);
    }

    /// Counts a request by the status code of its answer.
    pub fn request(&self, status: u16) {
        if let Some(counter) = usize::from(status / 100).checked_sub(1).and_then(|class| self.requests.get(class)) {
            add(counter, 1);
        }
    }

    /// Counts a connection that was accepted and is open until [`Metrics::connection_closed`].
    pub fn connection_opened(&self) {
        add(&self.connections_accepted, 1);
        self.connections.fetch_add(1, Ordering::Relaxed);
    }

    /// Counts a connection's end.
    pub fn connection_closed(&self) {
        self.connections.fetch_sub(1, Ordering::Relaxed);
    }

    /// Counts a connection that was refused because there are too many.
    pub fn connection_refused(&self) {
        add(&self.connections_refused, 1);
    }

    /// Counts a connection that could not be accepted (no free file descriptor).
    pub fn accept_failed(&self) {
        add(&self.accept_failures, 1);
    }

    /// Counts a query that was refused because too many run.
    pub fn query_refused(&self) {
        add(&self.overloaded, 1);
    }

    /// Returns everything as OpenMetrics text. `uptime_s` is the process's age in seconds.
    ///
    /// # Errors
    /// [`fmt::Error`]: never for a text in memory.
    pub fn render(&self, status: &Status, writer: &WriterFigures, uptime_s: f64) -> Result<String, fmt::Error> {
        let mut registry = Registry::with_prefix("vn100d");
        let build = Info::new([("version", env!("CARGO_PKG_VERSION"))]);
        registry.register("build", "The program", build);
        gauge(&mut registry, "uptime_seconds", "Age of the process", uptime_s);
        self.capture(&mut registry);
        sensor(&mut registry, status);
        capture_now(&mut registry, status);
        storage(&mut registry, status, writer);
        jobs(&mut registry, status);
        unattended(&mut registry, status);
        share(&mut registry, status);
        self.http(&mut registry);
        let mut text = String::with_capacity(8192);
        prometheus_client::encoding::text::encode(&mut text, &registry)?;
        Ok(text)
    }

    fn capture(&self, registry: &mut Registry) {
        counter(registry, "samples", "Samples received", read(&self.samples));
        register(
            registry,
            "reader_wake_seconds",
            "How late the reader runs after it was to wake",
            self.wakes.0.clone(),
        );
        counter(registry, "segments", "Segments begun", read(&self.segments));
        let by_cause = |counters: &[AtomicU64]| {
            GapCause::ALL.iter().zip(counters).map(|(cause, counter)| (cause.name(), read(counter))).collect::<Vec<_>>()
        };
        counters(registry, "gaps", "Gaps by cause", "cause", by_cause(&self.gaps));
        counters(registry, "missing_samples", "Samples missing by cause", "cause", by_cause(&self.missing));
        let bytes = &self.discarded[DiscardCause::GarbageBytes as usize];
        counter(registry, "garbage_bytes", "Bytes that belong to no frame", read(bytes));
        let discarded = DiscardCause::ALL
            .iter()
            .zip(&self.discarded)
            .filter(|(cause, _)| **cause != DiscardCause::GarbageBytes)
            .map(|(cause, counter)| (cause.name(), read(counter)));
        counters(registry, "discarded_frames", "Frames that did not become a sample, by cause", "cause", discarded);
    }

    fn http(&self, registry: &mut Registry) {
        let classes = STATUS_CLASSES.iter().zip(&self.requests).map(|(class, counter)| (*class, read(counter)));
        counters(registry, "http_requests", "Requests answered, by class of status code", "status", classes);
        let open = self.connections.load(Ordering::Relaxed) as f64;
        gauge(registry, "http_connections", "Connections open", open);
        counter(registry, "http_connections_accepted", "Connections accepted", read(&self.connections_accepted));
        counter(registry, "http_connections_refused", "Connections turned away", read(&self.connections_refused));
        counter(
            registry,
            "http_accept_failures",
            "Connections that could not be accepted",
            read(&self.accept_failures),
        );
        counter(registry, "http_queries_refused", "Queries turned away: too many at once", read(&self.overloaded));
    }
}

fn sensor(registry: &mut Registry, status: &Status) {
    states(registry, "sensor_state", "1 for the state the sensor's connection is in", status.sensor.state);
    if let Some(rate_hz) = status.sensor.rate_hz {
        gauge(registry, "sensor_rate_hertz", "Output rate of the sensor", rate_hz);
    }
}

fn capture_now(registry: &mut Registry, status: &Status) {
    let Some(capture) = &status.capture else {
        return gauge(registry, "capture_running", "Whether a capture runs or waits", 0.0);
    };
    gauge(registry, "capture_running", "Whether a capture runs or waits", 1.0);
    gauge(registry, "capture_id", "Id of the capture that runs or waits", capture.id as f64);
    gauge(registry, "capture_elapsed_seconds", "Sample time it holds, received and missing", capture.elapsed_s);
    gauge(registry, "capture_remaining_seconds", "Sample time still to come", capture.remaining_s);
    gauge(registry, "capture_samples", "Samples it received", capture.samples as f64);
    gauge(registry, "capture_missing_samples", "Samples it misses", capture.missing as f64);
    gauge(registry, "capture_committed_samples", "Samples it has on disk", capture.committed as f64);
    if let Some(age_s) = capture.last_sample_age_s {
        gauge(registry, "capture_last_sample_age_seconds", "Age of its last sample", age_s);
    }
}

fn storage(registry: &mut Registry, status: &Status, writer: &WriterFigures) {
    let storage = &status.storage;
    states(registry, "storage_state", "1 for the state the store is in", storage.state);
    gauge(registry, "database_bytes", "Size of the database file", storage.database_bytes as f64);
    gauge(registry, "wal_bytes", "Size of the write-ahead log", storage.wal_bytes as f64);
    gauge(registry, "free_bytes", "Free space of the database's file system", storage.free_bytes as f64);
    gauge(registry, "queue_samples", "Samples waiting for the disk", storage.queued as f64);
    let oldest_s = storage.oldest_waiting_s.unwrap_or(0.0);
    gauge(registry, "queue_oldest_seconds", "For how long the oldest of them has waited", oldest_s);
    if let Some(took_s) = storage.last_commit_s {
        gauge(registry, "last_commit_seconds", "Duration of the last commit", took_s);
    }
    if let Some(age_s) = storage.last_commit_age_s {
        gauge(registry, "last_commit_age_seconds", "Age of the last commit", age_s);
    }
    if let Some(left_s) = storage.time_to_full_s {
        gauge(registry, "time_to_full_seconds", "How long the free space lasts at the present rate", left_s);
    }
    counter(registry, "commits", "Commits of batches", writer.commits);
    counter(registry, "commit_failures", "Commits that failed", writer.failures);
    counter(registry, "commits_busy", "Commits that another process's lock delayed", writer.busy);
    counter(registry, "commits_slow", "Commits that took longer than a second", writer.slow_commits);
    gauge(registry, "slowest_commit_seconds", "Duration of the slowest commit", writer.slowest_commit_s);
    let low = if storage.low_space { 1.0 } else { 0.0 };
    gauge(registry, "low_space", "1 while less than 1 GB, or than 12 hours' data, is free", low);
    counter(registry, "committed_samples", "Samples on disk", writer.committed);
    counter(registry, "refused_records", "Records that the schema refused: faults of this program", writer.refused);
    gauge(registry, "commit_rate_hertz", "Samples committed per second, over half a minute", writer.samples_per_s);
}

fn jobs(registry: &mut Registry, status: &Status) {
    gauge(registry, "jobs_queued", "Jobs that wait", status.jobs.queued as f64);
    gauge(registry, "jobs_running", "Jobs that run", status.jobs.running as f64);
    counter(registry, "jobs_done", "Jobs done", status.jobs.done);
    counter(registry, "jobs_failed", "Jobs failed", status.jobs.failed);
}

fn unattended(registry: &mut Registry, status: &Status) {
    let notify = &status.notify;
    let outcomes = [("sent", notify.sent), ("failed", notify.failed), ("dropped", notify.dropped)];
    counters(registry, "notifications", "Notifications by what became of them", "outcome", outcomes);
    gauge(registry, "notifications_queued", "Notifications that wait or are being sent", notify.queued as f64);
    counter(registry, "retention_deleted_captures", "Captures deleted by age or size", status.retention.deleted);
    let planned = status.retention.planned_total as f64;
    gauge(registry, "retention_planned_captures", "Captures that are going to be deleted", planned);
}

fn share(registry: &mut Registry, status: &Status) {
    let Some(share) = &status.share else { return };
    gauge(
        registry,
        "share_reading",
        "Whether a program has the shared terminal open",
        f64::from(u8::from(share.reading)),
    );
    counter(registry, "share_bytes", "Bytes that the shared terminal took for a program", share.bytes);
    counter(registry, "share_dropped_bytes", "Bytes that a program was too slow to take", share.dropped_bytes);
    counter(registry, "share_ignored_bytes", "Bytes that programs wrote to the shared terminal", share.ignored_bytes);
    gauge(registry, "share_clients", "Clients of the shared socket", share.clients as f64);
    counter(registry, "share_clients_refused", "Clients turned away: too many at once", share.clients_refused);
    counter(registry, "share_lines", "Samples sent to clients of the shared socket", share.lines);
    counter(registry, "share_lost_lines", "Samples that clients were too slow to take", share.lost_lines);
}

fn register(registry: &mut Registry, name: &str, help: &str, metric: impl Metric) {
    registry.register(name, help, metric);
}

fn gauge(registry: &mut Registry, name: &str, help: &str, value: f64) {
    let metric = GaugeF64::default();
    metric.set(value);
    register(registry, name, help, metric);
}

fn counter(registry: &mut Registry, name: &str, help: &str, value: u64) {
    let metric: Counter = Counter::default();
    metric.inc_by(value);
    register(registry, name, help, metric);
}

fn counters<'a>(
    registry: &mut Registry,
    name: &str,
    help: &str,
    label: &'static str,
    values: impl IntoIterator<Item = (&'a str, u64)>,
) {
    let family = Family::<Label, Counter>::default();
    for (value, count) in values {
        family.get_or_create(&Label { name: label, value: value.to_owned() }).inc_by(count);
    }
    register(registry, name, help, family);
}

fn states<S: VariantArray + PartialEq + Copy>(registry: &mut Registry, name: &str, help: &str, now: S)
where
    &'static str: From<S>,
{
    let family = Family::<Label, GaugeF64>::default();
    for state in S::VARIANTS {
        let is_now = if *state == now { 1.0 } else { 0.0 };
        let value = <&str>::from(*state).to_owned();
        family.get_or_create(&Label { name: "state", value }).set(is_now);
    }
    register(registry, name, help, family);
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Label {
    name: &'static str,
    value: String,
}

impl EncodeLabelSet for Label {
    fn encode(&self, encoder: &mut prometheus_client::encoding::LabelSetEncoder<'_>) -> Result<(), fmt::Error> {
        [(self.name, self.value.as_str())].encode(encoder)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observe::{CaptureStatus, JobsStatus, SensorState};
    use imu_core::sample::{Gap, Sample};

    fn render(metrics: &Metrics, status: &Status) -> String {
        metrics.render(status, &WriterFigures { commits: 12, samples_per_s: 40.0, ..Default::default() }, 1.5).unwrap()
    }

    #[test]
    fn what_a_capture_records_is_counted_by_cause() {
        let metrics = Metrics::default();
        for seq in 0..3 {
            metrics.record(&Record::Sample { seq, segment: 1, sample: Sample::at(0, 0) });
        }
        for cause in GapCause::ALL {
            metrics.record(&Record::Gap(Gap {
                before_seq: 3,
                from_utc_ns: 0,
                to_utc_ns: 1,
                device_ns: None,
                missing: 40 + cause as u64,
                missing_exact: true,
                cause,
            }));
        }
        metrics.record(&Record::Discarded { cause: DiscardCause::Checksum, count: 2 });
        metrics.record(&Record::Discarded { cause: DiscardCause::GarbageBytes, count: 17 });
        let text = render(&metrics, &Status::default());
        for line in ["vn100d_samples_total 3", "vn100d_garbage_bytes_total 17", "vn100d_commits_total 12"] {
            assert!(text.lines().any(|found| found == line), "{line} in {text}");
        }
        assert!(text.contains("vn100d_discarded_frames_total{cause=\"checksum\"} 2"), "{text}");
        for cause in GapCause::ALL {
            let line = format!("vn100d_missing_samples_total{{cause=\"{}\"}} {}", cause.name(), 40 + cause as u64);
            assert!(text.contains(&line), "{line} in {text}");
        }
    }

    #[test]
    fn the_status_is_among_the_metrics() {
        let mut status = Status { jobs: JobsStatus { queued: 2, done: 5, ..Default::default() }, ..Default::default() };
        status.sensor.state = SensorState::Stalled;
        status.storage.queued = 99;
        status.notify.failed = 4;
        status.retention.planned_total = 3;
        status.capture = Some(CaptureStatus {
            id: 7,
            name: "a".to_owned(),
            state: "capturing".to_owned(),
            elapsed_s: 10.0,
            remaining_s: 5.5,
            samples: 400,
            missing: 1,
            gaps: 1,
            committed: 360,
            received: 0,
            in_flight: 0,
            discarded: Default::default(),
            last_sample_age_s: None,
            gap_open_since: None,
        });
        let text = render(&Metrics::default(), &status);
        for line in [
            "vn100d_sensor_state{state=\"stalled\"} 1.0",
            "vn100d_sensor_state{state=\"streaming\"} 0.0",
            "vn100d_storage_state{state=\"ok\"} 1.0",
            "vn100d_queue_samples 99.0",
            "vn100d_capture_id 7.0",
            "vn100d_capture_remaining_seconds 5.5",
            "vn100d_jobs_queued 2.0",
            "vn100d_jobs_done_total 5",
            "vn100d_notifications_total{outcome=\"failed\"} 4",
            "vn100d_retention_planned_captures 3.0",
            "vn100d_uptime_seconds 1.5",
        ] {
            assert!(text.lines().any(|found| found == line), "{line} in {text}");
        }
        assert!(!text.contains("last_sample_age"), "nothing is said of what is not known");
        assert!(text.ends_with("# EOF\n"));
    }

    #[test]
    fn requests_are_counted_by_class() {
        let metrics = Metrics::default();
        for status in [200, 201, 404, 503, 99, 0, 999] {
            metrics.request(status);
        }
        let text = render(&metrics, &Status::default());
        for (class, count) in [("2xx", 2), ("4xx", 1), ("5xx", 1), ("3xx", 0)] {
            let line = format!("vn100d_http_requests_total{{status=\"{class}\"}} {count}");
            assert!(text.contains(&line), "{line} in {text}");
        }
    }
}
