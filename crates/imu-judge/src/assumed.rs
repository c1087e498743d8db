//! The noise that filters assume: the datasheet's values, those of the Allan deviation, ten times these, and the consistent pairs.

use crate::filter::{Density, Noise};
use imu_core::sample::{Channel, Triad};
use imu_core::units::{RAD_PER_DEG, SECONDS_PER_HOUR, STANDARD_GRAVITY_M_S2};
use imu_cost::{FilterError, FilterRequest, filter_parameters};
use imu_model::simulator::SensorModel;

/// The names of what [`assumed`] returns.
pub const NAMES: [&str; 5] = ["datasheet", "Allan × 1", "Allan × 10", "closest", "covering"];

/// The channels of a filter in the order of [`Noise`].
pub fn channels() -> [Channel; 6] {
    let ([a, b, c], [d, e, f]) = (Triad::Gyro.channels(), Triad::Accel.channels());
    [a, b, c, d, e, f]
}

/// Returns the values of a VN-100's datasheet: 0.0035 °/s/√Hz and 0.14 mg/√Hz; as a walk the in-run bias stability of 5 °/h and
/// 0.04 mg over an hour.
pub fn datasheet() -> Noise {
    let hour = SECONDS_PER_HOUR.sqrt();
    let gyro = Density { n: 0.0035 * RAD_PER_DEG, k: 5.0 * RAD_PER_DEG / SECONDS_PER_HOUR / hour };
    let mg = 1e-3 * STANDARD_GRAVITY_M_S2;
    let accel = Density { n: 0.14 * mg, k: 0.04 * mg / hour };
    [gyro, gyro, gyro, accel, accel, accel]
}

/// Returns N and K of a model.
pub fn own(model: &SensorModel) -> Noise {
    channels().map(|of| model.channels.get(&of).map_or(Density::default(), |of| Density { n: of.n, k: of.k }))
}

/// Returns the noise that five filters assume of the sensor of a model, in the order of [`NAMES`].
///
/// `allan` has N and K of the Allan deviation. The consistent pairs are those that the model has for the request. As in the files
/// of `noise --consistent`, no number is below the sensor's own, which are N and K of the model. A channel that the model lacks has
/// no noise.
///
/// # Errors
/// [`FilterError`] for a model that cannot be simulated, and a request that makes no sense.
pub fn assumed(model: &SensorModel, allan: &Noise, request: &FilterRequest) -> Result<[Noise; 5], FilterError> {
    let found = filter_parameters(model, &model.name, request)?;
    let pair = |covers: bool| {
        let mut noise = Noise::default();
        for ((channel, own), sensor) in channels().iter().zip(&mut noise).zip(own(model)) {
            let Some(of) = found.channels.get(channel) else { continue };
            let of = if covers { &of.white_and_walk.cover } else { &of.white_and_walk.fit };
            *own = Density { n: of.n.max(sensor.n), k: of.k.unwrap_or(0.0).max(sensor.k) };
        }
        noise
    };
    let ten = allan.map(|of| Density { n: 10.0 * of.n, k: 10.0 * of.k });
    Ok([datasheet(), *allan, ten, pair(false), pair(true)])
}
