//! The page as a whole.

use super::*;
use serde::Deserialize as _;
use serde_json::{Value, json};

fn report() -> Value {
    json!({
        "format": "vn100d-diagnosis-1", "verdict": "effects", "summary": "accel_z: a 11.400 Hz tone <b> that the model lacks",
        "discrepancy": {"unit": "nats/sample", "before": 3.5e-4, "after_parameters": 3.4e-4, "after": -1e-7, "floor": 4.6e-6,
            "p_value_after": 0.4, "closed": 0.994, "closed_ci95": [0.98, 1.007], "measured_on": "second half"},
        "where": [{"channel": "accel_z", "band_hz": [11.1, 11.6], "tau_s": [0.03, 0.06], "from_s": 0, "to_s": 3600,
            "share": 0.98, "sign": "real noisier"}],
        "parameters": [{"channel": "gyro_x", "parameter": "N", "model": 1e-4, "capture": 1.2e-4, "ratio": 1.2,
            "ci95": [1.19e-4, 1.21e-4]}],
        "causes": [
            {"effect": "tone", "channels": ["accel_z"], "confidence": 0.999, "closes": 0.96,
             "parameters": {"accel_z": {"frequency_hz": 11.4, "amplitude": 0.002}},
             "uncertainty": {"accel_z": [{"amplitude": [0.0019, 0.0021]}]}, "evidence": ["2173 nats & more"]},
            {"effect": "bursts", "channels": ["gyro_x", "gyro_y"], "confidence": 0.5, "closes": null,
             "parameters": {"gyro_x": {"intervals": [[1, 2]], "sigma": 1e-3}, "gyro_y": vec![json!({"sigma": 1}); 9]},
             "evidence": []}],
        "alternatives": [{"effect": "resonance", "channels": ["accel_z"], "closes": null, "why_not": "355 nats less"}],
        "per_channel": {"accel_z": {"before": 1e-3, "after": 1e-6, "floor": 1e-6}, "gyro_x": {"before": 0, "after": 0, "floor": 0}},
        "notes": ["not compared: mag_x"], "software": "vn100d 0", "inputs": {"real": "night", "sim": "unit 7"}
    })
}

fn spectra() -> Value {
    let of = |channel: &str| {
        json!({"channel": channel, "unit": "m/s²", "frequency_hz": [0.1, 1, 10], "real": [1, 2, 3],
               "before": [1, 2, 2], "after": null})
    };
    json!([of("accel_z"), of("accel_y")])
}

fn drawn(spectra: &Value) -> Value {
    json!({"spectra": spectra})
}

/// Returns the page of stored documents.
fn page_of(report: &Value, drawings: &Value, links: Links<'_>) -> String {
    let report = Diagnosis::deserialize(report).unwrap();
    diagnosis(&report, &Drawings::deserialize(drawings).unwrap(), links)
}

#[test]
fn residuals_of_a_motion_are_drawn_before_and_after() {
    let of = |channel: &str| {
        json!({"channel": channel, "unit": "m/s²", "against": "specific force", "axis": "z", "at_unit": "m/s²",
               "at": [-9.8, 0, 9.8], "before": [0.1, 0, -0.1], "after": [0, 1e-4, 0]})
    };
    let drawn = json!({"residuals": [of("accel_z"), of("accel_y")]});
    let page = page_of(&report(), &drawn, &[]);
    let at = |part: &str| page.find(part).unwrap_or_else(|| panic!("{part} is not in {page}"));
    assert!(at("aria-label=\"accel_z against the specific force along z") < at("without a finding: accel_y"));
    assert!(at("without a finding: accel_y") < at("aria-label=\"accel_y against the specific force along z"));
}

#[test]
fn the_sentence_comes_first_and_every_part_is_there_without_anything_from_elsewhere() {
    let links = [("as JSON", "/v1/diagnoses/7".to_owned())];
    let page = page_of(&report(), &drawn(&spectra()), &links);
    let at = |part: &str| page.find(part).unwrap_or_else(|| panic!("{part} is not in {page}"));
    assert!(at("<h1>accel_z: a 11.400 Hz tone &lt;b&gt;") < at("The gap, in nats/sample"));
    assert!(at("the model as it is") < at("What the model lacks"));
    for part in [
        "99 % of the gap is closed (95 % interval 98 % to 100 %)",
        "<code>amplitude</code> 0.002 (0.0019 to 0.0021) m/s²",
        "<code>frequency_hz</code> 11.4",
        "gyro_y: and 3 more",
        "2173 nats &amp; more",
        "11.1 to 11.6",
        "355 nats less",
        "not compared: mag_x",
        "without a finding: accel_y",
        "href=\"/v1/diagnoses/7\"",
        "1.2·10⁻⁴ (1.19·10⁻⁴ to 1.21·10⁻⁴)",
    ] {
        at(part);
    }
    for absent in ["<b> that", "<script>", "http:", "https:", "url(", "NaN"] {
        assert!(!page.contains(absent), "{absent}");
    }
    for tag in ["table", "ul", "div", "figure", "svg", "details", "li", "tr"] {
        let (open, close) = (page.matches(&format!("<{tag}")).count(), page.matches(&format!("</{tag}>")).count());
        assert!(open >= close && close > 0, "{tag}: {open} and {close}");
    }
}

