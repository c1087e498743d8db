//! The likelihood of spectral sums under a noise model, and its maximum over coefficients that are not negative.
//!
//! The z_k of a stretch are independent and normal with mean Rdt·μ_k and variance 4 sin²(πu)·S(f)/dt: exactly for white noise
//! and random walks, to leading order for flicker and Gauss–Markov noise, whose end effects are allowed for. A bin of n of
//! them is a gamma variable of shape n/2, so that −2 log L = Σ n (log λ + P/λ) with P the mean square and λ, linear in the
//! squared coefficients, the mean of what is expected.
//!
//! # Source
//! P. Whittle, Ark. Mat. 2 (1953) 423, for the likelihood; P. McCullagh, J. A. Nelder, Generalized Linear Models (1989),
//! section 8, for the scoring.

use super::sums::DstSums;
use crate::noise::fit::Term;

/// Coefficients whose squares the spectrum is linear in: N, B, K, Q of [`Term`], and a Gauss–Markov process' σ.
pub(super) const SQUARES: usize = 5;
/// The place of σ.
pub(super) const SIGMA: usize = 4;
const SCORING_STEPS: usize = 60;
/// −2 log L is known to this; roots of differences of it are what intervals are made of.
const SETTLED: f64 = 1e-8;

/// A place among the squares.
pub(super) fn place(term: Term) -> Option<usize> {
    match term {
        Term::N => Some(0),
        Term::B => Some(1),
        Term::K => Some(2),
        Term::Q => Some(3),
        Term::R => None,
    }
}

/// Which terms a model has.
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
    pub(super) fn has_gauss_markov(self) -> bool {
        self.squares[SIGMA]
    }
    /// How many numbers are fitted.
    pub(super) fn parameters(self) -> usize {
        self.squares.iter().filter(|has| **has).count() + usize::from(self.ramp) + usize::from(self.has_gauss_markov())
    }
}

/// What is held at a value while the others are fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Held {
    Nothing,
    /// A square.
    Square(usize, f64),
    /// The ramp, U per s.
    Ramp(f64),
}

/// Coefficients of a model and how likely they make the data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Model {
    pub(super) terms: Terms,
    /// Squared coefficients, ≥ 0.
    pub(super) squares: [f64; SQUARES],
    /// Correlation time of the Gauss–Markov process, s.
    pub(super) tc_s: f64,
    /// The ramp, U per s, with its sign.
    pub(super) ramp: f64,
    /// −2 log L less a constant of the data.
    pub(super) deviance: f64,
}

impl Model {
    /// The coefficient of a term; the ramp's with its sign.
    pub(super) fn coefficient(&self, term: Term) -> f64 {
        place(term).map_or(self.ramp, |at| self.squares[at].sqrt())
    }
}

/// One bin: n squares of mean `power`, and the mean of what each term is expected to give for a coefficient of 1.
#[derive(Debug, Clone, Copy)]
struct Row {
    count: f64,
    power: f64,
    basis: [f64; SQUARES],
    /// 4 sin²(πu) and one over the stretch's length.
    sine: f64,
    ends: f64,
    cross: f64,
    ramp: f64,
    /// A rough level: of the bin and its neighbours.
    level: f64,
}

/// The data, ready for models.
#[derive(Debug, Clone)]
pub(super) struct Likelihood {
    rows: Vec<Row>,
    dt_s: f64,
}

