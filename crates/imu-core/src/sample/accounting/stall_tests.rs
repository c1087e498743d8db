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
    // Without blame there is nothing to report.
    let mut is_reported = !blamed;
    for tick in 0..before + after {
        let at_s = match tick.checked_sub(before) {
            Some(tick) => CHANGE_S + tick as f64 / to_hz,
            None => tick as f64 / from_hz,
        };
        let arrived = START_NS + (1e9 * if stall_s.contains(&at_s) { stall_s.end } else { at_s }) as u64;
        if at_s > stall_s.start && !std::mem::replace(&mut is_reported, true) {
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

/// Sends messages of a sensor with a clock: when they were sent, s, and what the clock shows, s. The host is stopped during the
/// stalls, and then reads what waits in chunks of 50 messages, with 20 ms in between.
fn read_late(
    rate_hz: f64,
    sent: impl IntoIterator<Item = (f64, f64)>,
    stalls_s: &[std::ops::Range<f64>],
    blamed: bool,
) -> (Accountant, Vec<Record>) {
    let (mut accountant, mut out) = (Accountant::new(rate_hz, Timebase::Device), Vec::new());
    let (mut reads_from_s, mut chunk) = (0.0_f64, 0);
    for (sent_s, clock_s) in sent {
        let stall = stalls_s.iter().find(|stall| stall.contains(&sent_s));
        reads_from_s = reads_from_s.max(stall.map_or(0.0, |stall| stall.end));
        chunk = if sent_s < reads_from_s { chunk + 1 } else { 0 };
        if chunk == 50 {
            (reads_from_s, chunk) = (reads_from_s + 0.02, 0);
        }
        let arrived = START_NS + (1e9 * sent_s.max(reads_from_s)) as u64;
        if let (Some(stall), true) = (stall, blamed) {
            accountant.blame_host(GapCause::HostStall, START_NS + (1e9 * stall.end) as u64 + 3_000_000_000);
        }
        let mut sample = Sample::at(arrived, 1_800_000_000_000_000_000 + arrived as i64);
        sample.device_time_ns = Some((1e9 * clock_s).round() as u64);
        accountant.observe(sample, &mut out);
    }
    accountant.settle(&mut out);
    (accountant, out)
}

/// A sample that is read at this time, s, and whose clock shows this, s.
fn timed(read_s: f64, clock_s: f64) -> Sample {
    let device_time_ns = Some((1e9 * clock_s).round() as u64);
    Sample { device_time_ns, ..counted(read_s, None) }
}

/// A sample that is read at this time, s, with this count.
fn counted(read_s: f64, sync_count: impl Into<Option<u32>>) -> Sample {
    let read_ns = START_NS + (1e9 * read_s) as u64;
    Sample { sync_count: sync_count.into(), ..Sample::at(read_ns, 1_800_000_000_000_000_000 + read_ns as i64) }
}

/// Messages of one run of the sensor's clock: sent at the rate from a time on, for a duration, s; the clock shows `clock_s` first.
fn run(rate_hz: f64, from_s: f64, length_s: f64, clock_s: f64) -> impl Iterator<Item = (f64, f64)> + Clone {
    (0..(length_s * rate_hz).round() as u64).map(move |tick| {
        let after_s = tick as f64 / rate_hz;
        (from_s + after_s, clock_s + after_s)
    })
}

/// A sensor that sends binary output after a boot is reset once or twice within a stall; the reader catches up in chunks.
#[test]
fn resets_within_a_stall_miss_what_the_sensor_did_not_send() {
    for rate_hz in [10.0, 50.0, 100.0, 400.0] {
        for second_s in [None, Some(0.6), Some(0.8), Some(1.6), Some(2.2)] {
            let mut sent: Vec<_> = run(rate_hz, 0.0, 10.0, 1000.0).collect();
            let boot_s = 1.25;
            let mut missing = boot_s * rate_hz;
            let end = second_s.map_or(10.0 + boot_s, |second_s: f64| {
                sent.extend(run(rate_hz, 10.0 + boot_s, second_s, 1.0));
                missing += boot_s * rate_hz;
                10.0 + boot_s + second_s + boot_s
            });
            sent.extend(run(rate_hz, end, 20.0, 1.0));
            let stall = 9.6..10.0 + boot_s + 3.4;
            let (accountant, _) = read_late(rate_hz, sent.iter().copied(), &[stall], true);
            let epochs = if second_s.is_some() { 3 } else { 2 };
            let case = format!("{rate_hz} Hz, {second_s:?}: {} missing of {missing}", accountant.missing());
            assert_eq!((accountant.received(), accountant.epoch()), (sent.len() as u64, epochs), "{case}");
            assert!((accountant.missing() as f64 - missing).abs() <= 3.0 + 0.03 * rate_hz, "{case}");
        }
    }
}

/// A slow host reads each 0.4 s; the sensor's clock is set ahead meanwhile. Nothing is missing.
#[test]
fn a_clock_that_is_set_ahead_while_the_host_is_slow_is_no_loss() {
    for rate_hz in [50.0, 100.0, 400.0] {
        for set_s in [8.05, 8.2, 8.35] {
            let sent = run(rate_hz, 0.0, set_s, 1000.0).chain(run(rate_hz, set_s, 10.0, 1000.9 + set_s));
            let stalls: Vec<_> =
                (0..20).map(|stall| 4.0 + 0.4 * f64::from(stall)..4.3 + 0.4 * f64::from(stall)).collect();
            for blamed in [false, true] {
                let (accountant, out) = read_late(rate_hz, sent.clone(), &stalls, blamed);
                let case = format!("{rate_hz} Hz, {set_s} s, {blamed}: {:?}", gaps(&out));
                assert_eq!(accountant.epoch(), 2, "{case}");
                assert!(accountant.missing() as f64 <= 1.0 + 0.02 * rate_hz, "{case}");
            }
        }
    }
}

/// The line lost samples while the rate changed: how many is not known exactly.
#[test]
fn a_gap_across_which_the_rate_changed_is_not_exact() {
    for (from_hz, to_hz) in [(200.0, 400.0), (400.0, 200.0), (800.0, 100.0), (50.0, 40.0)] {
        for cause in [None, Some(GapCause::HostStall)] {
            for away_s in [0.5, 2.0] {
                let (mut accountant, mut out) = (Accountant::new(from_hz, Timebase::Device), Vec::new());
                let mut send = |accountant: &mut Accountant, (sent_s, clock_s): (f64, f64)| {
                    accountant.observe(timed(sent_s, clock_s), &mut out);
                };
                run(from_hz, 0.0, 5.0, 1000.0).for_each(|sent| send(&mut accountant, sent));
                if let Some(cause) = cause {
                    accountant.interrupt(cause, &mut Vec::new());
                }
                let later = run(to_hz, 5.0 + away_s, 5.0, 1005.0 + away_s);
                later.for_each(|sent| send(&mut accountant, sent));
                accountant.settle(&mut out);
                let case = format!("{from_hz} to {to_hz} Hz, {cause:?}, {away_s} s: {:?}", gaps(&out));
                let [gap] = gaps(&out)[..] else { panic!("{case}") };
                assert_eq!((gap.missing_exact, accountant.rate_hz()), (false, to_hz), "{case}");
                assert!((gap.missing as f64 - away_s * from_hz).abs() <= from_hz / to_hz + 1.0, "{case}");
                assert_eq!(gap.cause, cause.unwrap_or(GapCause::RateChange), "{case}");
            }
        }
    }
}

/// Messages whose count was taken for theirs: the capture ends before their rate is decided.
#[test]
fn a_counted_rate_that_is_undecided_at_the_end_makes_no_exact_loss() {
    for end_s in [0.1, 0.3, 0.5, 0.8] {
        for to_hz in [25.0, 20.0, 40.0] {
            let (mut accountant, mut out) = (Accountant::new(50.0, Timebase::SyncCounter), Vec::new());
            let sent = run(50.0, 0.0, 10.0, 0.0).chain(run(to_hz, 10.0, 1.0 + end_s, 10.0));
            for (sent_s, clock_s) in sent {
                let arrived_s = if (9.4..11.0).contains(&sent_s) { 11.0 } else { sent_s };
                accountant.observe(counted(arrived_s, (clock_s * 50.0 + 1e-6) as u32), &mut out);
            }
            accountant.settle(&mut out);
            let exact: u64 = gaps(&out).iter().filter(|gap| gap.missing_exact).map(|gap| gap.missing).sum();
            assert_eq!(exact, 0, "{to_hz} Hz, {end_s} s: {:?}", gaps(&out));
            assert!(to_hz != 25.0 || accountant.missing() == 0, "{end_s} s: {:?}", gaps(&out));
        }
    }
}

/// The rate of counted messages changes while the host reads each 0.4 s; the sensor answers.
#[test]
fn a_counted_rate_that_changes_while_the_host_is_slow_loses_nothing() {
    for (from_hz, to_hz) in [
        (50.0, 200.0),
        (10.0, 100.0),
        (25.0, 100.0),
        (200.0, 50.0),
        (100.0, 25.0),
        (10.0, 4.0),
        (40.0, 50.0),
        (50.0, 40.0),
        (1.0, 5.0),
    ] {
        for answers in [true, false] {
            let (mut accountant, mut out) = (Accountant::new(from_hz, Timebase::SyncCounter), Vec::new());
            let sent = run(from_hz, 0.0, 10.0, 0.0).chain(run(to_hz, 10.0, 10.0, 10.0));
            let (mut changed, mut wrong) = (0, 0);
            for (sent_s, clock_s) in sent {
                let into_s = (sent_s - 8.0).rem_euclid(0.4);
                let slow = (8.0..16.0).contains(&sent_s) && into_s < 0.3;
                let arrived = START_NS + (1e9 * if slow { sent_s + 0.3 - into_s } else { sent_s }) as u64;
                let mut sample = Sample::at(arrived, 1_800_000_000_000_000_000 + arrived as i64);
                sample.sync_count = Some((clock_s * from_hz + 1e-6) as u32);
                sample.frame = u64::from(sent_s >= 10.0);
                changed += sample.frame;
                accountant.observe(sample, &mut out);
                if matches!(accountant.take_doubt(), Some(RateDoubt::Open(_))) && answers {
                    accountant.rate_known(if sent_s < 10.0 { from_hz } else { to_hz }, &mut out);
                }
            }
            accountant.settle(&mut out);
            let mut rate = from_hz;
            for record in &out {
                match record {
                    Record::Segment(segment) => rate = segment.rate_hz,
                    Record::Sample { sample, .. } => {
                        wrong += u64::from(rate != if sample.frame == 1 { to_hz } else { from_hz })
                    }
                    _ => {}
                }
            }
            let refused = accountant.take_refused().len();
            let case = format!(
                "{from_hz} to {to_hz} Hz, {answers}: {wrong} of {changed} with the wrong rate, {refused} refused, {:?}",
                rates(&out)
            );
            assert_eq!((accountant.missing(), refused, accountant.rate_hz()), (0, 0, to_hz), "{case}");
            // A count shows another rate at its first step that is not one, unless it takes longer than samples are held.
            assert!(from_hz == 1.0 || wrong as f64 <= 1.0 + 1.0 / (from_hz / to_hz - 1.0).abs(), "{case}");
        }
    }
}

/// A young sensor is reset again: its clock is ahead of the last sample's, and the line was interrupted.
#[test]
fn a_young_sensor_that_is_reset_again_is_measured_by_the_hosts_clock() {
    // How long it ran, how long it was away, how old it is when its first sample comes, s; whether the host stands still from
    // 0.3 s before the reset until 0.5 s before that sample.
    for (ran_s, away_s, age_s, stalled) in
        [(0.6, 2.3, 1.0, false), (0.3, 2.5, 0.5, false), (2.2, 4.0, 2.5, true), (1.0, 3.0, 1.5, true)]
    {
        for rate_hz in [20.0, 50.0, 200.0] {
            let mut sent: Vec<_> = run(rate_hz, 0.0, 10.0, 1000.0).collect();
            sent.extend(run(rate_hz, 11.25, ran_s, 0.1));
            let end_s = 11.25 + ran_s;
            let later: Vec<_> = run(rate_hz, end_s + away_s, 10.0, 0.1 + age_s).collect();
            let (mut accountant, mut out) = (Accountant::new(rate_hz, Timebase::Device), Vec::new());
            for (index, (sent_s, clock_s)) in sent.iter().chain(&later).copied().enumerate() {
                // A sensor that sends again by itself interrupts nothing.
                if index == sent.len() && age_s != 0.9 {
                    accountant.interrupt(GapCause::Unplugged, &mut out);
                }
                let stall = end_s - 0.3..end_s + away_s - 0.5;
                let arrived_s = if stalled && stall.contains(&sent_s) { stall.end } else { sent_s };
                accountant.observe(timed(arrived_s, clock_s), &mut out);
            }
            accountant.settle(&mut out);
            let missing = (1.25 + away_s) * rate_hz;
            let case = format!(
                "{rate_hz} Hz, {ran_s} s, {away_s} s: {} of {missing} missing, {:?}",
                accountant.missing(),
                gaps(&out)
            );
            assert_eq!((accountant.epoch(), accountant.received()), (3, (sent.len() + later.len()) as u64), "{case}");
            assert!((accountant.missing() as f64 - missing).abs() <= 3.0 + 0.02 * rate_hz, "{case}");
            assert!(gaps(&out).iter().all(|gap| !gap.missing_exact), "{case}");
        }
    }
}

/// A clock that is set ahead by a second during an interruption or just after a stall: what is missing is not known exactly.
#[test]
fn a_clock_that_is_set_ahead_in_trouble_makes_no_exact_loss() {
    let (mut accountant, mut out) = (Accountant::new(50.0, Timebase::Device), Vec::new());
    for (sent_s, clock_s) in run(50.0, 0.0, 10.0, 1000.0).chain(run(50.0, 10.64, 10.0, 1011.64)) {
        if sent_s == 10.64 {
            accountant.interrupt(GapCause::Unplugged, &mut out);
        }
        accountant.observe(timed(sent_s, clock_s), &mut out);
    }
    accountant.settle(&mut out);
    assert!(gaps(&out).iter().all(|gap| !gap.missing_exact), "{:?}", gaps(&out));
    // Just after a stall.
    let sent = run(50.0, 0.0, 10.0, 1000.0).chain(run(50.0, 10.0, 10.0, 1011.0));
    let (accountant, out) = read_late(50.0, sent, &[8.2..9.8], true);
    assert_eq!((accountant.epoch(), accountant.missing()), (2, 0), "{:?}", gaps(&out));
}

/// A sensor that was silent before it sends at another rate, and counted on meanwhile, was not reset.
#[test]
fn a_silence_before_another_rate_is_no_reset_if_the_count_goes_on() {
    for (to_hz, answers) in [(100.0, true), (25.0, true), (100.0, false), (25.0, false)] {
        let (mut accountant, mut out) = (Accountant::new(50.0, Timebase::SyncCounter), Vec::new());
        for (sent_s, clock_s) in run(50.0, 0.0, 10.0, 0.0).chain(run(to_hz, 11.5, 10.0, 11.5)) {
            accountant.observe(counted(sent_s, (clock_s * 50.0 + 1e-6) as u32), &mut out);
            if let Some(doubt) = accountant.take_doubt() {
                assert!(!doubt.is_reset(50.0, to_hz), "{to_hz} Hz: {doubt:?}");
                if answers && sent_s > 11.0 {
                    accountant.rate_known(to_hz, &mut out);
                }
            }
        }
        accountant.settle(&mut out);
        let [gap] = gaps(&out)[..] else { panic!("{to_hz} Hz: {:?}", gaps(&out)) };
        assert!(gap.missing.abs_diff(74) <= 2, "{to_hz} Hz, {answers}: {gap:?}");
        assert_ne!(gap.cause, GapCause::SensorReset, "{to_hz} Hz, {answers}");
    }
}

/// A line whose latency has grown for good: a loss after that is no reset, and a reset is as long as the sensor was away.
#[test]
fn a_latency_that_has_grown_for_good_makes_no_reset_and_lengthens_none() {
    for lag_s in [0.3, 1.5, 5.0] {
        for rate_hz in [10.0, 50.0, 400.0] {
            for reset in [false, true] {
                let away_s = if reset { 1.25 } else { 2.0 / rate_hz };
                let clock_s = if reset { 0.1 } else { 1020.0 + away_s };
                let (mut accountant, mut out) = (Accountant::new(rate_hz, Timebase::Device), Vec::new());
                for (sent_s, clock_s) in
                    run(rate_hz, 0.0, 20.0, 1000.0).chain(run(rate_hz, 20.0 + away_s, 10.0, clock_s))
                {
                    accountant.observe(timed(sent_s + if sent_s < 10.0 { 0.0 } else { lag_s }, clock_s), &mut out);
                }
                accountant.settle(&mut out);
                let case = format!("{lag_s} s, {rate_hz} Hz: {:?}", gaps(&out));
                let missing = (away_s * rate_hz).round() as u64;
                assert_eq!(accountant.epoch(), if reset { 2 } else { 1 }, "{case}");
                assert!(accountant.missing().abs_diff(missing) <= 1, "{missing}, {case}");
                assert!(reset || gaps(&out).iter().all(|gap| gap.missing_exact), "{case}");
            }
        }
    }
}

/// A sensor whose flash holds another rate counts faster after a reset: that is no lateness.
#[test]
fn a_count_that_restarts_at_another_rate_is_one_gap() {
    for (from_hz, to_hz) in [(40.0, 50.0), (50.0, 40.0), (40.0, 200.0), (200.0, 40.0), (10.0, 100.0)] {
        let (mut accountant, mut out) = (Accountant::new(from_hz, Timebase::SyncCounter), Vec::new());
        let mut held_ns = 0;
        for (tick, sent_s) in (0..(20.0 * from_hz) as u64)
            .map(|tick| (100 + tick, tick as f64 / from_hz))
            .chain((0..(20.0 * to_hz) as u64).map(|tick| (1 + tick, 21.25 + tick as f64 / to_hz)))
        {
            let arrived = START_NS + (1e9 * sent_s) as u64;
            let mut sample = Sample::at(arrived, 1_800_000_000_000_000_000 + arrived as i64);
            sample.sync_count = Some(tick as u32);
            accountant.observe(sample, &mut out);
            if let (true, Some(last)) = (accountant.held() > 0, accountant.last()) {
                held_ns = held_ns.max(arrived - last.host_mono_ns);
            }
            accountant.take_doubt();
        }
        accountant.settle(&mut out);
        let case = format!("{from_hz} to {to_hz} Hz: held for {held_ns} ns, {:?}, {:?}", gaps(&out), rates(&out));
        assert!(held_ns < 7_000_000_000, "{case}");
        assert_eq!(accountant.epoch(), 2, "{case}");
        let missing = (1.25 * from_hz) as u64;
        assert!(gaps(&out)[0].missing.abs_diff(missing) <= 2 + (0.03 * from_hz) as u64, "{case}");
    }
}

/// A capture that ends with its first sample after an hour without power was reset in between.
#[test]
fn a_reset_that_one_sample_shows_is_measured_by_the_hosts_clock() {
    let (mut accountant, mut out) = (Accountant::new(50.0, Timebase::Device), Vec::new());
    for (index, (sent_s, clock_s)) in run(50.0, 0.0, 10.0, 5.0).chain([(3610.0, 40.0)]).enumerate() {
        if index == 500 {
            accountant.interrupt(GapCause::Unplugged, &mut out);
        }
        accountant.observe(timed(sent_s, clock_s), &mut out);
    }
    accountant.settle(&mut out);
    let [gap] = gaps(&out)[..] else { panic!("{:?}", gaps(&out)) };
    assert_eq!((accountant.epoch(), gap.missing, gap.missing_exact), (2, 180_000, false));
}
