//! Cost: what the errors of a sensor model do to unaided strapdown integration at rest, in rad, m/s and m.
//!
//! In: a sensor model, an alignment, horizons, a temperature, limits. Out: mean, standard deviation and 95 % band of
//! attitude, velocity and position at each horizon, by cause, as the document `vn100d-cost-1`. Pure.
//!
//! The sensor is at rest and level, z up, and was switched on at t = −align. A bias calibration takes the mean of each
//! channel over the alignment, which ends at t = 0, and subtracts it. What is left is integrated:
//!
//! ```text
//! attitude θ = ∫ ω dt,   velocity_x = ∫ (a_x + g θ_y) dt,   velocity_y = ∫ (a_y − g θ_x) dt,   position = ∫ velocity dt
//! ```
//!
//! Every error is a linear functional of the samples (`weights`). Its variance is the integral of the density
//! times |W|² (`quadrature`), its mean the functional of the course (`courses`), its band follows from the
//! distribution (`band`). What has no closed form is simulated (`monte_carlo`).
//!
//! The ensemble: sensors of this model and nights with independent noise and phases. Courses that follow from time and
//! temperature are the same in each, and count in the mean.
//!
//! Along a motion ([`Along`]) truth and sensor are integrated by the full strapdown (`motion`).
//!
//! Not counted: the turn of the Earth, the coupling of vertical acceleration, and errors of second order (an angle that
//! is not small). A constant bias, magnetometers, pressure and stamps change nothing.
//!
//! # Example
//! ```
//! use imu_cost::{Quantity, Request, cost};
//! use imu_model::simulator::SensorModel;
//!
//! let model = SensorModel::from_json(
//!     r#"{"format": "vn100d-sensor-model-1", "name": "desk", "rate_hz": 40,
//!         "channels": {"gyro_z": {"N": 1e-4, "bias": 0.02}}}"#,
//!     "desk.json",
//! )?;
//! let request = Request { align_s: 30.0, horizons_s: vec![60.0], ..Request::default() };
//! let heading = &cost(&model, "desk.json", &request)?.quantities[&Quantity::Heading];
//! // Angle random walk, and the error of the calibration: N·√(t + t²/align).
//! assert!((heading.sd[0] / (1e-4 * (60.0_f64 + 60.0 * 60.0 / 30.0).sqrt()) - 1.0).abs() < 1e-6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod band;
mod channel;
mod compose;
mod corners;
mod courses;
mod document;
mod filter_parameters;
mod measured;
mod monte_carlo;
mod motion;
mod pieces;
mod quadrature;
mod request;
mod sheet;
mod shown;
mod sources;
mod spectra;
#[cfg(test)]
mod validation;
mod weights;

pub use corners::Corners;
pub use document::{Cause, Cost, FORMAT, Growth, Method, Verdict};
pub use filter_parameters::{
    ChannelParameters, FILTER_FORMAT, FilterError, FilterParameters, FilterRequest, Inflation, InflationCause, Over,
    Pairs, Prediction, RecordFrom, filter_parameters,
};
pub use measured::{Growing, LEAST_PIECES, Measured, Pieces, measured, measured_both};
pub use pieces::{MeasureError, Rest, piece_error};
pub use request::{Along, CostError, MOTION_ROWS_MAX, MotionRefusal, Quantity, Request, Tolerance};
pub use sheet::{
    Comparison, Covered, Envelope, Evidence, LimitState, LimitVerdict, ModelError, SHEET_FORMAT, Sheet, SheetVerdict,
    sheet,
};
pub use shown::{number, time};

use channel::ChannelErrors;
use compose::{Composed, compose};
use imu_core::sample::Channel;
use imu_core::units::STANDARD_GRAVITY_M_S2;
use imu_model::simulator::{SensorModel, Simulator};
use request::Setting;
use sources::ChannelSources;
use spectra::Spectra;
use std::collections::BTreeMap;

/// The channels that the integration uses: vertical acceleration moves nothing of first order.
const USED: [Channel; 5] = [Channel::GyroX, Channel::GyroY, Channel::GyroZ, Channel::AccelX, Channel::AccelY];

/// Quantities that are left out, and the effect that has no closed form.
type Unknown = Vec<(Quantity, String)>;

/// Up to this angle, rad, its sine is the angle to 2 %.
const SMALL_RAD: f64 = 0.3;

