//! The blind check of the diagnosis, from the command line: order, seals, thresholds. How well the diagnosis does is measured by
//! longer trials (`docs/validation.md`); this short one fails where it no longer works.

use crate::world::vn100d;
use serde_json::Value;
use sha2::{Digest as _, Sha256};

fn hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn a_trial_seals_its_keys_before_it_diagnoses_and_counts_afterwards() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (out, page) = (path("trial"), path("page.html"));
    let kinds = ["--cases", "4", "--seed", "31", "--kinds", "none,tone,chirp"];
    let ended = vn100d(&[&["trial", "--json", "--out", &out, "--html", &page], &kinds[..]].concat());
    let said = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert_eq!(ended.status.code(), Some(0), "{said}");
    let score: Value = serde_json::from_slice(&ended.stdout).unwrap();
    assert_eq!((&score["format"], &score["cases"]), (&"vn100d-trial-1".into(), &4.into()));
    assert_eq!(score["rates"]["refused"]["count"], 0, "{score}");

    let read = |name: &str| std::fs::read(folder.path().join("trial").join(name)).unwrap();
    let manifest = read("manifest.json");
    assert_eq!(score["manifest_sha256"], hex(&manifest));
    assert!(said.contains(&hex(&manifest)), "{said}");
    let manifest: Value = serde_json::from_slice(&manifest).unwrap();
    let keys: Vec<vn100d::trial::Key> = serde_json::from_slice(&read("key.json")).unwrap();
    for (key, digest) in keys.iter().zip(manifest["digests"].as_array().unwrap()) {
        assert_eq!(*digest, hex(serde_json::to_string(key).unwrap().as_bytes()));
        let report: Value = serde_json::from_slice(&read(&format!("reports/{:05}.json", key.case))).unwrap();
        assert_eq!(report["format"], "vn100d-diagnosis-1");
        assert!(!report.to_string().contains(&key.salt));
    }
    assert_eq!(keys.iter().filter(|key| !key.effects.is_empty()).count(), 3);
    assert!(std::fs::read_to_string(&page).unwrap().contains("Trial of the diagnosis"));
}

#[test]
fn what_is_asked_for_is_checked_first() {
    for (arguments, part) in [
        (["--kinds", "tune"], "`tune`"),
        (["--at-least", "right=0.9"], "right_first"),
        (["--at-most", "spurious=2"], "NAME=SHARE"),
        (["--cases", "0"], "no such case"),
    ] {
        let ended = vn100d(&[&["trial"], &arguments[..]].concat());
        let said = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(2), "{said}");
        assert!(said.contains(part), "{said}");
    }
}
