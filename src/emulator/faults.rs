//! Faults of a sensor and its line, and their times, as a script describes them. Pure.
//!
//! One fault per line, `#` begins a comment. In a file each line begins with the sensor's time since its start: `10s
//! unplug 10s`. On standard input the time is omitted, and the fault occurs at once.

use super::options::TICK_NS;
use imu_core::units::{format_duration, parse_duration};
use std::time::Duration;
use vn100_proto::link::{BAUD_RATES, INTERNAL_RATE_HZ};
use vn100_proto::register::{BINARY_OUTPUT_1, BinaryOutput};
use vn100_proto::{AsciiType, BinaryHeader};

/// A fault of a sensor or its line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fault {
    /// The terminal disappears and its link is removed; after this time there is a new terminal with the link to it.
    Unplug(Duration),
    /// The terminal hangs up and the link dangles; after this time it points to a new terminal.
    Eof(Duration),
    /// The sensor restarts: silent for its boot time, then its clock is at 0 and its registers are those of its flash.
    Reset,
    /// The sensor neither receives nor sends for this time; its clock continues.
    Silence(Duration),
    /// This many random bytes arrive between frames.
    Garbage(u64),
    /// One bit of each of the next frames is flipped.
    Checksum(u64),
    /// The next frames are not sent.
    Drop(u64),
    /// The next frames are sent twice.
    Duplicate(u64),
    /// This many times, a frame is sent after the one that follows it.
    Reorder(u64),
    /// The sensor sends at this rate in Hz from now on, without a command.
    Rate(u32),
    /// The sensor sends this message instead of the configured one.
    Format(Format),
    /// The sensor uses this baud rate from now on; data at another rate is garbled.
    Baud(u32),
    /// Bytes are kept for this time, then sent in one burst.
    Hold(Duration),
    /// Another unit is connected from now on: this serial number, registers as delivered, a clock that begins at 0.
    Unit(String),
    /// The sensor's clock jumps to this many microseconds, and its 32-bit sync counter to the same number.
    Clock(u64),
}

/// A message that a sensor may switch to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// An ASCII message, at the rate of register 7.
    Ascii(AsciiType),
    /// Binary output 1 with these groups and fields, at the rate of the previous output, else 40 Hz.
    Binary(BinaryHeader),
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let duration = |duration: &Duration| format_duration(*duration);
        match self {
            Self::Unplug(time) => write!(f, "unplug {}", duration(time)),
            Self::Eof(time) => write!(f, "eof {}", duration(time)),
            Self::Reset => f.write_str("reset"),
            Self::Silence(time) => write!(f, "silence {}", duration(time)),
            Self::Garbage(bytes) => write!(f, "garbage {bytes}"),
            Self::Checksum(frames) => write!(f, "checksum {frames}"),
            Self::Drop(frames) => write!(f, "drop {frames}"),
            Self::Duplicate(frames) => write!(f, "duplicate {frames}"),
            Self::Reorder(pairs) => write!(f, "reorder {pairs}"),
            Self::Rate(rate_hz) => write!(f, "rate {rate_hz}"),
            Self::Format(Format::Ascii(ascii)) => write!(f, "format {}", ascii.header()),
            Self::Format(Format::Binary(header)) => write!(f, "format {header}"),
            Self::Baud(baud) => write!(f, "baud {baud}"),
            Self::Hold(time) => write!(f, "hold {}", duration(time)),
            Self::Unit(serial) => write!(f, "unit {serial}"),
            Self::Clock(us) => write!(f, "clock {us}"),
        }
    }
}

/// A line of a script that cannot be parsed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{script}, line {line}: expected {expected}, found {found}")]
pub struct FaultError {
    /// The script's name.
    pub script: String,
    /// Its line, from 1.
    pub line: usize,
    /// The expected text.
    pub expected: String,
    /// The text found.
    pub found: String,
}

/// The expected and the found text within a line.
type Refusal = (String, String);

const FAULTS: &str = "one of unplug, eof, reset, silence, garbage, checksum, drop, duplicate, reorder, rate, format, baud, hold, unit, clock";

fn refuse(expected: impl Into<String>, found: &str) -> Refusal {
    let found = if found.is_empty() { "the end of the line".to_owned() } else { format!("`{found}`") };
    (expected.into(), found)
}

