//! Facts: properties that the values show without inference: a step that all values are multiples of, limits, repeats
//! and stamps.

use super::oddities::{self, Oddity};
use std::collections::HashMap;

/// The facts that one channel's values show.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Facts {
    /// The step that the values are multiples of.
    pub step: Option<f64>,
    /// The least value, if the channel was cut off there.
    pub low: Option<f64>,
    /// The greatest value, if the channel was cut off there.
    pub high: Option<f64>,
    /// Nats by which one value is more frequent than by chance.
    pub atom: f64,
}

/// Returns the facts of a channel's values (finite, without missing samples).
pub fn of(values: &[f64]) -> Facts {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let (Some(first), Some(last)) = (sorted.first().copied(), sorted.last().copied()) else { return Facts::default() };
    let rounding = 8.0 * f64::EPSILON * first.abs().max(last.abs());
    // Values and their counts.
    let mut counted: Vec<(f64, usize)> = Vec::new();
    for value in sorted {
        match counted.last_mut() {
            Some((own, count)) if value - *own <= rounding => *count += 1,
            _ => counted.push((value, 1)),
        }
    }
    let step = step(&counted, values.len());
    let limited = |extreme: f64| {
        // Counts separate occurrences: a value that is held counts once.
        let mut runs = 0;
        let mut inside = false;
        for value in values {
            let there = (value - extreme).abs() <= rounding;
            runs += usize::from(there && !inside);
            inside = there;
        }
        runs
    };
    // The count that the extreme would have if it belonged to a tail. The logarithms of a distribution's counts bend down, so
    // that a straight line through the next counts lies above. Small counts carry little information: their plausible upper
    // values are used.
    let near = |inwards: &mut dyn Iterator<Item = &(f64, usize)>| {
        let mut next = || inwards.next().map_or(1, |one| one.1) as f64;
        let [first, second, third, fourth] = [next(), next(), next(), next()];
        let (pair, inner) = (first + second, third + fourth);
        let (may, fall) = (pair + 2.0 * pair.sqrt(), (pair / inner).min(1.0));
        (first * first / second).min(first).max(may * fall / (1.0 + fall.sqrt())).max(1.0)
    };
    let cut = |extreme: f64, expected: f64| {
        let runs = limited(extreme);
        match step {
            // Without a step no two values are equal.
            None => runs >= 3,
            Some(_) => {
                let runs = runs as f64;
                runs >= 5.0 && runs > expected && runs * (runs / expected).ln() - (runs - expected) > 12.0
            }
        }
    };
    let low = cut(first, near(&mut counted.iter().skip(1))).then_some(first);
    let high = cut(last, near(&mut counted.iter().rev().skip(1))).then_some(last);
    let free: Vec<f64> = values.iter().copied().filter(|value| ![low, high].contains(&Some(*value))).collect();
    Facts { step, low, high, atom: atom(&free) }
}

/// Returns by how much the most frequent value exceeds the fifth most frequent, with runs counted once: half of a
/// square, which is the nats of a normal chance. `values` excludes those at a limit.
fn atom(values: &[f64]) -> f64 {
    const FIFTH: usize = 5;
    const FEWEST: f64 = 6.0;
    let changes = values.iter().enumerate().filter(|(t, value)| *t == 0 || **value != values[t - 1]);
    let mut sorted: Vec<f64> = changes.map(|(_, value)| *value).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let mut counts: Vec<usize> = sorted.chunk_by(|a, b| a == b).map(<[f64]>::len).collect();
    if counts.len() < FIFTH {
        return 0.0;
    }
    counts.sort_unstable_by(|a, b| b.cmp(a));
    let (most, fifth) = (counts[0] as f64, counts[FIFTH - 1] as f64);
    // Poisson counts: twice the difference of roots is about normal; small counts are chance.
    let z = 2.0 * (most.sqrt() - fifth.sqrt()) - 3.0;
    if most >= FEWEST && z > 0.0 { 0.5 * z * z } else { 0.0 }
}

