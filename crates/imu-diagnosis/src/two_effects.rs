//! Two effects on one channel: both are found, and the interval of each holds the truth whatever the other is.

use super::cliffs::{WHITE, Wrong, diagnosed, list, names};
use super::round_trip::{model, recording};
use super::strong_effects::SAMPLES;
use imu_core::sample::Channel;
use imu_model::simulator::SensorModel;
use serde_json::{Value, json};

/// Returns a sensor with two effects on one channel.
pub(super) fn with_both([one, other]: [&Value; 2]) -> SensorModel {
    let mut sensor = model(Some(one));
    let with = model(Some(other)).channels.remove(&Channel::AccelX).unwrap();
    sensor.channels.get_mut(&Channel::AccelX).unwrap().push_effect(with.effects[0].clone(), &[]);
    sensor
}

/// Expects that the interval of a parameter of the second of two effects holds the truth within a share `near`, and is
/// no wider than `wide`, high over low.
fn expect_interval(wrong: &mut Wrong, both: [&Value; 2], parameter: &str, seed: u64, (near, wide): (f64, f64)) {
    let found = diagnosed(&recording(&with_both(both), seed, 4 * SAMPLES), &model(None));
    let [other, effect] = both;
    let cause = found.diagnosis.causes.iter().find(|cause| effect["effect"] == cause.effect.name());
    let ends = cause.map(|cause| cause.uncertainty["accel_x"][0][parameter].clone()).unwrap_or_default();
    let [low, high] = [0, 1].map(|end| ends[end].as_f64().unwrap_or_default());
    let truth = effect[parameter].as_f64().unwrap();
    let is_right = low < (1.0 + near) * truth && high > (1.0 - near) * truth && high < wide * low;
    wrong.expect(is_right, || format!("{other} {effect} seed {seed}: {low} to {high}"));
}

/// Expects that the diagnosis names two effects of one channel that the model lacks, and no others.
pub(super) fn expect_both(wrong: &mut Wrong, [one, other]: [&Value; 2], seed: u64) {
    let found = diagnosed(&recording(&with_both([one, other]), seed, SAMPLES), &model(None));
    let mut named = names(&found);
    let mut expected = [one, other].map(|effect| effect["effect"].as_str().unwrap());
    named.sort_unstable();
    expected.sort_unstable();
    wrong.expect(named == expected, || format!("{one} {other} seed {seed}: {named:?}"));
}

/// Behind a filter a sample is a mixture of many, and where the filter passes nothing, other noise takes its place.
#[test]
fn tails_in_front_of_a_filter_or_beside_slow_noise_are_as_heavy_as_they_are() {
    let low_pass = |cutoff_hz: f64, order: u64, behind: f64| json!({"effect": "low_pass", "cutoff_hz": cutoff_hz, "order": order, "white_behind": behind});
    let mut wrong = Wrong::default();
    for (other, degrees, seed) in [
        (low_pass(9.0, 2, 0.0), 6.0, 1),
        (low_pass(14.0, 2, 0.0), 4.0, 2),
        (low_pass(6.0, 2, 1e-5), 5.0, 3),
        (low_pass(9.0, 4, 3e-5), 6.0, 4),
        (low_pass(12.0, 1, 1e-4), 8.0, 5),
        (json!({"effect": "moving_average", "window": 4}), 6.0, 6),
        (json!({"effect": "gauss_markov", "sigma": 0.05, "tc_s": 0.3}), 5.0, 7),
    ] {
        let tails = json!({"effect": "heavy_tails", "degrees_of_freedom": degrees});
        expect_interval(&mut wrong, [&other, &tails], "degrees_of_freedom", seed, (0.02, 1.5));
    }
    wrong.none();
}

/// Beside other noise, and behind a filter, the residual's variance changes less than that of the white noise.
#[test]
fn a_change_of_variance_is_that_of_the_white_noise_whatever_lies_beside_it() {
    let process = json!({"effect": "gauss_markov", "sigma": 1.5 * WHITE, "tc_s": 0.3});
    let filter = json!({"effect": "low_pass", "cutoff_hz": 9.0, "order": 2, "white_behind": 2e-4});
    let mut wrong = Wrong::default();
    for (seed, factor) in [(1, 1.6), (2, 2.24), (3, 4.0)] {
        for other in [&process, &filter] {
            let change = json!({"effect": "variance_change", "from_s": 500.0, "to_s": 1000.0, "factor": factor});
            expect_interval(&mut wrong, [other, &change], "factor", seed, (0.01, 1.12));
        }
    }
    wrong.none();
}

