//! Compares the noise fit on records whose noise went through a filter with the truth.
//!
//! ```text
//! cargo run --release --example noise_worlds -- --seeds 100 [--first 1] [--world boxcar-4] [--samples 144000] [--slow 1] [--threads 2]
//! ```
//!
//! Records come from this program alone: normal numbers of ChaCha20, flicker by a Fourier series four times as long as
//! the record, filters as difference equations. The simulator is not used. "known" is the Cramér–Rao bound on N, the
//! plateau, with the filter known, and "free" the bound with its cutoff as a further parameter; white noise behind the
//! filter, if any, is a parameter too.

#![expect(clippy::expect_used, reason = "a program for the workbench ends where it cannot go on")]

use imu_core::sample::Channel;
use imu_noise::allan::{FixedPoint, LiveAllan};
use imu_noise::fit::{Estimate, NoiseParameters};
use imu_noise::hold_against;
use imu_noise::whittle::{DstEstimator, Transform, fit};
use nalgebra::DMatrix;
use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use rand_distr::{Distribution, StandardNormal};
use realfft::RealFftPlanner;
use realfft::num_complex::Complex;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

const RATE_HZ: f64 = 40.0;
/// Scenarios A and D, with a K that an hour shows.
const N: f64 = 3.5e-3;
const B: f64 = 1e-3;
const K: f64 = 5e-5;
/// Samples before the record, in which filters settle.
const LEAD: usize = 4096;

#[derive(Clone, Copy)]
enum Filter {
    Boxcar(usize),
    FirstOrder(f64),
    Butterworth(u32, f64),
    Fir11,
}

const WORLDS: [(&str, Filter); 12] = [
    ("none", Filter::Boxcar(1)),
    ("boxcar-2", Filter::Boxcar(2)),
    ("boxcar-4", Filter::Boxcar(4)),
    ("boxcar-8", Filter::Boxcar(8)),
    ("first-0.1", Filter::FirstOrder(0.1)),
    ("first-0.2", Filter::FirstOrder(0.2)),
    ("first-0.46", Filter::FirstOrder(0.46)),
    ("butterworth-2-0.1", Filter::Butterworth(2, 0.1)),
    ("butterworth-2-0.3", Filter::Butterworth(2, 0.3)),
    ("butterworth-4-0.1", Filter::Butterworth(4, 0.1)),
    ("butterworth-4-0.3", Filter::Butterworth(4, 0.3)),
    ("fir-11", Filter::Fir11),
];

impl Filter {
    fn apply(self, values: &[f64]) -> Vec<f64> {
        match self {
            Self::Boxcar(window) => convolve(values, &vec![1.0 / window as f64; window]),
            Self::FirstOrder(cutoff) => {
                // y += a (x − y).
                let c = 1.0 - (2.0 * PI * cutoff).cos();
                let a = (c * c + 2.0 * c).sqrt() - c;
                let mut y = 0.0;
                values
                    .iter()
                    .map(|x| {
                        y += a * (x - y);
                        y
                    })
                    .collect()
            }
            Self::Butterworth(order, cutoff) => {
                let w = (PI * cutoff).tan();
                let mut now = values.to_vec();
                for pair in 0..order / 2 {
                    let q = 2.0 * (PI * f64::from(2 * pair + 1) / f64::from(2 * order)).sin();
                    let norm = 1.0 / (1.0 + q * w + w * w);
                    let gain = w * w * norm;
                    let (a1, a2) = (2.0 * (w * w - 1.0) * norm, (1.0 - q * w + w * w) * norm);
                    let (mut x1, mut x2, mut y1, mut y2) = (0.0, 0.0, 0.0, 0.0);
                    for value in &mut now {
                        let y = gain * (*value + 2.0 * x1 + x2) - a1 * y1 - a2 * y2;
                        (x2, x1) = (x1, *value);
                        (y2, y1) = (y1, y);
                        *value = y;
                    }
                }
                now
            }
            Self::Fir11 => {
                // A Hamming-windowed sinc of cutoff 0.2.
                let taps: Vec<f64> = (0..11)
                    .map(|i| {
                        let t = f64::from(i) - 5.0;
                        let sinc = if t == 0.0 { 0.4 } else { (0.4 * PI * t).sin() / (PI * t) };
                        sinc * (0.54 - 0.46 * (2.0 * PI * f64::from(i) / 10.0).cos())
                    })
                    .collect();
                let sum: f64 = taps.iter().sum();
                convolve(values, &taps.iter().map(|tap| tap / sum).collect::<Vec<_>>())
            }
        }
    }
}

fn convolve(values: &[f64], taps: &[f64]) -> Vec<f64> {
    (0..values.len()).map(|i| taps.iter().zip(0..=i).map(|(tap, lag)| tap * values[i - lag]).sum()).collect()
}

