//! Grids of averaging factors. A grid is fixed before the first sample is seen: sums over different grids do not add.

use super::AllanError;
use serde::{Deserialize, Serialize};

/// How the averaging factors are spaced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TauSpacing {
    /// 1, 2, 4, 8…
    Octave,
    /// About twenty to the decade.
    #[default]
    Log,
    /// Every one.
    All,
    /// A list of one's own.
    Custom,
}

/// Averaging factors m in ascending order, each once; τ = m / rate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TauGrid {
    factors: Vec<usize>,
}

impl TauGrid {
    /// The largest factor of exact sums with full overlap.
    pub const MAX_FACTOR: usize = 1 << 20;
    /// Factors to the decade of [`TauGrid::log`].
    pub const PER_DECADE: u32 = 20;
    /// Factors end at this fraction of the longest segment: beyond a quarter fewer than about four degrees of freedom remain.
    const LONGEST_FRACTION: u64 = 4;

    /// The grid of that spacing for a longest segment of `longest` samples, m ≤ `longest`/4.
    ///
    /// # Errors
    /// [`AllanError::TooShort`] below four samples; [`AllanError::FactorOutOfRange`] for [`TauSpacing::Custom`] without a
    /// list (use [`TauGrid::custom`]).
    pub fn new(spacing: TauSpacing, longest: u64) -> Result<Self, AllanError> {
        match spacing {
            TauSpacing::Octave => Self::octave(longest),
            TauSpacing::Log => Self::log(longest),
            TauSpacing::All => Self::all(longest),
            TauSpacing::Custom => Self::custom([]),
        }
    }

    fn largest(longest: u64) -> Result<usize, AllanError> {
        match usize::try_from(longest / Self::LONGEST_FRACTION) {
            Ok(0) => Err(AllanError::TooShort { samples: longest, needed: Self::LONGEST_FRACTION }),
            Ok(largest) => Ok(largest.min(Self::MAX_FACTOR)),
            Err(_) => Ok(Self::MAX_FACTOR),
        }
    }

    /// Powers of two.
    ///
    /// # Errors
    /// [`AllanError::TooShort`] below four samples.
    pub fn octave(longest: u64) -> Result<Self, AllanError> {
        let largest = Self::largest(longest)?;
        Ok(Self { factors: std::iter::successors(Some(1), |m| Some(m * 2)).take_while(|m| *m <= largest).collect() })
    }

    /// Twenty to the decade, rounded to integers, each once.
    ///
    /// # Errors
    /// [`AllanError::TooShort`] below four samples.
    pub fn log(longest: u64) -> Result<Self, AllanError> {
        let largest = Self::largest(longest)?;
        let mut factors: Vec<usize> = (0..)
            .map(|step| 10f64.powf(f64::from(step) / f64::from(Self::PER_DECADE)).round() as usize)
            .take_while(|m| *m <= largest)
            .collect();
        factors.dedup();
        Ok(Self { factors })
    }

    /// Every factor.
    ///
    /// # Errors
    /// [`AllanError::TooShort`] below four samples.
    pub fn all(longest: u64) -> Result<Self, AllanError> {
        Ok(Self { factors: (1..=Self::largest(longest)?).collect() })
    }

    /// The factors given, sorted, each once.
    ///
    /// # Errors
    /// [`AllanError::FactorOutOfRange`] for 0 or more than [`TauGrid::MAX_FACTOR`]; [`AllanError::TooShort`] for none.
    pub fn custom(factors: impl IntoIterator<Item = usize>) -> Result<Self, AllanError> {
        let mut factors: Vec<usize> = factors.into_iter().collect();
        if let Some(found) = factors.iter().find(|m| !(1..=Self::MAX_FACTOR).contains(*m)) {
            return Err(AllanError::FactorOutOfRange { found: *found as u64, largest: Self::MAX_FACTOR as u64 });
        }
        factors.sort_unstable();
        factors.dedup();
        if factors.is_empty() {
            return Err(AllanError::TooShort { samples: 0, needed: Self::LONGEST_FRACTION });
        }
        Ok(Self { factors })
    }

    /// The averaging factors, ascending; never empty.
    #[must_use]
    pub fn factors(&self) -> &[usize] {
        &self.factors
    }

    /// The largest factor.
    #[must_use]
    pub fn max_factor(&self) -> usize {
        self.factors.last().copied().unwrap_or(1)
    }

    /// How many samples before a chunk its terms reach back to: what [`Overlapping::resume`](super::Overlapping::resume) needs.
    #[must_use]
    pub fn halo_len(&self) -> usize {
        2 * self.max_factor()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_grid_has_twenty_to_the_decade_up_to_a_quarter() {
        let grid = TauGrid::log(720_000).unwrap();
        assert_eq!(grid.factors()[..6], [1, 2, 3, 4, 5, 6]);
        assert!(grid.max_factor() <= 180_000 && grid.max_factor() > 160_000);
        assert!((90..=100).contains(&grid.factors().len()), "{}", grid.factors().len());
        assert!(grid.factors().windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn octaves_are_powers_of_two_and_all_is_everyone() {
        assert_eq!(TauGrid::octave(40).unwrap().factors(), [1, 2, 4, 8]);
        assert_eq!(TauGrid::all(20).unwrap().factors(), [1, 2, 3, 4, 5]);
        assert_eq!(TauGrid::octave(u64::MAX).unwrap().max_factor(), TauGrid::MAX_FACTOR);
    }

    #[test]
    fn a_list_is_sorted_and_what_cannot_be_is_refused() {
        assert_eq!(TauGrid::custom([5, 1, 5]).unwrap().factors(), [1, 5]);
        assert!(matches!(TauGrid::custom([0]), Err(AllanError::FactorOutOfRange { found: 0, .. })));
        assert!(TauGrid::custom([TauGrid::MAX_FACTOR + 1]).is_err());
        assert!(TauGrid::custom([]).is_err());
        assert!(matches!(TauGrid::log(3), Err(AllanError::TooShort { samples: 3, needed: 4 })));
    }
}
