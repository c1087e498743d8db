//! The comparison of one quantity and horizon: errors of the model with their uncertainty.

use super::chance::{LEAST_RUNS, Run, Statistics, by_recording};
use super::{Comparison, ModelError};
use crate::corners::Corners;
use crate::cost;
use crate::document::{Cost, Growth};
use crate::measured::summary;
use crate::pieces::Piece;
use crate::request::{CostError, Quantity, Request};
use imu_model::simulator::SensorModel;
use statrs::distribution::{ContinuousCDF as _, StudentsT};

/// A size without an interval counts as exact. The sheet reports it from this part of the mean square error on.
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

    /// Returns how far a number may be below and above `predicted`, as the intervals allow; `None` if that is not known. The intervals
    /// move the predictions of all begins in proportion.
    fn reach(&self, quantity: Quantity, at: usize, predicted: f64, number: fn(&Growth, usize) -> f64) -> Option<Reach> {
        let own = number(self.central.quantities.get(&quantity)?, at);
        let [low, high] = *self.corners.ends(&self.central, quantity, f64::INFINITY, number)?.get(at)?;
        let share = if own == 0.0 { 1.0 } else { (predicted / own).abs() };
        Some([(own - low) * share, (high - own) * share])
    }

    /// Returns a sentence on the quantities whose uncertainty is not known.
    pub(super) fn open(&self, quantities: impl Iterator<Item = Quantity>) -> Option<String> {
        let is_open =
            |of: &Quantity| self.corners.ends(&self.central, *of, MATTERS, |growth, at| growth.sd[at]).is_none();
        let open: Vec<String> = quantities.filter(is_open).map(|of| of.to_string()).collect();
        let reason = "sizes without an interval, and what is simulated, count as exact";
        (!open.is_empty()).then(|| format!("the model's own uncertainty of {}: {reason}", open.join(", ")))
    }
}

/// How far below and above a value the truth may lie, with 95 % probability.
type Reach = [f64; 2];

/// How a statistic scatters in simulated records: its centre, its standard deviation, and Student's factor for 95 %.
#[derive(Clone, Copy)]
struct Spread {
    centre: f64,
    sd: f64,
    factor: f64,
}

impl Spread {
    fn of(values: &[f64]) -> Option<Self> {
        let count = values.len() as f64;
        let centre = values.iter().sum::<f64>() / count;
        let sd = (values.iter().map(|value| (value - centre).powi(2)).sum::<f64>() / (count - 1.0)).sqrt();
        let factor = StudentsT::new(0.0, 1.0, count - 1.0).ok()?.inverse_cdf(0.975);
        (values.len() >= LEAST_RUNS && sd.is_finite() && sd > 0.0).then_some(Self { centre, sd, factor })
    }
}

/// Returns an error. `of_data` is the reach of the measured value, `of_input` that of the predicted one.
fn error(predicted: f64, measured: f64, of_data: Reach, of_input: Reach, factor: f64) -> ModelError {
    let error = predicted - measured;
    let [below, above] = [of_data[1].hypot(of_input[0]), of_data[0].hypot(of_input[1])];
    let toward_0 = if error > 0.0 { below } else { above };
    let standardized = if error == 0.0 { 0.0 } else { factor * error / toward_0 };
    let u_val = (below + above) / (2.0 * factor);
    ModelError { predicted, measured, error, u_val, ci95: [error - below, error + above], standardized }
}

/// Returns the error of a size (root mean square, standard deviation), which scatters in proportion to itself.
fn of_size(predicted: f64, measured: f64, simulated: &[f64], of_input: Reach) -> Option<ModelError> {
    let logarithms: Vec<f64> = simulated.iter().map(|value| (value / predicted).ln()).collect();
    let spread = Spread::of(&logarithms)?;
    let end = |sign: f64| measured * (sign * spread.factor * spread.sd - spread.centre).exp();
    let of_data = [(measured - end(-1.0)).max(0.0), (end(1.0) - measured).max(0.0)];
    Some(error(predicted, measured, of_data, of_input, spread.factor))
}

