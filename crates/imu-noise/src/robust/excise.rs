//! Excision: reduces chosen frequencies of samples to the background, and leaves all else unchanged.
//!
//! Overlapping windows are transformed, multiplied by a gain per bin that is 1 outside the bands, and added again. With
//! a gain of 1 everywhere, the samples are unchanged: the window is a half sine both ways, whose squares add to 1.

use super::Part;
use super::lines::Line;
use super::spectrum::Spectrum;
use realfft::RealFftPlanner;
use std::f64::consts::PI;

/// Returns gains per bin that reduce the bands of `lines` to `quiet`; `None` if no bin needs it.
pub(super) fn gains(spectrum: &Spectrum, quiet: &[f64], lines: &[Line]) -> Option<Vec<f64>> {
    let mut gains: Vec<f64> = vec![1.0; spectrum.window / 2 + 1];
    for line in lines {
        for (bin, gain) in gains.iter_mut().enumerate() {
            if !(line.band_hz[0]..=line.band_hz[1]).contains(&(bin as f64 * spectrum.step_hz)) {
                continue;
            }
            *gain = gain.min((quiet[bin] / spectrum.power[bin].max(f64::MIN_POSITIVE)).sqrt().min(1.0));
        }
    }
    gains.iter().any(|gain| *gain < 1.0).then_some(gains)
}

/// The treatment of parts that are shorter than half a window, which cannot be filtered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Short {
    /// They are left out, because vibration in them would look like knocks.
    LeftOut,
    /// They stay unchanged, because a fit leaves the bands out anyway.
    Kept,
}

/// Applies gains to every part that is at least half a window long.
pub(super) fn apply(parts: Vec<Part>, gains: &[f64], short: Short) -> Vec<Part> {
    let half = gains.len() - 1;
    parts
        .into_iter()
        .filter_map(|part| {
            if part.values.len() <= half {
                return Some(part).filter(|_| short == Short::Kept);
            }
            filtered(&part.values, gains).map(|values| Part { values, ..part })
        })
        .collect()
}

fn filtered(values: &[f64], gains: &[f64]) -> Option<Vec<f64>> {
    let half = gains.len() - 1;
    let window = 2 * half;
    let mut planner = RealFftPlanner::<f64>::new();
    let (forward, inverse) = (planner.plan_fft_forward(window), planner.plan_fft_inverse(window));
    let sine: Vec<f64> = (0..window).map(|i| (PI * (i as f64 + 0.5) / window as f64).sin()).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let last = values.len() - 1;
    // Beyond the ends the samples are mirrored about the end points, so that no step causes leakage.
    let at = |i: isize| -> f64 {
        let inside = if i < 0 {
            2.0 * values[0] - values[i.unsigned_abs().min(last)]
        } else if i as usize > last {
            2.0 * values[last] - values[last - (i as usize - last).min(last)]
        } else {
            values[i as usize]
        };
        inside - mean
    };
    let mut out = vec![mean; values.len()];
    let (mut input, mut bins) = (forward.make_input_vec(), forward.make_output_vec());
    let (mut scratch, mut back) = (forward.make_scratch_vec(), inverse.make_scratch_vec());
    for block in 0..values.len().div_ceil(half) + 1 {
        let start = block as isize * half as isize - half as isize;
        for (i, (input, weight)) in input.iter_mut().zip(&sine).enumerate() {
            *input = at(start + i as isize) * weight;
        }
        forward.process_with_scratch(&mut input, &mut bins, &mut scratch).ok()?;
        for (bin, gain) in bins.iter_mut().zip(gains) {
            *bin *= gain / window as f64;
        }
        inverse.process_with_scratch(&mut bins, &mut input, &mut back).ok()?;
        for (i, (value, weight)) in input.iter().zip(&sine).enumerate() {
            if let Some(out) = usize::try_from(start + i as isize).ok().and_then(|index| out.get_mut(index)) {
                *out += value * weight;
            }
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::super::{lines, synthetic::Noise};
    use super::*;

    #[test]
    fn gains_of_one_change_nothing() {
        for count in [129, 1000, 4096] {
            let values: Vec<f64> = Noise::new(1).white(count, 1.0).iter().map(|v| v + 9.8).collect();
            let same = filtered(&values, &[1.0; 129]).unwrap();
            assert_eq!(same.len(), count);
            assert!(values.iter().zip(&same).all(|(a, b)| (a - b).abs() < 1e-12));
        }
    }

    #[test]
    fn a_tone_goes_and_the_noise_stays() {
        let noise = Noise::new(2).white(100_000, 1.0);
        let with: Vec<f64> =
            noise.iter().enumerate().map(|(i, v)| v + 2.0 * (2.0 * PI * 0.334_5 * i as f64).sin()).collect();
        let part = Part { start_s: 0.0, values: with };
        let spectrum = Spectrum::of(std::slice::from_ref(&part), 40.0).unwrap();
        let found = lines::find(&spectrum, 40.0);
        let gains = gains(&spectrum, &lines::quiet(&spectrum, &found), &found).unwrap();
        let cleaned = apply(vec![part], &gains, Short::LeftOut);
        let variance = cleaned[0].values.iter().map(|v| v * v).sum::<f64>() / 1e5;
        let before = noise.iter().map(|v| v * v).sum::<f64>() / 1e5;
        assert!((variance / before - 1.0).abs() < 0.01, "{variance} {before}");
    }
}
