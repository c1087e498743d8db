//! Magnetometer: hard and soft iron from the magnitude of the earth's field in many directions.

use super::fitted::Fitted;
use super::magnitude;
use crate::calibration::{Stretch, joined};
use crate::correction::Deviations;
use crate::fit::{Design, Prior};
use crate::triad::OFF;
use nalgebra::{DVector, Matrix3, Vector3};

/// Directions this far apart are points of their own, rad.
const APART: f64 = 0.04;
/// The longest time of a point, s.
const LONGEST_S: f64 = 1.0;
/// Minimum number of points.
const LEAST: usize = 60;
/// Standard deviation of the field's strength, in parts of it. A mean over directions of [`APART`] is shorter by less.
const STRENGTH_SD: f64 = 1e-4;
/// Part of the points' whole scatter that is along the direction of least: a third all around, a twelfth of half a sphere.
const FLATTEST: f64 = 0.02;
/// The scatter along that direction has to be this many times the noise of a sample.
const OVER_NOISE: f64 = 4.0;
/// Lengths that scatter by this many times what the noise makes, and by this part of the field, are not of one field. Beyond the last
/// part nothing is calibrated.
const UNEVEN: f64 = 3.0;
const UNEVEN_LEAST: f64 = 0.005;
const UNEVEN_MOST: f64 = 0.04;
/// Pairs of fits with as much noise again.
const PAIRS: u64 = 2;
/// Widest interval of hard iron that counts as determined, in parts of the field.
const WIDEST_IRON: f64 = 0.1;
/// A field that is disturbed in a larger part of the directions is no reference.
const DISTURBED_MOST: f64 = 0.3;
/// Stretches closer than this are one, s.
const BETWEEN_S: f64 = 2.0;

/// A magnetometer that was fitted.
#[derive(Debug, Clone)]
pub struct Magnetometer {
    /// Raw = M·field + hard iron.
    pub fitted: Fitted,
    /// Whether the strength of the field was stated. If not, M has the mean size of 1 by definition.
    pub is_absolute: bool,
    /// When a magnet or iron was nearby.
    pub disturbed: Vec<Stretch>,
    /// Whether the lengths scatter by far more than the noise: a magnet that stayed, another place, or a sensor that lags.
    pub is_uneven: bool,
}

impl Magnetometer {
    /// Returns the strength of the field that makes the mean sensitivity 1, in the sensor's unit.
    pub fn strength(&self) -> f64 {
        self.fitted.length()
    }

    /// Returns soft iron (sensitivity, cross-axis sensitivity) and hard iron (bias).
    pub fn deviations(&self) -> Deviations {
        Deviations::of_tumble(&self.fitted, false, WIDEST_IRON * self.fitted.length())
    }
}

/// Fits hard and soft iron. `None` if there are too few directions, or if the field is disturbed too often.
///
/// Noise makes the sphere larger where it was seen, and as a record's directions are not everywhere, its shape another one. The same
/// points with as much noise again show by how much, which is taken out.
///
/// # Source
/// As [`magnitude`]; simulation extrapolation: Cook and Stefanski 1994.
///
/// # Validation
/// `tests`: simulated turns with a magnet that comes and goes give hard and soft iron back within their intervals.
pub(super) fn fit(time_s: &[f64], raw: &[Vector3<f64>], field: Option<f64>) -> Option<Magnetometer> {
    let all = points(time_s, raw)?;
    let noise = noise(raw);
    if !is_all_around(&all, noise) {
        return None;
    }
    let mut kept = all.clone();
    let mut fitted = of(&kept, field)?;
    let mut disturbed = Vec::new();
    for _ in 0..3 {
        // A mean of few samples is farther off than one of many.
        let most = |point: &Point| {
            let own = noise * fitted.per_unit() / (point.count as f64).sqrt();
            OFF * fitted.scatter().max(own)
        };
        let far: Vec<f64> = all.iter().filter(|of| fitted.off(&of.mean) > most(of)).map(|of| of.time_s).collect();
        if far.len() as f64 > DISTURBED_MOST * all.len() as f64 {
            return None;
        }
        disturbed = joined(far.into_iter(), 0.0, BETWEEN_S);
        // A single point is a glitch and has a bounded weight.
        disturbed.retain(|of| of.to_s > of.from_s);
        let is_in = |time_s: f64| disturbed.iter().any(|of: &Stretch| (of.from_s..=of.to_s).contains(&time_s));
        kept = all.iter().filter(|of| !is_in(of.time_s)).copied().collect();
        fitted = of(&kept, field)?;
    }
    let mut strength = field;
    if field.is_none() {
        // By definition the mean of the sensitivities is 1.
        let (matrix, _) = fitted.matrix_and_bias();
        strength = Some(fitted.length() * matrix.trace() / 3.0);
        fitted = of(&kept, strength)?;
    }
    let counts = kept.iter().map(|of| 1.0 / of.count as f64).sum::<f64>() / kept.len() as f64;
    let expected = noise * fitted.per_unit() * counts.sqrt();
    let is_uneven = fitted.scatter() > UNEVEN * expected && fitted.scatter() > UNEVEN_LEAST * fitted.length();
    if is_uneven && fitted.scatter() > UNEVEN_MOST * fitted.length() {
        return None;
    }
    let bias = bias_of_noise(&kept, strength, &fitted)?;
    fitted.solution.less(&bias);
    Some(Magnetometer { fitted, is_absolute: field.is_some(), disturbed, is_uneven })
}

