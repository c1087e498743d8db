//! Nameless density: the density of the remainder beside all found effects, in bands in which the remainder is louder.

use super::series::Series;

/// Minimum number of coefficients in the finest bands, their minimum part of the band (the substitute effect resolves
/// no less), and the growth of bands.
const WIDTH: usize = 64;
const PARTS: usize = 125;
const WIDER: usize = 4;
/// Standard errors by which a band has to be louder.
const LOUDER: f64 = 6.0;
/// Maximum number of bands.
const MOST: usize = 24;
/// The smallest part of the power in front of a filter that the filter passes.
const PASSED: f64 = 0.01;

/// Points [frequency in Hz, two-sided density in front of all filters, in the series' scale² /Hz] of the residual's
/// excess over a white one. The list is empty if no band is clearly louder. The density is 0 outside the bands.
pub(super) fn density(series: &Series<'_>) -> Vec<(f64, f64)> {
    let n = series.len();
    let rate_hz = series.setting().rate_hz;
    let hz = |k: usize| k as f64 / n as f64 * 0.5 * rate_hz;
    let gain = series.filters();
    let mut taken = vec![false; n];
    let mut bands: Vec<(usize, usize, f64)> = Vec::new();
    let finest = WIDTH.max(n / PARTS);
    let mut width = finest;
    while 4 * width < n && bands.len() < MOST {
        for from in (finest..n - width).step_by(width) {
            let to = from + width;
            if taken[from..to].contains(&true) || bands.len() == MOST {
                continue;
            }
            let ratio = series.whitened[from..to].iter().map(|c| c * c).sum::<f64>() / width as f64;
            if (ratio - 1.0) * (0.5 * width as f64).sqrt() > LOUDER {
                let of = |k: usize| series.spectrum[k] / gain.as_ref().map_or(1.0, |gain| gain[k]).max(PASSED);
                let all = (from..to).map(of).sum::<f64>() / width as f64;
                taken[from..to].fill(true);
                bands.push((from, to, (ratio - 1.0) * all / rate_hz));
            }
        }
        width *= WIDER;
    }
    bands.sort_unstable_by_key(|(from, ..)| *from);
    let mut points: Vec<(f64, f64)> = Vec::new();
    let edge_hz = 1e-3 * hz(finest);
    for (from, to, density) in bands {
        let (low, high) = (hz(from), hz(to));
        match points.last_mut() {
            // Of two adjacent bands, one begins at the other's end.
            Some(last) if last.0 > low - edge_hz => *last = (low + edge_hz, density),
            _ => points.extend([(low - edge_hz, 0.0), (low, density)]),
        }
        points.extend([(high - edge_hz, density), (high, 0.0)]);
    }
    points
}

#[cfg(test)]
mod tests {
    use crate::diagnose;
    use crate::round_trip::{model, recording};
    use crate::{Options, Verdict};
    use imu_core::sample::Channel;
    use imu_model::effects::Record;
    use serde_json::json;

    #[test]
    fn what_has_no_name_is_in_the_corrected_model() {
        let band = json!({"effect": "resonance", "frequency_hz": 8.0, "bandwidth_hz": 1.0, "sigma": 0.01});
        // Bands are not searched, so that the density has no name.
        let options = Options { effects: Some(&[imu_model::EffectKind::Tone]), ..Options::default() };
        let outcome = diagnose(&recording(&model(Some(&band)), 5, 32_000), &model(None), &options).unwrap();
        assert_eq!(outcome.diagnosis.verdict, Verdict::UnknownEffect, "{}", outcome.diagnosis.summary);
        let remainder = outcome.diagnosis.remainder.unwrap();
        assert_eq!(remainder.channels, ["accel_x", "accel_z"]);
        let again =
            diagnose(&recording(&outcome.augmented, 6, 32_000), &outcome.augmented, &options).unwrap().diagnosis;
        assert_eq!((again.verdict, again.remainder), (Verdict::NoGap, None));
        for channel in [Channel::AccelX, Channel::AccelZ] {
            let effects = &outcome.augmented.channels[&channel].effects;
            let own = effects.iter().find(|effect| effect.kind() == imu_model::EffectKind::SpectralNoise).unwrap();
            let power = own.moments(Record { rate_hz: 40.0, samples: 32_000 }).unwrap().variance;
            // The law's own levels have absorbed a part of the power.
            assert!((2e-5..1.3e-4).contains(&power), "{power}");
        }
    }
}
