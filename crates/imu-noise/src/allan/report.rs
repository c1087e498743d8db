//! Reports: the deviation curves of a capture, or of several, in the form of docs/formats.md.

use super::{AllanCurve, Estimator};
use crate::Contribution;
use imu_core::sample::Channel;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Deviation curves of a capture, as returned by `GET /v1/captures/{id}/allan` and `vn100d allan --format json`
/// (docs/formats.md).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AllanReport {
    /// [`AllanReport::FORMAT`].
    pub format: String,
    /// The kind of deviation.
    pub estimator: Estimator,
    /// Sampling rate in Hz.
    pub rate_hz: f64,
    /// Whether the capture has ended.
    pub complete: bool,
    /// Number of samples analysed, from the capture's first one on: the input is fixed when a job is submitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub samples: Option<u64>,
    /// Samples at rest, s: the part that is analysed. Absent if motion is unknown, as without an inertial channel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_rest_s: Option<f64>,
    /// Samples in motion, s, which are left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moving_s: Option<f64>,
    /// For several captures of one sensor, the contribution of each. Samples are then their sum.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub captures: Vec<Contribution>,
    /// Number of missing samples.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing: Option<u64>,
    /// Notes about the input for the reader: gaps, samples that were left out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// One curve per channel.
    pub channels: BTreeMap<Channel, AllanCurve>,
}

impl AllanReport {
    /// The name of this format.
    pub const FORMAT: &'static str = "vn100d-allan-1";

    /// Creates a report of these curves.
    pub fn new(
        estimator: Estimator,
        rate_hz: f64,
        complete: bool,
        channels: impl IntoIterator<Item = (Channel, AllanCurve)>,
    ) -> Self {
        Self {
            format: Self::FORMAT.to_owned(),
            estimator,
            rate_hz,
            complete,
            samples: None,
            at_rest_s: None,
            moving_s: None,
            captures: Vec::new(),
            missing: None,
            warnings: Vec::new(),
            channels: channels.into_iter().collect(),
        }
    }

    /// Marks the averaging time from which on differences are no longer taken at every sample
    /// ([`AllanCurve::stride_from_s`]).
    pub fn stride_warning(&self) -> Option<String> {
        let from_s = self.channels.values().filter_map(|curve| curve.stride_from_s).min_by(f64::total_cmp)?;
        Some(format!("from {from_s:.0} s on, differences are taken at every sixteenth of the averaging time"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allan::NoiseType;

    #[test]
    fn a_report_is_written_as_documented() {
        let curve = AllanCurve {
            unit: "rad/s".into(),
            tau_s: vec![0.025],
            deviation: vec![1e-3],
            ci68_low: vec![9e-4],
            ci68_high: vec![1.1e-3],
            edf: vec![50.0],
            n: vec![99],
            stride_from_s: None,
            noise: vec![NoiseType::WhiteRate],
        };
        let report = AllanReport::new(Estimator::Oadev, 40.0, true, [(Channel::GyroX, curve)]);
        assert_eq!(
            serde_json::to_value(&report).unwrap(),
            serde_json::json!({
                "format": "vn100d-allan-1", "estimator": "oadev", "rate_hz": 40.0, "complete": true,
                "channels": { "gyro_x": { "unit": "rad/s", "tau_s": [0.025], "deviation": [1e-3], "ci68_low": [9e-4],
                                          "ci68_high": [1.1e-3], "edf": [50.0], "n": [99],
                                          "noise": ["white_rate"] } }
            })
        );
    }
}
