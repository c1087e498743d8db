//! Flicker noise (B), the bias instability of IEEE Std 952: a spectrum of B²/(2πf) from below one over the record's
//! length up to Nyquist, streamed in bounded memory.
//!
//! White noise passes one rational filter. The poles and zeros of the filter alternate on a logarithmic scale, two
//! octaves from pole to pole ([`RATIO`]). Its power falls as 1/f with a ripple of ±0.35 % (a ladder of ratio r ripples
//! by ±2/sinh(π²/ln r)). Close to Nyquist the samples' spectrum must be 1/f itself, kinked at Nyquist, and not its
//! aliased form. There, the top of the ladder, one lone pole and a pole-zero pair on the negative axis were fitted to
//! the target (log spectrum, 32-norm, 1e-5 … 0.5 of the rate; largest deviation ±0.98 %). One normal number per sample
//! is enough; a sum of independent processes would take one per pole.
//!
//! The filter runs as a sum of first-order sections and starts in its stationary state. The lowest pole lies at
//! 1/16 of one over the record's length ([`LOWEST_POLE`]), where its flattening costs less than 0.1 %.
//!
//! Validation: `the_spectrum_is_one_over_f_within_two_percent_from_one_over_the_record_up_to_nyquist`: ≤ 1 % for 5 h at
//! 40 Hz, 5 h and 24 h at 800 Hz.

use super::described::effect;
use super::spec::FROM_ZERO;
use super::{Effect, Record, Sampler, Stage, Stream, Temperature};
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, LN_2, PI};

effect! {
    /// Flicker noise with two-sided PSD B²/(2πf) up to Nyquist; its Allan deviation is flat at 0.664 B.
    ///
    /// Source: IEEE Std 952-1997, annex C (bias instability), without its cut-off frequency.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Flicker: dyn Effect, 2, Stage::Noise;
    "bias instability, two-sided density B²/(2πf)";
    b as "B": f64 = FROM_ZERO, "U", "B in U";
}

/// Up to this averaging factor the Allan variance is integrated; beyond it, the expansion is used (its error is below
/// 1e-6 there).
const INTEGRATED_UP_TO: u64 = 32;

impl Effect for Flicker {
    fn psd(&self, frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(self.b * self.b / (2.0 * PI * frequency_hz))
    }
    /// Returns the integral of the spectrum up to Nyquist, B²·(2/πm²)·∫ sin⁴(mx)/(x sin²x) dx over 0…π/2: 0.525 B² at m
    /// = 1, (2 ln 2/π)·B² = 0.441 B² for large m.
    fn allan_variance(&self, m: u64, _record: Record) -> Option<f64> {
        Some(self.b * self.b * unit_allan_variance(m.max(1)))
    }
    fn sampler(&self, rate_hz: f64, record_length_s: f64, stream: Stream) -> Box<dyn Sampler> {
        Box::new(FlickerSampler::new(self.b, &Ladder::new(rate_hz * record_length_s), stream))
    }
}

/// Returns the Allan variance of flicker noise with B = 1 at averaging factor `m`.
fn unit_allan_variance(m: u64) -> f64 {
    let averaged = m as f64;
    if m <= INTEGRATED_UP_TO {
        let integrand = |x: f64| {
            let (top, bottom) = ((averaged * x).sin(), x.sin());
            if x == 0.0 { 0.0 } else { top.powi(4) / (x * bottom * bottom) }
        };
        return 2.0 / (PI * averaged * averaged) * simpson(integrand, FRAC_PI_2, 256 * m);
    }
    // sin⁴(mx)/(x sin²x) = sin⁴(mx)/x³ + sin⁴(mx)·(1/sin²x − 1/x²)/x; for large m only the mean 3/8 of sin⁴ counts in
    // the part that is not singular at 0. The constant below comes from integrating the pieces.
    2.0 / PI * (LN_2 + (expansion_constant() + averaged.ln() / 8.0) / (averaged * averaged))
}

/// Returns the m-independent part of the expansion of the Allan variance in 1/m².
fn expansion_constant() -> f64 {
    const EULER_GAMMA: f64 = 0.577_215_664_901_532_9;
    // (1/sin²x − 1/x² − 1/3)/x, whose series begins with x/15.
    let rest = |x: f64| {
        if x < 1e-2 { x / 15.0 } else { (1.0 / x.sin().powi(2) - 1.0 / (x * x) - 1.0 / 3.0) / x }
    };
    let beyond_nyquist = 3.0 / 16.0 / (FRAC_PI_2 * FRAC_PI_2);
    3.0 / 8.0 * ((EULER_GAMMA + PI.ln()) / 3.0 + simpson(rest, FRAC_PI_2, 512)) - LN_2 / 24.0 - beyond_nyquist
}

