//! The reasons why a sensor cannot be compared with a reference.

/// A reference that was refused, or a pair that cannot be compared.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PoseError {
    /// The columns are of no known form.
    #[error(
        "the reference has the columns `{found}`; expected `time_s,q_w,q_x,q_y,q_z` (and `p_x_m,p_y_m,p_z_m`), EuRoC's or TUM's \
         poses, `time_s,ref_gyro_z_rad_s`, or `time_s,encoder_rpm` with --reference-axis"
    )]
    Columns {
        /// The header that was found, shortened.
        found: String,
    },
    /// An export has rotations as three angles, of which several conventions exist.
    #[error("line {line} of the reference: rotations as RX, RY, RZ alone; export quaternions (RX, RY, RZ, RW)")]
    Angles {
        /// The line, from 1.
        line: u64,
    },
    /// A cell is not a finite number, or a row has too few.
    #[error("line {line} of the reference: found `{found}`; expected {expected}")]
    Cell {
        /// The line, from 1.
        line: u64,
        /// What was found, shortened.
        found: String,
        /// What a cell there may be.
        expected: &'static str,
    },
    /// A row's quaternion has no direction.
    #[error("line {line} of the reference: the quaternion has the norm {norm:.3}; expected 1")]
    Norm {
        /// The line, from 1.
        line: u64,
        /// The norm.
        norm: f64,
    },
    /// Times do not increase.
    #[error("line {line} of the reference is at {time_s} s; each row has to be later than the one before")]
    Backwards {
        /// The line, from 1.
        line: u64,
        /// The row's time, s.
        time_s: f64,
    },
    /// An encoder's file does not state its axis.
    #[error(
        "an encoder has one axis, which its file does not name: give it with --reference-axis x, y or z, in a request as `reference_axis`"
    )]
    Axis,
    /// The recording lacks a channel.
    #[error("the recording has no {channel}; this reference is compared with it")]
    Channel {
        /// The channel that is wanted.
        channel: String,
    },
    /// Too little of both is at the same time.
    #[error("recording and reference have {found_s:.1} s in common; at least {least_s:.0} s are needed")]
    Overlap {
        /// The common time, s.
        found_s: f64,
        /// The time that is needed, s.
        least_s: f64,
    },
    /// The sensor was not turned enough to match anything.
    #[error(
        "the reference turns by {found_deg:.1}° in all, which determines neither axes nor clock; at least {least_deg:.0}° are \
         needed"
    )]
    Still {
        /// The angle, °.
        found_deg: f64,
        /// The angle that is needed, °.
        least_deg: f64,
    },
    /// The rates of both have nothing to do with each other.
    #[error(
        "the turning of recording and reference does not match at any offset of their clocks (correlation {best:.2}, at least \
         {least:.2} is needed): are they of one trial?"
    )]
    Unlike {
        /// The best correlation.
        best: f64,
        /// The correlation that is needed.
        least: f64,
    },
    /// Sensor and reference contradict each other in too much of the time.
    #[error(
        "gyroscope and reference contradict each other in {percent:.0} % of the time ({stretches} of the reference's clock): cut \
         these stretches out, or repeat the trial"
    )]
    Bad {
        /// The part of the time, %.
        percent: f64,
        /// The stretches.
        stretches: String,
    },
    /// The reference lasts far longer than the recording, or either is too long for a search.
    #[error(
        "the reference lasts {found_s:.0} s, the recording {record_s:.0} s; at most ten times the recording (or an hour), and 12 hours \
         of either, can be searched: are its times in seconds? Else cut it"
    )]
    Long {
        /// The duration of the reference, s.
        found_s: f64,
        /// The duration of the recording, s.
        record_s: f64,
    },
    /// A channel shows one value.
    #[error("{channel} shows the same value throughout: an axis is dead, and nothing can be compared")]
    Dead {
        /// The channel.
        channel: String,
    },
    /// The values are a multiple of the reference's that is no known unit.
    #[error(
        "the gyroscope shows {ratio:.3} times the reference's rates, which is no known unit: a dead or clipped axis, another clock rate, or \
         a reference of another body"
    )]
    Ratio {
        /// The ratio.
        ratio: f64,
    },
}
