//! Captures: creation, changes, lists and deletion.

use super::error::{changed_one, no_such};
use super::names::{NAME_MAX, as_id, check_name, check_note, free_name, numbered, pin};
use super::sql::{find, run, value};
use super::{Page, PageRequest, Reader, SOFTWARE, Store, StoreError, UtcNs};
use imu_core::sample::{CaptureConfiguration, Channel, DiscardCause, SensorDescription};
use rusqlite::types::Value as Sql;
use rusqlite::{Connection, ErrorCode, Row, Transaction, params, params_from_iter};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::str::FromStr;
use std::time::Duration;

/// Rows deleted in one transaction: a few tens of ms, so that the writer is free in between.
const DELETE_ROWS: i64 = 4000;

/// The state of a capture (docs/formats.md).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum CaptureState {
    /// The capture begins at a set time.
    #[default]
    Waiting,
    /// The capture is running, or continues when the daemon starts.
    Capturing,
    /// The capture has its planned duration.
    Complete,
    /// A user stopped the capture.
    Stopped,
    /// The samples were imported from a file.
    Imported,
    /// The samples are from a simulator.
    Simulated,
}

impl CaptureState {
    /// Returns the name in the database and JSON.
    pub fn name(self) -> &'static str {
        self.into()
    }
    /// Returns whether samples may still arrive.
    pub fn is_open(self) -> bool {
        matches!(self, Self::Waiting | Self::Capturing)
    }
}

/// A channel of a capture.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ChannelRow {
    /// The channel.
    #[serde(skip)]
    pub channel: Option<Channel>,
    /// Unit of the stored values.
    pub unit: String,
    /// Smallest step that was sent, in `unit`, if known (the decimals of ASCII messages).
    pub resolution: Option<f64>,
    /// Unit of an imported recording, if it was another.
    pub original_unit: Option<String>,
    /// stored = original × factor.
    pub factor: Option<f64>,
}

impl ChannelRow {
    /// Returns a channel that was converted at import: stored = original × `factor`.
    pub fn converted(channel: Channel, original_unit: &str, factor: f64) -> Self {
        Self { original_unit: Some(original_unit.to_owned()), factor: Some(factor), ..Self::plain(channel) }
    }
    /// Returns a channel stored as it was sent, of unknown resolution.
    pub fn plain(channel: Channel) -> Self {
        Self {
            channel: Some(channel),
            unit: channel.unit().to_owned(),
            resolution: None,
            original_unit: None,
            factor: None,
        }
    }
}

/// A capture to be created.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct NewCapture {
    /// Its name.
    pub name: Option<String>,
    /// Used if there is no name: this name if it is valid, with a number if it is taken, else a name made from the time.
    pub liked_name: Option<String>,
    /// A note about it.
    pub note: Option<String>,
    /// The source of its samples: a port, a file or `simulator`.
    pub source: String,
    /// Its initial state.
    pub state: CaptureState,
    /// The sample time to record.
    pub planned: Option<Duration>,
    /// The planned start, UTC ns.
    pub start_at_utc_ns: Option<i64>,
    /// The actual start, UTC ns; its first sample's time if absent.
    pub started_utc_ns: Option<i64>,
    /// Whether the rate was assumed because the source does not state it.
    pub rate_assumed: bool,
    /// A description of the sensor, if one is known already.
    pub sensor: Option<SensorDescription>,
    /// The sensor's configuration.
    pub configuration: Option<CaptureConfiguration>,
    /// Channels of which more than the unit is known.
    pub channels: Vec<ChannelRow>,
    /// Identifies the request: a repeated request returns the capture that the first one made ([`Store::withdraw`]).
    pub token: Option<String>,
}

impl NewCapture {
    /// Creates a capture from `source` in `state`, with nothing else set.
    pub fn new(source: &str, state: CaptureState) -> Self {
        Self { source: source.to_owned(), state, ..Self::default() }
    }
}

