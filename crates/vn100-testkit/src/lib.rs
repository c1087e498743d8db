//! Helpers for the tests of several crates: counted skips, and writers of small ROS bags.

#![expect(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on fails")]

pub mod bag;
pub mod ros2;
mod skip;

pub use skip::{real_data, skipped, tool};
