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

use crate::quadrature::scale;
use crate::request::{CostError, Quantity, Request};
use crate::sources::{ChannelSources, Law};
use crate::weights::{ORDERS, Strapdown};
use crate::{USED, cost};
use imu_core::sample::Channel;
use imu_model::EffectKind;
use imu_model::simulator::SensorModel;
use serde::Serialize;
use statrs::distribution::{Beta, ChiSquared, ContinuousCDF as _};
use std::collections::BTreeMap;

/// The least number of disjoint pieces from which anything is measured.
pub const LEAST_PIECES: usize = 5;
/// The most begins at which a law that changes with time is computed.
const BEGINS: usize = 48;
/// Pieces that begin within the length of one.
const OVERLAP: usize = 4;
/// Rates that differ by less are the same, as a share.
const SAME_RATE: f64 = 1e-2;

/// Samples of a sensor at rest on a regular grid.
#[derive(Debug, Clone, Default)]
pub struct Rest<'a> {
    /// Samples per second.
    pub rate_hz: f64,
    /// Each channel's values in its unit, all of one length; what is not finite is missing.
    pub channels: Vec<(Channel, &'a [f64])>,
    /// Whether each sample is missing; empty if none is.
    pub missing: &'a [bool],
}

/// The reason why nothing was measured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MeasureError {
    /// The recording has another rate than the model.
    #[error("the recording has {found_hz} Hz and the model {expected_hz} Hz: expected the same rate")]
    Rate {
        /// The recording's rate, Hz.
        found_hz: f64,
        /// The model's rate, Hz.
        expected_hz: f64,
    },
    /// No quantity of the model has its channels in the recording.
    #[error("the recording lacks the channels of every quantity of the model: expected some of {expected}")]
    NoChannel {
        /// The channels.
        expected: String,
    },
    /// There are too few pieces.
    #[error(
        "the recording has {found} disjoint pieces of {length_s} s (alignment and shortest horizon) without a gap: expected at \
         least {LEAST_PIECES}, thus a longer recording, a shorter alignment or shorter horizons"
    )]
    Few {
        /// The number of pieces.
        found: usize,
        /// Their length, s.
        length_s: f64,
    },
    /// The model's bands cannot be computed.
    #[error(transparent)]
    Cost(#[from] CostError),
}

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

/// The model's mean square and 95 % band, by quantity and horizon.
type Predicted = BTreeMap<Quantity, Vec<(f64, f64)>>;

/// Measures the error growth in pieces of a recording, which the result calls `real`, and compares it with a model's.
/// Limits of the request are ignored.
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
    if (record.rate_hz / model.rate_hz - 1.0).abs() > SAME_RATE {
        return Err(MeasureError::Rate { found_hz: record.rate_hz, expected_hz: model.rate_hz });
    }
    let request = Request { tolerances: Vec::new(), ..request.clone() };
    let setting = crate::request::Setting::new(&request, model)?;
    let align = setting.align as usize;
    let horizons: Vec<usize> = request.horizons_s.iter().map(|of| (of * model.rate_hz).round() as usize).collect();
    let quantities: Vec<Quantity> = Quantity::all().iter().copied().filter(|of| has(record, model, *of)).collect();
    if quantities.is_empty() {
        let expected = USED.map(|channel| channel.to_string()).join(", ");
        return Err(MeasureError::NoChannel { expected });
    }
    let runs: Vec<(Quantity, Vec<[usize; 2]>)> = quantities.iter().map(|of| (*of, runs(record, *of))).collect();
    let disjoint =
        |runs: &[[usize; 2]], length: usize| runs.iter().map(|[from, to]| (to - from) / length).sum::<usize>();
    let shortest = align + horizons[0];
    let most = runs.iter().map(|(_, of)| disjoint(of, shortest)).max().unwrap_or(0);
    if most < LEAST_PIECES {
        return Err(MeasureError::Few { found: most, length_s: shortest as f64 / model.rate_hz });
    }
    let is_moving = changes(model, setting.temperature_is_constant);
    // What changes with time is not simulated: each begin would need its own runs.
    let request = Request { simulate: request.simulate && !is_moving, ..request };
    let last = runs.iter().flat_map(|(_, of)| of.iter().map(|[_, to]| *to)).max().unwrap_or(0);
    let begins = begins(is_moving, last, shortest);
    let mut predictions = Vec::with_capacity(begins.len());
    let mut notes: Vec<String> = Vec::new();
    let mut note = |text: String| {
        if !notes.contains(&text) {
            notes.push(text);
        }
    };
    // The band at the upper end of K is not compared.
    let bare = SensorModel { provenance: None, ..model.clone() };
    for begin in &begins {
        let fitting = horizons.iter().filter(|horizon| !is_moving || begin + align + *horizon <= last).count();
        let horizons_s = request.horizons_s[..fitting].to_vec();
        let begin_s = request.begin_s + *begin as f64 / model.rate_hz;
        let found = match cost(&bare, real, &Request { begin_s, horizons_s, ..request.clone() }) {
            Ok(found) => found,
            Err(error @ CostError::NoClosedForm { .. }) => {
                note(format!("no band of pieces that begin at {begin_s:.0} s: {error}"));
                predictions.push(Predicted::new());
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        let square = |growth: &crate::Growth| {
            let moments = growth.mean.iter().zip(&growth.sd).map(|(mean, sd)| mean * mean + sd * sd);
            moments.zip(growth.band95.iter().copied()).collect()
        };
        predictions.push(found.quantities.iter().map(|(of, growth)| (*of, square(growth))).collect::<Predicted>());
        found.notes.into_iter().for_each(&mut note);
    }
    if is_moving {
        notes.push(format!(
            "the model changes with time: pieces begin at {} places, each with its own band",
            begins.len()
        ));
    }
    let place = Place { record, align, horizons: &horizons, begins: &begins, is_moving, predictions: &predictions };
    let mut found = BTreeMap::new();
    for (quantity, runs) in &runs {
        if predictions.iter().any(|of| of.contains_key(quantity)) {
            let pieces = (0..horizons.len()).map(|at| {
                let enough = disjoint(runs, align + horizons[at]) >= LEAST_PIECES;
                enough.then(|| place.pieces(*quantity, runs, at)).flatten()
            });
            found.insert(*quantity, Growing { unit: quantity.unit(), pieces: pieces.collect() });
        }
    }
    let there = (0..record.channels.first().map_or(0, |(_, values)| values.len())).filter(|k| !is_missing(record, *k));
    let length_s = there.count() as f64 / record.rate_hz;
    Ok(Measured { real: real.to_owned(), length_s, horizons_s: request.horizons_s, quantities: found, notes })
}

fn is_missing(record: &Rest<'_>, place: usize) -> bool {
    record.missing.get(place).copied().unwrap_or(false)
}

fn values<'a>(record: &Rest<'a>, channel: Channel) -> Option<&'a [f64]> {
    record.channels.iter().find(|(own, _)| *own == channel).map(|(_, values)| *values)
}

