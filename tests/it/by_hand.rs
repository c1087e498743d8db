//! The daemon by hand: captures are started, stopped, renamed, noted, pinned and deleted from the command line, with
//! the token, and the reading commands find the daemon's database.

use crate::world::{Process, World, program};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Output;
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(20);
const TOKEN: &str = "a-token-of-24-characters";

/// Returns the configuration of a daemon at the world's address, with a token.
fn configuration(world: &World) -> String {
    let listen = world.url.strip_prefix("http://").unwrap();
    format!("[http]\nlisten = \"{listen}\"\ntoken = \"{TOKEN}\"\n")
}

/// Runs the program as a user whose only setting is the configuration in the user's own folder.
fn user(world: &World, arguments: &[&str]) -> Output {
    let home = world.path("home");
    let folder = home.join(".config/vn100d");
    if !folder.exists() {
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::copy(world.path("vn100d.toml"), folder.join("vn100d.toml")).unwrap();
    }
    let mut command = program();
    command.env_remove("XDG_CONFIG_HOME").env_remove("XDG_STATE_HOME").env("HOME", home);
    command.args(arguments).output().unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn done(world: &World, arguments: &[&str]) -> String {
    let output = user(world, arguments);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr(&output));
    stdout(&output)
}

fn answer(world: &World, arguments: &[&str]) -> Value {
    serde_json::from_str(&done(world, arguments)).unwrap()
}

#[track_caller]
fn refused(world: &World, code: i32, arguments: &[&str], why: &str) {
    let output = user(world, arguments);
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
    assert!(text.contains(why), "{arguments:?}: {text}");
    // Beside the error there may be a note on which database is read.
    assert_eq!(text.lines().filter(|line| !line.starts_with("note: this reads ")).count(), 1, "{text}");
    assert!(text.len() < 600 && output.stdout.is_empty(), "{text}");
}

fn running(world: &World, daemon: &Process) -> Value {
    let some = || Some(world.get("/v1/status")["capture"].clone()).filter(|of| of["samples"].as_u64() > Some(20));
    world.until("samples", PATIENCE, some, daemon)
}

#[test]
fn a_capture_goes_through_its_life_by_hand() {
    let world = World::new();
    let _sensor = world.emulate(&[]);
    let mut daemon = world.daemon(&configuration(&world), &[]);
    let started = done(&world, &["start", "--duration", "1h", "--name", "desk", "--note", "on foam, 23 °C"]);
    assert_eq!(started, "capture 1 `desk` begins, 1h of samples\n");
    running(&world, &daemon);
    refused(&world, 1, &["start"], "capture 1 is running until it is complete or stopped: stop it first");
    refused(&world, 1, &["delete", "--yes", "desk"], "capture 1 is running: it is not deleted");
    // While it runs, its name, its note and its protection change; the status knows the name.
    let named = done(&world, &["rename", "desk", "a b?#%é😀"]);
    assert_eq!(named, "capture 1 is named `a b?#%é😀`\n");
    let renamed = || (world.get("/v1/status")["capture"]["name"] == "a b?#%é😀").then_some(());
    world.until("the new name", PATIENCE, renamed, &daemon);
    assert_eq!(answer(&world, &["--json", "note", "a b?#%é😀", "on concrete"])["note"], "on concrete");
    assert_eq!(answer(&world, &["--json", "pin", "1"])[0]["pinned"], true);
    let stopped = answer(&world, &["--json", "stop"]);
    assert_eq!((&stopped["state"], &stopped["note"]), (&json!("stopped"), &json!("on concrete")));
    assert!(stopped["samples"].as_u64() > Some(20), "{stopped}");
    refused(&world, 1, &["stop"], "no capture runs or waits");
    refused(&world, 1, &["stop", "1"], "capture 1 is not running");
    refused(&world, 1, &["delete", "1", "--yes"], "capture 1 is pinned");
    assert_eq!(done(&world, &["unpin", "latest"]), "capture 1 `a b?#%é😀` may be deleted\n");
    // The reading commands find the daemon's database, and show the note.
    let shown = done(&world, &["show", "latest"]);
    assert!(shown.contains("note: on concrete"), "{shown}");
    let listed = done(&world, &["captures"]);
    assert!(listed.contains("on concrete") && listed.contains("a b?#%é😀"), "{listed}");
    let report = world.path("report.html");
    done(&world, &["report", "latest", "--out", report.to_str().unwrap()]);
    assert!(std::fs::read_to_string(report).unwrap().contains("<p class=\"note\">on concrete</p>"));
    let page = world.get("/captures/1");
    assert!(page.as_str().unwrap().contains("<p class=\"note\">on concrete</p>"), "{page}");
    assert_eq!(done(&world, &["note", "1", ""]), "capture 1 `a b?#%é😀` has no note\n");
    assert_eq!(answer(&world, &["--json", "show", "1"])["note"], Value::Null);
    // Nobody is there who could be asked.
    refused(&world, 2, &["delete", "latest"], "--yes deletes without a question");
    assert_eq!(world.get("/v1/captures/1")["id"], 1);
    let gone = answer(&world, &["--json", "delete", "--yes", "latest"]);
    assert_eq!(gone, json!([{"id": 1, "name": "a b?#%é😀", "deleted": true}]));
    refused(&world, 1, &["show", "1"], "there is no capture `1`");
    refused(&world, 1, &["delete", "1", "--yes"], "there is no capture `1`");
    assert_eq!(daemon.terminate(), Some(0));
    assert_eq!(format!("{:?}", world.query("PRAGMA integrity_check")), "[[Text(\"ok\")]]");
}

