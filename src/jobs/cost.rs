//! Cost: what a gap does to unaided integration, as part of a diagnosis; and recordings at rest to measure it in.
//!
//! A diagnosis carries the 95 % bands of the model, of the corrected model, and of the corrected model without the causes,
//! at three horizons at most, which the record limits. Nothing is simulated: what has no closed form is left out, and a note
//! states it.

use super::motion::at_rest;
use super::{Gridded, JobError, Plan, SampleSource, gridded};
use imu_core::units::format_duration;
use imu_cost::{
    Corners, Cost, CostError, Growing, LEAST_PIECES, MeasureError, Pieces, Quantity, Request, Rest, cost, measured_both,
};
use imu_diagnosis::report::{Bands, Cause, CauseCost, GapCost, MeasuredGrowth, MeasuredPieces, Sense};
use imu_diagnosis::{Outcome, Recording, Verdict};
use imu_model::effects::Effect;
use imu_model::motion::Temperatures;
use imu_model::simulator::SensorModel;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// Horizons of a diagnosis, s; the last three that the record allows.
const HORIZONS_S: [f64; 5] = [1.0, 10.0, 60.0, 600.0, 3600.0];
const HORIZONS: usize = 3;
/// Horizons at which the growth of errors is measured in pieces of the recording, s.
const MEASURED_S: [f64; 12] = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 120.0, 300.0, 600.0, 1800.0, 3600.0];
const ALIGN_S: f64 = 30.0;
/// The most samples of alignment and horizon: 10 min at 800 Hz. Courses are run sample by sample.
const SAMPLES_MAX: f64 = 6e5;
/// The most samples of a record whose pieces are measured: a day at 800 Hz.
const RECORD_MAX: f64 = 7e7;
/// Bands that differ by less are not worth a sentence, as the logarithm of their ratio.
const MATERIAL: f64 = 0.05;
/// A size without an interval matters from this share of the mean square error on; a cause is named from it on.
const MATTERS: f64 = 0.05;

/// Returns the samples of a recording, as the measurement of its error growth takes them.
pub fn rest(recording: &Recording) -> Rest<'_> {
    let channels = recording.channels.iter().map(|(channel, values)| (*channel, values.as_slice())).collect();
    Rest { rate_hz: recording.rate_hz, channels, missing: &recording.missing }
}

/// Returns the temperature of a recording that begins at `begin_s`, if it was measured.
pub fn temperatures(recording: &Recording, begin_s: f64) -> Option<Temperatures> {
    let course = Temperatures::of_samples(recording.temperature_c.as_ref()?, recording.rate_hz)?;
    Some(course.delayed(begin_s))
}

/// Effects of a model whose cost is computed while a request waits, and as a part of a diagnosis.
pub const EFFECTS_MAX: usize = 40;
const EFFECTS_MAX_OF_DIAGNOSIS: usize = 120;

/// Refuses a model whose cost would take too long beside other work.
///
/// # Errors
/// [`CostError::Size`] with the numbers.
pub fn check_size(model: &SensorModel, effects_max: usize) -> Result<(), CostError> {
    const LINES_PER_EFFECT: usize = 5;
    let lines_max = LINES_PER_EFFECT * effects_max;
    let effects = || model.channels.values().flat_map(|of| &of.effects);
    let lists = |effect: &Arc<dyn Effect>| {
        let mut parameters = effect.parameters().into_iter();
        let lines = parameters.find(|(name, _)| *name == "amplitudes").map(|(_, value)| value);
        lines.and_then(|of| of.as_array().map(Vec::len)).unwrap_or(1)
    };
    let (found, lines) = (effects().count(), effects().map(lists).sum::<usize>());
    match found > effects_max || lines > lines_max {
        true => Err(CostError::Size { found, lines, effects_max, lines_max }),
        false => Ok(()),
    }
}

/// Reads the longest part of a plan's samples at rest ([`gridded`]).
///
/// # Errors
/// [`JobError::InsufficientData`] if nothing is at rest, or the error that `source` reports.
pub fn resting(source: &dyn SampleSource, plan: Plan) -> Result<Gridded, JobError> {
    let plan = at_rest(source, plan, false, || Ok(()))?.plan;
    if !plan.has_rest() {
        let reason = "the sensor moved all the time: expected a recording at rest".to_owned();
        return Err(JobError::InsufficientData(reason));
    }
    gridded(source, &plan, u64::MAX)
}

