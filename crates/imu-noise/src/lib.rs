//! Noise: Allan deviations, their confidence, and the noise parameters N, B, K, Q, R fitted to them.
//!
//! Samples of one channel enter as `f64` in the channel's unit, segment by segment. The outputs are exact sums that can be
//! checkpointed and merged ([`allan::Overlapping`]), curves with confidence intervals ([`allan::AllanCurve`]), parameters with
//! units and intervals ([`fit::NoiseParameters`]), and moments and histograms ([`statistics::Statistics`]). This crate does not
//! read a clock or a file, and no output number is NaN or infinite. If the data does not determine a value, the value is absent
//! and a flag states this.
//!
//! # Examples
//! The overlapping Allan deviation of a channel:
//! ```
//! use imu_core::sample::Channel;
//! use imu_noise::allan::{AllanCurve, FixedPoint, Overlapping, TauGrid};
//!
//! let samples = [0.1, 0.3, 0.2, 0.4, 0.2, 0.1, 0.3, 0.2];
//! let mut sums = Overlapping::new(FixedPoint::for_channel(Channel::GyroX), TauGrid::octave(samples.len() as u64)?);
//! sums.push(&samples);
//! let curve = AllanCurve::from_sums(&sums.into_sums(), 40.0, "rad/s");
//! assert_eq!(curve.tau_s[0], 0.025);
//! assert!((curve.deviation[0] - 0.11).abs() < 0.01);
//! # Ok::<(), imu_noise::allan::AllanError>(())
//! ```
//! The noise density N of five minutes of white noise, with its 95 % interval:
//! ```
//! use imu_core::sample::Channel;
//! use imu_noise::allan::FixedPoint;
//! use imu_noise::whittle::{DstEstimator, Transform, fit_as_sampled};
//! use rand::SeedableRng as _;
//! use rand_distr::{Distribution as _, Normal};
//!
//! let (rate_hz, density) = (40.0_f64, 1e-4);
//! let noise = Normal::new(0.0, density * rate_hz.sqrt()).unwrap();
//! let samples: Vec<f64> = noise.sample_iter(rand_chacha::ChaCha8Rng::seed_from_u64(1)).take(12_000).collect();
//! let mut transform = Transform::new();
//! let mut estimator = DstEstimator::new(FixedPoint::for_channel(Channel::GyroX));
//! estimator.push(&mut transform, &samples);
//! let n = fit_as_sampled(&estimator.into_sums(&mut transform), rate_hz, Channel::GyroX, None).n;
//! let [from, to] = n.ci95.unwrap();
//! assert!(from < density && density < to);
//! ```

pub mod allan;
mod contradiction;
mod contribution;
pub mod datasheet;
pub mod fit;
mod needed;
pub mod ratio;
pub mod robust;
pub mod statistics;
pub mod stillness;
pub mod welch;
pub mod whittle;
pub mod words;

pub use contradiction::hold_against;
pub use contribution::Contribution;
pub use fit::{NoiseParameters, NoiseReport, RecordNeeded};
pub use needed::walk_shows_beyond_s;
pub use statistics::{Moments, Statistics};
