//! Plots: the interfaces' documents as SVG. Pure.
//!
//! In: documents, or plain numbers. Out: one `<svg>`, coloured by the style of the page that contains it, or [`alone`]
//! with a separate style for light, dark and paper. Guarantees: no text of a document becomes markup, nothing that is not
//! finite is drawn, and every axis has its unit.

mod axis;
mod closing;
mod course;
mod density;
mod deviation;
mod drawing;
mod gaps;
mod growth;
mod heat;
mod histogram;
mod hourly;
mod lines;
pub mod number;
pub mod raster;
mod residuals;
mod spark;
mod spectra;
mod timeline;

pub use closing::closing;
pub use course::Course;
pub use density::Density;
pub use deviation::{deviation, deviation_beside};
pub use gaps::{Gap, Gaps};
pub use growth::{Growth, growth};
pub use heat::heat;
pub use histogram::histogram;
pub use hourly::hourly;
pub use lines::NamedLine;
pub use residuals::residuals;
pub use spark::spark;
pub use spectra::spectra;
pub use timeline::{level, spread};

const STYLE: &str = include_str!("style.css");

/// Returns a picture as a standalone file, with its style.
pub fn alone(svg: &str) -> String {
    match svg.strip_prefix("<svg").and_then(|rest| rest.split_once('>')) {
        Some((head, body)) => format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\"{head}><style>{STYLE}</style>\
             <rect class=\"ground\" width=\"100%\" height=\"100%\"/>{body}\n"
        ),
        None => String::new(),
    }
}

/// Returns the style of curves and surfaces, for a page that has pictures in it.
pub fn style() -> &'static str {
    STYLE
}

/// Returns the text with the special characters of HTML and SVG escaped.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_alone_has_its_style_and_its_ground() {
        let svg = alone("<svg viewBox=\"0 0 1 1\"><path/></svg>");
        assert!(
            svg.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 1 1\"><style>")
                && svg.trim_end().ends_with("<path/></svg>"),
            "{svg}"
        );
        assert!(svg.contains("prefers-color-scheme:dark") && !STYLE.contains('<') && !STYLE.contains('&'));
        assert_eq!(alone(""), "");
    }

    #[test]
    fn no_text_is_markup() {
        assert_eq!(escaped("<script a=\"1\">&"), "&lt;script a=&quot;1&quot;&gt;&amp;");
    }
}
