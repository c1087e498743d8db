//! Tests: what comes and goes is named with its times, and what does not is not.

use super::blocks::TwoLevels;
use crate::Verdict;
use crate::cliffs::{WHITE, Wrong, diagnosed, list, names};
use crate::report::Sense;
use crate::round_trip::{RATE_HZ, model, recording};
use crate::two_effects::with_both;
use imu_core::sample::Channel;
use imu_model::simulator::SensorModel;
use serde_json::{Value, json};

const SAMPLES: usize = 40_000;

/// Returns stays of a length every `every_s`, the first after half a pause.
fn every(every_s: f64, stay_s: f64) -> Vec<[f64; 2]> {
    let first_s = 0.5 * (every_s - stay_s);
    let count = (SAMPLES as f64 / RATE_HZ / every_s) as usize;
    (0..count).map(|of| first_s + of as f64 * every_s).map(|from_s| [from_s, from_s + stay_s]).collect()
}

fn intermittent(of: &Value, intervals: &[[f64; 2]]) -> Value {
    json!({"effect": "intermittent", "of": of, "intervals": intervals})
}

fn tone(frequency_hz: f64, amplitude: f64) -> Value {
    json!({"effect": "tone", "frequency_hz": frequency_hz, "amplitude": amplitude})
}

fn band(frequency_hz: f64, bandwidth_hz: f64, sigma: f64) -> Value {
    json!({"effect": "resonance", "frequency_hz": frequency_hz, "bandwidth_hz": bandwidth_hz, "sigma": sigma})
}

/// Returns the largest distance of an end from its truth; infinite if the numbers of stays differ.
fn farthest(found: &Value, truth: &[[f64; 2]]) -> f64 {
    let found: Vec<[f64; 2]> = serde_json::from_value(found["intervals"].clone()).unwrap_or_default();
    if found.len() != truth.len() {
        return f64::INFINITY;
    }
    let ends = found.iter().flatten().zip(truth.iter().flatten());
    ends.map(|(one, other)| (one - other).abs()).fold(0.0, f64::max)
}

/// Expects the effect alone, with numbers in their intervals that are narrower than `width` of the number, ends within
/// `end_s`, and a corrected model that explains its own simulation.
fn expect(wrong: &mut Wrong, effect: &Value, seed: u64, end_s: f64, width: f64) {
    let found = diagnosed(&recording(&model(Some(effect)), seed, SAMPLES), &model(None));
    let case = format!("{} of {} stays, seed {seed}", effect["of"], effect["intervals"].as_array().map_or(0, Vec::len));
    wrong.expect(names(&found) == ["intermittent"] && found.diagnosis.verdict == Verdict::Effects, || {
        format!("{case}: {:?} {:?} {:?}", names(&found), found.diagnosis.verdict, found.diagnosis.notes)
    });
    let Some(cause) = found.diagnosis.causes.first() else { return };
    let own = list(cause, "accel_x").into_iter().next().unwrap_or_default();
    let truth: Vec<[f64; 2]> = serde_json::from_value(effect["intervals"].clone()).unwrap();
    let end = farthest(&own, &truth);
    wrong.expect(end < end_s, || format!("{case}: an end is {end} s off: {own}"));
    let known = cause.uncertainty.get("accel_x").map(|list| list[0].clone()).unwrap_or_default();
    for (name, truth) in effect["of"].as_object().unwrap().iter().filter(|(name, _)| *name != "effect") {
        let ends = [0, 1].map(|end| known[format!("of.{name}")][end].as_f64().unwrap_or(f64::NAN));
        let truth = truth.as_f64().unwrap();
        // Twice the half width: one interval in twenty misses.
        let [low, high] = [2.0 * ends[0] - 0.5 * (ends[0] + ends[1]), 2.0 * ends[1] - 0.5 * (ends[0] + ends[1])];
        wrong.expect(low <= truth && truth <= high, || format!("{case}: {name} in {ends:?}"));
        wrong.expect(ends[1] - ends[0] < width * truth, || format!("{case}: {name} in {ends:?} is wide"));
    }
    let written = serde_json::to_string(&found.augmented).unwrap();
    let read = SensorModel::from_json(&written, "corrected").unwrap();
    let again = recording(&read, seed + 100, SAMPLES);
    let own = diagnosed(&again, &read);
    let is_own = matches!(own.diagnosis.verdict, Verdict::NoGap | Verdict::Parameters);
    wrong.expect(is_own, || format!("{case}: its corrected model: {:?}", names(&own)));
    let plain = diagnosed(&again, &model(None));
    wrong.expect(names(&plain) == ["intermittent"], || format!("{case} again: {:?}", names(&plain)));
}

