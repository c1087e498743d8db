//! The remains of a power loss (row A2), and programs of other versions (row A10).

use super::*;
use crate::tools;
use std::collections::BTreeMap;

/// One change of a file.
#[derive(Debug, Clone)]
enum Change {
    Write { file: String, at: usize, bytes: Vec<u8> },
    Cut { file: String, length: usize },
    Remove { file: String },
    Sync { file: String },
}

/// Reads `strace -y -xx`: writes, cuts, removals and syncs of files in `folder`, in order.
fn changes(trace: &str, folder: &Path) -> Vec<Change> {
    let folder = format!("{}/", folder.canonicalize().unwrap().display());
    let name = |text: &str| text.strip_prefix(&folder).map(str::to_owned);
    let bytes =
        |hex: &str| -> Vec<u8> { hex.split("\\x").skip(1).map(|two| u8::from_str_radix(two, 16).unwrap()).collect() };
    // strace -xx prints file names in hexadecimal too.
    let plain =
        |hex: &str| if hex.starts_with("\\x") { String::from_utf8(bytes(hex)).unwrap() } else { hex.to_owned() };
    let mut all = Vec::new();
    for line in trace.lines() {
        let Some((_, call)) = line.split_once(' ') else { continue };
        let call = call.trim_start();
        let Some((what, rest)) = call.split_once('(') else { continue };
        let of_descriptor = || {
            let (_, path) = rest.split_once('<')?;
            name(&plain(path.split_once('>')?.0))
        };
        match what {
            "pwrite64" => {
                let Some(file) = of_descriptor() else { continue };
                let mut quoted = rest.split('"');
                let data = bytes(quoted.nth(1).unwrap());
                let numbers = quoted.next().unwrap().trim_start_matches(", ");
                let numbers = numbers.split([',', ')', ' ']).filter(|part| !part.is_empty()).collect::<Vec<_>>();
                assert_eq!(numbers[0].parse::<usize>().unwrap(), data.len(), "{line}");
                all.push(Change::Write { file, at: numbers[1].parse().unwrap(), bytes: data });
            }
            "ftruncate" => {
                let Some(file) = of_descriptor() else { continue };
                let length = rest.split(", ").nth(1).unwrap().split([')', ' ']).next().unwrap();
                all.push(Change::Cut { file, length: length.parse().unwrap() });
            }
            "unlink" => {
                if let Some(file) = rest.split('"').nth(1).and_then(|path| name(&plain(path))) {
                    all.push(Change::Remove { file });
                }
            }
            "fsync" | "fdatasync" => {
                if let Some(file) = of_descriptor() {
                    all.push(Change::Sync { file });
                }
            }
            _ => {}
        }
    }
    all
}

type Files = BTreeMap<String, Vec<u8>>;

fn apply(files: &mut Files, change: &Change) {
    match change {
        Change::Write { file, at, bytes } => {
            let content = files.entry(file.clone()).or_default();
            content.resize(content.len().max(at + bytes.len()), 0);
            content[*at..at + bytes.len()].copy_from_slice(bytes);
        }
        Change::Cut { file, length } => files.entry(file.clone()).or_default().resize(*length, 0),
        Change::Remove { file } => drop(files.remove(file)),
        Change::Sync { .. } => {}
    }
}

/// Checks that the image opens, is intact, and has every batch that was acknowledged.
fn holds(files: &Files, acknowledged: i64, what: &str) {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files.iter().filter(|(name, _)| !name.ends_with("-shm")) {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    let database = folder.path().join("vn100d.db");
    if acknowledged == 0 && files.get("vn100d.db").is_none_or(Vec::is_empty) {
        return;
    }
    let connection = rusqlite::Connection::open(&database).unwrap();
    let whole: String = connection.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
    assert_eq!(whole, "ok", "{what}");
    let tables: i64 =
        connection.query_row("SELECT count(*) FROM sqlite_schema WHERE name = 'writer'", [], |row| row.get(0)).unwrap();
    if acknowledged == 0 && tables == 0 {
        return;
    }
    let (batch, counted, there): (i64, i64, i64) = connection
        .query_row(
            "SELECT batch, (SELECT coalesce(sum(samples), 0) FROM capture), (SELECT count(*) FROM sample) FROM writer",
            [],
            |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)),
        )
        .unwrap();
    assert!(batch >= acknowledged, "{what}: {batch} of {acknowledged} acknowledged batches");
    assert_eq!(counted, there, "{what}");
}

