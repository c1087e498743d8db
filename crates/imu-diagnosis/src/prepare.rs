//! Preparation: turns a recording and a model into series of samples in which the model's own effects are explained.

use super::averages::{mean, median, scale_of};
use super::course::{Course, Courses};
use super::declared::courses::shifts_of;
use super::dither;
use super::error::DiagnosisError;
use super::explanation::{Loud, Scedasticity, Sine};
use super::facts::{self, Facts, Repeats};
use super::filling;
use super::gated;
use super::law::{Law, Term, reach};
use super::recording::Recording;
use super::rounded;
use super::series::{BaseOf, Setting};
use super::transform::Cosines;
use imu_core::sample::{Channel, Triad};
use imu_model::effects::temperature_bias::RATE_LAG_S;
use imu_model::effects::{At, Effect, EffectKind, Line, Record, Stage, USUAL_TEMPERATURE_C, profile};
use imu_model::simulator::{ChannelModel, SensorModel, Spectrum};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

pub use super::prepared::{Prepared, base_of};

/// Minimum number of samples for a diagnosis.
pub const LEAST: usize = 1000;
/// Maximum time over which a rounded temperature is smoothed, s, and number of steps that the temperature moves in the
/// smoothing time.
const SMOOTHED_S: f64 = 60.0;
const STEPS: f64 = 3.0;
/// The temperature's rate is computed from means over this time, s: single readings alternate between two steps.
const MOVES_S: f64 = 10.0;

/// The factor by which the differences from sample to sample may exceed the declared white noise and still count as white noise.
/// Larger differences are lines, or white noise in another unit.
const LOUDER: f64 = 20.0;
/// Random stream of the repeats that are left out.
const HELD: u16 = 8;

/// All channels, and the data of the record.
#[derive(Debug)]
pub struct Ready {
    /// Channels in the model's order.
    pub channels: Vec<Prepared>,
    /// The courses.
    pub courses: Courses,
    /// The transform.
    pub transform: Cosines,
    /// By triad (or single channel): repeats that are not due to chance.
    pub repeats: Vec<(Vec<Channel>, Repeats)>,
    /// The channels that the recording has and the model lacks.
    pub further: Vec<Channel>,
    /// Samples per second.
    pub rate_hz: f64,
    /// Mean temperature, °C, that effects refer to.
    pub reference_c: f64,
}

impl Ready {
    /// Returns the record's data for one of its channels.
    pub(super) fn setting<'a>(&'a self, prepared: &'a Prepared, base: BaseOf<'a>) -> Setting<'a> {
        Setting {
            courses: &self.courses,
            base,
            declared: &prepared.spectral,
            wandering: &prepared.wandering,
            white: prepared.declared.levels[0],
            priors: prepared.priors,
            rate_hz: self.rate_hz,
            bursts: &prepared.bursts,
            shifts: prepared.shifts.len(),
            reach: prepared.reach,
            owner: prepared.channel as u32,
            gated: &prepared.gated,
            gates: false,
        }
    }
}

/// Prepares a recording and a model together.
///
/// # Errors
/// [`DiagnosisError`] if the inputs cannot be compared.
pub fn prepare(real: &Recording, sim: &SensorModel) -> Result<Ready, DiagnosisError> {
    let wanted = comparable(real, sim)?;
    let n = real.len();
    let missing: Vec<usize> =
        real.missing.iter().enumerate().filter(|(_, missing)| **missing).map(|(t, _)| t).collect();
    let mut transform = Cosines::new(n);
    let (temperature, reading_c) = temperature(real).unzip();
    let reference_c = temperature.as_ref().map(|values| values.iter().sum::<f64>() / n as f64);
    let about: Option<Vec<f64>> =
        temperature.as_ref().zip(reference_c).map(|(values, mean)| values.iter().map(|value| value - mean).collect());
    let mut courses = Courses::new(&mut transform, about.as_deref(), RATE_LAG_S * sim.rate_hz);
    courses.reading_c = reading_c.unwrap_or_default();
    let repeats = repeats(real, &wanted);
    let mut channels = Vec::new();
    for channel in wanted {
        let Some(model) = sim.channels.get(&channel) else { continue };
        let held = repeats.iter().filter(|(own, _)| own.contains(&channel));
        let held = held.flat_map(|(own, of)| beyond_chance(of, n, own[0]));
        let outliers: Vec<usize> = missing.iter().copied().chain(held).collect();
        channels.push(channel_of(real, sim, channel, model, outliers, temperature.as_deref())?);
    }
    let further = real.channels.iter().map(|(channel, _)| *channel);
    let further = further.filter(|channel| !sim.channels.contains_key(channel)).collect();
    Ok(Ready {
        channels,
        courses,
        transform,
        repeats,
        further,
        rate_hz: sim.rate_hz,
        reference_c: reference_c.unwrap_or(USUAL_TEMPERATURE_C),
    })
}

