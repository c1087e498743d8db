//! Poses: a tumble without a reference. Gravity is the same in every pose. Its magnitude determines the accelerometer's
//! scale factors, biases and cross-axis sensitivities. A turn by a full circle between two rests in one pose determines
//! the gyro's scale factor.
//!
//! At rest in pose i the accelerometer's mean is mᵢ = (1 + D + S)·fᵢ + b + noise with |fᵢ| = g. D is diagonal (scale
//! factors), S is symmetric without a diagonal (cross-axis sensitivity), and b is the bias. With u = m/|m|, to first
//! order |mᵢ| − g = g·Σ D_k·u_k² + 2g·Σ S_kl·u_k·u_l + Σ b_k·u_k. These are nine numbers, linear, with one equation per
//! pose (Frosio, Pedersini and Borghese 2009, IEEE Trans. Instrum. Meas. 58; IEEE Std 1293, the multi-position tumble).
//! Gauss–Newton steps add the terms of second order. A rotation of the whole triad does not change magnitudes and does
//! not show.
//!
//! Local gravity is known to 0.13 % (9.780 m/s² at the equator, 9.832 at the poles): it is a tenth number with that
//! prior. A common error of all scale factors is therefore identified only beyond that uncertainty.
//!
//! The noise of a mean over T s is N²/T, flicker's about B², and a walk's K²·min(tᵢ, tⱼ), which the poses share.

use super::groups::Pricing;
use super::rests::Rest;
use super::select::Choice;
use crate::options::Options;
use crate::response::Candidate;
use imu_core::sample::Triad;
use imu_model::effects::triad::Axes;
use imu_model::simulator::SensorModel;
use nalgebra::{Cholesky, DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF as _, Normal};

/// Gravity and its prior standard deviation, m/s².
const GRAVITY: f64 = imu_core::units::STANDARD_GRAVITY_M_S2;
pub(super) const GRAVITY_SD: f64 = 0.013;
/// Minimum number of distinct poses.
pub const POSES_MIN: usize = 6;
/// Variance of flicker's mean over a rest about the record's mean, in B²: about ln of the record's length over the
/// rest's.
const FLICKER: f64 = 1.0;
/// Variance of the record's mean about 0, which all poses share, in B²: flicker down to a thirty-second of the record's
/// own frequency.
const FLICKER_OF_ALL: f64 = 1.13;
/// Priors of an accelerometer's errors, as standard deviations: bias in m/s², the others as fractions. A number that
/// the poses do not show keeps its prior.
const OFF: [f64; 2] = [1.0, 0.1];
/// What a sensor may have of a number that was not chosen, as standard deviations. A bias along an axis that never turns over looks
/// like a scale factor of that axis, so that its error has a part of this.
const BESIDE_OFF: [f64; 2] = [0.05, 0.005];
const STEPS: usize = 8;
/// How far a turn by hand may end from its start, rad: half a degree.
const PLACED: f64 = 0.0087;
/// Maximum deviation of a turn from whole circles, as a part.
const WHOLE: f64 = 0.04;
/// The largest turn about other axes, or back, as a part of the turn: the path of noise and the tremble of a hand.
const BESIDE: f64 = 0.2;

/// The effects that poses determine.
pub(super) const PARTS: [Candidate; 3] = [Candidate::Bias, Candidate::ScaleFactor, Candidate::CrossAxisSensitivity];

/// The result of a tumble for the accelerometer.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tumbled {
    /// b, D, S (three numbers each) and gravity, with their standard errors; 0 for numbers that were not chosen.
    pub(super) values: [f64; 10],
    pub(super) errors: [f64; 10],
    pub(super) choice: Choice,
    /// Nats of each chosen part given the others, and its price.
    pub(super) gains: [f64; 3],
    pub(super) prices: [f64; 3],
    /// Nats that the chosen numbers, fitted to all other poses, explain of each pose.
    pub(super) held_out: f64,
    /// |m| − g per rest, m/s², before and after; for windows, each half with the numbers of the other half.
    pub(super) before: Vec<f64>,
    pub(super) after: Vec<f64>,
    /// Chance that the remainder is noise.
    pub(super) p_value: f64,
}

/// A scale factor of the gyro, from turns by whole circles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Turned {
    pub(super) axis: usize,
    pub(super) error: f64,
    pub(super) scale: f64,
    pub(super) circles: f64,
    pub(super) from_s: f64,
}

