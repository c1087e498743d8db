//! Posed: a record beside poses or rates that another instrument measured ([`imu_pose`]).
//!
//! The calibration gives scale factors, cross-axis sensitivity, bias and latency with intervals. Those that differ from the model's
//! are causes. The noise is that of the longest rest; without one, noise is not compared.

use super::places::driven;
use super::rests::rests;
use super::rows::rows;
use super::spoiled::Spoiled;
use super::together::{self, Driven, Sums};
use super::tumble::known;
use crate::diagnose::diagnose;
use crate::error::DiagnosisError;
use crate::options::Options;
use crate::outcome::Outcome;
use crate::prepare;
use crate::recording::Recording;
use crate::report::{ChannelGap, Diagnosis, Discrepancy, FORMAT, Hint, HintKind, Place, Verdict};
use crate::response::{AXES, Candidate};
use imu_core::sample::{Channel, Triad};
use imu_model::effects::EffectKind;
use imu_model::simulator::SensorModel;
use imu_pose::{
    Calibration, Estimate, External, Frames, Stated, StatedSensor, Track, TriadFit, Unit, against_poses, against_rates,
};
use nalgebra::Vector3;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// A number differs from the model's if it is this many half-widths of its 95 % interval away: about 4.5 standard deviations, two
/// dozen numbers are examined.
pub const CERTAIN: f64 = 2.2;
/// Confidence in a cause: its interval is the record's, and trials of one sensor scatter by more.
const RIGHT: f64 = 0.95;
/// Names of the cross-axis sensitivities.
const PAIRS: [&str; 3] = ["xy", "xz", "yz"];
/// What the gap was measured on.
const MEASURED: &str = "parts of the motion that all others foretell";
/// Numbers of a triad's fit.
const NUMBERS: usize = 10;

/// Compares a record with a model beside an external reference.
///
/// # Errors
/// [`DiagnosisError`] if the inputs cannot be compared.
///
/// # Validation
/// `imu-pose`, and BROAD, RepoIMU and an encoder in docs/motion-diagnosis.md.
pub fn diagnose_posed(
    real: &Recording,
    reference: &External,
    sim: &SensorModel,
    options: &Options<'_>,
) -> Result<Outcome, DiagnosisError> {
    prepare::comparable(real, sim)?;
    let [gyro, accel] = [Triad::Gyro, Triad::Accel].map(|triad| stated(sim, triad));
    let (found, spoiled) = compared(real, reference, &StatedSensor { gyro, accel })?;
    let mut outcome = at_rest(real, sim, options)?;
    let mut named = Vec::new();
    let (mut sums, mut located) = (Sums::default(), Vec::new());
    let is_rate = matches!(reference, External::Rates(_));
    let fits = [(Triad::Gyro, Some(&found.gyro)), (Triad::Accel, found.accel.as_ref())];
    for (triad, fit) in fits {
        let Some(fit) = fit.filter(|_| triad.channels().iter().any(|of| sim.channels.contains_key(of))) else {
            continue;
        };
        named.extend(causes(triad, fit, sim));
        sums.whole.extend(fit.gap.iter().map(|of| of.nats));
        sums.closed.extend(fit.gap.iter().map(|of| of.explained));
        sums.numbers += NUMBERS;
        let channels: Vec<Channel> = triad.channels().into_iter().filter(|of| real.values(*of).is_some()).collect();
        let (nats, explained) = fit.gap.iter().fold((0.0, 0.0), |sum, of| (sum.0 + of.nats, sum.1 + of.explained));
        let samples = (channels.len() * real.len()) as f64;
        located.extend(channels.iter().filter_map(|channel| place(*channel, fit, nats / channels.len() as f64, real)));
        for channel in &channels {
            let gap = outcome.diagnosis.per_channel.entry(channel.name().to_owned());
            let gap = gap.or_insert(ChannelGap { before: 0.0, after: 0.0, floor: 0.0 });
            gap.before += nats / samples;
            gap.after += (nats - explained) / samples;
        }
    }
    named.extend(latencies(&found, sim, is_rate));
    named.retain(|one: &Driven| options.wants(one.effect.kind()));
    let diagnosis = &mut outcome.diagnosis;
    let is_noise_compared = !diagnosis.discrepancy.measured_on.is_empty();
    let all = (real.len() * real.channels.len().max(1)) as f64;
    together::join(diagnosis, &sums, &mut named, located, all, MEASURED);
    if !is_noise_compared {
        diagnosis.discrepancy.measured_on = MEASURED.to_owned();
    }
    if !named.is_empty() && diagnosis.verdict != Verdict::UnknownEffect {
        diagnosis.verdict = Verdict::Effects;
    }
    let mut notes = notes(&found, &spoiled, is_rate);
    notes.append(&mut diagnosis.notes);
    diagnosis.notes = notes;
    diagnosis.summary = crate::sentence::summary(diagnosis);
    let mut first = first(&found, reference);
    first.extend(spoiled.hints(real.len()));
    if !first.is_empty() {
        let texts: Vec<&str> = first.iter().map(|hint| hint.text.as_str()).collect();
        diagnosis.summary = format!("{}; apart from that {}", texts.join("; "), diagnosis.summary);
        diagnosis.hints.splice(0..0, first);
    }
    outcome.augmented.triads = together::corrected(sim, &named);
    Ok(outcome)
}

