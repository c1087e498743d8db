//! Imposing: draws a kind of effect for a setting and applies it to columns of samples, simulated or recorded.
//!
//! The forms differ on purpose from those that a diagnosis fits. Sizes of spikes are evenly spread. Resonances are
//! AR(2). Filters are Butterworth's with a little noise behind them. Steps take some samples to rise, and bursts have
//! soft ends. A variance follows a sine or a triangle. Frequencies, times and sizes are drawn without restriction to a
//! grid.
//!
//! | file | kinds |
//! |---|---|
//! | `level` | rate_ramp, temperature_bias, warm_up, bias_step; hysteresis |
//! | `line` | tone, comb; chirp, fm_line |
//! | `colour` | quantization_noise, gauss_markov, resonance; odd_slope, random_telegraph, shot_noise |
//! | `filter` | low_pass, moving_average; echo |
//! | `event` | spikes, bursts; vibration_bursts |
//! | `loudness` | heavy_tails, variance_…; periodic_gain, skewed_noise |
//! | `sent` | resolution, saturation, held_samples, timing; dead_band |
//! | `shared` | common_mode; delayed_crosstalk, product_crosstalk |
//! | `outside` | other kinds outside the library: `wander` levels, `carrier` lines, `law` noise, `chain` later changes |

mod colour;
mod event;
mod filter;
mod level;
mod line;
mod loudness;
mod outside;
mod sent;
mod shared;

use super::class::Role;

use super::columns::Columns;
use super::draw::Draw;
use super::kind::Kind;
use super::limit;
use super::setting::Setting;
use imu_core::sample::{Channel, Triad};
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// The reason why an effect cannot be imposed on samples.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ImposeError {
    /// The effect depends on the temperature, which is not measured.
    #[error("{kind} needs a measured temperature, which the samples do not have")]
    NoTemperature {
        /// The effect.
        kind: Kind,
    },
    /// The effect needs several channels.
    #[error("{kind} needs {needed} channels; the samples have {found}")]
    TooFewChannels {
        /// The effect.
        kind: Kind,
        /// The number of channels needed.
        needed: usize,
        /// The number of channels.
        found: usize,
    },
    /// The effect needs a longer record.
    #[error("{kind} needs {needed} samples; there are {found}")]
    TooShort {
        /// The effect.
        kind: Kind,
        /// The number of samples needed.
        needed: usize,
        /// The number of samples.
        found: usize,
    },
    /// The model has the effect, but its format cannot state it.
    #[error("no model can state what it has of {kind}")]
    Unstated {
        /// The effect.
        kind: Kind,
    },
}

/// Minimum number of samples for an effect: events and bursts would not fit in fewer.
pub const SAMPLES_MIN: usize = 10_000;

/// The action of an effect on columns.
trait Act: std::fmt::Debug + Send + Sync {
    /// Acts on the columns `at`, in the order in which they were drawn.
    fn act(&self, on: &mut Columns, at: &[usize], draw: &mut Draw);
}

/// The inputs of a kind's draw.
struct Making<'a> {
    kind: Kind,
    role: Role,
    setting: &'a Setting,
    /// The channels' places in the setting.
    at: &'a [usize],
    /// The size over the 90 % limit.
    over: f64,
    /// The draws for the properties of the device.
    device: Draw,
    /// The draws for the times of events.
    events: Draw,
}

impl Making<'_> {
    /// Returns the size, in the units of [`limit::limit`].
    fn size(&self) -> f64 {
        self.over * limit::limit(self.kind, self.setting.samples)
    }

    /// Returns the size on each channel in U (times the white part's standard deviation), a little larger on some than
    /// on others.
    fn sizes_u(&mut self) -> Vec<f64> {
        let size = self.size();
        let rate_hz = self.setting.rate_hz;
        self.at
            .iter()
            .map(|at| size * self.setting.parts[*at].white(rate_hz) * self.device.uniform(1.0, limit::UNEVEN))
            .collect()
    }

    /// Returns these sizes with a random sign each.
    fn signed_sizes_u(&mut self) -> Vec<f64> {
        let sizes = self.sizes_u();
        sizes.into_iter().map(|size| size * self.device.sign()).collect()
    }

    fn samples(&self) -> f64 {
        self.setting.samples as f64
    }

    fn white(&self, at: usize) -> f64 {
        self.setting.parts[at].white(self.setting.rate_hz)
    }
}

/// A kind's draw.
struct Made {
    /// The size in the units of [`limit::limit`].
    size: f64,
    /// The documented parameters per channel, as far as they are known without samples.
    parameters: Vec<Value>,
    act: Box<dyn Act>,
}

/// An effect with its size and parameters, ready to act.
#[derive(Debug)]
pub struct Effect {
    /// The kind.
    pub kind: Kind,
    /// The size in the units of [`limit::limit`].
    pub size: f64,
    /// The size over the limit.
    pub over_limit: f64,
    /// The channels on which the effect acts, in column order.
    pub channels: Vec<Channel>,
    /// The parameters by channel, in the documented form.
    pub parameters: BTreeMap<String, Value>,
    act: Box<dyn Act>,
}