fn length(of: Axes) -> f64 {
    of.iter().map(|value| value * value).sum::<f64>().sqrt()
}

/// Returns the force that a sensor with these numbers turns into a mean: (1 + D + S)⁻¹(m − b), to second order.
fn felt(mean: Axes, numbers: &[f64]) -> Axes {
    let less: Axes = std::array::from_fn(|axis| mean[axis] - numbers[axis]);
    let mixed = |of: Axes| -> Axes {
        let [x, y, z] = of;
        let (d, s) = (&numbers[3..6], &numbers[6..9]);
        [d[0] * x + s[0] * y + s[1] * z, d[1] * y + s[0] * x + s[2] * z, d[2] * z + s[1] * x + s[2] * y]
    };
    let once = mixed(less);
    let twice = mixed(once);
    std::array::from_fn(|axis| less[axis] - once[axis] + twice[axis])
}

/// Returns the standard deviation of the prior of a number: gravity is the last; others are biases and fractions.
pub(super) fn prior_sd(number: usize) -> f64 {
    match number {
        9 => GRAVITY_SD,
        0..3 => OFF[0],
        _ => OFF[1],
    }
}

/// Returns the numbers of parts; gravity is always included.
pub(super) fn columns_of(parts: &[usize]) -> Vec<usize> {
    parts.iter().flat_map(|part| 3 * part..3 * part + 3).chain([9]).collect()
}

/// Returns the nats that this many numbers have to explain, at a level over the three parts.
pub(super) fn price(numbers: f64, level: f64) -> f64 {
    ChiSquared::new(numbers).map_or(f64::INFINITY, |of| 0.5 * of.inverse_cdf(1.0 - level / PARTS.len() as f64))
}

/// Returns the inverse of an information matrix, 0 along directions with less than this part of the largest information.
pub(super) fn inverse_of(matrix: &DMatrix<f64>, least: f64) -> Option<DMatrix<f64>> {
    let scales = matrix.diagonal().map(|value| value.max(1e-300).sqrt().recip());
    let scaled = |of: &DMatrix<f64>| {
        DMatrix::from_fn(of.nrows(), of.ncols(), |row, column| of[(row, column)] * scales[row] * scales[column])
    };
    Some(scaled(&scaled(matrix).pseudo_inverse(least).ok()?))
}

/// Returns the standard errors of the chosen parts' numbers if the others are what sensors usually have of them. `inverse` is that of
/// the information on all ten numbers, divided by `fewer`.
pub(super) fn errors_beside(inverse: &DMatrix<f64>, parts: &[usize], fewer: f64) -> Option<[f64; 10]> {
    let mut matrix = inverse.clone().try_inverse()? * fewer;
    let own = columns_of(parts);
    for number in (0..10).filter(|number| !own.contains(number)) {
        matrix[(number, number)] += BESIDE_OFF[usize::from(number >= 3)].powi(-2);
    }
    let inverse = matrix.try_inverse()?;
    Some(std::array::from_fn(
        |number| if own.contains(&number) { inverse[(number, number)].max(0.0).sqrt() } else { 0.0 },
    ))
}

