//! Scores: compares diagnoses of sealed cases with a motion with their keys.

use super::case::{Key, TrueEffect};
use super::impose::full_scale;
use super::kind::Kind;
use crate::detection::{self, Limit};
use crate::interval::Rate;
use imu_core::sample::Triad;
use imu_model::EffectKind;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;

/// From this multiple of the bound's size on, an effect has to be right.
const CLEAR: f64 = 3.0;
/// The share of the true effects' closed part that must be closed.
const NEARLY: f64 = 0.9;
/// The verdict of a record beside poses in which a diagnosis names what it names in the untouched one.
pub(crate) const AS_UNTOUCHED: &str = "as untouched";

/// A judged cause of a diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JudgedCause {
    /// The effect.
    pub effect: String,
    /// The triad: as stated, or that of all channels.
    pub triad: Option<String>,
    /// Whether the case has this effect.
    pub right: bool,
}

/// A judged case.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judgement {
    /// The case's number.
    pub case: usize,
    /// The kinds of its effects.
    pub kinds: Vec<Kind>,
    /// The triads of its effects.
    pub triads: Vec<String>,
    /// The sizes over the limit.
    pub over_limit: Vec<f64>,
    /// The limits, in the units of the numbers.
    pub limits: Vec<f64>,
    /// The verdict, or the reason for its absence.
    pub verdict: String,
    /// The causes in their order.
    pub causes: Vec<JudgedCause>,
    /// Whether the first cause is right.
    pub right_first: bool,
    /// Whether each effect was named.
    pub named: Vec<bool>,
    /// For each named parameter with an interval: whether the interval contains the truth.
    pub held: Vec<bool>,
    /// The same beside poses, about what the same record shows untouched.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub held_alone: Vec<bool>,
    /// The part of the gap that was closed.
    pub closed: Option<f64>,
    /// The part that the true effects close.
    pub closed_by_truth: Option<f64>,
}

/// Judges a diagnosis: its JSON, or the reason for its absence.
pub fn judge(key: &Key, report: Result<&Value, &str>, closed_by_truth: Option<f64>) -> Judgement {
    let nothing = Value::Null;
    let (value, verdict) = match report {
        Ok(value) => (value, value["verdict"].as_str().unwrap_or("none").to_owned()),
        Err(reason) => (&nothing, reason.to_owned()),
    };
    let causes: &[Value] = value["causes"].as_array().map_or(&[], Vec::as_slice);
    let right = |cause: &Value| key.effects.iter().any(|of| is(of, cause));
    let mut held = Vec::new();
    for of in &key.effects {
        for cause in causes.iter().filter(|cause| is(of, cause)) {
            held.extend(intervals(of, cause));
        }
    }
    Judgement {
        case: key.case,
        kinds: key.effects.iter().map(|of| of.kind).collect(),
        triads: key.effects.iter().map(|of| of.triad.clone()).collect(),
        over_limit: key.effects.iter().map(|of| of.over_limit).collect(),
        limits: key.effects.iter().map(|of| of.limit).collect(),
        verdict,
        causes: causes
            .iter()
            .map(|cause| JudgedCause { effect: called(cause), triad: triad_of(cause), right: right(cause) })
            .collect(),
        right_first: causes.first().is_some_and(right),
        named: key.effects.iter().map(|of| causes.iter().any(|cause| is(of, cause))).collect(),
        held,
        held_alone: Vec::new(),
        closed: value["discrepancy"]["closed"].as_f64(),
        closed_by_truth,
    }
}

fn called(cause: &Value) -> String {
    let name = cause["effect"].as_str().unwrap_or("?");
    let form =
        cause["parameters"].as_object().into_iter().flat_map(|of| of.values()).find_map(|of| of["form"].as_str());
    form.map_or_else(|| name.to_owned(), |form| format!("{form} {name}"))
}

