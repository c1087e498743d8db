//! Diagnosis: where a record and a simulator's law differ, and which effect the simulator lacks. Pure.
//!
//! In: samples of one rate ([`Recording`]), a sensor model. Out: a [`Diagnosis`] in the form of the contract's section 6,
//! and the model with its parameters corrected and the effects found added.
//!
//! Everything is in one currency: nats of log density of the real samples per sample. A channel's samples are transformed
//! ([`transform`]), binned ([`grid`]) and compared with a spectrum ([`law`]); what is deterministic in them follows
//! [`course`]s and sines ([`series`]). What each effect would give is in [`evidence`]; [`search`] adds one after the other as
//! long as they are worth their price, which is what chance gives in simulated records of the same length.

pub mod course;
pub mod error;
pub mod evidence;
pub mod grid;
pub mod law;
pub mod recording;
pub mod report;
pub mod search;
pub mod series;
pub mod transform;

pub use error::DiagnosisError;
pub use recording::Recording;
pub use report::{Diagnosis, FORMAT, Verdict};
