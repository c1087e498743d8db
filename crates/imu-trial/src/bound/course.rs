//! Courses of the level in coloured noise: the matched filter.

use realfft::RealFftPlanner;
use std::f64::consts::PI;

/// Returns the squares of a course's orthonormal DCT-II coefficients 1 to n − 1, in the square of its unit. The mean,
/// which is not compared, is left out.
///
/// # Source
/// J. Makhoul, IEEE Trans. ASSP 28 (1980) 27: the DCT-II of n samples is the Fourier transform of the 2n samples that are
/// these and their mirror image, with a shift of half a sample.
pub(super) fn powers(course: &[f64]) -> Vec<f64> {
    let count = course.len();
    if count < 2 {
        return Vec::new();
    }
    let mut mirrored: Vec<f64> = course.iter().chain(course.iter().rev()).copied().collect();
    let transform = RealFftPlanner::<f64>::new().plan_fft_forward(2 * count);
    let mut spectrum = transform.make_output_vec();
    // The lengths are the plan's own.
    let _ = transform.process(&mut mirrored, &mut spectrum);
    // The transform of a mirrored course is a phase times a real number; its square is that of the magnitude.
    (1..count).map(|k| spectrum[k].norm_sqr() / (2.0 * count as f64)).collect()
}

/// Returns the nats that a course with these [`powers`] is worth in noise of this density, both in the same unit: half
/// the square of a matched filter's signal-to-noise ratio, ½ Σ X²(f)/S(f). `density_at` takes cycles per sample.
///
/// # Source
/// H. L. Van Trees, *Detection, Estimation, and Modulation Theory* I (1968), section 4.3: known signals in coloured noise.
pub(super) fn nats(powers: &[f64], density_at: impl Fn(f64) -> f64) -> f64 {
    let step = 0.5 / (powers.len() + 1) as f64;
    0.5 * powers.iter().zip(1..).map(|(power, k)| power / density_at(step * f64::from(k))).sum::<f64>()
}

/// Adds a step of `size` at a part of the record, which rises within a sample.
pub(super) fn step(into: &mut [f64], at: f64, size: f64) {
    let from = (at.max(0.0) as usize).min(into.len());
    into[from..].iter_mut().for_each(|value| *value += size);
}

/// Returns the density of white noise of variance 1 per sample with flicker of level `b` and a walk of steps `k`, both
/// relative to the white noise's standard deviation.
///
/// # Source
/// B²/(2πf), (K/2πf)², per sample; a walk's 1/(4 sin² πf) is exact in the DCT-II.
pub(super) fn ground(b: f64, k: f64) -> impl Fn(f64) -> f64 {
    move |cycles: f64| 1.0 + b * b / (2.0 * PI * cycles) + k * k / (4.0 * (PI * cycles).sin().powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(make: impl Fn(usize) -> f64, samples: usize) -> Vec<f64> {
        powers(&(0..samples).map(make).collect::<Vec<_>>())
    }

    #[test]
    fn in_white_noise_a_course_is_worth_half_its_sum_of_squares_about_the_mean() {
        // A ramp over all of s: variance s²/12; a step of s at a quarter: s²·¼·¾.
        let ramp = nats(&of(|i| 0.1 * i as f64 / 6000.0, 6000), |_| 1.0);
        assert!((ramp - 0.5 * 6000.0 * 0.01 / 12.0).abs() < 1e-5, "{ramp}");
        let mut course = vec![0.0; 4000];
        step(&mut course, 1000.0, 0.2);
        let quarter = nats(&powers(&course), |_| 1.0);
        assert!((quarter - 0.5 * 4000.0 * 0.04 * 0.25 * 0.75).abs() < 1e-9, "{quarter}");
        // In twice the density, it is worth half.
        assert!((nats(&powers(&course), |_| 2.0) - 0.5 * quarter).abs() < 1e-9);
    }

    #[test]
    fn in_a_random_walk_a_step_is_one_increment_and_a_ramp_as_much_as_its_mean_increment() {
        // Increments of a walk of steps k are white. A step of s is one increment of s, worth s²/2k² nats; a ramp of s
        // over n samples is n increments of s/n.
        let walk = |cycles: f64| 0.09 * ground(0.0, 1.0)(cycles) - 0.09;
        let mut course = vec![0.0; 3000];
        step(&mut course, 1234.0, 0.6);
        let one = nats(&powers(&course), walk);
        assert!((one / (0.36 / (2.0 * 0.09)) - 1.0).abs() < 1e-6, "{one}");
        let ramp = nats(&of(|i| 30.0 * i as f64 / 3000.0, 3000), walk);
        assert!((ramp / (900.0 / 3000.0 / (2.0 * 0.09)) - 1.0).abs() < 1e-3, "{ramp}");
    }
}
