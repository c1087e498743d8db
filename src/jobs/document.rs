//! Documents: the results of the usual kinds, which pictures and pages are made of.

use super::{JobKind, StatisticsReport};
use crate::store::StoreError;
use imu_noise::NoiseReport;
use imu_noise::allan::AllanReport;

/// Documents of one capture; `None` if there is none.
#[derive(Debug, Clone, Default)]
pub struct Documents {
    /// Statistics.
    pub statistics: Option<StatisticsReport>,
    /// Allan deviations.
    pub allan: Option<AllanReport>,
    /// Noise parameters.
    pub noise: Option<NoiseReport>,
}

impl Documents {
    /// Reads a stored result.
    ///
    /// # Errors
    /// [`StoreError::Json`] if the text is no such document.
    pub fn read(kind: JobKind, text: &str) -> Result<Self, StoreError> {
        let mut own = Self::default();
        match kind {
            JobKind::Statistics => own.statistics = Some(serde_json::from_str(text)?),
            JobKind::Allan => own.allan = Some(serde_json::from_str(text)?),
            JobKind::Noise => own.noise = Some(serde_json::from_str(text)?),
            JobKind::Diagnosis => {}
        }
        Ok(own)
    }

    /// Takes the documents that `other` has.
    pub fn extend(&mut self, other: Self) {
        self.statistics = other.statistics.or(self.statistics.take());
        self.allan = other.allan.or(self.allan.take());
        self.noise = other.noise.or(self.noise.take());
    }
}
