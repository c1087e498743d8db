//! The likelihood of spectral sums under a noise model, and its maximum over coefficients that are not negative.
//!
//! The z_k of a stretch are independent and normal with mean Rdt·μ_k and variance 4 sin²(πu)·S(f)/dt. This holds
//! exactly for white noise and random walks, and to leading order for flicker and Gauss–Markov noise, whose end effects
//! are included. A bin of n of them is a gamma variable of shape n/2, so that −2 log L = Σ n (log λ + P/λ). P is the
//! mean square, and λ, linear in the squared coefficients, is the mean of the expected squares.
//!
//! # Source
//! P. Whittle, Ark. Mat. 2 (1953) 423, for the likelihood; P. McCullagh, J. A. Nelder, Generalized Linear Models (1989),
//! section 8, for the scoring.

use super::ends::{Excess, Own};
use super::shape::{Shape, TILTS};
use super::sums::{Bin, DstSums};
use crate::fit::Term;
use std::borrow::Cow;

/// Number of coefficients in whose squares the spectrum is linear: N, B, K, Q of [`Term`], the σ of a Gauss–Markov
/// process, and the density of white noise behind the filter.
pub(super) const SQUARES: usize = 6;
/// The place of σ.
pub(super) const SIGMA: usize = 4;
/// The place of the white noise behind the filter; it is a part of N, which is the plateau of both.
pub(super) const BEHIND: usize = 5;
/// Unknowns of a scoring step: squares, then the shape's numbers.
const UNKNOWNS: usize = SQUARES + TILTS;
const SCORING_STEPS: usize = 60;
/// Accuracy of −2 log L; intervals are computed from roots of its differences.
const SETTLED: f64 = 1e-8;
/// Maximum change of the shape's numbers in one step.
const FARTHEST: f64 = 0.5;

/// Returns a term's place among the squares.
pub(super) fn place(term: Term) -> Option<usize> {
    match term {
        Term::N => Some(0),
        Term::B => Some(1),
        Term::K => Some(2),
        Term::Q => Some(3),
        Term::R => None,
    }
}

/// The terms of a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Terms {
    pub(super) squares: [bool; SQUARES],
    pub(super) ramp: bool,
}

impl Terms {
    pub(super) fn of(letters: &[Term]) -> Self {
        letters.iter().fold(Self { squares: [false; SQUARES], ramp: false }, |terms, term| terms.with(*term))
    }
    pub(super) fn with(mut self, term: Term) -> Self {
        match place(term) {
            Some(at) => self.squares[at] = true,
            None => self.ramp = true,
        }
        self
    }
    pub(super) fn without(mut self, term: Term) -> Self {
        match place(term) {
            Some(at) => self.squares[at] = false,
            None => self.ramp = false,
        }
        self
    }
    pub(super) fn has(self, term: Term) -> bool {
        place(term).map_or(self.ramp, |at| self.squares[at])
    }
    pub(super) fn with_gauss_markov(mut self) -> Self {
        self.squares[SIGMA] = true;
        self
    }
    pub(super) fn without_gauss_markov(mut self) -> Self {
        self.squares[SIGMA] = false;
        self
    }
    pub(super) fn with_behind(mut self) -> Self {
        self.squares[BEHIND] = true;
        self
    }
    pub(super) fn has_gauss_markov(self) -> bool {
        self.squares[SIGMA]
    }
    /// Returns the number of fitted numbers.
    pub(super) fn parameters(self) -> usize {
        self.squares.iter().filter(|has| **has).count() + usize::from(self.ramp) + usize::from(self.has_gauss_markov())
    }
}

/// The coefficient that is held at a value while the others are fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Held {
    Nothing,
    /// A square.
    Square(usize, f64),
    /// The ramp, U per s.
    Ramp(f64),
    /// A number of the shape, relative to its value in the likelihood.
    Tilt(usize, f64),
}

/// Coefficients of a model, and their likelihood.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Model {
    pub(super) terms: Terms,
    /// Squared coefficients, ≥ 0.
    pub(super) squares: [f64; SQUARES],
    /// Correlation time of the Gauss–Markov process, s.
    pub(super) tc_s: f64,
    /// The ramp, U per s, with its sign.
    pub(super) ramp: f64,
    /// The shape's numbers, relative to their values in the likelihood.
    pub(super) tilt: [f64; TILTS],
    /// −2 log L less a constant of the data.
    pub(super) deviance: f64,
}

