//! Parcels: a case's recording and model as bytes, which the process that makes cases passes to the one that diagnoses
//! them.
//!
//! One line of JSON (rate, channels, samples, the other columns, the model), then the columns as 64-bit floating-point
//! numbers, little endian: the channels in order, the temperature, the stamps. A parcel carries no information about
//! the key. A parcel that is a table is written as the CSV of docs/formats.md and read again before it is diagnosed.

use imu_core::sample::Channel;
use imu_diagnosis::Recording;
use imu_model::simulator::{ModelError, SensorModel};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Bytes of a number.
const NUMBER: usize = 8;

/// The reasons why bytes are not a parcel.
#[derive(Debug, thiserror::Error)]
pub enum ParcelError {
    /// The first line is not valid.
    #[error("the parcel's first line cannot be read: {0}")]
    Head(#[from] serde_json::Error),
    /// The parcel names an unknown channel.
    #[error("the parcel names a channel `{0}`")]
    Channel(String),
    /// The model cannot be read.
    #[error("the parcel's model cannot be read: {0}")]
    Model(#[from] ModelError),
    /// The parcel is too short or too long.
    #[error("the parcel has {found} bytes of samples; {expected} were announced")]
    Length {
        /// The number of bytes according to the first line.
        expected: usize,
        /// The number of bytes.
        found: usize,
    },
}

#[derive(Debug, Serialize, Deserialize)]
struct Head {
    rate_hz: f64,
    samples: usize,
    channels: Vec<String>,
    temperature: bool,
    stamps: usize,
    missing: Vec<usize>,
    table: bool,
    model: Value,
}

/// The contents of a parcel.
#[derive(Debug, Clone, PartialEq)]
pub struct Parcel {
    /// The recording.
    pub recording: Recording,
    /// The model.
    pub model: SensorModel,
    /// Whether the recording is read like a table, with the rate of its stamps.
    pub table: bool,
}

/// Packs a recording and a model. With `table`, the recording is read like a table.
///
/// # Errors
/// [`ParcelError::Head`] if the model cannot be written as JSON.
pub fn pack(recording: &Recording, model: &SensorModel, table: bool) -> Result<Vec<u8>, ParcelError> {
    let missing = recording.missing.iter().enumerate().filter(|(_, missing)| **missing).map(|(place, _)| place);
    let head = Head {
        rate_hz: recording.rate_hz,
        samples: recording.len(),
        channels: recording.channels.iter().map(|(channel, _)| channel.name().to_owned()).collect(),
        temperature: recording.temperature_c.is_some(),
        stamps: recording.time_s.len(),
        missing: missing.collect(),
        table,
        model: serde_json::to_value(model)?,
    };
    let mut bytes = serde_json::to_vec(&head)?;
    bytes.push(b'\n');
    let columns = recording.channels.iter().map(|(_, values)| values);
    for value in columns.chain(&recording.temperature_c).chain([&recording.time_s]).flatten() {
        bytes.extend(value.to_le_bytes());
    }
    Ok(bytes)
}

/// Unpacks a recording and a model.
///
/// # Errors
/// [`ParcelError`] with the expected and the found value.
pub fn unpack(bytes: &[u8]) -> Result<Parcel, ParcelError> {
    let end = bytes.iter().position(|byte| *byte == b'\n').unwrap_or(bytes.len());
    let (head, body) = bytes.split_at(end);
    let head: Head = serde_json::from_slice(head)?;
    let body = body.get(1..).unwrap_or_default();
    let columns = head.channels.len() + usize::from(head.temperature);
    let expected = columns.saturating_mul(head.samples).saturating_add(head.stamps).saturating_mul(NUMBER);
    if body.len() != expected {
        return Err(ParcelError::Length { expected, found: body.len() });
    }
    let mut numbers = body.as_chunks::<NUMBER>().0.iter().map(|bytes| f64::from_le_bytes(*bytes));
    let mut column = |length: usize| numbers.by_ref().take(length).collect::<Vec<f64>>();
    let mut channels = Vec::new();
    for name in head.channels {
        let channel = Channel::from_name(&name).ok_or(ParcelError::Channel(name))?;
        channels.push((channel, column(head.samples)));
    }
    let temperature_c = head.temperature.then(|| column(head.samples));
    let time_s = column(head.stamps);
    let mut missing = if head.missing.is_empty() { Vec::new() } else { vec![false; head.samples] };
    for place in head.missing {
        if let Some(one) = missing.get_mut(place) {
            *one = true;
        }
    }
    let model = SensorModel::from_value(&head.model, "the case's model")?;
    let recording =
        Recording { rate_hz: head.rate_hz, channels, missing, temperature_c, time_s, ..Recording::default() };
    Ok(Parcel { recording, model, table: head.table })
}

/// Returns a recording as the documented CSV: rows of the present samples, every number with all its digits.
pub fn table(recording: &Recording) -> String {
    let mut text = String::from("time_s");
    for (channel, _) in &recording.channels {
        text.push(',');
        text += &channel.column_name();
    }
    if recording.temperature_c.is_some() {
        text.push(',');
        text += &Channel::Temperature.column_name();
    }
    text.push('\n');
    for place in 0..recording.len() {
        if recording.missing.get(place).copied().unwrap_or(false) {
            continue;
        }
        let stamp = recording.time_s.get(place).copied().unwrap_or(place as f64 / recording.rate_hz);
        text += &stamp.to_string();
        for values in recording.channels.iter().map(|(_, values)| values).chain(&recording.temperature_c) {
            text.push(',');
            if let Some(value) = values.get(place).filter(|value| value.is_finite()) {
                text += &value.to_string();
            }
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Case;
    use crate::kind::Kind;

    #[test]
    fn what_is_packed_is_unpacked_bit_by_bit() {
        for kinds in [&[][..], &[Kind::Timing], &[Kind::TemperatureBias]] {
            let case = Case::draw(3, 2, kinds).unwrap();
            let recording = case.record();
            let again = unpack(&pack(&recording, &case.model(), case.is_table()).unwrap()).unwrap();
            assert_eq!(again, Parcel { recording, model: case.model(), table: case.is_table() });
        }
    }

    #[test]
    fn a_parcel_that_is_cut_is_refused() {
        let case = Case::draw(3, 2, &[]).unwrap();
        let bytes = pack(&case.record(), &case.model(), false).unwrap();
        assert!(matches!(unpack(&bytes[..bytes.len() - 8]), Err(ParcelError::Length { .. })));
        assert!(matches!(unpack(b"{}"), Err(ParcelError::Head(_))));
        let text = String::from_utf8_lossy(&bytes[..60]).into_owned();
        assert!(!text.contains("effect"), "{text}");
    }
}
