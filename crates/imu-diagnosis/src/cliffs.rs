//! Cliffs: effects just beyond the usual sizes of models and records are named as well, and no other effect is named in their
//! place.

use super::report::Cause;
use super::round_trip::{RATE_HZ, model, recording};
use super::{Options, Outcome, Recording, Verdict, diagnose};
use imu_core::sample::Channel;
use imu_model::effects::{Stream, StreamId};
use imu_model::simulator::SensorModel;
use serde_json::{Value, json};

/// Standard deviation of the white noise of the tests' model, per sample.
pub(super) const WHITE: f64 = 0.012_649;

pub(super) fn diagnosed(real: &Recording, sim: &SensorModel) -> Outcome {
    diagnose(real, sim, &Options::default()).unwrap()
}

pub(super) fn names(outcome: &Outcome) -> Vec<&'static str> {
    outcome.diagnosis.causes.iter().map(|cause| cause.effect.name()).collect()
}

/// Returns the effects of a cause on a channel, one after the other.
pub(super) fn list(cause: &Cause, channel: &str) -> Vec<Value> {
    let of = cause.parameters.get(channel);
    of.map_or(Vec::new(), |of| of.as_array().cloned().unwrap_or_else(|| vec![of.clone()]))
}

/// Collects the failures of several cases, so that a failing test shows all of them.
#[derive(Debug, Default)]
pub(super) struct Wrong(Vec<String>);

impl Wrong {
    pub(super) fn expect(&mut self, right: bool, message: impl FnOnce() -> String) {
        if !right {
            self.0.push(message());
        }
    }
    pub(super) fn none(self) {
        assert!(self.0.is_empty(), "{:#?}", self.0);
    }
}

/// K differs by this much between sessions of one sensor, and B between data sheets.
#[test]
fn levels_that_are_far_too_small_in_the_model_are_parameters() {
    let mut wrong = Wrong::default();
    for (n, b, k) in [(1.0, 10.0, 1.0), (1.0, 1.0, 10.0), (1.0, 1.0, 30.0), (0.7, 3.0, 10.0)] {
        // A K that the record shows.
        let mut truth = model(None);
        truth.channels.values_mut().for_each(|of| (of.b, of.k) = (1e-3, 4e-4));
        for seed in 31..34 {
            let real = recording(&truth, seed, 40_000);
            let mut sim = truth.clone();
            sim.channels.values_mut().for_each(|of| (of.n, of.b, of.k) = (n * of.n, of.b / b, of.k / k));
            let found = diagnosed(&real, &sim);
            let right = names(&found).is_empty() && found.diagnosis.verdict == Verdict::Parameters;
            wrong.expect(right, || {
                format!("{n} 1/{b} 1/{k}, seed {seed}: {:?} {:?}", names(&found), found.diagnosis.verdict)
            });
        }
    }
    wrong.none();
}

#[test]
fn a_gauss_markov_process_beside_the_right_levels_is_still_named() {
    let mut wrong = Wrong::default();
    for (sigma, tc_s) in [(0.012, 4.0), (0.006, 15.0), (0.012, 40.0), (0.06, 15.0)] {
        let effect = json!({"effect": "gauss_markov", "sigma": sigma, "tc_s": tc_s});
        for seed in 41..43 {
            let real = recording(&model(Some(&effect)), seed, 40_000);
            let found = diagnosed(&real, &model(None));
            wrong.expect(names(&found) == ["gauss_markov"], || {
                format!("{sigma} {tc_s} s, seed {seed}: {:?}", names(&found))
            });
        }
    }
    wrong.none();
}

/// Adds a stream of steps of about two standard deviations of the white noise, at least ten seconds apart.
fn with_steps(real: &mut Recording, count: usize, seed: u64) {
    let mut stream = Stream::new(seed, StreamId { owner: 90, effect: 0, instance: 0 });
    let values = &mut real.channels[0].1;
    let part = values.len() / (count + 1);
    for step in 0..count {
        let at = (step + 1) * part + (0.5 * (stream.uniform() - 0.5) * part as f64) as usize;
        let size = WHITE * (1.5 + stream.uniform()) * if stream.uniform() < 0.5 { -1.0 } else { 1.0 };
        values[at..].iter_mut().for_each(|value| *value += size);
    }
}

