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
/// A power that is off by this much has the full colour, dB.
const FULL_DB: f64 = 10.0;
/// A band whose Whittle discrepancy is smaller than this many nats may be chance: of a true model it is ½χ² with one degree of
/// freedom, beyond 6 in one of 1900 bands.
const CHANCE_NATS: f64 = 6.0;
/// Where nobody tells how many coefficients a bin has: differences below this are no colour, dB.
const NONE_DB: f64 = 0.5;

/// The maps, before and after; none where no channel's model is known.
#[must_use]
pub fn heat(spectra: &[Spectra]) -> Vec<String> {
    let known: Vec<&Spectra> = spectra.iter().filter(|of| of.before.is_some()).collect();
    let ends = known.iter().flat_map(|of| &of.frequency_hz).filter(|hz| **hz > 0.0 && hz.is_finite());
    let (low, high) = ends.fold((f64::INFINITY, 0.0f64), |(low, high), hz| (low.min(*hz), high.max(*hz)));
    if !(low.is_finite() && high > low) {
        return Vec::new();
    }
    let scale = Scale { low: low.ln(), step: (high / low).ln() / BANDS as f64 };
    let mut maps = vec![map("the model as it is", &known, &scale, |of| Some((of.before.as_deref()?, of.scatter[0])))];
    if known.iter().any(|of| of.after.is_some()) {
        maps.push(map("the corrected model", &known, &scale, |of| Some((of.after.as_deref()?, of.scatter[1]))));
    }
    maps
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
    fn begin_hz(&self, band: usize) -> f64 {
        (self.low + self.step * band as f64).exp()
    }
}

fn map<'a>(
    what: &str,
    channels: &[&'a Spectra],
    scale: &Scale,
    model: impl Fn(&'a Spectra) -> Option<(&'a [f64], f64)>,
) -> String {
    let (top, height) = (30.0, 30.0 + ROW * channels.len() as f64 + 46.0);
    let title = format!("Recording over {what}");
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
        for (band, difference) in differences(of, model, scale).into_iter().enumerate() {
            let x = LEFT + width * band as f64;
            let Some(Difference { db, sure }) = difference else { continue };
            // The least that is seen beside nothing.
            let strength = if sure { (db.abs() / FULL_DB).clamp(0.1, 1.0) } else { 0.0 };
            let class = if db > 0.0 { "louder" } else { "quieter" };
            let told = format!(
                "{}, {} to {} Hz: {}{} dB{}",
                of.channel(),
                rounded(scale.begin_hz(band), 2),
                rounded(scale.begin_hz(band + 1), 2),
                if db > 0.0 { "+" } else { "" },
                rounded(db, 2),
                if sure { "" } else { ", within chance" }
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
            rounded(scale.begin_hz(band), 2)
        );
    }
    let _ = write!(
        out,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">frequency in Hz; orange louder, blue quieter, full at {FULL_DB} dB</text></svg>",
        0.5 * (LEFT + WIDTH - RIGHT),
        bottom + 36.0
    );
    out
}

/// The recording's power over the model's in a band.
#[derive(Debug, Clone, Copy)]
struct Difference {
    db: f64,
    /// Beyond chance.
    sure: bool,
}

/// Band by band: the mean of the ratios of the bins' powers, weighted by their coefficients, as the likelihood weighs them
/// (Whittle 1953). None where there is no frequency or no power.
fn differences(of: &Spectra, (model, scatter): (&[f64], f64), scale: &Scale) -> [Option<Difference>; BANDS] {
    let mut sums = [[0.0f64; 2]; BANDS];
    for (bin, ((hz, real), model)) in of.frequency_hz.iter().zip(&of.real).zip(model).enumerate() {
        if *hz > 0.0 && real.is_finite() && model.is_finite() && *model > 0.0 {
            let weight = of.coefficients.get(bin).copied().unwrap_or(1.0);
            let [ratios, weights] = &mut sums[scale.band(*hz)];
            *ratios += weight * (real / model).powi(2);
            *weights += weight;
        }
    }
    sums.map(|[ratios, weights]| {
        let ratio = ratios / weights;
        (ratio > 0.0 && ratio.is_finite()).then(|| {
            let db = 10.0 * ratio.log10();
            let nats = 0.5 * weights / scatter.max(1.0) * (ratio - 1.0 - ratio.ln());
            let sure = if of.coefficients.is_empty() { db.abs() > NONE_DB } else { nats > CHANCE_NATS };
            Difference { db, sure }
        })
    })
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
        let maps = heat(&[of]);
        let [before, after] = maps.as_slice() else { panic!("{maps:?}") };
        let strong = |part: &str| part.matches("class=\"cell louder\"").count();
        assert!(strong(before) >= 1 && strong(after) == 0, "{maps:?}");
        assert!(before.contains("fill-opacity=\"1.00\"") && !after.contains("fill-opacity=\"1.00\""));
        assert!(!before.contains("<x>") && !before.contains("NaN"));
        assert!(heat(&[]).is_empty());
    }

    #[test]
    fn what_chance_makes_has_no_colour() {
        // 3 dB more in every bin: with six coefficients in the whole band chance does that, with six hundred it does not.
        let map = |coefficients: f64| {
            let of = json!({"channel": "x", "unit": "rad/s", "frequency_hz": [0.1, 10.0], "real": [1.41, 1.41],
                "coefficients": [coefficients, coefficients], "before": [1.0, 1.0], "after": null});
            heat(&[serde_json::from_value(of).unwrap()]).concat()
        };
        assert!(map(6.0).contains("within chance") && map(6.0).contains("fill-opacity=\"0.00\""), "{}", map(6.0));
        assert!(
            !map(600.0).contains("within chance") && map(600.0).contains("fill-opacity=\"0.30\""),
            "{}",
            map(600.0)
        );
    }
}
