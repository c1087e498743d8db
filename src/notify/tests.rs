//! The guarantees of notifications, with receivers that hang, refuse and recover.

use super::coalesce::Coalescer;
use super::deliver::{DeliverError, Receiver};
use super::notice::{GapFacts, Message, Notice, Sender};
use super::watch::{Sign, WatchOptions, Watcher};
use super::worker::{Effort, QUEUE, Worker};
use super::*;
use crate::clock::SystemClock;
use crate::observe::{CaptureStatus, SensorState, StorageState};
use imu_core::sample::GapCause;
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::Mutex;
use std::time::Instant;

const S: u64 = 1_000_000_000;

fn sender() -> Sender {
    Sender { host: "bench".to_owned(), database: "/data/vn100d.db".to_owned() }
}

fn gap(missing: u64) -> Gap {
    Gap {
        before_seq: 100,
        from_utc_ns: 0,
        to_utc_ns: 10 * S as i64,
        device_ns: None,
        missing,
        missing_exact: true,
        cause: GapCause::Unplugged,
    }
}

fn status(state: SensorState, capturing: bool) -> Status {
    let mut status = Status::default();
    status.sensor.state = state;
    status.storage.database = "/data/vn100d.db".to_owned();
    status.storage.free_bytes = 100 << 30;
    status.capture = capturing.then(|| CaptureStatus {
        id: 7,
        name: "night".to_owned(),
        state: "capturing".to_owned(),
        elapsed_s: 60.0,
        remaining_s: 60.0,
        samples: 2400,
        missing: 0,
        gaps: 0,
        received: 2400,
        committed: 2400,
        in_flight: 0,
        discarded: BTreeMap::new(),
        last_sample_age_s: None,
        gap_open_since: None,
    });
    status
}

fn watcher() -> Watcher {
    Watcher::new(WatchOptions { sensor_lost_after: Duration::from_secs(30), reserve_bytes: 1 << 30 })
}

fn events(notices: &[Notice]) -> Vec<&'static str> {
    notices.iter().map(|notice| notice.event.name()).collect()
}

#[test]
fn a_sensor_is_lost_after_its_time_once_and_back_once() {
    let mut watcher = watcher();
    let mut at = |second: u64, state, capturing| {
        let notices = watcher.observe(second * S, 0, &status(state, capturing));
        events(&notices)
    };
    // Without a capture no one waits for it.
    assert_eq!(at(0, SensorState::Absent, false), [""; 0]);
    assert_eq!(at(100, SensorState::Absent, false), [""; 0]);
    // A short interruption is not reported.
    assert_eq!(at(101, SensorState::Streaming, true), [""; 0]);
    assert_eq!(at(110, SensorState::Absent, true), [""; 0]);
    assert_eq!(at(139, SensorState::Opening, true), [""; 0]);
    assert_eq!(at(139, SensorState::Streaming, true), [""; 0]);
    assert_eq!(at(140, SensorState::Stalled, true), [""; 0]);
    assert_eq!(at(169, SensorState::Backoff, true), [""; 0]);
    assert_eq!(at(170, SensorState::Absent, true), ["sensor_lost"]);
    assert_eq!(at(500, SensorState::Probing, true), [""; 0]);
    // The capture was stopped meanwhile: a receiver that was notified of the loss is nevertheless notified of the
    // return.
    assert_eq!(at(501, SensorState::Absent, false), [""; 0]);
    assert_eq!(at(502, SensorState::Streaming, false), ["sensor_back"]);
    assert_eq!(at(503, SensorState::Streaming, true), [""; 0]);
}

#[test]
fn a_gap_opens_once_and_its_end_has_number_and_cause() {
    let mut watcher = watcher();
    let mut open = status(SensorState::Streaming, true);
    assert_eq!(watcher.observe(0, 0, &open).len(), 0);
    open.capture.as_mut().unwrap().gap_open_since = Some("2026-11-21T20:00:00Z".to_owned());
    let notices = watcher.observe(S, 0, &open);
    assert_eq!(events(&notices), ["gap_opened"]);
    assert_eq!(notices[0].message(), "capture 7 (night): no samples since 2026-11-21T20:00:00Z");
    assert_eq!(watcher.observe(2 * S, 0, &open).len(), 0);
    let closed = watcher.sign(0, Sign::Gap(7, gap(400)));
    assert_eq!(events(&closed), ["gap_closed"]);
    assert_eq!(closed[0].message(), "capture 7 (night): samples come again, 400 missing in 10.0 s: unplugged");
    assert_eq!(watcher.observe(3 * S, 0, &status(SensorState::Streaming, true)).len(), 0);
    open.capture.as_mut().unwrap().gap_open_since = Some("2026-11-21T20:10:00Z".to_owned());
    assert_eq!(events(&watcher.observe(4 * S, 0, &open)), ["gap_opened"], "another gap");
}

