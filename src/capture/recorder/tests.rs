//! A recorder from its first sample to its planned end, and resumed.

use super::*;
use imu_core::sample::Channel;

const PERIOD_NS: u64 = 25_000_000;

fn sample(tick: u64) -> Sample {
    let host = 1_000_000_000 + tick * PERIOD_NS;
    let mut sample = Sample::at(host, 1_700_000_000_000_000_000 + host as i64);
    sample.device_time_ns = Some(3_000_000_000 + tick * PERIOD_NS);
    sample.set(Channel::GyroX, 0.0);
    sample
}

fn recorder(seconds: u64) -> Recorder {
    let plan = Plan { id: 1, name: "night".into(), duration_ns: seconds * 1_000_000_000, start_at_utc_ns: None };
    let mut recorder = Recorder::new(plan, None, 0.0);
    recorder.accept(40.0, Timebase::Device, &mut Vec::new());
    recorder
}

#[test]
fn a_capture_is_complete_with_duration_times_rate_samples() {
    let (mut recorder, mut out) = (recorder(10), Vec::new());
    for tick in 0..500 {
        recorder.sample(sample(tick), &mut out);
    }
    assert!(recorder.has_ended());
    assert_eq!(recorder.counts().samples, 400);
    assert_eq!(out.iter().filter(|record| matches!(record, Record::Sample { .. })).count(), 400);
    assert!(matches!(out.last(), Some(Record::Ended { how: CaptureEnd::Complete, .. })));
}

#[test]
fn missing_samples_count_and_a_gap_is_cut_at_the_planned_end() {
    let (mut recorder, mut out) = (recorder(10), Vec::new());
    for tick in 0..100 {
        recorder.sample(sample(tick), &mut out);
    }
    recorder.interrupt(GapCause::Unplugged, &mut out);
    // The second sample shows that the rate is the same after the gap.
    recorder.sample(sample(5000), &mut out);
    recorder.sample(sample(5001), &mut out);
    assert!(recorder.has_ended());
    assert_eq!((recorder.counts().samples, recorder.counts().missing), (100, 300));
}

/// A night is not over after seconds because the sensor came back with another rate.
#[test]
fn a_gap_between_two_rates_takes_its_own_time() {
    const AWAY_NS: u64 = 5_000_000_000;
    for timebase in [Timebase::Device, Timebase::SyncCounter, Timebase::Arrival] {
        for [from_hz, to_hz] in [[10.0, 200.0], [200.0, 10.0], [40.0, 800.0], [1.0, 800.0], [40.0, 50.0]] {
            let plan = Plan { id: 1, name: "night".into(), duration_ns: 3_600_000_000_000, start_at_utc_ns: None };
            let (mut recorder, mut out) = (Recorder::new(plan, None, 0.0), Vec::new());
            let (mut at_ns, mut count) = (1_000_000_000_u64, 0_u32);
            let mut send = |recorder: &mut Recorder, rate_hz: f64, away_ns: u64| {
                recorder.accept(rate_hz, timebase, &mut out);
                at_ns += away_ns;
                count += (away_ns as f64 / period_ns(rate_hz)) as u32;
                for _ in 0..(20.0 * rate_hz) as u64 {
                    let mut sample = Sample::at(at_ns, 1_700_000_000_000_000_000 + at_ns as i64);
                    sample.device_time_ns = (timebase == Timebase::Device).then_some(at_ns);
                    sample.sync_count = (timebase == Timebase::SyncCounter).then_some(count);
                    recorder.sample(sample, &mut out);
                    at_ns += period_ns(rate_hz) as u64;
                    count += 1;
                }
            };
            send(&mut recorder, from_hz, 0);
            recorder.interrupt(GapCause::Unplugged, &mut Vec::new());
            send(&mut recorder, to_hz, AWAY_NS);
            recorder.tick(at_ns, 1_700_000_000_000_000_000 + at_ns as i64, &mut out);
            let found_s = recorder.counts().elapsed_ns / 1e9;
            let case = format!("{timebase:?} {from_hz} {to_hz}: {found_s} s");
            // What counts messages cannot count those of the rate before.
            let falls = timebase == Timebase::SyncCounter && to_hz < from_hz;
            let slower_s = 2.5 / from_hz.min(to_hz);
            assert!(found_s < 45.0 + slower_s && !recorder.has_ended(), "{case}");
            assert!(falls || found_s > 45.0 - slower_s, "{case}");
        }
    }
}

#[test]
fn a_sensor_that_stays_away_does_not_keep_the_capture_open() {
    let (mut recorder, mut out) = (recorder(10), Vec::new());
    for tick in 0..100 {
        recorder.sample(sample(tick), &mut out);
    }
    recorder.interrupt(GapCause::Unplugged, &mut out);
    recorder.tick(1_000_000_000 + 300 * PERIOD_NS, 0, &mut out);
    assert!(!recorder.has_ended());
    recorder.tick(1_000_000_000 + 800 * PERIOD_NS, 0, &mut out);
    assert!(recorder.has_ended());
    assert_eq!((recorder.counts().samples, recorder.counts().missing), (100, 300));
    let cause = out.iter().find_map(|record| if let Record::Gap(gap) = record { Some(gap.cause) } else { None });
    assert_eq!(cause, Some(GapCause::Unplugged));
}

