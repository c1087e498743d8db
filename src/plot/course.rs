//! The course of a channel: its samples over time, or if there are many the range of each stretch.

use super::axis::{Axis, time_unit};
use super::drawing::{Drawing, Frame};
use super::gaps::Gap;

/// Values over time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Course<'a> {
    /// The channel's name: `gyro_x`.
    pub channel: &'a str,
    /// Its unit.
    pub unit: &'a str,
    /// Time in s, least and greatest value of each stretch; both are the same for single samples. A value that is not
    /// finite interrupts the curve.
    pub points: Vec<(f64, f64, f64)>,
    /// Its gaps.
    pub gaps: Vec<Gap>,
}

impl Course<'_> {
    /// Returns the picture; empty if there is no value.
    pub fn svg(&self) -> String {
        let times = || self.points.iter().map(|(time_s, ..)| *time_s);
        let (from_s, to_s) =
            times().fold((f64::MAX, f64::MIN), |(from, to), time_s| (from.min(time_s), to.max(time_s)));
        let (unit_s, unit) = time_unit(to_s - from_s);
        let up = Axis::straight(self.points.iter().flat_map(|(_, low, high)| [*low, *high]));
        let Some(up) = up else { return String::new() };
        let (title, x) = (format!("{} over time", self.channel), format!("time in {unit}"));
        let y = format!("{} in {}", self.channel, self.unit);
        let frame = Frame { title: &title, x: &x, y: &y, height: 280.0 };
        let mut drawing = Drawing::new(frame, Axis::between(from_s / unit_s, to_s / unit_s), up);
        for gap in &self.gaps {
            drawing.stretch("mark", gap.within_s.map(|at| at / unit_s), Some(&gap.description()));
        }
        let points = self.parted();
        let points: Vec<(f64, f64, f64)> =
            points.into_iter().map(|(time_s, low, high)| (time_s / unit_s, low, high)).collect();
        if points.iter().any(|(_, low, high)| high > low) {
            drawing.surface("range", &points);
        }
        drawing.curve("one", points.iter().map(|(time, low, high)| (*time, 0.5 * (low + high))));
        drawing.done()
    }

    /// Returns the points in order, with a value that is not finite inside every gap longer than the distance of two
    /// points, so that nothing is drawn across. Shorter gaps have their mark.
    fn parted(&self) -> Vec<(f64, f64, f64)> {
        let mut points = self.points.clone();
        let ends = points.first().zip(points.last()).map_or(0.0, |(first, last)| last.0 - first.0);
        let apart_s = ends / points.len().max(1) as f64;
        let long = self.gaps.iter().map(|gap| gap.within_s).filter(|[from, to]| to - from > apart_s);
        points.extend(long.map(|[from, to]| (0.5 * (from + to), f64::NAN, f64::NAN)));
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_core::sample::GapCause;

    #[test]
    fn ranges_are_a_surface_and_gaps_are_marked() {
        let points = (0..40).map(|t| (f64::from(t) * 600.0, -1.0, 1.0 + f64::from(t))).collect();
        let gap = |within_s| vec![Gap { within_s, missing: 3, cause: GapCause::Unplugged }];
        let of = Course { channel: "accel_z", unit: "m/s²", points, gaps: gap([7200.0, 7210.0]) };
        let svg = of.svg();
        assert!(
            svg.contains("time in h")
                && svg.contains("accel_z in m/s²")
                && svg.contains("<title>3 missing, unplugged</title>")
        );
        assert_eq!((svg.matches("surface range").count(), svg.matches("class=\"mark\"").count()), (1, 1));
        // Nothing is drawn across a missing hour.
        let cut = Course { gaps: gap([6000.5, 9599.5]), ..of.clone() }.svg();
        assert_eq!((cut.matches("surface range").count(), cut.matches('M').count() - svg.matches('M').count()), (2, 2));
        let single = Course { points: vec![(0.0, 1.0, 1.0), (1.0, f64::NAN, f64::NAN), (2.0, 2.0, 2.0)], ..of.clone() };
        assert!(!single.svg().contains("surface") && !single.svg().contains("NaN"));
        assert_eq!(Course { points: vec![], ..of }.svg(), "");
    }
}
