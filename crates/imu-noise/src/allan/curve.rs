//! Curves: deviation against averaging time with confidence intervals, in the form of docs/formats.md.

use super::edf::{CONFIDENCE_68, confidence_factors, total_bias};
use super::identify::noise_of_phases;
use super::point::{AllanPoint, noise_by_slope};
use super::{AllanSums, Estimator, NoiseType, Phases, SquareSum, TauGrid, equivalent_degrees_of_freedom};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A deviation curve of one channel. All lists have one entry per averaging time; times without a term are left out.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AllanCurve {
    /// Unit of the deviation: that of the channel.
    pub unit: String,
    /// Averaging times τ in s, ascending.
    pub tau_s: Vec<f64>,
    /// Deviations.
    pub deviation: Vec<f64>,
    /// Lower ends of the 68.3 % intervals.
    pub ci68_low: Vec<f64>,
    /// Upper ends of the 68.3 % intervals.
    pub ci68_high: Vec<f64>,
    /// Equivalent degrees of freedom.
    pub edf: Vec<f64>,
    /// Numbers of differences averaged.
    pub n: Vec<u64>,
    /// The dominant noise, from which `edf` and the interval follow.
    #[serde(default)]
    pub noise: Vec<NoiseType>,
    /// From this averaging time on, in s, differences are taken at every sixteenth of the averaging time instead of at
    /// every sample; absent if all averaging times have full overlap. For white noise this increases the uncertainty of
    /// a variance by 0.25 %.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stride_from_s: Option<f64>,
}

impl AllanCurve {
    /// Returns the curve of overlapping sums. The kind of noise, on which the intervals depend, follows from the local
    /// slope. If it is angle noise, white or flicker, the intervals are those of flicker.
    pub fn from_sums(sums: &AllanSums, rate_hz: f64, unit: &str) -> Self {
        Self::from_points(&sums.points(), rate_hz, unit)
    }

    /// Returns the curve of overlapping points at `rate_hz`.
    pub fn from_points(points: &[AllanPoint], rate_hz: f64, unit: &str) -> Self {
        let mut curve = Self { unit: unit.to_owned(), ..Self::default() };
        for (point, noise) in points.iter().zip(noise_by_slope(points)) {
            // The slope cannot separate white from flicker angle noise; the wider interval holds for both.
            let edf = match noise {
                NoiseType::WhiteAngle => point.edf(noise).min(point.edf(NoiseType::FlickerAngle)),
                _ => point.edf(noise),
            };
            curve.push(point.m, rate_hz, point.variance, edf, point.taken(), noise, 1.0);
        }
        curve.stride_from_s = points.iter().find(|point| point.stride > 1).map(|point| point.m as f64 / rate_hz);
        curve
    }

    /// Returns the curve of any estimator over whole segments in memory.
    ///
    /// Intervals are those of the estimated quantity. For a total deviation that is the Allan deviation, from which the
    /// expectation departs at long averaging times; `deviation` follows the definition, without a correction.
    pub fn from_phases(segments: &[Phases], estimator: Estimator, grid: &TauGrid, rate_hz: f64, unit: &str) -> Self {
        let sums: Vec<(usize, SquareSum, ByLength)> = grid
            .factors()
            .iter()
            .map(|m| {
                let (mut whole, mut by_length) = (SquareSum::default(), ByLength::new());
                for phases in segments {
                    let own = phases.square_sum(estimator, *m);
                    by_length.entry(phases.len() as u64).or_insert((own.terms, 0)).1 += 1;
                    whole = whole.plus(own);
                }
                (*m, whole, by_length)
            })
            .filter(|(_, sum, _)| sum.terms > 0)
            .collect();
        let factors: Vec<usize> = sums.iter().map(|(m, ..)| *m).collect();
        let mut curve = Self { unit: unit.to_owned(), ..Self::default() };
        for ((m, sum, by_length), noise) in sums.iter().zip(noise_of_phases(segments, &factors)) {
            let lengths = || segments.iter().map(|phases| phases.len() as u64);
            let degrees =
                pooled_degrees(by_length, |phases| equivalent_degrees_of_freedom(estimator, noise, *m, phases));
            let bias = if estimator == Estimator::Totdev { total_bias(noise, *m, lengths()) } else { 1.0 };
            curve.push(*m, rate_hz, sum.sum / sum.terms as f64, degrees, sum.terms, noise, bias);
        }
        curve
    }

    /// Adds a point. `bias` is the expectation of the variance over the estimated quantity.
    #[expect(clippy::too_many_arguments, reason = "one of each column")]
    fn push(&mut self, m: usize, rate_hz: f64, variance: f64, edf: f64, terms: u64, noise: NoiseType, bias: f64) {
        let Some(factors) = confidence_factors(edf, CONFIDENCE_68) else { return };
        let (deviation, unbiased) = (variance.sqrt(), (variance / bias).sqrt());
        self.tau_s.push(m as f64 / rate_hz);
        self.deviation.push(deviation);
        self.ci68_low.push(unbiased * factors.low);
        self.ci68_high.push(unbiased * factors.high);
        self.edf.push(edf);
        self.n.push(terms);
        self.noise.push(noise);
    }

