//! Streams without the sensor's time that change their rate, lose samples or come in bursts, and clocks that jump.

use super::*;
use proptest::prelude::*;

pub(super) const START_NS: u64 = 1_000_000_000;

/// The data of a simulated line: the arrival of each sample and the sensor's count, if it has one.
#[derive(Default)]
struct Line {
    arrivals: Vec<(u64, Option<u32>)>,
    /// When the sensor sends the next sample, ns.
    at_ns: f64,
    lost: u64,
}

impl Line {
    /// Sends at a rate for some seconds; samples for which `lost` returns `true` are lost.
    fn send(&mut self, rate_hz: f64, seconds: f64, mut lost: impl FnMut(u64) -> bool, latency_ns: impl Fn(u64) -> u64) {
        for index in 0..(seconds * rate_hz).round() as u64 {
            let arrived = START_NS + self.at_ns as u64 + latency_ns(index);
            // The line keeps the order.
            let arrived = self.arrivals.last().map_or(arrived, |(last, _)| arrived.max(*last));
            // SyncOut counts 800 Hz / 20, whatever the rate of the messages.
            let count = (self.at_ns / 25e6).round() as u32;
            if lost(index) {
                self.lost += 1;
            } else {
                self.arrivals.push((arrived, Some(count)));
            }
            self.at_ns += period_ns(rate_hz);
        }
    }

    fn silence(&mut self, seconds: f64) {
        self.at_ns += seconds * 1e9;
    }

    fn observed(&self, rate_hz: f64, timebase: Timebase) -> (Accountant, Vec<Record>) {
        self.observed_with(rate_hz, timebase, |_| None)
    }

    /// Observes the line with a sensor whose registers can be read on doubt: the rate that they hold at this time.
    fn observed_with(
        &self,
        rate_hz: f64,
        timebase: Timebase,
        registers: impl Fn(u64) -> Option<f64>,
    ) -> (Accountant, Vec<Record>) {
        let (mut accountant, mut out) = (Accountant::new(rate_hz, timebase), Vec::new());
        for (arrived, count) in &self.arrivals {
            let mut sample = Sample::at(*arrived, 1_800_000_000_000_000_000 + *arrived as i64);
            sample.sync_count = count.filter(|_| timebase == Timebase::SyncCounter);
            accountant.observe(sample, &mut out);
            if matches!(accountant.doubt, Some(RateDoubt::Open(_)))
                && let Some(rate_hz) = registers(*arrived)
            {
                accountant.doubt = None;
                accountant.rate_known(rate_hz, &mut out);
            }
        }
        accountant.settle(&mut out);
        (accountant, out)
    }
}

pub(super) fn gaps(out: &[Record]) -> Vec<&Gap> {
    out.iter().filter_map(|record| if let Record::Gap(gap) = record { Some(gap) } else { None }).collect()
}

pub(super) fn rates(out: &[Record]) -> Vec<f64> {
    let rate = |record: &Record| if let Record::Segment(segment) = record { Some(segment.rate_hz) } else { None };
    let mut rates: Vec<f64> = out.iter().filter_map(rate).collect();
    rates.dedup();
    rates
}

/// Delays samples as an FTDI adapter does: it delivers all that has arrived each 16 ms.
fn adapter(rate_hz: f64) -> impl Fn(u64) -> u64 {
    move |index| 16_000_000 - (index as f64 * period_ns(rate_hz)) as u64 % 16_000_000
}

/// Returns a number that is independent of its neighbours'.
fn random(index: u64) -> u64 {
    index.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 20
}

const PAIRS: [(f64, f64); 9] = [
    (50.0, 100.0),
    (50.0, 25.0),
    (50.0, 40.0),
    (40.0, 50.0),
    (100.0, 200.0),
    (200.0, 100.0),
    (200.0, 40.0),
    (40.0, 200.0),
    (20.0, 5.0),
];

