//! Streams with losses, bursts, resets and other rates, compared with the sent samples.

use super::*;
use crate::sample::Channel;
use proptest::prelude::*;

const PERIOD_NS: u64 = 25_000_000;

fn sample(tick: u64, device: bool, delay_ns: u64) -> Sample {
    let host = 1_000_000_000 + tick * PERIOD_NS + delay_ns;
    let mut sample = Sample::at(host, 1_700_000_000_000_000_000 + host as i64);
    sample.device_time_ns = device.then_some(5_000_000_000 + tick * PERIOD_NS);
    sample.set(Channel::GyroX, tick as f64);
    sample
}

fn gaps(out: &[Record]) -> Vec<&Gap> {
    out.iter().filter_map(|record| if let Record::Gap(gap) = record { Some(gap) } else { None }).collect()
}

fn seqs(out: &[Record]) -> Vec<(u64, u32)> {
    out.iter()
        .filter_map(
            |record| if let Record::Sample { seq, segment, .. } = record { Some((*seq, *segment)) } else { None },
        )
        .collect()
}

#[test]
fn a_clock_that_was_set_in_between_does_not_make_decades_of_absence() {
    assert_eq!(civil_elapsed_ns(1_000_000_000, 1_800_000_000_000_000_000), 0.0);
    assert_eq!(civil_elapsed_ns(1_000_000_000, 3_000_000_000), 2e9);
    assert_eq!(civil_elapsed_ns(3_000_000_000, 1_000_000_000), 0.0);
    assert_eq!(civil_elapsed_ns(1_800_000_000_000_000_000, 1_800_000_003_000_000_000), 3e9);
}

#[test]
fn a_step_of_three_periods_is_two_missing_samples_and_a_new_segment() {
    let mut accountant = Accountant::new(40.0, Timebase::Device);
    let mut out = Vec::new();
    for tick in [0, 1, 4, 5] {
        assert_eq!(accountant.observe(sample(tick, true, 0), &mut out), Observation::Taken);
    }
    let gaps = gaps(&out);
    assert_eq!(gaps.len(), 1);
    assert_eq!((gaps[0].before_seq, gaps[0].missing, gaps[0].missing_exact), (2, 2, true));
    assert_eq!(seqs(&out), [(0, 1), (1, 1), (2, 2), (3, 2)]);
    assert_eq!((accountant.received(), accountant.missing()), (4, 2));
}

#[test]
fn a_duplicate_is_dropped_and_a_clock_that_starts_again_is_a_reset() {
    let mut accountant = Accountant::new(40.0, Timebase::Device);
    let mut out = Vec::new();
    accountant.observe(sample(400, true, 0), &mut out);
    assert_eq!(accountant.observe(sample(400, true, 0), &mut out), Observation::Duplicate);
    assert_eq!(accountant.observe(sample(399, true, 0), &mut out), Observation::OutOfOrder);
    let mut after = sample(480, true, 0);
    after.device_time_ns = Some(1_000_000);
    accountant.observe(after, &mut out);
    // The next samples show that the first one after the reset was not read late.
    let next = [481, 482, 483].map(|tick| {
        let mut next = sample(tick, true, 0);
        next.device_time_ns = Some(1_000_000 + (tick - 480) * 25_000_000);
        accountant.observe(next, &mut out)
    });
    assert_eq!(next, [Observation::Taken, Observation::AfterReset, Observation::Taken]);
    let gaps = gaps(&out);
    assert_eq!((gaps[0].missing, gaps[0].missing_exact, gaps[0].cause), (79, false, GapCause::SensorReset));
}

