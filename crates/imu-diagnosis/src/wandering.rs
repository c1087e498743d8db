//! Wandering: lines whose frequency wanders. Their spectrum is that of noise in a band, but their amplitude is steady.

use super::law::{Shape, Term};
use super::omnibus::component::Part;
use imu_model::effects::{Effect, EffectKind, WanderingLine};
use imu_model::simulator::ChannelModel;
use std::f64::consts::{FRAC_1_SQRT_2, PI, SQRT_2, TAU};
use std::sync::Arc;

/// A band of the law that is a wandering line.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Wander {
    /// The place of its term in the law.
    pub(super) term: usize,
    /// Root mean square of the amplitude's logarithm.
    amplitude_sigma: f64,
    /// Correlation time of the amplitude's logarithm, samples.
    amplitude_tc: f64,
}

/// Returns the bands of the law whose amplitude is much steadier than that of noise in a band.
///
/// The kurtosis is 3 of normal noise in a band, 3/2 of a line with a constant amplitude, and 3/2·e^(4s²) of one whose
/// amplitude's logarithm is normal with the standard deviation s. Noise of power 1 − p beside a line of power p gives
/// 3 − p²·(3 − the line's kurtosis).
pub(super) fn lines(parts: &[Part]) -> Vec<Wander> {
    /// Standard deviations by which the kurtosis has to be below that of noise.
    const CLEAR: f64 = 6.0;
    let mut found = Vec::new();
    for part in parts.iter().filter(|part| part.term.shape == Shape::Resonance) {
        let Some((kurtosis, _)) = part.kurtosis().filter(|(_, score)| *score < -CLEAR) else { continue };
        let of_line = (3.0 - (3.0 - kurtosis) / part.purity.powi(2)).max(1.5);
        let amplitude_sigma = (0.25 * (of_line / 1.5).ln()).sqrt();
        found.push(Wander { term: part.place, amplitude_sigma, amplitude_tc: remembered(&part.course) });
    }
    found
}

/// Returns the bands that have the spectra of a model's wandering lines, in the scale of a series (U per unit of it): bins resolve
/// them, and they have a part at the ends that the transform does not represent.
pub(super) fn bands_of(model: &ChannelModel, scale: f64) -> Vec<Term> {
    let of = |effect: &Arc<dyn Effect>| {
        let [frequency_hz, bandwidth_hz] = effect.extents().first()?.band_hz?;
        let sigma = effect.number("amplitude")? * FRAC_1_SQRT_2 / scale;
        let numbers = vec![2.0 * sigma.ln(), frequency_hz, bandwidth_hz.ln()];
        numbers.iter().all(|number| number.is_finite()).then_some(Term { shape: Shape::Resonance, numbers })
    };
    model.effects.iter().filter(|effect| effect.kind() == EffectKind::WanderingLine).filter_map(of).collect()
}

/// Returns the lag, in samples, at which the autocovariance of a course's power falls to 1/e of that at one block of samples.
fn remembered(course: &[f64]) -> f64 {
    /// Blocks of this many samples hold several periods of most lines.
    const BLOCK: usize = 64;
    let squares: Vec<f64> = course.chunks_exact(BLOCK).map(|of| of.iter().map(|x| x * x).sum::<f64>()).collect();
    let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
    let covariance = |lag: usize| {
        let pairs = squares.iter().zip(squares.iter().skip(lag));
        pairs.map(|(one, other)| (one - mean) * (other - mean)).sum::<f64>()
    };
    let kept = covariance(1) / std::f64::consts::E;
    let lag = (2..squares.len() / 2).find(|lag| covariance(*lag) < kept).unwrap_or(1);
    (lag * BLOCK) as f64
}

impl Wander {
    /// Returns the line of a band with this centre, full width at half power, and root mean square.
    ///
    /// The width determines the product of the frequency's variance and correlation time alone, as long as the frequency changes
    /// often while the phase wanders off.
    pub(super) fn line(&self, frequency_hz: f64, bandwidth_hz: f64, sigma: f64, rate_hz: f64) -> WanderingLine {
        /// The mean square of the phase, rad², that one stay at a frequency gathers.
        const HELD: f64 = 0.02;
        /// Part of the width that is the frequency's at least.
        const LEAST: f64 = 0.1;
        let amplitude_tc_s = self.amplitude_tc / rate_hz;
        let of_amplitude_hz = self.amplitude_sigma.powi(2) / (PI * amplitude_tc_s);
        let of_frequency_hz = (bandwidth_hz - of_amplitude_hz).max(LEAST * bandwidth_hz);
        let frequency_tc_s = HELD / (PI * of_frequency_hz);
        WanderingLine {
            frequency_hz,
            amplitude: SQRT_2 * sigma,
            frequency_sigma_hz: HELD.sqrt() / (TAU * frequency_tc_s),
            frequency_tc_s,
            amplitude_sigma: self.amplitude_sigma,
            amplitude_tc_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::Verdict;
    use crate::cliffs::{Wrong, diagnosed, names};
    use crate::round_trip::{model, recording};
    use serde_json::json;

    const SAMPLES: usize = 40_000;

    #[test]
    fn a_line_whose_frequency_wanders_is_named_with_its_place_and_amplitude() {
        let mut wrong = Wrong::default();
        // Full width at half power: (2π·frequency_sigma_hz)²·frequency_tc_s/π.
        for (amplitude, [frequency_sigma_hz, frequency_tc_s], amplitude_sigma, seed) in
            [(0.02, [0.2, 0.1], 0.0, 1), (0.05, [0.5, 0.02], 0.0, 2), (0.02, [0.2, 0.2], 0.1, 3)]
        {
            let effect = json!({"effect": "wandering_line", "frequency_hz": 8.1, "amplitude": amplitude,
                "frequency_sigma_hz": frequency_sigma_hz, "frequency_tc_s": frequency_tc_s,
                "amplitude_sigma": amplitude_sigma, "amplitude_tc_s": 2.0});
            let found = diagnosed(&recording(&model(Some(&effect)), seed, SAMPLES), &model(None));
            let own =
                found.diagnosis.causes.first().map(|cause| cause.uncertainty["accel_x"][0].clone()).unwrap_or_default();
            let holds = |name: &str, truth: f64| {
                let [low, high] = [0, 1].map(|end| own[name][end].as_f64().unwrap_or(f64::NAN));
                low <= truth && truth <= high
            };
            wrong.expect(names(&found) == ["wandering_line"] && found.diagnosis.verdict == Verdict::Effects, || {
                format!("{effect} seed {seed}: {:?} {:?}", names(&found), found.diagnosis.notes)
            });
            wrong.expect(holds("frequency_hz", 8.1) && holds("amplitude", amplitude), || format!("{effect}: {own}"));
            let again = recording(&found.augmented, seed + 100, SAMPLES);
            let own = diagnosed(&again, &found.augmented);
            let is_own = matches!(own.diagnosis.verdict, Verdict::NoGap | Verdict::Parameters);
            wrong.expect(is_own, || format!("{effect}: its corrected model: {:?}", names(&own)));
            let plain = diagnosed(&again, &model(None));
            wrong.expect(names(&plain) == ["wandering_line"], || format!("{effect} again: {:?}", names(&plain)));
        }
        wrong.none();
    }
}
