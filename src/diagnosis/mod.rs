//! Diagnosis: where a record and a simulator's law differ, and which effect the simulator lacks. Pure.
//!
//! In: samples of one rate, a sensor model, randomness. Out: what each known effect would explain, in nats of log density.

pub mod response;
pub mod transform;
