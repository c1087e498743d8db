//! Bandwidth: which filter, if any, lies between the noise and the samples.
//!
//! If the plain law misfits, a moving average and low passes compete with it by likelihood, each with and without white
//! noise behind it. If none of them describes the spectrum, a smooth shape describes it up to as high a frequency as
//! possible. A known sampling (a boxcar and a decimation) is not a candidate but part of the law.
//!
//! # Validation
//! `tests::filters` has small cases; `examples/noise_worlds.rs` is the large form, with its table in
//! docs/validation.md.

use super::choice::{Choice, PLAIN, SIGNIFICANT, choose};
use super::likelihood::{BEHIND, FineBins, Held, Likelihood, Model, SIGMA};
use super::residual::{MISFIT, Residual};
use super::shape::{Gains, Shape, TILTS, boxcar};
use super::sums::DstSums;
use crate::fit::{Bandwidth, Term};

/// Candidate windows of moving averages.
const WINDOWS: std::ops::RangeInclusive<u32> = 2..=32;
/// Candidate orders of low passes.
const ORDERS: std::ops::RangeInclusive<u32> = 1..=4;
/// Number of moving averages that are examined closely.
const CLOSELY: usize = 2;
/// Cutoffs at which a search begins, cycles per sample.
const CUTOFFS: [f64; 6] = [0.02, 0.05, 0.1, 0.2, 0.3, 0.42];
/// Filters extend at least to this frequency, cycles per sample: a sensor does not send samples 125 times as often as
/// they change.
const LOWEST: f64 = 0.004;
/// A shape has to improve 2 log L by this beyond its price, in units of the plain law's misfit.
const PLAINLY: f64 = 10.0;
/// A shape whose score is worse by less than this is a rival: white noise behind a filter that was not worth its price
/// still changes N.
const RIVALS: f64 = 9.0;
/// Maximum number of times that slopes are computed again.
const ROUNDS: usize = 24;

/// How the samples were made, if known: the sensor takes the mean of `window` samples at its internal rate.
#[derive(Debug, Clone, PartialEq)]
pub struct Sampling {
    /// Rate at which the sensor samples, Hz.
    pub internal_rate_hz: f64,
    /// Samples per mean; 0 and 1 are no averaging.
    pub window: u32,
    /// The source of this knowledge, for the document: `register 85`, `option`.
    pub source: String,
}

impl Sampling {
    /// Returns the number of internal samples per output sample; `None` if the rates are not multiples of each other,
    /// to 1 in 1,000.
    pub fn every(&self, rate_hz: f64) -> Option<u32> {
        let ratio = self.internal_rate_hz / rate_hz;
        let whole = ratio.round();
        ((ratio - whole).abs() <= 1e-3 * whole && (1.0..=1e5).contains(&whole)).then_some(whole as u32)
    }

    fn shape(&self, rate_hz: f64) -> Option<Shape> {
        Some(Shape::Decimated { window: self.window.max(1), every: self.every(rate_hz)? })
    }

    /// Returns the document's description of the sampling.
    pub(crate) fn bandwidth(&self) -> Bandwidth {
        Bandwidth {
            kind: "moving_average".to_owned(),
            value: Some(f64::from(self.window)),
            unit: "samples at the internal rate".to_owned(),
            order: None,
            ci95: None,
            up_to_hz: None,
            white_behind: None,
            internal_rate_hz: Some(self.internal_rate_hz),
            exponential: false,
            source: self.source.clone(),
        }
    }

    /// Returns the filter if it colours white noise.
    pub(crate) fn filter(&self, rate_hz: f64) -> Option<Filter> {
        self.shape(rate_hz).filter(colours_white).map(|shape| Filter { shape })
    }

    /// Returns the factor from the sensor's own white density to that of the samples at low frequencies: √Σ|H(kR)|²
    /// over the images k of the output rate R. `None` if the rates do not fit.
    pub fn density_factor(&self, rate_hz: f64) -> Option<f64> {
        Some(density_factor(self.window, self.every(rate_hz)?))
    }
}

/// Returns the factor from the white density of a sequence to that, at low frequencies, of every `every`th mean of
/// `window` of its samples: √Σ|H|² over the images that fold onto zero. For windows no longer than `every`, this is
/// √(every / window).
pub fn density_factor(window: u32, every: u32) -> f64 {
    (0..every).map(|image| boxcar(window, f64::from(image) / f64::from(every))).sum::<f64>().sqrt()
}

