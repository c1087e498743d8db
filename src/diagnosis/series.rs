//! A series: one channel's samples, what explains them so far, and the residual that ought to be white.

use super::course::{Course, Courses};
use super::grid::{Grid, Narrow};
use super::law::{Base, Beliefs, Data, Fitted, Law, Shape};
use super::transform::Cosines;
use crate::effects::Stream;
use nalgebra::{DMatrix, DVector};
use std::borrow::Cow;

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

/// From this ratio of variances on a stretch says nothing about the noise: it is excluded.
const LOUD: f64 = 4.0;

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

/// Spikes of a series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpikeLaw {
    /// Chance that a sample is one.
    pub rate: f64,
    /// Typical size, in the series' scale.
    pub size: f64,
    /// Variance of a residual that is one.
    pub variance: f64,
    /// Standard error of the size, as a part of it.
    pub relative_error: f64,
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
    /// What the spikes among them are like.
    pub spikes: Option<SpikeLaw>,
    /// Stretches of another variance.
    pub loud: Vec<Loud>,
    /// Variance by temperature or time.
    pub scedasticity: Option<Scedasticity>,
    /// Degrees of freedom of Student's t.
    pub tails: Option<f64>,
    /// Where the samples are cut off, below and above.
    pub limits: [Option<f64>; 2],
}

impl Explanation {
    /// Noise alone.
    #[must_use]
    pub fn noise(law: Law) -> Self {
        Self {
            law,
            courses: Vec::new(),
            sines: Vec::new(),
            outliers: Vec::new(),
            spikes: None,
            loud: Vec::new(),
            scedasticity: None,
            tails: None,
            limits: [None, None],
        }
    }
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
    /// A series of samples with what is known to explain them.
    #[must_use]
    pub fn new(setting: &'a Setting<'a>, transform: Cosines, samples: Vec<f64>, start: Explanation) -> Self {
        let mut series = Self::unbuilt(setting, transform, samples, start);
        series.rebuild(true);
        series
    }

    fn unbuilt(setting: &'a Setting<'a>, transform: Cosines, samples: Vec<f64>, start: Explanation) -> Self {
        let grid = Grid::new(samples.len(), setting.rate_hz, &[]);
        let base = (setting.base)(&grid);
        let power = vec![1.0; grid.counts().len()];
        let fitted = Fitted {
            law: start.law.clone(),
            log_likelihood: f64::NEG_INFINITY,
            log_posterior: f64::NEG_INFINITY,
            covariance: None,
            logarithms: vec![0.0; grid.counts().len()],
        };
        Self {
            setting,
            transform,
            explanation: start,
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
        }
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
        self.resolve_lines();
        self.fit_means();
        self.refit(several);
        if !self.excluded().is_empty() {
            // What stands for excluded samples depends on the law, and the law a little on that.
            for _ in 0..2 {
                self.fit_means();
                self.interpolate();
                self.refit(false);
            }
        }
        self.refine_means();
    }

    /// Transforms the rest, fits the law to it and whitens it.
    fn refit(&mut self, several: bool) {
        self.transformed();
        let law = &self.explanation.law;
        let fitted = if several { law.fit_from_several(self.data()) } else { law.fit(self.data()) };
        self.explanation.law = fitted.law.clone();
        self.fitted = fitted;
        self.whiten();
    }

    fn transformed(&mut self) {
        let mut coefficients = self.rest.clone();
        self.transform.forward(&mut coefficients);
        self.power = self.grid.power(&coefficients);
        self.coefficients = coefficients;
    }

    /// The samples that are no noise, in order: outliers, and stretches that are much louder than the rest.
    fn excluded(&self) -> Vec<usize> {
        let mut places = self.explanation.outliers.clone();
        for loud in self.explanation.loud.iter().filter(|loud| loud.ratio > LOUD) {
            places.extend(loud.from..loud.to);
        }
        places.sort_unstable();
        places.dedup();
        places
    }

