//! Cases: a device that goes through a motion, with effects that its model lacks; with its key, recording and
//! reference.

use super::bound::{information, needed};
use super::course::{FINE, Shape, course};
use super::impose::{Imposed, behind, full_scale, shown};
use super::kind::{Kind, Planned};
use crate::draw::Draw;
use crate::ground::{TemperatureCourse, as_read, flicker};
use imu_core::sample::{Channel, Triad};
use imu_diagnosis::{Recording, Reference, ReferenceError};
use imu_model::simulator::{ModelError, Motion, SensorModel};
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use sha2::{Digest as _, Sha256};

/// The triads of a device.
const TRIADS: [Triad; 2] = [Triad::Gyro, Triad::Accel];
/// N of a VN-100 on both triads.
const VN_100: [f64; 2] = [6.1e-5, 1.37e-3];
/// Minimum number of samples in a case.
pub const SAMPLES_MIN: usize = 6000;
/// Part of the cases whose reference has a separate clock.
const OWN_CLOCK: f64 = 0.3;
/// Part of the samples beyond a limit at size 1, and a cutoff at size 1 as a part of the rate.
const CUT_OFF: f64 = 1e-3;
const CORNER: f64 = 0.4;
/// Share of the largest information below which a motion does not show a combination of an effect's numbers: a size a
/// thousand times that of the others does not belong to a first-order effect.
const UNSEEN: f64 = 1e-6;

/// An effect that a case has.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrueEffect {
    /// The kind.
    pub kind: Kind,
    /// The triad: `gyro` or `accel`.
    pub triad: String,
    /// The size over the bound's.
    pub over_limit: f64,
    /// The effect's numbers.
    pub numbers: Vec<f64>,
    /// The size at the bound in the unit of its numbers (root of the mean of their squares).
    pub limit: f64,
}

/// The contents of a case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Key {
    /// The case's number.
    pub case: usize,
    /// Samples per second.
    pub rate_hz: f64,
    /// Samples per channel.
    pub samples: usize,
    /// Whether the reference is on a separate clock, at twice the rate, and begins and ends within the record.
    pub own_clock: bool,
    /// The case's effects.
    pub effects: Vec<TrueEffect>,
    /// 16 random bytes.
    pub salt: String,
}

