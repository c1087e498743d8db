//! Equaliser: turns a record whose white noise changes with time into one whose white noise is even.

use super::dot::dot;
use super::phase;
use super::transform::Cosines;

/// A record x is the sum of white noise w, whose variance v changes with time, and the rest s, of spectrum S. Given x,
/// both are drawn from their conditional distribution (Hoffman and Ribak 1991, Astrophys. J. 380). With draws s' and w'
/// from their laws, s is s' + C(C + V)⁻¹(x − s' − w'); C is the covariance of S and V that of w. Then s + w/√v has the
/// spectrum S + 1, exactly. Every method that requires the same noise throughout may therefore be applied to it.
///
/// Behind filters the record is s + Fw, and noise that enters behind them is part of s: F·V·Fᵀ takes the place of V, and
/// s + F(w/√v) has the spectrum S + |F|². The filters' phase is removed first ([`phase::undo`]) and restored afterwards, so that
/// |F| takes the place of F.
#[derive(Debug, Clone)]
pub(super) struct Equaliser {
    /// Standard deviation of the white noise at each sample; without filters, [`Equaliser::UNKNOWN`] times the largest for
    /// samples without information.
    pub(super) deviation: Vec<f64>,
    /// The standard deviation of the white noise at variance 1.
    pub(super) white: f64,
    /// Power of the rest in each coefficient.
    pub(super) rest: Vec<f64>,
    /// The filters' gain of the white noise in each coefficient; empty without filters.
    pub(super) gain: Vec<f64>,
    /// The squares of the gain.
    pub(super) squares: Vec<f64>,
    /// (C + V)⁻¹(x − s' − w') for the record.
    pub(super) solution: Vec<f64>,
}

impl Equaliser {
    /// Standard deviations of unknown samples, over the largest.
    pub(super) const UNKNOWN: f64 = 1e3;

    /// Returns the values of the record with even white noise; `white` is its standard deviation as a multiple of the
    /// noise's own. `None` if the solver found no solution.
    pub(super) fn apply(&self, transform: &mut Cosines, values: &[f64]) -> Option<Vec<f64>> {
        let mut values = values.to_vec();
        phase::undo(&mut values, &self.squares);
        let solution = self.solve(transform, &values, None)?;
        let mut even = self.even(transform, &values, &solution);
        phase::redo(&mut even, &self.squares);
        Some(even)
    }

    /// Returns the power gain of the white noise in a coefficient.
    fn passed(&self, place: usize) -> f64 {
        self.squares.get(place).copied().unwrap_or(1.0)
    }

    /// Returns the part of the information about the white noise's variance at a place that the rest of the noise
    /// leaves, and the derivative of the variance's logarithm by that of the rest's power.
    pub(super) fn left(&self, place: usize) -> (f64, f64) {
        let white = self.deviation[place] * self.deviation[place];
        let (mut squares, mut products) = (0.0, 0.0);
        for (at, rest) in self.rest.iter().enumerate() {
            let white = white * self.passed(at);
            let share = white / (white + rest).max(f64::MIN_POSITIVE);
            squares += share * share;
            products += share * (1.0 - share);
        }
        (squares / self.rest.len() as f64, products / squares)
    }

    /// Returns the result of [`Self::apply`], given (C + V)⁻¹ times the values: the most probable rest is C times that.
    pub(super) fn even(&self, transform: &mut Cosines, values: &[f64], solution: &[f64]) -> Vec<f64> {
        let mut even = self.filtered(transform, solution, &|s| s);
        if self.gain.is_empty() {
            let places = even.iter_mut().zip(values).zip(&self.deviation);
            places.for_each(|((slow, x), own)| *slow += self.white * (x - *slow) / own);
            return even;
        }
        // The most probable w/√v is √v·Fᵀ times the solution.
        let mut fast = self.behind(transform, solution.to_vec());
        fast.iter_mut().zip(&self.deviation).for_each(|(fast, own)| *fast *= self.white * own);
        let fast = self.behind(transform, fast);
        even.iter_mut().zip(fast).for_each(|(even, fast)| *even += fast);
        even
    }

    /// Returns values behind the filters.
    pub(super) fn behind(&self, transform: &mut Cosines, mut values: Vec<f64>) -> Vec<f64> {
        if !self.gain.is_empty() {
            transform.forward(&mut values);
            values.iter_mut().zip(&self.gain).for_each(|(c, gain)| *c *= gain);
            transform.backward(&mut values);
        }
        values
    }

    /// Returns values whose coefficients are multiplied by a function of the rest's power.
    fn filtered(&self, transform: &mut Cosines, values: &[f64], gain: &dyn Fn(f64) -> f64) -> Vec<f64> {
        let mut c = values.to_vec();
        transform.forward(&mut c);
        c.iter_mut().zip(&self.rest).for_each(|(c, s)| *c *= gain(*s));
        transform.backward(&mut c);
        c
    }

    /// Returns values over the white noise's deviation.
    fn whitened(&self, values: &[f64]) -> Vec<f64> {
        values.iter().zip(&self.deviation).map(|(x, own)| x / own).collect()
    }