/// Noise that other channels share is neither heavy-tailed nor louder in a stretch.
#[test]
fn changes_of_a_channels_own_noise_do_not_concern_what_it_shares() {
    let shared = json!({"effect": "common_mode", "sigma": 0.6 * WHITE});
    let mut wrong = Wrong::default();
    for seed in 1..4 {
        let tails = json!({"effect": "heavy_tails", "degrees_of_freedom": 6.0});
        expect_interval(&mut wrong, [&shared, &tails], "degrees_of_freedom", seed, (0.02, 1.5));
        for factor in [1.4, 3.0] {
            let change = json!({"effect": "variance_change", "from_s": 500.0, "to_s": 1000.0, "factor": factor});
            expect_interval(&mut wrong, [&shared, &change], "factor", seed, (0.01, 1.12));
        }
        let bursts = json!({"effect": "bursts", "intervals": [[300.0, 310.0], [900.0, 907.0]], "sigma": 3.0 * WHITE});
        expect_interval(&mut wrong, [&shared, &bursts], "sigma", seed, (0.02, 1.3));
        let warm = json!({"effect": "variance_change", "per_c": 0.06, "reference_c": 25.0});
        expect_interval(&mut wrong, [&shared, &warm], "per_c", seed, (0.01, 1.3));
    }
    wrong.none();
}

/// The size of a stretch is relative to the noise about it, whose variance may change too, and is less certain if a few
/// values are far out.
#[test]
fn stretches_are_as_loud_as_they_are_beside_other_changes_of_the_variance() {
    let longer = json!({"effect": "variance_change", "from_s": 700.0, "to_s": 2000.0, "factor": 1.4});
    let bursts = json!({"effect": "bursts", "intervals": [[300.0, 310.0], [900.0, 907.0]], "sigma": 4.0 * WHITE});
    let tails = json!({"effect": "heavy_tails", "degrees_of_freedom": 6.0});
    let mut wrong = Wrong::default();
    for seed in 1..4 {
        expect_interval(&mut wrong, [&longer, &bursts], "sigma", seed, (0.02, 1.3));
        expect_interval(&mut wrong, [&tails, &longer], "factor", seed, (0.005, 1.12));
        let heavier = json!({"effect": "heavy_tails", "degrees_of_freedom": 4.0});
        let louder = json!({"effect": "variance_change", "from_s": 700.0, "to_s": 2000.0, "factor": 2.4});
        expect_interval(&mut wrong, [&heavier, &louder], "factor", seed, (0.01, 1.2));
    }
    wrong.none();
}

/// Behind a filter hardly anything is left of a step at high frequencies, nor of the noise.
#[test]
fn small_steps_behind_a_filter_are_found() {
    let mut wrong = Wrong::default();
    for (seed, filter) in [
        (1, json!({"effect": "low_pass", "cutoff_hz": 11.0, "order": 2})),
        (2, json!({"effect": "low_pass", "cutoff_hz": 5.0, "order": 3})),
        (3, json!({"effect": "moving_average", "window": 4})),
    ] {
        for size in [0.8 * WHITE, -1.6 * WHITE] {
            let step = json!({"effect": "bias_step", "at_s": 463.2, "size": size});
            expect_both(&mut wrong, [&filter, &step], seed);
        }
    }
    wrong.none();
}

/// A warm-up alone would take over a part of the ramp, with another time constant.
#[test]
fn a_ramp_beside_a_warm_up_is_found() {
    let mut wrong = Wrong::default();
    for (seed, per_s, tau_s) in [(1, 3e-5, 100.0), (2, -3e-5, 60.0), (3, 5e-5, 200.0)] {
        let ramp = json!({"effect": "rate_ramp", "R": per_s});
        let warm_up = json!({"effect": "warm_up", "amplitude": -0.03, "tau_s": tau_s});
        expect_both(&mut wrong, [&ramp, &warm_up], seed);
    }
    wrong.none();
}

/// Noise that enters behind a filter stays as loud as it is while the noise in front of it changes.
#[test]
fn behind_a_filter_a_change_of_variance_is_no_tails_and_no_bursts() {
    let profile: Vec<[f64; 2]> =
        (0..=40).map(|k| f64::from(k) * 25.0).map(|at| [at, (1.4 * (at / 110.0).sin()).exp()]).collect();
    let course = json!({"effect": "variance_change", "profile": profile});
    let mut wrong = Wrong::default();
    for (order, cutoff_hz, behind, seed) in [(1, 7.5, 1e-4, 1), (2, 7.0, 4e-5, 2), (1, 4.0, 2e-4, 3)] {
        let filter = json!({"effect": "low_pass", "cutoff_hz": cutoff_hz, "order": order, "white_behind": behind});
        let found = diagnosed(&recording(&with_both([&course, &filter]), seed, SAMPLES), &model(None));
        let mut named = names(&found);
        named.sort_unstable();
        let remains = found.diagnosis.remainder.as_ref().map_or(0.0, |of| of.nats);
        wrong.expect(named == ["low_pass", "variance_change"] && remains < 2e-3, || {
            format!("order {order} at {cutoff_hz} Hz, seed {seed}: {named:?}, {remains} nats remain")
        });
    }
    wrong.none();
}

