//! Logarithmic axes of the pictures of filter_picture and gap_picture.

use std::fmt::Write as _;

pub const WIDTH: f64 = 760.0;
pub const HEIGHT: f64 = 400.0;
pub const LEFT: f64 = 80.0;
pub const RIGHT: f64 = 20.0;
pub const TOP: f64 = 40.0;
pub const BOTTOM: f64 = 60.0;
pub const COLOURS: [&str; 4] = ["#222222", "#c4531d", "#0b6e99", "#4a7c2c"];

/// Two logarithmic axes: the least and the greatest value of each.
pub struct Axes {
    pub x: (f64, f64),
    pub y: (f64, f64),
}

/// Returns the least and the greatest of positive values.
pub fn ends(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, 0.0_f64), |(low, high), value| (low.min(value), high.max(value)))
}

impl Axes {
    pub fn x(&self, value: f64) -> f64 {
        LEFT + (WIDTH - LEFT - RIGHT) * (value / self.x.0).ln() / (self.x.1 / self.x.0).ln()
    }

    pub fn y(&self, value: f64) -> f64 {
        HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (value / self.y.0).ln() / (self.y.1 / self.y.0).ln()
    }

    /// Returns the head of a picture with a line and a number for each decade.
    pub fn begin(&self, title: &str) -> String {
        let mut svg = format!(
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="12" role="img"><title>{title}</title><rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>"##
        );
        let decades = |(low, high): (f64, f64)| (low.log10().ceil() as i32)..=(high.log10().floor() as i32);
        let power = |decade: i32| {
            format!(r##"10<tspan dy="-5" font-size="9">{}</tspan>"##, decade.to_string().replace('-', "−"))
        };
        for decade in decades(self.x) {
            let _ = write!(
                svg,
                r##"<path d="M{0:.1} {TOP}V{1}" stroke="#dddddd"/><text x="{0:.1}" y="{2}" text-anchor="middle">{3}</text>"##,
                self.x(10f64.powi(decade)),
                HEIGHT - BOTTOM,
                HEIGHT - BOTTOM + 18.0,
                power(decade)
            );
        }
        for decade in decades(self.y) {
            let at = self.y(10f64.powi(decade));
            let _ = write!(
                svg,
                r##"<path d="M{LEFT} {at:.1}H{}" stroke="#dddddd"/><text x="{}" y="{:.1}" text-anchor="end">{}</text>"##,
                WIDTH - RIGHT,
                LEFT - 8.0,
                at + 4.0,
                power(decade)
            );
        }
        svg
    }

    /// Returns the points of a curve.
    pub fn line(&self, points: impl Iterator<Item = (f64, f64)>) -> String {
        points.map(|(x, y)| format!("{:.1},{:.1}", self.x(x), self.y(y))).collect::<Vec<_>>().join(" ")
    }
}
