//! Export and import: every format restores the recorded values, and a failure leaves no partial output.

use crate::world::vn100d;
use arrow_array::Array as _;
use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float64Type, Int64Type};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use rusqlite::types::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A folder with a database in `data` and the files of a test.
pub struct Place(tempfile::TempDir);

impl Place {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn text(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap()
    }

    /// Runs the program in the folder.
    pub fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_vn100d"));
        command.env_remove("VN100D_DATA_DIR").env_remove("VN100D_CONFIG").current_dir(self.0.path());
        command.args(["--data-dir", "data"]).args(arguments).output().unwrap()
    }

    pub fn done(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    }

    fn refused(&self, code: i32, arguments: &[&str], why: &str) {
        let output = self.run(arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(why), "{arguments:?}: {}", stderr(&output));
    }

    /// Returns rows of the database.
    pub fn query(&self, sql: &str) -> Vec<Vec<Value>> {
        let database = rusqlite::Connection::open(self.path("data/vn100d.db")).unwrap();
        let mut statement = database.prepare(sql).unwrap();
        let columns = statement.column_count();
        let rows = statement.query_map([], |row| (0..columns).map(|column| row.get(column)).collect()).unwrap();
        rows.map(Result::unwrap).collect()
    }

    /// Returns the names of all files in the folder, without the data directory.
    pub fn files(&self) -> Vec<String> {
        fn walk(folder: &Path, from: &Path, found: &mut Vec<String>) {
            for entry in std::fs::read_dir(folder).unwrap().flatten() {
                let path = entry.path();
                found.push(path.strip_prefix(from).unwrap().display().to_string());
                if path.is_dir() {
                    walk(&path, from, found);
                }
            }
        }
        let mut found = Vec::new();
        walk(self.0.path(), self.0.path(), &mut found);
        found.retain(|path| !path.starts_with("data"));
        found.sort();
        found
    }
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// 2026-11-21T20:00:00Z.
const EVENING_S: u64 = 1_795_291_200;

/// Returns a recording at 40 Hz with jitter below a millisecond, two holes, a channel that is sometimes absent, and
/// values without a short decimal.
fn recording(samples: usize) -> String {
    let mut text = String::from("time_s,gyro_x_rad_s,accel_z_m_s2,mag_x_gauss,temperature_c\n");
    let mut ticks = 0_usize;
    for row in 0..samples {
        ticks += 1 + if row == samples / 3 { 40 } else { 3 * usize::from(row == samples / 2) };
        let ns = EVENING_S * 1_000_000_000 + ticks as u64 * 25_000_000 + (row as u64 * 7919) % 1000 * 997;
        let x = (row as f64 * 0.1).sin() / 3.0;
        let temperature = if row % 5 == 0 { String::new() } else { format!("{}", 21.0 + x) };
        text.push_str(&format!(
            "{}.{:09},{x},{},{},{temperature}\n",
            ns / 1_000_000_000,
            ns % 1_000_000_000,
            x - 9.8,
            x * 1e-3
        ));
    }
    text
}

/// Returns a place with this recording as capture 1, `night`.
pub fn with_capture(samples: usize) -> Place {
    let place = Place::new();
    std::fs::write(place.path("night.csv"), recording(samples)).unwrap();
    place.done(&["import", "night.csv"]);
    place
}

const SAMPLES: &str =
    "SELECT seq, segment_id, device_time_ns, host_utc_ns, yaw, mag_x, accel_z, gyro_x, temperature FROM sample";
const GAPS: &str = "SELECT before_seq, from_utc_ns, to_utc_ns, missing, missing_exact, cause FROM gap";

fn of(sql: &str, id: i64, order: &str) -> String {
    format!("{sql} WHERE capture_id = {id} ORDER BY {order}")
}

