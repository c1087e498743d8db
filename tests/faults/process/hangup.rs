//! SIGHUP: a terminal that is closed, and a manager that requests a reload of the configuration.

use super::{Manager, START, integer};
use crate::tools;
use crate::world::{Process, World, program, vn100d};
use rusqlite::types::Value;
use rustix::process::Signal;
use std::process::Command;
use std::time::{Duration, Instant};

/// Asserts that the sensor's output was restored: ASCII, as before the daemon configured it.
fn assert_restored(world: &World) {
    let probe = vn100d(&["--json", "probe", "--device", world.port().to_str().unwrap()]);
    let found: serde_json::Value = serde_json::from_slice(&probe.stdout).unwrap();
    assert_eq!(found["output"], "VNYMR", "{found}");
}

/// Returns the daemon as started by a user or a manager: this process's own manager must not be notified.
fn outside_of_systemd() -> Command {
    let mut command = program();
    command.env_remove("INVOCATION_ID");
    command
}

#[test]
fn a_hangup_ends_the_capture_cleanly_unless_it_is_to_go_on() {
    let world = World::new();
    let _sensor = world.emulate(&[]);
    let port = world.port().to_str().unwrap().to_owned();
    let mut daemon = world.daemon_of(outside_of_systemd(), &port, "", &["--capture", "5h"]);
    world.until_more_samples(40, &daemon);
    let samples = world.get("/v1/status")["capture"]["samples"].as_u64().unwrap();
    // The shell passes the first on, the kernel sends the second when the shell ends: two signals are one request.
    daemon.signal(Signal::HUP);
    daemon.signal(Signal::HUP);
    assert_eq!(daemon.wait(Duration::from_secs(15)), Some(0), "{}", daemon.log());
    let rows = integer(&world.query("SELECT count(*) FROM sample")[0][0]) as u64;
    assert!(rows >= samples, "{rows} of {samples}");
    assert_restored(&world);

    let mut daemon = world.daemon_of(outside_of_systemd(), &port, "", &["--keep-on-hangup"]);
    world.until_more_samples(40, &daemon);
    daemon.signal(Signal::HUP);
    world.until_more_samples(40, &daemon);
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());

    // As `nohup` starts it.
    let mut nohup = Command::new("nohup");
    nohup.arg(env!("CARGO_BIN_EXE_vn100d")).env_remove("INVOCATION_ID").env_remove("NOTIFY_SOCKET");
    let mut daemon = world.daemon_of(nohup, &port, "", &[]);
    world.until_more_samples(40, &daemon);
    daemon.signal(Signal::HUP);
    world.until_more_samples(40, &daemon);
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
}

/// The daemon's own terminal is closed: the signal comes from the kernel, and nothing can be written any more.
#[test]
fn a_terminal_that_is_closed_ends_the_capture_cleanly_or_is_not_missed() {
    if !tools::have("script", "it gives the daemon a terminal") {
        return;
    }
    for keep_on in [false, true] {
        let world = World::new();
        let _sensor = world.emulate(&[]);
        std::fs::write(world.path("vn100d.toml"), "[log]\nlevel = \"debug\"\n").unwrap();
        let path = |name: &str| world.path(name).display().to_string();
        let line = format!(
            "exec {} --data-dir {} --config {} run --listen {} --device {} --capture 5h{}",
            env!("CARGO_BIN_EXE_vn100d"),
            path("data"),
            path("vn100d.toml"),
            world.url.trim_start_matches("http://"),
            path("sensor"),
            if keep_on { " --keep-on-hangup" } else { "" }
        );
        let mut script = Command::new("script");
        script.args(["-qec", &line, "/dev/null"]).env_remove("INVOCATION_ID").env_remove("NOTIFY_SOCKET");
        let mut terminal = Process::start(&mut script, false);
        world.until("the daemon answers", START, || world.try_get("/healthz"), &terminal);
        world.until_more_samples(40, &terminal);
        terminal.kill();
        if keep_on {
            world.until_more_samples(100, &terminal);
            let holder = std::fs::read_to_string(world.path("data/vn100d.db.lock")).unwrap();
            let pid = holder.split_whitespace().find_map(|word| word.parse().ok()).unwrap();
            rustix::process::kill_process(rustix::process::Pid::from_raw(pid).unwrap(), Signal::TERM).unwrap();
        }
        let gone = || world.try_get("/healthz").is_none().then_some(());
        world.until("the daemon ends", Duration::from_secs(15), gone, &terminal);
        assert_restored(&world);
    }
}

#[test]
fn under_a_manager_a_hangup_reads_the_configuration_again_and_a_wrong_one_changes_nothing() {
    let world = World::new();
    let _sensor = world.emulate(&[]);
    let manager = Manager::new(&world);
    let messages = manager.listens();
    let mut daemon = manager.daemon(&world, "", &["--capture", "5h"]);
    world.until_more_samples(40, &daemon);
    let reload = |text: &str, expected: &str| {
        std::fs::write(world.path("vn100d.toml"), text).unwrap();
        daemon.signal(Signal::HUP);
        world.until(expected, START, || daemon.log().contains(expected).then_some(()), &daemon);
    };
    let night = "[schedule]\nat = \"03:33\"\nname = \"reloaded\"\n";
    reload(&format!("{night}[sensor]\nrate-hz = 20.0\n[log]\nlevel = \"debug\"\n"), "sensor.rate-hz");
    let planned = || Some(world.get("/v1/status")).filter(|status| status["schedule"]["at"] == "03:33");
    world.until("the night is planned", START, planned, &daemon);
    assert!(daemon.log().contains("log.level, schedule.at, schedule.name"), "{}", daemon.log());
    world.until("the level counts", START, || daemon.log().contains("DEBUG").then_some(()), &daemon);
    // A key that does not exist, and a rate that the line cannot carry.
    reload("[schedule]\nwhen = \"03:34\"\n", "there is no key `schedule.when`");
    reload("[sensor]\nbaud = 9600\nrate-hz = 800.0\n", "560000 bit/s");
    assert_eq!(world.get("/v1/status")["schedule"]["at"], "03:33");
    reload("", "take effect now: log.level");
    let none = || Some(world.get("/v1/status")).filter(|status| status["schedule"].is_null());
    world.until("no night is planned", START, none, &daemon);
    world.until_more_samples(40, &daemon);
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    assert_eq!(world.query("SELECT missing FROM capture")[0][0], Value::Integer(0));
    assert_eq!(messages.lock().unwrap().matches("RELOADING=1").count(), 3, "{}", messages.lock().unwrap());
}

/// A manager's socket holds ten messages. Further ones wait or are dropped; nothing else waits with them.
#[test]
fn a_manager_that_does_not_read_its_socket_delays_no_request() {
    let world = World::new();
    let _sensor = world.emulate(&[]);
    let manager = Manager::new(&world);
    let mut daemon = manager.daemon(&world, "", &["--capture", "5h"]);
    world.until_more_samples(40, &daemon);
    for _ in 0..30 {
        daemon.signal(Signal::HUP);
        std::thread::sleep(Duration::from_millis(100));
        let asked = Instant::now();
        world.get("/v1/status");
        assert!(asked.elapsed() < Duration::from_secs(2), "{:?}", asked.elapsed());
    }
    world.until_more_samples(40, &daemon);
    assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
    assert_eq!(world.query("SELECT missing FROM capture")[0][0], Value::Integer(0));
}
