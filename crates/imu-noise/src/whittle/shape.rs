//! Shapes: the effect of a filter inside the recorded band on the noise in front of it.
//!
//! A shape is a power gain over u = f·dt that is 1 at low frequencies, so that N stays the plateau of the sampled
//! spectrum. Its numbers (a cutoff, coefficients) are fitted by their slopes d ln(gain)/dp.

use std::f64::consts::PI;

/// Maximum number of a shape's numbers.
pub(super) const TILTS: usize = 6;

/// A family of filters.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Shape {
    /// No filter: noise reaches half the rate unchanged.
    Open,
    /// The mean of this many samples.
    MovingAverage(u32),
    /// A Butterworth filter, bilinear, −3 dB at u = `cutoff`.
    Butterworth {
        /// Order, 1 to 4.
        order: u32,
        /// Cutoff, cycles per sample.
        cutoff: f64,
    },
    /// y += a (x − y), −3 dB at u = `cutoff`.
    Exponential {
        /// Cutoff, cycles per sample.
        cutoff: f64,
    },
    /// The mean of `window` samples, of which every `every`th is kept: a sensor's boxcar and decimation, folding
    /// included.
    Decimated {
        /// Samples per mean, at the internal rate.
        window: u32,
        /// Internal samples per output sample.
        every: u32,
    },
    /// exp(−Σ c_j sin²ʲ(πu)): any smooth filter, up to the highest frequency used.
    Smooth {
        /// The coefficients from c_1 on.
        coefficients: Vec<f64>,
        /// Frequencies above this are not described.
        up_to: f64,
    },
}

/// Power gains of white noise, flicker and a random walk, relative to their spectra without a filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Gains {
    pub(super) white: f64,
    pub(super) flicker: f64,
    pub(super) walk: f64,
}

impl Shape {
    /// Returns the gains at u in (0, 1/2].
    pub(super) fn gains(&self, u: f64) -> Gains {
        let alike = |gain: f64| Gains { white: gain, flicker: gain, walk: gain };
        match self {
            Self::Open => alike(1.0),
            Self::MovingAverage(window) => alike(boxcar(*window, u)),
            Self::Butterworth { order, cutoff } => {
                let ratio = (PI * u).tan() / (PI * cutoff).tan();
                alike(1.0 / (1.0 + ratio.powi(2 * *order as i32)))
            }
            Self::Exponential { cutoff } => {
                let a = exponential_weight(*cutoff);
                let back = 1.0 - a;
                alike(a * a / (a * a + 2.0 * back * (1.0 - (2.0 * PI * u).cos())))
            }
            Self::Decimated { window, every } => decimated(*window, *every, u),
            Self::Smooth { coefficients, up_to } => {
                // A polynomial diverges beyond the range to which it was fitted.
                let x = (PI * u.min(*up_to)).sin().powi(2);
                let sum: f64 = coefficients.iter().rev().fold(0.0, |sum, c| (sum + c) * x);
                alike((-sum).exp())
            }
        }
    }

    /// Returns the number of fitted numbers.
    pub(super) fn tilts(&self) -> usize {
        match self {
            Self::Open | Self::MovingAverage(_) | Self::Decimated { .. } => 0,
            Self::Butterworth { .. } | Self::Exponential { .. } => 1,
            Self::Smooth { coefficients, .. } => coefficients.len().min(TILTS),
        }
    }

    /// Returns the shape with its numbers moved: cutoffs logarithmically, coefficients linearly.
    pub(super) fn moved(&self, by: &[f64; TILTS]) -> Self {
        let of = |cutoff: f64| (cutoff * by[0].exp()).clamp(1e-4, 0.4999);
        match self {
            Self::Butterworth { order, cutoff } => Self::Butterworth { order: *order, cutoff: of(*cutoff) },
            Self::Exponential { cutoff } => Self::Exponential { cutoff: of(*cutoff) },
            Self::Smooth { coefficients, up_to } => Self::Smooth {
                coefficients: coefficients.iter().zip(by).map(|(c, by)| c + by).collect(),
                up_to: *up_to,
            },
            other => other.clone(),
        }
    }

    /// Returns d ln(gain)/dp at u.
    pub(super) fn slopes(&self, u: f64) -> [f64; TILTS] {
        let mut slopes = [0.0; TILTS];
        match self {
            Self::Smooth { coefficients, .. } => {
                let x = (PI * u).sin().powi(2);
                let mut power = 1.0;
                for slope in slopes.iter_mut().take(coefficients.len()) {
                    power *= x;
                    *slope = -power;
                }
            }
            Self::Butterworth { .. } | Self::Exponential { .. } => {
                const STEP: f64 = 1e-4;
                let at = |step: f64| self.moved(&[step, 0.0, 0.0, 0.0, 0.0, 0.0]).gains(u).white.ln();
                slopes[0] = (at(STEP) - at(-STEP)) / (2.0 * STEP);
                if !slopes[0].is_finite() {
                    slopes[0] = 0.0;
                }
            }
            Self::Open | Self::MovingAverage(_) | Self::Decimated { .. } => {}
        }
        slopes
    }
}

