//! Reports: the parts of a diagnosis that a trial reads, in the form of docs/formats.md, from any program.

use super::class::Sense;
use imu_model::EffectKind;
use serde_json::Value;

/// The reasons why a value is not a diagnosis.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReportError {
    /// A key is missing or not valid.
    #[error("the diagnosis has no {key} that can be read")]
    Missing {
        /// The path of the key.
        key: &'static str,
    },
}

/// A named cause.
#[derive(Debug, Clone, PartialEq)]
pub struct Cause {
    /// The documented name of the effect.
    pub effect: String,
    /// The channels.
    pub channels: Vec<String>,
    /// Stated chance that this is the cause.
    pub confidence: Option<f64>,
    /// The parameters by channel, an object or a list of objects.
    pub parameters: Value,
    /// How sensor and model differ in the effect; `missing` if the report does not state it.
    pub sense: Sense,
    /// 95 % intervals of the parameters, in the same form.
    pub uncertainty: Value,
    /// The place among the report's causes.
    pub index: usize,
}

/// The owner of a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Of {
    /// The cause of this index.
    Cause(usize),
    /// Parameters that are off.
    Parameters,
    /// The remainder without a name.
    Remainder,
    /// The report does not state the owner.
    Unstated,
}

/// A place where sensor and model differ.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    /// The channel.
    pub channel: String,
    /// The owner of the place.
    pub of: Of,
    /// The band, Hz; none is any band.
    pub band_hz: Option<[f64; 2]>,
    /// The time, s after the record's start; none is any time.
    pub time_s: Option<[f64; 2]>,
}

/// The result of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// The verdict: `no_gap`, `parameters`, `effects` or `unknown_effect`.
    pub verdict: String,
    /// The causes, strongest first.
    pub causes: Vec<Cause>,
    /// The part of the gap that the causes close.
    pub closed: Option<f64>,
    /// The 95 % interval of that part.
    pub closed_ci95: Option<[f64; 2]>,
    /// The places, if the report states any.
    pub places: Vec<Place>,
    /// The part of the gap that is reproduced without a name, if the report states it.
    pub remainder: Option<f64>,
}

impl Report {
    /// Reads the JSON of a diagnosis.
    ///
    /// # Errors
    /// [`ReportError`] if it is not one.
    pub fn of(value: &Value) -> Result<Self, ReportError> {
        let missing = |key| ReportError::Missing { key };
        let verdict = value["verdict"].as_str().ok_or_else(|| missing("verdict"))?.to_owned();
        let causes = value["causes"].as_array().ok_or_else(|| missing("causes"))?;
        let cause = |(index, value): (usize, &Value)| {
            let names = value["channels"].as_array().ok_or_else(|| missing("causes.channels"))?;
            let sense = value["sense"].as_str().and_then(Sense::from_name).unwrap_or_default();
            // An effect that the sensor lacks only has the model's numbers.
            let is_of_model = sense == Sense::Superfluous && value["model"].is_object();
            let parameters = if is_of_model { "model" } else { "parameters" };
            Ok(Cause {
                effect: value["effect"].as_str().ok_or_else(|| missing("causes.effect"))?.to_owned(),
                channels: names.iter().filter_map(|name| name.as_str().map(str::to_owned)).collect(),
                confidence: value["confidence"].as_f64(),
                parameters: value[parameters].clone(),
                sense,
                uncertainty: value["uncertainty"].clone(),
                index,
            })
        };
        let discrepancy = &value["discrepancy"];
        let interval = &discrepancy["closed_ci95"];
        Ok(Self {
            verdict,
            causes: causes.iter().enumerate().map(cause).collect::<Result<_, _>>()?,
            closed: discrepancy["closed"].as_f64(),
            closed_ci95: pair(interval),
            places: value["where"].as_array().into_iter().flatten().filter_map(place).collect(),
            remainder: value["remainder"]["share"].as_f64(),
        })
    }
}

impl Cause {
    /// Returns the effect's kind; `None` for an unknown name.
    pub fn kind(&self) -> Option<EffectKind> {
        EffectKind::from_name(&self.effect)
    }

    /// Returns the entries of a channel: one, or several from a list.
    pub fn entries(&self, channel: &str) -> &[Value] {
        entries(&self.parameters[channel])
    }

    /// Returns the entries of all channels.
    pub fn all_entries(&self) -> impl Iterator<Item = &Value> {
        self.channels.iter().flat_map(|channel| self.entries(channel))
    }
}

/// Reads two numbers.
fn pair(value: &Value) -> Option<[f64; 2]> {
    value[0].as_f64().zip(value[1].as_f64()).map(|(low, high)| [low, high])
}

/// Returns a place; `None` if it names no channel.
fn place(value: &Value) -> Option<Place> {
    let of = match value["of"].as_str() {
        Some("parameters") => Of::Parameters,
        Some("remainder") => Of::Remainder,
        Some(other) => {
            other.strip_prefix("cause:").and_then(|index| index.parse().ok()).map_or(Of::Unstated, Of::Cause)
        }
        None => Of::Unstated,
    };
    let time_s = value["from_s"].as_f64().zip(value["to_s"].as_f64()).map(|(from, to)| [from, to]);
    Some(Place { channel: value["channel"].as_str()?.to_owned(), of, band_hz: pair(&value["band_hz"]), time_s })
}

/// Returns one entry, or several from a list.
pub(super) fn entries(value: &Value) -> &[Value] {
    match value {
        Value::Null => &[],
        Value::Array(list) => list,
        one => std::slice::from_ref(one),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn what_a_report_may_add_is_read_if_it_is_there() {
        let place = |of: Value| json!({"channel": "gyro_x", "of": of, "band_hz": [1.0, 2.0], "from_s": 0, "to_s": 9.5});
        let cause = json!({"effect": "tone", "channels": ["gyro_x"], "sense": "size", "parameters": {},
            "uncertainty": {"gyro_x": [{"amplitude": [1.0, 2.0]}]}});
        let report = Report::of(&json!({"verdict": "effects", "causes": [cause], "discrepancy": {},
            "where": [place(json!("cause:0")), place(json!("parameters")), place(json!("remainder")), place(Value::Null)],
            "remainder": {"share": 0.021, "channels": ["gyro_x"]}}))
        .unwrap();
        assert_eq!((report.causes[0].sense, report.causes[0].index), (Sense::Size, 0));
        let of: Vec<Of> = report.places.iter().map(|place| place.of).collect();
        assert_eq!(of, [Of::Cause(0), Of::Parameters, Of::Remainder, Of::Unstated]);
        assert_eq!(report.places[0].time_s, Some([0.0, 9.5]));
        assert_eq!(report.remainder, Some(0.021));
    }

    #[test]
    fn a_report_without_it_is_a_report() {
        let report =
            Report::of(&json!({"verdict": "effects", "causes": [{"effect": "tone", "channels": ["gyro_x"]}]})).unwrap();
        assert_eq!(report.causes[0].sense, Sense::Missing);
        assert!(report.places.is_empty() && report.remainder.is_none());
        assert!(Report::of(&json!({"causes": []})).is_err());
    }
}
