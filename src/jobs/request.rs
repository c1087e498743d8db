//! Requests for jobs: the kind of a job and its parameters.

use super::JobError;
use super::diagnosis_parameters::DiagnosisParameters;
use crate::store::{JobKind, JobRow, NewJob};
use imu_core::sample::Channel;
use imu_noise::allan::{Estimator, TauSpacing};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// The maximum number of captures in one computation.
pub const CAPTURES_MAX: usize = 100;

/// A request for a job. A row of the database holds the kind and, as JSON text, the parameters.
#[derive(Debug, Clone, PartialEq)]
pub enum JobRequest {
    /// An analysis of captures alone.
    Analysis(AnalysisRequest),
    /// Comparison with a simulator.
    Diagnosis(DiagnosisParameters),
}

/// A request for an analysis of captures alone.
#[derive(Debug, Clone, PartialEq)]
pub enum AnalysisRequest {
    /// Deviation curves.
    Allan(JobParameters),
    /// Noise parameters.
    Noise(JobParameters),
    /// Moments, histogram and a test for normality.
    Statistics(JobParameters),
}

impl AnalysisRequest {
    /// Returns the request for an analysis. Equal requests are equal values however they are written.
    ///
    /// # Errors
    /// [`JobError::Parameters`] for values that the kind does not have; a diagnosis takes none of these parameters.
    pub fn new(kind: JobKind, mut parameters: JobParameters) -> Result<Self, JobError> {
        let refuse = |reason: String| Err(JobError::Parameters { kind: kind.name(), reason });
        let allan = kind == JobKind::Allan;
        if parameters.taus == TauSpacing::Custom || (parameters.taus == TauSpacing::All && !allan) {
            let all = if allan { ", `all`" } else { "" };
            return refuse(format!("`taus` is `octave`, `log`{all}"));
        }
        if parameters.estimator != Estimator::default() && !allan {
            return refuse("only `allan` has an `estimator`".to_owned());
        }
        if !parameters.with.is_empty() && kind == JobKind::Statistics {
            return refuse("only `allan` and `noise` take captures `with` another".to_owned());
        }
        if parameters.with.len() >= CAPTURES_MAX {
            return refuse(format!("at most {} captures `with` another", CAPTURES_MAX - 1));
        }
        // Sums do not depend on the order.
        parameters.with.sort_unstable();
        if let Some(channels) = &mut parameters.channels {
            channels.sort_unstable();
            channels.dedup();
            if channels.is_empty() {
                return refuse("`channels` is empty: leave it out for all".to_owned());
            }
        }
        match kind {
            JobKind::Allan => Ok(Self::Allan(parameters)),
            JobKind::Noise => Ok(Self::Noise(parameters)),
            JobKind::Statistics => Ok(Self::Statistics(parameters)),
            JobKind::Diagnosis => refuse("it needs a simulator to compare with".to_owned()),
        }
    }

    /// Returns the request for an analysis with the usual parameters.
    ///
    /// # Errors
    /// [`JobError::Parameters`] for a diagnosis, which is never usual.
    pub fn usual(kind: JobKind) -> Result<Self, JobError> {
        Self::new(kind, JobParameters::default())
    }

    /// Returns the request for an analysis whose parameters a client gives as members of an object.
    ///
    /// # Errors
    /// [`JobError::Parameters`] for unknown names and impossible values.
    pub fn of_members(kind: JobKind, members: Map<String, Value>) -> Result<Self, JobError> {
        Self::of_read(kind, serde_json::from_value(Value::Object(members)))
    }

    fn of_read(kind: JobKind, read: serde_json::Result<JobParameters>) -> Result<Self, JobError> {
        let refuse = |error: serde_json::Error| JobError::Parameters { kind: kind.name(), reason: error.to_string() };
        Self::new(kind, read.map_err(refuse)?)
    }

    /// Returns the kind of job.
    pub fn kind(&self) -> JobKind {
        match self {
            Self::Allan(_) => JobKind::Allan,
            Self::Noise(_) => JobKind::Noise,
            Self::Statistics(_) => JobKind::Statistics,
        }
    }

    /// Returns the parameters.
    pub fn parameters(&self) -> &JobParameters {
        let (Self::Allan(parameters) | Self::Noise(parameters) | Self::Statistics(parameters)) = self;
        parameters
    }

    /// Returns the parameters as the database stores them.
    ///
    /// # Errors
    /// [`JobError::Json`] if they cannot be written.
    pub fn text(&self) -> Result<String, JobError> {
        text(self.parameters())
    }
}

