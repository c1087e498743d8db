//! The VN-100's datasheet.
//!
//! # Source
//! VN-100 Rugged IMU/AHRS datasheet, hardware v7.0 (2023, DS100-CR-70-R1), as quoted publicly: gyroscope 0.0035 °/s/√Hz
//! and < 10 °/h in run, accelerometer 0.14 mg/√Hz and < 0.04 mg; the same figures in ethz-asl/kalibr issue 111 (2017).
//! The magnetometer's 140 µgauss/√Hz comes from the product page; no bias stability is given.

use super::{Datasheet, Figures, Sampled};
use imu_core::units::Quantity;

/// Returns the figures of hardware v7.0.
pub fn vn_100() -> Datasheet {
    Datasheet {
        name: "vn-100".to_owned(),
        source:
            "VN-100 datasheet, hardware v7.0 (2023), DS100-CR-70-R1, as quoted publicly; magnetometer: product page"
                .to_owned(),
        sampled: Sampled::Register85,
        gyro: Some(Figures {
            density: Some(Quantity::deg_per_s(0.0035).per_root_hertz()),
            density_limit: Some(Quantity::deg_per_s(0.003_55).per_root_hertz()),
            bias_stability: Some(Quantity::deg_per_h(10.0)),
            printed: ("0.0035 deg/s/√Hz".to_owned(), "< 10 deg/h".to_owned()),
        }),
        accel: Some(Figures {
            density: Some(Quantity::mg(0.14).per_root_hertz()),
            density_limit: Some(Quantity::mg(0.145).per_root_hertz()),
            bias_stability: Some(Quantity::mg(0.04)),
            printed: ("0.14 mg/√Hz".to_owned(), "< 0.04 mg".to_owned()),
        }),
        mag: Some(Figures {
            density: Some(Quantity::microgauss(140.0).per_root_hertz()),
            density_limit: Some(Quantity::microgauss(145.0).per_root_hertz()),
            bias_stability: None,
            printed: ("140 µgauss/√Hz".to_owned(), "none given".to_owned()),
        }),
    }
}
