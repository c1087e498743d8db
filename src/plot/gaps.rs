//! The gaps of a capture on a line of time.

use super::axis::Axis;
use super::course::told;
use super::drawing::{Drawing, Frame};
use std::collections::BTreeMap;

/// Where samples are missing.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::exhaustive_structs, reason = "callers write it out")]
pub struct Gap {
    /// From and to, s since the capture's first sample.
    pub within_s: [f64; 2],
    /// How many.
    pub missing: u64,
    /// Why.
    pub cause: String,
}

/// All of a capture.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::exhaustive_structs, reason = "callers write it out")]
pub struct Gaps {
    /// How long the capture is, s.
    pub length_s: f64,
    /// Its samples.
    pub samples: u64,
    /// Its gaps.
    pub gaps: Vec<Gap>,
}

impl Gaps {
    /// The picture, which says how many are missing and why.
    #[must_use]
    pub fn svg(&self) -> String {
        let missing: u64 = self.gaps.iter().map(|gap| gap.missing).sum();
        let title = match (self.gaps.len(), missing) {
            (0, _) => format!("{} samples, none missing", self.samples),
            (1, missing) => format!("{} samples, {missing} missing in one gap", self.samples),
            (gaps, missing) => format!("{} samples, {missing} missing in {gaps} gaps", self.samples),
        };
        let mut causes: BTreeMap<&str, u64> = BTreeMap::new();
        for gap in &self.gaps {
            *causes.entry(gap.cause.as_str()).or_default() += gap.missing;
        }
        let causes: Vec<String> = causes.iter().map(|(cause, missing)| format!("{cause}: {missing}")).collect();
        let (unit_s, unit) = told(self.length_s);
        let x = match causes.is_empty() {
            true => format!("time in {unit}"),
            false => format!("time in {unit} ({})", causes.join(", ")),
        };
        let frame = Frame { title: &title, x: &x, y: "", height: 130.0 };
        // One surface from the bottom up: there are no values.
        let across = Axis::between(0.0, self.length_s / unit_s);
        let mut drawing = Drawing::new(frame, across, Axis::bare());
        drawing.stretch("there", [0.0, self.length_s / unit_s], None);
        for gap in &self.gaps {
            let told = format!("{} missing, {}", gap.missing, gap.cause);
            drawing.stretch("gap", gap.within_s.map(|at| at / unit_s), Some(&told));
        }
        drawing.done()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_counted_by_cause_and_shown_however_short() {
        let gap =
            |from: f64, missing, cause: &str| Gap { within_s: [from, from + 0.1], missing, cause: cause.to_owned() };
        let gaps = vec![gap(10.0, 4, "host_stall"), gap(60.0, 2, "unplugged"), gap(90.0, 3, "unplugged")];
        let svg = Gaps { length_s: 18_000.0, samples: 720_000, gaps }.svg();
        assert!(
            svg.contains("720000 samples, 9 missing in 3 gaps") && svg.contains("host_stall: 4, unplugged: 5"),
            "{svg}"
        );
        assert_eq!(svg.matches("class=\"gap\"").count(), 3);
        assert!(svg.contains("width=\"4.0\"") && !svg.contains("NaN") && !svg.contains("inf"));
        let none = Gaps { length_s: 0.0, samples: 0, gaps: vec![] }.svg();
        assert!(none.contains("none missing") && !none.contains("NaN"));
    }
}
