//! The heat map of a sim-to-real gap: channel by frequency, before and after.

use super::drawing::escaped_title;
use super::escaped;
use super::number::rounded;
use super::spectra::Spectra;
use std::fmt::Write as _;

/// Bands across, of equal width in the logarithm of the frequency.
const BANDS: usize = 28;
/// The map's width in its own units, room for the channels' names, and the height of a row.
const WIDTH: f64 = 560.0;
const LEFT: f64 = 84.0;
const RIGHT: f64 = 14.0;
const ROW: f64 = 22.0;
/// A density that is off by this much has the full colour, dB.
const FULL_DB: f64 = 10.0;
/// Differences below this are no colour, dB: spectra are estimates.
const NONE_DB: f64 = 0.3;

/// Both maps, one above the other; empty where no channel's model is known.
#[must_use]
pub fn heat(spectra: &[Spectra]) -> String {
    let known: Vec<&Spectra> = spectra.iter().filter(|of| of.before.is_some()).collect();
    let ends = known.iter().flat_map(|of| &of.frequency_hz).filter(|hz| **hz > 0.0 && hz.is_finite());
    let (low, high) = ends.fold((f64::INFINITY, 0.0f64), |(low, high), hz| (low.min(*hz), high.max(*hz)));
    if !(low.is_finite() && high > low) {
        return String::new();
    }
    let scale = Scale { low: low.ln(), step: (high / low).ln() / BANDS as f64 };
    let mut out = map("the model as it is", &known, &scale, |of| of.before.as_deref());
    if known.iter().any(|of| of.after.is_some()) {
        out += &map("the corrected model", &known, &scale, |of| of.after.as_deref().or(of.before.as_deref()));
    }
    out
}

/// Where a frequency lies.
struct Scale {
    low: f64,
    step: f64,
}

impl Scale {
    fn band(&self, hz: f64) -> usize {
        (((hz.ln() - self.low) / self.step) as usize).min(BANDS - 1)
    }
    fn from_hz(&self, band: usize) -> f64 {
        (self.low + self.step * band as f64).exp()
    }
}

fn map<'a>(
    what: &str,
    channels: &[&'a Spectra],
    scale: &Scale,
    model: impl Fn(&'a Spectra) -> Option<&'a [f64]>,
) -> String {
    let (top, height) = (30.0, 30.0 + ROW * channels.len() as f64 + 46.0);
    let title = format!("Recording over {what}, by channel and frequency");
    let mut out = escaped_title(&title, WIDTH, height, LEFT);
    let width = (WIDTH - LEFT - RIGHT) / BANDS as f64;
    for (row, of) in channels.iter().enumerate() {
        let y = top + ROW * row as f64;
        // Writing to a text cannot fail.
        let _ = write!(
            out,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>",
            LEFT - 7.0,
            y + 16.0,
            escaped(of.channel())
        );
        let Some(model) = model(of) else { continue };
        for (band, db) in differences(of, model, scale).into_iter().enumerate() {
            let x = LEFT + width * band as f64;
            let Some(db) = db else { continue };
            let strength = if db.abs() < NONE_DB { 0.0 } else { (db.abs() / FULL_DB).min(1.0) };
            let class = if db > 0.0 { "louder" } else { "quieter" };
            let told = format!(
                "{}, {} to {} Hz: {}{} dB",
                of.channel(),
                rounded(scale.from_hz(band), 2),
                rounded(scale.from_hz(band + 1), 2),
                if db > 0.0 { "+" } else { "" },
                rounded(db, 2)
            );
            let _ = write!(
                out,
                "<rect class=\"cell {class}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{}\" fill-opacity=\"{strength:.2}\">\
                 <title>{}</title></rect>",
                width - 0.6,
                ROW - 2.0,
                escaped(&told)
            );
        }
    }
    let bottom = top + ROW * channels.len() as f64;
    for band in (0..=BANDS).step_by(BANDS / 4) {
        let anchor = if band == BANDS { "end" } else { "middle" };
        let _ = write!(
            out,
            "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"{anchor}\">{}</text>",
            LEFT + width * band as f64,
            bottom + 16.0,
            rounded(scale.from_hz(band), 2)
        );
    }
    let _ = write!(
        out,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">frequency in Hz; orange: louder than the model, blue: quieter, full at {FULL_DB} dB\
         </text></svg>",
        0.5 * (LEFT + WIDTH - RIGHT),
        bottom + 36.0
    );
    out
}

/// The recording's power over the model's in each band, dB; None where there is no frequency or no power.
fn differences(of: &Spectra, model: &[f64], scale: &Scale) -> [Option<f64>; BANDS] {
    let mut sums = [[0.0f64; 2]; BANDS];
    for ((hz, real), model) in of.frequency_hz.iter().zip(&of.real).zip(model) {
        if *hz > 0.0 && real.is_finite() && model.is_finite() && *model > 0.0 {
            let [sum, own] = &mut sums[scale.band(*hz)];
            *sum += real * real;
            *own += model * model;
        }
    }
    sums.map(|[real, own]| (real > 0.0 && own > 0.0).then(|| 10.0 * (real / own).log10()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_band_that_is_off_has_colour_before_and_none_after() {
        let hz: Vec<f64> = (1..=200).map(|bin| 0.1 * f64::from(bin)).collect();
        let real: Vec<f64> = hz.iter().map(|hz| if (10.0..11.0).contains(hz) { 10.0 } else { 1.0 }).collect();
        let of: Spectra =
            serde_json::from_value(json!({"channel": "<x>", "unit": "rad/s", "frequency_hz": hz, "real": real,
            "before": vec![1.0; 200], "after": real}))
            .unwrap();
        let svg = heat(&[of]);
        let (before, after) = svg.split_once("</svg>").unwrap();
        let strong = |part: &str| part.matches("class=\"cell louder\"").count();
        assert!(strong(before) >= 1 && strong(after) == 0, "{svg}");
        assert!(before.contains("fill-opacity=\"1.00\"") && !after.contains("fill-opacity=\"1.00\""));
        assert!(!svg.contains("<x>") && !svg.contains("NaN"));
        assert_eq!(heat(&[]), "");
    }
}
