//! Tumble: a record without a reference, in which the sensor lay still in six poses or more, was turned by whole
//! circles, or was turned slowly through many poses.
//!
//! The rests are found without a reference ([`super::rests`]). [`super::poses`] evaluates their means, and
//! [`super::quasi_static`] a slow turn. The noise is found in the longest rest, as in any record at rest.

use super::felt::felt;
use super::noise::mean_freedom;
use super::places::driven;
use super::poses::{self, GRAVITY_SD, PARTS, POSES_MIN, Tumbled, Turned};
use super::quasi_static::{WINDOW_S, Windows, quasi_static};
use super::rests::{Rest, poses as count_poses, rests};
use super::together::{self, Driven, Sums};
use crate::averages::quantile;
use crate::diagnose::diagnose;
use crate::error::DiagnosisError;
use crate::options::Options;
use crate::outcome::Outcome;
use crate::prepare;
use crate::recording::Recording;
use crate::report::{Driver, Place, Verdict};
use crate::response::{AXES, Candidate, NORMAL_95};
use imu_core::sample::Triad;
use imu_core::units::STANDARD_GRAVITY_M_S2;
use imu_model::effects::EffectKind;
use imu_model::effects::triad::{Axes, ScaleFactor};
use imu_model::simulator::SensorModel;
use serde_json::{Map, Value, json};
use std::sync::Arc;

/// Confidence in causes that the poses name.
const RIGHT: f64 = 0.95;
/// A rest that is this unlikely under the noise shows an unknown effect.
const REMAINS: f64 = 0.005;

/// Compares a record that rests in several poses with a model. `None` if it does not rest in several poses, or is at
/// rest throughout.
///
/// # Errors
/// [`DiagnosisError`] if the inputs cannot be compared.
///
/// # Validation
/// `tests` below: a simulated tumble gives its scale factors and biases back within their intervals.
pub fn diagnose_tumble(
    real: &Recording,
    sim: &SensorModel,
    options: &Options<'_>,
) -> Option<Result<Outcome, DiagnosisError>> {
    let has = |triad: Triad| triad.channels().iter().all(|channel| sim.channels.contains_key(channel));
    if !has(Triad::Accel) || prepare::comparable(real, sim).is_err() {
        return None;
    }
    // An effect that the model has already is not a cause.
    let felt = felt(real, sim);
    let rests = rests(&felt);
    let tumble = count_poses(&rests) >= POSES_MIN;
    let gyro = felt.triad(Triad::Gyro);
    let n = Triad::Gyro.channels().map(|channel| sim.channels.get(&channel).map_or(0.0, |of| of.n));
    let turns = match gyro.filter(|_| has(Triad::Gyro)) {
        Some(gyro) => poses::turned(&rests, gyro, real.rate_hz, n, options.level),
        None => Vec::new(),
    };
    let longest = rests.iter().max_by_key(|rest| rest.within.len())?;
    let windows = match (gyro, felt.triad(Triad::Accel)) {
        (Some(gyro), Some(accel)) => Windows::of(&felt, accel, gyro, longest.rate.unwrap_or_default()),
        _ => Windows::default(),
    };
    if (!tumble && turns.is_empty() && !windows.turn(&rests)) || longest.within.len() < prepare::LEAST {
        return None;
    }
    let still = real.part(longest.within.clone());
    let mut plain = sim.clone();
    plain.triads.clear();
    let mut outcome = match diagnose(&still, &plain, options) {
        Ok(outcome) => outcome,
        Err(error) => return Some(Err(error)),
    };
    outcome.diagnosis.begins_at(longest.within.start as f64 / real.rate_hz);
    outcome.rest = Some(longest.within.clone());
    // N is that of the record; B and K do not show in one rest alone.
    let mut noise = sim.clone();
    for (channel, of) in &mut noise.channels {
        of.n = outcome.augmented.channels.get(channel).map_or(of.n, |found| found.n);
    }
    let freedom = mean_freedom(&noise, Triad::Accel, real.rate_hz, real.len());
    let at_rest = tumble.then(|| poses::tumbled(&rests, real.rate_hz, &noise, options, freedom)).flatten();
    let found = match at_rest {
        Some(of) => Some(Poses { of, stands: &rests, how: How::Rests }),
        None => quasi_static(&windows, options).map(|of| Poses { of, stands: &windows.stands, how: How::Windows }),
    };
    complete(&mut outcome, sim, real, options, longest, found.as_ref(), &turns);
    Some(Ok(outcome))
}

