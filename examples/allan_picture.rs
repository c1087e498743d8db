//! Draws the README's picture: deviation curves with their 68 % bands and the fitted N, B and K of one triad.
//!
//! ```text
//! vn100d allan latest --json > allan.json && vn100d noise latest --json > noise.json
//! cargo run --example allan_picture -- allan.json noise.json accel > docs/allan-demo.svg
//! ```

use serde_json::Value;
use std::fmt::Write as _;

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 440.0;
const LEFT: f64 = 80.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 40.0;
const BOTTOM: f64 = 60.0;
const COLOURS: [&str; 3] = ["#0b6e99", "#c4531d", "#4a7c2c"];
/// Level of the flat part of a flicker's Allan deviation: sqrt(2 ln 2 / π).
const FLAT: f64 = 0.664_28;

/// Logarithmic axes.
struct Axes {
    tau_s: (f64, f64),
    deviation: (f64, f64),
}

impl Axes {
    fn x(&self, tau_s: f64) -> f64 {
        LEFT + (WIDTH - LEFT - RIGHT) * (tau_s / self.tau_s.0).ln() / (self.tau_s.1 / self.tau_s.0).ln()
    }
    fn y(&self, deviation: f64) -> f64 {
        let share = (deviation / self.deviation.0).ln() / (self.deviation.1 / self.deviation.0).ln();
        HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * share
    }
}

fn read(path: &str) -> Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{path}: {error}"));
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{path}: {error}"))
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().map(|list| list.iter().filter_map(Value::as_f64).collect()).unwrap_or_default()
}

fn decades(range: (f64, f64)) -> impl Iterator<Item = i32> {
    (range.0.log10().ceil() as i32)..=(range.1.log10().floor() as i32)
}

fn superscript(exponent: i32) -> String {
    exponent.to_string().replace('-', "−")
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [allan, noise, triad] = arguments.as_slice() else {
        panic!("usage: allan_picture ALLAN.json NOISE.json TRIAD");
    };
    let (allan, noise) = (read(allan), read(noise));
    let names: Vec<String> = ["x", "y", "z"].map(|axis| format!("{triad}_{axis}")).to_vec();
    let curves: Vec<&Value> = names.iter().map(|name| &allan["channels"][name]).collect();
    let all = |key: &str| curves.iter().flat_map(|curve| numbers(&curve[key])).collect::<Vec<_>>();
    let low = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let axes = Axes {
        tau_s: (low(&all("tau_s")), high(&all("tau_s"))),
        deviation: (low(&all("ci68_low")) / 1.5, high(&all("ci68_high")) * 1.5),
    };
    let mut svg = format!(
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="12" role="img"><title>Allan deviation of {triad}</title><rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>"##
    );
    let mut draw = |text: String| svg.push_str(&text);
    for decade in decades(axes.tau_s) {
        let x = axes.x(10f64.powi(decade));
        draw(format!(
            r##"<path d="M{x:.1} {TOP}V{}" stroke="#dddddd"/><text x="{x:.1}" y="{}" text-anchor="middle">10<tspan dy="-5" font-size="9">{}</tspan></text>"##,
            HEIGHT - BOTTOM,
            HEIGHT - BOTTOM + 18.0,
            superscript(decade)
        ));
    }
    for decade in decades(axes.deviation) {
        let y = axes.y(10f64.powi(decade));
        draw(format!(
            r##"<path d="M{LEFT} {y:.1}H{}" stroke="#dddddd"/><text x="{}" y="{:.1}" text-anchor="end">10<tspan dy="-5" font-size="9">{}</tspan></text>"##,
            WIDTH - RIGHT,
            LEFT - 8.0,
            y + 4.0,
            superscript(decade)
        ));
    }
    for ((name, curve), colour) in names.iter().zip(&curves).zip(COLOURS) {
        let (tau_s, deviation) = (numbers(&curve["tau_s"]), numbers(&curve["deviation"]));
        let (lower, upper) = (numbers(&curve["ci68_low"]), numbers(&curve["ci68_high"]));
        let line = |values: &[f64]| {
            tau_s.iter().zip(values).fold(String::new(), |mut path, (tau_s, value)| {
                let _ = write!(path, "{:.1},{:.1} ", axes.x(*tau_s), axes.y(*value));
                path
            })
        };
        let mut band: Vec<String> = line(&upper).split_whitespace().map(str::to_owned).collect();
        band.extend(line(&lower).split_whitespace().rev().map(str::to_owned));
        draw(format!(
            r##"<polygon points="{}" fill="{colour}" opacity="0.2"/><polyline points="{}" fill="none" stroke="{colour}" stroke-width="1.8"/>"##,
            band.join(" "),
            line(&deviation)
        ));
        let parameter = |letter: &str| noise["channels"][name][letter]["value"].as_f64().unwrap_or(0.0);
        let (n, b, k) = (parameter("N"), parameter("B"), parameter("K"));
        let fitted: Vec<f64> =
            tau_s.iter().map(|tau_s| (n * n / tau_s + (FLAT * b).powi(2) + k * k * tau_s / 3.0).sqrt()).collect();
        draw(format!(
            r##"<polyline points="{}" fill="none" stroke="#222222" stroke-width="1" stroke-dasharray="4 3"/>"##,
            line(&fitted)
        ));
    }
    for (row, (name, colour)) in names.iter().zip(COLOURS).enumerate() {
        let y = TOP + 18.0 + 18.0 * row as f64;
        let found = &noise["channels"][name];
        let value = |letter: &str| {
            found[letter]["value"].as_f64().map_or_else(|| "–".to_owned(), |value| format!("{value:.2e}"))
        };
        draw(format!(
            r##"<path d="M{} {:.1}h22" stroke="{colour}" stroke-width="3"/><text x="{}" y="{y:.1}">{name}: N {} · B {} · K {}</text>"##,
            WIDTH - RIGHT - 330.0,
            y - 4.0,
            WIDTH - RIGHT - 300.0,
            value("N"),
            value("B"),
            value("K")
        ));
    }
    let unit = curves[0]["unit"].as_str().unwrap_or_default();
    draw(format!(
        r##"<text x="{LEFT}" y="24" font-size="14">Overlapping Allan deviation, 68 % band, and the fit of N, B, K (dashed)</text><text x="{}" y="{}" text-anchor="middle">averaging time τ in s</text><text transform="translate(18 {}) rotate(-90)" text-anchor="middle">deviation in {unit}</text></svg>"##,
        (WIDTH + LEFT - RIGHT) / 2.0,
        HEIGHT - 18.0,
        (HEIGHT + TOP - BOTTOM) / 2.0
    ));
    println!("{svg}");
}
