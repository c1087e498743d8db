//! Integration tests: the built program, driven as a user drives it.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

mod bad_input;
mod demo;
mod docs;
mod night;
mod replay;
mod restart;
mod tidy;
#[path = "../world/mod.rs"]
mod world;
