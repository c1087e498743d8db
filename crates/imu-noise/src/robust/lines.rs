//! Lines: narrow peaks of the spectrum that noise does not make, and bands filled by vibration.

use super::spectrum::{STRETCHES, Spectrum};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::cmp::Ordering;

/// Lines expected by chance in a record of pure noise.
const BY_CHANCE: f64 = 1e-4;
/// A peak below this multiple of the background has no material effect and is ignored.
const LEAST_RATIO: f64 = 1.5;
/// A line extends as far as its power exceeds this multiple of the background.
const FOOT: f64 = 1.25;
/// A stretch of the record has the line if its power there exceeds this multiple of the background.
const PRESENT: f64 = 1.5;
/// Number of bins on each side into which a Hann window spreads a pure tone.
const SMEAR: usize = 2;
/// Mains frequencies and twice these frequencies, Hz.
const MAINS_HZ: [f64; 4] = [50.0, 60.0, 100.0, 120.0];

/// A line, or a band filled by vibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Line {
    /// Frequency of its centre as recorded, Hz: true frequencies beyond half the rate appear folded.
    pub frequency_hz: f64,
    /// The band that is left out of the fit, Hz.
    pub band_hz: [f64; 2],
    /// Peak amplitude of a sinusoid of the line's power, in the channel's unit.
    pub amplitude: f64,
    /// Highest power density over the background.
    pub ratio: f64,
    /// Whether the line is present in at least three quarters of the record.
    pub persistent: bool,
    /// Whether this is a band of vibration, not a line.
    pub broad: bool,
    /// Mains frequencies, or twice these, that sampling folds to this frequency.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub may_be_mains_hz: Vec<f64>,
}

/// Returns the lines of a spectrum, by frequency.
pub(super) fn find(spectrum: &Spectrum, rate_hz: f64) -> Vec<Line> {
    let bins = spectrum.power.len();
    let Some(threshold) = threshold(spectrum) else { return Vec::new() };
    let ratio = |bin: usize| spectrum.power[bin] / spectrum.background[bin];
    let mut lines = Vec::new();
    let mut bin = Spectrum::FIRST;
    // The bin at half the rate has half the degrees of freedom: a line may extend into it, but does not begin there.
    while bin + 1 < bins {
        if ratio(bin) < threshold {
            bin += 1;
            continue;
        }
        let (mut from, mut to) = (bin, bin);
        while from > Spectrum::FIRST && ratio(from - 1) > FOOT {
            from -= 1;
        }
        // A peak continues as long as one of the next three bins stands out.
        while (1..=3).any(|ahead| to + ahead < bins && ratio(to + ahead) > FOOT) {
            to += 1;
        }
        lines.push(line(spectrum, from, to, rate_hz));
        bin = to + 1;
    }
    lines
}

/// Returns the ratio to the background that a bin exceeds by chance once in 1 / [`BY_CHANCE`] records.
fn threshold(spectrum: &Spectrum) -> Option<f64> {
    let degrees = 2.0 * spectrum.windows;
    let tail = BY_CHANCE / spectrum.power.len() as f64;
    let quantile = ChiSquared::new(degrees).ok()?.inverse_cdf(1.0 - tail) / degrees;
    // The background is a median, which lies below the mean, and is itself only known to some 10 %.
    let median = (1.0 - 2.0 / (9.0 * degrees)).powi(3);
    Some((1.1 * quantile / median).max(LEAST_RATIO))
}

