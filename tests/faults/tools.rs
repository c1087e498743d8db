//! Tools: what a fault needs besides the program, and how large a run shall be.

#![allow(dead_code, reason = "not every machine runs every row")]

use crate::world::skip::tool;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// True where this program can be run. Where it cannot, says that the test is skipped; with `VN100D_REQUIRE_TOOLS` set, as
/// CI does, a missing tool fails the test instead.
pub fn have(name: &str, reason: &str) -> bool {
    let found = Command::new("sh")
        .args(["-c", &format!("command -v {name}")])
        .stdout(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    tool(found, name, reason)
}

/// True for the superuser, who may mount and set limits.
pub fn root(reason: &str) -> bool {
    tool(rustix::process::geteuid().is_root(), "root", reason)
}

/// The library that sets a program's clock, where it is installed.
pub fn libfaketime() -> Option<PathBuf> {
    let folders = std::fs::read_dir("/usr/lib").into_iter().flatten().flatten().map(|entry| entry.path());
    let library = folders.map(|folder| folder.join("faketime/libfaketime.so.1")).find(|library| library.exists());
    tool(library.is_some(), "libfaketime", "it steps the daemon's clock");
    library
}

/// The full figure where `VN100D_FAULTS=full` asks for it, else the scaled one.
pub fn scaled<T>(every_push: T, full: T) -> T {
    if std::env::var("VN100D_FAULTS").is_ok_and(|value| value == "full") { full } else { every_push }
}