/// Returns the words of a line up to its comment.
fn words(line: &str) -> Vec<&str> {
    line.split('#').next().unwrap_or_default().split_whitespace().collect()
}

fn time(word: &str, what: &str) -> Result<Duration, Refusal> {
    parse_duration(word).map_err(|_| refuse(format!("{what}, such as 10s or 500ms"), word))
}

fn number(word: &str, what: &str, most: u64) -> Result<u64, Refusal> {
    let parsed = word.parse().ok().filter(|number| *number <= most);
    parsed.ok_or_else(|| refuse(format!("{what}, a whole number up to {most}"), word))
}

fn format(word: &str) -> Result<Format, Refusal> {
    if let Some(ascii) = AsciiType::ALL.into_iter().find(|ascii| ascii.header() == word) {
        return Ok(Format::Ascii(ascii));
    }
    let output = BinaryOutput::parse(BINARY_OUTPUT_1, &format!("1,20,{word}")).ok();
    output.and_then(|output| output.header).map(Format::Binary).ok_or_else(|| {
        let names: Vec<&str> = AsciiType::ALL.iter().map(|ascii| ascii.header()).collect();
        refuse(format!("one of {}, or groups and fields in hex, such as 01,0609", names.join(", ")), word)
    })
}

fn fault(words: &[&str]) -> Result<Fault, Refusal> {
    let name = words.first().copied().unwrap_or_default();
    let value = words.get(1).copied().unwrap_or_default();
    if let Some(surplus) = words.get(if name == "reset" { 1 } else { 2 }) {
        return Err(refuse("the end of the line", surplus));
    }
    const FRAMES: &str = "a number of frames";
    Ok(match name {
        "unplug" => Fault::Unplug(time(value, "how long it is gone")?),
        "eof" => Fault::Eof(time(value, "how long it is gone")?),
        "reset" => Fault::Reset,
        "silence" => Fault::Silence(time(value, "how long it is silent")?),
        "garbage" => Fault::Garbage(number(value, "a number of bytes", 1 << 40)?),
        "checksum" => Fault::Checksum(number(value, FRAMES, 1 << 40)?),
        "drop" => Fault::Drop(number(value, FRAMES, 1 << 40)?),
        "duplicate" => Fault::Duplicate(number(value, FRAMES, 1 << 40)?),
        "reorder" => Fault::Reorder(number(value, "a number of pairs", 1 << 40)?),
        "rate" => {
            let rate = value.parse().ok().filter(|rate| *rate > 0 && INTERNAL_RATE_HZ.is_multiple_of(*rate));
            Fault::Rate(rate.ok_or_else(|| refuse("a rate in Hz that divides 800", value))?)
        }
        "format" => Fault::Format(format(value)?),
        "baud" => {
            let baud = value.parse().ok().filter(|baud| BAUD_RATES.contains(baud));
            let allowed = BAUD_RATES.map(|baud| baud.to_string()).join(", ");
            Fault::Baud(baud.ok_or_else(|| refuse(format!("one of {allowed}"), value))?)
        }
        "hold" => Fault::Hold(time(value, "how long bytes are kept")?),
        "unit" if !value.is_empty() && value.bytes().all(|byte| byte.is_ascii_alphanumeric()) => {
            Fault::Unit(value.to_owned())
        }
        "unit" => return Err(refuse("a serial number, such as 0100099999", value)),
        "clock" => Fault::Clock(number(value, "microseconds", u64::MAX / 1000)?),
        name => return Err(refuse(FAULTS, name)),
    })
}

/// Parses a fault without its time, as a line of standard input; `None` for a line with nothing but a comment.
///
/// # Errors
/// [`FaultError`], which names the line.
pub fn parse_line(line: &str, script: &str, number: usize) -> Result<Option<Fault>, FaultError> {
    let words = words(line);
    if words.is_empty() {
        return Ok(None);
    }
    fault(&words).map(Some).map_err(|(expected, found)| FaultError {
        script: script.to_owned(),
        line: number,
        expected,
        found,
    })
}

/// Faults by the sensor's time.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Schedule {
    /// Tick and fault, the earliest last.
    coming: Vec<(u64, Fault)>,
}