/// B11: 200 → 100 Hz, and back to a faster one.
#[test]
fn a_silent_change_of_rate_is_a_new_segment_and_no_loss() {
    // 800 Hz over 5 and 6 differ by a fifth.
    for (from_hz, to_hz) in
        [(200.0, 100.0), (100.0, 200.0), (40.0, 10.0), (40.0, 400.0), (40.0, 50.0), (50.0, 40.0), (160.0, 800.0 / 6.0)]
    {
        let (mut accountant, mut out) = (Accountant::new(from_hz, Timebase::Device), Vec::new());
        let (mut at_ns, mut seen_after) = (5_000_000_000_u64, None);
        for index in 0..200 {
            at_ns += if index < 100 { period_ns(from_hz) } else { period_ns(to_hz) } as u64;
            let mut next = sample(0, true, 0);
            (next.device_time_ns, next.host_mono_ns) = (Some(at_ns), at_ns);
            if let Observation::RateChanged { from_hz: from, to_hz: to } = accountant.observe(next, &mut out) {
                assert_eq!((from, to), (from_hz, to_hz));
                seen_after = Some((index - 99) as f64 / to_hz);
            }
        }
        accountant.settle(&mut out);
        assert!(seen_after.unwrap() <= 2.0, "{seen_after:?}");
        assert_eq!((accountant.received(), accountant.missing()), (200, 0), "{from_hz} to {to_hz}");
        let rates: Vec<(u64, f64)> = out
            .iter()
            .filter_map(
                |record| if let Record::Segment(new) = record { Some((new.first_seq, new.rate_hz)) } else { None },
            )
            .collect();
        assert_eq!(rates, [(0, from_hz), (100, to_hz)]);
    }
}

/// Observes one measurement after another, at these times of the sensor's clock.
fn observe_at(accountant: &mut Accountant, ticks_ns: impl IntoIterator<Item = u64>, out: &mut Vec<Record>) {
    for at_ns in ticks_ns {
        let mut next = sample(0, true, 0);
        (next.device_time_ns, next.host_mono_ns) = (Some(at_ns), at_ns);
        accountant.observe(next, out);
    }
}

/// 200 → 80 Hz: steps of two and a half periods, which no loss makes, however early the stream is interrupted.
#[test]
fn steps_that_are_no_whole_number_of_periods_are_another_rate_and_no_loss() {
    let (mut accountant, mut out) = (Accountant::new(200.0, Timebase::Device), Vec::new());
    observe_at(&mut accountant, (0..20).map(|index| 5_000_000_000 + index * 5_000_000), &mut out);
    observe_at(&mut accountant, (1..5).map(|index| 5_095_000_000 + index * 12_500_000), &mut out);
    accountant.interrupt(GapCause::StorageBackpressure, &mut out);
    assert_eq!((accountant.rate_hz(), accountant.received(), accountant.missing()), (80.0, 24, 0));
}

/// 200 Hz is announced as 40 Hz and stays 200 Hz, with one sample lost in between: the missing samples follow from the
/// ticks alone.
#[test]
fn a_rate_that_was_announced_and_never_came_hides_no_loss() {
    let (mut accountant, mut out) = (Accountant::new(200.0, Timebase::Device), Vec::new());
    observe_at(&mut accountant, (0..20).map(|index| 5_000_000_000 + index * 5_000_000), &mut out);
    accountant.change(40.0, Timebase::Device, &mut out);
    observe_at(&mut accountant, (21..60).map(|index| 5_000_000_000 + index * 5_000_000), &mut out);
    accountant.settle(&mut out);
    assert_eq!((accountant.rate_hz(), accountant.received(), accountant.missing()), (200.0, 59, 1));
    assert!(gaps(&out)[0].missing_exact);
}

/// Samples of one segment are a period apart; a single step of 0.6 periods is neither a loss nor a repetition.
#[test]
fn a_step_that_is_no_period_begins_a_segment() {
    let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
    let ticks = (0..10).map(|index| index * PERIOD_NS).chain((0..10).map(|index| (9 + index) * PERIOD_NS + 15_000_000));
    observe_at(&mut accountant, ticks.map(|at_ns| 5_000_000_000 + at_ns), &mut out);
    accountant.settle(&mut out);
    assert_eq!((accountant.received(), accountant.missing()), (20, 0));
    assert_eq!(seqs(&out)[9..11], [(9, 1), (10, 2)]);
}

