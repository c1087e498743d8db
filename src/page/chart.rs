//! Charts: spectra of one channel as SVG, both axes logarithmic.

use super::escaped;
use super::figure::{numbers, numbers_or_none};
use serde::Deserialize;
use std::fmt::Write as _;

const WIDTH: f64 = 760.0;
/// Room at the left, right, top and bottom.
const MARGIN: [f64; 4] = [78.0, 14.0, 10.0, 40.0];

/// Amplitude densities of one channel.
#[derive(Debug, Deserialize)]
pub(super) struct Spectra {
    pub(super) channel: String,
    unit: String,
    #[serde(deserialize_with = "numbers")]
    frequency_hz: Vec<f64>,
    #[serde(deserialize_with = "numbers")]
    real: Vec<f64>,
    #[serde(default, deserialize_with = "numbers_or_none")]
    before: Option<Vec<f64>>,
    #[serde(default, deserialize_with = "numbers_or_none")]
    after: Option<Vec<f64>>,
}

/// An axis: powers of ten from one end to the other.
struct Axis {
    from: f64,
    to: f64,
    /// In the picture.
    at: [f64; 2],
}

impl Axis {
    /// None where there is nothing above 0.
    fn of(values: impl Iterator<Item = f64>, at: [f64; 2]) -> Option<Self> {
        let logs = values.filter(|value| *value > 0.0 && value.is_finite()).map(f64::log10);
        let (low, high) = logs.fold((f64::MAX, f64::MIN), |(low, high), log| (low.min(log), high.max(log)));
        // A flat spectrum gets some room around it.
        let room = (0.35 - (high - low)).max(0.06);
        (low <= high).then_some(Self { from: low - room, to: high + room, at })
    }

    fn place(&self, value: f64) -> f64 {
        let share = (value.max(f64::MIN_POSITIVE).log10() - self.from) / (self.to - self.from);
        self.at[0] + share.clamp(0.0, 1.0) * (self.at[1] - self.at[0])
    }

    /// Values with a line of their own and their label: powers of ten; between them too where these are few.
    fn ticks(&self) -> Vec<(f64, String)> {
        let decades = (self.from.floor() as i32)..=(self.to.ceil() as i32);
        let steps: &[f64] = if self.to - self.from > 2.5 { &[1.0] } else { &[1.0, 2.0, 5.0] };
        let all = decades.flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)));
        let inside = all.filter(|value| (self.from..=self.to).contains(&value.log10()));
        inside.map(|value| (value, super::figure::plain(value))).collect()
    }
}

/// One picture of several curves over the same frequencies.
struct Picture<'a> {
    name: String,
    height: f64,
    frequency_hz: &'a [f64],
    curves: Vec<(&'static str, &'a [f64])>,
    upwards: String,
}

