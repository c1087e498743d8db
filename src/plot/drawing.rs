//! The drawing: one picture with two axes, drawn from back to front.

use super::axis::Axis;
use super::escaped;
use std::fmt::Write as _;

/// Width in the picture's own units. Text of 14 units is 10 pixels high if a phone shows the picture 400 wide.
const WIDTH: f64 = 560.0;
/// Margins at the left, right, top and bottom; a key takes more room at the top.
const MARGIN: [f64; 4] = [84.0, 14.0, 30.0, 46.0];
/// The height of a row of a key, the length of its lines, and the distance between two entries.
const KEY: [f64; 3] = [18.0, 22.0, 16.0];
/// The width of a letter; most are narrower.
const LETTER: f64 = 7.7;
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
    top: f64,
    bottom: f64,
    /// The places of vertical texts.
    texts: Vec<f64>,
}

impl Drawing {
    /// Creates a picture with title, grid and labels.
    pub(super) fn new(frame: Frame<'_>, x: Axis, y: Axis) -> Self {
        Self::keyed(frame, &[], x, y)
    }

    /// Creates a picture with a key, which shows which curve is which. It is under the title and covers no data.
    pub(super) fn keyed(frame: Frame<'_>, key: &[(&str, &str)], x: Axis, y: Axis) -> Self {
        let height = frame.height;
        let (left, right, bottom) = (MARGIN[0], WIDTH - MARGIN[1], height - MARGIN[3]);
        let mut out = escaped_title(frame.title, WIDTH, height, left);
        let top = entries(&mut out, key);
        let mut own = Self { out, x, y, top, bottom, texts: Vec::new() };
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
        (left + self.x.share(x) * (right - left), self.bottom + self.y.share(y) * (self.top - self.bottom))
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
            self.top,
            self.bottom - self.top
        );
    }

    /// Draws vertical text beside a place of the x axis, below the top, where falling curves leave room, unless it would
    /// cover another one.
    pub(super) fn beside(&mut self, x: f64, text: &str) {
        let ((at, _), y) = (self.at(x, 0.0), self.top + 6.0);
        let at = at - 5.0;
        if self.texts.iter().any(|other| (other - at).abs() < KEY[0]) {
            return;
        }
        self.texts.push(at);
        let _ = write!(
            self.out,
            "<text class=\"beside\" x=\"{at:.1}\" y=\"{y}\" text-anchor=\"end\" transform=\"rotate(-90 {at:.1} {y})\">{}</text>",
            escaped(text)
        );
    }

    pub(super) fn done(mut self) -> String {
        self.out.push_str("</svg>");
        self.out
    }
}

/// Draws the entries of a key beside each other, in rows, each a line and a text; returns where they end.
fn entries(out: &mut String, entries: &[(&str, &str)]) -> f64 {
    let [height, line, apart] = KEY;
    let (left, right) = (MARGIN[0], WIDTH - MARGIN[1]);
    let (mut x, mut y) = (left, MARGIN[2] + 5.0);
    for (class, text) in entries {
        let text = shortened_to(text, 40);
        let end = x + line + 6.0 + LETTER * text.chars().count() as f64;
        if end > right && x > left {
            (x, y) = (left, y + height);
        }
        let (to, beside) = (x + line, x + line + 6.0);
        let _ = write!(
            out,
            "<path class=\"line {class}\" d=\"M{x:.1} {y}L{to:.1} {y}\"/><text x=\"{beside:.1}\" y=\"{}\">{}</text>",
            y + 5.0,
            escaped(&text)
        );
        x = beside + LETTER * text.chars().count() as f64 + apart;
    }
    if entries.is_empty() { MARGIN[2] } else { y + 0.5 * height + 4.0 }
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
    shortened_to(text, LONGEST)
}

fn shortened_to(text: &str, longest: usize) -> String {
    if text.chars().count() <= longest {
        return text.to_owned();
    }
    text.chars().take(longest - 1).chain(['…']).collect()
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
    fn a_key_stands_above_the_data_and_two_texts_not_in_one_place() {
        let frame = Frame { title: "title", x: "x", y: "y", height: 200.0 };
        let long = "<i>".repeat(30);
        let key = [("x", "one"), ("y", &*long), ("z", "third")];
        let mut drawing = Drawing::keyed(frame, &key, Axis::between(0.0, 10.0), Axis::between(0.0, 1.0));
        drawing.curve("x", [(0.0, 1.0), (10.0, 1.0)]);
        drawing.stretch("mark", [5.0, 5.0], None);
        [5.0, 5.1, 9.0].into_iter().for_each(|x| drawing.beside(x, "5 Hz"));
        let svg = drawing.done();
        // Two rows: the second entry is long, and the third does not fit beside it.
        let rows = ["y=\"40\"", "y=\"58\""].map(|at| svg.matches(at).count());
        assert_eq!(rows, [2, 1], "{svg}");
        let places = |prefix: &str| -> Vec<f64> {
            let numbers = svg.split(prefix).skip(1).filter_map(|rest| rest.split(['L', '"', ' ']).next());
            numbers.filter_map(|number| number.parse().ok()).collect()
        };
        let lines =
            svg.split("d=\"M").skip(1).map(|path| path.split([' ', 'L']).nth(1).unwrap().parse::<f64>().unwrap());
        let lines: Vec<f64> = lines.collect();
        // The last curve is the data, at the top of its field: below all lines of the key.
        let (data, key) = lines.split_last().unwrap();
        assert!(key.len() == 3 && key.iter().all(|y| y + 9.0 < *data), "{lines:?}");
        assert!(places("y1=\"").iter().all(|y| *y >= *data - 0.1), "{svg}");
        assert!(svg.matches(">5 Hz<").count() == 2 && svg.contains("…") && !svg.contains("<i>"), "{svg}");
    }

    #[test]
    fn a_long_title_is_cut() {
        assert_eq!(shortened(&"x".repeat(200)).chars().count(), LONGEST);
    }
}
