//! Scores: the summary of the judgements of a trial.

use super::class::{Class, Sense};
use super::interval::Rate;
use super::judge::{Judgement, Named};
use super::kind::Kind;
use super::of_kind::{Bin, OfKind, bins};
use super::rates::{Halves, Rates};
use serde::Serialize;
use std::collections::BTreeMap;

/// The format's name.
pub const FORMAT: &str = "vn100d-trial-1";

/// Edges of the stated confidences.
const CONFIDENCE: [f64; 8] = [0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0];

/// A case with a wrong result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Miss {
    /// The case's number.
    pub case: usize,
    /// The case's class.
    pub class: Class,
    /// The kinds of its effects.
    pub kinds: Vec<Kind>,
    /// How sensor and model differ in each effect.
    pub senses: Vec<Sense>,
    /// The smallest size over its limit; none outside the library, because there is no limit.
    pub over_limit: Option<f64>,
    /// The stated verdict.
    pub verdict: String,
    /// The named causes.
    pub named: Vec<Named>,
    /// The reason for the refusal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refusal: Option<String>,
}

/// The reliability of stated confidences.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Calibration {
    /// Causes with a stated confidence that were right.
    pub right: Rate,
    /// Mean of the stated confidences.
    pub mean_confidence: Option<f64>,
    /// Expected calibration error: mean of |mean confidence − share right| over the classes of `reliability`, weighted
    /// by their numbers (M. Naeini et al., AAAI 2015, equation 2); none if no confidence was stated.
    pub expected_error: Option<f64>,
}

impl Calibration {
    fn of(bins: &[Bin]) -> Self {
        let (count, of) = bins.iter().fold((0, 0), |(count, of), bin| (count + bin.right.count, of + bin.right.of));
        let mean_of = |value: &dyn Fn(f64, f64) -> f64| {
            let part = |bin: &Bin| Some(bin.right.of as f64 * value(bin.mean?, bin.right.share?));
            (of > 0).then(|| bins.iter().filter_map(part).sum::<f64>() / of as f64)
        };
        Self {
            right: Rate::new(count, of),
            mean_confidence: mean_of(&|mean, _| mean),
            expected_error: mean_of(&|mean, share| (mean - share).abs()),
        }
    }
}

/// The recording on which a trial's effects were imposed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct On {
    /// The recording's name.
    pub recording: String,
    /// Number of stretches from which cases were made.
    pub stretches: usize,
    /// Cases whose channels are reported as unknown without imposed effects: their verdicts do not count.
    pub own_unknown: Rate,
    /// Number of causes that were excluded as the recording's own.
    pub own_causes: usize,
}

/// The score of a trial.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Score {
    /// [`FORMAT`].
    pub format: &'static str,
    /// The program.
    pub software: String,
    /// The seed of its cases.
    pub seed: u64,
    /// The number of cases.
    pub cases: usize,
    /// The number of cases by class.
    pub classes: BTreeMap<&'static str, usize>,
    /// The name of the frozen set, if the trial uses one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub suite: Option<&'static str>,
    /// The recording, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub on: Option<On>,
    /// SHA-256 of the manifest that was written first.
    pub manifest_sha256: String,
    /// The summary.
    pub rates: Rates,
    /// False places per record, on average.
    pub false_places: Option<f64>,
    /// The scores by kind.
    pub kinds: Vec<OfKind>,
    /// Single effects, none and outside: by true kind, then the first named cause (or the verdict if there was none),
    /// the number of cases.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
    /// Stated confidence of the named causes, and the share that was right. Cases too small to count are left out, as
    /// are those outside the library, because their named causes are look-alikes.
    pub reliability: Vec<Bin>,
    /// The summary of the reliability.
    pub calibration: Calibration,
    /// Counted cases with a wrong result.
    pub misses: Vec<Miss>,
}

impl Score {
    /// Computes the score from all judgements of a trial.
    pub fn of(software: &str, seed: u64, manifest_sha256: &str, all: &[Judgement], halves: &Halves) -> Self {
        let mut classes: BTreeMap<&'static str, usize> = Class::ALL.map(|class| (class.name(), 0)).into();
        for judgement in all {
            *classes.entry(judgement.class.name()).or_default() += 1;
        }
        let reliability = reliability(all);
        Self {
            suite: None,
            on: None,
            calibration: Calibration::of(&reliability),
            format: FORMAT,
            software: software.to_owned(),
            seed,
            cases: all.len(),
            classes,
            manifest_sha256: manifest_sha256.to_owned(),
            rates: Rates::of(all, halves),
            false_places: mean(all.iter().filter_map(|one| one.false_places)),
            kinds: Kind::all().filter_map(|kind| OfKind::of(kind, all)).collect(),
            confusion: confusion(all),
            reliability,
            misses: all.iter().filter(|one| missed(one)).map(miss).collect(),
        }
    }

