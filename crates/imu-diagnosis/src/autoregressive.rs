//! Autoregressive: nearly the inverse of the covariance of coloured noise plus white noise whose variance changes with time.

use std::f64::consts::PI;

/// The order of the process.
const ORDER: usize = 8;

/// Solves the equations of the matrix R + V: V is the diagonal of the white noise's variances less half the least one, and R the
/// covariance of the autoregressive process that has the same covariances up to [`ORDER`] as the spectrum plus that half.
///
/// R⁻¹ has [`ORDER`] diagonals on either side of the main one (Siddiqui 1958, Ann. Math. Stat. 29), so that R⁻¹ + V⁻¹ is factored
/// and solved in a time proportional to the length, and (R + V)⁻¹ = V⁻¹ − V⁻¹(R⁻¹ + V⁻¹)⁻¹V⁻¹. Whatever the variances are, the
/// eigenvalues of (R + V)⁻¹ times the true covariance lie between 1 and the least and the largest ratio of the spectrum to that of R,
/// except for a few that the ends cause.
#[derive(Debug, Clone)]
pub(super) struct Autoregressive {
    /// The Cholesky factor of R⁻¹ + V⁻¹ by rows: the entry on the diagonal, then those before it.
    rows: Vec<[f64; ORDER + 1]>,
    /// The diagonal of V.
    variance: Vec<f64>,
}

impl Autoregressive {
    /// Factors the matrix for the power in each coefficient of a cosine transform and the variance of each sample. `None` for a
    /// short record, or if the factorization fails numerically.
    pub(super) fn of(spectrum: &[f64], variance: &[f64]) -> Option<Self> {
        let n = variance.len();
        if n <= 2 * ORDER || spectrum.len() != n {
            return None;
        }
        // A process of a few taps cannot follow a spectrum far below the white noise, so it has a part of that noise, too.
        let always = 0.5 * variance.iter().copied().fold(f64::INFINITY, f64::min);
        let variance: Vec<f64> = variance.iter().map(|v| v - always).collect();
        let (taps, power) = levinson(&covariances(spectrum, always))?;
        // Sums of products of the taps a distance apart, by the number of products: ends have fewer of them.
        let sums = |distance: usize| {
            let mut sum = 0.0;
            (0..=ORDER - distance).map(move |at| {
                sum += taps[at] * taps[at + distance] / power;
                sum
            })
        };
        let sums: Vec<Vec<f64>> = (0..=ORDER).map(|distance| sums(distance).collect()).collect();
        let mut rows: Vec<[f64; ORDER + 1]> = Vec::with_capacity(n);
        for i in 0..n {
            let mut own = [0.0; ORDER + 1];
            for distance in (0..=ORDER.min(i)).rev() {
                let j = i - distance;
                let mut entry = sums[distance][(ORDER - distance).min(n - 1 - i).min(j)];
                if distance == 0 {
                    entry += 1.0 / variance[i];
                }
                let other = if distance == 0 { own } else { rows[j] };
                for before in 1..=(ORDER - distance).min(j) {
                    entry -= own[distance + before] * other[before];
                }
                own[distance] = if distance == 0 { entry.sqrt() } else { entry / other[0] };
            }
            if own[0].is_nan() || own[0] <= 0.0 {
                return None;
            }
            rows.push(own);
        }
        Some(Self { rows, variance })
    }

    /// Returns (R + V)⁻¹ times values.
    pub(super) fn solve(&self, values: &[f64]) -> Vec<f64> {
        let mut x: Vec<f64> = values.iter().zip(&self.variance).map(|(value, v)| value / v).collect();
        let right = x.clone();
        for (i, own) in self.rows.iter().enumerate() {
            let before = (1..=ORDER.min(i)).map(|distance| own[distance] * x[i - distance]);
            x[i] = (x[i] - before.sum::<f64>()) / own[0];
        }
        for (i, own) in self.rows.iter().enumerate().rev() {
            x[i] /= own[0];
            for distance in 1..=ORDER.min(i) {
                x[i - distance] -= own[distance] * x[i];
            }
        }
        x.iter_mut().zip(right).zip(&self.variance).for_each(|((x, right), v)| *x = right - *x / v);
        x
    }
}

/// Returns the covariances at distances up to [`ORDER`] of a spectrum plus white noise.
fn covariances(spectrum: &[f64], white: f64) -> [f64; ORDER + 1] {
    let n = spectrum.len();
    let mut sums = [0.0; ORDER + 1];
    for (k, power) in spectrum.iter().enumerate() {
        // Cosines of multiples follow from one another.
        let cosine = (PI * k as f64 / n as f64).cos();
        let (mut before, mut here) = (cosine, 1.0);
        for sum in &mut sums {
            *sum += power * here;
            (before, here) = (here, 2.0 * cosine * here - before);
        }
    }
    let mut covariances = sums.map(|sum| sum / n as f64);
    covariances[0] += white;
    covariances
}

