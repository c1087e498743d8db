//! `vn100d`: unattended capture of a VectorNav VN-100 into SQLite, noise parameters by `curl`.
//!
//! Data flows one way:
//!
//! ```text
//! bytes ──► frames ──► samples ──► store ──► analysis ──► results ──► API
//! vn100-proto  imu-core            store     imu-noise, jobs         api
//!    └── capture drives these ──┘
//! ```
//!
//! The pure crates below `crates/` take bytes, numbers, time and randomness as arguments. The modules of this package
//! do the input and output ([`capture`], [`store`], [`jobs`], [`api`], [`cli`]) and meet only in [`daemon`].
//! `docs/architecture.md` has the diagram; the compiler and `tests/it/tidy.rs` check it.

pub mod clock;
pub mod control;
pub mod observe;

pub mod page;
pub mod plot;
pub mod process;
pub mod pty;

pub mod api;
pub mod capture;
pub mod cli;
pub mod config;
pub mod daemon;
pub mod emulator;
pub mod gallery;
pub mod jobs;
pub mod notify;
pub mod retention;
pub mod schedule;
pub mod share;
pub mod store;
