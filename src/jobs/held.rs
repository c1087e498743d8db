//! Held: the samples of a short plan, kept when they are first read, so that they are not read again.

use super::plan::Plan;
use crate::store::Chunk;
use imu_core::sample::Channel;
use imu_noise::robust::BLOCK;

/// The maximum memory of held samples in bytes: those of nine channels and temperature of five hours at 40 Hz.
const MEMORY: u64 = 64 << 20;

/// Consecutive samples of a plan from its first one on.
#[derive(Debug)]
pub(super) struct Held {
    channels: Vec<Channel>,
    segment: Vec<u32>,
    columns: Vec<Vec<f64>>,
}

impl Held {
    /// Creates room for the samples of a plan; `None` if there are too many, or if a capture has more than a block.
    pub(super) fn for_plan(plan: &Plan) -> Option<Self> {
        let channels: Vec<Channel> = plan.channels.iter().copied().chain([Channel::Temperature]).collect();
        let fits = plan.end_seq.saturating_mul(8 * channels.len() as u64) <= MEMORY;
        let short = plan.slices.iter().all(|slice| slice.samples.end - slice.samples.start <= BLOCK);
        let length = usize::try_from(plan.end_seq).ok().filter(|_| fits && short)?;
        let columns = channels.iter().map(|_| Vec::with_capacity(length)).collect();
        Some(Self { channels, segment: Vec::with_capacity(length), columns })
    }

    /// Returns the channels to read.
    pub(super) fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// Returns whether a channel is held.
    pub(super) fn has(&self, channel: Channel) -> bool {
        self.channels.contains(&channel)
    }

    /// Takes the next samples; the columns are those of [`Self::channels`], then any others.
    pub(super) fn take(&mut self, chunk: &Chunk) {
        self.segment.extend_from_slice(&chunk.segment);
        self.columns.iter_mut().zip(&chunk.columns).for_each(|(own, column)| own.extend_from_slice(column));
    }

    /// Returns the number of samples.
    pub(super) fn len(&self) -> u64 {
        self.segment.len() as u64
    }

    /// Returns up to `limit` samples from number `from` on; a channel that is not held is absent.
    pub(super) fn chunk(&self, from: u64, limit: usize, channels: &[Channel]) -> Chunk {
        let end = self.segment.len();
        let from = usize::try_from(from).unwrap_or(end).min(end);
        let rows = from..from.saturating_add(limit).min(end);
        let column = |channel: &Channel| {
            let at = self.channels.iter().position(|held| held == channel);
            let values = at.and_then(|at| self.columns.get(at)?.get(rows.clone()));
            values.map_or_else(|| vec![f64::NAN; rows.len()], <[f64]>::to_vec)
        };
        Chunk {
            first_seq: from as u64,
            segment: self.segment.get(rows.clone()).unwrap_or_default().to_vec(),
            channels: channels.to_vec(),
            columns: channels.iter().map(column).collect(),
            times: None,
        }
    }
}
