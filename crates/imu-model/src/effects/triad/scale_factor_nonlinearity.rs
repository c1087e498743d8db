//! Scale-factor nonlinearity: the scale factor depends on the input.

use super::{Axes, Drive, TriadEffect, diagonal, xyz};
use crate::effects::Stage;
use crate::effects::described::described;
use crate::effects::spec::{ANY, Form, Parameter, above};

/// Each axis deviates by x·ω²/F or x·ω·|ω|/F: by a fraction x of full scale F at full scale.
///
/// Source: IEEE Std 528-2019 (scale-factor nonlinearity); the quadratic terms of IEEE Std 952-1997's model equation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaleFactorNonlinearity {
    /// Deviation at full scale over full scale, per axis.
    pub axes: Axes,
    /// Full scale F, U.
    pub full_scale: f64,
    /// Whether the deviation keeps the input's sign (ω·|ω|) or not (ω²).
    pub signed: bool,
}

described! {
    ScaleFactorNonlinearity: dyn TriadEffect, 0, Stage::Scale;
    "the deviation grows with the square of the input";
    [
        Parameter::new("x", ANY, "", "deviation of the x axis at full scale, a fraction of it"),
        Parameter::new("y", ANY, "", "deviation of the y axis at full scale, a fraction of it"),
        Parameter::new("z", ANY, "", "deviation of the z axis at full scale, a fraction of it"),
        Parameter::new("full_scale", above(0.0), "U", "U"),
        Parameter::new("form", Form::Choice(&["unsigned", "signed"]), "", "unsigned: ω²; signed: ω·|ω|"),
    ];
    |values| ScaleFactorNonlinearity {
        axes: values.axes(),
        full_scale: values.number("full_scale"),
        signed: values.word("form") == "signed",
    },
    |of| {
        let mut parameters = xyz(of.axes);
        parameters.push(("full_scale", of.full_scale.into()));
        parameters.push(("form", if of.signed { "signed" } else { "unsigned" }.into()));
        parameters
    }
}

impl ScaleFactorNonlinearity {
    fn squares(&self, input: Axes) -> Axes {
        input.map(|input| input * if self.signed { input.abs() } else { input } / self.full_scale)
    }
}

impl TriadEffect for ScaleFactorNonlinearity {
    fn deviation(&self, drive: Drive) -> Axes {
        let squares = self.squares(drive.input);
        std::array::from_fn(|axis| self.axes[axis] * squares[axis])
    }
    fn coefficients(&self) -> Vec<f64> {
        self.axes.to_vec()
    }
    fn regress(&self, drive: Drive) -> Vec<Axes> {
        diagonal(self.squares(drive.input))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_full_scale_the_deviation_is_the_fraction_of_full_scale() {
        let drive = Drive { input: [35.0, -35.0, 17.5], ..Drive::default() };
        let deviation = |signed| {
            ScaleFactorNonlinearity { axes: [1e-3; 3], full_scale: 35.0, signed }.deviation(drive).map(|d| d / 0.035)
        };
        assert_eq!(deviation(false), [1.0, 1.0, 0.25]);
        assert_eq!(deviation(true), [1.0, -1.0, 0.25]);
    }
}
