//! Statement: computes the interval or limit of each parameter from its profile likelihood.

use super::choice::{Choice, correlation_time, price};
use super::likelihood::{Held, Likelihood, Model, SIGMA, Terms, place};
use super::residual::Residual;
use super::shape::Shape;
use crate::fit::Term;
use crate::fit::selection::{interval, upper_limit};

/// The information in the data about one coefficient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Statement {
    /// A value and its 95 % interval; for a ramp, with its sign.
    Named(f64, [f64; 2]),
    /// A 95 % upper limit, if there is one.
    Limited(Option<f64>),
}

/// Makes statements about a choice.
#[derive(Debug)]
pub(super) struct Profile<'a> {
    likelihood: &'a Likelihood,
    choice: &'a Choice,
    widen: f64,
}

impl<'a> Profile<'a> {
    pub(super) fn new(likelihood: &'a Likelihood, choice: &'a Choice) -> Self {
        // The likelihood does not include the choice of a degree. Without this factor, 91 of 100 intervals held behind
        // an FIR filter.
        const CHOSEN: f64 = 1.25;
        let chosen = if matches!(likelihood.shape(), Shape::Smooth { .. }) { CHOSEN } else { 1.0 };
        Self { likelihood, choice, widen: chosen * Residual::widen(choice.residual) }
    }

    /// Returns the model from which intervals are read: the chosen terms, with B and K whether named or not, because a
    /// term that is too weak to be named may still be present. A Gauss–Markov process takes their place.
    fn family(&self) -> Terms {
        let chosen = self.choice.model.terms;
        if chosen.has_gauss_markov() { chosen } else { self.plain_family() }
    }

    /// Returns the model without a process.
    fn plain_family(&self) -> Terms {
        self.choice.model.terms.without_gauss_markov().with(Term::B).with(Term::K)
    }

    fn best(&self, terms: Terms, held: Held, near: &Model) -> Option<Model> {
        if terms.has_gauss_markov() {
            let start = self.likelihood.maximise(terms, near.tc_s, held, Some(near))?;
            correlation_time(self.likelihood, held, &start)
        } else {
            self.likelihood.maximise(terms, near.tc_s, held, Some(near))
        }
    }

    /// Returns the root of the likelihood ratio of two deviances, in widened deviations.
    fn root(&self, held: f64, maximum: f64) -> f64 {
        (held - maximum).max(0.0).sqrt() / self.widen
    }

    /// Returns the statement about N, B, K, Q or R.
    pub(super) fn statement(&self, term: Term) -> Statement {
        let chosen = &self.choice.model;
        let Some(course) = Course::new(self, term, self.family()) else { return Statement::Limited(None) };
        let value = self.choice.values.coefficient(term).abs();
        let named = chosen.terms.has(term) && value > 0.0 && self.stands(term);
        if named && let Some([low, high]) = course.interval(value) {
            let ends = [low.min(value), high.max(value)];
            // A ramp falls or rises; the others have no sign.
            return if self.choice.values.coefficient(term) < 0.0 {
                Statement::Named(-value, [-ends[1], -ends[0]])
            } else {
                Statement::Named(value, ends)
            };
        }
        let limit = course.upper_limit();
        // Whether a process or flicker and a walk made the data is a matter of a few units of log L: a limit allows for
        // both.
        if chosen.terms.has_gauss_markov() && matches!(term, Term::B | Term::K) {
            let plain = self.limit_in(self.plain_family(), term);
            return Statement::Limited(limit.zip(plain).map(|(beside, plain)| beside.max(plain)));
        }
        Statement::Limited(limit)
    }

    /// Returns the 95 % upper limit that a family of models sets.
    pub(super) fn limit_in(&self, family: Terms, term: Term) -> Option<f64> {
        Course::new(self, term, family)?.upper_limit()
    }

