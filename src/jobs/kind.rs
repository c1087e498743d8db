//! Kinds of jobs and their parameters.

use super::{CAPTURES_MAX, JobError};
use imu_core::sample::Channel;
use imu_noise::allan::{Estimator, TauSpacing};
use serde::{Deserialize, Serialize};

/// What a job computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    /// Deviation curves (`vn100d-allan-1`).
    Allan,
    /// Noise parameters (`vn100d-noise-1`).
    Noise,
    /// Moments, histogram and a test for normality (`vn100d-statistics-1`).
    Statistics,
    /// Where a simulator differs and what it lacks (`vn100d-diagnosis-1`).
    Diagnosis,
}

impl JobKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Allan, Self::Noise, Self::Statistics, Self::Diagnosis];
    /// The kinds that are queued for every capture without a request.
    pub const USUAL: [Self; 3] = [Self::Allan, Self::Noise, Self::Statistics];

    /// The name in the database and JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Allan => "allan",
            Self::Noise => "noise",
            Self::Statistics => "statistics",
            Self::Diagnosis => "diagnosis",
        }
    }

    /// A description of its result.
    pub fn gives(self) -> &'static str {
        match self {
            Self::Allan => "Allan deviation",
            Self::Noise => "table of noise parameters",
            Self::Statistics => "table of statistics",
            Self::Diagnosis => "diagnosis",
        }
    }

    /// The kind with that name.
    ///
    /// # Errors
    /// [`JobError::UnknownKind`] with the known names.
    pub fn from_name(name: &str) -> Result<Self, JobError> {
        Self::ALL.into_iter().find(|kind| kind.name() == name).ok_or_else(|| JobError::UnknownKind {
            found: name.chars().take(40).collect(),
            expected: Self::ALL.map(Self::name).join(", "),
        })
    }

    /// Reads the parameters of a job of one of the usual kinds. Defaults are filled in, so that equal requests are the
    /// same job however they are written.
    ///
    /// # Errors
    /// [`JobError::Parameters`] for unknown names and impossible values.
    pub fn parameters(self, given: &serde_json::Value) -> Result<JobParameters, JobError> {
        let refuse = |reason| JobError::Parameters { kind: self.name(), reason };
        let given = if given.is_null() { serde_json::json!({}) } else { given.clone() };
        let mut parameters: JobParameters = serde_json::from_value(given).map_err(|error| refuse(error.to_string()))?;
        let allan = self == Self::Allan;
        if parameters.taus == TauSpacing::Custom || (parameters.taus == TauSpacing::All && !allan) {
            let all = if allan { ", `all`" } else { "" };
            return Err(refuse(format!("`taus` is `octave`, `log`{all}")));
        }
        if parameters.estimator != Estimator::default() && !allan {
            return Err(refuse("only `allan` has an `estimator`".to_owned()));
        }
        if !parameters.with.is_empty() && self == Self::Statistics {
            return Err(refuse("only `allan` and `noise` take captures `with` another".to_owned()));
        }
        if parameters.with.len() >= CAPTURES_MAX {
            return Err(refuse(format!("at most {} captures `with` another", CAPTURES_MAX - 1)));
        }
        // Sums do not depend on the order.
        parameters.with.sort_unstable();
        if let Some(channels) = &mut parameters.channels {
            channels.sort_unstable();
            channels.dedup();
            if channels.is_empty() {
                return Err(refuse("`channels` is empty: leave it out for all".to_owned()));
            }
        }
        Ok(parameters)
    }
}

/// Parameters of a job of one of the usual kinds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct JobParameters {
    /// Averaging times: `log` (twenty to the decade), `octave`, or of `allan` `all`; without effect on noise and statistics.
    #[serde(default)]
    pub taus: TauSpacing,
    /// Of `allan`: which deviation. All but `oadev` hold a channel's samples in memory.
    #[serde(default, skip_serializing_if = "is_default")]
    pub estimator: Estimator,
    /// Of `allan` and `noise`: ids of further captures of the same sensor, to be analysed with this one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub with: Vec<i64>,
    /// Which channels; where absent those whose noise is analysed, for statistics all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub channels: Option<Vec<Channel>>,
}

/// Defaults from before there was a choice are not written, so that the job stays the same.
fn is_default(estimator: &Estimator) -> bool {
    *estimator == Estimator::default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_wish_is_the_same_text_however_it_is_written() {
        let text =
            |given: serde_json::Value| serde_json::to_string(&JobKind::Allan.parameters(&given).unwrap()).unwrap();
        assert_eq!(text(serde_json::Value::Null), text(serde_json::json!({"taus": "log"})));
        assert_eq!(text(serde_json::Value::Null), r#"{"taus":"log"}"#, "as it was before there was an estimator");
        assert_eq!(text(serde_json::Value::Null), text(serde_json::json!({"estimator": "oadev", "with": []})));
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
            let error = JobKind::Allan.parameters(&given).unwrap_err();
            assert!(matches!(error, JobError::Parameters { kind: "allan", .. }), "{given}: {error}");
        }
        for given in [
            serde_json::json!({"taus": "all"}),
            serde_json::json!({"estimator": "mdev"}),
            serde_json::json!({"with": vec![2; CAPTURES_MAX]}),
        ] {
            assert!(JobKind::Noise.parameters(&given).is_err(), "{given}");
        }
        assert!(JobKind::Statistics.parameters(&serde_json::json!({"with": [2]})).is_err());
        assert!(JobKind::from_name("alan").unwrap_err().to_string().contains("allan"));
    }
}
