//! Told: what a model says of an effect that it has, as the sensor has it, at another size, or elsewhere.

use super::class::Sense;
use super::draw::Draw;
use super::impose::Effect;
use super::key::TrueEffect;
use super::kind::Kind;
use super::limit::LOUDEST;
use super::report::entries;
use super::setting::Setting;
use crate::simulator::SensorModel;
use serde_json::Value;
use statrs::function::erf::erfc_inv;
use std::collections::BTreeMap;

/// Factors between a size that a model has and the sensor's, to either side.
const OFF: [f64; 2] = [1.5, 30.0];

/// By channel, in the contract's form, what a model says, and the factor between the model's size and the sensor's; `None` of what is not
/// in the model, or what no model can say.
#[must_use]
pub fn told(
    effect: &Effect,
    sense: Sense,
    setting: &Setting,
    draw: &mut Draw,
) -> Option<(BTreeMap<String, Value>, f64)> {
    if !sense.is_in_model() || effect.kind.effect().is_none() {
        return None;
    }
    let length_s = setting.length_s();
    let (mut factor, shift) = (draw.log_uniform(OFF[0], OFF[1]), draw.uniform(0.15, 0.4));
    if draw.chance(0.5) {
        factor = 1.0 / factor;
    }
    let change = |entry: &Value, factor: f64| match sense {
        Sense::Size => each(entry, |one| resized(effect.kind, one, factor, setting.rate_hz)),
        Sense::Elsewhere => each(entry, |one| moved(one, shift, setting.rate_hz, length_s)),
        _ => entry.clone(),
    };
    // Where a size cannot grow any more, it shrinks.
    if sense == Sense::Size && effect.parameters.values().any(|entry| change(entry, factor) == *entry) {
        factor = 1.0 / factor;
    }
    let of = |(channel, entry): (&String, &Value)| (channel.clone(), change(entry, factor));
    let mut told: BTreeMap<String, Value> = effect.parameters.iter().map(of).collect();
    if effect.kind == Kind::Saturation {
        for part in &setting.parts {
            if let Some(entry) = told.get_mut(part.channel.name()) {
                *entry = limits(entry, part.level, part.white(setting.rate_hz));
            }
        }
    }
    Some((told, factor))
}

/// How far above its limit the difference of two sizes is, of an effect that is itself so far above: in what adds up it is the
/// difference, in what is counted the nats of two rates.
#[must_use]
pub fn over_limit(kind: Kind, over: f64, factor: f64) -> f64 {
    match kind {
        // Poisson's divergence per event, of which the limit has about three; eight nats a limit.
        Kind::Spikes | Kind::HeldSamples | Kind::Saturation => 0.4 * over * (factor - 1.0 - factor.ln()),
        Kind::LowPass | Kind::MovingAverage => over,
        _ => over * (factor - 1.0).abs(),
    }
}

/// Every object of an entry that is one or a list.
fn each(entry: &Value, change: impl Fn(&Value) -> Value) -> Value {
    match entry {
        Value::Array(list) => list.iter().map(change).collect(),
        one => change(one),
    }
}

