//! The design: a triad's mean response for given parameters, and its derivative by each of them.
//!
//! Both run through the simulator's own stages ([`imu_model::simulator::response`]) and the effects' own `regress`.

use super::candidate::Candidate;
use super::clock::{Clock, delayed};
use super::{Filters, Record, Request, input};
use imu_model::effects::triad::{Axes, Drive, Vibration};
use imu_model::effects::{At, Effect as _, Stage, TemperatureBias, TriadEffect};
use imu_model::simulator::Motion;
use imu_model::simulator::response::{STAGES, stage};
use std::ops::Range;
use std::sync::Arc;

/// Half the step of the derivative by a delay, in samples: small on the scale of the cubic between them.
const DELAY_STEP: f64 = 0.02;

/// Half the step of the derivative by a stage's input, in parts of the largest: exact for squares.
const SLOPE_STEP: f64 = 1e-4;
const IDENTITY: [Axes; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
/// Number of samples that the cubic needs beyond its place.
const NODES_BEYOND: f64 = 2.0;

/// The parameter that one column of the design belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Slot {
    /// A coefficient of the candidate at this place.
    Coefficient(usize, usize),
    /// The delay of the triad: a latency or a clock's offset.
    Delay,
    /// The rate at which the triad falls behind.
    RateError,
    /// Bias per kelvin of an axis.
    Temperature(usize),
    /// The addition to the logarithm of an axis's open cutoff.
    Cutoff(usize),
}

/// Values of all fitted parameters.
#[derive(Debug, Clone)]
pub(super) struct State {
    /// Coefficients per candidate.
    pub(super) coefficients: Vec<Vec<f64>>,
    /// The delay in the middle of the record, s.
    pub(super) delay_s: f64,
    pub(super) rate_error: f64,
    pub(super) per_c: Axes,
    pub(super) ln_cutoff: Axes,
}

impl State {
    pub(super) fn value(&self, slot: Slot) -> f64 {
        match slot {
            Slot::Coefficient(candidate, place) => self.coefficients[candidate][place],
            Slot::Delay => self.delay_s,
            Slot::RateError => self.rate_error,
            Slot::Temperature(axis) => self.per_c[axis],
            Slot::Cutoff(axis) => self.ln_cutoff[axis],
        }
    }

    /// Returns the state after `share` of a step.
    pub(super) fn stepped(&self, slots: &[Slot], step: &[f64], share: f64) -> Self {
        let mut to = self.clone();
        for (slot, step) in slots.iter().zip(step) {
            let value = match *slot {
                Slot::Coefficient(candidate, place) => &mut to.coefficients[candidate][place],
                Slot::Delay => &mut to.delay_s,
                Slot::RateError => &mut to.rate_error,
                Slot::Temperature(axis) => &mut to.per_c[axis],
                Slot::Cutoff(axis) => &mut to.ln_cutoff[axis],
            };
            *value += share * step;
        }
        to
    }
}

/// Returns a stage's additional output for a change of each axis of its input: the image of the change, axis by axis.
fn slopes(effects: &[Arc<dyn TriadEffect>], drive: Drive, step: f64) -> [Axes; 3] {
    if effects.is_empty() {
        return IDENTITY;
    }
    let shifted = |axis: usize, by: f64| {
        let mut drive = drive;
        drive.input[axis] += by;
        stage(effects, drive)
    };
    std::array::from_fn(|axis| {
        let (above, below) = (shifted(axis, step), shifted(axis, -step));
        std::array::from_fn(|shown| (above[shown] - below[shown]) / (2.0 * step))
    })
}

/// Passes a change through stages that have these images of changes of single axes.
fn carried(images: &[Axes; 3], change: Axes) -> Axes {
    std::array::from_fn(|shown| (0..3).map(|axis| images[axis][shown] * change[axis]).sum())
}