#[test]
fn many_steps_are_steps() {
    let mut wrong = Wrong::default();
    for (count, seed) in [(7, 51), (9, 52), (15, 53), (15, 54), (9, 55), (7, 56)] {
        let mut real = recording(&model(None), seed, 65_536);
        with_steps(&mut real, count, seed);
        let found = diagnosed(&real, &model(None));
        let steps = found.diagnosis.causes.first().map_or(0, |cause| list(cause, "accel_x").len());
        let right =
            names(&found) == ["bias_step"] && found.diagnosis.verdict == Verdict::Effects && steps.abs_diff(count) <= 1;
        wrong
            .expect(right, || format!("{count}, seed {seed}: {steps} {:?} {:?}", names(&found), found.diagnosis.notes));
    }
    wrong.none();
}

#[test]
fn what_goes_to_and_fro_between_two_levels_is_no_chain_of_steps() {
    let mut wrong = Wrong::default();
    for (mean_s, seed) in [(150.0, 61), (60.0, 62), (20.0, 63), (5.0, 64)] {
        let mut real = recording(&model(None), seed, 65_536);
        let mut stream = Stream::new(seed, StreamId { owner: 91, effect: 0, instance: 0 });
        let mut up = false;
        for value in &mut real.channels[0].1 {
            up ^= stream.uniform() < 1.0 / (mean_s * RATE_HZ);
            *value += if up { 2.0 * WHITE } else { 0.0 };
        }
        let found = diagnosed(&real, &model(None));
        let right = names(&found).first() != Some(&"bias_step") && found.diagnosis.verdict == Verdict::UnknownEffect;
        wrong.expect(right, || format!("{mean_s} s: {:?} {:?}", names(&found), found.diagnosis.verdict));
    }
    wrong.none();
}

/// A slow and large effect would hide in B and K of the half that is learned from.
#[test]
fn what_a_slow_effect_closes_is_a_number() {
    let mut wrong = Wrong::default();
    for effect in [
        json!({"effect": "gauss_markov", "sigma": 20.0 * WHITE, "tc_s": 10.0}),
        json!({"effect": "gauss_markov", "sigma": 5.0 * WHITE, "tc_s": 30.0}),
        json!({"effect": "rate_ramp", "R": 6e-5}),
        json!({"effect": "warm_up", "amplitude": 0.05, "tau_s": 200.0}),
    ] {
        for seed in 81..83 {
            let real = recording(&model(Some(&effect)), seed, 65_536);
            let found = diagnosed(&real, &model(None));
            let closed = found.diagnosis.discrepancy.closed;
            // A warm-up is over in the second half.
            let gone = effect["effect"] == "warm_up" && closed.is_none();
            let right = gone || closed.is_some_and(|closed| (0.9..1.1).contains(&closed));
            wrong.expect(right, || format!("{effect}, seed {seed}: {closed:?} {:?}", names(&found)));
        }
    }
    // A correction of parameters alone closes no gap, because there is no gap to close.
    for seed in 85..88 {
        let mut sim = model(None);
        sim.channels.values_mut().for_each(|of| (of.n, of.b) = (0.8 * of.n, 1.3 * of.b));
        let found = diagnosed(&recording(&model(None), seed, 65_536), &sim).diagnosis;
        let right = found.verdict == Verdict::Parameters
            && found.discrepancy.closed.is_none()
            && found.discrepancy.before > 20.0 * found.discrepancy.floor
            && found.discrepancy.after_parameters < 3.0 * found.discrepancy.floor;
        wrong.expect(right, || format!("seed {seed}: {:?} {:?}", found.verdict, found.discrepancy));
    }
    wrong.none();
}

