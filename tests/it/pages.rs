//! The pages in a browser, as users see them: `tests/browser/pages.mjs` against the demonstration and a daemon with a
//! token.

use crate::world::{Process, World, program};
use serde_json::Value;
use std::path::Path;
use std::process::Command;
use vn100_testkit::tool;

/// The token in the configuration, which is also typed into the page.
const TOKEN: &str = "correct-horse-battery";
/// The properties that the script must have checked, and the minimum number of checks: a script that checks nothing is
/// no success. Pages are checked at two widths on light and on dark.
const HELD: [(&str, u64); 16] = [
    ("accessible", 48),
    ("diagnosis", 1),
    ("escaped", 10),
    ("lost", 1),
    ("moves", 8),
    ("picture", 500),
    ("policy", 22),
    ("refused", 2),
    ("report", 1),
    ("request", 300),
    ("schedule", 3),
    ("screenshot", 56),
    ("static", 3),
    ("token", 3),
    ("width", 56),
    ("zoom", 2),
];

/// Returns `None`, with a note, if the browser, its driver or the script's runtime is missing.
fn at_hand(root: &Path) -> Option<()> {
    let there = |names: &str| {
        let found = Command::new("sh").args(["-c", &format!("command -v {names}")]).output().unwrap();
        found.status.success()
    };
    let browser = "chromium || command -v chromium-browser || command -v google-chrome";
    let driver = root.join("target/browser/node_modules/playwright-core/package.json").exists()
        && root.join("target/browser/node_modules/axe-core/package.json").exists();
    let found = [
        tool(there("node"), "node", "it runs the browser test's script"),
        tool(there(browser), "chromium", "the pages are looked at in it"),
        tool(driver, "playwright-core with axe-core", "node tests/browser/pages.mjs --install brings them"),
    ];
    found.iter().all(|found| *found).then_some(())
}

#[test]
fn people_go_from_the_first_page_to_the_diagnosis_and_every_page_is_sound() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    if at_hand(root).is_none() {
        return;
    }
    let world = World::new();
    let sensor = world.emulate(&[]);
    let guarded = world.daemon(&format!("[http]\ntoken = \"{TOKEN}\"\n"), &[]);
    let streaming = || (world.get("/v1/status")["sensor"]["state"] == "streaming").then_some(());
    world.until("the sensor sends", std::time::Duration::from_secs(30), streaming, &guarded);
    // Slow enough for the first page to be checked while it records. Its folder is removed with the test's.
    let mut demo = program();
    demo.args(["demo", "--listen", "127.0.0.1:0", "--speed", "600"]).env("TMPDIR", world.folder.path());
    let mut demo = Process::start(&mut demo, true);
    let address = demo.first_line.split("answers at ").nth(1).unwrap_or_else(|| panic!("{}", demo.log()));
    let output = Command::new("node")
        .arg(root.join("tests/browser/pages.mjs"))
        .args(["--demo", address.trim_end_matches('.')])
        .args(["--guarded", &world.url, "--token", TOKEN, "--pid", &guarded.id().to_string()])
        .arg("--pictures")
        .arg(root.join("target/screenshots"))
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let printed = format!("{}{}", text(&output.stdout), text(&output.stderr));
    let logs = || format!("{printed}\nthe demonstration:\n{}\nthe daemon:\n{}", demo.log(), guarded.log());
    assert!(output.status.success(), "{}", logs());
    let last = printed.lines().find(|line| line.starts_with("{\"held\"")).unwrap_or_else(|| panic!("{printed}"));
    let report: Value = serde_json::from_str(last).unwrap();
    for (kind, least) in HELD {
        let held = report["held"][kind].as_u64().unwrap_or(0);
        assert!(held >= least, "{kind} held {held} times instead of {least}: {report}");
    }
    assert_eq!(demo.terminate(), Some(0), "{}", demo.log());
    drop(sensor);
}
