//! Rows of the database that tests show.

use crate::store::{CaptureRow, CaptureState, DiagnosisRow, JobKind, JobRow, JobState, UtcNs};
use imu_core::sample::Channel;
use serde_json::json;

/// 2026-11-23, 20:00:00 UTC.
pub(super) const BEGUN_NS: i64 = 1_795_464_000_000_000_000;

/// Returns a capture of five hours with text that must not become markup.
pub(super) fn capture() -> CaptureRow {
    let begun = UtcNs(BEGUN_NS + 500_000_000);
    CaptureRow {
        id: 7,
        name: "<script>alert(1)".to_owned(),
        note: Some("on <foam>, 23 °C".to_owned()),
        source: "/dev/ttyUSB0".to_owned(),
        state: CaptureState::Complete,
        created_at: begun,
        start_at: None,
        started_at: Some(begun),
        ended_at: Some(UtcNs(BEGUN_NS + 18_000_000_000_000)),
        planned_duration_s: Some(18_000.0),
        duration_s: 18_000.0,
        rate_hz: Some(40.0),
        rate_assumed: false,
        samples: 719_990,
        missing: 10,
        gaps: 1,
        segments: 2,
        rejected: [("checksum".to_owned(), 3)].into(),
        pinned: false,
        delete_at: None,
        channels: vec![Channel::GyroX, Channel::Temperature],
        units: [].into(),
        sensor: json!({"model": "VN-100T", "serial_number": "<42>"}).into(),
        configuration: json!({"baud": 115_200, "filter_window": {"gyro": "<4>"}}).into(),
        software: "vn100d 1".to_owned(),
    }
}

/// Returns a job over another capture.
pub(super) fn job(id: i64, kind: JobKind, state: JobState) -> JobRow {
    JobRow {
        id,
        kind,
        capture: 6,
        params: "{}".to_owned(),
        end_seq: 1,
        state,
        progress: 0.25,
        created_at: UtcNs(BEGUN_NS),
        started_at: None,
        finished_at: None,
        error: None,
        result_id: None,
        software: String::new(),
        stale: false,
    }
}

/// Returns a diagnosis.
pub(super) fn diagnosis(summary: &str) -> DiagnosisRow {
    let job = job(9, JobKind::Diagnosis, JobState::Done);
    DiagnosisRow { job, verdict: Some("effects".to_owned()), summary: Some(summary.to_owned()) }
}
