//! Lines and wandering lines.

use super::{Act, Made, Making, object};
use crate::columns::Columns;
use crate::draw::Draw;
use crate::kind::Kind;
use serde_json::Value;
use std::f64::consts::TAU;

/// Part of the lines that are slow cycles, like those of room air; their minimum number of periods in the record, and
/// the frequency, in cycles per sample, that separates them from the others.
const SLOW: f64 = 0.25;
const PERIODS: f64 = 3.0;
const FAST: f64 = 0.004;

/// The frequency of a line over the record, in cycles per sample.
#[derive(Debug, Clone, Copy)]
enum Course {
    /// A constant frequency.
    Steady(f64),
    /// From one frequency to another.
    Swept(f64, f64),
    /// A middle, its deviation to either side, and the cycles per sample of the deviation.
    Modulated(f64, f64, f64),
}

/// The amplitudes of the harmonics per channel, from the fundamental on, U.
#[derive(Debug)]
struct Lines {
    course: Course,
    amplitudes: Vec<Vec<f64>>,
}

impl Course {
    /// Returns the turns until sample `i` of `samples`.
    fn turns(self, i: f64, samples: f64) -> f64 {
        match self {
            Self::Steady(cycles) => cycles * i,
            Self::Swept(from, to) => from * i + (to - from) * i * i / (2.0 * samples),
            Self::Modulated(middle, deviation, rate) => {
                middle * i + deviation / (TAU * rate) * (1.0 - (TAU * rate * i).cos())
            }
        }
    }
}

impl Act for Lines {
    fn act(&self, on: &mut Columns, at: &[usize], draw: &mut Draw) {
        let samples = on.len() as f64;
        for (amplitudes, column) in self.amplitudes.iter().zip(at) {
            let phases: Vec<f64> = amplitudes.iter().map(|_| draw.uniform(0.0, 1.0)).collect();
            for (i, value) in on.columns[*column].values.iter_mut().enumerate() {
                // Whole turns are subtracted first, because the sine of a large number loses digits.
                let turns = self.course.turns(i as f64, samples);
                for (harmonic, (amplitude, phase)) in (1..).zip(amplitudes.iter().zip(&phases)) {
                    *value += amplitude * (TAU * (f64::from(harmonic) * turns + phase).fract()).cos();
                }
            }
        }
    }
}

pub(super) fn draw(making: &mut Making<'_>) -> Made {
    let rate_hz = making.setting.rate_hz;
    let mut size = making.size();
    let outside = |making: &mut Making<'_>, from: f64, to: f64| {
        let size = making.device.log_uniform(from, to);
        let sizes: Vec<Vec<f64>> = making.at.iter().map(|at| vec![size * making.white(*at)]).collect();
        (size, sizes)
    };
    let (course, amplitudes, parameters): (Course, Vec<Vec<f64>>, Vec<Value>) = match making.kind {
        Kind::Comb => {
            let count = making.device.whole(2, 5);
            let fundamental = making.device.uniform(0.012, 0.492 / count as f64);
            let sizes = making.sizes_u();
            let mut harmonics: Vec<f64> = (0..count).map(|_| making.device.log_uniform(1.0, 2.5)).collect();
            let weakest = harmonics.iter().copied().fold(f64::INFINITY, f64::min);
            harmonics.iter_mut().for_each(|harmonic| *harmonic /= weakest);
            let of = |size: f64| harmonics.iter().map(|harmonic| size * harmonic).collect::<Vec<_>>();
            let amplitudes: Vec<Vec<f64>> = sizes.into_iter().map(of).collect();
            let entry = |amplitudes: &Vec<f64>| {
                object([("fundamental_hz", (fundamental * rate_hz).into()), ("amplitudes", amplitudes.clone().into())])
            };
            let parameters = amplitudes.iter().map(entry).collect();
            (Course::Steady(fundamental), amplitudes, parameters)
        }
        Kind::Chirp => {
            let (from, to) = (making.device.uniform(0.02, 0.45), making.device.uniform(0.02, 0.45));
            let (own, amplitudes) = outside(making, 0.1, 0.8);
            size = own;
            let entry = object([("from_hz", (from * rate_hz).into()), ("to_hz", (to * rate_hz).into())]);
            let parameters = vec![entry; amplitudes.len()];
            (Course::Swept(from, to), amplitudes, parameters)
        }
        Kind::FmLine => {
            let middle = making.device.uniform(0.06, 0.42);
            let deviation = making.device.log_uniform(0.005, 0.04);
            let rate = 1.0 / making.device.log_uniform(2_000.0, 20_000.0);
            let (own, amplitudes) = outside(making, 0.2, 0.8);
            size = own;
            let entry = object([
                ("frequency_hz", (middle * rate_hz).into()),
                ("deviation_hz", (deviation * rate_hz).into()),
                ("period_s", (1.0 / rate / rate_hz).into()),
            ]);
            let parameters = vec![entry; amplitudes.len()];
            (Course::Modulated(middle, deviation, rate), amplitudes, parameters)
        }
        // tone
        _ => {
            let cycles = if making.device.chance(SLOW) {
                making.device.log_uniform(PERIODS / making.samples(), FAST)
            } else {
                making.device.uniform(FAST, 0.492)
            };
            // Near 0, a line competes with flicker noise and a walk as well as white noise.
            let louder = |at: usize| {
                let (part, white) = (&making.setting.parts[at], making.white(at).max(f64::MIN_POSITIVE));
                let (b, k) = (part.true_nbk[1] / white, part.walk(rate_hz) / white);
                (1.0 + b * b / (TAU * cycles) + (k / (TAU * cycles)).powi(2)).sqrt()
            };
            let louder: Vec<f64> = making.at.iter().map(|at| louder(*at)).collect();
            let sizes = making.sizes_u().into_iter().zip(louder).map(|(size, louder)| size * louder);
            let amplitudes: Vec<Vec<f64>> = sizes.map(|size| vec![size]).collect();
            let entry = |amplitudes: &Vec<f64>| {
                object([("frequency_hz", (cycles * rate_hz).into()), ("amplitude", amplitudes[0].into())])
            };
            let parameters = amplitudes.iter().map(entry).collect();
            (Course::Steady(cycles), amplitudes, parameters)
        }
    };
    Made { size, parameters, act: Box::new(Lines { course, amplitudes }) }
}
