//! The other deviations, in one pass over a slice, for comparison with other tools and for captures that fit into
//! memory.
//!
//! All take rate samples and integrate them to phases with a leading 0. All return `None` if no term fits.

use imu_core::variants;
use serde::{Deserialize, Serialize};

/// The kind of deviation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::EnumString, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum Estimator {
    /// Overlapping Allan deviation: the default, and the one that streams.
    #[default]
    Oadev,
    /// Allan deviation without overlap.
    Adev,
    /// Modified Allan deviation: distinguishes white from flicker angle noise.
    Mdev,
    /// Hadamard deviation without overlap: insensitive to a constant rate ramp.
    Hdev,
    /// Overlapping Hadamard deviation.
    Ohdev,
    /// Total deviation: more degrees of freedom at long averaging times, by reflection.
    Totdev,
}

impl Estimator {
    /// All estimators.
    pub const ALL: [Self; 6] = variants();

    /// Returns the name on the command line and in JSON.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// Phases of one segment: a leading 0 and the running sums of the samples less their mean.
///
/// No deviation here depends on the mean, and without it the phases stay small. Rounding then stays below 1e-11 of a
/// deviation even with gravity on the channel.
#[derive(Debug, Clone)]
pub struct Phases(Vec<f64>);

/// A sum of squares and its number of terms; both are summed over segments.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SquareSum {
    /// Sum of the squared terms, scaled so that its mean is the variance.
    pub sum: f64,
    /// Number of terms.
    pub terms: u64,
}

impl SquareSum {
    /// Adds the sums of another segment.
    pub fn plus(self, other: Self) -> Self {
        Self { sum: self.sum + other.sum, terms: self.terms + other.terms }
    }
    /// Returns the deviation; `None` without a term.
    pub fn deviation(self) -> Option<f64> {
        (self.terms > 0).then(|| (self.sum / self.terms as f64).sqrt())
    }
}

impl Phases {
    /// Integrates rate samples; `None` if one is not finite.
    pub fn integrate(samples: &[f64]) -> Option<Self> {
        let count = samples.len().max(1) as f64;
        let rough = samples.iter().sum::<f64>() / count;
        let mean = rough + samples.iter().map(|value| value - rough).sum::<f64>() / count;
        if !mean.is_finite() {
            return None;
        }
        let mut phases = Vec::with_capacity(samples.len() + 1);
        let (mut phase, mut lost) = (0.0, 0.0);
        phases.push(phase);
        for value in samples {
            // Kahan's summation: plain running sums over millions of samples would lose digits.
            let step = (value - mean) - lost;
            let next = phase + step;
            lost = (next - phase) - step;
            phase = next;
            phases.push(phase);
        }
        Some(Self(phases))
    }

    /// Returns the number of phases.
    #[expect(clippy::len_without_is_empty, reason = "there is always the leading 0")]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns one phase in `m` ≥ 1.
    #[cfg(test)]
    pub(super) fn picked(&self, m: usize) -> Vec<f64> {
        self.0.iter().copied().step_by(m).collect()
    }

    /// Returns the means of every `m` ≥ 1 phases, one after the other.
    pub(super) fn averages(&self, m: usize) -> Vec<f64> {
        self.0.chunks_exact(m).map(|phases| phases.iter().sum::<f64>() / m as f64).collect()
    }

    /// Returns the sum of squares of an estimator at averaging factor `m` ≥ 1; its mean is the variance in the samples'
    /// unit squared.
    ///
    /// # Source
    /// Riley & Howe, NIST SP1065 (2008), sections 5.2.2 to 5.2.11.
    pub fn square_sum(&self, estimator: Estimator, m: usize) -> SquareSum {
        let x = self.0.as_slice();
        match estimator {
            Estimator::Oadev => differences(x, m, 1, second, 2.0),
            Estimator::Adev => differences(x, m, m, second, 2.0),
            Estimator::Ohdev => differences(x, m, 1, third, 6.0),
            Estimator::Hdev => differences(x, m, m, third, 6.0),
            Estimator::Mdev => modified(x, m),
            Estimator::Totdev => total(x, m),
        }
    }

    /// Returns the deviation at averaging factor `m`, in the samples' unit; `None` without a term.
    pub fn deviation(&self, estimator: Estimator, m: usize) -> Option<f64> {
        self.square_sum(estimator, m).deviation()
    }
}

/// Returns the second difference at lag m from index i, and the span of samples it needs, in units of m.
fn second(x: &[f64], i: usize, m: usize) -> Option<f64> {
    Some((x.get(i + 2 * m)? - x[i + m]) - (x[i + m] - x[i]))
}

fn third(x: &[f64], i: usize, m: usize) -> Option<f64> {
    Some((x.get(i + 3 * m)? - x[i]) - 3.0 * (x[i + 2 * m] - x[i + m]))
}

