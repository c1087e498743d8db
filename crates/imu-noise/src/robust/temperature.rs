//! Temperature: the dependence of a channel's level on the sensor's temperature.
//!
//! Changes of the level from block to block are regressed on changes of the temperature. For a random walk of the
//! level, the changes are independent, and the coefficient's interval holds. The dependence is removed only if it
//! differs from 0 at the 1 % level.

use super::blocks::Blocks;
use super::{Levels, Part};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Number of blocks in the record.
const BLOCKS: usize = 64;
/// Minimum range of the temperature, °C: below it, only the sensor's own resolution shows.
const LEAST_RANGE_C: f64 = 0.2;
/// Significance level of the coefficient.
const LEVEL: f64 = 0.01;

/// A channel's dependence on temperature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct TemperatureDependence {
    /// Change of the level per °C, in the channel's unit.
    pub per_c: f64,
    /// The 95 % interval of `per_c`.
    pub ci95: [f64; 2],
    /// Whether `per_c` differs from 0 (1 % level), so that it was subtracted for the parameters called
    /// `without_temperature`.
    pub significant: bool,
    /// Lowest and highest mean temperature of a block, °C.
    pub range_c: [f64; 2],
}

/// Returns the regression of parts on the temperature; `None` if the temperature is not recorded or hardly changes, or
/// if too few blocks have both. Increments across a step (s) do not count.
pub(super) fn regress(
    parts: &[Part],
    rate_hz: f64,
    temperature: &Levels,
    steps_s: &[f64],
) -> Option<(TemperatureDependence, Course)> {
    let levels = Blocks::of(parts, rate_hz, BLOCKS)?;
    let end_s = levels.begin_s + levels.length_s * BLOCKS as f64;
    let course = Blocks::between(temperature.parts(), temperature.rate_hz(), levels.begin_s, end_s, BLOCKS)?;
    let known: Vec<f64> = course.means.iter().flatten().copied().collect();
    let low = known.iter().copied().reduce(f64::min)?;
    let high = known.iter().copied().reduce(f64::max)?;
    if high - low < LEAST_RANGE_C {
        return None;
    }
    let changes = course.increments(&[]);
    let pairs: Vec<(f64, f64)> = levels
        .increments(steps_s)
        .into_iter()
        .filter_map(|(index, level)| Some((changes.iter().find(|(other, _)| *other == index)?.1, level)))
        .collect();
    let degrees = pairs.len() as f64 - 1.0;
    if pairs.len() < BLOCKS / 4 {
        return None;
    }
    let (mut tt, mut ty, mut yy) = (0.0, 0.0, 0.0);
    for (t, y) in &pairs {
        tt += t * t;
        ty += t * y;
        yy += y * y;
    }
    let per_c = ty / tt;
    let error = ((yy - ty * per_c).max(0.0) / degrees / tt).sqrt();
    let student = StudentsT::new(0.0, 1.0, degrees).ok()?;
    let reach = student.inverse_cdf(0.975) * error;
    let p_value = 2.0 * student.sf((per_c / error.max(f64::MIN_POSITIVE)).abs());
    let found = TemperatureDependence {
        per_c,
        ci95: [per_c - reach, per_c + reach],
        significant: p_value < LEVEL,
        range_c: [low, high],
    };
    (per_c.is_finite() && reach.is_finite()).then_some((found, Course(course)))
}

/// The temperature's slow course.
#[derive(Debug)]
pub(super) struct Course(Blocks);

impl Course {
    /// Subtracts `per_c` times the temperature, interpolated linearly between the middles of blocks.
    pub(super) fn subtract(&self, parts: &mut [Part], rate_hz: f64, per_c: f64) {
        let known: Vec<(f64, f64)> = self
            .0
            .means
            .iter()
            .enumerate()
            .filter_map(|(block, mean)| Some((self.0.middle_s(block), (*mean)?)))
            .collect();
        let Some(first) = known.first().copied() else { return };
        for part in parts {
            let mut next = 0;
            for index in 0..part.values.len() {
                let time_s = part.time_s(index, rate_hz);
                while next < known.len() && known[next].0 <= time_s {
                    next += 1;
                }
                let right = known[next.min(known.len() - 1)];
                let left = known[next.saturating_sub(1)];
                let share =
                    if right.0 > left.0 { ((time_s - left.0) / (right.0 - left.0)).clamp(0.0, 1.0) } else { 0.0 };
                part.values[index] -= per_c * (left.1 + share * (right.1 - left.1) - first.1);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::Noise;
    use super::*;

    fn levels(values: Vec<f64>) -> Levels {
        let mut levels = Levels::new(10.0, values.len() as u64);
        levels.push(&[Part { start_s: 0.0, values }], false);
        levels
    }

    #[test]
    fn a_dependence_is_found_within_its_interval_and_taken_out() {
        let mut noise = Noise::new(61);
        let course: Vec<f64> = (0..40_000).map(|i| 25.0 + 4.0 * (f64::from(i) / 6000.0).sin()).collect();
        let mut values = noise.sensor(40_000, 10.0, 1e-3, 0.0, 1e-5);
        for (value, t) in values.iter_mut().zip(&course) {
            *value += 2e-3 * (t - 25.0);
        }
        let mut parts = [Part { start_s: 0.0, values }];
        let temperature = levels(course);
        let (found, course) = regress(&parts, 10.0, &temperature, &[]).unwrap();
        assert!(found.significant && found.ci95[0] < 2e-3 && found.ci95[1] > 2e-3, "{found:?}");
        course.subtract(&mut parts, 10.0, found.per_c);
        let (rest, _) = regress(&parts, 10.0, &temperature, &[]).unwrap();
        assert!(!rest.significant && rest.per_c.abs() < 1e-4, "{rest:?}");
    }

    #[test]
    fn a_temperature_that_does_not_change_determines_nothing() {
        let parts = [Part { start_s: 0.0, values: Noise::new(62).white(10_000, 1.0) }];
        assert!(regress(&parts, 10.0, &levels(vec![25.0; 10_000]), &[]).is_none());
        assert!(regress(&parts, 10.0, &Levels::new(10.0, 0), &[]).is_none());
    }
}