/// A model without `bias` is compared with a record that has gravity in it.
#[test]
fn a_corrected_model_of_limits_and_steps_stands_at_the_records_level() {
    let mut wrong = Wrong::default();
    let mut sim = model(None);
    sim.channels.values_mut().for_each(|of| of.bias = None);
    for effect in [
        json!({"effect": "saturation", "low": -9.8 - 1.2 * WHITE, "high": 0.3 + WHITE}),
        json!({"effect": "resolution", "step": 0.01}),
        json!({"effect": "bias_step", "at_s": 231.7, "size": 6.0 * WHITE}),
        json!({"effect": "warm_up", "amplitude": -0.3, "tau_s": 60.0}),
        json!({"effect": "rate_ramp", "R": 2e-4}),
        json!({"effect": "temperature_bias", "per_c": 0.02, "reference_c": 20.0}),
    ] {
        let real = recording(&model(Some(&effect)), 91, 20_000);
        let found = diagnosed(&real, &sim);
        let again = recording(&found.augmented, 92, 20_000);
        for channel in [Channel::AccelX, Channel::AccelZ] {
            let mean = |of: &Recording| of.values(channel).unwrap().iter().sum::<f64>() / 20_000.0;
            let share = |of: &Recording| {
                let at =
                    |value: &&f64| [-9.8 - 1.2 * WHITE, 0.3 + WHITE].iter().any(|limit| (*value - limit).abs() < 1e-9);
                of.values(channel).unwrap().iter().filter(at).count() as f64 / 20_000.0
            };
            // Independent slow noise moves each channel by about a tenth.
            let right = (mean(&real) - mean(&again)).abs() < 0.3 * WHITE && (share(&real) - share(&again)).abs() < 0.05;
            wrong.expect(right, || {
                let [from, to] = [mean(&real), mean(&again)];
                format!("{effect} {channel}: {from} {to}, {} {} {:?}", share(&real), share(&again), names(&found))
            });
        }
    }
    wrong.none();
}

/// Returns the amplitude of a sine in a channel's values.
fn amplitude_of(real: &Recording, channel: Channel, frequency_hz: f64) -> f64 {
    let values = real.values(channel).unwrap();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let (mut cosine, mut sine) = (0.0, 0.0);
    for (t, value) in values.iter().enumerate() {
        let (s, c) = (std::f64::consts::TAU * frequency_hz * t as f64 / RATE_HZ).sin_cos();
        (cosine, sine) = (cosine + c * (value - mean), sine + s * (value - mean));
    }
    2.0 * f64::hypot(cosine, sine) / values.len() as f64
}

/// The model has a tone in front of the filters, the record has it behind them. Either of the two may state the filter.
#[test]
fn a_tone_behind_a_filter_has_its_amplitude_in_front_of_it() {
    let mut wrong = Wrong::default();
    for (filter, frequency_hz, amplitude) in [
        (json!({"effect": "low_pass", "cutoff_hz": 3.0, "order": 1}), 6.03, 0.0146),
        (json!({"effect": "low_pass", "cutoff_hz": 5.0, "order": 2}), 9.37, 0.02),
        (json!({"effect": "moving_average", "window": 5}), 5.43, 0.02),
    ] {
        for (known, seed) in [(false, 71), (true, 72), (false, 73)] {
            let sim = if known { model(Some(&filter)) } else { model(None) };
            let mut truth = model(Some(&filter));
            let of = truth.channels.get_mut(&Channel::AccelX).unwrap();
            of.effects.push(std::sync::Arc::new(imu_model::effects::Tone { frequency_hz, amplitude }));
            let real = recording(&truth, seed, 65_536);
            let found = diagnosed(&real, &sim);
            let tone = found.diagnosis.causes.iter().find(|cause| cause.effect.name() == "tone");
            let own = tone.filter(|tone| list(tone, "accel_x").len() == 1);
            let ends = own.map(|tone| tone.uncertainty["accel_x"][0]["amplitude"].clone());
            let [low, high] = [0, 1].map(|end| ends.as_ref().and_then(|ends| ends[end].as_f64()).unwrap_or(f64::NAN));
            // Three standard errors, in several cases.
            let holds = (0.5 * (low + high) - amplitude).abs() < 0.77 * (high - low);
            let again = recording(&found.augmented, seed + 100, 65_536);
            let [seen, shown] = [&real, &again].map(|of| amplitude_of(of, Channel::AccelX, frequency_hz));
            let same = (shown / seen - 1.0).abs() < 0.05;
            wrong.expect(holds && same, || {
                let names = names(&found);
                let own = tone.map(|tone| list(tone, "accel_x"));
                format!("{filter} {known}: {amplitude} in {low:.5}–{high:.5}, {seen:.5} {shown:.5} {names:?} {own:?}")
            });
        }
    }
    wrong.none();
}

