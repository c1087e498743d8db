//! Courses: the motion of a sealed case, on a grid finer than the record's. The code is separate from the library's.
//!
//! Either a table drives one rate after the other about random axes, or a hand turns the sensor from rest to rest;
//! attitude follows by rotating about each step's rate. Gravity is 9.80665 m/s² down; a third of the courses are also
//! shaken.

use crate::draw::Draw;
use imu_model::simulator::Motion;
use serde::Serialize;

/// Number of instants of a course per sample of the record.
pub const FINE: usize = 4;
const GRAVITY: f64 = 9.806_65;
type Vector = [f64; 3];

/// The properties of a course.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Shape {
    /// Whether the course goes from rest to rest.
    pub by_hand: bool,
    /// The fastest rate, rad/s.
    pub fastest: f64,
    /// Peak of the shaking, m/s²; 0 for none.
    pub shaken: f64,
}

impl Shape {
    /// Draws a shape.
    pub fn draw(draw: &mut Draw) -> Self {
        let by_hand = draw.chance(0.4);
        let fastest = if by_hand { draw.uniform(0.8, 2.5) } else { draw.uniform(2.0, 4.0) };
        let shaken = if draw.chance(0.33) { draw.uniform(0.3, 2.0) } else { 0.0 };
        Self { by_hand, fastest, shaken }
    }
}

/// Returns a course of `samples` at `rate_hz`, with [`FINE`] instants each.
pub fn course(shape: Shape, rate_hz: f64, samples: usize, draw: &mut Draw) -> Vec<Motion> {
    let (count, fine_hz) = (samples * FINE, rate_hz * FINE as f64);
    let mut rates = vec![[0.0; 3]; count];
    let mut at = (fine_hz * draw.uniform(4.0, 12.0)) as usize;
    while at < count {
        let (length_s, rest_s) = match shape.by_hand {
            true => (draw.uniform(1.0, 4.0), draw.uniform(8.0, 30.0)),
            false => (draw.uniform(6.0, 20.0), draw.uniform(2.0, 6.0)),
        };
        let (main, second) = (draw.whole(0, 2), draw.whole(1, 2));
        let rate = draw.sign() * shape.fastest * draw.uniform(0.15, 1.0);
        let beside = if draw.chance(0.35) { draw.sign() * shape.fastest * draw.uniform(0.1, 0.6) } else { 0.0 };
        let end = (at + (fine_hz * length_s) as usize).min(count);
        for values in &mut rates[at..end] {
            values[main] += rate;
            values[(main + second) % 3] += beside;
        }
        at = end + (fine_hz * rest_s) as usize;
    }
    // Rates change over about a second.
    for _ in 0..3 {
        for axis in 0..3 {
            smooth(&mut rates, axis, (0.35 * fine_hz) as usize);
        }
    }
    let shakes: Vec<(usize, f64, f64, f64)> = (0..5)
        .map(|_| (draw.whole(0, 2), draw.log_uniform(0.2, 2.0), draw.uniform(0.2, 1.0), draw.uniform(0.0, 6.3)))
        .collect();
    let mut turned = turn(random_axis(draw), draw.uniform(0.0, 3.0));
    rates
        .into_iter()
        .enumerate()
        .map(|(index, rate)| {
            let length = (rate[0] * rate[0] + rate[1] * rate[1] + rate[2] * rate[2]).sqrt();
            if length > 0.0 {
                turned = times(turned, turn(rate.map(|value| value / length), length / fine_hz));
            }
            // Down in the sensor's axes is the last row of its attitude.
            let mut force = turned[2].map(|value| -GRAVITY * value);
            let time_s = index as f64 / fine_hz;
            for (axis, hz, share, phase) in &shakes {
                let swing = (std::f64::consts::TAU * hz * time_s + phase).sin();
                // In bursts of some twenty seconds.
                let loud = (0.15 * time_s + 3.0 * phase).sin().max(0.0);
                force[*axis] += shape.shaken * share * swing * loud;
            }
            Motion { gyro_rad_s: rate, accel_m_s2: force, temperature_c: None }
        })
        .collect()
}

fn random_axis(draw: &mut Draw) -> Vector {
    let of = [draw.normal(), draw.normal(), draw.normal()];
    let length = of.iter().map(|value| value * value).sum::<f64>().sqrt().max(1e-9);
    of.map(|value| value / length)
}

/// Smooths values along an axis by means over `width` values.
fn smooth(values: &mut [Vector], axis: usize, width: usize) {
    let width = width.max(1);
    let mut sums = vec![0.0];
    let mut sum = 0.0;
    sums.extend(values.iter().map(|value| {
        sum += value[axis];
        sum
    }));
    let count = values.len();
    for (index, value) in values.iter_mut().enumerate() {
        let (from, to) = (index.saturating_sub(width / 2), (index + width / 2 + 1).min(count));
        value[axis] = (sums[to] - sums[from]) / (to - from) as f64;
    }
}

/// Returns the rotation about an axis by an angle (Rodrigues).
fn turn([x, y, z]: Vector, angle: f64) -> [Vector; 3] {
    let (s, c) = angle.sin_cos();
    let t = 1.0 - c;
    [
        [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
        [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
        [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
    ]
}

fn times(a: [Vector; 3], b: [Vector; 3]) -> [Vector; 3] {
    std::array::from_fn(|row| std::array::from_fn(|column| (0..3).map(|of| a[row][of] * b[of][column]).sum()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gravity_keeps_its_size_and_turns_against_the_rate() {
        let mut draw = Draw::device(3, 0, "course");
        let shape = Shape { by_hand: false, fastest: 3.0, shaken: 0.0 };
        let course = course(shape, 40.0, 4000, &mut draw);
        assert_eq!(course.len(), 16_000);
        for pair in course.windows(2).step_by(97) {
            let (one, other) = (pair[0].accel_m_s2, pair[1].accel_m_s2);
            let length = one.iter().map(|value| value * value).sum::<f64>().sqrt();
            assert!((length - GRAVITY).abs() < 1e-9);
            // In the sensor's axes a fixed vector turns by −ω × a.
            let [p, q, r] = pair[1].gyro_rad_s;
            let expected = [q * one[2] - r * one[1], r * one[0] - p * one[2], p * one[1] - q * one[0]];
            for axis in 0..3 {
                let change = (other[axis] - one[axis]) * 160.0;
                assert!((change + expected[axis]).abs() < 0.5, "{change} {expected:?}");
            }
        }
    }
}
