//! Recorder state: the capture that is recorded, the sensor's output, and the queue to the store.

use super::action::{Action, RecorderAction};
use super::host_watch::{set_back_unset, unset_before};
use super::recorder::Recorder;
use crate::observe::Tally;
use imu_core::sample::device_clock::ClockEstimate;
use imu_core::sample::{
    Accountant, ConnectedSensor, DiscardCause, EventKind, EventRecord, GapCause, RateDoubt, Record, Sample, Timebase,
};
use std::collections::VecDeque;
use std::time::Duration;
use vn100_proto::{BinaryAcceptance, MeasurementKind};

/// Places in the queue that samples never take, so that segments, gaps and events always find room.
const RESERVE: usize = 256;
/// The room that the accelerated reader waits for: more than one read can return.
const ROOM: usize = 8192;

/// The destination of records: a bounded queue that never makes the reader wait.
pub trait Sink: Send + Sync + 'static {
    /// Returns the number of records for which there is room now.
    fn room(&self) -> usize;
    /// Puts a record of this capture into the queue.
    ///
    /// # Errors
    /// The record, if the queue is full.
    fn put(&self, capture_id: i64, record: Record) -> Result<(), Box<Record>>;
    /// Returns whether the queue is no longer read.
    fn is_closed(&self) -> bool;
    /// Receives the counts of all received measurements by their state, before the counted records are put into the
    /// queue.
    fn tally(&self, _tally: Tally) {}
    /// Receives the bytes of the port as they were read, before they are decoded.
    fn bytes(&self, _bytes: &[u8]) {}
    /// Receives every measurement, whether a capture runs or not.
    fn seen(&self, _sample: &Sample) {}
    /// Receives the time by which the reader woke late.
    fn woke(&self, _late: Duration) {}
}

/// The present capture, the sensor's output, and the queue to the store.
pub(super) struct RecorderState {
    pub(super) recorder: Option<Recorder>,
    pub(super) accepted: Option<(MeasurementKind, f64)>,
    /// Whether the messages carry a serial count that increases by one.
    pub(super) counted: bool,
    /// The doubt about the rate that the arrivals raise, not yet passed to the session.
    pub(super) doubt: Option<RateDoubt>,
    /// While no capture runs: determines when the sensor's clock restarted, and whether the rate is the same.
    idle: Option<Accountant>,
    /// The number of streams accepted without a capture.
    idle_runs: i64,
    pub(super) description: Option<Box<ConnectedSensor>>,
    /// The number of samples of the capture when an unset clock was last set back.
    set_back_seq: Option<u64>,
    pub(super) sink: Box<dyn Sink>,
    /// Records for which there was no room; never samples.
    overflow: VecDeque<(i64, Record)>,
    out: Vec<Record>,
    /// The binary frames that the decoder must accept from the next read on, if they changed.
    pub(super) filter: Option<BinaryAcceptance>,
}

/// Returns the timebase of these measurements.
pub(super) fn timebase(kind: MeasurementKind, counted: bool) -> Timebase {
    match (kind.has_device_time(), counted) {
        (true, _) => Timebase::Device,
        (false, true) => Timebase::SyncCounter,
        (false, false) => Timebase::Arrival,
    }
}

impl RecorderState {
    /// Returns the state without a capture, whose records go into `sink`.
    pub(super) fn new(sink: Box<dyn Sink>) -> Self {
        Self {
            recorder: None,
            accepted: None,
            counted: false,
            doubt: None,
            idle: None,
            idle_runs: 0,
            description: None,
            set_back_seq: None,
            sink,
            overflow: VecDeque::new(),
            out: Vec::new(),
            filter: None,
        }
    }

    /// Performs the actions that concern the capture at once, in order, and leaves those that concern the port.
    pub(super) fn note(&mut self, actions: &mut Vec<Action>, utc_ns: i64) {
        for action in std::mem::take(actions) {
            match action {
                Action::Record(action) => self.apply(action, utc_ns),
                port => actions.push(port),
            }
        }
    }

