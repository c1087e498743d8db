//! Quantum: the step of which nearly all values of a channel are multiples, found from the values alone.
//!
//! Values on a grid differ by multiples of its step. So the small differences between neighbouring values are tried as
//! steps, the largest first. A step is fitted to the values from the nearest to the farthest, so that its own small
//! error cannot grow to half a step. It is accepted if 98 of 100 values lie on the grid, with more distinct values than
//! chance would produce. Pure.

/// Fewer values do not determine a step.
const LEAST_VALUES: usize = 32;
/// A value that lies farther from the grid, in steps, is off the grid.
const BESIDE: f64 = 0.25;
/// Values are scattered if the spread of their distances from the grid is larger than this, relative to that of an even
/// distribution between its points. A grid of another step that was rounded again reaches a fifth at most.
const SCATTERED: f64 = 0.25;
/// Gaps count as equal, rounded again, if they differ from one by no more than this.
const ALIKE: f64 = 0.3;
/// Values from which distances are measured, as a share of all: a value that was rounded again may be off.
const ORIGINS: [f64; 3] = [0.5, 0.45, 0.55];
/// The share of values that may be off the grid.
const BESIDE_SHARE: f64 = 0.02;
/// The highest accepted probability of being on a grid by accident.
const CHANCE: f64 = 1e-6;
/// Differences up to this share of the greatest value are rounding of the arithmetic.
const ROUNDING: f64 = 1e-13;

/// Returns the step of these finite values, or `None` if there is none.
pub(super) fn step_of(values: &[f64]) -> Option<f64> {
    if values.len() < LEAST_VALUES {
        return None;
    }
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let size = sorted.iter().fold(0.0, |size: f64, value| size.max(value.abs()));
    let mut gaps: Vec<f64> =
        sorted.windows(2).map(|two| two[1] - two[0]).filter(|gap| *gap > ROUNDING * size).collect();
    if gaps.len() < 2 {
        return None;
    }
    gaps.sort_unstable_by(f64::total_cmp);
    let origins = ORIGINS.map(|share| {
        let origin = sorted[(share * sorted.len() as f64) as usize];
        let mut distances: Vec<f64> = sorted.iter().map(|value| value - origin).collect();
        distances.sort_unstable_by(|one, other| one.abs().total_cmp(&other.abs()));
        distances
    });
    let count = gaps.len();
    let places = [0, 1, 3, 7, 15, count / 100, count / 20, count / 10, count / 4, count / 2];
    let mut candidates: Vec<f64> = places
        .iter()
        .filter_map(|place| gaps.get(*place))
        .flat_map(|gap| [*gap, gap / 2.0, gap / 3.0, mean_about(&gaps, *gap)])
        .filter(|step| *step > ROUNDING * size)
        .collect();
    candidates.sort_unstable_by(|one, other| other.total_cmp(one));
    candidates.dedup_by(|next, kept| (*kept - *next).abs() < 1e-3 * *kept);
    candidates.into_iter().find_map(|step| origins.iter().find_map(|distances| fitted(distances, step)))
}

/// Returns the mean of the gaps that are about as large as this one; `gaps` is sorted, the smallest first.
fn mean_about(gaps: &[f64], gap: f64) -> f64 {
    let begin = gaps.partition_point(|other| *other < (1.0 - ALIKE) * gap);
    let end = gaps.partition_point(|other| *other <= (1.0 + ALIKE) * gap);
    let alike = gaps.get(begin..end).unwrap_or_default();
    alike.iter().sum::<f64>() / alike.len().max(1) as f64
}

