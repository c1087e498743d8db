//! Kinds: the effects that sealed cases have, those of the library and those outside it.

use serde::{Deserialize, Serialize};

/// What a sealed case has that its model lacks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[expect(
    missing_docs,
    reason = "the names of the contract's section 5; the others are described where they are imposed"
)]
#[expect(clippy::exhaustive_enums, reason = "a new kind has to be imposed, sized and judged")]
pub enum Kind {
    Resolution,
    QuantizationNoise,
    RateRamp,
    GaussMarkov,
    Tone,
    Comb,
    Resonance,
    TemperatureBias,
    WarmUp,
    Spikes,
    HeavyTails,
    BiasStep,
    Bursts,
    VarianceInterval,
    VarianceProfile,
    VariancePerC,
    LowPass,
    MovingAverage,
    Saturation,
    HeldSamples,
    CommonMode,
    Timing,
    RandomTelegraph,
    Chirp,
    VibrationBursts,
    Echo,
    PeriodicGain,
    Hysteresis,
    FmLine,
    OddSlope,
    SkewedNoise,
    ShotNoise,
    DelayedCrosstalk,
    DeadBand,
}

/// What a case is a test of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[expect(clippy::exhaustive_enums, reason = "each is counted in its own way")]
pub enum Class {
    /// Nothing but wrong parameters.
    None,
    /// One effect of the library.
    Single,
    /// Two effects of the library.
    Pair,
    /// One effect that the library does not have.
    Outside,
}

impl Class {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::None, Self::Single, Self::Pair, Self::Outside];

    /// The word for it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Single => "single",
            Self::Pair => "pair",
            Self::Outside => "outside",
        }
    }

    /// Of a case with these kinds.
    #[must_use]
    pub fn of(kinds: &[Kind]) -> Self {
        match kinds {
            [] => Self::None,
            [one] if one.effect().is_none() => Self::Outside,
            [_] => Self::Single,
            _ => Self::Pair,
        }
    }
}

impl Kind {
    /// Those of the library: the stationary effects of the contract's section 5.
    pub const LIBRARY: [Self; 22] = [
        Self::Resolution,
        Self::QuantizationNoise,
        Self::RateRamp,
        Self::GaussMarkov,
        Self::Tone,
        Self::Comb,
        Self::Resonance,
        Self::TemperatureBias,
        Self::WarmUp,
        Self::Spikes,
        Self::HeavyTails,
        Self::BiasStep,
        Self::Bursts,
        Self::VarianceInterval,
        Self::VarianceProfile,
        Self::VariancePerC,
        Self::LowPass,
        Self::MovingAverage,
        Self::Saturation,
        Self::HeldSamples,
        Self::CommonMode,
        Self::Timing,
    ];
    /// Those that no effect of the library describes.
    pub const OUTSIDE: [Self; 12] = [
        Self::RandomTelegraph,
        Self::Chirp,
        Self::VibrationBursts,
        Self::Echo,
        Self::PeriodicGain,
        Self::Hysteresis,
        Self::FmLine,
        Self::OddSlope,
        Self::SkewedNoise,
        Self::ShotNoise,
        Self::DelayedCrosstalk,
        Self::DeadBand,
    ];

