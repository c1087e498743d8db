//! The law: the spectrum of a channel under a model, with its parameters at the maximum of the likelihood.
//!
//! All quantities here are in the channel's own scale and per sample: power is U²·rate of a two-sided density, and U is a unit in
//! which the white part is about 1.

use super::dot::dot;
use super::grid::{Grid, Narrow};
use imu_model::effects::{
    Effect, EffectKind, Frequencies, GaussMarkov, LowPass, MovingAverage, QuantizationNoise, Resonance,
};
use nalgebra::{DMatrix, DVector};

/// An effect that shapes a spectrum, without the numbers that a fit may change.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum Shape {
    /// ln Q² (per sample).
    QuantizationNoise,
    /// ln σ², ln Tc/s.
    GaussMarkov,
    /// ln σ², frequency/Hz, ln bandwidth/Hz; asymmetry over the largest possible one, if it is not 0.
    Resonance,
    /// ln cutoff/Hz, ln of the white noise after it over the white noise before it.
    LowPass(u64),
    /// ln of the white noise after it over the white noise before it.
    MovingAverage(u64),
    /// A density that falls as a power of the frequency: ln of it (per sample) at [`Shape::MIDDLE`] of the rate, exponent; which
    /// of [`Shape::SLOPES`].
    Slope(usize),
}

impl Shape {
    /// Exponents between those of white noise, flicker and random walk, and beyond.
    pub const SLOPES: [(f64, f64); 3] = [(0.3, 0.8), (1.25, 1.75), (2.2, 3.5)];
    /// Exponents that noise of a power law may have. At the ends of the searched range, the cause is another effect,
    /// usually a drift.
    pub(super) const POWER_LAW: std::ops::Range<f64> = 0.31..2.49;
    /// How many numbers a symmetric narrow band has.
    pub(super) const SYMMETRIC: usize = 3;
    /// Nats that an asymmetry has to gain.
    pub(super) const LEANING: f64 = 4.0;
    /// The frequency at which a slope's density is given, over the rate.
    pub(super) const MIDDLE: f64 = 0.01;
}

/// One spectral effect in a law.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Term {
    /// Its kind.
    pub shape: Shape,
    /// Its numbers, in the order that [`Shape`] states.
    pub numbers: Vec<f64>,
}

impl Term {
    /// Returns the term of a spectral effect of a model; `None` if the effect shapes no spectrum.
    ///
    /// `scale`: U per unit of the series; `white`: N of the channel, U/√Hz.
    pub(super) fn of(effect: &dyn Effect, scale: f64, white: f64, rate_hz: f64) -> Option<Self> {
        let number = |name: &str| effect.number(name);
        let level = |value: f64| 2.0 * (value / scale).max(f64::MIN_POSITIVE).ln();
        let behind = || {
            let share = number("white_behind").unwrap_or_default() / white.max(f64::MIN_POSITIVE);
            (2.0 * share.max(f64::MIN_POSITIVE).ln()).clamp(FLOOR.0, FLOOR.1)
        };
        let whole = |name: &str| number(name).map(|value| value as u64);
        let (shape, numbers) = match effect.kind() {
            EffectKind::QuantizationNoise => (Shape::QuantizationNoise, vec![level(number("Q")?)]),
            EffectKind::GaussMarkov => (Shape::GaussMarkov, vec![level(number("sigma")?), number("tc_s")?.ln()]),
            EffectKind::Resonance => {
                let (frequency_hz, bandwidth_hz) = (number("frequency_hz")?, number("bandwidth_hz")?);
                let most = Resonance::new(frequency_hz, bandwidth_hz, 1.0).most_asymmetric(rate_hz);
                let asymmetry = number("asymmetry").filter(|asymmetry| *asymmetry != 0.0).map(|of| of / most);
                let numbers = [level(number("sigma")?), frequency_hz, bandwidth_hz.ln()];
                (Shape::Resonance, numbers.into_iter().chain(asymmetry).collect())
            }
            EffectKind::PowerLaw => {
                let alpha = number("alpha")?;
                let which = Shape::SLOPES.iter().position(|(low, high)| (*low..=*high).contains(&alpha))?;
                let density = effect.psd(Shape::MIDDLE * rate_hz, rate_hz)?;
                (Shape::Slope(which), vec![level((density * rate_hz).sqrt()), alpha])
            }
            EffectKind::LowPass => (Shape::LowPass(whole("order")?), vec![number("cutoff_hz")?.ln(), behind()]),
            EffectKind::MovingAverage => (Shape::MovingAverage(whole("window")?), vec![behind()]),
            _ => return None,
        };
        Some(Self { shape, numbers })
    }

