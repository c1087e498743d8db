//! Reports: the parts of a diagnosis that a trial reads, in the form of docs/formats.md, from any program.

use super::class::Sense;
use imu_model::EffectKind;
use serde_json::Value;

/// The reason why a value is not a diagnosis.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReportError {
    /// A key is missing, or is not what it should be.
    #[error("the diagnosis has no {key} that can be read")]
    Missing {
        /// Its path.
        key: &'static str,
    },
}

/// A cause that was named.
#[derive(Debug, Clone, PartialEq)]
pub struct Cause {
    /// The documented name of it.
    pub effect: String,
    /// Its channels.
    pub channels: Vec<String>,
    /// Stated chance that it is this one.
    pub confidence: Option<f64>,
    /// By channel: its parameters, an object or a list of them.
    pub parameters: Value,
    /// How sensor and model differ in it; `missing` if the report does not state it.
    pub sense: Sense,
    /// 95 % intervals of the parameters, in the same form.
    pub uncertainty: Value,
    /// Its place among the report's causes.
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
    /// The report does not state it.
    Untold,
}

/// A place where sensor and model differ.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    /// The channel.
    pub channel: String,
    /// Of what.
    pub of: Of,
    /// Its band, Hz; none is any.
    pub band_hz: Option<[f64; 2]>,
    /// Its time, s after the record's begin; none is any.
    pub time_s: Option<[f64; 2]>,
}

/// The result of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// `no_gap`, `parameters`, `effects`, `unknown_effect`.
    pub verdict: String,
    /// The causes, strongest first.
    pub causes: Vec<Cause>,
    /// Which part of the gap they close, and its 95 % interval.
    pub closed: Option<f64>,
    /// The interval.
    pub closed_ci95: Option<[f64; 2]>,
    /// The places, if the report states any.
    pub places: Vec<Place>,
    /// The part of the gap that is reproduced without a name, if the report states it.
    pub remainder: Option<f64>,
}

impl Report {
    /// From a diagnosis's JSON.
    ///
    /// # Errors
    /// [`ReportError`]: it is none.
    pub fn of(value: &Value) -> Result<Self, ReportError> {
        let missing = |key| ReportError::Missing { key };
        let verdict = value["verdict"].as_str().ok_or_else(|| missing("verdict"))?.to_owned();
        let causes = value["causes"].as_array().ok_or_else(|| missing("causes"))?;
        let cause = |(index, value): (usize, &Value)| {
            let names = value["channels"].as_array().ok_or_else(|| missing("causes.channels"))?;
            let sense = value["sense"].as_str().and_then(Sense::from_name).unwrap_or_default();
            // An effect that the sensor lacks has the model's numbers alone.
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
    /// Which effect it is; none of an unknown name.
    pub fn kind(&self) -> Option<EffectKind> {
        EffectKind::from_name(&self.effect)
    }

    /// The entries of a channel: one, or several of a list.
    pub fn entries(&self, channel: &str) -> &[Value] {
        entries(&self.parameters[channel])
    }

    /// The entries of all its channels.
    pub fn all_entries(&self) -> impl Iterator<Item = &Value> {
        self.channels.iter().flat_map(|channel| self.entries(channel))
    }
}

/// Two numbers.
fn pair(value: &Value) -> Option<[f64; 2]> {
    value[0].as_f64().zip(value[1].as_f64()).map(|(low, high)| [low, high])
}

/// A place; none if it names no channel.
fn place(value: &Value) -> Option<Place> {
    let of = match value["of"].as_str() {
        Some("parameters") => Of::Parameters,
        Some("remainder") => Of::Remainder,
        Some(other) => other.strip_prefix("cause:").and_then(|index| index.parse().ok()).map_or(Of::Untold, Of::Cause),
        None => Of::Untold,
    };
    let time_s = value["from_s"].as_f64().zip(value["to_s"].as_f64()).map(|(from, to)| [from, to]);
    Some(Place { channel: value["channel"].as_str()?.to_owned(), of, band_hz: pair(&value["band_hz"]), time_s })
}

/// One entry, or several of a list.
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
        assert_eq!(of, [Of::Cause(0), Of::Parameters, Of::Remainder, Of::Untold]);
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
