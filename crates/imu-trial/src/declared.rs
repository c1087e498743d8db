//! Declared: a model's statement of an effect: with the right numbers, another size, or another place.

use super::class::Sense;
use super::draw::Draw;
use super::fit::{covered, intervals};
use super::impose::Effect;
use super::key::TrueEffect;
use super::kind::Kind;
use super::limit::{LOUDEST, UNEVEN, limit, most};
use super::report::entries;
use super::setting::{Part, Setting};
use imu_model::simulator::SensorModel;
use serde_json::Value;
use statrs::function::erf::erfc_inv;
use std::collections::BTreeMap;

/// Factors between the model's size and the sensor's, in either direction, and the smallest factor if the size meets a
/// bound.
const OFF: [f64; 2] = [1.5, 30.0];
const LEFT: f64 = 1.3;
/// The distance of another place, as a part of the band or of the record, which are treated as a circle.
const SHIFT: [f64; 2] = [0.15, 0.85];
/// Maximum number of draws of a size or a place.
const TRIES: usize = 400;

/// Returns the statement of a model that has the effect, by channel in the documented form, and the factor by which the
/// effect is larger there than in the sensor; `None` if no model can state it.
pub fn declared(
    effect: &Effect,
    sense: Sense,
    setting: &Setting,
    draw: &mut Draw,
) -> Option<(BTreeMap<String, Value>, f64)> {
    effect.kind.effect()?;
    let mut tries = (0..TRIES).map(|_| drawn(effect, sense, setting, draw));
    let (mut declared, factor) = tries.find(|(declared, factor)| match sense {
        Sense::Size => factor.ln().abs() >= LEFT.ln(),
        Sense::Elsewhere => are_apart(&effect.parameters, declared),
        _ => true,
    })?;
    if effect.kind == Kind::Saturation {
        for part in &setting.parts {
            if let Some(entry) = declared.get_mut(part.channel.name()) {
                *entry = limits(entry, part.level, part.white(setting.rate_hz));
            }
        }
    }
    Some((declared, factor))
}

/// Draws a model's statement, and the factor by which the resulting size is larger than the sensor's.
fn drawn(effect: &Effect, sense: Sense, setting: &Setting, draw: &mut Draw) -> (BTreeMap<String, Value>, f64) {
    let (kind, larger, shift) = (effect.kind, draw.log_uniform(OFF[0], OFF[1]), draw.uniform(SHIFT[0], SHIFT[1]));
    let factor = if draw.chance(0.5) { larger } else { 1.0 / larger };
    let change = |channel: &str, one: &Value| match sense {
        Sense::Size => {
            let part = setting.parts.iter().find(|part| part.channel.name() == channel);
            part.map_or_else(|| one.clone(), |part| resized(kind, one, factor, setting, part))
        }
        Sense::Elsewhere => moved(one, shift, setting.rate_hz, setting.length_s()),
        _ => one.clone(),
    };
    let of = |(channel, entry): (&String, &Value)| (channel.clone(), each(entry, |one| change(channel, one)));
    let declared: BTreeMap<String, Value> = effect.parameters.iter().map(of).collect();
    let factors = effect.parameters.iter().map(|(channel, entry)| grown(kind, entry, &declared[channel]));
    let least = factors.min_by(|one, other| one.ln().abs().total_cmp(&other.ln().abs()));
    (declared, least.unwrap_or(1.0))
}

/// Returns the factor by which the size of an entry is larger in the statement; for several numbers, that of the one
/// that changed least.
fn grown(kind: Kind, before: &Value, made: &Value) -> f64 {
    let size = |number: f64| match kind {
        Kind::HeavyTails | Kind::LowPass => 1.0 / number,
        Kind::VarianceInterval | Kind::VarianceProfile => number.ln(),
        _ => number,
    };
    let changed = numbers(before).into_iter().zip(numbers(made)).filter(|(before, made)| before != made);
    let factors = changed.map(|(before, made)| size(made) / size(before));
    factors.min_by(|one, other| one.ln().abs().total_cmp(&other.ln().abs())).unwrap_or(1.0)
}

/// Returns whether the stretches of two statements share less than half of the shorter one; true for effects without
/// stretches.
fn are_apart(one: &BTreeMap<String, Value>, other: &BTreeMap<String, Value>) -> bool {
    one.iter().all(|(channel, entry)| {
        let (own, its) = (intervals(entries(entry)), intervals(entries(&other[channel])));
        let long = |set: &[[f64; 2]]| covered(set, set)[0];
        own.is_empty() || covered(&own, &its)[0] < 0.5 * long(&own).min(long(&its))
    })
}

