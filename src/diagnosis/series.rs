//! A series: one channel's samples, what explains them so far, and the residual that ought to be white.

use super::course::{Course, Courses};
use super::grid::{Grid, Narrow};
use super::law::{Base, Beliefs, Data, Fitted, Law, Shape};
use super::transform::Cosines;
use crate::effects::Stream;
use nalgebra::{DMatrix, DVector};

/// A sine in a series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sine {
    /// Cycles per sample.
    pub cycles: f64,
    /// Factors of its cosine and its sine.
    pub quadratures: [f64; 2],
}

impl Sine {
    /// Peak.
    #[must_use]
    pub fn amplitude(&self) -> f64 {
        self.quadratures[0].hypot(self.quadratures[1])
    }
    fn add(&self, factor: f64, values: &mut [f64]) {
        let [a, b] = self.quadratures.map(|value| factor * value);
        turning(self.cycles, values.len(), |t, cosine, sine| values[t] += a * cosine + b * sine);
    }
}

/// Calls with cosine and sine of 2π·cycles·t for each t; a rotation that is set anew often enough to be exact.
pub(super) fn turning(cycles: f64, samples: usize, mut each: impl FnMut(usize, f64, f64)) {
    const RUN: usize = 256;
    let (step_sine, step_cosine) = (std::f64::consts::TAU * cycles).sin_cos();
    let mut t = 0;
    while t < samples {
        let (mut sine, mut cosine) = (std::f64::consts::TAU * (cycles * t as f64).fract()).sin_cos();
        for at in t..(t + RUN).min(samples) {
            each(at, cosine, sine);
            (cosine, sine) = (cosine * step_cosine - sine * step_sine, sine * step_cosine + cosine * step_sine);
        }
        t += RUN;
    }
}

/// A factor on the white part's standard deviation inside a range of samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loud {
    /// First sample.
    pub from: usize,
    /// One past the last.
    pub to: usize,
    /// On the variance.
    pub ratio: f64,
}

/// How the variance of the white part depends on something.
#[derive(Debug, Clone, PartialEq)]
pub enum Scedasticity {
    /// ln of the variance per °C about the mean temperature.
    PerDegree(f64),
    /// ln of the variance at equally spaced instants from the first sample to the last.
    Profile(Vec<f64>),
}

/// Everything that explains a series so far. What is transformed is built anew from the samples each time, so that nothing is
/// undone or done twice.
#[derive(Debug, Clone, PartialEq)]
pub struct Explanation {
    /// The spectrum.
    pub law: Law,
    /// Courses of the level and their factors.
    pub courses: Vec<(Course, f64)>,
    /// Sines.
    pub sines: Vec<Sine>,
    /// Samples that are no noise: spikes, held or clipped values.
    pub outliers: Vec<usize>,
    /// Stretches of another variance.
    pub loud: Vec<Loud>,
    /// Variance by temperature or time.
    pub scedasticity: Option<Scedasticity>,
    /// Degrees of freedom of Student's t.
    pub tails: Option<f64>,
}

/// What belongs to the whole record.
pub struct Setting<'a> {
    /// Courses.
    pub courses: &'a Courses,
    /// Spectra of N, B, K and the model's own effects, at any frequencies.
    pub base: &'a (dyn Fn(&Grid) -> Base + Sync),
    /// Beliefs about the levels.
    pub beliefs: Beliefs,
    /// Samples per second.
    pub rate_hz: f64,
    /// Variance of a rounding that the samples went through, in the series' scale.
    pub rounding: f64,
}

impl std::fmt::Debug for Setting<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Setting").field("rate_hz", &self.rate_hz).finish_non_exhaustive()
    }
}

/// One channel, in a scale in which its white part is about 1.
#[derive(Debug, Clone)]
pub struct Series<'a> {
    setting: &'a Setting<'a>,
    transform: Cosines,
    samples: Vec<f64>,
    /// What explains it.
    pub explanation: Explanation,
    /// Bins.
    pub grid: Grid,
    base: Base,
    /// The samples without what is explained.
    pub rest: Vec<f64>,
    /// Its transform.
    pub coefficients: Vec<f64>,
    /// Power in bins.
    pub power: Vec<f64>,
    /// The spectrum's fit.
    pub fitted: Fitted,
    /// The spectrum at each coefficient.
    pub spectrum: Vec<f64>,
    /// Coefficients over the root of the spectrum.
    pub whitened: Vec<f64>,
    /// Their inverse transform: about white noise of variance 1.
    pub residual: Vec<f64>,
    /// The variance that the explanation gives the residual at each sample; empty where it is 1.
    pub variance: Vec<f64>,
}

