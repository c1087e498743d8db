//! The covariance of Allan variances at different averaging times: they are computed from the same data, so that a
//! hundred of them are not a hundred independent measurements.

use super::term::{Term, response};
use crate::allan::AllanPoint;
use crate::whittle::Filter;
use nalgebra::DMatrix;
use std::f64::consts::LN_2;

/// Frequencies per octave. They are spread irregularly, so that the lobes of long averaging times average out.
const PER_OCTAVE: usize = 192;
/// The fraction of the golden ratio: its multiples are as evenly irregular as possible.
const GOLDEN: f64 = 0.618_033_988_749_894_9;
/// The terms that are noise.
const NOISES: [Term; 4] = [Term::N, Term::B, Term::K, Term::Q];

/// The covariance of the variances at given points as a function of the noise: a quadratic form in the squared coefficients
/// whose matrices are integrated once.
///
/// C_ij = 2/√(T_i T_j) ∫ S² G_i G_j df with S the spectrum, G the response and T = terms · dt.
///
/// # Source
/// Second moments of a quadratic form of a Gaussian process; Percival & Walden, Wavelet Methods for Time Series Analysis
/// (2000), section 8.3, for wavelet variances, of which the Allan variance is twice the Haar one.
///
/// # Validation
/// `the_diagonal_agrees_with_greenhall`: equivalent degrees of freedom 2V²/C within 4 % of Greenhall & Riley's where a
/// hundred averaging times fit and m is at least 64 (below, theirs describe phase averaged over the sampling interval).
#[derive(Debug, Clone)]
pub(super) struct CovarianceForm {
    /// One matrix per pair of [`NOISES`] (first ≤ second), in the order of [`pairs`].
    integrals: Vec<DMatrix<f64>>,
    /// For N, B and K: the covariance of the mean second differences, times the ramp's own per R².
    ramp: [DMatrix<f64>; 3],
    points: usize,
}

fn pairs() -> impl Iterator<Item = (usize, usize)> {
    (0..NOISES.len()).flat_map(|second| (0..=second).map(move |first| (first, second)))
}

impl CovarianceForm {
    /// Integrates for `points`, sampled every `dt_s` behind an optional filter.
    pub(super) fn new(points: &[AllanPoint], dt_s: f64, filter: Option<&Filter>) -> Self {
        let count = points.len();
        let mut integrals = vec![DMatrix::<f64>::zeros(count, count); pairs().count()];
        let longest = points.iter().map(|point| point.m).max().unwrap_or(1) as f64;
        // Starts far below the first lobe of the longest averaging time, where S²GG is constant for a random walk.
        let octaves = (0.5 * longest / 1e-3).log2().ceil() as usize;
        let lowest = 0.5 * 0.5f64.powi(octaves as i32);
        let scale: Vec<f64> = points.iter().map(|point| (point.terms.max(1) as f64 * dt_s).powf(-0.5)).collect();
        let mut responses = vec![0.0; count];
        for octave in 0..octaves {
            for step in 0..PER_OCTAVE {
                let jitter = (step as f64 * GOLDEN + octave as f64 * 0.37).fract();
                let u = lowest * 2f64.powf(octave as f64 + (step as f64 + jitter) / PER_OCTAVE as f64);
                for ((response_at, point), scale) in responses.iter_mut().zip(points).zip(&scale) {
                    *response_at = response(point.m, u) * scale;
                }
                let gain = |term: Term| filter.map_or(1.0, |filter| filter.gain(term, u));
                let spectra = NOISES.map(|term| gain(term) * term.spectrum(u, dt_s));
                // A factor 2 for the negative frequencies, and 2 from the formula.
                let weight = 4.0 * u * LN_2 / PER_OCTAVE as f64 / dt_s;
                for (integral, (first, second)) in integrals.iter_mut().zip(pairs()) {
                    let twice = if first == second { 1.0 } else { 2.0 };
                    let density = twice * weight * spectra[first] * spectra[second];
                    for (column, weighted) in responses.iter().enumerate() {
                        let weighted = density * weighted;
                        for (row, response) in responses[..=column].iter().enumerate() {
                            integral[(row, column)] += weighted * response;
                        }
                    }
                }
            }
        }
        for integral in &mut integrals {
            integral.fill_lower_triangle_with_upper_triangle();
        }
        Self { integrals, ramp: ramp(points, dt_s), points: count }
    }

    /// Returns the covariance matrix, shape points × points, for noise of these squared coefficients.
    pub(super) fn at(&self, squares: &[(Term, f64)]) -> DMatrix<f64> {
        let square = |index: usize| -> f64 {
            squares.iter().filter(|(term, _)| *term == NOISES[index]).map(|(_, square)| square).sum()
        };
        let mut matrix = DMatrix::zeros(self.points, self.points);
        for (integral, (first, second)) in self.integrals.iter().zip(pairs()) {
            let weight = square(first) * square(second);
            if weight > 0.0 {
                matrix += integral * weight;
            }
        }
        let slope: f64 = squares.iter().filter(|(term, _)| *term == Term::R).map(|(_, square)| square).sum();
        if slope > 0.0 {
            for (index, ramp) in self.ramp.iter().enumerate() {
                matrix += ramp * (slope * square(index));
            }
        }
        matrix
    }
}