/// Rates that differ by less than this are one rate by two clocks. The clocks of a sensor and a host each run within
/// 1e-4 of true time, stamps give a rate within 1e-4, and a model has the configured rate. A VN-100 differed from that
/// rate by 1.9e-4 (40 Hz, 39.9926 Hz by its host).
const SAME_RATE_WITHIN: f64 = 5e-4;

/// Returns whether two rates are one by two clocks.
pub fn is_same_rate(one_hz: f64, other_hz: f64) -> bool {
    one_hz.is_finite() && (one_hz / other_hz - 1.0).abs() <= SAME_RATE_WITHIN
}

/// Checks that a recording and a model have the same rate, before any work is done.
///
/// # Errors
/// [`DiagnosisError::Rate`] with both rates.
pub fn same_rate(found_hz: f64, expected_hz: f64) -> Result<(), DiagnosisError> {
    if is_same_rate(found_hz, expected_hz) { Ok(()) } else { Err(DiagnosisError::Rate { found_hz, expected_hz }) }
}

/// Returns checks whether a recording and a model can be compared, and returns the compared channels.
///
/// # Errors
/// [`DiagnosisError`] if the inputs cannot be compared.
pub(super) fn comparable(real: &Recording, sim: &SensorModel) -> Result<Vec<Channel>, DiagnosisError> {
    let n = real.len();
    same_rate(real.rate_hz, sim.rate_hz)?;
    if n < LEAST {
        return Err(DiagnosisError::TooShort { found: n, least: LEAST, least_s: LEAST as f64 / sim.rate_hz });
    }
    sim.check(sim.rate_hz).map_err(|fault| DiagnosisError::Model(fault.to_string()))?;
    for (channel, values) in &real.channels {
        if values.len() != n {
            return Err(DiagnosisError::Lengths { channel: channel.to_string(), found: values.len(), expected: n });
        }
        // A channel with a few values that are not numbers is accepted without these values. A channel with many of
        // them is refused.
        let bad: Vec<usize> = (0..n).filter(|t| !values[*t].is_finite() && !real.is_missing(*t)).collect();
        if let Some(index) = bad.first().copied().filter(|first| bad.len() * 10 > n || values[*first].is_infinite()) {
            let value = &values[index];
            return Err(DiagnosisError::NotFinite { channel: channel.to_string(), value: *value, index });
        }
    }
    let wanted: Vec<Channel> =
        sim.channels.keys().copied().filter(|channel| *channel != Channel::Temperature).collect();
    for channel in &wanted {
        if real.values(*channel).is_none() {
            let found: Vec<&str> = real.channels.iter().map(|(channel, _)| channel.name()).collect();
            return Err(DiagnosisError::MissingChannel { channel: channel.to_string(), found: found.join(", ") });
        }
    }
    Ok(wanted)
}

