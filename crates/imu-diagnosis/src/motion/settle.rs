//! Settling: chooses and fits one triad's response to a motion under the known law of its noise.

use super::align::Aligned;
use super::groups::{self, Foreign, Group, Member, Pricing};
use super::lateness::Delay;
use super::noise::{self, BLOCKS};
use super::select::{Choice, Weighing};
use crate::averages::scale_of;
use crate::error::DiagnosisError;
use crate::facts;
use crate::options::Options;
use crate::recording::Recording;
use crate::response::{self, AXES, Candidate, Clipping, Clock, Filters, Fit, Record, Request, Screen};
use imu_core::sample::Triad;
use imu_model::effects::triad::Axes;
use imu_model::effects::{EffectKind, TriadEffect};
use imu_model::simulator::SensorModel;
use std::sync::Arc;

/// The range of a VN-100: ±2000 °/s and ±16 g. Fractions of full scale refer to it.
const FULL_SCALE: [f64; 2] = [34.906_585, 156.906_4];
/// If repeats explain at least this many nats, samples are sent again.
const REPEATED: f64 = 14.0;
/// Maximum part of a record that is left out at its start behind a slow filter.
const FORGOTTEN_MOST: f64 = 1.0 / 32.0;
const BANDWIDTH: Member = Member::Foreign(Foreign::Bandwidth);
/// Orders of a filter that are tried on a motion's rounded corners.
const ORDERS: [u64; 3] = [1, 2, 4];

/// A triad whose response is explained as far as possible.
#[derive(Debug)]
pub(super) struct Settled {
    pub(super) triad: Triad,
    pub(super) screen: Screen,
    pub(super) groups: Vec<Group>,
    /// Columns that are always present: delay, clock, temperature, free cutoffs.
    pub(super) base: Vec<usize>,
    pub(super) choice: Choice,
    /// The fit of the chosen effects.
    pub(super) fit: Fit,
    /// The delay of the triad.
    pub(super) delay: Option<Delay>,
    /// Degrees of freedom of the mean's variance.
    pub(super) mean_freedom: f64,
    /// The effects that the model has already.
    pub(super) known: Vec<Arc<dyn TriadEffect>>,
    /// Nats of the values that the sensor cut off beyond its range, per axis and sample, if the model has no such
    /// range.
    pub(super) cut_off: Option<[Vec<f64>; 3]>,
    /// Samples less all effects that respond to the motion, U; NaN for a sample that is left out.
    pub(super) rest: [Vec<f64>; 3],
}

impl Settled {
    pub(super) fn weighing(&self) -> Weighing<'_> {
        Weighing::new(&self.screen, &self.base, &self.groups)
    }

    /// Returns the sensor's range, if samples show one that the model lacks.
    pub(super) fn range(&self) -> Option<Clipping> {
        let clipping = self.fit.clipping?;
        let known_range = self.known.iter().filter_map(|effect| effect.range()).reduce(f64::min);
        let is_known = known_range.is_some_and(|range| (range / clipping.limit - 1.0).abs() < 1e-6);
        (!is_known).then_some(clipping)
    }

    /// Returns the chosen groups.
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

/// The settings with which a triad is examined.
#[derive(Clone, Copy)]
pub(super) struct About<'a> {
    pub(super) part: &'a Recording,
    pub(super) aligned: &'a Aligned,
    pub(super) sim: &'a SensorModel,
    /// The known noise.
    pub(super) noise_model: &'a SensorModel,
    pub(super) temperature_c: Option<&'a [f64]>,
}

/// A fit, and the parts that were subtracted before it.
struct Ended {
    fit: Fit,
    outside: [Vec<f64>; 3],
}

