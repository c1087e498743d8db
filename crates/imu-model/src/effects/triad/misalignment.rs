//! Misalignment and cross-axis sensitivity: the two halves of a small matrix, antisymmetric and symmetric.

use super::{Axes, Drive, TriadEffect, xyz};
use crate::effects::Stage;
use crate::effects::described::{described, effect};
use crate::effects::spec::{ANY, Parameter};

/// The triad as a whole is turned by a small rotation vector θ: measured = true + θ × true.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misalignment {
    /// θ, rad.
    pub rotation: Axes,
}

effect! {
    /// Axes couple symmetrically: measured = true + S·true with S symmetric and zero on its diagonal. Together with
    /// misalignment, this describes the orthogonality errors of single axes.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct CrossAxisSensitivity: dyn TriadEffect, 0, Stage::CrossAxis;
    "axes show a fraction of one another, alike in both directions";
    xy: f64 = ANY, "", "what x shows of y, and y of x, a fraction";
    xz: f64 = ANY, "", "what x shows of z, and z of x, a fraction";
    yz: f64 = ANY, "", "what y shows of z, and z of y, a fraction";
}

described! {
    Misalignment: dyn TriadEffect, 0, Stage::CrossAxis;
    "the triad is turned by a small rotation vector θ: measured = true + θ × true";
    [
        Parameter::new("x", ANY, "rad", "rotation about the x axis, rad"),
        Parameter::new("y", ANY, "rad", "rotation about the y axis, rad"),
        Parameter::new("z", ANY, "rad", "rotation about the z axis, rad"),
    ];
    |values| Misalignment { rotation: values.axes() }, |of| xyz(of.rotation)
}

impl TriadEffect for Misalignment {
    fn deviation(&self, drive: Drive) -> Axes {
        let ([x, y, z], [a, b, c]) = (self.rotation, drive.input);
        [y * c - z * b, z * a - x * c, x * b - y * a]
    }
    fn coefficients(&self) -> Vec<f64> {
        self.rotation.to_vec()
    }
    fn regress(&self, drive: Drive) -> Vec<Axes> {
        let [a, b, c] = drive.input;
        vec![[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]]
    }
}

impl TriadEffect for CrossAxisSensitivity {
    fn deviation(&self, drive: Drive) -> Axes {
        let [a, b, c] = drive.input;
        [self.xy * b + self.xz * c, self.xy * a + self.yz * c, self.xz * a + self.yz * b]
    }
    fn coefficients(&self) -> Vec<f64> {
        vec![self.xy, self.xz, self.yz]
    }
    fn regress(&self, drive: Drive) -> Vec<Axes> {
        let [a, b, c] = drive.input;
        vec![[b, a, 0.0], [c, 0.0, a], [0.0, c, b]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_about_z_turns_x_towards_y() {
        let drive = Drive { input: [1.0, 0.0, 0.0], ..Drive::default() };
        assert_eq!(Misalignment { rotation: [0.0, 0.0, 0.01] }.deviation(drive), [0.0, 0.01, 0.0]);
    }

    #[test]
    fn both_axes_of_a_pair_show_the_same_fraction_of_one_another() {
        let cross = CrossAxisSensitivity { xy: 0.01, xz: 0.02, yz: 0.03 };
        let drive = |input| Drive { input, ..Drive::default() };
        assert_eq!(cross.deviation(drive([1.0, 0.0, 0.0])), [0.0, 0.01, 0.02]);
        assert_eq!(cross.deviation(drive([0.0, 1.0, 0.0])), [0.01, 0.0, 0.03]);
        assert_eq!(cross.deviation(drive([0.0, 0.0, 1.0])), [0.02, 0.03, 0.0]);
    }
}