/// Returns the ratio of the difference of two sizes to its limit, for an effect with a ratio of `over`. For additive
/// effects, this is the difference; for counted ones, the nats of two rates.
pub fn over_limit(kind: Kind, over: f64, factor: f64) -> f64 {
    match kind {
        // Poisson's divergence per event: the limit has about three events, and eight nats.
        Kind::Spikes | Kind::HeldSamples | Kind::Saturation => 0.4 * over * (factor - 1.0 - factor.ln()),
        _ => over * (factor - 1.0).abs(),
    }
}

/// Applies a change to every object of an entry, which is one object or a list.
fn each(entry: &Value, change: impl Fn(&Value) -> Value) -> Value {
    match entry {
        Value::Array(list) => list.iter().map(change).collect(),
        one => change(one),
    }
}

fn resized(kind: Kind, entry: &Value, factor: f64, setting: &Setting, part: &Part) -> Value {
    let (mut made, rate_hz) = (entry.clone(), setting.rate_hz);
    let mut change = |name: &str, by: &dyn Fn(f64) -> f64| {
        if let Some(value) = entry[name].as_f64() {
            made[name] = by(value).into();
        }
    };
    let times = |value: f64| factor * value;
    // At most as large as a sensor has it.
    let largest = match kind {
        Kind::Bursts => LOUDEST,
        Kind::VariancePerC => {
            0.5 * most(kind, setting.samples) * limit(kind, setting.samples)
                / setting.temperature.map_or(1.0, |of| of.spread_c())
        }
        _ => most(kind, setting.samples) * limit(kind, setting.samples),
    };
    let unit = if kind == Kind::VariancePerC { 1.0 } else { part.white(rate_hz) };
    let bounded = |value: f64| times(value).clamp(-UNEVEN * largest * unit, UNEVEN * largest * unit);
    match kind {
        Kind::Resolution => change("step", &bounded),
        Kind::QuantizationNoise => change("Q", &times),
        Kind::RateRamp => change("R", &times),
        Kind::GaussMarkov | Kind::Resonance | Kind::Bursts => change("sigma", &bounded),
        Kind::Tone | Kind::WarmUp => change("amplitude", &times),
        Kind::TemperatureBias | Kind::VariancePerC => change("per_c", &bounded),
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
            made["window"] = (times(window).round().clamp(2.0, 200.0) as u64).into();
        }
        Kind::Comb => made["amplitudes"] = numbers(&entry["amplitudes"]).into_iter().map(times).collect(),
        Kind::VarianceProfile => {
            let points = numbers(&entry["profile"]);
            let loudest = points.chunks_exact(2).map(|point| point[1].ln().abs()).fold(0.0, f64::max);
            let factor = factor.min(LOUDEST.ln() / loudest);
            let point = |point: &[f64]| Value::from(vec![point[0], power(point[1], factor)]);
            made["profile"] = points.chunks_exact(2).map(point).collect();
        }
        _ => {}
    }
    made
}

/// Returns a factor on an amplitude, with its logarithm multiplied by `factor`.
fn power(of: f64, factor: f64) -> f64 {
    (factor * of.ln()).clamp(-LOUDEST.ln(), LOUDEST.ln()).exp()
}

