//! Moments, histogram and a test for normality of one channel, streaming and mergeable.
//!
//! Samples enter in any portions ([`Accumulator::push`]) and order; accumulators of parts can be added
//! ([`Accumulator::merge`]). Samples that are not finite are counted and left out. Memory is a fixed few kilobytes.

mod checkpoint;

use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Maximum number of bins in a histogram; ranges double, so that at least half of the bins are in use.
const BINS: usize = 128;
/// Number of samples after which the first bins are laid out.
const SEED: usize = 64;

/// Central moments up to the fourth, combined without loss of digits.
///
/// # Source
/// P. Pébay, Formulas for robust, one-pass parallel computation of covariances and arbitrary-order statistical moments,
/// Sandia report SAND2008-6212 (2008), equations 2.1 and 3.1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moments {
    count: u64,
    mean: f64,
    m2: f64,
    m3: f64,
    m4: f64,
}

impl Moments {
    /// Takes one value; it must be finite.
    pub fn add(&mut self, value: f64) {
        let before = self.count as f64;
        self.count += 1;
        let count = self.count as f64;
        let delta = value - self.mean;
        let step = delta / count;
        let square = step * step;
        let term = delta * step * before;
        self.m4 += term * square * (count * count - 3.0 * count + 3.0) + 6.0 * square * self.m2 - 4.0 * step * self.m3;
        self.m3 += term * step * (count - 2.0) - 3.0 * step * self.m2;
        self.m2 += term;
        self.mean += step;
    }

    /// Returns the mean; `None` without a value.
    pub fn mean(&self) -> Option<f64> {
        (self.count > 0).then_some(self.mean)
    }
    /// Returns the standard deviation, divided by n − 1; `None` below two values.
    pub fn std(&self) -> Option<f64> {
        (self.count > 1).then(|| (self.m2 / (self.count as f64 - 1.0)).max(0.0).sqrt())
    }
    /// Returns the third standardised moment, divided by n; `None` for constant data.
    pub fn skewness(&self) -> Option<f64> {
        let spread = self.spread()?;
        Some(self.m3 / self.count as f64 / spread.powf(1.5)).filter(|value| value.is_finite())
    }
    /// Returns the fourth standardised moment, divided by n, less the 3 of a normal distribution; `None` for constant
    /// data.
    pub fn excess_kurtosis(&self) -> Option<f64> {
        let spread = self.spread()?;
        Some(self.m4 / self.count as f64 / (spread * spread) - 3.0).filter(|value| value.is_finite())
    }
    /// Returns the variance divided by n, if it is more than rounding.
    fn spread(&self) -> Option<f64> {
        let variance = self.m2 / self.count as f64;
        (self.count > 1 && variance > (self.mean * 1e-15).powi(2)).then_some(variance)
    }
}

/// Equal bins over the data's range; the range doubles when a value falls outside, so that bins are joined in pairs and
/// each value is needed only once.
#[derive(Debug, Clone, PartialEq, Default)]
struct Bins {
    /// Bin `i` extends from `(first + i) · 2^exponent`, inclusive, to the next edge: edges belong to a fixed lattice,
    /// so that the bins of different parts coincide.
    first: i64,
    exponent: i32,
    counts: Vec<u64>,
}

impl Bins {
    fn width(&self) -> f64 {
        2f64.powi(self.exponent)
    }

    fn add(&mut self, value: f64, count: u64) {
        loop {
            let lattice = value / self.width();
            // Beyond 2^53 steps, neighbouring edges are equal numbers.
            if lattice.abs() < 9e15 {
                let cell = lattice.floor() as i64;
                if self.counts.is_empty() {
                    self.first = cell;
                    self.counts.push(0);
                }
                let (low, high) = (cell.min(self.first), cell.max(self.first + self.counts.len() as i64 - 1));
                if high - low < BINS as i64 {
                    self.reach(low, high);
                    self.counts[(cell - low) as usize] += count;
                    return;
                }
            }
            self.coarsen();
        }
    }

