//! Compares the noise fit with the truth over many simulated records, and with the exact maximum-likelihood fit of the
//! same records.
//!
//! ```text
//! cargo run --release --example noise_monte_carlo -- --seeds 1000 [--first 1] [--scenario A] [--threads 2] [--samples 720000]
//! ```
//!
//! Records come from the simulator's own effects. "Exact" is the Whittle likelihood of every single DST coefficient,
//! without bins and with the true set of terms given, maximised by scoring from the truth; "bound" is the inverse of
//! its Fisher information at the truth (Cramér–Rao). It shares two things with the noise fit: the constants for the
//! leakage of flicker's differences at the first four k, and the formula for a Gauss–Markov process at a stretch's
//! ends. An error in these would show in the bias of both, not in their ratio. Errors are in percent of the truth, over
//! the records in which the fit names the parameter; those of the exact fit over the same records.

#![expect(clippy::expect_used, reason = "a program for the workbench ends where it cannot go on")]

use imu_core::sample::Channel;
use imu_model::effects::{Effect, Flicker, RandomWalk, Stream, StreamId, White};
use imu_noise::allan::FixedPoint;
use imu_noise::fit::{Estimate, NoiseParameters};
use imu_noise::whittle::{DstEstimator, Transform, fit};
use nalgebra::{DMatrix, DVector};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

const RATE_HZ: f64 = 40.0;
const DT_S: f64 = 1.0 / RATE_HZ;

#[derive(Debug, Clone, Copy)]
struct Scenario {
    name: char,
    n: f64,
    b: f64,
    k: f64,
    /// σ and Tc.
    gauss_markov: Option<(f64, f64)>,
    /// R; the exact fit receives the record without the ramp.
    ramp: f64,
}

/// A to D as specified; E: a ramp beside a walk; F: a shorter correlation time; G: no walk; H: white noise alone.
const SCENARIOS: [Scenario; 8] = [
    Scenario { name: 'A', n: 3.5e-3, b: 1e-3, k: 5e-5, gauss_markov: None, ramp: 0.0 },
    Scenario { name: 'B', n: 3.5e-3, b: 0.0, k: 5e-5, gauss_markov: None, ramp: 0.0 },
    Scenario { name: 'C', n: 3.5e-3, b: 0.0, k: 0.0, gauss_markov: Some((1e-3, 500.0)), ramp: 0.0 },
    Scenario { name: 'D', n: 3.5e-3, b: 1e-3, k: 1.5e-5, gauss_markov: None, ramp: 0.0 },
    Scenario { name: 'E', n: 9e-4, b: 0.0, k: 2e-5, gauss_markov: None, ramp: 4e-7 },
    Scenario { name: 'F', n: 3.5e-3, b: 0.0, k: 0.0, gauss_markov: Some((2e-3, 60.0)), ramp: 0.0 },
    Scenario { name: 'G', n: 3.5e-3, b: 1e-3, k: 0.0, gauss_markov: None, ramp: 0.0 },
    Scenario { name: 'H', n: 3.5e-3, b: 0.0, k: 0.0, gauss_markov: None, ramp: 0.0 },
];

impl Scenario {
    fn truth(&self, letter: &str) -> f64 {
        match letter {
            "N" => self.n,
            "B" => self.b,
            "K" => self.k,
            "σ" => self.gauss_markov.map_or(0.0, |(sigma, _)| sigma),
            "Tc" => self.gauss_markov.map_or(0.0, |(_, tc_s)| tc_s),
            "R" => self.ramp,
            _ => 0.0,
        }
    }

    /// Returns the parameters that the exact fit fits.
    fn letters(&self) -> Vec<&'static str> {
        ["N", "B", "K", "σ", "Tc"].into_iter().filter(|letter| self.truth(letter) > 0.0).collect()
    }

    fn record(&self, seed: u64, samples: usize) -> Vec<f64> {
        let length_s = samples as f64 * DT_S;
        let stream = |effect| Stream::new(seed, StreamId { owner: 9, effect, instance: 0 });
        let mut values = vec![0.0; samples];
        White { n: self.n }.sampler(RATE_HZ, length_s, stream(1)).apply(&mut values);
        if self.b > 0.0 {
            Flicker { b: self.b }.sampler(RATE_HZ, length_s, stream(2)).apply(&mut values);
        }
        if self.k > 0.0 {
            RandomWalk { k: self.k }.sampler(RATE_HZ, length_s, stream(3)).apply(&mut values);
        }
        if let Some((sigma, tc_s)) = self.gauss_markov {
            let (mut noise, phi) = (stream(900), (-DT_S / tc_s).exp());
            let mut state = sigma * noise.normal();
            for value in &mut values {
                *value += state;
                state = phi * state + sigma * (1.0 - phi * phi).sqrt() * noise.normal();
            }
        }
        values
    }
}

