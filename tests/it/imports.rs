//! Imports through the daemon: authorisation, outcomes, and the messages for the user.

use crate::world::{Process, World, program};
use rusqlite::types::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};
use vn100_testkit::ros2;

const TOKEN: &str = "0123456789abcdef0123456789abcdef";

/// Returns a recording with this number of samples of one channel at 40 Hz.
fn recording(world: &World, name: &str, samples: usize) -> PathBuf {
    let file = world.path(name);
    let mut text = String::from("time_s,gyro_x_rad_s\n");
    for row in 0..samples {
        text.push_str(&format!("{:.3},{}\n", row as f64 * 0.025, row % 7));
    }
    std::fs::write(&file, text).unwrap();
    file
}

/// Returns the configuration of the address on which this world's daemon listens.
fn listening(world: &World) -> String {
    format!("[http]\nlisten = \"{}\"\n", world.url.trim_start_matches("http://"))
}

/// Returns `vn100d import` with this configuration, beside the world's daemon.
fn importing(world: &World, configuration: &Path, arguments: &[&str]) -> Command {
    let mut command = program();
    command.args(["--data-dir", world.path("data").to_str().unwrap()]);
    command.args(["--config", configuration.to_str().unwrap(), "--json", "import"]).args(arguments);
    command
}

fn import(world: &World, configuration: &Path, arguments: &[&str]) -> Output {
    importing(world, configuration, arguments).output().unwrap()
}

fn count(world: &World, sql: &str) -> i64 {
    match world.query(sql)[0][0] {
        Value::Integer(count) => count,
        ref other => panic!("{other:?}"),
    }
}

/// Returns the priority of the daemon's first thread whose name begins with this, while there is one.
fn priority(daemon: &Process, name: &str) -> Option<i64> {
    let threads = std::fs::read_dir(format!("/proc/{}/task", daemon.id())).ok()?;
    threads.flatten().find_map(|thread| {
        let stat = std::fs::read_to_string(thread.path().join("stat")).ok()?;
        let (head, rest) = stat.rsplit_once(") ")?;
        // The 19th field is the nice value; the third follows the name.
        head.split_once(" (")?.1.starts_with(name).then(|| rest.split(' ').nth(16)?.parse().ok())?
    })
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Checks that no file of a recording remains beside the database.
fn nothing_aside(world: &World) -> Option<()> {
    let left = std::fs::read_dir(world.path("data")).unwrap().flatten();
    (left.filter(|entry| entry.file_name().to_string_lossy().starts_with(".import-")).count() == 0).then_some(())
}

/// A configured token is required wherever the daemon listens; `vn100d import` reads it from the configuration.
#[test]
fn a_configured_token_is_needed_on_loopback_too_and_import_brings_it() {
    let world = World::new();
    let configuration = format!("{}token = \"{TOKEN}\"\n", listening(&world));
    let mut daemon = world.daemon(&configuration, &[]);
    for (method, route) in [("POST", "/v1/captures"), ("POST", "/v1/captures/1/pin"), ("DELETE", "/v1/captures/1")] {
        let (status, text) = world.request(method, route, "{}").unwrap();
        assert_eq!(status, 401, "{method} {route}: {text}");
    }
    assert_eq!(world.get("/v1/status")["capture"], serde_json::Value::Null);
    let file = recording(&world, "desk.csv", 400);
    let without = world.path("without.toml");
    std::fs::write(&without, listening(&world)).unwrap();
    let refused = import(&world, &without, &[file.to_str().unwrap()]);
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    assert!(stderr(&refused).contains("token"), "{}", stderr(&refused));
    let taken = import(&world, &world.path("vn100d.toml"), &[file.to_str().unwrap()]);
    assert_eq!(taken.status.code(), Some(0), "{}", stderr(&taken));
    assert_eq!(world.get("/v1/captures/desk")["samples"], 400);
    assert_eq!(daemon.terminate(), Some(0));
}

/// The progress of an import when an event interrupts it.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    Read,
    Written,
}

