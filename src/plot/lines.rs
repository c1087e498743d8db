//! Lines: the narrow peaks that an analysis found, by name, for the spectra that contain them.

use super::number::rounded;
use serde::Deserialize;
use std::collections::BTreeMap;

/// Lines that differ by less than this part of their frequency are one: channels of one sensor are subject to the same
/// machine.
const SAME: f64 = 5e-3;

/// The parts of `vn100d-noise-1` that are read.
#[derive(Debug, Deserialize)]
struct Noise {
    #[serde(default)]
    disturbances: BTreeMap<String, Disturbances>,
}

#[derive(Debug, Deserialize)]
struct Disturbances {
    #[serde(default)]
    lines: Vec<Line>,
}

#[derive(Debug, Deserialize)]
struct Line {
    frequency_hz: f64,
    amplitude: f64,
    #[serde(default)]
    broad: bool,
    #[serde(default)]
    may_be_mains_hz: Vec<f64>,
}

/// A line of a channel.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedLine {
    /// Its channel.
    pub channel: String,
    /// The frequency of its centre, Hz.
    pub frequency_hz: f64,
    /// The amplitude of a sinusoid with its power, channel's unit.
    pub amplitude: f64,
    /// Whether it is a band of vibration.
    pub broad: bool,
    /// Mains frequencies that sampling folds to this frequency, Hz.
    pub may_be_mains_hz: Vec<f64>,
}

/// All lines of `vn100d-noise-1`; none without the document.
///
/// # Errors
/// The error of a text that is no such document.
pub fn lines(noise: Option<&str>) -> Result<Vec<NamedLine>, serde_json::Error> {
    let Some(noise) = noise else { return Ok(Vec::new()) };
    let document: Noise = serde_json::from_str(noise)?;
    let of = |(channel, own): (String, Disturbances)| {
        own.lines.into_iter().map(move |line| NamedLine {
            channel: channel.clone(),
            frequency_hz: line.frequency_hz,
            amplitude: line.amplitude,
            broad: line.broad,
            may_be_mains_hz: line.may_be_mains_hz,
        })
    };
    Ok(document.disturbances.into_iter().flat_map(of).collect())
}

/// The lines of these channels by frequency, with those of several channels combined: frequency in Hz, the largest
/// amplitude, and a description.
pub(super) fn joined(lines: &[NamedLine], channels: &[&str], unit: &str) -> Vec<(f64, f64, String)> {
    let mut own: Vec<&NamedLine> = lines.iter().filter(|line| channels.contains(&line.channel.as_str())).collect();
    own.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    own.chunk_by(|a, b| b.frequency_hz - a.frequency_hz < SAME * b.frequency_hz)
        .map(|together| {
            let strongest = together.iter().copied().max_by(|a, b| a.amplitude.total_cmp(&b.amplitude));
            let strongest = strongest.unwrap_or(together[0]);
            let names: Vec<&str> = together.iter().map(|line| line.channel.as_str()).collect();
            let mut told = format!(
                "{}{} Hz on {}: amplitude {} {unit}",
                if strongest.broad { "vibration around " } else { "" },
                rounded(strongest.frequency_hz, 4),
                names.join(", "),
                rounded(strongest.amplitude, 2)
            );
            if let Some(mains) = strongest.may_be_mains_hz.first() {
                told += &format!(", perhaps {} Hz from the mains", rounded(*mains, 3));
            }
            (strongest.frequency_hz, strongest.amplitude, told)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_line_of_two_channels_is_one() {
        let line = |hz: f64, amplitude: f64| {
            json!({"frequency_hz": hz, "band_hz": [hz, hz], "amplitude": amplitude,
            "ratio": 9.0, "persistent": true, "broad": false, "may_be_mains_hz": [50.0]})
        };
        let noise = json!({"disturbances": {"gyro_x": {"lines": [line(10.0, 1e-3)]},
            "gyro_y": {"lines": [line(10.001, 3e-3), line(12.0, 1e-3)]}, "accel_x": {"lines": [line(3.0, 1.0)]}}});
        let found = lines(Some(&noise.to_string())).unwrap();
        assert_eq!((found.len(), lines(None).unwrap().len()), (4, 0));
        let told = joined(&found, &["gyro_x", "gyro_y"], "rad/s");
        assert_eq!(told.len(), 2);
        assert_eq!(
            (told[0].0, told[0].2.as_str()),
            (10.001, "10 Hz on gyro_x, gyro_y: amplitude 0.003 rad/s, perhaps 50 Hz from the mains")
        );
        assert!(lines(Some("7")).is_err());
    }
}
