//! Tumble: a sensor that rested in many poses and was turned between them, calibrated by gravity, in any unit.
//!
//! 1. The quiet parts lie on a sphere in raw values: its centre and radius give offset and scale roughly ([`magnitude`]).
//! 2. The rests are found in roughly converted values ([`rests`]).
//! 3. Gravity has one length in all rests: nine numbers of the accelerometer ([`magnitude`]).
//! 4. The gyro turns gravity's direction from one rest to the next: nine numbers in the accelerometer's axes, and its bias
//!    ([`turns`]).
//! 5. The earth's field has one length in all directions: hard and soft iron ([`magnetometer`]).

mod error;
mod fitted;
mod magnetometer;
mod magnitude;
mod rests;
#[cfg(test)]
mod tests;
mod turns;

pub use error::TumbleError;
pub use fitted::Fitted;
pub use magnetometer::Magnetometer;
pub use rests::{Rest, SHORTEST_S, poses, rests};

use crate::correction::{self, Deviations};
use crate::fit::{Design, Prior};
use crate::track::Track;
use crate::triad::Estimate;
use fitted::Scaled;
use imu_core::units::STANDARD_GRAVITY_M_S2;
use nalgebra::Vector3;
use turns::Turn;

/// Standard deviation of local gravity about the standard one, m/s²: over the earth's surface.
const GRAVITY_SD: f64 = 0.013;
/// Standard deviation of a stated gravity, m/s².
const STATED_SD: f64 = 1e-4;
/// Minimum number of poses.
const POSES_MIN: usize = 6;
/// From this number of poses on, whole poses are left out in turn for the errors.
const POSES_MANY: usize = 12;
/// Scatter of one pose against another that few poses cannot show: a curve, a stress, a temperature, m/s².
const UNSEEN: f64 = 0.003;
/// Scatter of the lengths beyond which nothing is calibrated, m/s².
const SCATTER_MOST: f64 = 0.5;
/// Minimum number of turns for twelve numbers of a gyro: each gives two, and the errors have to show as well.
const TURNS_MIN: usize = 13;
/// Minimum number of turns for its scale roughly.
const TURNS_ROUGH: usize = 3;
/// Widest interval of the gyro's bias that counts as determined, rad/s.
const WIDEST_RATE_BIAS: f64 = 0.02;
/// Values in SI units are gravity's at rest if they are this close to it.
const NEAR_GRAVITY: f64 = 0.2;
/// A rest whose ends are left out has to be this long, s.
const WHOLE_REST_S: f64 = SHORTEST_S + 1.0;
/// Quiet parts that scatter by more than this, m/s², after their scale was found, are one pose.
const NOISE_MOST: f64 = 0.5;
/// Lengths that scatter by this many times what the noise makes, and by this, m/s², are not explained by nine numbers.
const BENT: f64 = 5.0;
const BENT_LEAST: f64 = 2e-3;
/// With fewer rests than this, the gyro's bias is one number instead of a line.
const LINE_MIN: usize = 6;

/// What is known beside the record.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Known {
    /// Local gravity, m/s²; the standard one to 0.13 % if absent.
    pub gravity_m_s2: Option<f64>,
    /// The strength of the earth's field in the unit of the magnetometer, if it is known.
    pub field: Option<f64>,
    /// Whether the values are in m/s² and rad/s. If not, they are counts.
    pub is_si: bool,
}

