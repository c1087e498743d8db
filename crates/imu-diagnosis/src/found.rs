//! Found: the findings on a channel and in a record, and the effects that are attributed to channels from them.

use super::bands::Bands;
use super::declared::courses::Off;
use super::declared::measured::MeasuredLine;
use super::explanation::Explanation;
use super::facts::Repeats;
use super::gated::Stays;
use super::holdout::Scores;
use super::law::Fitted;
use super::modulated::Levels;
use super::omnibus::Statistic;
use super::prepare::Prepared;
use super::prices::Tails;
use super::report::Sense;
use super::shared::Shared;
use super::spread::Spread;
use super::steps::Step;
use super::tiles::Tiles;
use super::variances::Ratio;
use super::wandering::Wander;
use imu_core::sample::Channel;
use imu_model::effects::Effect;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Minimum rounding step that is named, as a part of the white noise's standard deviation.
pub(super) const MATERIAL_STEP: f64 = 0.03;

/// The findings on a channel.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Findings {
    pub(super) prepared: Prepared,
    pub(super) explanation: Explanation,
    pub(super) steps: Vec<Step>,
    /// The law with effects, without a prior on its levels.
    pub(super) fitted: Fitted,
    /// Nats lost if N, B or K is held at the model's value and all other numbers are fitted again.
    pub(super) held: [f64; 3],
    /// The frequencies at which the effects gain likelihood.
    pub(super) bands: Bands,
    /// The density that exceeds everything found: points in Hz and the series' scale squared per Hz.
    pub(super) nameless: Vec<(f64, f64)>,
    /// Bands whose level changes.
    pub(super) levels: Vec<Levels>,
    /// Bands that come and go.
    pub(super) stays: Vec<Stays>,
    /// Bands that are lines whose frequency wanders.
    pub(super) wanders: Vec<Wander>,
    /// The tiles of time and frequency in which the residual still differs from the law.
    pub(super) after: Tiles,
    pub(super) statistics: Vec<(Statistic, f64)>,
    pub(super) scores: Scores,
    /// ln of the density of all samples under the explanation, nats.
    pub(super) nats: f64,
    /// Standard deviation of the white part, U per sample.
    pub(super) white: f64,
    /// The record's mean without the explained part, U.
    pub(super) level: f64,
    /// The white part's variance in each of the explanation's stretches.
    pub(super) ratios: Vec<Ratio>,
    /// The white part's mean variance over its variance at times when nothing changes it.
    pub(super) average_variance: f64,
    /// The previous ratio over the ratio that the model states.
    pub(super) louder: f64,
    /// Standard errors of the explanation.
    pub(super) spread: Spread,
    /// The model's lines as the channel has them.
    pub(super) lines: Vec<MeasuredLine>,
    /// The model's drifts, steps and changes of variance that the channel has with other numbers.
    pub(super) off: Vec<Off>,
}

/// The findings in a record.
#[derive(Debug)]
pub(super) struct Found {
    pub(super) channels: Vec<Findings>,
    pub(super) shared: Vec<Shared>,
    pub(super) repeats: Vec<(Vec<Channel>, Repeats)>,
    pub(super) further: Vec<Channel>,
    pub(super) samples: usize,
    pub(super) tails: Tails,
    pub(super) temperature_c: f64,
}

/// An effect attributed to a channel, with its gain.
#[derive(Clone)]
pub(super) struct Attribution {
    pub(super) channel: Channel,
    pub(super) sense: Sense,
    /// The model's own effect, and its place in the list, if it has it.
    pub(super) declared: Option<(usize, Arc<dyn Effect>)>,
    /// The sensor's effect; if the sensor lacks it, the model's.
    pub(super) effect: Arc<dyn Effect>,
    pub(super) gain: f64,
    /// Chance that noise alone gains as much anywhere in the record.
    pub(super) p_value: f64,
    pub(super) confidence: f64,
    pub(super) evidence: Vec<String>,
    /// 95 % intervals of the effect's parameters.
    pub(super) ci95: Vec<(&'static str, [f64; 2])>,
}

impl Attribution {
    /// Creates an effect that the model lacks, as certain as effects that are read off values and stamps.
    pub(super) fn missing(channel: Channel, effect: Arc<dyn Effect>, gain: f64) -> Self {
        Self {
            channel,
            sense: Sense::Missing,
            declared: None,
            effect,
            gain,
            p_value: (-gain).exp().min(1.0),
            confidence: 0.99,
            evidence: Vec::new(),
            ci95: Vec::new(),
        }
    }
}
