//! References of commands: the sensor's motion, poses, or rates about one axis, read from a file.

use crate::jobs::{ReferenceAxis, read_reference};
use anyhow::Context as _;
use imu_diagnosis::Known;
use std::fs::File;
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;

/// Maximum number of bytes of a reference, unpacked: a packed file does not state how long it is.
const REFERENCE_BYTES: u64 = 1 << 30;

/// Reads the reference: the sensor's motion, poses, or rates about one axis.
pub(super) fn reference(path: &Path, axis: Option<ReferenceAxis>) -> anyhow::Result<Known> {
    let found = read_reference(&reference_text(path)?, &path.display().to_string(), axis);
    found.map_err(|reason| anyhow::anyhow!("the reference {} cannot be used: {reason}", path.display()))
}

/// Reads the text of a reference; gzip is unpacked.
pub(super) fn reference_text(path: &Path) -> anyhow::Result<String> {
    let name = path.display().to_string();
    let mut file = BufReader::new(File::open(path).with_context(|| format!("the reference {name} cannot be read"))?);
    anyhow::ensure!(!file.get_ref().metadata()?.is_dir(), "the reference {name} is a folder: expected a CSV file");
    let mut text = String::new();
    let read = match file.fill_buf()?.starts_with(&[0x1f, 0x8b]) {
        true => flate2::bufread::MultiGzDecoder::new(file).take(REFERENCE_BYTES + 1).read_to_string(&mut text),
        false => file.take(REFERENCE_BYTES + 1).read_to_string(&mut text),
    };
    read.with_context(|| format!("the reference {name} cannot be read as text"))?;
    anyhow::ensure!(
        text.len() as u64 <= REFERENCE_BYTES,
        "the reference {name} has more than {} MiB of text: cut it",
        REFERENCE_BYTES >> 20
    );
    Ok(text)
}