/// Row A2.
#[test]
fn after_a_power_loss_everything_acknowledged_is_there_wherever_it_strikes() {
    if !tools::have("strace", "every write and sync is recorded") {
        return;
    }
    let world = World::new();
    let _sensor = world.emulate(FAST);
    let trace = world.path("trace");
    let traced = [
        "strace",
        "-D",
        "-f",
        "-qq",
        "-y",
        "-xx",
        "-s",
        "100000",
        "-o",
        trace.to_str().unwrap(),
        "-e",
        "trace=pwrite64,ftruncate,unlink,fsync,fdatasync",
    ];
    let mut daemon = start(&world, &traced, "[sensor]\nrate-hz = 200\nbaud = 921600\n", &["--capture", "1h"]);
    until_committed(&world, tools::scaled(1000, 30_000), Duration::from_secs(200), &daemon);
    stop_and_settle(&world, &mut daemon);
    drop(daemon);
    // The tracer outlives the daemon by a moment.
    let ended = Instant::now();
    let mut text = std::fs::read_to_string(&trace).unwrap();
    while ended.elapsed() < Duration::from_secs(2) {
        std::thread::sleep(Duration::from_millis(200));
        text = std::fs::read_to_string(&trace).unwrap();
    }
    let changes = changes(&text, &world.path("data"));
    let syncs = changes.iter().filter(|change| matches!(change, Change::Sync { .. })).count();
    assert!(syncs > 10, "{syncs}");

    // `now`: all written data; `safe`: each file as of its last sync. Removals and new names count as done.
    let (mut now, mut safe) = (Files::new(), Files::new());
    let (mut acknowledged, mut images) = (0, 0);
    let mut unsynced: Vec<Change> = Vec::new();
    for (number, change) in changes.iter().enumerate() {
        if let Change::Write { file, bytes, .. } = change
            && file == "vn100d.db.lock"
        {
            // The mark: identity and number of a batch whose commit has returned.
            let text = String::from_utf8_lossy(bytes);
            if let Some((_, batch)) = text.trim().split_once(' ') {
                acknowledged = batch.parse().unwrap_or(acknowledged);
            }
            continue;
        }
        match change {
            Change::Sync { file } => {
                // Just before the sync returns: nothing since the last one, everything, or the last write torn.
                holds(&safe, acknowledged, &format!("change {number}: unsynced writes are gone"));
                holds(&now, acknowledged, &format!("change {number}: everything is there"));
                images += 2;
                if let Some(Change::Write { file: torn, at, bytes }) = unsynced.last() {
                    let mut image = safe.clone();
                    unsynced[..unsynced.len() - 1].iter().for_each(|change| apply(&mut image, change));
                    let half = Change::Write { file: torn.clone(), at: *at, bytes: bytes[..bytes.len() / 2].to_vec() };
                    apply(&mut image, &half);
                    holds(&image, acknowledged, &format!("change {number}: the last write is torn"));
                    images += 1;
                }
                if let Some(content) = now.get(file) {
                    safe.insert(file.clone(), content.clone());
                }
                unsynced.retain(|change| !matches!(change, Change::Write { file: of, .. } | Change::Cut { file: of, .. } if of == file));
                holds(&safe, acknowledged, &format!("change {number}: after the sync"));
                images += 1;
            }
            Change::Remove { file } => {
                now.remove(file);
                safe.remove(file);
                unsynced.retain(|change| !matches!(change, Change::Write { file: of, .. } | Change::Cut { file: of, .. } if of == file));
            }
            other => {
                apply(&mut now, other);
                unsynced.push(other.clone());
            }
        }
    }
    println!("{images} images at {syncs} syncs, {acknowledged} batches acknowledged");
    assert!(acknowledged >= 3, "{acknowledged}");
}