/// How gravity was examined.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum How {
    /// In rests.
    Rests,
    /// In windows of a slow turn.
    Windows,
}

/// The accelerometer's result from gravity's magnitude, and its origin.
struct Poses<'a> {
    of: Tumbled,
    stands: &'a [Rest],
    how: How,
}

impl Poses<'_> {
    /// Returns a text such as "7 rests (6 poses)".
    fn description(&self) -> String {
        let (count, poses) = (self.stands.len(), count_poses(self.stands));
        match self.how {
            How::Rests => format!("{count} rests ({poses} poses)"),
            How::Windows => format!("{count} windows of {WINDOW_S:.0} s of a slow turn ({poses} poses)"),
        }
    }
}

fn complete(
    outcome: &mut Outcome,
    sim: &SensorModel,
    real: &Recording,
    options: &Options<'_>,
    longest: &Rest,
    poses: Option<&Poses<'_>>,
    turns: &[Turned],
) {
    let mut named: Vec<Driven> = poses.map(|poses| of_poses(poses, sim)).unwrap_or_default();
    named.extend(of_turns(turns, sim).filter(|_| options.wants(EffectKind::ScaleFactor)));
    let diagnosis = &mut outcome.diagnosis;
    let all = real.len() as f64 * diagnosis.per_channel.len().max(1) as f64;
    let mut notes = vec![format!(
        "without a reference: the noise is that of the longest rest, {:.1} s from {:.1} s on",
        longest.within.len() as f64 / real.rate_hz,
        longest.within.start as f64 / real.rate_hz
    )];
    if poses.is_none() && turns.is_empty() {
        notes.push(
            "the sensor is turned, too fast or through too few poses for gravity's magnitude to be a reference: give the motion \
             with --reference, or rest in six poses or more"
                .to_owned(),
        );
    }
    if let Some(poses) = poses {
        let of = &poses.of;
        let typical = match poses.how {
            How::Rests => |values: &[f64]| {
                (values.iter().map(|value| value * value).sum::<f64>() / values.len().max(1) as f64).sqrt()
            },
            // A jerk in a window is not caused by the sensor.
            How::Windows => {
                |values: &[f64]| quantile(values.iter().map(|value| value.abs()).collect(), 0.5).unwrap_or(0.0)
            }
        };
        notes.push(format!(
            "gravity's magnitude in {} is the reference, taken as {STANDARD_GRAVITY_M_S2:.4} m/s² ± {GRAVITY_SD}: it is off by \
             {:.4} m/s² ({}) as the model is and by {:.4} with what was found; gravity comes out as {:.4}",
            poses.description(),
            typical(&of.before),
            if poses.how == How::Rests { "rms" } else { "median" },
            typical(&of.after),
            STANDARD_GRAVITY_M_S2 + of.values[9]
        ));
        notes.push(
            "magnitudes do not show a rotation of the whole triad; scale factors that are all off alike show only beyond the \
             0.13 % to which local gravity is known: a reference would tell both"
                .to_owned(),
        );
        let sums = Sums { whole: vec![of.choice.gain], closed: vec![of.held_out], numbers: 3 * of.choice.groups.len() };
        // A magnitude belongs to no single axis.
        let each = |nats: f64| nats / (3.0 * real.len() as f64);
        for channel in Triad::Accel.channels() {
            if let Some(gap) = diagnosis.per_channel.get_mut(channel.name()) {
                gap.before += each(of.choice.gain);
                gap.after += each(of.choice.gain - of.held_out);
                gap.floor += each(sums.floor());
            }
        }
        let held_out = match poses.how {
            How::Rests => "poses foretold by all others",
            How::Windows => "half of the windows foretold by the other",
        };
        let at = place(of, poses.stands, real.rate_hz).filter(|_| !of.choice.groups.is_empty());
        let located = at.into_iter().collect();
        together::join(diagnosis, &sums, &mut named, located, all, held_out);
        diagnosis.discrepancy.p_value_after = diagnosis.discrepancy.p_value_after.min(of.p_value);
        if of.p_value < REMAINS {
            notes.push(format!(
                "gravity's magnitude is not that of one pose to the next as the noise would have it (chance {:.1e}): rests that \
                 are none, a drift, a temperature, or a curve that is not straight",
                of.p_value
            ));
            diagnosis.verdict = Verdict::UnknownEffect;
        }
    }
    if poses.is_none() && !named.is_empty() {
        together::join(diagnosis, &Sums::default(), &mut named, Vec::new(), all, "no part of the turns was held out");
    }
    if !named.is_empty() && diagnosis.verdict != Verdict::UnknownEffect {
        diagnosis.verdict = Verdict::Effects;
    }
    notes.append(&mut diagnosis.notes);
    diagnosis.notes = notes;
    diagnosis.summary = crate::sentence::summary(diagnosis);
    outcome.augmented.triads = together::corrected(sim, &named);
}

