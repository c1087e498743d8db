//! A place of a gap and a cause for tests, which need not spell out what they do not examine.

use super::report::{Cause, Of, Place, Sense};
use imu_model::effects::EffectKind;
use std::collections::BTreeMap;

impl Place {
    /// Creates a place on gyro_x over all times and frequencies of 1000 s at 40 Hz, with 1000 nats in all places.
    pub(crate) fn in_tests(of: Of, share: f64) -> Self {
        Self {
            of,
            channel: "gyro_x".to_owned(),
            band_hz: [0.0, 20.0],
            tau_s: [0.025, 1000.0],
            from_s: 0.0,
            to_s: 1000.0,
            temperature_c: None,
            at: None,
            share,
            nats: 1000.0 * share,
            p_value: 1e-9,
            sign: "real noisier".into(),
        }
    }
}

impl Cause {
    /// Returns a sure cause on the gyroscope's x axis that the model lacks.
    pub(crate) fn in_tests(effect: EffectKind) -> Self {
        Self {
            effect,
            sense: Sense::Missing,
            triad: None,
            channels: vec!["gyro_x".to_owned()],
            confidence: 1.0,
            closes: None,
            parameters: BTreeMap::new(),
            model: BTreeMap::new(),
            uncertainty: serde_json::Map::new(),
            evidence: Vec::new(),
            cost: BTreeMap::new(),
        }
    }
}
