//! Power law: noise whose density falls as a power of the frequency, between and beyond white, flicker and random walk.
//!
//! White noise passes one rational filter whose poles and zeros lie on a logarithmic scale, two octaves from pole to
//! pole ([`RATIO`]). The distance of each zero above its pole follows from the slope, so that the power falls as
//! sin(πf·dt)^−α. For slopes of 2 and more, one pole at the ladder's foot provides 2 of the slope. Behind the ladder, a
//! symmetric filter of [`TAPS`] taps turns the sine into its argument: the samples' density is f^−α itself up to half
//! the rate, with a kink there as flicker noise has it. The filter runs as a sum of first-order sections and starts in
//! its stationary state.
//!
//! The law holds from 1/T, with T the record's length, up to half the rate:
//! `the_density_is_the_power_law_from_one_over_the_record_to_half_the_rate`: within 2 % for 1000 samples, 5 h at 40 Hz
//! and 24 h at 800 Hz, with the largest deviation close to half the rate.

use super::described::effect;
use super::spec::{FROM_ZERO, Form, Range, above};
use super::{Effect, Moments, Record, Sampler, Stage, Stream, Temperature};
use std::f64::consts::PI;

effect! {
    /// Noise with two-sided PSD `density`·(f/`at_hz`)^−`alpha` up to half the rate.
    ///
    /// From a slope of 1 on, the noise has no level: its variance grows with the record. Noise steeper than 1 begins at
    /// 0, as a random walk does. Slopes are below 2.5. The part of an Allan variance that comes from below a frequency
    /// is proportional to the frequency to the power of 3 − α. From 3 on there is therefore no Allan variance, and for
    /// slopes close to 3 most of it comes from frequencies far below one over the record's length.
    ///
    /// Source of the law: Kasdin 1995, Discrete simulation of colored noise (Proc. IEEE 83); of the ladder: as in flicker noise.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct PowerLaw: dyn Effect, 18, Stage::Noise;
    "noise whose density falls as a power of the frequency";
    alpha: f64 = Form::Number(Range::Between(0.0, STEEPEST)), "", "slope: the density falls as f^−alpha";
    at_hz: f64 = above(0.0), "Hz", "the frequency at which `density` is given, Hz";
    density: f64 = FROM_ZERO, "U²/Hz", "two-sided density there, U²/Hz";
}

/// Slopes are below this.
const STEEPEST: f64 = 2.5;

impl Effect for PowerLaw {
    fn psd(&self, frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(self.density * (frequency_hz / self.at_hz).powf(-self.alpha))
    }
    /// Integrates the density up to half the rate.
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        Some(self.at_rate(record.rate_hz) * record.rate_hz * unit_allan_variance(self.alpha, m.max(1)))
    }
    /// The variance for slopes below 1 is 2·∫ density up to half the rate.
    fn moments(&self, record: Record) -> Option<Moments> {
        let level = |slope: f64| 2.0 * 0.5_f64.powf(slope) / slope;
        // A record determines its mean badly: for steeper slopes, too much power lies below one over its length.
        (self.alpha < STEEPEST_WITH_A_LEVEL).then(|| Moments {
            variance: self.at_rate(record.rate_hz) * record.rate_hz * level(1.0 - self.alpha),
            kurtosis: Some(3.0),
        })
    }
    fn sampler(&self, rate_hz: f64, record_length_s: f64, stream: Stream) -> Box<dyn Sampler> {
        // The ladder's density, with the taps behind it, is (f·dt)^−α per unit of f·dt.
        let scale = (self.at_rate(rate_hz) * rate_hz).sqrt();
        Box::new(PowerSampler::new(scale, self.alpha, rate_hz * record_length_s, stream))
    }
}

/// Slopes below this have a level that the ladder's foot does not change by more than a hundredth in any record of 1000
/// samples: the missing part below it is proportional to (16 000)^−(1 − α).
const STEEPEST_WITH_A_LEVEL: f64 = 0.5;

impl PowerLaw {
    /// Returns the density at the rate itself, U²/Hz.
    fn at_rate(&self, rate_hz: f64) -> f64 {
        self.density * (rate_hz / self.at_hz).powf(-self.alpha)
    }
}