/// Returns the temperature with its gaps filled, smoothed if it moves in steps, and the step, °C. `None` if the
/// temperature is constant.
pub(super) fn temperature(real: &Recording) -> Option<(Vec<f64>, f64)> {
    let read = real.temperature_c.as_ref().filter(|read| read.len() == real.len())?;
    let mut filled = read.clone();
    let mut last =
        read.iter().enumerate().find(|(t, value)| value.is_finite() && !real.is_missing(*t)).map(|(_, v)| *v)?;
    for (t, value) in filled.iter_mut().enumerate() {
        if value.is_finite() && !real.is_missing(t) {
            last = *value;
        } else {
            *value = last;
        }
    }
    let (low, high) = filled.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    if high - low <= 0.0 {
        return None;
    }
    // Wide enough for several steps of the readings, narrow enough for the temperature's own course.
    let step = facts::of(&filled).step.unwrap_or(0.0);
    let block = ((MOVES_S * real.rate_hz) as usize).clamp(1, filled.len());
    let means: Vec<f64> = filled.chunks_exact(block).map(|of| of.iter().sum::<f64>() / block as f64).collect();
    let moved: f64 = means.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum();
    let per_s = moved / filled.len() as f64 * real.rate_hz;
    let wide_s = (STEPS * step / per_s.max(f64::MIN_POSITIVE)).clamp(1.0, SMOOTHED_S);
    let width = ((wide_s * real.rate_hz) as usize).min(filled.len() / 8);
    Some((smoothed(&filled, width), step))
}

/// Fits parabolas to `width` samples about each sample (Savitzky and Golay 1964, Anal. Chem. 36), by way of means over
/// a sixteenth of the width; fewer samples at the ends.
fn smoothed(values: &[f64], width: usize) -> Vec<f64> {
    const PARTS: usize = 16;
    let size = (width / PARTS).max(1);
    let means: Vec<f64> = values.chunks(size).map(|part| part.iter().sum::<f64>() / part.len() as f64).collect();
    let count = means.len();
    let at = |place: usize| {
        let half = (PARTS / 2).min(place).min(count - 1 - place);
        if half < 2 {
            return means[place];
        }
        let (mut sum, mut second) = (0.0, 0.0);
        for (x, mean) in (-(half as i32)..=half as i32).zip(&means[place - half..=place + half]) {
            sum += mean;
            second += f64::from(x * x) * mean;
        }
        let (h, n) = (half as f64, (2 * half + 1) as f64);
        let square = h * (h + 1.0) * n / 3.0;
        let fourth = square * (3.0 * h * (h + 1.0) - 1.0) / 5.0;
        (fourth * sum - square * second) / (n * fourth - square * square)
    };
    let smooth: Vec<f64> = (0..count).map(at).collect();
    // Interpolates linearly between the parts' middles; the last part may be shorter.
    (0..values.len())
        .map(|t| {
            let place = ((t as f64 + 0.5) / size as f64 - 0.5).max(0.0);
            let from = (place as usize).min(count - 1);
            let to = (from + 1).min(count - 1);
            smooth[from] + (place - from as f64).min(1.0) * (smooth[to] - smooth[from])
        })
        .collect()
}

/// Returns the channels that repeat together, and where.
fn repeats(real: &Recording, wanted: &[Channel]) -> Vec<(Vec<Channel>, Repeats)> {
    const PROOF: f64 = 14.0;
    let mut groups: BTreeMap<Option<Triad>, Vec<Channel>> = BTreeMap::new();
    let mut found = Vec::new();
    let there: Vec<usize> = (0..real.len()).filter(|t| !real.is_missing(*t)).collect();
    for channel in wanted {
        groups.entry(channel.triad()).or_default().push(*channel);
    }
    let singles = groups.remove(&None).unwrap_or_default().into_iter().map(|channel| vec![channel]);
    for group in groups.into_values().chain(singles) {
        let sent = |channel: &Channel| real.sent(*channel).or_else(|| real.values(*channel));
        let columns: Vec<&[f64]> = group.iter().filter_map(sent).collect();
        let of = if there.len() == real.len() { facts::repeats(&columns) } else { among(&columns, &there) };
        if of.gain > PROOF && of.places.len() >= 3 {
            found.push((group, of));
        }
    }
    found
}

