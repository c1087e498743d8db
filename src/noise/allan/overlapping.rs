//! The overlapping Allan estimator: samples in any portions, exact sums out.

use super::kernel::{self, Width};
use super::{AllanSums, FixedPoint, TauGrid};

/// Blocks after which a factor tries the next smaller width again.
const RETRY_BLOCKS: u32 = 16;
/// Binary places by which phases of nothing but zeros may be shifted.
const MOST_SHIFT: u32 = 62;

/// Folds the samples of one channel into [`AllanSums`].
///
/// Every second difference belongs to the portion that holds its last phase, and second differences do not see where phases
/// begin. So a segment may be cut anywhere: a fresh estimator that is given the [`TauGrid::halo_len`] samples before the
/// cut ([`Overlapping::resume`]) continues to the same sums, bit for bit, and sums of parts that were computed side by side
/// add up to those of the whole.
///
/// Memory: 2.5 · m_max phases of 8 bytes. Speed: see docs/performance.md.
#[derive(Debug, Clone)]
pub struct Overlapping {
    sums: AllanSums,
    steps_per_unit: f64,
    /// Phases of the current segment over 2^`shift`, newest last, the oldest possibly dropped; phase 0 of a segment is 0.
    phases: Vec<i64>,
    /// Zeros that all steps of the segment end in: decimals of ASCII output need fewer bits, and squares less time.
    shift: u32,
    /// Phases before this index have had their turn as the newest of a term.
    folded: usize,
    widths: Vec<Width>,
    blocks: u32,
    /// Kept for its memory.
    steps: Vec<i64>,
}

impl Overlapping {
    /// An estimator that has seen nothing.
    #[must_use]
    pub fn new(scale: FixedPoint, grid: TauGrid) -> Self {
        Self::resume(AllanSums::new(scale, grid), &[])
    }

    /// Continues from a checkpoint within a segment.
    ///
    /// `halo`: the samples of the segment that precede the next one to be pushed, oldest first: the last
    /// [`TauGrid::halo_len`] of them, or all where the segment has fewer; none at the start of a segment. More does no harm.
    #[must_use]
    pub fn resume(sums: AllanSums, halo: &[f64]) -> Self {
        let taus = sums.grid().factors().len();
        let mut estimator = Self {
            steps_per_unit: sums.scale().steps_per_unit(),
            sums,
            phases: vec![0],
            shift: MOST_SHIFT,
            folded: 1,
            widths: vec![Width::default(); taus],
            blocks: 0,
            steps: Vec::new(),
        };
        // A sample that was refused ended a segment, and was counted, when it came first.
        let ended = halo.iter().rposition(|value| FixedPoint::steps(value * estimator.steps_per_unit).is_none());
        estimator.append(&halo[ended.map_or(0, |at| at + 1)..]);
        estimator.folded = estimator.phases.len();
        estimator
    }

    /// Takes the next samples of the segment, in the channel's unit.
    ///
    /// A sample that is not finite or beyond the channel's range is counted and ends the segment: nothing is averaged
    /// across it.
    pub fn push(&mut self, samples: &[f64]) {
        for portion in samples.chunks(kernel::BLOCK) {
            let mut rest = portion;
            loop {
                let taken = self.append(rest);
                self.sums.samples += taken as u64;
                if taken == rest.len() {
                    break;
                }
                self.sums.out_of_range += 1;
                self.break_segment();
                rest = &rest[taken + 1..];
            }
            while self.phases.len() - self.folded >= kernel::BLOCK {
                self.fold_block();
            }
            self.drop_oldest();
        }
    }

    /// Integrates samples up to the first that is out of range; answers how many they were.
    fn append(&mut self, samples: &[f64]) -> usize {
        self.steps.clear();
        self.steps.extend(samples.iter().map_while(|value| FixedPoint::steps(value * self.steps_per_unit)));
        let common = self.steps.iter().fold(0, |common, steps| common | steps).trailing_zeros();
        if common < self.shift {
            for phase in &mut self.phases {
                *phase = phase.wrapping_shl(self.shift - common);
            }
            self.shift = common;
        }
        let mut phase = self.phases.last().copied().unwrap_or(0);
        let shift = self.shift;
        self.phases.extend(self.steps.iter().map(|steps| {
            phase = phase.wrapping_add(steps >> shift);
            phase
        }));
        self.steps.len()
    }

    /// Ends the segment: what comes next does not continue what came before.
    pub fn break_segment(&mut self) {
        self.fold();
        self.phases.clear();
        self.phases.push(0);
        self.shift = MOST_SHIFT;
        self.folded = 1;
    }

    /// The sums over everything pushed so far.
    pub fn sums(&mut self) -> &AllanSums {
        self.fold();
        &self.sums
    }

    /// The sums over everything pushed.
    #[must_use]
    pub fn into_sums(mut self) -> AllanSums {
        self.fold();
        self.sums
    }

    /// The grid of averaging factors.
    #[must_use]
    pub fn grid(&self) -> &TauGrid {
        self.sums.grid()
    }

    fn fold(&mut self) {
        while self.folded < self.phases.len() {
            self.fold_block();
        }
    }

