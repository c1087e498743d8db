//! The variance that an explanation gives the white part at each sample.

use super::explanation::{LOUD, Loud, Scedasticity, profile};
use super::series::{Series, Varied};
use std::rc::Rc;

impl Series<'_> {
    /// Returns the ratio of the white part's average variance to its variance at times when nothing changes it: the
    /// law's level of white noise is the average.
    pub fn average_variance(&self) -> f64 {
        self.average(&self.raw_variances())
    }

    /// Returns the mean of variances over the samples that determine the law: those of excluded stretches are replaced by
    /// draws. No variances are those of a constant one.
    fn average(&self, variances: &[f64]) -> f64 {
        let mut is_there = vec![true; variances.len()];
        for loud in self.explanation.loud.iter().filter(|loud| loud.ratio > LOUD && !variances.is_empty()) {
            is_there[self.spoilt(loud)].fill(false);
        }
        let there = variances.iter().zip(is_there).filter(|(_, is_there)| *is_there);
        let (sum, count) = there.fold((0.0, 0.0), |(sum, count), (value, _)| (sum + value, count + 1.0));
        if count > 0.0 { sum / count } else { 1.0 }
    }

    /// Returns the variance that the explanation gives each sample of the residual, 1 on average; empty if it is
    /// constant.
    pub(super) fn variances(&self) -> Vec<f64> {
        let raw = self.raw_variances();
        let mean = self.average(&raw);
        raw.iter().map(|value| value / mean).collect()
    }

    /// Returns the variance that the explanation gives each sample, over the variance at times when nothing changes it.
    pub(super) fn raw_variances(&self) -> Rc<[f64]> {
        let own = &self.explanation;
        let quiet: Vec<Loud> = own.loud.iter().copied().filter(|loud| loud.ratio <= LOUD).collect();
        let mut kept = self.varied.borrow_mut();
        match &*kept {
            Some(of) if of.scedasticity == own.scedasticity && of.quiet == quiet => of.values.clone(),
            _ => {
                let values: Rc<[f64]> = self.computed_variances(&quiet).into();
                let scedasticity = own.scedasticity.clone();
                *kept = Some(Varied { scedasticity, quiet, values: values.clone() });
                values
            }
        }
    }

    /// Returns the white noise's share of the root of the spectrum at each coefficient. Noise that enters behind a
    /// filter is not part of it.
    pub(super) fn white_shares(&self) -> Vec<f32> {
        let white = self.white().powi(2);
        let gain = self.filters();
        let passed = |k: usize| gain.as_ref().map_or(1.0, |gain| gain[k]);
        let share =
            |(k, s): (usize, &f64)| if s.is_finite() { (white * passed(k) / s).sqrt().min(1.0) as f32 } else { 0.0 };
        self.spectrum.iter().enumerate().map(share).collect()
    }

    /// Returns the variance of the white noise in each stretch. The explanation has the factor on the residual's variance
    /// wherever other noise cannot be separated from it: in excluded stretches, and behind filters.
    ///
    /// Inside and outside a stretch the residual's mean squares are 1 − A + A·w, where A is the mean square of the white
    /// noise's share of the root of the spectrum, and w the variance of the white noise over that of the law.
    pub(super) fn white_ratios(&mut self) -> Vec<Ratio> {
        const ROUNDS: usize = 50;
        let ratio = |loud: &Loud| Ratio { factor: loud.ratio, error: 1.0, usual: 1.0 };
        let mut ratios: Vec<Ratio> = self.explanation.loud.iter().map(ratio).collect();
        let squares = |series: &Self| {
            let shares = series.white_shares();
            let sum: f64 = shares.iter().map(|share| f64::from(*share).powi(2)).sum();
            (sum / shares.len().max(1) as f64).max(1e-3)
        };
        let converted = |ratio: f64, share: f64| {
            let white = (1.0 + (ratio - 1.0) / share).max(1e-3);
            Ratio { factor: white, error: ratio / (share * white), usual: 1.0 }
        };
        // At this limit a stretch is as loud as it can be without being excluded.
        if self.explanation.loud.iter().any(|loud| loud.ratio == LOUD) {
            let mut other = self.clone();
            let limit = |loud: &mut Loud| loud.ratio = if loud.ratio == LOUD { 1.01 * LOUD } else { loud.ratio };
            other.explanation.loud.iter_mut().for_each(limit);
            other.rebuild(false);
            return other.white_ratios();
        }
        let share = squares(self);
        for (at, ratio) in self.loudness() {
            ratios[at] = converted(ratio, share);
        }
        let quiet: Vec<usize> = (0..ratios.len()).filter(|at| self.explanation.loud[*at].ratio <= LOUD).collect();
        if self.equaliser.is_none() && self.explanation.scedasticity.is_none() && !quiet.is_empty() {
            for _ in 0..ROUNDS {
                let average = self.average_with(&ratios);
                for at in &quiet {
                    // The share at times when nothing changes the variance.
                    let usual = share / average;
                    ratios[*at] = converted(self.explanation.loud[*at].ratio, usual / (usual + 1.0 - share));
                }
            }
        }
        self.over_usual(&mut ratios);
        ratios
    }

    /// Relates each stretch to the variance that all else gives it. Until now, excluded stretches are relative to the law,
    /// which is the average.
    fn over_usual(&self, ratios: &mut [Ratio]) {
        let variances = self.computed_variances(&self.quiet_with(ratios));
        let mean = self.average(&variances);
        for (loud, ratio) in self.explanation.loud.iter().zip(ratios) {
            let is_quiet = loud.ratio <= LOUD;
            let inside = variances.get(loud.from..loud.to);
            let inside = inside.map_or(1.0, |of| of.iter().sum::<f64>() / of.len() as f64);
            ratio.usual = if is_quiet { inside / ratio.factor } else { inside };
            if !is_quiet {
                ratio.factor *= mean / inside;
            }
        }
    }

    /// Returns [`Self::average_variance`] with other factors in the stretches.
    pub(super) fn average_with(&self, ratios: &[Ratio]) -> f64 {
        self.average(&self.computed_variances(&self.quiet_with(ratios)))
    }

    /// Returns the stretches that are not left out, with other factors.
    fn quiet_with(&self, ratios: &[Ratio]) -> Vec<Loud> {
        let own = self.explanation.loud.iter().zip(ratios).filter(|(loud, _)| loud.ratio <= LOUD);
        own.map(|(loud, ratio)| Loud { ratio: ratio.factor, ..*loud }).collect()
    }

    /// Computes the variances. `quiet` are the stretches that are not so loud that they are left out.
    fn computed_variances(&self, quiet: &[Loud]) -> Vec<f64> {
        let n = self.len();
        let temperature = self.setting().courses.temperature().unwrap_or_default();
        let mut variance: Vec<f64> = match &self.explanation.scedasticity {
            None => Vec::new(),
            Some(Scedasticity::PerDegree(slope)) => temperature.iter().map(|t| (slope * t).exp()).collect(),
            Some(Scedasticity::Profile(values)) => (0..n).map(|t| profile(values, t, n).exp()).collect(),
        };
        for loud in quiet {
            variance.resize(n, 1.0);
            variance[loud.from..loud.to].iter_mut().for_each(|value| *value *= loud.ratio);
        }
        variance
    }
}