    /// Returns the smallest deviation with at least `least_edf` degrees of freedom, and its averaging time.
    ///
    /// A deviation that first rises and then falls belongs to a filter, or to a process that looks like one. The noise
    /// that the filter passes at short averaging times is not a lowest point, and the search begins where the curve
    /// begins to fall.
    pub fn minimum(&self, least_edf: f64) -> Option<(f64, f64)> {
        let rows = self.tau_s.iter().zip(&self.deviation).zip(&self.edf);
        let rows = rows.map(|((tau_s, deviation), edf)| (*tau_s, *deviation, *edf));
        let rows: Vec<(f64, f64, f64)> = rows.filter(|row| row.2 >= least_edf).collect();
        let from = first_fall(rows.iter().map(|row| (row.1, row.2)));
        rows.iter().skip(from).map(|row| (row.0, row.1)).min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// Returns the place from which on the curve first falls beyond chance; 0 if it never does. `rows` are deviations with
/// their degrees of freedom.
pub(crate) fn first_fall(rows: impl Iterator<Item = (f64, f64)>) -> usize {
    /// Standard errors of a logarithm: 1/√(2 edf) each.
    const BEYOND: f64 = 3.0;
    let mut top: Option<(usize, f64, f64)> = None;
    for (place, (deviation, edf)) in rows.enumerate() {
        match top {
            Some((_, most, _)) if deviation >= most => top = Some((place, deviation, edf)),
            None => top = Some((place, deviation, edf)),
            Some((at, most, own)) if (most / deviation).ln() > BEYOND * (0.5 / edf + 0.5 / own).sqrt() => return at,
            Some(_) => {}
        }
    }
    0
}

/// By number of phases in a segment: the terms of one segment, and the number of segments.
type ByLength = BTreeMap<u64, (u64, u64)>;

/// Returns the degrees of freedom of a mean over all terms of independent segments: (Σ n)²/Σ (n²/edf).
fn pooled_degrees(by_length: &ByLength, edf: impl Fn(u64) -> f64) -> f64 {
    let (mut terms, mut variance) = (0.0, 0.0);
    for (phases, (own, count)) in by_length.iter().filter(|(_, (own, _))| *own > 0) {
        let (own, count) = (*own as f64, *count as f64);
        terms += count * own;
        variance += count * own * own / edf(*phases).max(1.0);
    }
    if variance > 0.0 { terms * terms / variance } else { 0.0 }
}

impl AllanSums {
    /// Returns the points of the curve, without factors that have no term.
    pub fn points(&self) -> Vec<AllanPoint> {
        (0..self.grid().factors().len())
            .filter_map(|index| {
                let m = self.grid().factors()[index];
                let (segments, stride) = (self.segments()[index], self.grid().stride(m));
                let terms = AllanPoint::spanned(self.terms()[index], segments, stride);
                Some(AllanPoint { m, variance: self.variance(index)?, terms, segments, stride })
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allan::{AllanReport, FixedPoint, Overlapping};
    use imu_core::sample::Channel;

    fn samples() -> Vec<f64> {
        let mut state = 1u64;
        (0..5000)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            })
            .collect()
    }

    #[test]
    fn sums_and_phases_draw_the_same_curve() {
        let grid = TauGrid::log(5000).unwrap();
        let mut estimator = Overlapping::new(FixedPoint::for_range(0, 1).unwrap(), grid.clone());
        estimator.push(&samples());
        let exact = AllanCurve::from_sums(estimator.sums(), 40.0, "rad/s");
        let phases = Phases::integrate(&samples()).unwrap();
        let plain = AllanCurve::from_phases(&[phases], Estimator::Oadev, &grid, 40.0, "rad/s");
        assert_eq!((&exact.tau_s, &exact.n), (&plain.tau_s, &plain.n));
        for index in 0..exact.tau_s.len() {
            assert!((exact.deviation[index] / plain.deviation[index] - 1.0).abs() < 1e-10);
            assert!((exact.edf[index] / plain.edf[index] - 1.0).abs() < 1e-9);
            assert!(exact.ci68_low[index] < exact.deviation[index] && exact.deviation[index] < exact.ci68_high[index]);
        }
        assert_eq!(exact.tau_s[0], 0.025);
        assert!(exact.minimum(5.0).is_some_and(|(tau_s, _)| tau_s > 1.0));
    }

    #[test]
    fn a_curve_reports_where_its_stride_begins() {
        let curve = |grid: TauGrid| {
            let mut estimator = Overlapping::new(FixedPoint::for_range(0, 1).unwrap(), grid);
            estimator.push(&samples());
            AllanCurve::from_sums(estimator.sums(), 40.0, "rad/s")
        };
        let report = |curve| AllanReport::new(Estimator::Oadev, 40.0, true, [(Channel::GyroX, curve)]);
        let full = curve(TauGrid::custom([1, 64, 800]).unwrap());
        assert_eq!((full.stride_from_s, report(full.clone()).stride_warning()), (None, None));
        let strided = curve(TauGrid::with_full_overlap([1, 64, 800], 7).unwrap());
        assert_eq!((strided.stride_from_s, strided.n[2]), (Some(20.0), (5001 - 1600usize).div_ceil(50) as u64));
        assert!((strided.deviation[2] / full.deviation[2] - 1.0).abs() < 0.02);
        assert!((strided.edf[2] / full.edf[2] - 1.0).abs() < 0.02);
        let warning = report(strided).stride_warning().unwrap();
        assert!(warning.starts_with("from 20 s on"), "{warning}");
    }

    #[test]
    fn constant_data_gives_a_curve_of_zeros_without_nan() {
        let grid = TauGrid::octave(1000).unwrap();
        let mut estimator = Overlapping::new(FixedPoint::for_channel(Channel::AccelZ), grid);
        estimator.push(&[-9.80665; 1000]);
        let curve = AllanCurve::from_sums(estimator.sums(), 40.0, "m/s²");
        assert!(curve.deviation.iter().chain(&curve.ci68_high).all(|value| *value == 0.0));
        assert!(curve.edf.iter().all(|edf| edf.is_finite()));
    }
}