fn line(spectrum: &Spectrum, from: usize, to: usize, rate_hz: f64) -> Line {
    let excess = |bin: usize| (spectrum.power[bin] - spectrum.background[bin]).max(0.0);
    let (mut sum, mut moment, mut ratio) = (0.0, 0.0, 0.0f64);
    for bin in from..=to {
        sum += excess(bin);
        moment += excess(bin) * bin as f64;
        ratio = ratio.max(spectrum.power[bin] / spectrum.background[bin]);
    }
    let frequency_hz = moment / sum.max(f64::MIN_POSITIVE) * spectrum.step_hz;
    let present = spectrum.stretches.iter().filter(|powers| {
        let sum = |values: &[f64]| values.get(from..=to).map_or(0.0, |values| values.iter().sum::<f64>());
        sum(powers) > PRESENT.min(ratio) * sum(&spectrum.background)
    });
    let (low, high) = (from.saturating_sub(SMEAR), to + SMEAR);
    let band_hz = [low as f64 * spectrum.step_hz, (high as f64 * spectrum.step_hz).min(rate_hz / 2.0)];
    Line {
        frequency_hz,
        band_hz,
        amplitude: (2.0 * sum * spectrum.step_hz).sqrt(),
        ratio,
        persistent: present.count() * 4 >= 3 * STRETCHES,
        broad: false,
        may_be_mains_hz: mains(frequency_hz, spectrum.step_hz, rate_hz),
    }
}

/// Returns the mains frequencies that sampling at `rate_hz` folds to `frequency_hz`.
fn mains(frequency_hz: f64, step_hz: f64, rate_hz: f64) -> Vec<f64> {
    let folds = |mains: &f64| {
        let folded = (mains - (mains / rate_hz).round() * rate_hz).abs();
        // Mains wander by some 0.1 Hz in 50 Hz, and the sensor's clock by 20 ppm.
        (folded - frequency_hz).abs() < 1e-3 * mains + 2.0 * step_hz
    };
    MAINS_HZ.into_iter().filter(folds).collect()
}

/// Returns bands in which the background itself rises above the level of the frequencies below: vibration, resonances.
///
/// A sensor's own spectrum falls with frequency (N, B, K) or rises as sin²(πf/rate) (Q). A band that neither describes belongs to
/// the environment.
pub(super) fn vibration(spectrum: &Spectrum, rate_hz: f64) -> Vec<Line> {
    /// Number of bands from 0 to half the rate.
    const BANDS: usize = 24;
    /// Bands that show the level of white noise: above flicker, below the upper half.
    const LEVEL: std::ops::Range<usize> = 1..8;
    /// A band belongs to vibration if the ratio of densities is at least this.
    const RISE: f64 = 1.35;
    let bins = spectrum.power.len();
    if bins < 8 * BANDS {
        return Vec::new();
    }
    let edge = |band: usize| (band * bins / BANDS).max(Spectrum::FIRST);
    let levels: Vec<f64> = (0..BANDS)
        .map(|band| {
            super::scale::median(spectrum.background[edge(band)..edge(band + 1)].iter().copied()).unwrap_or(0.0)
        })
        .collect();
    let Some(level) = super::scale::median(levels[LEVEL].iter().copied()) else { return Vec::new() };
    let sine = |band: usize| (std::f64::consts::PI * (band as f64 + 0.5) / (2.0 * BANDS as f64)).sin().powi(2);
    // Q from the uppermost bands, where it is strongest; it counts only if it describes all bands.
    let slope = (LEVEL.start..BANDS).map(|band| (levels[band] / level - 1.0) * sine(band)).sum::<f64>()
        / (LEVEL.start..BANDS).map(|band| sine(band).powi(2)).sum::<f64>();
    let expected = |band: usize| level * (1.0 + slope.max(0.0) * sine(band));
    if (LEVEL.start..BANDS).all(|band| (0.8..1.25).contains(&(levels[band] / expected(band)))) {
        return Vec::new();
    }
    let raised: Vec<bool> = (0..BANDS).map(|band| band >= 4 && levels[band] > RISE * level).collect();
    if raised.iter().filter(|raised| **raised).count() > 2 * BANDS / 3 {
        return Vec::new();
    }
    let mut found = Vec::new();
    let mut band = 0;
    while band < BANDS {
        let end = (band..BANDS).find(|next| !raised[*next]).unwrap_or(BANDS);
        if end > band {
            let (from, to) = (edge(band), edge(end).min(bins));
            let sum: f64 = spectrum.power[from..to].iter().map(|power| (power - level).max(0.0)).sum();
            let ratio = spectrum.background[from..to].iter().fold(0.0f64, |most, value| most.max(value / level));
            found.push(Line {
                frequency_hz: 0.5 * (from + to) as f64 * spectrum.step_hz,
                band_hz: [from as f64 * spectrum.step_hz, (to as f64 * spectrum.step_hz).min(rate_hz / 2.0)],
                amplitude: (2.0 * sum * spectrum.step_hz).sqrt(),
                ratio,
                persistent: true,
                broad: true,
                may_be_mains_hz: Vec::new(),
            });
        }
        band = end.max(band + 1);
    }
    found
}

