//! Evidence: the gain of each effect for a series, in nats, with the noise fitted again beside it.

pub mod declared;
pub mod leaps;
pub mod level;
pub mod line;
pub mod loudness;
pub mod outlier;
pub mod peaks;
pub mod spectral;

use super::explanation::Explanation;
use super::report::Sense;
use super::series::Series;
use serde::{Deserialize, Serialize};

/// A kind of cause, as far as the search distinguishes them. Several kinds may be one effect of docs/formats.md.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
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
    /// The level follows the temperature with play, its square, or its rate.
    TemperatureCurve,
    /// A density as another power of the frequency.
    Slope,
}

impl Kind {
    /// All.
    pub const ALL: [Self; 18] = [
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
        Self::TemperatureCurve,
        Self::Slope,
    ];

    /// The documented effect.
    pub fn effect(self) -> &'static str {
        match self {
            Self::RateRamp => "rate_ramp",
            Self::TemperatureBias | Self::TemperatureCurve => "temperature_bias",
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
            Self::Slope => "power_law",
        }
    }
}

impl Kind {
    /// Whether the kind determines the distribution of single samples, so that what remains of it is no further
    /// evidence.
    pub fn is_marginal(self) -> bool {
        matches!(self, Self::Spikes | Self::HeavyTails | Self::Bursts)
    }

    /// Whether a series may have several effects of this kind.
    pub fn repeats(self) -> bool {
        matches!(self, Self::Tone | Self::Resonance)
    }

    /// Whether it happens at its own time and is not a property that a later record would also have.
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
    /// Which of the model's own effects it changes, by its place in the list, and how; none for an effect that the
    /// model lacks.
    pub of_model: Option<(usize, Sense)>,
}

impl Candidate {
    /// A candidate of an effect that the model lacks.
    pub fn missing(kind: Kind, gain: f64, explanation: Explanation) -> Self {
        Self { kind, gain, explanation, of_model: None }
    }
}

/// The same, including effects that are searched only beside another one, as if that one had been found.
pub(super) fn all_and_conditional(series: &mut Series<'_>) -> Vec<Candidate> {
    let mut found = all(series);
    found.extend(level::curve_alone(series));
    found
}

/// The gain of each effect of the library for a series.
pub fn all(series: &mut Series<'_>) -> Vec<Candidate> {
    let mut found = Vec::new();
    found.extend(level::ramp(series));
    found.extend(level::temperature(series));
    found.extend(level::warm_up(series));
    found.extend(level::curve(series));
    found.extend(level::steps(series));
    found.extend(line::tone(series));
    found.extend(line::resonance(series));
    found.extend(spectral::gauss_markov(series));
    found.extend(spectral::quantization_noise(series));
    let low_pass = spectral::low_pass(series);
    // If no filter of any order gains, none of another shape does.
    let hopeless = low_pass.as_ref().is_some_and(|candidate| candidate.gain < spectral::HOPELESS);
    found.extend(low_pass);
    if !hopeless {
        found.extend(spectral::moving_average(series));
    }
    found.extend(spectral::slope(series));
    found.extend(of_squares(series));
    found
}

/// Collects the effects that show in the residual's squares: outliers, tails, stretches, and variance by temperature or
/// time.
pub fn of_squares(series: &Series<'_>) -> Vec<Candidate> {
    samples_and_stretches(series).chain(loudness::per_degree(series)).chain(loudness::profile(series)).collect()
}

fn samples_and_stretches(series: &Series<'_>) -> impl Iterator<Item = Candidate> {
    let single = outlier::spikes(series).into_iter().chain(outlier::heavy_tails(series));
    single.chain(loudness::intervals(series))
}

/// Those that concern the distribution of single samples ([`Kind::is_marginal`]).
pub fn of_samples(series: &Series<'_>) -> Vec<Candidate> {
    samples_and_stretches(series).filter(|candidate| candidate.kind.is_marginal()).collect()
}