/// A capture as the interfaces show it (docs/formats.md).
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct CaptureRow {
    /// Its id, which is never used again.
    pub id: i64,
    /// Its name; unique.
    pub name: String,
    /// What somebody wrote about it; null if nothing.
    pub note: Option<String>,
    /// The source of its samples: a port, a file or `simulator`.
    pub source: String,
    /// Its state.
    pub state: CaptureState,
    /// The time of its creation.
    pub created_at: UtcNs,
    /// The planned start of a waiting capture.
    pub start_at: Option<UtcNs>,
    /// The time of its start; null before.
    pub started_at: Option<UtcNs>,
    /// The time of its end; null before.
    pub ended_at: Option<UtcNs>,
    /// The planned sample time, s.
    pub planned_duration_s: Option<f64>,
    /// Sample time so far, received and missing, s.
    pub duration_s: f64,
    /// Output rate of its first segment in Hz; null before the first segment.
    pub rate_hz: Option<f64>,
    /// Whether the rate was assumed because the source does not state it.
    pub rate_assumed: bool,
    /// Number of samples received.
    pub samples: u64,
    /// Number of samples missing.
    pub missing: u64,
    /// Number of gaps.
    pub gaps: u64,
    /// Number of segments.
    pub segments: u64,
    /// Received data that did not become samples, by cause.
    pub rejected: BTreeMap<String, u64>,
    /// Whether it is kept from deletion.
    pub pinned: bool,
    /// The earliest time at which it is deleted to stay within the limits of `[storage]`; null if it is kept.
    pub delete_at: Option<UtcNs>,
    /// Its channels, in column order.
    pub channels: Vec<Channel>,
    /// Unit, resolution and conversion of each channel.
    pub units: BTreeMap<String, ChannelRow>,
    /// The sensor; an empty object if nothing is known.
    #[schema(value_type = Object)]
    pub sensor: SensorDescription,
    /// The sensor's configuration; an empty object if nothing is known.
    #[schema(value_type = Object)]
    pub configuration: CaptureConfiguration,
    /// The software that made it.
    pub software: String,
}

impl CaptureRow {
    /// Returns whether anything was rejected during the capture. Data from before its start or after its end is no loss
    /// of its samples.
    pub fn has_rejected(&self) -> bool {
        let apart = [DiscardCause::Probing, DiscardCause::AfterEnd].map(DiscardCause::name);
        self.rejected.iter().any(|(cause, count)| *count > 0 && !apart.contains(&cause.as_str()))
    }
}

impl Store {
    /// Creates a capture and returns its id.
    ///
    /// # Errors
    /// [`StoreError::NameTaken`], [`StoreError::NameRefused`], [`StoreError::NoteRefused`], or the error that the
    /// database reports.
    pub fn create_capture(&self, mut capture: NewCapture) -> Result<i64, StoreError> {
        if let Some(name) = &capture.name {
            check_name(name)?;
        }
        capture.note = capture.note.map_or(Ok(None), |note| check_note(&note))?;
        let utc_ns = self.utc_ns();
        self.execute(move |transaction| create(transaction, &capture, utc_ns, "live", None))
    }

    /// Withdraws a request to make a capture whose outcome is unknown. The capture with this token, if it was made and
    /// has no samples, is deleted.
    ///
    /// # Errors
    /// The error that the database reports; the request may be repeated.
    pub fn withdraw(&self, token: &str) -> Result<(), StoreError> {
        let token = token.to_owned();
        self.execute(move |transaction| {
            let sql = "UPDATE capture SET lifecycle = 'deleted', state = 'stopped' WHERE token = ?1 AND samples = 0";
            transaction.execute(sql, [token])?;
            Ok(())
        })
    }

    /// Sets the capture's state; `utc_ns` becomes its start (`Capturing`, if it has none) or its end.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or the error that the database reports.
    pub fn set_state(&self, id: i64, state: CaptureState, utc_ns: i64) -> Result<(), StoreError> {
        self.execute(move |transaction| {
            let sql = match state {
                CaptureState::Waiting => "UPDATE capture SET state = ?2 WHERE id = ?1 AND ?3 IS NOT NULL",
                CaptureState::Capturing => {
                    "UPDATE capture SET state = ?2, started_utc_ns = coalesce(started_utc_ns, ?3), \
                     ended_utc_ns = NULL WHERE id = ?1"
                }
                _ => "UPDATE capture SET state = ?2, ended_utc_ns = coalesce(ended_utc_ns, ?3) WHERE id = ?1",
            };
            changed_one(id, transaction.execute(sql, params![id, state.name(), utc_ns])?)
        })
    }