/// Returns the step: a distance that nearly all distances of neighbouring values are multiples of.
fn step(counted: &[(f64, usize)], samples: usize) -> Option<f64> {
    /// Minimum share of values that were seen before; otherwise the step is far below the noise.
    const REPEATED: f64 = 0.2;
    /// How far from whole a multiple may be, and what share may be farther: limits and spikes need not lie on the
    /// lattice.
    const WHOLE: f64 = 0.03;
    const ASTRAY: f64 = 0.02;
    const COMMON: usize = 3;
    if let [one, other] = counted {
        // If only two values are seen, the step is so wide that both are common.
        return (one.1.min(other.1) >= COMMON).then_some(other.0 - one.0);
    }
    if counted.len() < 3 || counted.len() as f64 > (1.0 - REPEATED) * samples as f64 {
        return None;
    }
    // Each distance counts as often as the rarer of its two values was seen.
    let mut distances: Vec<(f64, f64)> =
        counted.windows(2).map(|pair| (pair[1].0 - pair[0].0, pair[0].1.min(pair[1].1) as f64)).collect();
    distances.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let allowed = ASTRAY * distances.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut passed = 0.0;
    let smallest = distances.iter().find(|(_, weight)| {
        passed += weight;
        passed > allowed
    });
    let (smallest, _) = smallest?;
    let (mut best, mut astray_of_best) = (None, f64::INFINITY);
    for part in 1..=6 {
        let mut step = smallest / f64::from(part);
        // Increasing distances make the step increasingly exact.
        for _ in 0..3 {
            let (mut length, mut count) = (0.0, 0.0);
            for (distance, weight) in &distances {
                let multiple = (distance / step).round();
                if multiple <= 8.0 && (distance / step - multiple).abs() < 0.2 {
                    length += weight * distance;
                    count += weight * multiple;
                }
            }
            if count > 0.0 {
                step = length / count;
            }
        }
        let far = |(distance, _): &&(f64, f64)| (distance / step - (distance / step).round()).abs() > WHOLE;
        let astray: f64 = distances.iter().filter(far).map(|(_, weight)| weight).sum();
        if astray < astray_of_best {
            (best, astray_of_best) = (Some(step), astray);
        }
        if astray <= allowed {
            break;
        }
    }
    best.filter(|_| astray_of_best <= allowed)
}

/// Samples that repeat the ones before them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Repeats {
    /// The places of the repeats.
    pub places: Vec<usize>,
    /// The probability of each of them to be due to chance.
    pub by_chance: Vec<f64>,
    /// The number of pairs of neighbours.
    pub pairs: usize,
    /// Nats that repeats explain; 0 if the repeats are due to chance.
    pub gain: f64,
}

impl Repeats {
    /// Returns the number of repeats expected by chance.
    pub fn expected(&self) -> f64 {
        self.by_chance.iter().sum()
    }

    /// Returns the number of samples that were sent again.
    pub fn sent_again(&self) -> f64 {
        self.places.len() as f64 - self.expected()
    }

    /// Returns the share of samples that were sent again, and its 95 % interval.
    ///
    /// If each sample is sent again with probability h, and otherwise equals the last one with probability p, the share of repeats is
    /// h + (1 − h)·p. The variance of the number of repeats is taken as that of a Poisson distribution, and that of the number expected
    /// by chance, which was estimated from as many pairs, is added.
    pub fn probability(&self) -> (f64, [f64; 2]) {
        let pairs = self.pairs.max(1) as f64;
        let (found, expected) = (self.places.len() as f64, self.expected());
        let again = (found - expected).max(1.0) / pairs;
        let apart = (1.0 - again - expected / pairs).max(1.0 / pairs) / (1.0 - again).max(1.0 / pairs);
        let half = 1.96 * (found + expected).max(1.0).sqrt() / pairs / apart;
        (again, [(again - half).max(0.0), (again + half).min(1.0)])
    }
}

