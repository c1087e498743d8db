//! Pages: documents of the interfaces as HTML for people. Pure.
//!
//! In: a document's JSON text, as any program gets it, of this version or another. Out: one HTML file without scripts or
//! anything from elsewhere, readable on dark and on light. Promised: no text of a document becomes markup.

mod diagnosis;
mod figure;
mod waiting;

pub use diagnosis::{Links, Pictures, diagnosis};
pub use waiting::waiting;

use crate::plot::escaped;

const STYLE: &str = include_str!("style.css");

/// The whole file around what is to be seen; `refresh_s` has a browser ask again.
fn framed(title: &str, refresh_s: Option<u32>, body: &str) -> String {
    let refresh = refresh_s.map_or_else(String::new, |s| format!("<meta http-equiv=\"refresh\" content=\"{s}\">"));
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{}</title>\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <meta name=\"color-scheme\" content=\"light dark\">{refresh}<style>{}{STYLE}</style></head>\n<body>{body}</body></html>\n",
        escaped(title),
        crate::plot::style()
    )
}
