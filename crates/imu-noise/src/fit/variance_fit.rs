//! Weighted least squares on Allan variances, with model choice and the sandwich covariance.
//!
//! The variances are linear in the squared coefficients. Weights come from the model's own spectrum and are iterated.
//! The uncertainty comes from the full covariance of the variances, never from the residuals' scatter. The choice of
//! terms and the residual test use cube roots of the variances, which are nearly normal even at long averaging times,
//! where the variances are χ² with a few degrees of freedom.
//!
//! # Source
//! Guerrier, Molinari, Stebler, IEEE SPL 23 (2016) 597, for the cost of a line through the Allan variance; E. B. Wilson and M. M.
//! Hilferty, PNAS 17 (1931) 684, for the cube root.

use super::FittedCurve;
use super::covariance::CovarianceForm;
use super::least_squares::{non_negative, normal_inverse, unconstrained};
use super::selection::{interval, upper_limit};
use super::term::Term;
use crate::allan::AllanPoint;
use crate::whittle::{Filter, MISFIT};
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// 2 Δ log L beyond which a term at its boundary of 0 is real at the 1 % level (50:50 mixture of χ²₀ and χ²₁).
pub(super) const SIGNIFICANT: f64 = 5.41;
/// From this value on, the ramp enters the model, which would otherwise take it for a random walk (5 % of χ²₁).
const WORTH_ADDING_RAMP: f64 = 3.84;
/// Quantization noise, which few sensors show, has to be evident (0.1 %): named by chance, it would take its variance
/// from N.
const WORTH_ADDING_QUANTIZATION: f64 = 9.55;
/// A term that exceeds 0 by this number of deviations would be named in any record, so that there is no selection.
const BEYOND_DOUBT: f64 = 6.0;
/// Two-sided 95 % of the normal distribution, in standard deviations.
const TWO_SIDED_95: f64 = 1.959_964;
const ITERATIONS: usize = 40;

/// Variances at octave-spaced points and all quantities that do not depend on the coefficients.
#[derive(Debug)]
pub(super) struct VarianceFit {
    points: Vec<AllanPoint>,
    dt_s: f64,
    /// Per point, the contribution to the variance of each of [`Term::ALL`] with coefficient 1.
    parts: Vec<[f64; Term::ALL.len()]>,
    variances: DVector<f64>,
    form: CovarianceForm,
}

/// Coefficients of one set of terms.
#[derive(Debug, Clone)]
pub(super) struct Model {
    /// Terms and their squared coefficients, ≥ 0.
    pub(super) squares: Vec<(Term, f64)>,
    /// Covariance of the variances under this model.
    covariance: DMatrix<f64>,
}

/// The model that the data supports.
#[derive(Debug, Clone)]
pub(super) struct Choice {
    /// The coefficients, all positive.
    pub(super) model: Model,
    /// Whether each coefficient is significant.
    pub(super) identified: Vec<bool>,
    /// The residual test, if a degree of freedom remains.
    pub(super) residual: Option<Residual>,
    /// Factor on standard deviations: above 1 if the residuals are larger than expected (R. T. Birge, 1932).
    pub(super) widen: f64,
}

impl Choice {
    /// Returns whether the residuals are of the size that chance allows.
    pub(super) fn describes(&self) -> bool {
        self.residual.is_none_or(|residual| residual.p_value >= MISFIT)
    }
}

/// The residual test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Residual {
    pub(super) chi2: f64,
    pub(super) degrees_of_freedom: usize,
    pub(super) p_value: f64,
}

impl VarianceFit {
    /// Minimum number of points for a fit of three terms with a degree of freedom for the residual test.
    pub(super) const LEAST_POINTS: usize = 5;

    /// Takes the points nearest to octaves: points between them cost time and reduce the error by less than 1 %. `None`
    /// if fewer than [`VarianceFit::LEAST_POINTS`] remain.
    ///
    /// `filter` is the filter between the noise and the samples, if it is known.
    pub(super) fn new(points: &[AllanPoint], dt_s: f64, filter: Option<&Filter>) -> Option<Self> {
        let points = octaves(points);
        if points.len() < Self::LEAST_POINTS {
            return None;
        }
        let variances = DVector::from_iterator(points.len(), points.iter().map(|point| point.variance));
        let form = CovarianceForm::new(&points, dt_s, filter);
        let factors: Vec<usize> = points.iter().map(|point| point.m).collect();
        let ratios = filter.map(|filter| Term::ALL.map(|term| filter.ratios(term, &factors, dt_s)));
        let ratio = |at: usize, row: usize| ratios.as_ref().map_or(1.0, |ratios| ratios[at][row]);
        let of = |(row, m): (usize, &usize)| {
            std::array::from_fn(|at| ratio(at, row) * Term::ALL[at].allan_variance(*m, dt_s))
        };
        let parts = factors.iter().enumerate().map(of).collect();
        Some(Self { points, dt_s, parts, variances, form })
    }

