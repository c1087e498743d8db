//! One channel's chain: from its response to a motion (or its level at rest) to the sent values.

use super::model::SensorModel;
use crate::effects::moving_average::RunningMean;
use crate::effects::stream::{SENSOR_OWNER, triad_owner};
use crate::effects::{
    Effect, EffectKind, Flicker, RandomWalk, Sampler, Saturation, Scope, Stage, Stream, StreamId, Temperature, White,
};
use imu_core::sample::Channel;
use std::collections::BTreeMap;
use std::sync::Arc;

/// An effect, and its index among several of its kind.
pub type Numbered = (Arc<dyn Effect>, u16);

/// The subject of a simulation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Terms {
    pub(super) seed: u64,
    pub(super) rate_hz: f64,
    pub(super) internal_rate_hz: f64,
    /// Internal samples per sent sample.
    pub(super) ratio: usize,
    pub(super) record_length_s: f64,
}

/// The level of a channel before its own effects, over a block of internal samples.
#[derive(Debug, Clone, Copy)]
pub(super) enum Level<'a> {
    /// The level is 0, so that the bias is the level.
    Rest,
    /// The response to the motion; the bias is added.
    Response(&'a [f64]),
    /// The temperature itself, in place of the bias.
    Course(&'a [f64]),
}

/// The samplers of one channel in the order in which they act.
#[derive(Debug)]
pub(super) struct Chain {
    pub(super) channel: Channel,
    bias: f64,
    /// Bias effects, then K and B.
    before_white: Vec<Box<dyn Sampler>>,
    white: Option<Box<dyn Sampler>>,
    white_shapes: Vec<Box<dyn Sampler>>,
    /// Further noise, bandwidth, saturation.
    after_white: Vec<Box<dyn Sampler>>,
    boxcar: RunningMean,
    ratio: usize,
    /// Resolution and holding.
    sent: Vec<Box<dyn Sampler>>,
    internal: Vec<f64>,
    white_block: Vec<f64>,
    /// The values sent in the last block.
    pub(super) output: Vec<f64>,
}

/// Returns a channel's own effects in the chain's order, each with its index among those of its kind.
pub(super) fn in_order(effects: &[Arc<dyn Effect>]) -> Vec<Numbered> {
    let mut counts: BTreeMap<EffectKind, u16> = BTreeMap::new();
    let mut numbered: Vec<Numbered> = effects
        .iter()
        .map(|effect| {
            let count = counts.entry(effect.kind()).or_default();
            *count += 1;
            (Arc::clone(effect), *count - 1)
        })
        .collect();
    numbered.sort_by_key(|(effect, instance)| (effect.stage(), effect.kind(), *instance));
    numbered
}

/// Returns all effects that act on `channel`, in the chain's order: its own, and those that another channel names for the
/// whole triad.
pub fn effects_on(model: &SensorModel, channel: Channel) -> Vec<Numbered> {
    let own = model.channels.get(&channel).map(|parameters| in_order(&parameters.effects)).unwrap_or_default();
    let of_triad =
        |other: &Channel| *other == channel || (channel.triad().is_some() && other.triad() == channel.triad());
    let shared = model.channels.iter().filter(|(other, _)| of_triad(other)).flat_map(|(_, parameters)| {
        in_order(&parameters.effects).into_iter().filter(|(effect, _)| effect.scope() == Scope::Triad)
    });
    let mut all: Vec<Numbered> = own.into_iter().filter(|(effect, _)| effect.scope() != Scope::Triad).collect();
    for (effect, instance) in shared {
        if !all.iter().any(|(known, number)| known.kind() == effect.kind() && *number == instance) {
            all.push((effect, instance));
        }
    }
    all.sort_by_key(|(effect, instance)| (effect.stage(), effect.kind(), *instance));
    all
}

impl Chain {
    pub(super) fn new(model: &SensorModel, channel: Channel, terms: Terms) -> Self {
        let parameters = model.channels.get(&channel).cloned().unwrap_or_default();
        let sampler = |effect: &dyn Effect, instance: u16| {
            let owner = match (effect.scope(), channel.triad()) {
                (Scope::Triad, Some(triad)) => triad_owner(triad),
                (Scope::Channel | Scope::Triad, _) => channel as u32,
                (Scope::Sensor, _) => SENSOR_OWNER,
            };
            let rate_hz = if effect.stage().is_internal() { terms.internal_rate_hz } else { terms.rate_hz };
            let id = StreamId { owner, effect: effect.spec().stream, instance };
            effect.sampler(rate_hz, terms.record_length_s, Stream::new(terms.seed, id))
        };
        let all = effects_on(model, channel);
        let of = |from: Stage, to: Stage| -> Vec<Box<dyn Sampler>> {
            let within = all.iter().filter(|(effect, _)| (from..=to).contains(&effect.stage()));
            within.map(|(effect, instance)| sampler(effect.as_ref(), *instance)).collect()
        };
        let mut before_white = of(Stage::Bias, Stage::Bias);
        if parameters.k > 0.0 {
            before_white.push(sampler(&RandomWalk { k: parameters.k }, 0));
        }
        if parameters.b > 0.0 {
            before_white.push(sampler(&Flicker { b: parameters.b }, 0));
        }
        let mut after_white = of(Stage::Noise, Stage::Saturation);
        let triad = channel.triad().and_then(|triad| model.triads.get(&triad));
        for range in triad.iter().flat_map(|triad| &triad.effects).filter_map(|effect| effect.range()) {
            after_white.push(sampler(&Saturation { low: -range, high: range }, 0));
        }
        Self {
            channel,
            bias: parameters.bias.unwrap_or(0.0),
            before_white,
            white: (parameters.n > 0.0).then(|| sampler(&White { n: parameters.n }, 0)),
            white_shapes: of(Stage::WhitePart, Stage::WhitePart),
            after_white,
            boxcar: RunningMean::new(model.sampling.map_or(1, |sampling| sampling.filter_window)),
            ratio: terms.ratio,
            sent: of(Stage::Resolution, Stage::Hold),
            internal: Vec::new(),
            white_block: Vec::new(),
            output: Vec::new(),
        }
    }

    /// Computes the next `count` internal samples (a multiple of the ratio) and the samples sent from them.
    pub(super) fn run(&mut self, count: usize, level: Level<'_>, temperature: Temperature<'_>) {
        self.internal.clear();
        match level {
            Level::Rest => self.internal.resize(count, self.bias),
            Level::Response(values) => self.internal.extend(values.iter().map(|value| value + self.bias)),
            Level::Course(values) => self.internal.extend_from_slice(values),
        }
        for sampler in &mut self.before_white {
            sampler.act(&mut self.internal, temperature);
        }
        if let Some(white) = &mut self.white {
            if self.white_shapes.is_empty() {
                white.act(&mut self.internal, temperature);
            } else {
                self.white_block.clear();
                self.white_block.resize(count, 0.0);
                white.act(&mut self.white_block, temperature);
                for shape in &mut self.white_shapes {
                    shape.act(&mut self.white_block, temperature);
                }
                for (value, white) in self.internal.iter_mut().zip(&self.white_block) {
                    *value += white;
                }
            }
        }
        for sampler in &mut self.after_white {
            sampler.act(&mut self.internal, temperature);
        }
        self.output.clear();
        for period in self.internal.chunks_exact(self.ratio) {
            // A sample is sent at the first internal sample of its period; it is the mean of the last ones up to that.
            for (place, value) in period.iter().enumerate() {
                let mean = self.boxcar.next(*value);
                if place == 0 {
                    self.output.push(mean);
                }
            }
        }
        // The stages after sampling do not depend on temperature.
        for sampler in &mut self.sent {
            sampler.apply(&mut self.output);
        }
    }
}