/// Returns the repeats among the samples that are there; those after a missing sample do not count.
fn among(columns: &[&[f64]], there: &[usize]) -> Repeats {
    let present: Vec<Vec<f64>> = columns.iter().map(|column| there.iter().map(|t| column[*t]).collect()).collect();
    let of = facts::repeats(&present.iter().map(Vec::as_slice).collect::<Vec<_>>());
    let is_near = |at: usize| there[at] == there[at - 1] + 1;
    let near = of.places.iter().zip(&of.by_chance).filter(|(at, _)| is_near(**at));
    let (places, by_chance) = near.map(|(at, chance)| (there[*at], *chance)).unzip();
    Repeats { places, by_chance, pairs: (1..there.len()).filter(|at| is_near(*at)).count(), gain: of.gain }
}

/// Returns the repeats, at random, without those that are likely to be due to chance. If all were left out, neighbours that are equal
/// by chance would be missing from the rest, which would look bluer than it is.
fn beyond_chance(repeats: &Repeats, samples: usize, channel: Channel) -> Vec<usize> {
    let mut stream = filling::stream(samples, channel as u32, HELD);
    let all = repeats.places.iter().zip(&repeats.by_chance);
    all.filter(|(_, chance)| stream.uniform() >= **chance).map(|(place, _)| *place).collect()
}