/// The expected power of each coefficient, k by k.
struct Exact {
    letters: Vec<&'static str>,
    truth: Vec<f64>,
    samples: usize,
    /// 4 sin²(πk/2n).
    sine: Vec<f64>,
    /// Flicker of B = 1, with the leakage of its differences (the fit's own constants for k ≤ 4, its series beyond).
    flicker: Vec<f64>,
}

impl Exact {
    fn new(scenario: &Scenario, samples: usize) -> Self {
        use std::f64::consts::PI;
        let u = |k: usize| k as f64 / (2.0 * samples as f64);
        let leaks = |k: usize| match k {
            1 => 0.773_70,
            2 => 0.902_82,
            3 => 0.931_09,
            4 => 0.949_94,
            _ => 1.0 - 2.0 / (PI * PI * k as f64),
        };
        let letters = scenario.letters();
        Self {
            truth: letters.iter().map(|letter| scenario.truth(letter)).collect(),
            letters,
            samples,
            sine: (1..samples).map(|k| 4.0 * (PI * u(k)).sin().powi(2)).collect(),
            flicker: (1..samples).map(|k| leaks(k) / (2.0 * PI * u(k))).collect(),
        }
    }

    /// Returns the expected spectrum at k (from 0), and computes its derivatives by the logarithm of every coefficient.
    fn expected(&self, at: usize, coefficients: &[f64], derivatives: &mut [f64]) -> f64 {
        let mut sum = 0.0;
        for (index, letter) in self.letters.iter().enumerate() {
            let square = coefficients[index] * coefficients[index];
            let part = match *letter {
                "N" => square / DT_S,
                "B" => square * self.flicker[at],
                "K" => square * DT_S / self.sine[at],
                _ => continue,
            };
            derivatives[index] = 2.0 * part;
            sum += part;
        }
        if let Some(index) = self.letters.iter().position(|letter| *letter == "σ") {
            let (sigma, tc_s) = (coefficients[index], coefficients[index + 1]);
            let of = |tc_s: f64| {
                let decay = DT_S / tc_s;
                let (phi, rest) = ((-decay).exp(), -(-decay).exp_m1());
                let ends = 2.0 * decay / self.samples as f64 / (decay * decay + self.sine[at]);
                rest * (1.0 + phi) / (rest * rest + phi * self.sine[at]) * (1.0 - ends)
            };
            let part = sigma * sigma * of(tc_s);
            derivatives[index] = 2.0 * part;
            derivatives[index + 1] = sigma * sigma * (of(tc_s * 1.001) - of(tc_s / 1.001)) / (2.0 * 1.001f64.ln());
            sum += part;
        }
        sum
    }

    /// Returns the Fisher information and the score by the logarithms of the coefficients.
    fn information(&self, coefficients: &[f64], powers: Option<&[f64]>) -> (DMatrix<f64>, DVector<f64>) {
        let count = coefficients.len();
        let (mut information, mut score) = (DMatrix::zeros(count, count), DVector::zeros(count));
        let mut derivatives = vec![0.0; count];
        for at in 0..self.sine.len() {
            let expected = self.expected(at, coefficients, &mut derivatives);
            let excess = powers.map_or(0.0, |powers| powers[at] / expected - 1.0);
            for (one, derivative) in derivatives.iter().enumerate() {
                let relative = derivative / expected;
                score[one] += 0.5 * excess * relative;
                for (other, derivative) in derivatives.iter().enumerate() {
                    information[(one, other)] += 0.5 * relative * derivative / expected;
                }
            }
        }
        (information, score)
    }

