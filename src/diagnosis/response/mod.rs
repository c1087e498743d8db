//! Response: effects of a triad fitted against a known reference motion. Pure.
//!
//! In: a triad's samples at one rate, the motion at each of them, the noise's law, what the model knows already, and the
//! effects to fit. Out: each effect with its parameters, their covariance and 95 % intervals, what it gains in nats, the
//! residual, and in plain sentences what this motion leaves open.
//!
//! **Method.** Generalised least squares. Samples, response and its derivatives pass the cosine transform and are divided by
//! the square root of the noise's density there ([`noise_law`]); all three axes are fitted at once, since effects share
//! parameters among them. Derivatives are the effects' own ([`crate::effects::TriadEffect::regress`]), the response is the
//! simulator's ([`crate::simulator::response`]), and Gauss–Newton steps go on until they are below a thousandth of a
//! standard error: products of effects are then as the simulator makes them. A latency is found from the largest
//! cross-correlation on; clipped samples are found first and left out ([`clipping`]).
//!
//! **What it cannot tell.** Singular values of the whitened design with columns of length 1 say what the motion leaves open
//! ([`confounding`]): where a direction is open, only what its parameters make together is known; they share it and have no
//! interval. One triad's latency and an offset of the reference's clock are one ([`clock`]). The sensor's bandwidth and
//! boxcar act on the motion too; a reference has to have passed them, or they are found as latency.
//!
//! **Refused**: triads that no motion drives, columns of different lengths, fewer than [`SAMPLES_MIN`] samples, values that
//! are not finite, densities that are not above 0.
//!
//! Validation: `round_trip.rs` simulates every effect under coloured noise and asks whether 95 % of intervals hold.

#[cfg(test)]
mod behaviour;
mod candidate;
pub mod clipping;
pub mod clock;
pub mod confounding;
mod design;
mod error;
pub mod noise_law;
mod normal;
#[cfg(test)]
mod round_trip;
mod solution;
mod whitening;

pub use candidate::Candidate;
pub use clipping::Clipping;
pub use clock::{Clock, Lateness};
pub use confounding::{Confounding, Openness};
pub use error::ResponseError;
pub use noise_law::NoiseLaw;

use crate::effects::TriadEffect;
use crate::effects::triad::Axes;
use crate::sample::Triad;
use crate::simulator::Motion;
use clipping::Bridges;
use confounding::Motions;
use design::{Design, Slot, State};
use nalgebra::{DMatrix, DVector};
use solution::{Search, Solution};
use std::sync::Arc;
use whitening::Whitening;

/// The least samples of a record: more than its parameters.
pub const SAMPLES_MIN: usize = 64;
/// The normal distribution's 97.5 % point.
pub(crate) const NORMAL_95: f64 = 1.959_963_984_540_054;
/// How often the stretches to leave out are taken anew from the fitted response.
const CLIPPING_ROUNDS: usize = 4;
/// Part of them that may still change: whether a response is five standard deviations from the limit or a little less.
const CLIPPING_SETTLED: f64 = 1e-3;

/// A triad's record beside its reference.
#[derive(Debug, Clone, Copy)]
#[expect(clippy::exhaustive_structs, reason = "callers write it out")]
pub struct Record<'a> {
    /// Samples per second.
    pub rate_hz: f64,
    /// Accel or gyro.
    pub triad: Triad,
    /// x, y and z, U; without gaps, as many as there are motions.
    pub samples: [&'a [f64]; 3],
    /// The reference at each sample's time.
    pub reference: &'a [Motion],
    /// Temperature at each sample, °C: where it is given, a bias per kelvin of each axis is fitted beside all else. Smoothed: a
    /// rounded one makes its own errors.
    pub temperature_c: Option<&'a [f64]>,
}

/// What is known and what to find.
#[derive(Debug, Clone, Copy)]
#[expect(clippy::exhaustive_structs, reason = "callers write it out")]
pub struct Request<'a> {
    /// Effects that the model has. One that is also a candidate is where its fit starts; others stay as they are.
    pub known: &'a [Arc<dyn TriadEffect>],
    /// The channels' own biases, U.
    pub level: Axes,
    /// Effects to fit.
    pub candidates: &'a [Candidate],
    /// The reference's clock.
    pub clock: Clock,
}

