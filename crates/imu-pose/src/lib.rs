//! A sensor compared with poses or rates that another instrument measured: axes, signs, units and clock first, then scale
//! factors, cross-axis sensitivity, bias, latency, with intervals.
//!
//! In: a [`Track`] (samples with their stamps) and [`Poses`] or [`Rates`]. Out: a [`Calibration`] by triad. Pure.
//!
//! 1. The clocks are matched by the magnitude of the angular rate, which no rotation of frames changes ([`rough`]).
//! 2. The gyroscope is integrated between poses and compared with their relative rotation ([`gyro`]). The noise of the poses is
//!    then in what remains, not in what is multiplied, so that it makes no scale factor smaller (errors in variables).
//! 3. The accelerometer is averaged over the kernel of a second difference of positions ([`accel`]).
//! 4. Each matrix is split into a rotation of frames and a symmetric matrix ([`triad`]). Errors come from leaving out parts of the
//!    record in turn ([`fit`]).
//! 5. What the motion does not determine has no number.

mod accel;
mod calibration;
mod correction;
mod course;
mod error;
mod fit;
mod frames;
mod gyro;
mod rate;
mod read;
mod reference;
mod rough;
#[cfg(test)]
mod tests;
mod track;
mod triad;
pub mod tumble;

pub use calibration::{Calibration, StatedSensor, Stretch, against_poses, against_rates};
pub use correction::{Correction, Deviations};
pub use course::{CourseError, Instant, course};
pub use error::PoseError;
pub use fit::Part;
pub use frames::{Frames, SignedAxis, Unit};
pub use read::{External, read};
pub use reference::{Poses, Rates};
pub use track::Track;
pub use triad::{Estimate, Stated, TriadFit};