#[test]
fn what_the_gap_costs_is_a_table_with_a_bar_for_each_cause() {
    let mut own = report();
    own["discrepancy"]["cost"] = json!({"align_s": 30, "horizons_s": [10, 600], "notes": ["no <position>"], "quantities": {
        "heading": {"unit": "rad", "before": [1e-4, 1e-3], "after": [2e-4, 0.01746], "after_ci95": [[1e-4, 3e-4], [0.017, 0.018]],
            "floor": [1e-4, 1e-3], "floor_ci95": null},
        "of_a_later_version": {"unit": "rad", "before": [1], "after": [1], "after_ci95": null, "floor": [1], "floor_ci95": null}}});
    own["causes"][0]["cost"] = json!({"heading": {"share": [0.1, 0.873], "band95_without": [1e-4, 1e-3]}});
    let page = page_of(&own, &json!({}), &[]);
    let at = |part: &str| page.find(part).unwrap_or_else(|| panic!("{part} is not in {page}"));
    assert!(at("What the model lacks") < at("What it costs without aid"));
    for part in ["after 10m", "1.00° (0.974° to 1.03°)", "heading: tone", "87&nbsp;%", "no &lt;position&gt;"] {
        at(part);
    }
    assert!(!page_of(&report(), &json!({}), &[]).contains("without aid"), "reports of earlier versions have no cost");
}

#[test]
fn pieces_of_the_recording_are_drawn_beside_both_models_per_triad() {
    let mut own = report();
    let pieces = json!({"independent": 9.5, "rms": 1e-3, "rms_ci95": [7e-4, 1.6e-3], "before_rms": 4e-4, "after_rms": 1.1e-3,
        "before_coverage": 0.5, "after_coverage": 0.94, "after_coverage_ci95": [0.7, 0.99]});
    let bands = json!({"unit": "rad", "before": [1e-3], "after": [2e-3], "after_ci95": null, "floor": [1e-3], "floor_ci95": null});
    own["discrepancy"]["cost"] = json!({"align_s": 30, "horizons_s": [10], "notes": [], "quantities": {"heading": bands},
        "measured": {"horizons_s": [1, 10], "notes": ["<note>"], "quantities": {"heading": [pieces, pieces], "velocity_x": [null, null],
            "of_a_later_version": [null, null]}}});
    let page = page_of(&own, &json!({}), &[]);
    let at = |part: &str| page.find(part).unwrap_or_else(|| panic!("{part} is not in {page}"));
    assert!(at("Gyroscope: growth of errors") < at("root mean square in °"));
    for part in ["50 → 94&nbsp;%", "(70 to 99)", "&lt;note&gt;", "aria-label=\"heading"] {
        at(part);
    }
    assert!(!page.contains("Accelerometer: growth"), "nothing was measured there");
}

#[test]
fn what_has_no_name_is_shown_with_its_share() {
    let mut own = report();
    own["remainder"] = json!({"share": 0.0123, "nats": 1e-4, "channels": ["mag_x"], "what": ["power <in> one octave"]});
    let page = page_of(&own, &json!({}), &[]);
    assert!(page.contains("Without a name") && page.contains("1.23 % of the gap, on mag_x"), "{page}");
    assert!(page.contains("power &lt;in&gt; one octave"), "{page}");
    assert!(!page_of(&report(), &json!({}), &[]).contains("Without a name"));
}

#[test]
fn a_report_of_little_is_shown_and_no_report_is_refused() {
    let mut little = report();
    for key in ["where", "parameters", "causes", "alternatives", "notes"] {
        little[key] = json!([]);
    }
    little["per_channel"] = json!({});
    little["discrepancy"]["closed"] = Value::Null;
    let page = page_of(&little, &json!({}), &[]);
    assert!(!page.contains("What the model lacks") && !page.contains("is closed"), "{page}");
    assert!(Diagnosis::deserialize(json!({})).is_err());
}

#[test]
fn what_was_not_finite_is_a_dash_and_loses_nothing_else() {
    let mut report = report();
    report["discrepancy"]["after"] = Value::Null;
    report["where"][0]["band_hz"] = json!([null, 11.6]);
    report["where"][0]["to_s"] = Value::Null;
    report["causes"][1]["confidence"] = Value::Null;
    report["per_channel"]["accel_z"]["after"] = Value::Null;
    let mut spectra = spectra();
    spectra[0]["real"][1] = Value::Null;
    let page = page_of(&report, &drawn(&spectra), &[]);
    assert!(!page.contains("NaN") && !page.contains("inf"), "{page}");
    for part in ["– to 11.6", "0 to –", "<td class=\"number\">–</td>", "0.001 → –<", "11.4"] {
        assert!(page.contains(part), "{part} is not in {page}");
    }
}