/// Makes a record with N, B and K before the filter, and white noise behind it; `slow`: factor on B and K.
fn record(filter: Filter, behind: f64, slow: f64, samples: usize, seed: u64) -> Vec<f64> {
    let mut rng = ChaCha20Rng::seed_from_u64(0x9e37_79b9_7f4a_7c15 ^ seed);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
    let length = samples + LEAD;
    let mut front: Vec<f64> = (0..length).map(|_| N * RATE_HZ.sqrt() * normal()).collect();
    let circle = 4 * length.next_power_of_two();
    let mut planner = RealFftPlanner::<f64>::new();
    let inverse = planner.plan_fft_inverse(circle);
    let mut spectrum = inverse.make_input_vec();
    let bins = spectrum.len();
    for (bin, value) in spectrum.iter_mut().enumerate().take(bins - 1).skip(1) {
        // Two-sided B²/(2πf) of the sampled rate.
        let f = bin as f64 * RATE_HZ / circle as f64;
        let size = (B * B / (2.0 * PI * f) * RATE_HZ / circle as f64 / 2.0).sqrt();
        *value = Complex::new(size * normal(), size * normal());
    }
    let mut flicker = inverse.make_output_vec();
    inverse.process(&mut spectrum, &mut flicker).expect("lengths of the plan's own");
    let mut walk = 0.0;
    for (value, flicker) in front.iter_mut().zip(&flicker) {
        walk += K / RATE_HZ.sqrt() * normal();
        *value += slow * (flicker + walk);
    }
    let filtered = filter.apply(&front);
    filtered.iter().skip(LEAD).map(|value| value + behind * RATE_HZ.sqrt() * normal()).collect()
}

/// Returns |H|² on a grid of u from 0 to 1/2.
fn gains(filter: Filter) -> Vec<f64> {
    const LONG: usize = 8192;
    let mut impulse = vec![0.0; LONG];
    impulse[0] = 1.0;
    let mut response = filter.apply(&impulse);
    let transform = RealFftPlanner::<f64>::new().plan_fft_forward(LONG);
    let mut output = transform.make_output_vec();
    transform.process(&mut response, &mut output).expect("lengths of the plan's own");
    output.iter().map(|value| value.norm_sqr().max(1e-12)).collect()
}

/// Returns the relative bound on N, the plateau, if B, K and, if present, the white noise behind the filter are fitted
/// with it; `free`: also the cutoff.
fn bound(filter: Filter, behind: f64, slow: f64, samples: usize, free: bool) -> f64 {
    const STEP: f64 = 1e-3;
    let moved = match filter {
        Filter::FirstOrder(cutoff) => Some(Filter::FirstOrder(cutoff * (1.0 + STEP))),
        Filter::Butterworth(order, cutoff) => Some(Filter::Butterworth(order, cutoff * (1.0 + STEP))),
        _ => None,
    };
    let (table, moved) = (gains(filter), moved.filter(|_| free).map(gains));
    let at = |table: &[f64], u: f64| {
        let place = u * 2.0 * (table.len() - 1) as f64;
        let (low, share) = (place.floor() as usize, place.fract());
        table[low] * (1.0 - share) + table[(low + 1).min(table.len() - 1)] * share
    };
    let mut parts = vec![0usize, 1, 2];
    parts.extend((behind > 0.0 && !matches!(filter, Filter::Boxcar(1))).then_some(3));
    parts.extend(moved.is_some().then_some(4));
    let count = parts.len();
    let mut information = DMatrix::<f64>::zeros(count, count);
    let squares = [N * N + behind * behind, (slow * B).powi(2), (slow * K).powi(2), behind * behind];
    for k in 1..samples {
        let u = k as f64 / (2.0 * samples as f64);
        let gain = at(&table, u);
        let sine = 4.0 * (PI * u).sin().powi(2);
        // The parameters are the squares of the plateau, B, K and the density behind the filter, and the cutoff.
        let mut slopes = [gain * RATE_HZ, gain / (2.0 * PI * u), gain / RATE_HZ / sine, (1.0 - gain) * RATE_HZ, 0.0];
        let sum: f64 = slopes.iter().zip(squares).map(|(slope, square)| slope * square).sum();
        if let Some(moved) = &moved {
            slopes[4] = (at(moved, u) / gain - 1.0) / STEP * (sum - behind * behind * RATE_HZ);
        }
        for (one, a) in parts.iter().enumerate() {
            for (other, b) in parts.iter().enumerate() {
                information[(one, other)] += 0.5 * slopes[*a] * slopes[*b] / (sum * sum);
            }
        }
    }
    // The information is scaled, because the parameters are of very different sizes.
    let size: Vec<f64> = (0..count).map(|at| information[(at, at)].sqrt()).collect();
    let scaled = DMatrix::from_fn(count, count, |one, other| information[(one, other)] / size[one] / size[other]);
    let covariance = scaled.try_inverse().expect("an information matrix has an inverse");
    0.5 * covariance[(0, 0)].sqrt() / size[0] / squares[0]
}

#[derive(Default)]
struct Score {
    n: Vec<f64>,
    intervals: [(u32, u32); 3],
    limits: [(u32, u32); 3],
    kinds: BTreeMap<String, u32>,
    seconds: f64,
}

