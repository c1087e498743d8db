//! Effects that shift the level.

use super::{Act, Made, Making, object};
use crate::columns::Columns;
use crate::draw::Draw;
use crate::kind::Kind;
use serde_json::Value;

/// Range of the number of samples in which a step rises.
const RISE: [f64; 2] = [1.0, 20.0];
/// A warm-up's time constant as parts of the record, and how much slower the temperature follows.
const TAU: [f64; 2] = [0.015, 0.15];
const LAG: [f64; 2] = [1.3, 3.0];
/// Steps on a channel: a few in most cases, many in the others.
const FEW: usize = 3;
const MANY: usize = 20;
/// Part of the cases with a step like that of an axis that is turned over, and its size in σ.
const TURNED: f64 = 0.15;
const TURN: [f64; 2] = [80.0, 2_000.0];

/// One channel's course, U.
#[derive(Debug, Clone)]
enum Course {
    /// Slope per sample.
    Ramp(f64),
    /// Slope per °C about a reference.
    Temperature(f64, f64),
    /// Amplitude and time constant in samples.
    WarmUp(f64, f64),
    /// Start in samples, size, and samples of the rise.
    Steps(Vec<(f64, f64, f64)>),
    /// Slope per °C, and half the width of the play in °C: the level follows the temperature only once it has passed
    /// through the play.
    Hysteresis(f64, f64),
}

#[derive(Debug)]
struct Level(Vec<Course>);

impl Act for Level {
    fn act(&self, on: &mut Columns, at: &[usize], _draw: &mut Draw) {
        for (course, column) in self.0.iter().zip(at) {
            let values = &mut on.columns[*column].values;
            match course {
                Course::Ramp(slope) => values.iter_mut().enumerate().for_each(|(i, value)| *value += slope * i as f64),
                Course::Temperature(per_c, reference) => {
                    let shifts = on.temperature_c.iter().map(|celsius| per_c * (celsius - reference));
                    values.iter_mut().zip(shifts).for_each(|(value, shift)| *value += shift);
                }
                Course::WarmUp(size, tau) => {
                    values.iter_mut().enumerate().for_each(|(i, value)| *value += size * (-(i as f64) / tau).exp());
                }
                Course::Steps(steps) => {
                    for (begin, size, rise) in steps {
                        for (i, value) in values.iter_mut().enumerate().skip(begin.max(0.0) as usize) {
                            let done = ((i as f64 - begin) / rise).clamp(0.0, 1.0);
                            *value += size * 0.5 * (1.0 - (std::f64::consts::PI * done).cos());
                        }
                    }
                }
                Course::Hysteresis(per_c, half) => {
                    let Some(first) = on.temperature_c.first() else { continue };
                    let mut follows = *first;
                    for (value, celsius) in values.iter_mut().zip(&on.temperature_c) {
                        follows = follows.clamp(celsius - half, celsius + half);
                        *value += per_c * (follows - first);
                    }
                }
            }
        }
    }
}

pub(super) fn draw(making: &mut Making<'_>) -> Made {
    let (rate_hz, samples) = (making.setting.rate_hz, making.samples());
    let size = making.size();
    let made = |courses: Vec<(Course, Value)>| {
        let (courses, parameters) = courses.into_iter().unzip();
        Made { size, parameters, act: Box::new(Level(courses)) }
    };
    match making.kind {
        Kind::RateRamp => made(
            making
                .signed_sizes_u()
                .into_iter()
                .map(|over_all| {
                    (Course::Ramp(over_all / samples), object([("R", (over_all / samples * rate_hz).into())]))
                })
                .collect(),
        ),
        Kind::WarmUp => {
            let (tau, lag) = (making.device.uniform(TAU[0], TAU[1]), making.device.uniform(LAG[0], LAG[1]));
            // Both warm up after the same switching on: first the inside of the sensor, then the place of the
            // thermometer.
            let settles = making.setting.temperature.map(|course| (course.settles / lag).clamp(TAU[0], TAU[1]));
            let tau = settles.unwrap_or(tau) * samples;
            let entry = |size: f64| object([("amplitude", size.into()), ("tau_s", (tau / rate_hz).into())]);
            made(making.signed_sizes_u().into_iter().map(|size| (Course::WarmUp(size, tau), entry(size))).collect())
        }
        Kind::BiasStep => {
            if making.device.chance(TURNED) {
                let turn = making.device.log_uniform(TURN[0], TURN[1]);
                making.over = turn / crate::limit::limit(making.kind, making.setting.samples);
            }
            let count = if making.device.chance(0.7) {
                making.events.whole(1, FEW)
            } else {
                making.events.whole(FEW + 1, MANY)
            };
            let mut times: Vec<f64> = (0..count).map(|_| making.events.uniform(0.04, 0.96) * samples).collect();
            times.sort_by(f64::total_cmp);
            let sizes = making.sizes_u();
            let mut steps = |size: f64| {
                let step = |begin: &f64| {
                    let size = size * making.events.sign() * making.events.uniform(1.0, 1.3);
                    (*begin, size, making.events.uniform(RISE[0], RISE[1]))
                };
                let steps: Vec<_> = times.iter().map(step).collect();
                let entry = |(begin, size, rise): &(f64, f64, f64)| {
                    object([("at_s", ((begin + 0.5 * rise) / rate_hz).into()), ("size", (*size).into())])
                };
                let entries: Value = steps.iter().map(entry).collect();
                (Course::Steps(steps), entries)
            };
            let courses = sizes.into_iter().map(&mut steps).collect();
            Made { size: making.size(), ..made(courses) }
        }
        Kind::Hysteresis => {
            let wander = making.setting.temperature.map_or(1.0, |course| course.wander_c);
            let half = wander * making.device.uniform(0.4, 1.2);
            let slow = (samples / 65_536.0).max(1.0).sqrt();
            let size = making.device.log_uniform(1.0, 5.0) * slow;
            let sizes: Vec<f64> = making.at.iter().map(|at| making.setting.parts[*at].white(rate_hz) * size).collect();
            let sizes: Vec<f64> = sizes.into_iter().map(|size| size * making.device.sign()).collect();
            let entry = |size: f64| object([("per_c", size.into()), ("play_c", (2.0 * half).into())]);
            made(sizes.into_iter().map(|size| (Course::Hysteresis(size, half), entry(size))).collect())
        }
        // temperature_bias
        _ => {
            let course = making.setting.temperature.map_or((25.0, 0.0), |course| (course.start_c, course.rise_c));
            let reference = making.device.uniform(course.0, course.0 + course.1);
            let entry = |size: f64| object([("per_c", size.into()), ("reference_c", reference.into())]);
            let shift = |size: f64| (Course::Temperature(size, reference), entry(size));
            made(making.signed_sizes_u().into_iter().map(shift).collect())
        }
    }
}
