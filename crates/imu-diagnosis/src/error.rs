//! The reasons why a diagnosis is refused.

/// The reasons why a record and a model cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DiagnosisError {
    /// A channel of the model is not in the recording.
    #[error("the recording has no {channel}, which the model has; it has {found}")]
    MissingChannel {
        /// The channel.
        channel: String,
        /// The channels of the recording.
        found: String,
    },
    /// The rates differ.
    #[error("the recording has {found_hz} Hz and the simulator {expected_hz} Hz: give two of one rate, within 0.05 %")]
    Rate {
        /// The recording's rate.
        found_hz: f64,
        /// The model's rate.
        expected_hz: f64,
    },
    /// Too few samples.
    #[error(
        "the recording has {}; at least {least} are needed ({least_s:.1} s at its rate)",
        imu_core::units::counted(*found as u64, "sample", "samples")
    )]
    TooShort {
        /// The number of samples in the recording.
        found: usize,
        /// The minimum number of samples.
        least: usize,
        /// The minimum duration, s.
        least_s: f64,
    },
    /// A channel does not move.
    #[error("{channel} shows the same value throughout, {value}: there is no noise to compare")]
    Constant {
        /// The channel.
        channel: String,
        /// Its value.
        value: f64,
    },
    /// A channel has a value that is not a number.
    #[error("{channel} has {value} at sample {index}; mark the sample as missing or leave it out")]
    NotFinite {
        /// The channel.
        channel: String,
        /// The value.
        value: f64,
        /// The sample's index, from 0.
        index: usize,
    },
    /// A channel is at its limit for most of the time.
    #[error("{channel} is at its limit, {value}, in {share_percent} % of the samples: there is no noise to compare")]
    Saturated {
        /// The channel.
        channel: String,
        /// The limit.
        value: f64,
        /// The share of samples at the limit.
        share_percent: f64,
    },
    /// Columns of different lengths.
    #[error("{channel} has {found} samples where the others have {expected}")]
    Lengths {
        /// The channel.
        channel: String,
        /// The number of samples of the channel.
        found: usize,
        /// The number of samples of the other channels.
        expected: usize,
    },
    /// A motion drives no triad of the model.
    #[error("the model has neither all of gyro x, y, z nor all of accel x, y, z; a motion drives no other channels")]
    NotDriven,
    /// Recording and reference overlap too little.
    #[error("recording and reference have {common} samples in common; at least {least} are needed")]
    Reference {
        /// The number of common samples.
        common: usize,
        /// The minimum number of common samples.
        least: usize,
    },
    /// The reference is far longer than the recording.
    #[error(
        "the reference lasts {found_s:.0} s, the recording {record_s:.0} s; at most ten times the recording and an hour can be \
         searched: is `time_s` in seconds? Else cut it"
    )]
    ReferenceLong {
        /// The duration of the reference.
        found_s: f64,
        /// The duration of the recording.
        record_s: f64,
    },
    /// The recording cannot be compared with poses or rates.
    #[error(transparent)]
    Pose(#[from] imu_pose::PoseError),
    /// A triad's response cannot be fitted.
    #[error("the answer to the motion cannot be fitted: {0}")]
    Response(#[from] super::response::ResponseError),
    /// The caller's worker left a channel out, because the result is no longer wanted.
    #[error("the diagnosis was called off")]
    CalledOff,
    /// The model cannot be simulated at this rate.
    #[error("the model cannot be simulated: {0}")]
    Model(String),
}
