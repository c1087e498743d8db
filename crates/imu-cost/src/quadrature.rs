//! Quadrature: ∫ S(f)|W(f)|² df exactly, although |W|² oscillates millions of times up to half the rate.
//!
//! The frequencies from almost 0 to half the rate are cut into panels on which every density is smooth. On a panel |W|²
//! is a sum of smooth functions times e^(iωδ), with a few delays δ ([`crate::weights`]). Smooth function and density are
//! taken as a polynomial through [`NODES`] Gauss–Legendre points, and the polynomial times the oscillation is integrated
//! exactly, for any δ: Filon's method in Legendre polynomials, whose moments are spherical Bessel functions.
//! The error is that of the polynomials, and does not grow with the number of oscillations.
//!
//! Source of the method: Filon 1928 (Proc. R. Soc. Edinburgh 49); in Legendre polynomials Bakhvalov and Vasil'eva 1968.
//!
//! In: panels, spans. Out: one weight per node, order and span, so that a variance is a sum over nodes.
//!
//! Validation: `variances_are_those_of_the_listed_weights` (white, walk, Gauss–Markov, narrow line): 1e-6 and better.

use crate::weights::{Angle, ORDERS, Smooth, Span, Term};
use nalgebra::Complex;
use std::f64::consts::TAU;

/// The number of points of a panel.
pub(crate) const NODES: usize = 10;
/// The lowest frequency, as a part of one over the longest span. What lies below it is 1e-5 of the variance for a
/// density of f^−2.5, and nothing for others.
const LOWEST: f64 = 1e-10;
/// Up to this phase over half a panel the points resolve the oscillation.
const RESOLVED: f64 = 4.0;

/// The Gauss–Legendre rule, and its Legendre polynomials.
#[derive(Debug)]
pub(crate) struct Rule {
    /// Points in −1…1.
    points: [f64; NODES],
    weights: [f64; NODES],
    /// (2l + 1)/2·P_l at each point, by degree l.
    scaled: [[f64; NODES]; NODES],
}

impl Rule {
    pub(crate) fn new() -> Self {
        let (mut points, mut weights, mut scaled) = ([0.0; NODES], [0.0; NODES], [[0.0; NODES]; NODES]);
        for place in 0..NODES {
            // Newton's method from Chebyshev's point, which lies close by.
            let mut x = -(std::f64::consts::PI * (place as f64 + 0.75) / (NODES as f64 + 0.5)).cos();
            for _ in 0..20 {
                let [last, own] = last_two(x);
                let slope = NODES as f64 * (x * own - last) / (x * x - 1.0);
                x -= own / slope;
                weights[place] = 2.0 / ((1.0 - x * x) * slope * slope);
            }
            points[place] = x;
            let mut pair = [1.0, x];
            for (degree, row) in scaled.iter_mut().enumerate() {
                row[place] = 0.5 * (2 * degree + 1) as f64 * pair[0];
                pair = [pair[1], next(degree + 1, pair, x)];
            }
        }
        Self { points, weights, scaled }
    }

    /// Returns the points of a panel.
    pub(crate) fn nodes(&self, panel: Panel) -> [f64; NODES] {
        self.points.map(|x| 0.5 * (panel.from + panel.to) + 0.5 * (panel.to - panel.from) * x)
    }

    /// Returns the weights of a panel for what does not oscillate.
    pub(crate) fn plain(&self, panel: Panel) -> [f64; NODES] {
        self.weights.map(|weight| 0.5 * (panel.to - panel.from) * weight)
    }

    /// Returns how far the polynomial through the points may be off, as a part of the function's size: the last two of
    /// its Legendre coefficients over the sum of all.
    pub(crate) fn roughness(&self, values: &[f64; NODES]) -> f64 {
        let mut sizes = [0.0; NODES];
        for (size, row) in sizes.iter_mut().zip(&self.scaled) {
            *size = row.iter().zip(&self.weights).zip(values).map(|((p, w), value)| p * w * value).sum::<f64>().abs();
        }
        let all: f64 = sizes.iter().sum();
        if all > 0.0 { (sizes[NODES - 1] + sizes[NODES - 2]) / all } else { 0.0 }
    }

    /// Returns the weights of a panel for a function times e^(−iωδ), with `delay` δ in samples.
    pub(crate) fn oscillating(&self, panel: Panel, rate_hz: f64, delay: f64) -> [Complex<f64>; NODES] {
        let half = 0.5 * (panel.to - panel.from);
        let turn = TAU * delay / rate_hz;
        let theta = turn * half;
        let mut weights = [Complex::from(0.0); NODES];
        if theta < RESOLVED {
            for ((weight, own), hz) in weights.iter_mut().zip(&self.weights).zip(self.nodes(panel)) {
                *weight = Complex::cis(-turn * hz) * (half * own);
            }
            return weights;
        }
        let shift = Complex::cis(-turn * 0.5 * (panel.from + panel.to)) * (2.0 * half);
        let mut phase = shift;
        for (row, bessel) in self.scaled.iter().zip(spherical_bessel(theta)) {
            for ((weight, own), polynomial) in weights.iter_mut().zip(&self.weights).zip(row) {
                *weight += phase * (bessel * polynomial * own);
            }
            phase *= Complex::new(0.0, -1.0);
        }
        weights
    }
}

