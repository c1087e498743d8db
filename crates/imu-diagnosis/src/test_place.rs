//! A place of a gap for tests, which need not spell out what they do not examine.

use super::report::{Of, Place};

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
