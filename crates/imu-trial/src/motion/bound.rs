//! The bound: the smallest size of an effect at which a test can find it.
//!
//! For an effect of p numbers β, the information of a record with all other parameters unknown is J = X_gᵀX_g −
//! X_gᵀX_r(X_rᵀX_r)⁺X_rᵀX_g with whitened columns. J is the inverse of the Cramér–Rao bound; r stands for all other
//! effects of the triad and its delay. Twice the nats gained are non-central χ² with p degrees of freedom about
//! ½βᵀJβ·2. The bound is the size at which nine of ten such gains are above a price. Columns are averaged to at most
//! 8192 values, because motions are slow.

use super::course::FINE;
use super::impose::{Imposed, shown};
use super::kind::Kind;
use imu_core::sample::Triad;
use imu_diagnosis::transform::Cosines;
use imu_model::simulator::Motion;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use statrs::distribution::{ChiSquared, ContinuousCDF as _};

/// Maximum number of values to which columns are averaged.
const COARSE: usize = 8192;
/// The part of clean records in which an effect may be named, over the groups of both triads.
const LEVEL: f64 = 0.005;
const GROUPS: f64 = 20.0;
/// The normal distribution's 90 % point.
const NINE_OF_TEN: f64 = 1.281_551_565_545;

/// Returns twice the nats that an effect of p numbers must have on average so that nine of ten exceed their price.
pub fn needed(numbers: usize) -> f64 {
    let p = numbers as f64;
    let price = ChiSquared::new(p).map_or(f64::INFINITY, |of| of.inverse_cdf(1.0 - LEVEL / GROUPS));
    // A non-central χ² has mean p + λ and variance 2(p + 2λ).
    let mut needed = price;
    for _ in 0..50 {
        needed = (price - p + NINE_OF_TEN * (2.0 * (p + 2.0 * needed)).sqrt()).max(1.0);
    }
    needed
}

/// Least information of a number, in parts of what it would be with all others known.
const LEAST: f64 = 1e-9;

/// Returns the information of one effect's numbers, with all other parameters of its triad unknown. `nbk` are the
/// triad's true N, B, K per axis.
pub fn information(
    kind: Kind,
    triad: Triad,
    course: &[Motion],
    rate_hz: f64,
    warmth_c: &[f64],
    nbk: [[f64; 3]; 3],
) -> DMatrix<f64> {
    let samples = course.len() / FINE;
    let each = samples.div_ceil(COARSE).max(1);
    let coarse = samples / each;
    let mut cosines = Cosines::new(coarse);
    let coarse_hz = rate_hz / each as f64;
    let kinds: Vec<Kind> =
        Kind::LIBRARY.iter().copied().filter(|of| of.numbers().is_some() && of.triads().contains(&triad)).collect();
    let kinds: Vec<Kind> = if kinds.contains(&kind) { kinds } else { kinds.into_iter().chain([kind]).collect() };
    let nothing = shown(triad, course, rate_hz, &[], warmth_c);
    let mut columns: Vec<(Kind, Vec<f64>)> = Vec::new();
    for of in kinds {
        for place in 0..of.numbers().unwrap_or(0) {
            let mut numbers = vec![0.0; of.numbers().unwrap_or(0)];
            let step = if of == Kind::Latency { 0.1 / rate_hz } else { 1e-3 };
            numbers[place] = step;
            let moved = shown(triad, course, rate_hz, &[Imposed { kind: of, triad, numbers }], warmth_c);
            let mut column = Vec::with_capacity(3 * coarse);
            for axis in 0..3 {
                let differs = moved[axis].iter().zip(&nothing[axis]).map(|(one, other)| (one - other) / step);
                let differs: Vec<f64> = differs.collect();
                let mut means: Vec<f64> = differs
                    .chunks_exact(each)
                    .take(coarse)
                    .map(|part| part.iter().sum::<f64>() / each as f64)
                    .collect();
                cosines.forward(&mut means);
                let [n, b, k] = nbk[axis];
                for (place, value) in means.iter_mut().enumerate() {
                    *value /= deviation(n, b, k, place, coarse, coarse_hz);
                }
                column.extend(means);
            }
            columns.push((of, column));
        }
    }
    let own: Vec<usize> = (0..columns.len()).filter(|place| columns[*place].0 == kind).collect();
    let rest: Vec<usize> = (0..columns.len()).filter(|place| columns[*place].0 != kind).collect();
    let dot = |one: usize, other: usize| -> f64 {
        columns[one].1.iter().zip(&columns[other].1).map(|(one, other)| one * other).sum()
    };
    let of = |rows: &[usize], others: &[usize]| {
        DMatrix::from_fn(rows.len(), others.len(), |row, column| dot(rows[row], others[column]))
    };
    let (mine, between, others) = (of(&own, &own), of(&rest, &own), of(&rest, &rest));
    let scales = DVector::from_fn(rest.len(), |row, _| 1.0 / others[(row, row)].sqrt().max(1e-300));
    let scaled = DMatrix::from_fn(rest.len(), rest.len(), |r, c| others[(r, c)] * scales[r] * scales[c]);
    let seen = DMatrix::from_fn(rest.len(), own.len(), |r, c| between[(r, c)] * scales[r]);
    let solved =
        scaled.pseudo_inverse(1e-9).map_or_else(|_| DMatrix::zeros(rest.len(), own.len()), |inverse| inverse * &seen);
    let least = LEAST * mine.trace() / own.len().max(1) as f64;
    let mut left = SymmetricEigen::new(mine - seen.transpose() * solved);
    // If the others explain all of it, rounding leaves less than nothing.
    left.eigenvalues.iter_mut().for_each(|value| *value = value.max(least));
    left.recompose()
}

/// Returns the standard deviation of a cosine coefficient of the noise.
fn deviation(n: f64, b: f64, k: f64, place: usize, samples: usize, rate_hz: f64) -> f64 {
    let count = samples as f64;
    if place == 0 {
        // The mean: white noise, flicker down to a thirty-second of the record's own frequency, and a walk that begins
        // at 0.
        return (rate_hz * n * n + 1.13 * count * b * b + k * k * count * count / (3.0 * rate_hz)).sqrt();
    }
    let hz = 0.5 * rate_hz * place as f64 / count;
    let turn = std::f64::consts::TAU * hz;
    (rate_hz * (n * n + b * b / turn + (k / turn).powi(2))).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::Draw;
    use crate::motion::course::{Shape, course};

    #[test]
    fn a_scale_factors_information_is_that_of_white_noise_where_there_is_no_other() {
        let mut draw = Draw::device(5, 0, "course");
        let course = course(Shape { by_hand: false, fastest: 3.0, shaken: 0.0 }, 40.0, 8192, &mut draw);
        let warm = vec![0.0; 8192];
        let n = 1e-4;
        let found = information(Kind::GSensitivity, Triad::Gyro, &course, 40.0, &warm, [[n, 0.0, 0.0]; 3]);
        let whole: f64 =
            course.iter().step_by(FINE).map(|motion| motion.accel_m_s2[1].powi(2)).sum::<f64>() / (40.0 * n * n);
        // The other parameters take their share, but not nearly all.
        assert!(found[(1, 1)] < whole && found[(1, 1)] > 0.02 * whole, "{} of {whole}", found[(1, 1)]);
        assert_eq!(found.nrows(), 9);
        assert!(needed(3) > 19.0 && needed(3) < 45.0 && needed(9) > needed(1), "{}", needed(3));
    }
}
