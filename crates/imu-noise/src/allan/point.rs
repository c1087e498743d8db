//! One averaging factor's estimate: the element of curves and fits, from any estimator.

use super::{Estimator, NoiseType, equivalent_degrees_of_freedom};

/// An overlapping Allan variance with the data for its confidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AllanPoint {
    /// Averaging factor.
    pub m: usize,
    /// Allan variance, channel's unit squared; finite, ≥ 0.
    pub variance: f64,
    /// Number of second differences at full overlap that carry the same information; ≥ 1.
    pub terms: u64,
    /// Number of segments that gave any of them; ≥ 1.
    pub segments: u64,
    /// Phases from one second difference to the next: 1 with full overlap.
    pub stride: usize,
}

impl AllanPoint {
    /// Returns the terms at full overlap between the first and the last of `taken` differences at every `stride`th
    /// phase.
    pub fn spanned(taken: u64, segments: u64, stride: usize) -> u64 {
        taken.saturating_sub(segments) * stride as u64 + segments.min(taken)
    }

    /// Returns the number of averaged differences: fewer than [`Self::terms`] if not every phase is the newest of one.
    pub fn taken(&self) -> u64 {
        self.terms.saturating_sub(self.segments) / self.stride.max(1) as u64 + self.segments.min(self.terms)
    }

    /// Returns the equivalent degrees of freedom if `noise` dominates: the sum over the segments.
    ///
    /// Terms count as spread evenly over the segments: degrees are linear in the number of terms except for segments of
    /// a few m, so that merges need only the counts. If one segment is long and thousands of others have a single term,
    /// the result is too large.
    pub fn edf(&self, noise: NoiseType) -> f64 {
        let phases = self.phases() as u64;
        self.segments.max(1) as f64 * equivalent_degrees_of_freedom(Estimator::Oadev, noise, self.m, phases)
    }

    /// Returns the number of whole phases in a segment.
    fn phases(&self) -> f64 {
        (self.terms as f64 / self.segments.max(1) as f64).round() + 2.0 * self.m as f64
    }
}