/// Returns the causes that the magnitudes determine.
fn of_poses(poses: &Poses<'_>, sim: &SensorModel) -> Vec<Driven> {
    let of = &poses.of;
    let channels = Triad::Accel.channels().map(|channel| channel.name().to_owned());
    of.choice
        .groups
        .iter()
        .map(|group| {
            let part = PARTS[*group];
            let names = if part == Candidate::CrossAxisSensitivity { ["xy", "xz", "yz"] } else { AXES };
            let found: Axes = std::array::from_fn(|axis| of.values[3 * group + axis]);
            // To first order, the found deviation adds to the known one.
            let known = known(sim, Triad::Accel, part.kind(), names);
            let axes: Axes = std::array::from_fn(|axis| known[axis] + found[axis]);
            let effect = part.make(&axes);
            let ends = |axis: usize| {
                let half = NORMAL_95 * of.errors[3 * group + axis];
                json!([axes[axis] - half, axes[axis] + half])
            };
            let (gain, price) = (of.gains[*group], of.prices[*group]);
            let mut evidence = vec![format!(
                "accel: {gain:.0} nats more of {} with {} than without; chance gives {price:.0}",
                poses.description(),
                effect.name()
            )];
            for (axis, name) in names.iter().enumerate() {
                let error = of.errors[3 * group + axis];
                if found[axis].abs() > 3.0 * error {
                    evidence.push(format!("{name} {:.3e} ± {error:.1e}", axes[axis]));
                }
            }
            // Both axes of a pair are affected.
            let concerned = |axis: &usize| {
                let at: &[usize] = match (part, axis) {
                    (Candidate::CrossAxisSensitivity, 0) => &[0, 1],
                    (Candidate::CrossAxisSensitivity, 1) => &[0, 2],
                    (Candidate::CrossAxisSensitivity, _) => &[1, 2],
                    (_, axis) => std::slice::from_ref(axis),
                };
                at.iter().any(|place| found[*place].abs() > NORMAL_95 * of.errors[3 * group + place])
            };
            let own: Vec<String> = (0..3).filter(concerned).map(|axis| channels[axis].clone()).collect();
            let channels = if own.is_empty() { channels.to_vec() } else { own };
            let ends = json!({names[0]: ends(0), names[1]: ends(1), names[2]: ends(2)});
            Driven::new(Triad::Accel, effect, Some(gain), channels, RIGHT, ends, evidence)
        })
        .collect()
}

/// Returns the coefficients of an effect that a model's triad has already.
pub(super) fn known(sim: &SensorModel, triad: Triad, effect: EffectKind, names: [&str; 3]) -> Axes {
    let own = sim.triads.get(&triad).and_then(|of| of.effects.iter().find(|own| own.kind() == effect));
    names.map(|name| own.and_then(|own| own.number(name)).unwrap_or(0.0))
}

