//! Pictures drawn from the samples and gaps themselves.

use super::Window;
use crate::plot::{Course, Density, Gap, Gaps, NamedLine};
use crate::store::{GapRow, PageRequest, Reader, SampleRange, StoreError, chunks};
use imu_core::sample::{Channel, Triad};
use imu_files::export::samples::Bucket;
use imu_noise::welch::Welch;

/// The number of stretches in a course: about as many as a picture has columns.
const STRETCHES: u64 = 1000;
/// Samples read at once.
const CHUNK: usize = 16_384;
/// Bins closer than this share of their frequency form one point of a spectrum.
const APART: f64 = 0.02;
/// The maximum number of gaps drawn: the longest lists come from minutes of trouble.
const GAPS_MAX: usize = 2000;

/// Returns the picture of the times of missing samples.
pub(super) fn gaps(reader: &Reader, capture: &str) -> Result<String, StoreError> {
    let mut range = SampleRange::read(reader, capture, None, None)?;
    let (gaps, [_, last_s]) = (all_gaps(reader, &range, [f64::MIN, f64::MAX])?, range.ends_s(reader)?);
    // The last entry may be a gap.
    let length_s = gaps.iter().map(|gap| gap.within_s[1]).fold(last_s, f64::max);
    let causes = reader.missing_by_cause(range.capture.id)?;
    Ok(Gaps { length_s, samples: range.samples(), count: range.capture.gaps, causes, gaps }.svg())
}

/// Returns the gaps that overlap this time, s since the first sample; only the first ones if there are very many.
fn all_gaps(reader: &Reader, range: &SampleRange, within_s: [f64; 2]) -> Result<Vec<Gap>, StoreError> {
    let mut all: Vec<Gap> = Vec::new();
    let mut cursor = None;
    let of = |row: GapRow| Gap {
        within_s: [row.from.0, row.to.0].map(|utc_ns| (utc_ns - range.axis.origin_ns()) as f64 / 1e9),
        missing: row.missing,
        cause: row.cause,
    };
    loop {
        let page = reader.gaps(range.capture.id, &PageRequest { limit: None, cursor })?;
        let inside = |gap: &Gap| gap.within_s[1] > within_s[0] && gap.within_s[0] < within_s[1];
        all.extend(page.rows.into_iter().map(of).filter(inside));
        cursor = page.next;
        if cursor.is_none() || all.len() >= GAPS_MAX {
            return Ok(all);
        }
    }
}

/// Returns the picture of a channel over time.
pub(super) fn course(reader: &Reader, capture: &str, channel: Channel, window: Window) -> Result<String, StoreError> {
    let range = &mut SampleRange::read(reader, capture, window.from, window.to)?;
    let mut bucket = Bucket::new(range.samples().div_ceil(STRETCHES).max(1), 1);
    let mut points: Vec<(f64, f64, f64)> = Vec::new();
    let mut take = |bucket: &mut Bucket| {
        if let Some((time_ns, values)) = bucket.row() {
            let ends: Vec<f64> = values.collect();
            points.push((time_ns as f64 / 1e9, ends[0], ends[1]));
        }
    };
    let id = range.capture.id;
    let read = |seq, limit| reader.read_samples(id, seq, limit, &[channel]);
    for chunk in chunks(range.from_seq..range.to_seq, CHUNK, read) {
        let chunk = chunk?;
        let times = range.axis.times(reader, &chunk)?;
        let values = chunk.columns.first().map(Vec::as_slice).unwrap_or_default();
        for (time_ns, value) in times.into_iter().zip(values) {
            if bucket.take(time_ns, std::iter::once(*value)) {
                take(&mut bucket);
            }
        }
    }
    take(&mut bucket);
    let ends_s = range.ends_s(reader)?;
    let gaps = all_gaps(reader, range, ends_s)?;
    Ok(Course { channel: channel.name(), unit: channel.unit(), points, gaps }.svg())
}

/// Returns the number of samples of each segment; only of the first ones if there are very many.
pub(super) fn stretches(reader: &Reader, capture: i64) -> Result<Vec<u64>, StoreError> {
    Ok(reader.segments(capture, &PageRequest::first())?.rows.iter().map(|segment| segment.samples).collect())
}

/// Returns the picture of a triad's power spectra, with `lines` of its channels by name.
pub(super) fn density(
    reader: &Reader,
    capture: &str,
    triad: Triad,
    lines: &[NamedLine<'_>],
) -> Result<String, StoreError> {
    let range = &SampleRange::read(reader, capture, None, None)?;
    let Some(rate_hz) = range.capture.rate_hz.filter(|rate_hz| *rate_hz > 0.0) else { return Ok(String::new()) };
    let there = |channel: &Channel| range.capture.channels.contains(channel);
    let channels: Vec<Channel> = triad.channels().into_iter().filter(there).collect();
    let stretches = stretches(reader, range.capture.id)?;
    let mut spectra: Vec<Welch> = channels.iter().map(|_| Welch::new(&stretches, rate_hz)).collect();
    let mut segment = None;
    let read = |seq, limit| reader.read_chunk(range.capture.id, seq, limit, &channels);
    for chunk in chunks(range.from_seq..range.to_seq, CHUNK, read) {
        let chunk = chunk?;
        let mut from = 0;
        while let Some(own) = chunk.segment.get(from).copied() {
            let to = from + chunk.segment[from..].iter().take_while(|other| **other == own).count();
            if segment.replace(own) != Some(own) {
                spectra.iter_mut().for_each(Welch::interrupt);
            }
            for (welch, values) in spectra.iter_mut().zip(&chunk.columns) {
                welch.push(&values[from..to]);
            }
            from = to;
        }
    }
    let mut frequency_hz = Vec::new();
    let mut drawn = Vec::new();
    for (channel, welch) in channels.iter().zip(&spectra) {
        let Some((hz, density)) = welch.density(APART) else { continue };
        frequency_hz = hz;
        // Two-sided, as N is: white noise has the value N.
        let two_sided = density.into_iter().map(|one_sided| one_sided / std::f64::consts::SQRT_2);
        drawn.push((*channel, two_sided.collect()));
    }
    let title = format!("Power spectrum, {}", triad.name());
    let unit = triad.channels()[0].unit();
    Ok(Density { title: &title, unit, frequency_hz, channels: drawn, lines }.svg())
}
