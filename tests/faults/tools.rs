//! Tools: what a fault needs besides the program, and how large a run shall be.

#![allow(dead_code, reason = "not every machine runs every row")]

use std::process::{Command, Stdio};

/// True where this program can be run. Where it cannot, says that the test is skipped; with `VN100D_REQUIRE_TOOLS` set, as
/// CI does, a missing tool fails the test instead.
pub fn have(tool: &str, reason: &str) -> bool {
    let found = Command::new("sh")
        .args(["-c", &format!("command -v {tool}")])
        .stdout(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    told(found, tool, reason)
}

/// True for the superuser, who may mount and set limits.
pub fn root(reason: &str) -> bool {
    told(rustix::process::geteuid().is_root(), "root", reason)
}

fn told(found: bool, what: &str, reason: &str) -> bool {
    if !found {
        assert!(std::env::var_os("VN100D_REQUIRE_TOOLS").is_none(), "{what} is required here: {reason}");
        eprintln!("skipped: {what} is not at hand ({reason})");
    }
    found
}

/// The full figure where `VN100D_FAULTS=full` asks for it, else the scaled one.
pub fn scaled<T>(every_push: T, full: T) -> T {
    if std::env::var("VN100D_FAULTS").is_ok_and(|value| value == "full") { full } else { every_push }
}
