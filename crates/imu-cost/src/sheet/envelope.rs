//! The envelope of a sheet's recordings: what they cover, and where the model has therefore not been validated.

use super::{Comparison, Evidence};
use crate::USED;
use crate::request::Quantity;
use crate::shown::time;
use imu_core::sample::Channel;
use imu_model::EffectKind;
use imu_model::effects::Effect;
use imu_model::simulator::SensorModel;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

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
    /// Begin and end since switch-on, s.
    pub since_switch_on_s: [f64; 2],
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
            since_switch_on_s: [of.begin_s, end_s(of)],
            specific_force_m_s2: means.collect(),
        }
    }
}

/// Returns whether each sample is missing, without an end.
fn missing<'a>(of: &'a Evidence<'_>) -> impl Iterator<Item = bool> + 'a {
    of.rest.missing.iter().copied().chain(std::iter::repeat(false))
}

/// Returns the end of a recording since switch-on, s.
fn end_s(of: &Evidence<'_>) -> f64 {
    of.begin_s + of.rest.channels.first().map_or(0, |(_, values)| values.len()) as f64 / of.rest.rate_hz
}

fn is_accel(channel: Channel) -> bool {
    [Channel::AccelX, Channel::AccelY, Channel::AccelZ].contains(&channel)
}

fn is_gyro(channel: Channel) -> bool {
    [Channel::GyroX, Channel::GyroY, Channel::GyroZ].contains(&channel)
}

impl Envelope {
    pub(super) fn of(evidence: &[&Evidence<'_>], recordings: Vec<Covered>) -> Self {
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
        let ends = evidence.iter().map(|of| end_s(of));
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
            let without = quantities.get(quantity).map(|of| {
                let open = of.iter().zip(horizons_s).filter(|(found, _)| found.is_none());
                open.map(|(_, horizon_s)| time(*horizon_s)).collect::<Vec<_>>()
            });
            match without {
                None => {
                    all.push(format!("{quantity}: model or recordings lack its channels, or it has no closed form"));
                }
                Some(without) if without.len() == horizons_s.len() => {
                    all.push(format!("{quantity}: too few pieces at every horizon, or no noise to compare"));
                }
                Some(without) if !without.is_empty() => {
                    all.push(format!("{quantity} after {}: too few pieces", without.join(", ")));
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
        all.extend(others("units", self.recordings.iter().map(|of| of.unit.as_deref())));
        all.extend(others("days", self.recordings.iter().map(|of| of.date.as_deref())));
        let spans = union(self.recordings.iter().map(|of| of.since_switch_on_s));
        let spans: Vec<String> = spans.iter().map(|[from, to]| format!("{} to {}", time(*from), time(*to))).collect();
        all.push(format!("times from switch-on other than {}", spans.join(", ")));
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
        let ranges = union(self.recordings.iter().filter_map(|of| of.temperature_c));
        if ranges.is_empty() {
            return vec!["temperatures: the recordings have none".to_owned()];
        }
        let list: Vec<String> = ranges.iter().map(|[low, high]| format!("{low:.1} to {high:.1}")).collect();
        let mut all = vec![format!("temperatures other than {} °C", list.join(", "))];
        let unknown = self.recordings.iter().filter(|of| of.temperature_c.is_none()).count();
        if unknown > 0 {
            all.push(format!("the temperature of {unknown} of the recordings, which have none"));
        }
        let moved = ranges.last().map_or(0.0, |of| of[1]) - ranges.first().map_or(0.0, |of| of[0]);
        if has_effect && moved < SAME_TEMPERATURE_K {
            all.push(format!("temperature_bias: the temperature moved by {moved:.2} K"));
        }
        all
    }
}

/// Returns a sentence on other units or days, unless every recording states its own and there are several.
fn others<'a>(what: &str, stated: impl Iterator<Item = Option<&'a str>>) -> Option<String> {
    let stated: Vec<Option<&str>> = stated.collect();
    let unknown = stated.iter().filter(|of| of.is_none()).count();
    let known: BTreeSet<&str> = stated.into_iter().flatten().collect();
    match (known.len(), unknown) {
        (0, _) => Some(format!("other {what}: the recordings do not state theirs")),
        (1, 0) => Some(format!("other {what}: the recordings are of one")),
        (known, 1..) => {
            Some(format!("other {what}: {unknown} recordings do not state theirs, the others are of {known}"))
        }
        _ => None,
    }
}

/// Returns ranges without overlaps, in order.
fn union(ranges: impl Iterator<Item = [f64; 2]>) -> Vec<[f64; 2]> {
    let mut all: Vec<[f64; 2]> = ranges.collect();
    all.sort_by(|one, other| one[0].total_cmp(&other[0]));
    let mut joined: Vec<[f64; 2]> = Vec::new();
    for range in all {
        match joined.last_mut().filter(|last| range[0] <= last[1]) {
            Some(last) => last[1] = last[1].max(range[1]),
            None => joined.push(range),
        }
    }
    joined
}