/// Integrates over 0…`end` by Simpson's rule with `panels` panels (even).
fn simpson(integrand: impl Fn(f64) -> f64, end: f64, panels: u64) -> f64 {
    let step = end / panels as f64;
    let inner: f64 = (1..panels).map(|i| if i % 2 == 1 { 4.0 } else { 2.0 } * integrand(i as f64 * step)).sum();
    step / 3.0 * (integrand(0.0) + inner + integrand(end))
}

/// Ratio of neighbouring poles of the ladder; its zeros lie at the geometric middle.
const RATIO: f64 = 4.0;
/// The lowest pole's frequency times the record's length.
const LOWEST_POLE: f64 = 1.0 / 16.0;
/// Maximum number of pairs in a ladder: enough for 5e12 samples (200 years at 800 Hz).
const PAIRS_MAX: usize = 22;
/// Maximum number of first-order sections in a ladder: its pairs' poles, the lone pole and the one on the negative
/// axis.
const SECTIONS_MAX: usize = PAIRS_MAX + 2;
/// Sections computed side by side; keeps their state in registers.
const LANES: usize = 8;

// The fitted top of the ladder. With x = sin²(πf/rate), the filter's power times π·f/rate is 1 for
// GAIN·(ZERO − x)/(POLE − x)/(LONE² + x) · Π (ζ² + x)/(α² + x), α = TOP, TOP/4, TOP/16 …, ζ = 2α.
const LONE: f64 = 0.664_523_802_249_566_9;
const TOP: f64 = 0.147_556_947_884_764_34;
const GAIN: f64 = 1.065_927_257_420_672;
const NEGATIVE_ZERO: f64 = 1.035_173_513_374_276_8;
const NEGATIVE_POLE: f64 = 1.043_261_663_089_701_4;

/// A pole or zero at e^(−decay), on the negative axis if `negative`.
#[derive(Debug, Clone, Copy)]
struct Root {
    decay: f64,
    negative: bool,
}

impl Root {
    /// Returns the root of the factor x + `corner`².
    fn at_corner(corner: f64) -> Self {
        Self { decay: 2.0 * corner.asinh(), negative: false }
    }
    /// Returns the root of the factor `edge` − x, `edge` above 1.
    fn beyond_nyquist(edge: f64) -> Self {
        Self { decay: 2.0 * edge.sqrt().acosh(), negative: true }
    }
    fn place(self) -> f64 {
        if self.negative { -(-self.decay).exp() } else { (-self.decay).exp() }
    }
    /// Returns 1 − self·other, without cancellation for roots close to 1.
    fn one_minus_product(self, other: Self) -> f64 {
        let exponent = -(self.decay + other.decay);
        if self.negative == other.negative { -exponent.exp_m1() } else { 1.0 + exponent.exp() }
    }
    /// Returns 1 − self/other, without cancellation for roots close to 1.
    fn one_minus_quotient(self, other: Self) -> f64 {
        let exponent = other.decay - self.decay;
        if self.negative == other.negative { -exponent.exp_m1() } else { 1.0 + exponent.exp() }
    }
}

/// The filter that turns white noise of variance 1 into noise of spectrum rate/(πf) (per unit of normalised frequency).
#[derive(Debug)]
struct Ladder {
    poles: Vec<Root>,
    /// Weight of each pole's first-order section.
    weights: Vec<f64>,
}

