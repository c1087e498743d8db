//! Oddities: features of the values and stamps that no effect of the library explains.
//!
//! The size of each is its likelihood ratio, in nats, over the nearest effect of the library: for codes that a
//! converter leaves out, over rounding; for repeats at even distances, over samples sent twice by chance; for a clock
//! that wanders, over stamps that scatter.

use super::averages::sums;
use statrs::distribution::{ContinuousCDF as _, Normal};
use std::collections::BTreeMap;

/// A feature that no effect of the library explains.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Oddity {
    /// Description of the oddity.
    pub(super) what: &'static str,
    /// Nats.
    pub(super) nats: f64,
}

/// Minimum number of nats of an oddity: chance gives less among the hundreds of codes or distances examined.
const LEAST: f64 = 25.0;

/// Finds codes of a converter with steps of `step` that occur far less, or more, than those on both sides: missing
/// codes, a bit that is stuck, uneven steps. `None` if the steps are wider than the noise, or if too few codes occur
/// often enough.
///
/// The expected counts are those of rounded normal noise about a level that is the mean of some samples before and
/// behind.
pub(super) fn of_codes(values: &[f64], step: f64) -> Option<Oddity> {
    /// Number of samples about each one that determine its level.
    const NEAR: usize = 64;
    /// Counts below this carry little information.
    const FEWEST: f64 = 30.0;
    /// A code has to be off by this many standard errors and by this part of its count.
    const ERRORS: f64 = 5.0;
    const PART: f64 = 0.2;
    /// Maximum number of levels times codes.
    const MOST: i64 = 4_000_000;
    /// Maximum number of steps per standard deviation of the noise.
    const WIDEST: f64 = 1.5;
    let n = values.len();
    if n < 16 * NEAR || step <= 0.0 {
        return None;
    }
    let origin = values[0];
    let codes: Vec<i64> = values.iter().map(|value| ((value - origin) / step).round() as i64).collect();
    let sums = sums(codes.iter().map(|code| *code as f64));
    let level = |t: usize| {
        let (from, to) = (t.saturating_sub(NEAR), (t + NEAR + 1).min(n));
        (sums[to] - sums[from]) / (to - from) as f64
    };
    let levels: Vec<f64> = (0..n).map(level).collect();
    let square: f64 = codes.iter().zip(&levels).map(|(code, level)| (*code as f64 - level).powi(2)).sum();
    // The level absorbs a part of the variance; rounding adds a twelfth.
    let sigma = (square / n as f64 * (1.0 + 0.5 / NEAR as f64) - 1.0 / 12.0).max(0.0).sqrt();
    // How often a code in the middle occurs.
    if sigma * WIDEST < 1.0 || n as f64 * 0.4 / sigma < FEWEST {
        return None;
    }
    // Levels in tenths of a step.
    let mut at: BTreeMap<i64, f64> = BTreeMap::new();
    levels.iter().for_each(|level| *at.entry((10.0 * level).round() as i64).or_default() += 1.0);
    let far = (4.0 * sigma).ceil() as i64;
    if at.len() as i64 * far > MOST {
        return None;
    }
    let mut met: BTreeMap<i64, f64> = BTreeMap::new();
    codes.iter().for_each(|code| *met.entry(*code).or_default() += 1.0);
    let normal = Normal::standard();
    let mut expected: BTreeMap<i64, f64> = BTreeMap::new();
    for (tenths, count) in &at {
        let level = 0.1 * *tenths as f64;
        let centre = level.round() as i64;
        let below = |code: i64| normal.cdf((code as f64 - 0.5 - level) / sigma);
        let mut last = below(centre - far);
        for code in centre - far..=centre + far {
            let next = below(code + 1);
            *expected.entry(code).or_default() += count * (next - last);
            last = next;
        }
    }
    let off: BTreeMap<i64, (f64, f64)> = expected
        .iter()
        .filter(|(_, count)| **count >= FEWEST)
        .map(|(code, count)| (*code, ((met.get(code).copied().unwrap_or(0.0) + 0.5) / (count + 0.5), *count)))
        .map(|(code, (ratio, count))| (code, (ratio.ln(), count)))
        .collect();
    let mut nats = 0.0;
    for (code, (own, count)) in &off {
        // Compared with a cubic through the codes around it: a distribution that is not normal is still smooth.
        let of = |by: i64| off.get(&(code + by)).map(|(of, _)| *of);
        let [Some(a), Some(b), Some(c), Some(d)] = [of(-2), of(-1), of(1), of(2)] else { continue };
        let middle = (4.0 * (b + c) - (a + d)) / 6.0;
        let apart = own - middle;
        let should = count * middle.exp();
        // The four counts also have errors.
        let z = (apart.exp() - 1.0) * should.sqrt() / 1.4;
        if z.abs() > ERRORS && apart.abs() > PART {
            nats += should * (apart.exp() * (apart - 1.0) + 1.0);
        }
    }
    (nats > LEAST).then_some(Oddity { what: "codes that are met less or more often than those beside them", nats })
}