    /// Returns the frequencies at which the term's spectrum is narrow.
    pub(super) fn narrow(&self, rate_hz: f64) -> Vec<Narrow> {
        const NOTCH: f64 = 1e-3;
        match self.shape {
            Shape::Resonance => vec![Narrow { frequency_hz: self.at(1), width_hz: self.at(2).exp() }],
            // A boxcar's spectrum is narrow at its notches.
            Shape::MovingAverage(window) => (1..=window / 2)
                .map(|order| Narrow { frequency_hz: order as f64 * rate_hz / window as f64, width_hz: NOTCH * rate_hz })
                .collect(),
            // A Butterworth filter made by the bilinear transform has a zero of several orders at half the rate: bins are narrow
            // over the distance from it.
            Shape::LowPass(_) => [0.1 * NOTCH, NOTCH]
                .map(|part| Narrow { frequency_hz: 0.5 * rate_hz, width_hz: part * rate_hz })
                .to_vec(),
            _ => Vec::new(),
        }
    }

    /// Returns one of the numbers; 0 if the term has fewer.
    pub(super) fn at(&self, index: usize) -> f64 {
        self.numbers.get(index).copied().unwrap_or_default()
    }

    /// Returns the effect in the channel's scale, without the noise behind a filter. `None` for a slope, which depends
    /// on the rate.
    pub(super) fn effect(&self, rate_hz: f64) -> Option<Box<dyn Effect>> {
        let at = |index: usize| self.at(index);
        Some(match self.shape {
            Shape::QuantizationNoise => Box::new(QuantizationNoise { q: (0.5 * at(0)).exp() }),
            Shape::GaussMarkov => Box::new(GaussMarkov { sigma: (0.5 * at(0)).exp(), tc_s: at(1).exp() }),
            Shape::Resonance => {
                let line = Resonance::new(at(1), at(2).exp(), (0.5 * at(0)).exp());
                Box::new(Resonance { asymmetry: at(3) * line.most_asymmetric(rate_hz), ..line })
            }
            Shape::LowPass(order) => Box::new(LowPass::new(at(0).exp(), order)),
            Shape::MovingAverage(window) => Box::new(MovingAverage::new(window)),
            Shape::Slope(_) => return None,
        })
    }

    /// Returns whether the term adds noise with a correlation time.
    pub(super) fn adds(&self) -> bool {
        matches!(self.shape, Shape::GaussMarkov | Shape::Resonance | Shape::Slope(_))
    }

    /// Returns the power per sample that the term adds at each frequency.
    pub(super) fn added(&self, frequencies: &Frequencies) -> Vec<f64> {
        let rate_hz = frequencies.rate_hz();
        match self.effect(rate_hz) {
            Some(effect) => effect.densities(frequencies).into_iter().map(|density| rate_hz * density).collect(),
            None => {
                let (level, exponent) = (self.at(0), self.at(1));
                frequencies
                    .hz()
                    .iter()
                    .map(|f| (level - exponent * (f / (Shape::MIDDLE * rate_hz)).ln()).exp())
                    .collect()
            }
        }
    }

    /// Returns the power gain at each frequency.
    pub(super) fn gains(&self, frequencies: &Frequencies) -> Vec<f64> {
        let none = || vec![1.0; frequencies.hz().len()];
        self.effect(frequencies.rate_hz()).map_or_else(none, |effect| effect.power_gains(frequencies))
    }

    /// Returns the index of the number that is the logarithm of a power that the term adds, or of the white noise after
    /// a filter.
    fn level(&self) -> usize {
        match self.shape {
            Shape::LowPass(_) => 1,
            _ => 0,
        }
    }

    /// Returns a filter's ratio of the power of the white noise behind it to that of the white noise before it.
    pub(super) fn floor(&self) -> Option<f64> {
        self.is_filter().then(|| self.at(self.level()).exp())
    }

