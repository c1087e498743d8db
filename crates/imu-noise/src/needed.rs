//! How long to record: the time at rest after which B and K are known to ±20 %, and the averaging time from which on a
//! walk would show.
//!
//! The expected information of the squared coefficients in a record of n samples without a gap is that of the sine
//! transform's coefficients (`whittle`): each z_k² contributes a half of (∂ln λ_k)² for k = 1 to n − 1. N, B and K are
//! free, whether named or not, as for the intervals; a parameter that is not named counts with size 0. The filter in
//! front of the samples is left out, because frequencies far below it determine B and K. Records whose law misfits need
//! more time, in proportion to the widening of their intervals.

use super::fit::{Estimate, NoiseParameters, RecordNeeded, Term};
use super::whittle::MISFIT;
use std::f64::consts::PI;

/// Relative standard error at which 95 % of the values lie within ±20 %.
const WANTED: f64 = 0.2 / 1.96;
/// The longest time that is reported, s: 1000 h.
const LONGEST_S: f64 = 3.6e6;
/// Minimum number of samples for a fit.
const LEAST: f64 = 64.0;

impl RecordNeeded {
    /// Returns the times for noise of these parameters, sampled at `rate_hz`; rounded up to two digits.
    ///
    /// # Validation
    /// `estimates_scatter_by_a_tenth_after_the_stated_time`: the scatter of fits of simulated records of that length.
    pub fn of(parameters: &NoiseParameters, rate_hz: f64) -> Self {
        let needed = |term| Law::of(parameters, rate_hz, term)?.needed_s();
        Self { b: needed(Term::B), k: needed(Term::K) }
    }
}

/// Returns the averaging time at which a walk as large as its upper limit would reach the lowest deviation, s: K²τ/3 is
/// its Allan variance (IEEE Std 952-1997, annex C). `None` if a walk is identified, or if limit or lowest deviation are
/// unknown.
pub fn walk_shows_beyond_s(parameters: &NoiseParameters) -> Option<f64> {
    let limit = parameters.k.upper_limit95.filter(|limit| !parameters.k.identified && *limit > 0.0)?;
    let tau_s = 3.0 * (parameters.minimum?.deviation / limit).powi(2);
    tau_s.is_finite().then_some(tau_s)
}

/// One unknown: its square, and its share of the spectrum for a square of 1.
struct Column<'a> {
    square: f64,
    spectrum: Box<dyn Fn(f64) -> f64 + 'a>,
    /// The column is a derivative by another column's number and adds no power.
    is_slope: bool,
}

/// The law of a record, with the wanted unknown last.
struct Law<'a> {
    columns: Vec<Column<'a>>,
    rate_hz: f64,
    widen: f64,
}

