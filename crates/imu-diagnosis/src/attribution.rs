//! Attributions ([`super::found::Attribution`]): effects on channels, with their gains and the source of the evidence:
//! the search, the values, or the stamps.

use super::censored;
use super::confidence::confidence;
use super::declared::{self, values};
use super::evidence::Kind;
use super::facts;
use super::found::{Attribution, Findings, Found, MATERIAL_STEP};
use super::gated;
use super::options::Options;
use super::pairs;
use super::prepare::Prepared;
use super::recording::Recording;
use super::report::Sense;
use super::shared::Part;
use super::translate::{self, Translated};
use imu_model::effects::timing::JITTER_MAX;
use imu_model::effects::{CommonMode, Effect, EffectKind, HeldSamples, Resolution, Saturation, Timing};
use imu_model::simulator::{ChannelModel, SensorModel};
use std::sync::Arc;

/// Returns every effect that was found and is looked for.
pub(super) fn all(found: &Found, real: &Recording, sim: &SensorModel, options: &Options<'_>) -> Vec<Attribution> {
    let mut attributions: Vec<Attribution> = Vec::new();
    for of in &found.channels {
        if let Some(model) = sim.channels.get(&of.prepared.channel) {
            attributions.extend(of_channel(of, found, sim, model, options.level));
            attributions.extend(declared::of_lines(of, model));
            attributions.extend(declared::of_courses(of, model));
            attributions.extend(values::of_samples(of, model, sim.rate_hz));
        }
        attributions.extend(of_facts(of));
    }
    declared::elsewhere(&mut attributions);
    attributions.extend(of_repeats(found, sim));
    attributions.extend(values::of_repeats(found, sim));
    attributions.extend(of_shared(found, sim));
    attributions.extend(values::of_shared(found, sim));
    attributions.extend(of_stamps(real, sim));
    attributions.retain(|of| options.wants(of.effect.kind()));
    for of in &mut attributions {
        of.evidence.extend(pairs::of_line(of.channel, &*of.effect, real.rate_hz));
    }
    attributions
}

/// Returns the findings of the search on a channel.
fn of_channel(of: &Findings, found: &Found, sim: &SensorModel, model: &ChannelModel, level: f64) -> Vec<Attribution> {
    let effects = translate::effects(of, found.temperature_c, sim);
    // A level that follows the temperature other than along a line is the same effect.
    let is = |step: &super::steps::Step, kind: Kind| {
        step.kind == kind || (step.kind == Kind::TemperatureCurve && kind == Kind::TemperatureBias)
    };
    let same = |kind: Kind| of.steps.iter().filter(move |step| is(step, kind) && step.has_term());
    let standing = declared::stands_for(&effects, &of.steps, model);
    let superfluous = declared::left_out(of, model, &standing, level);
    let left_out = of.prepared.gated.iter().filter(|own| of.explanation.without.contains(&own.place));
    let left_out: Vec<gated::OfModel> = left_out.copied().collect();
    let stands_for_gated = |effect: &dyn Effect| gated::stands_for(&left_out, effect, sim.rate_hz, found.samples);
    let found_here = effects
        .iter()
        .zip(&standing)
        .filter_map(|(Translated { kind, effect, ci95 }, place)| {
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
                    "{}: {:.0} nats ({:.2e} a sample) more with {} than without, the noise fitted again; chance gives {:.0}",
                    of.prepared.channel,
                    step.gain,
                    step.gain / found.samples as f64,
                    effect.name(),
                    step.price,
                ));
            }
            let place = place.or_else(|| stands_for_gated(&**effect));
            let declared = place.and_then(|place| Some((place, model.effects.get(place)?.clone())));
            if declared.as_ref().is_some_and(|(_, declared)| gated::is_as_declared(&**effect, ci95, &**declared)) {
                return None;
            }
            Some(Attribution {
                sense: if declared.is_some() { Sense::Size } else { Sense::Missing },
                declared,
                p_value: same(*kind).map(|step| step.chance(level)).fold(1.0, f64::min),
                confidence: confidence(margin),
                evidence,
                ci95: ci95.clone(),
                ..Attribution::missing(of.prepared.channel, effect.clone(), gain)
            })
        })
        .collect::<Vec<Attribution>>();
    found_here.into_iter().chain(superfluous).collect()
}