impl Model {
    fn point(&self) -> Point {
        Point { squares: self.squares, tilt: self.tilt }
    }
    /// Returns the coefficient of a term; the ramp's with its sign.
    pub(super) fn coefficient(&self, term: Term) -> f64 {
        place(term).map_or(self.ramp, |at| self.squares[at].sqrt())
    }
}

/// One bin: n squares of mean `power`, and the mean of each term's expected squares for a coefficient of 1.
#[derive(Debug, Clone, Copy)]
struct Row {
    count: f64,
    power: f64,
    basis: [f64; SQUARES],
    /// 4 sin²(πu), and one over the stretch's length.
    sine: f64,
    ends: f64,
    cross: f64,
    ramp: f64,
    /// A rough level of the bin and its neighbours.
    level: f64,
    /// The part of white noise and of a process that passes the filter, and d ln(gain)/dp.
    white_gain: f64,
    process_gain: f64,
    slopes: [f64; TILTS],
}

impl Row {
    fn of(bin: &Bin, dt_s: f64) -> Self {
        Self {
            count: bin.count,
            power: bin.power / bin.count,
            basis: [
                1.0 / dt_s,
                bin.flicker / bin.count,
                dt_s * bin.walk / bin.count,
                bin.angle / bin.count / (dt_s * dt_s),
                0.0,
                0.0,
            ],
            sine: bin.count / bin.walk,
            ends: bin.ends / bin.count,
            cross: bin.cross / bin.count,
            ramp: bin.ramp / bin.count,
            level: 0.0,
            white_gain: 1.0,
            process_gain: 1.0,
            slopes: [0.0; TILTS],
        }
    }

    /// Applies a filter to the row: the mean of its gains over the bin's frequencies, with the contribution of a
    /// stretch's ends to white noise.
    fn filtered(&self, [low, high]: [f64; 2], shape: &Shape, excess: Option<&Excess>, dt_s: f64) -> Self {
        let mut row = *self;
        /// Gauss–Legendre quadrature with three points.
        const POINTS: [(f64, f64); 3] =
            [(-0.774_596_669_241_483, 5.0 / 18.0), (0.0, 8.0 / 18.0), (0.774_596_669_241_483, 5.0 / 18.0)];
        let (mut white, mut flicker, mut walk, mut slopes) = (0.0, 0.0, 0.0, [0.0; TILTS]);
        for (place, weight) in POINTS {
            let u = 0.5 * (low + high) + 0.5 * (high - low) * place;
            let gains = shape.gains(u);
            white += weight * gains.white;
            flicker += weight * gains.flicker;
            walk += weight * gains.walk;
            for (sum, slope) in slopes.iter_mut().zip(shape.slopes(u)) {
                *sum += weight * gains.white * slope;
            }
        }
        row.slopes = slopes.map(|slope| if white > 0.0 { slope / white } else { 0.0 });
        let added = excess.map_or(0.0, |excess| excess.at(0.5 * (low + high)) * self.ends);
        // For a stretch shorter than the filter, the sum is not valid.
        let white = f64::max(white + added, 0.1 * white);
        (row.white_gain, row.process_gain) = (white, walk);
        row.basis[0] *= white;
        row.basis[1] *= flicker;
        row.basis[2] *= walk;
        row.basis[3] *= white;
        row.basis[BEHIND] = (1.0 - white).max(0.0) / dt_s;
        row
    }

    /// Returns the expected squares of each term with the shape's numbers moved.
    fn basis_at(&self, tilt: &[f64; TILTS], dt_s: f64) -> [f64; SQUARES] {
        if tilt.iter().all(|by| *by == 0.0) {
            return self.basis;
        }
        let factor = self.slopes.iter().zip(tilt).map(|(slope, by)| slope * by).sum::<f64>().exp();
        let mut basis = self.basis.map(|own| own * factor);
        basis[BEHIND] = (1.0 - self.white_gain * factor).max(0.0) / dt_s;
        basis
    }
}

