//! Samples of a capture, streamed as they are read: never more than two pieces in memory, no read transaction longer
//! than one piece, and reading ends when the client has gone.

use super::extract::{P, Q};
use super::problem::{ApiError, Problem, ProblemType};
use super::state::ApiState;
use super::stream::{self, Pieces, Streamed};
use crate::store::{Chunk, Moment, PooledReader, Reader, SampleRange, StoreError, TimeAxis};
use axum::Extension;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use imu_core::sample::Channel;
use imu_files::export::samples::{Bucket, TextFormat, TextHead, TextWriter};
use serde::Deserialize;
use std::io;

/// Maximum number of samples in one answer without decimation: 7 hours at 40 Hz, 21 minutes at 800 Hz.
const SAMPLES_MAX: u64 = 1_000_000;
/// Maximum number of samples that one answer decimates: 25 days at 40 Hz.
const DECIMATED_MAX: u64 = 86_400_000;
/// Maximum number of rows in a decimated answer.
const POINTS_MAX: u32 = 100_000;
/// Number of samples read at once: a piece is then some 300 KiB, of which four are on their way to a reader that has
/// stopped.
const CHUNK: usize = 2048;

/// The wanted samples and their form.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct SamplesQuery {
    /// Channels by name, separated by commas; all of the capture's if absent.
    #[param(example = "gyro_x,gyro_y,gyro_z")]
    channels: Option<String>,
    /// From this time on: RFC 3339, or seconds since the capture's first sample.
    #[param(example = "0")]
    from: Option<String>,
    /// Before this time: RFC 3339, or seconds since the capture's first sample.
    #[param(example = "60")]
    to: Option<String>,
    /// If there are more samples, minimum and maximum of this many stretches instead.
    #[param(minimum = 1, maximum = 100000)]
    max_points: Option<u32>,
    /// `json`, `csv` or `ndjson`; if absent, the header `Accept` decides.
    format: Option<String>,
}

/// A range of samples. `time_s` counts from the capture's first sample, by the sensor's clock if it sends one.
#[derive(Debug, serde::Serialize, utoipa::ToSchema)]
pub(super) struct Samples {
    /// Id of the capture.
    capture: i64,
    /// The origin of `time_s`.
    origin: String,
    /// Output rate in Hz.
    rate_hz: Option<f64>,
    /// Number of samples in the range.
    range_samples: u64,
    /// 1, or the number of samples per row of minima and maxima.
    samples_per_row: u64,
    /// Names of the columns: `time_s`, then channels (`gyro_x`, or `gyro_x_min` and `gyro_x_max`).
    columns: Vec<String>,
    /// Units of the columns.
    units: Vec<String>,
    /// The rows; null if a sample has no value.
    samples: Vec<Vec<Option<f64>>>,
    /// Always null: a range is answered completely.
    next: Option<String>,
}

/// Samples of a range of time, streamed: at most 1,000,000, or decimated to `max_points`.
#[utoipa::path(get, path = "/v1/captures/{id}/samples", tag = "captures",
    params(("id" = String, Path, description = "Id, name, or `latest`"), SamplesQuery), responses(
    (status = 200, content((Samples = "application/json"), (String = "text/csv"), (String = "application/x-ndjson"))),
    (status = 400, body = Problem, content_type = "application/problem+json"),
    (status = 406, body = Problem, content_type = "application/problem+json"),
    (status = 429, body = Problem, content_type = "application/problem+json", description = "Too many large queries at once")))]
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
    let permit = state.stream_permit()?;
    let range = state.read(move |reader| SampleRange::read(reader, &name, from, to)).await?;
    let selection = Selection::new(range, wanted, points, format)?;
    let reader_state = state.clone();
    let (pieces, body) = stream::channel();
    tokio::task::spawn_blocking(move || {
        let _permit = permit;
        let outcome = reader_state.reader().and_then(|reader| selection.send(&reader, &pieces));
        if let Err(error) = outcome {
            tracing::warn!(%error, "Samples could not be sent to their end.");
            // The client may have gone too.
            let _ = pieces.blocking_send(Err(io::Error::other(error)));
        }
    });
    let media_type = HeaderValue::from_static(format.media_type());
    Ok((Extension(Streamed), [(header::CONTENT_TYPE, media_type)], body).into_response())
}

fn format(asked: Option<&str>, headers: &HeaderMap) -> Result<TextFormat, ApiError> {
    let names = TextFormat::ALL.map(TextFormat::name).join(", ");
    match asked {
        Some(name) => TextFormat::ALL
            .into_iter()
            .find(|format| format.name() == name)
            .ok_or_else(|| ApiError::bad_request(format!("`format`: allowed are {names}"))),
        None => accepted(headers.get(header::ACCEPT).and_then(|accept| accept.to_str().ok())).ok_or_else(|| {
            let media_types = TextFormat::ALL.map(TextFormat::media_type).join(", ");
            ApiError::new(ProblemType::NotAcceptable, format!("samples exist as {media_types}"))
        }),
    }
}

