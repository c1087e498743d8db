//! Paths: the truth along a motion, and how a sensor's errors grow along it.
//!
//! A sample holds over its period. With φ = ω·dt, the rotation over a period is e^(φ×), and the integrals of it, once and
//! twice, have closed forms J₁(φ) and J₂(φ). Truth and sensor go through the same sums, so that what holding a sample costs
//! cancels. The turn of the Earth is taken from both as the truth sees it.
//!
//! A small error x of a gyroscope's axis turns the attitude by R·J₁·x·dt, seen in the world's axes, and turns the
//! velocity's increments from then on. [`Small`] sums that; [`Navigator`] integrates errors of any size.

use crate::request::{Along, CostError, MotionRefusal, Quantity, Setting};
use imu_core::sample::Channel;
use imu_model::motion::file::between;
use imu_model::simulator::{Motion, SensorModel, Simulator};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use std::sync::Arc;

/// The channels that act along a motion: gyroscope, then accelerometer.
pub(super) const USED: [Channel; 6] =
    [Channel::GyroX, Channel::GyroY, Channel::GyroZ, Channel::AccelX, Channel::AccelY, Channel::AccelZ];
/// The number of quantities.
const QUANTITIES: usize = 7;
/// A value of each quantity, in the order of [`Quantity::all`].
pub(super) type Values = [f64; QUANTITIES];
/// An error of each channel, in the order of [`USED`].
pub(super) type Errors = [f64; USED.len()];

/// A first turn up to this rate, rad/s, is that of the Earth.
const EARTH_RAD_S: f64 = 1e-4;
/// How far the first specific force may be from standard gravity, m/s².
const GRAVITY_WITHIN_M_S2: f64 = 0.5;
/// Above this component of the vertical, an axis is steeper than 45°.
const STEEP: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Below this rotation per sample, rad, series stand for sines.
const SMALL_TURN_RAD: f64 = 0.1;

/// The truth over one sample.
#[derive(Debug, Clone, Copy)]
pub(super) struct Step {
    /// Angular rate and specific force in the sensor's axes, rad/s and m/s².
    rate: Vector3<f64>,
    force: Vector3<f64>,
    /// The turn of the Earth in the sensor's axes, rad/s.
    earth: Vector3<f64>,
    /// R·J₁: from an error of the gyroscope to a rate in the world's axes.
    forward: Matrix3<f64>,
    /// R·J₁·f and R·J₂·f, m/s².
    velocity: Vector3<f64>,
    position: Vector3<f64>,
}

/// A motion as a model's samples see it, after a rest at its first attitude.
#[derive(Debug)]
pub(super) struct Path {
    steps: Vec<Step>,
    /// Attitude, sensor to world, when the motion begins, and at each horizon.
    first: UnitQuaternion<f64>,
    ends: Vec<UnitQuaternion<f64>>,
    horizons: Vec<u64>,
    period_s: f64,
    rest: Motion,
    rows: Arc<[Motion]>,
    samples_per_row: u32,
    /// The sensor's own samples at rest.
    rests: usize,
    /// Whether the motion's temperature counts.
    has_temperature: bool,
}

impl Path {
    /// Computes the truth. `has_temperature` states whether the temperature of the motion counts, if it has one.
    ///
    /// # Errors
    /// [`MotionRefusal`] for a motion that does not begin with gravity.
    pub(super) fn new(
        setting: &Setting<'_>,
        along: &Along,
        samples_per_row: u32,
        has_temperature: bool,
    ) -> Result<Self, MotionRefusal> {
        let begin = along.rows.first().copied().unwrap_or_default();
        let first = attitude_at_rest(along, &begin)?;
        let earth = if is_at_rest(&begin) { first * Vector3::from(begin.gyro_rad_s) } else { Vector3::zeros() };
        let mut path = Self {
            steps: Vec::new(),
            first,
            ends: Vec::new(),
            horizons: setting.horizons.clone(),
            period_s: 1.0 / setting.rate_hz,
            rest: Motion { gyro_rad_s: (first.inverse() * earth).into(), ..begin },
            rows: Arc::clone(&along.rows),
            samples_per_row,
            rests: (setting.begin + setting.align) as usize * setting.ratio(),
            has_temperature: has_temperature && along.rows.iter().any(|row| row.temperature_c.is_some()),
        };
        if is_at_rest(&begin) {
            path.rest = begin;
        }
        path.follow(setting.ratio() / samples_per_row as usize, earth);
        Ok(path)
    }

