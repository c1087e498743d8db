//! Cliffs: what lies just beyond the sizes that models and records usually have is named as well, and nothing in its place.

use super::round_trip::{model, recording};
use super::{Options, Outcome, Recording, Verdict, diagnose};
use crate::simulator::SensorModel;
use serde_json::json;

fn diagnosed(real: &Recording, sim: &SensorModel) -> Outcome {
    diagnose(real, sim, &Options::default()).unwrap()
}

fn names(outcome: &Outcome) -> Vec<&'static str> {
    outcome.diagnosis.causes.iter().map(|cause| cause.effect).collect()
}

/// Collects what goes wrong in several cases, so that a failure shows all of it.
#[derive(Debug, Default)]
struct Wrong(Vec<String>);

impl Wrong {
    fn expect(&mut self, right: bool, said: impl FnOnce() -> String) {
        if !right {
            self.0.push(said());
        }
    }
    fn none(self) {
        assert!(self.0.is_empty(), "{:#?}", self.0);
    }
}

/// Sessions of one sensor differ by as much in K, and data sheets in B.
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