/// Returns the effects that the values show without inference.
fn of_facts(of: &Findings) -> Vec<Attribution> {
    let mut attributions = Vec::new();
    let channel = of.prepared.channel;
    let facts = of.prepared.facts;
    let mut add = |effect: Arc<dyn Effect>, gain: f64, evidence: String| {
        attributions.push(Attribution {
            confidence: 0.999,
            evidence: vec![evidence],
            ..Attribution::missing(channel, effect, gain)
        });
    };
    if let Some(step) = facts.step
        && step > MATERIAL_STEP * of.white
        && !of.prepared.has.contains(&EffectKind::Resolution)
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
    if (facts.low.is_some() || facts.high.is_some()) && !of.prepared.has.contains(&EffectKind::Saturation) {
        // Missing and held samples are left out as well, but do not count here.
        let Prepared { outliers, samples, limits, .. } = &of.prepared;
        let cut = censored::at_limits(outliers, samples, samples, *limits).len() as f64;
        let far = 1e3 * of.prepared.scale + of.prepared.level.abs();
        add(
            Arc::new(Saturation { low: facts.low.unwrap_or(-far), high: facts.high.unwrap_or(far) }),
            4.0 * cut,
            format!("{channel}: {cut} samples stand exactly at the extreme value, apart from one another"),
        );
    }
    attributions
}

fn has(model: &ChannelModel, kind: EffectKind) -> bool {
    model.effects.iter().any(|effect| effect.kind() == kind)
}

/// Reports samples that are sent again.
fn of_repeats(found: &Found, sim: &SensorModel) -> Vec<Attribution> {
    let mut attributions = Vec::new();
    for (channels, repeats) in &found.repeats {
        if channels.iter().filter_map(|channel| sim.channels.get(channel)).any(|of| has(of, EffectKind::HeldSamples)) {
            continue;
        }
        let (probability, ci95) = repeats.probability();
        for channel in channels {
            let evidence = format!(
                "{channel}: {} samples are the one before them again on all channels of the triad; chance makes {:.1}",
                repeats.places.len(),
                repeats.expected()
            );
            let gain = repeats.gain / channels.len() as f64;
            attributions.push(Attribution {
                confidence: 0.999,
                evidence: vec![evidence],
                ci95: vec![("probability", ci95)],
                ..Attribution::missing(*channel, Arc::new(HeldSamples { probability }), gain)
            });
        }
    }
    attributions
}

/// Reports noise that channels share.
fn of_shared(found: &Found, sim: &SensorModel) -> Vec<Attribution> {
    let mut attributions = Vec::new();
    for shared in &found.shared {
        for Part { index, size: part, ci95, .. } in shared.parts.iter().copied() {
            let of = &found.channels[index];
            if sim.channels.get(&of.prepared.channel).is_some_and(|model| has(model, EffectKind::CommonMode)) {
                return Vec::new();
            }
            let gain = shared.gain / shared.parts.len() as f64;
            let mut ends = ci95.map(|size| size * part.signum() * of.white);
            ends.sort_unstable_by(f64::total_cmp);
            attributions.push(Attribution {
                evidence: vec![format!(
                    "{}: {:.1} % of the white noise's variance is shared with other channels",
                    of.prepared.channel,
                    100.0 * part * part
                )],
                ci95: vec![("sigma", ends)],
                ..Attribution::missing(of.prepared.channel, Arc::new(CommonMode { sigma: part * of.white }), gain)
            });
        }
    }
    attributions
}

/// Returns the 95 % interval of a chance, given how often the event occurred in `samples` samples.
fn poisson(chance: f64, samples: usize) -> [f64; 2] {
    let count = chance * samples as f64;
    let half = 1.96 * count.max(1.0).sqrt();
    [(count - half).max(0.0) / samples as f64, ((count + half) / samples as f64).min(1.0)]
}

/// Returns the effects that the stamps show, if there are any stamps.
pub(super) fn stamps(real: &Recording) -> Option<facts::Stamps> {
    let there = |place: &usize| !real.missing.get(*place).copied().unwrap_or(false);
    let places: Vec<usize> = if real.time_s.len() == real.len() {
        (0..real.len()).collect()
    } else {
        (0..real.len()).filter(there).collect()
    };
    (places.len() == real.time_s.len()).then(|| facts::stamps(&real.time_s, places.into_iter())).flatten()
}

/// Reports stamps that scatter, and samples that are missing one by one.
fn of_stamps(real: &Recording, sim: &SensorModel) -> Vec<Attribution> {
    /// Maximum length of a drop; longer runs are gaps.
    const LONGEST: usize = 3;
    /// Minimum jitter that is named, as a part of a period.
    const JITTER: f64 = 0.01;
    let drops = real.missing.chunk_by(|a, b| a == b).filter(|run| run[0] && run.len() <= LONGEST);
    let (runs, dropped) = drops.fold((0, 0), |(runs, dropped), run| (runs + 1, dropped + run.len()));
    let stamps = stamps(real);
    if sim.channels.values().any(|model| has(model, EffectKind::Timing)) {
        return values::of_stamps(stamps, dropped, real.len(), sim);
    }
    let Some(first) = sim.channels.keys().next() else { return Vec::new() };
    let scatter_s = stamps.map_or(0.0, |stamps| stamps.jitter_s);
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
    let gain = 10.0 * f64::from(runs) + if jitter_s > 0.0 { real.len() as f64 } else { 0.0 };
    vec![Attribution {
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
        ..Attribution::missing(*first, Arc::new(Timing { jitter_s, drop_probability }), gain)
    }]
}