/// Adds the cost to a diagnosis of a record at rest: to the gap, to each cause, and to the summary.
pub fn add_cost(outcome: &mut Outcome, recording: &Recording, sim: &SensorModel) {
    if !outcome.residuals.is_empty() {
        return;
    }
    let fits = |horizon_s: &f64| {
        let long_s = ALIGN_S + horizon_s;
        long_s <= recording.length_s() && long_s * sim.internal_rate_hz(sim.rate_hz) <= SAMPLES_MAX
    };
    let horizons_s: Vec<f64> = HORIZONS_S.into_iter().filter(fits).collect();
    let horizons_s = horizons_s[horizons_s.len().saturating_sub(HORIZONS)..].to_vec();
    if horizons_s.is_empty() {
        return;
    }
    for model in [sim, &outcome.augmented] {
        if let Err(error) = check_size(model, EFFECTS_MAX_OF_DIAGNOSIS) {
            outcome.diagnosis.notes.push(format!("the cost of the gap was not computed: {error}"));
            return;
        }
    }
    let temperature = temperatures(recording, 0.0);
    let request = Request { align_s: ALIGN_S, horizons_s, temperature, simulate: false, ..Request::default() };
    let of = |model: &SensorModel| cost(model, &model.name, &request);
    let (before, after) = match (of(sim), of(&outcome.augmented)) {
        (Ok(before), Ok(after)) => (before, after),
        (Err(CostError::NoChannel { .. }), _) | (_, Err(CostError::NoChannel { .. })) => return,
        (Err(error), _) | (_, Err(error)) => {
            outcome.diagnosis.notes.push(format!("the cost of the gap was not computed: {error}"));
            return;
        }
    };
    let own = without_effects(outcome, sim, &|_, _| true);
    let floor = match of(&own) {
        Ok(floor) => floor,
        Err(error) => {
            outcome.diagnosis.notes.push(format!("the cost of the gap was not computed: {error}"));
            return;
        }
    };
    let ends = [&outcome.augmented, &own].map(|model| Corners::new(model, Some(sim), &request));
    let interval =
        |of: &Corners, central: &Cost, quantity| of.ends(central, quantity, MATTERS, |growth, at| growth.band95[at]);
    let [after_ends, floor_ends] = &ends;
    let bands = |quantity: Quantity| {
        let band = |of: &Cost| of.quantities.get(&quantity).map(|growth| growth.band95.clone());
        Some(Bands {
            unit: quantity.unit().into(),
            before: band(&before)?,
            after: band(&after)?,
            after_ci95: interval(after_ends, &after, quantity),
            floor: band(&floor)?,
            floor_ci95: interval(floor_ends, &floor, quantity),
        })
        // A document holds no other numbers.
        .filter(|of| [&of.before, &of.after, &of.floor].into_iter().flatten().all(|band| band.is_finite()))
    };
    let all = Quantity::all().iter().filter_map(|of| Some((of.to_string(), bands(*of)?)));
    let mut notes = after.notes.clone();
    notes.extend(before.notes.iter().filter(|note| !after.notes.contains(note)).cloned());
    let measured = measured_growth(recording, sim, &outcome.augmented, &request).unwrap_or_else(|error| {
        outcome.diagnosis.notes.push(format!("the growth of errors was not measured in pieces: {error}"));
        None
    });
    let found = GapCost {
        align_s: ALIGN_S,
        horizons_s: request.horizons_s.clone(),
        quantities: all.collect(),
        notes,
        measured,
    };
    let causes: Vec<BTreeMap<String, CauseCost>> = outcome
        .diagnosis
        .causes
        .iter()
        .map(|cause| {
            if cause.sense == Sense::Superfluous {
                return share(cause, &before, None);
            }
            let is_it = |name: &str, channel: &str| {
                cause.effect.name() == name && cause.channels.iter().any(|of| of == channel)
            };
            share(cause, &after, of(&without_effects(outcome, sim, &is_it)).ok().as_ref())
        })
        .collect();
    for (cause, found) in outcome.diagnosis.causes.iter_mut().zip(causes) {
        cause.cost = found;
    }
    if let Some(words) = sentence(outcome, &found) {
        outcome.diagnosis.summary += &words;
    }
    outcome.diagnosis.discrepancy.cost = Some(found);
}

/// Measures the growth of errors in pieces of the recording, beside what the model and the corrected one predict; `None` if it is too
/// short for five disjoint pieces.
fn measured_growth(
    recording: &Recording,
    sim: &SensorModel,
    augmented: &SensorModel,
    request: &Request,
) -> Result<Option<MeasuredGrowth>, MeasureError> {
    // Courses of a model that changes with time are run from switch-on to every piece.
    if recording.length_s() * sim.internal_rate_hz(sim.rate_hz) > RECORD_MAX {
        return Err(MeasureError::Long);
    }
    let fits = |horizon_s: &f64| {
        let long_s = ALIGN_S + horizon_s;
        LEAST_PIECES as f64 * long_s <= recording.length_s()
            && long_s * sim.internal_rate_hz(sim.rate_hz) <= SAMPLES_MAX
    };
    let horizons_s: Vec<f64> = MEASURED_S.into_iter().filter(fits).collect();
    if horizons_s.is_empty() {
        return Ok(None);
    }
    let request = Request { horizons_s, ..request.clone() };
    let [before, after] = measured_both(&rest(recording), "the recording", [sim, augmented], &request)?;
    let both = |(one, other): (&Option<Pieces>, &Option<Pieces>)| {
        let (one, other) = (one.as_ref()?, other.as_ref()?);
        Some(MeasuredPieces {
            independent: other.independent,
            rms: other.rms,
            rms_ci95: other.rms_ci95,
            before_rms: one.predicted_rms,
            after_rms: other.predicted_rms,
            before_coverage: one.coverage,
            after_coverage: other.coverage,
            after_coverage_ci95: other.coverage_ci95,
        })
    };
    let quantity = |(quantity, own): (&Quantity, &Growing)| {
        let of_before = before.quantities.get(quantity)?;
        Some((quantity.to_string(), of_before.pieces.iter().zip(&own.pieces).map(both).collect()))
    };
    let quantities = after.quantities.iter().filter_map(quantity).collect();
    let mut notes = after.notes;
    notes.extend(before.notes.into_iter().filter(|note| !notes.contains(note)).collect::<Vec<_>>());
    Ok(Some(MeasuredGrowth { horizons_s: request.horizons_s, quantities, notes }))
}