impl<'a> Series<'a> {
    /// A series of samples, explained by nothing but noise.
    #[must_use]
    pub fn new(setting: &'a Setting<'a>, transform: Cosines, samples: Vec<f64>, start: Law) -> Self {
        let grid = Grid::new(samples.len(), setting.rate_hz, &[]);
        let base = (setting.base)(&grid);
        let explanation = Explanation {
            law: start.clone(),
            courses: Vec::new(),
            sines: Vec::new(),
            outliers: Vec::new(),
            loud: Vec::new(),
            scedasticity: None,
            tails: None,
        };
        let power = vec![1.0; grid.counts().len()];
        let fitted = Fitted {
            law: start,
            log_likelihood: f64::NEG_INFINITY,
            log_posterior: f64::NEG_INFINITY,
            covariance: None,
            logarithms: vec![0.0; grid.counts().len()],
        };
        let mut series = Self {
            setting,
            transform,
            explanation,
            grid,
            base,
            rest: samples.clone(),
            samples,
            coefficients: Vec::new(),
            power,
            fitted,
            spectrum: Vec::new(),
            whitened: Vec::new(),
            residual: Vec::new(),
            variance: Vec::new(),
        };
        series.rebuild(true);
        series
    }

    /// The record's setting.
    #[must_use]
    pub fn setting(&self) -> &'a Setting<'a> {
        self.setting
    }

    /// How many samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// The samples as they came.
    #[must_use]
    pub fn samples(&self) -> &[f64] {
        &self.samples
    }

