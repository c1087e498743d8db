//! Validation sheet: the error of a sensor model's predictions in physical units, and the envelope of the data that shows it.
//!
//! In: a model, recordings at rest with what is known about them, a request, limits. Out: for each quantity and horizon the
//! comparison error E = S − D with its uncertainty, split into bias and scatter; verdicts; what the data cover and what they do not.
//! Pure.
//!
//! After ASME V&V 20-2009: D is what the recordings show, S what the model predicts for the same pieces, E = S − D, and
//! `u_val`² = `u_d`² + `u_input`² its standard uncertainty. The closed forms' own error of 10⁻⁵ does not count. If 0 is inside the
//! interval, the model's error is too small to be seen in these data.
//!
//! The pieces of all recordings count together: E is about these recordings. How far D scatters by chance is that of simulated records
//! with the same pieces (`chance`), so that overlaps and common parts of the errors count as the model has them.

mod chance;
mod compare;
mod envelope;
#[cfg(test)]
mod tests;

pub use envelope::{Covered, Envelope};

use crate::USED;
use crate::measured::LEAST_PIECES;
use crate::pieces::{MeasureError, Piece, Rest, disjoint, pieces};
use crate::request::{Quantity, Request, Setting};
use chance::simulated;
use compare::{Compared, Inputs};
use imu_model::motion::Temperatures;
use imu_model::simulator::SensorModel;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF as _, StudentsT};
use std::collections::BTreeMap;

/// Data that would not show an error of this share of the prediction do not validate it.
const HIDDEN_MAX: f64 = 0.5;
/// The format's name; a change that old readers would misread gets a new number.
pub const SHEET_FORMAT: &str = "vn100d-validation-1";

/// A recording at rest, and what is known about it.
#[derive(Debug, Clone)]
pub struct Evidence<'a> {
    /// Its name.
    pub name: String,
    /// Its samples.
    pub rest: Rest<'a>,
    /// Time from switch-on to its first sample, s.
    pub begin_s: f64,
    /// Its temperature from switch-on on, if it was measured.
    pub temperature: Option<Temperatures>,
    /// The least and the largest temperature that was measured, °C.
    pub temperature_c: Option<[f64; 2]>,
    /// The unit, such as its serial number, if it is known.
    pub unit: Option<String>,
    /// The date on which it was recorded, if it is known.
    pub date: Option<String>,
    /// Whether the model was fitted to it.
    pub is_source: bool,
}

/// A validation sheet.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sheet {
    /// [`SHEET_FORMAT`].
    pub format: &'static str,
    /// The model, as the caller names it.
    pub model: String,
    /// Time of the alignment, s.
    pub align_s: f64,
    /// Times since the alignment's end, s, increasing.
    pub horizons_s: Vec<f64>,
    /// What the recordings cover.
    pub envelope: Envelope,
    /// The comparisons of each quantity, one per horizon; null if there are fewer than five disjoint pieces.
    pub quantities: BTreeMap<Quantity, Vec<Option<Comparison>>>,
    /// The verdicts on the requested limits.
    pub limits: Vec<LimitVerdict>,
    /// The verdict on the whole.
    pub verdict: SheetVerdict,
    /// Why, one sentence.
    pub reason: String,
    /// Where the model has not been validated, one sentence each.
    pub not_validated: Vec<String>,
    /// What a reader has to know, one sentence each.
    pub notes: Vec<String>,
}

/// An error of the model with its uncertainty, in the quantity's unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ModelError {
    /// S, what the model predicts.
    pub predicted: f64,
    /// D, what the recordings show.
    pub measured: f64,
    /// E = S − D.
    pub error: f64,
    /// The standard uncertainty of E, of the data and of the intervals that the model states.
    pub u_val: f64,
    /// The 95 % interval of E.
    pub ci95: [f64; 2],
    /// E in standard uncertainties, of that side of the interval that 0 is on.
    #[serde(skip)]
    pub standardized: f64,
}

impl ModelError {
    /// Returns whether 0 is inside the interval.
    pub fn agrees(&self) -> bool {
        self.ci95[0] <= 0.0 && 0.0 <= self.ci95[1]
    }
}

