//! Saturation of a triad: the same range on each axis.

use super::TriadEffect;
use crate::effects::Stage;
use crate::effects::described::effect;
use crate::effects::spec::above;
use imu_core::sample::Triad;

effect! {
    /// No axis's output exceeds ± the range, motion and noise alike.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Saturation: dyn TriadEffect, 0, Stage::Saturation;
    "values beyond ± the range become its ends";
    range: f64 = above(0.0), "U", "largest magnitude that an axis shows, U";
}

impl TriadEffect for Saturation {
    fn triads(&self) -> &'static [Triad] {
        &[Triad::Attitude, Triad::Mag, Triad::Accel, Triad::Gyro]
    }
    fn range(&self) -> Option<f64> {
        Some(self.range)
    }
}