#[test]
fn a_taken_name_gets_a_number_at_a_start_and_refuses_a_renaming() {
    let world = World::new();
    let mut daemon = world.daemon(&configuration(&world), &[]);
    for (id, name) in ["desk", "desk-2", "desk-3"].into_iter().enumerate() {
        let row = answer(&world, &["--json", "start", "--name", "desk"]);
        assert_eq!((&row["id"], &row["name"]), (&json!(id + 1), &json!(name)));
        done(&world, &["stop"]);
    }
    let said = done(&world, &["start", "--name", "desk", "--at", "2099-01-15T09:00:00+01:00", "--duration", "90m"]);
    let expected =
        "capture 4 `desk-4` waits until 2099-01-15T08:00:00.000000000Z, 1h30m of samples (the name `desk` is taken)\n";
    assert_eq!(said, expected);
    refused(&world, 1, &["rename", "desk-2", "desk-3"], "a capture named `desk-3` exists already");
    // Of two starts at once one is taken, and no name is there twice.
    done(&world, &["stop", "desk-4"]);
    let both: Vec<Output> = std::thread::scope(|scope| {
        let start = || scope.spawn(|| user(&world, &["--json", "start", "--name", "desk"]));
        let both: Vec<_> = (0..2).map(|_| start()).collect();
        both.into_iter().map(|one| one.join().unwrap()).collect()
    });
    let codes: Vec<_> = both.iter().map(|one| one.status.code().unwrap()).collect();
    assert_eq!(codes.iter().sum::<i32>(), 1, "{codes:?}");
    let names = world.query("SELECT name FROM capture ORDER BY id");
    assert_eq!(format!("{names:?}").matches("desk-5").count(), 1, "{names:?}");
    assert_eq!(daemon.terminate(), Some(0));
}

