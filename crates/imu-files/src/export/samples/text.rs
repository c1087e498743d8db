//! Rows of samples as text: CSV (docs/formats.md), NDJSON, or one JSON document.
//!
//! Times are exact to the nanosecond and values are the shortest decimals that are read back as the same number:
//! exported data that is imported again is identical bit for bit.

use super::{ExportError, Rows, Sink, Tally};
use imu_core::sample::Channel;
use imu_core::variants;
use std::fmt::Write as _;
use std::io::Write;

/// The text formats of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum TextFormat {
    /// One document.
    Json,
    /// The documented table.
    Csv,
    /// A document per row.
    Ndjson,
}

impl TextFormat {
    /// All formats.
    pub const ALL: [Self; 3] = variants();

    /// Returns the name in queries.
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// Returns the name in HTTP's headers.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Csv => "text/csv",
            Self::Ndjson => "application/x-ndjson",
        }
    }
}

/// The contents of the document besides its rows.
#[derive(Debug, Clone, PartialEq)]
pub struct TextHead {
    /// Id of the capture.
    pub capture: i64,
    /// The origin of `time_s`, RFC 3339.
    pub origin: String,
    /// Output rate in Hz.
    pub rate_hz: Option<f64>,
    /// Number of samples in the range.
    pub samples: u64,
    /// Number of samples per row, if rows are minima and maxima of several.
    pub bucket: Option<u64>,
}

/// Writes rows of a time and one value per channel, or its minimum and maximum.
#[derive(Debug, Clone)]
pub struct TextWriter {
    format: TextFormat,
    names: Vec<String>,
    units: Vec<&'static str>,
    first: bool,
}

impl TextWriter {
    /// Creates a writer of these channels in this order, with two columns each if rows are minima and maxima.
    pub fn new(format: TextFormat, channels: &[Channel], min_max: bool) -> Self {
        let suffixes: &[&str] = if min_max { &["_min", "_max"] } else { &[""] };
        let (mut names, mut units) = (vec!["time_s".to_owned()], vec!["s"]);
        for channel in channels {
            for suffix in suffixes {
                // In CSV only the header states the unit.
                let unit = if format == TextFormat::Csv { channel.csv_suffix() } else { "" };
                names.push(format!("{}{suffix}{unit}", channel.name()));
                units.push(channel.unit());
            }
        }
        Self { format, names, units, first: true }
    }

    /// Adds a column behind the others, whose value is the last one of each row.
    #[must_use]
    pub fn with_column(mut self, name: &str, unit: &'static str) -> Self {
        self.names.push(name.to_owned());
        self.units.push(unit);
        self
    }

