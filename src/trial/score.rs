//! Scores: what the judgements of a trial come to.

use super::detection::{Detection, limits};
use super::interval::Rate;
use super::judge::{Found, Judgement, Named};
use super::kind::{Class, Kind};
use serde::Serialize;
use std::collections::BTreeMap;

/// The format's name.
pub const FORMAT: &str = "vn100d-trial-1";

/// Edges of the sizes over the limit by which detection is told.
const CURVE: [f64; 8] = [0.5, 0.7, 1.0, 1.5, 2.2, 3.3, 5.0, 10.0];
/// Edges of the stated confidences.
const CONFIDENCE: [f64; 8] = [0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0];

/// The rates by which a trial is told in short. Only cases with effects of 1.5 times the limit or above count, but for those
/// without effects and those outside the library.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the score's keys")]
pub struct Rates {
    /// One effect: it is the first cause named.
    pub right_first: Rate,
    /// The same with the cases that have none, which are right when nothing is named.
    pub right_first_or_none: Rate,
    /// No effect: something was named.
    pub none_named: Rate,
    /// No effect: called unknown.
    pub none_unknown: Rate,
    /// One or two effects of the library: called unknown.
    pub library_unknown: Rate,
    /// One or two effects: with a cause that is none of them.
    pub spurious: Rate,
    /// Two effects: both were named.
    pub both_found: Rate,
    /// Two effects: both, nothing else, and the verdict is `effects`.
    pub both_exactly: Rate,
    /// Two effects: the first cause named is one of them.
    pub pair_first: Rate,
    /// Outside the library: called unknown.
    pub outside_unknown: Rate,
    /// Effects that were named: all their channels and no other.
    pub channels_exact: Rate,
    /// Cases whose 95 % interval of `closed` holds what the true effects close; of those where that was measured.
    pub closed_covers: Rate,
    /// Cases that were refused.
    pub refused: Rate,
}

/// A stretch of a curve or a class of confidences.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the score's keys")]
pub struct Bin {
    /// From.
    pub from: f64,
    /// To; the last one includes it.
    pub to: f64,
    /// Mean of what it holds.
    pub mean: Option<f64>,
    /// How many were right.
    pub right: Rate,
}

/// The middle of some errors, and how many there are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the score's keys")]
pub struct Spread {
    /// How many.
    pub count: usize,
    /// The median.
    pub median: f64,
    /// What nine of ten stay below.
    pub p90: f64,
}

/// The score of one kind of effect, alone in its case.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the score's keys")]
pub struct OfKind {
    /// Which.
    pub kind: Kind,
    /// Whether the library has it.
    pub library: bool,
    /// The first cause is it (never, outside the library).
    pub right_first: Rate,
    /// Of these, under another name or form of the same law.
    pub equivalent: usize,
    /// Called unknown.
    pub unknown: Rate,
    /// With a cause that it is not.
    pub spurious: Rate,
    /// All its channels and no other.
    pub channels_exact: Rate,
    /// Part of the gap that is closed, median.
    pub closed: Option<f64>,
    /// And of what the true effect closes, median.
    pub closed_of_truth: Option<f64>,
    /// Errors of place: `frequency_bins` (1/length), `at_s`, `edge_s`.
    pub location: BTreeMap<&'static str, Spread>,
    /// Relative errors of parameters.
    pub parameters: BTreeMap<String, Spread>,
    /// Share right by size over the limit, all sizes.
    pub curve: Vec<Bin>,
    /// Size over the limit at which half are right, by a logistic curve through all; none where nearly all are, or none is.
    pub size_50: Option<f64>,
    /// And 90 %.
    pub size_90: Option<f64>,
    /// The same in the kind's own unit, with intervals, beside what no test can be below.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detection: Option<Detection>,
}

/// A case that went wrong.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the score's keys")]
pub struct Miss {
    /// Its number.
    pub case: usize,
    /// What it has.
    pub kinds: Vec<Kind>,
    /// The least of its sizes over their limits; none outside the library, where there is no limit.
    pub over_limit: Option<f64>,
    /// What was said.
    pub verdict: String,
    /// What was named.
    pub named: Vec<Named>,
    /// Why it was refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refusal: Option<String>,
}

