//! g-sensitivity: the response of gyroscopes to acceleration.

use super::{Axes, Drive, TriadEffect};
use crate::effects::Stage;
use crate::effects::described::effect;
use crate::effects::spec::Form;
use imu_core::sample::Triad;

effect! {
    /// The gyroscope's output increases by M·a, with a the specific force.
    ///
    /// Source: IEEE Std 528-2019 (acceleration-sensitive drift rate).
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct GSensitivity: dyn TriadEffect, 0, Stage::Bias;
    "gyroscopes show a part of the specific force; on the gyro triad";
    m: [Axes; 3] = Form::Matrix, "(rad/s)/(m/s²)", "row: gyro axis, column: acceleration axis; (rad/s)/(m/s²)";
}

impl TriadEffect for GSensitivity {
    fn triads(&self) -> &'static [Triad] {
        &[Triad::Gyro]
    }
    fn deviation(&self, drive: Drive) -> Axes {
        self.m.map(|row| row.iter().zip(drive.accel_m_s2).map(|(m, a)| m * a).sum())
    }
    /// Returns the matrix, row by row.
    fn coefficients(&self) -> Vec<f64> {
        self.m.concat()
    }
    fn regress(&self, drive: Drive) -> Vec<Axes> {
        let column = |row: usize, a: f64| {
            let mut axes = [0.0; 3];
            axes[row] = a;
            axes
        };
        (0..3).flat_map(|row| drive.accel_m_s2.map(|a| column(row, a))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_gyro_axes_and_columns_acceleration_axes() {
        let effect = GSensitivity { m: [[0.0, 1e-4, 0.0], [0.0; 3], [2e-4, 0.0, 0.0]] };
        let found = effect.deviation(Drive { input: [5.0; 3], accel_m_s2: [1.0, 10.0, 100.0], ..Drive::default() });
        assert_eq!(found, [1e-3, 0.0, 2e-4]);
    }
}
