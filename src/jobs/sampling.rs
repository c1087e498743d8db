//! Sampling: how the samples of gyroscope and accelerometer came about, as register 85 or a person says. Of the magnetometer no
//! document says at which rate it samples.

use crate::noise::whittle::Sampling;
use crate::sample::Triad;
use crate::units::IMU_RATE_HZ;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// Names the key of a capture's configuration that holds a stated sampling.
pub const SAMPLING_KEY: &str = "sampling";
/// Rates that differ by less are one.
const SAME: f64 = 1e-3;

/// States that the sensor sends means of its own samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(clippy::exhaustive_structs, reason = "the two options")]
pub struct StatedSampling {
    /// Samples to a mean.
    pub filter_window: u32,
    /// Rate of these samples, Hz. Without it the one that is known, else a VN-100's.
    #[serde(default)]
    pub internal_rate_hz: Option<f64>,
}

/// Reports why a stated sampling is impossible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SamplingError {
    /// The samples' rate does not divide the internal one.
    #[error(
        "the internal rate is {internal_hz} Hz and the samples have {rate_hz:.4} Hz: give an internal rate that is a whole \
         multiple of that"
    )]
    Rate {
        /// The internal rate.
        internal_hz: f64,
        /// The samples'.
        rate_hz: f64,
    },
    /// Another window is known.
    #[error(
        "the filter window is {told}, but {source_of_it} of the capture says {known} for the {triad}: leave the option out"
    )]
    Window {
        /// As it is stated.
        told: u32,
        /// As it is known.
        known: u32,
        /// Where that is known from.
        source_of_it: String,
        /// Of which triad.
        triad: &'static str,
    },
    /// Another internal rate is known.
    #[error(
        "the internal rate is {told_hz} Hz, but {source_of_it} of the capture means {known_hz} Hz for the {triad}: leave the option out"
    )]
    InternalRate {
        /// As it is stated.
        told_hz: f64,
        /// As it is known.
        known_hz: f64,
        /// Where that is known from.
        source_of_it: String,
        /// Of which triad.
        triad: &'static str,
    },
}

impl StatedSampling {
    /// What the samples at `rate_hz` are, with what is `known` of them. A capture's register 85 stays the source of what it says.
    ///
    /// # Errors
    /// [`SamplingError`] with both numbers.
    pub fn with(
        self,
        known: &BTreeMap<Triad, Sampling>,
        rate_hz: f64,
    ) -> Result<BTreeMap<Triad, Sampling>, SamplingError> {
        let mut all = BTreeMap::new();
        for triad in [Triad::Accel, Triad::Gyro] {
            let sampling = match known.get(&triad) {
                Some(known) => self.agrees(known, triad)?.clone(),
                None => Sampling {
                    internal_rate_hz: self.internal_rate_hz.unwrap_or(IMU_RATE_HZ),
                    window: self.filter_window,
                    source: "option".to_owned(),
                },
            };
            if sampling.every(rate_hz).is_none() {
                return Err(SamplingError::Rate { internal_hz: sampling.internal_rate_hz, rate_hz });
            }
            all.insert(triad, sampling);
        }
        Ok(all)
    }

    fn agrees(self, known: &Sampling, triad: Triad) -> Result<&Sampling, SamplingError> {
        let (triad, source_of_it) = (triad.name(), known.source.clone());
        if known.window.max(1) != self.filter_window.max(1) {
            return Err(SamplingError::Window { told: self.filter_window, known: known.window, source_of_it, triad });
        }
        let known_hz = known.internal_rate_hz;
        match self.internal_rate_hz.filter(|told_hz| (told_hz / known_hz - 1.0).abs() > SAME) {
            Some(told_hz) => Err(SamplingError::InternalRate { told_hz, known_hz, source_of_it, triad }),
            None => Ok(known),
        }
    }

    /// As a capture keeps it.
    #[must_use]
    pub fn kept(self) -> Self {
        Self { internal_rate_hz: Some(self.internal_rate_hz.unwrap_or(IMU_RATE_HZ)), ..self }
    }
}

/// What a capture's configuration says: register 85, or what its import stated.
pub(super) fn of_configuration(configuration: &Value) -> BTreeMap<Triad, Sampling> {
    let told =
        serde_json::from_value::<StatedSampling>(configuration[SAMPLING_KEY].clone()).ok().map(StatedSampling::kept);
    let sampling = |name: &str| {
        let register = configuration["filter_window"][name].as_u64().and_then(|window| u32::try_from(window).ok());
        let of =
            |internal_rate_hz, window, source: &str| Sampling { internal_rate_hz, window, source: source.to_owned() };
        match register {
            Some(window) => Some(of(IMU_RATE_HZ, window, "register 85")),
            None => told.and_then(|told| Some(of(told.internal_rate_hz?, told.filter_window, "option"))),
        }
    };
    let triads = [(Triad::Accel, "accel"), (Triad::Gyro, "gyro")];
    triads.into_iter().filter_map(|(triad, name)| Some((triad, sampling(name)?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn what_is_said_has_to_fit_the_samples_and_what_is_known_with_both_numbers() {
        let register = of_configuration(&json!({"filter_window": {"mag": 0, "accel": 4, "gyro": 4}}));
        let told = |filter_window, internal_rate_hz| StatedSampling { filter_window, internal_rate_hz };
        let refused = |told: StatedSampling, known: &BTreeMap<_, _>| told.with(known, 40.0).unwrap_err().to_string();
        for (message, parts) in [
            (refused(told(4, Some(1010.0)), &BTreeMap::new()), ["1010", "40.0000"]),
            (refused(told(8, None), &register), ["window is 8", "register 85 of the capture says 4"]),
            (refused(told(4, Some(1000.0)), &register), ["1000 Hz", "800 Hz"]),
        ] {
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
        assert_eq!(told(4, Some(800.0)).with(&register, 40.0).unwrap(), register);
        let found = &told(5, Some(1000.0)).with(&BTreeMap::new(), 40.0).unwrap()[&Triad::Gyro];
        assert_eq!((found.window, found.internal_rate_hz, found.source.as_str()), (5, 1000.0, "option"));
    }

    #[test]
    fn what_an_import_was_said_to_be_is_read_from_its_configuration() {
        let kept = serde_json::to_value(StatedSampling { filter_window: 5, internal_rate_hz: None }.kept()).unwrap();
        let found = of_configuration(&json!({ SAMPLING_KEY: kept }));
        assert_eq!((found.len(), found[&Triad::Accel].window, found[&Triad::Accel].internal_rate_hz), (2, 5, 800.0));
        // A later import is not held to what an earlier one's default was.
        assert!(StatedSampling { filter_window: 5, internal_rate_hz: None }.with(&found, 40.0).is_ok());
        assert!(of_configuration(&json!({ SAMPLING_KEY: null })).is_empty());
    }
}