    /// What a law is fitted to, with the bins' power as it is.
    #[must_use]
    pub fn data(&self) -> Data<'_> {
        self.data_of(&self.power)
    }

    /// The same with another power in the bins.
    #[must_use]
    pub fn data_of<'b>(&'b self, power: &'b [f64]) -> Data<'b> {
        Data { grid: &self.grid, power, base: &self.base, beliefs: &self.setting.beliefs }
    }

    /// Standard deviation of the white part, per sample.
    #[must_use]
    pub fn white(&self) -> f64 {
        (0.5 * self.explanation.law.levels[0]).exp() * self.setting.rate_hz.sqrt()
    }

    /// Builds everything anew from samples and explanation; `several`: from several starts of the law.
    pub fn rebuild(&mut self, several: bool) {
        let lines: Vec<Narrow> = self
            .explanation
            .law
            .terms
            .iter()
            .filter(|term| term.shape == Shape::Resonance)
            .map(|term| Narrow { frequency_hz: term.numbers[1], width_hz: term.numbers[2].exp() })
            .collect();
        self.grid = Grid::new(self.len(), self.setting.rate_hz, &lines);
        self.base = (self.setting.base)(&self.grid);
        self.fit_means();
        let mut coefficients = self.rest.clone();
        self.transform.forward(&mut coefficients);
        self.power = self.grid.power(&coefficients);
        self.coefficients = coefficients;
        let law = &self.explanation.law;
        let fitted = if several { law.fit_from_several(self.data()) } else { law.fit(self.data()) };
        self.explanation.law = fitted.law.clone();
        self.fitted = fitted;
        self.whiten();
        self.refine_means();
    }

    /// Fits the factors of courses and sines once more, all together, at the law as it is now.
    fn refine_means(&mut self) {
        if self.explanation.courses.is_empty() && self.explanation.sines.is_empty() {
            return;
        }
        let courses: Vec<Course> = self.explanation.courses.iter().map(|(course, _)| *course).collect();
        if !courses.is_empty() {
            let drift = self.with_courses(&courses);
            for ((_, factor), more) in self.explanation.courses.iter_mut().zip(&drift.factors) {
                *factor += more;
            }
        }
        let n = self.len();
        for index in 0..self.explanation.sines.len() {
            let cycles = self.explanation.sines[index].cycles;
            let mut sums = [0.0; 2];
            turning(cycles, n, |t, cosine, sine| {
                sums[0] += self.residual[t] * cosine;
                sums[1] += self.residual[t] * sine;
            });
            let at = ((2.0 * n as f64 * cycles) as usize).clamp(1, n - 1);
            let scale = 2.0 / n as f64 * self.spectrum[at].sqrt();
            let own = &mut self.explanation.sines[index].quadratures;
            own[0] += scale * sums[0];
            own[1] += scale * sums[1];
        }
        self.fit_means();
        let mut coefficients = self.rest.clone();
        self.transform.forward(&mut coefficients);
        self.power = self.grid.power(&coefficients);
        self.coefficients = coefficients;
        self.fitted = self.explanation.law.fit(self.data());
        self.explanation.law = self.fitted.law.clone();
        self.whiten();
    }

    /// The rest without means, given the present law: samples with outliers filled in, less sines and courses.
    fn fit_means(&mut self) {
        let mut rest = self.samples.clone();
        let explanation = &self.explanation;
        for sine in &explanation.sines {
            sine.add(-1.0, &mut rest);
        }
        for (course, factor) in &explanation.courses {
            self.setting.courses.add(*course, -factor, &mut rest);
        }
        let white = self.white().clamp(1e-3, 1e3);
        fill_in(&mut rest, &explanation.outliers, white);
        for loud in explanation.loud.iter().filter(|loud| loud.ratio > 4.0) {
            let inside: Vec<usize> = (loud.from..loud.to).collect();
            fill_in(&mut rest, &inside, white);
        }
        let mean = rest.iter().sum::<f64>() / rest.len().max(1) as f64;
        rest.iter_mut().for_each(|value| *value -= mean);
        self.rest = rest;
    }

    fn whiten(&mut self) {
        self.spectrum = self.grid.fill(&self.fitted.logarithms);
        self.whitened = self.coefficients.iter().zip(&self.spectrum).map(|(c, s)| c / s.sqrt()).collect();
        let mut residual = self.whitened.clone();
        self.transform.backward(&mut residual);
        self.variance = self.variances();
        for (value, variance) in residual.iter_mut().zip(&self.variance) {
            *value /= variance.sqrt();
        }
        self.residual = residual;
    }

    /// The variance that the explanation gives each sample of the residual, 1 on average over ln; empty if it is the same.
    fn variances(&self) -> Vec<f64> {
        let n = self.len();
        let Some(how) = &self.explanation.scedasticity else {
            let quiet: Vec<&Loud> = self.explanation.loud.iter().filter(|loud| loud.ratio <= 4.0).collect();
            if quiet.is_empty() {
                return Vec::new();
            }
            let mut variance = vec![1.0; n];
            for loud in quiet {
                variance[loud.from..loud.to].fill(loud.ratio);
            }
            return normalised(variance);
        };
        let logarithms: Vec<f64> = match how {
            Scedasticity::PerDegree(slope) => {
                self.setting.courses.temperature().unwrap_or_default().iter().map(|t| slope * t).collect()
            }
            Scedasticity::Profile(values) => (0..n).map(|t| profile(values, t, n)).collect(),
        };
        normalised(logarithms.iter().map(|l| l.exp()).collect())
    }

    /// The transform for records of this length.
    pub fn transform(&mut self) -> &mut Cosines {
        &mut self.transform
    }

    /// The gain in nats, the factors, their covariance and the law where courses are added to the level.
    #[must_use]
    pub fn with_courses(&self, courses: &[Course]) -> Drift {
        const ROUNDS: usize = 4;
        let columns: Vec<Vec<f64>> = courses.iter().map(|course| self.setting.courses.coefficients(*course)).collect();
        let kept = columns.first().map_or(0, Vec::len).min(self.len());
        let count = columns.len();
        let mut spectrum: Vec<f64> = self.spectrum[..kept].to_vec();
        let mut law = self.explanation.law.clone();
        let mut best =
            Drift { gain: 0.0, factors: vec![0.0; count], covariance: DMatrix::zeros(count, count), law: law.clone() };
        for round in 0..ROUNDS {
            let mut normal = DMatrix::zeros(count, count);
            let mut right = DVector::zeros(count);
            for i in 0..count {
                for k in 1..kept {
                    let weighted = columns[i][k] / spectrum[k];
                    right[i] += weighted * self.coefficients[k];
                    for j in 0..=i {
                        normal[(i, j)] += weighted * columns[j][k];
                    }
                }
            }
            for i in 0..count {
                for j in 0..i {
                    normal[(j, i)] = normal[(i, j)];
                }
                normal[(i, i)] *= 1.0 + 1e-9;
            }
            let Some(factor) = normal.cholesky() else { break };
            let factors = factor.solve(&right);
            let mut rest: Vec<f64> = self.coefficients[..kept].to_vec();
            for (column, factor) in columns.iter().zip(factors.iter()) {
                rest.iter_mut().zip(column).for_each(|(c, x)| *c -= factor * x);
            }
            let mut power = self.power.clone();
            for (bin, span) in self.grid.edges().windows(2).enumerate() {
                if span[1] <= kept {
                    power[bin] = rest[span[0]..span[1]].iter().map(|c| c * c).sum::<f64>() / (span[1] - span[0]) as f64;
                }
            }
            let fitted = law.fit(self.data_of(&power));
            let gain = fitted.log_posterior - self.fitted.log_posterior;
            law = fitted.law.clone();
            let settled = (gain - best.gain).abs() < 0.02;
            if gain > best.gain || round == 0 {
                best = Drift {
                    gain,
                    factors: factors.iter().copied().collect(),
                    covariance: factor.inverse(),
                    law: fitted.law,
                };
            }
            if settled && round > 0 {
                break;
            }
            spectrum = self.grid.fill(&fitted.logarithms)[..kept].to_vec();
        }
        best
    }
}

