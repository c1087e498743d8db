//! The size of the gap: in total, and channel by channel down to the gap of a true model.

use super::super::escaped;
use super::super::figure::{part, plain};
use crate::plot::closing;
use imu_diagnosis::Diagnosis;
use imu_diagnosis::report::Discrepancy;
use std::fmt::Write as _;

/// The bars' minimum scale, as a multiple of a true model's gap.
const SCALE: f64 = 20.0;

/// Returns a bar of a length between 0 and 1, with a minimum width.
pub(super) fn bar(share: f64, class: &str) -> String {
    // A value that is not finite gets the minimum width.
    let width = if share.is_finite() { (100.0 * share).clamp(0.3, 100.0) } else { 0.3 };
    format!(
        "<svg viewBox=\"0 0 100 10\" preserveAspectRatio=\"none\" aria-hidden=\"true\">\
         <rect class=\"fill-{class}\" width=\"{width:.2}\" height=\"10\"/></svg>"
    )
}

pub(super) fn section(out: &mut String, gap: &Discrepancy) {
    let rows = [
        ("the model as it is", gap.before, "before"),
        ("its parameters corrected", gap.after_parameters, "parameters"),
        ("with what was found", gap.after, "after"),
        ("a true model shows", gap.floor, "floor"),
    ];
    // Without a gap the bars are short: the scale reaches at least to this multiple of a true model's gap.
    let least = SCALE * gap.floor.max(f64::MIN_POSITIVE);
    let most = rows.iter().map(|(_, value, _)| *value).fold(least, f64::max);
    let _ = write!(out, "<h2>The gap, in {}</h2><div class=\"bars\">", escaped(&gap.unit));
    for (name, value, class) in rows {
        let _ =
            write!(out, "<span>{name}</span>{}<span class=\"value\">{}</span>", bar(value / most, class), plain(value));
    }
    *out += "</div>";
    if let Some(closed) = gap.closed {
        let interval = gap
            .closed_ci95
            .map_or_else(String::new, |[low, high]| format!(" (95 % interval {} to {})", part(low), part(high)));
        let _ = write!(out, "<p>{} of the gap is closed{interval}.</p>", part(closed));
    }
    let chance = match gap.p_value_after {
        known if known.is_finite() => format!(" Chance that a true model leaves as much: {}.", plain(known)),
        _ => String::new(),
    };
    let _ = write!(out, "<p class=\"soft\">Measured on the {}.{chance}</p>", escaped(&gap.measured_on));
    let _ = write!(out, "<p class=\"soft\">{}</p>", escaped(super::NATS));
}

/// Writes one bar per channel.
pub(super) fn by_channel(out: &mut String, report: &Diagnosis) {
    let picture = closing(&report.per_channel, &report.discrepancy.unit);
    if !picture.is_empty() {
        let _ = write!(
            out,
            "<h2>By channel</h2><p class=\"soft\"><span class=\"key closed\"></span>closed by what was found\
             <span class=\"key after\"></span>what remains, down to the floor: what a true model shows.</p>\
             <figure class=\"slim\">{picture}</figure>"
        );
    }
}
