//! Loudness: how the residual's variance changes with time or temperature.

use super::{Candidate, Kind};
use crate::averages::{MEDIAN, median, sums};
use crate::explanation::{LOUD, Loud, Scedasticity};
use crate::series::Series;
use nalgebra::{DMatrix, DVector};

/// Squares above this are outliers. They carry no information about a variance that changes slowly.
pub(crate) const LARGEST: f64 = 16.0;

/// Initial number of cosines of a course of ln variance over the record.
const COSINES: usize = 12;
/// ln of the largest ratio of variances at two times.
const RANGE: f64 = 12.0;

/// Shortest stretch, samples.
const SHORTEST: usize = 6;
/// Shortest quiet stretch, samples. It is longer because a few rounded values are easily equal.
const SHORTEST_QUIET: usize = 128;

/// Returns the means of squares over blocks, and the samples in a block. Squares are limited relative to the known variance,
/// or to that of a louder block.
fn blocks(series: &Series<'_>) -> (Vec<f64>, usize) {
    let n = series.len();
    let size = (n / 2048).max(64).min(n);
    let residual = series.scores();
    let mean = |block: &[f64]| {
        let squares: Vec<f64> = block.iter().map(|e| e * e).collect();
        let own = median(&mut squares.clone()) / MEDIAN;
        let largest = LARGEST * own.max(1.0);
        squares.iter().map(|square| square.min(largest)).sum::<f64>() / size as f64
    };
    (residual.chunks_exact(size).map(mean).collect(), size)
}

/// Finds again how the variance depends on time or temperature, if that is known already.
pub(crate) fn again(series: &Series<'_>, now: &Scedasticity) -> Option<Scedasticity> {
    let (mut means, size) = blocks(series);
    // This dependence of the variance has been divided out of the residual; the variance of stretches stays divided
    // out.
    let n = series.len();
    let temperature = series.setting().courses.temperature().unwrap_or_default();
    let known = |t: usize| match now {
        Scedasticity::PerDegree(slope) => (slope * temperature.get(t).copied().unwrap_or_default()).exp(),
        Scedasticity::Profile(values) => crate::explanation::profile(values, t, n).exp(),
    };
    for (block, mean) in means.iter_mut().enumerate() {
        *mean *= (block * size..(block + 1) * size).map(known).sum::<f64>() / size as f64;
    }
    match now {
        Scedasticity::PerDegree(_) => {
            let (_, slopes) = regression(&means, &[temperatures(series, size)?], size)?;
            Some(Scedasticity::PerDegree(slopes[0]))
        }
        Scedasticity::Profile(_) => Some(Scedasticity::Profile(detailed(&means, size)?)),
    }
}

/// Returns the mean square in each stretch that is not left out over that in no stretch, beside the other changes of
/// the variance.
pub(crate) fn ratios(series: &Series<'_>) -> Vec<Option<f64>> {
    let values = series.scores();
    let loud = &series.explanation.loud;
    let mut rest = vec![true; values.len()];
    loud.iter().for_each(|of| rest[series.spoilt(of)].fill(false));
    let square = |e: &f64| (e * e).min(LARGEST);
    let (sum, count) =
        values.iter().zip(&rest).filter(|(_, rest)| **rest).fold((0.0, 0.0), |(s, c), (e, _)| (s + square(e), c + 1.0));
    let level = sum / count;
    let of = |one: &Loud| {
        let inside = &values[one.from..one.to];
        let own = inside.iter().map(square).sum::<f64>() / inside.len() as f64;
        // The residual was divided by the known factor of the stretch.
        let ratio = one.ratio * own / level;
        (one.ratio <= LOUD && ratio.is_finite() && ratio > 0.0).then_some(ratio.min(LOUD))
    };
    loud.iter().map(of).collect()
}

fn temperatures(series: &Series<'_>, size: usize) -> Option<Vec<f64>> {
    let temperature = series.setting().courses.temperature()?;
    Some(temperature.chunks_exact(size).map(|block| block.iter().sum::<f64>() / size as f64).collect())
}