/// A single wrong tick is not a change of rate, also before an interruption or after an unfinished trial.
#[test]
fn a_single_short_step_is_no_change_of_rate() {
    let (period, tenth) = (PERIOD_NS, PERIOD_NS / 10);
    let regular = |from: u64, count: u64| (0..count).map(move |index| from + index * period);
    let late = 1_000_000_000;
    let streams: [Vec<u64>; 3] = [
        // One measurement too many, a tenth of a period after another.
        regular(0, 50).chain([49 * period + tenth]).chain(regular(50 * period, 50)).collect(),
        // Every other measurement is lost for a while, then one comes a tenth of a period after another.
        (0..20)
            .map(|index| index * period)
            .chain((0..6).map(|index| (21 + 2 * index) * period))
            .chain([31 * period + tenth])
            .chain(regular(32 * period, 68))
            .collect(),
        // One measurement too many, and then the cable is unplugged.
        regular(0, 50).chain([49 * period + tenth]).chain(regular(50 * period + late, 50)).collect(),
    ];
    for (index, stream) in streams.into_iter().enumerate() {
        let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
        let count = stream.len() as u64;
        for at_ns in stream {
            if index == 2 && at_ns == 50 * period + late {
                accountant.interrupt(GapCause::Unplugged, &mut out);
            }
            let mut next = sample(0, true, 0);
            (next.device_time_ns, next.host_mono_ns) = (Some(5_000_000_000 + at_ns), 1_000_000_000 + at_ns);
            accountant.observe(next, &mut out);
        }
        accountant.settle(&mut out);
        let rates = out.iter().filter(|record| matches!(record, Record::Segment(new) if new.rate_hz != 40.0)).count();
        assert_eq!((accountant.rate_hz(), rates), (40.0, 0), "stream {index}");
        assert_eq!((accountant.received(), accountant.take_refused().len()), (count - 1, 1), "stream {index}");
    }
}

#[test]
fn losses_that_are_not_regular_are_no_change_of_rate() {
    let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
    for tick in (0..100).chain((100..120).step_by(2)).chain(120..200) {
        accountant.observe(sample(tick, true, 0), &mut out);
    }
    assert_eq!((accountant.rate_hz(), accountant.missing()), (40.0, 10));
    assert!(gaps(&out).iter().all(|gap| gap.missing_exact && gap.cause == GapCause::Silent));
}

/// B10.
#[test]
fn a_counter_that_wraps_is_no_gap() {
    let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
    let start = u64::MAX - 50 * PERIOD_NS;
    for tick in 0..100 {
        let mut next = sample(tick, true, 0);
        next.device_time_ns = Some(start.wrapping_add(tick * PERIOD_NS));
        assert_eq!(accountant.observe(next, &mut out), Observation::Taken);
    }
    assert_eq!((accountant.received(), accountant.missing(), gaps(&out).len()), (100, 0, 0));
    let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::SyncCounter), Vec::new());
    for tick in (0..70).chain(73..100) {
        let mut next = sample(tick, false, 0);
        next.sync_count = Some((u32::MAX - 50).wrapping_add(tick as u32));
        accountant.observe(next, &mut out);
    }
    accountant.settle(&mut out);
    assert_eq!((accountant.received(), accountant.missing(), gaps(&out).len()), (97, 3, 1));
    assert!(gaps(&out)[0].missing_exact);
}

#[test]
fn a_clock_that_is_set_ahead_begins_a_new_epoch_and_nothing_is_missing() {
    let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
    for tick in 0..100 {
        let mut next = sample(tick, true, 0);
        next.device_time_ns = next.device_time_ns.map(|ns| if tick < 50 { ns } else { ns + 3_600_000_000_000 });
        accountant.observe(next, &mut out);
    }
    accountant.settle(&mut out);
    assert_eq!((accountant.received(), accountant.missing(), accountant.epoch()), (100, 0, 2));
}

#[test]
fn a_serial_count_that_stands_still_is_not_believed() {
    let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::SyncCounter), Vec::new());
    for tick in 0..100 {
        let mut next = sample(tick, false, 0);
        next.sync_count = Some(7);
        accountant.observe(next, &mut out);
    }
    accountant.settle(&mut out);
    assert!(accountant.received() >= 97, "{}", accountant.received());
    let Some(Record::Segment(last)) = out.iter().rev().find(|record| matches!(record, Record::Segment(_))) else {
        panic!("no segment")
    };
    assert_eq!(last.timebase, Timebase::Arrival);
}

