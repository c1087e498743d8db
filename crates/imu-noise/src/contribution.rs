//! Contribution: one capture's part in a document about several.

use super::fit::Flag;
use super::robust::Disturbances;
use imu_core::sample::Channel;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One of the captures in a document about several.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Contribution {
    /// The name of the capture.
    pub capture: String,
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
    /// The findings in each channel; times count from this capture's start.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub flags: BTreeMap<Channel, Vec<Flag>>,
    /// The disturbances of each channel during its recording.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub disturbances: BTreeMap<Channel, Disturbances>,
}