    /// Integrates the truth, of which every `every`-th row is sent.
    fn follow(&mut self, every: usize, earth: Vector3<f64>) {
        let count = self.horizons.last().copied().unwrap_or(0) as usize;
        let mut attitude = self.first;
        for row in self.rows.iter().step_by(every.max(1)).take(count) {
            let (rate, force) = (Vector3::from(row.gyro_rad_s), Vector3::from(row.accel_m_s2));
            let seen = attitude.inverse() * earth;
            let (next, [velocity, position], forward) = held(attitude, (rate - seen) * self.period_s, force);
            self.steps.push(Step { rate, force, earth: seen, forward, velocity, position });
            attitude = next;
            if self.horizons.get(self.ends.len()).is_some_and(|horizon| *horizon == self.steps.len() as u64) {
                self.ends.push(attitude);
            }
        }
    }

    /// Returns what each channel of a perfect sensor sends, from switch-on on.
    pub(super) fn truth(&self, sample: u64, rests: u64) -> Errors {
        let step = sample.checked_sub(rests).and_then(|sample| self.steps.get(sample as usize));
        let (rate, force) = match step {
            Some(step) => (step.rate.into(), step.force.into()),
            None => (self.rest.gyro_rad_s, self.rest.accel_m_s2),
        };
        let ([a, b, c], [d, e, f]): ([f64; 3], [f64; 3]) = (rate, force);
        [a, b, c, d, e, f]
    }

    /// Returns a simulation of `model` from switch-on on: moved, or at rest without gravity at the motion's temperature.
    pub(super) fn simulator(
        &self,
        setting: &Setting<'_>,
        model: &SensorModel,
        seed: u64,
        moved: bool,
    ) -> Result<Simulator, CostError> {
        let mut simulator = Simulator::new(model, seed, setting.rate_hz, setting.record_s())?;
        if moved || self.has_temperature {
            let feel = move |row: Motion| match moved {
                true => row,
                false => Motion { temperature_c: row.temperature_c, ..Motion::default() },
            };
            let rows = Arc::clone(&self.rows);
            let rows = (0..rows.len()).map(move |place| rows[place]);
            let rest = std::iter::repeat_n(self.rest, self.rests);
            simulator = simulator.with_motion(rest.chain(between(rows, self.samples_per_row)).map(feel));
        }
        if !self.has_temperature {
            let course = setting.temperature.clone();
            simulator = simulator.with_temperature(move |time_s: f64| course.at(time_s));
        }
        Ok(simulator)
    }

    /// Returns the error of each quantity at each horizon for errors of the channels sample by sample.
    pub(super) fn navigate(&self, mut errors: impl FnMut(usize) -> Errors) -> Vec<Values> {
        let mut navigator = Navigator::new(self);
        (0..self.steps.len()).for_each(|sample| navigator.push(errors(sample)));
        navigator.found
    }
}

/// Returns whether a motion begins at rest, up to the turn of the Earth.
pub(super) fn is_at_rest(begin: &Motion) -> bool {
    Vector3::from(begin.gyro_rad_s).norm() <= EARTH_RAD_S
}

/// Returns the attitude, sensor to world, of a sensor at rest: z up, x the horizontal direction of the sensor's x axis, or of
/// its y axis if x is steeper than 45°.
fn attitude_at_rest(along: &Along, begin: &Motion) -> Result<UnitQuaternion<f64>, MotionRefusal> {
    let force = Vector3::from(begin.accel_m_s2);
    let found = force.norm();
    if (found - imu_core::units::STANDARD_GRAVITY_M_S2).abs() > GRAVITY_WITHIN_M_S2 {
        return Err(MotionRefusal::Start { name: along.name.clone(), found });
    }
    let up = force / found;
    let ahead = if up.x.abs() <= STEEP { Vector3::x() } else { Vector3::y() };
    let x = (ahead - up * up.dot(&ahead)).normalize();
    let axes = Matrix3::from_columns(&[x, up.cross(&x), up]).transpose();
    Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)))
}

/// Returns attitude after a period, the mean of the force in the world's axes over it and twice integrated, and R·J₁.
fn held(
    attitude: UnitQuaternion<f64>,
    turn: Vector3<f64>,
    force: Vector3<f64>,
) -> (UnitQuaternion<f64>, [Vector3<f64>; 2], Matrix3<f64>) {
    let square = turn.norm_squared();
    let angle = square.sqrt();
    // (1 − cos φ)/φ², (φ − sin φ)/φ³, (φ²/2 + cos φ − 1)/φ⁴.
    let [a, b, c] = if angle < SMALL_TURN_RAD {
        let series = |first: f64, terms: [f64; 3]| {
            first * (1.0 - square / terms[0] * (1.0 - square / terms[1] * (1.0 - square / terms[2])))
        };
        [
            series(1.0 / 2.0, [12.0, 30.0, 56.0]),
            series(1.0 / 6.0, [20.0, 42.0, 72.0]),
            series(1.0 / 24.0, [30.0, 56.0, 90.0]),
        ]
    } else {
        let (sine, cosine) = angle.sin_cos();
        [(1.0 - cosine) / square, (angle - sine) / (square * angle), (0.5 * square + cosine - 1.0) / (square * square)]
    };
    let cross = turn.cross_matrix();
    let twice = cross * cross;
    let rotation = attitude.to_rotation_matrix().into_inner();
    let once = rotation * (Matrix3::identity() + cross * a + twice * b);
    let again = rotation * (Matrix3::identity() * 0.5 + cross * b + twice * c);
    (attitude * UnitQuaternion::from_scaled_axis(turn), [once * force, again * force], once)
}

