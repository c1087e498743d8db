//! Streams whose host or line stands still while their sensor is reset, unplugged or changes its rate, and random streams of whatever
//! may happen to a line.

use super::rate_tests::{START_NS, gaps, rates};
use super::*;
use proptest::prelude::*;

/// A rate that changes after 20 s, around a stall of the line or of the host (`blamed`); the sensor answers. Nothing is lost.
fn changed_around_a_stall(
    timebase: Timebase,
    (from_hz, to_hz): (f64, f64),
    stall_s: std::ops::Range<f64>,
    blamed: bool,
) {
    const CHANGE_S: f64 = 20.0;
    let (mut accountant, mut out) = (Accountant::new(from_hz, timebase), Vec::new());
    let (before, after) = ((CHANGE_S * from_hz) as u64, (30.0 * to_hz) as u64);
    let mut told = !blamed;
    for tick in 0..before + after {
        let at_s = match tick.checked_sub(before) {
            Some(tick) => CHANGE_S + tick as f64 / to_hz,
            None => tick as f64 / from_hz,
        };
        let arrived = START_NS + (1e9 * if stall_s.contains(&at_s) { stall_s.end } else { at_s }) as u64;
        if at_s > stall_s.start && !std::mem::replace(&mut told, true) {
            accountant.blame_host(GapCause::HostStall, START_NS + (1e9 * stall_s.end) as u64 + 3_000_000_000);
        }
        let mut sample = Sample::at(arrived, 1_800_000_000_000_000_000 + arrived as i64);
        sample.device_time_ns = (timebase == Timebase::Device).then_some(7_000_000_000 + (1e9 * at_s) as u64);
        // The sensor counts the messages of the first rate, as a clock.
        sample.sync_count = Some((at_s * from_hz + 1e-6) as u32);
        accountant.observe(sample, &mut out);
        if matches!(accountant.take_doubt(), Some(RateDoubt::Open(_))) {
            accountant.rate_known(if at_s < CHANGE_S { from_hz } else { to_hz }, &mut out);
        }
    }
    accountant.settle(&mut out);
    let refused = accountant.take_refused().len();
    let taken = out.iter().filter(|record| matches!(record, Record::Sample { .. })).count() as u64;
    let case = format!("{timebase:?}: {from_hz} to {to_hz} Hz, {stall_s:?} s; {refused} refused, {:?}", rates(&out));
    assert_eq!((taken + refused as u64, accountant.missing()), (before + after, 0), "{case}");
    // A count that repeats within a burst may be one of a message that came twice.
    assert!(refused == 0 || (timebase == Timebase::SyncCounter && to_hz > from_hz && refused <= 10), "{case}");
    assert_eq!(accountant.rate_hz(), to_hz, "{case}");
}

/// The rate changes while the host stands still, or soon after.
#[test]
fn a_rate_that_changes_around_a_stall_of_the_host_loses_nothing() {
    for rates_hz in [(50.0, 100.0), (50.0, 25.0), (40.0, 50.0), (200.0, 4.0), (5.0, 20.0), (2.0, 10.0), (1.0, 4.0)] {
        for timebase in [Timebase::Device, Timebase::SyncCounter] {
            for stall_s in [19.0..21.0, 19.0..19.8] {
                changed_around_a_stall(timebase, rates_hz, stall_s, true);
            }
        }
    }
}

proptest! {
    #[test]
    fn a_rate_that_changes_around_any_stall_loses_nothing(
        pair in proptest::sample::select(vec![(0, 1), (1, 3), (2, 8), (4, 5), (5, 2), (7, 8), (8, 7), (8, 9), (9, 6), (10, 2), (10, 9), (3, 10), (7, 4)]),
        begin in -3.0..3.0_f64,
        length in 0.0..4.0_f64,
        blamed in any::<bool>(),
    ) {
        const RATES_HZ: [f64; 11] = [1.0, 2.0, 4.0, 5.0, 10.0, 20.0, 25.0, 40.0, 50.0, 100.0, 200.0];
        let stall_s = 20.0 + begin..20.0 + begin + length;
        changed_around_a_stall(Timebase::Device, (RATES_HZ[pair.0], RATES_HZ[pair.1]), stall_s.clone(), blamed);
        // Just after the change, a burst of counted messages may look like the old rate (docs/reliability/time.md).
        if !(0.0..0.5).contains(&begin) {
            changed_around_a_stall(Timebase::SyncCounter, (RATES_HZ[pair.0], RATES_HZ[pair.1]), stall_s, blamed);
        }
    }
}

