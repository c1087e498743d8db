//! Rough: the offset of both clocks and the gyroscope's matrix to some percent, before anything small is fitted.

use crate::error::PoseError;
use crate::reference::Poses;
use crate::track::Track;
use nalgebra::{Matrix3, Vector3};

/// The grid on which turning is compared, s.
const GRID_S: f64 = 0.05;
/// A reference may be this many times as long as the recording, or [`LONGEST_S`].
const LONGER: f64 = 10.0;
const LONGEST_S: f64 = 3600.0;
/// Neither may be longer than this: the search for the offset goes over all of both.
const SPAN_S: f64 = 43_200.0;
/// Products of places up to which all offsets are tried; beyond, the first search is over means of [`COARSE`] places.
const SEARCHED: usize = 400_000_000;
const COARSE: usize = 10;
/// A magnitude beyond this many times the 95 % quantile is a fault of the reference.
const FAULT: f64 = 3.0;
/// Common time that is needed, s.
const LEAST_S: f64 = 5.0;
/// The turning that is needed, °.
const LEAST_DEG: f64 = 20.0;
/// The correlation of both magnitudes that is needed.
const LEAST_CORRELATION: f64 = 0.5;
/// A smaller offset is taken if its correlation is worse than the best by at most this: a steady swing repeats itself.
const AS_GOOD: f64 = 0.02;
/// A direction is known if the error of its column is at most this part of the strongest column.
const CERTAIN: f64 = 0.1;
/// Offsets this far apart are two, s.
const APART_S: f64 = 0.4;
/// Places of the grid whose residuals go together.
const TOGETHER: f64 = 20.0;

pub(crate) struct Rough {
    /// What a stamp of the track is later than the reference's time of the same instant, s.
    pub(crate) lag_s: f64,
    /// The sensor's rates are this matrix times the body's.
    pub(crate) matrix: Matrix3<f64>,
    /// Whether another offset of the clocks, a period of the motion away, fits as well.
    pub(crate) is_ambiguous: bool,
    /// The spread of the body's rate about each axis, rad/s.
    pub(crate) turning: Vector3<f64>,
}

/// A value at each place of a grid; `None` if a window has a gap.
struct Grid {
    begins_s: f64,
    values: Vec<Option<Vector3<f64>>>,
}

fn body(poses: &Poses) -> Grid {
    let (first, last) = (poses.time_s[0], poses.time_s[poses.time_s.len() - 1]);
    let longest_s = poses.longest_step_s();
    let count = ((last - first) / GRID_S) as usize;
    let mut near = 0;
    let mut attitudes = Vec::with_capacity(count + 1);
    for place in 0..=count {
        attitudes.push(poses.at(first + place as f64 * GRID_S, &mut near, longest_s));
    }
    let rate =
        |pair: &[Option<nalgebra::UnitQuaternion<f64>>]| Some((pair[0]?.inverse() * pair[1]?).scaled_axis() / GRID_S);
    Grid { begins_s: first + 0.5 * GRID_S, values: attitudes.windows(2).map(rate).collect() }
}

fn sensor(track: &Track) -> Grid {
    let first = track.time_s[0];
    let longest_s = track.longest_step_s().max(GRID_S);
    let count = ((track.time_s[track.time_s.len() - 1] - first) / GRID_S) as usize;
    let mean = |place: usize| {
        let from_s = first + place as f64 * GRID_S;
        let parts = track.parts(&track.gyro, from_s, from_s + GRID_S, longest_s)?;
        let all: f64 = parts.iter().map(|part| part.seconds).sum();
        Some(parts.iter().map(|part| part.value * part.seconds).sum::<Vector3<f64>>() / all)
    };
    Grid { begins_s: first + 0.5 * GRID_S, values: (0..count).map(mean).collect() }
}

/// Returns the correlation of both magnitudes with the sensor's grid moved by `shift` places, and the number of common places.
fn correlation(body: &[Option<f64>], sensor: &[Option<f64>], shift: i64) -> (f64, usize) {
    let (mut count, mut sums) = (0_usize, [0.0; 5]);
    let from = (-shift).max(0);
    let until = (body.len() as i64).min(sensor.len() as i64 - shift);
    for place in from..until {
        let (Some(one), Some(other)) = (body[place as usize], sensor[(place + shift) as usize]) else { continue };
        count += 1;
        for (sum, value) in sums.iter_mut().zip([one, other, one * one, other * other, one * other]) {
            *sum += value;
        }
    }
    let of = count as f64;
    let [one, other, ones, others, both] = sums.map(|sum| sum / of);
    let spread = ((ones - one * one) * (others - other * other)).sqrt();
    (if spread > 0.0 { (both - one * other) / spread } else { 0.0 }, count)
}

