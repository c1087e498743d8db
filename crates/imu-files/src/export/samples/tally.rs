//! The samples and gaps of an exported stretch, as far as a file's description states them.

use super::rfc3339;
use imu_core::sample::Gap;

/// The maximum number of gaps that a file's description lists; the total number is stated separately.
pub const GAPS_LISTED: usize = 1000;

/// Counts of a stretch, and its first gaps.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tally {
    /// Number of samples.
    pub samples: u64,
    /// Number of samples missing between the first and the last one.
    pub missing: u64,
    /// The number of gaps.
    pub gaps: u64,
    listed: Vec<Gap>,
}

impl Tally {
    /// Returns a tally of this many samples, without gaps so far.
    pub fn of(samples: u64) -> Self {
        Self { samples, ..Self::default() }
    }

    /// Counts a gap between two samples of the stretch.
    pub fn gap(&mut self, gap: Gap) {
        self.missing += gap.missing;
        self.gaps += 1;
        if self.listed.len() < GAPS_LISTED {
            self.listed.push(gap);
        }
    }

    /// Returns the first gaps as a JSON list.
    pub(super) fn gaps_json(&self) -> String {
        let listed = self.listed.iter().map(|gap| {
            serde_json::json!({
                "from": rfc3339(gap.from_utc_ns), "to": rfc3339(gap.to_utc_ns), "before_seq": gap.before_seq,
                "missing": gap.missing, "missing_exact": gap.missing_exact, "cause": gap.cause.name(),
            })
        });
        serde_json::Value::Array(listed.collect()).to_string()
    }
}
