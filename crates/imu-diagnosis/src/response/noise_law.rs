//! The noise's law in the cosine transform: the weight of every coefficient of a record.
//!
//! From the second coefficient on, noise of spectrum S is uncorrelated there with variance rate·S(f_k) ([`Cosines`]).
//! For flicker, the lowest coefficients have less variance, by a share of 2/(π²k) (within 3 % of the integral over its
//! spectrum). The first coefficient, the record's mean, determines a bias, and a spectrum does not determine the mean's
//! variance:
//!
//! * White and other stationary noise of finite density at 0 gives it rate·S(0).
//! * A random walk that starts at 0, as the simulator's does, gives it (n − 1)(2n − 1)/6 steps' variance, and
//!   correlates it with all others. That correlation is used: bias is then the level from which the walk starts, at the
//!   record's first sample, not the level halfway through it.
//! * Flicker's mean wanders without bound the further down its spectrum goes. Here the spectrum ends at 1/32 of one
//!   over the record's length, between the simulator's 1/16 and 1/64 ([`imu_model::effects::flicker`]): a variance of
//!   1.13 B².
//!
//! [`Cosines`]: crate::transform::Cosines

use super::ResponseError;
use imu_core::sample::{Channel, Triad};
use imu_model::effects::Record;
use imu_model::effects::triad::Axes;
use imu_model::simulator::{SensorModel, Spectrum};
use std::f64::consts::{PI, SQRT_2};

/// The frequency, times the record's length, at which flicker's spectrum ends and below which stationary noise is flat.
const LOWEST: f64 = 1.0 / 32.0;
/// Euler's constant.
const EULER_GAMMA: f64 = 0.577_215_664_901_532_9;
/// Minimum share of the mean's variance that the other coefficients leave: a bound on rounding if there is no white
/// noise.
const LEAST_SHARE: f64 = 1e-9;

/// Noise of a triad's three axes in records of one length.
#[derive(Debug, Clone)]
pub struct NoiseLaw {
    pub(super) axes: [AxisLaw; 3],
}

/// Noise of one axis.
#[derive(Debug, Clone)]
pub(super) struct AxisLaw {
    /// √variance of each coefficient; for the first, given all others.
    deviations: Vec<f64>,
    /// The mean's regression on the other coefficients; empty if there is none. The first place is unused.
    coupling: Vec<f64>,
}

impl NoiseLaw {
    /// Returns the law of `triad` in a sensor model, for records of `samples` samples at `rate_hz`: its N, B and K, its
    /// stationary effects, its bandwidth and sampling. Lines (tones) are not part of it.
    ///
    /// # Errors
    /// [`ResponseError::NoDensity`] if a channel is missing or has noise whose density does not follow from its
    /// parameters alone, [`ResponseError::Density`] for a density that is not above 0.
    pub fn of_model(model: &SensorModel, triad: Triad, rate_hz: f64, samples: usize) -> Result<Self, ResponseError> {
        let record = Record { rate_hz, samples: samples as u64 };
        // Without B and K the density has a value at 0.
        let mut stationary = model.clone();
        for channel in triad.channels() {
            if let Some(of) = stationary.channels.get_mut(&channel) {
                (of.b, of.k) = (0.0, 0.0);
            }
        }
        let [x, y, z] = triad.channels().map(|channel| {
            let none = ResponseError::NoDensity { channel };
            let Some(of) = model.channels.get(&channel) else { return Err(none) };
            let spectrum = Spectrum::new(model, channel, record);
            let frequency_hz = |place: usize| 0.5 * rate_hz * place as f64 / samples as f64;
            let densities: Option<Vec<f64>> = (1..samples).map(|place| spectrum.psd(frequency_hz(place))).collect();
            let at_zero = Spectrum::new(&stationary, channel, record).psd(LOWEST / record.length_s());
            let (Some(densities), Some(at_zero)) = (densities, at_zero) else { return Err(none) };
            AxisLaw::new(channel, rate_hz, &densities, at_zero, of.b, of.k)
        });
        Ok(Self { axes: [x?, y?, z?] })
    }

