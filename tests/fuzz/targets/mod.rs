//! Targets: properties that must hold for any bytes. Each function panics if its property does not hold.
//!
//! Each is defined once for the harness on stable (`tests/fuzz/main.rs`) and for libFuzzer (`fuzz/fuzz_targets`).

mod config;
mod decoder;
mod faults;
pub mod http;
mod recording;

/// A function of any bytes.
pub type Target = fn(&[u8]);

/// All targets by name.
pub const TARGETS: [(&str, Target); 12] = [
    ("decoder", decoder::any_split),
    ("csv", recording::csv),
    ("raw_text", recording::raw_text),
    ("raw_bytes", recording::any),
    ("bag", recording::any),
    ("db3", recording::any),
    ("mcap", recording::any),
    ("table", recording::table),
    ("mapped", recording::mapped),
    ("config", config::refused_with_its_place),
    ("http", http::no_server_error),
    ("faults", faults::refused_with_its_line),
];

/// Runs a target by name.
#[allow(dead_code, reason = "libFuzzer's entry")]
pub fn run(name: &str, input: &[u8]) {
    for (known, target) in TARGETS {
        if known == name {
            target(input);
        }
    }
}