    /// Puts in place of excluded samples what noise of the present law would be there, given all others: a draw from the
    /// conditional distribution, so that they look like nothing in particular.
    ///
    /// With a record drawn from the law, the difference of both is continued into the excluded places by conjugate gradients
    /// on the law's precision matrix (Hoffman and Ribak 1991, Astrophys. J. 380). Limits are left to the simple way.
    fn interpolate(&mut self) {
        const ROUNDS: usize = 40;
        const ENOUGH: f64 = 1e-3;
        let places = self.excluded();
        if places.is_empty() || self.explanation.limits != [None, None] || places.len() * 3 > self.len() {
            return;
        }
        let n = self.len();
        let mut stream = Stream::new(n as u64, crate::effects::StreamId { owner: 0, effect: 3, instance: 0 });
        let mut drawn: Vec<f64> =
            self.spectrum.iter().map(|s| if s.is_finite() { s.sqrt() * stream.normal() } else { 0.0 }).collect();
        self.transform.backward(&mut drawn);
        // What is known of the difference, with a first guess in the excluded places: nothing.
        let mut difference: Vec<f64> = self.rest.iter().zip(&drawn).map(|(own, other)| own - other).collect();
        let guess = self.simple_guess(&difference, &places);
        for (place, value) in places.iter().zip(guess) {
            difference[*place] = value;
        }
        let mut precision = |values: &[f64]| -> Vec<f64> {
            let mut c = values.to_vec();
            self.transform.forward(&mut c);
            c.iter_mut().zip(&self.spectrum).for_each(|(c, s)| *c /= s);
            self.transform.backward(&mut c);
            places.iter().map(|place| c[*place]).collect()
        };
        let mut residual: Vec<f64> = precision(&difference).into_iter().map(|value| -value).collect();
        let mut direction = residual.clone();
        let mut square: f64 = residual.iter().map(|r| r * r).sum();
        let first = square;
        let mut spread = vec![0.0; n];
        for _ in 0..ROUNDS {
            if square <= ENOUGH * ENOUGH * first || square == 0.0 {
                break;
            }
            for (place, value) in places.iter().zip(&direction) {
                spread[*place] = *value;
            }
            let image = precision(&spread);
            let curvature: f64 = direction.iter().zip(&image).map(|(d, a)| d * a).sum();
            if curvature <= 0.0 {
                break;
            }
            let step = square / curvature;
            for (at, place) in places.iter().enumerate() {
                difference[*place] += step * direction[at];
                residual[at] -= step * image[at];
            }
            let next: f64 = residual.iter().map(|r| r * r).sum();
            let ratio = next / square;
            direction.iter_mut().zip(&residual).for_each(|(d, r)| *d = r + ratio * *d);
            square = next;
        }
        for place in &places {
            self.rest[*place] = difference[*place] + drawn[*place];
        }
        let mean = self.rest.iter().sum::<f64>() / n as f64;
        self.rest.iter_mut().for_each(|value| *value -= mean);
    }

    /// A course between the neighbours.
    fn simple_guess(&self, values: &[f64], places: &[usize]) -> Vec<f64> {
        let mut filled = values.to_vec();
        fill_in(&mut filled, places, 0.0);
        places.iter().map(|place| filled[*place]).collect()
    }

    /// A series under an explanation that is not fitted any more, but for the phases of its sines, which no one can know.
    #[must_use]
    pub fn frozen(setting: &'a Setting<'a>, transform: Cosines, samples: Vec<f64>, explanation: Explanation) -> Self {
        let mut series = Self::unbuilt(setting, transform, samples, explanation);
        series.resolve_lines();
        let amplitudes: Vec<f64> = series.explanation.sines.iter().map(Sine::amplitude).collect();
        for pass in 0..3 {
            series.fit_means();
            if series.spectrum.is_empty() {
                series.fitted.logarithms = series.explanation.law.logarithms(series.data());
                series.spectrum = series.grid.fill(&series.fitted.logarithms);
            }
            series.interpolate();
            series.transformed();
            series.whiten();
            if series.explanation.sines.is_empty() || pass == 2 {
                break;
            }
            series.refine_sines();
            for (sine, amplitude) in series.explanation.sines.iter_mut().zip(&amplitudes) {
                let found = sine.amplitude();
                if found > 0.0 && *amplitude > 0.0 {
                    sine.quadratures = sine.quadratures.map(|value| value * amplitude / found);
                }
            }
        }
        series
    }

    /// ln of density in nats, in as many blocks of time as are asked for; without what belongs to spikes and tails.
    #[must_use]
    pub fn density(&self, blocks: usize) -> Vec<f64> {
        let n = self.len();
        let constant: f64 = self.spectrum.iter().skip(1).map(|s| s.ln()).sum::<f64>() / n as f64;
        let size = n.div_ceil(blocks.max(1));
        let of = |block: usize| {
            let range = (block * size).min(n)..((block + 1) * size).min(n);
            range
                .map(|t| {
                    let variance = self.variance.get(t).map_or(0.0, |v| v.ln());
                    -0.5 * (self.residual[t].powi(2) + variance + constant)
                })
                .sum()
        };
        (0..blocks).map(of).collect()
    }

    fn refine_sines(&mut self) {
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
        self.refine_sines();
        self.fit_means();
        self.interpolate();
        self.refit(false);
    }