    /// Returns the number of samples in a record.
    pub fn samples(&self) -> usize {
        self.axes[0].deviations.len()
    }

    /// Returns the standard deviation of each axis's white noise in single samples, U.
    pub fn sample_deviations(&self) -> Axes {
        self.axes.each_ref().map(AxisLaw::sample_deviation)
    }
}

impl AxisLaw {
    fn new(
        channel: Channel,
        rate_hz: f64,
        densities: &[f64],
        at_zero: f64,
        b: f64,
        k: f64,
    ) -> Result<Self, ResponseError> {
        let samples = densities.len() + 1;
        let frequency_hz = |place: usize| 0.5 * rate_hz * place as f64 / samples as f64;
        let wrong = |frequency_hz, found| ResponseError::Density { channel, frequency_hz, found };
        if let Some(place) = densities.iter().position(|density| !(density.is_finite() && *density > 0.0)) {
            return Err(wrong(frequency_hz(place + 1), densities[place]));
        }
        let n = samples as f64;
        let step = k * k / rate_hz;
        let walk = step * (n - 1.0) * (2.0 * n - 1.0) / 6.0;
        // ∫ B²/(2πf)·sinc²(πfT) df on both sides down to the lowest frequency, constant below, in coefficients (× n).
        let flicker = n * b * b / PI * (2.5 - EULER_GAMMA - (2.0 * PI * LOWEST).ln());
        let total = rate_hz * at_zero + walk + flicker;
        if !(total.is_finite() && total > 0.0) {
            return Err(wrong(0.0, total / rate_hz));
        }
        let mut deviations = Vec::with_capacity(samples);
        deviations.push(0.0);
        deviations.extend(densities.iter().enumerate().map(|(place, density)| {
            let k = (place + 1) as f64;
            let (whole, lacking) = (rate_hz * density, 2.0 * n * b * b / (PI.powi(3) * k * k));
            (whole - lacking.min(0.5 * whole)).sqrt()
        }));
        let mut coupling = Vec::new();
        let mut explained = 0.0;
        if step > 0.0 {
            coupling.push(0.0);
            for (place, deviation) in deviations.iter().enumerate().skip(1) {
                let (sine, cosine) = (PI * place as f64 / (2.0 * n)).sin_cos();
                let covariance = -step * SQRT_2 / 4.0 * cosine / (sine * sine);
                let slope = covariance / (deviation * deviation);
                explained += slope * covariance;
                coupling.push(slope);
            }
        }
        deviations[0] = (total - explained).max(LEAST_SHARE * total).sqrt();
        Ok(Self { deviations, coupling })
    }

    /// Returns the deviation in single samples of white noise with the density at high frequencies, U.
    pub(super) fn sample_deviation(&self) -> f64 {
        let upper = &self.deviations[self.deviations.len() / 2..];
        (upper.iter().map(|deviation| deviation * deviation).sum::<f64>() / upper.len().max(1) as f64).sqrt()
    }

    /// Turns coefficients into uncorrelated ones of variance 1, in place.
    pub(super) fn whiten(&self, coefficients: &mut [f64]) {
        let explained: f64 = self.coupling.iter().zip(&*coefficients).map(|(slope, value)| slope * value).sum();
        coefficients[0] -= explained;
        for (value, deviation) in coefficients.iter_mut().zip(&self.deviations) {
            *value /= deviation;
        }
    }

    /// Applies the transpose of [`AxisLaw::whiten`], in place.
    pub(super) fn whiten_transposed(&self, values: &mut [f64]) {
        for (value, deviation) in values.iter_mut().zip(&self.deviations) {
            *value /= deviation;
        }
        let mean = values[0];
        for (value, slope) in values.iter_mut().zip(&self.coupling) {
            *value -= slope * mean;
        }
    }

