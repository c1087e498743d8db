//! Facts: the content of a capture's page apart from its analyses, and the pictures that can be drawn of it.

use super::{Picture, samples};
use crate::jobs::Documents;
use crate::page::Facts;
use crate::store::{PageRequest, Reader, StoreError};
use imu_core::sample::Channel;

/// A spectrum needs at least this many samples without a gap.
const SPECTRUM_MIN: u64 = 256;

/// Reads the facts about a capture: of gaps and events the first thousand.
///
/// # Errors
/// The error that the database reports.
pub fn facts(reader: &Reader, id: i64) -> Result<Facts, StoreError> {
    let first = PageRequest::first();
    Ok(Facts {
        row: reader.capture(id)?,
        accounting: reader.accounting(id)?,
        gaps: reader.gaps(id, &first)?.rows,
        causes: reader.missing_by_cause(id)?,
        events: reader.events(id, &first)?.rows,
        longest: samples::stretches(reader, id)?.into_iter().max().unwrap_or(0),
    })
}

/// Returns the pictures that can be drawn of a capture and its analyses.
pub fn pictures(facts: &Facts, documents: &Documents) -> Vec<Picture> {
    let row = &facts.row;
    let deviates =
        |channel: &Channel| documents.allan.as_ref().is_some_and(|report| report.channels.contains_key(channel));
    let disturbances = |channel: &Channel| documents.noise.as_ref().and_then(|report| report.disturbances.get(channel));
    let drawn = |picture: &Picture| match picture {
        Picture::Gaps | Picture::Timeseries(_) => row.samples > 1,
        Picture::Histogram(_) => documents.statistics.is_some() && row.samples > 1,
        Picture::Psd(_) => facts.longest >= SPECTRUM_MIN,
        Picture::Allan(triad) => triad.channels().iter().any(deviates),
        Picture::AllanOfOne(channel) => deviates(channel),
        Picture::Hourly(channel) => disturbances(channel).is_some_and(|found| found.dynamic.is_some()),
    };
    let whole = |picture: &Picture| picture.channels().iter().all(|channel| row.channels.contains(channel));
    Picture::all(&row.channels).into_iter().filter(drawn).filter(whole).collect()
}
