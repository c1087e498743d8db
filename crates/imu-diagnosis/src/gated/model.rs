//! A model's lines and bands that come and go, and the found ones that stand for them.

use imu_model::effects::{Effect, EffectKind};
use imu_model::simulator::ChannelModel;
use std::sync::Arc;

/// A model's line or band that comes and goes.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct OfModel {
    /// Its place in the model's list.
    pub(crate) place: usize,
    /// Its frequency in cycles per sample.
    pub(crate) cycles: f64,
    /// The full width at half power in cycles per sample; none for a line.
    pub(crate) width: Option<f64>,
}

/// Returns a number of the effect that comes and goes; `None` for all other effects.
pub(super) fn number_of(effect: &dyn Effect, wanted: EffectKind, number: &str) -> Option<f64> {
    if effect.kind() != EffectKind::Intermittent {
        return None;
    }
    let of = effect.parameters().into_iter().find(|(name, _)| *name == "of")?.1;
    (of["effect"] == wanted.name()).then(|| of[number].as_f64()).flatten()
}

/// Returns whether an effect comes and goes at random times, which its model does not state.
fn is_random(effect: &dyn Effect) -> bool {
    effect.kind() == EffectKind::Intermittent && effect.pairs("intervals").is_empty()
}

/// Returns whether the search may look for sines that come and go: the times of the model's own are known.
pub(crate) fn are_known(model: &ChannelModel) -> bool {
    !model.effects.iter().any(|effect| is_random(&**effect))
}

/// Returns a model's bands that come and go, and its lines whose times it states.
pub(crate) fn of_model(model: &ChannelModel, rate_hz: f64) -> Vec<OfModel> {
    let of = |(place, effect): (usize, &Arc<dyn Effect>)| {
        let number = |kind: EffectKind, name: &str| number_of(&**effect, kind, name).map(|value| value / rate_hz);
        let line = number(EffectKind::Tone, "frequency_hz").filter(|_| !is_random(&**effect));
        line.map(|cycles| OfModel { place, cycles, width: None }).or_else(|| {
            let (cycles, width) =
                (number(EffectKind::Resonance, "frequency_hz")?, number(EffectKind::Resonance, "bandwidth_hz"));
            Some(OfModel { place, cycles, width })
        })
    };
    model.effects.iter().enumerate().filter_map(of).collect()
}

/// Returns the place of the model's sine that comes and goes for which a found one stands in a record of `samples` at a rate.
pub(crate) fn stands_for(of: &[OfModel], found: &dyn Effect, rate_hz: f64, samples: usize) -> Option<usize> {
    let cycles = number_of(found, EffectKind::Tone, "frequency_hz")? / rate_hz;
    let is_same = |of: &&OfModel| of.width.is_none() && are_same(of.cycles, cycles, samples);
    let nearest =
        of.iter().filter(is_same).min_by(|a, b| (a.cycles - cycles).abs().total_cmp(&(b.cycles - cycles).abs()));
    nearest.map(|of| of.place)
}

/// Returns whether a sine that was found agrees with a model's: its amplitude inside an interval that is half as wide again, and
/// its times apart by a small part. A model without times agrees with any.
pub(crate) fn is_as_declared(found: &dyn Effect, ci95: &[(&'static str, [f64; 2])], declared: &dyn Effect) -> bool {
    /// Largest part of all stays by which the times may differ.
    const OTHER: f64 = 0.05;
    let Some(amplitude) = number_of(declared, EffectKind::Tone, "amplitude") else { return false };
    let ends = ci95.iter().find(|(name, _)| *name == "of.amplitude").map(|(_, ends)| ends);
    let is_inside = |[low, high]: &[f64; 2]| (amplitude - 0.5 * (low + high)).abs() < 0.75 * (high - low);
    let [own, other] = [found, declared].map(|effect| effect.pairs("intervals"));
    let length = |of: &[(f64, f64)]| of.iter().map(|(from_s, to_s)| to_s - from_s).sum::<f64>();
    let common =
        |(from_s, to_s): &(f64, f64)| other.iter().map(|of| (to_s.min(of.1) - from_s.max(of.0)).max(0.0)).sum::<f64>();
    let apart_s = length(&own) + length(&other) - 2.0 * own.iter().map(common).sum::<f64>();
    ends.is_some_and(is_inside) && (other.is_empty() || apart_s < OTHER * (length(&own) + length(&other)))
}

/// Returns whether two frequencies in cycles per sample are those of one line in a record that is long enough to show when it comes
/// and goes.
pub(crate) fn are_same(one: f64, other: f64, samples: usize) -> bool {
    /// Part of a record over which the sines turn against each other at most once.
    const PART: f64 = 0.05;
    (one - other).abs() * PART * (samples as f64) < 1.0
}