#[test]
fn hostile_names_and_notes_are_refused_in_a_line_and_change_nothing() {
    let world = World::new();
    let mut daemon = world.daemon(&configuration(&world), &[]);
    done(&world, &["start", "--name", "desk"]);
    done(&world, &["stop"]);
    let long = "x".repeat(10_000);
    for (name, why) in [
        ("", "it is empty"),
        (" desk", "begins or ends with a space"),
        ("latest", "the capture made last"),
        ("42", "a number means"),
        ("../etc", "it holds a `/`"),
        ("a\nb", "a control character"),
        ("\u{1b}[31m", "a control character"),
        (&long, "longer than 100 characters"),
    ] {
        refused(&world, 2, &["rename", "desk", name], why);
        refused(&world, 2, &["start", "--name", name], why);
    }
    for (note, why) in [("a\nb", "a note is one line"), (&long, "longer than 1000 characters")] {
        refused(&world, 2, &["note", "desk", note], why);
        refused(&world, 2, &["start", "--note", note], why);
    }
    for capture in ["../../status", "..", "desk?x", "%00", "a\nb", &long] {
        refused(&world, 1, &["note", capture, "x"], "there is no capture");
    }
    refused(&world, 2, &["note", "", "x"], "is not empty");
    let rows = world.get("/v1/captures");
    assert_eq!((rows["captures"].as_array().unwrap().len(), &rows["captures"][0]["note"]), (1, &Value::Null));
    assert_eq!(daemon.terminate(), Some(0));
}

#[test]
fn without_the_token_or_the_daemon_an_error_names_what_to_do() {
    let world = World::new();
    let mut daemon = world.daemon(&configuration(&world), &[]);
    let without = world.path("without.toml");
    std::fs::write(&without, configuration(&world).lines().take(2).collect::<Vec<_>>().join("\n")).unwrap();
    let without = without.to_str().unwrap();
    for command in [&["start"][..], &["pin", "1"], &["note", "1", "x"]] {
        let arguments = [&["--config", without][..], command].concat();
        refused(
            &world,
            1,
            &arguments,
            "answered 401: requests that change something need `Authorization: Bearer TOKEN`",
        );
    }
    assert_eq!(daemon.terminate(), Some(0));
    for command in [
        &["start"][..],
        &["stop"],
        &["pin", "1"],
        &["delete", "1", "--yes"],
        &["rename", "1", "x"],
        &["note", "1", "x"],
    ] {
        refused(&world, 69, command, "start it with `vn100d run`, or name its address with --listen");
    }
}

#[test]
fn a_reading_command_finds_a_database_or_tells_where_it_looked() {
    let world = World::new();
    let mut daemon = world.daemon(&configuration(&world), &[]);
    done(&world, &["start", "--name", "of the daemon"]);
    done(&world, &["stop"]);
    // Whose database it is, is printed once, also by commands that read it several times.
    let note = |data: &Path| {
        format!("note: this reads {}/vn100d.db, the database of the daemon at {}\n", data.display(), world.url)
    };
    let data = world.path("data").canonicalize().unwrap();
    for command in [&["captures"][..], &["check"], &["export", "--all", "--partitioned", "set"]] {
        assert_eq!(stderr(&user(&world, command)).trim_end(), note(&data).trim_end(), "{command:?}");
    }
    let mut homeless = program();
    homeless.env_remove("HOME").env_remove("XDG_STATE_HOME").env("XDG_CONFIG_HOME", world.path("home/.config"));
    assert!(stdout(&homeless.arg("captures").output().unwrap()).contains("of the daemon"));
    assert!(done(&world, &["captures"]).contains("of the daemon"));
    let (copy, home) = (world.path("copy.db"), world.path("home"));
    done(&world, &["backup", "--out", copy.to_str().unwrap()]);
    done(&world, &["check"]);
    // A user's own database comes first, and the other one is not passed over in silence; a configuration that was
    // named names its daemon.
    let state = home.join(".local/state/vn100d");
    std::fs::create_dir_all(&state).unwrap();
    done(&world, &["simulate", "--duration", "1s", "--into-db", "own"]);
    let own = user(&world, &["captures"]);
    assert!(stdout(&own).contains("own") && !stdout(&own).contains("of the daemon"), "{}", stdout(&own));
    let data = world.path("data").canonicalize().unwrap();
    let note = format!("has another database (--data-dir {})", data.display());
    assert!(stderr(&own).contains(&note), "{}", stderr(&own));
    let config = world.path("vn100d.toml");
    let named = user(&world, &["--config", config.to_str().unwrap(), "captures"]);
    assert!(stdout(&named).contains("of the daemon") && stderr(&named).is_empty(), "{}", stderr(&named));
    assert!(done(&world, &["--data-dir", data.to_str().unwrap(), "captures"]).contains("of the daemon"));
    assert_eq!(daemon.terminate(), Some(0));
    let own = user(&world, &["captures"]);
    assert!(stdout(&own).contains("own") && stderr(&own).is_empty(), "{}", stderr(&own));
    // The daemon of a named configuration is asked for, and no other database is read in its place.
    for command in [&["captures"][..], &["show", "1"], &["check"], &["export", "latest", "--out", "x.csv"]] {
        let why = format!("no daemon answers at {}", world.url);
        refused(&world, 69, &[&["--config", config.to_str().unwrap()], command].concat(), &why);
    }
    std::fs::remove_dir_all(&state).unwrap();
    if !std::path::Path::new("/var/lib/vn100d/vn100d.db").exists() {
        let url = &world.url;
        refused(
            &world,
            1,
            &["captures"],
            &format!("{}/vn100d.db; no daemon answers at {url}; /var/lib", state.display()),
        );
    }
}

