//! Composition: the effects that the motion drives and the noise become one report and one corrected model.
//!
//! The gap that the motion drives is the gain of all chosen effects in the whitened samples, in nats. To measure the
//! remaining part, the chosen effects' numbers are fitted to seven blocks of time out of eight; the remaining part is
//! the part of the eighth that they do not explain. It is added to the gap of the remainder ([`crate::compose`]), which
//! is measured on its own held-out half.

use super::align::Aligned;
use super::groups::{Group, Member};
use super::lateness::Delay;
use super::noise::BLOCKS;
use super::rounds::Found;
use super::settle::{Settled, level};
use super::together::{self, Driven, Sums};
use super::{FOLDS, places, residuals};
use crate::options::Options;
use crate::outcome::Outcome;
use crate::recording::Recording;
use crate::report::{Alternative, Place, Remainder, Verdict};
use crate::response::{Candidate, Estimate, NORMAL_95, Openness, is_alike};
use imu_core::sample::Triad;
use imu_model::effects::EffectKind;
use imu_model::simulator::SensorModel;
use serde_json::{Value, json};
use statrs::distribution::{ContinuousCDF as _, StudentsT};
use std::sync::Arc;

/// The share of right causes if the choice is sure, and if an effect on the triad is outside the library.
const RIGHT: [f64; 2] = [0.99, 0.6];
/// Nats of an exact tie at the sensor's limit, as for records at rest.
const TIE: f64 = 4.0;
/// An axis is affected if it has at least this part of a cause's nats.
const CONCERNED: f64 = 0.02;
/// Part of a cause's gain that another effect has to reach to be reported.
const NEARLY: f64 = 0.3;
const ALTERNATIVES: usize = 6;

pub(super) fn outcome(
    found: &Found,
    real: &Recording,
    part: &Recording,
    aligned: &Aligned,
    sim: &SensorModel,
    options: &Options<'_>,
) -> Outcome {
    let mut diagnosis = found.rest.diagnosis.clone();
    let from_s = aligned.from as f64 / real.rate_hz;
    if from_s > 0.0 {
        diagnosis.begins_at(from_s);
    }
    let channels = diagnosis.per_channel.len().max(1) as f64;
    let samples = part.len() as f64;
    let mut driven: Vec<Driven> = Vec::new();
    let mut sums = Sums { whole: vec![0.0; BLOCKS], closed: vec![0.0; BLOCKS], numbers: 0 };
    let mut located: Vec<Place> = Vec::new();
    let mut alternatives: Vec<Alternative> = Vec::new();
    let mut outside = Vec::new();
    for of in &found.triads {
        let late = found.lateness.latencies.iter().find(|(delay, _)| delay.triad == of.triad);
        let before = driven.len();
        driven.extend(of_groups(of, samples));
        driven.extend(
            late.filter(|_| options.wants(EffectKind::Latency)).map(|(delay, nats)| latency(of, *delay, *nats, found)),
        );
        driven.extend(saturation(of).filter(|_| options.wants(EffectKind::Saturation)));
        alternatives.extend(weighed(of));
        located.extend(places::places(
            of,
            level(sim, of.triad),
            late.is_some(),
            &aligned.motions,
            part.rate_hz,
            from_s,
        ));
        let numbers = sums.numbers;
        let own = add(&mut sums, of, late.is_some());
        let floor = 0.5 * (sums.numbers - numbers) as f64 / 3.0;
        for (channel, [whole, left]) in of.triad.channels().into_iter().zip(own) {
            if let Some(gap) = diagnosis.per_channel.get_mut(channel.name()) {
                gap.before += whole / samples;
                gap.after += left / samples;
                gap.floor += floor / samples;
            }
        }
        for (_, foreign) in of.foreign() {
            outside.push(format!("outside the library: the {} {}", of.triad.name(), foreign.meaning()));
        }
        if of.foreign().next().is_some() {
            driven[before..].iter_mut().for_each(|one| one.cause.confidence *= RIGHT[1] / RIGHT[0]);
        }
    }
    let measured =
        format!("held-out blocks: of what the motion drives each eighth of {BLOCKS} with the numbers of the others");
    together::join(&mut diagnosis, &sums, &mut driven, located, samples * channels, &measured);
    diagnosis.alternatives = alternatives.into_iter().chain(diagnosis.alternatives).take(ALTERNATIVES).collect();
    let remains = |of: &Remainder| of.share > options.unknown_above;
    diagnosis.verdict = match (outside.is_empty(), diagnosis.verdict) {
        (false, _) => Verdict::UnknownEffect,
        (true, Verdict::UnknownEffect) if diagnosis.remainder.as_ref().is_none_or(remains) => Verdict::UnknownEffect,
        _ if !diagnosis.causes.is_empty() => Verdict::Effects,
        (_, verdict) => verdict,
    };
    if !outside.is_empty() {
        diagnosis.discrepancy.p_value_after = diagnosis.discrepancy.p_value_after.min(options.level);
    }
    let notes = std::mem::take(&mut diagnosis.notes);
    diagnosis.notes = outside.into_iter().chain(of_clock(found, aligned, real, part)).collect();
    diagnosis.notes.extend(left_open(found));
    diagnosis.notes.extend(notes);
    diagnosis.inputs.insert("reference".into(), "a motion".to_owned());
    diagnosis.summary = crate::sentence::summary(&diagnosis);
    let mut augmented = found.rest.augmented.clone();
    augmented.triads = together::corrected(sim, &driven);
    let residuals = found.triads.iter().flat_map(|of| {
        let sent = of.triad.channels().map(|channel| part.values(channel).unwrap_or_default());
        residuals::residuals(of, sim, sent, &aligned.motions, part.rate_hz, from_s)
    });
    Outcome { diagnosis, augmented, residuals: residuals.collect(), rest: None }
}

