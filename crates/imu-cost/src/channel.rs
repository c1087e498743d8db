//! One channel: what each of its causes contributes to the integrals of its error.
//!
//! In: sources, spectra. Out: per cause a mean, a variance, and the peaks of sines and sizes of spikes, per horizon and
//! order; and which effects on the channel are nonlinear there, so that they have to be simulated.

use crate::courses::{Course, Integrals, course, gated, modulation};
use crate::monte_carlo::simulated;
use crate::request::{CostError, Setting};
use crate::sources::{ChannelSources, Factor, Law, Source};
use crate::spectra::{Spectra, lines, local_lines, peaks, unsettled_lines};
use crate::weights::ORDERS;
use imu_core::sample::Channel;
use imu_model::EffectKind;
use imu_model::effects::{Effect, Line, Record};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Standard deviations that a channel stays away from a limit that counts as never reached.
const CLEAR: f64 = 6.0;
/// A resolution is white noise if half the mean square of the samples' differences is above (half a step)².
const DITHERED: f64 = 0.5;

/// What one cause contributes to the integrals of a channel's error, in the integrals' units.
#[derive(Debug, Clone)]
pub(crate) struct Contribution {
    pub cause: &'static str,
    pub mean: Integrals,
    /// Variance about the mean, of all parts.
    pub variance: Integrals,
    /// Peaks of sines, by horizon and order.
    pub sines: Vec<[Vec<f64>; ORDERS]>,
    pub shape: Shape,
    /// Noise that channels share: its instance and sign.
    pub common: Option<(usize, f64)>,
    /// Whether the variance comes from a simulation.
    pub is_simulated: bool,
}

/// How a contribution is distributed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Shape {
    /// Normal, but for its sines.
    Plain,
    /// Spikes of typical size `amplitude`, U; the other terms as in [`crate::band::Spiky`].
    Spikes { begins: f64, goes_on: f64, amplitude: f64, averaged: f64 },
    /// A line of the frequency as it is sent and of mean square `power`, U², that is a sine as long as it keeps its phase:
    /// phase² gathered in one correlation time, and that time, s. Its amplitude wanders too: a sine of the part `steady` of
    /// its mean square and normal noise for the rest have the same fourth moment.
    Wanders { sent_hz: f64, power: f64, steady: f64, beta: f64, tc_s: f64 },
}

impl Shape {
    fn of(setting: &Setting<'_>, effect: &Arc<dyn Effect>) -> Self {
        let number = |name: &str| effect.number(name).unwrap_or(0.0);
        match effect.kind() {
            EffectKind::Spikes => {
                let goes_on = 1.0 - 1.0 / number("cluster").max(1.0);
                let share = number("rate_hz") / setting.internal_hz;
                let begins = share * (1.0 - goes_on) / (1.0 - share * goes_on);
                let averaged = setting.window().min(setting.ratio() as u64) as f64;
                Self::Spikes { begins, goes_on, amplitude: number("amplitude"), averaged }
            }
            EffectKind::WanderingLine => {
                let (tc_s, within) = (number("frequency_tc_s"), number("frequency_hz").rem_euclid(setting.rate_hz));
                Self::Wanders {
                    sent_hz: within.min(setting.rate_hz - within),
                    power: 0.5 * number("amplitude").powi(2),
                    // E A⁴ over (E A²)² is e^(4s²).
                    steady: (2.0 - (4.0 * number("amplitude_sigma").powi(2)).exp()).max(0.0).sqrt(),
                    beta: (TAU * number("frequency_sigma_hz") * tc_s).powi(2),
                    tc_s,
                }
            }
            _ => Self::Plain,
        }
    }
}

/// A channel's contributions.
#[derive(Debug)]
pub(crate) struct ChannelErrors {
    pub channel: Channel,
    pub contributions: Vec<Contribution>,
    /// Effects that make the sum of the contributions wrong.
    pub nonlinear: Vec<&'static str>,
}

