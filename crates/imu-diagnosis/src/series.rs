//! A series: one channel's samples, their explanation so far, and the residual, which should be white. [`super::explained`]
//! builds it and fits its law, [`super::censored`] and [`super::variances`] make what it keeps of limits and variances.

use super::course::{Course, Courses};
use super::equaliser::Equaliser;
use super::explanation::{Explanation, LOUD, Loud, Scedasticity};
use super::gated::OfModel;
use super::grid::{Grid, Narrow};
use super::law::{Base, Data, Fitted, Law, Priors, Term};
use super::transform::Cosines;
use nalgebra::{DMatrix, DVector};
use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::rc::Rc;

/// Returns spectra on a grid, without the model's effects at these places of its list.
pub type BaseOf<'a> = &'a (dyn Fn(&Grid, &BTreeSet<usize>) -> Base + Sync);

/// The data of the whole record.
#[derive(Clone, Copy)]
pub struct Setting<'a> {
    /// The courses.
    pub courses: &'a Courses,
    /// Spectra at any frequencies of N, B, K and the model's own effects except those left out.
    pub base: BaseOf<'a>,
    /// The model's own effects of the spectrum: places in its list, and their terms.
    pub declared: &'a [(usize, Term)],
    /// Bands with the spectra of the model's wandering lines.
    pub wandering: &'a [Term],
    /// ln of the power of the model's white noise.
    pub white: f64,
    /// Priors of the levels with which a search begins.
    pub priors: Priors,
    /// Samples per second.
    pub rate_hz: f64,
    /// The intervals of the model's bursts.
    pub bursts: &'a [std::ops::Range<usize>],
    /// Number of the model's courses, which are the first in an explanation.
    pub shifts: usize,
    /// Samples that the model's own filters reach.
    pub reach: usize,
    /// Number of the channel whose random draws replace excluded samples.
    pub owner: u32,
    /// The model's lines and bands that come and go.
    pub gated: &'a [OfModel],
    /// Whether the search distinguishes sines that come and go from those that are always present.
    pub gates: bool,
}

/// A sample at a limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Censored {
    /// The index of the sample.
    pub(super) place: usize,
    /// The limit, less the explained part of the sample that is not noise.
    pub(super) bound: f64,
    /// 1 for an upper limit, −1 for a lower one.
    pub(super) sign: f64,
}

/// The variances that parts of an explanation give, cached while those parts stay. They also depend on the number of
/// samples and on the temperature, which stay as long as the series.
#[derive(Debug, Clone)]
pub(super) struct Varied {
    pub(super) scedasticity: Option<Scedasticity>,
    pub(super) quiet: Vec<Loud>,
    pub(super) values: Rc<[f64]>,
}

/// One channel, in a scale in which its white part is about 1.
#[derive(Clone)]
pub struct Series<'a> {
    pub(super) setting: &'a Setting<'a>,
    pub(super) transform: Cosines,
    pub(super) samples: Vec<f64>,
    /// The explanation of the samples.
    pub explanation: Explanation,
    /// The bins.
    pub grid: Grid,
    pub(super) base: Base,
    /// Priors of the levels: the setting's, unless the record contradicts them.
    pub(super) priors: Priors,
    /// The samples less the explained part.
    pub rest: Vec<f64>,
    /// The mean that was subtracted from the samples.
    pub(super) mean: f64,
    /// The samples at a limit.
    pub(super) censored: Vec<Censored>,
    /// The transform of the rest.
    pub coefficients: Vec<f64>,
    /// Power in the bins.
    pub power: Vec<f64>,
    /// The number of independent coefficients in each bin.
    pub(super) worth: Vec<f64>,
    /// The spectrum's fit.
    pub fitted: Fitted,
    /// The spectrum at each coefficient.
    pub spectrum: Vec<f64>,
    /// Coefficients over the root of the spectrum.
    pub whitened: Vec<f64>,
    /// The inverse transform of [`Self::whitened`]: about white noise of variance 1.
    pub residual: Vec<f64>,
    /// The residual with the filters' phase undone; empty if there are no filters.
    pub(super) unfiltered: Vec<f64>,
    /// The variance that the explanation gives the residual at each sample; empty if it is 1.
    pub variance: Vec<f64>,
    /// The last result of [`Series::raw_variances`].
    pub(super) varied: RefCell<Option<Varied>>,
    /// The equaliser of the white noise, if there is one.
    pub(super) equaliser: Option<Equaliser>,
    /// Whether the solver of the equaliser failed in the present rebuild. It would fail again, in as many rounds.
    pub(super) is_unsolved: bool,
}

