//! Converts [`Record`]s to rows, inside the caller's transaction. The counters of a capture change together with its
//! rows.
//!
//! Writing the same records again adds nothing. Samples are identified by `(capture, seq)` and gaps by their place and
//! times, and counters count only rows that were added. Events and rejections have no such key; the batch number in
//! table `writer` prevents duplicates.
//!
//! A record that the schema refuses (an unknown capture, a rate of 0) is dropped, logged and counted in
//! [`Inserted::refused`]. It must not block the records behind it.

use super::StoreError;
use super::batch::{Run, StoredRow};
use super::sql::{run, value};
use super::utc;
use imu_core::sample::device_clock::ClockEstimate;
use imu_core::sample::record::CaptureEnd;
use imu_core::sample::{Channel, ConnectedSensor, DiscardCause, EventRecord, Gap, Record, Sample, Segment, Timebase};
use imu_core::units::period_ns;
use rusqlite::{CachedStatement, Connection, ErrorCode, params};
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// The outcome of a batch.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Inserted {
    /// Number of samples of each capture now.
    pub(super) committed: BTreeMap<i64, u64>,
    /// Number of samples added.
    pub(super) samples: u64,
    /// Records that the schema refused.
    pub(super) refused: u64,
    /// Whether times can be corrected now ([`utc::step`]).
    pub(super) corrections: bool,
}

/// The additions of a batch to one capture.
#[derive(Default)]
struct Added {
    samples: u64,
    missing: u64,
    gaps: u64,
    segments: u64,
    sample_time_ns: f64,
    rate_hz: Option<f64>,
    first_rate_hz: Option<f64>,
    rejected: BTreeMap<DiscardCause, u64>,
    ends: BTreeMap<u32, SegmentEnd>,
    ended: Option<(CaptureEnd, i64)>,
    first_utc_ns: Option<i64>,
    next_seq: u64,
    /// Measurements received as of the last record; `None` if they are not counted.
    received: Option<u64>,
    /// Times before this are still to be corrected. This includes samples that arrive until one has a later time.
    unset_before_utc_ns: Option<i64>,
    /// Consecutive samples that were added, for their checksum.
    run: Option<Run>,
}

#[derive(Default)]
struct SegmentEnd {
    samples: u64,
    device_time_ns: Option<u64>,
    utc_ns: i64,
}

const INTO_SAMPLE: &str = "INSERT INTO sample (capture_id, segment_id, seq, device_time_ns, host_mono_ns, host_utc_ns, \
    yaw, pitch, roll, mag_x, mag_y, mag_z, accel_x, accel_y, accel_z, gyro_x, gyro_y, gyro_z, temperature, pressure, \
    sync_count) VALUES";
/// The columns of table `sample`.
const SAMPLE_COLUMNS: usize = 7 + Channel::COUNT;
/// Samples per statement. This saves a quarter of the time, and larger blocks save no more (docs/performance.md).
const BLOCK: usize = 32;

/// Inserts one sample; one that exists already stays.
static INSERT_SAMPLE: LazyLock<String> =
    LazyLock::new(|| format!("{INTO_SAMPLE} {} ON CONFLICT DO NOTHING", placeholders()));
/// Inserts [`BLOCK`] samples, all or none.
static INSERT_BLOCK: LazyLock<String> =
    LazyLock::new(|| format!("{INTO_SAMPLE} {}", vec![placeholders(); BLOCK].join(", ")));

fn placeholders() -> String {
    format!("({})", ["?"; SAMPLE_COLUMNS].join(", "))
}

