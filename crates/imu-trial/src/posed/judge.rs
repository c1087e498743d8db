//! Judgements: compares diagnoses of sealed cases beside poses with their keys.
//!
//! A cause that the untouched part has under the same model is not one of the case. Of a misalignment nothing may be named: beside poses
//! it is a matter of mounting.
//!
//! An interval is right in two senses. The numbers of a case are the untouched sensor's and the imposed ones. What the untouched sensor
//! has, another part of the recording shows with noise of its own (`held`): the difference of both has the root of both half widths' squares.
//! Or the same part shows it, with the same noise (`held_alone`), which asks no more than that the imposed number is found.

use super::impose::{ends, names};
use super::part::Own;
use crate::motion::score::{AS_UNTOUCHED, Judgement, is, judge as judge_moved};
use crate::motion::{Key, Kind, TrueEffect};
use imu_core::sample::Triad;
use serde_json::Value;

/// Judges a diagnosis: its JSON, or the reason for its absence. `own` is what the part shows untouched, `apart` what another part
/// of the recording shows, if there is one.
pub fn judge(key: &Key, report: Result<&Value, &str>, own: &Own, apart: Option<&Own>) -> Judgement {
    let mut judged = key.clone();
    judged.effects.retain(|of| of.kind != Kind::Misalignment);
    let new = report.map(|report| without(report, own));
    let mut judgement = judge_moved(&judged, new.as_ref().map_err(|reason| *reason), None);
    // What the untouched part does not explain is not the case's either.
    if judgement.verdict == own.verdict && (judgement.causes.is_empty() || judgement.verdict == "unknown_effect") {
        judgement.verdict = AS_UNTOUCHED.to_owned();
    }
    let held = |about: &Own, is_apart: bool| -> Vec<bool> {
        let causes = new.as_ref().ok().and_then(|of| of["causes"].as_array());
        let pairs = judged.effects.iter().flat_map(|of| causes.into_iter().flatten().map(move |cause| (of, cause)));
        pairs
            .filter(|(of, cause)| is(of, cause))
            .flat_map(|(of, cause)| intervals(of, cause, about, is_apart))
            .collect()
    };
    judgement.held = apart.map(|apart| held(apart, true)).unwrap_or_default();
    judgement.held_alone = held(own, false);
    judgement
}

/// Returns a report without the causes that the untouched part has.
fn without(report: &Value, own: &Own) -> Value {
    let mut report = report.clone();
    let same = |one: &Value, other: &Value| {
        ["effect", "sense", "triad", "channels"].iter().all(|key| one[*key] == other[*key])
    };
    if let Some(causes) = report["causes"].as_array_mut() {
        causes.retain(|cause| !own.named.iter().any(|of| same(of, cause)));
    }
    report
}

/// Returns whether each stated interval contains the sensor's number and the imposed one.
fn intervals(of: &TrueEffect, cause: &Value, about: &Own, is_apart: bool) -> Vec<bool> {
    let triad = if of.triad == Triad::Gyro.name() { Triad::Gyro } else { Triad::Accel };
    let Some(own) = about.of(triad).map(|numbers| numbers.of_kind(of.kind)) else { return Vec::new() };
    let judged = names(of.kind).iter().zip(own).zip(&of.numbers).filter_map(|((name, own), imposed)| {
        let ([low, high], own) = (ends(cause, &of.triad, name)?, own?);
        let half = (0.5 * (high - low)).hypot(if is_apart { own.half } else { 0.0 });
        Some((0.5 * (low + high) - own.value - imposed).abs() <= half)
    });
    judged.collect()
}

#[cfg(test)]
mod tests {
    use super::super::{Number, Numbers};
    use super::*;
    use serde_json::json;

    fn own(scale: f64) -> Own {
        let number = |value| Some(Number { value, half: 3e-4 });
        Own {
            gyro: Numbers { scale: [number(scale), number(0.0), None], ..Numbers::default() },
            verdict: "no_gap".to_owned(),
            named: vec![json!({"effect": "tone", "sense": "missing", "channels": ["gyro_x"]})],
            ..Own::default()
        }
    }

    fn key(kind: Kind) -> Key {
        let effect =
            TrueEffect { kind, triad: "gyro".into(), over_limit: 5.0, numbers: vec![0.01, 0.0, 0.0], limit: 2e-3 };
        Key { case: 0, rate_hz: 100.0, samples: 9000, own_clock: false, effects: vec![effect], salt: String::new() }
    }

    fn report(middle: f64, half: f64) -> Value {
        json!({"verdict": "effects", "causes": [
            {"effect": "tone", "sense": "missing", "channels": ["gyro_x"]},
            {"effect": "scale_factor", "sense": "missing", "triad": "gyro", "channels": ["gyro_x"],
             "uncertainty": {"gyro": {"x": [middle - half, middle + half], "y": [-1e-4, 1e-4]}}}]})
    }

    #[test]
    fn an_interval_is_judged_by_what_another_part_shows() {
        let (key, own, apart) = (key(Kind::ScaleFactor), own(0.002), own(0.0024));
        // 0.0124 in all, by the other part, whose half width is 0.0003.
        let found = judge(&key, Ok(&report(0.0119, 4.1e-4)), &own, Some(&apart));
        assert!(found.right_first && found.causes.len() == 1, "{found:?}");
        assert_eq!((found.held, found.held_alone), (vec![true, true], vec![true, true]));
        let found = judge(&key, Ok(&report(0.0118, 4e-4)), &own, Some(&apart));
        assert_eq!((found.held, found.held_alone), (vec![false, true], vec![true, true]));
        assert!(judge(&key, Ok(&report(0.0119, 4e-4)), &own, None).held.is_empty());
    }

    #[test]
    fn of_a_mounting_and_of_what_was_there_before_nothing_is_right() {
        let nothing = json!({"verdict": "no_gap", "causes": []});
        let found = judge(&key(Kind::Misalignment), Ok(&nothing), &own(0.0), None);
        assert!(found.kinds.is_empty() && found.verdict == AS_UNTOUCHED, "{found:?}");
        let found = judge(&key(Kind::Misalignment), Ok(&report(0.0119, 4e-4)), &own(0.0), None);
        assert!(found.causes.iter().any(|cause| !cause.right), "{found:?}");
    }
}
