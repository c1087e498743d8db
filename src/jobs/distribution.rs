//! Moments and histograms of a capture's channels, chunk by chunk, over all its samples: gaps and rates have no effect
//! here.

use super::JobError;
use super::pass::{GoOn, Pass, join, split};
use super::plan::Plan;
use super::report;
use super::source::Extent;
use crate::store::{Chunk, JobRow, Reader};
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
    /// Returns the state before any sample.
    pub(super) fn new(channels: Vec<Channel>) -> Self {
        let accumulators = channels.iter().map(|_| Accumulator::new()).collect();
        Self { channels, accumulators }
    }

    /// Resumes from a saved state ([`Pass::save`]); `None` if `state` is damaged or of other channels.
    pub(super) fn restore(channels: Vec<Channel>, state: &[u8]) -> Option<Self> {
        let (version, mut rest) = state.split_first()?;
        let entries = split(&mut rest).filter(|_| *version == VERSION && rest.is_empty())?;
        let accumulators: Vec<Accumulator> =
            entries.iter().map(|bytes| Accumulator::from_bytes(bytes)).collect::<Option<_>>()?;
        (accumulators.len() == channels.len()).then_some(Self { channels, accumulators })
    }

    /// Returns the statistics of every channel that has a value.
    pub(super) fn statistics(&self) -> BTreeMap<Channel, Statistics> {
        self.channels
            .iter()
            .zip(&self.accumulators)
            .map(|(channel, accumulator)| (*channel, accumulator.statistics(channel.unit())))
            .filter(|(_, statistics)| statistics.n > 0)
            .collect()
    }
}

impl Pass for Distribution {
    fn plan(&self) -> Option<&Plan> {
        None
    }
    fn read_channels(&self) -> &[Channel] {
        &self.channels
    }
    /// Absent values are skipped.
    fn take(&mut self, chunk: &Chunk) {
        for (accumulator, column) in self.accumulators.iter_mut().zip(&chunk.columns) {
            for part in column.split(|value| value.is_nan()) {
                accumulator.push(part);
            }
        }
    }
    fn progress(&self, next_seq: u64, end_seq: u64) -> f64 {
        next_seq as f64 / end_seq.max(1) as f64
    }
    fn save(&mut self) -> Result<Vec<u8>, JobError> {
        let entries: Vec<Vec<u8>> = self.accumulators.iter().map(Accumulator::to_bytes).collect();
        let mut bytes = vec![VERSION];
        bytes.extend(join(&entries));
        Ok(bytes)
    }
    fn document(self: Box<Self>, reader: &Reader, job: &JobRow, _: &mut GoOn<'_>) -> Result<String, JobError> {
        let extent = Extent::read(reader, job.capture, job.end_seq)?;
        Ok(serde_json::to_string(&report::statistics(self.statistics(), extent))?)
    }
}
