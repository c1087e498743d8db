//! A seeded multitude of requests, and bytes that are not requests (row E4).

use super::*;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

/// A seeded generator of requests: routes, ids, queries, headers and bodies, many of them invalid.
struct Fuzz {
    random: ChaCha8Rng,
}

/// A request of a client.
#[derive(Debug, Clone)]
struct Asked {
    method: &'static str,
    target: String,
    headers: Vec<(&'static str, Vec<u8>)>,
    body: Vec<u8>,
}

impl Fuzz {
    fn new(seed: u64) -> Self {
        Self { random: ChaCha8Rng::seed_from_u64(seed) }
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.random.random_range(0..from.len())]
    }

    fn chance(&mut self, percent: u32) -> bool {
        self.random.random_range(0..100) < percent
    }

    fn word(&mut self) -> String {
        const WORDS: [&str; 52] = [
            "",
            "0",
            "1",
            "2",
            "-1",
            "1000",
            "1001",
            "1e9",
            "NaN",
            "inf",
            "-inf",
            "1e-320",
            "9223372036854775807",
            "9223372036854775808",
            "18446744073709551616",
            "-9223372036854775809",
            "latest",
            "desk",
            "pinned",
            "json",
            "csv",
            "ndjson",
            "gyro_x",
            "gyro_x,gyro_x",
            "gyro_x,",
            "capturing",
            "done",
            "%00",
            "%ff%fe",
            "%F0%9F%A6%80",
            "%",
            "%zz",
            "..",
            "%2e%2e%2f",
            "..%2f..%2fetc%2fpasswd",
            "'--",
            "\"",
            "%27%20OR%201=1",
            "2027-01-15T08:00:00Z",
            "2027-01-15T08:00:00%2B01:00",
            "9999-12-31T23:59:59Z",
            "0000-01-01T00:00:00Z",
            "jobs-1-1",
            "gaps-1-zz",
            "segments-1-zzzzzzzzzzzzz",
            "captures-1-",
            "true",
            "null",
            "[]",
            "0x10",
            "1_000",
            "+5",
        ];
        match self.random.random_range(0..20) {
            0 => "x".repeat(self.random.random_range(1..10_240)),
            1 => format!("jobs-1-{}", "z".repeat(self.random.random_range(1..10_000))),
            2 => self.random.random::<i64>().to_string(),
            3 => self.random.random::<f64>().to_string(),
            4 => (0..8).map(|_| format!("%{:02x}", self.random.random::<u8>())).collect(),
            _ => self.pick(&WORDS).to_owned(),
        }
    }

    fn target(&mut self) -> String {
        const PATHS: [&str; 31] = [
            "/",
            "/healthz",
            "/readyz",
            "/metrics",
            "/openapi.json",
            "/v1/status",
            "/v1/captures",
            "/v1/captures/{}",
            "/v1/captures/{}/stop",
            "/v1/captures/{}/pin",
            "/v1/captures/{}/gaps",
            "/v1/captures/{}/segments",
            "/v1/captures/{}/events",
            "/v1/captures/{}/samples",
            "/v1/captures/{}/statistics",
            "/v1/captures/{}/allan",
            "/v1/captures/{}/noise",
            "/v1/jobs",
            "/v1/jobs/{}",
            "/v1/imports",
            "/v1/captures/",
            "/v1//captures",
            "/v1/captures/{}/samples/",
            "/v2/{}",
            "/{}",
            "/../../etc/passwd",
            "/v1/captures/../status",
            "/%2e%2e/{}",
            "/v1/captures/{}/plots/x.svg",
            "/v1/models",
            "/v1/models/model-1/cost",
        ];
        const NAMES: [&str; 16] = [
            "limit",
            "cursor",
            "from",
            "to",
            "max_points",
            "channels",
            "format",
            "state",
            "capture",
            "job",
            "file",
            "name",
            "rate_hz",
            "x",
            "limit",
            "%00",
        ];
        let mut path = self.pick(&PATHS).to_owned();
        if path.contains("{}") {
            let id =
                if self.chance(50) { self.pick(&["1", "2", "latest", "desk", "few"]).to_owned() } else { self.word() };
            path = path.replace("{}", &id.replace(['"', '[', ']'], "_"));
        }
        let parameters = self.random.random_range(0..4);
        let query: Vec<String> = (0..parameters)
            .map(|_| {
                let name = self.pick(&NAMES);
                format!("{name}={}", self.word().replace(['"', '[', ']'], "_"))
            })
            .collect();
        if query.is_empty() { path } else { format!("{path}?{}", query.join("&")) }
    }

