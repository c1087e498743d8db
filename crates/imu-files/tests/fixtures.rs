//! Recordings that the formats' own libraries wrote (`tests/peers/recordings.py`): samples, units, rate and gaps are those
//! that the script computed apart.

#![expect(clippy::unwrap_used, reason = "a test ends at what is not as expected")]

use imu_files::recording::{ColumnMap, Input, LoadedRecording, Options, Recording, RecordingError, Stamps, columns};
use serde_json::Value;
use std::path::PathBuf;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/recordings")
}

fn expected() -> Value {
    serde_json::from_str(&std::fs::read_to_string(folder().join("expected.json")).unwrap()).unwrap()
}

fn read(entry: &Value) -> Result<LoadedRecording, RecordingError> {
    let file = folder().join(entry["file"].as_str().unwrap());
    let map = ColumnMap::parse(&[entry["columns"].as_str().unwrap()]).unwrap();
    let options = Options { rate_hz: entry["rate"].as_f64(), ..Options::default() };
    columns(&Recording::read(Input::file(&file).with_columns(map), options)?)
}

/// Returns the first difference from what is expected.
fn difference(all: &Value, entry: &Value) -> Result<(), String> {
    let read = read(entry);
    if let Some(refused) = entry["refused"].as_str() {
        let error = read.map(|_| ()).err().map(|error| error.to_string());
        let error = error.ok_or_else(|| "was read, but must be refused".to_owned())?;
        return if error.contains(refused) { Ok(()) } else { Err(format!("expected {refused} in: {error}")) };
    }
    let read = read.map_err(|error| error.to_string())?;
    let count = entry["samples"].as_u64().unwrap();
    let check = |what: &str, found: String, expected: String| {
        if found == expected { Ok(()) } else { Err(format!("{what}: found {found}, expected {expected}")) }
    };
    let names = |channels: &mut dyn Iterator<Item = String>| {
        let mut names: Vec<String> = channels.collect();
        names.sort();
        names.join(" ")
    };
    let channels = entry["channels"].as_array().unwrap();
    check(
        "channels",
        names(&mut read.columns.iter().map(|column| column.channel.name().to_owned())),
        names(&mut channels.iter().map(|name| name.as_str().unwrap().to_owned())),
    )?;
    check("samples", read.samples.to_string(), count.to_string())?;
    check("missing", read.missing.to_string(), entry["missing"].to_string())?;
    check("rejected", format!("{:?}", read.info.rejected), "{}".to_owned())?;
    check("unix", (read.info.stamps == Stamps::Unix).to_string(), entry["unix"].to_string())?;
    let rate_hz = all["rate_hz"].as_f64().unwrap();
    if (read.info.rate_hz / rate_hz - 1.0).abs() > 1e-4 {
        return Err(format!("rate: found {}, expected {rate_hz}", read.info.rate_hz));
    }
    if read.info.stamps == Stamps::Unix {
        let start_ns = all["start_ns"].as_i64().unwrap();
        // Some forms keep times as doubles.
        if (read.info.started_utc_ns - start_ns).abs() > 1000 {
            return Err(format!("start: found {}, expected {start_ns}", read.info.started_utc_ns));
        }
    }
    for (channel, unit) in entry["conversions"].as_object().unwrap() {
        let found = read.info.conversions.iter().find(|conversion| conversion.channel.name() == channel);
        check(
            channel,
            found.map_or("none".to_owned(), |found| found.original_unit.to_owned()),
            unit.as_str().unwrap().to_owned(),
        )?;
    }
    for column in &read.columns {
        let truth: Vec<f64> = all["truth"][column.channel.name()]
            .as_array()
            .unwrap()
            .iter()
            .map(|value| value.as_f64().unwrap())
            .collect();
        let size = truth.iter().fold(0.0, |size: f64, value| size.max(value.abs()));
        for (place, (found, truth)) in column.values.iter().zip(&truth).enumerate() {
            // A value that is not a number is not near.
            let is_near = (found - truth).abs() <= entry["within"].as_f64().unwrap() * size;
            if !is_near {
                return Err(format!("{} sample {place}: found {found}, expected {truth}", column.channel));
            }
        }
    }
    Ok(())
}

