//! Translation: an explanation in a series' scale becomes effects of docs/formats.md, in the channel's unit.

use super::course::{Course, Follow};
use super::evidence::Kind;
use super::explanation::{Loud, Scedasticity, Sine};
use super::found::Findings;
use super::gated::Stays;
use super::law::{Shape, Term};
use super::modulated::Levels;
use super::variances::Ratio;
use super::wandering::Wander;
use imu_model::effects::intermittent::{Gated, Times};
use imu_model::effects::{
    BiasStep, Bursts, Comb, Effect, EffectKind, GaussMarkov, HeavyTails, Intermittent, LowPass, ModulatedBand,
    MovingAverage, PowerLaw, QuantizationNoise, RateRamp, Record, Resonance, Spikes, Stage, TemperatureBias, Tone,
    VarianceChange, WarmUp,
};
use imu_model::simulator::{ChannelModel, SensorModel, Spectrum};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// Returns the model's effects on a channel that the channel has too.
fn kept<'a>(of: &Findings, sim: &'a SensorModel) -> impl Iterator<Item = &'a Arc<dyn Effect>> {
    let own = sim.channels.get(&of.prepared.channel).map(|model| model.effects.as_slice()).unwrap_or_default();
    own.iter().enumerate().filter(|(place, _)| !of.explanation.without.contains(place)).map(|(_, effect)| effect)
}

/// Returns the part of a line's amplitude that passes all filters as the simulator has them: those that the channel shares
/// with its model, plus `further` ones.
fn passed(of: &Findings, sim: &SensorModel, further: &[Arc<dyn Effect>], frequency_hz: f64) -> f64 {
    let channel = of.prepared.channel;
    let filters = kept(of, sim).chain(further).filter(|effect| effect.stage() == Stage::Bandwidth).cloned();
    let line: Arc<dyn Effect> = Arc::new(Tone { frequency_hz, amplitude: 1.0 });
    let model = ChannelModel { effects: filters.chain([line]).collect(), ..ChannelModel::default() };
    let alone = SensorModel { channels: [(channel, model)].into(), triads: BTreeMap::new(), ..sim.clone() };
    let record = Record { rate_hz: sim.rate_hz, samples: of.prepared.samples.len() as u64 };
    let power: f64 = Spectrum::new(&alone, channel, record).lines().iter().map(|line| line.power).sum();
    (2.0 * power).sqrt().max(LEAST_PASSED)
}

/// Returns the delay of a step by all filters, s: the remaining ones of the model and the found ones.
fn delay_of_filters_s(of: &Findings, sim: &SensorModel) -> f64 {
    let internal_hz = sim.internal_rate_hz(sim.rate_hz);
    let found = of.explanation.law.terms.iter().filter_map(|term| term.effect(sim.rate_hz));
    kept(of, sim).map(|effect| delay_s(&**effect, internal_hz)).sum::<f64>()
        + found.map(|of| delay_s(&*of, sim.rate_hz)).sum::<f64>()
}

/// Returns a filter's delay of slow signals, s: (w − 1)/2 samples for a moving average; 1/(ω·sin(π/2n)) for
/// Butterworth's filter of order n and cutoff ω.
fn delay_s(effect: &dyn Effect, rate_hz: f64) -> f64 {
    let number = |name: &str| effect.number(name);
    match effect.kind() {
        EffectKind::MovingAverage => number("window").map_or(0.0, |window| 0.5 * (window - 1.0) / rate_hz),
        EffectKind::LowPass => {
            let (cutoff_hz, order) = (number("cutoff_hz").unwrap_or(f64::INFINITY), number("order").unwrap_or(1.0));
            1.0 / (std::f64::consts::TAU * cutoff_hz * (std::f64::consts::PI / (2.0 * order)).sin())
        }
        _ => 0.0,
    }
}