/// What a tumble shows.
#[derive(Debug, Clone)]
pub struct Tumble {
    /// The accelerometer: raw = M·(specific force, m/s²) + bias, in axes in which M is symmetric.
    pub accel: Fitted,
    /// The gyro in the accelerometer's axes: raw = M·(rate, rad/s) + bias.
    pub gyro: Option<Fitted>,
    /// What the gyro shows at rest, in its unit, if there is one.
    pub gyro_bias: Option<[Estimate; 3]>,
    /// Why there is no gyro, if there is none.
    pub without_gyro: Option<&'static str>,
    /// The magnetometer, if there is one that was turned enough.
    pub mag: Option<Magnetometer>,
    /// The rests, their forces roughly converted to m/s².
    pub rests: Vec<Rest>,
    /// The number of poses.
    pub poses: usize,
    /// The number of turns that the gyro was compared with.
    pub turns: usize,
    /// What the gyro shows of 1 rad/s, roughly, if it turned at least three times. It shows another unit, even if nothing is fitted.
    pub gyro_per_unit: Option<f64>,
    /// Whether the lengths at rest scatter by far more than the noise explains.
    pub is_bent: bool,
    /// Whether the values are in m/s² and rad/s.
    pub is_si: bool,
}

impl Tumble {
    /// Returns the accelerometer's deviations.
    pub fn of_accel(&self) -> Deviations {
        correction::of_accel(&self.accel, STANDARD_GRAVITY_M_S2)
    }

    /// Returns the gyro's deviations, its rotation beside the accelerometer among them.
    pub fn of_gyro(&self) -> Option<Deviations> {
        let Some(fitted) = &self.gyro else {
            // The rests show the bias even if the turns do not show the matrix.
            let bias = self.gyro_bias.filter(|_| self.is_si)?;
            return Some(Deviations { bias: bias.map(Some), ..Deviations::default() });
        };
        let of = Deviations::of_tumble(fitted, true, WIDEST_RATE_BIAS);
        Some(Deviations { bias: self.gyro_bias.map_or(of.bias, |bias| bias.map(Some)), ..of })
    }
}

/// Calibrates a sensor by gravity. `mag` has a row for each of the track's, or none.
///
/// # Errors
/// [`TumbleError`] if the sensor did not rest in enough poses.
///
/// # Source
/// IEEE Std 1293 (multi-position test); Tedaldi, Pretto and Menegatti 2014.
///
/// # Validation
/// `tests`: simulated tumbles give the numbers back within their intervals; the factory sheet of imu_tk's Xsens, mikoff's three published
/// MPU-9150 and Seoul's tumble (docs/calibration.md).
pub fn calibrate(track: &Track, mag: &[Vector3<f64>], known: &Known) -> Result<Tumble, TumbleError> {
    if track.accel.len() != track.time_s.len() || track.accel.is_empty() {
        return Err(TumbleError::NoAccelerometer);
    }
    if let Some(axis) = Track::dead(&track.accel) {
        return Err(TumbleError::Dead { channel: format!("accel_{}", ["x", "y", "z"][axis]) });
    }
    let length = match known.gravity_m_s2 {
        Some(stated) => Prior { mean: stated, sd: STATED_SD },
        None => Prior { mean: STANDARD_GRAVITY_M_S2, sd: GRAVITY_SD },
    };
    let still = found_rests(track, length.mean, known.is_si);
    let too_few = |rests: &[Rest], poses| TumbleError::Poses {
        rests: rests.len(),
        poses,
        least: POSES_MIN,
        shortest_s: WHOLE_REST_S,
    };
    let pose_of = poses(still.iter().map(|rest| rest.force));
    let count = pose_of.iter().flatten().max().map_or(0, |last| last + 1);
    if count < POSES_MIN {
        return Err(too_few(&still, count));
    }
    let points: Vec<(f64, Vector3<f64>)> = still
        .iter()
        .map(|rest| {
            (track.time_s[rest.within.start].midpoint(track.time_s[rest.within.end - 1]), mean(&track.accel, rest))
        })
        .collect();
    let is_many = count >= POSES_MANY;
    let parts = if is_many { pose_of.iter().map(|pose| pose.unwrap_or(0)).collect() } else { Vec::new() };
    let design = Design { parts, least: if is_many { 0.0 } else { UNSEEN }, is_whole: !is_many };
    let accel = magnitude::fit(&points, length, design).ok_or_else(|| too_few(&still, count))?;
    if accel.rms() > SCATTER_MOST {
        return Err(TumbleError::Scatter { rms_m_s2: accel.rms(), most_m_s2: SCATTER_MOST });
    }
    if !accel.is_finite() {
        return Err(too_few(&still, count));
    }
    let mut gyro_per_unit = None;
    let (gyro, without_gyro, turns) = match gyroscope(track, &still, &points, &accel, known.is_si, &mut gyro_per_unit) {
        Ok((gyro, turns)) => (Some(gyro), None, turns),
        Err(why) => (None, Some(why), 0),
    };
    let is_bent = accel.rms() > BENT_LEAST && accel.rms() > BENT * expected(track, &still, &accel);
    let has_gyro = track.gyro.len() == track.time_s.len() && Track::dead(&track.gyro).is_none();
    let gyro_bias = has_gyro.then(|| bias_of(&biases(track, &still, &points)));
    let mag = (mag.len() == track.time_s.len()).then(|| magnetometer::fit(&track.time_s, mag, known.field)).flatten();
    let is_si = known.is_si;
    Ok(Tumble {
        accel,
        gyro,
        gyro_bias,
        without_gyro,
        mag,
        rests: still,
        poses: count,
        turns,
        gyro_per_unit,
        is_bent,
        is_si,
    })
}

