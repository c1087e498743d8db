//! Frequencies: where spectra are evaluated many times, with the trigonometry that they share.

use std::f64::consts::PI;

/// Frequencies at which a fit evaluates spectra again and again. The sines, cosines and tangents are computed once.
#[derive(Debug, Clone, PartialEq)]
pub struct Frequencies {
    rate_hz: f64,
    hz: Vec<f64>,
    half_angles: Vec<HalfAngle>,
}

/// Functions of half the angle per sample, πf/rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct HalfAngle {
    pub sine: f64,
    pub cosine: f64,
    /// The bilinear transform's image of the frequency.
    pub tangent: f64,
}

impl HalfAngle {
    pub fn of(frequency_hz: f64, rate_hz: f64) -> Self {
        let angle = PI * frequency_hz / rate_hz;
        let (sine, cosine) = angle.sin_cos();
        Self { sine, cosine, tangent: warped(frequency_hz, rate_hz) }
    }
}

/// Returns the bilinear transform's image of a frequency.
pub(super) fn warped(frequency_hz: f64, rate_hz: f64) -> f64 {
    (PI * frequency_hz / rate_hz).tan()
}

impl Frequencies {
    /// Creates the frequencies `hz` of a spectrum that is sampled at `rate_hz`.
    pub fn new(hz: Vec<f64>, rate_hz: f64) -> Self {
        let half_angles = hz.iter().map(|frequency_hz| HalfAngle::of(*frequency_hz, rate_hz)).collect();
        Self { rate_hz, hz, half_angles }
    }

    /// Returns the frequencies, Hz.
    pub fn hz(&self) -> &[f64] {
        &self.hz
    }

    /// Returns the samples per second.
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// Evaluates a function of half the angle per sample at each frequency.
    pub(super) fn map(&self, of: impl Fn(&HalfAngle) -> f64) -> Vec<f64> {
        self.half_angles.iter().map(of).collect()
    }
}
