//! Folders that are recordings: a bag of ROS 2 (`metadata.yaml` beside its file), and KITTI's `oxts` (one file of text for
//! each sample, and `timestamps.txt`).
//!
//! The folder of a bag stands for the file in it, or for all files of a split bag in the order of its `metadata.yaml`. The samples of KITTI are joined to one table in memory, with the units of
//! its `dataformat.txt`; a file that is missing or has another number of values is a rejected row.

use super::error::RecordingError;
use super::input::{Input, read_small};
use super::names::known_column;
use super::propose::{OXTS_COLUMNS, of_oxts};
use std::path::{Path, PathBuf};

/// The most samples of KITTI that are read: days at its 10 or 100 Hz.
const OXTS_MOST: usize = 1_000_000;
/// The longest file of one sample and of all dates, bytes.
const OXTS_BYTES: u64 = 4096;
const STAMPS_BYTES: u64 = 64 << 20;
/// The longest `metadata.yaml`, bytes, and the most files of a split bag.
const METADATA_BYTES: u64 = 4 << 20;
const FILES_MOST: usize = 10_000;

/// Returns whether a folder is a recording.
pub fn is_recording_folder(path: &Path) -> bool {
    path.is_dir() && (path.join("metadata.yaml").is_file() || is_oxts(path))
}

fn is_oxts(path: &Path) -> bool {
    path.join("timestamps.txt").is_file() && path.join("data").is_dir()
}

/// Returns the files of a recording: of KITTI's folder all, of a bag's folder those of the bag, of any other path
/// itself.
pub fn recording_files(path: &Path) -> Vec<PathBuf> {
    if !path.is_dir() {
        return vec![path.to_owned()];
    }
    if let Some(files) = (!is_oxts(path)).then(|| bag_files(path).ok()).flatten() {
        return files;
    }
    let mut files: Vec<PathBuf> = [path.join("data"), path.to_owned()]
        .iter()
        .filter_map(|folder| std::fs::read_dir(folder).ok())
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.is_file())
        .collect();
    files.sort();
    files
}

/// Returns the input that a folder stands for; any other input as it is.
///
/// # Errors
/// [`RecordingError::Folder`] with what is in it, or the system's error.
pub(super) fn resolved(input: Input) -> Result<Input, RecordingError> {
    let path = input.path().to_owned();
    if input.bytes().is_some() || !path.is_dir() {
        return Ok(input);
    }
    if is_oxts(&path) {
        let table = oxts(&path)?;
        return Ok(input.with_bytes(table));
    }
    let mut files = bag_files(&path)?;
    let further = files.split_off(1);
    // `bag_files` returns at least one.
    let first = files.pop().unwrap_or(path);
    Ok(input.with_path(first).followed_by(further))
}

/// Returns the file that a path stands for: of a bag's folder the file in it, unless there are several; else the path
/// itself.
///
/// # Errors
/// [`RecordingError::Folder`] if a bag's folder has no such file, or files that its `metadata.yaml` does not name.
pub fn recording_file(path: &Path) -> Result<PathBuf, RecordingError> {
    if !is_recording_folder(path) || is_oxts(path) {
        return Ok(path.to_owned());
    }
    Ok(match bag_files(path)?.as_slice() {
        [only] => only.clone(),
        _ => path.to_owned(),
    })
}

fn is_bag(path: &Path) -> bool {
    let ends = |end: &str| path.to_string_lossy().ends_with(end);
    // A compressed MCAP file is read as it is; SQLite needs its file.
    ends(".mcap") || ends(".db3") || ends(".mcap.zstd")
}

/// Returns the files of a bag's folder in order, at least one.
fn bag_files(folder: &Path) -> Result<Vec<PathBuf>, RecordingError> {
    let open = |source| RecordingError::Open { file: folder.to_owned(), source };
    let mut all: Vec<PathBuf> =
        std::fs::read_dir(folder).map_err(open)?.filter_map(|entry| Some(entry.ok()?.path())).collect();
    all.sort();
    let refused = |found| Err(RecordingError::Folder { folder: folder.to_owned(), found });
    let bags: Vec<&PathBuf> = all.iter().filter(|path| is_bag(path)).collect();
    if let [only] = *bags {
        return Ok(vec![only.clone()]);
    }
    let metadata = read_small(&folder.join("metadata.yaml"), METADATA_BYTES).unwrap_or_default();
    let names = split_files(&metadata);
    // A file that is left out would be a gap, or nothing at all.
    if let Some(other) = names.iter().find(|name| !is_bag(Path::new(name)) || name.contains(['/', '\\'])) {
        let compressed = if other.ends_with(".zstd") {
            ": decompress its files with `zstd -d --rm`, and name them in it so"
        } else {
            ""
        };
        return refused(format!(
            "`{other}` in its metadata.yaml, which is no .mcap or .db3 of this folder{compressed}"
        ));
    }
    let files: Vec<PathBuf> = names.into_iter().map(|name| folder.join(name)).collect();
    match files.iter().find(|file| !file.is_file()) {
        Some(missing) => {
            let name = missing.file_name().unwrap_or_default().display();
            return refused(format!("no {name}, which its metadata.yaml names"));
        }
        None if files.len() > 1 && files.windows(2).all(|two| two[0].extension() == two[1].extension()) => {
            return Ok(files);
        }
        None => {}
    }
    let named = |paths: &mut dyn Iterator<Item = &PathBuf>| {
        let names: Vec<String> =
            paths.take(10).filter_map(|path| Some(path.file_name()?.display().to_string())).collect();
        if names.is_empty() { "nothing".to_owned() } else { names.join(", ") }
    };
    refused(if bags.is_empty() { named(&mut all.iter()) } else { named(&mut bags.into_iter()) })
}