    /// The name in keys, scores and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::VarianceInterval => "variance_interval",
            Self::VarianceProfile => "variance_profile",
            Self::VariancePerC => "variance_per_c",
            Self::RandomTelegraph => "random_telegraph",
            Self::Chirp => "chirp",
            Self::VibrationBursts => "vibration_bursts",
            Self::Echo => "echo",
            Self::PeriodicGain => "periodic_gain",
            Self::Hysteresis => "hysteresis",
            Self::FmLine => "fm_line",
            Self::OddSlope => "odd_slope",
            Self::SkewedNoise => "skewed_noise",
            Self::ShotNoise => "shot_noise",
            Self::DelayedCrosstalk => "delayed_crosstalk",
            Self::DeadBand => "dead_band",
            inside => inside.effect().unwrap_or_default(),
        }
    }

    /// The kind of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::LIBRARY.into_iter().chain(Self::OUTSIDE).find(|kind| kind.name() == name)
    }

    /// The contract's name of the effect; none for what is outside the library.
    #[must_use]
    pub fn effect(self) -> Option<&'static str> {
        Some(match self {
            Self::Resolution => "resolution",
            Self::QuantizationNoise => "quantization_noise",
            Self::RateRamp => "rate_ramp",
            Self::GaussMarkov => "gauss_markov",
            Self::Tone => "tone",
            Self::Comb => "comb",
            Self::Resonance => "resonance",
            Self::TemperatureBias => "temperature_bias",
            Self::WarmUp => "warm_up",
            Self::Spikes => "spikes",
            Self::HeavyTails => "heavy_tails",
            Self::BiasStep => "bias_step",
            Self::Bursts => "bursts",
            Self::VarianceInterval | Self::VarianceProfile | Self::VariancePerC => "variance_change",
            Self::LowPass => "low_pass",
            Self::MovingAverage => "moving_average",
            Self::Saturation => "saturation",
            Self::HeldSamples => "held_samples",
            Self::CommonMode => "common_mode",
            Self::Timing => "timing",
            _ => return None,
        })
    }

    /// Its place in the sensor's chain; of two effects the one with the lower place acts first.
    #[must_use]
    pub fn place(self) -> u8 {
        match self {
            Self::HeavyTails
            | Self::VarianceInterval
            | Self::VarianceProfile
            | Self::VariancePerC
            | Self::PeriodicGain
            | Self::SkewedNoise => 0,
            Self::LowPass | Self::MovingAverage | Self::Echo | Self::DelayedCrosstalk => 2,
            Self::Saturation | Self::DeadBand => 3,
            Self::Resolution => 4,
            Self::HeldSamples => 5,
            Self::Timing => 6,
            _ => 1,
        }
    }

    /// The effects of which nobody could tell it apart on one channel.
    #[must_use]
    pub fn like(self) -> &'static [&'static str] {
        match self {
            Self::Tone | Self::Comb | Self::Chirp | Self::FmLine => &["tone", "comb"],
            Self::Spikes | Self::HeavyTails | Self::SkewedNoise => &["spikes", "heavy_tails"],
            Self::Bursts
            | Self::VarianceInterval
            | Self::VarianceProfile
            | Self::VariancePerC
            | Self::VibrationBursts
            | Self::PeriodicGain => &["bursts", "variance_change"],
            Self::LowPass | Self::MovingAverage => &["low_pass", "moving_average"],
            Self::RateRamp | Self::WarmUp | Self::TemperatureBias | Self::Hysteresis => {
                &["rate_ramp", "warm_up", "temperature_bias"]
            }
            Self::GaussMarkov | Self::RandomTelegraph | Self::ShotNoise | Self::OddSlope => &["gauss_markov"],
            Self::Resolution | Self::DeadBand => &["resolution"],
            Self::QuantizationNoise => &["quantization_noise"],
            Self::Resonance => &["resonance"],
            Self::BiasStep => &["bias_step"],
            Self::Saturation => &["saturation"],
            Self::HeldSamples => &["held_samples"],
            Self::CommonMode | Self::DelayedCrosstalk => &["common_mode"],
            Self::Timing => &["timing"],
            Self::Echo => &[],
        }
    }

    /// Channels that it takes at least.
    #[must_use]
    pub fn channels_min(self) -> usize {
        if matches!(self, Self::CommonMode | Self::DelayedCrosstalk) { 2 } else { 1 }
    }

    /// Whether it cannot be without a measured temperature.
    #[must_use]
    pub fn needs_temperature(self) -> bool {
        matches!(self, Self::TemperatureBias | Self::VariancePerC | Self::Hysteresis)
    }

    /// Whether two kinds may be in one case: not where they are one effect, or nearly.
    #[must_use]
    pub fn goes_with(self, other: Self) -> bool {
        let lines = [Self::Tone, Self::Comb];
        self.effect() != other.effect() && !(lines.contains(&self) && lines.contains(&other))
    }
}

impl std::fmt::Display for Kind {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_is_found_by_its_name_and_every_effect_is_in_the_library() {
        for kind in Kind::LIBRARY.into_iter().chain(Kind::OUTSIDE) {
            assert_eq!(Kind::from_name(kind.name()), Some(kind));
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.name());
        }
        assert!(Kind::LIBRARY.iter().all(|kind| kind.effect().is_some()));
        assert!(Kind::OUTSIDE.iter().all(|kind| kind.effect().is_none()));
        for effect in crate::effects::registry::names(&crate::effects::registry::CHANNEL) {
            assert!(Kind::LIBRARY.iter().any(|kind| kind.effect() == Some(effect)), "no case has {effect}");
        }
    }

    #[test]
    fn a_case_is_of_one_class() {
        assert_eq!(Class::of(&[]), Class::None);
        assert_eq!(Class::of(&[Kind::Tone]), Class::Single);
        assert_eq!(Class::of(&[Kind::Echo]), Class::Outside);
        assert_eq!(Class::of(&[Kind::Tone, Kind::Spikes]), Class::Pair);
    }
}