/// Writes the records in their order. `utc_ns` is the time of configurations, which carry none of their own; `number` is
/// the batch's, 0 for an import.
pub(super) fn insert(
    connection: &Connection,
    records: &[(i64, Record)],
    utc_ns: i64,
    number: i64,
) -> Result<Inserted, StoreError> {
    let mut captures: BTreeMap<i64, Option<Added>> = BTreeMap::new();
    let mut inserted = Inserted::default();
    let mut sample_statement = connection.prepare_cached(&INSERT_SAMPLE)?;
    let mut block_statement = connection.prepare_cached(&INSERT_BLOCK)?;
    // `ahead`: how many of the next samples are written already, including the one that began their block. `singly`:
    // how many to try one by one, after a block of which one existed.
    let (mut ahead, mut singly) = (0, 0);
    for (place, (capture_id, record)) in records.iter().enumerate() {
        let added = match captures.entry(*capture_id) {
            std::collections::btree_map::Entry::Occupied(entry) => entry.into_mut(),
            std::collections::btree_map::Entry::Vacant(entry) => entry.insert(begin(connection, *capture_id)?),
        };
        let Some(added) = added else {
            inserted.refused += 1;
            continue;
        };
        let outcome = match record {
            Record::Sample { seq, segment, sample } => {
                if added.unset_before_utc_ns.take_if(|before| sample.host_utc_ns >= *before).is_some() {
                    // Corrected and uncorrected samples never share a checksum.
                    if let Some(run) = added.run.take() {
                        run.store(connection, *capture_id, number)?;
                    }
                    utc::close(connection, *capture_id, *seq)?;
                    inserted.corrections = true;
                }
                if ahead == 0
                    && singly == 0
                    && let Some(block) = block_of(&records[place..])
                {
                    let remaining = if insert_block(&mut block_statement, block)? { &mut ahead } else { &mut singly };
                    *remaining = BLOCK;
                }
                let new = if ahead > 0 {
                    ahead -= 1;
                    Ok(true)
                } else {
                    singly = singly.saturating_sub(1);
                    insert_sample(&mut sample_statement, *capture_id, *segment, *seq, sample)
                };
                new.and_then(|new| {
                    if !new {
                        return Ok(());
                    }
                    count_sample(*segment, *seq, sample, added);
                    cover(connection, *capture_id, &StoredRow::of(*seq, *segment, sample), number, added)
                })
            }
            Record::Segment(segment) => insert_segment(connection, *capture_id, segment, added),
            Record::Gap(gap) => insert_gap(connection, *capture_id, gap, added),
            Record::Event(event) => insert_event(connection, *capture_id, event),
            Record::Discarded { cause, count } => {
                *added.rejected.entry(*cause).or_default() += count;
                if cause.is_frame() {
                    added.received = added.received.map(|received| received + count);
                }
                Ok(())
            }
            Record::DeviceClock { epoch, estimate } => insert_clock(connection, *capture_id, *epoch, estimate),
            Record::UtcSet { by_ns, before_utc_ns, boot_id, since_seq } => {
                added.unset_before_utc_ns = Some(*before_utc_ns);
                let since = utc::since(connection, *capture_id, boot_id.as_deref(), *since_seq, added.next_seq)?;
                utc::note(connection, *capture_id, *by_ns, *before_utc_ns, since, added.next_seq)
            }
            Record::Configuration(sensor) => {
                insert_configuration(connection, *capture_id, sensor, added.next_seq, utc_ns)
            }
            Record::Ended { how, utc_ns } => {
                added.ended = Some((*how, *utc_ns));
                inserted.corrections |= added.unset_before_utc_ns.is_some();
                Ok(())
            }
        };
        match outcome {
            Err(StoreError::Sqlite(error)) if error.sqlite_error_code() == Some(ErrorCode::ConstraintViolation) => {
                tracing::error!(message = "A record was refused by the schema.", capture_id, %error, ?record);
                inserted.refused += 1;
            }
            other => other?,
        }
    }
    for (capture_id, mut added) in captures {
        if let Some(run) = added.as_mut().and_then(|added| added.run.take()) {
            run.store(connection, capture_id, number)?;
        }
        let Some(added) = added else {
            tracing::error!(message = "Records of a capture that does not exist were dropped.", capture_id);
            continue;
        };
        inserted.samples += added.samples;
        inserted.committed.insert(capture_id, finish(connection, capture_id, &added)?);
    }
    Ok(inserted)
}

