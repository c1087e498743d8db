//! Filters: the sensor's bandwidth, which acts on motion and noise alike.
//!
//! Noise determines a low pass's cutoff to some accuracy and without its phase; a motion shows the low pass mostly as a
//! delay. Noise and motion together determine a latency beside a filter: the logarithm of the cutoff is fitted, and the
//! noise's estimate enters as one more observation.

use crate::law::reach;
use imu_model::effects::{Effect, EffectKind, LowPass, Stream, StreamId};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// The filters that the motion of each axis passes, at the record's rate.
#[derive(Debug, Clone, Default)]
pub struct Filters {
    /// The filters of x, y and z, each in their order.
    pub of: [Vec<Arc<dyn Effect>>; 3],
    /// For each axis, the index of the low pass whose cutoff is fitted, and the standard error of its logarithm.
    pub open: [Option<(usize, f64)>; 3],
}

/// No filters on any axis.
pub static NO_FILTERS: Filters = Filters { of: [Vec::new(), Vec::new(), Vec::new()], open: [None; 3] };
/// Half the step of the derivative by the logarithm.
const STEP: f64 = 1e-3;
/// The upper bound of a cutoff, as a part of the rate.
const HIGHEST: f64 = 0.49;
/// The smallest starting value of a supposed cutoff, as a part of the rate.
const LOWEST: f64 = 0.005;
/// The starting value if there is no information.
const START: f64 = 0.1;
/// Standard error of the logarithm of a cutoff without prior information.
const WIDE_OPEN: f64 = 3.0;
/// A filter's memory, in multiples of rate over cutoff, which is 2π of its time constants.
const FORGETS: f64 = 3.0;

impl Filters {
    /// Filters the values of an axis in place, linearly and beginning from their first value. `moved` is added to the
    /// logarithm of the open cutoff.
    pub(crate) fn pass(&self, axis: usize, moved: f64, rate_hz: f64, values: &mut [f64]) {
        let length_s = values.len() as f64 / rate_hz;
        let open = self.open[axis].map(|(place, _)| place).filter(|_| moved != 0.0);
        for (place, filter) in self.of[axis].iter().enumerate() {
            // A filter does not use random draws.
            let stream = Stream::new(0, StreamId { owner: 0, effect: 0, instance: 0 });
            let other = low_pass(filter.as_ref()).filter(|_| open == Some(place)).map(|own| {
                let cutoff_hz = (own.cutoff_hz * moved.exp()).min(own.cutoff_hz.max(HIGHEST * rate_hz));
                LowPass { cutoff_hz, ..own }
            });
            let filter = other.as_ref().map_or(filter.as_ref(), |other| other as &dyn Effect);
            filter.sampler(rate_hz, length_s, stream).apply(values);
        }
    }

    /// Replaces the input by the derivative of the output by the logarithm of the open cutoff.
    pub(super) fn slope(&self, axis: usize, moved: f64, rate_hz: f64, values: &mut [f64]) {
        let mut above = values.to_vec();
        self.pass(axis, moved + STEP, rate_hz, &mut above);
        self.pass(axis, moved - STEP, rate_hz, values);
        values.iter_mut().zip(above).for_each(|(value, above)| *value = (above - *value) / (2.0 * STEP));
    }

