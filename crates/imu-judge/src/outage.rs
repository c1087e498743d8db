//! Outages: a filter that has fixes for a while and then none, and its errors at the end.
//!
//! In: samples of a sensor at rest, the noise that the filter assumes, a plan. Out: the errors at the end of each outage and the
//! covariance that the filter states for them. The truth is known because the sensor does not move.
//!
//! The record is cut into stretches of alignment, aided phase and outage. In each of them a filter starts again, so the outages of a
//! sensor of N and K alone are independent. The alignment takes the mean of each channel as its bias, with the variance
//! N²/T + K²T/3 (`docs/filters.md`). Attitude, velocity and position are exact at its end: position and heading count from there.

use crate::filter::{ACCEL_BIAS, Covariance, Filter, Fix, GYRO_BIAS, Noise, Sample, State};
use imu_core::units::STANDARD_GRAVITY_M_S2;
use imu_cost::{FilterRequest, Over};
use imu_model::effects::{Stream, StreamId};
use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};

/// What the filter observes beside the attitude.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Aid {
    /// That it stands still: the velocity is 0.
    ZeroVelocity,
    /// Where it is.
    Position,
}

/// The course of a filter: alignment, fixes at an interval, then an outage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// The length of the alignment, s.
    pub align_s: f64,
    /// The time with fixes, s.
    pub aided_s: f64,
    /// The time from one fix to the next, s.
    pub interval_s: f64,
    /// The time without fixes, s.
    pub outage_s: f64,
    /// What is observed.
    pub aid: Aid,
    /// The standard deviation of each axis of it, m/s or m.
    pub aid_sd: f64,
    /// The standard deviation of each angle of the attitude, which is observed at the same times, rad. At rest heading is
    /// observed by nothing else, and an accelerometer's bias looks like roll and pitch.
    pub attitude_sd: f64,
}

impl Plan {
    /// Returns the request for the parameters that match the end of the outage: horizons from `from_s` to its length, and all
    /// the time that the filter has seen its bias as alignment.
    pub fn request(&self, from_s: f64) -> FilterRequest {
        let over = Some(Over { from_s, to_s: self.outage_s });
        FilterRequest { over, align_s: self.align_s + self.aided_s, ..FilterRequest::default() }
    }
}

/// The end of an outage: rad, m/s, m, three axes each.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Truth less estimate.
    pub errors: SVector<f64, 9>,
    /// The covariance that the filter states.
    pub covariance: SMatrix<f64, 9, 9>,
}

/// Returns the ends of all outages of a record at rest.
///
/// `up` is the direction of the specific force in the sensor's frame. Fixes have errors of their standard deviations, drawn from
/// `seed`: all filters with one seed get the same fixes. A record that is shorter than one stretch has no outage.
pub fn outages(
    samples: &[Sample],
    rate_hz: f64,
    up: Vector3<f64>,
    noise: &Noise,
    plan: &Plan,
    seed: u64,
) -> Vec<Outcome> {
    let count = |time_s: f64| (time_s * rate_hz).round() as usize;
    let [align, aided, all, step] =
        [plan.align_s, plan.align_s + plan.aided_s, plan.align_s + plan.aided_s + plan.outage_s, plan.interval_s]
            .map(|time_s| count(time_s).max(1));
    let mut stream = Stream::new(seed, StreamId { owner: 1 << 16, effect: 0, instance: 0 });
    let stretch = |own: &[Sample]| {
        let mut filter = aligned(&own[..align], rate_hz, up, noise);
        let truth = State { gyro_bias: Vector3::zeros(), accel_bias: Vector3::zeros(), ..filter.state };
        for samples in own[align..aided].chunks(step) {
            filter.predict(samples, 1.0 / rate_hz);
            let mut error = |sd: f64| Vector3::from_fn(|_, _| sd * stream.normal());
            let turn = UnitQuaternion::from_scaled_axis(error(plan.attitude_sd));
            filter.fix(&Fix::Attitude(turn * truth.attitude), plan.attitude_sd);
            let seen = error(plan.aid_sd);
            let fix = match plan.aid {
                Aid::ZeroVelocity => Fix::Velocity(truth.velocity + seen),
                Aid::Position => Fix::Position(truth.position + seen),
            };
            filter.fix(&fix, plan.aid_sd);
        }
        own[aided..].chunks(step).for_each(|samples| filter.predict(samples, 1.0 / rate_hz));
        Outcome {
            errors: truth.minus(&filter.state).fixed_rows::<9>(0).into_owned(),
            covariance: filter.covariance.fixed_view::<9, 9>(0, 0).into_owned(),
        }
    };
    samples.chunks_exact(all).map(stretch).collect()
}

/// Returns a filter at the end of an alignment.
pub(crate) fn aligned(samples: &[Sample], rate_hz: f64, up: Vector3<f64>, noise: &Noise) -> Filter {
    let count = samples.len() as f64;
    let mean = |at: usize| Vector3::from_fn(|axis, _| samples.iter().map(|of| of[at + axis]).sum::<f64>() / count);
    let force = STANDARD_GRAVITY_M_S2 * up;
    let state = State {
        attitude: UnitQuaternion::identity(),
        velocity: Vector3::zeros(),
        position: Vector3::zeros(),
        gyro_bias: mean(0),
        accel_bias: mean(3) - force,
    };
    let time_s = count / rate_hz;
    let mut covariance = Covariance::zeros();
    for (axis, of) in noise.iter().enumerate() {
        let at = if axis < 3 { GYRO_BIAS + axis } else { ACCEL_BIAS + axis - 3 };
        covariance[(at, at)] = of.n * of.n / time_s + of.k * of.k * time_s / 3.0;
    }
    Filter::new(state, covariance, *noise, -force)
}
