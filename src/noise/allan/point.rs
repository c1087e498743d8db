//! One averaging factor's worth of knowledge: what curves and fits are made of, whichever estimator it came from.

use super::{Estimator, NoiseType, equivalent_degrees_of_freedom};

/// An overlapping Allan variance with what its confidence rests on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AllanPoint {
    /// Averaging factor.
    pub m: usize,
    /// Allan variance, channel's unit squared; finite, ≥ 0.
    pub variance: f64,
    /// Second differences at full overlap that carry the same information; ≥ 1.
    pub terms: u64,
    /// Segments that gave any of them; ≥ 1.
    pub segments: u64,
}

impl AllanPoint {
    /// Equivalent degrees of freedom where `noise` dominates: those of each segment add.
    ///
    /// Segments enter as if the terms were spread evenly over them: degrees are linear in the number of terms but for
    /// segments of a few m, so that only the counts have to be carried through merges.
    #[must_use]
    pub fn edf(&self, noise: NoiseType) -> f64 {
        let segments = self.segments.max(1);
        let phases = (self.terms as f64 / segments as f64).round() as u64 + 2 * self.m as u64;
        segments as f64 * equivalent_degrees_of_freedom(Estimator::Oadev, noise, self.m, phases)
    }
}

/// The noise that dominates at each point, by the slope of the variance over an octave to both sides.
#[must_use]
pub fn noise_by_slope(points: &[AllanPoint]) -> Vec<NoiseType> {
    /// At both sides this factor in m takes part in the slope.
    const REACH: f64 = 2.1;
    points
        .iter()
        .map(|point| {
            let near = points.iter().filter(|other| {
                let ratio = other.m as f64 / point.m as f64;
                other.variance > 0.0 && (1.0 / REACH..=REACH).contains(&ratio)
            });
            let (mut count, mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for other in near {
                let (log_m, log_v) = ((other.m as f64 / point.m as f64).ln(), other.variance.ln());
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
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(variance: impl Fn(f64) -> f64) -> Vec<AllanPoint> {
        (0..10)
            .map(|k| AllanPoint { m: 1 << k, variance: variance(f64::from(1 << k)), terms: 10_000, segments: 1 })
            .collect()
    }

    #[test]
    fn a_slope_is_found_at_the_ends_too() {
        assert_eq!(noise_by_slope(&points(|m| 1.0 / m)), [NoiseType::WhiteRate; 10]);
        assert_eq!(noise_by_slope(&points(|m| m)), [NoiseType::RandomWalkRate; 10]);
        assert_eq!(noise_by_slope(&points(|_| 0.0)), [NoiseType::WhiteRate; 10]);
    }

    #[test]
    fn degrees_of_equal_segments_add() {
        let one = AllanPoint { m: 16, variance: 1.0, terms: 1000, segments: 1 };
        let three = AllanPoint { terms: 3000, segments: 3, ..one };
        for noise in NoiseType::ALL {
            assert!((three.edf(noise) - 3.0 * one.edf(noise)).abs() < 1e-9 * three.edf(noise));
        }
    }
}
