//! Samples of a capture, streamed as they are read: never more than two pieces in memory, no read transaction longer
//! than one piece, and nothing is read any more once nobody listens.

use super::extract::{P, Q};
use super::layers::Streamed;
use super::problem::{ApiError, Problem, ProblemType};
use super::rows::{Bucket, Format, Head, Writer};
use super::state::ApiState;
use super::stream::{self, Pieces};
use crate::sample::{Channel, Timebase};
use crate::store::{CaptureRow, Chunk, PageRequest, PooledReader, Reader, SegmentRow, StoreError};
use crate::units::period_ns;
use axum::Extension;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use chrono::DateTime;
use serde::Deserialize;
use std::io;

/// Samples in one answer at most, where they are not decimated: 7 hours at 40 Hz, 21 minutes at 800 Hz.
const SAMPLES_MAX: u64 = 1_000_000;
/// Samples that one answer may decimate: 25 days at 40 Hz.
const DECIMATED_MAX: u64 = 86_400_000;
/// Rows of a decimated answer at most.
const POINTS_MAX: u32 = 100_000;
/// Samples read at once: a piece is then some 300 KiB, of which four are on their way to a reader that has stopped.
const CHUNK: usize = 2048;

/// Which samples are wanted and how.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct SamplesQuery {
    /// Channels by name, separated by commas; all of the capture's where absent.
    #[param(example = "gyro_x,gyro_y,gyro_z")]
    channels: Option<String>,
    /// From this time on: RFC 3339, or seconds since the capture's first sample.
    #[param(example = "0")]
    from: Option<String>,
    /// Before this time: RFC 3339, or seconds since the capture's first sample.
    #[param(example = "60")]
    to: Option<String>,
    /// Where there are more samples, minimum and maximum of so many stretches instead.
    #[param(minimum = 1, maximum = 100000)]
    max_points: Option<u32>,
    /// `json`, `csv` or `ndjson`; the header `Accept` decides where absent.
    format: Option<String>,
}

/// A range of samples, as [`Writer`] writes it. `time_s` counts from the capture's first sample, by the sensor's clock where it sends one.
#[derive(Debug, serde::Serialize, utoipa::ToSchema)]
pub(super) struct Samples {
    /// Id of the capture.
    capture: i64,
    /// What `time_s` counts from.
    origin: String,
    /// Output rate in Hz.
    rate_hz: Option<f64>,
    /// How many samples the range has.
    range_samples: u64,
    /// 1, or how many samples a row of minima and maxima stands for.
    samples_per_row: u64,
    /// Names of the columns: `time_s`, then channels (`gyro_x`, or `gyro_x_min` and `gyro_x_max`).
    columns: Vec<String>,
    /// Their units.
    units: Vec<String>,
    /// The rows; null where a sample has no value.
    samples: Vec<Vec<Option<f64>>>,
    /// Always null: a range is answered whole.
    next: Option<String>,
}

/// Samples of a range of time, streamed: at most 1,000,000, or decimated to `max_points`.
#[utoipa::path(get, path = "/v1/captures/{id}/samples", tag = "captures",
    params(("id" = String, Path, description = "Id, name, or `latest`"), SamplesQuery), responses(
    (status = 200, content((Samples = "application/json"), (String = "text/csv"), (String = "application/x-ndjson"))),
    (status = 400, body = Problem, content_type = "application/problem+json"),
    (status = 404, body = Problem, content_type = "application/problem+json"),
    (status = 406, body = Problem, content_type = "application/problem+json"),
    (status = 503, body = Problem, content_type = "application/problem+json", description = "Too many large queries at once")))]
