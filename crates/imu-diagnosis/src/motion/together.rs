//! Together: the effects that a motion drives and the remainder without them form one gap with one ranking of causes.
//!
//! Both gaps are in nats of the whole record, so they add, and a cause of either closes its part of their sum. Values
//! that were compared in one rest alone count as constant per sample throughout.

use crate::report::{Cause, Diagnosis, Of, Place, Sense, Verdict};
use crate::response::{NORMAL_95, is_alike};
use imu_core::sample::Triad;
use imu_model::effects::{Stream, StreamId, TriadEffect};
use imu_model::simulator::{SensorModel, TriadModel};
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Draws of blocks for an interval of the closed part.
const DRAWS: usize = 1000;

/// A cause on a triad before it is reported.
pub(super) struct Driven {
    pub(super) triad: Triad,
    pub(super) effect: Arc<dyn TriadEffect>,
    /// Nats gained, with all other effects fitted again. `None` for a cause that is read off exactly and that no
    /// held-out data measure.
    pub(super) gain: Option<f64>,
    pub(super) rank: f64,
    pub(super) cause: Cause,
}

impl Driven {
    pub(super) fn new(
        triad: Triad,
        effect: Arc<dyn TriadEffect>,
        gain: Option<f64>,
        channels: Vec<String>,
        confidence: f64,
        uncertainty: Value,
        evidence: Vec<String>,
    ) -> Self {
        let own: Map<String, Value> =
            effect.parameters().into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        let mut intervals = Map::new();
        if uncertainty.as_object().is_some_and(|of| !of.is_empty()) {
            intervals.insert(triad.name().to_owned(), uncertainty);
        }
        let cause = Cause {
            effect: effect.kind(),
            sense: Sense::Missing,
            triad: Some(triad.name().into()),
            channels,
            confidence,
            closes: None,
            parameters: BTreeMap::from([(triad.name().to_owned(), Value::Object(own))]),
            model: BTreeMap::new(),
            uncertainty: intervals,
            evidence,
            cost: BTreeMap::new(),
        };
        Self { triad, effect, gain, rank: gain.unwrap_or_default(), cause }
    }
}

/// The gap that a motion drives, nats.
#[derive(Default)]
pub(super) struct Sums {
    /// By block of time; one entry if there are no blocks.
    pub(super) whole: Vec<f64>,
    pub(super) closed: Vec<f64>,
    /// The number of fitted numbers.
    pub(super) numbers: usize,
}

impl Sums {
    /// Returns the gain of the numbers in noise alone.
    pub(super) fn floor(&self) -> f64 {
        0.5 * self.numbers as f64
    }
}

/// Adds a motion's gap, its causes and its places to the findings in the remainder. `all` is the number of samples of
/// all channels; `measured` is the number of samples on which the motion's gap was measured.
pub(super) fn join(
    diagnosis: &mut Diagnosis,
    sums: &Sums,
    driven: &mut [Driven],
    located: Vec<Place>,
    all: f64,
    measured: &str,
) {
    let rest_nats = rest_nats(diagnosis, all);
    let ranked_alone = diagnosis.causes.clone();
    rank(diagnosis, driven, rest_nats, sums);
    shrink(diagnosis, sums, all, rest_nats, driven);
    let gap = &mut diagnosis.discrepancy;
    gap.measured_on = format!("{measured}; of the rest the {}", gap.measured_on);
    let total = (sums.whole.iter().sum::<f64>() + rest_nats).max(f64::MIN_POSITIVE);
    let shares = diagnosis.r#where.iter_mut().map(|place| &mut place.share);
    shares.chain(diagnosis.remainder.iter_mut().map(|of| &mut of.share)).for_each(|share| *share *= rest_nats / total);
    let causes = &diagnosis.causes;
    let same = |one: &Cause, other: &Cause| {
        (&one.effect, one.sense, &one.triad, &one.channels)
            == (&other.effect, other.sense, &other.triad, &other.channels)
    };
    for place in &mut diagnosis.r#where {
        if let Of::Cause(index) = &mut place.of {
            *index = causes.iter().position(|cause| same(cause, &ranked_alone[*index])).unwrap_or(*index);
        }
    }
    diagnosis.r#where.extend(located.into_iter().map(|mut place| {
        place.share = (place.nats / total).min(1.0);
        // A place of the motion belongs to the strongest of the triad's causes.
        let acts = |cause: &Cause| cause.triad.is_some() && cause.channels.contains(&place.channel);
        place.of = causes.iter().position(acts).map_or(Of::Remainder, Of::Cause);
        place
    }));
    diagnosis.r#where.sort_by(|one, other| other.share.total_cmp(&one.share));
}

