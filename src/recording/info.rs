//! What is known about a recording as a whole.

use super::choice::StampChoice;
use super::detect::Kind;
use super::findings::Findings;
use super::grid::StampGrid;
use super::rows::Rejected;
use crate::sample::{Channel, ChannelSet, DiscardCause, Timebase};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Where a recording's times come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stamps {
    /// It has none: the row number at a told or assumed rate.
    None,
    /// Seconds in a column (or before each raw line), from any origin.
    Relative,
    /// Seconds since 1970 in a column (or before each raw line).
    Unix,
}

/// A column that came in another unit than the channel's.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Conversion {
    /// The channel.
    pub channel: Channel,
    /// The column's name in the file.
    pub column: String,
    /// The unit it came in.
    pub original_unit: &'static str,
    /// Value in the channel's unit = factor × value in the file.
    pub factor: f64,
}

/// How many decimals each channel's values were written with.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Decimals {
    /// Most decimals seen; `None` once a value was written with an exponent.
    seen: [Option<Option<u8>>; Channel::COUNT],
}

impl Decimals {
    /// Takes note of one value's text.
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

    /// Takes note of one value's decimals; `None` for one that has none in this sense.
    pub(super) fn note_count(&mut self, channel: Channel, decimals: Option<u8>) {
        let seen = &mut self.seen[channel as usize];
        *seen = Some(match (*seen, decimals) {
            (Some(Some(most)), Some(decimals)) => Some(most.max(decimals)),
            (None, decimals) => decimals,
            _ => None,
        });
    }

    /// The most decimals that a value of the channel was written with; `None` where it has no values or some were written
    /// with an exponent.
    #[must_use]
    pub fn get(&self, channel: Channel) -> Option<u8> {
        self.seen[channel as usize].flatten()
    }
}

/// What a first pass over the whole file found.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordingInfo {
    /// The file.
    pub file: PathBuf,
    /// What it is.
    pub kind: Kind,
    /// Channels that at least one sample has.
    pub channels: ChannelSet,
    /// Decimals of the text, in the file's units.
    pub decimals: Decimals,
    /// Columns that came in other units.
    pub conversions: Vec<Conversion>,
    /// Columns that are no channel's: ignored. For raw lines: what stood before `$VN` and was no stamp.
    pub ignored_columns: Vec<String>,
    /// Where the times come from.
    pub stamps: Stamps,
    /// Which stamps they are, where there are any.
    pub stamp_choice: Option<StampChoice>,
    /// What is remarkable about it.
    pub findings: Findings,
    /// Samples per second: of the grid on which the stamps lie, told, or assumed.
    pub rate_hz: f64,
    /// Whether the rate was neither in the file nor told.
    pub rate_assumed: bool,
    /// The rate of a comment in the file that was not used because the file has stamps.
    pub unused_rate_hz: Option<f64>,
    /// The rate of the stamps, Hz, if a told one overrides it.
    pub overridden_rate_hz: Option<f64>,
    /// The grid on which the stamps lie; `None` without stamps.
    pub stamp_grid: Option<StampGrid>,
    /// UTC of the first sample, ns since 1970: its stamp, else when the caller said that it starts.
    pub started_utc_ns: i64,
    /// Samples that the second pass will give.
    pub samples: u64,
    /// Lines that it will reject, by cause (bytes for [`DiscardCause::GarbageBytes`]).
    pub rejected: BTreeMap<DiscardCause, u64>,
    /// The first of them, at most [`super::REJECTED_KEPT`].
    pub first_rejected: Vec<Rejected>,
    /// First stamp in ns from the file's own origin; 0 without stamps.
    pub(super) first_stamp_ns: i64,
}

impl RecordingInfo {
    /// What the segments' times rest on.
    #[must_use]
    pub fn timebase(&self) -> Timebase {
        if self.stamps == Stamps::None { Timebase::Rate } else { Timebase::Stamps }
    }
}
