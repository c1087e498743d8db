//! The real errors of a channel: the joint moments of its integrals over the horizons of a grid, by cause.
//!
//! In: a model, a setting. Out: one list of moments per cause; their sum is the covariance that a filter should predict.
//! The ensemble is windows at any time of the record: what changes with time (courses, changes of variance, what comes
//! and goes) counts with its mean square over the record. What has no density is simulated over the record.

use super::moments::{Moments, Windows, add, of_densities, of_line};
use super::request::{Asked, Grid};
use crate::channel::nonlinear;
use crate::courses::{gated_wave, inside, powers, samples, simulator};
use crate::quadrature::Rule;
use crate::request::{CostError, Setting};
use crate::sources::{ChannelSources, Factor, Law, Source, restricted};
use crate::spectra::{Spectra, kept, lines, local_lines, unsettled_lines};
use imu_core::sample::Channel;
use imu_model::EffectKind;
use imu_model::effects::{Effect, HeldSamples, Line, RandomWalk, White};
use imu_model::simulator::SensorModel;

/// Alignments with the longest horizon that simulations together have at least.
const WINDOWS_SIMULATED: f64 = 300.0;

/// The moments of one cause.
#[derive(Debug, Clone)]
pub(crate) struct Part {
    /// `N`, `B`, `K`, or an effect's name, with its frequency if it has one.
    pub cause: String,
    pub moments: Moments,
}

impl Part {
    /// Returns whether a filter knows this noise as its own white noise or walk.
    pub(crate) fn is_known(&self) -> bool {
        ["N", "K"].contains(&self.cause.as_str())
    }
}

/// The errors of a channel.
#[derive(Debug)]
pub(crate) struct Real {
    pub channel: Channel,
    pub parts: Vec<Part>,
    /// The number of pairs of horizons.
    pub pairs: usize,
    /// The effects that had to be simulated.
    pub simulated: Vec<&'static str>,
}

impl Real {
    /// Returns the sum over all causes but `left_out`.
    pub(crate) fn without(&self, left_out: Option<usize>) -> Moments {
        let mut sum = vec![0.0; self.pairs];
        let kept = self.parts.iter().enumerate().filter(|(place, _)| Some(*place) != left_out);
        kept.for_each(|(_, part)| add(&mut sum, 1.0, &part.moments));
        sum
    }
}

/// The moments of one unit of what a filter knows: white noise of 1 U/√Hz and a walk of 1 U/√s at the sent rate.
#[derive(Debug)]
pub(crate) struct Known {
    pub white: Moments,
    pub walk: Moments,
}

/// Computes the errors of all channels, and beside them the moments of what a filter knows, by the same quadrature.
///
/// # Errors
/// [`CostError`] if the model cannot be simulated, or not in a bearable time.
pub(crate) fn errors(
    asked: &Asked<'_>,
    grid: &Grid,
    sources: &[ChannelSources],
) -> Result<(Known, Vec<Real>), CostError> {
    let (setting, rule) = (&asked.setting, Rule::new());
    let spectra = Spectra::unweighted(setting, sources, &rule);
    let repeated = |held: f64| {
        let law = HeldSamples { probability: held };
        spectra.nodes().iter().map(|hz| law.white_gain(*hz, setting.rate_hz) / setting.rate_hz).collect::<Vec<f64>>()
    };
    let unit = |effect: &dyn Effect| {
        spectra.nodes().iter().map(|hz| effect.psd(*hz, setting.rate_hz).unwrap_or(0.0)).collect::<Vec<f64>>()
    };
    let mut densities = vec![unit(&White { n: 1.0 }), unit(&RandomWalk { k: 1.0 })];
    let mut index = 0;
    for of in sources {
        for _ in of.sources.iter().filter(|source| source.is_spectral()) {
            let own = spectra.density(index).iter().zip(spectra.nodes());
            let gain = |hz: f64| if of.held == 0.0 { 1.0 } else { kept(of.held, hz, setting.rate_hz) };
            densities.push(own.map(|(density, hz)| density * gain(*hz)).collect());
            index += 1;
        }
        densities.push(if of.held > 0.0 { repeated(of.held) } else { vec![0.0; spectra.nodes().len()] });
    }
    let all = of_densities(&rule, &spectra.panels, setting.rate_hz, setting.align, grid, &densities);
    let mut all = all.into_iter();
    let mut next = || all.next().unwrap_or_default();
    let known = Known { white: next(), walk: next() };
    let mut index = 0;
    let mut found = Vec::with_capacity(sources.len());
    for of in sources {
        let count = of.sources.iter().filter(|source| source.is_spectral()).count();
        let stationary: Vec<Moments> = (0..count).map(|_| next()).collect();
        let channel = OfChannel { asked, grid, of, spectra: &spectra, first: index };
        found.push(channel.errors(stationary, next())?);
        index += count;
    }
    Ok((known, found))
}