/// An air conditioner's cycle has a few periods in a record of half an hour.
#[test]
fn a_tone_of_a_few_periods_is_a_tone() {
    let mut wrong = Wrong::default();
    for (periods, amplitude) in [(3.4, 0.003), (5.3, 0.003), (10.3, 0.0025), (5.3, 0.03)] {
        for seed in 101..103 {
            let length_s = 65_536.0 / RATE_HZ;
            let frequency_hz = periods / length_s;
            let tone = json!({"effect": "tone", "frequency_hz": frequency_hz, "amplitude": amplitude});
            let found = diagnosed(&recording(&model(Some(&tone)), seed, 65_536), &model(None));
            let cause = found.diagnosis.causes.first().filter(|cause| cause.effect.name() == "tone");
            let near = |channel: &str| {
                let of = cause.map_or(Vec::new(), |cause| list(cause, channel));
                let number = |name: &str| of.first().and_then(|of| of[name].as_f64()).unwrap_or(f64::NAN);
                of.len() == 1
                    && (number("frequency_hz") * length_s - periods).abs() < 0.3
                    && (number("amplitude") / amplitude - 1.0).abs() < 0.4
            };
            let right = names(&found) == ["tone"] && ["accel_x", "accel_z"].into_iter().all(near);
            wrong.expect(right, || {
                let of = cause.map(|cause| cause.parameters.clone());
                format!("{periods} of {amplitude}, seed {seed}: {:?} {of:?}", names(&found))
            });
        }
    }
    wrong.none();
}

/// A sine that alternates with each sample is the fastest possible tone.
#[test]
fn a_pattern_of_odd_and_even_samples_is_a_tone() {
    for seed in 105..107 {
        let mut real = recording(&model(None), seed, 40_000);
        let up_and_down = real.channels[0].1.iter_mut().enumerate();
        up_and_down.for_each(|(t, value)| *value += if t % 2 == 0 { 0.004 } else { -0.004 });
        let found = diagnosed(&real, &model(None));
        assert_eq!((names(&found), found.diagnosis.verdict), (vec!["tone"], Verdict::Effects));
        let of = &found.diagnosis.causes[0].parameters["accel_x"];
        assert!((of["amplitude"].as_f64().unwrap() / 0.004 - 1.0).abs() < 0.08, "{of}");
    }
}

/// Slow noise has no periods, whatever the model states about it.
#[test]
fn slow_noise_alone_is_no_slow_tone() {
    let mut wrong = Wrong::default();
    for (b, k, off) in [(4e-4, 1e-3, 1.0), (2e-3, 1e-4, 1.0), (1e-3, 1e-3, 0.1), (4e-4, 1e-3, 0.6)] {
        let mut truth = model(None);
        truth.channels.values_mut().for_each(|of| (of.b, of.k) = (b, k));
        let mut sim = truth.clone();
        sim.channels.values_mut().for_each(|of| (of.b, of.k) = (off * b, off * k));
        for seed in 111..117 {
            let found = diagnosed(&recording(&truth, seed, 32_768), &sim);
            wrong.expect(names(&found).is_empty(), || format!("{b} {k} {off}, seed {seed}: {:?}", names(&found)));
        }
    }
    wrong.none();
}