/// Returns the daemon and an import through it that has reached this stage.
fn halfway(world: &World, stage: Stage) -> (Process, Process) {
    let daemon = world.daemon(&listening(world), &[]);
    let file = recording(world, "long.csv", 3_000_000);
    let client = Process::start(&mut importing(world, &world.path("vn100d.toml"), &[file.to_str().unwrap()]), false);
    let patience = Duration::from_secs(300);
    // No capture's job competes with the import, nor the import with a capture: it has the priority of background jobs,
    // which stays the suite's own if that is lower.
    let background = || {
        let (import, jobs) = (priority(&daemon, "import")?, priority(&daemon, "jobs-")?);
        (import == jobs && import >= 10).then_some(())
    };
    world.until("it is read as a background job", patience, background, &daemon);
    if stage == Stage::Written {
        let rows = || (count(world, "SELECT count(*) FROM sample") > 0).then_some(());
        world.until("it is written", patience, rows, &daemon);
    }
    assert_eq!(count(world, "SELECT count(*) FROM capture WHERE lifecycle = 'live'"), 0);
    (daemon, client)
}

/// Checks that the import is not visible, and that its data is removed.
fn nothing_of_it(world: &World, daemon: &Process) {
    assert_eq!(world.get("/v1/captures")["captures"], serde_json::json!([]));
    let gone =
        || (count(world, "SELECT (SELECT count(*) FROM sample) + (SELECT count(*) FROM capture)") == 0).then_some(());
    world.until("its rows are cleared away", Duration::from_secs(300), gone, daemon);
    world.until("its file is removed", Duration::from_secs(20), || nothing_aside(world), daemon);
}

/// Row A3 for imports: the daemon ends in time, whatever the import does, and a partial import is never visible.
#[test]
fn a_termination_ends_an_import_in_time_and_leaves_nothing_of_it() {
    for stage in [Stage::Read, Stage::Written] {
        let world = World::new();
        let (mut daemon, mut client) = halfway(&world, stage);
        let begun = Instant::now();
        assert_eq!(daemon.terminate(), Some(0), "{}", daemon.log());
        assert!(begun.elapsed() < Duration::from_secs(10), "{stage:?}: {:?}", begun.elapsed());
        assert_eq!(client.wait(Duration::from_secs(10)), Some(1), "{}", client.log());
        assert!(client.log().contains("the daemon is stopping"), "{}", client.log());
        let mut daemon = world.daemon(&listening(&world), &[]);
        nothing_of_it(&world, &daemon);
        assert_eq!(daemon.terminate(), Some(0));
        assert_eq!(format!("{:?}", world.query("PRAGMA integrity_check")), "[[Text(\"ok\")]]");
    }
}

/// Returns the process that reads a recording for this daemon.
fn reader(daemon: &Process) -> Option<rustix::process::Pid> {
    let is_reader = |pid: &i32| {
        let text = |name: &str| std::fs::read_to_string(format!("/proc/{pid}/{name}")).unwrap_or_default();
        text("cmdline").split('\0').any(|word| word == "import")
            && text("status").contains(&format!("PPid:\t{}\n", daemon.id()))
    };
    let processes = std::fs::read_dir("/proc").ok()?.flatten();
    let pid = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).find(is_reader)?;
    rustix::process::Pid::from_raw(pid)
}

/// The process that reads a recording may be killed at any time: the import fails, and the daemon goes on.
#[test]
fn a_reader_that_is_killed_costs_its_import_alone() {
    for stage in [Stage::Read, Stage::Written] {
        let world = World::new();
        let (mut daemon, mut client) = halfway(&world, stage);
        let reader = reader(&daemon).unwrap();
        rustix::process::kill_process(reader, rustix::process::Signal::KILL).unwrap();
        assert_eq!(client.wait(Duration::from_secs(20)), Some(74), "{}", client.log());
        let log = client.log();
        assert!(log.contains("signal 9") && log.contains("import it again"), "{log}");
        nothing_of_it(&world, &daemon);
        let file = recording(&world, "desk.csv", 400);
        let taken = import(&world, &world.path("vn100d.toml"), &[file.to_str().unwrap()]);
        assert_eq!(taken.status.code(), Some(0), "{}", stderr(&taken));
        assert_eq!(world.get("/v1/captures/desk")["samples"], 400);
        assert_eq!(daemon.terminate(), Some(0));
    }
}

