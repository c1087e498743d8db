//! Kinds: the effects that sealed cases have, those of the library and those outside it.

use imu_model::EffectKind;

/// Defines lists of kinds with their names in keys, scores and on the command line; `row` has the other properties of
/// each kind.
macro_rules! kinds {
    (
        $(#[$meta:meta])*
        row: $row:ty;
        $($(#[$about:meta])* $list:ident: $($kind:ident = $name:literal => $value:expr),+;)+
    ) => {
        $(#[$meta])*
        #[derive(
            Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize,
        )]
        pub enum Kind {
            $($(#[doc = $name] #[serde(rename = $name)] $kind,)+)+
        }

        impl Kind {
            $($(#[$about])* pub const $list: &[Self] = &[$(Self::$kind),+];)+

            /// Returns every kind.
            pub fn all() -> impl Iterator<Item = Self> {
                [$(Self::$list),+].into_iter().flatten().copied()
            }

            /// Returns the name in keys, scores and on the command line.
            pub fn name(self) -> &'static str {
                match self {
                    $($(Self::$kind => $name,)+)+
                }
            }

            /// Returns the kind of that name.
            pub fn from_name(name: &str) -> Option<Self> {
                Self::all().find(|kind| kind.name() == name)
            }

            fn row(self) -> $row {
                match self {
                    $($(Self::$kind => $value,)+)+
                }
            }
        }

        impl std::fmt::Display for Kind {
            fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                formatter.write_str(self.name())
            }
        }
    };
}
pub(crate) use kinds;

/// The effects that cannot be distinguished from each other on one channel.
mod alike {
    use imu_model::EffectKind::{self, *};
    pub const LINES: &[EffectKind] = &[Tone, Comb, WanderingLine];
    pub const TAILS: &[EffectKind] = &[Spikes, HeavyTails];
    pub const LOUD: &[EffectKind] = &[Bursts, VarianceChange, Intermittent, ModulatedBand];
    pub const FILTERS: &[EffectKind] = &[LowPass, MovingAverage];
    pub const DRIFTS: &[EffectKind] = &[RateRamp, WarmUp, TemperatureBias];
    pub const SLOW: &[EffectKind] = &[GaussMarkov, PowerLaw];
    pub const ROUNDED: &[EffectKind] = &[Resolution];
    pub const ANGLE: &[EffectKind] = &[QuantizationNoise];
    pub const BANDS: &[EffectKind] = &[Resonance];
    pub const STEPS: &[EffectKind] = &[BiasStep];
    pub const LIMITS: &[EffectKind] = &[Saturation];
    pub const REPEATS: &[EffectKind] = &[HeldSamples];
    pub const SHARED: &[EffectKind] = &[CommonMode];
    pub const STAMPS: &[EffectKind] = &[Timing];
    pub const NOTHING: &[EffectKind] = &[];
}

kinds! {
    /// An effect that a sealed case has and its model lacks, or the reverse. Effects outside the library are described
    /// where they are imposed. A row has the place in the sensor's chain, and the effects that look alike.
    row: (u8, &'static [EffectKind]);
    /// The kinds of the library: the stationary effects of docs/effects.md.
    LIBRARY:
        Resolution = "resolution" => (4, alike::ROUNDED),
        QuantizationNoise = "quantization_noise" => (1, alike::ANGLE),
        RateRamp = "rate_ramp" => (1, alike::DRIFTS),
        GaussMarkov = "gauss_markov" => (1, alike::SLOW),
        Tone = "tone" => (1, alike::LINES),
        Comb = "comb" => (1, alike::LINES),
        Resonance = "resonance" => (1, alike::BANDS),
        TemperatureBias = "temperature_bias" => (1, alike::DRIFTS),
        WarmUp = "warm_up" => (1, alike::DRIFTS),
        Spikes = "spikes" => (1, alike::TAILS),
        HeavyTails = "heavy_tails" => (0, alike::TAILS),
        BiasStep = "bias_step" => (1, alike::STEPS),
        Bursts = "bursts" => (1, alike::LOUD),
        VarianceInterval = "variance_interval" => (0, alike::LOUD),
        VarianceProfile = "variance_profile" => (0, alike::LOUD),
        VariancePerC = "variance_per_c" => (0, alike::LOUD),
        LowPass = "low_pass" => (2, alike::FILTERS),
        MovingAverage = "moving_average" => (2, alike::FILTERS),
        Saturation = "saturation" => (3, alike::LIMITS),
        HeldSamples = "held_samples" => (5, alike::REPEATS),
        CommonMode = "common_mode" => (1, alike::SHARED),
        Timing = "timing" => (6, alike::STAMPS);
    /// Kinds that no effect of section 5 describes, on which the diagnosis may be tuned.
    TUNED:
        RandomTelegraph = "random_telegraph" => (1, alike::SLOW),
        Chirp = "chirp" => (1, alike::LINES),
        VibrationBursts = "vibration_bursts" => (1, alike::LOUD),
        Echo = "echo" => (2, alike::NOTHING),
        PeriodicGain = "periodic_gain" => (0, alike::LOUD),
        Hysteresis = "hysteresis" => (1, alike::DRIFTS),
        FmLine = "fm_line" => (1, alike::LINES),
        OddSlope = "odd_slope" => (1, alike::SLOW),
        SkewedNoise = "skewed_noise" => (0, alike::TAILS),
        ShotNoise = "shot_noise" => (1, alike::SLOW),
        DelayedCrosstalk = "delayed_crosstalk" => (2, alike::SHARED),
        DeadBand = "dead_band" => (3, alike::ROUNDED),
        BimodalNoise = "bimodal_noise" => (0, alike::TAILS),
        UniformNoise = "uniform_noise" => (0, alike::TAILS),
        FrequencyHops = "frequency_hops" => (1, alike::LINES),
        PhaseWalk = "phase_walk" => (1, alike::LINES),
        MovingResonance = "moving_resonance" => (1, alike::BANDS),
        VolatileNoise = "volatile_noise" => (0, alike::LOUD),
        ThreeLevels = "three_levels" => (1, alike::SLOW),
        RelaxingJumps = "relaxing_jumps" => (1, alike::STEPS),
        NeighbourMeans = "neighbour_means" => (5, alike::REPEATS),
        RepeatedPattern = "repeated_pattern" => (5, alike::REPEATS),
        MissingCodes = "missing_codes" => (4, alike::ROUNDED),
        MovingLimit = "moving_limit" => (3, alike::LIMITS),
        RingDowns = "ring_downs" => (1, alike::LOUD),
        ThermalRate = "thermal_rate" => (1, alike::DRIFTS),
        StuckBit = "stuck_bit" => (4, alike::ROUNDED),
        ToneOnOff = "tone_on_off" => (1, alike::LINES),
        ToneByTemperature = "tone_by_temperature" => (1, alike::LINES),
        ClusteredSpikes = "clustered_spikes" => (1, alike::TAILS),
        WanderingClock = "wandering_clock" => (6, alike::STAMPS);
    /// Similar kinds that must not be used for tuning, because they give the published figure.
    KEPT:
        SlewLimit = "slew_limit" => (3, alike::FILTERS),
        AsymmetricGain = "asymmetric_gain" => (0, alike::TAILS),
        Compression = "compression" => (3, alike::LIMITS),
        Notch = "notch" => (2, alike::BANDS),
        HighPass = "high_pass" => (2, alike::SLOW),
        AutoZero = "auto_zero" => (1, alike::SLOW),
        ThermalFringe = "thermal_fringe" => (1, alike::DRIFTS),
        TemperatureParabola = "temperature_parabola" => (1, alike::DRIFTS),
        CauchyPushes = "cauchy_pushes" => (1, alike::SLOW),
        JitteredPulses = "jittered_pulses" => (1, alike::LINES),
        ProductCrosstalk = "product_crosstalk" => (2, alike::LOUD),
        FlippedRuns = "flipped_runs" => (1, alike::TAILS),
        HalfRateStretches = "half_rate_stretches" => (5, alike::REPEATS),
        FilterSwitched = "filter_switched" => (2, alike::FILTERS),
        RangeSwitch = "range_switch" => (4, alike::ROUNDED),
        DyingLine = "dying_line" => (1, alike::LINES);
}

impl Kind {
    /// Returns whether the kind must not be used for tuning.
    pub fn is_kept(self) -> bool {
        Self::KEPT.contains(&self)
    }

    /// Returns the documented effect; `None` outside the library.
    pub fn effect(self) -> Option<EffectKind> {
        match self {
            Self::VarianceInterval | Self::VarianceProfile | Self::VariancePerC => Some(EffectKind::VarianceChange),
            own => Self::LIBRARY.contains(&own).then(|| EffectKind::from_name(own.name())).flatten(),
        }
    }

    /// Returns the effects of docs/effects.md that describe a kind outside the library. A diagnosis that knows one of
    /// them and names it gives a valid answer.
    pub fn described(self) -> &'static [EffectKind] {
        use EffectKind::*;
        match self {
            Self::FmLine | Self::PhaseWalk | Self::ToneByTemperature => &[WanderingLine],
            Self::ToneOnOff => &[Intermittent, WanderingLine],
            Self::VibrationBursts => &[Intermittent, ModulatedBand],
            Self::RingDowns => &[ModulatedBand, Intermittent],
            Self::OddSlope => &[PowerLaw, SpectralNoise],
            Self::MovingResonance | Self::HighPass | Self::Notch => &[SpectralNoise],
            // Their laws have parameters that section 8 adds.
            Self::Hysteresis | Self::ThermalRate | Self::TemperatureParabola => &[TemperatureBias],
            Self::ClusteredSpikes => &[Spikes],
            _ => &[],
        }
    }

    /// Returns the parameters of an effect of [`Self::described`] without which it is the plain effect of section 5,
    /// and not a valid answer.
    pub fn described_by(self) -> &'static [&'static str] {
        match self {
            Self::Hysteresis => &["play_c"],
            Self::ThermalRate => &["per_c_per_s"],
            Self::TemperatureParabola => &["per_c2"],
            Self::ClusteredSpikes => &["cluster"],
            _ => &[],
        }
    }

    /// Returns the place in the sensor's chain; of two effects, the one with the lower place acts first.
    pub fn place(self) -> u8 {
        self.row().0
    }

    /// Returns the effects that cannot be distinguished from the kind on one channel.
    pub fn like(self) -> &'static [EffectKind] {
        self.row().1
    }

    /// Returns the minimum number of channels on which the kind acts.
    pub fn channels_min(self) -> usize {
        if matches!(self, Self::CommonMode) || self.has_source() { 2 } else { 1 }
    }

    /// Returns whether the first channel couples into the others.
    pub fn has_source(self) -> bool {
        matches!(self, Self::DelayedCrosstalk | Self::ProductCrosstalk)
    }

    /// Returns whether the kind acts on stamps, so that the record must have stamps.
    pub fn needs_stamps(self) -> bool {
        matches!(self, Self::Timing | Self::WanderingClock)
    }

    /// Returns whether the kind requires a measured temperature.
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

    /// Returns whether the kind is constant in time and has exactly the law of the documented parameters, so that a
    /// model can state it correctly. Steps that rise slowly, soft ends, and limits that follow from the samples do not
    /// qualify.
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

    /// Returns whether a model can have the kind at another size. No parameter has the signs of shared noise.
    pub fn can_be_resized(self) -> bool {
        self.effect().is_some() && self != Self::CommonMode
    }

    /// Returns whether a model can have the kind at another frequency or time.
    pub fn can_be_elsewhere(self) -> bool {
        matches!(
            self,
            Self::Tone | Self::Comb | Self::Resonance | Self::BiasStep | Self::Bursts | Self::VarianceInterval
        )
    }

    /// Returns whether two kinds may be in one case: not if they are the same or nearly the same effect, nor if one
    /// cuts off the other.
    pub fn goes_with(self, other: Self) -> bool {
        let both = |two: [Self; 2]| two.contains(&self) && two.contains(&other);
        self.effect() != other.effect() && !both([Self::Tone, Self::Comb]) && !both([Self::Spikes, Self::Saturation])
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
        for effect in imu_model::effects::CHANNEL.iter().map(|of| of.spec.kind) {
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
