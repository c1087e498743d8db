//! Pieces: an alignment and a horizon of a recording at rest, each with the error of unaided integration at its end and what a
//! model predicts of it.
//!
//! In: samples on a regular grid, a model, a request. Out: the pieces of every quantity and horizon, and how many of them are
//! independent. Pure.
//!
//! A piece has no missing sample. Pieces begin a quarter of their length apart, which uses the record better.
//!
//! The recording's first sample is at the request's `begin_s` of the model's time. If the model's law changes with time (a warm-up,
//! a step, bursts), each piece has the prediction of its own begin, and there are at most 48 of them.

use crate::quadrature::scale;
use crate::request::{CostError, Quantity, Request};
use crate::sources::{ChannelSources, Law};
use crate::weights::{ORDERS, Strapdown};
use crate::{USED, cost};
use imu_core::sample::Channel;
use imu_model::EffectKind;
use imu_model::simulator::SensorModel;
use std::collections::BTreeMap;

/// The most begins at which a law that changes with time is computed.
pub(crate) const BEGINS: usize = 48;
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
        "the recording has {found} disjoint pieces of {} s (alignment and shortest horizon) without a gap: expected at \
         least {least}, thus a longer recording, a shorter alignment or shorter horizons",
        (length_s * 1e3).round() / 1e3
    )]
    Few {
        /// The number of pieces.
        found: usize,
        /// The number that is needed.
        least: usize,
        /// Their length, s.
        length_s: f64,
    },
    /// The simulations that show what chance makes would take too long.
    #[error("the recordings are too long to be simulated: expected a part of them, or fewer at once")]
    Long,
    /// The model predicts nothing that the recordings show.
    #[error("no quantity has a prediction for these recordings: {reason}")]
    NoPrediction {
        /// Why.
        reason: String,
    },
    /// A recording among several cannot be compared.
    #[error("{recording}: {error}")]
    Of {
        /// The recording.
        recording: String,
        /// The reason.
        #[source]
        error: Box<Self>,
    },
    /// The model's bands cannot be computed.
    #[error(transparent)]
    Cost(#[from] CostError),
}

/// What a model predicts of a piece's error, in the quantity's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Predicted {
    pub mean: f64,
    pub sd: f64,
    pub band95: f64,
}

impl Predicted {
    pub(crate) fn square(&self) -> f64 {
        self.mean * self.mean + self.sd * self.sd
    }
}

/// One piece: its begin, its recording and the range without a gap there, its error, and the model's prediction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Piece {
    pub begin: usize,
    /// Alignment and horizon, samples.
    pub length: usize,
    pub run: [usize; 2],
    pub error: f64,
    pub predicted: Predicted,
}

/// The pieces of a recording.
pub(crate) struct Found {
    /// Alignment and horizon, samples, one per horizon.
    pub lengths: Vec<usize>,
    /// By quantity, and then by horizon.
    pub pieces: BTreeMap<Quantity, Vec<Vec<Piece>>>,
    /// Time of the present samples, s.
    pub length_s: f64,
    pub notes: Vec<String>,
}

/// A model's predictions at one begin, by quantity and then by horizon.
type Predictions = BTreeMap<Quantity, Vec<Predicted>>;

/// Returns whether a model's predictions change with time, so that pieces begin at some places only.
pub(crate) fn has_begins(model: &SensorModel, request: &Request) -> Result<bool, CostError> {
    Ok(changes(model, crate::request::Setting::new(request, model)?.temperature_is_constant))
}

/// Returns the pieces of a recording, which has the number `number` among others. With `has_begins` they are those of a model that
/// changes with time. Limits and a motion of the request are ignored.
///
/// # Errors
/// [`MeasureError`] if rate or channels differ, if no quantity has `least` disjoint pieces of the shortest horizon, or for a request
/// that makes no sense.
pub(crate) fn pieces(
    record: &Rest<'_>,
    number: usize,
    model: &SensorModel,
    request: &Request,
    least: usize,
    has_begins: bool,
) -> Result<Found, MeasureError> {
    let apart = (record.rate_hz / model.rate_hz - 1.0).abs();
    if apart.is_nan() || apart > SAME_RATE {
        return Err(MeasureError::Rate { found_hz: record.rate_hz, expected_hz: model.rate_hz });
    }
    let request = Request { tolerances: Vec::new(), motion: None, ..request.clone() };
    let setting = crate::request::Setting::new(&request, model)?;
    let align = setting.align as usize;
    let horizons: Vec<usize> = request.horizons_s.iter().map(|of| (of * model.rate_hz).round() as usize).collect();
    let quantities: Vec<Quantity> = Quantity::all().iter().copied().filter(|of| has(record, model, *of)).collect();
    if quantities.is_empty() {
        let expected = USED.map(|channel| channel.to_string()).join(", ");
        return Err(MeasureError::NoChannel { expected });
    }
    let runs: Vec<(Quantity, Vec<[usize; 2]>)> = quantities.iter().map(|of| (*of, runs(record, *of))).collect();
    let shortest = align + horizons[0];
    let disjoint = |runs: &[[usize; 2]]| runs.iter().map(|[from, to]| (to - from) / shortest).sum::<usize>();
    let most = runs.iter().map(|(_, of)| disjoint(of)).max().unwrap_or(0);
    if most < least {
        return Err(MeasureError::Few { found: most, least, length_s: shortest as f64 / model.rate_hz });
    }
    let is_moving = has_begins || changes(model, setting.temperature_is_constant);
    let last = runs.iter().flat_map(|(_, of)| of.iter().map(|[_, to]| *to)).max().unwrap_or(0);
    let begins = begins(is_moving, last, shortest);
    let mut notes: Vec<String> = Vec::new();
    let predictions = predictions(&Laws { model, request: &request, is_moving, last }, &begins, &horizons, &mut notes)?;
    if is_moving && !notes.iter().any(|note| note.starts_with("the model changes")) {
        notes.push(format!(
            "the model changes with time: pieces begin at {} places, each with its own band",
            begins.len()
        ));
    }
    let place =
        Place { record, number, align, horizons: &horizons, begins: &begins, is_moving, predictions: &predictions };
    let is_predicted = |of: &Quantity| predictions.iter().any(|own| own.contains_key(of));
    let of_runs = |(quantity, runs): &(Quantity, Vec<[usize; 2]>)| {
        (*quantity, (0..horizons.len()).map(|at| place.pieces(*quantity, runs, at)).collect())
    };
    let pieces = runs.iter().filter(|(of, _)| is_predicted(of)).map(of_runs).collect();
    let there = (0..record.channels.first().map_or(0, |(_, values)| values.len())).filter(|k| !is_missing(record, *k));
    let length_s = there.count() as f64 / record.rate_hz;
    Ok(Found { lengths: horizons.iter().map(|horizon| align + horizon).collect(), pieces, length_s, notes })
}

