//! The computations of a job over samples: four folds with a common interface.

use super::curves::{Curves, check};
use super::distribution::Distribution;
use super::motion::{AtRest, at_rest};
use super::plan::Plan;
use super::runner::{FOLDED, FOLDED_SHORT};
use super::spectra::Spectra;
use super::sums::Summation;
use super::{JobError, JobKind, JobParameters, SampleSource, together};
use crate::store::{Chunk, JobRow, Reader, StoreError};
use imu_core::sample::Channel;
use imu_noise::allan::Estimator;

/// A computation in progress.
#[derive(Debug)]
pub(super) enum Fold {
    /// Allan sums, for `allan`.
    Sums(Box<Summation>),
    /// Deviation curves of stretches in memory, for `allan` with another estimator.
    Curves(Box<Curves>),
    /// Spectral sums, for `noise`.
    Spectra(Box<Spectra>),
    /// Moments and histograms, for `statistics`.
    Distribution(Distribution),
}

impl Fold {
    /// The job's computation at its last checkpoint, and the next `seq` it needs.
    pub(super) fn begin(
        reader: &Reader,
        job: &JobRow,
        kind: JobKind,
        parameters: &JobParameters,
        go_on: impl FnMut() -> Result<(), JobError>,
    ) -> Result<(Self, u64), JobError> {
        let checkpoint = reader.checkpoint(job.id)?;
        let next_seq = checkpoint.as_ref().map_or(0, |checkpoint| checkpoint.next_seq);
        let state = checkpoint.as_ref().map(|checkpoint| checkpoint.state.as_slice());
        let damaged = || JobError::Checkpoint { job: job.id };
        let plan = || -> Result<Plan, JobError> {
            let wanted = parameters.channels.clone().unwrap_or_else(|| Channel::ANALYSED.to_vec());
            let captures = together::captures(reader, job.capture, job.end_seq, &parameters.with)?;
            together::plan(reader, &captures, &wanted)
        };
        let fold = match kind {
            JobKind::Allan if parameters.estimator != Estimator::Oadev => {
                let plan = plan()?;
                check(parameters, &plan)?;
                let AtRest { plan, .. } = at_rest(reader, plan, false, go_on)?;
                let next_seq = next_seq.min(plan.end_seq);
                Self::Curves(Box::new(match state {
                    Some(state) => Curves::restore(plan, parameters, state, next_seq, reader)?.ok_or_else(damaged)?,
                    None => Curves::new(plan, parameters)?,
                }))
            }
            JobKind::Allan => {
                let plan = plan()?;
                check(parameters, &plan)?;
                let AtRest { plan, .. } = at_rest(reader, plan, false, go_on)?;
                let next_seq = next_seq.min(plan.end_seq);
                Self::Sums(Box::new(match state {
                    Some(state) => {
                        Summation::restore(plan, parameters, state, next_seq, reader)?.ok_or_else(damaged)?
                    }
                    None => Summation::new(plan, parameters)?,
                }))
            }
            JobKind::Noise => {
                let at_rest = at_rest(reader, plan()?, state.is_none(), go_on)?;
                let next_seq = next_seq.min(at_rest.plan.end_seq);
                Self::Spectra(Box::new(match state {
                    Some(state) => Spectra::restore(at_rest.plan, state, next_seq, reader)?.ok_or_else(damaged)?,
                    None => Spectra::of(at_rest),
                }))
            }
            JobKind::Statistics => {
                let capture = reader.capture(job.capture)?;
                let mut channels = parameters.channels.clone().unwrap_or(capture.channels.clone());
                channels.retain(|channel| capture.channels.contains(channel));
                if job.end_seq == 0 || channels.is_empty() {
                    let reason = format!("capture {} has no samples of these channels yet", job.capture);
                    return Err(JobError::InsufficientData { reason });
                }
                Self::Distribution(match state {
                    Some(state) => Distribution::restore(channels, state).ok_or_else(damaged)?,
                    None => Distribution::new(channels),
                })
            }
            // It takes all samples at once: `diagnosis` is its room.
            JobKind::Diagnosis => {
                return Err(JobError::InsufficientData { reason: "a diagnosis is no fold".to_owned() });
            }
        };
        let end_seq = fold.end_seq(job);
        Ok((fold, next_seq.min(end_seq)))
    }

    fn pass(&self) -> &dyn Pass {
        match self {
            Self::Sums(summation) => &**summation,
            Self::Curves(curves) => &**curves,
            Self::Spectra(spectra) => &**spectra,
            Self::Distribution(distribution) => distribution,
        }
    }

    /// The computation as a [`Pass`], to take samples in.
    pub(super) fn pass_mut(&mut self) -> &mut dyn Pass {
        match self {
            Self::Sums(summation) => &mut **summation,
            Self::Curves(curves) => &mut **curves,
            Self::Spectra(spectra) => &mut **spectra,
            Self::Distribution(distribution) => distribution,
        }
    }

    /// The number of samples in a pass.
    pub(super) fn end_seq(&self, job: &JobRow) -> u64 {
        self.pass().plan().map_or(job.end_seq, |plan| plan.end_seq)
    }

