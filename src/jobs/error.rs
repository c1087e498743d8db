//! The reasons why a job was not accepted or could not be done.

use super::SamplingError;
use crate::store::StoreError;
use imu_cost::CostError;
use imu_diagnosis::DiagnosisError;
use imu_model::simulator::ModelError;
use imu_noise::allan::AllanError;

/// Errors of jobs.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    /// The parameters of the job are not those of its kind.
    #[error("parameters of a `{kind}` job: {reason}")]
    Parameters {
        /// The kind.
        kind: &'static str,
        /// The reason.
        reason: String,
    },
    /// The requested data is larger than can be read.
    #[error("{0}")]
    TooLarge(String),
    /// The captures are not of one sensor at one setting, or cannot be analysed together for another reason.
    #[error("captures cannot be analysed together: {0}")]
    Together(String),
    /// The capture has no data to compute from.
    #[error("{0}")]
    InsufficientData(String),
    /// The estimator returned an error.
    #[error("{0}")]
    Allan(#[from] AllanError),
    /// The sensor model is invalid.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A model's cost was refused.
    #[error(transparent)]
    Cost(#[from] CostError),
    /// Recording and model cannot be compared.
    #[error("{0}")]
    Diagnosis(DiagnosisError),
    /// The stated sampling is impossible.
    #[error(transparent)]
    Sampling(#[from] SamplingError),
    /// A checkpoint could not be read.
    #[error("the checkpoint of job {0} is damaged: submit the job again")]
    Checkpoint(i64),
    /// The database returned an error.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The result could not be written as JSON.
    #[error("the result could not be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// The job was cancelled.
    #[error("the job was called off")]
    CalledOff,
    /// The job was stopped until the next start.
    #[error("the job waits for the next start")]
    Stopped,
    /// The job's separate process found that the job cannot be done.
    #[error("{0}")]
    Refused(String),
    /// The process of the job ended before the job was done.
    #[error("{0}")]
    Died(String),
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
