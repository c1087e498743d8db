//! A filter as a judge of what it is told about its sensor's noise: `imu_judge` on simulated worlds and on recordings at rest.
//!
//! ```text
//! cargo run --release -p imu-judge --example filter_judge -- worlds [NIGHTS [fitted]]
//! cargo run --release -p imu-judge --example filter_judge -- held-out MODEL.json SAMPLES.csv
//! ```
//!
//! `worlds` prints the tables of docs/filters.md for that many nights (20) of each world. The consistent pairs are those of the
//! true model, or with `fitted` those of the model that is fitted to one more night, whose N and K are then those of the Allan
//! rows. `held-out` judges the samples with the pairs of a model that was fitted to others (`tests/real/filters.py`).

mod held_out;
mod table;
mod worlds;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let given: Vec<String> = std::env::args().skip(1).collect();
    match given.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["worlds"] => worlds::run(20, false),
        ["worlds", nights] => worlds::run(nights.parse()?, false),
        ["worlds", nights, "fitted"] => worlds::run(nights.parse()?, true),
        ["held-out", model, samples] => held_out::run(model, samples),
        _ => Err("expected `worlds [NIGHTS [fitted]]` or `held-out MODEL.json SAMPLES.csv`".into()),
    }
}