impl About<'_> {
    pub(super) fn settle(
        &self,
        triad: Triad,
        triads: usize,
        options: &Options<'_>,
        lenient: f64,
    ) -> Result<Settled, DiagnosisError> {
        let (rate_hz, motions) = (self.part.rate_hz, self.aligned.motions.as_slice());
        let n = motions.len();
        let sent = triad.channels().map(|channel| self.part.values(channel).unwrap_or_default());
        let filters = noise::filters(self.noise_model, triad);
        let left_out = self.left_out(sent, &filters);
        let courses = noise::courses(self.noise_model, triad, rate_hz, n, self.temperature_c);
        let mut samples = sent.map(|values| {
            values.iter().map(|value| if value.is_finite() { *value } else { 0.0 }).collect::<Vec<f64>>()
        });
        for (values, course) in samples.iter_mut().zip(&courses) {
            for (value, of) in values.iter_mut().zip(course.as_deref().unwrap_or_default()) {
                *value -= of;
            }
        }
        let scale = std::array::from_fn(|axis| {
            let there =
                (0..n).filter(|t| !left_out[*t]).map(|t| samples[axis][t] - response::input(triad, &motions[t])[axis]);
            scale_of(&there.collect::<Vec<f64>>())
        });
        let law = noise::law(self.noise_model, triad, rate_hz, n, scale)?;
        let known = self.sim.triads.get(&triad).map(|of| of.effects.clone()).unwrap_or_default();
        let candidates = groups::candidates(triad, full_scale(triad, &known), self.reference_c(&known));
        let level = level(self.sim, triad);
        let clock = if self.aligned.shared { Clock::Shared } else { Clock::Separate };
        // On one clock a delay is a latency; on two clocks it is an offset.
        let with_delay = |mut of: Vec<Candidate>| {
            of.extend(self.aligned.shared.then_some(Candidate::Latency));
            of
        };
        let all = with_delay(candidates.clone());
        let request = Request { known: &known, level, candidates: &all, clock, filters: &filters };
        let mut counts = Vec::new();
        let extras = Foreign::of(triad).into_iter().flat_map(|of| {
            let columns = groups::foreign(of, triad, motions, rate_hz);
            counts.push((of, columns.len()));
            columns
        });
        let mut screen =
            response::screen(&self.record(triad, &samples, sent, &left_out), &law, &request, extras, BLOCKS)?;
        let mean_freedom = noise::mean_freedom(self.noise_model, triad, rate_hz, n);
        let mut groups = groups::groups(&candidates, screen.own, &counts, pricing(options, triads, mean_freedom));
        // Many numbers reach half of a price in noise alone.
        let inside_library = groups.iter_mut().filter(|group| matches!(group.member, Member::Library(_)));
        inside_library.for_each(|group| group.price *= lenient);
        let inside: usize = candidates.iter().map(|one| one.parameters().len()).sum();
        let base: Vec<usize> = (inside..screen.own).collect();
        let wanted = |group: &Group| match group.member {
            Member::Library(candidate) => options.wants(candidate.kind()),
            Member::Foreign(_) => true,
        };
        groups.retain(wanted);
        let weighing = Weighing::new(&screen, &base, &groups);
        let choice = weighing.choose();
        let columns = weighing.columns(&choice.groups);
        let (_, numbers) = screen.gain(&columns);
        let members = || choice.groups.iter().map(|place| groups[*place].member);
        let library = members().filter_map(|member| match member {
            Member::Library(candidate) => Some(candidate),
            Member::Foreign(_) => None,
        });
        let mut chosen = with_delay(library.collect());
        chosen.push(Candidate::Saturation);
        let request = Request { candidates: &chosen, ..request };
        let fitted = |outside: [Vec<f64>; 3], filters: &Filters| -> Result<Ended, DiagnosisError> {
            let mut inside = samples.clone();
            for (values, of) in inside.iter_mut().zip(&outside) {
                values.iter_mut().zip(of).for_each(|(value, of)| *value -= of);
            }
            let left_out = self.left_out(sent, filters);
            let record = self.record(triad, &inside, sent, &left_out);
            let fit = response::fit(&record, &law, &Request { filters, ..request })?;
            Ok(Ended { fit, outside })
        };
        // Effects outside the library are removed before the rest is fitted as the simulator makes it.
        let own: Vec<(usize, f64)> = columns.iter().copied().zip(numbers.iter().copied()).collect();
        let outside = |own: &[(usize, f64)]| self.outside(triad, own, &screen, &counts, &filters);
        let mut ended = fitted(outside(&own), &filters)?;
        let misfit = |of: &Ended| of.fit.misfit.iter().sum::<f64>();
        if let Some(place) = choice.groups.iter().find(|place| groups[**place].member == BANDWIDTH) {
            // Its columns equal a filter's to within some hundredths; the rest would hide the filter from the noise's
            // diagnosis. Other outside effects may be part of that rest.
            let others: Vec<(usize, f64)> =
                own.iter().copied().filter(|(column, _)| !groups[*place].columns.contains(column)).collect();
            let delay_s = self.aligned.shared.then_some(numbers[0]);
            for supposed in ORDERS.into_iter().filter_map(|order| filters.supposed(order, delay_s, rate_hz)) {
                for left in [&others[..], &[]] {
                    let other = fitted(outside(left), &supposed)?;
                    if misfit(&other) < misfit(&ended) {
                        ended = other;
                    }
                    if others.iter().all(|(column, _)| *column < screen.own) {
                        break;
                    }
                }
            }
        }
        screen.keep(&columns);
        let rest = self.rest(sent, &ended);
        let fit = ended.fit;
        let delay = Delay::of(triad, &fit.estimates);
        let mut settled =
            Settled { triad, screen, groups, base, choice, fit, delay, mean_freedom, known, cut_off: None, rest };
        settled.cut_off = settled.range().filter(|_| options.wants(EffectKind::Saturation)).map(|clipping| {
            // A model without the range expects the response; the sent value is the range exactly.
            let deviations = law.sample_deviations();
            std::array::from_fn(|axis| {
                let beyond = sent[axis].iter().zip(&settled.fit.response[axis]).map(|(sent, response)| {
                    let more = if sent.abs() == clipping.limit { response.abs() - clipping.limit } else { 0.0 };
                    0.5 * (more.max(0.0) / deviations[axis]).powi(2)
                });
                beyond.collect()
            })
        });
        Ok(settled)
    }

    /// Returns the sum of a screen's columns that are not in the library, multiplied by their numbers.
    fn outside(
        &self,
        triad: Triad,
        columns: &[(usize, f64)],
        screen: &Screen,
        counts: &[(Foreign, usize)],
        filters: &Filters,
    ) -> [Vec<f64>; 3] {
        let motions = self.aligned.motions.as_slice();
        let mut outside: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; motions.len()]);
        let moved = ["x ln_cutoff", "y ln_cutoff", "z ln_cutoff"]
            .map(|name| screen.fit.estimates.iter().find(|one| one.parameter == name).map_or(0.0, |one| one.value));
        let mut first = screen.own;
        for (of, count) in counts {
            let own: Vec<_> = columns.iter().filter(|(column, _)| (first..first + count).contains(column)).collect();
            // Such columns are rarely chosen: they are computed again instead of kept.
            let made = match own.is_empty() {
                true => Vec::new(),
                false => groups::foreign(*of, triad, motions, self.part.rate_hz),
            };
            for (column, number) in own {
                for (axis, sum) in outside.iter_mut().enumerate() {
                    // In the screen, the column was behind the filters.
                    let Some(mut values) = made[column - first][axis].clone() else { continue };
                    filters.pass(axis, moved[axis], self.part.rate_hz, &mut values);
                    sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += number * value);
                }
            }
            first += count;
        }
        outside
    }

    /// Returns samples less all effects that respond to the motion. The effect of the temperature is left to the
    /// diagnosis of the remainder.
    fn rest(&self, sent: [&[f64]; 3], ended: &Ended) -> [Vec<f64>; 3] {
        let fit = &ended.fit;
        let n = self.aligned.motions.len();
        let per_c = |axis: usize| {
            let name = format!("{} per_c", AXES[axis]);
            fit.estimates.iter().find(|one| one.parameter == name).map_or(0.0, |one| one.value)
        };
        let mean_c = self.temperature_c.map_or(0.0, |values| values.iter().sum::<f64>() / n.max(1) as f64);
        std::array::from_fn(|axis| {
            let per_c = per_c(axis);
            let warmth = |t: usize| self.temperature_c.map_or(0.0, |values| per_c * (values[t] - mean_c));
            let mut rest: Vec<f64> =
                (0..n).map(|t| sent[axis][t] - (fit.response[axis][t] - warmth(t)) - ended.outside[axis][t]).collect();
            for stretch in &fit.stretches[axis] {
                rest[stretch.clone()].fill(f64::NAN);
            }
            rest
        })
    }

    /// Returns the fit of all effects with a delay, under the model's noise.
    pub(super) fn delayed(&self, triad: Triad) -> Result<Fit, DiagnosisError> {
        let n = self.aligned.motions.len();
        let sent = triad.channels().map(|channel| self.part.values(channel).unwrap_or_default());
        let filters = noise::filters(self.noise_model, triad);
        let left_out = self.left_out(sent, &filters);
        let finite = |value: &f64| if value.is_finite() { *value } else { 0.0 };
        let samples = sent.map(|values| values.iter().map(finite).collect::<Vec<f64>>());
        let scale = sent.map(scale_of);
        let law = noise::law(self.noise_model, triad, self.part.rate_hz, n, scale)?;
        let known = self.sim.triads.get(&triad).map(|of| of.effects.clone()).unwrap_or_default();
        let candidates = groups::candidates(triad, full_scale(triad, &known), self.reference_c(&known));
        let level = level(self.sim, triad);
        let request =
            Request { known: &known, level, candidates: &candidates, clock: Clock::Separate, filters: &filters };
        Ok(response::fit(&self.record(triad, &samples, sent, &left_out), &law, &request)?)
    }

    /// Returns the temperature to which a scale factor's dependence on it refers: the model's own, or the record's mean.
    fn reference_c(&self, known: &[Arc<dyn TriadEffect>]) -> Option<f64> {
        let temperature_c = self.temperature_c?;
        let mut own = known.iter().filter(|effect| effect.kind() == EffectKind::TemperatureScale);
        let mean = || temperature_c.iter().sum::<f64>() / temperature_c.len().max(1) as f64;
        Some(own.find_map(|effect| effect.number("reference_c")).unwrap_or_else(mean))
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

    /// Returns the samples that are missing, not numbers or sent again, and the first samples behind a filter, because
    /// the filter's earlier input is not known.
    fn left_out(&self, sent: [&[f64]; 3], filters: &Filters) -> Vec<bool> {
        let mut out: Vec<bool> = (0..self.part.len())
            .map(|t| self.part.is_missing(t) || sent.iter().any(|values| !values[t].is_finite()))
            .collect();
        let repeats = facts::repeats(&sent);
        if repeats.gain > REPEATED && repeats.places.len() >= 3 {
            repeats.places.into_iter().for_each(|t| out[t] = true);
        }
        let most = (FORGOTTEN_MOST * out.len() as f64) as usize;
        let begins = filters.memory(self.part.rate_hz).min(most);
        out[..begins].fill(true);
        out
    }
}

/// Returns the biases that a model states for a triad's channels, U.
pub(super) fn level(sim: &SensorModel, triad: Triad) -> Axes {
    triad.channels().map(|channel| sim.channels.get(&channel).and_then(|of| of.bias).unwrap_or(0.0))
}

/// Returns the prices of groups for this number of triads.
pub(super) fn pricing(options: &Options<'_>, triads: usize, mean_freedom: f64) -> Pricing {
    Pricing { level: options.level, triads, mean_freedom }
}

/// Returns the full scale to which a nonlinearity refers: the model's own, or the sensor's range.
fn full_scale(triad: Triad, known: &[Arc<dyn TriadEffect>]) -> f64 {
    let mut own = known.iter().filter(|effect| effect.kind() == EffectKind::ScaleFactorNonlinearity);
    let stated = own.find_map(|effect| effect.number("full_scale"));
    stated.unwrap_or(FULL_SCALE[usize::from(triad != Triad::Gyro)])
}
