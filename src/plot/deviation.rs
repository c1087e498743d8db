//! Allan deviation: curves with their 68 % bands, the fits, and the lines of N, B and K.

use super::axis::Axis;
use super::drawing::{Drawing, Frame};
use super::number::rounded;
use serde::Deserialize;
use std::collections::BTreeMap;

/// The parts of `vn100d-allan-1` that are drawn.
#[derive(Debug, Deserialize)]
struct Allan {
    channels: BTreeMap<String, Curve>,
}

#[derive(Debug, Deserialize)]
struct Curve {
    unit: String,
    tau_s: Vec<f64>,
    deviation: Vec<f64>,
    ci68_low: Vec<f64>,
    ci68_high: Vec<f64>,
}

/// The parts of `vn100d-noise-1` that are drawn.
#[derive(Debug, Default, Deserialize)]
struct Noise {
    channels: BTreeMap<String, Found>,
}

#[derive(Debug, Deserialize)]
struct Found {
    #[serde(rename = "N")]
    n: Option<Parameter>,
    #[serde(rename = "B")]
    b: Option<Parameter>,
    #[serde(rename = "K")]
    k: Option<Parameter>,
    fit: Option<Fit>,
}

#[derive(Debug, Deserialize)]
struct Parameter {
    value: Option<f64>,
    unit: String,
}

#[derive(Debug, Deserialize)]
struct Fit {
    curve: Option<Fitted>,
}

#[derive(Debug, Deserialize)]
struct Fitted {
    tau_s: Vec<f64>,
    deviation: Vec<f64>,
    #[serde(default)]
    parts: BTreeMap<String, Vec<f64>>,
}

/// The drawable data of one capture.
#[derive(Debug)]
pub struct Deviations {
    allan: Allan,
    noise: Noise,
}

impl Deviations {
    /// Reads `vn100d-allan-1` and, if given, `vn100d-noise-1`, as JSON.
    ///
    /// # Errors
    /// The error of a text that is none of these documents.
    pub fn read(allan: &str, noise: Option<&str>) -> Result<Self, serde_json::Error> {
        let noise = noise.map(serde_json::from_str).transpose()?.unwrap_or_default();
        Ok(Self { allan: serde_json::from_str(allan)?, noise })
    }

    /// One picture of these channels, which have one unit: `gyro_x`, `gyro_y`, `gyro_z`, or a single channel, which
    /// then also has its lines of N, B and K. Empty if there is no curve.
    pub fn svg(&self, title: &str, channels: &[&str]) -> String {
        let curves: Vec<(&str, &Curve)> =
            channels.iter().filter_map(|name| Some((*name, self.allan.channels.get(*name)?))).collect();
        let Some((_, first)) = curves.first() else { return String::new() };
        let across = Axis::logarithmic(curves.iter().flat_map(|(_, curve)| &curve.tau_s).copied());
        let up = Axis::logarithmic(
            curves.iter().flat_map(|(_, curve)| curve.ci68_low.iter().chain(&curve.ci68_high)).copied(),
        );
        let (Some(across), Some(up)) = (across, up) else { return String::new() };
        let y = format!("Allan deviation in {}", first.unit);
        let frame = Frame { title, x: "averaging time τ in s", y: &y, height: 360.0 };
        let mut drawing = Drawing::new(frame, across, up);
        let mut key: Vec<(&str, String)> = Vec::new();
        for (name, curve) in &curves {
            let class = class(name, curves.len());
            let band = curve.tau_s.iter().zip(curve.ci68_low.iter().zip(&curve.ci68_high));
            let band: Vec<(f64, f64, f64)> = band.map(|(tau, (low, high))| (*tau, *low, *high)).collect();
            drawing.surface(class, &band);
            drawing.curve(class, curve.tau_s.iter().copied().zip(curve.deviation.iter().copied()));
            key.push((class, (*name).to_owned()));
            let Some(found) = self.noise.channels.get(*name) else { continue };
            let Some(fitted) = found.fit.as_ref().and_then(|fit| fit.curve.as_ref()) else { continue };
            drawing.curve("fit", fitted.tau_s.iter().copied().zip(fitted.deviation.iter().copied()));
            if curves.len() > 1 {
                continue;
            }
            key.push(("fit", "fitted".to_owned()));
            for (part, of) in [("N", &found.n), ("B", &found.b), ("K", &found.k)] {
                let value = of.as_ref().and_then(|of| Some((of.value?, of.unit.as_str())));
                if let (Some(values), Some((value, unit))) = (fitted.parts.get(part), value) {
                    drawing.curve(part, fitted.tau_s.iter().copied().zip(values.iter().copied()));
                    key.push((part, format!("{part} {} {unit}", rounded(value, 3))));
                }
            }
        }
        let key: Vec<(&str, &str)> = key.iter().map(|(class, text)| (*class, text.as_str())).collect();
        drawing.key_below(&key);
        drawing.done()
    }
}

/// The class of a channel's curve among others: its axis.
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
    use serde_json::json;

    fn documents() -> (String, String) {
        let curve = json!({"unit": "rad/s", "tau_s": [0.1, 1.0, 10.0], "deviation": [3e-4, 1e-4, 5e-5],
            "ci68_low": [2.9e-4, 9e-5, 3e-5], "ci68_high": [3.1e-4, 1.1e-4, 8e-5], "edf": [1, 1, 1], "n": [1, 1, 1]});
        let found = json!({"unit": "rad/s", "N": {"value": 1e-4, "unit": "rad/s/√Hz"}, "B": {"value": null, "unit": "rad/s"},
            "K": {"value": 2e-6, "unit": "rad/s/√s"}, "fit": {"curve": {"tau_s": [0.1, 10.0], "deviation": [3e-4, 5e-5],
            "parts": {"N": [3e-4, 3e-5], "K": [1e-7, 4e-6]}}}});
        let allan = json!({"format": "vn100d-allan-1", "channels": {"gyro_x": curve, "gyro_y": curve}});
        (allan.to_string(), json!({"channels": {"gyro_x": found}}).to_string())
    }

    #[test]
    fn a_triad_has_curves_and_bands_and_one_channel_its_lines() {
        let (allan, noise) = documents();
        let of = Deviations::read(&allan, Some(&noise)).unwrap();
        let triad = of.svg("Allan deviation, gyro", &["gyro_x", "gyro_y", "gyro_z"]);
        assert_eq!((triad.matches("class=\"surface").count(), triad.matches("line fit").count()), (2, 1), "{triad}");
        assert!(triad.contains("Allan deviation in rad/s") && triad.contains("averaging time τ in s"));
        let one = of.svg("gyro_x", &["gyro_x"]);
        // B has no value and no line.
        assert!(
            one.contains("N 1·10⁻⁴ rad/s/√Hz") && one.contains("K 2·10⁻⁶ rad/s/√s") && !one.contains("line B"),
            "{one}"
        );
        assert_eq!(of.svg("none", &["accel_x"]), "");
        assert!(Deviations::read("{}", None).is_err());
    }
}
