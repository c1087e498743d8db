//! Effects on the white part alone: on its size over time or temperature, or its law.

use super::{Act, Made, Making, object, soft_window};
use crate::columns::Columns;
use crate::draw::Draw;
use crate::kind::Kind;
use crate::limit::LOUDEST;
use serde_json::{Value, json};
use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

/// Number of points of a stated profile.
const POINTS: usize = 49;
/// Part of an interval over which it begins, and over which it fades.
const SOFT: f64 = 0.01;
/// Part of the intervals that last to the end, and the earliest start of these as a part of the record.
const TO_THE_END: f64 = 0.25;
const LATE: [f64; 2] = [0.4, 0.9];

/// A factor on the white part.
#[derive(Debug, Clone, Copy)]
enum Gain {
    /// Start and end as parts of the record, and the log of the factor; an interval that ends with the record does not
    /// fade.
    Interval(f64, f64, f64),
    /// Half periods over the record, phase, half the log variance, triangular rather than sinusoidal.
    Wave(f64, f64, f64, bool),
    /// Slope per °C about a reference.
    Temperature(f64, f64),
    /// Cycles per sample, phase, depth.
    Periodic(f64, f64, f64),
    /// Student's t from a random factor: degrees of freedom.
    Student(f64),
    /// Amount of the square that is added.
    Skew(f64),
}

#[derive(Debug)]
struct Loudness(Vec<Gain>);

impl Act for Loudness {
    fn act(&self, on: &mut Columns, at: &[usize], draw: &mut Draw) {
        let samples = on.len() as f64;
        for (gain, column) in self.0.iter().zip(at) {
            let mut draw = draw.split();
            let column = &mut on.columns[*column];
            let scale = column.scale;
            for (i, (value, white)) in column.values.iter_mut().zip(&mut column.white).enumerate() {
                let new = match gain {
                    Gain::Temperature(per_c, reference) => {
                        let celsius = on.temperature_c.get(i).copied().unwrap_or(*reference);
                        *white * (per_c * (celsius - reference)).exp()
                    }
                    Gain::Periodic(cycles, phase, depth) => {
                        *white * (1.0 + depth * (TAU * (cycles * i as f64 + phase)).cos())
                    }
                    Gain::Student(degrees_of_freedom) => *white * draw.student_factor(*degrees_of_freedom),
                    Gain::Skew(part) => {
                        let unit = *white / scale;
                        scale * (unit + part * (unit * unit - 1.0)) / (1.0 + 2.0 * part * part).sqrt()
                    }
                    steady => *white * steady.factor(i as f64 / samples),
                };
                *value += new - *white;
                *white = new;
            }
        }
    }
}

impl Gain {
    /// Returns the factor at a part of the record, for factors that depend on the time alone.
    fn factor(self, part: f64) -> f64 {
        match self {
            Self::Interval(from, to, log) if (from..to).contains(&part) => {
                let at = (part - from) / (to - from);
                (log * soft_window(if to < 1.0 { at } else { at.min(0.5) }, SOFT)).exp()
            }
            Self::Wave(halves, phase, log, triangular) => {
                let turn = 0.5 * halves * part + phase;
                let wave =
                    if triangular { 4.0 * ((turn - turn.floor()) - 0.5).abs() - 1.0 } else { (PI * 2.0 * turn).sin() };
                (log * wave).exp()
            }
            _ => 1.0,
        }
    }
}

pub(super) fn draw(making: &mut Making<'_>) -> Made {
    let (rate_hz, length_s) = (making.setting.rate_hz, making.setting.length_s());
    let mut size = making.size();
    let (gain, entry): (Gain, Value) = match making.kind {
        Kind::HeavyTails => {
            let degrees_of_freedom = (1.0 / size).max(2.5);
            (Gain::Student(degrees_of_freedom), object([("degrees_of_freedom", degrees_of_freedom.into())]))
        }
        Kind::VarianceInterval => {
            let [from, to] = if making.device.chance(TO_THE_END) {
                [making.events.uniform(LATE[0], LATE[1]), 1.0]
            } else {
                let from = making.events.uniform(0.04, 0.64);
                [from, from + making.device.log_uniform(0.04, 0.32)]
            };
            let part = to - from;
            // The same log variance over the record as a wave of this size.
            let log_variance = size * FRAC_1_SQRT_2 / (part * (1.0 - part)).sqrt();
            let log = (0.5 * log_variance).min(LOUDEST.ln()) * making.device.sign();
            let entry = object([
                ("from_s", (from * length_s).into()),
                ("to_s", (to * length_s).into()),
                ("factor", log.exp().into()),
            ]);
            (Gain::Interval(from, to, log), entry)
        }
        Kind::VarianceProfile => {
            let (halves, phase) = (making.device.uniform(2.5, 6.5), making.events.uniform(0.0, 1.0));
            let triangular = making.device.chance(0.5);
            // A triangle of the same height has two thirds of a sine's mean square.
            let log = (0.5 * size * if triangular { 1.5_f64.sqrt() } else { 1.0 }).min(LOUDEST.ln());
            let gain = Gain::Wave(halves, phase, log, triangular);
            let point = |index: usize| {
                let part = index as f64 / (POINTS - 1) as f64;
                json!([part * length_s, gain.factor(part)])
            };
            (gain, object([("profile", (0..POINTS).map(point).collect())]))
        }
        Kind::PeriodicGain => {
            let cycles = making.device.log_uniform(0.001, 0.05);
            size = making.device.log_uniform(0.15, 0.8);
            let entry = object([("frequency_hz", (cycles * rate_hz).into()), ("depth", size.into())]);
            (Gain::Periodic(cycles, making.events.uniform(0.0, 1.0), size), entry)
        }
        Kind::SkewedNoise => {
            size = making.device.log_uniform(0.03, 0.2) * making.device.sign();
            (Gain::Skew(size), object([("square", size.into())]))
        }
        // variance_per_c
        _ => {
            let course = making.setting.temperature;
            let spread = course.map_or(1.0, |course| course.spread_c());
            let (start, rise) = course.map_or((25.0, 0.0), |course| (course.start_c, course.rise_c));
            let per_c = 0.5 * size / spread * making.device.sign();
            let reference = making.device.uniform(start, start + rise);
            let entry = object([("per_c", per_c.into()), ("reference_c", reference.into())]);
            (Gain::Temperature(per_c, reference), entry)
        }
    };
    let count = making.at.len();
    Made { size, parameters: vec![entry; count], act: Box::new(Loudness(vec![gain; count])) }
}