    /// All averaging factors over one block of phases, so that the block stays in the cache.
    fn fold_block(&mut self) {
        let from = self.folded;
        let to = self.phases.len().min(from + kernel::BLOCK);
        let retry = self.blocks.is_multiple_of(RETRY_BLOCKS);
        let (phases, sums) = (&self.phases, &mut self.sums);
        for index in 0..self.widths.len() {
            let m = sums.grid().factors()[index];
            let first = from.max(2 * m);
            if first >= to {
                break;
            }
            let width = &mut self.widths[index];
            let start = if retry { width.narrower() } else { *width };
            let (sum, used) = kernel::sum_of_squares(
                &phases[first..to],
                &phases[first - m..to - m],
                &phases[first - 2 * m..to - 2 * m],
                start,
            );
            *width = used;
            let sum = if sum.leading_zeros() >= 2 * self.shift { sum << (2 * self.shift) } else { u128::MAX };
            sums.squares[index] = sums.squares[index].saturating_add(sum);
            sums.terms[index] += (to - first) as u64;
            sums.segments[index] += u64::from(first == 2 * m);
        }
        self.blocks = self.blocks.wrapping_add(1);
        self.folded = to;
    }

    /// Keeps one phase more than terms reach back to: index 2m is then the newest of a term only once in a segment.
    fn drop_oldest(&mut self) {
        let keep = self.grid().halo_len() + 1;
        let slack = (keep / 4).max(4 * kernel::BLOCK);
        if self.folded > keep + slack {
            let surplus = self.folded - keep;
            self.phases.drain(..surplus);
            self.folded -= surplus;
        }
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

    /// The definition, in integers, one term after the other.
    fn by_definition(samples: &[f64], m: usize) -> (u128, u64) {
        let mut phases = vec![0i128];
        for value in samples {
            phases.push(phases.last().unwrap() + i128::from(scale().quantise(*value).unwrap()));
        }
        let terms = phases.len().saturating_sub(2 * m);
        let sum = (0..terms).map(|i| (phases[i + 2 * m] - 2 * phases[i + m] + phases[i]).pow(2) as u128).sum();
        (sum, terms as u64)
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
    fn full_scale_motion_is_still_exact() {
        let grid = TauGrid::custom([1, 1000]).unwrap();
        let samples: Vec<f64> = (0..4000).map(|i| if i / 1000 % 2 == 0 { 134.0 } else { -134.0 }).collect();
        let sums = whole(&samples, &grid);
        assert_eq!((sums.squares[1], sums.terms[1]), by_definition(&samples, 1000));
    }

    #[test]
    fn decimals_before_finer_values_leave_no_trace() {
        let grid = TauGrid::custom([1, 10, 700]).unwrap();
        let mut samples: Vec<f64> = noise(20_000, 0.01).iter().map(|value| (value * 1e6).round() / 1e6).collect();
        samples.extend(noise(20_000, 0.01));
        let sums = whole(&samples, &grid);
        for (index, m) in grid.factors().iter().enumerate() {
            assert_eq!((sums.squares[index], sums.terms[index]), by_definition(&samples, *m), "m = {m}");
        }
        let mut decimals = Overlapping::new(scale(), grid);
        decimals.push(&samples[..20_000]);
        assert_eq!(decimals.shift, 15);
    }

    #[test]
    fn constant_data_has_no_variance_at_all() {
        let grid = TauGrid::octave(1000).unwrap();
        let sums = whole(&[0.123_456_789; 1000], &grid);
        assert!((0..grid.factors().len()).all(|index| sums.variance(index) == Some(0.0)));
    }

    /// A capture: samples with breaks before some of them.
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
            let grid = TauGrid::custom([1, 2, 5, 17, 100, 333]).unwrap();
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
            let grid = TauGrid::custom([1, 2, 5, 17, 100, 333]).unwrap();
            let mut samples = noise(count, 0.1);
            for at in bad {
                if at < count {
                    samples[at] = f64::INFINITY;
                }
            }
            let expected = whole(&samples, &grid);
            let mut cuts: Vec<usize> = cuts.into_iter().map(|cut| cut % count).chain([0, count]).collect();
            cuts.sort_unstable();
            let mut checkpoint = AllanSums::new(scale(), grid.clone()).to_bytes();
            let mut side_by_side = AllanSums::new(scale(), grid.clone());
            for pair in cuts.windows(2) {
                let halo = &samples[pair[0].saturating_sub(grid.halo_len() + more)..pair[0]];
                let mut resumed = Overlapping::resume(AllanSums::from_bytes(&checkpoint).unwrap(), halo);
                resumed.push(&samples[pair[0]..pair[1]]);
                checkpoint = resumed.sums().to_bytes();
                let mut part = Overlapping::resume(AllanSums::new(scale(), grid.clone()), halo);
                part.push(&samples[pair[0]..pair[1]]);
                side_by_side.merge(part.sums()).unwrap();
            }
            prop_assert_eq!(AllanSums::from_bytes(&checkpoint).unwrap(), expected.clone());
            prop_assert_eq!(side_by_side, expected);
        }
    }
}
