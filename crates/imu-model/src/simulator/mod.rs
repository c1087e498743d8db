//! The simulator: turns a sensor model, a seed and a rate into endless samples. Pure.
//!
//! The chain follows the physical order ([`crate::effects::Stage`]): reference motion → latency → misalignment and cross-axis
//! sensitivity → scale factor and nonlinearity → bias, temperature, g-sensitivity → noise → bandwidth → saturation → sampling
//! (the sensor's boxcar and decimation, so that faster noise folds) → resolution → held samples → stamps and lost samples.
//! Without a motion the sensor is at rest and its output is its biases.
//!
//! Every effect draws from a separate random stream ([`crate::effects::stream`]): the same model, seed, rate and record length
//! give the same values on every run, on any number of threads.
//!
//! **Temperature.** The sensor's temperature is that of [`Simulator::with_temperature`], else that of the motion, else
//! constant: the temperature channel's bias, or 25 °C if the model has none. If it is not constant, the temperature
//! channel shows it in place of the channel's bias, plus the channel's noise.
//!
//! Memory is bounded for any length: a block of [`BLOCK`] internal samples per channel ([`THREADED_BLOCK`] on several threads),
//! at least one sample sent.
//!
//! Channels that the model does not name are absent. Attitude, magnetometer and pressure do not follow the motion.

mod chain;
pub mod default_model;
pub mod model;
pub mod records;
pub mod reference;
pub mod response;
pub mod spectrum;
#[cfg(test)]
mod whole;

pub use chain::{Numbered, effects_on};
pub use default_model::default_model;
pub use model::{ChannelModel, Fault, ModelError, Sampling, SensorModel, TriadModel};
pub use reference::{Motion, Reference, TemperatureCourse};
pub use spectrum::{Spectrum, plateau};

use crate::effects::stream::SENSOR_OWNER;
use crate::effects::timing::LOSS_STREAM;
use crate::effects::{EffectKind, Stream, StreamId, Temperature, Timing, USUAL_TEMPERATURE_C};
use chain::{Chain, Level, Terms};
use imu_core::sample::{Channel, ChannelSet, Triad};
use response::Response;

/// Number of internal samples per channel that are computed at a time.
pub const BLOCK: usize = 512;
/// The number of internal samples per channel that several threads compute at a time: enough work for each to outweigh
/// its start.
pub const THREADED_BLOCK: usize = 16_384;

/// The reason why a simulation was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SimulatorError {
    /// The rate is not a number above 0.
    #[error("cannot simulate at {found} Hz: the rate must be a finite number above 0")]
    Rate {
        /// The given rate.
        found: f64,
    },
    /// The record's length is not a number above 0.
    #[error("cannot simulate {found} s: the record's length must be a finite number above 0")]
    RecordLength {
        /// The given length.
        found: f64,
    },
    /// An entry of the model is not valid, at all or at this rate.
    #[error("cannot simulate `{model}` at {rate_hz} Hz: {fault}")]
    Model {
        /// The model's name.
        model: String,
        /// The output's rate.
        rate_hz: f64,
        /// The fault and its place.
        fault: Fault,
    },
}

/// One sample as it would be recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedSample {
    /// The sample's number from 0, including lost samples.
    pub index: u64,
    /// The sample's stamp, s: index/rate plus jitter.
    pub time_s: f64,
    /// Whether the sample was lost on the way: a recording does not have it.
    pub lost: bool,
    /// One value per channel in column order and the channel's unit, 0 if the model has none.
    pub values: [f64; Channel::COUNT],
}

/// A stretch of samples, channel by channel.
#[derive(Debug, Clone, Copy)]
pub struct Block<'a> {
    /// The number of the first sample.
    pub first_index: u64,
    /// The samples' stamps, s.
    pub time_s: &'a [f64],
    /// Whether each sample was lost.
    pub lost: &'a [bool],
    chains: &'a [Chain],
}

