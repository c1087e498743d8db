//! The report: what a diagnosis says, in the form of the contract (section 6).

use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::BTreeMap;

/// The format's name.
pub const FORMAT: &str = "vn100d-diagnosis-1";

/// What was found in all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[expect(clippy::exhaustive_enums, reason = "the contract's four")]
pub enum Verdict {
    /// Nothing beyond chance.
    NoGap,
    /// Only N, B, K, a bias or the rate is off.
    Parameters,
    /// What was found explains the discrepancy down to the floor.
    Effects,
    /// Something real remains that no known effect explains.
    UnknownEffect,
}

/// The discrepancy in nats of log density of the real samples per sample, a mean over the channels.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the contract's keys")]
pub struct Discrepancy {
    /// Always `nats/sample`.
    pub unit: &'static str,
    /// Under the model as it came.
    pub before: f64,
    /// With its parameters corrected.
    pub after_parameters: f64,
    /// With the effects found as well.
    pub after: f64,
    /// What a true model shows.
    pub floor: f64,
    /// Chance that a true model shows as much as is left.
    pub p_value_after: f64,
    /// (after_parameters − after)/(after_parameters − floor); none where nothing was added or nothing was there to close.
    pub closed: Option<f64>,
    /// Its 95 % interval.
    pub closed_ci95: Option<[f64; 2]>,
    /// On which data.
    pub measured_on: String,
}

/// A place where real and simulated samples differ.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the contract's keys")]
pub struct Place {
    /// The channel.
    pub channel: String,
    /// Frequencies.
    pub band_hz: [f64; 2],
    /// Averaging times that see them.
    pub tau_s: [f64; 2],
    /// Begin, s after the record's.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
    /// Temperatures, where the discrepancy depends on them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<[f64; 2]>,
    /// Part of the whole discrepancy.
    pub share: f64,
    /// `real noisier` or `real quieter`.
    pub sign: &'static str,
}

/// A parameter that is merely off.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the contract's keys")]
pub struct Parameter {
    /// The channel; `sensor` for what belongs to all.
    pub channel: String,
    /// N, B, K, bias, rate_hz.
    pub parameter: &'static str,
    /// The model's value.
    pub model: f64,
    /// The capture's.
    pub capture: f64,
    /// The second over the first; none where the model has 0.
    pub ratio: Option<f64>,
    /// 95 % interval of the capture's value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
}

/// An effect that the model lacks.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the contract's keys")]
pub struct Cause {
    /// The contract's name of it.
    pub effect: &'static str,
    /// The triad that it belongs to as a whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub triad: Option<&'static str>,
    /// The channels it is on.
    pub channels: Vec<String>,
    /// Chance that it is this one.
    pub confidence: f64,
    /// The part of the gap that it closes; none where nothing could be measured.
    pub closes: Option<f64>,
    /// By channel (or triad): its parameters, a list where there are several.
    pub parameters: BTreeMap<String, Value>,
    /// 95 % intervals in the same form, where they are known.
    #[serde(skip_serializing_if = "Map::is_empty")]
    pub uncertainty: Map<String, Value>,
    /// Sentences with figures.
    pub evidence: Vec<String>,
}

/// An effect that was weighed and not named.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the contract's keys")]
pub struct Alternative {
    /// The contract's name of it.
    pub effect: &'static str,
    /// The channels.
    pub channels: Vec<String>,
    /// The part of the gap that it would close alone.
    pub closes: Option<f64>,
    /// A sentence.
    pub why_not: String,
}

/// One channel's discrepancy, nats per sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[expect(clippy::exhaustive_structs, reason = "the contract's keys")]
pub struct ChannelGap {
    /// Under the model as it came.
    pub before: f64,
    /// With everything found.
    pub after: f64,
    /// What a true model shows.
    pub floor: f64,
}

/// What a diagnosis says.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Diagnosis {
    /// [`FORMAT`].
    pub format: &'static str,
    /// In all.
    pub verdict: Verdict,
    /// One sentence for a person.
    pub summary: String,
    /// How much.
    pub discrepancy: Discrepancy,
    /// Where, before effects; what remains, where that is unknown.
    pub r#where: Vec<Place>,
    /// What is merely off.
    pub parameters: Vec<Parameter>,
    /// What the model lacks, strongest first.
    pub causes: Vec<Cause>,
    /// What was weighed.
    pub alternatives: Vec<Alternative>,
    /// Per channel.
    pub per_channel: BTreeMap<String, ChannelGap>,
    /// What a reader should know: channels not compared, effects larger than which are excluded, pairs that this record cannot
    /// tell apart and the measurement that would.
    pub notes: Vec<String>,
    /// The program.
    pub software: String,
    /// What was compared.
    pub inputs: BTreeMap<&'static str, String>,
}
