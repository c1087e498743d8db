//! Watch: determines which events are reported. Pure: status snapshots and times in, notices out.

use super::notice::{CaptureFacts, DELETIONS_NAMED, GapFacts, NightFacts, Notice};
use crate::observe::{CaptureStatus, NotifyEvent, PlannedDeletion, SensorState, Status, StorageState, StorageStatus};
use imu_core::sample::Gap;
use std::time::Duration;

/// A disk that refuses writes is reported when it has done so for this long: a checkpoint's or a backup's lock passes.
const TROUBLE_NS: u64 = 5_000_000_000;
/// Space that lasts less than the first value is low, s; it is sufficient again only when it lasts an hour longer.
const LASTS_S: (f64, f64) = (12.0 * 3600.0, 13.0 * 3600.0);

/// The limits for a lost sensor and for low space.
#[derive(Debug, Clone, PartialEq)]
pub struct WatchOptions {
    /// The minimum absence of the sensor.
    pub sensor_lost_after: Duration,
    /// Free space below this is low, bytes.
    pub reserve_bytes: u64,
}

/// An event that the status does not show.
#[derive(Debug, Clone)]
pub enum Sign {
    /// A gap of this capture is closed.
    Gap(i64, Gap),
    /// A capture is complete and on disk.
    Ended(CaptureFacts),
    /// Deletions of captures are planned.
    Deletions(Vec<PlannedDeletion>),
    /// A night of the schedule was not recorded.
    Skipped(NightFacts),
}

/// Compares each snapshot with the events reported before.
#[derive(Debug)]
pub struct Watcher {
    options: WatchOptions,
    /// The capture of the last snapshot.
    capture: Option<CaptureFacts>,
    /// The reported open gap: its capture and beginning.
    gap: Option<(i64, String)>,
    /// The time since which the sensor has been absent while a capture needs it.
    away_since_ns: Option<u64>,
    lost: bool,
    /// The time since which the disk has refused writes.
    trouble_since_ns: Option<u64>,
    low: bool,
}

impl Watcher {
    /// Creates a watcher that has seen no snapshot.
    pub fn new(options: WatchOptions) -> Self {
        Self { options, capture: None, gap: None, away_since_ns: None, lost: false, trouble_since_ns: None, low: false }
    }

    /// Returns the notices that follow from a snapshot at monotonic `now_ns`.
    pub fn observe(&mut self, now_ns: u64, utc_ns: i64, status: &Status) -> Vec<Notice> {
        let mut notices = Vec::new();
        self.capture = status.capture.as_ref().map(facts);
        self.gap(utc_ns, status, &mut notices);
        self.sensor(now_ns, utc_ns, status, &mut notices);
        self.storage(now_ns, utc_ns, &status.storage, &mut notices);
        notices
    }

    /// Returns the notices that follow from a sign.
    pub fn sign(&mut self, utc_ns: i64, sign: Sign) -> Vec<Notice> {
        match sign {
            Sign::Gap(capture_id, gap) => {
                let mut notice = Notice::new(NotifyEvent::GapClosed, utc_ns);
                notice.capture = self.capture.clone().filter(|capture| capture.id == capture_id).or_else(|| {
                    let (name, state) = (capture_id.to_string(), "capturing".to_owned());
                    let (duration_s, samples) = (0.0, gap.before_seq);
                    Some(CaptureFacts {
                        id: capture_id,
                        name,
                        state,
                        duration_s,
                        samples,
                        missing: gap.missing,
                        gaps: 1,
                    })
                });
                notice.gap = Some(GapFacts::closed(&gap));
                vec![notice]
            }
            Sign::Ended(capture) => {
                let mut notice = Notice::new(NotifyEvent::CaptureCompleted, utc_ns);
                notice.capture = Some(capture);
                vec![notice]
            }
            Sign::Deletions(planned) => {
                let mut notice = Notice::new(NotifyEvent::DeletionPlanned, utc_ns);
                notice.deletions_total = planned.len() as u64;
                notice.deletions = planned;
                notice.deletions.truncate(DELETIONS_NAMED);
                vec![notice]
            }
            Sign::Skipped(night) => {
                let mut notice = self.notice(NotifyEvent::NightSkipped, utc_ns);
                notice.night = Some(night);
                vec![notice]
            }
        }
    }

