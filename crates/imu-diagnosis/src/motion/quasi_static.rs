//! Quasi-static: gravity's magnitude in a sensor that is turned slowly through many poses without resting in them.
//!
//! In a window of T s the gyro shows how the sensor turned. With every sample turned into the window's middle, the mean
//! is gravity plus (v₂ − v₁)/T, the change of the hand's velocity. A hand returns, so that this term is usually small
//! and sometimes large, in any direction. To first order |f̄| − g = Σ b_k·ū_k + Σ D_k·⟨u_k·m_k⟩ + Σ S_kl·⟨u_k·m_l +
//! u_l·m_k⟩, with u the direction of f̄ in the sensor's axes at each sample. These are the numbers of [`super::poses`],
//! linear, with one equation per window.
//!
//! The residual is Student's t with three degrees of freedom, with a fitted scale (Lange, Little and Taylor 1989, J.
//! Am. Stat. Assoc. 84), so that windows with a jerk count little. If the scale is above [`STEADY`], no result is
//! reported: a hand that turns faster has centripetal accelerations that follow the pose as scale factors do.

use super::poses::{PARTS, Tumbled, columns_of, errors_beside, inverse_of, price, prior_sd};
use super::rests::{self, Rest};
use super::select::Choice;
use crate::options::Options;
use crate::recording::Recording;
use crate::response::Candidate;
use imu_core::units::STANDARD_GRAVITY_M_S2;
use imu_model::effects::triad::Axes;
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};

/// Length of a window, s.
pub(super) const WINDOW_S: f64 = 2.0;
/// Minimum number of windows.
const LEAST: usize = 24;
/// Minimum number of poses, 8° apart, in a record of a sensor that is turned.
pub(super) const TURNED: usize = 3;
/// Minimum part of the record in which the sensor is turned.
const MATERIAL: f64 = 0.3;
/// Minimum number of poses that determine nine numbers.
const POSES_MIN: usize = 12;
/// Largest scale of the residual, m/s².
const STEADY: f64 = 0.04;
/// Degrees of freedom of Student's t.
const FREEDOM: f64 = 3.0;
const STEPS: usize = 100;
/// Number of blocks of time that alternate between the halves.
const BLOCKS: usize = 8;

/// Windows, treated as momentary rests: their mean forces, turned to their middles, and the equation of each.
#[derive(Debug, Default)]
pub(super) struct Windows {
    pub(super) stands: Vec<Rest>,
    /// b, D, S by window, in the order of [`super::poses`].
    rows: Vec<[f64; 9]>,
}

impl Windows {
    /// Returns the windows of a record with gyro and accelerometer; the gyro's bias is that in its rests.
    pub(super) fn of(real: &Recording, accel: [&[f64]; 3], gyro: [&[f64]; 3], bias: Axes) -> Self {
        let size = (WINDOW_S * real.rate_hz) as usize;
        let mut all = Self::default();
        if size < 4 {
            return all;
        }
        let vector = |of: [&[f64]; 3], t: usize| Vector3::from(of.map(|values| values[t]));
        let bias = Vector3::from(bias);
        for from in (0..real.len() / size).map(|place| place * size) {
            let within = from..from + size;
            let lacks = |t: usize| real.is_missing(t) || accel.iter().chain(&gyro).any(|values| !values[t].is_finite());
            if within.clone().any(lacks) {
                continue;
            }
            let mut turned = Rotation3::identity();
            let mut attitudes = vec![turned];
            for t in within.start + 1..within.end {
                let rate = 0.5 * (vector(gyro, t) + vector(gyro, t - 1)) - bias;
                turned *= Rotation3::from_scaled_axis(rate / real.rate_hz);
                attitudes.push(turned);
            }
            let middle = attitudes[size / 2].inverse();
            let force: Vector3<f64> =
                within.clone().zip(&attitudes).map(|(t, at)| middle * (at * vector(accel, t))).sum::<Vector3<f64>>()
                    / size as f64;
            if force.norm() < 1.0 {
                continue;
            }
            let along = force.normalize();
            let (mut level, mut products) = (Vector3::zeros(), Matrix3::zeros());
            for (t, at) in within.clone().zip(&attitudes) {
                // The window's direction as the sensor has it at this sample.
                let here = at.inverse() * (attitudes[size / 2] * along);
                level += here / size as f64;
                products += here * vector(accel, t).transpose() / size as f64;
            }
            let pair = |k: usize, l: usize| products[(k, l)] + products[(l, k)];
            let [x, y, z]: Axes = level.into();
            let (d, s) = ([0, 1, 2].map(|k| products[(k, k)]), [pair(0, 1), pair(0, 2), pair(1, 2)]);
            all.rows.push([x, y, z, d[0], d[1], d[2], s[0], s[1], s[2]]);
            all.stands.push(Rest { within, force: force.into(), rate: None });
        }
        all
    }

