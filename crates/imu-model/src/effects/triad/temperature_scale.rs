//! Temperature scale: a scale factor that follows the sensor's temperature.

use super::{Axes, Drive, TriadEffect, diagonal, xyz};
use crate::effects::described::described;
use crate::effects::spec::{ANY, Need, Parameter, above};
use crate::effects::{Stage, USUAL_TEMPERATURE_C};

/// Each axis's output is x·(T − `reference_c`) of its input too large.
///
/// Source: IEEE Std 528-2019 (scale factor, its temperature sensitivity).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TemperatureScale {
    /// Fraction per °C, per axis.
    pub axes: Axes,
    /// The temperature at which it vanishes, °C.
    pub reference_c: f64,
}

described! {
    TemperatureScale: dyn TriadEffect, 0, Stage::Scale;
    "the scale factor follows the sensor's temperature";
    [
        Parameter::new("x", ANY, "1/°C", "fraction per °C that the x axis shows too much"),
        Parameter::new("y", ANY, "1/°C", "fraction per °C that the y axis shows too much"),
        Parameter::new("z", ANY, "1/°C", "fraction per °C that the z axis shows too much"),
        Parameter::new("reference_c", above(-273.15), "°C", "the temperature at which it vanishes, °C")
            .needed(Need::Default(USUAL_TEMPERATURE_C)),
    ];
    |values| TemperatureScale { axes: values.axes(), reference_c: values.number("reference_c") },
    |of| {
        let mut parameters = xyz(of.axes);
        parameters.push(("reference_c", of.reference_c.into()));
        parameters
    }
}

impl TemperatureScale {
    /// Returns the input times how much warmer it is than at the reference; 0 if the temperature is unknown.
    fn warmed(&self, drive: Drive) -> Axes {
        let warmer_c = drive.temperature_c.map_or(0.0, |temperature_c| temperature_c - self.reference_c);
        drive.input.map(|input| warmer_c * input)
    }
}

impl TriadEffect for TemperatureScale {
    fn deviation(&self, drive: Drive) -> Axes {
        let warmed = self.warmed(drive);
        std::array::from_fn(|axis| self.axes[axis] * warmed[axis])
    }
    fn coefficients(&self) -> Vec<f64> {
        self.axes.to_vec()
    }
    fn regress(&self, drive: Drive) -> Vec<Axes> {
        diagonal(self.warmed(drive))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_factor_moves_with_the_temperature() {
        let effect = TemperatureScale { axes: [1e-4, 0.0, -2e-4], reference_c: 25.0 };
        let at =
            |temperature_c| effect.deviation(Drive { input: [10.0, 10.0, 5.0], temperature_c, ..Drive::default() });
        let found = at(Some(35.0));
        assert!((found[0] - 0.01).abs() < 1e-15 && found[1] == 0.0 && (found[2] + 0.01).abs() < 1e-15, "{found:?}");
        assert_eq!(at(Some(25.0)), [0.0, 0.0, -0.0]);
        assert_eq!(at(None), [0.0, 0.0, -0.0]);
    }
}
