//! Judgements: one case's diagnosis compared with its key.

use super::again::Again;
use super::class::{Class, Sense};
use super::compare::{compare, intervals_held, locate};
use super::fit::{Fit, fit, is_of_delivery};
use super::key::{Key, TrueEffect};
use super::kind::Kind;
use super::limit::ABOVE;
use super::place::{false_places, is_placed};
use super::report::{Cause, Of, Place, Report};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// The result of a case: its diagnosis or the reason for its absence, and the part of the gap that the true effects
/// close, if measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The diagnosis, or the sentence of the refusal.
    pub report: Result<Report, String>,
    /// For an existing recording: the diagnosis of the same channels without imposed effects.
    pub own: Option<Report>,
    /// The part that the model with the true effects closes, with the same score as `closed`.
    pub closed_by_truth: Option<f64>,
    /// The result on unseen data, if measured.
    pub again: Option<Again>,
}

/// A case's effect in the diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Found {
    /// The kind.
    pub kind: Kind,
    /// How sensor and model differ in the effect.
    pub sense: Sense,
    /// The size over the limit.
    pub over_limit: f64,
    /// Whether the effect was named.
    pub named: bool,
    /// Whether it was named under another name or form of the same law.
    pub equivalent: bool,
    /// Whether exactly the effect's channels were named; none if it was not named, and for an effect without channel.
    pub channels_exact: Option<bool>,
    /// Whether `where` has exactly its places; none if it was not named, and for an effect without channel.
    pub placed: Option<bool>,
    /// Number of 95 % intervals of its parameters that contain the truth, and number of intervals.
    pub intervals: [usize; 2],
    /// Absolute errors of place by their kind (`frequency_bins`, `at_s`, `edge_s`).
    pub location: BTreeMap<&'static str, Vec<f64>>,
    /// Relative errors of parameters.
    pub parameters: BTreeMap<String, Vec<f64>>,
}

/// A judged cause.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Named {
    /// The documented name.
    pub effect: String,
    /// The cause's channels.
    pub channels: Vec<String>,
    /// The stated sense.
    pub sense: Sense,
    /// The stated confidence.
    pub confidence: Option<f64>,
    /// Whether the cause is one of the case's effects.
    pub right: bool,
}

/// A judged case.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judgement {
    /// The case's number.
    pub case: usize,
    /// The case's class.
    pub class: Class,
    /// Whether all effects are large enough to count: 1.5 times the limit or above.
    pub counts: bool,
    /// The verdict; `refused` if there was none.
    pub verdict: String,
    /// The reason for the refusal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refusal: Option<String>,
    /// The named causes, strongest first, without those of the recording itself.
    pub causes: Vec<Named>,
    /// Number of causes that are the recording's own, because they are also named without imposed effects.
    pub own: usize,
    /// Whether the recording without imposed effects is reported as unknown: then that verdict carries no information
    /// about the case.
    pub own_unknown: bool,
    /// The verdict on the recording without imposed effects, and the number of causes named in it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub control: Option<(String, usize)>,
    /// The case's effects.
    pub effects: Vec<Found>,
    /// Places at which the case has no effect; none if that cannot be determined.
    pub false_places: Option<usize>,
    /// The part of the gap that is reproduced without a name.
    pub remainder: Option<f64>,
    /// Part of the gap that was closed.
    pub closed: Option<f64>,
    /// The 95 % interval of the closed part.
    pub closed_ci95: Option<[f64; 2]>,
    /// The part that the true effects close.
    pub closed_by_truth: Option<f64>,
    /// The results on unseen data.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub again: Option<Again>,
}

impl Judgement {
    /// Returns whether the first cause is one of the case's effects.
    pub fn right_first(&self) -> bool {
        self.causes.first().is_some_and(|cause| cause.right)
    }

    /// Returns whether the case's causes count in the rates over all classes: its effects are large enough, or it has
    /// no effect to name.
    pub fn is_of_account(&self) -> bool {
        self.counts || self.class.is_silent()
    }

    /// Returns whether a cause was named that is not an effect of the case.
    pub fn spurious(&self) -> bool {
        self.causes.iter().any(|cause| !cause.right)
    }

    /// Returns whether the verdict is `unknown_effect`.
    pub fn unknown(&self) -> bool {
        self.verdict == "unknown_effect"
    }

    /// Returns, for an effect outside the library, whether the verdict is unknown, the effect is reproduced and
    /// reported as nameless, or it is named by an effect that describes it.
    pub fn answered(&self) -> bool {
        self.unknown() || self.remainder.is_some() || self.causes.iter().any(|cause| cause.right)
    }