    /// Returns whether the sensor was turned through poses, for a good part of the record, not just picked up once and
    /// laid down.
    pub(super) fn turn(&self, rests: &[Rest]) -> bool {
        let resting = |stand: &Rest| {
            let [middle, length] = [(stand.within.start + stand.within.end) / 2, stand.within.len()];
            rests.iter().any(|rest| rest.within.start < middle + length / 2 && middle < rest.within.end + length / 2)
        };
        let turned = self.stands.iter().filter(|stand| !resting(stand)).count();
        rests::poses(&self.stands) >= TURNED && turned as f64 >= MATERIAL * self.stands.len() as f64
    }
}

/// A fit of one subset.
struct Fit {
    numbers: Vec<f64>,
    inverse: DMatrix<f64>,
    scale: f64,
    nats: f64,
    left: Vec<f64>,
}

/// Returns the result of the windows. `None` if there are too few, or if they are too similar or too restless.
pub(super) fn quasi_static(windows: &Windows, options: &Options<'_>) -> Option<Tumbled> {
    let count = windows.rows.len();
    if count < LEAST || rests::poses(&windows.stands) < POSES_MIN {
        return None;
    }
    let magnitude = |rest: &Rest| rest.force.iter().map(|value| value * value).sum::<f64>().sqrt();
    let off: Vec<f64> = windows.stands.iter().map(|rest| magnitude(rest) - STANDARD_GRAVITY_M_S2).collect();
    let whole = |place: usize, number: usize| if number == 9 { 1.0 } else { windows.rows[place][number] };
    let fit = |parts: &[usize], among: &[usize]| -> Option<Fit> {
        let own = columns_of(parts);
        let design = DMatrix::from_fn(among.len(), own.len(), |row, column| whole(among[row], own[column]));
        let off = DVector::from_fn(among.len(), |row, _| off[among[row]]);
        student(&design, &off, &own)
    };
    let everywhere: Vec<usize> = (0..count).collect();
    let all: Vec<Fit> = (0..8usize)
        .map(|subset| fit(&(0..3).filter(|part| subset >> part & 1 == 1).collect::<Vec<_>>(), &everywhere))
        .collect::<Option<_>>()?;
    let priced = |part: Candidate| if options.wants(part.kind()) { price(3.0, options.level) } else { f64::INFINITY };
    let prices = PARTS.map(priced);
    // Similar neighbours count for fewer windows.
    let alike = all.last().map_or(0.0, |of| correlation(&of.left)).max(0.0);
    let fewer = (1.0 - alike) / (1.0 + alike);
    let cost = |subset: usize| (0..3).filter(|part| subset >> part & 1 == 1).map(|part| prices[part]).sum::<f64>();
    let score = |subset: usize| fewer * all[subset].nats - cost(subset);
    let own = (0..8).max_by(|one, other| score(*one).total_cmp(&score(*other)))?;
    let best = &all[own];
    if best.scale > STEADY {
        return None;
    }
    let parts: Vec<usize> = (0..3).filter(|part| own >> part & 1 == 1).collect();
    let gains = std::array::from_fn(|part| match own >> part & 1 {
        1 => fewer * (best.nats - all[own & !(1 << part)].nats),
        _ => 0.0,
    });
    let (mut values, mut errors) = ([0.0; 10], [0.0; 10]);
    for (place, number) in columns_of(&parts).into_iter().enumerate() {
        values[number] = best.numbers[place];
        errors[number] = (best.inverse[(place, place)].max(0.0) / fewer).sqrt();
    }
    if let Some(beside) = all.last().and_then(|of| errors_beside(&of.inverse, &parts, fewer)) {
        errors.iter_mut().zip(beside).for_each(|(error, beside)| *error = error.max(beside));
    }
    // A hand that turns about a point beside the sensor pulls it outward in every pose. This mean is about as large as the scatter, and
    // more windows do not make it smaller.
    for number in columns_of(&parts).into_iter().filter(|number| *number < 9) {
        let unit = if number < 3 { 1.0 } else { STANDARD_GRAVITY_M_S2 };
        errors[number] = errors[number].hypot(OUTWARD * best.scale / unit);
    }
    // Each half is predicted from the other.
    let mut held_out = 0.0;
    let (mut before, mut after) = (vec![0.0; count], vec![0.0; count]);
    let half = |parity: usize| (0..count).filter(|place| place * BLOCKS / count % 2 == parity).collect::<Vec<_>>();
    for (from, to) in [(half(0), half(1)), (half(1), half(0))] {
        let (plain, found) = (fit(&[], &from)?, fit(&parts, &from)?);
        let left = |of: &Fit, own: &[usize], place: usize| {
            let explained = own.iter().zip(&of.numbers).map(|(number, value)| whole(place, *number) * value);
            off[place] - explained.sum::<f64>()
        };
        for (fit, own, left_of, sign) in
            [(&found, columns_of(&parts), &mut after, 1.0), (&plain, columns_of(&[]), &mut before, -1.0)]
        {
            for place in &to {
                left_of[*place] = left(fit, &own, *place);
                held_out += sign * fewer * (density(left_of[*place] / fit.scale) - fit.scale.ln());
            }
        }
    }
    Some(Tumbled {
        values,
        errors,
        choice: Choice { gain: fewer * (best.nats - all[0].nats), groups: parts },
        gains,
        prices,
        held_out,
        before,
        after,
        // The scale is fitted, so that it explains all of the remaining scatter.
        p_value: 1.0,
    })
}

