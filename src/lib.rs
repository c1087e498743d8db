//! `vn100d`: unattended capture of a VectorNav VN-100 into SQLite, noise parameters by `curl`.
//!
//! Data flows one way:
//!
//! ```text
//! bytes ──► frames ──► samples ──► store ──► analysis ──► results ──► API
//! protocol  sample                 store     noise, jobs             api
//!    └── capture drives these ──┘
//! ```
//!
//! Pure rooms ([`protocol`], [`sample`], [`noise`], [`effects`], [`simulator`]) take bytes, numbers, time and randomness
//! as arguments. Shells ([`capture`], [`store`], [`jobs`], [`api`], [`cli`]) do the input and output and meet only in
//! [`daemon`]. `docs/architecture.md` draws the map; `tests/it/tidy.rs` keeps it true.

#[cfg(test)]
#[path = "../tests/world/skip.rs"]
mod skip;

pub mod clock;
pub mod control;
pub mod observe;
pub mod sample;
pub mod units;

pub mod datasheet;
pub mod diagnosis;
pub mod effects;
pub mod export;
pub mod model_fit;
pub mod motion;
pub mod noise;
pub mod page;
pub mod plot;
pub mod process;
pub mod protocol;
pub mod ros_messages;
pub mod simulator;
pub mod trial;

pub mod api;
pub mod capture;
pub mod cli;
pub mod config;
pub mod daemon;
pub mod emulator;
pub mod gallery;
pub mod jobs;
pub mod notify;
pub mod recording;
pub mod retention;
pub mod schedule;
pub mod store;