#[test]
fn csv_goes_out_and_in_again_with_every_bit_and_every_gap() {
    let place = with_capture(20_000);
    let printed = place.done(&["export", "night", "--out", "out.csv", "--time", "utc"]);
    assert!(printed.contains("out.csv: 20000 samples of 4 channels as csv, 43 missing in 2 gaps"), "{printed}");
    place.done(&["import", "out.csv", "--name", "again"]);
    let (one, two) = (place.query(&of(SAMPLES, 1, "seq")), place.query(&of(SAMPLES, 2, "seq")));
    assert_eq!(one.len(), 20_000);
    assert!(one == two, "the samples differ");
    let gaps = place.query(&of(GAPS, 1, "gap_id"));
    assert_eq!((gaps.len(), &gaps), (2, &place.query(&of(GAPS, 2, "gap_id"))));
    // Times from the first sample, to standard output: everything but the time of day is the same.
    let text = place.done(&["export", "1", "--format", "csv"]);
    assert!(text.starts_with("time_s,mag_x_gauss,accel_z_m_s2,gyro_x_rad_s,temperature_c\n0,"), "{}", &text[..200]);
    std::fs::write(place.path("relative.csv"), text).unwrap();
    place.done(&["import", "relative.csv", "--name", "relative"]);
    let values = "SELECT seq, segment_id, device_time_ns, mag_x, accel_z, gyro_x, temperature FROM sample";
    assert!(place.query(&of(values, 1, "seq")) == place.query(&of(values, 3, "seq")));
    let gaps = "SELECT before_seq, to_utc_ns - from_utc_ns, missing, cause FROM gap";
    assert_eq!(place.query(&of(gaps, 1, "gap_id")), place.query(&of(gaps, 3, "gap_id")));
    // The recording itself, without a database, gives the same file.
    place.done(&["export", "night.csv", "--out", "direct.csv", "--time", "utc"]);
    assert!(place.text("direct.csv") == place.text("out.csv"));
}

#[test]
fn ndjson_and_parquet_have_the_same_values_as_the_database() {
    let place = with_capture(20_000);
    place.done(&["export", "latest", "--out", "out.ndjson"]);
    let samples = place.query("SELECT gyro_x, temperature, host_utc_ns, segment_id FROM sample ORDER BY seq");
    let text = place.text("out.ndjson");
    assert_eq!(text.lines().count(), samples.len());
    let real = |value: &Value| if let Value::Real(value) = value { Some(*value) } else { None };
    let integer = |value: &Value| if let Value::Integer(value) = value { *value } else { panic!("{value:?}") };
    for (line, sample) in text.lines().zip(&samples) {
        let row: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(row["gyro_x"].as_f64().map(f64::to_bits), real(&sample[0]).map(f64::to_bits), "{line}");
        assert_eq!(row["temperature"].as_f64(), real(&sample[1]), "{line}");
    }
    let report = place.done(&["--json", "export", "latest", "--out", "out.parquet"]);
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["bytes"], std::fs::metadata(place.path("out.parquet")).unwrap().len());
    assert_eq!((&report["samples"], &report["missing"], &report["gaps"]), (&20_000.into(), &43.into(), &2.into()));
    assert_eq!(report["channels"], serde_json::json!(["mag_x", "accel_z", "gyro_x", "temperature"]));
    let file = std::fs::File::open(place.path("out.parquet")).unwrap();
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).unwrap();
    assert_eq!(builder.schema().field_with_name("gyro_x_rad_s").unwrap().metadata()["unit"], "rad/s");
    let mut rows = samples.iter();
    for batch in builder.build().unwrap().map(Result::unwrap) {
        let column = |name: &str| batch.column_by_name(name).unwrap();
        let (gyro, warm) = (
            column("gyro_x_rad_s").as_primitive::<Float64Type>(),
            column("temperature_c").as_primitive::<Float64Type>(),
        );
        let device = column("device_time_ns").as_primitive::<Int64Type>();
        for row in 0..batch.num_rows() {
            let sample = rows.next().unwrap();
            assert_eq!(Some(gyro.value(row).to_bits()), real(&sample[0]).map(f64::to_bits));
            assert_eq!((!warm.is_null(row)).then(|| warm.value(row)), real(&sample[1]));
            assert_eq!(device.value(row), integer(&sample[2]) - integer(&samples[0][2]));
        }
    }
    assert!(rows.next().is_none());
}

#[test]
fn mcap_has_every_sample_at_its_time_in_si_and_as_recorded() {
    let place = with_capture(2_000);
    place.done(&["export", "1", "--out", "out.mcap"]);
    let bytes = std::fs::read(place.path("out.mcap")).unwrap();
    let samples = place.query("SELECT host_utc_ns, mag_x, gyro_x FROM sample ORDER BY seq");
    let (mut own, mut mag) = (0, 0);
    for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        let double = |place: usize| f64::from_le_bytes(message.data[place..place + 8].try_into().unwrap());
        let at = |row: usize| Value::Integer(message.log_time as i64) == samples[row][0];
        match message.channel.topic.as_str() {
            "/vn100d/sample" => {
                assert!(
                    at(own) && Value::Real(double(36)) == samples[own][1] && Value::Real(double(52)) == samples[own][2]
                );
                own += 1;
            }
            "/imu/mag" => {
                let Value::Real(gauss) = samples[mag][1] else { panic!("no number") };
                assert!(at(mag) && double(28) == gauss / 1e4 && double(36).is_nan());
                mag += 1;
            }
            "/imu/temperature" => {}
            other => panic!("{other}: the capture has no whole triad"),
        }
    }
    assert_eq!((own, mag), (2_000, 2_000));
    // The import restores the recorded values, not those of the standard messages.
    place.done(&["import", "out.mcap", "--name", "again"]);
    assert!(place.query(&of(SAMPLES, 1, "seq")) == place.query(&of(SAMPLES, 2, "seq")), "the samples differ");
    assert_eq!(place.query(&of(GAPS, 1, "gap_id")), place.query(&of(GAPS, 2, "gap_id")));
    assert_eq!(mcap::Summary::read(&bytes).unwrap().unwrap().stats.unwrap().message_count, 2_000 * 2 + 1_600);
}