impl<'a> Block<'a> {
    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }
    /// Returns whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }
    /// Returns a channel's values in its unit; `None` if the model does not have it.
    pub fn values(&self, channel: Channel) -> Option<&'a [f64]> {
        let chain = self.chains.iter().find(|chain| chain.channel == channel)?;
        chain.output.get(..self.time_s.len())
    }
    /// Returns the sample at a place from 0, below [`Block::len`].
    pub fn sample(&self, place: usize) -> SimulatedSample {
        let mut values = [0.0; Channel::COUNT];
        for chain in self.chains {
            values[chain.channel as usize] = chain.output[place];
        }
        let (time_s, lost) = (self.time_s[place], self.lost[place]);
        SimulatedSample { index: self.first_index + place as u64, time_s, lost, values }
    }
}

/// A running simulation.
pub struct Simulator {
    terms: Terms,
    channels: ChannelSet,
    triads: Vec<Response>,
    chains: Vec<Chain>,
    motion: Option<Box<dyn Reference>>,
    course: Option<Box<dyn TemperatureCourse>>,
    rest_temperature_c: f64,
    /// Whether the motion has given a temperature so far.
    motion_has_temperature: bool,
    threads: usize,
    timing: Vec<(Timing, Stream, Stream)>,
    motions: Vec<Motion>,
    temperatures: Vec<f64>,
    time_s: Vec<f64>,
    lost: Vec<bool>,
    /// Number of samples before the present block, and number of samples already returned from the block.
    before: u64,
    given: usize,
    ended: bool,
    last: [f64; Channel::COUNT],
}

impl std::fmt::Debug for Simulator {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("Simulator")
            .field("terms", &self.terms)
            .field("motion", &self.motion.is_some())
            .field("course", &self.course.is_some())
            .field("index", &(self.before + self.given as u64))
            .finish_non_exhaustive()
    }
}