/// One derivative of the response over the record, per axis; `None` if it is 0 throughout.
pub(super) type Column = [Option<Vec<f64>>; 3];

/// The known quantities and the ones to be fitted.
#[derive(Debug)]
pub(super) struct Design<'a> {
    record: &'a Record<'a>,
    pub(super) filters: &'a Filters,
    /// Effects that stay unchanged.
    kept: Vec<Arc<dyn TriadEffect>>,
    level: Axes,
    /// Effects that are fitted by regression.
    pub(super) candidates: Vec<Candidate>,
    pub(super) slots: Vec<Slot>,
    reference_c: f64,
}

impl<'a> Design<'a> {
    /// Returns the design and the state to start from: the known values of known effects, 0 for others.
    pub(super) fn new(record: &'a Record<'a>, request: &Request<'a>) -> (Self, State) {
        let candidates: Vec<Candidate> = request.candidates.iter().copied().filter(|one| one.is_linear()).collect();
        let mut coefficients: Vec<Vec<f64>> = candidates.iter().map(|one| one.make(&[]).coefficients()).collect();
        let mut kept = Vec::new();
        for effect in request.known {
            let mut taken = false;
            for (candidate, sums) in candidates.iter().zip(&mut coefficients) {
                if let Some(values) = candidate.coefficients_of(effect.as_ref()) {
                    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
                    taken = true;
                    break;
                }
            }
            if !taken {
                kept.push(Arc::clone(effect));
            }
        }
        let mut slots: Vec<Slot> = Vec::new();
        for (candidate, values) in coefficients.iter().enumerate() {
            slots.extend((0..values.len()).map(|place| Slot::Coefficient(candidate, place)));
        }
        let is_separate = request.clock == Clock::Separate;
        if is_separate || request.candidates.contains(&Candidate::Latency) {
            slots.push(Slot::Delay);
        }
        if is_separate {
            slots.push(Slot::RateError);
        }
        let mut reference_c = 0.0;
        if let Some(temperature_c) = record.temperature_c {
            slots.extend((0..3).map(Slot::Temperature));
            // Relative to the mean, so that the bias is that at the record's own temperature.
            reference_c = temperature_c.iter().sum::<f64>() / temperature_c.len().max(1) as f64;
        }
        slots.extend((0..3).filter(|axis| request.filters.open[*axis].is_some()).map(Slot::Cutoff));
        let delay_s = request.known.iter().map(|effect| effect.delay_s()).sum();
        let state = State { coefficients, delay_s, rate_error: 0.0, per_c: [0.0; 3], ln_cutoff: [0.0; 3] };
        (Self { record, filters: request.filters, kept, level: request.level, candidates, slots, reference_c }, state)
    }

    fn moved(&self, state: &State, further: f64) -> Vec<Motion> {
        let rate_hz = self.record.rate_hz;
        let middle = self.middle();
        let at = |index: usize| state.delay_s * rate_hz + state.rate_error * (index as f64 - middle) + further;
        delayed(self.record.reference, at)
    }

    fn middle(&self) -> f64 {
        0.5 * self.record.reference.len().saturating_sub(1) as f64
    }

    /// Returns the range of samples whose motion lies within the reference.
    pub(super) fn reached(&self, state: &State) -> Range<usize> {
        let n = self.record.reference.len();
        let delay =
            |index: usize| state.delay_s * self.record.rate_hz + state.rate_error * (index as f64 - self.middle());
        let (first, last) = (delay(0), delay(n - 1));
        // A hold of less than a sample or two at the ends does not lose motion.
        if first.abs().max(last.abs()) < NODES_BEYOND {
            return 0..n;
        }
        let ceil = |samples: f64| (samples + NODES_BEYOND).ceil().clamp(0.0, n as f64) as usize;
        let from = if first > 0.0 { ceil(first) } else { 0 };
        let to = if last < 0.0 { n - ceil(-last) } else { n };
        from..to.max(from)
    }