/// Returns whether white noise behind the shape is no longer white.
fn colours_white(shape: &Shape) -> bool {
    (1..=64).any(|at| (shape.gains(f64::from(at) / 128.0).white - 1.0).abs() > 1e-6)
}

/// A known filter and its effect on each term, for fits to Allan variances.
#[derive(Debug, Clone)]
pub(crate) struct Filter {
    shape: Shape,
}

impl Filter {
    fn gain_of(term: Term) -> fn(Gains) -> f64 {
        match term {
            Term::N | Term::Q => |gains| gains.white,
            Term::B => |gains| gains.flicker,
            Term::K => |gains| gains.walk,
            // Deterministic: the ramp passes.
            Term::R => |_| 1.0,
        }
    }

    /// Returns the power gain at u cycles per sample.
    pub(crate) fn gain(&self, term: Term, u: f64) -> f64 {
        Self::gain_of(term)(self.shape.gains(u))
    }

    /// Returns the part of the Allan variance that the filter leaves at averaging factors.
    pub(crate) fn ratios(&self, term: Term, factors: &[usize], dt_s: f64) -> Vec<f64> {
        match term {
            Term::R => vec![1.0; factors.len()],
            _ => variance_ratios(&self.shape, factors, Self::gain_of(term), |u| term.spectrum(u, dt_s)),
        }
    }
}

/// Returns the law with which a fit begins: the plain one, or that of the known sampling if it shapes white noise.
pub(super) fn basic(
    sums: &DstSums,
    rate_hz: f64,
    excluded_bands_hz: &[[f64; 2]],
    sampling: Option<&Sampling>,
) -> Likelihood {
    match sampling.and_then(|sampling| sampling.shape(rate_hz)).filter(colours_white) {
        Some(shape) => Likelihood::filtered(&FineBins::new(sums, rate_hz, excluded_bands_hz), &shape, false),
        None => Likelihood::new(sums, rate_hz, excluded_bands_hz),
    }
}

/// Returns a better law than `basic` if that misfits and a better one exists. A known sampling is abandoned only for a
/// law that describes the record.
pub(super) fn compete(
    sums: &DstSums,
    rate_hz: f64,
    excluded_bands_hz: &[[f64; 2]],
    shape: &Shape,
    basic: &Choice,
) -> Option<Law> {
    let misfits = basic.residual.is_some_and(|residual| residual.p_value < MISFIT);
    if !misfits && !is_filter(basic, rate_hz) {
        return None;
    }
    // The first-order filter with the spectrum of the process: a search that starts far from it may end elsewhere.
    let process =
        basic.model.terms.has_gauss_markov().then(|| 1.0 / (std::f64::consts::TAU * rate_hz * basic.model.tc_s));
    let search = Search { bins: FineBins::new(sums, rate_hz, excluded_bands_hz), process };
    let known = search.of(shape, false, f64::INFINITY)?;
    let (best, rivals) = search.best()?;
    let widen = Residual::widen(Residual::of(&known.likelihood, &known.model));
    let gain = (known.score() - best.score()) / (widen * widen);
    let chosen = |candidate: Candidate| {
        let choice = choose(&candidate.likelihood).filter(|choice| is_behind(&choice.model))?;
        Some((choice, candidate.likelihood))
    };
    let described = |choice: &Choice| choice.residual.is_some_and(|residual| residual.p_value >= MISFIT);
    match (gain > PLAINLY).then(|| chosen(best)).flatten() {
        Some((choice, likelihood)) if described(&choice) => {
            let rivals = rivals.into_iter().filter_map(chosen).filter(|(choice, _)| described(choice));
            Some(Law { likelihood, choice, rivals: rivals.map(|(choice, likelihood)| (likelihood, choice)).collect() })
        }
        _ if *shape != Shape::Open => None,
        other => {
            let smooth = search.smooth(basic.residual).filter(|(_, choice)| described(choice));
            let (likelihood, choice) = smooth.or(other.map(|(choice, likelihood)| (likelihood, choice)))?;
            Some(Law { likelihood, choice, rivals: Vec::new() })
        }
    }
}