    /// Sets whether the capture is protected from deletion.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or the error that the database reports.
    pub fn pin(&self, id: i64, pinned: bool) -> Result<(), StoreError> {
        self.execute(move |transaction| pin(transaction, id, pinned))
    }

    /// Deletes a capture. It disappears from every list at once and its jobs are cancelled; its rows are removed in
    /// small steps with [`Self::purge_step`].
    ///
    /// # Errors
    /// [`StoreError::NotDeletable`] for one that runs, waits or is pinned; [`StoreError::NoSuchCapture`].
    pub fn delete_capture(&self, id: i64) -> Result<(), StoreError> {
        self.execute(move |transaction| {
            let sql = "SELECT state, pinned FROM capture WHERE id = ?1 AND lifecycle = 'live'";
            let found = find(transaction, sql, [id], |row| Ok((row.get::<_, String>(0)?, row.get::<_, bool>(1)?)))?;
            let Some((state, pinned)) = found else { return Err(no_such(id)) };
            let why = match state.as_str() {
                "capturing" => Some("running"),
                "waiting" => Some("waiting"),
                _ if pinned => Some("pinned"),
                _ => None,
            };
            if let Some(why) = why {
                return Err(StoreError::NotDeletable { id, why });
            }
            let sql = "UPDATE job SET state = 'cancelled' WHERE capture_id = ?1 AND state IN ('queued', 'running')";
            transaction.execute(sql, [id])?;
            transaction.execute("UPDATE capture SET lifecycle = 'deleted' WHERE id = ?1", [id])?;
            Ok(())
        })
    }

    /// Removes some rows of deleted captures, or of references that were deleted with them, in one transaction of some
    /// tens of milliseconds. Returns whether more remain.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn purge_step(&self) -> Result<bool, StoreError> {
        self.execute(|transaction| {
            let sql = "SELECT id FROM capture WHERE lifecycle = 'deleted' ORDER BY id LIMIT 1";
            let found: Option<i64> = find(transaction, sql, [], |row| row.get(0))?;
            let Some(id) = found else { return Self::purge_reference(transaction) };
            let sql = "DELETE FROM sample WHERE capture_id = ?1 AND seq < \
                       (SELECT min(seq) FROM sample WHERE capture_id = ?1) + ?2";
            let deleted = run(transaction, sql, params![id, DELETE_ROWS])?;
            if deleted > 0 {
                return Ok(true);
            }
            let sql = "DELETE FROM batch WHERE capture_id = ?1 AND first_seq IN \
                       (SELECT first_seq FROM batch WHERE capture_id = ?1 ORDER BY first_seq LIMIT ?2)";
            let batches = transaction.execute(sql, params![id, DELETE_ROWS])?;
            if batches > 0 {
                return Ok(true);
            }
            for table in ["gap", "event", "configuration", "result", "job"] {
                let key = match table {
                    "gap" | "event" | "configuration" => format!("{table}_id"),
                    _ => "id".to_owned(),
                };
                let sql = format!(
                    "DELETE FROM {table} WHERE {key} IN (SELECT {key} FROM {table} WHERE capture_id = ?1 LIMIT ?2)"
                );
                if transaction.execute(&sql, params![id, DELETE_ROWS])? > 0 {
                    return Ok(true);
                }
            }
            transaction.execute("DELETE FROM capture WHERE id = ?1", [id])?;
            Ok(true)
        })
    }
}

/// Settles unfinished work of the last run: unfinished imports are removed step by step, and interrupted jobs continue.
pub(super) fn tidy_after_start(connection: &mut Connection) -> Result<(), StoreError> {
    connection.execute("UPDATE capture SET lifecycle = 'deleted' WHERE lifecycle = 'importing'", [])?;
    connection.execute("UPDATE job SET state = 'queued' WHERE state = 'running'", [])?;
    // A reference that was still being stored when the program ended has no job, and is removed.
    connection.execute("UPDATE reference SET claimed = 1 WHERE claimed = 0", [])?;
    super::utc::close_all(connection)
}