/// Returns by how much noise moves the numbers: the mean change with as much noise again, whose opposite is added too, so that only
/// what does not change its sign remains.
fn bias_of_noise(points: &[Point], field: Option<f64>, fitted: &Fitted) -> Option<DVector<f64>> {
    let noise = fitted.scatter() / fitted.per_unit();
    let mut bias = DVector::zeros(fitted.solution.numbers.len());
    for pair in 0..PAIRS {
        for sign in [1.0, -1.0] {
            let mut moved = points.to_vec();
            for (place, point) in moved.iter_mut().enumerate() {
                point.mean += Vector3::from_fn(|axis, _| sign * noise * either(pair, place, axis));
            }
            bias += &of(&moved, field)?.solution.numbers - &fitted.solution.numbers;
        }
    }
    Some(bias / (2 * PAIRS) as f64)
}

/// Returns 1 or −1, for each point and axis another one, by the finaliser of SplitMix64 (Steele, Lea and Flood 2014).
fn either(pair: u64, place: usize, axis: usize) -> f64 {
    let mut mixed =
        (pair << 48 | (place as u64) << 2 | axis as u64).wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    if (mixed ^ (mixed >> 31)) & 1 == 0 { 1.0 } else { -1.0 }
}

fn of(points: &[Point], field: Option<f64>) -> Option<Fitted> {
    if points.len() < LEAST {
        return None;
    }
    let points: Vec<(f64, Vector3<f64>)> = points.iter().map(|of| (of.time_s, of.mean)).collect();
    let radius = 1.0 / magnitude::sphere(&points, 1.0)?.per_unit;
    let mean = field.unwrap_or(radius);
    let length = Prior { mean, sd: STRENGTH_SD * mean };
    magnitude::fit(&points, length, Design::default())
}

/// Returns whether the points have directions enough: along no direction they scatter by far less than along the others, or by noise
/// alone.
fn is_all_around(points: &[Point], noise: f64) -> bool {
    let count = points.len() as f64;
    let mean = points.iter().map(|of| of.mean).sum::<Vector3<f64>>() / count;
    let scatter: Matrix3<f64> = points.iter().map(|of| (of.mean - mean) * (of.mean - mean).transpose()).sum();
    let along = scatter.symmetric_eigenvalues();
    along.min() > FLATTEST * along.sum() && along.min() > count * (OVER_NOISE * noise).powi(2)
}

/// The mean of consecutive samples of about one direction.
#[derive(Debug, Clone, Copy)]
struct Point {
    time_s: f64,
    mean: Vector3<f64>,
    count: usize,
}

/// Returns the standard deviation of one sample's noise along an axis, from the median of what three samples in a row differ by from a
/// line.
fn noise(raw: &[Vector3<f64>]) -> f64 {
    let bends = raw.windows(3).flat_map(|three| (three[0] - 2.0 * three[1] + three[2]).data.0[0]);
    let mut sizes: Vec<f64> = bends.map(f64::abs).collect();
    if sizes.is_empty() {
        return 0.0;
    }
    let middle = sizes.len() / 2;
    1.4826 * *sizes.select_nth_unstable_by(middle, f64::total_cmp).1 / 6.0_f64.sqrt()
}

/// Returns means of consecutive samples of about one direction.
fn points(time_s: &[f64], raw: &[Vector3<f64>]) -> Option<Vec<Point>> {
    let every: Vec<(f64, Vector3<f64>)> = time_s.iter().copied().zip(raw.iter().copied()).collect();
    let thin = every.len() / 2000 + 1;
    let centre = magnitude::sphere(&every.iter().step_by(thin).copied().collect::<Vec<_>>(), 1.0)?;
    let mut found = Vec::new();
    let mut from = 0;
    for place in 0..=every.len() {
        let is_over = place == every.len()
            || centre.of(&every[from].1).angle(&centre.of(&every[place].1)) > APART
            || every[place].0 - every[from].0 > LONGEST_S;
        if is_over && place > from {
            let count = place - from;
            let own = &every[from..place];
            let mean = own.iter().map(|(_, raw)| *raw).sum::<Vector3<f64>>() / count as f64;
            let middle_s = own.iter().map(|(time_s, _)| *time_s).sum::<f64>() / count as f64;
            found.push(Point { time_s: middle_s, mean, count });
            from = place;
        }
    }
    Some(found)
}
