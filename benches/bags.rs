//! The cost of reading ROS recordings: a ROS 1 bag, a ROS 2 `.db3` and an MCAP file with the same messages, read whole
//! as an import reads them (both passes and the accounting, without the database), time and peak of the heap.
//!
//! `cargo bench --bench bags` reads recordings that it makes itself. `python3 benches/bags.py` lets rosbags make them,
//! and runs rosbags beside this bench. With `BAGS_DIR` set, its `imu.bag`, `imu.db3` and `imu.mcap` are read instead,
//! and the figures are written there.

#![expect(clippy::unwrap_used, reason = "a bench that cannot go on ends")]

use imu_files::recording::{Item, Options, Recording, RecordingAccountant};
use peak_alloc::PeakAlloc;
use rustix::time::{ClockId, clock_gettime};
use std::path::{Path, PathBuf};
use std::time::Instant;
use vn100_testkit::{bag, ros2};

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

const ROUNDS: usize = 5;
/// Messages of a generated recording.
const MESSAGES: usize = 200_000;
const START_NS: u64 = 1_700_000_000_000_000_000;
const STEP_NS: u64 = 5_000_000;
/// The number of these messages in a recorder's chunk of about 768 KiB.
const PER_CHUNK: usize = 2400;

fn main() {
    let quick = !std::env::args().any(|argument| argument == "--bench");
    let (messages, rounds) = if quick { (500, 1) } else { (MESSAGES, ROUNDS) };
    let given = std::env::var_os("BAGS_DIR").map(PathBuf::from);
    let own = tempfile::tempdir().unwrap();
    let folder = given.as_deref().unwrap_or(own.path());
    if given.is_none() {
        make(folder, messages);
    }
    let mut rows = Vec::new();
    for name in ["imu.bag", "imu.db3", "imu.mcap"] {
        let file = folder.join(name);
        let mut times = Vec::new();
        let mut samples = 0;
        ALLOCATOR.reset_peak_usage();
        for _ in 0..rounds {
            let (begun, begun_s) = (Instant::now(), processor_s());
            samples = read(&file);
            times.push((processor_s() - begun_s, begun.elapsed().as_secs_f64()));
        }
        times.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (processor, wall) = times[times.len() / 2];
        println!(
            "{name:<9} {samples:>8} samples: {:>9.0} a second ({wall:.3} s, {processor:.3} s of processor), heap at most {:.1} MB",
            samples as f64 / wall,
            ALLOCATOR.peak_usage_as_mb()
        );
        rows.push(serde_json::json!({ "file": name, "samples": samples, "processor_s": processor, "wall_s": wall }));
    }
    if let Some(folder) = given {
        std::fs::write(folder.join("run.json"), serde_json::json!(rows).to_string()).unwrap();
    }
}

/// Returns the number of samples of a recording, read as an import does.
fn read(file: &Path) -> u64 {
    let recording = Recording::open(file, Options::default()).unwrap();
    let mut accountant = RecordingAccountant::new(recording.info());
    let (mut samples, mut records) = (0, Vec::new());
    for item in recording.items().unwrap() {
        let item = item.unwrap();
        samples += u64::from(matches!(item, Item::Sample(..)));
        accountant.take(item, &mut records);
        records.clear();
    }
    samples
}

/// Returns the processor time so far, s: other work on the machine does not lengthen it.
fn processor_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Writes the three recordings.
fn make(folder: &Path, messages: usize) {
    let value = |index: usize| [1e-3 * (index % 7) as f64, -2e-3 * (index % 5) as f64, 9.8];
    let stamp_ns = |index: usize| START_NS + STEP_NS * index as u64;
    let cdr = |index| ros2::Cdr::little_endian().imu(stamp_ns(index), value(index), value(index + 1)).bytes();
    let second: Vec<ros2::Message> = (0..messages).map(|index| (0, stamp_ns(index) as i64, cdr(index))).collect();
    let topics = [("/imu/data", "sensor_msgs/msg/Imu", Some(ros2::IMU_DEFINITION))];
    std::fs::write(folder.join("imu.db3"), ros2::db3(&topics, &second)).unwrap();
    std::fs::write(folder.join("imu.mcap"), ros2::mcap(&topics, &second, true, PER_CHUNK)).unwrap();
    // ROS 1 has no alignment, and its header contains a number.
    let ros1 = |index: usize| {
        let mut data = (index as u32).to_le_bytes().to_vec();
        data.extend(bag::time(stamp_ns(index)));
        data.extend([3, 0, 0, 0]);
        data.extend(b"imu");
        let zeros = |count| std::iter::repeat_n(0.0, count);
        let fields = [0.0, 0.0, 0.0, 1.0].into_iter().chain(zeros(9)).chain(value(index)).chain(zeros(9));
        for field in fields.chain(value(index + 1)).chain(zeros(9)) {
            data.extend(field.to_le_bytes());
        }
        data
    };
    let chunks: Vec<Vec<u8>> = (0..messages)
        .collect::<Vec<_>>()
        .chunks(PER_CHUNK)
        .map(|indices| {
            let mut records = if indices[0] == 0 { bag::connection(0, "/imu/data", bag::IMU) } else { Vec::new() };
            indices.iter().for_each(|index| records.extend(bag::message(0, stamp_ns(*index), &ros1(*index))));
            bag::chunk("lz4", &records)
        })
        .collect();
    std::fs::write(folder.join("imu.bag"), bag::bag(&chunks)).unwrap();
}