#[test]
fn storage_is_low_by_space_by_time_and_by_trouble_and_well_again_with_room_to_spare() {
    let mut watcher = watcher();
    let mut at = |second: u64, free_mib: u64, lasts_h: Option<f64>, state| {
        let mut status = status(SensorState::Streaming, true);
        status.storage.free_bytes = free_mib << 20;
        status.storage.time_to_full_s = lasts_h.map(|hours| hours * 3600.0);
        status.storage.state = state;
        let notices = watcher.observe(second * S, 0, &status);
        events(&notices)
    };
    assert_eq!(at(0, 2000, Some(100.0), StorageState::Ok), [""; 0]);
    assert_eq!(at(1, 1000, Some(100.0), StorageState::Ok), ["storage_low"]);
    assert_eq!(at(2, 1030, Some(100.0), StorageState::Ok), [""; 0], "hardly above the reserve");
    assert_eq!(at(3, 1200, Some(100.0), StorageState::Ok), ["storage_ok"]);
    assert_eq!(at(4, 9000, Some(11.9), StorageState::Ok), ["storage_low"]);
    assert_eq!(at(5, 9000, Some(12.5), StorageState::Ok), [""; 0]);
    assert_eq!(at(6, 9000, None, StorageState::Slow), ["storage_ok"]);
    // A brief lock is not reported; a disk that refuses for seconds is.
    assert_eq!(at(7, 9000, None, StorageState::StorageLocked), [""; 0]);
    assert_eq!(at(9, 9000, None, StorageState::Ok), [""; 0]);
    assert_eq!(at(10, 9000, None, StorageState::StorageReadonly), [""; 0]);
    assert_eq!(at(15, 9000, None, StorageState::StorageReadonly), ["storage_low"]);
    assert_eq!(at(16, 9000, None, StorageState::Ok), ["storage_ok"]);
}

fn closed(utc_s: i64, missing: u64) -> Notice {
    let mut notice = Notice::new(NotifyEvent::GapClosed, utc_s * S as i64);
    notice.gap = Some(GapFacts::closed(&gap(missing)));
    notice
}

/// A gap a second for eight hours: a message at once, then one per interval that doubles up to an hour, and together
/// they contain every gap.
#[test]
fn a_gap_a_second_does_not_make_a_message_a_second() {
    let mut coalescer = Coalescer::new(Duration::from_secs(60));
    let mut messages: Vec<(u64, Notice)> = Vec::new();
    let hours = 8 * 3600;
    for second in 0..hours {
        messages.extend(coalescer.due(second * S).into_iter().map(|notice| (second, notice)));
        messages.extend(coalescer.offer(second * S, closed(second as i64, 3)).map(|notice| (second, notice)));
    }
    let rest = coalescer.due((hours + 3600) * S);
    messages.extend(rest.into_iter().map(|notice| (hours, notice)));
    assert_eq!(messages[0].0, 0, "the first at once");
    assert_eq!(messages[1].0, 60);
    assert!((10..=16).contains(&messages.len()), "{} messages", messages.len());
    assert_eq!(messages.iter().map(|(_, notice)| notice.count).sum::<u64>(), hours);
    let missing = |notice: &Notice| notice.gap.as_ref().unwrap().missing.unwrap();
    assert_eq!(messages.iter().map(|(_, notice)| missing(notice)).sum::<u64>(), 3 * hours);
    assert!(messages.windows(2).all(|pair| pair[1].0 - pair[0].0 <= 3600 || pair[1].0 == hours), "at least hourly");
    // After an hour without a gap the next one is reported at once.
    assert!(coalescer.offer(3 * hours * S, closed(0, 1)).is_some());
}

#[test]
fn captures_that_complete_never_stand_for_one_another() {
    let mut coalescer = Coalescer::new(Duration::from_secs(60));
    for second in 0..10 {
        assert!(coalescer.offer(second * S, Notice::new(NotifyEvent::CaptureCompleted, 0)).is_some());
    }
    assert_eq!(coalescer.deadline_ns(), None);
}

