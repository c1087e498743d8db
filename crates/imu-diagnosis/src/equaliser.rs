//! Equaliser: turns a record whose white noise changes with time into one whose white noise is even.

use super::dot::dot;
use super::filling::stream;
use super::series::Series;
use super::transform::Cosines;

/// The random stream of the draws.
const DRAWN: u16 = 7;

/// A record x is the sum of white noise w, whose variance v changes with time, and the rest s, of spectrum S. Given x,
/// both are drawn from their conditional distribution (Hoffman and Ribak 1991, Astrophys. J. 380). With draws s' and w'
/// from their laws, s is s' + C(C + V)⁻¹(x − s' − w'); C is the covariance of S and V that of w. Then s + w/√v has the
/// spectrum S + 1, exactly. Every method that requires the same noise throughout may therefore be applied to it. A
/// filter that acts behind the white noise cannot be undone in this way, and is left as it is.
#[derive(Debug, Clone)]
pub(super) struct Equaliser {
    /// Standard deviation of the white noise at each sample; [`Equaliser::UNKNOWN`] times the largest for samples without
    /// information.
    deviation: Vec<f64>,
    /// The standard deviation of the white noise at variance 1.
    white: f64,
    /// Power of the rest in each coefficient.
    rest: Vec<f64>,
    /// (C + V)⁻¹(x − s' − w') for the record.
    solution: Vec<f64>,
}

impl Equaliser {
    /// Standard deviations of unknown samples, over the largest.
    const UNKNOWN: f64 = 1e3;

    /// Returns the values of the record with even white noise; `white` is its standard deviation as a multiple of the
    /// noise's own. `None` if the solver found no solution.
    pub(super) fn apply(&self, transform: &mut Cosines, values: &[f64]) -> Option<Vec<f64>> {
        let solution = self.solve(transform, values, None)?;
        Some(self.even(transform, values, &solution))
    }

    /// Returns the part of the information about the white noise's variance at a place that the rest of the noise
    /// leaves, and the derivative of the variance's logarithm by that of the rest's power.
    pub(super) fn left(&self, place: usize) -> (f64, f64) {
        let white = self.deviation[place] * self.deviation[place];
        let (mut squares, mut products) = (0.0, 0.0);
        for rest in &self.rest {
            let share = white / (white + rest);
            squares += share * share;
            products += share * (1.0 - share);
        }
        (squares / self.rest.len() as f64, products / squares)
    }

    /// Returns the result of [`Self::apply`], given (C + V)⁻¹ times the values: the most probable rest is C times that.
    fn even(&self, transform: &mut Cosines, values: &[f64], solution: &[f64]) -> Vec<f64> {
        let mut slow = self.filtered(transform, solution, &|s| s);
        let places = slow.iter_mut().zip(values).zip(&self.deviation);
        places.for_each(|((slow, x), own)| *slow += self.white * (x - *slow) / own);
        slow
    }

    /// Returns values over the white noise's deviation.
    fn whitened(&self, values: &[f64]) -> Vec<f64> {
        values.iter().zip(&self.deviation).map(|(x, own)| x / own).collect()
    }

    /// Returns values whose coefficients are multiplied by a function of the rest's power.
    fn filtered(&self, transform: &mut Cosines, values: &[f64], gain: &dyn Fn(f64) -> f64) -> Vec<f64> {
        let mut c = values.to_vec();
        transform.forward(&mut c);
        c.iter_mut().zip(&self.rest).for_each(|(c, s)| *c *= gain(*s));
        transform.backward(&mut c);
        c
    }

    /// Returns (1 + V^−½·C·V^−½) times values.
    fn image(&self, transform: &mut Cosines, values: &[f64]) -> Vec<f64> {
        let mut image = self.whitened(&self.filtered(transform, &self.whitened(values), &|s| s));
        image.iter_mut().zip(values).for_each(|(i, x)| *i += x);
        image
    }

    /// Returns (C + V)⁻¹ times values, from a starting point near the solution if one is known.
    ///
    /// Uses conjugate gradients on (1 + V^−½·C·V^−½), which the inverse of 1 + S/v̄ brings near to 1.
    fn solve(&self, transform: &mut Cosines, values: &[f64], near: Option<&[f64]>) -> Option<Vec<f64>> {
        const ROUNDS: usize = 100;
        /// The number of samples that all rounds together may transform.
        const WORK: usize = 60_000_000;
        /// Squares of the residual, relative to the values' own square: the one that counts as 0, and the largest
        /// acceptable one.
        const ENOUGH: f64 = 1e-8;
        const MOST: f64 = 1e-4;
        let n = values.len();
        let usual = (2.0 * self.deviation.iter().map(|own| own.ln()).sum::<f64>() / n as f64).exp();
        let nearly = |s: f64| 1.0 / (1.0 + s / usual);
        let mut residual = self.whitened(values);
        let all = dot(&residual, &self.filtered(transform, &residual, &nearly));
        let mut solution = match near {
            Some(near) => near.iter().zip(&self.deviation).map(|(x, own)| x * own).collect(),
            None => vec![0.0; n],
        };
        if near.is_some() {
            let image = self.image(transform, &solution);
            residual.iter_mut().zip(&image).for_each(|(r, i)| *r -= i);
        }
        let mut direction = self.filtered(transform, &residual, &nearly);
        let mut square = dot(&residual, &direction);
        for _ in 0..ROUNDS.min(WORK / n.max(1)) {
            if square <= ENOUGH * all || square.is_nan() {
                break;
            }
            let image = self.image(transform, &direction);
            let step = square / dot(&direction, &image);
            solution.iter_mut().zip(&direction).for_each(|(x, d)| *x += step * d);
            residual.iter_mut().zip(&image).for_each(|(r, i)| *r -= step * i);
            let nearer = self.filtered(transform, &residual, &nearly);
            let next = dot(&residual, &nearer);
            let ratio = next / square;
            direction.iter_mut().zip(&nearer).for_each(|(d, r)| *d = r + ratio * *d);
            square = next;
        }
        (square <= MOST * all).then(|| self.whitened(&solution))
    }

