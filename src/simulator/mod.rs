//! The simulator: a sensor model, a seed and a rate in, endless samples out. Pure.
//!
//! Per channel it adds bias, random walk, flicker and white noise, each from a random stream of its own
//! ([`crate::effects::stream`]): the same model, seed, rate and record length give the same values on every run.
//! Memory is bounded: one block of [`BLOCK`] samples per channel, however long it runs.
//!
//! Channels that the model does not name are absent.

pub mod default_model;
pub mod model;

pub use default_model::default_model;
pub use model::{ChannelModel, ModelError, SensorModel};

use crate::effects::{Effect, Flicker, RandomWalk, Sampler, Stream, StreamId, White};
use crate::sample::{Channel, ChannelSet};

/// Samples per channel that are made at a time.
pub const BLOCK: usize = 512;

/// Numbers of the effects' streams; see [`crate::effects::stream`].
const WHITE_STREAM: u16 = 1;
const FLICKER_STREAM: u16 = 2;
const RANDOM_WALK_STREAM: u16 = 3;

/// Why a simulation was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimulatorError {
    /// The rate is not a number above 0.
    #[error("cannot simulate at {found} Hz: the rate must be a finite number above 0")]
    Rate {
        /// The rate as it was given.
        found: f64,
    },
    /// The record's length is not a number above 0.
    #[error("cannot simulate {found} s: the record's length must be a finite number above 0")]
    RecordLength {
        /// The length as it was given.
        found: f64,
    },
}

/// One channel's error sources in the order in which they act.
#[derive(Debug)]
struct Source {
    channel: Channel,
    bias: f64,
    samplers: Vec<Box<dyn Sampler>>,
    block: Vec<f64>,
}

/// A running simulation.
#[derive(Debug)]
pub struct Simulator {
    rate_hz: f64,
    channels: ChannelSet,
    sources: Vec<Source>,
    /// Samples of the present block that were given out.
    given: usize,
}

impl Simulator {
    /// A simulation of `model` at `rate_hz` from its first sample. Spectra hold down to 1/`record_length_s`; the simulation
    /// may run longer.
    ///
    /// # Errors
    /// [`SimulatorError`] for a rate or length that is not a finite number above 0.
    pub fn new(model: &SensorModel, seed: u64, rate_hz: f64, record_length_s: f64) -> Result<Self, SimulatorError> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        if !positive(rate_hz) {
            return Err(SimulatorError::Rate { found: rate_hz });
        }
        if !positive(record_length_s) {
            return Err(SimulatorError::RecordLength { found: record_length_s });
        }
        let sources: Vec<Source> = model
            .channels
            .iter()
            .map(|(channel, parameters)| Source {
                channel: *channel,
                bias: parameters.bias.unwrap_or(0.0),
                samplers: effects(parameters)
                    .into_iter()
                    .map(|(number, effect)| {
                        let id = StreamId { owner: *channel as u32, effect: number, instance: 0 };
                        effect.sampler(rate_hz, record_length_s, Stream::new(seed, id))
                    })
                    .collect(),
                block: vec![0.0; BLOCK],
            })
            .collect();
        let channels = model.channels.keys().copied().collect();
        Ok(Self { rate_hz, channels, sources, given: BLOCK })
    }

    /// The channels that the model gives.
    #[must_use]
    pub fn channels(&self) -> ChannelSet {
        self.channels
    }

    /// Samples per second.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// The next sample: one value per channel in column order and the channel's unit, 0 where the model has none.
    pub fn next_values(&mut self) -> [f64; Channel::COUNT] {
        if self.given == BLOCK {
            self.make_block();
        }
        let mut values = [0.0; Channel::COUNT];
        for source in &self.sources {
            values[source.channel as usize] = source.block[self.given];
        }
        self.given += 1;
        values
    }

    fn make_block(&mut self) {
        for source in &mut self.sources {
            source.block.fill(source.bias);
            for sampler in &mut source.samplers {
                sampler.apply(&mut source.block);
            }
        }
        self.given = 0;
    }
}