/// Returns the Allan variance at averaging factor `m` of noise of density ν^−`alpha` at ν = f·dt below ½: 2·∫
/// ν^−α·response dν.
fn unit_allan_variance(alpha: f64, m: u64) -> f64 {
    /// Number of half periods of sin⁴(πmν) that are integrated; beyond them its mean counts.
    const LOBES: u64 = 256;
    const PANELS: u64 = 32;
    let averaged = m as f64;
    let flat = |cycles: f64| {
        let (top, bottom) = ((averaged * PI * cycles).sin(), (PI * cycles).sin());
        2.0 * top.powi(4) / (averaged * bottom).powi(2)
    };
    // Up to the first zero with ν = first·s^8, which smooths the singularity at 0.
    let first = (1.0 / averaged).min(0.5);
    let below = |s: f64| {
        let cycles = first * s.powi(8);
        let near =
            if averaged * cycles < 1e-5 { 2.0 * (PI * averaged).powi(2) } else { flat(cycles) / (cycles * cycles) };
        8.0 * first.powf(3.0 - alpha) * s.powf(8.0 * (3.0 - alpha) - 1.0) * near
    };
    let mut sum = simpson(below, 0.0, 1.0, 1024);
    let integrated = (LOBES as f64 / averaged).min(0.5);
    if integrated > first {
        let lobes = m.div_ceil(2).min(LOBES);
        sum += simpson(|cycles| cycles.powf(-alpha) * flat(cycles), first, integrated, PANELS * lobes);
    }
    if integrated < 0.5 {
        let mean = |log: f64| {
            let cycles = log.exp();
            cycles.powf(1.0 - alpha) * 0.75 / (averaged * (PI * cycles).sin()).powi(2)
        };
        sum += simpson(mean, integrated.ln(), 0.5_f64.ln(), 512);
    }
    2.0 * sum
}

/// Integrates by Simpson's rule with `panels` panels (even).
fn simpson(integrand: impl Fn(f64) -> f64, from: f64, to: f64, panels: u64) -> f64 {
    let step = (to - from) / panels as f64;
    let weight = |i: u64| if i % 2 == 1 { 4.0 } else { 2.0 };
    let inner: f64 = (1..panels).map(|i| weight(i) * integrand(from + i as f64 * step)).sum();
    step / 3.0 * (integrand(from) + inner + integrand(to))
}

/// Ratio of neighbouring poles of the ladder.
const RATIO: f64 = 4.0;
/// The highest pole's place in sin πf·dt: the part left out above it changes the density by less than 0.1 %.
const HIGHEST_POLE: f64 = 32.0;
/// Maximum number of pairs in a ladder: enough for 1e13 samples at any slope.
const PAIRS_MAX: usize = 40;
/// Taps on each side of the middle one.
const REACH: usize = 32;
/// Taps behind the ladder.
const TAPS: usize = 2 * REACH + 1;

/// Returns the lowest pole's frequency times the record's length: the missing part below it reduces the density at one
/// over the length by less than half a hundredth. For steep slopes the pole is lower, because the Allan variance
/// depends on frequencies far below.
fn lowest_pole(alpha: f64) -> f64 {
    let below = 1.0 / 16.0;
    if alpha <= 1.0 { below } else { below * 1e-2_f64.powf(2.0 * (alpha - 1.0)) }
}

/// The filter whose density is (f·dt)^−α: first-order sections, the direct path beside them, and the taps behind.
#[derive(Debug)]
struct Ladder {
    /// Decay per sample of each pole.
    decays: Vec<f64>,
    weights: Vec<f64>,
    direct: f64,
    taps: Vec<f64>,
}

