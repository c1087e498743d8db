//! The judge of the clock: determines whether the clock can show the ages of captures, and whether it has stepped.

use super::Candidate;
use imu_core::sample::accounting::UTC_UNSET_BEFORE_NS;
use std::time::Duration;

/// The reason why the clock does not determine ages, so that nothing is announced or deleted for its age.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Distrust {
    /// It was never set: it shows a time before this program was written.
    Unset,
    /// A capture ended at a time that the clock has not reached yet.
    Behind {
        /// Its id.
        capture: i64,
        /// The time since which it is complete, UTC ns.
        since_utc_ns: i64,
    },
    /// The clock shows a time so much later than any trusted one that it must be confirmed.
    FarAhead {
        /// The latest trusted time: of a capture's end, or the clock's own before it stepped, UTC ns.
        newest_utc_ns: i64,
    },
}

impl Distrust {
    /// Returns the name in the status.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unset => "unset",
            Self::Behind { .. } => "behind",
            Self::FarAhead { .. } => "far-ahead",
        }
    }
}

/// The longest time without a capture that is accepted from an unconfirmed clock.
pub const ABSENCE: Duration = Duration::from_secs(30 * 86_400);

/// A clock that is too far ahead must run for this long without a step until captures that it has dated confirm it: a
/// machine that woke with a wrong date is corrected sooner.
pub const STANDING: Duration = Duration::from_secs(86_400);

/// A time server may set a correct clock back by this much, ns.
const SLACK_NS: i64 = 60_000_000_000;

/// The clock has stepped if civil time moved against the monotonic clock by more than this between two looks, ns.
const STEP_NS: u64 = 60_000_000_000;

/// The clocks at a look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Moment {
    /// Civil time, UTC ns.
    pub utc_ns: i64,
    /// The time of a clock that never steps, ns.
    pub mono_ns: u64,
    /// Whether a time server is known to have set the civil clock since the machine started.
    pub synchronised: bool,
}

/// The judgement of the clock at a look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Verdict {
    /// The reason why it does not determine ages, if there is one.
    pub distrust: Option<Distrust>,
    /// Whether it has jumped since the last look, or is trusted again: the notice of announcements begins now.
    pub stepped: bool,
    /// Whether this is the first look: only a second one shows whether the clock is being set, so nothing is due.
    pub is_first: bool,
}

/// Judges the clock at each look, by the captures and by its earlier times.
///
/// A machine whose battery is empty wakes in 1970, and one whose real-time clock is wrong in any year. Both are online
/// for a while before a time server corrects them, and most time servers leave no mark that they did. So a trusted
/// clock stays trusted as long as it does not step, however long nothing is recorded. At the start and after a step the
/// captures decide that existed when it was last trusted, as far as they still exist: a capture made by a wrong clock
/// does not make it right, and one with a wrong date has no effect once it is deleted.
#[derive(Debug, Clone, Copy, Default)]
pub struct Judge {
    last: Option<Look>,
}

/// The state kept from the last look.
#[derive(Debug, Clone, Copy)]
struct Look {
    /// Civil minus monotonic time, ns.
    offset_ns: i64,
    /// The monotonic time since which the clock has not jumped.
    stands_since_mono_ns: u64,
    distrust: Option<Distrust>,
    /// The clock's time when it was last trusted.
    believed_utc_ns: Option<i64>,
    /// Captures that were completed later than this were dated by an untrusted clock.
    known_until_utc_ns: Option<i64>,
}

