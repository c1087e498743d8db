//! Keeps the house in order: the imports that `docs/architecture.md` allows, and a few habits.

use std::path::{Path, PathBuf};

/// Room, and the rooms it may use besides itself.
const MAY_USE: [(&str, &[&str]); 31] = [
    ("units", &[]),
    ("clock", &[]),
    ("process", &[]),
    ("sample", &["units"]),
    ("protocol", &["sample", "units"]),
    ("noise", &["sample", "units"]),
    ("datasheet", &["noise", "sample", "units"]),
    ("ros_messages", &[]),
    ("export", &["noise", "ros_messages", "simulator", "sample", "units"]),
    ("motion", &["simulator", "sample", "units"]),
    ("model_fit", &["diagnosis", "effects", "noise", "simulator", "sample"]),
    ("diagnosis", &["effects", "motion", "noise", "simulator", "sample", "units"]),
    ("trial", &["diagnosis", "simulator", "sample", "units"]),
    ("effects", &["sample", "units"]),
    ("simulator", &["effects", "sample", "units"]),
    ("observe", &["sample", "units", "clock"]),
    ("control", &[]),
    ("emulator", &["protocol", "simulator", "sample", "clock", "units"]),
    ("capture", &["protocol", "sample", "clock", "observe", "units"]),
    ("store", &["sample", "clock", "observe", "units"]),
    ("recording", &["protocol", "ros_messages", "sample", "clock", "units"]),
    ("page", &["export", "noise", "plot", "sample"]),
    ("plot", &[]),
    ("gallery", &["process", "store", "plot", "datasheet", "export", "noise", "sample"]),
    (
        "jobs",
        &[
            "process",
            "store",
            "diagnosis",
            "model_fit",
            "motion",
            "noise",
            "simulator",
            "sample",
            "clock",
            "observe",
            "units",
        ],
    ),
    ("config", &["units", "protocol", "observe"]),
    ("notify", &["observe", "sample", "clock", "units"]),
    ("retention", &["sample"]),
    ("schedule", &["retention", "clock"]),
    (
        "api",
        &[
            "store",
            "jobs",
            "page",
            "plot",
            "gallery",
            "simulator",
            "datasheet",
            "export",
            "observe",
            "process",
            "control",
            "noise",
            "sample",
            "clock",
            "units",
        ],
    ),
    ("lib", &[]),
];
/// Rooms that take bytes, numbers, time and randomness as arguments.
const PURE: [&str; 16] = [
    "protocol",
    "sample",
    "noise",
    "datasheet",
    "diagnosis",
    "export",
    "motion",
    "model_fit",
    "ros_messages",
    "page",
    "plot",
    "effects",
    "simulator",
    "retention",
    "schedule",
    "trial",
];
/// Files of shells that are pure all the same.
const PURE_FILES: &[&str] = &[
    "capture/host_watch.rs",
    "capture/session.rs",
    "capture/session/connect.rs",
    "capture/script.rs",
    "capture/recorder.rs",
    "capture/backoff.rs",
    "capture/output.rs",
    "capture/rate_meter.rs",
    "capture/description.rs",
    "capture/action.rs",
    "emulator/registers.rs",
    "emulator/instant.rs",
    "emulator/sensor.rs",
    "emulator/faults.rs",
    "emulator/line.rs",
    "emulator/outbox.rs",
    "emulator/uart.rs",
    "notify/coalesce.rs",
    "notify/notice.rs",
    "notify/watch.rs",
    "recording/account.rs",
    "recording/between.rs",
    "recording/choice.rs",
    "recording/grid/mod.rs",
    "recording/grid/period.rs",
    "recording/grid/track.rs",
    "recording/order.rs",
    "recording/doubts.rs",
    "recording/header.rs",
    "recording/mapping.rs",
    "recording/number.rs",
    "recording/pairs.rs",
    "recording/placing.rs",
    "recording/quantum.rs",
    "recording/turning.rs",
    "recording/values.rs",
    "recording/ros/definition.rs",
    "recording/ros/given.rs",
    "recording/ros/layout.rs",
    "units.rs",
];
const IMPURE: [&str; 11] = [
    "tokio::",
    "rusqlite::",
    "axum::",
    "std::fs",
    "std::net",
    "std::thread",
    "std::process",
    "SystemTime::now",
    "Instant::now",
    "Utc::now",
    "rand::rng(",
];
const LINES_MAX: usize = 700;