#[test]
fn a_change_goes_to_no_other_database_than_the_named_one() {
    let world = World::new();
    let mut daemon = world.daemon(&configuration(&world), &[]);
    done(&world, &["start", "--name", "desk"]);
    done(&world, &["stop"]);
    let (data, other) = (world.path("data").canonicalize().unwrap(), world.path("other"));
    let (data, other) = (data.to_str().unwrap(), other.to_str().unwrap());
    done(&world, &["--data-dir", other, "simulate", "--duration", "1s", "--into-db", "desk"]);
    let changes = [
        &["delete", "--yes", "1"][..],
        &["stop"],
        &["start"],
        &["rename", "1", "x"],
        &["note", "1", "x"],
        &["pin", "1"],
        &["unpin", "1"],
    ];
    for change in changes {
        let why = format!("has {data}/vn100d.db, not {other}/vn100d.db");
        refused(&world, 1, &[&["--data-dir", other], change].concat(), &why);
    }
    let mut named = program();
    named.arg("--config").arg(world.path("vn100d.toml")).args(["delete", "--yes", "1"]).env("VN100D_DATA_DIR", other);
    assert_eq!(named.output().unwrap().status.code(), Some(1));
    let row = world.get("/v1/captures/1");
    assert_eq!((&row["name"], &row["note"], &row["pinned"]), (&json!("desk"), &Value::Null, &json!(false)));
    done(&world, &["--data-dir", data, "pin", "1"]);
    assert_eq!(world.get("/v1/captures/1")["pinned"], true);
    assert_eq!(daemon.terminate(), Some(0));
}

#[test]
fn of_several_captures_each_is_deleted_once_and_a_failure_hides_no_deletion() {
    let world = World::new();
    let mut daemon = world.daemon(&configuration(&world), &[]);
    for name in ["one", "two", "three"] {
        done(&world, &["start", "--name", name]);
        done(&world, &["stop"]);
    }
    assert_eq!(done(&world, &["delete", "--yes", "latest", "three", "3"]), "capture 3 `three` is deleted\n");
    done(&world, &["pin", "one"]);
    let failed = user(&world, &["--json", "delete", "--yes", "two", "one"]);
    assert_eq!(failed.status.code(), Some(1));
    let told: Value = serde_json::from_str(&stdout(&failed)).unwrap();
    assert_eq!(told, json!([{"id": 2, "name": "two", "deleted": true}]));
    assert!(stderr(&failed).contains("1 before it is done"), "{}", stderr(&failed));
    assert_eq!(daemon.terminate(), Some(0));
}