impl ChannelErrors {
    /// Computes the contributions of a channel whose spectral sources begin at `first` in `spectra`.
    ///
    /// # Errors
    /// [`CostError::Model`] if the model cannot be simulated.
    pub(crate) fn new(
        setting: &Setting<'_>,
        of: &ChannelSources,
        spectra: &Spectra,
        first: usize,
    ) -> Result<Self, CostError> {
        let mut contributions = Vec::new();
        let (mut index, mut unsettled, mut local, mut courses) = (first, 0.0, 0.0, [0.0; 2]);
        for source in &of.sources {
            let mut own = Contribution::none(setting, source);
            match &source.law {
                Law::Stationary | Law::Modulated(_) => {
                    let found = lines(setting, of, source);
                    own.spectral(setting, of, source, spectra, index);
                    own.add_lines(setting, &found, of.held);
                    if matches!(source.law, Law::Stationary) {
                        unsettled += spectra.unsettled(index, of.held) + unsettled_lines(setting, &found, of.held);
                        local +=
                            if source.is_sent() { 0.0 } else { spectra.local(index) + local_lines(setting, &found) };
                    }
                    index += 1;
                }
                Law::Course => {
                    let constant = source.effect.kind() == EffectKind::TemperatureBias;
                    if !(constant && setting.temperature_is_constant) {
                        let Course { means, range } = course(setting, of, source)?;
                        own.mean = means;
                        courses = [courses[0] + range[0], courses[1] + range[1]];
                    }
                }
                Law::Gated { frequency_hz, amplitude, intervals } => {
                    own.add_sine(gated(setting, of, *frequency_hz, *amplitude, intervals));
                }
                Law::Simulated => {
                    setting.check_work(source.cause, of.channel)?;
                    own.variance = simulated(setting, of, source)?;
                    own.is_simulated = true;
                }
            }
            contributions.push(own);
        }
        contributions.extend(held(setting, of, spectra, unsettled));
        let mut nonlinear = nonlinear(setting, of, local, courses);
        // What is there at random times is neither normal nor a sine.
        if of.sources.iter().any(|source| comes_and_goes(&*source.effect)) {
            nonlinear.insert(0, EffectKind::Intermittent.name());
        }
        nonlinear.iter().try_for_each(|effect| setting.check_work(effect, of.channel))?;
        Ok(Self { channel: of.channel, contributions, nonlinear })
    }
}

impl Contribution {
    fn none(setting: &Setting<'_>, source: &Source) -> Self {
        let count = setting.horizons.len();
        Self {
            cause: source.cause,
            mean: vec![[0.0; ORDERS]; count],
            variance: vec![[0.0; ORDERS]; count],
            sines: vec![Default::default(); count],
            shape: Shape::of(setting, &source.effect),
            common: source.common,
            is_simulated: false,
        }
    }

    /// Sets the variances of a source with a density.
    fn spectral(
        &mut self,
        setting: &Setting<'_>,
        of: &ChannelSources,
        source: &Source,
        spectra: &Spectra,
        index: usize,
    ) {
        let factors = match &source.law {
            Law::Modulated(factor) => modulation(setting, factor),
            _ => vec![[1.0; ORDERS]; setting.horizons.len()],
        };
        for (place, (row, factors)) in self.variance.iter_mut().zip(factors).enumerate() {
            for (order, (variance, factor)) in row.iter_mut().zip(factors).enumerate() {
                *variance = factor * spectra.variance(index, of.held, place, order + 1);
            }
        }
    }

    fn add_lines(&mut self, setting: &Setting<'_>, lines: &[Line], held: f64) {
        for place in 0..self.sines.len() {
            for order in 1..=ORDERS {
                let peaks = peaks(setting, lines, held, place, order);
                self.variance[place][order - 1] += peaks.iter().map(|peak| 0.5 * peak * peak).sum::<f64>();
                self.sines[place][order - 1].extend(peaks);
            }
        }
    }

    fn add_sine(&mut self, peaks: Integrals) {
        for ((sines, variance), peaks) in self.sines.iter_mut().zip(&mut self.variance).zip(peaks) {
            for ((sines, variance), peak) in sines.iter_mut().zip(variance).zip(peaks) {
                sines.push(peak);
                *variance += 0.5 * peak * peak;
            }
        }
    }
}

