//! Prints the results of `vn100d noise` for the recordings in a folder, one row each: the table in docs/validation.md.
//!
//! ```text
//! cargo build --release && VN100D_REAL_DATA=folder cargo run --release --example real_noise
//! ```
//!
//! A channel is usable if the fit lies inside the measured Allan deviation's band at every averaging time, as one test
//! at 1 %.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Recordings without stamps, and their rates.
const RATES: [(&str, &str); 1] = [("adis16405", "100")];
/// References and curves, which are not recordings of a sensor.
const OTHERS: [&str; 6] = [".optical.", ".vicon.", ".encoder.", "oadev_", "allan-curves", ".json"];

fn files(folder: &Path, into: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            files(&path, into)?;
        } else {
            into.push(path);
        }
    }
    Ok(())
}

fn seconds(value: &Value) -> String {
    value.as_f64().map_or_else(|| "–".to_owned(), |seconds| format!("{seconds:.0}"))
}

fn row(name: &str, document: &Value) -> String {
    let (mut all, mut usable, mut withheld) = (0, 0, Vec::new());
    for (channel, of) in document["channels"].as_object().into_iter().flatten() {
        all += 1;
        if of["usable"] == true {
            usable += 1;
        } else {
            let reason = of["reason"].as_str().unwrap_or("no reason").to_owned();
            withheld.push((channel.clone(), reason));
        }
    }
    let mut reasons: Vec<String> = Vec::new();
    if let Some((_, reason)) = withheld.first().filter(|first| withheld.iter().all(|of| of.1 == first.1)) {
        reasons.push(if withheld.len() == all { reason.clone() } else { format!("{}: {reason}", channels(&withheld)) });
    } else {
        reasons.extend(withheld.iter().map(|(channel, reason)| format!("{channel}: {reason}")));
    }
    let rate_hz = document["rate_hz"].as_f64().unwrap_or_default();
    let times = ["duration_s", "at_rest_s"].map(|key| seconds(&document[key]));
    format!("| {name} | {rate_hz:.2} | {} | {} | {usable} of {all} | {} |", times[0], times[1], reasons.join("; "))
}

fn channels(of: &[(String, String)]) -> String {
    of.iter().map(|(channel, _)| channel.as_str()).collect::<Vec<_>>().join(", ")
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = PathBuf::from(std::env::var("VN100D_REAL_DATA")?);
    let program = std::env::current_exe()?.with_file_name("").join("../vn100d");
    let mut all = Vec::new();
    files(&folder, &mut all)?;
    all.sort();
    println!("| recording | rate, Hz | duration, s | at rest, s | inside the measured curve's band | withheld |");
    println!("|---|---|---|---|---|---|");
    for file in all {
        let name = file.strip_prefix(&folder)?.display().to_string();
        if OTHERS.iter().any(|other| name.contains(other)) || name.ends_with("README.md") {
            continue;
        }
        let mut command = Command::new(&program);
        command.args(["noise", "--json"]).arg(&file);
        if let Some((_, rate)) = RATES.iter().find(|(of, _)| name.starts_with(of)) {
            command.args(["--rate", rate]);
        }
        let output = command.output()?;
        match serde_json::from_slice::<Value>(&output.stdout) {
            Ok(document) => println!("{}", row(&name, &document)),
            Err(_) => {
                let stderr = String::from_utf8_lossy(&output.stderr);
                println!("| {name} | – | – | – | – | {} |", stderr.lines().last().unwrap_or_default());
            }
        }
    }
    Ok(())
}