fn channel_of(
    real: &Recording,
    sim: &SensorModel,
    channel: Channel,
    model: &ChannelModel,
    mut outliers: Vec<usize>,
    temperature: Option<&[f64]>,
) -> Result<Prepared, DiagnosisError> {
    let values = real.values(channel).unwrap_or_default();
    outliers.extend((0..values.len()).filter(|t| !values[*t].is_finite()));
    outliers.sort_unstable();
    outliers.dedup();
    let there: Vec<f64> =
        values.iter().enumerate().filter(|(t, _)| outliers.binary_search(t).is_err()).map(|(_, v)| *v).collect();
    let facts = match real.sent(channel) {
        // The motion causes values that are cut off there.
        Some(sent) => {
            let sent: Vec<f64> = (0..sent.len())
                .filter(|t| outliers.binary_search(t).is_err() && sent[*t].is_finite())
                .map(|t| sent[t])
                .collect();
            Facts { low: None, high: None, atom: 0.0, ..facts::of(&sent) }
        }
        None => facts::of(&there),
    };
    let (low, high) = there.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    if there.len() < LEAST {
        let least_s = LEAST as f64 / sim.rate_hz;
        return Err(DiagnosisError::TooShort { found: there.len(), least: LEAST, least_s });
    }
    if high <= low {
        let value = if low.is_finite() { low } else { 0.0 };
        return Err(DiagnosisError::Constant { channel: channel.to_string(), value });
    }
    for limit in [facts.low, facts.high].into_iter().flatten() {
        let share = there.iter().filter(|value| **value == limit).count() as f64 / there.len() as f64;
        if share > 0.9 {
            let share_percent = (1000.0 * share).round() / 10.0;
            return Err(DiagnosisError::Saturated { channel: channel.to_string(), value: limit, share_percent });
        }
    }
    let density = white_density(model, sim.internal_rate_hz(sim.rate_hz));
    // Values hidden by a coarse step are drawn below; then no rounding is left.
    let step = facts.step.filter(|_| real.sent(channel).is_none());
    let coarse =
        step.and_then(|step| Some((step, rounded::white_of(values, step, &outliers, density * sim.rate_hz.sqrt())?)));
    let mut samples = values.to_vec();
    let shifts = shifts_of(model, values.len(), sim.rate_hz, temperature.map(mean));
    subtract_others(&mut samples, model, &shifts, sim.rate_hz, temperature);
    let internal_hz = sim.internal_rate_hz(sim.rate_hz);
    let level = median(&mut there.clone());
    let white = coarse.map_or_else(|| scale_of(&there), |(_, white)| white.deviation);
    let declared = density * sim.rate_hz.sqrt();
    let most = if declared > 0.0 && coarse.is_none() { LOUDER * declared } else { f64::INFINITY };
    let scale = white.min(most).max(1e-3 * declared);
    for sample in &mut samples {
        *sample = if sample.is_finite() { (*sample - level) / scale } else { 0.0 };
    }
    let limits = [facts.low, facts.high].map(|limit| limit.map(|limit| (limit - level) / scale));
    let at_limit = |value: f64| [facts.low, facts.high].into_iter().flatten().any(|limit| value == limit);
    outliers.extend(values.iter().enumerate().filter(|(_, value)| at_limit(**value)).map(|(t, _)| t));
    outliers.sort_unstable();
    outliers.dedup();
    let square = |value: f64| if value > 0.0 { 2.0 * (value / scale).ln() } else { -60.0 };
    let mean_c = temperature.map_or(USUAL_TEMPERATURE_C, mean);
    let white_shift = white_shift(model, mean_c);
    let levels = [square(density) + white_shift, square(model.b), square(model.k)];
    let prior = |level: f64, sd: f64| (level > -50.0).then_some((level, sd));
    let rounding = model.effects.iter().find(|effect| effect.kind() == EffectKind::Resolution);
    let of_model = rounding.and_then(|effect| effect.number("step"));
    let (sines, lines) = lines_of(sim, channel, values.len(), scale).into_iter().unzip();
    let (loud, scedasticity) = variance_of(model, values.len(), sim.rate_hz, scale, internal_hz);
    let shifts = shifts.into_iter().map(|(place, course, factor)| (place, course, factor / scale)).collect();
    let mut prepared = Prepared {
        channel,
        scale,
        level,
        samples,
        step: facts.step.or(of_model).filter(|_| coarse.is_none()),
        facts,
        outliers,
        limits,
        declared: Law { levels, terms: Vec::new(), quiet: f64::INFINITY },
        priors: [None, prior(levels[1], 0.6), prior(levels[2], 0.8)],
        spectral: terms_of(model, scale, density, sim.rate_hz),
        wandering: super::wandering::bands_of(model, scale),
        sines,
        lines,
        gated: gated::of_model(model, sim.rate_hz),
        shifts,
        bursts: loud_of_bursts(model, &loud),
        loud,
        scedasticity,
        reach: model.effects.iter().map(|effect| reach(&**effect, sim.rate_hz)).max().unwrap_or(0),
        changes: model.effects.iter().any(|effect| changes(&**effect, values.len(), sim.rate_hz)),
        has: model.effects.iter().map(|effect| effect.kind()).collect(),
        white_shift,
        share: coarse.map_or(1.0, |(_, white)| white.share),
        dither: 0.0,
    };
    if coarse.is_none() {
        dither::dither(&mut prepared, &there, declared);
    }
    if let Some((step, white)) = coarse {
        rounded::unround(&mut prepared, sim, step, white);
    }
    Ok(prepared)
}

/// Subtracts from samples the model's contributions to the level beyond the fitted shifts, U.
fn subtract_others(
    samples: &mut [f64],
    model: &ChannelModel,
    shifts: &[(usize, Course, f64)],
    rate_hz: f64,
    temperature: Option<&[f64]>,
) {
    let is_fitted = |place: usize| shifts.iter().any(|(own, ..)| *own == place);
    let listed = model.effects.iter().enumerate().filter(|(_, effect)| effect.stage() == Stage::Bias);
    let others: Vec<&Arc<dyn Effect>> = listed.filter(|(place, _)| !is_fitted(*place)).map(|(_, of)| of).collect();
    if others.is_empty() {
        return;
    }
    for (t, sample) in samples.iter_mut().enumerate() {
        let temperature_c = temperature.map_or(USUAL_TEMPERATURE_C, |values| values[t]);
        let at = At { time_s: t as f64 / rate_hz, temperature_c };
        *sample -= others.iter().map(|effect| effect.mean_response(0.0, at)).sum::<f64>();
    }
}