/// Returns the plain files that can be read, with their columns.
fn readable(all: &Value) -> Vec<(String, Vec<u8>, ColumnMap, u64, Options)> {
    let files = all["files"].as_array().unwrap().iter().filter(|entry| entry["refused"].is_null());
    let plain = files.filter(|entry| folder().join(entry["file"].as_str().unwrap()).is_file());
    plain
        .map(|entry| {
            let name = entry["file"].as_str().unwrap().to_owned();
            let bytes = std::fs::read(folder().join(&name)).unwrap();
            let map = ColumnMap::parse(&[entry["columns"].as_str().unwrap()]).unwrap();
            let options = Options { rate_hz: entry["rate"].as_f64(), ..Options::default() };
            (name, bytes, map, entry["samples"].as_u64().unwrap(), options)
        })
        .collect()
}

#[test]
fn a_file_of_any_form_that_was_cut_is_refused_or_counts_what_is_lost() {
    for (name, bytes, map, samples, options) in readable(&expected()) {
        for share in [0.15, 0.6, 0.95] {
            let cut = &bytes[..(bytes.len() as f64 * share) as usize];
            let input = Input::memory(&name, cut).with_columns(map.clone());
            match Recording::read(input, options.clone()) {
                Err(error) => {
                    let text = error.to_string();
                    assert!(text.contains(&name) && !text.contains('\n') && text.len() > name.len() + 20, "{text}");
                }
                Ok(recording) => {
                    let read = columns(&recording).unwrap();
                    assert!(read.samples < samples, "{name}: {} of {samples} samples", read.samples);
                    // Text may end with its line; other forms state their lengths.
                    let is_text = name.ends_with(".csv") || name.ends_with(".txt");
                    assert!(is_text || !read.info.rejected.is_empty(), "{name} at {share}: nothing is counted");
                }
            }
        }
    }
}

#[test]
fn damage_in_a_file_of_any_form_never_ends_the_program() {
    for (name, bytes, map, _, options) in readable(&expected()) {
        // The crate `parquet` panics at some damage (offsets within a page). That happens in the first pass, before
        // anything is stored.
        if name.ends_with(".parquet") {
            continue;
        }
        let mut state = 27_u64;
        for _ in 0..60 {
            let mut damaged = bytes.clone();
            for _ in 0..4 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let place = (state >> 33) as usize % damaged.len();
                damaged[place] = (state >> 17) as u8;
            }
            let input = Input::memory(&name, damaged).with_columns(map.clone());
            if let Ok(recording) = Recording::read(input, options.clone()) {
                let _ = columns(&recording);
            }
        }
    }
}

#[test]
fn a_mapping_that_cannot_be_meant_is_refused_for_any_form() {
    let all = expected();
    for file in [
        "structured.npy",
        "arrays.npz",
        "pandas.parquet",
        "matlab5.mat",
        "groups.h5",
        "px4.ulg",
        "ardupilot.bin",
        "bag_folder",
    ] {
        let refused = |pairs: &str| {
            let map = ColumnMap::parse(&[pairs]).unwrap();
            let input = Input::file(&folder().join(file)).with_columns(map);
            let error = Recording::read(input, Options::default()).map(|_| ()).unwrap_err().to_string();
            assert!(error.contains(file), "{error}");
            error
        };
        let error = refused("absent=gyro_x_rad_s");
        assert!(error.contains("absent") && error.contains("its columns are"), "{file}: {error}");
    }
    let twice = ColumnMap::parse(&["#1=gyro_x_rad_s,#2=gyro_x_rad_s"]).unwrap();
    let input = Input::file(&folder().join("table.npy")).with_columns(twice);
    let error = Recording::read(input, Options::default()).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("\"#1\" and \"#2\" both give gyro_x"), "{error}");
    assert!(ColumnMap::parse(&["a=gyro_x_m_s2"]).unwrap_err().to_string().contains("gyro_x_m_s2"));
    assert!(all["samples"].as_u64() > Some(100));
}

#[test]
fn recordings_of_other_programs_have_the_samples_that_were_written() {
    let all = expected();
    let files = all["files"].as_array().unwrap();
    assert!(files.len() >= 40);
    let wrong: Vec<String> = files
        .iter()
        .filter_map(|entry| {
            difference(&all, entry).err().map(|what| format!("{} {}: {what}", entry["file"], entry["columns"]))
        })
        .collect();
    assert!(wrong.is_empty(), "{} of {} are wrong:\n{}", wrong.len(), files.len(), wrong.join("\n"));
}
