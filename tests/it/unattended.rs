//! Unattended operation: notifications arrive, old captures are deleted as announced, and neither costs a sample.

use crate::world::{World, program, vn100d};
use serde_json::Value;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};
use std::time::Duration;

const START: Duration = Duration::from_secs(20);

/// Returns a receiver that fails its first `refused` requests, and the messages that it received after that.
fn receiver(refused: usize) -> (String, Arc<Mutex<Vec<Value>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/topic", listener.local_addr().unwrap());
    let received = Arc::new(Mutex::new(Vec::new()));
    let theirs = Arc::clone(&received);
    std::thread::spawn(move || {
        for number in 0.. {
            let Ok((mut stream, _)) = listener.accept() else { return };
            let (mut text, mut buffer) = (String::new(), [0; 8192]);
            while !text.ends_with('}') {
                match stream.read(&mut buffer) {
                    Ok(count) if count > 0 => text.push_str(&String::from_utf8_lossy(&buffer[..count])),
                    _ => break,
                }
            }
            let answer = if number < refused { "503 Service Unavailable" } else { "204 No Content" };
            let _ = stream
                .write_all(format!("HTTP/1.1 {answer}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n").as_bytes());
            if number >= refused
                && let Some((_, body)) = text.split_once("\r\n\r\n")
            {
                theirs.lock().unwrap().push(serde_json::from_str(body).unwrap());
            }
        }
    });
    (url, received)
}

/// A sensor unplugged and back: the gap's end, the loss and the capture's completion arrive at a URL that failed at
/// first, while a program that hangs is killed repeatedly; this costs no sample and no answer.
#[test]
fn a_receiver_is_notified_and_one_that_hangs_costs_nothing() {
    let world = World::new();
    let (url, received) = receiver(1);
    let configuration = format!(
        "[notify]\ncommand = [\"sleep\", \"600\"]\nurl = \"{url}\"\nsensor-lost-after = \"1s\"\ncoalesce = \"1s\"\n\
         timeout = \"700ms\"\nattempts = 3\nretry-after = \"200ms\"\n"
    );
    let sensor = world.emulate(&[]);
    let mut daemon = world.daemon(&configuration, &["--capture", "9s"]);
    let some = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(80));
    world.until("samples", START, some, &daemon);
    drop(sensor);
    let events = || -> Vec<String> {
        received.lock().unwrap().iter().map(|notice| notice["event"].as_str().unwrap().to_owned()).collect()
    };
    let lost = || events().contains(&"sensor_lost".to_owned()).then_some(());
    world.until("the loss is reported", START, lost, &daemon);
    let begun = std::time::Instant::now();
    assert!(world.try_get("/v1/status").is_some());
    assert!(begun.elapsed() < Duration::from_secs(2), "{:?}", begun.elapsed());
    let _sensor = world.emulate(&[]);
    let complete = || events().contains(&"capture_completed".to_owned()).then_some(());
    world.until("the end is reported", Duration::from_secs(40), complete, &daemon);
    let received = received.lock().unwrap().clone();
    for event in ["gap_opened", "sensor_lost", "sensor_back", "gap_closed"] {
        assert_eq!(received.iter().filter(|notice| notice["event"] == event).count(), 1, "{event}: {received:?}");
    }
    let find = |event: &str| received.iter().find(|notice| notice["event"] == event).unwrap();
    assert_eq!(find("gap_closed")["gap"]["cause"], "unplugged");
    let end = &find("capture_completed")["capture"];
    assert_eq!(end["samples"].as_u64().unwrap() + end["missing"].as_u64().unwrap(), 360, "9 s at 40 Hz");
    assert_eq!(find("gap_closed")["gap"]["missing"], end["missing"]);
    let counted = || {
        world.try_get("/v1/status").filter(|status| {
            let count = |name: &str| status["notify"][name].as_u64().unwrap();
            count("failed") >= 1 && count("sent") >= 5
        })
    };
    let status = world.until("the program is given up, the address has all", START, counted, &daemon);
    assert!(status["notify"]["error"].as_str().unwrap().contains("sleep"), "{status}");
    let children = std::fs::read_to_string(format!("/proc/{0}/task/{0}/children", daemon.id())).unwrap_or_default();
    assert!(children.split_whitespace().count() <= 1, "one program at a time: {children}");
    assert_eq!(daemon.terminate(), Some(0));
    assert_eq!(format!("{:?}", world.query("PRAGMA integrity_check")), "[[Text(\"ok\")]]");
}

