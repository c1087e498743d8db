//! The report: the result of a diagnosis, in the form of docs/formats.md. `sentence.rs` writes its summary.

use super::written::numbers;
use imu_core::sample::Channel;
use imu_model::effects::EffectKind;
use serde::{Deserialize, Deserializer, Serialize, de};
use serde_json::{Map, Value};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

/// The format's name.
pub const FORMAT: &str = "vn100d-diagnosis-1";

/// The overall result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// No difference beyond chance.
    NoGap,
    /// Only N, B, K, a bias or the rate is off.
    Parameters,
    /// The effects that were found explain the discrepancy down to the floor.
    Effects,
    /// A discrepancy remains that no known effect explains, and it exceeds a small part of the gap.
    UnknownEffect,
}

/// The discrepancy in nats of log density of the real samples per sample, a mean over the channels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Discrepancy {
    /// Always `nats/sample`.
    pub unit: Cow<'static, str>,
    /// Under the original model.
    #[serde(deserialize_with = "numbers")]
    pub before: f64,
    /// With the model's parameters corrected.
    #[serde(deserialize_with = "numbers")]
    pub after_parameters: f64,
    /// With the effects found as well.
    #[serde(deserialize_with = "numbers")]
    pub after: f64,
    /// The discrepancy of a true model.
    #[serde(deserialize_with = "numbers")]
    pub floor: f64,
    /// Chance that a true model shows as large a discrepancy as the remaining one.
    #[serde(deserialize_with = "numbers")]
    pub p_value_after: f64,
    /// (after_parameters − after)/(after_parameters − floor); none if no effect was added or if there was no gap to close.
    pub closed: Option<f64>,
    /// The 95 % interval of `closed`.
    pub closed_ci95: Option<[f64; 2]>,
    /// The data on which it was measured.
    pub measured_on: String,
    /// What the gap does to unaided integration; none for a motion, for a record that is too short, and in reports of
    /// earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<GapCost>,
}

/// Error growth of unaided integration at rest, under the model and under the corrected one (docs/cost.md).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GapCost {
    /// Time of the alignment, s.
    #[serde(deserialize_with = "numbers")]
    pub align_s: f64,
    /// Times since the alignment's end, s, at most three.
    pub horizons_s: Vec<f64>,
    /// By quantity, such as `heading`.
    pub quantities: BTreeMap<String, Bands>,
    /// What was left out, one sentence each.
    pub notes: Vec<String>,
    /// What pieces of the recording show; none if it is too short, and in reports of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<MeasuredGrowth>,
}

/// Error growth measured in pieces of the recording, beside what both models predict (docs/cost.md).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasuredGrowth {
    /// Times since the alignment's end, s.
    pub horizons_s: Vec<f64>,
    /// By quantity, such as `heading`; one entry per horizon, none if there are too few pieces.
    pub quantities: BTreeMap<String, Vec<Option<MeasuredPieces>>>,
    /// What was left out, one sentence each.
    pub notes: Vec<String>,
}

/// The errors in the pieces of one horizon, in the quantity's unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasuredPieces {
    /// The number of independent pieces.
    #[serde(deserialize_with = "numbers")]
    pub independent: f64,
    /// Root mean square of the errors.
    #[serde(deserialize_with = "numbers")]
    pub rms: f64,
    /// Its 95 % interval.
    pub rms_ci95: [f64; 2],
    /// The root mean square that the original model predicts for these pieces.
    #[serde(deserialize_with = "numbers")]
    pub before_rms: f64,
    /// The one that the corrected model predicts.
    #[serde(deserialize_with = "numbers")]
    pub after_rms: f64,
    /// Share of the pieces inside the original model's 95 % band.
    #[serde(deserialize_with = "numbers")]
    pub before_coverage: f64,
    /// Share of the pieces inside the corrected model's 95 % band.
    #[serde(deserialize_with = "numbers")]
    pub after_coverage: f64,
    /// The 95 % interval of `after_coverage`.
    pub after_coverage_ci95: [f64; 2],
}

/// The 95 % bands of a quantity, one per horizon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bands {
    /// `rad`, `m/s` or `m`.
    pub unit: Cow<'static, str>,
    /// Under the original model.
    pub before: Vec<f64>,
    /// Under the corrected model.
    pub after: Vec<f64>,
    /// What the 95 % intervals of the corrected model's N, B, K and sizes of effects allow; none if a size that
    /// matters has no interval.
    pub after_ci95: Option<Vec<[f64; 2]>>,
    /// Under the corrected model without the causes that the sensor has.
    pub floor: Vec<f64>,
    /// As `after_ci95`.
    pub floor_ci95: Option<Vec<[f64; 2]>>,
}

