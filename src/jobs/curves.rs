//! Deviation curves of whole stretches in memory, for `allan` jobs with the other estimators.
//!
//! These estimators cannot be summed chunk by chunk: a channel's stretches are gathered and integrated, and every
//! averaging time costs one walk over them. Channels are processed in groups, one pass over the samples per group, so
//! that memory stays below [`MEMORY`] plus one channel; [`MOST`] bounds that one. A checkpoint contains the finished
//! curves; the samples of the others are read again.

use super::pass::{GoOn, Pass, join, split};
use super::plan::{Plan, feed};
use super::report;
use super::source::Extent;
use super::{JobError, JobParameters, SampleSource};
use crate::store::{Chunk, JobRow, Reader};
use imu_core::sample::Channel;
use imu_noise::allan::{AllanCurve, Estimator, Phases, TauGrid, TauSpacing};
use std::collections::VecDeque;

/// The maximum number of samples of a channel that is held in memory: 32 MB, and as much again for its phases.
pub(super) const MOST: u64 = 4_000_000;
/// The maximum number of averaging times of all channels together in one result: some 5 MB of JSON.
const MOST_POINTS: usize = 40_000;
/// The maximum number of steps over samples for each averaging time of a channel: some seconds.
const MOST_STEPS: u64 = 2_000_000_000;
/// The maximum memory of the samples of one pass in bytes.
const MEMORY: usize = 64 << 20;
/// Version of the checkpoint.
const VERSION: u8 = 1;

/// The curves under computation.
#[derive(Debug)]
pub(super) struct Curves {
    plan: Plan,
    grid: TauGrid,
    estimator: Estimator,
    /// Channels of one pass.
    group: usize,
    /// Curves of the finished channels, in the plan's order.
    done: Vec<AllanCurve>,
    /// Stretches of the channels of this pass.
    current: VecDeque<Vec<Vec<f64>>>,
    /// The segment that the last sample taken in belongs to.
    open: Option<u32>,
}

impl Curves {
    /// Returns the state before any sample.
    pub(super) fn new(plan: Plan, parameters: &JobParameters) -> Result<Self, JobError> {
        let estimator = parameters.estimator;
        let grid = TauGrid::new(parameters.taus, plan.longest)?;
        let bytes = usize::try_from(plan.end_seq).unwrap_or(usize::MAX).saturating_mul(8);
        let group = (MEMORY / bytes.max(1)).clamp(1, plan.channels.len().max(1));
        let mut curves = Self { plan, grid, estimator, group, done: Vec::new(), current: VecDeque::new(), open: None };
        curves.begin_pass();
        Ok(curves)
    }

    /// Resumes after `next_seq` samples of the pass that `state` ([`Pass::save`]) contains; `None` if it is damaged.
    pub(super) fn restored(
        mut self,
        state: &[u8],
        next_seq: u64,
        source: &dyn SampleSource,
    ) -> Result<Option<Self>, JobError> {
        let Some(done) = decode(state).filter(|done| done.len() <= self.plan.channels.len()) else { return Ok(None) };
        self.done = done;
        self.begin_pass();
        let channels = self.read_channels().to_vec();
        let (plan, end) = (self.plan.clone(), if channels.is_empty() { 0 } else { next_seq });
        for chunk in plan.chunks(source, 0..end, &channels) {
            self.take(&chunk?);
        }
        Ok(Some(self))
    }

    fn begin_pass(&mut self) {
        self.open = None;
        self.current = self.read_channels().iter().map(|_| vec![Vec::new()]).collect();
    }

    /// Returns the plan, the estimator and every channel's curve, once the last pass has ended.
    pub(super) fn finish(self) -> (Plan, Estimator, Vec<(Channel, AllanCurve)>) {
        let curves = self.plan.channels.iter().copied().zip(self.done).collect();
        (self.plan, self.estimator, curves)
    }
}

