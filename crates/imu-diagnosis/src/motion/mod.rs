//! Diagnosis with a known motion: which of the effects that a motion drives a simulator lacks, beside those of a record at
//! rest. Pure.
//!
//! In: a [`Recording`], a [`Reference`] (the sensor's motion as another instrument measured it), a sensor model. Out:
//! the same report as that of a record at rest ([`super::diagnose`]), and the corrected model.
//!
//! 1. The reference is aligned in time and brought to the record's instants ([`align`]).
//! 2. Per triad, all candidates are fitted at once, by generalised least squares under the model's own noise
//!    ([`super::response`]), with additional columns for effects outside the library ([`groups`]).
//! 3. The subset is chosen that explains most nats less the prices of its effects ([`select`]). A price is the gain
//!    that as many numbers exceed by chance only in the permitted part of clean records, with all effects and triads
//!    counted.
//! 4. The samples less the mean response go to the diagnosis of records at rest: N, B, K, lines, drifts, filters. Its findings
//!    become the noise's law, the drift and the bandwidth of a second round. The rounds continue until no finding changes. Two
//!    rounds nearly always suffice, because mean and noise are orthogonal to first order: the Fisher information between them is
//!    0 for normal noise.
//! 5. Latencies are separated from the offset of the reference's clock, as far as two triads allow it ([`lateness`]).
//! 6. Named effects are scored on held-out blocks of time and ranked with those that were found in the noise
//!    ([`compose`]).

mod align;
mod compose;
mod felt;
mod groups;
mod lateness;
mod noise;
mod places;
mod posed;
mod poses;
mod quasi_static;
mod reference;
mod residuals;
mod rests;
#[cfg(test)]
mod round_trip;
mod rounds;
mod rows;
mod select;
mod settle;
mod spoiled;
mod together;
mod tumble;

pub use posed::{CERTAIN, beside, diagnose_posed};
pub use reference::{Known, Reference, ReferenceError};
pub use residuals::Residuals;
pub use rows::{Rows, rows};
pub use spoiled::rows_in_range;
pub use tumble::diagnose_tumble;

use super::error::DiagnosisError;
use super::field;
use super::options::Options;
use super::outcome::Outcome;
use super::recording::Recording;
use imu_core::sample::Triad;
use imu_core::units::STANDARD_GRAVITY_M_S2;
use imu_model::motion::gravity;
use imu_model::simulator::SensorModel;

/// If a clock's offset is off by more than this many samples, the reference is aligned again.
const ALIGNED: f64 = 0.05;
pub(super) const FOLDS: usize = 8;

/// Compares a record with a model. It uses the reference if there is one, gravity if the sensor rests in several poses
/// or is turned slowly, and otherwise treats the record as one at rest. A disturbed magnetic field is reported in
/// addition.
///
/// # Errors
/// [`DiagnosisError`] if the inputs cannot be compared, or if the diagnosis was cancelled.
pub fn diagnose_any(
    real: &Recording,
    reference: Option<&Known>,
    sim: &SensorModel,
    options: &Options<'_>,
) -> Result<Outcome, DiagnosisError> {
    let mut outcome = match reference {
        Some(Known::Motion(reference)) => diagnose_moved(real, reference, sim, options),
        Some(Known::External(reference)) => diagnose_posed(real, reference, sim, options),
        None => diagnose_tumble(real, sim, options).unwrap_or_else(|| super::diagnose::diagnose(real, sim, options)),
    }?;
    outcome.diagnosis.notes.extend(field::disturbed(real).iter().map(field::Disturbed::sentence));
    Ok(outcome)
}

/// Compares a record of a known motion with a model.
///
/// # Errors
/// [`DiagnosisError`] if the inputs cannot be compared, or if the diagnosis was cancelled.
///
/// # Source
/// The effects' forms and the tests that excite them: IEEE Std 1293 (accelerometers), 1431 (Coriolis gyros), 952 (noise).
///
/// # Validation
/// `round_trip.rs`, and on sealed cases `vn100d trial --motion` (docs/validation.md).
pub fn diagnose_moved(
    real: &Recording,
    reference: &Reference,
    sim: &SensorModel,
    options: &Options<'_>,
) -> Result<Outcome, DiagnosisError> {
    super::prepare::comparable(real, sim)?;
    // A model of a sensor at rest has gravity as bias; a reference includes gravity.
    let mut held = sim.clone();
    let taken_out = gravity::take_out(&mut held, STANDARD_GRAVITY_M_S2);
    let given = sim;
    let sim = &held;
    let triads: Vec<Triad> = [Triad::Gyro, Triad::Accel]
        .into_iter()
        .filter(|triad| triad.channels().iter().all(|channel| sim.channels.contains_key(channel)))
        .collect();
    if triads.is_empty() {
        return Err(DiagnosisError::NotDriven);
    }
    let mut aligned = align::align(real, reference, sim, &triads)?;
    let mut part = real.part(aligned.from..aligned.from + aligned.motions.len());
    if !aligned.shared
        && let Some(lie) = rounds::refined(&part, &aligned, sim, &triads)?
    {
        aligned = align::at(real, reference, sim, lie)?;
        part = real.part(aligned.from..aligned.from + aligned.motions.len());
    }
    let mut found = rounds::run(&part, &aligned, sim, &triads, options)?;
    // The reference was aligned with the triad that determines the time best, which is the late one: a delay that all
    // triads share belongs to the clock. This holds for a small latency too. In that alignment, the other triad would
    // appear early.
    let latency_s = found.lateness.latencies.iter().map(|(of, _)| of.seconds).fold(f64::INFINITY, f64::min);
    let most_s = (ALIGNED / real.rate_hz).min(0.1 * latency_s);
    if let Some(offset_s) = found.lateness.offset_s.filter(|of| !aligned.shared && of.abs() > most_s) {
        let begins_s = aligned.begins_s - offset_s;
        aligned = align::at(real, reference, sim, align::Lie { begins_s, gains: aligned.gains, shared: false })?;
        part = real.part(aligned.from..aligned.from + aligned.motions.len());
        found = rounds::run(&part, &aligned, sim, &triads, options)?;
    }
    let mut outcome = compose::outcome(&found, real, &part, &aligned, sim, options);
    if taken_out.is_some() {
        outcome.diagnosis.notes.push(format!(
            "the model holds gravity as the accelerometer's bias: {STANDARD_GRAVITY_M_S2} m/s² were taken out of it along its own \
             direction, the motion brings its own"
        ));
        // The corrected model is one at rest, as the given model was, except for the found effects.
        for channel in Triad::Accel.channels() {
            if let (Some(of), Some(own)) = (outcome.augmented.channels.get_mut(&channel), given.channels.get(&channel))
            {
                of.bias = own.bias;
            }
        }
    }
    Ok(outcome)
}
