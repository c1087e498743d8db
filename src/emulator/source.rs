//! Source: provides the values of each instant. Pure but for the recording's iterator.

use super::Values;
use super::replay::Replay;
use super::sensor::VirtualSensor;
use imu_core::sample::Channel;
use imu_model::simulator::{SensorModel, Simulator, SimulatorError};
use vn100_proto::link::INTERNAL_RATE_HZ;
use vn100_proto::register::{ASYNC_RATE, ASYNC_TYPE, BinaryOutput};

/// Length of the records for which the simulated spectra hold at the low end, s.
const RECORD_LENGTH_S: f64 = 86_400.0;

/// The source of the sensor's output.
pub enum Source {
    /// Simulated noise.
    Model(Box<Noise>),
    /// Recorded lines.
    Replay(Replay),
}

/// The noise of a model, at whatever rate the sensor is configured to send.
pub struct Noise {
    model: SensorModel,
    seed: u64,
    running: Option<Running>,
    /// The configurations so far, each with the number of its simulations.
    started: Vec<(Stream, u64)>,
}

/// A running simulation, for one configuration of the output.
struct Running {
    stream: Stream,
    simulator: Simulator,
    /// The tick of its first values.
    origin: u64,
    /// The number of simulated instants, and the last of them.
    instants: u64,
    values: Values,
}

/// The configured output of the sensor.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Stream {
    binary: Option<(u16, BinaryOutput)>,
    ascii: (String, String),
}

impl Stream {
    pub(super) fn of(sensor: &VirtualSensor) -> Self {
        let read = |register| sensor.registers().read(register, None).unwrap_or_default();
        Self { binary: sensor.binary_output(), ascii: (read(ASYNC_TYPE), read(ASYNC_RATE)) }
    }

    /// Returns the rate of its fastest output in Hz.
    fn rate_hz(&self) -> f64 {
        let binary = self.binary.as_ref().and_then(|(_, output)| output.rate_hz()).unwrap_or(0.0);
        let ascii = if self.ascii.0 == "0" { 0.0 } else { self.ascii.1.parse().unwrap_or(0.0) };
        let rate = f64::max(binary, ascii);
        if rate > 0.0 { rate } else { f64::from(INTERNAL_RATE_HZ) }
    }
}

impl Source {
    /// Creates noise of this model. The simulation begins with the first message after each change of the output, so
    /// that a stream's noise depends on the seed and not on the time of the request. After a reset it is other noise.
    pub fn model(model: SensorModel, seed: u64) -> Self {
        Self::Model(Box::new(Noise { model, seed, running: None, started: Vec::new() }))
    }
}

impl Noise {
    /// Returns the values at `tick`; ticks do not run back within a stream.
    pub(super) fn at(&mut self, tick: u64, stream: Stream) -> Result<Values, SimulatorError> {
        let running = match &mut self.running {
            Some(running) if running.stream == stream => running,
            other => {
                let again = match self.started.iter_mut().find(|(known, _)| *known == stream) {
                    Some((_, times)) => {
                        *times += 1;
                        *times
                    }
                    None => {
                        self.started.push((stream.clone(), 0));
                        0
                    }
                };
                // A multiple of an odd number far from powers of two: no seed's stream is that of a neighbouring seed.
                let seed = self.seed.wrapping_add(again.wrapping_mul(0x9e37_79b9_7f4a_7c15));
                let simulator = Simulator::new(&self.model, seed, stream.rate_hz(), RECORD_LENGTH_S)?;
                other.insert(Running { stream, simulator, origin: tick, instants: 0, values: [0.0; Channel::COUNT] })
            }
        };
        let elapsed = (tick - running.origin) as f64 * running.simulator.rate_hz() / f64::from(INTERNAL_RATE_HZ);
        while running.instants <= (elapsed + 1e-6) as u64 {
            running.values = running.simulator.next_values();
            running.instants += 1;
        }
        Ok(running.values)
    }
}
