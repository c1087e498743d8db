//! The overlapping Allan deviation of one recording compared with other programs, in one run and on one thread: 720,000
//! samples (five hours at 40 Hz) at 100 averaging times, and 14.4 million (at 800 Hz) at all those of the usual grid
//! that have full overlap. Prints processor times, ratios and how far the results differ.
//!
//! `cargo bench --bench peers` compares with the crates `allan-tools` and `allan` and with floors;
//! `python3 benches/peers.py` runs that and allantools on the same samples.
//!
//! All programs start from rate samples in memory; if a peer takes phases, integrating is part of its time. With
//! `PEERS_DIR` set, the samples, the averaging factors and the results are written there.

#![expect(clippy::unwrap_used, reason = "a bench that cannot go on ends")]

use fearless_simd::{Level, Simd as _};
use imu_core::sample::Channel;
use imu_noise::allan::{FixedPoint, Overlapping, TauGrid};
use rustix::time::{ClockId, clock_gettime};
use std::hint::black_box;
use std::path::Path;

/// A program's name, the number of its rounds, and its deviations.
type Contender<'a> = (&'static str, usize, Box<dyn Fn() -> Vec<f64> + 'a>);

fn main() {
    // `cargo test --benches` only checks that it runs.
    let quick = !std::env::args().any(|argument| argument == "--bench");
    let directory = std::env::var_os("PEERS_DIR");
    let (short, long, rounds) = if quick { (7200, 20_000, [1, 1]) } else { (720_000, 14_400_000, [21, 5]) };
    beside(&hundred(short), short, rounds, directory.as_deref().map(Path::new));
    let grid = TauGrid::log(long as u64).unwrap();
    let grid = TauGrid::custom(grid.full_overlap().iter().copied()).unwrap();
    beside(&grid, long, if quick { rounds } else { [3, 1] }, None);
}

/// Compares the programs; `rounds` are the numbers for fast and for slow ones.
fn beside(grid: &TauGrid, count: usize, [fast, slow]: [usize; 2], directory: Option<&Path>) {
    let samples = gyro(count);
    let decimals: Vec<f64> = samples.iter().map(|value| (value * 1e6).round() / 1e6).collect();
    let factors = grid.factors();
    let taus: Vec<f64> = factors.iter().map(|m| *m as f64).collect();
    let exact = |samples: &[f64]| -> Vec<f64> {
        let mut estimator = Overlapping::new(FixedPoint::for_channel(Channel::GyroX), grid.clone());
        for chunk in samples.chunks(65_536) {
            estimator.push(chunk);
        }
        estimator.into_sums().points().iter().map(|point| point.variance.sqrt()).collect()
    };
    let passes = || -> Vec<f64> {
        let phases = integrate(black_box(&samples));
        factors.iter().map(|m| deviation(squares(&phases, 0..phases.len(), *m), phases.len(), *m)).collect()
    };
    let allan_tools = || -> Vec<f64> {
        let phases = integrate(black_box(&samples));
        allan_tools::deviation(&phases, &taus, allan_tools::Deviation::Allan, 1.0, false, true).unwrap().0
    };
    // The crate accepts no list of averaging times: one instance for each.
    let allan = || -> Vec<f64> {
        let phases = integrate(black_box(&samples));
        let one = |m: &usize| {
            let config = allan::Config::new().style(allan::Style::SingleTau(*m as u32)).max_tau(*m);
            let mut allan = config.build_allan();
            phases.iter().for_each(|phase| allan.record(*phase));
            allan.get(*m).unwrap().deviation().unwrap()
        };
        factors.iter().map(one).collect()
    };
    let contenders: [Contender; 6] = [
        ("vn100d, exact, binary floats", fast, Box::new(|| exact(black_box(&samples)))),
        ("vn100d, exact, ASCII decimals", fast, Box::new(|| exact(black_box(&decimals)))),
        ("floor: doubles in blocks, SIMD, not exact", fast, Box::new(|| floor(black_box(&samples), factors))),
        ("doubles, a pass per averaging time", fast, Box::new(passes)),
        ("allan-tools 0.1", slow, Box::new(allan_tools)),
        ("allan 0.4", slow, Box::new(allan)),
    ];

    println!("{count} samples, {} averaging times, one thread; median processor time", factors.len());
    let mut times: Vec<Vec<f64>> = vec![Vec::new(); contenders.len()];
    let mut results: Vec<Vec<f64>> = vec![Vec::new(); contenders.len()];
    for round in 0..fast {
        for (index, (_, rounds, run)) in contenders.iter().enumerate() {
            if round < *rounds {
                let begun = processor_s();
                results[index] = run();
                times[index].push(processor_s() - begun);
            }
        }
    }
    let median = |times: &Vec<f64>| {
        let mut sorted = times.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    };
    let ours = median(&times[0]);
    let mut rows = Vec::new();
    for (index, (name, _, _)) in contenders.iter().enumerate() {
        let time = median(&times[index]);
        let same = if index == 1 { &results[1] } else { &results[0] };
        assert_eq!(results[index].len(), factors.len(), "{name}");
        let apart = results[index].iter().zip(same).map(|(one, other)| (one / other - 1.0).abs()).fold(0.0, f64::max);
        println!("{name:<44} {:>9.2} ms  {:>7.2} ×  apart by {apart:.0e}", time * 1e3, time / ours);
        assert!(apart < 1e-6, "{name} comes to other deviations");
        rows.push(serde_json::json!({ "name": name, "ms": time * 1e3 }));
    }
    if let Some(directory) = directory {
        let bytes: Vec<u8> = samples.iter().flat_map(|value| value.to_le_bytes()).collect();
        std::fs::write(directory.join("samples.f64"), bytes).unwrap();
        let run =
            serde_json::json!({ "factors": factors, "deviation": results[0], "ours_ms": ours * 1e3, "rows": rows });
        std::fs::write(directory.join("run.json"), run.to_string()).unwrap();
    }
}

