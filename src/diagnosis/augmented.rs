//! Augmented: the model with its parameters corrected and what was found.

use super::diagnose::{Findings, Found};
use super::law::{FLOOR_MATTERS, Term};
use super::named::Named;
use super::shared::Shared;
use crate::effects::{CommonMode, Effect};
use crate::simulator::SensorModel;
use std::sync::Arc;

/// Standard error of ln of a level, with no belief about it.
fn spread(of: &Findings, level: usize) -> Option<f64> {
    let variance = of.fitted.covariance.as_ref().map(|covariance| covariance[(level, level)])?;
    (variance.is_finite() && variance > 0.0).then(|| variance.sqrt())
}

/// The filters of a channel if there is so much white noise behind them that a model, which cannot have that, is better
/// without them.
pub(super) fn open_filters(of: &Findings) -> Vec<Box<dyn Effect>> {
    let filters = of.explanation.law.terms.iter().filter(|term| term.is_filter());
    let open = filters.clone().filter_map(Term::floor).any(|floor| floor.ln() > FLOOR_MATTERS);
    filters.filter(|_| open).filter_map(Term::effect).collect()
}

/// The model with what was found.
pub(super) fn augmented(found: &Found, sim: &SensorModel, named: &[Named]) -> SensorModel {
    let mut model = sim.clone();
    for of in &found.channels {
        let Some(channel) = model.channels.get_mut(&of.prepared.channel) else { continue };
        let level = |index: usize| (0.5 * of.explanation.law.levels[index]).exp() * of.prepared.scale;
        // The law's level is an average; the model's N is that where nothing changes the variance.
        channel.n = level(0) / of.average_variance.sqrt() / (0.5 * of.prepared.white_shift).exp();
        // Levels that are nowhere seen are none.
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
        let open = open_filters(of);
        if !open.is_empty() {
            // White noise as loud as what passes the filters and what is behind them, on average over the band.
            let passed = |f: f64| open.iter().map(|effect| effect.power_gain(f, sim.rate_hz)).product::<f64>();
            let bins = 500;
            let at = |bin: i32| passed((f64::from(bin) + 0.5) / f64::from(2 * bins) * sim.rate_hz);
            let gain = (0..bins).map(at).sum::<f64>() / f64::from(bins);
            let floor: f64 = of.explanation.law.terms.iter().filter_map(Term::floor).sum();
            channel.n *= (gain + floor).sqrt();
        }
        let left_out = |one: &&Named| open.iter().any(|effect| effect.name() == one.effect.name());
        for one in named.iter().filter(|one| one.channel == of.prepared.channel && !left_out(one)) {
            if one.effect.name() == "common_mode" {
                // The first of all channels have one source, the second another: earlier sources are not this channel's.
                let with = |shared: &Shared| {
                    shared.parts.iter().any(|(index, _)| found.channels[*index].prepared.channel == one.channel)
                };
                let before = found.shared.iter().position(with).unwrap_or(0);
                (0..before).for_each(|_| channel.push_effect(Arc::new(CommonMode { sigma: 0.0 }), &[]));
            }
            channel.push_effect(one.effect.clone(), &one.ci95);
            if let Some(common) = one.effect.parameters().iter().find(|(name, _)| *name == "sigma")
                && one.effect.name() == "common_mode"
                && let Some(sigma) = common.1.as_f64()
            {
                // What is shared was part of the white noise.
                channel.n = (channel.n * channel.n - sigma * sigma / sim.rate_hz).max(0.0).sqrt();
            }
        }
    }
    model
}