/// Returns whether recording and model both have a quantity's own channel, and both or neither the gyroscope's.
fn has(record: &Rest<'_>, model: &SensorModel, quantity: Quantity) -> bool {
    let both = |channel| [model.channels.contains_key(&channel), values(record, channel).is_some()];
    let shares = quantity.shares();
    let mut all = shares.iter().map(|share| both(share.channel));
    all.next() == Some([true, true]) && all.all(|[one, other]| one == other)
}

/// Returns the ranges of places at which all channels of a quantity have a value.
fn runs(record: &Rest<'_>, quantity: Quantity) -> Vec<[usize; 2]> {
    let columns: Vec<&[f64]> = quantity.shares().iter().filter_map(|share| values(record, share.channel)).collect();
    let length = columns.iter().map(|of| of.len()).min().unwrap_or(0);
    let is_there = |place: usize| !is_missing(record, place) && columns.iter().all(|of| of[place].is_finite());
    let mut runs: Vec<[usize; 2]> = Vec::new();
    for place in (0..length).filter(|place| is_there(*place)) {
        match runs.last_mut() {
            Some(last) if last[1] == place => last[1] += 1,
            _ => runs.push([place, place + 1]),
        }
    }
    runs
}

/// Returns whether the law of a model's errors changes with time. A ramp moves the bias alike at any time.
fn changes(model: &SensorModel, temperature_is_constant: bool) -> bool {
    let sources = USED.into_iter().filter_map(|channel| ChannelSources::new(model, channel));
    let mut all = sources.flat_map(|of| of.sources);
    all.any(|source| match source.law {
        Law::Stationary => false,
        // Stays at given times, or a level over time.
        Law::Simulated => source.effect.parameters().iter().any(|(name, _)| ["intervals", "level"].contains(name)),
        Law::Modulated(_) | Law::Gated { .. } => true,
        Law::Course => match source.effect.kind() {
            EffectKind::RateRamp => false,
            EffectKind::TemperatureBias => !temperature_is_constant,
            _ => true,
        },
    })
}

/// Returns the places at which a prediction is computed: the first, or some over the record.
fn begins(is_moving: bool, last: usize, shortest: usize) -> Vec<usize> {
    if !is_moving {
        return vec![0];
    }
    let room = last.saturating_sub(shortest);
    let count = BEGINS.min(OVERLAP * room / shortest + 1);
    let mut begins: Vec<usize> = (0..count).map(|k| k * room / (count - 1).max(1)).collect();
    begins.dedup();
    begins
}