/// Coefficients at which the spectrum is evaluated.
#[derive(Debug, Clone, Copy)]
struct Point {
    squares: [f64; SQUARES],
    tilt: [f64; TILTS],
}

/// A record's bins, on which filters compete.
#[derive(Debug)]
pub(super) struct FineBins {
    /// The range of u of each bin, and its contents.
    rows: Vec<([f64; 2], Row)>,
    dt_s: f64,
}

impl FineBins {
    /// Takes the bins that touch none of `excluded_bands_hz` and have no neighbour that does.
    ///
    /// Frequencies at which a filter leaves almost no noise take no part: the contribution of a stretch's ends is
    /// larger there, and has few independent numbers. The data alone determines these frequencies, so that all shapes
    /// are compared on the same bins.
    pub(super) fn new(sums: &DstSums, rate_hz: f64, excluded_bands_hz: &[[f64; 2]]) -> Self {
        /// Maximum share of a bin's power contributed by the ends.
        const ADDED_MOST: f64 = 0.1;
        let dt_s = 1.0 / rate_hz;
        let bins = sums.finely_filled().filter(|(range, _)| !excluded(*range, rate_hz, excluded_bands_hz));
        let (ranges, mut rows): (Vec<_>, Vec<_>) = bins.map(|(range, bin)| (range, Row::of(bin, dt_s))).unzip();
        level(&mut rows);
        let own = Own::of(sums);
        let takes_part = |([low, high], row): &([f64; 2], Row)| {
            let added = own.excess(0.5 * (low + high)).abs() * row.ends;
            added < ADDED_MOST * row.level * row.sine || row.sine < 1e-3
        };
        Self { rows: ranges.into_iter().zip(rows).filter(takes_part).collect(), dt_s }
    }
}

/// The data, ready for models.
#[derive(Debug, Clone)]
pub(super) struct Likelihood {
    rows: Vec<Row>,
    dt_s: f64,
    shape: Shape,
    /// Whether white noise enters behind the filter.
    behind: bool,
}

impl Likelihood {
    /// Takes the bins that touch none of `excluded_bands_hz` and have no neighbour that does.
    pub(super) fn new(sums: &DstSums, rate_hz: f64, excluded_bands_hz: &[[f64; 2]]) -> Self {
        let dt_s = 1.0 / rate_hz;
        let rows = sums.filled().filter(|(range, _)| !excluded(*range, rate_hz, excluded_bands_hz));
        let mut rows: Vec<Row> = rows.map(|(_, bin)| Row::of(bin, dt_s)).collect();
        level(&mut rows);
        Self { rows, dt_s, shape: Shape::Open, behind: false }
    }

    /// Returns the likelihood with a filter on the noise, over finer bins. `behind` is whether white noise may enter
    /// behind the filter.
    pub(super) fn filtered(bins: &FineBins, shape: &Shape, behind: bool) -> Self {
        let up_to = if let Shape::Smooth { up_to, .. } = shape { *up_to } else { 0.5 };
        let excess = Excess::of(shape);
        let taken = bins.rows.iter().filter(|(range, _)| range[1] <= up_to * (1.0 + 1e-9));
        let rows = taken.map(|(range, row)| row.filtered(*range, shape, excess.as_ref(), bins.dt_s)).collect();
        Self { rows, dt_s: bins.dt_s, shape: shape.clone(), behind }
    }

    /// Returns the filter on the noise.
    pub(super) fn shape(&self) -> &Shape {
        &self.shape
    }

    /// Returns the terms that every model has: N, and white noise behind the filter if that is allowed.
    pub(super) fn least_terms(&self) -> Terms {
        let terms = Terms::of(&[Term::N]);
        if self.behind { terms.with_behind() } else { terms }
    }

    /// Returns the number of squares, and whether any differs from 0.
    pub(super) fn extent(&self) -> (f64, bool) {
        (self.rows.iter().map(|row| row.count).sum(), self.rows.iter().any(|row| row.power > 0.0))
    }

    /// Returns the longest stretch, s; 0 without data.
    pub(super) fn longest_s(&self) -> f64 {
        self.rows.iter().map(|row| self.dt_s / row.ends).fold(0.0, f64::max)
    }

