//! Kinds outside the library that act on each of their channels separately: a size, an entry for the key, and a
//! function of the column.
//!
//! Sizes are in units of the white part's standard deviation. They are drawn so that the effect is visible to a reader
//! who examines the record long enough; they have no limit.

mod carrier;
mod chain;
mod law;
mod wander;

use super::{Act, Made, Making, object};
use crate::columns::{Column, Columns};
use crate::draw::Draw;
use crate::kind::Kind;

/// A change of one column; it receives the true temperature at every sample, °C, empty if it is not known.
type Change = Box<dyn Fn(&mut Column, &[f64], &mut Draw) + Send + Sync>;

/// The same change on every column, with separate draws on each.
struct Each(Change);

impl std::fmt::Debug for Each {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("Each")
    }
}

impl Act for Each {
    fn act(&self, on: &mut Columns, at: &[usize], draw: &mut Draw) {
        for column in at {
            (self.0)(&mut on.columns[*column], &on.temperature_c, &mut draw.split());
        }
    }
}

/// Stamps of a clock whose rate wanders: amplitude in s, period in s.
#[derive(Debug)]
struct Clock(f64, f64);

impl Act for Clock {
    fn act(&self, on: &mut Columns, _at: &[usize], draw: &mut Draw) {
        let phase = draw.uniform(0.0, 1.0);
        let wave = |time_s: f64| self.0 * (std::f64::consts::TAU * (time_s / self.1 + phase)).sin();
        on.time_s.iter_mut().for_each(|stamp| *stamp += wave(*stamp));
    }
}

/// A drawn kind outside the library: its size, its name in a key, and the change.
struct Drawn {
    size: f64,
    name: &'static str,
    change: Change,
}

impl Drawn {
    fn new(
        size: f64,
        name: &'static str,
        change: impl Fn(&mut Column, &[f64], &mut Draw) + Send + Sync + 'static,
    ) -> Self {
        Self { size, name, change: Box::new(change) }
    }
}

pub(super) fn draw(making: &mut Making<'_>) -> Made {
    let count = making.at.len();
    if making.kind == Kind::WanderingClock {
        let (parts, period_s) = (making.device.log_uniform(1e-4, 1e-3), making.device.log_uniform(100.0, 1_000.0));
        let amplitude_s = parts * period_s / std::f64::consts::TAU;
        let entry = object([("rate_off", parts.into()), ("period_s", period_s.into())]);
        return Made { size: parts, parameters: vec![entry; count], act: Box::new(Clock(amplitude_s, period_s)) };
    }
    let samples = making.setting.samples;
    let drawn = wander::draw(making.kind, samples, &mut making.device)
        .or_else(|| carrier::draw(making.kind, samples, &mut making.device))
        .or_else(|| law::draw(making.kind, &mut making.device))
        .unwrap_or_else(|| chain::draw(making.kind, samples, &mut making.device));
    let entry = object([(drawn.name, drawn.size.into())]);
    Made { size: drawn.size, parameters: vec![entry; count], act: Box::new(Each(drawn.change)) }
}

/// Returns a random square wave that marks which of `samples` are on: on for `on` samples on average, then off for
/// `off`.
fn on_and_off(samples: usize, on: f64, off: f64, draw: &mut Draw) -> Vec<bool> {
    let mut is_on = draw.chance(on / (on + off));
    let mut made = Vec::with_capacity(samples);
    while made.len() < samples {
        let stays = draw.wait(1.0 / if is_on { on } else { off }).unwrap_or(samples);
        made.resize((made.len() + stays).min(samples), is_on);
        is_on = !is_on;
    }
    made
}

/// Returns the times, from 1 on, of events that are about `apart` samples apart.
fn events(samples: usize, apart: f64, draw: &mut Draw) -> Vec<usize> {
    draw.events((1.0 / apart).min(0.5), samples)
}
