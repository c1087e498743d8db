//! The findings of a diagnosis by chance in records of noise alone: the table of `crates/imu-diagnosis/src/prices.rs`.
//!
//! `cargo run --release --example null_tails -- 65536 240` prints for each effect and statistic quantiles and the tail.
//! Records: white noise, flicker and random walk between half and twice a VN-100's at 40 Hz, a warm-up's temperature in steps
//! of 0.1 °C, models whose N, B and K are off by up to 5, 25 and 40 %. The seed is 1.

use imu_diagnosis::calibration::{Chance, Nulls};
use imu_diagnosis::prices::Tail;
use imu_model::effects::{Stream, StreamId};
use std::collections::BTreeMap;
use vn100d::jobs::TwoThreads;

const RATE_HZ: f64 = 40.0;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut numbers = std::env::args().skip(1).map(|word| word.parse::<usize>());
    let samples = numbers.next().transpose()?.unwrap_or(65_536);
    let records = numbers.next().transpose()?.unwrap_or(240);
    let mut stream = Stream::new(1, StreamId { owner: 77, effect: 0, instance: 0 });
    let mut levels = || {
        let (b, k) = (2f64.powf(2.0 * stream.uniform() - 1.0), 2f64.powf(2.6 * stream.uniform() - 1.3));
        [1.0 / RATE_HZ.sqrt(), 0.063 * b, 8e-4 * RATE_HZ.sqrt() * k]
    };
    let levels: Vec<[f64; 3]> = (0..64).map(|_| levels()).collect();
    let mut wander = 0.0;
    let mut reading = |t: usize| {
        wander += (stream.uniform() - 0.5) * 6.0 / (samples as f64).sqrt();
        let warm = 8.0 * (1.0 - (-5.0 * t as f64 / samples as f64).exp());
        (10.0 * (25.0 + warm + wander)).round() / 10.0
    };
    let temperature_c = Some((0..samples).map(&mut reading).collect());
    let nulls = Nulls { samples, rate_hz: RATE_HZ, levels, temperature_c, seed: 1 };
    let all: Vec<Chance> = nulls.chances(records, &TwoThreads, &|_| true)?.unwrap_or_default();
    let mut values: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for chance in &all {
        for (kind, gain) in &chance.kinds {
            values.entry(format!("{kind:?}")).or_default().push(*gain);
        }
        for (statistic, value) in &chance.statistics {
            values.entry(format!("{statistic:?} (statistic)")).or_default().push(*value);
        }
    }
    println!(
        "{:32} {:>6} {:>7} {:>7} {:>7} {:>7} {:>7} {:>6}",
        "", "values", "50 %", "85 %", "99 %", "most", "offset", "scale"
    );
    for (name, mut of) in values {
        of.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| of.get((share * of.len() as f64) as usize).or(of.last()).copied().unwrap_or_default();
        let Some(tail) = Tail::of(&of) else { continue };
        println!(
            "{name:32} {:6} {:7.2} {:7.2} {:7.2} {:7.2} {:7.2} {:6.2}",
            of.len(),
            at(0.5),
            at(0.85),
            at(0.99),
            at(1.0),
            tail.offset,
            tail.scale
        );
    }
    Ok(())
}