    /// Returns whether the term is still worth its price when deviations are widened.
    fn stands(&self, term: Term) -> bool {
        if self.widen <= 1.0 && term != Term::N {
            // The choice has already paid the price.
            return true;
        }
        let chosen = &self.choice.model;
        self.best(chosen.terms.without(term), Held::Nothing, chosen)
            .is_none_or(|without| self.root(without.deviance, chosen.deviance).powi(2) >= price(term, chosen.terms))
    }

    /// Returns σ and Tc of the Gauss–Markov process, if one was chosen.
    pub(super) fn gauss_markov(&self) -> Option<[(f64, [f64; 2]); 2]> {
        let chosen = &self.choice.model;
        let sigma = chosen.squares[SIGMA].sqrt();
        if !chosen.terms.has_gauss_markov() || sigma <= 0.0 {
            return None;
        }
        let signed = |held: f64, c: f64, found: f64| {
            let root = self.root(held, chosen.deviance);
            if c < found { root } else { -root }
        };
        let of_sigma = |c: f64| {
            let held = self.best(chosen.terms, Held::Square(SIGMA, c * c), chosen)?;
            Some(signed(held.deviance, c, sigma))
        };
        let of_tc = |c: f64| {
            let held = self.likelihood.maximise(chosen.terms, c, Held::Nothing, Some(chosen))?;
            Some(signed(held.deviance, c, chosen.tc_s))
        };
        // Both are present or absent together, far beyond doubt: neither was selected.
        let sigma_95 = interval(sigma, f64::INFINITY, 0.0, &of_sigma);
        let tc_95 = interval(chosen.tc_s, f64::INFINITY, 0.0, &of_tc);
        Some([(sigma, sigma_95?), (chosen.tc_s, tc_95?)])
    }
}

/// The likelihood of each size of one coefficient in a family of models.
#[derive(Debug)]
struct Course<'a> {
    profile: &'a Profile<'a>,
    term: Term,
    terms: Terms,
    maximum: Model,
    /// The size at the maximum, and its sign.
    found: f64,
    sign: f64,
    /// The root at 0, infinite if the family needs the term.
    r_zero: f64,
    /// The root from which on the term is named.
    threshold: f64,
}

impl<'a> Course<'a> {
    /// Creates the course; `None` if the family does not fit.
    fn new(profile: &'a Profile<'a>, term: Term, family: Terms) -> Option<Self> {
        let terms = family.with(term);
        let maximum = profile.best(terms, Held::Nothing, &profile.choice.model)?;
        let without = profile.best(terms.without(term), Held::Nothing, &maximum);
        let r_zero = without.map_or(f64::INFINITY, |without| profile.root(without.deviance, maximum.deviance));
        let signed = maximum.coefficient(term);
        let sign = if signed < 0.0 { -1.0 } else { 1.0 };
        let threshold = price(term, terms).sqrt();
        Some(Self { profile, term, terms, maximum, found: signed.abs(), sign, r_zero, threshold })
    }

    /// Returns the signed root at `c` of the found sign.
    fn root(&self, c: f64) -> Option<f64> {
        let hold = place(self.term).map_or(Held::Ramp(self.sign * c), |at| Held::Square(at, c * c));
        let held = self.profile.best(self.terms, hold, &self.maximum)?;
        let root = self.profile.root(held.deviance, self.maximum.deviance);
        Some(if c < self.found { root } else { -root })
    }

    /// Returns the 95 % interval for a term of that value.
    fn interval(&self, value: f64) -> Option<[f64; 2]> {
        interval(self.found.max(1e-6 * value), self.r_zero, self.threshold, &|c| self.root(c))
    }

    /// Returns the 95 % limit of a term that is not named.
    fn upper_limit(&self) -> Option<f64> {
        let least = 1e-4 * self.profile.likelihood.whole(self.term, &self.maximum).unwrap_or(1.0);
        upper_limit(least, self.r_zero, self.threshold, &|c| self.root(c)).filter(|limit| limit.is_finite())
    }
}
