//! The cost of a diagnosis: nine channels of five hours at 40 Hz with one effect, two channels of 27 minutes, the exact
//! calibration at that size, and 20 minutes on a rate table at 100 Hz against their reference; time, processor time and
//! peak of the heap, beside cosine transforms of the same samples, of which whitening takes at least one. `cargo bench
//! --bench diagnosis`.

#![expect(clippy::expect_used, reason = "a bench that cannot go on ends")]

use imu_core::sample::{Channel, Triad};
use imu_diagnosis::calibration::{Nulls, RECORDS};
use imu_diagnosis::transform::Cosines;
use imu_diagnosis::{Options, Outcome, Recording, Reference, diagnose, diagnose_moved};
use imu_model::effects::Tone;
use imu_model::effects::triad::ScaleFactor;
use imu_model::motion::{Course, Kind, Site};
use imu_model::simulator::{Motion, SensorModel, Simulator, default_model};
use peak_alloc::PeakAlloc;
use std::sync::Arc;
use std::time::Instant;
use vn100d::jobs::TwoThreads;

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

const RATE_HZ: f64 = 40.0;

/// Returns the processor time of all threads so far, s: other work on the machine does not lengthen it.
fn processor_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Returns a record of some channels of the demonstration's sensor at rest, with a tone on the first channel, and the
/// model without the tone.
fn record(channels: &[Channel], samples: usize) -> (Recording, SensorModel) {
    let mut model = default_model();
    model.channels.retain(|channel, _| channels.contains(channel));
    model.rate_hz = RATE_HZ;
    let mut truth = model.clone();
    let first = truth.channels.get_mut(&channels[0]).expect("a channel of the model");
    let amplitude = 0.2 * first.n * RATE_HZ.sqrt();
    first.push_effect(Arc::new(Tone { frequency_hz: 13.38, amplitude }), &[]);
    let mut simulator =
        Simulator::new(&truth, 1, RATE_HZ, samples as f64 / RATE_HZ).expect("a model that can be simulated");
    let mut real = Recording { rate_hz: RATE_HZ, ..Recording::default() };
    real.channels = channels.iter().map(|channel| (*channel, Vec::with_capacity(samples))).collect();
    while real.len() < samples {
        let block = simulator.next_block().expect("there is no end at rest");
        for (channel, values) in &mut real.channels {
            let new = block.values(*channel).expect("the channel");
            values.extend_from_slice(&new[..new.len().min(samples - values.len())]);
        }
    }
    real.missing = vec![false; samples];
    (real, model)
}

/// Returns a record on a rate table whose gyro has a scale factor that is missing in the model, the reference motion,
/// and the model.
fn on_a_table(length_s: f64, rate_hz: f64) -> (Recording, Reference, SensorModel) {
    let mut model = default_model();
    model.channels.retain(|channel, _| matches!(channel.triad(), Some(Triad::Gyro | Triad::Accel)));
    model.triads.clear();
    // The motion has gravity, which at rest is a part of the accelerometer's bias.
    model.channels.values_mut().for_each(|of| (of.effects, of.bias) = (Vec::new(), None));
    model.rate_hz = rate_hz;
    let mut truth = model.clone();
    let effect = Arc::new(ScaleFactor { axes: [1e-3, -5e-4, 0.0] });
    truth.triads.entry(Triad::Gyro).or_default().effects.push(effect);
    let samples = (length_s * rate_hz) as usize;
    let course = Course::new(Kind::RateTable, length_s, Site::default()).expect("a length");
    let motions: Vec<Motion> = course.sampled(rate_hz).take(samples).collect();
    let rows = motions.iter().enumerate().map(|(index, motion)| (index as f64 / rate_hz, *motion));
    let reference = Reference::new(rows).expect("rows in order");
    let simulator = Simulator::new(&truth, 1, rate_hz, length_s).expect("a model that can be simulated");
    let mut simulator = simulator.with_motion(motions.into_iter());
    let mut real = Recording { rate_hz, ..Recording::default() };
    real.channels = model.channels.keys().map(|channel| (*channel, Vec::with_capacity(samples))).collect();
    for _ in 0..samples {
        let sample = simulator.next_sample().expect("as many as there are motions");
        real.channels.iter_mut().for_each(|(channel, values)| values.push(sample.values[*channel as usize]));
    }
    (real, reference, model)
}

