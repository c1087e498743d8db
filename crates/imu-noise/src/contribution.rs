//! Contribution: the part of one of several captures in a document that is made of them.

use super::fit::Flag;
use super::robust::Disturbances;
use imu_core::sample::Channel;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One of the captures that a document is made of.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Contribution {
    /// Its name.
    pub capture: String,
    /// Sample time covered, s.
    pub duration_s: f64,
    /// Of these at rest, s: what the document is made of. Absent if motion is unknown, as without an inertial channel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_rest_s: Option<f64>,
    /// In motion, s: left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moving_s: Option<f64>,
    /// Samples received.
    pub samples: u64,
    /// Samples missing.
    pub missing: u64,
    /// What was found in each channel; times count from this capture's start.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub flags: BTreeMap<Channel, Vec<Flag>>,
    /// What happened to each channel while it was recorded.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub disturbances: BTreeMap<Channel, Disturbances>,
}
