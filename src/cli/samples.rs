//! Samples: reads the samples to export, from a capture of the database or a recording's file, block by block.

use super::Context;
use super::part::Part;
use super::source::{Source, has_rejected, note_assumed_rate, note_assumed_time};
use crate::store::{Chunk, GapRow, PageRequest, Reader, SOFTWARE, SampleRange, StoreError};
use imu_core::sample::{Channel, Gap, Record, Sample, SensorDescription};
use imu_files::export::samples::{About, Rows, Tally};
use imu_files::recording::{Item, KeepOn, Recording, RecordingAccountant, Stamps};

/// Samples per block: one short query, some 1 MB.
const BLOCK: usize = 8192;

/// Samples to be exported.
pub(super) struct Samples {
    /// The facts about the capture.
    pub about: About,
    /// Number of samples to come: exact for a capture, a maximum for a recording.
    pub samples: u64,
    /// Whether frames or lines were rejected on the way in.
    pub rejected: bool,
    held: Held,
}

/// The source of the samples.
enum Held {
    Capture { reader: Box<Reader>, range: Box<SampleRange> },
    Recording { recording: Box<Recording>, part: Part },
}

impl Samples {
    /// Returns a file if one of that name exists, read while `keep_on` allows it, else a capture.
    ///
    /// # Errors
    /// If the source cannot be read, or does not have the channels.
    pub(super) fn open(
        context: &Context,
        named: &str,
        rate_hz: Option<f64>,
        part: Part,
        keep_on: KeepOn,
    ) -> anyhow::Result<Self> {
        match Source::open(context, named, rate_hz, keep_on)? {
            Source::Recording(recording) => Self::of_recording(named, recording, part),
            Source::Capture(reader, row) => {
                let range = SampleRange::read(&reader, &row.id.to_string(), part.from, part.to)?;
                let channels = Channel::chosen(part.channels.as_deref(), &range.capture.channels)?;
                Ok(Self::of_range(*reader, range, channels)?)
            }
        }
    }

    /// Returns a whole capture with these columns, whether it has them or not.
    ///
    /// # Errors
    /// The database's error.
    pub(super) fn of_capture(context: &Context, id: i64, channels: Vec<Channel>) -> anyhow::Result<Self> {
        let reader = context.reader()?;
        let range = SampleRange::read(&reader, &id.to_string(), None, None)?;
        Ok(Self::of_range(reader, range, channels)?)
    }

    /// Returns a range of a capture's samples with these columns.
    ///
    /// # Errors
    /// The database's error.
    pub(super) fn of_range(reader: Reader, range: SampleRange, channels: Vec<Channel>) -> Result<Self, StoreError> {
        let capture = &range.capture;
        let about = About {
            id: Some(capture.id),
            database: reader.identity()?,
            name: capture.name.clone(),
            note: capture.note.clone(),
            origin_ns: range.axis.origin_ns(),
            rate_hz: capture.rate_hz,
            channels,
            sensor: capture.sensor.clone(),
            software: capture.software.clone(),
            writer: SOFTWARE.to_owned(),
        };
        Ok(Self {
            about,
            samples: range.samples(),
            rejected: capture.has_rejected(),
            held: Held::Capture { reader: Box::new(reader), range: Box::new(range) },
        })
    }

    fn of_recording(named: &str, recording: Box<Recording>, part: Part) -> anyhow::Result<Self> {
        let info = recording.info();
        let has: Vec<Channel> = info.channels.iter().collect();
        if info.rate_assumed {
            note_assumed_rate(named, info.rate_hz);
        }
        if info.stamps != Stamps::Unix {
            note_assumed_time(named);
        }
        let about = About {
            id: None,
            database: String::new(),
            name: named.to_owned(),
            note: None,
            origin_ns: info.started_utc_ns,
            rate_hz: Some(info.rate_hz),
            channels: Channel::chosen(part.channels.as_deref(), &has)?,
            sensor: SensorDescription::default(),
            software: SOFTWARE.to_owned(),
            writer: SOFTWARE.to_owned(),
        };
        Ok(Self {
            about,
            samples: info.samples,
            rejected: has_rejected(info),
            held: Held::Recording { recording, part },
        })
    }

    /// Passes the samples to `take` block by block, and returns their description and the number of samples missing
    /// between them.
    ///
    /// # Errors
    /// If the source cannot be read, and the errors of `take`.
    pub(super) fn each(self, take: &mut dyn FnMut(Block) -> anyhow::Result<()>) -> anyhow::Result<Tally> {
        match self.held {
            Held::Capture { reader, range } => of_capture(&reader, *range, &self.about.channels, take),
            Held::Recording { recording, part } => of_recording(&recording, &part, &self.about, take),
        }
    }
}

fn of_capture(
    reader: &Reader,
    range: SampleRange,
    channels: &[Channel],
    take: &mut dyn FnMut(Block) -> anyhow::Result<()>,
) -> anyhow::Result<Tally> {
    let id = range.capture.id;
    let read = read_capture(reader, range, channels, take);
    // If the capture was deleted meanwhile, its rows go step by step: the rest is neither damage nor a capture.
    match reader.capture(id) {
        Err(gone @ StoreError::NoSuchCapture(_)) => Err(gone.into()),
        _ => read,
    }
}

