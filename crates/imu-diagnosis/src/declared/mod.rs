//! Declared effects: effects that a model has and its sensor lacks, or has with other numbers.

pub(crate) mod courses;
pub(crate) mod measured;
pub(crate) mod values;

use crate::confidence::confidence;
use crate::found::{Attribution, Findings};
use crate::report::Sense;
use crate::steps::Step;
use crate::translate::{LEAST_PASSED, Translated};
use imu_model::effects::{Comb, Effect, Tone};
use imu_model::simulator::ChannelModel;
use measured::MeasuredLine;
use std::sync::Arc;

/// A line of known frequency with this many nats is present.
const THERE: f64 = 6.0;

/// Returns the chance that noise alone puts one of the model's effects off by this many nats.
fn by_chance(nats: f64) -> f64 {
    /// Approximate number of such effects examined in a record.
    const LOOKED_AT: f64 = 100.0;
    (LOOKED_AT * (-nats).exp()).min(1.0)
}

/// Returns lines of the model that a channel lacks or has with other amplitudes.
pub(crate) fn of_lines(of: &Findings, model: &ChannelModel) -> Vec<Attribution> {
    let prepared = &of.prepared;
    let channel = prepared.channel;
    let attribution = |(place, effect): (usize, &Arc<dyn Effect>)| {
        let own: Vec<(f64, &MeasuredLine)> = prepared
            .lines
            .iter()
            .zip(&of.lines)
            .filter(|((of_effect, _), _)| *of_effect == place)
            .map(|((_, passed), line)| (prepared.scale / passed, line))
            .collect();
        if !own.iter().any(|(_, line)| line.is_off) {
            return None;
        }
        let otherwise: f64 = own.iter().map(|(_, line)| line.otherwise).sum();
        let is_there = own.iter().any(|(_, line)| line.there > THERE);
        let amplitudes: Vec<f64> = own.iter().map(|(unit, line)| unit * line.amplitude).collect();
        let (found, ci95): (Arc<dyn Effect>, _) = match (effect.number("frequency_hz"), effect.number("fundamental_hz"))
        {
            (Some(frequency_hz), _) => {
                let (unit, line) = own[0];
                let ends = [-1.96, 1.96].map(|far| (unit * (line.amplitude + far * line.error)).max(0.0));
                (Arc::new(Tone { frequency_hz, amplitude: amplitudes[0] }), vec![("amplitude", ends)])
            }
            (_, Some(fundamental_hz)) => (Arc::new(Comb { fundamental_hz, amplitudes }), Vec::new()),
            _ => return None,
        };
        if is_there && prepared.lines.iter().any(|(of_effect, passed)| *of_effect == place && *passed < LEAST_PASSED) {
            // Behind the model's filters, almost nothing remains of the line; a line on the channel has another cause.
            return None;
        }
        let difference = if is_there { "with another amplitude than the model's" } else { "without the model's line" };
        let evidence = format!("{channel}: {otherwise:.0} nats more {difference}, its phase fitted");
        Some(Attribution {
            p_value: by_chance(otherwise),
            confidence: 0.99,
            ci95: if is_there { ci95 } else { Vec::new() },
            ..values::attribution(channel, (place, effect), is_there.then_some(found), otherwise, evidence)
        })
    };
    model.effects.iter().enumerate().filter_map(attribution).collect()
}

/// Returns, for each found effect, the place of the model's effect that it stands for.
pub(crate) fn stands_for(found: &[Translated], steps: &[Step], model: &ChannelModel) -> Vec<Option<usize>> {
    let mut places = vec![None; found.len()];
    let changed = steps.iter().filter_map(|step| step.of_model.filter(|(_, sense)| *sense == Sense::Size));
    for (place, _) in changed {
        let Some(declared) = model.effects.get(place) else { continue };
        let hz = |effect: &dyn Effect| effect.number("frequency_hz").unwrap_or_default();
        let apart = |at: &usize| (hz(&*found[*at].effect) - hz(&**declared)).abs();
        let same = (0..found.len()).filter(|at| places[*at].is_none() && found[*at].effect.name() == declared.name());
        if let Some(at) = same.min_by(|a, b| apart(a).total_cmp(&apart(b))) {
            places[at] = Some(place);
        }
    }
    places
}