    fn reach(&mut self, low: i64, high: i64) {
        if low < self.first {
            self.counts.splice(0..0, std::iter::repeat_n(0, (self.first - low) as usize));
            self.first = low;
        }
        self.counts.resize((high - low + 1) as usize, 0);
    }

    fn coarsen(&mut self) {
        let first = self.first.div_euclid(2);
        let mut counts = vec![0; self.counts.len() / 2 + 1];
        for (index, count) in self.counts.iter().enumerate() {
            counts[((self.first + index as i64).div_euclid(2) - first) as usize] += count;
        }
        while counts.last() == Some(&0) {
            counts.pop();
        }
        self.first = first;
        self.counts = counts;
        self.exponent += 1;
    }
}

/// Folds the samples of one channel.
#[derive(Debug, Clone, Default)]
pub struct Accumulator {
    moments: Moments,
    min: f64,
    max: f64,
    not_finite: u64,
    /// The first values, until bins can be laid out.
    seed: Vec<f64>,
    bins: Option<Bins>,
}

impl Accumulator {
    /// Creates an accumulator without samples.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes samples.
    pub fn push(&mut self, samples: &[f64]) {
        for value in samples {
            self.add(*value);
        }
    }

    fn add(&mut self, value: f64) {
        if !value.is_finite() {
            self.not_finite += 1;
            return;
        }
        if self.moments.count == 0 {
            (self.min, self.max) = (value, value);
        }
        self.min = self.min.min(value);
        self.max = self.max.max(value);
        self.moments.add(value);
        match &mut self.bins {
            Some(bins) => bins.add(value, 1),
            None => {
                self.seed.push(value);
                if self.seed.len() >= SEED && self.max > self.min {
                    self.bins = Some(self.lay_out());
                    self.seed = Vec::new();
                } else if self.seed.len() >= 1 << 16 {
                    // Constant so far: one value represents all, and the moments have its count.
                    self.seed.truncate(1 << 15);
                }
            }
        }
    }

    /// Returns bins of a sixty-fourth of the seed's range, from which doubling continues.
    fn lay_out(&self) -> Bins {
        // Divided before subtracted: the range of the largest doubles would overflow.
        let width = self.max / SEED as f64 - self.min / SEED as f64;
        let exponent = if width > 0.0 { (width.log2().floor() as i32).clamp(-1000, 1000) } else { -40 };
        let mut bins = Bins { first: 0, exponent, counts: Vec::new() };
        // If values were constant, more of them arrived than were kept.
        let surplus = self.moments.count - self.seed.len() as u64;
        for (index, value) in self.seed.iter().enumerate() {
            bins.add(*value, if index == 0 { 1 + surplus } else { 1 });
        }
        bins
    }

    /// Returns the statistics so far.
    pub fn statistics(&self, unit: &str) -> Statistics {
        let moments = self.moments;
        let any = moments.count > 0;
        let bins = match &self.bins {
            Some(bins) => Some(bins.clone()),
            None if any => Some(self.lay_out()),
            None => None,
        };
        let histogram = bins.map(|bins| {
            let edges =
                (0..=bins.counts.len()).map(|index| (bins.first + index as i64) as f64 * bins.width()).collect();
            Histogram { edges, counts: bins.counts }
        });
        Statistics {
            unit: unit.to_owned(),
            n: moments.count,
            not_finite: self.not_finite,
            mean: moments.mean(),
            std: moments.std(),
            min: any.then_some(self.min),
            max: any.then_some(self.max),
            skewness: moments.skewness(),
            kurtosis: moments.excess_kurtosis(),
            histogram: histogram.unwrap_or_default(),
            normality: Normality::jarque_bera(&moments),
        }
    }
}

/// Counts in equal bins.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Histogram {
    /// Edges of the bins, one more than the number of bins, ascending; a bin includes its lower edge.
    pub edges: Vec<f64>,
    /// Number of samples in each bin.
    pub counts: Vec<u64>,
}

