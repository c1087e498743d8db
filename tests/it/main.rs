//! Integration tests: they use the built program as a user does.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

mod acceptance;
mod bad_input;
mod by_hand;
mod calibration;
mod circles;
mod completions;
mod cost;
mod demo;
mod diagnoses;
mod diagnosis;
mod docs;
mod export;
mod export_line;
mod filter_parameters;
mod gap;
mod imports;
mod night;
mod odd_diagnoses;
mod output;
mod pages;
mod parts;
mod plots;
mod poses;
mod real_recordings;
mod recordings;
mod replay;
mod report;
mod restart;
mod schedule;
mod share;
mod simulation;
mod tidy;
mod trial;
mod unattended;
#[path = "../world/mod.rs"]
mod world;
