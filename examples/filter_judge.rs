//! A filter as a judge of noise parameters: an error-state Kalman filter of one axis that loses its fixes, with four pairs of N and K.
//!
//! The filter has the errors of angle and bias. It integrates a simulated gyroscope that does not turn, gets an angle with an error of
//! 0.1 mrad every second for two minutes, and then nothing for the length of an outage. At the end of the outage its normalised
//! square error (NEES) of the angle has the mean 1 if its covariance is right, and 95 % of the errors are inside 1.96 of its
//! standard deviations.
//!
//! `cargo run --release --example filter_judge -- [NIGHTS]`: that many nights (20) of half an hour for each axis.

use imu_core::sample::Channel;
use imu_cost::{FilterRequest, filter_parameters};
use imu_model::effects::{Stream, StreamId};
use imu_model::simulator::{SensorModel, Simulator};

/// The datasheet's values of a VN-100: 0.0035 °/s/√Hz, and as a walk the in-run bias stability of 5 °/h over an hour.
const DATASHEET: [f64; 2] = [6.1e-5, 4.0e-7];
const FIX_RAD: f64 = 1e-4;
const AIDED_S: f64 = 120.0;
const OUTAGES_S: [f64; 4] = [1.0, 10.0, 60.0, 100.0];
const LENGTH_S: f64 = 1800.0;
const MODEL: &str = r#"{ "format": "vn100d-sensor-model-1", "name": "unit", "rate_hz": 40, "channels": {
    "gyro_x": { "N": 1.2e-4, "B": 2.6e-5, "K": 1.5e-6 },
    "gyro_y": { "N": 1.2e-4, "B": 2.6e-5, "K": 1.5e-6,
                "effects": [ { "effect": "tone", "frequency_hz": 13.38, "amplitude": 2e-2 } ] },
    "gyro_z": { "N": 1.2e-4, "B": 2.6e-5, "K": 1.5e-6,
                "effects": [ { "effect": "warm_up", "amplitude": 2e-3, "tau_s": 600 } ] } } }"#;

/// The error state: angle and bias, and their covariance.
struct Filter {
    angle: f64,
    bias: f64,
    covariance: [[f64; 2]; 2],
    noise: [f64; 2],
}

impl Filter {
    fn new(noise: [f64; 2]) -> Self {
        Self { angle: 0.0, bias: 0.0, covariance: [[1e-6, 0.0], [0.0, 1e-4]], noise }
    }

    /// Integrates a sample over its period.
    fn predict(&mut self, rate: f64, dt: f64) {
        self.angle += (rate - self.bias) * dt;
        let ([[a, b], [_, c]], [n, k]) = (self.covariance, self.noise);
        let angle = a - 2.0 * dt * b + dt * dt * c + n * n * dt + k * k * dt.powi(3) / 3.0;
        let both = b - dt * c - k * k * dt * dt / 2.0;
        self.covariance = [[angle, both], [both, c + k * k * dt]];
    }

    /// Takes an angle with the error [`FIX_RAD`].
    fn fix(&mut self, angle: f64) {
        let [[a, b], [_, c]] = self.covariance;
        let innovation = a + FIX_RAD * FIX_RAD;
        let (gain, difference) = ([a / innovation, b / innovation], angle - self.angle);
        self.angle += gain[0] * difference;
        self.bias += gain[1] * difference;
        self.covariance = [[a - gain[0] * a, b - gain[0] * b], [b - gain[0] * b, c - gain[1] * b]];
    }
}

/// Returns the squares of the angle's errors over their variances at the ends of all outages.
fn nees(samples: &[f64], rate_hz: f64, noise: [f64; 2], outage_s: f64, stream: &mut Stream) -> Vec<f64> {
    let (mut filter, dt) = (Filter::new(noise), 1.0 / rate_hz);
    let [aided, all, second] = [AIDED_S, AIDED_S + outage_s, 1.0].map(|time_s| (time_s * rate_hz) as usize);
    let mut found = Vec::new();
    for (index, rate) in samples.iter().enumerate() {
        filter.predict(*rate, dt);
        let place = index % all + 1;
        if place == all {
            found.push(filter.angle * filter.angle / filter.covariance[0][0]);
        }
        if place <= aided && place % second == 0 {
            filter.fix(FIX_RAD * stream.normal());
        }
    }
    found
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let nights: u64 = std::env::args().nth(1).map_or(Ok(20), |of| of.parse())?;
    let model = SensorModel::from_json(MODEL, "unit")?;
    let request = FilterRequest { record_s: Some(LENGTH_S), ..FilterRequest::default() };
    let parameters = filter_parameters(&model, "unit", &request)?;
    println!("| axis | pair | N | K | {} |", OUTAGES_S.map(|of| format!("after {of} s")).join(" | "));
    println!("|---|---|---|---|{}", "---|".repeat(OUTAGES_S.len()));
    let count = (LENGTH_S * model.rate_hz) as usize;
    for channel in [Channel::GyroX, Channel::GyroY, Channel::GyroZ] {
        let own = &parameters.channels[&channel].white_and_walk;
        let of = &model.channels[&channel];
        let pair = |of: &imu_cost::Prediction| [of.n, of.k.unwrap_or(0.0)];
        let pairs = [
            ("datasheet", DATASHEET),
            ("Allan × 1", [of.n, of.k]),
            ("Allan × 10", [10.0 * of.n, 10.0 * of.k]),
            ("closest", pair(&own.fit)),
            ("covering", pair(&own.cover)),
        ];
        let mut all = vec![vec![Vec::new(); OUTAGES_S.len()]; pairs.len()];
        for night in 0..nights {
            let mut simulator = Simulator::new(&model, 100 + night, model.rate_hz, LENGTH_S)?;
            let mut samples = Vec::with_capacity(count);
            while samples.len() < count {
                let Some(block) = simulator.next_block() else { break };
                samples.extend_from_slice(block.values(channel).unwrap_or_default());
            }
            for ((_, noise), all) in pairs.iter().zip(&mut all) {
                for (outage_s, all) in OUTAGES_S.iter().zip(all) {
                    let mut stream = Stream::new(night, StreamId { owner: 99, effect: 1, instance: 0 });
                    all.extend(nees(&samples, model.rate_hz, *noise, *outage_s, &mut stream));
                }
            }
        }
        for ((name, [n, k]), all) in pairs.iter().zip(&all) {
            let cells = all.iter().map(|of: &Vec<f64>| {
                let mean = of.iter().sum::<f64>() / of.len() as f64;
                let inside = of.iter().filter(|value| **value <= 1.96 * 1.96).count() as f64 / of.len() as f64;
                format!("{mean:.2}, {:.0} %", 100.0 * inside)
            });
            println!("| {channel} | {name} | {n:.1e} | {k:.1e} | {} |", cells.collect::<Vec<_>>().join(" | "));
        }
    }
    Ok(())
}
