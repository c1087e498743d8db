//! The spectrum: Welch's averaged periodogram, its background, and the excess over it that chance may cause.
//!
//! # Source
//! P. D. Welch, IEEE Trans. Audio Electroacoustics AU-15 (1967) 70, for the estimate and the degrees of freedom that
//! overlapping Hann windows leave (correlation of neighbours 1/6, so that K windows count as K / (1 + 2/36)).

use super::Part;
use super::scale::{median, spread_of_95};
use crate::welch::Windows;
use crate::whittle::boxcar;

/// Minimum number of windows averaged in a spectrum.
const LEAST_WINDOWS: usize = 16;
const SHORTEST: usize = 256;
const LONGEST: usize = 1 << 16;
/// Number of stretches of equal time into which the record is divided, to see whether a line lasts.
pub(super) const STRETCHES: usize = 4;
/// Windows in which samples jump by more than about this multiple of the usual window's jumps are left out.
const WILD: f64 = 4.0;

/// An averaged one-sided spectrum.
#[derive(Debug, Clone)]
pub(super) struct Spectrum {
    /// Samples per window.
    pub(super) window: usize,
    /// Distance of bins, Hz.
    pub(super) step_hz: f64,
    /// Power density per bin, U²/Hz; bin 0 is the mean, which was subtracted, and the last bin is half the rate.
    pub(super) power: Vec<f64>,
    /// The power density for each quarter of the record; empty if the quarter had no window.
    pub(super) stretches: [Vec<f64>; STRETCHES],
    /// Effective number of independent windows.
    pub(super) windows: f64,
    /// The density without lines: the running median.
    pub(super) background: Vec<f64>,
}

impl Spectrum {
    /// Returns the spectrum of parts; `None` if they are too short for [`LEAST_WINDOWS`] windows of 256 samples in
    /// total.
    pub(super) fn of(parts: &[Part], rate_hz: f64) -> Option<Self> {
        let longest = parts.iter().map(|part| part.values.len()).max()?;
        let most = (longest / LEAST_WINDOWS).clamp(SHORTEST, LONGEST);
        let window = 1 << most.ilog2();
        let mut transform = Windows::new(window, rate_hz);
        let begin_s = parts.first()?.start_s;
        let end_s = parts.last().map(|part| part.time_s(part.values.len(), rate_hz))?;
        let places = places(parts, window);
        let wild = wildness(parts, &places, window);
        let mut sums = std::array::from_fn::<Vec<f64>, STRETCHES, _>(|_| vec![0.0; window / 2 + 1]);
        let mut counts = [0usize; STRETCHES];
        for ((part, from), wild) in places.iter().zip(wild) {
            if wild {
                continue;
            }
            let values = parts.get(*part)?.values.get(*from..from + window)?;
            let middle_s = parts.get(*part)?.time_s(from + window / 2, rate_hz);
            let share = (middle_s - begin_s) / (end_s - begin_s).max(f64::MIN_POSITIVE);
            let stretch = ((share * STRETCHES as f64) as usize).min(STRETCHES - 1);
            counts[stretch] += 1;
            transform.add(values, &mut sums[stretch])?;
        }
        let total: usize = counts.iter().sum();
        if total < LEAST_WINDOWS {
            return None;
        }
        let mut power = vec![0.0; window / 2 + 1];
        for sum in &sums {
            for (power, value) in power.iter_mut().zip(sum) {
                *power += value / total as f64;
            }
        }
        let mut stretches = sums;
        for (stretch, count) in stretches.iter_mut().zip(counts) {
            if count == 0 {
                stretch.clear();
            }
            stretch.iter_mut().for_each(|value| *value /= count as f64);
        }
        let background = background(&power);
        let windows = total as f64 / (1.0 + 2.0 / 36.0);
        Some(Self { window, step_hz: rate_hz / window as f64, power, stretches, windows, background })
    }

    /// The first bin in which lines are searched: below it, the background cannot be determined.
    pub(super) const FIRST: usize = 8;
}

/// Returns half-overlapping windows: part and first sample.
fn places(parts: &[Part], window: usize) -> Vec<(usize, usize)> {
    let of = |(index, part): (usize, &Part)| {
        let last = part.values.len().checked_sub(window);
        let count = last.map_or(0, |last| last / (window / 2) + 1);
        (0..count).map(move |k| (index, k * window / 2))
    };
    parts.iter().enumerate().flat_map(of).collect()
}

