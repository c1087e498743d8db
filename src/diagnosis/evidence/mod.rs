//! Evidence: what each effect would explain of a series, in nats, the noise fitted anew beside it.

pub mod level;
pub mod line;
pub mod loudness;
pub mod outlier;
pub mod spectral;

use super::series::{Explanation, Series};

/// A kind of cause, as far as the search tells them apart; several kinds may be one effect of the contract.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// A constant drift.
    RateRamp,
    /// The level follows the temperature.
    TemperatureBias,
    /// An exponential settling.
    WarmUp,
    /// Jumps of the level.
    BiasStep,
    /// A sine.
    Tone,
    /// A narrow band of noise.
    Resonance,
    /// Exponentially correlated noise.
    GaussMarkov,
    /// White angle noise.
    QuantizationNoise,
    /// A Butterworth filter.
    LowPass,
    /// A boxcar filter.
    MovingAverage,
    /// Rare outliers.
    Spikes,
    /// Student's t.
    HeavyTails,
    /// Stretches of extra noise.
    Bursts,
    /// One stretch of another variance.
    VarianceInterval,
    /// Variance by temperature.
    VariancePerDegree,
    /// Variance over time.
    VarianceProfile,
}

impl Kind {
    /// All.
    pub const ALL: [Self; 16] = [
        Self::RateRamp,
        Self::TemperatureBias,
        Self::WarmUp,
        Self::BiasStep,
        Self::Tone,
        Self::Resonance,
        Self::GaussMarkov,
        Self::QuantizationNoise,
        Self::LowPass,
        Self::MovingAverage,
        Self::Spikes,
        Self::HeavyTails,
        Self::Bursts,
        Self::VarianceInterval,
        Self::VariancePerDegree,
        Self::VarianceProfile,
    ];

    /// The contract's effect.
    #[must_use]
    pub fn effect(self) -> &'static str {
        match self {
            Self::RateRamp => "rate_ramp",
            Self::TemperatureBias => "temperature_bias",
            Self::WarmUp => "warm_up",
            Self::BiasStep => "bias_step",
            Self::Tone => "tone",
            Self::Resonance => "resonance",
            Self::GaussMarkov => "gauss_markov",
            Self::QuantizationNoise => "quantization_noise",
            Self::LowPass => "low_pass",
            Self::MovingAverage => "moving_average",
            Self::Spikes => "spikes",
            Self::HeavyTails => "heavy_tails",
            Self::Bursts => "bursts",
            Self::VarianceInterval | Self::VariancePerDegree | Self::VarianceProfile => "variance_change",
        }
    }
}

impl Kind {
    /// Whether the samples' own distribution is the kind's matter, so that what remains of it says nothing else.
    #[must_use]
    pub fn is_marginal(self) -> bool {
        matches!(self, Self::Spikes | Self::HeavyTails | Self::Bursts)
    }

    /// Whether there may be several of it.
    #[must_use]
    pub fn repeats(self) -> bool {
        matches!(self, Self::Tone | Self::Resonance)
    }

    /// Whether it happens at its time and is no property that a later record has as well.
    #[must_use]
    pub fn is_transient(self) -> bool {
        matches!(self, Self::BiasStep | Self::WarmUp | Self::Bursts | Self::VarianceInterval | Self::VarianceProfile)
    }
}

/// An effect that may explain more.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// Its kind.
    pub kind: Kind,
    /// Nats more than without it.
    pub gain: f64,
    /// The explanation with it.
    pub explanation: Explanation,
}

/// What each effect of the library would give a series.
#[must_use]
pub fn all(series: &mut Series<'_>) -> Vec<Candidate> {
    let mut found = Vec::new();
    found.extend(level::ramp(series));
    found.extend(level::temperature(series));
    found.extend(level::warm_up(series));
    found.extend(level::steps(series));
    found.extend(line::tone(series));
    found.extend(line::resonance(series));
    found.extend(spectral::gauss_markov(series));
    found.extend(spectral::quantization_noise(series));
    found.extend(spectral::low_pass(series));
    found.extend(spectral::moving_average(series));
    found.extend(outlier::spikes(series));
    found.extend(outlier::heavy_tails(series));
    found.extend(loudness::intervals(series));
    found.extend(loudness::per_degree(series));
    found.extend(loudness::profile(series));
    found
}
