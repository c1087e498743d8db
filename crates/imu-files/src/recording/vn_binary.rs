//! Raw bytes of a VN-100's serial line: binary frames, with or without lines between them.
//!
//! The decoder that reads a port reads them, so that checksums decide and a damaged frame costs only itself. Stamps are
//! the sensor's own time (TimeStartup) if the output carries it. If that clock restarts, the sensor was reset. Time
//! then continues one step behind the last sample, since the length of the absence is unknown, and the restart is
//! counted.

use super::error::{RecordingError, read_error};
use super::input::Input;
use super::rows::{Decimals, Rejected, Row, Rows};
use super::stamps::RowStamps;
use imu_core::sample::{DiscardCause, Sample};
use std::collections::VecDeque;
use std::io::BufRead;
use std::path::PathBuf;
use vn100_proto::{BinaryAcceptance, Decoder, DecoderOptions, Event, MeasurementKind};

/// The number of frames at the start of a file that identify it as raw bytes: one may be chance.
const FRAMES_MIN: u64 = 3;
/// Bytes of a rejected frame that are shown.
const SHOWN_BYTES: usize = 80;
/// A clock that goes back by more than this has restarted, ns: frames of one sensor never overtake each other.
const RESTART_NS: u64 = 500_000_000;

/// Returns whether the beginning of a file holds binary frames.
pub(super) fn is_binary(head: &[u8]) -> bool {
    let mut frames = 0;
    let mut decoder = decoder();
    decoder.push(head, &mut |event: Event<'_>| {
        if let Event::Measurement(measurement) = event
            && matches!(measurement.kind, MeasurementKind::Binary(_))
        {
            frames += 1;
        }
    });
    frames >= FRAMES_MIN
}

fn decoder() -> Decoder {
    Decoder::new(DecoderOptions { binary: BinaryAcceptance::Any })
}

/// The frames and lines of such a file, one at a time.
pub(super) struct BinaryRows {
    file: PathBuf,
    reader: Box<dyn BufRead>,
    decoder: Decoder,
    found: VecDeque<Row>,
    /// Bytes that were pushed into the decoder.
    at: u64,
    clock: DeviceClock,
    decimals: Decimals,
    ended: bool,
}

/// The sensor's time, continued across restarts.
#[derive(Debug, Default)]
struct DeviceClock {
    last_ns: Option<u64>,
    /// The offset added since the last restart.
    offset_ns: u64,
    step_ns: u64,
    restarts: u64,
}

impl DeviceClock {
    /// Returns the time since the sensor's clock first began.
    fn stamp_ns(&mut self, device_ns: u64) -> i64 {
        let mut now_ns = device_ns.saturating_add(self.offset_ns);
        if let Some(last_ns) = self.last_ns {
            if now_ns.saturating_add(RESTART_NS) < last_ns {
                self.restarts += 1;
                now_ns = last_ns.saturating_add(self.step_ns);
                self.offset_ns = now_ns.saturating_sub(device_ns);
            } else if now_ns > last_ns {
                self.step_ns = now_ns - last_ns;
            }
        }
        self.last_ns = Some(now_ns.max(self.last_ns.unwrap_or(0)));
        i64::try_from(now_ns).unwrap_or(i64::MAX)
    }
}

impl BinaryRows {
    pub(super) fn open(input: &Input) -> Result<Self, RecordingError> {
        Ok(Self {
            file: input.path().to_owned(),
            reader: input.open()?,
            decoder: decoder(),
            found: VecDeque::new(),
            at: 0,
            clock: DeviceClock::default(),
            decimals: Decimals::default(),
            ended: false,
        })
    }

    /// Returns how often the sensor's clock restarted so far.
    pub(super) fn restarts(&self) -> u64 {
        self.clock.restarts
    }

    fn read(&mut self) -> Result<(), RecordingError> {
        let bytes = self.reader.fill_buf().map_err(|source| read_error(&self.file, self.at, source))?;
        let (found, clock, decimals) = (&mut self.found, &mut self.clock, &mut self.decimals);
        // Rejected data has been read by now, but its beginning is not known exactly.
        let at = self.at + 1;
        let mut take = |event: Event<'_>| match event {
            Event::Measurement(measurement) => {
                let sample = measurement.to_sample(0, 0);
                if sample.channels().is_empty() {
                    found.push_back(Row::Rejected(Rejected::new(
                        at,
                        DiscardCause::UnexpectedFormat,
                        "no channel",
                        false,
                    )));
                    return;
                }
                for channel in sample.channels().iter() {
                    decimals.note_count(channel, measurement.decimals(channel));
                }
                found.push_back(row(at, sample, clock));
            }
            Event::Rejected { cause, bytes } => {
                let garbage = cause == DiscardCause::GarbageBytes;
                let shown: Vec<String> = bytes.iter().take(SHOWN_BYTES).map(|byte| format!("{byte:02x}")).collect();
                let mut rejected = Rejected::new(at, cause, &shown.join(" "), !garbage);
                rejected.bytes = bytes.len() as u64;
                found.push_back(Row::Rejected(rejected));
            }
            _ => found.push_back(Row::Aside),
        };
        if bytes.is_empty() {
            self.decoder.flush(&mut take);
            self.ended = true;
            return Ok(());
        }
        let read = bytes.len();
        self.decoder.push(bytes, &mut take);
        self.reader.consume(read);
        self.at += read as u64;
        Ok(())
    }
}

fn row(line: u64, mut sample: Sample, clock: &mut DeviceClock) -> Row {
    // The time is set again, counted from the first stamp, if the stamps are used.
    let device_ns = sample.device_time_ns.take();
    let stamps = device_ns.map(|device_ns| RowStamps::one(clock.stamp_ns(device_ns))).unwrap_or_default();
    Row::Sample { line, stamps, sample }
}

impl Rows for BinaryRows {
    fn next_row(&mut self) -> Result<Option<Row>, RecordingError> {
        while self.found.is_empty() && !self.ended {
            self.read()?;
        }
        Ok(self.found.pop_front())
    }

    fn decimals(&self) -> &Decimals {
        &self.decimals
    }
}
