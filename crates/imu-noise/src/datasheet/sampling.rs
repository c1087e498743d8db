//! Sampling: the effect of the sensor's filter window and the choice of every n-th sample on a white noise density.
//!
//! The sensor averages W samples of its internal rate (register 85) and sends every n-th average. If averages do not
//! overlap enough to suppress faster noise, it folds into the band below half the output rate.

use crate::whittle::{self, density_factor};
use imu_core::sample::{FilterWindows, Triad};
use imu_core::units::IMU_RATE_HZ;
use serde::{Deserialize, Serialize};

/// Assumed sampling rate of the magnetometer, Hz; no document gives it. A unit's 200 Hz output without averaging has
/// 1.7e-3 to 2.4e-3 gauss; 140 µgauss/√Hz gives 2.0e-3 at 200 Hz and 4.0e-3 at 800 Hz.
const MAG_RATE_HZ: f64 = 200.0;

/// Returns the number of samples at the sensor's own rate per sent sample, if the rates fit.
pub(super) fn every(own_rate_hz: f64, rate_hz: f64) -> Option<u32> {
    whittle::Sampling { internal_rate_hz: own_rate_hz, window: 1, source: String::new() }.every(rate_hz)
}

/// How a capture's samples were made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Sampling {
    /// Sampling rate of accelerometer and gyroscope, Hz.
    pub internal_rate_hz: f64,
    /// Sampling rate of the magnetometer, Hz: inferred, because no document states it.
    pub mag_rate_hz: f64,
    /// Rate of the capture, Hz.
    pub rate_hz: f64,
    /// The windows of register 85.
    pub filter_window: FilterWindows,
    /// Whether the windows are the factory's because the capture does not have any.
    pub assumed: bool,
}

impl Sampling {
    /// Returns the sampling of a capture at `rate_hz`; with the windows of its register 85, else the factory's.
    pub fn new(rate_hz: f64, windows: Option<FilterWindows>) -> Self {
        Self {
            internal_rate_hz: IMU_RATE_HZ,
            mag_rate_hz: MAG_RATE_HZ,
            rate_hz,
            filter_window: windows.unwrap_or(FilterWindows::FACTORY),
            assumed: windows.is_none(),
        }
    }

    /// Returns the factor from the sensor's own white density to that of its output, at low frequencies.
    ///
    /// This is the [`density_factor`] of the triad's window and rates.
    pub fn density_factor(&self, triad: Triad) -> f64 {
        let window = match triad {
            Triad::Gyro => self.filter_window.gyro,
            Triad::Accel => self.filter_window.accel,
            Triad::Mag => self.filter_window.mag,
            Triad::Attitude => 1,
        };
        let own_rate_hz = if triad == Triad::Mag { self.mag_rate_hz } else { self.internal_rate_hz };
        // A VN-100 only sends at its own rate divided by whole numbers. The exception is the magnetometer, whose rate
        // is inferred.
        let nearest = || (own_rate_hz / self.rate_hz).round().clamp(1.0, 1e5) as u32;
        density_factor(window, every(own_rate_hz, self.rate_hz).unwrap_or_else(nearest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn factor(rate_hz: f64, window: u32) -> f64 {
        let windows = FilterWindows { mag: 0, accel: window, gyro: window };
        Sampling::new(rate_hz, Some(windows)).density_factor(Triad::Gyro)
    }

    #[test]
    fn the_factory_window_at_forty_hertz_shows_more_than_twice_the_density() {
        assert!((factor(40.0, 4) - 5f64.sqrt()).abs() < 1e-12);
        for (rate, window, expected) in
            [(40.0, 1, 4.472), (40.0, 5, 2.0), (200.0, 4, 1.0), (100.0, 4, 1.414), (40.0, 20, 1.0)]
        {
            assert!((factor(rate, window) - expected).abs() < 1e-3, "{rate} {window}: {}", factor(rate, window));
        }
        // A window longer than the output period leaves low frequencies unchanged.
        assert!((factor(800.0, 4) - 1.0).abs() < 1e-12);
        assert!((factor(200.0, 8) - 1.0).abs() < 1e-12);
        assert!((Sampling::new(40.0, None).density_factor(Triad::Mag) - 5f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn the_factor_is_that_of_simulated_white_noise() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let white: Vec<f64> = (0..4_000_000).map(|_| StandardNormal.sample(&mut rng)).collect();
        // Every 20th mean of 4: its variance times the output period, compared with the internal one.
        let means: Vec<f64> = white.chunks_exact(20).map(|chunk| chunk[..4].iter().sum::<f64>() / 4.0).collect();
        let variance = means.iter().map(|mean: &f64| mean * mean).sum::<f64>() / means.len() as f64;
        let seen = (variance / 40.0 * 800.0).sqrt();
        assert!((seen / factor(40.0, 4) - 1.0).abs() < 0.01, "{seen}");
    }
}
