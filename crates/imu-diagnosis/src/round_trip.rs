//! Round trips: a simulated effect is found again, with its parameters inside their intervals.

use super::{Options, Recording, diagnose};
use imu_core::sample::Channel;
use imu_model::simulator::{SensorModel, Simulator};
use serde_json::{Value, json};
use std::collections::BTreeMap;

pub(super) const RATE_HZ: f64 = 40.0;
pub(super) const CHANNELS: [Channel; 3] = [Channel::AccelX, Channel::AccelY, Channel::AccelZ];

/// Returns a temperature that rises, falls and rises: no drift.
fn temperature_c(time_s: f64, length_s: f64) -> f64 {
    let turn = std::f64::consts::TAU * time_s / length_s;
    25.0 + 3.0 * (1.7 * turn).sin() + 2.0 * (3.1 * turn + 1.0).sin()
}

/// Returns a model of three accelerometer axes, of which the first and the last have the effect (all, if it belongs to
/// the triad).
pub(super) fn model(effect: Option<&Value>) -> SensorModel {
    let own = |index: usize| match effect {
        Some(effect) if index != 1 || of_triad(effect) => vec![effect.clone()],
        _ => Vec::new(),
    };
    let channel = |index: usize| {
        let bias = [0.3, -0.1, -9.8][index];
        json!({"N": 2e-3, "B": 4e-4, "K": 2e-5, "bias": bias, "effects": own(index)})
    };
    let channels: BTreeMap<&str, Value> =
        CHANNELS.iter().enumerate().map(|(index, of)| (of.name(), channel(index))).collect();
    let model = json!({"format": "vn100d-sensor-model-1", "name": "t", "rate_hz": RATE_HZ, "channels": channels});
    SensorModel::from_json(&model.to_string(), "test").unwrap()
}

fn of_triad(effect: &Value) -> bool {
    matches!(effect["effect"].as_str(), Some("held_samples" | "common_mode" | "timing"))
}

pub(super) fn recording(model: &SensorModel, seed: u64, samples: usize) -> Recording {
    let length_s = samples as f64 / RATE_HZ;
    let mut simulator = Simulator::new(model, seed, RATE_HZ, length_s)
        .unwrap()
        .with_temperature(move |time_s| temperature_c(time_s, length_s));
    let mut recording = Recording {
        rate_hz: RATE_HZ,
        channels: CHANNELS.iter().map(|channel| (*channel, Vec::new())).collect(),
        ..Recording::default()
    };
    let mut warmth = Vec::new();
    for index in 0..samples {
        let sample = simulator.next_sample().unwrap();
        for (channel, values) in &mut recording.channels {
            values.push(sample.values[*channel as usize]);
        }
        recording.missing.push(sample.lost);
        recording.time_s.push(sample.time_s);
        // As a VN-100 sends it.
        warmth.push((10.0 * temperature_c(index as f64 / RATE_HZ, length_s)).round() / 10.0);
    }
    recording.temperature_c = Some(warmth);
    recording
}

/// Counts of an effect's parameters inside their intervals and in total, and the failures.
#[derive(Debug, Default)]
struct Tally {
    inside: usize,
    of: usize,
    missed: Vec<String>,
    unnamed: Vec<String>,
}

fn tally(effect: &Value, seeds: std::ops::Range<u64>, samples: usize) -> Tally {
    let mut tally = Tally::default();
    let name = effect["effect"].as_str().unwrap();
    for seed in seeds {
        let real = recording(&model(Some(effect)), seed, samples);
        let outcome = diagnose(&real, &model(None), &Options::default()).unwrap();
        let causes = &outcome.diagnosis.causes;
        let Some(cause) = causes.first().filter(|cause| cause.effect.name() == name) else {
            let names: Vec<&str> = causes.iter().map(|cause| cause.effect.name()).collect();
            tally.unnamed.push(format!("seed {seed}: {names:?}"));
            continue;
        };
        if causes.len() > 1 {
            tally.unnamed.push(format!("seed {seed}: more: {:?}", causes[1].effect));
        }
        for (channel, known) in &cause.uncertainty {
            for (parameter, ends) in known[0].as_object().unwrap() {
                let truth = truth(effect, parameter);
                let [low, high] = [0, 1].map(|end: usize| ends[end].as_f64().unwrap());
                tally.of += 1;
                if (low..=high).contains(&truth) {
                    tally.inside += 1;
                } else {
                    tally.missed.push(format!("seed {seed} {channel} {parameter}: {truth} in {low:.6e}–{high:.6e}"));
                }
            }
        }
    }
    tally
}