#[test]
fn a_rate_that_changes_without_time_is_a_new_segment_and_no_loss() {
    for (from_hz, to_hz) in PAIRS {
        for latency in ["none", "adapter", "random"] {
            let mut line = Line::default();
            let delay = |rate_hz: f64| {
                move |index: u64| match latency {
                    "adapter" => adapter(rate_hz)(index),
                    "random" => random(index) % 3_000_000,
                    _ => 0,
                }
            };
            line.send(from_hz, 10.0, |_| false, delay(from_hz));
            line.send(to_hz, 10.0, |_| false, delay(to_hz));
            let (accountant, out) = line.observed(from_hz, Timebase::Arrival);
            assert_eq!((accountant.rate_hz(), accountant.missing()), (to_hz, 0), "{from_hz} to {to_hz}, {latency}");
            assert_eq!((accountant.received(), rates(&out)), (line.arrivals.len() as u64, vec![from_hz, to_hz]));
            let begun = out.iter().rev().find_map(|record| match record {
                Record::Segment(segment) => Some(segment.first_seq as f64 - from_hz * 10.0),
                _ => None,
            });
            assert!(begun.unwrap().abs() <= 8.0, "{from_hz} to {to_hz}: {begun:?}");
        }
    }
}

/// A sensor boots for 1.25 s and then sends the output in its flash.
#[test]
fn a_reset_to_another_rate_is_one_gap_by_the_hosts_clock() {
    for (from_hz, to_hz) in PAIRS {
        let mut line = Line::default();
        line.send(from_hz, 10.0, |_| false, |_| 0);
        line.silence(1.25);
        line.send(to_hz, 10.0, |_| false, |_| 0);
        let (accountant, out) = line.observed(from_hz, Timebase::Arrival);
        let gaps = gaps(&out);
        let actual = (accountant.rate_hz(), gaps.len(), gaps[0].cause, gaps[0].missing_exact);
        assert_eq!(actual, (to_hz, 1, GapCause::SensorReset, false), "{from_hz} to {to_hz}");
        assert!((accountant.missing() as f64 - 1.25 * from_hz).abs() <= 2.0, "{}", accountant.missing());
    }
}

/// After the boot, samples at a much higher rate arrive as if they made up for it at the old rate.
#[test]
fn a_reset_to_a_much_higher_rate_is_one_gap_whatever_the_latency() {
    for (from_hz, to_hz) in [(1.0, 4.0), (4.0, 20.0), (10.0, 40.0), (10.0, 200.0), (20.0, 100.0), (40.0, 200.0)] {
        for (latency_ns, registers) in
            [0_u64, 2, 12, 18].into_iter().flat_map(|ms| [(ms * 1_000_000, false), (ms * 1_000_000, true)])
        {
            for seed in 0..20 {
                let latency = |index| random(index + 1000 * seed) % (latency_ns + 1);
                let mut line = Line::default();
                line.send(from_hz, 40.0, |_| false, latency);
                line.silence(1.25);
                line.send(to_hz, 20.0, |_| false, latency);
                let known_hz =
                    |at_ns| registers.then_some(if at_ns < START_NS + 40_000_000_000 { from_hz } else { to_hz });
                let (accountant, out) = line.observed_with(from_hz, Timebase::Arrival, known_hz);
                let case = format!("{from_hz} to {to_hz}, {latency_ns}, {registers}, {seed}");
                assert_eq!((accountant.rate_hz(), gaps(&out).len()), (to_hz, 1), "{case}");
                assert!(
                    (accountant.missing() as f64 - 1.25 * from_hz).abs() <= 2.0,
                    "{case}: {}",
                    accountant.missing()
                );
            }
        }
    }
}

/// A hiccup `before_s` before a reset: samples are late by `late_ms`, or this many are lost. The silence of the boot then lies
/// among the undecided samples.
fn reset_after_a_hiccup(
    from_hz: f64,
    to_hz: f64,
    boot_s: f64,
    before_s: f64,
    (late_ms, lost): (u64, u64),
    answers: bool,
) {
    let at = ((10.0 - before_s) * from_hz) as u64;
    // The host reads nothing for a while.
    let latency = |index: u64| match index.checked_sub(at) {
        Some(since) if late_ms > 0 => (late_ms * 1_000_000).saturating_sub(since * period_ns(from_hz) as u64),
        _ => random(index) % 2_000_000,
    };
    let mut line = Line::default();
    line.send(from_hz, 10.0, |index| (at..at + lost).contains(&index), latency);
    let lost = line.lost;
    line.silence(boot_s);
    line.send(to_hz, 30.0, |_| false, |index| random(index) % 2_000_000);
    let registers = |at_ns| answers.then_some(if at_ns < START_NS + 10_100_000_000 { from_hz } else { to_hz });
    let (accountant, out) = line.observed_with(from_hz, Timebase::Arrival, registers);
    let case = format!("{from_hz} to {to_hz}, {boot_s} s, {before_s}, {late_ms}, {lost}, {answers}");
    assert_eq!((accountant.rate_hz(), accountant.received()), (to_hz, line.arrivals.len() as u64), "{case}");
    let (missing, expected) = (accountant.missing() as f64, boot_s * from_hz + lost as f64);
    assert!((missing - expected).abs() <= 2.0 + 0.03 * from_hz, "{case}: {missing} of {expected}");
    let resets = gaps(&out).iter().filter(|gap| gap.cause == GapCause::SensorReset).count();
    assert_eq!(resets, 1, "{case}: {:?}", gaps(&out));
}