impl Judge {
    /// Returns the verdict at `now`, from which the next one starts.
    pub fn look(&mut self, now: Moment, captures: &[Candidate]) -> Verdict {
        // Saturating: a clock that is years wrong must not stop this.
        let offset_ns = now.utc_ns.saturating_sub(i64::try_from(now.mono_ns).unwrap_or(i64::MAX));
        let moved = self.last.is_some_and(|last| offset_ns.saturating_sub(last.offset_ns).unsigned_abs() > STEP_NS);
        // A running capture has not ended.
        let ends = || captures.iter().filter(|capture| !capture.open).map(|capture| capture.since_utc_ns);
        let before = self.last.unwrap_or(Look {
            offset_ns,
            stands_since_mono_ns: now.mono_ns,
            distrust: None,
            believed_utc_ns: None,
            known_until_utc_ns: ends().max(),
        });
        let stands_since_mono_ns = if moved { now.mono_ns } else { before.stands_since_mono_ns };
        let was_believed = self.last.is_some() && before.distrust.is_none();
        let distrust = if now.utc_ns < UTC_UNSET_BEFORE_NS {
            Some(Distrust::Unset)
        } else if now.synchronised || (was_believed && !moved) {
            None
        } else {
            let stands = Duration::from_nanos(now.mono_ns.saturating_sub(stands_since_mono_ns)) >= STANDING;
            implausible(now.utc_ns, captures, &before, stands)
        };
        let mut look = Look { offset_ns, stands_since_mono_ns, distrust, ..before };
        if distrust.is_none() {
            look.believed_utc_ns = Some(now.utc_ns);
            // A capture that is dated later than a trusted clock has a wrong date.
            look.known_until_utc_ns = ends().filter(|end| *end <= now.utc_ns.saturating_add(SLACK_NS)).max();
        }
        let is_first = self.last.is_none();
        self.last = Some(look);
        Verdict { distrust, stepped: moved || (before.distrust.is_some() && distrust.is_none()), is_first }
    }
}

