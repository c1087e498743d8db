//! The guarantees of retention, for any captures, limits and clock.

use super::*;
use proptest::prelude::*;

const DAY: i64 = 86_400_000_000_000;
const NOW: i64 = 1_800_000_000_000_000_000;
const NOTICE: Duration = Duration::from_secs(86_400);

fn capture(id: i64, age_days: i64, bytes: u64) -> Candidate {
    Candidate { id, since_utc_ns: NOW - age_days * DAY, bytes, open: false, pinned: false, announced: None }
}

fn limits(keep_days: Option<u64>, keep_bytes: Option<u64>) -> Limits {
    Limits { keep: keep_days.map(|days| Duration::from_secs(days * 86_400)), keep_bytes, notice: NOTICE }
}

/// Returns the plan with a trusted clock.
fn plan(captures: &[Candidate], now_utc_ns: i64, stepped: bool, limits: &Limits) -> Vec<Planned> {
    super::plan(captures, now_utc_ns, &Verdict { stepped, ..Verdict::default() }, limits)
}

fn ids(planned: &[Planned]) -> Vec<i64> {
    planned.iter().map(|planned| planned.id).collect()
}

#[test]
fn age_is_announced_a_notice_ahead_and_deleted_on_its_day() {
    let mut captures = [capture(1, 31, 10), capture(2, 28, 10), capture(3, 1, 10)];
    captures[1].since_utc_ns = NOW - 30 * DAY + DAY / 2;
    let planned = plan(&captures, NOW, false, &limits(Some(30), None));
    assert_eq!(ids(&planned), [1, 2]);
    // The first exceeds its age already and has a whole notice anyway; the second is deleted when it is 30 days old,
    // but not before its notice is over.
    assert_eq!(planned[0].announcement.delete_at_utc_ns, NOW + DAY);
    assert_eq!(planned[1].announcement.delete_at_utc_ns, NOW + DAY);
    assert!(planned.iter().all(|planned| planned.is_new && !planned.is_due && planned.reason == Reason::Age));
    // A day later the announcement stands and is due.
    captures[0].announced = Some(planned[0].announcement);
    let later = plan(&captures[..1], NOW + DAY, false, &limits(Some(30), None));
    assert!(later[0].is_due && !later[0].is_new);
}

#[test]
fn size_takes_the_oldest_and_no_more_than_needed() {
    let captures = [capture(1, 9, 10), capture(2, 3, 10), capture(3, 5, 10), capture(4, 1, 10)];
    assert_eq!(ids(&plan(&captures, NOW, false, &limits(None, Some(40)))), [0_i64; 0]);
    assert_eq!(ids(&plan(&captures, NOW, false, &limits(None, Some(39)))), [1]);
    assert_eq!(ids(&plan(&captures, NOW, false, &limits(None, Some(15)))), [1, 3, 2]);
    // Captures deleted for their age count for the size.
    assert_eq!(ids(&plan(&captures, NOW, false, &limits(Some(7), Some(30)))), [1]);
}

#[test]
fn a_clock_that_cannot_be_trusted_restarts_the_notice() {
    let announcement = Announcement { made_utc_ns: NOW - DAY, delete_at_utc_ns: NOW };
    let announced = [Candidate { announced: Some(announcement), ..capture(1, 31, 10) }];
    let at = |now, stepped| plan(&announced, now, stepped, &limits(Some(30), None))[0];
    assert!(at(NOW, false).is_due);
    for (now, stepped) in [(NOW, true), (NOW - 2 * DAY, false), (NOW + 2 * DAY, false)] {
        let planned = at(now, stepped);
        assert!(planned.is_new && !planned.is_due, "{now} {stepped}");
        assert!(planned.announcement.delete_at_utc_ns >= now + DAY);
    }
    // The machine did not know the year when it recorded: its captures' ages have no meaning.
    let of_1970 = [Candidate { since_utc_ns: 5 * DAY, ..capture(1, 0, 10) }];
    assert_eq!(plan(&of_1970, NOW, false, &limits(Some(30), None)), []);
    assert_eq!(ids(&plan(&of_1970, NOW, false, &limits(Some(30), Some(5)))), [1]);
}

#[test]
fn a_notice_that_is_made_longer_holds_for_what_was_announced() {
    let announcement = Announcement { made_utc_ns: NOW - DAY, delete_at_utc_ns: NOW };
    let announced = [Candidate { announced: Some(announcement), ..capture(1, 31, 10) }];
    let longer = Limits { notice: 3 * NOTICE, ..limits(Some(30), None) };
    let planned = plan(&announced, NOW, false, &longer);
    assert!(planned[0].is_new && planned[0].announcement.delete_at_utc_ns == NOW + 3 * DAY);
}