/// Steps of the level hide where a louder stretch begins, so that it looks like a course of the variance at first.
#[test]
fn a_louder_stretch_beside_large_steps_is_one_stretch() {
    let mut wrong = Wrong::default();
    for (factor, size, seed) in [(4.3, 90.0, 1), (2.5, 40.0, 2), (7.0, 200.0, 3)] {
        let louder = json!({"effect": "variance_change", "from_s": 640.0, "to_s": 960.0, "factor": factor});
        let mut real = recording(
            &with_both([&louder, &json!({"effect": "moving_average", "window": 4, "white_behind": 5e-5})]),
            seed,
            SAMPLES,
        );
        let values = &mut real.channels[0].1;
        for at in [3_513, 15_654] {
            values[at..].iter_mut().for_each(|value| *value += size * WHITE);
        }
        let found = diagnosed(&real, &model(None));
        let mut named = names(&found);
        named.sort_unstable();
        let cause = found.diagnosis.causes.iter().find(|cause| cause.effect.name() == "variance_change");
        let is_stretch = cause.is_some_and(|cause| list(cause, "accel_x").iter().any(|of| of["from_s"].is_number()));
        wrong.expect(named == ["bias_step", "moving_average", "variance_change"] && is_stretch, || {
            format!("{factor} {size} seed {seed}: {named:?}")
        });
    }
    wrong.none();
}

/// A strong line is searched first, and then further lines. The many peaks of a band or of slow noise are none.
#[test]
fn beside_lines_a_band_or_slow_noise_is_no_further_lines() {
    let comb = json!({"effect": "comb", "fundamental_hz": 3.1, "amplitudes": [0.9 * WHITE, 0.8 * WHITE, 1.1 * WHITE]});
    let mut wrong = Wrong::default();
    for (other, seed) in [
        (json!({"effect": "resonance", "frequency_hz": 10.7, "bandwidth_hz": 0.35, "sigma": 0.6 * WHITE}), 1),
        (json!({"effect": "resonance", "frequency_hz": 5.3, "bandwidth_hz": 0.08, "sigma": 0.3 * WHITE}), 2),
        (json!({"effect": "gauss_markov", "sigma": 1.6 * WHITE, "tc_s": 5.0}), 3),
    ] {
        for times in [1.0, 6.0] {
            let comb = scaled(&comb, times);
            expect_both(&mut wrong, [&comb, &other], seed);
        }
    }
    wrong.none();
}

/// Returns a comb with other amplitudes.
fn scaled(comb: &Value, times: f64) -> Value {
    let mut scaled = comb.clone();
    let amplitudes = scaled["amplitudes"].as_array_mut().unwrap();
    amplitudes.iter_mut().for_each(|of| *of = json!(times * of.as_f64().unwrap()));
    scaled
}

/// A filter that is found before the skirts of a strong band are known would stand for them, and a second filter for what the
/// first leaves.
#[test]
fn a_strong_leaning_band_beside_a_comb_is_no_filter() {
    let mut wrong = Wrong::default();
    for (frequency_hz, sigma, seed) in [(2.7, 3.3, 1), (4.6, 5.0, 2), (3.1, 2.0, 3)] {
        let band = json!({"effect": "resonance", "frequency_hz": frequency_hz, "bandwidth_hz": 0.24,
            "sigma": sigma * WHITE, "asymmetry": 0.95});
        let amplitudes = [4.0, 7.4, 3.5].map(|times| times * WHITE);
        let comb = json!({"effect": "comb", "fundamental_hz": 0.93 * frequency_hz, "amplitudes": amplitudes});
        expect_both(&mut wrong, [&band, &comb], seed);
    }
    wrong.none();
}

/// An error in the form of a very strong effect gains as much as a weak effect does. What gains less than a two-thousandth of the
/// largest effect of its channel is an alternative with the reason, and stays in the corrected model.
#[test]
fn what_gains_a_small_part_of_another_effect_is_an_alternative() {
    let filter = json!({"effect": "low_pass", "cutoff_hz": 9.0, "order": 4});
    let mut wrong = Wrong::default();
    for (sigma, is_cause) in [(0.2, false), (1.5, true)] {
        let process = json!({"effect": "gauss_markov", "sigma": sigma * WHITE, "tc_s": 20.0});
        let found = diagnosed(&recording(&with_both([&filter, &process]), 3, 2 * SAMPLES), &model(None));
        let cause = names(&found).contains(&"gauss_markov");
        let alternatives = &found.diagnosis.alternatives;
        let alternative = alternatives.iter().find(|of| of.effect.name() == "gauss_markov");
        let reason = alternative.map_or("", |of| &of.why_not);
        let modelled = found.augmented.channels[&Channel::AccelX].effects.iter().any(|of| of.name() == "gauss_markov");
        let is_right = if is_cause { cause } else { !cause && reason.contains("of low_pass") && modelled };
        wrong.expect(is_right, || format!("sigma {sigma}: {:?}, {reason:?}, {modelled}", names(&found)));
    }
    wrong.none();
}
