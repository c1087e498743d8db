//! Round trips: effects simulated under coloured noise, fitted, and compared with the simulated values.

use super::*;
use imu_model::motion::{Course, Kind, Site};
use imu_model::simulator::{ChannelModel, SensorModel, Simulator, TriadModel};

pub(super) const RATE_HZ: f64 = 20.0;
const SEEDS: u64 = 60;

/// Returns a motion of this many samples.
pub(super) fn motion(kind: Kind, samples: usize, rate_hz: f64) -> Vec<Motion> {
    let course = Course::new(kind, samples as f64 / rate_hz, Site::default()).unwrap();
    course.sampled(rate_hz).take(samples).collect()
}

pub(super) fn rate_table() -> Vec<Motion> {
    motion(Kind::RateTable, 2187, RATE_HZ)
}

pub(super) fn tumble() -> Vec<Motion> {
    motion(Kind::Tumble, 1575, RATE_HZ)
}

/// Returns a sensor whose N, B and K all show in 100 s, with a separate size for each axis.
pub(super) fn sensor(triad: Triad, effects: &[Arc<dyn TriadEffect>]) -> SensorModel {
    let unit = if triad == Triad::Gyro { 1.0 } else { 10.0 };
    let of = |axis: usize| {
        let unit = unit * (1.0 + 0.5 * axis as f64);
        ChannelModel { n: 1e-4 * unit, b: 5e-5 * unit, k: 3e-5 * unit, ..ChannelModel::default() }
    };
    let channels = triad.channels().into_iter().enumerate();
    SensorModel {
        name: "test".into(),
        rate_hz: RATE_HZ,
        channels: channels.map(|(axis, channel)| (channel, of(axis))).collect(),
        triads: [(triad, TriadModel { effects: effects.to_vec() })].into(),
        ..SensorModel::default()
    }
}

pub(super) fn simulated(
    model: &SensorModel,
    triad: Triad,
    reference: &[Motion],
    rate_hz: f64,
    seed: u64,
) -> [Vec<f64>; 3] {
    let length_s = reference.len() as f64 / rate_hz;
    let mut simulator = Simulator::new(model, seed, rate_hz, length_s).unwrap();
    let motions = reference.to_vec();
    simulator = simulator.with_motion(motions.into_iter());
    let mut columns: [Vec<f64>; 3] = Default::default();
    while let Some(sample) = simulator.next_sample() {
        for (column, channel) in columns.iter_mut().zip(triad.channels()) {
            column.push(sample.values[channel as usize]);
        }
    }
    columns
}

impl Estimate {
    /// Returns the value ± 1.96 standard errors.
    pub(super) fn ci95(&self) -> [f64; 2] {
        [-1.0, 1.0].map(|sign| self.value + sign * NORMAL_95 * self.standard_error.unwrap())
    }
}

/// One record and its law.
pub(super) struct Case {
    pub(super) triad: Triad,
    pub(super) reference: Vec<Motion>,
    pub(super) model: SensorModel,
    pub(super) law: NoiseLaw,
}

impl Case {
    pub(super) fn new(triad: Triad, reference: Vec<Motion>, truth: &[(Candidate, Vec<f64>)]) -> Self {
        let effects: Vec<Arc<dyn TriadEffect>> = truth.iter().map(|(of, values)| of.make(values)).collect();
        let model = sensor(triad, &effects);
        let law = NoiseLaw::of_model(&model, triad, RATE_HZ, reference.len()).unwrap();
        Self { triad, reference, model, law }
    }

    pub(super) fn samples(&self, seed: u64) -> [Vec<f64>; 3] {
        simulated(&self.model, self.triad, &self.reference, RATE_HZ, seed)
    }

    pub(super) fn fit_to(&self, samples: &[Vec<f64>; 3], candidates: &[Candidate], clock: Clock) -> Fit {
        let record = Record {
            rate_hz: RATE_HZ,
            triad: self.triad,
            samples: samples.each_ref().map(Vec::as_slice),
            reference: &self.reference,
            temperature_c: None,
            left_out: &[],
            sent: None,
        };
        fit(&record, &self.law, &Request { known: &[], level: [0.0; 3], candidates, clock, filters: &NO_FILTERS })
            .unwrap()
    }

