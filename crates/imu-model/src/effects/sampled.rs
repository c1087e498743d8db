//! Sums that the closed forms of sampled processes share.

/// Returns the index of the first sample at or after `time_s`. A time within a millionth of a period after a sample
/// counts as that sample's, so that decimal times match the intended samples.
pub fn index_at(time_s: f64, rate_hz: f64) -> u64 {
    (time_s * rate_hz - 1e-6).ceil().max(0.0) as u64
}

/// Returns the Allan variance at averaging factor `m` (from 1) of a process whose structure function is known:
/// `structure(k)` = R(0) − R(k), half the mean square of differences over k samples. Takes 2 `m` steps.
///
/// From σ²(m) = ½·E(ȳ₂ − ȳ₁)² with the weights' autocorrelation 2m − 3k up to k = m, k − 2m beyond; exact, and without
/// cancellation if the process hardly decorrelates within 2 `m`.
pub fn allan_variance(m: u64, structure: impl Fn(u64) -> f64) -> f64 {
    let averaged = m as f64;
    let weight = |k: u64| if k <= m { 3.0 * k as f64 - 2.0 * averaged } else { 2.0 * averaged - k as f64 };
    (1..2 * m).map(|k| weight(k) * structure(k)).sum::<f64>() / (averaged * averaged)
}

/// Returns the two-sided response of the sampled Allan variance at f·dt = `cycles`: σ²(m) = ∫ S·response df.
pub fn allan_response(m: u64, cycles: f64) -> f64 {
    let (m, x) = (m as f64, std::f64::consts::PI * cycles);
    if x.sin() == 0.0 { 0.0 } else { 2.0 * (m * x).sin().powi(4) / (m * x.sin()).powi(2) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_structure_function_of_white_noise_and_of_a_walk_give_their_allan_variances() {
        for m in [1, 2, 7, 500] {
            let averaged = m as f64;
            assert!((allan_variance(m, |_| 1.0) * averaged - 1.0).abs() < 1e-9);
            let walk = allan_variance(m, |k| 0.5 * k as f64);
            assert!((walk / ((2.0 * averaged * averaged + 1.0) / (6.0 * averaged)) - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn a_time_belongs_to_the_first_sample_at_or_after_it() {
        assert_eq!((index_at(0.0, 40.0), index_at(0.025, 40.0), index_at(0.026, 40.0)), (0, 1, 2));
        // 0.1 · 30 is a little more than 3 in binary.
        assert_eq!(index_at(0.1, 30.0), 3);
        assert_eq!(index_at(-5.0, 30.0), 0);
    }
}
