//! A filter as a judge of the noise that it assumes of its sensor: `imu_judge` on simulated worlds and on recordings at rest.
//!
//! ```text
//! cargo run --release -p imu-judge --example filter_judge -- worlds [NIGHTS [fitted|interval]]
//! cargo run --release -p imu-judge --example filter_judge -- held-out PLAIN.json MODEL.json SAMPLES.csv
//! ```
//!
//! `worlds` prints the tables of docs/filters.md for that many nights (20) of each world. The consistent pairs are those of the
//! true model for horizons from a third of the outage on, with `interval` from the time between two fixes on. With `fitted` they
//! are those of the model that is fitted to one more night, and N and K of the Allan rows are those fitted without effects.
//! `held-out` judges samples with the pairs of a model that was fitted to others, and with N and K of one that was fitted to these
//! without effects (`tests/real/filters.py`).

mod held_out;
mod table;
mod worlds;

use worlds::Source;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let given: Vec<String> = std::env::args().skip(1).collect();
    match given.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["worlds"] => worlds::run(20, Source::Truth),
        ["worlds", nights] => worlds::run(nights.parse()?, Source::Truth),
        ["worlds", nights, "fitted"] => worlds::run(nights.parse()?, Source::Fitted),
        ["worlds", nights, "interval"] => worlds::run(nights.parse()?, Source::FromInterval),
        ["held-out", plain, model, samples] => held_out::run(plain, model, samples),
        _ => Err("expected `worlds [NIGHTS [fitted|interval]]` or `held-out PLAIN.json MODEL.json SAMPLES.csv`".into()),
    }
}