/// Joins the lines of a record that was examined in `blocks`, each with its own lines: lines whose bands overlap become
/// one.
pub(super) fn joined(mut lines: Vec<Line>, blocks: usize) -> Vec<Line> {
    if blocks <= 1 {
        return lines;
    }
    lines.sort_by(|a, b| (a.broad, a.band_hz[0]).partial_cmp(&(b.broad, b.band_hz[0])).unwrap_or(Ordering::Equal));
    let overlap = |last: &Vec<Line>, line: &Line| {
        last.iter().any(|known| known.broad == line.broad && line.band_hz[0] <= known.band_hz[1])
    };
    let mut groups: Vec<Vec<Line>> = Vec::new();
    for line in lines {
        match groups.last_mut() {
            Some(last) if overlap(last, &line) => last.push(line),
            _ => groups.push(vec![line]),
        }
    }
    groups.into_iter().filter_map(|group| one(&group, blocks)).collect()
}

/// Joins the lines of the blocks that have them to one line.
fn one(group: &[Line], blocks: usize) -> Option<Line> {
    let first = group.first()?;
    let power = |line: &Line| line.amplitude * line.amplitude;
    let sum: f64 = group.iter().map(power).sum();
    let weighted: f64 = group.iter().map(|line| line.frequency_hz * power(line)).sum();
    let lasting = group.iter().filter(|line| line.persistent).count();
    Some(Line {
        frequency_hz: if sum > 0.0 { weighted / sum } else { first.frequency_hz },
        band_hz: group
            .iter()
            .fold(first.band_hz, |band, line| [band[0].min(line.band_hz[0]), band[1].max(line.band_hz[1])]),
        // Relative to the whole record: blocks without the line count.
        amplitude: (sum / blocks.max(group.len()) as f64).sqrt(),
        ratio: group.iter().fold(0.0, |most, line| most.max(line.ratio)),
        persistent: lasting * 4 >= 3 * blocks,
        broad: first.broad,
        may_be_mains_hz: group
            .iter()
            .map(|line| line.may_be_mains_hz.clone())
            .find(|mains| !mains.is_empty())
            .unwrap_or_default(),
    })
}

/// Returns the density without lines and vibration, per bin: the level to which [`super::excise`] brings the bands
/// down.
pub(super) fn quiet(spectrum: &Spectrum, lines: &[Line]) -> Vec<f64> {
    let mut quiet = spectrum.background.clone();
    let from = Spectrum::FIRST.max(spectrum.power.len() / 24);
    let to = spectrum.power.len() / 3;
    let Some(level) = spectrum.background.get(from..to).and_then(|part| super::scale::median(part.iter().copied()))
    else {
        return quiet;
    };
    for line in lines.iter().filter(|line| line.broad) {
        for (bin, value) in quiet.iter_mut().enumerate() {
            if (line.band_hz[0]..=line.band_hz[1]).contains(&(bin as f64 * spectrum.step_hz)) {
                *value = value.min(level);
            }
        }
    }
    quiet
}

#[cfg(test)]
mod tests {
    use super::super::{Part, synthetic::Noise};
    use super::*;
    use std::f64::consts::PI;

    fn spectrum(values: Vec<f64>, rate_hz: f64) -> Spectrum {
        Spectrum::of(&[Part { start_s: 0.0, values }], rate_hz).unwrap()
    }

