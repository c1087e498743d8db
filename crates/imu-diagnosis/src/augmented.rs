//! Augments a model: corrects its parameters and adds the effects that were found.

use super::course::Course;
use super::found::{Attribution, Findings, Found};
use super::report::Sense;
use super::shared::Shared;
use imu_core::sample::Channel;
use imu_model::effects::{CommonMode, Effect, EffectKind, SpectralNoise, Stage};
use imu_model::simulator::{ChannelModel, SensorModel};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Returns the standard error of ln of a level, without a prior on it.
fn spread(of: &Findings, level: usize) -> Option<f64> {
    let variance = of.fitted.covariance.as_ref().map(|covariance| covariance[(level, level)])?;
    (variance.is_finite() && variance > 0.0).then(|| variance.sqrt())
}

/// Subtracts shared noise, of a given standard deviation per sample, from a channel's N.
fn without_shared(channel: &mut ChannelModel, sigma: f64, internal_hz: f64) {
    let own = |n: f64| (n * n - sigma * sigma / internal_hz).max(0.0).sqrt();
    let known = channel.interval("N");
    channel.n = own(channel.n);
    if let Some(ends) = known {
        channel.set_interval("N", ends.map(own));
    }
}

/// Returns the model with the effects that were found. On channels on which something `remains`, the model also
/// receives the density of this remainder, as far as that density is louder than the model's.
pub(super) fn augmented(
    found: &Found,
    sim: &SensorModel,
    attributions: &[Attribution],
    remains: &BTreeSet<Channel>,
) -> SensorModel {
    let mut model = sim.clone();
    let internal_hz = sim.internal_rate_hz(sim.rate_hz);
    for of in &found.channels {
        let Some(channel) = model.channels.get_mut(&of.prepared.channel) else { continue };
        let level = |index: usize| (0.5 * of.explanation.law.levels[index]).exp() * of.prepared.scale;
        // The law's level is an average; the model's N is the level at times when nothing changes the variance.
        channel.n = level(0) / of.average_variance.sqrt() / (0.5 * of.prepared.white_shift).exp();
        // A level that is identified on no channel is set to 0.
        let seen = |index: usize| of.explanation.law.levels[index] > [-30.0, -20.0, -34.0][index];
        channel.b = if seen(1) { level(1) } else { 0.0 };
        channel.k = if seen(2) { level(2) } else { 0.0 };
        channel.uncertainty = None;
        for (index, parameter) in [(0, "N"), (1, "B"), (2, "K")] {
            let value = [channel.n, channel.b, channel.k][index];
            if let Some(spread) = spread(of, index).filter(|spread| *spread < 1.0 && value > 0.0) {
                let factor = (0.98 * spread).exp();
                channel.set_interval(parameter, [value / factor, value * factor]);
            }
        }
        let own = || attributions.iter().filter(|one| one.channel == of.prepared.channel);
        // The law's white noise includes the noise that the model shares with other channels.
        let is_common = |effect: &Arc<dyn Effect>| effect.kind() == EffectKind::CommonMode;
        let is_off = own().any(|one| one.declared.as_ref().is_some_and(|(_, of)| is_common(of)));
        let shared = channel.effects.iter().filter(|effect| is_common(effect) && !is_off);
        let sigmas: Vec<f64> = shared.filter_map(|effect| effect.number("sigma")).collect();
        sigmas.into_iter().for_each(|sigma| without_shared(channel, sigma, internal_hz));
        for one in own().filter(|one| one.sense != Sense::Superfluous) {
            if one.effect.kind() == EffectKind::CommonMode {
                // The first shared noise of all channels has one source, the second another: earlier sources are not this
                // channel's.
                let with = |shared: &Shared| {
                    shared.parts.iter().any(|part| found.channels[part.index].prepared.channel == one.channel)
                };
                let before = found.shared.iter().position(with).unwrap_or(0);
                (0..before).for_each(|_| channel.push_effect(Arc::new(CommonMode { sigma: 0.0 }), &[]));
            }
            // A model states intervals of an effect's own parameters, not of those of the effect that comes and goes.
            let is_own = |(name, _): &&(&str, [f64; 2])| !name.contains('.');
            let ci95: Vec<(&str, [f64; 2])> = one.ci95.iter().filter(is_own).copied().collect();
            channel.push_effect(one.effect.clone(), &ci95);
            if one.effect.kind() == EffectKind::CommonMode
                && let Some(sigma) = one.effect.number("sigma")
            {
                without_shared(channel, sigma, internal_hz);
            }
        }
        if remains.contains(&of.prepared.channel) && !of.nameless.is_empty() {
            let square = of.prepared.scale.powi(2);
            let density = of.nameless.iter().map(|(hz, density)| (*hz, density * square)).collect();
            channel.push_effect(Arc::new(SpectralNoise { density, level: Vec::new() }), &[]);
        }
        // Removes the effects that the model states wrongly, from last to first, so that places stay valid.
        let gone: BTreeSet<usize> = own().filter_map(|one| Some(one.declared.as_ref()?.0)).collect();
        gone.into_iter().rev().for_each(|place| drop(channel.remove_effect(place)));
        // Limits and transmitted values stay where they are; an effect that shifts the level needs the level before it.
        let stages = || channel.effects.iter().map(|effect| effect.stage());
        let limited = stages().any(|stage| stage == Stage::Saturation);
        let shifted = stages().any(|stage| matches!(stage, Stage::Bias | Stage::Resolution));
        if limited || (shifted && channel.bias.is_none()) {
            channel.bias = Some(of.level - before_ramp(of));
        }
    }
    model
}

/// Returns the mean of a ramp relative to the course that stands for it, U. The ramp begins at 0, the course's mean is
/// 0.
fn before_ramp(of: &Findings) -> f64 {
    let ramps = of.explanation.courses.iter().filter(|(course, _)| *course == Course::Ramp);
    0.5 * of.prepared.scale * ramps.map(|(_, factor)| factor).sum::<f64>()
}
