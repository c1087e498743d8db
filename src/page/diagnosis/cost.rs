//! The cost of the gap: error growth before and after, and the part of each cause.

use super::super::{escaped, wide};
use super::gap::bar;
use crate::plot;
use imu_core::units::format_duration;
use imu_cost::Quantity;
use imu_diagnosis::Diagnosis;
use imu_diagnosis::report::{Bands, GapCost, MeasuredGrowth, MeasuredPieces};
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
    if let Some(measured) = &cost.measured {
        pieces(out, measured);
    }
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

/// The quantities of the gyroscope's pictures and of the accelerometer's.
const TRIADS: [(&str, &[Quantity]); 2] = [
    ("Gyroscope", &[Quantity::AttitudeX, Quantity::AttitudeY, Quantity::Heading]),
    ("Accelerometer", &[Quantity::VelocityX, Quantity::VelocityY, Quantity::PositionX, Quantity::PositionY]),
];

/// Writes what pieces of the recording show beside the predictions: a picture for each quantity and a table of coverage, per triad.
fn pieces(out: &mut String, measured: &MeasuredGrowth) {
    let known =
        |of: &&Quantity| measured.quantities.get(&of.to_string()).is_some_and(|of| of.iter().any(Option::is_some));
    for (triad, quantities) in TRIADS {
        let quantities: Vec<&Quantity> = quantities.iter().filter(known).collect();
        if quantities.is_empty() {
            continue;
        }
        let _ = write!(
            out,
            "<h3>{triad}: growth of errors in pieces of the recording</h3><p class=\"soft\"><span class=\"key real\"></span>pieces \
             of the recording, with the 95&nbsp;% interval<span class=\"key before\"></span>the model as it is\
             <span class=\"key after\"></span>the corrected model</p><div class=\"figures\">"
        );
        for quantity in &quantities {
            let _ = write!(out, "<figure>{}</figure>", picture(measured, **quantity));
        }
        *out += "</div>";
        coverage(out, measured, &quantities);
    }
    for note in &measured.notes {
        let _ = write!(out, "<p class=\"soft\">{}</p>", escaped(note));
    }
}

fn picture(measured: &MeasuredGrowth, quantity: Quantity) -> String {
    let (factor, unit) = quantity.shown_in();
    let of = &measured.quantities[&quantity.to_string()];
    let shown = |number: &dyn Fn(&MeasuredPieces) -> f64| -> Vec<f64> {
        of.iter().map(|pieces| pieces.as_ref().map_or(f64::NAN, |pieces| factor * number(pieces))).collect()
    };
    let measured_with_ends = of.iter().map(|pieces| {
        pieces.as_ref().map_or([f64::NAN; 3], |of| [of.rms, of.rms_ci95[0], of.rms_ci95[1]].map(|value| factor * value))
    });
    plot::growth(&plot::Growth {
        title: &quantity.to_string().replace('_', " "),
        unit,
        horizons_s: measured.horizons_s.clone(),
        measured: measured_with_ends.collect(),
        predicted: vec![("before", shown(&|of| of.before_rms)), ("after", shown(&|of| of.after_rms))],
    })
}

/// Writes the share of pieces inside both models' bands; a true model's has 95 %.
fn coverage(out: &mut String, measured: &MeasuredGrowth, quantities: &[&Quantity]) {
    let percent = |share: f64| if share.is_finite() { format!("{:.0}", 100.0 * share) } else { "–".to_owned() };
    *out += "<p class=\"soft\">Pieces inside the 95&nbsp;% band of the model as it is → of the corrected model:</p>";
    *out += &wide("pieces inside the band");
    *out += "<table><tr><th scope=\"col\">after</th>";
    for quantity in quantities {
        let _ = write!(out, "<th scope=\"col\" class=\"number\">{}</th>", quantity.to_string().replace('_', " "));
    }
    *out += "</tr>";
    for (at, horizon_s) in measured.horizons_s.iter().enumerate() {
        let _ = write!(out, "<tr><th scope=\"row\">{}</th>", time(*horizon_s));
        for quantity in quantities {
            let pieces = measured.quantities[&quantity.to_string()].get(at).and_then(Option::as_ref);
            let cell = pieces.map_or_else(
                || "–".to_owned(),
                |of| {
                    let [low, high] = of.after_coverage_ci95.map(percent);
                    let (before, after) = (percent(of.before_coverage), percent(of.after_coverage));
                    format!("{before} → {after}&nbsp;% <span class=\"interval\">({low} to {high})</span>")
                },
            );
            let _ = write!(out, "<td class=\"number\">{cell}</td>");
        }
        *out += "</tr>";
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