/// Returns the effects of the library that were chosen on a triad.
fn of_groups(of: &Settled, samples: f64) -> Vec<Driven> {
    let weighing = of.weighing();
    let own = &of.choice.groups;
    let columns = weighing.columns(own);
    let (_, numbers) = of.screen.gain(&columns);
    let mut all = Vec::new();
    for (place, group) in of.chosen() {
        let Member::Library(candidate) = group.member else { continue };
        let Some(fitted) = of.fit.fitted.iter().find(|one| is_alike(&*candidate.make(&[]), &*one.effect)) else {
            continue;
        };
        let rest: Vec<usize> = own.iter().copied().filter(|other| *other != place).collect();
        let gain = weighing.gain(own) - weighing.gain(&rest);
        let (margin, _) = weighing.margin(own, place);
        let mine: Vec<(usize, f64)> =
            columns.iter().copied().zip(numbers.iter().copied()).filter(|(of, _)| group.columns.contains(of)).collect();
        let (at, by): (Vec<usize>, Vec<f64>) = mine.into_iter().unzip();
        let nats = of.screen.by_axis(&at, &by);
        let least = CONCERNED * nats.iter().sum::<f64>();
        let concerned = |axis: &usize| nats[*axis] > least;
        let channels: Vec<String> =
            (0..3).filter(concerned).map(|axis| of.triad.channels()[axis].name().to_owned()).collect();
        let estimates = &of.fit.estimates[fitted.places.clone()];
        let mut evidence = vec![format!(
            "{}: {gain:.0} nats ({:.2e} a sample) more with {} than without, all else fitted again; chance gives {:.0}",
            of.triad.name(),
            gain / samples,
            called(candidate),
            group.price
        )];
        evidence.extend(of_estimates(estimates));
        if estimates.iter().any(|one| one.known != 0.0) {
            let stated: Vec<String> =
                estimates.iter().map(|one| format!("{} {:.3e}", one.parameter, one.known)).collect();
            evidence.push(format!("the model has {} already, with {}", called(candidate), stated.join(", ")));
        }
        let wide = match candidate {
            Candidate::Bias => student(of.mean_freedom),
            _ => 1.0,
        };
        let confidence = RIGHT[0] / (1.0 + (-margin.clamp(-30.0, 30.0)).exp());
        let uncertainty = uncertainty(candidate, estimates, wide);
        let effect = Arc::clone(&fitted.effect);
        all.push(Driven::new(of.triad, effect, Some(gain), channels, confidence, uncertainty, evidence));
    }
    all
}

