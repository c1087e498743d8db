//! Allan deviation: curves with their 68 % bands, the fits, and the lines of N, B and K.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};
use super::number::rounded;
use imu_core::sample::Channel;
use imu_noise::NoiseReport;
use imu_noise::allan::{AllanCurve, AllanReport};

/// Returns one picture of these channels, which have one unit: a triad, or a single channel, which then also has its
/// lines of N, B and K. Empty if there is no curve.
pub fn deviation(title: &str, channels: &[Channel], allan: &AllanReport, noise: Option<&NoiseReport>) -> String {
    let curves: Vec<(Channel, &AllanCurve)> =
        channels.iter().filter_map(|channel| Some((*channel, allan.channels.get(channel)?))).collect();
    let Some((_, first)) = curves.first() else { return String::new() };
    let across = Axis::logarithmic(curves.iter().flat_map(|(_, curve)| &curve.tau_s).copied());
    let ends = curves.iter().flat_map(|(_, curve)| curve.ci68_low.iter().chain(&curve.ci68_high));
    let (Some(across), Some(up)) = (across, Axis::logarithmic(ends.copied())) else { return String::new() };
    let y = format!("Allan deviation in {}", first.unit);
    let frame = Frame { title, x: "averaging time τ in s", y: &y, height: 360.0 };
    let mut drawing = Drawing::new(frame, across, up);
    let mut key: Vec<(&str, String)> = Vec::new();
    for (channel, curve) in &curves {
        let class = class(channel.name(), curves.len());
        let band = curve.tau_s.iter().zip(curve.ci68_low.iter().zip(&curve.ci68_high));
        let band: Vec<(f64, f64, f64)> = band.map(|(tau, (low, high))| (*tau, *low, *high)).collect();
        drawing.surface(class, &band);
        drawing.curve(class, curve.tau_s.iter().copied().zip(curve.deviation.iter().copied()));
        key.push((class, channel.name().to_owned()));
        let Some(found) = noise.and_then(|noise| noise.channels.get(channel)) else { continue };
        let Some(fitted) = &found.fit.curve else { continue };
        drawing.curve("fit", fitted.tau_s.iter().copied().zip(fitted.deviation.iter().copied()));
        if curves.len() > 1 {
            continue;
        }
        key.push(("fit", "fitted".to_owned()));
        for (part, of) in [("N", &found.n), ("B", &found.b), ("K", &found.k)] {
            if let (Some(values), Some(value)) = (fitted.parts.get(part), of.value) {
                drawing.curve(part, fitted.tau_s.iter().copied().zip(values.iter().copied()));
                key.push((part, format!("{part} {} {}", rounded(value, 3), of.unit)));
            }
        }
    }
    let key: Vec<(&str, &str)> = key.iter().map(|(class, text)| (*class, text.as_str())).collect();
    drawing.key_below(&key);
    drawing.done()
}

/// Returns the class of a channel's curve among others: its axis.
pub(super) fn class(name: &str, among: usize) -> &'static str {
    match name.rsplit('_').next() {
        Some("x") if among > 1 => "x",
        Some("y") if among > 1 => "y",
        Some("z") if among > 1 => "z",
        _ => "one",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_core::sample::Triad;
    use imu_noise::allan::Estimator;
    use serde_json::json;

    #[test]
    fn a_triad_has_curves_and_bands_and_one_channel_its_lines() {
        let curve = AllanCurve {
            unit: "rad/s".to_owned(),
            tau_s: vec![0.1, 1.0, 10.0],
            deviation: vec![3e-4, 1e-4, 5e-5],
            ci68_low: vec![2.9e-4, 9e-5, 3e-5],
            ci68_high: vec![3.1e-4, 1.1e-4, 8e-5],
            ..AllanCurve::default()
        };
        let curves = [(Channel::GyroX, curve.clone()), (Channel::GyroY, curve)];
        let allan = AllanReport::new(Estimator::Oadev, 40.0, true, curves);
        let unknown = |unit: &str| json!({"value": null, "identified": false, "unit": unit});
        let known = |value: f64, unit: &str| json!({"value": value, "identified": true, "unit": unit});
        let fit = json!({"method": "whittle-dst", "curve": {"tau_s": [0.1, 10.0], "deviation": [3e-4, 5e-5],
            "parts": {"N": [3e-4, 3e-5], "K": [1e-7, 4e-6]}}});
        let found = json!({"unit": "rad/s", "N": known(1e-4, "rad/s/√Hz"), "B": unknown("rad/s"), "K": known(2e-6, "rad/s/√s"),
            "Q": unknown("rad"), "R": unknown("rad/s/s"), "fit": fit, "flags": []});
        let noise = json!({"format": NoiseReport::FORMAT, "capture": "a", "rate_hz": 40.0, "duration_s": 1.0, "samples": 40,
            "missing": 0, "complete": true, "channels": {"gyro_x": found}});
        let noise: NoiseReport = serde_json::from_value(noise).unwrap();
        let drawn = |channels: &[Channel]| deviation("Allan deviation", channels, &allan, Some(&noise));
        let triad = drawn(&Triad::Gyro.channels());
        assert_eq!((triad.matches("class=\"surface").count(), triad.matches("line fit").count()), (2, 1), "{triad}");
        assert!(triad.contains("Allan deviation in rad/s") && triad.contains("averaging time τ in s"));
        let one = drawn(&[Channel::GyroX]);
        // B has no value and no line.
        assert!(
            one.contains("N 1·10⁻⁴ rad/s/√Hz") && one.contains("K 2·10⁻⁶ rad/s/√s") && !one.contains("line B"),
            "{one}"
        );
        assert_eq!(drawn(&[Channel::AccelX]), "");
    }
}
