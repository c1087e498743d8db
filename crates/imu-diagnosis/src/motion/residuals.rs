//! Residuals: the difference between a record of a motion and the model, against time, rate and specific force, for
//! pictures.

use super::settle::{Settled, level};
use crate::response::{self, AXES};
use crate::written::numbers;
use imu_model::effects::triad::Axes;
use imu_model::simulator::{Motion, SensorModel};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Number of points in a picture against time, and in one against rate or force.
const POINTS: [usize; 2] = [120, 40];
/// Minimum number of samples per point: their mean scatters by a third of the noise.
const LEAST: usize = 10;

/// Means of the residuals of one channel over the range of the quantity that they are drawn against.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Residuals {
    /// The channel.
    pub channel: Cow<'static, str>,
    /// The channel's unit.
    pub unit: Cow<'static, str>,
    /// `time`, `rate` or `specific force`.
    pub against: Cow<'static, str>,
    /// The axis of that quantity: the one by which the residuals differ most.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis: Option<Cow<'static, str>>,
    /// Unit of [`Self::at`]: s after the record's first sample, rad/s or m/s².
    pub at_unit: Cow<'static, str>,
    /// The position of each mean, in order.
    #[serde(deserialize_with = "numbers")]
    pub at: Vec<f64>,
    /// Samples less the model's response to the motion.
    #[serde(deserialize_with = "numbers")]
    pub before: Vec<f64>,
    /// Samples less the corrected model's response to the motion.
    #[serde(deserialize_with = "numbers")]
    pub after: Vec<f64>,
}

/// Returns the residuals of a triad's channels; `from_s` is when the motions begin.
pub(super) fn residuals(
    of: &Settled,
    sim: &SensorModel,
    sent: [&[f64]; 3],
    motions: &[Motion],
    rate_hz: f64,
    from_s: f64,
) -> Vec<Residuals> {
    let shown = response::expected(of.triad, rate_hz, motions, &of.known, level(sim, of.triad));
    let time_s: Vec<f64> = (0..motions.len()).map(|t| from_s + t as f64 / rate_hz).collect();
    let driver = |force: bool, axis: usize| -> Vec<f64> {
        motions.iter().map(|motion| if force { motion.accel_m_s2[axis] } else { motion.gyro_rad_s[axis] }).collect()
    };
    let drivers: Vec<(&'static str, &'static str, [Vec<f64>; 3])> =
        [("rate", "rad/s", false), ("specific force", "m/s²", true)]
            .map(|(against, unit, force)| (against, unit, std::array::from_fn(|axis| driver(force, axis))))
            .into();
    let mut all = Vec::new();
    for (axis, channel) in of.triad.channels().into_iter().enumerate() {
        let before: Vec<f64> = sent[axis].iter().zip(&shown[axis]).map(|(sent, shown)| sent - shown).collect();
        let after = &of.rest[axis];
        let of_means =
            |against: &'static str, axis: Option<&'static str>, at_unit: &'static str, means: Means| Residuals {
                channel: channel.name().into(),
                unit: channel.unit().into(),
                against: against.into(),
                axis: axis.map(Cow::from),
                at_unit: at_unit.into(),
                at: means.at,
                before: means.before,
                after: means.after,
            };
        all.push(of_means("time", None, "s", Means::of(&time_s, &before, after, POINTS[0])));
        for (against, unit, values) in &drivers {
            let along = (0..3).map(|axis| (axis, Means::of(&values[axis], &before, after, POINTS[1])));
            let most = along.max_by(|(_, one), (_, other)| one.differ.total_cmp(&other.differ));
            if let Some((axis, means)) = most.filter(|(_, means)| means.at.len() > 1) {
                all.push(of_means(against, Some(AXES[axis]), unit, means));
            }
        }
    }
    all
}

/// Means over parts of a range.
#[derive(Debug, Default)]
struct Means {
    at: Vec<f64>,
    before: Vec<f64>,
    after: Vec<f64>,
    /// Sum of squares that the means of `before` explain.
    differ: f64,
}

impl Means {
    /// Divides the range into `points` parts of one width and drops those with too few samples.
    fn of(values: &[f64], before: &[f64], after: &[f64], points: usize) -> Self {
        let (low, high) =
            values.iter().fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(*value), high.max(*value)));
        if high <= low {
            return Self::default();
        }
        let mut sums = vec![(0_usize, Axes::default()); points];
        for ((value, before), after) in values.iter().zip(before).zip(after) {
            let place = ((value - low) / (high - low) * points as f64) as usize;
            let (count, sum) = &mut sums[place.min(points - 1)];
            // A sample that is left out has no value after the correction.
            if before.is_finite() && after.is_finite() {
                *count += 1;
                for (sum, value) in sum.iter_mut().zip([value, before, after]) {
                    *sum += value;
                }
            }
        }
        let mut means = Self::default();
        let (mut whole, mut counted) = (0.0, 0.0);
        for (count, sum) in sums.into_iter().filter(|(count, _)| *count >= LEAST) {
            let [at, before, after] = sum.map(|sum| sum / count as f64);
            means.at.push(at);
            means.before.push(before);
            means.after.push(after);
            means.differ += count as f64 * before * before;
            whole += count as f64 * before;
            counted += count as f64;
        }
        if counted > 0.0 {
            means.differ -= whole * whole / counted;
        }
        means
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_follow_what_drives_and_lack_what_is_left_out() {
        let values: Vec<f64> = (0..4000).map(|t| (0.01 * f64::from(t)).sin()).collect();
        let before: Vec<f64> = values.iter().map(|value| 0.5 * value + 0.1).collect();
        let mut after = vec![0.0; 4000];
        after[7] = f64::NAN;
        let means = Means::of(&values, &before, &after, 20);
        assert_eq!(means.at.len(), 20);
        for (at, before) in means.at.iter().zip(&means.before) {
            assert!((before - (0.5 * at + 0.1)).abs() < 1e-12, "{at} {before}");
        }
        assert!(means.after.iter().all(|value| *value == 0.0));
        let square: f64 = before.iter().map(|value| (value - 0.1).powi(2)).sum();
        assert!((means.differ / square - 1.0).abs() < 0.05, "{} of {square}", means.differ);
        let still = Means::of(&vec![1.0; 4000], &before, &after, 20);
        assert!(still.at.is_empty() && Means::of(&values[..15], &before, &after, 20).at.is_empty());
    }
}