/// Returns the effects that make the sum of the variances of a channel's contributions wrong. `local` is half the mean square of the
/// difference from one sample to the next, U², `courses` the range of the courses, U.
pub(crate) fn nonlinear(
    setting: &Setting<'_>,
    of: &ChannelSources,
    local: f64,
    courses: [f64; 2],
) -> Vec<&'static str> {
    let mut nonlinear = Vec::new();
    // How often a sample is repeated does not depend on its noise, but what that adds does.
    let changes = |law: &Law| !matches!(law, Law::Stationary | Law::Course);
    if of.held > 0.0 && of.sources.iter().any(|source| changes(&source.law)) {
        nonlinear.push(EffectKind::HeldSamples.name());
    }
    if of.step.is_some_and(|step| local < (DITHERED * step).powi(2)) {
        nonlinear.push(EffectKind::Resolution.name());
    }
    if of.limits.is_some_and(|limits| reaches(setting, of, limits, courses)) {
        nonlinear.push(EffectKind::Saturation.name());
    }
    nonlinear
}

/// Returns what repeating samples adds: noise of the mean square that it leaves out of the input.
fn held(setting: &Setting<'_>, of: &ChannelSources, spectra: &Spectra, unsettled: f64) -> Option<Contribution> {
    (of.held > 0.0).then(|| {
        let variance = |place: usize| [1, 2, 3].map(|order| unsettled * spectra.repeated(of.held, place, order));
        let count = setting.horizons.len();
        Contribution {
            cause: EffectKind::HeldSamples.name(),
            mean: vec![[0.0; ORDERS]; count],
            variance: (0..count).map(variance).collect(),
            sines: vec![Default::default(); count],
            shape: Shape::Plain,
            common: None,
            is_simulated: false,
        }
    })
}

/// Returns whether an effect is there at random times.
fn comes_and_goes(effect: &dyn Effect) -> bool {
    effect.kind() == EffectKind::Intermittent && effect.pairs("intervals").is_empty()
}

/// Returns whether the sensor's own samples come near a limit: by their level, courses, and standard deviation over the
/// record.
fn reaches(setting: &Setting<'_>, of: &ChannelSources, limits: [f64; 2], courses: [f64; 2]) -> bool {
    let record =
        Record { rate_hz: setting.internal_hz, samples: (setting.begin + setting.samples()) * setting.ratio() as u64 };
    let variance = |source: &Source| match &source.law {
        Law::Course => 0.0,
        _ if source.is_sent() => 0.0,
        Law::Modulated(Factor::Changes(changes)) => {
            mean_square(source, record) * changes.iter().map(largest).product::<f64>().powi(2)
        }
        _ => mean_square(source, record),
    };
    let spikes = |source: &Source| match source.effect.kind() {
        EffectKind::Spikes => 1.5 * source.effect.number("amplitude").unwrap_or(0.0),
        _ => 0.0,
    };
    let sigma = of.sources.iter().map(variance).sum::<f64>().sqrt();
    let far = CLEAR * sigma + of.sources.iter().map(spikes).sum::<f64>();
    of.level + courses[0] - far < limits[0] || of.level + courses[1] + far > limits[1]
}

/// Returns the mean square over a record of a source's output, U²; for noise without a level, what lies above one over the
/// record's length, within a factor of 2.
fn mean_square(source: &Source, record: Record) -> f64 {
    if let Some(moments) = source.effect.moments(record) {
        return moments.variance;
    }
    let lowest_hz = 1.0 / record.length_s();
    let octaves = (0.5 * record.samples as f64).log2().ceil() as i32;
    let part = |octave: i32| {
        let hz = lowest_hz * 2.0_f64.powi(octave);
        hz * source.effect.psd(hz, record.rate_hz).unwrap_or(0.0)
    };
    2.0 * (0..octaves).map(part).sum::<f64>()
}

/// Returns the largest factor that a change of variance states, at least 1.
fn largest(change: &Arc<dyn Effect>) -> f64 {
    let profile = change.pairs("profile").into_iter().map(|(_, factor)| factor);
    change.number("factor").into_iter().chain(profile).fold(1.0, f64::max)
}
