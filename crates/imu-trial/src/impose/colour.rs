//! Additive noise with a separate spectrum or law.

use super::{Act, Made, Making, object};
use crate::columns::Columns;
use crate::draw::Draw;
use crate::ground::coloured;
use crate::kind::Kind;
use serde_json::Value;
use std::f64::consts::{PI, TAU};

/// The shortest time constant of a Gauss–Markov process, s, but at least a sample.
const SHORTEST_S: f64 = 0.05;
/// The longest time constant, in samples and as a part of the record: a longer one is a random walk.
const LONGEST: f64 = 4_000.0;
const LONGEST_PART: f64 = 1.0 / 60.0;

/// One channel's noise, U.
#[derive(Debug, Clone, Copy)]
enum Noise {
    /// Differences of white angle noise of this standard deviation.
    Angle(f64),
    /// Standard deviation, time constant in samples.
    Markov(f64, f64),
    /// Standard deviation, radius and angle (in cycles per sample) of the two poles.
    Autoregressive(f64, f64, f64),
    /// White density times (corner/f)^exponent: the density at the corner, the corner (cycles per sample), the
    /// exponent.
    Power(f64, f64, f64),
    /// Two levels at this distance, with this probability of a change per sample.
    Telegraph(f64, f64),
    /// Decaying shots: size, probability per sample, time constant in samples.
    Shots(f64, f64, f64),
}

#[derive(Debug)]
struct Colour(Vec<Noise>);

impl Act for Colour {
    fn act(&self, on: &mut Columns, at: &[usize], draw: &mut Draw) {
        for (noise, column) in self.0.iter().zip(at) {
            noise.add(&mut on.columns[*column].values, &mut draw.split());
        }
    }
}

impl Noise {
    fn add(self, values: &mut [f64], draw: &mut Draw) {
        match self {
            Self::Angle(size) => {
                let mut before = draw.normal();
                for value in values {
                    let now = draw.normal();
                    *value += size * (now - before);
                    before = now;
                }
            }
            Self::Markov(size, tau) => {
                let pole = (-1.0 / tau).exp();
                let fresh = (1.0 - pole * pole).sqrt();
                let mut state = draw.normal();
                for value in values {
                    *value += size * state;
                    state = pole * state + fresh * draw.normal();
                }
            }
            Self::Autoregressive(size, radius, cycles) => {
                let (first, second) = (2.0 * radius * (TAU * cycles).cos(), radius * radius);
                // Variance of an AR(2) process with innovations of variance 1 (Box and Jenkins, 3.2.28).
                let variance = (1.0 + second) / ((1.0 - second) * ((1.0 + second).powi(2) - first * first));
                let scale = size / variance.sqrt();
                let (mut one, mut two) = (0.0, 0.0);
                let mut next = |draw: &mut Draw| {
                    let now = first * one - second * two + draw.normal();
                    (two, one) = (one, now);
                    now
                };
                // The process has forgotten its start after many time constants.
                for _ in 0..(12.0 / (1.0 - radius)) as usize {
                    next(draw);
                }
                values.iter_mut().for_each(|value| *value += scale * next(draw));
            }
            Self::Power(density, corner, exponent) => {
                let made = coloured(values.len(), draw, |cycles| density * (corner / cycles).powf(exponent));
                values.iter_mut().zip(made).for_each(|(value, noise)| *value += noise);
            }
            Self::Telegraph(apart, changes) => {
                let mut level = 0.5 * apart * draw.sign();
                let mut next = draw.wait(changes).unwrap_or(usize::MAX);
                for (i, value) in values.iter_mut().enumerate() {
                    if i >= next {
                        level = -level;
                        next = i + draw.wait(changes).unwrap_or(usize::MAX - i);
                    }
                    *value += level;
                }
            }
            Self::Shots(size, probability, tau) => {
                let pole = (-1.0 / tau).exp();
                let mut state = 0.0;
                let mut next = draw.wait(probability).unwrap_or(usize::MAX);
                for (i, value) in values.iter_mut().enumerate() {
                    if i >= next {
                        state += size * draw.uniform(0.5, 1.5);
                        next = i + draw.wait(probability).unwrap_or(usize::MAX - i);
                    }
                    *value += state;
                    state *= pole;
                }
            }
        }
    }
}

pub(super) fn draw(making: &mut Making<'_>) -> Made {
    let rate_hz = making.setting.rate_hz;
    let mut size = making.size();
    let whites: Vec<f64> = making.at.iter().map(|at| making.white(*at)).collect();
    let made: Vec<(Noise, Value)> = match making.kind {
        Kind::QuantizationNoise => {
            let one = |size: f64| (Noise::Angle(size), object([("Q", (size / rate_hz).into())]));
            making.sizes_u().into_iter().map(one).collect()
        }
        Kind::GaussMarkov => {
            let longest = LONGEST.min(LONGEST_PART * making.samples());
            let tau = making.device.log_uniform((SHORTEST_S * rate_hz).max(1.0), longest);
            let one = |size: f64| {
                (Noise::Markov(size, tau), object([("sigma", size.into()), ("tc_s", (tau / rate_hz).into())]))
            };
            making.sizes_u().into_iter().map(one).collect()
        }
        Kind::Resonance => {
            let cycles = making.device.uniform(0.03, 0.45);
            let radius = 1.0 - making.device.log_uniform(0.0003, 0.05);
            let one = |size: f64| {
                let entry = object([
                    ("frequency_hz", (cycles * rate_hz).into()),
                    // Half power is at √2 of the smallest distance to the pole: (1 − r)/π cycles per sample in total.
                    ("bandwidth_hz", ((1.0 - radius) / PI * rate_hz).into()),
                    ("sigma", size.into()),
                ]);
                (Noise::Autoregressive(size, radius, cycles), entry)
            };
            making.sizes_u().into_iter().map(one).collect()
        }
        Kind::OddSlope => {
            let steep = making.device.chance(0.5);
            let exponent = if steep { 1.5 } else { 0.5 };
            let corner =
                if steep { making.device.log_uniform(0.05, 0.2) } else { making.device.log_uniform(0.01, 0.1) };
            size = corner;
            let entry = object([("exponent", (-exponent).into()), ("corner_hz", (corner * rate_hz).into())]);
            whites.iter().map(|white| (Noise::Power(white * white, corner, exponent), entry.clone())).collect()
        }
        Kind::RandomTelegraph => {
            let stays = making.device.log_uniform(300.0, 3_000.0);
            size = making.device.log_uniform(0.3, 1.5);
            let one = |white: &f64| {
                let entry = object([("apart", (size * white).into()), ("stays_s", (stays / rate_hz).into())]);
                (Noise::Telegraph(size * white, 1.0 / stays), entry)
            };
            whites.iter().map(one).collect()
        }
        // shot_noise
        _ => {
            let tau = making.device.log_uniform(50.0, 500.0);
            let apart = tau * making.device.log_uniform(5.0, 50.0);
            size = making.device.log_uniform(0.6, 3.0) * making.device.sign();
            let one = |white: &f64| {
                let entry = object([
                    ("size", (size * white).into()),
                    ("per_s", (rate_hz / apart).into()),
                    ("tau_s", (tau / rate_hz).into()),
                ]);
                (Noise::Shots(size * white, 1.0 / apart, tau), entry)
            };
            whites.iter().map(one).collect()
        }
    };
    let (noises, parameters) = made.into_iter().unzip();
    Made { size, parameters, act: Box::new(Colour(noises)) }
}