impl Likelihood {
    /// Takes the bins that touch none of `excluded_bands_hz`, nor neighbour one that does.
    pub(super) fn new(sums: &DstSums, rate_hz: f64, excluded_bands_hz: &[[f64; 2]]) -> Self {
        /// A bin is 3.7 % wide: what a line leaks beyond its neighbour falls with the square of the distance.
        const MARGIN: f64 = 1.037;
        let dt_s = 1.0 / rate_hz;
        let excluded = |[low, high]: [f64; 2]| {
            excluded_bands_hz.iter().any(|[from, to]| high * rate_hz >= from / MARGIN && low * rate_hz <= to * MARGIN)
        };
        let mut rows: Vec<Row> = sums
            .filled()
            .filter(|(range, _)| !excluded(*range))
            .map(|(_, bin)| Row {
                count: bin.count,
                power: bin.power / bin.count,
                basis: [
                    1.0 / dt_s,
                    bin.flicker / bin.count,
                    dt_s * bin.walk / bin.count,
                    bin.angle / bin.count / (dt_s * dt_s),
                    0.0,
                ],
                sine: bin.count / bin.walk,
                ends: bin.ends / bin.count,
                cross: bin.cross / bin.count,
                ramp: bin.ramp / bin.count,
                level: 0.0,
            })
            .collect();
        level(&mut rows);
        Self { rows, dt_s }
    }

    /// How many squares there are, and whether any differs from 0.
    pub(super) fn extent(&self) -> (f64, bool) {
        (self.rows.iter().map(|row| row.count).sum(), self.rows.iter().any(|row| row.power > 0.0))
    }

    /// The longest stretch, s; 0 without data.
    pub(super) fn longest_s(&self) -> f64 {
        self.rows.iter().map(|row| self.dt_s / row.ends).fold(0.0, f64::max)
    }

    pub(super) fn dt_s(&self) -> f64 {
        self.dt_s
    }

    /// The largest likelihood of `terms`, beginning from `start` where there is one. None where nothing fits.
    pub(super) fn maximise(&self, terms: Terms, tc_s: f64, held: Held, start: Option<&Model>) -> Option<Model> {
        let rows = self.with_gauss_markov(terms, tc_s);
        let mut ramp = match held {
            Held::Ramp(value) => value * self.dt_s,
            _ => start.filter(|_| terms.ramp).map_or(0.0, |start| start.ramp * self.dt_s),
        };
        let mut squares = [0.0; SQUARES];
        let mut deviance = f64::INFINITY;
        if let Some(start) = start {
            squares = std::array::from_fn(|at| if terms.squares[at] { start.squares[at] } else { 0.0 });
            if let Held::Square(at, value) = held {
                squares[at] = value;
            }
            deviance = deviance_of(&rows, &squares, ramp);
        }
        for step in 0..SCORING_STEPS {
            let begun = deviance.is_finite();
            let lambda = |row: &Row| if begun { spectrum(row, &squares) } else { row.level };
            if terms.ramp && !matches!(held, Held::Ramp(_)) {
                ramp = generalised_mean(&rows, &lambda).unwrap_or(ramp);
            }
            let proposed = scoring_step(&rows, &lambda, terms, held, ramp)?;
            let (next, reached) = shorten(&rows, squares, proposed, ramp, begun);
            let before = if begun && terms.ramp { deviance_of(&rows, &squares, ramp) } else { deviance };
            if begun && reached >= before - SETTLED {
                if reached < before {
                    (squares, deviance) = (next, reached);
                } else {
                    deviance = before;
                }
                // The first step from somebody else's maximum may well lead nowhere, but the ramp's has been taken.
                if step > 0 || !terms.ramp {
                    break;
                }
            } else {
                (squares, deviance) = (next, reached);
            }
        }
        let model = Model { terms, squares, tc_s, ramp: ramp / self.dt_s, deviance };
        deviance.is_finite().then_some(model)
    }

    fn with_gauss_markov(&self, terms: Terms, tc_s: f64) -> Vec<Row> {
        let mut rows = self.rows.clone();
        if terms.has_gauss_markov() {
            let decay = self.dt_s / tc_s;
            for row in &mut rows {
                row.basis[SIGMA] = gauss_markov(row.sine, row.ends, decay);
            }
        }
        rows
    }

