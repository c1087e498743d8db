//! Bias step: the level jumps once and stays.

use super::described::effect;
use super::spec::{ANY, Form};
use super::{At, Effect, Extent, Record, Sampler, Stage, Stream, each, sampled};

effect! {
    /// A bias of `size` from the first sample at or after `at_s` on.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct BiasStep: dyn Effect, 0, Stage::Bias;
    "the level jumps once and stays" => "a step of {size:.3e} at {at_s:.1} s{more}";
    at_s: f64 = Form::Time, "s", "when, s after the start";
    size: f64 = ANY, "U", "by how much, U; signed";
}

/// Returns 1² + … + n², 0 for n below 1.
fn squares_up_to(n: i128) -> i128 {
    let n = n.max(0);
    n * (n + 1) * (2 * n + 1) / 6
}

impl Effect for BiasStep {
    fn extents(&self) -> Vec<Extent> {
        vec![Extent::time(self.at_s, self.at_s, self.size * self.size)]
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(0.0)
    }
    /// The averages around a step that lies j samples after the first one's start differ by size·j/m up to j = m and by
    /// size·(2m − j)/m from there to 2m. Returns half the mean square over the record, in closed form.
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
        let (size, mut before) = (self.size, sampled::index_at(self.at_s, rate_hz));
        each(move |value| match before {
            0 => *value += size,
            _ => before -= 1,
        })
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
