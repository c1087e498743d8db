//! Recording: the input of a diagnosis, on a regular grid of instants.

use imu_core::sample::{Channel, Triad};
use imu_noise::whittle::Sampling;
use std::collections::BTreeMap;

/// Samples of several channels at one rate. A lost sample keeps a place, so that later samples stay at their instants.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recording {
    /// Samples per second.
    pub rate_hz: f64,
    /// Each channel's values in its unit, all of one length; the value at a missing sample does not count.
    pub channels: Vec<(Channel, Vec<f64>)>,
    /// Whether each sample is missing; empty if none is.
    pub missing: Vec<bool>,
    /// The sensor's temperature at every sample, °C, as it was read, in steps of any size, if it was measured.
    pub temperature_c: Option<Vec<f64>>,
    /// Stamps, s, one per present sample or per place; empty if none were taken.
    pub time_s: Vec<f64>,
    /// The first stamp on the recording's own clock, s, if it is known.
    pub begins_s: Option<f64>,
    /// The values that the sensor sent, if the channels' values are the remainder beyond a response to a motion. Only
    /// the sent values show steps of rounding and samples sent again; limits belong to the response.
    pub sent: Vec<(Channel, Vec<f64>)>,
    /// The sampling of a triad, if it is known.
    pub sampling: BTreeMap<Triad, Sampling>,
}

impl Recording {
    /// Returns the number of places on the grid.
    pub fn len(&self) -> usize {
        self.channels.first().map_or(0, |(_, values)| values.len())
    }

    /// Returns whether there are no places.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns a channel's values.
    pub fn values(&self, channel: Channel) -> Option<&[f64]> {
        self.channels.iter().find(|(own, _)| *own == channel).map(|(_, values)| values.as_slice())
    }

    /// Returns the values of all axes of a triad; `None` if the recording lacks one.
    pub(super) fn triad(&self, triad: Triad) -> Option<[&[f64]; 3]> {
        let [x, y, z] = triad.channels().map(|channel| self.values(channel));
        Some([x?, y?, z?])
    }

    /// Returns the values that the sensor sent, if the channel's values are the remainder beyond a response to a
    /// motion.
    pub fn sent(&self, channel: Channel) -> Option<&[f64]> {
        self.sent.iter().find(|(own, _)| *own == channel).map(|(_, values)| values.as_slice())
    }

    /// Returns the part of the recording at these places.
    pub fn part(&self, within: std::ops::Range<usize>) -> Self {
        let cut = |values: &[f64]| values.get(within.clone()).unwrap_or_default().to_vec();
        let all = |of: &[(Channel, Vec<f64>)]| of.iter().map(|(channel, values)| (*channel, cut(values))).collect();
        // One stamp per place, or per present sample.
        let there = |until: usize| (0..until.min(self.len())).filter(|place| !self.is_missing(*place)).count();
        let stamps = match self.time_s.len() == self.len() {
            true => within.clone(),
            false => there(within.start)..there(within.end),
        };
        Self {
            rate_hz: self.rate_hz,
            channels: all(&self.channels),
            missing: self.missing.get(within.clone()).unwrap_or_default().to_vec(),
            temperature_c: self.temperature_c.as_deref().map(cut),
            time_s: self.time_s.get(stamps).unwrap_or_default().to_vec(),
            begins_s: self.begins_s,
            sent: all(&self.sent),
            sampling: self.sampling.clone(),
        }
    }

    /// Returns whether the sample at a place is missing.
    pub fn is_missing(&self, place: usize) -> bool {
        self.missing.get(place).copied().unwrap_or(false)
    }

    /// Returns the lowest and the highest temperature from one time to another, s from the first sample; `None` if none
    /// was measured.
    pub fn temperatures_between(&self, from_s: f64, to_s: f64) -> Option<[f64; 2]> {
        let place = |time_s: f64| ((time_s * self.rate_hz).round().max(0.0) as usize).min(self.len());
        let there = |t: &usize| !self.missing.get(*t).copied().unwrap_or(false);
        let read = self.temperature_c.as_ref()?;
        let readings = (place(from_s)..place(to_s)).filter(there).filter_map(|t| read.get(t).copied());
        let finite = readings.filter(|value| value.is_finite());
        finite.fold(None, |ends: Option<[f64; 2]>, value| {
            let [low, high] = ends.unwrap_or([value, value]);
            Some([low.min(value), high.max(value)])
        })
    }

    /// Returns the length, s.
    pub fn length_s(&self) -> f64 {
        self.len() as f64 / self.rate_hz
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn temperatures_are_those_of_samples_that_are_there() {
        let real = Recording {
            rate_hz: 2.0,
            channels: vec![(Channel::GyroX, vec![0.0; 6])],
            missing: vec![false, false, true, false, false, false],
            temperature_c: Some(vec![20.0, 21.0, 90.0, 23.0, f64::NAN, 22.0]),
            ..Recording::default()
        };
        assert_eq!(real.temperatures_between(0.0, 3.0), Some([20.0, 23.0]));
        assert_eq!(real.temperatures_between(2.0, 2.4), None);
        assert_eq!(real.temperatures_between(2.5, 9.0), Some([22.0, 22.0]));
    }
}
