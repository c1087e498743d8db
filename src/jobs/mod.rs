//! Jobs: durable background work over captures, in chunks, beside a running capture.
//!
//! In: requests ([`JobRequest`], capture). Out: results in the store, as the JSON documents that the interfaces
//! return. Guarantees: the same submission is the same job. A job that is killed at any point continues at its last
//! chunk and produces the same bytes. Its input is fixed when it is submitted. Nothing is averaged across a gap, a
//! reset, an absent value or two rates. A job whose process dies three times at the same chunk fails. Each job has a
//! separate process at nice 10 and with a memory limit. It rests a tenth of its time while it reads, holds no read
//! transaction between chunks, and fits on two threads. Memory is bounded whatever a capture's length:
//! docs/performance.md has the figures. A diagnosis is an exception: it takes the samples that fit, all at once, and
//! reports this. Its checkpoints come after each channel.
//!
//! [`direct`] does the same for a caller that waits, from any [`SampleSource`].
//!
//! [`Live`] provides results for a capture that still runs.

mod apart;
mod cost;
mod curves;
mod diagnosis;
mod diagnosis_parameters;
mod diagnosis_request;
pub mod direct;
mod distribution;
mod document;
mod error;
mod examine;
mod fold;
mod gridded;
mod held;
mod live;
mod model;
mod motion;
mod pass;
mod plan;
mod raw_counts;
mod report;
mod request;
mod runner;
mod sampling;
mod source;
mod spectra;
mod sums;
#[cfg(test)]
mod tests;
mod threads;
mod together;
mod worker;

pub use crate::store::JobKind;
pub use apart::{JOB_MEMORY_BYTES, JOB_PROCESSOR_S, answer};
pub use cost::{EFFECTS_MAX, add_cost, check_size, rest, resting, temperatures};
pub use diagnosis::{DiagnosisDocument, read_diagnosis};
pub use diagnosis_parameters::{DiagnosisParameters, ReferenceAxis, ReferenceMotion, Simulator, read_reference};
pub use diagnosis_request::{DiagnosisBody, SIM_BYTES_MAX, answer_diagnosis_body};
pub use document::Documents;
pub use error::JobError;
pub use gridded::{Gridded, gridded};
pub use live::{CATCH_UP, Live, LivePoints, SoFar};
pub use model::{Fitted, fitted};
pub use plan::{Plan, Slice};
pub use report::StatisticsReport;
pub use request::{AnalysisRequest, CAPTURES_MAX, JobParameters, JobRequest};
pub use sampling::{SamplingError, of_configuration, sampling};
pub use source::{CHUNK, Extent, SampleSource};
pub use sums::MEMORY;
pub use threads::TwoThreads;
pub use together::{Setting, one_sensor};
pub use worker::{Jobs, JobsOptions, Place, leave_for_daemon};