/// Fits the tumble. None if there are too few poses or if the noise is not valid.
pub(super) fn tumbled(
    rests: &[Rest],
    rate_hz: f64,
    model: &SensorModel,
    options: &Options<'_>,
    mean_freedom: f64,
) -> Option<Tumbled> {
    let level = options.level;
    let count = rests.len();
    let channels = Triad::Accel.channels();
    let noise: Vec<[f64; 3]> = channels
        .iter()
        .map(|channel| model.channels.get(channel).map(|of| [of.n, of.b, of.k]))
        .collect::<Option<_>>()?;
    let unit: Vec<Axes> = rests.iter().map(|rest| rest.force.map(|value| value / length(rest.force))).collect();
    let at_s = |rest: &Rest| 0.5 * (rest.within.start + rest.within.end) as f64 / rate_hz;
    let covariance = DMatrix::from_fn(count, count, |row, column| {
        (0..3)
            .map(|axis| {
                let [n, b, k] = noise[axis];
                let own = if row == column {
                    n * n * rate_hz / rests[row].within.len() as f64 + FLICKER * b * b
                } else {
                    0.0
                };
                let walk = k * k * at_s(&rests[row]).min(at_s(&rests[column]));
                unit[row][axis] * unit[column][axis] * (own + FLICKER_OF_ALL * b * b + walk)
            })
            .sum()
    });
    let root = Cholesky::new(covariance)?;
    let lower = root.l();
    let weigh = |values: DVector<f64>| lower.solve_lower_triangular(&values);
    let misfit = |numbers: &[f64], places: &[usize]| {
        DVector::from_iterator(
            places.len(),
            places.iter().map(|place| length(felt(rests[*place].force, numbers)) - GRAVITY - numbers[9]),
        )
    };
    let everywhere: Vec<usize> = (0..count).collect();
    // Gauss–Newton over the chosen numbers, with numeric derivatives.
    let fit = |parts: &[usize], keep: &[f64]| -> Option<(Vec<f64>, DMatrix<f64>, f64)> {
        let own = columns_of(parts);
        let mut numbers = vec![0.0; 10];
        let mut inverse = DMatrix::zeros(own.len(), own.len());
        let mut square = f64::INFINITY;
        for _ in 0..STEPS {
            let residual = weigh(misfit(&numbers, &everywhere))?;
            let mut design = DMatrix::zeros(count, own.len());
            for (place, number) in own.iter().enumerate() {
                let step = if (3..9).contains(number) { 1e-5 } else { 1e-4 };
                let mut moved = numbers.clone();
                moved[*number] += step;
                let change = (weigh(misfit(&moved, &everywhere))? - &residual) / -step;
                design.set_column(place, &change);
            }
            let weights = DMatrix::from_diagonal(&DVector::from_column_slice(keep));
            let mut matrix = design.transpose() * &weights * &design;
            let mut right = design.transpose() * &weights * &residual;
            for (place, number) in own.iter().enumerate() {
                matrix[(place, place)] += prior_sd(*number).powi(-2);
                right[place] -= numbers[*number] / prior_sd(*number).powi(2);
            }
            inverse = inverse_of(&matrix, 1e-9)?;
            let step = &inverse * right;
            for (number, step) in own.iter().zip(step.iter()) {
                numbers[*number] += step;
            }
            let left = weigh(misfit(&numbers, &everywhere))?;
            let believed: f64 = own.iter().map(|number| (numbers[*number] / prior_sd(*number)).powi(2)).sum();
            square = left.iter().zip(keep).map(|(value, keep)| keep * value * value).sum::<f64>() + believed;
        }
        Some((numbers, inverse, square))
    };
    let all = vec![1.0; count];
    // The price of a bias depends on how well flicker's level is known, as with a reference.
    let of_mean = Pricing { level, triads: 1, mean_freedom }.price_of_mean(3, PARTS.len());
    let prices = PARTS.map(|part| match part {
        part if !options.wants(part.kind()) => f64::INFINITY,
        Candidate::Bias => of_mean,
        _ => price(3.0, level),
    });
    let mut best: Option<(f64, Vec<usize>)> = None;
    let mut squares = [0.0; 8];
    for (subset, kept) in squares.iter_mut().enumerate() {
        let parts: Vec<usize> = (0..3).filter(|part| subset >> part & 1 == 1).collect();
        // As many numbers as poses explain any data; gravity's number has a prior in addition.
        if 3 * parts.len() > count {
            *kept = f64::INFINITY;
            continue;
        }
        let (_, _, square) = fit(&parts, &all)?;
        *kept = square;
        let score = -0.5 * square - parts.iter().map(|part| prices[*part]).sum::<f64>();
        if best.as_ref().is_none_or(|(most, _)| score > *most) {
            best = Some((score, parts));
        }
    }
    let (_, parts) = best?;
    let own: usize = parts.iter().map(|part| 1 << part).sum();
    let (numbers, inverse, square) = fit(&parts, &all)?;
    let gains =
        std::array::from_fn(
            |part| {
                if own >> part & 1 == 1 { 0.5 * (squares[own & !(1 << part)] - square) } else { 0.0 }
            },
        );
    let mut errors = [0.0; 10];
    for (place, number) in columns_of(&parts).into_iter().enumerate() {
        errors[number] = inverse[(place, place)].max(0.0).sqrt();
    }
    if let Some(beside) = fit(&[0, 1, 2], &all).and_then(|(_, inverse, _)| errors_beside(&inverse, &parts, 1.0)) {
        errors.iter_mut().zip(beside).for_each(|(error, beside)| *error = error.max(beside));
    }
    // Each pose is predicted from the others.
    let mut held_out = 0.0;
    let (plain, _, _) = fit(&[], &all)?;
    let before_w = weigh(misfit(&plain, &everywhere))?;
    if !parts.is_empty() {
        for place in 0..count {
            let keep: Vec<f64> = (0..count).map(|other| f64::from(u8::from(other != place))).collect();
            let (others, _, _) = fit(&parts, &keep)?;
            let after = weigh(misfit(&others, &everywhere))?;
            held_out += 0.5 * (before_w[place].powi(2) - after[place].powi(2));
        }
    }
    let freedom = (count + 1).saturating_sub(columns_of(&parts).len());
    let p_value =
        ChiSquared::new(freedom as f64).map_or(1.0, |of| if freedom == 0 { 1.0 } else { 1.0 - of.cdf(square) });
    let values: [f64; 10] = std::array::from_fn(|place| numbers[place]);
    Some(Tumbled {
        values,
        errors,
        choice: Choice { gain: 0.5 * (squares[0] - square), groups: parts },
        gains,
        prices,
        held_out,
        before: misfit(&plain, &everywhere).iter().copied().collect(),
        after: misfit(&numbers, &everywhere).iter().copied().collect(),
        p_value,
    })
}

