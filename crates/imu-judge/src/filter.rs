//! The filter: an error-state extended Kalman filter of attitude, velocity, position and the biases of both triads.
//!
//! In: samples, the noise that the filter assumes, fixes. Out: a state and the covariance of its errors. The nominal state is a
//! strapdown integration with a quaternion. The errors are those of truth less estimate; that of the attitude is a small turn in
//! the frame of navigation:
//!
//! ```text
//! C_true = exp(δθ×)·C,   δθ' = −C(δb_g + n_g),   δv' = −(C f)×δθ − C(δb_a + n_a),   δp' = δv
//! ```
//!
//! The matrix A of this system has A⁴ = 0 as long as C and the specific force C f are constant. The transition over a step is
//! then I + A dt + A²dt²/2 + A³dt³/6, and the noise of a step is the integral of polynomials of degree 6, which four points of
//! Gauss and Legendre take exactly. A step may therefore be long at rest; with a motion it is one sample.
//!
//! Source: Solà 2017, Quaternion kinematics for the error-state Kalman filter, section 7 (global errors); Bucy and Joseph 1968 for
//! the form of the update. A turn of the frame of errors after an update is of second order and left out.
//! Validation: `transitions_are_derivatives`, `unaided_covariance_is_the_closed_form`.

use nalgebra::{Cholesky, Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};

/// The number of errors: attitude, velocity, position, gyroscope bias, accelerometer bias, three each.
pub const STATES: usize = 15;
/// Errors of a state, truth less estimate: rad, m/s, m, rad/s, m/s².
pub type Errors = SVector<f64, STATES>;
/// The covariance of errors.
pub type Covariance = SMatrix<f64, STATES, STATES>;
/// Where the triads of errors begin.
pub const ATTITUDE: usize = 0;
/// See [`ATTITUDE`].
pub const VELOCITY: usize = 3;
/// See [`ATTITUDE`].
pub const POSITION: usize = 6;
pub(crate) const GYRO_BIAS: usize = 9;
pub(crate) const ACCEL_BIAS: usize = 12;

/// Abscissae on 0 … 1 and weights of four points (Abramowitz and Stegun 1964, table 25.4).
const GAUSS: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
    (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
];

/// The noise that a filter assumes on an axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Density {
    /// White noise, U/√Hz.
    pub n: f64,
    /// Random walk of the bias, U/√s.
    pub k: f64,
}

/// The noise that a filter assumes: x, y, z of the gyroscope (rad/s), then of the accelerometer (m/s²).
pub type Noise = [Density; 6];

/// A sample: x, y, z of the gyroscope, rad/s, then of the accelerometer, m/s².
pub type Sample = [f64; 6];

/// A nominal state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// The turn from the sensor's frame to that of navigation.
    pub attitude: UnitQuaternion<f64>,
    /// Velocity, m/s.
    pub velocity: Vector3<f64>,
    /// Position, m.
    pub position: Vector3<f64>,
    /// Bias of the gyroscope, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// Bias of the accelerometer, m/s².
    pub accel_bias: Vector3<f64>,
}

impl State {
    /// Returns the state that has these errors.
    pub fn plus(&self, errors: &Errors) -> Self {
        let part = |at: usize| errors.fixed_rows::<3>(at).into_owned();
        Self {
            attitude: UnitQuaternion::from_scaled_axis(part(ATTITUDE)) * self.attitude,
            velocity: self.velocity + part(VELOCITY),
            position: self.position + part(POSITION),
            gyro_bias: self.gyro_bias + part(GYRO_BIAS),
            accel_bias: self.accel_bias + part(ACCEL_BIAS),
        }
    }

    /// Returns the errors of `estimate` if this is the truth.
    pub fn minus(&self, estimate: &Self) -> Errors {
        let mut errors = Errors::zeros();
        let turn = (self.attitude * estimate.attitude.inverse()).scaled_axis();
        errors.fixed_rows_mut::<3>(ATTITUDE).copy_from(&turn);
        errors.fixed_rows_mut::<3>(VELOCITY).copy_from(&(self.velocity - estimate.velocity));
        errors.fixed_rows_mut::<3>(POSITION).copy_from(&(self.position - estimate.position));
        errors.fixed_rows_mut::<3>(GYRO_BIAS).copy_from(&(self.gyro_bias - estimate.gyro_bias));
        errors.fixed_rows_mut::<3>(ACCEL_BIAS).copy_from(&(self.accel_bias - estimate.accel_bias));
        errors
    }

    /// Integrates a sample over its period and returns the turn and the specific force, m/s², at its middle, in the frame of
    /// navigation.
    fn integrate(&mut self, sample: &Sample, dt: f64, gravity: Vector3<f64>) -> (Rotation3<f64>, Vector3<f64>) {
        let [gyro, accel] = [0, 3].map(|at| Vector3::new(sample[at], sample[at + 1], sample[at + 2]));
        let half = UnitQuaternion::from_scaled_axis(0.5 * dt * (gyro - self.gyro_bias));
        let (begin, middle) = (self.attitude, self.attitude * half);
        self.attitude = middle * half;
        let force = accel - self.accel_bias;
        let [first, second, third] = [begin, middle, self.attitude].map(|turn| turn * force + gravity);
        // Simpson's rule for ∫ a ds and ∫ (dt − s) a ds.
        self.position += dt * self.velocity + dt * dt / 6.0 * (first + 2.0 * second);
        self.velocity += dt / 6.0 * (first + 4.0 * second + third);
        (middle.to_rotation_matrix(), middle * force)
    }
}

