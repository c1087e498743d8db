//! Rows: the common form in which every kind of recording is read, before times and rates are known, and with how many
//! decimals its values were written.

use super::error::RecordingError;
use super::stamps::RowStamps;
use imu_core::sample::{Channel, DiscardCause, Sample};

/// The number of characters of a rejected line that are kept.
const TEXT_CHARS: usize = 256;

/// A line that did not become a sample.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Rejected {
    /// The number of the line in the (decompressed) file, from 1; for a bag, the number of the message among those of
    /// its topic.
    pub line: u64,
    /// The cause.
    pub cause: DiscardCause,
    /// The text of the line, at most 256 characters.
    pub text: String,
    /// Bytes of the line.
    #[serde(skip)]
    pub bytes: u64,
    /// Whether the line takes the place of a sample: without stamps, one sample is then missing there.
    #[serde(skip)]
    pub stands_for_sample: bool,
    /// The time of the line: since the recording's first stamp, and UTC, ns. `None` if no stamp shows it.
    #[serde(skip)]
    pub at: Option<(u64, i64)>,
    #[serde(skip)]
    pub(super) stamps: RowStamps,
    /// By how much its stamp lies before that of the last sample, ns; 0 if it repeats it. `None` if this is not the
    /// cause.
    #[serde(skip)]
    pub(super) late_ns: Option<u64>,
    /// Whether its stamp is of another clock, or far ahead of those that follow.
    #[serde(skip)]
    pub(super) astray: bool,
}

impl Rejected {
    pub(super) fn new(line: u64, cause: DiscardCause, text: &str, stands_for_sample: bool) -> Self {
        Self {
            line,
            cause,
            text: text.chars().take(TEXT_CHARS).collect(),
            bytes: text.len() as u64,
            stands_for_sample,
            at: None,
            stamps: RowStamps::default(),
            late_ns: None,
            astray: false,
        }
    }

    /// Creates the rejection of a line of the file, whose bytes are counted whether they are text or not.
    pub(super) fn of_line(line: u64, cause: DiscardCause, bytes: &[u8], stands_for_sample: bool) -> Self {
        let text = String::from_utf8_lossy(bytes.get(..4 * TEXT_CHARS).unwrap_or(bytes));
        Self { bytes: bytes.len() as u64, ..Self::new(line, cause, &text, stands_for_sample) }
    }

    /// Adds the stamps that the line carries.
    pub(super) fn stamped(mut self, stamps: RowStamps) -> Self {
        self.stamps = stamps;
        self
    }

    /// Returns the amount that the line adds to the count of its cause: 1, or its bytes for
    /// [`DiscardCause::GarbageBytes`].
    pub fn amount(&self) -> u64 {
        if self.cause == DiscardCause::GarbageBytes { self.bytes } else { 1 }
    }
}

/// The number of decimals with which each channel's values were written.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Decimals {
    /// Most decimals seen; `None` once a value had an exponent.
    seen: [Option<Option<u8>>; Channel::COUNT],
}

impl Decimals {
    /// Records the decimals of one value's text.
    pub(super) fn note(&mut self, channel: Channel, text: &str) {
        if self.seen[channel as usize] == Some(None) {
            return;
        }
        let decimals = if text.bytes().any(|byte| byte.is_ascii_alphabetic()) {
            None
        } else {
            u8::try_from(text.len() - text.find('.').map_or(text.len(), |point| point + 1)).ok()
        };
        self.note_count(channel, decimals);
    }

    /// Records the number of one value's decimals; `None` if the value was written without such a number.
    pub(super) fn note_count(&mut self, channel: Channel, decimals: Option<u8>) {
        let seen = &mut self.seen[channel as usize];
        *seen = Some(match (*seen, decimals) {
            (Some(Some(most)), Some(decimals)) => Some(most.max(decimals)),
            (None, decimals) => decimals,
            _ => None,
        });
    }

    /// Returns the largest number of decimals with which a value of the channel was written; `None` if it has no values
    /// or some were written with an exponent.
    pub fn get(&self, channel: Channel) -> Option<u8> {
        self.seen[channel as usize].flatten()
    }
}

/// One line of a recording.
#[derive(Debug)]
pub(super) enum Row {
    /// A sample; its times are not set yet.
    Sample { line: u64, stamps: RowStamps, sample: Sample },
    /// A line that is not a sample.
    Rejected(Rejected),
    /// A valid line that carries no measurement: a reply to a command.
    Aside,
}

/// A recording, line by line.
pub(super) trait Rows {
    /// Returns the next line; `None` at the end.
    fn next_row(&mut self) -> Result<Option<Row>, RecordingError>;
    /// Returns how the values read so far were written.
    fn decimals(&self) -> &Decimals;
}
