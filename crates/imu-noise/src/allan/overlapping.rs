//! The overlapping Allan estimator: turns samples in any portions into exact sums.

use super::block::{BIAS, BLOCK};
use super::integers::Width;
use super::kernel;
use super::strided::Strided;
use super::{AllanError, AllanSums, FixedPoint, TauGrid};

/// Number of blocks after which a factor tries the next smaller width again.
const RETRY_BLOCKS: u32 = 16;

/// Folds the samples of one channel into [`AllanSums`].
///
/// Every second difference belongs to the portion with its last phase, and second differences do not depend on where
/// phases begin. A segment may therefore be cut anywhere: given the output of [`Overlapping::save`] and the
/// [`TauGrid::halo_len`] samples before the cut, [`Overlapping::restore`] continues to the same sums, bit for bit. Sums
/// over other data can be added ([`AllanSums::merge`]).
///
/// Memory: 2.5 phases of 8 bytes for each sample of the longest averaging time with full overlap, at most
/// [`Overlapping::bytes`]; 0.5 kB for each factor beyond. Speed: see docs/performance.md.
#[derive(Debug, Clone)]
pub struct Overlapping {
    sums: AllanSums,
    steps_per_unit: f64,
    /// Phases of the current segment, the newest last; the oldest may have been dropped. Phase 0 of a segment is 0.
    phases: Vec<i64>,
    /// Phases before this index have been used as the newest of a term.
    folded: usize,
    /// The factors beyond full overlap.
    strided: Strided,
    widths: Vec<Width>,
    blocks: u32,
    /// The newest phases of a block in the form for the kernel; kept to reuse its memory.
    newest: Vec<i64>,
}

impl Overlapping {
    /// Creates an estimator without samples.
    pub fn new(scale: FixedPoint, grid: TauGrid) -> Self {
        let strided = Strided::new(&grid);
        Self::resume(AllanSums::new(scale, grid), strided, &[])
    }

    fn resume(sums: AllanSums, strided: Strided, halo: &[f64]) -> Self {
        let taus = sums.grid().full_overlap().len();
        let mut estimator = Self {
            steps_per_unit: sums.scale().steps_per_unit(),
            sums,
            phases: vec![0],
            folded: 1,
            strided,
            widths: vec![Width::default(); taus],
            blocks: 0,
            newest: Vec::new(),
        };
        // A refused sample ended a segment, and was counted, when it was first pushed.
        let ended = halo.iter().rposition(|value| FixedPoint::steps(value * estimator.steps_per_unit).is_none());
        estimator.integrate(&halo[ended.map_or(0, |at| at + 1)..]);
        estimator.folded = estimator.phases.len();
        estimator
    }

    /// Returns the checkpoint: the sums over all samples pushed so far, and the position of the next sample in its
    /// segment.
    pub fn save(&mut self) -> Vec<u8> {
        let sums = self.sums().to_bytes();
        let mut bytes = (sums.len() as u64).to_le_bytes().to_vec();
        bytes.extend(sums);
        bytes.extend(self.strided.to_bytes());
        bytes
    }

    /// Continues from a checkpoint.
    ///
    /// `halo` has the samples of the segment before the next one to be pushed, oldest first: the last
    /// [`TauGrid::halo_len`] samples, or all if the segment has fewer; none at the start of a segment. More samples are
    /// harmless.
    ///
    /// # Errors
    /// The errors of [`AllanSums::from_bytes`].
    pub fn restore(bytes: &[u8], halo: &[f64]) -> Result<Self, AllanError> {
        let damaged =
            |field, expected: u64| Err(AllanError::CheckpointDamaged { field, expected, found: bytes.len() as u64 });
        let Some((length, rest)) = bytes.split_first_chunk::<8>() else { return damaged("length", 8) };
        let length = u64::from_le_bytes(*length);
        let parts = usize::try_from(length).ok().and_then(|length| rest.split_at_checked(length));
        let Some((sums, strided)) = parts else { return damaged("length of sums", length) };
        let sums = AllanSums::from_bytes(sums)?;
        match Strided::from_bytes(sums.grid(), strided) {
            Some(strided) => Ok(Self::resume(sums, strided, halo)),
            None => damaged("factors beyond full overlap", length),
        }
    }

    /// Returns the memory of a channel on that grid, in bytes, if its longest segment has that many samples.
    pub fn bytes(grid: &TauGrid, longest: u64) -> usize {
        8 * usize::try_from(longest).unwrap_or(usize::MAX).min(Self::most_phases(grid))
    }