/// Returns the gain of a smooth course of ln variance, and the course at equally spaced instants. Cosines are level at both ends
/// of the record; with `slopes` the course has any slope there.
fn cosines(means: &[f64], size: usize, count: usize, slopes: bool) -> Option<(f64, Vec<f64>)> {
    let instants = 1 + 60 * count.div_ceil(2 * COSINES).max(1);
    let wave = |order: usize, share: f64| match order.checked_sub(count) {
        None | Some(0) => (std::f64::consts::PI * order as f64 * share).cos(),
        Some(power) => share.powi(power as i32),
    };
    let orders = || 1..=if slopes { count + 2 } else { count };
    let column = |order: usize| -> Vec<f64> {
        (0..means.len()).map(|row| wave(order, (row as f64 + 0.5) / means.len() as f64)).collect()
    };
    let columns: Vec<Vec<f64>> = orders().map(column).collect();
    let (gain, factors) = regression(means, &columns, size)?;
    let at = |instant: usize| {
        let share = instant as f64 / (instants - 1) as f64;
        factors.iter().zip(orders()).map(|(factor, order)| factor * wave(order, share)).sum()
    };
    Some((gain, (0..instants).map(at).collect()))
}

/// Returns the course of as many functions as are worth their number. A course that is far from even is seen in more
/// detail.
fn detailed(means: &[f64], size: usize) -> Option<Vec<f64>> {
    /// Nats that each function has to gain.
    const EACH: f64 = 3.0;
    let of = |(times, slopes): (usize, bool)| {
        let count = times * COSINES;
        if times > 1 && 4 * count > means.len() {
            return None;
        }
        let (gain, values) = cosines(means, size, count, slopes)?;
        Some((gain - EACH * (count + 2 * usize::from(slopes)) as f64, values))
    };
    let all = [(1, false), (1, true), (2, true), (4, true)].into_iter().filter_map(of);
    all.reduce(|a, b| if b.0 > a.0 { b } else { a }).map(|(_, values)| values)
}

/// Returns the gain and coefficients of ln variance = Xβ over a constant, for means of `size` squares.
fn regression(means: &[f64], columns: &[Vec<f64>], size: usize) -> Option<(f64, Vec<f64>)> {
    let rows = means.len();
    let level = means.iter().sum::<f64>() / rows as f64;
    if level <= 0.0 {
        return None;
    }
    let design = DMatrix::from_fn(
        rows,
        columns.len() + 1,
        |row, column| {
            if column == 0 { 1.0 } else { columns[column - 1][row] }
        },
    );
    let factor = (design.transpose() * &design).cholesky()?;
    let mut beta = DVector::zeros(columns.len() + 1);
    beta[0] = level.ln();
    for _ in 0..30 {
        let eta = (&design * &beta).map(|eta| eta.clamp(-RANGE, RANGE));
        let mu: Vec<f64> = eta.iter().map(|eta| eta.exp()).collect();
        let work = DVector::from_fn(rows, |row, _| eta[row] + (means[row] - mu[row]) / mu[row]);
        let next = factor.solve(&(design.transpose() * work));
        let change = (&next - &beta).amax();
        beta = next;
        if change < 1e-7 {
            break;
        }
    }
    let fitted: Vec<f64> = (&design * &beta).iter().map(|eta| eta.clamp(-RANGE, RANGE)).collect();
    let likelihood: f64 = fitted.iter().zip(means).map(|(eta, mean)| -(eta + mean / eta.exp())).sum();
    let reference = -(level.ln() + 1.0) * rows as f64;
    let gain = 0.5 * size as f64 * (likelihood - reference);
    // A fit that did not converge is discarded.
    let is_fit = gain.is_finite() && fitted.iter().all(|eta| eta.abs() < RANGE) && gain > -1.0;
    is_fit.then(|| (gain, beta.iter().copied().skip(1).collect()))
}

