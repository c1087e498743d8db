//! HTTP: the daemon's interface.
//!
//! In: requests. Out: JSON, text, streams of samples, problem documents. Status, health and metrics are answered from
//! memory, also while the disk hangs; the database is read on threads for blocking work, a bounded number at a time.
//! Guarantees: every error is a problem document (RFC 9457), or a page for a browser, no number is NaN, no request makes the capture wait.
//! Refuses: heads that take longer than 5 s, bodies above 64 KiB, more than 1024 connections, more large queries,
//! bodies and imports than `docs/api.md` lists, readers that stop reading for 30 s, changes without the token beyond
//! loopback, on loopback any other host's name. A panic ends the process on purpose: committed data is safe, and a
//! restart is better than half a program. This module uses neither the serial port nor SQL. `docs/api.md` describes
//! each route, `docs/openapi.json` is the machine's description.

mod analysis;
mod aside;
mod captures;
mod comparison;
mod conditional;
mod connection;
mod diagnoses;
mod extract;
mod health;
mod held;
mod html;
mod imports;
mod jobs;
mod latest;
mod layers;
mod lists;
mod models;
mod openapi;
mod page;
mod pages;
mod plots;
mod problem;
mod router;
mod samples;
mod server;
mod state;
mod status;
mod stream;

#[cfg(test)]
mod tests;

pub use problem::{ApiError, PROBLEM_JSON, Problem, ProblemType};
pub use router::{document, router};
pub use server::{Limits, listen, serve};
pub use state::ApiParts;
