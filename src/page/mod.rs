//! Pages: documents of the interfaces as HTML for users. Pure.
//!
//! In: documents. Out: one HTML file without external resources, readable on dark and on light, on paper and on a phone.
//! It needs no scripts: [`SCRIPT`] only updates it. Guarantee: no text of a document becomes markup.

mod capture;
mod comparison;
mod dashboard;
mod diagnosis;
mod figure;
mod list;
mod picture;
mod refusal;
#[cfg(test)]
mod rows;
mod series;
mod validation;
mod waiting;

pub use capture::{CaptureView, Facts, Served, capture};
pub use comparison::{ComparisonView, PAIRS, Side, choice, comparison, order};
pub use dashboard::{DashboardView, Stored, dashboard, live};
pub use diagnosis::{Links, NATS, SURE, advice, closes, diagnosis, diagnosis_body};
pub use figure::{digits, part, span};
pub use list::{ListView, SEARCH_MAX, captures, diagnoses, jobs, models};
pub use picture::Figure;
pub use refusal::{RefusalView, refusal};
pub use series::{SeriesView, series};
pub use validation::validation;
pub use waiting::waiting;

use crate::plot::escaped;

const STYLE: &str = include_str!("style.css");

/// The script of served pages: it fetches the live part, sends requests, and zooms.
pub const SCRIPT: &str = include_str!("page.js");
/// The path at which it is served.
pub const SCRIPT_PATH: &str = "/assets/page.js";

/// The purpose of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// A standalone file that is mailed and printed.
    File,
    /// A page of the daemon.
    Served,
    /// A page of the daemon that is reloaded after this many seconds, also without scripts.
    Renewed(u32),
    /// A page of the daemon that scripts keep up to date; without them it is reloaded after this many seconds.
    Live(u32),
    /// A page that waits for a result: scripts repeat the request until it exists; without them the page is reloaded
    /// after this many seconds.
    Waiting(u32),
}

/// Begins content that may be wider than the window: it scrolls separately, also by keyboard, and has a label.
fn wide(label: &str) -> String {
    format!("<div class=\"wide\" role=\"group\" tabindex=\"0\" aria-label=\"{label}\">")
}

/// Returns the whole file around the visible content.
fn framed(title: &str, kind: Kind, body: &str) -> String {
    let again = |s: u32| format!("<meta http-equiv=\"refresh\" content=\"{s}\">");
    let refresh = match kind {
        Kind::File | Kind::Served => String::new(),
        Kind::Renewed(s) => again(s),
        Kind::Live(s) | Kind::Waiting(s) => format!("<noscript>{}</noscript>", again(s)),
    };
    let (script, top) = match kind {
        Kind::File => (String::new(), ""),
        _ => (
            format!("<script src=\"{SCRIPT_PATH}\" defer></script>"),
            "<header class=\"top\"><a href=\"/\">vn100d</a><nav aria-label=\"lists\"><a href=\"/captures\">captures</a>\
             <a href=\"/diagnoses\">diagnoses</a><a href=\"/jobs\">jobs</a><a href=\"/models\">models</a></nav></header>",
        ),
    };
    let waits = if let Kind::Waiting(s) = kind { format!(" data-waits=\"{s}\"") } else { String::new() };
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{}</title>\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <meta name=\"color-scheme\" content=\"light dark\"><link rel=\"icon\" href=\"data:,\">{refresh}\
         <style>{}{STYLE}</style>{script}</head>\n<body>{top}<main{waits}>{body}</main></body></html>\n",
        escaped(title),
        crate::plot::style()
    )
}