pub(super) async fn samples(
    State(state): State<ApiState>,
    headers: HeaderMap,
    P(name): P,
    Q(query): Q<SamplesQuery>,
) -> Result<Response, ApiError> {
    let format = format(query.format.as_deref(), &headers)?;
    let wanted = query.channels.as_deref().map(channels).transpose()?;
    let (from, to) = (query.from.as_deref().map(time).transpose()?, query.to.as_deref().map(time).transpose()?);
    let points = query.max_points;
    if points.is_some_and(|points| !(1..=POINTS_MAX).contains(&points)) {
        return Err(ApiError::bad_request(format!("`max_points`: allowed is 1 to {POINTS_MAX}")));
    }
    let permit = state.heavy_permit()?;
    let range = state.read(move |reader| Range::read(reader, &name, from, to)).await?;
    let selection = Selection::new(range, wanted, points, format)?;
    let reader_state = state.clone();
    let (pieces, body) = stream::channel();
    tokio::task::spawn_blocking(move || {
        let _permit = permit;
        let outcome = reader_state.reader().and_then(|reader| selection.send(&reader, &pieces));
        if let Err(error) = outcome {
            tracing::warn!(%error, "Samples could not be sent to their end.");
            // The other side may be gone too.
            let _ = pieces.blocking_send(Err(io::Error::other(error)));
        }
    });
    let media_type = HeaderValue::from_static(format.media_type());
    Ok((Extension(Streamed), [(header::CONTENT_TYPE, media_type)], body).into_response())
}

fn format(asked: Option<&str>, headers: &HeaderMap) -> Result<Format, ApiError> {
    let names = Format::ALL.map(Format::name).join(", ");
    match asked {
        Some(name) => Format::ALL
            .into_iter()
            .find(|format| format.name() == name)
            .ok_or_else(|| ApiError::bad_request(format!("`format`: allowed are {names}"))),
        None => {
            Format::accepted(headers.get(header::ACCEPT).and_then(|accept| accept.to_str().ok())).ok_or_else(|| {
                let media_types = Format::ALL.map(Format::media_type).join(", ");
                ApiError::new(ProblemType::NotAcceptable, format!("samples exist as {media_types}"))
            })
        }
    }
}

fn channels(names: &str) -> Result<Vec<Channel>, ApiError> {
    let mut channels = Vec::new();
    for name in names.split(',').map(str::trim) {
        let channel = Channel::from_name(name).ok_or_else(|| {
            let known = Channel::ALL.map(Channel::name).join(", ");
            let found: String = name.chars().take(40).collect();
            ApiError::bad_request(format!("`channels`: there is no `{found}`: channels are {known}"))
        })?;
        if !channels.contains(&channel) {
            channels.push(channel);
        }
    }
    Ok(channels)
}

/// A time as it was asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Moment {
    Utc(i64),
    /// Since the capture's first sample, ns.
    Since(i64),
}

fn time(text: &str) -> Result<Moment, ApiError> {
    let refuse = || {
        let found: String = text.chars().take(40).collect();
        ApiError::bad_request(format!(
            "`{found}` is no time: expected RFC 3339 such as 2026-11-21T20:00:00Z (a `+` is written %2B), or seconds \
             since the capture's first sample"
        ))
    };
    if let Ok(seconds) = text.parse::<f64>() {
        let ns = seconds * 1e9;
        // Beyond 2^62 ns (146 years) sums could not be held.
        return if (0.0..4.6e18).contains(&ns) { Ok(Moment::Since(ns.round() as i64)) } else { Err(refuse()) };
    }
    DateTime::parse_from_rfc3339(text).ok().and_then(|at| at.timestamp_nanos_opt()).map(Moment::Utc).ok_or_else(refuse)
}

/// A stretch of a capture.
#[derive(Debug)]
struct Range {
    capture: CaptureRow,
    axis: TimeAxis,
    from_seq: u64,
    to_seq: u64,
}

impl Range {
    fn read(reader: &Reader, name: &str, from: Option<Moment>, to: Option<Moment>) -> Result<Self, StoreError> {
        let id = reader.resolve(name)?;
        let capture = reader.capture(id)?;
        let mut axis = TimeAxis::read(reader, id)?;
        let end = reader.seq_range(id)?.map_or(0, |range| range.last + 1);
        let from_seq = from.map_or(Ok(0), |from| axis.seq_at(reader, from, end))?;
        let to_seq = to.map_or(Ok(end), |to| axis.seq_at(reader, to, end))?;
        Ok(Self { capture, axis, from_seq, to_seq: to_seq.max(from_seq) })
    }
}

