//! Checks that the effects' tests share: simulated spectra, Allan variances and moments are compared with the closed
//! forms, and values must not depend on how a stream is cut.

use super::{At, Effect, EffectKind, Frequencies, Record, Stage, Stream, StreamId, USUAL_TEMPERATURE_C, sampled};

/// Samples per realisation.
pub(super) const SAMPLES: usize = 1 << 14;
/// Number of realisations.
const SEEDS: u64 = 100;
/// Accepted distance in standard errors of the mean over the realisations: with some 20 comparisons per effect and 30
/// effects, one in 3000 runs would fail by chance if seeds were not fixed.
const STANDARD_ERRORS: f64 = 5.0;
/// Accepted relative deviation of spectra (leakage of the window, flicker's ripple) and of the Allan variance of
/// flicker and power laws.
const APPROXIMATE: f64 = 0.01;
/// Accepted relative deviation of quantities with exact closed forms.
const EXACT: f64 = 1e-6;

/// Accepted deviation of a quantity that should be 0, in sums over numbers of about 1.
const ROUNDING: f64 = 1e-18;

/// Returns a stream for a test.
pub(super) fn stream(seed: u64) -> Stream {
    Stream::new(seed, StreamId { owner: 9, effect: 7, instance: 0 })
}

/// Draws `count` samples of the effect alone.
pub(super) fn draw(effect: &dyn Effect, rate_hz: f64, count: usize, seed: u64) -> Vec<f64> {
    let mut values = vec![0.0; count];
    effect.sampler(rate_hz, count as f64 / rate_hz, stream(seed)).apply(&mut values);
    values
}

/// Draws `count` normal values of variance 1 from a stream that no effect uses.
fn white(count: usize, seed: u64) -> Vec<f64> {
    let mut stream = Stream::new(seed, StreamId { owner: 9, effect: 60_000, instance: 0 });
    (0..count).map(|_| stream.normal()).collect()
}

/// Returns the output of the effect for normal white noise of variance 1 per sample.
pub(super) fn draw_on_white(effect: &dyn Effect, rate_hz: f64, count: usize, seed: u64) -> Vec<f64> {
    let mut values = white(count, seed);
    effect.sampler(rate_hz, count as f64 / rate_hz, stream(seed)).apply(&mut values);
    values
}

/// Returns the overlapping Allan variance of `values` at averaging factor `m`, from its definition.
pub(super) fn allan_variance(values: &[f64], m: usize) -> f64 {
    let mut phase = vec![0.0];
    for value in values {
        phase.push(phase[phase.len() - 1] + value);
    }
    let differences = phase.len() - 2 * m;
    let sum: f64 = (0..differences).map(|i| (phase[i + 2 * m] - 2.0 * phase[i + m] + phase[i]).powi(2)).sum();
    sum / (2.0 * (m * m) as f64 * differences as f64)
}

/// The weighting of a record before its spectrum is taken.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Window {
    /// For spectra that are not flat.
    Hann,
    /// For white noise that varies over time: every sample counts.
    Rectangular,
}