/// Returns the triad of a cause: the stated one, or that of all its channels.
fn triad_of(cause: &Value) -> Option<String> {
    if let Some(triad) = cause["triad"].as_str() {
        return Some(triad.to_owned());
    }
    let names: Vec<&str> = cause["channels"].as_array()?.iter().filter_map(Value::as_str).collect();
    let triads = [Triad::Gyro, Triad::Accel].map(Triad::name);
    triads.into_iter().find(|triad| names.iter().all(|name| name.starts_with(triad))).map(str::to_owned)
}

/// Returns whether a cause is the effect: by name, form and triad.
pub(crate) fn is(of: &TrueEffect, cause: &Value) -> bool {
    let form = match of.kind {
        Kind::UnsignedNonlinearity => "unsigned ",
        Kind::SignedNonlinearity => "signed ",
        _ => "",
    };
    let Some(effect) = of.kind.effect() else { return false };
    called(cause) == format!("{form}{effect}") && triad_of(cause).as_deref() == Some(of.triad.as_str())
}

/// Returns whether each stated interval of a triad's parameters contains the truth.
fn intervals(of: &TrueEffect, cause: &Value) -> Vec<bool> {
    if of.kind.on_channels() {
        return on_channels(of, cause);
    }
    let ends = &cause["uncertainty"][&of.triad];
    let parameters = &cause["parameters"][&of.triad];
    let scale = match of.kind {
        Kind::UnsignedNonlinearity | Kind::SignedNonlinearity => {
            let triad = if of.triad == Triad::Gyro.name() { Triad::Gyro } else { Triad::Accel };
            parameters["full_scale"].as_f64().unwrap_or(1.0) / full_scale(triad)
        }
        _ => 1.0,
    };
    let at: Vec<&Value> = match of.kind {
        Kind::CrossAxisSensitivity => ["xy", "xz", "yz"].iter().map(|name| &ends[*name]).collect(),
        Kind::GSensitivity => (0..9).map(|place| &ends["m"][place / 3][place % 3]).collect(),
        Kind::Latency => vec![&ends["seconds"]],
        Kind::Saturation => Vec::new(),
        _ => ["x", "y", "z"].iter().map(|name| &ends[*name]).collect(),
    };
    at.into_iter()
        .zip(&of.numbers)
        .filter_map(|(ends, truth)| {
            let (low, high) = (ends[0].as_f64()?, ends[1].as_f64()?);
            Some((low..=high).contains(&(truth * scale)))
        })
        .collect()
}

/// Returns, for each axis, whether the stated interval of an effect with a number per channel contains the truth.
fn on_channels(of: &TrueEffect, cause: &Value) -> Vec<bool> {
    let name = if of.kind == Kind::LowPass { "cutoff_hz" } else { "per_c" };
    ["x", "y", "z"]
        .iter()
        .enumerate()
        .filter_map(|(axis, letter)| {
            let uncertainty = &cause["uncertainty"][format!("{}_{letter}", of.triad)];
            let ends = &uncertainty.as_array().and_then(|list| list.first()).unwrap_or(uncertainty)[name];
            let (low, high) = (ends[0].as_f64()?, ends[1].as_f64()?);
            // One corner applies to all axes.
            let truth = of.numbers.get(axis).or(of.numbers.first())?;
            Some((low..=high).contains(truth))
        })
        .collect()
}

/// The row of a kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OfKind {
    /// The kind.
    pub kind: Kind,
    /// Right first, for effects that are alone.
    pub right_first: Rate,
    /// Right first, from [`CLEAR`] times the limit on.
    pub right_first_clear: Rate,
    /// Reported as unknown.
    pub unknown: Rate,
    /// Cases with a wrong cause.
    pub spurious: Rate,
    /// Intervals that contain the truth.
    pub held: Rate,
    /// Median of the closed part, from [`CLEAR`] on.
    pub closed: Option<f64>,
    /// The size over the bound's at which half are right.
    pub size_50: Option<Limit>,
    /// The size over the bound's at which nine of ten are right.
    pub size_90: Option<Limit>,
    /// The bound's size by triad, a median over the cases.
    pub bounds: BTreeMap<String, f64>,
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// The summary of a trial.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Score {
    /// The program.
    pub software: String,
    /// The sealed seed.
    pub seed: u64,
    /// SHA-256 of the manifest.
    pub manifest_sha256: String,
    /// The number of cases.
    pub cases: usize,
    /// Rates by name.
    pub rates: BTreeMap<&'static str, Rate>,
    /// The rows by kind.
    pub kinds: Vec<OfKind>,
    /// Cases with a wrong result.
    pub misses: Vec<Judgement>,
}

