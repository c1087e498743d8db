//! The Allan deviation hour by hour: it shows whether the sensor stayed the same all night.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};
use super::number::rounded;
use imu_noise::robust::{DynamicAllan, DynamicBlock};

/// Shades from the first hour to the last (`style.css`: `h0` …).
const SHADES: usize = 6;

/// Returns the picture of a channel's deviation by the hour; empty if nothing is above 0. `unit` is the channel's.
pub fn hourly(channel: &str, unit: &str, of: &DynamicAllan) -> String {
    let curve = |block: &DynamicBlock| -> Vec<(f64, f64)> {
        of.tau_s.iter().copied().zip(block.deviation.iter().map(|value| value.unwrap_or(f64::NAN))).collect()
    };
    let curves: Vec<Vec<(f64, f64)>> = of.blocks.iter().map(curve).collect();
    let across = Axis::logarithmic(of.tau_s.iter().copied());
    let up = Axis::logarithmic(curves.iter().flatten().map(|(_, value)| *value));
    let (Some(across), Some(up)) = (across, up) else { return String::new() };
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
    let mut drawing = Drawing::keyed(frame, &[("h0", "first"), ("h5", "last")], across, up);
    let last = curves.len().saturating_sub(1).max(1);
    for (place, curve) in curves.iter().enumerate() {
        let class = format!("h{}", (place * (SHADES - 1) + last / 2) / last);
        drawing.curve(&class, curve.iter().copied());
    }

    drawing.done()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_block_is_a_curve_and_the_verdict_is_shown() {
        let block =
            |level: f64| DynamicBlock { from_s: 0.0, to_s: 1.0, deviation: vec![Some(level), Some(level / 2.0), None] };
        let of = DynamicAllan {
            block_s: 3600.0,
            tau_s: vec![1.0, 4.0, 16.0],
            blocks: [1.0, 1.1, 3.0].map(block).to_vec(),
            stationary: Some(false),
            p_value: Some(1e-5),
            worst_tau_s: Some(4.0),
        };
        let svg = hourly("gyro_x", "rad/s", &of);
        // Each shade occurs once, and the first and the last also in the key.
        assert_eq!(
            ["h0", "h2", "h3", "h5"].map(|h| svg.matches(&format!("line {h}\"")).count()),
            [2, 0, 1, 2],
            "{svg}"
        );
        assert!(svg.contains("by the hour: differ most at 4 s (p = 1·10⁻⁵)") && !svg.contains("NaN"), "{svg}");
        assert_eq!(hourly("gyro_x", "rad/s", &DynamicAllan { tau_s: vec![], ..of }), "");
    }
}