    pub(super) fn is_filter(&self) -> bool {
        matches!(self.shape, Shape::LowPass(_) | Shape::MovingAverage(_))
    }

    /// Returns the samples that a filter reaches; 0 for other terms.
    pub(super) fn reach(&self, rate_hz: f64) -> usize {
        self.effect(rate_hz).filter(|_| self.is_filter()).map_or(0, |effect| reach(&*effect, rate_hz))
    }

    /// Returns the ranges of the term's numbers, for a record of `samples` at `rate_hz`.
    fn ranges(&self, samples: usize, rate_hz: f64) -> Vec<(f64, f64)> {
        let level = (-16.0, 24.0);
        let longest = (samples as f64 / rate_hz / 6.0).ln();
        match self.shape {
            // Q² belongs to an angle: it is about 1/rate² of that of a rate.
            Shape::QuantizationNoise => vec![(level.0 - 2.0 * rate_hz.ln(), 24.0)],
            Shape::GaussMarkov => vec![level, ((1.5 / rate_hz).ln(), longest.max((12.0 / rate_hz).ln()))],
            Shape::Resonance => {
                let width = ((2.0 * rate_hz / samples as f64).max(1e-4 * rate_hz).ln(), (0.15 * rate_hz).ln());
                let mut ranges = vec![level, (0.002 * rate_hz, 0.4999 * rate_hz), width, ASYMMETRY];
                ranges.truncate(self.numbers.len());
                ranges
            }
            Shape::LowPass(_) => vec![((0.01 * rate_hz).ln(), (0.4999 * rate_hz).ln()), FLOOR],
            Shape::MovingAverage(_) => vec![FLOOR],
            Shape::Slope(which) => vec![level, Shape::SLOPES[which.min(2)]],
        }
    }
}

/// Returns the number of samples for which an input of a filter lasts behind it.
pub(crate) fn reach(filter: &dyn Effect, rate_hz: f64) -> usize {
    let window = filter.number("window").or(filter.number("cutoff_hz").map(|cutoff_hz| rate_hz / cutoff_hz));
    window.map_or(0, |samples| samples.ceil() as usize)
}

/// The spectra of N, B and K of 1 (in the channel's scale) and of the model's own effects in each bin.
#[derive(Debug, Clone, PartialEq)]
pub struct Base {
    /// White, flicker, random walk.
    pub shapes: [Vec<f64>; 3],
    /// The model's other noise, before [`Base::gain`]'s filters.
    pub known: Vec<f64>,
    /// Noise that acts after all other stages, such as rounding.
    pub after: Vec<f64>,
    /// The largest power per sample that may be present behind the model's filters and that the model does not state; 0 if it has
    /// no filters.
    pub quiet_max: f64,
    /// Power gain of the model's own filters.
    pub gain: Vec<f64>,
    /// The power gain of those filters that the shapes already include.
    pub passed: Vec<f64>,
}

/// The prior belief about ln N², ln B² and ln K²: centre and standard deviation; `None` allows any value.
pub type Priors = [Option<(f64, f64)>; 3];

/// The levels have no prior.
pub(super) const FREE: Priors = [None, None, None];

/// A channel's spectrum as numbers.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Law {
    /// ln N², ln B², ln K² per sample.
    pub levels: [f64; 3],
    /// Other effects.
    pub terms: Vec<Term>,
    /// Power per sample behind the model's filters that the model does not state: numbers are rounded, and records end.
    /// It is at most [`Base::quiet_max`]. Each fit finds it.
    pub quiet: f64,
}

/// A law at the maximum of its likelihood.
#[derive(Debug, Clone, serde::Serialize, serde::Deserialize)]
pub struct Fitted {
    /// The law.
    pub law: Law,
    /// ln of the density, nats, without the priors' part and −½ln 2π per coefficient.
    pub log_likelihood: f64,
    /// The log likelihood with the priors' part.
    pub log_posterior: f64,
    /// Covariance of the numbers: of the levels, then of each term. `None` if it is singular.
    pub covariance: Option<DMatrix<f64>>,
    /// ln of the spectrum in each bin.
    pub logarithms: Vec<f64>,
}