/// Returns the nats gained by the best multiple of a course of ln variance, one value per sample, over the course
/// itself.
pub fn otherwise(series: &Series<'_>, shape: &[f64]) -> f64 {
    let (means, size) = blocks(series);
    let column: Vec<f64> = shape.chunks_exact(size).map(|block| block.iter().sum::<f64>() / size as f64).collect();
    let Some((best, _)) = regression(&means, std::slice::from_ref(&column), size) else { return 0.0 };
    let rows = means.len() as f64;
    let level = means.iter().sum::<f64>() / rows;
    let own = means.iter().zip(&column).map(|(mean, x)| mean / x.exp()).sum::<f64>() / rows;
    // Each has its likeliest constant.
    let as_it_is = 0.5 * size as f64 * (rows * (level.ln() - own.ln()) - column.iter().sum::<f64>());
    best - as_it_is
}

/// Searches for a variance that depends on temperature.
pub fn per_degree(series: &Series<'_>) -> Option<Candidate> {
    if series.explanation.scedasticity.is_some() {
        return None;
    }
    let (means, size) = blocks(series);
    let (gain, slopes) = regression(&means, &[temperatures(series, size)?], size)?;
    let mut explanation = series.explanation.clone();
    explanation.scedasticity = Some(Scedasticity::PerDegree(slopes[0]));
    Some(Candidate::missing(Kind::VariancePerDegree, gain, explanation))
}

/// Searches for a variance that changes smoothly with time.
pub fn profile(series: &Series<'_>) -> Option<Candidate> {
    if series.explanation.scedasticity.is_some() {
        return None;
    }
    let (means, size) = blocks(series);
    let (gain, values) = cosines(&means, size, COSINES, false)?;
    let mut explanation = series.explanation.clone();
    explanation.scedasticity = Some(Scedasticity::Profile(values));
    Some(Candidate::missing(Kind::VarianceProfile, gain, explanation))
}

/// Sums of squares up to each sample, unlimited and limited.
struct Sums {
    whole: Vec<f64>,
    limited: Vec<f64>,
    /// Number of samples within 1 of 0.
    small: Vec<f64>,
}

impl Sums {
    fn of(residual: &[f64]) -> Self {
        let squares = || residual.iter().map(|e| e * e);
        let small = squares().map(|square| if square < 1.0 { 1.0 } else { 0.0 });
        Self { whole: sums(squares()), limited: sums(squares().map(|square| square.min(LARGEST))), small: sums(small) }
    }
    /// Returns the gain in nats of a different variance inside, from limited squares, so that an outlier is no stretch.
    fn gain(&self, from: usize, to: usize, level: f64) -> f64 {
        let sum = (self.limited[to] - self.limited[from]) / level;
        let quiet = sum < (to - from) as f64 && to - from < SHORTEST_QUIET;
        if quiet { 0.0 } else { gain(sum, to - from) }
    }
    /// Returns whether the gain is surely below `least`: r − 1 − ln r is below (r − 1)²/2, above 1, and below that over
    /// r otherwise.
    fn hopeless(&self, from: usize, to: usize, level: f64, least: f64) -> bool {
        let count = (to - from) as f64;
        let ratio = (self.limited[to] - self.limited[from]) / (level * count);
        0.25 * count * (ratio - 1.0).powi(2) < least * ratio.clamp(1e-6, 1.0)
    }
    /// Returns the variance inside, its ratio to that outside, and the gain of having both, from unlimited squares.
    fn split(&self, from: usize, to: usize) -> (f64, f64, f64) {
        let all = self.whole.len() - 1;
        let (inside, whole) = (self.whole[to] - self.whole[from], self.whole[all]);
        let (count, rest) = ((to - from) as f64, (all - (to - from)) as f64);
        let (own, other) = (inside / count, (whole - inside) / rest);
        let mean = whole / all as f64;
        (own, own / other, 0.5 * (all as f64 * mean.ln() - count * own.max(1e-9).ln() - rest * other.max(1e-9).ln()))
    }
    /// Returns whether a stretch is loud throughout and not because of a few outliers. A normal distribution's small
    /// values are as rare as its variance implies. A quiet stretch has to be long, because a few rounded values are
    /// easily equal.
    fn genuine(&self, from: usize, to: usize, own: f64, ratio: f64) -> bool {
        if ratio < 1.0 {
            return to - from >= SHORTEST_QUIET;
        }
        let expected = statrs::function::erf::erf((0.5 / own).sqrt());
        let spread = (expected * (1.0 - expected) / (to - from) as f64).sqrt();
        self.small(from, to) < expected + 4.0 * spread + 0.1 * (0.683 - expected)
    }
    /// Returns the share of samples within 1 of 0: 0.683 for a standard normal distribution.
    fn small(&self, from: usize, to: usize) -> f64 {
        (self.small[to] - self.small[from]) / (to - from) as f64
    }
}