impl Ladder {
    /// Returns the ladder for a record of `samples` samples (any number; fewer than 2 count as 2).
    fn new(samples: f64) -> Self {
        let lowest = PI * LOWEST_POLE / samples.max(2.0);
        let mut poles = vec![Root::at_corner(LONE), Root::beyond_nyquist(NEGATIVE_POLE)];
        let mut zeros = vec![Root::beyond_nyquist(NEGATIVE_ZERO)];
        let mut corner = TOP;
        for _ in 0..PAIRS_MAX {
            poles.push(Root::at_corner(corner));
            zeros.push(Root::at_corner(corner * RATIO.sqrt()));
            if corner <= lowest {
                break;
            }
            corner /= RATIO;
        }
        // |1 − φe^(−iω)|² = 4φ·(α² + x): the fitted power in x becomes a filter with this gain.
        let log_gain = GAIN.ln() - zeros.iter().map(|zero| 4_f64.ln() - zero.decay).sum::<f64>()
            + poles.iter().map(|pole| 4_f64.ln() - pole.decay).sum::<f64>();
        let gain = (0.5 * log_gain).exp();
        // Partial fractions. There is one zero fewer than poles, so that no part of the input passes directly.
        let weights = poles
            .iter()
            .enumerate()
            .map(|(own, pole)| {
                let above: f64 = zeros.iter().map(|zero| zero.one_minus_quotient(*pole)).product();
                let below: f64 = poles
                    .iter()
                    .enumerate()
                    .filter(|(other, _)| *other != own)
                    .map(|(_, other)| other.one_minus_quotient(*pole))
                    .product();
                gain * above / below
            })
            .collect();
        Self { poles, weights }
    }

    /// Returns the lower triangle L with L·Lᵀ = covariance of the sections' stationary states, 1/(1 − φᵢφⱼ).
    fn stationary_root(&self) -> Vec<Vec<f64>> {
        let n = self.poles.len();
        let mut lower = vec![vec![0.0; n]; n];
        for i in 0..n {
            for j in 0..=i {
                let known: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
                let rest = 1.0 / self.poles[i].one_minus_product(self.poles[j]) - known;
                lower[i][j] = if i == j { rest.max(0.0).sqrt() } else { rest / lower[j][j] };
            }
        }
        lower
    }
}

/// The sections' states. The padding beyond the last section has weight 0.
#[derive(Debug)]
struct FlickerSampler {
    scale: f64,
    groups: usize,
    poles: [f64; SECTIONS_MAX],
    weights: [f64; SECTIONS_MAX],
    states: [f64; SECTIONS_MAX],
    input: Vec<f64>,
    stream: Stream,
}

/// Number of samples that pass the sections at a time.
const BLOCK: usize = 256;

impl FlickerSampler {
    fn new(b: f64, ladder: &Ladder, mut stream: Stream) -> Self {
        // B²/(2πf) is B²/2 times the ladder's spectrum.
        let scale = b * FRAC_1_SQRT_2;
        let (mut poles, mut weights, mut states) = ([0.0; SECTIONS_MAX], [0.0; SECTIONS_MAX], [0.0; SECTIONS_MAX]);
        let start: Vec<f64> = ladder.poles.iter().map(|_| stream.normal()).collect();
        for (i, row) in ladder.stationary_root().iter().enumerate() {
            poles[i] = ladder.poles[i].place();
            weights[i] = ladder.weights[i];
            states[i] = scale * row.iter().zip(&start).map(|(root, normal)| root * normal).sum::<f64>();
        }
        Self {
            scale,
            groups: ladder.poles.len().div_ceil(LANES),
            poles,
            weights,
            states,
            input: vec![0.0; BLOCK],
            stream,
        }
    }
}

impl Sampler for FlickerSampler {
    fn act(&mut self, values: &mut [f64], _temperature: Temperature<'_>) {
        for block in values.chunks_mut(BLOCK) {
            let input = &mut self.input[..block.len()];
            for slot in input.iter_mut() {
                *slot = self.scale * self.stream.normal();
            }
            let (poles, _) = self.poles.as_chunks::<LANES>();
            let (weights, _) = self.weights.as_chunks::<LANES>();
            let (states, _) = self.states.as_chunks_mut::<LANES>();
            for group in 0..self.groups {
                let (pole, weight, mut state) = (poles[group], weights[group], states[group]);
                for (value, drive) in block.iter_mut().zip(input.iter()) {
                    let mut sums = [0.0; LANES];
                    for lane in 0..LANES {
                        state[lane] = state[lane] * pole[lane] + drive;
                        sums[lane] = state[lane] * weight[lane];
                    }
                    *value += ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]));
                }
                states[group] = state;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    /// Returns the ratio of the running filter's spectrum (poles and weights) to the intended one.
    fn ratio_to_target(ladder: &Ladder, cycles_per_sample: f64) -> f64 {
        let sine = (2.0 * PI * cycles_per_sample).sin();
        let (mut real, mut imaginary) = (0.0, 0.0);
        for (pole, weight) in ladder.poles.iter().zip(&ladder.weights) {
            // weight/(1 − φe^(−iω)); 1 − φ cos ω is formed without cancellation.
            let place = pole.place();
            let half = (PI * cycles_per_sample).sin();
            let one_minus = if pole.negative { 1.0 - place } else { -(-pole.decay).exp_m1() };
            let (below_real, below_imaginary) = (one_minus + 2.0 * place * half * half, place * sine);
            let norm = below_real * below_real + below_imaginary * below_imaginary;
            real += weight * below_real / norm;
            imaginary -= weight * below_imaginary / norm;
        }
        (real * real + imaginary * imaginary) * PI * cycles_per_sample
    }