/// Returns the repeats of channels that repeat together. `columns` have one length and belong to one triad.
pub fn repeats(columns: &[&[f64]]) -> Repeats {
    let n = columns.iter().map(|column| column.len()).min().unwrap_or_default();
    if n < 3 || columns.is_empty() {
        return Repeats::default();
    }
    // A value at an extreme may have been cut off there: the limit then causes its repeats.
    let ends: Vec<[f64; 2]> = columns
        .iter()
        .map(|column| column[..n].iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], v| [l.min(*v), h.max(*v)]))
        .collect();
    let cut = |t: usize| columns.iter().zip(&ends).all(|(column, ends)| ends.contains(&column[t]));
    let same = |t: usize, back: usize| columns.iter().all(|column| column[t] == column[t - back]) && !cut(t);
    let places: Vec<usize> = (1..n).filter(|t| same(*t, 1)).collect();
    let found = places.len() as f64;
    // The number of repeats by chance, and the number if chance alone made every repeat of each channel.
    let [expected, alone] = match columns {
        [one] => {
            let (equal, chance) = chance(&one[..n]);
            [(1.0 - sent_again(equal, chance)) * chance, chance].map(|chance| chance * (n - 1) as f64)
        }
        several => {
            let equal = several.iter().map(|column| (1..n).filter(|t| column[*t] == column[t - 1]).count() as f64);
            let equal: Vec<f64> = equal.map(|count| count / (n - 1) as f64).collect();
            let together = together(columns, n);
            let all = jointly(found / (n - 1) as f64, &equal, together);
            [all, together * equal.iter().product::<f64>()].map(|chance| chance * (n - 1) as f64)
        }
    };
    // Fewer than one expected repeat counts as a fraction, so that a single repeat is no proof.
    let gain_over = |expected: f64| {
        let floor = expected.max(1e-3);
        if found > expected { found * (found / floor).ln() - (found - expected) } else { 0.0 }
    };
    let gain = gain_over(expected).min(gain_over(alone));
    let by_chance = by_chance(columns, &places, expected);
    Repeats { places, by_chance, pairs: n - 1, gain }
}

/// Returns the probability of each repeat to be due to chance, if so many are expected in all. By chance, a value is repeated in
/// proportion to the square of its frequency; a value that is sent again, in proportion to its frequency.
fn by_chance(columns: &[&[f64]], places: &[usize], expected: f64) -> Vec<f64> {
    const ROUNDS: usize = 60;
    if places.is_empty() || expected >= places.len() as f64 {
        return vec![1.0; places.len()];
    }
    let mut frequency = vec![1.0; places.len()];
    for column in columns {
        let mut counts = HashMap::new();
        column.iter().for_each(|value| *counts.entry(key(*value)).or_insert(0.0) += 1.0 / column.len() as f64);
        let own = places.iter().map(|place| counts.get(&key(column[*place])).copied().unwrap_or_default());
        frequency.iter_mut().zip(own).for_each(|(all, own)| *all *= own);
    }
    let at = |ln: f64| frequency.iter().map(move |own| 1.0 / (1.0 + (-ln).exp() / own));
    // Bisects for the logarithm of the odds at frequency 1.
    let (mut low, mut high) = (-100.0, 100.0);
    for _ in 0..ROUNDS {
        let middle = 0.5 * (low + high);
        if at(middle).sum::<f64>() < expected { low = middle } else { high = middle }
    }
    at(0.5 * (low + high)).collect()
}

/// Returns the key of a value in a table of values; 0 and −0 are one value.
fn key(value: f64) -> u64 {
    (value + 0.0).to_bits()
}

/// Returns how often all channels equal their last samples by chance, given how often they are equal (`all`, `each`). A
/// sample that is sent again is equal in all channels at once.
fn jointly(all: f64, each: &[f64], together: f64) -> f64 {
    const ROUNDS: usize = 60;
    let by_chance = |again: f64| {
        let alone: f64 = each.iter().map(|own| ((own - again) / (1.0 - again).max(1e-9)).max(0.0)).product();
        (together * alone).min(all)
    };
    // Bisects for the consistent part of samples sent again: coarse values are equal so often that iteration would
    // settle slowly.
    let (mut low, mut high) = (0.0, all);
    for _ in 0..ROUNDS {
        let again = 0.5 * (low + high);
        let chance = by_chance(again);
        if (all - chance) / (1.0 - chance).max(1e-9) > again { low = again } else { high = again }
    }
    let again = 0.5 * (low + high);
    (1.0 - again) * by_chance(again)
}