    /// Marks the score as that of a frozen set.
    pub fn of_suite(self, name: Option<&'static str>) -> Self {
        Self { suite: name, ..self }
    }

    /// Records the recording on which the effects were imposed.
    pub fn on(self, recording: &str, stretches: usize, all: &[Judgement]) -> Self {
        let on = On {
            recording: recording.to_owned(),
            stretches,
            own_unknown: Rate::of(all.iter().map(|one| one.own_unknown)),
            own_causes: all.iter().map(|one| one.own).sum(),
        };
        Self { on: Some(on), ..self }
    }
}

/// Returns whether the case reduces one of the rates.
fn missed(one: &Judgement) -> bool {
    one.verdict == "refused"
        || match one.class {
            Class::None | Class::Known => !one.causes.is_empty() || (one.unknown() && !one.own_unknown),
            Class::Outside | Class::Kept => !one.answered(),
            _ => one.counts && !(one.right_first() && one.exactly()),
        }
}

fn miss(one: &Judgement) -> Miss {
    Miss {
        case: one.case,
        class: one.class,
        kinds: one.effects.iter().map(|effect| effect.kind).collect(),
        senses: one.effects.iter().map(|effect| effect.sense).collect(),
        over_limit: one
            .class
            .in_library()
            .then(|| one.effects.iter().map(|effect| effect.over_limit).min_by(f64::total_cmp))
            .flatten(),
        verdict: one.verdict.clone(),
        named: one.causes.clone(),
        refusal: one.refusal.clone(),
    }
}

/// Returns the label of a row of the confusion: the kind, and the sense unless it is `Missing`.
fn truth(one: &Judgement) -> String {
    match one.effects.first() {
        None => "none".to_owned(),
        Some(effect) => match effect.sense {
            Sense::Missing => effect.kind.name().to_owned(),
            Sense::Superfluous => format!("{} (superfluous)", effect.kind),
            Sense::Size => format!("{} (size)", effect.kind),
            Sense::Elsewhere => format!("{} (elsewhere)", effect.kind),
            Sense::Known => format!("{} (known)", effect.kind),
        },
    }
}

fn confusion(all: &[Judgement]) -> BTreeMap<String, BTreeMap<String, usize>> {
    let mut matrix: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for one in all.iter().filter(|one| one.effects.len() < 2 && one.counts) {
        let named = one.causes.first().map_or(one.verdict.as_str(), |cause| cause.effect.as_str());
        *matrix.entry(truth(one)).or_default().entry(named.to_owned()).or_default() += 1;
    }
    matrix
}

fn reliability(all: &[Judgement]) -> Vec<Bin> {
    let named = all.iter().filter(|one| !one.class.is_outside() && one.is_of_account()).flat_map(|one| &one.causes);
    let stated: Vec<(f64, bool)> = named.filter_map(|cause| Some((cause.confidence?, cause.right))).collect();
    bins(&CONFIDENCE, &stated)
}