impl Score {
    fn take(&mut self, found: &NoiseParameters, truth: [f64; 3]) {
        let of = |estimate: &Estimate, truth: f64| match (estimate.ci95, estimate.upper_limit95) {
            (Some([low, high]), _) => (true, (low..=high).contains(&truth)),
            (None, Some(limit)) => (false, limit >= truth),
            (None, None) => (false, false),
        };
        for (at, estimate) in [&found.n, &found.b, &found.k].into_iter().enumerate() {
            let (named, holds) = of(estimate, truth[at]);
            let count = if named { &mut self.intervals[at] } else { &mut self.limits[at] };
            count.0 += u32::from(holds);
            count.1 += 1;
        }
        self.n.extend(found.n.value.map(|value| value / truth[0] - 1.0));
        let misfit = found.flags.iter().any(|flag| flag.kind == "misfit");
        let kind = found.bandwidth.as_ref().map_or("none".to_owned(), |own| {
            let order = own.order.map_or(String::new(), |order| format!(" {order}"));
            let size = own.value.map_or(String::new(), |value| {
                if own.kind == "moving_average" { format!(" {value}") } else { String::new() }
            });
            let behind = if own.white_behind.is_some() { " +" } else { "" };
            format!("{}{order}{size}{behind}", own.kind)
        });
        let marks = [(misfit, " misfit"), (!found.usable, " withheld")].map(|(is, mark)| if is { mark } else { "" });
        *self.kinds.entry(format!("{kind}{}", marks.concat())).or_default() += 1;
    }
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let (mut seeds, mut first, mut wanted, mut samples, mut threads) = (100u64, 1u64, None, 144_000usize, 2usize);
    let mut slow = 1.0;
    while let Some(flag) = arguments.next() {
        let value = arguments.next().expect("a value after each flag");
        match flag.as_str() {
            "--seeds" => seeds = value.parse().expect("a number"),
            "--first" => first = value.parse().expect("a number"),
            "--world" => wanted = Some(value),
            "--samples" => samples = value.parse().expect("a number"),
            "--slow" => slow = value.parse().expect("a number"),
            "--threads" => threads = value.parse().expect("a number"),
            other => panic!("unknown flag {other}"),
        }
    }
    println!("{seeds} seeds from {first}, {samples} samples at {RATE_HZ} Hz");
    println!(
        "world                 behind  N bias %  N rmse %  /known  /free   N held    B held    K held    limits B, K    found"
    );
    for (name, filter) in WORLDS {
        if wanted.as_ref().is_some_and(|wanted| wanted != name) {
            continue;
        }
        for behind in [0.0, 0.3 * N] {
            let (next, score) = (AtomicU64::new(first), Mutex::new(Score::default()));
            let truth = [N.hypot(behind), slow * B, slow * K];
            std::thread::scope(|scope| {
                for _ in 0..threads {
                    scope.spawn(|| {
                        loop {
                            let seed = next.fetch_add(1, Ordering::Relaxed);
                            if seed >= first + seeds {
                                return;
                            }
                            let values = record(filter, behind, slow, samples, seed);
                            let mut transform = Transform::new();
                            let mut estimator = DstEstimator::new(FixedPoint::for_channel(Channel::GyroX));
                            estimator.push(&mut transform, &values);
                            let sums = estimator.into_sums(&mut transform);
                            let began = std::time::Instant::now();
                            let mut found = fit(&sums, RATE_HZ, Channel::GyroX, &[], None);
                            let taken_s = began.elapsed().as_secs_f64();
                            let mut octaves = LiveAllan::new(FixedPoint::for_channel(Channel::GyroX));
                            octaves.push(&values);
                            hold_against(&mut found, &octaves.points(), RATE_HZ, Channel::GyroX, &[]);
                            let mut score = score.lock().expect("no thread has panicked");
                            score.seconds += taken_s;
                            score.take(&found, truth);
                        }
                    });
                }
            });
            let score = score.into_inner().expect("no thread has panicked");
            let count = score.n.len().max(1) as f64;
            let bias = score.n.iter().sum::<f64>() / count;
            let rmse = (score.n.iter().map(|error| error * error).sum::<f64>() / count).sqrt();
            let of = |(held, all): (u32, u32)| format!("{held:>3}/{all:<3}");
            println!(
                "{name:<20} {:>7.2} {:>9.3} {:>9.3} {:>7.2} {:>6.2}   {}   {}   {}   {} {}   {:?} {:.2} s",
                behind / N,
                100.0 * bias,
                100.0 * rmse,
                rmse / bound(filter, behind, slow, samples, false),
                rmse / bound(filter, behind, slow, samples, true),
                of(score.intervals[0]),
                of(score.intervals[1]),
                of(score.intervals[2]),
                of(score.limits[1]),
                of(score.limits[2]),
                score.kinds,
                score.seconds / seeds as f64,
            );
        }
    }
}
