//! Pictures on pages: drawn in the page itself, or fetched from their address, then with a link to the PNG.

use super::escaped;
use std::fmt::Write as _;

/// A picture on a page.
#[derive(Debug, Clone, PartialEq)]
pub enum Figure {
    /// A picture that is fetched from its address when it scrolls into view; `alt` describes it for users who cannot
    /// see it.
    Linked {
        /// Its description.
        alt: String,
        /// Its address, which ends with `.svg` before the query.
        address: String,
        /// Its height in units in which its width is 560.
        height: u32,
    },
    /// A picture that is part of the file: `<svg>…</svg>`.
    Drawn(String),
}

/// Writes the picture, with a caption if there is one.
pub(super) fn write(out: &mut String, figure: &Figure, caption: Option<&str>) {
    let caption = caption.map(escaped).unwrap_or_default();
    // Writing to a text cannot fail.
    let _ = match figure {
        Figure::Drawn(svg) if caption.is_empty() => write!(out, "<figure>{svg}</figure>"),
        Figure::Drawn(svg) => write!(out, "<figure>{svg}<figcaption>{caption}</figcaption></figure>"),
        Figure::Linked { alt, address, height } => {
            let (alt, png) = (escaped(alt), png(address));
            let address = escaped(address);
            let caption = if caption.is_empty() { caption } else { format!("{caption} · ") };
            write!(
                out,
                "<figure><img src=\"{address}\" alt=\"{alt}\" width=\"560\" height=\"{height}\" loading=\"lazy\">\
                 <figcaption>{caption}{png}</figcaption></figure>"
            )
        }
    };
}

/// Returns the link to the PNG of the picture with this address.
pub(super) fn png(address: &str) -> String {
    format!("<a href=\"{}\">PNG</a>", escaped(&address.replacen(".svg", ".png", 1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linked_picture_has_its_png_and_no_text_is_markup() {
        let mut out = String::new();
        let address = "/v1/captures/7/plots/allan-gyro_x.svg?beside=8&x".to_owned();
        write(&mut out, &Figure::Linked { alt: "<alt>".to_owned(), address, height: 360 }, Some("<night>"));
        assert_eq!(
            out,
            "<figure><img src=\"/v1/captures/7/plots/allan-gyro_x.svg?beside=8&amp;x\" alt=\"&lt;alt&gt;\" width=\"560\" \
             height=\"360\" loading=\"lazy\"><figcaption>&lt;night&gt; · \
             <a href=\"/v1/captures/7/plots/allan-gyro_x.png?beside=8&amp;x\">PNG</a></figcaption></figure>"
        );
        let mut drawn = String::new();
        write(&mut drawn, &Figure::Drawn("<svg></svg>".to_owned()), None);
        assert_eq!(drawn, "<figure><svg></svg></figure>");
    }
}