    /// Returns the contribution of a term of coefficient 1 to a point's variance.
    fn part(&self, term: Term, row: usize) -> f64 {
        Term::ALL.iter().position(|own| *own == term).map_or(0.0, |at| self.parts[row][at])
    }

    fn design(&self, terms: &[Term]) -> DMatrix<f64> {
        DMatrix::from_fn(self.points.len(), terms.len(), |row, column| self.part(terms[column], row))
    }

    fn variances_of(&self, squares: &[(Term, f64)]) -> DVector<f64> {
        let of = |row: usize, _: usize| squares.iter().map(|(term, square)| square * self.part(*term, row)).sum();
        DVector::from_fn(self.points.len(), of)
    }

    /// Fits `terms`; terms at their boundary have a square of 0. `None` if no square is positive.
    pub(super) fn fit(&self, terms: &[Term]) -> Option<Model> {
        let design = self.design(terms);
        // Initially, each variance is as certain as its number of independent blocks.
        let mut deviations: Vec<f64> = self
            .points
            .iter()
            .map(|point| point.variance * (2.0 * point.m as f64 / point.terms.max(1) as f64).sqrt())
            .collect();
        let mut squares: Vec<(Term, f64)> = Vec::new();
        let mut covariance = DMatrix::zeros(0, 0);
        for _ in 0..ITERATIONS {
            let weighted =
                DMatrix::from_fn(design.nrows(), design.ncols(), |row, column| design[(row, column)] / deviations[row]);
            let target = DVector::from_fn(design.nrows(), |row, _| self.variances[row] / deviations[row]);
            let solution = non_negative(&weighted, &target)?;
            let next: Vec<(Term, f64)> = terms.iter().copied().zip(solution.values).collect();
            let change = self.variances_of(&next) - self.variances_of(&squares);
            let settled = change.iter().zip(&deviations).all(|(change, deviation)| change.abs() < 1e-6 * deviation);
            covariance = self.form.at(&next);
            deviations = covariance.diagonal().iter().map(|variance| variance.sqrt()).collect();
            squares = next;
            if deviations.iter().any(|deviation| !(deviation.is_finite() && *deviation > 0.0)) {
                return None;
            }
            if settled {
                break;
            }
        }
        Some(Model { squares, covariance })
    }