/// A model and what is asked of it, for a recording whose last sample is before `last`.
struct Laws<'a> {
    model: &'a SensorModel,
    request: &'a Request,
    is_moving: bool,
    last: usize,
}

/// Returns the model's predictions at every begin, and adds what a reader has to know.
fn predictions(
    of: &Laws<'_>,
    begins: &[usize],
    horizons: &[usize],
    notes: &mut Vec<String>,
) -> Result<Vec<Predictions>, MeasureError> {
    let &Laws { model, request, is_moving, last } = of;
    let align = (request.align_s * model.rate_hz).round() as usize;
    // What changes with time is not simulated: each begin would need its own runs.
    let request = Request { simulate: request.simulate && !is_moving, ..request.clone() };
    // The band at the upper end of K is not compared.
    let bare = SensorModel { provenance: None, ..model.clone() };
    let mut note = |text: String| {
        if !notes.contains(&text) {
            notes.push(text);
        }
    };
    let mut all = Vec::with_capacity(begins.len());
    for begin in begins {
        let fitting = horizons.iter().filter(|horizon| !is_moving || begin + align + *horizon <= last).count();
        if fitting == 0 {
            all.push(Predictions::new());
            continue;
        }
        let horizons_s = request.horizons_s[..fitting].to_vec();
        let begin_s = request.begin_s + *begin as f64 / model.rate_hz;
        let found = match cost(&bare, &model.name, &Request { begin_s, horizons_s, ..request.clone() }) {
            Ok(found) => found,
            Err(error @ CostError::NoClosedForm { .. }) => {
                note(format!("no band of pieces that begin at {begin_s:.0} s: {error}"));
                all.push(Predictions::new());
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        let of_growth = |growth: &crate::Growth| {
            let moments = growth.mean.iter().zip(&growth.sd).zip(&growth.band95);
            moments.map(|((mean, sd), band95)| Predicted { mean: *mean, sd: *sd, band95: *band95 }).collect()
        };
        all.push(found.quantities.iter().map(|(of, growth)| (*of, of_growth(growth))).collect());
        found.notes.into_iter().for_each(&mut note);
    }
    Ok(all)
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
    number: usize,
    align: usize,
    horizons: &'a [usize],
    begins: &'a [usize],
    is_moving: bool,
    predictions: &'a [Predictions],
}

impl Place<'_> {
    /// Returns the pieces of the horizon `at`.
    fn pieces(&self, quantity: Quantity, runs: &[[usize; 2]], at: usize) -> Vec<Piece> {
        let length = self.align + self.horizons[at];
        let mut all: Vec<Piece> = Vec::new();
        for (run, [from, to]) in runs.iter().enumerate() {
            let add = |(begin, prediction): (usize, &Predictions)| {
                let predicted = *prediction.get(&quantity)?.get(at)?;
                let error = piece_error(self.record, quantity, begin, self.align, self.horizons[at]);
                Some(Piece { begin, length, run: [self.number, run], error, predicted })
            };
            if self.is_moving {
                let own = self.begins.iter().copied().zip(self.predictions);
                all.extend(own.filter(|(begin, _)| begin >= from && begin + length <= *to).filter_map(add));
            } else {
                let last = (to - from).checked_sub(length).map(|room| from + room);
                let places = (0..).map(|k| from + k * length.max(OVERLAP) / OVERLAP);
                let begins = last.into_iter().flat_map(|last| places.clone().take_while(move |begin| *begin <= last));
                all.extend(begins.filter_map(|begin| add((begin, self.predictions.first()?))));
            }
        }
        all
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

/// Returns pieces of one length that do not overlap.
pub(crate) fn disjoint(all: &[Piece], length: usize) -> Vec<&Piece> {
    let mut disjoint: Vec<&Piece> = Vec::new();
    for piece in all {
        if disjoint.last().is_none_or(|last| last.run != piece.run || piece.begin >= last.begin + length) {
            disjoint.push(piece);
        }
    }
    disjoint
}
