//! Spectral sums of a capture's channels, chunk by chunk, for `noise` jobs.
//!
//! Channels are processed in groups, one pass over the samples per group, so that memory stays below [`MEMORY`] plus
//! one transform's work space, whatever the length. A checkpoint contains the sums of stretches that have ended. An
//! open stretch is read again, so that the transform sees it without an interruption.

use super::examine::{Examined, Steps};
use super::held::Held;
use super::motion::AtRest;
use super::pass::{FOLDED, FOLDED_SHORT, GoOn, Pass, join, split};
use super::plan::{Plan, feed};
use super::report;
use super::threads::side_by_side;
use super::{JobError, SampleSource};
use crate::store::{Chunk, JobRow, Reader};
use imu_core::sample::Channel;
use imu_noise::allan::FixedPoint;
use imu_noise::robust::blocks_of;
use imu_noise::whittle::{DstEstimator, DstSums, Transform};
use std::collections::BTreeMap;

/// The maximum memory of the samples of one pass in bytes: those of nine channels of five hours at 40 Hz.
const MEMORY: usize = 64 << 20;
/// Version of the checkpoint.
const VERSION: u8 = 3;

/// The sums under computation.
#[derive(Debug)]
pub(super) struct Spectra {
    plan: Plan,
    /// Channels of one pass.
    group: usize,
    /// Sums of the channels of earlier passes.
    done: Vec<DstSums>,
    /// The channels of this pass.
    current: Vec<DstEstimator>,
    transform: Transform,
    /// The segment that the last sample taken in belongs to.
    open: Option<u32>,
    /// The channels that were examined for disturbances before the job was interrupted.
    examined: BTreeMap<Channel, Examined>,
    /// All samples so far, if there is room for all and no restart preceded them.
    held: Option<Held>,
}

impl Spectra {
    /// Returns the state before any sample.
    pub(super) fn new(plan: Plan) -> Self {
        let longest = usize::try_from(plan.longest).unwrap_or(usize::MAX);
        let group = (MEMORY / DstEstimator::bytes(longest).max(1)).clamp(1, plan.channels.len().max(1));
        let transform = Transform::new();
        let held = Held::for_plan(&plan).filter(|_| group == plan.channels.len());
        let mut spectra = Self {
            plan,
            group,
            done: Vec::new(),
            current: Vec::new(),
            transform,
            open: None,
            examined: BTreeMap::new(),
            held,
        };
        spectra.begin_pass();
        spectra
    }

    /// Returns the state before any sample, for the samples at rest; keeps the samples that are held already.
    pub(super) fn of(at_rest: AtRest) -> Self {
        let mut spectra = Self::new(at_rest.plan);
        if spectra.held.is_some() && at_rest.held.is_some() {
            spectra.held = at_rest.held;
        }
        spectra
    }

    /// Resumes after `next_seq` samples of the pass that `state` ([`Pass::save`]) contains; `None` if it is damaged.
    pub(super) fn restored(
        mut self,
        state: &[u8],
        next_seq: u64,
        source: &dyn SampleSource,
    ) -> Result<Option<Self>, JobError> {
        let Some(State { done, running, examined }) = decode(state) else { return Ok(None) };
        (self.done, self.examined) = (done, examined);
        self.held = None;
        let channels = self.pass_channels().to_vec();
        if channels.len() != running.len() {
            return Ok(None);
        }
        let mut current = Vec::new();
        for (channel, (sums, open)) in channels.iter().zip(running) {
            let mut estimator = DstEstimator::resume(FixedPoint::for_channel(*channel), sums);
            let Some(from) = next_seq.checked_sub(open) else { return Ok(None) };
            for chunk in self.plan.chunks(source, from..next_seq, &[*channel]) {
                estimator.push(&mut self.transform, chunk?.columns.first().map(Vec::as_slice).unwrap_or_default());
            }
            current.push(estimator);
        }
        self.current = current;
        if let Some(last) = next_seq.checked_sub(1) {
            let chunk = self.plan.read_chunk(source, last, 1, &[])?;
            self.open = chunk.segment.first().copied().filter(|number| self.plan.stretch_of(*number, last).is_some());
        }
        Ok(Some(self))
    }

    /// Returns the channels that are summed in this pass.
    fn pass_channels(&self) -> &[Channel] {
        self.plan.channels_after(self.done.len(), self.group)
    }

    fn begin_pass(&mut self) {
        self.open = None;
        let longest = usize::try_from(self.plan.longest).unwrap_or(usize::MAX);
        let estimator = |channel: &Channel| {
            let mut estimator = DstEstimator::new(FixedPoint::for_channel(*channel));
            estimator.reserve(longest);
            estimator
        };
        self.current = self.pass_channels().iter().map(estimator).collect();
    }

    /// Returns whether the search for disturbances takes long: there are several captures, or one has more than one
    /// block.
    fn is_long(&self) -> bool {
        self.plan.slices.len() > 1
            || self.plan.slices.iter().any(|slice| blocks_of(slice.samples.end - slice.samples.start) > 1)
    }

    /// Returns the plan, every channel's sums, and all samples if they are held, once the last pass has ended.
    pub(super) fn finish(self) -> (Plan, Vec<(Channel, DstSums)>, Option<Held>) {
        let sums = self.plan.channels.iter().copied().zip(self.done).collect();
        let whole = self.plan.end_seq;
        (self.plan, sums, self.held.filter(|held| held.len() == whole))
    }
}

