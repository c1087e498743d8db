//! Calibration on the command line: chance findings in records like this one, computed once and cached.

use super::progress::bar;
use crate::jobs::TwoThreads;
use crate::store::SOFTWARE;
use anyhow::Context as _;
use imu_diagnosis::Recording;
use imu_diagnosis::calibration::{Nulls, RECORDS};
use imu_diagnosis::prepare;
use imu_diagnosis::prices::Tails;
use imu_model::simulator::SensorModel;
use sha2::{Digest as _, Sha256};
use std::io::Write as _;
use std::path::PathBuf;

/// Returns the tails for a recording and a model: from the cache, or from [`RECORDS`] simulated records, with the same
/// result.
pub(super) fn tails(real: &Recording, sim: &SensorModel) -> anyhow::Result<Tails> {
    // Incomparable inputs are refused before anything is simulated.
    prepare::prepare(real, sim)?;
    let nulls = Nulls::of(real, sim);
    let file = folder().map(|folder| folder.join(format!("null-{}.json", &name(&nulls)[..24])));
    // A file that cannot be read, or that another version wrote, is made again.
    let kept = file.as_ref().and_then(|file| std::fs::read(file).ok());
    let tails = kept.and_then(|bytes| serde_json::from_slice::<Tails>(&bytes).ok());
    if let Some(tails) = tails.filter(Tails::is_whole) {
        return Ok(tails);
    }
    let bar = bar("{bar:30} {pos} of {len} records of noise alone · {eta} left", RECORDS as u64);
    let each = |done: usize| {
        bar.set_position(done as u64);
        true
    };
    let tails = nulls.tails(RECORDS, &TwoThreads, &each)?.context("the calibration was stopped")?;
    bar.finish_and_clear();
    if let Some(file) = file
        && let Err(error) = keep(&file, &tails)
    {
        eprintln!("the calibration is not kept for the next time: {}: {error}", file.display());
    }
    Ok(tails)
}

/// Returns the digest of everything on which the tails depend.
fn name(nulls: &Nulls) -> String {
    let mut digest = Sha256::new();
    // Another table changes the search.
    digest.update(format!("{:?}", Tails::shipped(nulls.samples)));
    digest
        .update(format!("{SOFTWARE} {RECORDS} {} {} {:?} {}", nulls.samples, nulls.rate_hz, nulls.levels, nulls.seed));
    for value in nulls.temperature_c.iter().flatten() {
        digest.update(value.to_le_bytes());
    }
    digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns `$XDG_CACHE_HOME/vn100d`, else `~/.cache/vn100d`.
fn folder() -> Option<PathBuf> {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let cache = absolute("XDG_CACHE_HOME").or_else(|| Some(absolute("HOME")?.join(".cache")))?;
    Some(cache.join("vn100d"))
}

/// Writes the file completely or not at all.
fn keep(file: &std::path::Path, tails: &Tails) -> std::io::Result<()> {
    let folder = file.parent().unwrap_or(file);
    std::fs::create_dir_all(folder)?;
    let mut new = tempfile::NamedTempFile::new_in(folder)?;
    new.write_all(&serde_json::to_vec(tails)?)?;
    new.persist(file).map_err(|error| error.error)?;
    Ok(())
}