    /// Applies the inverse of [`AxisLaw::whiten_transposed`], in place.
    pub(super) fn colour_transposed(&self, values: &mut [f64]) {
        let mean = values[0];
        for (value, slope) in values.iter_mut().zip(&self.coupling) {
            *value += slope * mean;
        }
        for (value, deviation) in values.iter_mut().zip(&self.deviations) {
            *value *= deviation;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transform::Cosines;
    use imu_model::effects::{Effect, Flicker, RandomWalk, Sampler, Stream, StreamId, White};
    use imu_model::simulator::ChannelModel;

    fn model(n: f64, b: f64, k: f64) -> SensorModel {
        let channels = Triad::Gyro.channels();
        let of = ChannelModel { n, b, k, ..ChannelModel::default() };
        SensorModel {
            name: "test".into(),
            rate_hz: 20.0,
            channels: channels.into_iter().map(|channel| (channel, of.clone())).collect(),
            ..SensorModel::default()
        }
    }

    fn noise(n: f64, b: f64, k: f64, samples: usize, seed: u64) -> Vec<f64> {
        let mut values = vec![0.0; samples];
        let parts: [Box<dyn Effect>; 3] = [Box::new(White { n }), Box::new(Flicker { b }), Box::new(RandomWalk { k })];
        for (instance, part) in parts.iter().enumerate() {
            let stream = Stream::new(seed, StreamId { owner: 1, effect: 99, instance: instance as u16 });
            let mut sampler: Box<dyn Sampler> = part.sampler(20.0, samples as f64 / 20.0, stream);
            sampler.apply(&mut values);
        }
        values
    }

    /// Returns the mean square of the first whitened coefficient and of the next three, over 1500 records.
    fn first_four(n: f64, b: f64, k: f64) -> [f64; 4] {
        let (samples, seeds) = (401, 1500);
        let law = NoiseLaw::of_model(&model(n, b, k), Triad::Gyro, 20.0, samples).unwrap();
        let mut cosines = Cosines::new(samples);
        let mut squares = [0.0; 4];
        for seed in 0..seeds {
            let mut values = noise(n, b, k, samples, seed);
            cosines.forward(&mut values);
            law.axes[0].whiten(&mut values);
            for (square, value) in squares.iter_mut().zip(&values) {
                *square += value * value / seeds as f64;
            }
        }
        squares
    }

    #[test]
    fn the_lowest_coefficients_of_simulated_noise_have_variance_one() {
        // One standard error of a mean square over 1500 records is 3.7 %; flicker's mean is only as exact as its lowest
        // frequency.
        for (n, b, k, mean) in
            [(1.0, 0.0, 0.0, 0.15), (1.0, 0.0, 0.3, 0.15), (0.1, 0.0, 2.0, 0.15), (1.0, 1.0, 0.05, 0.35)]
        {
            let found = first_four(n, b, k);
            assert!((found[0] - 1.0).abs() < mean, "mean under {n} {b} {k}: {found:?}");
            for square in &found[1..] {
                assert!((square - 1.0).abs() < 0.15, "under {n} {b} {k}: {found:?}");
            }
        }
    }

    #[test]
    fn colouring_undoes_whitening() {
        let law = NoiseLaw::of_model(&model(1.0, 0.5, 0.7), Triad::Gyro, 20.0, 7).unwrap();
        let values: Vec<f64> = (0..7).map(|place| f64::from(place * place) - 3.0).collect();
        let mut found = values.clone();
        law.axes[1].whiten_transposed(&mut found);
        law.axes[1].colour_transposed(&mut found);
        for (found, value) in found.iter().zip(&values) {
            assert!((found - value).abs() < 1e-12);
        }
    }

    #[test]
    fn a_record_without_noise_and_one_without_density_are_refused() {
        let none = NoiseLaw::of_model(&model(0.0, 0.0, 0.0), Triad::Gyro, 20.0, 64).unwrap_err();
        assert!(matches!(none, ResponseError::Density { channel: Channel::GyroX, .. }), "{none}");
        let missing = NoiseLaw::of_model(&model(1.0, 0.0, 0.0), Triad::Accel, 20.0, 64).unwrap_err();
        assert_eq!(missing, ResponseError::NoDensity { channel: Channel::AccelX });
    }
}
