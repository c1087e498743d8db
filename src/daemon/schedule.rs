//! The schedule's shell: requests each night's capture when its time has come.
//!
//! A night's capture is known by its name: if a capture has that name, or was made since the night's start and had it
//! before somebody renamed it, the night is done, regardless of its origin and state. So a restart starts no second one, and no state has to be stored.

use super::retention::candidate;
use crate::clock::{Clock, rfc3339};
use crate::config::Config;
use crate::control::{CaptureControl, CaptureRequest, ControlError};
use crate::notify::Tap;
use crate::observe::ScheduleStatus;
use crate::retention::{Candidate, Judge, Moment, Verdict};
use crate::schedule::{Doubt, Night, Schedule, doubt};
use crate::store::{Store, StoreError};
use chrono::NaiveDate;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// The longest interval between looks, by the daemon's clock: the civil clock may be set, and an obstacle may be gone.
const EVERY: Duration = Duration::from_secs(60);
/// The shortest interval in real time, however fast the daemon's clock runs.
const SHORTEST: Duration = Duration::from_millis(250);

/// Returns the schedule of the configuration; `None` if there is none.
pub fn schedule(config: &Config) -> Option<Schedule> {
    let schedule = &config.schedule;
    Some(Schedule {
        at: schedule.at.0?,
        duration: schedule.duration.0.unwrap_or(config.capture.duration),
        prefix: schedule.name.clone(),
        days: schedule.days.iter().map(|day| day.weekday()).collect(),
    })
}

/// The parts of the daemon that the schedule uses.
#[derive(Debug, Clone)]
pub struct Scheduler {
    /// The store with the captures.
    pub store: Store,
    /// The control that starts a capture.
    pub control: CaptureControl,
    /// The recipient of notifications about skipped nights.
    pub tap: Tap,
    /// The clock.
    pub clock: Arc<dyn Clock>,
    /// The offset of local time from UTC, s, at an instant in seconds of UTC.
    pub zone: fn(i64) -> i64,
    /// The schedule.
    pub schedule: Schedule,
}

/// The state between looks.
#[derive(Debug, Default)]
struct Course {
    judge: Judge,
    /// The evening of the night that is done.
    done: Option<NaiveDate>,
    /// The night that should have begun.
    waiting: Option<Waiting>,
}

/// A night that should have begun.
#[derive(Debug)]
struct Waiting {
    night: Night,
    why: Why,
    /// The last logged reason.
    reason: String,
}

/// The reasons why a night has not begun.
#[derive(Debug, PartialEq, Eq)]
enum Why {
    /// The clock may be wrong.
    Clock(Doubt),
    /// This capture runs or waits.
    Busy(i64),
    /// The database does not accept it; the error's message.
    Store(String),
}

impl Why {
    /// Returns a sentence for the user; the clock shows `now_utc_ns`.
    fn message(&self, now_utc_ns: i64) -> String {
        match self {
            Self::Clock(doubt) => doubt.message(now_utc_ns),
            Self::Busy(running) => format!("capture {running} runs or waits: stop it, or let it end"),
            Self::Store(reason) => reason.clone(),
        }
    }
}

/// The outcome of an attempt to begin a night.
enum Attempt {
    /// Its capture exists.
    Done,
    /// It cannot begin yet, for this reason.
    Waits(Why),
    /// The daemon is ending.
    Stopping,
}

impl Scheduler {
    /// Looks and starts until `stop`; `status` receives the next night.
    pub async fn run(self, status: watch::Sender<Option<ScheduleStatus>>, stop: CancellationToken) {
        let mut course = Course::default();
        loop {
            let look = tokio::select! {
                () = stop.cancelled() => return,
                look = self.look(&mut course) => look,
            };
            let Some((now_known, wait)) = look else { return };
            status.send_replace(now_known);
            tokio::select! {
                () = stop.cancelled() => return,
                () = tokio::time::sleep(self.clock.real(wait).max(SHORTEST)) => {}
            }
        }
    }