/// Distances, in samples: farther than a value is held, but so near that the level is the same.
const APART: std::ops::Range<usize> = 20..28;

/// Returns the ratio of how often all channels together equal their values some samples ago to how often they would if
/// they were independent. It is above 1 for coarse values that share noise, or that are loud and quiet together.
/// Samples that are sent again do not raise it.
fn together(columns: &[&[f64]], n: usize) -> f64 {
    /// With fewer samples, the ratio carries no information.
    const LEAST: f64 = 200.0;
    let (mut both, mut alone) = (0.0, 0.0);
    for apart in APART.filter(|apart| *apart < n) {
        let same = |column: &&[f64], t: usize| column[t] == column[t - apart];
        let length = (n - apart) as f64;
        let counts = columns.iter().map(|column| (apart..n).filter(|t| same(column, *t)).count() as f64 / length);
        alone += length * counts.product::<f64>();
        both += (apart..n).filter(|t| columns.iter().all(|column| same(column, *t))).count() as f64;
    }
    if both < LEAST { 1.0 } else { (both / alone).max(1.0) }
}

/// Returns the share of samples that are sent again, from the share of neighbours that are equal and the chance of that.
fn sent_again(equal: f64, chance: f64) -> f64 {
    ((equal - chance) / (1.0 - chance).max(1e-9)).max(0.0)
}

/// Returns the share of neighbours that are equal, and the chance that a rounded value repeats the one before it. The chance follows
/// from how often neighbours differ by one step and by two, for normally distributed differences, and from how often values farther
/// apart are equal.
fn chance(column: &[f64]) -> (f64, f64) {
    let distances: Vec<f64> = column.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    let length = distances.len().max(1) as f64;
    let equal = distances.iter().filter(|d| **d == 0.0).count() as f64 / length;
    if equal == 0.0 {
        return (0.0, 0.0);
    }
    let Some(step) = of(column).step else {
        // Values of many digits are never equal by chance. Values of coarse floats sometimes are, also farther apart.
        return (equal, from_farther(column, equal).min(equal));
    };
    let count = |multiple: f64| distances.iter().filter(|d| (*d / step - multiple).abs() < 0.2).count() as f64 / 2.0;
    let (one, two) = (count(1.0), count(2.0));
    if one < 20.0 || two < 1.0 {
        return (equal, from_farther(column, equal));
    }
    // ln of the counts is a − b·multiple². This does not hold for coarse values, which equal their values some samples
    // ago equally often. Samples that are sent again are not among those that differ.
    let at_zero = (one / length * ((one / two).ln() / 3.0).max(0.0).exp()).min(equal);
    let at_zero = at_zero / (1.0 - (equal - at_zero));
    let apart = APART.filter(|apart| *apart < column.len());
    let again = |apart: usize| {
        let pairs = column.iter().zip(&column[apart..]);
        pairs.filter(|(a, b)| a == b).count() as f64 / (column.len() - apart) as f64
    };
    let (sum, count) = apart.fold((0.0, 0.0), |(sum, count), apart| (sum + again(apart), count + 1.0));
    (equal, at_zero.max(sum / f64::max(count, 1.0)).min(1.0))
}