    /// Returns the nats by which one fit is better than another, if no sample was left out.
    pub(super) fn gain(&self, with: &Fit, without: &Fit) -> f64 {
        let square = |of: &Fit| of.misfit.iter().sum::<f64>();
        0.5 * self.reference.len() as f64 * (square(without) - square(with))
    }

    pub(super) fn fit(&self, seed: u64, candidates: &[Candidate]) -> Fit {
        self.fit_to(&self.samples(seed), candidates, Clock::Shared)
    }
}

/// Returns how often the intervals of each parameter hold over the seeds. The true values are those of `truth`, 0 for
/// others.
fn coverage(triad: Triad, reference: Vec<Motion>, truth: &[(Candidate, Vec<f64>)], others: &[Candidate]) {
    let case = Case::new(triad, reference, truth);
    let candidates: Vec<Candidate> = truth.iter().map(|(of, _)| *of).chain(others.iter().copied()).collect();
    let mut held: Vec<u64> = Vec::new();
    let mut misfit = 0.0;
    let mut names = Vec::new();
    for seed in 0..SEEDS {
        let found = case.fit(seed, &candidates);
        misfit += found.misfit.iter().sum::<f64>() / (3.0 * SEEDS as f64);
        held.resize(found.estimates.len(), 0);
        names = found.estimates.iter().map(|one| format!("{:?} {}", one.effect, one.parameter)).collect();
        for fitted in &found.fitted {
            let same = truth.iter().find(|(of, _)| of.coefficients_of(fitted.effect.as_ref()).is_some());
            for (place, index) in fitted.places.clone().enumerate() {
                let truth = same.and_then(|(_, values)| values.get(place)).copied().unwrap_or(0.0);
                let [low, high] = found.estimates[index].ci95();
                held[index] += u64::from((low..=high).contains(&truth));
            }
        }
    }
    let share = held.iter().sum::<u64>() as f64 / (SEEDS * held.len() as u64) as f64;
    println!("{} {}: {:.1} % {held:?}", triad.name(), candidates[0].kind(), 100.0 * share);
    // Binomial: one parameter in 60 trials falls below 50 with 2e-4; the parameters of a fit are not independent.
    for (held, name) in held.iter().zip(&names) {
        assert!(*held >= 50, "{name}: {held} of {SEEDS}");
    }
    let error = (0.95 * 0.05 / (SEEDS * held.len() as u64) as f64).sqrt();
    assert!((share - 0.95).abs() < 3.3 * error, "{candidates:?}: {share}");
    assert!((misfit - 1.0).abs() < 0.02, "{misfit}");
}

pub(super) const FULL_SCALE: f64 = 4.0;

pub(super) fn nonlinearity(full_scale: f64, signed: bool) -> Candidate {
    Candidate::ScaleFactorNonlinearity { full_scale, signed }
}

#[test]
fn intervals_of_bias_and_scale_factor_hold() {
    let bias = (Candidate::Bias, vec![1e-3, -2e-3, 5e-4]);
    let scale = (Candidate::ScaleFactor, vec![2e-3, -1e-3, 5e-4]);
    coverage(Triad::Gyro, rate_table(), std::slice::from_ref(&bias), &[]);
    coverage(Triad::Gyro, rate_table(), &[scale.clone(), bias], &[]);
    let bias = (Candidate::Bias, vec![0.02, -0.05, 0.01]);
    coverage(Triad::Accel, tumble(), &[scale, bias], &[]);
}

#[test]
fn intervals_of_nonlinearity_hold_in_both_forms() {
    let both = [
        (nonlinearity(FULL_SCALE, true), vec![1e-3, -2e-3, 3e-3]),
        (nonlinearity(FULL_SCALE, false), vec![-1e-3, 1e-3, 5e-4]),
    ];
    coverage(Triad::Gyro, rate_table(), &both, &[Candidate::Bias, Candidate::ScaleFactor]);
    let unsigned = (nonlinearity(20.0, false), vec![1e-3, -1e-3, 5e-4]);
    coverage(Triad::Accel, tumble(), &[unsigned], &[Candidate::Bias, Candidate::ScaleFactor]);
}