    /// Does one look; returns the status, and the time until the next look by the daemon's clock. `None` once the
    /// daemon is ending.
    async fn look(&self, course: &mut Course) -> Option<(Option<ScheduleStatus>, Duration)> {
        let now = Moment {
            utc_ns: self.clock.utc_ns(),
            mono_ns: self.clock.mono_ns(),
            synchronised: self.clock.is_synchronised(),
        };
        let nights = self.schedule.nights(now.utc_ns, &self.zone);
        if let Some(Waiting { night, reason, .. }) =
            course.waiting.take_if(|waiting| nights.due.as_ref() != Some(&waiting.night))
        {
            // Otherwise the clock was set back before its hour and the night may still come, or the zone has changed
            // and it begins at another time.
            let is_same = nights.due.as_ref().is_some_and(|due| due.date == night.date);
            if now.utc_ns >= night.start_utc_ns && !is_same {
                tracing::warn!(night = night.name, "the night was skipped: {reason}");
                self.tap.night_skipped(night.name, reason);
            }
        }
        let due = nights.due.filter(|night| course.done != Some(night.date));
        let found = self.ask_store(due.as_ref(), now, course.judge).await;
        if let Ok((judged, ..)) = found {
            course.judge = judged;
        }
        if let Some(night) = due {
            let attempt = match found {
                Ok((_, _, true)) => Attempt::Done,
                Ok((_, verdict, false)) => self.begin(&night, &now, &verdict).await,
                Err(StoreError::Closed) => Attempt::Stopping,
                Err(error) => Attempt::Waits(Why::Store(error.to_string())),
            };
            match attempt {
                Attempt::Done => {
                    course.done = Some(night.date);
                    course.waiting = None;
                }
                Attempt::Waits(why) => {
                    let reason = why.message(now.utc_ns);
                    if course.waiting.as_ref().is_none_or(|before| before.why != why) {
                        let until = rfc3339(night.end_utc_ns);
                        tracing::warn!(night = night.name, until, "the night waits: {reason}");
                    }
                    course.waiting = Some(Waiting { night, why, reason });
                }
                Attempt::Stopping => return None,
            }
        }
        let until_next = nights.next.as_ref().map_or(EVERY, |next| {
            Duration::from_nanos(u64::try_from(next.start_utc_ns.saturating_sub(now.utc_ns)).unwrap_or(0))
        });
        let (next, waits) = match &course.waiting {
            Some(Waiting { night, reason, .. }) => (Some(night), Some(reason.clone())),
            None => (nights.next.as_ref(), None),
        };
        Some((next.map(|night| self.status_of(night, waits)), until_next.min(EVERY)))
    }

    /// Reads from the database the verdict of its captures on the clock, and whether the night has a capture.
    async fn ask_store(
        &self,
        due: Option<&Night>,
        now: Moment,
        mut judge: Judge,
    ) -> Result<(Judge, Verdict, bool), StoreError> {
        let due = due.map(|night| (night.name.clone(), night.start_utc_ns));
        let ask = move |store: &Store| {
            let reader = store.reader()?;
            let captures: Vec<Candidate> = reader.retention_rows()?.iter().map(candidate).collect();
            let verdict = judge.look(now, &captures);
            let is_there = due.map_or(Ok(false), |(name, start)| reader.has_been_named(&name, start))?;
            Ok((judge, verdict, is_there))
        };
        self.store.offload(ask).await
    }

    /// Tries to begin a night that has no capture yet.
    async fn begin(&self, night: &Night, now: &Moment, verdict: &Verdict) -> Attempt {
        if let Some(doubt) = doubt(now, verdict) {
            return Attempt::Waits(Why::Clock(doubt));
        }
        let name = Some(night.name.clone());
        let request = CaptureRequest { duration: self.schedule.duration, name, ..CaptureRequest::default() };
        match self.control.start(request).await {
            Ok(id) => {
                tracing::info!(capture = id, night = night.name, "the night's capture begins");
                Attempt::Done
            }
            Err(ControlError::NameTaken(_)) => Attempt::Done,
            Err(ControlError::Busy(running)) => Attempt::Waits(Why::Busy(running)),
            Err(ControlError::Stopping) => Attempt::Stopping,
            Err(error) => Attempt::Waits(Why::Store(error.to_string())),
        }
    }

