//! Acceptance in continuous integration: limits of `diagnose` and `noise`, exit code 4, and the JUnit report.

use crate::world::vn100d;
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;
use vn100_testkit::tool;

/// Returns standard output and standard error of a program that ended with this code.
fn ended(arguments: &[&str], code: i32) -> (String, String) {
    let ended = vn100d(arguments);
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    let (stdout, stderr) = (text(ended.stdout), text(ended.stderr));
    assert_eq!(ended.status.code(), Some(code), "{arguments:?}: {stderr}\n{stdout}");
    (stdout, stderr)
}

fn path(folder: &Path, name: &str) -> String {
    folder.join(name).to_str().unwrap().to_owned()
}

/// Writes a model of one gyroscope axis with these effects.
fn model(folder: &Path, name: &str, effects: &Value) -> String {
    let file = path(folder, name);
    let channels = json!({"gyro_x": {"N": 1e-4, "effects": effects}});
    let model = json!({"format": "vn100d-sensor-model-1", "name": "unit", "rate_hz": 40, "channels": channels});
    std::fs::write(&file, model.to_string()).unwrap();
    file
}

/// Writes a recording of ten minutes that a model makes.
fn recorded(folder: &Path, name: &str, model: &str) -> String {
    let file = path(folder, name);
    ended(&["simulate", "--model", model, "--duration", "10min", "--seed", "5", "--out", &file], 0);
    file
}

/// Returns a JUnit report as Python's own parser reads it: root, counts, and for each case name, failure and message.
fn parsed(report: &str) -> Option<Value> {
    const READ: &str = "\
import json, sys, xml.etree.ElementTree as tree
root = tree.parse(sys.argv[1]).getroot()
suites = root.findall('testsuite')
cases = [{'name': case.get('name'), 'class': case.get('classname'), 'inside': [part.tag for part in case],
          'message': [part.get('message') for part in case], 'text': [part.text for part in case]}
         for suite in suites for case in suite.findall('testcase')]
properties = {one.get('name'): one.get('value') for one in root.iter('property')}
print(json.dumps({'root': root.tag, 'suites': [dict(suite.attrib) for suite in suites], 'cases': cases,
                  'properties': properties, 'out': root.findtext('testsuite/system-out')}))";
    if !tool(Command::new("python3").arg("--version").output().is_ok(), "acceptance", "python3 reads the reports") {
        return None;
    }
    let read = Command::new("python3").args(["-c", READ, report]).output().unwrap();
    assert!(read.status.success(), "{report}: {}", String::from_utf8_lossy(&read.stderr));
    Some(serde_json::from_slice(&read.stdout).unwrap())
}