/// A fitted parameter.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Estimate {
    /// The effect's name; `clock` for the reference's, `temperature_bias` for what goes with the temperature.
    pub effect: &'static str,
    /// `x`, `xy`, `m[0][2]`, `seconds`; `offset_s`, `rate_error`; `x per_c`.
    pub parameter: String,
    /// In the parameter's unit.
    pub value: f64,
    /// Before the fit.
    pub known: f64,
    /// `None` where the motion leaves it open.
    pub standard_error: Option<f64>,
    /// Value ± 1.96 standard errors.
    pub ci95: Option<[f64; 2]>,
}

/// A fitted effect.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Fitted {
    /// With the fitted parameters. A latency that came out below 0 is 0 here.
    pub effect: Arc<dyn TriadEffect>,
    /// Where its parameters are in [`Fit::estimates`]. None for a saturation, which is read off exactly.
    pub places: std::ops::Range<usize>,
    /// Log likelihood lost if its parameters went back to what was known and all others were fitted again, nats; to second
    /// order. Parameters that the motion leaves open count for nothing. 0 for a saturation: an exact tie has no density.
    pub gain_nats: f64,
}

/// What was found.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Fit {
    /// The candidates in their order; a latency only if the reference's clock has no offset of its own, a saturation only if
    /// there is one.
    pub fitted: Vec<Fitted>,
    /// Every parameter, then the clock's and the temperature's.
    pub estimates: Vec<Estimate>,
    /// Covariance of the estimates: rows and columns in their order, 0 for those left open.
    pub covariance: Vec<Vec<f64>>,
    /// Log likelihood gained over what was known, nats. Of clipped records the share of samples that were not left out.
    pub gain_nats: f64,
    /// Mean square of the whitened residual per axis: 1 where the noise is as its law says and nothing is missing.
    pub misfit: Axes,
    /// What the triad shows on average with all that was fitted, U.
    pub response: [Vec<f64>; 3],
    /// Samples less response, U; bridged where samples were left out.
    pub residual: [Vec<f64>; 3],
    /// The sensor's range, where the samples show it.
    pub clipping: Option<Clipping>,
    /// What this motion leaves open.
    pub confounded: Vec<Confounding>,
    /// Whether the steps became small.
    pub converged: bool,
    /// Gauss–Newton steps of the last round.
    pub steps: usize,
}

/// Fits the candidates to a record.
///
/// # Errors
/// [`ResponseError`], see the module.
///
/// # Source
/// Generalised least squares with a diagonal covariance in the transform's domain; Seber and Wild, Nonlinear Regression
/// (1989), sections 2.1 and 14.1 (Gauss–Newton with halved steps).
///
/// # Validation
/// `round_trip.rs`: 95 % intervals of every effect's parameters over 60 seeds.
pub fn fit(record: &Record<'_>, law: &NoiseLaw, request: &Request<'_>) -> Result<Fit, ResponseError> {
    check(record, law, request)?;
    let (design, known) = Design::new(record, request);
    let input: Vec<Axes> = record.reference.iter().map(|motion| design.input(motion)).collect();
    let mut clipping = Clipping::find_or_known(record.samples, &input, request.known);
    let mut search = Search { record, design: &design, whitening: Whitening::new(law) };
    let mut state = known.clone();
    if let Some(clipping) = &mut clipping {
        let response = design.response(&known);
        leave_out(clipping, record, law, &response, &mut search.whitening)?;
    }
    state = search.start(&state);
    let mut solution = search.run(state);
    for _ in 1..CLIPPING_ROUNDS {
        let Some(clipping) = &mut clipping else { break };
        let before = clipping.left_out;
        leave_out(clipping, record, law, &solution.response, &mut search.whitening)?;
        solution = search.run(solution.state);
        let changed: usize = clipping.left_out.iter().zip(before).map(|(now, before)| now.abs_diff(before)).sum();
        if changed as f64 <= CLIPPING_SETTLED * clipping.left_out.iter().sum::<usize>() as f64 {
            break;
        }
    }
    Ok(report(record, request, &known, &mut search, solution, clipping))
}

fn leave_out(
    clipping: &mut Clipping,
    record: &Record<'_>,
    law: &NoiseLaw,
    response: &[Vec<f64>; 3],
    whitening: &mut Whitening<'_>,
) -> Result<(), ResponseError> {
    let bridges = clipping.bridges(record.samples, response, &law.axes);
    clipping.left_out = bridges.each_ref().map(Bridges::count);
    for (channel, out) in record.triad.channels().into_iter().zip(clipping.left_out) {
        let found = law.samples() - out;
        if found < SAMPLES_MIN {
            return Err(ResponseError::Clipped { channel, limit: clipping.limit, needed: SAMPLES_MIN, found });
        }
    }
    whitening.bridges = bridges;
    Ok(())
}