/// Returns the effect at another frequency or time: `shift` is a part of the band or of the record, which are treated
/// as a circle.
fn moved(entry: &Value, shift: f64, rate_hz: f64, length_s: f64) -> Value {
    let mut made = entry.clone();
    let band_hz = 0.5 * rate_hz;
    for name in ["frequency_hz", "fundamental_hz"] {
        if let Some(hz) = entry[name].as_f64() {
            // All harmonics of a comb have to stay below half the rate.
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

/// Returns an interval moved by a part of the record; an interval that would extend beyond the end wraps round.
fn round_about([from, to]: [f64; 2], shift: f64, length_s: f64) -> [f64; 2] {
    let long = to - from;
    let begin = (from + shift * length_s) % (length_s - long).max(0.01 * length_s);
    [begin, (begin + long).min(length_s)]
}

/// A limit that no sample reaches, in σ.
const NO_LIMIT: f64 = 1e3;

/// Returns limits that a share of normal samples exceeds; a model has two, one of which may be far away.
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

/// Returns all numbers of a value, in order.
fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(list) => list.iter().flat_map(numbers).collect(),
        Value::Object(map) => map.values().flat_map(numbers).collect(),
        other => other.as_f64().into_iter().collect(),
    }
}

/// Returns a model that states these effects besides its own. If limits or steps are absolute, the model's bias is the
/// level, because from another level no noise would reach them. `None` if the model's format cannot state it.
pub fn with<'a>(
    model: &SensorModel,
    effects: impl IntoIterator<Item = (&'a TrueEffect, &'a BTreeMap<String, Value>)>,
    level: impl Fn(&str) -> Option<f64>,
) -> Option<SensorModel> {
    let mut value = serde_json::to_value(model).ok()?;
    for (effect, declared) in effects {
        let name = effect.effect.as_ref()?;
        for (channel, declared) in declared {
            let of = value.get_mut("channels")?.get_mut(channel)?.as_object_mut()?;
            if matches!(effect.kind, Kind::Saturation | Kind::Resolution)
                && let Some(level) = level(channel)
            {
                of.insert("bias".to_owned(), level.into());
            }
            let list = of.entry("effects").or_insert_with(|| Value::Array(Vec::new())).as_array_mut()?;
            for one in entries(declared) {
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
    use crate::case::Case;
    use crate::recipe::Recipe;

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
                    let differs = effect.declared.as_ref() != Some(&effect.parameters);
                    assert_eq!(
                        differs,
                        sense == Sense::Size || sense == Sense::Elsewhere || kind == Kind::Saturation,
                        "{kind} {sense:?} {effect:?}"
                    );
                    let count: usize = model.channels.values().map(|of| of.effects.len()).sum();
                    assert!(count >= effect.channels.len(), "{kind} {sense:?}");
                }
            }
        }
    }

    fn made(kind: Kind, sense: Sense, seed: u64) -> Case {
        Case::make(seed, 1, &Recipe::of_model(kind, sense), Some(20_000)).unwrap()
    }

    #[test]
    fn another_size_is_that_of_the_model_and_no_larger_than_a_sensors() {
        for seed in 0..40 {
            for kind in Kind::LIBRARY.iter().copied().filter(|kind| kind.can_be_resized() && *kind != Kind::Saturation)
            {
                let case = made(kind, Sense::Size, seed);
                let (key, own) = (case.key(), case.effects().next().unwrap());
                let stated = key.effects[0].declared.clone().unwrap();
                let factor = stated.iter().map(|(channel, stated)| grown(kind, &own.parameters[channel], stated));
                let factor = factor.min_by(|one, other| one.ln().abs().total_cmp(&other.ln().abs())).unwrap();
                assert!(factor.ln().abs() >= LEFT.ln(), "{kind} {stated:?}");
                let over = over_limit(kind, own.over_limit, factor);
                assert!((key.effects[0].over_limit / over - 1.0).abs() < 1e-9, "{kind} {stated:?}");
                for part in &case.setting().parts {
                    let white = part.white(case.setting().rate_hz);
                    let number = |name: &str| stated.get(part.channel.name()).and_then(|entry| entry[name].as_f64());
                    assert!(number("window").is_none_or(|window| window >= 2.0), "{stated:?}");
                    assert!(number("step").is_none_or(|step| step <= 6.001 * white), "{stated:?}");
                    assert!(number("sigma").is_none_or(|sigma| sigma <= 62.51 * white), "{kind} {stated:?}");
                }
            }
        }
    }

    #[test]
    fn another_place_is_not_the_same() {
        for seed in 0..40 {
            for kind in [Kind::Bursts, Kind::VarianceInterval] {
                let key = made(kind, Sense::Elsewhere, seed).key();
                let effect = &key.effects[0];
                assert!(are_apart(&effect.parameters, effect.declared.as_ref().unwrap()), "{effect:?}");
            }
        }
        let of = |from: f64| [("gyro_x".to_owned(), serde_json::json!({"from_s": from, "to_s": from + 10.0}))].into();
        assert!(are_apart(&of(0.0), &of(6.0)) && !are_apart(&of(0.0), &of(4.0)));
    }

    #[test]
    fn a_limit_in_the_model_is_about_its_bias() {
        for seed in 0..10 {
            let case = made(Kind::Saturation, Sense::Superfluous, seed);
            for part in case
                .setting()
                .parts
                .iter()
                .filter(|part| case.key().effects[0].channels.contains(&part.channel.name().to_owned()))
            {
                assert_eq!(case.model().channels[&part.channel].bias, Some(part.level));
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