/// Returns the capture's state so far; `None` if there is no such capture.
fn begin(connection: &Connection, capture_id: i64) -> Result<Option<Added>, StoreError> {
    let mut statement = connection.prepare_cached(
        "SELECT samples, received, (SELECT rate_hz FROM segment WHERE capture_id = capture.id ORDER BY segment_id DESC LIMIT 1) \
         FROM capture WHERE id = ?1",
    )?;
    let mut rows = statement.query([capture_id])?;
    let Some(row) = rows.next()? else { return Ok(None) };
    let next_seq = row.get::<_, i64>(0)? as u64;
    let received = row.get::<_, Option<i64>>(1)?.map(|received| received as u64);
    let rate_hz = row.get(2)?;
    let unset_before_utc_ns = utc::open_before(connection, capture_id)?;
    Ok(Some(Added { next_seq, received, rate_hz, unset_before_utc_ns, ..Added::default() }))
}

/// Returns the next [`BLOCK`] records, if they are samples of one capture.
fn block_of(records: &[(i64, Record)]) -> Option<&[(i64, Record); BLOCK]> {
    let block: &[_; BLOCK] = records.first_chunk()?;
    let is_one =
        |(capture_id, record): &(i64, Record)| *capture_id == block[0].0 && matches!(record, Record::Sample { .. });
    block.iter().all(is_one).then_some(block)
}