/// Returns the deviations that a model states of a triad.
fn stated(sim: &SensorModel, triad: Triad) -> Stated {
    Stated {
        scale: known(sim, triad, EffectKind::ScaleFactor, AXES),
        cross: known(sim, triad, EffectKind::CrossAxisSensitivity, PAIRS),
        bias: known(sim, triad, EffectKind::Bias, AXES),
        later_s: known_latency_s(sim, triad),
    }
}

fn known_latency_s(sim: &SensorModel, triad: Triad) -> f64 {
    let effects = sim.triads.get(&triad).map(|of| of.effects.as_slice()).unwrap_or_default();
    effects.iter().find(|of| of.kind() == EffectKind::Latency).map_or(0.0, |of| of.delay_s())
}

/// Returns what poses or rates show of a sensor, without a model, and the samples that were left out because they do not show the motion.
///
/// # Errors
/// [`DiagnosisError`] if they cannot be compared.
pub fn beside(real: &Recording, reference: &External) -> Result<(Calibration, Vec<Hint>), DiagnosisError> {
    let (found, spoiled) = compared(real, reference, &StatedSensor::default())?;
    Ok((found, spoiled.hints(real.len())))
}

/// Returns what poses or rates show of a sensor, without the samples that are spoiled, and those.
fn compared(
    real: &Recording,
    reference: &External,
    stated: &StatedSensor,
) -> Result<(Calibration, Spoiled), DiagnosisError> {
    let spoiled = Spoiled::of(real);
    let track = track(real, reference, &spoiled)?;
    let mut found = match reference {
        External::Poses(poses) => against_poses(&track, poses, stated),
        External::Rates(rates) => against_rates(&track, rates, &stated.gyro),
    }?;
    // When a row was measured that is sent again does not show.
    found.gyro.is_timed &= !spoiled.repeats(Triad::Gyro);
    if let Some(accel) = &mut found.accel {
        accel.is_timed &= !spoiled.repeats(Triad::Accel);
    }
    Ok((found, spoiled))
}

/// Returns the shortest stretch of time with most of a triad's gap, on one of its channels, which have equal parts of it.
fn place(channel: Channel, fit: &TriadFit, nats: f64, real: &Recording) -> Option<Place> {
    /// Part of the gap that the stretch holds.
    const HELD: f64 = 0.8;
    let parts = &fit.gap;
    let all: f64 = parts.iter().map(|of| of.nats).sum();
    let stretches = (0..parts.len()).filter_map(|from| {
        let mut sum = 0.0;
        let to = (from..parts.len()).find(|to| {
            sum += parts[*to].nats;
            sum >= HELD * all
        })?;
        Some([parts[from].from_s, parts[to].to_s])
    });
    let [from_s, to_s] = stretches.min_by(|one, other| (one[1] - one[0]).total_cmp(&(other[1] - other[0])))?;
    let at_s = [from_s, to_s]
        .map(|time_s| (time_s + fit.later_s.value - real.begins_s.unwrap_or(0.0)).clamp(0.0, real.length_s()));
    let mut place = driven(channel, at_s, real.len(), real.rate_hz, true);
    (place.nats, place.p_value) = (nats, (-nats).exp());
    (nats > 4.0).then_some(place)
}

