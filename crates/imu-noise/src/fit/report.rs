//! Reports: the noise parameters of a capture, or of several, in the form of docs/formats.md.

use super::NoiseParameters;
use crate::Contribution;
use crate::robust::Disturbances;
use imu_core::sample::Channel;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Noise parameters of a capture, as returned by `GET /v1/captures/{id}/noise` and `vn100d noise --format json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct NoiseReport {
    /// [`NoiseReport::FORMAT`].
    pub format: String,
    /// The capture's name; for several captures, their names joined with ` + `.
    pub capture: String,
    /// For several captures of one sensor, the contribution of each. Durations and numbers of samples are then sums.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub captures: Vec<Contribution>,
    /// Sampling rate in Hz.
    pub rate_hz: f64,
    /// Sample time covered, s.
    pub duration_s: f64,
    /// Sample time at rest, s: the part that is analysed. Absent if motion is unknown, as without an inertial channel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_rest_s: Option<f64>,
    /// Sample time in motion, s, which is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moving_s: Option<f64>,
    /// Number of received samples.
    pub samples: u64,
    /// Number of missing samples.
    pub missing: u64,
    /// Whether the capture has ended.
    pub complete: bool,
    /// One entry per analysed channel.
    pub channels: BTreeMap<Channel, NoiseParameters>,
    /// The disturbances of each channel during its recording; absent for a running capture.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub disturbances: BTreeMap<Channel, Disturbances>,
    /// Comparison with a data sheet, if requested.
    pub datasheet: Option<serde_json::Value>,
}

impl NoiseReport {
    /// The name of this format.
    pub const FORMAT: &'static str = "vn100d-noise-1";

    /// Returns the reasons why parameters of this report should not be used: the `concerned` channels that are not
    /// usable, with their reasons. `None` if all are.
    pub fn refusal(&self, concerned: impl Fn(Channel) -> bool) -> Option<String> {
        let unusable = self.channels.iter().filter(|(channel, of)| !of.usable && concerned(**channel));
        let reasons: Vec<String> = unusable
            .map(|(channel, of)| {
                format!("{channel}: {}", of.reason.as_deref().unwrap_or("the parameters are not usable"))
            })
            .collect();
        (!reasons.is_empty()).then(|| reasons.join("; "))
    }
}
