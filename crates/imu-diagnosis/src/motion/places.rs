//! Places: the rate, acceleration or pose at which a gap driven by a motion lies, and its time.

use super::settle::Settled;
use crate::report::{Driver, Of, Place};
use crate::response::{self, AXES};
use imu_core::sample::Channel;
use imu_model::effects::triad::Axes;
use imu_model::simulator::Motion;
use std::borrow::Cow;

/// Bins of a motion's range.
const BINS: usize = 16;
/// Part of the gap that a stated range holds.
const HELD: f64 = 0.8;
/// A driver that spans this part of its whole range or more carries no information.
const WIDE: f64 = 0.9;
/// Part of the variance of a gap over time that a driver has to account for.
const ACCOUNTED_MIN: f64 = 0.2;
/// How near to upright a pose is, as a part of gravity.
const UPRIGHT: f64 = 0.97;

/// Returns the places of a triad's gap: one per axis with a material part of it.
pub(super) fn places(
    of: &Settled,
    level: Axes,
    late: bool,
    motions: &[Motion],
    rate_hz: f64,
    from_s: f64,
) -> Vec<Place> {
    let columns = of.weighing().columns(&of.choice.groups);
    let (_, numbers) = of.screen.gain(&columns);
    // A delay that is a latency is the first of the base.
    let is_chosen = |place: &usize| *place >= of.base.len() || (late && *place == 0);
    let (chosen, by): (Vec<usize>, Vec<f64>) =
        (0..columns.len()).filter(is_chosen).map(|place| (columns[place], numbers[place])).unzip();
    let mut course = of.screen.course(&chosen, &by);
    for (values, more) in course.iter_mut().zip(of.cut_off.iter().flatten()) {
        values.iter_mut().zip(more).for_each(|(value, more)| *value += more);
    }
    let model = response::expected(of.triad, rate_hz, motions, &of.known, level);
    let totals = course.each_ref().map(|values| values.iter().sum::<f64>());
    let all: f64 = totals.iter().sum();
    let mut places = Vec::new();
    for (axis, channel) in of.triad.channels().into_iter().enumerate() {
        if totals[axis] < (0.02 * all).max(4.0) {
            continue;
        }
        let values = &course[axis];
        let [from, to] = shortest(values, totals[axis]);
        // Samples that are cut off are missing.
        let is_cut = of.cut_off.as_ref().is_some_and(|nats| nats[axis].iter().sum::<f64>() > 0.5 * totals[axis]);
        let rising = if is_cut { -1.0 } else { mean_gap(&of.fit.response[axis], &model[axis], values) };
        let at_s = [from, to].map(|index| from_s + index as f64 / rate_hz);
        let mut place = driven(channel, at_s, values.len(), rate_hz, rising >= 0.0);
        (place.at, place.nats, place.p_value) = (driver(values, motions), totals[axis], (-totals[axis]).exp());
        places.push(place);
    }
    places
}

/// Returns a place of a gap that a motion drives during `length` samples, without its driver and its nats.
pub(super) fn driven(
    channel: Channel,
    [from_s, to_s]: [f64; 2],
    length: usize,
    rate_hz: f64,
    is_higher: bool,
) -> Place {
    Place {
        // The cause of a gap, and the share of a place, are known once all causes are ranked.
        of: Of::Remainder,
        channel: channel.name().to_owned(),
        // The gap that a motion drives is as slow as the motion: from the length to the motion's own changes.
        band_hz: [0.0, rate_hz / 2.0],
        tau_s: [1.0 / rate_hz, length as f64 / rate_hz],
        from_s,
        to_s,
        temperature_c: None,
        at: None,
        share: 0.0,
        nats: 0.0,
        p_value: 1.0,
        sign: if is_higher { "real higher" } else { "real lower" }.into(),
    }
}

/// Returns whether the sensor shows more than the model at the place of the gap, weighted by the gap.
fn mean_gap(response: &[f64], model: &[f64], weights: &[f64]) -> f64 {
    response.iter().zip(model).zip(weights).map(|((response, model), weight)| weight * (response - model)).sum()
}

/// Returns the shortest stretch of time, in blocks of a hundredth, that has most of the total.
fn shortest(values: &[f64], total: f64) -> [usize; 2] {
    const PARTS: usize = 100;
    let n = values.len();
    let edge = |part: usize| n * part / PARTS;
    let sums: Vec<f64> = (0..PARTS).map(|part| values[edge(part)..edge(part + 1)].iter().sum()).collect();
    let [from, to] = narrowest(&sums, HELD * total);
    [edge(from), edge(to)]
}