/// An effect in the channel's unit.
#[derive(Debug, Clone)]
pub struct Translated {
    /// Its kind.
    pub kind: Kind,
    /// The effect.
    pub effect: Arc<dyn Effect>,
    /// 95 % intervals of its parameters, if they are known.
    pub ci95: Vec<(&'static str, [f64; 2])>,
}

/// The 97.5 % point of the normal distribution.
const NORMAL_95: f64 = 1.959_964;

/// Returns value ± 1.96 standard errors.
fn about(value: f64, error: f64) -> [f64; 2] {
    [value - NORMAL_95 * error.abs(), value + NORMAL_95 * error.abs()]
}

/// Returns the interval on a logarithmic scale; `error` is the standard error of the logarithm.
fn times(value: f64, error: f64) -> [f64; 2] {
    let factor = (NORMAL_95 * error).min(50.0).exp();
    [value / factor, value * factor]
}

/// Possible error of a step's place behind a filter, as a part of the filter's delay.
const DELAY_ERROR: f64 = 0.25;
/// Possible error of the middle of a step's rise, in samples, if no sample of the rise is visible.
const RISE: f64 = 4.0;

/// Returns the first and last sample of a step's rise: the adjacent excluded samples about it.
fn rise(left_out: &[usize], at: usize) -> (usize, usize) {
    /// Maximum number of samples between two samples of one rise, and longest rise to either side.
    const APART: usize = 2;
    const LONGEST: usize = 40;
    let middle = left_out.partition_point(|own| *own < at);
    let mut first = at;
    for own in left_out[..middle].iter().rev().take_while(|own| at - **own <= LONGEST) {
        if first - own <= APART {
            first = *own;
        }
    }
    let mut last = at;
    for own in left_out[middle..].iter().take_while(|own| **own - at <= LONGEST) {
        if own - last <= APART {
            last = own + 1;
        }
    }
    (first, last)
}

/// If less than this part of a line passes the filters, its amplitude in front of them is not known: it has no interval.
pub(super) const LEAST_PASSED: f64 = 1e-4;
/// The highest frequency of a tone in a model, over the rate. It has to be below half the rate; no record shows the
/// difference.
const BELOW_HALF: f64 = 0.5 * (1.0 - 1e-9);

/// Returns the effects of an explanation; effects that the model has already are left out.
pub(super) fn effects(of: &Findings, temperature_c: f64, sim: &SensorModel) -> Vec<Translated> {
    let samples = of.prepared.samples.len();
    let mut all = Translation { of, sim, rate_hz: sim.rate_hz, scale: of.prepared.scale, samples, found: Vec::new() };
    all.courses(temperature_c);
    let spectral = all.spectral();
    all.lines(&spectral);
    for (kind, effect, ci95) in spectral {
        all.add(kind, effect, ci95);
    }
    all.tails();
    all.loud();
    all.variances(temperature_c);
    all.spikes();
    all.found
}

/// An explanation on its way to effects in the channel's unit.
struct Translation<'a> {
    of: &'a Findings,
    sim: &'a SensorModel,
    rate_hz: f64,
    /// The channel's unit for a unit of the series.
    scale: f64,
    samples: usize,
    found: Vec<Translated>,
}

