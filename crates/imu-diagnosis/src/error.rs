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
        /// The recording's.
        found_hz: f64,
        /// The model's.
        expected_hz: f64,
    },
    /// Too few samples.
    #[error("the recording has {found} samples; at least {least} are needed ({least_s} s at its rate)")]
    TooShort {
        /// Those there are.
        found: usize,
        /// Those it takes.
        least: usize,
        /// In s.
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
        /// What stands there.
        value: f64,
        /// Where, from 0.
        index: usize,
    },
    /// A channel is at its limit for most of the time.
    #[error("{channel} is at its limit, {value}, in {share_percent} % of the samples: there is no noise to compare")]
    Saturated {
        /// The channel.
        channel: String,
        /// The limit.
        value: f64,
        /// How often.
        share_percent: f64,
    },
    /// Columns of different lengths.
    #[error("{channel} has {found} samples where the others have {expected}")]
    Lengths {
        /// The channel.
        channel: String,
        /// Its samples.
        found: usize,
        /// The others'.
        expected: usize,
    },
    /// No triad of the model is one that a motion drives.
    #[error("the model has neither all of gyro x, y, z nor all of accel x, y, z; a motion drives no other channels")]
    NotDriven,
    /// Recording and reference have too little in common.
    #[error("recording and reference have {common} samples in common; at least {least} are needed")]
    Reference {
        /// Those that both have.
        common: usize,
        /// Those it takes.
        least: usize,
    },
    /// The reference is far longer than the recording.
    #[error(
        "the reference lasts {found_s:.0} s, the recording {record_s:.0} s; at most ten times the recording and an hour can be \
         searched: is `time_s` in seconds? Else cut it"
    )]
    ReferenceLong {
        /// The reference's length.
        found_s: f64,
        /// The recording's.
        record_s: f64,
    },
    /// A triad's answer cannot be fitted.
    #[error("the answer to the motion cannot be fitted: {0}")]
    Response(#[from] super::response::ResponseError),
    /// The caller that works on it left a channel out, because the result is no longer wanted.
    #[error("the diagnosis was called off")]
    CalledOff,
    /// The model cannot be simulated at this rate.
    #[error("the model cannot be simulated: {0}")]
    Model(String),
}