/// The variance of the white noise in a stretch.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Ratio {
    /// The factor that the stretch has on the variance.
    pub factor: f64,
    /// The error of the factor's logarithm over that of the explanation's factor.
    pub error: f64,
    /// The variance without this factor over the variance at times when nothing changes it.
    pub usual: f64,
}

impl Ratio {
    /// Returns the variance of a channel's own white noise, if `shared` is the part of the white noise's average variance
    /// that other channels share: the stretch does not change that part. `average` is the average variance over that at
    /// times when nothing changes it. The error is infinite if hardly anything is the channel's own.
    pub(super) fn beside_shared(self, shared: f64, average: f64) -> Self {
        const MOST: f64 = 0.98;
        let part = shared * average / self.usual;
        let own = 1.0 - part.min(MOST);
        let left = self.factor - part.min(MOST);
        let is_known = part < MOST && left > (1.0 - MOST) * self.factor;
        let error = if is_known { self.error * self.factor / left } else { f64::INFINITY };
        Self { factor: (left / own).max(1e-3), error, usual: self.usual * own }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::explanation::{Explanation, Sine};
    use crate::grid::Grid;
    use crate::prepare;
    use crate::round_trip::{model, recording};
    use std::collections::BTreeSet;

    /// Calls `each` with a series that has a changing variance, a sine and excluded samples.
    fn with_uneven(each: impl FnOnce(Series<'_>)) {
        let model = model(None);
        let ready = prepare::prepare(&recording(&model, 3, 8_000), &model).unwrap();
        let prepared = &ready.channels[0];
        let base = |grid: &Grid, without: &BTreeSet<usize>| prepare::base_of(&model, prepared, grid, without);
        let setting = ready.setting(prepared, &base);
        let mut start = Explanation::noise(prepared.declared.clone());
        start.scedasticity = Some(Scedasticity::Profile(vec![0.0, 0.7, 0.2]));
        start.loud = vec![Loud { from: 100, to: 900, ratio: 1.5 }, Loud { from: 2000, to: 2100, ratio: 30.0 }];
        start.sines = vec![Sine { cycles: 0.21, quadratures: [0.1, 0.2] }];
        start.outliers = vec![5, 6, 7, 4000];
        each(Series::new(&setting, ready.transform.clone(), prepared.samples.clone(), start));
    }

    fn is_fresh(series: &Series<'_>) -> bool {
        let quiet: Vec<Loud> = series.explanation.loud.iter().copied().filter(|loud| loud.ratio <= LOUD).collect();
        series.raw_variances().to_vec() == series.computed_variances(&quiet)
    }

    #[test]
    fn variances_follow_the_explanation_whatever_was_computed_before() {
        with_uneven(|mut series| {
            assert!(is_fresh(&series));
            let kept = series.clone();
            series.explanation.scedasticity = Some(Scedasticity::Profile(vec![0.0, 0.1, 0.2]));
            assert!(is_fresh(&series) && series.raw_variances() != kept.raw_variances());
            series.explanation.loud[0].to = 1000;
            assert!(is_fresh(&series));
            series.explanation.loud[0].ratio = 5.0;
            assert!(is_fresh(&series));
            series.explanation.scedasticity = None;
            assert!(series.raw_variances().is_empty());
            assert!(is_fresh(&kept) && kept.raw_variances().len() == kept.len());
        });
    }

    #[test]
    fn the_average_is_that_of_the_samples_that_are_not_replaced() {
        with_uneven(|mut series| {
            series.explanation.scedasticity = None;
            series.explanation.loud =
                vec![Loud { from: 0, to: 2000, ratio: 16.0 }, Loud { from: 4000, to: 6000, ratio: 3.0 }];
            let expected = (4000.0 + 2000.0 * 3.0) / 6000.0;
            assert!((series.average_variance() - expected).abs() < 1e-12, "{}", series.average_variance());
            assert!((series.variances()[7000] - 1.0 / expected).abs() < 1e-12);
            assert!((series.variances()[5000] - 3.0 / expected).abs() < 1e-12);
        });
    }

    #[test]
    fn a_factor_beside_shared_noise_is_finite_and_has_no_interval_where_nothing_is_left() {
        let of = |factor: f64, shared: f64, usual: f64| Ratio { factor, error: 1.0, usual }.beside_shared(shared, 1.0);
        let louder = of(2.0, 0.25, 1.0);
        assert!((louder.factor - 1.75 / 0.75).abs() < 1e-12 && (louder.error - 2.0 / 1.75).abs() < 1e-12);
        // What a stretch adds stays the same.
        assert!((louder.usual * (louder.factor - 1.0) - 1.0).abs() < 1e-12);
        for (factor, shared, usual) in [(2.0, 0.5, 0.4), (1.0, 1.0, 1.0), (0.2, 0.265, 1.0), (2.0, 0.999, 1.0)] {
            let found = of(factor, shared, usual);
            assert!(found.factor.is_finite() && found.factor > 0.0 && found.error == f64::INFINITY, "{found:?}");
            assert!(factor <= 1.0 || found.factor > 1.0, "{found:?}");
        }
    }

    #[test]
    fn a_series_that_was_built_is_whitened_by_its_own_law() {
        with_uneven(|mut series| {
            for _ in 0..2 {
                let state = |of: &Series<'_>| (of.whitened.clone(), of.residual.clone(), of.variance.clone());
                let before = state(&series);
                series.whiten();
                assert_eq!(before, state(&series));
                series.explanation.sines.clear();
                series.rebuild(false);
            }
        });
    }
}