    /// The smallest coefficient of `term` that by itself would make up `model` at some frequency.
    pub(super) fn whole(&self, term: Term, model: &Model) -> Option<f64> {
        let rows = self.with_gauss_markov(model.terms, model.tc_s);
        let of = |row: &Row| match place(term) {
            Some(at) => (spectrum(row, &model.squares) / row.basis[at]).sqrt(),
            None => (spectrum(row, &model.squares) / row.ramp).sqrt() / self.dt_s,
        };
        rows.iter().map(of).filter(|c| c.is_finite() && *c > 0.0).min_by(f64::total_cmp)
    }

    /// Expected mean squares over found ones by groups of bins: count, found and expected, from low to high frequency.
    pub(super) fn groups(&self, model: &Model, least: f64, ratio: f64) -> Vec<(f64, f64)> {
        let rows = self.with_gauss_markov(model.terms, model.tc_s);
        let mut groups: Vec<(f64, f64)> = Vec::new();
        let (mut count, mut sum, mut first) = (0.0, 0.0, 0.0);
        for row in &rows {
            if count == 0.0 {
                first = row.sine;
            }
            count += row.count;
            sum += row.count * residual_power(row, model.ramp * self.dt_s) / spectrum(row, &model.squares);
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

/// Spectrum over dt of a Gauss–Markov process with σ = 1 at s = 4 sin²(πu), sampled, with the first-order effect of a
/// stretch's ends: a process as long as the stretch looks smaller than it is.
///
/// # Source
/// The sampled process is an AR(1) with φ = e^(−dt/Tc). Ends: the variance of ∫ y cos(ωt) dt over T is
/// T·2a/(a² + ω²) · (1 − 2a/(T(a² + ω²))) for a = 1/Tc ≫ 1/T.
fn gauss_markov(s: f64, ends: f64, decay: f64) -> f64 {
    let (phi, rest) = ((-decay).exp(), -(-decay).exp_m1());
    let ends = 2.0 * decay * ends / (decay * decay + s);
    rest * (1.0 + phi) / (rest * rest + phi * s) * (1.0 - ends).max(0.0)
}

/// Means over bins until ten squares are in: weights to begin with.
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
        // A band without noise would else weigh more than all others.
        row.level = row.level.max(1e-12 * top);
    }
}

fn spectrum(row: &Row, squares: &[f64; SQUARES]) -> f64 {
    row.basis.iter().zip(squares).map(|(basis, square)| basis * square).sum()
}

fn residual_power(row: &Row, ramp: f64) -> f64 {
    (row.power + ramp * (ramp * row.ramp - 2.0 * row.cross)).max(0.0)
}

/// −2 log L against that of the rough levels, which keeps the sum small and its digits.
fn deviance_of(rows: &[Row], squares: &[f64; SQUARES], ramp: f64) -> f64 {
    let of = |row: &Row| {
        let lambda = spectrum(row, squares);
        row.count * ((lambda / row.level).ln() + residual_power(row, ramp) / lambda - 1.0)
    };
    let sum: f64 = rows.iter().map(of).sum();
    if sum.is_nan() { f64::INFINITY } else { sum }
}

/// The ramp by generalised least squares.
fn generalised_mean(rows: &[Row], lambda: &impl Fn(&Row) -> f64) -> Option<f64> {
    let (cross, ramp) = rows.iter().fold((0.0, 0.0), |(cross, ramp), row| {
        let weight = row.count / lambda(row);
        (cross + weight * row.cross, ramp + weight * row.ramp)
    });
    Some(cross / ramp).filter(|mean| mean.is_finite())
}

/// One step of Fisher scoring: weighted least squares over squares that are not negative.
fn scoring_step(
    rows: &[Row],
    lambda: &impl Fn(&Row) -> f64,
    terms: Terms,
    held: Held,
    ramp: f64,
) -> Option<[f64; SQUARES]> {
    let fixed = match held {
        Held::Square(at, value) => Some((at, value)),
        _ => None,
    };
    let mut normal = [[0.0; SQUARES]; SQUARES];
    let mut right = [0.0; SQUARES];
    for row in rows {
        let weight = row.count / lambda(row).powi(2);
        let target = residual_power(row, ramp) - fixed.map_or(0.0, |(at, value)| row.basis[at] * value);
        for (one, basis) in row.basis.iter().enumerate() {
            let weighted = weight * basis;
            right[one] += weighted * target;
            for (entry, other) in normal[one].iter_mut().zip(&row.basis).take(one + 1) {
                *entry += weighted * other;
            }
        }
    }
    let free: Vec<usize> =
        (0..SQUARES).filter(|at| terms.squares[*at] && fixed.is_none_or(|(held, _)| held != *at)).collect();
    let mut squares = non_negative(&normal, &right, &free)?;
    if let Some((at, value)) = fixed {
        squares[at] = value;
    }
    Some(squares)
}

/// Goes towards what is proposed as far as the likelihood rises.
fn shorten(
    rows: &[Row],
    from: [f64; SQUARES],
    proposed: [f64; SQUARES],
    ramp: f64,
    begun: bool,
) -> ([f64; SQUARES], f64) {
    const HALVINGS: i32 = 30;
    let full = deviance_of(rows, &proposed, ramp);
    if !begun {
        return (proposed, full);
    }
    let base = deviance_of(rows, &from, ramp);
    let (mut next, mut reached) = (proposed, full);
    for halving in 1..=HALVINGS {
        if reached <= base {
            break;
        }
        let share = 0.5f64.powi(halving);
        next = std::array::from_fn(|at| from[at] + share * (proposed[at] - from[at]));
        reached = deviance_of(rows, &next, ramp);
    }
    (next, reached)
}

/// Least squares from normal equations (lower triangles) over x ≥ 0: of all sets of `free` columns that give positive
/// numbers, the one that explains most. Exact, and with five columns cheaper than being clever.
fn non_negative(normal: &[[f64; SQUARES]; SQUARES], right: &[f64; SQUARES], free: &[usize]) -> Option<[f64; SQUARES]> {
    let mut best = [0.0; SQUARES];
    let mut most = 0.0;
    if right.iter().any(|value| !value.is_finite()) {
        return None;
    }
    for chosen in 1u32..1 << free.len() {
        let set: Vec<usize> =
            free.iter().enumerate().filter(|(index, _)| chosen & 1 << index != 0).map(|(_, at)| *at).collect();
        let Some(values) = solve(normal, right, &set) else { continue };
        let explained: f64 = set.iter().zip(values).map(|(at, value)| right[*at] * value).sum();
        if explained > most && values.iter().take(set.len()).all(|value| *value >= 0.0) {
            most = explained;
            best = [0.0; SQUARES];
            for (at, value) in set.iter().zip(values) {
                best[*at] = value;
            }
        }
    }
    Some(best)
}

/// Cholesky's solution for a set of columns scaled to a diagonal of 1; None where they depend on one another.
fn solve(normal: &[[f64; SQUARES]; SQUARES], right: &[f64; SQUARES], set: &[usize]) -> Option<[f64; SQUARES]> {
    /// Columns whose rest is smaller than this share of them are not told apart.
    const DEPENDENT: f64 = 1e-12;
    let mut lower = [[0.0f64; SQUARES]; SQUARES];
    let mut values = [0.0; SQUARES];
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

    #[test]
    fn a_column_that_would_be_negative_is_left_out() {
        let mut normal = [[0.0; SQUARES]; SQUARES];
        normal[0][0] = 3.0;
        normal[2][0] = 3.0;
        normal[2][2] = 5.0;
        let of = |right: [f64; 2]| non_negative(&normal, &[right[0], 0.0, right[1], 0.0, 0.0], &[0, 2]).unwrap();
        let rising = of([9.0, 13.0]);
        assert!((rising[0] - 1.0).abs() < 1e-12 && (rising[2] - 2.0).abs() < 1e-12, "{rising:?}");
        let falling = of([9.0, 5.0]);
        assert!((falling[0] - 3.0).abs() < 1e-12 && falling[2] == 0.0, "{falling:?}");
        assert_eq!(of([-1.0, -1.0]), [0.0; SQUARES]);
    }
}
