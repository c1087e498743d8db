//! The effects of an inertial sensor, each with one law ([`effects`]), the simulator built from them ([`simulator`]),
//! and motions of the sensor ([`motion`]).
//!
//! Numbers, randomness and text are arguments: nothing here reads a file or a clock.
//!
//! # Example
//! ```
//! use imu_core::sample::Channel;
//! use imu_model::simulator::{SensorModel, Simulator};
//!
//! let model = SensorModel::from_json(
//!     r#"{"format": "vn100d-sensor-model-1", "name": "desk", "rate_hz": 40,
//!         "channels": {"gyro_x": {"N": 1e-4, "B": 3e-5, "K": 3e-6}}}"#,
//!     "desk.json",
//! )?;
//! // Seed 7, 40 Hz, an hour.
//! let mut simulator = Simulator::new(&model, 7, 40.0, 3600.0)?;
//! let first = simulator.next_sample().unwrap();
//! assert!(first.values[Channel::GyroX as usize].abs() < 0.01);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod effects;
pub mod motion;
pub mod simulator;

pub use effects::EffectKind;
