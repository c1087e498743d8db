//! The nightly schedule: determines which night is due, when the next one begins, and whether the clock may start one.
//! Pure: the schedule, the time and the zone's rules in, nights out.
//!
//! Guarantees, for any rules and time: a night begins at the first instant at which local clocks show its hour or a
//! later one of its evening. An hour that a change to summer time skips is therefore the moment of the change, and one
//! that comes twice is the first. A night is due for as long as it lasts, so that a machine that was down at the hour
//! still records it.

use crate::clock::rfc3339;
use crate::retention::{Distrust, Moment, Verdict};
use chrono::{DateTime, Datelike, Days, NaiveDate, NaiveTime, Weekday};
use std::time::Duration;

const DAY_S: i64 = 86_400;
/// Nights are searched for within this many days: a week, and the days that a zone may skip or repeat.
const SEARCHED_DAYS: u64 = 8;

/// The offset of local time from UTC, s, at an instant in seconds of UTC.
pub type Zone<'a> = &'a dyn Fn(i64) -> i64;

/// The times at which nights are recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schedule {
    /// The local time of day at which a night begins.
    pub at: NaiveTime,
    /// The sample time of a night, and how late it may still begin.
    pub duration: Duration,
    /// The prefix of the captures' names.
    pub prefix: String,
    /// The days on whose evening a night begins.
    pub days: Vec<Weekday>,
}

/// One night.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Night {
    /// The date of its evening in the machine's zone.
    pub date: NaiveDate,
    /// The name of its capture: no other night has it.
    pub name: String,
    /// When it begins, UTC ns.
    pub start_utc_ns: i64,
    /// The time from which it is too late to begin, UTC ns.
    pub end_utc_ns: i64,
}

/// The night that is due, and the one after it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Nights {
    /// The latest night that has begun, unless it is over.
    pub due: Option<Night>,
    /// The next night; `None` only centuries from now, when nanoseconds overflow.
    pub next: Option<Night>,
}

impl Schedule {
    /// Returns the nights around `now_utc_ns`, in a zone with these rules.
    pub fn nights(&self, now_utc_ns: i64, zone: Zone) -> Nights {
        let now_s = now_utc_ns.div_euclid(1_000_000_000);
        let local_s = now_s.saturating_add(zone(now_s));
        let Some(today) = DateTime::from_timestamp(local_s, 0).map(|local| local.date_naive()) else {
            return Nights::default();
        };
        let first = today.checked_sub_days(Days::new(SEARCHED_DAYS)).unwrap_or(NaiveDate::MIN);
        let mut nights = Nights::default();
        for date in first.iter_days().take(2 * SEARCHED_DAYS as usize + 1) {
            let Some(night) = self.night(date, zone) else { continue };
            if night.start_utc_ns > now_utc_ns {
                nights.next = Some(night);
                break;
            }
            nights.due = Some(night);
        }
        nights.due.take_if(|night| night.end_utc_ns <= now_utc_ns);
        nights
    }

    /// Returns the night of this date; `None` if none begins on that day of the week.
    fn night(&self, date: NaiveDate, zone: Zone) -> Option<Night> {
        if !self.days.contains(&date.weekday()) {
            return None;
        }
        let start_s = first_instant_s(date.and_time(self.at).and_utc().timestamp(), zone);
        let start_utc_ns = start_s.checked_mul(1_000_000_000)?;
        let lasts_ns = i64::try_from(self.duration.as_nanos()).unwrap_or(i64::MAX);
        let name = format!("{}-{}", self.prefix, date.format("%Y-%m-%d"));
        Some(Night { date, name, start_utc_ns, end_utc_ns: start_utc_ns.saturating_add(lasts_ns) })
    }
}

/// Returns the first instant, in seconds of UTC, at which local clocks show at least `local_s` (the civil time counted
/// as if it were UTC). Zones lie within a day of UTC and change at most once in two days.
fn first_instant_s(local_s: i64, zone: Zone) -> i64 {
    let (mut earlier_s, mut later_s) = (local_s - DAY_S, local_s + DAY_S);
    let (before_s, after_s) = (zone(earlier_s), zone(later_s));
    let shown = [before_s, after_s].map(|offset_s| (local_s - offset_s, offset_s));
    let exact = shown.iter().filter(|(instant_s, offset_s)| zone(*instant_s) == *offset_s);
    if let Some(first) = exact.map(|(instant_s, _)| *instant_s).min() {
        return first;
    }
    if before_s == after_s {
        // There are two changes within two days, which no zone has made: use the offset around them.
        return local_s - before_s;
    }
    // The time is skipped: find the change itself, to the second.
    while later_s - earlier_s > 1 {
        let middle_s = earlier_s.midpoint(later_s);
        if zone(middle_s) == before_s { earlier_s = middle_s } else { later_s = middle_s }
    }
    later_s
}

