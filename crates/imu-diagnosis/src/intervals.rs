//! Intervals: 95 % intervals of found effects hold the truth about as often as stated, for each parameter.

use super::round_trip::{model, recording};
use super::{Options, diagnose};
use serde_json::{Value, json};
use std::collections::BTreeMap;

const SAMPLES: usize = 32_000;
const CHANNELS: [&str; 2] = ["accel_x", "accel_z"];

/// Returns effects at sizes that are found, and far larger ones.
fn cases() -> Vec<Value> {
    let mut all = Vec::new();
    for larger in [1.0, 12.0] {
        all.extend([
            json!({"effect": "tone", "frequency_hz": 11.37, "amplitude": 0.002 * larger}),
            json!({"effect": "resonance", "frequency_hz": 8.3, "bandwidth_hz": 0.4, "sigma": 0.006 * larger}),
            json!({"effect": "gauss_markov", "sigma": 0.008 * larger, "tc_s": 3.0}),
            json!({"effect": "quantization_noise", "Q": 1.5e-4 * larger}),
            json!({"effect": "rate_ramp", "R": 1e-5 * larger}),
            json!({"effect": "warm_up", "amplitude": 0.02 * larger, "tau_s": 47.0}),
            json!({"effect": "bias_step", "at_s": 400.013, "size": 0.012 * larger}),
            json!({"effect": "variance_change", "from_s": 300.01, "to_s": 421.3, "factor": 1.0 + 0.4 * larger}),
            json!({"effect": "variance_change", "per_c": 0.03 * larger, "reference_c": 25.0}),
            json!({"effect": "bursts", "intervals": [[300.0, 302.0], [500.0, 501.5]], "sigma": 0.05 * larger}),
            json!({"effect": "spikes", "rate_hz": 0.06, "amplitude": 0.15 * larger}),
            json!({"effect": "temperature_bias", "per_c": 0.003 * larger, "reference_c": 25.0}),
        ]);
    }
    all.extend([
        json!({"effect": "variance_change", "from_s": 300.01, "to_s": 421.3, "factor": 0.5}),
        json!({"effect": "low_pass", "cutoff_hz": 7.0, "order": 2, "white_behind": 1e-4}),
        json!({"effect": "low_pass", "cutoff_hz": 3.0, "order": 1, "white_behind": 1e-4}),
        json!({"effect": "heavy_tails", "degrees_of_freedom": 4.0}),
        json!({"effect": "heavy_tails", "degrees_of_freedom": 12.0}),
        json!({"effect": "held_samples", "probability": 0.1}),
        json!({"effect": "common_mode", "sigma": 0.006}),
        json!({"effect": "common_mode", "sigma": 0.04}),
    ]);
    all
}

#[test]
fn intervals_hold_the_truth_about_as_often_as_they_state() {
    const SEEDS: u64 = 6;
    let mut held: BTreeMap<(String, String), [usize; 2]> = BTreeMap::new();
    let mut out = Vec::new();
    for (index, effect) in cases().into_iter().enumerate() {
        for seed in 0..SEEDS {
            let real = recording(&model(Some(&effect)), 1000 * index as u64 + seed, SAMPLES);
            let found = diagnose(&real, &model(None), &Options::default()).unwrap().diagnosis;
            let Some(cause) = found.causes.iter().find(|of| effect["effect"] == of.effect.name()) else { continue };
            for channel in CHANNELS {
                for (name, ends) in
                    cause.uncertainty.get(channel).into_iter().flat_map(|of| of[0].as_object().cloned()).flatten()
                {
                    // A size may be stated with the other sign for all channels of a source; the temperature at which
                    // an effect vanishes is free.
                    let truth = effect[&name].as_f64().filter(|_| name != "reference_c");
                    let Some((truth, (low, high))) = truth.zip(ends[0].as_f64().zip(ends[1].as_f64())) else {
                        continue;
                    };
                    let own = held.entry((effect["effect"].to_string(), name.clone())).or_default();
                    let inside = (low..=high).contains(&truth) || (low..=high).contains(&-truth);
                    own[0] += usize::from(inside);
                    own[1] += 1;
                    if !inside {
                        out.push(format!("{effect} {name} seed {seed} {channel}: [{low}, {high}]"));
                    }
                }
            }
        }
    }
    let (inside, all) = held.values().fold((0, 0), |(a, b), [c, d]| (a + c, b + d));
    assert!(all > 400 && inside * 100 >= 92 * all, "{inside} of {all}: {held:#?}\n{out:#?}");
    // 95 % of some dozen rows, less the variation that chance gives to 30 rows.
    let bad: Vec<_> = held.iter().filter(|(_, [inside, all])| *inside * 100 < 78 * all).collect();
    assert!(bad.is_empty(), "{inside} of {all}: {bad:#?}\n{out:#?}");
}
