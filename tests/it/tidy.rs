//! Checks the imports that `docs/architecture.md` allows, and a few conventions.

use std::path::{Path, PathBuf};

/// A module of the root package, and the modules and crates that it may use. The allowed crates of a crate are in its
/// `Cargo.toml`.
const MAY_USE: [(&str, &[&str]); 18] = [
    ("clock", &[]),
    ("process", &[]),
    ("observe", &["imu_core", "clock"]),
    ("control", &[]),
    ("config", &["imu_core", "observe"]),
    ("pty", &[]),
    ("emulator", &["vn100_proto", "imu_model", "imu_core", "clock", "pty"]),
    ("capture", &["vn100_proto", "imu_core", "clock", "observe"]),
    ("store", &["imu_core", "clock", "observe"]),
    ("share", &["vn100_proto", "imu_core", "imu_files", "observe", "pty"]),
    (
        "page",
        &[
            "store",
            "jobs",
            "observe",
            "plot",
            "imu_cost",
            "imu_diagnosis",
            "imu_files",
            "imu_model",
            "imu_noise",
            "imu_core",
        ],
    ),
    ("plot", &["imu_diagnosis", "imu_noise", "imu_core"]),
    ("gallery", &["process", "store", "jobs", "page", "plot", "imu_files", "imu_noise", "imu_core"]),
    (
        "jobs",
        &[
            "process",
            "store",
            "imu_cost",
            "imu_diagnosis",
            "imu_model",
            "imu_pose",
            "imu_noise",
            "imu_core",
            "clock",
            "observe",
        ],
    ),
    ("notify", &["observe", "imu_core", "clock"]),
    ("retention", &["imu_core"]),
    ("schedule", &["retention", "clock"]),
    (
        "api",
        &[
            "store",
            "jobs",
            "page",
            "gallery",
            "imu_cost",
            "imu_model",
            "imu_noise",
            "imu_files",
            "imu_core",
            "observe",
            "process",
            "control",
            "clock",
        ],
    ),
];
/// Modules that may use all others.
const ALL: [&str; 4] = ["daemon", "cli", "lib", "main"];
/// The crates beside the root package.
const CRATES: [&str; 11] = [
    "imu_core",
    "imu_noise",
    "imu_model",
    "imu_pose",
    "imu_diagnosis",
    "imu_cost",
    "imu_files",
    "imu_trial",
    "imu_judge",
    "vn100_proto",
    "vn100_testkit",
];
/// Items that a part of a crate may not use, although the crate may.
const MAY_NOT_USE: [(&str, &[&str]); 11] = [
    ("imu-core/units", &["crate::sample", "crate::ros_messages"]),
    ("imu-core/sample", &["crate::ros_messages"]),
    ("imu-core/ros_messages", &["crate::"]),
    ("imu-model/effects", &["crate::simulator", "crate::motion"]),
    ("imu-model/simulator", &["crate::motion"]),
    ("imu-files/recording", &["crate::export", "imu_noise", "imu_model", "imu_pose"]),
    ("imu-files/export", &["crate::recording"]),
    // The trial has other parametrisations than the fitted ones.
    ("imu-trial", &["imu_model::effects", "imu_model::motion", ".spec()"]),
    // Pages take rows and results, and do not read the database.
    ("page", &["Reader", "Store,", "Store}", "Jobs,", "Jobs}", "jobs::direct"]),
    ("imu-noise", &["crate::datasheet"]),
    ("imu-diagnosis", &["crate::model_fit"]),
];
/// Modules and crates that take bytes, numbers, time and randomness as arguments.
const PURE: [&str; 13] = [
    "imu-core",
    "imu-noise",
    "imu-model",
    "imu-pose",
    "imu-diagnosis",
    "imu-cost",
    "imu-trial",
    "imu-judge",
    "vn100-proto",
    "page",
    "plot",
    "retention",
    "schedule",
];
/// Files of shells that are pure nevertheless.
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
    "emulator/options.rs",
    "emulator/faults.rs",
    "emulator/line.rs",
    "emulator/outbox.rs",
    "emulator/uart.rs",
    "share/backlog.rs",
    "notify/coalesce.rs",
    "notify/notice.rs",
    "notify/watch.rs",
    "imu-files/recording/account.rs",
    "imu-files/recording/between.rs",
    "imu-files/recording/choice.rs",
    "imu-files/recording/grid/mod.rs",
    "imu-files/recording/grid/period.rs",
    "imu-files/recording/grid/track.rs",
    "imu-files/recording/order.rs",
    "imu-files/recording/doubts.rs",
    "imu-files/recording/columns.rs",
    "imu-files/recording/header.rs",
    "imu-files/recording/kind.rs",
    "imu-files/recording/mapping.rs",
    "imu-files/recording/names.rs",
    "imu-files/recording/number.rs",
    "imu-files/recording/propose.rs",
    "imu-files/recording/utf16.rs",
    "imu-files/recording/vocabulary.rs",
    "imu-files/recording/table/arrays.rs",
    "imu-files/recording/table/hdf5.rs",
    "imu-files/recording/table/mat5.rs",
    "imu-files/recording/table/npy.rs",
    "imu-files/recording/pairs.rs",
    "imu-files/recording/part.rs",
    "imu-files/recording/placing.rs",
    "imu-files/recording/quantum.rs",
    "imu-files/recording/turning.rs",
    "imu-files/recording/values.rs",
    "imu-files/recording/ros/definition.rs",
    "imu-files/recording/ros/field.rs",
    "imu-files/recording/ros/given.rs",
    "imu-files/recording/ros/layout.rs",
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
/// Maximum number of lines of code in a file.
const LINES_MAX: usize = 500;
/// Longer files, with the reason.
const LONG_FILES: [(&str, &str); 5] = [
    ("imu-diagnosis/law.rs", "one type: the law of a spectrum with its parameters, derivatives and fit"),
    ("imu-diagnosis/translate.rs", "one translation: a method for each kind of finding"),
    ("imu-model/effects/spec.rs", "a table: the keys of each effect with their ranges"),
    ("imu-noise/whittle/likelihood.rs", "one likelihood with its gradient and information"),
    ("store/writer.rs", "one thread: the only one that writes to the database"),
];
/// Maximum number of lines of code in a function.
const FUNCTION_LINES_MAX: usize = 80;
/// Longer functions, with the reason.
const LONG_FUNCTIONS: [(&str, &str, &str); 23] = [
    ("imu-cost/sheet/mod.rs", "sheet", "assembles one document from all that was computed"),
    ("imu-diagnosis/diagnose.rs", "explain", "the steps of one explanation share a dozen values"),
    ("imu-diagnosis/law.rs", "fit_for", "one iteration with its damping"),
    ("imu-diagnosis/motion/compose.rs", "outcome", "assembles one report"),
    ("imu-diagnosis/motion/poses.rs", "tumbled", "one fit with its choice of groups, whose steps share its matrices"),
    ("imu-diagnosis/motion/settle.rs", "settle", "one iteration, whose steps share its state"),
    ("imu-diagnosis/motion/tumble.rs", "complete", "assembles one report"),
    ("imu-diagnosis/motion/posed.rs", "notes", "a list of sentences"),
    ("imu-diagnosis/prepare.rs", "channel_of", "one pass over a channel, whose steps share its values"),
    ("imu-model/simulator/model/schema.rs", "schema", "a table"),
    ("imu-trial/impose/outside/chain.rs", "draw", "a table of kinds"),
    ("imu-trial/impose/outside/wander.rs", "draw", "a table of kinds"),
    ("imu-trial/motion/score.rs", "of", "a table of rates"),
    ("imu-trial/rates.rs", "of", "a table of rates"),
    ("vn100-proto/decoder.rs", "advance", "one state machine"),
    ("capture/task.rs", "run", "one loop over the events of the port"),
    ("cli/show.rs", "run", "a table of lines"),
    ("cli/status.rs", "rows", "a table of lines"),
    ("daemon/mod.rs", "run", "where all rooms meet: the order of their start and end"),
    ("emulator/terminal.rs", "run", "one loop over the events of the terminal"),
    ("jobs/cost.rs", "add_cost", "assembles one document"),
    ("jobs/examine.rs", "examine", "the steps of one job in order, each with its progress"),
    ("store/insert.rs", "insert", "one transaction"),
];

