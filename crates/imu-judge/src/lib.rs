//! A judge of noise parameters: an error-state Kalman filter that loses its fixes.
//!
//! In: samples of a sensor at rest, and the white noise and random walk that a filter assumes on each axis. Out: whether the
//! filter's errors at the ends of outages are those that its covariance states. Pure. `docs/filters.md` has the results.

mod assumed;
mod filter;
mod outage;
mod score;
#[cfg(test)]
mod tests;

pub use assumed::{NAMES, assumed, channels, datasheet, own};
pub use filter::{
    ATTITUDE, Covariance, Density, Errors, Filter, Fix, Noise, POSITION, STATES, Sample, State, VELOCITY,
};
pub use outage::{Aid, Outcome, Plan, outages};
pub use score::{Score, score};