fn called(candidate: Candidate) -> String {
    format!("{}{}", candidate.form(), candidate.kind())
}

/// Returns a text such as "x 2.0e-3 ± 3e-5, 67 standard errors".
fn of_estimates(estimates: &[Estimate]) -> Option<String> {
    let texts: Vec<String> = estimates
        .iter()
        .filter_map(|one| {
            let error = one.standard_error.filter(|error| *error > 0.0)?;
            let far = (one.value - one.known).abs() / error;
            (far > 3.0).then(|| format!("{} {:.3e} ± {error:.1e} ({far:.0} standard errors)", one.parameter, one.value))
        })
        .collect();
    (!texts.is_empty()).then(|| texts.join("; "))
}

/// Returns Student's 97.5 % point over the normal distribution's.
fn student(freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, freedom).map_or(1.0, |of| of.inverse_cdf(0.975) / NORMAL_95)
}

/// Returns 95 % intervals in the form of the parameters.
fn uncertainty(candidate: Candidate, estimates: &[Estimate], wide: f64) -> Value {
    let ends = |one: &Estimate| {
        let half = one.standard_error? * NORMAL_95 * wide;
        Some(json!([one.value - half, one.value + half]))
    };
    if candidate == Candidate::GSensitivity {
        let row = |row: usize| -> Vec<Value> {
            estimates[3 * row..3 * row + 3].iter().map(|one| ends(one).unwrap_or(Value::Null)).collect()
        };
        return json!({"m": [row(0), row(1), row(2)]});
    }
    let pairs = estimates.iter().filter_map(|one| Some((one.parameter.clone(), ends(one)?)));
    Value::Object(pairs.collect())
}

fn all_of(triad: Triad) -> Vec<String> {
    triad.channels().iter().map(|channel| channel.name().to_owned()).collect()
}

/// Returns a latency that was separated from the offset of the reference's clock.
fn latency(of: &Settled, delay: Delay, nats: f64, found: &Found) -> Driven {
    let known: f64 = of.known.iter().map(|effect| effect.delay_s()).sum();
    let seconds = known + delay.seconds;
    let half = NORMAL_95 * delay.error_s;
    let evidence = vec![
        format!(
            "{}: {nats:.0} nats more with latency than without; chance gives {:.0}",
            of.triad.name(),
            found.price_of_one
        ),
        match found.lateness.offset_s {
            Some(offset_s) => format!(
                "it is later than the other triad by {:.3e} s ± {:.0e} s; the reference's clock is {offset_s:.4} s early for both",
                delay.seconds, delay.error_s
            ),
            None => format!(
                "it is later than the reference, whose stamps are the recording's, by {:.3e} s ± {:.0e} s",
                delay.seconds, delay.error_s
            ),
        },
    ];
    let margin = nats - found.price_of_one;
    let confidence = RIGHT[0] / (1.0 + (-margin.clamp(-30.0, 30.0)).exp());
    let effect = Candidate::Latency.make(&[seconds]);
    let ends = json!({"seconds": [seconds - half, seconds + half]});
    Driven::new(of.triad, effect, Some(nats), all_of(of.triad), confidence, ends, evidence)
}