    fn notice(&self, event: NotifyEvent, utc_ns: i64) -> Notice {
        let mut notice = Notice::new(event, utc_ns);
        notice.capture.clone_from(&self.capture);
        notice
    }

    fn gap(&mut self, utc_ns: i64, status: &Status, notices: &mut Vec<Notice>) {
        let open = status.capture.as_ref().and_then(|capture| Some((capture.id, capture.gap_open_since.clone()?)));
        if let Some((_, since)) = open.as_ref().filter(|open| self.gap.as_ref() != Some(*open)) {
            let mut notice = self.notice(NotifyEvent::GapOpened, utc_ns);
            notice.gap = Some(GapFacts::open(since));
            notice.sensor = Some(status.sensor.clone());
            notices.push(notice);
        }
        self.gap = open;
    }

    fn sensor(&mut self, now_ns: u64, utc_ns: i64, status: &Status, notices: &mut Vec<Notice>) {
        let here = status.sensor.state == SensorState::Streaming;
        let event = if here {
            self.away_since_ns = None;
            std::mem::take(&mut self.lost).then_some(NotifyEvent::SensorBack)
        } else if status.capture.is_none() {
            // The absence of a sensor that no capture needs is not reported; the return of a lost one still is.
            self.away_since_ns = None;
            None
        } else {
            let since_ns = *self.away_since_ns.get_or_insert(now_ns);
            let long = now_ns.saturating_sub(since_ns) >= self.options.sensor_lost_after.as_nanos() as u64;
            let new = long && !self.lost;
            self.lost |= long;
            new.then_some(NotifyEvent::SensorLost)
        };
        if let Some(event) = event {
            let mut notice = self.notice(event, utc_ns);
            notice.sensor = Some(status.sensor.clone());
            notices.push(notice);
        }
    }

    fn storage(&mut self, now_ns: u64, utc_ns: i64, storage: &StorageStatus, notices: &mut Vec<Notice>) {
        // Before the first measurement nothing is known.
        if storage.database.is_empty() {
            return;
        }
        if matches!(storage.state, StorageState::Ok | StorageState::Slow) {
            self.trouble_since_ns = None;
        } else {
            self.trouble_since_ns.get_or_insert(now_ns);
        }
        let troubled = self.trouble_since_ns.is_some_and(|since_ns| now_ns.saturating_sub(since_ns) >= TROUBLE_NS);
        let reserve = self.options.reserve_bytes as f64;
        let (floor, lasts_s) = if self.low { (1.1 * reserve, LASTS_S.1) } else { (reserve, LASTS_S.0) };
        let short =
            (storage.free_bytes as f64) < floor || storage.time_to_full_s.is_some_and(|left_s| left_s < lasts_s);
        // While the disk refuses writes, nothing shows that it is well.
        let low = troubled || short || (self.low && self.trouble_since_ns.is_some());
        if low != self.low {
            self.low = low;
            let event = if low { NotifyEvent::StorageLow } else { NotifyEvent::StorageOk };
            let mut notice = self.notice(event, utc_ns);
            notice.storage = Some(storage.clone());
            notices.push(notice);
        }
    }
}

fn facts(capture: &CaptureStatus) -> CaptureFacts {
    CaptureFacts {
        id: capture.id,
        name: capture.name.clone(),
        state: capture.state.clone(),
        duration_s: capture.elapsed_s,
        samples: capture.samples,
        missing: capture.missing,
        gaps: capture.gaps,
    }
}