    fn body(&mut self) -> Vec<u8> {
        const BODIES: [&str; 16] = [
            "",
            "{",
            "{}",
            "[]",
            "null",
            "1e999",
            "{\"duration\": \"-5h\"}",
            "{\"duration\": \"5h\", \"x\": 1}",
            "{\"duration\": 5}",
            "{\"kind\": \"allan\"}",
            "{\"kind\": \"allan\", \"capture\": 1}",
            "{\"kind\": \"nothing\", \"capture\": \"latest\"}",
            "{\"kind\": \"noise\", \"capture\": \"few\", \"taus\": \"all\"}",
            "{\"kind\": \"statistics\", \"capture\": 1e300}",
            "{\"pinned\": true}",
            "{\"start_at\": \"9999-12-31T00:00:00Z\"}",
        ];
        match self.random.random_range(0..12) {
            0 => (0..self.random.random_range(1..300)).map(|_| self.random.random()).collect(),
            1 => vec![b'['; self.random.random_range(1..2000)],
            2 => vec![b'x'; 70_000],
            _ => self.pick(&BODIES).as_bytes().to_vec(),
        }
    }

    /// Returns the next request.
    fn next(&mut self) -> Asked {
        const HEADERS: [&str; 10] = [
            "accept",
            "accept-encoding",
            "if-none-match",
            "origin",
            "authorization",
            "content-encoding",
            "range",
            "cookie",
            "x-forwarded-for",
            "expect-ct",
        ];
        let method = if self.chance(55) {
            "GET"
        } else {
            self.pick(&["POST", "DELETE", "HEAD", "PUT", "PATCH", "OPTIONS", "TRACE"])
        };
        let mut headers = vec![("host", b"localhost".to_vec())];
        for _ in 0..self.random.random_range(0..3) {
            let value = if self.chance(20) {
                // Any byte that a header may carry, also bytes that are not UTF-8.
                (0..20).map(|_| self.random.random_range(128..=255_u8)).collect()
            } else {
                self.word().into_bytes()
            };
            headers.push((self.pick(&HEADERS), value));
        }
        let has_body = method != "GET" && method != "HEAD";
        if has_body {
            let media_types =
                ["application/json", "application/json", "application/json", "text/plain", "text/csv", "x"];
            headers.push(("content-type", self.pick(&media_types).as_bytes().to_vec()));
        }
        let (target, body) = (self.target(), if has_body { self.body() } else { Vec::new() });
        Asked { method, target, headers, body }
    }
}

/// The requirements for an answer to any request: it is declared in docs/openapi.json, an error is a problem document,
/// and it is never 500.
struct Oracle {
    paths: Vec<(Vec<String>, Value)>,
}

impl Oracle {
    fn new() -> Self {
        let document: Value = serde_json::from_str(include_str!("../../../docs/openapi.json")).unwrap();
        let paths = document["paths"].as_object().unwrap().iter();
        Self { paths: paths.map(|(path, item)| (path.split('/').map(str::to_owned).collect(), item.clone())).collect() }
    }