/// Returns the mean two-sided PSD over the bins `from..to`.
fn band_powers(values: &[f64], rate_hz: f64, bands: &[(usize, usize)], window: Window) -> Vec<f64> {
    let n = values.len();
    let window = |i: usize| match window {
        Window::Hann => 0.5 - 0.5 * (2.0 * std::f64::consts::PI * i as f64 / n as f64).cos(),
        Window::Rectangular => 1.0,
    };
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

/// Returns the mean and its standard error.
pub(super) fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

fn agrees(what: &str, found: &[f64], expected: f64, systematic: f64) {
    let (mean, error) = mean_and_error(found);
    let allowed = STANDARD_ERRORS * error + systematic * expected.abs() + ROUNDING;
    assert!((mean - expected).abs() < allowed, "{what}: {mean:e} ± {error:e}, expected {expected:e}");
}

/// Returns the octaves up to half the rate.
fn octaves() -> Vec<(usize, usize)> {
    (5..13).map(|octave| (1 << octave, 1 << (octave + 1))).collect()
}

/// Asserts that the mean spectrum over the seeds equals `expected` (a function of the frequency in Hz) in every octave.
pub(super) fn spectrum_agrees(
    name: &str,
    window: Window,
    draw: impl Fn(u64) -> Vec<f64>,
    rate_hz: f64,
    expected: impl Fn(f64) -> f64,
) {
    let bands = octaves();
    let powers: Vec<Vec<f64>> = (0..SEEDS).map(|seed| band_powers(&draw(seed), rate_hz, &bands, window)).collect();
    for (place, (from, to)) in bands.iter().enumerate() {
        let found: Vec<f64> = powers.iter().map(|powers| powers[place]).collect();
        let at = |bin: usize| expected(bin as f64 * rate_hz / SAMPLES as f64);
        let expected = (*from..*to).map(at).sum::<f64>() / (to - from) as f64;
        agrees(&format!("{name}: spectrum in bins {from}–{to}"), &found, expected, APPROXIMATE);
    }
}

/// Asserts that the mean Allan variances over the seeds equal `expected`, if that is known.
fn allan_agrees(name: &str, cases: &[Vec<f64>], systematic: f64, expected: impl Fn(u64) -> Option<f64>) {
    // Beyond an eighth of the record only one difference remains, whose mean square over 100 seeds is far from normal.
    for m in [1, 2, 4, 16, 64, 256, 2048, 7000].into_iter().filter(|m| *m <= 2048 || cases.len() < SEEDS as usize) {
        let Some(expected) = expected(m as u64) else { continue };
        let found: Vec<f64> = cases.iter().map(|values| allan_variance(values, m)).collect();
        agrees(&format!("{name}: Allan variance at m = {m}"), &found, expected, systematic);
    }
}

fn moments_agree(name: &str, cases: &[Vec<f64>], moments: super::Moments) {
    let mean_power = |values: &Vec<f64>, power| values.iter().map(|v| v.powi(power)).sum::<f64>() / values.len() as f64;
    let squares: Vec<f64> = cases.iter().map(|values| mean_power(values, 2)).collect();
    agrees(&format!("{name}: variance"), &squares, moments.variance, EXACT);
    if let Some(kurtosis) = moments.kurtosis {
        let fourths: Vec<f64> = cases.iter().map(|values| mean_power(values, 4)).collect();
        agrees(&format!("{name}: fourth moment"), &fourths, kurtosis * moments.variance.powi(2), EXACT);
    }
}

/// Asserts that a realisation does not depend on how it is cut, but on the seed if the effect draws random numbers.
fn cuts_do_not_matter(effect: &dyn Effect, rate_hz: f64) {
    let length_s = 1000.0 / rate_hz;
    let whole = draw_on_white(effect, rate_hz, 1000, 11);
    let mut pieces = white(1000, 11);
    let mut sampler = effect.sampler(rate_hz, length_s, stream(11));
    let mut rest = pieces.as_mut_slice();
    for length in [1, 77, 0, 300, 512, 110] {
        let (piece, after) = rest.split_at_mut(length);
        sampler.apply(piece);
        rest = after;
    }
    assert!(rest.is_empty());
    assert_eq!(whole, pieces, "{} depends on how it is cut", effect.name());
    let mut again = white(1000, 11);
    effect.sampler(rate_hz, length_s, stream(12)).apply(&mut again);
    let silent = effect.stage() == Stage::Bandwidth && effect.psd(1.0, rate_hz) == Some(0.0);
    if effect.spec().stream == 0 || silent {
        assert_eq!(again, whole);
    } else if !matches!(effect.kind(), EffectKind::Bursts | EffectKind::Spikes) {
        assert_ne!(again, whole, "{} does not depend on the seed", effect.name());
    }
}

/// Asserts that densities and power gains at many frequencies are those at each one, up to rounding.
fn many_frequencies_are_as_single_ones(effect: &dyn Effect, rate_hz: f64) {
    let frequencies = Frequencies::new((1..500).map(|part| 1e-3 * f64::from(part) * rate_hz).collect(), rate_hz);
    let (densities, gains) = (effect.densities(&frequencies), effect.power_gains(&frequencies));
    for ((hz, density), gain) in frequencies.hz().iter().zip(densities).zip(gains) {
        let (one, single_gain) = (effect.psd(*hz, rate_hz).unwrap_or(0.0), effect.power_gain(*hz, rate_hz));
        assert!((density - one).abs() <= 1e-12 * one, "{} at {hz} Hz: {density} {one}", effect.name());
        assert!((gain - single_gain).abs() <= 1e-12 * single_gain, "{} at {hz} Hz", effect.name());
    }
}

/// Asserts that spectra (octaves up to Nyquist), lines, Allan variances (m = 1 … 7000) and moments over 100 seeds agree with the
/// closed forms within their sampling error. Also asserts that deterministic parts are the mean response, and that realisations
/// do not depend on how they are cut.
pub(super) fn agrees_with_its_closed_forms(effect: &dyn Effect, rate_hz: f64) {
    let name = effect.name();
    let record = Record { rate_hz, samples: SAMPLES as u64 };
    effect.check(rate_hz).unwrap();
    cuts_do_not_matter(effect, rate_hz);
    many_frequencies_are_as_single_ones(effect, rate_hz);
    let deterministic = effect.regressors() > 0 && effect.lines().is_empty();
    let seeds = if deterministic { 2 } else { SEEDS };
    let case = |seed| match effect.stage() {
        Stage::WhitePart | Stage::Bandwidth => draw_on_white(effect, rate_hz, SAMPLES, seed),
        Stage::Resolution => {
            let (before, after) = (white(SAMPLES, seed), draw_on_white(effect, rate_hz, SAMPLES, seed));
            after.iter().zip(before).map(|(after, before)| after - before).collect()
        }
        _ => draw(effect, rate_hz, SAMPLES, seed),
    };
    let cases: Vec<Vec<f64>> = (0..seeds).map(case).collect();
    let taken = |seed: u64| cases[seed as usize].clone();
    match effect.stage() {
        Stage::WhitePart => {
            let moments = effect.white_moments(record).unwrap();
            spectrum_agrees(name, Window::Rectangular, taken, rate_hz, |_| moments.variance / rate_hz);
            moments_agree(name, &cases, moments);
        }
        Stage::Bandwidth => {
            let behind = effect.psd(1.0, rate_hz).unwrap();
            let psd = |cycles: f64| effect.power_gain(cycles * rate_hz, rate_hz) + behind * rate_hz;
            spectrum_agrees(name, Window::Hann, taken, rate_hz, |f| psd(f / rate_hz) / rate_hz);
            let panels = 1_u32 << 17;
            let integral = |m| {
                let cycles = (0..panels).map(|panel| (f64::from(panel) + 0.5) / f64::from(2 * panels));
                cycles.map(|cycles| psd(cycles) * sampled::allan_response(m, cycles)).sum::<f64>() / f64::from(panels)
            };
            // The first values behind a filter differ from those that follow.
            allan_agrees(name, &cases, 1e-3, |m| Some(integral(m)));
        }
        _ => {
            let systematic =
                if matches!(effect.kind(), EffectKind::Flicker | EffectKind::PowerLaw) { APPROXIMATE } else { EXACT };
            allan_agrees(name, &cases, systematic, |m| effect.allan_variance(m, record));
            let lines = effect.lines();
            if let (false, Some(_), true) = (deterministic, effect.psd(1.0, rate_hz), lines.is_empty()) {
                spectrum_agrees(name, Window::Hann, taken, rate_hz, |f| effect.psd(f, rate_hz).unwrap());
            }
            for line in lines {
                let bin = (line.frequency_hz / rate_hz * SAMPLES as f64).round() as usize;
                let around = [(bin - 6, bin + 7)];
                let width_hz = 13.0 * rate_hz / SAMPLES as f64;
                let found: Vec<f64> = cases
                    .iter()
                    .map(|values| band_powers(values, rate_hz, &around, Window::Hann)[0] * width_hz)
                    .collect();
                let beside = |bin: usize| effect.psd(bin as f64 * rate_hz / SAMPLES as f64, rate_hz).unwrap_or(0.0);
                let foot: f64 = (bin - 6..bin + 7).map(beside).sum::<f64>() * rate_hz / SAMPLES as f64;
                let expected = line.power / 2.0 + foot;
                agrees(&format!("{name}: line at {} Hz", line.frequency_hz), &found, expected, EXACT.max(2e-3));
            }
            if let Some(moments) = effect.moments(record) {
                moments_agree(name, &cases, moments);
            }
        }
    }
    if deterministic {
        let mut row = vec![0.0; effect.regressors()];
        let (mut above, mut below): (f64, f64) = (0.0, 0.0);
        for (index, value) in cases[0].iter().enumerate() {
            let at = At { time_s: index as f64 / rate_hz, temperature_c: USUAL_TEMPERATURE_C };
            let expected = effect.mean_response(0.0, at);
            assert!((value - expected).abs() <= 1e-12 * expected.abs().max(1e-6), "{name} at {} s", at.time_s);
            effect.regress(at, &mut row);
            above += row[0] * value;
            below += row[0] * row[0];
        }
        // The course is the regressor times one coefficient.
        let coefficient = if below > 0.0 { above / below } else { 0.0 };
        for (index, value) in cases[0].iter().enumerate() {
            effect.regress(At { time_s: index as f64 / rate_hz, temperature_c: USUAL_TEMPERATURE_C }, &mut row);
            assert!((value - coefficient * row[0]).abs() < 1e-9 * coefficient.abs().max(1e-9), "{name}: regressor");
        }
    }
}
