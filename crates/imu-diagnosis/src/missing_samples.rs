//! Missing samples: rows that a driver filled with zeros, samples lost or cut off behind a filter, stamps of arrival.

use super::cliffs::WHITE;
use super::round_trip::{RATE_HZ, model, recording};
use super::{Options, Outcome, Recording, Verdict, diagnose};
use imu_model::effects::{Stream, StreamId};
use imu_model::simulator::SensorModel;
use serde_json::{Value, json};

const SAMPLES: usize = 40_000;

fn diagnosed(real: &Recording, sim: &SensorModel) -> Outcome {
    diagnose(real, sim, &Options::default()).unwrap()
}

/// Returns a model of one axis and a recording of it: three axes that repeat together are hardly equal by chance.
fn one_axis(effect: Option<&Value>, seed: u64) -> (SensorModel, Recording) {
    let mut sim = model(effect);
    let mut real = recording(&sim, seed, SAMPLES);
    real.channels.truncate(1);
    sim.channels.retain(|channel, _| *channel == real.channels[0].0);
    (sim, real)
}

/// Sends a share of the samples again.
fn hold(values: &mut [f64], share: f64, seed: u64) {
    let mut stream = Stream::new(seed, StreamId { owner: 94, effect: 0, instance: 0 });
    for t in 1..values.len() {
        if stream.uniform() < share {
            values[t] = values[t - 1];
        }
    }
}

fn names(outcome: &Outcome) -> Vec<&'static str> {
    outcome.diagnosis.causes.iter().map(|cause| cause.effect.name()).collect()
}

#[test]
fn a_run_of_zeros_of_a_driver_is_missing_rows_and_no_cause() {
    for (seed, from, count) in [(11, 9_990, 20), (12, 30_000, 1), (13, 200, 900)] {
        let mut real = recording(&model(None), seed, SAMPLES);
        real.channels.iter_mut().for_each(|(_, values)| values[from..from + count].fill(0.0));
        let found = diagnosed(&real, &model(None)).diagnosis;
        assert!(matches!(found.verdict, Verdict::NoGap), "{}", found.summary);
        let begins = format!("{count} row");
        assert!(
            found.notes.iter().any(|note| note.starts_with(&begins) && note.contains("0 on every")),
            "{:?}",
            found.notes
        );
    }
}

#[test]
fn zeros_now_and_then_are_rows_that_were_lost() {
    let mut real = recording(&model(None), 14, SAMPLES);
    let zeros = |values: &mut Vec<f64>| values.iter_mut().step_by(7).for_each(|value| *value = 0.0);
    real.channels.iter_mut().for_each(|(_, values)| zeros(values));
    let found = diagnosed(&real, &model(None));
    assert_eq!(names(&found), ["timing"], "{}", found.diagnosis.summary);
    assert!(found.diagnosis.notes.iter().any(|note| note.contains("0 on every")), "{:?}", found.diagnosis.notes);
}

/// A walk that passes 0 holds it for a while, although it spends most of its time far from there.
#[test]
fn a_walk_in_coarse_steps_passes_zero_and_has_no_missing_rows() {
    let (sim, mut real) = one_axis(None, 15);
    let step = 3.0 * WHITE;
    let count = SAMPLES as f64;
    for (t, value) in real.channels[0].1.iter_mut().enumerate() {
        // From −20 to 10 steps and back.
        let course = -5.0 + 15.0 * (9.0 * t as f64 / count).sin();
        *value = step * ((*value - 0.3) / step + course).round();
    }
    let found = diagnosed(&real, &sim);
    assert!(!names(&found).contains(&"timing"), "{}", found.diagnosis.summary);
    assert!(!found.diagnosis.notes.iter().any(|note| note.contains("0 on every")), "{:?}", found.diagnosis.notes);
}

