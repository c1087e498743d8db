//! The gaps of a capture on a time line.

use super::axis::{Axis, time_unit};
use super::drawing::{Drawing, Frame};
use imu_core::sample::GapCause;
use imu_core::units::counted;
use std::collections::BTreeMap;

/// A gap in the samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Gap {
    /// Begin and end, s since the capture's first sample.
    pub within_s: [f64; 2],
    /// The number of missing samples.
    pub missing: u64,
    /// The cause.
    pub cause: GapCause,
}

impl Gap {
    /// Returns the description.
    pub(super) fn description(&self) -> String {
        format!("{} missing, {}", self.missing, self.cause.name())
    }
}

/// All gaps of a capture.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaps {
    /// The length of the capture, s.
    pub length_s: f64,
    /// Its samples.
    pub samples: u64,
    /// The number of its gaps.
    pub count: u64,
    /// The number of missing samples by cause.
    pub causes: BTreeMap<String, u64>,
    /// Its gaps, or the first of very many.
    pub gaps: Vec<Gap>,
}

impl Gaps {
    /// Returns the picture, with the number of missing samples and the causes.
    pub fn svg(&self) -> String {
        let missing: u64 = self.causes.values().sum();
        let drawn = match self.gaps.len() {
            all if all as u64 >= self.count => String::new(),
            first => format!("; the first {first} are drawn"),
        };
        let samples = counted(self.samples, "sample", "samples");
        let title = match (self.count, missing) {
            (0, _) => format!("{samples}, none missing"),
            (1, missing) => format!("{samples}, {missing} missing in one gap"),
            (gaps, missing) => format!("{samples}, {missing} missing in {gaps} gaps{drawn}"),
        };
        let causes: Vec<String> = self.causes.iter().map(|(cause, missing)| format!("{cause}: {missing}")).collect();
        let (unit_s, unit) = time_unit(self.length_s);
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
            drawing.stretch("gap", gap.within_s.map(|at| at / unit_s), Some(&gap.description()));
        }
        drawing.done()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_counted_by_cause_and_shown_however_short() {
        let gap = |from: f64, missing, cause| Gap { within_s: [from, from + 0.1], missing, cause };
        let unplugged = GapCause::Unplugged;
        let gaps = vec![gap(10.0, 4, GapCause::HostStall), gap(60.0, 2, unplugged), gap(90.0, 3, unplugged)];
        let causes = BTreeMap::from([("host_stall".to_owned(), 4), ("unplugged".to_owned(), 5)]);
        let of = Gaps { length_s: 18_000.0, samples: 720_000, count: 3, causes, gaps };
        let svg = of.svg();
        assert!(
            svg.contains("720000 samples, 9 missing in 3 gaps") && svg.contains("host_stall: 4, unplugged: 5"),
            "{svg}"
        );
        assert_eq!(svg.matches("class=\"gap\"").count(), 3);
        assert!(svg.contains("width=\"4.0\"") && !svg.contains("NaN") && !svg.contains("inf"));
        let many = Gaps { count: 5000, ..of }.svg();
        assert!(many.contains("9 missing in 5000 gaps; the first 3 are drawn"), "{many}");
        let none = Gaps { length_s: 0.0, samples: 0, count: 0, causes: BTreeMap::new(), gaps: vec![] }.svg();
        assert!(none.contains("none missing") && !none.contains("NaN"));
    }
}