    /// The next samples of this pass, at most `limit`.
    pub(super) fn read_chunk(
        &self,
        source: &dyn SampleSource,
        job: &JobRow,
        next_seq: u64,
        limit: usize,
    ) -> Result<Chunk, StoreError> {
        if let Some(chunk) = self.pass().held_chunk(next_seq, limit) {
            return Ok(chunk);
        }
        let channels = self.pass().read_channels();
        let chunk = match self.pass().plan() {
            Some(plan) => plan.read_chunk(source, next_seq, limit, channels)?,
            None => source.read_chunk(job.capture, next_seq, limit, channels)?,
        };
        if chunk.is_empty() {
            return Err(StoreError::NoSuchCapture { asked: job.capture.to_string() });
        }
        Ok(chunk)
    }

    /// The overall progress when this pass has reached `next_seq` of `end_seq`, 0–1.
    pub(super) fn progress(&self, next_seq: u64, end_seq: u64) -> f64 {
        match self {
            Self::Sums(summation) => summation.progress(next_seq),
            Self::Curves(curves) => curves.progress(next_seq),
            Self::Spectra(spectra) => {
                let folded = if spectra.is_long() { FOLDED } else { FOLDED_SHORT };
                folded * spectra.progress(next_seq)
            }
            Self::Distribution(_) => next_seq as f64 / end_seq.max(1) as f64,
        }
    }

    /// The state for a checkpoint.
    pub(super) fn save(&mut self) -> Result<Vec<u8>, JobError> {
        Ok(match self {
            Self::Sums(summation) => summation.save(),
            Self::Curves(curves) => curves.save()?,
            Self::Spectra(spectra) => spectra.save(),
            Self::Distribution(distribution) => distribution.save(),
        })
    }
}

/// A computation that receives samples, in one pass over them or several.
pub(super) trait Pass {
    /// The samples it takes in; `None` if these are all samples of the capture.
    fn plan(&self) -> Option<&Plan>;

    /// The channels to be read in this pass.
    fn read_channels(&self) -> &[Channel];

    /// The next samples of this pass if they are held; otherwise they must be read.
    fn held_chunk(&self, _from: u64, _limit: usize) -> Option<Chunk> {
        None
    }

    /// Takes in the next samples of this pass.
    fn take(&mut self, chunk: &Chunk);

    /// Does a part of the computation after a pass has all its samples; returns `false` if nothing is left.
    fn work(&mut self) -> bool {
        false
    }

    /// Ends a pass over the samples; returns whether another one is needed.
    fn end_pass(&mut self) -> bool {
        false
    }
}

impl Pass for Summation {
    fn plan(&self) -> Option<&Plan> {
        Some(self.plan())
    }
    fn read_channels(&self) -> &[Channel] {
        self.pass_channels()
    }
    fn take(&mut self, chunk: &Chunk) {
        self.take(chunk);
    }
    fn end_pass(&mut self) -> bool {
        self.end_pass()
    }
}

impl Pass for Curves {
    fn plan(&self) -> Option<&Plan> {
        Some(self.plan())
    }
    fn read_channels(&self) -> &[Channel] {
        self.pass_channels()
    }
    fn take(&mut self, chunk: &Chunk) {
        self.take(chunk);
    }
    fn work(&mut self) -> bool {
        self.work()
    }
    fn end_pass(&mut self) -> bool {
        self.end_pass()
    }
}

impl Pass for Spectra {
    fn plan(&self) -> Option<&Plan> {
        Some(self.plan())
    }
    fn read_channels(&self) -> &[Channel] {
        self.read_channels()
    }
    fn held_chunk(&self, from: u64, limit: usize) -> Option<Chunk> {
        self.held_chunk(from, limit)
    }
    fn take(&mut self, chunk: &Chunk) {
        self.take(chunk);
    }
    fn end_pass(&mut self) -> bool {
        self.end_pass()
    }
}

impl Pass for Distribution {
    fn plan(&self) -> Option<&Plan> {
        None
    }
    fn read_channels(&self) -> &[Channel] {
        self.channels()
    }
    fn take(&mut self, chunk: &Chunk) {
        self.take(chunk);
    }
}

/// Joins byte strings, each preceded by its length.
pub(super) fn join(entries: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = (entries.len() as u32).to_le_bytes().to_vec();
    for entry in entries {
        bytes.extend((entry.len() as u32).to_le_bytes());
        bytes.extend(entry);
    }
    bytes
}

/// Splits off what [`join`] has written; `None` if it is damaged.
pub(super) fn split(rest: &mut &[u8]) -> Option<Vec<Vec<u8>>> {
    let number = |rest: &mut &[u8]| -> Option<usize> {
        let (bytes, tail) = rest.split_first_chunk::<4>()?;
        *rest = tail;
        usize::try_from(u32::from_le_bytes(*bytes)).ok()
    };
    let count = number(rest)?;
    let mut entries = Vec::new();
    for _ in 0..count {
        let length = number(rest)?;
        let (entry, tail) = rest.split_at_checked(length)?;
        entries.push(entry.to_vec());
        *rest = tail;
    }
    Some(entries)
}
