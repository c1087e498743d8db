//! Exact Allan sums of a capture's channels, chunk by chunk, for `allan` and `noise` jobs.
//!
//! Channels are processed in groups, one pass over the samples per group, so that memory stays below [`MEMORY`]
//! whatever the length. A channel needs 2.5 phases of 8 bytes per sample of its longest averaging time with full
//! overlap.

use super::pass::{GoOn, Pass, join, split};
use super::plan::{Plan, feed};
use super::report;
use super::source::Extent;
use super::{JobError, JobParameters, SampleSource};
use crate::store::{Chunk, JobRow, Reader};
use imu_core::sample::Channel;
use imu_noise::allan::{AllanSums, FixedPoint, Overlapping, TauGrid};

/// The maximum memory of the phases of one pass in bytes.
pub const MEMORY: usize = 48 << 20;
/// Version of the checkpoint.
const VERSION: u8 = 2;

/// The sums under computation.
#[derive(Debug)]
pub(super) struct Summation {
    plan: Plan,
    grid: TauGrid,
    /// Channels of one pass.
    group: usize,
    /// Sums of the channels of earlier passes.
    done: Vec<AllanSums>,
    /// The channels of this pass.
    current: Vec<Overlapping>,
    /// The segment that the last sample taken in belongs to.
    open: Option<u32>,
}

impl Summation {
    /// Returns the state before any sample.
    pub(super) fn new(plan: Plan, parameters: &JobParameters) -> Result<Self, JobError> {
        let grid = TauGrid::new(parameters.taus, plan.longest)?;
        let group = (MEMORY / Overlapping::bytes(&grid, plan.longest).max(1)).clamp(1, plan.channels.len());
        let mut summation = Self { plan, grid, group, done: Vec::new(), current: Vec::new(), open: None };
        summation.begin_pass();
        Ok(summation)
    }

    /// Resumes after `next_seq` samples of the pass that `state` ([`Pass::save`]) contains.
    pub(super) fn restored(
        mut self,
        state: &[u8],
        next_seq: u64,
        source: &dyn SampleSource,
    ) -> Result<Option<Self>, JobError> {
        let Some((done, current)) = decode(state) else { return Ok(None) };
        let Some(finished) = self.decode_sums(&done) else { return Ok(None) };
        self.done = finished;
        let channels = self.read_channels().to_vec();
        if channels.is_empty() || channels.len() != current.len() {
            return Ok(None);
        }
        let halo = self.halo(next_seq, source)?;
        let mut running = Vec::new();
        for (channel, saved) in channels.iter().zip(current) {
            let values = match &halo {
                Some((_, from)) => {
                    let limit = usize::try_from(next_seq - from).unwrap_or(usize::MAX);
                    let chunk = self.plan.read_chunk(source, *from, limit, &[*channel])?;
                    chunk.columns.into_iter().next().unwrap_or_default()
                }
                None => Vec::new(),
            };
            // The samples before an absent value belong to a stretch that has ended.
            let since = values.iter().rposition(|value| value.is_nan()).map_or(0, |index| index + 1);
            let restored = Overlapping::restore(&saved, values.get(since..).unwrap_or_default());
            let Some(estimator) = restored.ok().filter(|estimator| *estimator.grid() == self.grid) else {
                return Ok(None);
            };
            running.push(estimator);
        }
        self.current = running;
        self.open = halo.map(|(number, _)| number);
        Ok(Some(self))
    }

    /// Reads the sums over this grid; `None` if one is damaged or of another grid.
    fn decode_sums(&self, entries: &[Vec<u8>]) -> Option<Vec<AllanSums>> {
        let decode = |bytes: &Vec<u8>| AllanSums::from_bytes(bytes).ok().filter(|sums| *sums.grid() == self.grid);
        entries.iter().map(decode).collect()
    }

    /// Returns the segment of the sample before `next_seq`, and the point from which it is needed again.
    fn halo(&self, next_seq: u64, source: &dyn SampleSource) -> Result<Option<(u32, u64)>, JobError> {
        let Some(last) = next_seq.checked_sub(1) else { return Ok(None) };
        let chunk = self.plan.read_chunk(source, last, 1, &[])?;
        let Some(number) = chunk.segment.first().copied() else { return Ok(None) };
        let Some((number, start)) = self.plan.stretch_of(number, last) else { return Ok(None) };
        Ok(Some((number, start.max(next_seq.saturating_sub(self.grid.halo_len() as u64)))))
    }

    fn begin_pass(&mut self) {
        self.open = None;
        self.current = self
            .read_channels()
            .iter()
            .map(|channel| Overlapping::new(FixedPoint::for_channel(*channel), self.grid.clone()))
            .collect();
    }

    /// Returns the plan and every channel's sums, once the last pass has ended.
    pub(super) fn finish(self) -> (Plan, Vec<(Channel, AllanSums)>) {
        let sums = self.plan.channels.iter().copied().zip(self.done).collect();
        (self.plan, sums)
    }
}

impl Pass for Summation {
    fn plan(&self) -> Option<&Plan> {
        Some(&self.plan)
    }
    fn read_channels(&self) -> &[Channel] {
        self.plan.channels_after(self.done.len(), self.group)
    }
    fn take(&mut self, chunk: &Chunk) {
        let runs = self.plan.runs(chunk);
        for (estimator, column) in self.current.iter_mut().zip(&chunk.columns) {
            feed(estimator, &runs, column, self.open, Overlapping::push, Overlapping::break_segment);
        }
        if let Some((number, _)) = runs.last() {
            self.open = *number;
        }
    }
    fn end_pass(&mut self) -> bool {
        self.done.extend(std::mem::take(&mut self.current).into_iter().map(Overlapping::into_sums));
        let more = self.done.len() < self.plan.channels.len();
        if more {
            self.begin_pass();
        }
        more
    }
    fn progress(&self, next_seq: u64, _end_seq: u64) -> f64 {
        let share = self.read_channels().len() as f64 * next_seq as f64 / self.plan.end_seq.max(1) as f64;
        (self.done.len() as f64 + share) / self.plan.channels.len() as f64
    }
    fn save(&mut self) -> Result<Vec<u8>, JobError> {
        let done: Vec<Vec<u8>> = self.done.iter().map(AllanSums::to_bytes).collect();
        let current: Vec<Vec<u8>> = self.current.iter_mut().map(Overlapping::save).collect();
        let mut bytes = vec![VERSION];
        bytes.extend(join(&done));
        bytes.extend(join(&current));
        Ok(bytes)
    }
    fn document(self: Box<Self>, reader: &Reader, _: &JobRow, _: &mut GoOn<'_>) -> Result<String, JobError> {
        let (plan, sums) = self.finish();
        let extent = Extent::of_plan(reader, &plan)?;
        Ok(serde_json::to_string(&report::allan(&plan, &sums, &extent))?)
    }
}

#[cfg(test)]
impl Summation {
    pub(super) fn in_groups(mut self, group: usize) -> Self {
        self.group = group;
        self.begin_pass();
        self
    }
}

type Lists = (Vec<Vec<u8>>, Vec<Vec<u8>>);

fn decode(state: &[u8]) -> Option<Lists> {
    let (version, mut rest) = state.split_first()?;
    let lists = (split(&mut rest)?, split(&mut rest)?);
    (*version == VERSION && rest.is_empty()).then_some(lists)
}
