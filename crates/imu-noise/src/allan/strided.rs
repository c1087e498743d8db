//! Averaging factors beyond full overlap: second differences at every m/16th phase, in constant memory.
//!
//! For white rate noise the variance of the estimate grows by 0.5 % against full overlap, and a factor needs 33 phases
//! for any length.

use super::grid::OVERLAP;
use super::{AllanSums, TauGrid};

/// Phases that a factor's terms span, both ends included.
const KEPT: usize = 2 * OVERLAP + 1;

/// Returns a square, limited to 2^128.
fn square(difference: i128) -> u128 {
    let magnitude = difference.unsigned_abs();
    magnitude.saturating_mul(magnitude)
}

/// The open segment for the factors beyond full overlap.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Strided {
    /// Index of the newest phase and the phase itself; 128 bits, because these averaging times outgrow 64.
    index: u64,
    phase: i128,
    rings: Vec<Ring>,
}

/// The latest phases at multiples of a factor's stride.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Ring {
    stride: u64,
    phases: [i128; KEPT],
}

impl Ring {
    /// Stores the phase at `number` strides and returns the difference of which it is the newest phase.
    fn keep(&mut self, number: u64, phase: i128) -> Option<i128> {
        let span = KEPT as u64;
        let slot = (number % span) as usize;
        self.phases[slot] = phase;
        let back = |strides: usize| self.phases[(slot + KEPT - strides) % KEPT];
        (number >= span - 1).then(|| phase - 2 * back(OVERLAP) + back(2 * OVERLAP))
    }
}

impl Strided {
    /// Returns the start of a segment.
    pub(super) fn new(grid: &TauGrid) -> Self {
        let ring = |m: &usize| Ring { stride: grid.stride(*m) as u64, phases: [0; KEPT] };
        Self { index: 0, phase: 0, rings: grid.beyond_full_overlap().iter().map(ring).collect() }
    }

    /// Takes the next phases of the segment; `before` and `phases` may have wrapped and may begin anywhere.
    pub(super) fn take(&mut self, before: i64, phases: &[i64], sums: &mut AllanSums) {
        let Some(last) = phases.last() else { return };
        let at = |phase: i64| self.phase + i128::from(phase.wrapping_sub(before));
        let first_sum = sums.grid().full_overlap().len();
        for (ring, sum) in self.rings.iter_mut().zip(first_sum..) {
            let mut number = self.index / ring.stride + 1;
            while let Some(phase) = phases.get((number * ring.stride - self.index - 1) as usize) {
                if let Some(difference) = ring.keep(number, at(*phase)) {
                    sums.squares[sum] = sums.squares[sum].saturating_add(square(difference));
                    sums.terms[sum] += 1;
                    sums.segments[sum] += u64::from(number == KEPT as u64 - 1);
                }
                number += 1;
            }
        }
        self.phase = at(*last);
        self.index += phases.len() as u64;
    }

    /// Ends the segment.
    pub(super) fn break_segment(&mut self) {
        (self.index, self.phase) = (0, 0);
        for ring in &mut self.rings {
            ring.phases[0] = 0;
        }
    }

    /// Returns the state for a checkpoint: little-endian, 24 bytes and 528 per factor.
    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = self.index.to_le_bytes().to_vec();
        bytes.extend_from_slice(&self.phase.to_le_bytes());
        for phase in self.rings.iter().flat_map(|ring| ring.phases) {
            bytes.extend_from_slice(&phase.to_le_bytes());
        }
        bytes
    }

    /// Reads the output of [`Self::to_bytes`] for the same grid; `None` if its length differs.
    pub(super) fn from_bytes(grid: &TauGrid, bytes: &[u8]) -> Option<Self> {
        let mut strided = Self::new(grid);
        let (index, rest) = bytes.split_first_chunk::<8>()?;
        let (phases, remainder) = rest.as_chunks::<16>();
        if !remainder.is_empty() || phases.len() != 1 + KEPT * strided.rings.len() {
            return None;
        }
        strided.index = u64::from_le_bytes(*index);
        let mut phases = phases.iter().map(|bytes| i128::from_le_bytes(*bytes));
        strided.phase = phases.next()?;
        for slot in strided.rings.iter_mut().flat_map(|ring| &mut ring.phases) {
            *slot = phases.next()?;
        }
        Some(strided)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allan::FixedPoint;

    #[test]
    fn a_checkpoint_of_another_length_is_refused() {
        let grid = TauGrid::with_full_overlap([1, 100, 2048, 4096], 10).unwrap();
        let mut sums = AllanSums::new(FixedPoint::for_range(6, 7).unwrap(), grid.clone());
        let mut strided = Strided::new(&grid);
        let phases: Vec<i64> = (0..9000).map(|i| i * i % 1_000_003).collect();
        strided.take(0, &phases, &mut sums);
        let bytes = strided.to_bytes();
        assert_eq!(bytes.len(), 24 + 2 * 528);
        assert_eq!(Strided::from_bytes(&grid, &bytes).unwrap(), strided);
        assert_eq!(Strided::from_bytes(&grid, &bytes[1..]), None);
        assert_eq!(Strided::from_bytes(&grid, &bytes[..bytes.len() - 16]), None);
        assert_eq!(Strided::from_bytes(&TauGrid::octave(64).unwrap(), &bytes), None);
        assert_eq!(Strided::from_bytes(&grid, &[]), None);
    }

    #[test]
    fn motion_at_full_scale_beyond_128_bits_saturates() {
        let grid = TauGrid::with_full_overlap([TauGrid::MAX_FACTOR], 10).unwrap();
        let mut ring = Strided::new(&grid).rings.remove(0);
        let largest = FixedPoint::largest_steps() as i128;
        let mut last = None;
        for number in 0..KEPT as u64 {
            // Away for an averaging time and back for another.
            let strides = i128::from(number.min(KEPT as u64 - 1 - number));
            last = ring.keep(number, largest * strides * i128::from(ring.stride));
            assert_eq!(last.is_some(), number == 32);
        }
        let difference = last.unwrap();
        assert_eq!(difference, -2 * largest * TauGrid::MAX_FACTOR as i128);
        assert_eq!(square(difference), u128::MAX);
        assert_eq!(square(-3), 9);
    }
}
