//! Limits: sizes at which a feasibility study in Python named an effect in 90 % of its cases, and how they change with length.
//!
//! The study's cases had 65,536 samples (27 min at 40 Hz) and two channels. Sizes are in units of the white part's
//! standard deviation per sample, unless stated otherwise. With n samples, limits of effects on variances and of a
//! tone's amplitude fall as n^-½, and those of counts of single samples as 1/n. Limits of slow courses of the level
//! grow as n^½ beyond the study's length, as does the random walk that hides them.

use super::class::{Role, Sense};
use super::kind::Kind;

/// Samples of the study's cases: the length for which limits are given.
pub const STUDY: usize = 65_536;
/// Log-likelihood that a single burst has to gain, nats: twice the price of an interval at this length.
const BURST_NATS: f64 = 20.0;
/// The highest corner over the rate at which a low pass is always named; the study found no limit.
pub(super) const CORNER: f64 = 0.42;
/// If no limit is known, cases count as this multiple of it.
pub(super) const ABOVE: f64 = 1.5;

/// Returns the size of `kind` that is named in 90 % of the cases of `samples`.
///
/// | kind | size |
/// |---|---|
/// | resolution | step |
/// | quantization_noise, resonance, gauss_markov, bursts | standard deviation |
/// | rate_ramp | over the capture |
/// | tone, comb | amplitude; of the weakest harmonic |
/// | temperature_bias | per °C |
/// | warm_up, bias_step | amplitude |
/// | spikes, held_samples, timing | share of the samples |
/// | heavy_tails | 1/degrees of freedom |
/// | variance_… | log variance: rms over the record times √2; per standard deviation of the temperature |
/// | saturation | share of the samples at the limit |
/// | common_mode | share of each channel |
///
/// 1 for kinds without a limit: filters, and effects outside the library.
pub fn limit(kind: Kind, samples: usize) -> f64 {
    let longer = samples as f64 / STUDY as f64;
    let (variance, slow) = (longer.powf(-0.5), longer.max(1.0).sqrt());
    match kind {
        Kind::Resolution => 0.15,
        Kind::QuantizationNoise => 0.18 * variance.sqrt(),
        Kind::RateRamp => 2.4 * slow,
        Kind::GaussMarkov => 0.45,
        Kind::Tone | Kind::Comb => 0.06 * variance,
        Kind::Resonance => 0.11 * variance.sqrt(),
        Kind::TemperatureBias => 0.11 * slow,
        Kind::WarmUp => 1.1 * slow,
        Kind::Spikes => 5e-5 / longer,
        Kind::HeavyTails => variance / 55.0,
        Kind::BiasStep => 0.8,
        Kind::VarianceInterval | Kind::VarianceProfile => 0.06 * variance,
        Kind::VariancePerC => 0.028 * variance,
        Kind::HeldSamples | Kind::Timing => 1e-4 / longer,
        // Twenty ties at this length: a few would suffice, but the level wanders and the ties occur together.
        Kind::Saturation => 3e-4 * variance,
        Kind::CommonMode => 0.16 * variance.sqrt(),
        _ => 1.0,
    }
}

/// The largest ratio of the sizes on two channels.
pub(super) const UNEVEN: f64 = 1.25;
/// The coarsest step beside other effects, σ: a coarser one rounds them away.
const FINE: f64 = 1.5;
/// Minimum number of events that a model expects of spikes that the sensor lacks: the absence of a few is not evidence.
const EXPECTED: f64 = 12.0;

/// Returns the range of sizes over the limit from which an effect is drawn in cases of `samples`.
///
/// An effect among three or four starts from 1.5 times the limit, because a case counts only if all its effects are
/// above that. A bias that the model states correctly changes by at most 1 σ per °C, because the model reads the
/// temperature in steps of 0.1 °C.
pub fn range(kind: Kind, samples: usize, role: Role) -> [f64; 2] {
    let limit = limit(kind, samples);
    let least = match kind {
        Kind::Spikes if role.sense == Sense::Superfluous => EXPECTED / samples as f64 / limit,
        _ if role.of > 2 => ABOVE,
        _ => LEAST,
    };
    let largest = match kind {
        Kind::Resolution if role.of > 1 => FINE,
        Kind::TemperatureBias if role.sense == Sense::Known => 1.0,
        _ => f64::INFINITY,
    };
    [least, most(kind, samples).min(largest / UNEVEN / limit).max(2.0 * least)]
}

/// The multiple of the limit from which sizes start.
pub const LEAST: f64 = 0.5;
/// The multiple of the limit that sizes reach if no physical bound applies.
const MOST: f64 = 100.0;

