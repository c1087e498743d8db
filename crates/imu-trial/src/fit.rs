//! Fits: whether a named cause is an effect of a case. The rules, which `docs/validation.md` repeats:
//!
//! 1. A cause is an effect if it has the effect's documented name and at least one of its channels. A `timing` has no
//!    channel.
//! 2. Identical laws count as right and are counted separately as equivalent:
//!    * `tone` for a comb, if a tone lies on every harmonic, within two widths of a Fourier bin;
//!    * `variance_change` in intervals that are louder for `bursts`, and `bursts` for a louder interval, where the times they
//!      have in common are at least half of all they cover: more white noise in a stretch has one law, whatever its name;
//!    * a `profile` for an interval or for a dependence on temperature, and two or more intervals for a profile: a profile can
//!      follow either. The other way round it is the wrong form, and no fit.
//! 3. Its sense has to be the true one: an effect that the model lacks, one that it has and the sensor does not, or one that both
//!    have differently. For an effect that both have at two places, each of the three is a true statement. A report that states
//!    no sense is read as stating that the model lacks the effect.
//! 4. For an effect outside the library, the effects of docs/effects.md that describe it are right, if they have the
//!    parameters that do.
//! 5. All other causes are spurious: also the right effect on none of its channels, a comb for a single tone, a single interval
//!    for a wave, a resonance for a tone.

use super::key::{Key, TrueEffect};
use super::kind::Kind;
use super::report::{Cause, entries};
use imu_model::EffectKind;
use serde_json::Value;

/// How well a cause matches an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fit {
    /// The cause is another effect.
    No,
    /// The cause has the same law under another name or form.
    Equivalent,
    /// The cause is the effect.
    Exact,
}

/// Maximum distance of a tone from its harmonic, in widths of a Fourier bin.
const BINS: f64 = 2.0;
/// Minimum common part of the time that two sets of intervals cover.
const OVERLAP: f64 = 0.5;

/// Returns whether `cause` is `truth`, an effect of the case with this key.
pub fn fit(truth: &TrueEffect, cause: &Cause, key: &Key) -> Fit {
    if !truth.sense.accepts(cause.sense) {
        return Fit::No;
    }
    if truth.kind == Kind::Timing {
        return if cause.kind() == Some(EffectKind::Timing) { Fit::Exact } else { Fit::No };
    }
    if !cause.channels.iter().any(|channel| truth.channels.contains(channel)) {
        return Fit::No;
    }
    let when = |holds: bool| if holds { Fit::Equivalent } else { Fit::No };
    let Some(named) = cause.kind() else { return Fit::No };
    match (truth.kind, named) {
        (Kind::VarianceInterval | Kind::VarianceProfile | Kind::VariancePerC, EffectKind::VarianceChange) => {
            variance(truth.kind, cause)
        }
        (Kind::Comb, EffectKind::Tone) => when(every_harmonic(truth, cause, key)),
        (Kind::Bursts, EffectKind::VarianceChange) => {
            let louder = cause.all_entries().all(|entry| entry["factor"].as_f64().is_some_and(|factor| factor > 1.0));
            when(louder && overlap(&intervals_of(truth, cause), &stated_intervals(cause)) >= OVERLAP)
        }
        (Kind::VarianceInterval, EffectKind::Bursts) => {
            let louder =
                truth.meant(cause.sense).values().any(|entry| entry["factor"].as_f64().is_some_and(|one| one > 1.0));
            when(louder && overlap(&intervals_of(truth, cause), &stated_intervals(cause)) >= OVERLAP)
        }
        (kind, named) if kind.effect() == Some(named) => Fit::Exact,
        (kind, named) if kind.described().contains(&named) => {
            let needed = kind.described_by();
            let has = |entry: &Value| needed.iter().any(|name| !entry[*name].is_null());
            when(needed.is_empty() || cause.all_entries().any(has))
        }
        _ => Fit::No,
    }
}

fn variance(kind: Kind, cause: &Cause) -> Fit {
    let has = |name: &str| cause.all_entries().any(|entry| !entry[name].is_null());
    let stated = if has("profile") {
        Kind::VarianceProfile
    } else if has("per_c") {
        Kind::VariancePerC
    } else {
        Kind::VarianceInterval
    };
    let several = || cause.channels.iter().any(|channel| cause.entries(channel).len() > 1);
    match (kind, stated) {
        (truth, stated) if truth == stated => Fit::Exact,
        (_, Kind::VarianceProfile) => Fit::Equivalent,
        (Kind::VarianceProfile, Kind::VarianceInterval) if several() => Fit::Equivalent,
        _ => Fit::No,
    }
}

