//! Field: stretches of a record in which a magnet or iron was near the magnetometer.
//!
//! The magnitude of the earth's field is the same in every pose of the sensor. A magnetometer's own hard and soft iron
//! change the measured magnitude by some percent, depending on the pose. A magnitude far outside the range of the rest
//! of the record comes from the surroundings; it is not an effect of the sensor that a simulator could have.

use super::averages::median;
use super::recording::Recording;
use imu_core::sample::Triad;

/// Length of the examined parts, s.
const PART_S: f64 = 0.5;
/// Minimum number of parts.
const LEAST: usize = 20;
/// Deviation from the middle that is a disturbance: in median deviations of the parts (as standard deviations), and as
/// a part of the middle.
const FAR: [f64; 2] = [8.0, 0.15];
/// A disturbance may swing back for this many parts and still be the same one.
const BETWEEN: usize = 4;
/// Ratio of a normal distribution's standard deviation to its median deviation.
const AS_DEVIATION: f64 = 1.4826;

/// A stretch with a disturbed field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disturbed {
    /// Start, s after the record's first sample.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
    /// The magnitude that is farthest from the middle, gauss (mean over half a second).
    pub farthest_gauss: f64,
    /// The median of all parts, gauss.
    pub middle_gauss: f64,
    /// The parts' scatter about it, gauss.
    pub scatter_gauss: f64,
}

impl Disturbed {
    /// Returns the sentence for a report.
    pub fn sentence(&self) -> String {
        format!(
            "the magnetic field is disturbed from {:.1} s to {:.1} s (a magnet or iron nearby): its magnitude reaches {:.3} \
             gauss, {:.3} ± {:.3} elsewhere; no effect of a sensor makes that",
            self.from_s, self.to_s, self.farthest_gauss, self.middle_gauss, self.scatter_gauss
        )
    }
}

/// Returns the disturbed stretches of a record with a magnetometer, in order.
///
/// # Validation
/// On BROAD's trial 28 (Laidig et al. 2021, Data 6(7):72) this finds the two passes of the magnet, and nothing in 01,
/// 24 and 26 (docs/motion-diagnosis.md).
pub fn disturbed(real: &Recording) -> Vec<Disturbed> {
    let Some(columns) = real.triad(Triad::Mag) else { return Vec::new() };
    let size = ((PART_S * real.rate_hz) as usize).max(1);
    let magnitude = |t: usize| columns.iter().map(|values| values[t] * values[t]).sum::<f64>().sqrt();
    let parts: Vec<Option<f64>> = (0..real.len() / size)
        .map(|part| {
            let there: Vec<f64> = (part * size..(part + 1) * size)
                .filter(|t| !real.is_missing(*t))
                .map(magnitude)
                .filter(|value| value.is_finite())
                .collect();
            (2 * there.len() > size).then(|| there.iter().sum::<f64>() / there.len() as f64)
        })
        .collect();
    let mut known: Vec<f64> = parts.iter().flatten().copied().collect();
    if known.len() < LEAST {
        return Vec::new();
    }
    let middle = median(&mut known);
    known.iter_mut().for_each(|value| *value = (*value - middle).abs());
    let scatter = AS_DEVIATION * median(&mut known);
    let least = (FAR[0] * scatter).max(FAR[1] * middle);
    let mut found: Vec<(usize, usize, f64)> = Vec::new();
    for (place, value) in parts.iter().enumerate().filter_map(|(place, value)| Some((place, (*value)?))) {
        if (value - middle).abs() <= least {
            continue;
        }
        match found.last_mut() {
            Some((_, last, farthest)) if place - *last <= BETWEEN => {
                *last = place;
                if (value - middle).abs() > (*farthest - middle).abs() {
                    *farthest = value;
                }
            }
            _ => found.push((place, place, value)),
        }
    }
    let at_s = |part: usize| (part * size) as f64 / real.rate_hz;
    let stretch = |(from, last, farthest): (usize, usize, f64)| Disturbed {
        from_s: at_s(from),
        to_s: at_s(last + 1),
        farthest_gauss: farthest,
        middle_gauss: middle,
        scatter_gauss: scatter,
    };
    found.into_iter().map(stretch).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(field: impl Fn(usize) -> [f64; 3]) -> Recording {
        let channels = Triad::Mag.channels().into_iter().enumerate();
        let values = |axis: usize| (0..4000).map(|t| field(t)[axis]).collect();
        Recording {
            rate_hz: 40.0,
            channels: channels.map(|(axis, channel)| (channel, values(axis))).collect(),
            ..Recording::default()
        }
    }

    #[test]
    fn a_magnets_pass_is_found_and_a_turn_with_hard_iron_is_none() {
        let turned = |t: usize| {
            let (sin, cos) = (0.002 * t as f64).sin_cos();
            // Hard iron of a twentieth, and deterministic values in place of noise.
            [0.45 * cos + 0.02, 0.45 * sin, 0.02 * ((t * 7919) % 13) as f64 / 13.0]
        };
        assert_eq!(disturbed(&record(turned)), []);
        let passed = |t: usize| {
            let [x, y, z] = turned(t);
            let near = (-(((t as f64) - 2000.0) / 60.0).powi(2)).exp();
            [x, y, z + 0.9 * near]
        };
        let found = disturbed(&record(passed));
        assert_eq!(found.len(), 1, "{found:?}");
        assert!((47.0..50.0).contains(&found[0].from_s) && (50.0..53.0).contains(&found[0].to_s), "{found:?}");
        assert!(found[0].farthest_gauss > 0.9 && (0.4..0.5).contains(&found[0].middle_gauss), "{found:?}");
        assert!(found[0].sentence().contains("magnet or iron nearby"));
        assert_eq!(disturbed(&Recording { rate_hz: 40.0, ..Recording::default() }), []);
    }
}