#[test]
fn a_model_that_lacks_a_tone_misses_its_limits_and_one_that_has_it_meets_them() {
    let folder = tempfile::tempdir().unwrap();
    let plain = model(folder.path(), "plain.json", &json!([]));
    let whole =
        model(folder.path(), "whole.json", &json!([{"effect": "tone", "frequency_hz": 11.4, "amplitude": 5e-4}]));
    let real = recorded(folder.path(), "real.csv", &whole);
    let report = path(folder.path(), "limits.xml");
    let limits = ["--at-most", "gap=0.002,closed=0.5", "--at-most", "remainder=0.02"];
    let with = |sim: &str, more: &[&str], code| {
        ended(&[&["diagnose", "--real", &real, "--sim", sim, "--junit", &report, "--force"], more].concat(), code)
    };

    let (stdout, _) = with(&plain, &limits, 4);
    assert!(stdout.contains("FAIL: gap is ") && stdout.contains("at most 0.002 nats/sample is asked for"), "{stdout}");
    assert!(stdout.contains("FAIL: closed is ") && stdout.contains("pass: remainder is 0"), "{stdout}");
    if let Some(found) = parsed(&report) {
        assert_eq!((found["root"].as_str(), found["suites"].as_array().map(Vec::len)), (Some("testsuites"), Some(1)));
        let suite = &found["suites"][0];
        assert_eq!((suite["tests"].as_str(), suite["failures"].as_str()), (Some("3"), Some("2")), "{found}");
        assert_eq!(found["cases"][0]["name"], "gap at most 0.002 nats/sample");
        assert_eq!(found["cases"][0]["inside"], json!(["failure"]));
        assert!(found["cases"][0]["text"][0].as_str().unwrap().contains("tone"), "{found}");
        assert_eq!(found["cases"][2]["inside"], json!([]));
        assert!(found["properties"]["sim"].as_str().unwrap().ends_with("plain.json"), "{found}");
    }

    // The model that made the recording: there is no gap, so nothing can be closed.
    let (stdout, _) = with(&whole, &limits, 0);
    assert!(!stdout.contains("FAIL") && stdout.contains("pass: closed has no number"), "{stdout}");
    let (stdout, _) = with(&whole, &["--at-least", "closed=0.9"], 0);
    assert!(stdout.contains("there was no gap for an effect to close"), "{stdout}");
    if let Some(found) = parsed(&report) {
        assert_eq!(found["suites"][0]["failures"], "0", "{found}");
    }

    // What the diagnosis found closes the gap.
    let (stdout, stderr) = with(&plain, &["--json", "--at-least", "closed=0.9", "--at-most", "after=1e-9"], 4);
    let document: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(document["format"], "vn100d-diagnosis-1");
    let [closed, after] = [&document["limits"][0], &document["limits"][1]];
    assert_eq!((closed["verdict"].as_str(), closed["bound"].as_str()), (Some("met"), Some("at_least")), "{closed}");
    assert_eq!(closed["value"], document["discrepancy"]["closed"]);
    assert_eq!((after["verdict"].as_str(), &after["value"]), (Some("missed"), &document["discrepancy"]["after"]));
    assert!(stderr.contains("FAIL: after is ") && !stderr.contains("closed"), "{stderr}");
}

#[test]
fn wrong_limits_are_refused_in_a_sentence_before_anything_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let diagnose = ["diagnose", "--real", "nowhere.csv", "--sim", "nowhere.json"];
    for (limits, part) in [
        (&["--at-most", "gap=-1"][..], "`--at-most gap=-1`: expected NAME=NUMBER, a number for gap of 0 or more"),
        (&["--at-most", "gap=NaN"], "`--at-most gap=NaN`"),
        (&["--at-most", "gap=1,closed=7"], "a share of closed from 0 to 1"),
        (&["--at-most", "size=1"], "NAME one of gap, after_parameters, after, closed, remainder"),
        (&["--at-least", "closed"], "`--at-least closed`"),
        (&["--at-most", "gap=1,gap=2"], "gap has such a limit already"),
        (&["--junit", "out.xml"], "--at-most or --at-least"),
        (&["--junit", "a.xml", "--html", "./a.xml", "--at-most", "gap=1"], "cannot be both the page and the JUnit"),
    ] {
        let (_, stderr) = ended(&[&diagnose, limits].concat(), 2);
        assert!(stderr.contains(part) && stderr.lines().count() == 1, "{stderr}");
    }
    for (text, part) in [
        ("[gyro]\nB_deg_h = -8", "`gyro.B_deg_h` is -8: allowed are finite numbers above 0"),
        ("[gyro]\nB_deg_h = nan", "is NaN: allowed"),
        ("[gyro]\nB_mg = 8", "`gyro` has no key `B_mg`: allowed are N_rad_s_sqrt_hz"),
        ("[gyro]\nB_deg_h = 8\nB_rad_s = 1", "`gyro` has two limits on B"),
        ("[gyro_w]\nB_deg_h = 8", "no table `gyro_w`: allowed are gyro, accel, mag"),
        ("[temperature]\nB = 8", "no table `temperature`"),
        ("[gyro]\nB_deg_h = 'low'", "line 2"),
        ("[gyro]\nB_deg_h = 8\nB_deg_h = 9", "line 3"),
        ("", "there is no limit"),
    ] {
        let file = path(folder.path(), "limits.toml");
        std::fs::write(&file, text).unwrap();
        let (_, stderr) = ended(&["noise", "nowhere.csv", "--within", &file], 2);
        assert!(stderr.contains(part) && stderr.contains("limits.toml") && stderr.lines().count() == 1, "{stderr}");
    }
    let (_, stderr) = ended(&["noise", "nowhere.csv", "--within", &path(folder.path(), "none.toml")], 74);
    assert!(stderr.contains("none.toml"), "{stderr}");
    ended(&["noise", "nowhere.csv", "--junit", "out.xml"], 2);
}

