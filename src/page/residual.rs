//! Residual charts: means of what a record of a motion shows beyond the model, against time, rate or specific force, as SVG.

use super::escaped;
use super::figure::{numbers, plain};
use serde::Deserialize;
use std::fmt::Write as _;

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 220.0;
/// Room at the left, right, top and bottom.
const MARGIN: [f64; 4] = [84.0, 14.0, 10.0, 40.0];
/// Lines across each axis, about.
const LINES: f64 = 6.0;

/// Means of one channel against one quantity, as [`crate::diagnosis::Residuals`] has them.
#[derive(Debug, Deserialize)]
pub(super) struct Residuals {
    pub(super) channel: String,
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

/// A straight axis.
struct Axis {
    from: f64,
    to: f64,
    /// In the picture.
    at: [f64; 2],
}

impl Axis {
    /// None where there is no value.
    fn of(values: impl Iterator<Item = f64>, at: [f64; 2]) -> Option<Self> {
        let (low, high) = values
            .filter(|value| value.is_finite())
            .fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
        // A flat curve gets some room around it.
        let room = (0.04 * (high - low)).max(1e-3 * high.abs()).max(f64::MIN_POSITIVE);
        (low <= high).then_some(Self { from: low - room, to: high + room, at })
    }

    fn place(&self, value: f64) -> f64 {
        self.at[0] + (value - self.from) / (self.to - self.from) * (self.at[1] - self.at[0])
    }

    /// Round values with a line of their own.
    fn ticks(&self) -> Vec<f64> {
        let rough = (self.to - self.from) / LINES;
        let decade = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|of| of * decade).find(|step| *step >= rough).unwrap_or(rough);
        let first = (self.from / step).ceil() as i64;
        // A sum of steps is rounded otherwise than a multiple.
        (first..=(self.to / step).floor() as i64).map(|of| of as f64 * step).collect()
    }
}

impl Residuals {
    /// "accel_x against the rate about y".
    pub(super) fn title(&self) -> String {
        let of = match (self.against.as_str(), self.axis.as_deref()) {
            ("rate", Some(axis)) => format!("the rate about {axis}"),
            (other, Some(axis)) => format!("the {other} along {axis}"),
            (other, None) => other.to_owned(),
        };
        format!("{} against {of}", self.channel)
    }

    /// The chart; empty where there is nothing to draw.
    pub(super) fn drawn(&self) -> String {
        let [left, right, top, bottom] = [MARGIN[0], WIDTH - MARGIN[1], MARGIN[2], HEIGHT - MARGIN[3]];
        let x = Axis::of(self.at.iter().copied(), [left, right]);
        let y = Axis::of(self.before.iter().chain(&self.after).copied().chain([0.0]), [bottom, top]);
        let (Some(x), Some(y)) = (x, y) else { return String::new() };
        let name = escaped(&format!("residuals of {}", self.title()));
        let mut out = format!("<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{name}\">");
        // Writing to a text cannot fail.
        for value in x.ticks() {
            let at = x.place(value);
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{top}\" y2=\"{bottom}\"/>\
                 <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{}</text>",
                bottom + 16.0,
                plain(value)
            );
        }
        for value in y.ticks() {
            let at = y.place(value);
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{left}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>\
                 <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                left - 6.0,
                at + 4.0,
                plain(value)
            );
        }
        for (class, values, dashes) in
            [("before", &self.before, " stroke-dasharray=\"6 4\""), ("after", &self.after, "")]
        {
            let _ = write!(out, "<polyline class=\"{class}\" fill=\"none\" stroke-width=\"2\"{dashes} points=\"");
            for (at, value) in self.at.iter().zip(values).filter(|(at, value)| at.is_finite() && value.is_finite()) {
                let _ = write!(out, "{:.1},{:.1} ", x.place(*at), y.place(*value));
            }
            out.push_str("\"/>");
        }
        let (middle, low) = (0.5 * (left + right), HEIGHT - 6.0);
        let (against, unit) = (escaped(&self.title()), escaped(&self.unit));
        let _ = write!(
            out,
            "<text x=\"{middle}\" y=\"{low}\" text-anchor=\"middle\">{against}, {}; upwards: {unit}</text></svg>",
            escaped(&self.at_unit)
        );
        out
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
    fn both_curves_are_inside_and_axes_have_round_values() {
        let svg = of(vec![-2.0, 0.0, 2.0], vec![-0.004, 0.0, 0.004], vec![1e-5, f64::NAN, -1e-5]).drawn();
        assert_eq!((svg.matches("<polyline").count(), svg.matches("<svg").count()), (2, 1));
        assert!(svg.contains("&lt;z&gt; against the rate about z, rad/s; upwards: rad/s"), "{svg}");
        assert!(!svg.contains("NaN") && !svg.contains("inf") && !svg.contains("<z>"), "{svg}");
        let axis = Axis::of([-2.0, 2.0].into_iter(), [0.0, 100.0]).unwrap();
        assert_eq!(axis.ticks(), [-2.0, -1.0, 0.0, 1.0, 2.0]);
        assert!(axis.place(-2.0) > 0.0 && axis.place(2.0) < 100.0);
    }

    #[test]
    fn nothing_is_drawn_of_nothing_and_a_flat_curve_has_room() {
        assert_eq!(of(vec![], vec![], vec![]).drawn(), "");
        let flat = of(vec![1.0], vec![0.0], vec![0.0]).drawn();
        assert!(flat.contains("<svg") && !flat.contains("NaN") && !flat.contains("inf"), "{flat}");
    }
}