    /// Returns the known and the fitted effects of each memoryless stage.
    fn stages(&self, state: &State) -> [Vec<Arc<dyn TriadEffect>>; 3] {
        let fitted = self.candidates.iter().zip(&state.coefficients).map(|(one, values)| one.make(values));
        let all: Vec<Arc<dyn TriadEffect>> = self.kept.iter().cloned().chain(fitted).collect();
        STAGES.map(|at: Stage| all.iter().filter(|effect| effect.stage() == at).cloned().collect())
    }

    fn temperature_bias(&self, axis: usize, state: &State) -> TemperatureBias {
        TemperatureBias::linear(state.per_c[axis], self.reference_c)
    }

    /// Returns the mean output of the triad.
    pub(super) fn response(&self, state: &State) -> [Vec<f64>; 3] {
        let mut axes = self.unfiltered(state);
        axes.iter_mut().enumerate().for_each(|(axis, values)| self.pass(state, axis, values));
        axes
    }

    /// Returns the input of the filters.
    fn unfiltered(&self, state: &State) -> [Vec<f64>; 3] {
        let mut axes = self.answer(&self.stages(state), &self.moved(state, 0.0));
        for (axis, values) in axes.iter_mut().enumerate() {
            let bias = self.temperature_bias(axis, state);
            for (index, value) in values.iter_mut().enumerate() {
                *value = bias.mean_response(*value + self.level[axis], self.at(index));
            }
        }
        axes
    }

    /// Lets values of an axis pass its filters, in place.
    pub(super) fn pass(&self, state: &State, axis: usize, values: &mut [f64]) {
        self.filters.pass(axis, state.ln_cutoff[axis], self.record.rate_hz, values);
    }

    fn at(&self, index: usize) -> At {
        let temperature_c = self.record.temperature_c.and_then(|of| of.get(index).copied());
        At { time_s: index as f64 / self.record.rate_hz, temperature_c: temperature_c.unwrap_or(self.reference_c) }
    }

    /// Returns what acts on the triad in these motions, instant by instant.
    fn drives<'b>(&'b self, motions: &'b [Motion]) -> impl Iterator<Item = Drive> + 'b {
        let mut vibration = Vibration::new(self.record.rate_hz);
        motions.iter().enumerate().map(move |(index, motion)| Drive {
            input: input(self.record.triad, motion),
            accel_m_s2: motion.accel_m_s2,
            vibration_m2_s4: vibration.next(motion.accel_m_s2),
            temperature_c: self.record.temperature_c.and_then(|of| of.get(index).copied()),
        })
    }

    /// Returns the output of the memoryless stages.
    fn answer(&self, stages: &[Vec<Arc<dyn TriadEffect>>; 3], motions: &[Motion]) -> [Vec<f64>; 3] {
        let mut axes: [Vec<f64>; 3] = std::array::from_fn(|_| Vec::with_capacity(motions.len()));
        for mut drive in self.drives(motions) {
            for effects in stages {
                drive.input = stage(effects, drive);
            }
            axes.iter_mut().zip(drive.input).for_each(|(axis, value)| axis.push(value));
        }
        axes
    }

