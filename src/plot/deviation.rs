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
    let fitted = |channel: &Channel| {
        let found = noise?.channels.get(channel)?;
        Some((found, found.fit.curve.as_ref()?))
    };
    let mut key: Vec<(&str, String)> = Vec::new();
    let mut lines: Vec<(&str, &[f64], &[f64])> = Vec::new();
    for (channel, _) in &curves {
        key.push((class(channel.name(), curves.len()), channel.name().to_owned()));
        let Some((found, fitted)) = fitted(channel) else { continue };
        lines.push(("fit", &fitted.tau_s, &fitted.deviation));
        if curves.len() > 1 {
            continue;
        }
        key.push(("fit", "fitted".to_owned()));
        for (part, of) in [("N", &found.n), ("B", &found.b), ("K", &found.k)] {
            if let (Some(values), Some(value)) = (fitted.parts.get(part), of.value) {
                lines.push((part, &fitted.tau_s, values));
                key.push((part, format!("{part} {} {}", rounded(value, 3), of.unit)));
            }
        }
    }
    let mut drawing = Drawing::keyed(frame, &borrowed(&key), across, up);
    for (channel, curve) in &curves {
        drawn(&mut drawing, class(channel.name(), curves.len()), curve);
    }
    for (class, tau_s, values) in lines {
        drawing.curve(class, tau_s.iter().copied().zip(values.iter().copied()));
    }
    drawing.done()
}

/// Returns one picture of a channel's curves in two captures, each with the capture's name. Empty if neither has one;
/// a curve in another unit than the first one's is left out.
pub fn deviation_beside(channel: Channel, of: [(&str, &AllanReport); 2]) -> String {
    let classes = ["one", "second"].into_iter().zip(of);
    let curves = classes.filter_map(|(class, (name, report))| Some((class, name, report.channels.get(&channel)?)));
    let mut curves: Vec<(&str, &str, &AllanCurve)> = curves.collect();
    let Some((.., first)) = curves.first().copied() else { return String::new() };
    curves.retain(|(.., curve)| curve.unit == first.unit);
    let across = Axis::logarithmic(curves.iter().flat_map(|(.., curve)| &curve.tau_s).copied());
    let ends = curves.iter().flat_map(|(.., curve)| curve.ci68_low.iter().chain(&curve.ci68_high));
    let (Some(across), Some(up)) = (across, Axis::logarithmic(ends.copied())) else { return String::new() };
    let (title, y) = (format!("Allan deviation, {channel}"), format!("Allan deviation in {}", first.unit));
    let frame = Frame { title: &title, x: "averaging time τ in s", y: &y, height: 360.0 };
    let key: Vec<(&str, &str)> = curves.iter().map(|(class, name, _)| (*class, *name)).collect();
    let mut drawing = Drawing::keyed(frame, &key, across, up);
    curves.iter().for_each(|(class, _, curve)| drawn(&mut drawing, class, curve));
    drawing.done()
}

/// Draws a curve on its band.
fn drawn(drawing: &mut Drawing, class: &str, curve: &AllanCurve) {
    let band = curve.tau_s.iter().zip(curve.ci68_low.iter().zip(&curve.ci68_high));
    let band: Vec<(f64, f64, f64)> = band.map(|(tau, (low, high))| (*tau, *low, *high)).collect();
    drawing.surface(class, &band);
    drawing.curve(class, curve.tau_s.iter().copied().zip(curve.deviation.iter().copied()));
}

fn borrowed<'a>(key: &'a [(&'a str, String)]) -> Vec<(&'a str, &'a str)> {
    key.iter().map(|(class, text)| (*class, text.as_str())).collect()
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
        let beside = |channel| deviation_beside(channel, [("<night>", &allan), ("foam", &allan)]);
        let two = beside(Channel::GyroY);
        let counts =
            ["surface one", "surface second", "line one", "line second"].map(|class| two.matches(class).count());
        assert_eq!(counts, [1, 1, 2, 2], "{two}");
        assert!(two.contains("&lt;night&gt;") && two.contains(">foam<") && !two.contains("<night>"), "{two}");
        assert_eq!(beside(Channel::AccelX), "");
        let mut other = allan.clone();
        other.channels.get_mut(&Channel::GyroY).unwrap().unit = "°/s".to_owned();
        let one = deviation_beside(Channel::GyroY, [("night", &allan), ("foam", &other)]);
        assert!(one.contains(">night<") && !one.contains(">foam<"), "{one}");
    }
}
