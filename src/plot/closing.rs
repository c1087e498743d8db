//! Closing: one bar per channel, from the initial gap down to a true model's gap, with the part that was closed.

use super::drawing::escaped_title;
use super::escaped;
use super::number::{plain, rounded};
use imu_diagnosis::report::ChannelGap;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The picture's width in its own units, the room for names and numbers, and the height of a row.
const WIDTH: f64 = 560.0;
const LEFT: f64 = 84.0;
const RIGHT: f64 = 166.0;
const TOP: f64 = 34.0;
const ROW: f64 = 26.0;
/// The scale reaches at least to this multiple of the floor: if there is no gap, the bars are short.
const LEAST: f64 = 100.0;

/// Returns the picture, on a logarithmic scale in multiples of each channel's own floor; empty if there is no bar to
/// draw.
pub fn closing(bars: &BTreeMap<String, ChannelGap>, unit: &str) -> String {
    let drawn: Vec<(&String, &ChannelGap)> =
        bars.iter().filter(|(_, bar)| bar.floor > 0.0 && bar.before.is_finite()).collect();
    if drawn.is_empty() {
        return String::new();
    }
    let most = drawn.iter().flat_map(|(_, bar)| [bar.before / bar.floor, bar.after / bar.floor]);
    let decades = most.filter(|times| times.is_finite()).fold(LEAST, f64::max).log10().ceil();
    let length = WIDTH - LEFT - RIGHT;
    // At the floor and below it there is no bar.
    let at = |times: f64| LEFT + length * (times.max(1.0).log10() / decades).min(1.0);
    let bottom = TOP + ROW * drawn.len() as f64;
    let mut out = escaped_title("The gap by channel", WIDTH, bottom + 46.0, LEFT);
    let step = (decades / 6.0).ceil().max(1.0) as usize;
    for decade in (0..=decades as usize).step_by(step) {
        let (x, label) = (
            LEFT + length * decade as f64 / decades,
            match decade {
                0 => "floor".to_owned(),
                decade => plain(10f64.powi(i32::try_from(decade).unwrap_or(0))) + "×",
            },
        );
        // Writing to a text cannot fail.
        let _ = write!(
            out,
            "<line class=\"grid\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{TOP}\" y2=\"{bottom}\"/>\
             <text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{label}</text>",
            bottom + 18.0
        );
    }
    for (row, (channel, bar)) in drawn.iter().enumerate() {
        let y = TOP + ROW * row as f64;
        let [before, after] = [bar.before, bar.after].map(|value| at(value / bar.floor));
        let _ = write!(
            out,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>\
             <rect class=\"left\" x=\"{LEFT}\" y=\"{}\" width=\"{:.1}\" height=\"16\"/>\
             <rect class=\"closed\" x=\"{after:.1}\" y=\"{}\" width=\"{:.1}\" height=\"16\"/>\
             <text x=\"{}\" y=\"{}\">{} → {}</text>",
            LEFT - 7.0,
            y + 17.0,
            escaped(channel),
            y + 4.0,
            (if bar.after.is_finite() { after - LEFT } else { before - LEFT }).max(1.0),
            y + 4.0,
            if bar.after.is_finite() { (before - after).max(0.0) } else { 0.0 },
            WIDTH - RIGHT + 8.0,
            y + 17.0,
            rounded(bar.before, 2),
            rounded(bar.after, 2),
        );
    }
    let _ = write!(
        out,
        "<text x=\"{LEFT}\" y=\"{}\">times the floor, logarithmic; at the right {}</text></svg>",
        bottom + 38.0,
        escaped(unit)
    );
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_reaches_from_what_is_left_to_what_was_there() {
        let bar = |channel: &str, before, after| (channel.to_owned(), ChannelGap { before, after, floor: 1e-6 });
        let bars = [bar("<z>", 1e-2, 1e-6), bar("gyro_x", 1e-6, -1e-7), bar("gyro_y", 1e-5, 1e-3)].into();
        let svg = closing(&bars, "nats/sample");
        assert_eq!((svg.matches("class=\"closed\"").count(), svg.matches("class=\"left\"").count()), (3, 3));
        // Four decades over 310 units: the first gap is closed completely, the second never existed.
        assert!(
            svg.contains("x=\"84.0\" y=\"38\" width=\"310.0\"") && svg.contains("x=\"84.0\" y=\"64\" width=\"0.0\"")
        );
        assert!(svg.contains("floor") && svg.contains("nats/sample") && !svg.contains("<z>") && !svg.contains("NaN"));
        assert_eq!(closing(&[("x".to_owned(), ChannelGap { before: 1.0, after: 1.0, floor: 0.0 })].into(), "nats"), "");
        let unknown = closing(&[bar("x", 1e-3, f64::NAN)].into(), "nats");
        assert!(unknown.contains("→ –") && !unknown.contains("NaN"), "{unknown}");
    }
}
