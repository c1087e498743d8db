//! Requests: no path, header, query or body gives a server error, and every error is a problem document.

use axum::body::Body;
use axum::http::{HeaderName, HeaderValue, Method, Request, StatusCode, header};
use hyper::service::Service as _;
use hyper_util::service::TowerToHyperService;
use imu_core::sample::{Channel, Gap, GapCause, Record, Sample, Segment, Timebase};
use std::sync::Arc;
use std::time::Duration;
use vn100d::api::{ApiParts, Limits, PROBLEM_JSON, router};
use vn100d::control::{CaptureControl, ImportError, ImportReport, ImportRequest, Importer};
use vn100d::jobs::{Jobs, JobsOptions, Live};
use vn100d::observe::{Metrics, Status};
use vn100d::store::{CaptureState, NewCapture, Store, StoreOptions};

const START_NS: i64 = 1_800_000_000_000_000_000;
const PERIOD_NS: u64 = 25_000_000;
/// Samples before the gap and after it.
const SAMPLES: [u64; 2] = [300, 100];
/// Longest answer that is read, in bytes.
const ANSWER_BYTES: usize = 16 << 20;

/// Refuses every recording: reading them is another target.
#[derive(Debug)]
struct NoImports;

impl Importer for NoImports {
    fn import(&self, request: ImportRequest) -> Result<ImportReport, ImportError> {
        Err(ImportError::Recording(format!("{} is no recording", request.called)))
    }
}

/// An interface over a separate database.
struct World {
    runtime: tokio::runtime::Runtime,
    service: TowerToHyperService<axum::Router>,
    _status: tokio::sync::watch::Sender<Status>,
    _folder: tempfile::TempDir,
}

thread_local! {
    static WORLD: World = World::new();
}

impl World {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Store::open(&folder.path().join("vn100d.db"), StoreOptions::default()).expect("a database");
        fill(&store);
        let jobs = Jobs::start(&store, JobsOptions::default()).expect("jobs");
        let (status, watched) = tokio::sync::watch::channel(Status::default());
        // No capture task runs: its requests are answered with the message that the daemon is stopping.
        let (control, _) = CaptureControl::pair();
        let parts = ApiParts {
            status: watched,
            control,
            store,
            jobs,
            live: Arc::new(Live::new()),
            metrics: Arc::new(Metrics::default()),
            recent: vn100d::observe::SharedRecent::default(),
            clock: Arc::new(vn100d::clock::SystemClock),
            token: None,
            // The Host header is not checked: nearly every mutated request would end there.
            loopback: false,
            importer: Arc::new(NoImports),
            default_duration: Duration::from_secs(18_000),
            reserve_bytes: 1 << 30,
            limits: Limits::default(),
        };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let service = runtime.block_on(async { TowerToHyperService::new(router(parts)) });
        Self { runtime, service, _status: status, _folder: folder }
    }
}

/// Stores a capture of two segments with a gap between them, and a model.
fn fill(store: &Store) {
    let mut capture = NewCapture::new("fuzz", CaptureState::Imported);
    capture.started_utc_ns = Some(START_NS);
    let mut import = store.begin_import(capture, None).expect("an import");
    let mut seq = 0;
    for (index, samples) in SAMPLES.into_iter().enumerate() {
        let first_ns = START_NS + ((seq + 4 * index as u64) * PERIOD_NS) as i64;
        if index > 0 {
            let gap = Gap {
                before_seq: seq,
                from_utc_ns: first_ns - 5 * PERIOD_NS as i64,
                to_utc_ns: first_ns,
                device_ns: None,
                missing: 4,
                missing_exact: true,
                cause: GapCause::Source,
            };
            import.push(Record::Gap(gap)).expect("a gap");
        }
        let segment = Segment {
            number: index as u32 + 1,
            epoch: 1,
            first_seq: seq,
            rate_hz: 40.0,
            timebase: Timebase::Stamps,
            channels: [Channel::GyroX, Channel::AccelZ].into_iter().collect(),
            first_device_time_ns: Some((first_ns - START_NS) as u64),
            first_utc_ns: first_ns,
            boot_id: None,
        };
        import.push(Record::Segment(segment)).expect("a segment");
        for step in 0..samples {
            let mut sample = Sample::at(0, first_ns + (step * PERIOD_NS) as i64);
            sample.device_time_ns = Some((sample.host_utc_ns - START_NS) as u64);
            sample.set(Channel::GyroX, 1e-3 * (step as f64).sin());
            sample.set(Channel::AccelZ, -9.8 + 1e-3 * (step as f64 * 1.7).sin());
            import.push(Record::Sample { seq, segment: index as u32 + 1, sample }).expect("a sample");
            seq += 1;
        }
    }
    import.finish(None).expect("a capture");
    let model =
        r#"{"format": "vn100d-sensor-model-1", "name": "unit", "rate_hz": 40, "channels": {"gyro_z": {"N": 1e-4}}}"#;
    store.keep_model("unit", 40.0, model.to_owned()).expect("a model");
}

/// The input: `METHOD path?query`, lines of headers, an empty line, a body.
pub fn no_server_error(input: &[u8]) {
    answered(input);
}

/// Returns the status of the answer; `None` if the input is no request.
pub fn answered(input: &[u8]) -> Option<StatusCode> {
    let (request, is_head) = request(input)?;
    let status = WORLD.with(|world| {
        world.runtime.block_on(async {
            let response = world.service.call(request).await.expect("it cannot fail");
            let (parts, body) = response.into_parts();
            let body = axum::body::to_bytes(body, ANSWER_BYTES).await.expect("an answer that ends");
            let shown = || String::from_utf8_lossy(&body).into_owned();
            assert_ne!(parts.status, StatusCode::INTERNAL_SERVER_ERROR, "{}", shown());
            let kind = parts.headers.get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
            if parts.status.as_u16() >= 400 && !is_head {
                assert_eq!(kind, PROBLEM_JSON, "{} {}", parts.status, shown());
                let problem: serde_json::Value = serde_json::from_slice(&body).expect("JSON");
                assert_eq!(problem["status"], parts.status.as_u16());
            }
            if kind == "application/json" && !is_head && !body.is_empty() {
                let parsed: Result<serde_json::Value, _> = serde_json::from_slice(&body);
                assert!(parsed.is_ok(), "{}", shown());
            }
            parts.status
        })
    });
    Some(status)
}

/// Returns the request; `None` if a server would not pass it on, or if it would end the world.
fn request(input: &[u8]) -> Option<(Request<Body>, bool)> {
    let (head, body) = match input.windows(2).position(|window| window == b"\n\n") {
        Some(end) => (&input[..end], &input[end + 2..]),
        None => (input, &[][..]),
    };
    let mut lines = head.split(|byte| *byte == b'\n');
    let first = lines.next()?;
    let space = first.iter().position(|byte| *byte == b' ')?;
    let method = Method::from_bytes(&first[..space]).ok()?;
    if method == Method::DELETE && first.windows(8).any(|window| window == b"captures") {
        return None;
    }
    let is_head = method == Method::HEAD;
    let mut request = Request::builder().method(method).uri(first.get(space + 1..)?);
    for line in lines {
        let colon = line.iter().position(|byte| *byte == b':')?;
        let name = HeaderName::from_bytes(&line[..colon]).ok()?;
        request = request.header(name, HeaderValue::from_bytes(line[colon + 1..].trim_ascii()).ok()?);
    }
    Some((request.body(Body::from(body.to_vec())).ok()?, is_head))
}
