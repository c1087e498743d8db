//! Strong effects: an effect that is far louder than all others is named alone, and hides no effect beside it.

use super::cliffs::{WHITE, Wrong, diagnosed, list, names};
use super::round_trip::{RATE_HZ, model, recording};
use super::two_effects::{expect_both, with_both};
use super::{Outcome, Verdict};
use imu_model::effects::{Stream, StreamId};
use serde_json::{Value, json};

pub(super) const SAMPLES: usize = 40_000;

/// Returns the findings on an effect that the model lacks.
fn found(effect: &Value, seed: u64) -> Outcome {
    diagnosed(&recording(&model(Some(effect)), seed, SAMPLES), &model(None))
}

/// Expects that the diagnosis names one effect that the model lacks, and no other.
fn expect_alone(wrong: &mut Wrong, effect: &Value, seed: u64) {
    let found = found(effect, seed);
    let is_right = names(&found) == [effect["effect"].as_str().unwrap()] && found.diagnosis.verdict == Verdict::Effects;
    wrong.expect(is_right, || format!("{effect} seed {seed}: {:?} {:?}", names(&found), found.diagnosis.notes));
}

/// A cosine transform mirrors a record at its ends, unlike a strong line. Values far from the line in the spectrum
/// depend on the kind of line.
#[test]
fn a_strong_band_is_no_burst_at_the_ends_and_no_filter() {
    let mut wrong = Wrong::default();
    for (frequency_hz, bandwidth_hz, asymmetry) in
        [(6.0, 0.02, 0.0), (6.0, 0.1, 1.0), (3.0, 0.5, -1.0), (14.0, 0.05, 0.0), (9.0, 0.3, 0.5)]
    {
        for seed in 1..3 {
            let effect = json!({"effect": "resonance", "frequency_hz": frequency_hz, "bandwidth_hz": bandwidth_hz,
                "sigma": 0.5, "asymmetry": asymmetry});
            expect_alone(&mut wrong, &effect, seed);
        }
    }
    wrong.none();
}

#[test]
fn strong_lines_are_no_filter() {
    let mut wrong = Wrong::default();
    for (fundamental_hz, seed) in [(0.7, 1), (1.6, 2), (2.9, 3)] {
        let comb = json!({"effect": "comb", "fundamental_hz": fundamental_hz, "amplitudes": [0.9, 1.9, 0.8, 1.2, 1.5]});
        expect_alone(&mut wrong, &comb, seed);
    }
    wrong.none();
}

/// White noise of changing variance is added to noise of constant variance.
#[test]
fn a_variance_that_changes_a_thousandfold_is_no_other_effect() {
    let mut wrong = Wrong::default();
    let profile = |most: f64| -> Vec<[f64; 2]> {
        let at = |k: u32| f64::from(k) * 25.0;
        (0..=40).map(|k| [at(k), (most * (at(k) / 120.0).sin()).exp()]).collect()
    };
    for (most, seed) in [(1.5, 1), (2.5, 2), (3.5, 3)] {
        expect_alone(&mut wrong, &json!({"effect": "variance_change", "profile": profile(most)}), seed);
    }
    for (factor, seed) in [(0.02, 4), (0.1, 5), (40.0, 6)] {
        let effect = json!({"effect": "variance_change", "from_s": 300.0, "to_s": 420.0, "factor": factor});
        let found = found(&effect, seed);
        let own = found.diagnosis.causes.first().and_then(|cause| list(cause, "accel_x").first().cloned());
        let stated = own.and_then(|own| own["factor"].as_f64()).unwrap_or_default();
        let is_right = names(&found) == ["variance_change"] && (stated / factor - 1.0).abs() < 0.25;
        wrong.expect(is_right, || format!("{factor}: {stated} {:?} {:?}", names(&found), found.diagnosis.notes));
    }
    wrong.none();
}