/// Returns N of a model's channel, including the white noise that it shares with others, U/√Hz: one channel alone
/// cannot separate them.
pub(super) fn white_density(model: &ChannelModel, internal_hz: f64) -> f64 {
    let shared = model.effects.iter().filter(|effect| effect.kind() == EffectKind::CommonMode);
    let power: f64 = shared.filter_map(|effect| effect.psd(0.0, internal_hz)).sum();
    (model.n * model.n + power).sqrt()
}

/// Returns the lines of a model's channel as they are sent, in the series' scale (U per unit of it). Each has the place
/// of its effect in the model's list, and its amplitude over that of the effect alone: the part that the filters pass.
fn lines_of(sim: &SensorModel, channel: Channel, samples: usize, scale: f64) -> Vec<(Sine, (usize, f64))> {
    let record = Record { rate_hz: sim.rate_hz, samples: samples as u64 };
    let effects = sim.channels.get(&channel).map(|model| model.effects.as_slice()).unwrap_or_default();
    let is_filter = |effect: &&Arc<dyn Effect>| effect.stage() == Stage::Bandwidth;
    let of_effect = |(place, effect): (usize, &Arc<dyn Effect>)| -> Vec<(Sine, (usize, f64))> {
        let own = effect.lines();
        if own.is_empty() || effect.stationary(record).is_some() {
            return Vec::new();
        }
        let effects = effects.iter().filter(is_filter).chain([effect]).cloned().collect();
        let channels = [(channel, ChannelModel { effects, ..ChannelModel::default() })].into();
        let alone = SensorModel { channels, triads: BTreeMap::new(), ..sim.clone() };
        let sent = Spectrum::new(&alone, channel, record).lines();
        let pairs = sent.into_iter().zip(own).filter(|(sent, own)| sent.frequency_hz > 0.0 && own.power > 0.0);
        let line = |(sent, own): (Line, Line)| {
            let amplitude = (2.0 * sent.power).sqrt() / scale;
            let sine = Sine { cycles: sent.frequency_hz / sim.rate_hz, quadratures: [amplitude, 0.0] };
            (sine, (place, (sent.power / own.power).sqrt()))
        };
        pairs.map(line).collect()
    };
    effects.iter().enumerate().flat_map(of_effect).collect()
}

/// Returns the first spectral effects of a model's channel as terms in the series' scale (U per unit of it), with their
/// places in its list; the rest are taken as stated.
fn terms_of(model: &ChannelModel, scale: f64, density: f64, rate_hz: f64) -> Vec<(usize, Term)> {
    /// Maximum number of terms: every step of a search compares each of them by a separate fit.
    const MOST: usize = 24;
    let listed = model.effects.iter().enumerate();
    listed
        .filter_map(|(place, effect)| Some((place, Term::of(&**effect, scale, density, rate_hz)?)))
        .take(MOST)
        .collect()
}

/// Returns by how much a model's white part is louder at a temperature than at the temperature to which N refers, in ln
/// of its variance.
fn white_shift(model: &ChannelModel, mean_c: f64) -> f64 {
    let changes = model.effects.iter().filter(|effect| effect.kind() == EffectKind::VarianceChange);
    let of = |effect: &Arc<dyn Effect>| {
        let number = |name: &str| effect.number(name);
        number("per_c").zip(number("reference_c")).map_or(0.0, |(per_c, reference)| 2.0 * per_c * (mean_c - reference))
    };
    changes.map(of).sum()
}

/// A property of an effect of a model, with the effect's place in the model's list.
type OfModel<T> = (usize, T);