fn channels(names: &str) -> Result<Vec<Channel>, ApiError> {
    Channel::list(names).map_err(|error| ApiError::bad_request(format!("`channels`: {error}")))
}

/// Parses a time of a query.
pub(super) fn time(text: &str) -> Result<Moment, ApiError> {
    Moment::parse(text).ok_or_else(|| {
        let found: String = text.chars().take(40).collect();
        ApiError::bad_request(format!(
            "`{found}` is no time: expected RFC 3339 such as 2026-11-21T20:00:00Z (a `+` is written %2B), or seconds \
             since the capture's first sample"
        ))
    })
}

/// Returns the form preferred by an `Accept` header; JSON if it states none. `None` if it accepts none of the forms.
fn accepted(accept: Option<&str>) -> Option<TextFormat> {
    let Some(accept) = accept else { return Some(TextFormat::Json) };
    let mut best: Option<(TextFormat, f64)> = None;
    for range in accept.split(',') {
        let mut parts = range.split(';').map(str::trim);
        let media = parts.next().unwrap_or_default().to_ascii_lowercase();
        let quality = parts.find_map(|part| part.strip_prefix("q=")).map_or(1.0, |q| q.parse().unwrap_or(0.0));
        let format = match media.as_str() {
            "*/*" | "application/*" | "application/json" => TextFormat::Json,
            "text/csv" | "text/*" => TextFormat::Csv,
            "application/x-ndjson" | "application/ndjson" => TextFormat::Ndjson,
            _ => continue,
        };
        if quality > best.map_or(0.0, |(_, quality)| quality) {
            best = Some((format, quality));
        }
    }
    best.map(|(format, _)| format)
}

/// The selected samples.
#[derive(Debug)]
struct Selection {
    range: SampleRange,
    channels: Vec<Channel>,
    format: TextFormat,
    bucket: Option<u64>,
}

impl Selection {
    fn new(
        range: SampleRange,
        wanted: Option<Vec<Channel>>,
        points: Option<u32>,
        format: TextFormat,
    ) -> Result<Self, ApiError> {
        let channels = Channel::chosen(wanted.as_deref(), &range.capture.channels)
            .map_err(|error| ApiError::bad_request(error.to_string()))?;
        let samples = range.samples();
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

    /// Reads and sends to the end, or until the client has gone.
    fn send(mut self, reader: &PooledReader, pieces: &Pieces) -> Result<(), StoreError> {
        let SampleRange { capture, axis, from_seq, to_seq } = &mut self.range;
        let (from_seq, to_seq) = (*from_seq, *to_seq);
        let mut writer = TextWriter::new(self.format, &self.channels, self.bucket.is_some());
        let mut bucket = Bucket::new(self.bucket.unwrap_or(1), self.channels.len());
        let mut out = String::new();
        writer.head(
            &mut out,
            &TextHead {
                capture: capture.id,
                origin: crate::clock::rfc3339(axis.origin_ns()),
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
                // The capture was deleted meanwhile: the announced samples cannot be sent.
                return Err(StoreError::NoSuchCapture(capture.id.to_string()));
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
        // The client may have gone.
        let _ = pieces.blocking_send(Ok(out.into()));
        Ok(())
    }
}

/// Writes a chunk's rows, or adds them to the bucket and writes full buckets.
fn write(
    reader: &Reader,
    axis: &mut TimeAxis,
    chunk: &Chunk,
    decimated: bool,
    writer: &mut TextWriter,
    bucket: &mut Bucket,
    out: &mut String,
) -> Result<(), StoreError> {
    for (index, time_ns) in axis.times(reader, chunk)?.into_iter().enumerate() {
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
    fn channels_are_named_and_each_taken_once() {
        assert_eq!(channels("gyro_x, accel_z,gyro_x").unwrap(), [Channel::GyroX, Channel::AccelZ]);
        for text in ["", "gyro", "gyro_x,", "GYRO_X"] {
            assert!(channels(text).is_err(), "{text}");
        }
    }

    #[test]
    fn the_form_that_is_liked_best_is_taken() {
        for (accept, format) in [
            (None, Some(TextFormat::Json)),
            (Some("*/*"), Some(TextFormat::Json)),
            (Some("text/csv"), Some(TextFormat::Csv)),
            (Some("application/json;q=0.5, text/csv"), Some(TextFormat::Csv)),
            (Some("text/html, application/x-ndjson;q=0.1"), Some(TextFormat::Ndjson)),
            (Some("image/png"), None),
            (Some("application/json;q=0"), None),
            (Some("text/csv;q=x"), None),
        ] {
            assert_eq!(accepted(accept), format, "{accept:?}");
        }
    }
}
