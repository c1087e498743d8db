//! Composition: what was found becomes a verdict, a report and a corrected model.

use super::diagnose::{Findings, Found, Options, Outcome};
use super::evidence::Kind;
use super::facts;
use super::holdout::BLOCKS;
use super::law::{FLOOR_MATTERS, Term};
use super::omnibus::Statistic;
use super::pairs;
use super::recording::Recording;
use super::report::{Alternative, Cause, ChannelGap, Diagnosis, Discrepancy, FORMAT, Parameter, Place, Verdict};
use super::shared::Shared;
use super::tiles::Rectangle;
use super::translate::{self, Translated, Units};
use crate::effects::timing::JITTER_MAX;
use crate::effects::{CommonMode, Effect, HeldSamples, Resolution, Saturation, Stream, StreamId, Timing};
use crate::sample::Channel;
use crate::simulator::SensorModel;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// A rounding is worth naming from this part of the white noise's standard deviation on.
const MATERIAL_STEP: f64 = 0.03;
/// A statistic that is this rare in noise alone, all of them counted, is no chance.
const REMAINS: f64 = 0.005;
/// The same on a channel of which nothing was named while others have their causes.
const REMAINS_ELSEWHERE: f64 = 1e-4;
/// A parameter is off from so many standard errors on.
const OFF: f64 = 4.0;
/// And from this part of itself on, of a rate in 10⁴.
const RATE_OFF: f64 = 1e-4;

