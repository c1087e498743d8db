//! Faults: the built daemon in a world with faults, and the audit of its data.
//!
//! One file per group of faults: the process and its host, the serial line, storage, time, HTTP, background jobs. Each
//! test is named after its promise and ends in the same audit ([`audit`]). The sizes are scaled so that all tests run
//! on every push; `VN100D_FAULTS=full` runs the figures that docs/reliability.md states.

#![expect(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on fails")]

mod audit;
mod http;
mod isolation;
mod jobs;
mod line;
mod process;
mod rate;
mod soak;
mod storage;
mod stream;
mod time;
mod tools;
#[path = "../world/mod.rs"]
mod world;
