//! Imports through the daemon: who may, how they end, and what a user is told.

use crate::world::{World, program};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const TOKEN: &str = "0123456789abcdef0123456789abcdef";

/// A recording of so many samples of one channel at 40 Hz.
fn recording(world: &World, name: &str, samples: usize) -> PathBuf {
    let file = world.path(name);
    let mut text = String::from("time_s,gyro_x_rad_s\n");
    for row in 0..samples {
        text.push_str(&format!("{:.3},{}\n", row as f64 * 0.025, row % 7));
    }
    std::fs::write(&file, text).unwrap();
    file
}

/// Where the daemon of this world listens, as the configuration says it.
fn listening(world: &World) -> String {
    format!("[http]\nlisten = \"{}\"\n", world.url.trim_start_matches("http://"))
}

/// `vn100d import` with this configuration, beside the world's daemon.
fn importing(world: &World, configuration: &Path, arguments: &[&str]) -> Command {
    let mut command = program();
    command.args(["--data-dir", world.path("data").to_str().unwrap()]);
    command.args(["--config", configuration.to_str().unwrap(), "--json", "import"]).args(arguments);
    command
}

fn import(world: &World, configuration: &Path, arguments: &[&str]) -> Output {
    importing(world, configuration, arguments).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Who configures a token wants it asked for, wherever the daemon listens; `vn100d import` has it from the configuration.
#[test]
fn a_configured_token_is_needed_on_loopback_too_and_import_brings_it() {
    let world = World::new();
    let configuration = format!("{}token = \"{TOKEN}\"\n", listening(&world));
    let mut daemon = world.daemon(&configuration, &[]);
    for (method, route) in [("POST", "/v1/captures"), ("POST", "/v1/captures/1/pin"), ("DELETE", "/v1/captures/1")] {
        let (status, text) = world.request(method, route, "{}").unwrap();
        assert_eq!(status, 401, "{method} {route}: {text}");
    }
    assert_eq!(world.get("/v1/status")["capture"], serde_json::Value::Null);
    let file = recording(&world, "desk.csv", 400);
    let without = world.path("without.toml");
    std::fs::write(&without, listening(&world)).unwrap();
    let refused = import(&world, &without, &[file.to_str().unwrap()]);
    assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
    assert!(said(&refused).contains("token"), "{}", said(&refused));
    let taken = import(&world, &world.path("vn100d.toml"), &[file.to_str().unwrap()]);
    assert_eq!(taken.status.code(), Some(0), "{}", said(&taken));
    assert_eq!(world.get("/v1/captures/desk")["samples"], 400);
    assert_eq!(daemon.terminate(), Some(0));
}
