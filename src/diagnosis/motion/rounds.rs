//! Rounds: what the motion drives and what the noise is, each found beside the other until neither changes.

use super::align::{Aligned, Lie};
use super::groups::{self, Foreign, Group, Member, Pricing};
use super::lateness::{self, Delay};
use super::select::{Choice, Weighing};
use super::{BLOCKS, noise};
use crate::diagnosis::diagnose::{Options, Outcome, diagnose};
use crate::diagnosis::error::DiagnosisError;
use crate::diagnosis::recording::Recording;
use crate::diagnosis::report::Diagnosis;
use crate::diagnosis::response::{self, Candidate, Clock, Fit, Record, Request, Screen};
use crate::diagnosis::{facts, prepare};
use crate::effects::TriadEffect;
use crate::sample::Triad;
use crate::simulator::SensorModel;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};

/// Rounds after which it is left as it is.
const ROUNDS: usize = 4;
/// Part of the prices in the first round, whose noise is only declared.
const LENIENT: f64 = 0.5;
/// What a VN-100 measures at most: ±2000 °/s and ±16 g. Fractions of full scale are told of it.
const FULL_SCALE: [f64; 2] = [34.906_585, 156.906_4];
/// Nats from which on samples that repeat are sent again.
const REPEATED: f64 = 14.0;
/// Part of a channel's samples that may be without a value there; with more at the sensor's limit the instant is left out of all.
const LACKING: f64 = 0.08;

/// A triad whose answer is understood as far as it can be.
#[derive(Debug)]
pub(super) struct Settled {
    pub(super) triad: Triad,
    pub(super) screen: Screen,
    pub(super) groups: Vec<Group>,
    /// Columns that are always there: delay, clock, temperature, open cutoffs.
    pub(super) base: Vec<usize>,
    pub(super) choice: Choice,
    /// The fit of what was chosen.
    pub(super) fit: Fit,
    /// How late it is.
    delay: Option<Delay>,
    /// Degrees of freedom of the mean's variance.
    pub(super) mean_freedom: f64,
    /// What the model has already.
    pub(super) known: Vec<Arc<dyn TriadEffect>>,
    /// Samples less everything that answers the motion, U; no number where a sample is left out.
    rest: [Vec<f64>; 3],
}

impl Settled {
    pub(super) fn weighing(&self) -> Weighing<'_> {
        Weighing::new(&self.screen, &self.base, &self.groups)
    }

    /// Samples less everything that answers the motion, U; no number where a sample is left out.
    pub(super) fn rest(&self, axis: usize) -> &[f64] {
        &self.rest[axis]
    }

    /// The groups that were chosen.
    pub(super) fn chosen(&self) -> impl Iterator<Item = (usize, &Group)> {
        self.choice.groups.iter().map(|place| (*place, &self.groups[*place]))
    }

    pub(super) fn foreign(&self) -> impl Iterator<Item = (usize, Foreign)> {
        self.chosen().filter_map(|(place, group)| match group.member {
            Member::Foreign(of) => Some((place, of)),
            Member::Library(_) => None,
        })
    }
}

/// What was found in a record of a motion.
#[derive(Debug)]
pub(super) struct Found {
    pub(super) triads: Vec<Settled>,
    /// What was found in what remains.
    pub(super) rest: Outcome,
    pub(super) lateness: lateness::Verdict,
    /// Nats that a single number has to explain.
    pub(super) price_of_one: f64,
}

/// Finds both, in turn.
pub(super) fn run(
    part: &Recording,
    aligned: &Aligned,
    sim: &SensorModel,
    triads: &[Triad],
    options: &Options<'_>,
) -> Result<Found, DiagnosisError> {
    let temperature_c = prepare::temperature(part);
    let mut still = sim.clone();
    still.triads.clear();
    let mut told = still.clone();
    let mut noise_told = None;
    let mut before = None;
    let mut round = 0;
    loop {
        let lenient = if round == 0 { LENIENT } else { 1.0 };
        let places: Vec<Mutex<Option<Result<Settled, DiagnosisError>>>> =
            triads.iter().map(|_| Mutex::new(None)).collect();
        options.workers.each(triads.len(), &|index| {
            let (told, found, temperature_c) = (&told, noise_told.as_ref(), temperature_c.as_deref());
            let about = About { part, aligned, sim, told, found, temperature_c };
            let settled = about.settle(triads[index], triads.len(), options, lenient);
            *places[index].lock().unwrap_or_else(PoisonError::into_inner) = Some(settled);
        });
        let done = places.into_iter().map(|place| place.into_inner().unwrap_or_else(PoisonError::into_inner));
        let settled = done.map(|of| of.ok_or(DiagnosisError::CalledOff)?).collect::<Result<Vec<_>, _>>()?;
        let rest = diagnose(&remainder(part, &settled), &still, options)?;
        let now = signature(&settled, &rest.augmented);
        round += 1;
        if (round > 1 && before.as_ref() == Some(&now)) || round == ROUNDS {
            let delays: Vec<Delay> = settled.iter().filter_map(|of| of.delay).collect();
            let price_of_one = pricing(options, triads.len(), 1.0).price(1, 2);
            let lateness = lateness::tell(&delays, aligned.shared, price_of_one);
            return Ok(Found { triads: settled, rest, lateness, price_of_one });
        }
        before = Some(now);
        told = rest.augmented;
        noise_told = Some(rest.diagnosis);
    }
}

