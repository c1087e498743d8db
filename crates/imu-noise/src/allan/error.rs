//! The inputs that the Allan estimators refuse.

/// The reasons why an Allan estimator refused its input.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AllanError {
    /// A grid needs at least one averaging factor.
    #[error(
        "no averaging factor fits a longest segment of {}: record at least {needed} without a gap",
        imu_core::units::counted(*samples, "sample", "samples")
    )]
    TooShort {
        /// Length of the longest segment.
        samples: u64,
        /// The length that gives one factor.
        needed: u64,
    },
    /// An averaging factor is 0 or larger than exact sums allow.
    #[error("averaging factor {found} is outside 1 to {largest}")]
    FactorOutOfRange {
        /// The factor.
        found: u64,
        /// The largest allowed factor.
        largest: u64,
    },
    /// Fixed-point range and resolution need more bits than exact sums have.
    #[error(
        "a range of 2^{range_exponent} at 10^-{decimals} · 2^-{binary} needs more than {bits} bits: \
         choose a smaller range or a coarser step"
    )]
    ScaleTooFine {
        /// Exponent of the range.
        range_exponent: i32,
        /// Decimals of the step.
        decimals: u32,
        /// Binary digits of the step.
        binary: u32,
        /// Number of available bits.
        bits: u32,
    },
    /// A checkpoint has another version.
    #[error("a checkpoint of version {found} is not of version {expected}: start the job again")]
    CheckpointVersion {
        /// The version that this program writes.
        expected: u8,
        /// The version found.
        found: u8,
    },
    /// A checkpoint is damaged.
    #[error("the checkpoint is damaged at {field} (expected {expected}, found {found}): start the job again")]
    CheckpointDamaged {
        /// The object being read.
        field: &'static str,
        /// The expected value.
        expected: u64,
        /// The value found.
        found: u64,
    },
}
