//! `vn100d worker`: one piece of heavy work in a separate process, which the daemon starts and reads over a pipe.

use super::Outcome;
use super::args::{Work, WorkerArgs};
use crate::daemon::import;
use crate::process::{Confinement, confine};
use crate::{gallery, jobs};
use anyhow::Context as _;

/// Does the work within its limits, and writes frames to standard output.
pub(super) fn run(args: &WorkerArgs) -> anyhow::Result<Outcome> {
    confine(Confinement { memory_bytes: args.memory, processor_s: args.processor_s, parent: args.parent })
        .context("the limits cannot be set")?;
    let out = std::io::BufWriter::new(std::io::stdout());
    match &args.work {
        Work::Png => gallery::apart::answer(std::io::stdin().lock(), out)?,
        Work::DiagnosisBody { file } => jobs::answer_diagnosis_body(file, out)?,
        Work::Import => import::answer(std::io::stdin().lock(), out)?,
        Work::Job { id, database, file } => jobs::answer(database, file, *id, out)?,
    }
    Ok(Outcome::Done)
}
