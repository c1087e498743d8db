//! What commands print for people: digits, counts, widths, and what to do.

use crate::world::{program, vn100d};
use serde_json::json;
use std::path::Path;

fn done(arguments: &[&str]) -> String {
    let ended = vn100d(arguments);
    assert!(ended.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&ended.stderr));
    String::from_utf8(ended.stdout).unwrap()
}

/// Returns a model with these effects on three axes, and a recording of it of 20 min.
fn made(folder: &Path, name: &str, effects: &serde_json::Value, rate_hz: f64) -> (String, String) {
    let path = |end: &str| folder.join(format!("{name}.{end}")).to_str().unwrap().to_owned();
    let axis = json!({"N": 1e-4, "effects": effects});
    let channels = json!({"gyro_x": axis, "gyro_y": axis, "gyro_z": axis});
    let model = json!({"format": "vn100d-sensor-model-1", "name": name, "rate_hz": rate_hz, "channels": channels});
    std::fs::write(path("json"), model.to_string()).unwrap();
    done(&["simulate", "--model", &path("json"), "--duration", "20min", "--seed", "7", "--out", &path("csv")]);
    (path("json"), path("csv"))
}

#[test]
fn disturbances_are_counted_and_listed_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let effects = json!([{"effect": "spikes", "rate_hz": 0.01, "amplitude": 0.02},
                         {"effect": "tone", "frequency_hz": 7.3, "amplitude": 5e-4}]);
    let (_, recording) = made(folder.path(), "spiky", &effects, 40.0);
    let counted = done(&["noise", &recording]);
    let line = counted.lines().find(|line| line.starts_with("gyro_x: ") && line.contains(" spikes")).unwrap();
    assert!(line.ends_with(", 1 line (--verbose lists them)"), "{line}");
    assert!(!counted.contains("gyro_x: spike at"), "{counted}");
    let listed = done(&["noise", &recording, "--verbose"]);
    let spikes = listed.lines().filter(|line| line.starts_with("gyro_x: spike at")).count();
    assert!(spikes > 1 && line.starts_with(&format!("gyro_x: {spikes} spikes")), "{line}: {spikes} in\n{listed}");
    assert!(listed.contains("gyro_x: line: 7.3"), "{listed}");
}

#[test]
fn a_diagnosis_explains_its_columns_and_ends_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let (plain, _) = made(folder.path(), "plain", &json!([]), 40.0);
    let tone = json!([{"effect": "tone", "frequency_hz": 13.377, "amplitude": 5e-4}]);
    let (_, recording) = made(folder.path(), "toned", &tone, 40.0);
    let page = folder.path().join("gap.html").to_str().unwrap().to_owned();
    let better = folder.path().join("better.json").to_str().unwrap().to_owned();
    let arguments = ["diagnose", "--real", &recording, "--sim", &plain, "--html", &page, "--augmented-model", &better];
    let text = done(&arguments);
    assert!(text.contains("\nsure: the chance that this effect is the cause"), "{text}");
    let row = text.lines().find(|line| line.contains("frequency_hz 13.37")).unwrap();
    assert!(!row.contains('…') && row.contains(" %)"), "{row}");
    for share in text.split(" %").filter_map(|before| before.rsplit([' ', '(']).next()?.parse::<f64>().ok()) {
        assert!((0.0..=100.0).contains(&share), "{share} % in\n{text}");
    }
    let (_, advice) = text.split_once("\nWhat to do:\n").unwrap();
    assert!(advice.lines().all(|line| line.starts_with("- ")), "{advice}");
    assert!(advice.starts_with("- add a 13.377 Hz tone of "), "{advice}");
    assert!(advice.contains(&format!(": --augmented-model wrote it to {better}\n")), "{advice}");
    assert!(
        advice.contains("- isolate the table") && advice.contains("such as 100 Hz, to tell a folded line"),
        "{advice}"
    );
    let page = std::fs::read_to_string(&page).unwrap();
    for part in ["A nat is the unit of", "Sure: the chance that", "<h2>What to do</h2><ul><li>add a 13.377 Hz tone"] {
        assert!(page.contains(part), "{part} is not on the page");
    }
    assert!(done(&["diagnose", "--help"]).replace('\n', " ").contains("A nat is the unit of the natural logarithm"));
    let none = done(&["diagnose", "--real", &recording, "--sim", &better]);
    assert!(
        none.ends_with("\nWhat to do:\n- keep the model: a longer record would show smaller differences\n"),
        "{none}"
    );
}

