//! Plots through the daemon: every picture of a capture, and the message if there is none.

use crate::world::{World, vn100d};
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(120);
const MODEL: &str = r#"{"format": "vn100d-sensor-model-1", "name": "unit 7", "rate_hz": 40, "channels": {
    "gyro_x": {"N": 1e-4, "B": 2e-5, "K": 1e-6}, "gyro_y": {"N": 1e-4}, "gyro_z": {"N": 1e-4},
    "accel_z": {"N": 0.002, "bias": -9.8, "effects": [{"effect": "tone", "frequency_hz": 13.38, "amplitude": 0.002}]}}}"#;

#[test]
fn every_plot_of_a_capture_is_drawn_and_what_is_not_there_is_reported() {
    let world = World::new();
    let (model, data) = (world.path("model.json"), world.path("data"));
    std::fs::write(&model, MODEL).unwrap();
    let made = vn100d(&[
        "--data-dir",
        data.to_str().unwrap(),
        "simulate",
        "--model",
        model.to_str().unwrap(),
        "--duration",
        "10min",
        "--seed",
        "7",
        "--into-db",
        "<desk>",
    ]);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let daemon = world.daemon("", &[]);
    let plot = |name: &str| world.request("GET", &format!("/v1/captures/latest/plots/{name}.svg"), "").unwrap();
    let drawn = |name: &str| {
        let svg = || Some(plot(name)).filter(|(status, _)| *status != 202);
        let (status, svg) = world.until(name, PATIENCE, svg, &daemon);
        assert_eq!(status, 200, "{name}: {svg}");
        assert!(svg.starts_with("<svg xmlns=") && svg.trim_end().ends_with("</svg>"), "{name}: {svg}");
        assert!(!svg.contains("NaN") && !svg.contains("inf") && !svg.contains("<desk>"), "{name}: {svg}");
        svg
    };
    let curves = |svg: &str, class: &str| svg.matches(&format!("<path class=\"line {class}\" d=\"M")).count();
    // Each curve occurs once, and once more in the key.
    let triad = drawn("allan-gyro");
    assert_eq!(["x", "y", "z"].map(|axis| curves(&triad, axis)), [2, 2, 2], "{triad}");
    let one = drawn("allan-gyro_x");
    assert!(one.contains("fitted") && one.contains("rad/s/√Hz") && curves(&one, "N") == 2, "{one}");
    let series = drawn("timeseries-accel_z");
    assert!(series.contains("time in min") && series.contains("accel_z in m/s²") && series.contains("surface range"));
    let histogram = drawn("histogram-gyro_y");
    assert!(histogram.contains("normal (p = ") && histogram.matches("class=\"bar\"").count() > 10, "{histogram}");
    let psd = drawn("psd-gyro");
    assert!(psd.contains("density in rad/s/√Hz") && curves(&psd, "z") == 2, "{psd}");
    // Time counts from the first sample.
    assert!(series.contains(">2</text>") && series.contains(">8</text>"), "{series}");
    assert!(drawn("gaps").contains("24000 samples, none missing"));
    for (name, detail) in
        [("gap", "allan-&lt;"), ("timeseries-mag_x", "no channel mag_x"), ("psd-accel", "no channel accel_x")]
    {
        let (status, body) = plot(name);
        assert_eq!(status, 404, "{name}: {body}");
        assert!(body.contains(&detail.replace("&lt;", "<")), "{name}: {body}");
    }
}