impl Simulator {
    /// Creates a simulation of `model` at `rate_hz` from its first sample, at rest. Spectra hold down to
    /// 1/`record_length_s`; the simulation may run longer.
    ///
    /// # Errors
    /// [`SimulatorError`] for a rate or length that is not a finite number above 0, and for a model that cannot be
    /// simulated at this rate.
    pub fn new(model: &SensorModel, seed: u64, rate_hz: f64, record_length_s: f64) -> Result<Self, SimulatorError> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        if !positive(rate_hz) {
            return Err(SimulatorError::Rate { found: rate_hz });
        }
        if !positive(record_length_s) {
            return Err(SimulatorError::RecordLength { found: record_length_s });
        }
        model.check(rate_hz).map_err(|fault| SimulatorError::Model { model: model.name.clone(), rate_hz, fault })?;
        let terms = Terms {
            seed,
            rate_hz,
            internal_rate_hz: model.internal_rate_hz(rate_hz),
            ratio: model.sampling.and_then(|sampling| sampling.decimation(rate_hz)).unwrap_or(1),
            record_length_s,
        };
        let triads = [Triad::Attitude, Triad::Mag, Triad::Accel, Triad::Gyro].into_iter().filter_map(|triad| {
            let effects = model.triads.get(&triad).map(|triad| triad.effects.as_slice()).unwrap_or_default();
            let named = model.channels.keys().any(|channel| channel.triad() == Some(triad));
            named.then(|| Response::new(triad, effects, terms.internal_rate_hz))
        });
        let temperature = model.channels.get(&Channel::Temperature).and_then(|channel| channel.bias);
        Ok(Self {
            terms,
            channels: model.channels.keys().copied().collect(),
            triads: triads.collect(),
            chains: model.channels.keys().map(|channel| Chain::new(model, *channel, terms)).collect(),
            motion: None,
            course: None,
            rest_temperature_c: temperature.unwrap_or(USUAL_TEMPERATURE_C),
            motion_has_temperature: false,
            threads: 1,
            timing: timing(model, seed),
            motions: Vec::new(),
            temperatures: Vec::new(),
            time_s: Vec::new(),
            lost: Vec::new(),
            before: 0,
            given: 0,
            ended: false,
            last: [0.0; Channel::COUNT],
        })
    }

    /// Lets the sensor follow a motion, given at [`Simulator::internal_rate_hz`]. The simulation ends with it. Call this before
    /// the first sample.
    pub fn with_motion(mut self, motion: impl Reference + 'static) -> Self {
        self.motion = Some(Box::new(motion));
        self
    }

    /// Lets the sensor's temperature follow a course, which takes precedence over the motion's. Call this before the first
    /// sample.
    pub fn with_temperature(mut self, course: impl TemperatureCourse + 'static) -> Self {
        self.course = Some(Box::new(course));
        self
    }

    /// Spreads the channels over this many threads (0 counts as 1); the values are the same.
    pub fn with_threads(mut self, threads: usize) -> Self {
        self.threads = threads.max(1);
        self
    }

    /// Returns the channels that the model gives.
    pub fn channels(&self) -> ChannelSet {
        self.channels
    }

    /// Returns the number of samples sent per second.
    pub fn rate_hz(&self) -> f64 {
        self.terms.rate_hz
    }

    /// Returns whether stamps deviate from their nominal times.
    pub fn has_jitter(&self) -> bool {
        self.timing.iter().any(|(timing, ..)| timing.jitter_s > 0.0)
    }

    /// Returns the rate at which the chain runs before sampling, and at which a motion is given.
    pub fn internal_rate_hz(&self) -> f64 {
        self.terms.internal_rate_hz
    }

    /// Returns the next sample's values: one per channel in column order and the channel's unit, 0 if the model has
    /// none. After a motion's end, it repeats the last values.
    pub fn next_values(&mut self) -> [f64; Channel::COUNT] {
        self.next_sample().map_or(self.last, |sample| sample.values)
    }

    /// Returns the next sample; `None` after the motion's end.
    pub fn next_sample(&mut self) -> Option<SimulatedSample> {
        if self.given == self.time_s.len() && !self.make_block() {
            return None;
        }
        let sample = self.block().sample(self.given);
        self.given += 1;
        self.last = sample.values;
        Some(sample)
    }

    /// Returns the samples up to the present block's end, at least one; `None` after the motion's end.
    pub fn next_block(&mut self) -> Option<Block<'_>> {
        if self.given != 0 && self.given < self.time_s.len() {
            // Samples of this block were taken one by one: the rest is returned as a separate block.
            self.drop_given();
        } else if !self.make_block() {
            return None;
        }
        self.given = self.time_s.len();
        Some(self.block())
    }

    fn drop_given(&mut self) {
        for chain in &mut self.chains {
            chain.output.drain(..self.given);
        }
        self.time_s.drain(..self.given);
        self.lost.drain(..self.given);
        self.before += self.given as u64;
        self.given = 0;
    }

    fn block(&self) -> Block<'_> {
        Block { first_index: self.before, time_s: &self.time_s, lost: &self.lost, chains: &self.chains }
    }

    /// Computes the next block; returns `false` if there is none.
    fn make_block(&mut self) -> bool {
        self.before += self.time_s.len() as u64;
        self.given = 0;
        self.time_s.clear();
        self.lost.clear();
        if self.ended {
            return false;
        }
        let ratio = self.terms.ratio;
        let wanted = if self.threads > 1 { THREADED_BLOCK } else { BLOCK };
        let sent = (wanted / ratio).max(1);
        let internal = sent * ratio;
        let felt = self.feel(internal);
        // A sample is sent at the first internal sample of its period.
        let sent = felt.div_ceil(ratio);
        if sent == 0 {
            return false;
        }
        self.run_chains(internal);
        for place in 0..sent {
            let (time_s, lost) = self.stamp(self.before + place as u64);
            self.time_s.push(time_s);
            self.lost.push(lost);
        }
        true
    }

    /// Takes the next motions and temperatures. Returns the number of internal samples before the motion's end.
    fn feel(&mut self, internal: usize) -> usize {
        let mut felt = internal;
        if let Some(motion) = &mut self.motion {
            let rest = self.motions.last().copied().unwrap_or_default();
            self.motions.resize(internal, rest);
            felt = motion.fill(&mut self.motions).min(internal);
            self.ended = felt < internal;
            let last = felt.checked_sub(1).map_or(rest, |last| self.motions[last]);
            self.motions[felt..].fill(last);
        } else if self.motions.len() != internal {
            self.motions.resize(internal, Motion::default());
        }
        self.temperatures.clear();
        let first = self.before * self.terms.ratio as u64;
        if let Some(course) = &mut self.course {
            let time_s = |place: usize| (first + place as u64) as f64 / self.terms.internal_rate_hz;
            self.temperatures.extend((0..internal).map(|place| course.temperature_c(time_s(place))));
        } else if self.motion.is_some() {
            for motion in &self.motions {
                self.motion_has_temperature |= motion.temperature_c.is_some();
                self.rest_temperature_c = motion.temperature_c.unwrap_or(self.rest_temperature_c);
                self.temperatures.push(self.rest_temperature_c);
            }
            if !self.motion_has_temperature {
                self.temperatures.clear();
            }
        }
        felt
    }

    fn run_chains(&mut self, internal: usize) {
        let moved = self.motion.is_some();
        let temperature = if self.temperatures.is_empty() {
            Temperature::Constant(self.rest_temperature_c)
        } else {
            Temperature::Series(&self.temperatures)
        };
        for response in self.triads.iter_mut().filter(|response| response.acts(moved)) {
            response.run(&self.motions, temperature);
        }
        let (triads, temperatures) = (&self.triads, &self.temperatures);
        let level = |channel: Channel| {
            let axis = |response: &Response| response.triad().channels().iter().position(|other| *other == channel);
            let response = triads
                .iter()
                .filter(|r| r.acts(moved))
                .find_map(|response| axis(response).map(|axis| &response.axes[axis]));
            match response {
                Some(values) => Level::Response(values),
                None if channel == Channel::Temperature && !temperatures.is_empty() => Level::Course(temperatures),
                None => Level::Rest,
            }
        };
        let run = |chains: &mut [Chain]| {
            for chain in chains {
                chain.run(internal, level(chain.channel), temperature);
            }
        };
        if self.threads == 1 {
            run(&mut self.chains);
            return;
        }
        let each = self.chains.len().div_ceil(self.threads).max(1);
        std::thread::scope(|scope| {
            for chains in self.chains.chunks_mut(each) {
                scope.spawn(move || run(chains));
            }
        });
    }

    /// Returns the stamp of a sample, and whether it is lost.
    fn stamp(&mut self, index: u64) -> (f64, bool) {
        let rate_hz = self.terms.rate_hz;
        let (mut time_s, mut lost) = (index as f64 / rate_hz, false);
        for (timing, jitter, loss) in &mut self.timing {
            time_s += timing.deviation_s(jitter.normal(), rate_hz);
            lost |= loss.uniform() < timing.drop_probability;
        }
        // Several deviations together must not let a stamp run back either.
        let (place_s, most_s) = (index as f64 / rate_hz, crate::effects::timing::DEVIATION_MAX / rate_hz);
        (time_s.clamp(place_s - most_s, place_s + most_s), lost)
    }
}

/// Returns the model's `timing`, from the first channel that names it (the others agree), with its streams.
fn timing(model: &SensorModel, seed: u64) -> Vec<(Timing, Stream, Stream)> {
    let of =
        |parameters: &ChannelModel| parameters.effects.iter().filter_map(|effect| effect.timing()).collect::<Vec<_>>();
    // If channels have several, the longest list counts; the other lists are beginnings of it.
    let timings = model.channels.values().map(of).max_by_key(Vec::len).unwrap_or_default();
    let stream = |effect, instance| Stream::new(seed, StreamId { owner: SENSOR_OWNER, effect, instance });
    let own = EffectKind::Timing.spec().stream;
    let both = |(instance, timing)| (timing, stream(own, instance), stream(LOSS_STREAM, instance));
    (0..).zip(timings).map(both).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_channel(channel: Channel, parameters: ChannelModel) -> SensorModel {
        SensorModel {
            name: "test".into(),
            rate_hz: 40.0,
            channels: [(channel, parameters)].into(),
            ..SensorModel::default()
        }
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
        let alone = one_channel(Channel::GyroX, white.clone());
        let mut together = alone.clone();
        together.channels.insert(Channel::GyroY, white.clone());
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
