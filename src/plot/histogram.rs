//! The histogram of a channel with the normal distribution of the same mean and standard deviation, and whether it is
//! normal.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};
use super::number::rounded;
use imu_noise::Statistics;
use std::f64::consts::TAU;

/// Points of the normal curve.
const POINTS: usize = 200;
/// The maximum number of bars: if there are more bins, several form one bar.
const BARS: usize = 120;

/// Returns the picture of a channel's statistics; empty if it has no samples.
pub fn histogram(channel: &str, of: &Statistics) -> String {
    let (edges, counts) = (&of.histogram.edges, &of.histogram.counts);
    let total: u64 = counts.iter().sum();
    let ends = edges.first().zip(edges.last());
    let (Some((low, high)), true) = (ends, total > 0 && edges.len() == counts.len() + 1) else {
        return String::new();
    };
    let together = counts.len().div_ceil(BARS).max(1);
    let bars: Vec<(f64, f64, f64)> = (0..counts.len())
        .step_by(together)
        .map(|place| {
            let end = (place + together).min(counts.len());
            let (from, to) = (edges[place], edges[end]);
            let count: u64 = counts[place..end].iter().sum();
            let width = if to > from { to - from } else { 1.0 };
            (from, to, count as f64 / total as f64 / width)
        })
        .collect();
    let normal: Vec<(f64, f64)> = match (of.mean, of.std.filter(|std| *std > 0.0)) {
        (Some(mean), Some(std)) => (0..=POINTS)
            .map(|point| {
                let value = low + (high - low) * point as f64 / POINTS as f64;
                (value, (-0.5 * ((value - mean) / std).powi(2)).exp() / (TAU.sqrt() * std))
            })
            .collect(),
        _ => Vec::new(),
    };
    let most =
        bars.iter().map(|(.., height)| *height).chain(normal.iter().map(|(_, height)| *height)).fold(0.0, f64::max);
    let y = format!("density per {}", of.unit);
    let x = format!("{channel} in {}", of.unit);
    let title = match &of.normality {
        Some(test) if test.verdict == "normal" => {
            format!("Histogram of {channel}: normal (p = {})", rounded(test.p_value, 2))
        }
        Some(test) => format!("Histogram of {channel}: not normal (p = {})", rounded(test.p_value, 2)),
        None => format!("Histogram of {channel}"),
    };
    let up = Axis::between(0.0, 1.05 * most);
    let frame = Frame { title: &title, x: &x, y: &y, height: 300.0 };
    let key: &[(&str, &str)] = if normal.is_empty() { &[] } else { &[("law", "normal distribution")] };
    let mut drawing = Drawing::keyed(frame, key, Axis::between(*low, *high), up);
    for (from, to, height) in bars {
        drawing.bar("bar", from, to, height);
    }
    drawing.curve("law", normal);

    drawing.done()
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_noise::statistics::{Histogram, Normality};

    fn of(edges: &[f64], counts: &[u64]) -> String {
        let (test, verdict) = ("jarque-bera".to_owned(), "not_normal".to_owned());
        let of = Statistics {
            unit: "m/s²".to_owned(),
            n: 4,
            not_finite: 0,
            mean: Some(0.5),
            std: Some(0.4),
            min: None,
            max: None,
            skewness: None,
            kurtosis: None,
            histogram: Histogram { edges: edges.to_vec(), counts: counts.to_vec() },
            normality: Some(Normality { test, statistic: 99.0, p_value: 1e-9, verdict }),
        };
        histogram("accel_<x>", &of)
    }

    #[test]
    fn bars_curve_and_verdict_are_there() {
        let svg = of(&[0.0, 0.5, 1.0], &[3, 1]);
        assert_eq!((svg.matches("class=\"bar\"").count(), svg.matches("line law").count()), (2, 2), "{svg}");
        assert!(
            svg.contains("not normal (p = 1·10⁻⁹)") && svg.contains("density per m/s²") && !svg.contains("<x>"),
            "{svg}"
        );
    }

    #[test]
    fn many_bins_become_few_bars_and_no_bins_give_no_picture() {
        let edges: Vec<f64> = (0..=1000).map(f64::from).collect();
        let bars = of(&edges, &[1; 1000]).matches("class=\"bar\"").count();
        assert!((100..=BARS).contains(&bars), "{bars}");
        assert_eq!(of(&[], &[]), "");
        assert!(!of(&[1.0, 1.0], &[5]).contains("NaN"));
    }
}