/// An effect on a channel with what it gives.
pub(super) struct Named {
    pub(super) channel: Channel,
    pub(super) effect: Arc<dyn Effect>,
    gain: f64,
    confidence: f64,
    evidence: Vec<String>,
    /// 95 % intervals of its parameters.
    ci95: Vec<(&'static str, [f64; 2])>,
}

pub(super) fn outcome(found: &Found, real: &Recording, sim: &SensorModel, options: &Options<'_>) -> Outcome {
    let mut named: Vec<Named> = Vec::new();
    let mut notes = Vec::new();
    for of in &found.channels {
        named.extend(of_channel(of, found, sim.rate_hz));
        named.extend(of_facts(of));
    }
    named.extend(of_repeats(found, sim));
    named.extend(of_shared(found, sim));
    named.extend(of_stamps(real, sim));
    named.retain(|of| options.wants(of.effect.name()));
    for of in &mut named {
        of.evidence.extend(pairs::of_line(of.channel, &*of.effect, real.rate_hz));
    }
    if !found.further.is_empty() {
        let names: Vec<&str> = found.further.iter().map(|channel| channel.name()).collect();
        notes.push(format!("not compared, because the model does not have them: {}", names.join(", ")));
    }
    let remains = remains(found, &named);
    let parameters = parameters(found, real, sim);
    let foreign = foreign(found);
    let remains_something = remains.worst.is_some() || !foreign.is_empty();
    let verdict = match (remains_something, named.is_empty(), parameters.iter().any(|of| of.parameter != "bias")) {
        (true, ..) => Verdict::UnknownEffect,
        (false, false, _) => Verdict::Effects,
        (false, true, true) => Verdict::Parameters,
        (false, true, false) => Verdict::NoGap,
    };
    let discrepancy = discrepancy(found, &named, remains.p_value);
    let total: f64 = named.iter().filter(|of| !is_fact(of)).map(|of| of.gain).sum();
    let causes = causes(&named, total, discrepancy.closed);
    let alternatives = alternatives(found, &named);
    let places = places(found, &named, verdict);
    notes.extend(foreign);
    for of in found.channels.iter().filter(|of| !open_filters(of).is_empty()) {
        notes.push(format!(
            "{}: there is white noise behind the filter, which no effect describes; the corrected model leaves the filter out",
            of.prepared.channel
        ));
    }
    if let Some((channel, statistic)) = remains.worst {
        notes.push(format!("what remains on {channel}: {}", statistic.meaning()));
    }
    notes.extend(pairs::notes(found, &named, real));
    let augmented = augmented(found, sim, &named);
    let per_channel = found.channels.iter().map(|of| {
        let samples = of.scores.samples as f64;
        let sum = |blocks: &[f64]| blocks.iter().sum::<f64>();
        let gap = |blocks: &[f64]| (sum(&of.scores.ceiling) - sum(blocks)) / samples;
        let floor = 0.5 * of.scores.numbers as f64 / samples;
        let gap = ChannelGap { before: gap(&of.scores.declared), after: gap(&of.scores.effects), floor };
        (of.prepared.channel.name().to_owned(), gap)
    });
    let mut diagnosis = Diagnosis {
        format: FORMAT,
        verdict,
        summary: String::new(),
        discrepancy,
        r#where: places,
        parameters,
        causes,
        alternatives,
        per_channel: per_channel.collect(),
        notes,
        software: options.software.to_owned(),
        inputs: [("real", options.real.to_owned()), ("sim", options.sim.to_owned())].into(),
    };
    diagnosis.summary = super::sentence::summary(&diagnosis);
    Outcome { diagnosis, augmented }
}

/// What the search found on a channel.
fn of_channel(of: &Findings, found: &Found, rate_hz: f64) -> Vec<Named> {
    let units = Units {
        prepared: &of.prepared,
        rate_hz,
        samples: found.samples,
        temperature_c: found.temperature_c,
        average_variance: of.average_variance,
    };
    let effects = translate::effects(&of.explanation, &of.spread, units);
    let same = |kind: Kind| of.steps.iter().filter(move |step| step.kind == kind);
    effects
        .iter()
        .map(|Translated { kind, effect, ci95 }| {
            let several = effects.iter().filter(|other| other.kind == *kind).count().max(1) as f64;
            let gain = same(*kind).map(|step| step.gain).sum::<f64>() / several;
            let margin = same(*kind)
                .map(|step| {
                    let score = step.gain - step.price;
                    let next = step.others.iter().find(|(other, _)| other.effect() != kind.effect());
                    next.map_or(score, |(_, other)| score - other)
                })
                .fold(f64::NEG_INFINITY, f64::max);
            let mut evidence = Vec::new();
            for step in same(*kind) {
                evidence.push(format!(
                    "{}: {:.0} nats ({:.2e} a sample) more with {} than without, the noise fitted anew; chance gives {:.0}",
                    of.prepared.channel,
                    step.gain,
                    step.gain / found.samples as f64,
                    effect.name(),
                    step.price,
                ));
            }
            let confidence = 1.0 / (1.0 + (-margin.clamp(-30.0, 30.0)).exp());
            Named { channel: of.prepared.channel, effect: effect.clone(), gain, confidence, evidence, ci95: ci95.clone() }
        })
        .collect()
}

/// What the values show by themselves.
fn of_facts(of: &Findings) -> Vec<Named> {
    let mut named = Vec::new();
    let channel = of.prepared.channel;
    let facts = of.prepared.facts;
    let mut add = |effect: Arc<dyn Effect>, gain: f64, evidence: String| {
        named.push(Named { channel, effect, gain, confidence: 0.999, evidence: vec![evidence], ci95: Vec::new() });
    };
    if let Some(step) = facts.step
        && step > MATERIAL_STEP * of.white
        && !of.prepared.has.contains(&"resolution")
    {
        let ratio = step / of.white;
        add(
            Arc::new(Resolution { step }),
            of.prepared.samples.len() as f64 * (1.0 + ratio * ratio / 12.0).ln() * 0.5,
            format!(
                "{channel}: all values are multiples of {step:.6e}, {ratio:.2} of the white noise's standard deviation"
            ),
        );
    }
    if (facts.low.is_some() || facts.high.is_some()) && !of.prepared.has.contains(&"saturation") {
        let cut = of.prepared.outliers.len() as f64;
        let far = 1e3 * of.prepared.scale + of.prepared.level.abs();
        add(
            Arc::new(Saturation { low: facts.low.unwrap_or(-far), high: facts.high.unwrap_or(far) }),
            4.0 * cut,
            format!("{channel}: {cut} samples stand exactly at the extreme value, apart from one another"),
        );
    }
    named
}

/// Samples that are sent again.
fn of_repeats(found: &Found, sim: &SensorModel) -> Vec<Named> {
    let mut named = Vec::new();
    for (channels, repeats) in &found.repeats {
        let has = |channel: &Channel| {
            sim.channels.get(channel).is_some_and(|model| model.effects.iter().any(|e| e.name() == "held_samples"))
        };
        if channels.iter().any(has) {
            continue;
        }
        let probability = (repeats.places.len() as f64 - repeats.expected).max(1.0) / found.samples as f64;
        for channel in channels {
            let evidence = format!(
                "{channel}: {} samples are the one before them again on all channels of the triad; chance makes {:.1}",
                repeats.places.len(),
                repeats.expected
            );
            named.push(Named {
                channel: *channel,
                effect: Arc::new(HeldSamples { probability }),
                gain: repeats.gain / channels.len() as f64,
                confidence: 0.999,
                evidence: vec![evidence],
                ci95: vec![("probability", poisson(probability, found.samples))],
            });
        }
    }
    named
}

/// Noise that channels share.
fn of_shared(found: &Found, sim: &SensorModel) -> Vec<Named> {
    let mut named = Vec::new();
    for shared in &found.shared {
        for ((index, part), error) in shared.parts.iter().zip(&shared.errors) {
            let of = &found.channels[*index];
            let has = sim.channels.get(&of.prepared.channel);
            if has.is_some_and(|model| model.effects.iter().any(|effect| effect.name() == "common_mode")) {
                return Vec::new();
            }
            named.push(Named {
                channel: of.prepared.channel,
                effect: Arc::new(CommonMode { sigma: part * of.white }),
                gain: shared.gain / shared.parts.len() as f64,
                confidence: 0.99,
                evidence: vec![format!(
                    "{}: {:.1} % of the white noise's variance is shared with other channels",
                    of.prepared.channel,
                    100.0 * part * part
                )],
                ci95: vec![("sigma", [-1.96, 1.96].map(|far| (part + far * error) * of.white))],
            });
        }
    }
    named
}

/// The 95 % interval of a chance that was met as often as it says in so many samples.
fn poisson(chance: f64, samples: usize) -> [f64; 2] {
    let count = chance * samples as f64;
    let half = 1.96 * count.max(1.0).sqrt();
    [(count - half).max(0.0) / samples as f64, ((count + half) / samples as f64).min(1.0)]
}

/// What the stamps show, where there are any.
fn stamps(real: &Recording) -> Option<facts::Stamps> {
    let there = |place: &usize| !real.missing.get(*place).copied().unwrap_or(false);
    let places: Vec<usize> = if real.time_s.len() == real.len() {
        (0..real.len()).collect()
    } else {
        (0..real.len()).filter(there).collect()
    };
    (places.len() == real.time_s.len()).then(|| facts::stamps(&real.time_s, places.into_iter())).flatten()
}

/// Stamps that scatter and samples that are missing one by one.
fn of_stamps(real: &Recording, sim: &SensorModel) -> Vec<Named> {
    /// Runs that are longer are gaps, not drops.
    const LONGEST: usize = 3;
    /// A jitter is worth naming from this part of a period on.
    const JITTER: f64 = 0.01;
    let has = sim.channels.values().any(|model| model.effects.iter().any(|effect| effect.name() == "timing"));
    let Some(first) = sim.channels.keys().next().filter(|_| !has) else { return Vec::new() };
    let (mut runs, mut dropped, mut run) = (0, 0, 0);
    for missing in real.missing.iter().copied().chain([false]) {
        if missing {
            run += 1;
        } else {
            if (1..=LONGEST).contains(&run) {
                runs += 1;
                dropped += run;
            }
            run = 0;
        }
    }
    let scatter_s = stamps(real).map_or(0.0, |stamps| stamps.jitter_s);
    let scatter_s = if scatter_s * real.rate_hz > JITTER { scatter_s } else { 0.0 };
    // A model's stamps keep their order.
    let most_s = JITTER_MAX / sim.rate_hz;
    let jitter_s = scatter_s.min(most_s);
    if runs < 3 && jitter_s == 0.0 {
        return Vec::new();
    }
    let drop_probability = if runs < 3 { 0.0 } else { dropped as f64 / real.len() as f64 };
    let mut evidence = Vec::new();
    if jitter_s > 0.0 {
        let more =
            if scatter_s > most_s { ", more than a model's may: they do not tell when samples were taken" } else { "" };
        evidence.push(format!("stamps scatter by {scatter_s:.2e} s about even steps{more}"));
    }
    if drop_probability > 0.0 {
        evidence.push(format!("{dropped} samples are missing, one by one"));
    }
    let gain = 10.0 * runs as f64 + if jitter_s > 0.0 { real.len() as f64 } else { 0.0 };
    vec![Named {
        channel: *first,
        effect: Arc::new(Timing { jitter_s, drop_probability }),
        gain,
        confidence: 0.99,
        evidence,
        ci95: [("jitter_s", jitter_s), ("drop_probability", drop_probability)]
            .into_iter()
            .filter(|(_, value)| *value > 0.0)
            .map(|(name, value)| {
                let half = 1.96 * value / (2.0 * real.len() as f64).sqrt();
                let ends = if name == "jitter_s" { [value - half, value + half] } else { poisson(value, real.len()) };
                (name, ends)
            })
            .collect(),
    }]
}

/// What remains.
struct Remains {
    worst: Option<(Channel, Statistic)>,
    p_value: f64,
}

fn remains(found: &Found, named: &[Named]) -> Remains {
    let count = (Statistic::ALL.len() * found.channels.len()).max(1) as f64;
    let (mut worst, mut worst_excess, mut p_value) = (None, 1.0, 1.0f64);
    for of in &found.channels {
        let own: Vec<&Named> = named.iter().filter(|one| one.channel == of.prepared.channel).collect();
        let marginal = own.iter().any(|one| {
            matches!(one.effect.name(), "spikes" | "heavy_tails" | "bursts" | "saturation" | "held_samples")
        }) || of
            .prepared
            .has
            .iter()
            .any(|name| matches!(*name, "spikes" | "heavy_tails" | "bursts" | "saturation" | "held_samples"))
            || of.prepared.step.is_some_and(|step| step > 0.6 * of.white);
        let level = if own.is_empty() && !named.is_empty() { REMAINS_ELSEWHERE } else { REMAINS };
        for (statistic, value) in &of.statistics {
            // On a lattice the value in the middle is met most.
            let lattice = of.prepared.step.is_some() && *statistic == Statistic::Atom;
            // Steps wider than the noise, and what was cut on one side, are skewed by themselves.
            let coarse = of.prepared.step.is_some_and(|step| step > 1.2 * of.white);
            let cut = of.prepared.limits.iter().any(Option::is_some) || of.prepared.has.contains(&"saturation");
            let skewed = (coarse || cut) && *statistic == Statistic::Skewness;
            if lattice || skewed || (marginal && statistic.is_marginal()) {
                continue;
            }
            // The most conspicuous of all other channels.
            let tries = if *statistic == Statistic::Crosstalk { (found.channels.len() - 1).max(1) as f64 } else { 1.0 };
            let p = (count * tries * found.tails.chance(*statistic, *value)).min(1.0);
            p_value = p_value.min(p);
            if p < level && p / level < worst_excess {
                (worst, worst_excess) = (Some((of.prepared.channel, *statistic)), p / level);
            }
        }
    }
    Remains { worst, p_value }
}

/// What explains something and is no effect of the library.
fn foreign(found: &Found) -> Vec<String> {
    let steps = found.channels.iter().flat_map(|of| of.steps.iter().map(move |step| (of.prepared.channel, step)));
    let said = |(channel, step): (Channel, &super::search::Step)| {
        let meaning = step.kind.foreign()?;
        Some(format!(
            "outside the library, on {channel}: {meaning} ({:.0} nats; chance gives {:.0})",
            step.gain, step.price
        ))
    };
    steps.filter_map(said).collect()
}

/// N, B, K and bias that are off.
fn parameters(found: &Found, real: &Recording, sim: &SensorModel) -> Vec<Parameter> {
    let mut off = Vec::new();
    for of in &found.channels {
        let Some(model) = sim.channels.get(&of.prepared.channel) else { continue };
        for (level, parameter, told) in [(0, "N", model.n), (1, "B", model.b), (2, "K", model.k)] {
            let fitted = &of.fitted;
            let Some(variance) = fitted.covariance.as_ref().map(|covariance| covariance[(level, level)]) else {
                continue;
            };
            let (found, spread) = (fitted.law.levels[level], variance.max(0.0).sqrt());
            // N is the white noise where nothing changes its variance.
            let changed = if level == 0 { of.average_variance.ln() } else { 0.0 };
            let found = found - changed;
            let shift = if level == 0 { of.prepared.white_shift } else { 0.0 };
            let capture = (0.5 * (found - shift)).exp() * of.prepared.scale;
            let declared = of.prepared.declared.levels[level];
            let certain = spread < 1.0;
            // Told with an interval or a limit that reaches the capture's, it is not off.
            let end = |sign: f64| capture * (0.5 * sign * 1.96 * spread).exp();
            let known = model.interval(parameter).or(model.upper_limit(parameter).map(|limit| [0.0, limit]));
            let within = known.is_some_and(|[low, high]| end(-1.0) <= high && end(1.0) >= low);
            if certain && !within && of.held[level] > 0.5 * OFF * OFF && (found - declared).abs() > OFF * spread {
                let ratio = (told > 0.0).then(|| capture / told);
                let ci95 = Some([end(-1.0), end(1.0)]);
                let channel = of.prepared.channel.name().to_owned();
                off.push(Parameter { channel, parameter, model: told, capture, ratio, ci95 });
            }
        }
    }
    let rate_hz = stamps(real).map_or(real.rate_hz, |stamps| stamps.rate_hz);
    if (rate_hz / sim.rate_hz - 1.0).abs() > RATE_OFF {
        off.push(Parameter {
            channel: "sensor".to_owned(),
            parameter: "rate_hz",
            model: sim.rate_hz,
            capture: rate_hz,
            ratio: Some(rate_hz / sim.rate_hz),
            ci95: None,
        });
    }
    off
}

/// How much is explained, on the half that chose no number.
fn discrepancy(found: &Found, named: &[Named], p_value_after: f64) -> Discrepancy {
    const DRAWS: usize = 1000;
    let channels = found.channels.len().max(1) as f64;
    let samples = found.channels.first().map_or(1, |of| of.scores.samples) as f64;
    let blocks = |which: fn(&Findings) -> &Vec<f64>| -> Vec<f64> {
        (0..BLOCKS).map(|block| found.channels.iter().map(|of| which(of)[block]).sum::<f64>()).collect()
    };
    let common = named.iter().any(|of| of.effect.name() == "common_mode");
    // What correlation gives is the same in every block.
    let shared: f64 = found.shared.iter().filter(|_| common).map(|shared| shared.gain).sum();
    let more = 0.5 * shared / BLOCKS as f64;
    let declared = blocks(|of| &of.scores.declared);
    let parameters = blocks(|of| &of.scores.parameters);
    let effects: Vec<f64> = blocks(|of| &of.scores.effects).into_iter().map(|sum| sum + more).collect();
    let ceiling: Vec<f64> = blocks(|of| &of.scores.ceiling).into_iter().map(|sum| sum + more).collect();
    let floor_nats: f64 = found.channels.iter().map(|of| 0.5 * of.scores.numbers as f64).sum();
    let per_sample = |nats: f64| nats / (samples * channels);
    let gap = |of: &[f64], weights: &dyn Fn(usize) -> f64| -> f64 {
        of.iter().zip(&ceiling).enumerate().map(|(block, (own, best))| weights(block) * (best - own)).sum()
    };
    let one = |_: usize| 1.0;
    let ratio = |weights: &dyn Fn(usize) -> f64| {
        let (before, after) = (gap(&parameters, weights), gap(&effects, weights));
        (before - after) / (before - floor_nats)
    };
    let before = gap(&parameters, &one);
    let something = !named.is_empty() && before > 3.0 * floor_nats + 5.0;
    let closed = something.then(|| ratio(&one)).filter(|value| value.is_finite());
    let closed_ci95 = closed.map(|_| {
        let mut stream = Stream::new(BLOCKS as u64, StreamId { owner: 0, effect: 2, instance: 0 });
        let mut draws: Vec<f64> = (0..DRAWS)
            .map(|_| {
                let mut weights = [0.0; BLOCKS];
                for _ in 0..BLOCKS {
                    let block = ((stream.uniform() * BLOCKS as f64) as usize).min(BLOCKS - 1);
                    weights[block] += 1.0;
                }
                ratio(&|block| weights[block])
            })
            .filter(|value| value.is_finite())
            .collect();
        draws.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| draws.get((share * draws.len() as f64) as usize).copied().unwrap_or(0.0);
        [at(0.025), at(0.975)]
    });
    Discrepancy {
        unit: "nats/sample",
        before: per_sample(gap(&declared, &one)),
        after_parameters: per_sample(before),
        after: per_sample(gap(&effects, &one)),
        floor: per_sample(floor_nats),
        p_value_after,
        closed,
        closed_ci95,
        measured_on: "second half, with the levels of the first; places and shapes are of the whole record".to_owned(),
    }
}

/// Whether an effect is read off the values and stamps: what it does is left out of all densities alike.
fn is_fact(of: &Named) -> bool {
    matches!(of.effect.name(), "resolution" | "saturation" | "held_samples" | "timing")
}

/// The same effect on several channels is one cause.
fn causes(named: &[Named], total: f64, closed: Option<f64>) -> Vec<Cause> {
    let mut groups: BTreeMap<&'static str, Vec<&Named>> = BTreeMap::new();
    for of in named {
        groups.entry(of.effect.name()).or_default().push(of);
    }
    let mut causes: Vec<(f64, Cause)> = groups
        .into_iter()
        .map(|(effect, group)| {
            let gain: f64 = group.iter().map(|of| of.gain).sum();
            let mut parameters: BTreeMap<String, Vec<Value>> = BTreeMap::new();
            for of in &group {
                let entry: Map<String, Value> =
                    of.effect.parameters().into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
                parameters.entry(of.channel.name().to_owned()).or_default().push(entry.into());
            }
            let mut uncertainty: Map<String, Value> = Map::new();
            for of in group.iter().filter(|of| !of.ci95.is_empty()) {
                let entry: Map<String, Value> =
                    of.ci95.iter().map(|(name, ends)| ((*name).to_owned(), serde_json::json!(ends))).collect();
                let list = uncertainty.entry(of.channel.name()).or_insert_with(|| Value::Array(Vec::new()));
                if let Value::Array(list) = list {
                    list.push(entry.into());
                }
            }
            let channels = parameters.keys().cloned().collect();
            let parameters = parameters.into_iter().map(|(channel, mut list)| {
                let only = if list.len() == 1 { list.pop() } else { None };
                (channel, only.unwrap_or(Value::Array(list)))
            });
            let confidence = group.iter().map(|of| of.confidence).fold(0.0, f64::max);
            let mut evidence: Vec<String> = group.iter().flat_map(|of| of.evidence.clone()).collect();
            let mut said = BTreeSet::new();
            evidence.retain(|sentence| said.insert(sentence.clone()));
            let cause = Cause {
                effect,
                triad: None,
                channels,
                confidence,
                closes: closed.filter(|_| group.iter().all(|of| !is_fact(of))).map(|closed| closed * gain / total),
                parameters: parameters.collect(),
                uncertainty,
                evidence,
            };
            (gain, cause)
        })
        .collect();
    causes.sort_by(|a, b| b.0.total_cmp(&a.0));
    causes.into_iter().map(|(_, cause)| cause).collect()
}

/// What was worth its price as well, at some step, and was not named.
fn alternatives(found: &Found, named: &[Named]) -> Vec<Alternative> {
    let mut best: BTreeMap<&'static str, (f64, f64, Kind, Vec<String>)> = BTreeMap::new();
    for of in &found.channels {
        for step in &of.steps {
            for (kind, score) in &step.others {
                let effect = kind.effect();
                if kind.foreign().is_some() {
                    continue;
                }
                let same = named.iter().any(|one| one.effect.name() == effect && one.channel == of.prepared.channel);
                if same || effect == step.kind.effect() {
                    continue;
                }
                let lead = step.gain - step.price - score;
                let entry = best.entry(effect).or_insert((0.0, lead, step.kind, Vec::new()));
                entry.0 += score;
                let name = of.prepared.channel.name().to_owned();
                if !entry.3.contains(&name) {
                    entry.3.push(name);
                }
            }
        }
    }
    let mut list: Vec<(f64, Alternative)> = best
        .into_iter()
        .map(|(effect, (score, lead, winner, channels))| {
            let why_not = match lead >= 0.0 {
                true => format!("{} explains {lead:.0} nats more", winner.effect()),
                false => format!("{} is simpler and explains only {:.0} nats less", winner.effect(), -lead),
            };
            (score, Alternative { effect, channels, closes: None, why_not })
        })
        .collect();
    list.sort_by(|a, b| b.0.total_cmp(&a.0));
    list.into_iter().map(|(_, of)| of).take(6).collect()
}

/// Where it lies: per channel, the rectangle of time and frequency with most of it.
fn places(found: &Found, named: &[Named], verdict: Verdict) -> Vec<Place> {
    let remaining = verdict == Verdict::UnknownEffect;
    let all: Vec<(&Findings, Rectangle, f64)> = found
        .channels
        .iter()
        .filter_map(|of| {
            let tiles = if remaining { &of.after } else { &of.before };
            let concerned = remaining || named.iter().any(|one| one.channel == of.prepared.channel);
            let rectangle = tiles.heaviest().filter(|_| concerned)?;
            Some((of, rectangle, tiles.total().max(rectangle.excess)))
        })
        .collect();
    let total: f64 = all.iter().map(|(.., total)| total.max(0.0)).sum();
    let mut places: Vec<Place> = all
        .into_iter()
        .filter(|(_, rectangle, _)| rectangle.excess > 0.02 * total && rectangle.excess > 8.0)
        .map(|(of, rectangle, _)| {
            let [low, high] = rectangle.band_hz;
            Place {
                channel: of.prepared.channel.name().to_owned(),
                band_hz: [low, high],
                // An averaging time sees about 1/(2τ).
                tau_s: [0.5 / high, 0.5 / low.max(1e-9)],
                from_s: rectangle.time_s[0],
                to_s: rectangle.time_s[1],
                temperature_c: None,
                share: (rectangle.excess / total).min(1.0),
                sign: if rectangle.ratio >= 1.0 { "real noisier" } else { "real quieter" },
            }
        })
        .collect();
    places.sort_by(|a, b| b.share.total_cmp(&a.share));
    places
}

/// Standard error of ln of a level, with no belief about it.
fn spread(of: &Findings, level: usize) -> Option<f64> {
    let variance = of.fitted.covariance.as_ref().map(|covariance| covariance[(level, level)])?;
    (variance.is_finite() && variance > 0.0).then(|| variance.sqrt())
}

/// The filters of a channel if there is so much white noise behind them that a model, which cannot have that, is better
/// without them.
fn open_filters(of: &Findings) -> Vec<Box<dyn Effect>> {
    let filters = of.explanation.law.terms.iter().filter(|term| term.is_filter());
    let open = filters.clone().filter_map(Term::floor).any(|floor| floor.ln() > FLOOR_MATTERS);
    filters.filter(|_| open).filter_map(Term::effect).collect()
}

/// The model with what was found.
fn augmented(found: &Found, sim: &SensorModel, named: &[Named]) -> SensorModel {
    let mut model = sim.clone();
    for of in &found.channels {
        let Some(channel) = model.channels.get_mut(&of.prepared.channel) else { continue };
        let level = |index: usize| (0.5 * of.explanation.law.levels[index]).exp() * of.prepared.scale;
        // The law's level is an average; the model's N is that where nothing changes the variance.
        channel.n = level(0) / of.average_variance.sqrt() / (0.5 * of.prepared.white_shift).exp();
        // Levels that are nowhere seen are none.
        let seen = |index: usize| of.explanation.law.levels[index] > [-30.0, -20.0, -34.0][index];
        channel.b = if seen(1) { level(1) } else { 0.0 };
        channel.k = if seen(2) { level(2) } else { 0.0 };
        channel.uncertainty = None;
        for (index, parameter) in [(0, "N"), (1, "B"), (2, "K")] {
            let value = [channel.n, channel.b, channel.k][index];
            if let Some(spread) = spread(of, index).filter(|spread| *spread < 1.0 && value > 0.0) {
                let factor = (0.98 * spread).exp();
                channel.set_interval(parameter, [value / factor, value * factor]);
            }
        }
        let open = open_filters(of);
        if !open.is_empty() {
            // White noise as loud as what passes the filters and what is behind them, on average over the band.
            let passed = |f: f64| open.iter().map(|effect| effect.power_gain(f, sim.rate_hz)).product::<f64>();
            let bins = 500;
            let at = |bin: i32| passed((f64::from(bin) + 0.5) / f64::from(2 * bins) * sim.rate_hz);
            let gain = (0..bins).map(at).sum::<f64>() / f64::from(bins);
            let floor: f64 = of.explanation.law.terms.iter().filter_map(Term::floor).sum();
            channel.n *= (gain + floor).sqrt();
        }
        let left_out = |one: &&Named| open.iter().any(|effect| effect.name() == one.effect.name());
        for one in named.iter().filter(|one| one.channel == of.prepared.channel && !left_out(one)) {
            if one.effect.name() == "common_mode" {
                // The first of all channels have one source, the second another: earlier sources are not this channel's.
                let with = |shared: &Shared| {
                    shared.parts.iter().any(|(index, _)| found.channels[*index].prepared.channel == one.channel)
                };
                let before = found.shared.iter().position(with).unwrap_or(0);
                (0..before).for_each(|_| channel.push_effect(Arc::new(CommonMode { sigma: 0.0 }), &[]));
            }
            channel.push_effect(one.effect.clone(), &one.ci95);
            if let Some(common) = one.effect.parameters().iter().find(|(name, _)| *name == "sigma")
                && one.effect.name() == "common_mode"
                && let Some(sigma) = common.1.as_f64()
            {
                // What is shared was part of the white noise.
                channel.n = (channel.n * channel.n - sigma * sigma / sim.rate_hz).max(0.0).sqrt();
            }
        }
    }
    model
}
