//! Rectification: vibration shifts the level.

use super::{Axes, Drive, TriadEffect, diagonal, xyz};
use crate::effects::Stage;
use crate::effects::described::described;
use crate::effects::spec::{ANY, Parameter};

/// Time constant of the mean square of the vibration, s: long compared with a vibration's period, short compared with how long a
/// machine runs.
pub const VIBRATION_S: f64 = 1.0;

/// Each axis's level moves by x·v, with v the mean square of the vibration along it.
///
/// The specific force f less its mean m is vibration, and v is the mean of its square. Both means are lags of first order with
/// the time constant τ = [`VIBRATION_S`]: m′ = (f − m)/τ, v′ = ((f − m)² − v)/τ, from m = f and v = 0 on ([`Vibration`]). A sine of
/// amplitude A has v = A²/2·(ωτ)²/(1 + (ωτ)²) on average.
///
/// Source: IEEE Std 528-2019 and 1293-2018 (vibration rectification error of accelerometers), IEEE Std 952-2020 and 1431-2004 (of
/// gyroscopes): the shift of the output over the mean square of the vibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectification {
    /// Shift per axis over the mean square of the vibration, U/(m/s²)².
    pub axes: Axes,
}

described! {
    Rectification: dyn TriadEffect, 0, Stage::Bias;
    "vibration shifts the level, by its mean square";
    [
        Parameter::new("x", ANY, "U/(m/s²)²", "shift of the x axis, U per (m/s²)² of vibration along it"),
        Parameter::new("y", ANY, "U/(m/s²)²", "shift of the y axis, U per (m/s²)² of vibration along it"),
        Parameter::new("z", ANY, "U/(m/s²)²", "shift of the z axis, U per (m/s²)² of vibration along it"),
    ];
    |values| Rectification { axes: values.axes() }, |of| xyz(of.axes)
}

impl TriadEffect for Rectification {
    fn deviation(&self, drive: Drive) -> Axes {
        std::array::from_fn(|axis| self.axes[axis] * drive.vibration_m2_s4[axis])
    }
    fn coefficients(&self) -> Vec<f64> {
        self.axes.to_vec()
    }
    fn regress(&self, drive: Drive) -> Vec<Axes> {
        diagonal(drive.vibration_m2_s4)
    }
}

/// The mean square of the vibration along each axis, sample by sample ([`Rectification`]).
#[derive(Debug, Clone)]
pub struct Vibration {
    /// The part of its distance that a mean covers in a sample.
    share: f64,
    /// What was seen last, once a force was given.
    last: Option<Seen>,
}

/// The specific force at an instant, its mean, and the mean square of what it is beyond that.
#[derive(Debug, Clone, Copy)]
struct Seen {
    force: Axes,
    mean: Axes,
    square: Axes,
}

impl Vibration {
    /// Begins without vibration.
    pub fn new(rate_hz: f64) -> Self {
        Self { share: -(-1.0 / (VIBRATION_S * rate_hz)).exp_m1(), last: None }
    }

    /// Returns the mean square of the vibration with a further specific force, (m/s²)². Between two instants the means follow the middle
    /// of both, so that the rate of the instants matters to second order only.
    pub fn next(&mut self, accel_m_s2: Axes) -> Axes {
        let before = self.last.unwrap_or(Seen { force: accel_m_s2, mean: accel_m_s2, square: [0.0; 3] });
        let mut now = Seen { force: accel_m_s2, ..before };
        for axis in 0..3 {
            let middle = f64::midpoint(before.force[axis], now.force[axis]);
            now.mean[axis] += self.share * (middle - before.mean[axis]);
            let [was, is] = [before, now].map(|of| (of.force[axis] - of.mean[axis]).powi(2));
            now.square[axis] += self.share * (f64::midpoint(was, is) - before.square[axis]);
        }
        self.last = Some(now);
        now.square
    }

    /// Returns the present mean square, (m/s²)².
    pub fn now(&self) -> Axes {
        self.last.map_or([0.0; 3], |of| of.square)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_has_half_the_square_of_its_amplitude_at_any_rate() {
        for rate_hz in [200.0, 1000.0] {
            let mut vibration = Vibration::new(rate_hz);
            let turn = std::f64::consts::TAU * 20.0;
            let force = |t: usize| [3.0 * (turn * t as f64 / rate_hz).sin(), 5.0, 0.0];
            let count = (20.0 * rate_hz) as usize;
            let shown: Vec<Axes> = (0..count).map(|t| vibration.next(force(t))).collect();
            let from = count / 2;
            let mean = shown[from..].iter().map(|of| of[0]).sum::<f64>() / (count - from) as f64;
            let expected = 4.5 * turn.powi(2) / (1.0 + turn.powi(2));
            assert!((mean / expected - 1.0).abs() < 0.01, "{rate_hz}: {mean} {expected}");
            assert!(shown.iter().all(|of| of[1] == 0.0 && of[2] == 0.0));
            // After a time constant the mean square has come near, after some it is there.
            assert!(shown[rate_hz as usize][0] < 0.8 * expected, "{}", shown[rate_hz as usize][0]);
        }
    }

    #[test]
    fn a_slow_turn_has_the_same_mean_square_at_any_rate() {
        let turned = |rate_hz: f64| {
            let mut vibration = Vibration::new(rate_hz);
            let force = |t: f64| [9.8 * (0.5 * t).sin(), 9.8 * (0.5 * t).cos(), 3.0 * t.min(2.0)];
            let last = (6.0 * rate_hz) as usize;
            (0..=last).map(|t| vibration.next(force(t as f64 / rate_hz))).last().unwrap()
        };
        let (fine, coarse) = (turned(800.0), turned(40.0));
        for (fine, coarse) in fine.into_iter().zip(coarse) {
            assert!((coarse / fine - 1.0).abs() < 1e-3, "{fine} {coarse}");
        }
    }

    #[test]
    fn the_level_moves_with_the_mean_square_along_each_axis() {
        let drive = Drive { vibration_m2_s4: [2.0, 0.0, 10.0], ..Drive::default() };
        assert_eq!(Rectification { axes: [1e-4, 5.0, -1e-3] }.deviation(drive), [2e-4, 0.0, -1e-2]);
    }
}