#[test]
fn a_line_that_comes_and_goes_is_named_with_its_times() {
    let mut wrong = Wrong::default();
    for (every_s, stay_s, amplitude, seed) in [
        (15.0, 5.0, 0.03, 1),
        (50.0, 30.0, 0.03, 2),
        (250.0, 80.0, 0.03, 3),
        (1000.0, 400.0, 0.03, 4),
        (100.0, 30.0, 0.3, 5),
        (200.0, 60.0, 0.01, 6),
    ] {
        expect(&mut wrong, &intermittent(&tone(8.1, amplitude), &every(every_s, stay_s)), seed, 1.0, 0.1);
    }
    wrong.none();
}

#[test]
fn a_band_that_comes_and_goes_is_named_with_its_times() {
    let mut wrong = Wrong::default();
    for (every_s, stay_s, bandwidth_hz, sigma, seed) in [
        (100.0, 40.0, 0.8, 0.02, 1),
        (250.0, 100.0, 0.8, 0.02, 2),
        (100.0, 50.0, 2.0, 0.03, 3),
        (500.0, 200.0, 0.3, 0.1, 4),
    ] {
        expect(&mut wrong, &intermittent(&band(8.1, bandwidth_hz, sigma), &every(every_s, stay_s)), seed, 4.0, 0.5);
    }
    wrong.none();
}

#[test]
fn what_comes_and_goes_is_found_beside_other_effects() {
    let mut wrong = Wrong::default();
    let gated_tone = intermittent(&tone(8.1, 0.03), &every(100.0, 40.0));
    let gated_band = intermittent(&band(8.1, 0.8, 0.02), &every(200.0, 80.0));
    let loud = json!({"effect": "variance_change", "from_s": 300.0, "to_s": 500.0, "factor": 1.5});
    let bursts = json!({"effect": "bursts", "intervals": [[310.0, 314.0], [555.0, 560.0]], "sigma": 0.2});
    let spikes = json!({"effect": "spikes", "rate_hz": 0.05, "amplitude": 0.2});
    let low_pass = json!({"effect": "low_pass", "cutoff_hz": 6.0, "order": 2});
    let ramp = json!({"effect": "rate_ramp", "R": 1e-4});
    let cases = [
        (&gated_tone, &loud),
        (&gated_tone, &low_pass),
        (&gated_tone, &ramp),
        (&gated_tone, &tone(11.3, 0.004)),
        (&gated_band, &loud),
        (&gated_band, &bursts),
        (&gated_band, &spikes),
        (&gated_tone, &spikes),
        (&gated_band, &low_pass),
    ];
    for ((gated, other), seed) in cases.into_iter().zip(1..) {
        let found = diagnosed(&recording(&with_both([gated, other]), seed, SAMPLES), &model(None));
        let named = names(&found);
        let name = other["effect"].as_str().unwrap_or_default();
        let are_both = named.len() == 2 && ["intermittent", name].iter().all(|name| named.contains(name));
        wrong.expect(are_both, || format!("{} beside {other}: {named:?}", gated["of"]));
    }
    wrong.none();
}

