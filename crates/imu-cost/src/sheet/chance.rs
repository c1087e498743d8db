//! Chance: what the pieces of the recordings show if the model is true, from simulated records with the same pieces.
//!
//! In: a model, recordings, their pieces. Out: root mean square, mean and scatter of the pieces' errors in each of a number of
//! simulations. Pieces overlap, and their errors have parts in common; simulated pieces do alike. Pure: run k of recording r has the
//! seed of the request plus a number of its own.

use super::{Evidence, USED};
use crate::courses::simulator;
use crate::pieces::Piece;
use crate::quadrature::scale;
use crate::request::{CostError, Quantity, Request, Setting};
use crate::sources::restricted;
use crate::weights::ORDERS;
use imu_core::sample::Channel;
use imu_model::simulator::SensorModel;
use std::collections::BTreeMap;

/// The number of simulations of each recording.
const RUNS: usize = 100;
/// The least number from which a spread is taken.
pub(super) const LEAST_RUNS: usize = 20;
/// The most samples of all channels in all simulations: minutes.
const WORK_MAX: f64 = 4e9;
/// The most samples of all channels of one record: 1.3 GB.
const RECORD_MAX: f64 = 4e7;

/// What pieces show, in the quantity's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Statistics {
    /// Root mean square of the errors.
    pub rms: f64,
    /// Mean of the errors beyond the predicted mean.
    pub mean: f64,
    /// Standard deviation about the two.
    pub sd: f64,
}

impl Statistics {
    /// Takes the statistics of errors, one for each piece.
    pub(super) fn of(pieces: &[Piece], errors: &[f64]) -> Self {
        let count = errors.len() as f64;
        let beyond = || pieces.iter().zip(errors).map(|(piece, error)| error - piece.predicted.mean);
        let mean = beyond().sum::<f64>() / count;
        let variance = beyond().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
        let square = errors.iter().map(|error| error * error).sum::<f64>() / count;
        Self { rms: square.sqrt(), mean, sd: variance.sqrt() }
    }
}

/// One simulation of all recordings.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Run {
    /// Of the pieces of all recordings.
    pub all: Statistics,
    /// The root mean square of each recording's.
    pub rms: Vec<f64>,
}

/// The simulations, by quantity and horizon.
pub(super) type Runs = BTreeMap<Quantity, Vec<Vec<Run>>>;