/// D1, D5: the host's own trouble is a cause, and a change of civil time is not.
#[test]
fn a_host_that_slept_is_the_cause_and_a_stepped_clock_is_none() {
    let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
    for tick in 0..100 {
        accountant.observe(sample(tick, true, 0), &mut out);
    }
    let hour = 144_000;
    accountant.blame_host(GapCause::HostSuspend, 1_000_000_000 + (100 + hour + 80) * PERIOD_NS);
    for (index, tick) in (100..110).chain(100 + hour..300 + hour).enumerate() {
        // The first ones waited in the line's buffer.
        let mut next = sample(tick, true, 0);
        if index < 10 {
            next.host_mono_ns = sample(100 + hour, true, 0).host_mono_ns;
        }
        next.host_utc_ns -= 7_200_000_000_000;
        accountant.observe(next, &mut out);
    }
    let gaps = gaps(&out);
    assert_eq!(gaps.len(), 1);
    assert_eq!((gaps[0].cause, gaps[0].missing, gaps[0].missing_exact), (GapCause::HostSuspend, hour - 10, true));
    assert!(gaps[0].to_utc_ns >= gaps[0].from_utc_ns);
}

#[test]
fn an_interruption_names_the_cause_and_the_device_clock_counts() {
    let mut accountant = Accountant::new(40.0, Timebase::Device);
    let mut out = Vec::new();
    accountant.observe(sample(0, true, 0), &mut out);
    accountant.interrupt(GapCause::Unplugged, &mut out);
    accountant.observe(sample(400, true, 0), &mut out);
    // The next sample shows that the rate is the same.
    accountant.observe(sample(401, true, 0), &mut out);
    let [gap] = gaps(&out)[..] else { panic!("{out:?}") };
    assert_eq!((gap.missing, gap.missing_exact, gap.cause), (399, true, GapCause::Unplugged));
}

#[test]
fn a_sensor_that_lost_power_while_unplugged_is_measured_by_the_host() {
    let mut accountant = Accountant::new(40.0, Timebase::Device);
    let mut out = Vec::new();
    accountant.observe(sample(0, true, 0), &mut out);
    accountant.interrupt(GapCause::Unplugged, &mut out);
    // An hour later, the clock is only 10 s ahead of its earlier value: it restarted.
    let mut back = sample(144_000, true, 0);
    back.device_time_ns = Some(15_000_000_000);
    assert_eq!(accountant.observe(back, &mut out), Observation::Taken);
    let next = [1, 2, 3].map(|tick| {
        let mut next = sample(144_000 + tick, true, 0);
        next.device_time_ns = Some(15_000_000_000 + tick * 25_000_000);
        accountant.observe(next, &mut out)
    });
    assert!(next.contains(&Observation::AfterReset), "{next:?}");
    assert_eq!((gaps(&out)[0].missing, gaps(&out)[0].missing_exact), (143_999, false));
}

#[test]
fn a_burst_that_catches_up_has_lost_nothing() {
    let mut accountant = Accountant::new(40.0, Timebase::Arrival);
    let mut out = Vec::new();
    for tick in 0..200 {
        // The host hears nothing between tick 100 and 140, then everything at once.
        let delay = if (100..140).contains(&tick) { (140 - tick) * PERIOD_NS } else { 0 };
        accountant.observe(sample(tick, false, delay), &mut out);
    }
    accountant.settle(&mut out);
    assert_eq!((accountant.received(), accountant.missing()), (200, 0));
    assert_eq!(seqs(&out).len(), 200);
}

#[test]
fn without_device_time_a_lasting_delay_is_a_gap() {
    let mut accountant = Accountant::new(40.0, Timebase::Arrival);
    let mut out = Vec::new();
    for tick in (0..100).chain(152..200) {
        accountant.observe(sample(tick, false, tick % 3 * 2_000_000), &mut out);
    }
    accountant.settle(&mut out);
    assert_eq!(accountant.missing(), 52);
    assert_eq!((gaps(&out)[0].before_seq, gaps(&out)[0].missing_exact), (100, false));
    assert_eq!(seqs(&out)[100], (100, 2));
}

#[test]
fn where_time_runs_faster_the_hosts_own_lateness_is_no_gap() {
    let mut accountant = Accountant::new(40.0, Timebase::Arrival).with_host_jitter(5e9);
    let mut out = Vec::new();
    for tick in 0..1000 {
        // For a while everything is read 2 s late, steadily.
        let delay = if (300..600).contains(&tick) { 2_000_000_000 } else { 0 };
        accountant.observe(sample(tick, false, delay), &mut out);
    }
    accountant.settle(&mut out);
    assert_eq!((accountant.received(), accountant.missing()), (1000, 0));
}