/// Returns P_(n−1) and P_n at `x`, for n = [`NODES`].
fn last_two(x: f64) -> [f64; 2] {
    (1..NODES).fold([1.0, x], |pair, degree| [pair[1], next(degree, pair, x)])
}

/// Returns P_(degree + 1) from the two before.
fn next(degree: usize, pair: [f64; 2], x: f64) -> f64 {
    let degree = degree as f64;
    ((2.0 * degree + 1.0) * x * pair[1] - degree * pair[0]) / (degree + 1.0)
}

/// Returns j_0 … of an argument from [`RESOLVED`] up, for which the recursion upwards keeps ten digits.
fn spherical_bessel(x: f64) -> [f64; NODES] {
    let (sine, cosine) = x.sin_cos();
    let mut values = [sine / x; NODES];
    values[1] = sine / (x * x) - cosine / x;
    for l in 1..NODES - 1 {
        values[l + 1] = (2 * l + 1) as f64 / x * values[l] - values[l - 1];
    }
    values
}

/// A stretch of frequencies, Hz.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Panel {
    pub from: f64,
    pub to: f64,
}

impl Panel {
    /// Returns both halves.
    pub(crate) fn halves(self) -> [Self; 2] {
        let middle = 0.5 * (self.from + self.to);
        [Self { to: middle, ..self }, Self { from: middle, ..self }]
    }
}

/// Returns octaves from almost 0 to half of `rate_hz`, cut at `cuts_hz` as well. The longest span has `samples`.
pub(crate) fn octaves(rate_hz: f64, samples: f64, cuts_hz: &[f64]) -> Vec<Panel> {
    let (lowest, highest) = (LOWEST * rate_hz / samples, 0.5 * rate_hz);
    let mut cuts = vec![lowest, highest];
    let mut edge = 0.5 * highest;
    while edge > lowest {
        cuts.push(edge);
        edge *= 0.5;
    }
    cuts.extend(cuts_hz.iter().copied().filter(|cut| (lowest..highest).contains(cut)));
    cuts.sort_by(f64::total_cmp);
    // Cuts that almost coincide make no panel.
    cuts.dedup_by(|later, earlier| *later - *earlier < 1e-12 * *later);
    cuts.windows(2).map(|pair| Panel { from: pair[0], to: pair[1] }).collect()
}

/// Returns, for each span and order, one weight per node of all panels: a variance is Σ weight·density, with the
/// two-sided density in U²/Hz at the node; in the unit of the quantity, squared.
pub(crate) fn variances(rule: &Rule, panels: &[Panel], rate_hz: f64, spans: &[Span]) -> Vec<[Vec<f64>; ORDERS]> {
    let mut all: Vec<[Vec<f64>; ORDERS]> = spans.iter().map(|_| Default::default()).collect();
    for panel in panels {
        let nodes = rule.nodes(*panel);
        let plain = rule.plain(*panel);
        let angles = nodes.map(|hz| Angle::new(TAU * hz / rate_hz));
        let align = spans.first().map(|span| rule.oscillating(*panel, rate_hz, span.align));
        for (span, weights) in spans.iter().zip(&mut all) {
            let smooth = Smooth::up_to(TAU * panel.to / rate_hz, *span);
            let delays = [span.align, span.horizon, span.align + span.horizon];
            let of = |delay: f64| rule.oscillating(*panel, rate_hz, delay);
            let turning = [align.unwrap_or_default(), of(delays[1]), of(delays[2])];
            for (order, weights) in weights.iter_mut().enumerate() {
                let scale = 2.0 * rate_hz.powi(-2 * (order as i32 + 1));
                let mut terms: Vec<Term> = Vec::with_capacity(3);
                for (place, angle) in angles.iter().enumerate() {
                    angle.terms(order + 1, *span, smooth, &mut terms);
                    let mut sum = 0.0;
                    for (index, one) in terms.iter().enumerate() {
                        sum += one.amplitude.norm_sqr() * plain[place];
                        for other in &terms[index + 1..] {
                            let delay = other.delay - one.delay;
                            let known = delays.iter().position(|of| (of - delay).abs() < 0.5);
                            let turn = known.map_or(of(delay)[place], |known| turning[known][place]);
                            // The later term's own phase is e^(−iωδ).
                            sum += 2.0 * (one.amplitude.conj() * other.amplitude * turn).re;
                        }
                    }
                    weights.push(scale * sum);
                }
            }
        }
    }
    all
}

