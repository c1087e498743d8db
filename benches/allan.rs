//! Allan deviations of five hours at 40 Hz on about a hundred averaging times, one channel and thread: the exact estimator
//! beside a floor (plain doubles, one pass per averaging time) in the same run, and the live pyramid.
//!
//! `cargo bench --bench allan`

#![expect(clippy::expect_used, reason = "a bench has nobody to answer to")]

use divan::{Bencher, black_box, counter::ItemsCount};
use imu_core::sample::Channel;
use imu_noise::allan::{FixedPoint, LiveAllan, Overlapping, TauGrid};

const SAMPLES: usize = 720_000;

fn main() {
    divan::main();
}

/// Returns white noise of a VN-100's size with a slow walk, in rad/s, as the floats of its binary output.
fn gyro(count: usize) -> Vec<f64> {
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut uniform = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let mut walk = 0.0;
    (0..count)
        .map(|_| {
            walk += uniform() * 1e-7;
            f64::from(((uniform() + uniform() + uniform()) * 1.5e-3 + walk + 1e-3) as f32)
        })
        .collect()
}

fn hundred() -> TauGrid {
    let factors = (0..=105).map(|step| 10f64.powf(f64::from(step) / 20.0).round() as usize);
    let filling = [13, 15, 17, 19, 21, 23];
    TauGrid::custom(factors.filter(|m| *m <= SAMPLES / 4).chain(filling)).expect("a grid")
}

#[divan::bench]
fn exact_hundred_taus(bencher: Bencher) {
    let (samples, grid) = (gyro(SAMPLES), hundred());
    assert!((98..=102).contains(&grid.factors().len()), "{} averaging times", grid.factors().len());
    bencher.counter(ItemsCount::new(SAMPLES)).bench(|| {
        let mut estimator = Overlapping::new(FixedPoint::for_channel(Channel::GyroX), grid.clone());
        for chunk in black_box(&samples).chunks(65_536) {
            estimator.push(chunk);
        }
        estimator.into_sums()
    });
}

/// Values as ASCII output sends them: six decimals and a scale of six decimals.
#[divan::bench]
fn exact_hundred_taus_of_decimals(bencher: Bencher) {
    let (samples, grid) = (gyro(SAMPLES), hundred());
    let samples: Vec<f64> = samples.iter().map(|value| (value * 1e6).round() / 1e6).collect();
    bencher.counter(ItemsCount::new(SAMPLES)).bench(|| {
        let mut estimator = Overlapping::new(FixedPoint::decimal(6).expect("a scale"), grid.clone());
        for chunk in black_box(&samples).chunks(65_536) {
            estimator.push(chunk);
        }
        estimator.into_sums()
    });
}

/// Does the minimum work of any estimator: one pass per averaging time over phases in doubles, not exact.
#[divan::bench]
fn floor_doubles_one_pass_per_tau(bencher: Bencher) {
    let (samples, grid) = (gyro(SAMPLES), hundred());
    bencher.counter(ItemsCount::new(SAMPLES)).bench(|| {
        let mut phases = Vec::with_capacity(SAMPLES + 1);
        let mut phase = 0.0;
        phases.push(phase);
        for value in black_box(&samples) {
            phase += value;
            phases.push(phase);
        }
        grid.factors().iter().map(|m| floor(&phases, *m)).sum::<f64>()
    });
}

fn floor(x: &[f64], m: usize) -> f64 {
    let n = x.len();
    let (newest, middle, oldest) = (&x[2 * m..], &x[m..n - m], &x[..n - 2 * m]);
    let mut sums = [0.0; 4];
    let chunks = newest.chunks_exact(4).zip(middle.chunks_exact(4)).zip(oldest.chunks_exact(4));
    for ((a, b), c) in chunks {
        for lane in 0..4 {
            let d = (a[lane] - b[lane]) - (b[lane] - c[lane]);
            sums[lane] += d * d;
        }
    }
    sums.iter().sum()
}

#[divan::bench]
fn exact_octaves(bencher: Bencher) {
    let samples = gyro(SAMPLES);
    let grid = TauGrid::octave(SAMPLES as u64).expect("a grid");
    bencher.counter(ItemsCount::new(SAMPLES)).bench(|| {
        let mut estimator = Overlapping::new(FixedPoint::for_channel(Channel::GyroX), grid.clone());
        estimator.push(black_box(&samples));
        estimator.into_sums()
    });
}

#[divan::bench]
fn live_octaves(bencher: Bencher) {
    let samples = gyro(SAMPLES);
    bencher.counter(ItemsCount::new(SAMPLES)).bench(|| {
        let mut live = LiveAllan::new(FixedPoint::for_channel(Channel::GyroX));
        live.push(black_box(&samples));
        live.points()
    });
}

/// Five hours at 800 Hz: the phases no longer fit into the caches.
#[divan::bench(sample_count = 3)]
fn exact_hundred_taus_of_fourteen_million(bencher: Bencher) {
    let samples = gyro(14_400_000);
    let grid = TauGrid::log(14_400_000).expect("a grid");
    bencher.counter(ItemsCount::new(samples.len())).bench(|| {
        let mut estimator = Overlapping::new(FixedPoint::for_channel(Channel::GyroX), grid.clone());
        for chunk in black_box(&samples).chunks(65_536) {
            estimator.push(chunk);
        }
        estimator.into_sums()
    });
}

/// Measures the step from sums to parameters: the cost of a request for a running capture beyond its sums, per channel.
#[divan::bench(sample_count = 20)]
fn parameters_from_sums(bencher: Bencher) {
    let mut estimator = Overlapping::new(FixedPoint::for_channel(Channel::GyroX), hundred());
    estimator.push(&gyro(SAMPLES));
    let points = estimator.into_sums().points();
    bencher.bench(|| imu_noise::fit::fit(black_box(&points), 40.0, Channel::GyroX));
}