    /// Returns (C + V)⁻¹ times values, from a starting point near the solution if one is known.
    ///
    /// Uses conjugate gradients on (1 + V^−½·C·V^−½), which the inverse of 1 + S/v̄ brings near to 1.
    pub(super) fn solve(&self, transform: &mut Cosines, values: &[f64], near: Option<&[f64]>) -> Option<Vec<f64>> {
        let usual = (2.0 * self.deviation.iter().map(|own| own.ln()).sum::<f64>() / values.len() as f64).exp();
        if !self.gain.is_empty() {
            return self.solve_behind(transform, values, near, usual);
        }
        let nearly =
            |transform: &mut Cosines, values: &[f64]| self.filtered(transform, values, &|s| 1.0 / (1.0 + s / usual));
        let image = |transform: &mut Cosines, values: &[f64]| {
            let mut image = self.whitened(&self.filtered(transform, &self.whitened(values), &|s| s));
            image.iter_mut().zip(values).for_each(|(i, x)| *i += x);
            image
        };
        let near = near.map(|near| near.iter().zip(&self.deviation).map(|(x, own)| x * own).collect());
        let solution = conjugate_gradients(transform, self.whitened(values), near, &image, &nearly, PRECISE)?;
        Some(self.whitened(&solution))
    }

    /// Returns the result of [`Self::solve`] behind filters. `usual` is v̄.
    ///
    /// Uses conjugate gradients on the coefficients' matrix S + |F|·V·|F|, which the inverse of S + v̄·|F|² brings near to 1.
    fn solve_behind(
        &self,
        transform: &mut Cosines,
        values: &[f64],
        near: Option<&[f64]>,
        usual: f64,
    ) -> Option<Vec<f64>> {
        let places = self.rest.iter().zip(&self.squares);
        let about: Vec<f64> = places.map(|(s, passed)| (s + usual * passed).max(f64::MIN_POSITIVE)).collect();
        let nearly =
            |_: &mut Cosines, c: &[f64]| -> Vec<f64> { c.iter().zip(&about).map(|(c, about)| c / about).collect() };
        let image = |transform: &mut Cosines, c: &[f64]| -> Vec<f64> {
            let mut white: Vec<f64> = c.iter().zip(&self.gain).map(|(c, gain)| c * gain).collect();
            transform.backward(&mut white);
            white.iter_mut().zip(&self.deviation).for_each(|(w, own)| *w *= own * own);
            transform.forward(&mut white);
            let places = white.iter().zip(&self.gain).zip(c.iter().zip(&self.rest));
            places.map(|((white, gain), (c, s))| white * gain + c * s).collect()
        };
        let coefficients = |transform: &mut Cosines, values: &[f64]| {
            let mut c = values.to_vec();
            transform.forward(&mut c);
            c
        };
        let near = near.map(|near| coefficients(transform, near));
        let values = coefficients(transform, values);
        let mut solution = conjugate_gradients(transform, values, near, &image, &nearly, PRECISE_BEHIND)?;
        transform.backward(&mut solution);
        Some(solution)
    }

    /// Returns the factor by which a slow change of a sine's amplitude is multiplied at each sample, for a sine at the
    /// frequency of this coefficient.
    pub(super) fn factors(&self, place: usize) -> impl Iterator<Item = f64> {
        let power = self.rest.get(place).copied().unwrap_or_default();
        let (white, passed) = (self.white, self.passed(place));
        let sum = move |white: f64| power + white * passed;
        self.deviation.iter().map(move |own| sum(own * white) / sum(own * own).max(f64::MIN_POSITIVE))
    }
}

/// When conjugate gradients end.
struct Precision {
    rounds: usize,
    /// Squares of the residual, relative to the values' own square: the one that counts as 0, and the largest
    /// acceptable one.
    enough: f64,
    most: f64,
}

const PRECISE: Precision = Precision { rounds: 100, enough: 1e-8, most: 1e-4 };
/// Behind filters the residual is relative to the usual noise, and at quiet times the noise is much smaller.
const PRECISE_BEHIND: Precision = Precision { rounds: 200, enough: 1e-10, most: 1e-6 };

/// A linear function of a record or of its coefficients.
type Linear<'a> = &'a dyn Fn(&mut Cosines, &[f64]) -> Vec<f64>;

/// Solves a symmetric positive equation by conjugate gradients, from a starting point near the solution if one is known.
/// `image` multiplies by the matrix, and `nearly` about by its inverse. `None` if the rounds end far from the solution.
fn conjugate_gradients(
    transform: &mut Cosines,
    values: Vec<f64>,
    near: Option<Vec<f64>>,
    image: Linear<'_>,
    nearly: Linear<'_>,
    precision: Precision,
) -> Option<Vec<f64>> {
    /// The number of samples that all rounds together may transform.
    const WORK: usize = 60_000_000;
    let n = values.len();
    let mut residual = values;
    let all = dot(&residual, &nearly(transform, &residual));
    let mut solution = vec![0.0; n];
    if let Some(near) = near {
        solution = near;
        let there = image(transform, &solution);
        residual.iter_mut().zip(&there).for_each(|(r, i)| *r -= i);
    }
    let mut direction = nearly(transform, &residual);
    let mut square = dot(&residual, &direction);
    for _ in 0..precision.rounds.min(WORK / n.max(1)) {
        if square <= precision.enough * all || square.is_nan() {
            break;
        }
        let there = image(transform, &direction);
        let step = square / dot(&direction, &there);
        solution.iter_mut().zip(&direction).for_each(|(x, d)| *x += step * d);
        residual.iter_mut().zip(&there).for_each(|(r, i)| *r -= step * i);
        let nearer = nearly(transform, &residual);
        let next = dot(&residual, &nearer);
        let ratio = next / square;
        direction.iter_mut().zip(&nearer).for_each(|(d, r)| *d = r + ratio * *d);
        square = next;
    }
    (square <= precision.most * all).then_some(solution)
}
