//! Notice: one message, as data, as a sentence and in the form for receivers.

use crate::clock::rfc3339;
use crate::observe::{NotifyEvent, PlannedDeletion, SensorStatus, StorageStatus};
use imu_core::sample::Gap;
use imu_core::units::counted;
use serde::Serialize;

/// Name and version of the JSON's form.
pub const FORMAT: &str = "vn100d-notice-1";

/// The sender in every message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sender {
    /// The machine's name.
    pub host: String,
    /// The database; it distinguishes several daemons of one machine.
    pub database: String,
}

/// A capture in a message.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CaptureFacts {
    /// Its id.
    pub id: i64,
    /// Its name.
    pub name: String,
    /// Its state.
    pub state: String,
    /// Sample time so far, s.
    pub duration_s: f64,
    /// Number of samples received.
    pub samples: u64,
    /// Number of samples missing.
    pub missing: u64,
    /// Number of gaps.
    pub gaps: u64,
}

/// The facts about a gap in a message.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GapFacts {
    /// Last sample before it, RFC 3339.
    pub from: String,
    /// First sample after it, RFC 3339; null while it is open.
    pub to: Option<String>,
    /// Samples missing; in all gaps if the message covers several. Null while the gap is open.
    pub missing: Option<u64>,
    /// The cause. Null while the gap is open.
    pub cause: Option<&'static str>,
    /// Its length, s; null while it is open.
    pub length_s: Option<f64>,
}

impl GapFacts {
    /// Returns a gap that is over.
    pub fn closed(gap: &Gap) -> Self {
        Self {
            from: rfc3339(gap.from_utc_ns),
            to: Some(rfc3339(gap.to_utc_ns)),
            missing: Some(gap.missing),
            cause: Some(gap.cause.name()),
            length_s: Some((gap.to_utc_ns - gap.from_utc_ns) as f64 / 1e9),
        }
    }
    /// Returns a gap that is open.
    pub fn open(since: &str) -> Self {
        Self { from: since.to_owned(), to: None, missing: None, cause: None, length_s: None }
    }
}

/// A night of the schedule in a message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NightFacts {
    /// The name that its capture would have had.
    pub name: String,
    /// The reason why it was not recorded.
    pub reason: String,
}

/// One message, or several of a kind combined.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Notice {
    /// The event.
    pub event: NotifyEvent,
    /// The time of the event, UTC ns; of several the last.
    #[serde(skip)]
    pub utc_ns: i64,
    /// The time of the first event, if there are several, UTC ns.
    #[serde(skip)]
    pub first_utc_ns: i64,
    /// The number of events that it covers.
    pub count: u64,
    /// The capture it concerns.
    pub capture: Option<CaptureFacts>,
    /// The gap; of several the last, with the samples missing in all.
    pub gap: Option<GapFacts>,
    /// The sensor.
    pub sensor: Option<SensorStatus>,
    /// The store.
    pub storage: Option<StorageStatus>,
    /// The planned deletions: the first of them, at most [`DELETIONS_NAMED`].
    pub deletions: Vec<PlannedDeletion>,
    /// The number of planned deletions.
    pub deletions_total: u64,
    /// The night that was skipped.
    pub night: Option<NightFacts>,
}

/// The maximum number of deletions listed. A message thus fits into a pipe and an environment variable however many
/// captures it covers.
pub const DELETIONS_NAMED: usize = 20;

/// The message in the form for receivers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// The event's name.
    pub event: &'static str,
    /// The JSON.
    pub body: String,
    /// The same data for a shell script: names and values of environment variables.
    pub environment: Vec<(&'static str, String)>,
}

impl Notice {
    /// Creates a message of this event, with nothing else set.
    pub fn new(event: NotifyEvent, utc_ns: i64) -> Self {
        Self {
            event,
            utc_ns,
            first_utc_ns: utc_ns,
            count: 1,
            capture: None,
            gap: None,
            sensor: None,
            storage: None,
            deletions: Vec::new(),
            deletions_total: 0,
            night: None,
        }
    }

    /// Combines a later message of the same kind with this one.
    pub fn take_in(&mut self, later: Self) {
        let missing = |gap: &Option<GapFacts>| gap.as_ref().and_then(|gap| gap.missing);
        let sum = match (missing(&self.gap), missing(&later.gap)) {
            (Some(before), Some(now)) => Some(before + now),
            (before, now) => before.or(now),
        };
        let (count, first_utc_ns) = (self.count + later.count, self.first_utc_ns);
        let deletions_total = self.deletions_total + later.deletions_total;
        let mut deletions = std::mem::take(&mut self.deletions);
        deletions.extend_from_slice(&later.deletions);
        deletions.truncate(DELETIONS_NAMED);
        *self = Self { count, first_utc_ns, deletions, deletions_total, ..later };
        if let Some(gap) = &mut self.gap {
            gap.missing = sum;
        }
    }

