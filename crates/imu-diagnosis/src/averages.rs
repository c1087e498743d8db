//! Averages: the mean, the median, quantiles and running sums of values.

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
