//! Host watch: detects from the host's clocks that the host stood still, slept, or had its civil time stepped. Pure.
//!
//! Three clocks are compared from turn to turn of the reader's loop: one that continues while the machine sleeps
//! (`CLOCK_BOOTTIME`), one that does not (`CLOCK_MONOTONIC`), and civil time. NTP slews all of them alike, so that a
//! change between civil and monotonic time is a step.

use imu_core::sample::accounting::UTC_UNSET_BEFORE_NS;

/// The host stood still if the loop did not run for this long beyond its tick, ns.
const STALL_NS: u64 = 1_000_000_000;
/// The machine slept if the clock that stops during sleep lacks at least this, ns.
const SLEEP_NS: u64 = 500_000_000;
/// The minimum size of a step of civil time, ns.
const STEP_NS: i64 = 10_000_000;
/// Clocks are read one after the other; a reading that took longer than this cannot show a step, ns.
const BRACKET_NS: u64 = 1_000_000;

/// The host's clocks, read together, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reading {
    /// Continues while the machine sleeps; read before the others.
    pub mono_ns: u64,
    /// Stops while the machine sleeps.
    pub awake_ns: u64,
    /// Civil time.
    pub utc_ns: i64,
    /// As `mono_ns`, read after the others.
    pub after_ns: u64,
}

/// An event of the host since the last turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HostEvent {
    /// The program did not run for this long, ns.
    Stalled(u64),
    /// The machine slept for this long, ns.
    Slept(u64),
    /// Civil time was stepped by this much, ns.
    Stepped(i64),
}

/// Compares the clocks from turn to turn.
#[derive(Debug, Clone, Default)]
pub struct HostWatch {
    last: Option<Reading>,
    /// Civil minus monotonic time, as of the last good reading.
    offset_ns: Option<i64>,
}

impl HostWatch {
    /// Takes a reading; the loop runs at least every `tick_ns`.
    pub fn turn(&mut self, now: Reading, tick_ns: u64) -> Vec<HostEvent> {
        let mut events = Vec::new();
        if let Some(last) = self.last.replace(now) {
            let passed_ns = now.mono_ns.saturating_sub(last.mono_ns);
            let awake_ns = now.awake_ns.saturating_sub(last.awake_ns);
            let slept_ns = passed_ns.saturating_sub(awake_ns);
            if slept_ns > SLEEP_NS {
                events.push(HostEvent::Slept(slept_ns));
            } else if awake_ns > tick_ns + STALL_NS {
                events.push(HostEvent::Stalled(awake_ns));
            }
        }
        if now.after_ns.saturating_sub(now.mono_ns) <= BRACKET_NS {
            let offset_ns = now.utc_ns.saturating_sub_unsigned(now.mono_ns.midpoint(now.after_ns));
            if let Some(before_ns) = self.offset_ns.replace(offset_ns) {
                let by_ns = offset_ns.saturating_sub(before_ns);
                if by_ns.saturating_abs() >= STEP_NS {
                    events.push(HostEvent::Stepped(by_ns));
                }
            }
        }
        events
    }
}

/// Arrivals are stamped with both clocks one after the other. A program that is suspended in between causes no step of
/// that size, ns, and neither does NTP's slew, which is at most 500 ppm.
const AWAY_STEP_NS: u64 = 1_000_000_000;
const AWAY_SLEW: f64 = 500e-6;

/// Returns the step of civil time, ns, between two instants of one boot of the host while no daemon watched:
/// `(monotonic, civil)` of each. `None` if there was no step.
pub fn stepped_while_away(before: (u64, i64), now: (u64, i64)) -> Option<i64> {
    let away_ns = now.0.checked_sub(before.0)?;
    let by_ns = now.1.saturating_sub(before.1).saturating_sub_unsigned(away_ns);
    (by_ns.unsigned_abs() > AWAY_STEP_NS + (AWAY_SLEW * away_ns as f64) as u64).then_some(by_ns)
}

/// From this size on, the rows show steps of a clock that stays unset: no measurement is that late, ns.
const UNSET_STEP_NS: i64 = 10_000_000_000;

/// Returns, if a step shows that the host's clock had not been set, the limit, UTC ns, below which times are of the
/// clock before the step. `utc_ns` is civil time after the step. A clock that is still not plausible after the step is
/// set once more later, starting from the result of this step. Half of the step then determines which times precede it.
pub fn unset_before(by_ns: i64, utc_ns: i64) -> Option<i64> {
    let was_unset = by_ns > 0 && utc_ns.saturating_sub(by_ns) < UTC_UNSET_BEFORE_NS;
    match utc_ns >= UTC_UNSET_BEFORE_NS {
        true => was_unset.then_some(UTC_UNSET_BEFORE_NS),
        false => (was_unset && by_ns >= UNSET_STEP_NS).then_some(utc_ns - by_ns / 2),
    }
}

