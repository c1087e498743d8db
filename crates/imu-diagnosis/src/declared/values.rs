//! Values: compares a model's statements about single samples, stamps and shared noise with the record.

use crate::censored;
use crate::facts::Stamps;
use crate::found::{Attribution, Findings, Found, MATERIAL_STEP};
use crate::prepare;
use crate::report::Sense;
use crate::shared::Part;
use imu_core::sample::Channel;
use imu_model::effects::timing::JITTER_MAX;
use imu_model::effects::{Effect, EffectKind, HeavyTails, HeldSamples, Resolution, Saturation, Spikes, Timing};
use imu_model::simulator::{ChannelModel, SensorModel};
use std::sync::Arc;

/// Nats at or above which a number is off.
const OFF: f64 = 12.0;

/// Returns a finding at the place of a model's effect that the sensor does not have, or has with other numbers.
pub(super) fn attribution(
    channel: Channel,
    declared: (usize, &Arc<dyn Effect>),
    found: Option<Arc<dyn Effect>>,
    nats: f64,
    evidence: String,
) -> Attribution {
    let (place, own) = declared;
    let sense = if found.is_some() { Sense::Size } else { Sense::Superfluous };
    Attribution {
        sense,
        declared: Some((place, own.clone())),
        confidence: 0.999,
        evidence: vec![evidence],
        ..Attribution::missing(channel, found.unwrap_or_else(|| own.clone()), nats)
    }
}

/// Returns the nats by which a count of events differs from the expected count (Poisson).
fn poisson(count: f64, expected: f64) -> f64 {
    let expected = expected.max(1e-9);
    if count > 0.0 { count * (count / expected).ln() - (count - expected) } else { expected }
}

/// Returns the effects on single samples in which a channel differs from the model's statement.
pub(crate) fn of_samples(of: &Findings, model: &ChannelModel, rate_hz: f64) -> Vec<Attribution> {
    let channel = of.prepared.channel;
    let samples = of.prepared.samples.len() as f64;
    let check = |(place, effect): (usize, &Arc<dyn Effect>)| -> Option<Attribution> {
        let number = |name: &str| effect.number(name);
        let off = |found: Option<Arc<dyn Effect>>, nats: f64, evidence: String| {
            (nats > OFF).then(|| attribution(channel, (place, effect), found, nats, evidence))
        };
        match effect.kind() {
            EffectKind::Resolution => resolution(of, number("step")?, &off),
            EffectKind::Saturation => saturation(of, [number("low")?, number("high")?], &off),
            EffectKind::Spikes => {
                let (rate, size) = (number("rate_hz")? / rate_hz, number("amplitude")? / of.white);
                // Events that hide in the noise are not evidence.
                let shown = if size > 6.0 { 1.0 } else { 0.0 };
                let found = of.explanation.spikes.filter(|law| law.rate * samples > 2.0);
                let Some(law) = found else {
                    let nats = shown * samples * rate;
                    let none = format!("{channel}: the model has {nats:.0} spikes in this time, the sensor none");
                    return off(None, nats, none);
                };
                let own = law.size * of.prepared.scale / of.white;
                let size = size.max(1e-3);
                let by_size = 0.5 * ((own / size).ln() / law.relative_error.max(0.02)).powi(2);
                let nats = poisson(law.rate * samples, rate * samples) + by_size;
                let effect = Spikes::new(law.rate * rate_hz, law.size * of.prepared.scale);
                off(Some(Arc::new(effect)), nats, format!("{channel}: spikes of another rate or size than the model's"))
            }
            EffectKind::HeavyTails => {
                let declared = number("degrees_of_freedom")?;
                let error = of.spread.tails.max((2.0 / samples).sqrt());
                let kurtosis = |degrees: f64| if degrees > 4.0 { 6.0 / (degrees - 4.0) } else { 6.0 };
                let Some(degrees) = of.explanation.tails.filter(|degrees| *degrees < 60.0) else {
                    // The fourth moment of this many samples has a standard deviation of √(24/n).
                    let nats = 0.5 * (of.spread.fourth * kurtosis(declared)).powi(2) * samples / 24.0;
                    return off(None, nats, format!("{channel}: the sensor's noise is normal, the model's is not"));
                };
                let nats = 0.5 * ((degrees / declared).ln() / error).powi(2);
                let found = HeavyTails { degrees_of_freedom: degrees };
                off(Some(Arc::new(found)), nats, format!("{channel}: tails of {degrees:.1} degrees of freedom"))
            }
            _ => None,
        }
    };
    model.effects.iter().enumerate().filter_map(check).collect()
}

