//! Spectrum: noise of a given density, for effects without a name.
//!
//! White noise passes a symmetric filter whose gain is the root of the density. The gain is sampled in frequency and
//! its response windowed (Hann). The filter has as many taps as the closest points need, at most [`TAPS_MAX`]: features
//! narrower than 1/500 of the rate are smoothed. The filter runs by overlap-save in blocks of its own length, for
//! requested blocks of any size. All input that the filter reaches back to is drawn first, so that the noise is
//! stationary from the start.

use super::described::effect;
use super::spec::{Form, Need};
use super::{Effect, Moments, Record, Refusal, Sampler, Stage, Stream, Temperature, profile, sampled};
use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

effect! {
    /// Noise whose two-sided density is given at points, linear in between (density over frequency) and constant beyond
    /// them, times the square of a factor that may follow a profile.
    ///
    /// Autocovariance without a profile: 2·Σ b·(cos ωf₁ − cos ωf₀)/ω² over the lines of slope b from f₀ to f₁, ω = 2πk·dt.
    #[derive(Debug, Clone, PartialEq)]
    pub struct SpectralNoise: dyn Effect, 19, Stage::Noise;
    "noise of a given density: what has no name";
    density: Vec<(f64, f64)> = Form::Density, "U²/Hz",
        "[f_hz, two-sided density in U²/Hz], straight lines in between, constant beyond";
    level: Vec<(f64, f64)> = Form::Profile, "",
        "[t_s, factor on the amplitude], linear in between; 1 where it is not given", Need::Optional;
}

/// Maximum number of taps.
pub const TAPS_MAX: usize = 4096;
/// Minimum number of taps.
const TAPS_MIN: usize = 64;
/// Taps per period of the distance between the closest points.
const TAPS_PER_DISTANCE: f64 = 16.0;

impl SpectralNoise {
    /// Returns the density at a frequency without the level's factor, U²/Hz.
    fn at(&self, frequency_hz: f64) -> f64 {
        // Linear in between and constant beyond, as a profile.
        profile::factor(&self.density, frequency_hz)
    }

    /// Returns the points from 0 to half the rate, both included.
    fn knots(&self, rate_hz: f64) -> Vec<(f64, f64)> {
        let half_hz = 0.5 * rate_hz;
        let inner = self.density.iter().copied().filter(|(f, _)| *f > 0.0 && *f < half_hz);
        std::iter::once((0.0, self.at(0.0))).chain(inner).chain([(half_hz, self.at(half_hz))]).collect()
    }

    /// Returns the mean square without the level's factor: the density's integral over both sides.
    fn variance(&self, rate_hz: f64) -> f64 {
        self.knots(rate_hz).windows(2).map(|two| (two[1].0 - two[0].0) * (two[0].1 + two[1].1)).sum()
    }

    /// Returns the number of taps that resolves the points, a power of two.
    fn taps(&self, rate_hz: f64) -> usize {
        let closest_hz = self.density.windows(2).map(|two| two[1].0 - two[0].0).fold(rate_hz, f64::min);
        let wanted = (TAPS_PER_DISTANCE * rate_hz / closest_hz).min(TAPS_MAX as f64);
        (wanted as usize).clamp(TAPS_MIN, TAPS_MAX).next_power_of_two()
    }
}

impl Effect for SpectralNoise {
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        let half_hz = 0.5 * rate_hz;
        let Some(place) = self.density.iter().position(|point| point.0 > half_hz * (1.0 + 1e-9)) else { return Ok(()) };
        let allowed = format!("frequencies up to {half_hz} Hz, half the rate at which it acts");
        Err(Self::SPEC.refuse(format!("density[{place}]"), format!("{} Hz", self.density[place].0), allowed))
    }
    /// `None` with a level, which changes the density with time.
    fn psd(&self, frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        self.level.is_empty().then(|| self.at(frequency_hz))
    }
    fn stationary(&self, record: Record) -> Option<Arc<dyn Effect>> {
        let square = profile::mean_power_of(&self.level, record.length_s(), 2);
        let density = self.density.iter().map(|(hz, density)| (*hz, density * square)).collect();
        (!self.level.is_empty()).then(|| Arc::new(Self { density, level: Vec::new() }) as Arc<dyn Effect>)
    }
    /// `None` with a level, which changes the variance with time.
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        if !self.level.is_empty() {
            return None;
        }
        let knots = self.knots(record.rate_hz);
        let variance = self.variance(record.rate_hz);
        let covariance = |k: u64| {
            let turn = TAU * k as f64 / record.rate_hz;
            let line = |two: &[(f64, f64)]| {
                let ((f0, s0), (f1, s1)) = (two[0], two[1]);
                // cos ωf₁ − cos ωf₀ without cancellation.
                let bend = -2.0 * (0.5 * turn * (f0 + f1)).sin() * (0.5 * turn * (f1 - f0)).sin();
                (s1 - s0) / (f1 - f0) * bend
            };
            2.0 * knots.windows(2).filter(|two| two[0].1 != two[1].1).map(line).sum::<f64>() / (turn * turn)
        };
        Some(sampled::allan_variance(m, |k| variance - covariance(k)))
    }
    fn moments(&self, record: Record) -> Option<Moments> {
        Some(profile::moments(self.variance(record.rate_hz), &self.level, record.length_s()))
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, stream: Stream) -> Box<dyn Sampler> {
        let mut taps = taps(self.taps(rate_hz), |cycles| (self.at(cycles * rate_hz) * rate_hz).sqrt());
        // Smoothing an amplitude reduces its power.
        let power = taps.iter().map(|tap| tap * tap).sum::<f64>();
        let scale = (self.variance(rate_hz) / power.max(f64::MIN_POSITIVE)).sqrt();
        taps.iter_mut().for_each(|tap| *tap *= scale);
        let stationary = Box::new(FilteredSampler::new(&taps, stream));
        if self.level.is_empty() {
            stationary
        } else {
            Box::new(profile::Weighted::new(stationary, profile::Course::new(&self.level, rate_hz)))
        }
    }
}