proptest! {
    #[test]
    fn a_reset_soon_after_a_hiccup_is_one_gap_too(
        from in 3_usize..11, other in 1_usize..10, more_s in 0.0_f64..2.2, before_s in 0.0_f64..0.6, late_ms in 0_u64..200,
        lost in 0_u64..10, answers in any::<bool>(),
    ) {
        let rates_hz = [1.0, 2.0, 4.0, 5.0, 10.0, 20.0, 25.0, 40.0, 50.0, 100.0, 200.0];
        let (from_hz, to_hz) = (rates_hz[from], rates_hz[if other < from { other } else { other + 1 }]);
        let lost = lost.min((before_s * from_hz) as u64);
        // Half a second and a period of the lower rate are no sign of a reset.
        let boot_s = 0.8 + 1.0 / from_hz.min(to_hz) + more_s;
        reset_after_a_hiccup(from_hz, to_hz, boot_s, before_s, (late_ms, lost), answers);
    }
}

#[test]
fn messages_that_are_counted_by_another_clock_than_their_rate_lose_nothing_when_it_changes() {
    for to_hz in [20.0, 25.0, 50.0, 100.0, 200.0, 10.0] {
        for seed in 0..40 {
            let delay = |rate_hz: f64| {
                move |index: u64| match seed {
                    0 => 0,
                    1 => adapter(rate_hz)(index),
                    _ => random(index + 1000 * seed) % (seed * 500_000),
                }
            };
            let mut line = Line::default();
            line.send(40.0, 10.0, |_| false, delay(40.0));
            line.send(to_hz, 10.0, |_| false, delay(to_hz));
            let (mut accountant, out) = line.observed(40.0, Timebase::SyncCounter);
            let case = format!("{to_hz}, {seed}");
            assert_eq!((accountant.rate_hz(), accountant.missing()), (to_hz, 0), "{case}");
            assert_eq!(accountant.received(), line.arrivals.len() as u64, "{case}");
            let doubt = accountant.take_doubt();
            assert!(matches!(doubt, Some(RateDoubt::Changed(_))) && !doubt.unwrap().is_reset(40.0, to_hz), "{case}");
            assert_eq!(rates(&out), [40.0, to_hz], "{case}");
        }
    }
}

#[test]
fn a_line_that_stalls_and_catches_up_keeps_its_rate() {
    // Each second, 0.3 s of samples are delivered late, at once; the very first samples as well.
    let late = |index: u64| if index % 50 < 15 { (15 - index % 50) * 20_000_000 } else { 0 };
    let mut line = Line::default();
    line.send(50.0, 60.0, |_| false, late);
    let (accountant, out) = line.observed(50.0, Timebase::Arrival);
    assert_eq!((accountant.rate_hz(), accountant.missing(), rates(&out)), (50.0, 0, vec![50.0]));
}

/// The host causes the effects of a late read, though they are decided later.
#[test]
fn a_loss_that_shows_while_the_host_is_to_blame_is_the_hosts() {
    let (mut accountant, mut out) = (Accountant::new(50.0, Timebase::Arrival), Vec::new());
    for tick in (0..100).chain(140..300) {
        let arrived = START_NS + tick * 20_000_000;
        if tick == 140 {
            accountant.blame_host(GapCause::HostStall, arrived + 250_000_000);
        }
        accountant.observe(Sample::at(arrived, 1_800_000_000_000_000_000 + arrived as i64), &mut out);
    }
    accountant.settle(&mut out);
    let actual: Vec<_> = gaps(&out).iter().map(|gap| (gap.before_seq, gap.missing, gap.cause)).collect();
    assert_eq!(actual, [(100, 40, GapCause::HostStall)]);
}