/// What adding courses would give.
#[derive(Debug, Clone)]
pub struct Drift {
    /// Nats.
    pub gain: f64,
    /// Of each course.
    pub factors: Vec<f64>,
    /// Theirs.
    pub covariance: DMatrix<f64>,
    /// The law beside them.
    pub law: Law,
}

/// A profile's value at sample t of n, straight between its instants.
pub(super) fn profile(values: &[f64], t: usize, n: usize) -> f64 {
    let Some(last) = values.len().checked_sub(1).filter(|last| *last > 0) else {
        return values.first().copied().unwrap_or_default();
    };
    let place = t as f64 / (n.max(2) - 1) as f64 * last as f64;
    let (at, share) = ((place as usize).min(last - 1), place.fract());
    let share = if place >= last as f64 { 1.0 } else { share };
    values[at] + share * (values[at + 1] - values[at])
}

fn normalised(mut variance: Vec<f64>) -> Vec<f64> {
    let mean = variance.iter().sum::<f64>() / variance.len().max(1) as f64;
    variance.iter_mut().for_each(|value| *value /= mean);
    variance
}

/// Replaces samples (in order) by the course between their neighbours and white noise: a gap that is filled without noise
/// looks like a filter.
pub(super) fn fill_in(values: &mut [f64], places: &[usize], white: f64) {
    const NEAR: usize = 8;
    let n = values.len();
    let mut at = 0;
    let mut stream = Stream::new(n as u64, crate::effects::StreamId { owner: 0, effect: 0, instance: 0 });
    while at < places.len() {
        let mut end = at + 1;
        // A run, with what good samples lie within it too few to tell a level.
        while end < places.len() && places[end] <= places[end - 1] + 1 {
            end += 1;
        }
        let (from, to) = (places[at], places[end - 1] + 1);
        let level = |range: std::ops::Range<usize>| {
            let inside = range.clone().filter(|t| places.binary_search(t).is_err());
            let (sum, count) = inside.fold((0.0, 0), |(sum, count), t| (sum + values[t], count + 1));
            (count > 0).then(|| sum / f64::from(count))
        };
        let before = level(from.saturating_sub(NEAR)..from);
        let after = level(to..(to + NEAR).min(n));
        let (before, after) = (before.or(after).unwrap_or(0.0), after.or(before).unwrap_or(0.0));
        for t in from..to {
            let share = (t - from + 1) as f64 / (to - from + 1) as f64;
            values[t] = before + share * (after - before) + white * stream.normal();
        }
        at = end;
    }
}
