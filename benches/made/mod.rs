//! A capture of the demonstration's sensor, for the benches that read one.

use imu_core::sample::{Channel, Record, Sample, Segment, Timebase};
use imu_model::simulator::{Simulator, default_model};
use vn100d::store::{NewCapture, Store};

const START_NS: i64 = 1_800_000_000_000_000_000;

/// Makes a capture with `samples` samples whose values `written` has converted; returns its id.
pub fn capture(
    store: &Store,
    capture: NewCapture,
    channels: &[Channel],
    rate_hz: f64,
    samples: u64,
    written: impl Fn(Channel, f64) -> f64,
) -> i64 {
    let mut model = default_model();
    model.channels.retain(|channel, _| channels.contains(channel));
    let mut simulator = Simulator::new(&model, 1, rate_hz, samples as f64 / rate_hz).unwrap();
    let mut import = store.begin_import(capture, None).unwrap();
    let period_ns = (1e9 / rate_hz) as u64;
    import
        .push(Record::Segment(Segment {
            number: 1,
            epoch: 1,
            first_seq: 0,
            rate_hz,
            timebase: Timebase::Device,
            channels: channels.iter().copied().collect(),
            first_device_time_ns: Some(0),
            first_utc_ns: START_NS,
            boot_id: None,
        }))
        .unwrap();
    for seq in 0..samples {
        let mut sample = Sample::at(1_000_000_000_000 + seq * period_ns, START_NS + (seq * period_ns) as i64);
        sample.device_time_ns = Some(seq * period_ns);
        let values = simulator.next_values();
        channels.iter().for_each(|channel| sample.set(*channel, written(*channel, values[*channel as usize])));
        import.push(Record::Sample { seq, segment: 1, sample }).unwrap();
    }
    import.finish(None).unwrap().id()
}