/// Returns the model's spectral effects that a channel lacks: the search left them out, and no effect that was found
/// stands for them.
pub(crate) fn left_out(
    of: &Findings,
    model: &ChannelModel,
    standing: &[Option<usize>],
    level: f64,
) -> Vec<Attribution> {
    let channel = of.prepared.channel;
    let superfluous = of.steps.iter().filter_map(|step| {
        let (place, _) = step.of_model.filter(|(place, _)| !standing.contains(&Some(*place)))?;
        let effect = model.effects.get(place)?;
        let next = step.others.first().map_or(0.0, |(_, score)| *score);
        let margin = step.gain - step.price - next;
        let evidence = format!(
            "{channel}: {:.0} nats more without the model's {} than with it, the noise fitted again; chance gives {:.0}",
            step.gain,
            effect.name(),
            step.price
        );
        Some(Attribution {
            p_value: step.chance(level),
            confidence: confidence(margin),
            ..values::attribution(channel, (place, effect), None, step.gain, evidence)
        })
    });
    superfluous.collect()
}

/// Returns the model's drifts, steps and changes of variance that a channel lacks or has with other numbers. The
/// channel's own are found separately.
pub(crate) fn of_courses(of: &Findings, model: &ChannelModel) -> Vec<Attribution> {
    let channel = of.prepared.channel;
    let attribution = |one: &courses::Off| {
        let (effect, gain) = (model.effects.get(one.place)?, one.otherwise);
        let evidence = format!("{channel}: {gain:.0} nats more with another {} than the model's", effect.name());
        let attribution = values::attribution(channel, (one.place, effect), None, gain, evidence);
        Some(Attribution { p_value: by_chance(gain), confidence: 0.99, ..attribution })
    };
    of.off.iter().filter_map(attribution).collect()
}

/// Returns whether a found effect agrees with the model: its numbers lie inside intervals that are half as wide again.
fn is_as_declared(found: &Attribution, declared: &dyn Effect) -> bool {
    let inside = |(name, [low, high]): &(&str, [f64; 2])| {
        let more = 0.25 * (high - low);
        declared.number(name).is_some_and(|value| (low - more..=high + more).contains(&value))
    };
    !found.ci95.is_empty() && found.ci95.iter().all(inside)
}

/// Merges pairs of an effect that the model has at one place and the sensor at another: each is one effect with other
/// numbers.
pub(crate) fn elsewhere(attributions: &mut Vec<Attribution>) {
    let mut at = 0;
    while at < attributions.len() {
        let same = |one: &Attribution| {
            let both = [attributions[at].sense, one.sense] == [Sense::Superfluous, Sense::Missing];
            both && one.channel == attributions[at].channel && one.effect.name() == attributions[at].effect.name()
        };
        // The nearest of several in frequency or time.
        let apart = |other: &usize| {
            let [one, other] = [at, *other].map(|place| &attributions[place].effect);
            let both = ["frequency_hz", "fundamental_hz", "at_s", "from_s"]
                .iter()
                .find_map(|name| Some(one.number(name)? - other.number(name)?));
            both.unwrap_or_default().abs()
        };
        let others = (0..attributions.len()).filter(|other| same(&attributions[*other]));
        let Some(other) = others.min_by(|a, b| apart(a).total_cmp(&apart(b))) else {
            at += 1;
            continue;
        };
        let lacked = attributions.remove(at);
        // The place moved down by one if it was behind the removed one.
        let other = other - usize::from(other > at);
        if lacked.declared.as_ref().is_some_and(|(_, declared)| is_as_declared(&attributions[other], &**declared)) {
            attributions.remove(other);
            at -= usize::from(other < at);
            continue;
        }
        let found = &mut attributions[other];
        (found.sense, found.declared) = (Sense::Size, lacked.declared);
        found.gain += lacked.gain;
        found.evidence.extend(lacked.evidence);
    }
}
