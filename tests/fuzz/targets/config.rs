//! The configuration: accepted, or refused with file and line.

use std::path::Path;

const FILE: &str = "fuzz.toml";

pub fn refused_with_its_place(input: &[u8]) {
    let Ok(text) = std::str::from_utf8(input) else { return };
    // The configuration would open any file that is named.
    if text.contains("token") && text.contains("file") {
        return;
    }
    let Err(error) = vn100d::config::parse(Path::new(FILE), text) else { return };
    let message = error.to_string();
    let place = message.strip_prefix(FILE).and_then(|rest| rest.strip_prefix(':'));
    match place.and_then(|rest| rest.split(':').next()?.parse::<usize>().ok()) {
        Some(line) => assert!((1..=text.lines().count().max(1) + 1).contains(&line), "{message}"),
        None => assert!(message.contains("built-in default"), "no place: {message}"),
    }
}