fn mean(counts: impl Iterator<Item = usize>) -> Option<f64> {
    let (sum, of) = counts.fold((0, 0), |(sum, of), one| (sum + one, of + 1));
    (of > 0).then(|| sum as f64 / of as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judge::Found;

    fn judgement(case: usize, class: Class, kinds: &[Kind], verdict: &str, causes: &[(&str, bool)]) -> Judgement {
        let found = |kind: &Kind| Found {
            kind: *kind,
            sense: Sense::Missing,
            over_limit: 2.0,
            named: causes
                .iter()
                .any(|(name, right)| *right && kind.effect().is_some_and(|effect| effect.name() == *name)),
            equivalent: false,
            channels_exact: Some(true),
            placed: Some(false),
            intervals: [1, 2],
            location: BTreeMap::new(),
            parameters: BTreeMap::new(),
        };
        let named = |(name, right): &(&str, bool)| Named {
            effect: (*name).to_owned(),
            channels: Vec::new(),
            sense: Sense::Missing,
            confidence: Some(if *right { 0.96 } else { 0.6 }),
            right: *right,
        };
        Judgement {
            case,
            class,
            counts: true,
            verdict: verdict.to_owned(),
            refusal: None,
            own: 0,
            own_unknown: false,
            control: None,
            causes: causes.iter().map(named).collect(),
            effects: kinds.iter().map(found).collect(),
            false_places: Some(1),
            remainder: None,
            closed: Some(0.9),
            closed_ci95: Some([0.85, 0.95]),
            closed_by_truth: Some(0.92),
            again: None,
        }
    }

    fn score() -> Score {
        let tone = &[Kind::Tone][..];
        let pair = &[Kind::Tone, Kind::Spikes][..];
        let all = [
            judgement(0, Class::None, &[], "no_gap", &[]),
            judgement(1, Class::None, &[], "parameters", &[]),
            judgement(2, Class::None, &[], "effects", &[("rate_ramp", false)]),
            judgement(3, Class::None, &[], "unknown_effect", &[]),
            judgement(4, Class::Single, tone, "effects", &[("tone", true)]),
            judgement(5, Class::Single, tone, "effects", &[("resonance", false), ("tone", true)]),
            judgement(6, Class::Single, tone, "unknown_effect", &[("tone", true)]),
            judgement(7, Class::Pair, pair, "effects", &[("tone", true), ("spikes", true)]),
            judgement(8, Class::Pair, pair, "effects", &[("tone", true)]),
            judgement(9, Class::Outside, &[Kind::Echo], "unknown_effect", &[("resonance", false)]),
            judgement(10, Class::Outside, &[Kind::Echo], "effects", &[("resonance", false)]),
            // Too small to count: in no rate of causes and not in the reliability.
            Judgement { counts: false, ..judgement(11, Class::Single, tone, "effects", &[("comb", false)]) },
        ];
        Score::of("test", 1, "", &all, &[])
    }

    #[test]
    fn rates_are_those_of_reports_made_by_hand() {
        let score = score();
        for (name, expected) in [
            ("right_first", (2, 3)),
            ("right_first_or_none", (5, 7)),
            ("none_named", (1, 4)),
            ("none_unknown", (1, 4)),
            ("cause_and_sense_first", (4, 5)),
            ("library_unknown", (1, 5)),
            ("spurious", (1, 5)),
            ("both_found", (1, 2)),
            ("both_exactly", (1, 2)),
            ("all_found", (1, 2)),
            ("outside_unknown", (1, 2)),
            ("outside_answered", (1, 2)),
            ("kept_unknown", (0, 0)),
            ("placed", (0, 6)),
            ("false_place", (12, 12)),
            ("intervals_hold", (6, 12)),
            ("closed_covers", (5, 5)),
            ("first_new", (0, 0)),
        ] {
            let rate = score.rates.get(name).unwrap();
            assert_eq!((rate.count, rate.of), expected, "{name}");
        }
        assert_eq!(score.false_places, Some(1.0));
        let names = Rates::names();
        assert!(names.iter().all(|name| names.iter().filter(|other| *other == name).count() == 1), "{names:?}");
        assert_eq!(score.misses.iter().map(|miss| miss.case).collect::<Vec<_>>(), [2, 3, 5, 6, 8, 10]);
    }

    #[test]
    fn confusion_and_reliability_count_what_was_named() {
        let score = score();
        assert_eq!(score.confusion["tone"], [("resonance".to_owned(), 1), ("tone".to_owned(), 2)].into());
        assert_eq!(score.confusion["none"]["no_gap"], 1);
        let bins: Vec<_> = score.reliability.iter().map(|bin| (bin.right.count, bin.right.of)).collect();
        assert_eq!(bins, [(0, 0), (0, 2), (0, 0), (0, 0), (0, 0), (6, 6), (0, 0)]);
        // Six of six at 0.96, none of two at 0.6: (6·0.04 + 2·0.6)/8.
        let of = score.calibration;
        assert_eq!((of.right.count, of.right.of), (6, 8));
        assert!(
            (of.expected_error.unwrap() - 0.18).abs() < 1e-12 && (of.mean_confidence.unwrap() - 0.87).abs() < 1e-12
        );
        assert_eq!(Score::of("", 1, "", &[], &[]).calibration.expected_error, None);
        let tone = score.kinds.iter().find(|of| of.kind == Kind::Tone).unwrap();
        assert_eq!((tone.closed, tone.right_first.of), (Some(0.9), 3));
        assert!((tone.closed_of_truth.unwrap() - 0.9 / 0.92).abs() < 1e-12);
    }

    #[test]
    fn verdicts_on_a_recording_that_is_unknown_as_it_is_do_not_count() {
        let mut all = [
            judgement(0, Class::None, &[], "unknown_effect", &[]),
            judgement(1, Class::Single, &[Kind::Tone], "unknown_effect", &[("tone", true)]),
            judgement(2, Class::Outside, &[Kind::Echo], "unknown_effect", &[]),
        ];
        for one in &mut all {
            one.own_unknown = true;
            one.own = 2;
            one.control = Some(("unknown_effect".to_owned(), 2));
        }
        let halves = [("no_gap".to_owned(), 0), ("unknown_effect".to_owned(), 1)];
        let score = Score::of("test", 1, "", &all, &halves).on("desk", 3, &all);
        let of = |name: &str| score.rates.get(name).unwrap();
        assert_eq!(["none_unknown", "library_unknown", "outside_unknown"].map(|name| of(name).of), [0; 3]);
        assert_eq!((of("right_first").count, of("none_named").of), (1, 1));
        assert_eq!((of("first_new").count, of("control_unknown").count, of("control_named").of), (1, 3, 3));
        assert_eq!((of("halves_clean").count, of("halves_unknown").count), (1, 1));
        assert!(score.misses.is_empty(), "{:?}", score.misses);
        let on = score.on.unwrap();
        assert_eq!((on.stretches, on.own_causes, on.own_unknown.count), (3, 6, 3));
    }
}