/// When each sample was taken: by the sensor's clock within each of its epochs, by the rate where the sensor sends no
/// time, by the stamps of a recording. It keeps one segment at a time, however many there are.
#[derive(Debug)]
struct TimeAxis {
    capture_id: i64,
    origin_ns: i64,
    segment: Option<(SegmentRow, i64)>,
}

impl TimeAxis {
    fn read(reader: &Reader, capture_id: i64) -> Result<Self, StoreError> {
        let first = PageRequest { limit: Some(1), cursor: None };
        let origin_ns = reader.segments(capture_id, &first)?.rows.first().map_or(0, |segment| segment.from.0);
        Ok(Self { capture_id, origin_ns, segment: None })
    }

    /// `seq` of the first sample at or after the moment, `end` where none is. Found by bisection: where the axis itself
    /// goes back (the host's clock was stepped while the sensor was away) it is one of the places in question.
    fn seq_at(&mut self, reader: &Reader, moment: Moment, end: u64) -> Result<u64, StoreError> {
        let wanted_ns = match moment {
            Moment::Since(ns) => ns,
            Moment::Utc(utc_ns) => utc_ns.saturating_sub(self.origin_ns),
        };
        let (mut low, mut high) = (0, end);
        while low < high {
            let middle = low + (high - low) / 2;
            let (segment, device_ns, host_utc_ns) = reader.sample_clocks(self.capture_id, middle)?;
            let at_ns = self.time_ns(reader, segment, middle, device_ns, host_utc_ns)?;
            if at_ns < wanted_ns { low = middle + 1 } else { high = middle }
        }
        Ok(low)
    }

    /// Since the capture's first sample, ns.
    fn time_ns(
        &mut self,
        reader: &Reader,
        segment: u32,
        seq: u64,
        device_ns: Option<u64>,
        host_utc_ns: i64,
    ) -> Result<i64, StoreError> {
        if self.segment.as_ref().is_none_or(|(row, _)| row.segment != segment) {
            let row = reader.segment(self.capture_id, segment)?;
            // One offset per epoch: host times vary by the latency, the sensor's own do not.
            let offset_ns = reader.epoch_offset_ns(self.capture_id, row.epoch)?.unwrap_or(0);
            self.segment = Some((row, offset_ns));
        }
        let utc_ns = match &self.segment {
            Some((row, offset_ns)) => match (row.timebase, device_ns) {
                (Timebase::Device, Some(device_ns)) => offset_ns.saturating_add(device_ns as i64),
                (Timebase::SyncCounter | Timebase::Arrival | Timebase::Rate, _) => {
                    let steps = seq.saturating_sub(row.first_seq) as f64;
                    row.from.0.saturating_add((steps * period_ns(row.rate_hz)).round() as i64)
                }
                (Timebase::Device | Timebase::Stamps, _) => host_utc_ns,
            },
            None => host_utc_ns,
        };
        Ok(utc_ns.saturating_sub(self.origin_ns))
    }
}

/// What is sent.
#[derive(Debug)]
struct Selection {
    range: Range,
    channels: Vec<Channel>,
    format: Format,
    bucket: Option<u64>,
}

impl Selection {
    fn new(range: Range, wanted: Option<Vec<Channel>>, points: Option<u32>, format: Format) -> Result<Self, ApiError> {
        let has = &range.capture.channels;
        let channels = wanted.unwrap_or_else(|| has.clone());
        if let Some(absent) = channels.iter().find(|channel| !has.contains(channel)) {
            let has: Vec<&str> = has.iter().map(|channel| channel.name()).collect();
            return Err(ApiError::bad_request(format!("the capture has no `{absent}`: it has {}", has.join(", "))));
        }
        let samples = range.to_seq - range.from_seq;
        let bucket = points.map(u64::from).filter(|points| samples > *points).map(|points| samples.div_ceil(points));
        let most = if bucket.is_some() { DECIMATED_MAX } else { SAMPLES_MAX };
        if samples > most {
            return Err(ApiError::bad_request(format!(
                "the range has {samples} samples, {most} are allowed: narrow it with `from` and `to`, decimate it with \
                 `max_points`, or use `vn100d export`"
            )));
        }
        Ok(Self { range, channels, format, bucket })
    }