    pub(super) fn dt_s(&self) -> f64 {
        self.dt_s
    }

    /// Returns the model of `terms` with the largest likelihood, starting from `start` if given. `None` if no model
    /// fits.
    pub(super) fn maximise(&self, terms: Terms, tc_s: f64, held: Held, start: Option<&Model>) -> Option<Model> {
        let rows = self.with_gauss_markov(terms, tc_s);
        let mut ramp = match held {
            Held::Ramp(value) => value * self.dt_s,
            _ => start.filter(|_| terms.ramp).map_or(0.0, |start| start.ramp * self.dt_s),
        };
        let dt_s = self.dt_s;
        let mut point = Point { squares: [0.0; SQUARES], tilt: [0.0; TILTS] };
        let mut deviance = f64::INFINITY;
        if let Held::Tilt(at, value) = held {
            point.tilt[at] = value;
        }
        if let Some(start) = start {
            point.squares = std::array::from_fn(|at| if terms.squares[at] { start.squares[at] } else { 0.0 });
            point.tilt = start.tilt;
            match held {
                Held::Square(at, value) => point.squares[at] = value,
                Held::Tilt(at, value) => point.tilt[at] = value,
                Held::Nothing | Held::Ramp(_) => {}
            }
            deviance = deviance_of(&rows, &point, ramp, dt_s);
        }
        for step in 0..SCORING_STEPS {
            let begun = deviance.is_finite();
            let lambda = |row: &Row| if begun { spectrum(row, &point, dt_s) } else { row.level };
            if terms.ramp && !matches!(held, Held::Ramp(_)) {
                ramp = generalised_mean(&rows, &lambda).unwrap_or(ramp);
            }
            let tilts = if begun { self.shape.tilts() } else { 0 };
            let before = if begun && terms.ramp { deviance_of(&rows, &point, ramp, dt_s) } else { deviance };
            let proposed = scoring_step(&rows, &lambda, terms, held, ramp, &point, tilts, dt_s)?;
            let (next, reached) = shorten(&rows, point, proposed, ramp, before, dt_s);
            if begun && reached >= before - SETTLED {
                if reached < before {
                    (point, deviance) = (next, reached);
                } else {
                    deviance = before;
                }
                // The first step from another law's maximum may lead nowhere, but the ramp's step has been taken.
                if step > 0 || !terms.ramp {
                    break;
                }
            } else {
                (point, deviance) = (next, reached);
            }
        }
        let Point { squares, tilt } = point;
        let model = Model { terms, squares, tc_s, ramp: ramp / self.dt_s, tilt, deviance };
        deviance.is_finite().then_some(model)
    }

    fn with_gauss_markov(&self, terms: Terms, tc_s: f64) -> Cow<'_, [Row]> {
        let mut rows = Cow::Borrowed(&self.rows[..]);
        if terms.has_gauss_markov() {
            let decay = self.dt_s / tc_s;
            for row in rows.to_mut() {
                row.basis[SIGMA] = row.process_gain * gauss_markov(row.sine, row.ends, decay);
            }
        }
        rows
    }

    /// Returns the smallest coefficient of `term` that alone would equal `model` at some frequency.
    pub(super) fn whole(&self, term: Term, model: &Model) -> Option<f64> {
        let rows = self.with_gauss_markov(model.terms, model.tc_s);
        let of = |row: &Row| match place(term) {
            Some(at) => (spectrum(row, &model.point(), self.dt_s) / row.basis[at]).sqrt(),
            None => (spectrum(row, &model.point(), self.dt_s) / row.ramp).sqrt() / self.dt_s,
        };
        rows.iter().map(of).filter(|c| c.is_finite() && *c > 0.0).min_by(f64::total_cmp)
    }

    /// Returns groups of bins from low to high frequency: the number of squares, and the sum of found over expected
    /// squares.
    pub(super) fn groups(&self, model: &Model, least: f64, ratio: f64) -> Vec<(f64, f64)> {
        let rows = self.with_gauss_markov(model.terms, model.tc_s);
        let mut groups: Vec<(f64, f64)> = Vec::new();
        let (mut count, mut sum, mut first) = (0.0, 0.0, 0.0);
        for row in rows.iter() {
            if count == 0.0 {
                first = row.sine;
            }
            count += row.count;
            sum += row.count * residual_power(row, model.ramp * self.dt_s) / spectrum(row, &model.point(), self.dt_s);
            if count >= least && row.sine >= first * ratio {
                groups.push((count, sum));
                (count, sum) = (0.0, 0.0);
            }
        }
        if count > 0.0 {
            match groups.last_mut() {
                Some(last) => (last.0, last.1) = (last.0 + count, last.1 + sum),
                None => groups.push((count, sum)),
            }
        }
        groups
    }
}