/// The mean of what a hand does in all windows alike, in units of the scatter from one to the next. Against an optical reference, the
/// bias z of one record was off by 2.2 (BROAD 01).
const OUTWARD: f64 = 1.5;

/// Returns ln of Student's density at a deviation in scales, without its constant.
fn density(of: f64) -> f64 {
    -0.5 * (FREEDOM + 1.0) * (of * of / FREEDOM).ln_1p()
}

/// Returns the most likely numbers and scale under Student's t with the numbers' priors, by expectation maximisation.
fn student(design: &DMatrix<f64>, off: &DVector<f64>, own: &[usize]) -> Option<Fit> {
    let count = design.nrows();
    let mut numbers = DVector::zeros(own.len());
    let mut inverse = DMatrix::zeros(own.len(), own.len());
    let mut square = off.norm_squared() / count as f64;
    for _ in 0..STEPS {
        let left = off - design * &numbers;
        let weights = left.map(|value| (FREEDOM + 1.0) / (FREEDOM + value * value / square.max(1e-18)));
        let weighed = DMatrix::from_fn(count, own.len(), |row, column| weights[row] * design[(row, column)]);
        let mut information = design.transpose() * &weighed / square.max(1e-18);
        let right = weighed.transpose() * off / square.max(1e-18);
        for (place, number) in own.iter().enumerate() {
            information[(place, place)] += prior_sd(*number).powi(-2);
        }
        inverse = inverse_of(&information, 1e-10)?;
        numbers = &inverse * right;
        let left = off - design * &numbers;
        square =
            left.iter().zip(weights.iter()).map(|(value, weight)| weight * value * value).sum::<f64>() / count as f64;
    }
    let left = off - design * &numbers;
    let scale = square.sqrt();
    let believed: f64 = own.iter().zip(numbers.iter()).map(|(number, value)| (value / prior_sd(*number)).powi(2)).sum();
    let nats =
        left.iter().map(|value| density(value / scale)).sum::<f64>() - count as f64 * scale.ln() - 0.5 * believed;
    // Student's information about a location is (ν + 1)/(ν + 3) of the weights'.
    inverse *= (FREEDOM + 3.0) / (FREEDOM + 1.0);
    let (numbers, left) = (numbers.iter().copied().collect(), left.iter().copied().collect());
    nats.is_finite().then_some(Fit { numbers, inverse, scale, nats, left })
}

