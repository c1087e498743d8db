//! Tests of the configuration.

use super::*;
use std::time::Duration;

const SHIPPED: &str = include_str!("../../systemd/vn100d.toml");

fn refused(text: &str) -> String {
    parse(Path::new("x.toml"), text).unwrap_err().to_string()
}

#[test]
fn an_empty_file_is_the_default() {
    assert_eq!(parse(Path::new("x.toml"), "").unwrap(), Config::default());
}

#[test]
fn the_shipped_file_as_it_is_is_the_default() {
    assert_eq!(parse(Path::new("vn100d.toml"), SHIPPED).unwrap(), Config::default());
}

/// `#key = value` without a space is a key, `# text` is prose.
fn uncommented() -> String {
    SHIPPED
        .lines()
        .map(|line| match line.strip_prefix('#') {
            Some(rest) if rest.starts_with(|letter: char| letter.is_ascii_lowercase()) => format!("{rest}\n"),
            _ => format!("{line}\n"),
        })
        .collect()
}

#[test]
fn the_shipped_file_with_every_key_uncommented_is_the_default() {
    let text = uncommented();
    assert_eq!(parse(Path::new("vn100d.toml"), &text).unwrap(), Config::default(), "{text}");
}

#[test]
fn the_shipped_file_names_every_key() {
    let shipped: serde_json::Value = toml::from_str(&uncommented()).unwrap();
    let known = serde_json::to_value(Config::default()).unwrap();
    for (section, keys) in known.as_object().unwrap() {
        for key in keys.as_object().unwrap().keys() {
            assert!(shipped[section].get(key).is_some(), "{section}.{key} is missing");
        }
    }
}

#[test]
fn every_key_of_the_documentation_exists_and_every_key_is_documented() {
    let documentation = include_str!("../../docs/config.md");
    let known = serde_json::to_value(Config::default()).unwrap();
    for (section, keys) in known.as_object().unwrap() {
        let (_, rest) = documentation.split_once(&format!("## `[{section}]`")).expect(section);
        let part = rest.split("\n## ").next().unwrap();
        for key in keys.as_object().unwrap().keys() {
            assert!(part.contains(&format!("| `{key}` |")), "{section}.{key}");
        }
        assert_eq!(part.matches("\n| `").count(), keys.as_object().unwrap().len(), "{section}");
    }
}

#[test]
fn values_of_a_file_count() {
    let config = parse(
        Path::new("x.toml"),
        "[sensor]\ndevice = \"/dev/ttyUSB*\"\nbaud = 921600\noutput = \"VNIMU\"\nrate-hz = 200\n\
         [capture]\nduration = \"90m\"\n[storage]\nqueue = \"1m\"\n[http]\nlisten = \"[::1]:9000\"\n[log]\nformat = \"json\"",
    )
    .unwrap();
    assert_eq!(config.sensor.device, Device::Glob("/dev/ttyUSB*".to_owned()));
    assert_eq!(config.sensor.baud, Baud::Fixed(921_600));
    assert_eq!(config.sensor.output, Output::Ascii("VNIMU".to_owned()));
    assert!((config.sensor.rate_hz - 200.0).abs() < f64::EPSILON);
    assert_eq!(config.capture.duration, Duration::from_secs(5400));
    assert_eq!(config.storage.queue_samples(), 48_000);
    assert_eq!(config.http.listen, "[::1]:9000".parse().unwrap());
    assert_eq!(config.log.format, LogFormat::Json);
}

#[test]
fn a_schedule_has_an_hour_and_may_have_a_length_a_name_and_days_of_its_own() {
    let read = |text: &str| parse(Path::new("x.toml"), text).unwrap().schedule;
    assert_eq!(read("").at, StartTime(None));
    let plain = read("[schedule]\nat = \"22:00\"");
    assert_eq!(plain.at.to_string(), "22:00");
    assert_eq!((plain.duration, plain.name.as_str(), plain.days.len()), (NightLength(None), "nightly", 7));
    let own = read("[schedule]\nat = \"6:05\"\nduration = \"60h\"\nname = \"weekend of A\"\ndays = [\"fri\"]");
    assert_eq!((own.at.to_string().as_str(), own.duration.to_string().as_str()), ("06:05", "60h"));
    assert_eq!((own.name.as_str(), own.days.as_slice()), ("weekend of A", [Day::Fri].as_slice()));
    assert_eq!(own.shortest_interval(), Some(Duration::from_secs(7 * 86_400)));
    // A long capture does not contradict a schedule that does not exist.
    assert_eq!(read("[capture]\nduration = \"30h\"").at, StartTime(None));
}