    /// Writes the text before the rows.
    pub fn head(&self, out: &mut String, head: &TextHead) {
        match self.format {
            TextFormat::Csv => self.header(out),
            TextFormat::Ndjson => {}
            TextFormat::Json => {
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

    /// Writes the line that names the columns.
    fn header(&self, out: &mut String) {
        out.push_str(&self.names.join(","));
        out.push('\n');
    }

    /// Writes one row; a value that is not finite is absent.
    pub fn row(&mut self, out: &mut String, time_ns: i64, values: impl Iterator<Item = f64>) {
        match self.format {
            TextFormat::Csv => {
                seconds(out, time_ns);
                for value in values {
                    out.push(',');
                    number(out, value, "");
                }
            }
            TextFormat::Ndjson => {
                out.push_str("{\"time_s\":");
                seconds(out, time_ns);
                for (name, value) in self.names.iter().skip(1).zip(values) {
                    // Writing to a text cannot fail.
                    let _ = write!(out, ",\"{name}\":");
                    number(out, value, "null");
                }
                out.push('}');
            }
            TextFormat::Json => {
                out.push_str(if self.first { "\n[" } else { ",\n[" });
                seconds(out, time_ns);
                for value in values {
                    out.push(',');
                    number(out, value, "null");
                }
                out.push(']');
            }
        }
        if self.format != TextFormat::Json {
            out.push('\n');
        }
        self.first = false;
    }

    /// Writes the text behind the rows.
    pub fn tail(&self, out: &mut String) {
        if self.format == TextFormat::Json {
            out.push_str("]}\n");
        }
    }
}

/// Samples as lines of text, streamed.
#[derive(Debug)]
pub struct TextSink<W: Write> {
    to: W,
    writer: TextWriter,
    /// Added to every time, ns.
    origin_ns: i64,
    out: String,
}

impl<W: Write> TextSink<W> {
    /// Begins CSV or NDJSON; `origin_ns` is added to every time.
    ///
    /// # Errors
    /// The error that the destination reports.
    pub fn begin(to: W, format: TextFormat, channels: &[Channel], origin_ns: i64) -> Result<Self, ExportError> {
        let (writer, mut out) = (TextWriter::new(format, channels, false), String::new());
        if format == TextFormat::Csv {
            writer.header(&mut out);
        }
        Ok(Self { to, writer, origin_ns, out })
    }

    fn pass_on(&mut self) -> Result<(), ExportError> {
        self.to.write_all(self.out.as_bytes())?;
        self.out.clear();
        Ok(())
    }
}

impl<W: Write> Sink for TextSink<W> {
    fn rows(&mut self, rows: Rows<'_>) -> Result<(), ExportError> {
        for (index, time_ns) in rows.time_ns.iter().enumerate() {
            let values = rows.columns.iter().filter_map(|column| column.get(index).copied());
            self.writer.row(&mut self.out, time_ns.saturating_add(self.origin_ns), values);
        }
        self.pass_on()
    }

    fn finish(mut self: Box<Self>, _: &Tally) -> Result<(), ExportError> {
        self.pass_on()?;
        Ok(self.to.flush()?)
    }
}

/// Writes nanoseconds as seconds, exactly, without trailing zeros.
fn seconds(out: &mut String, ns: i64) {
    let sign = if ns < 0 { "-" } else { "" };
    let (whole, rest) = (ns.unsigned_abs() / 1_000_000_000, ns.unsigned_abs() % 1_000_000_000);
    let _ = write!(out, "{sign}{whole}");
    if rest > 0 {
        let digits = format!("{rest:09}");
        let _ = write!(out, ".{}", digits.trim_end_matches('0'));
    }
}

/// Writes the shortest decimal that is read back as the same value.
fn number(out: &mut String, value: f64, absent: &str) {
    if value.is_finite() {
        let _ = write!(out, "{value}");
    } else {
        out.push_str(absent);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(format: TextFormat, min_max: bool) -> String {
        let mut writer = TextWriter::new(format, &[Channel::GyroX, Channel::Temperature], min_max);
        let head = TextHead {
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
    fn csv_has_the_documented_columns() {
        assert_eq!(
            written(TextFormat::Csv, false),
            "time_s,gyro_x_rad_s,temperature_c\n0,0.0000001,\n0.025,-0.001222,21.5\n"
        );
        assert_eq!(
            written(TextFormat::Csv, true),
            "time_s,gyro_x_min_rad_s,gyro_x_max_rad_s,temperature_min_c,temperature_max_c\n"
        );
    }

    #[test]
    fn json_is_one_document_and_ndjson_one_per_row() {
        let document: serde_json::Value = serde_json::from_str(&written(TextFormat::Json, false)).unwrap();
        assert_eq!(document["columns"], serde_json::json!(["time_s", "gyro_x", "temperature"]));
        assert_eq!(document["units"], serde_json::json!(["s", "rad/s", "°C"]));
        assert_eq!(document["samples"], serde_json::json!([[0, 1e-7, null], [0.025, -0.001222, 21.5]]));
        assert_eq!(document["samples_per_row"], 1);
        let lines: Vec<serde_json::Value> =
            written(TextFormat::Ndjson, false).lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(lines[1], serde_json::json!({"time_s": 0.025, "gyro_x": -0.001222, "temperature": 21.5}));
        let empty: serde_json::Value = serde_json::from_str(&written(TextFormat::Json, true)).unwrap();
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
}