/// Returns whether there is a tone on every harmonic, on the channels that both have.
fn every_harmonic(truth: &TrueEffect, cause: &Cause, key: &Key) -> bool {
    let width_hz = BINS * key.rate_hz / key.samples as f64;
    let shared = truth.channels.iter().filter(|channel| cause.channels.contains(channel));
    shared.into_iter().all(|channel| {
        let entry = &truth.meant(cause.sense)[channel];
        let fundamental_hz = entry["fundamental_hz"].as_f64().unwrap_or(f64::NAN);
        let count = entry["amplitudes"].as_array().map_or(0, Vec::len);
        let stated: Vec<f64> =
            cause.entries(channel).iter().filter_map(|entry| entry["frequency_hz"].as_f64()).collect();
        (1..=count).all(|harmonic| {
            stated.iter().any(|frequency_hz| (frequency_hz - harmonic as f64 * fundamental_hz).abs() <= width_hz)
        })
    })
}

/// Returns the true intervals of a cause's effect, s.
pub(super) fn intervals_of(truth: &TrueEffect, cause: &Cause) -> Vec<[f64; 2]> {
    truth.meant(cause.sense).values().next().map_or_else(Vec::new, |entry| intervals(entries(entry)))
}

/// Returns the intervals of a cause on its first channel that has any, s.
pub(super) fn stated_intervals(cause: &Cause) -> Vec<[f64; 2]> {
    let of = |channel: &String| intervals(cause.entries(channel));
    cause.channels.iter().map(of).find(|found| !found.is_empty()).unwrap_or_default()
}

pub(super) fn intervals(entries: &[Value]) -> Vec<[f64; 2]> {
    let pair = |value: &Value| Some([value[0].as_f64()?, value[1].as_f64()?]);
    let of = |entry: &Value| -> Vec<[f64; 2]> {
        if let Some(list) = entry["intervals"].as_array() {
            return list.iter().filter_map(pair).collect();
        }
        entry["from_s"].as_f64().zip(entry["to_s"].as_f64()).map(|(from, to)| [from, to]).into_iter().collect()
    };
    entries.iter().flat_map(of).collect()
}

/// Returns the time that two sets of intervals share, over the time that either covers.
fn overlap(one: &[[f64; 2]], other: &[[f64; 2]]) -> f64 {
    let [both, either] = covered(one, other);
    if either > 0.0 { both / either } else { 0.0 }
}

/// Returns the time that two sets of intervals share, and the time that either covers.
pub(super) fn covered(one: &[[f64; 2]], other: &[[f64; 2]]) -> [f64; 2] {
    let mut cuts: Vec<f64> = one.iter().chain(other).flatten().copied().collect();
    cuts.sort_by(f64::total_cmp);
    let (mut both, mut either) = (0.0, 0.0);
    for cut in cuts.windows(2) {
        let middle = 0.5 * (cut[0] + cut[1]);
        let within = |set: &[[f64; 2]]| set.iter().any(|[from, to]| (*from..*to).contains(&middle));
        match (within(one), within(other)) {
            (true, true) => (both, either) = (both + cut[1] - cut[0], either + cut[1] - cut[0]),
            (false, false) => {}
            _ => either += cut[1] - cut[0],
        }
    }
    [both, either]
}

