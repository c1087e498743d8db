//! Crosstalk: one channel's samples in another's, earlier or later.

use crate::plans;
use realfft::num_complex::Complex;

/// Longest lag, samples.
const LONGEST: usize = 20_000;
/// Shortest lag; [`super::super::shared`] separates shorter ones from noise that channels share.
const SHORTEST: usize = 3;

/// Returns, for each channel, half the greatest squared correlation with any other at a lag, times the number of
/// samples: about −ln of its chance, without the number of lags. The residuals are white. Pairs that are `linked` share
/// noise without a lag, which two whitening filters spread over lags; they are left out.
pub fn greatest(residuals: Vec<Vec<f64>>, linked: &dyn Fn(usize, usize) -> bool) -> Vec<f64> {
    let mut found = vec![0.0; residuals.len()];
    let n = residuals.first().map_or(0, Vec::len);
    if residuals.len() < 2 || n < 8 * SHORTEST {
        return found;
    }
    let (forward, backward) = (plans::forward(n), plans::backward(n));
    let mut sums = forward.make_input_vec();
    let power: Vec<f64> = residuals.iter().map(|of| of.iter().map(|e| e * e).sum()).collect();
    let mut spectra: Vec<Vec<Complex<f64>>> = Vec::with_capacity(residuals.len());
    // Each residual is freed once it is transformed: both together would need much memory for many long channels.
    for mut of in residuals {
        let mut spectrum = forward.make_output_vec();
        if forward.process(&mut of, &mut spectrum).is_err() {
            return found;
        }
        spectra.push(spectrum);
    }
    let longest = LONGEST.min(n / 4);
    for i in 0..spectra.len() {
        for j in (0..i).filter(|j| !linked(i, *j)) {
            let mut product: Vec<Complex<f64>> =
                spectra[i].iter().zip(&spectra[j]).map(|(a, b)| a * b.conj()).collect();
            // The first value and, for an even number, the last one are real.
            product[0].im = 0.0;
            if n.is_multiple_of(2)
                && let Some(last) = product.last_mut()
            {
                last.im = 0.0;
            }
            if backward.process(&mut product, &mut sums).is_err() {
                continue;
            }
            let lags = sums[SHORTEST..longest].iter().chain(&sums[n - longest + 1..=n - SHORTEST]);
            let most = lags.map(|sum| sum.abs()).fold(0.0, f64::max) / n as f64;
            let square = most * most / (power[i] * power[j]).max(f64::MIN_POSITIVE);
            let value = 0.5 * n as f64 * square;
            found[i] = found[i].max(value);
            found[j] = found[j].max(value);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::{Stream, StreamId};

    #[test]
    fn a_delayed_copy_is_found_in_both_and_others_are_left_alone() {
        let n = 6001;
        let noise = |effect: u16| {
            let mut stream = Stream::new(5, StreamId { owner: 1, effect, instance: 0 });
            (0..n).map(|_| stream.normal()).collect::<Vec<f64>>()
        };
        let (source, mut copy, other) = (noise(0), noise(1), noise(2));
        for t in 37..n {
            copy[t] -= 0.15 * source[t - 37];
        }
        let found = greatest(vec![source.clone(), copy.clone(), other], &|_, _| false);
        // n·r²/2 = 66.
        assert!(found[0] > 40.0 && found[0] == found[1] && found[2] < 18.0, "{found:?}");
        assert_eq!(greatest(vec![source.clone()], &|_, _| false), [0.0]);
        assert_eq!(greatest(vec![source, copy], &|_, _| true), [0.0, 0.0]);
    }
}