/// Returns the nats of the gap that remain without the motion's gap, if that gap counts.
fn rest_nats(of: &Diagnosis, all: f64) -> f64 {
    match of.verdict {
        Verdict::Effects | Verdict::UnknownEffect => {
            ((of.discrepancy.after_parameters - of.discrepancy.floor) * all).max(0.0)
        }
        _ => 0.0,
    }
}

/// Adds the motion's gap to that of the remainder.
fn shrink(diagnosis: &mut Diagnosis, sums: &Sums, all: f64, rest: f64, driven: &[Driven]) {
    let gap = &mut diagnosis.discrepancy;
    let (whole, closed): (f64, f64) = (sums.whole.iter().sum(), sums.closed.iter().sum());
    let (floor, blocks) = (sums.floor(), sums.whole.len());
    let rest_closed = gap.closed.map_or(0.0, |part| part * rest);
    let rest_error = gap.closed_ci95.map_or(0.0, |[low, high]| (high - low) / (2.0 * NORMAL_95) * rest);
    let ratio_is_known = driven.iter().any(|one| one.gain.is_some()) || gap.closed.is_some();
    let ratio = |whole: f64, closed: f64, more: f64| (closed + rest_closed + more) / (whole - floor + rest);
    if ratio_is_known && whole > floor {
        gap.closed = Some(ratio(whole, closed, 0.0)).filter(|value| value.is_finite());
        gap.closed_ci95 = None;
    }
    if ratio_is_known && whole > floor && blocks > 1 {
        let mut stream = Stream::new(blocks as u64, StreamId { owner: 0, effect: 3, instance: 0 });
        let mut draw = || {
            let (mut some_whole, mut some_closed) = (0.0, 0.0);
            for _ in 0..blocks {
                let block = ((stream.uniform() * blocks as f64) as usize).min(blocks - 1);
                some_whole += sums.whole[block];
                some_closed += sums.closed[block];
            }
            ratio(some_whole, some_closed, rest_error * stream.normal())
        };
        let mut draws: Vec<f64> = (0..DRAWS).map(|_| draw()).filter(|value| value.is_finite()).collect();
        draws.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| draws.get((share * draws.len() as f64) as usize).copied();
        gap.closed_ci95 = at(0.025).zip(at(0.975)).map(|(low, high)| [low, high]);
    }
    gap.before += whole / all;
    gap.after_parameters += whole / all;
    gap.after += (whole - closed) / all;
    gap.floor += floor / all;
}

/// Ranks causes of both kinds, the strongest first, each with the part that it closes.
fn rank(diagnosis: &mut Diagnosis, driven: &mut [Driven], rest_nats: f64, sums: &Sums) {
    let motion: f64 = driven.iter().filter_map(|one| one.gain).sum();
    let closed: f64 = sums.closed.iter().sum();
    let (whole, floor) = (sums.whole.iter().sum::<f64>(), sums.floor());
    let all = (whole - floor).max(0.0) + rest_nats;
    for one in driven.iter_mut() {
        one.cause.closes = one.gain.filter(|_| motion > 0.0 && all > 0.0).map(|gain| gain / motion * closed / all);
    }
    let mut ranked: Vec<(f64, Cause)> = driven.iter().map(|one| (one.rank, one.cause.clone())).collect();
    // A cause that is read off exactly closes no part; it keeps its place before the others.
    let mut least = 0.0f64;
    for mut cause in std::mem::take(&mut diagnosis.causes).into_iter().rev() {
        let nats = cause.closes.map_or(0.0, |part| part * rest_nats);
        if all > 0.0 {
            cause.closes = cause.closes.map(|_| nats / all);
        }
        least = least.max(nats);
        ranked.push((least, cause));
    }
    ranked[driven.len()..].reverse();
    ranked.sort_by(|one, other| other.0.total_cmp(&one.0));
    diagnosis.causes = ranked.into_iter().map(|(_, cause)| cause).collect();
}