#[test]
fn noise_is_judged_by_its_intervals() {
    let folder = tempfile::tempdir().unwrap();
    let made = model(folder.path(), "made.json", &json!([]));
    // A name with everything that XML, terminals and shells treat in their own way.
    let real = recorded(folder.path(), "a<b>&\"c\"'d']]>\u{1}\n.csv", &made);
    let report = path(folder.path(), "limits.xml");
    let limits = path(folder.path(), "limits.toml");
    let with = |text: &str, more: &[&str], code| {
        std::fs::write(&limits, text).unwrap();
        ended(&[&["noise", &real, "--within", &limits, "--junit", &report, "--force"], more].concat(), code)
    };

    // 1e-4 rad/s/√Hz is 0.344 deg/√h. The channel's own limit counts, not the triad's, which the other axes miss.
    let (stdout, _) = with("[gyro_x]\nN_deg_sqrt_h = 0.4\n", &[], 0);
    assert!(
        stdout.contains("pass: gyro_x N is 0.34") && stdout.contains("at most 0.4 deg/√h is asked for"),
        "{stdout}"
    );
    let (stdout, _) = with("[gyro]\nN_deg_sqrt_h = 0.4\n[gyro_x]\nN_rad_s_sqrt_hz = 5e-5\n", &[], 4);
    assert!(stdout.contains("FAIL: gyro_x N is 1.0") && stdout.contains("at most 0.00005 rad/s/√Hz"), "{stdout}");
    assert!(
        stdout.contains("FAIL: gyro_y N has no number") && stdout.contains("the capture has no gyro_y"),
        "{stdout}"
    );
    if let Some(found) = parsed(&report) {
        assert_eq!((&found["suites"][0]["tests"], &found["suites"][0]["failures"]), (&json!("3"), &json!("3")));
        let captures = found["properties"]["captures"].as_str().unwrap();
        assert!(captures.ends_with("a<b>&\"c\"'d']]>\u{fffd}\n.csv"), "{captures:?}");
        assert!(found["out"].as_str().unwrap().contains("'d']]>"), "{found}");
    }

    // The interval holds the limit itself: neither met nor missed.
    let (document, _) = with("[gyro_x]\nN_rad_s_sqrt_hz = 1\nK_rad_s_sqrt_s = 1\n", &["--json"], 0);
    let document: Value = serde_json::from_str(&document).unwrap();
    let verdicts: Vec<&str> =
        document["limits"].as_array().unwrap().iter().map(|one| one["verdict"].as_str().unwrap()).collect();
    assert_eq!((document["format"].as_str(), verdicts), (Some("vn100d-noise-1"), vec!["met", "met"]), "{document:#}");
    let own = document["channels"]["gyro_x"]["N"]["value"].as_f64().unwrap();
    let text = format!("[gyro_x]\nN_rad_s_sqrt_hz = {own}\nK_rad_s_sqrt_s = 1e-12\n");
    let (stdout, _) = with(&text, &[], 4);
    assert!(stdout.contains("NOT SHOWN: gyro_x N is") && stdout.contains("interval contains the limit"), "{stdout}");
    assert!(stdout.contains("NOT SHOWN: gyro_x K has no number") && stdout.contains("record for longer"), "{stdout}");
    let (_, stderr) = with(&text, &["--format", "kalibr", "--undecided", "reported"], 0);
    assert!(stderr.contains("NOT SHOWN: gyro_x N"), "{stderr}");
    if let Some(found) = parsed(&report) {
        let suite = &found["suites"][0];
        assert_eq!((&suite["failures"], &suite["skipped"]), (&json!("0"), &json!("2")), "{found}");
        assert_eq!(found["cases"][0]["inside"], json!(["skipped"]));
    }

    // A report that is there already stays without --force, and one that cannot be written is no missed limit.
    let (_, stderr) = ended(&["noise", &real, "--within", &limits, "--junit", &report], 73);
    assert!(stderr.contains("limits.xml exists already"), "{stderr}");
    ended(&["noise", &real, "--within", &limits, "--junit", &limits, "--force"], 2);
}