fn truth(effect: &Value, parameter: &str) -> f64 {
    effect[parameter].as_f64().unwrap()
}

/// Returns the documented effects, at sizes that the record shows.
fn effects() -> Vec<Value> {
    vec![
        json!({"effect": "quantization_noise", "Q": 1.2e-4}),
        json!({"effect": "rate_ramp", "R": 1.2e-4}),
        json!({"effect": "gauss_markov", "sigma": 0.012, "tc_s": 4.0}),
        json!({"effect": "tone", "frequency_hz": 11.37, "amplitude": 0.003}),
        json!({"effect": "resonance", "frequency_hz": 8.3, "bandwidth_hz": 0.4, "sigma": 0.006}),
        json!({"effect": "temperature_bias", "per_c": 0.004, "reference_c": 25.0}),
        json!({"effect": "warm_up", "amplitude": -0.03, "tau_s": 60.0}),
        json!({"effect": "spikes", "rate_hz": 0.08, "amplitude": 0.12}),
        json!({"effect": "heavy_tails", "degrees_of_freedom": 6.0}),
        json!({"effect": "bias_step", "at_s": 231.7, "size": 0.02}),
        json!({"effect": "variance_change", "from_s": 100.0, "to_s": 220.0, "factor": 1.4}),
        json!({"effect": "variance_change", "per_c": 0.06, "reference_c": 25.0}),
        json!({"effect": "low_pass", "cutoff_hz": 11.0, "order": 2}),
        json!({"effect": "held_samples", "probability": 0.004}),
        json!({"effect": "common_mode", "sigma": 0.006}),
        json!({"effect": "timing", "jitter_s": 0.0012, "drop_probability": 0.003}),
        json!({"effect": "bursts", "intervals": [[70.0, 74.0], [200.0, 203.0]], "sigma": 0.04}),
    ]
}

#[test]
fn parameters_are_inside_their_intervals() {
    let (mut inside, mut of, mut missed) = (0, 0, Vec::new());
    for effect in effects() {
        let tally = tally(&effect, 0..1, 20_001);
        assert!(tally.unnamed.is_empty(), "{effect}: {:?}", tally.unnamed);
        (inside, of) = (inside + tally.inside, of + tally.of);
        missed.extend(tally.missed);
    }
    // 95 % of them, less the margin of a binomial's 0.1 %.
    let least = 0.95 * of as f64 - 3.1 * (0.95 * 0.05 * of as f64).sqrt();
    assert!(inside as f64 >= least, "{inside} of {of}: {missed:#?}");
}

/// Effects without a number that chance would blur.
#[test]
fn exact_parameters_are_found() {
    for (effect, share) in [
        (json!({"effect": "resolution", "step": 0.004}), 1e-4),
        (json!({"effect": "moving_average", "window": 5}), 0.0),
        (json!({"effect": "saturation", "low": -9.83, "high": 9.83}), 1e-9),
        (json!({"effect": "comb", "fundamental_hz": 3.17, "amplitudes": [0.004, 0.0, 0.003, 0.0025]}), 0.1),
        (json!({"effect": "variance_change", "profile": [[0.0, 1.0], [150.0, 1.5], [350.0, 0.8], [500.0, 1.0]]}), 0.0),
    ] {
        let real = recording(&model(Some(&effect)), 5, 20_000);
        let found = diagnose(&real, &model(None), &Options::default()).unwrap().diagnosis;
        let names: Vec<&str> = found.causes.iter().map(|cause| cause.effect.name()).collect();
        assert_eq!(names, [effect["effect"].as_str().unwrap()], "{found:#?}");
        for (channel, of) in &found.causes[0].parameters {
            for (parameter, value) in of.as_object().unwrap() {
                let Some(truth) = effect[parameter].as_f64() else { continue };
                let Some(value) = value.as_f64().filter(|value| value.abs() < 1e3) else { continue };
                let off = (value / truth - 1.0).abs();
                let other = effect["effect"] == "saturation" && off > 0.5;
                assert!(other || off <= share, "{channel} {parameter}: {value}, simulated {truth}");
            }
        }
        if effect["effect"] == "comb" {
            let of = &found.causes[0].parameters["accel_x"]["amplitudes"];
            for (index, truth) in [0.004, 0.0, 0.003, 0.0025].into_iter().enumerate() {
                assert!((of[index].as_f64().unwrap() - truth).abs() < 4e-4, "{of}");
            }
        }
    }
}