    /// Takes the next samples of the segment, in the channel's unit.
    ///
    /// A sample that is not finite or beyond the channel's range is counted and ends the segment, so that no average
    /// spans it.
    pub fn push(&mut self, samples: &[f64]) {
        for portion in samples.chunks(BLOCK) {
            let mut rest = portion;
            loop {
                let taken = self.append(rest);
                if taken == rest.len() {
                    break;
                }
                self.sums.out_of_range += 1;
                self.break_segment();
                rest = &rest[taken + 1..];
            }
            while self.phases.len() - self.folded >= BLOCK {
                self.fold_block();
            }
            self.drop_oldest();
        }
    }

    /// Takes samples up to the first one out of range, and returns their number.
    fn append(&mut self, samples: &[f64]) -> usize {
        let known = self.phases.len();
        let before = self.phases[known - 1];
        let taken = self.integrate(samples);
        self.strided.take(before, &self.phases[known..], &mut self.sums);
        self.sums.samples += taken as u64;
        taken
    }

    /// Adds the phases of samples up to the first one out of range, and returns their number.
    fn integrate(&mut self, samples: &[f64]) -> usize {
        let scale = self.steps_per_unit;
        let fits = |value: &f64| FixedPoint::steps(value * scale).is_some();
        let taken = samples.iter().position(|value| !fits(value)).unwrap_or(samples.len());
        let needed = self.phases.len() + taken;
        if needed > self.phases.capacity() {
            // Grows by doubling as usual, but not beyond the maximum number of phases.
            let room = (2 * self.phases.capacity()).min(Self::most_phases(self.sums.grid())).max(needed);
            self.phases.reserve_exact(room - self.phases.len());
        }
        let mut phase = self.phases.last().copied().unwrap_or(0);
        self.phases.extend(samples[..taken].iter().map(|value| {
            phase = phase.wrapping_add(FixedPoint::steps(value * scale).unwrap_or(0));
            phase
        }));
        taken
    }

    /// Ends the segment: later samples do not continue the earlier ones.
    pub fn break_segment(&mut self) {
        self.fold();
        self.strided.break_segment();
        self.phases.clear();
        self.phases.push(0);
        self.folded = 1;
    }

    /// Returns the sums over all samples pushed so far.
    pub fn sums(&mut self) -> &AllanSums {
        self.fold();
        &self.sums
    }

    /// Returns the sums over all samples pushed.
    pub fn into_sums(mut self) -> AllanSums {
        self.fold();
        self.sums
    }

    /// Returns the grid of averaging factors.
    pub fn grid(&self) -> &TauGrid {
        self.sums.grid()
    }

    fn fold(&mut self) {
        while self.folded < self.phases.len() {
            self.fold_block();
        }
    }

    /// Processes all averaging factors of full overlap over one block of phases, so that the block stays in the cache.
    fn fold_block(&mut self) {
        let from = self.folded;
        let to = self.phases.len().min(from + BLOCK);
        let retry = self.blocks.is_multiple_of(RETRY_BLOCKS);
        let (phases, sums) = (&self.phases, &mut self.sums);
        self.newest.clear();
        self.newest.extend(phases[from..to].iter().map(|phase| phase.wrapping_add(BIAS)));
        for (index, width) in self.widths.iter_mut().enumerate() {
            let m = sums.grid().factors()[index];
            let first = from.max(2 * m);
            if first >= to {
                break;
            }
            if retry {
                *width = width.narrower();
            }
            let (middle, oldest) = (&phases[first - m..to - m], &phases[first - 2 * m..to - 2 * m]);
            let sum = kernel::sum_of_squares(&self.newest[first - from..], middle, oldest, width);
            sums.squares[index] = sums.squares[index].saturating_add(sum);
            sums.terms[index] += (to - first) as u64;
            sums.segments[index] += u64::from(first == 2 * m);
        }
        self.blocks = self.blocks.wrapping_add(1);
        self.folded = to;
    }

    /// Keeps one phase more than terms use, so that index 2m is the newest of a term only once in a segment.
    fn drop_oldest(&mut self) {
        let keep = self.grid().halo_len() + 1;
        if self.folded > keep + Self::slack(keep) {
            let surplus = self.folded - keep;
            self.phases.drain(..surplus);
            self.folded -= surplus;
        }
    }

    /// Returns the number of surplus phases that accumulate before all are moved at once.
    fn slack(keep: usize) -> usize {
        (keep / 4).max(4 * BLOCK)
    }

