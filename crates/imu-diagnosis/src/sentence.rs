//! Sentences: summarises a diagnosis in one sentence for a hurried reader, and again when its times are moved.

use super::report::{Cause, Diagnosis, Of, Parameter, Sense, Verdict};
use imu_model::effects::EffectKind;
use serde_json::Value;
use std::collections::BTreeMap;

impl Diagnosis {
    /// States all times relative to the capture's start. The diagnosis saw the capture from `from_s` on.
    pub fn begins_at(&mut self, from_s: f64) {
        for place in &mut self.r#where {
            place.from_s += from_s;
            place.to_s += from_s;
        }
        for cause in &mut self.causes {
            let own =
                cause.parameters.values_mut().chain(cause.model.values_mut()).chain(cause.uncertainty.values_mut());
            own.for_each(|of| cause.effect.spec().move_times(of, from_s));
        }
        self.summary = summary(self);
    }
}

/// Returns the summary: the effect or parameter that makes most of the gap comes first.
pub(super) fn summary(of: &Diagnosis) -> String {
    let nats =
        |of_what: Of| -> f64 { of.r#where.iter().filter(|place| place.of == of_what).map(|place| place.nats).sum() };
    let parts = parameters(of);
    let (largest, weight) = parts.first().map_or((None, 0.0), |(clause, nats)| (Some(clause.as_str()), *nats));
    // Among parts of the same rank a cause comes first.
    let of_cause = (0..of.causes.len()).map(|index| nats(Of::Cause(index))).fold(0.0, f64::max);
    let first = largest.filter(|_| weight > of_cause);
    let sentence = match (of.verdict, of.causes.first(), first) {
        (Verdict::NoGap, ..) => "no gap: the recording is what the model says, as far as the record shows".to_owned(),
        (Verdict::Parameters, ..) => {
            let clauses: Vec<&str> = parts.iter().take(3).map(|(clause, _)| clause.as_str()).collect();
            format!("no effect is missing, but parameters are off: {}", clauses.join("; "))
        }
        (Verdict::Effects, Some(cause), first) => {
            let further = match of.causes.len() {
                1 => String::new(),
                2 => ", beside another cause".to_owned(),
                more => format!(", beside {} other causes", more - 1),
            };
            let explained = match of.discrepancy.closed.map(|closed| 100.0 * closed.clamp(0.0, 1.0)) {
                Some(part) if of.causes.len() == 1 => format!(" explains {part:.0} % of the gap"),
                Some(part) => format!("; together they explain {part:.0} % of the gap"),
                None => String::new(),
            };
            let own = format!("{}: {}{further}{explained}", channels(cause), phrase(cause));
            match first {
                Some(clause) => {
                    let rest = if explained.is_empty() { "" } else { " that is left" };
                    format!("mostly a parameter: {clause}; then {own}{rest}")
                }
                None => own,
            }
        }
        (Verdict::UnknownEffect, cause, first) => {
            let cause = cause.map(|cause| format!("{}: {}", channels(cause), phrase(cause)));
            let known: Vec<String> = first.map(str::to_owned).into_iter().chain(cause).collect();
            match known.is_empty() {
                true => "something is there that no known effect explains".to_owned(),
                false => format!("{}; something remains that no known effect explains", known.join("; then ")),
            }
        }
        (Verdict::Effects, None, _) => "an effect is missing".to_owned(),
    };
    let hint = |about_mean: bool| {
        let mut hints = of.hints.iter().filter(|hint| hint.about.ends_with("mean") == about_mean);
        hints.next().map_or_else(String::new, |hint| format!(" ({}: {})", hint.about, hint.text))
    };
    let left = of.remainder.as_ref().filter(|_| of.verdict != Verdict::UnknownEffect);
    let left = left.map_or_else(String::new, |left| {
        let share = Some(100.0 * left.share).filter(|share| *share >= 0.05);
        let share = share.map_or_else(|| "less than 0.1 %".to_owned(), |share| format!("{share:.1} %"));
        format!("; {share} of the gap remains that no known effect explains, on {}", left.channels.join(", "))
    });
    let sentence = sentence + &left + &hint(false);
    match of.offsets.first() {
        Some(of) => {
            let (channel, capture, model, hint) = (&of.channel, of.capture, of.model, hint(true));
            format!("the mean of {channel} is {capture:.4}, the model's {model:.4}{hint}; apart from that {sentence}")
        }
        None => sentence,
    }
}

/// Returns the parameters that are off, each with its nats, the largest first; axes on which the same parameter is off
/// by about the same ratio form one entry.
fn parameters(of: &Diagnosis) -> Vec<(String, f64)> {
    /// Ratios within this distance are equal, ln.
    const SAME: f64 = 0.1;
    let mut groups: Vec<(Vec<&Parameter>, f64)> = Vec::new();
    for one in &of.parameters {
        let logarithm = |of: &Parameter| of.ratio.map(f64::ln);
        let same = |group: &&mut (Vec<&Parameter>, f64)| {
            let other = group.0[0];
            let ratios = logarithm(one).zip(logarithm(other));
            other.parameter == one.parameter && ratios.is_some_and(|(a, b)| (a - b).abs() < SAME)
        };
        match groups.iter_mut().find(same) {
            Some(group) => {
                group.0.push(one);
                group.1 += one.nats;
            }
            None => groups.push((vec![one], one.nats)),
        }
    }
    groups.sort_by(|a, b| b.1.total_cmp(&a.1));
    let clause = |group: &[&Parameter]| {
        let of = group[0];
        let names: Vec<&str> = group.iter().map(|of| of.channel.as_str()).collect();
        let name = format!("{} {}", names.join(", "), of.parameter);
        match (of.ratio, of.ci95) {
            (Some(ratio), _) => format!("{name} is {ratio:.2} times the model's"),
            (None, Some([_, high])) if of.capture == 0.0 => {
                format!("{name} is below {high:.1e}, the model has {:.1e}", of.model)
            }
            _ => format!("{name} is {:.3e} instead of 0", of.capture),
        }
    };
    groups.into_iter().map(|(group, nats)| (clause(&group), nats)).collect()
}

fn channels(cause: &Cause) -> String {
    match cause.channels.as_slice() {
        [] => "sensor".to_owned(),
        [one] => one.clone(),
        [first, .., last] if cause.channels.len() > 3 => format!("{first} to {last} ({})", cause.channels.len()),
        several => several.join(", "),
    }
}

/// Returns an effect in a few words, with its main numbers, and the side that has it.
fn phrase(cause: &Cause) -> String {
    let of = |parameters: &BTreeMap<String, Value>| words(cause.effect, parameters.values().next());
    match cause.sense {
        Sense::Missing => format!("{} that the model lacks", of(&cause.parameters)),
        Sense::Superfluous => format!("{} that the sensor lacks", of(&cause.model)),
        Sense::Size => format!("{} where the model has {}", of(&cause.parameters), of(&cause.model)),
    }
}

/// Returns an effect in a few words, with its main numbers.
fn words(effect: EffectKind, first: Option<&Value>) -> String {
    let (of, count) = match first {
        Some(Value::Array(list)) => (list.first(), list.len()),
        other => (other, 1),
    };
    let more = if count > 1 { format!(" and {} more", count - 1) } else { String::new() };
    effect.spec().phrase(of, &more)
}
