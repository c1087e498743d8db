//! Bias of a triad's axes.

use super::{Axes, Drive, TriadEffect, diagonal, xyz};
use crate::effects::Stage;
use crate::effects::described::described;
use crate::effects::spec::{ANY, Parameter};
use imu_core::sample::Triad;

/// A constant per axis, beside each channel's own `bias`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bias {
    /// The constants, U.
    pub axes: Axes,
}

described! {
    Bias: dyn TriadEffect, 0, Stage::Bias;
    "a constant per axis";
    [
        Parameter::new("x", ANY, "U", "bias of the x axis, U"),
        Parameter::new("y", ANY, "U", "bias of the y axis, U"),
        Parameter::new("z", ANY, "U", "bias of the z axis, U"),
    ];
    |values| Bias { axes: values.axes() }, |of| xyz(of.axes)
}

impl TriadEffect for Bias {
    fn triads(&self) -> &'static [Triad] {
        &[Triad::Attitude, Triad::Mag, Triad::Accel, Triad::Gyro]
    }
    fn deviation(&self, _drive: Drive) -> Axes {
        self.axes
    }
    fn coefficients(&self) -> Vec<f64> {
        self.axes.to_vec()
    }
    fn regress(&self, _drive: Drive) -> Vec<Axes> {
        diagonal([1.0; 3])
    }
}