/// One quantity and horizon, and what is compared with it.
pub(super) struct Compared<'a> {
    pub pieces: &'a [Piece],
    pub length: usize,
    pub quantity: Quantity,
    /// The horizon's index.
    pub at: usize,
    pub inputs: Option<&'a Inputs>,
    pub runs: &'a [Run],
}

impl Compared<'_> {
    /// Returns the comparison; `None` if there are too few pieces, or if the model has no noise on the quantity.
    pub(super) fn comparison(&self) -> Option<Comparison> {
        let whole = summary(self.pieces, self.length)?;
        let count = self.pieces.len() as f64;
        let errors: Vec<f64> = self.pieces.iter().map(|piece| piece.error).collect();
        let found = Statistics::of(self.pieces, &errors);
        let predicted_mean = self.pieces.iter().map(|piece| piece.predicted.mean).sum::<f64>() / count;
        let predicted_sd = (self.pieces.iter().map(|piece| piece.predicted.sd.powi(2)).sum::<f64>() / count).sqrt();
        let simulated = |of: fn(&Statistics) -> f64| -> Vec<f64> { self.runs.iter().map(|run| of(&run.all)).collect() };
        let reach = |predicted: f64, of: fn(&Growth, usize) -> f64| {
            self.inputs.and_then(|own| own.reach(self.quantity, self.at, predicted, of)).unwrap_or([0.0; 2])
        };
        let of_rms = reach(whole.predicted_rms, |growth, at| growth.mean[at].hypot(growth.sd[at]));
        let rms = of_size(whole.predicted_rms, found.rms, &simulated(|of| of.rms), of_rms)?;
        let of_sd = reach(predicted_sd, |growth, at| growth.sd[at]);
        let scatter = of_size(predicted_sd, found.sd, &simulated(|of| of.sd), of_sd)?;
        let mean = Spread::of(&simulated(|of| of.mean))?;
        // A sensor that is louder than the model has a mean that is known less well.
        let half = mean.factor * mean.sd * (found.sd / predicted_sd).max(1.0);
        let of_mean = reach(predicted_mean, |growth, at| growth.mean[at]);
        let bias = error(predicted_mean, predicted_mean + found.mean, [half; 2], of_mean, mean.factor);
        let sum = bias.error.powi(2) + scatter.error.powi(2);
        let logarithms: Vec<f64> = self.runs.iter().map(|run| run.all.rms.ln()).collect();
        Some(Comparison {
            pieces: whole.count,
            // A root mean square of n independent normal values has a logarithm with the variance 1/2n.
            independent: Spread::of(&logarithms).map_or(1.0, |of| 0.5 / (of.sd * of.sd)).min(count),
            rms,
            bias,
            scatter,
            bias_proportion: (sum > 0.0).then(|| bias.error.powi(2) / sum),
            coverage: whole.coverage,
            coverage_ci95: whole.coverage_ci95,
            recordings_differ: self.recordings_differ(&errors),
        })
    }

    /// Returns the least and the largest ratio of a recording's root mean square to the predicted one if they differ by more than
    /// chance makes.
    fn recordings_differ(&self, errors: &[f64]) -> Option<[f64; 2]> {
        let recordings = self.runs.first()?.rms.len();
        let predicted: Vec<f64> = self.pieces.iter().map(|piece| piece.predicted.square().sqrt()).collect();
        let predicted = by_recording(self.pieces, &predicted, recordings);
        let ratios = |own: &[f64]| -> Vec<f64> {
            own.iter().zip(&predicted).map(|(rms, predicted)| rms / predicted).filter(|of| of.is_finite()).collect()
        };
        let range = |of: &[f64]| of.iter().copied().reduce(f64::max).zip(of.iter().copied().reduce(f64::min));
        let apart = |of: &[f64]| range(of).map(|(most, least)| (most / least).ln());
        let (found, own) = (ratios(&by_recording(self.pieces, errors, recordings)), apart);
        let measured = own(&found)?;
        let by_chance: Vec<f64> = self.runs.iter().filter_map(|run| own(&ratios(&run.rms))).collect();
        let beyond = by_chance.iter().filter(|of| **of >= measured).count() as f64;
        let (most, least) = range(&found)?;
        (found.len() > 1 && beyond < 0.01 * by_chance.len() as f64).then_some([least, most])
    }
}