#[test]
fn intervals_of_misalignment_and_cross_axis_sensitivity_hold() {
    let misalignment = (Candidate::Misalignment, vec![1e-3, -2e-3, 5e-4]);
    let cross = (Candidate::CrossAxisSensitivity, vec![1e-3, -5e-4, 2e-3]);
    coverage(Triad::Gyro, rate_table(), std::slice::from_ref(&misalignment), &[Candidate::Bias]);
    coverage(Triad::Gyro, rate_table(), std::slice::from_ref(&cross), &[Candidate::Bias, Candidate::ScaleFactor]);
    coverage(Triad::Accel, tumble(), &[misalignment, cross], &[Candidate::Bias, Candidate::ScaleFactor]);
}

#[test]
fn intervals_of_g_sensitivity_hold() {
    let m = vec![1e-4, -2e-4, 5e-5, 3e-4, 0.0, 1e-4, -1e-4, 2e-4, -3e-4];
    coverage(Triad::Gyro, tumble(), &[(Candidate::GSensitivity, m)], &[Candidate::Bias]);
}

#[test]
fn intervals_of_rectification_hold() {
    let rectified = (Candidate::Rectification, vec![1e-4, -5e-5, 2e-5]);
    coverage(Triad::Gyro, tumble(), std::slice::from_ref(&rectified), &[Candidate::Bias]);
    let rectified = (Candidate::Rectification, vec![1e-3, -5e-4, 2e-4]);
    coverage(Triad::Accel, tumble(), &[rectified], &[Candidate::Bias, Candidate::ScaleFactor]);
}

#[test]
fn intervals_of_a_scale_factor_that_follows_the_temperature_hold() {
    let warm = Candidate::TemperatureScale { reference_c: 30.0 };
    let numbers = [2e-4, -1e-4, 5e-5];
    let mut reference = rate_table();
    let temperature_c: Vec<f64> = (0..reference.len()).map(|t| 28.0 + 8.0 * (2e-3 * t as f64).sin()).collect();
    reference.iter_mut().zip(&temperature_c).for_each(|(motion, of)| motion.temperature_c = Some(*of));
    let case = Case::new(Triad::Gyro, reference, &[(warm, numbers.to_vec())]);
    let mut held = 0;
    for seed in 0..SEEDS {
        let samples = case.samples(seed);
        let record = Record {
            rate_hz: RATE_HZ,
            triad: Triad::Gyro,
            samples: samples.each_ref().map(Vec::as_slice),
            reference: &case.reference,
            temperature_c: Some(&temperature_c),
            left_out: &[],
            sent: None,
        };
        let candidates = [Candidate::ScaleFactor, Candidate::Bias, warm];
        let request = Request {
            known: &[],
            level: [0.0; 3],
            candidates: &candidates,
            clock: Clock::Shared,
            filters: &NO_FILTERS,
        };
        let found = fit(&record, &case.law, &request).unwrap();
        for (index, truth) in found.fitted[2].places.clone().zip(numbers) {
            let [low, high] = found.estimates[index].ci95();
            held += u64::from((low..=high).contains(&truth));
        }
    }
    // 180 intervals of 95 %: 171 on average, with a standard deviation of 3.
    assert!(held >= 161, "{held}");
}

#[test]
fn intervals_of_latency_hold_with_other_effects_beside_it() {
    let late = |seconds: f64| (Candidate::Latency, vec![seconds]);
    coverage(Triad::Gyro, rate_table(), &[late(0.02)], &[Candidate::Bias]);
    let scale = (Candidate::ScaleFactor, vec![5e-3, -1e-3, 2e-3]);
    let m = (Candidate::GSensitivity, vec![1e-4, -2e-4, 5e-5, 3e-4, 0.0, 1e-4, -1e-4, 2e-4, -3e-4]);
    coverage(Triad::Gyro, rate_table(), &[late(0.73), scale, m], &[Candidate::Bias]);
    coverage(Triad::Accel, tumble(), &[late(0.31)], &[Candidate::Bias, Candidate::ScaleFactor]);
}

#[test]
fn intervals_hold_where_samples_are_clipped() {
    let scale = (Candidate::ScaleFactor, vec![2e-3, -1e-3, 5e-4]);
    let bias = (Candidate::Bias, vec![1e-3, -2e-3, 5e-4]);
    // Below the fastest stair, and exactly at one, at which the noise decides which samples are clipped.
    for range in [3.0, 1.7459] {
        let saturation = (Candidate::Saturation, vec![range]);
        coverage(Triad::Gyro, rate_table(), &[scale.clone(), bias.clone(), saturation], &[]);
    }
}