/// Inserts the capture. Without a usable name it is named after the time, `2026-11-21T20-00-00Z`. A name that was not
/// given gets a number if it is taken, `…-2`.
pub(super) fn create(
    transaction: &Transaction<'_>,
    capture: &NewCapture,
    utc_ns: i64,
    lifecycle: &str,
    fingerprint: Option<&str>,
) -> Result<i64, StoreError> {
    if let Some(token) = &capture.token {
        let sql = "SELECT id FROM capture WHERE token = ?1";
        let made = find(transaction, sql, [token], |row| row.get(0))?;
        if let Some(id) = made {
            return Ok(id);
        }
    }
    let name = match &capture.name {
        Some(name) => name.clone(),
        None => match capture.liked_name.as_ref().filter(|name| check_name(name).is_ok()) {
            Some(name) => numbered(transaction, name)?,
            None => free_name(transaction, capture.start_at_utc_ns.unwrap_or(utc_ns))?,
        },
    };
    let rows = transaction.execute(
        "INSERT INTO capture (name, source, state, lifecycle, created_utc_ns, start_at_utc_ns, planned_duration_ns, \
         started_utc_ns, rate_assumed, sensor, configuration, software, fingerprint, token, note, received) \
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, 0)",
        params![
            name,
            capture.source,
            capture.state.name(),
            lifecycle,
            utc_ns,
            capture.start_at_utc_ns,
            capture.planned.map(|planned| planned.as_nanos() as i64),
            capture.started_utc_ns,
            capture.rate_assumed,
            capture.sensor.as_ref().map(SensorDescription::to_string),
            capture.configuration.as_ref().map(CaptureConfiguration::to_string),
            SOFTWARE,
            fingerprint,
            capture.token,
            capture.note,
        ],
    );
    match rows {
        Err(error) if error.sqlite_error_code() == Some(ErrorCode::ConstraintViolation) => {
            return Err(if error.to_string().contains("capture.name") {
                StoreError::NameTaken(name)
            } else {
                error.into()
            });
        }
        other => other?,
    };
    let id = transaction.last_insert_rowid();
    for row in &capture.channels {
        let Some(channel) = row.channel else { continue };
        let sql = "INSERT INTO channel (capture_id, channel, unit, resolution, original_unit, factor) \
                   VALUES (?1, ?2, ?3, ?4, ?5, ?6)";
        let values = params![id, channel.name(), row.unit, row.resolution, row.original_unit, row.factor];
        transaction.execute(sql, values)?;
    }
    Ok(id)
}

pub(super) const CAPTURE_COLUMNS: &str = "id, name, source, state, created_utc_ns, start_at_utc_ns, started_utc_ns, ended_utc_ns, \
    planned_duration_ns, sample_time_ns, rate_hz, rate_assumed, samples, missing, gaps, segments, \
    (SELECT json_group_object(cause, count) FROM rejected WHERE capture_id = capture.id), pinned, \
    (SELECT json_group_array(json_array(channel, unit, resolution, original_unit, factor)) \
        FROM channel WHERE capture_id = capture.id), sensor, configuration, software, delete_at_utc_ns, note";

pub(super) fn capture_of(row: &Row<'_>) -> Result<CaptureRow, StoreError> {
    type Raw = (String, String, Option<f64>, Option<String>, Option<f64>);
    let count = |index| row.get::<_, i64>(index).map(|count| count as u64);
    let time = |index| row.get::<_, Option<i64>>(index).map(|ns| ns.map(UtcNs));
    let channels: Vec<Raw> = serde_json::from_str(&row.get::<_, String>(18)?)?;
    let mut units = BTreeMap::new();
    let mut names = Vec::new();
    for (name, unit, resolution, original_unit, factor) in channels {
        let channel = known("channel.channel", name.clone())?;
        names.push(channel);
        units.insert(name, ChannelRow { channel: Some(channel), unit, resolution, original_unit, factor });
    }
    names.sort_unstable();
    Ok(CaptureRow {
        id: row.get(0)?,
        name: row.get(1)?,
        note: row.get(23)?,
        source: row.get(2)?,
        state: known("capture.state", row.get(3)?)?,
        created_at: UtcNs(row.get(4)?),
        start_at: time(5)?,
        started_at: time(6)?,
        ended_at: time(7)?,
        planned_duration_s: row.get::<_, Option<i64>>(8)?.map(seconds),
        duration_s: seconds(row.get(9)?),
        rate_hz: row.get(10)?,
        rate_assumed: row.get(11)?,
        samples: count(12)?,
        missing: count(13)?,
        gaps: count(14)?,
        segments: count(15)?,
        rejected: serde_json::from_str(&row.get::<_, String>(16)?)?,
        pinned: row.get(17)?,
        delete_at: time(22)?,
        channels: names,
        units,
        sensor: json_of(row, 19)?.unwrap_or_default(),
        configuration: json_of(row, 20)?.unwrap_or_default(),
        software: row.get(21)?,
    })
}