    /// Returns the maximum number of phases: those needed, the slack, a waiting block and an incoming portion.
    fn most_phases(grid: &TauGrid) -> usize {
        let keep = grid.halo_len() + 1;
        keep + Self::slack(keep) + 2 * BLOCK
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn scale() -> FixedPoint {
        FixedPoint::for_range(6, 7).unwrap()
    }

    fn whole(samples: &[f64], grid: &TauGrid) -> AllanSums {
        let mut estimator = Overlapping::new(scale(), grid.clone());
        estimator.push(samples);
        estimator.into_sums()
    }

    fn by_definition(samples: &[f64], m: usize) -> (u128, u64) {
        by_definition_at(samples, m, 1)
    }

    /// Returns the definition, in integers, one term after the other.
    fn by_definition_at(samples: &[f64], m: usize, stride: usize) -> (u128, u64) {
        let mut phases = vec![0i128];
        for value in samples {
            phases.push(phases.last().unwrap() + i128::from(scale().quantise(*value).unwrap()));
        }
        let starts = (0..phases.len().saturating_sub(2 * m)).step_by(stride);
        starts.fold((0, 0), |(sum, terms), i| {
            (sum + (phases[i + 2 * m] - 2 * phases[i + m] + phases[i]).pow(2) as u128, terms + 1)
        })
    }

    fn noise(count: usize, size: f64) -> Vec<f64> {
        let mut state = 88_172_645_463_325_252u64;
        let mut level = 9.80665;
        (0..count)
            .map(|_| {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                let white = (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
                level += white * size * 0.01;
                level + white * size
            })
            .collect()
    }

    #[test]
    fn sums_are_those_of_the_definition() {
        let grid = TauGrid::custom([1, 2, 3, 7, 64, 500, 999, 1000, 1001]).unwrap();
        let samples = noise(2000, 0.01);
        let sums = whole(&samples, &grid);
        for (index, m) in grid.factors().iter().enumerate() {
            assert_eq!((sums.squares[index], sums.terms[index]), by_definition(&samples, *m), "m = {m}");
        }
        assert_eq!(sums.segments(), [1, 1, 1, 1, 1, 1, 1, 1, 0]);
        assert_eq!(sums.samples(), 2000);
    }

    #[test]
    fn a_long_series_that_drops_its_oldest_phases_is_cut_without_a_trace() {
        let grid = TauGrid::custom([1, 10, 300, 4000]).unwrap();
        let samples = noise(200_000, 30.0);
        let expected = whole(&samples, &grid);
        let mut estimator = Overlapping::new(scale(), grid.clone());
        for portion in samples.chunks(12_345) {
            estimator.push(portion);
        }
        assert!(estimator.phases.len() < 60_000, "{} phases kept", estimator.phases.len());
        assert_eq!(estimator.into_sums(), expected);
        let (sum, terms) = by_definition(&samples, 4000);
        assert_eq!((expected.squares[3], expected.terms[3]), (sum, terms));
    }

    #[test]
    fn a_sample_out_of_range_ends_the_segment_and_is_counted() {
        let grid = TauGrid::custom([1, 5]).unwrap();
        let samples = noise(100, 1.0);
        let mut with_bad = samples[..40].to_vec();
        with_bad.push(f64::NAN);
        with_bad.extend_from_slice(&samples[40..]);
        let mut expected = Overlapping::new(scale(), grid.clone());
        expected.push(&samples[..40]);
        expected.break_segment();
        expected.push(&samples[40..]);
        let sums = whole(&with_bad, &grid);
        assert_eq!(sums.squares, expected.sums().squares);
        assert_eq!(sums.segments(), [2, 2]);
        assert_eq!((sums.samples(), sums.out_of_range()), (100, 1));
    }

    #[test]
    fn beyond_full_overlap_sums_are_those_of_the_definition_at_the_stride() {
        let grid = TauGrid::with_full_overlap([1, 64, 65, 96, 1000, 4000], 6).unwrap();
        assert_eq!((grid.full_overlap(), grid.beyond_full_overlap()), (&[1, 64][..], &[96, 992, 4000][..]));
        for (samples, what) in [
            (noise(30_000, 0.01), "at rest"),
            ((0..30_000).map(|i| if i / 3000 % 2 == 0 { 127.0 } else { -127.0 }).collect(), "in motion"),
        ] {
            let sums = whole(&samples, &grid);
            for (index, m) in grid.factors().iter().enumerate() {
                let expected = by_definition_at(&samples, *m, grid.stride(*m));
                assert_eq!((sums.squares[index], sums.terms[index]), expected, "m = {m} {what}");
                assert_eq!(sums.segments()[index], 1);
            }
            let last = sums.points().pop().unwrap();
            assert_eq!((last.m, last.stride, last.taken()), (4000, 250, 89));
            assert_eq!(last.terms, 88 * 250 + 1);
        }
        assert!(Overlapping::bytes(&grid, 30_000) < 8 * 60_000, "phases kept for factors beyond full overlap");
    }

    #[test]
    fn full_scale_motion_is_still_exact() {
        let grid = TauGrid::custom([1, 1000]).unwrap();
        let samples: Vec<f64> = (0..4000).map(|i| if i / 1000 % 2 == 0 { 134.0 } else { -134.0 }).collect();
        let sums = whole(&samples, &grid);
        assert_eq!((sums.squares[1], sums.terms[1]), by_definition(&samples, 1000));
    }

    #[test]
    fn constant_data_has_no_variance_at_all() {
        let grid = TauGrid::octave(1000).unwrap();
        let sums = whole(&[0.123_456_789; 1000], &grid);
        assert!((0..grid.factors().len()).all(|index| sums.variance(index) == Some(0.0)));
    }

    /// Folds a capture: samples with breaks before some of them.
    fn fold(samples: &[f64], breaks: &[usize], grid: &TauGrid, portions: &[usize]) -> AllanSums {
        let mut estimator = Overlapping::new(scale(), grid.clone());
        let mut at = 0;
        let mut portions = portions.iter().cycle();
        while at < samples.len() {
            if breaks.contains(&at) {
                estimator.break_segment();
            }
            let next_break = breaks.iter().copied().filter(|b| *b > at).min().unwrap_or(samples.len());
            let to = (at + portions.next().copied().unwrap_or(1)).min(next_break).min(samples.len());
            estimator.push(&samples[at..to]);
            at = to;
        }
        estimator.into_sums()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn any_portions_give_the_same_sums(
            count in 1usize..3000,
            size in prop::sample::select(vec![1e-5, 1e-3, 1.0, 60.0]),
            breaks in proptest::collection::vec(0usize..3000, 0..4),
            portions in proptest::collection::vec(1usize..700, 1..6),
        ) {
            let grid = TauGrid::with_full_overlap([1, 2, 5, 17, 100, 144, 336], 7).unwrap();
            let samples = noise(count, size);
            let expected = fold(&samples, &breaks, &grid, &[usize::MAX / 2]);
            prop_assert_eq!(fold(&samples, &breaks, &grid, &portions), expected);
        }

        #[test]
        fn killed_anywhere_and_resumed_with_a_halo_nothing_differs(
            count in 2usize..3000,
            cuts in proptest::collection::vec(0usize..3000, 1..6),
            bad in proptest::collection::vec(0usize..3000, 0..3),
            more in 0usize..50,
        ) {
            let grid = TauGrid::with_full_overlap([1, 2, 5, 17, 100, 144, 336], 7).unwrap();
            let mut samples = noise(count, 0.1);
            for at in bad {
                if at < count {
                    samples[at] = f64::INFINITY;
                }
            }
            let expected = whole(&samples, &grid);
            let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut % count).chain([0, count]).collect();
            cuts.sort_unstable();
            let mut checkpoint = Overlapping::new(scale(), grid.clone()).save();
            for pair in cuts.windows(2) {
                let halo = &samples[pair[0].saturating_sub(grid.halo_len() + more)..pair[0]];
                let mut resumed = Overlapping::restore(&checkpoint, halo).unwrap();
                resumed.push(&samples[pair[0]..pair[1]]);
                checkpoint = resumed.save();
            }
            prop_assert_eq!(Overlapping::restore(&checkpoint, &[]).unwrap().into_sums(), expected);
        }
    }

    #[test]
    fn a_damaged_checkpoint_is_refused() {
        let grid = TauGrid::with_full_overlap([1, 2, 144], 7).unwrap();
        let mut estimator = Overlapping::new(scale(), grid);
        estimator.push(&noise(1000, 0.1));
        let bytes = estimator.save();
        assert_eq!(Overlapping::restore(&bytes, &[]).unwrap().into_sums(), estimator.into_sums());
        for length in [0, 7, 8, 40, bytes.len() - 528, bytes.len() - 1] {
            assert!(Overlapping::restore(&bytes[..length], &[]).is_err(), "{length}");
        }
        let mut bad = bytes;
        bad[0] ^= 1;
        assert!(Overlapping::restore(&bad, &[]).is_err());
    }
}
