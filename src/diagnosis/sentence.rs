//! Sentences: a diagnosis in one, for a person who has ten seconds.

use super::report::{Cause, Diagnosis, Sense, Verdict};
use serde_json::Value;
use std::collections::BTreeMap;

/// The one sentence.
#[must_use]
pub(super) fn summary(of: &Diagnosis) -> String {
    let explained = |closed: Option<f64>| {
        closed
            .map_or_else(String::new, |closed| format!(" explains {:.0} % of the gap", 100.0 * closed.clamp(0.0, 1.0)))
    };
    match (of.verdict, of.causes.first()) {
        (Verdict::NoGap, _) => "no gap: the recording is what the model says, as far as can be told".to_owned(),
        (Verdict::Parameters, _) => {
            let names: Vec<String> = of
                .parameters
                .iter()
                .take(3)
                .map(|of| match of.ratio {
                    Some(ratio) => format!("{} {} is {ratio:.2} times the model's", of.channel, of.parameter),
                    None => format!("{} {} is {:.3e} instead of 0", of.channel, of.parameter, of.capture),
                })
                .collect();
            format!("no effect is missing, but parameters are off: {}", names.join("; "))
        }
        (Verdict::Effects, Some(cause)) => {
            let further = match of.causes.len() {
                1 => String::new(),
                2 => ", beside another cause".to_owned(),
                more => format!(", beside {} other causes", more - 1),
            };
            let closed = of.discrepancy.closed;
            let together = if of.causes.len() > 1 { "; together they" } else { "" };
            match closed {
                Some(_) if together.is_empty() => {
                    format!("{}: {}{}", channels(cause), phrase(cause), explained(closed))
                }
                Some(closed) => format!(
                    "{}: {}{further}{together} explain {:.0} % of the gap",
                    channels(cause),
                    phrase(cause),
                    100.0 * closed.clamp(0.0, 1.0)
                ),
                None => format!("{}: {}{further}", channels(cause), phrase(cause)),
            }
        }
        (Verdict::UnknownEffect, Some(cause)) => {
            format!("{}: {}; something remains that no known effect explains", channels(cause), phrase(cause))
        }
        _ => "something is there that no known effect explains".to_owned(),
    }
}

fn channels(cause: &Cause) -> String {
    match cause.channels.as_slice() {
        [] => "sensor".to_owned(),
        [one] => one.clone(),
        [first, .., last] if cause.channels.len() > 3 => format!("{first} to {last} ({})", cause.channels.len()),
        several => several.join(", "),
    }
}

/// An effect in a few words, with its main numbers, and who has it.
fn phrase(cause: &Cause) -> String {
    let of = |parameters: &BTreeMap<String, Value>| words(cause.effect, parameters.values().next());
    match cause.sense {
        Sense::Missing => format!("{} that the model lacks", of(&cause.parameters)),
        Sense::Superfluous => format!("{} that the sensor lacks", of(&cause.model)),
        Sense::Size => format!("{} where the model has {}", of(&cause.parameters), of(&cause.model)),
    }
}

/// An effect in a few words, with its main numbers.
fn words(effect: &str, first: Option<&Value>) -> String {
    let (of, count) = match first {
        Some(Value::Array(list)) => (list.first(), list.len()),
        other => (other, 1),
    };
    let number = |name: &str| of.and_then(|of| of.get(name)).and_then(Value::as_f64);
    let more = if count > 1 { format!(" and {} more", count - 1) } else { String::new() };
    let with = |name: &str, unit: &str| number(name).map_or_else(String::new, |value| format!("{value:.3e}{unit}"));
    match effect {
        "tone" => format!(
            "a {:.3} Hz tone of {:.2e}{more}",
            number("frequency_hz").unwrap_or_default(),
            number("amplitude").unwrap_or_default()
        ),
        "comb" => format!("a comb of {:.3} Hz{more}", number("fundamental_hz").unwrap_or_default()),
        "resonance" => format!(
            "a band of vibration at {:.2} Hz, {:.2} Hz wide{more}",
            number("frequency_hz").unwrap_or_default(),
            number("bandwidth_hz").unwrap_or_default()
        ),
        "resolution" => format!("values in steps of {}", with("step", "")),
        "rate_ramp" => format!("a drift of {}", with("R", " a second")),
        "warm_up" => format!("a warm-up of {} in {}", with("amplitude", ""), with("tau_s", " s")),
        "bias_step" => format!("a step of {} at {:.1} s{more}", with("size", ""), number("at_s").unwrap_or_default()),
        "temperature_bias" => format!("a level that moves by {} per °C", with("per_c", "")),
        "low_pass" => format!("a low-pass filter at {:.2} Hz", number("cutoff_hz").unwrap_or_default()),
        "held_samples" => format!("samples sent twice, {} of all,", with("probability", "")),
        other => other.replace('_', " "),
    }
}