/// How a reference on a clock of its own lies beside a record, to a part of a sample: from the triad that tells it best. Between
/// samples of the record a motion's corners are lost; between rows of a faster reference they are not.
pub(super) fn refined(
    part: &Recording,
    aligned: &Aligned,
    sim: &SensorModel,
    triads: &[Triad],
) -> Result<Option<Lie>, DiagnosisError> {
    let mut best: Option<(f64, Lie)> = None;
    let about = About { part, aligned, sim, told: sim, found: None, temperature_c: None };
    let middle_s = 0.5 * part.len().saturating_sub(1) as f64 / part.rate_hz;
    for triad in triads {
        let fit = about.delayed(*triad)?;
        let of = |name: &str| fit.estimates.iter().find(|one| one.parameter == name);
        let told = of("offset_s").zip(of("rate_error")).and_then(|(offset, rate)| {
            Some((offset.standard_error?, offset.value, rate.standard_error.map_or(0.0, |_| rate.value)))
        });
        let Some((error_s, offset_s, gains)) = told else { continue };
        if best.as_ref().is_none_or(|(least_s, _)| error_s < *least_s) {
            // The offset is that of the middle of the part.
            let from_s = aligned.from as f64 / part.rate_hz;
            let begins_s = aligned.begins_s - offset_s + gains * (middle_s + from_s);
            best = Some((error_s, Lie { begins_s, gains, shared: false }));
        }
    }
    Ok(best.map(|(_, lie)| lie))
}

fn pricing(options: &Options<'_>, triads: usize, mean_freedom: f64) -> Pricing {
    Pricing { level: options.level, triads, mean_freedom }
}

