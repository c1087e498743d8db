//! Tests the rate, duration and missing samples found in recordings with coarse, jittering, late and paired stamps.
//!
//! `cargo run --release --example stamp_worlds -- --seeds 3 --first 1 --length 600`
//!
//! Each recording is written as CSV text, without any part of the program, and read as a user's file is. The table in
//! docs/validation.md is the output of this program.

use imu_files::recording::{Input, Options, Recording, columns};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Exp1, StandardNormal};
use std::fmt::Write as _;

const RATES_HZ: [f64; 8] = [25.0, 40.0, 50.0, 100.0, 128.0, 200.0, 400.0, 800.0];
const LOSSES: [f64; 3] = [0.0, 0.01, 0.05];
const KINDS: [Kind; 8] = [
    Kind::Exact,
    Kind::Decimals(3),
    Kind::Decimals(2),
    Kind::Jitter(1.0),
    Kind::Jitter(3.0),
    Kind::Jitter(5.0),
    Kind::Late,
    Kind::Pairs,
];

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Exact,
    Decimals(usize),
    /// Standard deviation, ms.
    Jitter(f64),
    Late,
    Pairs,
}

impl Kind {
    fn name(self) -> String {
        match self {
            Self::Exact => "exact".to_owned(),
            Self::Decimals(3) => "whole ms".to_owned(),
            Self::Decimals(places) => format!("{places} decimals"),
            Self::Jitter(sigma_ms) => format!("jitter {sigma_ms} ms"),
            Self::Late => "late deliveries".to_owned(),
            Self::Pairs => "pairs".to_owned(),
        }
    }

    /// Returns whether rounding or jitter is below a third of the period, so that each loss is detectable.
    fn is_fine(self, rate_hz: f64) -> bool {
        let third_s = 1.0 / rate_hz / 3.0;
        match self {
            Self::Exact | Self::Late | Self::Pairs => true,
            Self::Decimals(places) => 0.1_f64.powi(places as i32) < third_s,
            Self::Jitter(sigma_ms) => 1e-3 * sigma_ms < third_s,
        }
    }
}

/// Returns a recording's CSV text, and the indices of its samples.
fn written(kind: Kind, rate_hz: f64, loss: f64, length_s: f64, seed: u64) -> (String, Vec<usize>) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let count = (rate_hz * length_s) as usize;
    let begin_s = random.random_range(0.0..1000.0);
    let time = |index: usize| begin_s + index as f64 / rate_hz;
    let (mut held_until_s, mut sent) = (0.0, Vec::with_capacity(count));
    for index in 0..count {
        let at_s = time(index);
        sent.push(match kind {
            Kind::Exact | Kind::Decimals(_) => at_s,
            Kind::Jitter(sigma_ms) => {
                let normal: f64 = StandardNormal.sample(&mut random);
                at_s + 1e-3 * sigma_ms * normal
            }
            Kind::Late => {
                // Every few seconds deliveries are held up for as much as 0.3 s; waiting samples then arrive at once,
                // 20 µs apart.
                if at_s > held_until_s && random.random_bool((0.3 / rate_hz).min(1.0)) {
                    held_until_s = at_s + random.random_range(0.0..0.3);
                }
                let delay: f64 = Exp1.sample(&mut random);
                let after_last_s = sent.last().map_or(0.0, |last: &f64| last + 2e-5);
                (at_s + 1e-4 * delay).max(held_until_s).max(after_last_s)
            }
            // Two messages are received together, the second 10 µs behind the first.
            Kind::Pairs if index % 2 == 0 => time(index + 1) + 2e-5,
            Kind::Pairs => at_s + 3e-5,
        });
    }
    let decimals = if let Kind::Decimals(places) = kind { places } else { 9 };
    let (mut text, mut kept) = ("time_s,gyro_x_rad_s,gyro_y_rad_s\n".to_owned(), Vec::new());
    for (index, at_s) in sent.iter().enumerate() {
        if random.random_bool(loss) {
            continue;
        }
        let [x, y] = [0, 1].map(|_| random.random_range(-1e-3..1e-3));
        let _ = writeln!(text, "{at_s:.decimals$},{x:.6},{y:.6}");
        kept.push(index);
    }
    (text, kept)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let option = |name: &str, or: f64| -> Result<f64, std::num::ParseFloatError> {
        let place = arguments.iter().position(|argument| argument == name);
        place.and_then(|place| arguments.get(place + 1)).map_or(Ok(or), |text| text.parse())
    };
    let (seeds, first, length_s) =
        (option("--seeds", 1.0)? as u64, option("--first", 1.0)? as u64, option("--length", 600.0)?);
    println!(
        "| stamps | lost | recordings | rate within 1e-4 | duration within a period | missing exact, of those finer than a \
         third | worst rate | worst duration, periods | rejected |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for kind in KINDS {
        for loss in LOSSES {
            let (mut cases, mut rates, mut durations, mut exact, mut fine) = (0, 0, 0, 0, 0);
            let (mut worst_rate, mut worst_duration, mut rejected) = (0.0_f64, 0.0_f64, 0);
            for rate_hz in RATES_HZ {
                for seed in first..first + seeds {
                    let (text, kept) = written(kind, rate_hz, loss, length_s, seed);
                    let recording =
                        Recording::read(Input::memory("worlds.csv", text.into_bytes()), Options::default())?;
                    let found = columns(&recording)?;
                    let (first, last) = (kept.first().copied().unwrap_or(0), kept.last().copied().unwrap_or(0));
                    let points = (last - first + 1) as u64;
                    let rate = found.info.rate_hz / rate_hz - 1.0;
                    let duration = (found.duration_s() - points as f64 / rate_hz) * rate_hz;
                    cases += 1;
                    rates += u32::from(rate.abs() < 1e-4);
                    durations += u32::from(duration.abs() <= 1.0 + 1e-6);
                    let missing = points - kept.len() as u64;
                    if kind.is_fine(rate_hz) {
                        fine += 1;
                        exact += u32::from(found.missing == missing && found.samples == kept.len() as u64);
                    }
                    worst_rate = worst_rate.max(rate.abs());
                    worst_duration = worst_duration.max(duration.abs());
                    rejected += found.info.rejected.values().sum::<u64>();
                    if arguments.iter().any(|argument| argument == "--verbose") {
                        eprintln!(
                            "{} {rate_hz} Hz, {loss} lost, seed {seed}: {} Hz, {} of {missing} missing, {} of {} samples, {duration:.3} periods, {:?}",
                            kind.name(),
                            found.info.rate_hz,
                            found.missing,
                            found.samples,
                            kept.len(),
                            found.info.stamp_grid
                        );
                    }
                }
            }
            let name = kind.name();
            println!(
                "| {name} | {} % | {cases} | {rates} | {durations} | {exact} of {fine} | {worst_rate:.1e} | {worst_duration:.2} | {rejected} |",
                100.0 * loss
            );
        }
    }
    Ok(())
}
