//! Sums of squared second differences: the only data that an overlapping Allan deviation needs.

use super::{AllanError, FixedPoint, TauGrid};

const MAGIC: [u8; 4] = *b"OAVS";
const VERSION: u8 = 2;

/// Per averaging factor, the exact sum of squared second differences, their number, and the number of segments that
/// gave any.
///
/// The result does not depend on how the data was cut, to the last bit. A checkpoint needs nothing else.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AllanSums {
    scale: FixedPoint,
    grid: TauGrid,
    pub(super) squares: Vec<u128>,
    pub(super) terms: Vec<u64>,
    pub(super) segments: Vec<u64>,
    pub(super) samples: u64,
    pub(super) out_of_range: u64,
}

impl AllanSums {
    /// Creates sums without data.
    pub fn new(scale: FixedPoint, grid: TauGrid) -> Self {
        let taus = grid.factors().len();
        Self {
            scale,
            grid,
            squares: vec![0; taus],
            terms: vec![0; taus],
            segments: vec![0; taus],
            samples: 0,
            out_of_range: 0,
        }
    }

    /// Returns the scale of the integers.
    pub fn scale(&self) -> FixedPoint {
        self.scale
    }

    /// Returns the averaging factors, which determine the shape of all fields per factor.
    pub fn grid(&self) -> &TauGrid {
        &self.grid
    }

    /// Returns the number of second differences in each sum: for a segment of `n` samples, `n + 1 − 2m`, or with a
    /// stride `s` every `s`th of these from the first one on.
    pub fn terms(&self) -> &[u64] {
        &self.terms
    }

    /// Returns the number of segments that gave at least one term to each sum.
    pub fn segments(&self) -> &[u64] {
        &self.segments
    }

    /// Returns the number of accepted samples.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Returns the number of samples that were not finite or beyond the channel's range; each ended a segment.
    pub fn out_of_range(&self) -> u64 {
        self.out_of_range
    }

    /// Returns the overlapping Allan variance at the grid's factor number `index`, in the channel's unit squared;
    /// `None` without a term, or if the sum exceeded 2^128 (full-scale motion for hours).
    ///
    /// # Source
    /// Riley & Howe, NIST SP1065 (2008), equation 10.
    pub fn variance(&self, index: usize) -> Option<f64> {
        let (sum, terms) = (*self.squares.get(index)?, *self.terms.get(index)?);
        let m = *self.grid.factors().get(index)? as f64;
        if terms == 0 || sum == u128::MAX {
            return None;
        }
        // Powers of ten and two separately: the square of their product is not always exact.
        let steps = self.scale.steps_per_unit();
        Some(sum as f64 / (2.0 * terms as f64 * m * m) / steps / steps)
    }

    /// Returns the checkpoint: little-endian, versioned, 36 bytes per averaging factor.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(32 + 36 * self.squares.len());
        bytes.extend_from_slice(&MAGIC);
        bytes.extend_from_slice(&[VERSION, self.scale.decimals, self.scale.binary, self.grid.full_overlap_bits()]);
        bytes.extend_from_slice(&(self.squares.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&self.samples.to_le_bytes());
        bytes.extend_from_slice(&self.out_of_range.to_le_bytes());
        for (index, m) in self.grid.factors().iter().enumerate() {
            bytes.extend_from_slice(&(*m as u32).to_le_bytes());
            bytes.extend_from_slice(&self.squares[index].to_le_bytes());
            bytes.extend_from_slice(&self.terms[index].to_le_bytes());
            bytes.extend_from_slice(&self.segments[index].to_le_bytes());
        }
        bytes
    }

    /// Reads the output of [`AllanSums::to_bytes`].
    ///
    /// # Errors
    /// [`AllanError::CheckpointVersion`] for another version, [`AllanError::CheckpointDamaged`] for any other fault.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, AllanError> {
        let damaged = |field, expected: usize, found: usize| AllanError::CheckpointDamaged {
            field,
            expected: expected as u64,
            found: found as u64,
        };
        let Some((header, body)) = bytes.split_first_chunk::<32>() else {
            return Err(damaged("length of header", 32, bytes.len()));
        };
        if header[..4] != MAGIC {
            return Err(damaged("magic number", MAGIC[0].into(), header[0].into()));
        }
        if header[4] != VERSION {
            return Err(AllanError::CheckpointVersion { expected: VERSION, found: header[4] });
        }
        let scale = FixedPoint { decimals: header[5], binary: header[6] };
        if scale.decimals > 12 || scale.binary > 60 {
            return Err(damaged("scale", 12, scale.decimals.into()));
        }
        let word = |at: usize| u64::from_le_bytes(std::array::from_fn(|byte| header[at + byte]));
        let taus = usize::try_from(word(8)).unwrap_or(usize::MAX);
        if taus.checked_mul(36) != Some(body.len()) {
            return Err(damaged("length of sums", taus.saturating_mul(36), body.len()));
        }
        let (rows, _) = body.as_chunks::<36>();
        let row = |row: &[u8; 36], at: usize| u64::from_le_bytes(std::array::from_fn(|byte| row[at + byte]));
        let factors: Vec<usize> =
            rows.iter().map(|row| u32::from_le_bytes([row[0], row[1], row[2], row[3]]) as usize).collect();
        let grid = TauGrid::with_full_overlap(factors.iter().copied(), header[7])?;
        if grid.factors() != factors {
            return Err(damaged("order of averaging factors", taus, grid.factors().len()));
        }
        let mut sums = Self::new(scale, grid);
        (sums.samples, sums.out_of_range) = (word(16), word(24));
        for (index, bytes) in rows.iter().enumerate() {
            sums.squares[index] = u128::from(row(bytes, 4)) | u128::from(row(bytes, 12)) << 64;
            sums.terms[index] = row(bytes, 20);
            sums.segments[index] = row(bytes, 28);
        }
        Ok(sums)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_core::sample::Channel;

    fn some() -> AllanSums {
        let mut sums = AllanSums::new(FixedPoint::for_channel(Channel::GyroX), TauGrid::octave(64).unwrap());
        for index in 0..sums.squares.len() {
            sums.squares[index] = u128::MAX / (index as u128 + 2);
            sums.terms[index] = 1000 + index as u64;
            sums.segments[index] = 3;
        }
        (sums.samples, sums.out_of_range) = (4711, 2);
        sums
    }

    #[test]
    fn a_checkpoint_is_read_back_as_it_was_written() {
        assert_eq!(AllanSums::from_bytes(&some().to_bytes()).unwrap(), some());
        let long = AllanSums::new(some().scale(), TauGrid::octave(1 << 30).unwrap());
        assert_eq!(AllanSums::from_bytes(&long.to_bytes()).unwrap(), long);
    }

    #[test]
    fn a_damaged_checkpoint_is_refused() {
        let bytes = some().to_bytes();
        for length in [0, 5, 31, bytes.len() - 1] {
            assert!(AllanSums::from_bytes(&bytes[..length]).is_err(), "{length}");
        }
        for (at, value) in [(0, b'X'), (4, 9), (5, 200), (7, 0), (7, 21), (8, 77), (32, 0)] {
            let mut bad = bytes.clone();
            bad[at] = value;
            assert!(AllanSums::from_bytes(&bad).is_err(), "byte {at}");
        }
    }

    #[test]
    fn a_sum_beyond_its_bits_is_absent_not_wrong() {
        let mut sums = some();
        sums.squares[0] = u128::MAX;
        assert_eq!(sums.variance(0), None);
        assert!(sums.variance(4).is_some());
    }
}
