//! The fit compared with the truth in many simulated records, from a generator that is independent of the program's
//! simulator.
//!
//! `cargo test --release -p imu-noise fit::monte_carlo -- --ignored --nocapture`; `VN100D_SEEDS` sets their number.

use super::term::Term;
use super::variance_fit::VarianceFit;
use crate::allan::{FixedPoint, Overlapping, TauGrid};
use std::f64::consts::PI;

const RATE_HZ: f64 = 40.0;
const SAMPLES: usize = 720_000;

/// SplitMix64 and the Box–Muller method.
struct Gauss(u64);

impl Gauss {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
    fn next(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (2.0 * PI * self.uniform()).cos()
    }
}

/// Returns flicker of spectrum 1/(2πf): shaped in frequency over a record at least twice as long, of which the first
/// part is used.
fn flicker(count: usize, gauss: &mut Gauss) -> Vec<f64> {
    let length = (2 * count).next_power_of_two();
    let dt_s = 1.0 / RATE_HZ;
    let mut plan = realfft::RealFftPlanner::<f64>::new();
    let inverse = plan.plan_fft_inverse(length);
    let mut spectrum = inverse.make_input_vec();
    let last = spectrum.len() - 1;
    for (index, bin) in spectrum.iter_mut().enumerate().skip(1) {
        let f = index as f64 / (length as f64 * dt_s);
        // E|X|² = S · n / dt for an unnormalised transform.
        let size = (1.0 / (2.0 * PI * f) * length as f64 / dt_s / 2.0).sqrt();
        *bin = realfft::num_complex::Complex::new(
            gauss.next() * size,
            if index == last { 0.0 } else { gauss.next() * size },
        );
    }
    let mut output = inverse.make_output_vec();
    inverse.process(&mut spectrum, &mut output).unwrap();
    output.truncate(count);
    output.iter().map(|value| value / length as f64).collect()
}

fn record(n: f64, b: f64, k: f64, seed: u64) -> Vec<f64> {
    let mut gauss = Gauss(seed.wrapping_mul(0xa076_1d64_78bd_642f) ^ 0xe703_7ed1_a0b4_28db);
    let dt_s = 1.0 / RATE_HZ;
    let flicker = if b > 0.0 { flicker(SAMPLES, &mut gauss) } else { vec![0.0; SAMPLES] };
    let mut walk = 0.0;
    flicker
        .into_iter()
        .map(|flicker| {
            walk += k * dt_s.sqrt() * gauss.next();
            n / dt_s.sqrt() * gauss.next() + b * flicker + walk
        })
        .collect()
}

#[derive(Default)]
struct Tally {
    /// Relative errors with N, B and K free, and with the kept terms.
    free: Vec<f64>,
    chosen: Vec<f64>,
    covered: usize,
    named: usize,
    limits: usize,
    limits_covered: usize,
}

/// Returns bias and root mean square error in percent.
fn bias_and_rmse(errors: &[f64]) -> (f64, f64) {
    let count = errors.len().max(1) as f64;
    let square = errors.iter().map(|error| error * error).sum::<f64>();
    (errors.iter().sum::<f64>() / count * 100.0, (square / count).sqrt() * 100.0)
}

fn scenario(name: &str, truth: [f64; 3], seeds: u64) -> [Tally; 3] {
    let mut tallies: [Tally; 3] = Default::default();
    let mut residuals = Vec::new();
    for seed in 0..seeds {
        let samples = record(truth[0], truth[1], truth[2], seed + 1);
        let mut estimator =
            Overlapping::new(FixedPoint::for_range(0, 6).unwrap(), TauGrid::octave(SAMPLES as u64).unwrap());
        estimator.push(&samples);
        let fit = VarianceFit::new(&estimator.into_sums().points(), 1.0 / RATE_HZ, None).unwrap();
        let all = fit.fit(&[Term::N, Term::B, Term::K]).unwrap();
        let choice = fit.choose().unwrap();
        if let Some(residual) = choice.residual {
            residuals.push(residual.p_value);
        }
        let chosen = &choice.model;
        let intervals = fit.intervals(chosen, choice.widen).unwrap();
        for (index, term) in [Term::N, Term::B, Term::K].into_iter().enumerate() {
            let tally = &mut tallies[index];
            let at = chosen.squares.iter().position(|(t, _)| *t == term);
            if truth[index] > 0.0 {
                tally.free.push(all.squares[index].1.sqrt() / truth[index] - 1.0);
                if let Some(at) = at {
                    tally.chosen.push(chosen.squares[at].1.sqrt() / truth[index] - 1.0);
                }
            }
            if let Some(at) = at.filter(|at| choice.identified[*at]) {
                tally.named += 1;
                tally.covered += usize::from((intervals[at][0]..=intervals[at][1]).contains(&truth[index]));
            } else if let Some(limit) = fit.upper_limit(chosen, term, choice.widen) {
                tally.limits += 1;
                tally.limits_covered += usize::from(limit >= truth[index]);
            }
        }
    }
    println!("{name}: {seeds} seeds; truth {truth:?}");
    for (letter, tally) in ["N", "B", "K"].into_iter().zip(&tallies) {
        let (free, chosen) = (bias_and_rmse(&tally.free), bias_and_rmse(&tally.chosen));
        println!(
            "  {letter}: free: bias {:+.2} % rmse {:.2} %; kept in {}: bias {:+.2} % rmse {:.2} %; \
             named {} covered {}; limits {} covered {}",
            free.0,
            free.1,
            tally.chosen.len(),
            chosen.0,
            chosen.1,
            tally.named,
            tally.covered,
            tally.limits,
            tally.limits_covered
        );
    }
    let mean_p = residuals.iter().sum::<f64>() / residuals.len().max(1) as f64;
    let low = residuals.iter().filter(|p| **p < 0.05).count();
    println!("  residual p-values: mean {mean_p:.3}, below 0.05: {low} of {}", residuals.len());
    tallies
}

#[test]
#[ignore = "minutes"]
fn intervals_hold_the_truth_as_often_as_they_state() {
    let seeds = std::env::var("VN100D_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(100);
    // Four standard deviations of a count at 95 %.
    let least = |count: usize| 0.95 * count as f64 - 4.0 * (0.95 * 0.05 * count as f64).sqrt();
    let holds = |tally: &Tally| {
        let covered = tally.covered + tally.limits_covered;
        assert!(covered as f64 >= least(tally.named + tally.limits), "{covered} of {}", tally.named + tally.limits);
    };
    let a = scenario("A", [3.5e-3, 1e-3, 5e-5], seeds);
    a.iter().for_each(holds);
    assert!(
        bias_and_rmse(&a[0].free).1 < 0.11 && bias_and_rmse(&a[1].free).1 < 4.6 && bias_and_rmse(&a[2].free).1 < 28.0
    );
    let b = scenario("B", [3.5e-3, 0.0, 5e-5], seeds);
    [&b[0], &b[2]].into_iter().for_each(holds);
    assert!(b[1].named as f64 <= 0.06 * seeds as f64, "B named where there is none in {}", b[1].named);
    let d = scenario("D", [3.5e-3, 1e-3, 1.5e-5], seeds);
    d[..2].iter().for_each(holds);
    assert!(d[2].named as f64 <= 0.12 * seeds as f64, "K named where it cannot be seen in {}", d[2].named);
}
