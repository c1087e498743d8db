//! Residuals: means of the part of a motion's record beyond the model, against time, rate or specific force.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};
use imu_diagnosis::Residuals;

/// Returns the picture; empty if there is nothing to draw.
pub fn residuals(of: &Residuals) -> String {
    let against = match (&*of.against, of.axis.as_deref()) {
        ("rate", Some(axis)) => format!("the rate about {axis}"),
        (other, Some(axis)) => format!("the {other} along {axis}"),
        (other, None) => other.to_owned(),
    };
    let across = Axis::straight(of.at.iter().copied());
    let up = Axis::straight(of.before.iter().chain(&of.after).copied().chain([0.0]));
    let (Some(across), Some(up)) = (across.filter(|_| !of.at.is_empty()), up) else { return String::new() };
    let (title, x) = (format!("{} against {against}", of.channel), format!("{against} in {}", of.at_unit));
    let y = format!("beyond the model, {}", of.unit);
    let mut drawing = Drawing::new(Frame { title: &title, x: &x, y: &y, height: 260.0 }, across, up);
    for (class, values) in [("before", &of.before), ("after", &of.after)] {
        drawing.curve(class, of.at.iter().copied().zip(values.iter().copied()));
    }
    drawing.done()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(at: Vec<f64>, before: Vec<f64>, after: Vec<f64>) -> String {
        residuals(&Residuals {
            channel: "gyro_<z>".into(),
            unit: "rad/s".into(),
            against: "rate".into(),
            axis: Some("z".into()),
            at_unit: "rad/s".into(),
            at,
            before,
            after,
        })
    }

    #[test]
    fn both_curves_are_inside_and_axes_have_units() {
        let svg = of(vec![-2.0, 0.0, 2.0], vec![-0.004, 0.0, 0.004], vec![1e-5, f64::NAN, -1e-5]);
        assert_eq!((svg.matches("<path class=\"line").count(), svg.matches("<svg").count()), (2, 1));
        assert!(
            svg.contains("gyro_&lt;z&gt; against the rate about z") && svg.contains("the rate about z in rad/s"),
            "{svg}"
        );
        assert!(!svg.contains("NaN") && !svg.contains("inf") && !svg.contains("<z>"), "{svg}");
    }

    #[test]
    fn nothing_is_drawn_of_nothing_and_a_flat_curve_has_room() {
        assert_eq!(of(vec![], vec![], vec![]), "");
        let flat = of(vec![1.0], vec![0.0], vec![0.0]);
        assert!(flat.contains("<svg") && !flat.contains("NaN") && !flat.contains("inf"), "{flat}");
    }
}
