//! Jobs: durable background work over captures, in chunks, beside a running capture.
//!
//! In: submissions (kind, capture, parameters). Out: results in the store, as the JSON documents the interfaces give out.
//! Promised: the same submission is the same job; a job that is killed anywhere goes on at its last chunk and comes to the
//! same bytes; its input is fixed when it is submitted; nothing is averaged across a gap, a reset, an absent value or two
//! rates; one whose process dies three times at the same chunk fails. Each job has a process of its own at nice 10 and with a
//! limit of memory; it rests a tenth of its time while it reads and holds no read transaction between chunks, and fits on two
//! threads.
//! Memory is bounded whatever a capture's length: docs/performance.md has the figures. A diagnosis is the exception in two
//! ways: it begins anew where it was interrupted, and it takes the samples that fit, all at once, and says so.
//!
//! [`direct`] does the same for whoever waits, from any [`SampleSource`].
//!
//! [`Live`] answers for a capture that still runs.

mod apart;
mod curves;
mod diagnosis;
pub mod direct;
mod distribution;
mod error;
mod examine;
mod fold;
mod gridded;
mod held;
mod kind;
mod live;
mod model;
mod motion;
mod plan;
mod raw_counts;
mod report;
mod runner;
mod sampling;
mod source;
mod spectra;
mod sums;
#[cfg(test)]
mod tests;
mod threads;
mod together;
mod wish;
mod worker;

pub use apart::{JOB_MEMORY_BYTES, JOB_PROCESSOR_S, answer};
pub use diagnosis::{DiagnosisDocument, DiagnosisParameters, Simulator};
pub use error::JobError;
pub use gridded::{Gridded, gridded};
pub use kind::{JobKind, JobParameters};
pub use live::{CATCH_UP, Live, LivePoints, SoFar};
pub use model::{Fitted, fitted};
pub use plan::{Plan, Slice};
pub use report::{Extent, StatisticsReport};
pub use runner::CHUNK;
pub use sampling::{SAMPLING_KEY, SamplingError, StatedSampling};
pub use source::SampleSource;
pub use sums::MEMORY;
pub use threads::TwoThreads;
pub use together::{CAPTURES_MAX, Setting, one_sensor};
pub use wish::{GivenReference, SIM_BYTES_MAX, WishBody, answer_wish};
pub use worker::{Jobs, JobsOptions, Place, leave_for_daemon};