/// Returns whether a cause does not count: stamps of arrival do not show whether the sensor's clock or the delivery
/// scatters.
pub(super) fn is_of_delivery(cause: &Cause, key: &Key) -> bool {
    cause.kind() == Some(EffectKind::Timing)
        && key.stamps.is_some_and(|stamps| stamps.deliver_late())
        && !key.effects.iter().any(|effect| effect.kind.needs_stamps())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::class::{Class, Sense};
    use serde_json::json;

    fn key() -> Key {
        Key {
            case: 0,
            class: Class::Single,
            rate_hz: 40.0,
            samples: 40_000,
            channels: vec!["gyro_x".to_owned(), "gyro_y".to_owned()],
            effects: Vec::new(),
            true_nbk: Default::default(),
            stamps: None,
            salt: String::new(),
        }
    }
    fn truth(kind: Kind, parameters: Value) -> TrueEffect {
        TrueEffect {
            kind,
            effect: kind.effect().map(|effect| effect.name().to_owned()),
            sense: Sense::Missing,
            size: 1.0,
            over_limit: 2.0,
            channels: vec!["gyro_x".to_owned()],
            parameters: [("gyro_x".to_owned(), parameters)].into(),
            declared: None,
        }
    }
    fn cause(effect: &str, channel: &str, parameters: Value) -> Cause {
        Cause {
            effect: effect.to_owned(),
            channels: vec![channel.to_owned()],
            confidence: None,
            parameters: json!({ channel: parameters }),
            sense: Sense::Missing,
            uncertainty: Value::Null,
            index: 0,
        }
    }

    #[test]
    fn a_cause_fits_by_name_and_channel() {
        let truth = truth(Kind::Tone, json!({"frequency_hz": 3.0, "amplitude": 1.0}));
        let of = |effect, channel| fit(&truth, &cause(effect, channel, json!({})), &key());
        assert_eq!(of("tone", "gyro_x"), Fit::Exact);
        assert_eq!(of("tone", "gyro_y"), Fit::No);
        assert_eq!(of("comb", "gyro_x"), Fit::No);
        assert_eq!(of("resonance", "gyro_x"), Fit::No);
    }

    #[test]
    fn a_cause_in_the_wrong_sense_is_wrong() {
        let tone = json!({"frequency_hz": 3.0, "amplitude": 1.0});
        let of = |sense, stated| {
            let truth = TrueEffect { sense, ..truth(Kind::Tone, tone.clone()) };
            fit(&truth, &Cause { sense: stated, ..cause("tone", "gyro_x", tone.clone()) }, &key())
        };
        assert_eq!(of(Sense::Superfluous, Sense::Missing), Fit::No);
        assert_eq!(of(Sense::Superfluous, Sense::Superfluous), Fit::Exact);
        assert_eq!(of(Sense::Size, Sense::Missing), Fit::No);
        assert_eq!(of(Sense::Elsewhere, Sense::Missing), Fit::Exact);
    }

    #[test]
    fn what_section_8_describes_is_an_answer_outside() {
        let of = |kind, effect, entry| fit(&truth(kind, json!({})), &cause(effect, "gyro_x", entry), &key());
        assert_eq!(of(Kind::ToneOnOff, "intermittent", json!({})), Fit::Equivalent);
        assert_eq!(of(Kind::ToneOnOff, "resonance", json!({})), Fit::No);
        assert_eq!(of(Kind::Hysteresis, "temperature_bias", json!({"per_c": 1.0})), Fit::No);
        assert_eq!(of(Kind::Hysteresis, "temperature_bias", json!({"per_c": 1.0, "play_c": 2.0})), Fit::Equivalent);
    }

    #[test]
    fn tones_on_every_harmonic_are_a_comb() {
        let truth = truth(Kind::Comb, json!({"fundamental_hz": 3.0, "amplitudes": [1.0, 1.0]}));
        let tones = |list: &[f64]| {
            let list: Vec<Value> = list.iter().map(|hz| json!({"frequency_hz": hz, "amplitude": 1.0})).collect();
            fit(&truth, &cause("tone", "gyro_x", list.into()), &key())
        };
        assert_eq!(tones(&[6.0005, 3.001]), Fit::Equivalent);
        assert_eq!(tones(&[3.0]), Fit::No);
        assert_eq!(tones(&[3.0, 6.1]), Fit::No);
    }

    #[test]
    fn a_louder_stretch_may_be_a_burst() {
        let interval =
            |factor: f64| truth(Kind::VarianceInterval, json!({"from_s": 100.0, "to_s": 200.0, "factor": factor}));
        let bursts = |from: f64, to: f64| cause("bursts", "gyro_x", json!({"intervals": [[from, to]], "sigma": 1.0}));
        assert_eq!(fit(&interval(1.5), &bursts(110.0, 205.0), &key()), Fit::Equivalent);
        assert_eq!(fit(&interval(0.5), &bursts(110.0, 205.0), &key()), Fit::No);
        assert_eq!(fit(&interval(1.5), &bursts(110.0, 120.0), &key()), Fit::No);
        let truth = truth(Kind::Bursts, json!({"intervals": [[10.0, 12.0], [50.0, 51.0]], "sigma": 1.0}));
        let list =
            json!([{"from_s": 10.1, "to_s": 12.0, "factor": 2.0}, {"from_s": 50.0, "to_s": 51.2, "factor": 3.0}]);
        assert_eq!(fit(&truth, &cause("variance_change", "gyro_x", list), &key()), Fit::Equivalent);
    }

    #[test]
    fn a_profile_follows_the_other_forms_and_not_the_other_way_round() {
        let wave = truth(Kind::VarianceProfile, json!({"profile": [[0.0, 1.0], [9.0, 2.0]]}));
        let warm = truth(Kind::VariancePerC, json!({"per_c": 0.1}));
        let named = |value| cause("variance_change", "gyro_x", value);
        let (profile, per_c) = (json!({"profile": [[0.0, 1.0], [9.0, 2.0]]}), json!({"per_c": 0.1}));
        let one = json!({"from_s": 0.0, "to_s": 2.0, "factor": 2.0});
        assert_eq!(fit(&wave, &named(profile.clone()), &key()), Fit::Exact);
        assert_eq!(fit(&warm, &named(profile), &key()), Fit::Equivalent);
        assert_eq!(fit(&wave, &named(per_c.clone()), &key()), Fit::No);
        assert_eq!(fit(&warm, &named(per_c), &key()), Fit::Exact);
        assert_eq!(fit(&wave, &named(one.clone()), &key()), Fit::No);
        assert_eq!(fit(&wave, &named(json!([one, one])), &key()), Fit::Equivalent);
    }
}
