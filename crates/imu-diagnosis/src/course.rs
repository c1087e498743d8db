//! Courses: functions of time that a level may follow, with their transforms at low frequencies.

use super::transform::Cosines;
use std::f64::consts::PI;
use std::sync::OnceLock;

/// A deterministic course of a level over a record of n samples, with coefficient 1.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum Course {
    /// From −½ to ½ over the record.
    Ramp,
    /// The temperature about its reference, °C.
    Temperature,
    /// exp(−t/τ), τ in samples.
    WarmUp(f64),
    /// 0 before this sample, 1 from it on.
    Step(usize),
    /// The temperature, other than along an immediate straight line.
    Follows(Follow),
}

/// How a level may follow the temperature other than along a straight line ([`imu_model::effects::TemperatureBias`]).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum Follow {
    /// The square of the temperature, °C².
    Square,
    /// With play of this many °C: the level stays while the temperature is within half of the play (a backlash;
    /// Visintin 1994, Differential Models of Hysteresis, section III.2).
    Play(f64),
    /// The rate at which the temperature changes, behind a lag of this many samples, °C per sample
    /// ([`imu_model::effects::TemperatureBias::per_c_per_s`]).
    Rate(f64),
}

impl Follow {
    /// Returns the values at each sample, about their mean.
    fn values(self, temperature: &[f64]) -> Vec<f64> {
        let mut values = self.raw(temperature);
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        values.iter_mut().for_each(|value| *value -= mean);
        values
    }

    /// Returns the values at each sample for a temperature, °C.
    pub(super) fn raw(self, temperature: &[f64]) -> Vec<f64> {
        match self {
            Self::Square => temperature.iter().map(|t| t * t).collect(),
            Self::Play(width) => {
                let mut now = temperature.first().copied().unwrap_or_default();
                let mut follow = |t: &f64| {
                    now = now.clamp(t - 0.5 * width, t + 0.5 * width);
                    now
                };
                temperature.iter().map(&mut follow).collect()
            }
            Self::Rate(lag) => {
                let share = -(-1.0 / lag).exp_m1();
                let mut behind = temperature.first().copied().unwrap_or_default();
                let mut rate = |t: &f64| {
                    let off = t - behind;
                    behind += share * off;
                    off / lag
                };
                temperature.iter().map(&mut rate).collect()
            }
        }
    }
}

/// The data about a record that courses need.
#[derive(Debug, Clone)]
pub struct Courses {
    samples: usize,
    kept: usize,
    ramp: Vec<f64>,
    /// The temperature about the reference, °C, with its transform.
    temperature: Option<(Vec<f64>, Vec<f64>)>,
    /// Transforms of the other courses that may follow the temperature.
    follows: OnceLock<Vec<(Follow, Vec<f64>)>>,
    /// The lag of [`Follow::Rate`], samples.
    lag: f64,
    /// Step in which the temperature was read, °C; 0 if no step is visible.
    pub(super) reading_c: f64,
}

impl Courses {
    /// Number of coefficients used: courses are slow.
    pub const KEPT: usize = 4096;

    /// Creates courses for records as long as the transform. `temperature` is the sensor's at every sample about some
    /// reference, °C, if it was measured; smooth rounded readings first. `lag` is the lag behind which a level follows
    /// the temperature's rate, samples.
    pub fn new(transform: &mut Cosines, temperature: Option<&[f64]>, lag: f64) -> Self {
        let samples = transform.length();
        let kept = Self::KEPT.min(samples);
        let mut ramp: Vec<f64> = (0..samples).map(|t| ramp(t, samples)).collect();
        transform.forward(&mut ramp);
        ramp.truncate(kept);
        let temperature = temperature.filter(|values| values.len() == samples).map(|values| {
            let mut coefficients = values.to_vec();
            transform.forward(&mut coefficients);
            coefficients.truncate(kept);
            (values.to_vec(), coefficients)
        });
        Self { samples, kept, ramp, temperature, follows: OnceLock::new(), lag, reading_c: 0.0 }
    }

    /// Returns the ways in which a level may follow this record's temperature; empty if the temperature moves too
    /// little to distinguish them.
    pub fn ways(&self) -> Vec<Follow> {
        const LEAST_C: f64 = 0.5;
        const SHARES: [f64; 5] = [0.05, 0.1, 0.2, 0.35, 0.6];
        let values = self.temperature().unwrap_or_default();
        let (low, high) = values.iter().fold((0.0, 0.0), |(l, h): (f64, f64), t| (l.min(*t), h.max(*t)));
        if high - low < LEAST_C {
            return Vec::new();
        }
        let plays = SHARES.into_iter().map(|share| Follow::Play(share * (high - low)));
        [Follow::Square, Follow::Rate(self.lag)].into_iter().chain(plays).collect()
    }

    fn transformed(&self, way: Follow) -> Vec<f64> {
        let mut values = way.values(self.temperature().unwrap_or_default());
        Cosines::new(self.samples).forward(&mut values);
        values.truncate(self.kept);
        values
    }

    /// Returns the number of samples in the record.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Returns the temperature about its reference, °C.
    pub fn temperature(&self) -> Option<&[f64]> {
        self.temperature.as_ref().map(|(about, _)| about.as_slice())
    }