impl<'a> Law<'a> {
    /// Returns the law; `None` if `wanted` has no value.
    fn of(parameters: &NoiseParameters, rate_hz: f64, wanted: Term) -> Option<Law<'a>> {
        let size = |of: &Estimate| of.value.filter(|value| of.identified && value.is_finite());
        size(parameters.estimate(wanted)).filter(|value| *value > 0.0)?;
        if !(rate_hz.is_finite() && rate_hz > 0.0) {
            return None;
        }
        let dt_s = 1.0 / rate_hz;
        let column = |term: Term| Column {
            square: size(parameters.estimate(term)).unwrap_or(0.0).powi(2),
            spectrum: Box::new(move |u| term.spectrum(u, dt_s)),
            is_slope: false,
        };
        let mut columns: Vec<Column<'a>> = Vec::new();
        columns.extend([Term::N, Term::B, Term::K].into_iter().filter(|term| *term != wanted).map(column));
        columns.extend(size(&parameters.q).map(|_| column(Term::Q)));
        let process = parameters.gauss_markov.as_ref().and_then(|of| of.sigma.value.zip(of.tc_s.value));
        if let Some((sigma, tc_s)) = process {
            let of = move |tc_s: f64, u: f64| 2.0 * tc_s / (1.0 + (2.0 * PI * u * tc_s / dt_s).powi(2));
            columns.push(Column { square: sigma * sigma, spectrum: Box::new(move |u| of(tc_s, u)), is_slope: false });
            let slope = move |u: f64| (of(1.01 * tc_s, u) - of(0.99 * tc_s, u)) / 0.02;
            columns.push(Column { square: sigma * sigma, spectrum: Box::new(slope), is_slope: true });
        }
        columns.push(column(wanted));
        let misfit = parameters.fit.p_value.is_some_and(|p| p < MISFIT);
        let scatter = parameters.fit.chi2.zip(parameters.fit.degrees_of_freedom).filter(|_| misfit);
        let widen = scatter.map_or(1.0, |(chi2, degrees)| (chi2 / degrees.max(1) as f64).sqrt().max(1.0));
        Some(Law { columns, rate_hz, widen })
    }

    /// Returns the relative standard error of the wanted coefficient in a record of `samples` samples.
    ///
    /// The error of a coefficient is half that of its square. Its information given all others is Cholesky's last
    /// pivot.
    fn error(&self, samples: f64) -> Option<f64> {
        /// Coefficients that are taken one by one; beyond them, in groups of 5 % of their frequency.
        const SINGLE: f64 = 40.0;
        const RATIO: f64 = 1.05;
        let size = self.columns.len();
        let mut information = vec![vec![0.0; size]; size];
        let mut k = 1.0;
        while k < samples {
            let next = if k < SINGLE { k + 1.0 } else { (k * RATIO).ceil().min(samples) };
            let u = 0.5 * (k + next - 1.0) / (2.0 * samples);
            let shares: Vec<f64> = self.columns.iter().map(|column| (column.spectrum)(u)).collect();
            let own = self.columns.iter().zip(&shares).filter(|(column, _)| !column.is_slope);
            let all: f64 = own.map(|(column, share)| column.square * share).sum();
            for (row, one) in information.iter_mut().zip(&shares) {
                for (entry, other) in row.iter_mut().zip(&shares) {
                    *entry += 0.5 * (next - k) * (one / all) * (other / all);
                }
            }
            k = next;
        }
        let pivot = last_pivot(&information)?;
        let square = self.columns.last()?.square;
        Some(0.5 * self.widen / (pivot.sqrt() * square)).filter(|error| error.is_finite())
    }

    fn needed_s(&self) -> Option<f64> {
        let enough = |samples: f64| self.error(samples).is_some_and(|error| error <= WANTED);
        let (mut short, mut long) = (LEAST, LONGEST_S * self.rate_hz);
        if !enough(long) {
            return None;
        }
        while long / short > 1.01 {
            let middle = (short * long).sqrt().ceil();
            if enough(middle) { long = middle } else { short = middle }
        }
        let seconds = long / self.rate_hz;
        let digit = 10f64.powf(seconds.log10().floor() - 1.0);
        Some((seconds / digit).ceil() * digit)
    }
}