impl Ladder {
    fn new(alpha: f64, samples: f64) -> Self {
        let lowest = PI * lowest_pole(alpha) / samples.max(2.0);
        let slope = if alpha < 2.0 { alpha } else { alpha - 2.0 };
        let decay = |corner: f64| 2.0 * corner.asinh();
        let (mut poles, mut zeros) = (Vec::new(), Vec::new());
        let mut corner = HIGHEST_POLE;
        let mut corners = Vec::new();
        for _ in 0..PAIRS_MAX {
            poles.push(decay(corner));
            zeros.push(decay(corner * RATIO.powf(0.5 * slope)));
            corners.push(corner);
            if corner <= lowest {
                break;
            }
            corner /= RATIO;
        }
        if alpha >= 2.0 {
            poles.push(decay(corner / RATIO));
        }
        // |1 − φe^(−iω)|² = 4φ·(corner² + x) with x = sin² πf·dt. The power in x is x^−α/2 times `level` in the ladder's middle:
        // each pair gives its share of the slope about the geometric middle of zero and pole.
        let log_level: f64 = alpha * PI.ln() + mean_log_excess(alpha, &corners, slope, corner / RATIO);
        let log_gain = log_level - zeros.iter().map(|zero| 4_f64.ln() - zero).sum::<f64>()
            + poles.iter().map(|pole| 4_f64.ln() - pole).sum::<f64>();
        let gain = (0.5 * log_gain).exp();
        // Partial fractions in 1/(1 − φz⁻¹).
        let one_minus_quotient = |above: f64, below: f64| -(below - above).exp_m1();
        let weights = (0..poles.len())
            .map(|own| {
                let above: f64 = zeros.iter().map(|zero| one_minus_quotient(*zero, poles[own])).product();
                let others = poles.iter().enumerate().filter(|(other, _)| *other != own);
                let below: f64 = others.map(|(_, other)| one_minus_quotient(*other, poles[own])).product();
                gain * above / below
            })
            .collect();
        let quotient = poles.iter().sum::<f64>() - zeros.iter().sum::<f64>();
        let direct = if alpha < 2.0 { gain * quotient.exp() } else { 0.0 };
        Self { decays: poles, weights, direct, taps: taps(alpha) }
    }

    /// Returns the lower triangle L with L·Lᵀ = covariance of the sections' stationary states, 1/(1 − φᵢφⱼ).
    fn stationary_root(&self) -> Vec<Vec<f64>> {
        let n = self.decays.len();
        let mut lower = vec![vec![0.0; n]; n];
        for i in 0..n {
            for j in 0..=i {
                let known: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
                let rest = -1.0 / (-(self.decays[i] + self.decays[j])).exp_m1() - known;
                lower[i][j] = match (i == j, lower[j][j] > 0.0) {
                    (true, _) => rest.max(0.0).sqrt(),
                    (false, true) => rest / lower[j][j],
                    (false, false) => 0.0,
                };
            }
        }
        lower
    }
}

/// Returns the mean of ln x^(−α/2) less ln of the ladder's power without gain, over two octaves of the frequency in
/// which the ladder ripples evenly about the law.
fn mean_log_excess(alpha: f64, corners: &[f64], slope: f64, foot: f64) -> f64 {
    const POINTS: u32 = 64;
    let spread = RATIO.powf(slope);
    // A period of the ripple, well inside the ladder.
    let from = (HIGHEST_POLE * 0.5 * corners.last().copied().unwrap_or(HIGHEST_POLE)).sqrt().min(0.125);
    let at = |point: u32| {
        let x = (from * RATIO.powf(f64::from(point) / f64::from(POINTS))).powi(2);
        let ladder: f64 = corners.iter().map(|c| ((c * c * spread + x) / (c * c + x)).ln()).sum();
        let pole = if alpha < 2.0 { 0.0 } else { (foot * foot + x).ln() };
        -0.5 * alpha * x.ln() - (ladder - pole)
    };
    (0..POINTS).map(at).sum::<f64>() / f64::from(POINTS)
}

/// Returns the taps whose gain is (sin πν/πν)^(α/2): exact at multiples of 1/64 of the rate.
fn taps(alpha: f64) -> Vec<f64> {
    let gain = |place: usize| {
        let x = PI * place as f64 / (2 * REACH) as f64;
        if place == 0 { 1.0 } else { (x.sin() / x).powf(0.5 * alpha) }
    };
    let gains: Vec<f64> = (0..=REACH).map(gain).collect();
    let end = |place: usize| if place == 0 || place == REACH { 0.5 } else { 1.0 };
    let one_side: Vec<f64> = (0..=REACH)
        .map(|tap| {
            let wave = |place: usize| (PI * (place * tap % (2 * REACH)) as f64 / REACH as f64).cos();
            let sum: f64 = (0..=REACH).map(|place| end(place) * gains[place] * wave(place)).sum();
            sum / REACH as f64 * if tap == REACH { 0.5 } else { 1.0 }
        })
        .collect();
    one_side.iter().rev().chain(&one_side[1..]).copied().collect()
}