    fn operation(&self, asked: &Asked) -> Option<&Value> {
        let path: Vec<&str> = asked.target.split('?').next().unwrap().split('/').collect();
        let method = if asked.method == "HEAD" { "get".to_owned() } else { asked.method.to_lowercase() };
        let matches = |pattern: &[String]| {
            pattern.len() == path.len()
                && pattern
                    .iter()
                    .zip(&path)
                    .all(|(one, other)| one.starts_with('{') && !other.is_empty() || one == other)
        };
        self.paths
            .iter()
            .find(|(pattern, _)| matches(pattern))
            .map(|(_, item)| &item[&method])
            .filter(|found| found.is_object())
    }

    /// Panics if the answer violates a requirement.
    fn check(&self, asked: &Asked, status: u16, media_type: &str, body: &[u8]) {
        let context =
            || format!("{asked:?}: {status} {media_type} {}", String::from_utf8_lossy(&body[..body.len().min(500)]));
        assert!(status != 500 && status < 600, "{}", context());
        let media_type = media_type.split(';').next().unwrap();
        if status >= 400 {
            assert_eq!(media_type, "application/problem+json", "{}", context());
            if asked.method != "HEAD" {
                let problem: Value = serde_json::from_slice(body).unwrap_or_else(|_| panic!("{}", context()));
                assert_eq!(problem["status"], status, "{}", context());
                for member in ["type", "title", "detail", "instance"] {
                    assert!(problem[member].as_str().is_some_and(|text| !text.is_empty()), "{member}: {}", context());
                }
            }
        }
        let Some(operation) = self.operation(asked) else {
            // A request without a declared operation is an error, unless it is not part of the interface for programs.
            let page = ["/", "/openapi.json"].contains(&asked.target.split('?').next().unwrap());
            assert!(status >= 400 || page, "{}", context());
            return;
        };
        let responses = operation["responses"].as_object().unwrap();
        let declared = responses.get(&status.to_string()).or_else(|| (status >= 400).then(|| &responses["default"]));
        let declared = declared.unwrap_or_else(|| panic!("status not declared: {}", context()));
        if let Some(content) = declared["content"].as_object() {
            assert!(content.contains_key(media_type), "media type not declared: {}", context());
            if media_type == "application/json" && asked.method != "HEAD" {
                let answer: Result<Value, _> = serde_json::from_slice(body);
                assert!(answer.is_ok(), "{}", context());
            }
        }
    }
}

/// The interface itself, without sockets: for volume.
struct Inside {
    router: hyper_util::service::TowerToHyperService<axum::Router>,
    jobs: vn100d::jobs::Jobs,
    _store: vn100d::store::Store,
}

/// Accepts no recording.
#[derive(Debug)]
struct NoImports;

impl vn100d::control::Importer for NoImports {
    fn import(
        &self,
        request: vn100d::control::ImportRequest,
    ) -> Result<vn100d::control::ImportReport, vn100d::control::ImportError> {
        Err(vn100d::control::ImportError::Recording(format!("{} is no recording", request.called)))
    }
}

impl Inside {
    fn new(world: &World) -> Self {
        use std::sync::Arc;
        use vn100d::control::{CaptureControl, Command, ControlError};
        let store = vn100d::store::Store::open(&world.database(), vn100d::store::StoreOptions::default()).unwrap();
        let jobs = vn100d::jobs::Jobs::start(&store, vn100d::jobs::JobsOptions::default()).unwrap();
        let mut status = vn100d::observe::Status::default();
        status.storage.free_bytes = 10 << 30;
        let (control, mut commands) = CaptureControl::pair();
        tokio::spawn(async move {
            while let Some(command) = commands.recv().await {
                match command {
                    Command::Start(_, reply) => drop(reply.send(Err(ControlError::Busy(1)))),
                    Command::Stop(id, reply) => drop(reply.send(Err(ControlError::NotRunning(id)))),
                }
            }
        });
        let router = vn100d::api::router(vn100d::api::ApiParts {
            status: tokio::sync::watch::channel(status).1,
            control,
            store: store.clone(),
            jobs: jobs.clone(),
            live: Arc::new(vn100d::jobs::Live::new()),
            metrics: Arc::new(vn100d::observe::Metrics::default()),
            recent: vn100d::observe::SharedRecent::default(),
            clock: Arc::new(vn100d::clock::SystemClock),
            token: None,
            loopback: true,
            importer: Arc::new(NoImports),
            default_duration: Duration::from_secs(18_000),
            reserve_bytes: 1 << 30,
            limits: vn100d::api::Limits::default(),
        });
        Self { router: hyper_util::service::TowerToHyperService::new(router), jobs, _store: store }
    }

