//! The score of a kind of effect that is alone in its case.

use super::class::Sense;
use super::detection::{Detection, limits};
use super::interval::Rate;
use super::judge::{Found, Judgement};
use super::kind::Kind;
use serde::Serialize;
use std::collections::BTreeMap;

/// Edges of the bins of sizes over the limit for detection; the last bin is open.
const CURVE: [f64; 11] = [0.5, 0.7, 1.0, 1.5, 2.2, 3.3, 5.0, 10.0, 20.0, 50.0, f64::INFINITY];

/// A stretch of a curve or a class of confidences.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bin {
    /// The lower edge.
    pub from: f64,
    /// The upper edge; the last one is included. Infinite, in JSON null, if the bin is open.
    pub to: f64,
    /// Mean of the bin's contents.
    pub mean: Option<f64>,
    /// The share that is right.
    pub right: Rate,
}

impl Bin {
    /// Returns the edges in words.
    pub fn label(&self) -> String {
        if self.to.is_finite() { format!("{}–{}", self.from, self.to) } else { format!("above {}", self.from) }
    }
}

/// The median and a high quantile of some errors, with their number.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// The number of errors.
    pub count: usize,
    /// The median.
    pub median: f64,
    /// The value below which nine of ten stay.
    pub p90: f64,
}

/// The score of one kind of effect, alone in its case.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OfKind {
    /// The kind.
    pub kind: Kind,
    /// Whether the library has the kind.
    pub library: bool,
    /// Cases whose first cause is the effect (never for effects outside the library).
    pub right_first: Rate,
    /// Number of these under another name or form of the same law.
    pub equivalent: usize,
    /// Cases reported as unknown.
    pub unknown: Rate,
    /// Cases with a wrong cause.
    pub spurious: Rate,
    /// Cases with exactly the effect's channels.
    pub channels_exact: Rate,
    /// Median of the closed part of the gap.
    pub closed: Option<f64>,
    /// Median of the part that the true effect closes.
    pub closed_of_truth: Option<f64>,
    /// Errors of place: `frequency_bins` (1/length), `at_s`, `edge_s`.
    pub location: BTreeMap<&'static str, Spread>,
    /// Relative errors of parameters.
    pub parameters: BTreeMap<String, Spread>,
    /// Share right by size over the limit, for all sizes.
    pub curve: Vec<Bin>,
    /// Size over the limit at which half are right, from a logistic curve through all cases; none if nearly all or none
    /// are right.
    pub size_50: Option<f64>,
    /// Size over the limit at which 90 % are right.
    pub size_90: Option<f64>,
    /// The same sizes in the kind's own unit, with intervals, beside the lower bound of every test.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detection: Option<Detection>,
}

impl OfKind {
    /// Computes the score from all judgements; `None` if the kind is alone in no case.
    pub fn of(kind: Kind, all: &[Judgement]) -> Option<Self> {
        let alone = |one: &&Judgement| matches!(one.effects.as_slice(), [only] if only.kind == kind && only.sense == Sense::Missing);
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
        Some(Self {
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

/// Returns how many are right between each pair of edges.
pub(super) fn bins(edges: &[f64], values: &[(f64, bool)]) -> Vec<Bin> {
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