/// Returns the taps of the filter that predicts a process from its covariances, and the power of its innovations (Levinson and
/// Durbin). `None` if the covariances are no process's.
fn levinson(covariances: &[f64; ORDER + 1]) -> Option<([f64; ORDER + 1], f64)> {
    /// White noise that rounding adds, relative to the process.
    const ROUNDING: f64 = 1e-12;
    let mut taps = [0.0; ORDER + 1];
    taps[0] = 1.0;
    let mut power = covariances[0] * (1.0 + ROUNDING);
    for order in 1..=ORDER {
        let sum: f64 = (0..order).map(|at| taps[at] * covariances[order - at]).sum();
        let reflection = -sum / power;
        let before = taps;
        for at in 1..=order {
            taps[at] += reflection * before[order - at];
        }
        power *= 1.0 - reflection * reflection;
        if power.is_nan() || power <= 0.0 {
            return None;
        }
    }
    Some((taps, power))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    const N: usize = 96;

    fn variances() -> Vec<f64> {
        (0..N).map(|at| if at % 40 < 9 { 30.0 } else { 0.02 + 0.01 * (at % 7) as f64 }).collect()
    }

    #[test]
    fn the_taps_of_a_process_follow_from_its_spectrum() {
        // x_t = 0.8 x_(t−1) + e, of variance 1 / (1 − 0.64) and correlation 0.8 a sample.
        let power = |k: usize| 1.0 / (1.64 - 1.6 * (PI * k as f64 / 50_000.0).cos());
        let covariances = covariances(&(0..50_000).map(power).collect::<Vec<f64>>(), 0.0);
        let (taps, innovations) = levinson(&covariances).unwrap();
        assert!((innovations - 1.0).abs() < 1e-3 && (taps[1] + 0.8).abs() < 1e-3, "{innovations} {taps:?}");
        assert!(taps[2..].iter().all(|tap| tap.abs() < 1e-3), "{taps:?}");
    }

    #[test]
    fn the_factor_solves_the_matrix_of_its_process() {
        let spectrum: Vec<f64> = (0..N).map(|k| 1.0 / (1.64 - 1.6 * (PI * k as f64 / N as f64).cos())).collect();
        let variance = variances();
        let always = 0.5 * 0.02;
        let covariances = covariances(&spectrum, always);
        let (taps, power) = levinson(&covariances).unwrap();
        // The process's covariances beyond its order follow from its taps.
        let mut r = covariances.to_vec();
        r[0] *= 1.0 + 1e-12;
        for at in ORDER + 1..N {
            r.push(-(1..=ORDER).map(|tap| taps[tap] * r[at - tap]).sum::<f64>());
        }
        let predicted = r[0] + (1..=ORDER).map(|tap| taps[tap] * r[tap]).sum::<f64>();
        assert!((predicted / power - 1.0).abs() < 1e-9, "{predicted} {power}");
        let matrix = DMatrix::from_fn(N, N, |i, j| r[i.abs_diff(j)] + if i == j { variance[i] - always } else { 0.0 });
        let wanted: Vec<f64> = (0..N).map(|at| (at as f64 % 7.0 - 3.0) * 0.7).collect();
        let right: Vec<f64> = (0..N).map(|i| (0..N).map(|j| matrix[(i, j)] * wanted[j]).sum()).collect();
        let found = Autoregressive::of(&spectrum, &variance).unwrap().solve(&right);
        for (found, wanted) in found.iter().zip(&wanted) {
            assert!((found - wanted).abs() < 1e-9, "{found} {wanted}");
        }
    }

    #[test]
    fn what_has_no_process_has_no_factor_and_white_noise_alone_is_scaled() {
        let variance = variances();
        assert!(Autoregressive::of(&[1.0; 3], &[1.0; 3]).is_none());
        assert!(Autoregressive::of(&[1.0; 3], &variance).is_none());
        assert!(Autoregressive::of(&[f64::NAN; N], &variance).is_none());
        let even = Autoregressive::of(&[0.0; N], &[2.0; N]).unwrap();
        let values: Vec<f64> = (0..N).map(|at| (at % 5) as f64).collect();
        let found = even.solve(&values);
        assert!(found.iter().zip(&values).all(|(found, value)| (found - 0.5 * value).abs() < 1e-9), "{found:?}");
    }
}
