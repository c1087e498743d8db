//! Explained: builds a series from samples and their explanation, fits its law, and whitens what is left.

use super::censored;
use super::explanation::{Explanation, LOUD, Loud, Sine};
use super::filling::fill_in;
use super::grid::Grid;
use super::law::{Base, Data, Fitted, Term};
use super::phase;
use super::series::{Series, Setting};
use super::transform::Cosines;
use std::cell::RefCell;

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

    /// Returns whether the data that is fitted depends on the law as well.
    fn depends_on_law(&self) -> bool {
        self.has_odd_parts() || !self.raw_variances().is_empty()
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

    /// Whitens the rest by the spectrum.
    pub(super) fn whiten(&mut self) {
        self.whitened = self.coefficients.iter().zip(&self.spectrum).map(|(c, s)| c / s.sqrt()).collect();
        let mut residual = self.whitened.clone();
        self.transform.backward(&mut residual);
        self.set_residual(residual);
    }

    /// Sets the inverse transform of the whitened values, less the known changes of the variance.
    pub(super) fn set_residual(&mut self, mut residual: Vec<f64>) {
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
}