impl Pass for Curves {
    fn plan(&self) -> Option<&Plan> {
        Some(&self.plan)
    }
    fn read_channels(&self) -> &[Channel] {
        self.plan.channels_after(self.done.len(), self.group)
    }
    fn take(&mut self, chunk: &Chunk) {
        let runs = self.plan.runs(chunk);
        for (stretches, column) in self.current.iter_mut().zip(&chunk.columns) {
            feed(
                stretches,
                &runs,
                column,
                self.open,
                |stretches, values| {
                    if let Some(last) = stretches.last_mut() {
                        last.extend_from_slice(values);
                    }
                },
                |stretches| {
                    if stretches.last().is_some_and(|last| !last.is_empty()) {
                        stretches.push(Vec::new());
                    }
                },
            );
        }
        if let Some((number, _)) = runs.last() {
            self.open = *number;
        }
    }
    fn work(&mut self) -> bool {
        let Some(channel) = self.read_channels().first().copied() else { return false };
        let Some(stretches) = self.current.pop_front() else { return false };
        let phases: Vec<Phases> = stretches.into_iter().filter_map(|values| Phases::integrate(&values)).collect();
        let curve = AllanCurve::from_phases(&phases, self.estimator, &self.grid, self.plan.rate_hz, channel.unit());
        self.done.push(curve);
        true
    }
    fn end_pass(&mut self) -> bool {
        let more = self.done.len() < self.plan.channels.len();
        if more {
            self.begin_pass();
        }
        more
    }
    /// Reading counts as a tenth.
    fn progress(&self, next_seq: u64, _end_seq: u64) -> f64 {
        let read = 0.1 * self.current.len() as f64 * next_seq as f64 / self.plan.end_seq.max(1) as f64;
        (self.done.len() as f64 + read) / self.plan.channels.len().max(1) as f64
    }
    fn save(&mut self) -> Result<Vec<u8>, JobError> {
        let done: Vec<Vec<u8>> = self.done.iter().map(serde_json::to_vec).collect::<Result<_, _>>()?;
        let mut bytes = vec![VERSION];
        bytes.extend(join(&done));
        Ok(bytes)
    }
    fn document(self: Box<Self>, reader: &Reader, _: &JobRow, _: &mut GoOn<'_>) -> Result<String, JobError> {
        let (plan, estimator, curves) = self.finish();
        let extent = Extent::of_plan(reader, &plan)?;
        Ok(serde_json::to_string(&report::curves(&plan, estimator, curves, &extent))?)
    }
}

/// Checks whether an `allan` job stays within the memory and time of a job. A caller that waits for the result may use
/// more.
pub(super) fn check(parameters: &JobParameters, plan: &Plan) -> Result<(), JobError> {
    let estimator = parameters.estimator;
    if estimator != Estimator::Oadev && plan.end_seq > MOST {
        let reason = format!(
            "{} samples are too many: {} holds a record in memory, up to {MOST} samples in a job; take the estimator \
             `oadev`, which has no such bound, or `vn100d allan --estimator {}`, which takes the memory it needs",
            plan.end_seq,
            estimator.name(),
            estimator.name()
        );
        return Err(JobError::InsufficientData(reason));
    }
    let grid = TauGrid::new(parameters.taus, plan.longest)?;
    let (factors, channels) = (grid.factors().len(), plan.channels.len());
    let too_many = factors * channels > MOST_POINTS || factors as u64 * plan.end_seq > MOST_STEPS;
    if parameters.taus == TauSpacing::All && too_many {
        let reason = format!(
            "{factors} averaging times of {channels} channels over {} samples are too many for a job: take `taus` `log` or \
             `octave`, or fewer `channels`, or `vn100d allan --taus all`",
            plan.end_seq
        );
        return Err(JobError::InsufficientData(reason));
    }
    Ok(())
}

fn decode(state: &[u8]) -> Option<Vec<AllanCurve>> {
    let (version, mut rest) = state.split_first()?;
    let done = split(&mut rest).filter(|_| *version == VERSION && rest.is_empty())?;
    done.iter().map(|bytes| serde_json::from_slice(bytes).ok()).collect()
}
