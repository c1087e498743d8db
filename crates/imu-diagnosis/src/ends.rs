//! Ends: the part of a narrow band or of quantization noise at the ends of a record that the transform does not
//! represent.

use super::law::{Shape, Term};
use super::series::Series;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::{PI, TAU};

/// Bands that lose their correlation within fewer than 1 over this many samples have no material effect at the ends.
const WIDEST: f64 = 0.3;
/// Correlation times after which no correlation is left.
const FORGOTTEN: f64 = 8.0;

/// Returns the part of a term that is odd about a record's first end, and its variance, in the series' scale: e^(−γ(t +
/// ½))·sin(ω(t + ½)) for a band. Quantization noise is u_t − u_(t−1); its odd part is the u before the first sample.
fn odd_part(term: &Term, rate_hz: f64, samples: usize) -> Option<(Vec<f64>, f64)> {
    if term.shape == Shape::QuantizationNoise {
        return term.numbers.first().map(|level| (vec![1.0], level.exp() * rate_hz * rate_hz));
    }
    let [power, frequency_hz, width] = *term.numbers.first_chunk::<3>()?;
    let (gamma, turn) = (PI * width.exp() / rate_hz, TAU * frequency_hz / rate_hz);
    let lasts = ((FORGOTTEN / gamma) as usize).clamp(1, samples);
    let at = |t: usize| t as f64 + 0.5;
    let values = (0..lasts).map(|t| (-gamma * at(t)).exp() * (turn * at(t)).sin());
    (gamma < WIDEST).then(|| (values.collect(), power.exp()))
}

impl Series<'_> {
    /// Returns whether the law or the model has terms with a part that is odd about an end.
    pub(super) fn has_odd_parts(&self) -> bool {
        self.odd_terms().next().is_some()
    }

    fn odd_terms(&self) -> impl Iterator<Item = &Term> {
        let declared = self.setting().declared.iter().filter(|(place, _)| !self.explanation.without.contains(place));
        let declared = declared.map(|(_, term)| term).chain(self.setting().wandering);
        let terms = self.explanation.law.terms.iter().chain(declared);
        terms.filter(|term| matches!(term.shape, Shape::Resonance | Shape::QuantizationNoise))
    }

    /// Subtracts from the rest the part of narrow bands and quantization noise at the ends of the record that the law does not
    /// represent.
    ///
    /// The cosine transform continues a record by its mirror image. A stationary process whose autocovariance is c has
    /// c(s − t) between samples s and t; the law of the transform's coefficients has c(s − t) + c(s + t + 1) at the
    /// first end, and the mirror image of that at the last. For a band, c(s + t + 1) is σ²·e^(−γ(s + t + 1))·cos ω(s +
    /// t + 1): the product of its even part about the end at s and at t less that of its odd part. The law lacks the
    /// odd part, which is as large as the even part; that of a strong band looks like a burst at the end, or like a
    /// filter. For quantization noise, c(1) is −σ², and the odd part is in the first sample alone. This function
    /// subtracts the most probable course of the odd parts, given the rest.
    pub(super) fn take_ends_off(&mut self) {
        let n = self.len();
        let rate_hz = self.setting().rate_hz;
        let parts: Vec<(Vec<f64>, f64)> = self.odd_terms().filter_map(|term| odd_part(term, rate_hz, n)).collect();
        // If a band lies behind a filter that passes almost nothing there, its course is not known precisely enough.
        if parts.is_empty() || self.spectrum.len() != n || self.filters().is_some() {
            return;
        }
        let mut rest = self.rest.clone();
        self.transform.forward(&mut rest);
        let mut columns: Vec<Vec<f64>> = Vec::new();
        for (values, _) in &parts {
            let mut first = values.clone();
            first.resize(n, 0.0);
            self.transform.forward(&mut first);
            let last = first.iter().enumerate().map(|(k, c)| if k % 2 == 0 { *c } else { -c }).collect();
            columns.extend([first, last]);
        }
        let product = |a: &[f64], b: &[f64]| {
            a.iter().zip(b).zip(&self.spectrum).skip(1).map(|((a, b), s)| a * b / s).sum::<f64>()
        };
        let count = columns.len();
        let mut normal = DMatrix::from_fn(count, count, |i, j| product(&columns[i], &columns[j]));
        for i in 0..count {
            normal[(i, i)] += 1.0 / parts[i / 2].1.max(f64::MIN_POSITIVE);
        }
        let right = DVector::from_fn(count, |i, _| product(&columns[i], &rest));
        let Some(factor) = normal.cholesky() else { return };
        let factors = factor.solve(&right);
        for (at, (values, _)) in parts.iter().enumerate() {
            for (t, value) in values.iter().enumerate() {
                self.rest[t] -= factors[2 * at] * value;
                self.rest[n - 1 - t] -= factors[2 * at + 1] * value;
            }
        }
    }
}