impl Fitted {
    /// Returns the uncertainty of a function of the law, from its derivatives by all numbers and their covariance (the
    /// delta method). `None` if the covariance is not known.
    pub(super) fn spread(&self, of: impl Fn(&Law) -> f64) -> Option<f64> {
        const STEP: f64 = 1e-4;
        let covariance = self.covariance.as_ref()?;
        let numbers = self.law.numbers();
        let slope = |at: usize, _: usize| {
            let moved = |by: f64| {
                let mut there = numbers.clone();
                there[at] += by;
                of(&self.law.with(&there))
            };
            (moved(STEP) - moved(-STEP)) / (2.0 * STEP)
        };
        let slopes = DVector::from_fn(numbers.len(), slope);
        let variance = slopes.dot(&(covariance * &slopes));
        variance.is_finite().then(|| variance.max(0.0).sqrt())
    }
}

/// Power in bins, and the data that it is compared with.
#[derive(Debug, Clone, Copy)]
pub struct Data<'a> {
    /// The bins.
    pub grid: &'a Grid,
    /// Mean square of the coefficients in each bin.
    pub power: &'a [f64],
    /// The number of independent coefficients that each bin counts for: as many as it has ([`Grid::counts`]), or fewer.
    pub worth: &'a [f64],
    /// The shapes.
    pub base: &'a Base,
    /// Priors of the levels.
    pub priors: &'a Priors,
}

/// Bounds of ln of the white noise's power behind a filter over its power before it. A filter made by the bilinear transform
/// passes almost nothing at half the rate, and samples of 53 bits show that.
const FLOOR: (f64, f64) = (-72.0, 0.0);

/// Bounds of a line's asymmetry, over the largest possible one.
const ASYMMETRY: (f64, f64) = (-1.0, 1.0);

/// Bounds of a level, ln of power per sample.
pub(super) const LEVELS: [(f64, f64); 3] = [(-12.0, 30.0), (-24.0, 24.0), (-40.0, 20.0)];

/// The pieces of a spectrum S = (N + B + K + known + added)·gain + after.
struct Pieces {
    levels: [Vec<f64>; 3],
    added: Vec<Vec<f64>>,
    gains: Vec<Vec<f64>>,
    floors: Vec<f64>,
    spectrum: Vec<f64>,
    gain: Vec<f64>,
    before: Vec<f64>,
}

impl Pieces {
    fn of(law: &Law, data: Data<'_>) -> Self {
        let bins = data.grid.counts.len();
        let mut pieces = Self {
            levels: std::array::from_fn(|level| {
                let power = law.levels[level].exp();
                data.base.shapes[level].iter().map(|shape| power * shape).collect()
            }),
            added: Vec::new(),
            gains: Vec::new(),
            floors: Vec::new(),
            spectrum: vec![0.0; bins],
            gain: data.base.gain.clone(),
            before: data.base.known.clone(),
        };
        for term in &law.terms {
            let (mut added, mut gain, mut floor) = (Vec::new(), Vec::new(), 0.0);
            if term.is_filter() {
                gain = term.gains(data.grid.frequencies());
                floor = (law.levels[0] + term.numbers[term.level()]).exp() * data.grid.rate_hz();
                pieces.gain.iter_mut().zip(&gain).for_each(|(all, one)| *all *= one);
            } else {
                added = term.added(data.grid.frequencies());
                pieces.before.iter_mut().zip(&added).for_each(|(all, one)| *all += one);
            }
            pieces.added.push(added);
            pieces.gains.push(gain);
            pieces.floors.push(floor);
        }
        for level in &pieces.levels {
            pieces.before.iter_mut().zip(level).for_each(|(all, one)| *all += one);
        }
        let floor: f64 = pieces.floors.iter().sum();
        let quiet = law.quiet.min(data.base.quiet_max);
        for bin in 0..bins {
            let behind = data.base.after[bin] + quiet + floor;
            pieces.spectrum[bin] = pieces.before[bin] * pieces.gain[bin] + behind;
        }
        pieces
    }
}

