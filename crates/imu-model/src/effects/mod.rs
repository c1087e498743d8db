//! Effects: one physical error source per file, each defined once for the simulator, the fit, the plots and the diagnosis.
//! Pure.
//!
//! In: an effect's parameters (docs/formats.md), a rate, a random stream. Out: its closed forms (power spectrum, Allan variance,
//! gain, mean response, moments, the functions of time it is linear in) and a sampler that streams it in bounded memory. If there
//! is no closed form, the method returns `None`, and its documentation states why.
//!
//! Every effect samples from a separate stream ([`stream`]), so that adding one never changes another's values. A
//! sampler works on blocks in place and its values do not depend on how the stream is cut into blocks.
//!
//! [`Stage`] is the order in which effects act, for any order in a file. [`EffectKind`] is the identity of an effect,
//! listed once below; [`Spec`] has its parameters, with their ranges and units, and its words. The refusals, the JSON
//! Schema, a report's phrases and the tables in `docs/effects.md` follow from [`Spec`]. Effects on a triad, driven by a
//! motion, are in [`triad`].
//!
//! Refused, with the parameter, the value found and the values allowed ([`Refusal`]): values outside their range,
//! frequencies from half the rate up, intervals that end before they begin.
//!
//! Validation: each effect's tests compare simulated spectra, Allan variances and moments over 100 seeds with its closed
//! forms.

#[cfg(test)]
mod check;

pub mod bias_step;
pub mod bursts;
pub mod common_mode;
pub mod described;
pub mod flicker;
pub mod frequencies;
pub mod gauss_markov;
pub mod heavy_tails;
pub mod held_samples;
pub mod intermittent;
pub mod low_pass;
pub mod modulated_band;
pub mod moving_average;
pub mod power_law;
pub mod profile;
pub mod quantization_noise;
pub mod random_walk;
pub mod rate_ramp;
pub mod registry;
pub mod resolution;
pub mod resonance;
pub mod sampled;
pub mod saturation;
pub mod spec;
pub mod spectrum;
pub mod spikes;
pub mod stream;
pub mod temperature_bias;
pub mod timing;
pub mod tone;
pub mod triad;
pub mod variance_change;
pub mod wandering_line;
pub mod warm_up;
pub mod white;

pub use bias_step::BiasStep;
pub use bursts::Bursts;
pub use common_mode::CommonMode;
pub use described::Described;
pub use flicker::Flicker;
pub use frequencies::Frequencies;
pub use gauss_markov::GaussMarkov;
pub use heavy_tails::HeavyTails;
pub use held_samples::HeldSamples;
pub use intermittent::Intermittent;
pub use low_pass::LowPass;
pub use modulated_band::ModulatedBand;
pub use moving_average::MovingAverage;
pub use power_law::PowerLaw;
pub use quantization_noise::QuantizationNoise;
pub use random_walk::RandomWalk;
pub use rate_ramp::RateRamp;
pub use resolution::Resolution;
pub use resonance::Resonance;
pub use saturation::Saturation;
pub use spec::{Definition, LARGEST, Refusal, Spec};
pub use spectrum::SpectralNoise;
pub use spikes::Spikes;
pub use stream::{Stream, StreamId};
pub use temperature_bias::TemperatureBias;
pub use timing::Timing;
pub use tone::{Comb, Tone};
pub use triad::TriadEffect;
pub use variance_change::VarianceChange;
pub use wandering_line::WanderingLine;
pub use warm_up::WarmUp;
pub use white::White;

use std::sync::Arc;

