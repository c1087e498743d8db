//! Why a response cannot be fitted.

use imu_core::sample::{Channel, Triad};
use imu_model::effects::{EffectKind, Refusal};

/// Why a record cannot be held against its reference.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ResponseError {
    /// No motion drives this triad.
    #[error("cannot hold {} against a motion: expected accel or gyro", found.name())]
    Triad {
        /// The triad as it was given.
        found: Triad,
    },
    /// The rate is not a number above 0.
    #[error("the rate must be a finite number above 0, found {found} Hz")]
    Rate {
        /// The rate as it was given.
        found: f64,
    },
    /// Two columns that belong together differ in length.
    #[error("{what}: expected {expected} samples, found {found}")]
    Length {
        /// Which of them.
        what: &'static str,
        /// The samples of the record's first column.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// There are too few samples.
    #[error("a response needs {needed} samples or more, found {found}")]
    TooShort {
        /// The least that is needed.
        needed: usize,
        /// How many there are.
        found: usize,
    },
    /// A value is not a finite number.
    #[error("{what}: expected finite numbers, found {found} at sample {index}")]
    NotFinite {
        /// Which column.
        what: &'static str,
        /// Where.
        index: usize,
        /// What stood there.
        found: f64,
    },
    /// The noise of a channel has no density that its parameters alone give.
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
        /// The density there, U²/Hz.
        found: f64,
    },
    /// An effect is asked for twice.
    #[error("`{effect}` is asked for twice; expected each effect once")]
    Twice {
        /// Which.
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
        /// The least that is needed.
        needed: usize,
        /// How many there are.
        found: usize,
    },
}
