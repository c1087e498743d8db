//! Searched again: channels whose effects can stand for one another are searched again without one of them.
//!
//! The search adds one effect after the other, and an early choice can need further effects to make up for it: a boxcar and a
//! band for a filter of lower order, tails for a course of the variance. What the first half of the record predicts of the
//! second decides which of the explanations is kept ([`super::holdout`]), so that numbers of other forms can be compared. An
//! effect that only the first half has, or whose numbers it does not show, would not count; so the whole record has to agree.

use super::evidence::Kind;
use super::found::Findings;
use std::collections::{BTreeMap, BTreeSet};

/// A channel, and the kinds of effects that are not looked for on it.
pub(super) type Without = (usize, BTreeSet<Kind>);

/// The search again: returns the findings of some channels without some kinds; `None` if the diagnosis was cancelled.
pub(super) type Again<'a> = &'a dyn Fn(&[Without]) -> Option<Vec<Findings>>;

/// Returns how many channels may be searched again in a record of so many samples. Those effects come first that gain least.
pub(super) fn budget(samples: usize) -> usize {
    const SAMPLES_MAX: usize = 2_000_000;
    const SEARCHES_MAX: usize = 16;
    (SAMPLES_MAX / samples.max(1)).min(SEARCHES_MAX)
}

/// Kinds that can stand for one another: on the spectrum, on the distribution of single samples, and on the level.
const ALIKE: [&[Kind]; 3] = [
    &[Kind::LowPass, Kind::MovingAverage, Kind::Resonance, Kind::GaussMarkov, Kind::Slope, Kind::QuantizationNoise],
    &[
        Kind::HeavyTails,
        Kind::Spikes,
        Kind::Bursts,
        Kind::VarianceInterval,
        Kind::VarianceProfile,
        Kind::VariancePerDegree,
    ],
    &[Kind::RateRamp, Kind::WarmUp, Kind::TemperatureBias, Kind::TemperatureCurve, Kind::BiasStep],
];

/// Replaces findings by others with fewer effects that predict about as well; `None` if the diagnosis was cancelled. Channels whose
/// effects of the model differ from the record's are left as they are.
pub(super) fn with_fewer(channels: &mut [Findings], budget: &mut usize, again: Again<'_>) -> Option<()> {
    const ROUNDS: usize = 2;
    /// Nats that an effect may lose which others do not replace: its gain was by chance, or by errors of other effects.
    const CHANCE: f64 = 7.0;
    /// The largest part of what a channel's effects gain together that an effect may gain to be doubtful.
    const DOUBTFUL: f64 = 0.5;
    let mut open: Vec<usize> = (0..channels.len()).filter(|at| is_plain(&channels[*at])).collect();
    for _ in 0..ROUNDS {
        let of_channel = |at: usize| doubtful(&own(&channels[at])).into_iter().map(move |kind| (at, kind));
        let all = |at: usize| channels[at].steps.iter().map(|step| step.gain).sum::<f64>();
        let mut tries: Vec<(usize, Kind)> = open.iter().copied().flat_map(of_channel).collect();
        tries.retain(|(at, kind)| gain(&channels[*at], *kind) < DOUBTFUL * all(*at));
        tries.sort_by(|one, other| gain(&channels[one.0], one.1).total_cmp(&gain(&channels[other.0], other.1)));
        tries.truncate(*budget);
        *budget -= tries.len();
        let tries: Vec<Without> = tries.into_iter().map(|(at, kind)| (at, BTreeSet::from([kind]))).collect();
        let mut best: Vec<Option<(f64, Findings)>> = channels.iter().map(|_| None).collect();
        for ((at, _), found) in tries.iter().zip(again(&tries)?) {
            let (before, after) = (own(&channels[*at]), own(&found));
            let is_part = after.iter().all(|(kind, count)| before.get(kind).is_some_and(|of| count <= of));
            let least = if is_part { -CHANCE } else { 0.0 };
            let gained = gained(&found, &channels[*at]);
            let is_fewer = is_plain(&found) && after.values().sum::<usize>() < before.values().sum();
            if is_fewer && gained > least && best[*at].as_ref().is_none_or(|(most, _)| gained > *most) {
                best[*at] = Some((gained, found));
            }
        }
        open.clear();
        for (at, found) in best.into_iter().enumerate() {
            if let Some((_, found)) = found {
                channels[at] = found;
                open.push(at);
            }
        }
    }
    Some(())
}

