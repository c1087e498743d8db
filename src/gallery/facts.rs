//! Facts: the contents of a capture's page apart from its pictures, from the database, as the interfaces' documents.

use super::{Documents, Picture, samples};
use crate::store::{CaptureRow, EventRow, GapRow, Page, PageRequest, Reader, StoreError};
use imu_core::sample::Channel;
use imu_noise::NoiseReport;
use imu_noise::datasheet::{Datasheet, FilterWindows, compare_report};
use serde_json::Value;
use std::collections::BTreeMap;

/// A spectrum needs at least this many samples without a gap.
const SPECTRUM_MIN: u64 = 256;
/// The datasheet that sensors are compared with, and the prefix of the models that it covers.
const DATASHEET: (&str, &str) = ("vn-100", "VN-100");

/// JSON documents of a capture.
#[derive(Debug, Clone)]
pub struct Facts {
    /// Its row.
    pub row: CaptureRow,
    /// The row with its accounting, as `GET /v1/captures/{id}` returns it.
    pub capture: String,
    /// Its gaps (the first thousand), a list.
    pub gaps: String,
    /// The number of missing samples by cause, an object.
    pub causes: String,
    /// Its events (the first thousand), a list.
    pub events: String,
    /// Samples of its longest segment.
    pub longest: u64,
}

impl Facts {
    /// Reads them.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn read(reader: &Reader, id: i64) -> Result<Self, StoreError> {
        let row = reader.capture(id)?;
        let gaps: Page<GapRow> = reader.gaps(id, &PageRequest::first())?;
        let events: Page<EventRow> = reader.events(id, &PageRequest::first())?;
        let mut capture = json(&row);
        capture["accounting"] = json(&reader.accounting(id)?);
        Ok(Self {
            row,
            capture: capture.to_string(),
            gaps: json(&gaps.rows).to_string(),
            causes: causes(reader, Some(id))?,
            longest: samples::stretches(reader, id)?.into_iter().max().unwrap_or(0),
            events: json(&events.rows).to_string(),
        })
    }

    /// The report with the datasheet beside it, unless the sensor is known to be another maker's.
    pub fn compared(&self, mut report: NoiseReport) -> NoiseReport {
        let model = self.row.sensor["model"].as_str().unwrap_or_default();
        let (sheet, family) = DATASHEET;
        let sheet = Datasheet::named(sheet).ok().filter(|_| model.is_empty() || model.starts_with(family));
        if let Some(sheet) = sheet {
            let windows = FilterWindows::of_configuration(&self.row.configuration);
            let compared = compare_report(&sheet, &report, windows).ok();
            report.datasheet = compared.and_then(|compared| serde_json::to_value(compared).ok());
        }
        report
    }

    /// The pictures that can be drawn from it and from the available analyses.
    pub fn pictures(&self, there: &Documents, noise: Option<&NoiseReport>) -> Vec<Picture> {
        let row = &self.row;
        let deviations = there.allan.as_deref().and_then(|text| serde_json::from_str::<Value>(text).ok());
        let deviates =
            |channel: &Channel| deviations.as_ref().is_some_and(|of| of["channels"].get(channel.name()).is_some());
        let drawn = |picture: &Picture| match picture {
            Picture::Gaps => row.samples > 1,
            Picture::Timeseries(_) => row.samples > 1,
            Picture::Histogram(_) => there.statistics.is_some() && row.samples > 1,
            Picture::Psd(_) => self.longest >= SPECTRUM_MIN,
            Picture::Allan(triad) => triad.channels().iter().any(deviates),
            Picture::AllanOfOne(channel) => deviates(channel),
            Picture::Hourly(channel) => {
                noise.and_then(|noise| noise.disturbances.get(channel)).is_some_and(|found| found.dynamic.is_some())
            }
        };
        let whole = |picture: &Picture| picture.channels().iter().all(|channel| row.channels.contains(channel));
        Picture::all(&row.channels).into_iter().filter(drawn).filter(whole).collect()
    }
}

/// Samples missing by cause, a JSON object; empty without a capture.
///
/// # Errors
/// The error that the database reports.
pub fn causes(reader: &Reader, capture: Option<i64>) -> Result<String, StoreError> {
    let causes = match capture {
        Some(id) => reader.missing_by_cause(id)?,
        None => BTreeMap::new(),
    };
    Ok(json(&causes).to_string())
}

/// The store's own rows cannot fail here: they are numbers and texts.
fn json(rows: &impl serde::Serialize) -> Value {
    serde_json::to_value(rows).unwrap_or_default()
}
