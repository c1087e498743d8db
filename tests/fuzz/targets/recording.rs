//! Recordings: every entry becomes a sample or a rejected one, and the accounting's identities hold.

use imu_core::sample::{Channel, DiscardCause, Record};
use imu_files::recording::{
    ColumnMap, Input, Item, Options, Part, PartEnd, REJECTED_KEPT, Recording, RecordingAccountant, columns,
};
use std::collections::{BTreeMap, BTreeSet};

/// A line that is longer is read in pieces.
const LINE_BYTES: usize = 4096;
/// The beginnings of inputs that are not text.
const NO_TEXT: [&[u8]; 17] = [
    b"#ROSBAG",
    b"SQLite format 3",
    b"\x89MCAP",
    b"\x1F\x8B",
    b"\xFA",
    b"BZh",
    b"\xFD7zXZ",
    b"\x28\xB5\x2F\xFD",
    b"\xFF\xFE",
    b"\xFE\xFF",
    b"PAR1",
    b"\x93NUMPY",
    b"PK\x03\x04",
    b"MATLAB 5.0",
    b"\x89HDF",
    b"ULog",
    b"\xA3\x95",
];

fn is_no_text(input: &[u8]) -> bool {
    NO_TEXT.iter().any(|magic| input.starts_with(magic))
}

pub fn csv(input: &[u8]) {
    let Some(items) = holds(input) else { return };
    // Quotation marks may hold line ends, other kinds are other targets; otherwise each line that is not empty is a
    // row.
    if input.contains(&b'"') || input.windows(3).any(|window| window == b"$VN") || is_no_text(input) {
        return;
    }
    let lines = input.split(|byte| *byte == b'\n' || *byte == b'\r').filter(|line| !line.is_empty()).count();
    assert_eq!(items.len() + 1, lines, "rows and lines");
}

pub fn raw_text(input: &[u8]) {
    let Some(items) = holds(input) else { return };
    let is_text = input.windows(3).any(|window| window == b"$VN");
    if !is_text || is_no_text(input) {
        return;
    }
    let lines: Vec<_> = input.split(|byte| *byte == b'\n').collect();
    if lines.iter().any(|line| line.len() >= LINE_BYTES) {
        return;
    }
    // The detected line-wise kind does not matter here: `$VN` may stand beyond the examined part.
    let rejected: BTreeSet<u64> = items.iter().filter_map(|(rejected, _)| *rejected).collect();
    if items.iter().any(|(_, is_csv)| *is_csv) {
        return;
    }
    for (index, line) in lines.iter().enumerate() {
        let line = line.trim_ascii();
        // The header of a table of messages, and the rest of a quoted cell, are no rows.
        let is_aside = index == 0 || line.iter().all(|byte| matches!(byte, b'"' | b'\''));
        if !is_aside && !line.windows(3).any(|window| window == b"$VN") {
            assert!(rejected.contains(&(index as u64 + 1)), "line {} is neither sample nor rejected", index + 1);
        }
    }
}

/// Tests a recording of any kind: only the common properties are known.
pub fn any(input: &[u8]) {
    holds(input);
}

/// Tests a table of another program's form. Parquet is left out: the library that reads it may panic (docs/recordings.md).
pub fn table(input: &[u8]) {
    if !input.starts_with(b"PAR1") {
        holds(input);
    }
}

/// Tests what the user states about a recording. The first line is the map of its columns, the second a part: `FROM TO
/// CHANNELS`, of which `-` is none. The rest is the recording.
pub fn mapped(input: &[u8]) {
    let mut lines = input.splitn(3, |byte| *byte == b'\n');
    let [Some(map), Some(part), Some(bytes)] = [lines.next(), lines.next(), lines.next()] else { return };
    let map = match ColumnMap::parse(&[String::from_utf8_lossy(map)]) {
        Ok(map) => map,
        Err(error) => {
            let text = error.to_string();
            return assert!(text.starts_with("columns: ") && text.len() < 20_000, "{text}");
        }
    };
    assert_eq!(ColumnMap::parse(&[map.to_string()]).as_ref(), Ok(&map), "a map is read as it is written");
    let part = String::from_utf8_lossy(part);
    let mut words = part.split(' ');
    let mut end = || {
        let seconds: f64 = words.next()?.parse().ok()?;
        // Beyond 1e9 s it is a time of day.
        let ns = (seconds * 1e9) as i64;
        Some(if seconds < 1e9 { PartEnd::Since(ns) } else { PartEnd::Utc(ns) })
    };
    let (from, to) = (end(), end());
    let part = Part { from, to, channels: words.next().and_then(|names| Channel::list(names).ok()) };
    let read = |part: Part| {
        let input = Input::memory("fuzz", bytes).with_columns(map.clone());
        holds_as(input, Options { started_utc_ns: 1, part, ..Options::default() })
    };
    let (whole, of_part) = (read(Part::default()), read(part));
    let samples = |items: &[(Option<u64>, bool)]| items.iter().filter(|(rejected, _)| rejected.is_none()).count();
    if let Some(of_part) = of_part {
        let whole = whole.expect("a recording of which a part is read is read");
        assert!(samples(&of_part) <= whole.len(), "a part has no more than the whole");
    }
}