impl Translation<'_> {
    fn add(&mut self, kind: Kind, effect: Arc<dyn Effect>, mut ci95: Intervals) {
        // If no error is known, there is no interval.
        ci95.retain(|(_, [low, high])| low < high && low.is_finite() && high.is_finite());
        self.found.push(Translated { kind, effect, ci95 });
    }

    fn courses(&mut self, temperature_c: f64) {
        let Findings { prepared, explanation, spread, .. } = self.of;
        let (rate_hz, scale) = (self.rate_hz, self.scale);
        let courses = explanation.courses.iter().zip(&spread.courses).skip(prepared.shifts.len());
        // The effects that follow the temperature without play are one effect.
        let mut warm: Option<(TemperatureBias, Intervals)> = None;
        for ((course, factor), (error, second)) in courses {
            let (size, error) = (factor * scale, error * scale);
            match course {
                Course::Ramp => {
                    let per_s = rate_hz / self.samples as f64;
                    let r = size * per_s;
                    self.add(Kind::RateRamp, Arc::new(RateRamp { r }), vec![("R", about(r, error * per_s))]);
                }
                Course::Temperature | Course::Follows(Follow::Square | Follow::Rate(_)) => {
                    let bias = warm.get_or_insert_with(|| (TemperatureBias::linear(0.0, temperature_c), Vec::new()));
                    let (name, number, factor) = match course {
                        Course::Follows(Follow::Square) => ("per_c2", &mut bias.0.per_c2, 1.0),
                        Course::Follows(_) => ("per_c_per_s", &mut bias.0.per_c_per_s, 1.0 / rate_hz),
                        _ => ("per_c", &mut bias.0.per_c, 1.0),
                    };
                    *number = factor * size;
                    bias.1.push((name, about(factor * size, factor * error)));
                }
                Course::Follows(Follow::Play(play_c)) => {
                    let effect = TemperatureBias { play_c: *play_c, ..TemperatureBias::linear(size, temperature_c) };
                    self.add(Kind::TemperatureBias, Arc::new(effect), vec![("per_c", about(size, error))]);
                }
                Course::WarmUp(tau) => {
                    let tau_s = tau / rate_hz;
                    let ci95 = vec![("amplitude", about(size, error)), ("tau_s", times(tau_s, *second))];
                    self.add(Kind::WarmUp, Arc::new(WarmUp { amplitude: size, tau_s }), ci95);
                }
                Course::Step(at) => self.step(*at, [size, error], *second),
            }
        }
        if let Some((bias, ci95)) = warm {
            self.add(Kind::TemperatureBias, Arc::new(bias), ci95);
        }
    }

    /// Adds a step of this size, with its error and that of its place.
    fn step(&mut self, at: usize, [size, error]: [f64; 2], place_error: f64) {
        // The step shows half way up, behind all filters.
        let delay_s = delay_of_filters_s(self.of, self.sim);
        let (first, last) = rise(&self.of.explanation.outliers, at);
        let seconds = |sample: usize| sample as f64 / self.rate_hz - delay_s;
        let at_s = (0.5 * (seconds(first) + seconds(last))).max(0.0);
        // Its course is unknown until the end of the rise.
        let rises_s = (0.5 * (last - first) as f64).max(RISE) / self.rate_hz / NORMAL_95;
        let at_error = (place_error / self.rate_hz).hypot(rises_s) + DELAY_ERROR * delay_s;
        let ci95 = vec![("at_s", about(at_s, at_error)), ("size", about(size, error))];
        self.add(Kind::BiasStep, Arc::new(BiasStep { at_s, size }), ci95);
    }

    /// Returns the channel's unit of white noise, the rates and the scale, as [`spectral`] takes them.
    fn units(&self) -> [f64; 4] {
        let white = (0.5 * self.of.explanation.law.levels[0]).exp() * self.scale;
        [self.scale, white, self.rate_hz, self.sim.internal_rate_hz(self.rate_hz)]
    }

    fn spectral(&self) -> Vec<Spectral> {
        let Findings { explanation, spread, levels, stays, wanders, .. } = self.of;
        let (rate_hz, scale) = (self.rate_hz, self.scale);
        let terms = explanation.law.terms.iter().zip(&spread.terms).enumerate();
        terms
            .filter_map(|(place, (term, errors))| {
                let found = spectral(term, errors, self.units())?;
                if let Some(stays) = stays.iter().find(|stays| stays.term == place) {
                    let delay_s = delay_of_filters_s(self.of, self.sim);
                    return gated_band(found, stays, [self.samples as f64, rate_hz], delay_s);
                }
                if let Some(wander) = wanders.iter().find(|wander| wander.term == place) {
                    return Some(wandering(term, found, wander, scale, rate_hz));
                }
                let level = levels.iter().find(|levels| levels.term == place);
                Some(level.map_or(found.clone(), |level| modulated(term, found, level, scale, rate_hz)))
            })
            .collect()
    }

    fn lines(&mut self, spectral: &[Spectral]) {
        let Findings { prepared, explanation, spread, .. } = self.of;
        let (rate_hz, scale) = (self.rate_hz, self.scale);
        let filters: Vec<Arc<dyn Effect>> = spectral.iter().map(|(_, effect, _)| Arc::clone(effect)).collect();
        // The filters with numbers off by a standard error.
        let off = |(term, errors): (&Term, &Vec<f64>)| {
            let numbers = term.numbers.iter().zip(errors).map(|(number, error)| number + error.min(1.0)).collect();
            self::spectral(&Term { shape: term.shape, numbers }, errors, self.units()).map(|(_, effect, _)| effect)
        };
        let filters_off: Vec<Arc<dyn Effect>> =
            explanation.law.terms.iter().zip(&spread.terms).filter_map(off).collect();
        let own = explanation.sines.get(prepared.sines.len()..).unwrap_or_default();
        let errors = spread.sines.get(prepared.sines.len()..).unwrap_or_default();
        // The record has a line behind the filters, the model in front of them.
        let in_front = |cycles: f64, cycles_error: f64, [seen, seen_error]: [f64; 2]| {
            let frequency_hz = (cycles * rate_hz).min(BELOW_HALF * rate_hz);
            let gain = passed(self.of, self.sim, &filters, frequency_hz);
            let is_known = gain > LEAST_PASSED;
            let off = passed(self.of, self.sim, &filters_off, frequency_hz);
            let gain_error = if is_known { (off / gain).ln() } else { f64::INFINITY };
            let scale = scale / gain;
            LineFound {
                frequency_hz,
                amplitude: scale * seen,
                frequency_error_hz: cycles_error * rate_hz,
                amplitude_error: scale * seen_error.hypot(seen * gain_error),
            }
        };
        let sine = |(sine, (cycles, amplitude)): (&Sine, &(f64, f64))| {
            in_front(sine.cycles, *cycles, [sine.amplitude(), *amplitude])
        };
        let lines: Vec<LineFound> = own.iter().zip(errors).map(sine).collect();
        let gated: Vec<LineFound> = explanation
            .gated
            .iter()
            .zip(&spread.gated)
            .map(|(sine, (cycles_error, amplitude))| in_front(sine.cycles, *cycles_error, *amplitude))
            .collect();
        for (sine, line) in explanation.gated.iter().zip(gated) {
            let tone = Tone { frequency_hz: line.frequency_hz, amplitude: line.amplitude };
            let ci95 = vec![
                ("of.frequency_hz", about(line.frequency_hz, line.frequency_error_hz)),
                ("of.amplitude", about(line.amplitude, line.amplitude_error)),
            ];
            let ranges = sine.stays.iter().map(|stay| stay.from..stay.to);
            let times = times_of(ranges, rate_hz, delay_of_filters_s(self.of, self.sim));
            self.add(Kind::Intermittent, Arc::new(Intermittent { of: Gated::Tone(tone), times }), ci95);
        }
        let (combs, tones) = combs(&lines, rate_hz / self.samples as f64);
        for (comb, error_hz) in combs {
            let ci95 = vec![("fundamental_hz", about(comb.fundamental_hz, error_hz))];
            self.add(Kind::Tone, Arc::new(comb), ci95);
        }
        for line in tones {
            let effect = Tone { frequency_hz: line.frequency_hz, amplitude: line.amplitude };
            let ci95 = vec![
                ("frequency_hz", about(line.frequency_hz, line.frequency_error_hz)),
                ("amplitude", about(line.amplitude, line.amplitude_error)),
            ];
            self.add(Kind::Tone, Arc::new(effect), ci95);
        }
    }

    fn tails(&mut self) {
        let Findings { prepared, explanation, spread, .. } = self.of;
        if let Some(degrees) = explanation.tails
            && !prepared.has.contains(&EffectKind::HeavyTails)
        {
            let ci95 = times(degrees, spread.tails);
            let effect = HeavyTails { degrees_of_freedom: degrees };
            self.add(Kind::HeavyTails, Arc::new(effect), vec![("degrees_of_freedom", [ci95[0].max(2.0), ci95[1]])]);
        }
    }

    fn loud(&mut self) {
        let Findings { prepared, explanation, spread, average_variance, ratios, .. } = self.of;
        let rate_hz = self.rate_hz;
        let seconds = |sample: usize| sample as f64 / rate_hz;
        let loud = explanation.loud.iter().zip(ratios).skip(prepared.loud.len());
        let white = (0.5 * explanation.law.levels[0]).exp() * (rate_hz / average_variance).sqrt() * self.scale;
        let errors = spread.loud.get(prepared.loud.len()..).unwrap_or_default();
        let (intervals, bursts): (Vec<_>, Vec<_>) =
            loud.zip(errors).partition(|((of, _), _)| of.is_interval(self.samples, &prepared.bursts));
        let bursts: Vec<(&Loud, &Ratio)> = bursts.into_iter().map(|(of, _)| of).collect();
        for ((one, ratio), error) in intervals {
            let (from_s, to_s) = (seconds(one.from), seconds(one.to));
            let change = VarianceChange::Interval { from_s, to_s, factor: ratio.factor.sqrt() };
            let end = (5.5 * spread.squares / divergence(one.ratio) + 1.0) / NORMAL_95 / rate_hz;
            let ci95 = vec![
                ("from_s", about(from_s, end)),
                ("to_s", about(to_s, end)),
                ("factor", times(ratio.factor.sqrt(), error * ratio.error)),
            ];
            self.add(Kind::VarianceInterval, Arc::new(change), ci95);
        }
        if !bursts.is_empty() {
            let (sum, errors, count) = bursts.iter().fold((0.0, 0.0, 0.0), |(sum, errors, count), (of, ratio)| {
                let width = (of.to - of.from) as f64;
                let more = width * ratio.usual * (ratio.factor - 1.0).max(0.0);
                (sum + more, errors + width * ratio.usual * ratio.factor * ratio.error, count + width)
            });
            let excess = sum / count;
            let sigma = white * excess.sqrt();
            let intervals = bursts.iter().map(|(of, _)| (seconds(of.from), seconds(of.to))).collect();
            let error = (0.5 / count).sqrt() * errors / sum.max(1e-6 * count);
            self.add(Kind::Bursts, Arc::new(Bursts { intervals, sigma }), vec![("sigma", times(sigma, error))]);
        }
    }

    fn variances(&mut self, temperature_c: f64) {
        if self.of.prepared.scedasticity.is_some() {
            return;
        }
        match &self.of.explanation.scedasticity {
            Some(Scedasticity::PerDegree(slope)) => {
                let change = VarianceChange::PerDegree { per_c: 0.5 * slope, reference_c: temperature_c };
                let ci95 = vec![("per_c", about(0.5 * slope, 0.5 * self.of.spread.per_degree))];
                self.add(Kind::VariancePerDegree, Arc::new(change), ci95);
            }
            Some(Scedasticity::Profile(values)) => {
                let last = (values.len().max(2) - 1) as f64;
                let length_s = self.samples as f64 / self.rate_hz;
                let at = |index: usize| index as f64 / last * length_s;
                let points = values.iter().enumerate().map(|(i, value)| (at(i), (0.5 * value).exp())).collect();
                self.add(Kind::VarianceProfile, Arc::new(VarianceChange::Profile(points)), Vec::new());
            }
            None => {}
        }
    }

    fn spikes(&mut self) {
        let Findings { prepared, explanation, .. } = self.of;
        if let Some(spikes) = explanation.spikes
            && !prepared.has.contains(&EffectKind::Spikes)
        {
            let (per_s, size) = (spikes.rate * self.rate_hz, spikes.size * self.scale);
            let error = (1.0 / (spikes.rate * self.samples as f64).max(1.0)).sqrt();
            let ci95 = vec![("rate_hz", times(per_s, error)), ("amplitude", times(size, spikes.relative_error))];
            self.add(Kind::Spikes, Arc::new(Spikes::new(per_s, size)), ci95);
        }
    }
}

