//! Measured error growth: what unaided integration does in pieces of a recording at rest, beside a model's bands.
//!
//! In: samples on a regular grid, a model, a request. Out: per quantity and horizon the number of pieces, the root mean
//! square of their errors with its interval, what the model predicts, and the share of pieces inside its 95 % band with an
//! interval. Pure.
//!
//! A piece is an alignment and a horizon after it, without a missing sample. Pieces begin a quarter of their length apart,
//! which uses the record better; intervals count disjoint pieces only, and fewer if their errors are correlated.
//!
//! The recording's first sample is at the request's `begin_s` of the model's time. If the model's law changes with time (a warm-up, a step, bursts), each
//! piece has the band of its own begin, and there are at most 48 of them.
//!
//! Refused: a recording of another rate, and one with fewer than [`LEAST_PIECES`] disjoint pieces at every horizon.

use crate::pieces::{MeasureError, Piece, Rest, disjoint, has_begins, pieces};
use crate::request::{Quantity, Request};
use imu_model::simulator::SensorModel;
use serde::Serialize;
use statrs::distribution::{Beta, ChiSquared, ContinuousCDF as _};
use std::collections::BTreeMap;

/// The least number of disjoint pieces from which anything is measured.
pub const LEAST_PIECES: usize = 5;

/// What was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measured {
    /// The recording, as the caller names it.
    pub real: String,
    /// Time of the present samples, s.
    pub length_s: f64,
    /// Times since the alignment's end, s.
    pub horizons_s: Vec<f64>,
    /// The quantities whose channels model and recording have.
    pub quantities: BTreeMap<Quantity, Growing>,
    /// What a reader has to know, one sentence each.
    pub notes: Vec<String>,
}

/// One quantity, one entry per horizon; none if there are fewer than [`LEAST_PIECES`] disjoint pieces.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Growing {
    /// `rad`, `m/s` or `m`.
    pub unit: &'static str,
    /// What the pieces show.
    pub pieces: Vec<Option<Pieces>>,
}

/// The errors in the pieces of one horizon, in the quantity's unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pieces {
    /// The number of pieces, which overlap.
    pub count: usize,
    /// The number of independent ones: disjoint pieces, less what their correlation takes.
    pub independent: f64,
    /// Root mean square of the errors.
    pub rms: f64,
    /// Its 95 % interval.
    pub rms_ci95: [f64; 2],
    /// The root mean square that the model predicts for these pieces.
    pub predicted_rms: f64,
    /// Share of the pieces whose error is inside the model's 95 % band.
    pub coverage: f64,
    /// The 95 % interval of that share (Clopper and Pearson).
    pub coverage_ci95: [f64; 2],
}

/// Measures the error growth in pieces of a recording, which the result calls `real`, and compares it with a model's.
/// Limits and a motion of the request are ignored.
///
/// # Errors
/// [`MeasureError`] if there are too few pieces, if rate or channels differ, or for a request that makes no sense.
///
/// # Source
/// Intervals: χ² with the degrees of freedom of the kurtosis for the root mean square; Clopper and Pearson, Biometrika 26
/// (1934), for the share.
///
/// # Validation
/// `a_true_model_covers_its_own_record`, `intervals_hold_as_often_as_they_state`.
pub fn measured(
    record: &Rest<'_>,
    real: &str,
    model: &SensorModel,
    request: &Request,
) -> Result<Measured, MeasureError> {
    of_pieces(record, real, model, request, false)
}

/// Measures the same pieces for a model and for another one, as [`measured`] does for one.
///
/// # Errors
/// Those of [`measured`].
pub fn measured_both(
    record: &Rest<'_>,
    real: &str,
    models: [&SensorModel; 2],
    request: &Request,
) -> Result<[Measured; 2], MeasureError> {
    let plain = Request { tolerances: Vec::new(), motion: None, ..request.clone() };
    let has_begins = has_begins(models[0], &plain)? || has_begins(models[1], &plain)?;
    let [one, other] = models.map(|model| of_pieces(record, real, model, request, has_begins));
    Ok([one?, other?])
}

fn of_pieces(
    record: &Rest<'_>,
    real: &str,
    model: &SensorModel,
    request: &Request,
    has_begins: bool,
) -> Result<Measured, MeasureError> {
    let found = pieces(record, 0, model, request, LEAST_PIECES, has_begins)?;
    let growing = |(quantity, all): (&Quantity, &Vec<Vec<Piece>>)| {
        let summaries = all.iter().zip(&found.lengths).map(|(pieces, length)| summary(pieces, *length));
        (*quantity, Growing { unit: quantity.unit(), pieces: summaries.collect() })
    };
    let quantities = found.pieces.iter().map(growing).collect();
    let horizons_s = request.horizons_s.clone();
    Ok(Measured { real: real.to_owned(), length_s: found.length_s, horizons_s, quantities, notes: found.notes })
}

