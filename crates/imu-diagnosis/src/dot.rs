//! Dot: the scalar product of two columns.

/// Returns Σ aᵢ bᵢ over the shorter column. It is summed in eight interleaved parts, which do not wait for each other.
pub(super) fn dot(one: &[f64], other: &[f64]) -> f64 {
    const PARTS: usize = 8;
    let length = one.len().min(other.len());
    let (one, other) = (one[..length].chunks_exact(PARTS), other[..length].chunks_exact(PARTS));
    let rest: f64 = one.remainder().iter().zip(other.remainder()).map(|(a, b)| a * b).sum();
    let mut sums = [0.0; PARTS];
    for (one, other) in one.zip(other) {
        for ((sum, a), b) in sums.iter_mut().zip(one).zip(other) {
            *sum += a * b;
        }
    }
    sums.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_product_is_in_the_sum_once() {
        for (length, more) in (0..40).flat_map(|length| [(length, 0), (length, 3)]) {
            let one: Vec<f64> = (0..length).map(|at| f64::from(at) + 1.0).collect();
            let other: Vec<f64> = (0..length + more).map(|at| f64::from(at) - 7.0).collect();
            let expected: f64 = one.iter().zip(&other).map(|(a, b)| a * b).sum();
            assert_eq!((dot(&one, &other), dot(&other, &one)), (expected, expected), "{length}");
        }
    }
}
