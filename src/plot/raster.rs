//! Raster: converts a picture to PNG, for slides and for programs that do not read SVG.
//!
//! In: the `<svg>` of any picture of this module. Out: the bytes of a PNG, on white, drawn with a font included in the
//! program (DejaVu Sans), so that it looks the same on a server without fonts.

use super::STYLE;
use resvg::{tiny_skia, usvg};
use std::sync::Arc;

/// The default number of pixels per unit of a picture: 560 become 1680.
pub const SCALE: f32 = 3.0;

/// The reasons why there is no PNG.
#[derive(Debug, thiserror::Error)]
pub enum RasterError {
    /// The text is not a picture of this program.
    #[error("the picture cannot be read: {0}")]
    Svg(#[from] usvg::Error),
    /// The picture is too large or has no size.
    #[error("a picture of {width} × {height} pixels cannot be made")]
    Size {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
    },
    /// The picture could not be compressed.
    #[error("the picture cannot be written as PNG: {0}")]
    Png(String),
}

/// Returns the picture as PNG with `scale` pixels for each of its units.
///
/// # Errors
/// [`RasterError`] if `svg` is no picture or too large.
pub fn png(svg: &str, scale: f32) -> Result<Vec<u8>, RasterError> {
    let mut fonts = usvg::fontdb::Database::new();
    fonts.load_font_data(dejavu::sans::regular().to_vec());
    fonts.load_font_data(dejavu::sans::bold().to_vec());
    fonts.set_sans_serif_family("DejaVu Sans");
    let options =
        usvg::Options { fontdb: Arc::new(fonts), font_family: "DejaVu Sans".to_owned(), ..Default::default() };
    let tree = usvg::Tree::from_str(&plain(svg), &options)?;
    let size = tree.size();
    let (width, height) = ((size.width() * scale).ceil() as u32, (size.height() * scale).ceil() as u32);
    let mut pixels = tiny_skia::Pixmap::new(width, height).ok_or(RasterError::Size { width, height })?;
    pixels.fill(tiny_skia::Color::WHITE);
    resvg::render(&tree, tiny_skia::Transform::from_scale(scale, scale), &mut pixels.as_mut());
    pixels.encode_png().map_err(|error| RasterError::Png(error.to_string()))
}

/// Returns the picture with a style without variables and media queries: the light one.
fn plain(svg: &str) -> String {
    match svg.strip_prefix("<svg").and_then(|rest| rest.split_once('>')) {
        Some((head, body)) => {
            format!("<svg xmlns=\"http://www.w3.org/2000/svg\"{head}><style>{}</style>{body}", light(STYLE))
        }
        None => String::new(),
    }
}

/// Returns a style's rules for light screens, its variables written out.
fn light(style: &str) -> String {
    let rules = style.lines().filter(|line| !line.starts_with("@media"));
    let (variables, rules): (Vec<&str>, Vec<&str>) = rules.partition(|line| line.starts_with(":root{"));
    let values = variables.iter().flat_map(|line| line.trim_start_matches(":root{").trim_end_matches('}').split(';'));
    let values: Vec<(&str, &str)> = values.filter_map(|pair| pair.split_once(':')).collect();
    let written =
        values.iter().fold(rules.join("\n"), |text, (name, value)| text.replace(&format!("var({name})"), value));
    written.replace("system-ui,sans-serif", "'DejaVu Sans'")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::Course;

    #[test]
    fn a_picture_has_its_colours_and_its_letters() {
        let points = (0..100).map(|t| (f64::from(t), (f64::from(t) * 0.1).sin(), (f64::from(t) * 0.1).sin())).collect();
        let svg = Course { channel: "gyro_x", unit: "rad/s", points, gaps: vec![] }.svg();
        let file = png(&svg, 1.0).unwrap();
        let pixels = tiny_skia::Pixmap::decode_png(&file).unwrap();
        assert_eq!((pixels.width(), pixels.height()), (560, 280));
        let is = |pixel: &tiny_skia::PremultipliedColorU8, [red, green, blue]: [u8; 3]| {
            let near = |a: u8, b: u8| a.abs_diff(b) < 24;
            near(pixel.red(), red) && near(pixel.green(), green) && near(pixel.blue(), blue)
        };
        // The curve's #0f766e, and the title's #1d2430 above it.
        assert!(pixels.pixels().iter().filter(|pixel| is(pixel, [0x0f, 0x76, 0x6e])).count() > 200);
        assert!(pixels.pixels()[..560 * 25].iter().filter(|pixel| is(pixel, [0x1d, 0x24, 0x30])).count() > 20);
        assert!(pixels.pixels().iter().all(|pixel| pixel.alpha() == 255));
    }

    #[test]
    fn the_light_style_has_no_variables() {
        let style = light(STYLE);
        assert!(
            !style.contains("var(") && !style.contains("@media") && style.contains(".line.x{stroke:#1d4ed8}"),
            "{style}"
        );
    }

    #[test]
    fn what_is_no_picture_is_an_error() {
        assert!(png("", 1.0).is_err());
        assert!(png("<svg viewBox=\"0 0 10 10\"></svg>", 1e9).is_err());
    }
}