/// Returns the fewest neighbouring places with a sum of at least `least`.
fn narrowest(sums: &[f64], least: f64) -> [usize; 2] {
    let (mut best, mut from, mut sum) = ([0, sums.len()], 0, 0.0);
    for (to, value) in sums.iter().enumerate() {
        sum += value;
        while from <= to && sum - sums[from] >= least {
            sum -= sums[from];
            from += 1;
        }
        if sum >= least && to + 1 - from < best[1] - best[0] {
            best = [from, to + 1];
        }
    }
    best
}

/// Returns the rate or acceleration on which the gap depends most: the one whose bins account for the largest part of
/// its variance over time.
fn driver(values: &[f64], motions: &[Motion]) -> Option<Driver> {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    let whole: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    let mut best: Option<(f64, Driver)> = None;
    for (quantity, unit) in [("rate", "rad/s"), ("acceleration", "m/s²")] {
        for (axis, name) in AXES.into_iter().enumerate() {
            let of =
                |motion: &Motion| if quantity == "rate" { motion.gyro_rad_s[axis] } else { motion.accel_m_s2[axis] };
            let (low, high) =
                motions.iter().map(of).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            let least = if quantity == "rate" { 1e-3 } else { 1e-2 };
            if high - low < least {
                continue;
            }
            let bin = |motion: &Motion| (((of(motion) - low) / (high - low) * BINS as f64) as usize).min(BINS - 1);
            let (mut sums, mut counts) = ([0.0; BINS], [0.0; BINS]);
            for (value, motion) in values.iter().zip(motions) {
                sums[bin(motion)] += value;
                counts[bin(motion)] += 1.0;
            }
            let between: f64 = sums
                .iter()
                .zip(&counts)
                .filter(|(_, count)| **count > 0.0)
                .map(|(sum, count)| count * (sum / count - mean).powi(2))
                .sum();
            let part = between / whole.max(f64::MIN_POSITIVE);
            let [from, to] = narrowest(&sums, HELD * sums.iter().sum::<f64>());
            if (to - from) as f64 > WIDE * BINS as f64 || part < ACCOUNTED_MIN {
                continue;
            }
            let edge = |place: usize| low + (high - low) * place as f64 / BINS as f64;
            let range = [edge(from), edge(to)];
            if best.as_ref().is_none_or(|(most, _)| part > *most) {
                let pose = (quantity == "acceleration").then(|| pose(name, range)).flatten();
                let [quantity, axis, unit] = [quantity, name, unit].map(Cow::from);
                best = Some((part, Driver { quantity, axis, unit, range, pose }));
            }
        }
    }
    best.map(|(_, driver)| driver)
}

/// Returns the pose of a range of specific force: the support of a sensor pushes it away from the Earth.
fn pose(axis: &str, [low, high]: [f64; 2]) -> Option<String> {
    let gravity = imu_core::units::STANDARD_GRAVITY_M_S2;
    if high >= UPRIGHT * gravity && low > 0.0 {
        return Some(format!("{axis} up"));
    }
    (low <= -UPRIGHT * gravity && high < 0.0).then(|| format!("{axis} down"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_at_which_a_gap_lies_is_reported() {
        let rate = |t: usize| if (t / 100) % 3 == 2 { 3.0 } else { (t / 100 % 3) as f64 - 1.0 };
        let motions: Vec<Motion> =
            (0..3000).map(|t| Motion { gyro_rad_s: [0.0, rate(t), 0.0], ..Motion::default() }).collect();
        let values: Vec<f64> = motions.iter().map(|of| if of.gyro_rad_s[1] > 2.0 { 1.0 } else { 0.01 }).collect();
        let found = driver(&values, &motions).unwrap();
        assert_eq!((&*found.quantity, &*found.axis), ("rate", "y"));
        assert!(found.range[0] > 1.0 && (found.range[1] - 3.0).abs() < 1e-9, "{:?}", found.range);
        assert_eq!(driver(&vec![1.0; 3000], &motions), None);
        assert_eq!(narrowest(&[0.0, 1.0, 5.0, 4.0, 0.1], 8.0), [2, 4]);
        assert_eq!((pose("z", [-9.9, -8.0]), pose("x", [8.0, 9.9])), (Some("z down".into()), Some("x up".into())));
    }
}