/// The meanings of the rates, in display order.
pub const RATES: [(&str, &str); 12] = [
    ("right_first_clear", "right effect and triad first, from 3 times the limit on"),
    ("right_first", "right effect and triad first, all sizes"),
    ("both_named", "two effects at once, both named, from 3 times the limit on"),
    ("none_blamed", "nothing there: blamed"),
    ("none_named", "nothing there: a cause named"),
    ("held", "parameters inside their 95 % intervals"),
    ("held_alone", "the same, about what the same record shows untouched"),
    ("nearly_closed", "closed at least 90 % of what the truth closes, from 3 times the limit on"),
    ("turned_mixed", "misalignment called cross-axis sensitivity, or the reverse"),
    ("unknown_found", "outside the library: called unknown, from 3 times the limit on"),
    ("false_unknown", "in the library: called unknown"),
    ("spurious", "cases with a spurious cause"),
];

impl Score {
    /// Computes the score of these judgements.
    pub fn of(software: &str, seed: u64, manifest_sha256: &str, all: &[Judgement]) -> Self {
        let inside = |of: &Judgement| !of.kinds.is_empty() && of.kinds.iter().all(|kind| kind.effect().is_some());
        let single = || all.iter().filter(move |of| of.kinds.len() == 1 && inside(of));
        let pairs = || all.iter().filter(move |of| of.kinds.len() == 2);
        let nothing = || all.iter().filter(|of| of.kinds.is_empty());
        let outside = || all.iter().filter(|of| of.kinds.iter().any(|kind| kind.effect().is_none()));
        let clear = |of: &&Judgement| of.over_limit.iter().all(|size| *size >= CLEAR);
        let unknown = |of: &Judgement| of.verdict == "unknown_effect";
        let spurious = |of: &Judgement| of.causes.iter().any(|cause| !cause.right);
        // A refusal is not an answer either.
        let blamed = |of: &Judgement| {
            !of.causes.is_empty() || !matches!(of.verdict.as_str(), "no_gap" | "parameters" | AS_UNTOUCHED)
        };
        let turned = [
            (Kind::Misalignment, EffectKind::CrossAxisSensitivity),
            (Kind::CrossAxisSensitivity, EffectKind::Misalignment),
        ];
        let mixed = |of: &Judgement| {
            turned.iter().any(|(kind, other)| {
                of.kinds.contains(kind)
                    && !of.kinds.iter().any(|kind| kind.effect() == Some(*other))
                    && of.causes.iter().any(|cause| cause.effect == other.name())
            })
        };
        let both = single().chain(pairs());
        // If no cause was named, the closed part is 0.
        let closing = both.clone().filter(clear).filter_map(|of| Some((of.closed.unwrap_or(0.0), of.closed_by_truth?)));
        let rates = BTreeMap::from([
            ("right_first_clear", Rate::of(single().filter(clear).map(|of| of.right_first))),
            ("right_first", Rate::of(single().map(|of| of.right_first))),
            ("both_named", Rate::of(pairs().filter(clear).map(|of| of.named.iter().all(|named| *named)))),
            ("none_blamed", Rate::of(nothing().map(blamed))),
            ("none_named", Rate::of(nothing().map(|of| !of.causes.is_empty()))),
            ("held", Rate::of(both.clone().flat_map(|of| of.held.iter().copied()))),
            ("held_alone", Rate::of(all.iter().flat_map(|of| of.held_alone.iter().copied()))),
            ("nearly_closed", Rate::of(closing.map(|(closed, truth)| closed >= NEARLY * truth))),
            (
                "turned_mixed",
                Rate::of(both.clone().filter(|of| turned.iter().any(|(kind, _)| of.kinds.contains(kind))).map(mixed)),
            ),
            ("unknown_found", Rate::of(outside().filter(clear).map(unknown))),
            ("false_unknown", Rate::of(both.clone().map(unknown))),
            ("spurious", Rate::of(both.map(spurious))),
        ]);
        let kinds = Kind::all().filter_map(|kind| {
            let own: Vec<&Judgement> = all.iter().filter(|of| of.kinds == [kind]).collect();
            if own.is_empty() {
                return None;
            }
            let good = |of: &Judgement| if kind.effect().is_some() { of.right_first } else { unknown(of) };
            let sizes: Vec<(f64, bool)> = own.iter().map(|of| (of.over_limit[0], good(of))).collect();
            let limits = detection::limits(&sizes);
            let closed = own.iter().copied().filter(clear).filter_map(|of| of.closed).collect();
            let bound = |triad: &Triad| {
                let on = own.iter().filter(|of| of.triads == [triad.name()]);
                Some((triad.name().to_owned(), median(on.map(|of| of.limits[0]).collect())?))
            };
            Some(OfKind {
                kind,
                right_first: Rate::of(own.iter().map(|of| good(of))),
                right_first_clear: Rate::of(own.iter().copied().filter(clear).map(good)),
                unknown: Rate::of(own.iter().map(|of| unknown(of))),
                spurious: Rate::of(own.iter().map(|of| spurious(of))),
                held: Rate::of(own.iter().flat_map(|of| of.held.iter().copied())),
                closed: median(closed),
                bounds: kind.triads().iter().filter_map(bound).collect(),
                size_50: limits.map(|[half, _]| half),
                size_90: limits.map(|[_, most]| most),
            })
        });
        let miss = |of: &&Judgement| match of.kinds.as_slice() {
            [] => blamed(of),
            kinds if kinds.iter().any(|kind| kind.effect().is_none()) => !unknown(of),
            _ => spurious(of) || unknown(of) || of.named.iter().any(|named| !named),
        };
        Self {
            software: software.to_owned(),
            seed,
            manifest_sha256: manifest_sha256.to_owned(),
            cases: all.len(),
            rates,
            kinds: kinds.collect(),
            misses: all.iter().filter(miss).cloned().collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn key(kind: Kind, numbers: &[f64]) -> Key {
        let effect = TrueEffect { kind, triad: "gyro".into(), over_limit: 4.0, numbers: numbers.to_vec(), limit: 1e-4 };
        Key { case: 0, rate_hz: 40.0, samples: 6000, own_clock: false, effects: vec![effect], salt: String::new() }
    }

    #[test]
    fn an_effect_is_right_with_its_name_its_form_and_its_triad() {
        let report = |form: &str, triad: &str| {
            json!({"verdict": "effects", "discrepancy": {"closed": 0.97}, "causes": [{
                "effect": "scale_factor_nonlinearity", "triad": triad, "channels": [format!("{triad}_x")],
                "parameters": {triad: {"x": 2e-4, "y": 0.0, "z": 0.0, "full_scale": 17.4532925, "form": form}},
                "uncertainty": {triad: {"x": [1.4e-4, 1.6e-4], "y": [1e-5, 2e-5], "z": [-1e-5, 1e-5]}}
            }]})
        };
        let key = key(Kind::SignedNonlinearity, &[3e-4, 0.0, 0.0]);
        let found = judge(&key, Ok(&report("signed", "gyro")), Some(0.99));
        assert!(found.right_first && found.named == [true]);
        // Fractions of half the full scale are half as large.
        assert_eq!(found.held, [true, false, true]);
        for wrong in [report("unsigned", "gyro"), report("signed", "accel")] {
            assert!(!judge(&key, Ok(&wrong), None).right_first);
        }
        let refused = judge(&key, Err("too short"), None);
        let score = Score::of("test", 1, "", &[found, refused]);
        assert_eq!((score.rates["right_first_clear"].count, score.rates["right_first_clear"].of), (1, 2));
        assert_eq!(score.rates["nearly_closed"].count, 1);
        assert_eq!(score.misses.len(), 1);
        assert_eq!(score.kinds[0].bounds["gyro"], 1e-4);
        assert!(RATES.iter().all(|(name, _)| score.rates.contains_key(name)));
    }

    /// A short trial in this process: `VN100D_MOTION_CASES` makes it longer, `VN100D_MOTION_KINDS` chooses kinds.
    #[test]
    fn a_short_trial_reaches_its_rates() {
        use crate::motion::case::{Case, pack, unpack};
        use crate::motion::plan;
        use imu_diagnosis::{Options, diagnose_moved};
        let variable = |name: &str| std::env::var(name).ok();
        let cases: usize = variable("VN100D_MOTION_CASES").and_then(|text| text.parse().ok()).unwrap_or(10);
        let seed: u64 = variable("VN100D_MOTION_SEED").and_then(|text| text.parse().ok()).unwrap_or(11);
        let kinds = variable("VN100D_MOTION_KINDS").unwrap_or_default();
        let planned = plan(seed, cases, kinds.split(',').filter(|word| !word.is_empty())).unwrap();
        let mut judged = Vec::new();
        for (index, own) in planned.iter().enumerate() {
            let case = Case::draw(seed, index, own, None);
            let (recording, model, reference) = unpack(&pack(&case, &case.model(false).unwrap()).unwrap()).unwrap();
            let report = diagnose_moved(&recording, &reference, &model, &Options::default())
                .map(|outcome| serde_json::to_value(&outcome.diagnosis).unwrap())
                .map_err(|error| error.to_string());
            let own = judge(&case.key(), report.as_ref().map_err(String::as_str), None);
            println!(
                "{index}: {:?} {:?} {:.1?} → {} {:?} held {:?} closed {:?}",
                own.kinds,
                own.triads,
                own.over_limit,
                own.verdict,
                own.causes.iter().map(|of| format!("{} {:?}", of.effect, of.triad)).collect::<Vec<_>>(),
                own.held,
                own.closed
            );
            if own.verdict == "unknown_effect" || own.causes.iter().any(|of| !of.right) {
                println!("    {:?}", report.as_ref().map(|of| of["notes"].clone()));
            }
            judged.push(own);
        }
        let score = Score::of("test", seed, "", &judged);
        for (name, _) in RATES {
            println!("{name}: {:?}", score.rates[name]);
        }
        assert_eq!(score.rates["turned_mixed"].count, 0);
        assert!(score.rates["spurious"].count * 5 <= cases.max(5), "{:?}", score.misses);
        assert!(score.rates["none_blamed"].count * 20 <= score.rates["none_blamed"].of, "{:?}", score.misses);
        for (name, least) in [("right_first_clear", 0.95), ("both_named", 0.9), ("unknown_found", 0.9), ("held", 0.8)] {
            let Rate { count, of, .. } = score.rates[name];
            assert!(count as f64 >= least * of as f64, "{name}: {count} of {of}, {:?}", score.misses);
        }
    }

    #[test]
    fn what_is_on_channels_is_on_their_triad() {
        let report = json!({"verdict": "effects", "causes": [
            {"effect": "temperature_bias", "channels": ["gyro_x", "gyro_z"], "parameters": {}}]});
        assert!(judge(&key(Kind::TemperatureBias, &[1e-5, 0.0, 1e-5]), Ok(&report), None).right_first);
        let none = Key { effects: Vec::new(), ..key(Kind::Bias, &[]) };
        let score = Score::of("test", 1, "", &[judge(&none, Ok(&report), None)]);
        assert_eq!(score.rates["none_blamed"].count, 1);
    }
}