/// A law with its filter, and the laws that describe the record nearly as well: their values of N are not excluded.
pub(super) struct Law {
    pub(super) likelihood: Likelihood,
    pub(super) choice: Choice,
    pub(super) rivals: Vec<(Likelihood, Choice)>,
}

/// Returns whether the white noise behind the filter, which is a part of the plateau, is at most half of it. If it is
/// more, the shape is not a filter, but looks like the skirt of a vibration.
fn is_behind(model: &Model) -> bool {
    2.0 * model.squares[BEHIND] <= model.squares[0]
}

/// Returns whether a law has a Gauss–Markov process that may be white noise behind a low pass of first order, which has
/// the same spectrum: either there is hardly any white noise beside it, or it is as short as that of a filter and makes
/// most of the plateau.
fn is_filter(choice: &Choice, rate_hz: f64) -> bool {
    /// White noise is at most this share of the process at half the rate.
    const SHARE: f64 = 0.1;
    let Model { terms, squares, tc_s, .. } = choice.model;
    let decay = 1.0 / (rate_hz * tc_s);
    // At half the rate over dt: σ² (1 − φ)/(1 + φ).
    let process = squares[SIGMA] * (0.5 * decay).tanh();
    let is_all = squares[0] * rate_hz < SHARE * process;
    // At low frequencies: σ² · 2 Tc.
    let is_short = std::f64::consts::TAU * LOWEST * rate_hz * tc_s < 1.0;
    let is_most = is_short && squares[0] < 2.0 * squares[SIGMA] * tc_s;
    terms.has_gauss_markov() && (is_all || is_most)
}

/// A shape with its best model.
struct Candidate {
    likelihood: Likelihood,
    model: Model,
    price: f64,
}

impl Candidate {
    fn score(&self) -> f64 {
        self.model.deviance + self.price
    }
}

struct Search {
    bins: FineBins,
    /// Cutoff of a first-order filter to try, cycles per sample.
    process: Option<f64>,
}

impl Search {
    /// Returns the best N, B and K under a shape whose numbers are fitted.
    ///
    /// The slope of a low pass of first order is so gentle that flicker may permanently take its place. The search
    /// therefore also starts from the shape fitted with white noise alone.
    ///
    /// `best` is the score of another shape. `None` if this one will not come near it.
    fn of(&self, shape: &Shape, behind: bool, best: f64) -> Option<Candidate> {
        let gentle = matches!(shape, Shape::Butterworth { order: 1, .. } | Shape::Exponential { .. });
        let from_white = gentle.then(|| self.from(shape, behind, 4, best)).flatten();
        let all = self.from(shape, behind, 0, best).into_iter().chain(from_white);
        all.min_by(|a, b| a.score().total_cmp(&b.score()))
    }

    /// Fits as [`Self::of`] does, starting from this shape, with white noise alone in the first rounds.
    fn from(&self, shape: &Shape, behind: bool, white: usize, best: f64) -> Option<Candidate> {
        /// The remaining gain of further rounds is less than this multiple of the last gain.
        const STILL: f64 = 20.0;
        /// The best numbers are within this distance.
        const NEAR: f64 = 0.1;
        let mut shape = shape.clone();
        let mut last: Option<Model> = None;
        for round in 0..ROUNDS {
            let likelihood = Likelihood::filtered(&self.bins, &shape, behind);
            let terms = likelihood.least_terms();
            let terms = if round < white { terms } else { terms.with(Term::B).with(Term::K) };
            let start = last.map(|model| Model { tilt: [0.0; TILTS], ..model });
            let model = likelihood.maximise(terms, 1.0, Held::Nothing, start.as_ref())?;
            let moved = model.tilt.iter().fold(0.0f64, |most, by| most.max(by.abs()));
            if (moved < 1e-3 && round >= white) || round + 1 == ROUNDS {
                if !is_behind(&model) {
                    return None;
                }
                // A spectrum that falls off at frequencies at which no sensor's output does is rejected too: a slow
                // motion looks like that.
                if shape.gains(LOWEST).white < 0.5 {
                    return None;
                }
                let price = price(&shape, behind);
                return Some(Candidate { likelihood, model, price });
            }
            // Far from its best numbers, a shape gains little at first and much later.
            let gained = last.filter(|_| round > white && moved < NEAR).map(|last| last.deviance - model.deviance);
            if gained.is_some_and(|gained| gained >= 0.0 && model.deviance - STILL * gained > best + RIVALS) {
                return None;
            }
            shape = shape.moved(&model.tilt);
            last = Some(model);
        }
        None
    }