/// Returns the sensor's range, if samples are at it and the model has none.
fn saturation(of: &Settled) -> Option<Driven> {
    let clipping = of.range()?;
    let ties: usize = clipping.ties.iter().sum();
    let channels = of.triad.channels().into_iter().zip(clipping.ties).filter(|(_, ties)| *ties > 0);
    let channels: Vec<String> = channels.map(|(channel, _)| channel.name().to_owned()).collect();
    let evidence = vec![format!(
        "{}: {ties} samples stand exactly at the largest magnitude, {:.6}, while the reference runs on",
        of.triad.name(),
        clipping.limit
    )];
    let effect = Candidate::Saturation.make(&[clipping.limit]);
    let nats: f64 = of.cut_off.iter().flatten().flatten().sum();
    let mut one = Driven::new(of.triad, effect, Some(nats), channels, 0.999, Value::Null, evidence);
    // An exact tie determines the range even if hardly any sample is beyond it.
    one.rank = nats.max(TIE * ties as f64);
    Some(one)
}

/// Adds a triad's gap, block by block. Returns the whole and the remaining gap per axis.
fn add(sums: &mut Sums, of: &Settled, late: bool) -> [[f64; 2]; 3] {
    let weighing = of.weighing();
    // A delay is a cause if it is a latency, but not if it is a clock's offset.
    let delay: Vec<usize> = of.base.iter().copied().take(usize::from(late)).collect();
    let base: Vec<usize> = of.base.iter().copied().filter(|column| !delay.contains(column)).collect();
    let inside: Vec<usize> = of
        .chosen()
        .filter(|(_, group)| matches!(group.member, Member::Library(_)))
        .flat_map(|(_, group)| group.columns.clone())
        .chain(delay.iter().copied())
        .collect();
    let whole_columns = weighing.columns(&of.choice.groups);
    let n = of.fit.response[0].len();
    let cut_off = of.cut_off.as_ref().map_or([0.0; 3], |axes| axes.each_ref().map(|nats| nats.iter().sum::<f64>()));
    for nats in of.cut_off.iter().flatten() {
        for block in 0..BLOCKS {
            // A model with this range shows these samples exactly.
            let own: f64 = nats[n * block / BLOCKS..n * (block + 1) / BLOCKS].iter().sum();
            sums.whole[block] += own;
            sums.closed[block] += own;
        }
    }
    if inside.is_empty() && of.choice.groups.is_empty() {
        return cut_off.map(|nats| [nats, 0.0]);
    }
    let with_base = |columns: &[usize]| base.iter().copied().chain(columns.iter().copied()).collect::<Vec<usize>>();
    let (_, of_base) = of.screen.gain(&base);
    let (_, of_whole) = of.screen.gain(&whole_columns);
    let nothing = of.screen.explained(&base, &of_base);
    let whole: Vec<f64> =
        of.screen.explained(&whole_columns, &of_whole).iter().zip(&nothing).map(|(all, base)| all - base).collect();
    let held_out: Vec<f64> = match inside.is_empty() {
        true => vec![0.0; BLOCKS],
        false => {
            let (with, without) = (of.screen.held_out(&with_base(&inside), FOLDS), of.screen.held_out(&base, FOLDS));
            with.iter().zip(&without).map(|(with, without)| with - without).collect()
        }
    };
    for block in 0..BLOCKS {
        sums.whole[block] += whole[block];
        sums.closed[block] += held_out[block];
    }
    sums.numbers += inside.len();
    let (total, closed): (f64, f64) = (whole.iter().sum(), held_out.iter().sum());
    let foreign = of.chosen().flat_map(|(_, group)| group.columns.clone()).chain(delay);
    let columns: Vec<usize> = foreign.collect();
    let numbers: Vec<f64> = columns
        .iter()
        .map(|column| whole_columns.iter().position(|own| own == column).map_or(0.0, |place| of_whole[place]))
        .collect();
    let axes = of.screen.by_axis(&columns, &numbers);
    let all: f64 = axes.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    std::array::from_fn(|axis| [total * axes[axis] / all + cut_off[axis], (total - closed) * axes[axis] / all])
}

