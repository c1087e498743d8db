//! The solution: Gauss–Newton steps from the known values until the steps are small compared with the standard errors.

use super::candidate::Candidate;
use super::clipping::{Bridges, is_near};
use super::clock::coarse;
use super::design::{Design, Slot, State};
use super::normal::Normal;
use super::whitening::{Columns, Whitening, products};
use super::{Clock, Record, ResponseError, SAMPLES_MIN, input};
use imu_model::effects::triad::{Axes, Latency};
use nalgebra::{DMatrix, DVector};

/// Maximum number of steps in a search.
const STEPS_MAX: usize = 30;
/// Part of a step's squared length that the next step may have; derivatives are computed again if the next step is
/// longer. The effect of old derivatives on the estimates is second order.
const STALE: f64 = 0.01;
/// Change of the delay, in samples, above which derivatives are always computed again.
const STALE_DELAY: f64 = 0.05;
/// Two delays within this many samples lead to the same solution.
const NEAR: f64 = 1.5;
/// Squared length of a step, in standard errors, at which the search ends.
const DONE: f64 = 1e-6;
/// Squared length of a step that is taken without checking whether it leads down: slightly old derivatives have a
/// larger error.
const TRUSTED: f64 = 1e-2;
/// Maximum number of halvings of a step that does not lead down.
const HALVINGS: u32 = 10;
/// Standard error of a clock's rate above which a motion carries no information about it, s/s.
const UNSEEN_RATE: f64 = 0.1;

/// The state in which the search ended.
#[derive(Debug)]
pub(super) struct Solution {
    pub(super) state: State,
    pub(super) response: [Vec<f64>; 3],
    /// The whitened residual.
    pub(super) residual: [Vec<f64>; 3],
    pub(super) columns: Columns,
    pub(super) normal: Normal,
}

fn squares(residual: &[Vec<f64>; 3]) -> f64 {
    residual.iter().flatten().map(|value| value * value).sum()
}

/// A problem with its weights.
#[derive(Debug)]
pub(super) struct Search<'a, 'b> {
    pub(super) record: &'a Record<'a>,
    pub(super) design: &'b Design<'a>,
    pub(super) whitening: Whitening<'a>,
    pub(super) clock: Clock,
}

impl Search<'_, '_> {
    pub(super) fn residual(&mut self, state: &State) -> ([Vec<f64>; 3], [Vec<f64>; 3]) {
        let response = self.design.response(state);
        let residual = self.whitening.residual(self.record.samples, &response);
        (response, residual)
    }

    /// Leaves out samples at the sensor's limit or, if the response is known, near it, and samples that the reference does not
    /// reach. Returns their number per axis.
    pub(super) fn leave_out(
        &mut self,
        limit: Option<f64>,
        response: Option<&[Vec<f64>; 3]>,
        state: &State,
    ) -> Result<[usize; 3], ResponseError> {
        let reached = self.design.reached(state);
        let deviations = self.whitening.law.sample_deviations();
        let bridges: [Bridges; 3] = std::array::from_fn(|axis| {
            let out = |(index, shown): (usize, &f64)| {
                // A course that was subtracted is added to both again: the limit applies to the sent values.
                let sent = self.record.sent.map_or(*shown, |axes| axes[axis][index]);
                let course = Some(sent - shown).filter(|course| course.is_finite()).unwrap_or(0.0);
                let response = response.map(|axes| axes[axis][index] + course);
                let near = limit.is_some_and(|limit| is_near(limit, sent, response, deviations[axis]));
                near || !reached.contains(&index) || self.record.left_out.get(index) == Some(&true)
            };
            Bridges::new(self.record.samples[axis].iter().enumerate().map(out))
        });
        let left_out = bridges.each_ref().map(Bridges::count);
        for (channel, out) in self.record.triad.channels().into_iter().zip(left_out) {
            let found = self.record.reference.len() - out;
            if found < SAMPLES_MIN {
                return Err(ResponseError::LeftOut { channel, needed: SAMPLES_MIN, found });
            }
        }
        self.whitening.bridges = bridges;
        Ok(left_out)
    }

    fn linearised(&mut self, state: &State) -> (Columns, Normal) {
        let columns = self.whitening.columns(self.design.columns(state));
        let matrix = products(&columns) + self.known();
        let unseen = |slot: &Slot| match slot {
            Slot::Coefficient(candidate, _) => self.design.candidates[*candidate].unseen(),
            Slot::Delay => Candidate::Latency.unseen(),
            Slot::RateError => UNSEEN_RATE,
            Slot::Temperature(_) | Slot::Cutoff(_) => f64::INFINITY,
        };
        let effect = |slot: &Slot| match slot {
            Slot::Coefficient(candidate, _) => *candidate,
            Slot::Delay => usize::MAX,
            Slot::RateError => usize::MAX - 1,
            Slot::Temperature(_) => usize::MAX - 2,
            Slot::Cutoff(_) => usize::MAX - 3,
        };
        let slots = &self.design.slots;
        let normal = Normal::new(
            &matrix,
            &slots.iter().map(unseen).collect::<Vec<_>>(),
            &slots.iter().map(effect).collect::<Vec<_>>(),
        );
        (columns, normal)
    }