#[test]
fn clocks_that_drift_apart_lose_nothing() {
    let mut accountant = Accountant::new(40.0, Timebase::Arrival);
    let mut out = Vec::new();
    for tick in 0..720_000_u64 {
        // 200 ppm: 3.6 s in five hours.
        accountant.observe(sample(tick, false, tick * PERIOD_NS / 5000), &mut out);
        out.clear();
    }
    assert_eq!(accountant.missing(), 0);
}

#[test]
fn a_resumed_capture_goes_on_in_a_new_segment_with_the_gap_counted() {
    let mut out = Vec::new();
    let last = Position {
        device_time_ns: Some(5_000_000_000),
        sync_count: None,
        host_mono_ns: 0,
        host_utc_ns: 1_700_000_000_000_000_000,
    };
    let mut accountant =
        Accountant::resume(40.0, Timebase::Device, (3, 1, 1000, 7, 2), Some(last), GapCause::DaemonStopped);
    let mut next = sample(400, true, 0);
    next.host_utc_ns = last.host_utc_ns + 10_000_000_000;
    accountant.observe(next, &mut out);
    accountant.settle(&mut out);
    assert_eq!((accountant.received(), accountant.missing(), accountant.gaps()), (1001, 7 + 399, 3));
    assert_eq!(gaps(&out)[0].cause, GapCause::DaemonStopped);
    assert_eq!(seqs(&out), [(1000, 4)]);
}

proptest! {
    #[test]
    fn received_and_missing_add_up_for_any_losses(lost in proptest::collection::vec(any::<bool>(), 1..400), jitter in 0_u64..10_000_000) {
        let mut accountant = Accountant::new(40.0, Timebase::Device);
        let mut out = Vec::new();
        let kept: Vec<u64> = (0..lost.len() as u64).filter(|tick| !lost[*tick as usize]).collect();
        // A loss that leaves a dozen even steps is another rate.
        let steps: Vec<u64> = kept.windows(2).map(|pair| pair[1] - pair[0]).collect();
        prop_assume!(!steps.windows(10).any(|steps| steps[0] > 1 && steps.iter().all(|step| *step == steps[0])));
        for tick in &kept {
            let mut sample = sample(*tick, true, 0);
            sample.device_time_ns = sample.device_time_ns.map(|time| time + tick * 7919 % (jitter + 1));
            accountant.observe(sample, &mut out);
        }
        accountant.settle(&mut out);
        if let (Some(first), Some(last)) = (kept.first(), kept.last()) {
            prop_assert_eq!(accountant.received(), kept.len() as u64);
            prop_assert_eq!(accountant.received() + accountant.missing(), last - first + 1);
            prop_assert_eq!(gaps(&out).iter().map(|gap| gap.missing).sum::<u64>(), accountant.missing());
            let numbers: Vec<u64> = seqs(&out).iter().map(|(seq, _)| *seq).collect();
            prop_assert_eq!(numbers, (0..kept.len() as u64).collect::<Vec<_>>());
        }
    }

    #[test]
    fn arrival_times_with_latency_below_a_period_find_every_longer_silence(silences in proptest::collection::vec((20_u64..60, 3_u64..200), 1..8), latency in 0_u64..12_000_000) {
        let mut accountant = Accountant::new(40.0, Timebase::Arrival);
        let mut out = Vec::new();
        let (mut tick, mut sent) = (0, 0_u64);
        for (run, silence) in &silences {
            for _ in 0..*run {
                accountant.observe(sample(tick, false, tick * 7919 % (latency + 1)), &mut out);
                tick += 1;
                sent += 1;
            }
            tick += silence;
        }
        for _ in 0..20 {
            accountant.observe(sample(tick, false, 0), &mut out);
            tick += 1;
            sent += 1;
        }
        accountant.settle(&mut out);
        prop_assert_eq!(accountant.received(), sent);
        prop_assert_eq!(accountant.missing(), tick - sent);
    }
}