/// Diagnoses a record several times.
fn measure(what: &str, real: &Recording, expected: &str, rounds: usize, diagnose: impl Fn() -> Outcome) {
    let (mut took, mut worked, mut transforms, mut peak) = (Vec::new(), Vec::new(), Vec::new(), 0.0f64);
    for _ in 0..rounds {
        let begun_s = processor_s();
        let mut transform = Cosines::new(real.len());
        for (_, values) in &real.channels {
            transform.forward(&mut values.clone());
        }
        transforms.push(processor_s() - begun_s);
        ALLOCATOR.reset_peak_usage();
        let before = ALLOCATOR.current_usage_as_mb();
        let (begun, begun_s) = (Instant::now(), processor_s());
        let outcome = diagnose();
        took.push(begun.elapsed().as_secs_f64());
        worked.push(processor_s() - begun_s);
        peak = peak.max(f64::from(ALLOCATOR.peak_usage_as_mb() - before));
        assert_eq!(outcome.diagnosis.causes.first().map(|cause| cause.effect.name()), Some(expected));
    }
    let median = |of: &mut Vec<f64>| {
        of.sort_unstable_by(f64::total_cmp);
        of[of.len() / 2]
    };
    let (took, worked, transforms) = (median(&mut took), median(&mut worked), median(&mut transforms));
    println!(
        "{what}: {took:.2} s on two threads, {worked:.2} s of processor, {:.0} times one cosine transform of each channel, {peak:.0} MB of heap beside the record",
        worked / transforms
    );
}

fn at_rest(what: &str, channels: &[Channel], samples: usize, rounds: usize) {
    let (real, model) = record(channels, samples);
    let options = Options { workers: &TwoThreads, ..Options::default() };
    measure(what, &real, "tone", rounds, || diagnose(&real, &model, &options).expect("a record that can be compared"));
}

fn with_a_motion(what: &str, length_s: f64, rate_hz: f64, rounds: usize) {
    let (real, reference, model) = on_a_table(length_s, rate_hz);
    let options = Options { workers: &TwoThreads, ..Options::default() };
    let found = || diagnose_moved(&real, &reference, &model, &options).expect("a record that can be compared");
    measure(what, &real, "scale_factor", rounds, found);
}

fn main() {
    // `cargo test --benches` only checks that it runs.
    let quick = !std::env::args().any(|argument| argument == "--bench");
    if quick {
        at_rest("two channels", &[Channel::AccelZ, Channel::GyroX], 20_000, 1);
        return with_a_motion("two minutes on a table", 120.0, 100.0, 1);
    }
    with_a_motion("20 min at 100 Hz on a rate table, six channels", 1200.0, 100.0, 5);
    at_rest("5 h at 40 Hz, nine channels", &Channel::ANALYSED, 720_000, 3);
    let two = [Channel::AccelZ, Channel::GyroX];
    at_rest("27 min at 40 Hz, two channels", &two, 65_536, 15);
    let (real, model) = record(&two, 65_536);
    let (begun, begun_s) = (Instant::now(), processor_s());
    let tails = Nulls::of(&real, &model).tails(RECORDS, &TwoThreads, &|_| true).expect("levels of noise");
    assert!(tails.expect("nobody stops it").is_whole());
    println!(
        "calibration at 27 min, {RECORDS} records of two channels: {:.0} s, {:.0} s of processor",
        begun.elapsed().as_secs_f64(),
        processor_s() - begun_s
    );
}
