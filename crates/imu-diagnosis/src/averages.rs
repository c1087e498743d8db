//! Averages: the mean, the median, quantiles and running sums of values, and a robust standard deviation.

/// Returns the mean; 0 of no values.
pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Returns the sums of the first values: of none, of one, up to all.
pub(super) fn sums(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut sum = 0.0;
    let next = |value| {
        sum += value;
        sum
    };
    [0.0].into_iter().chain(values.map(next)).collect()
}

/// The median of the squares of standard normal values.
pub(super) const MEDIAN: f64 = 0.454_936;

/// Returns the median of some values, which it reorders.
pub(super) fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Returns the value that a share of all values is below; `None` of no values.
pub(super) fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get((share * values.len() as f64) as usize).copied()
}

/// Returns a robust standard deviation of the white part, U, from differences of neighbours.
pub(super) fn scale_of(values: &[f64]) -> f64 {
    /// The part of the differences that spikes do not affect, and the root mean square of normal differences in that
    /// part.
    const MOST: f64 = 0.95;
    const OF_MOST: f64 = 0.871;
    let mut distances: Vec<f64> = values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    let rms = |of: &[f64]| (0.5 * of.iter().map(|d| d * d).sum::<f64>() / of.len().max(1) as f64).sqrt();
    let all = rms(&distances);
    let most = (MOST * distances.len() as f64) as usize;
    let most = most.min(distances.len() - 1);
    let (lower, ..) = distances.select_nth_unstable_by(most, f64::total_cmp);
    let trimmed = rms(lower) / OF_MOST;
    let robust = median(&mut distances) / (0.674_49 * 2f64.sqrt());
    // If half the neighbours are equal, a step is wider than the noise.
    match (robust > 0.2 * trimmed, trimmed > 0.0) {
        (true, _) if robust > 0.0 => robust,
        (_, true) => trimmed,
        _ => all,
    }
}
