use super::*;
use serde_json::json;

fn row() -> String {
    json!({"id": 7, "name": "<script>alert(1)", "state": "complete", "source": "/dev/ttyUSB0", "started_at": "2026-11-23T20:00:00.5Z",
        "ended_at": "2026-11-24T01:00:00Z", "duration_s": 18_000.0, "planned_duration_s": 18_000.0, "samples": 719_990, "missing": 10,
        "gaps": 1, "segments": 2, "rate_hz": 40.0, "pinned": false, "software": "vn100d 1", "channels": ["gyro_x", "temperature"],
        "rejected": {"checksum": 3}, "sensor": {"model": "VN-100T", "serial_number": "<42>"},
        "configuration": {"baud": 115_200, "filter_window": {"gyro": "<4>"}},
        "accounting": {"holds": false, "violations": ["7 < 8"]}})
    .to_string()
}

const GAPS: &str = r#"[{"from": "2026-11-23T21:00:00Z", "to": "2026-11-23T21:00:00.25Z", "missing": 10, "missing_exact": true,
    "cause": "host_stall"}]"#;
const EVENTS: &str = r#"[{"at": "2026-11-23T20:00:00Z", "kind": "connected", "message": "<b>connected"}]"#;

fn noise() -> String {
    document(json!({}))
}

/// One channel with everything, except where `changed` differs.
fn document(changed: serde_json::Value) -> String {
    let unknown = |unit: &str| json!({"value": null, "identified": false, "unit": unit});
    let n = json!({"value": 1e-4, "ci95": [0.9e-4, 1.1e-4], "identified": true, "unit": "rad/s/√Hz", "also": {"deg/√h": 0.34377}});
    let k = json!({"value": null, "upper_limit95": 1.5e-6, "identified": false, "unit": "rad/s/√s"});
    let density = json!({"measured": 1e-4, "datasheet": 6e-5, "printed": "0.0035 °/s/√Hz", "predicted": 1.1e-4, "ratio": 1.6, "ratio_to_predicted": 0.91,
        "unit": "rad/s/√Hz", "verdict": "explained_by_sampling"});
    let bias = json!({"allan_minimum": 9e-5, "tau_s": 100.0, "datasheet": 2e-5, "printed": "5 °/h", "ratio": 4.0, "unit": "rad/s",
        "verdict": "worse"});
    let short = json!({"allan_minimum": 9e-5, "tau_s": 100.0, "datasheet": 2e-5, "printed": "5 °/h", "ratio": 4.0, "unit": "rad/s",
        "verdict": "too_short", "needed_s": 720.0});
    let b = json!({"value": 2.6e-5, "ci95": [2.4e-5, 2.8e-5], "identified": true, "unit": "rad/s"});
    let minimum = json!({"deviation": 1.8e-5, "tau_s": 120.0, "over_0_664": 2.7e-5});
    let curve = json!({"tau_s": [0.025, 4500.0], "deviation": [1e-4, 1e-5], "parts": {}});
    let mut own = json!({"unit": "rad/s", "N": n, "B": b, "K": k, "Q": unknown("rad"), "R": unknown("rad/s/s"), "minimum": minimum,
        "record_needed": {"B": 2400.0, "K": null}, "walk_shows_beyond_s": 432.0, "fit": {"method": "whittle-dst", "curve": curve},
        "flags": [{"kind": "knock", "from_s": 1.0, "to_s": 2.0, "note": "a <note>"}]});
    own.as_object_mut().unwrap().extend(changed.as_object().unwrap().clone());
    let value = |value: f64| json!({"name": "gyroscope_noise_density", "of": "gyro", "noise": "white", "value": value, "unit": "rad/s/√Hz", "limit": true});
    let program = json!({"format": "kalibr", "program": "Kalibr's imu.yaml", "takes": "densities <N>", "source": "its wiki",
        "values": [value(1e-4)]});
    json!({"channels": {"gyro_x": own},
        "datasheet": {"name": "VN-100", "source": "User manual.", "channels": {"gyro_x": {"noise_density": density,
        "bias_stability": bias}, "gyro_y": {"bias_stability": short}, "gyro_z": {"verdict": "not_at_rest"}}},
        "paste": {"note": "Published values are <larger>.", "programs": [program]}})
    .to_string()
}

fn statistics() -> String {
    json!({"channels": {"gyro_x": {"unit": "rad/s", "mean": 1e-3, "std": 2e-3, "min": -0.01, "max": 0.01, "skewness": 0.01,
        "kurtosis": -0.02, "normality": {"p_value": 0.3, "verdict": "normal"}}}})
    .to_string()
}

fn shown(served: Option<bool>, figures: &BTreeMap<String, Figure>) -> String {
    page_of(&noise(), served, figures)
}

fn page_of(noise: &str, served: Option<bool>, figures: &BTreeMap<String, Figure>) -> String {
    let (row, statistics) = (row(), statistics());
    capture(&CaptureView {
        capture: &row,
        statistics: Some(&statistics),
        noise: Some(noise),
        remarks: &["the Allan deviation is <being> computed".to_owned()],
        waits: false,
        gaps: GAPS,
        causes: "{\"host_stall\": 10}",
        events: EVENTS,
        diagnoses: r#"[{"id": 9, "state": "done", "summary": "a <tone> is missing"}]"#,
        figures,
        served,
        enclosed: &[],
    })
    .unwrap()
}