#[test]
fn what_is_shared_has_paths_of_its_own_and_permissions() {
    let share = parse(Path::new("x.toml"), "[share]\nlink = \"/run/vn100d/tty\"\nmode = \"600\"").unwrap().share;
    assert_eq!((share.link.to_str(), share.mode.bits()), (Some("/run/vn100d/tty"), 0o600));
    assert_eq!(Config::default().share.mode.to_string(), "660");
    for (text, expected) in [
        ("[share]\nmode = \"777\"", "x.toml:2: `share.mode` is "),
        ("[share]\nmode = \"066\"", "expected permissions such as \"600\""),
        ("[share]\nlink = \"/\"", "x.toml:2: `share.link` is /: expected a path that ends in a name"),
        (
            "[sensor]\ndevice = \"/dev/vn100\"\n[share]\nlink = \"/dev/vn100\"",
            "x.toml:4: `share.link` is /dev/vn100: this is `sensor.device`",
        ),
        ("[share]\nlink = \"/run/a\"\nsocket = \"/run/a\"", "x.toml:3: `share.socket` is /run/a: this is `share.link`"),
    ] {
        assert!(refused(text).contains(expected), "{}", refused(text));
    }
    assert!(refused(&format!("[share]\nsocket = \"/{}\"", "a".repeat(107))).contains("at most 107 bytes"));
}

#[test]
fn a_capture_may_keep_what_the_sensor_sends() {
    let config = parse(Path::new("x.toml"), "[sensor]\noutput = \"keep\"").unwrap();
    assert_eq!(config.sensor.output, Output::Keep);
}

#[test]
fn an_unknown_key_is_refused_with_file_line_and_what_is_allowed() {
    assert_eq!(
        refused("[sensor]\nbaud = 9600\nrate = 40"),
        "x.toml:3: there is no key `sensor.rate`: allowed here are baud, bauds, binary-fields, device, output, rate-hz"
    );
    assert_eq!(
        refused("output = \"keep\""),
        "x.toml:1: there is no key `output`: allowed here are capture, http, log, notify, schedule, sensor, share, storage"
    );
    assert!(refused("\n[sensors]\nbaud = 1").starts_with("x.toml:2: there is no key `sensors`"));
    assert!(refused("sensor.x.y = 1").starts_with("x.toml:1: there is no key `sensor.x`"));
}