/// Returns the processor time of this thread, s: other work on the machine affects it less than the wall clock.
fn processor_s() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
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

/// Returns twenty averaging times per decade up to a quarter, filled up to a hundred.
fn hundred(count: usize) -> TauGrid {
    let grid = TauGrid::log(count as u64).unwrap();
    let missing = 100usize.saturating_sub(grid.factors().len());
    let filling: Vec<usize> = (1..).filter(|m| !grid.factors().contains(m)).take(missing).collect();
    TauGrid::custom(grid.factors().iter().copied().chain(filling)).unwrap()
}

#[inline(always)]
fn integrate(samples: &[f64]) -> Vec<f64> {
    let mut phase = 0.0;
    let mut phases = Vec::with_capacity(samples.len() + 1);
    phases.push(phase);
    phases.extend(samples.iter().map(|value| {
        phase += value;
        phase
    }));
    phases
}

/// Does the minimum work of any estimator: doubles, each block of phases with all averaging times while it is in the
/// cache, by the widest available instructions.
fn floor(samples: &[f64], factors: &[usize]) -> Vec<f64> {
    let level = Level::new();
    #[cfg(any(target_arch = "x86_64", target_arch = "x86"))]
    if let Some(avx512) = level.as_avx512() {
        return avx512.vectorize(
            #[inline(always)]
            || blocks(samples, factors),
        );
    }
    #[cfg(any(target_arch = "x86_64", target_arch = "x86"))]
    if let Some(avx2) = level.as_avx2() {
        return avx2.vectorize(
            #[inline(always)]
            || blocks(samples, factors),
        );
    }
    let _ = level;
    blocks(samples, factors)
}

#[inline(always)]
fn blocks(samples: &[f64], factors: &[usize]) -> Vec<f64> {
    const BLOCK: usize = 8192;
    let phases = integrate(samples);
    let mut sums = vec![0.0; factors.len()];
    for from in (0..phases.len()).step_by(BLOCK) {
        for (sum, m) in sums.iter_mut().zip(factors) {
            *sum += squares(&phases, from..(from + BLOCK).min(phases.len()), *m);
        }
    }
    sums.into_iter().zip(factors).map(|(sum, m)| deviation(sum, phases.len(), *m)).collect()
}

fn deviation(squares: f64, phases: usize, m: usize) -> f64 {
    (squares / (2.0 * (phases - 2 * m) as f64)).sqrt() / m as f64
}

/// Returns the sum of squared second differences whose newest phases are `range`.
#[inline(always)]
fn squares(x: &[f64], range: std::ops::Range<usize>, m: usize) -> f64 {
    const LANES: usize = 32;
    let (from, to) = (range.start.max(2 * m), range.end);
    if from >= to {
        return 0.0;
    }
    let (newest, middle, oldest) = (&x[from..to], &x[from - m..to - m], &x[from - 2 * m..to - 2 * m]);
    let ((a, last_a), (b, last_b), (c, last_c)) =
        (newest.as_chunks::<LANES>(), middle.as_chunks::<LANES>(), oldest.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for ((a, b), c) in a.iter().zip(b).zip(c) {
        for lane in 0..LANES {
            let d = (a[lane] - b[lane]) - (b[lane] - c[lane]);
            sums[lane] += d * d;
        }
    }
    let last: f64 = last_a.iter().zip(last_b).zip(last_c).map(|((a, b), c)| ((a - b) - (b - c)).powi(2)).sum();
    sums.iter().sum::<f64>() + last
}