/// A channel's effects with the numbers of their streams, in the order in which they act.
fn effects(parameters: &ChannelModel) -> Vec<(u16, Box<dyn Effect>)> {
    let mut effects: Vec<(u16, Box<dyn Effect>)> = Vec::new();
    if parameters.k > 0.0 {
        effects.push((RANDOM_WALK_STREAM, Box::new(RandomWalk { k: parameters.k })));
    }
    if parameters.b > 0.0 {
        effects.push((FLICKER_STREAM, Box::new(Flicker { b: parameters.b })));
    }
    if parameters.n > 0.0 {
        effects.push((WHITE_STREAM, Box::new(White { n: parameters.n })));
    }
    effects
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_channel(channel: Channel, parameters: ChannelModel) -> SensorModel {
        SensorModel { name: "test".into(), rate_hz: 40.0, channels: [(channel, parameters)].into() }
    }

    #[test]
    fn the_same_seed_gives_the_same_values_and_another_seed_others() {
        let model = default_model();
        let run = |seed| {
            let mut simulator = Simulator::new(&model, seed, 40.0, 18_000.0).unwrap();
            (0..2000).map(|_| simulator.next_values()).collect::<Vec<_>>()
        };
        let reference = run(1);
        assert_eq!(run(1), reference);
        let other = run(2);
        for channel in Channel::ALL {
            assert_ne!(other[100][channel as usize], reference[100][channel as usize], "{channel}");
        }
    }

    #[test]
    fn a_channel_does_not_change_when_another_one_or_another_effect_is_added() {
        let white = ChannelModel { n: 1e-3, ..ChannelModel::default() };
        let alone = one_channel(Channel::GyroX, white);
        let mut together = alone.clone();
        together.channels.insert(Channel::GyroY, white);
        together.channels.insert(Channel::GyroX, ChannelModel { bias: Some(1.0), ..white });
        let mut alone = Simulator::new(&alone, 5, 40.0, 100.0).unwrap();
        let mut together = Simulator::new(&together, 5, 40.0, 100.0).unwrap();
        for _ in 0..1000 {
            let (a, b) = (alone.next_values(), together.next_values());
            assert!((a[Channel::GyroX as usize] + 1.0 - b[Channel::GyroX as usize]).abs() < 1e-12);
            assert_ne!(b[Channel::GyroX as usize] - 1.0, b[Channel::GyroY as usize]);
        }
    }

    #[test]
    fn channels_that_the_model_does_not_name_are_absent() {
        let model = one_channel(Channel::AccelZ, ChannelModel { bias: Some(-9.8), ..ChannelModel::default() });
        let mut simulator = Simulator::new(&model, 1, 40.0, 10.0).unwrap();
        assert_eq!(simulator.channels().iter().collect::<Vec<_>>(), [Channel::AccelZ]);
        let values = simulator.next_values();
        assert_eq!(values[Channel::AccelZ as usize], -9.8);
        assert_eq!(values.iter().filter(|value| **value != 0.0).count(), 1);
    }

    #[test]
    fn a_rate_or_length_that_is_no_positive_number_is_refused() {
        for rate_hz in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let refused = Simulator::new(&default_model(), 1, rate_hz, 10.0);
            assert!(matches!(refused, Err(SimulatorError::Rate { .. })), "{rate_hz}");
        }
        assert!(matches!(Simulator::new(&default_model(), 1, 40.0, 0.0), Err(SimulatorError::RecordLength { .. })));
    }

    #[test]
    fn white_noise_of_every_channel_is_independent_of_the_others() {
        let mut model = default_model();
        for parameters in model.channels.values_mut() {
            *parameters = ChannelModel { n: 1.0, ..ChannelModel::default() };
        }
        let mut simulator = Simulator::new(&model, 9, 1.0, 20_000.0).unwrap();
        let n = 20_000;
        let mut products = [[0.0; Channel::COUNT]; Channel::COUNT];
        for _ in 0..n {
            let values = simulator.next_values();
            for i in 0..Channel::COUNT {
                for j in 0..i {
                    products[i][j] += values[i] * values[j];
                }
            }
        }
        for (i, row) in products.iter().enumerate() {
            for product in &row[..i] {
                assert!((product / f64::from(n)).abs() < 5.0 / f64::from(n).sqrt());
            }
        }
    }
}
