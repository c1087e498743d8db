//! Scales that a few wild values do not affect: medians, quantiles, robust spreads.

/// Maximum number of values; more are thinned out evenly. A median of this many is accurate to 0.3 %.
const ENOUGH: usize = 1 << 18;
/// Distance of the quartiles of a normal distribution from its median, in standard deviations.
const NORMAL_QUARTILE: f64 = 0.674_489_750_196_081_7;
/// Distance of the 2.5 % and 97.5 % quantiles from the median, in standard deviations.
const NORMAL_95: f64 = 1.959_963_984_540_054;

/// Returns an even selection of at most [`ENOUGH`] values; those that are not finite are left out.
fn thinned(values: impl ExactSizeIterator<Item = f64>) -> Vec<f64> {
    let stride = values.len().div_ceil(ENOUGH).max(1);
    values.step_by(stride).filter(|value| value.is_finite()).collect()
}

fn quantile_of(values: &mut [f64], fraction: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let at = (fraction * last as f64).round() as usize;
    Some(*values.select_nth_unstable_by(at.min(last), f64::total_cmp).1)
}

/// Returns the median; `None` if there are no values.
pub(super) fn median(values: impl ExactSizeIterator<Item = f64>) -> Option<f64> {
    quantile_of(&mut thinned(values), 0.5)
}

/// Returns the median, and the standard deviation from the median absolute deviation.
pub(super) fn centre_and_spread(values: impl ExactSizeIterator<Item = f64>) -> Option<(f64, f64)> {
    let mut values = thinned(values);
    let centre = quantile_of(&mut values, 0.5)?;
    for value in &mut values {
        *value = (*value - centre).abs();
    }
    Some((centre, quantile_of(&mut values, 0.5)? / NORMAL_QUARTILE))
}

/// Returns the standard deviation from the middle 95 %, which also holds for data of few steps, whose median deviation
/// may be 0.
pub(super) fn spread_of_95(values: impl ExactSizeIterator<Item = f64>) -> Option<f64> {
    let mut values = thinned(values);
    let (low, high) = (quantile_of(&mut values, 0.025)?, quantile_of(&mut values, 0.975)?);
    Some((high - low) / (2.0 * NORMAL_95))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wild_values_do_not_move_a_robust_scale() {
        let mut values: Vec<f64> = (0..1000).map(|i| f64::from(i) / 1000.0).collect();
        values[500] = 1e9;
        values[10] = f64::NAN;
        let (centre, spread) = centre_and_spread(values.iter().copied()).unwrap();
        assert!((centre - 0.5).abs() < 0.01, "{centre}");
        assert!((spread - 0.25 / NORMAL_QUARTILE).abs() < 0.01, "{spread}");
        assert!((spread_of_95(values.iter().copied()).unwrap() - 0.95 / 3.92).abs() < 0.01);
        assert_eq!(median(std::iter::empty()), None);
    }

    #[test]
    fn coarse_data_still_has_a_spread() {
        let steps: Vec<f64> = (0..1000).map(|i| if i % 5 == 0 { 1.0 } else { 0.0 }).collect();
        assert_eq!(centre_and_spread(steps.iter().copied()).unwrap().1, 0.0);
        assert!(spread_of_95(steps.iter().copied()).unwrap() > 0.2);
    }
}
