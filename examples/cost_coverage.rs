//! Coverage of bands on simulated nights: how often the 95 % bands of the true model, of the one that a diagnosis corrected, and
//! of the plain one hold the errors of fresh nights.
//!
//! `cargo run --release --example cost_coverage -- [SEEDS [NIGHTS [HOURS [RATE_HZ]]]]`: 8 worlds, each with that many sensors'
//! records (40) of so many hours (4) at a rate (10 Hz). From each record a diagnosis corrects the plain model; the bands are then
//! compared with that many fresh nights (25) from switch-on.

use imu_core::sample::Channel;
use imu_cost::{Cost, Quantity, Request, Rest, cost, piece_error};
use imu_diagnosis::{Options, Recording, diagnose};
use imu_model::simulator::{SensorModel, Simulator};
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

const ALIGN_S: f64 = 30.0;
const HORIZONS_S: [f64; 12] = [1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 120.0, 300.0, 600.0, 1200.0, 1800.0, 3600.0];
const MODELS: [&str; 3] = ["true", "corrected", "plain"];

/// What each world adds to N, B and K: effects of gyro_y and gyro_z, and of accel_x.
const WORLDS: [(&str, &str, &str); 8] = [
    ("N, B and K alone", "", ""),
    (
        "tone",
        r#"{"effect": "tone", "frequency_hz": 1.37, "amplitude": 3e-3}"#,
        r#"{"effect": "tone", "frequency_hz": 1.37, "amplitude": 0.03}"#,
    ),
    (
        "warm_up",
        r#"{"effect": "warm_up", "amplitude": 1e-3, "tau_s": 900}"#,
        r#"{"effect": "warm_up", "amplitude": 2e-2, "tau_s": 900}"#,
    ),
    (
        "gauss_markov",
        r#"{"effect": "gauss_markov", "sigma": 2e-4, "tc_s": 20}"#,
        r#"{"effect": "gauss_markov", "sigma": 5e-3, "tc_s": 20}"#,
    ),
    (
        "spikes",
        r#"{"effect": "spikes", "rate_hz": 0.02, "amplitude": 5e-3}"#,
        r#"{"effect": "spikes", "rate_hz": 0.02, "amplitude": 0.1}"#,
    ),
    ("rate_ramp", r#"{"effect": "rate_ramp", "R": 1e-7}"#, r#"{"effect": "rate_ramp", "R": 2e-6}"#),
    (
        "resonance",
        r#"{"effect": "resonance", "frequency_hz": 0.8, "bandwidth_hz": 0.1, "sigma": 1e-3}"#,
        r#"{"effect": "resonance", "frequency_hz": 0.8, "bandwidth_hz": 0.1, "sigma": 2e-2}"#,
    ),
    (
        "bias_step",
        r#"{"effect": "bias_step", "at_s": 400, "size": 2e-4}"#,
        r#"{"effect": "bias_step", "at_s": 400, "size": 5e-3}"#,
    ),
];

fn model(rate_hz: f64, gyro: &str, accel: &str) -> SensorModel {
    let text = format!(
        r#"{{"format": "vn100d-sensor-model-1", "name": "world", "rate_hz": {rate_hz}, "channels": {{
            "gyro_y": {{"N": 1.2e-4, "B": 2.6e-5, "K": 1e-6, "effects": [{gyro}]}},
            "gyro_z": {{"N": 1.2e-4, "B": 2.6e-5, "K": 1e-6, "effects": [{gyro}]}},
            "accel_x": {{"N": 2e-3, "B": 4e-4, "K": 1e-5, "effects": [{accel}]}}}}}}"#
    );
    SensorModel::from_json(&text, "world").unwrap_or_else(|error| panic!("{error}"))
}

fn simulated(model: &SensorModel, seed: u64, length_s: f64) -> Vec<(Channel, Vec<f64>)> {
    let count = (length_s * model.rate_hz) as usize;
    let mut simulator = Simulator::new(model, seed, model.rate_hz, length_s).unwrap_or_else(|error| panic!("{error}"));
    let mut columns: Vec<(Channel, Vec<f64>)> = model.channels.keys().map(|of| (*of, Vec::new())).collect();
    while columns[0].1.len() < count {
        let Some(block) = simulator.next_block() else { break };
        for (channel, column) in &mut columns {
            column.extend_from_slice(block.values(*channel).unwrap_or_default());
        }
    }
    columns.iter_mut().for_each(|(_, column)| column.truncate(count));
    columns
}

/// Errors inside the band, and all, by model, quantity and horizon.
type Counts = BTreeMap<(usize, Quantity, usize), [usize; 2]>;

fn count(counts: &mut Counts, world: &SensorModel, costs: &[Option<Cost>], first_seed: u64, nights: u64) {
    let last_s = HORIZONS_S[HORIZONS_S.len() - 1];
    for night in 0..nights {
        let columns = simulated(world, first_seed + night, ALIGN_S + last_s);
        let channels = columns.iter().map(|(channel, values)| (*channel, values.as_slice())).collect();
        let record = Rest { rate_hz: world.rate_hz, channels, missing: &[] };
        let samples = |time_s: f64| (time_s * world.rate_hz).round() as usize;
        for quantity in [Quantity::AttitudeY, Quantity::Heading, Quantity::VelocityX, Quantity::PositionX] {
            for (place, horizon_s) in HORIZONS_S.iter().enumerate() {
                let error = piece_error(&record, quantity, 0, samples(ALIGN_S), samples(*horizon_s)).abs();
                for (of, cost) in costs.iter().enumerate() {
                    let Some(growth) = cost.as_ref().and_then(|cost| cost.quantities.get(&quantity)) else { continue };
                    let [inside, all] = counts.entry((of, quantity, place)).or_default();
                    *inside += usize::from(error <= growth.band95[place]);
                    *all += 1;
                }
            }
        }
    }
}

