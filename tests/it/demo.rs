//! The demonstration, as in the README.

use crate::world::program;
use serde_json::Value;

#[test]
fn five_hours_pass_in_under_two_minutes_and_the_parameters_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let begun = std::time::Instant::now();
    let output = program()
        .args(["--data-dir", folder.path().to_str().unwrap(), "demo", "--once", "--listen", "127.0.0.1:0"])
        .output()
        .unwrap();
    let text = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{text}");
    assert!(text.contains("720000 samples, 0 missing"), "{text}");
    assert!(text.contains("/dev/pts/"), "{text}");
    // The sensor's hum is missing in the model; the diagnosis names it.
    let sentence = text.lines().find(|line| line.contains("that the model lacks")).unwrap_or_else(|| panic!("{text}"));
    assert!(sentence.trim().starts_with("accel_z: a 11.400 Hz tone of "), "{sentence}");
    for path in ["/v1/diagnoses/latest", "/diagnoses/latest"] {
        assert!(text.contains(path), "{path}: {text}");
    }
    // The promise is for the optimised program on two cores; tests run beside others, unoptimised.
    assert!(begun.elapsed().as_secs() < 300, "{:?}", begun.elapsed());

    let noise = program()
        .args(["--data-dir", folder.path().to_str().unwrap(), "noise", "latest", "--format", "json"])
        .output()
        .unwrap();
    let noise: Value = serde_json::from_slice(&noise.stdout).unwrap();
    let truth = [
        ("accel_x", 0.0021, 0.0011, 3.19e-4),
        ("accel_y", 0.0017, 5.3e-4, 7.39e-5),
        ("accel_z", 0.0028, 0.0018, 6.56e-4),
    ];
    for (channel, n, b, k) in truth {
        let found = &noise["channels"][channel];
        let value = found["N"]["value"].as_f64().unwrap();
        assert!((value / n - 1.0).abs() < 0.01, "{channel} N {value} instead of {n}");
        for (letter, truth) in [("B", b), ("K", k)] {
            let ends: Vec<f64> =
                found[letter]["ci95"].as_array().unwrap().iter().map(|end| end.as_f64().unwrap()).collect();
            assert!(ends[0] <= truth && truth <= ends[1], "{channel} {letter} {truth} outside {ends:?}");
        }
    }
}