/// A steady line beside a stretch that is replaced, a line whose amplitude swings, two lines that beat, and a band.
#[test]
fn what_is_steady_or_swings_does_not_come_and_go() {
    let mut wrong = Wrong::default();
    let loud = json!({"effect": "variance_change", "from_s": 300.0, "to_s": 800.0, "factor": 10.0});
    let swings = json!({"effect": "wandering_line", "frequency_hz": 8.1, "amplitude": 0.03, "frequency_sigma_hz": 0.01,
        "frequency_tc_s": 5.0, "amplitude_sigma": 0.7, "amplitude_tc_s": 20.0});
    let profile: Vec<[f64; 2]> = (0..21).map(|of| [50.0 * f64::from(of), f64::from(of % 4)]).collect();
    let swells = json!({"effect": "modulated_band", "frequency_hz": 8.1, "bandwidth_hz": 0.8, "sigma": 0.02,
        "level": profile});
    for (effects, seed) in [
        ([tone(8.1, 0.03), loud], 1),
        ([tone(8.1, 0.03), tone(8.11, 0.03)], 2),
        ([tone(8.1, 0.03), tone(8.15, 0.02)], 3),
        ([band(8.1, 0.8, 0.02), tone(3.1, 0.01)], 4),
        ([swings, tone(3.1, 0.01)], 5),
        ([swells, tone(3.1, 0.01)], 6),
    ] {
        let found = diagnosed(&recording(&with_both([&effects[0], &effects[1]]), seed, SAMPLES), &model(None));
        let named = names(&found);
        wrong.expect(!named.is_empty() && !named.contains(&"intermittent"), || format!("{effects:?}: {named:?}"));
    }
    wrong.none();
}

/// In the half of the record in which white noise is louder, a steady band and white noise of the mean level have the powers
/// of a band and of silence.
#[test]
fn a_steady_band_beside_a_change_of_variance_does_not_come_and_go() {
    let mut wrong = Wrong::default();
    let low_pass = json!({"effect": "low_pass", "cutoff_hz": 12.0, "order": 1});
    for (factor, sigma, seed) in [(1.2, 0.003, 1), (1.38, 0.003, 2), (1.38, 0.004, 3), (1.38, 0.006, 4)] {
        let change = json!({"effect": "variance_change", "from_s": 400.0, "to_s": 900.0, "factor": factor});
        let mut sensor = with_both([&band(8.1, 0.8, sigma), &change]);
        for other in [None, Some(&low_pass)] {
            if let Some(other) = other {
                let filter = model(Some(other)).channels.remove(&Channel::AccelX).unwrap().effects[0].clone();
                sensor.channels.get_mut(&Channel::AccelX).unwrap().push_effect(filter, &[]);
            }
            let found = diagnosed(&recording(&sensor, seed, SAMPLES), &model(None));
            let named = names(&found);
            let is_steady = !named.is_empty() && !named.contains(&"intermittent");
            wrong.expect(is_steady, || format!("{factor} {sigma} {}: {named:?}", other.is_some()));
        }
    }
    wrong.none();
}

/// A line whose frequency wanders within its stays is no sine, but it is named.
#[test]
fn what_comes_and_goes_and_wanders_is_named() {
    let mut wrong = Wrong::default();
    for (frequency_sigma_hz, seed) in [(0.05, 1), (0.3, 2)] {
        let line = json!({"effect": "wandering_line", "frequency_hz": 8.1, "amplitude": 0.03,
            "frequency_sigma_hz": frequency_sigma_hz, "frequency_tc_s": 5.0, "amplitude_sigma": 0.0, "amplitude_tc_s": 1.0});
        let mut real = recording(&model(None), seed, SAMPLES);
        let [quiet, with] =
            [None, Some(&line)].map(|of| recording(&model(of), seed + 50, SAMPLES).channels[0].1.clone());
        let stays = every(100.0, 40.0);
        for (t, value) in real.channels[0].1.iter_mut().enumerate() {
            let time_s = t as f64 / RATE_HZ;
            let is_there = stays.iter().any(|[from_s, to_s]| (*from_s..*to_s).contains(&time_s));
            *value += if is_there { with[t] - quiet[t] } else { 0.0 };
        }
        let found = diagnosed(&real, &model(None));
        let is_of_band = |name: &&str| ["intermittent", "modulated_band", "resonance", "wandering_line"].contains(name);
        let named = names(&found);
        wrong.expect(named.iter().any(is_of_band), || format!("{frequency_sigma_hz}: {named:?}"));
    }
    wrong.none();
}