fn differences(
    x: &[f64],
    m: usize,
    stride: usize,
    difference: impl Fn(&[f64], usize, usize) -> Option<f64>,
    divisor: f64,
) -> SquareSum {
    let mut squares = SquareSum::default();
    let mut pairwise = PairwiseSum::default();
    for i in (0..x.len()).step_by(stride.max(1)) {
        let Some(d) = difference(x, i, m) else { break };
        pairwise.add(d * d);
        squares.terms += 1;
    }
    squares.sum = pairwise.total() / (divisor * (m as f64).powi(2));
    squares
}

/// Returns the modified Allan variance: second differences averaged over m, by a sliding sum that is renewed every m
/// steps so that rounding does not accumulate.
fn modified(x: &[f64], m: usize) -> SquareSum {
    let Some(terms) = (x.len() + 1).checked_sub(3 * m).filter(|terms| *terms > 0) else {
        return SquareSum::default();
    };
    let fresh = |start: usize| -> f64 { (start..start + m).filter_map(|i| second(x, i, m)).sum() };
    let mut pairwise = PairwiseSum::default();
    let mut window = 0.0;
    for start in 0..terms {
        window = if start % m == 0 {
            fresh(start)
        } else {
            let (gone, come) = (second(x, start - 1, m), second(x, start + m - 1, m));
            window + (come.unwrap_or(0.0) - gone.unwrap_or(0.0))
        };
        pairwise.add(window * window);
    }
    SquareSum { sum: pairwise.total() / (2.0 * (m as f64).powi(4)), terms: terms as u64 }
}

/// Returns the total variance: the phases are extended at both ends by reflection about their end points (SP1065,
/// equation 24).
fn total(x: &[f64], m: usize) -> SquareSum {
    let last = x.len() - 1;
    if m == 0 || m >= last {
        return SquareSum::default();
    }
    let at = |i: isize| -> f64 {
        if i < 0 {
            2.0 * x[0] - x[i.unsigned_abs()]
        } else if i as usize > last {
            2.0 * x[last] - x[2 * last - i as usize]
        } else {
            x[i as usize]
        }
    };
    let mut pairwise = PairwiseSum::default();
    for i in 1..last as isize {
        let reach = m as isize;
        let d = (at(i + reach) - at(i)) - (at(i) - at(i - reach));
        pairwise.add(d * d);
    }
    SquareSum { sum: pairwise.total() / (2.0 * (m as f64).powi(2)), terms: last as u64 - 1 }
}

/// Sums blocks before blocks of blocks: rounding grows with the logarithm of the count.
#[derive(Debug)]
struct PairwiseSum {
    levels: [f64; 64],
    count: u64,
}

impl Default for PairwiseSum {
    fn default() -> Self {
        Self { levels: [0.0; 64], count: 0 }
    }
}

impl PairwiseSum {
    fn add(&mut self, term: f64) {
        let mut carry = term;
        self.count += 1;
        for level in &mut self.levels[..self.count.trailing_zeros() as usize] {
            carry += std::mem::take(level);
        }
        self.levels[self.count.trailing_zeros() as usize] = carry;
    }
    fn total(&self) -> f64 {
        self.levels.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimator_without_a_term_has_no_deviation() {
        let phases = Phases::integrate(&[1.0, 2.0, 3.0, 5.0]).unwrap();
        assert_eq!(phases.len(), 5);
        for (estimator, first_empty) in [
            (Estimator::Oadev, 3),
            (Estimator::Adev, 3),
            (Estimator::Mdev, 2),
            (Estimator::Hdev, 2),
            (Estimator::Ohdev, 2),
            (Estimator::Totdev, 4),
        ] {
            assert!(phases.deviation(estimator, first_empty - 1).is_some(), "{estimator:?}");
            assert_eq!(phases.deviation(estimator, first_empty), None, "{estimator:?}");
        }
        assert!(Phases::integrate(&[1.0, f64::NAN]).is_none());
        assert_eq!(Phases::integrate(&[]).unwrap().deviation(Estimator::Oadev, 1), None);
    }

    #[test]
    fn a_ramp_is_seen_by_allan_and_not_by_hadamard() {
        let ramp: Vec<f64> = (0..1000).map(|i| f64::from(i) * 1e-3).collect();
        let phases = Phases::integrate(&ramp).unwrap();
        let oadev = phases.deviation(Estimator::Oadev, 10).unwrap();
        assert!((oadev - 1e-3 * 10.0 / 2f64.sqrt()).abs() < 1e-12, "{oadev}");
        assert!(phases.deviation(Estimator::Ohdev, 10).unwrap() < 1e-12);
    }

    #[test]
    fn every_estimator_is_found_by_its_name() {
        for estimator in Estimator::ALL {
            assert_eq!(estimator.name().parse(), Ok(estimator));
        }
    }
}