/// The variance of a course may rise or fall at the record's ends, unlike a sum of cosines.
#[test]
fn a_variance_that_falls_steeply_at_the_ends_is_no_burst() {
    let mut wrong = Wrong::default();
    let profile = |most: f64, turns: f64, phase: f64| -> Vec<[f64; 2]> {
        let at = |k: u32| f64::from(k) / 48.0;
        let value = |k: u32| (most * (std::f64::consts::TAU * turns * at(k) + phase).sin()).exp();
        (0..=48).map(|k| [at(k) * 1000.0, value(k)]).collect()
    };
    for (most, turns, phase, seed) in
        [(2.5, 2.3, 3.1, 276), (3.5, 0.6, 3.1, 359), (3.5, 1.6, 3.1, 369), (3.5, 2.3, 2.5, 375)]
    {
        expect_alone(&mut wrong, &json!({"effect": "variance_change", "profile": profile(most, turns, phase)}), seed);
    }
    wrong.none();
}

/// Returns the factor on noise at a distance from the end of a stretch, in units of the time over which the noise rises.
fn soft(edge: f64) -> f64 {
    (std::f64::consts::FRAC_PI_2 * edge.clamp(0.0, 1.0)).sin().powi(2)
}

/// Noise that rises and falls over an eighth of a stretch leaves loud samples outside the stretch that is found.
#[test]
fn soft_ends_of_loud_stretches_are_neither_tails_nor_spikes() {
    let mut wrong = Wrong::default();
    for (size, length, seed) in [(9.0, 33, 1), (9.0, 120, 2), (40.0, 60, 3), (4.0, 300, 4)] {
        let mut real = recording(&model(None), seed, SAMPLES);
        let mut stream = Stream::new(seed, StreamId { owner: 93, effect: 0, instance: 0 });
        for from in (0..10).map(|of| 1_700 + of * 3_771) {
            for (at, value) in real.channels[0].1[from..from + length].iter_mut().enumerate() {
                let edge = (at.min(length - 1 - at) as f64 + 0.5) / (0.125 * length as f64);
                *value += size * WHITE * soft(edge) * stream.normal();
            }
        }
        let found = diagnosed(&real, &model(None));
        wrong.expect(names(&found) == ["bursts"], || format!("{size} {length}: {:?}", names(&found)));
    }
    wrong.none();
}

#[test]
fn a_loud_part_of_the_record_with_soft_ends_is_one_change_of_the_variance() {
    let mut wrong = Wrong::default();
    for (factor, from, to, soft_part, seed) in
        [(10.0, 0.3, 0.72, 0.02, 1), (40.0, 0.3, 0.72, 0.02, 2), (40.0, 0.1, 0.3, 0.12, 2)]
    {
        let mut real = recording(&model(None), seed, SAMPLES);
        let (from, to) = (from * SAMPLES as f64, to * SAMPLES as f64);
        let mut stream = Stream::new(seed, StreamId { owner: 94, effect: 0, instance: 0 });
        for (at, value) in real.channels[0].1.iter_mut().enumerate() {
            let edge = (at as f64 - from).min(to - at as f64) / (soft_part * (to - from));
            *value += factor * WHITE * soft(edge) * stream.normal();
        }
        let found = diagnosed(&real, &model(None));
        let cause = found.diagnosis.causes.first().map(|cause| list(cause, "accel_x"));
        // Inside the soft ends the noise is quieter.
        let near = 0.1 + 2.0 * soft_part;
        let is_right = |of: &Value| of["factor"].as_f64().is_some_and(|own| (own / factor - 1.0).abs() < near);
        let is_interval = cause.as_ref().is_some_and(|own| own.iter().any(is_right));
        wrong.expect(names(&found) == ["variance_change"] && is_interval, || {
            format!("{factor} {soft_part}: {:?} {cause:?}", names(&found))
        });
    }
    wrong.none();
}

#[test]
fn spikes_are_found_beside_a_stretch_that_is_most_of_the_record() {
    let mut wrong = Wrong::default();
    for (to_s, seed) in [(550.0, 1), (700.0, 2)] {
        let loud = json!({"effect": "variance_change", "from_s": 50.0, "to_s": to_s, "factor": 5.0});
        let spikes = json!({"effect": "spikes", "rate_hz": 0.1, "amplitude": 60.0 * WHITE});
        let found = diagnosed(&recording(&with_both([&loud, &spikes]), seed, SAMPLES), &model(None));
        let named = names(&found);
        let are_named = ["variance_change", "spikes"].iter().all(|name| named.contains(name));
        // The spikes in the stretch are loud noise beside its own.
        wrong.expect(are_named && !named.contains(&"heavy_tails"), || format!("{to_s}: {named:?}"));
    }
    wrong.none();
}