impl Law {
    /// Finds the likeliest power behind the model's filters that the model does not state, with the law as it is.
    pub(super) fn find_quiet(&mut self, data: Data<'_>) {
        /// ln of the smallest over the largest value; number of steps, and how often they are halved.
        const SPAN: f64 = 32.0;
        const STEPS: i32 = 16;
        const HALVED: i32 = 6;
        let most = data.base.quiet_max;
        if most <= 0.0 {
            return;
        }
        let others = Pieces::of(self, data).spectrum;
        let score = |below: f64| {
            let change = most * (-below).exp() - self.quiet.min(most);
            let spectrum: Vec<f64> = others.iter().map(|s| (s + change).max(f64::MIN_POSITIVE)).collect();
            self.judged(&spectrum, data).0
        };
        let mut step = SPAN / f64::from(STEPS);
        let starts = (0..=STEPS).map(|at| f64::from(at) * step).map(|below| (score(below), below));
        let mut best = starts.reduce(|a, b| if b.0 > a.0 { b } else { a }).unwrap_or_default();
        for _ in 0..HALVED {
            step *= 0.5;
            for below in [best.1 - step, best.1 + step] {
                let there = (score(below), below);
                if (0.0..=SPAN).contains(&below) && there.0 > best.0 {
                    best = there;
                }
            }
        }
        self.quiet = most * (-best.1).exp();
    }

    /// Returns ln of the spectrum in each bin.
    pub fn logarithms(&self, data: Data<'_>) -> Vec<f64> {
        Pieces::of(self, data).spectrum.iter().map(|s| s.max(f64::MIN_POSITIVE).ln()).collect()
    }

    /// Returns the two-sided density that is white at low frequencies besides N²: noise behind filters and the skirts
    /// of bands.
    pub(super) fn beside(&self, rate_hz: f64) -> f64 {
        /// A frequency below all others, in parts of the rate.
        const LOWEST: f64 = 1e-9;
        let of = |term: &Term| match (term.floor(), term.shape) {
            (Some(floor), _) => self.levels[0].exp() * floor,
            (None, Shape::Resonance) => {
                term.added(&Frequencies::new(vec![LOWEST * rate_hz], rate_hz)).iter().sum::<f64>() / rate_hz
            }
            _ => 0.0,
        };
        self.terms.iter().map(of).sum()
    }

    fn numbers(&self) -> Vec<f64> {
        self.levels.iter().copied().chain(self.terms.iter().flat_map(|term| term.numbers.iter().copied())).collect()
    }

    fn with(&self, numbers: &[f64]) -> Self {
        let mut law = self.clone();
        let (levels, mut rest) = numbers.split_at(3);
        law.levels.copy_from_slice(levels);
        for term in &mut law.terms {
            let (own, others) = rest.split_at(term.numbers.len());
            term.numbers.copy_from_slice(own);
            rest = others;
        }
        law
    }

    fn ranges(&self, grid: &Grid) -> Vec<(f64, f64)> {
        let of_terms = self.terms.iter().flat_map(|term| term.ranges(grid.samples, grid.rate_hz()));
        LEVELS.into_iter().chain(of_terms).collect()
    }

    /// Returns the derivatives of the spectrum by every number, divided by the spectrum.
    fn slopes(&self, pieces: &Pieces, data: Data<'_>) -> Vec<Vec<f64>> {
        const STEP: f64 = 1e-5;
        let scaled = |values: &[f64]| -> Vec<f64> {
            let places = values.iter().zip(&pieces.gain).zip(&pieces.spectrum);
            places.map(|((value, gain), s)| value * gain / s).collect()
        };
        let mut slopes: Vec<Vec<f64>> = pieces.levels.iter().map(|level| scaled(level)).collect();
        // The noise behind a filter is stated as a part of the noise before it.
        let floor: f64 = pieces.floors.iter().sum();
        if floor > 0.0 {
            slopes[0].iter_mut().zip(&pieces.spectrum).for_each(|(slope, s)| *slope += floor / s);
        }
        for (at, term) in self.terms.iter().enumerate() {
            for number in 0..term.numbers.len() {
                if number == term.level() && term.is_filter() {
                    slopes.push(pieces.spectrum.iter().map(|s| pieces.floors[at] / s).collect());
                } else if number == term.level() {
                    slopes.push(scaled(&pieces.added[at]));
                } else {
                    let mut moved = term.clone();
                    moved.numbers[number] += STEP;
                    if term.is_filter() {
                        let there = moved.gains(data.grid.frequencies());
                        let change = there.iter().zip(&pieces.gains[at]).map(|(to, from)| (to / from - 1.0) / STEP);
                        let places = change.zip(&pieces.before).zip(pieces.gain.iter().zip(&pieces.spectrum));
                        slopes.push(places.map(|((change, before), (gain, s))| change * before * gain / s).collect());
                    } else {
                        let there = moved.added(data.grid.frequencies());
                        let change = there.iter().zip(&pieces.added[at]).map(|(to, from)| (to - from) / STEP);
                        slopes.push(scaled(&change.collect::<Vec<f64>>()));
                    }
                }
            }
        }
        slopes
    }

