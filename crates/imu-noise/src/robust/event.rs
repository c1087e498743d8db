//! Events: disturbances of a channel at a known time.

use crate::fit::Flag;

/// The kind of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, strum::IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum Kind {
    /// One to three samples far outside the noise.
    Spike,
    /// A short stretch of shaking.
    Knock,
    /// Two seconds of shaking or more.
    Handling,
    /// A level that changed and returned.
    Bump,
    /// A level that changed and stayed.
    Step,
}

impl Kind {
    /// Returns the name in JSON.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// An event; its samples are left out of the parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// The kind of the event.
    pub kind: Kind,
    /// The start, s since the start of the capture.
    pub from_s: f64,
    /// The end, s.
    pub to_s: f64,
    /// The event in one sentence.
    pub note: String,
}

impl Event {
    /// Returns the event in the form of the document.
    pub fn flag(&self) -> Flag {
        Flag {
            kind: self.kind.name().to_owned(),
            from_s: Some(milli(self.from_s)),
            to_s: Some(milli(self.to_s)),
            note: self.note.clone(),
        }
    }
}

/// Rounds a time to ms: no sample is shorter.
fn milli(time_s: f64) -> f64 {
    (time_s * 1e3).round() / 1e3
}

/// Merges intervals that touch or overlap, sorted by time.
pub(super) fn merged(mut intervals: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    intervals.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut merged: Vec<(f64, f64)> = Vec::new();
    for (from, to) in intervals {
        match merged.last_mut() {
            Some(last) if from <= last.1 => last.1 = last.1.max(to),
            _ => merged.push((from, to)),
        }
    }
    merged
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_that_touch_become_one() {
        assert_eq!(merged(vec![(5.0, 6.0), (1.0, 2.0), (2.0, 3.0), (5.5, 5.7)]), [(1.0, 3.0), (5.0, 6.0)]);
    }

    #[test]
    fn an_event_is_a_documented_flag() {
        let event = Event { kind: Kind::Knock, from_s: 78.900_04, to_s: 79.6, note: "…".into() };
        assert_eq!(
            serde_json::to_value(event.flag()).unwrap(),
            serde_json::json!({ "kind": "knock", "from_s": 78.9, "to_s": 79.6, "note": "…" })
        );
    }
}
