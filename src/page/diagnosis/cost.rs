//! The cost of the gap: error growth before and after, and the part of each cause.

use super::super::{escaped, wide};
use super::gap::bar;
use imu_core::units::format_duration;
use imu_cost::Quantity;
use imu_diagnosis::Diagnosis;
use imu_diagnosis::report::{Bands, GapCost};
use std::fmt::Write as _;
use std::time::Duration;

/// Shares below this have no bar.
const SHOWN_FROM: f64 = 0.01;

/// Writes the section, if the report has a cost.
pub(super) fn section(out: &mut String, report: &Diagnosis) {
    let Some(cost) = report.discrepancy.cost.as_ref().filter(|of| !of.quantities.is_empty()) else { return };
    // Writing to a text cannot fail.
    let _ = write!(
        out,
        "<h2>What it costs without aid</h2><p class=\"soft\">The size of an error of unaided integration stays below this in \
         95&nbsp;%: at rest, after {} of alignment. In brackets what the intervals of the corrected model's numbers allow.</p>",
        time(cost.align_s)
    );
    bands(out, cost);
    causes(out, report, cost);
    for note in &cost.notes {
        let _ = write!(out, "<p class=\"soft\">{}</p>", escaped(note));
    }
}

fn time(time_s: f64) -> String {
    Duration::try_from_secs_f64(time_s).map_or_else(|_| "–".to_owned(), format_duration)
}

/// Returns the quantities of a cost that this version knows, in the order of a document.
fn known(cost: &GapCost) -> impl Iterator<Item = (Quantity, &Bands)> {
    Quantity::all().iter().filter_map(|of| Some((*of, cost.quantities.get(&of.to_string())?)))
}

fn bands(out: &mut String, cost: &GapCost) {
    *out += &wide("what the gap costs");
    *out += "<table><tr><th scope=\"col\">error</th><th scope=\"col\">under</th>";
    for horizon_s in &cost.horizons_s {
        let _ = write!(out, "<th scope=\"col\" class=\"number\">after {}</th>", time(*horizon_s));
    }
    *out += "</tr>";
    for (quantity, of) in known(cost) {
        let rows = [
            ("the model as it is", &of.before, None),
            ("the corrected model", &of.after, of.after_ci95.as_ref()),
            ("without the causes", &of.floor, of.floor_ci95.as_ref()),
        ];
        for (place, (name, values, ends)) in rows.into_iter().enumerate() {
            let first = match place {
                0 => format!("<th scope=\"row\" rowspan=\"3\">{}</th>", quantity.to_string().replace('_', " ")),
                _ => String::new(),
            };
            let _ = write!(out, "<tr>{first}<td>{name}</td>");
            for (index, value) in values.iter().enumerate() {
                let ends = ends.and_then(|of| of.get(index)).map_or_else(String::new, |[low, high]| {
                    format!(" ({} to {})", quantity.with_unit(*low), quantity.with_unit(*high))
                });
                let _ = write!(out, "<td class=\"number\">{}{ends}</td>", quantity.with_unit(*value));
            }
            *out += "</tr>";
        }
    }
    *out += "</table></div>";
}

/// Writes a bar for each cause: its part in the mean square error at the last horizon.
fn causes(out: &mut String, report: &Diagnosis, cost: &GapCost) {
    let mut rows = String::new();
    for (quantity, _) in known(cost) {
        for cause in &report.causes {
            let share = cause.cost.get(&quantity.to_string()).and_then(|of| of.share.last().copied());
            let Some(share) = share.filter(|share| *share >= SHOWN_FROM) else { continue };
            let _ = write!(
                rows,
                "<span>{}: {}</span>{}<span class=\"value\">{:.0}&nbsp;%</span>",
                quantity.to_string().replace('_', " "),
                escaped(&cause.effect.name().replace('_', " ")),
                bar(share, "before"),
                100.0 * share
            );
        }
    }
    if let Some(last) = cost.horizons_s.last().filter(|_| !rows.is_empty()) {
        let _ = write!(
            out,
            "<p class=\"soft\">The causes' parts in the mean square error after {}:</p><div class=\"bars\">{rows}</div>",
            time(*last)
        );
    }
}