/// Returns the nats by which one sample distinguishes two variances of this ratio, for the variance that it
/// distinguishes less (Kullback and Leibler 1951). The place of a change is known within 5.5 over that in 95 %, as that
/// of a small step is within 11 times the squared ratio of noise to step (Yao 1987): both follow from a random walk
/// with that drift.
fn divergence(ratio: f64) -> f64 {
    let of = |ratio: f64| 0.5 * (ratio - 1.0 - ratio.ln());
    of(ratio).min(of(1.0 / ratio)).max(1e-4)
}

/// A line in the channel's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
struct LineFound {
    frequency_hz: f64,
    amplitude: f64,
    frequency_error_hz: f64,
    amplitude_error: f64,
}

/// 95 % intervals of parameters by their names.
type Intervals = Vec<(&'static str, [f64; 2])>;
/// An effect of the spectrum with the intervals of its parameters.
type Spectral = (Kind, Arc<dyn Effect>, Intervals);

/// Translates a band whose level changes.
fn modulated(term: &Term, (kind, _, ci95): Spectral, levels: &Levels, scale: f64, rate_hz: f64) -> Spectral {
    let band = Resonance::new(term.at(1), term.at(2).exp(), (0.5 * term.at(0)).exp() * scale);
    let level = levels.points.iter().map(|(sample, factor)| (sample / rate_hz, *factor)).collect();
    // Such a band is symmetric.
    let ci95 = ci95.into_iter().filter(|(name, _)| *name != "asymmetry").collect();
    (kind, Arc::new(ModulatedBand { band, level }), ci95)
}

/// Returns the times at which an effect is present in front of filters of this delay.
fn times_of(ranges: impl Iterator<Item = Range<usize>>, rate_hz: f64, delay_s: f64) -> Times {
    let second = |at: usize| (at as f64 / rate_hz - delay_s).max(0.0);
    let intervals = ranges.map(|range| (second(range.start), second(range.end)));
    Times::Intervals(intervals.filter(|(from_s, to_s)| from_s < to_s).collect())
}

/// Translates a band of noise that comes and goes. Its spectrum is that of the whole record: the variance is less by the part of
/// the record in which it is present, and the band is wider by the width of a stay. As much less of the record determines it.
fn gated_band(
    (kind, band, ci95): Spectral,
    stays: &Stays,
    [samples, rate_hz]: [f64; 2],
    delay_s: f64,
) -> Option<Spectral> {
    /// Part of the width that is the band's own at least.
    const LEAST: f64 = 0.1;
    let number = |name: &str| band.number(name);
    let (frequency_hz, all_hz, all) = (number("frequency_hz")?, number("bandwidth_hz")?, number("sigma")?);
    let wider = (samples / stays.samples() as f64).sqrt();
    let stay_s = stays.samples() as f64 / stays.ranges.len() as f64 / rate_hz;
    let bandwidth_hz = (all_hz - 1.0 / (std::f64::consts::PI * stay_s)).max(LEAST * all_hz);
    let sigma = all * wider;
    let own = |(name, ends): (&'static str, [f64; 2])| match name {
        "sigma" => Some(("of.sigma", ends.map(|end| sigma * (end / all).powf(wider)))),
        // The width of the stays is known.
        "bandwidth_hz" if bandwidth_hz > LEAST * all_hz => {
            let own_hz = |end: f64| (bandwidth_hz + all_hz * ((end / all_hz).powf(wider) - 1.0)).max(0.0);
            Some(("of.bandwidth_hz", ends.map(own_hz)))
        }
        "frequency_hz" => Some(("of.frequency_hz", ends.map(|end| frequency_hz + wider * (end - frequency_hz)))),
        _ => None,
    };
    let of = Gated::Resonance(Resonance::new(frequency_hz, bandwidth_hz, sigma));
    let times = times_of(stays.ranges.iter().cloned(), rate_hz, delay_s);
    Some((kind, Arc::new(Intermittent { of, times }), ci95.into_iter().filter_map(own).collect()))
}

/// Translates a band that is a wandering line. The record shows its frequency and amplitude; the other numbers only
/// reproduce its spectrum.
fn wandering(term: &Term, (kind, _, ci95): Spectral, wander: &Wander, scale: f64, rate_hz: f64) -> Spectral {
    let sigma = (0.5 * term.at(0)).exp() * scale;
    let line = wander.line(term.at(1), term.at(2).exp(), sigma, rate_hz);
    let shown = |(name, [low, high]): (&'static str, [f64; 2])| match name {
        "sigma" => Some(("amplitude", [low, high].map(|of| of / sigma * line.amplitude))),
        "frequency_hz" => Some((name, [low, high])),
        _ => None,
    };
    (kind, Arc::new(line), ci95.into_iter().filter_map(shown).collect())
}

/// Translates a term to the channel's unit. `units` are its scale, N of the channel in U/√Hz, and the output's and the
/// internal rate in Hz.
fn spectral(term: &Term, errors: &[f64], units: [f64; 4]) -> Option<Spectral> {
    let [scale, white, rate_hz, internal_hz] = units;
    /// White noise behind a filter below this part of N (ln of the squares) counts as absent: the record does not show
    /// it.
    const SILENT: f64 = -16.0;
    let behind = term.floor().filter(|floor| floor.ln() > SILENT).map_or(0.0, |floor| white * floor.sqrt());
    // The last number of a filter.
    let of_behind = |error: f64| (behind > 0.0 && error < 1.0).then(|| ("white_behind", times(behind, 0.5 * error)));

    let at = |index: usize| term.at(index);
    let error = |index: usize| errors.get(index).copied().unwrap_or_default();
    let size = |index: usize| (0.5 * at(index)).exp() * scale;
    Some(match term.shape {
        Shape::QuantizationNoise => {
            let q = size(0);
            (Kind::QuantizationNoise, Arc::new(QuantizationNoise { q }), vec![("Q", times(q, 0.5 * error(0)))])
        }
        Shape::GaussMarkov => {
            let (sigma, tc_s) = (size(0), at(1).exp());
            let ci95 = vec![("sigma", times(sigma, 0.5 * error(0))), ("tc_s", times(tc_s, error(1)))];
            (Kind::GaussMarkov, Arc::new(GaussMarkov { sigma, tc_s }), ci95)
        }
        Shape::Resonance => {
            let (sigma, frequency_hz, bandwidth_hz) = (size(0), at(1), at(2).exp());
            let line = Resonance::new(frequency_hz, bandwidth_hz, sigma);
            let most = line.most_asymmetric(rate_hz);
            // A resonance found at the output's rate acts at the internal one. A standard error away, it may be beyond
            // half the rate.
            let possible = line.most_asymmetric(internal_hz);
            let asymmetry = (at(3) * most).max(-possible).min(possible);
            let mut ci95 = vec![
                ("sigma", times(sigma, 0.5 * error(0))),
                ("frequency_hz", about(frequency_hz, error(1))),
                ("bandwidth_hz", times(bandwidth_hz, error(2))),
            ];
            if asymmetry != 0.0 {
                ci95.push(("asymmetry", about(asymmetry, most * error(3))));
            }
            (Kind::Resonance, Arc::new(Resonance { asymmetry, ..line }), ci95)
        }
        Shape::LowPass(order) => {
            let cutoff_hz = at(0).exp();
            let ci95 = [("cutoff_hz", times(cutoff_hz, error(0)))].into_iter().chain(of_behind(error(1)));
            (Kind::LowPass, Arc::new(LowPass { cutoff_hz, order, white_behind: behind }), ci95.collect())
        }
        Shape::MovingAverage(window) => {
            let effect = MovingAverage { window, white_behind: behind };
            (Kind::MovingAverage, Arc::new(effect), of_behind(error(0)).into_iter().collect())
        }
        Shape::Slope(_) => {
            let alpha = Some(at(1)).filter(|alpha| Shape::POWER_LAW.contains(alpha))?;
            let density = size(0).powi(2) / rate_hz;
            let effect = PowerLaw { alpha, at_hz: Shape::MIDDLE * rate_hz, density };
            let ci95 = vec![("alpha", about(alpha, error(1))), ("density", times(density, error(0)))];
            (Kind::Slope, Arc::new(effect), ci95)
        }
    })
}

/// Splits lines into combs and tones. Lines at whole multiples of the lowest of them, within the resolution of a record
/// of 1/`resolution_hz`, are one comb, with the standard error of its fundamental. The others are tones.
fn combs(lines: &[LineFound], resolution_hz: f64) -> (Vec<(Comb, f64)>, Vec<LineFound>) {
    const HARMONICS: f64 = 12.0;
    let mut left: Vec<LineFound> = lines.to_vec();
    left.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    let mut combs = Vec::new();
    let mut index = 0;
    while index < left.len() {
        let fundamental_hz = left[index].frequency_hz;
        let order = |line: &LineFound| {
            let order = (line.frequency_hz / fundamental_hz).round();
            let near = (line.frequency_hz - order * fundamental_hz).abs() < 0.25 * order * resolution_hz;
            (near && order <= HARMONICS).then_some(order as usize)
        };
        let harmonics: Vec<(usize, LineFound)> = left.iter().filter_map(|line| Some((order(line)?, *line))).collect();
        let orders: std::collections::BTreeSet<usize> = harmonics.iter().map(|(order, _)| *order).collect();
        if orders.len() < 2 || orders.len() < harmonics.len() {
            index += 1;
            continue;
        }
        let highest = harmonics.iter().map(|(order, _)| *order).max().unwrap_or(1);
        let mut amplitudes = vec![0.0; highest];
        // Each harmonic determines the fundamental by its order and its own error.
        let (mut sum, mut weights) = (0.0, 0.0);
        for (order, line) in &harmonics {
            amplitudes[order - 1] = line.amplitude;
            let error_hz = line.frequency_error_hz / *order as f64;
            let weight = 1.0 / (error_hz * error_hz).max(f64::MIN_POSITIVE);
            sum += weight * line.frequency_hz / *order as f64;
            weights += weight;
        }
        combs.push((Comb { fundamental_hz: sum / weights, amplitudes }, (1.0 / weights).sqrt()));
        left.retain(|line| order(line).is_none());
    }
    (combs, left)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The filter's amplitude is computed with every number a standard error off.
    #[test]
    fn a_band_beyond_half_the_rate_has_an_effect_and_no_panic() {
        let term = Term { shape: Shape::Resonance, numbers: vec![0.0, 20.5, 0.0, 0.5] };
        assert!(spectral(&term, &[0.1; 4], [1.0, 1.0, 40.0, 40.0]).is_some());
    }

    #[test]
    fn harmonics_are_one_comb_and_others_stay_tones() {
        let line = |frequency_hz, amplitude| LineFound {
            frequency_hz,
            amplitude,
            frequency_error_hz: 1e-5 / amplitude,
            amplitude_error: 0.01,
        };
        let lines = [line(3.1, 1.0), line(12.4001, 0.2), line(5.0, 0.7), line(9.3, 0.5), line(7.77, 0.1)];
        let (combs, tones) = combs(&lines, 0.001);
        assert_eq!(combs.len(), 1);
        assert_eq!(combs[0].0.amplitudes, [1.0, 0.0, 0.5, 0.2]);
        assert!((combs[0].0.fundamental_hz - 3.1).abs() < 1e-4 && combs[0].1 < 1e-5);
        assert_eq!(tones.iter().map(|line| line.frequency_hz).collect::<Vec<_>>(), [5.0, 7.77]);
    }
}