#[test]
fn a_part_has_its_times_and_channels_and_the_gaps_between_its_samples() {
    let place = with_capture(3_000);
    let rows = |arguments: &[&str]| {
        let text = place.done(&[&["export"], arguments].concat());
        text.lines().map(str::to_owned).collect::<Vec<_>>()
    };
    let whole = rows(&["night"]);
    for named in ["night", "night.csv"] {
        let part = rows(&[named, "--from", "10", "--to", "12", "--channels", "temperature,gyro_x"]);
        assert_eq!(part[0], "time_s,temperature_c,gyro_x_rad_s", "in the order that was asked for");
        let times: Vec<f64> = part[1..].iter().map(|row| row.split(',').next().unwrap().parse().unwrap()).collect();
        assert!(times.iter().all(|time| (10.0..12.0).contains(time)) && (78..=82).contains(&times.len()), "{times:?}");
        // By the time of day: the first sample was taken 25 ms after the hour.
        let from = ["--from", "2026-11-21T20:00:10.025Z", "--to", "2026-11-21T20:00:12.025Z"];
        assert_eq!(rows(&[&[named, "--channels", "temperature,gyro_x"], &from[..]].concat()), part);
        assert_eq!(rows(&[named, "--from", "12", "--to", "10"]), whole[..1], "an empty range is a table without rows");
        assert_eq!(rows(&[named, "--from", "1e6"]), whole[..1]);
        // The first hole lies at 25 s, the second at 39 s.
        let report = place.done(&["--json", "export", named, "--from", "30", "--out", "part.parquet", "--force"]);
        let report: serde_json::Value = serde_json::from_str(&report).unwrap();
        assert_eq!((&report["missing"], &report["gaps"]), (&3.into(), &1.into()), "{report}");
        place.refused(
            2,
            &["export", named, "--channels", "gyro_y"],
            "the capture has no `gyro_y`: it has mag_x, accel_z",
        );
    }
    place.refused(2, &["export", "1", "--channels", "gyro"], "there is no `gyro`: channels are yaw");
    place.refused(2, &["export", "1", "--from", "yesterday"], "expected RFC 3339");
    place.refused(1, &["export", "nobody"], "nobody");
}

#[test]
fn what_cannot_be_is_refused_and_leaves_nothing() {
    let place = with_capture(5_000);
    let before = place.files();
    place.refused(2, &["export", "1", "--out", "out"], "name --format (csv, ndjson, parquet, mcap)");
    place.refused(2, &["export", "1", "1", "--out", "out.csv"], "--partitioned DIR takes several");
    place.refused(2, &["--json", "export", "1"], "name --out FILE");
    place.refused(2, &["export", "1", "--out", "out.parquet", "--time", "utc"], "--time is of csv and ndjson");
    place.refused(2, &["export", "night.csv", "--out", "night.csv", "--force"], "night.csv is read");
    place.refused(2, &["export", "night.csv", "--partitioned", "lake"], "import it first");
    place.refused(74, &["export", "1", "--out", "nowhere/out.csv"], "nowhere/out.csv cannot be written");
    place.refused(
        74,
        &["export", "1", "--out", "/dev/full", "--format", "parquet"],
        "/dev/full cannot be written: No space left",
    );
    for format in ["csv", "ndjson", "parquet", "mcap"] {
        // The disk accepts 51 KB of a file (SQLite needs 32 of them).
        let out = format!("out.{format}");
        let limited = Command::new("sh")
            .args(["-c", "trap '' XFSZ; ulimit -f 100; exec \"$0\" --data-dir data export 1 --out \"$1\""])
            .args([env!("CARGO_BIN_EXE_vn100d"), &out])
            .current_dir(place.path(""))
            .output()
            .unwrap();
        assert_eq!(limited.status.code(), Some(74), "{format}: {}", stderr(&limited));
        assert!(stderr(&limited).contains(&format!("{out} cannot be written")), "{}", stderr(&limited));
        assert_eq!(place.files(), before, "{format}");
    }
    std::fs::write(place.path("mine.csv"), "mine").unwrap();
    place.refused(73, &["export", "1", "--out", "mine.csv"], "say --force to replace it");
    assert_eq!(place.text("mine.csv"), "mine");
    place.done(&["export", "1", "--out", "mine.csv", "--force"]);
    assert!(place.text("mine.csv").starts_with("time_s,"));
    // Rejected lines determine the exit code, as everywhere.
    std::fs::write(place.path("torn.csv"), "time_s,gyro_x_rad_s\n0,1\n0.025,x\n0.05,1\n0.075,1\n").unwrap();
    assert_eq!(place.run(&["export", "torn.csv"]).status.code(), Some(3));
}