/// Returns the dominant noise at each point, from the slope of the variance over an octave on both sides; `points` are
/// in order of m. If a segment is shorter than thirty averaging times, the slope is mostly chance, and the last
/// identified noise type stays.
pub fn noise_by_slope(points: &[AllanPoint]) -> Vec<NoiseType> {
    /// Points within this factor in m on both sides take part in the slope.
    const REACH: f64 = 2.1;
    /// Minimum number of averaging times in a segment.
    const LEAST: f64 = 30.0;
    /// A slope from fewer terms is sometimes wrong by half.
    const CHANCE: f64 = 300.0;
    /// Maximum number of points in a slope, evenly chosen: every averaging time may be a point.
    const MOST: usize = 64;
    let logs: Vec<(f64, f64)> = points.iter().map(|point| ((point.m as f64).ln(), point.variance.ln())).collect();
    let (mut from, mut to) = (0, 0);
    let mut kinds: Vec<NoiseType> = points
        .iter()
        .zip(&logs)
        .map(|(point, (own_log_m, _))| {
            let ratio = |other: &AllanPoint| other.m as f64 / point.m as f64;
            from += points.get(from..).unwrap_or_default().iter().take_while(|of| ratio(of) < 1.0 / REACH).count();
            to += points.get(to..).unwrap_or_default().iter().take_while(|of| ratio(of) <= REACH).count();
            let near = logs.get(from..to).unwrap_or_default();
            let (mut count, mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
            let chosen = near.iter().step_by(near.len().div_ceil(MOST).max(1));
            for (log_m, log_v) in chosen.filter(|(_, log_v)| log_v.is_finite()) {
                let log_m = log_m - own_log_m;
                count += 1.0;
                x += log_m;
                y += log_v;
                xx += log_m * log_m;
                xy += log_m * log_v;
            }
            let spread = xx - x * x / f64::max(count, 1.0);
            if spread > 1e-9 {
                NoiseType::of_variance_slope((xy - x * y / count) / spread)
            } else {
                NoiseType::WhiteRate
            }
        })
        .collect();
    // A slope of −2 that begins at a long averaging time is chance, because angle noise dominates at short ones.
    for at in 1..kinds.len() {
        let (before, own) = (kinds[at - 1], kinds[at]);
        let is_long = points[at].phases() < CHANCE * points[at].m as f64;
        if is_long && own == NoiseType::WhiteAngle && before != own {
            kinds[at] = before;
        }
    }
    let reliable = points.iter().take_while(|point| point.phases() >= LEAST * point.m as f64).count();
    if let Some(last) = reliable.checked_sub(1).and_then(|last| kinds.get(last).copied()) {
        kinds.iter_mut().skip(reliable).for_each(|kind| *kind = last);
    }
    kinds
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(variance: impl Fn(f64) -> f64) -> Vec<AllanPoint> {
        (0..10)
            .map(|k| AllanPoint {
                m: 1 << k,
                variance: variance(f64::from(1 << k)),
                terms: 10_000,
                segments: 1,
                stride: 1,
            })
            .collect()
    }

    #[test]
    fn a_slope_is_found_at_the_ends_too() {
        assert_eq!(noise_by_slope(&points(|m| 1.0 / m)), [NoiseType::WhiteRate; 10]);
        assert_eq!(noise_by_slope(&points(|m| m)), [NoiseType::RandomWalkRate; 10]);
        assert_eq!(noise_by_slope(&points(|_| 0.0)), [NoiseType::WhiteRate; 10]);
    }

    #[test]
    fn beyond_a_thirtieth_of_the_segment_the_noise_identified_before_stays() {
        let mut points = points(|m| 1.0 / m);
        // 10,000 terms: from m = 512 on a segment is shorter than thirty averaging times.
        assert_eq!(points.len(), 10);
        points.extend((10..13).map(|k| AllanPoint { m: 1 << k, variance: 1.0, terms: 3000, segments: 1, stride: 1 }));
        assert_eq!(noise_by_slope(&points), [NoiseType::WhiteRate; 13]);
        // No type was identified before: the slope has to decide.
        let short: Vec<AllanPoint> = (0..3)
            .map(|k| AllanPoint { m: 1 << k, variance: f64::from(1 << k), terms: 5, segments: 1, stride: 1 })
            .collect();
        assert_eq!(noise_by_slope(&short), [NoiseType::RandomWalkRate; 3]);
    }

    #[test]
    fn angle_noise_does_not_begin_at_long_averaging_times() {
        // White rate noise whose last slope happens to be that of angle noise.
        let chance = |m: f64| if m > 200.0 { 40.0 / (m * m).max(1.0) } else { 1.0 / m };
        assert!(noise_by_slope(&points(chance)).iter().all(|kind| *kind != NoiseType::WhiteAngle));
        assert_eq!(noise_by_slope(&points(|m| 1.0 / (m * m))), [NoiseType::WhiteAngle; 10]);
    }

    #[test]
    fn every_averaging_time_may_be_a_point() {
        let points: Vec<AllanPoint> = (1..=100_000)
            .map(|m| AllanPoint { m, variance: 1.0 / m as f64, terms: 10_000_000, segments: 1, stride: 1 })
            .collect();
        assert!(noise_by_slope(&points).iter().all(|kind| *kind == NoiseType::WhiteRate));
    }

    #[test]
    fn degrees_of_equal_segments_add() {
        let one = AllanPoint { m: 16, variance: 1.0, terms: 1000, segments: 1, stride: 1 };
        let three = AllanPoint { terms: 3000, segments: 3, ..one };
        for noise in NoiseType::ALL {
            assert!((three.edf(noise) - 3.0 * one.edf(noise)).abs() < 1e-9 * three.edf(noise));
        }
    }
    #[test]
    fn a_stride_is_undone() {
        for (taken, segments, stride) in [(33, 1, 65_536), (66, 2, 65_536), (1, 1, 4), (1000, 7, 1), (5, 5, 9)] {
            let terms = AllanPoint::spanned(taken, segments, stride);
            assert_eq!(AllanPoint { m: 1, variance: 1.0, terms, segments, stride }.taken(), taken);
        }
        assert_eq!(AllanPoint::spanned(33, 1, 65_536), 32 * 65_536 + 1);
    }
}