/// Gives the channels one kind of filter: a device rarely has two. A boxcar of few samples and a Butterworth filter of the first
/// order differ little, and least beside strong slow noise; where samples are coarse, rounding hides the difference. The
/// channels with fine samples decide. A channel's other effects stay as they are named. `None` if the diagnosis was cancelled.
pub(super) fn with_one_filter(channels: &mut [Findings], budget: &mut usize, again: Again<'_>) -> Option<()> {
    /// Nats that a channel may lose for the kind of filter that the others have: with fine samples, with coarse ones.
    const LOSS_MAX: f64 = 12.0;
    const LOSS_MAX_COARSE: f64 = 200.0;
    let pair = [Kind::LowPass, Kind::MovingAverage];
    let swapped = |kind: Kind| -> Vec<Without> {
        let others = |at: usize| {
            let known = own(&channels[at]);
            let all = Kind::ALL.into_iter();
            all.filter(|of| *of == kind || !(known.contains_key(of) || pair.contains(of))).collect()
        };
        let places = (0..channels.len()).filter(|at| filter_of(&channels[*at]) == Some(kind));
        places.map(|at| (at, others(at))).collect()
    };
    let tries = pair.map(swapped);
    let count = tries.iter().map(Vec::len).sum::<usize>();
    let decides = tries.iter().flatten().any(|(at, _)| !is_coarse(&channels[*at]));
    if tries.iter().any(Vec::is_empty) || !decides || count > *budget {
        return Some(());
    }
    *budget -= count;
    let mut best: Option<(f64, Vec<(usize, Findings)>)> = None;
    for (tries, other) in tries.iter().zip(pair.into_iter().rev()) {
        let mut total = Some(0.0);
        let mut changed = Vec::new();
        for ((at, _), found) in tries.iter().zip(again(tries)?) {
            let now = &channels[*at];
            let (is_coarse, gained) = (is_coarse(now), gained(&found, now));
            let least = if is_coarse { -LOSS_MAX_COARSE } else { -LOSS_MAX };
            total = total.filter(|_| filter_of(&found) == Some(other) && gained > least);
            total = total.map(|total| total + if is_coarse { 0.0 } else { gained });
            changed.push((*at, found));
        }
        // All channels have to agree.
        if let Some(total) = total
            && best.as_ref().is_none_or(|(most, _)| total > *most)
        {
            best = Some((total, changed));
        }
    }
    for (at, found) in best.into_iter().flat_map(|(_, changed)| changed) {
        channels[at] = found;
    }
    Some(())
}

/// Returns the nats that another explanation gains: in what the first half predicts of the second, or in the whole record if it
/// loses there. Each effect counts its price in the latter.
fn gained(found: &Findings, now: &Findings) -> f64 {
    /// Nats that the whole record may lose: it has the numbers that were fitted to it.
    const FITTED: f64 = 10.0;
    let predicted = |of: &Findings| 2.0 * of.scores.effects.iter().sum::<f64>();
    let price = |of: &Findings| of.steps.iter().map(|step| step.price).sum::<f64>();
    let whole = |of: &Findings| of.nats - price(of);
    let more = whole(found) - whole(now);
    let ahead = predicted(found) - predicted(now);
    if more > -FITTED { ahead } else { ahead.min(more) }
}

/// Returns the nats that a kind gains on a channel.
fn gain(of: &Findings, kind: Kind) -> f64 {
    of.steps.iter().filter(|step| step.kind == kind).map(|step| step.gain).sum()
}

/// Returns the kinds of effects that the model lacks on a channel, and how many there are of each.
fn own(of: &Findings) -> BTreeMap<Kind, usize> {
    let mut all = BTreeMap::new();
    for step in of.steps.iter().filter(|step| step.of_model.is_none()) {
        *all.entry(step.kind).or_default() += 1;
    }
    all
}

/// Returns whether all effects of the model are as it states them, and hardly any samples are excluded: replaced samples are drawn
/// under each explanation, and favour it.
fn is_plain(of: &Findings) -> bool {
    const EXCLUDED: f64 = 0.01;
    let excluded = of.explanation.outliers.len() as f64 / of.prepared.samples.len().max(1) as f64;
    let is_stated = of.steps.iter().all(|step| step.of_model.is_none());
    is_stated && of.off.is_empty() && of.lines.iter().all(|line| !line.is_off) && excluded < EXCLUDED
}

/// Returns whether the values were drawn as they may have been before rounding, or are of steps that show.
fn is_coarse(of: &Findings) -> bool {
    /// A step that shows, in standard deviations of the white noise.
    const SHOWS: f64 = 0.4;
    of.prepared.facts.step.is_some_and(|step| step > SHOWS * of.white)
}

/// Returns the kinds beside which there is another that can stand for them.
fn doubtful(kinds: &BTreeMap<Kind, usize>) -> Vec<Kind> {
    let there =
        |group: &[Kind]| -> Vec<Kind> { group.iter().copied().filter(|kind| kinds.contains_key(kind)).collect() };
    ALIKE.into_iter().map(there).filter(|there| there.len() > 1).flatten().collect()
}