/// Returns the spectrum over dt of a sampled Gauss–Markov process with σ = 1 at s = 4 sin²(πu), with the first-order
/// effect of a stretch's ends: a process as long as the stretch looks smaller.
///
/// # Source
/// The sampled process is an AR(1) with φ = e^(−dt/Tc). Ends: the variance of ∫ y cos(ωt) dt over T is
/// T·2a/(a² + ω²) · (1 − 2a/(T(a² + ω²))) for a = 1/Tc ≫ 1/T.
fn gauss_markov(s: f64, ends: f64, decay: f64) -> f64 {
    let (phi, rest) = ((-decay).exp(), -(-decay).exp_m1());
    let ends = 2.0 * decay * ends / (decay * decay + s);
    rest * (1.0 + phi) / (rest * rest + phi * s) * (1.0 - ends).max(0.0)
}

/// Averages over bins until there are ten squares, for initial weights.
fn level(rows: &mut [Row]) {
    let mut from = 0;
    let mut last = 0.0;
    while from < rows.len() {
        let (mut to, mut count, mut sum) = (from, 0.0, 0.0);
        while to < rows.len() && count < 10.0 {
            count += rows[to].count;
            sum += rows[to].count * rows[to].power;
            to += 1;
        }
        let mean = if sum > 0.0 { sum / count } else { last };
        for row in &mut rows[from..to] {
            row.level = mean;
        }
        (from, last) = (to, mean);
    }
    let top = rows.iter().map(|row| row.level).fold(0.0, f64::max);
    for row in rows {
        // Otherwise, a band without noise would have more weight than all others.
        row.level = row.level.max(1e-12 * top);
    }
}

/// Returns whether a bin or its neighbour touches an excluded band.
fn excluded([low, high]: [f64; 2], rate_hz: f64, bands_hz: &[[f64; 2]]) -> bool {
    /// A bin is 3.7 % wide; the leakage of a line beyond its neighbour falls with the square of the distance.
    const MARGIN: f64 = 1.037;
    bands_hz.iter().any(|[from, to]| high * rate_hz >= from / MARGIN && low * rate_hz <= to * MARGIN)
}

fn spectrum(row: &Row, point: &Point, dt_s: f64) -> f64 {
    row.basis_at(&point.tilt, dt_s).iter().zip(&point.squares).map(|(basis, square)| basis * square).sum()
}

fn residual_power(row: &Row, ramp: f64) -> f64 {
    (row.power + ramp * (ramp * row.ramp - 2.0 * row.cross)).max(0.0)
}

/// Returns −2 log L relative to that of the rough levels, which keeps the sum small and its digits.
fn deviance_of(rows: &[Row], point: &Point, ramp: f64, dt_s: f64) -> f64 {
    let of = |row: &Row| {
        let lambda = spectrum(row, point, dt_s);
        row.count * ((lambda / row.level).ln() + residual_power(row, ramp) / lambda - 1.0)
    };
    let sum: f64 = rows.iter().map(of).sum();
    if sum.is_nan() { f64::INFINITY } else { sum }
}

/// Returns the ramp by generalised least squares.
fn generalised_mean(rows: &[Row], lambda: &impl Fn(&Row) -> f64) -> Option<f64> {
    let (cross, ramp) = rows.iter().fold((0.0, 0.0), |(cross, ramp), row| {
        let weight = row.count / lambda(row);
        (cross + weight * row.cross, ramp + weight * row.ramp)
    });
    Some(cross / ramp).filter(|mean| mean.is_finite())
}