    /// Returns the filters with a low pass of this order added to every axis without one. The prior of its cutoff is so
    /// weak that the motion alone determines it. The cutoff starts at that of the triad's other axes, else at the value
    /// that would cause this delay. `None` if every axis has a low pass.
    pub(crate) fn supposed(&self, order: u64, delay_s: Option<f64>, rate_hz: f64) -> Option<Self> {
        let own = |axis: usize| self.of[axis].iter().find_map(|filter| low_pass(filter.as_ref()));
        // The delay of a Butterworth filter of order n is 1/(2πf·sin(π/2n)).
        let lags = |seconds: f64| (TAU * seconds * (PI / (2 * order) as f64).sin()).recip();
        let start_hz = delay_s.filter(|seconds| *seconds > 0.0).map_or(START * rate_hz, lags);
        let other = (0..3).find_map(own).unwrap_or(LowPass::new(start_hz, order));
        let cutoff_hz = other.cutoff_hz.clamp(LOWEST * rate_hz, HIGHEST * rate_hz);
        if (0..3).all(|axis| own(axis).is_some()) {
            return None;
        }
        let mut all = self.clone();
        for axis in (0..3).filter(|axis| own(*axis).is_none()) {
            all.open[axis] = Some((all.of[axis].len(), WIDE_OPEN));
            all.of[axis].push(Arc::new(LowPass::new(cutoff_hz, other.order)));
        }
        Some(all)
    }

    /// Returns the number of samples after which the input before a record's first sample no longer shows. The input
    /// decays by e to the −6π, more slowly behind the sharper corners of higher orders.
    pub(crate) fn memory(&self, rate_hz: f64) -> usize {
        let of = |filter: &dyn Effect| match low_pass(filter) {
            Some(own) => FORGETS * rate_hz / own.cutoff_hz / (PI / (2 * own.order) as f64).sin(),
            None => reach(filter, rate_hz) as f64,
        };
        self.of.iter().flatten().map(|filter| of(filter.as_ref())).fold(0.0, f64::max).ceil() as usize
    }

    /// Returns the prior information about an axis's cutoff: the inverse variance of its logarithm.
    pub(super) fn weight(&self, axis: usize) -> f64 {
        self.open[axis].map_or(0.0, |(_, error)| error.powi(-2))
    }
}

fn low_pass(effect: &dyn Effect) -> Option<LowPass> {
    (effect.kind() == EffectKind::LowPass).then_some(())?;
    Some(LowPass::new(effect.number("cutoff_hz")?, effect.number("order")? as u64))
}

#[cfg(test)]
mod tests {
    use super::super::round_trip::{Case, RATE_HZ, rate_table};
    use super::super::{Candidate, Clock, Fit, Record, Request, fit};
    use super::*;
    use imu_core::sample::Triad;
    use imu_model::effects::MovingAverage;

    /// Returns the fit of a triad behind a low pass of `sent_hz` with one of `declared_hz` whose logarithm is known to
    /// `error`.
    fn fitted(seed: u64, sent_hz: f64, declared_hz: f64, error: f64) -> Fit {
        let case = Case::new(Triad::Gyro, rate_table(), &[]);
        let filters = |cutoff_hz| Filters {
            of: std::array::from_fn(|_| vec![Arc::new(LowPass::new(cutoff_hz, 2)) as Arc<dyn Effect>]),
            open: [Some((0, error)); 3],
        };
        let mut samples = case.samples(seed);
        for (axis, values) in samples.iter_mut().enumerate() {
            let mut motion: Vec<f64> = case.reference.iter().map(|motion| motion.gyro_rad_s[axis]).collect();
            values.iter_mut().zip(&motion).for_each(|(value, of)| *value -= of);
            filters(sent_hz).pass(axis, 0.0, RATE_HZ, &mut motion);
            values.iter_mut().zip(&motion).for_each(|(value, of)| *value += of);
        }
        let record = Record {
            rate_hz: RATE_HZ,
            triad: Triad::Gyro,
            samples: samples.each_ref().map(Vec::as_slice),
            reference: &case.reference,
            temperature_c: None,
            left_out: &[],
            sent: None,
        };
        let request = Request {
            known: &[],
            level: [0.0; 3],
            candidates: &[Candidate::Latency],
            clock: Clock::Shared,
            filters: &filters(declared_hz),
        };
        fit(&record, &case.law, &request).unwrap()
    }