/// Simulates the recordings. Returns `None` if that would take too long, or too much memory.
pub(super) fn simulated(
    model: &SensorModel,
    evidence: &[(&Evidence<'_>, Request)],
    pieces: &BTreeMap<Quantity, Vec<Vec<Piece>>>,
) -> Result<Option<Runs>, CostError> {
    let model = restricted(model, &USED);
    let mut settings = Vec::with_capacity(evidence.len());
    for (of, request) in evidence {
        let places = of.rest.channels.first().map_or(0, |(_, values)| values.len()).max(1);
        let horizons_s = vec![places as f64 / model.rate_hz];
        let setting = Setting::new(&Request { horizons_s, tolerances: Vec::new(), ..request.clone() }, &model)?;
        settings.push((setting, places));
    }
    let samples = |(setting, places): &(Setting<'_>, usize)| (setting.begin + *places as u64) * setting.ratio() as u64;
    let work = settings.iter().map(|of| samples(of) as f64).sum::<f64>() * model.channels.len() as f64;
    let count = RUNS.min((WORK_MAX / work.max(1.0)) as usize);
    let longest = settings.iter().map(|(_, places)| *places).max().unwrap_or(0);
    if count < LEAST_RUNS || longest as f64 * model.channels.len() as f64 > RECORD_MAX {
        return Ok(None);
    }
    let mut runs: Runs =
        pieces.iter().map(|(of, horizons)| (*of, vec![Vec::with_capacity(count); horizons.len()])).collect();
    for run in 0..count {
        let mut errors: BTreeMap<Quantity, Vec<Vec<f64>>> =
            pieces.iter().map(|(of, horizons)| (*of, vec![Vec::new(); horizons.len()])).collect();
        // One record at a time is in memory. Pieces are in the order of their recordings.
        for (number, (setting, places)) in settings.iter().enumerate() {
            let seed = setting.seed.wrapping_add((run * settings.len() + number) as u64);
            let record = Record::new(setting, &model, seed, *places)?;
            for (quantity, horizons) in pieces {
                for (pieces, errors) in horizons.iter().zip(errors.entry(*quantity).or_default()) {
                    let own = pieces.iter().filter(|piece| piece.run[0] == number);
                    errors.extend(own.map(|piece| record.error(*quantity, piece)));
                }
            }
        }
        for (quantity, horizons) in pieces {
            let all = runs.entry(*quantity).or_default().iter_mut().zip(horizons).zip(&errors[quantity]);
            for ((found, pieces), errors) in all {
                let rms = by_recording(pieces, errors, settings.len());
                found.push(Run { all: Statistics::of(pieces, errors), rms });
            }
        }
    }
    Ok(Some(runs))
}

/// Returns the root mean square of each recording's errors; NaN if it has no piece.
pub(super) fn by_recording(pieces: &[Piece], errors: &[f64], recordings: usize) -> Vec<f64> {
    let mut sums = vec![[0.0; 2]; recordings];
    for (piece, error) in pieces.iter().zip(errors) {
        if let Some([sum, count]) = sums.get_mut(piece.run[0]) {
            *sum += error * error;
            *count += 1.0;
        }
    }
    sums.iter().map(|[sum, count]| (sum / count).sqrt()).collect()
}

/// A simulated record: for each channel the running sums of k⁰x, k¹x and k²x before each place, of samples less their mean.
struct Record {
    rate_hz: f64,
    align: usize,
    sums: BTreeMap<Channel, Vec<[f64; ORDERS]>>,
}

impl Record {
    fn new(setting: &Setting<'_>, model: &SensorModel, seed: u64, places: usize) -> Result<Self, CostError> {
        let mut simulator = simulator(setting, model, seed)?;
        let mut columns: BTreeMap<Channel, Vec<f64>> =
            model.channels.keys().map(|channel| (*channel, Vec::with_capacity(places))).collect();
        let (mut before, mut taken) = (setting.begin, 0);
        while taken < places {
            let Some(block) = simulator.next_block() else { break };
            let skipped = (before as usize).min(block.len());
            before -= skipped as u64;
            let end = block.len().min(skipped + places - taken);
            for (channel, column) in &mut columns {
                column.extend(block.values(*channel).unwrap_or_default().get(skipped..end).unwrap_or_default());
            }
            taken += end - skipped;
        }
        let sums = columns.into_iter().map(|(channel, column)| (channel, running_sums(&column))).collect();
        Ok(Self { rate_hz: setting.rate_hz, align: setting.align as usize, sums })
    }

    /// Returns the error of a piece, as [`crate::pieces::piece_error`] does.
    fn error(&self, quantity: Quantity, piece: &Piece) -> f64 {
        let part = |share: &crate::request::Share| {
            let sums = self.sums.get(&share.channel)?;
            let (start, end) = (piece.begin + self.align, piece.begin + piece.length);
            let bias = (sums.get(start)?[0] - sums.get(piece.begin)?[0]) / self.align as f64;
            let between: [f64; ORDERS] =
                std::array::from_fn(|power| sums[end.min(sums.len() - 1)][power] - sums[start][power]);
            // With u = end − k: Σx, Σ(u − ½)x and Σ(u² − u + ⅓)x/2, the integrals of held samples.
            let (from_end, horizon) = (end as f64, (end - start) as f64);
            let first = from_end * between[0] - between[1];
            let second = from_end * from_end * between[0] - 2.0 * from_end * between[1] + between[2];
            let (own, of_bias) = match share.order {
                1 => (between[0], horizon),
                2 => (first - 0.5 * between[0], horizon * horizon / 2.0),
                _ => (0.5 * (second - first) + between[0] / 6.0, horizon.powi(3) / 6.0),
            };
            Some(share.factor * (own - bias * of_bias) * scale(share.order, self.rate_hz))
        };
        quantity.shares().iter().filter_map(part).sum()
    }
}

fn running_sums(column: &[f64]) -> Vec<[f64; ORDERS]> {
    let mean = column.iter().sum::<f64>() / column.len().max(1) as f64;
    let mut sums = Vec::with_capacity(column.len() + 1);
    let mut sum = [0.0; ORDERS];
    sums.push(sum);
    for (place, value) in column.iter().enumerate() {
        let (value, place) = (value - mean, place as f64);
        sum[0] += value;
        sum[1] += place * value;
        sum[2] += place * place * value;
        sums.push(sum);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pieces::{Predicted, Rest, piece_error};

    #[test]
    fn errors_from_running_sums_are_those_of_the_samples() {
        let columns: Vec<(Channel, Vec<f64>)> = USED
            .into_iter()
            .enumerate()
            .map(|(at, channel)| {
                (channel, (0..5000).map(|k| 0.3 + ((k * (7 + at)) as f64).sin() + 1e-4 * k as f64).collect())
            })
            .collect();
        let record = Record {
            rate_hz: 40.0,
            align: 300,
            sums: columns.iter().map(|(channel, column)| (*channel, running_sums(column))).collect(),
        };
        let rest = Rest {
            rate_hz: 40.0,
            channels: columns.iter().map(|(channel, column)| (*channel, column.as_slice())).collect(),
            missing: &[],
        };
        for (begin, horizon) in [(0, 1), (17, 20), (4000, 700), (1234, 2000)] {
            let predicted = Predicted { mean: 0.0, sd: 1.0, band95: 2.0 };
            let piece = Piece { begin, run: [0; 2], length: 300 + horizon, error: 0.0, predicted };
            for quantity in Quantity::all() {
                let (own, other) =
                    (record.error(*quantity, &piece), piece_error(&rest, *quantity, begin, 300, horizon));
                assert!(
                    (own - other).abs() < 1e-8 * other.abs().max(1e-3),
                    "{quantity} {begin} {horizon}: {own} {other}"
                );
            }
        }
    }
}