/// A ramp is deterministic, but its product with the noise is not: with second differences Rτ + e, the variance ½⟨(Rτ +
/// e)²⟩ varies by Rτ⟨e⟩ in addition to ½⟨e²⟩. ⟨e⟩ is the record's end less its beginning, both weighted by triangles of
/// two averaging times, over the record's length T.
///
/// White noise: 2N² ∫ΛᵢΛⱼ/T². Random walk: K² τᵢτⱼ/T. Flicker, to leading order: (2/π) B² τᵢτⱼ (ln(T/τ) + 1)/T².
fn ramp(points: &[AllanPoint], dt_s: f64) -> [DMatrix<f64>; 3] {
    let count = points.len();
    let tau_s = |index: usize| points[index].m as f64 * dt_s;
    let record_s = |index: usize| points[index].terms.max(1) as f64 * dt_s + 2.0 * tau_s(index);
    let entry = |of: &dyn Fn(f64, f64, f64) -> f64| {
        DMatrix::from_fn(count, count, |row, column| {
            let (short, long) = (tau_s(row.min(column)), tau_s(row.max(column)));
            short * long * of(short, long, record_s(row.max(column)))
        })
    };
    [
        entry(&|short, long, record| 2.0 * triangles(short, long) / (record * record)),
        entry(&|short, long, record| {
            std::f64::consts::FRAC_2_PI * short * long * ((record / long).ln() + 1.0) / (record * record)
        }),
        entry(&|short, long, record| short * long / record),
    ]
}

/// Returns ∫ of the product of two triangles of height 1 that begin at 0 and reach to twice `short` and `long`.
fn triangles(short: f64, long: f64) -> f64 {
    const PANELS: u32 = 256;
    let triangle = |x: f64, width: f64| (x / width).min(2.0 - x / width).max(0.0);
    let step = 2.0 * short / f64::from(PANELS);
    (0..PANELS)
        .map(|panel| (f64::from(panel) + 0.5) * step)
        .map(|x| triangle(x, short) * triangle(x, long) * step)
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allan::NoiseType;

    fn points() -> Vec<AllanPoint> {
        (0..14)
            .map(|k| 1usize << k)
            .map(|m| AllanPoint { m, variance: 1.0, terms: 720_001 - 2 * m as u64, segments: 1, stride: 1 })
            .collect()
    }

    #[test]
    fn the_diagonal_agrees_with_greenhall() {
        let dt_s = 0.025;
        let points: Vec<AllanPoint> = points().into_iter().filter(|point| (64..=7_200).contains(&point.m)).collect();
        let form = CovarianceForm::new(&points, dt_s, None);
        for (term, noise) in
            [(Term::N, NoiseType::WhiteRate), (Term::B, NoiseType::FlickerRate), (Term::K, NoiseType::RandomWalkRate)]
        {
            let matrix = form.at(&[(term, 1.0)]);
            for (index, point) in points.iter().enumerate() {
                let variance = term.allan_variance(point.m, dt_s);
                let edf = 2.0 * variance * variance / matrix[(index, index)];
                let ratio = edf / point.edf(noise);
                assert!((ratio - 1.0).abs() < 0.04, "{term:?} m = {}: {edf}, ratio {ratio}", point.m);
            }
        }
    }

    #[test]
    fn white_noise_at_one_sample_has_two_thirds_of_its_terms_as_degrees() {
        // Neighbouring differences have a correlation of −1/2: 2V²/C = n / (1 + 2/4).
        let points = [AllanPoint { m: 1, variance: 1.0, terms: 720_000, segments: 1, stride: 1 }];
        let matrix = CovarianceForm::new(&points, 0.025, None).at(&[(Term::N, 1.0)]);
        let edf = 2.0 * Term::N.allan_variance(1, 0.025).powi(2) / matrix[(0, 0)];
        assert!((edf / 480_000.0 - 1.0).abs() < 1e-3, "{edf}");
    }

    #[test]
    fn a_ramps_product_with_white_noise_varies_as_its_ends_do() {
        // Λ² integrates to two thirds of τ at each end.
        assert!((triangles(3.0, 3.0) - 2.0).abs() < 1e-3);
        assert!((triangles(1.0, 4.0) - 0.25).abs() < 1e-3);
        let point = AllanPoint { m: 4000, variance: 1.0, terms: 92_000, segments: 1, stride: 1 };
        let form = CovarianceForm::new(&[point], 0.025, None);
        let (noise, slope) = (1e-6, 1e-10);
        let added = form.at(&[(Term::N, noise), (Term::R, slope)])[(0, 0)] - form.at(&[(Term::N, noise)])[(0, 0)];
        let expected = slope * 100f64.powi(2) * noise * (4.0 / 3.0) * 100.0 / 2500f64.powi(2);
        assert!((added / expected - 1.0).abs() < 1e-3, "{added} {expected}");
    }

    #[test]
    fn adjacent_octaves_vary_together_as_the_literature_has_it() {
        let matrix = CovarianceForm::new(&points(), 0.025, None).at(&[(Term::N, 1.0), (Term::K, 1e-8)]);
        for index in 4..10 {
            let variance = matrix[(index, index)] * matrix[(index + 1, index + 1)];
            let correlation = matrix[(index, index + 1)] / variance.sqrt();
            assert!((0.4..0.9).contains(&correlation), "{correlation}");
        }
        assert!(matrix.cholesky().is_some(), "positive definite");
    }
}
