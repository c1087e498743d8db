//! Lines and bands that vary over time.

use super::{Drawn, events, on_and_off};
use crate::draw::Draw;
use crate::kind::Kind;
use std::f64::consts::TAU;

/// Returns a line whose frequency (cycles per sample) and amplitude (σ) are given sample by sample, starting from a
/// random phase.
fn line(draw: &mut Draw, mut at: impl FnMut(usize, &mut Draw) -> (f64, f64)) -> impl FnMut(usize) -> f64 {
    let mut turns = draw.uniform(0.0, 1.0);
    let mut draw = draw.split();
    move |i| {
        let (cycles, amplitude) = at(i, &mut draw);
        turns = (turns + cycles).fract();
        amplitude * (TAU * turns).cos()
    }
}

pub(super) fn draw(kind: Kind, samples: usize, device: &mut Draw) -> Option<Drawn> {
    let cycles = device.uniform(0.03, 0.45);
    Some(match kind {
        // A line that hops from frequency to frequency.
        Kind::FrequencyHops => {
            let (size, stays) = (device.log_uniform(0.2, 1.0), device.log_uniform(500.0, 5_000.0));
            Drawn::new(size, "amplitude", move |column, _, draw| {
                let (mut now, mut next) = (cycles, 0);
                column.add(line(draw, |i, draw| {
                    if i >= next {
                        now = draw.uniform(0.03, 0.45);
                        next = i + draw.wait(1.0 / stays).unwrap_or(usize::MAX - i);
                    }
                    (now, size)
                }));
            })
        }
        // A line whose phase walks.
        Kind::PhaseWalk => {
            let (size, step) = (device.log_uniform(0.3, 1.5), device.log_uniform(1e-3, 1e-2));
            Drawn::new(size, "amplitude", move |column, _, draw| {
                column.add(line(draw, |_, draw| (cycles + step * draw.normal(), size)));
            })
        }
        // A line that is switched on and off.
        Kind::ToneOnOff => {
            let (size, stays) = (device.log_uniform(0.2, 1.0), samples as f64 / device.uniform(6.0, 20.0));
            Drawn::new(size, "amplitude", move |column, _, draw| {
                let on = on_and_off(column.values.len(), stays, stays, draw);
                column.add(line(draw, |i, _| (cycles, if on[i] { size } else { 0.0 })));
            })
        }
        // A line whose amplitude follows the temperature.
        Kind::ToneByTemperature => {
            let size = device.log_uniform(0.3, 1.2);
            Drawn::new(size, "largest_amplitude", move |column, celsius, draw| {
                let (low, high) =
                    celsius.iter().fold((f64::MAX, f64::MIN), |(low, high), c| (low.min(*c), high.max(*c)));
                column.add(line(draw, |i, _| (cycles, size * (celsius[i] - low) / (high - low).max(1e-9))));
            })
        }
        // A line that decays.
        Kind::DyingLine => {
            let (size, tau) = (device.log_uniform(0.4, 2.0), samples as f64 / device.uniform(5.0, 12.0));
            Drawn::new(size, "first_amplitude", move |column, _, draw| {
                column.add(line(draw, |i, _| (cycles, size * (-(i as f64) / tau).exp())));
            })
        }
        // A line that is struck repeatedly and rings each time.
        Kind::RingDowns => {
            let (size, tau) = (device.log_uniform(1.0, 6.0), device.log_uniform(20.0, 200.0));
            let apart = device.log_uniform(20.0, 100.0) * tau;
            Drawn::new(size, "first_amplitude", move |column, _, draw| {
                let strokes = events(column.values.len(), apart, draw);
                let (mut next, mut now, pole) = (strokes.into_iter().peekable(), 0.0, (-1.0 / tau).exp());
                column.add(line(draw, move |i, _| {
                    now = if next.next_if_eq(&i).is_some() { size } else { now * pole };
                    (cycles, now)
                }));
            })
        }
        // A resonance whose middle wanders over a tenth of the band.
        Kind::MovingResonance => {
            let (size, radius) = (device.log_uniform(0.4, 1.5), 1.0 - device.log_uniform(0.003, 0.02));
            let (middle, turns) = (device.uniform(0.1, 0.38), device.uniform(1.5, 6.0));
            Drawn::new(size, "sigma", move |column, _, draw| {
                let (count, phase) = (column.values.len() as f64, draw.uniform(0.0, TAU));
                // About the variance of an AR(2) process with poles of this radius away from the ends of the band.
                let fresh = size * (1.0 - radius * radius).sqrt();
                let (mut one, mut two) = (0.0, 0.0);
                column.add(|i| {
                    let at = middle + 0.05 * (TAU * turns * i as f64 / count + phase).sin();
                    let now = 2.0 * radius * (TAU * at).cos() * one - radius * radius * two
                        + fresh * (TAU * at).sin() * std::f64::consts::SQRT_2 * draw.normal();
                    (two, one) = (one, now);
                    now
                });
            })
        }
        _ => return None,
    })
}