    /// Returns ln of the density, and ln of the density with priors, of a spectrum's power.
    fn judged(&self, spectrum: &[f64], data: Data<'_>) -> (f64, f64) {
        let bins = spectrum.iter().zip(data.power).zip(data.worth);
        let likelihood = -0.5 * bins.map(|((s, power), count)| count * (s.ln() + power / s)).sum::<f64>();
        let priors = self.levels.iter().zip(data.priors);
        let misses = priors.filter_map(|(level, prior)| prior.map(|(centre, sd)| ((level - centre) / sd).powi(2)));
        (likelihood, likelihood - 0.5 * misses.sum::<f64>())
    }

    /// Fits the law of this form with the greatest posterior density, starting from `self`.
    ///
    /// Fisher scoring with Levenberg's damping (Whittle's likelihood of gamma-distributed power in bins: Whittle 1953,
    /// J. R. Stat. Soc. B 15).
    pub fn fit(&self, data: Data<'_>) -> Fitted {
        const ROUNDS: usize = 60;
        self.fit_for(data, ROUNDS)
    }

    /// Returns the best of fits from several starts: those that are ahead after a few rounds are fitted to the end.
    pub fn fit_best(starts: Vec<Self>, data: Data<'_>) -> Option<Fitted> {
        const FIRST: usize = 8;
        const BEHIND: f64 = 12.0;
        const MOST: usize = 3;
        if starts.len() == 1 {
            return starts.first().map(|law| law.fit(data));
        }
        let mut first: Vec<Fitted> = starts.iter().map(|law| law.fit_for(data, FIRST)).collect();
        first.sort_by(|a, b| b.log_posterior.total_cmp(&a.log_posterior));
        let ahead = first.first()?.log_posterior - BEHIND;
        first.retain(|of| of.log_posterior > ahead);
        let ended = first.into_iter().take(MOST).map(|of| of.law.fit(data));
        ended.reduce(|a, b| if b.log_posterior > a.log_posterior { b } else { a })
    }

