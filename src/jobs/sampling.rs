//! Sampling: how the samples of gyroscope and accelerometer are formed, according to register 85 or to the user. No
//! document states at which rate the magnetometer samples.

use imu_core::sample::Triad;
use imu_core::units::IMU_RATE_HZ;
use imu_noise::whittle::Sampling;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// The key of a capture's configuration that holds a stated sampling.
pub const SAMPLING_KEY: &str = "sampling";
/// Rates that differ by less than this share are equal.
const SAME: f64 = 1e-3;

/// States that the sensor sends means of its own samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatedSampling {
    /// Samples per mean.
    pub filter_window: u32,
    /// Rate of these samples, Hz. Without it the known one is used, else a VN-100's.
    #[serde(default)]
    pub internal_rate_hz: Option<f64>,
}

/// Reports why a stated sampling is impossible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SamplingError {
    /// The samples' rate does not divide the internal one.
    #[error(
        "the internal rate is {internal_hz} Hz and the samples have {rate_hz:.4} Hz: give an internal rate that is a whole \
         multiple of that"
    )]
    Rate {
        /// The internal rate.
        internal_hz: f64,
        /// The rate of the samples.
        rate_hz: f64,
    },
    /// The stated filter window contradicts the known one.
    #[error(
        "the filter window is {told}, but {source_of_it} of the capture says {known} for the {triad}: leave the option out"
    )]
    Window {
        /// The stated value.
        told: u32,
        /// The known value.
        known: u32,
        /// The source of the known value.
        source_of_it: String,
        /// The triad concerned.
        triad: &'static str,
    },
    /// The stated internal rate contradicts the known one.
    #[error(
        "the internal rate is {told_hz} Hz, but {source_of_it} of the capture means {known_hz} Hz for the {triad}: leave the option out"
    )]
    InternalRate {
        /// The stated value.
        told_hz: f64,
        /// The known value.
        known_hz: f64,
        /// The source of the known value.
        source_of_it: String,
        /// The triad concerned.
        triad: &'static str,
    },
}

impl StatedSampling {
    /// The sampling at `rate_hz`, given what is `known`. A capture's register 85 stays the source of its values.
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

    /// The statement in the form that a capture stores.
    pub fn kept(self) -> Self {
        Self { internal_rate_hz: Some(self.internal_rate_hz.unwrap_or(IMU_RATE_HZ)), ..self }
    }
}

/// The sampling that a capture's configuration states: register 85, or the statement at its import.
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
        // A later import is not bound to an earlier one's default.
        assert!(StatedSampling { filter_window: 5, internal_rate_hz: None }.with(&found, 40.0).is_ok());
        assert!(of_configuration(&json!({ SAMPLING_KEY: null })).is_empty());
    }
}