#[test]
fn a_value_out_of_range_is_refused_with_file_line_key_and_what_is_allowed() {
    for (text, expected) in [
        ("\n[sensor]\nbaud = 128000", "x.toml:3: `sensor.baud` is 128000: allowed are 9600, 19200, 38400"),
        ("[sensor]\nbauds = []", "x.toml:2: `sensor.bauds` is []: allowed are 9600"),
        ("[sensor]\nrate-hz = 300", "x.toml:2: `sensor.rate-hz` is 300 Hz: binary output has 800 Hz divided by"),
        ("[sensor]\nrate-hz = 0", "x.toml:2: `sensor.rate-hz` is 0 Hz"),
        ("[sensor]\nrate-hz = nan", "x.toml:2: `sensor.rate-hz` is NaN Hz"),
        ("[sensor]\nrate-hz = -inf", "x.toml:2: `sensor.rate-hz` is -inf Hz"),
        (
            "[sensor]\noutput = \"VNYMR\"\nrate-hz = 80",
            "x.toml:3: `sensor.rate-hz` is 80 Hz: ASCII output has 1, 2, 4,",
        ),
        ("[sensor]\noutput = \"keep\"\nrate-hz = 0.5", "x.toml:3: `sensor.rate-hz` is 0.5 Hz: any rate"),
        ("[capture]\nduration = \"0s\"", "x.toml:2: `capture.duration` is 0ms: allowed is 1s to 8784h"),
        (
            "[schedule]\nduration = \"25h\"",
            "x.toml:2: `schedule.duration` is 25h: allowed is 1s to 24h for a night of `[schedule]`, which ends before",
        ),
        (
            "[schedule]\nduration = \"49h\"\ndays = [\"mon\", \"fri\", \"wed\"]",
            "x.toml:2: `schedule.duration` is 49h: allowed is 1s to 48h",
        ),
        (
            "[schedule]\nduration = \"25h\"\ndays = [\"sun\", \"mon\"]",
            "x.toml:2: `schedule.duration` is 25h: allowed is 1s to 24h",
        ),
        ("[schedule]\nduration = \"0s\"", "x.toml:2: `schedule.duration` is 0ms: allowed is 1s to 24h"),
        (
            "[capture]\nduration = \"30h\"\n[schedule]\nat = \"22:00\"",
            "x.toml:2: `capture.duration` is 30h: allowed is 1s to 24h for a night of `[schedule]`",
        ),
        ("[schedule]\ndays = []", "x.toml:2: `schedule.days` is []: expected at least one of mon, tue"),
        ("[schedule]\nname = \"\"", "x.toml:2: `schedule.name` is \"\": expected 1 to 80 characters without `/`"),
        ("[schedule]\nname = \"a/b\"", "x.toml:2: `schedule.name` is \"a/b\": expected 1 to 80"),
        ("[schedule]\nname = \" a\"", "x.toml:2: `schedule.name` is \" a\": expected 1 to 80"),
        ("[storage]\nqueue = \"1s\"", "x.toml:2: `storage.queue` is 1s: allowed is 30s to 10m"),
        ("[storage]\nreserve-mib = 1", "x.toml:2: `storage.reserve-mib` is 1: allowed is 16 to 1048576 MiB"),
        ("[http]\ntoken = \"short\"", "x.toml:2: `http.token` is a text of 5 characters: allowed are at least 16"),
        ("[log]\nlevel = \"loud,=\"", "x.toml:2: `log.level` is `loud,=`: allowed are error, warn"),
    ] {
        let message = refused(text);
        assert!(message.starts_with(expected), "{text:?} gave {message:?}");
    }
}

#[test]
fn a_value_of_the_wrong_kind_is_refused_with_file_line_key_and_what_is_allowed() {
    for (text, expected) in [
        (
            "[sensor]\nbaud = \"fast\"",
            "x.toml:2: `sensor.baud` is \"fast\": invalid value: string \"fast\", expected `\"auto\"` or a baud rate such as 115200",
        ),
        ("[sensor]\nbaud = -1", "x.toml:2: `sensor.baud` is -1: "),
        ("[sensor]\nbaud = 9999999999", "x.toml:2: `sensor.baud` is 9999999999: "),
        (
            "[sensor]\noutput = \"VNABC\"",
            "x.toml:2: `sensor.output` is \"VNABC\": expected `\"binary\"`, `\"keep\"` or one of VNYPR,",
        ),
        (
            "[sensor]\noutput = 3",
            "x.toml:2: `sensor.output` is 3: invalid type: integer `3`, expected `\"binary\"`, `\"keep\"`",
        ),
        (
            "[sensor]\nbinary-fields = \"01\"",
            "x.toml:2: `sensor.binary-fields` is \"01\": expected groups and one mask",
        ),
        ("[sensor]\ndevice = \"\"", "x.toml:2: `sensor.device` is \"\": expected `\"auto\"`, a path"),
        (
            "[sensor]\nrate-hz = \"40\"",
            "x.toml:2: `sensor.rate-hz` is \"40\": invalid type: string \"40\", expected f64",
        ),
        (
            "[sensor]\nbauds = [\n9600,\n\"x\"]",
            "x.toml:2: `sensor.bauds` is [\n9600,\n\"x\"]: invalid type: string \"x\", expected u32",
        ),
        ("[capture]\nduration = \"5\"", "x.toml:2: `capture.duration` is \"5\": `5` is not a duration"),
        (
            "[schedule]\nat = \"24:00\"",
            "x.toml:2: `schedule.at` is \"24:00\": expected a local time of day such as \"22:00\", or \"\" for none",
        ),
        ("[schedule]\nat = \"22:00:30\"", "x.toml:2: `schedule.at` is \"22:00:30\": expected a local time"),
        ("[schedule]\nat = 22:00:00", "x.toml:2: `schedule.at` is 22:00:00: "),
        (
            "[schedule]\nduration = \"5\"",
            "x.toml:2: `schedule.duration` is \"5\": expected a duration such as \"5h\" or \"90m\", or \"\" for that",
        ),
        (
            "[schedule]\ndays = [\"mon\", \"funday\"]",
            "x.toml:2: `schedule.days` is [\"mon\", \"funday\"]: unknown variant `funday`, expected one of `mon`, `tue`",
        ),
        ("[http]\nlisten = \"8100\"", "x.toml:2: `http.listen` is \"8100\": "),
        ("sensor = 3", "x.toml:1: `sensor` is 3: invalid type: integer `3`"),
        (
            "[log]\nformat = \"xml\"",
            "x.toml:2: `log.format` is \"xml\": unknown variant `xml`, expected `text` or `json`",
        ),
        ("[storage]\nreserve-mib = 1.5", "x.toml:2: `storage.reserve-mib` is 1.5: "),
        ("[log.level]\nx = 1", "x.toml:1: `log.level` is "),
    ] {
        let message = refused(text);
        assert!(message.starts_with(expected), "{text:?} gave {message:?}");
    }
}