#[test]
fn a_message_has_the_same_content_as_json_and_in_the_environment() {
    let mut watcher = watcher();
    watcher.observe(0, 0, &status(SensorState::Streaming, true));
    let notice = watcher.sign(5, Sign::Gap(7, gap(400))).remove(0);
    let message = notice.rendered(&sender());
    let json: serde_json::Value = serde_json::from_str(&message.body).unwrap();
    assert_eq!(json["format"], "vn100d-notice-1");
    assert_eq!(json["event"], "gap_closed");
    assert_eq!(json["capture"]["name"], "night");
    assert_eq!(json["gap"]["missing"], 400);
    assert_eq!(json["gap"]["cause"], "unplugged");
    assert_eq!(json["host"], "bench");
    let variable = |name| message.environment.iter().find(|(key, _)| *key == name).unwrap().1.as_str();
    assert_eq!(variable("VN100D_EVENT"), "gap_closed");
    assert_eq!(variable("VN100D_EVENT_CAPTURE"), "7");
    assert_eq!(variable("VN100D_EVENT_MESSAGE"), json["message"]);
}

#[test]
fn waits_double_up_to_five_minutes() {
    let effort = Effort { attempts: 20, timeout: Duration::from_secs(1), retry_after: Duration::from_secs(2) };
    let waits: Vec<u64> = (1..=10).map(|failed| effort.wait(failed).as_secs()).collect();
    assert_eq!(waits, [2, 4, 8, 16, 32, 64, 128, 256, 300, 300]);
    assert_eq!(effort.wait(u32::MAX), Duration::from_secs(300));
}

fn message() -> Arc<Message> {
    Arc::new(closed(0, 1).rendered(&sender()))
}

fn effort(attempts: u32, timeout_ms: u64) -> Effort {
    Effort { attempts, timeout: Duration::from_millis(timeout_ms), retry_after: Duration::from_millis(20) }
}

/// Returns a receiver that answers one connection after the other with these bytes (`None`: it sends nothing and keeps
/// it open), and the data it received.
fn receiver(answers: Vec<Option<&'static str>>) -> (Receiver, Arc<Mutex<Vec<String>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let shown = format!("http://{}", listener.local_addr().unwrap());
    let received = Arc::new(Mutex::new(Vec::new()));
    let theirs = Arc::clone(&received);
    std::thread::spawn(move || {
        let mut open = Vec::new();
        for answer in answers {
            let Ok((mut stream, _)) = listener.accept() else { return };
            let mut text = String::new();
            let mut buffer = [0; 4096];
            // Head and body: the body ends with the object.
            while !text.ends_with('}') {
                match stream.read(&mut buffer) {
                    Ok(count) if count > 0 => text.push_str(&String::from_utf8_lossy(&buffer[..count])),
                    _ => break,
                }
            }
            theirs.lock().unwrap().push(text);
            match answer {
                Some(answer) => drop(stream.write_all(answer.as_bytes())),
                None => open.push(stream),
            }
        }
        // Hangs until the test ends.
        std::thread::park();
    });
    (Receiver::Url { url: format!("{shown}/secret"), shown }, received)
}

