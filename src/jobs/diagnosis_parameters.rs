//! Parameters of a diagnosis: the simulator that a capture is compared with, and the motion of the sensor.

use super::JobError;
use crate::store::{JobKind, Reader};
use imu_diagnosis::{Known, Reference};
use imu_model::motion::file::Rows;
use imu_model::simulator::SensorModel;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The prefix of a model's number in its id: a number alone is a capture.
const MODEL: &str = "model-";

/// The simulator that a capture is compared with.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Simulator {
    /// The id of a capture that a simulator made.
    Capture(i64),
    /// A sensor model.
    Model(Box<SensorModel>),
}

/// Parameters of a diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DiagnosisParameters {
    /// The simulator that the capture is compared with. A model is included as a whole, so that the job outlives it.
    pub sim: Simulator,
    /// The motion that the sensor underwent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference: Option<ReferenceMotion>,
}

/// The sensor's axis about which an encoder turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
#[expect(missing_docs, reason = "the names say it")]
pub enum ReferenceAxis {
    X,
    Y,
    Z,
}

impl ReferenceAxis {
    /// Lists all axes with their names.
    pub const NAMED: [(&'static str, Self); 3] = [("x", Self::X), ("y", Self::Y), ("z", Self::Z)];

    /// Returns the axis with that name.
    pub(super) fn from_name(name: &str) -> Option<Self> {
        Self::NAMED.into_iter().find_map(|(own, axis)| (own == name).then_some(axis))
    }
}

/// The motion of the sensor, as a job's parameters contain it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ReferenceMotion {
    /// A motion's CSV, which the database stores.
    Stored {
        /// SHA-256 of its text.
        sha256: String,
        /// Bytes of its text.
        bytes: u64,
        /// The axis of an encoder, which its file does not name.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        axis: Option<ReferenceAxis>,
    },
    /// A motion that needs no file: `still`, `tumble`, `poses`, `rate-table`.
    Named(String),
}

impl Simulator {
    /// Looks up the requested simulator: a model by its id, a model, or a capture by its id or name.
    ///
    /// # Errors
    /// [`JobError::Parameters`] if the value is not a simulator, [`JobError::Model`] if the model is invalid,
    /// [`JobError::Store`] if there is no such model or capture.
    pub(super) fn of(reader: &Reader, sim: Value) -> Result<Self, JobError> {
        let refuse = |reason: &str| JobError::Parameters { kind: JobKind::Diagnosis.name(), reason: reason.to_owned() };
        let capture = |id: i64| {
            if reader.capture(id)?.state.is_open() {
                return Err(refuse(&format!("capture {id} still runs: `sim` is one that has ended")));
            }
            Ok(Self::Capture(id))
        };
        match sim {
            model @ Value::Object(_) => Self::of_model(&model, "sim"),
            Value::String(text) => match text.strip_prefix(MODEL).and_then(|number| number.parse().ok()) {
                Some(number) => Self::of_model(&serde_json::from_str(&reader.model(number)?.body)?, &text),
                None => capture(reader.resolve(&text)?),
            },
            Value::Number(number) => {
                let id = number.as_i64().ok_or_else(|| refuse("`sim` is a number and no capture's id"))?;
                capture(id)
            }
            _ => Err(refuse("`sim` is a model's id (\"model-1\"), a sensor model, or a capture's id or name")),
        }
    }

    fn of_model(value: &Value, called: &str) -> Result<Self, JobError> {
        Ok(Self::Model(Box::new(SensorModel::from_value(value, called)?)))
    }
}

impl DiagnosisParameters {
    /// Reads the parameters that a row of the database holds.
    pub(super) fn of_text(text: &str) -> Result<Self, JobError> {
        #[derive(Deserialize)]
        struct Stored {
            sim: Value,
            #[serde(default)]
            reference: Option<ReferenceMotion>,
        }
        let refuse = |error: serde_json::Error| JobError::Parameters {
            kind: JobKind::Diagnosis.name(),
            reason: error.to_string(),
        };
        let Stored { sim, reference } = serde_json::from_str(text).map_err(refuse)?;
        let sim = match sim.as_i64() {
            Some(id) => Simulator::Capture(id),
            None => Simulator::of_model(&sim, "sim")?,
        };
        Ok(Self { sim, reference })
    }

    /// Returns the SHA-256 of the reference that the database stores for this job.
    pub(super) fn stored_reference(&self) -> Option<&str> {
        match &self.reference {
            Some(ReferenceMotion::Stored { sha256, .. }) => Some(sha256),
            Some(ReferenceMotion::Named(_)) | None => None,
        }
    }
}

/// Reads a reference, `name`: a motion's CSV, poses, or rates about one axis. `axis` is that of an encoder.
///
/// # Errors
/// A sentence for the user.
pub fn read_reference(text: &str, name: &str, axis: Option<ReferenceAxis>) -> Result<Known, String> {
    if !text.contains('\n') {
        return Err(
            "expected a motion's CSV with a header line, poses or rates likewise, or one of still, tumble, poses, rate-table"
                .to_owned(),
        );
    }
    if let Some(external) = imu_pose::read(text, axis.map(|axis| axis as usize)).map_err(|error| error.to_string())? {
        return Ok(Known::External(external));
    }
    let rows = Rows::new(text.as_bytes(), name, None).map_err(|error| error.to_string())?;
    let mut refused = None;
    // There are many rows: they are stored once.
    let reference = Reference::new(rows.map_while(|row| row.map_err(|error| refused = Some(error)).ok()));
    match refused {
        Some(error) => Err(error.to_string()),
        None => reference.map(Known::Motion).map_err(|error| error.to_string()),
    }
}
