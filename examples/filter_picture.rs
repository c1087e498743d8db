//! Draws what a filter predicts beside the real errors of one channel: with the Allan deviation's N and K, with the pair that
//! is closest, and with the pair that covers.
//!
//! ```text
//! vn100d noise --model unit.json --consistent --json > parameters.json
//! cargo run --example filter_picture -- parameters.json gyro_y > docs/filters-gyro.svg
//! ```

use serde_json::Value;
use std::fmt::Write as _;

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 400.0;
const LEFT: f64 = 80.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 40.0;
const BOTTOM: f64 = 60.0;
/// Name, colour and dashes of a curve.
const CURVES: [(&str, &str, &str); 4] = [
    ("real error", "#222222", ""),
    ("Allan N, K", "#c4531d", "2 4"),
    ("closest pair", "#0b6e99", "8 4"),
    ("covering pair", "#4a7c2c", "1 0"),
];

fn numbers(of: &Value) -> Vec<f64> {
    of.as_array().map(|list| list.iter().filter_map(Value::as_f64).collect()).unwrap_or_default()
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [file, channel] = arguments.as_slice() else { panic!("usage: filter_picture DOCUMENT.json CHANNEL") };
    let text = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{file}: {error}"));
    let document: Value = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{file}: {error}"));
    let of = &document["channels"][channel];
    let unit = of["unit"].as_str().unwrap_or_else(|| panic!("{file} has no {channel}"));
    let horizons_s = numbers(&document["horizons_s"]);
    let pair = &of["white_and_walk"];
    let curves = [
        numbers(&of["real_sd"]),
        numbers(&of["allan"]["predicted_sd"]),
        numbers(&pair["fit"]["predicted_sd"]),
        numbers(&pair["cover"]["predicted_sd"]),
    ];
    let ends = |values: &mut dyn Iterator<Item = f64>| {
        values.fold((f64::INFINITY, 0.0_f64), |(low, high), value| (low.min(value), high.max(value)))
    };
    let time = ends(&mut horizons_s.iter().copied());
    let error = ends(&mut curves.iter().flatten().copied());
    let error = (error.0 / 1.5, error.1 * 1.5);
    let x = |s: f64| LEFT + (WIDTH - LEFT - RIGHT) * (s / time.0).ln() / (time.1 / time.0).ln();
    let y = |of: f64| HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (of / error.0).ln() / (error.1 / error.0).ln();
    let mut svg = format!(
        r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="12" role="img"><title>Real and predicted errors of {channel}</title><rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>"##
    );
    let decades = |(low, high): (f64, f64)| (low.log10().ceil() as i32)..=(high.log10().floor() as i32);
    let power =
        |decade: i32| format!(r##"10<tspan dy="-5" font-size="9">{}</tspan>"##, decade.to_string().replace('-', "−"));
    for decade in decades(time) {
        let _ = write!(
            svg,
            r##"<path d="M{0:.1} {TOP}V{1}" stroke="#dddddd"/><text x="{0:.1}" y="{2}" text-anchor="middle">{3}</text>"##,
            x(10f64.powi(decade)),
            HEIGHT - BOTTOM,
            HEIGHT - BOTTOM + 18.0,
            power(decade)
        );
    }
    for decade in decades(error) {
        let at = y(10f64.powi(decade));
        let _ = write!(
            svg,
            r##"<path d="M{LEFT} {at:.1}H{}" stroke="#dddddd"/><text x="{}" y="{:.1}" text-anchor="end">{}</text>"##,
            WIDTH - RIGHT,
            LEFT - 8.0,
            at + 4.0,
            power(decade)
        );
    }
    for (row, (values, (label, colour, dashes))) in curves.iter().zip(CURVES).enumerate() {
        let line = horizons_s.iter().zip(values).fold(String::new(), |mut line, (s, of)| {
            let _ = write!(line, "{:.1},{:.1} ", x(*s), y(*of));
            line
        });
        let at = LEFT + 20.0 + 160.0 * row as f64;
        let width = if row == 0 { 2.5 } else { 1.5 };
        let _ = write!(
            svg,
            r##"<polyline points="{}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-dasharray="{dashes}"/><path d="M{at} {}h28" stroke="{colour}" stroke-width="{width}" stroke-dasharray="{dashes}"/><text x="{}" y="{}">{label}</text>"##,
            line.trim_end(),
            TOP + 10.0,
            at + 34.0,
            TOP + 14.0
        );
    }
    let _ = write!(
        svg,
        r##"<text x="{LEFT}" y="24" font-size="14">{channel}: real and predicted error of the integral</text><text x="{}" y="{}" text-anchor="middle">time without aid in s</text><text transform="translate(18 {}) rotate(-90)" text-anchor="middle">standard deviation in {unit}</text></svg>"##,
        (WIDTH + LEFT - RIGHT) / 2.0,
        HEIGHT - 18.0,
        (HEIGHT + TOP - BOTTOM) / 2.0,
    );
    println!("{svg}");
}