impl Key {
    /// Returns the SHA-256 of the key, in hexadecimal digits.
    pub fn digest(&self) -> String {
        // A key only has finite numbers, texts and lists, so that it always has a text.
        let text = serde_json::to_string(self).unwrap_or_default();
        Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

/// Returns the part of a direction that a motion shows, without combinations of numbers that have almost no
/// information.
fn shown_of(information: &DMatrix<f64>, along: DVector<f64>) -> DVector<f64> {
    let eigen = SymmetricEigen::new(information.clone());
    let most = eigen.eigenvalues.max();
    let mut own = eigen.eigenvectors.tr_mul(&along);
    for (value, eigenvalue) in own.iter_mut().zip(eigen.eigenvalues.iter()) {
        if *eigenvalue < UNSEEN * most {
            *value = 0.0;
        }
    }
    let shown = &eigen.eigenvectors * own;
    if shown.norm() > 0.0 { shown } else { along }
}

/// A sealed case.
#[derive(Debug, Clone)]
pub struct Case {
    seed: u64,
    number: usize,
    rate_hz: f64,
    samples: usize,
    shape: Shape,
    /// The true N, B and K, and the model's, by triad and axis.
    nbk: [[[[f64; 3]; 2]; 3]; 2],
    warms: TemperatureCourse,
    clock: Option<OwnClock>,
    planned: Vec<Planned>,
}

/// A reference's clock that differs from the record's.
#[derive(Debug, Clone, Copy)]
struct OwnClock {
    /// By how much of the record the reference begins late and ends early, s.
    within_s: [f64; 2],
    /// The reference's time at its first row, s.
    begins_s: f64,
    /// By how much the clock gains, s/s.
    gains: f64,
}

impl Case {
    /// Returns the case `number` of the sealed seed with these effects.
    pub fn draw(seed: u64, number: usize, planned: &[Planned], samples: Option<usize>) -> Self {
        let mut draw = Draw::device(seed, number as u64, "motion setting");
        let rate_hz = [40.0, 50.0, 100.0][draw.whole(0, 2)];
        let drawn = (rate_hz * draw.log_uniform(300.0, 900.0)) as usize;
        let shape = Shape::draw(&mut draw);
        let nbk = VN_100.map(|vn_100| {
            let level = vn_100 * draw.log_uniform(0.5, 3.0);
            std::array::from_fn(|_| {
                let n = level * draw.uniform(0.8, 1.5);
                let b = n * draw.log_uniform(0.02, 0.3);
                let k = n * draw.log_uniform(0.001, 0.02);
                let declared = [n * draw.uniform(0.95, 1.05), b * draw.uniform(0.75, 1.25), k * draw.uniform(0.6, 1.4)];
                [[n, b, k], declared]
            })
        });
        let warms = TemperatureCourse::draw(&mut draw);
        let own = OwnClock {
            within_s: [draw.uniform(1.0, 15.0), draw.uniform(1.0, 15.0)],
            begins_s: draw.uniform(0.0, 1e5),
            gains: draw.sign() * draw.log_uniform(1e-7, 1e-4),
        };
        let clock = draw.chance(OWN_CLOCK).then_some(own);
        Self {
            seed,
            number,
            rate_hz,
            samples: samples.unwrap_or(drawn).max(SAMPLES_MIN),
            shape,
            nbk,
            warms,
            clock,
            planned: planned.to_vec(),
        }
    }

    fn stream(&self, purpose: &str) -> Draw {
        Draw::capture(self.seed, self.number as u64, 1, purpose)
    }

    fn course(&self) -> Vec<Motion> {
        course(self.shape, self.rate_hz, self.samples, &mut self.stream("course"))
    }

    /// Returns the temperature, and the temperature about its mean.
    fn warmth(&self) -> (Vec<f64>, Vec<f64>) {
        let warm = self.warms.samples(self.samples, &mut self.stream("temperature"));
        let mean = warm.iter().sum::<f64>() / warm.len().max(1) as f64;
        let about = warm.iter().map(|value| value - mean).collect();
        (warm, about)
    }

    /// Returns the effects with their sizes: log-uniform over a decade from the bound's size.
    fn effects(&self, course: &[Motion], warmth_c: &[f64]) -> Vec<(TrueEffect, Imposed)> {
        let of = |(index, (kind, triad)): (usize, &Planned)| {
            let mut draw = Draw::device(self.seed, self.number as u64, &format!("motion effect {index}"));
            let over_limit = draw.log_uniform(1.0, 10.0);
            let place = usize::from(*triad == Triad::Accel);
            let (numbers, limit) = match kind {
                Kind::Saturation => {
                    let mut sizes: Vec<f64> = course
                        .iter()
                        .step_by(FINE)
                        .flat_map(|motion| if place == 0 { motion.gyro_rad_s } else { motion.accel_m_s2 })
                        .map(f64::abs)
                        .collect();
                    sizes.sort_unstable_by(f64::total_cmp);
                    let beyond = (CUT_OFF * over_limit * sizes.len() as f64) as usize;
                    (vec![sizes[sizes.len() - 1 - beyond.min(sizes.len() / 4)]], CUT_OFF)
                }
                Kind::LowPass => (vec![self.rate_hz * CORNER / over_limit], CORNER),
                _ => {
                    let count = kind.numbers().unwrap_or(1);
                    let nbk = self.nbk[place].map(|axis| axis[0]);
                    let information = information(*kind, *triad, course, self.rate_hz, warmth_c, nbk);
                    let mut along = DVector::from_fn(count, |_, _| draw.normal());
                    if *kind == Kind::Latency {
                        along[0] = 1.0;
                    }
                    along = shown_of(&information, along);
                    along /= along.norm() / (count as f64).sqrt();
                    let seen = (along.transpose() * information * &along)[(0, 0)].max(1e-300);
                    let limit = (needed(count) / seen).sqrt();
                    // Beyond this, a first-order effect makes no sense: the motion does not show it.
                    let size = limit * over_limit;
                    (along.iter().map(|value| value * size).collect(), limit)
                }
            };
            let truth =
                TrueEffect { kind: *kind, triad: triad.name().to_owned(), over_limit, numbers: numbers.clone(), limit };
            (truth, Imposed { kind: *kind, triad: *triad, numbers })
        };
        self.planned.iter().enumerate().map(of).collect()
    }

    /// Returns the key.
    pub fn key(&self) -> Key {
        let (course, (_, warmth_c)) = (self.course(), self.warmth());
        Key {
            case: self.number,
            rate_hz: self.rate_hz,
            samples: self.samples,
            own_clock: self.clock.is_some(),
            effects: self.effects(&course, &warmth_c).into_iter().map(|(truth, _)| truth).collect(),
            salt: self.stream("salt").salt(),
        }
    }

    /// Returns the recording and the rows of its reference.
    pub fn record(&self) -> (Recording, Vec<(f64, Motion)>) {
        let (course, (warm, warmth_c)) = (self.course(), self.warmth());
        let effects: Vec<Imposed> = self.effects(&course, &warmth_c).into_iter().map(|(_, imposed)| imposed).collect();
        let mut channels: Vec<(Channel, Vec<f64>)> = Vec::new();
        for (place, triad) in TRIADS.into_iter().enumerate() {
            let axes = shown(triad, &course, self.rate_hz, &effects, &warmth_c);
            for ((channel, mut values), nbk) in triad.channels().into_iter().zip(axes).zip(self.nbk[place]) {
                let [n, b, k] = nbk[0];
                let mut draw = self.stream(channel.name());
                let (white, step) = (n * self.rate_hz.sqrt(), k / self.rate_hz.sqrt());
                let slow = flicker(self.samples, b, &mut draw.split());
                let mut walk = 0.0;
                for (value, slow) in values.iter_mut().zip(slow) {
                    walk += step * draw.normal();
                    *value += walk + slow + white * draw.normal();
                }
                behind(&mut values, triad, self.rate_hz, &effects);
                channels.push((channel, values));
            }
        }
        let read = as_read(&warm, &mut self.stream("thermometer"));
        let time_s = |index: usize| index as f64 / self.rate_hz;
        let recording = Recording {
            rate_hz: self.rate_hz,
            channels,
            temperature_c: Some(read),
            time_s: (0..self.samples).map(time_s).collect(),
            ..Recording::default()
        };
        let rows: Vec<(f64, Motion)> = match self.clock {
            None => course.into_iter().step_by(FINE).enumerate().map(|(index, of)| (time_s(index), of)).collect(),
            Some(clock) => {
                let every = FINE / 2;
                let place = |at_s: f64| ((at_s * self.rate_hz * 2.0) as usize).min(course.len() / every);
                let (from, to) = (place(clock.within_s[0]), course.len() / every - place(clock.within_s[1]));
                let stamp = |row: usize| clock.begins_s + 0.5 * time_s(row) * (1.0 + clock.gains);
                let rows = course.iter().step_by(every).enumerate().skip(from).take(to.saturating_sub(from));
                rows.map(|(row, of)| (stamp(row), *of)).collect()
            }
        };
        (recording, rows)
    }

    /// Returns the model that the diagnosis receives, or, with `with_effects`, the true model.
    ///
    /// # Errors
    /// [`ModelError`] for effects that no model can state.
    pub fn model(&self, with_effects: bool) -> Result<SensorModel, ModelError> {
        let mut channels = Map::new();
        let mut triads = Map::new();
        let effects = if with_effects {
            let (course, (_, warmth_c)) = (self.course(), self.warmth());
            self.effects(&course, &warmth_c)
        } else {
            Vec::new()
        };
        let mean_c = if with_effects { self.mean_c() } else { 0.0 };
        for (place, triad) in TRIADS.into_iter().enumerate() {
            let own = |on_channels: bool, axis: usize| -> Option<Value> {
                let all = effects.iter().map(|(_, effect)| effect).filter(|effect| effect.triad == triad);
                let own = all.filter(|effect| effect.kind.on_channels() == on_channels);
                let own: Vec<Value> = own.map(|effect| entry(effect, axis, mean_c)).collect();
                (!own.is_empty()).then(|| own.into())
            };
            for (axis, channel) in triad.channels().into_iter().enumerate() {
                let [n, b, k] = self.nbk[place][axis][1];
                let mut channel_entry = json!({"N": n, "B": b, "K": k});
                if let Some(own) = own(true, axis) {
                    channel_entry["effects"] = own;
                }
                channels.insert(channel.name().to_owned(), channel_entry);
            }
            if let Some(own) = own(false, 0) {
                triads.insert(triad.name().to_owned(), json!({"effects": own}));
            }
        }
        let value = json!({
            "format": "vn100d-sensor-model-1", "name": format!("case {}", self.number), "rate_hz": self.rate_hz,
            "channels": channels, "triads": triads
        });
        SensorModel::from_value(&value, "case")
    }

    fn mean_c(&self) -> f64 {
        let (warm, _) = self.warmth();
        warm.iter().sum::<f64>() / warm.len().max(1) as f64
    }
}

/// Returns an effect in the form of a model's file; for effects on channels, on the axis.
fn entry(effect: &Imposed, axis: usize, mean_c: f64) -> Value {
    let n = &effect.numbers;
    let mut entry = match effect.kind {
        Kind::UnsignedNonlinearity | Kind::SignedNonlinearity => json!({
            "x": n[0], "y": n[1], "z": n[2], "full_scale": full_scale(effect.triad),
            "form": if effect.kind == Kind::SignedNonlinearity { "signed" } else { "unsigned" }
        }),
        Kind::CrossAxisSensitivity => json!({"xy": n[0], "xz": n[1], "yz": n[2]}),
        Kind::GSensitivity => json!({"m": [[n[0], n[1], n[2]], [n[3], n[4], n[5]], [n[6], n[7], n[8]]]}),
        Kind::Latency => json!({"seconds": n[0]}),
        Kind::Saturation => json!({"range": n[0]}),
        Kind::LowPass => json!({"cutoff_hz": n[0]}),
        Kind::TemperatureBias => json!({"per_c": n[axis], "reference_c": mean_c}),
        Kind::TemperatureScale => json!({"x": n[0], "y": n[1], "z": n[2], "reference_c": mean_c}),
        _ => json!({"x": n[0], "y": n[1], "z": n[2]}),
    };
    entry["effect"] = json!(effect.kind.effect());
    entry
}

/// Returns a case's recording, reference and model as bytes for the process that diagnoses them: the length of a
/// parcel, the parcel ([`crate::parcel`]), and the reference's rows.
///
/// # Errors
/// The errors of the parcel's writer.
pub fn pack(case: &Case, model: &SensorModel) -> Result<Vec<u8>, crate::parcel::ParcelError> {
    let (recording, rows) = case.record();
    let parcel = crate::parcel::pack(&recording, model, false)?;
    let mut bytes = (parcel.len() as u64).to_le_bytes().to_vec();
    bytes.extend(parcel);
    for (time_s, motion) in rows {
        let values = [time_s].into_iter().chain(motion.gyro_rad_s).chain(motion.accel_m_s2);
        values.for_each(|value| bytes.extend(value.to_le_bytes()));
    }
    Ok(bytes)
}

/// The reasons why a case with a motion cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// The parcel is not valid.
    #[error(transparent)]
    Parcel(#[from] crate::parcel::ParcelError),
    /// The reference is not valid.
    #[error(transparent)]
    Reference(#[from] ReferenceError),
    /// The bytes end too early.
    #[error("the case ends after {found} bytes; its parcel alone has {expected}")]
    Short {
        /// The number of bytes.
        found: usize,
        /// The expected number of bytes.
        expected: u64,
    },
}

/// Reads the output of [`pack`].
///
/// # Errors
/// [`CaseError`].
pub fn unpack(bytes: &[u8]) -> Result<(Recording, SensorModel, Reference), CaseError> {
    const ROW: usize = 7 * 8;
    let number = |of: &[u8]| of.try_into().map_or(0.0, f64::from_le_bytes);
    let expected = bytes.get(..8).and_then(|of| of.try_into().ok()).map_or(u64::MAX, u64::from_le_bytes);
    let end = usize::try_from(expected).ok().and_then(|length| length.checked_add(8));
    let Some((parcel, rest)) = end.and_then(|end| Some((bytes.get(8..end)?, bytes.get(end..)?))) else {
        return Err(CaseError::Short { found: bytes.len(), expected });
    };
    let crate::parcel::Parcel { recording, model, .. } = crate::parcel::unpack(parcel)?;
    let rows = rest.chunks_exact(ROW).map(|row| {
        let mut values = [0.0; 7];
        values.iter_mut().zip(row.chunks_exact(8)).for_each(|(value, of)| *value = number(of));
        let [time_s, a, b, c, d, e, f] = values;
        (time_s, Motion { gyro_rad_s: [a, b, c], accel_m_s2: [d, e, f], temperature_c: None })
    });
    Ok((recording, model, Reference::new(rows)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_case_is_the_same_every_time_and_crosses_over_whole() {
        let case = || Case::draw(7, 3, &[(Kind::Misalignment, Triad::Gyro), (Kind::Bias, Triad::Accel)], Some(6000));
        let key = case().key();
        assert_eq!(key, case().key());
        assert_eq!(key.digest().len(), 64);
        assert!(key.effects.iter().all(|of| (1.0..=10.0).contains(&of.over_limit) && of.limit > 0.0));
        let (recording, rows) = case().record();
        assert!(recording.channels.iter().all(|(_, values)| values.iter().all(|value| value.is_finite())));
        let bytes = pack(&case(), &case().model(false).unwrap()).unwrap();
        let (again, model, reference) = unpack(&bytes).unwrap();
        assert_eq!(again.channels, recording.channels);
        assert!(model.triads.is_empty() && reference.len() == rows.len());
        let truth = case().model(true).unwrap();
        assert_eq!(truth.triads[&Triad::Gyro].effects[0].name(), "misalignment");
        assert!(unpack(&bytes[..100]).is_err());
    }

    #[test]
    fn every_kind_of_the_library_is_one_that_a_model_can_express() {
        for kind in Kind::LIBRARY {
            for triad in kind.triads() {
                let case = Case::draw(8, 1, &[(*kind, *triad)], Some(6000));
                let model = case.model(true).unwrap();
                let on_triads = model.triads.values().flat_map(|of| &of.effects).map(|effect| effect.name());
                let on_channels = model.channels.values().flat_map(|of| &of.effects).map(|effect| effect.name());
                let names: Vec<&str> = on_triads.chain(on_channels).collect();
                assert!(names.contains(&kind.effect().unwrap().name()), "{kind}");
            }
        }
    }
}
