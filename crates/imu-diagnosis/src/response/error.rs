//! The reasons why a response cannot be fitted.

use imu_core::sample::Channel;

/// The reasons why a record cannot be compared with its reference.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ResponseError {
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
