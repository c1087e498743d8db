//! The live estimator: all octaves of a running capture in constant memory.
//!
//! Averaging factors are powers of two up to [`TauGrid::FULL_OVERLAP`]. Beyond m = 16 terms are taken at every m/16th
//! sample: for white rate noise the variance of the estimate grows by 0.5 % against full overlap. The sums are integers
//! and do not depend on how the samples were divided into portions.

use super::grid::OVERLAP;
use super::point::AllanPoint;
use super::{FixedPoint, TauGrid};

/// Phases that a level keeps: a power of two above two averaging times.
const KEPT: usize = 64;
const LEVELS: usize = TauGrid::FULL_OVERLAP.ilog2() as usize + 1;
/// Levels that use every phase: m = 1 to 16.
const DENSE: usize = OVERLAP.ilog2() as usize + 1;

#[derive(Debug, Clone, Copy, Default)]
struct Level {
    squares: u128,
    terms: u64,
    segments: u64,
}

impl Level {
    fn add(&mut self, newest: i64, middle: i64, oldest: i64, first: bool) {
        let difference = newest.wrapping_sub(middle).wrapping_sub(middle.wrapping_sub(oldest));
        let magnitude = u128::from(difference.unsigned_abs());
        self.squares = self.squares.saturating_add(magnitude * magnitude);
        self.terms += 1;
        self.segments += u64::from(first);
    }
}

/// Folds the samples of one channel into octave Allan variances. It takes about 12 kB, for any length.
#[derive(Debug, Clone)]
pub struct LiveAllan {
    steps_per_unit: f64,
    levels: [Level; LEVELS],
    /// The latest phases at every 1, 2, 4… samples; `[0]` belongs to the dense levels.
    rings: Vec<[i64; KEPT]>,
    /// Index of the segment's newest phase and the phase itself.
    index: u64,
    phase: i64,
    samples: u64,
    out_of_range: u64,
}

impl LiveAllan {
    /// Creates an estimator without samples.
    pub fn new(scale: FixedPoint) -> Self {
        Self {
            steps_per_unit: scale.steps_per_unit(),
            levels: [Level::default(); LEVELS],
            rings: vec![[0; KEPT]; LEVELS - DENSE + 1],
            index: 0,
            phase: 0,
            samples: 0,
            out_of_range: 0,
        }
    }

    /// Takes the next samples of the segment, in the channel's unit; a sample that is not finite or out of range ends
    /// it.
    pub fn push(&mut self, samples: &[f64]) {
        for value in samples {
            match FixedPoint::steps(value * self.steps_per_unit) {
                Some(steps) => self.step(steps),
                None => {
                    self.out_of_range += 1;
                    self.break_segment();
                }
            }
        }
    }

    /// Ends the segment.
    pub fn break_segment(&mut self) {
        (self.index, self.phase) = (0, 0);
        for ring in &mut self.rings {
            ring[0] = 0;
        }
    }

    fn step(&mut self, steps: i64) {
        self.samples += 1;
        self.phase = self.phase.wrapping_add(steps);
        self.index += 1;
        let newest = self.phase;
        let at = |ring: &[i64; KEPT], index: u64, back: usize| ring[(index as usize).wrapping_sub(back) % KEPT];
        let dense = &mut self.rings[0];
        dense[self.index as usize % KEPT] = newest;
        for (power, level) in self.levels[..DENSE].iter_mut().enumerate() {
            let m = 1 << power;
            if self.index < 2 * m as u64 {
                break;
            }
            level.add(newest, at(dense, self.index, m), at(dense, self.index, 2 * m), self.index == 2 * m as u64);
        }
        self.sparse(newest);
    }