/// Reads the recording as the import does and checks the properties. Returns each item's line, if it was rejected, and
/// whether the recording is a CSV; `None` if it was refused as a whole.
fn holds(input: &[u8]) -> Option<Vec<(Option<u64>, bool)>> {
    holds_as(Input::memory("fuzz", input), Options { started_utc_ns: 1, ..Options::default() })
}

fn holds_as(input: Input, options: Options) -> Option<Vec<(Option<u64>, bool)>> {
    let recording = match Recording::read(input, options) {
        Ok(recording) => recording,
        Err(error) => {
            let text = error.to_string();
            assert!(text.contains("fuzz") && text.len() < 20_000, "{text}");
            return None;
        }
    };
    let info = recording.info();
    assert!(info.rate_hz.is_finite() && info.rate_hz > 0.0);
    assert!(info.remarks().iter().all(|remark| !remark.contains("NaN")));
    let mut accountant = RecordingAccountant::new(info);
    let mut records = Vec::new();
    let (mut items, mut rejected) = (Vec::new(), BTreeMap::<DiscardCause, u64>::new());
    let is_csv = info.kind == imu_files::recording::Kind::Csv;
    let (mut samples, mut missing) = (0_u64, None::<u64>);
    for item in recording.items().expect("it was read once") {
        let item = item.expect("it was read once");
        match &item {
            Item::Sample(sample, before) => {
                assert!(sample.channels().iter().all(|channel| info.channels.contains(channel)));
                items.push((None, is_csv));
                samples += 1;
                missing = missing.unwrap_or(0).checked_add(before.unwrap_or(0));
                assert!(samples > 1 || before.unwrap_or(0) == 0, "nothing is missing before the first sample");
                assert_eq!(before.is_some(), info.stamp_grid.is_some());
            }
            Item::Rejected(bad) => {
                assert!(bad.text.chars().count() <= 256);
                *rejected.entry(bad.cause).or_default() += bad.amount();
                items.push((Some(bad.line), is_csv));
            }
        }
        accountant.take(item, &mut records);
    }
    assert_eq!(rejected, info.rejected, "both passes");
    check_records(&records, &accountant);
    assert_eq!(accountant.received(), info.samples);
    if info.stamp_grid.is_some() {
        assert_eq!(Some(accountant.missing()), missing, "what the grid tells is what is accounted for");
        assert_eq!(info.findings.missing, accountant.missing(), "both passes");
    }
    let loaded = columns(&recording).expect("it was read once");
    assert_eq!((loaded.samples, loaded.missing), (accountant.received(), accountant.missing()));
    for column in &loaded.columns {
        // A sample without the channel has no number.
        let mut values = column.values.iter().map(|value| (!value.is_nan()).then_some(*value));
        for record in &records {
            if let Record::Sample { sample, .. } = record {
                assert_eq!(values.next(), Some(sample.get(column.channel)));
            }
        }
        assert!(values.flatten().next().is_none());
    }
    Some(items)
}

fn check_records(records: &[Record], accountant: &RecordingAccountant) {
    let (mut samples, mut missing, mut gaps, mut events, mut last_ns) = (0, 0, 0, 0, None);
    for record in records {
        match record {
            Record::Sample { seq, sample, .. } => {
                assert_eq!(*seq, samples);
                if let (Some(last), Some(now)) = (last_ns, sample.device_time_ns) {
                    assert!(now > last, "samples are in order");
                }
                last_ns = sample.device_time_ns;
                samples += 1;
            }
            Record::Gap(gap) => {
                assert!(gap.missing > 0 && gap.from_utc_ns <= gap.to_utc_ns && gap.before_seq == samples);
                missing += gap.missing;
                gaps += 1;
            }
            Record::Event(_) => events += 1,
            _ => {}
        }
    }
    assert_eq!((samples, missing, gaps), (accountant.received(), accountant.missing(), accountant.gaps()));
    assert!(events <= REJECTED_KEPT);
}
