//! Odd records: unintended data passes the checks of a diagnosis' input, and must not make it panic.
//!
//! Each is a case of the trial whose values, gaps, stamps or model were spoilt in several ways by a seed.
//! `VN100D_ODD=2000` sets the number of cases (10 unless it is set), `VN100D_ODD_SEED=N` repeats a run,
//! `VN100D_ODD_FROM=500` skips the cases before. The records are short, because a diagnosis of a long one takes
//! minutes.

use imu_diagnosis::{Known, Options, Recording, Reference};
use imu_model::simulator::{Motion, SensorModel};
use imu_trial::{Case, Recipe, Wanted, motion, plan};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::panic::AssertUnwindSafe;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

/// The test prints a case that takes longer.
const SLOW: std::time::Duration = std::time::Duration::from_secs(10);

/// Number of samples of a record of a motion, and the maximum of one at rest.
const MOVED_SAMPLES: usize = 2000;
const STILL_SAMPLES: usize = 10_000;

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

/// Spoils the values of one channel in one way.
fn spoil(values: &mut [f64], random: &mut ChaCha8Rng) -> &'static str {
    let length = values.len();
    let (from, sign) = (random.random_range(0..length), if random.random() { 1.0 } else { -1.0 });
    let until = random.random_range(from..length) + 1;
    let size = 10_f64.powf(random.random_range(-12.0..12.0));
    let scale = values.iter().map(|value| value.abs()).fold(1e-300, f64::max);
    match random.random_range(0..14) {
        0 => {
            let value = values[from];
            values[from..until].fill(value);
            "stands"
        }
        1 => {
            for _ in 0..random.random_range(1..20) {
                values[random.random_range(0..length)] += sign * size * scale;
            }
            "spikes"
        }
        2 => {
            values.iter_mut().for_each(|value| *value *= size);
            "scaled"
        }
        3 => {
            values.iter_mut().for_each(|value| *value += sign * size);
            "offset"
        }
        4 => {
            let step = scale / f64::from(random.random_range(1..6_u8));
            values.iter_mut().for_each(|value| *value = (*value / step).round() * step);
            "coarse"
        }
        5 => {
            values.fill(0.0);
            "zero"
        }
        6 => {
            values
                .iter_mut()
                .enumerate()
                .for_each(|(at, value)| *value += sign * size * scale * at as f64 / length as f64);
            "ramp"
        }
        7 => {
            let repeats = random.random_range(2..50);
            for at in 0..length {
                values[at] = values[at - at % repeats];
            }
            "repeated"
        }
        8 => {
            values[from..until].iter_mut().for_each(|value| *value *= size);
            "louder"
        }
        9 => {
            let period = random.random_range(2.0..(length as f64));
            let tone = |at: usize| (std::f64::consts::TAU * at as f64 / period).sin();
            values.iter_mut().enumerate().for_each(|(at, value)| *value += size * scale * tone(at));
            "tone"
        }
        10 => {
            let limit = scale * random.random_range(0.0..0.9);
            values.iter_mut().for_each(|value| *value = value.clamp(-limit, limit));
            "clipped"
        }
        11 => {
            values.iter_mut().enumerate().for_each(|(at, value)| *value = if at % 2 == 0 { size } else { -size });
            "alternates"
        }
        12 => {
            let mut sum = 0.0;
            values.iter_mut().for_each(|value| {
                sum += *value;
                *value = sum;
            });
            "summed"
        }
        _ => {
            values[from..until].reverse();
            "turned round"
        }
    }
}

/// Keeps this number of samples from the beginning.
fn cut(recording: &mut Recording, keep: usize) {
    recording.channels.iter_mut().chain(&mut recording.sent).for_each(|(_, values)| values.truncate(keep));
    recording.missing.truncate(keep);
    recording.time_s.truncate(keep);
    recording.temperature_c.iter_mut().for_each(|values| values.truncate(keep));
}

/// Makes samples missing, or removes stamps or temperature.
fn tear(recording: &mut Recording, random: &mut ChaCha8Rng) -> &'static str {
    let length = recording.len();
    match random.random_range(0..5) {
        0 => {
            let share = random.random_range(0.0..0.9);
            recording.missing = (0..length).map(|_| random.random::<f64>() < share).collect();
            recording.time_s.clear();
            "scattered"
        }
        1 => {
            let from = random.random_range(0..length);
            let until = random.random_range(from..length);
            recording.missing = (0..length).map(|at| (from..until).contains(&at)).collect();
            recording.time_s.clear();
            "a gap"
        }
        2 => {
            recording.temperature_c = Some((0..length).map(|_| random.random_range(-1e3..1e3)).collect());
            "wild temperature"
        }
        3 => {
            let lag = random.random_range(0.0..5.0);
            recording.time_s =
                (0..length).map(|at| (at as f64 + random.random::<f64>() * lag) / recording.rate_hz).collect();
            recording.missing.clear();
            "late stamps"
        }
        _ => {
            cut(recording, random.random_range(length * 2 / 5..=length));
            "short"
        }
    }
}

/// Changes the model's statements, but keeps it valid.
fn bend(model: &mut SensorModel, random: &mut ChaCha8Rng) {
    let mut text = serde_json::to_value(&*model).unwrap();
    for channel in text["channels"].as_object_mut().unwrap().values_mut() {
        for name in ["N", "B", "K"] {
            if random.random_range(0..4) == 0 {
                channel[name] = 10_f64.powf(random.random_range(-9.0..3.0)).into();
            }
        }
    }
    if let Ok(bent) = SensorModel::from_value(&text, "model") {
        *model = bent;
    }
}