fn resized(kind: Kind, entry: &Value, factor: f64, rate_hz: f64) -> Value {
    let mut made = entry.clone();
    let mut change = |name: &str, by: &dyn Fn(f64) -> f64| {
        if let Some(value) = entry[name].as_f64() {
            made[name] = by(value).into();
        }
    };
    let times = |value: f64| factor * value;
    match kind {
        Kind::Resolution => change("step", &|step| times(step)),
        Kind::QuantizationNoise => change("Q", &times),
        Kind::RateRamp => change("R", &times),
        Kind::GaussMarkov | Kind::Resonance | Kind::Bursts => change("sigma", &times),
        Kind::Tone | Kind::WarmUp => change("amplitude", &times),
        Kind::TemperatureBias | Kind::VariancePerC => change("per_c", &times),
        Kind::Spikes => change("rate_hz", &|rate| times(rate).min(0.05 * rate_hz)),
        Kind::HeavyTails => change("degrees_of_freedom", &|degrees| (degrees / factor).max(2.5)),
        Kind::BiasStep => change("size", &times),
        Kind::VarianceInterval => change("factor", &|of| power(of, factor)),
        Kind::LowPass => change("cutoff_hz", &|corner| times(corner).clamp(0.002 * rate_hz, 0.45 * rate_hz)),
        Kind::HeldSamples => change("probability", &|probability| times(probability).min(0.3)),
        Kind::Saturation => change("share", &|share| times(share).min(0.2)),
        Kind::Timing => {
            change("jitter_s", &|jitter| times(jitter).min(0.2 / rate_hz));
            change("drop_probability", &|lost| times(lost).min(0.2));
        }
        Kind::MovingAverage => {
            let window = entry["window"].as_u64().unwrap_or(2) as f64;
            made["window"] = ((window * factor).round().clamp(1.0, 200.0) as u64).into();
        }
        Kind::Comb => made["amplitudes"] = numbers(&entry["amplitudes"]).into_iter().map(times).collect(),
        Kind::VarianceProfile => {
            let point = |point: &Value| -> Value {
                let of = numbers(point);
                match of.as_slice() {
                    [time, of] => vec![*time, power(*of, factor)].into(),
                    _ => point.clone(),
                }
            };
            made["profile"] =
                entry["profile"].as_array().map(|list| list.iter().map(point).collect()).unwrap_or_default();
        }
        _ => {}
    }
    made
}

/// A factor on an amplitude whose logarithm is so many times larger.
fn power(of: f64, factor: f64) -> f64 {
    (factor * of.ln()).clamp(-LOUDEST.ln(), LOUDEST.ln()).exp()
}

/// The same at another frequency or time: `shift` in parts of the band or of the record, round about.
fn moved(entry: &Value, shift: f64, rate_hz: f64, length_s: f64) -> Value {
    let mut made = entry.clone();
    let band_hz = 0.5 * rate_hz;
    for name in ["frequency_hz", "fundamental_hz"] {
        if let Some(hz) = entry[name].as_f64() {
            // Of a comb all harmonics have to stay below half the rate.
            let harmonics = entry["amplitudes"].as_array().map_or(1, Vec::len) as f64;
            let room = 0.98 * band_hz / harmonics;
            let to = hz + shift * room;
            made[name] = (if to < room { to } else { (to - room).max(0.02 * room) }).into();
        }
    }
    if let Some(at) = entry["at_s"].as_f64() {
        made["at_s"] = ((at + shift * length_s) % length_s).into();
    }
    if let (Some(from), Some(to)) = (entry["from_s"].as_f64(), entry["to_s"].as_f64()) {
        let [from, to] = round_about([from, to], shift, length_s);
        made["from_s"] = from.into();
        made["to_s"] = to.into();
    }
    if let Some(list) = entry["intervals"].as_array() {
        let mut intervals: Vec<[f64; 2]> = list
            .iter()
            .filter_map(|one| Some(round_about([one[0].as_f64()?, one[1].as_f64()?], shift, length_s)))
            .collect();
        intervals.sort_by(|one, other| one[0].total_cmp(&other[0]));
        made["intervals"] = intervals.into_iter().map(Vec::from).map(Value::from).collect();
    }
    made
}

/// An interval moved by a part of the record; what would reach beyond the end is that much earlier.
fn round_about([from, to]: [f64; 2], shift: f64, length_s: f64) -> [f64; 2] {
    let long = to - from;
    let begin = (from + shift * length_s) % (length_s - long).max(0.01 * length_s);
    [begin, (begin + long).min(length_s)]
}

/// A limit that no sample reaches, in σ.
const NO_LIMIT: f64 = 1e3;

