//! The heat map of a sim-to-real gap: channel by frequency, before and after.

use super::drawing::escaped_title;
use super::escaped;
use super::number::rounded;
use imu_diagnosis::ChannelSpectra;
use std::fmt::Write as _;

/// Bands across, of equal width in the logarithm of the frequency.
const BANDS: usize = 28;
/// The map's width in its own units, room for the channels' names, and the height of a row.
const WIDTH: f64 = 560.0;
const LEFT: f64 = 84.0;
const RIGHT: f64 = 14.0;
const ROW: f64 = 22.0;
/// The discrepancy of a band beyond its expectation that may be chance, nats. For a true model it is ½χ² less its mean,
/// with a degree of freedom for each bin. With one degree it exceeds 8 in one of 27,000 bands, and a page has some five
/// hundred. Its deviation grows as the root of the number of bins.
const CHANCE_NATS: f64 = 8.0;
/// The range from full colour down to the palest, decades of the discrepancy.
const DECADES: f64 = 3.0;
/// The strength of the palest colour, relative to full colour.
const PALEST: f64 = 0.15;
/// If the number of coefficients per bin is unknown, smaller differences than this have no colour, dB.
const NONE_DB: f64 = 0.5;

/// Returns the maps, before and after; none if no channel's model is known.
pub fn heat(spectra: &[ChannelSpectra]) -> Vec<String> {
    let known: Vec<&ChannelSpectra> = spectra.iter().filter(|of| of.before.is_some()).collect();
    let ends = known.iter().flat_map(|of| &of.frequency_hz).filter(|hz| **hz > 0.0 && hz.is_finite());
    let (low, high) = ends.fold((f64::INFINITY, 0.0f64), |(low, high), hz| (low.min(*hz), high.max(*hz)));
    if !(low.is_finite() && high > low) {
        return Vec::new();
    }
    let scale = Scale { low: low.ln(), step: (high / low).ln() / BANDS as f64 };
    let before: Vec<Row<'_>> = known.iter().map(|of| row(of, 0, &scale)).collect();
    let after: Vec<Row<'_>> = known.iter().map(|of| row(of, 1, &scale)).collect();
    let all = before.iter().chain(&after).flat_map(|row| row.bands).flatten();
    let most = all.filter(|of| of.sure).map(|of| of.nats).fold(0.0, f64::max);
    let mut maps = vec![map("the model as it is", &before, &scale, most)];
    if known.iter().any(|of| of.after.is_some()) {
        maps.push(map("the corrected model", &after, &scale, most));
    }
    maps
}

/// One channel's bands.
struct Row<'a> {
    channel: &'a str,
    bands: [Option<Difference>; BANDS],
}

fn row<'a>(of: &'a ChannelSpectra, which: usize, scale: &Scale) -> Row<'a> {
    let ratios = over_model(of, which);
    let bands = ratios.map_or([None; BANDS], |ratios| differences(of, &ratios, of.simulated[which], scale));
    Row { channel: &of.channel, bands }
}

/// Returns the record's power over the model's in each bin, before (0) or after (1).
fn over_model(of: &ChannelSpectra, which: usize) -> Option<Vec<f64>> {
    let model = [&of.before, &of.after][which].as_ref()?;
    let ratios = || of.real.iter().zip(model).map(|(real, model)| (real / model).powi(2)).collect();
    Some(of.ratios[which].clone().unwrap_or_else(ratios))
}

/// The position of a frequency.
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

/// Returns one map; `most` is the greatest discrepancy of both, nats.
fn map(what: &str, rows: &[Row<'_>], scale: &Scale, most: f64) -> String {
    let (top, height) = (30.0, 30.0 + ROW * rows.len() as f64 + 46.0);
    let title = format!("Recording over {what}");
    let mut out = escaped_title(&title, WIDTH, height, LEFT);
    let width = (WIDTH - LEFT - RIGHT) / BANDS as f64;
    for (place, Row { channel, bands }) in rows.iter().enumerate() {
        let y = top + ROW * place as f64;
        // Writing to a text cannot fail.
        let _ = write!(
            out,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>",
            LEFT - 7.0,
            y + 16.0,
            escaped(channel)
        );
        for (band, difference) in bands.iter().enumerate() {
            let x = LEFT + width * band as f64;
            let Some(Difference { db, nats, sure }) = *difference else { continue };
            let strength = match sure {
                true => (1.0 + (1.0 - PALEST) * (nats / most).log10() / DECADES).clamp(PALEST, 1.0),
                false => 0.0,
            };
            let class = if db > 0.0 { "louder" } else { "quieter" };
            let description = format!(
                "{channel}, {} to {} Hz: {}{} dB, {}",
                rounded(scale.begin_hz(band), 2),
                rounded(scale.begin_hz(band + 1), 2),
                if db > 0.0 { "+" } else { "" },
                rounded(db, 2),
                if sure { format!("{} nats", rounded(nats, 2)) } else { "within chance".to_owned() }
            );
            let _ = write!(
                out,
                "<rect class=\"cell {class}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{}\" fill-opacity=\"{strength:.2}\">\
                 <title>{}</title></rect>",
                width - 0.6,
                ROW - 2.0,
                escaped(&description)
            );
        }
    }
    let bottom = top + ROW * rows.len() as f64;
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
    let full = if most > 0.0 { format!(", full at {} nats", rounded(most, 2)) } else { String::new() };
    let _ = write!(
        out,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">frequency in Hz; orange louder, blue quieter{full}</text></svg>",
        0.5 * (LEFT + WIDTH - RIGHT),
        bottom + 36.0
    );
    out
}

/// The recording's power over the model's in a band.
#[derive(Debug, Clone, Copy)]
struct Difference {
    db: f64,
    /// Whittle's discrepancy beyond that expected of a true model.
    nats: f64,
    /// Whether it is beyond chance.
    sure: bool,
}

/// The sums of a band.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    ratios: f64,
    weights: f64,
    nats: f64,
    bins: f64,
}

