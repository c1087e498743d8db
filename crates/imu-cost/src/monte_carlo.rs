//! Monte Carlo: integrals of simulated samples, for what has no closed form.
//!
//! In: a model, a number of runs, a seed. Out: the integrals of each run. Run k has the seed of the request plus k; the
//! simulator's random streams are ChaCha8 ([`imu_model::effects::stream`]).

use crate::courses::{Integrals, simulator};
use crate::quadrature::scale;
use crate::request::{CostError, Quantity, Setting};
use crate::sources::{ChannelSources, Source, restricted};
use crate::weights::{ORDERS, Strapdown};
use imu_core::sample::Channel;
use imu_model::simulator::SensorModel;

/// Returns the integrals of each channel in one run.
fn run(
    setting: &Setting<'_>,
    model: &SensorModel,
    channels: &[Channel],
    seed: u64,
) -> Result<Vec<Integrals>, CostError> {
    let mut simulator = simulator(setting, model, seed)?;
    let mut states: Vec<Strapdown> = channels.iter().map(|_| Strapdown::new(setting.align)).collect();
    let mut found: Vec<Integrals> = channels.iter().map(|_| Vec::with_capacity(setting.horizons.len())).collect();
    let (mut before, mut taken) = (setting.begin, 0);
    while taken < setting.samples() {
        let Some(block) = simulator.next_block() else { break };
        for place in 0..block.len() {
            if before > 0 {
                before -= 1;
                continue;
            }
            taken += 1;
            for ((channel, state), found) in channels.iter().zip(&mut states).zip(&mut found) {
                let value = block.values(*channel).and_then(|values| values.get(place)).copied();
                let now = state.push(value.unwrap_or(0.0));
                if setting.horizons.get(found.len()).is_some_and(|horizon| setting.align + horizon == taken) {
                    found.push([1, 2, 3].map(|order: usize| now[order - 1] * scale(order, setting.rate_hz)));
                }
            }
        }
    }
    Ok(found)
}

/// Returns the mean squares of the integrals of a source alone.
pub(crate) fn simulated(setting: &Setting<'_>, of: &ChannelSources, source: &Source) -> Result<Integrals, CostError> {
    let model = of.alone(setting.model, &source.effect);
    let mut sums = vec![[0.0; ORDERS]; setting.horizons.len()];
    for seed in 0..setting.runs as u64 {
        let found = run(setting, &model, &[of.channel], setting.seed.wrapping_add(seed))?;
        for (sums, values) in sums.iter_mut().zip(found.iter().flatten()) {
            for (sum, value) in sums.iter_mut().zip(values) {
                *sum += value * value / setting.runs as f64;
            }
        }
    }
    Ok(sums)
}

/// Returns the values of quantities of the whole model: by quantity and horizon, one per run.
pub(crate) fn quantities(setting: &Setting<'_>, of: &[Quantity]) -> Result<Vec<Vec<Vec<f64>>>, CostError> {
    let mut channels: Vec<Channel> =
        of.iter().flat_map(|quantity| quantity.shares()).map(|share| share.channel).collect();
    channels.sort_unstable();
    channels.dedup();
    channels.retain(|channel| setting.model.channels.contains_key(channel));
    let model = restricted(setting.model, &channels);
    let mut values = vec![vec![Vec::with_capacity(setting.runs); setting.horizons.len()]; of.len()];
    for seed in 0..setting.runs as u64 {
        let found = run(setting, &model, &channels, setting.seed.wrapping_add(seed))?;
        for (quantity, values) in of.iter().zip(&mut values) {
            for (place, values) in values.iter_mut().enumerate() {
                let part = |share: &crate::request::Share| {
                    let own = channels.iter().position(|channel| *channel == share.channel)?;
                    Some(share.factor * found.get(own)?.get(place)?[share.order - 1])
                };
                values.push(quantity.shares().iter().filter_map(part).sum());
            }
        }
    }
    Ok(values)
}