    /// Returns the best of the named shapes, and its rivals.
    fn best(&self) -> Option<(Candidate, Vec<Candidate>)> {
        let mut all: Vec<Candidate> = Vec::new();
        for (shape, behind) in self.shapes().iter().flat_map(|shape| [(shape, false), (shape, true)]) {
            let best = all.iter().map(Candidate::score).fold(f64::INFINITY, f64::min);
            all.extend(self.of(shape, behind, best));
        }
        all.sort_by(|a, b| a.score().total_cmp(&b.score()));
        let mut all = all.into_iter();
        let best = all.next()?;
        let most = best.score() + RIVALS;
        Some((best, all.take_while(|other| other.score() < most).collect()))
    }

    /// Returns the named shapes that are worth a closer examination.
    fn shapes(&self) -> Vec<Shape> {
        // Each shape with white noise behind it, which includes the one without; the best few are examined closely.
        let glance = |shape: Shape| {
            let likelihood = Likelihood::filtered(&self.bins, &shape, true);
            let terms = likelihood.least_terms().with(Term::B).with(Term::K);
            let model = likelihood.maximise(terms, 1.0, Held::Nothing, None)?;
            Some((model.deviance, shape.moved(&model.tilt)))
        };
        let mut windows: Vec<(f64, Shape)> =
            WINDOWS.filter_map(|window| glance(Shape::MovingAverage(window))).collect();
        windows.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut shapes: Vec<Shape> = windows.into_iter().take(CLOSELY).map(|(_, shape)| shape).collect();
        let second_order = CUTOFFS.iter().filter_map(|cutoff| glance(Shape::Butterworth { order: 2, cutoff: *cutoff }));
        if let Some((_, Shape::Butterworth { cutoff, .. })) = second_order.min_by(|a, b| a.0.total_cmp(&b.0)) {
            shapes.extend(ORDERS.map(|order| Shape::Butterworth { order, cutoff }));
            shapes.push(Shape::Exponential { cutoff });
        }
        let first_order = |cutoff: f64| [Shape::Exponential { cutoff }, Shape::Butterworth { order: 1, cutoff }];
        shapes.extend(self.process.into_iter().flat_map(first_order));
        shapes
    }

    /// Returns a smooth shape over as much of the band as it describes; `plain` is the residual of the law without one.
    ///
    /// In one of a thousand records, the plain law misfits by chance. A shape then has to be worth as much as a named
    /// one.
    fn smooth(&self, plain: Option<Residual>) -> Option<(Likelihood, Choice)> {
        /// A p-value below this is not due to chance.
        const BEYOND_CHANCE: f64 = 1e-6;
        let is_chance = plain.is_none_or(|plain| plain.p_value > BEYOND_CHANCE);
        /// A shape describes a band if the p-value is at least this: a shape that nearly misfits already changes N.
        const DESCRIBED: f64 = 0.05;
        /// Candidate ends of the band, cycles per sample.
        const ENDS: [f64; 8] = [0.5, 0.42, 0.34, 0.26, 0.18, 0.12, 0.08, 0.05];
        for up_to in ENDS {
            let mut best: Option<Candidate> = None;
            for degree in 1..=TILTS {
                let start = best.as_ref().map_or(&[][..], |best| match best.likelihood.shape() {
                    Shape::Smooth { coefficients, .. } => coefficients,
                    _ => &[],
                });
                let mut coefficients = start.to_vec();
                coefficients.resize(degree, 0.0);
                let Some(found) = self.of(&Shape::Smooth { coefficients, up_to }, false, f64::INFINITY) else {
                    continue;
                };
                if best.as_ref().is_none_or(|best| found.score() < best.score()) {
                    best = Some(found);
                }
            }
            let Some(best) = best else { continue };
            // The change by the next coefficient is part of the error, so that the coefficient is kept.
            let finer = match best.likelihood.shape() {
                Shape::Smooth { coefficients, .. } if coefficients.len() < TILTS => {
                    let coefficients = coefficients.iter().copied().chain([0.0]).collect();
                    self.of(&Shape::Smooth { coefficients, up_to }, false, f64::INFINITY)
                }
                _ => None,
            };
            let open = self.of(&Shape::Smooth { coefficients: Vec::new(), up_to }, false, f64::INFINITY);
            let is_significant = open.is_none_or(|open| open.score() - best.score() > PLAINLY);
            if is_chance && !is_significant {
                continue;
            }
            let best = finer.unwrap_or(best);
            let residual = Residual::of(&best.likelihood, &best.model);
            if residual.is_some_and(|residual| residual.p_value >= DESCRIBED)
                && let Some(choice) = choose(&best.likelihood)
            {
                return Some((best.likelihood, choice));
            }
        }
        None
    }
}