/// What the pieces of all horizons share.
struct Place<'a> {
    record: &'a Rest<'a>,
    align: usize,
    horizons: &'a [usize],
    begins: &'a [usize],
    is_moving: bool,
    predictions: &'a [Predicted],
}

/// One piece: its begin, run and error, and the model's mean square and band.
struct Piece {
    begin: usize,
    run: usize,
    error: f64,
    predicted: (f64, f64),
}

impl Place<'_> {
    /// Returns what the pieces of the horizon `at` show; `None` if the model's begins leave too few.
    fn pieces(&self, quantity: Quantity, runs: &[[usize; 2]], at: usize) -> Option<Pieces> {
        let length = self.align + self.horizons[at];
        let mut all: Vec<Piece> = Vec::new();
        for (run, [from, to]) in runs.iter().enumerate() {
            let add = |(begin, prediction): (usize, &Predicted)| {
                let predicted = *prediction.get(&quantity)?.get(at)?;
                Some(Piece {
                    begin,
                    run,
                    error: piece_error(self.record, quantity, begin, self.align, self.horizons[at]),
                    predicted,
                })
            };
            if self.is_moving {
                let own = self.begins.iter().copied().zip(self.predictions);
                all.extend(own.filter(|(begin, _)| begin >= from && begin + length <= *to).filter_map(add));
            } else {
                let last = (to - from).checked_sub(length).map(|room| from + room);
                let begins = last.into_iter().flat_map(|last| (*from..=last).step_by((length / OVERLAP).max(1)));
                all.extend(begins.filter_map(|begin| add((begin, self.predictions.first()?))));
            }
        }
        summary(&all, length)
    }
}

/// Returns a quantity's error, in its unit, after `align` and `horizon` samples from the sample `begin` on. Samples beyond the
/// record's end count as absent, and the integral then ends before.
pub fn piece_error(record: &Rest<'_>, quantity: Quantity, begin: usize, align: usize, horizon: usize) -> f64 {
    let part = |share: &crate::request::Share| {
        let all = values(record, share.channel).and_then(|of| of.get(begin..)).unwrap_or_default();
        let mut strapdown = Strapdown::new(align as u64);
        let own = all.iter().take(align + horizon);
        let state = own.fold([0.0; ORDERS], |_, value| strapdown.push(*value));
        share.factor * state[share.order - 1] * scale(share.order, record.rate_hz)
    };
    quantity.shares().iter().map(part).sum()
}

/// Summarises pieces of one length; `None` if fewer than [`LEAST_PIECES`] are disjoint.
fn summary(all: &[Piece], length: usize) -> Option<Pieces> {
    let mut disjoint: Vec<&Piece> = Vec::new();
    for piece in all {
        if disjoint.last().is_none_or(|last| last.run != piece.run || piece.begin >= last.begin + length) {
            disjoint.push(piece);
        }
    }
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
    let inside = all.iter().filter(|piece| piece.error.abs() <= piece.predicted.1).count() as f64;
    let coverage = inside / count;
    let predicted = all.iter().map(|piece| piece.predicted.0).sum::<f64>() / count;
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

/// Returns how many independent errors give as good a mean square. The errors of successive disjoint pieces may be correlated, and
/// all may have a part in common, such as the drift of a ramp. Both correlations are estimated with the bias that a short row has,
/// and the smaller number counts.
fn independent(disjoint: &[&Piece]) -> f64 {
    let count = disjoint.len() as f64;
    let square = disjoint.iter().map(|piece| piece.error.powi(2)).sum::<f64>() / count;
    if square <= 0.0 {
        return count;
    }
    let pairs = disjoint.iter().zip(&disjoint[1..]).filter(|(one, other)| one.run == other.run);
    let (number, sum): (f64, f64) =
        pairs.fold((0.0, 0.0), |(number, sum), (one, other)| (number + 1.0, sum + one.error * other.error));
    // A half standard error on top: of few pieces the correlation itself is hardly known.
    let next = (sum / (number.max(1.0) * square) + 0.5 / count.sqrt()).clamp(0.0, 0.999);
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
mod tests {
    use super::*;
    use imu_model::simulator::Simulator;

    fn model(channels: &str) -> SensorModel {
        let text =
            format!(r#"{{"format": "vn100d-sensor-model-1", "name": "t", "rate_hz": 20, "channels": {{{channels}}}}}"#);
        SensorModel::from_json(&text, "t.json").unwrap()
    }

    fn simulated(model: &SensorModel, seed: u64, length_s: f64) -> Vec<(Channel, Vec<f64>)> {
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
            let piece = |(begin, error): (usize, &f64)| Piece { begin, run: 0, error: *error, predicted: (1.0, 2.0) };
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
