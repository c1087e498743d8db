//! The Allan deviation hour by hour: whether the sensor was the same all night.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};
use super::number::rounded;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Shades from the first hour to the last (`style.css`: `h0` …).
const SHADES: usize = 6;

/// The parts of `vn100d-noise-1` that are drawn.
#[derive(Debug, Deserialize)]
struct Noise {
    #[serde(default)]
    disturbances: BTreeMap<String, Disturbances>,
}

#[derive(Debug, Deserialize)]
struct Disturbances {
    dynamic: Option<Dynamic>,
}

#[derive(Debug, Deserialize)]
struct Dynamic {
    block_s: f64,
    tau_s: Vec<f64>,
    blocks: Vec<Block>,
    p_value: Option<f64>,
    stationary: Option<bool>,
    worst_tau_s: Option<f64>,
}

#[derive(Debug, Deserialize)]
struct Block {
    deviation: Vec<Option<f64>>,
}

/// The picture of a channel in `vn100d-noise-1`; empty if the document has no deviation by the hour. `unit` is the
/// channel's.
///
/// # Errors
/// The error of a text that is no such document.
pub fn hourly(channel: &str, unit: &str, noise: &str) -> Result<String, serde_json::Error> {
    let mut document: Noise = serde_json::from_str(noise)?;
    let Some(of) = document.disturbances.remove(channel).and_then(|own| own.dynamic) else { return Ok(String::new()) };
    let curve = |block: &Block| -> Vec<(f64, f64)> {
        of.tau_s.iter().copied().zip(block.deviation.iter().map(|value| value.unwrap_or(f64::NAN))).collect()
    };
    let curves: Vec<Vec<(f64, f64)>> = of.blocks.iter().map(curve).collect();
    let across = Axis::logarithmic(of.tau_s.iter().copied());
    let up = Axis::logarithmic(curves.iter().flatten().map(|(_, value)| *value));
    let (Some(across), Some(up)) = (across, up) else { return Ok(String::new()) };
    let p = of.p_value.map_or_else(String::new, |p| format!(" (p = {})", rounded(p, 2)));
    let verdict = match (of.stationary, of.worst_tau_s) {
        (Some(true), _) => format!(": all agree{p}"),
        (Some(false), Some(tau_s)) => format!(": differ most at {} s{p}", rounded(tau_s, 2)),
        _ => String::new(),
    };
    let block = match of.block_s / 60.0 {
        minutes if minutes > 55.0 && minutes < 65.0 => "hour".to_owned(),
        minutes => format!("{} min", rounded(minutes, 2)),
    };
    let title = format!("{channel} by the {block}{verdict}");
    let y = format!("Allan deviation in {unit}");
    let frame = Frame { title: &title, x: "averaging time τ in s", y: &y, height: 320.0 };
    let mut drawing = Drawing::new(frame, across, up);
    let last = curves.len().saturating_sub(1).max(1);
    for (place, curve) in curves.iter().enumerate() {
        let class = format!("h{}", (place * (SHADES - 1) + last / 2) / last);
        drawing.curve(&class, curve.iter().copied());
    }
    drawing.key_below(&[("h0", "first"), ("h5", "last")]);
    Ok(drawing.done())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn each_block_is_a_curve_and_the_verdict_is_told() {
        let block = |level: f64| json!({"from_s": 0, "to_s": 1, "deviation": [level, level / 2.0, null]});
        let dynamic = json!({"block_s": 3600.0, "tau_s": [1.0, 4.0, 16.0], "blocks": [block(1.0), block(1.1), block(3.0)],
            "stationary": false, "p_value": 1e-5, "worst_tau_s": 4.0});
        let noise = json!({"disturbances": {"gyro_x": {"dynamic": dynamic}, "gyro_y": {"dynamic": null}}}).to_string();
        let svg = hourly("gyro_x", "rad/s", &noise).unwrap();
        // Each once, and the first and the last again in the key.
        assert_eq!(
            ["h0", "h2", "h3", "h5"].map(|h| svg.matches(&format!("line {h}\"")).count()),
            [2, 0, 1, 2],
            "{svg}"
        );
        assert!(svg.contains("by the hour: differ most at 4 s (p = 1·10⁻⁵)") && !svg.contains("NaN"), "{svg}");
        assert_eq!(hourly("gyro_y", "rad/s", &noise).unwrap(), "");
        assert!(hourly("gyro_x", "rad/s", "7").is_err());
    }
}