/// Returns the sources of the root package as `module/file.rs`, and those of the crates as `crate/file.rs`, without
/// files of tests.
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
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    walk(&root.join("src"), &mut found);
    walk(&root.join("crates"), &mut found);
    found.sort();
    let name = |path: &Path| {
        let path = path.strip_prefix(root).unwrap().display().to_string();
        let inside = path.strip_prefix("src/").map(str::to_owned);
        inside.unwrap_or_else(|| path.trim_start_matches("crates/").replacen("/src/", "/", 1))
    };
    let all: Vec<(String, String)> =
        found.into_iter().map(|path| (name(&path), std::fs::read_to_string(&path).unwrap())).collect();
    all.iter().filter(|(file, _)| !is_tests(file, &all)).cloned().collect()
}

fn room(file: &str) -> &str {
    file.split('/').next().unwrap().trim_end_matches(".rs")
}

/// Returns whether a file contains only tests: its parent declares it behind `#[cfg(test)]`.
fn is_tests(file: &str, sources: &[(String, String)]) -> bool {
    let path = Path::new(file);
    let name = path.file_stem().unwrap().to_string_lossy().into_owned();
    let parent = path.parent().unwrap();
    let declared = format!("#[cfg(test)]\nmod {name};");
    let mut parents = vec![parent.join("mod.rs"), parent.join("lib.rs")];
    parents.extend(parent.file_name().map(|folder| parent.with_file_name(format!("{}.rs", folder.to_string_lossy()))));
    sources.iter().any(|(other, text)| parents.contains(&PathBuf::from(other)) && text.contains(&declared))
}