    /// Returns the response's derivatives in the order of the slots: those of the effects at their stage, carried
    /// through the stages after it.
    pub(super) fn columns(&self, state: &State) -> Vec<Column> {
        let stages = self.stages(state);
        let fitted: Vec<Arc<dyn TriadEffect>> =
            self.candidates.iter().zip(&state.coefficients).map(|(one, values)| one.make(values)).collect();
        let first: Vec<usize> = fitted
            .iter()
            .scan(0, |sum, effect| {
                let place = *sum;
                *sum += effect.coefficients().len();
                Some(place)
            })
            .collect();
        let n = self.record.reference.len();
        let mut columns: Vec<Column> = self.slots.iter().map(|_| Column::default()).collect();
        let put = |column: &mut Column, index: usize, axes: Axes| {
            for (values, value) in column.iter_mut().zip(axes) {
                if value != 0.0 {
                    values.get_or_insert_with(|| vec![0.0; n])[index] = value;
                }
            }
        };
        let moved = self.moved(state, 0.0);
        let peak = moved.iter().flat_map(|motion| input(self.record.triad, motion)).map(f64::abs).fold(0.0, f64::max);
        let step = if peak > 0.0 { SLOPE_STEP * peak } else { 1.0 };
        for (index, drive) in self.drives(&moved).enumerate() {
            let mut drives = [drive; 3];
            for place in 1..STAGES.len() {
                drives[place].input = stage(&stages[place - 1], drives[place - 1]);
            }
            // The image of a small change of each axis behind a stage.
            let mut after = IDENTITY;
            for (place, at) in STAGES.into_iter().enumerate().rev() {
                for (effect, first) in fitted.iter().zip(&first).filter(|(effect, _)| effect.stage() == at) {
                    for (coefficient, axes) in effect.regress(drives[place]).into_iter().enumerate() {
                        put(&mut columns[first + coefficient], index, carried(&after, axes));
                    }
                }
                if place > 0 {
                    after = slopes(&stages[place], drives[place], step).map(|change| carried(&after, change));
                }
            }
        }
        self.other_columns(state, &stages, &mut columns);
        for column in &mut columns {
            for (axis, values) in column.iter_mut().enumerate() {
                if let Some(values) = values {
                    self.pass(state, axis, values);
                }
            }
        }
        if self.slots.iter().any(|slot| matches!(slot, Slot::Cutoff(_))) {
            let mut shown = self.unfiltered(state);
            for (slot, column) in self.slots.iter().zip(&mut columns) {
                if let Slot::Cutoff(axis) = *slot {
                    let mut values = std::mem::take(&mut shown[axis]);
                    self.filters.slope(axis, state.ln_cutoff[axis], self.record.rate_hz, &mut values);
                    column[axis] = Some(values);
                }
            }
        }
        columns
    }

    /// Returns the columns of delay, rate error and temperature.
    fn other_columns(&self, state: &State, stages: &[Vec<Arc<dyn TriadEffect>>; 3], columns: &mut [Column]) {
        let delayed = self.slots.iter().any(|slot| matches!(slot, Slot::Delay | Slot::RateError));
        let slope = delayed.then(|| {
            let later = self.answer(stages, &self.moved(state, DELAY_STEP));
            let sooner = self.answer(stages, &self.moved(state, -DELAY_STEP));
            let per_s = self.record.rate_hz / (2.0 * DELAY_STEP);
            let difference = |axis: usize| {
                let pairs = later[axis].iter().zip(&sooner[axis]);
                pairs.map(|(later, sooner)| per_s * (later - sooner)).collect::<Vec<f64>>()
            };
            [difference(0), difference(1), difference(2)]
        });
        let some = |values: Vec<f64>| values.iter().any(|value| *value != 0.0).then_some(values);
        for (slot, column) in self.slots.iter().zip(columns) {
            match (*slot, &slope) {
                (Slot::Delay, Some(slope)) => *column = slope.clone().map(some),
                (Slot::RateError, Some(slope)) => {
                    let middle = self.middle();
                    *column = slope.clone().map(|mut values| {
                        for (index, value) in values.iter_mut().enumerate() {
                            *value *= (index as f64 - middle) / self.record.rate_hz;
                        }
                        some(values)
                    });
                }
                (Slot::Temperature(axis), _) => {
                    let bias = self.temperature_bias(axis, state);
                    let mut row = [0.0];
                    let at = |index: usize| {
                        bias.regress(self.at(index), &mut row);
                        row[0]
                    };
                    column[axis] = some((0..self.record.reference.len()).map(at).collect());
                }
                _ => {}
            }
        }
    }
}