/// Fits hard and soft iron of a magnetometer that was turned through many directions, with or without rests. `None` as in
/// [`calibrate`].
pub fn magnetometer(time_s: &[f64], mag: &[Vector3<f64>], field: Option<f64>) -> Option<Magnetometer> {
    magnetometer::fit(time_s, mag, field)
}

fn mean(values: &[Vector3<f64>], rest: &Rest) -> Vector3<f64> {
    values[rest.within.clone()].iter().sum::<Vector3<f64>>() / rest.within.len().max(1) as f64
}

/// Returns the rests, found in values that are roughly converted. Rates count only if they are in rad/s.
fn found_rests(track: &Track, gravity_m_s2: f64, is_si: bool) -> Vec<Rest> {
    let rate_hz = 1.0 / track.period_s().max(1e-9);
    let size = rests::samples(rate_hz);
    let parts = track.accel.chunks_exact(size).map(|part| {
        let mean = part.iter().sum::<Vector3<f64>>() / size as f64;
        let spread = part.iter().map(|of| (of - mean).norm_squared()).sum::<f64>();
        (spread, (0.0, mean))
    });
    let mut quiet: Vec<(f64, (f64, Vector3<f64>))> = parts.collect();
    quiet.sort_unstable_by(|one, other| one.0.total_cmp(&other.0));
    let least = quiet.get(quiet.len() / 10).map_or(0.0, |(spread, _)| *spread);
    // The quieter half is at rest or nearly so.
    let quiet: Vec<(f64, Vector3<f64>)> = quiet[..quiet.len() / 2].iter().map(|(_, of)| *of).collect();
    let Some(scaled) = roughly(&quiet, gravity_m_s2, is_si) else { return Vec::new() };
    let noise = (least / size as f64).sqrt() * scaled.per_unit;
    if noise > NOISE_MOST {
        return Vec::new();
    }
    let columns =
        |values: Vec<Vector3<f64>>| [0, 1, 2].map(|axis| values.iter().map(|of| of[axis]).collect::<Vec<f64>>());
    let accel = columns(track.accel.iter().map(|raw| scaled.of(raw)).collect());
    let is_rate = is_si && track.gyro.len() == track.accel.len();
    let gyro = is_rate.then(|| columns(track.gyro.clone()));
    let longest_s = track.longest_step_s();
    let is_missing = |place: usize| {
        place.checked_sub(1).is_some_and(|before| track.time_s[place] - track.time_s[before] > longest_s)
    };
    let gyro = gyro.as_ref().map(|of| [of[0].as_slice(), &of[1], &of[2]]);
    let accel = [accel[0].as_slice(), &accel[1], &accel[2]];
    let found = rests(rate_hz, accel, gyro, &is_missing);
    // A gyro in another unit than is stated, or one that drifts, hides rests.
    let is_enough = poses(found.iter().map(|rest| rest.force)).iter().flatten().max() >= Some(&(POSES_MIN - 1));
    if is_enough { found } else { rests(rate_hz, accel, None, &is_missing) }
}

