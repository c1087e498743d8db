//! The reasons why a response cannot be fitted.

use imu_core::sample::{Channel, Triad};
use imu_model::effects::{EffectKind, Refusal};

/// The reasons why a record cannot be compared with its reference.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ResponseError {
    /// No motion drives this triad.
    #[error("cannot hold {} against a motion: expected accel or gyro", found.name())]
    Triad {
        /// The given triad.
        found: Triad,
    },
    /// The rate is not a number above 0.
    #[error("the rate must be a finite number above 0, found {found} Hz")]
    Rate {
        /// The given rate.
        found: f64,
    },
    /// Two columns that belong together differ in length.
    #[error("{what}: expected {expected} samples, found {found}")]
    Length {
        /// The column.
        what: &'static str,
        /// The number of samples of the record's first column.
        expected: usize,
        /// The number of samples of this column.
        found: usize,
    },
    /// There are too few samples.
    #[error("a response needs {needed} samples or more, found {found}")]
    TooShort {
        /// The minimum number of samples.
        needed: usize,
        /// The number of samples.
        found: usize,
    },
    /// A value is not a finite number.
    #[error("{what}: expected finite numbers, found {found} at sample {index}")]
    NotFinite {
        /// The column.
        what: &'static str,
        /// The place in the column.
        index: usize,
        /// The value.
        found: f64,
    },
    /// The noise of a channel has no density that follows from its parameters alone.
    #[error("{channel}: its effects have no spectral density; expected N, B, K and stationary effects")]
    NoDensity {
        /// The channel.
        channel: Channel,
    },
    /// A density is not a number above 0: without noise, the samples have no weights.
    #[error("{channel}: expected a noise density above 0, found {found} at {frequency_hz} Hz")]
    Density {
        /// The channel.
        channel: Channel,
        /// The frequency, Hz.
        frequency_hz: f64,
        /// The density at that frequency, U²/Hz.
        found: f64,
    },
    /// An effect is requested twice.
    #[error("`{effect}` is asked for twice; expected each effect once")]
    Twice {
        /// The effect.
        effect: EffectKind,
    },
    /// A parameter or an effect that this triad cannot have.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// Too few samples of an axis lie within the sensor's range and the reference's time.
    #[error("{channel}: expected {needed} samples or more within the sensor's range and the reference, found {found}")]
    LeftOut {
        /// The channel.
        channel: Channel,
        /// The minimum number of samples.
        needed: usize,
        /// The number of samples.
        found: usize,
    },
}