/// Returns the names of a bag's files in the order of its `metadata.yaml`: the list `relative_file_paths`, without quotes, comments and
/// `./`.
fn split_files(metadata: &str) -> Vec<String> {
    let mut lines = metadata.lines().skip_while(|line| line.trim_end() != "  relative_file_paths:").skip(1);
    let items = std::iter::from_fn(|| lines.next()?.trim().strip_prefix("- ").map(str::trim));
    let names = items.map(|name| name.split(" #").next().unwrap_or(name).trim().trim_matches(['"', '\'']));
    names.map(|name| name.trim_start_matches("./").to_owned()).take(FILES_MOST).collect()
}

/// Returns KITTI's samples as a CSV.
fn oxts(folder: &Path) -> Result<String, RecordingError> {
    let stamps = folder.join("timestamps.txt");
    let dates = read_small(&stamps, STAMPS_BYTES)?;
    let found = dates.lines().take(OXTS_MOST + 1).count();
    if found > OXTS_MOST {
        let what = format!("it has more than {OXTS_MOST} samples; split it");
        return Err(RecordingError::Table { file: stamps, what });
    }
    let mut names = vec![String::new(); OXTS_COLUMNS];
    for pair in of_oxts(0) {
        if let Some((position, name)) = pair.trim_start_matches('#').split_once('=')
            && let Some(place) = position.parse::<usize>().ok().and_then(|position| names.get_mut(position - 1))
            && known_column(name).is_some()
        {
            *place = name.to_owned();
        }
    }
    let mut table = format!("time_s,{}\n", names.join(","));
    for (index, date) in dates.lines().enumerate() {
        let file = folder.join("data").join(format!("{index:010}.txt"));
        // A file that is missing, too long or no file at all is a row without values, which is rejected.
        let values = read_small(&file, OXTS_BYTES).unwrap_or_default();
        let values: Vec<&str> = values.split_ascii_whitespace().collect();
        table.push_str(&format!("{},{}\n", date.trim(), values.join(",")));
    }
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_that_is_no_text_or_no_file_is_a_row_without_values() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        std::fs::create_dir_all(data.join("0000000002.txt")).unwrap();
        std::fs::write(folder.path().join("timestamps.txt"), "2011-09-26 13:02:25.9\n".repeat(4)).unwrap();
        std::fs::write(data.join("0000000000.txt"), "1 2 3").unwrap();
        std::fs::write(data.join("0000000001.txt"), [0xFF, 0xFE, b' ', b'1']).unwrap();
        let pipe = data.join("0000000003.txt");
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR).unwrap();
        let table = oxts(folder.path()).unwrap();
        let rows: Vec<&str> = table.lines().skip(1).collect();
        assert_eq!(rows.len(), 4);
        assert!(rows[0].ends_with(",1,2,3"), "{table}");
        assert!(rows[2].ends_with(",") && rows[3].ends_with(","), "{table}");
        std::fs::write(folder.path().join("timestamps.txt"), "\n".repeat(OXTS_MOST + 1)).unwrap();
        assert!(oxts(folder.path()).unwrap_err().to_string().contains("more than 1000000 samples"));
    }

    #[test]
    fn the_files_of_a_split_bag_have_the_order_of_its_metadata() {
        let metadata = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n    - ./night_2.db3 # the first\n\
                        \x20   - \"night_10.db3\"\n  duration:\n    - a.db3\n";
        assert_eq!(split_files(metadata), ["night_2.db3", "night_10.db3"]);
        assert!(split_files("").is_empty() && split_files("relative_file_paths: [a.db3]").is_empty());
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        std::fs::write(place("metadata.yaml"), metadata).unwrap();
        for name in ["night_10.db3", "night_2.db3"] {
            std::fs::write(place(name), name).unwrap();
        }
        let expected = [place("night_2.db3"), place("night_10.db3")];
        assert_eq!(bag_files(folder.path()).unwrap(), expected);
        assert_eq!(recording_files(folder.path()), expected);
        assert_eq!(recording_file(folder.path()).unwrap(), folder.path());
        std::fs::write(place("metadata.yaml"), metadata.replace("night_10", "night_3")).unwrap();
        let error = bag_files(folder.path()).unwrap_err().to_string();
        assert!(error.contains("no night_3.db3, which its metadata.yaml names"), "{error}");
        // Nothing is left out of the list.
        for other in ["../other.db3", "night_3.db3.zstd"] {
            std::fs::write(place("metadata.yaml"), metadata.replace("night_2.db3", other)).unwrap();
            let error = bag_files(folder.path()).unwrap_err().to_string();
            assert!(error.contains(other.trim_start_matches("./")) && error.contains("metadata.yaml"), "{error}");
        }
        std::fs::write(place("metadata.yaml"), "other: 1").unwrap();
        let error = bag_files(folder.path()).unwrap_err().to_string();
        assert!(error.contains("night_10.db3, night_2.db3"), "{error}");
    }
}