fn captures(world: &World) -> String {
    let output = vn100d(&["--data-dir", world.path("data").to_str().unwrap(), "captures"]);
    String::from_utf8(output.stdout).unwrap()
}

/// Three recordings of 1.45 MiB exceed a limit of 2 MiB: the oldest is pinned and stays. The others are announced a day
/// ahead, survive a restart as announced, and are deleted with their rows once their notice is over. The capture that
/// runs meanwhile loses nothing.
#[test]
fn the_oldest_captures_go_as_was_announced_and_pinned_or_running_ones_stay() {
    let world = World::new();
    for name in ["one", "two", "three"] {
        let file = world.path(&format!("{name}.csv"));
        let rows: String = (0..8000).map(|row| format!("{:.3},{}\n", f64::from(row) * 0.025, row % 7)).collect();
        // Another column's name makes it another recording.
        std::fs::write(&file, format!("time_s,gyro_x_rad_s,{name}\n{}", rows.replace('\n', ",0\n"))).unwrap();
        let mut import = program();
        import.args(["--data-dir", world.path("data").to_str().unwrap(), "import", file.to_str().unwrap()]);
        assert!(import.output().unwrap().status.success());
    }
    let limits = |notice: &str| format!("[storage]\nkeep-mib = 2\ndelete-notice = \"{notice}\"\n");
    let mut daemon = world.daemon(&limits("24h"), &[]);
    let planned = |count: u64| {
        let status = world.try_get("/v1/status");
        move || status.clone().filter(|status| status["retention"]["planned_total"] == count)
    };
    let plan = world.until("a plan", START, || planned(2)(), &daemon);
    let at = plan["retention"]["planned"][0]["delete_at"].clone();
    assert_eq!(plan["retention"]["planned"][0]["name"], "one");
    assert_eq!(plan["retention"]["planned"][0]["reason"], "size");
    assert!(daemon.log().contains("it will be deleted unless it is pinned"), "{}", daemon.log());
    assert!(captures(&world).contains("will be deleted on"));
    assert_eq!(world.get("/v1/captures/one")["delete_at"], at);
    // A pinned capture leaves the plan at once, and at the next look another one is planned.
    let (code, pinned) = world.request("POST", "/v1/captures/one/pin", "").unwrap();
    assert_eq!(code, 200, "{pinned}");
    let pinned: Value = serde_json::from_str(&pinned).unwrap();
    assert_eq!((&pinned["pinned"], &pinned["delete_at"]), (&Value::Bool(true), &Value::Null));
    assert_eq!(world.request("DELETE", "/v1/captures/one", "").unwrap().0, 409);
    assert_eq!(daemon.terminate(), Some(0));

    // After a restart the announcement still holds, for the same time.
    let mut daemon = world.daemon(&limits("24h"), &[]);
    world.until("the new plan", START, || planned(2)(), &daemon);
    assert_eq!(world.get("/v1/captures/one")["delete_at"], Value::Null);
    assert!(world.get("/v1/captures/two")["delete_at"].is_string());
    assert!(world.get("/v1/captures/three")["delete_at"].is_string());
    // Unpinned it is the oldest again, and the youngest may stay.
    let (code, _) = world.request("POST", "/v1/captures/one/pin", "{\"pinned\": false}").unwrap();
    assert_eq!(code, 200);
    assert_eq!(world.request("POST", "/v1/captures/one/pin", "{\"pinned\": true}").unwrap().0, 200);
    assert_eq!(daemon.terminate(), Some(0));
    assert_eq!(format!("{:?}", world.query("SELECT count(*) FROM capture")), "[[Integer(3)]]", "nothing went early");

    // Without limits the announcements are withdrawn.
    let mut daemon = world.daemon("", &[]);
    let none = "SELECT count(*) FROM capture WHERE delete_at_utc_ns IS NOT NULL OR deletion_said_utc_ns IS NOT NULL";
    let taken_back = || (format!("{:?}", world.query(none)) == "[[Integer(0)]]").then_some(());
    world.until("what was announced is taken back", START, taken_back, &daemon);
    assert_eq!(daemon.terminate(), Some(0));

    // A notice of two seconds, and a capture that runs meanwhile.
    let _sensor = world.emulate(&[]);
    let mut daemon = world.daemon(&limits("2s"), &["--capture", "6s"]);
    let gone = || world.try_get("/v1/status").filter(|status| status["retention"]["deleted"] == 2);
    world.until("two are deleted", Duration::from_secs(30), gone, &daemon);
    assert!(daemon.log().contains("deleted, as was announced"), "{}", daemon.log());
    assert_eq!(world.request("GET", "/v1/captures/two", "").unwrap().0, 404);
    assert_eq!(world.get("/v1/captures/one")["pinned"], true);
    let ended = || world.try_get("/v1/captures/latest").filter(|capture| capture["state"] == "complete");
    let capture = world.until("the capture ends", Duration::from_secs(40), ended, &daemon);
    assert_eq!((&capture["samples"], &capture["missing"]), (&Value::from(240), &Value::from(0)));
    let purged = || {
        let rows = world.query("SELECT count(DISTINCT capture_id) FROM sample");
        (format!("{rows:?}") == "[[Integer(2)]]").then_some(())
    };
    world.until("their rows are gone", Duration::from_secs(40), purged, &daemon);
    assert_eq!(daemon.terminate(), Some(0));
    assert_eq!(format!("{:?}", world.query("PRAGMA integrity_check")), "[[Text(\"ok\")]]");
}