/// Limits that a share of normal samples is beyond; the contract has two, of which one may be far away.
fn limits(entry: &Value, level: f64, white: f64) -> Value {
    let share = entry["share"].as_f64().unwrap_or(0.01);
    let far = std::f64::consts::SQRT_2 * erfc_inv(2.0 * share) * white;
    let end = |side: &str, sign: f64| {
        let off = if entry[side] == true { far } else { NO_LIMIT * white };
        Value::from(level + sign * off)
    };
    [("low", end("below", -1.0)), ("high", end("above", 1.0))]
        .into_iter()
        .map(|(name, limit)| (name.to_owned(), limit))
        .collect()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().into_iter().flatten().filter_map(Value::as_f64).collect()
}

/// A model with what is told of these effects besides what it has; levels are stated where limits or steps are absolute.
/// `None` where the model's format cannot say it.
#[must_use]
pub fn with<'a>(
    model: &SensorModel,
    effects: impl IntoIterator<Item = (&'a TrueEffect, &'a BTreeMap<String, Value>)>,
    level: impl Fn(&str) -> Option<f64>,
) -> Option<SensorModel> {
    let mut value = serde_json::to_value(model).ok()?;
    for (effect, told) in effects {
        let name = effect.effect.as_ref()?;
        for (channel, told) in told {
            let of = value.get_mut("channels")?.get_mut(channel)?.as_object_mut()?;
            if matches!(effect.kind, Kind::Saturation | Kind::Resolution)
                && !of.get("bias").is_some_and(Value::is_number)
                && let Some(level) = level(channel)
            {
                of.insert("bias".to_owned(), level.into());
            }
            let list = of.entry("effects").or_insert_with(|| Value::Array(Vec::new())).as_array_mut()?;
            for one in entries(told) {
                let mut one = one.as_object()?.clone();
                one.insert("effect".to_owned(), name.as_str().into());
                list.push(Value::Object(one));
            }
        }
    }
    SensorModel::from_value(&value, "case").ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trial::case::Case;
    use crate::trial::recipe::Recipe;

    #[test]
    fn every_effect_can_be_too_much_and_at_another_size_or_place() {
        for (number, kind) in Kind::LIBRARY.iter().copied().enumerate() {
            for (sense, may) in [
                (Sense::Superfluous, true),
                (Sense::Size, kind.can_be_resized()),
                (Sense::Elsewhere, kind.can_be_elsewhere()),
                (Sense::Known, kind.can_be_known()),
            ] {
                for seed in 0..if may { 4 } else { 0 } {
                    let case = Case::make(seed, number, &Recipe::of_model(kind, sense), Some(20_000)).unwrap();
                    let (key, model) = (case.key(), case.model());
                    assert!(model.check(key.rate_hz).is_ok(), "{kind} {sense:?}: {:?}", model.check(key.rate_hz));
                    let effect = &key.effects[0];
                    let differs = effect.told.as_ref() != Some(&effect.parameters);
                    assert_eq!(
                        differs,
                        sense == Sense::Size || sense == Sense::Elsewhere || kind == Kind::Saturation,
                        "{kind} {sense:?} {effect:?}"
                    );
                    let said: usize = model.channels.values().map(|of| of.effects.len()).sum();
                    assert!(said >= effect.channels.len(), "{kind} {sense:?}");
                }
            }
        }
    }

    #[test]
    fn limits_are_where_the_share_is_beyond() {
        let made = limits(&serde_json::json!({"share": 0.022_750_132, "above": true, "below": false}), 1.0, 0.5);
        assert!((made["high"].as_f64().unwrap() - 2.0).abs() < 1e-6 && made["low"].as_f64() < Some(-100.0), "{made}");
    }

    #[test]
    fn a_small_difference_of_size_is_below_the_limit() {
        assert!((over_limit(Kind::Tone, 10.0, 1.5) - 5.0).abs() < 1e-12);
        assert!(over_limit(Kind::Spikes, 5.0, 1.5) < 0.5 && over_limit(Kind::Spikes, 50.0, 10.0) > 50.0);
    }
}