/// The first sample after a reset is held until the next one shows whether it was read late.
#[test]
fn a_reset_before_the_last_sample_is_reported_once() {
    for more in [0, 1, 5] {
        let (mut recorder, mut out) = (recorder(10), Vec::new());
        for tick in 0..100 {
            recorder.sample(sample(tick), &mut out);
        }
        for tick in 150..=150 + more {
            let mut after = sample(tick);
            after.device_time_ns = Some((tick - 149) * PERIOD_NS);
            recorder.sample(after, &mut out);
        }
        recorder.stop(1_000_000_000 + (151 + more) * PERIOD_NS, 0, &mut out);
        let is_reset =
            |record: &&Record| matches!(record, Record::Event(EventRecord { kind: EventKind::SensorReset, .. }));
        assert_eq!(out.iter().filter(is_reset).count(), 1, "{more}");
        assert_eq!((recorder.counts().samples, recorder.counts().missing), (101 + more, 50), "{more}");
    }
}

/// Samples that are held until their rate is known are the last ones, and a rate that was only announced measures no gap.
#[test]
fn a_closing_gap_begins_at_the_last_sample_and_has_its_rate() {
    let at = |ns: u64| Sample::at(ns, 1_700_000_000_000_000_000 + ns as i64);
    let mut recorder = Recorder::new(
        Plan { id: 1, name: "night".into(), duration_ns: 60_000_000_000, start_at_utc_ns: None },
        None,
        0.0,
    );
    let mut out = Vec::new();
    recorder.accept(50.0, Timebase::Arrival, &mut out);
    let mut now_ns = 1_000_000_000;
    for period_ns in [20_000_000; 200].into_iter().chain([25_000_000; 60]) {
        now_ns += period_ns;
        recorder.sample(at(now_ns), &mut out);
    }
    let stopped_ns = now_ns + 1_500_000_000;
    recorder.stop(stopped_ns, 1_700_000_000_000_000_000 + stopped_ns as i64, &mut out);
    let gap = out.iter().rev().find_map(|record| if let Record::Gap(gap) = record { Some(gap) } else { None }).unwrap();
    assert_eq!(gap.to_utc_ns - gap.from_utc_ns, 1_500_000_000, "{gap:?}");

    let (mut recorder, mut out) = (self::recorder(10), Vec::new());
    for tick in 0..100 {
        recorder.sample(sample(tick), &mut out);
    }
    recorder.interrupt(GapCause::Unplugged, &mut out);
    recorder.accept(4.0, Timebase::Device, &mut out);
    for tick in [800, 808, 816] {
        recorder.tick(1_000_000_000 + tick * PERIOD_NS, 0, &mut out);
    }
    assert!(recorder.has_ended());
    assert_eq!((recorder.counts().samples, recorder.counts().missing, recorder.counts().gaps), (100, 300, 1));
}

#[test]
fn a_stopped_capture_ends_at_its_last_sample_and_discards_are_written_down() {
    let (mut recorder, mut out) = (recorder(10), Vec::new());
    recorder.sample(sample(0), &mut out);
    recorder.sample(sample(0), &mut out);
    recorder.discard(DiscardCause::Checksum, 2);
    recorder.stop(1_000_000_005, 5, &mut out);
    assert!(out.contains(&Record::Discarded { cause: DiscardCause::Duplicate, count: 1 }));
    assert!(out.contains(&Record::Discarded { cause: DiscardCause::Checksum, count: 2 }));
    assert_eq!(out.last(), Some(&Record::Ended { how: CaptureEnd::Stopped, utc_ns: 5 }));
}

/// Returns the recorder of a capture of ten seconds that has these samples, and the last of them.
fn resumed_after(samples: u64) -> (Recorder, Sample) {
    let plan = Plan { id: 1, name: "night".into(), duration_ns: 10_000_000_000, start_at_utc_ns: None };
    let last = sample(samples - 1);
    let point = ResumePoint {
        segments: 1,
        epoch: 1,
        samples,
        received: samples,
        discarded: BTreeMap::new(),
        missing: 0,
        gaps: 0,
        elapsed_ns: samples * PERIOD_NS,
        last: Some(Position {
            device_time_ns: last.device_time_ns,
            sync_count: None,
            host_mono_ns: 0,
            host_utc_ns: last.host_utc_ns,
        }),
        rate_hz: Some(40.0),
        serial_number: None,
        baud: None,
        previous_output: BTreeMap::new(),
    };
    (Recorder::new(plan, Some(point), 0.0), last)
}

#[test]
fn a_resumed_capture_whose_sensor_never_returns_ends_with_a_gap() {
    let ((mut recorder, last), mut out) = (resumed_after(100), Vec::new());
    recorder.tick(0, last.host_utc_ns + 5_000_000_000, &mut out);
    assert!(!recorder.has_ended());
    recorder.tick(0, last.host_utc_ns + 60_000_000_000, &mut out);
    assert!(recorder.has_ended());
    assert_eq!((recorder.counts().samples, recorder.counts().missing), (100, 300));
}

#[test]
fn a_resumed_capture_needs_only_what_is_left() {
    let ((mut recorder, _), mut out) = (resumed_after(300), Vec::new());
    recorder.accept(40.0, Timebase::Device, &mut out);
    for tick in 320..500 {
        recorder.sample(sample(tick), &mut out);
    }
    assert_eq!((recorder.counts().samples, recorder.counts().missing), (380, 20));
    let segment =
        out.iter().find_map(|record| if let Record::Segment(segment) = record { Some(segment.number) } else { None });
    assert_eq!(segment, Some(2));
}