/// The charts: densities, and where the model is known what they are over its own, which shows what is small beside drifts. Bands
/// in Hz are marked behind the curves.
pub(super) fn spectra(of: &Spectra, bands: &[[f64; 2]]) -> String {
    let frequency_hz = of.frequency_hz.as_slice();
    let all = [("real", Some(&of.real)), ("before", of.before.as_ref()), ("after", of.after.as_ref())];
    let densities = Picture {
        name: format!("spectra of {}", of.channel),
        height: 280.0,
        frequency_hz,
        curves: all.iter().filter_map(|(class, values)| Some((*class, values.as_ref()?.as_slice()))).collect(),
        upwards: format!("{}/√Hz", of.unit),
    };
    let mut out = densities.drawn(bands);
    if let Some(before) = &of.before {
        let over = |values: &[f64]| -> Vec<f64> {
            values.iter().zip(before).map(|(value, own)| if *own > 0.0 { value / own } else { 0.0 }).collect()
        };
        let ratios: Vec<(&'static str, Vec<f64>)> =
            all.iter().filter_map(|(class, values)| Some((*class, over(values.as_ref()?)))).collect();
        let ratio = Picture {
            name: format!("spectra of {} over the model's", of.channel),
            height: 200.0,
            frequency_hz,
            curves: ratios.iter().map(|(class, values)| (*class, values.as_slice())).collect(),
            upwards: "times the model as it is".to_owned(),
        };
        out += &ratio.drawn(bands);
    }
    out
}

impl Picture<'_> {
    fn drawn(&self, bands: &[[f64; 2]]) -> String {
        let [left, right, top, bottom] = [MARGIN[0], WIDTH - MARGIN[1], MARGIN[2], self.height - MARGIN[3]];
        let x = Axis::of(self.frequency_hz.iter().copied(), [left, right]);
        let y = Axis::of(self.curves.iter().flat_map(|(_, values)| *values).copied(), [bottom, top]);
        let (Some(x), Some(y)) = (x, y) else { return String::new() };
        let (height, name) = (self.height, escaped(&self.name));
        let mut out = format!("<svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{name}\">");
        // Writing to a text cannot fail.
        for [from, to] in bands {
            let (from, to) = (x.place(*from), x.place(*to));
            let width = (to - from).max(4.0);
            let _ = write!(
                out,
                "<rect class=\"mark\" x=\"{:.1}\" y=\"{top}\" width=\"{width:.1}\" height=\"{}\"/>",
                0.5 * (from + to - width),
                bottom - top
            );
        }
        for (value, label) in x.ticks() {
            let at = x.place(value);
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{top}\" y2=\"{bottom}\"/>\
                 <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{label}</text>",
                bottom + 16.0
            );
        }
        for (value, label) in y.ticks() {
            let at = y.place(value);
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{left}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>\
                 <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
                left - 6.0,
                at + 4.0
            );
        }
        for (class, values) in &self.curves {
            let width = if *class == "real" { 1.0 } else { 2.0 };
            let dashes = if *class == "before" { " stroke-dasharray=\"6 4\"" } else { "" };
            let _ = write!(out, "<polyline class=\"{class}\" fill=\"none\" stroke-width=\"{width}\"{dashes} points=\"");
            let points = self.frequency_hz.iter().zip(*values);
            for (hz, value) in points.filter(|(hz, value)| hz.is_finite() && value.is_finite()) {
                let _ = write!(out, "{:.1},{:.1} ", x.place(*hz), y.place(*value));
            }
            out.push_str("\"/>");
        }
        let (middle, low) = (0.5 * (left + right), height - 6.0);
        let upwards = escaped(&self.upwards);
        let _ = write!(
            out,
            "<text x=\"{middle}\" y=\"{low}\" text-anchor=\"middle\">frequency in Hz; upwards: {upwards}</text></svg>"
        );
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_curve_that_is_there_is_drawn_inside_the_picture() {
        let of = Spectra {
            channel: "<z>".to_owned(),
            unit: "m/s²".to_owned(),
            frequency_hz: vec![0.01, 1.0, 20.0],
            real: vec![1.0, 2e-3, 0.0],
            before: None,
            after: Some(vec![1.1, 2e-3, 2e-3]),
        };
        let svg = spectra(&of, &[[11.0, 12.0]]);
        assert_eq!(svg.matches("<polyline").count(), 2);
        assert!(svg.contains("class=\"mark\"") && svg.contains("m/s²/√Hz") && !svg.contains("<z>"), "{svg}");
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        let known = Spectra { before: Some(vec![1.0, 2e-3, 1e-3]), ..of };
        let svg = spectra(&known, &[]);
        assert_eq!((svg.matches("<polyline").count(), svg.matches("<svg").count()), (6, 2));
        assert!(svg.contains("times the model as it is") && !svg.contains("NaN"), "{svg}");
        let of = known;
        let empty = Spectra { frequency_hz: vec![], real: vec![], after: None, ..of };
        assert_eq!(spectra(&empty, &[]), "");
    }
}