/// Finds samples sent again at even distances. `places` are those of the repeats.
pub(super) fn of_repeats(places: &[usize]) -> Option<Oddity> {
    const FEWEST: usize = 30;
    /// Number of bins of about the same chance.
    const BINS: usize = 32;
    /// Nats per repeat that even distances have to gain.
    const CLEARLY: f64 = 0.3;
    if places.len() < FEWEST {
        return None;
    }
    let distances: Vec<usize> = places.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let count = distances.len() as f64;
    if distances.iter().all(|distance| *distance == 1) {
        return None;
    }
    let ln_other = (-count / distances.iter().sum::<usize>() as f64).ln_1p();
    // The chance of a distance of this or more.
    let from = |distance: usize| (ln_other * (distance - 1) as f64).exp();
    let bin = |distance: usize| ((1.0 - from(distance)) * BINS as f64) as usize;
    let mut met = [0.0; BINS];
    distances.iter().for_each(|distance| met[bin(*distance).min(BINS - 1)] += 1.0);
    let (mut nats, mut bins, mut first) = (0.0, 0.0, 1);
    for (place, own) in met.iter().enumerate() {
        // A bin ends at the distance at which the next one begins.
        let end = ((-((place + 1) as f64) / BINS as f64).ln_1p() / ln_other).ceil() as usize;
        let last = if place + 1 == BINS { usize::MAX } else { end.saturating_add(1).max(first) };
        let chance = from(first) - if last == usize::MAX { 0.0 } else { from(last) };
        first = last;
        if *own > 0.0 && chance > 0.0 {
            nats += own * (own / (count * chance)).ln();
            bins += 0.5;
        }
        if last == usize::MAX {
            break;
        }
    }
    let nats = nats - bins;
    (nats > LEAST + CLEARLY * count).then_some(Oddity { what: "samples that are sent again at even distances", nats })
}

/// Returns finds a clock that wanders: stamps that are early or late together for a long while, by more than a fifth of
/// a period and 5 ms.
pub(super) fn of_clock(off_s: &[f64], period_s: f64) -> Option<Oddity> {
    const STRETCHES: usize = 64;
    const LEAST_S: f64 = 5e-3;
    const PART: f64 = 0.2;
    let size = off_s.len() / STRETCHES;
    if size < 16 {
        return None;
    }
    let means: Vec<f64> = off_s.chunks_exact(size).map(|of| of.iter().sum::<f64>() / size as f64).collect();
    let square = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64;
    let (slow, all) = (square(&means), square(off_s));
    if slow.sqrt() < LEAST_S.max(PART * period_s) {
        return None;
    }
    let nats =
        0.5 * means.len() as f64 * (slow * size as f64 / (all - slow).max(all / off_s.len() as f64)).max(1.0).ln();
    (nats > LEAST).then_some(Oddity { what: "stamps of a clock that wanders", nats })
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::{Stream, StreamId};

    fn noise(seed: u64, n: usize) -> Vec<f64> {
        let mut stream = Stream::new(seed, StreamId { owner: 0, effect: 4, instance: 0 });
        (0..n).map(|_| stream.normal()).collect()
    }

    fn rounded(values: &[f64], step: f64) -> Vec<f64> {
        values.iter().map(|value| (value / step).round() * step).collect()
    }

    #[test]
    fn codes_that_are_left_out_are_found_and_even_ones_are_not() {
        for (seed, step) in [(1, 0.05), (2, 0.3), (3, 0.6)] {
            let mut values = noise(seed, 40_000);
            // A level that moves, and tails.
            values.iter_mut().enumerate().for_each(|(t, value)| {
                *value += 2.0 * (t as f64 / 40_000.0) + if t > 20_000 { 3.0 } else { 0.0 };
                if t % 50 == 0 {
                    *value *= 4.0;
                }
            });
            assert_eq!(of_codes(&rounded(&values, step), step), None, "{step}");
            // Each fifth code becomes the one below.
            let missing: Vec<f64> = values
                .iter()
                .map(|value| (value / step).round())
                .map(|code| if (code as i64).rem_euclid(5) == 0 { code - 1.0 } else { code } * step)
                .collect();
            assert!(of_codes(&missing, step).is_some(), "{step}");
        }
        assert_eq!(of_codes(&rounded(&noise(4, 40_000), 3.0), 3.0), None);
    }

    #[test]
    fn even_distances_are_found_and_chance_is_not() {
        let by_chance: Vec<usize> =
            noise(5, 40_000).iter().enumerate().filter(|(_, e)| **e > 1.5).map(|(t, _)| t).collect();
        assert_eq!(of_repeats(&by_chance), None);
        let even: Vec<usize> = (1..2000).map(|t| 4 * t).collect();
        assert!(of_repeats(&even).is_some());
        assert_eq!(of_repeats(&even[..10]), None);
    }

    #[test]
    fn a_wandering_clock_is_found_and_jitter_is_not() {
        let period_s = 0.025;
        let jitter: Vec<f64> = noise(6, 20_000).iter().map(|e| 0.004 * e).collect();
        assert_eq!(of_clock(&jitter, period_s), None);
        let wanders: Vec<f64> =
            jitter.iter().enumerate().map(|(t, of)| of + 0.02 * (t as f64 / 4000.0).sin()).collect();
        assert!(of_clock(&wanders, period_s).is_some());
        let slightly: Vec<f64> =
            jitter.iter().enumerate().map(|(t, of)| of + 1e-3 * (t as f64 / 4000.0).sin()).collect();
        assert_eq!(of_clock(&slightly, period_s), None);
    }
}