/// Number of samples that pass the sections at a time.
const BLOCK: usize = 256;

/// The sections' states, and their last outputs.
#[derive(Debug)]
struct PowerSampler {
    scale: f64,
    poles: Vec<f64>,
    weights: Vec<f64>,
    states: Vec<f64>,
    direct: f64,
    taps: Vec<f64>,
    /// The input that the taps reach back to, followed by the present block.
    passed: Vec<f64>,
    input: Vec<f64>,
    /// The value that is subtracted, so that a slope without a level begins at 0; `None` before the first sample.
    start: Option<f64>,
    stream: Stream,
}

impl PowerSampler {
    fn new(scale: f64, alpha: f64, samples: f64, mut stream: Stream) -> Self {
        let ladder = Ladder::new(alpha, samples);
        let normals: Vec<f64> = ladder.decays.iter().map(|_| stream.normal()).collect();
        let state = |row: &Vec<f64>| row.iter().zip(&normals).map(|(root, normal)| root * normal).sum::<f64>();
        let mut sampler = Self {
            scale,
            poles: ladder.decays.iter().map(|decay| (-decay).exp()).collect(),
            states: ladder.stationary_root().iter().map(state).collect(),
            weights: ladder.weights,
            direct: ladder.direct,
            taps: ladder.taps,
            passed: Vec::with_capacity(TAPS + BLOCK),
            input: Vec::with_capacity(BLOCK),
            start: (alpha <= 1.0).then_some(0.0),
            stream,
        };
        sampler.pass(TAPS - 1);
        sampler
    }

    /// Appends the sections' next `count` values.
    fn pass(&mut self, count: usize) {
        self.input.clear();
        for _ in 0..count {
            self.input.push(self.stream.normal());
        }
        let first = self.passed.len();
        self.passed.extend(self.input.iter().map(|drive| self.direct * drive));
        let next = &mut self.passed[first..];
        for ((pole, weight), state) in self.poles.iter().zip(&self.weights).zip(&mut self.states) {
            let mut own = *state;
            for (value, drive) in next.iter_mut().zip(&self.input) {
                own = own * pole + drive;
                *value += own * weight;
            }
            *state = own;
        }
    }
}