#[test]
fn steps_of_a_thousand_deviations_that_rise_slowly_are_steps_alone() {
    let mut wrong = Wrong::default();
    for (count, size, rise, seed) in [(1, 1000.0, 20.0, 1), (10, 600.0, 18.0, 2), (14, 100.0, 12.0, 3)] {
        let mut real = recording(&model(None), seed, SAMPLES);
        let mut truth = Vec::new();
        let values = &mut real.channels[0].1;
        for step in 0..count {
            let at = (step * 2 + 1) * SAMPLES / (2 * count) + 17 * step;
            let size = size * WHITE * if step % 3 == 1 { -1.1 } else { 1.0 };
            truth.push(size);
            for (t, value) in values.iter_mut().enumerate().skip(at) {
                let done = ((t - at) as f64 / rise).min(1.0);
                *value += 0.5 * size * (1.0 - (std::f64::consts::PI * done).cos());
            }
        }
        let found = diagnosed(&real, &model(None));
        let mut own = found.diagnosis.causes.first().map_or(Vec::new(), |cause| list(cause, "accel_x"));
        let number = |of: &Value, name: &str| of[name].as_f64().unwrap_or_default();
        own.sort_by(|a, b| number(a, "at_s").total_cmp(&number(b, "at_s")));
        let sizes: Vec<f64> = own.iter().map(|of| number(of, "size")).collect();
        let same = sizes.len() == count
            && sizes.iter().zip(&truth).all(|(found, truth)| (found - truth).abs() < 0.01 * truth.abs() + WHITE);
        wrong.expect(names(&found) == ["bias_step"] && same, || format!("{count}: {:?} {sizes:?}", names(&found)));
    }
    wrong.none();
}

#[test]
fn large_spikes_beside_loud_stretches_and_behind_a_filter_are_spikes() {
    let mut wrong = Wrong::default();
    for (size, seed) in [(50.0, 1), (700.0, 2)] {
        let mut real = recording(&model(None), seed, SAMPLES);
        let mut stream = Stream::new(seed, StreamId { owner: 93, effect: 0, instance: 0 });
        let values = &mut real.channels[0].1;
        for from in [4_000, 17_500, 31_000] {
            values[from..from + 45].iter_mut().for_each(|value| *value += 30.0 * WHITE * stream.normal());
        }
        for value in values.iter_mut() {
            if stream.uniform() < 1.2e-3 {
                *value += size * WHITE * (0.6 + 0.8 * stream.uniform());
            }
        }
        let found = diagnosed(&real, &model(None));
        let mut names = names(&found);
        names.sort_unstable();
        wrong.expect(names == ["bursts", "spikes"], || format!("{size}: {names:?}"));
    }
    for (size, seed) in [(3_000.0, 3), (100.0, 4)] {
        let filter = json!({"effect": "low_pass", "cutoff_hz": 12.0, "order": 2, "white_behind": 1e-4});
        let spikes = json!({"effect": "spikes", "rate_hz": 0.004, "amplitude": size * WHITE});
        expect_both(&mut wrong, [&filter, &spikes], seed);
    }
    wrong.none();
}

/// A spike behind a boxcar is as many samples wide, and spikes that are near each other look like bursts.
#[test]
fn spikes_of_a_thousand_deviations_in_front_of_a_boxcar_are_no_bursts() {
    let mut wrong = Wrong::default();
    for (window, rate_hz, size, seed) in
        [(3, 0.06, 1_200.0, 1), (3, 0.06, 1_200.0, 2), (4, 0.1, 300.0, 3), (2, 0.1, 2_000.0, 4)]
    {
        let filter = json!({"effect": "moving_average", "window": window, "white_behind": 6e-5});
        let spikes = json!({"effect": "spikes", "rate_hz": rate_hz, "amplitude": size * WHITE});
        expect_both(&mut wrong, [&spikes, &filter], seed);
    }
    wrong.none();
}