/// Takes one step of Fisher scoring: weighted least squares over squares that are not negative, and over the first
/// `tilts` of the shape's numbers, which may have any sign.
#[expect(clippy::too_many_arguments, reason = "one step of one loop")]
fn scoring_step(
    rows: &[Row],
    lambda: &impl Fn(&Row) -> f64,
    terms: Terms,
    held: Held,
    ramp: f64,
    point: &Point,
    tilts: usize,
    dt_s: f64,
) -> Option<Point> {
    let fixed = match held {
        Held::Square(at, value) => Some((at, value)),
        _ => None,
    };
    let free: Vec<usize> =
        (0..SQUARES).filter(|at| terms.squares[*at] && fixed.is_none_or(|(held, _)| held != *at)).collect();
    let held_tilt = if let Held::Tilt(at, _) = held { Some(at) } else { None };
    let signed: Vec<usize> = (0..tilts).filter(|at| held_tilt != Some(*at)).map(|at| SQUARES + at).collect();
    let taken: Vec<usize> = free.iter().chain(&signed).copied().collect();
    let mut normal = [[0.0; UNKNOWNS]; UNKNOWNS];
    let mut right = [0.0; UNKNOWNS];
    let mut columns = [0.0; UNKNOWNS];
    for row in rows {
        let weight = row.count / lambda(row).powi(2);
        let basis = row.basis_at(&point.tilt, dt_s);
        let target = residual_power(row, ramp) - fixed.map_or(0.0, |(at, value)| basis[at] * value);
        columns[..SQUARES].copy_from_slice(&basis);
        if tilts > 0 {
            let front: f64 = basis.iter().zip(&point.squares).take(BEHIND).map(|(basis, square)| basis * square).sum();
            let moves = front - point.squares[BEHIND] * (1.0 / dt_s - basis[BEHIND]);
            for (column, slope) in columns[SQUARES..].iter_mut().zip(row.slopes).take(tilts) {
                *column = slope * moves;
            }
        }
        for (place, one) in taken.iter().enumerate() {
            let weighted = weight * columns[*one];
            right[*one] += weighted * target;
            for other in &taken[..=place] {
                normal[*one][*other] += weighted * columns[*other];
            }
        }
    }
    let found = non_negative(&normal, &right, &free, &signed)?;
    let mut next = Point { squares: std::array::from_fn(|at| found[at]), tilt: point.tilt };
    if let Some((at, value)) = fixed {
        next.squares[at] = value;
    }
    let largest = found[SQUARES..].iter().fold(0.0f64, |most, by| most.max(by.abs()));
    let limit = if largest > FARTHEST { FARTHEST / largest } else { 1.0 };
    next.tilt.iter_mut().zip(&found[SQUARES..]).for_each(|(tilt, by)| *tilt += by * limit);
    Some(next)
}

/// Moves towards the proposed values as long as the likelihood rises. `base` is the deviance at `from`, infinite before
/// the first step.
fn shorten(rows: &[Row], from: Point, proposed: Point, ramp: f64, base: f64, dt_s: f64) -> (Point, f64) {
    const HALVINGS: i32 = 30;
    let (mut next, mut reached) = (proposed, deviance_of(rows, &proposed, ramp, dt_s));
    let between = |from: f64, to: f64, share: f64| from + share * (to - from);
    for halving in 1..=HALVINGS {
        if reached <= base {
            break;
        }
        let share = 0.5f64.powi(halving);
        next = Point {
            squares: std::array::from_fn(|at| between(from.squares[at], proposed.squares[at], share)),
            tilt: std::array::from_fn(|at| between(from.tilt[at], proposed.tilt[at], share)),
        };
        reached = deviance_of(rows, &next, ramp, dt_s);
    }
    (next, reached)
}