impl JobRequest {
    /// Returns the request that a row of the database holds.
    ///
    /// # Errors
    /// [`JobError::Parameters`] or [`JobError::Model`] if the row's parameters are not those of its kind.
    pub fn of_row(row: &JobRow) -> Result<Self, JobError> {
        Ok(match row.kind {
            JobKind::Diagnosis => Self::Diagnosis(DiagnosisParameters::of_text(&row.params)?),
            kind => Self::Analysis(AnalysisRequest::of_read(kind, serde_json::from_str(&row.params))?),
        })
    }

    /// Returns the job that is to be stored.
    pub(super) fn job(&self, capture_id: i64) -> Result<NewJob, JobError> {
        let (kind, params, reference) = match self {
            Self::Analysis(analysis) => (analysis.kind(), analysis.text()?, None),
            Self::Diagnosis(parameters) => {
                (JobKind::Diagnosis, text(parameters)?, parameters.stored_reference().map(str::to_owned))
            }
        };
        Ok(NewJob { kind, capture_id, params, reference })
    }
}

/// Returns parameters as JSON with sorted keys, so that equal ones are the same text.
fn text(parameters: &impl Serialize) -> Result<String, JobError> {
    Ok(serde_json::to_value(parameters)?.to_string())
}

/// Parameters of an analysis.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobParameters {
    /// Averaging times: `log` (twenty per decade), `octave`, or, for `allan`, `all`; no effect on noise and statistics.
    #[serde(default)]
    pub taus: TauSpacing,
    /// For `allan`: the estimator. All but `oadev` hold a channel's samples in memory.
    #[serde(default, skip_serializing_if = "is_default")]
    pub estimator: Estimator,
    /// For `allan` and `noise`: ids of further captures of the same sensor, to be analysed with this one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub with: Vec<i64>,
    /// The channels; if absent, those whose noise is analysed, for statistics all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channels: Option<Vec<Channel>>,
}

/// Returns whether this is the default. The default is not written, so that jobs from before there was a choice stay
/// the same.
fn is_default(estimator: &Estimator) -> bool {
    *estimator == Estimator::default()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the request with these members.
    fn request(kind: JobKind, members: Value) -> Result<AnalysisRequest, JobError> {
        AnalysisRequest::of_read(kind, serde_json::from_value(members))
    }

    #[test]
    fn the_stored_text_has_sorted_keys() {
        let members = serde_json::json!({"taus": "octave", "estimator": "mdev"});
        let text = request(JobKind::Allan, members).unwrap().text().unwrap();
        assert_eq!(text, r#"{"estimator":"mdev","taus":"octave"}"#);
    }

    #[test]
    fn the_same_request_is_the_same_text_however_it_is_written() {
        let text = |members: Value| request(JobKind::Allan, members).unwrap().text().unwrap();
        let usual = AnalysisRequest::usual(JobKind::Allan).unwrap().text().unwrap();
        assert_eq!(usual, r#"{"taus":"log"}"#, "as it was before there was an estimator");
        assert_eq!(usual, text(serde_json::json!({})));
        assert_eq!(usual, text(serde_json::json!({"taus": "log"})));
        assert_eq!(usual, text(serde_json::json!({"estimator": "oadev", "with": []})));
        assert_eq!(text(serde_json::json!({"with": [3, 2]})), text(serde_json::json!({"with": [2, 3]})));
        assert_eq!(
            text(serde_json::json!({"channels": ["gyro_z", "gyro_x"]})),
            text(serde_json::json!({"channels": ["gyro_x", "gyro_z", "gyro_x"]})),
        );
    }

    #[test]
    fn what_is_not_a_parameter_is_refused_by_name() {
        for given in [
            serde_json::json!({"tau": "log"}),
            serde_json::json!({"taus": "custom"}),
            serde_json::json!({"estimator": "avar"}),
            serde_json::json!({"with": 2}),
            serde_json::json!({"channels": []}),
            serde_json::json!({"channels": ["gyro"]}),
            serde_json::json!([1]),
            serde_json::json!("log"),
        ] {
            let error = request(JobKind::Allan, given.clone()).unwrap_err();
            assert!(matches!(error, JobError::Parameters { kind: "allan", .. }), "{given}: {error}");
        }
        for given in [
            serde_json::json!({"taus": "all"}),
            serde_json::json!({"estimator": "mdev"}),
            serde_json::json!({"with": vec![2; CAPTURES_MAX]}),
        ] {
            assert!(request(JobKind::Noise, given.clone()).is_err(), "{given}");
        }
        assert!(request(JobKind::Statistics, serde_json::json!({"with": [2]})).is_err());
        assert!(AnalysisRequest::usual(JobKind::Diagnosis).unwrap_err().to_string().contains("needs a simulator"));
    }
}
