use super::*;
use crate::jobs::StatisticsReport;
use crate::page::rows::{self, BEGUN_NS};
use crate::store::{ModelEntry, UtcNs};
use imu_core::sample::GapCause;
use imu_core::sample::audit::{CountFacts, audit};
use imu_noise::NoiseReport;
use serde_json::{Value, json};

fn facts() -> Facts {
    let counts = CountFacts { received: None, committed: 0, in_flight: 0, discarded: [].into(), counters: [0; 4] };
    let mut accounting = audit(&[], &[], counts);
    (accounting.holds, accounting.violations) = (false, vec!["7 < 8".to_owned()]);
    let gap = GapRow {
        from: UtcNs(BEGUN_NS + 3_600_000_000_000),
        to: UtcNs(BEGUN_NS + 3_600_250_000_000),
        missing: 10,
        missing_exact: true,
        cause: GapCause::HostStall,
        before_seq: 1,
        from_device_ns: None,
        to_device_ns: None,
    };
    let (kind, message) = ("connected".to_owned(), "<b>connected".to_owned());
    let event = EventRow { at: UtcNs(BEGUN_NS), kind, message, detail: None };
    let causes = [("host_stall".to_owned(), 10)].into();
    Facts { row: rows::capture(), accounting, gaps: vec![gap], causes, events: vec![event], longest: 1000 }
}

/// Returns four channels: one with everything, except where `changed` differs, one whose record is too short, one in
/// motion.
fn noise(changed: Value) -> NoiseReport {
    let unknown = |unit: &str| json!({"value": null, "identified": false, "unit": unit});
    let n = json!({"value": 1e-4, "ci95": [0.9e-4, 1.1e-4], "identified": true, "unit": "rad/s/√Hz", "also": {"deg/√h": 0.34377}});
    let k = json!({"value": null, "upper_limit95": 1.5e-6, "identified": false, "unit": "rad/s/√s"});
    let b = json!({"value": 2.6e-5, "ci95": [2.4e-5, 2.8e-5], "identified": true, "unit": "rad/s"});
    let minimum = json!({"deviation": 1.8e-5, "tau_s": 120.0, "over_0_664": 2.7e-5});
    let curve = json!({"tau_s": [0.025, 4500.0], "deviation": [1e-4, 1e-5], "parts": {}});
    let mut own = json!({"unit": "rad/s", "N": n, "B": b, "K": k, "Q": unknown("rad"), "R": unknown("rad/s/s"),
        "gauss_markov": null, "minimum": minimum, "record_needed": {"B": 2400.0, "K": null}, "walk_shows_beyond_s": 432.0,
        "fit": {"method": "whittle-dst", "curve": curve}, "flags": [{"kind": "knock", "from_s": 1.0, "to_s": 2.0, "note": "a <note>"}]});
    own.as_object_mut().unwrap().extend(changed.as_object().unwrap().clone());
    let plain = |flags: Value| {
        json!({"unit": "rad/s", "N": unknown("rad/s/√Hz"), "B": unknown("rad/s"), "K": unknown("rad/s/√s"), "Q": unknown("rad"),
            "R": unknown("rad/s/s"), "gauss_markov": null, "fit": {"method": "whittle-dst"}, "flags": flags})
    };
    let moved = json!([{"kind": "not_at_rest", "note": "it moved"}]);
    let disturbed = |deviation: f64, tau_s: f64| {
        json!({"with_disturbances": null, "excluded_s": 0.0, "excluded_intervals_s": [], "excluded_bands_hz": [], "lines": [],
            "drift": null, "temperature": null, "dynamic": null,
            "allan_minimum": {"deviation": deviation, "ci68_low": deviation, "tau_s": tau_s}})
    };
    let report = json!({"format": NoiseReport::FORMAT, "capture": "a", "rate_hz": 40.0, "duration_s": 1600.0, "samples": 64_000,
        "missing": 0, "complete": true,
        "channels": {"gyro_x": own, "gyro_y": plain(json!([])), "gyro_z": plain(moved)},
        "disturbances": {"gyro_x": disturbed(9e-5, 50.0), "gyro_y": disturbed(9e-5, 400.0)}, "datasheet": null});
    serde_json::from_value(report).unwrap()
}

fn statistics() -> StatisticsReport {
    let of = json!({"unit": "rad/s", "n": 2, "not_finite": 0, "mean": 1e-3, "std": 2e-3, "min": -0.01, "max": 0.01, "skewness": 0.01,
        "kurtosis": -0.02, "histogram": {"edges": [], "counts": []},
        "normality": {"test": "jarque-bera", "statistic": 1.0, "p_value": 0.3, "verdict": "normal"}});
    let report = json!({"format": StatisticsReport::FORMAT, "capture": "a", "duration_s": 1.0, "samples": 2, "missing": 0,
        "complete": true, "channels": {"gyro_x": of}});
    serde_json::from_value(report).unwrap()
}

fn shown(served: Option<bool>, figures: &BTreeMap<String, Figure>) -> String {
    page_of(noise(json!({})), served, figures)
}