/// Inserts the samples of a block. Returns `false` if one exists already or the schema refuses one: then none is
/// inserted, and each must be tried on its own.
fn insert_block(statement: &mut CachedStatement<'_>, block: &[(i64, Record); BLOCK]) -> Result<bool, StoreError> {
    for (index, (capture_id, record)) in block.iter().enumerate() {
        if let Record::Sample { seq, segment, sample } = record {
            bind_sample(statement, index * SAMPLE_COLUMNS, *capture_id, *segment, *seq, sample)?;
        }
    }
    match statement.raw_execute() {
        Ok(_) => Ok(true),
        Err(error) if error.sqlite_error_code() == Some(ErrorCode::ConstraintViolation) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// Inserts one sample; returns `false` if it exists already.
fn insert_sample(
    statement: &mut CachedStatement<'_>,
    capture_id: i64,
    segment: u32,
    seq: u64,
    sample: &Sample,
) -> Result<bool, StoreError> {
    bind_sample(statement, 0, capture_id, segment, seq, sample)?;
    Ok(statement.raw_execute()? == 1)
}

/// Binds a sample's columns behind the first `before` parameters.
fn bind_sample(
    statement: &mut CachedStatement<'_>,
    before: usize,
    capture_id: i64,
    segment: u32,
    seq: u64,
    sample: &Sample,
) -> rusqlite::Result<()> {
    statement.raw_bind_parameter(before + 1, capture_id)?;
    statement.raw_bind_parameter(before + 2, segment)?;
    statement.raw_bind_parameter(before + 3, seq as i64)?;
    // The bits are kept: a clock beyond 2^63 ns is read back unchanged.
    statement.raw_bind_parameter(before + 4, sample.device_time_ns.map(|ns| ns as i64))?;
    statement.raw_bind_parameter(before + 5, sample.host_mono_ns as i64)?;
    statement.raw_bind_parameter(before + 6, sample.host_utc_ns)?;
    for channel in Channel::ALL {
        statement.raw_bind_parameter(before + 7 + channel as usize, sample.get(channel))?;
    }
    statement.raw_bind_parameter(before + SAMPLE_COLUMNS, sample.sync_count)
}

/// Updates its capture's counts with a new sample.
fn count_sample(segment: u32, seq: u64, sample: &Sample, added: &mut Added) {
    added.samples += 1;
    added.next_seq = seq + 1;
    if sample.frame == 0 {
        added.received = None;
    }
    // The reader's own count: a measurement lost on the way here appears as a difference.
    added.received = added.received.map(|_| sample.frame);
    if let Some(rate_hz) = added.rate_hz {
        added.sample_time_ns += period_ns(rate_hz);
    }
    let end = added.ends.entry(segment).or_default();
    end.samples += 1;
    end.device_time_ns = sample.device_time_ns;
    end.utc_ns = sample.host_utc_ns;
}

/// Adds a row to the checksum of its batch; a hole in `seq` (samples that existed already) begins another batch.
fn cover(
    connection: &Connection,
    capture_id: i64,
    row: &StoredRow,
    number: i64,
    added: &mut Added,
) -> Result<(), StoreError> {
    if let Some(run) = added.run.take_if(|run| run.next_seq() != row.seq) {
        run.store(connection, capture_id, number)?;
    }
    added.run.get_or_insert_with(|| Run::new(row.seq)).push(row);
    Ok(())
}

fn insert_segment(
    connection: &Connection,
    capture_id: i64,
    segment: &Segment,
    added: &mut Added,
) -> Result<(), StoreError> {
    let names: Vec<&str> = segment.channels.iter().map(Channel::name).collect();
    let sql = "INSERT INTO segment (capture_id, segment_id, epoch, first_seq, rate_hz, timebase, channels, \
               first_device_time_ns, first_utc_ns, boot_id) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10) \
               ON CONFLICT DO NOTHING";
    let values = params![
        capture_id,
        segment.number,
        segment.epoch,
        segment.first_seq as i64,
        segment.rate_hz,
        <&str>::from(segment.timebase),
        serde_json::to_string(&names)?,
        segment.first_device_time_ns.map(|ns| ns as i64),
        segment.first_utc_ns,
        segment.boot_id,
    ];
    let rows = run(connection, sql, values)?;
    added.rate_hz = Some(segment.rate_hz);
    if rows == 0 {
        return Ok(());
    }
    added.segments += 1;
    if segment.number == 1 {
        added.first_rate_hz = Some(segment.rate_hz);
        // 0 stands for a recording without host time.
        added.first_utc_ns = Some(segment.first_utc_ns).filter(|ns| *ns != 0);
    }
    let ascii = matches!(segment.timebase, Timebase::Arrival | Timebase::SyncCounter);
    let mut channel_statement = connection.prepare_cached(
        "INSERT INTO channel (capture_id, channel, unit, resolution) VALUES (?1, ?2, ?3, ?4) ON CONFLICT DO NOTHING",
    )?;
    for channel in segment.channels.iter() {
        // Only ASCII messages lack device time, and their decimals are known.
        let resolution = ascii.then(|| 10f64.powi(-(channel.ascii_decimals() as i32)));
        channel_statement.execute(params![capture_id, channel.name(), channel.unit(), resolution])?;
    }
    Ok(())
}

fn insert_gap(connection: &Connection, capture_id: i64, gap: &Gap, added: &mut Added) -> Result<(), StoreError> {
    let sql = "INSERT INTO gap (capture_id, before_seq, from_utc_ns, to_utc_ns, from_device_ns, to_device_ns, missing, \
               missing_exact, cause) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9) ON CONFLICT DO NOTHING";
    let values = params![
        capture_id,
        gap.before_seq as i64,
        gap.from_utc_ns,
        gap.to_utc_ns,
        gap.device_ns.map(|(from, _)| from as i64),
        gap.device_ns.map(|(_, to)| to as i64),
        gap.missing as i64,
        gap.missing_exact,
        gap.cause.name(),
    ];
    let rows = run(connection, sql, values)?;
    if rows == 1 {
        added.gaps += 1;
        added.missing += gap.missing;
        if let Some(rate_hz) = added.rate_hz {
            added.sample_time_ns += gap.sample_time_ns(period_ns(rate_hz));
        }
    }
    Ok(())
}

pub(super) fn insert_event(connection: &Connection, capture_id: i64, event: &EventRecord) -> Result<(), StoreError> {
    let detail = event.detail.as_ref().map(serde_json::Value::to_string);
    let sql = "INSERT INTO event (capture_id, utc_ns, kind, message, detail) VALUES (?1, ?2, ?3, ?4, ?5)";
    run(connection, sql, params![capture_id, event.utc_ns, event.kind.name(), event.message, detail])?;
    Ok(())
}

fn insert_clock(
    connection: &Connection,
    capture_id: i64,
    epoch: u32,
    estimate: &ClockEstimate,
) -> Result<(), StoreError> {
    let sql = "INSERT OR REPLACE INTO device_clock (capture_id, epoch, skew_ppm, skew_ppm_uncertainty, offset_s, \
               latency_mean_ms, latency_max_ms, span_s) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)";
    let values = params![
        capture_id,
        epoch,
        estimate.skew_ppm,
        estimate.skew_ppm_uncertainty,
        estimate.offset_s,
        estimate.latency_mean_ms,
        estimate.latency_max_ms,
        estimate.span_s,
    ];
    run(connection, sql, values)?;
    Ok(())
}

fn insert_configuration(
    connection: &Connection,
    capture_id: i64,
    sensor: &ConnectedSensor,
    before_seq: u64,
    utc_ns: i64,
) -> Result<(), StoreError> {
    let (description, configuration) = (sensor.sensor().to_string(), sensor.configuration().to_string());
    let sql = "INSERT INTO configuration (capture_id, utc_ns, before_seq, registers) VALUES (?1, ?2, ?3, ?4)";
    run(connection, sql, params![capture_id, utc_ns, before_seq as i64, configuration])?;
    let sql =
        "UPDATE capture SET sensor = coalesce(sensor, ?2), configuration = coalesce(configuration, ?3) WHERE id = ?1";
    run(connection, sql, params![capture_id, description, configuration])?;
    Ok(())
}

/// Updates the counters; returns how many samples the capture has now.
fn finish(connection: &Connection, capture_id: i64, added: &Added) -> Result<u64, StoreError> {
    let mut end_statement = connection.prepare_cached(
        "UPDATE segment SET samples = samples + ?3, last_device_time_ns = ?4, last_utc_ns = ?5 \
         WHERE capture_id = ?1 AND segment_id = ?2",
    )?;
    for (segment, end) in &added.ends {
        let device_time_ns = end.device_time_ns.map(|ns| ns as i64);
        end_statement.execute(params![capture_id, segment, end.samples as i64, device_time_ns, end.utc_ns])?;
    }
    let mut rejected_statement = connection.prepare_cached(
        "INSERT INTO rejected (capture_id, cause, count) VALUES (?1, ?2, ?3) \
         ON CONFLICT (capture_id, cause) DO UPDATE SET count = count + excluded.count",
    )?;
    for (cause, count) in &added.rejected {
        rejected_statement.execute(params![capture_id, cause.name(), *count as i64])?;
    }
    let state = added.ended.map(|(how, _)| match how {
        CaptureEnd::Complete => "complete",
        CaptureEnd::Stopped => "stopped",
    });
    let sql = "UPDATE capture SET samples = samples + ?2, missing = missing + ?3, gaps = gaps + ?4, \
               segments = segments + ?5, sample_time_ns = sample_time_ns + ?6, rate_hz = coalesce(?7, rate_hz), \
               started_utc_ns = coalesce(started_utc_ns, ?8), state = coalesce(?9, CASE WHEN state = 'waiting' AND ?5 > 0 THEN 'capturing' ELSE state END), \
               ended_utc_ns = coalesce(?10, ended_utc_ns), received = ?11 WHERE id = ?1 RETURNING samples";
    let values = params![
        capture_id,
        added.samples as i64,
        added.missing as i64,
        added.gaps as i64,
        added.segments as i64,
        added.sample_time_ns.round() as i64,
        added.first_rate_hz,
        added.first_utc_ns,
        state,
        added.ended.map(|(_, utc_ns)| utc_ns),
        added.received.map(|received| received as i64),
    ];
    let samples: i64 = value(connection, sql, values)?;
    Ok(samples as u64)
}
