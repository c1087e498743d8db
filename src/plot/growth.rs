//! Growth of errors without aid: what pieces of a recording show, and what models predict.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};

/// The growth of one quantity over the time without aid, in the shown unit. What is not finite is left out.
#[derive(Debug, Clone, Default)]
pub struct Growth<'a> {
    /// Such as `heading`.
    pub title: &'a str,
    /// The shown unit.
    pub unit: &'a str,
    /// Times, s.
    pub horizons_s: Vec<f64>,
    /// Root mean square of the errors, and the ends of its 95 % interval.
    pub measured: Vec<[f64; 3]>,
    /// What each model predicts, with the class of its line: `before` or `after`.
    pub predicted: Vec<(&'static str, Vec<f64>)>,
}

/// Returns the picture; empty if there is nothing to draw.
pub fn growth(of: &Growth<'_>) -> String {
    let measured = of.measured.iter().flatten().copied();
    let values = measured.chain(of.predicted.iter().flat_map(|(_, values)| values.iter().copied()));
    let across = Axis::logarithmic(of.horizons_s.iter().copied());
    let (Some(across), Some(up)) = (across, Axis::logarithmic(values)) else { return String::new() };
    let y = format!("root mean square in {}", of.unit);
    let frame = Frame { title: of.title, x: "time without aid in s", y: &y, height: 260.0 };
    let mut drawing = Drawing::new(frame, across, up);
    let band = of.horizons_s.iter().zip(&of.measured).map(|(time_s, [_, low, high])| (*time_s, *low, *high));
    drawing.surface("real", &band.collect::<Vec<_>>());
    let middle = of.horizons_s.iter().copied().zip(of.measured.iter().map(|[value, _, _]| *value));
    drawing.curve("real", middle);
    for (class, values) in &of.predicted {
        drawing.curve(class, of.horizons_s.iter().copied().zip(values.iter().copied()));
    }
    drawing.done()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_measured_has_a_band_and_each_model_a_line() {
        let of = Growth {
            title: "<heading>",
            unit: "°",
            horizons_s: vec![1.0, 10.0, 60.0],
            measured: vec![[1e-3, 8e-4, 1.2e-3], [2e-3, 1e-3, 4e-3], [f64::NAN; 3]],
            predicted: vec![("before", vec![5e-4, 1e-3, 2e-3]), ("after", vec![1e-3, 2e-3, 8e-3])],
        };
        let svg = growth(&of);
        assert_eq!((svg.matches("<path class=\"line").count(), svg.matches("class=\"surface real").count()), (3, 1));
        assert!(svg.contains("root mean square in °") && !svg.contains("<heading>") && !svg.contains("NaN"), "{svg}");
        assert_eq!(growth(&Growth::default()), "");
    }
}