    /// Returns the first coefficients of a course's transform, [`Courses::KEPT`] at most; the first, a constant's, is
    /// 0.
    pub fn coefficients(&self, course: Course) -> Vec<f64> {
        let n = self.samples as f64;
        let scale = (2.0 / n).sqrt();
        let mut found = match course {
            Course::Ramp => self.ramp.clone(),
            Course::Temperature => {
                self.temperature.as_ref().map_or_else(|| vec![0.0; self.kept], |(_, coefficients)| coefficients.clone())
            }
            Course::Follows(way) => {
                let all = || self.ways().into_iter().map(|way| (way, self.transformed(way))).collect();
                match self.follows.get_or_init(all).iter().find(|(own, _)| *own == way) {
                    Some((_, coefficients)) => coefficients.clone(),
                    None if self.temperature.is_none() => vec![0.0; self.kept],
                    // This way belongs to another record, of which this record is a part.
                    None => self.transformed(way),
                }
            }
            // The geometric series of exp(−t/τ + iθ(t + ½)).
            Course::WarmUp(tau) => {
                let pole = (-1.0 / tau).exp();
                let end = (-n / tau).exp();
                let of = |k: usize| {
                    let theta = PI * k as f64 / n;
                    let last = if k.is_multiple_of(2) { 1.0 - end } else { 1.0 + end };
                    // Re e^(iθ/2)/(1 − p e^(iθ)) = (1 − p) cos(θ/2)/(1 − 2p cos θ + p²).
                    let below = (1.0 - pole).powi(2) + 4.0 * pole * (0.5 * theta).sin().powi(2);
                    scale * last * (1.0 - pole) * (0.5 * theta).cos() / below
                };
                (0..self.kept).map(of).collect()
            }
            Course::Step(at) => {
                let of = |k: usize| {
                    let theta = PI * k as f64 / n;
                    -scale * (theta * at as f64).sin() / (2.0 * (0.5 * theta).sin())
                };
                (0..self.kept).map(|k| if k == 0 { 0.0 } else { of(k) }).collect()
            }
        };
        if let Some(constant) = found.first_mut() {
            *constant = 0.0;
        }
        found
    }

    /// Returns the first coefficients of a cosine and a sine of this many cycles per sample (not a whole multiple of
    /// half a cycle).
    pub fn turning(&self, cycles: f64) -> [Vec<f64>; 2] {
        let n = self.samples as f64;
        let turn = std::f64::consts::TAU * cycles;
        // Σ cos and Σ sin of a·t + b over the record.
        let sums = |a: f64, b: f64| {
            let half = 0.5 * a;
            let ratio = if half.sin().abs() < 1e-12 { n } else { (n * half).sin() / half.sin() };
            let (sine, cosine) = ((n - 1.0) * half + b).sin_cos();
            [ratio * cosine, ratio * sine]
        };
        let of = |k: usize| {
            let step = PI * k as f64 / n;
            let [above, below] = [sums(turn + step, 0.5 * step), sums(turn - step, -0.5 * step)];
            let scale = if k == 0 { 0.0 } else { (2.0 / n).sqrt() };
            [0, 1].map(|part| 0.5 * scale * (above[part] + below[part]))
        };
        let both: Vec<[f64; 2]> = (0..self.kept).map(of).collect();
        [0, 1].map(|part| both.iter().map(|of| of[part]).collect())
    }

    /// Adds `factor` times a course to values.
    pub fn add(&self, course: Course, factor: f64, values: &mut [f64]) {
        match course {
            Course::Ramp => {
                values.iter_mut().enumerate().for_each(|(t, value)| *value += factor * ramp(t, self.samples));
            }
            Course::Temperature => {
                let about = self.temperature().unwrap_or_default();
                values.iter_mut().zip(about).for_each(|(value, t)| *value += factor * t);
            }
            Course::Follows(way) => {
                let own = way.values(self.temperature().unwrap_or_default());
                values.iter_mut().zip(own).for_each(|(value, t)| *value += factor * t);
            }
            Course::WarmUp(tau) => {
                let rate = -1.0 / tau;
                values.iter_mut().enumerate().for_each(|(t, value)| *value += factor * (rate * t as f64).exp());
            }
            Course::Step(at) => values.iter_mut().skip(at).for_each(|value| *value += factor),
        }
    }
}

fn ramp(t: usize, samples: usize) -> f64 {
    (t as f64 + 0.5) / samples as f64 - 0.5
}

#[cfg(test)]
mod tests {
    use super::super::explanation::turning;
    use super::*;

    #[test]
    fn transforms_are_those_of_the_courses() {
        for n in [37usize, 500, 5001] {
            let mut transform = Cosines::new(n);
            let warm: Vec<f64> = (0..n).map(|t| 25.0 + (t as f64 * 0.01).sin()).collect();
            let courses = Courses::new(&mut transform, Some(&warm), 400.0);
            for course in [
                Course::Ramp,
                Course::Temperature,
                Course::WarmUp(11.3),
                Course::WarmUp(900.0),
                Course::Step(17),
                Course::Follows(Follow::Square),
                Course::Follows(Follow::Play(0.37)),
            ] {
                let mut values = vec![0.0; n];
                courses.add(course, 2.0, &mut values);
                transform.forward(&mut values);
                for (k, (found, expected)) in courses.coefficients(course).iter().zip(&values).enumerate().skip(1) {
                    assert!((2.0 * found - expected).abs() < 1e-9, "{course:?} n {n} k {k}: {found} {expected}");
                }
            }
            for cycles in [0.3 / n as f64, 3.37 / n as f64, 0.21] {
                let mut values = [vec![0.0; n], vec![0.0; n]];
                turning(cycles, n, |t, cosine, sine| (values[0][t], values[1][t]) = (cosine, sine));
                for (expected, found) in values.iter_mut().zip(courses.turning(cycles)) {
                    transform.forward(expected);
                    for (k, (found, expected)) in found.iter().zip(&*expected).enumerate().skip(1) {
                        assert!((found - expected).abs() < 1e-9, "{cycles} n {n} k {k}: {found} {expected}");
                    }
                }
            }
        }
    }
}