/// What happens after the first sample of a reset is not the reset's cause.
#[test]
fn trouble_after_a_reset_is_the_cause_of_what_follows() {
    let (mut accountant, mut out) = (Accountant::new(50.0, Timebase::Device), Vec::new());
    let mut send = |accountant: &mut Accountant, at_ms: u64, device_ms: u64| {
        let at_ns = START_NS + at_ms * 1_000_000;
        let mut sample = Sample::at(at_ns, 1_800_000_000_000_000_000 + at_ns as i64);
        sample.device_time_ns = Some(device_ms * 1_000_000);
        accountant.observe(sample, &mut out);
    };
    (0..100).for_each(|tick| send(&mut accountant, 20 * tick, 5000 + 20 * tick));
    send(&mut accountant, 3240, 20);
    accountant.suspect(GapCause::Checksum);
    send(&mut accountant, 3280, 60);
    (1..50).for_each(|tick| send(&mut accountant, 3280 + 20 * tick, 60 + 20 * tick));
    accountant.settle(&mut out);
    let actual: Vec<_> = gaps(&out).iter().map(|gap| (gap.missing, gap.cause)).collect();
    assert_eq!(actual, [(62, GapCause::SensorReset), (1, GapCause::Checksum)]);
}

/// What may happen to a line, one after the other.
#[derive(Debug, Clone, Copy)]
enum Happens {
    Lost(u8),
    Twice,
    Swapped,
    Late(u16),
    Reset(u16),
    Rate(u8),
    Count(u8),
    Interrupted,
    Blamed,
    Suspected,
    Known,
}

fn happens() -> impl Strategy<Value = (u16, Happens)> {
    let kind = prop_oneof![
        (1..40_u8).prop_map(Happens::Lost),
        Just(Happens::Twice),
        Just(Happens::Swapped),
        (1..4000_u16).prop_map(Happens::Late),
        (0..3000_u16).prop_map(Happens::Reset),
        (0..11_u8).prop_map(Happens::Rate),
        (0..4_u8).prop_map(Happens::Count),
        Just(Happens::Interrupted),
        Just(Happens::Blamed),
        Just(Happens::Suspected),
        Just(Happens::Known),
    ];
    (0..200_u16, kind)
}