registry::registry! {
    beside: White = "white", Flicker = "flicker", RandomWalk = "random_walk";
    channel:
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
        VarianceChange = "variance_change",
        LowPass = "low_pass",
        MovingAverage = "moving_average",
        Saturation = "saturation",
        HeldSamples = "held_samples",
        CommonMode = "common_mode",
        Timing = "timing",
        PowerLaw = "power_law",
        SpectralNoise = "spectrum",
        ModulatedBand = "modulated_band",
        Intermittent = "intermittent",
        WanderingLine = "wandering_line";
    triad:
        Bias = "bias",
        ScaleFactor = "scale_factor",
        ScaleFactorNonlinearity = "scale_factor_nonlinearity",
        Misalignment = "misalignment",
        CrossAxisSensitivity = "cross_axis_sensitivity",
        GSensitivity = "g_sensitivity",
        Latency = "latency",
        Rectification = "rectification",
        TemperatureScale = "temperature_scale";
    on both: Saturation;
}

/// Temperature if none is given, °C: that of a laboratory, and the reference of most data sheets.
pub const USUAL_TEMPERATURE_C: f64 = 25.0;

/// The chain of a sensor, in the order in which its parts act. The order of a file's list has no meaning.
///
/// Within one stage effects on a triad add up, each from the stage's own input, so that their order does not matter.
/// A bandwidth acts on motion and noise alike, before the converter clips and before anything is decimated: noise beyond
/// it is gone, and a clipped value stays exactly at its limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// The motion arrives late.
    Latency,
    /// Coupling between axes: misalignment, cross-axis sensitivity.
    CrossAxis,
    /// Scale factor, its nonlinearity and its temperature sensitivity.
    Scale,
    /// Effects that shift the level: bias, temperature, warm-up, steps, ramp, g-sensitivity, rectification.
    Bias,
    /// Effects that shape the white part alone, before it is added: heavy tails, changes of variance.
    WhitePart,
    /// Additive noise: N, B, K and the others.
    Noise,
    /// The sensor's bandwidth: filters on the sum of all stages so far.
    Bandwidth,
    /// The converter's limits.
    Saturation,
    /// The boxcar over internal samples and the choice of every n-th; not an effect but the model's `sampling`.
    Sampling,
    /// Rounding of the sent values.
    Resolution,
    /// Samples that are sent twice.
    Hold,
    /// Stamps, and samples that are lost on the way.
    Timing,
}

impl Stage {
    /// Returns whether the stage runs at the sensor's internal rate, before its boxcar and decimation, if the model has
    /// them.
    pub fn is_internal(self) -> bool {
        self < Self::Sampling
    }
}

/// The reach of an effect that a channel names; it decides whose random stream the effect draws from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scope {
    /// The channel alone.
    Channel,
    /// All channels of the triad alike.
    Triad,
    /// The whole sensor: one stream for all channels.
    Sensor,
}

/// The record over which an expectation is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record {
    /// Samples per second.
    pub rate_hz: f64,
    /// The number of samples.
    pub samples: u64,
}

impl Record {
    /// Returns the length in s.
    pub fn length_s(self) -> f64 {
        self.samples as f64 / self.rate_hz
    }
    /// Returns the index of the first sample at or after `time_s`, at most [`Record::samples`].
    pub fn index_at(self, time_s: f64) -> u64 {
        sampled::index_at(time_s, self.rate_hz).min(self.samples)
    }
}

/// An instant, as far as effects depend on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct At {
    /// Time since the start, s.
    pub time_s: f64,
    /// The sensor's temperature, °C.
    pub temperature_c: f64,
}

/// The sensor's temperature over a block of samples, °C.
#[derive(Debug, Clone, Copy)]
pub enum Temperature<'a> {
    /// A constant temperature.
    Constant(f64),
    /// One value per sample, at least as many as the block has.
    Series(&'a [f64]),
}

impl Temperature<'_> {
    /// Returns the temperature at the block's sample `index`; beyond a series' end, its last value.
    pub fn at(&self, index: usize) -> f64 {
        match self {
            Self::Constant(value) => *value,
            Self::Series(values) => values.get(index).or_else(|| values.last()).copied().unwrap_or(USUAL_TEMPERATURE_C),
        }
    }
}

/// Moments of single samples of an effect's output.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments {
    /// Mean square about the mean, U².
    pub variance: f64,
    /// Fourth moment over the squared variance (3 for a normal distribution); `None` if it is infinite.
    pub kurtosis: Option<f64>,
}