/// A few compressed bytes that become hundreds of megabytes are read in another process, which may have less memory.
#[test]
fn a_bag_of_one_long_name_takes_no_memory_of_the_recorder() {
    let world = World::new();
    let mut daemon = world.daemon(&listening(&world), &[]);
    let file = world.path("long.mcap");
    let options = mcap::WriteOptions::new().chunk_size(None);
    let mut writer = options.create(std::io::BufWriter::new(std::fs::File::create(&file).unwrap())).unwrap();
    writer.add_schema(&"n".repeat(220 << 20), "ros2msg", b"float64 x").unwrap();
    writer.finish().unwrap();
    drop(writer);
    let refused = import(&world, &world.path("vn100d.toml"), &[file.to_str().unwrap()]);
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    let status = std::fs::read_to_string(format!("/proc/{}/status", daemon.id())).unwrap();
    let most: u64 =
        status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")?.parse().ok()).unwrap();
    assert!(most < 128 << 10, "{most} kB; {}", stderr(&refused));
    world.until("its file is removed", Duration::from_secs(20), || nothing_aside(&world), &daemon);
    assert_eq!(daemon.terminate(), Some(0));
}

/// Ctrl-C at `vn100d import` cancels the import. Meanwhile a second import must wait, and its message does not blame a
/// missing daemon or a full disk.
#[test]
fn a_client_that_goes_away_cancels_its_import_and_a_second_one_has_to_wait() {
    let world = World::new();
    let (mut daemon, mut client) = halfway(&world, Stage::Written);
    let configuration = world.path("vn100d.toml");
    let small = recording(&world, "small.csv", 400);
    let busy = import(&world, &configuration, &[small.to_str().unwrap()]);
    assert_eq!(busy.status.code(), Some(1), "{}", stderr(&busy));
    assert!(stderr(&busy).contains("another recording is being imported"), "{}", stderr(&busy));
    client.kill();
    nothing_of_it(&world, &daemon);
    let taken = import(&world, &configuration, &[small.to_str().unwrap()]);
    assert_eq!(taken.status.code(), Some(0), "{}", stderr(&taken));
    assert_eq!(world.get("/v1/captures/small")["samples"], 400);
    assert_eq!(daemon.terminate(), Some(0));
}

/// Files and names that are invalid for a capture are refused with the same exit code and message, with and without a
/// daemon, and before any wait.
#[test]
fn names_and_files_that_cannot_be_are_refused_alike_with_and_without_a_daemon() {
    let world = World::new();
    let configuration = world.path("vn100d.toml");
    std::fs::write(&configuration, listening(&world)).unwrap();
    let pipe = world.path("pipe.csv");
    rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR).unwrap();
    let long = recording(&world, &format!("{}.csv", "n".repeat(140)), 400);
    let number = recording(&world, "2024.csv", 401);
    let bomb = world.path("bomb.csv.gz");
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    std::io::Write::write_all(&mut encoder, b"time_s,gyro_x_rad_s\n").unwrap();
    let blank = vec![b'\n'; 1 << 20];
    for _ in 0..400 {
        std::io::Write::write_all(&mut encoder, &blank).unwrap();
    }
    std::fs::write(&bomb, encoder.finish().unwrap()).unwrap();
    let check = |with_daemon: bool| {
        let run = |arguments: &[&str]| {
            let begun = Instant::now();
            let output = import(&world, &configuration, arguments);
            assert!(begun.elapsed() < Duration::from_secs(240), "{arguments:?}: {:?}", begun.elapsed());
            (output.status.code(), stderr(&output), String::from_utf8_lossy(&output.stdout).into_owned())
        };
        let refused = |arguments: &[&str], code: i32, sentence: &str| {
            let (found, message, _) = run(arguments);
            assert_eq!(found, Some(code), "{with_daemon} {arguments:?}: {message}");
            assert!(message.contains(sentence), "{with_daemon} {arguments:?}: {message}");
        };
        refused(&[pipe.to_str().unwrap()], 74, "is a pipe, but a recording is read several times");
        refused(&["/dev/zero"], 74, "is a device");
        refused(&[bomb.to_str().unwrap()], 1, "which no sensor's recording does");
        refused(&[number.to_str().unwrap(), "--name", "2024"], 1, "a number means the capture with that id");
        for file in [&long, &number] {
            let (code, message, _) = run(&[file.to_str().unwrap()]);
            assert_eq!(code, Some(0), "{with_daemon}: {message}");
        }
    };
    check(false);
    let mut daemon = world.daemon(&listening(&world), &[]);
    check(true);
    assert_eq!(
        world.get(&format!("/v1/captures/{}", "n".repeat(100)))["samples"],
        400,
        "named as far as a name may go"
    );
    assert_eq!(world.get("/v1/captures/2")["samples"], 401);
    assert_eq!(daemon.terminate(), Some(0));
}