    /// Returns one sentence for the user.
    pub fn message(&self) -> String {
        let capture = self
            .capture
            .as_ref()
            .map_or("no capture".to_owned(), |capture| format!("capture {} ({})", capture.id, capture.name));
        let first = rfc3339(self.first_utc_ns);
        match self.event {
            NotifyEvent::CaptureCompleted => match &self.capture {
                Some(facts) => format!(
                    "{capture} is complete: {}, {} missing in {}",
                    counted(facts.samples, "sample", "samples"),
                    facts.missing,
                    counted(facts.gaps, "gap", "gaps")
                ),
                None => "a capture is complete".to_owned(),
            },
            NotifyEvent::GapOpened if self.count > 1 => {
                format!("{capture}: samples stopped {} times since {first}", self.count)
            }
            NotifyEvent::GapOpened => {
                let since = self.gap.as_ref().map_or(first, |gap| gap.from.clone());
                format!("{capture}: no samples since {since}")
            }
            NotifyEvent::GapClosed => {
                let gap = self.gap.as_ref();
                let missing = gap.and_then(|gap| gap.missing).unwrap_or(0);
                let cause = gap.and_then(|gap| gap.cause).unwrap_or("not known");
                if self.count > 1 {
                    let count = self.count;
                    format!("{capture}: {count} gaps since {first}, {missing} samples missing, the last: {cause}")
                } else {
                    let length_s = gap.and_then(|gap| gap.length_s).unwrap_or(0.0);
                    format!("{capture}: samples come again, {missing} missing in {length_s:.1} s: {cause}")
                }
            }
            NotifyEvent::StorageLow | NotifyEvent::StorageOk => self.storage_message(),
            NotifyEvent::SensorLost | NotifyEvent::SensorBack => {
                let lost = self.event == NotifyEvent::SensorLost;
                let times =
                    if self.count > 1 { format!(" ({} times since {first})", self.count) } else { String::new() };
                let hint = self.sensor.as_ref().and_then(|sensor| sensor.hint.clone()).filter(|_| lost);
                let hint = hint.map(|hint| format!(": {hint}")).unwrap_or_default();
                let what = if lost { "the sensor is lost" } else { "the sensor sends again" };
                format!("{capture}: {what}{times}{hint}")
            }
            NotifyEvent::DeletionPlanned => {
                let names: Vec<String> = self
                    .deletions
                    .iter()
                    .map(|planned| {
                        let PlannedDeletion { capture, name, reason, delete_at, .. } = planned;
                        format!("{capture} ({name}) on {delete_at}, for its {reason}")
                    })
                    .collect();
                let more = self.deletions_total.saturating_sub(self.deletions.len() as u64);
                let more = if more > 0 { format!("; and {more} more (/v1/status)") } else { String::new() };
                format!("captures are going to be deleted unless they are pinned: {}{more}", names.join("; "))
            }
            NotifyEvent::NightSkipped => match &self.night {
                Some(NightFacts { name, reason }) => format!("the night {name} was not recorded: {reason}"),
                None => "a night was not recorded".to_owned(),
            },
            NotifyEvent::Test => "this is a test: notifications arrive".to_owned(),
        }
    }

    fn storage_message(&self) -> String {
        let Some(storage) = &self.storage else { return "storage".to_owned() };
        let free = storage.free_bytes >> 20;
        let state = storage.state.name();
        if self.event == NotifyEvent::StorageOk {
            return format!("storage is well again: {free} MiB free");
        }
        let lasts =
            storage.time_to_full_s.map(|left_s| format!(", full in {:.1} h", left_s / 3600.0)).unwrap_or_default();
        let error = storage.error.as_ref().map(|error| format!(": {error}")).unwrap_or_default();
        format!("storage runs low: {free} MiB free{lasts}, state {state}{error}")
    }

    /// Returns the message in the form for receivers.
    pub fn rendered(&self, sender: &Sender) -> Message {
        let (message, at) = (self.message(), rfc3339(self.utc_ns));
        // A serialisation of texts and finite numbers cannot fail.
        let mut body = serde_json::to_value(self).unwrap_or_default();
        if let Some(object) = body.as_object_mut() {
            let more = [
                ("format", FORMAT.into()),
                ("message", message.as_str().into()),
                ("at", at.as_str().into()),
                ("first_at", rfc3339(self.first_utc_ns).into()),
                ("host", sender.host.as_str().into()),
                ("database", sender.database.as_str().into()),
                ("software", concat!("vn100d ", env!("CARGO_PKG_VERSION")).into()),
            ];
            object.extend(more.map(|(name, value): (_, serde_json::Value)| (name.to_owned(), value)));
        }
        let mut environment = vec![
            ("VN100D_EVENT", self.event.name().to_owned()),
            ("VN100D_EVENT_AT", at),
            ("VN100D_EVENT_COUNT", self.count.to_string()),
            ("VN100D_EVENT_HOST", sender.host.clone()),
        ];
        if let Some(capture) = &self.capture {
            environment.push(("VN100D_EVENT_CAPTURE", capture.id.to_string()));
            environment.push(("VN100D_EVENT_CAPTURE_NAME", capture.name.clone()));
        }
        environment.push(("VN100D_EVENT_MESSAGE", message));
        // The system does not accept a zero byte in a variable.
        for (_, value) in &mut environment {
            value.retain(|character| character != '\0');
        }
        Message { event: self.event.name(), body: body.to_string(), environment }
    }
}
