//! Welch's averaged periodogram with half-overlapping Hann windows, each less its straight line.
//!
//! # Source
//! P. D. Welch, IEEE Trans. Audio Electroacoustics AU-15 (1967) 70.

use realfft::num_complex::Complex;
use realfft::{RealFftPlanner, RealToComplex};
use std::f64::consts::PI;
use std::sync::Arc;

/// The transform of windows of one length.
pub(super) struct Windows {
    hann: Vec<f64>,
    transform: Arc<dyn RealToComplex<f64>>,
    input: Vec<f64>,
    output: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
    norm: f64,
}

impl Windows {
    /// Creates windows of `window` samples, an even number.
    pub(super) fn new(window: usize, rate_hz: f64) -> Self {
        let transform = RealFftPlanner::<f64>::new().plan_fft_forward(window);
        let hann: Vec<f64> = (0..window).map(|i| 0.5 - 0.5 * (2.0 * PI * i as f64 / window as f64).cos()).collect();
        let norm = 2.0 / (rate_hz * hann.iter().map(|w| w * w).sum::<f64>());
        let (input, output, scratch) =
            (transform.make_input_vec(), transform.make_output_vec(), transform.make_scratch_vec());
        Self { hann, transform, input, output, scratch, norm }
    }

    /// Adds the one-sided power density of a window of samples to the sums of its bins, U²/Hz; `None` if its length
    /// differs.
    pub(super) fn add(&mut self, values: &[f64], sums: &mut [f64]) -> Option<()> {
        if values.len() != self.hann.len() {
            return None;
        }
        detrended(values, &self.hann, &mut self.input);
        self.transform.process_with_scratch(&mut self.input, &mut self.output, &mut self.scratch).ok()?;
        for (sum, value) in sums.iter_mut().zip(&self.output) {
            *sum += value.norm_sqr() * self.norm;
        }
        // At half the rate, both sides are the same.
        if let Some((sum, value)) = sums.last_mut().zip(self.output.last()) {
            *sum -= 0.5 * value.norm_sqr() * self.norm;
        }
        Some(())
    }
}

/// Subtracts the straight line from samples and applies the window, so that a drift does not leak into every bin.
fn detrended(values: &[f64], hann: &[f64], out: &mut [f64]) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let centre = (count - 1.0) / 2.0;
    let (mut xy, mut xx) = (0.0, 0.0);
    for (i, value) in values.iter().enumerate() {
        let x = i as f64 - centre;
        xy += x * (value - mean);
        xx += x * x;
    }
    let slope = xy / xx.max(1.0);
    for (i, ((out, value), weight)) in out.iter_mut().zip(values).zip(hann).enumerate() {
        *out = (value - mean - slope * (i as f64 - centre)) * weight;
    }
}

/// The spectrum of a channel whose samples arrive one after the other; it needs the memory of two windows for any
/// number of samples.
pub struct Welch {
    windows: Windows,
    window: usize,
    rate_hz: f64,
    /// Samples since the middle of the last complete window.
    held: Vec<f64>,
    sums: Vec<f64>,
    count: u64,
}

impl std::fmt::Debug for Welch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Welch").field("window", &self.window).field("count", &self.count).finish_non_exhaustive()
    }
}

impl Welch {
    /// Number of samples in the shortest and in the longest window.
    const ENDS: (usize, usize) = (256, 1 << 16);
    /// Intended number of windows of a record.
    const WANTED: u64 = 16;

    /// Creates a spectrum for stretches of about these numbers of samples without gaps, at a rate. It uses the longest
    /// window of which there are enough, because no window spans a gap.
    pub fn new(stretches: &[u64], rate_hz: f64) -> Self {
        let (shortest, longest) = Self::ENDS;
        let mut window = longest;
        while window > shortest && stretches.iter().map(|samples| samples / window as u64).sum::<u64>() < Self::WANTED {
            window /= 2;
        }
        let windows = Windows::new(window, rate_hz);
        Self { windows, window, rate_hz, held: Vec::with_capacity(window), sums: vec![0.0; window / 2 + 1], count: 0 }
    }

    /// Takes the next samples, which follow the previous ones without a gap; a sample that is not a number interrupts.
    pub fn push(&mut self, samples: &[f64]) {
        for sample in samples {
            if !sample.is_finite() {
                self.interrupt();
                continue;
            }
            self.held.push(*sample);
            if self.held.len() == self.window {
                let whole = self.windows.add(&self.held, &mut self.sums);
                self.count += u64::from(whole.is_some());
                self.held.drain(..self.window / 2);
            }
        }
    }

    /// Marks a gap, which no window spans.
    pub fn interrupt(&mut self) {
        self.held.clear();
    }

    /// Returns frequencies above 0 in Hz and the root of the one-sided power density there, U/√Hz: means over bins that
    /// lie closer than a share `apart` of their frequency. `None` if there was no complete window.
    pub fn density(&self, apart: f64) -> Option<(Vec<f64>, Vec<f64>)> {
        let step_hz = self.rate_hz / self.window as f64;
        let mut at = (Vec::new(), Vec::new());
        let mut bin = 1;
        while bin < self.sums.len() && self.count > 0 {
            let end = (bin + ((bin as f64 * apart) as usize).max(1)).min(self.sums.len());
            let mean = self.sums[bin..end].iter().sum::<f64>() / ((end - bin) as f64 * self.count as f64);
            at.0.push(0.5 * (bin + end - 1) as f64 * step_hz);
            at.1.push(mean.max(0.0).sqrt());
            bin = end;
        }
        (!at.0.is_empty()).then_some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};

    fn white(samples: usize, seed: u64) -> Vec<f64> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        (0..samples).map(|_| (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0).collect()
    }

    #[test]
    fn white_noise_has_its_density_however_it_is_cut() {
        let samples = white(60_000, 3);
        let mut whole = Welch::new(&[60_000], 40.0);
        whole.push(&samples);
        let mut cut = Welch::new(&[60_000], 40.0);
        samples.chunks(777).for_each(|chunk| cut.push(chunk));
        assert_eq!(whole.density(0.05), cut.density(0.05));
        let (hz, density) = whole.density(0.05).unwrap();
        // One-sided: √(2/rate).
        let mean = density.iter().map(|value| value * value).sum::<f64>() / density.len() as f64;
        assert!((mean / (2.0 / 40.0) - 1.0).abs() < 0.05, "{mean}");
        assert!(hz.windows(2).all(|pair| pair[1] > pair[0]) && *hz.last().unwrap() <= 20.0);
    }

    #[test]
    fn no_window_goes_across_a_gap() {
        let mut steps = Welch::new(&[8192], 40.0);
        for level in [0.0, 1e3] {
            steps.push(&white(4096, 5).into_iter().map(|value| value + level).collect::<Vec<_>>());
            steps.interrupt();
        }
        let (_, density) = steps.density(0.1).unwrap();
        assert!(density[1..].iter().all(|value| *value < 1.0), "{density:?}");
        // A gap every ten minutes: windows that fit between them.
        let mut often = Welch::new(&[24_000; 30], 40.0);
        for seed in 0..30 {
            often.push(&white(24_000, seed));
            often.interrupt();
        }
        assert!(often.density(0.02).is_some());
        let mut short = Welch::new(&[100], 40.0);
        short.push(&[1.0; 100]);
        assert_eq!(short.density(0.1), None);
    }
}