    /// Returns the distance of the data from `model`, as nearly normal numbers whitened by the model's covariance:
    /// residual and design.
    fn whitened(&self, model: &Model, terms: &[Term]) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let expected = self.variances_of(&model.squares);
        let target = DVector::from_fn(self.points.len(), |row, _| {
            let (expected, variance) = (expected[row], model.covariance[(row, row)]);
            let spread = variance / (9.0 * expected * expected);
            // Wilson and Hilferty: the cube root of χ²/ν has mean 1 − 2/(9ν) and variance 2/(9ν), with ν = 2V²/C.
            expected + 3.0 * expected * ((self.variances[row] / expected).cbrt() - (1.0 - spread))
        });
        let factor = model.covariance.clone().cholesky()?.unpack();
        let design = factor.solve_lower_triangular(&self.design(terms))?;
        Some((design, factor.solve_lower_triangular(&target)?))
    }

    /// Returns 2 Δ log L of adding `term` to `terms`, judged under the fit without it.
    fn gain(&self, terms: &[Term], term: Term) -> Option<f64> {
        let null = self.fit(terms)?;
        let with: Vec<Term> = terms.iter().copied().chain([term]).collect();
        let (design, target) = self.whitened(&null, &with)?;
        let full = non_negative(&design, &target)?.objective;
        let restricted = non_negative(&design.columns(0, terms.len()).into_owned(), &target)?.objective;
        Some(restricted - full)
    }

    /// Chooses the terms that the data supports: N, B and K, which every sensor has, then any other worth adding.
    ///
    /// A positive term whose gain is below [`SIGNIFICANT`] stays in the model, so that the others' intervals allow for
    /// it, but is not identified. Without it, the interval of B held in 91 % instead of 93 % of records with a weak K.
    /// Q and R are used only if the data is then described, so that they do not represent vibration and knocks. `None`
    /// if no term is positive.
    pub(super) fn choose(&self) -> Option<Choice> {
        let base = [Term::N, Term::B, Term::K];
        let extended = self.judge(&self.extend(&base)?)?;
        if extended.model.squares.iter().all(|(term, _)| base.contains(term)) || extended.describes() {
            return Some(extended);
        }
        self.judge(&base).or(Some(extended))
    }

    /// Adds terms as long as one is worth it.
    fn extend(&self, base: &[Term]) -> Option<Vec<Term>> {
        let mut terms = base.to_vec();
        for _ in Term::ALL {
            terms = self.positive(&self.fit(&terms)?);
            let strongest = Term::ALL
                .into_iter()
                .filter(|term| !terms.contains(term))
                .filter_map(|term| Some((term, self.gain(&terms, term)?)))
                .max_by(|a, b| a.1.total_cmp(&b.1));
            let enough = |term: Term| match term {
                Term::R => WORTH_ADDING_RAMP,
                Term::Q => WORTH_ADDING_QUANTIZATION,
                _ => SIGNIFICANT,
            };
            let Some((strongest, _)) = strongest.filter(|(term, gain)| *gain >= enough(*term)) else { break };
            let more: Vec<Term> = terms.iter().copied().chain([strongest]).collect();
            if !self.positive(&self.fit(&more)?).contains(&strongest) {
                break;
            }
            terms = more;
        }
        terms.sort_unstable();
        Some(terms)
    }

    /// Fits the positive ones of `terms` and determines which are significant.
    fn judge(&self, terms: &[Term]) -> Option<Choice> {
        let model = self.fit(terms)?;
        let terms = self.positive(&model);
        let model = if terms.len() < model.squares.len() { self.fit(&terms)? } else { model };
        let residual = self.residual(&model);
        let widen = match residual {
            Some(residual) if residual.p_value < MISFIT => (residual.chi2 / residual.degrees_of_freedom as f64).sqrt(),
            _ => 1.0,
        };
        let significant = |term: &Term| {
            let others: Vec<Term> = terms.iter().copied().filter(|other| other != term).collect();
            // If no gain can be computed, the other terms alone are not a noise model: this term is essential.
            self.gain(&others, *term).is_none_or(|gain| gain / (widen * widen) >= SIGNIFICANT)
        };
        let identified = terms.iter().map(significant).collect();
        (!terms.is_empty()).then_some(Choice { model, identified, residual, widen })
    }

    fn positive(&self, model: &Model) -> Vec<Term> {
        model.squares.iter().filter(|(_, square)| *square > 0.0).map(|(term, _)| *term).collect()
    }

    /// Returns the covariance of the squared coefficients of `model`: (AᵀWA)⁻¹ AᵀWCWA (AᵀWA)⁻¹.
    fn sandwich(&self, model: &Model) -> Option<DMatrix<f64>> {
        let terms: Vec<Term> = model.squares.iter().map(|(term, _)| *term).collect();
        let estimator = self.linear_estimator(model, &terms)?;
        Some(&estimator * &model.covariance * estimator.transpose())
    }

    /// Returns (AᵀWA)⁻¹AᵀW, of shape terms × points.
    fn linear_estimator(&self, model: &Model, terms: &[Term]) -> Option<DMatrix<f64>> {
        let deviations: Vec<f64> = model.covariance.diagonal().iter().map(|variance| variance.sqrt()).collect();
        let mut weighted = self.design(terms);
        for (mut row, deviation) in weighted.row_iter_mut().zip(&deviations) {
            row /= *deviation;
        }
        let mut estimator = normal_inverse(&weighted)? * weighted.transpose();
        for (mut column, deviation) in estimator.column_iter_mut().zip(&deviations) {
            column /= *deviation;
        }
        Some(estimator)
    }

    /// Returns 95 % intervals of the coefficients (not squared) of `model` that hold among the records in which the
    /// term is named. `widen` is a factor on the standard deviations.
    pub(super) fn intervals(&self, model: &Model, widen: f64) -> Option<Vec<[f64; 2]>> {
        let covariance = self.sandwich(model)?;
        let interval_of = |(index, (term, square)): (usize, &(Term, f64))| {
            let coefficient = square.sqrt();
            let root = self.root(model, *term, widen);
            let selected = root(0.0)
                .filter(|r_zero| *r_zero < BEYOND_DOUBT)
                .and_then(|r_zero| interval(coefficient, r_zero, SIGNIFICANT.sqrt(), &root));
            selected.map_or_else(
                || {
                    let deviation = covariance[(index, index)].sqrt() / (2.0 * coefficient) * widen;
                    [(coefficient - TWO_SIDED_95 * deviation).max(0.0), coefficient + TWO_SIDED_95 * deviation]
                },
                |[low, high]| [low.min(coefficient), high.max(coefficient)],
            )
        };
        Some(model.squares.iter().enumerate().map(interval_of).collect())
    }

    /// Returns the 95 % upper limit of a term that is not identified.
    pub(super) fn upper_limit(&self, model: &Model, term: Term, widen: f64) -> Option<f64> {
        let root = self.root(model, term, widen);
        let alone = |row: usize| (self.variances[row] / self.part(term, row)).sqrt();
        let least = 1e-4 * (0..self.points.len()).map(alone).fold(f64::INFINITY, f64::min);
        upper_limit(least, root(0.0)?.max(0.0), SIGNIFICANT.sqrt(), &root)
    }

    /// Returns how far the found square lies above that of c, in deviations of a model that has the term at c: weights
    /// and covariance are that model's.
    fn root(&self, model: &Model, term: Term, widen: f64) -> impl Fn(f64) -> Option<f64> {
        let others: Vec<(Term, f64)> = model.squares.iter().copied().filter(|(other, _)| *other != term).collect();
        let terms: Vec<Term> = others.iter().map(|(term, _)| *term).chain([term]).collect();
        let last = terms.len() - 1;
        move |c: f64| {
            let squares: Vec<(Term, f64)> = others.iter().copied().chain([(term, c * c)]).collect();
            let covariance = self.form.at(&squares);
            let supposed = Model { squares, covariance };
            let estimator = self.linear_estimator(&supposed, &terms)?;
            let found = (&estimator * &self.variances)[last].max(0.0);
            let spread = (&estimator * &supposed.covariance * estimator.transpose())[(last, last)].sqrt() * widen;
            Some((found - c * c) / spread).filter(|root| root.is_finite())
        }
    }

    /// Returns the model's Allan deviation and its parts.
    pub(super) fn curve(&self, model: &Model) -> FittedCurve {
        let factors = self.points.iter().map(|point| point.m).collect();
        let dt_s = self.dt_s;
        let parts = model.squares.iter().map(|(term, square)| {
            let (term, square) = (*term, *square);
            let row = |m: usize| self.points.iter().position(|point| point.m == m);
            let variance = move |m| square * row(m).map_or(0.0, |row| self.part(term, row));
            (term.letter(), Box::new(variance) as Box<dyn Fn(usize) -> f64 + '_>)
        });
        FittedCurve::at(factors, dt_s, parts)
    }

    /// Returns whether the residuals of `model` have the size that its covariance predicts.
    pub(super) fn residual(&self, model: &Model) -> Option<Residual> {
        let terms: Vec<Term> = model.squares.iter().map(|(term, _)| *term).collect();
        let (design, target) = self.whitened(model, &terms)?;
        let best = unconstrained(&design, &target)?;
        let chi2 = (target - design * best).norm_squared();
        let degrees_of_freedom = self.points.len().checked_sub(terms.len()).filter(|degrees| *degrees > 0)?;
        let p_value = ChiSquared::new(degrees_of_freedom as f64).ok()?.sf(chi2);
        (chi2.is_finite() && p_value.is_finite()).then_some(Residual { chi2, degrees_of_freedom, p_value })
    }
}

/// Returns the points nearest to powers of two times the smallest factor, each once.
fn octaves(points: &[AllanPoint]) -> Vec<AllanPoint> {
    /// Two points whose ratio is below this factor carry the same information.
    const APART: f64 = 1.6;
    let usable: Vec<&AllanPoint> = points.iter().filter(|point| point.variance > 0.0 && point.terms > 0).collect();
    let Some(first) = usable.first() else { return Vec::new() };
    let mut chosen: Vec<AllanPoint> = Vec::new();
    for octave in 0..64 {
        let wanted = (first.m as f64 * 2f64.powi(octave)).ln();
        let distance = |point: &AllanPoint| ((point.m as f64).ln() - wanted).abs();
        let nearest = usable.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let Some(nearest) = nearest.filter(|point| distance(point) < 0.35) else { continue };
        if chosen.last().is_none_or(|last| nearest.m as f64 >= APART * last.m as f64) {
            chosen.push(**nearest);
        }
    }
    chosen
}