/// Shorter loud stretches beside a long one make as much of the apparent tails as the long one.
#[test]
fn loud_stretches_of_all_lengths_are_no_tails() {
    let mut real = recording(&model(None), 7, SAMPLES);
    let mut stream = Stream::new(7, StreamId { owner: 94, effect: 0, instance: 0 });
    let values = &mut real.channels[0].1;
    for (from, to) in [(6_600, 6_690), (11_000, 11_075), (17_100, 17_190), (24_200, 24_330), (37_800, SAMPLES)] {
        values[from..to].iter_mut().for_each(|value| *value += 40.0 * WHITE * stream.normal());
    }
    let found = diagnosed(&real, &model(None));
    let mut names = names(&found);
    names.sort_unstable();
    assert_eq!(names, ["bursts", "variance_change"], "{:?}", found.diagnosis.notes);
}

#[test]
fn a_process_of_a_few_samples_is_no_band_and_no_filter() {
    let mut wrong = Wrong::default();
    for (samples, sigma, seed) in [(4.0, 0.3, 1), (2.5, 0.05, 2), (5.0, 0.02, 3)] {
        let effect = json!({"effect": "gauss_markov", "sigma": sigma, "tc_s": samples / RATE_HZ});
        expect_alone(&mut wrong, &effect, seed);
    }
    wrong.none();
}

/// If a level follows the temperature steeply, rounded readings do not show all of it. The missing part is not a
/// separate process.
#[test]
fn a_level_that_follows_a_rounded_temperature_steeply_follows_it_alone() {
    let mut wrong = Wrong::default();
    for (per_c, seed) in [(0.05, 1), (0.2, 2)] {
        expect_alone(&mut wrong, &json!({"effect": "temperature_bias", "per_c": per_c, "reference_c": 25.0}), seed);
    }
    wrong.none();
}

/// Bursts in a record whose N is not the model's, so that most of the noise differs from the expected noise.
#[test]
fn all_of_many_bursts_are_found() {
    let mut wrong = Wrong::default();
    for (factor, loud, seed) in [(1.0, 12.0, 1), (3.0, 12.0, 2), (0.4, 45.0, 3)] {
        let mut real = recording(&model(None), seed, SAMPLES);
        let mut stream = Stream::new(seed, StreamId { owner: 95, effect: 0, instance: 0 });
        let values = &mut real.channels[0].1;
        values.iter_mut().for_each(|value| *value *= factor);
        for burst in 0..12 {
            let from = burst * SAMPLES / 12 + (1_500.0 * stream.uniform()) as usize;
            let length = if burst % 3 == 0 { 500 } else { 60 };
            let louder = loud * factor * WHITE;
            values[from..from + length].iter_mut().for_each(|value| *value += louder * stream.normal());
        }
        let found = diagnosed(&real, &model(None));
        let own = found.diagnosis.causes.first().map_or(Vec::new(), |cause| list(cause, "accel_x"));
        let count = own.first().and_then(|own| own["intervals"].as_array().map(Vec::len));
        wrong.expect(names(&found) == ["bursts"] && count == Some(12), || {
            format!("{factor} {loud}: {count:?} {:?}", names(&found))
        });
    }
    wrong.none();
}

/// The transform represents the part before the first sample of white angle noise as the first sample itself.
#[test]
fn strong_quantization_noise_is_no_burst_at_the_ends() {
    let mut wrong = Wrong::default();
    for (times, seed) in [(10.0, 1), (40.0, 2), (200.0, 3)] {
        let effect = json!({"effect": "quantization_noise", "Q": times * WHITE / RATE_HZ});
        for seed in [seed, seed + 10] {
            expect_alone(&mut wrong, &effect, seed);
        }
    }
    wrong.none();
}

/// The effect of a filter on spikes, and on white noise whose variance changes, is not known before the filter is.
#[test]
fn what_lies_in_front_of_a_boxcar_does_not_hide_it() {
    let mut wrong = Wrong::default();
    let profile: Vec<[f64; 2]> =
        (0..=40).map(|k| f64::from(k) * 25.0).map(|at| [at, (1.2 * (at / 40.0).sin()).exp()]).collect();
    for (other, seed) in [
        (json!({"effect": "spikes", "rate_hz": 0.02, "amplitude": 1_000.0 * WHITE}), 1),
        (json!({"effect": "spikes", "rate_hz": 0.02, "amplitude": 4_000.0 * WHITE}), 2),
        (json!({"effect": "variance_change", "profile": profile}), 3),
    ] {
        let boxcar = json!({"effect": "moving_average", "window": 2, "white_behind": 1e-5});
        expect_both(&mut wrong, [&boxcar, &other], seed);
    }
    wrong.none();
}