#[test]
fn tables_fit_the_terminal_and_are_whole_without_one() {
    let folder = tempfile::tempdir().unwrap();
    let tone = json!([{"effect": "tone", "frequency_hz": 13.377, "amplitude": 5e-4}]);
    let (model, recording) = made(folder.path(), "toned", &tone, 40.0);
    let data = folder.path().join("data").to_str().unwrap().to_owned();
    done(&["--data-dir", &data, "import", &recording]);
    let other = made(folder.path(), "plain", &json!([]), 40.0).0;
    let all: [&[&str]; 6] = [
        &["captures"],
        &["show", "1"],
        &["noise", "1", "--datasheet", "vn-100"],
        &["model", "show", &model],
        &["allan", "1"],
        &["diagnose", "--real", "1", "--sim", &other],
    ];
    for arguments in all {
        let arguments = [&["--data-dir", &data], arguments].concat();
        let whole_words = std::cell::RefCell::new(std::collections::BTreeSet::new());
        let lines = |columns: Option<&str>| {
            let mut command = program();
            command.env_remove("COLUMNS").args(&arguments);
            columns.map(|columns| command.env("COLUMNS", columns));
            let ended = command.output().unwrap();
            assert!(ended.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&ended.stderr));
            let text = String::from_utf8(ended.stdout).unwrap();
            let words = |of: &str| {
                let word = |of: &str| of.trim_matches(|of: char| !of.is_alphanumeric()).to_owned();
                of.split_whitespace().map(word).collect::<std::collections::BTreeSet<_>>()
            };
            if columns.is_none() {
                whole_words.replace(words(&text));
            }
            // No word is cut in two.
            let cut: Vec<String> = words(&text).difference(&whole_words.borrow()).cloned().collect();
            assert!(cut.is_empty(), "{arguments:?} at {columns:?}: {cut:?}");
            let rows = text.lines().filter(|line| line.starts_with(['│', '┌', '╞', '└']));
            rows.map(|line| line.chars().count()).max()
        };
        let whole = lines(None);
        for columns in ["60", "80", "120"] {
            let most: usize = columns.parse().unwrap();
            let widest = lines(Some(columns));
            assert!(widest.is_none_or(|widest| widest <= most), "{arguments:?} at {columns}: {widest:?} of {whole:?}");
        }
    }
}

#[test]
fn rates_and_counts_read_as_people_write_them() {
    let folder = tempfile::tempdir().unwrap();
    let (_, recording) = made(folder.path(), "odd", &json!([]), 39.987_654);
    let text = std::fs::read_to_string(&recording).unwrap();
    // One sample is lost.
    let lines: Vec<&str> = text.lines().collect();
    let holed = folder.path().join("holed.csv").to_str().unwrap().to_owned();
    std::fs::write(&holed, [&lines[..5000], &lines[5001..]].concat().join("\n") + "\n").unwrap();
    let data = folder.path().join("data").to_str().unwrap().to_owned();
    let with = |arguments: &[&str]| done(&[&["--data-dir", &data], arguments].concat());
    let imported = with(&["import", &holed]);
    assert!(imported.contains("samples at 39.99 Hz, 1 missing in 1 gap\n"), "{imported}");
    let shown = with(&["show", "1"]);
    assert!(shown.contains(" at 39.99 Hz: ") && shown.contains("1 missing in 1 gap, 2 segments"), "{shown}");
    assert!(shown.contains("1 gap by source: 1 missing"), "{shown}");
    assert!(with(&["captures"]).contains("┆ 39.99 "));
    assert!(with(&["noise", "1"]).contains(" s at 39.99 Hz, "));
}