    /// Returns status, media type and body; `None` for a target or header that HTTP itself cannot carry.
    async fn ask(&self, asked: &Asked) -> Option<(u16, String, Vec<u8>)> {
        use hyper::body::Body as _;
        use hyper::service::Service as _;
        let mut request = hyper::Request::builder().method(asked.method).uri(&asked.target);
        for (name, value) in &asked.headers {
            request = request.header(*name, value.as_slice());
        }
        let request = request.body(axum::body::Body::from(asked.body.clone())).ok()?;
        let response = self.router.call(request).await.unwrap();
        let status = response.status().as_u16();
        let media_type =
            response.headers().get("content-type").and_then(|value| value.to_str().ok()).unwrap_or("").to_owned();
        let packed = response.headers().contains_key("content-encoding");
        let mut body = response.into_body();
        let mut bytes = Vec::new();
        while let Some(frame) = std::future::poll_fn(|context| std::pin::Pin::new(&mut body).poll_frame(context)).await
        {
            bytes.extend(frame.unwrap().into_data().unwrap_or_default());
        }
        if packed {
            let mut plain = Vec::new();
            flate2::read::MultiGzDecoder::new(&bytes[..]).read_to_end(&mut plain).unwrap();
            bytes = plain;
        }
        Some((status, media_type, bytes))
    }
}

fn desk(world: &World) {
    fill(world, "desk", &[Channel::GyroX, Channel::Temperature], &plain(400), noise);
    fill(world, "few", &[Channel::GyroX], &plain(3), noise);
}

/// Row E4.
#[test]
fn no_request_of_a_seeded_multitude_gives_a_500_or_an_undeclared_answer() {
    let world = World::new();
    desk(&world);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let requests = scaled(100_000, 1_000_000);
    let (mut refused, mut answered, mut slowest) = (0_u64, 0_u64, Duration::ZERO);
    runtime.block_on(async {
        let inside = Inside::new(&world);
        let (oracle, mut fuzz) = (Oracle::new(), Fuzz::new(7));
        for _ in 0..requests {
            let asked = fuzz.next();
            // Both captures must exist to the end.
            if asked.method == "DELETE" && asked.target.starts_with("/v1/captures/") {
                continue;
            }
            let begun = Instant::now();
            let Some((status, media_type, body)) = inside.ask(&asked).await else { continue };
            let mut took = begun.elapsed();
            oracle.check(&asked, status, &media_type, &body);
            answered += 1;
            if (400..500).contains(&status) {
                refused += 1;
                // A machine with other work may be late; a repeated request shows the request's own time.
                for _ in 0..5 {
                    if took > Duration::from_millis(50) {
                        let begun = Instant::now();
                        inside.ask(&asked).await;
                        took = took.min(begun.elapsed());
                    }
                }
                assert!(took <= Duration::from_millis(50), "{asked:?} was refused after {took:?}");
                slowest = slowest.max(took);
            }
        }
        inside.jobs.stop();
    });
    eprintln!("E4: {answered} answers, {refused} of them 4xx, the slowest of those after {slowest:?}");
    assert!(answered > requests / 2 && refused > requests / 4 && answered - refused > requests / 20);
    drop(runtime);
    settle(&world);
}