    /// Returns the bound on every coefficient's relative standard deviation.
    fn bound(&self) -> Vec<f64> {
        let (information, _) = self.information(&self.truth, None);
        let covariance = information.try_inverse().expect("an information matrix has an inverse");
        covariance.diagonal().iter().map(|variance| variance.sqrt()).collect()
    }

    /// Returns the maximum of the likelihood. Logarithms cannot cross 0: a coefficient without support in the data ends
    /// far below the truth.
    fn fit(&self, powers: &[f64]) -> Vec<f64> {
        let mut coefficients = self.truth.clone();
        for _ in 0..60 {
            let (mut information, score) = self.information(&coefficients, Some(powers));
            // Scoring in squares converges at the boundary too; a little damping keeps the logarithms from diverging.
            for at in 0..coefficients.len() {
                information[(at, at)] += 1e-3;
            }
            let step = information.lu().solve(&score).expect("a damped matrix has an inverse");
            let longest = step.iter().fold(0.0f64, |longest, step| longest.max(step.abs()));
            let shorten = if longest > 0.7 { 0.7 / longest } else { 1.0 };
            for (coefficient, (step, truth)) in coefficients.iter_mut().zip(step.iter().zip(&self.truth)) {
                *coefficient = (*coefficient * (shorten * step).exp()).max(truth * 1e-3);
            }
            let settled = step.iter().zip(&coefficients).zip(&self.truth).all(|((step, coefficient), truth)| {
                // A coefficient at the floor cannot decrease further.
                (step * shorten).abs() < 2e-4 || *coefficient <= 1.01e-3 * truth
            });
            if settled {
                break;
            }
        }
        for (coefficient, truth) in coefficients.iter_mut().zip(&self.truth) {
            if *coefficient < 2e-3 * truth {
                *coefficient = 0.0;
            }
        }
        coefficients
    }
}

/// The results of one record.
struct Outcome {
    parameters: NoiseParameters,
    exact: Vec<f64>,
    fit_s: f64,
}

fn outcome(scenario: &Scenario, exact: &Exact, seed: u64, samples: usize, transform: &mut Transform) -> Outcome {
    let values = scenario.record(seed, samples);
    let ramped: Vec<f64> =
        values.iter().enumerate().map(|(index, value)| value + scenario.ramp * index as f64 * DT_S).collect();
    let begun = Instant::now();
    let mut estimator = DstEstimator::new(FixedPoint::for_range(0, 6).expect("a scale"));
    estimator.push(transform, &ramped);
    let sums = estimator.into_sums(transform);
    let parameters = fit(&sums, RATE_HZ, Channel::GyroX, &[], None);
    let fit_s = begun.elapsed().as_secs_f64();
    let mut powers = vec![0.0; samples - 1];
    transform.differences(&values, |k, z, sine_squared, _| powers[k - 1] = z * z / (4.0 * sine_squared));
    Outcome { parameters, exact: exact.fit(&powers), fit_s }
}

fn estimate<'a>(parameters: &'a NoiseParameters, letter: &str) -> Option<&'a Estimate> {
    match letter {
        "N" => Some(&parameters.n),
        "B" => Some(&parameters.b),
        "K" => Some(&parameters.k),
        "Q" => Some(&parameters.q),
        "R" => Some(&parameters.r),
        "σ" => parameters.gauss_markov.as_ref().map(|process| &process.sigma),
        _ => parameters.gauss_markov.as_ref().map(|process| &process.tc_s),
    }
}

/// Returns bias and root mean square in percent.
fn errors(of: &[f64]) -> (f64, f64) {
    let count = of.len().max(1) as f64;
    (100.0 * of.iter().sum::<f64>() / count, 100.0 * (of.iter().map(|e| e * e).sum::<f64>() / count).sqrt())
}

fn percent(part: usize, whole: usize) -> String {
    if whole == 0 { "–".to_owned() } else { format!("{:.1} %", 100.0 * part as f64 / whole as f64) }
}