/// Returns the step near this one of which the distances are multiples; `distances` is sorted, the smallest first.
fn fitted(distances: &[f64], first: f64) -> Option<f64> {
    let may_be_beside = (BESIDE_SHARE * distances.len() as f64) as usize;
    let (mut step, mut squares, mut products, mut beside) = (first, 0.0, 0.0, 0_usize);
    for distance in distances {
        let multiple = (distance / step).round();
        if (distance / step - multiple).abs() > BESIDE {
            beside += 1;
            if beside > may_be_beside {
                return None;
            }
        } else if multiple != 0.0 {
            squares += multiple * multiple;
            products += multiple * distance;
            step = products / squares;
        }
    }
    // Repeated with the step that was found.
    let (mut on, mut sum, mut squares, mut distinct) = (0_usize, 0.0, 0.0, Vec::new());
    for distance in distances {
        let multiple = (distance / step).round();
        let error = distance / step - multiple;
        if error.abs() <= BESIDE {
            on += 1;
            sum += error;
            squares += error * error;
            distinct.push(multiple as i64);
        }
    }
    distinct.sort_unstable();
    distinct.dedup();
    let nearly_all = distances.len() - on <= may_be_beside;
    // Two values define a step; each other one lies within the spread of the errors by accident with this probability.
    // The error common to all is that of the value from which distances are measured.
    let variance = (squares / on as f64 - (sum / on as f64).powi(2)).max(0.0);
    let spread = (12.0 * variance).sqrt().min(1.0);
    let chance = spread.max(ROUNDING).powi(i32::try_from(distinct.len()).unwrap_or(i32::MAX).saturating_sub(2));
    (nearly_all && spread < SCATTERED && distinct.len() > 2 && chance < CHANCE).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StandardNormal};

    fn noise(seed: u64, count: usize) -> Vec<f64> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| StandardNormal.sample(&mut random)).collect()
    }

    #[test]
    fn the_step_of_rounded_noise_is_found_whatever_its_size_and_offset() {
        for (seed, sigma, step, offset) in [
            (1, 0.9, 0.05, 0.0),
            (2, 0.004, 0.00333, -1.01565),
            (3, 0.05, 1.0 / 131.0, 4.77),
            (4, 1.0, 1e-6, -9.81),
            (5, 30.0, 0.1, 1e4),
            (6, 0.6, 1.0, 0.0),
        ] {
            let values: Vec<f64> =
                noise(seed, 4096).iter().map(|noise| ((offset + sigma * noise) / step).round() * step).collect();
            let found = step_of(&values).unwrap();
            assert!((found / step - 1.0).abs() < 1e-6, "{step}: {found}");
        }
    }

    #[test]
    fn values_rounded_again_and_a_few_beside_the_grid_hide_no_step() {
        // Steps of 1/16.384 deg/s, written with four decimals and converted.
        let step = 1.0 / 16.384;
        let rounded = |value: f64| (((value / step).round() * step) * 1e4).round() / 1e4;
        let mut values: Vec<f64> = noise(7, 4096).iter().map(|noise| rounded(2.0 * noise).to_radians()).collect();
        let found = step_of(&values).unwrap().to_degrees();
        assert!((found / step - 1.0).abs() < 1e-3, "{found}");
        for (place, outlier) in noise(8, 40).into_iter().enumerate() {
            values[place * 100] = outlier;
        }
        let found = step_of(&values).unwrap().to_degrees();
        assert!((found / step - 1.0).abs() < 1e-3, "{found}");
    }

    #[test]
    fn a_grid_rounded_again_to_a_fifth_of_its_step_is_found_and_no_finer_one() {
        // Steps of 0.004790 m/s², written in mg.
        let (step, written) = (0.004_790_2, 0.000_981);
        for seed in 0..40 {
            let rounded = |value: f64| ((value / step).round() * step / written).round() * written;
            let values: Vec<f64> = noise(300 + seed, 4096).iter().map(|noise| rounded(1.5 * noise)).collect();
            let found = step_of(&values).unwrap();
            assert!((found / step - 1.0).abs() < 1e-3, "{seed}: {found}");
        }
    }

    #[test]
    fn no_grid_is_found_where_there_is_none() {
        assert_eq!(step_of(&[]), None);
        assert_eq!(step_of(&[1.5; 1000]), None);
        let two: Vec<f64> = (0..1000).map(|index| f64::from(index % 2)).collect();
        assert_eq!(step_of(&two), None, "two values are no grid");
        for seed in 0..200 {
            let values = noise(100 + seed, 4096);
            assert_eq!(step_of(&values), None, "{seed}");
            // Nor if a few values repeat.
            let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let few: Vec<f64> = (0..1000).map(|_| values[random.random_range(0..6)]).collect();
            assert_eq!(step_of(&few), None, "{seed}");
        }
    }
}