/// Returns the offset and scale that make m/s² of the quiet parts roughly: none in SI units, unless the values are far from gravity.
fn roughly(quiet: &[(f64, Vector3<f64>)], gravity_m_s2: f64, is_si: bool) -> Option<Scaled> {
    let mut lengths: Vec<f64> = quiet.iter().map(|(_, mean)| mean.norm()).collect();
    lengths.sort_unstable_by(f64::total_cmp);
    let middle = *lengths.get(lengths.len() / 2)?;
    match is_si && (middle / gravity_m_s2 - 1.0).abs() < NEAR_GRAVITY {
        true => Some(Scaled { offset: Vector3::zeros(), per_unit: 1.0 }),
        false => magnitude::sphere(quiet, gravity_m_s2),
    }
}

/// Fits the gyro; else states why not.
fn gyroscope(
    track: &Track,
    still: &[Rest],
    points: &[(f64, Vector3<f64>)],
    accel: &Fitted,
    is_si: bool,
    per_unit: &mut Option<f64>,
) -> Result<(Fitted, usize), &'static str> {
    if track.gyro.len() != track.time_s.len() {
        return Err("the recording has no gyroscope of three axes");
    }
    if Track::dead(&track.gyro).is_some() {
        return Err("an axis of the gyroscope shows the same value throughout");
    }
    let biases = biases(track, still, points);
    let (offset, slope, sd) = line(&biases.means);
    let sd = sd.hypot(biases.unresolved);
    let middle_s = biases.means.iter().map(|(time_s, _)| time_s).sum::<f64>() / biases.means.len().max(1) as f64;
    let half = track.every_other();
    let bias = |time_s: f64| offset + slope * (time_s - middle_s);
    let directions: Vec<Vector3<f64>> = points.iter().map(|(_, raw)| accel.felt(raw).normalize()).collect();
    let part = rests::samples(1.0 / track.period_s().max(1e-9));
    let made = (1..still.len()).filter_map(|at| {
        let of = |samples: &Track, wider: usize| {
            let (from, to) = (still[at - 1].within.end - wider, still[at].within.start + wider);
            let ends_s = [*track.time_s.get(from)?, *track.time_s.get(to)?];
            Turn::between(samples, ends_s, [directions[at - 1], directions[at]], &bias)
        };
        Some((at, [of(track, 0)?, of(&half, 0)?, of(track, part)?]))
    });
    let (mut places, mut turns, mut coarse, mut wide) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (at, [turn, halved, wider]) in made {
        places.push(at);
        turns.push(turn);
        coarse.push(halved);
        wide.push(wider);
    }
    let rough = (turns.len() >= TURNS_ROUGH).then(|| turns::rough(&turns, is_si)).flatten();
    *per_unit = rough.map(|matrix| 1.0 / matrix.determinant().abs().cbrt());
    if turns.len() < TURNS_MIN {
        return Err("fewer than 13 turns from one rest to the next turn gravity by 12° or more without a lost sample");
    }
    let rough = rough.ok_or(
        "the gyroscope does not turn gravity from one rest to the next with any scale and axes: was it clipped, or is it of another \
         body?",
    )?;
    // What the accelerometer's own errors do to the directions.
    let others: Vec<Vec<[Vector3<f64>; 2]>> = accel
        .deviations()
        .iter()
        .map(|numbers| {
            let along = |at: usize| accel.felt_by(numbers, &points[at].1).normalize();
            places.iter().map(|at| [along(at - 1), along(*at)]).collect()
        })
        .collect();
    let fitted = turns::fit(&turns, &rough, offset, sd, &others, [&coarse, &wide]).filter(Fitted::is_finite);
    let fitted = fitted.ok_or("the turns between rests do not determine it: were they about all axes?")?;
    Ok((fitted, turns.len()))
}