    pub(super) fn apply(&mut self, action: RecorderAction, utc_ns: i64) {
        match action {
            RecorderAction::Accept(kind, rate_hz) => {
                self.accepted = Some((kind, rate_hz));
                // Random bytes can only be mistaken for a frame with the one expected header.
                self.filter = Some(match kind {
                    MeasurementKind::Binary(header) => BinaryAcceptance::Only(header),
                    MeasurementKind::Ascii(_) => BinaryAcceptance::Any,
                });
                match &mut self.recorder {
                    Some(recorder) => recorder.accept(rate_hz, timebase(kind, self.counted), &mut self.out),
                    None => {
                        self.idle_runs += 1;
                        self.idle = Some(Accountant::new(rate_hz, timebase(kind, self.counted)));
                    }
                }
            }
            RecorderAction::RateKnown(rate_hz) => match (&mut self.recorder, &mut self.idle) {
                (Some(recorder), _) => recorder.rate_known(rate_hz, &mut self.out),
                (None, Some(idle)) => idle.rate_known(rate_hz, &mut self.out),
                (None, None) => {}
            },
            RecorderAction::Counted(counted) => self.counted = counted,
            RecorderAction::AcceptAny => self.filter = Some(BinaryAcceptance::Any),
            RecorderAction::Interrupt(cause) => {
                self.filter = Some(BinaryAcceptance::Any);
                if let Some(recorder) = &mut self.recorder {
                    recorder.interrupt(cause, &mut self.out);
                }
            }
            RecorderAction::Event(kind, message) => {
                match kind {
                    EventKind::Warning | EventKind::SensorLost | EventKind::SensorError => {
                        tracing::warn!(%message, "sensor");
                    }
                    _ => tracing::info!(%message, "sensor"),
                }
                if self.recorder.is_some() {
                    self.out.push(Record::Event(EventRecord { utc_ns, kind, message, detail: None }));
                }
            }
            RecorderAction::Describe(description) => {
                if self.recorder.is_some() {
                    self.out.push(Record::Configuration(description.clone()));
                }
                self.description = Some(description);
            }
        }
        self.flush();
    }

    pub(super) fn begin(&mut self, mut recorder: Recorder) {
        if let Some((kind, rate_hz)) = self.accepted {
            recorder.accept(rate_hz, timebase(kind, self.counted), &mut self.out);
        }
        if let Some(description) = &self.description {
            self.out.push(Record::Configuration(description.clone()));
        }
        self.recorder = Some(recorder);
        self.set_back_seq = None;
        self.flush();
    }

    pub(super) fn sample(&mut self, sample: Sample) {
        self.sink.seen(&sample);
        let Some(recorder) = &mut self.recorder else {
            if let Some(idle) = &mut self.idle {
                idle.observe(sample, &mut self.out);
                idle.take_refused();
                self.doubt = idle.take_doubt().or(self.doubt);
                self.out.clear();
            }
            return;
        };
        if self.sink.room() <= RESERVE + self.out.len() {
            // The disk is too slow by more than the queue holds: this becomes a gap, whose length the sensor's clock
            // will determine.
            recorder.interrupt(GapCause::StorageBackpressure, &mut self.out);
            recorder.refuse(DiscardCause::StorageBackpressure);
            self.sink.tally(recorder.tally());
            return;
        }
        recorder.sample(sample, &mut self.out);
        self.doubt = recorder.take_doubt().or(self.doubt);
        if self.overflow.is_empty() {
            self.flush();
        } else {
            self.sink.tally(recorder.tally());
        }
    }

    /// Returns the present run of the sensor's clock, as the accounting numbers it: capture and epoch. Without a
    /// capture each accepted stream is a run: it may be of another unit, or of one that lost power.
    pub(super) fn clock_run(&self) -> (i64, u32) {
        match (&self.recorder, &self.idle) {
            (Some(recorder), _) => (recorder.plan().id, recorder.epoch().unwrap_or(0)),
            (None, idle) => (-self.idle_runs, idle.as_ref().map_or(0, Accountant::epoch)),
        }
    }

