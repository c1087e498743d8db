//! Turning: determines whether the gyro and the accelerometer agree about how far the sensor turned.
//!
//! Gravity is fixed in the world, so a sensor that turns by a small angle θ sees its direction g change by g × θ. The
//! direction is determined every [`HOP`] samples. Once it has turned by [`TURNED`], the change is compared with the
//! gyro's angle. The ratio of the two is near 1 if the gyro's unit is right, and π/180 if degrees were taken for
//! radians. Only turns that the accelerometer has seen are compared, not the gyro's values at rest: noise is no
//! turning. Pure.

use imu_core::sample::{Channel, Sample};

/// The number of samples whose mean is one direction of gravity.
const HOP: u32 = 8;
/// The change of direction that is compared, rad: small enough to be a vector, too large to be noise.
const TURNED: f64 = 0.2;
/// The number of hops after which the gyro's own bias would have turned too far: the comparison begins again.
const HOPS_MAX: u32 = 64;
/// The longest step over which the turning is known, s.
const STEP_MAX_S: f64 = 2.0;

type Vector = [f64; 3];

/// Sums of comparisons.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Turns {
    /// The number of comparisons.
    pub(super) count: u64,
    seen_predicted: f64,
    seen_seen: f64,
    predicted_predicted: f64,
}

impl Turns {
    /// Returns the ratio of the sensor's turning to that of the gyro, and how well directions agree (1: exactly).
    pub(super) fn ratio(&self) -> Option<(f64, f64)> {
        let ratio = self.seen_predicted / self.predicted_predicted;
        let agreement = self.seen_predicted / (self.seen_seen * self.predicted_predicted).sqrt();
        (self.count > 0 && ratio.is_finite() && agreement.is_finite()).then_some((ratio, agreement))
    }
}

/// Compares a recording's gyro with its accelerometer, sample by sample.
#[derive(Debug, Default)]
pub(super) struct Turning {
    pub(super) turns: Turns,
    last_ns: Option<i64>,
    /// Sum of the hop's accelerations, and samples in it.
    hop: (Vector, u32),
    /// Direction of gravity when the comparison began, and hops since.
    begun: Option<(Vector, u32)>,
    /// Angle since then by the gyro, rad; without stamps in rad·samples/s.
    angle: Vector,
}

impl Turning {
    pub(super) fn take(&mut self, stamp_ns: Option<i64>, sample: &Sample) {
        let all = |channels: [Channel; 3]| {
            let [x, y, z] = channels.map(|channel| sample.get(channel));
            Some([x?, y?, z?])
        };
        let step_s = match (self.last_ns, stamp_ns) {
            (Some(last_ns), Some(now_ns)) => now_ns.saturating_sub(last_ns) as f64 * 1e-9,
            _ => 1.0,
        };
        self.last_ns = stamp_ns;
        let accel = all([Channel::AccelX, Channel::AccelY, Channel::AccelZ]);
        let gyro = all([Channel::GyroX, Channel::GyroY, Channel::GyroZ]);
        let (Some(accel), Some(gyro), true) = (accel, gyro, step_s <= STEP_MAX_S) else {
            (self.hop, self.begun) = (Default::default(), None);
            return;
        };
        for (axis, (accel, gyro)) in accel.into_iter().zip(gyro).enumerate() {
            self.hop.0[axis] += accel;
            self.angle[axis] += gyro * step_s;
        }
        self.hop.1 += 1;
        if self.hop.1 == HOP {
            let (sum, _) = std::mem::take(&mut self.hop);
            self.hopped(sum);
        }
    }

    fn hopped(&mut self, sum: Vector) {
        let length = dot(sum, sum).sqrt();
        if length == 0.0 {
            return;
        }
        let now = sum.map(|part| part / length);
        let Some((begin, hops)) = &mut self.begun else { return self.begin(now) };
        *hops += 1;
        let seen = [0, 1, 2].map(|axis| now[axis] - begin[axis]);
        if dot(seen, seen) > TURNED * TURNED {
            let predicted = cross(*begin, self.angle);
            self.turns.count += 1;
            self.turns.seen_predicted += dot(seen, predicted);
            self.turns.seen_seen += dot(seen, seen);
            self.turns.predicted_predicted += dot(predicted, predicted);
            self.begin(now);
        } else if *hops == HOPS_MAX {
            self.begin(now);
        }
    }

    fn begin(&mut self, direction: Vector) {
        (self.begun, self.angle) = (Some((direction, 0)), [0.0; 3]);
    }
}

fn dot(one: Vector, other: Vector) -> f64 {
    one.into_iter().zip(other).map(|(one, other)| one * other).sum()
}

fn cross(one: Vector, other: Vector) -> Vector {
    let part = |next: usize, last: usize| one[next] * other[last] - one[last] * other[next];
    [part(1, 2), part(2, 0), part(0, 1)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a sensor that rocks about two axes, with its gyro in units of which `per_rad` make a radian.
    fn rocking(per_rad: f64, stamped: bool) -> Turns {
        let mut turning = Turning::default();
        let (mut gravity, step_s) = ([0.0, 0.0, -9.8], 0.01);
        for index in 0..20_000_u32 {
            let phase = f64::from(index) * step_s;
            let rate = [0.9 * phase.cos(), 0.7 * (0.6 * phase).sin(), 0.2];
            let change = cross(gravity, rate.map(|rate| rate * step_s));
            gravity = [0, 1, 2].map(|axis| gravity[axis] + change[axis]);
            let mut sample = Sample::at(0, 0);
            for (axis, channel) in [Channel::AccelX, Channel::AccelY, Channel::AccelZ].into_iter().enumerate() {
                sample.set(channel, gravity[axis]);
            }
            for (axis, channel) in [Channel::GyroX, Channel::GyroY, Channel::GyroZ].into_iter().enumerate() {
                sample.set(channel, rate[axis] * per_rad);
            }
            turning.take(stamped.then_some(i64::from(index) * 10_000_000), &sample);
        }
        turning.turns
    }

    #[test]
    fn the_ratio_of_the_seen_to_the_predicted_turn_is_the_units_error() {
        let turns = rocking(1.0, true);
        let (ratio, agreement) = turns.ratio().unwrap();
        assert!(turns.count > 50 && (ratio - 1.0).abs() < 0.05 && agreement > 0.98, "{turns:?} {ratio} {agreement}");
        let (ratio, agreement) = rocking(1.0_f64.to_degrees(), true).ratio().unwrap();
        assert!((ratio * 57.3 - 1.0).abs() < 0.05 && agreement > 0.98, "{ratio} {agreement}");
        // Without stamps it is in samples.
        let (ratio, _) = rocking(1.0, false).ratio().unwrap();
        assert!((ratio * 100.0 - 1.0).abs() < 0.05, "{ratio}");
    }

    #[test]
    fn a_sensor_at_rest_turned_nowhere() {
        let mut turning = Turning::default();
        for index in 0..10_000 {
            let mut sample = Sample::at(0, 0);
            for channel in
                [Channel::AccelX, Channel::AccelY, Channel::AccelZ, Channel::GyroX, Channel::GyroY, Channel::GyroZ]
            {
                sample.set(
                    channel,
                    f64::from(index * 7919 % 101) * 1e-3 + if channel == Channel::AccelZ { 9.8 } else { 0.0 },
                );
            }
            turning.take(Some(i64::from(index) * 25_000_000), &sample);
        }
        assert_eq!(turning.turns.ratio(), None);
    }
}