/// Returns the model's statement of its white part's variance.
fn variance_of(
    model: &ChannelModel,
    samples: usize,
    rate_hz: f64,
    scale: f64,
    internal_hz: f64,
) -> (Vec<OfModel<Loud>>, Option<OfModel<Scedasticity>>) {
    const INSTANTS: usize = 241;
    let mut loud = Vec::new();
    let mut scedasticity = None;
    let white = (white_density(model, internal_hz) / scale).powi(2) * internal_hz;
    let index = |time_s: f64| ((time_s * rate_hz).ceil().max(0.0) as usize).min(samples);
    for (place, effect) in model.effects.iter().enumerate() {
        let number = |name: &str| effect.number(name);
        match effect.kind() {
            EffectKind::Bursts => {
                let ratio = 1.0 + (number("sigma").unwrap_or_default() / scale).powi(2) / white;
                for (from_s, to_s) in effect.pairs("intervals") {
                    let (from, to) = (index(from_s), index(to_s));
                    if from < to {
                        loud.push((place, Loud { from, to, ratio }));
                    }
                }
            }
            EffectKind::VarianceChange => match (number("per_c"), number("factor")) {
                (Some(per_c), _) => scedasticity = Some((place, Scedasticity::PerDegree(2.0 * per_c))),
                (_, Some(factor)) => {
                    let (from, to) =
                        (index(number("from_s").unwrap_or_default()), index(number("to_s").unwrap_or_default()));
                    if from < to {
                        loud.push((place, Loud { from, to, ratio: (factor * factor).max(1e-6) }));
                    }
                }
                _ => {
                    let pairs = effect.pairs("profile");
                    let at = |instant: usize| {
                        let time_s = instant as f64 / (INSTANTS - 1) as f64 * samples as f64 / rate_hz;
                        2.0 * profile::factor(&pairs, time_s).max(1e-6).ln()
                    };
                    scedasticity = Some((place, Scedasticity::Profile((0..INSTANTS).map(at).collect())));
                }
            },
            _ => {}
        }
    }
    (loud, scedasticity)
}

/// Returns the intervals of a model's bursts among its stretches of another variance.
fn loud_of_bursts(model: &ChannelModel, loud: &[OfModel<Loud>]) -> Vec<Range<usize>> {
    let is_burst = |place: usize| model.effects.get(place).is_some_and(|effect| effect.kind() == EffectKind::Bursts);
    loud.iter().filter(|(place, _)| is_burst(*place)).map(|(_, loud)| loud.from..loud.to).collect()
}

/// Returns whether an effect changes with time.
fn changes(effect: &dyn Effect, samples: usize, rate_hz: f64) -> bool {
    let by_name = matches!(effect.kind(), EffectKind::Intermittent | EffectKind::WanderingLine);
    by_name || effect.stationary(Record { rate_hz, samples: samples as u64 }).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_rate_by_two_clocks_is_accepted_and_a_nearby_one_is_not() {
        for (one_hz, other_hz, same) in [
            (39.9926, 40.0, true),
            (40.0, 39.9926, true),
            (100.04, 100.0, true),
            (40.2, 40.0, false),
            (f64::NAN, 40.0, false),
        ] {
            assert_eq!(same_rate(one_hz, other_hz).is_ok(), same, "{one_hz} {other_hz}");
        }
        let refused = same_rate(40.2, 40.0).unwrap_err().to_string();
        assert!(refused.contains("40.2 Hz") && refused.contains("40 Hz"), "{refused}");
    }

    #[test]
    fn a_parabola_is_smoothed_to_itself_and_rounding_goes() {
        let curve = |t: usize| 25.0 + 0.0023 * t as f64 - 3e-8 * (t as f64).powi(2);
        let values: Vec<f64> = (0..20_000).map(curve).collect();
        for (t, value) in smoothed(&values, 801).iter().enumerate().skip(500).take(19_000) {
            assert!((value - curve(t)).abs() < 1e-4, "{t}: {value}");
        }
        let rounded: Vec<f64> = values.iter().map(|value| (10.0 * value).round() / 10.0).collect();
        let off = smoothed(&rounded, 801).into_iter().zip(&values).skip(500).take(15_000).map(|(a, b)| (a - b).powi(2));
        assert!((off.sum::<f64>() / 15_000.0).sqrt() < 0.006);
    }
}
