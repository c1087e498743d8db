//! Sampling: how the samples of gyroscope and accelerometer are formed, according to register 85 or to the user. No
//! document states at which rate the magnetometer samples.

use imu_core::sample::{CaptureConfiguration, StatedSampling, Triad};
use imu_core::units::IMU_RATE_HZ;
use imu_noise::whittle::Sampling;
use std::collections::BTreeMap;

/// Rates that differ by less than this share are equal.
const SAME: f64 = 1e-3;

/// Reasons why a stated sampling is impossible.
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
        "the filter window is {stated}, but {source_of_it} of the capture says {known} for the {triad}: leave the option out"
    )]
    Window {
        /// The stated value.
        stated: u32,
        /// The known value.
        known: u32,
        /// The source of the known value.
        source_of_it: String,
        /// The triad concerned.
        triad: &'static str,
    },
    /// The stated internal rate contradicts the known one.
    #[error(
        "the internal rate is {stated_hz} Hz, but {source_of_it} of the capture means {known_hz} Hz for the {triad}: leave the option out"
    )]
    InternalRate {
        /// The stated value.
        stated_hz: f64,
        /// The known value.
        known_hz: f64,
        /// The source of the known value.
        source_of_it: String,
        /// The triad concerned.
        triad: &'static str,
    },
}

/// Returns the sampling at `rate_hz`, as stated by the user, given what is `known`. A capture's register 85 stays the
/// source of its values.
///
/// # Errors
/// [`SamplingError`] with both numbers.
pub fn sampling(
    stated: StatedSampling,
    known: &BTreeMap<Triad, Sampling>,
    rate_hz: f64,
) -> Result<BTreeMap<Triad, Sampling>, SamplingError> {
    let mut all = BTreeMap::new();
    for triad in [Triad::Accel, Triad::Gyro] {
        let sampling = match known.get(&triad) {
            Some(known) => agreed(stated, known, triad)?.clone(),
            None => Sampling {
                internal_rate_hz: stated.internal_rate_hz.unwrap_or(IMU_RATE_HZ),
                window: stated.filter_window,
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

fn agreed(stated: StatedSampling, known: &Sampling, triad: Triad) -> Result<&Sampling, SamplingError> {
    let (triad, source_of_it) = (triad.name(), known.source.clone());
    if known.window.max(1) != stated.filter_window.max(1) {
        return Err(SamplingError::Window { stated: stated.filter_window, known: known.window, source_of_it, triad });
    }
    let known_hz = known.internal_rate_hz;
    match stated.internal_rate_hz.filter(|stated_hz| (stated_hz / known_hz - 1.0).abs() > SAME) {
        Some(stated_hz) => Err(SamplingError::InternalRate { stated_hz, known_hz, source_of_it, triad }),
        None => Ok(known),
    }
}

/// Returns the sampling that a capture's configuration states: register 85, or the statement at its import.
pub fn of_configuration(configuration: &CaptureConfiguration) -> BTreeMap<Triad, Sampling> {
    let Some(windows) = configuration.filter_windows() else { return BTreeMap::new() };
    let stated = configuration.stated_sampling().filter(|_| configuration.register_85().is_none());
    let internal_rate_hz = stated.and_then(|stated| stated.internal_rate_hz).unwrap_or(IMU_RATE_HZ);
    let source = if stated.is_some() { "option" } else { "register 85" };
    let of = |window| Sampling { internal_rate_hz, window, source: source.to_owned() };
    [(Triad::Accel, of(windows.accel)), (Triad::Gyro, of(windows.gyro))].into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_stated_sampling_must_fit_the_samples_and_what_is_known_or_both_numbers_are_reported() {
        let register = of_configuration(&json!({"filter_window": {"mag": 0, "accel": 4, "gyro": 4}}).into());
        let means = |filter_window, internal_rate_hz| StatedSampling { filter_window, internal_rate_hz };
        let refused =
            |stated: StatedSampling, known: &BTreeMap<_, _>| sampling(stated, known, 40.0).unwrap_err().to_string();
        for (message, parts) in [
            (refused(means(4, Some(1010.0)), &BTreeMap::new()), ["1010", "40.0000"]),
            (refused(means(8, None), &register), ["window is 8", "register 85 of the capture says 4"]),
            (refused(means(4, Some(1000.0)), &register), ["1000 Hz", "800 Hz"]),
        ] {
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
        assert_eq!(sampling(means(4, Some(800.0)), &register, 40.0).unwrap(), register);
        let found = &sampling(means(5, Some(1000.0)), &BTreeMap::new(), 40.0).unwrap()[&Triad::Gyro];
        assert_eq!((found.window, found.internal_rate_hz, found.source.as_str()), (5, 1000.0, "option"));
    }

    #[test]
    fn the_sampling_stated_at_an_import_is_read_from_its_configuration() {
        let kept = serde_json::to_value(StatedSampling { filter_window: 5, internal_rate_hz: None }.kept()).unwrap();
        let found = of_configuration(&json!({ "sampling": kept }).into());
        assert_eq!((found.len(), found[&Triad::Accel].window, found[&Triad::Accel].internal_rate_hz), (2, 5, 800.0));
        // A later import is not bound to an earlier one's default.
        assert!(sampling(StatedSampling { filter_window: 5, internal_rate_hz: None }, &found, 40.0).is_ok());
        assert!(of_configuration(&json!({ "sampling": null }).into()).is_empty());
    }
}