/// Two spikes within a few samples look like a short burst.
#[test]
fn spikes_that_are_near_each_other_are_spikes() {
    let mut wrong = Wrong::default();
    for seed in 1..4 {
        let process = json!({"effect": "gauss_markov", "sigma": 4.0 * WHITE, "tc_s": 14.0 / RATE_HZ});
        let mut real = recording(&model(Some(&process)), seed, SAMPLES);
        let mut stream = Stream::new(seed, StreamId { owner: 96, effect: 0, instance: 0 });
        for spike in 0..60 {
            let at = spike * SAMPLES / 60 + (600.0 * stream.uniform()) as usize;
            let size = 20.0 * WHITE * (0.7 + 0.6 * stream.uniform());
            real.channels[0].1[at] += size;
            if spike % 8 == 0 {
                real.channels[0].1[at + 3] -= size;
            }
        }
        let found = diagnosed(&real, &model(None));
        let mut names = names(&found);
        names.sort_unstable();
        wrong.expect(names == ["gauss_markov", "spikes"], || format!("seed {seed}: {names:?}"));
    }
    wrong.none();
}

/// No noise enters behind most simulators' filters: a spectrum may fall by forty orders of magnitude.
#[test]
fn a_filter_with_nothing_behind_it_is_alone() {
    let mut wrong = Wrong::default();
    for (cutoff, order, seed) in [(0.03, 1, 1), (0.1, 2, 2), (0.1, 3, 3), (0.3, 2, 4), (0.05, 4, 5), (0.42, 4, 6)] {
        expect_alone(&mut wrong, &json!({"effect": "low_pass", "cutoff_hz": cutoff * RATE_HZ, "order": order}), seed);
    }
    for (window, seed) in [(2, 1), (3, 2), (5, 3), (12, 4), (25, 5)] {
        expect_alone(&mut wrong, &json!({"effect": "moving_average", "window": window}), seed);
    }
    wrong.none();
}

/// A dead band moves a piece of the distribution's middle onto one value; no distribution of tails does.
#[test]
fn a_band_in_which_the_sensor_does_not_move_is_no_heavy_tails() {
    let mut wrong = Wrong::default();
    for (half, seed) in [(0.16, 1), (0.31, 2), (0.6, 3)] {
        let mut real = recording(&model(None), seed, SAMPLES);
        let values = &mut real.channels[0].1;
        let middle = values.iter().sum::<f64>() / values.len() as f64;
        for value in values {
            let off = *value - middle;
            *value = middle + off.signum() * (off.abs() - half * WHITE).max(0.0);
        }
        let found = diagnosed(&real, &model(None)).diagnosis;
        let shows = found.remainder.is_some_and(|of| of.what.iter().any(|what| what.contains("one value")));
        wrong.expect(shows, || format!("{half}: {:?} {:?}", found.verdict, found.notes));
        let sure = found.causes.iter().any(|of| of.confidence > 0.9);
        wrong.expect(!sure, || format!("{half}: {}", found.summary));
    }
    wrong.none();
}

/// In a stretch in which the white noise almost vanishes, most of the signal is the rest of the noise.
#[test]
fn the_factor_of_a_quiet_stretch_is_that_of_the_white_noise() {
    let mut wrong = Wrong::default();
    for (factor, seed) in [(0.02, 1), (0.02, 2), (0.05, 3), (0.05, 4), (0.3, 5), (0.3, 6)] {
        let quiet = json!({"effect": "variance_change", "from_s": 363.5, "to_s": 466.8, "factor": factor});
        let found = found(&quiet, seed);
        let ends = found.diagnosis.causes.first().map(|of| of.uncertainty["accel_x"][0]["factor"].clone());
        let holds =
            ends.as_ref().is_some_and(|of| (of[0].as_f64() <= Some(factor)) && (Some(factor) <= of[1].as_f64()));
        wrong.expect(holds, || format!("{factor} seed {seed}: {:?} {ends:?}", names(&found)));
    }
    wrong.none();
}