/// The comparison of model and recordings for one quantity and horizon.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The number of pieces, which overlap.
    pub pieces: usize,
    /// The number of independent ones.
    pub independent: f64,
    /// Of the root mean square of the errors.
    pub rms: ModelError,
    /// Of their mean: the bias of the model.
    pub bias: ModelError,
    /// Of their standard deviation about the predicted course: the scatter of the model.
    pub scatter: ModelError,
    /// bias²/(bias² + scatter²), Theil's bias proportion; null if both errors are 0.
    pub bias_proportion: Option<f64>,
    /// Share of the pieces whose error is inside the model's 95 % band.
    pub coverage: f64,
    /// The 95 % interval of that share.
    pub coverage_ci95: [f64; 2],
    /// The least and the largest ratio of a recording's root mean square to the predicted one, if recordings differ by more than chance
    /// makes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recordings_differ: Option<[f64; 2]>,
}

/// The verdict on a limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LimitState {
    /// The whole interval of E is inside the limit.
    Met,
    /// The whole interval is outside.
    Missed,
    /// The interval contains the limit, or there is no number: the data do not decide.
    Undecided,
}

/// The verdict on one limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LimitVerdict {
    /// The quantity.
    pub quantity: Quantity,
    /// Time since the alignment's end, s.
    pub horizon_s: f64,
    /// The largest allowed size of E of the root mean square, in the quantity's unit.
    pub limit: f64,
    /// E and its interval; null if there are too few pieces.
    pub error: Option<ModelError>,
    /// The verdict.
    pub state: LimitState,
}

/// The verdict on the whole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, strum::Display)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum SheetVerdict {
    /// The limits are met, or without limits no error is seen, inside the envelope.
    Validated,
    /// A limit is missed, or without limits an error is seen.
    NotValid,
    /// The data do not decide, or the model was fitted to them.
    Undecided,
}