/// Returns the factor from an integral in samples to one in s: dt^order.
pub(crate) fn scale(order: usize, rate_hz: f64) -> f64 {
    rate_hz.powi(-(order as i32))
}

/// Returns an upper bound of |W|² of order 1 up to a factor, in samples²: flat up to one over the horizon, then falling
/// with the square. Higher orders have the same form.
pub(crate) fn envelope(hz: f64, rate_hz: f64, horizon: f64) -> f64 {
    (horizon * horizon).min((rate_hz / (TAU * hz)).powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::weights::listed;

    /// Returns Σ Σ w_j w_k R(j − k), term by term.
    fn direct(order: usize, span: Span, covariance: impl Fn(usize) -> f64) -> f64 {
        let weights = listed(order, span);
        let lags: Vec<f64> = (0..weights.len()).map(covariance).collect();
        let row = |j: usize| (0..weights.len()).map(|k| weights[k] * lags[j.abs_diff(k)]).sum::<f64>();
        (0..weights.len()).map(|j| weights[j] * row(j)).sum()
    }

    fn integrated(span: Span, cuts: &[f64], halvings: usize, density: impl Fn(f64) -> f64) -> [f64; ORDERS] {
        let rule = Rule::new();
        let mut panels = octaves(1.0, span.align + span.horizon, cuts);
        for _ in 0..halvings {
            panels = panels.into_iter().flat_map(Panel::halves).collect();
        }
        let weights = variances(&rule, &panels, 1.0, &[span]);
        let values: Vec<f64> = panels.iter().flat_map(|panel| rule.nodes(*panel)).map(density).collect();
        [0, 1, 2].map(|order| weights[0][order].iter().zip(&values).map(|(weight, value)| weight * value).sum())
    }

    const SPANS: [Span; 4] = [
        Span { align: 30.0, horizon: 1.0 },
        Span { align: 1.0, horizon: 400.0 },
        Span { align: 300.0, horizon: 300.0 },
        Span { align: 1200.0, horizon: 40.0 },
    ];

    #[test]
    fn variances_are_those_of_the_listed_weights() {
        for span in SPANS {
            let white = integrated(span, &[], 0, |_| 1.0);
            let walk = integrated(span, &[], 0, |hz| 0.25 / (std::f64::consts::PI * hz).sin().powi(2));
            let decay = 0.05_f64;
            let pole = (-decay).exp();
            let markov = integrated(span, &[], 1, |hz| {
                (1.0 - pole * pole) / (1.0 + pole * pole - 2.0 * pole * (TAU * hz).cos())
            });
            for order in 1..=ORDERS {
                let weights = listed(order, span);
                let square: f64 = weights.iter().map(|weight| weight * weight).sum();
                assert!((white[order - 1] / square - 1.0).abs() < 1e-7, "white {span:?} {order}");
                let mut sum = 0.0;
                let later = weights.iter().rev().map(|weight| {
                    sum += weight;
                    sum * sum
                });
                let cumulated: f64 = later.sum();
                assert!((walk[order - 1] / cumulated - 1.0).abs() < 1e-7, "walk {span:?} {order}");
                let expected = direct(order, span, |lag| (-decay * lag as f64).exp());
                assert!((markov[order - 1] / expected - 1.0).abs() < 1e-6, "Gauss–Markov {span:?} {order}");
            }
        }
    }

    #[test]
    fn a_line_narrower_than_one_over_the_span_is_integrated() {
        let (width, centre) = (1e-4, 0.11);
        let lorentzian = |off: f64| {
            let decay = std::f64::consts::PI * width;
            let pole = (-decay).exp();
            (1.0 - pole * pole) / ((1.0 - pole).powi(2) + 4.0 * pole * (std::f64::consts::PI * off).sin().powi(2))
        };
        // Cut closer and closer to the centre.
        let cuts: Vec<f64> = (0..14)
            .flat_map(|k| [centre - 0.03 * 0.5_f64.powi(k), centre + 0.03 * 0.5_f64.powi(k)])
            .chain([centre])
            .collect();
        for span in SPANS {
            let found = integrated(span, &cuts, 0, |hz| 0.5 * (lorentzian(hz - centre) + lorentzian(hz + centre)));
            for order in 1..=ORDERS {
                let covariance = |lag: usize| {
                    let lag = lag as f64;
                    (-std::f64::consts::PI * width * lag).exp() * (TAU * centre * lag).cos()
                };
                let expected = direct(order, span, covariance);
                assert!((found[order - 1] / expected - 1.0).abs() < 1e-5, "{span:?} {order}: {found:?} {expected}");
            }
        }
    }
}
