//! Pages: documents of the interfaces as HTML for people. Pure.
//!
//! In: a document's JSON text, as any program gets it, of this version or another. Out: one HTML file without anything from
//! elsewhere, readable on dark and on light, on paper and on a phone, and without scripts: [`SCRIPT`] only makes it move.
//! Promised: no text of a document becomes markup.

mod capture;
mod dashboard;
mod diagnosis;
mod figure;
mod series;
mod waiting;

pub use capture::{CaptureView, Figure, capture};
pub use dashboard::{DashboardView, Minute, Stored, dashboard, live};
pub use diagnosis::{Links, diagnosis, diagnosis_body};
pub use series::{SeriesView, series};
pub use waiting::waiting;

use crate::plot::escaped;

const STYLE: &str = include_str!("style.css");

/// What makes served pages move: it asks for the live part, sends wishes, and zooms.
pub const SCRIPT: &str = include_str!("page.js");
/// Where it is served.
pub const SCRIPT_PATH: &str = "/assets/page.js";

/// What a page is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// A file of its own, that is mailed and printed.
    File,
    /// A page of the daemon.
    Served,
    /// A page of the daemon that is asked for again after so many seconds, by those who have no scripts as well.
    Renewed(u32),
    /// A page of the daemon that scripts keep up to date; others ask again after so many seconds.
    Live(u32),
    /// The same for a page that waits for something: scripts ask again until it is there.
    Waiting(u32),
}

/// Begins what may be wider than the window: it scrolls by itself, by keys as well, and says what it is.
fn wide(label: &str) -> String {
    format!("<div class=\"wide\" role=\"group\" tabindex=\"0\" aria-label=\"{label}\">")
}

/// The whole file around what is to be seen.
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
            "<header class=\"top\"><a href=\"/\">vn100d</a></header>",
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