/// Compares a model, which the sheet calls `name`, with recordings at rest. The request's limits count for the size of E of the root
/// mean square. Its `begin_s` and `temperature` do not count, since each recording has its own, nor does its motion.
///
/// # Errors
/// [`MeasureError`] with the first recording that has another rate or none of the channels, if all together have too few pieces, or for
/// a request that makes no sense.
///
/// # Source
/// ASME V&V 20-2009, sections 1 and 2 (E, `u_val`); Theil 1966, Applied Economic Forecasting, chapter 2 (proportions); NASA-STD-7009A,
/// section 4.4 (what a report has to state).
///
/// # Validation
/// `a_true_model_is_validated_as_often_as_stated`, `a_wrong_model_is_not_valid`.
pub fn sheet(
    model: &SensorModel,
    name: &str,
    evidence: &[Evidence<'_>],
    request: &Request,
) -> Result<Sheet, MeasureError> {
    // The order is checked before the limits' horizons are added.
    Setting::new(&Request { tolerances: Vec::new(), ..request.clone() }, model)?;
    let mut horizons_s = request.horizons_s.clone();
    let samples = |time_s: f64| (time_s * model.rate_hz).round();
    for limit in &request.tolerances {
        // Times of one sample are one horizon.
        if !horizons_s.iter().any(|own| samples(*own) == samples(limit.horizon_s)) {
            horizons_s.push(limit.horizon_s);
        }
    }
    horizons_s.sort_by(f64::total_cmp);
    horizons_s.dedup();
    let own = |of: &Evidence<'_>| Request {
        begin_s: of.begin_s,
        horizons_s: horizons_s.clone(),
        temperature: of.temperature.clone(),
        motion: None,
        ..request.clone()
    };
    let (mut all, mut notes): (BTreeMap<Quantity, Vec<Vec<Piece>>>, Vec<String>) = Default::default();
    let (mut lengths, mut covered, mut remarks) = (Vec::new(), Vec::new(), Vec::new());
    let mut counting: Vec<&Evidence<'_>> = Vec::new();
    let requests: Vec<(&Evidence<'_>, Request)> = evidence.iter().map(|of| (of, own(of))).collect();
    for (number, (of, request)) in requests.iter().enumerate() {
        let least = if evidence.len() == 1 { LEAST_PIECES } else { 0 };
        let found = pieces(&of.rest, number, model, request, least, false).map_err(|error| match error {
            MeasureError::Cost(error) => MeasureError::Cost(error),
            error if evidence.len() > 1 => MeasureError::Of { recording: of.name.clone(), error: Box::new(error) },
            error => error,
        })?;
        // A recording without a piece shows nothing, whatever its unit or temperature.
        match found.pieces.values().flatten().any(|pieces| !pieces.is_empty()) {
            true => {
                covered.push(Covered::by(of, found.length_s));
                counting.push(of);
            }
            false => notes.push(format!("{} has no piece, and does not count", of.name)),
        }
        for (quantity, pieces) in found.pieces {
            let pooled = all.entry(quantity).or_insert_with(|| vec![Vec::new(); pieces.len()]);
            pooled.iter_mut().zip(pieces).for_each(|(pooled, own)| pooled.extend(own));
        }
        lengths = found.lengths;
        remarks.push((of.name.clone(), found.notes));
    }
    notes.extend(once(&remarks));
    let inputs = requests.first().map(|(_, request)| Inputs::new(model, request)).transpose()?.flatten();
    let enough = |quantity: &Quantity| {
        let shortest = all.get(quantity).and_then(|of| of.first()).zip(lengths.first());
        shortest.map_or(0, |(pieces, length)| disjoint(pieces, *length).len())
    };
    let most = all.keys().map(enough).max().unwrap_or(0);
    if most < LEAST_PIECES {
        let shortest_s = lengths.first().copied().unwrap_or(0) as f64 / model.rate_hz;
        return Err(match all.is_empty() && !notes.is_empty() {
            true => MeasureError::NoPrediction { reason: notes.join("; ") },
            false => MeasureError::Few { found: most, least: LEAST_PIECES, length_s: shortest_s },
        });
    }
    let runs = simulated(model, &requests, &all)?.ok_or(MeasureError::Long)?;
    let compared = |(quantity, pooled): (&Quantity, &Vec<Vec<Piece>>)| {
        let of = |(at, pieces): (usize, &Vec<Piece>)| {
            let runs = runs.get(quantity).and_then(|of| of.get(at)).map_or(&[][..], Vec::as_slice);
            let (length, inputs) = (lengths[at], inputs.as_ref());
            Compared { pieces, length, quantity: *quantity, at, inputs, runs }.comparison()
        };
        (*quantity, pooled.iter().enumerate().map(of).collect())
    };
    let quantities: BTreeMap<Quantity, Vec<Option<Comparison>>> = all.iter().map(compared).collect();
    let differing: Vec<String> = quantities
        .iter()
        .filter_map(|(quantity, of)| {
            let [least, most] = of.iter().rev().flatten().find_map(|of| of.recordings_differ)?;
            Some(format!("{quantity} × {} to × {}", crate::number(least), crate::number(most)))
        })
        .collect();
    if !differing.is_empty() {
        notes.push(format!(
            "recordings differ among themselves by more than chance makes (measured over predicted: {}): the error of another one \
             may be larger than its interval here",
            differing.join(", ")
        ));
    }
    let found = |of: &crate::Tolerance| {
        let at = horizons_s.iter().position(|own| samples(*own) == samples(of.horizon_s))?;
        quantities.get(&of.quantity)?.get(at)?.as_ref()
    };
    let limits: Vec<LimitVerdict> = request.tolerances.iter().map(|of| LimitVerdict::on(of, found(of))).collect();
    let envelope = Envelope::of(&counting, covered);
    let mut not_validated = envelope.outside(model, &quantities, &horizons_s);
    not_validated.extend(inputs.iter().filter_map(|of| of.open(quantities.keys().copied())));
    if model.provenance.as_ref().is_some_and(|of| of.contains_key("capture")) {
        not_validated.push(
            "a recording that the model was fitted to under another name: it is recognised by its name alone"
                .to_owned(),
        );
    }
    let count = runs.values().flatten().map(Vec::len).max().unwrap_or(0);
    let (verdict, reason) = verdict(evidence, &quantities, &limits, count);
    Ok(Sheet {
        format: SHEET_FORMAT,
        model: name.to_owned(),
        align_s: request.align_s,
        horizons_s,
        envelope,
        quantities,
        limits,
        verdict,
        reason,
        not_validated,
        notes,
    })
}

/// Returns the notes of recordings, those of all once, the others with the recording's name.
fn once(remarks: &[(String, Vec<String>)]) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for (name, notes) in remarks {
        for note in notes {
            let is_of_all = remarks.iter().all(|(_, others)| others.contains(note));
            let note = if is_of_all { note.clone() } else { format!("{name}: {note}") };
            if !all.contains(&note) {
                all.push(note);
            }
        }
    }
    all
}

