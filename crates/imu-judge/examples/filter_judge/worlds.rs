//! Simulated worlds: N, B and K with at most one effect, on all axes of gyroscope and accelerometer.

use crate::table::{Judged, PARTS, head, summary};
use imu_cost::FilterRequest;
use imu_diagnosis::{Options, Recording, diagnose};
use imu_judge::{Aid, Density, Noise, Outcome, Plan, Sample, assumed, channels, outages, own};
use imu_model::simulator::{ChannelModel, SensorModel, Simulator};
use imu_noise::allan::FixedPoint;
use imu_noise::whittle::{DstEstimator, Transform, fit_as_sampled};
use nalgebra::Vector3;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The rate of the samples, Hz, and the length of a night, s.
const RATE_HZ: f64 = 40.0;
const NIGHT_S: f64 = 1800.0;

/// A name, and what the world adds to N, B and K of each axis of gyroscope and accelerometer. The first eight are those of
/// `examples/cost_coverage.rs`.
const WORLDS: [(&str, &str, &str); 14] = [
    ("N, B and K alone", "", ""),
    (
        "tone at 1.37 Hz",
        r#"{"effect": "tone", "frequency_hz": 1.37, "amplitude": 3e-3}"#,
        r#"{"effect": "tone", "frequency_hz": 1.37, "amplitude": 0.03}"#,
    ),
    (
        "warm_up",
        r#"{"effect": "warm_up", "amplitude": 1e-3, "tau_s": 900}"#,
        r#"{"effect": "warm_up", "amplitude": 2e-2, "tau_s": 900}"#,
    ),
    (
        "gauss_markov",
        r#"{"effect": "gauss_markov", "sigma": 2e-4, "tc_s": 20}"#,
        r#"{"effect": "gauss_markov", "sigma": 5e-3, "tc_s": 20}"#,
    ),
    (
        "spikes",
        r#"{"effect": "spikes", "rate_hz": 0.02, "amplitude": 5e-3}"#,
        r#"{"effect": "spikes", "rate_hz": 0.02, "amplitude": 0.1}"#,
    ),
    ("rate_ramp", r#"{"effect": "rate_ramp", "R": 1e-7}"#, r#"{"effect": "rate_ramp", "R": 2e-6}"#),
    (
        "resonance",
        r#"{"effect": "resonance", "frequency_hz": 0.8, "bandwidth_hz": 0.1, "sigma": 1e-3}"#,
        r#"{"effect": "resonance", "frequency_hz": 0.8, "bandwidth_hz": 0.1, "sigma": 2e-2}"#,
    ),
    (
        "bias_step",
        r#"{"effect": "bias_step", "at_s": 400, "size": 2e-4}"#,
        r#"{"effect": "bias_step", "at_s": 400, "size": 5e-3}"#,
    ),
    (
        "tone at 13.38 Hz",
        r#"{"effect": "tone", "frequency_hz": 13.38, "amplitude": 2e-2}"#,
        r#"{"effect": "tone", "frequency_hz": 13.38, "amplitude": 0.2}"#,
    ),
    (
        "bursts",
        r#"{"effect": "bursts", "intervals": [[300, 420], [1000, 1180], [1500, 1560]], "sigma": 2e-3}"#,
        r#"{"effect": "bursts", "intervals": [[300, 420], [1000, 1180], [1500, 1560]], "sigma": 0.04}"#,
    ),
    (
        "variance_change",
        r#"{"effect": "variance_change", "from_s": 600, "to_s": 1200, "factor": 2}"#,
        r#"{"effect": "variance_change", "from_s": 600, "to_s": 1200, "factor": 2}"#,
    ),
    (
        "quantization_noise",
        r#"{"effect": "quantization_noise", "Q": 2e-5}"#,
        r#"{"effect": "quantization_noise", "Q": 4e-4}"#,
    ),
    ("common_mode", r#"{"effect": "common_mode", "sigma": 1e-3}"#, r#"{"effect": "common_mode", "sigma": 2e-2}"#),
    (
        "power_law",
        r#"{"effect": "power_law", "alpha": 1.5, "at_hz": 0.01, "density": 1e-7}"#,
        r#"{"effect": "power_law", "alpha": 1.5, "at_hz": 0.01, "density": 2e-5}"#,
    ),
];

/// N, B and K of each world, of a gyroscope and of an accelerometer.
const GYRO: &str = r#""N": 1.2e-4, "B": 2.6e-5, "K": 1e-6"#;
const ACCEL: &str = r#""N": 2e-3, "B": 4e-4, "K": 1e-5"#;

/// Returns the model of a world.
fn model(name: &str, gyro: &str, accel: &str) -> Result<SensorModel, Box<dyn std::error::Error>> {
    let channel = |(at, channel): (usize, _)| {
        let (noise, effect) = if at < 3 { (GYRO, gyro) } else { (ACCEL, accel) };
        format!(r#""{channel}": {{{noise}, "effects": [{effect}]}}"#)
    };
    let all: Vec<String> = channels().into_iter().enumerate().map(channel).collect();
    let text = format!(
        r#"{{"format": "vn100d-sensor-model-1", "name": "{name}", "rate_hz": {RATE_HZ}, "channels": {{{}}}}}"#,
        all.join(", ")
    );
    Ok(SensorModel::from_json(&text, name)?)
}

/// Returns the samples of a night.
fn night(model: &SensorModel, seed: u64) -> Result<Vec<Sample>, Box<dyn std::error::Error>> {
    let count = (NIGHT_S * RATE_HZ) as usize;
    let mut simulator = Simulator::new(model, seed, RATE_HZ, NIGHT_S)?;
    let mut samples = Vec::with_capacity(count);
    while samples.len() < count {
        let Some(block) = simulator.next_block() else { break };
        let columns = channels().map(|channel| block.values(channel).unwrap_or_default());
        samples.extend((0..block.len()).map(|at| columns.map(|column| column.get(at).copied().unwrap_or(0.0))));
    }
    samples.truncate(count);
    Ok(samples)
}

/// Nights whose outages are judged together, some 50 of them, beside all nights.
const GROUP: usize = 5;
/// Where in its stretch a night begins, so that outages come at any time of the record: multiples of the golden section are
/// spread evenly.
const GOLDEN: f64 = 0.618_033_988_749_895;

/// The course of the judge.
pub fn plan(aid: Aid) -> Plan {
    let aid_sd = if aid == Aid::Position { 0.01 } else { 2e-3 };
    Plan { align_s: 30.0, aided_s: 90.0, interval_s: 1.0, outage_s: 60.0, aid, aid_sd, attitude_sd: 1e-4 }
}

/// Returns where the horizons of the consistent pairs begin, s: at a third of the outage.
pub fn begin_s(plan: &Plan) -> f64 {
    plan.outage_s / 3.0
}

/// What the consistent pairs are those of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// The true model, for outages of about the judged length.
    Truth,
    /// The true model, for horizons from the time between two fixes on.
    FromInterval,
    /// A model that was fitted to a night.
    Fitted,
}

/// Fits a model to a night: N, B and K by Whittle likelihood, then the effects that a diagnosis finds beside them. Returns it
/// with N and K as they are without effects.
fn fitted(samples: &[Sample]) -> Result<(SensorModel, Noise), Box<dyn std::error::Error>> {
    let mut plain = SensorModel { name: "fitted".to_owned(), rate_hz: RATE_HZ, ..SensorModel::default() };
    let (mut allan, mut columns, mut transform) = (Noise::default(), Vec::new(), Transform::new());
    for (at, channel) in channels().into_iter().enumerate() {
        let column: Vec<f64> = samples.iter().map(|of| of[at]).collect();
        let mut estimator = DstEstimator::new(FixedPoint::for_channel(channel));
        estimator.push(&mut transform, &column);
        let found = fit_as_sampled(&estimator.into_sums(&mut transform), RATE_HZ, channel, None);
        let [n, b, k] = [&found.n, &found.b, &found.k].map(|of| of.value.unwrap_or(0.0));
        allan[at] = Density { n, k };
        plain.channels.insert(channel, ChannelModel { n, b, k, ..ChannelModel::default() });
        columns.push((channel, column));
    }
    let recording = Recording { rate_hz: RATE_HZ, channels: columns, ..Recording::default() };
    Ok((diagnose(&recording, &plain, &Options::default())?.augmented, allan))
}

/// The outcomes of all filters of one world, by aid, filter and night.
type Outcomes = Vec<Vec<Vec<Vec<Outcome>>>>;

fn judged(at: usize, nights: usize, of: Source) -> Result<Outcomes, Box<dyn std::error::Error>> {
    let (name, gyro, accel) = WORLDS[at];
    let truth = model(name, gyro, accel)?;
    let seed = |night: usize| 1_000_000 * (at as u64 + 1) + night as u64;
    let (model, allan) = match of {
        Source::Fitted => fitted(&night(&truth, seed(nights))?)?,
        Source::Truth | Source::FromInterval => (truth.clone(), own(&truth)),
    };
    let plan = plan(Aid::Position);
    let from_s = if of == Source::FromInterval { plan.interval_s } else { begin_s(&plan) };
    let request = FilterRequest { record_s: Some(NIGHT_S), ..plan.request(from_s) };
    let noise = assumed(&model, &allan, &request)?;
    let mut all: Outcomes = vec![vec![Vec::new(); noise.len()]; AIDS.len()];
    for place in 0..nights {
        let samples = night(&truth, seed(place))?;
        for (aid, all) in AIDS.iter().zip(&mut all) {
            let plan = self::plan(*aid);
            let stretch = (plan.align_s + plan.aided_s + plan.outage_s) * RATE_HZ;
            let begin = ((place as f64 * GOLDEN).fract() * stretch) as usize;
            for (noise, all) in noise.iter().zip(all) {
                all.push(outages(&samples[begin..], RATE_HZ, Vector3::z(), noise, &plan, seed(place)));
            }
        }
    }
    Ok(all)
}

const AIDS: [Aid; 2] = [Aid::ZeroVelocity, Aid::Position];

/// Prints the tables of all worlds.
pub fn run(nights: usize, source: Source) -> Result<(), Box<dyn std::error::Error>> {
    let found: Vec<Mutex<Result<Outcomes, String>>> = WORLDS.iter().map(|_| Mutex::new(Err(String::new()))).collect();
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    let Some(own) = found.get(at) else { break };
                    let outcomes = judged(at, nights, source).map_err(|error| error.to_string());
                    *own.lock().unwrap_or_else(|poisoned| poisoned.into_inner()) = outcomes;
                }
            });
        }
    });
    let mut worlds = Vec::new();
    for own in found {
        worlds.push(own.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner())?);
    }
    for (place, aid) in AIDS.iter().enumerate() {
        let judge = |of: &Outcomes, nights: std::ops::Range<usize>| {
            let filters: Vec<Vec<Outcome>> = of[place].iter().map(|own| own[nights.clone()].concat()).collect();
            Judged::new(&filters, &PARTS)
        };
        let whole: Vec<Judged> = worlds.iter().map(|of| judge(of, 0..nights)).collect();
        let Some((outages, bounds)) = whole.iter().find_map(Judged::bounds) else { continue };
        println!("\n## {aid:?}, {outages} outages of a world");
        println!("Bounds of all errors {:.2?}, of a triad {:.2?}", bounds[0], bounds[1]);
        head("mean NEES: all, attitude, velocity, position");
        WORLDS.iter().zip(&whole).for_each(|((name, ..), of)| println!("| {name} | {} |", of.nees()));
        head("coverage, log score behind the best");
        WORLDS.iter().zip(&whole).for_each(|((name, ..), of)| println!("| {name} | {} |", of.coverage()));
        println!();
        summary(&whole);
        let groups = (0..nights / GROUP).map(|of| GROUP * of..GROUP * (of + 1));
        let parts: Vec<Judged> =
            groups.flat_map(|group| worlds.iter().map(move |of| judge(of, group.clone()))).collect();
        println!("\nEach {GROUP} nights for themselves:");
        summary(&parts);
    }
    Ok(())
}