type Off<'a> = dyn Fn(Option<Arc<dyn Effect>>, f64, String) -> Option<Attribution> + 'a;

fn resolution(of: &Findings, declared: f64, off: &Off<'_>) -> Option<Attribution> {
    /// Steps that are equal except for rounding in the file.
    const SAME: f64 = 1e-3;
    let channel = of.prepared.channel;
    let samples = of.prepared.samples.len() as f64;
    let found = of.prepared.facts.step.filter(|step| *step > MATERIAL_STEP * of.white);
    if found.is_some_and(|step| (step / declared - 1.0).abs() < SAME) {
        return None;
    }
    let ratio = found.unwrap_or(0.0).max(declared) / of.white;
    let nats = 0.5 * samples * (ratio * ratio / 12.0).ln_1p();
    let evidence = match found {
        Some(step) => format!("{channel}: all values are multiples of {step:.6e}, the model's of {declared:.6e}"),
        None => format!("{channel}: values are no multiples of anything, the model's of {declared:.6e}"),
    };
    off(found.map(|step| Arc::new(Resolution { step }) as Arc<dyn Effect>), nats, evidence)
}

fn saturation(of: &Findings, [low, high]: [f64; 2], off: &Off<'_>) -> Option<Attribution> {
    let prepared = &of.prepared;
    let (channel, facts) = (prepared.channel, prepared.facts);
    // A difference of a tenth of the noise does not count as another limit, and a rounded value stood up to half a step
    // away.
    let slack = (0.1 * of.white).max(0.5 * facts.step.unwrap_or(0.0));
    let values = prepared.samples.iter().map(|value| value * prepared.scale + prepared.level);
    let beyond = values.filter(|value| *value > high + slack || *value < low - slack).count();
    let differs = |found: Option<f64>, declared: f64| found.is_some_and(|found| (found - declared).abs() > slack);
    let is_other = differs(facts.low, low) || differs(facts.high, high);
    let cut = censored::at_limits(&prepared.outliers, &prepared.samples, &prepared.samples, prepared.limits).len();
    let evidence = format!("{channel}: {beyond} samples are beyond the model's limits");
    let found = (facts.low.is_some() || facts.high.is_some()).then(|| {
        let (low, high) = (facts.low.unwrap_or(low), facts.high.unwrap_or(high));
        Arc::new(Saturation { low, high }) as Arc<dyn Effect>
    });
    let nats = 4.0 * (beyond + if is_other { cut } else { 0 }) as f64;
    off(found, nats, evidence)
}

/// Reports samples that are sent again more or less often than the model states.
pub(crate) fn of_repeats(found: &Found, sim: &SensorModel) -> Vec<Attribution> {
    let samples = found.samples as f64;
    let mut all = Vec::new();
    for of in &found.channels {
        let channel = of.prepared.channel;
        let Some(model) = sim.channels.get(&channel) else { continue };
        let own = model.effects.iter().enumerate().find(|(_, effect)| effect.kind() == EffectKind::HeldSamples);
        let Some((place, effect)) = own else { continue };
        let declared = effect.number("probability").unwrap_or_default();
        let repeats = found.repeats.iter().find(|(channels, _)| channels.contains(&channel));
        let count = repeats.map_or(0.0, |(_, of)| of.sent_again().max(0.0));
        let samples = repeats.map_or(samples, |(_, of)| of.pairs as f64);
        let nats = poisson(count, declared * samples);
        if nats > OFF {
            let there =
                (count > 0.0).then(|| Arc::new(HeldSamples { probability: count / samples }) as Arc<dyn Effect>);
            let evidence = format!(
                "{channel}: {count:.0} samples are the one before them again, the model's {:.0}",
                declared * samples
            );
            all.push(attribution(channel, (place, effect), there, nats, evidence));
        }
    }
    all
}

/// Shared noise of a model's channel: place, effect, standard deviation, and share of all white noise of the channel.
type Stated<'a> = (usize, &'a Arc<dyn Effect>, f64, f64);