/// Returns the gain that a shape needs in 2 log L.
fn price(shape: &Shape, behind: bool) -> f64 {
    let windows = 2.0 * f64::from(WINDOWS.end() - WINDOWS.start() + 1).ln();
    let own = match shape {
        Shape::Open | Shape::Decimated { .. } => 0.0,
        // One of many. Low passes come close to any of them, with one more free number.
        Shape::MovingAverage(_) => windows,
        Shape::Butterworth { .. } | Shape::Exponential { .. } => windows + SIGNIFICANT + 2.0 * 5f64.ln(),
        Shape::Smooth { coefficients, .. } => SIGNIFICANT * coefficients.len() as f64,
    };
    own + if behind { PLAIN } else { 0.0 }
}

/// Returns the document's description of the shape under which `choice` was made; `None` if noise is white up to half
/// the rate.
pub(super) fn statement(
    likelihood: &Likelihood,
    choice: &Choice,
    rate_hz: f64,
    sampling: Option<&Sampling>,
) -> Option<Bandwidth> {
    let model = &choice.model;
    let shape = likelihood.shape().moved(&model.tilt);
    let behind = model.squares[BEHIND].sqrt();
    let white_behind = (behind > 0.0).then_some(behind);
    let of = |kind: &str, value: Option<f64>, order: Option<u32>| Bandwidth {
        kind: kind.to_owned(),
        value,
        unit: if kind == "moving_average" { "samples" } else { "Hz" }.to_owned(),
        order,
        ci95: None,
        up_to_hz: None,
        white_behind,
        internal_rate_hz: None,
        exponential: false,
        source: "fitted".to_owned(),
    };
    match shape {
        Shape::Open => None,
        Shape::Decimated { .. } => sampling.map(Sampling::bandwidth),
        Shape::MovingAverage(window) => Some(of("moving_average", Some(f64::from(window)), None)),
        Shape::Butterworth { order, cutoff } => {
            let ci95 = interval(likelihood, choice).and_then(|ends| below_half(ends.map(|end| end * cutoff), rate_hz));
            Some(Bandwidth { ci95, ..of("low_pass", Some(cutoff * rate_hz), Some(order)) })
        }
        Shape::Exponential { cutoff } => {
            let ci95 = interval(likelihood, choice).and_then(|ends| below_half(ends.map(|end| end * cutoff), rate_hz));
            Some(Bandwidth { ci95, exponential: true, ..of("low_pass", Some(cutoff * rate_hz), Some(1)) })
        }
        Shape::Smooth { up_to, .. } => {
            let half = (1..=1000).map(|at| up_to * f64::from(at) / 1000.0).find(|u| shape.gains(*u).white < 0.5);
            let up_to_hz = (up_to < 0.5).then_some(up_to * rate_hz);
            Some(Bandwidth { up_to_hz, ..of("other", half.map(|u| u * rate_hz), None) })
        }
    }
}

/// Returns an interval of cutoffs in Hz; `None` if it reaches half the rate, where shapes no longer act as filters.
fn below_half(ends: [f64; 2], rate_hz: f64) -> Option<[f64; 2]> {
    (ends[1] < 0.5).then_some(ends.map(|end| end * rate_hz))
}

