//! The interface's guarantees, tested by real requests to a real server over a real database.

mod analysis;
mod captures;
mod comparison;
mod daemon;
mod diagnoses;
mod limits;
mod lists;
mod samples;

use super::{ApiParts, Limits, listen, router, serve};
use crate::control::{
    CaptureControl, CaptureRequest, Command, ControlError, ImportError, ImportReport, ImportRequest, Importer,
};
use crate::jobs::{Jobs, JobsOptions, Live};
use crate::observe::{Metrics, SharedRecent, Status};
use crate::store::{CaptureState, NewCapture, Store, StoreOptions};
use imu_core::sample::{Channel, Gap, GapCause, Record, Sample, Segment, Timebase};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

const START_NS: i64 = 1_800_000_000_000_000_000;
const PERIOD_NS: u64 = 25_000_000;

/// Takes no recording; tests/faults tests the built daemon's importer.
#[derive(Debug)]
struct NoImports;

impl Importer for NoImports {
    fn import(&self, request: ImportRequest) -> Result<ImportReport, ImportError> {
        let bytes = std::fs::read(&request.file).unwrap();
        Err(ImportError::Recording(format!("{} has {} bytes", request.called, bytes.len())))
    }
}

/// A server over a separate database, until dropped.
pub(super) struct World {
    pub(super) store: Store,
    pub(super) jobs: Jobs,
    pub(super) status: watch::Sender<Status>,
    pub(super) metrics: Arc<Metrics>,
    /// The requests to the capture's side.
    pub(super) started: Arc<Mutex<Vec<CaptureRequest>>>,
    pub(super) address: SocketAddr,
    pub(super) stop: CancellationToken,
    runtime: Option<tokio::runtime::Runtime>,
    _directory: tempfile::TempDir,
}

/// The differences between worlds.
#[derive(Default)]
pub(super) struct Setting {
    pub(super) token: Option<String>,
    pub(super) limits: Limits,
    pub(super) live: Live,
}

impl World {
    pub(super) fn new() -> Self {
        Self::with(Setting::default())
    }

    pub(super) fn with(setting: Setting) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let store = Store::open(&directory.path().join("vn100d.db"), StoreOptions::default()).unwrap();
        let jobs = Jobs::start(&store, JobsOptions::default()).unwrap();
        let mut healthy = Status::default();
        healthy.storage.free_bytes = 10 << 30;
        let (status, watched) = watch::channel(healthy);
        let metrics = Arc::new(Metrics::default());
        let (control, mut commands) = CaptureControl::pair();
        let started = Arc::new(Mutex::new(Vec::new()));
        let parts = ApiParts {
            status: watched,
            control,
            store: store.clone(),
            jobs: jobs.clone(),
            live: Arc::new(setting.live),
            metrics: Arc::clone(&metrics),
            recent: SharedRecent::default(),
            clock: Arc::new(crate::clock::SystemClock),
            token: setting.token,
            loopback: true,
            importer: Arc::new(NoImports),
            default_duration: Duration::from_secs(18_000),
            reserve_bytes: 1 << 30,
            limits: setting.limits,
        };
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        // The capture's side: one capture at a time, as in the daemon.
        let (side_store, asked) = (store.clone(), Arc::clone(&started));
        runtime.spawn(async move {
            let mut running: Option<i64> = None;
            while let Some(command) = commands.recv().await {
                match command {
                    Command::Start(request, reply) => {
                        let outcome = match running {
                            Some(running) => Err(ControlError::Busy(running)),
                            None => Ok(start(&side_store, &request).await),
                        };
                        asked.lock().unwrap().push(request);
                        running = outcome.as_ref().ok().copied().or(running);
                        reply.send(outcome).unwrap();
                    }
                    Command::Stop(id, reply) if running == Some(id) => {
                        side_store
                            .offload(move |store| store.set_state(id, CaptureState::Stopped, START_NS))
                            .await
                            .unwrap();
                        running = None;
                        reply.send(Ok(())).unwrap();
                    }
                    Command::Stop(id, reply) => reply.send(Err(ControlError::NotRunning(id))).unwrap(),
                }
            }
        });
        let listener = runtime.block_on(async { listen("127.0.0.1:0".parse().unwrap()) }).unwrap();
        let address = listener.local_addr().unwrap();
        let stop = CancellationToken::new();
        let limits = parts.limits;
        runtime.spawn(serve(listener, router(parts), limits, Arc::clone(&metrics), stop.clone()));
        Self { store, jobs, status, metrics, started, address, stop, runtime: Some(runtime), _directory: directory }
    }

    pub(super) fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.address)
    }

    pub(super) fn get(&self, path: &str) -> Answer {
        Answer::of(agent().get(self.url(path)).call())
    }

    pub(super) fn get_with(&self, path: &str, header: &str, value: &str) -> Answer {
        Answer::of(agent().get(self.url(path)).header(header, value).call())
    }

    pub(super) fn post(&self, path: &str, body: &str) -> Answer {
        Answer::of(agent().post(self.url(path)).header("content-type", "application/json").send(body))
    }

    pub(super) fn patch(&self, path: &str, body: &str) -> Answer {
        Answer::of(agent().patch(self.url(path)).header("content-type", "application/json").send(body))
    }

    pub(super) fn delete(&self, path: &str) -> Answer {
        Answer::of(agent().delete(self.url(path)).call())
    }

    /// Returns a capture with `samples` samples of gyro_x and temperature and one gap of 4 before sample 100.
    pub(super) fn capture(&self, name: &str, state: CaptureState, samples: u64) -> i64 {
        self.capture_of(name, state, records(samples))
    }

    pub(super) fn capture_of(&self, name: &str, state: CaptureState, records: Vec<Record>) -> i64 {
        let capture = NewCapture { name: Some(name.to_owned()), ..NewCapture::new("test", state) };
        let id = self.store.create_capture(capture).unwrap();
        for record in records {
            self.store.records().blocking_send(id, record).unwrap();
        }
        self.store.flush_blocking().unwrap();
        id
    }
}