    /// Reads and sends to the end, or until nobody listens.
    fn send(mut self, reader: &PooledReader, pieces: &Pieces) -> Result<(), StoreError> {
        let Range { capture, axis, from_seq, to_seq } = &mut self.range;
        let (from_seq, to_seq) = (*from_seq, *to_seq);
        let mut writer = Writer::new(self.format, &self.channels, self.bucket.is_some());
        let mut bucket = Bucket::new(self.bucket.unwrap_or(1), self.channels.len());
        let mut out = String::new();
        writer.head(
            &mut out,
            &Head {
                capture: capture.id,
                origin: crate::clock::rfc3339(axis.origin_ns),
                rate_hz: capture.rate_hz,
                samples: to_seq - from_seq,
                bucket: self.bucket,
            },
        );
        let mut next_seq = from_seq;
        while next_seq < to_seq {
            let limit = CHUNK.min(usize::try_from(to_seq - next_seq).unwrap_or(CHUNK));
            let chunk = reader.read_samples(capture.id, next_seq, limit, &self.channels)?;
            if chunk.is_empty() {
                // The capture was deleted meanwhile: what was announced cannot be kept.
                return Err(StoreError::NoSuchCapture { asked: capture.id.to_string() });
            }
            let decimated = self.bucket.is_some();
            write(reader, axis, &chunk, decimated, &mut writer, &mut bucket, &mut out)?;
            next_seq = chunk.next_seq();
            if pieces.blocking_send(Ok(std::mem::take(&mut out).into())).is_err() {
                return Ok(());
            }
        }
        if let Some((time_ns, values)) = bucket.row() {
            writer.row(&mut out, time_ns, values);
        }
        writer.tail(&mut out);
        // Whoever listened may be gone.
        let _ = pieces.blocking_send(Ok(out.into()));
        Ok(())
    }
}

/// Writes a chunk's rows, or takes them into the bucket and writes those that are full.
fn write(
    reader: &Reader,
    axis: &mut TimeAxis,
    chunk: &Chunk,
    decimated: bool,
    writer: &mut Writer,
    bucket: &mut Bucket,
    out: &mut String,
) -> Result<(), StoreError> {
    let Some(times) = &chunk.times else { return Ok(()) };
    let clocks = times.device_ns.iter().zip(&times.host_utc_ns);
    for (index, (segment, (device_ns, host_utc_ns))) in chunk.segment.iter().zip(clocks).enumerate() {
        let seq = chunk.first_seq + index as u64;
        let time_ns = axis.time_ns(reader, *segment, seq, *device_ns, *host_utc_ns)?;
        let values = chunk.columns.iter().filter_map(|column| column.get(index).copied());
        if !decimated {
            writer.row(out, time_ns, values);
        } else if bucket.take(time_ns, values)
            && let Some((time_ns, values)) = bucket.row()
        {
            writer.row(out, time_ns, values);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_rfc_3339_or_seconds_since_the_first_sample() {
        assert_eq!(time("1.5").unwrap(), Moment::Since(1_500_000_000));
        assert_eq!(time("1970-01-01T00:00:01Z").unwrap(), Moment::Utc(1_000_000_000));
        assert_eq!(time("1970-01-01T01:00:01.5+01:00").unwrap(), Moment::Utc(1_500_000_000));
        for text in ["", "-1", "NaN", "inf", "1e30", "yesterday", "2026-11-21", "9999-01-01T00:00:00Z"] {
            assert!(time(text).is_err(), "{text}");
        }
    }

    #[test]
    fn channels_are_named_and_each_taken_once() {
        assert_eq!(channels("gyro_x, accel_z,gyro_x").unwrap(), [Channel::GyroX, Channel::AccelZ]);
        for text in ["", "gyro", "gyro_x,", "GYRO_X"] {
            assert!(channels(text).is_err(), "{text}");
        }
    }
}
