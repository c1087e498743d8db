//! The document `vn100d-filter-parameters-1` (docs/formats.md): pairs, inflation, causes.

use super::request::RecordFrom;
use imu_core::sample::Channel;
use serde::Serialize;
use std::collections::BTreeMap;

/// The format's name; a change that old readers would misread gets a new number.
pub const FORMAT: &str = "vn100d-filter-parameters-1";

/// Parameters with which a filter's covariance is that of the real errors.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FilterParameters {
    /// [`FORMAT`].
    pub format: &'static str,
    /// The model, as the caller names it.
    pub model: String,
    /// The first and the last horizon, s.
    pub over_s: [f64; 2],
    /// Time of the alignment before each horizon, s.
    pub align_s: f64,
    /// The record over which what changes with time is averaged, s.
    pub record_s: f64,
    /// Where the record's length comes from.
    pub record_from: RecordFrom,
    /// Whether alignment and longest horizon exceed the record.
    pub extrapolated: bool,
    /// The horizons that were fitted jointly, s.
    pub horizons_s: Vec<f64>,
    /// The gyroscope's and the accelerometer's channels.
    pub channels: BTreeMap<Channel, ChannelParameters>,
    /// What a reader has to know, one sentence each.
    pub notes: Vec<String>,
}

/// The parameters of one channel of unit U; N in U/√Hz, K in U/√s, σ in U.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChannelParameters {
    /// The unit of the integrated error: `rad` or `m/s`.
    pub unit: &'static str,
    /// The root mean square of the real error at each horizon, in `unit`.
    pub real_sd: Vec<f64>,
    /// N and K from the Allan deviation, and what a filter predicts with them; absent if N is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub allan: Option<Prediction>,
    /// White noise and a random walk.
    pub white_and_walk: Pairs,
    /// White noise and a Gauss-Markov process.
    pub gauss_markov: Pairs,
    /// White noise alone, for programs that estimate no bias.
    pub white: Pairs,
    /// What each cause adds to N and K of the fitted pair.
    pub causes: Vec<Cause>,
    /// The inflation with its causes, in words.
    pub summary: String,
    /// The effects that had to be simulated.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub simulated: Vec<String>,
}

/// Both answers of one family of noise.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pairs {
    /// The parameters whose predicted covariance is closest to the real one.
    pub fit: Prediction,
    /// The closest ones whose predicted variance is at least the real one at every horizon of the range.
    pub cover: Prediction,
}

/// Parameters of a filter and what it predicts with them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Prediction {
    /// White noise, U/√Hz.
    #[serde(rename = "N")]
    pub n: f64,
    /// The random walk, U/√s.
    #[serde(rename = "K", skip_serializing_if = "Option::is_none")]
    pub k: Option<f64>,
    /// The root mean square of the Gauss-Markov process, U.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma: Option<f64>,
    /// The correlation time of the Gauss-Markov process, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tc_s: Option<f64>,
    /// Whether the correlation time is at an end of what the range can tell: at the long end the process is a random walk
    /// of σ√(2/Tc).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tc_at_end: Option<bool>,
    /// N over that of the Allan deviation, and K likewise; null if there is none.
    pub inflation: Inflation,
    /// The standard deviation that the filter predicts at each horizon, in the integral's unit.
    pub predicted_sd: Vec<f64>,
    /// The largest ratio of the real error to the predicted one, in standard deviations; null if the prediction is 0.
    pub worst_ratio: Option<f64>,
    /// The horizon of that ratio, s.
    pub worst_at_s: f64,
    /// The Kullback-Leibler divergence of the real integrated errors from the predicted ones, nats over all horizons; null if
    /// it is infinite.
    pub divergence: Option<f64>,
}

/// Ratios to the values of the Allan deviation.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Inflation {
    /// Of N.
    #[serde(rename = "N")]
    pub n: Option<f64>,
    /// Of K.
    #[serde(rename = "K")]
    pub k: Option<f64>,
}

/// What a cause adds to the fitted pair.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cause {
    /// The effect, with its frequency if it has one.
    pub cause: String,
    /// N and K of the fitted pair if the cause is gone and all others stay.
    pub without: [f64; 2],
    /// N and K of the fitted pair if of all causes beside N and K it is the only one.
    pub alone: [f64; 2],
}