#[test]
fn a_data_set_follows_a_renaming_and_no_other_file_is_taken_away() {
    let world = World::new();
    let _sensor = world.emulate(&[]);
    let mut daemon = world.daemon(&configuration(&world), &[]);
    for name in ["other", "desk"] {
        done(&world, &["start", "--name", name]);
        running(&world, &daemon);
        let some = || (world.get(&format!("/v1/captures/{name}"))["samples"].as_u64() > Some(0)).then_some(());
        world.until("stored samples", PATIENCE, some, &daemon);
        done(&world, &["stop"]);
    }
    let set = world.path("set");
    let export = |capture: &str| {
        let arguments = ["--json", "export", capture, "--partitioned", set.to_str().unwrap()];
        let output = user(&world, &arguments);
        assert!(output.status.success(), "{}", stderr(&output));
        let report: Value = serde_json::from_str(&stdout(&output)).unwrap();
        let file = report[0]["file"].as_str().unwrap_or_else(|| panic!("{report}"));
        let file = std::path::PathBuf::from(file);
        let lines = |part: &str| stderr(&output).lines().filter(|line| line.contains(part)).count();
        assert_eq!(lines("note: this reads"), 1, "{}", stderr(&output));
        let left = lines("stays beside");
        (file, left)
    };
    let (other, _) = export("other");
    let (desk, _) = export("desk");
    assert!(desk.exists() && desk != other);
    done(&world, &["rename", "desk", "shelf"]);
    let (shelf, left) = export("latest");
    assert!(shelf.exists() && shelf != desk && !desk.exists() && left == 0);
    // Another capture's data under the earlier name, a file that is no Parquet, and a pipe.
    std::fs::copy(&other, &desk).unwrap();
    assert_eq!((export("latest"), desk.exists()), ((shelf.clone(), 1), true));
    std::fs::write(&desk, "mine").unwrap();
    assert_eq!((export("latest"), desk.exists()), ((shelf.clone(), 1), true));
    std::fs::remove_file(&desk).unwrap();
    rustix::fs::mkfifoat(rustix::fs::CWD, &desk, rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR).unwrap();
    assert_eq!((export("latest"), desk.exists()), ((shelf.clone(), 1), true));
    std::fs::remove_file(&desk).unwrap();
    std::fs::copy(&shelf, &desk).unwrap();
    assert_eq!((export("latest"), desk.exists()), ((shelf.clone(), 0), false));
    assert!(other.exists());
    assert_eq!(daemon.terminate(), Some(0));
}

#[test]
fn texts_of_a_database_do_not_command_the_terminal() {
    let world = World::new();
    let data = world.path("data");
    let data = data.to_str().unwrap();
    done_at(data, &["simulate", "--duration", "1s", "--into-db", "x"]);
    let evil = "\u{1b}[2Ja\u{9b}1m\nb\u{7}";
    let connection = rusqlite::Connection::open(world.database()).unwrap();
    connection.execute("UPDATE capture SET name = ?1, note = ?1, source = ?1", [evil]).unwrap();
    connection.close().map_err(|(_, error)| error).unwrap();
    let out = world.path("out.db");
    for command in [&["captures"][..], &["show", "1"], &["check"], &["recover", "--out", out.to_str().unwrap()]] {
        let text = done_at(data, command);
        assert!(!text.contains(|one: char| one.is_control() && one != '\n'), "{command:?}: {text:?}");
        assert!(text.contains("a 1m b") || command[0] == "recover" || command[0] == "check", "{command:?}: {text:?}");
    }
}

fn done_at(data: &str, arguments: &[&str]) -> String {
    let output = program().args(["--data-dir", data]).args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    stdout(&output)
}

/// A database that belongs to somebody else.
#[test]
fn a_database_that_may_not_be_read_is_reported_as_such() {
    use std::os::unix::fs::PermissionsExt as _;
    use std::os::unix::process::CommandExt as _;
    let world = World::new();
    let data = world.path("data");
    let run = |program: &mut std::process::Command, arguments: &[&str]| {
        program.arg("--data-dir").arg(&data).args(arguments).output().unwrap()
    };
    assert!(run(&mut program(), &["simulate", "--duration", "1s", "--into-db", "x"]).status.success());
    std::fs::set_permissions(world.database(), std::fs::Permissions::from_mode(0o000)).unwrap();
    let mut command = program();
    if rustix::process::geteuid().is_root() {
        // Root may read everything.
        command.uid(65_534).gid(65_534);
    }
    let output = run(&mut command, &["captures"]);
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(74), "{text}");
    assert!(text.contains("this user may not read") && text.contains("sudo"), "{text}");
}
