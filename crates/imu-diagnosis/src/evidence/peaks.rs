//! Peaks: single samples so far out that they are visible without a law of the noise, which such samples distort.

use crate::averages::median;

/// A sample is compared with the median of this many samples on either side.
const HALF: usize = 16;
/// Number of samples before and behind a group that have to be quiet.
const BESIDE: usize = 12;

/// Returns the samples of short groups that are far out among quiet ones, and the samples behind each group that a
/// filter may have changed.
pub(crate) fn peaks(values: &[f64]) -> Vec<usize> {
    /// Far out: this many robust standard deviations of the distances from local medians.
    const FAR: f64 = 25.0;
    const QUIET: f64 = 2.5;
    /// Maximum number of samples between the parts of a group, and its maximum length.
    const NEAR: usize = 8;
    const LONGEST: usize = 32;
    /// Minimum number of samples behind a group that are left out.
    const BEHIND: usize = 4;
    /// Maximum effective number of samples that hold the square of a group, (Σd²)²/Σd⁴: a stretch of noise has more.
    const FEW: f64 = 5.0;
    /// If this part of the record is left out, the samples do not count as single ones.
    const MOST: f64 = 0.05;
    let n = values.len();
    if n < 16 * HALF {
        return Vec::new();
    }
    let mut window = Vec::with_capacity(2 * HALF + 1);
    let distances: Vec<f64> = (0..n)
        .map(|t| {
            window.clear();
            window.extend_from_slice(&values[t.saturating_sub(HALF)..(t + HALF + 1).min(n)]);
            (values[t] - median(&mut window)).abs()
        })
        .collect();
    let usual = median(&mut distances.clone());
    let far: Vec<usize> = (0..n).filter(|t| distances[*t] > FAR / 0.6745 * usual && usual > 0.0).collect();
    let mut found = Vec::new();
    for group in far.chunk_by(|a, b| b - a <= NEAR) {
        let (first, last) = (group[0], group[group.len() - 1]);
        let span = last + 1 - first;
        let (from, to) = (first.saturating_sub(1), (last + 1 + span.max(BEHIND)).min(n));
        // At an end of the record, the median is not centred on the sample.
        if from < HALF + BESIDE || to + HALF + BESIDE > n {
            continue;
        }
        let is_quiet = |range: std::ops::Range<usize>| {
            let loud = range.clone().filter(|t| distances[*t] > QUIET / 0.6745 * usual).count();
            4 * loud <= range.len()
        };
        let (square, fourth) =
            group.iter().map(|t| distances[*t].powi(2)).fold((0.0, 0.0), |(a, b), d| (a + d, b + d * d));
        let is_single = span <= LONGEST && square * square < FEW * fourth;
        if is_single && is_quiet(from - BESIDE..from) && is_quiet(to..to + BESIDE) {
            found.extend(from..to);
        }
    }
    found.sort_unstable();
    found.dedup();
    if found.len() as f64 > MOST * n as f64 { Vec::new() } else { found }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::{Stream, StreamId};

    #[test]
    fn single_samples_are_peaks_and_steps_stretches_and_walks_are_not() {
        let mut stream = Stream::new(1, StreamId { owner: 93, effect: 0, instance: 0 });
        let mut values: Vec<f64> = (0..20_000).map(|_| stream.normal()).collect();
        values[15_000..15_200].iter_mut().for_each(|value| *value *= 60.0);
        values[18_000..].iter_mut().for_each(|value| *value += 500.0);
        assert!(peaks(&values).is_empty(), "{:?}", peaks(&values));
        values[5_000] += 800.0;
        values[9_000] -= 70.0;
        values[9_001] -= 70.0;
        let found = peaks(&values);
        assert!([5_000, 9_000, 9_001].iter().all(|at| found.contains(at)), "{found:?}");
        assert!(found.iter().all(|at| at.abs_diff(5_000) < 8 || at.abs_diff(9_000) < 8), "{found:?}");
        let mut level = 0.0;
        let walk: Vec<f64> = (0..20_000)
            .map(|_| {
                level += stream.normal();
                level
            })
            .collect();
        assert!(peaks(&walk).is_empty());
        // The samples that are left out behind one group may reach into the next one.
        for place in [12_000, 12_008, 12_016, 12_025] {
            values[place] += 900.0;
        }
        let found = peaks(&values);
        assert!(found.is_sorted() && found.contains(&12_025), "{found:?}");
        assert!(peaks(&[1.0; 1000]).is_empty());
    }
}