prop_compose! {
    fn any_capture()(
        age_hours in -50_i64..2000,
        bytes in 0_u64..1000,
        open in prop::bool::weighted(0.1),
        pinned in prop::bool::weighted(0.2),
        announced_hours in prop::option::of((-60_i64..60, 0_i64..60)),
    ) -> Candidate {
        let hour = DAY / 24;
        let announced = announced_hours.map(|(ago, ahead)| Announcement {
            made_utc_ns: NOW - ago * hour,
            delete_at_utc_ns: NOW - ago * hour + ahead * hour,
        });
        Candidate { id: 0, since_utc_ns: NOW - age_hours * hour, bytes, open, pinned, announced }
    }
}

proptest! {
    #[test]
    fn what_is_planned_is_what_the_limits_ask_for(
        mut captures in prop::collection::vec(any_capture(), 0..20),
        keep_days in prop::option::of(1_u64..60),
        keep_bytes in prop::option::of(0_u64..8000),
        notice_hours in 1_u64..72,
        stepped: bool,
    ) {
        for (id, capture) in (1..).zip(&mut captures) {
            capture.id = id;
        }
        let notice = Duration::from_secs(notice_hours * 3600);
        let limits = Limits { notice, ..limits(keep_days, keep_bytes) };
        let planned = plan(&captures, NOW, stepped, &limits);
        let find = |id: i64| &captures[id as usize - 1];
        let notice_ns = notice.as_nanos() as i64;
        for one in &planned {
            let capture = find(one.id);
            prop_assert!(!capture.open && !capture.pinned, "never a running or pinned one");
            // A capture is due only if it was announced a whole notice ago and its own time has come.
            if one.is_due {
                let announcement = capture.announced.unwrap();
                prop_assert!(!stepped && !one.is_new && announcement == one.announcement);
                prop_assert!(announcement.made_utc_ns + notice_ns <= NOW && announcement.delete_at_utc_ns <= NOW);
            }
            if one.is_new {
                prop_assert!(one.announcement.delete_at_utc_ns >= NOW + notice_ns && one.announcement.made_utc_ns == NOW);
            }
        }
        // The oldest are deleted first: every capture that may be deleted and is older than a planned one is planned
        // too.
        let eligible: Vec<i64> = {
            let mut all: Vec<&Candidate> = captures.iter().filter(|one| !one.open && !one.pinned).collect();
            all.sort_by_key(|one| (one.since_utc_ns, one.id));
            all.iter().map(|one| one.id).collect()
        };
        prop_assert_eq!(&ids(&planned), &eligible[..planned.len()]);
        let first_waiting = planned.iter().position(|one| !one.is_due).unwrap_or(planned.len());
        prop_assert!(
            planned[first_waiting..].iter().all(|one| !one.is_due || one.reason == Reason::Age),
            "none goes for the size before an older one"
        );
        // Enough captures are deleted for the size, or all that may be; without the last of them it would not be
        // enough.
        let total: u64 = captures.iter().map(|one| one.bytes).sum();
        let goes: u64 = planned.iter().map(|one| one.bytes).sum();
        if let Some(keep_bytes) = keep_bytes {
            prop_assert!(total - goes <= keep_bytes || planned.len() == eligible.len());
        }
        if let Some(last) = planned.last().filter(|last| last.reason == Reason::Size) {
            prop_assert!(total - (goes - last.bytes) > keep_bytes.unwrap());
        }
        // Captures are deleted for their age if they reach it within the notice; no younger ones are.
        for id in &eligible {
            let capture = find(*id);
            let by_age = keep_days.is_some_and(|days| {
                capture.since_utc_ns + (days * 86_400 * 1_000_000_000) as i64 - notice_ns <= NOW
            });
            let found = planned.iter().find(|one| one.id == *id);
            prop_assert_eq!(by_age, found.is_some_and(|one| one.reason == Reason::Age));
        }
        if limits.is_unlimited() {
            prop_assert!(planned.is_empty());
        }
        // The same plan with the announcements recorded announces nothing new.
        for one in &planned {
            captures[one.id as usize - 1].announced = Some(one.announcement);
        }
        let again = plan(&captures, NOW, false, &limits);
        prop_assert!(again.iter().all(|one| !one.is_new));
        prop_assert_eq!(ids(&again), ids(&planned));
    }
}
