//! Events: single samples far off, bursts of noise and of vibration.

use super::{Act, Made, Making, object, soft_window};
use crate::columns::Columns;
use crate::draw::Draw;
use crate::kind::Kind;
use crate::limit::{ABOVE, LEAST, LOUDEST, burst_limit};
use serde_json::Value;
use std::f64::consts::TAU;

/// Typical sizes of spikes in σ, and the part of the cases with a single spike.
const TYPICAL: [f64; 2] = [6.0, 2_000.0];
const ALONE: f64 = 0.15;
/// The size from which on a single spike counts, σ; the smallest is 0.6 of that.
const FAR: f64 = 15.0;
/// The longest bursts, s; the part of the cases whose last burst lasts to the end.
const LONG_S: [f64; 2] = [1.0, 60.0];
const TO_THE_END: f64 = 0.15;
/// Part of a burst's length over which it rises, and over which it falls.
const SOFT: f64 = 0.12;

/// Spikes: probability per sample, and per channel a typical size, U.
#[derive(Debug)]
struct Spikes(f64, Vec<f64>);

impl Act for Spikes {
    fn act(&self, on: &mut Columns, at: &[usize], draw: &mut Draw) {
        for (size, column) in self.1.iter().zip(at) {
            let values = &mut on.columns[*column].values;
            for i in draw.events(self.0, values.len()) {
                values[i] += draw.sign() * size * draw.uniform(0.6, 1.4);
            }
        }
    }
}

/// Bursts of white noise: start and length in samples, and the standard deviation per channel, U.
#[derive(Debug)]
struct Bursts(Vec<(usize, usize)>, Vec<f64>);

impl Act for Bursts {
    fn act(&self, on: &mut Columns, at: &[usize], draw: &mut Draw) {
        for (size, column) in self.1.iter().zip(at) {
            let mut draw = draw.split();
            let samples = on.columns[*column].values.len();
            for (begin, length) in &self.0 {
                let values = on.columns[*column].values.iter_mut().skip(*begin).take(*length);
                for (i, value) in values.enumerate() {
                    let at = (i as f64 + 0.5) / *length as f64;
                    *value += size
                        * soft_window(if begin + length < samples { at } else { at.min(0.5) }, SOFT)
                        * draw.normal();
                }
            }
        }
    }
}

/// Bursts of vibration: start and length in samples, first and last frequency in cycles per sample, and amplitudes per
/// channel, U.
#[derive(Debug)]
struct Vibration(Vec<(usize, usize, f64, f64)>, Vec<f64>);

impl Act for Vibration {
    fn act(&self, on: &mut Columns, at: &[usize], draw: &mut Draw) {
        for (size, column) in self.1.iter().zip(at) {
            for (begin, length, from, to) in &self.0 {
                let phase = draw.uniform(0.0, 1.0);
                let values = on.columns[*column].values.iter_mut().skip(*begin).take(*length);
                for (i, value) in values.enumerate() {
                    let i = i as f64;
                    let turns = phase + from * i + (to - from) * i * i / (2.0 * *length as f64);
                    *value += size * soft_window((i + 0.5) / *length as f64, 0.5) * (TAU * turns).cos();
                }
            }
        }
    }
}

/// Returns `count` stretches without overlap, each with a length between two numbers of samples, in order.
fn stretches(draw: &mut Draw, samples: usize, count: usize, [short, long]: [f64; 2]) -> Vec<(usize, usize)> {
    let mut found: Vec<(usize, usize)> = Vec::new();
    // A record may be too full for the last ones.
    for _ in 0..50 * count {
        let length = draw.log_uniform(short, long) as usize;
        let begin = draw.whole(0, samples.saturating_sub(length + 1));
        let free = |(other, its): &(usize, usize)| begin + length + 2 < *other || other + its + 2 < begin;
        if found.iter().all(free) {
            found.push((begin, length));
        }
        if found.len() == count {
            break;
        }
    }
    found.sort_unstable();
    found
}

pub(super) fn draw(making: &mut Making<'_>) -> Made {
    let (rate_hz, samples) = (making.setting.rate_hz, making.setting.samples);
    let whites: Vec<f64> = making.at.iter().map(|at| making.white(*at)).collect();
    let times = |intervals: &[(usize, usize)]| -> Value {
        let interval =
            |(begin, length): &(usize, usize)| vec![*begin as f64 / rate_hz, (begin + length) as f64 / rate_hz];
        intervals.iter().map(interval).map(Value::from).collect()
    };
    match making.kind {
        Kind::Spikes => {
            // A single spike is as certain as many if it is far out.
            let alone = making.device.chance(ALONE) && making.role.sense.is_in_sensor();
            let size = if alone { 1.0 / making.samples() } else { making.size() };
            let probability = size;
            let typical = making.device.log_uniform(TYPICAL[0], TYPICAL[1]);
            if alone {
                // Among the noise of hundreds of thousands of samples, one spike of a few standard deviations is not
                // visible.
                making.over = if typical > FAR { ABOVE } else { LEAST };
            }
            let sizes: Vec<f64> = whites.iter().map(|white| typical * white).collect();
            let entry =
                |size: &f64| object([("rate_hz", (probability * rate_hz).into()), ("amplitude", (*size).into())]);
            Made { size, parameters: sizes.iter().map(entry).collect(), act: Box::new(Spikes(probability, sizes)) }
        }
        Kind::Bursts => {
            let longest =
                making.device.log_uniform(LONG_S[0], LONG_S[1]).min(0.02 * making.setting.length_s().max(50.0));
            let count = making.events.whole(1, 12);
            let lengths = [0.5 * rate_hz, longest * rate_hz];
            let mut intervals = stretches(&mut making.events, samples, count, lengths);
            if let Some((begin, length)) = intervals.last_mut().filter(|_| making.events.chance(TO_THE_END)) {
                // In the second half, because a burst through the whole record would be N.
                *begin = (*begin + samples) / 2;
                *length = samples - *begin;
            }
            let shortest = intervals.iter().map(|(_, length)| *length).min().unwrap_or(1);
            let size = (making.over * burst_limit((1.0 - SOFT) * shortest as f64)).min(LOUDEST);
            let sizes: Vec<f64> = whites.iter().map(|white| size * white * making.device.uniform(1.0, 1.25)).collect();
            let times = times(&intervals);
            let entry = |size: &f64| object([("intervals", times.clone()), ("sigma", (*size).into())]);
            Made { size, parameters: sizes.iter().map(entry).collect(), act: Box::new(Bursts(intervals, sizes)) }
        }
        // vibration_bursts
        _ => {
            let size = making.device.log_uniform(0.4, 2.0);
            let count = making.events.whole(4, 30);
            let intervals = stretches(&mut making.events, samples, count, [100.0, 1_500.0]);
            let entry = object([("intervals", times(&intervals)), ("size", size.into())]);
            let mut course =
                |(begin, length)| (begin, length, making.events.uniform(0.05, 0.45), making.events.uniform(0.05, 0.45));
            let courses = intervals.into_iter().map(&mut course).collect();
            let sizes: Vec<f64> = whites.iter().map(|white| size * white).collect();
            Made { size, parameters: vec![entry; sizes.len()], act: Box::new(Vibration(courses, sizes)) }
        }
    }
}