impl Effect {
    /// Draws an effect for a role: `device` determines the properties of the device, `events` the times of events.
    ///
    /// # Errors
    /// [`ImposeError`] if the setting lacks something that the kind needs.
    pub fn draw(
        kind: Kind,
        setting: &Setting,
        role: Role,
        mut device: Draw,
        events: Draw,
    ) -> Result<Self, ImposeError> {
        if setting.samples < SAMPLES_MIN {
            return Err(ImposeError::TooShort { kind, needed: SAMPLES_MIN, found: setting.samples });
        }
        if kind.needs_temperature() && setting.temperature.is_none() {
            return Err(ImposeError::NoTemperature { kind });
        }
        let [least, most] = limit::range(kind, setting.samples, role);
        let over = device.log_uniform(least, most);
        let at = places(kind, setting, &mut device)?;
        let mut making = Making { kind, role, setting, at: &at, over, device, events };
        let made = match kind {
            Kind::RateRamp | Kind::TemperatureBias | Kind::WarmUp | Kind::BiasStep | Kind::Hysteresis => {
                level::draw(&mut making)
            }
            Kind::Tone | Kind::Comb | Kind::Chirp | Kind::FmLine => line::draw(&mut making),
            Kind::QuantizationNoise
            | Kind::GaussMarkov
            | Kind::Resonance
            | Kind::OddSlope
            | Kind::RandomTelegraph
            | Kind::ShotNoise => colour::draw(&mut making),
            Kind::LowPass | Kind::MovingAverage | Kind::Echo => filter::draw(&mut making),
            Kind::Spikes | Kind::Bursts | Kind::VibrationBursts => event::draw(&mut making),
            Kind::HeavyTails
            | Kind::VarianceInterval
            | Kind::VarianceProfile
            | Kind::VariancePerC
            | Kind::PeriodicGain
            | Kind::SkewedNoise => loudness::draw(&mut making),
            Kind::Resolution | Kind::Saturation | Kind::HeldSamples | Kind::Timing | Kind::DeadBand => {
                sent::draw(&mut making)
            }
            Kind::CommonMode | Kind::DelayedCrosstalk | Kind::ProductCrosstalk => shared::draw(&mut making),
            _ => outside::draw(&mut making),
        };
        let over_limit = match kind {
            // The filter's own size states how far it is from no filter.
            Kind::LowPass => made.size,
            Kind::MovingAverage => limit::ABOVE * made.size / 2.0,
            outside if outside.effect().is_none() => limit::ABOVE,
            _ => making.over,
        };
        let channels: Vec<Channel> = at.iter().map(|at| setting.parts[*at].channel).collect();
        let named = channels.iter().map(|channel| channel.name().to_owned());
        Ok(Self {
            kind,
            size: made.size,
            over_limit,
            parameters: named.zip(made.parameters).collect(),
            channels,
            act: made.act,
        })
    }

    /// Applies the effect; `draw` determines the realisation.
    pub fn impose(&self, on: &mut Columns, draw: &mut Draw) {
        let at: Vec<usize> = self
            .channels
            .iter()
            .filter_map(|channel| on.columns.iter().position(|column| column.channel == *channel))
            .collect();
        // Columns of a device other than the one that the effect was drawn for are left unchanged instead of changed in
        // part.
        if at.len() == self.channels.len() {
            self.act.act(on, &at, draw);
        }
    }
}

/// Returns the channels that a kind acts on: some at random, or as few as the kind requires; never a channel with a
/// similar effect of the recording.
fn places(kind: Kind, setting: &Setting, device: &mut Draw) -> Result<Vec<usize>, ImposeError> {
    let free: Vec<usize> =
        (0..setting.parts.len()).filter(|at| setting.is_free(setting.parts[*at].channel, kind)).collect();
    let (count, least) = (free.len(), kind.channels_min());
    if count < least {
        return Err(ImposeError::TooFewChannels { kind, needed: least, found: count });
    }
    let chosen = match kind {
        stamps if stamps.needs_stamps() => (0..count).collect(),
        Kind::HeldSamples => {
            let triad_of = |at: &usize| setting.parts[free[*at]].channel.triad();
            let mut triads: Vec<Option<Triad>> = (0..count).map(|at| triad_of(&at)).collect();
            triads.dedup();
            let triad = triads[device.whole(0, triads.len() - 1)];
            (0..count).filter(|at| triad_of(at) == triad).collect()
        }
        // If a channel couples into others, it is the first one.
        source if source.has_source() => device.some_of(count - 1, 1).into_iter().map(|at| at + 1).collect(),
        _ => device.some_of(count, least),
    };
    Ok(chosen.into_iter().map(|at| free[at]).collect())
}

/// Returns an object with one entry per pair.
fn object<const N: usize>(entries: [(&str, Value); N]) -> Value {
    Value::Object(entries.into_iter().map(|(name, value)| (name.to_owned(), value)).collect::<Map<_, _>>())
}

/// Returns the value at `at`, from 0 to 1, of a window that rises over `soft` of its length and falls in the same way,
/// with sin² ends.
fn soft_window(at: f64, soft: f64) -> f64 {
    let edge = at.min(1.0 - at) / soft;
    if edge >= 1.0 { 1.0 } else { (std::f64::consts::FRAC_PI_2 * edge.max(0.0)).sin().powi(2) }
}

#[cfg(test)]
mod tests;
