//! Skips: reports that a test lacks a tool or a recording. A skip is printed, and counted if `VN100D_SKIPPED` names a
//! file, so that a successful run does not hide omitted checks.

use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Returns the repository's root: tests of a crate run in the crate's folder, but paths are relative to the root.
fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// Prints that the test is skipped, and appends a line to the file that `VN100D_SKIPPED` names.
pub fn skipped(why: &str) {
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    eprintln!("skipped: {test}: {why}");
    if let Some(path) = std::env::var_os("VN100D_SKIPPED").map(|path| root().join(path)) {
        let mut file = std::fs::File::options().append(true).create(true).open(path).expect("VN100D_SKIPPED is a file");
        // One write, so that lines of parallel tests do not mix.
        file.write_all(format!("{test}: {why}\n").as_bytes()).expect("VN100D_SKIPPED can be written");
    }
}

/// Returns `found`. If it is false, reports the skip, or fails the test if `VN100D_REQUIRE_TOOLS` is set, as in CI.
pub fn tool(found: bool, what: &str, reason: &str) -> bool {
    if !found {
        assert!(std::env::var_os("VN100D_REQUIRE_TOOLS").is_none(), "{what} is required here: {reason}");
        skipped(&format!("{what} is not at hand ({reason})"));
    }
    found
}

/// Returns a file or folder of the real recordings that `VN100D_REAL_DATA` names. If the variable is not set, reports
/// the skip and returns `None`. With `VN100D_REQUIRE_DATA` set, as in CI where they are available, missing recordings
/// fail the test.
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