#[test]
fn a_test_message_reports_which_receiver_took_it() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("vn100d.toml");
    let out = folder.path().join("out");
    let run = |text: String| {
        std::fs::write(&config, text).unwrap();
        let data = folder.path().to_str().unwrap().to_owned();
        vn100d(&["--data-dir", &data, "--config", config.to_str().unwrap(), "notify"])
    };
    let script = format!("echo $VN100D_EVENT > {}", out.display());
    let output = run(format!("[notify]\ncommand = [\"sh\", \"-c\", \"{script}\"]\n"));
    assert_eq!((output.status.code(), String::from_utf8_lossy(&output.stdout).as_ref()), (Some(0), "sh: told\n"));
    assert_eq!(std::fs::read_to_string(&out).unwrap(), "test\n");
    let output = run("[notify]\ncommand = [\"false\"]\nattempts = 1\n".to_owned());
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stdout).contains("exit code 1"));
    let output = run(String::new());
    assert_eq!(output.status.code(), Some(78));
    assert!(String::from_utf8_lossy(&output.stderr).contains("notify.command"));
}

#[test]
fn manual_pages_are_made_of_the_arguments() {
    let folder = tempfile::tempdir().unwrap();
    assert!(vn100d(&["generate", "man", folder.path().to_str().unwrap()]).status.success());
    let page = std::fs::read_to_string(folder.path().join("vn100d-noise.1")).unwrap();
    assert!(page.contains(".TH vn100d") && page.contains("rate"), "{page}");
    let count = std::fs::read_dir(folder.path()).unwrap().count();
    let help = String::from_utf8(vn100d(&["--help"]).stdout).unwrap();
    let (_, commands) = help.split_once("Commands:").unwrap();
    let (commands, _) = commands.split_once("Options:").unwrap();
    let shown = commands.lines().filter(|line| line.starts_with("  ") && !line.starts_with("   ")).count();
    // All commands but `help`, and the page of the program itself.
    assert_eq!(count, shown, "{commands}");
    assert_eq!(vn100d(&["generate", "poetry", "x"]).status.code(), Some(2));
}