/// Row E4, through the socket: bytes that a client library would not send.
#[test]
fn bytes_that_are_no_request_are_refused_and_the_daemon_answers_on() {
    let world = World::new();
    desk(&world);
    let daemon = world.daemon("", &[]);
    let long = "x".repeat(10_240);
    let table: Vec<(Vec<u8>, &[u16])> = vec![
        (b"GET /v1/captures?limit=1000000000 HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/captures?limit=-1 HTTP/1.1".to_vec(), &[400]),
        (format!("GET /v1/captures?cursor={long} HTTP/1.1").into_bytes(), &[400]),
        (format!("GET /v1/captures/{long} HTTP/1.1").into_bytes(), &[404]),
        (b"GET /v1/captures/desk/samples?from=NaN HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/captures/desk/samples?from=-1e308&to=1e308 HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/captures/desk/samples?max_points=99999999999999999999 HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/captures/desk/samples?channels=%ff%fe HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/captures/%ff%fe/gaps HTTP/1.1".to_vec(), &[400, 404]),
        (b"GET /v1/captures/\xff\xfe/gaps HTTP/1.1".to_vec(), &[400, 404]),
        (b"GET /../../../../etc/passwd HTTP/1.1".to_vec(), &[404]),
        (b"GET /v1/captures/..%2f..%2fetc%2fpasswd HTTP/1.1".to_vec(), &[404]),
        (b"GET http://evil.example/v1/status HTTP/1.1".to_vec(), &[403]),
        (b"DELETE /v1/status HTTP/1.1".to_vec(), &[405]),
        (b"BREW /v1/status HTTP/1.1".to_vec(), &[405]),
        (b"GET /v1/jobs/99999999999999999999 HTTP/1.1".to_vec(), &[400]),
        (b"GET /v1/jobs/-1 HTTP/1.1".to_vec(), &[404]),
    ];
    for (line, expected) in table {
        let request = String::from_utf8_lossy(&line[..line.len().min(100)]).into_owned();
        let mut took = Duration::MAX;
        for _ in 0..5 {
            let mut stream = connect(&world);
            let begun = Instant::now();
            stream.write_all(&[&line[..], b"\r\nHost: localhost\r\nConnection: close\r\n\r\n"].concat()).unwrap();
            let mut bytes = Vec::new();
            stream.read_to_end(&mut bytes).unwrap();
            took = took.min(begun.elapsed());
            let text = String::from_utf8_lossy(&bytes);
            let status: u16 = text[9..12].parse().unwrap();
            assert!(expected.contains(&status), "{request}: {text}");
            // The server refuses bytes that are not HTTP before the interface sees them.
            assert!(text.contains("application/problem+json") || line.contains(&0xff), "{request}: {text}");
        }
        assert!(took <= Duration::from_millis(50), "{request}: {took:?}");
    }
    // Raw bytes, cut requests, several in one.
    let mut fuzz = Fuzz::new(11);
    for _ in 0..scaled(500, 20_000) {
        let asked = fuzz.next();
        let mut bytes = format!("{} {} HTTP/1.1\r\n", asked.method, asked.target).into_bytes();
        for (name, value) in &asked.headers {
            bytes.extend([name.as_bytes(), b": ", value, b"\r\n"].concat());
        }
        bytes.extend(format!("content-length: {}\r\nconnection: close\r\n\r\n", asked.body.len()).as_bytes());
        bytes.extend(&asked.body);
        if fuzz.chance(30) {
            let place = fuzz.random.random_range(0..bytes.len());
            bytes[place] = fuzz.random.random();
        }
        if fuzz.chance(10) {
            bytes.truncate(fuzz.random.random_range(0..bytes.len()));
        }
        let mut stream = connect(&world);
        // The daemon may close before it has received all bytes.
        if stream.write_all(&bytes).is_ok() && stream.shutdown(std::net::Shutdown::Write).is_ok() {
            let mut answer = Vec::new();
            let _ = stream.read_to_end(&mut answer);
            let text = String::from_utf8_lossy(&answer);
            assert!(!text.starts_with("HTTP/1.1 500"), "{} gave {text}", String::from_utf8_lossy(&bytes));
        }
    }
    assert_eq!(world.get("/healthz")["status"], "ok");
    drop(daemon);
    settle(&world);
}