/// The user's statements about foreign columns and messages reach the daemon, and identify the recording together with
/// its content.
#[test]
fn statements_about_foreign_columns_and_messages_reach_the_daemon() {
    let world = World::new();
    let mut daemon = world.daemon(&listening(&world), &[]);
    let configuration = world.path("vn100d.toml");
    let table = world.path("table.csv");
    let rows: String = (0..400).map(|row| format!("{};{:.2}\n", row * 25, f64::from(row % 7) * 0.05)).collect();
    std::fs::write(&table, format!("Clock [ms];TurnX(dps)\n{rows}")).unwrap();
    let bag = world.path("own.db3");
    let stamp_ns = |index: u64| 1_729_716_663_000_000_000 + 25_000_000 * index;
    let message = |index: u64| {
        let data = ros2::Cdr::little_endian().header(stamp_ns(index)).wide(&[index as f64]).bytes();
        (0, stamp_ns(index) as i64, data)
    };
    let messages: Vec<_> = (0..40).map(message).collect();
    std::fs::write(&bag, ros2::db3(&[("/own", "own_msgs/msg/Reading", None)], &messages)).unwrap();
    let definition = world.path("Reading.msg");
    std::fs::write(&definition, "# what it is\nstd_msgs/Header header\n\nfloat64 gyro_x_rad_s # rad/s\n").unwrap();
    let named = format!("own_msgs/msg/Reading={}", definition.display());
    let of = |arguments: &[&str]| -> (serde_json::Value, String) {
        let output = import(&world, &configuration, arguments);
        let report = serde_json::from_slice(&output.stdout).unwrap_or_default();
        (report, format!("{:?} {}", output.status.code(), stderr(&output)))
    };
    let (table, bag, definition) = (table.to_str().unwrap(), bag.to_str().unwrap(), definition.to_str().unwrap());
    for (refused, words) in [
        (&[table][..], ["Some(1)", "Clock [ms] | TurnX(dps)"]),
        (&[table, "--columns", "TurnX=gyro_x_dps"], ["Some(1)", "no column is \"TurnX\""]),
        (&[table, "--columns", "TurnX(dps)=gyro_x"], ["Some(2)", "is no column's name"]),
        (&[bag], ["Some(1)", "--message-definition"]),
        (&[bag, "--message-definition", table], ["Some(2)", "line 2 is no field"]),
    ] {
        let (_, outcome) = of(refused);
        assert!(words.iter().all(|word| outcome.contains(word)), "{refused:?}: {outcome}");
    }
    for (first, again, samples) in [
        (
            &[table, "--columns", "Clock [ms]=time_ms,TurnX(dps)=gyro_x_dps"][..],
            &[table, "--columns", "TurnX(dps)=gyro_x_dps", "--columns", "Clock [ms]=time_ms"][..],
            400,
        ),
        (&[bag, "--message-definition", &named], &[bag, "--message-definition", &named], 40),
    ] {
        let (report, outcome) = of(first);
        assert_eq!((&report[0]["samples"], &report[0]["new"]), (&samples.into(), &true.into()), "{outcome}");
        assert_eq!(report[0]["rate_hz"], 40.0);
        let (second, outcome) = of(again);
        assert_eq!((&second[0]["capture"], &second[0]["new"]), (&report[0]["capture"], &false.into()), "{outcome}");
    }
    // Without its package the type is another reading of the file.
    let (other, outcome) = of(&[bag, "--message-definition", definition]);
    assert_eq!(other[0]["new"], true, "{outcome}");
    assert_eq!(world.get("/v1/captures/table")["configuration"]["columns"][1], "TurnX(dps)=gyro_x_dps");
    assert_eq!(daemon.terminate(), Some(0));
}
