//! The drawing: one picture with two axes, drawn from back to front.

use super::axis::Axis;
use super::escaped;
use std::fmt::Write as _;

/// Width in the picture's own units. Text of 14 units is 10 pixels high if a phone shows the picture 400 wide.
const WIDTH: f64 = 560.0;
/// Margins at the left, right, top and bottom.
const MARGIN: [f64; 4] = [84.0, 14.0, 30.0, 46.0];
/// The distance between a tick's label and its line.
const APART: f64 = 7.0;
/// The maximum length of a title in characters.
const LONGEST: usize = 72;

/// The title of a picture and of its axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame<'a> {
    /// The title above it.
    pub title: &'a str,
    /// The title below it, with its unit.
    pub x: &'a str,
    /// The title beside it, with its unit.
    pub y: &'a str,
    pub height: f64,
}

/// A picture under construction. Writing to a text cannot fail.
#[derive(Debug)]
pub(super) struct Drawing {
    out: String,
    x: Axis,
    y: Axis,
    bottom: f64,
}

impl Drawing {
    /// Creates a picture with title, grid and labels.
    pub(super) fn new(frame: Frame<'_>, x: Axis, y: Axis) -> Self {
        let height = frame.height;
        let (left, right, top, bottom) = (MARGIN[0], WIDTH - MARGIN[1], MARGIN[2], height - MARGIN[3]);
        let mut own = Self { out: escaped_title(frame.title, WIDTH, height, left), x, y, bottom };
        let out = &mut own.out;
        for (value, label) in x.ticks() {
            let at = left + x.share(value) * (right - left);
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{top}\" y2=\"{bottom}\"/>\
                 <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\">{label}</text>",
                bottom + 18.0
            );
        }
        for (value, label) in y.ticks() {
            let at = bottom + y.share(value) * (top - bottom);
            let _ = write!(
                out,
                "<line class=\"grid\" x1=\"{left}\" x2=\"{right}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>\
                 <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
                left - APART,
                at + 5.0
            );
        }
        let (middle, half) = (0.5 * (left + right), 0.5 * (top + bottom));
        let _ = write!(
            out,
            "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text>\
             <text x=\"14\" y=\"{half}\" text-anchor=\"middle\" transform=\"rotate(-90 14 {half})\">{}</text>",
            height - 8.0,
            escaped(&shortened(frame.x)),
            escaped(&shortened(frame.y))
        );
        own
    }

    fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let (left, right) = (MARGIN[0], WIDTH - MARGIN[1]);
        (left + self.x.share(x) * (right - left), self.bottom + self.y.share(y) * (MARGIN[2] - self.bottom))
    }

    /// Draws a curve; it is interrupted at values that are not finite.
    pub(super) fn curve(&mut self, class: &str, points: impl IntoIterator<Item = (f64, f64)>) {
        let mut path = String::new();
        let mut open = false;
        for (x, y) in points {
            if !(x.is_finite() && y.is_finite()) {
                open = false;
                continue;
            }
            let (x, y) = self.at(x, y);
            let _ = write!(path, "{}{x:.1} {y:.1}", if open { 'L' } else { 'M' });
            open = true;
        }
        if !path.is_empty() {
            let _ = write!(self.out, "<path class=\"line {class}\" d=\"{path}\"/>");
        }
    }

    /// Draws the surface between two curves over the same places; it is interrupted at values that are not finite.
    pub(super) fn surface(&mut self, class: &str, points: &[(f64, f64, f64)]) {
        for stretch in points.split(|(x, low, high)| !(x + low + high).is_finite()).filter(|stretch| stretch.len() > 1)
        {
            let mut path = String::new();
            let above = stretch.iter().map(|(x, _, high)| (*x, *high));
            let below = stretch.iter().rev().map(|(x, low, _)| (*x, *low));
            for (place, (x, y)) in above.chain(below).enumerate() {
                let (x, y) = self.at(x, y);
                let _ = write!(path, "{}{x:.1} {y:.1}", if place == 0 { 'M' } else { 'L' });
            }
            let _ = write!(self.out, "<path class=\"surface {class}\" d=\"{path}Z\"/>");
        }
    }

    /// Draws a bar from the bottom up, with a minimum width.
    pub(super) fn bar(&mut self, class: &str, from: f64, to: f64, value: f64) {
        let ((left, y), (right, _)) = (self.at(from, value), self.at(to, value));
        let (width, height) = ((right - left).max(0.5), self.bottom - y);
        let _ = write!(
            self.out,
            "<rect class=\"{class}\" x=\"{left:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\"/>"
        );
    }

    /// Draws a stretch of the x axis from bottom to top, wide enough to be visible, with its description.
    pub(super) fn stretch(&mut self, class: &str, [from, to]: [f64; 2], what: Option<&str>) {
        let ((left, _), (right, _)) = (self.at(from, 0.0), self.at(to, 0.0));
        let width = (right - left).max(4.0);
        let title = what.map_or_else(String::new, |what| format!("<title>{}</title>", escaped(what)));
        let _ = write!(
            self.out,
            "<rect class=\"{class}\" x=\"{:.1}\" y=\"{}\" width=\"{width:.1}\" height=\"{}\">{title}</rect>",
            0.5 * (left + right - width),
            MARGIN[2],
            self.bottom - MARGIN[2]
        );
    }

    /// Draws vertical text beside a place of the x axis, from the bottom up.
    pub(super) fn beside(&mut self, x: f64, text: &str) {
        let ((at, _), y) = (self.at(x, 0.0), self.bottom - 6.0);
        let at = at - 5.0;
        let _ = write!(
            self.out,
            "<text class=\"beside\" x=\"{at:.1}\" y=\"{y}\" transform=\"rotate(-90 {at:.1} {y})\">{}</text>",
            escaped(text)
        );
    }

    /// Draws the key under the title's right end: it shows which curve is which.
    pub(super) fn key(&mut self, entries: &[(&str, &str)]) {
        let right = WIDTH - MARGIN[1];
        let at = [right - 26.0, right - 4.0, right - 32.0];
        self.entries(entries, MARGIN[2] + 16.0, at, " text-anchor=\"end\"");
    }

    /// Draws the key at the bottom left: falling curves leave room there.
    pub(super) fn key_below(&mut self, entries: &[(&str, &str)]) {
        let (left, below) = (MARGIN[0], 18.0 * entries.len().saturating_sub(1) as f64);
        self.entries(entries, self.bottom - 14.0 - below, [left + 6.0, left + 28.0, left + 34.0], "");
    }

    /// Draws the entries of a key below each other, each a line from one x to the other, and a text.
    fn entries(&mut self, entries: &[(&str, &str)], top: f64, [from, to, beside]: [f64; 3], anchor: &str) {
        for (place, (class, text)) in entries.iter().enumerate() {
            let (y, text) = (top + 18.0 * place as f64, escaped(text));
            let _ = write!(
                self.out,
                "<path class=\"line {class}\" d=\"M{from} {y}L{to} {y}\"/><text x=\"{beside}\" y=\"{}\"{anchor}>{text}</text>",
                y + 5.0
            );
        }
    }

    pub(super) fn done(mut self) -> String {
        self.out.push_str("</svg>");
        self.out
    }
}

