//! Reports: what a trial reads of a diagnosis in the contract's form (section 6), whoever made it.

use serde_json::Value;

/// Why something is no diagnosis.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
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
#[expect(clippy::exhaustive_structs, reason = "the contract's keys")]
pub struct Cause {
    /// The contract's name of it.
    pub effect: String,
    /// Its channels.
    pub channels: Vec<String>,
    /// Stated chance that it is this one.
    pub confidence: Option<f64>,
    /// By channel: its parameters, an object or a list of them.
    pub parameters: Value,
}

/// What a diagnosis says.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::exhaustive_structs, reason = "the contract's keys")]
pub struct Report {
    /// `no_gap`, `parameters`, `effects`, `unknown_effect`.
    pub verdict: String,
    /// The causes, strongest first.
    pub causes: Vec<Cause>,
    /// Which part of the gap they close, and its 95 % interval.
    pub closed: Option<f64>,
    /// The interval.
    pub closed_ci95: Option<[f64; 2]>,
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
        let cause = |value: &Value| {
            let names = value["channels"].as_array().ok_or_else(|| missing("causes.channels"))?;
            Ok(Cause {
                effect: value["effect"].as_str().ok_or_else(|| missing("causes.effect"))?.to_owned(),
                channels: names.iter().filter_map(|name| name.as_str().map(str::to_owned)).collect(),
                confidence: value["confidence"].as_f64(),
                parameters: value["parameters"].clone(),
            })
        };
        let discrepancy = &value["discrepancy"];
        let interval = &discrepancy["closed_ci95"];
        Ok(Self {
            verdict,
            causes: causes.iter().map(cause).collect::<Result<_, _>>()?,
            closed: discrepancy["closed"].as_f64(),
            closed_ci95: interval[0].as_f64().zip(interval[1].as_f64()).map(|(low, high)| [low, high]),
        })
    }
}

impl Cause {
    /// The entries of a channel: one, or several of a list.
    #[must_use]
    pub fn entries(&self, channel: &str) -> &[Value] {
        entries(&self.parameters[channel])
    }

    /// The entries of all its channels.
    pub fn all_entries(&self) -> impl Iterator<Item = &Value> {
        self.channels.iter().flat_map(|channel| self.entries(channel))
    }
}

/// One entry, or several of a list.
pub(super) fn entries(value: &Value) -> &[Value] {
    match value {
        Value::Null => &[],
        Value::Array(list) => list,
        one => std::slice::from_ref(one),
    }
}