/// How far stated confidences are to be believed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the score's keys")]
pub struct Calibration {
    /// Causes with a stated confidence that were right.
    pub right: Rate,
    /// Mean of the stated confidences.
    pub mean_confidence: Option<f64>,
    /// Expected calibration error: mean of |mean confidence − share right| over the classes of `reliability`, by how many each
    /// holds (M. Naeini et al., AAAI 2015, equation 2); none where nothing was stated.
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

/// The recording that a trial's effects were imposed on.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the score's keys")]
pub struct On {
    /// What it is called.
    pub recording: String,
    /// Stretches that cases were made of.
    pub stretches: usize,
    /// Cases whose channels are called unknown as they are: their verdicts do not count.
    pub own_unknown: Rate,
    /// Causes that were set aside as the recording's own.
    pub own_causes: usize,
}

/// The score of a trial.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the format's keys")]
pub struct Score {
    /// [`FORMAT`].
    pub format: &'static str,
    /// The program.
    pub software: String,
    /// The seed of its cases.
    pub seed: u64,
    /// Cases.
    pub cases: usize,
    /// By class.
    pub classes: BTreeMap<&'static str, usize>,
    /// The recording, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub on: Option<On>,
    /// SHA-256 of the manifest that was written first.
    pub manifest_sha256: String,
    /// In short.
    pub rates: Rates,
    /// By kind.
    pub kinds: Vec<OfKind>,
    /// Single effects, none and outside: true kind, then the first cause named (or the verdict where none was), how often.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
    /// Stated confidence of the causes named and how many were right; without the cases outside the library, where what is
    /// named is a look-alike.
    pub reliability: Vec<Bin>,
    /// The same in short.
    pub calibration: Calibration,
    /// Cases that count and went wrong.
    pub misses: Vec<Miss>,
}

impl Score {
    /// Of all the judgements of a trial.
    #[must_use]
    pub fn of(software: &str, seed: u64, manifest_sha256: &str, all: &[Judgement]) -> Self {
        let mut classes: BTreeMap<&'static str, usize> = Class::ALL.map(|class| (class.name(), 0)).into();
        for judgement in all {
            *classes.entry(judgement.class.name()).or_default() += 1;
        }
        let kinds = Kind::LIBRARY.into_iter().chain(Kind::OUTSIDE);
        let reliability = reliability(all);
        Self {
            on: None,
            calibration: Calibration::of(&reliability),
            format: FORMAT,
            software: software.to_owned(),
            seed,
            cases: all.len(),
            classes,
            manifest_sha256: manifest_sha256.to_owned(),
            rates: rates(all),
            kinds: kinds.filter_map(|kind| of_kind(kind, all)).collect(),
            confusion: confusion(all),
            reliability,
            misses: all.iter().filter(|one| missed(one)).map(miss).collect(),
        }
    }

    /// Says which recording the effects were imposed on.
    #[must_use]
    pub fn on(self, recording: &str, stretches: usize, all: &[Judgement]) -> Self {
        let on = On {
            recording: recording.to_owned(),
            stretches,
            own_unknown: Rate::of(all.iter().map(|one| one.own_unknown)),
            own_causes: all.iter().map(|one| one.own).sum(),
        };
        Self { on: Some(on), ..self }
    }

    /// A rate of [`Rates`] by its name.
    #[must_use]
    pub fn rate(&self, name: &str) -> Option<Rate> {
        self.named_rates().into_iter().find(|(own, ..)| *own == name).map(|(_, _, rate)| rate)
    }

