//! Tools: the requirements of a fault besides the program, and the scale of a run.

#![allow(dead_code, reason = "not every machine runs every row")]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use vn100_testkit::tool;

/// Returns whether this program can be run. If not, prints that the test is skipped; with `VN100D_REQUIRE_TOOLS` set,
/// as in CI, a missing tool fails the test instead.
pub fn have(name: &str, reason: &str) -> bool {
    let found = Command::new("sh")
        .args(["-c", &format!("command -v {name}")])
        .stdout(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    tool(found, name, reason)
}

/// Returns whether this is the superuser, who may mount and set limits.
pub fn root(reason: &str) -> bool {
    tool(rustix::process::geteuid().is_root(), "root", reason)
}

/// The civil time of a program: libfaketime, and the file with its offset.
pub struct Faketime {
    library: PathBuf,
    file: PathBuf,
}

impl Faketime {
    /// Returns `None`, with a note, if the library is not installed. `offset`: `+0`, `-3600`, in s.
    pub fn new(folder: &Path, offset: &str) -> Option<Self> {
        let folders = std::fs::read_dir("/usr/lib").into_iter().flatten().flatten().map(|entry| entry.path());
        let library = folders.map(|folder| folder.join("faketime/libfaketime.so.1")).find(|library| library.exists());
        tool(library.is_some(), "libfaketime", "it sets the daemon's clock");
        let faketime = Self { library: library?, file: folder.join("offset") };
        faketime.step(offset);
        Some(faketime)
    }

    /// Returns the environment with which a program must be started.
    pub fn environment(&self) -> [(&str, &std::ffi::OsStr); 4] {
        [
            ("LD_PRELOAD", self.library.as_os_str()),
            ("FAKETIME_TIMESTAMP_FILE", self.file.as_os_str()),
            ("FAKETIME_NO_CACHE", "1".as_ref()),
            ("FAKETIME_DONT_FAKE_MONOTONIC", "1".as_ref()),
        ]
    }

    /// Steps civil time to this offset; readers never see half a file.
    pub fn step(&self, offset: &str) {
        let next = self.file.with_extension("next");
        std::fs::write(&next, offset).unwrap();
        std::fs::rename(next, &self.file).unwrap();
    }
}

/// Returns the full figure if `VN100D_FAULTS=full` is set, else the scaled one.
pub fn scaled<T>(every_push: T, full: T) -> T {
    if std::env::var("VN100D_FAULTS").is_ok_and(|value| value == "full") { full } else { every_push }
}