fn seconds(ns: i64) -> f64 {
    ns as f64 / 1e9
}

pub(super) fn json_of<T: DeserializeOwned>(row: &Row<'_>, index: usize) -> Result<Option<T>, StoreError> {
    let text: Option<String> = row.get(index)?;
    Ok(text.map(|text| serde_json::from_str(&text)).transpose()?)
}

/// Reads a name that this program knows.
pub(super) fn known<T: FromStr>(column: &'static str, found: String) -> Result<T, StoreError> {
    found.parse().map_err(|_| StoreError::Unknown { column, found })
}

impl Reader {
    /// Returns the id of `latest` (the capture made last), of an id, or of a name.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or the error that the database reports.
    pub fn resolve(&self, asked: &str) -> Result<i64, StoreError> {
        let (sql, key) = if asked == "latest" {
            ("SELECT max(id) FROM capture WHERE lifecycle = 'live' AND ?1 IS NOT NULL", Sql::Integer(0))
        } else if let Some(id) = as_id(asked) {
            ("SELECT id FROM capture WHERE lifecycle = 'live' AND id = ?1", Sql::Integer(id))
        } else {
            ("SELECT id FROM capture WHERE lifecycle = 'live' AND name = ?1", Sql::Text(asked.to_owned()))
        };
        let found: Option<Option<i64>> = find(&self.connection, sql, [key], |row| row.get(0))?;
        found.flatten().ok_or_else(|| StoreError::NoSuchCapture(asked.chars().take(NAME_MAX).collect()))
    }

    /// Returns whether rows of deleted captures or of their references remain to be removed ([`Store::purge_step`]).
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn has_deleted(&self) -> Result<bool, StoreError> {
        let sql = "SELECT EXISTS (SELECT 1 FROM capture WHERE lifecycle = 'deleted')";
        let captures: bool = value(&self.connection, sql, [])?;
        Ok(captures || self.has_orphans()?)
    }

    /// Returns a capture.
    ///
    /// # Errors
    /// [`StoreError::NoSuchCapture`], or the error that the database reports.
    pub fn capture(&self, id: i64) -> Result<CaptureRow, StoreError> {
        let sql = format!("SELECT {CAPTURE_COLUMNS} FROM capture WHERE id = ?1 AND lifecycle = 'live'");
        let mut statement = self.connection.prepare_cached(&sql)?;
        let mut rows = statement.query([id])?;
        match rows.next()? {
            Some(row) => capture_of(row),
            None => Err(no_such(id)),
        }
    }

    /// Returns captures, the latest first.
    ///
    /// # Errors
    /// [`StoreError::BadCursor`], or the error that the database reports.
    pub fn captures(&self, state: Option<CaptureState>, page: &PageRequest) -> Result<Page<CaptureRow>, StoreError> {
        let before = page.after("captures")?.unwrap_or(i64::MAX);
        let mut sql = format!("SELECT {CAPTURE_COLUMNS} FROM capture WHERE lifecycle = 'live' AND id < ?");
        let mut values = vec![Sql::Integer(before)];
        if let Some(state) = state {
            sql.push_str(" AND state = ?");
            values.push(Sql::Text(state.name().to_owned()));
        }
        sql.push_str(" ORDER BY id DESC LIMIT ?");
        values.push(Sql::Integer(page.limit() as i64 + 1));
        Page::read(&self.connection, &sql, params_from_iter(values), page, "captures", capture_of)
    }
}