    #[test]
    fn a_tone_and_its_harmonic_are_found_with_their_amplitudes() {
        let mut values = Noise::new(7).white(120_000, 1.0);
        for (i, value) in values.iter_mut().enumerate() {
            let t = i as f64 / 40.0;
            *value += 0.3 * (2.0 * PI * 3.71 * t).sin() + 0.15 * (2.0 * PI * 11.13 * t).cos();
        }
        let lines = find(&spectrum(values, 40.0), 40.0);
        assert_eq!(lines.len(), 2, "{lines:?}");
        for (line, (frequency, amplitude)) in lines.iter().zip([(3.71, 0.3), (11.13, 0.15)]) {
            assert!((line.frequency_hz - frequency).abs() < 0.01, "{line:?}");
            assert!((line.amplitude / amplitude - 1.0).abs() < 0.1, "{line:?}");
            assert!(line.persistent && line.band_hz[1] - line.band_hz[0] < 0.2, "{line:?}");
        }
    }

    #[test]
    fn mains_are_recognised_where_sampling_folds_them() {
        assert_eq!(mains(19.98, 0.02, 40.0), [60.0, 100.0], "60 Hz, or the light of 50 Hz mains");
        assert_eq!(mains(10.0, 0.02, 40.0), [50.0]);
        assert!(mains(13.38, 0.02, 40.0).is_empty());
        assert_eq!(mains(50.02, 0.1, 200.0), [50.0]);
    }

    #[test]
    fn a_tone_of_one_part_of_the_record_is_not_persistent() {
        let mut values = Noise::new(8).white(120_000, 1.0);
        for (i, value) in values.iter_mut().enumerate().skip(60_000).take(20_000) {
            *value += (2.0 * PI * 0.2 * i as f64).sin();
        }
        let lines = find(&spectrum(values, 40.0), 40.0);
        assert_eq!(lines.len(), 1);
        assert!(!lines[0].persistent, "{lines:?}");
    }

    #[test]
    fn white_angle_noise_is_no_vibration_and_a_resonance_is() {
        let angle = Noise::new(9).white(200_001, 1.0);
        let rate: Vec<f64> = angle.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let white = Noise::new(10).white(200_000, 1.0);
        let both: Vec<f64> = white.iter().zip(&rate).map(|(white, rate)| white + 0.7 * rate).collect();
        assert!(vibration(&spectrum(both, 40.0), 40.0).is_empty());
        let (mut one, mut two) = (0.0, 0.0);
        let drive = Noise::new(11).white(200_000, 0.15);
        let shaken: Vec<f64> = white
            .iter()
            .zip(drive)
            .map(|(white, drive)| {
                let next = 2.0 * 0.93 * (2.0 * PI * 16.0 / 40.0f64).cos() * one - 0.93 * 0.93 * two + drive;
                (two, one) = (one, next);
                white + next
            })
            .collect();
        let found = vibration(&spectrum(shaken, 40.0), 40.0);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!((found[0].band_hz[0]..found[0].band_hz[1]).contains(&16.0));
        assert!(vibration(&spectrum(white, 40.0), 40.0).is_empty());
    }

    #[test]
    fn blocks_share_a_line_and_one_that_few_have_does_not_last() {
        let line = |frequency_hz: f64, amplitude: f64| Line {
            frequency_hz,
            band_hz: [frequency_hz - 0.1, frequency_hz + 0.1],
            amplitude,
            ratio: 2.0,
            persistent: true,
            broad: false,
            may_be_mains_hz: Vec::new(),
        };
        let found = joined(vec![line(5.0, 1.0), line(13.4, 1.0), line(5.05, 1.0), line(4.95, 1.0), line(5.0, 1.0)], 4);
        assert_eq!(found.len(), 2);
        assert!(found[0].persistent && (found[0].frequency_hz - 5.0).abs() < 1e-9 && found[0].amplitude == 1.0);
        assert!(!found[1].persistent && found[1].amplitude == 0.5);
    }
}