fn sources() -> Vec<(String, String)> {
    fn walk(folder: &Path, found: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                walk(&path, found);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path);
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    walk(&root, &mut found);
    found.sort();
    let all: Vec<(String, String)> = found
        .into_iter()
        .map(|path| (path.strip_prefix(&root).unwrap().display().to_string(), std::fs::read_to_string(&path).unwrap()))
        .collect();
    all.iter().filter(|(file, _)| !is_tests(file, &all)).cloned().collect()
}

fn room(file: &str) -> &str {
    file.split('/').next().unwrap().trim_end_matches(".rs")
}

/// Whether a file holds nothing but tests: its parent declares it behind `#[cfg(test)]`.
fn is_tests(file: &str, sources: &[(String, String)]) -> bool {
    let path = Path::new(file);
    let name = path.file_stem().unwrap().to_string_lossy().into_owned();
    let parent = path.parent().unwrap();
    let declared = format!("#[cfg(test)]\nmod {name};");
    let mut parents = vec![parent.join("mod.rs")];
    parents.extend(parent.file_name().map(|folder| parent.with_file_name(format!("{}.rs", folder.to_string_lossy()))));
    sources.iter().any(|(other, text)| parents.contains(&PathBuf::from(other)) && text.contains(&declared))
}

/// The part of a file before its tests, without comments.
fn code(text: &str) -> String {
    let end = text.find("#[cfg(test)]\nmod tests {").unwrap_or(text.len());
    text[..end].lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

#[test]
fn rooms_import_only_what_the_map_allows() {
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        let Some((_, allowed)) = MAY_USE.iter().find(|(name, _)| *name == room(&file)) else { continue };
        for part in code(&text).split("crate::").skip(1) {
            let used: String = part.chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '_').collect();
            if !used.is_empty() && used != room(&file) && !allowed.contains(&used.as_str()) {
                wrong.push(format!("{file} uses crate::{used}"));
            }
        }
    }
    assert!(wrong.is_empty(), "forbidden imports:\n{}", wrong.join("\n"));
}

#[test]
fn pure_rooms_do_no_input_output_and_read_no_clock() {
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        if PURE.contains(&room(&file)) || PURE_FILES.contains(&file.as_str()) {
            // Threads that end before the call does leave it pure.
            let code = code(&text).replace("std::thread::scope", "");
            wrong.extend(IMPURE.iter().filter(|word| code.contains(**word)).map(|word| format!("{file} says {word}")));
        }
    }
    assert!(wrong.is_empty(), "not pure:\n{}", wrong.join("\n"));
}

/// The one file beside the store that reads SQLite: others' bags.
const OTHERS_DATABASES: (&str, &str) = ("rusqlite::", "recording/ros/db3.rs");

#[test]
fn each_thing_has_one_owner() {
    let owners: [(&str, &[&str]); 4] = [
        ("rusqlite::", &["store"]),
        ("StatusCode::", &["api"]),
        ("tokio_serial::", &["capture"]),
        ("PRAGMA ", &["store"]),
    ];
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        let code = code(&text);
        for (word, rooms) in owners {
            if code.contains(word) && !rooms.contains(&room(&file)) && (word, file.as_str()) != OTHERS_DATABASES {
                wrong.push(format!("{file} says {word}, which belongs to {rooms:?}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_file_says_what_it_is_and_stays_readable() {
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        if !text.starts_with("//!") {
            wrong.push(format!("{file} has no module comment"));
        }
        let lines = code(&text).lines().count();
        if lines > LINES_MAX {
            wrong.push(format!("{file} has {lines} lines of code (at most {LINES_MAX})"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