impl Pass for Spectra {
    fn plan(&self) -> Option<&Plan> {
        Some(&self.plan)
    }
    /// Returns the channels that are summed first.
    fn read_channels(&self) -> &[Channel] {
        self.held.as_ref().map_or_else(|| self.pass_channels(), Held::channels)
    }
    fn held_chunk(&self, from: u64, limit: usize) -> Option<Chunk> {
        let held = self.held.as_ref().filter(|held| held.len() == self.plan.end_seq)?;
        Some(held.chunk(from, limit, self.pass_channels()))
    }
    fn take(&mut self, chunk: &Chunk) {
        if let Some(held) = self.held.as_mut().filter(|held| held.len() <= chunk.first_seq) {
            held.take(chunk);
        }
        let runs = self.plan.runs(chunk);
        for (estimator, column) in self.current.iter_mut().zip(&chunk.columns) {
            feed(
                &mut (estimator, &mut self.transform),
                &runs,
                column,
                self.open,
                |(estimator, transform), values| estimator.push(transform, values),
                |(estimator, transform)| estimator.break_segment(transform),
            );
        }
        if let Some((number, _)) = runs.last() {
            self.open = *number;
        }
    }
    fn end_pass(&mut self) -> bool {
        self.transform = Transform::new();
        let sums = |transform: &mut Transform, estimator: DstEstimator| estimator.into_sums(transform);
        self.done.extend(side_by_side(std::mem::take(&mut self.current).into_iter(), Transform::new, sums));
        let more = self.done.len() < self.plan.channels.len();
        if more {
            self.begin_pass();
        }
        more
    }
    fn progress(&self, next_seq: u64, _end_seq: u64) -> f64 {
        let share = self.pass_channels().len() as f64 * next_seq as f64 / self.plan.end_seq.max(1) as f64;
        let folded = if self.is_long() { FOLDED } else { FOLDED_SHORT };
        folded * (self.done.len() as f64 + share) / self.plan.channels.len().max(1) as f64
    }
    fn save(&mut self) -> Result<Vec<u8>, JobError> {
        let done: Vec<Vec<u8>> = self.done.iter().map(DstSums::to_bytes).collect();
        let current: Vec<Vec<u8>> = self
            .current
            .iter()
            .map(|estimator| {
                let mut bytes = estimator.open_samples().to_le_bytes().to_vec();
                bytes.extend(estimator.sums().to_bytes());
                bytes
            })
            .collect();
        let mut bytes = vec![VERSION];
        bytes.extend(join(&done));
        bytes.extend(join(&current));
        Ok(bytes)
    }
    fn document(mut self: Box<Self>, reader: &Reader, _: &JobRow, go_on: &mut GoOn<'_>) -> Result<String, JobError> {
        let mut steps = InJob { sums: self.save()?, examined: std::mem::take(&mut self.examined), go_on };
        let (plan, sums, held) = self.finish();
        Ok(serde_json::to_string(&report::noise(reader, &plan, &sums, held, &mut steps)?)?)
    }
}

/// The examination of a job: the sums as a checkpoint has them, and the channels that are examined.
struct InJob<'a, 'b> {
    sums: Vec<u8>,
    examined: BTreeMap<Channel, Examined>,
    go_on: &'a mut GoOn<'b>,
}

impl Steps for InJob<'_, '_> {
    fn go_on(&mut self, done: f64) -> Result<(), JobError> {
        (self.go_on)(done, None)
    }
    fn kept(&self, channel: Channel) -> Option<Examined> {
        self.examined.get(&channel).cloned()
    }
    fn keep(&mut self, examined: &[(Channel, Examined)], done: f64) -> Result<(), JobError> {
        self.examined.extend(examined.iter().cloned());
        (self.go_on)(done, Some([self.sums.clone(), serde_json::to_vec(&self.examined)?].concat()))
    }
}

#[cfg(test)]
impl Spectra {
    pub(super) fn in_groups(mut self, group: usize) -> Self {
        self.group = group;
        self.held = None;
        self.begin_pass();
        self
    }
}

/// The content of a checkpoint.
struct State {
    /// The sums of earlier passes.
    done: Vec<DstSums>,
    /// The sums of this pass with the number of samples of the open stretch.
    running: Vec<(DstSums, u64)>,
    /// The examined channels.
    examined: BTreeMap<Channel, Examined>,
}

fn decode(state: &[u8]) -> Option<State> {
    let (version, mut rest) = state.split_first()?;
    let (done, current) = (split(&mut rest)?, split(&mut rest)?);
    if *version != VERSION {
        return None;
    }
    let examined = if rest.is_empty() { BTreeMap::new() } else { serde_json::from_slice(rest).ok()? };
    let done = done.iter().map(|bytes| DstSums::from_bytes(bytes)).collect::<Option<_>>()?;
    let running = |bytes: &Vec<u8>| {
        let (open, sums) = bytes.split_first_chunk::<8>()?;
        Some((DstSums::from_bytes(sums)?, u64::from_le_bytes(*open)))
    };
    Some(State { done, running: current.iter().map(running).collect::<Option<_>>()?, examined })
}