proptest! {
    /// Whatever happens: each sample is taken once, in its order, or refused; none stays.
    #[test]
    fn each_sample_is_taken_or_refused(
        timebase in proptest::sample::select(vec![Timebase::Device, Timebase::SyncCounter, Timebase::Arrival]),
        rate in 0..11_usize,
        events in proptest::collection::vec(happens(), 0..12),
    ) {
        const RATES_HZ: [f64; 11] = [1.0, 2.0, 4.0, 5.0, 10.0, 20.0, 25.0, 40.0, 50.0, 100.0, 200.0];
        let (mut accountant, mut out) = (Accountant::new(RATES_HZ[rate], timebase), Vec::new());
        let (mut rate_hz, mut at_ns, mut device_ns, mut count, mut per_message) = (RATES_HZ[rate], START_NS, 7_000_000_000_u64, 9_u32, 1_u8);
        let (mut late_until, mut arrived, mut frame, mut refused) = (0, 0_u64, 0_u64, 0);
        let mut taken_from = |accountant: &mut Accountant, at_ns: u64, late_until: u64, device_ns: u64, count: u32, out: &mut Vec<Record>| {
            arrived = arrived.max(at_ns).max(late_until);
            frame += 1;
            let mut sample = Sample { frame, ..Sample::at(arrived, 1_800_000_000_000_000_000 + arrived as i64) };
            sample.device_time_ns = (timebase == Timebase::Device).then_some(device_ns);
            sample.sync_count = (timebase == Timebase::SyncCounter).then_some(count);
            refused += u64::from(matches!(accountant.observe(sample, out), Observation::Duplicate | Observation::OutOfOrder));
        };
        for (messages, event) in events.iter().copied().chain([(200, Happens::Known)]) {
            for _ in 0..messages {
                let period = period_ns(rate_hz) as u64;
                (at_ns, device_ns, count) = (at_ns + period, device_ns + period, count.wrapping_add(per_message.into()));
                taken_from(&mut accountant, at_ns, late_until, device_ns, count, &mut out);
            }
            let period = period_ns(rate_hz) as u64;
            match event {
                Happens::Lost(lost) => {
                    (at_ns, device_ns) = (at_ns + u64::from(lost) * period, device_ns + u64::from(lost) * period);
                    count = count.wrapping_add(u32::from(lost) * u32::from(per_message));
                }
                Happens::Twice => taken_from(&mut accountant, at_ns, late_until, device_ns, count, &mut out),
                Happens::Swapped => {
                    taken_from(&mut accountant, at_ns, late_until, device_ns + 2 * period, count + 2, &mut out);
                    taken_from(&mut accountant, at_ns, late_until, device_ns + period, count + 1, &mut out);
                    (device_ns, count) = (device_ns + 2 * period, count + 2);
                }
                Happens::Late(ms) => late_until = at_ns + u64::from(ms) * 1_000_000,
                Happens::Reset(ms) => (at_ns, device_ns, count) = (at_ns + u64::from(ms) * 1_000_000, 10_000_000, 0),
                Happens::Rate(rate) => rate_hz = RATES_HZ[usize::from(rate)],
                Happens::Count(per) => per_message = per,
                Happens::Interrupted => accountant.interrupt(GapCause::Unplugged, &mut out),
                Happens::Blamed => accountant.blame_host(GapCause::HostStall, at_ns + 3_000_000_000),
                Happens::Suspected => accountant.suspect(GapCause::Checksum),
                Happens::Known => accountant.rate_known(rate_hz, &mut out),
            }
        }
        accountant.settle(&mut out);
        let refused = refused + accountant.take_refused().iter().map(|(_, _)| 1).sum::<u64>();
        let taken: Vec<(u64, u64)> =
            out.iter().filter_map(|record| if let Record::Sample { seq, sample, .. } = record { Some((*seq, sample.frame)) } else { None }).collect();
        prop_assert_eq!((taken.len() as u64 + refused, accountant.received(), accountant.held()), (frame, taken.len() as u64, 0));
        prop_assert!(taken.iter().enumerate().all(|(index, (seq, _))| *seq == index as u64));
        prop_assert!(taken.windows(2).all(|pair| pair[0].1 < pair[1].1), "in the order of their arrival: {:?}", taken.windows(2).find(|pair| pair[0].1 >= pair[1].1));
        prop_assert_eq!(accountant.missing(), gaps(&out).iter().map(|gap| gap.missing).sum::<u64>());
    }
}

/// A sensor that is configured again sends its next message up to one period of its slower rate later.
#[test]
fn a_lower_rate_after_an_interruption_is_no_gap() {
    for (from_hz, to_hz, away_s, missing) in
        [(200.0, 2.0, 0.45, 0), (50.0, 4.0, 0.25, 0), (50.0, 4.0, 0.45, 10), (2.0, 200.0, 0.3, 0), (50.0, 50.0, 0.1, 4)]
    {
        let (mut accountant, mut out) = (Accountant::new(from_hz, Timebase::Arrival), Vec::new());
        let mut at_ns = START_NS;
        for _ in 0..100 {
            at_ns += period_ns(from_hz) as u64;
            accountant.observe(Sample::at(at_ns, 1_800_000_000_000_000_000 + at_ns as i64), &mut out);
        }
        accountant.interrupt(GapCause::RateChange, &mut out);
        accountant.change(to_hz, Timebase::Arrival, &mut out);
        at_ns += (away_s * 1e9) as u64;
        for _ in 0..100 {
            accountant.observe(Sample::at(at_ns, 1_800_000_000_000_000_000 + at_ns as i64), &mut out);
            at_ns += period_ns(to_hz) as u64;
        }
        accountant.settle(&mut out);
        assert_eq!(
            (accountant.received(), accountant.missing()),
            (200, missing),
            "{from_hz} to {to_hz} Hz, {away_s} s"
        );
    }
}

/// A clock that was set ahead was not reset: samples that are missing before it have their own cause.
#[test]
fn samples_lost_before_a_clock_that_was_set_ahead_were_not_lost_by_a_reset() {
    let (mut accountant, mut out) = (Accountant::new(50.0, Timebase::Device), Vec::new());
    for tick in (0..200).chain(220..400) {
        let at_ns = START_NS + tick * 20_000_000;
        let mut sample = Sample::at(at_ns, 1_800_000_000_000_000_000 + at_ns as i64);
        sample.device_time_ns = Some(at_ns + if tick < 200 { 0 } else { 60_000_000_000 });
        accountant.observe(sample, &mut out);
    }
    accountant.settle(&mut out);
    let actual: Vec<_> = gaps(&out).iter().map(|gap| (gap.before_seq, gap.missing, gap.cause)).collect();
    assert_eq!((actual, accountant.epoch()), (vec![(200, 20, GapCause::Silent)], 2));
}

