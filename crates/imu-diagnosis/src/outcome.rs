//! Outcome: the result of a diagnosis, with the corrected model.

use super::motion::Residuals;
use super::report::Diagnosis;
use imu_model::simulator::SensorModel;

/// The result of a diagnosis.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The report.
    pub diagnosis: Diagnosis,
    /// The model with its parameters corrected and the missing effects added.
    pub augmented: SensorModel,
    /// The part of a record of a known motion beyond the model, for pictures; empty for a record at rest.
    pub residuals: Vec<Residuals>,
    /// The places of the rest to which pictures of noise are limited, in a record of a motion; empty if there is none.
    pub rest: Option<std::ops::Range<usize>>,
}
