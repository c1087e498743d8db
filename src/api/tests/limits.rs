//! Limits of the server for its clients.

use super::*;
use std::io::{Read, Write};
use std::net::TcpStream;

fn limited(change: impl FnOnce(&mut Limits)) -> World {
    let mut limits = Limits::default();
    change(&mut limits);
    World::with(Setting { limits, ..Setting::default() })
}

/// Reads until the other side closes; returns the data and the time taken.
fn until_closed(mut stream: TcpStream) -> (String, Duration) {
    let begun = Instant::now();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let mut bytes = Vec::new();
    if let Err(error) = stream.read_to_end(&mut bytes) {
        assert_eq!(error.kind(), std::io::ErrorKind::ConnectionReset, "{error}");
    }
    (String::from_utf8_lossy(&bytes).into_owned(), begun.elapsed())
}

#[test]
fn half_a_head_is_closed_in_time_and_others_are_served_meanwhile() {
    let world = limited(|limits| limits.header = Duration::from_millis(500));
    let slow: Vec<TcpStream> = (0..100)
        .map(|_| {
            let mut stream = TcpStream::connect(world.address).unwrap();
            stream.write_all(b"GET /v1/status HTTP/1.1\r\nHost: localhost\r\nX-Slow: ").unwrap();
            stream
        })
        .collect();
    let begun = Instant::now();
    assert_eq!(world.get("/v1/status").status, 200);
    assert!(begun.elapsed() < Duration::from_millis(400), "{:?}", begun.elapsed());
    for stream in slow {
        let (_, took) = until_closed(stream);
        assert!(took < Duration::from_secs(5), "{took:?}");
    }
}

#[test]
fn an_idle_connection_is_closed_in_time() {
    let world = limited(|limits| limits.header = Duration::from_millis(300));
    let mut stream = TcpStream::connect(world.address).unwrap();
    stream.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    let (text, took) = until_closed(stream);
    assert!(text.starts_with("HTTP/1.1 200 OK"), "{text}");
    assert!(took < Duration::from_secs(5), "{took:?}");
}

#[test]
fn a_connection_beyond_the_limit_is_answered_with_503() {
    let world = limited(|limits| limits.connections = 2);
    let held: Vec<TcpStream> = (0..2).map(|_| TcpStream::connect(world.address).unwrap()).collect();
    eventually(
        "both are counted",
        || world.metrics.render(&Status::default(), &crate::observe::WriterFigures::default(), 0.0).unwrap(),
        |text| text.contains("vn100d_http_connections 2.0"),
    );
    let (text, _) = until_closed(TcpStream::connect(world.address).unwrap());
    assert!(text.starts_with("HTTP/1.1 503 "), "{text}");
    drop(held);
    eventually("there is room again", || world.try_status(), |status| *status == Some(200));
}

impl World {
    fn try_status(&self) -> Option<u16> {
        agent().get(self.url("/healthz")).call().ok().map(|response| response.status().as_u16())
    }
}

#[test]
fn a_head_that_is_too_long_is_refused() {
    let world = World::new();
    let mut stream = TcpStream::connect(world.address).unwrap();
    let head = format!("GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Long: {}\r\n\r\n", "x".repeat(40_000));
    // The server may close before it has received everything.
    let _ = stream.write_all(head.as_bytes());
    let (text, _) = until_closed(stream);
    assert!(text.is_empty() || text.starts_with("HTTP/1.1 4"), "{text}");
    assert_eq!(world.get("/healthz").status, 200);
}

#[test]
fn bytes_that_are_no_http_do_no_harm() {
    let world = World::new();
    for bytes in [&b"\x16\x03\x01\x02\x00\x01\x00"[..], b"GET\r\n\r\n", b"\0\0\0\0\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n"]
    {
        let mut stream = TcpStream::connect(world.address).unwrap();
        stream.write_all(bytes).unwrap();
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        let (text, _) = until_closed(stream);
        assert!(text.is_empty() || text.starts_with("HTTP/1.1 4") || text.starts_with("HTTP/1.0 4"), "{text}");
    }
    assert_eq!(world.get("/healthz").status, 200);
}