    #[test]
    fn a_cutoff_that_the_noise_determined_badly_is_found_and_is_no_latency() {
        let mut inside = 0;
        for seed in 0..20 {
            let found = fitted(seed, 4.0, 4.0 * 0.06_f64.exp(), 0.05);
            let of = |name: &str| found.estimates.iter().find(|one| one.parameter == name).unwrap();
            let (latency, corner) = (of("seconds"), of("x ln_cutoff"));
            assert!(latency.value.abs() < 4.0 * latency.standard_error.unwrap(), "{latency:?}");
            assert!(corner.standard_error.unwrap() < 0.05, "{corner:?}");
            let [low, high] = latency.ci95();
            inside += usize::from((low..high).contains(&0.0));
        }
        assert!(inside >= 17, "{inside} of 20");
    }

    #[test]
    fn a_motion_with_little_information_leaves_the_cutoff_as_the_noise_determined_it() {
        let found = fitted(3, 4.0, 4.0, 1e-6);
        let corner = found.estimates.iter().find(|one| one.parameter == "y ln_cutoff").unwrap();
        assert!(corner.value.abs() < 5e-6 && (corner.standard_error.unwrap() / 1e-6 - 1.0).abs() < 1e-3, "{corner:?}");
    }

    #[test]
    fn only_an_open_low_pass_is_moved() {
        let filters = |cutoff_hz, open: Option<f64>| {
            let low_pass: Arc<dyn Effect> = Arc::new(LowPass::new(cutoff_hz, 3));
            let mean: Arc<dyn Effect> = Arc::new(MovingAverage::new(4));
            let open = open.map(|error| (1, error));
            Filters { of: [vec![mean, low_pass], Vec::new(), Vec::new()], open: [open, Some((0, 0.1)), None] }
        };
        let passed = |filters: Filters, axis, moved| {
            let mut values: Vec<f64> = (0..50).map(|index| f64::from(index % 7)).collect();
            filters.pass(axis, moved, 100.0, &mut values);
            values
        };
        let (plain, other) = (passed(filters(10.0, None), 0, 0.0), passed(filters(10.0 * 0.1_f64.exp(), None), 0, 0.0));
        assert_eq!(passed(filters(10.0, None), 0, 0.1), plain);
        assert_eq!(passed(filters(10.0, Some(0.1)), 0, 0.1), other);
        assert!(plain != other);
        // The cutoff moves only up to the limit of the rate. Without a filter, nothing changes.
        assert_eq!(passed(filters(10.0, Some(0.1)), 0, 9.0), passed(filters(49.0, None), 0, 0.0));
        assert_eq!(passed(filters(10.0, None), 1, 0.1), passed(filters(10.0, None), 2, 0.0));
    }

    #[test]
    fn a_filter_is_supposed_where_there_is_none_and_begins_with_the_delay_it_would_make() {
        let none = NO_FILTERS.clone();
        let supposed = none.supposed(1, Some(0.02), 100.0).unwrap();
        let of = low_pass(supposed.of[2][0].as_ref()).unwrap();
        assert!((of.cutoff_hz * TAU * 0.02 - 1.0).abs() < 1e-12 && supposed.open[2] == Some((0, WIDE_OPEN)));
        let low_pass_at = |cutoff_hz| Arc::new(LowPass::new(cutoff_hz, 2)) as Arc<dyn Effect>;
        let one = Filters { of: [vec![low_pass_at(5.0)], Vec::new(), Vec::new()], open: [Some((0, 0.02)), None, None] };
        let others = one.supposed(1, Some(0.02), 100.0).unwrap();
        assert_eq!(
            (low_pass(others.of[1][0].as_ref()), others.open[0]),
            (low_pass(one.of[0][0].as_ref()), Some((0, 0.02)))
        );
        assert!(others.supposed(1, None, 100.0).is_none());
        // Three times rate over cutoff, more for a sharper corner.
        assert_eq!((supposed.memory(100.0), one.memory(100.0), none.memory(100.0)), (38, 85, 0));
    }
}