fn report(scenario: &Scenario, bound: &[f64], outcomes: &[Outcome]) {
    let seeds = outcomes.len();
    println!();
    println!(
        "| {} | named | bias | RMSE | exact: bias | RMSE | bound | ratio | intervals hold | limits hold |",
        scenario.name
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for letter in ["N", "B", "K", "σ", "Tc", "Q", "R"] {
        let truth = scenario.truth(letter);
        let place = scenario.letters().iter().position(|other| *other == letter);
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        let (mut within, mut limited, mut below) = (0, 0, 0);
        let mut named = 0;
        for outcome in outcomes {
            let Some(found) = estimate(&outcome.parameters, letter) else { continue };
            if let (Some(value), Some([low, high])) = (found.value, found.ci95) {
                named += 1;
                within += usize::from((low..=high).contains(&truth));
                if let Some(place) = place {
                    ours.push(value / truth - 1.0);
                    theirs.push(outcome.exact[place] / truth - 1.0);
                }
            } else if let Some(limit) = found.upper_limit95 {
                limited += 1;
                below += usize::from(limit >= truth);
            }
        }
        let figures = match place {
            Some(place) if named > 0 => {
                let ((bias, rmse), (exact_bias, exact_rmse)) = (errors(&ours), errors(&theirs));
                format!(
                    "{bias:+.2} % | {rmse:.3} % | {exact_bias:+.2} % | {exact_rmse:.3} % | {:.3} % | {:.3}",
                    100.0 * bound[place],
                    rmse / exact_rmse
                )
            }
            _ => "– | – | – | – | – | –".to_owned(),
        };
        println!(
            "| {letter} | {named} of {seeds} | {figures} | {} ({within} of {named}) | {} ({below} of {limited}) |",
            percent(within, named),
            percent(below, limited)
        );
    }
    let low = outcomes.iter().filter(|outcome| outcome.parameters.fit.p_value.is_some_and(|p| p < 0.05)).count();
    let misfit = outcomes.iter().filter(|outcome| !outcome.parameters.flags.is_empty()).count();
    let took = outcomes.iter().map(|outcome| outcome.fit_s).sum::<f64>() / seeds as f64;
    println!();
    println!(
        "{seeds} records; residual p < 0.05 in {low}, flagged {misfit}; samples to parameters {:.0} ms.",
        1e3 * took
    );
    if scenario.b > 0.0 || scenario.k > 0.0 {
        // Over all records, not only those in which the noise fit names the parameter.
        let all: Vec<Vec<f64>> = outcomes.iter().map(|outcome| outcome.exact.clone()).collect();
        for (place, letter) in scenario.letters().iter().enumerate() {
            let of: Vec<f64> = all.iter().map(|exact| exact[place] / scenario.truth(letter) - 1.0).collect();
            let (bias, rmse) = errors(&of);
            println!("exact fit over all records, {letter}: bias {bias:+.2} %, RMSE {rmse:.3} %");
        }
    }
}

fn main() {
    let (mut seeds, mut first, mut threads, mut samples, mut only) = (100u64, 1u64, 1usize, 720_000usize, None);
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    for pair in arguments.chunks(2) {
        let [name, value] = pair else { panic!("{pair:?}: a name and a value") };
        match name.as_str() {
            "--seeds" => seeds = value.parse().expect("a number"),
            "--first" => first = value.parse().expect("a number"),
            "--threads" => threads = value.parse().expect("a number"),
            "--samples" => samples = value.parse().expect("a number"),
            "--scenario" => only = value.chars().next(),
            _ => panic!("{name}: --seeds, --first, --threads, --samples, --scenario"),
        }
    }
    println!("Records of {samples} samples at {RATE_HZ} Hz, seeds {first} to {}.", first + seeds - 1);
    for scenario in SCENARIOS.iter().filter(|scenario| only.is_none_or(|only| only == scenario.name)) {
        let begun = Instant::now();
        let exact = Exact::new(scenario, samples);
        let (next, outcomes) = (AtomicU64::new(first), Mutex::new(Vec::new()));
        std::thread::scope(|scope| {
            for _ in 0..threads.max(1) {
                scope.spawn(|| {
                    let mut transform = Transform::new();
                    loop {
                        let seed = next.fetch_add(1, Ordering::Relaxed);
                        if seed >= first + seeds {
                            break;
                        }
                        let outcome = outcome(scenario, &exact, seed, samples, &mut transform);
                        outcomes.lock().expect("no thread ended early").push(outcome);
                    }
                });
            }
        });
        report(scenario, &exact.bound(), &outcomes.into_inner().expect("no thread ended early"));
        eprintln!("{}: {:.1} s", scenario.name, begun.elapsed().as_secs_f64());
    }
}