/// What is observed of the state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fix {
    /// All three angles.
    Attitude(UnitQuaternion<f64>),
    /// Velocity, m/s.
    Velocity(Vector3<f64>),
    /// Position, m.
    Position(Vector3<f64>),
}

/// An error-state filter.
#[derive(Debug, Clone)]
pub struct Filter {
    /// The estimate.
    pub state: State,
    /// The covariance of its errors.
    pub covariance: Covariance,
    noise: Noise,
    gravity: Vector3<f64>,
}

impl Filter {
    /// Creates a filter at a state. `gravity` is the acceleration of free fall in the frame of navigation, m/s².
    pub fn new(state: State, covariance: Covariance, noise: Noise, gravity: Vector3<f64>) -> Self {
        Self { state, covariance, noise, gravity }
    }

    /// Integrates samples that last `dt` s each, and takes one step of the covariance over all of them.
    pub fn predict(&mut self, samples: &[Sample], dt: f64) {
        if samples.is_empty() {
            return;
        }
        let (mut turn, mut force) = (Matrix3::zeros(), Vector3::zeros());
        for sample in samples {
            let (own_turn, own_force) = self.state.integrate(sample, dt, self.gravity);
            turn += own_turn.matrix();
            force += own_force;
        }
        let count = samples.len() as f64;
        let (system, time_s) = (system(&(turn / count), &(force / count)), dt * count);
        let transition = transition(&system, time_s);
        let noise = self.noise_of_step(&system, &(turn / count), time_s);
        self.covariance = transition * self.covariance * transition.transpose() + noise;
    }

    /// Returns ∫ Φ(s) D Φ(s)ᵀ ds over a step, with D the densities in the frame of navigation.
    fn noise_of_step(&self, system: &Covariance, turn: &Matrix3<f64>, time_s: f64) -> Covariance {
        let squares = |at: usize, of: fn(&Density) -> f64| {
            Matrix3::from_diagonal(&Vector3::from_fn(|axis, _| of(&self.noise[at + axis]).powi(2)))
        };
        let mut density = Covariance::zeros();
        let mut set = |at: usize, block: Matrix3<f64>| density.fixed_view_mut::<3, 3>(at, at).copy_from(&block);
        set(ATTITUDE, turn * squares(0, |of| of.n) * turn.transpose());
        set(VELOCITY, turn * squares(3, |of| of.n) * turn.transpose());
        set(GYRO_BIAS, squares(0, |of| of.k));
        set(ACCEL_BIAS, squares(3, |of| of.k));
        GAUSS.iter().fold(Covariance::zeros(), |sum, (place, weight)| {
            let until = transition(system, place * time_s);
            sum + until * density * until.transpose() * (weight * time_s)
        })
    }

    /// Takes a fix whose errors have the standard deviation `sd` on each axis, and returns the square of the innovation over
    /// its covariance, with the mean 3. `None` leaves the filter as it is: the covariance of the innovation is not positive
    /// definite.
    pub fn fix(&mut self, fix: &Fix, sd: f64) -> Option<f64> {
        let (at, difference) = match fix {
            Fix::Attitude(seen) => (ATTITUDE, (seen * self.state.attitude.inverse()).scaled_axis()),
            Fix::Velocity(seen) => (VELOCITY, seen - self.state.velocity),
            Fix::Position(seen) => (POSITION, seen - self.state.position),
        };
        let variance = Matrix3::from_diagonal_element(sd * sd);
        let innovation = Cholesky::new(self.covariance.fixed_view::<3, 3>(at, at) + variance)?;
        let gain = self.covariance.fixed_columns::<3>(at) * innovation.inverse();
        self.state = self.state.plus(&(gain * difference));
        let mut kept = Covariance::identity();
        let mut columns = kept.fixed_columns_mut::<3>(at);
        columns -= gain;
        self.covariance = kept * self.covariance * kept.transpose() + gain * variance * gain.transpose();
        Some(difference.dot(&innovation.solve(&difference)))
    }
}

/// Returns the matrix A of the errors, for the turn from the sensor and the specific force in the frame of navigation.
fn system(turn: &Matrix3<f64>, force: &Vector3<f64>) -> Covariance {
    let mut all = Covariance::zeros();
    let mut set = |row: usize, column: usize, block: Matrix3<f64>| {
        all.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
    };
    set(ATTITUDE, GYRO_BIAS, -turn);
    set(VELOCITY, ATTITUDE, -force.cross_matrix());
    set(VELOCITY, ACCEL_BIAS, -turn);
    set(POSITION, VELOCITY, Matrix3::identity());
    all
}

/// Returns exp(A·time), exact because A⁴ = 0.
fn transition(system: &Covariance, time_s: f64) -> Covariance {
    let first = system * time_s;
    let second = first * first / 2.0;
    Covariance::identity() + first + second + second * first / 3.0
}