/// Returns which windows contain a knock: steps from sample to sample far beyond those of the others.
fn wildness(parts: &[Part], places: &[(usize, usize)], window: usize) -> Vec<bool> {
    let roughness: Vec<f64> = places
        .iter()
        .map(|(part, from)| {
            let values = parts.get(*part).and_then(|part| part.values.get(*from..from + window)).unwrap_or_default();
            let squares: f64 = values.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
            (squares / window as f64).max(f64::MIN_POSITIVE).ln()
        })
        .collect();
    let centre = median(roughness.iter().copied()).unwrap_or(0.0);
    let below = roughness.iter().map(|value| value.min(centre)).collect::<Vec<_>>();
    // The spread of the calm half: knocks must not widen the scale that measures them.
    let spread = (2.0 * spread_of_95(below.iter().copied()).unwrap_or(0.0)).max((2.0 / window as f64).sqrt());
    roughness.iter().map(|value| value - centre > WILD * spread + 0.1).collect()
}

/// Returns the density without lines: its running median, with the lobes of a moving average if the samples are means
/// of many.
fn background(power: &[f64]) -> Vec<f64> {
    let plain = running_median(power);
    let Some(gain) = lobes(power) else { return plain };
    let flat: Vec<f64> = power.iter().zip(&gain).map(|(power, gain)| power / gain).collect();
    let lobed: Vec<f64> = running_median(&flat).iter().zip(&gain).map(|(level, gain)| level * gain).collect();
    if misfit(power, &lobed) < misfit(power, &plain) - LOBED * power.len() as f64 { lobed } else { plain }
}

/// Windows whose lobes are narrow enough for lines.
const WINDOWS: std::ops::RangeInclusive<u32> = 6..=64;
/// How much lobes have to improve the mean square of logarithms.
const LOBED: f64 = 0.02;
/// Larger logarithms of ratios to the background belong to lines.
const LINE: f64 = 1.5;

/// Returns squared logarithms of densities over the background; lines count little.
fn misfit(power: &[f64], background: &[f64]) -> f64 {
    let bins = power.iter().zip(background).skip(Spectrum::FIRST);
    bins.map(|(power, level)| (power.max(f64::MIN_POSITIVE) / level).ln().clamp(-LINE, LINE).powi(2)).sum()
}

/// Returns the gain of the moving average among [`WINDOWS`] that makes the density most nearly flat; `None` if the
/// density does not fall like these gains.
fn lobes(power: &[f64]) -> Option<Vec<f64>> {
    /// Windows are compared on this many means of bins.
    const COARSE: usize = 1024;
    /// The upper half of the band has less than this share of the density of the lowest eighth.
    const FALLS: f64 = 0.2;
    let last = power.len().checked_sub(1).filter(|last| *last > 4 * Spectrum::FIRST)?;
    let level = |from: usize, to: usize| median(power.get(from..to)?.iter().copied());
    if level(last / 2, last)? > FALLS * level(Spectrum::FIRST, last / 8)? {
        return None;
    }
    let gain_of = |window: u32, bins: &mut dyn Iterator<Item = f64>| -> Vec<f64> {
        // A Hann window spreads a bin over its neighbours.
        let at = |bin: f64| boxcar(window, 0.5 * bin / last as f64);
        bins.map(|bin| (0.5 * at(bin) + 0.25 * (at(bin - 1.0) + at(bin + 1.0))).max(1e-6)).collect()
    };
    let size = last.div_ceil(COARSE);
    let coarse: Vec<f64> = power.chunks(size).map(|of| of.iter().sum::<f64>() / of.len() as f64).collect();
    let flatness = |window: u32| {
        let middle = |place: usize| place as f64 * size as f64 + 0.5 * (size as f64 - 1.0);
        let gain = gain_of(window, &mut (0..coarse.len()).map(middle));
        let level = median(coarse.iter().zip(&gain).skip(Spectrum::FIRST).map(|(power, gain)| power / gain))?;
        Some((misfit(&coarse, &gain.iter().map(|gain| level * gain).collect::<Vec<_>>()), window))
    };
    let (_, window) = WINDOWS.filter_map(flatness).min_by(|one, other| one.0.total_cmp(&other.0))?;
    Some(gain_of(window, &mut (0..power.len()).map(|bin| bin as f64)))
}

