//! Bursts: stretches of extra noise, such as knocks and handling.

use super::described::effect;
use super::spec::{FROM_ZERO, Form};
use super::{Effect, Extent, Moments, Record, Sampler, Stage, Stream, each, sampled};

effect! {
    /// White noise of root mean square `sigma` per sample inside the intervals; overlapping intervals count once.
    ///
    /// An interval holds the samples from its first instant to before its last. Spectrum: flat, but only inside;
    /// averaged over a record it is σ²/rate times the share of the samples inside, which depends on more than the
    /// parameters (`None`).
    #[derive(Debug, Clone, PartialEq)]
    pub struct Bursts: dyn Effect, 11, Stage::Noise, Samples;
    "white noise inside intervals: knocks, handling";
    intervals: Vec<(f64, f64)> = Form::Intervals, "s", "[from_s, to_s] after the start";
    sigma: f64 = FROM_ZERO, "U", "root mean square per sample, U";
}

impl Bursts {
    /// Returns the samples inside as ranges that neither overlap nor touch, in order.
    pub fn ranges(&self, rate_hz: f64) -> Vec<(u64, u64)> {
        let index = |time_s| sampled::index_at(time_s, rate_hz);
        let mut ranges: Vec<_> = self.intervals.iter().map(|(from, to)| (index(*from), index(*to))).collect();
        ranges.sort_unstable();
        let mut merged: Vec<(u64, u64)> = Vec::new();
        for (from, to) in ranges {
            match merged.last_mut() {
                Some(last) if from <= last.1 => last.1 = last.1.max(to),
                _ => merged.push((from, to)),
            }
        }
        merged
    }

    /// Returns the number of the record's samples that are inside.
    pub(super) fn inside(&self, record: Record) -> u64 {
        let until = |index: u64| index.min(record.samples);
        self.ranges(record.rate_hz).iter().map(|(from, to)| until(*to) - until(*from)).sum()
    }
}

impl Effect for Bursts {
    fn extents(&self) -> Vec<Extent> {
        self.intervals.iter().map(|(from_s, to_s)| Extent::time(*from_s, *to_s, to_s - from_s)).collect()
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        None
    }
    /// A sample inside belongs to as many of the n − 2m + 1 windows of 2m as reach it, and adds σ²/m² to the difference
    /// of each window.
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        let last_start = record.samples.checked_sub(2 * m).filter(|_| m > 0)?;
        let windows = |index: u64| index.min(last_start) - (index + 1).saturating_sub(2 * m).min(last_start + 1) + 1;
        let ranges = self.ranges(record.rate_hz);
        let samples = ranges.iter().flat_map(|(from, to)| *from..(*to).min(record.samples));
        let count: f64 = samples.map(|index| windows(index) as f64).sum();
        Some(0.5 * self.sigma * self.sigma * count / (last_start as f64 + 1.0) / (m as f64 * m as f64))
    }
    fn moments(&self, record: Record) -> Option<Moments> {
        let share = self.inside(record) as f64 / record.samples.max(1) as f64;
        Some(Moments { variance: self.sigma * self.sigma * share, kurtosis: (share > 0.0).then(|| 3.0 / share) })
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let mut ranges = self.ranges(rate_hz);
        ranges.reverse();
        let (sigma, mut index) = (self.sigma, 0_u64);
        each(move |value| {
            while ranges.last().is_some_and(|range| range.1 <= index) {
                ranges.pop();
            }
            if ranges.last().is_some_and(|range| range.0 <= index) {
                *value += sigma * stream.normal();
            }
            index += 1;
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn allan_variance_and_moments_are_those_of_noise_inside_the_intervals() {
        let intervals = vec![(300.0, 500.0), (10.0, 11.0), (10.5, 40.0)];
        check::agrees_with_its_closed_forms(&Bursts { intervals, sigma: 0.6 }, 40.0);
    }

    #[test]
    fn nothing_is_added_outside_and_overlaps_count_once() {
        let bursts = Bursts { intervals: vec![(1.0, 2.0), (1.5, 2.5), (3.0, 3.1)], sigma: 1.0 };
        let values = check::draw(&bursts, 10.0, 50, 2);
        let inside = |index: usize| (10..25).contains(&index) || index == 30;
        assert!((0..50).all(|index| (values[index] != 0.0) == inside(index)));
    }

    #[test]
    fn an_interval_that_ends_before_it_begins_is_refused() {
        let refusal = Bursts { intervals: vec![(0.0, 1.0), (3.0, 2.0)], sigma: 1.0 }.check(40.0).unwrap_err();
        assert_eq!((refusal.parameter.as_str(), refusal.found.as_str()), ("intervals[1]", "[3.0,2.0]"));
        assert!(Bursts { intervals: Vec::new(), sigma: 1.0 }.check(40.0).is_err());
    }
}
