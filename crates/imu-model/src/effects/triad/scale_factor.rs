//! Scale factor error: an axis's output is a fixed fraction too large.

use super::{Axes, Drive, TriadEffect, diagonal, xyz};
use crate::effects::Stage;
use crate::effects::described::described;
use crate::effects::spec::{ANY, Parameter};

/// Each axis's output is (1 + s) times its input.
///
/// Source: IEEE Std 528-2019 (scale factor error).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaleFactor {
    /// s per axis, a fraction.
    pub axes: Axes,
}

described! {
    ScaleFactor: dyn TriadEffect, 0, Stage::Scale;
    "each axis shows a fixed fraction of its input too much";
    [
        Parameter::new("x", ANY, "", "fraction that the x axis shows too much"),
        Parameter::new("y", ANY, "", "fraction that the y axis shows too much"),
        Parameter::new("z", ANY, "", "fraction that the z axis shows too much"),
    ];
    |values| ScaleFactor { axes: values.axes() }, |of| xyz(of.axes)
}

impl TriadEffect for ScaleFactor {
    fn deviation(&self, drive: Drive) -> Axes {
        std::array::from_fn(|axis| self.axes[axis] * drive.input[axis])
    }
    fn coefficients(&self) -> Vec<f64> {
        self.axes.to_vec()
    }
    fn regress(&self, drive: Drive) -> Vec<Axes> {
        diagonal(drive.input)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_axis_shows_its_fraction_too_much() {
        let drive = Drive { input: [10.0, -10.0, 0.0], ..Drive::default() };
        let found = ScaleFactor { axes: [0.01, 0.02, 0.03] }.deviation(drive);
        assert_eq!(found, [0.1, -0.2, 0.0]);
    }
}