    /// Returns whether no cause is named.
    pub fn silent(&self) -> bool {
        self.causes.is_empty() && self.verdict != "refused"
    }

    /// Returns whether every effect was named.
    pub fn all_found(&self) -> bool {
        self.verdict != "refused" && self.effects.iter().all(|effect| effect.named)
    }

    /// Returns whether every effect was named, no other cause was named, and no gap remains.
    pub fn exactly(&self) -> bool {
        self.all_found() && !self.spurious() && (self.verdict == "effects" || self.own_unknown)
    }
}

/// Judges an answer.
///
/// For an existing recording, only the changes by the imposed effects are judged. A cause is the recording's own on
/// channels that also have a cause of this name without imposed effects, unless an effect of the case is on them. A
/// cause without remaining channels is neither right nor spurious.
pub fn judge(key: &Key, answer: &Answer) -> Judgement {
    let (all, verdict, refusal) = match &answer.report {
        Ok(report) => (report.causes.clone(), report.verdict.clone(), None),
        Err(refusal) => (Vec::new(), "refused".to_owned(), Some(refusal.clone())),
    };
    let (aside, all): (Vec<Cause>, Vec<Cause>) = all.into_iter().partition(|cause| is_of_delivery(cause, key));
    let named_in_all = all.len();
    let causes: Vec<Cause> = match &answer.own {
        Some(own) => all.into_iter().filter_map(|cause| beyond(own, cause, key)).collect(),
        None => all,
    };
    let report = answer.report.as_ref().ok();
    let is_aside = |place: &&Place| aside.iter().any(|cause| place.of == Of::Cause(cause.index));
    let places: Vec<Place> =
        report.iter().flat_map(|report| &report.places).filter(|place| !is_aside(place)).cloned().collect();
    let named = |cause: &Cause| Named {
        effect: cause.effect.clone(),
        channels: cause.channels.clone(),
        sense: cause.sense,
        confidence: cause.confidence,
        right: key.effects.iter().any(|truth| fit(truth, cause, key) > Fit::No),
    };
    Judgement {
        case: key.case,
        class: key.class,
        counts: key.effects.iter().all(|effect| effect.over_limit >= ABOVE),
        verdict,
        refusal,
        own: named_in_all - causes.len(),
        own_unknown: answer.own.as_ref().is_some_and(|own| own.verdict == "unknown_effect"),
        control: answer.own.as_ref().map(|own| (own.verdict.clone(), own.causes.len())),
        causes: causes.iter().map(named).collect(),
        effects: key.effects.iter().map(|truth| found(truth, &causes, &places, key)).collect(),
        // The places of the recording's own effects are not known.
        false_places: report.filter(|_| answer.own.is_none()).map(|_| false_places(&places, key).count()),
        remainder: report.and_then(|report| report.remainder),
        closed: report.and_then(|report| report.closed),
        closed_ci95: report.and_then(|report| report.closed_ci95),
        closed_by_truth: answer.closed_by_truth,
        again: answer.again,
    }
}

/// Returns a cause without the channels on which the recording itself has it; `None` if no channel is left.
fn beyond(own: &Report, mut cause: Cause, key: &Key) -> Option<Cause> {
    let imposed = |channel: &String| {
        let on = |truth: &&TrueEffect| truth.channels.contains(channel);
        let one = Cause { channels: vec![channel.clone()], ..cause.clone() };
        key.effects.iter().filter(on).any(|truth| fit(truth, &one, key) > Fit::No)
    };
    let of_itself = |channel: &String| {
        own.causes.iter().any(|of| of.effect == cause.effect && of.channels.contains(channel)) && !imposed(channel)
    };
    let left: Vec<String> = cause.channels.iter().filter(|channel| !of_itself(channel)).cloned().collect();
    let was_empty = cause.channels.is_empty();
    cause.channels = left;
    (was_empty || !cause.channels.is_empty()).then_some(cause)
}

