//! The input of a simulated sensor: its motion and its temperature. Both come from outside, sample by sample.

use crate::effects::triad::Axes;

/// The input of the sensor at one internal sample, in its own axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Angular rate, rad/s.
    pub gyro_rad_s: Axes,
    /// Specific force, m/s².
    pub accel_m_s2: Axes,
    /// The sensor's temperature, °C, if it is known.
    pub temperature_c: Option<f64>,
}

/// A reference motion at the sensor's internal rate ([`super::Simulator::internal_rate_hz`]), from the first sample on.
///
/// Every iterator over [`Motion`] is a reference.
pub trait Reference: Send {
    /// Writes the next motions and returns how many there were: fewer than `motions.len()` only at the end.
    fn fill(&mut self, motions: &mut [Motion]) -> usize;
}

impl<I: Iterator<Item = Motion> + Send> Reference for I {
    fn fill(&mut self, motions: &mut [Motion]) -> usize {
        let mut count = 0;
        for (slot, motion) in motions.iter_mut().zip(self) {
            *slot = motion;
            count += 1;
        }
        count
    }
}

/// A temperature over time. Every function of time is such a course.
pub trait TemperatureCourse: Send {
    /// Returns the temperature at `time_s` after the start, °C; times do not run back.
    fn temperature_c(&mut self, time_s: f64) -> f64;
}

impl<F: FnMut(f64) -> f64 + Send> TemperatureCourse for F {
    fn temperature_c(&mut self, time_s: f64) -> f64 {
        self(time_s)
    }
}