/// A machine without a battery starts with the time of its last shutdown, which looks plausible, and a time server
/// corrects it within this time if there is one.
pub const SETTLING: Duration = Duration::from_secs(300);

/// The reasons why the clock starts no night.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Doubt {
    /// The clock shows an implausible date.
    Implausible(Distrust),
    /// The machine has only just started, and no time server is known to have set its clock yet.
    Settling,
}

/// Returns the reason why a clock that shows `now`, with this verdict, must not start a night; `None` if it may.
pub fn doubt(now: &Moment, verdict: &Verdict) -> Option<Doubt> {
    // The monotonic clock counts from the machine's start.
    let settles = !now.synchronised && Duration::from_nanos(now.mono_ns) < SETTLING;
    verdict.distrust.map(Doubt::Implausible).or_else(|| settles.then_some(Doubt::Settling))
}

impl Doubt {
    /// Returns a description of the problem of a clock that shows `now_utc_ns`, and the remedy.
    pub fn message(self, now_utc_ns: i64) -> String {
        let now = rfc3339(now_utc_ns);
        match self {
            Self::Implausible(Distrust::Unset) => {
                format!("the clock shows {now}, so it was never set: set it, or wait for a time server")
            }
            Self::Implausible(Distrust::Behind { capture, since_utc_ns }) => format!(
                "capture {capture} ended at {}, but the clock shows {now}: set the clock, or, where that capture's date is \
                 the wrong one, delete the capture",
                rfc3339(since_utc_ns)
            ),
            Self::Implausible(Distrust::FarAhead { newest_utc_ns }) => format!(
                "the clock shows {now}, more than 30 days after {}, the latest time that is sure: where it is right, start a \
                 capture by hand, and it is believed once it has run for a day without a step",
                rfc3339(newest_utc_ns)
            ),
            Self::Settling => format!(
                "the machine has started less than {} minutes ago, and no time server is known to have set its clock: wait",
                SETTLING.as_secs() / 60
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR_S: i64 = 3600;
    const ALL: [Weekday; 7] =
        [Weekday::Mon, Weekday::Tue, Weekday::Wed, Weekday::Thu, Weekday::Fri, Weekday::Sat, Weekday::Sun];

    fn instant_s(text: &str) -> i64 {
        DateTime::parse_from_rfc3339(text).unwrap().timestamp()
    }

    fn ns(text: &str) -> i64 {
        instant_s(text) * 1_000_000_000
    }

    /// Returns the offset of Central Europe in 2026: an hour ahead of UTC, two in summer.
    fn europe(utc_s: i64) -> i64 {
        let summer = instant_s("2026-03-29T01:00:00Z")..instant_s("2026-10-25T01:00:00Z");
        if summer.contains(&utc_s) { 2 * HOUR_S } else { HOUR_S }
    }

    fn schedule(at: &str, duration: Duration, days: &[Weekday]) -> Schedule {
        let at = NaiveTime::parse_from_str(at, "%H:%M").unwrap();
        Schedule { at, duration, prefix: "nightly".to_owned(), days: days.to_vec() }
    }

    fn hours(count: u64) -> Duration {
        Duration::from_secs(3600 * count)
    }

    fn name(night: &Option<Night>) -> Option<&str> {
        night.as_ref().map(|night| night.name.as_str())
    }

    /// Returns the names of the due and of the next night, at this time in Central Europe.
    fn around(schedule: &Schedule, now: &str) -> (Option<String>, Option<String>) {
        let nights = schedule.nights(ns(now), &europe);
        (name(&nights.due).map(str::to_owned), name(&nights.next).map(str::to_owned))
    }

    fn some(due: &str, next: &str) -> (Option<String>, Option<String>) {
        let named = |date: &str| (!date.is_empty()).then(|| format!("nightly-{date}"));
        (named(due), named(next))
    }

    #[test]
    fn a_night_is_due_from_its_hour_on_past_midnight_until_it_would_be_over() {
        let schedule = schedule("22:00", hours(5), &ALL);
        assert_eq!(around(&schedule, "2026-11-21T21:59:59+01:00"), some("", "2026-11-21"));
        assert_eq!(around(&schedule, "2026-11-21T22:00:00+01:00"), some("2026-11-21", "2026-11-22"));
        assert_eq!(around(&schedule, "2026-11-22T00:00:00+01:00"), some("2026-11-21", "2026-11-22"));
        assert_eq!(around(&schedule, "2026-11-22T02:59:59+01:00"), some("2026-11-21", "2026-11-22"));
        assert_eq!(around(&schedule, "2026-11-22T03:00:00+01:00"), some("", "2026-11-22"));
        let night = schedule.nights(ns("2026-11-21T12:00:00Z"), &europe).next.unwrap();
        assert_eq!(night.start_utc_ns, ns("2026-11-21T22:00:00+01:00"));
        assert_eq!(night.end_utc_ns, ns("2026-11-22T03:00:00+01:00"));
    }

    #[test]
    fn a_night_that_begins_at_midnight_has_the_date_that_begins() {
        let schedule = schedule("00:00", hours(2), &ALL);
        assert_eq!(around(&schedule, "2026-12-31T23:59:59+01:00"), some("", "2027-01-01"));
        assert_eq!(around(&schedule, "2027-01-01T00:00:00+01:00"), some("2027-01-01", "2027-01-02"));
    }

    #[test]
    fn a_night_of_a_whole_day_gives_way_to_the_next_one() {
        let schedule = schedule("22:00", hours(24), &ALL);
        assert_eq!(around(&schedule, "2026-11-22T21:59:59+01:00"), some("2026-11-21", "2026-11-22"));
        assert_eq!(around(&schedule, "2026-11-22T22:00:00+01:00"), some("2026-11-22", "2026-11-23"));
    }

    /// 2026-11-20 is a Friday. The night from Friday to Saturday is Friday's.
    #[test]
    fn only_the_evenings_of_its_days_begin_a_night() {
        let schedule = schedule("22:00", hours(5), &[Weekday::Mon, Weekday::Fri]);
        assert_eq!(around(&schedule, "2026-11-20T21:00:00+01:00"), some("", "2026-11-20"));
        assert_eq!(around(&schedule, "2026-11-21T01:00:00+01:00"), some("2026-11-20", "2026-11-23"));
        assert_eq!(around(&schedule, "2026-11-21T22:30:00+01:00"), some("", "2026-11-23"));
        let weekly = self::schedule("22:00", hours(24 * 7), &[Weekday::Fri]);
        assert_eq!(around(&weekly, "2026-11-27T21:59:00+01:00"), some("2026-11-20", "2026-11-27"));
        assert_eq!(around(&weekly, "2026-11-27T22:00:00+01:00"), some("2026-11-27", "2026-12-04"));
    }

    /// On 2026-03-29 the clocks go from 02:00 to 03:00: the night of 02:30 begins there, and the others at their hours.
    #[test]
    fn an_hour_that_summer_time_leaves_out_is_the_moment_of_the_change() {
        let schedule = schedule("02:30", hours(5), &ALL);
        let start = |now| schedule.nights(ns(now), &europe).next.unwrap().start_utc_ns;
        assert_eq!(start("2026-03-28T00:00:00Z"), ns("2026-03-28T02:30:00+01:00"));
        assert_eq!(start("2026-03-28T12:00:00Z"), ns("2026-03-29T03:00:00+02:00"));
        assert_eq!(around(&schedule, "2026-03-29T01:59:59+01:00"), some("", "2026-03-29"));
        assert_eq!(around(&schedule, "2026-03-29T03:00:00+02:00"), some("2026-03-29", "2026-03-30"));
        assert_eq!(start("2026-03-29T12:00:00Z"), ns("2026-03-30T02:30:00+02:00"));
    }

    /// On 2026-10-25 the clocks go back from 03:00 to 02:00: 02:30 comes twice.
    #[test]
    fn an_hour_that_comes_twice_is_the_first_and_begins_one_night() {
        let schedule = schedule("02:30", hours(5), &ALL);
        let next = schedule.nights(ns("2026-10-24T12:00:00Z"), &europe).next.unwrap();
        assert_eq!(next.start_utc_ns, ns("2026-10-25T02:30:00+02:00"));
        for during in ["2026-10-25T02:30:00+02:00", "2026-10-25T02:15:00+01:00", "2026-10-25T02:30:00+01:00"] {
            assert_eq!(around(&schedule, during), some("2026-10-25", "2026-10-26"), "{during}");
        }
        // On the evening before, its hour comes once, and its night lasts as long as any other.
        let evening = self::schedule("22:00", hours(5), &ALL);
        assert_eq!(around(&evening, "2026-10-25T01:59:59+01:00"), some("2026-10-24", "2026-10-25"));
        assert_eq!(around(&evening, "2026-10-25T02:00:00+01:00"), some("", "2026-10-25"));
    }

    /// Samoa moved across the date line and had no 2011-12-30.
    #[test]
    fn a_day_that_a_zone_leaves_out_begins_its_night_with_the_next() {
        let samoa = |utc_s: i64| if utc_s < instant_s("2011-12-30T10:00:00Z") { -10 * HOUR_S } else { 14 * HOUR_S };
        let schedule = schedule("22:00", hours(5), &ALL);
        let nights = schedule.nights(ns("2011-12-30T09:00:00Z"), &samoa);
        assert_eq!((name(&nights.due), name(&nights.next)), (Some("nightly-2011-12-29"), Some("nightly-2011-12-30")));
        assert_eq!(nights.next.unwrap().start_utc_ns, ns("2011-12-31T00:00:00+14:00"));
    }

    #[test]
    fn no_time_and_no_offset_stops_it() {
        let schedule = schedule("23:59", Duration::MAX, &ALL);
        for now_utc_ns in [i64::MIN, -1, 0, i64::MAX] {
            for offset_s in [-26 * HOUR_S, 0, 26 * HOUR_S] {
                let _ = schedule.nights(now_utc_ns, &|_| offset_s);
            }
        }
        let none = Schedule { days: Vec::new(), ..schedule };
        assert_eq!(none.nights(0, &|_| 0), Nights::default());
    }

    #[test]
    fn a_clock_starts_no_night_before_it_is_set_or_just_after_the_machines_start() {
        let now = |mono_s: u64, synchronised| Moment { utc_ns: 0, mono_ns: mono_s * 1_000_000_000, synchronised };
        let believed = Verdict::default();
        assert_eq!(doubt(&now(299, false), &believed), Some(Doubt::Settling));
        assert_eq!(doubt(&now(299, true), &believed), None);
        assert_eq!(doubt(&now(300, false), &believed), None);
        for distrust in
            [Distrust::Unset, Distrust::Behind { capture: 7, since_utc_ns: 0 }, Distrust::FarAhead { newest_utc_ns: 0 }]
        {
            let verdict = Verdict { distrust: Some(distrust), ..believed };
            let doubt = doubt(&now(10_000, true), &verdict).unwrap();
            assert_eq!(doubt, Doubt::Implausible(distrust));
            assert!(doubt.message(0).contains("1970-01-01"), "{}", doubt.message(0));
        }
    }

    proptest::proptest! {
        /// Whatever the hour, the duration and the moment: the due night has begun and is not over, the next night has
        /// not begun, and both keep their names at every moment in between.
        #[test]
        fn what_is_due_and_what_comes_lie_around_now(minute in 0_u32..1440, length_min in 1_u64..1440, now_min in 0_i64..527_040) {
            let at = NaiveTime::from_num_seconds_from_midnight_opt(60 * minute, 0).unwrap();
            let duration = Duration::from_secs(60 * length_min);
            let schedule = Schedule { at, duration, prefix: "n".to_owned(), days: ALL.to_vec() };
            let now_utc_ns = ns("2026-01-01T00:00:00Z") + now_min * 60_000_000_000;
            let nights = schedule.nights(now_utc_ns, &europe);
            let next = nights.next.unwrap();
            proptest::prop_assert!(next.start_utc_ns > now_utc_ns && next.start_utc_ns - now_utc_ns <= 25 * HOUR_S * 1_000_000_000);
            if let Some(due) = nights.due {
                proptest::prop_assert!(due.start_utc_ns <= now_utc_ns && now_utc_ns < due.end_utc_ns);
                proptest::prop_assert_eq!(due.date.succ_opt(), Some(next.date));
            }
            let then = schedule.nights(next.start_utc_ns, &europe);
            proptest::prop_assert_eq!(then.due, Some(next));
        }
    }
}