fn found(truth: &TrueEffect, causes: &[Cause], places: &[Place], key: &Key) -> Found {
    let fits: Vec<(Fit, &Cause)> =
        causes.iter().map(|cause| (fit(truth, cause, key), cause)).filter(|(fit, _)| *fit > Fit::No).collect();
    let best = fits.iter().map(|(fit, _)| *fit).max().unwrap_or(Fit::No);
    let declared: BTreeSet<&String> = fits.iter().flat_map(|(_, cause)| &cause.channels).collect();
    let channels_exact = declared == truth.channels.iter().collect();
    let mut found = Found {
        kind: truth.kind,
        sense: truth.sense,
        over_limit: truth.over_limit,
        named: best > Fit::No,
        equivalent: best == Fit::Equivalent,
        channels_exact: (best > Fit::No && !truth.kind.needs_stamps()).then_some(channels_exact),
        placed: fits.first().and_then(|(_, cause)| is_placed(truth, cause, places, key)),
        intervals: [0; 2],
        location: BTreeMap::new(),
        parameters: BTreeMap::new(),
    };
    for (_, cause) in fits {
        locate(truth, cause, key, &mut found.location);
        if best == Fit::Exact && cause.kind() == truth.kind.effect() {
            compare(truth, cause, key, &mut found.parameters);
            let [held, of] = intervals_held(truth, cause, key);
            found.intervals = [found.intervals[0] + held, found.intervals[1] + of];
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Case;
    use crate::recipe::Recipe;
    use serde_json::{Value, json};

    fn key(kinds: &[Kind]) -> Key {
        (0..)
            .map(|case| Case::draw(17, case, kinds).unwrap().key())
            .find(|key| key.effects.iter().all(|one| one.over_limit > 2.0))
            .unwrap()
    }
    fn report(verdict: &str, causes: Value) -> Answer {
        let report = Report::of(
            &json!({"verdict": verdict, "causes": causes, "discrepancy": {"closed": 0.9, "closed_ci95": [0.8, 0.95]}}),
        );
        Answer { report: Ok(report.unwrap()), own: None, closed_by_truth: Some(0.92), again: None }
    }
    fn truth(key: &Key, at: usize) -> Value {
        let effect = &key.effects[at];
        json!({"effect": effect.effect, "channels": effect.channels, "confidence": 0.9, "parameters": effect.parameters})
    }

    #[test]
    fn the_truth_itself_is_right_in_everything() {
        for kind in Kind::LIBRARY.iter().copied() {
            let key = key(&[kind]);
            let judged = judge(&key, &report("effects", json!([truth(&key, 0)])));
            assert!(judged.right_first() && judged.exactly() && judged.counts, "{kind}");
            assert!(judged.effects[0].channels_exact != Some(false) && !judged.effects[0].equivalent, "{kind}");
            assert!(judged.effects[0].location.values().flatten().all(|error| *error < 1e-9), "{kind}");
            assert!(judged.effects[0].placed != Some(true), "{kind}: no place was stated");
            assert!(judged.effects[0].parameters.values().flatten().all(|error| *error < 1e-9), "{kind}");
        }
    }

    #[test]
    fn errors_of_a_tone_are_in_bins_and_in_parts_of_its_amplitude() {
        let key = key(&[Kind::Tone]);
        let mut cause = truth(&key, 0);
        let channel = key.effects[0].channels[0].clone();
        let entry = &mut cause["parameters"][&channel];
        entry["frequency_hz"] = json!(entry["frequency_hz"].as_f64().unwrap() + 0.3 * key.rate_hz / key.samples as f64);
        entry["amplitude"] = json!(entry["amplitude"].as_f64().unwrap() * 1.1);
        let judged = judge(&key, &report("effects", json!([cause])));
        let worst = |errors: &[f64]| errors.iter().copied().fold(0.0, f64::max);
        assert!((worst(&judged.effects[0].location["frequency_bins"]) - 0.3).abs() < 1e-6);
        assert!((worst(&judged.effects[0].parameters["amplitude"]) - 0.1).abs() < 1e-6);
    }

    #[test]
    fn what_is_missing_wrong_or_too_much_is_seen() {
        let key = key(&[Kind::Tone, Kind::Spikes]);
        let both = json!([truth(&key, 0), truth(&key, 1)]);
        assert!(judge(&key, &report("effects", both.clone())).exactly());
        assert!(!judge(&key, &report("unknown_effect", both)).exactly());
        let one = judge(&key, &report("effects", json!([truth(&key, 1)])));
        assert!(one.right_first() && !one.all_found() && !one.spurious());
        let extra = json!({"effect": "rate_ramp", "channels": key.channels, "confidence": 0.5, "parameters": {}});
        let more = judge(&key, &report("effects", json!([extra, truth(&key, 0), truth(&key, 1)])));
        assert!(more.all_found() && more.spurious() && !more.right_first() && !more.exactly());
        let refused =
            judge(&key, &Answer { report: Err("no".to_owned()), own: None, closed_by_truth: None, again: None });
        assert!(!refused.right_first() && !refused.all_found() && refused.verdict == "refused");
    }

    #[test]
    fn what_a_recording_has_of_itself_is_neither_right_nor_spurious() {
        let key = key(&[Kind::Spikes]);
        let imposed = key.effects[0].channels[0].clone();
        let of = |effect: &str, channels: &[&str]| json!({"effect": effect, "channels": channels, "confidence": 0.9, "parameters": {}});
        let own = report("unknown_effect", json!([of("tone", &["yaw"]), of("spikes", &["pitch"])])).report.ok();
        let mut named = truth(&key, 0);
        named["channels"].as_array_mut().unwrap().push(json!("pitch"));
        let causes = json!([of("tone", &["yaw"]), named, of("rate_ramp", &["yaw"]), of("tone", &["yaw", &imposed])]);
        let judged = judge(&key, &Answer { own, ..report("unknown_effect", causes) });
        // The line on yaw and the spikes on pitch are the recording's own; the ramp and the line on the imposed channel
        // are not.
        assert_eq!((judged.own, judged.own_unknown), (1, true));
        let left: Vec<(&str, bool)> = judged.causes.iter().map(|of| (of.effect.as_str(), of.right)).collect();
        assert_eq!(left, [("spikes", true), ("rate_ramp", false), ("tone", false)]);
        assert!(judged.right_first() && judged.effects[0].channels_exact == Some(true));
        assert_eq!(judged.causes[2].channels, [imposed]);
    }

    #[test]
    fn a_sense_that_is_wrong_makes_a_cause_wrong() {
        let key = Case::make(3, 1, &Recipe::of_model(Kind::Tone, Sense::Superfluous), Some(20_000)).unwrap().key();
        let mut cause = truth(&key, 0);
        assert!(!judge(&key, &report("effects", json!([cause.clone()]))).right_first());
        cause["sense"] = json!("superfluous");
        let judged = judge(&key, &report("effects", json!([cause])));
        assert!(judged.right_first() && judged.exactly());
    }

    #[test]
    fn a_cause_that_the_sensor_lacks_is_compared_with_the_models_own() {
        let key = Case::make(3, 1, &Recipe::of_model(Kind::Tone, Sense::Elsewhere), Some(20_000)).unwrap().key();
        let mut cause = truth(&key, 0);
        cause["sense"] = json!("superfluous");
        let wrong = judge(&key, &report("effects", json!([cause.clone()]))).effects.remove(0);
        assert!(wrong.location["frequency_bins"][0] > 4.0 && wrong.parameters.is_empty());
        cause["parameters"] = json!(key.effects[0].declared);
        let right = judge(&key, &report("effects", json!([cause]))).effects.remove(0);
        assert!(right.location["frequency_bins"][0] < 1e-9 && right.parameters["amplitude"][0] < 1e-9);
    }

    #[test]
    fn a_timing_that_is_the_deliverys_is_set_aside() {
        let keys = (0..).map(|case| Case::make(17, case, &Recipe::lacking(&[Kind::Tone]), Some(20_000)).unwrap().key());
        let key = keys.into_iter().find(|key| key.stamps.is_some_and(|stamps| stamps.deliver_late())).unwrap();
        let timing = json!({"effect": "timing", "channels": [], "confidence": 0.9, "parameters": {}});
        let mut answer = report("effects", json!([timing, truth(&key, 0)]));
        let place = |of| Place { channel: "temperature".to_owned(), of, band_hz: None, time_s: None };
        answer.report.as_mut().unwrap().places = vec![place(Of::Cause(0)), place(Of::Cause(1))];
        let judged = judge(&key, &answer);
        assert!(judged.exactly());
        assert_eq!(judged.false_places, Some(1));
    }

    #[test]
    fn intervals_hold_the_truth_or_do_not() {
        let key = key(&[Kind::Tone]);
        let mut cause = truth(&key, 0);
        let channel = key.effects[0].channels[0].clone();
        let hz = key.effects[0].parameters[&channel]["frequency_hz"].as_f64().unwrap();
        cause["uncertainty"] = json!({ &channel: [{"frequency_hz": [hz - 1.0, hz + 1.0], "amplitude": [0.0, 0.0]}] });
        assert_eq!(judge(&key, &report("effects", json!([cause]))).effects[0].intervals, [1, 2]);
    }

    #[test]
    fn channels_are_exact_or_not() {
        let key = key(&[Kind::Spikes]);
        let mut cause = truth(&key, 0);
        cause["channels"] = json!([key.effects[0].channels[0].clone(), "yaw"]);
        let judged = judge(&key, &report("effects", json!([cause])));
        assert_eq!(judged.effects[0].channels_exact, Some(false));
    }
}
