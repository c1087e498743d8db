//! One N: checks whether `noise`, `model fit` and `diagnose` agree on N, B and K of one recording.
//!
//! ```text
//! cargo build --release && cargo run --release --example one_n -- [--worlds 200] [--first 1] [--samples 32768] [--all]
//! VN100D_REAL_DATA=folder cargo run --release --example one_n -- --worlds 0
//! ```
//!
//! The three commands run on the same file: those of the folder `VN100D_REAL_DATA` that can be read, and records that
//! the simulator makes with lines, bands, knocks, shared noise and filters. `diagnose` is given a model of N, B and K
//! alone, wrong by a fifth. Two answers agree if their 95 % intervals meet; a limit is an interval from 0.
//! Disagreements are printed, with `--all` all answers. `--keep` leaves each record in a folder, `--only WORD` selects
//! the worlds and recordings whose name contains the word.

#![expect(clippy::expect_used, reason = "a program for the workbench ends where it cannot go on")]

use imu_core::sample::Channel;
use imu_model::simulator::{SensorModel, plateau};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha20Rng;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

const RATE_HZ: f64 = 40.0;
const CHANNELS: [&str; 3] = ["gyro_x", "gyro_y", "gyro_z"];
/// As a VN-100's gyroscope, with larger B and K, so that records of minutes show them.
const N: f64 = 1.2e-4;
const B: f64 = 3.4e-5;
const K: f64 = 3.4e-6;
/// The error factors of the diagnosed model.
const WRONG: [f64; 3] = [1.2, 0.8, 0.8];
const WORLDS: [&str; 8] = ["plain", "lines", "band", "knocks", "shared", "filter", "filter behind", "everything"];
/// Recordings whose stamps do not show the rate.
const RATES: [(&str, &str); 1] = [("adis16405", "100")];

/// A command's answer for a parameter: its value, if it has one, and its range.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Answer {
    value: Option<f64>,
    ends: [f64; 2],
}

impl Answer {
    fn meets(self, other: Self) -> bool {
        self.ends[0] <= other.ends[1] && other.ends[0] <= self.ends[1]
    }
}

impl std::fmt::Display for Answer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.value {
            Some(value) => write!(f, "{value:.3e} [{:.3e}, {:.3e}]", self.ends[0], self.ends[1]),
            None => write!(f, "< {:.3e}", self.ends[1]),
        }
    }
}

fn number(value: &Value) -> Option<f64> {
    value.as_f64()
}

fn pair(value: &Value) -> Option<[f64; 2]> {
    Some([number(&value[0])?, number(&value[1])?])
}

/// Returns N, B or K of `noise`'s document.
fn of_noise(channel: &Value, letter: &str) -> Option<Answer> {
    let of = &channel[letter];
    match (number(&of["value"]), pair(&of["ci95"]), number(&of["upper_limit95"])) {
        (value @ Some(_), Some(ends), _) => Some(Answer { value, ends }),
        (_, _, Some(limit)) => Some(Answer { value: None, ends: [0.0, limit] }),
        _ => None,
    }
}

/// Returns N, B or K of a model. N is the plateau, between the values for the ends of its own N.
fn of_model(model: &SensorModel, channel: Channel, letter: &str, samples: u64) -> Option<Answer> {
    let own = model.channels.get(&channel)?;
    let stated = match letter {
        "N" => own.n,
        "B" => own.b,
        _ => own.k,
    };
    let seen = |stated: f64| {
        let mut model = model.clone();
        model.channels.get_mut(&channel).expect("it is there").n = stated;
        if letter == "N" { plateau(&model, channel, samples) } else { stated }
    };
    match (own.interval(letter), own.upper_limit(letter)) {
        (Some(ends), _) if stated > 0.0 => Some(Answer { value: Some(seen(stated)), ends: ends.map(seen) }),
        (_, Some(limit)) => Some(Answer { value: None, ends: [0.0, limit] }),
        _ => None,
    }
}

/// Returns a parameter that `diagnose` reports as different.
fn of_diagnosis(diagnosis: &Value, channel: &str, letter: &str) -> Option<Answer> {
    let list = diagnosis["parameters"].as_array()?;
    let of = list.iter().find(|of| of["channel"] == channel && of["parameter"] == letter)?;
    Some(Answer { value: number(&of["capture"]), ends: pair(&of["ci95"])? })
}

struct Bench {
    program: PathBuf,
    folder: PathBuf,
    all: bool,
    counts: BTreeMap<String, [u32; 4]>,
    withheld: u32,
    /// The model of a record that the simulator made.
    truth: Option<SensorModel>,
}

impl Bench {
    fn run(&self, arguments: &[&str]) -> Result<String, String> {
        let output = Command::new(&self.program).args(arguments).output().expect("the program runs");
        // 3: the import rejected lines.
        match output.status.code() {
            Some(0 | 3) => Ok(String::from_utf8_lossy(&output.stdout).into_owned()),
            _ => Err(String::from_utf8_lossy(&output.stderr).lines().next().unwrap_or_default().to_owned()),
        }
    }

    fn file(&self, name: &str) -> String {
        self.folder.join(name).display().to_string()
    }