/// Returns the 95 % interval of a cutoff over its value, by its profile likelihood.
fn interval(likelihood: &Likelihood, choice: &Choice) -> Option<[f64; 2]> {
    const CHI2: f64 = 3.841_459;
    let model = &choice.model;
    let widen = Residual::widen(choice.residual);
    let rises = |by: f64| {
        let held = Held::Tilt(0, model.tilt[0] + by);
        let held = likelihood.maximise(model.terms, model.tc_s, held, Some(model))?;
        Some(held.deviance - model.deviance > CHI2 * widen * widen)
    };
    let end = |sign: f64| {
        let (mut inside, mut outside) = (0.0, 1e-3);
        while !rises(sign * outside)? {
            (inside, outside) = (outside, 2.0 * outside);
            if outside > 4.0 {
                return None;
            }
        }
        for _ in 0..12 {
            let middle = 0.5 * (inside + outside);
            if rises(sign * middle)? {
                outside = middle;
            } else {
                inside = middle;
            }
        }
        Some((sign * outside).exp())
    };
    Some([end(-1.0)?, end(1.0)?])
}

/// Returns, for every octave of `factors`, the ratio of the Allan variance at averaging factor `m` with the filter to
/// that without, for a term of two-sided spectrum `spectrum`(u) (1 for white noise).
pub(super) fn variance_ratios(
    shape: &Shape,
    factors: &[usize],
    gain: fn(Gains) -> f64,
    spectrum: impl Fn(f64) -> f64,
) -> Vec<f64> {
    /// Up to this factor by quadrature; beyond it, the part that a filter removes falls with m.
    const EXACT: usize = 256;
    const POINTS: u32 = 16_384;
    let grid: Vec<(f64, f64, f64)> = (0..POINTS)
        .map(|point| 0.5 * (f64::from(point) + 0.5) / f64::from(POINTS))
        .map(|u| {
            let open = spectrum(u);
            (u, open, open * gain(shape.gains(u)))
        })
        .collect();
    let exact = |m: usize| {
        let (open, filtered) = grid.iter().fold((0.0, 0.0), |(open, filtered), (u, one, other)| {
            let response = crate::fit::response(m, *u);
            (open + one * response, filtered + other * response)
        });
        filtered / open
    };
    let last = exact(EXACT);
    factors
        .iter()
        .map(|m| if *m <= EXACT { exact(*m) } else { 1.0 + (last - 1.0) * EXACT as f64 / *m as f64 })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::{DstEstimator, Transform};
    use super::*;
    use crate::allan::FixedPoint;
    use rand::SeedableRng as _;
    use rand_distr::{Distribution as _, StandardNormal};

    /// Abandoned shapes would not have come near the best one.
    #[test]
    fn what_is_given_up_is_no_rival() {
        let fir = [1.0, 3.0, 6.0, 3.0, 1.0].map(|tap| tap / 14.0);
        let worlds = [(&[0.25; 4][..], 1.0), (&[1.0], 0.4), (&fir, 1.0), (&[0.5; 2], 0.1)];
        for (seed, ((taps, a), behind)) in
            (0..).zip(worlds.into_iter().flat_map(|world| [0.0, 0.3].map(|behind| (world, behind))))
        {
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let white: Vec<f64> = (0..60_000).map(|_| StandardNormal.sample(&mut rng)).collect();
            let mut y = 0.0;
            let smooth = |of: &[f64]| {
                y += a * (of.iter().zip(taps).map(|(x, tap)| x * tap).sum::<f64>() - y);
                y
            };
            let filtered: Vec<f64> = white.windows(taps.len()).map(smooth).collect();
            let with_behind = |y: &f64| {
                let unit: f64 = StandardNormal.sample(&mut rng);
                y + behind * unit
            };
            let samples: Vec<f64> = filtered.iter().map(with_behind).collect();
            let (mut estimator, mut transform) =
                (DstEstimator::new(FixedPoint::for_range(1, 6).unwrap()), Transform::new());
            estimator.push(&mut transform, &samples);
            estimator.break_segment(&mut transform);
            let search =
                Search { bins: FineBins::new(&estimator.into_sums(&mut transform), 100.0, &[]), process: None };
            let shapes = search.shapes();
            let all =
                shapes.iter().flat_map(|shape| [false, true].map(|behind| search.of(shape, behind, f64::INFINITY)));
            let mut scores: Vec<f64> = all.flatten().map(|candidate| candidate.score()).collect();
            scores.sort_by(f64::total_cmp);
            let near = scores.iter().filter(|score| **score < scores[0] + RIVALS).count();
            let (best, rivals) = search.best().unwrap();
            assert_eq!((best.score(), rivals.len() + 1), (scores[0], near), "{taps:?} {a}");
            assert!(scores.len() > near, "{scores:?}");
        }
    }
}
