//! Prints how many samples a second are read from each file: the first pass and the second one together, as an import reads.
//!
//! `cargo run --release -p imu-files --example reading_speed -- FILE…`

use imu_files::recording::{Options, Recording, RecordingError};
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), RecordingError> {
    for file in std::env::args().skip(1) {
        let begun = Instant::now();
        let recording = Recording::open(Path::new(&file), Options::default())?;
        let first_s = begun.elapsed().as_secs_f64();
        let mut count = 0_u64;
        for item in recording.items()? {
            item?;
            count += 1;
        }
        let all_s = begun.elapsed().as_secs_f64();
        let (first, second) = (count as f64 / first_s, count as f64 / (all_s - first_s));
        println!("{file}: {count} samples, {first:.0} samples/s in the first pass, {second:.0} in the second");
    }
    Ok(())
}
