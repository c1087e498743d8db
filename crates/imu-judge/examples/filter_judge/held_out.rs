//! Recordings at rest: samples that the model has not seen.

use crate::table::{Judged, PARTS};
use crate::worlds::{begin_s, plan};
use imu_core::sample::Channel;
use imu_judge::{Aid, Outcome, Plan, Sample, assumed, channels, outages, own};
use imu_model::simulator::SensorModel;
use nalgebra::Vector3;

/// The stretches that a record has at least.
const STRETCHES: f64 = 8.0;

/// Returns the course for a record of that length: that of the worlds, shortened in proportion if the record is short.
fn plan_for(length_s: f64) -> Plan {
    let usual = plan(Aid::ZeroVelocity);
    let part = (length_s / STRETCHES / (usual.align_s + usual.aided_s + usual.outage_s)).min(1.0);
    let outage_s = usual.outage_s * part;
    let interval_s = usual.interval_s.min(outage_s / 5.0);
    Plan { align_s: usual.align_s * part, aided_s: usual.aided_s * part, outage_s, interval_s, ..usual }
}

/// Reads the samples of a CSV that `vn100d export` wrote: columns named `gyro_x_rad_s` and so on. Returns them with the columns
/// that are there. A missing value repeats the one before.
fn read(path: &str) -> Result<(Vec<Sample>, [bool; 6]), Box<dyn std::error::Error>> {
    let mut reader = csv::Reader::from_path(path)?;
    let header = reader.headers()?.clone();
    let places = channels().map(|channel: Channel| header.iter().position(|name| name.starts_with(channel.name())));
    let (mut samples, mut last) = (Vec::new(), [0.0; 6]);
    for row in reader.records() {
        let row = row?;
        for (value, place) in last.iter_mut().zip(places) {
            let field = place.and_then(|place| row.get(place)).filter(|field| !field.is_empty());
            *value = field.map_or(Ok(*value), str::parse)?;
        }
        samples.push(last);
    }
    Ok((samples, places.map(|place| place.is_some())))
}

/// Prints the rows of a recording: mean NEES, coverage and log scores, with a line on the course.
pub fn run(plain: &str, model: &str, samples: &str) -> Result<(), Box<dyn std::error::Error>> {
    let [plain, model] = [plain, model].map(|path| -> Result<SensorModel, Box<dyn std::error::Error>> {
        Ok(SensorModel::from_json(&std::fs::read_to_string(path)?, path)?)
    });
    let (plain, model) = (plain?, model?);
    let (samples, present) = read(samples)?;
    let rate_hz = model.rate_hz;
    let plan = plan_for(samples.len() as f64 / rate_hz);
    let has_accel = present[3..] == [true; 3];
    let mean = |at: usize| samples.iter().map(|of| of[at]).sum::<f64>();
    let up = if has_accel { Vector3::new(mean(3), mean(4), mean(5)).normalize() } else { Vector3::z() };
    let outcomes = assumed(&model, &own(&plain), &plan.request(begin_s(&plan)))?
        .map(|noise| -> Vec<Outcome> { outages(&samples, rate_hz, up, &noise, &plan, 1) });
    // Without an accelerometer attitude alone is judged.
    let parts = if has_accel { &PARTS[..] } else { &PARTS[1..2] };
    let judged = Judged::new(&outcomes, parts);
    let (outages, bounds) = judged.bounds().ok_or("no outage, or no noise")?;
    println!("{}", judged.nees());
    println!("{}", judged.coverage());
    println!("{outages} of {:.1} s: {:.2} … {:.2}", plan.outage_s, bounds[0][0], bounds[0][1]);
    Ok(())
}