/// The means of the gyro in the rests.
struct Biases {
    means: Vec<(f64, Vector3<f64>)>,
    /// The standard deviation of what steps without noise between them hide.
    unresolved: f64,
}

fn biases(track: &Track, still: &[Rest], points: &[(f64, Vector3<f64>)]) -> Biases {
    let means = points.iter().zip(still).map(|((time_s, _), rest)| (*time_s, mean(&track.gyro, rest))).collect();
    let unresolved = (0..3)
        .map(|axis| {
            let steps =
                track.gyro.windows(2).map(|pair| (pair[1][axis] - pair[0][axis]).abs()).filter(|step| *step > 0.0);
            let step = steps.fold(f64::INFINITY, f64::min);
            let noise = still.iter().map(|rest| spread(track.gyro[rest.within.clone()].iter().map(|of| of[axis])));
            let noise = noise.fold(0.0, f64::max);
            // With noise of half a step, the mean of rounded values is that of the values.
            if step.is_finite() && noise < 0.5 * step { step / 12.0_f64.sqrt() } else { 0.0 }
        })
        .fold(0.0, f64::max);
    Biases { means, unresolved }
}

fn spread(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt()
}

/// Returns the bias in the middle of the record, with Student's interval.
fn bias_of(biases: &Biases) -> [Estimate; 3] {
    let (mean, _, sd) = line(&biases.means);
    let sd = sd.hypot(biases.unresolved);
    let freedom = biases.means.len().saturating_sub(2).max(1) as f64;
    [0, 1, 2].map(|axis| Estimate::with_freedom(mean[axis], sd, freedom))
}

/// Returns the scatter of the lengths that the noise in the rests makes, m/s².
fn expected(track: &Track, still: &[Rest], accel: &Fitted) -> f64 {
    let squares = still.iter().map(|rest| {
        let own = |axis: usize| spread(track.accel[rest.within.clone()].iter().map(|of| of[axis]));
        (0..3).map(|axis| own(axis).powi(2)).sum::<f64>() / (3.0 * rest.within.len() as f64)
    });
    (squares.sum::<f64>() / still.len().max(1) as f64).sqrt() * accel.per_unit()
}

/// Returns the mean of values and its growth per second, each axis a line of least squares, and the standard deviation of the mean as a
/// number for the whole time: its error, and the growth.
fn line(values: &[(f64, Vector3<f64>)]) -> (Vector3<f64>, Vector3<f64>, f64) {
    let count = values.len().max(1) as f64;
    let middle_s = values.iter().map(|(time_s, _)| time_s).sum::<f64>() / count;
    let mean = values.iter().map(|(_, value)| *value).sum::<Vector3<f64>>() / count;
    let about = |time_s: f64| time_s - middle_s;
    let squares: f64 = values.iter().map(|(time_s, _)| about(*time_s).powi(2)).sum();
    let slope = if values.len() < LINE_MIN || squares <= 0.0 {
        Vector3::zeros()
    } else {
        values.iter().map(|(time_s, value)| (value - mean) * about(*time_s)).sum::<Vector3<f64>>() / squares
    };
    let rest = values.iter().map(|(time_s, value)| value - mean - slope * about(*time_s));
    let most = rest.fold(Vector3::zeros(), |sum: Vector3<f64>, of| sum + of.component_mul(&of)).max();
    let error = most / (count * (count - 2.0).max(1.0));
    // Even growth over a time has a standard deviation of its range over √12.
    let growth = slope.amax().powi(2) * squares / count;
    (mean, slope, (error + growth).sqrt())
}