/// Returns the cost of a model, which the document calls `name`.
///
/// Numbers are in rad, m/s and m, one per horizon of the request. A quantity is there if the model has its own channel
/// (a gyroscope's axis for attitude, an accelerometer's for velocity and position).
///
/// # Errors
/// [`CostError`] for a request that makes no sense, and for a model that has none of the used channels or cannot be
/// simulated.
///
/// # Source
/// Strapdown error growth at rest: Titterton and Weston 2004, Strapdown Inertial Navigation Technology, chapter 12; the
/// spectra are those of the effects (`docs/effects.md`).
///
/// # Validation
/// docs/cost.md: each closed form against runs of the simulator, and against an implementation in numpy.
pub fn cost(model: &SensorModel, name: &str, request: &Request) -> Result<Cost, CostError> {
    let (request, left_out) = motion::within(request, model)?;
    let request = &*request;
    let setting = Setting::new(request, model)?;
    // The simulator checks the whole model.
    Simulator::new(model, request.seed, setting.rate_hz, setting.record_s())?;
    let quantities = quantities(model)?;
    if let Some(absent) = request.tolerances.iter().find(|tolerance| !quantities.contains(&tolerance.quantity)) {
        let present = quantities.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        return Err(CostError::Absent { quantity: absent.quantity, present });
    }
    let (mut composed, unknown) = match &request.motion {
        Some(along) => (motion::composed(request, along, model, &quantities)?, Unknown::new()),
        None => composed(&setting, &quantities)?,
    };
    if let Some((_, effect)) = unknown.iter().find(|(of, _)| request.tolerances.iter().any(|own| own.quantity == *of)) {
        return Err(CostError::NoClosedForm { effect: effect.clone() });
    }
    let tolerances = request.tolerances.iter().filter_map(|limit| verdict(limit, &setting, &composed)).collect();
    let places: Vec<usize> = request.horizons_s.iter().map(|horizon_s| setting.place(*horizon_s)).collect();
    let chosen =
        |values: &mut Vec<f64>| *values = places.iter().filter_map(|place| values.get(*place)).copied().collect();
    for Composed { growth, causes } in composed.values_mut() {
        [&mut growth.mean, &mut growth.sd, &mut growth.band95].into_iter().for_each(chosen);
        for cause in causes.iter_mut() {
            [&mut cause.share, &mut cause.share_band95, &mut cause.band95_without].into_iter().for_each(chosen);
        }
        let last = |cause: &Cause| cause.share.last().copied().unwrap_or_default();
        causes.sort_by(|one, other| last(other).total_cmp(&last(one)));
    }
    let extrapolated = record_s(model).map(|record_s| request.horizons_s.iter().map(|of| *of > record_s).collect());
    let mut notes = match &request.motion {
        Some(along) => motion::notes(along, model, &quantities),
        None => notes(model, &quantities),
    };
    notes.extend(left_out);
    notes.extend(unknown.iter().map(|(quantity, effect)| format!("no {quantity}: {effect} has no closed form")));
    notes.extend(composed.iter().find_map(|(quantity, of)| large_angle(*quantity, &of.growth, request)));
    let mut cost = Cost {
        format: FORMAT,
        model: name.to_owned(),
        motion: request.motion.as_ref().map(|along| along.name.clone()),
        align_s: request.align_s,
        horizons_s: request.horizons_s.clone(),
        extrapolated,
        gravity_m_s2: STANDARD_GRAVITY_M_S2,
        causes: composed.values_mut().flat_map(|of| std::mem::take(&mut of.causes)).collect(),
        quantities: composed.into_iter().map(|(quantity, of)| (quantity, of.growth)).collect(),
        tolerances,
        notes,
    };
    add_upper(&mut cost, model, request)?;
    Ok(cost)
}

/// Computes the quantities of a setting. Those that would have to be simulated, if nothing is, are returned with the
/// effect that is the reason.
fn composed(
    setting: &Setting<'_>,
    quantities: &[Quantity],
) -> Result<(BTreeMap<Quantity, Composed>, Unknown), CostError> {
    let sources: Vec<ChannelSources> =
        USED.into_iter().filter_map(|channel| ChannelSources::new(setting.model, channel)).collect();
    let spectra = Spectra::new(setting, &sources);
    let mut first = 0;
    let mut errors = Vec::with_capacity(sources.len());
    let mut unknown: BTreeMap<Channel, String> = BTreeMap::new();
    for of in &sources {
        match ChannelErrors::new(setting, of, &spectra, first) {
            Ok(found) => errors.push(found),
            Err(CostError::NoClosedForm { effect }) => {
                unknown.insert(of.channel, effect);
            }
            Err(error) => return Err(error),
        }
        first += of.sources.iter().filter(|source| source.is_spectral()).count();
    }
    let why = |quantity: &Quantity| {
        let mut effects = quantity.shares().into_iter().filter_map(|share| unknown.get(&share.channel));
        effects.next().map(|effect| (*quantity, effect.clone()))
    };
    let left_out: Unknown = quantities.iter().filter_map(why).collect();
    let kept: Vec<Quantity> = quantities.iter().copied().filter(|quantity| why(quantity).is_none()).collect();
    match left_out.first() {
        Some((_, effect)) if kept.is_empty() => Err(CostError::NoClosedForm { effect: effect.clone() }),
        _ => Ok((compose(setting, &errors, &kept)?, left_out)),
    }
}