/// If a filter passes nothing, the size of a tone in front of the filter cannot be determined.
#[test]
fn a_tone_that_a_filter_hardly_lets_pass_has_no_interval() {
    let filter = json!({"effect": "moving_average", "window": 4});
    let mut real = recording(&model(Some(&filter)), 121, 40_000);
    // The tone enters behind the filter, at the filter's own zero.
    for (t, value) in real.channels[0].1.iter_mut().enumerate() {
        *value += 0.003 * (std::f64::consts::TAU * 0.25 * t as f64 + 0.3).sin();
    }
    let found = diagnosed(&real, &model(Some(&filter))).diagnosis;
    let tone = found.causes.iter().find(|cause| cause.effect.name() == "tone").unwrap();
    let near = |of: &Value| (of["frequency_hz"].as_f64().unwrap() - 10.0).abs() < 1e-4;
    let own: Vec<usize> =
        list(tone, "accel_x").iter().enumerate().filter(|(_, of)| near(of)).map(|(at, _)| at).collect();
    let [own] = own[..] else { panic!("{tone:#?}") };
    assert_eq!(tone.uncertainty["accel_x"][own].get("amplitude"), None, "{tone:#?}");
    assert!(tone.uncertainty["accel_x"][own].get("frequency_hz").is_some());
}

/// F5: noise that is 1.6 to 50 times louder for a while, or from an instant on.
fn louder(from_s: f64, to_s: f64, factor: f64, seed: u64) -> super::Diagnosis {
    let effect = json!({"effect": "variance_change", "from_s": from_s, "to_s": to_s, "factor": factor});
    let samples = 64_000;
    diagnose(&recording(&model(Some(&effect)), seed, samples), &model(None), &Options::default()).unwrap().diagnosis
}