/// Returns the reason why the clock's time is implausible; `stands`: it has run for [`STANDING`] without a step.
fn implausible(now_utc_ns: i64, captures: &[Candidate], before: &Look, stands: bool) -> Option<Distrust> {
    let latest_utc_ns = now_utc_ns.saturating_add(SLACK_NS);
    let absence_ns = i64::try_from(ABSENCE.as_nanos()).unwrap_or(i64::MAX);
    let is_known = |capture: &&Candidate| !capture.open && Some(capture.since_utc_ns) <= before.known_until_utc_ns;
    let newest = captures.iter().filter(is_known).max_by_key(|capture| (capture.since_utc_ns, capture.id));
    if let Some(Candidate { id, since_utc_ns, .. }) = newest.filter(|newest| newest.since_utc_ns > latest_utc_ns) {
        return Some(Distrust::Behind { capture: *id, since_utc_ns: *since_utc_ns });
    }
    let newest_utc_ns = newest.map(|newest| newest.since_utc_ns).max(before.believed_utc_ns)?;
    let speaks_for_it = |capture: &Candidate| {
        let is_recent = now_utc_ns.saturating_sub(capture.since_utc_ns) <= absence_ns;
        capture.open || (is_recent && capture.since_utc_ns <= latest_utc_ns)
    };
    let is_far = now_utc_ns.saturating_sub(newest_utc_ns) > absence_ns;
    (is_far && !(stands && captures.iter().any(speaks_for_it))).then_some(Distrust::FarAhead { newest_utc_ns })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retention::{Limits, Planned, Reason, plan};

    const HOUR: i64 = 3_600_000_000_000;
    const DAY: i64 = 24 * HOUR;
    const NOW: i64 = 1_800_000_000_000_000_000;
    const FAR: i64 = 20_000 * DAY;

    fn capture(id: i64, since_utc_ns: i64) -> Candidate {
        Candidate { id, since_utc_ns, bytes: 10, open: false, pinned: false, announced: None }
    }

    /// A clock that can be set, and the judge of it.
    #[derive(Default)]
    struct World {
        judge: Judge,
        utc_ns: i64,
        mono_ns: u64,
        synchronised: bool,
    }

    impl World {
        fn at(utc_ns: i64) -> Self {
            Self { utc_ns, ..Self::default() }
        }
        /// Lets time pass.
        fn pass(&mut self, by_ns: i64) -> &mut Self {
            self.utc_ns += by_ns;
            self.mono_ns += by_ns as u64;
            self
        }
        fn set(&mut self, utc_ns: i64) -> &mut Self {
            self.utc_ns = utc_ns;
            self
        }
        fn look(&mut self, captures: &[Candidate]) -> Verdict {
            let Self { utc_ns, mono_ns, synchronised, .. } = *self;
            self.judge.look(Moment { utc_ns, mono_ns, synchronised }, captures)
        }
        /// Returns only the distrust.
        fn distrust(&mut self, captures: &[Candidate]) -> Option<Distrust> {
            self.look(captures).distrust
        }
    }

    #[test]
    fn a_clock_that_shows_an_implausible_date_determines_no_ages() {
        let at = |utc_ns, newest: Option<i64>, synchronised| {
            let captures: Vec<Candidate> = newest.into_iter().map(|newest| capture(1, newest)).collect();
            World { synchronised, ..World::at(utc_ns) }.distrust(&captures)
        };
        for synchronised in [false, true] {
            assert_eq!(at(3 * DAY, Some(NOW), synchronised), Some(Distrust::Unset));
            assert_eq!(at(3 * DAY, None, synchronised), Some(Distrust::Unset));
            for usual in [NOW, NOW + 1, NOW + 29 * DAY] {
                assert_eq!(at(usual, Some(NOW), synchronised), None, "{usual}");
            }
            assert_eq!(at(NOW, None, synchronised), None);
        }
        assert_eq!(at(NOW - HOUR, Some(NOW), false), Some(Distrust::Behind { capture: 1, since_utc_ns: NOW }));
        assert_eq!(at(NOW - 1, Some(NOW), false), None, "a time server sets a clock back by a moment");
        assert_eq!(at(NOW + 31 * DAY, Some(NOW), false), Some(Distrust::FarAhead { newest_utc_ns: NOW }));
        assert_eq!(at(i64::MAX, Some(-DAY), false), Some(Distrust::FarAhead { newest_utc_ns: -DAY }));
        // A time server is trusted: then a capture's own date was wrong, or nothing was recorded for long.
        assert_eq!(at(NOW - DAY, Some(NOW), true), None);
        assert_eq!(at(NOW + 4000 * DAY, Some(NOW), true), None);
    }

    /// A month without a capture, or a capture that lasts a month, is no reason to distrust a clock that did not step.
    #[test]
    fn a_clock_that_does_not_step_stays_believed_however_long_nothing_ends() {
        let running = Candidate { open: true, ..capture(2, NOW + HOUR) };
        for during in [vec![capture(1, NOW)], vec![capture(1, NOW), running]] {
            let mut world = World::at(NOW + HOUR);
            assert_eq!(world.distrust(&during), None);
            for day in 1..=100 {
                assert_eq!(world.pass(DAY).look(&during), Verdict::default(), "{day}");
            }
            // A correction by two minutes after that is a step and no more.
            let later = world.utc_ns + 2 * HOUR / 60;
            let verdict = world.set(later).look(&during);
            assert_eq!((verdict.distrust, verdict.stepped), (None, true));
        }
    }

    #[test]
    fn a_month_away_is_made_good_by_a_day_of_captures_and_not_by_one_capture() {
        let old = capture(1, NOW);
        let far = Some(Distrust::FarAhead { newest_utc_ns: NOW });
        let begin = NOW + 60 * DAY;
        for open in [false, true] {
            let mut world = World::at(begin);
            let new = Candidate { open, ..capture(2, begin + HOUR) };
            assert_eq!(world.distrust(std::slice::from_ref(&old)), far);
            for _ in 0..23 {
                assert_eq!(world.pass(HOUR).distrust(&[old.clone(), new.clone()]), far, "what it dated itself");
            }
            assert_eq!(world.pass(HOUR).look(&[old.clone(), new]).distrust, None, "{open}");
            assert_eq!(world.pass(HOUR).look(std::slice::from_ref(&old)), Verdict::default());
        }
        // Nothing confirms the clock, and a step begins the day again.
        let mut world = World::at(begin);
        assert_eq!(world.distrust(std::slice::from_ref(&old)), far);
        assert_eq!(world.pass(10 * DAY).distrust(std::slice::from_ref(&old)), far);
        let further = world.utc_ns + FAR;
        let new = capture(2, further);
        assert_eq!(world.set(further).distrust(&[old, new]), far);
    }

    #[test]
    fn a_capture_that_a_wrong_clock_dated_does_not_stand_in_the_right_ones_way() {
        let (old, wrong) = (capture(1, NOW), capture(2, NOW + FAR));
        // The clock was wrong while the daemon ran, and is right again.
        let mut world = World::at(NOW + HOUR);
        assert_eq!(world.distrust(std::slice::from_ref(&old)), None);
        let newest_utc_ns = world.utc_ns;
        assert_eq!(
            world.set(NOW + FAR).distrust(std::slice::from_ref(&old)),
            Some(Distrust::FarAhead { newest_utc_ns })
        );
        let both = [old.clone(), wrong.clone()];
        assert_eq!(world.pass(HOUR).distrust(&both), Some(Distrust::FarAhead { newest_utc_ns }));
        assert_eq!(world.set(NOW + 2 * HOUR).distrust(&both), None);
        for _ in 0..3 {
            assert_eq!(world.pass(HOUR).look(&both), Verdict::default());
        }
        let later = world.utc_ns + HOUR;
        assert_eq!(world.set(later).distrust(&both), None, "nor after another step");
        // It was wrong before the daemon started: this cannot be known, but deleting the capture helps at once.
        let mut world = World::at(NOW + HOUR);
        let behind = Some(Distrust::Behind { capture: 2, since_utc_ns: NOW + FAR });
        assert_eq!(world.distrust(&both), behind);
        assert_eq!(world.pass(DAY).distrust(&both), behind);
        let verdict = world.pass(HOUR).look(&[old]);
        assert_eq!((verdict.distrust, verdict.stepped), (None, true));
        assert_eq!(world.pass(HOUR).distrust(&both), None);
    }

    /// The end of the distrust counts as a step: deletions announced before the wrong date are announced again.
    #[test]
    fn what_was_announced_before_an_implausible_date_is_announced_again_after_it() {
        let limits = Limits {
            keep: Some(Duration::from_secs(30 * 86_400)),
            keep_bytes: None,
            notice: Duration::from_secs(7 * 86_400),
        };
        // The clock is ten days slow.
        let mut world = World::at(NOW);
        let mut captures = [capture(1, NOW - 29 * DAY), capture(2, NOW - DAY)];
        assert!(world.look(&captures).is_first);
        let verdict = world.pass(HOUR).look(&captures);
        let [first] = plan(&captures, world.utc_ns, &verdict, &limits)[..] else { panic!() };
        assert_eq!((first.id, first.announcement.delete_at_utc_ns), (1, NOW + HOUR + 7 * DAY));
        captures[0].announced = Some(first.announcement);
        // A wrong date, for a minute.
        let verdict = world.set(NOW + FAR).look(&captures);
        assert_eq!(plan(&captures, world.utc_ns, &verdict, &limits), []);
        // The right time is past the date that was announced.
        let right = NOW + 10 * DAY;
        let verdict = world.set(right).look(&captures);
        let again = plan(&captures, right, &verdict, &limits);
        assert_eq!((verdict.distrust, again.len()), (None, 1));
        assert!(again[0].is_new && !again[0].is_due && again[0].announcement.delete_at_utc_ns >= right + 7 * DAY);
        captures[0].announced = Some(again[0].announcement);
        let verdict = world.pass(HOUR / 60).look(&captures);
        assert!(!plan(&captures, world.utc_ns, &verdict, &limits)[0].is_due);
    }

    /// The captures beyond the size limit do not depend on the clock: `keep-mib` and its notice apply with a wrong
    /// clock too.
    #[test]
    fn size_is_kept_by_a_clock_that_is_not_believed_and_the_first_made_go_first() {
        let limits =
            Limits { keep: Some(Duration::from_secs(86_400)), keep_bytes: Some(25), notice: Duration::from_secs(3600) };
        // The machine woke in 1970 and has recorded since.
        let mut world = World::at(2 * HOUR);
        let mut captures = [capture(1, NOW - 90 * DAY), capture(2, NOW - 80 * DAY), capture(3, HOUR)];
        let planned = |world: &mut World, captures: &[Candidate]| -> Vec<Planned> {
            let verdict = world.look(captures);
            assert_eq!(verdict.distrust, Some(Distrust::Unset));
            plan(captures, world.utc_ns, &verdict, &limits)
        };
        let [one] = planned(&mut world, &captures)[..] else { panic!() };
        assert_eq!((one.id, one.reason, one.is_due), (1, Reason::Size, false));
        captures[0].announced = Some(one.announcement);
        assert!(!planned(world.pass(HOUR / 2), &captures)[0].is_due);
        assert!(planned(world.pass(HOUR / 2), &captures)[0].is_due);
    }
}
