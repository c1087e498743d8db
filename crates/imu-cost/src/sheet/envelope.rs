//! The envelope of a sheet's recordings: what they cover, and where the model has therefore not been validated.

use super::{Comparison, Evidence};
use crate::USED;
use crate::request::Quantity;
use imu_core::sample::Channel;
use imu_core::units::format_duration;
use imu_model::EffectKind;
use imu_model::effects::Effect;
use imu_model::simulator::SensorModel;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// A temperature that moves by less shows nothing of an effect of temperature, K.
const SAME_TEMPERATURE_K: f64 = 1.0;
/// Poses whose specific forces differ by less are one.
const SAME_POSE_M_S2: f64 = 1.0;

/// What recordings cover.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Envelope {
    /// The recordings.
    pub recordings: Vec<Covered>,
    /// Samples per second.
    pub rate_hz: f64,
    /// Time of the present samples of all, s.
    pub total_s: f64,
    /// The least and the largest temperature, °C; null if none was measured.
    pub temperature_c: Option<[f64; 2]>,
    /// From the earliest to the latest time since switch-on, s.
    pub since_switch_on_s: [f64; 2],
    /// The largest size of each angular rate, rad/s, and of each specific force, m/s².
    pub largest: BTreeMap<Channel, f64>,
    /// The units, such as serial numbers; empty if none is known.
    pub units: BTreeSet<String>,
    /// The dates; empty if none is known.
    pub dates: BTreeSet<String>,
}

/// One recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Covered {
    /// Its name.
    pub name: String,
    /// Time of its present samples, s.
    pub length_s: f64,
    /// The unit, if it is known.
    pub unit: Option<String>,
    /// The date, if it is known.
    pub date: Option<String>,
    /// The least and the largest temperature, °C, if it was measured.
    pub temperature_c: Option<[f64; 2]>,
    /// Mean specific force along x, y and z, m/s², of the axes that it has: the pose.
    pub specific_force_m_s2: BTreeMap<Channel, f64>,
}

impl Covered {
    pub(super) fn by(of: &Evidence<'_>, length_s: f64) -> Self {
        let means =
            of.rest.channels.iter().filter(|(channel, _)| is_accel(*channel)).filter_map(|(channel, values)| {
                let there = values.iter().zip(missing(of)).filter(|(value, missing)| value.is_finite() && !missing);
                let (sum, count) = there.fold((0.0, 0.0), |(sum, count), (value, _)| (sum + value, count + 1.0));
                (count > 0.0).then(|| (*channel, sum / count))
            });
        Self {
            name: of.name.clone(),
            length_s,
            unit: of.unit.clone(),
            date: of.date.clone(),
            temperature_c: of.temperature_c,
            specific_force_m_s2: means.collect(),
        }
    }
}

/// Returns whether each sample is missing, without an end.
fn missing<'a>(of: &'a Evidence<'_>) -> impl Iterator<Item = bool> + 'a {
    of.rest.missing.iter().copied().chain(std::iter::repeat(false))
}

fn is_accel(channel: Channel) -> bool {
    [Channel::AccelX, Channel::AccelY, Channel::AccelZ].contains(&channel)
}

fn is_gyro(channel: Channel) -> bool {
    [Channel::GyroX, Channel::GyroY, Channel::GyroZ].contains(&channel)
}

fn time(time_s: f64) -> String {
    Duration::try_from_secs_f64(time_s).map_or_else(|_| format!("{time_s} s"), format_duration)
}