    /// Updates the levels beyond 16: each takes every second phase of the level before it.
    fn sparse(&mut self, newest: i64) {
        let mut index = self.index;
        for (ring, level) in self.rings[1..].iter_mut().zip(&mut self.levels[DENSE..]) {
            if index % 2 == 1 {
                return;
            }
            index /= 2;
            ring[index as usize % KEPT] = newest;
            if index >= 2 * OVERLAP as u64 {
                let at = |back: usize| ring[(index as usize).wrapping_sub(back) % KEPT];
                level.add(newest, at(OVERLAP), at(2 * OVERLAP), index == 2 * OVERLAP as u64);
            }
        }
    }

    /// Returns the number of accepted samples.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Returns the number of samples that were not finite or out of range.
    pub fn out_of_range(&self) -> u64 {
        self.out_of_range
    }

    /// Returns the points so far, for a curve ([`AllanCurve::from_points`](super::AllanCurve::from_points)) or a fit:
    /// octaves up to a quarter of the samples of their segments.
    pub fn points(&self) -> Vec<AllanPoint> {
        let steps = self.steps_per_unit;
        let mut points = Vec::new();
        for (power, level) in self.levels.iter().enumerate() {
            let m = 1usize << power;
            let stride = (m / OVERLAP).max(1);
            let terms = level.terms * stride as u64;
            // A segment of 4m samples has 2m terms: shorter segments carry little information.
            if level.terms == 0 || level.squares == u128::MAX || terms < level.segments * 2 * m as u64 {
                continue;
            }
            let mean = level.squares as f64 / (2.0 * level.terms as f64 * (m as f64).powi(2));
            let terms = AllanPoint::spanned(level.terms, level.segments, stride);
            points.push(AllanPoint { m, variance: mean / steps / steps, terms, segments: level.segments, stride });
        }
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn scale() -> FixedPoint {
        FixedPoint::for_range(6, 7).unwrap()
    }

    fn noise(count: usize) -> Vec<f64> {
        let mut state = 9u64;
        (0..count)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            })
            .collect()
    }

    /// Returns the definition at stride max(1, m/16) over one segment.
    fn by_definition(samples: &[f64], m: usize) -> (u128, u64) {
        let mut phases = vec![0i128];
        for value in samples {
            phases.push(phases.last().unwrap() + i128::from(scale().quantise(*value).unwrap()));
        }
        (2 * m..phases.len()).step_by((m / OVERLAP).max(1)).fold((0, 0), |(sum, terms), i| {
            (sum + (phases[i] - 2 * phases[i - m] + phases[i - 2 * m]).pow(2) as u128, terms + 1)
        })
    }

    #[test]
    fn every_octave_is_that_of_the_definition() {
        let samples = noise(20_000);
        let mut live = LiveAllan::new(scale());
        live.push(&samples);
        for power in 0..=12 {
            let level = live.levels[power];
            assert_eq!((level.squares, level.terms), by_definition(&samples, 1 << power), "m = {}", 1 << power);
        }
        let factors: Vec<usize> = live.points().iter().map(|point| point.m).collect();
        assert_eq!(factors, (0..=12).map(|power| 1 << power).collect::<Vec<_>>());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn portions_do_not_matter_and_breaks_separate(
            portions in proptest::collection::vec(1usize..900, 1..5),
            cut in 1usize..2999,
        ) {
            let mut samples = noise(3000);
            samples[cut] = f64::NAN;
            let mut live = LiveAllan::new(scale());
            let mut at = 0;
            for portion in portions.iter().cycle() {
                let to = (at + portion).min(samples.len());
                live.push(&samples[at..to]);
                at = to;
                if at == samples.len() { break; }
            }
            for power in 0..8 {
                let (left, right) =
                    (by_definition(&samples[..cut], 1 << power), by_definition(&samples[cut + 1..], 1 << power));
                let level = live.levels[power];
                prop_assert_eq!((level.squares, level.terms), (left.0 + right.0, left.1 + right.1));
                prop_assert_eq!(level.segments, u64::from(left.1 > 0) + u64::from(right.1 > 0));
            }
            prop_assert_eq!((live.samples(), live.out_of_range()), (2999, 1));
        }
    }
}