/// Whether the samples are normally distributed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Normality {
    /// The test: `jarque-bera`.
    pub test: String,
    /// The statistic of the test.
    pub statistic: f64,
    /// How often a normal distribution gives as large a statistic.
    pub p_value: f64,
    /// The verdict: `normal` (p ≥ 0.01) or `not_normal`.
    pub verdict: String,
}

impl Normality {
    /// Below this p-value the verdict is `not_normal`.
    const LEVEL: f64 = 0.01;
    /// Minimum number of values for the asymptotic distribution.
    const LEAST: u64 = 100;

    /// Computes the test of Jarque and Bera: n/6 (skewness² + excess²/4) against χ² with two degrees of freedom.
    ///
    /// The test assumes independent samples. A slow walk or flicker beside the noise reduces their effective number and
    /// can fail the test although every contribution is normal; skewness and kurtosis show how much it matters. `None`
    /// below 100 samples or for constant data.
    ///
    /// # Source
    /// C. M. Jarque and A. K. Bera, International Statistical Review 55 (1987) 163.
    fn jarque_bera(moments: &Moments) -> Option<Self> {
        if moments.count < Self::LEAST {
            return None;
        }
        let (skewness, excess) = (moments.skewness()?, moments.excess_kurtosis()?);
        let statistic = moments.count as f64 / 6.0 * (skewness * skewness + excess * excess / 4.0);
        let p_value = ChiSquared::new(2.0).ok()?.sf(statistic);
        let verdict = if p_value >= Self::LEVEL { "normal" } else { "not_normal" };
        (statistic.is_finite() && p_value.is_finite()).then(|| Self {
            test: "jarque-bera".to_owned(),
            statistic,
            p_value,
            verdict: verdict.to_owned(),
        })
    }
}