fn read_capture(
    reader: &Reader,
    range: SampleRange,
    channels: &[Channel],
    take: &mut dyn FnMut(Block) -> anyhow::Result<()>,
) -> anyhow::Result<Tally> {
    let SampleRange { capture, mut axis, from_seq, to_seq } = range;
    let mut next_seq = from_seq;
    while next_seq < to_seq {
        let limit = BLOCK.min(usize::try_from(to_seq - next_seq).unwrap_or(BLOCK));
        let chunk: Chunk = reader.read_samples(capture.id, next_seq, limit, channels)?;
        if chunk.is_empty() {
            // The capture was deleted meanwhile.
            return Err(StoreError::NoSuchCapture(capture.id.to_string()).into());
        }
        let time_ns = axis.times(reader, &chunk)?;
        let first_seq = std::mem::replace(&mut next_seq, chunk.next_seq());
        let device_ns = chunk.times.unwrap_or_default().device_ns;
        take(Block { first_seq, segment: chunk.segment, time_ns, device_ns, columns: chunk.columns })?;
    }
    let mut tally = Tally::of(to_seq - from_seq);
    let mut page = PageRequest::first();
    loop {
        let gaps = reader.gaps(capture.id, &page)?;
        let within = |gap: &GapRow| gap.before_seq > from_seq && gap.before_seq < to_seq;
        gaps.rows.into_iter().filter(within).for_each(|gap| tally.gap(gap_of(&gap)));
        let Some(cursor) = gaps.next else { return Ok(tally) };
        page.cursor = Some(cursor);
    }
}

fn gap_of(row: &GapRow) -> Gap {
    Gap {
        before_seq: row.before_seq,
        from_utc_ns: row.from.0,
        to_utc_ns: row.to.0,
        device_ns: row.from_device_ns.zip(row.to_device_ns),
        missing: row.missing,
        missing_exact: row.missing_exact,
        cause: row.cause,
    }
}

/// Consecutive samples that were read.
pub(super) struct Block {
    first_seq: u64,
    segment: Vec<u32>,
    time_ns: Vec<i64>,
    device_ns: Vec<Option<u64>>,
    columns: Vec<Vec<f64>>,
}

impl Block {
    fn push(&mut self, seq: u64, segment: u32, time_ns: i64, sample: &Sample, channels: &[Channel]) {
        if self.segment.is_empty() {
            self.first_seq = seq;
        }
        self.segment.push(segment);
        self.time_ns.push(time_ns);
        self.device_ns.push(sample.device_time_ns);
        for (column, channel) in self.columns.iter_mut().zip(channels) {
            // A database keeps no sign of a zero, so that the same values are exported without one.
            column.push(sample.get(*channel).unwrap_or(f64::NAN) + 0.0);
        }
    }

    fn of(channels: usize) -> Self {
        Self {
            first_seq: 0,
            segment: Vec::new(),
            time_ns: Vec::new(),
            device_ns: Vec::new(),
            columns: vec![Vec::new(); channels],
        }
    }

    /// Returns the rows to write.
    pub(super) fn rows(&self) -> Rows<'_> {
        Rows {
            first_seq: self.first_seq,
            segment: &self.segment,
            time_ns: &self.time_ns,
            device_ns: &self.device_ns,
            columns: &self.columns,
        }
    }

    /// Passes its samples on and is empty afterwards.
    fn hand_on(&mut self, take: &mut dyn FnMut(Self) -> anyhow::Result<()>) -> anyhow::Result<()> {
        if self.segment.is_empty() {
            return Ok(());
        }
        let empty = Self::of(self.columns.len());
        take(std::mem::replace(self, empty))
    }
}

fn of_recording(
    recording: &Recording,
    part: &Part,
    about: &About,
    take: &mut dyn FnMut(Block) -> anyhow::Result<()>,
) -> anyhow::Result<Tally> {
    let from_ns = part.from.map_or(i64::MIN, |from| from.since(about.origin_ns));
    let to_ns = part.to.map_or(i64::MAX, |to| to.since(about.origin_ns));
    let mut accountant = RecordingAccountant::new(recording.info());
    let mut block = Block::of(about.channels.len());
    let (mut tally, mut records, mut gaps) = (Tally::default(), Vec::new(), Vec::new());
    for item in recording.items()? {
        let item: Item = item?;
        accountant.take(item, &mut records);
        for record in records.drain(..) {
            match record {
                Record::Gap(gap) => gaps.push(gap),
                Record::Sample { seq, segment, sample } => {
                    let time_ns = sample.host_utc_ns.saturating_sub(about.origin_ns);
                    if time_ns >= to_ns {
                        block.hand_on(take)?;
                        return Ok(tally);
                    }
                    // A gap counts if samples of the part lie on both sides of it.
                    for gap in gaps.drain(..) {
                        if tally.samples > 0 {
                            tally.gap(gap);
                        }
                    }
                    if time_ns >= from_ns {
                        tally.samples += 1;
                        block.push(seq, segment, time_ns, &sample, &about.channels);
                    }
                }
                _ => {}
            }
        }
        if block.segment.len() >= BLOCK {
            block.hand_on(take)?;
        }
    }
    block.hand_on(take)?;
    Ok(tally)
}
