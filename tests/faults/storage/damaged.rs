//! A damaged database is detected, left alone, and salvaged (C8).

use super::*;
use crate::tools;
use rand::{RngExt as _, SeedableRng as _};
use std::collections::{BTreeMap, BTreeSet};

const EACH: u64 = 100;

/// Returns everything in a database, or the error that reading it returns.
fn content(database: &Path) -> Result<Vec<String>, rusqlite::Error> {
    let connection = rusqlite::Connection::open_with_flags(database, rusqlite::OpenFlags::SQLITE_OPEN_READ_ONLY)?;
    let mut all = Vec::new();
    for table in ["capture", "segment", "sample", "batch", "writer"] {
        let mut statement = connection.prepare(&format!("SELECT * FROM {table} NOT INDEXED"))?;
        let columns = statement.column_count();
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            let values: Result<Vec<_>, _> =
                (0..columns).map(|index| row.get::<_, rusqlite::types::Value>(index)).collect();
            all.push(format!("{table} {:?}", values?));
        }
    }
    Ok(all)
}

/// Returns content and times of the files in a folder.
fn state_of(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = std::fs::read_dir(folder).unwrap().flatten();
    files
        .filter(|file| !file.file_name().to_string_lossy().ends_with("-shm"))
        .filter(|file| !file.file_name().to_string_lossy().ends_with(".lock"))
        .map(|file| (file.file_name().to_string_lossy().into_owned(), std::fs::read(file.path()).unwrap()))
        .filter(|(_, bytes)| !bytes.is_empty())
        .collect()
}

/// Checks that the daemon refuses the database with one sentence and changes nothing in it; returns the sentence.
fn refused(world: &World) -> String {
    let before = state_of(&world.path("data"));
    let mut daemon = begin(world, &[], "", &[]);
    assert_eq!(daemon.wait(Duration::from_secs(20)), Some(74), "{}", daemon.log());
    assert!(state_of(&world.path("data")) == before, "the damaged files were changed");
    let last = last_words(&daemon);
    assert!(last.contains("vn100d recover"), "{last}");
    last
}

fn recovered(world: &World) -> serde_json::Value {
    let out = world.path("salvaged.db");
    let before = state_of(&world.path("data"));
    let database = world.database();
    let arguments = ["--json", "recover", database.to_str().unwrap(), "--out", out.to_str().unwrap(), "--force"];
    let output = vn100d(&arguments);
    assert!(state_of(&world.path("data")) == before, "the damaged files were changed");
    assert!(
        matches!(output.status.code(), Some(0 | 3)),
        "{:?} {}",
        output.status.code(),
        String::from_utf8_lossy(&output.stderr)
    );
    let mut report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    report["code"] = output.status.code().into();
    assert!(sound(&out), "the new database is whole");
    report
}

/// Returns the batches that have a byte on these pages: by their rows' times and by their checksum, which the pages
/// contain unchanged. It only assumes that integers are big-endian.
fn touched(image: &[u8], pages: &BTreeSet<usize>, batches: &[(u64, u64, u32)]) -> BTreeSet<u64> {
    let mut of_time = BTreeMap::new();
    for (first, count, _) in batches {
        of_time.extend((*first..first + count).map(|seq| (utc_ns(seq), *first)));
    }
    let of_crc: BTreeMap<u32, u64> = batches.iter().map(|(first, _, crc)| (*crc, *first)).collect();
    let mut found = BTreeSet::new();
    for page in pages {
        let bytes = &image[page * 4096..(page + 1) * 4096];
        for window in bytes.windows(8) {
            let time = i64::from_be_bytes(window.try_into().unwrap());
            found.extend(of_time.get(&time));
            let crc = u32::from_be_bytes(window[..4].try_into().unwrap());
            found.extend(of_crc.get(&crc));
        }
    }
    found
}

