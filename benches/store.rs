//! The speed at which the store writes and reads samples; prints figures, `cargo bench --bench store`.
//!
//! The writer's figure holds for the disk under `TMPDIR`: every batch is synced.

#![expect(clippy::unwrap_used, reason = "a bench that cannot go on ends")]

use imu_core::sample::{Channel, Record, Sample, Segment, Timebase};
use std::time::{Duration, Instant};
use vn100d::jobs::{AnalysisRequest, JobKind, JobParameters, Jobs, JobsOptions};
use vn100d::store::{CaptureState, JobState, NewCapture, Reader, Store, StoreOptions};

const PERIOD_NS: u64 = 1_250_000;

fn segment(rate_hz: f64) -> Record {
    Record::Segment(Segment {
        number: 1,
        epoch: 1,
        first_seq: 0,
        rate_hz,
        timebase: Timebase::Device,
        channels: Channel::ALL.into_iter().collect(),
        first_device_time_ns: Some(0),
        first_utc_ns: 1_800_000_000_000_000_000,
        boot_id: None,
    })
}

fn record(seq: u64) -> Record {
    let mut sample =
        Sample::at(1_000_000_000_000 + seq * PERIOD_NS, 1_800_000_000_000_000_000 + (seq * PERIOD_NS) as i64);
    sample.device_time_ns = Some(seq * PERIOD_NS);
    let mut state = seq.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    for channel in Channel::ALL {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        sample.set(channel, f64::from((state >> 40) as f32 * 1e-6 - 8.0));
    }
    Record::Sample { seq, segment: 1, sample }
}

fn main() {
    // `cargo test --benches` only checks that it runs.
    let quick = !std::env::args().any(|argument| argument == "--bench");
    let samples: u64 = if quick { 20_000 } else { 2_000_000 };
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("bench.db");
    let store = Store::open(&path, StoreOptions::default()).unwrap();
    let id = store.create_capture(NewCapture::new("bench", CaptureState::Capturing)).unwrap();
    let sender = store.records();
    sender.blocking_send(id, segment(800.0)).unwrap();
    let begun = Instant::now();
    let mut slowest = 0.0_f64;
    for seq in 0..samples {
        sender.blocking_send(id, record(seq)).unwrap();
        if seq % 4096 == 0 {
            slowest = slowest.max(store.progress().last_commit.map_or(0.0, |took| took.as_secs_f64()));
        }
    }
    store.flush_blocking().unwrap();
    let took = begun.elapsed().as_secs_f64();
    println!(
        "write: {:>9.0} samples/s ({samples} in {took:.2} s, 14 channels, synced; slowest commit {slowest:.3} s)",
        samples as f64 / took
    );
    store.close().unwrap();
    let bytes = std::fs::metadata(&path).unwrap().len();
    println!("size:  {:>9.1} bytes per sample", bytes as f64 / samples as f64);

    let reader = Reader::open(&path).unwrap();
    for channels in [&Channel::ALL[9..12], &Channel::ANALYSED[..], &Channel::ALL[..]] {
        let begun = Instant::now();
        let (mut seq, mut sum) = (0, 0.0);
        loop {
            let chunk = reader.read_chunk(id, seq, 32_768, channels).unwrap();
            if chunk.is_empty() {
                break;
            }
            sum += chunk.columns.iter().flatten().sum::<f64>();
            seq = chunk.next_seq();
        }
        assert_eq!(seq, samples);
        assert!(sum.is_finite());
        let took = begun.elapsed().as_secs_f64();
        println!("read:  {:>9.0} samples/s ({} channels)", samples as f64 / took, channels.len());
    }
    drop(reader);
    let samples = if quick { 20_000 } else { 720_000 };
    analyse(&path, samples);
}

/// Runs an import of five hours at 40 Hz and its jobs, including reading, sums, checkpoints and the result.
fn analyse(path: &std::path::Path, samples: u64) {
    let store = Store::open(path, StoreOptions::default()).unwrap();
    let begun = Instant::now();
    let mut import = store.begin_import(NewCapture::new("bench", CaptureState::Imported), None).unwrap();
    import.push(segment(40.0)).unwrap();
    for seq in 0..samples {
        import.push(record(seq)).unwrap();
    }
    let id = import.finish(None).unwrap().id();
    let took = begun.elapsed().as_secs_f64();
    println!("import: {:>8.0} samples/s", samples as f64 / took);
    let jobs = Jobs::start(&store, JobsOptions::default()).unwrap();
    let reader = store.reader().unwrap();
    for (kind, what, channels) in [
        (JobKind::Allan, "one channel", Some(vec![Channel::GyroX])),
        (JobKind::Allan, "nine channels", None),
        (JobKind::Noise, "nine channels", None),
        (JobKind::Statistics, "fourteen channels", None),
    ] {
        let begun = Instant::now();
        let request = AnalysisRequest::new(kind, JobParameters { channels, ..JobParameters::default() }).unwrap();
        let job = jobs.submit(id, request).unwrap().0.id;
        while reader.job(job).unwrap().state != JobState::Done {
            std::thread::sleep(Duration::from_millis(1));
        }
        println!("{} job, {samples} samples, {what}: {:.3} s", kind.name(), begun.elapsed().as_secs_f64());
    }
    jobs.stop();
}
