//! Evidence: the gain of each effect for a series, in nats, with the noise fitted again beside it.

pub(super) mod declared;
pub(super) mod heavy_tails;
pub(super) mod leaps;
pub(super) mod level;
pub(super) mod line;
pub(super) mod loudness;
pub(super) mod outlier;
pub(super) mod peaks;
pub(super) mod spectral;

use super::explanation::Explanation;
use super::report::Sense;
use super::series::Series;
use super::tail::with_tails;
use imu_model::effects::EffectKind;

with_tails! {
    /// A kind of cause, as far as the search distinguishes them. Several kinds may be one effect of docs/formats.md.
    Kind;
    /// Returns the documented effect.
    effect -> EffectKind;
    /// A constant drift.
    RateRamp: EffectKind::RateRamp, [0.0, 0.0, 0.0], 1.0;
    /// The level follows the temperature.
    TemperatureBias: EffectKind::TemperatureBias, [0.0, 0.0, 0.0], 1.0;
    /// An exponential settling.
    WarmUp: EffectKind::WarmUp, [0.5, 0.5, 0.5], 1.0;
    /// Jumps of the level.
    BiasStep: EffectKind::BiasStep, [4.4, 5.6, 7.1], 1.0;
    /// A sine.
    Tone: EffectKind::Tone, [9.9, 12.0, 14.4], 1.05;
    /// A sine that comes and goes.
    Intermittent: EffectKind::Intermittent, [0.0, 0.0, 0.0], 1.0;
    /// A narrow band of noise.
    Resonance: EffectKind::Resonance, [6.2, 7.2, 8.0], 1.05;
    /// Exponentially correlated noise.
    GaussMarkov: EffectKind::GaussMarkov, [0.3, 0.5, 0.6], 1.0;
    /// White angle noise.
    QuantizationNoise: EffectKind::QuantizationNoise, [-0.3, -0.3, -0.3], 1.0;
    /// A Butterworth filter.
    LowPass: EffectKind::LowPass, [0.0, 0.0, 0.0], 1.15;
    /// A boxcar filter.
    MovingAverage: EffectKind::MovingAverage, [0.0, 0.0, 0.0], 1.0;
    /// Rare outliers.
    Spikes: EffectKind::Spikes, [0.0, 0.0, 0.0], 1.0;
    /// Student's t.
    HeavyTails: EffectKind::HeavyTails, [0.0, 0.0, 0.0], 1.0;
    /// Stretches of extra noise.
    Bursts: EffectKind::Bursts, [8.0, 10.3, 12.4], 1.2;
    /// One stretch of another variance.
    VarianceInterval: EffectKind::VarianceChange, [8.0, 10.3, 12.4], 1.2;
    /// Variance by temperature.
    VariancePerDegree: EffectKind::VarianceChange, [0.0, 0.0, 0.0], 1.0;
    /// Variance over time.
    VarianceProfile: EffectKind::VarianceChange, [6.9, 6.9, 6.9], 1.35;
    /// The level follows the temperature with play, its square, or its rate.
    TemperatureCurve: EffectKind::TemperatureBias, [0.3, 0.5, 0.6], 1.0;
    /// A density as another power of the frequency.
    Slope: EffectKind::PowerLaw, [0.0, 0.2, 0.4], 1.0;
}

impl Kind {
    /// Returns whether the kind determines the distribution of single samples, so that its remainder is no further
    /// evidence.
    pub fn is_marginal(self) -> bool {
        matches!(self, Self::Spikes | Self::HeavyTails | Self::Bursts)
    }

    /// Returns whether the kind shapes the spectrum.
    pub fn is_spectral(self) -> bool {
        use Kind::{GaussMarkov, LowPass, MovingAverage, QuantizationNoise, Resonance, Slope};
        matches!(self, GaussMarkov | QuantizationNoise | LowPass | MovingAverage | Resonance | Slope)
    }

    /// Returns whether a series may have several effects of this kind.
    pub fn repeats(self) -> bool {
        matches!(self, Self::Tone | Self::Intermittent | Self::Resonance)
    }
}

/// An effect that may explain more.
#[derive(Debug, Clone)]
pub struct Candidate {
    /// Its kind.
    pub kind: Kind,
    /// Nats gained over the explanation without it.
    pub gain: f64,
    /// The explanation with the effect.
    pub explanation: Explanation,
    /// The model's own effect that this candidate changes, by its place in the list, and how; none for an effect that
    /// the model lacks.
    pub of_model: Option<(usize, Sense)>,
}

impl Candidate {
    /// Returns a candidate of an effect that the model lacks.
    pub fn missing(kind: Kind, gain: f64, explanation: Explanation) -> Self {
        Self { kind, gain, explanation, of_model: None }
    }
}

/// Returns the candidates of [`all`], and those of effects that are searched only beside another one, as if that one
/// had been found.
pub(super) fn all_and_conditional(series: &mut Series<'_>) -> Vec<Candidate> {
    let mut found = all(series);
    found.extend(level::curve_alone(series));
    found
}

/// Returns the gain of each effect that is a term of the law.
pub(super) fn of_spectrum(series: &Series<'_>) -> Vec<Candidate> {
    let others = [spectral::gauss_markov(series), spectral::quantization_noise(series), spectral::slope(series)];
    line::resonance(series).into_iter().chain(others.into_iter().flatten()).chain(filters(series)).collect()
}

/// Returns the gain of each kind of filter.
pub(super) fn filters(series: &Series<'_>) -> Vec<Candidate> {
    let low_pass = spectral::low_pass(series);
    // If no filter of any order gains, none of another shape does.
    let hopeless = low_pass.as_ref().is_some_and(|candidate| candidate.gain < spectral::HOPELESS);
    let moving_average = if hopeless { None } else { spectral::moving_average(series) };
    low_pass.into_iter().chain(moving_average).collect()
}

/// Returns the gain of each effect of the library for a series.
pub fn all(series: &mut Series<'_>) -> Vec<Candidate> {
    let mut found = Vec::new();
    found.extend(level::ramp(series));
    found.extend(level::temperature(series));
    found.extend(level::warm_up(series));
    found.extend(level::curve(series));
    found.extend(level::steps(series));
    let (tone, gated) = line::sines(series);
    found.extend(tone);
    found.extend(line::resonance(series).filter(|of| !gated.iter().any(|sine| line::is_foot(series, of, sine))));
    found.extend(gated);
    found.extend(spectral::gauss_markov(series));
    found.extend(spectral::quantization_noise(series));
    found.extend(filters(series));
    found.extend(spectral::slope(series));
    found.extend(of_squares(series));
    found
}

/// Collects the effects that show in the residual's squares: outliers, tails, stretches, and variance by temperature or
/// time. A band that comes and goes would look like any of them.
pub fn of_squares(series: &Series<'_>) -> Vec<Candidate> {
    let evened = series.whitened_by_time();
    let series = evened.as_ref().unwrap_or(series);
    samples_and_stretches(series).chain(loudness::per_degree(series)).chain(loudness::profile(series)).collect()
}

fn samples_and_stretches(series: &Series<'_>) -> impl Iterator<Item = Candidate> {
    let single = outlier::spikes(series).into_iter().chain(heavy_tails::heavy_tails(series));
    single.chain(loudness::intervals(series))
}

/// Returns the effects that concern the distribution of single samples ([`Kind::is_marginal`]).
pub fn of_samples(series: &Series<'_>) -> Vec<Candidate> {
    let evened = series.whitened_by_time();
    let series = evened.as_ref().unwrap_or(series);
    samples_and_stretches(series).filter(|candidate| candidate.kind.is_marginal()).collect()
}
