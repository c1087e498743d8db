//! Phase: removes the phase that filters give to their input.
//!
//! A residual that is whitened by its spectrum alone keeps the filters' phase: a spike behind the filters is spread
//! out, and tails look normal. The filters of the library have minimum phase, which follows from the gain (Oppenheim
//! and Schafer, Discrete-Time Signal Processing, section 12.3, by way of the cepstrum).

use super::plans;

/// The least gain: narrow notches have no relevant phase.
const LEAST: f64 = 1e-12;

/// Removes the phase of filters from values. `gain` is the filters' power gain at each coefficient of a cosine
/// transform of that length.
pub(super) fn undo(values: &mut [f64], gain: &[f64]) {
    let n = values.len();
    if n < 4 || gain.len() != n {
        return;
    }
    let (forward, backward) = (plans::forward(n), plans::backward(n));
    let mut spectrum = forward.make_output_vec();
    // Bin k of n is twice as far as coefficient k of the cosine transform.
    for (k, value) in spectrum.iter_mut().enumerate() {
        let gain = gain[(2 * k).clamp(1, n - 1)];
        *value = (0.5 * gain.max(LEAST).ln()).into();
    }
    let mut cepstrum = backward.make_output_vec();
    if backward.process(&mut spectrum, &mut cepstrum).is_err() {
        return;
    }
    // The part before 0 is folded onto the part after it.
    for (at, value) in cepstrum.iter_mut().enumerate() {
        let weight = match (2 * at).cmp(&n) {
            _ if at == 0 => 1.0,
            std::cmp::Ordering::Less => 2.0,
            std::cmp::Ordering::Equal => 1.0,
            std::cmp::Ordering::Greater => 0.0,
        };
        *value *= weight / n as f64;
    }
    let mut response = forward.make_output_vec();
    let mut own = forward.make_output_vec();
    let mut input = values.to_vec();
    if forward.process(&mut cepstrum, &mut response).is_err() || forward.process(&mut input, &mut own).is_err() {
        return;
    }
    let last = own.len() - 1;
    for (k, (value, response)) in own.iter_mut().zip(&response).enumerate() {
        let (sine, cosine) = response.im.sin_cos();
        let [re, im] = [value.re * cosine + value.im * sine, value.im * cosine - value.re * sine];
        // The first bin and, for an even length, the last one have no counterpart.
        let alone = k == 0 || (k == last && n.is_multiple_of(2));
        (value.re, value.im) = if alone { (value.re, 0.0) } else { (re, im) };
    }
    if backward.process(&mut own, &mut input).is_ok() {
        values.iter_mut().zip(&input).for_each(|(value, new)| *value = new / n as f64);
    }
}

/// Gives values the phase of filters: the inverse of [`undo`].
pub(super) fn redo(values: &mut [f64], gain: &[f64]) {
    // The inverse of a phase is the same phase in a reversed record.
    values.reverse();
    undo(values, gain);
    values.reverse();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transform::Cosines;
    use imu_model::effects::{Effect, LowPass, MovingAverage, Stream, StreamId};

    #[test]
    fn a_spike_behind_a_filter_is_one_sample_again() {
        let filters: [&dyn Effect; 2] = [&MovingAverage::new(7), &LowPass::new(6.0, 2)];
        for n in [4000usize, 4001] {
            for filter in filters {
                let stream = Stream::new(1, StreamId { owner: 1, effect: 1, instance: 0 });
                let mut values = vec![0.0; n];
                values[1500] = 1.0;
                filter.sampler(40.0, n as f64 / 40.0, stream).apply(&mut values);
                let gain: Vec<f64> =
                    (0..n).map(|k| filter.power_gain(20.0 * k as f64 / n as f64, 40.0).max(LEAST)).collect();
                let mut transform = Cosines::new(n);
                transform.forward(&mut values);
                values.iter_mut().zip(&gain).for_each(|(c, gain)| *c /= gain.sqrt());
                transform.backward(&mut values);
                let spread = values.iter().map(|value| value * value).fold(0.0, f64::max);
                let all: f64 = values.iter().map(|value| value * value).sum();
                undo(&mut values, &gain);
                assert!(values[1500] > 0.9, "{n}: {} instead of 1, {spread} before", values[1500]);
                let after: f64 = values.iter().map(|value| value * value).sum();
                assert!((after / all - 1.0).abs() < 1e-3, "{all} {after}");
            }
        }
    }

    #[test]
    fn a_phase_that_is_restored_is_the_one_that_was_removed() {
        let filters: [&dyn Effect; 2] = [&MovingAverage::new(7), &LowPass::new(6.0, 2)];
        for n in [4000usize, 4001] {
            for filter in filters {
                let gain: Vec<f64> =
                    (0..n).map(|k| filter.power_gain(20.0 * k as f64 / n as f64, 40.0).max(LEAST)).collect();
                let values: Vec<f64> = (0..n).map(|k| ((k * k) % 101) as f64 - 50.0).collect();
                let mut there = values.clone();
                undo(&mut there, &gain);
                redo(&mut there, &gain);
                let most = there.iter().zip(&values).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                // The first bin and, for an even length, the last one lose what has no counterpart.
                assert!(most < 0.5, "{n}: {most}");
            }
        }
    }
}