/// Returns the correlation of neighbours.
fn correlation(of: &[f64]) -> f64 {
    let square: f64 = of.iter().map(|value| value * value).sum();
    let next: f64 = of.windows(2).map(|pair| pair[0] * pair[1]).sum();
    if square > 0.0 { (next / square).clamp(-0.99, 0.99) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_core::sample::{Channel, Triad};
    use imu_model::effects::{Stream, StreamId};

    const RATE_HZ: f64 = 100.0;

    /// Returns a record of a sensor that is turned slowly about changing axes for 3 min and shaken a little. `shows`
    /// maps the force to the sensor's output.
    fn turned(seed: u64, shaken: f64, shows: impl Fn([f64; 3]) -> [f64; 3]) -> Recording {
        let mut draw = Stream::new(seed, StreamId { owner: 0, effect: 0, instance: 0 });
        let n = 18_000;
        let mut down = Vector3::new(0.3, -0.5, -0.8).normalize();
        let mut channels: Vec<(Channel, Vec<f64>)> = [Triad::Gyro, Triad::Accel]
            .iter()
            .flat_map(|of| of.channels())
            .map(|of| (of, Vec::with_capacity(n)))
            .collect();
        let mut jolt = Vector3::zeros();
        let mut next = || -> f64 { draw.normal() };
        for t in 0..n {
            let s = t as f64 / RATE_HZ;
            let rate = Vector3::new(0.8 * (0.41 * s).sin(), 0.9 * (0.23 * s + 1.0).cos(), 0.7 * (0.31 * s + 2.0).sin());
            // In the sensor's frame, the earth turns the other way; the mean rate applies between two samples.
            down = Rotation3::from_scaled_axis(-rate / RATE_HZ) * down;
            jolt = 0.98 * jolt + shaken * 0.2 * Vector3::new(next(), next(), next());
            let force = -STANDARD_GRAVITY_M_S2 * down + jolt;
            let shown = shows(force.into());
            for (axis, (rate, shown)) in rate.iter().zip(shown).enumerate() {
                channels[axis].1.push(rate + 1e-3 * next());
                channels[3 + axis].1.push(shown + 0.01 * next());
            }
        }
        Recording { rate_hz: RATE_HZ, channels, ..Recording::default() }
    }

    fn found(real: &Recording) -> Option<Tumbled> {
        let of = |triad: Triad| triad.channels().map(|channel| real.values(channel).unwrap());
        let windows = Windows::of(real, of(Triad::Accel), of(Triad::Gyro), [0.0; 3]);
        assert!(windows.turn(&[]));
        quasi_static(&windows, &Options { level: 0.05, ..Options::default() })
    }

    #[test]
    fn a_slow_turn_determines_bias_and_scale_within_their_errors() {
        let bias = [0.06, -0.04, 0.08];
        let scale = [0.004, -0.006, 0.005];
        let real = turned(1, 0.05, |force| std::array::from_fn(|axis| force[axis] * (1.0 + scale[axis]) + bias[axis]));
        let found = found(&real).unwrap();
        assert_eq!(found.choice.groups, [0, 1]);
        for (number, truth) in bias.into_iter().chain(scale).enumerate() {
            let (value, error) = (found.values[number], found.errors[number]);
            // The errors hold what a hand does in all windows alike; this one does nothing of the kind.
            assert!((value - truth).abs() < 0.02 && error < 0.06, "{number}: {value} ± {error} for {truth}");
        }
        assert!(found.held_out > 0.8 * found.choice.gain, "{} of {}", found.held_out, found.choice.gain);
    }

    #[test]
    fn a_true_accelerometer_is_blamed_for_nothing_and_a_wild_hand_determines_nothing() {
        for seed in 2..7 {
            let found = found(&turned(seed, 0.05, |force| force)).unwrap();
            assert!(found.choice.groups.is_empty(), "{seed}: {:?} {:?}", found.choice, found.values);
        }
        assert!(found(&turned(8, 3.0, |force| force)).is_none());
    }
}