/// What a next round would start from: what was chosen, and the names of what changes the mean or the law's form.
type Signature = (Vec<Vec<usize>>, BTreeSet<(usize, &'static str)>);

fn signature(settled: &[Settled], told: &SensorModel) -> Signature {
    let names = settled.iter().flat_map(|of| of.triad.channels()).filter_map(|channel| {
        let effects = &told.channels.get(&channel)?.effects;
        Some(effects.iter().map(move |effect| (channel as usize, effect.name())))
    });
    (settled.iter().map(|of| of.choice.groups.clone()).collect(), names.flatten().collect())
}

/// The record with the answers taken off.
fn remainder(part: &Recording, settled: &[Settled]) -> Recording {
    let mut rest = part.clone();
    let n = part.len();
    rest.missing.resize(n, false);
    for of in settled {
        for (axis, channel) in of.triad.channels().into_iter().enumerate() {
            let Some((_, values)) = rest.channels.iter_mut().find(|(own, _)| *own == channel) else { continue };
            let sent = std::mem::replace(values, of.rest[axis].clone());
            rest.sent.push((channel, sent));
            let lacking = |t: &usize| !values[*t].is_finite() && !rest.missing[*t];
            let places: Vec<usize> = (0..n).filter(lacking).collect();
            if places.len() as f64 > LACKING * n as f64 {
                places.into_iter().for_each(|t| rest.missing[t] = true);
                // A stamp belongs to every place or to every sample that is there: those of the others do not count.
                if rest.time_s.len() != n {
                    rest.time_s.clear();
                }
            }
        }
    }
    rest
}

/// What a triad is looked at with.
#[derive(Clone, Copy)]
struct About<'a> {
    part: &'a Recording,
    aligned: &'a Aligned,
    sim: &'a SensorModel,
    /// The noise as far as it is known, and how it was found.
    told: &'a SensorModel,
    found: Option<&'a Diagnosis>,
    temperature_c: Option<&'a [f64]>,
}

impl About<'_> {
    fn settle(
        &self,
        triad: Triad,
        triads: usize,
        options: &Options<'_>,
        lenient: f64,
    ) -> Result<Settled, DiagnosisError> {
        let (rate_hz, motions) = (self.part.rate_hz, self.aligned.motions.as_slice());
        let n = motions.len();
        let sent = triad.channels().map(|channel| self.part.values(channel).unwrap_or_default());
        let left_out = self.left_out(sent);
        let courses = noise::courses(self.told, triad, rate_hz, n, self.temperature_c);
        let mut samples = sent.map(|values| {
            values.iter().map(|value| if value.is_finite() { *value } else { 0.0 }).collect::<Vec<f64>>()
        });
        for (values, course) in samples.iter_mut().zip(&courses) {
            for (value, of) in values.iter_mut().zip(course.as_deref().unwrap_or_default()) {
                *value -= of;
            }
        }
        let input = |t: usize, axis: usize| match triad {
            Triad::Gyro => motions[t].gyro_rad_s[axis],
            _ => motions[t].accel_m_s2[axis],
        };
        let scale = std::array::from_fn(|axis| {
            let there = (0..n).filter(|t| !left_out[*t]).map(|t| samples[axis][t] - input(t, axis));
            prepare::scale_of(&there.collect::<Vec<f64>>())
        });
        let law = noise::law(self.told, triad, rate_hz, n, scale)?;
        let filters = noise::filters(self.told, self.found, triad);
        let known = self.sim.triads.get(&triad).map(|of| of.effects.clone()).unwrap_or_default();
        let candidates = groups::candidates(triad, full_scale(triad, &known));
        let level =
            triad.channels().map(|channel| self.sim.channels.get(&channel).and_then(|of| of.bias).unwrap_or(0.0));
        let clock = if self.aligned.shared { Clock::SHARED } else { Clock::SEPARATE };
        // On one clock a delay is a latency's, on two it is the clock's.
        let with_delay = |mut of: Vec<Candidate>| {
            of.extend(self.aligned.shared.then_some(Candidate::Latency));
            of
        };
        let all = with_delay(candidates.clone());
        let request = Request { known: &known, level, candidates: &all, clock, filters: &filters };
        let mut counts = Vec::new();
        let extras = Foreign::of(triad).into_iter().flat_map(|of| {
            let columns = groups::foreign(of, triad, motions, rate_hz, self.temperature_c);
            counts.push((of, columns.len()));
            columns
        });
        let mut screen =
            response::screen(&self.record(triad, &samples, sent, &left_out), &law, &request, extras, BLOCKS)?;
        let mean_freedom = noise::mean_freedom(self.told, triad, rate_hz, n);
        let mut groups = groups::groups(&candidates, screen.own, &counts, pricing(options, triads, mean_freedom));
        // Many numbers of noise alone reach half of a price.
        let inside_library = groups.iter_mut().filter(|group| matches!(group.member, Member::Library(_)));
        inside_library.for_each(|group| group.price *= lenient);
        let inside: usize = candidates.iter().map(|one| one.parameters().len()).sum();
        let base: Vec<usize> = (inside..screen.own).collect();
        let wanted = |group: &Group| match group.member {
            Member::Library(candidate) => options.wants(candidate.name()),
            Member::Foreign(_) => true,
        };
        groups.retain(wanted);
        let choice = Weighing::new(&screen, &base, &groups).choose();
        // What is outside the library is taken off before the rest is fitted as the simulator makes it.
        let weighing = Weighing::new(&screen, &base, &groups);
        let columns = weighing.columns(&choice.groups);
        let (_, numbers) = screen.gain(&columns);
        let mut outside: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; n]);
        let mut first = screen.own;
        for (of, count) in counts {
            let chosen: Vec<(usize, f64)> = columns.iter().copied().zip(numbers.iter().copied()).collect();
            let chosen: Vec<_> =
                chosen.into_iter().filter(|(column, _)| (first..first + count).contains(column)).collect();
            // Rarely one is chosen: it is made again sooner than kept.
            let made = match chosen.is_empty() {
                true => Vec::new(),
                false => groups::foreign(of, triad, motions, rate_hz, self.temperature_c),
            };
            for (column, number) in chosen {
                for (axis, sum) in outside.iter_mut().enumerate() {
                    // The screen had it behind the filters.
                    let Some(mut values) = made[column - first][axis].clone() else { continue };
                    filters.pass(axis, 0.0, rate_hz, &mut values);
                    sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += number * value);
                }
            }
            first += count;
        }
        screen.keep(&columns);
        for (values, of) in samples.iter_mut().zip(&outside) {
            values.iter_mut().zip(of).for_each(|(value, of)| *value -= of);
        }
        let chosen: Vec<Candidate> = choice
            .groups
            .iter()
            .filter_map(|place| match groups[*place].member {
                Member::Library(candidate) => Some(candidate),
                Member::Foreign(_) => None,
            })
            .collect();
        let mut chosen = with_delay(chosen);
        chosen.push(Candidate::Saturation);
        let request = Request { candidates: &chosen, ..request };
        let fit = response::fit(&self.record(triad, &samples, sent, &left_out), &law, &request)?;
        // What the temperature does is left to the diagnosis of what remains.
        let per_c = |axis: usize| {
            let name = format!("{} per_c", ["x", "y", "z"][axis]);
            fit.estimates.iter().find(|one| one.parameter == name).map_or(0.0, |one| one.value)
        };
        let mean_c = self.temperature_c.map_or(0.0, |values| values.iter().sum::<f64>() / n.max(1) as f64);
        let rest = std::array::from_fn(|axis| {
            let per_c = per_c(axis);
            let warmth = |t: usize| self.temperature_c.map_or(0.0, |values| per_c * (values[t] - mean_c));
            let mut rest: Vec<f64> =
                (0..n).map(|t| sent[axis][t] - (fit.response[axis][t] - warmth(t)) - outside[axis][t]).collect();
            for stretch in &fit.stretches[axis] {
                rest[stretch.clone()].fill(f64::NAN);
            }
            rest
        });
        let delay = Delay::of(triad, &fit.estimates);
        Ok(Settled { triad, screen, groups, base, choice, fit, delay, mean_freedom, known, rest })
    }

    /// The fit of everything with a delay, under the model's noise.
    fn delayed(&self, triad: Triad) -> Result<Fit, DiagnosisError> {
        let n = self.aligned.motions.len();
        let sent = triad.channels().map(|channel| self.part.values(channel).unwrap_or_default());
        let left_out = self.left_out(sent);
        let finite = |value: &f64| if value.is_finite() { *value } else { 0.0 };
        let samples = sent.map(|values| values.iter().map(finite).collect::<Vec<f64>>());
        let scale = sent.map(prepare::scale_of);
        let law = noise::law(self.told, triad, self.part.rate_hz, n, scale)?;
        let known = self.sim.triads.get(&triad).map(|of| of.effects.clone()).unwrap_or_default();
        let candidates = groups::candidates(triad, full_scale(triad, &known));
        let level =
            triad.channels().map(|channel| self.sim.channels.get(&channel).and_then(|of| of.bias).unwrap_or(0.0));
        let filters = noise::filters(self.told, self.found, triad);
        let request =
            Request { known: &known, level, candidates: &candidates, clock: Clock::SEPARATE, filters: &filters };
        Ok(response::fit(&self.record(triad, &samples, sent, &left_out), &law, &request)?)
    }

    fn record<'b>(
        &'b self,
        triad: Triad,
        samples: &'b [Vec<f64>; 3],
        sent: [&'b [f64]; 3],
        left_out: &'b [bool],
    ) -> Record<'b> {
        Record {
            sent: Some(sent),
            rate_hz: self.part.rate_hz,
            triad,
            samples: samples.each_ref().map(Vec::as_slice),
            reference: &self.aligned.motions,
            temperature_c: self.temperature_c,
            left_out,
        }
    }

    /// Samples that are missing, no numbers, or sent again.
    fn left_out(&self, sent: [&[f64]; 3]) -> Vec<bool> {
        let mut out: Vec<bool> = (0..self.part.len())
            .map(|t| self.part.is_missing(t) || sent.iter().any(|values| !values[t].is_finite()))
            .collect();
        let repeats = facts::repeats(&sent);
        if repeats.gain > REPEATED && repeats.places.len() >= 3 {
            repeats.places.into_iter().for_each(|t| out[t] = true);
        }
        out
    }
}

/// The full scale that a nonlinearity is told of: the model's own, or the sensor's range.
fn full_scale(triad: Triad, known: &[Arc<dyn TriadEffect>]) -> f64 {
    let told = known.iter().filter(|effect| effect.name() == "scale_factor_nonlinearity").find_map(|effect| {
        effect.parameters().into_iter().find(|(name, _)| *name == "full_scale").and_then(|(_, value)| value.as_f64())
    });
    told.unwrap_or(FULL_SCALE[usize::from(triad != Triad::Gyro)])
}
