//! Allan deviations: exact sums, curves, confidence.
//!
//! A series of `n` rate samples `y` is integrated to `n + 1` phases (a leading 0, then running sums); the overlapping
//! estimator averages all second differences `X[i] − 2 X[i−m] + X[i−2m]`, so that averaging factor `m` has `n + 1 − 2m`
//! terms (Riley & Howe, NIST SP1065, equation 10; the convention of allantools and Stable32). `tests/golden/allan` has
//! the reference values for all of this.

mod block;
#[cfg(test)]
mod coverage;
mod curve;
mod deviation;
mod edf;
mod error;
mod fixed_point;
#[cfg(test)]
mod golden;
mod grid;
mod identify;
mod integers;
mod kernel;
mod live;
mod overlapping;
mod point;
mod report;
mod strided;
mod sums;

pub use curve::AllanCurve;
pub(crate) use curve::first_fall;
pub use deviation::{Estimator, Phases, SquareSum};

pub use edf::{
    CONFIDENCE_68, CONFIDENCE_95, ConfidenceFactors, NoiseType, confidence_factors, equivalent_degrees_of_freedom,
};
pub use error::AllanError;
pub use fixed_point::FixedPoint;
pub use grid::{TauGrid, TauSpacing};
pub use live::LiveAllan;
pub use overlapping::Overlapping;
pub use point::{AllanPoint, noise_by_slope};
pub use report::AllanReport;
pub use sums::AllanSums;