/// Once samples come on time again, the host is no longer the cause of what happens to the sensor.
#[test]
fn an_unplugging_after_a_stall_is_no_stall() {
    for timebase in [Timebase::Device, Timebase::SyncCounter, Timebase::Arrival] {
        for (after_ms, cause) in [(100, GapCause::HostStall), (2000, GapCause::Unplugged)] {
            let (mut accountant, mut out) = (Accountant::new(50.0, timebase), Vec::new());
            let stall = START_NS + 10_000_000_000..START_NS + 11_500_000_000;
            let unplugged = stall.end + after_ms * 1_000_000;
            for tick in 0..1000 {
                let sent = START_NS + tick * 20_000_000;
                let arrived = if stall.contains(&sent) { stall.end } else { sent };
                if sent == stall.start {
                    accountant.blame_host(GapCause::HostStall, stall.end + 3_000_000_000);
                }
                if (unplugged..unplugged + 500_000_000).contains(&sent) {
                    accountant.interrupt(GapCause::Unplugged, &mut out);
                    continue;
                }
                let mut sample = Sample::at(arrived, 1_800_000_000_000_000_000 + arrived as i64);
                sample.device_time_ns = (timebase == Timebase::Device).then_some(sent);
                sample.sync_count = (timebase == Timebase::SyncCounter).then_some(tick as u32);
                accountant.observe(sample, &mut out);
            }
            accountant.settle(&mut out);
            let actual: Vec<_> = gaps(&out).iter().map(|gap| (gap.missing, gap.cause)).collect();
            assert_eq!(actual, [(25, cause)], "{timebase:?}, {after_ms} ms");
        }
    }
}

/// Messages before and after a reset that are read late show how late they were, once those after it come on time.
#[test]
fn a_reset_within_a_stall_is_measured_by_the_messages_that_came_late() {
    for timebase in [Timebase::Device, Timebase::SyncCounter] {
        for (before_s, silent_s, after_s) in [
            (0.5, 1.25, 1.25),
            (1.5, 1.25, 0.1),
            (0.02, 1.25, 0.5),
            (1.0, 0.3, 1.0),
            (0.5, 2.5, 0.0),
            (2.0, 1.25, -0.6),
        ] {
            let (mut accountant, mut out) = (Accountant::new(50.0, timebase), Vec::new());
            let period = 20_000_000;
            let reset_ns = START_NS + 20_000_000_000;
            let again_ns = reset_ns + (silent_s * 1e9) as u64;
            let stall = reset_ns - (before_s * 1e9) as u64..(again_ns as f64 + after_s * 1e9) as u64;
            let mut sent: Vec<(u64, u64)> = (0..1000).map(|tick| (START_NS + tick * period, 100 + tick)).collect();
            sent.extend((0..1000).map(|tick| (again_ns + tick * period, tick)));
            for (at_ns, tick) in sent {
                let arrived = if stall.contains(&at_ns) { stall.end } else { at_ns };
                if at_ns == stall.start {
                    accountant.blame_host(GapCause::HostStall, stall.end + 3_000_000_000);
                }
                let mut sample = Sample::at(arrived, 1_800_000_000_000_000_000 + arrived as i64);
                sample.device_time_ns = (timebase == Timebase::Device).then_some(1_000_000_000 + tick * period);
                sample.sync_count = (timebase == Timebase::SyncCounter).then_some(tick as u32);
                accountant.observe(sample, &mut out);
            }
            accountant.settle(&mut out);
            let missing = (silent_s * 50.0) as i64 - 1;
            let case =
                format!("{timebase:?}: {before_s} s, {silent_s} s, {after_s} s: {} missing", accountant.missing());
            assert_eq!((accountant.received(), accountant.epoch(), accountant.gaps()), (2000, 2, 1), "{case}");
            assert!((accountant.missing() as i64 - missing).abs() <= 3, "{case} instead of {missing}");
        }
    }
}
