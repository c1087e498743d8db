//! The document `vn100d-cost-1` (docs/formats.md): quantities, causes, tolerances.

use crate::request::Quantity;
use imu_core::sample::Channel;
use serde::Serialize;
use std::collections::BTreeMap;

/// The format's name; a change that old readers would misread gets a new number.
pub const FORMAT: &str = "vn100d-cost-1";

/// What a sensor model costs: error growth of unaided strapdown integration, at rest or along a motion.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cost {
    /// [`FORMAT`].
    pub format: &'static str,
    /// The model, as the caller names it.
    pub model: String,
    /// The motion after the alignment, as the caller names it; absent at rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motion: Option<String>,
    /// Time of the alignment, s.
    pub align_s: f64,
    /// Times since the alignment's end, s.
    pub horizons_s: Vec<f64>,
    /// Whether each horizon is longer than the record that the model was fitted to; absent if the model does not state
    /// the record's length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extrapolated: Option<Vec<bool>>,
    /// Gravity that couples attitude into velocity, m/s².
    pub gravity_m_s2: f64,
    /// The quantities whose channels the model has.
    pub quantities: BTreeMap<Quantity, Growth>,
    /// What each cause contributes, the largest at the last horizon first within a quantity.
    pub causes: Vec<Cause>,
    /// The verdicts on the requested limits.
    pub tolerances: Vec<Verdict>,
    /// What a reader has to know, one sentence each.
    pub notes: Vec<String>,
}

/// The growth of one quantity's error, one number per horizon.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Growth {
    /// `rad`, `m/s` or `m`.
    pub unit: &'static str,
    /// Mean over the ensemble of sensors and nights.
    pub mean: Vec<f64>,
    /// Standard deviation over the ensemble.
    pub sd: Vec<f64>,
    /// The error's size stays below this with a probability of 95 %.
    pub band95: Vec<f64>,
    /// The band with every K at the upper end of its 95 % interval; only for extrapolated horizons of a model that
    /// states such intervals.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub band95_upper: Option<Vec<f64>>,
    /// How the numbers were found.
    pub method: Method,
    /// Runs of the simulation, if there was one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub runs: Option<usize>,
    /// The effects that had to be simulated, such as `saturation on gyro_x`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub simulated: Vec<String>,
}

/// How a quantity was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Method {
    /// From spectra, courses and distributions.
    #[serde(rename = "closed form")]
    ClosedForm,
    /// From runs of the simulator, at least in part.
    #[serde(rename = "Monte Carlo")]
    MonteCarlo,
}

/// One cause's part in one quantity, one number per horizon.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cause {
    /// `N`, `B`, `K`, or an effect's name; several effects of a kind on a channel are one cause.
    pub cause: String,
    /// The channel.
    pub channel: Channel,
    /// The quantity.
    pub quantity: Quantity,
    /// Share of the mean square error: (mean·own mean + own covariance with the whole)/(mean² + sd²). The shares of a
    /// quantity sum to 1. A cause that opposes the others has a negative one.
    pub share: Vec<f64>,
    /// 1 − (band without the cause)/band.
    pub share_band95: Vec<f64>,
    /// The 95 % band without the cause, in the quantity's unit.
    pub band95_without: Vec<f64>,
}

/// The verdict on one limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// The quantity.
    pub quantity: Quantity,
    /// Time since the alignment's end, s.
    pub horizon_s: f64,
    /// The largest allowed 95 % band, in the quantity's unit.
    pub limit: f64,
    /// The 95 % band, in the quantity's unit.
    pub value: f64,
    /// `value`/`limit`.
    pub ratio: f64,
    /// Whether `value` is at most `limit`.
    pub pass: bool,
    /// The cause with the largest share, such as `warm_up on gyro_z`; empty if there is no error.
    pub deciding: String,
}
