//! Effects on samples on their way out: limits, steps, repeats, stamps.

use super::{Act, Made, Making, object};
use crate::class::Sense;
use crate::columns::Columns;
use crate::draw::Draw;
use crate::kind::Kind;
use serde_json::Value;

/// The jitter that counts as the limit, in periods: stamps taken by a program are seldom better.
const JITTER: f64 = 0.005;

/// Rounds to multiples: steps per channel, U; downwards like a truncating converter, or to the nearest.
#[derive(Debug)]
struct Steps(Vec<f64>, bool);

impl Act for Steps {
    fn act(&self, on: &mut Columns, at: &[usize], _draw: &mut Draw) {
        for (step, column) in self.0.iter().zip(at) {
            let values = on.columns[*column].values.iter_mut();
            values.for_each(|value| {
                *value = step * if self.1 { (*value / step).floor() } else { (*value / step).round() }
            });
        }
    }
}

/// Clips a share of the samples: above, below, or both.
#[derive(Debug)]
struct Clip(f64, bool, bool);

impl Act for Clip {
    fn act(&self, on: &mut Columns, at: &[usize], _draw: &mut Draw) {
        for column in at {
            let values = &mut on.columns[*column].values;
            let mut sorted = values.clone();
            let beyond = ((self.0 * sorted.len() as f64) as usize).clamp(3, sorted.len() / 2);
            if self.1 {
                let place = sorted.len() - beyond;
                let high = *sorted.select_nth_unstable_by(place, f64::total_cmp).1;
                values.iter_mut().for_each(|value| *value = value.min(high));
            }
            if self.2 {
                let low = *sorted.select_nth_unstable_by(beyond - 1, f64::total_cmp).1;
                values.iter_mut().for_each(|value| *value = value.max(low));
            }
        }
    }
}

/// Repeats the last sample of all its columns with this probability.
#[derive(Debug)]
struct Hold(f64);

impl Act for Hold {
    fn act(&self, on: &mut Columns, at: &[usize], draw: &mut Draw) {
        for i in draw.events(self.0, on.len()) {
            for column in at {
                let values = &mut on.columns[*column].values;
                values[i] = values[i - 1];
            }
        }
    }
}

/// Jitter of the stamps, s, and the probability that a sample is lost.
#[derive(Debug)]
struct Stamps(f64, f64);

impl Act for Stamps {
    fn act(&self, on: &mut Columns, _at: &[usize], draw: &mut Draw) {
        let mut jitter = draw.split();
        let samples = on.len();
        let (first, rate_hz) = (on.time_s.first().copied().unwrap_or(0.0), on.rate_hz);
        // A stamp never lies before the previous one.
        let bound = 0.45 / rate_hz;
        if on.time_s.len() != samples {
            on.time_s = (0..samples).map(|i| first + i as f64 / rate_hz).collect();
        }
        on.time_s.iter_mut().for_each(|stamp| *stamp += (self.0 * jitter.normal()).clamp(-bound, bound));
        if self.1 == 0.0 {
            return;
        }
        // The first and the last sample are present: samples lost outside them are not known to be missing.
        let places = draw.events(self.1, samples - 1);
        on.lose(places);
    }
}

/// A band about the middle in which a channel does not move: half the band's width per channel, U.
#[derive(Debug)]
struct DeadBand(Vec<f64>);

impl Act for DeadBand {
    fn act(&self, on: &mut Columns, at: &[usize], _draw: &mut Draw) {
        for (half, column) in self.0.iter().zip(at) {
            let values = &mut on.columns[*column].values;
            let middle = values.iter().sum::<f64>() / values.len() as f64;
            for value in values {
                let off = *value - middle;
                *value = middle + off.signum() * (off.abs() - half).max(0.0);
            }
        }
    }
}

pub(super) fn draw(making: &mut Making<'_>) -> Made {
    let rate_hz = making.setting.rate_hz;
    let (size, count) = (making.size(), making.at.len());
    match making.kind {
        Kind::Resolution => {
            let steps = making.sizes_u();
            // A model rounds to the nearest.
            let down = making.device.chance(0.5) && making.role.sense != Sense::Known;
            let parameters = steps.iter().map(|step| object([("step", (*step).into())])).collect();
            Made { size, parameters, act: Box::new(Steps(steps, down)) }
        }
        Kind::Saturation => {
            let (above, below) = if making.device.chance(0.3) {
                (true, true)
            } else if making.device.chance(0.5) {
                (true, false)
            } else {
                (false, true)
            };
            let share = size;
            // The limits follow from the samples: a share of them lies beyond.
            let entry = object([("share", share.into()), ("above", above.into()), ("below", below.into())]);
            Made { size, parameters: vec![entry; count], act: Box::new(Clip(share, above, below)) }
        }
        Kind::HeldSamples => {
            let probability = size;
            let entry = object([("probability", probability.into())]);
            Made { size, parameters: vec![entry; count], act: Box::new(Hold(probability)) }
        }
        Kind::Timing => {
            let jitter_s = making.over * JITTER / rate_hz;
            let lost = if making.device.chance(0.6) { size.min(0.2) } else { 0.0 };
            let entry = object([("jitter_s", jitter_s.into()), ("drop_probability", lost.into())]);
            Made { size, parameters: vec![entry; count], act: Box::new(Stamps(jitter_s, lost)) }
        }
        // dead_band
        _ => {
            let size = making.device.log_uniform(0.15, 0.8);
            let halves: Vec<f64> = making.at.iter().map(|at| size * making.white(*at)).collect();
            let parameters: Vec<Value> = halves.iter().map(|half| object([("width", (2.0 * half).into())])).collect();
            Made { size, parameters, act: Box::new(DeadBand(halves)) }
        }
    }
}