/// Summarises pieces of one length; `None` if fewer than [`LEAST_PIECES`] are disjoint.
pub(crate) fn summary(all: &[Piece], length: usize) -> Option<Pieces> {
    let disjoint = disjoint(all, length);
    if disjoint.len() < LEAST_PIECES {
        return None;
    }
    let independent = independent(&disjoint);
    let count = all.len() as f64;
    let mean = |power: i32| all.iter().map(|piece| piece.error.powi(power)).sum::<f64>() / count;
    let (square, fourth) = (mean(2), mean(4));
    // Var(x²)/E(x²)² is 2 for normal errors, and the kurtosis less 1 for any.
    let kurtosis = if square > 0.0 { fourth / (square * square) } else { 3.0 };
    let freedom = (independent * (2.0 / (kurtosis - 1.0).max(2.0))).max(1.0);
    let chi = ChiSquared::new(freedom).ok()?;
    let end = |probability: f64| (square * freedom / chi.inverse_cdf(probability)).sqrt();
    let inside = all.iter().filter(|piece| piece.error.abs() <= piece.predicted.band95).count() as f64;
    let coverage = inside / count;
    let predicted = all.iter().map(|piece| piece.predicted.square()).sum::<f64>() / count;
    Some(Pieces {
        count: all.len(),
        independent,
        rms: square.sqrt(),
        rms_ci95: [end(0.975), end(0.025)],
        predicted_rms: predicted.sqrt(),
        coverage,
        coverage_ci95: share_interval(coverage, independent),
    })
}

/// Returns the correlation of the values of successive disjoint pieces, 0 or more. A half standard error is added: of few pieces the
/// correlation itself is hardly known.
pub(crate) fn correlation(disjoint: &[&Piece], values: &[f64]) -> f64 {
    let count = values.len() as f64;
    let square = values.iter().map(|value| value * value).sum::<f64>() / count;
    let neighbours = disjoint.iter().zip(disjoint.iter().skip(1)).zip(values.iter().zip(values.iter().skip(1)));
    let (number, sum) = neighbours
        .filter(|((one, other), _)| one.run == other.run)
        .fold((0.0_f64, 0.0), |(number, sum), (_, (one, other))| (number + 1.0, sum + one * other));
    (sum / (number.max(1.0) * square) + 0.5 / count.sqrt()).clamp(0.0, 0.999)
}

/// Returns how many independent errors give as good a mean square. The errors of successive disjoint pieces may be correlated, and
/// all may have a part in common, such as the drift of a ramp. Both correlations are estimated with the bias that a short row has,
/// and the smaller number counts.
fn independent(disjoint: &[&Piece]) -> f64 {
    let count = disjoint.len() as f64;
    let square = disjoint.iter().map(|piece| piece.error.powi(2)).sum::<f64>() / count;
    if square <= 0.0 {
        return count;
    }
    let next = correlation(disjoint, &disjoint.iter().map(|piece| piece.error).collect::<Vec<_>>());
    let mean = disjoint.iter().map(|piece| piece.error).sum::<f64>() / count;
    let common = ((count * mean * mean / square - 1.0) / (count - 1.0)).clamp(0.0, 1.0);
    // Squares of normal errors have the square of the correlation.
    let of_chain = count * (1.0 - next * next) / (1.0 + next * next);
    let of_common = count / (1.0 + (count - 1.0) * common * common);
    of_chain.min(of_common).max(1.0)
}

