//! Why a job was not taken or could not be done.

use super::SamplingError;
use crate::diagnosis::DiagnosisError;
use crate::noise::allan::AllanError;
use crate::simulator::ModelError;
use crate::store::StoreError;

/// Everything that can go wrong with a job.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JobError {
    /// No computation has that name.
    #[error("there is no job kind `{found}`: expected one of {expected}")]
    UnknownKind {
        /// The name.
        found: String,
        /// The names there are.
        expected: String,
    },
    /// The parameters of the job are not those of its kind.
    #[error("parameters of a `{kind}` job: {reason}")]
    Parameters {
        /// The kind.
        kind: &'static str,
        /// What is wrong with them.
        reason: String,
    },
    /// What was asked for is larger than can be read.
    #[error("{reason}")]
    TooLarge {
        /// What is, and how large it may be.
        reason: String,
    },
    /// Captures that are not of one sensor at one setting, or cannot be analysed together for another reason.
    #[error("captures cannot be analysed together: {reason}")]
    Together {
        /// What differs, and between which.
        reason: String,
    },
    /// The capture has nothing to compute from.
    #[error("{reason}")]
    InsufficientData {
        /// What is lacking.
        reason: String,
    },
    /// The estimator refused.
    #[error("{0}")]
    Allan(#[from] AllanError),
    /// A sensor model that is none.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// Recording and model cannot be compared.
    #[error("{0}")]
    Diagnosis(DiagnosisError),
    /// The stated sampling cannot be.
    #[error(transparent)]
    Sampling(#[from] SamplingError),
    /// A checkpoint could not be read.
    #[error("the checkpoint of job {job} is damaged: submit the job again")]
    Checkpoint {
        /// The job.
        job: i64,
    },
    /// The database refused.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The result could not be written as JSON.
    #[error("the result could not be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// The job was called off.
    #[error("the job was called off")]
    CalledOff,
    /// The job was told to wait for the next start.
    #[error("the job waits for the next start")]
    Stopped,
    /// A process of its own found that the job cannot be done.
    #[error("{reason}")]
    Refused {
        /// Why.
        reason: String,
    },
    /// The process of the job ended before the job was done.
    #[error("{reason}")]
    Died {
        /// How it ended.
        reason: String,
    },
    /// The process of the job reached its limit of processor time.
    #[error(
        "the job used all the processor time that a job may use: run it with `vn100d diagnose`, `noise` or `allan`, which have no limit, \
         or over fewer channels"
    )]
    OutOfTime,
    /// A process for the job could not be started.
    #[error("a process for the job could not be started: {0}")]
    Process(std::io::Error),
    /// A worker thread could not be started.
    #[error("a worker thread could not be started: {0}")]
    Thread(std::io::Error),
}

impl From<DiagnosisError> for JobError {
    fn from(error: DiagnosisError) -> Self {
        match error {
            DiagnosisError::CalledOff => Self::CalledOff,
            other => Self::Diagnosis(other),
        }
    }
}
