//! Changes of samples on their way out that no effect of the library describes.

use super::{Drawn, on_and_off};
use crate::draw::Draw;
use crate::kind::Kind;
use std::f64::consts::{PI, TAU};

/// Returns the level about which values vary: the mean of the first thousand.
fn level(values: &[f64]) -> f64 {
    let first = &values[..values.len().min(1_000)];
    first.iter().sum::<f64>() / first.len().max(1) as f64
}

/// Applies y = b₀x + b₁x₁ + b₂x₂ − a₁y₁ − a₂y₂ about the level, which stays.
fn biquad(values: &mut [f64], [b0, b1, b2, a1, a2]: [f64; 5]) {
    let level = level(values);
    let (mut x1, mut x2, mut y1, mut y2) = (0.0, 0.0, 0.0, 0.0);
    for value in values {
        let x = *value - level;
        let y = b0 * x + b1 * x1 + b2 * x2 - a1 * y1 - a2 * y2;
        (x2, x1, y2, y1) = (x1, x, y1, y);
        *value = level + y;
    }
}

pub(super) fn draw(kind: Kind, samples: usize, device: &mut Draw) -> Drawn {
    match kind {
        // Some samples are means of neighbouring measured samples.
        Kind::NeighbourMeans => {
            let size = device.log_uniform(0.02, 0.4);
            Drawn::new(size, "share", move |column, _, draw| {
                let values = &mut column.values;
                for i in draw.events(size, values.len() - 1) {
                    values[i] = 0.5 * (values[i - 1] + values[i + 1]);
                }
            })
        }
        // Each second, third … sample repeats the one before.
        Kind::RepeatedPattern => {
            let every = device.whole(2, 6);
            Drawn::new(every as f64, "every", move |column, _, _| {
                for i in (1..column.values.len()).filter(|i| i % every == 0) {
                    column.values[i] = column.values[i - 1];
                }
            })
        }
        // A converter that never gives each fourth code.
        Kind::MissingCodes => {
            let size = device.uniform(0.4, 1.2);
            Drawn::new(size, "step", move |column, _, _| {
                let step = size * column.scale;
                for value in &mut column.values {
                    let code = (*value / step).round();
                    *value = step * if code.rem_euclid(4.0) == 1.0 { code + 1.0 } else { code };
                }
            })
        }
        // A converter one of whose bits is always set.
        Kind::StuckBit => {
            let size = device.uniform(0.2, 0.5);
            Drawn::new(size, "step", move |column, _, _| {
                let step = size * column.scale;
                for value in &mut column.values {
                    let code = (*value / step).round();
                    *value = step * if code.rem_euclid(4.0) < 2.0 { code + 2.0 } else { code };
                }
            })
        }
        // Steps are four times as large if the value is far from the middle.
        Kind::RangeSwitch => {
            let size = device.uniform(0.3, 1.0);
            Drawn::new(size, "step", move |column, _, _| {
                let (fine, level, far) = (size * column.scale, level(&column.values), 0.8 * column.scale);
                for value in &mut column.values {
                    let step = if (*value - level).abs() > far { 4.0 * fine } else { fine };
                    *value = step * (*value / step).round();
                }
            })
        }
        // A limit that moves.
        Kind::MovingLimit => {
            let (size, turns) = (device.uniform(1.0, 2.5), device.uniform(1.5, 6.0));
            Drawn::new(size, "middle", move |column, _, draw| {
                let (count, phase) = (column.values.len() as f64, draw.uniform(0.0, TAU));
                let (level, scale) = (level(&column.values), column.scale);
                for (i, value) in column.values.iter_mut().enumerate() {
                    let limit = size + 0.5 * (TAU * turns * i as f64 / count + phase).sin();
                    *value = value.min(level + scale * limit);
                }
            })
        }
        // The output cannot move by more than a limit per sample.
        Kind::SlewLimit => {
            let size = device.log_uniform(0.5, 2.0);
            Drawn::new(size, "per_sample", move |column, _, _| {
                let (most, mut before) = (size * column.scale, level(&column.values));
                for value in &mut column.values {
                    before += (*value - before).clamp(-most, most);
                    *value = before;
                }
            })
        }
        // Large values are compressed smoothly.
        Kind::Compression => {
            let size = device.log_uniform(1.0, 2.5);
            Drawn::new(size, "knee", move |column, _, _| {
                let (knee, level) = (size * column.scale, level(&column.values));
                column.values.iter_mut().for_each(|value| *value = level + knee * ((*value - level) / knee).tanh());
            })
        }
        // A band is removed.
        Kind::Notch => {
            let (cycles, size) = (device.uniform(0.06, 0.42), device.log_uniform(0.005, 0.05));
            Drawn::new(size, "bandwidth", move |column, _, _| {
                let (cos, alpha) = ((TAU * cycles).cos(), (PI * size).tan());
                let norm = 1.0 / (1.0 + alpha);
                let (middle, ends) = (-2.0 * cos * norm, norm);
                biquad(&mut column.values, [ends, middle, ends, middle, (1.0 - alpha) * norm]);
            })
        }
        // Coupled by a capacitor: slow components are removed.
        Kind::HighPass => {
            let size = device.log_uniform(0.01, 0.1);
            Drawn::new(size, "corner", move |column, _, _| {
                let k = (PI * size).tan();
                let norm = 1.0 / (1.0 + k);
                biquad(&mut column.values, [norm, -norm, 0.0, (k - 1.0) * norm, 0.0]);
            })
        }
        // In some stretches each second sample is sent twice.
        Kind::HalfRateStretches => {
            let (size, stays) = (device.log_uniform(0.05, 0.4), samples as f64 / device.uniform(10.0, 40.0));
            Drawn::new(size, "share", move |column, _, draw| {
                let half = on_and_off(column.values.len(), stays * size, stays * (1.0 - size), draw);
                for i in (1..column.values.len()).filter(|i| i % 2 == 1 && half[*i]) {
                    column.values[i] = column.values[i - 1];
                }
            })
        }
        // filter_switched: in some stretches the mean of the last few.
        _ => {
            let (size, stays) = (device.whole(2, 6), samples as f64 / device.uniform(4.0, 15.0));
            Drawn::new(size as f64, "window", move |column, _, draw| {
                let filtered = on_and_off(column.values.len(), 0.4 * stays, 0.6 * stays, draw);
                let before = column.values.clone();
                for i in (size..before.len()).filter(|i| filtered[*i]) {
                    column.values[i] = before[i + 1 - size..=i].iter().sum::<f64>() / size as f64;
                }
            })
        }
    }
}