    fn fit_for(&self, data: Data<'_>, rounds: usize) -> Fitted {
        const ENOUGH: f64 = 1e-4;
        const LONGEST: f64 = 2.0;
        let ranges = self.ranges(data.grid);
        let clamp = |numbers: &mut Vec<f64>| {
            numbers.iter_mut().zip(&ranges).for_each(|(number, (low, high))| *number = number.clamp(*low, *high));
        };
        let mut numbers = self.numbers();
        clamp(&mut numbers);
        let mut law = self.with(&numbers);
        law.find_quiet(data);
        let mut pieces = Pieces::of(&law, data);
        let (mut likelihood, mut posterior) = law.judged(&pieces.spectrum, data);
        let mut damping = 1e-3;
        let mut fisher = DMatrix::zeros(numbers.len(), numbers.len());
        let mut small = 0;
        for _ in 0..rounds {
            let slopes = law.slopes(&pieces, data);
            let count = slopes.len();
            let mut gradient = DVector::zeros(count);
            let excess: Vec<f64> = data.power.iter().zip(&pieces.spectrum).map(|(power, s)| power / s - 1.0).collect();
            for i in 0..count {
                let weighted: Vec<f64> = slopes[i].iter().zip(data.worth).map(|(slope, n)| 0.5 * n * slope).collect();
                gradient[i] = dot(&weighted, &excess);
                for j in 0..=i {
                    fisher[(i, j)] = dot(&weighted, &slopes[j]);
                    fisher[(j, i)] = fisher[(i, j)];
                }
            }
            for (i, prior) in data.priors.iter().enumerate() {
                if let Some((centre, sd)) = prior {
                    gradient[i] -= (law.levels[i] - centre) / (sd * sd);
                    fisher[(i, i)] += 1.0 / (sd * sd);
                }
            }
            // A number at its bound that would move beyond it is held there.
            let held: Vec<bool> = (0..count)
                .map(|i| {
                    let (low, high) = ranges[i];
                    (numbers[i] <= low && gradient[i] < 0.0) || (numbers[i] >= high && gradient[i] > 0.0)
                })
                .collect();
            let mut gained = None;
            for _ in 0..12 {
                let mut system = fisher.clone();
                let mut right = gradient.clone();
                for i in 0..count {
                    system[(i, i)] += damping * fisher[(i, i)] + 1e-9;
                    if held[i] {
                        system.row_mut(i).fill(0.0);
                        system.column_mut(i).fill(0.0);
                        system[(i, i)] = 1.0;
                        right[i] = 0.0;
                    }
                }
                let Some(step) = system.cholesky().map(|factor| factor.solve(&right)) else {
                    damping = (damping * 10.0).max(1e-3);
                    continue;
                };
                let longest = step.amax();
                let share = if longest > LONGEST { LONGEST / longest } else { 1.0 };
                let mut there: Vec<f64> = numbers.iter().zip(step.iter()).map(|(x, d)| x + share * d).collect();
                clamp(&mut there);
                let moved = law.with(&there);
                let spectrum = Pieces::of(&moved, data);
                let (new_likelihood, new_posterior) = moved.judged(&spectrum.spectrum, data);
                if new_posterior.is_finite() && new_posterior > posterior {
                    gained = Some(new_posterior - posterior);
                    (numbers, law, pieces) = (there, moved, spectrum);
                    (likelihood, posterior) = (new_likelihood, new_posterior);
                    damping = (damping * 0.3).max(1e-6);
                    break;
                }
                damping *= 5.0;
            }
            small = if gained.is_some_and(|gained| gained > ENOUGH) { 0 } else { small + 1 };
            if gained.is_none() || small >= 2 {
                break;
            }
            if data.base.quiet_max > 0.0 {
                law.find_quiet(data);
                pieces = Pieces::of(&law, data);
                (likelihood, posterior) = law.judged(&pieces.spectrum, data);
            }
        }
        let logarithms = pieces.spectrum.iter().map(|s| s.max(f64::MIN_POSITIVE).ln()).collect();
        let covariance = fisher.try_inverse();
        Fitted { law, log_likelihood: likelihood, log_posterior: posterior, covariance, logarithms }
    }

