//! The transform: DST-I of a stretch's differences by one real FFT of the stretch's own length.

use realfft::num_complex::Complex;
use realfft::{RealFftPlanner, RealToComplex};
use std::f64::consts::PI;
use std::sync::Arc;

/// Number of planned lengths after which the planner is dropped.
const PLANS: usize = 32;

/// The transform of one length at a time, with its tables and work space: about 45 bytes per sample, shared by all channels.
#[derive(Default)]
pub struct Transform {
    planner: Option<RealFftPlanner<f64>>,
    planned: usize,
    plan: Option<Plan>,
}

struct Plan {
    length: usize,
    /// sin(πj/2n), for j from 0 to n.
    sines: Vec<f64>,
    fft: Arc<dyn RealToComplex<f64>>,
    input: Vec<f64>,
    output: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
}

impl std::fmt::Debug for Transform {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Transform").field("length", &self.plan.as_ref().map(|plan| plan.length)).finish()
    }
}

impl Transform {
    /// Creates a transform without plans.
    pub fn new() -> Self {
        Self::default()
    }

    /// Computes the DST-I of the differences of `samples`: z_k = √(2/n) Σ d_j sin(πjk/n) with d_j = y_j − y_{j−1} and n
    /// samples. Calls `each` for k = 1 … n−1 in this order with (k, z_k, sin²(πk/2n), √(2/n) cot(πk/2n) for odd k and 0
    /// for even).
    ///
    /// The last value is the transform of a constant 1. `samples.len()` is even and at least 2; for other lengths
    /// `each` is not called.
    ///
    /// # Source
    /// Press et al., Numerical Recipes (2007), section 12.4.1, for the sine transform by a real FFT of length n.
    ///
    /// # Validation
    /// `the_transform_is_that_of_its_definition`.
    pub fn differences(&mut self, samples: &[f64], mut each: impl FnMut(usize, f64, f64, f64)) {
        let n = samples.len();
        if n < 2 || !n.is_multiple_of(2) {
            return;
        }
        let Some(plan) = self.plan(n) else { return };
        let difference = |j: usize| samples[j] - samples[j - 1];
        plan.input[0] = 0.0;
        for j in 1..n {
            let (rising, falling) = (difference(j), difference(n - j));
            let sine = 2.0 * plan.sines[j] * plan.sines[n - j];
            plan.input[j] = sine * (rising + falling) + 0.5 * (rising - falling);
        }
        if plan.fft.process_with_scratch(&mut plan.input, &mut plan.output, &mut plan.scratch).is_err() {
            // Fails only for buffers of a wrong length; these are the plan's own.
            return;
        }
        let scale = (2.0 / n as f64).sqrt();
        let mut odd = 0.5 * plan.output[0].re;
        for half in 0..n / 2 {
            if half > 0 {
                let sine = plan.sines[2 * half];
                each(2 * half, -plan.output[half].im * scale, sine * sine, 0.0);
                odd += plan.output[half].re;
            }
            let k = 2 * half + 1;
            let (sine, cosine) = (plan.sines[k], plan.sines[n - k]);
            each(k, odd * scale, sine * sine, scale * cosine / sine);
        }
    }

    fn plan(&mut self, length: usize) -> Option<&mut Plan> {
        if self.plan.as_ref().is_none_or(|plan| plan.length != length) {
            self.plan = None;
            if self.planned >= PLANS {
                (self.planner, self.planned) = (None, 0);
            }
            self.planned += 1;
            let fft = self.planner.get_or_insert_with(RealFftPlanner::new).plan_fft_forward(length);
            let step = PI / (2.0 * length as f64);
            self.plan = Some(Plan {
                length,
                sines: (0..=length).map(|j| (j as f64 * step).sin()).collect(),
                input: fft.make_input_vec(),
                output: fft.make_output_vec(),
                scratch: fft.make_scratch_vec(),
                fft,
            });
        }
        self.plan.as_mut()
    }
}

/// Returns the largest even number up to `samples` whose prime factors are at most 7; 0 below 2. Such lengths transform
/// fast, and from ten thousand on they are less than 2 % apart.
pub(super) fn efficient_length(samples: usize) -> usize {
    let mut best = 0;
    let limit = samples / 2;
    let mut sevens = 1;
    while sevens <= limit {
        let mut fives = sevens;
        while fives <= limit {
            let mut threes = fives;
            while threes <= limit {
                best = best.max(threes << (limit / threes).ilog2());
                threes *= 3;
            }
            fives *= 5;
        }
        sevens *= 7;
    }
    2 * best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_transform_is_that_of_its_definition() {
        let mut transform = Transform::new();
        for n in [2usize, 4, 6, 10, 14, 60, 210, 60] {
            let samples: Vec<f64> = (0..n).map(|i| ((i * i * 7 + 3 * i) % 23) as f64 * 0.1 + 9.8).collect();
            let mut seen = vec![false; n];
            let size = (2.0 / n as f64).sqrt();
            transform.differences(&samples, |k, z, sine_squared, constant| {
                let basis = |j: usize| (PI * (j * k) as f64 / n as f64).sin();
                let expected: f64 = (1..n).map(|j| (samples[j] - samples[j - 1]) * basis(j)).sum::<f64>() * size;
                assert!((z - expected).abs() < 1e-12, "n {n} k {k}: {z} {expected}");
                let of_one: f64 = (1..n).map(basis).sum::<f64>() * size;
                assert!((constant - of_one).abs() < 1e-11, "n {n} k {k}: {constant} {of_one}");
                assert!((sine_squared - (PI * k as f64 / (2 * n) as f64).sin().powi(2)).abs() < 1e-14);
                assert!(!std::mem::replace(&mut seen[k], true));
            });
            assert_eq!(seen.iter().filter(|seen| **seen).count(), n - 1);
        }
        transform.differences(&[1.0, 2.0, 3.0], |_, _, _, _| panic!("an odd length"));
    }

    #[test]
    fn efficient_lengths_are_even_seven_smooth_and_dense() {
        assert_eq!(efficient_length(720_000), 720_000);
        assert_eq!([0, 1, 2, 3, 11, 13, 23].map(efficient_length), [0, 0, 2, 2, 10, 12, 20]);
        for samples in [59_999, 65_537, 719_989, 1_048_575] {
            let length = efficient_length(samples);
            let mut rest = length;
            for prime in [2, 3, 5, 7] {
                while rest.is_multiple_of(prime) {
                    rest /= prime;
                }
            }
            assert!(rest == 1 && length.is_multiple_of(2) && length <= samples);
            assert!(length as f64 > 0.98 * samples as f64, "{samples}: {length}");
        }
    }
}