#[test]
fn noise_that_is_louder_for_a_while_is_that_alone() {
    let mut wrong = Vec::new();
    let mut of = 0;
    for (from_s, to_s) in [(400.0, 800.0), (300.0, 360.0), (900.0, 1600.0), (0.0, 500.0)] {
        for factor in [1.6, 2.5, 5.0, 15.0, 50.0] {
            of += 1;
            let found = louder(from_s, to_s, factor, of);
            let names: Vec<String> = found.causes.iter().map(|of| format!("{} {:?}", of.effect, of.channels)).collect();
            let right = names == ["variance_change [\"accel_x\", \"accel_z\"]"] && found.verdict == Verdict::Effects;
            let n_is_off = found.parameters.iter().any(|of| of.parameter == "N");
            if !right || n_is_off {
                let off: Vec<String> = found
                    .parameters
                    .iter()
                    .map(|of| format!("{} {} {:.2}", of.channel, of.parameter, of.ratio.unwrap_or_default()))
                    .collect();
                wrong.push(format!(
                    "{from_s} {to_s} x{factor}: {:?} {names:?} {off:?} {:?}",
                    found.verdict,
                    found
                        .notes
                        .iter()
                        .filter(|note| note.contains("remains") || note.contains("outside"))
                        .collect::<Vec<_>>()
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{} of {of}: {wrong:#?}", wrong.len());
}

/// Coarse sensors: a magnetometer's step is about two standard deviations of its noise.
#[test]
fn steps_wider_than_the_noise_are_a_resolution_alone() {
    let mut wrong = Wrong::default();
    for (wide, stated) in
        [(2.0, false), (3.0, false), (4.0, false), (6.0, false), (2.0, true), (3.0, true), (5.0, true)]
    {
        for seed in 121..123 {
            let mut truth = model(None);
            let resolution = imu_model::effects::Resolution { step: wide * WHITE };
            truth.channels.values_mut().for_each(|of| of.effects.push(std::sync::Arc::new(resolution)));
            let sim = if stated { truth.clone() } else { model(None) };
            let found = diagnosed(&recording(&truth, seed, 40_000), &sim);
            let expected = if stated { vec![] } else { vec!["resolution"] };
            let verdict = if stated { Verdict::NoGap } else { Verdict::Effects };
            let right = names(&found) == expected && found.diagnosis.verdict == verdict;
            wrong.expect(right, || {
                let of = &found.diagnosis;
                {
                    let evidence: Vec<&String> = of.causes.iter().flat_map(|cause| &cause.evidence).collect();
                    format!("{wide} {stated}, seed {seed}: {:?} {:?} {evidence:#?}", of.verdict, of.parameters)
                }
            });
        }
    }
    wrong.none();
}

#[test]
fn long_moving_averages_are_found() {
    let mut wrong = Wrong::default();
    for (window, seed) in [(19, 1), (22, 2), (30, 3), (31, 4), (48, 5), (60, 6)] {
        let effect = json!({"effect": "moving_average", "window": window, "white_behind": 5e-5});
        let found = diagnosed(&recording(&model(Some(&effect)), 400 + seed, 40_000), &model(None));
        let own = names(&found) == ["moving_average"]
            && found.diagnosis.causes[0].parameters["accel_x"]["window"] == window
            && found.diagnosis.verdict == Verdict::Effects;
        wrong.expect(own, || format!("{window}: {:?} {:#?}", found.diagnosis.verdict, found.diagnosis.causes));
    }
    wrong.none();
}

#[test]
fn a_leap_of_any_size_is_a_step() {
    for (size, seed) in [(1.0, 21), (19.6, 22), (126.0, 23), (1e4, 24)] {
        let mut real = recording(&model(None), seed, 40_000);
        real.channels[2].1[25_000..].iter_mut().for_each(|value| *value += size);
        let found = diagnosed(&real, &model(None));
        assert_eq!(names(&found), ["bias_step"], "{size}: {}", found.diagnosis.summary);
        assert_eq!(found.diagnosis.verdict, Verdict::Effects, "{size}");
        let cause = &found.diagnosis.causes[0];
        let found_size = cause.parameters["accel_z"]["size"].as_f64().unwrap();
        assert!((found_size - size).abs() < 0.01, "{size}: {found_size}");
        assert!(cause.confidence > 0.9, "{size}: {}", cause.confidence);
    }
}

/// A line that hops and sweeps: the bands of the whole record are not those of its second half.
#[test]
fn effects_that_do_not_close_the_second_half_leave_an_unknown_effect() {
    const SAMPLES: usize = 40_000;
    let mut wrong = Wrong::default();
    let hz = [5.1, 18.2, 3.0, 7.3, 13.3, 11.1, 5.1, 15.7];
    for (size, seed) in [(0.3, 1), (0.6, 2), (1.0, 3)] {
        let mut real = recording(&model(None), seed, SAMPLES);
        let mut cycles = 0.0;
        for (t, value) in real.channels[0].1.iter_mut().enumerate() {
            // Each part sweeps: a part of one frequency is a line that comes and goes.
            let part = (t * hz.len()) as f64 / SAMPLES as f64;
            cycles += (hz[part as usize] + 0.5 * part.fract()) / RATE_HZ;
            *value += size * WHITE * (std::f64::consts::TAU * cycles).sin();
        }
        let found = diagnosed(&real, &model(None)).diagnosis;
        let is_right = found.verdict == Verdict::UnknownEffect && found.causes.iter().all(|of| of.confidence < 0.6);
        wrong.expect(is_right, || format!("{size}: {:?} {:?} {:?}", found.verdict, found.discrepancy, found.remainder));
    }
    wrong.none();
}

/// K of another session is up to some tens of times the model's, not thousands of times.
#[test]
fn a_process_in_a_short_record_is_no_random_walk_of_thousands_of_times_the_size() {
    let effect = json!({"effect": "gauss_markov", "sigma": 0.28, "tc_s": 3.0});
    for seed in 51..54 {
        let real = recording(&model(Some(&effect)), seed, (26.0 * RATE_HZ) as usize);
        let found = diagnosed(&real, &model(None));
        assert_eq!(names(&found).first(), Some(&"gauss_markov"), "{seed}: {}", found.diagnosis.summary);
    }
}