    /// Runs all three commands on a recording, and counts.
    fn ask(&mut self, world: &str, name: &str, recording: &str, rate: Option<&str>) {
        let rate: Vec<&str> = rate.iter().flat_map(|rate| ["--rate", *rate]).collect();
        let with = |arguments: &[&str]| self.run(&[arguments, &rate].concat());
        let noise = match with(&["noise", recording, "--format", "json"]) {
            Ok(text) => serde_json::from_str::<Value>(&text).expect("noise writes JSON"),
            Err(why) => return println!("{name}: {why}"),
        };
        let read = |text: &str| SensorModel::from_json(text, "model").expect("model fit writes a model");
        let fit = match with(&["model", "fit", recording, "--force"]) {
            Ok(text) => read(&text),
            Err(why) => return println!("{name}: {why}"),
        };
        let mut wrong = fit.clone();
        wrong.channels.values_mut().for_each(|of| {
            *of = imu_model::simulator::ChannelModel {
                n: WRONG[0] * of.n,
                b: WRONG[1] * of.b.max(0.1 * of.n),
                k: WRONG[2] * of.k.max(1e-2 * of.n),
                bias: of.bias,
                ..Default::default()
            };
        });
        let (model, better) = (self.file("wrong.json"), self.file("better.json"));
        std::fs::write(&model, serde_json::to_string(&wrong).expect("a model is JSON")).expect("the folder is there");
        let printed = with(&[
            "diagnose",
            "--real",
            recording,
            "--sim",
            &model,
            "--augmented-model",
            &better,
            "--force",
            "--json",
        ]);
        let diagnosis = match printed {
            Ok(text) => serde_json::from_str::<Value>(&text).expect("diagnose writes JSON"),
            Err(why) => return println!("{name}: {why}"),
        };
        let corrected = read(&std::fs::read_to_string(&better).expect("diagnose wrote it"));
        let causes = |channel: &str| -> String {
            let of = diagnosis["causes"].as_array().into_iter().flatten();
            let on =
                |cause: &&Value| cause["channels"].as_array().is_some_and(|on| on.iter().any(|own| own == channel));
            of.filter(on).filter_map(|cause| cause["effect"].as_str()).collect::<Vec<_>>().join(", ")
        };
        let samples = noise["samples"].as_u64().unwrap_or_default();
        for (channel, of) in noise["channels"].as_object().into_iter().flatten() {
            let Some(own) = Channel::from_name(channel) else { continue };
            if of["usable"] == false {
                self.withheld += 1;
                continue;
            }
            for letter in ["N", "B", "K"] {
                let Some(noise) = of_noise(of, letter) else { continue };
                let others = [
                    ("model fit", of_model(&fit, own, letter, samples)),
                    ("diagnose", of_diagnosis(&diagnosis, channel, letter)),
                    ("corrected", of_model(&corrected, own, letter, samples)),
                ];
                // An N that is wrong by a fifth is far beyond its interval: a diagnosis that does not report it has
                // missed it.
                let met = others.map(|(_, other)| other.map_or(letter != "N", |other| noise.meets(other)));
                let count = self.counts.entry(format!("{world:<14} {letter}")).or_default();
                count[0] += 1;
                for (count, met) in count[1..].iter_mut().zip(met) {
                    *count += u32::from(met);
                }
                if self.all || met.contains(&false) {
                    let rest: Vec<String> = others
                        .iter()
                        .zip(met)
                        .map(|((who, other), met)| {
                            let text = other.map_or_else(|| "–".to_owned(), |other| other.to_string());
                            format!("{who} {text}{}", if met { "" } else { " !" })
                        })
                        .collect();
                    let truth = self.truth.as_ref().map_or(String::new(), |truth| {
                        let of = &truth.channels[&own];
                        let size = [plateau(truth, own, samples), of.b, of.k]
                            [["N", "B", "K"].iter().position(|own| *own == letter).unwrap_or(0)];
                        format!("truth {size:.3e}; ")
                    });
                    println!(
                        "{name} {channel} {letter}: {truth}noise {noise}; {}; {}",
                        rest.join("; "),
                        causes(channel)
                    );
                }
            }
        }
    }
}

