//! The speed of a CSV's import: ten channels with stamps, as in docs/formats.md. Prints rows per second of one pass
//! over the file, of the pass that also finds the rate and irregularities, and of a whole import into SQLite (hash,
//! both passes, every transaction synced to the disk under `TMPDIR`), with processor times.
//!
//! `cargo bench --bench import`; `python3 benches/import.py` runs it beside pandas' `read_csv` and `to_sql` on the same
//! file, which this bench writes to `IMPORT_DIR`.

#![expect(clippy::unwrap_used, reason = "a bench that cannot go on ends")]

use imu_files::recording::{Options, Recording};
use rustix::time::{ClockId, clock_gettime};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;
use vn100d::clock::SystemClock;
use vn100d::daemon::import::{Source, import};
use vn100d::store::{Store, StoreOptions};

/// The columns of a row after its stamp: name, decimals, size of the values.
const COLUMNS: [(&str, usize, f64); 10] = [
    ("mag_x_gauss", 4, 0.5),
    ("mag_y_gauss", 4, 0.5),
    ("mag_z_gauss", 4, 0.5),
    ("accel_x_m_s2", 3, 1.0),
    ("accel_y_m_s2", 3, 1.0),
    ("accel_z_m_s2", 3, 10.0),
    ("gyro_x_rad_s", 6, 0.01),
    ("gyro_y_rad_s", 6, 0.01),
    ("gyro_z_rad_s", 6, 0.01),
    ("temperature_c", 1, 30.0),
];
const ROUNDS: usize = 5;

/// Measures work: its duration and the time of all processors, s.
fn timed<T>(work: impl FnOnce() -> T) -> (f64, f64, T) {
    let processor = || {
        let time = clock_gettime(ClockId::ProcessCPUTime);
        time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
    };
    let (begun, worked) = (Instant::now(), processor());
    let result = work();
    (begun.elapsed().as_secs_f64(), processor() - worked, result)
}

/// Prints the median of several rounds by their time.
fn print_median(what: &str, rows: u64, mut rounds: Vec<(f64, f64)>) {
    rounds.sort_by(|one, other| one.0.total_cmp(&other.0));
    let (took_s, worked_s) = rounds[rounds.len() / 2];
    println!("{what}: {:>9.0} rows/s ({rows} in {took_s:.3} s, {worked_s:.3} s of processor)", rows as f64 / took_s);
}

fn write_csv(path: &Path, rows: u64) {
    let mut out = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    let names: Vec<&str> = COLUMNS.iter().map(|(name, ..)| *name).collect();
    writeln!(out, "time_s,{}", names.join(",")).unwrap();
    let mut state = 7_u64;
    for row in 0..rows {
        write!(out, "{}.{:03}", row / 40, row % 40 * 25).unwrap();
        for (_, decimals, size) in COLUMNS {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let value = size * ((state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0);
            write!(out, ",{value:.decimals$}").unwrap();
        }
        out.write_all(b"\n").unwrap();
    }
    out.into_inner().unwrap().sync_all().unwrap();
}

fn main() {
    // `cargo test --benches` only checks that it runs.
    let quick = !std::env::args().any(|argument| argument == "--bench");
    let (rows, rounds) = if quick { (20_000, 1) } else { (2_000_000, ROUNDS) };
    let folder = tempfile::tempdir().unwrap();
    let kept = std::env::var_os("IMPORT_DIR").map(PathBuf::from);
    let file = kept.unwrap_or_else(|| folder.path().to_owned()).join("import.csv");
    write_csv(&file, rows);
    let bytes = std::fs::metadata(&file).unwrap().len();
    println!("{rows} rows of ten channels and a stamp, {:.1} bytes each", bytes as f64 / rows as f64);

    let (mut first, mut second) = (Vec::new(), Vec::new());
    for _ in 0..rounds {
        let (took_s, worked_s, recording) = timed(|| Recording::open(&file, Options::default()).unwrap());
        assert_eq!((recording.info().samples, recording.info().rate_hz), (rows, 40.0));
        first.push((took_s, worked_s));
        let (took_s, worked_s, read) = timed(|| recording.items().unwrap().filter(|item| item.is_ok()).count());
        assert_eq!(read as u64, rows);
        second.push((took_s, worked_s));
    }
    print_median("parse: values and times", rows, second);
    print_median("parse: rate, channels, findings", rows, first);

    let mut imports = Vec::new();
    for round in 0..rounds.min(3) {
        let store = Store::open(&folder.path().join(format!("{round}.db")), StoreOptions::default()).unwrap();
        let (took_s, worked_s, imported) =
            timed(|| import(&store, &SystemClock, Source::of(&file), None, &mut |_, _| Ok(())).unwrap());
        assert_eq!((imported.report.samples, imported.report.missing), (rows, 0));
        imports.push((took_s, worked_s));
        store.close().unwrap();
    }
    print_median("import into SQLite", rows, imports);
}
