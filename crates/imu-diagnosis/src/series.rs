//! A series: one channel's samples, their explanation so far, and the residual, which should be white.

use super::censored::{self, Censored};
use super::course::{Course, Courses};
use super::equaliser::Equaliser;
use super::explanation::{Explanation, LOUD, Loud, Sine};
use super::filling::fill_in;
use super::gated;
use super::grid::{Grid, Narrow};
use super::law::{Base, Data, Fitted, Law, Priors, Term};
use super::phase;
use super::transform::Cosines;
use super::variances::Varied;
use nalgebra::{DMatrix, DVector};
use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::BTreeSet;

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
    pub gated: &'a [gated::OfModel],
    /// Whether the search distinguishes sines that come and go from those that are always present.
    pub gates: bool,
}

/// One channel, in a scale in which its white part is about 1.
#[derive(Clone)]
pub struct Series<'a> {
    setting: &'a Setting<'a>,
    pub(super) transform: Cosines,
    pub(super) samples: Vec<f64>,
    /// The explanation of the samples.
    pub explanation: Explanation,
    /// The bins.
    pub grid: Grid,
    base: Base,
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
    worth: Vec<f64>,
    /// The spectrum's fit.
    pub fitted: Fitted,
    /// The spectrum at each coefficient.
    pub spectrum: Vec<f64>,
    /// Coefficients over the root of the spectrum.
    pub whitened: Vec<f64>,
    /// The inverse transform of [`Self::whitened`]: about white noise of variance 1.
    pub residual: Vec<f64>,
    /// The residual with the filters' phase undone; empty if there are no filters.
    unfiltered: Vec<f64>,
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
    /// Creates a series of samples with their known explanation.
    pub fn new(setting: &'a Setting<'a>, transform: Cosines, samples: Vec<f64>, start: Explanation) -> Self {
        let mut series = Self::unbuilt(setting, transform, samples, start);
        series.rebuild(true);
        series
    }

    fn unbuilt(setting: &'a Setting<'a>, transform: Cosines, samples: Vec<f64>, start: Explanation) -> Self {
        let grid = Grid::new(samples.len(), setting.rate_hz, &[]);
        let base = (setting.base)(&grid, &start.without);
        let power = vec![1.0; grid.counts.len()];
        let fitted = Fitted {
            law: start.law.clone(),
            log_likelihood: f64::NEG_INFINITY,
            log_posterior: f64::NEG_INFINITY,
            covariance: None,
            logarithms: vec![0.0; grid.counts.len()],
        };
        Self {
            setting,
            transform,
            explanation: start,
            grid,
            base,
            priors: setting.priors,
            rest: samples.clone(),
            mean: 0.0,
            censored: Vec::new(),
            samples,
            coefficients: Vec::new(),
            worth: power.clone(),
            power,
            fitted,
            spectrum: Vec::new(),
            whitened: Vec::new(),
            residual: Vec::new(),
            unfiltered: Vec::new(),
            variance: Vec::new(),
            varied: RefCell::new(None),
            equaliser: None,
            is_unsolved: false,
        }
    }

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

    /// Builds the state again from samples and explanation. If `several`, the law is fitted from several starts.
    pub fn rebuild(&mut self, several: bool) {
        /// Filled-in samples count in the law if at least one sample in this many is filled in.
        const MANY: usize = 50;
        /// Maximum remaining change of ln N².
        const AGREE: f64 = 1e-3;
        self.is_unsolved = false;
        self.resolve_lines();
        self.fit_means();
        self.refit(several);
        // The values that depend on the law were computed with the previous law.
        if self.depends_on_law() {
            self.fit_means();
            self.refit(false);
        }
        if !self.excluded().is_empty() {
            // The replacement of excluded samples depends on the law, and the law on the replacement. The dependence is weak for
            // a few samples. Behind a filter, whose spectrum may be almost 0 somewhere, it is strong. For a good part of the
            // record, the loop runs until both agree.
            let filtered = self.explanation.law.terms.iter().any(Term::is_filter);
            let least = if filtered { 5 } else { 2 };
            let most = if self.loud_samples() * MANY > self.len() { 12 } else { least };
            for round in 1..=most {
                let before = self.explanation.law.levels[0];
                self.fit_means();
                self.interpolate();
                self.refit(false);
                if round >= least && (self.explanation.law.levels[0] - before).abs() < AGREE {
                    break;
                }
            }
        }
        self.refine_means();
        self.measure_loud();
    }

    /// Builds the state again with another explanation.
    pub(super) fn adopt(&mut self, explanation: Explanation) {
        self.explanation = explanation;
        self.rebuild(false);
    }

    /// Returns the series with a changed explanation.
    pub(super) fn changed<T>(&self, change: impl FnOnce(&mut Explanation) -> T) -> Self {
        let mut other = self.clone();
        change(&mut other.explanation);
        other.rebuild(false);
        other
    }

    /// Whitens the samples less the explanation by the present law.
    pub(super) fn rewhiten(&mut self) {
        self.fit_means();
        self.interpolate();
        self.transformed();
        self.spectrum = self.grid.fill(&self.fitted.logarithms);
        self.whiten();
    }

    /// Measures again the loudness of excluded stretches relative to the noise without them.
    fn measure_loud(&mut self) {
        for (at, ratio) in self.loudness() {
            self.explanation.loud[at].ratio = ratio.max(1.01 * LOUD);
        }
    }

    /// Returns the mean square of the residual in each excluded stretch, by its place in the list.
    pub(super) fn loudness(&mut self) -> Vec<(usize, f64)> {
        if self.explanation.loud.iter().all(|loud| loud.ratio <= LOUD) {
            return Vec::new();
        }
        let mut there = self.rest.clone();
        let outliers = self.explanation.outliers.clone();
        let kept = (self.rest.clone(), self.censored.clone(), self.mean);
        self.fit_means_but(false);
        let own = std::mem::replace(&mut self.rest, kept.0);
        (self.censored, self.mean) = (kept.1, kept.2);
        for loud in self.explanation.loud.iter().filter(|loud| loud.ratio > LOUD) {
            for t in self.spoilt(loud) {
                if outliers.binary_search(&t).is_err() {
                    there[t] = own[t];
                }
            }
        }
        self.transform.forward(&mut there);
        there.iter_mut().zip(&self.spectrum).for_each(|(c, s)| *c /= s.sqrt());
        self.transform.backward(&mut there);
        let square = |loud: &Loud| {
            let inside = &there[loud.from..loud.to];
            inside.iter().map(|e| e * e).sum::<f64>() / inside.len() as f64
        };
        let loud = self.explanation.loud.iter().enumerate().filter(|(_, loud)| loud.ratio > LOUD);
        loud.map(|(at, loud)| (at, square(loud))).collect()
    }

    /// Transforms the rest and fits the law to it. The whitened values stay those of the previous law.
    pub(super) fn refit(&mut self, several: bool) {
        self.transformed();
        self.worth = self.worth_on(&self.grid, &self.base);
        let law = &self.explanation.law;
        let fitted = if several { law.fit_from_several(self.data()) } else { law.fit(self.data()) };
        self.explanation.law = fitted.law.clone();
        self.fitted = fitted;
        self.spectrum = self.grid.fill(&self.fitted.logarithms);
    }

    /// Returns the number of independent coefficients in the bins of a grid.
    ///
    /// The mean square of n coefficients of white noise whose variance v changes over a record has the scatter of n·⟨v⟩²/⟨v²⟩
    /// coefficients of even noise (the moments of its sum of squares). The replacement of loud stretches has no weight.
    pub(super) fn worth_on(&self, grid: &Grid, base: &Base) -> Vec<f64> {
        /// Bins count for at least half; otherwise, existing bands would be taken for white noise of another level.
        const MOST: f64 = 1.0;
        let variance = self.variances();
        let there = 1.0 - (self.loud_samples() as f64 / self.len().max(1) as f64).min(0.9);
        if variance.is_empty() || self.equaliser.is_some() {
            return grid.counts.iter().map(|count| there * count).collect();
        }
        let square = variance.iter().map(|v| v * v).sum::<f64>() / variance.len() as f64;
        let data = Data { grid, power: &[], worth: &[], base, priors: &self.priors };
        let white = self.white().powi(2);
        let logarithms = self.explanation.law.logarithms(data);
        let places = logarithms.iter().zip(base.gain.iter().zip(&grid.counts));
        places
            .map(|(s, (gain, count))| {
                let share = (white * gain / s.exp()).min(1.0);
                there * count / (1.0 + (share * share * (square - 1.0)).min(MOST))
            })
            .collect()
    }

    fn transformed(&mut self) {
        let mut coefficients = self.rest.clone();
        self.transform.forward(&mut coefficients);
        self.power = self.grid.power(&coefficients);
        self.coefficients = coefficients;
        let mut law = self.explanation.law.clone();
        law.find_quiet(self.data());
        self.explanation.law = law;
    }

    /// Returns a series under an explanation that is no longer fitted, except for the phases of its sines, which cannot
    /// be known in advance. Its level of white noise is the level at times when nothing changes the variance.
    pub fn frozen(setting: &'a Setting<'a>, transform: Cosines, samples: Vec<f64>, explanation: Explanation) -> Self {
        let mut series = Self::unbuilt(setting, transform, samples, explanation);
        series.explanation.law.levels[0] += series.average_variance().ln();
        series.resolve_lines();
        let amplitudes: Vec<f64> = series.explanation.sines.iter().map(Sine::amplitude).collect();
        for pass in 0..3 {
            series.apply();
            // The values that depend on the law need one more iteration.
            let is_alone = series.explanation.sines.is_empty() && !(pass == 0 && series.depends_on_law());
            if is_alone || pass == 2 {
                break;
            }
            series.refine_sines();
            for (sine, amplitude) in series.explanation.sines.iter_mut().zip(&amplitudes) {
                sine.rescale(*amplitude);
            }
        }
        series
    }

    /// Returns a series under an explanation that was fitted to these samples before. Nothing is fitted again.
    pub fn explained(
        setting: &'a Setting<'a>,
        transform: Cosines,
        samples: Vec<f64>,
        explanation: Explanation,
    ) -> Self {
        let mut series = Self::unbuilt(setting, transform, samples, explanation);
        series.resolve_lines();
        series.apply();
        if series.depends_on_law() {
            series.apply();
        }
        series
    }

    /// Whitens the samples by the explanation's law as it is.
    fn apply(&mut self) {
        self.fit_means();
        // The replacement of samples that are left out is drawn from the spectrum, which depends a little on it.
        for is_drawn in [false, true] {
            if is_drawn {
                self.interpolate();
            }
            self.transformed();
            self.fitted.logarithms = self.explanation.law.logarithms(self.data());
            self.spectrum = self.grid.fill(&self.fitted.logarithms);
        }
        self.whiten();
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

    /// Returns whether the data that is fitted depends on the law as well.
    fn depends_on_law(&self) -> bool {
        self.has_odd_parts() || !self.raw_variances().is_empty()
    }

    /// Returns a grid that resolves these narrow bands and those of the law and of the model.
    pub(super) fn resolving(&self, more: &[Narrow]) -> Grid {
        let rate_hz = self.setting.rate_hz;
        let declared = self.setting.declared.iter().map(|(_, term)| term).chain(self.setting.wandering);
        let own = self.explanation.law.terms.iter().chain(declared).flat_map(|term| term.narrow(rate_hz));
        let lines: Vec<Narrow> = own.chain(more.iter().copied()).collect();
        Grid::new(self.len(), rate_hz, &lines)
    }

    /// Returns the series as if its model had no spectral effect at this place of its list. Excluded samples that were
    /// replaced under a wrong filter may have any value, and are drawn again. Otherwise, the law is fitted again to its
    /// current input.
    pub(super) fn without_declared(&self, place: usize) -> Self {
        let mut bare = self.clone();
        bare.explanation.without.insert(place);
        bare.relaw();
        if self.setting.declared.iter().any(|(own, term)| *own == place && term.is_filter()) {
            bare.rebuild(false);
        }
        bare
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

    /// Fits the law again beside the remaining effects of the model.
    pub(super) fn relaw(&mut self) {
        self.base = (self.setting.base)(&self.grid, &self.explanation.without);
        // A wrong filter may have moved the levels far away: white noise is about 1 in this scale.
        let mut usual = self.explanation.law.clone();
        usual.levels[0] = -self.setting.rate_hz.ln();
        for (level, prior) in usual.levels.iter_mut().zip(self.setting.priors) {
            *level = prior.map_or(*level, |(centre, _)| centre);
        }
        let fitted = [&self.explanation.law, &usual].map(|law| law.fit_from_several(self.data()));
        let [one, other] = fitted;
        self.fitted = if other.log_posterior > one.log_posterior { other } else { one };
        self.explanation.law = self.fitted.law.clone();
        self.spectrum = self.grid.fill(&self.fitted.logarithms);
        self.whitened = self.coefficients.iter().zip(&self.spectrum).map(|(c, s)| c / s.sqrt()).collect();
    }

    /// Rebuilds grid and spectra from the present explanation.
    fn resolve_lines(&mut self) {
        self.grid = self.resolving(&[]);
        self.base = (self.setting.base)(&self.grid, &self.explanation.without);
        self.worth = self.worth_on(&self.grid, &self.base);
    }

    /// Computes the rest without means under the present law: samples with outliers filled in, less sines and courses.
    pub(super) fn fit_means(&mut self) {
        self.fit_means_but(true);
    }

    /// Computes the rest as [`Self::fit_means`] does; if `quiet`, with loud stretches filled in.
    fn fit_means_but(&mut self, quiet: bool) {
        let mut rest = self.samples.clone();
        let explanation = &self.explanation;
        for sine in &explanation.sines {
            sine.add(-1.0, &mut rest);
        }
        for sine in &explanation.gated {
            sine.add(-1.0, &mut rest);
        }
        for (course, factor) in &explanation.courses {
            self.setting.courses.add(*course, -factor, &mut rest);
        }
        let white = self.white().clamp(1e-3, 1e3);
        let left_out = explanation.left_out(self.samples.len(), self.reach());
        self.censored = censored::at_limits(&left_out, &self.samples, &rest, explanation.limits);
        fill_in(&mut rest, &left_out, white, self.setting.owner);
        for loud in explanation.loud.iter().filter(|loud| quiet && loud.ratio > LOUD) {
            let inside: Vec<usize> = self.spoilt(loud).collect();
            fill_in(&mut rest, &inside, white, self.setting.owner);
        }
        (self.rest, self.mean) = (rest, 0.0);
        self.guess_censored(white);
        if quiet {
            self.equalise();
        }
        self.take_ends_off();
        self.centre();
    }

    /// Subtracts the mean from the rest and from its limits.
    pub(super) fn centre(&mut self) {
        let mean = self.rest.iter().sum::<f64>() / self.len().max(1) as f64;
        self.mean += mean;
        self.rest.iter_mut().for_each(|value| *value -= mean);
        self.censored.iter_mut().for_each(|of| of.bound -= mean);
    }

    /// Whitens the rest by the spectrum.
    pub(super) fn whiten(&mut self) {
        self.whitened = self.coefficients.iter().zip(&self.spectrum).map(|(c, s)| c / s.sqrt()).collect();
        let mut residual = self.whitened.clone();
        self.transform.backward(&mut residual);
        self.set_residual(residual);
    }

    /// Sets the inverse transform of the whitened values, less the known changes of the variance.
    fn set_residual(&mut self, mut residual: Vec<f64>) {
        self.variance = self.variances();
        self.unfiltered = self.filters().map_or_else(Vec::new, |gain| {
            let mut values = residual.clone();
            phase::undo(&mut values, &gain);
            values
        });
        if self.equaliser.is_none() {
            for values in [&mut residual, &mut self.unfiltered] {
                values.iter_mut().zip(&self.variance).for_each(|(value, variance)| *value /= variance.sqrt());
            }
        }
        self.residual = residual;
    }

    /// Returns the series with a residual that is whitened by the spectrum of its time: with the bands that are present then, and
    /// without the others. `None` if no band comes and goes.
    pub(super) fn whitened_by_time(&self) -> Option<Self> {
        /// Samples that are replaced have the mean spectrum.
        const REPLACED: u8 = 1 << 7;
        /// Samples on either side of an end, and the largest usual value there.
        const NEAR: usize = 16;
        const USUAL: f64 = 2.0;
        let gates = gated::gates(self);
        if gates.is_empty() {
            return None;
        }
        let mut states: Vec<u8> = gated::left_out(self).into_iter().map(|of| if of { REPLACED } else { 0 }).collect();
        for (at, gate) in gates.iter().enumerate() {
            for range in &gate.ranges {
                let there = states[range.clone()].iter_mut().filter(|state| **state != REPLACED);
                there.for_each(|state| *state |= 1 << at);
            }
        }
        let mut residual = vec![0.0; self.len()];
        let mut series = self.clone();
        for state in states.iter().copied().collect::<BTreeSet<u8>>() {
            let spectrum = match state {
                REPLACED => self.spectrum.clone(),
                _ => gated::spectrum_at(self, &gates, |at| state & (1 << at) != 0),
            };
            let mut own: Vec<f64> = self.coefficients.iter().zip(&spectrum).map(|(c, s)| c / s.sqrt()).collect();
            series.transform.backward(&mut own);
            let here = states.iter().enumerate().filter(|(_, own)| **own == state);
            here.for_each(|(t, _)| residual[t] = own[t]);
        }
        // About the ends of a stay neither spectrum holds.
        for end in gates.iter().flat_map(|gate| &gate.ranges).flat_map(|range| [range.start, range.end]) {
            let near = end.saturating_sub(NEAR)..(end + NEAR).min(residual.len());
            residual[near].iter_mut().for_each(|value| *value = value.clamp(-USUAL, USUAL));
        }
        series.whitened.clone_from(&residual);
        series.transform.forward(&mut series.whitened);
        series.set_residual(residual);
        Some(series)
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
    fn loud_samples(&self) -> usize {
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
