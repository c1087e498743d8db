//! Residuals: means of the part of a motion's record beyond the model, against time, rate or specific force.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};
use super::json::numbers;
use serde::Deserialize;

/// Means of one channel against one quantity, as [`imu_diagnosis::Residuals`] has them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Residuals {
    channel: String,
    unit: String,
    against: String,
    axis: Option<String>,
    at_unit: String,
    #[serde(deserialize_with = "numbers")]
    at: Vec<f64>,
    #[serde(deserialize_with = "numbers")]
    before: Vec<f64>,
    #[serde(deserialize_with = "numbers")]
    after: Vec<f64>,
}

impl Residuals {
    /// The channel.
    pub fn channel(&self) -> &str {
        &self.channel
    }

    /// "accel_x against the rate about y".
    pub fn title(&self) -> String {
        format!("{} against {}", self.channel, self.quantity())
    }

    fn quantity(&self) -> String {
        match (self.against.as_str(), self.axis.as_deref()) {
            ("rate", Some(axis)) => format!("the rate about {axis}"),
            (other, Some(axis)) => format!("the {other} along {axis}"),
            (other, None) => other.to_owned(),
        }
    }

    /// The picture; empty if there is nothing to draw.
    pub fn svg(&self) -> String {
        let across = Axis::straight(self.at.iter().copied());
        let up = Axis::straight(self.before.iter().chain(&self.after).copied().chain([0.0]));
        let (Some(across), Some(up)) = (across.filter(|_| !self.at.is_empty()), up) else { return String::new() };
        let (title, x) = (self.title(), format!("{} in {}", self.quantity(), self.at_unit));
        let y = format!("beyond the model, {}", self.unit);
        let mut drawing = Drawing::new(Frame { title: &title, x: &x, y: &y, height: 260.0 }, across, up);
        for (class, values) in [("before", &self.before), ("after", &self.after)] {
            drawing.curve(class, self.at.iter().copied().zip(values.iter().copied()));
        }
        drawing.done()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(at: Vec<f64>, before: Vec<f64>, after: Vec<f64>) -> Residuals {
        Residuals {
            channel: "gyro_<z>".to_owned(),
            unit: "rad/s".to_owned(),
            against: "rate".to_owned(),
            axis: Some("z".to_owned()),
            at_unit: "rad/s".to_owned(),
            at,
            before,
            after,
        }
    }

    #[test]
    fn both_curves_are_inside_and_axes_have_units() {
        let svg = of(vec![-2.0, 0.0, 2.0], vec![-0.004, 0.0, 0.004], vec![1e-5, f64::NAN, -1e-5]).svg();
        assert_eq!((svg.matches("<path class=\"line").count(), svg.matches("<svg").count()), (2, 1));
        assert!(
            svg.contains("gyro_&lt;z&gt; against the rate about z") && svg.contains("the rate about z in rad/s"),
            "{svg}"
        );
        assert!(!svg.contains("NaN") && !svg.contains("inf") && !svg.contains("<z>"), "{svg}");
    }

    #[test]
    fn nothing_is_drawn_of_nothing_and_a_flat_curve_has_room() {
        assert_eq!(of(vec![], vec![], vec![]).svg(), "");
        let flat = of(vec![1.0], vec![0.0], vec![0.0]).svg();
        assert!(flat.contains("<svg") && !flat.contains("NaN") && !flat.contains("inf"), "{flat}");
    }
}