/// Returns the part of a positive matrix that remains for its last unknown when all others are free. `None` if the
/// unknowns cannot be separated.
fn last_pivot(matrix: &[Vec<f64>]) -> Option<f64> {
    /// If the rest is smaller than this share of the whole, the unknowns cannot be separated.
    const DEPENDENT: f64 = 1e-12;
    let scale: Vec<f64> = matrix.iter().enumerate().map(|(at, row)| row[at].sqrt()).collect();
    let mut lower: Vec<Vec<f64>> = Vec::new();
    let mut rest = 0.0;
    for (row, own) in matrix.iter().enumerate() {
        let mut entries: Vec<f64> = Vec::new();
        for column in 0..=row {
            let above = if column == row { &entries } else { lower.get(column)? };
            let known: f64 = entries.iter().zip(above).take(column).map(|(one, other)| one * other).sum();
            let left = own[column] / (scale[row] * scale[column]) - known;
            if column == row {
                rest = left;
                if left.is_nan() || left <= DEPENDENT {
                    return None;
                }
            }
            entries.push(if column == row { left.sqrt() } else { left / above.get(column)? });
        }
        lower.push(entries);
    }
    Some(rest * scale.last()?.powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allan::FixedPoint;
    use crate::fit::{Flag, Minimum, nothing};
    use crate::whittle::{DstEstimator, Transform, fit};
    use imu_core::sample::Channel;
    use imu_model::effects::{Effect, Flicker, RandomWalk, Stream, StreamId, White};

    const RATE_HZ: f64 = 40.0;

    fn parameters([n, b, k]: [f64; 3]) -> NoiseParameters {
        let estimate = |term, value: f64| match value {
            0.0 => Estimate::unidentified(Channel::GyroX, term, Some(1e-6)),
            _ => Estimate::identified(Channel::GyroX, term, value, [value; 2]),
        };
        NoiseParameters {
            n: estimate(Term::N, n),
            b: estimate(Term::B, b),
            k: estimate(Term::K, k),
            ..nothing(Channel::GyroX, "", Flag::whole("", ""))
        }
    }

    fn record([n, b, k]: [f64; 3], samples: usize, seed: u64) -> Vec<f64> {
        let mut values = vec![0.0; samples];
        let length_s = samples as f64 / RATE_HZ;
        for (effect, own) in (1..).zip([&White { n } as &dyn Effect, &Flicker { b }, &RandomWalk { k }]) {
            let stream = Stream::new(seed, StreamId { owner: 9, effect, instance: 7 });
            own.sampler(RATE_HZ, length_s, stream).apply(&mut values);
        }
        values
    }

    /// For five hours of a sensor, an independent program gives a Cramér–Rao bound of 3.83 % and 21.95 % for N 3.5e-3,
    /// B 1e-3, K 5e-5.
    #[test]
    fn errors_are_those_of_the_bound() {
        let of = parameters([3.5e-3, 1e-3, 5e-5]);
        for (term, bound) in [(Term::B, 0.0383), (Term::K, 0.2195)] {
            let error = Law::of(&of, RATE_HZ, term).unwrap().error(720_000.0).unwrap();
            assert!((error / bound - 1.0).abs() < 0.05, "{term:?}: {error}");
        }
        let needed = RecordNeeded::of(&of, RATE_HZ);
        // An error decreases with the root of the time: (3.83/10.2)² of five hours, and more than (21.95/10.2)² of
        // them.
        assert!((2000.0..3500.0).contains(&needed.b.unwrap()), "{needed:?}");
        assert!((60_000.0..130_000.0).contains(&needed.k.unwrap()), "{needed:?}");
    }

    #[test]
    fn estimates_scatter_by_a_tenth_after_the_stated_time() {
        const SEEDS: u64 = 24;
        let truth = [1.5e-3, 1e-3, 4e-4];
        let needed = RecordNeeded::of(&parameters(truth), RATE_HZ);
        let mut transform = Transform::new();
        for (term, seconds, truth_of) in [(Term::B, needed.b, truth[1]), (Term::K, needed.k, truth[2])] {
            let samples = (seconds.unwrap() * RATE_HZ) as usize;
            assert!((8_000..800_000).contains(&samples), "{term:?}: {samples}");
            let squares = (1..=SEEDS).map(|seed| {
                let mut estimator = DstEstimator::new(FixedPoint::for_range(0, 6).unwrap());
                estimator.push(&mut transform, &record(truth, samples, seed));
                let found = fit(&estimator.into_sums(&mut transform), RATE_HZ, Channel::GyroX, &[], None);
                (found.estimate(term).value.unwrap() / truth_of - 1.0).powi(2)
            });
            let scatter = (squares.sum::<f64>() / SEEDS as f64).sqrt();
            println!("{term:?} after {seconds:?} s: {scatter:.3}");
            // 24 squares determine a deviation to 15 %.
            assert!((0.6..1.5).contains(&(scatter / WANTED)), "{term:?} after {seconds:?} s: {scatter}");
        }
    }

    #[test]
    fn what_is_not_identified_has_no_time_and_a_misfit_takes_longer() {
        let white = parameters([3.5e-3, 0.0, 0.0]);
        assert_eq!(RecordNeeded::of(&white, RATE_HZ), RecordNeeded::default());
        // Such a weak walk takes more than a thousand hours.
        assert_eq!(RecordNeeded::of(&parameters([3.5e-3, 1e-3, 1e-8]), RATE_HZ).k, None);
        let of = parameters([3.5e-3, 1e-3, 0.0]);
        let mut misfit = of.clone();
        misfit.fit.p_value = Some(1e-9);
        (misfit.fit.chi2, misfit.fit.degrees_of_freedom) = (Some(400.0), Some(100));
        let [plain, longer] = [of, misfit].map(|of| RecordNeeded::of(&of, RATE_HZ).b.unwrap());
        assert!(longer > 3.0 * plain, "{plain} {longer}");
    }

    #[test]
    fn a_walk_at_its_limit_reaches_the_lowest_deviation_at_the_stated_time() {
        let mut of = parameters([3.5e-3, 1e-3, 0.0]);
        assert_eq!(walk_shows_beyond_s(&of), None);
        of.minimum = Some(Minimum { deviation: 6e-4, tau_s: 100.0, over_0_664: 9e-4 });
        let tau_s = walk_shows_beyond_s(&of).unwrap();
        assert!((1e-6 * (tau_s / 3.0).sqrt() / 6e-4 - 1.0).abs() < 1e-9, "{tau_s}");
        assert_eq!(walk_shows_beyond_s(&parameters([3.5e-3, 1e-3, 5e-5])), None);
    }
}