impl LimitVerdict {
    fn on(limit: &crate::Tolerance, found: Option<&Comparison>) -> Self {
        let inside = |end: f64| end.abs() <= limit.limit;
        let state = match found.map(|of| of.rms.ci95) {
            Some([low, high]) if inside(low) && inside(high) => LimitState::Met,
            Some([low, high]) if low > limit.limit || high < -limit.limit => LimitState::Missed,
            _ => LimitState::Undecided,
        };
        let crate::Tolerance { quantity, limit, horizon_s } = *limit;
        Self { quantity, horizon_s, limit, error: found.map(|of| of.rms), state }
    }
}

/// Returns the verdict on the whole and the reason.
fn verdict(
    evidence: &[Evidence<'_>],
    quantities: &BTreeMap<Quantity, Vec<Option<Comparison>>>,
    limits: &[LimitVerdict],
    runs: usize,
) -> (SheetVerdict, String) {
    if let Some(own) = evidence.iter().find(|of| of.is_source) {
        let reason = format!("the model was fitted to {}: expected recordings that it was not fitted to", own.name);
        return (SheetVerdict::Undecided, reason);
    }
    let count = |state: LimitState| limits.iter().filter(|of| of.state == state).count();
    let of_limits = |number: usize| format!("{number} of {} limits", limits.len());
    if !limits.is_empty() {
        return match (count(LimitState::Missed), count(LimitState::Undecided)) {
            (0, 0) => (SheetVerdict::Validated, "every limit is met inside the envelope below".to_owned()),
            (0, open) => (SheetVerdict::Undecided, format!("the data do not decide on {}", of_limits(open))),
            (missed, _) => (SheetVerdict::NotValid, format!("the model misses {}", of_limits(missed))),
        };
    }
    let all: Vec<&ModelError> =
        quantities.values().flatten().flatten().flat_map(|of| [&of.rms, &of.bias, &of.scatter]).collect();
    // All together miss 0 by chance in 5 % (Bonferroni).
    let freedom = runs.saturating_sub(1).max(1) as f64;
    let student = StudentsT::new(0.0, 1.0, freedom);
    let most = student.map_or(f64::INFINITY, |of| of.inverse_cdf(1.0 - 0.025 / all.len().max(1) as f64));
    let apart = all.iter().filter(|of| of.standardized.abs() > most).count();
    // The size of an error that the best horizon of a quantity would show, the largest of all quantities.
    let hidden = |of: &&Comparison| 0.5 * (of.rms.ci95[1] - of.rms.ci95[0]) / of.rms.predicted;
    let best = |of: &Vec<Option<Comparison>>| of.iter().flatten().map(|of| hidden(&of)).reduce(f64::min);
    let hidden = quantities.values().filter_map(best).fold(0.0, f64::max);
    match apart {
        _ if all.is_empty() => (SheetVerdict::Undecided, "no quantity has a comparison".to_owned()),
        0 => {
            let none = format!("none of {} errors of the model is beyond its uncertainty", all.len());
            let size =
                format!("an error of the predicted root mean square below {:.0} % would not be seen", 100.0 * hidden);
            let state = if hidden < HIDDEN_MAX { SheetVerdict::Validated } else { SheetVerdict::Undecided };
            (state, format!("{none}; {size}"))
        }
        _ => (
            SheetVerdict::NotValid,
            format!("{apart} of {} errors of the model are beyond their uncertainty", all.len()),
        ),
    }
}