/// Returns the running median of the density, at least a fortieth of the band to both sides but never beyond half the
/// frequency.
fn running_median(power: &[f64]) -> Vec<f64> {
    let bins = power.len();
    // Only rounding is below this value: it keeps ratios finite.
    let floor = (1e-12 * power.iter().copied().fold(0.0, f64::max)).max(f64::MIN_POSITIVE);
    let widest = (bins / 20).max(24);
    let mut at = Vec::new();
    let mut bin = 1usize;
    while bin < bins {
        let reach = (bin / 2).clamp(2, widest);
        let (from, to) = (bin.saturating_sub(reach).max(1), (bin + reach + 1).min(bins));
        at.push((bin, median(power[from..to].iter().copied()).unwrap_or(0.0).max(floor).ln()));
        bin += (reach / 8).max(1);
    }
    let mut filled = vec![0.0; bins];
    let mut left = 0;
    for (bin, value) in filled.iter_mut().enumerate() {
        while left + 1 < at.len() && at[left + 1].0 <= bin {
            left += 1;
        }
        let (here, next) = (at[left], at[(left + 1).min(at.len() - 1)]);
        let share = if next.0 > here.0 { (bin as f64 - here.0 as f64) / (next.0 - here.0) as f64 } else { 0.0 };
        *value = (here.1 + share.clamp(0.0, 1.0) * (next.1 - here.1)).exp();
    }
    filled
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::Noise;
    use super::*;

    #[test]
    fn white_noise_has_a_flat_spectrum_of_its_density() {
        let part = Part { start_s: 0.0, values: Noise::new(3).white(100_000, 0.5) };
        let spectrum = Spectrum::of(&[part], 40.0).unwrap();
        let density = 2.0 * 0.25 / 40.0;
        let mean = spectrum.power[8..].iter().sum::<f64>() / (spectrum.power.len() - 8) as f64;
        assert!((mean / density - 1.0).abs() < 0.02, "{mean} {density}");
        assert!(spectrum.background[8..].iter().all(|level| (0.6..1.5).contains(&(level / density))));
    }

    #[test]
    fn a_knock_is_left_out_and_a_drift_does_not_leak() {
        let mut values = Noise::new(4).white(100_000, 1.0);
        for (i, value) in values.iter_mut().enumerate() {
            *value += i as f64 * 0.01 + if (5000..5040).contains(&i) { 400.0 * (i as f64 * 1.3).sin() } else { 0.0 };
        }
        let spectrum = Spectrum::of(&[Part { start_s: 0.0, values }], 40.0).unwrap();
        let ratios: Vec<f64> = spectrum.power[8..].iter().map(|power| power / (2.0 / 40.0)).collect();
        let most = ratios.iter().copied().fold(0.0, f64::max);
        let least = ratios.iter().copied().fold(most, f64::min);
        assert!(least > 0.2 && most < 3.0, "{least} {most}");
    }

    #[test]
    fn lobes_of_a_moving_average_are_background() {
        for (seed, window) in [(4, 4), (5, 8), (6, 32), (7, 50)] {
            let white = Noise::new(seed).white(60_000 + window, 1.0);
            let mut values: Vec<f64> = white.windows(window).map(|of| of.iter().sum::<f64>() / window as f64).collect();
            let found = |values: &[f64]| {
                let spectrum = Spectrum::of(&[Part { start_s: 0.0, values: values.to_vec() }], 100.0).unwrap();
                super::super::lines::find(&spectrum, 100.0)
            };
            assert!(found(&values).is_empty(), "{window}: {:?}", found(&values));
            // A line on a lobe is still a line.
            values.iter_mut().enumerate().for_each(|(i, value)| *value += 0.05 * (1.1 * i as f64).sin());
            let lines = found(&values);
            assert!(lines.len() == 1 && (lines[0].frequency_hz - 17.507).abs() < 0.1, "{window}: {lines:?}");
        }
    }

    #[test]
    fn too_little_has_no_spectrum() {
        assert!(Spectrum::of(&[], 40.0).is_none());
        let part = Part { start_s: 0.0, values: vec![1.0; 2000] };
        assert!(Spectrum::of(&[part], 40.0).is_none());
    }
}