/// Returns the causes that the circles determine.
fn of_turns(turns: &[Turned], sim: &SensorModel) -> Option<Driven> {
    let channels = Triad::Gyro.channels();
    let mut axes = known(sim, Triad::Gyro, EffectKind::ScaleFactor, AXES);
    let (mut ends, mut evidence, mut gain) = (Map::new(), Vec::new(), 0.0);
    for one in turns {
        axes[one.axis] += one.scale;
        let (scale, half) = (axes[one.axis], NORMAL_95 * one.error);
        ends.insert(AXES[one.axis].to_owned(), json!([scale - half, scale + half]));
        evidence.push(format!(
            "{}: {} turned from {:.1} s on between two rests in one pose come out as {:.3} of it; the turn's end is taken to \
             be known to half a degree",
            channels[one.axis],
            if one.circles > 1.0 { format!("{} whole circles", one.circles) } else { "a whole circle".to_owned() },
            one.from_s,
            1.0 + one.scale
        ));
        gain += 0.5 * (one.scale / one.error).powi(2);
    }
    let effect = Arc::new(ScaleFactor { axes });
    let channels = turns.iter().map(|one| channels[one.axis].name().to_owned()).collect();
    // The part that it closes was not measured on another turn.
    let mut one = Driven::new(Triad::Gyro, effect, None, channels, RIGHT, Value::Object(ends), evidence);
    one.rank = gain;
    (!turns.is_empty()).then_some(one)
}

