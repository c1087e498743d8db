//! Statistics: one row per channel.

use super::{by_name, escaped, wide};
use crate::page::figure::plain;
use crate::plot::number::rounded;
use imu_core::sample::Channel;
use imu_noise::Statistics;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Channels in the order of the sensor's manual.
const ORDER: [&str; 5] = ["yaw", "pitch", "roll", "gyro", "accel"];

/// Writes the table.
pub(super) fn section(out: &mut String, channels: &BTreeMap<Channel, Statistics>) {
    if channels.is_empty() {
        return;
    }
    *out += "<h2>Statistics</h2><p class=\"soft\">Kurtosis is that in excess of a normal distribution's.</p>";
    *out += &wide("statistics");
    *out += "<table><tr><th scope=\"col\">channel</th><th scope=\"col\">unit</th>";
    for name in ["mean", "std", "min", "max", "skewness", "kurtosis"] {
        // Writing to a text cannot fail.
        let _ = write!(out, "<th scope=\"col\" class=\"number\">{name}</th>");
    }
    *out += "<th scope=\"col\">normal?</th></tr>";
    let place = |name: &str| ORDER.iter().position(|prefix| name.starts_with(prefix)).unwrap_or(ORDER.len());
    let mut channels = by_name(channels);
    channels.sort_by_key(|(name, _)| place(name));
    for (name, own) in channels {
        let _ = write!(out, "<tr><th scope=\"row\">{}</th><td>{}</td>", name, escaped(&own.unit));
        // A level of 9.8 with noise of a thousandth needs all its digits.
        let digits = |value: f64| rounded(value, 6);
        let cells = [
            own.mean.map(digits),
            own.std.map(plain),
            own.min.map(digits),
            own.max.map(digits),
            own.skewness.map(|value| rounded(value, 2)),
            own.kurtosis.map(|value| rounded(value, 2)),
        ];
        for cell in cells {
            let _ = write!(out, "<td class=\"number\">{}</td>", cell.unwrap_or_else(|| "–".to_owned()));
        }
        let normal = own.normality.as_ref().map_or_else(
            || "–".to_owned(),
            |test| format!("{} (p = {})", escaped(&test.verdict.replace('_', " ")), rounded(test.p_value, 2)),
        );
        let _ = write!(out, "<td>{normal}</td></tr>");
    }
    *out += "</table></div>";
}