/// Returns the 95 % interval of a share among a number of independent trials, which need not be whole.
fn share_interval(share: f64, trials: f64) -> [f64; 2] {
    let (inside, outside) = (share * trials, (1.0 - share) * trials);
    let quantile =
        |a: f64, b: f64, probability: f64| Beta::new(a, b).map_or(f64::NAN, |of| of.inverse_cdf(probability));
    let low = if inside > 0.0 { quantile(inside, outside + 1.0, 0.025) } else { 0.0 };
    let high = if outside > 0.0 { quantile(inside + 1.0, outside, 0.975) } else { 1.0 };
    [if low.is_finite() { low } else { 0.0 }, if high.is_finite() { high } else { 1.0 }]
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::pieces::{BEGINS, Predicted};
    use imu_core::sample::Channel;
    use imu_model::simulator::Simulator;

    fn model(channels: &str) -> SensorModel {
        let text =
            format!(r#"{{"format": "vn100d-sensor-model-1", "name": "t", "rate_hz": 20, "channels": {{{channels}}}}}"#);
        SensorModel::from_json(&text, "t.json").unwrap()
    }

    /// Returns the samples of a simulated record, by channel.
    pub(crate) fn simulated(model: &SensorModel, seed: u64, length_s: f64) -> Vec<(Channel, Vec<f64>)> {
        let mut simulator = Simulator::new(model, seed, model.rate_hz, length_s).unwrap();
        let mut columns: Vec<(Channel, Vec<f64>)> = model.channels.keys().map(|of| (*of, Vec::new())).collect();
        let count = (length_s * model.rate_hz) as usize;
        while columns[0].1.len() < count {
            let block = simulator.next_block().unwrap();
            for (channel, column) in &mut columns {
                column.extend_from_slice(block.values(*channel).unwrap());
            }
        }
        columns.iter_mut().for_each(|(_, column)| column.truncate(count));
        columns
    }

    fn rest<'a>(columns: &'a [(Channel, Vec<f64>)], missing: &'a [bool]) -> Rest<'a> {
        let channels = columns.iter().map(|(channel, values)| (*channel, values.as_slice())).collect();
        Rest { rate_hz: 20.0, channels, missing }
    }

    fn request(horizons_s: &[f64]) -> Request {
        Request { align_s: 10.0, horizons_s: horizons_s.to_vec(), ..Request::default() }
    }

    const UNIT: &str =
        r#""gyro_y": {"N": 1e-4, "B": 2e-5, "K": 1e-6}, "gyro_z": {"N": 1e-4, "K": 2e-6}, "accel_x": {"N": 1e-3}"#;

    #[test]
    fn a_true_model_covers_its_own_record() {
        let model = model(UNIT);
        let columns = simulated(&model, 7, 14_400.0);
        let found = measured(&rest(&columns, &[]), "night", &model, &request(&[1.0, 10.0, 60.0])).unwrap();
        assert_eq!((found.length_s, found.quantities.len()), (14_400.0, 4));
        for (quantity, of) in &found.quantities {
            for pieces in &of.pieces {
                let pieces = pieces.as_ref().unwrap();
                assert!(pieces.count as f64 > 3.0 * pieces.independent, "{quantity} {pieces:?}");
                assert!((pieces.coverage - 0.95).abs() < 0.04, "{quantity} {pieces:?}");
                let [low, high] = pieces.rms_ci95;
                assert!(low < pieces.predicted_rms && pieces.predicted_rms < high, "{quantity} {pieces:?}");
            }
        }
    }

    #[test]
    fn a_model_of_too_little_noise_covers_less() {
        let columns = simulated(&model(UNIT), 8, 7200.0);
        let quiet = model(r#""gyro_z": {"N": 4e-5}"#);
        let found = measured(&rest(&columns, &[]), "night", &quiet, &request(&[10.0])).unwrap();
        let pieces = found.quantities[&Quantity::Heading].pieces[0].clone().unwrap();
        assert!(pieces.coverage_ci95[1] < 0.8 && pieces.rms_ci95[0] > 2.0 * pieces.predicted_rms, "{pieces:?}");
    }

    #[test]
    fn no_piece_spans_a_gap() {
        let model = model(r#""gyro_z": {"N": 1e-4}"#);
        let mut columns = simulated(&model, 9, 3600.0);
        // Another level after each of two gaps: one is marked, one has no values.
        columns[0].1.iter_mut().skip(20_010).for_each(|value| *value += 1.0);
        columns[0].1.iter_mut().skip(40_000).for_each(|value| *value += 1.0);
        columns[0].1[39_990..40_000].fill(f64::NAN);
        let missing: Vec<bool> = (0..72_000).map(|place| (20_000..20_010).contains(&place)).collect();
        let found = measured(&rest(&columns, &missing), "night", &model, &request(&[1.0, 30.0])).unwrap();
        for pieces in found.quantities[&Quantity::Heading].pieces.iter().flatten() {
            assert!(pieces.rms < 1.3 * pieces.predicted_rms, "{pieces:?}");
        }
    }

    #[test]
    fn each_piece_of_a_warm_up_has_the_band_of_its_own_begin() {
        let warm =
            model(r#""gyro_z": {"N": 1e-5, "effects": [{"effect": "warm_up", "amplitude": 5e-3, "tau_s": 600}]}"#);
        let columns = simulated(&warm, 3, 3600.0);
        let found = measured(&rest(&columns, &[]), "night", &warm, &request(&[60.0])).unwrap();
        let pieces = found.quantities[&Quantity::Heading].pieces[0].clone().unwrap();
        assert!((0.85..=1.0).contains(&pieces.coverage) && pieces.count <= BEGINS, "{pieces:?}");
        assert!((pieces.rms / pieces.predicted_rms - 1.0).abs() < 0.02, "{pieces:?}");
        // Without the warm-up nothing near switch-on is covered; what is left of it later counts as one error.
        let plain = model(r#""gyro_z": {"N": 1e-5}"#);
        let found = measured(&rest(&columns, &[]), "night", &plain, &request(&[60.0])).unwrap();
        let pieces = found.quantities[&Quantity::Heading].pieces[0].clone().unwrap();
        assert!(pieces.coverage < 0.5 && pieces.independent < 30.0, "{pieces:?}");
    }

    #[test]
    fn intervals_hold_as_often_as_they_state() {
        let model = model(r#""gyro_z": {"N": 1e-4, "B": 3e-5}"#);
        let request = request(&[5.0, 20.0]);
        let (mut held, mut all) = ([0; 2], 0);
        for seed in 0..200 {
            let columns = simulated(&model, seed, 600.0);
            let found = measured(&rest(&columns, &[]), "night", &model, &request).unwrap();
            for pieces in found.quantities[&Quantity::Heading].pieces.iter().flatten() {
                all += 1;
                let inside = |value: f64, [low, high]: [f64; 2]| usize::from(low <= value && value <= high);
                held[0] += inside(pieces.predicted_rms, pieces.rms_ci95);
                held[1] += inside(0.95, pieces.coverage_ci95);
            }
        }
        // They are careful rather than too narrow.
        assert!(held.iter().all(|held| *held as f64 >= 0.94 * f64::from(all)), "{held:?} of {all}");
    }

    #[test]
    fn what_cannot_be_measured_is_refused_with_what_is_expected() {
        let model = model(UNIT);
        let columns = simulated(&model, 1, 100.0);
        let refusal = |rate_hz: f64, align_s: f64| {
            let request = Request { align_s, ..request(&[10.0]) };
            measured(&Rest { rate_hz, ..rest(&columns, &[]) }, "night", &model, &request).unwrap_err().to_string()
        };
        assert!(refusal(20.0, 30.0).contains("2 disjoint pieces of 40 s"), "{}", refusal(20.0, 30.0));
        assert!(refusal(40.0, 10.0).contains("expected the same rate"));
        let other = [(Channel::MagX, vec![0.0; 2000])];
        let error = measured(&rest(&other, &[]), "night", &model, &request(&[1.0])).unwrap_err().to_string();
        assert!(error.contains("gyro_x"), "{error}");
    }

    /// Errors with a part in common, such as the drift of a ramp that the model lacks, are few whatever their number.
    #[test]
    fn correlated_pieces_count_as_few() {
        let pieces = |errors: &[f64]| -> f64 {
            let predicted = Predicted { mean: 0.0, sd: 1.0, band95: 2.0 };
            let piece =
                |(begin, error): (usize, &f64)| Piece { begin, length: 1, run: [0; 2], error: *error, predicted };
            let all: Vec<Piece> = errors.iter().enumerate().map(piece).collect();
            independent(&all.iter().collect::<Vec<&Piece>>())
        };
        for count in [5, 6, 12, 40] {
            assert_eq!(pieces(&vec![3.0; count]), 1.0, "{count} alike");
        }
        let mut state = 1_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        // The average over rows, since a row of a few errors shows its correlation badly.
        let mut average = |count: usize, common: f64, next: f64| -> f64 {
            let rows = 200;
            let of_row = |_| {
                let (own, mut before) = (uniform(), uniform());
                let errors: Vec<f64> = (0..count)
                    .map(|_| {
                        before = next * before + (1.0 - next * next).sqrt() * uniform();
                        common.sqrt() * own + (1.0 - common).sqrt() * before
                    })
                    .collect();
                pieces(&errors)
            };
            (0..rows).map(of_row).sum::<f64>() / f64::from(rows)
        };
        assert!(average(40, 0.0, 0.0) > 30.0 && average(12, 0.0, 0.0) > 7.0);
        assert!(average(40, 0.9, 0.0) < 8.0 && average(12, 0.9, 0.0) < 4.0);
        assert!(average(40, 0.0, 0.8) < 14.0);
    }
}