fn gain(sum: f64, count: usize) -> f64 {
    let ratio = (sum / count as f64).max(1e-6);
    0.5 * count as f64 * (ratio - 1.0 - ratio.ln())
}

/// Returns the mean square of the samples in no stretch.
fn level(residual: &[f64], stretches: &[Loud]) -> f64 {
    let mut outside = vec![true; residual.len()];
    stretches.iter().for_each(|loud| outside[loud.from..loud.to].fill(false));
    let there = residual.iter().zip(&outside).filter(|(_, outside)| **outside);
    let (sum, count) = there.fold((0.0, 0), |(sum, count), (e, _)| (sum + e * e, count + 1));
    if count > 0 && sum > 0.0 { sum / f64::from(count) } else { 1.0 }
}

/// Returns the variance of the usual noise among values whose overall variance is 1, if it clearly differs from 1. This
/// is the variance of most long blocks, or else the block variance nearest to the model's.
///
/// "Louder until here" and "quieter from here on" are two names of one change.
fn usual(values: &[f64], declared: f64) -> f64 {
    const BLOCKS: usize = 64;
    const SHARES: [f64; 5] = [0.1, 0.25, 0.5, 0.75, 0.9];
    /// ln of the ratio from which on two variances differ clearly.
    const CLEARLY: f64 = 0.3;
    /// A variance that this part of the blocks has is beyond doubt that of the usual noise.
    const MOST: f64 = 0.6;
    let size = (values.len() / BLOCKS).max(64);
    let mean = |block: &[f64]| block.iter().map(|e| e * e).sum::<f64>() / size as f64;
    let mut means: Vec<f64> = values.chunks_exact(size).map(mean).filter(|mean| *mean > 0.0).collect();
    means.sort_unstable_by(f64::total_cmp);
    let own = SHARES.iter().filter_map(|share| means.get((share * means.len() as f64) as usize)).copied();
    let alike = |own: f64| means.iter().copied().filter(move |mean| (mean / own).ln().abs() < CLEARLY);
    let most = own.clone().map(|own| (alike(own).count(), own)).max_by_key(|(count, _)| *count);
    if let Some((count, own)) = most.filter(|(count, _)| *count as f64 > MOST * means.len() as f64) {
        let own = alike(own).sum::<f64>() / count as f64;
        return if own.ln().abs() > CLEARLY { own } else { 1.0 };
    }
    let apart = |variance: &f64| (variance / declared).ln().abs();
    let nearest = own.min_by(|a, b| apart(a).total_cmp(&apart(b))).filter(|own| own.ln().abs() > CLEARLY);
    nearest.filter(|own| apart(own) < apart(&1.0)).unwrap_or(1.0)
}

/// Returns the nats that a stretch's two ends and ratio cost in a record of `samples` samples.
pub(crate) fn price_of_one(samples: usize) -> f64 {
    const RATIO: f64 = 3.0;
    RATIO + 2.0 * (samples as f64).ln()
}

