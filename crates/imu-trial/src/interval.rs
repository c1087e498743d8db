//! Rates: a count among a total, with the 95 % interval of Clopper and Pearson.

use serde::Serialize;
use statrs::function::beta::checked_beta_reg;

/// A count among a total.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rate {
    /// The count.
    pub count: usize,
    /// The total.
    pub of: usize,
    /// The ratio; none if the total is 0.
    pub share: Option<f64>,
    /// The 95 % interval ([`clopper_pearson`]).
    pub ci95: Option<[f64; 2]>,
}

impl Rate {
    /// Creates the rate of a count.
    pub fn new(count: usize, of: usize) -> Self {
        let some = of > 0;
        Self {
            count,
            of,
            share: some.then(|| count as f64 / of as f64),
            ci95: some.then(|| clopper_pearson(count, of, 0.95)),
        }
    }

    /// Returns the rate of values that are true.
    pub fn of(answers: impl IntoIterator<Item = bool>) -> Self {
        let (mut count, mut of) = (0, 0);
        for answer in answers {
            count += usize::from(answer);
            of += 1;
        }
        Self::new(count, of)
    }
}

/// Returns the exact interval of a probability after `count` of `of`, with at least this confidence for any
/// probability.
///
/// # Source
/// C. J. Clopper, E. S. Pearson, Biometrika 26 (1934) 404: quantiles of Beta(k, n − k + 1) and Beta(k + 1, n − k).
/// # Validation
/// `clopper_pearson_has_its_published_values`: to the digits of published tables.
pub fn clopper_pearson(count: usize, of: usize, confidence: f64) -> [f64; 2] {
    let (k, n, tail) = (count as f64, of as f64, 0.5 * (1.0 - confidence));
    let low = if count == 0 { 0.0 } else { quantile(k, n - k + 1.0, tail) };
    let high = if count >= of { 1.0 } else { quantile(k + 1.0, n - k, 1.0 - tail) };
    [low, high]
}

/// Returns the quantile of the beta distribution, by bisection: it is rarely needed, and has to be right in the far
/// tails.
fn quantile(a: f64, b: f64, probability: f64) -> f64 {
    let (mut low, mut high) = (0.0_f64, 1.0_f64);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        let below = checked_beta_reg(a, b, middle).unwrap_or(if middle < a / (a + b) { 0.0 } else { 1.0 });
        if below < probability { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clopper_pearson_has_its_published_values() {
        // None and all have the closed form 1 - (α/2)^(1/n); for 10 of 350 a published table has 1.4-5.2 %.
        let near = |found: [f64; 2], expected: [f64; 2], within: f64| {
            assert!((found[0] - expected[0]).abs() < within && (found[1] - expected[1]).abs() < within, "{found:?}");
        };
        near(clopper_pearson(0, 10, 0.95), [0.0, 1.0 - 0.025_f64.powf(0.1)], 1e-12);
        near(clopper_pearson(10, 10, 0.95), [0.025_f64.powf(0.1), 1.0], 1e-12);
        near(clopper_pearson(10, 350, 0.95), [0.0138, 0.0519], 1e-4);
        // R: binom.test(5, 10)$conf.int
        near(clopper_pearson(5, 10, 0.95), [0.187_086, 0.812_914], 1e-6);
        // The tails of the beta distribution near its ends.
        let [low, high] = clopper_pearson(81, 263, 0.95);
        assert!((checked_beta_reg(81.0, 183.0, low).unwrap() - 0.025).abs() < 1e-9);
        assert!((checked_beta_reg(82.0, 182.0, high).unwrap() - 0.975).abs() < 1e-9);
    }

    #[test]
    fn a_rate_of_nothing_is_none() {
        let none = Rate::of([]);
        assert_eq!((none.share, none.ci95), (None, None));
        let some = Rate::of([true, false, true, true]);
        assert_eq!((some.count, some.of, some.share), (3, 4, Some(0.75)));
    }
}