/// Makes the database of the first release: its schema alone, with one capture and some samples.
fn of_an_old_version(database: &Path, samples: u64) {
    std::fs::create_dir_all(database.parent().unwrap()).unwrap();
    let connection = rusqlite::Connection::open(database).unwrap();
    connection.pragma_update(None, "application_id", vn100d::store::APPLICATION_ID).unwrap();
    connection.pragma_update(None, "journal_mode", "WAL").unwrap();
    connection.execute_batch(include_str!("../../../migrations/0001_captures.sql")).unwrap();
    connection.execute_batch(include_str!("../../../migrations/0002_jobs.sql")).unwrap();
    connection.pragma_update(None, "user_version", 2).unwrap();
    connection
        .execute_batch(
            "INSERT INTO capture (name, source, state, created_utc_ns, rate_hz, software) VALUES ('old', 'pty', 'stopped', 1, 40, 'x');
             INSERT INTO segment VALUES (1, 1, 1, 0, 0, 40, 'device', '[\"gyro_x\"]', 0, 0, 1, 1);",
        )
        .unwrap();
    connection
        .execute(
            "INSERT INTO sample (capture_id, segment_id, seq, device_time_ns, host_mono_ns, host_utc_ns, gyro_x) \
             WITH RECURSIVE n(i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i + 1 < ?1) \
             SELECT 1, 1, i, i * 25000000, i * 25000000, 1800000000000000000 + i * 25000000, i * 1e-6 FROM n",
            [samples as i64],
        )
        .unwrap();
    connection
        .execute("UPDATE capture SET samples = ?1, segments = 1, sample_time_ns = ?1 * 25000000", [samples as i64])
        .unwrap();
    connection.execute("UPDATE segment SET samples = ?1", [samples as i64]).unwrap();
}

/// Row A10.
#[test]
fn an_older_program_refuses_a_newer_database_with_both_versions() {
    let world = World::new();
    build(&world.database(), 1, 10);
    let newer = vn100d::store::schema_version() + 7;
    rusqlite::Connection::open(world.database()).unwrap().pragma_update(None, "user_version", newer).unwrap();
    let before = std::fs::read(world.database()).unwrap();
    let mut daemon = begin(&world, &[], "", &[]);
    assert_eq!(daemon.wait(Duration::from_secs(10)), Some(78), "{}", daemon.log());
    let log = last_words(&daemon);
    assert!(log.contains(&format!("version {newer}")) && log.contains(&format!("up to {}", newer - 7)), "{log}");
    assert!(std::fs::read(world.database()).unwrap() == before);
    let shown = vn100d(&["--data-dir", world.path("data").to_str().unwrap(), "captures"]);
    assert_eq!(shown.status.code(), Some(78));
}

/// Row A10.
#[test]
fn an_upgrade_killed_anywhere_leaves_the_old_database_or_the_new_one() {
    if !tools::have("strace", "the program is killed at its n-th write") {
        return;
    }
    let world = World::new();
    let samples = tools::scaled(20_000, 2_000_000);
    let old = world.path("old/vn100d.db");
    of_an_old_version(&old, samples);
    let recording = world.path("r.csv");
    std::fs::write(&recording, "time_s,gyro_x_rad_s\n0,0.1\n0.025,0.2\n0.05,0.1\n").unwrap();
    let (mut kept, mut upgraded) = (0, 0);
    let step = tools::scaled(4, 1);
    for write in (1..400).step_by(step) {
        let _ = std::fs::remove_dir_all(world.path("data"));
        std::fs::create_dir_all(world.path("data")).unwrap();
        std::fs::copy(&old, world.database()).unwrap();
        let inject = format!("inject=pwrite64,fsync:signal=SIGKILL:when={write}");
        let ended = Command::new("strace")
            .args(["-f", "-qq", "-o", "/dev/null", "-e", "trace=pwrite64,fsync", "-e", &inject])
            .arg(program().get_program())
            .args(["--data-dir", world.path("data").to_str().unwrap(), "import", recording.to_str().unwrap()])
            .output()
            .unwrap();
        let rows = world.query("PRAGMA user_version");
        let rusqlite::types::Value::Integer(version) = rows[0][0] else { panic!() };
        assert!(version == 2 || version == vn100d::store::schema_version(), "write {write}: version {version}");
        if version == 2 {
            kept += 1
        } else {
            upgraded += 1
        }
        let begun = Instant::now();
        let again =
            vn100d(&["--data-dir", world.path("data").to_str().unwrap(), "import", recording.to_str().unwrap()]);
        assert!(again.status.success(), "write {write}: {}", String::from_utf8_lossy(&again.stderr));
        assert!(begun.elapsed() < Duration::from_secs(60));
        settle(&world);
        let rows = world.query("SELECT count(*) FROM sample WHERE capture_id = 1");
        assert_eq!(rows[0][0], rusqlite::types::Value::Integer(samples as i64), "write {write}");
        if ended.status.success() {
            break;
        }
    }
    println!("killed at {kept} places before the upgrade was committed, {upgraded} after");
    assert!(kept > 0 && upgraded > 0, "{kept} {upgraded}");
}