impl Envelope {
    pub(super) fn of(evidence: &[Evidence<'_>], recordings: Vec<Covered>) -> Self {
        let mut largest: BTreeMap<Channel, f64> = BTreeMap::new();
        for of in evidence {
            for (channel, values) in of.rest.channels.iter().filter(|(own, _)| is_accel(*own) || is_gyro(*own)) {
                let there = values.iter().zip(missing(of)).filter(|(value, missing)| value.is_finite() && !missing);
                let own = there.fold(0.0_f64, |most, (value, _)| most.max(value.abs()));
                largest.entry(*channel).and_modify(|most| *most = most.max(own)).or_insert(own);
            }
        }
        let temperatures = evidence.iter().filter_map(|of| of.temperature_c);
        let temperature_c = temperatures.reduce(|one, other| [one[0].min(other[0]), one[1].max(other[1])]);
        let begin_s = evidence.iter().map(|of| of.begin_s).fold(f64::INFINITY, f64::min);
        let ends = evidence.iter().map(|of| {
            let samples = of.rest.channels.first().map_or(0, |(_, values)| values.len());
            of.begin_s + samples as f64 / of.rest.rate_hz
        });
        Self {
            rate_hz: evidence.first().map_or(0.0, |of| of.rest.rate_hz),
            total_s: recordings.iter().map(|of| of.length_s).sum(),
            temperature_c,
            since_switch_on_s: [begin_s, ends.fold(begin_s, f64::max)],
            largest,
            units: recordings.iter().filter_map(|of| of.unit.clone()).collect(),
            dates: recordings.iter().filter_map(|of| of.date.clone()).collect(),
            recordings,
        }
    }

    /// Returns where the model has not been validated, one sentence each.
    pub(super) fn outside(
        &self,
        model: &SensorModel,
        quantities: &BTreeMap<Quantity, Vec<Option<Comparison>>>,
        horizons_s: &[f64],
    ) -> Vec<String> {
        let mut all = Vec::new();
        for quantity in Quantity::all() {
            let last = quantities.get(quantity).map(|of| {
                let with_number = of.iter().zip(horizons_s).filter(|(found, _)| found.is_some());
                with_number.map(|(_, horizon_s)| *horizon_s).fold(0.0, f64::max)
            });
            match last {
                None => {
                    all.push(format!("{quantity}: model or recordings lack its channels, or it has no closed form"))
                }
                Some(last) if last == 0.0 => all.push(format!("{quantity}: too few pieces at every horizon")),
                Some(last) if horizons_s.last().is_some_and(|end| last < *end) => {
                    all.push(format!("{quantity} beyond {}: too few pieces", time(last)));
                }
                Some(_) => {}
            }
        }
        if let Some(last) = horizons_s.last() {
            all.push(format!("horizons beyond {}", time(*last)));
        }
        let unused: Vec<&str> = model.channels.keys().filter(|of| !USED.contains(of)).map(|of| of.name()).collect();
        if !unused.is_empty() {
            all.push(format!("{}: unaided integration at rest does not use them", unused.join(", ")));
        }
        all.extend(self.outside_temperature(model));
        let motion = "motion: the recordings are at rest";
        let acting: BTreeSet<&str> =
            model.triads.values().flat_map(|of| &of.effects).map(|effect| effect.name()).collect();
        all.push(match acting.is_empty() {
            true => motion.to_owned(),
            false => format!("{motion}, and show nothing of {}", acting.into_iter().collect::<Vec<_>>().join(", ")),
        });
        if !self.has_poses() {
            all.push("other poses: the recordings show one".to_owned());
        }
        match self.units.len() {
            0 => all.push("other units: the recordings do not state theirs".to_owned()),
            1 => all.push("other units: the recordings are of one".to_owned()),
            _ => {}
        }
        match self.dates.len() {
            0 => all.push("other days: the recordings do not state theirs".to_owned()),
            1 => all.push("other days: the recordings are of one".to_owned()),
            _ => {}
        }
        let [from, to] = self.since_switch_on_s;
        let before = if from > 0.0 { format!("before {} and ", time(from)) } else { String::new() };
        all.push(format!("times {before}after {} from switch-on", time(to)));
        all
    }

    /// Returns whether recordings differ in pose.
    fn has_poses(&self) -> bool {
        let Some((first, others)) = self.recordings.split_first() else { return false };
        let apart = |other: &Covered| {
            first.specific_force_m_s2.iter().any(|(channel, value)| {
                other.specific_force_m_s2.get(channel).is_some_and(|of| (of - value).abs() > SAME_POSE_M_S2)
            })
        };
        others.iter().any(apart)
    }

    fn outside_temperature(&self, model: &SensorModel) -> Vec<String> {
        let depends = |effect: &&Arc<dyn Effect>| effect.kind() == EffectKind::TemperatureBias;
        let has_effect = model.channels.values().flat_map(|of| &of.effects).any(|of| depends(&of));
        match self.temperature_c {
            None => vec!["temperatures: the recordings have none".to_owned()],
            Some([low, high]) => {
                let mut all = vec![format!("temperatures below {low:.1} °C and above {high:.1} °C")];
                if has_effect && high - low < SAME_TEMPERATURE_K {
                    all.push(format!("temperature_bias: the temperature moved by {:.2} K", high - low));
                }
                all
            }
        }
    }
}