/// Returns the corrected model without the effects of its causes that `is_meant` accepts by name and channel. Effects that the
/// original model states alike stay.
fn without_effects(outcome: &Outcome, sim: &SensorModel, is_meant: &dyn Fn(&str, &str) -> bool) -> SensorModel {
    let mut model = outcome.augmented.clone();
    for (channel, own) in &mut model.channels {
        let declared = sim.channels.get(channel);
        let is_cause = |name: &str| {
            let mut of_sensor = outcome.diagnosis.causes.iter().filter(|cause| cause.sense != Sense::Superfluous);
            of_sensor.any(|cause| cause.effect.name() == name && cause.channels.iter().any(|of| of == channel.name()))
        };
        for index in (0..own.effects.len()).rev() {
            let effect = &own.effects[index];
            let is_known = declared.is_some_and(|of| of.effects.contains(effect));
            if !is_known && is_cause(effect.name()) && is_meant(effect.name(), channel.name()) {
                own.remove_effect(index);
            }
        }
    }
    model
}

/// Returns a cause's part in a cost, by quantity; `bare` is the cost without the cause. Without it, a quantity on which the cause
/// acts through several channels is left out. If a channel has an effect of the same kind that is no cause, the share is of both.
fn share(cause: &Cause, under: &Cost, bare: Option<&Cost>) -> BTreeMap<String, CauseCost> {
    let is_own = |of: &&imu_cost::Cause| {
        of.cause == cause.effect.name() && cause.channels.iter().any(|channel| channel == of.channel.name())
    };
    let mut all = BTreeMap::new();
    for (quantity, growth) in &under.quantities {
        let own: Vec<&imu_cost::Cause> =
            under.causes.iter().filter(|of| of.quantity == *quantity).filter(is_own).collect();
        let share = |place: usize| own.iter().filter_map(|of| of.share.get(place)).sum::<f64>();
        let without = match (&own[..], bare) {
            ([], _) => continue,
            (_, Some(bare)) => bare.quantities.get(quantity).map(|growth| growth.band95.clone()),
            ([only], None) => Some(only.band95_without.clone()),
            _ => None,
        };
        let Some(band95_without) = without else { continue };
        let of = CauseCost { share: (0..growth.band95.len()).map(share).collect(), band95_without };
        if of.share.iter().chain(&of.band95_without).all(|value| value.is_finite()) {
            all.insert(quantity.to_string(), of);
        }
    }
    all
}

/// Returns the sentence on the quantity whose band differs most: of an angle if there is one, else of a position, else of a velocity.
fn sentence(outcome: &Outcome, found: &GapCost) -> Option<String> {
    if outcome.diagnosis.verdict == Verdict::NoGap {
        return None;
    }
    let last = |values: &[f64]| values.last().copied().unwrap_or_default();
    let differs = |unit: &str| {
        let of_unit = Quantity::all().iter().filter(|of| of.unit() == unit);
        let bands = of_unit.filter_map(|of| Some((*of, found.quantities.get(&of.to_string())?)));
        let pairs = bands.map(|(of, bands)| (of, last(&bands.before), last(&bands.after)));
        let apart = |(_, before, after): &(Quantity, f64, f64)| (after - before).abs() > MATERIAL * after.max(*before);
        let size = |of: &(Quantity, f64, f64)| (of.2 - of.1).abs();
        pairs.filter(apart).max_by(|one, other| size(one).total_cmp(&size(other)))
    };
    let (quantity, before, after) = ["rad", "m", "m/s"].into_iter().find_map(differs)?;
    let time = format_duration(Duration::from_secs_f64(last(&found.horizons_s)));
    let of_sensor = outcome.diagnosis.causes.iter().filter(|cause| cause.sense != Sense::Superfluous);
    let less = of_sensor.filter_map(|cause| {
        let own = cause.cost.get(&quantity.to_string())?;
        Some((cause.effect.name(), after - last(&own.band95_without), last(&own.share)))
    });
    let main = less.filter(|(_, less, share)| *less > 0.0 && *share > MATTERS).max_by(|a, b| a.1.total_cmp(&b.1));
    let main = main.map(|(name, less, _)| format!(" ({} of it: {name})", quantity.with_unit(less)));
    Some(format!(
        ". After {time} without aid, 95 % of the sensor's {quantity} errors are within {}{}; the model states {}",
        quantity.with_unit(after),
        main.unwrap_or_default(),
        quantity.with_unit(before)
    ))
}