    /// Returns the factor by which a slow change of a sine's amplitude is multiplied at each sample. `power` is the
    /// rest's power at the sine's frequency.
    pub(super) fn factors(&self, power: f64) -> impl Iterator<Item = f64> {
        let white = self.white;
        self.deviation.iter().map(move |own| (power + own * white) / (power + own * own))
    }

    /// Returns the power of the rest in a coefficient.
    pub(super) fn power(&self, place: usize) -> f64 {
        self.rest.get(place).copied().unwrap_or_default()
    }
}

impl Series<'_> {
    /// Returns whether the law is about as high as the record where the record is white. Draws would separate a filter
    /// that is not known yet from the white noise, until no white noise is left.
    fn law_is_even(&self) -> bool {
        const BANDS: usize = 8;
        /// Range of the ratio of the record's power to the law's.
        const ABOUT: std::ops::Range<f64> = 0.6..1.6;
        /// Deviations of a band's mean up to this many standard errors are chance.
        const ERRORS: f64 = 3.0;
        let high = self.len() / 2;
        let places = self.coefficients[high..].iter().zip(&self.spectrum[high..]);
        let ratios: Vec<f64> = places.map(|(c, s)| c * c / s).collect();
        let size = ratios.len().div_ceil(BANDS).max(1);
        let mut means: Vec<f64> =
            ratios.chunks(size).map(|band| band.iter().sum::<f64>() / band.len() as f64).collect();
        // One of the bands may hold a line that is not known yet.
        means.sort_unstable_by(f64::total_cmp);
        // An uneven variance leaves this many of a band's coefficients independent.
        let variance = self.variances();
        let (sum, square) = variance.iter().fold((0.0, 0.0), |(sum, square), v| (sum + v, square + v * v));
        let count = size as f64 * sum * sum / (square * variance.len().max(1) as f64);
        let slack = if count > 0.0 { ERRORS * (2.0 / count).sqrt() } else { 0.0 };
        let about = ABOUT.start - slack..ABOUT.end + slack;
        means.iter().take(BANDS - 2).all(|mean| about.contains(mean))
    }

    /// Makes the white noise of the rest even if its variance is known to change and the law is even.
    pub(super) fn equalise(&mut self) {
        /// Variances that differ by at least this ratio are uneven.
        const UNEVEN: f64 = 2.0;
        let n = self.len();
        let before = self.equaliser.take();
        let variance = self.variances();
        let (least, most) = variance.iter().fold((f64::MAX, 0.0f64), |(l, m), v| (l.min(*v), m.max(*v)));
        let is_uneven = most > UNEVEN * least && least > 0.0 && most.is_finite();
        if !is_uneven || self.spectrum.len() != n || !self.censored.is_empty() || self.filters().is_some() {
            return;
        }
        if !self.law_is_even() {
            return;
        }
        let white = self.white();
        let mut deviation: Vec<f64> = variance.iter().map(|v| white * v.sqrt()).collect();
        for place in self.excluded() {
            deviation[place] = Equaliser::UNKNOWN * white * most.sqrt();
        }
        // A constant is not noise and is not divided.
        let weights = deviation.iter().map(|own| 1.0 / (own * own));
        let (sum, all) = self.rest.iter().zip(weights).fold((0.0, 0.0), |(sum, all), (x, w)| (sum + w * x, all + w));
        let mean = sum / all;
        self.mean += mean;
        self.rest.iter_mut().for_each(|value| *value -= mean);
        let mut rest: Vec<f64> = self.spectrum.iter().map(|s| (s - white * white).max(0.0)).collect();
        // The mean is unknown.
        rest[0] = rest[1];
        let mut equaliser = Equaliser { deviation, white, rest, solution: Vec::new() };
        let mut stream = stream(n, self.setting().owner, DRAWN);
        let mut slow: Vec<f64> = equaliser.rest.iter().map(|s| s.sqrt() * stream.normal()).collect();
        slow[0] = 0.0;
        self.transform.backward(&mut slow);
        let fast: Vec<f64> = (0..n).map(|_| stream.normal()).collect();
        let drawn = slow.iter().zip(&fast).zip(&equaliser.deviation).map(|((slow, fast), own)| slow + own * fast);
        let difference: Vec<f64> = self.rest.iter().zip(drawn).map(|(x, drawn)| x - drawn).collect();
        let near = before.as_ref().map(|before| before.solution.as_slice());
        let Some(solution) = equaliser.solve(&mut self.transform, &difference, near) else { return };
        let known = equaliser.even(&mut self.transform, &difference, &solution);
        self.rest =
            known.iter().zip(&slow).zip(&fast).map(|((known, slow), fast)| known + slow + white * fast).collect();
        equaliser.solution = solution;
        self.equaliser = Some(equaliser);
    }
}
