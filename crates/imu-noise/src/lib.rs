//! Noise: Allan deviations, their confidence, and the noise parameters N, B, K, Q, R fitted to them.
//!
//! Samples of one channel enter as `f64` in the channel's unit, segment by segment. The outputs are exact sums that can be
//! checkpointed and merged ([`allan::Overlapping`]), curves with confidence intervals ([`allan::AllanCurve`]), parameters with
//! units and intervals ([`fit::NoiseParameters`]), and moments and histograms ([`statistics::Statistics`]). This crate does not
//! read a clock or a file, and no output number is NaN or infinite. If the data does not determine a value, the value is absent
//! and a flag states this.

pub mod allan;
mod contradiction;
mod contribution;
pub mod datasheet;
pub mod fit;
mod needed;
pub mod robust;
pub mod statistics;
pub mod stillness;
pub mod welch;
pub mod whittle;
mod words;

pub use contradiction::hold_against;
pub use contribution::Contribution;
pub use fit::{NoiseParameters, NoiseReport};
pub use needed::{RecordNeeded, walk_shows_beyond_s};
pub use statistics::{Moments, Statistics};