/// Returns the quantities whose own channel the model has.
fn quantities(model: &SensorModel) -> Result<Vec<Quantity>, CostError> {
    let is_there =
        |quantity: &&Quantity| quantity.shares().first().is_some_and(|own| model.channels.contains_key(&own.channel));
    let found: Vec<Quantity> = Quantity::all().iter().filter(is_there).copied().collect();
    if found.is_empty() {
        let expected = USED.map(|channel| channel.to_string()).join(", ");
        return Err(CostError::NoChannel { expected });
    }
    Ok(found)
}

/// Returns what a reader has to know about what is missing.
fn notes(model: &SensorModel, quantities: &[Quantity]) -> Vec<String> {
    let has = |channel: Channel| model.channels.contains_key(&channel);
    if !has(Channel::AccelX) && !has(Channel::AccelY) {
        return vec!["the model has no horizontal accelerometer: attitude only".to_owned()];
    }
    let missing = USED.into_iter().filter(|channel| !has(*channel));
    let note = |channel: Channel| {
        let concerned = |quantity: &&Quantity| quantity.shares().iter().any(|share| share.channel == channel);
        let (kept, left): (Vec<&Quantity>, Vec<&Quantity>) =
            Quantity::all().iter().filter(concerned).partition(|quantity| quantities.contains(quantity));
        let list = |of: &[&Quantity]| of.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        let without = if kept.is_empty() { String::new() } else { format!("; {} leave out its error", list(&kept)) };
        format!("the model has no {channel}: no {}{without}", list(&left))
    };
    missing.map(note).collect()
}

/// Returns a note if an angle is too large for the formulas of velocity and position.
fn large_angle(quantity: Quantity, growth: &Growth, request: &Request) -> Option<String> {
    // Along a motion a heading that is wrong turns accelerations.
    let tilts = matches!(quantity, Quantity::AttitudeX | Quantity::AttitudeY)
        || (quantity == Quantity::Heading && request.motion.is_some());
    let place = growth.band95.iter().position(|band| tilts && *band > SMALL_RAD)?;
    let horizon_s = request.horizons_s.get(place)?;
    if request.motion.is_some() {
        return Some(format!(
            "{quantity} exceeds {SMALL_RAD} rad after {horizon_s} s: what noise adds to a mean error of that size is no longer exact"
        ));
    }
    Some(format!(
        "{quantity} exceeds {SMALL_RAD} rad after {horizon_s} s: the formulas for small angles no longer hold there for velocity \
         and position"
    ))
}

/// Returns the verdict on a limit.
fn verdict(limit: &Tolerance, setting: &Setting<'_>, composed: &BTreeMap<Quantity, Composed>) -> Option<Verdict> {
    let of = composed.get(&limit.quantity)?;
    let place = setting.place(limit.horizon_s);
    let value = *of.growth.band95.get(place)?;
    let share = |cause: &&Cause| cause.share[place];
    let largest = of.causes.iter().max_by(|one, other| share(one).total_cmp(&share(other)));
    let deciding = largest.filter(|cause| share(cause) > 0.0);
    Some(Verdict {
        quantity: limit.quantity,
        horizon_s: limit.horizon_s,
        limit: limit.limit,
        value,
        ratio: value / limit.limit,
        pass: value <= limit.limit,
        deciding: deciding.map(|cause| format!("{} on {}", cause.cause, cause.channel)).unwrap_or_default(),
    })
}

/// Returns the length of the record that the model was fitted to, s, if its provenance states it.
fn record_s(model: &SensorModel) -> Option<f64> {
    model.provenance.as_ref()?.get("duration_s")?.as_f64().filter(|length_s| *length_s > 0.0)
}

/// Adds the bands with every K at its upper end, if a horizon is an extrapolation.
fn add_upper(cost: &mut Cost, model: &SensorModel, request: &Request) -> Result<(), CostError> {
    if !cost.extrapolated.iter().flatten().any(|beyond| *beyond) {
        return Ok(());
    }
    let mut upper = SensorModel { provenance: None, ..model.clone() };
    let mut raised = false;
    for channel in USED {
        let Some(of) = upper.channels.get_mut(&channel) else { continue };
        let end = of.interval("K").map(|[_, high]| high).or_else(|| of.upper_limit("K"));
        if let Some(k) = end.filter(|k| *k > of.k) {
            (of.k, raised) = (k, true);
        }
    }
    if raised {
        let request = Request { tolerances: Vec::new(), ..request.clone() };
        let upper = match self::cost(&upper, &cost.model, &request) {
            // A larger K may bring a limit within reach. What was computed stays.
            Err(CostError::NoClosedForm { .. }) => return Ok(()),
            found => found?,
        };
        for (quantity, growth) in upper.quantities {
            if let Some(own) = cost.quantities.get_mut(&quantity) {
                own.band95_upper = Some(growth.band95);
            }
        }
    }
    Ok(())
}