/// Computes, band by band over its bins, Σ ½w(r − 1 − ln r) (Whittle 1953). r is the mean ratio of the powers, and w
/// the number of coefficients, divided by `scatter` because their chance is greater by that factor. For a simulation,
/// whose powers are subject to chance as well, it is the likelihood ratio of two samples of equal size, Σ w(ln((1 +
/// r)/2) − ½ ln r). `None` if there is no frequency or no power.
fn differences(of: &ChannelSpectra, ratios: &[f64], simulated: bool, scale: &Scale) -> [Option<Difference>; BANDS] {
    let mut sums = [Sum::default(); BANDS];
    for (bin, (hz, ratio)) in of.frequency_hz.iter().zip(ratios.iter().copied()).enumerate() {
        if *hz > 0.0 && ratio > 0.0 && ratio.is_finite() {
            let weight = of.coefficients.get(bin).copied().unwrap_or(1.0) / of.scatter.max(1.0);
            let sum = &mut sums[scale.band(*hz)];
            sum.ratios += weight * ratio;
            sum.weights += weight;
            sum.nats += match simulated {
                true => weight * ((0.5 * (1.0 + ratio)).ln() - 0.5 * ratio.ln()),
                false => 0.5 * weight * (ratio - 1.0 - ratio.ln()),
            };
            sum.bins += 1.0;
        }
    }
    sums.map(|Sum { ratios, weights, nats, bins }| {
        let db = 10.0 * (ratios / weights).log10();
        let nats = nats - 0.5 * bins;
        let sure = match of.coefficients.is_empty() {
            true => db.abs() > NONE_DB,
            false => nats > CHANCE_NATS * (0.5 * bins).sqrt().max(1.0),
        };
        (bins > 0.0).then_some(Difference { db, nats: nats.max(f64::MIN_POSITIVE), sure })
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
        let of: ChannelSpectra =
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
    fn a_line_in_a_wide_band_is_seen_and_the_louder_one_is_darker() {
        // Ten bins of a hundred coefficients in each band of 1.2 to 1.
        let hz: Vec<f64> = (0..280).map(|bin| (0.02 * f64::from(bin)).exp()).collect();
        let line = |at: usize| (0..280).map(|bin| if bin == at { 4.0 } else { 1.0 }).collect::<Vec<f64>>();
        let of = |channel: &str, real: &[f64]| {
            json!({"channel": channel, "unit": "rad/s", "frequency_hz": hz, "real": real, "coefficients": vec![100.0; 280],
                "before": vec![1.0; 280], "after": null})
        };
        let mut weaker = line(155);
        weaker[155] = 2.0;
        let spectra = [of("a", &line(105)), of("b", &weaker)].map(|of| serde_json::from_value(of).unwrap());
        let [map] = heat(&spectra).try_into().unwrap();
        let strengths: Vec<f64> =
            map.split("fill-opacity=\"").skip(1).map(|of| of.split('"').next().unwrap().parse().unwrap()).collect();
        let coloured: Vec<f64> = strengths.into_iter().filter(|strength| *strength > 0.0).collect();
        assert!(
            matches!(coloured.as_slice(), [full, less] if *full == 1.0 && (0.15..0.9).contains(less)),
            "{coloured:?}"
        );
    }

    #[test]
    fn what_chance_makes_has_no_colour() {
        // 3 dB more in every bin: with six coefficients in a band chance does that, with six hundred it does not.
        let map = |coefficients: f64| {
            let of = json!({"channel": "x", "unit": "rad/s", "frequency_hz": [0.1, 10.0], "real": [1.41, 1.41],
                "coefficients": [coefficients, coefficients], "before": [1.0, 1.0], "after": null});
            heat(&[serde_json::from_value(of).unwrap()]).concat()
        };
        assert!(map(6.0).contains("within chance") && map(6.0).contains("fill-opacity=\"0.00\""), "{}", map(6.0));
        assert!(
            !map(600.0).contains("within chance") && map(600.0).contains("fill-opacity=\"1.00\""),
            "{}",
            map(600.0)
        );
    }
}