/// Solves least squares from normal equations (lower triangles) over x ≥ 0 for `free` columns and any x for `signed`
/// ones: of all sets of `free` columns with positive numbers, it takes the one that explains most. This is exact and,
/// with six columns, cheap enough.
fn non_negative(
    normal: &[[f64; UNKNOWNS]; UNKNOWNS],
    right: &[f64; UNKNOWNS],
    free: &[usize],
    signed: &[usize],
) -> Option<[f64; UNKNOWNS]> {
    let mut best = [0.0; UNKNOWNS];
    let mut most = 0.0;
    if right.iter().any(|value| !value.is_finite()) {
        return None;
    }
    // Without any square, the signed columns still move.
    for chosen in u32::from(signed.is_empty())..1 << free.len() {
        let set: Vec<usize> =
            free.iter().enumerate().filter(|(index, _)| chosen & 1 << index != 0).map(|(_, at)| *at).collect();
        let squares = set.len();
        let set: Vec<usize> = set.into_iter().chain(signed.iter().copied()).collect();
        let Some(values) = solve(normal, right, &set) else { continue };
        let explained: f64 = set.iter().zip(values).map(|(at, value)| right[*at] * value).sum();
        if explained > most && values.iter().take(squares).all(|value| *value >= 0.0) {
            most = explained;
            best = [0.0; UNKNOWNS];
            for (at, value) in set.iter().zip(values) {
                best[*at] = value;
            }
        }
    }
    Some(best)
}

/// Returns Cholesky's solution for a set of columns scaled to a diagonal of 1; `None` if they depend on one another.
fn solve(normal: &[[f64; UNKNOWNS]; UNKNOWNS], right: &[f64; UNKNOWNS], set: &[usize]) -> Option<[f64; UNKNOWNS]> {
    /// If the rest of a column is smaller than this share of it, the columns cannot be separated.
    const DEPENDENT: f64 = 1e-12;
    let mut lower = [[0.0f64; UNKNOWNS]; UNKNOWNS];
    let mut values = [0.0; UNKNOWNS];
    let scale = |index: usize| normal[set[index]][set[index]].sqrt();
    for row in 0..set.len() {
        for column in 0..=row {
            let (one, other) = (set[row].max(set[column]), set[row].min(set[column]));
            let known: f64 = (0..column).map(|at| lower[row][at] * lower[column][at]).sum();
            let rest = normal[one][other] / (scale(row) * scale(column)) - known;
            lower[row][column] = if row == column { rest.max(0.0).sqrt() } else { rest / lower[column][column] };
        }
        let own = lower[row][row] * lower[row][row];
        if own.is_nan() || own <= DEPENDENT {
            return None;
        }
        let known: f64 = (0..row).map(|at| lower[row][at] * values[at]).sum();
        values[row] = (right[set[row]] / scale(row) - known) / lower[row][row];
    }
    for row in (0..set.len()).rev() {
        let known: f64 = (row + 1..set.len()).map(|at| lower[at][row] * values[at]).sum();
        values[row] = (values[row] - known) / lower[row][row];
    }
    for (index, value) in values.iter_mut().enumerate().take(set.len()) {
        *value /= scale(index);
    }
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The step stood still if N was held and neither B nor K was present: intervals of N were then those of a known
    /// filter.
    #[test]
    fn a_signed_column_moves_where_no_square_does() {
        let mut normal = [[0.0; UNKNOWNS]; UNKNOWNS];
        normal[1][1] = 2.0;
        normal[SQUARES][SQUARES] = 4.0;
        let mut right = [0.0; UNKNOWNS];
        (right[1], right[SQUARES]) = (-1.0, -6.0);
        let found = non_negative(&normal, &right, &[1], &[SQUARES]).unwrap();
        assert!(found[1] == 0.0 && (found[SQUARES] + 1.5).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn a_column_that_would_be_negative_is_left_out() {
        let mut normal = [[0.0; UNKNOWNS]; UNKNOWNS];
        normal[0][0] = 3.0;
        normal[2][0] = 3.0;
        normal[2][2] = 5.0;
        let of = |[first, third]: [f64; 2]| {
            let mut right = [0.0; UNKNOWNS];
            (right[0], right[2]) = (first, third);
            non_negative(&normal, &right, &[0, 2], &[]).unwrap()
        };
        let rising = of([9.0, 13.0]);
        assert!((rising[0] - 1.0).abs() < 1e-12 && (rising[2] - 2.0).abs() < 1e-12, "{rising:?}");
        let falling = of([9.0, 5.0]);
        assert!((falling[0] - 3.0).abs() < 1e-12 && falling[2] == 0.0, "{falling:?}");
        assert_eq!(of([-1.0, -1.0]), [0.0; UNKNOWNS]);
    }
}