/// Returns the part of a file before its tests, without comments.
fn code(text: &str) -> String {
    let end = text.find("#[cfg(test)]\nmod tests {").unwrap_or(text.len());
    text[..end].lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

#[test]
fn rooms_import_only_what_the_map_allows() {
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        let code = code(&text);
        for (_, forbidden) in MAY_NOT_USE.iter().filter(|(part, _)| is_part(&file, part)) {
            wrong.extend(
                forbidden.iter().filter(|word| code.contains(**word)).map(|word| format!("{file} uses {word}")),
            );
        }
        if room(&file).contains('-') || ALL.contains(&room(&file)) {
            continue;
        }
        let Some((_, allowed)) = MAY_USE.iter().find(|(name, _)| *name == room(&file)) else {
            wrong.push(format!("{file} is in a room that the map does not have"));
            continue;
        };
        let ends = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
        let rooms = code.split("crate::").skip(1).filter_map(|part| part.split(ends).next());
        let crates = code.split(ends).filter(|word| word.starts_with("imu_") || word.starts_with("vn100_"));
        // A field or a function may have such a name too.
        let crates = crates.filter(|word| CRATES.contains(word));
        for used in rooms.chain(crates) {
            if !used.is_empty() && used != room(&file) && !allowed.contains(&used) {
                wrong.push(format!("{file} uses {used}"));
            }
        }
    }
    assert!(wrong.is_empty(), "forbidden imports:\n{}", wrong.join("\n"));
}

/// Returns whether a file belongs to a crate, or to a part of one.
fn is_part(file: &str, part: &str) -> bool {
    file.strip_prefix(part).is_some_and(|rest| rest.starts_with(['/', '.']))
}

/// Compares the table of crates in docs/architecture.md with their manifests.
#[test]
fn the_table_of_crates_is_that_of_their_manifests() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let table = std::fs::read_to_string(root.join("docs/architecture.md")).unwrap();
    let (_, table) = table.split_once("## Crates").unwrap();
    let (table, _) = table.split_once("\n## ").unwrap();
    let rows = table.lines().filter_map(|line| line.strip_prefix("| `")).filter_map(|row| {
        let (name, rest) = row.split_once('`')?;
        let uses = rest.trim_end_matches('|').rsplit('|').next()?;
        name.contains('-')
            .then(|| (name.to_owned(), uses.split(", ").map(|of| of.trim().to_owned()).collect::<Vec<_>>()))
    });
    let mut seen = 0;
    for (name, mut uses) in rows {
        let manifest = std::fs::read_to_string(root.join("crates").join(&name).join("Cargo.toml")).unwrap();
        let manifest: toml::Table = manifest.parse().unwrap();
        let dependencies = manifest["dependencies"].as_table().unwrap();
        let mut own: Vec<String> = dependencies.keys().filter(|of| is_ours(of)).cloned().collect();
        uses.retain(|of| !of.is_empty());
        own.sort();
        uses.sort();
        assert_eq!(own, uses, "{name}: its manifest and docs/architecture.md");
        if PURE.contains(&name.as_str()) {
            let impure = ["tokio", "rusqlite", "axum", "hyper", "rustix", "tempfile", "ureq", "imu-files"];
            let found: Vec<&&str> = impure.iter().filter(|of| dependencies.contains_key(**of)).collect();
            assert!(found.is_empty(), "{name} is pure, and its manifest has {found:?}");
        }
        seen += 1;
    }
    assert_eq!(seen, CRATES.len());
}

