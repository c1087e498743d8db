//! Refinement: fits the factors of courses and sines again, all together, at the present law.

use super::course::Course;
use super::explanation::{Sine, per_product, turning};
use super::gated;
use super::series::Series;

impl Series<'_> {
    /// Returns whether a sine has so few periods in the record that whitening distorts it, because its ends count.
    pub(super) fn is_slow(&self, cycles: f64) -> bool {
        const PERIODS: f64 = 64.0;
        cycles * (self.len() as f64) < PERIODS
    }

    /// Returns twice the gain in nats of a slow sine at the present law, and the factors of its cosine and sine.
    pub(super) fn turn(&self, cycles: f64) -> (f64, [f64; 2]) {
        self.turn_of(&self.setting().courses.turning(cycles))
    }

    /// Computes [`Self::turn`] from the transforms of the products of the sine's cosine and sine with the rest.
    fn turn_of(&self, columns: &[Vec<f64>; 2]) -> (f64, [f64; 2]) {
        let product = |a: &[f64], b: &[f64]| -> f64 {
            a.iter().zip(b).zip(&self.spectrum).skip(1).map(|((a, b), s)| a * b / s).sum()
        };
        let [cosine, sine] = columns;
        let (aa, ab, bb) = (product(cosine, cosine), product(cosine, sine), product(sine, sine));
        let (a, b) = (product(cosine, &self.coefficients), product(sine, &self.coefficients));
        let determinant = aa * bb - ab * ab;
        if determinant.is_nan() || determinant <= 1e-9 * aa * bb {
            return (0.0, [0.0; 2]);
        }
        let factors = [(bb * a - ab * b) / determinant, (aa * b - ab * a) / determinant];
        (a * factors[0] + b * factors[1], factors)
    }

    pub(super) fn refine_sines(&mut self) {
        let n = self.len();
        for index in 0..self.explanation.sines.len() {
            let cycles = self.explanation.sines[index].cycles;
            if self.is_slow(cycles) {
                let quadrature = |quadratures| {
                    let mut values = vec![0.0; n];
                    Sine { cycles, quadratures }.add(1.0, &mut values);
                    values
                };
                let columns = self.equalised(|| [[1.0, 0.0], [0.0, 1.0]].map(quadrature));
                let (_, [cosine, sine]) = columns.map_or_else(|| self.turn(cycles), |columns| self.turn_of(&columns));
                let own = &mut self.explanation.sines[index].quadratures;
                (own[0], own[1]) = (own[0] + cosine, own[1] + sine);
                continue;
            }
            let mut sums = [0.0; 2];
            let at = ((2.0 * n as f64 * cycles) as usize).clamp(1, n - 1);
            let factors: Option<Vec<f64>> = self.equaliser.as_ref().map(|equaliser| equaliser.factors(at).collect());
            let factor = |t: usize| factors.as_ref().map_or(1.0, |factors| factors[t]);
            turning(cycles, n, |t, cosine, sine| {
                let there = factor(t) * self.residual[t];
                sums[0] += there * cosine;
                sums[1] += there * sine;
            });
            let square = factors.as_ref().map_or(1.0, |factors| factors.iter().map(|f| f * f).sum::<f64>() / n as f64);
            let scale = per_product(cycles, n) * self.spectrum[at].sqrt() / square;
            let own = &mut self.explanation.sines[index].quadratures;
            own[0] += scale * sums[0];
            own[1] += scale * sums[1];
        }
    }

    /// Fits the factors of courses and sines again, all together, at the present law, and whitens the rest.
    pub(super) fn refine_means(&mut self) {
        let own = &self.explanation;
        if own.courses.is_empty() && own.sines.is_empty() && own.gated.is_empty() {
            return self.whiten();
        }
        /// Maximum remaining movement of a step, in standard deviations of white noise: its size and the filled-in
        /// samples about it depend on each other.
        const SETTLED: f64 = 0.2;
        const ROUNDS: usize = 8;
        let has_steps = self.explanation.courses.iter().any(|(course, _)| matches!(course, Course::Step(_)));
        let rounds = if has_steps && !self.excluded().is_empty() { ROUNDS } else { 1 };
        let mut before = f64::INFINITY;
        for _ in 0..rounds {
            let moved = self.refine_courses();
            // Fast sines are read off the residual.
            if self.explanation.sines.iter().any(|sine| !self.is_slow(sine.cycles)) {
                self.whiten();
            }
            self.refine_sines();
            gated::refine(self);
            self.fit_means();
            self.interpolate();
            self.refit(false);
            // A step whose movement increases is left as it is.
            if moved < SETTLED * self.white() || moved > before {
                break;
            }
            before = moved;
        }
        self.whiten();
    }

    /// Fits the factors of courses again. Returns the largest movement of a step of the level.
    fn refine_courses(&mut self) -> f64 {
        let courses: Vec<Course> = self.explanation.courses.iter().map(|(course, _)| *course).collect();
        let mut moved = 0.0f64;
        if !courses.is_empty() {
            let (setting, samples) = (self.setting(), self.samples.len());
            let values = |course: &Course| {
                let mut values = vec![0.0; samples];
                setting.courses.add(*course, 1.0, &mut values);
                values
            };
            let columns = self.equalised(|| courses.iter().map(values).collect::<Vec<_>>());
            let drift = columns.map_or_else(|| self.with_courses(&courses), |columns| self.with_columns(&columns));
            for ((course, factor), more) in self.explanation.courses.iter_mut().zip(&drift.factors) {
                *factor += more;
                if matches!(course, Course::Step(_)) {
                    moved = moved.max(more.abs());
                }
            }
        }
        moved
    }

    /// Returns the transforms of the equalised functions of the record; `None` if there is no equaliser, or if it
    /// fails.
    fn equalised<T: AsMut<[Vec<f64>]>>(&mut self, functions: impl FnOnce() -> T) -> Option<T> {
        let equaliser = self.equaliser.take()?;
        let mut functions = functions();
        let mut done = true;
        for values in functions.as_mut() {
            let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
            values.iter_mut().for_each(|value| *value -= mean);
            // One that fails makes the others, each of hundreds of transforms, useless.
            let Some(even) = equaliser.apply(&mut self.transform, values) else {
                done = false;
                break;
            };
            *values = even;
            self.transform.forward(values);
        }
        self.equaliser = Some(equaliser);
        done.then_some(functions)
    }
}