/// Returns the effects that explain nearly as much as a cause.
fn weighed(of: &Settled) -> Vec<Alternative> {
    let weighing = of.weighing();
    let own = &of.choice.groups;
    let whole = weighing.gain(own);
    let library = |group: &Group| match group.member {
        Member::Library(candidate) => Some(candidate),
        Member::Foreign(_) => None,
    };
    let mut all: Vec<(f64, Alternative)> = Vec::new();
    for (place, group) in of.chosen() {
        let Some(winner) = library(group) else { continue };
        let rest: Vec<usize> = own.iter().copied().filter(|other| *other != place).collect();
        let least = weighing.gain(&rest);
        for (other, group) in of.groups.iter().enumerate().filter(|(other, _)| !own.contains(other)) {
            let Some(candidate) = library(group) else { continue };
            let with: Vec<usize> = rest.iter().copied().chain([other]).collect();
            let gain = weighing.gain(&with);
            if gain - least < NEARLY * (whole - least) || gain - least < group.price {
                continue;
            }
            let lead = (whole - of.groups[place].price) - (gain - group.price);
            let why_not = format!("{} explains {lead:.0} nats more for what it costs", called(winner));
            let closes = Some((gain - least) / whole.max(f64::MIN_POSITIVE));
            let alternative = Alternative { effect: candidate.kind(), channels: all_of(of.triad), closes, why_not };
            all.push((gain - least, alternative));
        }
    }
    all.sort_by(|one, other| other.0.total_cmp(&one.0));
    all.into_iter().map(|(_, of)| of).collect()
}

/// Describes the alignment of record and reference in time.
fn of_clock(found: &Found, aligned: &Aligned, real: &Recording, part: &Recording) -> Vec<String> {
    let mut notes = Vec::new();
    if part.len() < real.len() {
        notes.push(format!(
            "compared are the {:.1} s that the reference reaches, from {:.1} s on; {} outside it",
            part.length_s(),
            aligned.from as f64 / real.rate_hz,
            imu_core::units::counted((real.len() - part.len()) as u64, "sample is", "samples are")
        ));
    }
    if !aligned.shared {
        notes.push(format!(
            "the reference has a clock of its own: the recording begins {:.4} s after its first row",
            aligned.begins_s - found.lateness.offset_s.unwrap_or_default()
        ));
        for of in &found.triads {
            let rate = of.fit.estimates.iter().find(|one| one.parameter == "rate_error");
            let off = rate.and_then(|one| Some((one.value, one.standard_error?)));
            // The corrections made during alignment, plus the remaining ones.
            let off = off.map(|(value, error)| (aligned.gains + value, error));
            if let Some((value, error)) = off.filter(|(value, error)| value.abs() > 4.0 * error && value.abs() > 1e-7) {
                notes.push(format!(
                    "by the {} that clock {} {:.2e} s a second (± {error:.0e}) on the recording's",
                    of.triad.name(),
                    if value > 0.0 { "loses" } else { "gains" },
                    value.abs()
                ));
            }
        }
    } else if let Some(offset_s) = found.lateness.offset_s {
        notes.push(format!(
            "the reference is {offset_s:.4} s early for the whole recording: its stamps are another clock's"
        ));
    }
    if found.lateness.open {
        notes.push(
            "this record cannot tell a latency of all triads from an offset of the reference's clock: a trigger that both \
             record would tell"
                .to_owned(),
        );
    }
    notes
}

/// Returns the parameters that the motion leaves open.
fn left_open(found: &Found) -> Vec<String> {
    let of = |settled: &Settled| {
        let all = settled.screen.fit.confounded.iter().filter(|one| one.openness != Openness::Faint);
        // A clock is reported separately.
        let own = all.filter(|one| !one.of_clock);
        own.map(|one| format!("{}: {}", settled.triad.name(), one.sentence)).collect::<Vec<String>>()
    };
    found.triads.iter().flat_map(of).collect()
}