/// Returns the multiple of the limit up to which sizes of `kind` reach in cases of `samples`: 100, or the physical
/// bound.
///
/// | kind | at most |
/// |---|---|
/// | resolution | steps of 6 σ: coarser ones leave one or two codes |
/// | heavy_tails | 2.5 degrees of freedom: the variance has to be finite |
/// | spikes, held_samples, saturation | a twentieth of the samples: more are no exception |
/// | timing | a jitter of a fifth of a period: stamps keep their order |
/// | variance_… | a factor of 50 on the amplitude; per standard deviation of the temperature 4.5 |
/// | bursts | 50 σ; the limit is a burst's own, so that this is kept where they are drawn |
///
/// In some cases a bias step may have 2,000 σ: an axis that is turned over.
pub fn most(kind: Kind, samples: usize) -> f64 {
    let physical = match kind {
        Kind::Resolution => 6.0 / UNEVEN,
        Kind::HeavyTails => 0.4,
        Kind::Spikes | Kind::HeldSamples | Kind::Saturation => 0.05,
        Kind::VarianceInterval | Kind::VarianceProfile => 2.0 * LOUDEST.ln(),
        Kind::VariancePerC => 3.0,
        // The jitter grows as a part of a period, for any length.
        Kind::Timing => 40.0 * limit(kind, samples),
        _ => f64::INFINITY,
    };
    (physical / limit(kind, samples)).clamp(2.0 * LEAST, MOST)
}

/// Largest factor on the amplitude of noise.
pub(super) const LOUDEST: f64 = 50.0;

/// Returns the size that counts as 1 in `over_limit` at the study's length, in [`unit`]: the study's 90 % limit if
/// there is one.
pub fn one(kind: Kind) -> f64 {
    match kind {
        // A window of 2 counts as the same multiple as the highest corner.
        Kind::MovingAverage => 2.0 / ABOVE,
        other => limit(other, STUDY),
    }
}

/// Returns the unit of the sizes, in words; σ is the white part's standard deviation per sample.
pub fn unit(kind: Kind) -> &'static str {
    match kind {
        Kind::Resolution => "step in σ",
        Kind::QuantizationNoise => "angle noise in σ",
        Kind::RateRamp => "over the record in σ",
        Kind::GaussMarkov | Kind::Resonance => "rms in σ",
        Kind::Tone => "amplitude in σ",
        Kind::Comb => "amplitude of the weakest harmonic in σ",
        Kind::TemperatureBias => "σ per °C",
        Kind::WarmUp | Kind::BiasStep => "size in σ",
        Kind::Spikes | Kind::HeldSamples | Kind::Timing | Kind::Saturation => "share of the samples",
        Kind::HeavyTails => "1/degrees of freedom",
        Kind::Bursts => "σ over that at which the shortest has 20 nats",
        Kind::VarianceInterval | Kind::VarianceProfile => "rms log variance × √2",
        Kind::VariancePerC => "log variance per standard deviation of the temperature",
        Kind::LowPass => "0.63 × rate over corner",
        Kind::MovingAverage => "samples",
        Kind::CommonMode => "share in σ",
        _ => "",
    }
}

/// Returns the standard deviation, in units of the white part's, at which a burst of `samples` samples is found.
pub fn burst_limit(samples: f64) -> f64 {
    let nats = |sigma: f64| 0.5 * samples * (sigma * sigma - (sigma * sigma).ln_1p());
    let (mut low, mut high) = (0.0, 100.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if nats(middle) < BURST_NATS { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_the_studys_at_its_length_and_fall_as_it_states() {
        assert_eq!(limit(Kind::Tone, 65_536), 0.06);
        assert!((limit(Kind::Tone, 4 * 65_536) - 0.03).abs() < 1e-12);
        // A resonance's power at 5 h: 0.3 of that at 27 min.
        let power = (limit(Kind::Resonance, 720_000) / limit(Kind::Resonance, 65_536)).powi(2);
        assert!((power - 0.3).abs() < 0.01, "{power}");
        assert_eq!(limit(Kind::RateRamp, 4 * 65_536), 4.8);
    }

    #[test]
    fn sizes_reach_a_hundred_times_the_limit_or_what_is_physical() {
        assert_eq!(most(Kind::Tone, 65_536), 100.0);
        assert!((most(Kind::Resolution, 65_536) - 32.0).abs() < 1e-9);
        assert!((most(Kind::HeavyTails, 65_536) * limit(Kind::HeavyTails, 65_536) - 0.4).abs() < 1e-12);
        for kind in Kind::all() {
            assert!((1.0..=100.0).contains(&most(kind, 10_000)), "{kind}");
        }
    }

    #[test]
    fn sizes_suit_what_an_effect_is_drawn_for() {
        let of = |kind, sense, of| range(kind, 65_536, Role { sense, of });
        assert_eq!(of(Kind::Tone, Sense::Missing, 2), [0.5, 100.0]);
        assert_eq!(of(Kind::Tone, Sense::Missing, 3), [1.5, 100.0]);
        assert!((of(Kind::Resolution, Sense::Missing, 2)[1] * 0.15 - 1.2).abs() < 1e-12);
        assert!((of(Kind::TemperatureBias, Sense::Known, 1)[1] * 0.11 - 0.8).abs() < 1e-12);
        assert!((of(Kind::Spikes, Sense::Superfluous, 1)[0] * 5e-5 * 65_536.0 - 12.0).abs() < 1e-9);
    }

    #[test]
    fn a_longer_burst_is_found_when_weaker() {
        let (short, long) = (burst_limit(20.0), burst_limit(2_000.0));
        assert!(long < short && (0.1..0.5).contains(&long) && (1.0..4.0).contains(&short), "{short} {long}");
    }
}
