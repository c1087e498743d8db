//! Prices: what chance makes of each effect's gain and of each omnibus statistic in records of noise alone.
//!
//! Tails are exponential: the chance of more than x nats is about exp(−(x − offset)/scale). Offsets were read off simulated
//! records (docs/validation.md); between the lengths of the table they go straight in ln of the samples.

use super::evidence::Kind;
use super::omnibus::Statistic;
use super::search::Prices;

/// Lengths of the table, samples.
const LENGTHS: [f64; 3] = [8193.0, 65_536.0, 720_000.0];

/// Kind, offsets at the lengths, scale.
const KINDS: [(Kind, [f64; 3], f64); 16] = [
    (Kind::RateRamp, [0.0, 0.0, 0.0], 1.0),
    (Kind::TemperatureBias, [0.0, 0.0, 0.0], 1.0),
    (Kind::WarmUp, [0.5, 0.5, 0.5], 1.0),
    (Kind::BiasStep, [5.0, 6.0, 6.5], 1.0),
    (Kind::Tone, [10.4, 12.4, 14.8], 1.0),
    (Kind::Resonance, [6.4, 7.3, 8.5], 1.0),
    (Kind::GaussMarkov, [0.5, 0.5, 0.5], 1.0),
    (Kind::QuantizationNoise, [-0.3, -0.3, -0.3], 1.0),
    (Kind::LowPass, [0.4, 0.4, 0.4], 1.0),
    (Kind::MovingAverage, [0.0, 0.0, 0.0], 1.0),
    (Kind::Spikes, [0.0, 0.0, 0.0], 1.0),
    (Kind::HeavyTails, [0.0, 0.0, 0.0], 1.0),
    (Kind::Bursts, [10.3, 12.3, 14.7], 1.0),
    (Kind::VarianceInterval, [10.3, 12.3, 14.7], 1.0),
    (Kind::VariancePerDegree, [0.0, 0.0, 0.0], 1.0),
    (Kind::VarianceProfile, [6.5, 6.5, 6.5], 1.3),
];

const STATISTICS: [(Statistic, [f64; 3], f64); 12] = [
    (Statistic::Kurtosis, [-0.5, -0.5, -0.5], 1.0),
    (Statistic::Skewness, [-0.5, -0.5, -0.5], 1.0),
    (Statistic::Tiles, [-0.5, -0.5, -0.5], 1.2),
    (Statistic::Tile, [4.5, 5.2, 5.6], 1.1),
    (Statistic::Octave, [2.0, 2.5, 3.0], 1.6),
    (Statistic::Stretch, [3.0, 3.5, 3.5], 1.6),
    (Statistic::OctaveKurtosis, [0.5, 0.5, 0.8], 1.1),
    (Statistic::Clusters, [2.0, 2.5, 2.5], 1.1),
    (Statistic::FineBand, [3.0, 5.0, 7.5], 1.1),
    (Statistic::FineBands, [-0.5, -0.5, -0.5], 1.2),
    (Statistic::Modulation, [8.3, 10.4, 12.8], 1.0),
    (Statistic::Echo, [7.5, 9.2, 9.4], 1.0),
];

fn between(offsets: [f64; 3], samples: usize) -> f64 {
    let x = (samples.max(2) as f64).ln();
    let at = usize::from(x > LENGTHS[1].ln());
    let (from, to) = (LENGTHS[at].ln(), LENGTHS[at + 1].ln());
    offsets[at] + (x - from) / (to - from) * (offsets[at + 1] - offsets[at])
}

/// For records of `samples` of which `channels` are looked at: by chance an effect is named in about a part `level` of them.
#[must_use]
pub fn of_effects(samples: usize, channels: usize, level: f64) -> Prices {
    let tails = KINDS.into_iter().map(|(kind, offsets, scale)| (kind, between(offsets, samples), scale)).collect();
    Prices { tails, level: level / (channels.max(1) * KINDS.len()) as f64 }
}

/// The chance that noise alone shows as much of a statistic in a record of `samples`; above 1 for what is usual.
#[must_use]
pub fn chance(statistic: Statistic, value: f64, samples: usize) -> f64 {
    let row = STATISTICS.into_iter().find(|(own, ..)| *own == statistic);
    row.map_or(1.0, |(_, offsets, scale)| (-(value - between(offsets, samples)) / scale).exp())
}