/// Measures the coverage of every interval over many seeds; `-- --ignored --nocapture` prints the table of
/// docs/validation.md.
#[test]
#[ignore = "minutes"]
fn coverage() {
    for effect in effects() {
        let seeds: u64 = std::env::var("SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(60);
        let tally = tally(&effect, 100..100 + seeds, 20_001);
        println!("{:18} {:3} of {:3} {:?}", effect["effect"].as_str().unwrap(), tally.inside, tally.of, tally.unnamed);
        let mut by: BTreeMap<String, usize> = BTreeMap::new();
        for missed in &tally.missed {
            *by.entry(missed.split(' ').nth(3).unwrap_or("").to_owned()).or_default() += 1;
        }
        println!("    {by:?} {:?}", tally.missed.iter().take(2).collect::<Vec<_>>());
    }
}

fn named(real: &Recording) -> (Vec<&'static str>, super::Verdict) {
    let diagnosis = diagnose(real, &model(None), &Options::default()).unwrap().diagnosis;
    (diagnosis.causes.iter().map(|cause| cause.effect.name()).collect(), diagnosis.verdict)
}

#[test]
fn a_filter_and_a_limit_behind_it_are_both_named_and_nothing_else() {
    for filter in
        [json!({"effect": "moving_average", "window": 5}), json!({"effect": "low_pass", "cutoff_hz": 7.0, "order": 2})]
    {
        let mut real = recording(&model(Some(&filter)), 5, 40_000);
        let name = filter["effect"].as_str().unwrap();
        // One value in forty exceeds it.
        let values = &mut real.channels[0].1;
        let mut sorted = values.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let limit = sorted[39_000];
        values.iter_mut().for_each(|value| *value = value.min(limit));
        let (mut causes, verdict) = named(&real);
        causes.sort_unstable();
        assert_eq!((causes, verdict), (vec![name, "saturation"], super::Verdict::Effects));
    }
}

#[test]
fn a_step_that_takes_its_time_is_a_step_alone() {
    let mut real = recording(&model(None), 6, 40_000);
    for (t, value) in real.channels[2].1.iter_mut().enumerate().skip(17_000) {
        // Ten standard deviations of the white noise in half a second, with an overshoot.
        let late = (t - 17_000) as f64 / 20.0;
        *value += 0.126 * (1.0 - (-3.0 * late).exp() * (1.0 + 0.5 * late) * (4.0 * late).cos());
    }
    assert_eq!(named(&real), (vec!["bias_step"], super::Verdict::Effects));
}

/// Corrupted samples are far out, and few: one of 70 standard deviations, twenty of 400, two hundred of 2000.
#[test]
fn samples_that_are_far_out_are_spikes_and_leave_n_alone() {
    for (count, far) in [(1, 70.0), (20, 400.0), (200, 2000.0)] {
        let mut real = recording(&model(None), 7, 20_000);
        let values = &mut real.channels[0].1;
        for spike in 0..count {
            values[500 + 97 * spike + spike * spike * 31 % 89] +=
                far * 0.0126 * if spike % 3 == 0 { 1.0 } else { -0.8 };
        }
        let outcome = diagnose(&real, &model(None), &Options::default()).unwrap();
        let names: Vec<&str> = outcome.diagnosis.causes.iter().map(|cause| cause.effect.name()).collect();
        // Sizes that take two values alone look like tails as well.
        assert_eq!(names.first(), Some(&"spikes"), "{count} of {far}: {:#?}", outcome.diagnosis.parameters);
        let n = outcome.augmented.channels[&Channel::AccelX].n;
        assert!((n / 2e-3 - 1.0).abs() < 0.03, "{count} of {far}: N {n}");
    }
}

/// Behind a steep filter without noise behind it the law cannot always separate N from its other terms; `imu-noise` can.
#[test]
fn an_n_that_is_off_is_reported_behind_a_steep_filter() {
    let filter = json!({"effect": "low_pass", "cutoff_hz": 3.855, "order": 3});
    let mut declared = model(None);
    declared.channels.values_mut().for_each(|of| of.n *= 1.2);
    for seed in 21..25 {
        let real = recording(&model(Some(&filter)), seed, 16_384);
        let outcome = diagnose(&real, &declared, &Options::default()).unwrap();
        let off = |channel: &&str| {
            let of = &outcome.diagnosis.parameters;
            of.iter().any(|of| of.channel == **channel && of.parameter == "N" && (of.capture / 2e-3 - 1.0).abs() < 0.06)
        };
        let missing: Vec<&str> = CHANNELS.map(Channel::name).into_iter().filter(|channel| !off(channel)).collect();
        let found = &outcome.diagnosis;
        assert!(missing.is_empty(), "seed {seed}, {missing:?}: {:#?} {:?}", found.parameters, found.causes);
    }
}