    /// The rates with their names and what they mean.
    #[must_use]
    pub fn named_rates(&self) -> [(&'static str, &'static str, Rate); 13] {
        let of = &self.rates;
        [
            ("right_first", "one effect: named first", of.right_first),
            ("right_first_or_none", "the same, with none where nothing is named", of.right_first_or_none),
            ("none_named", "none: something named", of.none_named),
            ("none_unknown", "none: called unknown", of.none_unknown),
            ("library_unknown", "in the library, yet called unknown", of.library_unknown),
            ("spurious", "with a spurious cause", of.spurious),
            ("both_found", "two effects: both found", of.both_found),
            ("both_exactly", "two effects: exactly both, and clean", of.both_exactly),
            ("pair_first", "two effects: one of them named first", of.pair_first),
            ("outside_unknown", "outside the library: called unknown", of.outside_unknown),
            ("channels_exact", "channels exact", of.channels_exact),
            ("closed_covers", "interval of closed holds the true effect's", of.closed_covers),
            ("refused", "refused", of.refused),
        ]
    }
}

fn in_library(judgement: &Judgement) -> bool {
    matches!(judgement.class, Class::Single | Class::Pair)
}

/// Whether the case has a rate that it falls short in.
fn missed(one: &Judgement) -> bool {
    one.verdict == "refused"
        || match one.class {
            Class::None => !one.causes.is_empty() || (one.unknown() && !one.own_unknown),
            Class::Outside => !one.unknown(),
            Class::Single => one.counts && !(one.right_first() && one.exactly()),
            Class::Pair => one.counts && !one.exactly(),
        }
}

fn miss(one: &Judgement) -> Miss {
    Miss {
        case: one.case,
        kinds: one.effects.iter().map(|effect| effect.kind).collect(),
        over_limit: in_library(one)
            .then(|| one.effects.iter().map(|effect| effect.over_limit).min_by(f64::total_cmp))
            .flatten(),
        verdict: one.verdict.clone(),
        named: one.causes.clone(),
        refusal: one.refusal.clone(),
    }
}

fn rates(all: &[Judgement]) -> Rates {
    let of = |class: Class| all.iter().filter(move |one| one.class == class);
    let counting = |class: Class| of(class).filter(|one| one.counts);
    let library = || all.iter().filter(|one| in_library(one) && one.counts);
    let telling = |one: &&Judgement| !one.own_unknown;
    let silent = |one: &Judgement| one.causes.is_empty() && one.verdict != "refused";
    Rates {
        right_first: Rate::of(counting(Class::Single).map(Judgement::right_first)),
        right_first_or_none: Rate::of(
            counting(Class::Single).map(Judgement::right_first).chain(of(Class::None).map(silent)),
        ),
        none_named: Rate::of(of(Class::None).map(|one| !one.causes.is_empty())),
        none_unknown: Rate::of(of(Class::None).filter(telling).map(Judgement::unknown)),
        library_unknown: Rate::of(library().filter(telling).map(Judgement::unknown)),
        spurious: Rate::of(library().map(Judgement::spurious)),
        both_found: Rate::of(counting(Class::Pair).map(Judgement::all_found)),
        both_exactly: Rate::of(counting(Class::Pair).map(Judgement::exactly)),
        pair_first: Rate::of(counting(Class::Pair).map(Judgement::right_first)),
        outside_unknown: Rate::of(of(Class::Outside).filter(telling).map(Judgement::unknown)),
        channels_exact: Rate::of(library().flat_map(|one| &one.effects).filter_map(|effect| effect.channels_exact)),
        closed_covers: Rate::of(library().filter_map(|one| {
            let (truth, [low, high]) = (one.closed_by_truth?, one.closed_ci95?);
            Some((low..=high).contains(&truth))
        })),
        refused: Rate::of(all.iter().map(|one| one.verdict == "refused")),
    }
}

fn of_kind(kind: Kind, all: &[Judgement]) -> Option<OfKind> {
    let alone = |one: &&Judgement| matches!(one.effects.as_slice(), [only] if only.kind == kind);
    let every: Vec<&Judgement> = all.iter().filter(alone).collect();
    let counting: Vec<&Judgement> = every.iter().copied().filter(|one| one.counts).collect();
    if every.is_empty() {
        return None;
    }
    let found = || counting.iter().flat_map(|one| &one.effects);
    let sizes: Vec<(f64, bool)> =
        every.iter().filter_map(|one| Some((one.effects.first()?.over_limit, one.right_first()))).collect();
    let library = kind.effect().is_some();
    let limits = if library { limits(&sizes) } else { None };
    let of_truth = |one: &&Judgement| Some(one.closed? / one.closed_by_truth.filter(|truth| *truth > 0.0)?);
    Some(OfKind {
        kind,
        library,
        right_first: Rate::of(counting.iter().map(|one| one.right_first())),
        equivalent: found().filter(|effect| effect.equivalent).count(),
        unknown: Rate::of(counting.iter().filter(|one| !one.own_unknown).map(|one| one.unknown())),
        spurious: Rate::of(counting.iter().map(|one| one.spurious())),
        channels_exact: Rate::of(found().filter_map(|effect| effect.channels_exact)),
        closed: spread(counting.iter().filter_map(|one| one.closed)).map(|spread| spread.median),
        closed_of_truth: spread(counting.iter().filter_map(of_truth)).map(|spread| spread.median),
        location: spreads(found().flat_map(|effect: &Found| &effect.location)),
        parameters: spreads(found().flat_map(|effect: &Found| &effect.parameters)),
        curve: if library { bins(&CURVE, &sizes) } else { Vec::new() },
        size_50: limits.map(|[half, _]| half.size),
        size_90: limits.map(|[_, most]| most.size),
        detection: library.then(|| Detection::of(kind, &sizes)),
    })
}

fn spreads<'a, K: Ord + Clone + 'a>(lists: impl Iterator<Item = (&'a K, &'a Vec<f64>)>) -> BTreeMap<K, Spread> {
    let mut gathered: BTreeMap<K, Vec<f64>> = BTreeMap::new();
    for (name, errors) in lists {
        gathered.entry(name.clone()).or_default().extend(errors);
    }
    gathered.into_iter().filter_map(|(name, errors)| Some((name, spread(errors)?))).collect()
}

fn spread(values: impl IntoIterator<Item = f64>) -> Option<Spread> {
    let mut sorted: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let at = |part: f64| sorted[(part * last as f64).round() as usize];
    Some(Spread { count: sorted.len(), median: at(0.5), p90: at(0.9) })
}

/// How many are right between each two edges.
fn bins(edges: &[f64], values: &[(f64, bool)]) -> Vec<Bin> {
    let last = edges.len().saturating_sub(2);
    let bin = |(index, edge): (usize, &[f64])| {
        let (from, to) = (edge[0], edge[1]);
        let within = |value: f64| value >= from && (value < to || index == last);
        let held: Vec<&(f64, bool)> = values.iter().filter(|(value, _)| within(*value)).collect();
        let mean = held.iter().map(|(value, _)| value).sum::<f64>() / held.len() as f64;
        Bin { from, to, mean: mean.is_finite().then_some(mean), right: Rate::of(held.iter().map(|(_, right)| *right)) }
    };
    edges.windows(2).enumerate().map(bin).collect()
}

fn confusion(all: &[Judgement]) -> BTreeMap<String, BTreeMap<String, usize>> {
    let mut matrix: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for one in all.iter().filter(|one| one.class != Class::Pair && one.counts) {
        let truth = one.effects.first().map_or("none", |effect| effect.kind.name());
        let named = one.causes.first().map_or(one.verdict.as_str(), |cause| cause.effect.as_str());
        *matrix.entry(truth.to_owned()).or_default().entry(named.to_owned()).or_default() += 1;
    }
    matrix
}

fn reliability(all: &[Judgement]) -> Vec<Bin> {
    let named = all.iter().filter(|one| one.class != Class::Outside).flat_map(|one| &one.causes);
    let stated: Vec<(f64, bool)> = named.filter_map(|cause| Some((cause.confidence?, cause.right))).collect();
    bins(&CONFIDENCE, &stated)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judgement(case: usize, class: Class, kinds: &[Kind], verdict: &str, causes: &[(&str, bool)]) -> Judgement {
        let found = |kind: &Kind| Found {
            kind: *kind,
            over_limit: 2.0,
            named: causes.iter().any(|(name, right)| *right && kind.effect() == Some(*name)),
            equivalent: false,
            channels_exact: Some(true),
            location: BTreeMap::new(),
            parameters: BTreeMap::new(),
        };
        let named = |(name, right): &(&str, bool)| Named {
            effect: (*name).to_owned(),
            channels: Vec::new(),
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
            causes: causes.iter().map(named).collect(),
            effects: kinds.iter().map(found).collect(),
            closed: Some(0.9),
            closed_ci95: Some([0.85, 0.95]),
            closed_by_truth: Some(0.92),
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
        ];
        Score::of("test", 1, "", &all)
    }

    #[test]
    fn rates_are_those_of_reports_made_by_hand() {
        let rates = score().rates;
        let of = |rate: Rate| (rate.count, rate.of);
        assert_eq!(of(rates.right_first), (2, 3));
        assert_eq!(of(rates.right_first_or_none), (5, 7));
        assert_eq!(of(rates.none_named), (1, 4));
        assert_eq!(of(rates.none_unknown), (1, 4));
        assert_eq!(of(rates.library_unknown), (1, 5));
        assert_eq!(of(rates.spurious), (1, 5));
        assert_eq!(of(rates.both_found), (1, 2));
        assert_eq!(of(rates.both_exactly), (1, 2));
        assert_eq!(of(rates.outside_unknown), (1, 2));
        assert_eq!(of(rates.closed_covers), (5, 5));
        assert_eq!(score().rate("none_named"), Some(rates.none_named));
        assert_eq!(score().misses.iter().map(|miss| miss.case).collect::<Vec<_>>(), [2, 3, 5, 6, 8, 10]);
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
        assert_eq!(Score::of("", 1, "", &[]).calibration.expected_error, None);
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
        }
        let score = Score::of("test", 1, "", &all).on("desk", 3, &all);
        assert_eq!(
            [score.rates.none_unknown.of, score.rates.library_unknown.of, score.rates.outside_unknown.of],
            [0; 3]
        );
        assert_eq!((score.rates.right_first.count, score.rates.none_named.of), (1, 1));
        assert!(score.misses.is_empty(), "{:?}", score.misses);
        let on = score.on.unwrap();
        assert_eq!((on.stretches, on.own_causes, on.own_unknown.count), (3, 6, 3));
    }
}