/// Returns a record of a case with a motion, or without one, with its model.
fn make(
    seed: u64,
    number: usize,
    plans: &Plans,
    random: &mut ChaCha8Rng,
) -> (Recording, SensorModel, Option<Vec<(f64, Motion)>>) {
    if number.is_multiple_of(5) {
        let case = motion::Case::draw(seed, number, &plans.moved[number], Some(MOVED_SAMPLES));
        let (recording, mut rows) = case.record();
        let size = 10_f64.powf(random.random_range(-6.0..6.0));
        match random.random_range(0..6) {
            0 => {
                rows.iter_mut().for_each(|(_, motion)| motion.gyro_rad_s = motion.gyro_rad_s.map(|value| value * size))
            }
            1 => rows.iter_mut().for_each(|(time_s, _)| *time_s += size),
            2 => rows.iter_mut().for_each(|(_, motion)| motion.accel_m_s2 = [0.0; 3]),
            3 => rows.truncate(rows.len() / 2),
            _ => {}
        }
        return (recording, case.model(false).unwrap(), Some(rows));
    }
    let case = Case::make(seed, number, &plans.still[number], Some(STILL_SAMPLES)).unwrap();
    (case.record(), case.model(), None)
}

/// The plans of the cases.
struct Plans {
    still: Vec<Recipe>,
    moved: Vec<Vec<motion::kind::Planned>>,
}

/// Returns the outcome of an odd case: the changes, and whether the diagnosis accepted it. A panic is passed on.
fn diagnose_case(seed: u64, number: usize, plans: &Plans) -> (String, bool) {
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ (number as u64) << 20);
    let (mut recording, mut model, rows) = make(seed, number, plans, &mut random);
    let mut done = Vec::new();
    if rows.is_none() {
        let length = recording.len() as f64;
        // A diagnosis needs 1,000 samples: few records have fewer.
        cut(&mut recording, length.powf(random.random_range(0.74..1.0)) as usize);
    } else {
        done.push("moved");
    }
    for _ in 0..random.random_range(1..4) {
        let count = recording.channels.len();
        let channel = random.random_range(0..count);
        done.push(spoil(&mut recording.channels[channel].1, &mut random));
    }
    if random.random() {
        done.push(tear(&mut recording, &mut random));
    }
    if random.random() {
        bend(&mut model, &mut random);
        done.push("bent model");
    }
    let changes = done.join(", ");
    let reference = match rows.map(Reference::new) {
        Some(Err(error)) => return (format!("{changes}: {error}"), false),
        reference => reference.and_then(Result::ok).map(Known::Motion),
    };
    let options = Options { real: "odd", sim: "model", ..Options::default() };
    if std::env::var("VN100D_ODD_TOLD").is_ok() {
        eprintln!("case {number}: {} samples, {changes}", recording.len());
    }
    match imu_diagnosis::diagnose_any(&recording, reference.as_ref(), &model, &options) {
        Err(error) => (format!("{changes}: {error}"), false),
        Ok(outcome) => {
            serde_json::to_string(&outcome.diagnosis).unwrap();
            serde_json::to_string(&outcome.augmented).unwrap();
            (changes, true)
        }
    }
}

#[test]
fn odd_records_get_past_the_checks_and_never_bring_a_diagnosis_down() {
    let (count, seed) = (number("VN100D_ODD", 10) as usize, number("VN100D_ODD_SEED", 20_261_126));
    let still = plan(seed, count, &Wanted::from_words(std::iter::empty()).unwrap());
    let moved = motion::plan(seed, count, std::iter::empty()).unwrap();
    let plans = Plans { still, moved };
    // The first takes minutes: each push skips it.
    let first = u64::from(std::env::var_os("VN100D_ODD").is_none());
    let from = (number("VN100D_ODD_FROM", first) as usize).min(count);
    let (next, past, slowest) = (AtomicUsize::new(from), AtomicUsize::new(0), AtomicU64::new(0));
    let ended = AtomicUsize::new(0);
    let failed = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= count {
                        return;
                    }
                    let begun = std::time::Instant::now();
                    match std::panic::catch_unwind(AssertUnwindSafe(|| diagnose_case(seed, number, &plans))) {
                        Ok((_, true)) => drop(past.fetch_add(1, Ordering::Relaxed)),
                        Ok((outcome, false)) => eprintln!("case {number} was refused: {outcome}"),
                        Err(_) => failed.lock().unwrap().push(number),
                    }
                    let took = begun.elapsed();
                    if took > SLOW {
                        eprintln!("case {number} took {took:?}");
                    }
                    slowest.fetch_max(took.as_millis() as u64, Ordering::Relaxed);
                    let ended = ended.fetch_add(1, Ordering::Relaxed) + 1;
                    if ended.is_multiple_of(100) {
                        let panics = failed.lock().unwrap().len();
                        eprintln!("{} of {ended} got past the checks, {panics} panics", past.load(Ordering::Relaxed));
                    }
                }
            });
        }
    });
    let (taken, failed) = (past.into_inner(), failed.into_inner().unwrap());
    eprintln!(
        "{taken} of {} odd records of seed {seed} got past the checks; {} panics; the slowest took {} ms",
        count - from,
        failed.len(),
        slowest.into_inner()
    );
    assert!(failed.is_empty(), "cases {failed:?} of seed {seed} panicked");
    assert!(taken * 2 >= count - from, "too few got past the checks: {taken} of {}", count - from);
}