/// Sharp filters hide how much is behind them if samples are lost.
#[test]
fn samples_that_are_lost_behind_a_filter_are_no_other_filter() {
    for filter in [
        json!({"effect": "low_pass", "cutoff_hz": 5.0, "order": 2}),
        json!({"effect": "low_pass", "cutoff_hz": 8.0, "order": 1}),
        json!({"effect": "moving_average", "window": 4}),
    ] {
        for (share, seed) in [(3e-5, 31), (1e-3, 32), (3e-2, 33), (0.1, 34)] {
            let sim = model(Some(&filter));
            let mut real = recording(&sim, seed, SAMPLES);
            let mut stream = Stream::new(seed, StreamId { owner: 91, effect: 0, instance: 0 });
            real.missing.iter_mut().for_each(|missing| *missing = stream.uniform() < share);
            let found = diagnosed(&real, &sim);
            let others = names(&found).iter().filter(|name| **name != "timing").count();
            let is_right = others == 0 && found.diagnosis.verdict != Verdict::UnknownEffect;
            assert!(is_right, "{filter}, {share}: {}", found.diagnosis.summary);
        }
    }
}

#[test]
fn samples_that_are_cut_off_behind_a_filter_are_saturation_alone() {
    let filter = json!({"effect": "low_pass", "cutoff_hz": 5.0, "order": 2});
    for (limit, seed) in [(0.312, 41), (0.310, 42), (0.316, 43)] {
        let sim = model(Some(&filter));
        let mut real = recording(&sim, seed, SAMPLES);
        real.channels[0].1.iter_mut().for_each(|value| *value = value.min(limit));
        let found = diagnosed(&real, &sim);
        assert_eq!(names(&found), ["saturation"], "{limit}: {}", found.diagnosis.summary);
        assert!(found.diagnosis.discrepancy.before.abs() < 0.01, "{:?}", found.diagnosis.discrepancy);
    }
}

/// Stamps of arrival scatter by more than a model's may. The corrected model can still be read.
#[test]
fn a_model_of_stamps_that_scatter_by_more_than_its_own_stays_a_model() {
    let timing = json!({"effect": "timing", "jitter_s": 0.002, "drop_probability": 0.0});
    let sim = model(Some(&timing));
    let mut real = recording(&sim, 61, 20_000);
    let mut stream = Stream::new(61, StreamId { owner: 93, effect: 0, instance: 0 });
    real.time_s.iter_mut().for_each(|time_s| *time_s += 0.02 * stream.normal());
    let found = diagnosed(&real, &sim);
    assert_eq!(names(&found), ["timing"], "{}", found.diagnosis.summary);
    assert_eq!(found.augmented.check(RATE_HZ), Ok(()));
}

/// Neighbours that are equal by chance are not left out: what is left would look bluer than it is.
#[test]
fn samples_that_are_held_in_coarse_steps_leave_no_other_noise() {
    for (step, held, seed) in [(0.25, 0.01, 71), (0.4, 0.02, 72), (1.0, 0.03, 73), (0.4, 0.1, 74), (1.0, 0.2, 75)] {
        let (sim, mut real) = one_axis(None, seed);
        let values = &mut real.channels[0].1;
        values.iter_mut().for_each(|value| *value = step * WHITE * (*value / (step * WHITE)).round());
        hold(values, held, seed);
        let mut found = names(&diagnosed(&real, &sim));
        found.sort_unstable();
        assert_eq!(found, ["held_samples", "resolution"], "{step}, {held}");
    }
}

/// Values of many digits are equal by chance nowhere, also if one value is sent three times.
#[test]
fn samples_that_are_held_often_are_all_left_out() {
    let (sim, mut real) = one_axis(None, 81);
    hold(&mut real.channels[0].1, 0.3, 81);
    assert_eq!(names(&diagnosed(&real, &sim)), ["held_samples"]);
}

/// Values of two or three steps stay for long and come back: that is chance, although a value that has changed seldom returns at once.
#[test]
fn values_of_a_few_steps_are_not_held() {
    for (steps, seed) in [(5.0, 91), (6.0, 92), (9.0, 93)] {
        let (sim, real) = one_axis(Some(&json!({"effect": "resolution", "step": steps * WHITE})), seed);
        let found = diagnosed(&real, &sim);
        assert!(names(&found).is_empty(), "{steps}: {}", found.diagnosis.summary);
    }
}