/// A cause's part in the error of a quantity, one number per horizon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CauseCost {
    /// Part of the mean square error.
    pub share: Vec<f64>,
    /// The 95 % band if the cause is gone, in the quantity's unit.
    pub band95_without: Vec<f64>,
}

/// The finding that lies in a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Of {
    /// The cause of this number in the list.
    Cause(usize),
    /// Parameters that are off.
    Parameters,
    /// The part of the gap that no known effect explains.
    Remainder,
}

impl Serialize for Of {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Cause(index) => serializer.collect_str(&format_args!("cause:{index}")),
            Self::Parameters => serializer.serialize_str("parameters"),
            Self::Remainder => serializer.serialize_str("remainder"),
        }
    }
}

impl<'de> Deserialize<'de> for Of {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let text = Cow::<str>::deserialize(from)?;
        match (text.strip_prefix("cause:").and_then(|index| index.parse().ok()), &*text) {
            (Some(index), _) => Ok(Self::Cause(index)),
            (None, "parameters") => Ok(Self::Parameters),
            (None, "remainder") => Ok(Self::Remainder),
            (None, other) => Err(de::Error::custom(format_args!("`{other}` lies in no place"))),
        }
    }
}

/// Returns a cause number that no cause has: reports of earlier versions do not state the finding of a place.
fn unstated() -> Of {
    Of::Cause(usize::MAX)
}

/// A place where real and simulated samples differ.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// The finding at the place.
    #[serde(default = "unstated")]
    pub of: Of,
    /// The channel.
    pub channel: String,
    /// Frequencies.
    #[serde(deserialize_with = "numbers")]
    pub band_hz: [f64; 2],
    /// Averaging times that cover these frequencies.
    #[serde(deserialize_with = "numbers")]
    pub tau_s: [f64; 2],
    /// Start, s after that of the compared samples, or of the capture ([`Diagnosis::begins_at`]).
    #[serde(deserialize_with = "numbers")]
    pub from_s: f64,
    /// End, s.
    #[serde(deserialize_with = "numbers")]
    pub to_s: f64,
    /// Temperatures, if the discrepancy depends on them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<[f64; 2]>,
    /// The course of the motion at the place, if the motion drives the gap.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub at: Option<Driver>,
    /// Part of the nats of all places.
    #[serde(deserialize_with = "numbers")]
    pub share: f64,
    /// Nats at the place.
    #[serde(default, deserialize_with = "numbers")]
    pub nats: f64,
    /// Chance that noise alone makes as heavy a place anywhere in the record.
    #[serde(default, deserialize_with = "numbers")]
    pub p_value: f64,
    /// `real noisier` or `real quieter`; for a gap that a motion drives, `real higher` or `real lower`.
    pub sign: Cow<'static, str>,
}

/// The part of a motion's range in which a discrepancy lies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Driver {
    /// `rate` or `acceleration` (specific force).
    pub quantity: Cow<'static, str>,
    /// The sensor's axis: x, y or z.
    pub axis: Cow<'static, str>,
    /// The unit of the quantity.
    pub unit: Cow<'static, str>,
    /// The lower and the upper end.
    #[serde(deserialize_with = "numbers")]
    pub range: [f64; 2],
    /// The pose at rest, such as `z down`, if the range lies in one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose: Option<String>,
}

/// A parameter that is merely off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// The channel; `sensor` for a parameter of the whole sensor.
    pub channel: String,
    /// N, B, K, bias or rate_hz.
    pub parameter: Cow<'static, str>,
    /// The model's value.
    #[serde(deserialize_with = "numbers")]
    pub model: f64,
    /// The capture's value; 0 if the capture shows none, which limits it to the upper end of its interval.
    #[serde(deserialize_with = "numbers")]
    pub capture: f64,
    /// The capture's value over the model's; none if one of them is 0.
    pub ratio: Option<f64>,
    /// Nats that the model's value loses against the best one; 0 if not measured.
    #[serde(default, deserialize_with = "numbers")]
    pub nats: f64,
    /// 95 % interval of the capture's value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
}

/// A mean of the capture that differs from the model's by more than turn-on bias and pose explain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Offset {
    /// The channel.
    pub channel: String,
    /// The model's `bias`, U.
    #[serde(deserialize_with = "numbers")]
    pub model: f64,
    /// The capture's mean without its explained part, U.
    #[serde(deserialize_with = "numbers")]
    pub capture: f64,
    /// The part that turn-on bias explains, U.
    #[serde(deserialize_with = "numbers")]
    pub explained: f64,
}

/// The possible meaning of the size of a difference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HintKind {
    /// The root of the rate is applied once too often or once too rarely.
    SqrtRate,
    /// Another unit.
    Unit,
    /// The other sign.
    Sign,
    /// Another axis.
    Axes,
    /// Another prefix of the unit.
    Scale,
    /// A range that cuts off.
    Range,
    /// Rows that were sent again.
    Repeats,
}

