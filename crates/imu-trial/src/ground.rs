//! Ground: the noise and the temperature that a sealed case has beneath its effects. The code is separate from the
//! library under test.
//!
//! White noise and random walk are drawn sample by sample. Noise with a power of the frequency is made in the frequency domain on
//! a circle more than twice as long as the record, and the record is a part of that circle. Its spectrum holds from half the rate
//! down to less than one period of the record.

use super::draw::Draw;
use realfft::RealFftPlanner;
use realfft::num_complex::Complex;
use serde::Serialize;

/// Minimum ratio of the circle's length to the record's.
const CIRCLE: f64 = 2.5;

/// Returns `samples` of Gaussian noise whose two-sided density per sample is `power_at(f)`, with f in cycles per sample
/// in (0, ½].
pub fn coloured(samples: usize, draw: &mut Draw, power_at: impl Fn(f64) -> f64) -> Vec<f64> {
    let length = even_smooth((samples as f64 * CIRCLE) as usize);
    let mut planner = RealFftPlanner::<f64>::new();
    let inverse = planner.plan_fft_inverse(length);
    let mut spectrum = inverse.make_input_vec();
    for (index, bin) in spectrum.iter_mut().enumerate().skip(1) {
        // An unnormalised inverse transform: each pair of bins carries 2 S/length of the variance.
        let spread = (power_at(index as f64 / length as f64) / length as f64).sqrt();
        *bin = Complex::new(spread * draw.normal(), spread * draw.normal()) * std::f64::consts::FRAC_1_SQRT_2;
    }
    if let Some(last) = spectrum.last_mut() {
        *last = Complex::new(last.re * std::f64::consts::SQRT_2, 0.0);
    }
    let mut made = inverse.make_output_vec();
    // The lengths are the plan's own.
    let _ = inverse.process(&mut spectrum, &mut made);
    let from = draw.whole(0, length - samples);
    made[from..from + samples].to_vec()
}

/// Returns flicker noise of `level` b: density b²/(2πf).
pub fn flicker(samples: usize, level: f64, draw: &mut Draw) -> Vec<f64> {
    coloured(samples, draw, |cycles| level * level / (std::f64::consts::TAU * cycles))
}

/// Returns the next even length whose factors are 2, 3 and 5.
fn even_smooth(least: usize) -> usize {
    let smooth = |length: &usize| {
        let mut rest = *length;
        for factor in [2, 3, 5] {
            while rest.is_multiple_of(factor) {
                rest /= factor;
            }
        }
        rest == 1
    };
    (least.max(8)..).filter(|length| length.is_multiple_of(2)).find(smooth).unwrap_or(least)
}

/// The course of the sensor's temperature: it rises to a level as after switching on, and wanders.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TemperatureCourse {
    /// Temperature at the beginning, °C.
    pub start_c: f64,
    /// The rise, K.
    pub rise_c: f64,
    /// The time constant of the rise, as a part of the record.
    pub settles: f64,
    /// Standard deviation of the wander, K.
    pub wander_c: f64,
}

impl TemperatureCourse {
    /// Draws a course as in the study, at other room temperatures.
    pub fn draw(device: &mut Draw) -> Self {
        Self {
            start_c: device.uniform(14.0, 31.0),
            rise_c: device.uniform(4.0, 12.0),
            settles: device.uniform(0.08, 0.3),
            wander_c: device.uniform(0.8, 2.0),
        }
    }

    /// Returns the expected standard deviation over the record, K.
    pub fn spread_c(&self) -> f64 {
        let mean = self.settles * (1.0 - (-1.0 / self.settles).exp());
        let square = 0.5 * self.settles * (1.0 - (-2.0 / self.settles).exp());
        (self.rise_c * self.rise_c * (square - mean * mean) + self.wander_c * self.wander_c).sqrt()
    }

    /// Returns the true temperature at every sample, °C: smooth over some thirtieths of the record.
    pub fn samples(&self, samples: usize, draw: &mut Draw) -> Vec<f64> {
        let pole = 1.0 - 30.0 / samples as f64;
        let (mut walk, mut smooth) = (0.0, 0.0);
        let mut wander: Vec<f64> = (0..samples)
            .map(|_| {
                walk += draw.normal();
                smooth += (1.0 - pole) * (walk - smooth);
                smooth
            })
            .collect();
        let count = samples as f64;
        // Without most of its trend, which the rise already has.
        let slope = 0.7 * wander.last().copied().unwrap_or(0.0) / count;
        wander.iter_mut().enumerate().for_each(|(index, value)| *value -= slope * index as f64);
        let mean = wander.iter().sum::<f64>() / count;
        let square = wander.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / count;
        let size = self.wander_c / square.sqrt().max(f64::MIN_POSITIVE);
        let rise = |index: usize| self.rise_c * (1.0 - (-(index as f64) / (self.settles * count)).exp());
        wander.iter().enumerate().map(|(index, value)| self.start_c + rise(index) + size * (value - mean)).collect()
    }
}

/// Returns the temperature as a sensor reports it: with a little noise, in steps of 0.1 °C.
pub fn as_read(temperature_c: &[f64], draw: &mut Draw) -> Vec<f64> {
    temperature_c.iter().map(|value| ((value + 0.02 * draw.normal()) * 10.0).round() / 10.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns half the mean square of the difference of neighbouring means of `m` samples.
    fn allan_variance(values: &[f64], m: usize) -> f64 {
        let means: Vec<f64> = values.chunks_exact(m).map(|chunk| chunk.iter().sum::<f64>() / m as f64).collect();
        let steps = means.windows(2).map(|two| (two[1] - two[0]).powi(2));
        0.5 * steps.sum::<f64>() / (means.len() - 1) as f64
    }

    #[test]
    fn flicker_has_its_flat_allan_variance() {
        let expected = 2.0 * std::f64::consts::LN_2 / std::f64::consts::PI;
        for m in [16, 64, 256] {
            let of = |seed| allan_variance(&flicker(40_001, 1.0, &mut Draw::device(seed, 1, "flicker")), m);
            let mean = (0..30).map(of).sum::<f64>() / 30.0;
            assert!((mean / expected - 1.0).abs() < 0.08, "m {m}: {mean} for {expected}");
        }
    }

    #[test]
    fn coloured_noise_has_its_variance() {
        let of = |seed| {
            let made = coloured(10_001, &mut Draw::device(seed, 1, "white"), |_| 4.0);
            made.iter().map(|value| value * value).sum::<f64>() / made.len() as f64
        };
        let mean = (0..20).map(of).sum::<f64>() / 20.0;
        assert!((mean - 4.0).abs() < 0.06, "{mean}");
    }

    #[test]
    fn temperature_rises_and_wanders_as_much_as_stated() {
        let mut squares = (0.0, 0.0);
        for seed in 0..40 {
            let mut device = Draw::device(seed, 1, "temperature");
            let course = TemperatureCourse::draw(&mut device);
            let made = course.samples(30_001, &mut device);
            let mean = made.iter().sum::<f64>() / made.len() as f64;
            squares.0 += made.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / made.len() as f64;
            squares.1 += course.spread_c().powi(2);
            assert!(
                as_read(&made, &mut device).iter().all(|value| ((value * 10.0).round() - value * 10.0).abs() < 1e-9)
            );
        }
        assert!((squares.0 / squares.1 - 1.0).abs() < 0.35, "{squares:?}");
    }
}
