//! Rows of samples as text: CSV (contract, section 4), NDJSON, or one JSON document. Pure.

use crate::sample::Channel;
use std::fmt::Write;

/// The forms of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Json,
    Csv,
    Ndjson,
}

impl Format {
    pub(super) const ALL: [Self; 3] = [Self::Json, Self::Csv, Self::Ndjson];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Csv => "csv",
            Self::Ndjson => "ndjson",
        }
    }

    pub(super) fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Csv => "text/csv",
            Self::Ndjson => "application/x-ndjson",
        }
    }

    /// The form that an `Accept` header likes best; JSON where it says nothing. `None` where it takes none of them.
    pub(super) fn accepted(accept: Option<&str>) -> Option<Self> {
        let Some(accept) = accept else { return Some(Self::Json) };
        let mut best: Option<(Self, f64)> = None;
        for range in accept.split(',') {
            let mut parts = range.split(';').map(str::trim);
            let media = parts.next().unwrap_or_default().to_ascii_lowercase();
            let quality = parts.find_map(|part| part.strip_prefix("q=")).map_or(1.0, |q| q.parse().unwrap_or(0.0));
            let format = match media.as_str() {
                "*/*" | "application/*" | "application/json" => Self::Json,
                "text/csv" | "text/*" => Self::Csv,
                "application/x-ndjson" | "application/ndjson" => Self::Ndjson,
                _ => continue,
            };
            if quality > best.map_or(0.0, |(_, quality)| quality) {
                best = Some((format, quality));
            }
        }
        best.map(|(format, _)| format)
    }
}

/// What the document says besides its rows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Head {
    pub capture: i64,
    /// RFC 3339: what `time_s` counts from.
    pub origin: String,
    pub rate_hz: Option<f64>,
    /// Samples in the range.
    pub samples: u64,
    /// Samples per row where rows are minima and maxima of several.
    pub bucket: Option<u64>,
}

/// Writes rows of a time and one value per channel, or its minimum and maximum.
#[derive(Debug, Clone)]
pub(super) struct Writer {
    format: Format,
    names: Vec<String>,
    units: Vec<&'static str>,
    first: bool,
}

impl Writer {
    pub(super) fn new(format: Format, channels: &[Channel], min_max: bool) -> Self {
        let suffixes: &[&str] = if min_max { &["_min", "_max"] } else { &[""] };
        let (mut names, mut units) = (vec!["time_s".to_owned()], vec!["s"]);
        for channel in channels {
            for suffix in suffixes {
                // In CSV the header alone says the unit.
                let unit = if format == Format::Csv { channel.csv_suffix() } else { "" };
                names.push(format!("{}{suffix}{unit}", channel.name()));
                units.push(channel.unit());
            }
        }
        Self { format, names, units, first: true }
    }

    pub(super) fn head(&self, out: &mut String, head: &Head) {
        match self.format {
            Format::Csv => {
                out.push_str(&self.names.join(","));
                out.push('\n');
            }
            Format::Ndjson => {}
            Format::Json => {
                let head = serde_json::json!({
                    "capture": head.capture, "origin": head.origin, "rate_hz": head.rate_hz, "range_samples": head.samples,
                    "samples_per_row": head.bucket.unwrap_or(1), "columns": self.names, "units": self.units,
                    "next": null,
                })
                .to_string();
                // The rows come last, inside the same object.
                out.push_str(head.strip_suffix('}').unwrap_or(&head));
                out.push_str(",\"samples\":[");
            }
        }
    }

    /// One row; a value that is not finite is absent.
    pub(super) fn row(&mut self, out: &mut String, time_ns: i64, values: impl Iterator<Item = f64>) {
        match self.format {
            Format::Csv => {
                seconds(out, time_ns);
                for value in values {
                    out.push(',');
                    number(out, value, "");
                }
            }
            Format::Ndjson => {
                out.push_str("{\"time_s\":");
                seconds(out, time_ns);
                for (name, value) in self.names.iter().skip(1).zip(values) {
                    // Writing to a text cannot fail.
                    let _ = write!(out, ",\"{name}\":");
                    number(out, value, "null");
                }
                out.push('}');
            }
            Format::Json => {
                out.push_str(if self.first { "\n[" } else { ",\n[" });
                seconds(out, time_ns);
                for value in values {
                    out.push(',');
                    number(out, value, "null");
                }
                out.push(']');
            }
        }
        if self.format != Format::Json {
            out.push('\n');
        }
        self.first = false;
    }

    pub(super) fn tail(&self, out: &mut String) {
        if self.format == Format::Json {
            out.push_str("]}\n");
        }
    }
}

/// Nanoseconds as seconds, exactly, without zeros at the end.
fn seconds(out: &mut String, ns: i64) {
    let sign = if ns < 0 { "-" } else { "" };
    let (whole, rest) = (ns.unsigned_abs() / 1_000_000_000, ns.unsigned_abs() % 1_000_000_000);
    let _ = write!(out, "{sign}{whole}");
    if rest > 0 {
        let digits = format!("{rest:09}");
        let _ = write!(out, ".{}", digits.trim_end_matches('0'));
    }
}

/// The shortest decimal that is read back as the same value.
fn number(out: &mut String, value: f64, absent: &str) {
    if value.is_finite() {
        let _ = write!(out, "{value}");
    } else {
        out.push_str(absent);
    }
}