/// Returns the kind of a channel's only filter, if all else is plain ([`is_plain`]).
fn filter_of(of: &Findings) -> Option<Kind> {
    let is_filter = |kind: &Kind| matches!(kind, Kind::LowPass | Kind::MovingAverage);
    let own = own(of);
    let mut filters = own.keys().copied().filter(is_filter);
    match (filters.next(), filters.next()) {
        (Some(kind), None) if is_plain(of) => Some(kind),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cliffs::{WHITE, Wrong, diagnosed, names};
    use crate::round_trip::{model, recording};
    use crate::strong_effects::SAMPLES;
    use imu_core::sample::Channel;
    use imu_model::simulator::SensorModel;
    use serde_json::{Value, json};

    /// Returns a sensor whose first channels have these lists of effects.
    fn sensor(effects: &[Vec<Value>]) -> SensorModel {
        let mut sensor = model(None);
        for (channel, effects) in [Channel::AccelX, Channel::AccelY, Channel::AccelZ].into_iter().zip(effects) {
            for effect in effects {
                let own = model(Some(effect)).channels.remove(&Channel::AccelX).unwrap();
                sensor.channels.get_mut(&channel).unwrap().push_effect(own.effects[0].clone(), &[]);
            }
        }
        sensor
    }

    /// Expects the diagnosis of a sensor without effects to name these and no others.
    fn expect(wrong: &mut Wrong, effects: &[Vec<Value>], seed: u64, expected: &[&str]) {
        let found = diagnosed(&recording(&sensor(effects), seed, SAMPLES), &model(None));
        let mut named = names(&found);
        named.sort_unstable();
        wrong.expect(named == expected, || format!("seed {seed}: {named:?}, {:?}", found.diagnosis.summary));
    }

    /// Rounding to coarse steps hides which filter it is.
    #[test]
    fn channels_with_coarse_steps_have_the_filter_of_the_others() {
        let boxcar = json!({"effect": "moving_average", "window": 2, "white_behind": 2e-5});
        let mut wrong = Wrong::default();
        for (step, seed) in [(0.6, 1), (0.8, 2), (0.7, 3), (0.9, 4), (0.5, 5)] {
            let coarse = vec![boxcar.clone(), json!({"effect": "resolution", "step": step * WHITE})];
            let effects = [coarse.clone(), vec![boxcar.clone()], coarse];
            expect(&mut wrong, &effects, seed, &["moving_average", "resolution"]);
        }
        wrong.none();
    }

    /// On coarse channels alone neither kind may replace the other.
    #[test]
    fn coarse_channels_alone_keep_their_filters() {
        let coarse = json!({"effect": "resolution", "step": 0.6 * WHITE});
        let boxcar = json!({"effect": "moving_average", "window": 2, "white_behind": 2e-5});
        let mut wrong = Wrong::default();
        for (cutoff_hz, seed) in [(8.0, 2), (9.0, 3)] {
            let low_pass = json!({"effect": "low_pass", "cutoff_hz": cutoff_hz, "order": 1, "white_behind": 2e-5});
            let effects = [vec![low_pass, coarse.clone()], Vec::new(), vec![boxcar.clone(), coarse.clone()]];
            expect(&mut wrong, &effects, seed, &["low_pass", "moving_average", "resolution"]);
        }
        wrong.none();
    }

    /// The filter that makes two others necessary, in an order in which neither is worth its price alone.
    #[test]
    fn a_boxcar_and_a_low_pass_filter_are_both_found() {
        let mut wrong = Wrong::default();
        for (window, cutoff_hz, order, seed) in [(6, 12.0, 1, 1), (4, 8.0, 2, 2), (8, 10.0, 1, 3), (3, 7.6, 2, 4)] {
            let effects = vec![
                json!({"effect": "resonance", "frequency_hz": 5.1, "bandwidth_hz": 0.1, "sigma": 0.5 * WHITE}),
                json!({"effect": "moving_average", "window": window}),
                json!({"effect": "low_pass", "cutoff_hz": cutoff_hz, "order": order, "white_behind": 3e-5}),
            ];
            expect(&mut wrong, &[effects], seed, &["low_pass", "moving_average", "resonance"]);
        }
        wrong.none();
    }

    #[test]
    fn kinds_are_doubtful_beside_others_of_their_group_alone() {
        let of = |kinds: &[Kind]| doubtful(&kinds.iter().map(|kind| (*kind, 1)).collect());
        assert_eq!(of(&[Kind::LowPass, Kind::Tone, Kind::HeavyTails, Kind::RateRamp]), []);
        assert_eq!(
            of(&[Kind::LowPass, Kind::GaussMarkov, Kind::Bursts, Kind::Tone]),
            [Kind::LowPass, Kind::GaussMarkov]
        );
    }
}
