//! Levels that wander in ways that no effect of the library describes.

use super::{Drawn, events, on_and_off};
use crate::draw::Draw;
use crate::kind::Kind;
use std::f64::consts::{PI, TAU};

pub(super) fn draw(kind: Kind, samples: usize, device: &mut Draw) -> Option<Drawn> {
    // Slow courses compete with a walk, which grows with the record.
    let slow = (samples as f64 / 65_536.0).max(1.0).sqrt();
    Some(match kind {
        // The level follows the rate of change of the temperature.
        Kind::ThermalRate => {
            let size = slow * device.log_uniform(2.0, 15.0);
            Drawn::new(size, "sigma_at_the_fastest", move |column, celsius, _| {
                let over = (celsius.len() / 200).max(1);
                let rate = |i: usize| celsius[(i + over).min(celsius.len() - 1)] - celsius[i.saturating_sub(over)];
                let most = (0..celsius.len()).map(|i| rate(i).abs()).fold(f64::MIN_POSITIVE, f64::max);
                column.add(|i| size * rate(i) / most);
            })
        }
        // A fringe: the level is a sine of the temperature.
        Kind::ThermalFringe => {
            let (size, period_c) = (slow * device.log_uniform(1.0, 6.0), device.uniform(1.0, 3.0));
            Drawn::new(size, "amplitude", move |column, celsius, draw| {
                let phase = draw.uniform(0.0, TAU);
                column.add(|i| size * (TAU * celsius[i] / period_c + phase).sin());
            })
        }
        // A parabola of the temperature about the middle of its range.
        Kind::TemperatureParabola => {
            let size = slow * device.log_uniform(0.3, 2.0) * device.sign();
            Drawn::new(size, "per_c2", move |column, celsius, _| {
                let (low, high) =
                    celsius.iter().fold((f64::MAX, f64::MIN), |(low, high), c| (low.min(*c), high.max(*c)));
                column.add(|i| size * (celsius[i] - 0.5 * (low + high)).powi(2));
            })
        }
        // The level changes at random between three values.
        Kind::ThreeLevels => {
            let (size, stays) = (device.log_uniform(0.4, 2.0), device.log_uniform(300.0, 3_000.0));
            Drawn::new(size, "apart", move |column, _, draw| {
                let (mut level, mut next) = (0.0, 0);
                column.add(|i| {
                    if i >= next {
                        level = size * (draw.whole(0, 2) as f64 - 1.0);
                        next = i + draw.wait(1.0 / stays).unwrap_or(usize::MAX - i);
                    }
                    level
                });
            })
        }
        // Jumps after which the level returns.
        Kind::RelaxingJumps => {
            let (size, tau) = (device.log_uniform(2.0, 10.0), device.log_uniform(200.0, 2_000.0));
            let apart = samples as f64 / device.uniform(5.0, 20.0);
            Drawn::new(size, "size", move |column, _, draw| {
                let jumps = events(column.values.len(), apart, draw);
                let (mut state, mut next, pole) = (0.0, jumps.iter().peekable(), (-1.0 / tau).exp());
                column.add(|i| {
                    state *= pole;
                    if next.next_if(|jump| **jump == i).is_some() {
                        state += size * draw.sign();
                    }
                    state
                });
            })
        }
        // The level drifts and is set to zero at random times.
        Kind::AutoZero => {
            let (size, apart) = (device.log_uniform(1.0, 5.0), device.log_uniform(300.0, 4_000.0));
            Drawn::new(size, "drift_between_resets", move |column, _, draw| {
                let resets = events(column.values.len(), apart, draw);
                let (mut since, mut next) = (0, resets.iter().peekable());
                column.add(|i| {
                    if next.next_if(|reset| **reset == i).is_some() {
                        since = i;
                    }
                    size * (i - since) as f64 / apart
                });
            })
        }
        // The level is pushed all the time, sometimes very hard (Cauchy's law), and returns.
        Kind::CauchyPushes => {
            let (size, tau) = (device.log_uniform(0.01, 0.06), device.log_uniform(50.0, 600.0));
            let apart = device.log_uniform(3.0, 20.0);
            Drawn::new(size, "scale", move |column, _, draw| {
                let (mut state, pole) = (0.0, (-1.0 / tau).exp());
                column.add(|_| {
                    state *= pole;
                    if draw.chance(1.0 / apart) {
                        state += size * (PI * draw.uniform(-0.5, 0.5)).tan();
                    }
                    state
                });
            })
        }
        // Half-sine pulses that come nearly periodically.
        Kind::JitteredPulses => {
            let (size, apart) = (device.log_uniform(0.6, 3.0), device.log_uniform(100.0, 1_500.0));
            Drawn::new(size, "height", move |column, _, draw| {
                let width = 0.15 * apart;
                let mut begin = draw.uniform(0.0, apart);
                column.add(|i| {
                    let at = (i as f64 - begin) / width;
                    if at > 1.0 {
                        begin += (apart * (1.0 + 0.15 * draw.normal())).max(1.2 * width);
                    }
                    if (0.0..1.0).contains(&at) { size * (PI * at).sin() } else { 0.0 }
                });
            })
        }
        // In runs of samples one more bit is set: a level of one sign, from time to time.
        Kind::FlippedRuns => {
            let (size, runs) = (device.log_uniform(2.0, 12.0), device.uniform(2.0, 12.0));
            let apart = device.log_uniform(500.0, 4_000.0);
            Drawn::new(size, "size", move |column, _, draw| {
                let flipped = on_and_off(column.values.len(), runs, apart, draw);
                column.add(|i| if flipped[i] { size } else { 0.0 });
            })
        }
        _ => return None,
    })
}