/// Returns whether a clock was set back to, or within, an implausible time. Earlier rows then have later times than the
/// following ones, so that a later correction would move them too far.
pub fn set_back_unset(by_ns: i64, utc_ns: i64) -> bool {
    by_ns <= -UNSET_STEP_NS && utc_ns < UTC_UNSET_BEFORE_NS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::{Clock, ManualClock};
    use std::time::Duration;

    const TICK_NS: u64 = 200_000_000;

    fn reading(clock: &ManualClock) -> Reading {
        let mono_ns = clock.mono_ns();
        Reading { mono_ns, awake_ns: clock.awake_ns(), utc_ns: clock.utc_ns(), after_ns: clock.mono_ns() }
    }

    #[test]
    fn times_before_each_step_of_an_unset_clock_are_distinguished_from_those_after_it() {
        let (set, in_2010) = (UTC_UNSET_BEFORE_NS + 5, 1_262_304_000_000_000_000);
        assert_eq!(unset_before(set - 60, set), Some(UTC_UNSET_BEFORE_NS), "1970, then NTP");
        assert_eq!(unset_before(in_2010 - 60, in_2010), Some(in_2010 / 2 + 30), "1970, then 2010 by hand");
        assert_eq!(unset_before(-3_600_000_000_000, in_2010), None, "set back");
        assert!(set_back_unset(-3_600_000_000_000, in_2010) && !set_back_unset(-3_600_000_000_000, set));
        assert_eq!(unset_before(20_000_000, in_2010), None, "no row shows which side it is on");
        assert!(!set_back_unset(-20_000_000, in_2010));
        assert_eq!(unset_before(2_000_000_000, set + 10_000_000_000), None, "a clock that was right");
    }

    #[test]
    fn a_step_of_civil_time_is_reported_with_its_size_and_nothing_else_is() {
        let clock = ManualClock::new(1_800_000_000_000_000_000);
        let mut watch = HostWatch::default();
        assert!(watch.turn(reading(&clock), TICK_NS).is_empty());
        for step_ns in
            [-3_600_000_000_000, 3_600_000_000_000, -1_800_000_000_000_000_000, 1_800_000_000_000_000_000, 12_000_000]
        {
            clock.advance(Duration::from_millis(100));
            assert!(watch.turn(reading(&clock), TICK_NS).is_empty());
            clock.step_utc(step_ns);
            assert_eq!(watch.turn(reading(&clock), TICK_NS), [HostEvent::Stepped(step_ns)]);
        }
        // A slow reading shows nothing; the next good one does.
        clock.step_utc(50_000_000);
        let mut slow = reading(&clock);
        slow.after_ns += 2_000_000;
        assert!(watch.turn(slow, TICK_NS).is_empty());
        assert_eq!(watch.turn(reading(&clock), TICK_NS), [HostEvent::Stepped(50_000_000)]);
    }

    #[test]
    fn a_step_while_away_is_reported_and_a_slew_is_no_step() {
        let (second, night) = (1_000_000_000_u64, 28_800_000_000_000_u64);
        let before = (50 * second, 1_800_000_000_000_000_000_i64);
        let later = |by_ns: i64| (before.0 + night, before.1 + night as i64 + by_ns);
        assert_eq!(stepped_while_away(before, later(0)), None);
        // 500 ppm of eight hours.
        assert_eq!(stepped_while_away(before, later(14_400_000_000)), None);
        assert_eq!(stepped_while_away(before, later(-3_600_000_000_000)), Some(-3_600_000_000_000));
        assert_eq!(stepped_while_away((20, 0), (10, 5)), None, "another boot's clock");
    }

    /// Fault D5 of docs/reliability/time.md.
    #[test]
    fn an_hour_of_sleep_is_no_stall_and_a_stall_is_no_sleep() {
        let clock = ManualClock::new(0);
        let mut watch = HostWatch::default();
        watch.turn(reading(&clock), TICK_NS);
        clock.suspend(Duration::from_secs(3600));
        assert_eq!(watch.turn(reading(&clock), TICK_NS), [HostEvent::Slept(3_600_000_000_000)]);
        clock.advance(Duration::from_secs(60));
        assert_eq!(watch.turn(reading(&clock), TICK_NS), [HostEvent::Stalled(60_000_000_000)]);
        clock.advance(Duration::from_millis(200));
        assert!(watch.turn(reading(&clock), TICK_NS).is_empty());
    }
}