/// The registers decide before the arrivals do.
#[test]
fn registers_that_were_read_again_decide_about_what_is_held() {
    for (known_hz, missing) in [(50.0, true), (25.0, false)] {
        let (mut accountant, mut out) = (Accountant::new(50.0, Timebase::Arrival), Vec::new());
        let mut line = Line::default();
        line.send(50.0, 5.0, |_| false, |_| 0);
        line.send(25.0, 3.0, |_| false, |_| 0);
        line.send(known_hz, 3.0, |_| false, |_| 0);
        for (arrived, _) in &line.arrivals {
            accountant.observe(Sample::at(*arrived, 1_800_000_000_000_000_000 + *arrived as i64), &mut out);
            if matches!(accountant.take_doubt(), Some(RateDoubt::Open(_))) {
                accountant.rate_known(known_hz, &mut out);
            }
        }
        accountant.settle(&mut out);
        assert_eq!((accountant.rate_hz(), accountant.missing() > 60), (known_hz, missing), "{}", accountant.missing());
        assert_eq!(accountant.received(), line.arrivals.len() as u64);
    }
}

/// A count that was never switched on, while one sample comes late: each sample is taken or refused.
#[test]
fn a_count_that_stands_still_loses_no_sample() {
    for (late, late_ms) in (1..30).flat_map(|late| [10, 24, 40, 300].map(|late_ms| (late, late_ms))) {
        let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::SyncCounter), Vec::new());
        let mut last_ns = 0;
        for tick in 0..100 {
            last_ns = last_ns.max(START_NS + tick * 25_000_000 + if tick == late { late_ms * 1_000_000 } else { 0 });
            let sample =
                Sample { sync_count: Some(7), ..Sample::at(last_ns, 1_800_000_000_000_000_000 + last_ns as i64) };
            accountant.observe(sample, &mut out);
        }
        accountant.settle(&mut out);
        let refused: u64 = accountant.take_refused().iter().map(|(frame, _)| u64::from(*frame < 100)).sum();
        let taken = out.iter().filter(|record| matches!(record, Record::Sample { .. })).count() as u64;
        let case = format!("tick {late} late by {late_ms} ms");
        assert_eq!((taken + refused, accountant.received() + refused, accountant.held()), (100, 100, 0), "{case}");
        assert!(refused <= 20 && accountant.missing() == 0, "{case}: {refused}, {} missing", accountant.missing());
    }
}

/// Another master changes the skip factor of the count: the messages still come at the rate.
#[test]
fn a_count_that_advances_at_another_rate_counts_nothing_missing() {
    for rate_hz in [2.0, 5.0, 10.0, 50.0, 200.0] {
        for (twice, name) in [(4, "twice"), (1, "half")] {
            let (mut accountant, mut out) = (Accountant::new(rate_hz, Timebase::SyncCounter), Vec::new());
            let (mut doubt, mut doubles) = (None, 0);
            let changed = 20;
            let ticks = changed + (10.0 * rate_hz) as u64;
            for tick in 0..ticks {
                let arrived = START_NS + (tick as f64 * period_ns(rate_hz)) as u64;
                let count = 2 * tick.min(changed) + twice * tick.saturating_sub(changed);
                let sync_count = Some(count as u32 / 2);
                let sample = Sample { sync_count, ..Sample::at(arrived, 1_800_000_000_000_000_000 + arrived as i64) };
                doubles += u64::from(accountant.observe(sample, &mut out) == Observation::Duplicate);
                doubt = doubt.or(accountant.take_doubt());
            }
            accountant.settle(&mut out);
            let case = format!("{rate_hz} Hz, {name}");
            assert_eq!((accountant.missing(), accountant.timebase()), (0, Timebase::Arrival), "{case}");
            assert!(matches!(doubt, Some(RateDoubt::Open(_))), "{case}: {doubt:?}");
            let refused = doubles + accountant.take_refused().len() as u64;
            assert_eq!((accountant.received(), refused), (ticks, 0), "{case}");
        }
    }
}