/// Returns scale factors of the gyro from turns by whole circles between two rests in one pose, about the axis that
/// points up or down.
pub(super) fn turned(rests: &[Rest], gyro: [&[f64]; 3], rate_hz: f64, n: [f64; 3], level: f64) -> Vec<Turned> {
    let price = Normal::standard().inverse_cdf(1.0 - 0.5 * level / 3.0);
    let mut found: Vec<Turned> = Vec::new();
    for pair in rests.windows(2) {
        let (Some(before), Some(after)) = (pair[0].rate, pair[1].rate) else { continue };
        let [one, other] = [&pair[0].force, &pair[1].force].map(|force| force.map(|value| value / length(*force)));
        let along: f64 = one.iter().zip(other).map(|(one, other)| one * other).sum();
        let upright = (0..3).find(|axis| one[*axis].abs() > 0.98);
        let Some(axis) = upright.filter(|_| along > (2.0 * PLACED).cos()) else { continue };
        let (from, to) = (pair[0].within.end, pair[1].within.start);
        if to <= from {
            continue;
        }
        let bias = 0.5 * (before[axis] + after[axis]);
        let angle: f64 = gyro[axis][from..to].iter().map(|value| (value - bias) / rate_hz).sum();
        let circles = (angle.abs() / std::f64::consts::TAU).round();
        let whole = circles * std::f64::consts::TAU;
        // The turn must be about this axis alone and in one direction: otherwise, angles of single axes do not add up
        // to circles.
        let path = |of: usize| {
            let rested = 0.5 * (before[of] + after[of]);
            gyro[of][from..to].iter().map(|value| (value - rested).abs() / rate_hz).sum::<f64>()
        };
        let about = (0..3).filter(|of| *of != axis).map(path).sum::<f64>() < BESIDE * angle.abs();
        let one_way = path(axis) < (1.0 + BESIDE) * angle.abs();
        if circles < 1.0 || (angle.abs() / whole - 1.0).abs() > WHOLE || !about || !one_way {
            continue;
        }
        let seconds = (to - from) as f64 / rate_hz;
        let rested: f64 =
            pair.iter().map(|rest| 0.25 * rate_hz / rest.within.len() as f64).sum::<f64>() * n[axis] * n[axis];
        let error = (n[axis] * n[axis] * seconds + rested * seconds * seconds + PLACED * PLACED).sqrt() / whole;
        let scale = angle.abs() / whole - 1.0;
        let from_s = from as f64 / rate_hz;
        match found.iter_mut().find(|other| other.axis == axis) {
            // Several turns about an axis are weighted by their errors.
            Some(other) => {
                let weights = [other.error.powi(-2), error.powi(-2)];
                other.scale = (weights[0] * other.scale + weights[1] * scale) / (weights[0] + weights[1]);
                other.error = (weights[0] + weights[1]).powf(-0.5);
                other.circles += circles;
            }
            None => found.push(Turned { axis, error, scale, circles, from_s }),
        }
    }
    found.retain(|one| one.scale.abs() > price * one.error);
    found
}