    /// Returns the prior information as a part of XᵀX: of open cutoffs alone, about 0.
    pub(super) fn known(&self) -> DMatrix<f64> {
        let weight = |slot: &Slot| if let Slot::Cutoff(axis) = *slot { self.design.filters.weight(axis) } else { 0.0 };
        let slots = &self.design.slots;
        DMatrix::from_diagonal(&DVector::from_iterator(slots.len(), slots.iter().map(weight)))
    }

    /// Returns the known state; if a delay is fitted, one that is right to a sample. The derivative does not reach a
    /// delay that is long compared with the motion's turns.
    pub(super) fn start(&mut self, known: &State) -> State {
        let slots = self.design.slots.clone();
        if !slots.contains(&Slot::Delay) {
            return known.clone();
        }
        let rate_hz = self.record.rate_hz;
        let n = self.record.reference.len();
        let input: Vec<Axes> = self.record.reference.iter().map(|motion| input(self.record.triad, motion)).collect();
        let weights = self.whitening.law.sample_deviations().map(|deviation| deviation.powi(-2));
        // A latency is bounded; a clock's offset is bounded only by the rest of the record.
        let most = if self.clock == Clock::Separate { n / 4 } else { (Latency::SECONDS_MAX * rate_hz) as usize };
        let over = |from: usize, to: usize| {
            let samples = self.record.samples.map(|axis| &axis[from..to]);
            coarse(samples, &input[from..to], weights, most) / rate_hz
        };
        let whole = over(0, n);
        let mut starts = vec![known.clone(), State { delay_s: whole, ..known.clone() }];
        if slots.contains(&Slot::RateError) {
            let (first, second) = (over(0, n / 2), over(n / 2, n));
            let rate_error = (second - first) / (0.5 * n as f64 / rate_hz);
            starts.push(State { delay_s: 0.5 * (first + second), rate_error, ..known.clone() });
        }
        let near = |one: &State, other: &State| {
            let drift = (one.rate_error - other.rate_error).abs() * n as f64;
            (one.delay_s - other.delay_s).abs() * rate_hz < NEAR && drift < NEAR
        };
        let mut apart: Vec<State> = Vec::new();
        for start in starts {
            if !apart.iter().any(|other| near(&start, other)) {
                apart.push(start);
            }
        }
        if apart.len() == 1 {
            return known.clone();
        }
        let mut tried: Vec<(f64, State)> = Vec::new();
        for start in apart {
            let (_, residual) = self.residual(&start);
            let (columns, normal) = self.linearised(&start);
            let gradient = Whitening::gradient(&columns, &residual);
            let gain = gradient.dot(&(normal.inverse() * &gradient));
            tried.push((squares(&residual) - gain, start));
        }
        let best = tried.into_iter().min_by(|one, other| one.0.total_cmp(&other.0));
        best.map_or_else(|| known.clone(), |(_, state)| state)
    }

    /// Takes steps from `start` on.
    pub(super) fn run(&mut self, start: State) -> Solution {
        let slots = self.design.slots.clone();
        let known = self.known();
        let beside = |state: &State| {
            let values = DVector::from_iterator(slots.len(), slots.iter().map(|slot| state.value(*slot)));
            (values.transpose() * &known * values)[(0, 0)]
        };
        let mut state = start;
        let (mut response, mut residual) = self.residual(&state);
        let (mut columns, mut normal) = self.linearised(&state);
        let mut linear_at_s = state.delay_s;
        let mut last = f64::INFINITY;
        for _ in 0..STEPS_MAX {
            let pulled = &known * DVector::from_iterator(slots.len(), slots.iter().map(|slot| state.value(*slot)));
            let mut gradient = Whitening::gradient(&columns, &residual) - &pulled;
            let mut step: DVector<f64> = normal.inverse() * &gradient;
            let slow = gradient.dot(&step) > (STALE * last).max(DONE);
            if slow || (state.delay_s - linear_at_s).abs() * self.record.rate_hz > STALE_DELAY {
                // Keeping both would need twice the memory.
                columns.clear();
                (columns, normal) = self.linearised(&state);
                linear_at_s = state.delay_s;
                gradient = Whitening::gradient(&columns, &residual) - &pulled;
                step = normal.inverse() * &gradient;
            }
            let length = gradient.dot(&step);
            last = length;
            let before = squares(&residual) + beside(&state);
            let accepted = (0..HALVINGS).find_map(|halvings| {
                let to = state.stepped(&slots, step.as_slice(), 0.5_f64.powi(halvings as i32));
                let (response, residual) = self.residual(&to);
                let better = length < TRUSTED || squares(&residual) + beside(&to) <= before;
                better.then_some((to, response, residual))
            });
            let Some((to, after, rest)) = accepted else { break };
            (state, response, residual) = (to, after, rest);
            if length < DONE {
                break;
            }
        }
        Solution { state, response, residual, columns, normal }
    }
}
