//! Skips: what a test does without when a tool or a recording is not at hand. It is said aloud, and counted where
//! `VN100D_SKIPPED` names a file: a green run shall not hide what it did not look at.

use std::io::Write as _;
use std::path::{Path, PathBuf};

/// The repository's root: tests of a crate run in the crate's folder, and paths are given relative to the root.
fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// Says that the test is skipped, also as a line of the file that `VN100D_SKIPPED` names.
pub fn skipped(why: &str) {
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    eprintln!("skipped: {test}: {why}");
    if let Some(path) = std::env::var_os("VN100D_SKIPPED").map(|path| root().join(path)) {
        let mut file = std::fs::File::options().append(true).create(true).open(path).expect("VN100D_SKIPPED is a file");
        // One write, so that lines of tests that run at once do not mix.
        file.write_all(format!("{test}: {why}\n").as_bytes()).expect("VN100D_SKIPPED can be written");
    }
}

/// True where `found`; else says so, or fails the test where `VN100D_REQUIRE_TOOLS` is set, as in CI.
pub fn tool(found: bool, what: &str, reason: &str) -> bool {
    if !found {
        assert!(std::env::var_os("VN100D_REQUIRE_TOOLS").is_none(), "{what} is required here: {reason}");
        skipped(&format!("{what} is not at hand ({reason})"));
    }
    found
}

/// A file or folder of the real recordings that `VN100D_REAL_DATA` names; `None`, said aloud, where it names none. With
/// `VN100D_REQUIRE_DATA` set, as in CI where they are at hand, their absence fails the test.
pub fn real_data(file: &str) -> Option<PathBuf> {
    let Some(folder) = std::env::var_os("VN100D_REAL_DATA") else {
        assert!(std::env::var_os("VN100D_REQUIRE_DATA").is_none(), "VN100D_REAL_DATA is required here for {file}");
        skipped(&format!("VN100D_REAL_DATA is not set, so {file} is not at hand"));
        return None;
    };
    let path = root().join(folder).join(file);
    assert!(path.exists(), "VN100D_REAL_DATA is set, but {} is missing", path.display());
    Some(path)
}
