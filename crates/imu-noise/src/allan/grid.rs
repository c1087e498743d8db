//! Grids of averaging factors. A grid is fixed before the first sample, because sums over different grids cannot be
//! added.

use super::AllanError;
use serde::{Deserialize, Serialize};

/// Terms per averaging time if not every phase is the newest of a term.
pub(super) const OVERLAP: usize = 16;

/// The spacing of averaging factors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TauSpacing {
    /// 1, 2, 4, 8…
    Octave,
    /// About twenty per decade.
    #[default]
    Log,
    /// Every factor up to [`TauGrid::FULL_OVERLAP`], twenty per decade beyond.
    All,
    /// A custom list.
    Custom,
}

/// Averaging factors m in ascending order, each once; τ = m / rate.
///
/// Up to [`TauGrid::FULL_OVERLAP`] every phase is the newest of a second difference. Beyond it, differences are taken
/// at every m/16th phase, and factors are multiples of 16.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TauGrid {
    factors: Vec<usize>,
    /// Binary logarithm of the largest factor with full overlap.
    full_overlap: u8,
}

impl TauGrid {
    /// The largest factor of sums with full overlap: an hour at 288 Hz. It bounds their memory.
    pub const FULL_OVERLAP: usize = 1 << Self::FULL_OVERLAP_BITS;
    const FULL_OVERLAP_BITS: u8 = 20;
    /// The largest factor: 15 days at 800 Hz.
    pub const MAX_FACTOR: usize = 1 << 30;
    /// Factors per decade of [`TauGrid::log`].
    pub const PER_DECADE: u32 = 20;
    /// Factors end at this fraction of the longest segment: beyond a quarter, fewer than about four degrees of freedom
    /// remain.
    const LONGEST_FRACTION: u64 = 4;

    /// Returns the grid of that spacing for a longest segment of `longest` samples, m ≤ `longest`/4.
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

    /// Returns powers of two.
    ///
    /// # Errors
    /// [`AllanError::TooShort`] below four samples.
    pub fn octave(longest: u64) -> Result<Self, AllanError> {
        let largest = Self::largest(longest)?;
        Self::custom(std::iter::successors(Some(1), |m| Some(m * 2)).take_while(|m| *m <= largest))
    }

    /// Returns twenty factors per decade, rounded to integers, each once.
    ///
    /// # Errors
    /// [`AllanError::TooShort`] below four samples.
    pub fn log(longest: u64) -> Result<Self, AllanError> {
        Self::custom(Self::logarithmic(Self::largest(longest)?))
    }

    fn logarithmic(largest: usize) -> impl Iterator<Item = usize> {
        (0..)
            .map(|step| 10f64.powf(f64::from(step) / f64::from(Self::PER_DECADE)).round() as usize)
            .take_while(move |m| *m <= largest)
    }

    /// Returns every factor up to [`TauGrid::FULL_OVERLAP`], and beyond it those of [`TauGrid::log`].
    ///
    /// # Errors
    /// [`AllanError::TooShort`] below four samples.
    pub fn all(longest: u64) -> Result<Self, AllanError> {
        let largest = Self::largest(longest)?;
        let beyond = Self::logarithmic(largest).filter(|m| *m > Self::FULL_OVERLAP);
        Self::custom((1..=largest.min(Self::FULL_OVERLAP)).chain(beyond))
    }

    /// Returns the given factors, sorted, each once; factors beyond [`TauGrid::FULL_OVERLAP`] become the multiple of 16
    /// below them.
    ///
    /// # Errors
    /// [`AllanError::FactorOutOfRange`] for 0 or more than [`TauGrid::MAX_FACTOR`]; [`AllanError::TooShort`] for none.
    pub fn custom(factors: impl IntoIterator<Item = usize>) -> Result<Self, AllanError> {
        Self::with_full_overlap(factors, Self::FULL_OVERLAP_BITS)
    }