/// Matches clocks and axes.
///
/// # Errors
/// [`PoseError`] if they have too little in common, if nothing turns, or if their turning is not alike.
pub(crate) fn rough(track: &Track, poses: &Poses) -> Result<Rough, PoseError> {
    let lasts = |of: &[f64]| of.last().zip(of.first()).map_or(0.0, |(last, first)| last - first);
    let (found_s, record_s) = (lasts(&poses.time_s), lasts(&track.time_s));
    // Stamps that are far off would need a grid without end.
    if !(found_s <= (LONGER * record_s).clamp(LONGEST_S, SPAN_S) && record_s <= SPAN_S) {
        return Err(PoseError::Long { found_s, record_s });
    }
    let (body, sensor) = (body(poses), sensor(track));
    let turned = body.values.iter().flatten().map(|rate| rate.norm() * GRID_S).sum::<f64>().to_degrees();
    if turned < LEAST_DEG {
        return Err(PoseError::Still { found_deg: turned, least_deg: LEAST_DEG });
    }
    let norms = |of: &Grid| without_faults(of.values.iter().map(|value| value.map(|rate| rate.norm())).collect());
    let (ours, theirs) = (norms(&body), norms(&sensor));
    let shorter = ours.len().min(theirs.len());
    let least = ((LEAST_S / GRID_S) as usize).max(shorter / 3);
    if shorter < (LEAST_S / GRID_S) as usize {
        return Err(PoseError::Overlap { found_s: shorter as f64 * GRID_S, least_s: LEAST_S });
    }
    let lag_of = |shift: i64| sensor.begins_s - body.begins_s + shift as f64 * GRID_S;
    let found = offsets(&ours, &theirs, least);
    if found.is_empty() {
        // Too much of one of them is missing or was cut off.
        let known = |of: &[Option<f64>]| of.iter().flatten().count();
        return Err(PoseError::Overlap { found_s: known(&ours).min(known(&theirs)) as f64 * GRID_S, least_s: LEAST_S });
    }
    let best = found.iter().map(|(_, value)| *value).fold(f64::NEG_INFINITY, f64::max);
    if best < LEAST_CORRELATION {
        return Err(PoseError::Unlike { best, least: LEAST_CORRELATION });
    }
    let near: Vec<&(i64, f64)> = found.iter().filter(|(_, value)| *value >= best - AS_GOOD).collect();
    let closest = near.iter().min_by(|one, other| lag_of(one.0).abs().total_cmp(&lag_of(other.0).abs()));
    // The best place about the chosen one.
    let mut shift = closest.map_or(0, |(shift, _)| *shift);
    let is_ambiguous = near.iter().any(|(other, _)| (other - shift).unsigned_abs() > (APART_S / GRID_S) as u64);
    let at = |shift: i64| correlation(&ours, &theirs, shift).0;
    while at(shift + 1) > at(shift) {
        shift += 1;
    }
    while at(shift - 1) > at(shift) {
        shift -= 1;
    }
    let (before, here, after) = (at(shift - 1), at(shift), at(shift + 1));
    let bend = before - 2.0 * here + after;
    let part = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    let pairs = (0..body.values.len()).filter_map(|place| {
        let at = usize::try_from(place as i64 + shift).ok()?;
        Some((body.values[place]?, (*sensor.values.get(at)?)?))
    });
    let (matrix, turning) = robust(pairs.collect());
    Ok(Rough { lag_s: lag_of(shift) + part * GRID_S, matrix, turning, is_ambiguous })
}

/// Returns the offsets with enough common places, in places of the grid, and their correlations.
fn offsets(ours: &[Option<f64>], theirs: &[Option<f64>], least: usize) -> Vec<(i64, f64)> {
    let all = |ours: &[Option<f64>], theirs: &[Option<f64>], least: usize, shifts: std::ops::Range<i64>| {
        let of = |shift: i64| Some(correlation(ours, theirs, shift)).filter(|of| of.1 >= least).map(|of| (shift, of.0));
        shifts.filter_map(of).collect::<Vec<_>>()
    };
    if ours.len().saturating_mul(theirs.len()) <= SEARCHED {
        return all(ours, theirs, least, -(ours.len() as i64)..theirs.len() as i64);
    }
    let mean = |of: &[Option<f64>]| {
        of.chunks(COARSE)
            .map(|part| {
                Some(part.iter().flatten().sum::<f64>() / part.len() as f64)
                    .filter(|_| part.iter().all(Option::is_some))
            })
            .collect::<Vec<_>>()
    };
    let (fewer, others) = (mean(ours), mean(theirs));
    let rough = all(&fewer, &others, least / COARSE, -(fewer.len() as i64)..others.len() as i64);
    let best = rough.iter().max_by(|one, other| one.1.total_cmp(&other.1)).map_or(0, |best| best.0 * COARSE as i64);
    all(ours, theirs, least, best - 2 * COARSE as i64..best + 2 * COARSE as i64 + 1)
}

