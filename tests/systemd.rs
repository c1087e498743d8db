//! The systemd units, the plain one and that of instances, are checked by systemd itself: `systemd-analyze verify`
//! reports nothing, and `security` scores 1.6 or better. Skipped, with a note, if `systemd-analyze` is not installed.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The worst exposure level that passes: 1.6, in tenths.
const THRESHOLD: &str = "--threshold=16";

/// The plain unit and an instance of the template.
const UNITS: [(&str, &str); 2] = [
    ("vn100d.service", include_str!("../systemd/vn100d.service")),
    ("vn100d@left.service", include_str!("../systemd/vn100d@.service")),
];

fn analyze(arguments: &[&str], unit: &Path) -> Option<Output> {
    match Command::new("systemd-analyze").args(arguments).arg(unit).output() {
        Ok(output) => Some(output),
        Err(error) => {
            vn100_testkit::tool(false, "systemd-analyze", &error.to_string());
            None
        }
    }
}

/// Returns a shipped unit with the program just built in place of the installed one, which `verify` would not find.
fn unit_with_the_built_binary(directory: &Path, name: &str, shipped: &str) -> std::io::Result<PathBuf> {
    let text = shipped.replace("ExecStart=/usr/bin/vn100d", concat!("ExecStart=", env!("CARGO_BIN_EXE_vn100d")));
    assert_ne!(text, shipped, "the unit starts /usr/bin/vn100d");
    let unit = directory.join(name);
    std::fs::write(&unit, text)?;
    Ok(unit)
}

fn printed(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

#[test]
fn systemd_reports_nothing_about_the_units() {
    let directory = tempfile::tempdir().unwrap();
    for (name, shipped) in UNITS {
        let unit = unit_with_the_built_binary(directory.path(), name, shipped).unwrap();
        let Some(output) = analyze(&["verify"], &unit) else { return };
        // Its reports about other units of this machine do not concern these units.
        let ours: Vec<String> =
            printed(&output).lines().filter(|line| line.contains("vn100d")).map(str::to_owned).collect();
        assert!(ours.is_empty() && output.status.success(), "{name}: {}", printed(&output));
    }
}

#[test]
fn the_units_exposure_is_at_most_1_6() {
    let directory = tempfile::tempdir().unwrap();
    for (name, shipped) in UNITS {
        let unit = unit_with_the_built_binary(directory.path(), name, shipped).unwrap();
        let Some(output) = analyze(&["security", "--offline=true", THRESHOLD], &unit) else { return };
        assert!(output.status.success(), "{name}: {}", printed(&output));
    }
}

/// The units differ only in the lines that make an instance.
#[test]
fn an_instance_differs_in_its_configuration_and_its_data_alone() {
    let [plain, instance] = UNITS.map(|(_, text)| {
        let keys = text.lines().filter(|line| !line.starts_with('#') && line.contains('='));
        keys.map(str::to_owned).collect::<std::collections::BTreeSet<_>>()
    });
    let only_here: Vec<&String> = instance.difference(&plain).collect();
    assert_eq!(
        only_here,
        [
            "Description=VN-100 capture and noise analysis, sensor %i",
            "ExecStart=/usr/bin/vn100d --config /etc/vn100d/%i.toml run",
            "RuntimeDirectory=vn100d/%i",
            "StateDirectory=vn100d/%i",
        ]
    );
    assert_eq!(plain.difference(&instance).count(), only_here.len());
    for key in ["WatchdogSec=30", "Restart=always", "RestartPreventExitStatus=2 78", "LimitNOFILE=4096", "Type=notify"]
    {
        assert!(plain.contains(key), "{key}");
    }
    // /proc/sys shows the boot id, /proc/locks the process that holds a port.
    assert!(!plain.iter().any(|key| key.starts_with("ProcSubset")));
}

#[test]
fn the_udev_rule_sets_the_low_latency_of_the_adapter_and_keeps_modemmanager_away() {
    let rules = include_str!("../systemd/70-vn100.rules");
    for needed in ["ATTR{latency_timer}=\"1\"", "ENV{ID_MM_DEVICE_IGNORE}=\"1\"", "ATTRS{idVendor}==\"0403\""] {
        assert!(rules.contains(needed), "{needed}");
    }
    // Each rule is comma-separated `KEY op "value"`; the label of a GOTO must exist.
    for line in rules.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        for part in line.split(", ") {
            let value = part.split_once('=').map(|(_, value)| value.trim_start_matches('='));
            assert!(value.is_some_and(|value| value.starts_with('"') && value.ends_with('"')), "{part}");
        }
    }
    assert!(rules.contains("GOTO=\"vn100_end\"") && rules.contains("LABEL=\"vn100_end\""));
}
