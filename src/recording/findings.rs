//! Findings: what is remarkable about a recording's times and values, as figures and as sentences.

use super::info::RecordingInfo;
use crate::units::NANOS_PER_SECOND;

/// Mean and median rate that differ by more are told apart.
const RATES_DIFFER: f64 = 0.02;
/// A told rate that differs by more from the one found is said.
const TOLD_DIFFERS: f64 = 0.005;
/// From this share of short steps on, stamps come in pairs or bursts.
const BURSTS_FROM: f64 = 0.05;

/// Figures of a first pass.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize)]
pub struct Findings {
    /// Steps from stamp to stamp.
    pub steps: u64,
    /// Steps over their time, Hz; below the rate where samples are missing.
    pub mean_rate_hz: Option<f64>,
    /// Steps over 1.5 periods: each is a gap.
    pub irregular_steps: u64,
    /// The longest, s.
    pub longest_step_s: Option<f64>,
    /// When it began, UTC ns; `None` where stamps do not tell the time of day.
    pub longest_step_utc_ns: Option<i64>,
    /// Steps below a tenth of the mean step: stamps in pairs or bursts.
    pub short_steps: u64,
    /// Samples that repeat the one before in every channel.
    pub repeated_samples: u64,
    /// How often the sensor's own clock restarted: what was missed there nothing tells.
    pub restarts: u64,
    /// Samples with a magnetic field above 25 gauss: the unit is not what it was taken for.
    pub strong_fields: u64,
}

impl RecordingInfo {
    /// What a person should know about the recording, a sentence each.
    #[must_use]
    pub fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        let found = &self.findings;
        if let Some(choice) = self.stamp_choice.as_ref().filter(|choice| choice.regular.len() > 1) {
            let percent = |share: &f64| format!("{:.1} %", 100.0 * share);
            let others = choice.regular.iter().enumerate().filter(|(index, _)| index + 1 != choice.column);
            let others: Vec<_> = others.map(|(_, share)| percent(share)).collect();
            remarks.push(format!(
                "times are from the {}: {} of its steps lie within 10 % of the median step (the other stamps: {})",
                choice.name,
                choice.regular.get(choice.column - 1).map(percent).unwrap_or_default(),
                others.join(", ")
            ));
        }
        if let Some(mean_hz) = found.mean_rate_hz.filter(|mean| (mean / self.rate_hz - 1.0).abs() > RATES_DIFFER) {
            remarks.push(format!("{mean_hz:.1} stamps a second on average, {:.1} by the median step", self.rate_hz));
        }
        if let Some(longest_s) = found.longest_step_s.filter(|_| found.irregular_steps > 0) {
            let when =
                found.longest_step_utc_ns.map_or_else(String::new, |utc_ns| format!(", from {}", rfc3339(utc_ns)));
            remarks.push(format!(
                "{} of {} steps are over 1.5 periods, a gap each; the longest is {longest_s:.3} s{when}",
                found.irregular_steps, found.steps
            ));
        }
        if found.short_steps as f64 > BURSTS_FROM * found.steps as f64 {
            remarks.push(format!(
                "stamps come in pairs or bursts: {} of {} steps are below a tenth of the mean step",
                found.short_steps, found.steps
            ));
        }
        if let Some(told_hz) = self.unused_rate_hz {
            let differs = (told_hz / self.rate_hz - 1.0).abs() > TOLD_DIFFERS;
            let but = if differs { format!(", which say {} Hz", self.rate_hz) } else { String::new() };
            remarks.push(format!("the told rate of {told_hz} Hz was not used: the recording has stamps{but}"));
        }
        if found.repeated_samples > 0 {
            remarks.push(format!(
                "{} samples repeat the one before in every channel: the source was frozen or wrote them twice",
                found.repeated_samples
            ));
        }
        if found.restarts > 0 {
            remarks.push(format!(
                "the sensor's clock restarted {} times (a reset): how long it was away nothing tells, no sample is counted missing there",
                found.restarts
            ));
        }
        if found.strong_fields > 0 {
            remarks.push(format!(
                "{} samples have a magnetic field above 25 gauss, which no VN-100 can tell: was it in gauss already?",
                found.strong_fields
            ));
        }
        remarks
    }
}

/// UTC to the millisecond.
fn rfc3339(utc_ns: i64) -> String {
    let (seconds, nanos) = (utc_ns.div_euclid(NANOS_PER_SECOND as i64), utc_ns.rem_euclid(NANOS_PER_SECOND as i64));
    chrono::DateTime::from_timestamp(seconds, nanos as u32)
        .map_or_else(String::new, |time| time.to_rfc3339_opts(chrono::SecondsFormat::Millis, true))
}
