//! The transform: an orthonormal discrete cosine transform, in which a record's noise is uncorrelated.

use super::plans::{self, Turns};
use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealToComplex};
use std::sync::Arc;

/// DCT-II of records of one length, and its inverse, by one real FFT of that length (Makhoul 1980, IEEE Trans. ASSP 28).
///
/// c₀ = √(1/n)·Σ x_j and c_k = √(2/n)·Σ x_j cos(πk(2j + 1)/2n), at the frequency rate·k/2n. White noise stays white. A random
/// walk's coefficients are uncorrelated exactly, with the variance that its spectrum has there, for any first value (the basis
/// diagonalises second differences with reflecting ends: Strang 1999, SIAM Review 41). Other smooth spectra are nearly
/// uncorrelated.
///
/// Validation: against the definition, and by its inverse.
#[derive(Clone)]
pub struct Cosines {
    length: usize,
    forward: Arc<dyn RealToComplex<f64>>,
    backward: Arc<dyn ComplexToReal<f64>>,
    /// cos and sin of πk/2n for k up to n/2.
    turns: Turns,
    real: Vec<f64>,
    complex: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
}

impl std::fmt::Debug for Cosines {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Cosines").field("length", &self.length).finish_non_exhaustive()
    }
}

impl Cosines {
    /// Creates a transform for records of `length` samples, at least 1.
    pub fn new(length: usize) -> Self {
        let length = length.max(1);
        let (forward, backward) = (plans::forward(length), plans::backward(length));
        Self {
            length,
            turns: plans::turns(length),
            real: forward.make_input_vec(),
            complex: forward.make_output_vec(),
            scratch: vec![Complex::default(); forward.get_scratch_len().max(backward.get_scratch_len())],
            forward,
            backward,
        }
    }

    /// Returns the periodogram of `values` followed by as many zeros: |Σ x_j e^(−2πijk/2n)|²/n for k from 0 to n, at
    /// the frequencies rate·k/2n. Empty for a record of another length.
    pub fn periodogram(&mut self, values: &[f64]) -> Vec<f64> {
        let n = self.length;
        if values.len() != n {
            return Vec::new();
        }
        let plan = plans::forward(2 * n);
        let (mut input, mut output) = (plan.make_input_vec(), plan.make_output_vec());
        input[..n].copy_from_slice(values);
        // This fails only for buffers of a wrong length; these are the plan's own.
        let _ = plan.process(&mut input, &mut output);
        output.iter().map(|value| value.norm_sqr() / n as f64).collect()
    }

    /// Returns the number of samples in a record.
    pub fn length(&self) -> usize {
        self.length
    }

    /// Transforms `values` to their coefficients, in place. A record of another length is left unchanged.
    pub fn forward(&mut self, values: &mut [f64]) {
        let n = self.length;
        if values.len() != n {
            return;
        }
        for (j, value) in values.iter().enumerate() {
            let place = if j % 2 == 0 { j / 2 } else { n - 1 - j / 2 };
            self.real[place] = *value;
        }
        // This fails only for buffers of a wrong length; these are the plan's own.
        let _ = self.forward.process_with_scratch(&mut self.real, &mut self.complex, &mut self.scratch);
        let scale = (2.0 / n as f64).sqrt();
        for (k, (of, (cosine, sine))) in self.complex.iter().zip(self.turns.iter()).enumerate() {
            let (re, im) = (of.re * cosine + of.im * sine, of.im * cosine - of.re * sine);
            values[k] = scale * re;
            if k > 0 && k < n - k {
                values[n - k] = -scale * im;
            }
        }
        values[0] *= 0.5f64.sqrt();
    }

    /// Transforms coefficients to their values, in place. A record of another length is left unchanged.
    pub fn backward(&mut self, coefficients: &mut [f64]) {
        let n = self.length;
        if coefficients.len() != n {
            return;
        }
        coefficients[0] *= 2.0f64.sqrt();
        for (k, (of, (cosine, sine))) in self.complex.iter_mut().zip(self.turns.iter()).enumerate() {
            let (re, im) = (coefficients[k], if k > 0 { -coefficients[n - k] } else { 0.0 });
            *of = Complex::new(re * cosine - im * sine, re * sine + im * cosine);
        }
        // The ends are real except for rounding.
        self.complex[0].im = 0.0;
        if n.is_multiple_of(2) {
            self.complex[n / 2].im = 0.0;
        }
        let _ = self.backward.process_with_scratch(&mut self.complex, &mut self.real, &mut self.scratch);
        let scale = (1.0 / (2.0 * n as f64)).sqrt();
        for (j, value) in coefficients.iter_mut().enumerate() {
            let place = if j % 2 == 0 { j / 2 } else { n - 1 - j / 2 };
            *value = scale * self.real[place];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn the_transform_is_that_of_its_definition_and_its_inverse_undoes_it() {
        for n in [1usize, 2, 3, 4, 5, 7, 12, 13, 31, 64, 97, 210] {
            let mut transform = Cosines::new(n);
            let values: Vec<f64> = (0..n).map(|i| ((i * i * 7 + 3 * i) % 23) as f64 * 0.1 - 1.0).collect();
            let mut coefficients = values.clone();
            transform.forward(&mut coefficients);
            for (k, found) in coefficients.iter().enumerate() {
                let scale = if k == 0 { 1.0 / n as f64 } else { 2.0 / n as f64 }.sqrt();
                let cosine = |j: usize| (PI * (k * (2 * j + 1)) as f64 / (2 * n) as f64).cos();
                let expected: f64 = scale * values.iter().enumerate().map(|(j, value)| value * cosine(j)).sum::<f64>();
                assert!((found - expected).abs() < 1e-12, "n {n} k {k}: {found} {expected}");
            }
            transform.backward(&mut coefficients);
            for (found, value) in coefficients.iter().zip(&values) {
                assert!((found - value).abs() < 1e-12, "n {n}: {found} {value}");
            }
        }
    }

    #[test]
    fn the_periodogram_of_a_sine_has_a_quarter_of_its_square_a_sample() {
        let n = 1000;
        let values: Vec<f64> = (0..n).map(|t| 2.0 * (PI * 0.2 * t as f64 + 0.3).cos()).collect();
        let power = Cosines::new(n).periodogram(&values);
        // A²n/4 at 0.1 cycles per sample, which is coefficient 200 of 2n; almost none far off.
        assert!((power[200] / n as f64 - 1.0).abs() < 1e-6 && power[600] < 1e-3 && power.len() == n + 1);
    }

    #[test]
    fn a_record_of_another_length_is_left_alone() {
        let mut values = [1.0, 2.0];
        Cosines::new(3).forward(&mut values);
        Cosines::new(3).backward(&mut values);
        assert_eq!(values, [1.0, 2.0]);
    }
}