/// Returns `count` taps (a power of two) whose gain is `gain` of cycles per sample, smoothed by a Hann window's
/// transform.
fn taps(count: usize, gain: impl Fn(f64) -> f64) -> Vec<f64> {
    let grid = 4 * count;
    let inverse = RealFftPlanner::<f64>::new().plan_fft_inverse(grid);
    let mut gains: Vec<Complex<f64>> =
        (0..=grid / 2).map(|bin| Complex::new(gain(bin as f64 / grid as f64), 0.0)).collect();
    let mut response = inverse.make_output_vec();
    transform_back(inverse.as_ref(), &mut gains, &mut response);
    // The response is symmetric about 0; its middle goes to the middle of the taps.
    (1..count)
        .map(|tap| {
            let window = (PI * tap as f64 / count as f64).sin().powi(2);
            window * response[(tap + grid - count / 2) % grid] / grid as f64
        })
        .collect()
}

/// Applies an inverse transform; its lengths are its own, and the imaginary parts at 0 and half the rate are 0.
fn transform_back(inverse: &dyn ComplexToReal<f64>, from: &mut [Complex<f64>], to: &mut [f64]) {
    if let (Some(first), true) = (from.first_mut(), inverse.len() > 0) {
        first.im = 0.0;
    }
    if let Some(last) = from.last_mut() {
        last.im = 0.0;
    }
    let done = inverse.process(from, to);
    debug_assert!(done.is_ok(), "{done:?}");
}

/// White noise behind a filter, by overlap-save.
struct FilteredSampler {
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
    /// The transform of the taps over its length.
    gains: Vec<Complex<f64>>,
    /// The number of past samples that the filter uses.
    reach: usize,
    /// The input; its first `reach` numbers are the last ones of the block before.
    input: Vec<f64>,
    scratch: Vec<f64>,
    bins: Vec<Complex<f64>>,
    /// The present block's values, and the number of those already returned.
    output: Vec<f64>,
    given: usize,
    stream: Stream,
}

impl std::fmt::Debug for FilteredSampler {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("FilteredSampler").field("reach", &self.reach).finish_non_exhaustive()
    }
}

impl FilteredSampler {
    fn new(taps: &[f64], mut stream: Stream) -> Self {
        let length = 4 * taps.len().next_power_of_two();
        let mut planner = RealFftPlanner::<f64>::new();
        let (forward, inverse) = (planner.plan_fft_forward(length), planner.plan_fft_inverse(length));
        let mut padded = forward.make_input_vec();
        for (place, tap) in padded.iter_mut().zip(taps) {
            *place = tap / length as f64;
        }
        let mut gains = forward.make_output_vec();
        let done = forward.process(&mut padded, &mut gains);
        debug_assert!(done.is_ok(), "{done:?}");
        let reach = taps.len() - 1;
        let mut input = vec![0.0; length];
        for drive in &mut input[length - reach..] {
            *drive = stream.normal();
        }
        Self {
            bins: forward.make_output_vec(),
            output: inverse.make_output_vec(),
            scratch: vec![0.0; length],
            given: length,
            forward,
            inverse,
            gains,
            reach,
            input,
            stream,
        }
    }