/// Reports noise that channels share, if it is more or less than the model states.
pub(crate) fn of_shared(found: &Found, sim: &SensorModel) -> Vec<Attribution> {
    /// If the shared part of a channel's white noise is larger than this, its size is not measured.
    const MOST: f64 = 0.9;
    let samples = found.samples as f64;
    let mut all = Vec::new();
    let declared: Vec<Option<Stated<'_>>> = found
        .channels
        .iter()
        .map(|of| {
            let model = sim.channels.get(&of.prepared.channel)?;
            // An entry of size 0 stands for a source of other channels.
            let is_shared = |effect: &Arc<dyn Effect>| {
                effect.kind() == EffectKind::CommonMode && effect.number("sigma").is_some_and(|sigma| sigma != 0.0)
            };
            let (place, effect) = model.effects.iter().enumerate().find(|(_, effect)| is_shared(effect))?;
            let sigma = effect.number("sigma")?;
            let white = prepare::white_density(model, sim.internal_rate_hz(sim.rate_hz)) * sim.rate_hz.sqrt();
            Some((place, effect, sigma, sigma / white.max(f64::MIN_POSITIVE)))
        })
        .collect();
    for (index, of) in found.channels.iter().enumerate() {
        let Some((place, effect, sigma, part)) = declared[index] else { continue };
        let own = found.shared.iter().flat_map(|shared| &shared.parts).find(|part| part.index == index);
        // The model's shares with the others: a correlation r gives −n/2·ln(1 − r²).
        let others = declared.iter().enumerate().filter(|(other, _)| *other != index);
        let most = others.filter_map(|(_, of)| of.map(|(.., part)| part.abs())).fold(0.0, f64::max);
        let expected = -0.5 * samples * (-(part * most).clamp(-0.99, 0.99).powi(2)).ln_1p();
        let channel = of.prepared.channel;
        let (there, nats, evidence) = match own {
            Some(&Part { size: found, error, .. }) => {
                if part.abs() > MOST && found.abs() > MOST {
                    continue;
                }
                let nats = 0.5 * ((found.abs() - (sigma / of.white).abs()) / error.max(1e-6)).powi(2);
                let sigma = (found.abs() * of.white).copysign(part);
                let effect: Arc<dyn Effect> = Arc::new(imu_model::effects::CommonMode { sigma });
                let share = 100.0 * found * found;
                (Some(effect), nats, format!("{channel}: {share:.1} % of the white noise's variance is shared"))
            }
            None => (None, expected, format!("{channel}: its noise is not shared with the model's other channels")),
        };
        if nats > OFF {
            all.push(attribution(channel, (place, effect), there, nats, evidence));
        }
    }
    all
}

/// Reports stamps and lost samples that differ from the model's statement.
pub(crate) fn of_stamps(stamps: Option<Stamps>, dropped: usize, samples: usize, sim: &SensorModel) -> Vec<Attribution> {
    /// Part of a period that no stamp shows.
    const LEAST: f64 = 0.01;
    let own = sim.channels.iter().filter_map(|(channel, model)| {
        let (place, effect) =
            model.effects.iter().enumerate().find(|(_, effect)| effect.kind() == EffectKind::Timing)?;
        Some((*channel, place, effect))
    });
    let own: Vec<(Channel, usize, &Arc<dyn Effect>)> = own.collect();
    let Some((.., effect)) = own.first() else { return Vec::new() };
    let declared_s = effect.number("jitter_s").unwrap_or_default();
    let declared = effect.number("drop_probability").unwrap_or_default();
    let (jitter_s, by_jitter) = match stamps {
        // Stamps that were not sent carry no information.
        None => (declared_s, 0.0),
        Some(ref stamps) => {
            let floor = LEAST / sim.rate_hz;
            let ratio = (stamps.jitter_s.max(floor) / declared_s.max(floor)).ln();
            (stamps.jitter_s, samples as f64 * ratio * ratio)
        }
    };
    // A record without stamps and gaps does not show losses.
    let shows_drops = stamps.is_some() || dropped > 0;
    let by_drops = if shows_drops { poisson(dropped as f64, declared * samples as f64) } else { 0.0 };
    let nats = by_jitter + by_drops;
    if nats <= OFF {
        return Vec::new();
    }
    let is_there = jitter_s * sim.rate_hz > LEAST || dropped > 2;
    let drop_probability = dropped as f64 / samples.max(1) as f64;
    // A model's stamps keep their order.
    let kept_s = jitter_s.min(JITTER_MAX / sim.rate_hz);
    let found = is_there.then(|| Arc::new(Timing { jitter_s: kept_s, drop_probability }) as Arc<dyn Effect>);
    let evidence = format!(
        "stamps scatter by {jitter_s:.2e} s, the model's by {declared_s:.2e} s; {dropped} samples are missing, the model's {:.0}",
        declared * samples as f64
    );
    let part = nats / own.len() as f64;
    // The effect concerns the whole sensor.
    let all = own.into_iter();
    all.map(|(channel, place, effect)| attribution(channel, (place, effect), found.clone(), part, evidence.clone()))
        .collect()
}
