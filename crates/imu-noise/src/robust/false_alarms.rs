//! False alarms: how often pure noise is reported as disturbed.
//!
//! `cargo test --release --lib false_alarms -- --ignored --nocapture` prints the counts.

use super::synthetic::Noise;
use super::*;
use std::collections::BTreeMap;

/// Returns the findings in `records` records of pure noise of `count` samples at 40 Hz, by kind.
fn found(records: u64, count: usize, b: f64, k: f64) -> (usize, BTreeMap<String, usize>) {
    let mut kinds = BTreeMap::new();
    let mut disturbed = 0;
    for seed in 0..records {
        let values = Noise::new(50_000 + seed).sensor(count, 40.0, 3.5e-3, b, k);
        let flags = examine(&[Part { start_s: 0.0, values }], 40.0).flags(Channel::GyroX);
        disturbed += usize::from(!flags.is_empty());
        for flag in flags {
            *kinds.entry(flag.kind).or_default() += 1;
        }
    }
    (disturbed, kinds)
}

#[test]
fn pure_noise_is_seldom_reported_as_disturbed() {
    let (disturbed, kinds) = found(20, 40_000, 1e-3, 5e-5);
    assert!(disturbed <= 1, "{kinds:?}");
}

#[test]
#[ignore = "minutes: run in release"]
fn false_alarms() {
    for (name, b, k) in [("N", 0.0, 0.0), ("N, B, K", 1e-3, 5e-5), ("N and a strong K", 0.0, 2e-3)] {
        for (records, count) in [(100, 90_000), (20, 720_000)] {
            let (disturbed, kinds) = found(records, count, b, k);
            println!("{name}: {disturbed} of {records} records of {count} samples; {kinds:?}");
            assert!(disturbed * 20 <= records as usize, "{name}: {kinds:?}");
        }
    }
}
