//! Effects that channels share.

use super::{Act, Made, Making, object};
use crate::columns::Columns;
use crate::draw::Draw;
use crate::kind::Kind;

/// White noise that several channels share: each channel's share, signed, U.
#[derive(Debug)]
struct Common(Vec<f64>);

impl Act for Common {
    fn act(&self, on: &mut Columns, at: &[usize], draw: &mut Draw) {
        for i in 0..on.len() {
            let noise = draw.normal();
            for (share, column) in self.0.iter().zip(at) {
                on.columns[*column].values[i] += share * noise;
            }
        }
    }
}

/// The first column couples into others with a delay: delay in samples, gains.
#[derive(Debug)]
struct Crosstalk(usize, Vec<f64>);

impl Act for Crosstalk {
    fn act(&self, on: &mut Columns, at: &[usize], _draw: &mut Draw) {
        let Some(source) = on.columns.first().map(|column| column.values.clone()) else { return };
        let level = source.first().copied().unwrap_or(0.0);
        for (gain, column) in self.1.iter().zip(at) {
            let delayed = on.columns[*column].values.iter_mut().skip(self.0);
            delayed.zip(&source).for_each(|(value, source)| *value += gain * (source - level));
        }
    }
}

/// The other columns are loud while the first column is loud: its course over some samples multiplies their white
/// parts.
#[derive(Debug)]
struct Product(f64, f64);

impl Act for Product {
    fn act(&self, on: &mut Columns, at: &[usize], _draw: &mut Draw) {
        let Some(source) = on.columns.first() else { return };
        let pole = (-1.0 / self.1).exp();
        let fresh = (1.0 - pole * pole).sqrt() / source.scale;
        let mut state = 0.0;
        let gains = source.white.iter().map(|white| {
            state = pole * state + fresh * white;
            (self.0 * state).exp()
        });
        let gains: Vec<f64> = gains.collect();
        for column in at {
            on.columns[*column].amplify(|i, _| gains[i]);
        }
    }
}

pub(super) fn draw(making: &mut Making<'_>) -> Made {
    if making.kind == Kind::CommonMode {
        let shares = making.signed_sizes_u();
        let parameters = shares.iter().map(|share| object([("sigma", share.abs().into())])).collect();
        return Made { size: making.size(), parameters, act: Box::new(Common(shares)) };
    }
    if making.kind == Kind::ProductCrosstalk {
        let (size, over) = (making.device.log_uniform(0.15, 0.6), making.device.log_uniform(1.0, 30.0));
        let entry = object([("log_gain", size.into()), ("samples", over.into())]);
        return Made { size, parameters: vec![entry; making.at.len()], act: Box::new(Product(size, over)) };
    }
    // delayed_crosstalk: the gain is in units of the two channels' noise, which may have different units.
    let (delay, size) = (making.device.whole(3, 50), making.device.log_uniform(0.1, 0.5));
    let source = making.white(0);
    let gains: Vec<f64> = making.at.iter().map(|at| size * making.white(*at) / source).collect();
    let gains: Vec<f64> = gains.into_iter().map(|gain| gain * making.device.sign()).collect();
    let entry =
        |gain: &f64| object([("delay_s", (delay as f64 / making.setting.rate_hz).into()), ("gain", (*gain).into())]);
    let parameters = gains.iter().map(entry).collect();
    Made { size, parameters, act: Box::new(Crosstalk(delay, gains)) }
}