/// Returns the samples with their stamps, without those that are missing or spoiled. Where the accelerometer alone was cut off, it shows
/// no number.
fn track(real: &Recording, reference: &External, spoiled: &Spoiled) -> Result<Track, DiagnosisError> {
    let columns = |triad: Triad| triad.channels().map(|channel| real.values(channel));
    let gyro = columns(Triad::Gyro);
    let wanted = |axis: usize| match reference {
        External::Poses(_) => true,
        External::Rates(rates) => rates.axis == axis,
    };
    if let Some(axis) = (0..3).find(|axis| wanted(*axis) && gyro[*axis].is_none()) {
        let channel = Triad::Gyro.channels()[axis].name().to_owned();
        return Err(imu_pose::PoseError::Channel { channel }.into());
    }
    let has_accel = columns(Triad::Accel).iter().all(Option::is_some);
    let triads = if has_accel { &[Triad::Gyro, Triad::Accel][..] } else { &[Triad::Gyro] };
    let rows = rows(real, triads);
    let (out, cut) = (spoiled.rows(real.len()), spoiled.accel(real.len()));
    let mut found = Track::default();
    for (at, place) in rows.places.iter().enumerate().filter(|(_, place)| !out[**place]) {
        found.time_s.push(rows.time_s[at]);
        found.gyro.push(rows.triads[0][at]);
        if let Some(force) = rows.triads.get(1).map(|of| of[at]) {
            found.accel.push(if cut[*place] { Vector3::repeat(f64::NAN) } else { force });
        }
    }
    Ok(found)
}

/// Compares the noise in the longest rest. Without a rest that is long enough, nothing is compared.
fn at_rest(real: &Recording, sim: &SensorModel, options: &Options<'_>) -> Result<Outcome, DiagnosisError> {
    let mut plain = sim.clone();
    plain.triads.clear();
    let longest = rests(real).into_iter().max_by_key(|rest| rest.within.len());
    let found = longest.filter(|rest| rest.within.len() >= prepare::LEAST).map(|rest| {
        let outcome = diagnose(&real.part(rest.within.clone()), &plain, options);
        outcome.map(|mut outcome| {
            let (from_s, to_s) = (rest.within.start as f64 / real.rate_hz, rest.within.end as f64 / real.rate_hz);
            outcome.diagnosis.begins_at(from_s);
            outcome.rest = Some(rest.within.clone());
            outcome
                .diagnosis
                .notes
                .insert(0, format!("the noise is that of the longest rest, {from_s:.1} to {to_s:.1} s"));
            outcome
        })
    });
    match found {
        Some(Ok(outcome)) => return Ok(outcome),
        Some(Err(DiagnosisError::CalledOff)) => return Err(DiagnosisError::CalledOff),
        Some(Err(_)) | None => {}
    }
    let discrepancy = Discrepancy {
        unit: "nats/sample".into(),
        before: 0.0,
        after_parameters: 0.0,
        after: 0.0,
        floor: 0.0,
        p_value_after: 1.0,
        closed: None,
        closed_ci95: None,
        measured_on: String::new(),
        cost: None,
    };
    let least_s = prepare::LEAST as f64 / real.rate_hz;
    let diagnosis = Diagnosis {
        format: FORMAT.into(),
        verdict: Verdict::NoGap,
        summary: String::new(),
        discrepancy,
        r#where: Vec::new(),
        parameters: Vec::new(),
        offsets: Vec::new(),
        hints: Vec::new(),
        causes: Vec::new(),
        remainder: None,
        alternatives: Vec::new(),
        per_channel: BTreeMap::new(),
        notes: vec![format!(
            "noise is not compared: the record has no rest of {least_s:.1} s ({} samples)",
            prepare::LEAST
        )],
        software: options.software.to_owned(),
        inputs: [("real".into(), options.real.to_owned()), ("sim".into(), options.sim.to_owned())].into(),
    };
    Ok(Outcome { diagnosis, augmented: sim.clone(), residuals: Vec::new(), rest: Some(0..0) })
}