impl Sampler for PowerSampler {
    fn act(&mut self, values: &mut [f64], _temperature: Temperature<'_>) {
        for block in values.chunks_mut(BLOCK) {
            self.pass(block.len());
            for (place, value) in block.iter_mut().enumerate() {
                let window = &self.passed[place..place + TAPS];
                let sum: f64 = window.iter().zip(&self.taps).map(|(value, tap)| value * tap).sum();
                *value += self.scale * (sum - *self.start.get_or_insert(sum));
            }
            self.passed.drain(..block.len());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    /// Returns the ratio of the running filter's density to that of the law.
    fn ratio(ladder: &Ladder, alpha: f64, cycles: f64) -> f64 {
        let (mut real, mut imaginary) = (ladder.direct, 0.0);
        let (sine, half) = ((2.0 * PI * cycles).sin(), (PI * cycles).sin());
        for (decay, weight) in ladder.decays.iter().zip(&ladder.weights) {
            let place = (-decay).exp();
            let (below_real, below_imaginary) = (-(-decay).exp_m1() + 2.0 * place * half * half, place * sine);
            let norm = below_real * below_real + below_imaginary * below_imaginary;
            real += weight * below_real / norm;
            imaginary -= weight * below_imaginary / norm;
        }
        let wave = |tap: usize| (2.0 * PI * cycles * (tap as f64 - REACH as f64)).cos();
        let gain: f64 = ladder.taps.iter().enumerate().map(|(tap, weight)| weight * wave(tap)).sum();
        (real * real + imaginary * imaginary) * gain * gain * cycles.powf(alpha)
    }

    #[test]
    fn the_density_is_the_power_law_from_one_over_the_record_to_half_the_rate() {
        for samples in [1000.0, 720_000.0, 7e7] {
            for alpha in [0.01, 0.3, 0.5, 1.0, 1.5, 1.9, 1.99, 2.0, 2.01, 2.2, 2.49] {
                let ladder = Ladder::new(alpha, samples);
                let mut worst: (f64, f64) = (0.0, 0.0);
                for step in 0..4000 {
                    let cycles = 0.5 * (2.0 / samples).powf(f64::from(step) / 3999.0);
                    let off = ratio(&ladder, alpha, cycles) - 1.0;
                    if off.abs() > worst.0.abs() {
                        worst = (off, cycles);
                    }
                }
                assert!(worst.0.abs() < 0.02, "{samples} samples, slope {alpha}: {worst:?}");
            }
        }
    }

    #[test]
    fn spectrum_and_allan_variance_are_those_of_the_law() {
        for alpha in [0.5, 1.4, 2.0] {
            let law = PowerLaw { alpha, at_hz: 2.0, density: 0.3 };
            check::agrees_with_its_closed_forms(&law, 40.0);
        }
        check::agrees_with_its_closed_forms(&PowerLaw { alpha: 0.3, at_hz: 100.0, density: 2.0 }, 40.0);
    }

    /// For steep slopes the Allan variance of one record is so far from normal that a hundred records do not suffice.
    #[test]
    fn steep_slopes_have_their_allan_variance_over_many_records() {
        let law = PowerLaw { alpha: 2.4, at_hz: 2.0, density: 0.3 };
        let (records, m) = (2000, 128);
        let one = |seed| {
            let values = check::draw(&law, 40.0, 1024, seed);
            check::allan_variance(&values, m as usize)
        };
        let found: Vec<f64> = (0..records).map(one).collect();
        let (mean, error) = check::mean_and_error(&found);
        let expected = law.allan_variance(m, Record { rate_hz: 40.0, samples: 1024 }).unwrap();
        assert!((mean - expected).abs() < 5.0 * error, "{mean:e} ± {error:e}, expected {expected:e}");
        assert!(error < 0.03 * expected);
    }

    #[test]
    fn known_slopes_have_their_allan_variances() {
        for m in [1, 2, 3, 17, 511, 512, 513, 5000, 1_000_001] {
            let averaged = m as f64;
            // The limits of white noise, and of flicker noise with B²/2π = 1.
            assert!((unit_allan_variance(1e-9, m) * averaged - 1.0).abs() < 1e-5, "m = {m}");
            let flicker = super::super::Flicker { b: (2.0 * PI).sqrt() };
            let exact = flicker.allan_variance(m, Record { rate_hz: 1.0, samples: 1 }).unwrap();
            assert!((unit_allan_variance(1.0, m) / exact - 1.0).abs() < 1e-5, "m = {m}");
        }
        // A random walk without folding approaches (2π)²·m/3.
        assert!((unit_allan_variance(2.0, 100_000) / (2.0 * PI).powi(2) / 100_000.0 * 3.0 - 1.0).abs() < 1e-4);
    }

    #[test]
    fn a_slope_that_has_no_level_begins_at_0() {
        assert_eq!(check::draw(&PowerLaw { alpha: 1.5, at_hz: 1.0, density: 1.0 }, 40.0, 10, 1)[0], 0.0);
        assert_ne!(check::draw(&PowerLaw { alpha: 1.0, at_hz: 1.0, density: 1.0 }, 40.0, 10, 1)[0], 0.0);
    }

    #[test]
    fn senseless_parameters_are_refused() {
        let law = PowerLaw { alpha: 1.5, at_hz: 1.0, density: 1.0 };
        assert_eq!(law.check(40.0), Ok(()));
        for wrong in [
            PowerLaw { alpha: 0.0, ..law },
            PowerLaw { alpha: 2.5, ..law },
            PowerLaw { alpha: f64::NAN, ..law },
            PowerLaw { at_hz: 0.0, ..law },
            PowerLaw { density: -1.0, ..law },
        ] {
            assert!(wrong.check(40.0).is_err(), "{wrong:?}");
        }
    }
}