fn until(what: &str, condition: impl Fn() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(20);
    while !condition() {
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

const OK: &str = "HTTP/1.1 200 OK\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
const SORRY: &str = "HTTP/1.1 500 Internal Server Error\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
const NOT_FOUND: &str = "HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
const MOVED: &str = "HTTP/1.1 302 Found\r\nLocation: /elsewhere\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";

fn figures(worker: &Worker) -> NotifyStatus {
    worker.figures().lock().clone()
}

#[test]
fn a_receiver_that_hangs_then_errs_then_takes_it_has_it_after_three_attempts() {
    let (receiver, received) = receiver(vec![None, Some(SORRY), Some(OK)]);
    let worker = Worker::start(receiver, effort(5, 300)).unwrap();
    worker.put(message());
    until("sent", || figures(&worker).sent == 1);
    let status = figures(&worker);
    assert_eq!((status.failed, status.dropped, status.queued, status.error), (0, 0, 0, None));
    let received = received.lock().unwrap();
    assert_eq!(received.len(), 3);
    assert!(received.iter().all(|text| text.starts_with("POST /secret HTTP/1.1\r\n")), "{received:?}");
    assert!(received[2].contains("content-type: application/json") && received[2].contains("\"event\":\"gap_closed\""));
    Worker::stop(vec![worker]);
}

#[test]
fn an_answer_that_will_not_change_is_not_asked_for_again() {
    for (answer, status) in [(NOT_FOUND, 404), (MOVED, 302)] {
        let (receiver, received) = receiver(vec![Some(answer), Some(OK)]);
        let worker = Worker::start(receiver, effort(5, 2000)).unwrap();
        worker.put(message());
        until("given up", || figures(&worker).failed == 1);
        assert_eq!(received.lock().unwrap().len(), 1);
        let error = figures(&worker).error.unwrap();
        assert!(error.ends_with(&format!("answered {status}")) && !error.contains("secret"), "{error}");
        Worker::stop(vec![worker]);
    }
}

#[test]
fn an_absent_receiver_is_given_up_after_the_attempts_and_what_does_not_fit_is_dropped() {
    // A port that was free a moment ago: refused at once.
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let receiver = Receiver::Url { url: format!("http://{address}/secret"), shown: format!("http://{address}") };
    let worker = Worker::start(receiver, effort(3, 1000)).unwrap();
    worker.put(message());
    until("given up", || figures(&worker).failed == 1);
    let error = figures(&worker).error.unwrap();
    assert!(error.contains("did not answer") && !error.contains("secret"), "{error}");
    Worker::stop(vec![worker]);

    let (receiver, _) = self::receiver(vec![None; 3]);
    let worker = Worker::start(receiver, effort(1, 60_000)).unwrap();
    let begun = Instant::now();
    for _ in 0..QUEUE + 50 {
        worker.put(message());
    }
    assert!(begun.elapsed() < Duration::from_secs(1), "the sender never waits");
    let status = figures(&worker);
    assert!((49..=50).contains(&status.dropped), "{status:?}");
    assert_eq!(status.queued + status.dropped, QUEUE as u64 + 50);
    let begun = Instant::now();
    Worker::stop(vec![worker]);
    assert!(begun.elapsed() < Duration::from_secs(4), "an end does not wait for a receiver that hangs");
}

#[test]
fn a_program_gets_the_event_in_its_environment_and_on_its_input() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let script = format!("(printf '%s|' \"$VN100D_EVENT\" \"$1\"; cat) > {}", out.display());
    let receiver = Receiver::Command(["sh", "-c", &script, "sh", "a b;$HOME"].map(str::to_owned).to_vec());
    receiver.attempt(&message(), Duration::from_secs(20), || true).unwrap();
    let output = std::fs::read_to_string(&out).unwrap();
    let (before, json) = output.split_once('{').unwrap();
    assert_eq!(before, "gap_closed|a b;$HOME|", "arguments are passed as they are");
    assert!(serde_json::from_str::<serde_json::Value>(&format!("{{{json}")).is_ok());
}

#[test]
fn a_program_that_fails_or_is_missing_is_reported() {
    let run = |command: &[&str]| {
        let receiver = Receiver::Command(command.iter().map(|&word| word.to_owned()).collect());
        receiver.attempt(&message(), Duration::from_secs(20), || true).unwrap_err()
    };
    assert_eq!(run(&["sh", "-c", "exit 3"]).to_string(), "sh ended with exit code 3");
    assert_eq!(run(&["sh", "-c", "kill -9 $$"]).to_string(), "sh ended with signal 9");
    assert!(matches!(run(&["/nonexistent/pager"]), DeliverError::Start { .. }));
}

#[test]
fn a_program_that_hangs_is_killed_with_what_it_started() {
    let folder = tempfile::tempdir().unwrap();
    let pid = folder.path().join("pid");
    let script = format!("sleep 600 & echo $! > {}; wait", pid.display());
    let receiver = Receiver::Command(["sh", "-c", &script].map(str::to_owned).to_vec());
    let begun = Instant::now();
    let error = receiver.attempt(&message(), Duration::from_millis(1500), || true).unwrap_err();
    assert!(matches!(error, DeliverError::Killed { .. }), "{error}");
    assert!(begun.elapsed() < Duration::from_secs(10));
    let child: u32 = std::fs::read_to_string(&pid).unwrap().trim().parse().unwrap();
    // Gone, or waiting for its adoptive parent to collect its status.
    until("its child is gone", || {
        std::fs::read_to_string(format!("/proc/{child}/stat")).map_or(true, |stat| stat.contains(") Z "))
    });
}

/// A body beyond the pipe's 64 KiB, as many planned deletions produce.
#[test]
fn a_long_body_is_handed_over_whole_and_waits_for_no_program_that_does_not_read() {
    let long = Message { event: "test", body: "x".repeat(1 << 20), environment: Vec::new() };
    let command = |words: &[&str]| Receiver::Command(words.iter().map(|word| (*word).to_owned()).collect());
    let begun = Instant::now();
    let error = command(&["sleep", "600"]).attempt(&long, Duration::from_millis(500), || true).unwrap_err();
    assert!(matches!(error, DeliverError::Killed { .. }), "{error}");
    assert!(begun.elapsed() < Duration::from_secs(20), "{:?}", begun.elapsed());
    let error = command(&["sleep", "600"]).attempt(&long, Duration::from_secs(600), || false).unwrap_err();
    assert_eq!(error, DeliverError::Stopped);
    // A body that is read slowly still arrives; if the pipe is closed at once, the program's exit code counts.
    let slow = "head -c 300000 | wc -c; sleep 0.3; test \"$(wc -c)\" -eq 748576";
    command(&["sh", "-c", slow]).attempt(&long, Duration::from_secs(60), || true).unwrap();
    command(&["sh", "-c", "exec <&-; exit 0"]).attempt(&long, Duration::from_secs(60), || true).unwrap();
}

#[test]
fn a_hanging_program_ends_with_the_daemon() {
    let receiver = Receiver::Command(["sleep", "600"].map(str::to_owned).to_vec());
    let worker = Worker::start(receiver, effort(1, 60_000)).unwrap();
    worker.put(message());
    until("it runs", || figures(&worker).queued == 1);
    let shared = worker.figures();
    let begun = Instant::now();
    Worker::stop(vec![worker]);
    assert!(begun.elapsed() < Duration::from_secs(4));
    let status = shared.lock().clone();
    assert_eq!((status.failed, status.queued), (1, 0), "{status:?}");
}

/// Many gaps reach a receiver that hangs as a few messages, and a receiver that works beside it gets all of them.
#[tokio::test(flavor = "multi_thread")]
async fn a_hanging_receiver_costs_the_other_one_nothing() {
    let (hanging, _) = receiver(vec![None; 4]);
    let (working, received) = receiver(vec![Some(OK); 8]);
    let notifier = Notifier::start(NotifyOptions {
        receivers: vec![hanging, working],
        events: NotifyEvent::ALL.to_vec(),
        coalesce: Duration::from_millis(700),
        watch: WatchOptions { sensor_lost_after: Duration::from_secs(30), reserve_bytes: 0 },
        effort: effort(2, 30_000),
        sender: sender(),
    })
    .unwrap();
    let (tap, figures) = (notifier.tap(), notifier.figures());
    let (_status, status) = channel::channel(Status::default());
    let stop = CancellationToken::new();
    let running = tokio::spawn(notifier.run(status, Arc::new(SystemClock), stop.clone()));
    for number in 0..50 {
        tap.gap(7, &gap(number));
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    tokio::task::spawn_blocking(move || until("both messages", || received.lock().unwrap().len() >= 2)).await.unwrap();
    let counts = figures.status();
    assert!((2..=8).contains(&counts.sent), "50 gaps, at most 8 messages: {counts:?}");
    assert!(counts.queued >= 1 && counts.dropped == 0, "{counts:?}");
    let begun = Instant::now();
    stop.cancel();
    running.await.unwrap();
    assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
}

#[test]
fn a_thousand_deletions_are_one_short_message_that_counts_them() {
    let planned = |id: i64| PlannedDeletion {
        capture: id,
        name: format!("night {id}"),
        bytes: 1,
        reason: "age".to_owned(),
        delete_at: "2026-11-22T20:00:00Z".to_owned(),
    };
    let mut watcher = watcher();
    let mut notices = watcher.sign(0, Sign::Deletions((0..1000).map(planned).collect()));
    let later = watcher.sign(1, Sign::Deletions(vec![planned(1000)])).remove(0);
    notices[0].take_in(later);
    let notice = &notices[0];
    assert_eq!((notice.deletions.len(), notice.deletions_total, notice.count), (20, 1001, 2));
    assert!(notice.message().ends_with("and 981 more (/v1/status)") && notice.message().len() < 4096);
}

#[test]
fn every_skipped_night_is_reported_separately_with_its_reason() {
    let mut coalescer = Coalescer::new(Duration::from_secs(60));
    for name in ["nightly-2026-11-21", "nightly-2026-11-22"] {
        let reason = "capture 7 runs or waits: stop it, or let it end".to_owned();
        let night = NightFacts { name: name.to_owned(), reason };
        let notice = watcher().sign(0, Sign::Skipped(night)).remove(0);
        let notice = coalescer.offer(0, notice).unwrap();
        let expected = format!("the night {name} was not recorded: capture 7 runs or waits: stop it, or let it end");
        assert_eq!(notice.message(), expected);
        let body: serde_json::Value = serde_json::from_str(&notice.rendered(&sender()).body).unwrap();
        assert_eq!((&body["event"], &body["night"]["name"]), (&"night_skipped".into(), &name.into()));
    }
}

#[test]
fn without_receivers_the_tap_forgets() {
    let tap = Tap::default();
    assert!(!tap.has_receiver());
    tap.gap(1, &gap(1));
}
