//! Diagnosis: where a record and a simulator's law differ, and which effect the simulator lacks. Pure.
//!
//! In: samples of one rate ([`Recording`]), a sensor model. Out: a [`Diagnosis`] in the form of docs/formats.md, and
//! the model with corrected parameters and the found effects.
//!
//! All evidence is in one unit: nats of log density of the real samples per sample. A channel's samples are transformed
//! ([`transform`]), binned ([`grid`]) and compared with a spectrum ([`law`]). Their deterministic part follows
//! [`course`]s and sines ([`series`]). [`evidence`] computes the gain of each effect. [`search`] adds one effect after
//! the other as long as each is worth its price. The price is the gain that chance gives in simulated records of the
//! same length.
//!
//! # Example
//! A sensor has a tone that its model lacks:
//! ```
//! use imu_core::sample::Channel;
//! use imu_diagnosis::{Options, Recording, diagnose};
//! use imu_model::simulator::{SensorModel, Simulator};
//!
//! let model = |effects: &str| {
//!     let text = format!(
//!         r#"{{"format": "vn100d-sensor-model-1", "name": "desk", "rate_hz": 40,
//!             "channels": {{"gyro_x": {{"N": 1e-4, "B": 3e-5, "K": 3e-6, "effects": [{effects}]}}}}}}"#
//!     );
//!     SensorModel::from_json(&text, "desk.json")
//! };
//! let sensor = model(r#"{"effect": "tone", "frequency_hz": 3.2, "amplitude": 1e-4}"#)?;
//! let (rate_hz, samples) = (40.0, 16_384);
//! let mut simulator = Simulator::new(&sensor, 7, rate_hz, samples as f64 / rate_hz)?;
//! let gyro_x = (0..samples).map(|_| simulator.next_values()[Channel::GyroX as usize]).collect();
//! let recording = Recording { rate_hz, channels: vec![(Channel::GyroX, gyro_x)], ..Recording::default() };
//!
//! let found = diagnose(&recording, &model("")?, &Options::default())?;
//! assert_eq!(found.diagnosis.causes[0].effect.name(), "tone");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod attribution;
mod augmented;
mod averages;
mod bands;
#[cfg(test)]
mod both_ways;
pub mod calibration;
mod censored;
#[cfg(test)]
mod cliffs;
mod compose;
mod confidence;
mod course;
mod declared;
mod diagnose;
mod discrepancy;
mod dither;
mod dot;
mod drawings;
mod ends;
mod equalised;
mod equaliser;
mod error;
mod evidence;
mod explained;
mod explanation;
mod facts;
mod field;
mod filling;
mod found;
mod further;
mod gated;
mod grid;
mod hidden;
mod hints;
mod holdout;
#[cfg(test)]
mod in_tests;
#[cfg(test)]
mod intervals;
mod law;
#[cfg(test)]
mod located;
#[cfg(test)]
mod missing_samples;
pub mod model_fit;
mod modulated;
mod motion;
mod nameless;
mod oddities;
mod omnibus;
mod options;
mod outcome;
mod owned;
mod pairs;
mod phase;
mod places;
mod plans;
mod polish;
mod preconditioner;
pub mod prepare;
mod prepared;
pub mod prices;
mod recording;
mod refinement;
mod remainder;
mod reordered;
pub mod report;
mod response;
#[cfg(test)]
mod round_trip;
mod rounded;
mod search;
mod searched_again;
mod sentence;
mod series;
mod shared;
mod spread;
mod steps;
#[cfg(test)]
mod strong_effects;
mod tail;
mod taken_back;
mod tiles;
pub mod transform;
mod translate;
#[cfg(test)]
mod two_effects;
mod variances;
mod wandering;
mod work;
mod written;
mod zero_rows;

use imu_model::effects::{CHANNEL, EffectKind};

pub use diagnose::diagnose;
pub use drawings::{ChannelSpectra, ChannelTimeline, Drawings, Stretches};
pub use error::DiagnosisError;
pub use motion::{
    CERTAIN, Known, Reference, ReferenceError, Residuals, Rows, beside, diagnose_any, diagnose_moved, diagnose_posed,
    rows, rows_in_range,
};
pub use options::Options;
pub use outcome::Outcome;
pub use prepare::{is_same_rate, same_rate};
pub use recording::Recording;
pub use remainder::MATERIAL;
pub use report::{Diagnosis, FORMAT, Verdict};
pub use work::{Alone, Workers};

/// Returns the effects that can be found in a record at rest: those of docs/effects.md that act on channels.
pub fn effects() -> Vec<EffectKind> {
    CHANNEL.iter().map(|of| of.spec.kind).collect()
}
