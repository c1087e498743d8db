//! The comparison of one quantity and horizon: errors of the model with their uncertainty.

use super::{Comparison, ModelError};
use crate::corners::Corners;
use crate::cost;
use crate::document::{Cost, Growth};
use crate::measured::{correlation, summary};
use crate::pieces::{Piece, disjoint};
use crate::request::{CostError, Quantity, Request};
use imu_model::simulator::SensorModel;
use statrs::distribution::{ChiSquared, ContinuousCDF as _, StudentsT};

/// The half width of a 95 % interval in standard uncertainties.
const NORMAL_95: f64 = 1.959_964;
/// A size without an interval leaves the uncertainty open from this part of the mean square error on.
const MATTERS: f64 = 0.05;

/// How far the model's own intervals move its predictions, at the begin of the first recording.
pub(super) struct Inputs {
    central: Cost,
    corners: Corners,
}

impl Inputs {
    /// Returns `None` if nothing of the model has a closed form.
    pub(super) fn new(model: &SensorModel, request: &Request) -> Result<Option<Self>, CostError> {
        let request = Request { tolerances: Vec::new(), simulate: false, ..request.clone() };
        let bare = SensorModel { provenance: None, ..model.clone() };
        match cost(&bare, &model.name, &request) {
            Ok(central) => Ok(Some(Self { central, corners: Corners::new(&bare, None, &request) })),
            Err(CostError::NoClosedForm { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Returns the prediction of a number, and the least and the largest that the intervals allow; `None` if that is not known.
    fn ends(&self, quantity: Quantity, at: usize, number: impl Fn(&Growth, usize) -> f64) -> Option<[f64; 3]> {
        let own = number(self.central.quantities.get(&quantity)?, at);
        let [low, high] = *self.corners.ends(&self.central, quantity, MATTERS, number)?.get(at)?;
        Some([own, low, high])
    }

    /// Returns a sentence on the quantities whose uncertainty is not known.
    pub(super) fn open(&self, quantities: impl Iterator<Item = Quantity>) -> Option<String> {
        let is_open = |of: &Quantity| self.ends(*of, 0, |growth, at| growth.sd[at]).is_none();
        let open: Vec<String> = quantities.filter(is_open).map(|of| of.to_string()).collect();
        let reason = "sizes without an interval count as exact";
        (!open.is_empty()).then(|| format!("the model's own uncertainty of {}: {reason}", open.join(", ")))
    }
}

/// How far below and above a value the truth may lie.
type Reach = [f64; 2];

/// Returns an error with its uncertainty. `of_data` is the reach of the measured value, `of_input` that of the predicted one.
fn error(predicted: f64, measured: f64, of_data: Reach, of_input: Reach) -> ModelError {
    let error = predicted - measured;
    let [below, above] = [of_data[1].hypot(of_input[0]), of_data[0].hypot(of_input[1])];
    let u_val = (below + above) / (2.0 * NORMAL_95);
    ModelError { predicted, measured, error, u_val, ci95: [error - below, error + above] }
}

/// Returns the comparison of one quantity and horizon; `None` if there are too few pieces.
pub(super) fn compare(
    all: &[Piece],
    length: usize,
    quantity: Quantity,
    at: usize,
    inputs: Option<&Inputs>,
) -> Option<Comparison> {
    let whole = summary(all, length)?;
    let count = all.len() as f64;
    let average = |number: &dyn Fn(&Piece) -> f64| all.iter().map(number).sum::<f64>() / count;
    let beyond = |piece: &Piece| piece.error - piece.predicted.mean;
    let mean = average(&beyond);
    let predicted_mean = average(&|piece| piece.predicted.mean);
    let predicted_sd = average(&|piece| piece.predicted.sd.powi(2)).sqrt();
    let apart = disjoint(all, length);
    let number = Independent::of(&apart, &|piece| beyond(piece) - mean);
    // The pieces' own mean is too close to them.
    let sd = (average(&|piece| (beyond(piece) - mean).powi(2)) * number.of_mean / (number.of_mean - 1.0)).sqrt();
    let [low, high] = chi_interval(sd, (number.of_squares - 1.0).max(1.0))?;
    let quantile = StudentsT::new(0.0, 1.0, number.of_mean - 1.0).ok()?.inverse_cdf(0.975);
    // Two pieces that agree by chance are no proof that all do.
    let half = quantile * sd.max(predicted_sd * f64::from(u8::from(number.of_mean < 3.0))) / number.of_mean.sqrt();
    // What the model states without an interval counts as exact.
    let input = |of: fn(&Growth, usize) -> f64| inputs.and_then(|own| own.ends(quantity, at, of)).unwrap_or([0.0; 3]);
    let difference = |[own, low, high]: [f64; 3]| [own - low, high - own];
    // Sizes scale the prediction at any begin alike.
    let scaled = |predicted: f64, [own, low, high]: [f64; 3]| match own > 0.0 {
        true => [predicted * (1.0 - low / own), predicted * (high / own - 1.0)],
        false => [own - low, high - own],
    };
    let of_mean = difference(input(|growth, at| growth.mean[at]));
    let of_sd = scaled(predicted_sd, input(|growth, at| growth.sd[at]));
    let of_rms = scaled(whole.predicted_rms, input(|growth, at| growth.mean[at].hypot(growth.sd[at])));
    let bias = error(predicted_mean, predicted_mean + mean, [half, half], of_mean);
    let scatter = error(predicted_sd, sd, [sd - low, high - sd], of_sd);
    let around_zero = Independent::of(&apart, &|piece| piece.error);
    let [from, to] = chi_interval(whole.rms, around_zero.of_squares.min(whole.independent))?;
    let [low, high] = [from.min(whole.rms_ci95[0]), to.max(whole.rms_ci95[1])];
    let rms = error(whole.predicted_rms, whole.rms, [whole.rms - low, high - whole.rms], of_rms);
    let sum = bias.error.powi(2) + scatter.error.powi(2);
    Some(Comparison {
        pieces: whole.count,
        independent: whole.independent,
        rms,
        bias,
        scatter,
        bias_proportion: (sum > 0.0).then(|| bias.error.powi(2) / sum),
        coverage: whole.coverage,
        coverage_ci95: whole.coverage_ci95,
    })
}

/// Returns the 95 % interval of a standard deviation or root mean square with that many degrees of freedom.
fn chi_interval(value: f64, freedom: f64) -> Option<[f64; 2]> {
    let chi = ChiSquared::new(freedom).ok()?;
    Some([0.975, 0.025].map(|probability| value * (freedom / chi.inverse_cdf(probability)).sqrt()))
}

/// How many independent values give as good a mean and as good a mean square as those of disjoint pieces.
struct Independent {
    of_mean: f64,
    of_squares: f64,
}

impl Independent {
    /// Neighbours may be correlated, the values' tails heavy, and recordings may differ among themselves.
    fn of(disjoint: &[&Piece], value: &dyn Fn(&Piece) -> f64) -> Self {
        let count = disjoint.len() as f64;
        let values: Vec<f64> = disjoint.iter().map(|piece| value(piece)).collect();
        let moment = |power: i32| values.iter().map(|value| value.powi(power)).sum::<f64>() / count;
        let square = moment(2);
        if square <= 0.0 {
            return Self { of_mean: count.max(2.0), of_squares: count };
        }
        let kurtosis = moment(4) / (square * square);
        let next = correlation(disjoint, &values);
        let mut own = Self {
            of_mean: count * (1.0 - next) / (1.0 + next),
            of_squares: count * (1.0 - next * next) / (1.0 + next * next) * (2.0 / (kurtosis - 1.0).max(2.0)),
        };
        let mut recordings: Vec<Vec<f64>> = Vec::new();
        let mut last = None;
        for (piece, value) in disjoint.iter().zip(&values) {
            if last != Some(piece.run[0]) {
                recordings.push(Vec::new());
                last = Some(piece.run[0]);
            }
            recordings.last_mut().into_iter().for_each(|of| of.push(*value));
        }
        if recordings.len() > 1 {
            let between = |of: &dyn Fn(f64) -> f64| {
                let means: Vec<f64> = recordings
                    .iter()
                    .map(|values| values.iter().map(|value| of(*value)).sum::<f64>() / values.len() as f64)
                    .collect();
                let mean = means.iter().sum::<f64>() / means.len() as f64;
                let freedom = means.len() as f64 - 1.0;
                means.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / freedom / means.len() as f64
            };
            // Variances of the mean and of the mean square, as independent values of that number would have them.
            own.of_mean = own.of_mean.min(square / between(&|value| value));
            own.of_squares = own.of_squares.min(2.0 * square * square / between(&|value| value * value));
        }
        Self { of_mean: own.of_mean.max(2.0), of_squares: own.of_squares.max(1.0) }
    }
}