    #[test]
    fn the_spectrum_is_one_over_f_within_two_percent_from_one_over_the_record_up_to_nyquist() {
        for (rate_hz, length_s) in [(40.0, 754.0), (40.0, 18_000.0), (800.0, 18_000.0), (800.0, 86_400.0)] {
            let samples: f64 = rate_hz * length_s;
            let ladder = Ladder::new(samples);
            let mut worst: f64 = 0.0;
            let (low, high) = ((1.0 / samples).ln(), 0.5_f64.ln());
            for i in 0..=4000 {
                let cycles = (low + (high - low) * f64::from(i) / 4000.0).exp();
                worst = worst.max((ratio_to_target(&ladder, cycles) - 1.0).abs());
            }
            for i in 0..400 {
                let cycles = 0.5 - 0.5 * 10_f64.powf(-f64::from(i) / 40.0);
                if cycles > 0.0 {
                    worst = worst.max((ratio_to_target(&ladder, cycles) - 1.0).abs());
                }
            }
            println!("{rate_hz} Hz, {length_s} s: {} sections, worst {:.3} %", ladder.poles.len(), 100.0 * worst);
            assert!(worst < 0.01, "{rate_hz} Hz for {length_s} s: {worst}");
        }
    }

    #[test]
    fn the_spectrum_does_not_flatten_at_half_the_lowest_frequency_either() {
        let samples = 720_000.0;
        let ladder = Ladder::new(samples);
        let ratio = ratio_to_target(&ladder, 0.5 / samples);
        assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
    }

    #[test]
    fn the_start_is_stationary() {
        // The covariance of the states must reproduce itself through one step: P = ΦPΦ + 1.
        let ladder = Ladder::new(720_000.0);
        let root = ladder.stationary_root();
        for i in 0..ladder.poles.len() {
            for j in 0..ladder.poles.len() {
                let covariance: f64 = root[i].iter().zip(&root[j]).map(|(a, b)| a * b).sum();
                let after = ladder.poles[i].place() * ladder.poles[j].place() * covariance + 1.0;
                assert!((after - covariance).abs() <= 1e-9 * covariance.abs().max(1.0), "{i} {j}");
            }
        }
    }

    #[test]
    fn spectrum_and_allan_variance_are_those_of_flicker_noise() {
        check::agrees_with_its_closed_forms(&Flicker { b: 5.3e-4 }, 40.0);
    }

    #[test]
    fn the_expansion_of_the_allan_variance_continues_the_integral() {
        for m in [INTEGRATED_UP_TO + 1, 64, 100] {
            let averaged = m as f64;
            let integrand = |x: f64| if x == 0.0 { 0.0 } else { (averaged * x).sin().powi(4) / (x * x.sin().powi(2)) };
            let exact = 2.0 / (PI * averaged * averaged) * simpson(integrand, FRAC_PI_2, 256 * m);
            assert!((unit_allan_variance(m) / exact - 1.0).abs() < 1e-6, "m = {m}");
        }
        // Cin(π)/π at m = 1, 2 ln 2/π far out (the flat level 0.664 B).
        assert!((unit_allan_variance(1) - 0.524_67).abs() < 1e-4);
        assert!((unit_allan_variance(1_000_000).sqrt() - 0.664_28).abs() < 1e-5);
    }

    #[test]
    fn values_do_not_depend_on_how_the_stream_is_cut() {
        let whole = check::draw(&Flicker { b: 1.0 }, 40.0, 1000, 11);
        let mut sampler = Flicker { b: 1.0 }.sampler(40.0, 25.0, check::stream(11));
        let mut pieces = vec![0.0; 1000];
        for piece in pieces.chunks_mut(77) {
            sampler.apply(piece);
        }
        assert_eq!(whole, pieces);
    }
}
