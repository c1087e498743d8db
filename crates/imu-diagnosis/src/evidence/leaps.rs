//! Leaps: steps of the level that are visible without a law of the noise, which such steps distort.

use crate::averages::median;

/// Samples between the starts of blocks, and samples in a block.
const STRIDE: usize = 32;
const BLOCK: usize = 64;
/// With more steps than this, they are not steps of a level.
const MOST: usize = 32;

/// Returns the places where the level leaps: the medians of the blocks before and behind differ far more than the
/// medians about other places, and far more than the scatter of the nearby samples predicts.
///
/// A step that takes up to [`STRIDE`] samples to rise lies between the blocks. The place is where two constant levels
/// fit best, by the sum of absolute distances.
pub(super) fn leaps(values: &[f64]) -> Vec<usize> {
    /// Medians differ far more if they differ by this many robust standard deviations of differences between blocks,
    /// and by this many standard errors of a median.
    const TIMES: f64 = 15.0;
    const ERRORS: f64 = 10.0;
    let count = values.len().saturating_sub(BLOCK) / STRIDE;
    if count < 16 {
        return Vec::new();
    }
    let medians: Vec<f64> =
        (0..count).map(|at| median(&mut values[at * STRIDE..at * STRIDE + BLOCK].to_vec())).collect();
    // Around the place j·STRIDE: behind it from one stride on, before it up to one stride.
    let apart: Vec<f64> = (3..count - 1).map(|at| medians[at + 1] - medians[at - 3]).collect();
    let usual = median(&mut apart.iter().map(|value| value.abs()).collect::<Vec<f64>>()) / 0.674_49;
    let mut found = Vec::new();
    let mut at = 0;
    while at < apart.len() {
        if apart[at].abs() <= TIMES * usual {
            at += 1;
            continue;
        }
        let end = (at..apart.len()).find(|next| apart[*next].abs() <= TIMES * usual).unwrap_or(apart.len());
        let (peak, size) =
            (at..end).map(|own| (own, apart[own])).fold((at, 0.0f64), |a, b| if b.1.abs() > a.1.abs() { b } else { a });
        at = end;
        let place = (peak + 3) * STRIDE;
        let (before, behind) = (medians[peak], medians[peak + 4]);
        let about = |from: usize, level: f64| {
            let mut distances: Vec<f64> =
                values[from..from + BLOCK].iter().map(|value| (value - level).abs()).collect();
            1.48 * median(&mut distances)
        };
        let spread = about(place - 3 * STRIDE, before).max(about(place + STRIDE, behind));
        // A median's standard error is 1.25 times that of a mean.
        if size.abs() > ERRORS * 1.25 * spread / (BLOCK as f64).sqrt() {
            found.push(split(values, place, before, behind));
        }
    }
    found.dedup();
    if found.len() > MOST { Vec::new() } else { found }
}

/// Returns the place near another one that best separates the samples of one level from those of the other.
fn split(values: &[f64], about: usize, before: f64, behind: f64) -> usize {
    let (from, to) = (about - 2 * STRIDE, (about + 2 * STRIDE).min(values.len()));
    let (mut sum, mut best) = (0.0, (0.0, from));
    for (at, value) in values.iter().enumerate().take(to).skip(from) {
        sum += (value - before).abs() - (value - behind).abs();
        if sum < best.0 {
            best = (sum, at + 1);
        }
    }
    best.1
}

/// Returns whether the level behind a step of `size` at a place differs from the level before it permanently, not only
/// during a loud stretch.
pub fn is_lasting(values: &[f64], at: usize, size: f64) -> bool {
    const LONG: usize = 512;
    let level = |from: usize, to: usize| (to - from >= STRIDE).then(|| median(&mut values[from..to].to_vec()));
    let before = level(at.saturating_sub(STRIDE + LONG), at.saturating_sub(STRIDE));
    let behind = level((at + STRIDE).min(values.len()), (at + STRIDE + LONG).min(values.len()));
    before.zip(behind).is_some_and(|(before, behind)| ((behind - before) / size - 1.0).abs() < 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::{Stream, StreamId};

    fn noise(seed: u64, count: usize) -> Vec<f64> {
        let mut stream = Stream::new(seed, StreamId { owner: 92, effect: 0, instance: 0 });
        (0..count).map(|_| stream.normal()).collect()
    }

    #[test]
    fn large_steps_are_found_where_they_are_and_nothing_else_is() {
        let mut values = noise(1, 20_000);
        assert!(leaps(&values).is_empty());
        values[9_000..9_200].iter_mut().for_each(|value| *value *= 80.0);
        assert!(leaps(&values).is_empty(), "a burst is no step: {:?}", leaps(&values));
        let places = [640, 5_003, 12_345, 12_600, 19_777];
        for (at, size) in places.iter().zip([40.0, -300.0, 1e4, 60.0, -25.0]) {
            values[*at..].iter_mut().for_each(|value| *value += size);
        }
        let found = leaps(&values);
        assert_eq!(found.len(), places.len(), "{found:?}");
        assert!(found.iter().zip(&places).all(|(a, b)| a.abs_diff(*b) <= 1), "{found:?}");
    }

    #[test]
    fn noise_that_wanders_does_not_leap() {
        let mut level = 0.0;
        let walk: Vec<f64> = noise(2, 20_000)
            .into_iter()
            .map(|step| {
                level += step;
                level
            })
            .collect();
        assert!(leaps(&walk).is_empty());
        let tone: Vec<f64> = (0..20_000).map(|t| 100.0 * (f64::from(t) * 0.003).sin()).collect();
        assert!(leaps(&tone).is_empty());
        assert!(leaps(&[1.0; 100]).is_empty());
    }
}