/// The caller's cause is that of the gap: only a silence just before the samples in doubt belongs to them.
#[test]
fn a_doubt_reports_the_silence_before_its_samples() {
    // Seconds of silence, of samples at 50 Hz, of silence; whether this is a reset before 40 Hz.
    for (early_s, good_s, late_s, is_reset) in [
        (0.0, 5.0, 0.0, false),
        (0.6, 5.0, 0.0, false),
        (2.0, 8.4, 1.25, true),
        (0.0, 5.0, 1.25, true),
        (3.0, 5.0, 0.4, false),
    ] {
        let mut line = Line::default();
        line.send(50.0, 5.0, |_| false, |_| 0);
        line.silence(early_s);
        line.send(50.0, good_s, |_| false, |_| 0);
        line.silence(late_s);
        let changed_ns = START_NS + line.at_ns as u64;
        line.send(40.0, 5.0, |_| false, |_| 0);
        let (mut accountant, mut out) = (Accountant::new(50.0, Timebase::Arrival), Vec::new());
        let mut doubt = None;
        for (arrived, _) in &line.arrivals {
            accountant.observe(Sample::at(*arrived, 1_800_000_000_000_000_000 + *arrived as i64), &mut out);
            doubt = doubt.or(accountant.take_doubt().filter(|_| *arrived >= changed_ns));
        }
        accountant.settle(&mut out);
        let cause = gaps(&out).last().map(|gap| gap.cause);
        let case = format!("{early_s} s, {good_s} s, {late_s} s: {cause:?}");
        assert_eq!(doubt.map(|doubt| doubt.is_reset(50.0, 40.0)), Some(is_reset), "{case}");
        assert_eq!(late_s > 0.5 && cause == Some(GapCause::SensorReset), is_reset, "{case}");
    }
}

/// The rate changes on a line that loses some samples and delivers late. The sensor either answers queries or only sends.
fn changed_among_losses_and_bursts(pair: usize, every: u64, burst: u64, at: u64, answers: bool) {
    let (from_hz, to_hz) = PAIRS[pair];
    // A sensor that only sends must be heard for two seconds without a loss or a long burst.
    let (every, burst) = if answers { (every, burst) } else { (every.max(3 * to_hz as u64), burst / 2) };
    let mut line = Line::default();
    // Between two rates, it is open at which of them a sample was lost.
    let lost = move |index: u64| index > 3 && (index + at).is_multiple_of(every);
    // A burst each three seconds.
    let late = move |rate_hz: f64| {
        move |index: u64| {
            let into_ms = (index * 1000 / rate_hz as u64 + at * 17) % 3000;
            burst.saturating_sub(into_ms) * 1_000_000
        }
    };
    line.send(from_hz, 10.0, lost, late(from_hz));
    line.send(to_hz, 12.0, lost, late(to_hz));
    let all_lost = line.lost;
    line.send(to_hz, 2.0, |_| false, |_| 0);
    let registers = |at_ns| answers.then_some(if at_ns < START_NS + 10_000_000_000 { from_hz } else { to_hz });
    let (accountant, out) = line.observed_with(from_hz, Timebase::Arrival, registers);
    assert_eq!(accountant.received(), line.arrivals.len() as u64);
    assert_eq!(rates(&out), vec![from_hz, to_hz]);
    // One sample more or less is possible where the rates meet; a loss of less than 20 ms is not yet lateness, and a stall
    // hides the change.
    let unseen = 4 + (0.04 * (from_hz + to_hz)) as u64;
    assert!(accountant.missing().abs_diff(all_lost) <= unseen, "{} of {all_lost}", accountant.missing());
}

proptest! {
    /// Losses of any pattern that is not as regular as another rate are losses.
    #[test]
    fn random_losses_are_never_taken_for_another_rate(share in 0.01_f64..0.7, seed in any::<u64>(), latency in 0_u64..12_000_000) {
        let mut line = Line::default();
        let mut state = seed | 1;
        let lost = |index| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            // The very first samples do not show when the earliest ones come.
            index > 20 && ((state >> 33) as f64 / f64::from(1_u32 << 31)) < share
        };
        line.send(40.0, 30.0, lost, |index| random(index) % (latency + 1));
        line.send(40.0, 2.0, |_| false, |_| 0);
        let (accountant, out) = line.observed(40.0, Timebase::Arrival);
        prop_assert_eq!(rates(&out), vec![40.0]);
        prop_assert_eq!(accountant.received(), line.arrivals.len() as u64);
        prop_assert_eq!(accountant.missing(), line.lost);
    }

    #[test]
    fn a_changed_rate_is_found_among_losses_and_bursts(pair in 0_usize..9, every in 40_u64..200, burst in 0_u64..300, at in 0_u64..50, answers in any::<bool>()) {
        changed_among_losses_and_bursts(pair, every, burst, at, answers);
    }
}

/// In the first case samples of the new rate come while those of the old one are undecided; in the second, a burst puts the
/// rate in doubt just before it changes.
#[test]
fn a_rate_that_changes_while_samples_are_held_is_found() {
    changed_among_losses_and_bursts(6, 52, 7, 48, true);
    changed_among_losses_and_bursts(1, 60, 261, 0, true);
}