/// Returns the effects of a world, one list per channel.
fn effects(world: &str, rng: &mut ChaCha20Rng, length_s: f64) -> [Vec<Value>; 3] {
    let white = N * RATE_HZ.sqrt();
    let mut between = |low: f64, high: f64| low * (high / low).powf(rng.random::<f64>());
    let mut lists: [Vec<Value>; 3] = Default::default();
    let has = |own: &str| world == own || world == "everything";
    // A source is the same on all channels that share it, with a separate size on each.
    if has("shared") {
        for list in &mut lists {
            list.push(json!({"effect": "common_mode", "sigma": white * between(0.3, 1.5)}));
        }
    }
    for list in &mut lists {
        if has("lines") {
            for _ in 0..2 {
                let (frequency_hz, amplitude) = (between(1.0, 19.0), white * between(0.1, 3.0));
                list.push(json!({"effect": "tone", "frequency_hz": frequency_hz, "amplitude": amplitude}));
            }
        }
        if has("band") {
            list.push(
                json!({"effect": "resonance", "frequency_hz": between(4.0, 18.0), "bandwidth_hz": between(0.1, 4.0),
                "sigma": white * between(0.3, 5.0)}),
            );
        }
        if has("knocks") {
            let at: Vec<f64> = (0..4).map(|knock| (f64::from(knock) + between(0.1, 0.9)) * length_s / 4.0).collect();
            let intervals: Vec<[f64; 2]> = at.iter().map(|at| [*at, at + between(0.2, 3.0)]).collect();
            list.push(json!({"effect": "bursts", "intervals": intervals, "sigma": white * between(2.0, 20.0)}));
        }
        if has("filter") || world == "filter behind" {
            let behind = if world == "filter behind" { N * between(0.05, 0.5) } else { 0.0 };
            let mut filter = if between(1.0, 2.0) < 1.4 {
                json!({"effect": "moving_average", "window": between(2.0, 9.0) as u64})
            } else {
                json!({"effect": "low_pass", "cutoff_hz": between(3.0, 14.0), "order": between(1.0, 3.9) as u64})
            };
            if behind > 0.0 {
                filter["white_behind"] = json!(behind);
            }
            list.push(filter);
        }
    }
    lists
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let (mut worlds, mut first, mut samples, mut only) = (200u64, 1u64, 32_768u32, String::new());
    let (mut all, mut keep) = (false, false);
    while let Some(flag) = arguments.next() {
        let mut value = || arguments.next().expect("a value after the flag");
        match flag.as_str() {
            "--worlds" => worlds = value().parse().expect("a number"),
            "--first" => first = value().parse().expect("a number"),
            "--samples" => samples = value().parse().expect("a number"),
            "--only" => only = value(),
            "--all" => all = true,
            "--keep" => keep = true,
            other => panic!("unknown flag {other}"),
        }
    }
    let own = std::env::current_exe().expect("this program has a path");
    let program = own.parent().and_then(Path::parent).expect("it lies in target/…/examples").join("vn100d");
    let folder = tempfile::tempdir().expect("there is room for files");
    let mut bench =
        Bench { program, folder: folder.path().to_owned(), all, counts: BTreeMap::new(), withheld: 0, truth: None };
    let length_s = f64::from(samples) / RATE_HZ;
    for seed in first..first + worlds {
        let world = WORLDS[(seed % WORLDS.len() as u64) as usize];
        if !world.contains(&only) {
            continue;
        }
        if keep {
            bench.folder = PathBuf::from(format!("one_n-{seed}"));
            std::fs::create_dir_all(&bench.folder).expect("a folder can be made here");
        }
        let mut rng = ChaCha20Rng::seed_from_u64(0x0e1f ^ seed);
        let lists = effects(world, &mut rng, length_s);
        let channels: Map<String, Value> = CHANNELS
            .iter()
            .zip(lists)
            .map(|(channel, effects)| ((*channel).to_owned(), json!({"N": N, "B": B, "K": K, "effects": effects})))
            .collect();
        let truth =
            json!({"format": "vn100d-sensor-model-1", "name": "truth", "rate_hz": RATE_HZ, "channels": channels});
        let (path, recording) = (bench.file("truth.json"), bench.file("record.csv"));
        std::fs::write(&path, truth.to_string()).expect("the folder is there");
        let duration = format!("{length_s}s");
        let made = bench.run(&[
            "simulate",
            "--model",
            &path,
            "--duration",
            &duration,
            "--seed",
            &seed.to_string(),
            "--out",
            &recording,
            "--force",
        ]);
        made.expect("the truth can be simulated");
        bench.truth = SensorModel::from_json(&truth.to_string(), "truth").ok();
        bench.ask(world, &format!("{world} {seed}"), &recording, None);
    }
    bench.truth = None;
    if let Some(data) = std::env::var_os("VN100D_REAL_DATA") {
        let mut files: Vec<PathBuf> = Vec::new();
        let folders = std::fs::read_dir(&data).expect("VN100D_REAL_DATA is a folder").flatten();
        for folder in folders.filter(|of| of.path().is_dir()) {
            files.extend(std::fs::read_dir(folder.path()).expect("it can be read").flatten().map(|of| of.path()));
        }
        files.sort();
        for file in files {
            let shown = file.strip_prefix(&data).unwrap_or(&file).display().to_string();
            // References are no recordings, and curves no samples.
            let other = [".optical.", ".vicon.", ".encoder.", "oadev", "allan-curves", ".json", ".ulg"];
            if other.iter().any(|part| shown.contains(part)) || !shown.contains(&only) {
                continue;
            }
            let rate = RATES.iter().find(|(folder, _)| shown.starts_with(folder)).map(|(_, rate)| *rate);
            bench.ask("real", &shown, &file.display().to_string(), rate);
        }
    }
    println!("world                 asked  model fit  diagnose  corrected");
    for (what, [asked, fit, diagnosis, corrected]) in &bench.counts {
        println!("{what:<20} {asked:>6} {fit:>10} {diagnosis:>9} {corrected:>10}");
    }
    println!("{} channels withheld by noise", bench.withheld);
}