/// The distribution of one channel's samples; values are null if there is too little data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Statistics {
    /// Unit of mean, std, min and max, and of the histogram's edges.
    pub unit: String,
    /// Number of samples.
    pub n: u64,
    /// Number of samples that were not finite and were left out.
    pub not_finite: u64,
    /// Mean.
    pub mean: Option<f64>,
    /// Standard deviation (n − 1).
    pub std: Option<f64>,
    /// Least value.
    pub min: Option<f64>,
    /// Greatest value.
    pub max: Option<f64>,
    /// Third standardised moment.
    pub skewness: Option<f64>,
    /// Excess kurtosis: 0 for a normal distribution.
    pub kurtosis: Option<f64>,
    /// Histogram over the range of the data.
    pub histogram: Histogram,
    /// Test for normality.
    pub normality: Option<Normality>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(samples: &[f64]) -> Statistics {
        let mut accumulator = Accumulator::new();
        accumulator.push(samples);
        accumulator.statistics("rad/s")
    }

    fn uniform(count: usize) -> Vec<f64> {
        let mut state = 1_234_567_890u64;
        (0..count)
            .map(|_| {
                let value = state as f64 / 2_147_483_647.0;
                state = 16_807 * state % 2_147_483_647;
                value
            })
            .collect()
    }

    fn close(found: f64, expected: f64, error: f64) {
        assert!((found - expected).abs() <= error, "{found} instead of {expected}");
    }

    /// NIST SP1065, section 12.4, recomputed to full precision (tests/golden/allan/sp1065_1000point.json).
    #[test]
    fn the_thousand_point_set_has_its_published_statistics() {
        let statistics = of(&uniform(1000));
        close(statistics.max.unwrap(), 0.995_745_294_259_742_5, 1e-15);
        close(statistics.min.unwrap(), 0.001_371_759_921_951_107_6, 1e-15);
        close(statistics.mean.unwrap(), 0.489_774_462_859_506_93, 1e-14);
        assert_eq!(statistics.n, 1000);
        let normality = statistics.normality.unwrap();
        assert_eq!(normality.verdict, "not_normal");
    }

    #[test]
    fn small_sets_have_the_moments_of_the_textbook() {
        let statistics = of(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]);
        close(statistics.mean.unwrap(), 5.0, 1e-15);
        close(statistics.std.unwrap(), (32.0f64 / 7.0).sqrt(), 1e-14);
        close(statistics.skewness.unwrap(), 42.0 / 8.0 / 8.0, 1e-14);
        close(statistics.kurtosis.unwrap(), 356.0 / 8.0 / 16.0 - 3.0, 1e-14);
        assert_eq!(statistics.normality, None);
    }

    #[test]
    fn gravity_on_the_channel_costs_no_digits() {
        let samples = uniform(100_000);
        let raised: Vec<f64> = samples.iter().map(|value| value * 1e-3 - 9.80665).collect();
        let (plain, raised) = (of(&samples), of(&raised));
        close(raised.std.unwrap() / plain.std.unwrap(), 1e-3, 1e-12);
        close(raised.skewness.unwrap(), plain.skewness.unwrap(), 1e-9);
        close(raised.kurtosis.unwrap(), plain.kurtosis.unwrap(), 1e-9);
        close(plain.kurtosis.unwrap(), -1.2, 0.01);
    }

    #[test]
    fn sums_of_uniforms_are_normal_to_the_test_until_one_value_is_wild() {
        let normal: Vec<f64> = uniform(120_000).chunks(48).map(|twelve| twelve.iter().sum::<f64>() - 24.0).collect();
        assert_eq!(of(&normal).normality.unwrap().verdict, "normal");
        let mut wild = normal;
        wild[7] = 40.0;
        assert_eq!(of(&wild).normality.unwrap().verdict, "not_normal");
    }

    #[test]
    fn nothing_and_constants_are_answered_without_nan() {
        let empty = of(&[]);
        assert_eq!((empty.n, empty.mean, empty.histogram.counts.len()), (0, None, 0));
        for count in [1usize, 63, 64, 70_000] {
            let constant = of(&vec![-9.80665; count]);
            assert_eq!((constant.min, constant.max, constant.skewness), (Some(-9.80665), Some(-9.80665), None));
            assert_eq!(constant.histogram.counts, [count as u64]);
            assert_eq!(constant.normality, None);
            assert!(!serde_json::to_string(&constant).unwrap().contains("NaN"));
        }
        let bad = of(&[f64::NAN, 1.0, f64::INFINITY]);
        assert_eq!((bad.n, bad.not_finite), (1, 2));
        let huge = of(&[f64::MAX, f64::MIN, 0.0]);
        assert!(!serde_json::to_string(&huge).unwrap().contains("null,null,null"), "{huge:?}");
    }

    #[test]
    fn a_constant_that_moves_at_last_is_still_counted_whole() {
        let mut samples = vec![1.0; 100_000];
        samples.push(2.0);
        let histogram = of(&samples).histogram;
        assert_eq!(histogram.counts.iter().sum::<u64>(), 100_001);
        assert_eq!((histogram.counts.first(), histogram.counts.last()), (Some(&100_000), Some(&1)));
    }

    fn check_histogram(samples: &[f64], histogram: &Histogram) -> Result<(), TestCaseError> {
        prop_assert_eq!(histogram.counts.iter().sum::<u64>(), samples.len() as u64);
        prop_assert!(histogram.counts.len() <= BINS);
        for (index, count) in histogram.counts.iter().enumerate() {
            let bin = histogram.edges[index]..histogram.edges[index + 1];
            prop_assert_eq!(samples.iter().filter(|value| bin.contains(value)).count() as u64, *count);
        }
        Ok(())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn the_histogram_has_every_sample(
            samples in proptest::collection::vec(-1e3..1e3f64, 0..400),
            scale in prop::sample::select(vec![1e-6, 1.0, 1e4]),
        ) {
            let samples: Vec<f64> = samples.iter().map(|value| value * scale + 3.0).collect();
            check_histogram(&samples, &of(&samples).histogram)?;
        }
    }
}
