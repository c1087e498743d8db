//! Moments and histograms of a capture's channels, chunk by chunk, over all its samples: gaps and rates have no effect
//! here.

use super::fold::{join, split};
use crate::store::Chunk;
use imu_core::sample::Channel;
use imu_noise::statistics::{Accumulator, Statistics};
use std::collections::BTreeMap;

/// Version of the checkpoint.
const VERSION: u8 = 1;

/// The distribution of every channel.
#[derive(Debug)]
pub(super) struct Distribution {
    channels: Vec<Channel>,
    accumulators: Vec<Accumulator>,
}

impl Distribution {
    /// The state before any sample.
    pub(super) fn new(channels: Vec<Channel>) -> Self {
        let accumulators = channels.iter().map(|_| Accumulator::new()).collect();
        Self { channels, accumulators }
    }

    /// Resumes from a saved state ([`Self::save`]); `None` if `state` is damaged or of other channels.
    pub(super) fn restore(channels: Vec<Channel>, state: &[u8]) -> Option<Self> {
        let (version, mut rest) = state.split_first()?;
        let entries = split(&mut rest).filter(|_| *version == VERSION && rest.is_empty())?;
        let accumulators: Vec<Accumulator> =
            entries.iter().map(|bytes| Accumulator::from_bytes(bytes)).collect::<Option<_>>()?;
        (accumulators.len() == channels.len()).then_some(Self { channels, accumulators })
    }

    pub(super) fn save(&self) -> Vec<u8> {
        let entries: Vec<Vec<u8>> = self.accumulators.iter().map(Accumulator::to_bytes).collect();
        let mut bytes = vec![VERSION];
        bytes.extend(join(&entries));
        bytes
    }

    pub(super) fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// Takes in the next samples; absent values are skipped.
    pub(super) fn take(&mut self, chunk: &Chunk) {
        self.take_columns(chunk.columns.iter().map(Vec::as_slice));
    }

    pub(super) fn take_columns<'a>(&mut self, columns: impl Iterator<Item = &'a [f64]>) {
        for (accumulator, column) in self.accumulators.iter_mut().zip(columns) {
            for part in column.split(|value| value.is_nan()) {
                accumulator.push(part);
            }
        }
    }

    /// The statistics of every channel that has a value.
    pub(super) fn statistics(&self) -> BTreeMap<Channel, Statistics> {
        self.channels
            .iter()
            .zip(&self.accumulators)
            .map(|(channel, accumulator)| (*channel, accumulator.statistics(channel.unit())))
            .filter(|(_, statistics)| statistics.n > 0)
            .collect()
    }
}