fn check(record: &Record<'_>, law: &NoiseLaw, request: &Request<'_>) -> Result<(), ResponseError> {
    if !matches!(record.triad, Triad::Accel | Triad::Gyro) {
        return Err(ResponseError::Triad { found: record.triad });
    }
    if !(record.rate_hz.is_finite() && record.rate_hz > 0.0) {
        return Err(ResponseError::Rate { found: record.rate_hz });
    }
    let expected = record.samples[0].len();
    let lengths = [
        ("samples of the y axis", record.samples[1].len()),
        ("samples of the z axis", record.samples[2].len()),
        ("the reference", record.reference.len()),
        ("the noise's law", law.samples()),
        ("the temperature", record.temperature_c.map_or(expected, <[f64]>::len)),
    ];
    for (what, found) in lengths {
        if found != expected {
            return Err(ResponseError::Length { what, expected, found });
        }
    }
    if expected < SAMPLES_MIN {
        return Err(ResponseError::TooShort { needed: SAMPLES_MIN, found: expected });
    }
    let finite = |what: &'static str, mut values: Box<dyn Iterator<Item = f64> + '_>| {
        let wrong = values.by_ref().enumerate().find(|(_, value)| !value.is_finite());
        wrong.map_or(Ok(()), |(index, found)| Err(ResponseError::NotFinite { what, index, found }))
    };
    for axis in 0..3 {
        finite("samples", Box::new(record.samples[axis].iter().copied()))?;
        finite("the reference's rate", Box::new(record.reference.iter().map(move |motion| motion.gyro_rad_s[axis])))?;
        finite("the reference's force", Box::new(record.reference.iter().map(move |motion| motion.accel_m_s2[axis])))?;
    }
    finite("the temperature", Box::new(record.temperature_c.unwrap_or_default().iter().copied()))?;
    finite("the channels' biases", Box::new(request.level.into_iter()))?;
    for effect in request.known {
        effect.check(record.triad)?;
    }
    for (place, candidate) in request.candidates.iter().enumerate() {
        candidate.check(record.triad)?;
        let same = |other: &Candidate| candidate.coefficients_of(other.make(&[]).as_ref()).is_some();
        if request.candidates[..place].iter().any(same) {
            return Err(ResponseError::Twice { effect: candidate.name() });
        }
    }
    Ok(())
}

/// Everything that is said about a solution.
fn report(
    record: &Record<'_>,
    request: &Request<'_>,
    known: &State,
    search: &mut Search<'_, '_>,
    solution: Solution,
    clipping: Option<Clipping>,
) -> Fit {
    let design = search.design;
    let inverse = solution.normal.inverse();
    let covariance = match clipping {
        Some(_) => &inverse * search.whitening.gradient_covariance(&solution.columns) * &inverse,
        None => inverse,
    };
    let open: Vec<usize> =
        solution.normal.unseen().into_iter().chain(solution.normal.open_groups().into_iter().flatten()).collect();
    let estimates: Vec<Estimate> = design
        .slots
        .iter()
        .enumerate()
        .map(|(place, slot)| {
            let (effect, parameter) = label(design, request, *slot);
            let value = solution.state.value(*slot);
            let error = covariance[(place, place)].max(0.0).sqrt();
            let standard_error = (!open.contains(&place)).then_some(error);
            let ci95 = standard_error.map(|error| [value - NORMAL_95 * error, value + NORMAL_95 * error]);
            Estimate { effect, parameter, value, known: known.value(*slot), standard_error, ci95 }
        })
        .collect();
    let (_, before) = search.residual(known);
    let n = record.reference.len() as f64;
    let squares = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
    let left_out = clipping.map_or([0; 3], |clipping| clipping.left_out);
    let gain = |axis: usize| {
        let share = 1.0 - left_out[axis] as f64 / n;
        0.5 * share * (squares(&before[axis]) - squares(&solution.residual[axis]))
    };
    let rows: Vec<Vec<f64>> = covariance
        .row_iter()
        .enumerate()
        .map(|(row, of)| {
            let seen = |column: &usize| !open.contains(&row) && !open.contains(column);
            (0..of.len()).map(|column| if seen(&column) { of[column] } else { 0.0 }).collect()
        })
        .collect();
    Fit {
        fitted: fitted(request, design, &solution.state, &estimates, &rows, clipping),
        gain_nats: (0..3).map(gain).sum(),
        // Behind a bridge next to nothing is left.
        misfit: std::array::from_fn(|axis| squares(&solution.residual[axis]) / (n - left_out[axis] as f64)),
        residual: std::array::from_fn(|axis| {
            let pairs = record.samples[axis].iter().zip(&solution.response[axis]);
            let mut values: Vec<f64> = pairs.map(|(shown, response)| shown - response).collect();
            search.whitening.bridges[axis].fill(&mut values);
            values
        }),
        confounded: statements(record, request, design, &solution, &estimates),
        covariance: rows,
        estimates,
        response: solution.response,
        clipping,
        converged: solution.converged,
        steps: solution.steps,
    }
}

