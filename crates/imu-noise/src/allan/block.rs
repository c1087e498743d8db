//! Blocks: how phases are given to the inner loop, how many at a time and with which bias.

/// Terms per call; the sums of each lane are sized for it.
pub(super) const BLOCK: usize = 8192;
/// The value added to the newest phases: the bits of 1.5·2^52. A difference plus this is, read as a double, 1.5·2^52 +
/// d.
pub(super) const BIAS: i64 = ORIGIN.to_bits() as i64;
/// The middle of the doubles that biased differences are read as, 1.5·2^52.
pub(super) const ORIGIN: f64 = 6_755_399_441_055_744.0;