/// Returns a of y += a (x − y), which passes half the power at `cutoff` cycles per sample.
///
/// |H|² is a²/(a² + 2(1 − a)c) with c = 1 − cos(2π·cutoff).
pub fn exponential_weight(cutoff: f64) -> f64 {
    let c = 1.0 - (2.0 * PI * cutoff).cos();
    (c * c + 2.0 * c).sqrt() - c
}

/// Returns |H|² of the mean of `window` samples; a window of 0 does not average.
pub(crate) fn boxcar(window: u32, u: f64) -> f64 {
    let sine = (PI * u).sin();
    let window = f64::from(window.max(1));
    if sine.abs() < 1e-12 { 1.0 } else { ((PI * u * window).sin() / (window * sine)).powi(2) }
}

/// Returns the gains of a boxcar and decimation: the images k of the output rate are added.
fn decimated(window: u32, every: u32, u: f64) -> Gains {
    let every = every.max(1);
    let (mut white, mut plateau, mut flicker, mut walk) = (0.0, 0.0, 0.0, 0.0);
    let output = (PI * u).sin().powi(2);
    for image in 0..every {
        // The images lie at u + k for k from −every/2 on.
        let k = f64::from(image) - f64::from(every / 2);
        let own = (u + k) / f64::from(every);
        let gain = boxcar(window, own);
        white += gain;
        plateau += boxcar(window, k / f64::from(every));
        flicker += gain * u / (u + k).abs().max(1e-300);
        walk += gain * output / (f64::from(every) * (PI * own).sin()).powi(2).max(1e-300);
    }
    Gains { white: white / plateau, flicker, walk }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_are_one_at_low_frequencies_and_half_at_the_cutoff() {
        let shapes = [
            Shape::Open,
            Shape::MovingAverage(4),
            Shape::Butterworth { order: 3, cutoff: 0.2 },
            Shape::Exponential { cutoff: 0.2 },
            Shape::Decimated { window: 4, every: 4 },
            Shape::Smooth { coefficients: vec![3.0, -1.0], up_to: 0.5 },
        ];
        for shape in &shapes {
            let gains = shape.gains(1e-7);
            for gain in [gains.white, gains.flicker, gains.walk] {
                assert!((gain - 1.0).abs() < 1e-4, "{shape:?}: {gains:?}");
            }
        }
        for shape in &shapes[2..4] {
            assert!((shape.gains(0.2).white - 0.5).abs() < 1e-9, "{shape:?}");
        }
    }

    #[test]
    fn a_window_that_the_output_period_holds_leaves_white_noise_white() {
        for (window, every) in [(4, 20), (1, 20), (4, 4), (20, 20)] {
            for u in [0.01, 0.1, 0.3, 0.5] {
                let white = Shape::Decimated { window, every }.gains(u).white;
                assert!((white - 1.0).abs() < 1e-9, "{window} of {every} at {u}: {white}");
            }
        }
        let sent = Shape::Decimated { window: 4, every: 1 };
        assert_eq!(sent.gains(0.13).white, Shape::MovingAverage(4).gains(0.13).white);
    }

    #[test]
    fn a_walk_without_a_filter_folds_to_a_walk() {
        for u in [0.001, 0.1, 0.4] {
            let walk = Shape::Decimated { window: 1, every: 20 }.gains(u).walk;
            assert!((walk - 1.0).abs() < 1e-9, "{u}: {walk}");
        }
    }

    #[test]
    fn slopes_are_those_of_the_gains() {
        for shape in [
            Shape::Butterworth { order: 2, cutoff: 0.1 },
            Shape::Exponential { cutoff: 0.3 },
            Shape::Smooth { coefficients: vec![3.0, -1.0, 0.5], up_to: 0.5 },
        ] {
            for tilt in 0..shape.tilts() {
                let mut by = [0.0; TILTS];
                by[tilt] = 1e-3;
                for u in [0.01, 0.2, 0.45] {
                    let found = (shape.moved(&by).gains(u).white / shape.gains(u).white).ln() / 1e-3;
                    assert!((found - shape.slopes(u)[tilt]).abs() < 5e-3 * found.abs().max(1e-3), "{shape:?} {u}");
                }
            }
        }
    }
}
