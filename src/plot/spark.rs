//! Sparks: the last minute of a channel in the size of a word or two, without axes.

use std::fmt::Write as _;

/// Size in the picture's own units.
const WIDTH: f64 = 240.0;
const HEIGHT: f64 = 44.0;
/// Points farther apart than this multiple of the usual distance are not joined: no data arrived in between.
const APART: f64 = 2.5;

/// Returns the spark. `points` are the least and the greatest value by age in s, oldest first, over the last `span_s`;
/// pauses longer than `step_s` interrupt the line. `label` is for users of screen readers.
pub fn spark(label: &str, points: &[(f64, f64, f64)], span_s: f64, step_s: f64) -> String {
    let ends = points
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), (_, low, high)| (least.min(*low), most.max(*high)));
    let mut out = format!(
        "<svg class=\"spark\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" preserveAspectRatio=\"none\" role=\"img\" aria-label=\"{}\">",
        super::escaped(label)
    );
    let (least, most) = ends;
    if least.is_finite() && most.is_finite() {
        let range = if most > least { most - least } else { 1.0 };
        let x = |age_s: f64| WIDTH * (1.0 - age_s / span_s).clamp(0.0, 1.0);
        let y = |value: f64| HEIGHT - 2.0 - (HEIGHT - 4.0) * if most > least { (value - least) / range } else { 0.5 };
        let mut path = String::new();
        let mut before: Option<f64> = None;
        // From least to greatest of each stretch and on to the next: a line as wide as the noise.
        for (age_s, low, high) in points {
            let joined = before.is_some_and(|before| before - age_s < APART * step_s);
            let (x, low, high) = (x(*age_s), y(*low), y(*high));
            // Writing to a text cannot fail.
            let _ = write!(path, "{}{x:.1} {low:.1}V{high:.1}", if joined { 'L' } else { 'M' });
            before = Some(*age_s);
        }
        let _ = write!(out, "<path class=\"line one\" d=\"{path}\"/>");
    }
    out + "</svg>"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_interrupts_and_a_flat_line_is_in_the_middle() {
        let svg = spark("<gyro>", &[(10.0, 1.0, 2.0), (9.75, 0.0, 2.0), (1.0, 1.0, 1.0)], 60.0, 0.25);
        assert_eq!((svg.matches('M').count(), svg.matches('L').count()), (2, 1), "{svg}");
        assert!(!svg.contains("<gyro>") && svg.contains("aria-label=\"&lt;gyro&gt;\""));
        assert!(spark("", &[(0.0, 3.0, 3.0)], 60.0, 0.25).contains("M240.0 22.0"));
        assert!(!spark("", &[], 60.0, 0.25).contains("path"));
    }
}