    fn status_of(&self, next: &Night, waits: Option<String>) -> ScheduleStatus {
        ScheduleStatus {
            at: self.schedule.at.format("%H:%M").to_string(),
            next_start: rfc3339(next.start_utc_ns),
            name: next.name.clone(),
            duration_s: self.schedule.duration.as_secs_f64(),
            waits,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::ManualClock;
    use crate::control::Command;
    use crate::store::{CaptureChange, CaptureState, NewCapture, StoreOptions};
    use std::sync::Mutex;

    /// 2027-01-15, 22:00 UTC.
    const START_NS: i64 = 1_800_050_400_000_000_000;
    const MINUTE_NS: i64 = 60_000_000_000;
    const HOUR: Duration = Duration::from_secs(3600);

    /// A scheduler of `at = "22:00"`, `duration = "5h"` in UTC, and a keeper with prescribed answers.
    struct World {
        scheduler: Scheduler,
        clock: Arc<ManualClock>,
        asked: Arc<Mutex<Vec<CaptureRequest>>>,
        refusal: Arc<Mutex<Option<ControlError>>>,
        _folder: tempfile::TempDir,
    }

    impl World {
        /// Creates a world whose machine has been running for an hour at `utc_ns`.
        fn at(utc_ns: i64) -> Self {
            let folder = tempfile::tempdir().unwrap();
            let clock = Arc::new(ManualClock::new(utc_ns - HOUR.as_nanos() as i64));
            clock.advance(HOUR);
            let options = StoreOptions { clock: Arc::clone(&clock) as Arc<dyn Clock>, ..StoreOptions::default() };
            let store = Store::open(&folder.path().join("vn100d.db"), options).unwrap();
            let (control, mut commands) = CaptureControl::pair();
            let (asked, refusal) = (Arc::new(Mutex::new(Vec::new())), Arc::new(Mutex::new(None)));
            let (theirs, answer, made_in) = (Arc::clone(&asked), Arc::clone(&refusal), store.clone());
            tokio::spawn(async move {
                while let Some(command) = commands.recv().await {
                    let Command::Start(request, reply) = command else { continue };
                    theirs.lock().unwrap().push(request.clone());
                    let refused: Option<ControlError> = answer.lock().unwrap().clone();
                    let made = match refused {
                        Some(error) => Err(error),
                        None => Ok(make(&made_in, &request.name.unwrap()).await),
                    };
                    reply.send(made).unwrap();
                }
            });
            let text = "[schedule]\nat = \"22:00\"\nduration = \"5h\"";
            let config = crate::config::parse(std::path::Path::new("x.toml"), text).unwrap();
            let scheduler = Scheduler {
                store,
                control,
                tap: Tap::default(),
                clock: Arc::clone(&clock) as Arc<dyn Clock>,
                zone: |_| 0,
                schedule: schedule(&config).unwrap(),
            };
            Self { scheduler, clock, asked, refusal, _folder: folder }
        }

        /// Does one look; returns the name of the displayed night, and why it waits.
        async fn look(&self, course: &mut Course) -> (String, Option<String>) {
            let (status, wait) = self.scheduler.look(course).await.unwrap();
            assert!(wait <= EVERY);
            let status = status.unwrap();
            (status.name, status.waits)
        }

        fn asked(&self) -> Vec<String> {
            self.asked.lock().unwrap().iter().filter_map(|request| request.name.clone()).collect()
        }
    }

    async fn make(store: &Store, name: &str) -> i64 {
        let mut capture = NewCapture::new("test", CaptureState::Capturing);
        capture.name = Some(name.to_owned());
        store.offload(move |store| store.create_capture(capture)).await.unwrap()
    }

    fn night(date: &str) -> String {
        format!("nightly-{date}")
    }

    #[tokio::test]
    async fn a_night_begins_at_its_hour_and_once() {
        let world = World::at(START_NS - MINUTE_NS / 2);
        let mut course = Course::default();
        let (status, wait) = world.scheduler.look(&mut course).await.unwrap();
        let status = status.unwrap();
        assert_eq!((status.at.as_str(), status.name), ("22:00", night("2027-01-15")));
        assert_eq!(status.next_start, "2027-01-15T22:00:00.000000000Z");
        assert!((status.duration_s - 18_000.0).abs() < f64::EPSILON && status.waits.is_none());
        assert_eq!(wait, Duration::from_secs(30), "to the hour itself");
        assert!(world.asked().is_empty());
        world.clock.advance(wait);
        for _ in 0..3 {
            assert_eq!(world.look(&mut course).await, (night("2027-01-16"), None));
        }
        let asked = world.asked.lock().unwrap().clone();
        let (name, duration) = (Some(night("2027-01-15")), 5 * HOUR);
        assert_eq!(asked, [CaptureRequest { duration, name, ..CaptureRequest::default() }]);
        // The next run of the daemon knows only the data in the database.
        assert_eq!(world.look(&mut Course::default()).await, (night("2027-01-16"), None));
        assert_eq!(world.asked().len(), 1);
    }

    #[tokio::test]
    async fn after_the_hour_a_night_still_begins_until_it_would_be_over() {
        for (late, begins) in [(4 * HOUR, true), (5 * HOUR, false)] {
            let world = World::at(START_NS + late.as_nanos() as i64);
            assert_eq!(world.look(&mut Course::default()).await, (night("2027-01-16"), None));
            assert_eq!(world.asked().len(), usize::from(begins), "{late:?}");
        }
    }

    #[tokio::test]
    async fn a_name_that_is_taken_is_a_night_that_is_done() {
        let world = World::at(START_NS);
        *world.refusal.lock().unwrap() = Some(ControlError::NameTaken(night("2027-01-15")));
        let mut course = Course::default();
        for _ in 0..2 {
            assert_eq!(world.look(&mut course).await, (night("2027-01-16"), None));
        }
        assert_eq!(world.asked().len(), 1);
    }

    #[tokio::test]
    async fn a_night_that_was_renamed_is_done() {
        let world = World::at(START_NS);
        assert_eq!(world.look(&mut Course::default()).await, (night("2027-01-16"), None));
        let rename = |store: &Store| {
            let id = store.reader()?.resolve(&night("2027-01-15"))?;
            let name = Some("on foam".to_owned());
            store.change_capture(id, CaptureChange { name, ..CaptureChange::default() })
        };
        world.scheduler.store.offload(rename).await.unwrap();
        // The next run of the daemon.
        assert_eq!(world.look(&mut Course::default()).await, (night("2027-01-16"), None));
        assert_eq!(world.asked(), [night("2027-01-15")]);
    }

    #[tokio::test]
    async fn a_mistaken_name_that_was_taken_back_skips_no_night() {
        let world = World::at(START_NS - MINUTE_NS);
        let id = make(&world.scheduler.store, "desk").await;
        let rename = move |store: &Store| {
            for name in [night("2027-01-15"), "desk".to_owned()] {
                store.change_capture(id, CaptureChange { name: Some(name), ..CaptureChange::default() })?;
            }
            store.set_state(id, CaptureState::Complete, START_NS)
        };
        world.scheduler.store.offload(rename).await.unwrap();
        world.clock.advance(Duration::from_secs(60));
        assert_eq!(world.look(&mut Course::default()).await, (night("2027-01-16"), None));
        assert_eq!(world.asked(), [night("2027-01-15")]);
    }

    #[tokio::test]
    async fn a_night_waits_for_another_capture_and_is_skipped_where_that_lasts_as_long() {
        let world = World::at(START_NS);
        *world.refusal.lock().unwrap() = Some(ControlError::Busy(7));
        let mut course = Course::default();
        for minute in 0..3 {
            let (name, waits) = world.look(&mut course).await;
            assert_eq!(name, night("2027-01-15"));
            assert!(waits.unwrap().starts_with("capture 7 runs or waits"), "{minute}");
            world.clock.advance(EVERY);
        }
        world.clock.advance(5 * HOUR);
        assert_eq!(world.look(&mut course).await, (night("2027-01-16"), None));
        assert_eq!(world.asked(), vec![night("2027-01-15"); 3]);
        // The next night can begin after a minute.
        world.clock.advance(19 * HOUR);
        assert_eq!(world.look(&mut course).await.0, night("2027-01-16"));
        *world.refusal.lock().unwrap() = None;
        world.clock.advance(EVERY);
        assert_eq!(world.look(&mut course).await, (night("2027-01-17"), None));
        assert_eq!(world.asked().len(), 5);
    }

    #[tokio::test]
    async fn a_clock_that_is_not_believed_begins_no_night() {
        // The machine woke in 1970, at 22:30.
        let world = World::at(HOUR.as_nanos() as i64 * 45 / 2);
        let mut course = Course::default();
        let (name, waits) = world.look(&mut course).await;
        assert_eq!(name, night("1970-01-01"));
        assert!(waits.unwrap().contains("so it was never set"));
        // A time server sets the clock: the night in progress begins late.
        world.clock.step_utc(START_NS + 10 * MINUTE_NS - world.clock.utc_ns());
        assert_eq!(world.look(&mut course).await, (night("2027-01-16"), None));
        assert_eq!(world.asked(), [night("2027-01-15")]);
        // The night ends, and then the clock is set two days back.
        world.clock.advance(Duration::from_secs(20 * 60));
        let since = START_NS + 30 * MINUTE_NS;
        let store = world.scheduler.store.clone();
        let ended = move |store: &Store| {
            let id = store.reader()?.resolve("nightly-2027-01-15")?;
            store.set_state(id, CaptureState::Complete, since)
        };
        store.offload(ended).await.unwrap();
        assert_eq!(world.look(&mut course).await, (night("2027-01-16"), None));
        world.clock.step_utc(-2 * 24 * 60 * MINUTE_NS);
        let (name, waits) = world.look(&mut course).await;
        assert_eq!(name, night("2027-01-13"));
        assert!(waits.unwrap().contains("set the clock"));
        assert_eq!(world.asked().len(), 1);
    }

    #[tokio::test]
    async fn a_machine_that_has_just_started_waits_for_its_time_server() {
        let world = World::at(START_NS);
        let clock = Arc::new(ManualClock::new(START_NS + 60 * MINUTE_NS));
        let scheduler = Scheduler { clock: Arc::clone(&clock) as Arc<dyn Clock>, ..world.scheduler.clone() };
        let mut course = Course::default();
        let (status, _) = scheduler.look(&mut course).await.unwrap();
        assert!(status.unwrap().waits.unwrap().contains("less than 5 minutes ago"));
        clock.advance(crate::schedule::SETTLING);
        let (status, _) = scheduler.look(&mut course).await.unwrap();
        assert_eq!(status.unwrap().waits, None);
        assert_eq!(world.asked(), [night("2027-01-15")]);
    }

    #[tokio::test]
    async fn it_ends_with_the_daemon() {
        let world = World::at(START_NS - MINUTE_NS);
        let (sender, mut status) = watch::channel(None);
        let stop = CancellationToken::new();
        let running = tokio::spawn(world.scheduler.clone().run(sender, stop.clone()));
        status.changed().await.unwrap();
        assert!(status.borrow().is_some());
        stop.cancel();
        tokio::time::timeout(Duration::from_secs(10), running).await.unwrap().unwrap();
    }
}