/// Row C8.
#[test]
fn flipped_bits_are_found_at_the_start_and_every_intact_batch_is_salvaged() {
    let world = World::new();
    build(&world.database(), tools::scaled(150, 600), EACH);
    let whole = std::fs::read(world.database()).unwrap();
    let truth = content(&world.database()).unwrap();
    let batches: Vec<(u64, u64, u32)> = world
        .query("SELECT first_seq, count, crc FROM batch ORDER BY first_seq")
        .into_iter()
        .map(|row| match row[..] {
            [
                rusqlite::types::Value::Integer(first),
                rusqlite::types::Value::Integer(count),
                rusqlite::types::Value::Integer(crc),
            ] => (first as u64, count as u64, crc as u32),
            _ => panic!("{row:?}"),
        })
        .collect();
    let all = batches.len() as u64 * EACH;
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(8);
    let (mut harmless, mut least) = (0, u64::MAX);
    let rounds = tools::scaled(10, 100);
    for round in 0..rounds {
        // First one bit, finally one on each of a hundred pages.
        let flips = match round {
            0..4 => 1,
            4..8 => tools::scaled(5, 20),
            _ => tools::scaled(20, 100),
        };
        let mut image = whole.clone();
        let mut pages = BTreeSet::new();
        for _ in 0..flips {
            let at = random.random_range(0..image.len());
            image[at] ^= 1 << random.random_range(0..8);
            pages.insert(at / 4096);
        }
        std::fs::write(world.database(), &image).unwrap();
        if content(&world.database()).is_ok_and(|content| content == truth) && {
            let checked = vn100d(&["check", world.database().to_str().unwrap()]);
            checked.status.success()
        } {
            // Nothing depends on this byte.
            harmless += 1;
            continue;
        }
        let mut daemon = begin(&world, &[], "", &[]);
        let code = daemon.wait(Duration::from_secs(20));
        // Page 1 may be so damaged that the file does not look like a database of this program: it is refused too.
        assert!(matches!(code, Some(74 | 73)), "round {round}: {code:?} {}", daemon.log());
        assert!(last_words(&daemon).contains("vn100d recover"), "{}", daemon.log());
        assert!(std::fs::read(world.database()).unwrap() == image, "the damaged file was changed");
        let report = recovered(&world);
        assert_eq!(report["code"], 3, "{report}");
        let lost_to = touched(&whole, &pages, &batches);
        let must = all - lost_to.len() as u64 * EACH;
        let captures = report["captures"].as_array().unwrap();
        let samples: u64 = captures.iter().map(|capture| capture["samples"].as_u64().unwrap()).sum();
        assert!(samples >= must, "round {round}: {samples} of {all}, {must} are intact: {report}");
        least = least.min(samples);
        // The salvaged data must be the written data.
        let salvaged = rusqlite::Connection::open(world.path("salvaged.db")).unwrap();
        let wrong: i64 = salvaged
            .query_row(
                "SELECT count(*) FROM sample WHERE abs(gyro_x - ((host_utc_ns - 1800000000000000000) / 2500000 + 0.1) * 1e-3 - 9) > 1e-6",
                [],
                |row| row.get(0),
            )
            .unwrap();
        let vouched: u64 = captures.iter().map(|capture| capture["without_checksum"].as_u64().unwrap()).sum();
        assert!(wrong as u64 <= vouched.min(flips as u64), "round {round}: {wrong} wrong: {report}");
    }
    println!("{rounds} rounds, {harmless} harmless; at least {least} of {all} samples salvaged");
    assert!(harmless < rounds / 2);
}

/// Row C8.
#[test]
fn a_truncated_database_is_refused_and_its_rest_salvaged() {
    let world = World::new();
    build(&world.database(), 100, EACH);
    let whole = std::fs::read(world.database()).unwrap();
    std::fs::write(world.database(), &whole[..whole.len() / 8192 * 4096]).unwrap();
    refused(&world);
    let report = recovered(&world);
    assert_eq!(report["code"], 3);
    let samples = report["captures"][0]["samples"].as_u64().unwrap();
    assert!((3000..10_000).contains(&samples), "{report}");
}

/// Row C8.
#[test]
fn a_log_that_was_taken_away_is_noticed() {
    let world = World::new();
    let _sensor = world.emulate(FAST);
    let mut daemon = start(&world, &[], "", &["--capture", "1h"]);
    until_committed(&world, 100, START, &daemon);
    let acknowledged = committed(&world);
    daemon.kill();
    let log = PathBuf::from(format!("{}-wal", world.database().display()));
    let taken = std::fs::read(&log).unwrap();
    std::fs::remove_file(&log).unwrap();
    let refusal = refused(&world);
    assert!(refusal.contains("-wal") && refusal.contains(".lock"), "{refusal}");
    // Once the log is back, everything is there.
    std::fs::write(&log, taken).unwrap();
    let mut daemon = start(&world, &[], "", &[]);
    until_committed(&world, acknowledged + 1, START, &daemon);
    stop_and_settle(&world, &mut daemon);
}

/// Row C8, while the daemon runs: a purge finds a damaged page of a capture that no client reads any more.
#[test]
fn damage_met_in_use_ends_the_daemon_with_what_to_run_and_no_start_writes_to_it_again() {
    let world = World::new();
    build(&world.database(), 150, EACH);
    let _sensor = world.emulate(FAST);
    let mut daemon = start(&world, &[], "", &["--capture", "1h"]);
    until_committed(&world, 80, START, &daemon);
    // The page that holds this row contains its time unchanged.
    let image = std::fs::read(world.database()).unwrap();
    let row = utc_ns(50 * EACH).to_be_bytes();
    let page = image.windows(8).position(|window| window == row).unwrap() / 4096;
    let file = std::fs::OpenOptions::new().write(true).open(world.database()).unwrap();
    std::os::unix::fs::FileExt::write_all_at(&file, &[0xA5; 64], page as u64 * 4096).unwrap();
    drop(file);
    let acknowledged = committed(&world);
    let (code, body) = world.request("DELETE", "/v1/captures/night", "").unwrap();
    assert_eq!(code, 204, "{body}");
    assert_eq!(daemon.wait(Duration::from_secs(30)), Some(74), "{}", daemon.log());
    let last = last_words(&daemon);
    assert!(last.contains("vn100d check") && last.contains("vn100d recover"), "{last}");
    // systemd starts it again and again: each time it is refused with the same words, and nothing is changed.
    for _ in 0..3 {
        assert_eq!(refused(&world), last);
    }
    let report = recovered(&world);
    let capture = report["captures"].as_array().unwrap().iter().find(|capture| capture["id"] == 2).unwrap();
    assert!(capture["samples"].as_u64().unwrap() >= acknowledged, "{acknowledged} were safe: {report}");
}