#[test]
fn what_is_not_toml_is_refused_with_its_line() {
    assert!(refused("[sensor]\nbaud = ").starts_with("x.toml:2: this is not TOML: "));
    assert!(refused("[sensor\n").starts_with("x.toml:1: this is not TOML: "));
    assert!(refused("[http]\n[http]").contains("x.toml:2: this is not TOML: "));
}

#[test]
fn listening_beyond_loopback_needs_a_token() {
    let message = refused("[http]\nlisten = \"0.0.0.0:8100\"");
    assert!(
        message.starts_with("x.toml:2: `http.listen` is 0.0.0.0:8100, which others can reach: set `http.token`"),
        "{message}"
    );
    let config = parse(Path::new("x.toml"), "[http]\nlisten = \"0.0.0.0:8100\"\ntoken = \"0123456789abcdef\"").unwrap();
    assert_eq!(config.http.token.secret(), "0123456789abcdef");
    let overrides = Overrides { listen: Some("[::]:80".parse().unwrap()), ..Overrides::default() };
    let error = finish(&Source::new(Path::new(""), ""), &overrides).unwrap_err();
    assert!(matches!(error, ConfigError::TokenNeeded { place: Place::Given, .. }), "{error}");
}

#[test]
fn a_token_may_lie_in_a_file_of_its_own() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("token");
    let text = format!("[http]\nlisten = \"0.0.0.0:1\"\ntoken-file = {file:?}");
    assert!(refused(&text).starts_with("x.toml:3: `http.token-file`: cannot read "));
    // A user who only sends queries may not be allowed to read the file.
    let asking = Overrides { without_token: true, ..Overrides::default() };
    let config = finish(&Source::new(Path::new("x.toml"), &text), &asking).unwrap();
    assert_eq!(config.http.listen.port(), 1);
    std::fs::write(&file, "\n").unwrap();
    assert!(refused(&text).contains("whose first line is empty"));
    std::fs::write(&file, "0123456789abcdef\n").unwrap();
    assert_eq!(parse(Path::new("x.toml"), &text).unwrap().http.token.secret(), "0123456789abcdef");
    let both = format!("{text}\ntoken = \"0123456789abcdef\"");
    assert!(refused(&both).contains("give one of them"));
}