/// Returns the model's effects on triads with found effects in place of those of the same kind.
pub(super) fn corrected(sim: &SensorModel, driven: &[Driven]) -> BTreeMap<Triad, TriadModel> {
    let mut triads = sim.triads.clone();
    for one in driven {
        let effects = &mut triads.entry(one.triad).or_default().effects;
        effects.retain(|effect| !is_alike(&**effect, &*one.effect));
        effects.push(Arc::clone(&one.effect));
    }
    triads
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::diagnose;
    use crate::options::Options;
    use crate::recording::Recording;
    use imu_core::sample::Channel;
    use imu_model::effects::triad::ScaleFactor;
    use serde_json::json;

    /// Returns the diagnosis of a record at rest with rounded values and a tone.
    fn at_rest() -> Diagnosis {
        let channel = json!({"N": 1e-4, "effects": [{"effect": "resolution", "step": 1e-3},
            {"effect": "tone", "frequency_hz": 7.3, "amplitude": 2e-3}]});
        let of = |channel| {
            SensorModel::from_value(
                &json!({"format": "vn100d-sensor-model-1", "name": "t", "rate_hz": 40, "channels": {"gyro_x": channel}}),
                "test",
            )
            .unwrap()
        };
        let mut simulator = imu_model::simulator::Simulator::new(&of(channel), 4, 40.0, 300.0).unwrap();
        let values = std::iter::from_fn(|| simulator.next_sample()).take(12_000);
        let values = values.map(|sample| sample.values[Channel::GyroX as usize]).collect();
        let real = Recording { rate_hz: 40.0, channels: vec![(Channel::GyroX, values)], ..Recording::default() };
        diagnose(&real, &of(json!({"N": 1e-4})), &Options::default()).unwrap().diagnosis
    }

    fn joined(gain: f64, whole: &[f64], closed: &[f64]) -> Diagnosis {
        let mut diagnosis = at_rest();
        let effect = Arc::new(ScaleFactor { axes: [1e-3, 0.0, 0.0] });
        let mut driven =
            [Driven::new(Triad::Gyro, effect, Some(gain), vec!["gyro_x".to_owned()], 0.99, Value::Null, Vec::new())];
        let sums = Sums { whole: whole.to_vec(), closed: closed.to_vec(), numbers: 3 };
        join(&mut diagnosis, &sums, &mut driven, Vec::new(), 12_000.0, "blocks");
        diagnosis
    }

    #[test]
    fn causes_of_both_are_ranked_together_and_close_parts_of_one_gap() {
        let rest = at_rest();
        let names = |of: &Diagnosis| of.causes.iter().map(|cause| cause.effect.name()).collect::<Vec<_>>();
        assert!(names(&rest).contains(&"resolution") && names(&rest).contains(&"tone"), "{:?}", names(&rest));
        // The motion's gap is far larger than the rest, with almost nothing beside it.
        let more = joined(1e6, &[6e5, 4e5], &[6e5, 4e5]);
        assert_eq!(names(&more)[0], "scale_factor");
        let less = joined(5.0, &[3.0, 3.0], &[2.0, 2.0]);
        let place = |of: &str| names(&less).iter().position(|name| *name == of).unwrap();
        assert!(place("scale_factor") > place("tone"));
        let others: Vec<&str> = names(&less).into_iter().filter(|name| *name != "scale_factor").collect();
        assert_eq!(others, names(&rest));
        for of in [&more, &less] {
            let all: f64 = of.causes.iter().filter_map(|cause| cause.closes).sum();
            assert!((all - of.discrepancy.closed.unwrap()).abs() < 0.02, "{all} {:?}", of.discrepancy);
            let shares: f64 = of.r#where.iter().map(|place| place.share).sum();
            assert!(shares <= 1.0 + 1e-9, "{shares}");
        }
        assert!((more.discrepancy.before - rest.discrepancy.before - 1e6 / 12_000.0).abs() < 1e-6);
    }

    #[test]
    fn one_block_has_no_interval() {
        assert!(joined(1e4, &[1e4], &[9e3]).discrepancy.closed_ci95.is_none());
        assert!(joined(1e4, &[5e3, 5e3], &[4e3, 5e3]).discrepancy.closed_ci95.is_some());
    }
}