/// Finds stretches of a different variance one after the other, each at the place of the greatest gain. Bursts and a
/// long stretch are two effects.
pub fn intervals(series: &Series<'_>) -> Vec<Candidate> {
    const MOST: usize = 40;
    const MOST_OF_RECORD: f64 = 0.2;
    const REFUSED: usize = 6;
    let n = series.len();
    if n < 8 * SHORTEST {
        return Vec::new();
    }
    let mut residual = series.scores().into_owned();
    // The values that replace excluded samples carry no information.
    let known: Vec<Loud> = series.explanation.loud.iter().filter(|loud| loud.ratio > LOUD).copied().collect();
    let outside = level(&residual, &known);
    for loud in &known {
        residual[loud.from..loud.to].fill(outside.sqrt());
    }
    let bursts = series.setting().bursts;
    let declared = (series.setting().white - series.explanation.law.levels[0]).exp();
    let mut gains: Vec<f64> = Vec::new();
    let mut found: Vec<Loud> = Vec::new();
    // Places that look loud because of a few values; they do not prevent other places from being found.
    let mut refused: Vec<(usize, usize)> = Vec::new();
    while found.len() < MOST {
        // Brings the stretches found so far to the level of the rest, and that level to 1.
        let level = level(&residual, &found);
        let mut even: Vec<f64> = residual.iter().map(|e| e / level.sqrt()).collect();
        for loud in &mut found {
            let inside = &mut even[loud.from..loud.to];
            loud.ratio = inside.iter().map(|e| e * e).sum::<f64>() / inside.len() as f64;
            inside.iter_mut().for_each(|e| *e /= loud.ratio.sqrt());
        }
        let usual = usual(&even, declared / level);
        even.iter_mut().for_each(|e| *e /= usual.sqrt());
        // The stretches that were found are already even with the rest.
        for loud in &found {
            even[loud.from..loud.to].iter_mut().for_each(|e| *e *= usual.sqrt());
        }
        let excluded = known.iter().map(|loud| (loud.from, loud.to)).chain(refused.iter().copied());
        excluded.for_each(|(from, to)| even[from..to].fill(1.0));
        let sums = Sums::of(&even);
        let limited = if usual == 1.0 { sums.limited[n] / n as f64 } else { 1.0 };
        let Some((mut from, mut to)) = loudest(&sums, 0..n, n * 9 / 10, limited) else { break };
        let (mut own, mut ratio, mut gain) = sums.split(from, to);
        let mut genuine = sums.genuine(from, to, own, ratio);
        // Several bursts with quiet between them are not one burst: take the loudest part.
        while !genuine && to - from >= 4 * SHORTEST {
            let Some(part) = loudest(&sums, from..to, (to - from) / 2, limited) else { break };
            (from, to) = part;
            (own, ratio, gain) = sums.split(from, to);
            genuine = sums.genuine(from, to, own, ratio);
        }
        // A quieter stretch inside a loud one is its soft end.
        genuine &= ratio > 1.0 || found.iter().all(|loud| loud.to <= from || to <= loud.from);
        let price = if found.is_empty() { 0.0 } else { price_of_one(n) };
        if gain < price.max(8.0) || (!genuine && refused.len() >= REFUSED) {
            if found.is_empty() && genuine {
                // Its gain is reported even if it is not worth its price.
                gains.push(gain);
                found.push(Loud { from, to, ratio });
            }
            break;
        }
        if !genuine {
            refused.push((from, to));
            continue;
        }
        gains.push(gain - price);
        found.push(Loud { from, to, ratio });
    }
    join(&mut found, &mut gains);
    let of = |kind: Kind, long: bool| {
        let own = || found.iter().zip(&gains).filter(move |(loud, _)| loud.is_interval(n, bursts) == long);
        let stretches: Vec<Loud> = own().map(|(loud, _)| *loud).collect();
        // If much of the record is loud beside the longest stretch, no quiet stretch represents its noise.
        let lengths = || stretches.iter().map(|loud| loud.to - loud.from);
        let others = lengths().sum::<usize>() - lengths().max().unwrap_or(0);
        let too_many = others as f64 > MOST_OF_RECORD * n as f64;
        let gain = own().map(|(_, gain)| gain).sum::<f64>();
        let mut explanation = series.explanation.clone();
        // The noise is that of the samples that are not left out.
        let left_out: Vec<Loud> = stretches.iter().filter(|loud| loud.ratio > LOUD).copied().collect();
        if !left_out.is_empty() {
            explanation.law.levels[0] += level(&residual, &left_out).ln();
        }
        explanation.loud.extend(stretches);
        (gain > 0.0 && !too_many).then_some(Candidate::missing(kind, gain, explanation))
    };
    // A change of variance that is known already is not reported twice.
    let long = series.explanation.scedasticity.is_none().then(|| of(Kind::VarianceInterval, true));
    long.flatten().into_iter().chain(of(Kind::Bursts, false)).collect()
}

