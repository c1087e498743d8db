//! Completions: a shell is offered the captures, models, channels and plots that are there.

use crate::export::Place;
use crate::world::{World, program, vn100d};
use std::path::Path;
use std::process::Command;

/// Returns what bash completes the last of these words to, with the script that the program prints.
fn bash(place: &Place, words: &[&str]) -> Vec<String> {
    let binary = Path::new(env!("CARGO_BIN_EXE_vn100d"));
    let script = "source <(vn100d completions bash); COMP_WORDS=(vn100d \"$@\"); COMP_CWORD=$#; COMP_TYPE=9; \
                  _clap_complete_vn100d vn100d \"${COMP_WORDS[COMP_CWORD]}\" \"${COMP_WORDS[COMP_CWORD-1]}\"; \
                  printf '%s\\n' \"${COMPREPLY[@]}\"";
    let mut command = Command::new("bash");
    let path = format!("{}:{}", binary.parent().unwrap().display(), std::env::var("PATH").unwrap());
    command.args(["--norc", "-c", script, "bash"]).args(words).env("PATH", path).current_dir(place.path(""));
    let output = command.output().unwrap();
    assert!(output.stderr.is_empty(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap().lines().map(str::to_owned).collect()
}

#[test]
fn bash_is_offered_commands_captures_models_channels_and_plots() {
    let place = Place::new();
    std::fs::write(place.path("one.csv"), "time_s,gyro_x_rad_s\n0,1\n0.025,2\n0.05,1\n0.075,2\n").unwrap();
    place.done(&["import", "one.csv", "--name", "night-1"]);
    place.done(&["simulate", "--duration", "1s", "--into-db", "night 2"]);
    std::fs::write(place.path("unit.json"), "{}").unwrap();
    let of = |words: &[&str]| bash(&place, words);
    assert_eq!(of(&["noi"]), ["noise"]);
    assert!(of(&["noise", "--dat"]).contains(&"--data-dir".to_owned()));
    let data = ["--data-dir", "data"];
    // A name that bash would take apart is offered as its id.
    let shown = of(&[&data[..], &["show", ""]].concat());
    assert_eq!(shown[..4], ["2", "night-1", "latest", "one.csv"], "{shown:?}");
    assert_eq!(of(&[&data[..], &["noise", "latest", "ni"]].concat()), ["night-1"]);
    assert_eq!(of(&["--data-dir", "=", "data", "show", "n"]), ["night-1"]);
    assert_eq!(of(&[&data[..], &["diagnose", "--real", "n"]].concat()), ["night-1"]);
    let simulators = of(&[&data[..], &["diagnose", "--sim", ""]].concat());
    assert!(
        simulators.starts_with(&["unit.json".to_owned()]) && simulators.contains(&"2".to_owned()),
        "{simulators:?}"
    );
    assert!(!simulators.contains(&"night-1".to_owned()), "it is recorded: {simulators:?}");
    assert_eq!(of(&["model", "show", "u"]), ["unit.json"]);
    assert_eq!(of(&["export", "one.csv", "--channels", "gyro_x,gyro_"]), ["gyro_x,gyro_y", "gyro_x,gyro_z"]);
    assert_eq!(of(&[&data[..], &["export", "night-1", "--channels", ""]].concat()), ["gyro_x"]);
    assert_eq!(of(&[&data[..], &["plot", "night-1", "allan-"]].concat()), ["allan-gyro", "allan-gyro_x"]);
    assert!(of(&["plot", "one.csv", "timeseries-"]).contains(&"timeseries-mag_z".to_owned()));
    assert_eq!(of(&["model", "fit", "x.csv", "--effects", "tone,reson"]), ["tone,resonance"]);
    // Without a database nothing is offered, and no error is seen.
    assert_eq!(of(&["--data-dir", "nowhere", "show", "n"]), [""]);
}

#[test]
fn commands_that_change_are_offered_the_daemon_s_captures_alone() {
    let place = Place::new();
    place.done(&["simulate", "--duration", "1s", "--into-db", "night-own"]);
    let world = World::new();
    let mut daemon = world.daemon("", &[]);
    let body = r#"{"name": "night-1"}"#;
    assert_eq!(world.request("POST", "/v1/captures", body).unwrap().0, 201);
    let listen = world.url.strip_prefix("http://").unwrap().to_owned();
    let config = world.path("at.toml");
    std::fs::write(&config, format!("[http]\nlisten = \"{listen}\"\n")).unwrap();
    let (config, data) = (config.to_str().unwrap(), world.path("data").canonicalize().unwrap());
    let data = data.to_str().unwrap();
    for command in ["stop", "pin", "unpin", "delete", "rename", "note"] {
        let of = |place_named: &[&str]| bash(&place, &[place_named, &[command, "n"]].concat());
        assert_eq!(of(&["--config", config]), ["night-1"], "{command}");
        assert_eq!(of(&["--config", config, "--data-dir", data]), ["night-1"], "{command}");
        // It would be refused.
        assert_eq!(of(&["--config", config, "--data-dir", "data"]), [""], "{command}");
    }
    assert_eq!(bash(&place, &["pin", "--listen", &listen, "n"]), ["night-1"]);
    assert_eq!(daemon.terminate(), Some(0));
    assert_eq!(bash(&place, &["--config", config, "pin", "n"]), [""]);
}

#[test]
fn every_shell_has_a_script_that_asks_the_program() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let output = vn100d(&["completions", shell]);
        assert!(output.status.success(), "{shell}");
        assert!(String::from_utf8(output.stdout).unwrap().contains("VN100D_COMPLETE"), "{shell}");
        let mut asked = program();
        asked.env("VN100D_COMPLETE", shell).env("_CLAP_COMPLETE_INDEX", "1").args(["--", "vn100d", "noi"]);
        let output = asked.output().unwrap();
        assert!(String::from_utf8_lossy(&output.stdout).starts_with("noise"), "{shell}: {output:?}");
    }
    let folder = tempfile::tempdir().unwrap();
    assert!(vn100d(&["generate", "completions", folder.path().to_str().unwrap()]).status.success());
    for name in ["vn100d.bash", "_vn100d", "vn100d.fish"] {
        assert!(std::fs::read_to_string(folder.path().join(name)).unwrap().contains("VN100D_COMPLETE"), "{name}");
    }
}
