//! The interface between a job's computation and its runner: how a computation receives samples, and how its progress and
//! its checkpoints are stored.

use super::JobError;
use super::plan::Plan;
use crate::store::{Chunk, JobCheckpoint, JobRow, Reader};
use imu_core::sample::Channel;

/// The progress of a job over a long capture when its fold is done and disturbances are still to be searched for.
pub(super) const FOLDED: f64 = 0.4;
/// [`FOLDED`] if the search is done in one go.
pub(super) const FOLDED_SHORT: f64 = 0.9;

/// A computation that receives samples, in one pass over them or several.
pub(super) trait Pass {
    /// Returns the plan of the samples that this computation takes in; `None` if it takes in all samples of the
    /// capture.
    fn plan(&self) -> Option<&Plan>;

    /// Returns the channels to be read in this pass.
    fn read_channels(&self) -> &[Channel];

    /// Returns the next samples of this pass if they are held; otherwise they must be read.
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

    /// Returns the overall progress when this pass has reached `next_seq` of `end_seq`, 0–1.
    fn progress(&self, next_seq: u64, end_seq: u64) -> f64;

    /// Returns the state for a checkpoint: everything that continuing needs besides the samples.
    fn save(&mut self) -> Result<Vec<u8>, JobError>;

    /// Returns the result's text, once the last pass has ended; `go_on` receives the progress of the remaining work, and
    /// the state from which it continues.
    fn document(self: Box<Self>, reader: &Reader, job: &JobRow, go_on: &mut GoOn<'_>) -> Result<String, JobError>;
}

/// Receives the progress, 0–1, and a new state for a checkpoint, if there is one; an error ends the work.
pub(super) type GoOn<'a> = dyn FnMut(f64, Option<Vec<u8>>) -> Result<(), JobError> + 'a;

/// Stores the progress of a job. An error ends the work: [`JobError::CalledOff`] if the job is no longer wanted,
/// [`JobError::Stopped`] if it is to continue at the next start.
pub(super) trait Keeper: Send {
    /// Stores a checkpoint of the job.
    fn checkpoint(&mut self, checkpoint: JobCheckpoint, progress: f64) -> Result<(), JobError>;
    /// Stores the progress between checkpoints.
    fn progress(&mut self, progress: f64) -> Result<(), JobError>;
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