    /// Computes the next block.
    fn filter(&mut self) {
        let length = self.input.len();
        self.input.copy_within(length - self.reach.., 0);
        for drive in &mut self.input[self.reach..] {
            *drive = self.stream.normal();
        }
        self.scratch.copy_from_slice(&self.input);
        let done = self.forward.process(&mut self.scratch, &mut self.bins);
        debug_assert!(done.is_ok(), "{done:?}");
        for (bin, gain) in self.bins.iter_mut().zip(&self.gains) {
            *bin *= gain;
        }
        transform_back(self.inverse.as_ref(), &mut self.bins, &mut self.output);
        self.given = self.reach;
    }
}

impl Sampler for FilteredSampler {
    fn act(&mut self, values: &mut [f64], _temperature: Temperature<'_>) {
        let mut rest = values;
        while !rest.is_empty() {
            if self.given == self.output.len() {
                self.filter();
            }
            let count = rest.len().min(self.output.len() - self.given);
            let (now, later) = rest.split_at_mut(count);
            for (value, filtered) in now.iter_mut().zip(&self.output[self.given..]) {
                *value += filtered;
            }
            self.given += count;
            rest = later;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    fn noise(density: &[(f64, f64)]) -> SpectralNoise {
        SpectralNoise { density: density.to_vec(), level: Vec::new() }
    }

    #[test]
    fn spectrum_allan_variance_and_moments_are_those_of_the_density() {
        check::agrees_with_its_closed_forms(&noise(&[(0.0, 1.0), (20.0, 1.0)]), 40.0);
        check::agrees_with_its_closed_forms(&noise(&[(1.0, 4.0), (3.0, 0.5), (9.0, 2.0), (10.0, 1.0)]), 40.0);
        check::agrees_with_its_closed_forms(&noise(&[(11.0, 0.1), (11.4, 3.0), (11.8, 0.1)]), 40.0);
    }

    #[test]
    fn moments_follow_the_level() {
        let level = vec![(50.0, 0.5), (200.0, 2.0), (300.0, 0.0)];
        let of = SpectralNoise { level, ..noise(&[(1.0, 4.0), (3.0, 0.5)]) };
        assert_eq!((of.psd(1.0, 40.0), of.allan_variance(3, Record { rate_hz: 40.0, samples: 100 })), (None, None));
        check::agrees_with_its_closed_forms(&of, 40.0);
        // With a factor of 0 there is no noise.
        let values = check::draw(&of, 40.0, check::SAMPLES, 3);
        assert!(values[12_000..].iter().all(|value| *value == 0.0) && values[7_999] != 0.0);
    }

    #[test]
    fn the_filters_gain_is_the_root_of_the_density() {
        let of = noise(&[(1.0, 4.0), (3.0, 0.5), (9.0, 2.0), (10.0, 1.0)]);
        let taps = taps(of.taps(40.0), |cycles| of.at(cycles * 40.0).sqrt());
        let (mut at_points, mut between): (f64, f64) = (0.0, 0.0);
        for step in 0..=1000 {
            let cycles = f64::from(step) / 2000.0;
            let middle = taps.len() / 2;
            let wave = |tap: usize| (TAU * cycles * (tap as f64 - middle as f64)).cos();
            let gain: f64 = taps.iter().enumerate().map(|(tap, weight)| weight * wave(tap)).sum();
            let off = (gain * gain / of.at(40.0 * cycles) - 1.0).abs();
            let is_near = of.density.iter().any(|point| (point.0 - 40.0 * cycles).abs() < 0.2);
            let worst = if is_near { &mut at_points } else { &mut between };
            *worst = worst.max(off);
        }
        // Lines bend at the points.
        assert!(at_points < 0.06 && between < 0.005, "{at_points} {between}");
    }

    #[test]
    fn the_closest_points_decide_how_many_taps_there_are() {
        assert_eq!(noise(&[(0.0, 1.0), (20.0, 1.0)]).taps(40.0), 64);
        assert_eq!(noise(&[(0.0, 1.0), (1.0, 2.0)]).taps(40.0), 1024);
        assert_eq!(noise(&[(0.0, 1.0), (1e-3, 2.0)]).taps(800.0), TAPS_MAX);
    }

    #[test]
    fn senseless_densities_are_refused() {
        let refused = |density: &[(f64, f64)]| noise(density).check(40.0).unwrap_err().parameter;
        assert_eq!(refused(&[(1.0, 1.0)]), "density");
        assert_eq!(refused(&[(1.0, 1.0), (1.0, 2.0)]), "density[1]");
        assert_eq!(refused(&[(1.0, 1.0), (2.0, -2.0)]), "density[1]");
        assert_eq!(refused(&[(1.0, 1.0), (20.1, 2.0)]), "density[1]");
        assert_eq!(noise(&[(1.0, 1.0), (20.0, 0.0)]).check(40.0), Ok(()));
    }
}
