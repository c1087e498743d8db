//! `vn100d diagnose --at-most` and `--at-least`: the quantities of a diagnosis that may be limited.

use super::limits::{Bound, Judged, Known, Limit, Verdict};
use imu_diagnosis::Diagnosis;
use imu_diagnosis::report::Verdict as Finding;

/// The names and the largest number of each: three gaps in nats a sample, two shares.
pub(super) const KNOWN: [Known; 5] = [
    ("gap", f64::INFINITY),
    ("after_parameters", f64::INFINITY),
    ("after", f64::INFINITY),
    ("closed", 1.0),
    ("remainder", 1.0),
];

/// Judges a diagnosis by the numbers that its document has; their intervals do not count.
pub(super) fn judge(limits: &[Limit], of: &Diagnosis) -> Vec<Judged> {
    limits.iter().map(|limit| judged(limit, of)).collect()
}

fn judged(limit: &Limit, of: &Diagnosis) -> Judged {
    let gap = &of.discrepancy;
    let (value, unit) = match limit.name.as_str() {
        "gap" => (Some(gap.before), &*gap.unit),
        "after_parameters" => (Some(gap.after_parameters), &*gap.unit),
        "after" => (Some(gap.after), &*gap.unit),
        "closed" => (gap.closed, ""),
        _ => (Some(of.remainder.as_ref().map_or(0.0, |left| left.share)), ""),
    };
    let value = value.filter(|value| value.is_finite());
    let (met, reason) = match value {
        Some(value) => (limit.holds(value), None),
        None if limit.name == "closed" => {
            let (met, reason) = unclosed(limit.bound, of);
            (met, Some(reason.to_owned()))
        }
        None => (false, Some("the record does not show it".to_owned())),
    };
    Judged {
        quantity: limit.name.clone(),
        bound: limit.bound,
        limit: limit.number,
        unit: unit.to_owned(),
        value,
        ci95: gap.closed_ci95.filter(|_| limit.name == "closed" && value.is_some()),
        verdict: if met { Verdict::Met } else { Verdict::Missed },
        reason,
    }
}

/// Returns whether a diagnosis that closed nothing satisfies a limit on what is closed, and why.
fn unclosed(bound: Bound, of: &Diagnosis) -> (bool, &'static str) {
    match (bound, of.verdict) {
        (Bound::AtMost, _) => (true, "no effect was added that closes a gap"),
        (Bound::AtLeast, Finding::NoGap | Finding::Parameters) => (true, "there was no gap for an effect to close"),
        (Bound::AtLeast, Finding::Effects) => (false, "the gap is too small to measure which part is closed"),
        (Bound::AtLeast, Finding::UnknownEffect) => (false, "no known effect was found that closes the gap"),
    }
}