#[test]
fn a_reader_that_stops_reading_is_dropped_and_its_query_with_it() {
    let world = limited(|limits| {
        limits.write_stall = Duration::from_secs(3);
        limits.streams = 1;
    });
    world.capture("a", CaptureState::Complete, 150_000);
    let mut stream = TcpStream::connect(world.address).unwrap();
    stream.write_all(b"GET /v1/captures/a/samples?format=ndjson HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    // This request has the permit; the requests below do not.
    let mut head = [0; 12];
    stream.read_exact(&mut head).unwrap();
    assert_eq!(&head, b"HTTP/1.1 200");
    let busy = eventually("it runs", || world.get("/v1/captures/a/samples?to=1"), |answer| answer.status == 429);
    busy.problem(429, "busy");
    assert_eq!(busy.header("retry-after"), "1");
    assert_eq!(world.get("/v1/captures/a").status, 200, "small queries are served meanwhile");
    eventually("its permit comes back", || world.get("/v1/captures/a/samples?to=1"), |answer| answer.status == 200);
    let (text, _) = until_closed(stream);
    assert!(!text.ends_with("0\r\n\r\n"), "what was cut off does not look whole");
}

#[test]
fn a_refusal_takes_a_second_and_delays_no_other_request() {
    let world = limited(|limits| limits.streams = 0);
    world.capture("a", CaptureState::Complete, 100);
    let (url, begun) = (world.url("/v1/captures/a/samples"), Instant::now());
    std::thread::scope(|scope| {
        let refused = scope.spawn(move || agent().get(&url).call().unwrap().status().as_u16());
        std::thread::sleep(Duration::from_millis(100));
        let asked = Instant::now();
        assert_eq!(world.get("/v1/status").status, 200);
        assert!(asked.elapsed() < Duration::from_millis(500), "{:?}", asked.elapsed());
        assert_eq!(refused.join().unwrap(), 429);
    });
    assert!(begun.elapsed() >= Duration::from_secs(1), "{:?}", begun.elapsed());
}

/// Returns a connection on which this was sent, as much of it as the other side takes.
fn pushed(world: &World, bytes: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(world.address).unwrap();
    stream.set_write_timeout(Some(Duration::from_millis(50))).unwrap();
    // What the other side does not take is not sent.
    let _ = stream.write_all(bytes);
    stream
}

/// The answers are in the daemon's memory until they are read: together they have a limit.
#[test]
fn unread_answers_share_a_limit() {
    let world = limited(|limits| limits.held_bytes = 64 * 1024);
    world.capture("a", CaptureState::Complete, 1_000);
    let page = "/captures/a";
    assert!(world.get(page).text.len() > 8 * 1024, "it is large enough to count");
    let many = format!("GET {page} HTTP/1.1\r\nHost: localhost\r\n\r\n").repeat(400);
    let unread: Vec<TcpStream> = (0..16).map(|_| pushed(&world, many.as_bytes())).collect();
    let refused = eventually("the limit is reached", || world.get(page), |answer| answer.status == 429);
    refused.problem(429, "busy");
    assert_eq!(world.get("/v1/status").status, 200, "small answers are given meanwhile");
    assert_eq!(world.get("/openapi.json").status, 200, "what all share is not counted");
    drop(unread);
    eventually("the memory comes back", || world.get(page), |answer| answer.status == 200);
}

/// Bodies that do not end are in the daemon's memory: together they have a limit.
#[test]
fn bodies_that_do_not_end_share_a_limit() {
    let world = limited(|limits| limits.held_bytes = 2 << 20);
    let model = |length: usize| format!("{{\"name\":\"{}\"}}", "x".repeat(length));
    let head = "POST /v1/models HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 60000\r\n\r\n";
    let mut unfinished = Vec::new();
    // A whole body takes a part for a moment too, and an unfinished one that finds none is over: another follows.
    let another = || {
        unfinished.push(pushed(&world, format!("{head}{}", model(20_000)).as_bytes()));
        world.post("/v1/models", &model(20_000))
    };
    let refused = eventually("the limit is reached", another, |answer| answer.status == 429);
    refused.problem(429, "busy");
    assert_eq!(world.post("/v1/models", &model(100)).status, 400, "small bodies are read meanwhile");
    drop(unfinished);
    eventually("the memory comes back", || world.post("/v1/models", &model(20_000)), |answer| answer.status == 400);
}

#[test]
fn a_body_that_never_comes_is_not_waited_for() {
    let world = limited(|limits| limits.answer = Duration::from_millis(200));
    let mut stream = TcpStream::connect(world.address).unwrap();
    // A body that never arrives.
    stream
        .write_all(
            b"POST /v1/captures HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 10\r\n\r\n",
        )
        .unwrap();
    let mut bytes = [0; 4096];
    let length = stream.read(&mut bytes).unwrap();
    let text = String::from_utf8_lossy(&bytes[..length]);
    assert!(text.starts_with("HTTP/1.1 408 ") && text.contains("urn:vn100d:problem:body-timeout"), "{text}");
}

#[test]
fn at_the_end_requests_under_way_are_finished_and_nothing_new_is_taken() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 50_000);
    let url = world.url("/v1/captures/a/samples?format=csv");
    let lines = std::thread::scope(|scope| {
        let mut response = agent().get(&url).call().unwrap();
        world.stop.cancel();
        scope.spawn(move || response.body_mut().with_config().limit(1 << 30).read_to_string().unwrap()).join().unwrap()
    });
    assert_eq!(lines.lines().count(), 50_001);
    eventually("the port is closed", || TcpStream::connect(world.address).is_err(), |closed| *closed);
}

#[test]
fn no_path_or_query_of_a_seeded_thousand_gives_a_500() {
    let world = World::new();
    world.capture("a", CaptureState::Complete, 120);
    let paths = [
        "/v1/captures",
        "/v1/captures/a/samples",
        "/v1/captures/a/gaps",
        "/v1/jobs",
        "/v1/captures/a/allan",
        "/v1/status",
    ];
    let names = ["limit", "cursor", "from", "to", "max_points", "channels", "format", "state", "capture", "job", "x"];
    let values = [
        "",
        "0",
        "-1",
        "1",
        "1e9",
        "NaN",
        "inf",
        "9223372036854775807",
        "99999999999999999999",
        "latest",
        "%00",
        "%ff%fe",
        "gaps-1-zz",
        "captures-1-1",
        "json",
        "csv",
        "gyro_x",
        "gyro_x,gyro_x",
        "2027-01-15T08:00:00Z",
        "0x10",
        "'--",
        "%F0%9F%A6%80",
    ];
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut pick = |count: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % count
    };
    let agent = agent();
    for _ in 0..1000 {
        let query: Vec<String> =
            (0..pick(4)).map(|_| format!("{}={}", names[pick(names.len())], values[pick(values.len())])).collect();
        let path = format!("{}?{}", paths[pick(paths.len())], query.join("&"));
        let answer = Answer::of(agent.get(world.url(&path)).call());
        assert!(answer.status < 500, "{path}: {answer:?}");
        if answer.status >= 400 {
            assert_eq!(answer.header("content-type"), super::super::PROBLEM_JSON, "{path}");
        }
    }
}
