//! Simulated: one channel of a model beside a record.

use super::Recording;
use imu_core::sample::Channel;
use imu_model::simulator::{SensorModel, Simulator};

/// A simulator may show many realisations; the pictures use this one, so that they are the same for every caller. Both
/// models receive the same noise, so that only the corrections differ between them.
const SEED: u64 = 1;

/// Returns the channel as the model's simulator shows it, as long as the record and at its temperature; None if the
/// model cannot run at the record's rate.
pub(super) fn simulated(real: &Recording, model: &SensorModel, channel: Channel) -> Option<Vec<f64>> {
    let mut model = model.clone();
    model.channels.retain(|own, _| *own == channel);
    let length_s = real.len() as f64 / real.rate_hz;
    let mut simulator = Simulator::new(&model, SEED, real.rate_hz, length_s).ok()?;
    if let Some(course) = real.temperature_c.clone() {
        let (rate_hz, last) = (real.rate_hz, course.len().saturating_sub(1));
        let at = move |time_s: f64| course.get(((time_s * rate_hz) as usize).min(last)).copied().unwrap_or(f64::NAN);
        simulator = simulator.with_temperature(at);
    }
    let mut values: Vec<f64> = Vec::with_capacity(real.len());
    while values.len() < real.len() {
        values.extend_from_slice(simulator.next_block()?.values(channel)?);
    }
    values.truncate(real.len());
    Some(values)
}