fn share(counts: &Counts, of: usize, place: usize, quantity: Option<Quantity>) -> f64 {
    let own = counts
        .iter()
        .filter(|((own, which, at), _)| *own == of && *at == place && quantity.is_none_or(|of| of == *which));
    let [inside, all] = own.fold([0, 0], |[a, b], (_, [inside, all])| [a + inside, b + all]);
    inside as f64 / all.max(1) as f64
}

fn main() {
    let given: Vec<f64> =
        std::env::args().skip(1).map(|of| of.parse().unwrap_or_else(|_| panic!("{of}: no number"))).collect();
    let number = |place: usize, default: f64| given.get(place).copied().unwrap_or(default);
    let (seeds, nights) = (number(0, 40.0) as usize, number(1, 25.0) as u64);
    let (length_s, rate_hz) = (3600.0 * number(2, 4.0), number(3, 10.0));
    println!(
        "{} worlds, {seeds} records of {length_s} s at {rate_hz} Hz each, {nights} fresh nights for each",
        WORLDS.len()
    );
    let plain = model(rate_hz, "", "");
    let request = Request { align_s: ALIGN_S, horizons_s: HORIZONS_S.to_vec(), ..Request::default() };
    let bands = |model: &SensorModel| cost(model, "world", &request);
    let all: Vec<Mutex<Counts>> = WORLDS.iter().map(|_| Mutex::default()).collect();
    let (next, failures) = (AtomicUsize::new(0), AtomicUsize::new(0));
    thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let task = next.fetch_add(1, Ordering::Relaxed);
                    let (seed, at) = ((task / WORLDS.len()) as u64, task % WORLDS.len());
                    if seed >= seeds as u64 {
                        break;
                    }
                    let world = model(rate_hz, WORLDS[at].1, WORLDS[at].2);
                    let first_seed = 1_000_000 * (at as u64 + 1) + 1000 * seed;
                    let channels = simulated(&world, first_seed, length_s);
                    let recording = Recording { rate_hz, channels, ..Recording::default() };
                    let corrected = diagnose(&recording, &plain, &Options::default()).map(|outcome| outcome.augmented);
                    let corrected = match corrected {
                        Ok(corrected) => bands(&corrected).map_err(|error| error.to_string()),
                        Err(error) => Err(error.to_string()),
                    };
                    if let Err(error) = &corrected {
                        println!("{}, record {seed}: {error}", WORLDS[at].0);
                        failures.fetch_add(1, Ordering::Relaxed);
                    }
                    let costs = [bands(&world).ok(), corrected.ok(), bands(&plain).ok()];
                    let mut own = Counts::new();
                    count(&mut own, &world, &costs, first_seed + 1, nights);
                    let mut counts = all[at].lock().unwrap_or_else(|poisoned| poisoned.into_inner());
                    for (key, [inside, of]) in own {
                        let entry = counts.entry(key).or_default();
                        *entry = [entry[0] + inside, entry[1] + of];
                    }
                }
            });
        }
    });
    print(all.into_iter().map(|of| of.into_inner().unwrap_or_default()).collect(), failures.into_inner());
}

fn print(all: Vec<Counts>, failures: usize) {
    println!("records without a corrected cost: {failures}\n");
    println!("| horizon | {} |\n|---|---|---|---|", MODELS.join(" | "));
    let mut whole = Counts::new();
    for (key, [inside, of]) in all.iter().flatten() {
        let entry = whole.entry(*key).or_default();
        *entry = [entry[0] + inside, entry[1] + of];
    }
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    for (place, horizon_s) in HORIZONS_S.iter().enumerate() {
        let row = (0..3).map(|of| percent(share(&whole, of, place, None)));
        println!("| {horizon_s} s | {} |", row.collect::<Vec<_>>().join(" | "));
    }
    println!(
        "\nLeast and largest coverage over the horizons, by world:\n\n| world | {} |\n|---|---|---|---|",
        MODELS.join(" | ")
    );
    for ((name, ..), counts) in WORLDS.iter().zip(&all) {
        let row = (0..3).map(|of| {
            let shares = (0..HORIZONS_S.len()).map(|place| share(counts, of, place, None));
            let (low, high) = shares.fold((1.0_f64, 0.0_f64), |(low, high), of| (low.min(of), high.max(of)));
            format!("{} … {}", percent(low), percent(high))
        });
        println!("| {name} | {} |", row.collect::<Vec<_>>().join(" | "));
    }
    println!("\nBy quantity:\n\n| quantity | {} |\n|---|---|---|---|", MODELS.join(" | "));
    for quantity in [Quantity::AttitudeY, Quantity::Heading, Quantity::VelocityX, Quantity::PositionX] {
        let row = (0..3).map(|of| {
            let shares = (0..HORIZONS_S.len()).map(|place| share(&whole, of, place, Some(quantity)));
            let (low, high) = shares.fold((1.0_f64, 0.0_f64), |(low, high), of| (low.min(of), high.max(of)));
            format!("{} … {}", percent(low), percent(high))
        });
        println!("| {quantity} | {} |", row.collect::<Vec<_>>().join(" | "));
    }
}