impl Schedule {
    /// Reads a script. Its lines may be in any order; faults at the same time occur in the order of the lines.
    ///
    /// # Errors
    /// [`FaultError`] for the first line that cannot be parsed.
    pub fn parse(text: &str, script: &str) -> Result<Self, FaultError> {
        let mut coming = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let words = words(line);
            let Some((at, rest)) = words.split_first() else { continue };
            let parsed = time(at, "the sensor's time at which it happens").and_then(|at| Ok((at, fault(rest)?)));
            let (at, fault) = parsed.map_err(|(expected, found)| FaultError {
                script: script.to_owned(),
                line: index + 1,
                expected,
                found,
            })?;
            coming.push((ticks(at), fault));
        }
        coming.sort_by_key(|(tick, _)| *tick);
        coming.reverse();
        Ok(Self { coming })
    }

    /// Returns the next fault whose time has come.
    pub fn due(&mut self, tick: u64) -> Option<Fault> {
        let (at, _) = self.coming.last()?;
        if *at <= tick { self.coming.pop().map(|(_, fault)| fault) } else { None }
    }

    /// Returns the tick of the next fault.
    pub fn next_tick(&self) -> Option<u64> {
        self.coming.last().map(|(tick, _)| *tick)
    }
}

/// Returns a duration in ticks of 1/800 s.
pub fn ticks(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos() / u128::from(TICK_NS)).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const EVERY: &str = "unplug 10s\neof 10s\nreset\nsilence 5s\ngarbage 4096\nchecksum 20\ndrop 7\nduplicate 3\nreorder 1\nrate 100\nformat VNYMR\nbaud 9600\nhold 2s\nunit 0100099999\nclock 4294967290\n";

    #[test]
    fn every_fault_is_read_and_written_alike() {
        for (index, line) in EVERY.lines().enumerate() {
            let fault = parse_line(line, "test", index + 1).unwrap().unwrap();
            assert_eq!(fault.to_string(), line);
        }
        assert_eq!(parse_line("  # nothing", "test", 1), Ok(None));
        let binary = parse_line("format 01,0009", "test", 1).unwrap().unwrap();
        assert!(matches!(binary, Fault::Format(Format::Binary(_))), "{binary}");
    }

    #[test]
    fn a_script_happens_by_the_sensors_time() {
        let script = "# an evening\n20s drop 7 # frames\n\n10s unplug 10s\n20s reset\n";
        let mut schedule = Schedule::parse(script, "evening.txt").unwrap();
        assert_eq!(schedule.next_tick(), Some(8000));
        assert_eq!(schedule.due(7999), None);
        assert_eq!(schedule.due(8000), Some(Fault::Unplug(Duration::from_secs(10))));
        assert_eq!(schedule.due(8000), None);
        assert_eq!(schedule.due(16_000), Some(Fault::Drop(7)));
        assert_eq!(schedule.due(16_000), Some(Fault::Reset));
        assert_eq!((schedule.due(u64::MAX), schedule.next_tick()), (None, None));
    }

    #[test]
    fn errors_name_the_line_what_was_expected_and_what_was_found() {
        for (script, message) in [
            (
                "1s drop 7\nx unplug 1s",
                "s, line 2: expected the sensor's time at which it happens, such as 10s or 500ms, found `x`",
            ),
            ("1s", "s, line 1: expected one of unplug,"),
            ("1s unplug", "s, line 1: expected how long it is gone, such as 10s or 500ms, found the end of the line"),
            ("1s drop -1", "s, line 1: expected a number of frames, a whole number up to 1099511627776, found `-1`"),
            ("1s rate 33", "s, line 1: expected a rate in Hz that divides 800, found `33`"),
            ("1s rate 0", "s, line 1: expected a rate in Hz that divides 800, found `0`"),
            ("1s format VNXXX", "s, line 1: expected one of VNYPR,"),
            ("1s baud 1200", "s, line 1: expected one of 9600,"),
            ("1s reset now", "s, line 1: expected the end of the line, found `now`"),
            ("1s explode", "found `explode`"),
            ("1s unit", "s, line 1: expected a serial number, such as 0100099999, found the end of the line"),
            ("1s unit 1,2", "found `1,2`"),
        ] {
            let error = Schedule::parse(script, "s").unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
