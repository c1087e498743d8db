//! Draws what a filter predicts beside the real errors of one channel: with the Allan deviation's N and K, with the pair that
//! is closest, and with the pair that covers.
//!
//! ```text
//! vn100d noise --model unit.json --consistent --json > parameters.json
//! cargo run --example filter_picture -- parameters.json gyro_y > docs/filters-gyro.svg
//! ```

mod axes;

use axes::{Axes, BOTTOM, COLOURS, HEIGHT, LEFT, RIGHT, TOP, WIDTH, ends};
use serde_json::Value;
use std::fmt::Write as _;

/// Name and dashes of a curve.
const CURVES: [(&str, &str); 4] =
    [("real error", ""), ("Allan N, K", "2 4"), ("closest pair", "8 4"), ("covering pair", "1 0")];

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
    let error = ends(curves.iter().flatten().copied());
    let axes = Axes { x: ends(horizons_s.iter().copied()), y: (error.0 / 1.5, error.1 * 1.5) };
    let mut svg = axes.begin(&format!("Real and predicted errors of {channel}"));
    for (row, ((values, (label, dashes)), colour)) in curves.iter().zip(CURVES).zip(COLOURS).enumerate() {
        let line = axes.line(horizons_s.iter().copied().zip(values.iter().copied()));
        let at = LEFT + 20.0 + 160.0 * row as f64;
        let width = if row == 0 { 2.5 } else { 1.5 };
        let _ = write!(
            svg,
            r##"<polyline points="{}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-dasharray="{dashes}"/><path d="M{at} {}h28" stroke="{colour}" stroke-width="{width}" stroke-dasharray="{dashes}"/><text x="{}" y="{}">{label}</text>"##,
            line,
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
