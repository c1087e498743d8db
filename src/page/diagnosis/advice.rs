//! What to do about a diagnosis: how the model changes, and which record or measure tells what is still open.
//!
//! A diagnosis goes in; sentences without a full stop come out, at least one.

use imu_diagnosis::Diagnosis;
use imu_diagnosis::report::{Cause, Of, Parameter, Sense, Verdict};
use imu_model::effects::EffectKind as Kind;
use serde_json::Value;
use std::collections::BTreeMap;

/// What a nat is, for readers of a diagnosis.
pub const NATS: &str = "A nat is the unit of the natural logarithm of a probability. The gap is the number of nats by which the \
    model predicts a sample of the recording worse than the best model that was found: over n samples the recording is \
    exp(n × gap) times as probable under that one. For scale: a white noise N that is wrong by 10 % costs about 0.01 nats a sample, one \
    that is wrong by 1 % about 0.0001. A true model shows a small gap too, since its numbers are known no better than the record \
    allows.";

/// What the column `sure` is, for readers of a diagnosis.
pub const SURE: &str = "the chance that this effect is the cause, and no other effect that looks like it";

/// The maximum number of causes with a sentence of their own.
const CAUSES: usize = 5;
/// The maximum number of parameters in a sentence.
const PARAMETERS: usize = 3;

/// Returns what to do. `corrected` states where the corrected model is, such as `better.json has it`.
pub fn advice(of: &Diagnosis, corrected: &str) -> Vec<String> {
    let mut changes: Vec<String> = of.causes.iter().take(CAUSES).map(change).collect();
    if of.causes.len() > CAUSES {
        changes.push(format!("likewise for the other {}", effects(of.causes.len() - CAUSES)));
    }
    if !of.parameters.is_empty() {
        changes.push(correction(&of.parameters));
    }
    match changes.last_mut() {
        Some(last) => *last += &format!(": {corrected}"),
        None if of.verdict == Verdict::NoGap => {
            changes.push("keep the model: a longer record would show smaller differences".to_owned());
        }
        None => {}
    }
    changes.extend(measures(of));
    if of.verdict == Verdict::UnknownEffect {
        let on = of.remainder.as_ref().map_or_else(String::new, |left| format!(" on {}", left.channels.join(", ")));
        changes.push(format!("look at the spectra of what remains{on}, and record in another place: what is gone there was not the sensor's"));
    }
    if changes.is_empty() {
        changes.push("record for longer: this record shows a difference and not its cause".to_owned());
    }
    changes
}

fn effects(count: usize) -> String {
    if count == 1 { "effect".to_owned() } else { format!("{count} effects") }
}

/// Returns how the model changes because of a cause.
fn change(cause: &Cause) -> String {
    let words = |parameters: &BTreeMap<String, Value>| {
        let (first, count) = match parameters.values().next() {
            Some(Value::Array(list)) => (list.first(), list.len()),
            other => (other, 1),
        };
        let more = if count > 1 { format!(" and {} more", count - 1) } else { String::new() };
        cause.effect.spec().phrase(first, &more)
    };
    let on = if cause.channels.is_empty() { "the sensor".to_owned() } else { cause.channels.join(", ") };
    match cause.sense {
        Sense::Missing => format!("add {} to the model of {on}", words(&cause.parameters)),
        Sense::Superfluous => format!("take {} out of the model of {on}", words(&cause.model)),
        Sense::Size => {
            format!("make it {} instead of {} in the model of {on}", words(&cause.parameters), words(&cause.model))
        }
    }
}

/// Returns how the model's parameters change.
fn correction(parameters: &[Parameter]) -> String {
    let one = |of: &Parameter| format!("{} {} to {}", of.channel, of.parameter, imu_cost::number(of.capture));
    let first: Vec<String> = parameters.iter().take(PARAMETERS).map(one).collect();
    let more = parameters.len().saturating_sub(PARAMETERS);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("correct {}{more}", first.join(", "))
}

/// Returns the measures and records that tell the sensor from its surroundings.
fn measures(of: &Diagnosis) -> Vec<String> {
    let missing: Vec<&Cause> = of.causes.iter().filter(|cause| cause.sense == Sense::Missing).collect();
    let found = |kinds: &[Kind]| missing.iter().any(|cause| kinds.contains(&cause.effect));
    let nyquist_hz = of.r#where.iter().filter(|place| !matches!(place.of, Of::Parameters));
    let nyquist_hz = nyquist_hz.map(|place| place.band_hz[1]).fold(0.0, f64::max);
    let other_hz = if (49.0..51.0).contains(&nyquist_hz) { 200 } else { 100 };
    let folded = format!(
        "record at another output rate, such as {other_hz} Hz, to tell a folded line: a true one stays, a folded one moves"
    );
    let all: [(&[Kind], &str); 8] = [
        (
            &[Kind::Tone, Kind::Comb, Kind::Resonance, Kind::WanderingLine, Kind::ModulatedBand, Kind::Intermittent],
            "isolate the table and record again: a line or a band that is gone then was vibration, and not the sensor's",
        ),
        (&[Kind::Tone, Kind::Comb], &folded),
        (
            &[Kind::Bursts, Kind::Spikes, Kind::BiasStep, Kind::VarianceChange],
            "record where nobody walks or touches the table: knocks and handling are not the sensor's",
        ),
        (
            &[Kind::TemperatureBias, Kind::WarmUp, Kind::RateRamp],
            "record the temperature too, and begin once the sensor is warm, to tell a drift from a warm-up",
        ),
        (&[Kind::CommonMode], "record on another support: noise that axes share may be the support's"),
        (
            &[Kind::Resolution, Kind::QuantizationNoise],
            "let the sensor send more digits, or binary values, if the steps matter",
        ),
        (&[Kind::Saturation], "choose a larger range of the sensor, or a gentler motion"),
        (
            &[Kind::HeldSamples, Kind::Timing],
            "check the link and the output rate: samples that repeat or come late are made there",
        ),
    ];
    all.into_iter().filter(|(kinds, _)| found(kinds)).map(|(_, sentence)| sentence.to_owned()).collect()
}

pub(super) fn section(out: &mut String, of: &Diagnosis) {
    *out += "<h2>What to do</h2><ul>";
    for sentence in advice(of, "the corrected model has it") {
        *out += &format!("<li>{}</li>", super::escaped(&sentence));
    }
    *out += "</ul>";
}