/// A channel whose errors are computed.
struct OfChannel<'a> {
    asked: &'a Asked<'a>,
    grid: &'a Grid,
    of: &'a ChannelSources,
    spectra: &'a Spectra,
    /// The first of its sources in the spectra.
    first: usize,
}

impl OfChannel<'_> {
    fn errors(&self, stationary: Vec<Moments>, repeated: Moments) -> Result<Real, CostError> {
        let (asked, of, grid) = (self.asked, self.of, self.grid);
        let (setting, record) = (&asked.setting, &asked.record);
        let mut parts: Vec<Part> = Vec::new();
        let mut simulated = Vec::new();
        let (mut index, mut unsettled, mut local, mut courses) = (self.first, 0.0, 0.0, [0.0; 2]);
        let mut stationary = stationary.into_iter();
        for source in &of.sources {
            let mut moments = vec![0.0; grid.pairs.len()];
            match &source.law {
                Law::Stationary | Law::Modulated(_) => {
                    let found = lines(setting, of, source);
                    let mean_power = match &source.law {
                        Law::Modulated(factor) => mean_power(record, factor),
                        _ => 1.0,
                    };
                    add(&mut moments, mean_power, &stationary.next().unwrap_or_default());
                    for line in &found {
                        add(&mut moments, 1.0, &self.line(*line));
                    }
                    if matches!(source.law, Law::Stationary) {
                        unsettled += self.spectra.unsettled(index, of.held) + unsettled_lines(setting, &found, of.held);
                        let own = self.spectra.local(index) + local_lines(setting, &found);
                        local += if source.is_sent() { 0.0 } else { own };
                    }
                    index += 1;
                }
                Law::Course => {
                    let is_constant =
                        source.effect.kind() == EffectKind::TemperatureBias && record.temperature_is_constant;
                    if !is_constant {
                        let (own, range) = self.course(source)?;
                        moments = own;
                        courses = [courses[0] + range[0], courses[1] + range[1]];
                    }
                }
                Law::Gated { frequency_hz, amplitude, intervals } => {
                    // A quarter of the shortest interval or horizon.
                    let shortest = intervals.iter().map(|(from, to)| to - from).fold(f64::INFINITY, f64::min);
                    let shortest = (shortest * setting.rate_hz).min(grid.horizons.first().map_or(1.0, |of| *of as f64));
                    let stride = (0.25 * shortest).max(1.0) as u64;
                    for wave in [f64::cos, f64::sin] {
                        let next = gated_wave(record, of, *frequency_hz, *amplitude, intervals, wave);
                        let windows = Windows::dense(record.samples(), setting.align, grid, stride);
                        // The mean over all phases.
                        add(&mut moments, 0.5, &windows.moments(setting.rate_hz, grid, next));
                    }
                }
                Law::Simulated => {
                    moments = self.simulated(&of.alone(record.model, &source.effect), source.cause)?;
                    simulated.push(source.cause);
                }
            }
            gather(&mut parts, name(source), &moments);
        }
        if of.held > 0.0 {
            let moments: Moments = repeated.iter().map(|own| own * unsettled).collect();
            gather(&mut parts, EffectKind::HeldSamples.name().to_owned(), &moments);
        }
        let nonlinear = nonlinear(record, of, local, courses);
        if let Some(first) = nonlinear.first() {
            let all = self.simulated(&restricted(record.model, &[of.channel]), first)?;
            parts.retain(|part| !nonlinear.contains(&part.cause.as_str()));
            // The rest of what the whole channel does.
            let mut rest = all;
            parts.iter().for_each(|part| add(&mut rest, -1.0, &part.moments));
            parts.push(Part { cause: nonlinear.join(" and "), moments: rest });
            simulated.extend(nonlinear);
        }
        Ok(Real { channel: of.channel, parts, pairs: grid.pairs.len(), simulated })
    }

    /// Returns the moments of a line as it is sent, as far as held samples keep it.
    fn line(&self, line: Line) -> Moments {
        let setting = &self.asked.setting;
        let power = line.power * kept(self.of.held, line.frequency_hz, setting.rate_hz);
        of_line(Line { power, ..line }, setting.rate_hz, setting.align, self.grid)
    }

    /// Returns the moments of a course over the record, and the range of its values.
    fn course(&self, source: &Source) -> Result<(Moments, [f64; 2]), CostError> {
        let record = &self.asked.record;
        let mut next = samples(simulator(record, &self.of.alone(record.model, &source.effect), 0)?, self.of.channel);
        let windows = Windows::new(record.samples(), record.align, self.grid);
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        let moments = windows.moments(record.rate_hz, self.grid, || {
            let value = next();
            range = [range[0].min(value), range[1].max(value)];
            value
        });
        Ok((moments, range))
    }

    /// Returns the mean moments of the channel in simulations of a model over the record.
    fn simulated(&self, model: &SensorModel, effect: &str) -> Result<Moments, CostError> {
        let record = &self.asked.record;
        let windows = Windows::new(record.samples(), record.align, self.grid);
        let longest = record.align + self.grid.horizons.last().copied().unwrap_or(1);
        let runs = (WINDOWS_SIMULATED * longest as f64 / windows.samples() as f64).ceil().max(1.0);
        record.check_runs(effect, self.of.channel, runs as usize)?;
        let mut mean = vec![0.0; self.grid.pairs.len()];
        for run in 0..runs as u64 {
            let next = samples(simulator(record, model, record.seed.wrapping_add(run))?, self.of.channel);
            add(&mut mean, 1.0 / runs, &windows.moments(record.rate_hz, self.grid, next));
        }
        Ok(mean)
    }
}

