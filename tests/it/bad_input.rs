//! Errors state a remedy, with the exit code of docs/formats.md.

use crate::world::{Process, World, program, vn100d};
use std::time::Duration;

fn fails(arguments: &[&str], code: i32, words: &[&str]) {
    let output = vn100d(arguments);
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
    for word in words {
        assert!(text.contains(word), "{arguments:?}: {word} is not in: {text}");
    }
}

#[test]
fn usage_is_two_and_an_absent_daemon_sixty_nine() {
    fails(&["--no-such-flag"], 2, &["--no-such-flag"]);
    fails(&["run", "--capture", "5"], 2, &["5h"]);
    fails(&["status", "--listen", "127.0.0.1:1"], 69, &["127.0.0.1:1"]);
}

#[test]
fn a_bad_configuration_is_seventy_eight_with_file_line_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("vn100d.toml");
    let data = folder.path().join("data");
    let run = |text: &str, words: &[&str]| {
        std::fs::write(&config, text).unwrap();
        fails(&["--data-dir", data.to_str().unwrap(), "--config", config.to_str().unwrap(), "run"], 78, words);
    };
    run("[sensor]\nrate-hertz = 40\n", &["vn100d.toml", "2", "rate-hertz"]);
    run("[sensor]\nrate-hz = 41.5\n", &["rate-hz"]);
    run("[sensor]\nbaud = 115200\nrate-hz = 800\n", &["70 bytes × 800 Hz × 10 bits = 560000 bit/s", "115200"]);
    run("[http]\nlisten = \"0.0.0.0:8100\"\n", &["token"]);
    assert!(!data.join("vn100d.db").exists(), "nothing was made");
}

#[test]
fn a_database_that_is_in_use_is_seventy_three_and_names_the_process() {
    let world = World::new();
    let daemon = world.daemon("", &[]);
    let pid = daemon.id().to_string();
    let data = world.path("data");
    let started = std::time::Instant::now();
    fails(&["--data-dir", data.to_str().unwrap(), "run", "--listen", "127.0.0.1:0"], 73, &["vn100d.db", &pid]);
    assert!(started.elapsed() < Duration::from_secs(2));
    assert!(world.try_get("/healthz").is_some(), "the first goes on");
}

#[test]
fn a_database_of_a_newer_version_is_seventy_eight_and_untouched() {
    let world = World::new();
    world.daemon("", &[]).terminate();
    let connection = rusqlite::Connection::open(world.database()).unwrap();
    connection.pragma_update(None, "user_version", 9999).unwrap();
    drop(connection);
    let before = std::fs::read(world.database()).unwrap();
    let data = world.path("data");
    fails(&["--data-dir", data.to_str().unwrap(), "run", "--listen", "127.0.0.1:0"], 78, &["9999"]);
    assert_eq!(std::fs::read(world.database()).unwrap(), before);
}

#[test]
fn a_missing_device_and_a_busy_port_are_states_with_a_hint() {
    let world = World::new();
    let daemon = world.daemon("", &[]);
    let hinted = || world.try_get("/v1/status").filter(|status| status["sensor"]["hint"].is_string());
    let status = world.until("the absence is explained", Duration::from_secs(5), hinted, &daemon);
    assert_eq!(status["sensor"]["state"], "absent");
    assert!(status["sensor"]["hint"].as_str().unwrap().contains("plug"));
    drop(daemon);

    let _sensor = world.emulate(&[]);
    let first = world.daemon("", &[]);
    let streaming = || world.try_get("/v1/status").filter(|status| status["sensor"]["state"] == "streaming");
    world.until("the first has the port", Duration::from_secs(10), streaming, &first);
    let second = World::new();
    let mut command = program();
    command.args(["--data-dir", second.path("data").to_str().unwrap(), "run"]).args([
        "--listen",
        second.url.trim_start_matches("http://"),
        "--device",
        world.port().to_str().unwrap(),
    ]);
    let process = Process::start(&mut command, false);
    let busy = || second.try_get("/v1/status").filter(|status| status["sensor"]["state"] == "port_busy");
    let status = second.until("the port is busy", Duration::from_secs(10), busy, &process);
    assert!(status["sensor"]["hint"].as_str().unwrap().contains(&first.id().to_string()), "{status}");
}

#[test]
fn a_file_that_is_no_recording_is_named_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (data, file) = (folder.path().join("data"), folder.path().join("holiday.jpg"));
    std::fs::write(&file, [0xff, 0xd8, 0xff, 0xe0, 0, 16, 74, 70]).unwrap();
    let data = data.to_str().unwrap();
    fails(&["--data-dir", data, "import", file.to_str().unwrap()], 1, &["holiday.jpg"]);
    let captures = vn100d(&["--data-dir", data, "--json", "captures"]);
    let captures: serde_json::Value = serde_json::from_slice(&captures.stdout).unwrap();
    assert_eq!(captures["captures"].as_array().unwrap().len(), 0);
    fails(&["--data-dir", data, "show", "latest"], 1, &["latest"]);
}

/// A user who types a path means a recording: if it is not one, the error reports that, not a missing capture in a
/// missing database.
#[test]
fn a_path_that_is_no_recording_is_called_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let data = at("data");
    assert!(std::process::Command::new("mkfifo").arg(at("pipe")).status().unwrap().success());
    let cases = [
        (at("pipe"), "a pipe"),
        (folder.path().display().to_string(), "a folder"),
        ("/dev/null".to_owned(), "a device"),
        (at("nothing.csv"), "No such file"),
    ];
    for (path, word) in &cases {
        for command in [&["noise"][..], &["allan"], &["show"], &["export"], &["report", "--out", &at("out.html")]] {
            fails(&[&["--data-dir", &data], command, &[path]].concat(), 74, &[path, word]);
        }
    }
    // A name refers to a capture.
    fails(&["--data-dir", &data, "noise", "night"], 1, &["there is no database"]);
}