    pub(super) fn discard(&mut self, cause: DiscardCause, count: u64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.discard(cause, count);
        }
    }

    pub(super) fn refuse(&mut self, cause: DiscardCause) {
        if let Some(recorder) = &mut self.recorder {
            recorder.refuse(cause);
            self.sink.tally(recorder.tally());
        }
    }

    pub(super) fn blame_host(&mut self, cause: GapCause, until_mono_ns: u64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.blame_host(cause, until_mono_ns);
        }
    }

    /// Handles a step of civil time. The step is recorded; no count depends on it. If the host's clock had not been set
    /// before, the times written with it are corrected.
    pub(super) fn clock_stepped(&mut self, by_ns: i64, utc_ns: i64) {
        let before_utc_ns = unset_before(by_ns, utc_ns);
        let more = if before_utc_ns.is_some() {
            "; it had not been set, and what was recorded with it is corrected"
        } else {
            ""
        };
        let message = format!("the host's clock was stepped by {:+.3} s{more}", by_ns as f64 / 1e9);
        tracing::warn!(%message, "clock");
        if let Some(recorder) = &self.recorder {
            if let Some(before_utc_ns) = before_utc_ns {
                let (boot_id, since_seq) = (recorder.boot_id(), self.set_back_seq);
                self.out.push(Record::UtcSet { by_ns, before_utc_ns, boot_id, since_seq });
            } else if set_back_unset(by_ns, utc_ns) {
                self.set_back_seq = Some(recorder.counts().samples);
            }
            let filled = before_utc_ns.is_some();
            let detail = Some(serde_json::json!({"by_s": by_ns as f64 / 1e9, "utc_back_filled": filled}));
            self.out.push(Record::Event(EventRecord { utc_ns, kind: EventKind::ClockStep, message, detail }));
            self.flush();
        }
    }

    /// Records the estimate of the sensor's clock; returns `false` if there is no capture with samples.
    pub(super) fn device_clock(&mut self, estimate: ClockEstimate) -> bool {
        let Some(epoch) = self.recorder.as_ref().and_then(Recorder::epoch) else { return false };
        self.out.push(Record::DeviceClock { epoch, estimate });
        self.flush();
        true
    }

    pub(super) fn suspect(&mut self, cause: GapCause) {
        if let Some(recorder) = &mut self.recorder {
            recorder.suspect(cause);
        }
    }

    pub(super) fn tick(&mut self, mono_ns: u64, utc_ns: i64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.tick(mono_ns, utc_ns, &mut self.out);
        }
        self.flush();
    }

    pub(super) fn stop(&mut self, mono_ns: u64, utc_ns: i64) -> bool {
        let Some(recorder) = &mut self.recorder else { return false };
        recorder.stop(mono_ns, utc_ns, &mut self.out);
        true
    }

    /// Passes on the written records; returns `true` if the capture has ended.
    pub(super) fn settle(&mut self) -> bool {
        if let Some(recorder) = self.recorder.as_mut().filter(|recorder| recorder.has_ended()) {
            // These measurements arrived with the last one, but after the planned end.
            recorder.write_discards(&mut self.out);
        }
        self.flush();
        let ended = self.recorder.take_if(|recorder| recorder.has_ended()).is_some();
        if let (true, Some((kind, rate_hz))) = (ended, self.accepted) {
            self.idle = Some(Accountant::new(rate_hz, timebase(kind, self.counted)));
        }
        ended
    }

    /// Puts the records into the queue, in order; those without room wait (samples have reserved their room before).
    fn flush(&mut self) {
        if let Some(recorder) = &self.recorder {
            self.sink.tally(recorder.tally());
        }
        match self.recorder.as_ref().map(|recorder| recorder.plan().id) {
            Some(id) => {
                for record in self.out.drain(..) {
                    // While the disk refuses, every tick adds to the count of discards: one record grows instead of the
                    // queue.
                    if let (
                        Some((last_id, Record::Discarded { cause: last, count: total })),
                        Record::Discarded { cause, count },
                    ) = (self.overflow.back_mut(), &record)
                        && (*last_id, *last) == (id, *cause)
                    {
                        *total += count;
                        continue;
                    }
                    self.overflow.push_back((id, record));
                }
            }
            None => self.out.clear(),
        }
        while let Some((id, record)) = self.overflow.pop_front() {
            if let Err(record) = self.sink.put(id, record) {
                self.overflow.push_front((id, *record));
                break;
            }
        }
    }

    /// Waits until the queue has room for the records of one read.
    pub(super) async fn room(&self) {
        while self.sink.room() < ROOM && !self.sink.is_closed() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    /// Ends with the daemon: puts all records into the queue; an unfinished capture stays unfinished.
    pub(super) async fn close(&mut self) {
        if let Some(recorder) = &mut self.recorder {
            recorder.pause(&mut self.out);
        }
        self.flush();
        while !self.overflow.is_empty() && !self.sink.is_closed() {
            tokio::time::sleep(Duration::from_millis(5)).await;
            self.flush();
        }
    }
}