/// A pipe may never end, and a device has no end: a daemon that reads its configuration again must not wait or fill up.
#[test]
fn only_a_small_regular_file_is_read() {
    let directory = tempfile::tempdir().unwrap();
    let pipe = directory.path().join("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let large = directory.path().join("large");
    std::fs::File::create(&large).unwrap().set_len(FILE_BYTES + 1).unwrap();
    for (file, expected) in [
        (Path::new("/dev/zero"), "expected a regular file"),
        (&pipe, "expected a regular file"),
        (&large, "expected a file of at most 1 MiB"),
    ] {
        let error = load(Some(file), &Environment::of([]), &Overrides::default()).unwrap_err().to_string();
        assert!(error.ends_with(expected), "{error}");
        let text = format!("[http]\ntoken-file = {file:?}");
        assert!(refused(&text).ends_with(expected), "{}", refused(&text));
    }
}

#[test]
fn an_error_has_only_the_ends_of_a_long_value_and_states_what_is_allowed() {
    for length in [200, 500_000] {
        let long = "x".repeat(length);
        for (text, allowed) in [
            (format!("[sensor]\noutput = \"{long}\""), "expected"),
            (format!("[sensor]\nrate-hz = \"{long}\""), "expected"),
            (format!("[notify]\nevents = [\"{long}\"]"), "expected one of"),
            (format!("[sensor]\n{long} = 1"), "allowed here are"),
            (format!("[sensor]\nrate-hz = 1{long}"), "this is not TOML"),
        ] {
            let message = refused(&text);
            assert!(message.starts_with("x.toml:2: "), "{message:.300}");
            assert!(message.contains(allowed), "{length}: {message}");
            assert!(message.len() < 2500, "{} bytes", message.len());
        }
    }
}

#[test]
fn the_place_of_a_token_that_is_too_short_is_its_file() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("token");
    std::fs::write(&file, "short\n").unwrap();
    let message = refused(&format!("[http]\ntoken-file = {file:?}"));
    assert!(message.starts_with("x.toml:2: `http.token`"), "{message}");
}

#[test]
fn flags_count_more_than_the_file() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("a.toml");
    std::fs::write(&file, "[sensor]\ndevice = \"/dev/a\"\nrate-hz = 100").unwrap();
    let listen = Some("127.0.0.1:1".parse().unwrap());
    let overrides = Overrides { device: Some("/dev/b".to_owned()), listen, ..Overrides::default() };
    let config = load(Some(&file), &Environment::default(), &overrides).unwrap();
    assert_eq!(config.sensor.device, Device::Path("/dev/b".into()));
    assert_eq!(config.http.listen.port(), 1);
    assert!((config.sensor.rate_hz - 100.0).abs() < f64::EPSILON);
}

#[test]
fn a_file_that_was_named_must_be_there_and_one_that_is_searched_need_not() {
    let nowhere = Path::new("/nonexistent/vn100d.toml");
    let overrides = Overrides::default();
    assert!(matches!(load(Some(nowhere), &Environment::default(), &overrides), Err(ConfigError::Read { .. })));
    let environment = Environment::of([("VN100D_CONFIG", "/nonexistent/vn100d.toml")]);
    assert!(matches!(load(None, &environment, &overrides), Err(ConfigError::Read { .. })));
    let directory = tempfile::tempdir().unwrap();
    let environment = Environment::of([("XDG_CONFIG_HOME", directory.path().to_str().unwrap())]);
    std::fs::create_dir(directory.path().join("vn100d")).unwrap();
    let file = directory.path().join("vn100d/vn100d.toml");
    std::fs::write(&file, "[log]\nlevel = \"debug\"").unwrap();
    assert_eq!(load(None, &environment, &overrides).unwrap().log.level, "debug");
}

#[test]
fn a_rate_is_800_hz_divided_by_a_whole_number() {
    let divisor = |rate_hz| SensorConfig { rate_hz, ..SensorConfig::default() }.rate_divisor();
    for (rate_hz, expected) in [(800.0, 1), (40.0, 20), (50.0, 16), (33.33, 24), (1.0, 800), (114.2857, 7)] {
        assert_eq!(divisor(rate_hz), Some(expected), "{rate_hz}");
    }
    for rate_hz in [0.0, -40.0, 0.5, 300.0, 900.0, 1600.0, f64::NAN, f64::INFINITY] {
        assert_eq!(divisor(rate_hz), None, "{rate_hz}");
    }
}

proptest::proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(text in "(\\[(sensor|http|log|x)\\]\n)?[a-z-]{0,8} ?=? ?[\\PC\n]{0,20}") {
        let _ = parse(Path::new("x.toml"), &text);
    }
}
