//! The cost of a simulation: five hours of nine channels with N, B and K, at 40 Hz and at 800 Hz, and through the
//! sensor's boxcar; time, processor time and peak of the heap. `cargo bench --bench simulator`; `benches/simulator.py`
//! runs it beside the same work in NumPy.

#![expect(clippy::expect_used, reason = "a bench that cannot go on ends")]

use imu_core::sample::Channel;
use imu_model::simulator::{Sampling, SensorModel, Simulator, default_model};
use peak_alloc::PeakAlloc;
use std::time::Instant;

#[global_allocator]
static ALLOCATOR: PeakAlloc = PeakAlloc;

const LENGTH_S: f64 = 18_000.0;

fn nine() -> SensorModel {
    let mut model = default_model();
    model.channels.retain(|channel, _| Channel::ANALYSED.contains(channel));
    model
}

/// Returns the processor time of all threads so far, s: other work on the machine does not lengthen it.
fn processor_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

fn measure(name: &str, model: &SensorModel, rate_hz: f64, threads: usize) {
    ALLOCATOR.reset_peak_usage();
    let (begun, begun_s) = (Instant::now(), processor_s());
    let simulator = Simulator::new(model, 1, rate_hz, LENGTH_S).expect("a model that can be simulated");
    let mut simulator = simulator.with_threads(threads);
    let wanted = (LENGTH_S * rate_hz) as u64;
    let (mut made, mut sum) = (0, 0.0);
    while made < wanted {
        let block = simulator.next_block().expect("there is no end at rest");
        made += block.len() as u64;
        sum += block.values(Channel::GyroX).expect("the channel").iter().sum::<f64>();
    }
    let (took_s, peak) = (begun.elapsed().as_secs_f64(), ALLOCATOR.peak_usage_as_mb());
    let worked_s = processor_s() - begun_s;
    println!(
        "{name:<34} {threads} threads: {took_s:>7.3} s, {worked_s:>7.3} s of processor, {peak:>6.1} MB (mean of gyro_x {:.6})",
        sum / made as f64
    );
}

fn main() {
    let plain = nine();
    let sampled = SensorModel { sampling: Some(Sampling { internal_rate_hz: 800.0, filter_window: 4 }), ..nine() };
    for threads in [1, 2] {
        measure("5 h at 40 Hz", &plain, 40.0, threads);
        measure("5 h at 800 Hz", &plain, 800.0, threads);
        measure("5 h at 40 Hz behind the boxcar", &sampled, 40.0, threads);
    }
}