/// The moments of the output of an effect of [`Stage::WhitePart`] for normal white noise of variance 1.
pub type WhiteMoments = Moments;

/// A line in a spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// The line's frequency, Hz.
    pub frequency_hz: f64,
    /// The line's mean square, U².
    pub power: f64,
}

/// A part of a record in which an effect acts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// Middle and half width of its band, Hz; none for all frequencies.
    pub band_hz: Option<[f64; 2]>,
    /// Begin and end, s; none for the whole time.
    pub time_s: Option<[f64; 2]>,
    /// The part's share of the effect, in any unit.
    pub weight: f64,
}

impl Extent {
    /// Creates a band about a frequency.
    pub fn band(frequency_hz: f64, half_width_hz: f64, weight: f64) -> Self {
        Self { band_hz: Some([frequency_hz, half_width_hz]), time_s: None, weight }
    }

    /// Creates a stretch of time with a weight.
    pub fn time(from_s: f64, to_s: f64, weight: f64) -> Self {
        Self { band_hz: None, time_s: Some([from_s, to_s]), weight }
    }
}

/// One error source of a channel. U is the unit of the channel on which it acts.
///
/// Creating an effect with other parameters is cheap, because fits do this repeatedly.
pub trait Effect: Described + std::fmt::Debug + Send + Sync {
    /// Returns the reach of the effect.
    fn scope(&self) -> Scope {
        Scope::Channel
    }

    /// Checks whether the parameters are in their ranges and make sense at `rate_hz`, the rate at which the effect acts
    /// (a model's internal rate, if it has one, for effects before sampling).
    ///
    /// # Errors
    /// [`Refusal`] with the parameter, the value found and the values allowed.
    fn check(&self, rate_hz: f64) -> Result<(), Refusal> {
        self.spec().check(&self.parameters())?;
        self.check_at(rate_hz)
    }