/// A difference whose size has a meaning.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hint {
    /// The quantity that differs, such as `accel_x N`.
    pub about: String,
    /// The meaning.
    pub kind: HintKind,
    /// The hint as a sentence.
    pub text: String,
}

/// The side on which an effect is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sense {
    /// The sensor has it, the model lacks it.
    #[default]
    Missing,
    /// The model has it, the sensor lacks it.
    Superfluous,
    /// Both have it, with other numbers.
    Size,
}

/// An effect in which sensor and model differ.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cause {
    /// The effect.
    pub effect: EffectKind,
    /// The side that has it.
    #[serde(default)]
    pub sense: Sense,
    /// The triad, if the effect belongs to it as a whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub triad: Option<Cow<'static, str>>,
    /// The channels of the effect.
    pub channels: Vec<String>,
    /// Chance that this is the cause.
    #[serde(deserialize_with = "numbers")]
    pub confidence: f64,
    /// The part of the gap that it closes; none if nothing could be measured.
    pub closes: Option<f64>,
    /// By channel (or triad): the sensor's parameters, a list if there are several.
    pub parameters: BTreeMap<String, Value>,
    /// The model's parameters in the same form, if it has the effect.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub model: BTreeMap<String, Value>,
    /// 95 % intervals in the same form, if they are known.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub uncertainty: Map<String, Value>,
    /// The evidence, in sentences with figures.
    pub evidence: Vec<String>,
    /// By quantity: its part in the cost under the corrected model; of an effect that the sensor lacks, under the
    /// original one.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub cost: BTreeMap<String, CauseCost>,
}

impl Cause {
    /// Returns whether one of the cause's channels is among these.
    pub(crate) fn is_on(&self, channels: &BTreeSet<Channel>) -> bool {
        channels.iter().any(|channel| self.channels.iter().any(|own| own == channel.name()))
    }
}

/// An effect that was weighed and not named.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alternative {
    /// The effect.
    pub effect: EffectKind,
    /// The channels.
    pub channels: Vec<String>,
    /// The part of the gap that it would close alone.
    pub closes: Option<f64>,
    /// The reason, as a sentence.
    pub why_not: String,
}

/// One channel's discrepancy, nats per sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ChannelGap {
    /// Under the original model.
    #[serde(deserialize_with = "numbers")]
    pub before: f64,
    /// With all effects that were found.
    #[serde(deserialize_with = "numbers")]
    pub after: f64,
    /// The discrepancy of a true model.
    #[serde(deserialize_with = "numbers")]
    pub floor: f64,
}

/// The part that no known effect explains.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Remainder {
    /// Part of the nats of all places.
    pub share: f64,
    /// Nats per sample.
    #[serde(deserialize_with = "numbers")]
    pub nats: f64,
    /// The channels of the remainder.
    pub channels: Vec<String>,
    /// The evidence, one sentence each.
    pub what: Vec<String>,
}

/// The result of a diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Diagnosis {
    /// [`FORMAT`].
    pub format: Cow<'static, str>,
    /// The overall result.
    pub verdict: Verdict,
    /// One sentence for a person.
    pub summary: String,
    /// The size of the gap.
    pub discrepancy: Discrepancy,
    /// The places, heaviest first: of each cause, of the parameters that are off, and of the remainder.
    pub r#where: Vec<Place>,
    /// The parameters that are merely off.
    pub parameters: Vec<Parameter>,
    /// Means that differ from the model's.
    #[serde(default)]
    pub offsets: Vec<Offset>,
    /// The possible meanings of the sizes of these differences.
    #[serde(default)]
    pub hints: Vec<Hint>,
    /// Effects in which sensor and model differ, strongest first.
    pub causes: Vec<Cause>,
    /// The part that no known effect explains; none if nothing remains.
    pub remainder: Option<Remainder>,
    /// The effects that were weighed and not named.
    pub alternatives: Vec<Alternative>,
    /// The gap per channel.
    pub per_channel: BTreeMap<String, ChannelGap>,
    /// Notes for the reader: channels that were not compared, the sizes above which effects are excluded, and pairs of
    /// causes that this record cannot distinguish, with the measurement that would distinguish them.
    pub notes: Vec<String>,
    /// The program and its version.
    pub software: String,
    /// The inputs that were compared.
    pub inputs: BTreeMap<Cow<'static, str>, String>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_read_as_it_was_written() {
        for of in [Of::Cause(3), Of::Parameters, Of::Remainder] {
            let place = Place::in_tests(of, 0.5);
            let read: Place = serde_json::from_value(serde_json::to_value(&place).unwrap()).unwrap();
            assert_eq!(read, place);
        }
        assert!(serde_json::from_value::<Of>("cause:x".into()).is_err());
    }
}
