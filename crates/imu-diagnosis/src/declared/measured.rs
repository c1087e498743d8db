//! Measured: a model's lines as a channel has them.

use crate::evidence::Kind;
use crate::prepare::Prepared;
use crate::prices::Prices;
use crate::series::Series;
use crate::spread::Spread;
use imu_model::simulator::ChannelModel;

/// One of the model's lines as a channel has it, in the series' scale.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub(crate) struct MeasuredLine {
    /// Peak and its standard error.
    pub(crate) amplitude: f64,
    pub(crate) error: f64,
    /// Nats gained over the model's amplitude, and over a series without the line.
    pub(crate) otherwise: f64,
    pub(crate) there: f64,
    /// Whether the channel's line differs from the model's statement.
    pub(crate) is_off: bool,
}

/// Returns the model's lines as a channel has them. Amplitudes are normal about the true ones.
///
/// A line whose stated interval reaches the channel's value agrees with the model.
pub(crate) fn lines(series: &Series<'_>, of: &Prepared, model: &ChannelModel, prices: &Prices) -> Vec<MeasuredLine> {
    let errors = Spread::of(series).sines;
    let own = series.explanation.sines.iter().zip(&of.sines).zip(&of.lines).zip(errors);
    own.map(|(((found, declared), (place, passed)), (_, error))| {
        let (amplitude, expected) = (found.amplitude(), declared.amplitude());
        let nats = |off: f64| 0.5 * (off / error).powi(2);
        let stated = model.effect_interval(*place, "amplitude").map(|ends| ends.map(|end| end * passed / of.scale));
        let is_within =
            stated.is_some_and(|[low, high]| amplitude - 1.96 * error <= high && amplitude + 1.96 * error >= low);
        let otherwise = nats(amplitude - expected);
        MeasuredLine {
            amplitude,
            error,
            otherwise,
            there: nats(amplitude),
            is_off: !is_within && otherwise > prices.of(Kind::Tone),
        }
    })
    .collect()
}
