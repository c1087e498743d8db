//! Rests of a recording ([`imu_pose::tumble`]).

use crate::recording::Recording;
use imu_core::sample::Triad;
pub(super) use imu_pose::tumble::Rest;

/// Returns the rests of a record with an accelerometer, in order.
pub(super) fn rests(real: &Recording) -> Vec<Rest> {
    let Some(accel) = real.triad(Triad::Accel) else { return Vec::new() };
    imu_pose::tumble::rests(real.rate_hz, accel, real.triad(Triad::Gyro), &|place| real.is_missing(place))
}

/// Returns the number of distinct poses.
pub(super) fn poses(rests: &[Rest]) -> usize {
    let all = imu_pose::tumble::poses(rests.iter().map(|rest| rest.force));
    all.iter().flatten().max().map_or(0, |last| last + 1)
}