/// Joins stretches that follow one another, in order of time: the front of a burst may be found separately.
fn join(found: &mut Vec<Loud>, gains: &mut Vec<f64>) {
    /// Maximum number of samples between two stretches of one burst.
    const NEAR: usize = 2;
    /// Maximum ratio of their variances.
    const ALIKE: f64 = 4.0;
    let is_one = |a: &Loud, b: &Loud| {
        let apart = a.ratio / b.ratio;
        (a.to..=a.to + NEAR).contains(&b.from)
            && a.ratio > 1.0
            && b.ratio > 1.0
            && (1.0 / ALIKE..ALIKE).contains(&apart)
    };
    let mut order: Vec<usize> = (0..found.len().min(gains.len())).collect();
    order.sort_by_key(|own| found[*own].from);
    let mut joined: Vec<(Loud, f64)> = Vec::new();
    for own in order {
        let (next, gain) = (found[own], gains[own]);
        match joined.last_mut().filter(|(last, _)| is_one(last, &next)) {
            Some((last, sum)) => {
                let (a, b) = ((last.to - last.from) as f64, (next.to - next.from) as f64);
                *last = Loud { to: next.to, ratio: (a * last.ratio + b * next.ratio) / (a + b), ..*last };
                *sum += gain;
            }
            None => joined.push((next, gain)),
        }
    }
    (*found, *gains) = joined.into_iter().unzip();
}

/// Returns the stretch with the greatest gain: first on a coarse set of places and lengths, then with its ends moved.
fn loudest(sums: &Sums, within: std::ops::Range<usize>, longest: usize, level: f64) -> Option<(usize, usize)> {
    /// The distance about an end within which a better end is searched, samples.
    const NEAR: usize = 64;
    let mut best: (f64, usize, usize) = (0.0, 0, 0);
    let (first, end) = (within.start, within.end);
    let mut length = SHORTEST;
    while length <= longest {
        let step = (length / 4).max(1);
        let mut from = first;
        while from + length <= end {
            let gain = if sums.hopeless(from, from + length, level, best.0) {
                0.0
            } else {
                sums.gain(from, from + length, level)
            };
            if gain > best.0 {
                best = (gain, from, from + length);
            }
            from += step;
        }
        length = (length * 4 / 3).max(length + 1);
    }
    if best.0 <= 0.0 {
        return None;
    }
    let mut step = (best.2 - best.1) / 4;
    loop {
        let mut moved = false;
        for (from, to) in [
            (best.1.saturating_sub(step).max(first), best.2),
            (best.1 + step, best.2),
            (best.1, (best.2 + step).min(end)),
            (best.1, best.2.saturating_sub(step)),
        ] {
            if to >= from + SHORTEST && to - from <= longest {
                let gain = sums.gain(from, to, level);
                if gain > best.0 {
                    best = (gain, from, to);
                    moved = true;
                }
            }
        }
        if !moved {
            if step <= 1 {
                break;
            }
            step = (step / 2).max(1);
        }
    }
    // A few small values beside an end keep it from moving sample by sample.
    for _ in 0..2 {
        let (_, from, to) = best;
        let near = |end: usize| end.saturating_sub(NEAR).max(first)..=(end + NEAR).min(within.end);
        let begins = near(from).map(|from| (from, to));
        let all = begins.chain(near(to).map(|to| (from, to)));
        for (from, to) in all.filter(|(from, to)| *to >= from + SHORTEST && to - from <= longest) {
            let gain = sums.gain(from, to, level);
            if gain > best.0 {
                best = (gain, from, to);
            }
        }
    }
    Some((best.1, best.2))
}
