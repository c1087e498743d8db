//! Description: the stored description of a capture's sensor and configuration. Pure.

use super::port::Latency;
use crate::observe::SensorStatus;
use std::collections::BTreeMap;
use vn100_proto::MeasurementKind;

/// Register contents by number.
pub type Registers = BTreeMap<u16, String>;

/// The description of the measurement. A register that the sensor does not have is absent.
pub(super) fn describe(
    status: &SensorStatus,
    registers: &Registers,
    previous_output: &Registers,
    latency: Latency,
    kind: MeasurementKind,
    rate_hz: f64,
) -> serde_json::Value {
    let numbered = |registers: &Registers| -> serde_json::Map<String, serde_json::Value> {
        registers.iter().map(|(number, fields)| (number.to_string(), fields.clone().into())).collect()
    };
    let windows: Vec<u32> = registers
        .get(&85)
        .map(|text| text.split(',').take(5).filter_map(|field| field.trim().parse().ok()).collect())
        .unwrap_or_default();
    let filter_window = match windows[..] {
        [mag, accel, gyro, temperature, pressure] => serde_json::json!({
            "mag": mag, "accel": accel, "gyro": gyro, "temperature": temperature, "pressure": pressure,
        }),
        _ => serde_json::Value::Null,
    };
    serde_json::json!({
        "port": status.port,
        "baud": status.baud,
        "model": status.model,
        "hardware_revision": registers.get(&2),
        "serial_number": status.serial_number,
        "firmware": status.firmware,
        "output": kind.to_string(),
        "rate_hz": rate_hz,
        "filter_window": filter_window,
        "latency_timer_ms": latency.timer_ms(),
        "registers": numbered(registers),
        "previous_output": numbered(previous_output),
    })
}