fn is_ours(name: &str) -> bool {
    CRATES.contains(&name.replace('-', "_").as_str())
}

#[test]
fn pure_rooms_do_no_input_output_and_read_no_clock() {
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        let is_pure = PURE.contains(&room(&file)) || PURE_FILES.contains(&file.as_str());
        // A crate's examples are programs.
        let is_library = !file.contains("/examples/");
        if is_library && (is_pure || is_part(&file, "imu-files/export")) {
            // A call stays pure if its threads end before it does.
            let code = code(&text).replace("std::thread::scope", "");
            wrong.extend(IMPURE.iter().filter(|word| code.contains(**word)).map(|word| format!("{file} says {word}")));
        }
    }
    assert!(wrong.is_empty(), "not pure:\n{}", wrong.join("\n"));
}

/// The one file outside the store that reads SQLite: bags of other programs.
const OTHERS_DATABASES: (&str, &str) = ("rusqlite::", "imu-files/recording/ros/db3.rs");

#[test]
fn each_thing_has_one_owner() {
    let owners: [(&str, &[&str]); 5] = [
        ("rusqlite::", &["store", "vn100-testkit"]),
        ("StatusCode::", &["api"]),
        ("tokio_serial::", &["capture"]),
        ("rustix::pty", &["pty"]),
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
fn every_file_states_what_it_is_and_stays_readable() {
    let mut wrong = Vec::new();
    for (file, text) in sources() {
        if !text.starts_with("//!") {
            wrong.push(format!("{file} has no module comment"));
        }
        let lines = code(&text).lines().count();
        if lines > LINES_MAX && !LONG_FILES.iter().any(|(own, _)| *own == file) {
            wrong.push(format!("{file} has {lines} lines of code (at most {LINES_MAX})"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Returns the name and the number of lines of code of each function, as the formatter lays them out.
fn functions(text: &str) -> Vec<(String, usize)> {
    let code = code(text);
    let lines: Vec<&str> = code.lines().filter(|line| !line.trim().is_empty()).collect();
    let name = |line: &str| {
        let rest = line.trim_start().trim_start_matches("pub ").trim_start_matches("pub(super) ");
        let rest = rest.trim_start_matches("pub(crate) ").trim_start_matches("const ").trim_start_matches("async ");
        let rest = rest.strip_prefix("fn ")?;
        Some(rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>())
    };
    let from = |at: usize| {
        let own = name(lines[at]).filter(|_| !lines[at].ends_with(';'))?;
        let indent = lines[at].len() - lines[at].trim_start().len();
        let end = format!("{}}}", " ".repeat(indent));
        let length = lines[at..].iter().position(|line| *line == end)?;
        Some((own, length + 1))
    };
    (0..lines.len()).filter_map(from).collect()
}

#[test]
fn long_functions_have_a_reason() {
    let mut wrong = Vec::new();
    let mut known = LONG_FUNCTIONS.to_vec();
    for (file, text) in sources() {
        for (name, lines) in functions(&text).into_iter().filter(|(_, lines)| *lines > FUNCTION_LINES_MAX) {
            match known.iter().position(|(own, function, _)| *own == file && *function == name) {
                Some(place) => drop(known.remove(place)),
                None => wrong.push(format!("{file}: {name} has {lines} lines (at most {FUNCTION_LINES_MAX})")),
            }
        }
    }
    wrong.extend(known.iter().map(|(file, name, _)| format!("{file}: {name} is short: take it off the list")));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
