//! Description: assembles the stored description of the sensor that a capture records. Pure.

use super::port::Latency;
use crate::observe::SensorStatus;
use imu_core::sample::{ConnectedSensor, Register85, Registers};
use vn100_proto::MeasurementKind;

/// Returns the description of the measurement. A register that the sensor does not have is absent.
pub(super) fn describe(
    status: &SensorStatus,
    registers: &Registers,
    previous_output: &Registers,
    latency: Latency,
    kind: MeasurementKind,
    rate_hz: f64,
) -> Box<ConnectedSensor> {
    Box::new(ConnectedSensor {
        port: status.port.clone(),
        baud: status.baud,
        model: status.model.clone(),
        hardware_revision: registers.get(&2).cloned(),
        serial_number: status.serial_number.clone(),
        firmware: status.firmware.clone(),
        output: kind.to_string(),
        rate_hz,
        filter_window: registers.get(&85).and_then(|text| Register85::parse(text)),
        latency_timer_ms: latency.timer_ms(),
        registers: registers.clone(),
        previous_output: previous_output.clone(),
    })
}