fn page_of(noise: NoiseReport, served: Option<bool>, figures: &BTreeMap<String, Figure>) -> String {
    let created_at = UtcNs(BEGUN_NS);
    let models = [ModelEntry { id: "model-1".to_owned(), name: "<unit>".to_owned(), rate_hz: 40.0, created_at }];
    let captures = [CaptureRow { id: 3, name: "<before>".to_owned(), ..rows::capture() }];
    let served = served.map(|token| Served { token, models: &models, captures: &captures });
    capture(&CaptureView {
        facts: &facts(),
        is_kept: true,
        documents: &Documents { statistics: Some(statistics()), allan: None, noise: Some(noise) },
        remarks: &["the Allan deviation is <being> computed".to_owned()],
        waits: false,
        diagnoses: &[rows::diagnosis("a <tone> is missing")],
        figures,
        served,
        enclosed: &[],
    })
}

#[test]
fn everything_that_is_known_is_shown_and_nothing_is_markup() {
    let linked = |name: &str| {
        let address = format!("/v1/captures/7/plots/{name}.svg");
        (name.to_owned(), Figure::Linked { alt: "<told>".to_owned(), address, height: 280 })
    };
    let figures =
        ["gaps", "allan-gyro", "hourly-gyro_x", "psd-gyro", "timeseries-temperature", "histogram-gyro_x"].map(linked);
    let page = shown(Some(true), &BTreeMap::from(figures));
    for expected in [
        "5 h at 40 Hz: 719990 samples, 10 missing (less than 1 %) in 1 gap",
        "2026-11-23 20:00:00 to 2026-11-24 01:00:00 UTC",
        "<p class=\"note\">on &lt;foam&gt;, 23 °C</p>",
        "data-method=\"PATCH\"",
        "name=\"note\" maxlength=\"1000\" size=\"40\" value=\"on &lt;foam&gt;, 23 °C\"",
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
        "<span class=\"soft\">too short to tell: ",
        " min of recording at rest would do</span>",
        "<span class=\"soft\">not at rest</span>",
        "<a href=\"/v1/captures/7/noise?format=kalibr\">kalibr</a></th>",
        "<details><summary>1 knock</summary>Knock at 1.00–2.00 s: a &lt;note&gt;.</details>",
        "<span class=\"bad\">above</span>",
        "normal (p = 0.3)",
        "a &lt;tone&gt; is missing",
        "&lt;4&gt;",
        "VN-100T &lt;42&gt;",
        "href=\"/captures/7/series/gyro_x\"",
        "class=\"token\"",
        "<option value=\"model-1\">model-1 (&lt;unit&gt;)</option>",
        "<optgroup label=\"captures that a simulator made\"><option value=\"3\">&lt;before&gt;</option></optgroup>",
        "action=\"/compare\"><input type=\"hidden\" name=\"a\" value=\"7\">",
        "<input name=\"reference\" type=\"file\"",
        "<select name=\"reference_axis\"",
        "<figcaption><a href=\"/v1/captures/7/plots/allan-gyro.png\">PNG</a></figcaption>",
    ] {
        assert!(page.contains(expected), "{expected}: {page}");
    }
    assert_eq!(page.matches("<img ").count(), 6, "{page}");
    for markup in ["<unit>", "<before>", "<script>", "<told>", "<tone>", "<b>", "<note>", "<foam>", "<42>", "<being>"] {
        assert!(!page.contains(markup), "{markup}");
    }
}

#[test]
fn a_file_has_its_pictures_in_it_and_nothing_from_elsewhere() {
    let figures = BTreeMap::from([("allan-gyro".to_owned(), Figure::Drawn("<svg id=\"own\"></svg>".to_owned()))]);
    let page = shown(None, &figures);
    assert!(page.contains("<figure><svg id=\"own\"></svg></figure>"), "{page}");
    assert!(page.contains("on &lt;foam&gt;, 23 °C</p>"), "{page}");
    assert!(!page.contains("<details>") && page.contains("<details open>"), "what is closed on paper is lost: {page}");
    for foreign in ["<script", "<img", "href=\"/", "<form", "http-equiv"] {
        assert!(!page.contains(foreign), "{foreign}: {page}");
    }
}

#[test]
fn what_is_not_usable_is_first_marked_as_such_with_the_reason() {
    let n = json!({"value": 1e-4, "ci95": [0.9e-4, 1.1e-4], "identified": true, "unit": "rad/s/√Hz", "internal": 4e-5,
        "source": "allan deviation"});
    let bandwidth =
        json!({"kind": "low_pass", "value": 12.5, "unit": "Hz", "order": 2, "ci95": [12.0, 13.0], "source": "fitted"});
    let noise =
        noise(json!({"usable": false, "reason": "<it> predicts another deviation", "N": n, "bandwidth": bandwidth}));
    let page = page_of(noise.clone(), None, &BTreeMap::new());
    for expected in [
        "<td colspan=\"3\"><strong class=\"bad\">not usable: &lt;it&gt; predicts another deviation</strong><br>",
        "9·10⁻⁵ to 1.1·10⁻⁴</span></div><div class=\"soft\">from the Allan deviation alone</div>",
        "Behind a low pass of order 2 at 12.5000 Hz [12.0000, 13.0000] (fitted).",
        "The sensor's own density is 4·10⁻⁵ rad/s/√Hz.",
        "<h2>Which number to paste where</h2>",
        "<th scope=\"row\">kalibr</th>",
    ] {
        assert!(page.contains(expected), "{expected}: {page}");
    }
    assert!(!page.contains("record at rest and without a gap") && !page.contains("No random walk"), "{page}");
    let served = page_of(noise, Some(false), &BTreeMap::new());
    assert!(served.contains("not usable: &lt;it&gt;") && !shown(Some(false), &BTreeMap::new()).contains("not usable"));
}
