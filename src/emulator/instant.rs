//! One instant of a virtual sensor: converts channel values to the quantities of a message.
//!
//! Compensated and uncompensated values are the same (a virtual sensor estimates no bias). The quantities that follow
//! from the channels are computed: quaternion, direction cosines, accelerations without gravity and in north, east,
//! down, delta theta and velocity (rate × interval). Heave and the uncertainty of the angles are not modelled and are
//! 0.

use imu_core::sample::Channel;
use imu_core::units::{RAD_PER_DEG, STANDARD_GRAVITY_M_S2};
use vn100_proto::{Measurement, MeasurementKind, Quantity};

/// One value per channel, in the order of [`Channel::ALL`] and in the units that the sensor sends.
pub type Values = [f64; Channel::COUNT];

type Vector = [f64; 3];
/// Rows of a 3×3 matrix.
type Matrix = [Vector; 3];

fn vector(values: &Values, channels: [Channel; 3]) -> Vector {
    channels.map(|channel| values[channel as usize])
}

/// Returns the rotation from body to north, east, down for yaw, pitch, roll (turned in this order) in degrees.
fn body_to_ned(yaw_pitch_roll_deg: Vector) -> Matrix {
    let [(sy, cy), (sp, cp), (sr, cr)] = yaw_pitch_roll_deg.map(|angle| (angle * RAD_PER_DEG).sin_cos());
    [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
}

/// Returns that rotation as a quaternion, scalar last.
fn quaternion(yaw_pitch_roll_deg: Vector) -> [f64; 4] {
    let [(sy, cy), (sp, cp), (sr, cr)] = yaw_pitch_roll_deg.map(|angle| (angle * RAD_PER_DEG / 2.0).sin_cos());
    [cy * cp * sr - sy * sp * cr, cy * sp * cr + sy * cp * sr, sy * cp * cr - cy * sp * sr, cy * cp * cr + sy * sp * sr]
}

fn transposed([[a, b, c], [d, e, f], [g, h, i]]: Matrix) -> Matrix {
    [[a, d, g], [b, e, h], [c, f, i]]
}

fn times(matrix: Matrix, [x, y, z]: Vector) -> Vector {
    matrix.map(|[a, b, c]| a * x + b * y + c * z)
}

/// Returns the measurement of that kind at an instant. `interval_s` is the time since the last message of the kind,
/// over which delta theta and delta velocity are integrated.
pub fn measure(kind: MeasurementKind, values: &Values, interval_s: f64) -> Measurement {
    use Channel::{
        AccelX, AccelY, AccelZ, GyroX, GyroY, GyroZ, MagX, MagY, MagZ, Pitch, Pressure, Roll, Temperature, Yaw,
    };
    let mut measurement = Measurement::new(kind);
    let angles = vector(values, [Yaw, Pitch, Roll]);
    let mag = vector(values, [MagX, MagY, MagZ]);
    let accel = vector(values, [AccelX, AccelY, AccelZ]);
    let gyro = vector(values, [GyroX, GyroY, GyroZ]);
    // gravity acts along down; specific force + gravity = acceleration
    let linear_body = || {
        let gravity = times(transposed(body_to_ned(angles)), [0.0, 0.0, STANDARD_GRAVITY_M_S2]);
        [accel[0] + gravity[0], accel[1] + gravity[1], accel[2] + gravity[2]]
    };
    for quantity in kind.quantities().iter() {
        match quantity {
            Quantity::YawPitchRoll => measurement.set(quantity, &angles),
            Quantity::Quaternion => measurement.set(quantity, &self::quaternion(angles)),
            Quantity::DirectionCosines => {
                // NED to body: binary column by column, which are the rows of body to NED; text row by row
                let rows = match kind {
                    MeasurementKind::Binary(_) => body_to_ned(angles),
                    MeasurementKind::Ascii(_) => transposed(body_to_ned(angles)),
                };
                measurement.set(quantity, rows.as_flattened());
            }
            Quantity::Mag | Quantity::UncompMag => measurement.set(quantity, &mag),
            Quantity::Accel | Quantity::UncompAccel => measurement.set(quantity, &accel),
            Quantity::AngularRate | Quantity::UncompGyro => measurement.set(quantity, &gyro),
            Quantity::Temperature => measurement.set(quantity, &[values[Temperature as usize]]),
            Quantity::Pressure => measurement.set(quantity, &[values[Pressure as usize]]),
            Quantity::DeltaTime => measurement.set(quantity, &[interval_s]),
            Quantity::DeltaTheta => measurement.set(quantity, &gyro.map(|rate| rate * interval_s / RAD_PER_DEG)),
            Quantity::DeltaVelocity => measurement.set(quantity, &accel.map(|accel| accel * interval_s)),
            Quantity::LinearAccelBody => measurement.set(quantity, &linear_body()),
            Quantity::LinearAccelNed => measurement.set(quantity, &times(body_to_ned(angles), linear_body())),
            Quantity::MagNed => measurement.set(quantity, &times(body_to_ned(angles), mag)),
            Quantity::AccelNed => measurement.set(quantity, &times(body_to_ned(angles), accel)),
            Quantity::Heave | Quantity::YprUncertainty => measurement.set(quantity, &[0.0; 3]),
        }
    }
    measurement
}

#[cfg(test)]
mod tests {
    use super::*;
    use vn100_proto::{AsciiType, BinaryHeader};

    fn close(found: &[f64], expected: &[f64]) {
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} instead of {expected}");
        }
    }

    #[test]
    fn a_sensor_at_rest_has_no_acceleration_but_gravity() {
        let mut values = [0.0; Channel::COUNT];
        values[Channel::Yaw as usize] = 30.0;
        values[Channel::Pitch as usize] = 20.0;
        values[Channel::Roll as usize] = -50.0;
        let rotation = body_to_ned([30.0, 20.0, -50.0]);
        let force = times(transposed(rotation), [0.0, 0.0, -STANDARD_GRAVITY_M_S2]);
        values[Channel::AccelX as usize..=Channel::AccelZ as usize].copy_from_slice(&force);
        let kind = MeasurementKind::Binary(BinaryHeader::new(0, 0, 0, 0x00EC).unwrap());
        let found = measure(kind, &values, 0.025);
        close(found.get(Quantity::LinearAccelBody).unwrap(), &[0.0; 3]);
        close(found.get(Quantity::LinearAccelNed).unwrap(), &[0.0; 3]);
        close(found.get(Quantity::AccelNed).unwrap(), &[0.0, 0.0, -STANDARD_GRAVITY_M_S2]);
        // the quaternion and the matrix are the same rotation
        let [x, y, z, w] = quaternion([30.0, 20.0, -50.0]);
        close(&[x * x + y * y + z * z + w * w], &[1.0]);
        close(&rotation[2], &[2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)]);
        close(&rotation[0], &[1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)]);
    }

    #[test]
    fn real_angles_and_quaternions_of_one_instant_agree() {
        // user manual UM001 rev 2.45: register 8 and register 9 examples, read one after the other on a desk
        let angles = [6.271, 0.031, -2.0];
        let [x, y, z, w] = quaternion(angles);
        let published = [-0.017386, -0.000303, 0.055490, 0.998308];
        for (found, published) in [x, y, z, w].into_iter().zip(published) {
            assert!((found - published).abs() < 2e-3, "{found} instead of {published}");
        }
    }

    #[test]
    fn deltas_are_rate_times_interval() {
        let mut values = [0.0; Channel::COUNT];
        values[Channel::GyroZ as usize] = RAD_PER_DEG;
        values[Channel::AccelX as usize] = 2.0;
        let found = measure(MeasurementKind::Ascii(AsciiType::Dtv), &values, 0.025);
        assert_eq!(found.scalar(Quantity::DeltaTime), Some(0.025));
        close(found.get(Quantity::DeltaTheta).unwrap(), &[0.0, 0.0, 0.025]);
        close(found.get(Quantity::DeltaVelocity).unwrap(), &[0.05, 0.0, 0.0]);
    }
}