/// Returns the chance of equal neighbours, from the shares of samples two and three apart that are equal. The share of slow noise that
/// crosses a step within a short time grows as the root of the time. If a share h is sent again, h² and h³ of these samples are. A value
/// that a record has in one place alone was sent again there, and does not count.
fn from_farther(column: &[f64], equal: f64) -> f64 {
    const ROUNDS: usize = 200;
    let mut runs = HashMap::new();
    for run in column.chunk_by(|one, next| one == next) {
        *runs.entry(key(run[0])).or_insert(0_usize) += 1;
    }
    let is_elsewhere = |value: f64| runs.get(&key(value)).is_some_and(|count| *count > 1);
    let share = |apart: usize| {
        let pairs = column.iter().zip(column.get(apart..).unwrap_or_default());
        pairs.filter(|(a, b)| a == b && is_elsewhere(**a)).count() as f64 / column.len() as f64
    };
    let (two, three) = (share(2), share(3));
    let mut again = 0.0_f64;
    let mut chance = 0.0;
    // Settles from below, at the least share that agrees with itself.
    for _ in 0..ROUNDS {
        let unequal = |share: f64, sent: f64| 1.0 - ((share - sent) / (1.0 - sent).max(1e-9)).max(0.0);
        let (two, three) = (unequal(two, again.powi(2)), unequal(three, again.powi(3)));
        chance = 1.0 - (2.0 * two * two - three * three).clamp(0.0, two * two).sqrt();
        again = sent_again(equal, chance);
    }
    chance
}

/// The facts that stamps show.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Stamps {
    /// Standard deviation about evenly spaced instants, or about a clock that wanders slowly, beyond the stamps' own rounding, s.
    pub jitter_s: f64,
    /// Samples per second.
    pub rate_hz: f64,
    /// Whether the clock wanders.
    pub(super) wanders: Option<Oddity>,
}

/// Returns the lateness of stamps of samples at the given places of a grid relative to the straight line through them,
/// s, and the line's period, s; `None` for fewer than 16.
fn off_line(time_s: &[f64], places: impl Iterator<Item = usize>) -> Option<(Vec<f64>, f64)> {
    let pairs: Vec<(f64, f64)> = places.map(|place| place as f64).zip(time_s.iter().copied()).collect();
    if pairs.len() < 16 {
        return None;
    }
    let n = pairs.len() as f64;
    let (place, time) = pairs.iter().fold((0.0, 0.0), |(p, t), (place, time)| (p + place / n, t + time / n));
    let (mut product, mut square) = (0.0, 0.0);
    for (own_place, own_time) in &pairs {
        product += (own_place - place) * (own_time - time);
        square += (own_place - place).powi(2);
    }
    let period = product / square;
    (period.is_finite() && period > 0.0)
        .then(|| (pairs.iter().map(|(p, t)| t - time - period * (p - place)).collect(), period))
}

/// Returns the stamps of samples at the given places of a grid; `None` for fewer than 16.
pub fn stamps(time_s: &[f64], places: impl Iterator<Item = usize>) -> Option<Stamps> {
    /// Stretches of a record; within each, a wandering clock's lateness is about constant.
    const STRETCHES: usize = 64;
    /// Maximum jitter as a part of a period.
    const SURE: f64 = 0.15;
    let (off_s, period_s) = off_line(time_s, places)?;
    let size = (off_s.len() / STRETCHES).max(16);
    let (mut square, mut free) = (0.0, 0.0);
    for of in off_s.chunks(size) {
        let mean = of.iter().sum::<f64>() / of.len() as f64;
        square += of.iter().map(|off| (off - mean).powi(2)).sum::<f64>();
        free += of.len() as f64 - 1.0;
    }
    let variance = square / free - digits_s(time_s).powi(2) / 12.0;
    let jitter_s = variance.max(0.0).sqrt();
    // Stamps that scatter by this much are sometimes put on the wrong instants of the grid.
    let wanders = oddities::of_clock(&off_s, period_s).filter(|_| jitter_s < SURE * period_s);
    Some(Stamps { jitter_s, rate_hz: 1.0 / period_s, wanders })
}

