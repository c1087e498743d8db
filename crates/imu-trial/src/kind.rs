//! Kinds: the effects that sealed cases have, those of the library and those outside it.

use serde::{Deserialize, Serialize};

/// The kinds with their names in keys, scores and on the command line.
macro_rules! kinds {
    ($($list:ident: $($kind:ident = $name:literal),+;)+) => {
        /// An effect that a sealed case has and its model lacks, or the other way round.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[expect(
            missing_docs,
            reason = "the names of docs/effects.md; the others are described where they are imposed"
        )]
        pub enum Kind {
            $($(#[serde(rename = $name)] $kind,)+)+
        }

        $(const $list: &[Kind] = &[$(Kind::$kind),+];)+

        impl Kind {
            /// The name in keys, scores and on the command line.
            pub fn name(self) -> &'static str {
                match self {
                    $($(Self::$kind => $name,)+)+
                }
            }
        }
    };
}

kinds! {
    LIBRARY:
        Resolution = "resolution",
        QuantizationNoise = "quantization_noise",
        RateRamp = "rate_ramp",
        GaussMarkov = "gauss_markov",
        Tone = "tone",
        Comb = "comb",
        Resonance = "resonance",
        TemperatureBias = "temperature_bias",
        WarmUp = "warm_up",
        Spikes = "spikes",
        HeavyTails = "heavy_tails",
        BiasStep = "bias_step",
        Bursts = "bursts",
        VarianceInterval = "variance_interval",
        VarianceProfile = "variance_profile",
        VariancePerC = "variance_per_c",
        LowPass = "low_pass",
        MovingAverage = "moving_average",
        Saturation = "saturation",
        HeldSamples = "held_samples",
        CommonMode = "common_mode",
        Timing = "timing";
    TUNED:
        RandomTelegraph = "random_telegraph",
        Chirp = "chirp",
        VibrationBursts = "vibration_bursts",
        Echo = "echo",
        PeriodicGain = "periodic_gain",
        Hysteresis = "hysteresis",
        FmLine = "fm_line",
        OddSlope = "odd_slope",
        SkewedNoise = "skewed_noise",
        ShotNoise = "shot_noise",
        DelayedCrosstalk = "delayed_crosstalk",
        DeadBand = "dead_band",
        BimodalNoise = "bimodal_noise",
        UniformNoise = "uniform_noise",
        FrequencyHops = "frequency_hops",
        PhaseWalk = "phase_walk",
        MovingResonance = "moving_resonance",
        VolatileNoise = "volatile_noise",
        ThreeLevels = "three_levels",
        RelaxingJumps = "relaxing_jumps",
        NeighbourMeans = "neighbour_means",
        RepeatedPattern = "repeated_pattern",
        MissingCodes = "missing_codes",
        MovingLimit = "moving_limit",
        RingDowns = "ring_downs",
        ThermalRate = "thermal_rate",
        StuckBit = "stuck_bit",
        ToneOnOff = "tone_on_off",
        ToneByTemperature = "tone_by_temperature",
        ClusteredSpikes = "clustered_spikes",
        WanderingClock = "wandering_clock";
    KEPT:
        SlewLimit = "slew_limit",
        AsymmetricGain = "asymmetric_gain",
        Compression = "compression",
        Notch = "notch",
        HighPass = "high_pass",
        AutoZero = "auto_zero",
        ThermalFringe = "thermal_fringe",
        TemperatureParabola = "temperature_parabola",
        CauchyPushes = "cauchy_pushes",
        JitteredPulses = "jittered_pulses",
        ProductCrosstalk = "product_crosstalk",
        FlippedRuns = "flipped_runs",
        HalfRateStretches = "half_rate_stretches",
        FilterSwitched = "filter_switched",
        RangeSwitch = "range_switch",
        DyingLine = "dying_line";
}

impl Kind {
    /// The kinds of the library: the stationary effects of docs/effects.md.
    pub const LIBRARY: &[Self] = LIBRARY;
    /// The kinds that no effect of section 5 describes, on which the diagnosis may be tuned.
    pub const TUNED: &[Self] = TUNED;
    /// Others like them that must not be used for tuning: they give the published figure.
    pub const KEPT: &[Self] = KEPT;