    /// A grid that resolves the narrow bands of the law.
    fn resolve_lines(&mut self) {
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
        beyond(&mut rest, &self.samples, &explanation.outliers, explanation.limits, white);
        for loud in explanation.loud.iter().filter(|loud| loud.ratio > LOUD) {
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

    /// By how much the white part's variance is on average above what it is where nothing changes it: the law's level of
    /// white noise is the average.
    #[must_use]
    pub fn average_variance(&self) -> f64 {
        let raw = self.raw_variances();
        if raw.is_empty() { 1.0 } else { raw.iter().sum::<f64>() / raw.len() as f64 }
    }

    /// The variance that the explanation gives each sample of the residual, 1 on average; empty if it is the same.
    fn variances(&self) -> Vec<f64> {
        normalised(self.raw_variances())
    }

    /// The same over that where nothing changes it.
    fn raw_variances(&self) -> Vec<f64> {
        let n = self.len();
        let Some(how) = &self.explanation.scedasticity else {
            let quiet: Vec<&Loud> = self.explanation.loud.iter().filter(|loud| loud.ratio <= LOUD).collect();
            if quiet.is_empty() {
                return Vec::new();
            }
            let mut variance = vec![1.0; n];
            for loud in quiet {
                variance[loud.from..loud.to].iter_mut().for_each(|value| *value *= loud.ratio);
            }
            return variance;
        };
        let logarithms: Vec<f64> = match how {
            Scedasticity::PerDegree(slope) => {
                self.setting.courses.temperature().unwrap_or_default().iter().map(|t| slope * t).collect()
            }
            Scedasticity::Profile(values) => (0..n).map(|t| profile(values, t, n)).collect(),
        };
        logarithms.iter().map(|l| l.exp()).collect()
    }

    /// The transform for records of this length.
    pub fn transform(&mut self) -> &mut Cosines {
        &mut self.transform
    }

    /// The residual as what does not mind its tails should see it: where the explanation has Student's t, normal scores, the
    /// values that a normal distribution has at the residual's ranks. Their order in time stays.
    #[must_use]
    pub fn scores(&self) -> Cow<'_, [f64]> {
        use statrs::distribution::{ContinuousCDF, Normal};
        if self.explanation.tails.is_none() {
            return Cow::Borrowed(&self.residual);
        }
        let normal = Normal::standard();
        let mut order: Vec<usize> = (0..self.residual.len()).collect();
        order.sort_unstable_by(|a, b| self.residual[*a].total_cmp(&self.residual[*b]));
        let mut scores = vec![0.0; self.residual.len()];
        for (rank, place) in order.into_iter().enumerate() {
            scores[place] = normal.inverse_cdf((rank as f64 + 0.5) / self.residual.len() as f64);
        }
        Cow::Owned(scores)
    }

    /// Covariance of factors of courses whose transforms are `columns`, at the present law; None where they cannot be told
    /// apart.
    #[must_use]
    pub fn covariance(&self, columns: &[Vec<f64>]) -> Option<DMatrix<f64>> {
        let product = |i: usize, j: usize| -> f64 {
            let places = columns[i].iter().zip(&columns[j]).zip(&self.spectrum).skip(1);
            places.map(|((a, b), s)| a * b / s).sum()
        };
        let mut normal = DMatrix::from_fn(columns.len(), columns.len(), product);
        for i in 0..columns.len() {
            normal[(i, i)] *= 1.0 + 1e-12;
        }
        normal.cholesky().map(|factor| factor.inverse())
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

/// Lets samples that are cut off lie beyond the limit, as noise about their neighbours' level would.
fn beyond(rest: &mut [f64], samples: &[f64], places: &[usize], limits: [Option<f64>; 2], white: f64) {
    use statrs::distribution::{ContinuousCDF, Normal};
    const NEAR: usize = 12;
    if limits == [None, None] {
        return;
    }
    let normal = Normal::standard();
    let n = rest.len();
    let mut stream = Stream::new(n as u64, crate::effects::StreamId { owner: 0, effect: 1, instance: 0 });
    for place in places {
        let at =
            |limit: Option<f64>| limit.filter(|limit| (samples[*place] - limit).abs() < 1e-9 * limit.abs().max(1.0));
        let (limit, sign) = match (at(limits[0]), at(limits[1])) {
            (Some(limit), _) => (limit, -1.0),
            (_, Some(limit)) => (limit, 1.0),
            _ => continue,
        };
        let near = place.saturating_sub(NEAR)..(place + NEAR + 1).min(n);
        let (sum, count) = near
            .filter(|t| places.binary_search(t).is_err())
            .fold((0.0, 0.0), |(sum, count), t| (sum + samples[t], count + 1.0));
        let level = if count > 0.0 { sum / count } else { limit };
        // The chance of being below the limit, and a place beyond it.
        let below = normal.cdf(sign * (limit - level) / white);
        let share = below + (1.0 - below) * stream.uniform();
        let z = normal.inverse_cdf(share.clamp(1e-12, 1.0 - 1e-12)).clamp(-6.0, 6.0);
        let value = level + sign * white * z;
        let value = if sign * (value - limit) < 0.0 { limit } else { value };
        // What was explained of the sample beside the noise stays so.
        rest[*place] = value + (rest_of(rest, *place, places, samples));
    }
}

/// By how much explained means moved the samples about a place.
fn rest_of(rest: &[f64], place: usize, places: &[usize], samples: &[f64]) -> f64 {
    let near = place.saturating_sub(2)..(place + 3).min(rest.len());
    let (sum, count) = near
        .filter(|t| places.binary_search(t).is_err())
        .fold((0.0, 0.0), |(sum, count), t| (sum + rest[t] - samples[t], count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
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