async fn start(store: &Store, request: &CaptureRequest) -> i64 {
    let name = request.name.clone();
    store
        .offload(move |store| {
            store.create_capture(NewCapture { name, ..NewCapture::new("test", CaptureState::Capturing) })
        })
        .await
        .unwrap()
}

/// Returns white noise from a number: the finaliser of splitmix64.
fn mixed(seq: u64) -> u64 {
    let z = (seq + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB) >> 31
}

fn records(samples: u64) -> Vec<Record> {
    let mut records = Vec::new();
    for seq in 0..samples {
        // The gap takes four periods of the sensor's clock.
        let device_ns = (seq + if seq < 100 { 0 } else { 4 }) * PERIOD_NS;
        let utc_ns = START_NS + device_ns as i64;
        if seq == 100 {
            records.push(Record::Gap(Gap {
                before_seq: 100,
                from_utc_ns: utc_ns - 5 * PERIOD_NS as i64,
                to_utc_ns: utc_ns,
                device_ns: Some((device_ns - 5 * PERIOD_NS, device_ns)),
                missing: 4,
                missing_exact: true,
                cause: GapCause::Checksum,
            }));
        }
        if seq == 0 || seq == 100 {
            records.push(Record::Segment(Segment {
                number: if seq == 0 { 1 } else { 2 },
                epoch: 1,
                first_seq: seq,
                rate_hz: 40.0,
                timebase: Timebase::Device,
                channels: [Channel::GyroX, Channel::Temperature].into_iter().collect(),
                first_device_time_ns: Some(device_ns),
                first_utc_ns: utc_ns,
                boot_id: None,
            }));
        }
        // Arrival varies by up to 3 ms, the sensor's clock does not.
        let late_ns = (seq % 4) * 1_000_000;
        let mut sample = Sample::at(device_ns + late_ns, utc_ns + late_ns as i64);
        sample.device_time_ns = Some(device_ns);
        sample.set(Channel::GyroX, (mixed(seq) % 1000) as f64 * 1e-6);
        if seq != 2 {
            sample.set(Channel::Temperature, 21.5);
        }
        records.push(Record::Sample { seq, segment: if seq < 100 { 1 } else { 2 }, sample });
    }
    records
}

impl Drop for World {
    fn drop(&mut self) {
        self.stop.cancel();
        self.jobs.stop();
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(Duration::from_secs(5));
        }
    }
}

/// Returns an agent that accepts every status as an answer.
fn agent() -> ureq::Agent {
    ureq::Agent::config_builder()
        .http_status_as_error(false)
        .timeout_global(Some(Duration::from_secs(30)))
        .accept_encoding("identity")
        .accept("*/*")
        .build()
        .new_agent()
}

/// An answer, read to its end.
#[derive(Debug)]
pub(super) struct Answer {
    pub(super) status: u16,
    pub(super) headers: axum::http::HeaderMap,
    pub(super) text: String,
}

impl Answer {
    fn of(outcome: Result<axum::http::Response<ureq::Body>, ureq::Error>) -> Self {
        let mut response = outcome.unwrap();
        Self {
            status: response.status().as_u16(),
            headers: response.headers().clone(),
            text: response.body_mut().with_config().limit(1 << 30).read_to_string().unwrap(),
        }
    }
    pub(super) fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.text).unwrap_or_else(|error| panic!("{error}: {}", self.text))
    }
    pub(super) fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().unwrap())
    }
    /// Asserts a problem document of this status and type, and returns its detail.
    pub(super) fn problem(&self, status: u16, kind: &str) -> String {
        assert_eq!(self.status, status, "{self:?}");
        assert_eq!(self.header("content-type"), super::PROBLEM_JSON, "{self:?}");
        let problem = self.json();
        assert_eq!(problem["type"], format!("urn:vn100d:problem:{kind}"), "{self:?}");
        assert_eq!(problem["status"], status);
        assert!(!problem["title"].as_str().unwrap().is_empty());
        assert_eq!(problem["instance"], format!("/requests/{}", self.header("x-request-id")));
        problem["detail"].as_str().unwrap().to_owned()
    }
}

/// Repeats a request until `done` holds.
pub(super) fn eventually<T>(what: &str, mut ask: impl FnMut() -> T, done: impl Fn(&T) -> bool) -> T {
    let begun = Instant::now();
    loop {
        let answer = ask();
        if done(&answer) {
            return answer;
        }
        assert!(begun.elapsed() < Duration::from_secs(120), "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}
