//! Rests: the stretches of a record in which the sensor lies still, and the poses in the rests.
//!
//! A quarter of a second is quiet if gyro and accelerometer scatter about as little as in the quietest tenth of the record.
//! Consecutive quiet parts that keep their level are a rest. A sensor that is never still has no rests.

use std::ops::Range;

/// Length of the examined parts, s.
const PART_S: f64 = 0.25;
/// Shortest rest, s.
pub const SHORTEST_S: f64 = 1.5;
/// Part of the record that counts as the quietest.
const QUIETEST: f64 = 0.1;
/// A part is quiet up to this multiple of the standard deviation of the quietest parts, and of the deviation of a
/// part's mean.
const QUIET: f64 = 2.5;
/// Maximum movement of a level in a rest, m/s² and rad/s: more than a hand's tremble, less than any turn.
const MOVED: [f64; 2] = [0.15, 0.03];
/// Cosine of 8°, the angle from which on two poses differ.
const APART: f64 = 0.990_268;

/// A stretch in which the sensor lies still.
#[derive(Debug, Clone, PartialEq)]
pub struct Rest {
    /// The samples of the rest.
    pub within: Range<usize>,
    /// Mean specific force, m/s².
    pub force: [f64; 3],
    /// Mean rate, rad/s, if there is a gyro.
    pub rate: Option<[f64; 3]>,
}

/// Returns the samples of an examined part, the same at rates that differ by less than a percent.
pub(super) fn samples(rate_hz: f64) -> usize {
    ((PART_S * rate_hz + 0.2) as usize).max(4)
}

/// Returns the rests of an accelerometer (m/s²) and, if there is one, a gyro (rad/s), in order. `is_missing` states whether a sample
/// is missing or the first behind a gap.
///
/// # Validation
/// On the recordings of imu_tk, mikoff and Seoul's tumble this finds the rests that their authors count
/// (docs/calibration.md).
pub fn rests(
    rate_hz: f64,
    accel: [&[f64]; 3],
    gyro: Option<[&[f64]; 3]>,
    is_missing: &dyn Fn(usize) -> bool,
) -> Vec<Rest> {
    let size = samples(rate_hz);
    let parts = accel[0].len() / size;
    if parts < 4 {
        return Vec::new();
    }
    let part = |place: usize| place * size..(place + 1) * size;
    let of = |columns: [&[f64]; 3]| -> Vec<Option<([f64; 3], f64)>> {
        (0..parts)
            .map(|place| {
                let gone = part(place).any(is_missing);
                let means = columns.map(|values| mean(&values[part(place)]));
                let square = columns.iter().zip(means).map(|(values, mean)| {
                    values[part(place)].iter().map(|value| (value - mean).powi(2)).sum::<f64>() / size as f64
                });
                let spread = square.sum::<f64>().sqrt();
                (!gone && spread.is_finite()).then_some((means, spread))
            })
            .collect()
    };
    let forces = of(accel);
    let rates = gyro.map(of);
    let (least_force, least_rate) = (quietest(&forces), rates.as_ref().map_or(0.0, |of| quietest(of)));
    // The permitted movement of a part beyond its noise: the scatter of the noise itself and a tremble.
    let quiet = |place: usize| {
        let still = |of: &Option<([f64; 3], f64)>, least: f64, moved: f64| {
            of.as_ref().is_some_and(|(_, spread)| *spread <= QUIET * least + 0.1 * moved)
        };
        still(&forces[place], least_force, MOVED[0])
            && rates.as_ref().is_none_or(|rates| still(&rates[place], least_rate, MOVED[1]))
    };
    // A table that turns steadily is quiet too. At rest the rate is the slowest one: the gyro's bias.
    let pace = |place: usize| {
        let of = rates.as_ref().and_then(|rates| rates[place].as_ref());
        of.map_or(0.0, |(rate, _)| rate.iter().map(|value| value * value).sum::<f64>().sqrt())
    };
    let slowest = (0..parts).filter(|place| quiet(*place)).map(pace).fold(f64::INFINITY, f64::min);
    let quiet = |place: usize| quiet(place) && pace(place) <= slowest + MOVED[1];
    let goes_on = |run: &Range<usize>, place: usize| {
        let apart = |of: &[Option<([f64; 3], f64)>], most: f64, least: f64| {
            let (Some((first, _)), Some((now, _))) = (&of[run.start], &of[place]) else { return true };
            let far = first.iter().zip(now).map(|(one, other)| (one - other).powi(2)).sum::<f64>().sqrt();
            far > most + QUIET * least / (size as f64).sqrt()
        };
        !apart(&forces, MOVED[0], least_force) && !rates.as_ref().is_some_and(|of| apart(of, MOVED[1], least_rate))
    };
    let mut found = Vec::new();
    let mut open: Option<Range<usize>> = None;
    for place in 0..=parts {
        let is_quiet = place < parts && quiet(place);
        match &mut open {
            Some(run) if is_quiet && goes_on(run, place) => run.end = place + 1,
            None if is_quiet => open = Some(place..place + 1),
            Some(run) => {
                // The first and the last part may touch a turn.
                let within = (run.start + 1) * size..run.end.saturating_sub(1) * size;
                // A rate that is a little off is the same rest.
                if within.len() as f64 >= 0.98 * SHORTEST_S * rate_hz {
                    let over = |columns: [&[f64]; 3]| columns.map(|values| mean(&values[within.clone()]));
                    found.push(Rest { force: over(accel), rate: gyro.map(over), within });
                }
                open = is_quiet.then(|| place..place + 1);
            }
            None => {}
        }
    }
    found
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Returns the scatter of the quietest parts.
fn quietest(of: &[Option<([f64; 3], f64)>]) -> f64 {
    let mut spreads: Vec<f64> = of.iter().flatten().map(|(_, spread)| *spread).collect();
    spreads.sort_unstable_by(f64::total_cmp);
    spreads.get((QUIETEST * spreads.len() as f64) as usize).copied().unwrap_or(0.0)
}

/// Returns the pose of each rest, from 0 in the order of their first rests, and `None` for one without a direction.
pub fn poses(forces: impl Iterator<Item = [f64; 3]>) -> Vec<Option<usize>> {
    let mut seen: Vec<[f64; 3]> = Vec::new();
    forces
        .map(|force| {
            let length = force.iter().map(|value| value * value).sum::<f64>().sqrt();
            if length < 1.0 {
                return None;
            }
            let along = force.map(|value| value / length);
            let near = |other: &[f64; 3]| other.iter().zip(along).map(|(one, other)| one * other).sum::<f64>() > APART;
            Some(seen.iter().position(near).unwrap_or_else(|| {
                seen.push(along);
                seen.len() - 1
            }))
        })
        .collect()
}