#[test]
fn a_database_of_captures_is_never_replaced() {
    let place = with_capture(400);
    let before = std::fs::read(place.path("data/vn100d.db")).unwrap();
    for arguments in [
        ["export", "night", "--out", "data/vn100d.db", "--format", "csv", "--force"].as_slice(),
        &["simulate", "--duration", "1s", "--out", "data/vn100d.db", "--force"],
        &["export", "night", "--out", "data/vn100d.db-wal", "--format", "csv", "--force"],
    ] {
        place.refused(2, arguments, "is a database of captures");
    }
    assert!(std::fs::read(place.path("data/vn100d.db")).unwrap() == before);
}

#[test]
fn captures_of_two_databases_are_two_files_of_a_data_set() {
    let place = with_capture(400);
    place.done(&["export", "--all", "--partitioned", "lake"]);
    std::fs::rename(place.path("data"), place.path("other")).unwrap();
    let recording = place.text("night.csv");
    std::fs::write(place.path("night.csv"), recording.lines().take(200).collect::<Vec<_>>().join("\n")).unwrap();
    place.done(&["import", "night.csv"]);
    place.done(&["export", "--all", "--partitioned", "lake"]);
    let files: Vec<String> = place.files().into_iter().filter(|file| file.contains("capture-1-night-")).collect();
    assert_eq!(files.len(), 2, "{files:?}");
}

#[test]
fn an_mcap_file_that_was_not_finished_does_not_look_whole() {
    let place = Place::new();
    place.done(&["simulate", "--duration", "2h", "--into-db", "long"]);
    let file = std::fs::File::create(place.path("half.mcap")).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_vn100d"));
    command.current_dir(place.path("")).args(["--data-dir", "data", "export", "long", "--format", "mcap"]);
    let mut child = command.stdout(file).stderr(std::process::Stdio::null()).spawn().unwrap();
    while std::fs::metadata(place.path("half.mcap")).unwrap().len() == 0 {
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    let pid = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    let status = child.wait().unwrap();
    let written = std::fs::read(place.path("half.mcap")).unwrap();
    // A machine that finished before the signal has written a complete file.
    assert_eq!(written.ends_with(mcap::MAGIC), status.success(), "{status}");
}

#[test]
fn a_data_set_has_a_file_per_capture_in_the_folder_of_its_sensor_and_day() {
    let place = with_capture(400);
    let simulated = ["simulate", "--duration", "5s", "--into-db", "sim one"];
    place.done(&simulated);
    let reports = place.done(&["--json", "export", "--all", "--partitioned", "lake"]);
    let reports: Vec<serde_json::Value> = serde_json::from_str(&reports).unwrap();
    assert_eq!(reports.len(), 2);
    let night = reports[0]["file"].as_str().unwrap();
    let of_database = night.strip_prefix("lake/sensor=unknown/date=2026-11-21/capture-1-night-").unwrap();
    assert_eq!(of_database.len(), 8 + ".parquet".len());
    let other = reports[1]["file"].as_str().unwrap();
    assert!(other.ends_with(&format!("capture-2-sim_one-{of_database}")), "{other}");
    let schema = |file: &str| {
        let file = std::fs::File::open(place.path(file)).unwrap();
        // The file's metadata describes its capture.
        ParquetRecordBatchReaderBuilder::try_new(file).unwrap().schema().fields().clone()
    };
    assert_eq!(schema(night), schema(reports[1]["file"].as_str().unwrap()), "one schema for all files");
    assert_eq!(schema(night).len(), 7 + 14);
    // The same capture again: the same file, replaced; nothing else in its folder.
    let first = std::fs::read(place.path(night)).unwrap();
    let files = place.files();
    place.done(&["export", "night", "1", "--partitioned", "lake"]);
    assert!(std::fs::read(place.path(night)).unwrap() == first && place.files() == files);
    // A failure leaves no folder either.
    std::fs::write(place.path("file"), "").unwrap();
    place.refused(74, &["export", "1", "--partitioned", "file"], "cannot be made");
    assert_eq!(vn100d(&["export", "--partitioned", "lake"]).status.code(), Some(2), "which captures?");
}
