//! Recording: what is diagnosed, on a regular grid of instants.

use crate::sample::Channel;

/// Samples of several channels at one rate. A sample that was lost has a place all the same, so that what comes after it
/// stands where it was.
#[derive(Debug, Clone, PartialEq, Default)]
#[expect(clippy::exhaustive_structs, reason = "an argument that callers write out")]
pub struct Recording {
    /// Samples per second.
    pub rate_hz: f64,
    /// Each channel's values in its unit, all of one length; what stands where a sample is missing does not count.
    pub channels: Vec<(Channel, Vec<f64>)>,
    /// Which samples are missing; empty if none is.
    pub missing: Vec<bool>,
    /// The sensor's temperature at every sample, °C, where it was measured; as it was read, in whatever steps.
    pub temperature_c: Option<Vec<f64>>,
    /// Stamps, s, one per sample that is there or per place; empty if none were taken.
    pub time_s: Vec<f64>,
}

impl Recording {
    /// Places on the grid.
    #[must_use]
    pub fn len(&self) -> usize {
        self.channels.first().map_or(0, |(_, values)| values.len())
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A channel's values.
    #[must_use]
    pub fn values(&self, channel: Channel) -> Option<&[f64]> {
        self.channels.iter().find(|(own, _)| *own == channel).map(|(_, values)| values.as_slice())
    }

    /// Its length in s.
    #[must_use]
    pub fn length_s(&self) -> f64 {
        self.len() as f64 / self.rate_hz
    }
}