/// Returns the power of ten, s, of which all stamps are multiples, counted from the first; 0 below 1e-7.
fn digits_s(time_s: &[f64]) -> f64 {
    const WHOLE: f64 = 1e-3;
    let first = time_s.first().copied().unwrap_or_default();
    let whole = |digit: &i32| {
        let per_s = 10f64.powi(*digit);
        time_s.iter().map(|s| (s - first) * per_s).all(|of| (of - of.round()).abs() < WHOLE)
    };
    (0..=7).find(whole).map_or(0.0, |digit| 10f64.powi(-digit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::{Stream, StreamId};

    fn noise(seed: u64, n: usize) -> Vec<f64> {
        let mut stream = Stream::new(seed, StreamId { owner: 0, effect: 1, instance: 0 });
        (0..n).map(|_| -9.8 + stream.normal()).collect()
    }

    #[test]
    fn a_step_is_found_and_floats_have_none() {
        for step in [0.03, 0.2, 0.003_33 * 9.806_65, 1.0, 3.0] {
            let mut values: Vec<f64> = noise(1, 30_001).iter().map(|v| (v / step).round() * step).collect();
            assert!((of(&values).step.unwrap() / step - 1.0).abs() < 1e-4, "{step}: {:?}", of(&values));
            // A few values off the lattice do not change the result.
            values[17] += 0.377;
            assert!((of(&values).step.unwrap() / step - 1.0).abs() < 1e-3, "{step}: {:?}", of(&values));
        }
        assert_eq!(of(&noise(2, 20_000)), Facts::default());
    }

    #[test]
    fn limits_are_distinguished_from_extremes() {
        let cut = |values: &[f64]| -> Vec<f64> { values.iter().map(|v| v.min(-7.0)).collect() };
        let values = noise(3, 20_000);
        assert_eq!(of(&cut(&values)).high, Some(-7.0));
        let rounded: Vec<f64> = values.iter().map(|v| (v / 0.2).round() * 0.2).collect();
        assert_eq!((of(&rounded).low, of(&rounded).high), (None, None));
        let cut_off: Vec<f64> = rounded.iter().map(|v| v.min(-8.0)).collect();
        let found = of(&cut_off);
        assert!((found.high.unwrap() + 8.0).abs() < 1e-9, "{found:?}");
        // One extreme sample, held a few times.
        let mut held = values;
        held[100..106].fill(50.0);
        assert_eq!(of(&held).high, None);
    }

    #[test]
    fn a_few_equal_extremes_of_rounded_values_are_chance() {
        // Ten values at the extreme, four beside them, sixteen next to those: a fall by about half each may show this.
        let counts = [10, 4, 16, 40, 70, 120, 200, 320, 500, 760];
        let mut values: Vec<f64> = Vec::new();
        for (place, count) in counts.into_iter().enumerate() {
            let value = 1.0 - 0.25 * place as f64;
            values.extend((0..count).map(|_| value));
        }
        // Reorders the values, so that none is held.
        let count = values.len();
        let mixed: Vec<f64> = (0..count).map(|at| values[at * 1009 % count]).collect();
        assert_eq!(of(&mixed).high, None);
        let cut: Vec<f64> = mixed.iter().map(|value| value.min(-0.25)).collect();
        assert_eq!(of(&cut).high, Some(-0.25));
    }

    #[test]
    fn repeats_of_rounded_values_are_chance_and_held_ones_are_not() {
        let rounded = |seed: u64, step: f64| -> Vec<f64> {
            noise(seed, 20_000).iter().map(|v| (v / step).round() * step).collect()
        };
        let columns = [rounded(4, 0.3), rounded(5, 0.3), rounded(6, 0.3)];
        let of_all = |columns: &[Vec<f64>]| repeats(&columns.iter().map(Vec::as_slice).collect::<Vec<_>>());
        let by_chance = of_all(&columns);
        assert!(by_chance.gain < 6.0 && !by_chance.places.is_empty(), "{}", by_chance.gain);
        assert!(of_all(&columns[..1]).gain < 6.0, "{}", of_all(&columns[..1]).gain);
        // Coarse values that share noise repeat together more often than independent ones.
        let source = noise(10, 200_000);
        let shared = |seed: u64| -> Vec<f64> {
            noise(seed, 200_000).iter().zip(&source).map(|(own, all)| ((own + all) / 1.5).round() * 1.5).collect()
        };
        let linked = [shared(11), shared(12), shared(13)];
        assert!(of_all(&linked).gain < 6.0, "{}", of_all(&linked).gain);
        let mut held = columns;
        for t in [50, 700, 701, 9000, 15_000, 15_100, 16_000, 17_000] {
            for column in &mut held {
                column[t] = column[t - 1];
            }
        }
        let mut few = [noise(7, 5000), noise(8, 5000)];
        for column in &mut few {
            column[70] = column[69];
            column[71] = column[69];
            column[90] = column[89];
        }
        assert_eq!(of_all(&few).places, [70, 71, 90]);
        assert!(of_all(&few).gain > 12.0);
        assert!(of_all(&held).gain > by_chance.gain);
    }

    #[test]
    fn the_share_of_held_samples_is_inside_its_interval_at_any_step_and_share() {
        let mut uniform = Stream::new(3, StreamId { owner: 3, effect: 0, instance: 0 });
        for (step, seed) in [(0.0, 21), (0.4, 22), (1.0, 23), (2.0, 24), (5.0, 25)] {
            for share in [0.02, 0.1, 0.3, 0.6] {
                let mut values = noise(seed, 40_000);
                if step > 0.0 {
                    values.iter_mut().for_each(|value| *value = (*value / step).round() * step);
                }
                for t in 1..values.len() {
                    if uniform.uniform() < share {
                        values[t] = values[t - 1];
                    }
                }
                let found = repeats(&[&values]);
                let (at, [low, high]) = found.probability();
                assert!(low <= share && share <= high, "{step} {share}: {at} in {low} to {high}");
                assert!(high - low < 0.1 || step > 3.0, "{step} {share}: {low} to {high}");
                assert!(found.gain > 14.0 || share < 0.1 || step > 3.0, "{step} {share}: {}", found.gain);
            }
        }
    }

    /// Slow noise in coarse steps stays for long at a value.
    #[test]
    fn slow_noise_in_coarse_steps_is_not_held() {
        for (memory, step, seed) in
            [(0.5, 3.0, 31), (0.9, 3.0, 32), (0.9, 6.0, 33), (0.98, 8.0, 34), (0.0, 4.0, 35), (0.0, 6.0, 36)]
        {
            let mut level = 0.0;
            let slow = noise(seed, 20_000).into_iter().map(|value| {
                level = memory * level + (value + 9.8);
                (0.3 + level / step).round() * step
            });
            let values: Vec<f64> = slow.collect();
            let found = repeats(&[&values]);
            assert!(found.gain < 14.0, "{memory} {step}: {} of {}", found.gain, found.places.len());
        }
    }

    #[test]
    fn stamps_determine_rate_and_jitter() {
        let scatter = noise(9, 5000);
        let time_s: Vec<f64> = (0..5000).map(|i| 3.0 + i as f64 / 40.0 + 0.001 * (scatter[i] + 9.8)).collect();
        let found = stamps(&time_s, 0..5000).unwrap();
        assert!((found.jitter_s / 0.001 - 1.0).abs() < 0.05 && (found.rate_hz / 40.0 - 1.0).abs() < 1e-6, "{found:?}");
        assert_eq!(stamps(&time_s[..10], 0..10), None);
        // Whole milliseconds of unevenly rounded even steps are no jitter; with jitter they are not added to it.
        let whole = |time_s: f64| (1e3 * time_s).round() / 1e3;
        let even: Vec<f64> = (0..5000).map(|i| whole(i as f64 / 60.0)).collect();
        assert!(stamps(&even, 0..5000).unwrap().jitter_s < 5e-5);
        let both: Vec<f64> = time_s.iter().map(|s| whole(*s)).collect();
        assert!((stamps(&both, 0..5000).unwrap().jitter_s / 0.001 - 1.0).abs() < 0.05);
    }
}