/// A model states an amplitude, times or means of the times. A record that agrees has no gap.
#[test]
fn a_models_line_that_comes_and_goes_is_compared() {
    let mut wrong = Wrong::default();
    let own = intermittent(&tone(8.1, 0.03), &every(100.0, 40.0));
    let random = json!({"effect": "intermittent", "of": tone(8.1, 0.03), "on_s": 10.0, "off_s": 30.0});
    for (effect, seed) in [(&own, 1), (&random, 2)] {
        let found = diagnosed(&recording(&model(Some(effect)), seed, SAMPLES), &model(Some(effect)));
        let is_none = names(&found).is_empty() && found.diagnosis.verdict == Verdict::NoGap;
        wrong.expect(is_none, || format!("{effect}: {:?} {:?}", names(&found), found.diagnosis.notes));
    }
    let louder = intermittent(&tone(8.1, 0.06), &every(100.0, 40.0));
    let later: Vec<[f64; 2]> = every(100.0, 40.0).iter().map(|stay| stay.map(|at_s| at_s + 20.0)).collect();
    let later = intermittent(&tone(8.1, 0.03), &later);
    for (effect, seed) in [(&louder, 4), (&later, 5)] {
        let found = diagnosed(&recording(&model(Some(effect)), seed, SAMPLES), &model(Some(&own)));
        let cause = found.diagnosis.causes.first().map(|cause| (cause.effect.name(), cause.sense));
        let is_size = names(&found).len() == 1 && cause == Some(("intermittent", Sense::Size));
        wrong.expect(is_size, || format!("{effect}: {:?} {cause:?}", names(&found)));
    }
    wrong.none();
}

/// Its frequency has to be found with an error that turns it by much less than a cycle within a stay.
#[test]
fn a_line_with_one_long_stay_and_times_at_random_is_one_line() {
    let mut wrong = Wrong::default();
    let long = intermittent(&tone(8.1, 0.03), &[[500.0, 7000.0]]);
    let random = json!({"effect": "intermittent", "of": tone(8.1, 0.03), "on_s": 60.0, "off_s": 120.0});
    for (effect, seed) in [(&long, 1), (&long, 2), (&random, 3), (&random, 4)] {
        let found = diagnosed(&recording(&model(Some(effect)), seed, 300_000), &model(None));
        let named = names(&found);
        wrong.expect(named == ["intermittent"], || format!("{effect} seed {seed}: {named:?}"));
        let known = found.diagnosis.causes.first().and_then(|of| of.uncertainty.get("accel_x").cloned());
        let ends = known.map(|known| known[0]["of.amplitude"].clone()).unwrap_or_default();
        let [low, high] = [0, 1].map(|end| ends[end].as_f64().unwrap_or(f64::NAN));
        // Twice the half width: one interval in twenty misses.
        let is_known = (0.03 - 0.5 * (low + high)).abs() < high - low && high - low < 0.002;
        wrong.expect(is_known, || format!("{effect} seed {seed}: {ends}"));
    }
    wrong.none();
}

/// The first half has no stay from which the effects of the second could be learned.
#[test]
fn what_is_present_in_one_half_alone_is_no_unknown_effect() {
    let mut wrong = Wrong::default();
    for (of, seed) in [(tone(8.1, 0.03), 1), (band(8.1, 0.8, 0.02), 2)] {
        for stay in [[600.0, 900.0], [100.0, 400.0]] {
            let effect = intermittent(&of, &[stay]);
            let found = diagnosed(&recording(&model(Some(&effect)), seed, SAMPLES), &model(None));
            let is_right = names(&found) == ["intermittent"] && found.diagnosis.verdict == Verdict::Effects;
            let notes = &found.diagnosis.notes;
            wrong.expect(is_right, || format!("{effect}: {:?} {:?} {notes:?}", names(&found), found.diagnosis.verdict));
        }
    }
    wrong.none();
}

#[test]
fn a_sensor_that_does_not_move_has_no_levels() {
    assert!(TwoLevels::of(&[0.0; 40], 0.2).is_none());
    assert!(TwoLevels::of(&[f64::NAN; 40], 0.2).is_none());
    let steps: Vec<f64> = (0..48).map(|at| if at / 8 % 2 == 0 { 1e-3 } else { WHITE }).collect();
    let levels = TwoLevels::of(&steps, 0.2).map(|levels| levels.ranges());
    assert_eq!(levels, None);
    let steps: Vec<f64> = steps.iter().map(|of| of * of).collect();
    assert_eq!(TwoLevels::of(&steps, 0.2).map(|levels| levels.ranges()), Some(vec![8..16, 24..32, 40..48]));
}
