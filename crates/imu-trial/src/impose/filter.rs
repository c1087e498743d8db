//! Filters of the whole channel.

use super::{Act, Made, Making, object};
use crate::columns::Columns;
use crate::draw::Draw;
use crate::kind::Kind;
use crate::limit::{ABOVE, CORNER};
use std::f64::consts::{PI, SQRT_2};

/// Noise that enters behind the filter, in units of the white part's standard deviation: in practice, a filter is never
/// the last stage.
const BEHIND: f64 = 0.03;

/// The change of a channel.
#[derive(Debug, Clone, Copy)]
enum Filter {
    /// A Butterworth filter: corner in cycles per sample, order 1 or 2.
    Butterworth(f64, usize),
    /// The mean of this many samples.
    Mean(usize),
    /// Delay in samples, gain.
    Echo(usize, f64),
}

#[derive(Debug)]
struct Filtered {
    filter: Filter,
    /// Standard deviation of the noise behind the filter, U, per channel.
    behind: Vec<f64>,
}

impl Act for Filtered {
    fn act(&self, on: &mut Columns, at: &[usize], draw: &mut Draw) {
        for (behind, column) in self.behind.iter().zip(at) {
            let mut draw = draw.split();
            let values = &mut on.columns[*column].values;
            self.filter.apply(values);
            values.iter_mut().for_each(|value| *value += behind * draw.normal());
        }
    }
}

impl Filter {
    fn apply(self, values: &mut [f64]) {
        let Some(first) = values.first().copied() else { return };
        match self {
            // The bilinear transform, warped so that the corner is at the requested frequency.
            Self::Butterworth(corner, order) => {
                let k = (PI * corner).tan();
                let [b0, b1, b2, a1, a2] = if order == 1 {
                    [k / (1.0 + k), k / (1.0 + k), 0.0, (k - 1.0) / (k + 1.0), 0.0]
                } else {
                    let norm = 1.0 / (1.0 + SQRT_2 * k + k * k);
                    let b = k * k * norm;
                    [b, 2.0 * b, b, 2.0 * (k * k - 1.0) * norm, (1.0 - SQRT_2 * k + k * k) * norm]
                };
                // As if the first value had lasted forever.
                let (mut x1, mut x2, mut y1, mut y2) = (first, first, first, first);
                for value in values {
                    let y = b0 * *value + b1 * x1 + b2 * x2 - a1 * y1 - a2 * y2;
                    (x2, x1, y2, y1) = (x1, *value, y1, y);
                    *value = y;
                }
            }
            Self::Mean(window) => {
                let mut last = vec![first; window];
                for (i, value) in values.iter_mut().enumerate() {
                    last[i % window] = *value;
                    // Relative to the first value, so that a large level costs no digits.
                    *value = first + last.iter().map(|one| one - first).sum::<f64>() / window as f64;
                }
            }
            // An echo is of the signal, not of itself.
            Self::Echo(delay, gain) => {
                for i in (delay..values.len()).rev() {
                    values[i] += gain * (values[i - delay] - first);
                }
            }
        }
    }
}

pub(super) fn draw(making: &mut Making<'_>) -> Made {
    let whites: Vec<f64> = making.at.iter().map(|at| making.white(*at)).collect();
    let rate_hz = making.setting.rate_hz;
    // A narrower filter would remove every other effect.
    let alone = making.role.of == 1;
    let (filter, behind, size, entry) = match making.kind {
        Kind::LowPass => {
            // The study found every corner that it tried: sizes range from its highest corner to a fortieth of that.
            let corner = making.device.log_uniform(if alone { 0.01 } else { 0.1 }, CORNER);
            let order = making.device.whole(1, 2);
            let entry = object([("cutoff_hz", (corner * rate_hz).into()), ("order", order.into())]);
            (Filter::Butterworth(corner, order), BEHIND, ABOVE * CORNER / corner, entry)
        }
        Kind::MovingAverage => {
            let window = making.device.log_uniform(2.0, if alone { 33.0 } else { 10.0 }) as usize;
            (Filter::Mean(window), BEHIND, window as f64, object([("window", window.into())]))
        }
        // echo
        _ => {
            let (delay, gain) = (making.device.whole(8, 300), making.device.log_uniform(0.05, 0.4));
            let entry = object([("delay_s", (delay as f64 / rate_hz).into()), ("gain", gain.into())]);
            (Filter::Echo(delay, gain), 0.0, gain, entry)
        }
    };
    let behind: Vec<f64> = whites.into_iter().map(|white| behind * white).collect();
    let entry_of = |behind: &f64| {
        let mut entry = entry.clone();
        if *behind > 0.0 {
            entry["white_behind"] = (behind / rate_hz.sqrt()).into();
        }
        entry
    };
    let parameters = behind.iter().map(entry_of).collect();
    Made { size, parameters, act: Box::new(Filtered { filter, behind }) }
}