fn label(design: &Design<'_>, request: &Request<'_>, slot: Slot) -> (&'static str, String) {
    match slot {
        Slot::Coefficient(candidate, place) => {
            let candidate = design.candidates[candidate];
            (candidate.name(), candidate.parameters()[place].clone())
        }
        Slot::Delay if request.clock.offset_unknown => ("clock", "offset_s".to_owned()),
        Slot::Delay => (Candidate::Latency.name(), "seconds".to_owned()),
        Slot::RateError => ("clock", "rate_error".to_owned()),
        Slot::Temperature(axis) => ("temperature_bias", format!("{} per_c", ["x", "y", "z"][axis])),
    }
}

fn fitted(
    request: &Request<'_>,
    design: &Design<'_>,
    state: &State,
    estimates: &[Estimate],
    covariance: &[Vec<f64>],
    clipping: Option<Clipping>,
) -> Vec<Fitted> {
    let mut linear = 0;
    let mut all = Vec::new();
    for candidate in request.candidates {
        let first = |wanted: Slot| design.slots.iter().position(|slot| *slot == wanted).unwrap_or(0);
        let (effect, places) = match candidate {
            Candidate::Saturation => {
                let Some(clipping) = clipping else { continue };
                (candidate.make(&[clipping.limit]), 0..0)
            }
            Candidate::Latency if request.clock.offset_unknown => continue,
            Candidate::Latency => {
                let place = first(Slot::Delay);
                (candidate.make(&[state.delay_s]), place..place + 1)
            }
            _ => {
                let place = first(Slot::Coefficient(linear, 0));
                let coefficients = &state.coefficients[linear];
                linear += 1;
                (candidate.make(coefficients), place..place + coefficients.len())
            }
        };
        let gain_nats = loss(places.clone(), estimates, covariance);
        all.push(Fitted { effect, places, gain_nats });
    }
    all
}

/// ½ (β − known)ᵀ C⁻¹ (β − known) over the parameters of these places that are not left open.
fn loss(places: std::ops::Range<usize>, estimates: &[Estimate], covariance: &[Vec<f64>]) -> f64 {
    let seen: Vec<usize> = places.filter(|place| estimates[*place].standard_error.is_some_and(|e| e > 0.0)).collect();
    let errors: Vec<f64> = seen.iter().map(|place| covariance[*place][*place].sqrt()).collect();
    let correlation = DMatrix::from_fn(seen.len(), seen.len(), |row, column| {
        covariance[seen[row]][seen[column]] / (errors[row] * errors[column])
    });
    let moved = seen.iter().zip(&errors).map(|(place, error)| {
        let estimate = &estimates[*place];
        (estimate.value - estimate.known) / error
    });
    let moved = DVector::from_iterator(seen.len(), moved);
    correlation.cholesky().map_or(0.0, |root| 0.5 * moved.dot(&root.solve(&moved)))
}

fn statements(
    record: &Record<'_>,
    request: &Request<'_>,
    design: &Design<'_>,
    solution: &Solution,
    estimates: &[Estimate],
) -> Vec<Confounding> {
    let motions = Motions::of(record);
    let (mut unseen, normal) = (solution.normal.unseen(), &solution.normal);
    let mut groups: Vec<(Openness, Vec<usize>)> = Vec::new();
    while let Some(first) = unseen.first().copied() {
        // One sentence for each effect and clock.
        let (same, rest) = unseen.iter().partition(|place| estimates[**place].effect == estimates[first].effect);
        groups.push((Openness::Unseen, same));
        unseen = rest;
    }
    groups.extend(normal.open_groups().into_iter().map(|group| (Openness::Confounded, group)));
    groups.extend(normal.faint_groups().into_iter().map(|group| (Openness::Faint, group)));
    let state = |(openness, group): (Openness, Vec<usize>)| {
        motions.state(openness, &group, &design.slots, &design.candidates, estimates)
    };
    let mut all: Vec<Confounding> = groups.into_iter().map(state).collect();
    if request.clock.offset_unknown && request.candidates.contains(&Candidate::Latency) {
        all.push(clock::latency_or_offset());
    }
    all
}