/// Minimum and maximum of each channel over a number of consecutive samples.
#[derive(Debug, Clone)]
pub(super) struct Bucket {
    size: u64,
    count: u64,
    first_ns: i64,
    last_ns: i64,
    extremes: Vec<(f64, f64)>,
}

impl Bucket {
    pub(super) fn new(size: u64, channels: usize) -> Self {
        Self { size, count: 0, first_ns: 0, last_ns: 0, extremes: vec![(f64::NAN, f64::NAN); channels] }
    }

    /// Takes a sample; answers whether the bucket is full.
    pub(super) fn take(&mut self, time_ns: i64, values: impl Iterator<Item = f64>) -> bool {
        if self.count == 0 {
            self.first_ns = time_ns;
            self.extremes.fill((f64::NAN, f64::NAN));
        }
        self.last_ns = time_ns;
        self.count += 1;
        for ((low, high), value) in self.extremes.iter_mut().zip(values) {
            // f64::min and max leave a NaN for the number on the other side.
            (*low, *high) = (low.min(value), high.max(value));
        }
        self.count >= self.size
    }

    /// The row of what was taken, at the middle of its time; `None` where nothing was.
    pub(super) fn row(&mut self) -> Option<(i64, impl Iterator<Item = f64> + '_)> {
        if self.count == 0 {
            return None;
        }
        self.count = 0;
        let middle_ns = self.first_ns + (self.last_ns - self.first_ns) / 2;
        Some((middle_ns, self.extremes.iter().flat_map(|(low, high)| [*low, *high])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(format: Format, min_max: bool) -> String {
        let mut writer = Writer::new(format, &[Channel::GyroX, Channel::Temperature], min_max);
        let head = Head {
            capture: 7,
            origin: "2026-11-21T20:00:00.000000000Z".to_owned(),
            rate_hz: Some(40.0),
            samples: 3,
            bucket: None,
        };
        let mut out = String::new();
        writer.head(&mut out, &head);
        if !min_max {
            writer.row(&mut out, 0, [1e-7, f64::NAN].into_iter());
            writer.row(&mut out, 25_000_000, [-0.001_222, 21.5].into_iter());
        }
        writer.tail(&mut out);
        out
    }

    #[test]
    fn csv_has_the_columns_of_the_contract() {
        assert_eq!(
            written(Format::Csv, false),
            "time_s,gyro_x_rad_s,temperature_c\n0,0.0000001,\n0.025,-0.001222,21.5\n"
        );
        assert_eq!(
            written(Format::Csv, true),
            "time_s,gyro_x_min_rad_s,gyro_x_max_rad_s,temperature_min_c,temperature_max_c\n"
        );
    }

    #[test]
    fn json_is_one_document_and_ndjson_one_per_row() {
        let document: serde_json::Value = serde_json::from_str(&written(Format::Json, false)).unwrap();
        assert_eq!(document["columns"], serde_json::json!(["time_s", "gyro_x", "temperature"]));
        assert_eq!(document["units"], serde_json::json!(["s", "rad/s", "°C"]));
        assert_eq!(document["samples"], serde_json::json!([[0, 1e-7, null], [0.025, -0.001222, 21.5]]));
        assert_eq!(document["samples_per_row"], 1);
        let lines: Vec<serde_json::Value> =
            written(Format::Ndjson, false).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(lines[1], serde_json::json!({"time_s": 0.025, "gyro_x": -0.001222, "temperature": 21.5}));
        let empty: serde_json::Value = serde_json::from_str(&written(Format::Json, true)).unwrap();
        assert_eq!(empty["samples"], serde_json::json!([]));
    }

    #[test]
    fn seconds_are_exact() {
        for (ns, text) in [(0, "0"), (1, "0.000000001"), (-1_500_000_000, "-1.5"), (18_000_000_000_000, "18000")] {
            let mut out = String::new();
            seconds(&mut out, ns);
            assert_eq!(out, text);
        }
    }

    #[test]
    fn a_bucket_keeps_the_extremes_and_forgets_them() {
        let mut bucket = Bucket::new(2, 1);
        assert!(!bucket.take(0, [f64::NAN].into_iter()));
        assert!(bucket.take(10, [3.0].into_iter()));
        let (middle_ns, row) = bucket.row().unwrap();
        assert_eq!((middle_ns, row.collect::<Vec<_>>()), (5, vec![3.0, 3.0]));
        assert!(bucket.row().is_none());
        assert!(!bucket.take(20, [-1.0].into_iter()));
        assert!(bucket.take(30, [1.0].into_iter()));
        assert_eq!(bucket.row().unwrap().1.collect::<Vec<_>>(), [-1.0, 1.0]);
    }

    #[test]
    fn the_form_that_is_liked_best_is_taken() {
        for (accept, format) in [
            (None, Some(Format::Json)),
            (Some("*/*"), Some(Format::Json)),
            (Some("text/csv"), Some(Format::Csv)),
            (Some("application/json;q=0.5, text/csv"), Some(Format::Csv)),
            (Some("text/html, application/x-ndjson;q=0.1"), Some(Format::Ndjson)),
            (Some("image/png"), None),
            (Some("application/json;q=0"), None),
            (Some("text/csv;q=x"), None),
        ] {
            assert_eq!(Format::accepted(accept), format, "{accept:?}");
        }
    }
}