    /// Sets full overlap up to `1 << full_overlap`, at least 16.
    pub(super) fn with_full_overlap(
        factors: impl IntoIterator<Item = usize>,
        full_overlap: u8,
    ) -> Result<Self, AllanError> {
        if !(OVERLAP.ilog2()..=u32::from(Self::FULL_OVERLAP_BITS)).contains(&full_overlap.into()) {
            return Err(AllanError::FactorOutOfRange {
                found: full_overlap.into(),
                largest: Self::FULL_OVERLAP as u64,
            });
        }
        let mut factors: Vec<usize> = factors.into_iter().collect();
        if let Some(found) = factors.iter().find(|m| !(1..=Self::MAX_FACTOR).contains(*m)) {
            return Err(AllanError::FactorOutOfRange { found: *found as u64, largest: Self::MAX_FACTOR as u64 });
        }
        for m in factors.iter_mut().filter(|m| **m > 1 << full_overlap) {
            *m -= *m % OVERLAP;
        }
        factors.sort_unstable();
        factors.dedup();
        if factors.is_empty() {
            return Err(AllanError::TooShort { samples: 0, needed: Self::LONGEST_FRACTION });
        }
        Ok(Self { factors, full_overlap })
    }

    /// Returns the averaging factors, ascending; never empty.
    pub fn factors(&self) -> &[usize] {
        &self.factors
    }

    /// Returns the largest factor.
    pub fn max_factor(&self) -> usize {
        self.factors.last().copied().unwrap_or(1)
    }

    /// Returns the factors whose differences are taken at every phase: the first ones.
    pub fn full_overlap(&self) -> &[usize] {
        &self.factors[..self.full_factors()]
    }

    /// Returns the factors beyond full overlap.
    pub fn beyond_full_overlap(&self) -> &[usize] {
        &self.factors[self.full_factors()..]
    }

    fn full_factors(&self) -> usize {
        self.factors.partition_point(|m| *m <= 1 << self.full_overlap)
    }

    /// Returns the phases from one second difference of factor `m` to the next: 1 with full overlap, else m/16.
    pub fn stride(&self, m: usize) -> usize {
        if m <= 1 << self.full_overlap { 1 } else { m / OVERLAP }
    }

    /// Returns the binary logarithm of the largest factor with full overlap.
    pub(super) fn full_overlap_bits(&self) -> u8 {
        self.full_overlap
    }

    /// Returns how many samples before a cut the terms of full overlap use;
    /// [`Overlapping::restore`](super::Overlapping::restore) needs them.
    pub fn halo_len(&self) -> usize {
        2 * self.full_overlap().last().copied().unwrap_or(0)
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
        let all = TauGrid::all(14_400_000).unwrap();
        assert_eq!(all.full_overlap().len(), TauGrid::FULL_OVERLAP);
        assert_eq!(all.beyond_full_overlap().len(), 11);
    }

    #[test]
    fn beyond_full_overlap_factors_are_multiples_of_their_strides() {
        let grid = TauGrid::log(14_400_000).unwrap();
        assert_eq!(grid.full_overlap().last(), Some(&1_000_000));
        assert!(grid.max_factor() > 3_500_000 && grid.max_factor() <= 3_600_000, "{}", grid.max_factor());
        assert!(grid.beyond_full_overlap().iter().all(|m| 16 * grid.stride(*m) == *m));
        assert!(grid.full_overlap().iter().all(|m| grid.stride(*m) == 1));
        // Of two factors that become equal, one remains, and none falls back into full overlap.
        let limit = TauGrid::FULL_OVERLAP;
        let custom = TauGrid::custom([limit, limit + 1, limit + 16, limit + 31]).unwrap();
        assert_eq!(custom.factors(), [limit, limit + 16]);
        assert_eq!((custom.halo_len(), TauGrid::custom([limit + 16]).unwrap().halo_len()), (2 * limit, 0));
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