/// Integrates a sensor's samples beside the truth: the full nonlinear strapdown.
#[derive(Debug)]
pub(super) struct Navigator<'a> {
    path: &'a Path,
    attitude: UnitQuaternion<f64>,
    velocity: Vector3<f64>,
    position: Vector3<f64>,
    taken: usize,
    /// The errors at each horizon so far.
    pub(super) found: Vec<Values>,
}

impl<'a> Navigator<'a> {
    pub(super) fn new(path: &'a Path) -> Self {
        let (velocity, position) = (Vector3::zeros(), Vector3::zeros());
        Self { path, attitude: path.first, velocity, position, taken: 0, found: Vec::new() }
    }

    /// Takes the channels' errors in the next sample.
    pub(super) fn push(&mut self, errors: Errors) {
        let Some(step) = self.path.steps.get(self.taken) else { return };
        let [a, b, c, d, e, f] = errors;
        let dt = self.path.period_s;
        let turn = (step.rate - step.earth + Vector3::new(a, b, c)) * dt;
        let (next, [velocity, position], _) = held(self.attitude, turn, step.force + Vector3::new(d, e, f));
        self.position += self.velocity * dt + (position - step.position) * (dt * dt);
        self.velocity += (velocity - step.velocity) * dt;
        self.attitude = next;
        self.taken += 1;
        let place = self.found.len();
        if self.path.horizons.get(place).is_some_and(|horizon| *horizon == self.taken as u64) {
            let end = self.path.ends[place];
            // The product of equal quaternions has its rounding.
            let is_apart = self.attitude != end;
            let angle = if is_apart { (self.attitude * end.inverse()).scaled_axis() } else { Vector3::zeros() };
            let (v, p) = (self.velocity, self.position);
            self.found.push([angle.x, angle.y, angle.z, v.x, v.y, p.x, p.y]);
        }
    }
}

/// Integrates small errors of one channel along a path, to first order.
#[derive(Debug)]
pub(super) struct Small<'a> {
    path: &'a Path,
    axis: usize,
    is_gyro: bool,
    angle: Vector3<f64>,
    velocity: Vector3<f64>,
    position: Vector3<f64>,
    taken: usize,
    /// The errors at each horizon so far.
    pub(super) found: Vec<Values>,
}

impl<'a> Small<'a> {
    /// Creates the sums for the channel at a place of [`USED`].
    pub(super) fn new(path: &'a Path, channel: usize) -> Self {
        let [angle, velocity, position] = [Vector3::zeros(); 3];
        let (axis, is_gyro) = (channel % 3, channel < 3);
        Self { path, axis, is_gyro, angle, velocity, position, taken: 0, found: Vec::new() }
    }

    /// Takes the channel's error in the next sample.
    pub(super) fn push(&mut self, error: f64) {
        let Some(step) = self.path.steps.get(self.taken) else { return };
        let dt = self.path.period_s;
        let own = step.forward.column(self.axis) * (error * dt);
        if self.is_gyro {
            // Over the period the angle grows evenly.
            self.position +=
                self.velocity * dt + (self.angle * 0.5 + own * (1.0 / 6.0)).cross(&step.velocity) * (dt * dt);
            self.velocity += (self.angle + own * 0.5).cross(&step.velocity) * dt;
            self.angle += own;
        } else {
            self.position += self.velocity * dt + own * (0.5 * dt);
            self.velocity += own;
        }
        self.taken += 1;
        if self.path.horizons.get(self.found.len()).is_some_and(|horizon| *horizon == self.taken as u64) {
            let (angle, v, p) = (self.angle, self.velocity, self.position);
            self.found.push([angle.x, angle.y, angle.z, v.x, v.y, p.x, p.y]);
        }
    }
}

/// Returns the place of a quantity in [`Values`].
pub(super) fn place_of(quantity: Quantity) -> usize {
    Quantity::all().iter().position(|own| *own == quantity).unwrap_or(0)
}