/// Returns the rest in which gravity deviates most.
fn place(of: &Tumbled, rests: &[Rest], rate_hz: f64) -> Option<Place> {
    let worst = (0..rests.len()).max_by(|one, other| of.before[*one].abs().total_cmp(&of.before[*other].abs()))?;
    let force = rests[worst].force;
    let axis = (0..3).max_by(|one, other| force[*one].abs().total_cmp(&force[*other].abs()))?;
    let pose = Some(format!("{} {}", AXES[axis], if force[axis] > 0.0 { "up" } else { "down" }));
    let within = &rests[worst].within;
    let at_s = [within.start, within.end].map(|index| index as f64 / rate_hz);
    let squares: f64 = of.before.iter().map(|value| value * value).sum();
    let mut place = driven(Triad::Accel.channels()[axis], at_s, within.len(), rate_hz, of.before[worst] > 0.0);
    let range = [force[axis], force[axis]];
    let (quantity, axis, unit) = ("acceleration".into(), AXES[axis].into(), "m/s²".into());
    place.at = Some(Driver { quantity, axis, unit, range, pose });
    place.nats = of.before[worst].powi(2) / squares.max(f64::MIN_POSITIVE) * of.choice.gain;
    place.p_value = (-of.choice.gain).exp();
    Some(place)
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::motion::{Course, Kind, Site};
    use imu_model::simulator::{Motion, Simulator};

    const RATE_HZ: f64 = 40.0;

    fn model(triads: Value) -> SensorModel {
        let mut entries = Map::new();
        for (triad, n) in [(Triad::Accel, 0.0014), (Triad::Gyro, 6e-5)] {
            for channel in triad.channels() {
                entries.insert(channel.name().to_owned(), json!({"N": n, "B": 0.1 * n, "K": 0.003 * n}));
            }
        }
        let value = json!({"format": "vn100d-sensor-model-1", "name": "test", "rate_hz": RATE_HZ, "channels": entries,
            "triads": triads});
        SensorModel::from_value(&value, "test").unwrap()
    }

    fn recorded(model: &SensorModel, motions: Vec<Motion>, seed: u64) -> Recording {
        let count = motions.len();
        let simulator = Simulator::new(model, seed, RATE_HZ, count as f64 / RATE_HZ).unwrap();
        let mut simulator = simulator.with_motion(motions.into_iter());
        let mut channels: Vec<_> = model.channels.keys().map(|channel| (*channel, Vec::new())).collect();
        for _ in 0..count {
            let sample = simulator.next_sample().unwrap();
            channels.iter_mut().for_each(|(channel, values)| values.push(sample.values[*channel as usize]));
        }
        Recording { rate_hz: RATE_HZ, channels, ..Recording::default() }
    }

    fn tumble(seconds: usize) -> Vec<Motion> {
        let course = Course::new(Kind::Tumble, seconds as f64, Site::default()).unwrap();
        course.sampled(RATE_HZ).take(seconds * 40).collect()
    }

    #[test]
    fn a_tumble_determines_the_accelerometers_scale_and_bias_by_itself() {
        let truth = model(json!({"accel": {"effects": [
            {"effect": "bias", "x": 0.05, "y": -0.03, "z": 0.02},
            {"effect": "scale_factor", "x": 0.006, "y": -0.005, "z": 0.002}]}}));
        // Twice, so that each pose is predicted by another one like it.
        let real = recorded(&truth, [tumble(300), tumble(300)].concat(), 3);
        let found = diagnose_tumble(&real, &model(json!({})), &Options::default()).unwrap().unwrap();
        println!("{}", serde_json::to_string_pretty(&found.diagnosis).unwrap());
        let mut named: Vec<&str> = found.diagnosis.causes.iter().map(|cause| cause.effect.name()).collect();
        named.sort_unstable();
        assert_eq!(named, ["bias", "scale_factor"]);
        assert_eq!(found.diagnosis.verdict, Verdict::Effects);
        for (effect, truth) in [("bias", [0.05, -0.03, 0.02]), ("scale_factor", [0.006, -0.005, 0.002])] {
            let cause = found.diagnosis.causes.iter().find(|cause| cause.effect.name() == effect).unwrap();
            for (name, truth) in ["x", "y", "z"].into_iter().zip(truth) {
                let ends = &cause.uncertainty["accel"][name];
                let (low, high) = (ends[0].as_f64().unwrap(), ends[1].as_f64().unwrap());
                let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
                assert!((truth - middle).abs() < 1.6 * half, "{effect} {name}: {truth} [{low}, {high}]");
            }
        }
        assert!(found.diagnosis.discrepancy.closed.unwrap() > 0.8);
    }

    #[test]
    fn a_clean_tumble_names_nothing_and_a_still_record_is_no_tumble() {
        let plain = model(json!({}));
        for seed in 0..3 {
            let real = recorded(&plain, tumble(240), 20 + seed);
            let found = diagnose_tumble(&real, &plain, &Options::default()).unwrap().unwrap();
            assert!(found.diagnosis.causes.is_empty(), "{:?}", found.diagnosis.causes);
            assert_ne!(found.diagnosis.verdict, Verdict::Effects);
        }
        let still = Course::new(Kind::Still, 60.0, Site::default()).unwrap().sampled(RATE_HZ).take(2400).collect();
        let real = recorded(&plain, still, 1);
        assert!(diagnose_tumble(&real, &plain, &Options::default()).is_none());
    }

    #[test]
    fn a_circle_between_two_rests_determines_the_gyros_scale() {
        let truth = model(json!({"gyro": {"effects": [{"effect": "scale_factor", "x": 0.0, "y": 0.0, "z": 0.012}]}}));
        let rate = |t: usize| if (1600..2400).contains(&t) { std::f64::consts::TAU / 20.0 } else { 0.0 };
        let motions = (0..4000).map(|t| Motion {
            gyro_rad_s: [0.0, 0.0, rate(t)],
            accel_m_s2: [0.0, 0.0, -9.806_65],
            temperature_c: None,
        });
        let real = recorded(&truth, motions.collect(), 5);
        let found = diagnose_tumble(&real, &model(json!({})), &Options::default()).unwrap().unwrap();
        let cause = &found.diagnosis.causes[0];
        assert_eq!((cause.effect.name(), cause.channels.as_slice()), ("scale_factor", &["gyro_z".to_owned()][..]));
        assert!((cause.parameters["gyro"]["z"].as_f64().unwrap() - 0.012).abs() < 2e-3);
    }
}
