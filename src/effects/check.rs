//! What every effect's tests share: simulated spectra and Allan variances against the closed forms.

use super::{Effect, Stream, StreamId};

/// Samples per realisation.
const SAMPLES: usize = 1 << 14;
/// Realisations.
const SEEDS: u64 = 60;
/// Accepted distance in standard errors of the mean over the realisations.
const STANDARD_ERRORS: f64 = 5.0;
/// Accepted relative deviation of an approximated spectrum (flicker: 1 %).
const SYSTEMATIC: f64 = 0.01;

/// A stream for a test.
pub(super) fn stream(seed: u64) -> Stream {
    Stream::new(seed, StreamId { owner: 9, effect: 7, instance: 0 })
}

/// `count` samples of the effect alone.
pub(super) fn draw(effect: &dyn Effect, rate_hz: f64, count: usize, seed: u64) -> Vec<f64> {
    let mut values = vec![0.0; count];
    effect.sampler(rate_hz, count as f64 / rate_hz, stream(seed)).apply(&mut values);
    values
}

/// Overlapping Allan variance of `values` at averaging factor `m`, from its definition.
fn allan_variance(values: &[f64], m: usize) -> f64 {
    let mut phase = vec![0.0];
    for value in values {
        phase.push(phase[phase.len() - 1] + value);
    }
    let differences = phase.len() - 2 * m;
    let sum: f64 = (0..differences).map(|i| (phase[i + 2 * m] - 2.0 * phase[i + m] + phase[i]).powi(2)).sum();
    sum / (2.0 * (m * m) as f64 * differences as f64)
}

/// Mean two-sided PSD over the bins `from..to`, Hann window.
fn band_powers(values: &[f64], rate_hz: f64, bands: &[(usize, usize)]) -> Vec<f64> {
    let n = values.len();
    let window = |i: usize| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * i as f64 / n as f64).cos();
    let mut tapered: Vec<f64> = values.iter().enumerate().map(|(i, value)| value * window(i)).collect();
    let power: f64 = (0..n).map(|i| window(i).powi(2)).sum();
    let fft = realfft::RealFftPlanner::<f64>::new().plan_fft_forward(n);
    let mut spectrum = fft.make_output_vec();
    fft.process(&mut tapered, &mut spectrum).unwrap();
    bands
        .iter()
        .map(|(from, to)| {
            spectrum[*from..*to].iter().map(realfft::num_complex::Complex::norm_sqr).sum::<f64>()
                / ((to - from) as f64 * power * rate_hz)
        })
        .collect()
}

/// Mean and its standard error.
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

fn agrees(what: &str, found: &[f64], expected: f64) {
    let (mean, error) = mean_and_error(found);
    let allowed = STANDARD_ERRORS * error + SYSTEMATIC * expected;
    assert!((mean - expected).abs() < allowed, "{what}: {mean:e} ± {error:e}, expected {expected:e}");
}

/// Asserts that simulated Allan variances (m = 1 … 2048) and spectra (octaves up to Nyquist) are the closed forms' within
/// their sampling error.
pub(super) fn agrees_with_its_closed_forms(effect: &dyn Effect, rate_hz: f64) {
    let factors = [1, 2, 4, 16, 64, 256, 2048];
    let bands: Vec<(usize, usize)> = (5..13).map(|octave| (1 << octave, 1 << (octave + 1))).collect();
    let (mut variances, mut powers) = (vec![Vec::new(); factors.len()], vec![Vec::new(); bands.len()]);
    for seed in 0..SEEDS {
        let values = draw(effect, rate_hz, SAMPLES, seed);
        for (slot, m) in variances.iter_mut().zip(factors) {
            slot.push(allan_variance(&values, m));
        }
        for (slot, power) in powers.iter_mut().zip(band_powers(&values, rate_hz, &bands)) {
            slot.push(power);
        }
    }
    for (found, m) in variances.iter().zip(factors) {
        agrees(
            &format!("{}: Allan variance at m = {m}", effect.name()),
            found,
            effect.allan_variance(m as u64, rate_hz),
        );
    }
    for (found, (from, to)) in powers.iter().zip(&bands) {
        let expected: f64 =
            (*from..*to).map(|bin| effect.psd(bin as f64 * rate_hz / SAMPLES as f64, rate_hz)).sum::<f64>()
                / (to - from) as f64;
        agrees(&format!("{}: spectrum in bins {from}–{to}", effect.name()), found, expected);
    }
}