    /// Returns the best of several fits: from `self`, and from other levels of flicker and random walk, which may hide
    /// behind one another.
    pub fn fit_from_several(&self, data: Data<'_>) -> Fitted {
        let best = self.fit(data);
        let mut starts = Vec::new();
        // Frequencies at which flicker and walk meet the white noise, as shares of the band.
        for (flicker, walk) in [(1e-4, 1e-5), (1e-2, 1e-4), (1e-3, 1e-3), (1e-5, 1e-2)] {
            let mut start = self.clone();
            let nyquist_hz = 0.5 * data.grid.rate_hz();
            for (level, corner) in [(1, flicker), (2, walk)] {
                let at = |f: f64| {
                    let near = data.grid.frequencies_hz().partition_point(|own| *own < f);
                    near.min(data.grid.counts.len() - 1)
                };
                let bin = at(corner * nyquist_hz);
                let shape = data.base.shapes[level][bin];
                if shape > 0.0 {
                    start.levels[level] = best.law.levels[0] + (data.base.shapes[0][bin] / shape).ln();
                }
            }
            start.levels[0] = best.law.levels[0];
            starts.push(start);
        }
        Self::fit_best(starts, data).filter(|other| other.log_posterior > best.log_posterior + 1e-3).unwrap_or(best)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transform::Cosines;
    use imu_model::effects::{Flicker, RandomWalk, Stream, StreamId, White};

    const RATE_HZ: f64 = 40.0;

    pub(super) fn base(grid: &Grid) -> Base {
        let of = |effect: &dyn Effect| -> Vec<f64> {
            grid.frequencies_hz().iter().map(|f| RATE_HZ * effect.psd(*f, RATE_HZ).unwrap()).collect()
        };
        let bins = grid.counts.len();
        Base {
            quiet_max: 0.0,
            shapes: [of(&White { n: 1.0 }), of(&Flicker { b: 1.0 }), of(&RandomWalk { k: 1.0 })],
            known: vec![0.0; bins],
            after: vec![0.0; bins],
            gain: vec![1.0; bins],
            passed: vec![1.0; bins],
        }
    }

    fn drawn(effects: &[&dyn Effect], n: usize, seed: u64) -> Vec<f64> {
        let mut values = vec![0.0; n];
        for (at, effect) in effects.iter().enumerate() {
            let stream = Stream::new(seed, StreamId { owner: 1, effect: at as u16, instance: 0 });
            effect.sampler(RATE_HZ, n as f64 / RATE_HZ, stream).apply(&mut values);
        }
        values
    }

    #[test]
    fn levels_and_terms_are_found_within_their_errors() {
        let n = 30_001;
        let (white, flicker) = (White { n: 1.0 / RATE_HZ.sqrt() }, Flicker { b: 0.1 });
        let walk = RandomWalk { k: 0.005 };
        let process = GaussMarkov { sigma: 0.8, tc_s: 3.0 };
        let grid = Grid::new(n, RATE_HZ, &[]);
        let base = base(&grid);
        let mut transform = Cosines::new(n);
        let mut sums = [0.0; 5];
        for seed in 0..12 {
            let mut values = drawn(&[&white, &flicker, &walk, &process], n, seed);
            transform.forward(&mut values);
            let power = grid.power(&values);
            let data =
                Data { grid: &grid, power: &power, worth: &grid.counts, base: &base, priors: &[None, None, None] };
            let start = Law {
                levels: [-3.0, -6.0, -12.0],
                terms: vec![Term { shape: Shape::GaussMarkov, numbers: vec![-1.0, 0.5] }],
                quiet: 0.0,
            };
            let fitted = start.fit_from_several(data);
            let covariance = fitted.covariance.unwrap();
            let truths = [(1.0 / RATE_HZ).ln(), 0.01f64.ln(), 2.5e-5f64.ln(), 0.64f64.ln(), 3f64.ln()];
            for (at, (found, truth)) in fitted.law.numbers().iter().zip(truths).enumerate() {
                if at != 1 && at != 2 {
                    sums[at] += (found - truth).powi(2) / covariance[(at, at)];
                }
            }
        }
        for at in [0, 3, 4] {
            // χ² of 12 degrees of freedom is below 33 with 99.9 %.
            assert!((1.0..33.0).contains(&sums[at]), "{at}: {sums:?}");
        }
    }

    #[test]
    fn a_filter_is_found_with_the_noise_behind_it() {
        let n = 20_000;
        let filter = LowPass::new(9.0, 2);
        let mut values = drawn(&[&White { n: 1.0 / RATE_HZ.sqrt() }, &filter], n, 5);
        for (value, more) in values.iter_mut().zip(drawn(&[&White { n: 0.03 / RATE_HZ.sqrt() }], n, 6)) {
            *value += more;
        }
        Cosines::new(n).forward(&mut values);
        let grid = Grid::new(n, RATE_HZ, &[]);
        let (power, base) = (grid.power(&values), base(&grid));
        let data = Data { grid: &grid, power: &power, worth: &grid.counts, base: &base, priors: &[None, None, None] };
        let start = Law {
            levels: [-3.0, -12.0, -20.0],
            terms: vec![Term { shape: Shape::LowPass(2), numbers: vec![14f64.ln(), -7.0] }],
            quiet: 0.0,
        };
        let found = start.fit_from_several(data).law;
        assert!((found.terms[0].numbers[0].exp() / 9.0 - 1.0).abs() < 0.02, "{found:?}");
        assert!(((0.5 * found.terms[0].numbers[1]).exp() / 0.03 - 1.0).abs() < 0.1, "{found:?}");
    }
}