/// Returns the beginning of a picture: its size, and its title from `left` on.
pub(super) fn escaped_title(title: &str, width: f64, height: f64, left: f64) -> String {
    let title = escaped(&shortened(title));
    format!(
        "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{title}\">\
         <text class=\"title\" x=\"{left}\" y=\"19\">{title}</text>"
    )
}

fn shortened(text: &str) -> String {
    if text.chars().count() <= LONGEST {
        return text.to_owned();
    }
    text.chars().take(LONGEST - 1).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawing() -> Drawing {
        let frame = Frame { title: "<b>", x: "time in s", y: "m/s²", height: 200.0 };
        Drawing::new(frame, Axis::between(0.0, 10.0), Axis::between(0.0, 1.0))
    }

    #[test]
    fn what_is_not_finite_interrupts_and_no_text_is_markup() {
        let mut drawing = drawing();
        drawing.curve("x", [(0.0, 0.0), (1.0, f64::NAN), (2.0, 1.0), (3.0, 0.5)]);
        drawing
            .surface("x", &[(0.0, 0.1, 0.2), (1.0, 0.1, 0.2), (2.0, f64::NAN, 0.2), (3.0, 0.0, 1.0), (4.0, 0.0, 1.0)]);
        drawing.stretch("mark", [3.0, 3.0], Some("a gap of \"<script>\""));
        let svg = drawing.done();
        assert_eq!((svg.matches('M').count(), svg.matches("class=\"surface").count()), (4, 2), "{svg}");
        assert!(!svg.contains("NaN") && !svg.contains("<b>") && !svg.contains("<script>") && svg.ends_with("</svg>"));
        assert!(svg.contains("width=\"4.0\""), "{svg}");
    }

    #[test]
    fn a_long_title_is_cut() {
        assert_eq!(shortened(&"x".repeat(200)).chars().count(), LONGEST);
    }
}