    /// Every kind.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::LIBRARY.iter().chain(Self::TUNED).chain(Self::KEPT).copied()
    }

    /// Whether it must not be used for tuning.
    pub fn is_kept(self) -> bool {
        Self::KEPT.contains(&self)
    }

    /// The kind of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::all().find(|kind| kind.name() == name)
    }

    /// The documented name of the effect; none outside the library.
    pub fn effect(self) -> Option<&'static str> {
        match self {
            Self::VarianceInterval | Self::VarianceProfile | Self::VariancePerC => Some("variance_change"),
            own => Self::LIBRARY.contains(&own).then(|| own.name()),
        }
    }

    /// Effects of docs/effects.md that describe a kind outside the library. A diagnosis that knows one of them and names it gives
    /// a valid answer.
    pub fn described(self) -> &'static [&'static str] {
        match self {
            Self::FmLine | Self::PhaseWalk | Self::ToneByTemperature => &["wandering_line"],
            Self::ToneOnOff => &["intermittent", "wandering_line"],
            Self::VibrationBursts => &["intermittent", "modulated_band"],
            Self::RingDowns => &["modulated_band", "intermittent"],
            Self::OddSlope => &["power_law", "spectrum"],
            Self::MovingResonance | Self::HighPass | Self::Notch => &["spectrum"],
            // Their laws are those of the parameters that section 8 adds.
            Self::Hysteresis | Self::ThermalRate | Self::TemperatureParabola => &["temperature_bias"],
            Self::ClusteredSpikes => &["spikes"],
            _ => &[],
        }
    }

    /// The parameters of an effect of [`Self::described`] without which it is the plain effect of section 5, and no answer.
    pub fn described_by(self) -> &'static [&'static str] {
        match self {
            Self::Hysteresis => &["play_c"],
            Self::ThermalRate => &["per_c_per_s"],
            Self::TemperatureParabola => &["per_c2"],
            Self::ClusteredSpikes => &["cluster"],
            _ => &[],
        }
    }

    /// Its place in the sensor's chain; of two effects the one with the lower place acts first.
    pub fn place(self) -> u8 {
        match self {
            Self::HeavyTails
            | Self::VarianceInterval
            | Self::VarianceProfile
            | Self::VariancePerC
            | Self::PeriodicGain
            | Self::SkewedNoise
            | Self::BimodalNoise
            | Self::UniformNoise
            | Self::VolatileNoise
            | Self::AsymmetricGain => 0,
            Self::LowPass
            | Self::MovingAverage
            | Self::Echo
            | Self::DelayedCrosstalk
            | Self::ProductCrosstalk
            | Self::Notch
            | Self::HighPass
            | Self::FilterSwitched => 2,
            Self::Saturation | Self::DeadBand | Self::MovingLimit | Self::SlewLimit | Self::Compression => 3,
            Self::Resolution | Self::MissingCodes | Self::StuckBit | Self::RangeSwitch => 4,
            Self::HeldSamples | Self::NeighbourMeans | Self::RepeatedPattern | Self::HalfRateStretches => 5,
            Self::Timing | Self::WanderingClock => 6,
            _ => 1,
        }
    }

    /// The effects that cannot be distinguished from it on one channel.
    pub fn like(self) -> &'static [&'static str] {
        match self {
            Self::Tone
            | Self::Comb
            | Self::Chirp
            | Self::FmLine
            | Self::FrequencyHops
            | Self::PhaseWalk
            | Self::ToneOnOff
            | Self::ToneByTemperature
            | Self::DyingLine
            | Self::JitteredPulses => &["tone", "comb", "wandering_line"],
            Self::Spikes
            | Self::HeavyTails
            | Self::SkewedNoise
            | Self::BimodalNoise
            | Self::UniformNoise
            | Self::AsymmetricGain
            | Self::ClusteredSpikes
            | Self::FlippedRuns => &["spikes", "heavy_tails"],
            Self::Bursts
            | Self::VarianceInterval
            | Self::VarianceProfile
            | Self::VariancePerC
            | Self::VibrationBursts
            | Self::RingDowns
            | Self::VolatileNoise
            | Self::ProductCrosstalk
            | Self::PeriodicGain => &["bursts", "variance_change", "intermittent", "modulated_band"],
            Self::LowPass | Self::MovingAverage | Self::SlewLimit | Self::FilterSwitched => {
                &["low_pass", "moving_average"]
            }
            Self::RateRamp
            | Self::WarmUp
            | Self::TemperatureBias
            | Self::Hysteresis
            | Self::ThermalRate
            | Self::ThermalFringe
            | Self::TemperatureParabola => &["rate_ramp", "warm_up", "temperature_bias"],
            Self::GaussMarkov
            | Self::RandomTelegraph
            | Self::ShotNoise
            | Self::OddSlope
            | Self::ThreeLevels
            | Self::AutoZero
            | Self::CauchyPushes
            | Self::HighPass => &["gauss_markov", "power_law"],
            Self::Resolution | Self::DeadBand | Self::MissingCodes | Self::StuckBit | Self::RangeSwitch => {
                &["resolution"]
            }
            Self::QuantizationNoise => &["quantization_noise"],
            Self::Resonance | Self::MovingResonance | Self::Notch => &["resonance"],
            Self::BiasStep | Self::RelaxingJumps => &["bias_step"],
            Self::Saturation | Self::MovingLimit | Self::Compression => &["saturation"],
            Self::HeldSamples | Self::NeighbourMeans | Self::RepeatedPattern | Self::HalfRateStretches => {
                &["held_samples"]
            }
            Self::CommonMode | Self::DelayedCrosstalk => &["common_mode"],
            Self::Timing | Self::WanderingClock => &["timing"],
            Self::Echo => &[],
        }
    }

    /// The least number of channels that it acts on.
    pub fn channels_min(self) -> usize {
        if matches!(self, Self::CommonMode) || self.has_source() { 2 } else { 1 }
    }

    /// Whether the first channel is heard on the others.
    pub fn has_source(self) -> bool {
        matches!(self, Self::DelayedCrosstalk | Self::ProductCrosstalk)
    }

    /// Whether it acts on stamps, so that the record has to have stamps.
    pub fn needs_stamps(self) -> bool {
        matches!(self, Self::Timing | Self::WanderingClock)
    }

    /// Whether it requires a measured temperature.
    pub fn needs_temperature(self) -> bool {
        matches!(
            self,
            Self::TemperatureBias
                | Self::VariancePerC
                | Self::Hysteresis
                | Self::ThermalRate
                | Self::ToneByTemperature
                | Self::ThermalFringe
                | Self::TemperatureParabola
        )
    }

    /// Whether it is the same all the time and has exactly the law of the documented parameters, so that a model can state it
    /// rightly. Steps that rise slowly, soft ends and limits that follow from the samples are not.
    pub fn can_be_known(self) -> bool {
        matches!(
            self,
            Self::Resolution
                | Self::QuantizationNoise
                | Self::RateRamp
                | Self::GaussMarkov
                | Self::Tone
                | Self::Comb
                | Self::Resonance
                | Self::TemperatureBias
                | Self::WarmUp
                | Self::HeavyTails
                | Self::VariancePerC
                | Self::LowPass
                | Self::MovingAverage
                | Self::HeldSamples
        )
    }

    /// Whether a model can have it at another size. The signs of shared noise are in no parameter.
    pub fn can_be_resized(self) -> bool {
        self.effect().is_some() && self != Self::CommonMode
    }

    /// Whether a model can have it at another frequency or time.
    pub fn can_be_elsewhere(self) -> bool {
        matches!(
            self,
            Self::Tone | Self::Comb | Self::Resonance | Self::BiasStep | Self::Bursts | Self::VarianceInterval
        )
    }

    /// Whether two kinds may be in one case: not if they are one effect, or nearly, nor if the one cuts the other off.
    pub fn goes_with(self, other: Self) -> bool {
        let both = |two: [Self; 2]| two.contains(&self) && two.contains(&other);
        self.effect() != other.effect() && !both([Self::Tone, Self::Comb]) && !both([Self::Spikes, Self::Saturation])
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
        for kind in Kind::all() {
            assert_eq!(Kind::from_name(kind.name()), Some(kind));
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.name());
        }
        assert!(Kind::LIBRARY.iter().all(|kind| kind.effect().is_some()));
        assert!(Kind::TUNED.iter().chain(Kind::KEPT).all(|kind| kind.effect().is_none()));
        for effect in imu_model::effects::registry::names(&imu_model::effects::registry::CHANNEL) {
            let has = |kind: Kind| kind.effect() == Some(effect) || kind.described().contains(&effect);
            assert!(Kind::all().any(has), "no case has {effect}");
        }
    }

    #[test]
    fn at_least_thirty_kinds_are_outside_and_some_of_them_are_kept() {
        assert!(Kind::TUNED.len() >= 30 && Kind::KEPT.len() >= 12);
        assert!(Kind::KEPT.iter().all(|kind| kind.is_kept() && !Kind::TUNED.contains(kind)));
        assert!(Kind::all().filter(|kind| kind.can_be_known()).all(Kind::can_be_resized));
    }
}
