//! `plot` and `report` without a daemon and beside one: every picture as a file, and one standalone page.

use crate::export::Place;
use crate::world::{World, vn100d};
use serde_json::Value;
use std::process::Output;
use std::time::Duration;

const PATIENCE: Duration = Duration::from_secs(60);
const MODEL: &str = r#"{"format": "vn100d-sensor-model-1", "name": "VN-100 unit 7", "rate_hz": 40, "channels": {
    "gyro_x": {"N": 1e-4, "B": 2e-5, "K": 1e-6}, "gyro_y": {"N": 1e-4}, "gyro_z": {"N": 1e-4}, "temperature": {"N": 0.01, "bias": 30},
    "accel_z": {"N": 0.002, "bias": -9.8, "effects": [{"effect": "tone", "frequency_hz": 13.38, "amplitude": 0.002}]}}}"#;

/// Returns a folder whose database holds ten minutes under a name that looks like markup.
fn place() -> Place {
    let place = Place::new();
    std::fs::write(place.path("model.json"), MODEL).unwrap();
    place.done(&[
        "simulate",
        "--model",
        "model.json",
        "--duration",
        "10min",
        "--seed",
        "7",
        "--into-db",
        "<script>alert(1)",
    ]);
    place
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn refused(place: &Place, code: i32, arguments: &[&str], why: &str) {
    let output = place.run(arguments);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
    assert!(stderr(&output).contains(why), "{arguments:?}: {}", stderr(&output));
    assert!(!stderr(&output).contains("panicked"), "{}", stderr(&output));
}

/// Returns width and height from a PNG's header.
fn pixels(png: &[u8]) -> [u32; 2] {
    assert_eq!(&png[..8], b"\x89PNG\r\n\x1a\n");
    [16, 20].map(|at| u32::from_be_bytes(png[at..at + 4].try_into().unwrap()))
}

#[test]
fn every_plot_of_a_capture_is_a_file_as_svg_and_as_png() {
    let place = place();
    let made: Value = serde_json::from_str(&place.done(&["report", "latest", "--out", "page.html", "--json"])).unwrap();
    let names: Vec<&str> = made["plots"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    for wanted in ["gaps", "allan-gyro", "allan-gyro_x", "psd-gyro", "timeseries-temperature", "histogram-accel_z"] {
        assert!(names.contains(&wanted), "{wanted}: {names:?}");
    }
    for name in names.iter().filter(|name| !name.ends_with("_y")) {
        let file = format!("{name}.svg");
        place.done(&["plot", "1", name, "--out", &file]);
        let svg = place.text(&file);
        assert!(svg.starts_with("<svg xmlns=") && svg.trim_end().ends_with("</svg>"), "{name}: {svg}");
        assert!(svg.contains("class=\"title\"") && !svg.contains("NaN") && !svg.contains("<script"), "{name}: {svg}");
    }
    let has = |name: &str, parts: &[&str]| {
        let svg = place.text(name);
        parts.iter().for_each(|part| assert!(svg.contains(part), "{part} is not in {svg}"));
    };
    has("timeseries-accel_z.svg", &[">accel_z", "accel_z in m/s²", "time in min"]);
    has("allan-gyro_x.svg", &["Allan deviation, gyro_x", "averaging time τ in s", "in rad/s"]);
    has("psd-gyro.svg", &["Power spectrum, gyro", "rad/s/√Hz", "Hz</text>"]);
    has("gaps.svg", &["24000 samples, none missing"]);
    let actual: Value =
        serde_json::from_str(&place.done(&["plot", "latest", "allan-gyro", "--out", "a.png", "--json"])).unwrap();
    let png = std::fs::read(place.path("a.png")).unwrap();
    assert_eq!(pixels(&png), [1680, 1080]);
    assert_eq!(actual, serde_json::json!({"plot": "allan-gyro", "capture": 1, "out": "a.png", "bytes": png.len()}));
    // A part of the time, on standard output.
    let part = place.done(&["plot", "latest", "timeseries-gyro_x", "--from", "60", "--to", "62.5", "--out", "-"]);
    assert!(part.contains(">61</text>") && part.contains("time in s") && !part.contains(">100</text>"), "{part}");
}

#[test]
fn a_report_has_everything_in_it_and_nothing_from_elsewhere() {
    let place = place();
    let printed = place.done(&["report", "latest", "--out", "page.html"]);
    let page = place.text("page.html");
    assert!(printed.starts_with("page.html: report of <script>"), "{printed}");
    assert!(printed.contains(&format!("{} bytes", page.len())), "{printed}");
    assert!(page.starts_with("<!doctype html>") && page.trim_end().ends_with("</html>"));
    assert!(page.contains("<h1>&lt;script&gt;alert(1)</h1>"), "{page}");
    for absent in
        ["<script", "http://", "https://", "src=", "url(", "@import", "<link rel=\"stylesheet", "<img", "<form", "NaN"]
    {
        assert!(!page.contains(absent), "{absent}");
    }
    // The empty icon keeps a browser from asking for one.
    assert_eq!(page.matches("href=").count(), page.matches("href=\"data:,\"").count());
    assert!(!page.contains(" id=\""), "two pictures might share it");
    for heading in [
        "Samples and gaps",
        "Noise parameters",
        "Allan deviation",
        "Power spectrum",
        "Statistics",
        "Beside the datasheet",
        "Channel by channel",
        "What made it",
    ] {
        assert!(page.contains(&format!("<h2>{heading}")), "{heading}");
    }
    assert!(page.contains("vn100d-sensor-model-1"), "the configuration is not there");
    // The numbers must be those of `noise`, computed again from the samples.
    let noise: Value = serde_json::from_str(&place.done(&["noise", "latest", "--json"])).unwrap();
    let mut found = 0;
    let table = page.split("<h2>Noise parameters").nth(1).unwrap();
    for (channel, of) in noise["channels"].as_object().unwrap() {
        let row = table.split(&format!(">{channel}</th><td>")).nth(1).unwrap();
        let row = row.split("</tr>").next().unwrap();
        for parameter in ["N", "B", "K"] {
            let (value, limit) = (of[parameter]["value"].as_f64(), of[parameter]["upper_limit95"].as_f64());
            if let Some(value) = value.or(limit) {
                let is_listed = numbers(row).into_iter().any(|number| (number / value - 1.0).abs() < 0.01);
                assert!(is_listed, "{channel} {parameter}: {value} is not in {row}");
                found += 1;
            }
        }
    }
    assert!(found >= 8, "{found}");
    // The page from the database must be the same again.
    place.done(&["report", "latest", "--out", "again.html"]);
    assert!(place.text("again.html") == page, "two reports of one capture differ");
}

/// Returns the numbers of a table's row, as a page writes them: `1.2·10⁻⁴`.
fn numbers(row: &str) -> Vec<f64> {
    let text = row.replace("&nbsp;", " ");
    let words = text.split(|c: char| c.is_whitespace() || matches!(c, '<' | '>'));
    let exponent = |text: &str| -> Option<i32> {
        let plain = text.chars().map(|c| {
            if c == '⁻' {
                Some('-')
            } else {
                "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().position(|d| d == c).and_then(|d| char::from_digit(d as u32, 10))
            }
        });
        plain.collect::<Option<String>>()?.parse().ok()
    };
    let number = |word: &str| match word.split_once("·10") {
        Some((mantissa, power)) => Some(mantissa.parse::<f64>().ok()? * 10_f64.powi(exponent(power)?)),
        None => word.parse().ok(),
    };
    words.filter_map(number).collect()
}

#[test]
fn a_recordings_path_takes_the_place_of_a_capture_and_leaves_no_database() {
    let place = place();
    place.done(&["export", "latest", "--out", "desk night.csv"]);
    let temporary = place.path("temporary");
    std::fs::create_dir(&temporary).unwrap();
    let elsewhere = place.path("elsewhere");
    let run = |arguments: &[&str]| {
        let mut command = crate::world::program();
        command.current_dir(place.path("")).env("TMPDIR", &temporary).arg("--data-dir").arg(&elsewhere);
        command.args(arguments).output().unwrap()
    };
    let output = run(&["report", "desk night.csv", "--out", "page.html", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stderr(&output).contains("tells no time of day"), "{}", stderr(&output));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(document["capture"].is_null() && document["name"] == "desk night", "{document}");
    let page = place.text("page.html");
    for part in ["<h1>desk night</h1>", "imported, from desk night.csv", "24000 samples", "tells no time of day"] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("capture 1") && !page.contains("temporary") && !page.contains("vn100d.db"), "{page}");
    let output = run(&["plot", "desk night.csv", "allan-accel_z", "--out", "a.svg"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(place.text("a.svg").starts_with("<svg"));
    assert_eq!(std::fs::read_dir(&temporary).unwrap().count(), 0, "something stayed behind");
    assert!(!elsewhere.exists());
    // A row that is no sample is rejected: the report is made, with a remark.
    let mut text = place.text("desk night.csv");
    text.push_str("600.5,what is this\n");
    std::fs::write(place.path("odd.csv"), text).unwrap();
    for arguments in [["report", "odd.csv", "--out", "odd.html"], ["plot", "odd.csv", "gaps", "--out"]] {
        let mut arguments = arguments.to_vec();
        if arguments[0] == "plot" {
            arguments.push("odd.svg");
        }
        let output = run(&arguments);
        assert_eq!(output.status.code(), Some(3), "{arguments:?}: {}", stderr(&output));
    }
    // Rows without stamps have the stated rate.
    std::fs::write(place.path("bare.csv"), "gyro_x_rad_s\n".to_owned() + &"0.001\n0.002\n".repeat(200)).unwrap();
    let output = run(&["plot", "bare.csv", "timeseries-gyro_x", "--rate", "100", "--out", "bare.svg"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(place.text("bare.svg").contains(">3</text>"), "{}", place.text("bare.svg"));
}

#[test]
fn what_is_not_there_is_refused_and_no_file_is_made() {
    let place = place();
    let before = place.files();
    refused(&place, 2, &["plot", "latest", "allan", "--out", "a.svg"], "timeseries-<channel>");
    refused(&place, 2, &["plot", "latest", "gaps", "--out", "a.pdf"], ".svg or .png");
    refused(
        &place,
        2,
        &["plot", "latest", "gaps", "--channels", "gyro_x", "--out", "a.svg"],
        "--channels is not for a plot",
    );
    refused(&place, 2, &["plot", "latest", "gaps", "--out", "-", "--json"], "both want standard output");
    refused(&place, 2, &["plot", "latest", "timeseries-gyro_x", "--from", "noon", "--out", "a.svg"], "RFC 3339");
    refused(&place, 2, &["plot", "latest", "gaps"], "--out");
    refused(&place, 2, &["report", "latest", "--out", "a.pdf"], ".html");
    refused(&place, 2, &["report", "model.json", "--out", "model.json"], "--out model.json");
    refused(
        &place,
        1,
        &["plot", "latest", "timeseries-mag_x", "--out", "a.svg"],
        "does not have: it has accel_z, gyro_x",
    );
    refused(&place, 1, &["plot", "latest", "psd-accel", "--out", "a.svg"], "needs accel_x");
    refused(&place, 1, &["plot", "latest", "timeseries-gyro_x", "--from", "9000", "--out", "a.svg"], "not enough data");
    refused(&place, 1, &["plot", "nobody", "gaps", "--out", "a.svg"], "nobody");
    refused(&place, 1, &["report", "nobody", "--out", "a.html"], "nobody");
    refused(&place, 1, &["report", "model.json", "--out", "a.html"], "model.json");
    assert_eq!(place.files(), before);
    place.done(&["plot", "latest", "gaps", "--out", "a.svg"]);
    refused(&place, 73, &["plot", "latest", "gaps", "--out", "a.svg"], "--force");
    place.done(&["plot", "latest", "gaps", "--out", "a.svg", "--force"]);
}

/// A few samples do not show any noise: the page states that and has the other sections.
#[test]
fn a_report_of_little_states_what_is_lacking() {
    let place = Place::new();
    std::fs::write(place.path("few.csv"), "time_s,gyro_x_rad_s\n0,0.1\n0.025,0.2\n0.05,0.3\n").unwrap();
    place.done(&["report", "few.csv", "--out", "few.html"]);
    let page = place.text("few.html");
    assert!(page.contains("3 samples") && page.contains("class=\"remark\""), "{page}");
}

#[test]
fn a_capture_that_runs_is_drawn_beside_the_daemon_that_writes_it() {
    let world = World::new();
    let emulator = world.emulate(&["--speed", "200"]);
    let daemon = world.daemon("", &["--speed", "200", "--capture", "10h"]);
    let samples = || world.try_get("/v1/status")?["capture"]["samples"].as_u64().filter(|samples| *samples > 12_000);
    world.until("samples", PATIENCE, samples, &daemon);
    let (data, page) = (world.database(), world.path("page.html"));
    let data = data.parent().unwrap().to_str().unwrap();
    let run = |arguments: &[&str]| {
        let output = vn100d(&[&["--data-dir", data], arguments].concat());
        // Bytes before the first frame may have been rejected.
        assert!(matches!(output.status.code(), Some(0 | 3)), "{arguments:?}: {}", stderr(&output));
    };
    run(&["report", "latest", "--out", page.to_str().unwrap()]);
    let page = std::fs::read_to_string(page).unwrap();
    assert!(
        page.contains("It still runs: this is what there is so far.") && page.contains("Noise parameters"),
        "{page}"
    );
    let plot = world.path("a.png");
    run(&["plot", "latest", "allan-gyro", "--out", plot.to_str().unwrap()]);
    assert_eq!(pixels(&std::fs::read(plot).unwrap()), [1680, 1080]);
    // The writer continues.
    let then = samples();
    world.until("more samples", PATIENCE, || Some(()).filter(|()| samples() > then), &daemon);
    drop(emulator);
}

/// A sheet of a model against nights that it was fitted to, that it predicts, and that it does not.
#[test]
fn a_validation_sheet_states_the_error_and_where_nothing_is_known() {
    let place = Place::new();
    let unit = |n: f64| {
        let gyro = format!(r#"{{"N": {n}, "uncertainty": {{"N": {{"ci95": [{}, {}]}}}}}}"#, 0.97 * n, 1.03 * n);
        format!(
            r#"{{"format": "vn100d-sensor-model-1", "name": "<b>unit", "rate_hz": 40, "provenance": {{"capture": "own.csv"}},
                "channels": {{"gyro_x": {gyro}, "gyro_y": {gyro}, "gyro_z": {gyro}}}}}"#
        )
    };
    std::fs::write(place.path("unit.json"), unit(1e-4)).unwrap();
    std::fs::write(place.path("loud.json"), unit(3e-4)).unwrap();
    for (name, seed) in [("own.csv", "1"), ("night.csv", "2"), ("second.csv", "3")] {
        place.done(&["simulate", "--model", "unit.json", "--duration", "20min", "--seed", seed, "--out", name]);
    }
    let sheet = |arguments: &[&str]| -> Value {
        let common = ["report", "--validation", "--json", "--horizons", "1s,10s"];
        serde_json::from_str(&place.done(&[&common[..], arguments].concat())).unwrap()
    };
    let valid = sheet(&["--model", "unit.json", "night.csv", "second.csv", "--out", "valid.html"]);
    assert_eq!((&valid["format"], &valid["verdict"]), (&"vn100d-validation-1".into(), &"validated".into()), "{valid}");
    let heading = &valid["quantities"]["heading"][1]["rms"];
    let number = |key: &str| heading[key].as_f64().unwrap();
    // N·√(t + t²/align), and the whole of E inside its interval.
    assert!((number("predicted") / (1e-4 * (10.0_f64 + 100.0 / 30.0).sqrt()) - 1.0).abs() < 1e-3, "{heading}");
    assert!((number("error") - (number("predicted") - number("measured"))).abs() < 1e-12 && number("u_val") > 0.0);
    assert_eq!(valid["envelope"]["recordings"].as_array().map(Vec::len), Some(2));
    let page = place.text("valid.html");
    for part in [
        "Error of the model",
        "What the data cover",
        "Where the model has not been validated",
        "NASA-STD-7009A",
        "<svg",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("<b>unit") && !page.contains("NaN") && !page.contains("http"), "{page}");
    let own = sheet(&["--model", "unit.json", "own.csv", "--out", "own.html"]);
    assert!(own["verdict"] == "undecided" && own["reason"].as_str().unwrap().contains("fitted to"), "{own}");
    let loud = sheet(&["--model", "loud.json", "night.csv", "--out", "loud.html"]);
    assert_eq!(loud["verdict"], "not_valid", "{loud}");
    let limited =
        ["report", "--validation", "--model", "loud.json", "night.csv", "--out", "limited.html", "--horizons", "1s"];
    let missed = [&limited[..], &["--tolerance", "heading=1e-9deg/1s", "--check"]].concat();
    assert_eq!(place.run(&missed).status.code(), Some(4));
    place.done(&[&limited[..], &["--tolerance", "heading=5deg/1s", "--check", "--force"]].concat());
    for (arguments, code, why) in [
        (&["report", "--validation", "night.csv", "--out", "a.html"][..], 2, "--model"),
        (&["report", "night.csv", "second.csv", "--out", "a.html"], 2, "several are for --validation"),
        (&["report", "night.csv", "--horizons", "1s", "--out", "a.html"], 2, "--validation"),
        (
            &["report", "--validation", "--model", "unit.json", "night.csv", "--out", "a.html", "--horizons", "1h"],
            1,
            "disjoint pieces",
        ),
        (&["report", "--validation", "--model", "unit.json", "night.csv", "--out", "night.csv", "--force"], 2, "html"),
        (
            &["report", "--validation", "--model", "unit.json", "night.csv", "--out", "a.html", "--horizons", "10s,1s"],
            2,
            "increasing",
        ),
    ] {
        refused(&place, code, arguments, why);
    }
}