/// Returns magnitudes without those that no motion beside the others makes.
fn without_faults(mut of: Vec<Option<f64>>) -> Vec<Option<f64>> {
    let mut sorted: Vec<f64> = of.iter().flatten().copied().collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let most = sorted.get(sorted.len() * 95 / 100).map_or(f64::INFINITY, |value| FAULT * value);
    of.iter_mut().for_each(|value| *value = value.filter(|value| *value <= most));
    of
}

/// Returns [`matrix`] of the pairs without those that it explains worst, in two rounds.
fn robust(mut pairs: Vec<(Vector3<f64>, Vector3<f64>)>) -> (Matrix3<f64>, Vector3<f64>) {
    for _ in 0..2 {
        let faults = without_faults(pairs.iter().map(|(body, _)| Some(body.norm())).collect());
        pairs = pairs.into_iter().zip(faults).filter_map(|(pair, of)| of.map(|_| pair)).collect();
        let (found, _) = matrix(&pairs);
        let left: Vec<f64> = pairs.iter().map(|(body, sensor)| (sensor - found * body).norm()).collect();
        let mut sorted = left.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        // The bias is in what is left, so that the bound is a wide one.
        let most = sorted.get(sorted.len() / 2).map_or(f64::INFINITY, |median| 8.0 * median);
        pairs = pairs.into_iter().zip(left).filter_map(|(pair, left)| (left <= most).then_some(pair)).collect();
    }
    matrix(&pairs)
}

/// Returns the matrix between both rates less their means, and the spread of the body's. Directions about which the body hardly
/// turns are completed to the nearest rotation.
pub(crate) fn matrix(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> (Matrix3<f64>, Vector3<f64>) {
    let count = pairs.len().max(1) as f64;
    let mean = pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |sum, pair| (sum.0 + pair.0, sum.1 + pair.1));
    let mean = (mean.0 / count, mean.1 / count);
    let (mut both, mut own) = (Matrix3::zeros(), Matrix3::zeros());
    for (body, sensor) in pairs {
        let (body, sensor) = (body - mean.0, sensor - mean.1);
        both += sensor * body.transpose() / count;
        own += body * body.transpose() / count;
    }
    let turning = own.diagonal().map(f64::sqrt);
    // What is left of the rates is noise of the attitudes, and vibration: a direction whose part of it is uncertain is unknown.
    let spread = own.symmetric_eigen();
    let strongest = spread.eigenvalues.imax();
    let direction = |at: usize| spread.eigenvectors.column(at).into_owned();
    let along = |at: usize| both * direction(at) / spread.eigenvalues[at].max(f64::MIN_POSITIVE);
    let scale = along(strongest).norm();
    let left = pairs.iter().map(|(body, sensor)| {
        let explained: Vector3<f64> =
            (0..3).map(|at| along(at) * direction(at).dot(&(body - mean.0))).sum::<Vector3<f64>>();
        (sensor - mean.1 - explained).norm_squared()
    });
    let left = (left.sum::<f64>() / count).sqrt();
    let error = |at: usize| left / (spread.eigenvalues[at] * (count / TOGETHER).max(1.0)).sqrt();
    let known: Vec<usize> = (0..3).filter(|at| *at == strongest || error(*at) < CERTAIN * scale).collect();
    let inverse: Matrix3<f64> =
        known.iter().map(|at| direction(*at) * direction(*at).transpose() / spread.eigenvalues[*at]).sum();
    let found = both * inverse;
    if known.len() == 3 {
        return (found, turning);
    }
    if known.len() == 1 {
        // How the sensor is turned about this direction does not show: it is taken to be turned as little as possible.
        let turn = nalgebra::Rotation3::rotation_between(&direction(strongest), &along(strongest));
        return (turn.map_or(-Matrix3::identity(), nalgebra::Rotation3::into_inner) * scale, turning);
    }
    let of = found.svd(true, true);
    let (Some(left), Some(right)) = (of.u, of.v_t) else { return (found, turning) };
    let scale = of.singular_values.max();
    let mut rotation = left * right;
    if rotation.determinant() < 0.0 {
        // The singular value that is least belongs to what is not known.
        let least = of.singular_values.imin();
        let mut turned = left;
        turned.column_mut(least).neg_mut();
        rotation = turned * right;
    }
    (rotation * scale, turning)
}