/// Returns the causes of a triad whose numbers differ from the model's.
fn causes(triad: Triad, fit: &TriadFit, sim: &SensorModel) -> Vec<Driven> {
    let all = triad.channels().map(|channel| channel.name().to_owned());
    let of = |candidate: Candidate, names: [&str; 3], numbers: &[Option<Estimate>; 3], unit: f64| {
        let known = known(sim, triad, candidate.kind(), names);
        let (mut axes, mut ends, mut evidence, mut gain) = (known, Map::new(), Vec::new(), 0.0);
        let mut channels = Vec::new();
        for (axis, name) in names.into_iter().enumerate() {
            let Some(number) = numbers[axis] else { continue };
            axes[axis] = number.value / unit;
            ends.insert(name.to_owned(), json!(number.ci95.map(|end| end / unit)));
            let (off, half) = (axes[axis] - known[axis], number.half() / unit);
            if off.abs() <= CERTAIN * half {
                continue;
            }
            gain += 0.5 * (off * unit / number.sd).powi(2);
            evidence.push(format!(
                "{} {name}: {:.3e} ± {half:.1e}, the model has {:.3e}",
                triad.name(),
                axes[axis],
                known[axis]
            ));
            channels.extend(all.iter().filter(|channel| name.contains(&channel[channel.len() - 1..])).cloned());
        }
        channels.sort_unstable();
        channels.dedup();
        let effect = candidate.make(&axes);
        (!evidence.is_empty())
            .then(|| Driven::new(triad, effect, Some(gain), channels, RIGHT, Value::Object(ends), evidence))
    };
    let unit = fit.frames.factor;
    [
        of(Candidate::ScaleFactor, AXES, &fit.scale, 1.0),
        of(Candidate::CrossAxisSensitivity, PAIRS, &fit.cross, 1.0),
        of(Candidate::Bias, AXES, &fit.bias, unit),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Returns the latencies that are the sensor's. On one clock, each delay is one. On two clocks, the smaller belongs to the clocks.
fn latencies(found: &Calibration, sim: &SensorModel, is_rate: bool) -> Vec<Driven> {
    let mut delays: Vec<(Triad, Estimate)> = vec![(Triad::Gyro, found.gyro.later_s)];
    delays.extend(found.accel.as_ref().filter(|of| of.is_timed).map(|of| (Triad::Accel, of.later_s)));
    // The delay of a rate's own instrument does not show apart.
    if is_rate || !found.gyro.is_timed {
        return Vec::new();
    }
    let is_shared = found.is_one_clock(CERTAIN);
    let least = delays.iter().map(|(_, of)| *of).min_by(|one, other| one.value.total_cmp(&other.value));
    let Some(least) = least else { return Vec::new() };
    let own = delays.into_iter().filter_map(|(triad, of)| {
        let (seconds, sd, half) = if is_shared {
            (of.value, of.sd, of.half())
        } else {
            (of.value - least.value, of.sd.hypot(least.sd), of.half().hypot(least.half()))
        };
        let known = known_latency_s(sim, triad);
        let off = seconds - known;
        if seconds <= 0.0 || off.abs() <= CERTAIN * half {
            return None;
        }
        let channels = triad.channels().map(|channel| channel.name().to_owned()).to_vec();
        let evidence = vec![format!(
            "{}: {:.2} ± {:.2} ms later than the reference, the model has {:.2} ms",
            triad.name(),
            1e3 * seconds,
            1e3 * half,
            1e3 * known
        )];
        let ends = json!({"seconds": [seconds - half, seconds + half]});
        let gain = 0.5 * (off / sd).powi(2);
        Some(Driven::new(triad, Candidate::Latency.make(&[seconds]), Some(gain), channels, RIGHT, ends, evidence))
    });
    own.collect()
}

/// Returns what comes before everything small: axes, signs, units, conventions of the reference.
fn first(found: &Calibration, reference: &External) -> Vec<Hint> {
    let mut hints = Vec::new();
    if found.inverse_quaternions {
        hints.push(Hint {
            about: "reference".to_owned(),
            kind: HintKind::Axes,
            text: "the reference's quaternions turn the world to the body: invert them (negate x, y, z)".to_owned(),
        });
    }
    if found.world_down {
        hints.push(Hint {
            about: "reference".to_owned(),
            kind: HintKind::Sign,
            text: "z of the reference's world points down: a world with z up (ENU) is expected, so negate y and z of its axes"
                .to_owned(),
        });
    }
    let of = |name: &str, frames: &Frames| {
        let mut texts = Vec::new();
        let is_exchanged = frames.axes.iter().enumerate().any(|(at, of)| of.axis != at || of.negative);
        if let (External::Rates(rates), true) = (reference, is_exchanged) {
            let channel = Triad::Gyro.channels()[rates.axis];
            texts
                .push((HintKind::Sign, format!("{channel} has the other sign than the reference: negate one of them")));
        } else if frames.aligned && is_exchanged {
            let axes = frames.axes.map(|of| format!("{}{}", if of.negative { "−" } else { "" }, AXES[of.axis]));
            let hand = if frames.mirrored { ", a left-handed frame" } else { "" };
            texts.push((
                HintKind::Axes,
                format!(
                    "x, y, z of the {name} are {} of the reference{hand}: exchange or negate them",
                    axes.join(", ")
                ),
            ));
        }
        let unit = match frames.unit {
            Unit::Same => None,
            Unit::Degrees => Some("is in °/s instead of rad/s: multiply it by π/180".to_owned()),
            Unit::Radians => Some("is in rad/s where °/s is stated: multiply it by 180/π".to_owned()),
            Unit::Gravities => Some("is in g instead of m/s²: multiply it by 9.80665".to_owned()),
            Unit::MetresPerSecondSquared => Some("is in m/s² where g is stated: divide it by 9.80665".to_owned()),
            Unit::Milligravities => Some("is in mg instead of m/s²: multiply it by 0.00980665".to_owned()),
            Unit::Unknown => {
                Some(format!("shows {:.4} times the reference's values: divide it by that", frames.factor))
            }
        };
        texts.extend(unit.map(|text| (HintKind::Unit, format!("the {name} {text}"))));
        texts.into_iter().map(|(kind, text)| Hint { about: name.to_owned(), kind, text }).collect::<Vec<_>>()
    };
    hints.extend(of("gyroscope", &found.gyro.frames));
    hints.extend(found.accel_frames.iter().flat_map(|frames| of("accelerometer", frames)));
    hints
}

fn notes(found: &Calibration, spoiled: &Spoiled, is_rate: bool) -> Vec<String> {
    let mut notes = Vec::new();
    let fits = [(Triad::Gyro, "gyroscope", Some(&found.gyro)), (Triad::Accel, "accelerometer", found.accel.as_ref())];
    for (triad, name, fit) in fits {
        let Some(fit) = fit else { continue };
        let later = fit.later_s;
        let (size, what) = (1e3 * later.value.abs(), if later.value < 0.0 { "earlier" } else { "later" });
        let whose = if is_rate {
            ": the delay of the reference's own instrument is in it, and two runs at other speeds would tell"
        } else {
            ""
        };
        if !spoiled.repeats(triad) {
            notes.push(format!(
                "the {name} is {size:.2} ± {:.2} ms {what} than the reference{whose}",
                1e3 * later.half()
            ));
        }
        let turned = fit.turned_deg.iter().flatten().map(|of| of.value.powi(2)).sum::<f64>().sqrt();
        if turned > 0.0 && fit.turned_deg.iter().all(Option::is_some) {
            let about = fit
                .turned_deg
                .map(|of| of.map_or_else(String::new, |of| format!("{:.2} ± {:.2}", of.value, of.half())));
            notes.push(format!(
                "the reference's body is turned by {turned:.2}° against the {name} (about x, y, z: {}°): a matter of mounting, no \
                 effect of the sensor",
                about.join(", ")
            ));
        }
        let open: Vec<String> = AXES
            .iter()
            .zip(&fit.scale)
            .filter(|(_, of)| of.is_none())
            .map(|(axis, _)| format!("scale {axis}"))
            .chain(
                ["xy", "xz", "yz"]
                    .iter()
                    .zip(&fit.cross)
                    .filter(|(_, of)| of.is_none())
                    .map(|(pair, _)| format!("cross-axis {pair}")),
            )
            .chain(AXES.iter().zip(&fit.bias).filter(|(_, of)| of.is_none()).map(|(axis, _)| format!("bias {axis}")))
            .collect();
        if !open.is_empty() {
            let wanted = if is_rate { "a reference of all axes" } else { "turns of more than 90° about each axis" };
            notes.push(format!("this motion does not determine {} of the {name}: {wanted} would", open.join(", ")));
        }
    }
    if let Some(arm) = found.arm_m {
        let arm = arm.map(|of| format!("{:.1} ± {:.1}", 1e3 * of.value, 1e3 * of.half()));
        notes.push(format!("the point of the positions is {} mm from the accelerometer (x, y, z)", arm.join(", ")));
    } else if let Some(why) = found.without_accel {
        notes.push(format!("the accelerometer is not compared: {why}"));
    } else if found.accel_frames.is_some() {
        notes.push("without positions, only axes, signs and unit of the accelerometer are compared".to_owned());
    }
    if !found.off.is_empty() {
        let named: Vec<String> =
            found.off.iter().take(6).map(|of| format!("{:.1} to {:.1} s", of.from_s, of.to_s)).collect();
        notes.push(format!(
            "gyroscope and reference contradict each other at {} of the reference's clock",
            named.join(", ")
        ));
    }
    if found.is_ambiguous {
        notes.push(
            "the motion repeats itself, and another offset of the clocks fits as well: no latency is stated, and numbers hold for the \
             smallest offset"
                .to_owned(),
        );
    }
    if let Some(rate) = found.clock_rate.filter(|of| of.value.abs() > CERTAIN * of.half()) {
        notes.push(format!(
            "the recording's clock runs {:.0} ± {:.0} ppm faster than the reference's; delays are those of the middle",
            1e6 * rate.value,
            1e6 * rate.half()
        ));
    }
    notes.push(
        "intervals are those of this record: bias and scale of one sensor scatter by two to five times as much from one trial to the \
         next"
            .to_owned(),
    );
    notes
}