#[test]
fn everything_that_is_known_is_told_and_nothing_is_markup() {
    let linked = |name: &str| {
        let address = format!("/v1/captures/7/plots/{name}.svg");
        (name.to_owned(), Figure::Linked { told: "<told>".to_owned(), address, height: 280 })
    };
    let figures =
        ["gaps", "allan-gyro", "hourly-gyro_x", "psd-gyro", "timeseries-temperature", "histogram-gyro_x"].map(linked);
    let page = shown(Some(true), &BTreeMap::from(figures));
    for told in [
        "5 h at 40 Hz: 719990 samples, 10 missing (less than 1 %) in 1 gap",
        "2026-11-23 20:00:00 to 2026-11-24 01:00:00 UTC",
        "7 &lt; 8",
        "host stall: 10 missing",
        "1·10⁻⁴&nbsp;rad/s/√Hz <span class=\"interval\">9·10⁻⁵ to 1.1·10⁻⁴</span>",
        "0.344&nbsp;deg/√h <span class=\"interval\">0.309 to 0.378</span>",
        "below 1.5·10⁻⁶ rad/s/√s",
        "explained by sampling",
        "Lowest Allan deviation 1.8·10⁻⁵ rad/s at 2 min; over 0.664 that is 2.7·10⁻⁵ rad/s, and B is at most this, to within the \
         scatter of the curve.",
        "To know a value to ±20 %, record at rest and without a gap: 40 min for B.",
        "No random walk is seen, hence no slope of +½: one as large as its limit, 1.5·10⁻⁶ rad/s/√s, would rise above the lowest \
         deviation beyond 7 min; this record's curve ends at 75 min, but its last points are of too few averages.",
        "<span class=\"soft\">too short to tell: 12 min of recording at rest would do</span>",
        "<span class=\"soft\">not at rest</span>",
        "<a href=\"/v1/captures/7/noise?format=kalibr\">kalibr</a></th><td>densities &lt;N&gt;</td><td>&lt; 1·10⁻⁴ rad/s/√Hz</td>",
        "Published values are &lt;larger&gt;.",
        "Knock at 1.00–2.00 s: a &lt;note&gt;.",
        "<span class=\"bad\">worse</span>",
        "normal (p = 0.3)",
        "a &lt;tone&gt; is missing",
        "&lt;4&gt;",
        "VN-100T &lt;42&gt;",
        "href=\"/captures/7/series/gyro_x\"",
        "class=\"token\"",
    ] {
        assert!(page.contains(told), "{told}: {page}");
    }
    assert_eq!(page.matches("<img ").count(), 6, "{page}");
    for markup in ["<script>", "<told>", "<tone>", "<b>", "<note>", "<42>", "<being>", "<N>", "<larger>"] {
        assert!(!page.contains(markup), "{markup}");
    }
}

#[test]
fn a_file_has_its_pictures_in_it_and_nothing_from_elsewhere() {
    let figures = BTreeMap::from([("allan-gyro".to_owned(), Figure::Drawn("<svg id=\"own\"></svg>".to_owned()))]);
    let page = shown(None, &figures);
    assert!(page.contains("<figure><svg id=\"own\"></svg></figure>"), "{page}");
    assert!(!page.contains("<details>") && page.contains("<details open>"), "what is closed on paper is lost: {page}");
    for foreign in ["<script", "<img", "href=\"/", "<form", "http-equiv"] {
        assert!(!page.contains(foreign), "{foreign}: {page}");
    }
}

#[test]
fn what_is_not_usable_says_so_first_and_why() {
    let n = json!({"value": 1e-4, "ci95": [0.9e-4, 1.1e-4], "identified": true, "unit": "rad/s/√Hz", "internal": 4e-5,
        "source": "allan deviation"});
    let bandwidth =
        json!({"kind": "low_pass", "value": 12.5, "unit": "Hz", "order": 2, "ci95": [12.0, 13.0], "source": "fitted"});
    let noise =
        document(json!({"usable": false, "reason": "<it> predicts another deviation", "N": n, "bandwidth": bandwidth}));
    let page = page_of(&noise, None, &BTreeMap::new());
    for told in [
        "<td colspan=\"3\"><strong class=\"bad\">not usable: &lt;it&gt; predicts another deviation</strong><br>",
        "9·10⁻⁵ to 1.1·10⁻⁴</span></div><div class=\"soft\">from the Allan deviation alone</div>",
        "Behind a low pass of order 2 at 12.5000 Hz [12.0000, 13.0000] (fitted).",
        "The sensor's own density is 4·10⁻⁵ rad/s/√Hz.",
        "<h2>Which number to paste where</h2>",
        "<th scope=\"row\">kalibr</th>",
    ] {
        assert!(page.contains(told), "{told}: {page}");
    }
    assert!(!page.contains("record at rest and without a gap") && !page.contains("No random walk"), "{page}");
    let served = page_of(&noise, Some(false), &BTreeMap::new());
    assert!(served.contains("not usable: &lt;it&gt;") && !shown(Some(false), &BTreeMap::new()).contains("not usable"));
}