/// Adds moments to the cause of that name.
fn gather(parts: &mut Vec<Part>, cause: String, moments: &[f64]) {
    match parts.iter_mut().find(|part| part.cause == cause) {
        Some(part) => add(&mut part.moments, 1.0, moments),
        None => parts.push(Part { cause, moments: moments.to_vec() }),
    }
}

/// Returns the name of a source's cause, with its frequency if it has one.
fn name(source: &Source) -> String {
    let inner = || source.effect.parameter("of").and_then(|of| of.get("frequency_hz")?.as_f64());
    let own = source.effect.number("frequency_hz").or_else(|| source.effect.number("fundamental_hz"));
    match own.or_else(inner) {
        Some(hz) if hz < 0.01 => format!("{} at {hz:.2e} Hz", source.cause),
        Some(hz) => format!("{} at {} Hz", source.cause, (hz * 1e4).round() / 1e4),
        None => source.cause.to_owned(),
    }
}

/// Returns the mean over the record of the factor on the power of white noise; of several changes, what the last one
/// adds.
fn mean_power(record: &Setting<'_>, factor: &Factor) -> f64 {
    let count = record.samples();
    let mean = |next: &mut dyn FnMut() -> f64| (0..count).map(|_| next()).sum::<f64>() / count as f64;
    match factor {
        Factor::Intervals(intervals) => {
            let mut is_inside = inside(intervals, record.rate_hz);
            mean(&mut || f64::from(u8::from(is_inside())))
        }
        Factor::Changes(changes) => {
            let before = if changes.len() > 1 { mean(&mut powers(record, &changes[..changes.len() - 1])) } else { 1.0 };
            mean(&mut powers(record, changes)) - before
        }
    }
}