/// Observes one sample after another, at ticks of the sensor's clock and of the host's, both in ns.
fn observe(accountant: &mut Accountant, device_ns: u64, host_ns: u64, out: &mut Vec<Record>) -> Observation {
    let mut sample = Sample::at(START_NS + host_ns, 1_800_000_000_000_000_000 + host_ns as i64);
    sample.device_time_ns = Some(5_000_000_000 + device_ns);
    accountant.observe(sample, out)
}

const PERIOD_NS: u64 = 25_000_000;

#[test]
fn a_clock_that_jumps_ahead_while_samples_keep_coming_is_no_loss() {
    for jump in [2, 10, 40, 79] {
        let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
        let mut ahead = 0;
        for tick in 0..400 {
            let jumped = if tick < 200 { 0 } else { jump * PERIOD_NS };
            let host_ns = tick * PERIOD_NS + tick * 7919 % 5_000_000;
            if let Observation::ClockAhead(by_ns) =
                observe(&mut accountant, tick * PERIOD_NS + jumped, host_ns, &mut out)
            {
                ahead += by_ns;
            }
        }
        accountant.settle(&mut out);
        assert_eq!((accountant.received(), accountant.missing(), accountant.epoch()), (400, 0, 2), "{jump}");
        assert!(ahead.abs_diff(jump * PERIOD_NS) <= 10_000_000, "{ahead}");
    }
}

/// The host reads nothing for a second; the line holds a part of the data, and the rest is lost.
#[test]
fn a_stall_whose_burst_lacks_samples_is_a_loss() {
    let (mut accountant, mut out) = (Accountant::new(40.0, Timebase::Device), Vec::new());
    let stalled = 200..240;
    for tick in (0..215).chain(230..400) {
        let host_ns = if stalled.contains(&tick) { 240 * PERIOD_NS } else { tick * PERIOD_NS };
        observe(&mut accountant, tick * PERIOD_NS, host_ns, &mut out);
    }
    accountant.settle(&mut out);
    assert_eq!((accountant.received(), accountant.missing(), accountant.epoch()), (385, 15, 1));
    // By arrival, the gap had no length.
    let gap = gaps(&out)[0];
    assert_eq!((gap.missing_exact, gap.to_utc_ns - gap.from_utc_ns), (true, 16 * PERIOD_NS as i64));
    assert!((gap.from_utc_ns - 1_800_000_000_000_000_000 - 214 * PERIOD_NS as i64).abs() < 5_000_000);
}

/// A host without a clock battery is switched off: its next boot begins in 1970, or the clock of the boot before was
/// not set.
#[test]
fn a_gap_across_a_clock_that_was_not_set_is_as_long_as_what_is_missing() {
    let day = 86_400_000_000_000;
    for (before_ns, after_ns) in
        [(1_800_000_000_000_000_000, 5_000_000_000), (5_000_000_000, 1_800_000_000_000_000_000 + day)]
    {
        let last =
            Position { device_time_ns: Some(5_000_000_000), sync_count: None, host_mono_ns: 0, host_utc_ns: before_ns };
        let mut out = Vec::new();
        let mut accountant =
            Accountant::resume(40.0, Timebase::Device, (1, 1, 100, 0, 0), Some(last), GapCause::DaemonStopped);
        // The sensor lost power as well and has run for 3 s.
        let mut sample = Sample::at(4_000_000_000, after_ns);
        sample.device_time_ns = Some(3_000_000_000);
        accountant.observe(sample, &mut out);
        accountant.settle(&mut out);
        let gap = gaps(&out)[0];
        let length_ns = gap.to_utc_ns - gap.from_utc_ns;
        assert_eq!((gap.to_utc_ns, gap.missing), (after_ns, 119));
        assert_eq!(length_ns, 120 * PERIOD_NS as i64);
    }
}

#[test]
fn a_segment_whose_count_never_comes_rests_on_arrival() {
    let mut line = Line::default();
    line.send(40.0, 2.0, |_| false, |_| 0);
    line.arrivals.iter_mut().for_each(|(_, count)| *count = None);
    let (_, out) = line.observed(40.0, Timebase::SyncCounter);
    let timebases = out.iter().filter_map(|record| match record {
        Record::Segment(segment) => Some(segment.timebase),
        _ => None,
    });
    assert_eq!(timebases.collect::<Vec<_>>(), [Timebase::Arrival]);
}