    /// Checks the part of [`Effect::check`] that a table of ranges cannot express.
    ///
    /// # Errors
    /// [`Refusal`], as for [`Effect::check`].
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        let _ = rate_hz;
        Ok(())
    }

    /// Returns the two-sided power spectral density in U²/Hz at `frequency_hz` (above 0, up to `rate_hz`/2) of the
    /// noise that the effect adds, sampled at `rate_hz`: its continuous part ([`Effect::lines`] has the rest). 0 for an
    /// effect that adds no noise; `None` if it depends on more than the parameters: on the other noise, the
    /// temperature's course or the record.
    fn psd(&self, frequency_hz: f64, rate_hz: f64) -> Option<f64>;

    /// Returns [`Effect::psd`] at many frequencies, with 0 in place of `None`.
    fn densities(&self, frequencies: &Frequencies) -> Vec<f64> {
        let density = |frequency_hz: &f64| self.psd(*frequency_hz, frequencies.rate_hz()).unwrap_or(0.0);
        frequencies.hz().iter().map(density).collect()
    }

    /// Returns, for an effect that varies over time, the stationary effect that has its mean density over `record`,
    /// exactly or approximately. `None` for all effects whose [`Effect::psd`] gives the density.
    fn stationary(&self, record: Record) -> Option<Arc<dyn Effect>> {
        let _ = record;
        None
    }

    /// Returns the lines in the spectrum of the effect's output.
    fn lines(&self) -> Vec<Line> {
        Vec::new()
    }

    /// Returns the parts of a record in which the effect acts, as far as its parameters determine them; none for an
    /// effect without a place.
    fn extents(&self) -> Vec<Extent> {
        Vec::new()
    }

    /// Returns the expected overlapping Allan variance in U², at the averaging time `m`/rate (`m` from 1), of the
    /// effect's contribution to `record`. 0 for an effect that adds no noise. `None` if it depends on more than the
    /// parameters and the record, and if the record is shorter than 2 `m` for an effect that varies over time.
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64>;

    /// Returns the power gain |H|² at `frequency_hz` of a filter that runs at `rate_hz`; 1 for all other effects.
    fn power_gain(&self, frequency_hz: f64, rate_hz: f64) -> f64 {
        let _ = (frequency_hz, rate_hz);
        1.0
    }

    /// Returns [`Effect::power_gain`] at many frequencies.
    fn power_gains(&self, frequencies: &Frequencies) -> Vec<f64> {
        let gain = |frequency_hz: &f64| self.power_gain(*frequency_hz, frequencies.rate_hz());
        frequencies.hz().iter().map(gain).collect()
    }

    /// Returns a filter without the noise behind it; `None` for all other effects.
    fn noiseless(&self) -> Option<Arc<dyn Effect>> {
        None
    }

    /// Returns the mean output of a channel whose output would be `input` (U, constant) without the effect.
    fn mean_response(&self, input: f64, at: At) -> f64 {
        let _ = at;
        input
    }

    /// Returns the moments of the effect's contribution to single samples over `record`. `None` if the effect adds no
    /// signal, if the moments depend on more than the parameters, and for noise without a level (flicker, random walk).
    fn moments(&self, record: Record) -> Option<Moments> {
        let _ = record;
        None
    }

    /// For effects of [`Stage::WhitePart`]: returns the moments over `record` of the output for normal white noise of
    /// variance 1; `None` for all others, and if the moments depend on the temperature's course.
    fn white_moments(&self, record: Record) -> Option<WhiteMoments> {
        let _ = record;
        None
    }

    /// Returns the number of functions of time and temperature in which the effect's deterministic part is linear; 0 if
    /// it has none.
    fn regressors(&self) -> usize {
        0
    }

    /// Writes those functions at an instant to `row`, for coefficients of 1 (for a ramp, the time; for a tone, cosine
    /// and sine, since its phase is unknown). `row` has [`Effect::regressors`] places.
    fn regress(&self, at: At, row: &mut [f64]) {
        let _ = (at, row);
    }

    /// Returns the effect's influence on stamps, if it has one.
    fn timing(&self) -> Option<Timing> {
        None
    }

    /// Returns a sampler at `rate_hz` that draws from `stream`. Spectra hold down to 1/`record_length_s`; a longer
    /// record may be drawn, but its lowest frequencies are then not guaranteed.
    fn sampler(&self, rate_hz: f64, record_length_s: f64, stream: Stream) -> Box<dyn Sampler>;
}

/// A realisation of an effect, in bounded memory.
pub trait Sampler: std::fmt::Debug + Send {
    /// Lets the effect act on the next `values.len()` samples of its channel (U), in place.
    fn act(&mut self, values: &mut [f64], temperature: Temperature<'_>);

    /// Acts at the usual temperature.
    fn apply(&mut self, values: &mut [f64]) {
        self.act(values, Temperature::Constant(USUAL_TEMPERATURE_C));
    }
}

/// Returns a sampler that calls `act` on one sample after the other, at any temperature.
pub(crate) fn each(act: impl FnMut(&mut f64) + Send + 'static) -> Box<dyn Sampler> {
    Box::new(Each(act))
}

struct Each<F>(F);

impl<F> std::fmt::Debug for Each<F> {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("Each")
    }
}

impl<F: FnMut(&mut f64) + Send> Sampler for Each<F> {
    fn act(&mut self, values: &mut [f64], _temperature: Temperature<'_>) {
        values.iter_mut().for_each(&mut self.0);
    }
}

/// Two effects are the same if they have the same name and parameters.
impl PartialEq for dyn Effect {
    fn eq(&self, other: &Self) -> bool {
        self.kind() == other.kind() && self.parameters() == other.parameters()
    }
}

/// Two effects are the same if they have the same name and parameters.
impl PartialEq for dyn TriadEffect {
    fn eq(&self, other: &Self) -> bool {
        self.kind() == other.kind() && self.parameters() == other.parameters()
    }
}