impl<'a> Series<'a> {
    /// Returns the record's setting.
    pub fn setting(&self) -> &'a Setting<'a> {
        self.setting
    }

    /// Returns the number of samples.
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// Returns the data that a law is fitted to, with the bins' actual power.
    pub fn data(&self) -> Data<'_> {
        self.data_of(&self.power)
    }

    /// Returns the data with another power in the bins.
    pub fn data_of<'b>(&'b self, power: &'b [f64]) -> Data<'b> {
        Data { grid: &self.grid, power, worth: &self.worth, base: &self.base, priors: &self.priors }
    }

    /// Returns the standard deviation of the white part, per sample.
    pub fn white(&self) -> f64 {
        (0.5 * self.explanation.law.levels[0]).exp() * self.setting.rate_hz.sqrt()
    }

    /// Returns ln of the density in nats, in `blocks` blocks of time, without the parts of spikes and tails.
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

    /// Returns a grid that resolves these narrow bands and those of the law and of the model.
    pub(super) fn resolving(&self, more: &[Narrow]) -> Grid {
        let rate_hz = self.setting.rate_hz;
        let declared = self.setting.declared.iter().map(|(_, term)| term).chain(self.setting.wandering);
        let own = self.explanation.law.terms.iter().chain(declared).flat_map(|term| term.narrow(rate_hz));
        let lines: Vec<Narrow> = own.chain(more.iter().copied()).collect();
        Grid::new(self.len(), rate_hz, &lines)
    }

    /// Returns ln of the spectrum of a law in each bin if the model's effect at this place, which is left out, acted as
    /// well.
    pub(super) fn logarithms_with_declared(&self, place: usize, law: &Law) -> Vec<f64> {
        let mut without = self.explanation.without.clone();
        without.remove(&place);
        let base = (self.setting.base)(&self.grid, &without);
        law.logarithms(Data { base: &base, ..self.data() })
    }

    /// Returns ln of the spectrum in each bin without the model's effect at this place.
    pub(super) fn logarithms_without_declared(&self, place: usize) -> Vec<f64> {
        let mut without = self.explanation.without.clone();
        without.insert(place);
        let base = (self.setting.base)(&self.grid, &without);
        self.explanation.law.logarithms(Data { base: &base, ..self.data() })
    }

    /// Subtracts the mean from the rest and from its limits.
    pub(super) fn centre(&mut self) {
        let mean = self.rest.iter().sum::<f64>() / self.len().max(1) as f64;
        self.mean += mean;
        self.rest.iter_mut().for_each(|value| *value -= mean);
        self.censored.iter_mut().for_each(|of| of.bound -= mean);
    }

    /// Returns the residual before the filters: each value is the input at its time.
    pub fn innovations(&self) -> &[f64] {
        if self.is_filtered() { &self.unfiltered } else { &self.residual }
    }

    /// Returns whether the model or the explanation has filters.
    pub(super) fn is_filtered(&self) -> bool {
        !self.unfiltered.is_empty()
    }

    /// Returns the number of samples that the filters of the model and the found ones reach.
    pub fn reach(&self) -> usize {
        let found = self.explanation.law.terms.iter().map(|term| term.reach(self.setting.rate_hz));
        // For a slower filter, too few samples are left to determine it.
        found.max().unwrap_or(0).max(self.setting.reach).min(self.len() / 32)
    }

    /// Returns the samples in stretches that are so loud that they are left out.
    pub(super) fn loud_samples(&self) -> usize {
        let loud = self.explanation.loud.iter().filter(|loud| loud.ratio > LOUD);
        loud.map(|loud| self.spoilt(loud).len()).sum()
    }

    /// Returns the samples that a stretch spoils; behind filters it lasts longer.
    pub(super) fn spoilt(&self, loud: &Loud) -> std::ops::Range<usize> {
        loud.from..(loud.to + self.reach()).min(self.len())
    }

    /// Returns the power gain of the model's and the found filters at each coefficient; `None` if there are none.
    pub fn filters(&self) -> Option<Vec<f64>> {
        let found = self.explanation.law.terms.iter().filter(|term| term.is_filter());
        let mut gain: Vec<f64> = self.base.gain.iter().zip(&self.base.passed).map(|(one, other)| one * other).collect();
        for filter in found {
            let own = filter.gains(self.grid.frequencies());
            gain.iter_mut().zip(own).for_each(|(all, one)| *all *= one);
        }
        if gain.iter().all(|gain| *gain == 1.0) {
            return None;
        }
        let logarithms: Vec<f64> = gain.into_iter().map(|gain| gain.max(f64::MIN_POSITIVE).ln()).collect();
        Some(self.grid.fill(&logarithms))
    }

    /// Returns the residual for methods that must not depend on its tails. If the explanation has Student's t, these
    /// are normal scores: the values that a normal distribution has at the residual's ranks, in their order in time.
    pub fn scores(&self) -> Cow<'_, [f64]> {
        match self.explanation.tails {
            None => Cow::Borrowed(self.innovations()),
            Some(_) => Cow::Owned(normal_scores(self.innovations())),
        }
    }

    /// Returns the covariance of the factors of courses whose transforms are `columns`, at the present law. `None` if
    /// the factors cannot be separated.
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

    /// Returns the gain in nats of courses of the level under the present law.
    pub(super) fn gain_of(&self, courses: &[Course]) -> f64 {
        let columns: Vec<Vec<f64>> = courses.iter().map(|course| self.setting.courses.coefficients(*course)).collect();
        let Some(covariance) = self.covariance(&columns) else { return 0.0 };
        let products = columns.iter().map(|column| {
            let places = column.iter().zip(&self.coefficients).zip(&self.spectrum).skip(1);
            places.map(|((x, c), s)| x * c / s).sum()
        });
        let right = DVector::from_iterator(columns.len(), products);
        0.5 * right.dot(&(covariance * &right))
    }

    /// Returns the gain in nats, the factors, their covariance and the law after adding courses to the level.
    pub fn with_courses(&self, courses: &[Course]) -> Drift {
        let columns: Vec<Vec<f64>> = courses.iter().map(|course| self.setting.courses.coefficients(*course)).collect();
        self.with_columns(&columns)
    }

    /// Returns the result of [`Self::with_courses`] for courses whose first coefficients are given.
    pub fn with_columns(&self, columns: &[Vec<f64>]) -> Drift {
        const ROUNDS: usize = 4;
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
            for (bin, span) in self.grid.edges.windows(2).enumerate() {
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
            spectrum = self.grid.fill_first(&fitted.logarithms, kept);
        }
        best
    }
}

/// Returns the values that a normal distribution has at the ranks of values, in their order.
pub(super) fn normal_scores(values: &[f64]) -> Vec<f64> {
    use statrs::distribution::{ContinuousCDF, Normal};
    let normal = Normal::standard();
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_unstable_by(|a, b| values[*a].total_cmp(&values[*b]));
    let mut scores = vec![0.0; values.len()];
    for (rank, place) in order.into_iter().enumerate() {
        scores[place] = normal.inverse_cdf((rank as f64 + 0.5) / values.len() as f64);
    }
    scores
}

/// The result of adding courses.
#[derive(Debug, Clone)]
pub struct Drift {
    /// Nats gained.
    pub gain: f64,
    /// Factor of each course.
    pub factors: Vec<f64>,
    /// Covariance of the factors.
    pub covariance: DMatrix<f64>,
    /// The law beside the courses.
    pub law: Law,
}
