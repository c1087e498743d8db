//! Time: the reference as the triad feels it, delayed by a latency, a clock's offset and a clock's rate.
//!
//! A reference may come from a separate clock. One triad alone cannot distinguish a latency from an offset of that
//! clock: both make the triad late. Two triads can, if their delays differ ([`crate::motion::lateness`]).

use imu_model::effects::triad::{Axes, DelayLine};
use imu_model::simulator::Motion;
use realfft::RealFftPlanner;
use realfft::num_complex::Complex;

/// The relation of the reference's clock to the sensor's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clock {
    /// The sensor's own clock.
    Shared,
    /// A separate clock. It may be off by a constant, up to a quarter of the record, and run faster or slower. No latency of
    /// this triad can be determined then.
    Separate,
}

/// Returns returns, for each sample, the motion `delay` samples ago; for a negative delay, the future motion. Between
/// samples the motion follows the simulator's cubic ([`DelayLine`]). Before its start it keeps its first value, after
/// its end its last one.
pub(super) fn delayed(motions: &[Motion], delay: impl Fn(usize) -> f64) -> Vec<Motion> {
    let last = motions.len().saturating_sub(1);
    let at = |index: usize| {
        let samples = delay(index);
        let (skip, weights) = DelayLine::nodes(samples.abs());
        let mut motion = Motion { temperature_c: motions[index].temperature_c, ..Motion::default() };
        for (node, weight) in weights.into_iter().enumerate() {
            let back = skip + node;
            let of = if samples >= 0.0 { index.saturating_sub(back) } else { (index + back).min(last) };
            let add = |sum: &mut Axes, value: Axes| sum.iter_mut().zip(value).for_each(|(sum, x)| *sum += weight * x);
            add(&mut motion.gyro_rad_s, motions[of].gyro_rad_s);
            add(&mut motion.accel_m_s2, motions[of].accel_m_s2);
        }
        motion
    };
    (0..motions.len()).map(at).collect()
}

/// Returns by how many whole samples, up to `most`, the samples are later than the input. This is the lag of the
/// largest cross-correlation of their differences, which have no bias and little slow noise. `weights` has one entry
/// per axis.
pub(super) fn coarse(samples: [&[f64]; 3], input: &[Axes], weights: Axes, most: usize) -> f64 {
    let n = input.len();
    let most = most.min(n / 4);
    if n < 8 || most == 0 {
        return 0.0;
    }
    // Long enough that no lag up to `most` wraps round.
    let length = (n + most).next_power_of_two();
    let step = |of: &dyn Fn(usize) -> f64| (1..n).map(|index| of(index) - of(index - 1)).collect::<Vec<f64>>();
    let pairs = (0..3).map(|axis| {
        let (shown, felt) = (step(&|index| samples[axis][index]), step(&|index| input[index][axis]));
        (shown, felt, move |product: Complex<f64>| product * weights[axis])
    });
    latest(length, pairs, -(most as i64)..=most as i64) as f64
}

/// Returns the lag, samples, at which the sum of the cross-correlations of pairs of columns is largest: by how much the first
/// columns are later than the second ones. The columns are padded to a length, a power of 2. Each pair has a function that
/// weighs a product of coefficients.
pub(crate) fn latest<W: Fn(Complex<f64>) -> Complex<f64>>(
    length: usize,
    pairs: impl Iterator<Item = (Vec<f64>, Vec<f64>, W)>,
    lags: impl Iterator<Item = i64>,
) -> i64 {
    let mut planner = RealFftPlanner::<f64>::new();
    let (forward, backward) = (planner.plan_fft_forward(length), planner.plan_fft_inverse(length));
    let spectrum = |column: &[f64]| {
        let mut padded = forward.make_input_vec();
        padded[..column.len()].copy_from_slice(column);
        let mut spectrum = forward.make_output_vec();
        // This fails only for buffers of a wrong length; these are the plan's own.
        let _ = forward.process(&mut padded, &mut spectrum);
        spectrum
    };
    let mut sum = forward.make_output_vec();
    for (shown, felt, weigh) in pairs {
        for (sum, (shown, felt)) in sum.iter_mut().zip(spectrum(&shown).iter().zip(&spectrum(&felt))) {
            *sum += weigh(shown * felt.conj());
        }
    }
    // The ends are real except for rounding.
    sum[0].im = 0.0;
    sum[length / 2].im = 0.0;
    let mut correlation = backward.make_output_vec();
    let _ = backward.process(&mut sum, &mut correlation);
    let at = |lag: &i64| correlation[lag.rem_euclid(length as i64) as usize];
    lags.max_by(|one, other| at(one).total_cmp(&at(other))).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wavy(index: f64) -> Motion {
        let rate = |axis: f64| (0.05 * index + axis).sin() + (0.013 * index * (axis + 1.0)).cos();
        Motion { gyro_rad_s: [rate(0.0), rate(1.0), rate(2.0)], ..Motion::default() }
    }

    #[test]
    fn a_delay_is_the_simulators_and_a_negative_one_its_mirror() {
        let motions: Vec<Motion> = (0..200).map(|index| wavy(f64::from(index))).collect();
        for samples in [0.0, 0.4, 1.0, 3.7] {
            let mut line = DelayLine::new(samples);
            let found = delayed(&motions, |_| samples);
            let early = delayed(&motions, |_| -samples);
            for (index, motion) in motions.iter().enumerate() {
                assert_eq!(found[index].gyro_rad_s, line.next(motion.gyro_rad_s));
                if index < 190 {
                    let expected = wavy(index as f64 + samples).gyro_rad_s[0];
                    assert!((early[index].gyro_rad_s[0] - expected).abs() < 1e-4);
                }
            }
        }
    }

    #[test]
    fn whole_lags_of_either_sign_are_found() {
        let input: Vec<Axes> = (0..501).map(|index| wavy(f64::from(index)).gyro_rad_s).collect();
        for lag in [-20_i32, -1, 0, 3, 40] {
            let shown: Vec<Axes> = (0..501).map(|index| wavy(f64::from(index - lag)).gyro_rad_s).collect();
            let columns: [Vec<f64>; 3] = std::array::from_fn(|axis| shown.iter().map(|axes| axes[axis]).collect());
            let found = coarse(columns.each_ref().map(Vec::as_slice), &input, [1.0; 3], 60);
            assert!((found - f64::from(lag)).abs() <= 1.0, "{lag}: {found}");
        }
    }
}
