//! Bias step: the level jumps once and stays.

use super::spec::{Kind, Range, number};
use super::stream::number as streams;
use super::{At, Effect, Record, Sampler, Spec, Stage, Stream, Temperature, sampled};
use serde_json::Value;
use std::sync::Arc;

/// A bias of `size` from the first sample at or after `at_s` on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BiasStep {
    /// When, s after the start.
    pub at_s: f64,
    /// By how much, U; signed.
    pub size: f64,
}

static SPEC: Spec = Spec {
    name: "bias_step",
    stream: streams::NONE,
    stage: Stage::Bias,
    parameters: &[
        number("at_s", Range::FromZero, "when, s after the start"),
        number("size", Range::Any, "by how much, U; signed"),
    ],
    forms: &[],
    meaning: "the level jumps once and stays",
};
pub(super) static KIND: Kind<dyn Effect> = Kind {
    spec: &SPEC,
    make: |values| Arc::new(BiasStep { at_s: values.number("at_s"), size: values.number("size") }),
};

/// 1² + … + n², 0 for n below 1.
fn squares_up_to(n: i128) -> i128 {
    let n = n.max(0);
    n * (n + 1) * (2 * n + 1) / 6
}

impl Effect for BiasStep {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        vec![("at_s", self.at_s.into()), ("size", self.size.into())]
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(0.0)
    }
    /// The averages around a step that lies j samples after the first one's start differ by size·j/m up to j = m and by
    /// size·(2m − j)/m from there to 2m; half the mean square over the record, in closed form.
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        let last_start = i128::from(record.samples.checked_sub(2 * m).filter(|_| m > 0)?);
        let (step, width) = (i128::from(record.index_at(self.at_s)), i128::from(m));
        // j runs over step − last_start … step.
        let (from, to) = (step - last_start, step);
        let rising = squares_up_to(to.min(width)) - squares_up_to(from.min(width + 1) - 1);
        // i = 2m − j runs from 2m − to … 2m − from, as far as it is below m.
        let (low, high) = ((2 * width - to).max(1), (2 * width - from).min(width - 1));
        let falling = if high >= low { squares_up_to(high) - squares_up_to(low - 1) } else { 0 };
        let mean_square = (rising + falling) as f64 / (last_start as f64 + 1.0) / (m as f64 * m as f64);
        Some(0.5 * self.size * self.size * mean_square)
    }
    fn mean_response(&self, input: f64, at: At) -> f64 {
        if at.time_s >= self.at_s { input + self.size } else { input }
    }
    fn regressors(&self) -> usize {
        1
    }
    fn regress(&self, at: At, row: &mut [f64]) {
        row[0] = if at.time_s >= self.at_s { 1.0 } else { 0.0 };
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, _stream: Stream) -> Box<dyn Sampler> {
        Box::new(StepSampler { before: sampled::index_at(self.at_s, rate_hz), size: self.size })
    }
}

/// How many samples are left before the step.
#[derive(Debug)]
struct StepSampler {
    before: u64,
    size: f64,
}

impl Sampler for StepSampler {
    fn act(&mut self, values: &mut [f64], _temperature: Temperature<'_>) {
        let first = usize::try_from(self.before).unwrap_or(usize::MAX).min(values.len());
        self.before -= first as u64;
        for value in &mut values[first..] {
            *value += self.size;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn allan_variance_and_course_are_those_of_a_step() {
        for at_s in [0.0, 0.5, 100.0, 395.0, 409.0, 1e6] {
            check::agrees_with_its_closed_forms(&BiasStep { at_s, size: 0.7 }, 40.0);
        }
    }
}
