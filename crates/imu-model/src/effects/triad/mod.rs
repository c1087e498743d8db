//! Effects on a triad: the response of its axes to a motion. They are deterministic and use no random numbers.
//!
//! In: the triad's input (rad/s or m/s²), the specific force and its vibration, in the sensor's axes, and the temperature. Out: the triad's deviation
//! from its input, and its derivatives by the parameters in which it is linear, on which a diagnosis regresses.
//!
//! Within a stage every effect sees the same input and their contributions are summed: misalignment and cross-axis
//! sensitivity together are the matrix 1 + θ× + S, for any order in a file.

pub mod bias;
pub mod g_sensitivity;
pub mod latency;
pub mod misalignment;
pub mod rectification;
pub mod saturation;
pub mod scale_factor;
pub mod scale_factor_nonlinearity;
pub mod temperature_scale;

pub use bias::Bias;
pub use g_sensitivity::GSensitivity;
pub use latency::{DelayLine, Latency};
pub use misalignment::{CrossAxisSensitivity, Misalignment};
pub use rectification::{Rectification, Vibration};
pub use saturation::Saturation;
pub use scale_factor::ScaleFactor;
pub use scale_factor_nonlinearity::ScaleFactorNonlinearity;
pub use temperature_scale::TemperatureScale;

use super::{Described, Refusal};
use imu_core::sample::Triad;
use serde_json::Value;

/// A value per axis.
pub type Axes = [f64; 3];

/// The inputs of a triad's effects at an instant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Drive {
    /// The triad's own input: angular rate in rad/s or specific force in m/s².
    pub input: Axes,
    /// Specific force, m/s².
    pub accel_m_s2: Axes,
    /// Mean square of the vibration, (m/s²)² ([`Vibration`]).
    pub vibration_m2_s4: Axes,
    /// The sensor's temperature, °C, if it is known.
    pub temperature_c: Option<f64>,
}

/// One error source of a triad. U is the unit of its channels.
pub trait TriadEffect: Described + std::fmt::Debug + Send + Sync {
    /// Returns the triads on which the effect makes sense: those that a motion drives, if the effect needs one.
    fn triads(&self) -> &'static [Triad] {
        &[Triad::Accel, Triad::Gyro]
    }

    /// Checks whether the parameters are in their ranges and the effect may stand on this triad.
    ///
    /// # Errors
    /// [`Refusal`] with the parameter, the value found and the values allowed.
    fn check(&self, triad: Triad) -> Result<(), Refusal> {
        if !self.triads().contains(&triad) {
            let allowed = self.triads().iter().map(|triad| triad.name()).collect::<Vec<_>>().join(" or ");
            return Err(self.spec().refuse("effect", format!("`{}` on {}", self.name(), triad.name()), allowed));
        }
        self.spec().check(&self.parameters())
    }

    /// Returns the triad's deviation from its input, for memoryless effects; 0 for the others.
    fn deviation(&self, drive: Drive) -> Axes {
        let _ = drive;
        [0.0; 3]
    }

    /// Returns the parameters in which the deviation is linear.
    fn coefficients(&self) -> Vec<f64> {
        Vec::new()
    }

    /// Returns the deviation's derivative by each coefficient: one value per axis for each.
    fn regress(&self, drive: Drive) -> Vec<Axes> {
        let _ = drive;
        Vec::new()
    }

    /// Returns the delay of the motion, s.
    fn delay_s(&self) -> f64 {
        0.0
    }

    /// Returns the largest magnitude of an axis's output, U.
    fn range(&self) -> Option<f64> {
        None
    }
}

/// Returns the derivatives by x, y and z for effects whose coefficients each act on one axis alone.
fn diagonal(values: Axes) -> Vec<Axes> {
    let [x, y, z] = values;
    vec![[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]]
}

fn xyz(values: Axes) -> Vec<(&'static str, Value)> {
    let [x, y, z] = values;
    vec![("x", x.into()), ("y", y.into()), ("z", z.into())]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{TRIAD, registry};
    use serde_json::json;

    /// Returns one effect of each kind, through the registry.
    fn all() -> Vec<std::sync::Arc<dyn TriadEffect>> {
        [
            ("bias", json!({"x": 0.1, "y": -0.2, "z": 0.3})),
            ("scale_factor", json!({"x": 0.002, "y": -0.001, "z": 0.003})),
            (
                "scale_factor_nonlinearity",
                json!({"x": 1e-3, "y": 2e-3, "z": -1e-3, "full_scale": 35.0, "form": "unsigned"}),
            ),
            (
                "scale_factor_nonlinearity",
                json!({"x": 1e-3, "y": 2e-3, "z": -1e-3, "full_scale": 35.0, "form": "signed"}),
            ),
            ("misalignment", json!({"x": 0.001, "y": 0.002, "z": -0.003})),
            ("cross_axis_sensitivity", json!({"xy": 0.001, "xz": 0.002, "yz": -0.003})),
            ("g_sensitivity", json!({"m": [[1e-4, 2e-4, 3e-4], [0, 5e-4, 6e-4], [7e-4, 8e-4, -9e-4]]})),
            ("latency", json!({"seconds": 0.004})),
            ("saturation", json!({"range": 35.0})),
            ("rectification", json!({"x": 1e-4, "y": -2e-4, "z": 3e-5})),
            ("temperature_scale", json!({"x": 1e-4, "y": -2e-4, "z": 3e-5, "reference_c": 20.0})),
        ]
        .into_iter()
        .map(|(name, entry)| registry::find(&TRIAD, name).unwrap().read(entry.as_object().unwrap()).unwrap())
        .collect()
    }

    #[test]
    fn the_deviation_is_the_sum_of_coefficients_times_derivatives() {
        let drive = Drive {
            input: [0.3, -1.2, 2.0],
            accel_m_s2: [1.0, -9.0, 3.0],
            vibration_m2_s4: [0.2, 3.0, 1.0],
            temperature_c: Some(31.0),
        };
        for effect in all() {
            let (coefficients, columns) = (effect.coefficients(), effect.regress(drive));
            assert_eq!(coefficients.len(), columns.len(), "{}", effect.name());
            for (axis, deviation) in effect.deviation(drive).into_iter().enumerate() {
                let sum: f64 = coefficients.iter().zip(&columns).map(|(c, column)| c * column[axis]).sum();
                assert!((deviation - sum).abs() < 1e-15, "{} axis {axis}", effect.name());
            }
        }
    }

    #[test]
    fn parameters_come_back_as_they_were_read() {
        for effect in all() {
            let entry = effect.parameters().into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
            let again = registry::find(&TRIAD, effect.name()).unwrap().read(&entry).unwrap();
            assert_eq!(again.parameters(), effect.parameters());
            assert!(effect.check(Triad::Gyro).is_ok());
        }
    }

    #[test]
    fn an_effect_on_a_triad_that_no_motion_drives_is_refused() {
        for effect in all() {
            let free = matches!(effect.name(), "bias" | "saturation");
            assert_eq!(effect.check(Triad::Mag).is_ok(), free, "{}", effect.name());
            assert_eq!(effect.check(Triad::Accel).is_ok(), effect.name() != "g_sensitivity", "{}", effect.name());
        }
    }
}
