//! Response: effects of a triad, fitted against a known reference motion. Pure.
//!
//! In: a triad's samples at one rate, the motion at each of them, the noise's law, the parameters that the model knows already,
//! and the effects to fit. Out: each effect with its parameters, their covariance and 95 % intervals, its gain in nats, the
//! residual, and plain sentences about the parameters that this motion leaves open.
//!
//! **Method.** Generalised least squares. Samples, response and its derivatives pass the cosine transform and are
//! divided by the square root of the noise's density there ([`noise_law`]). All three axes are fitted at once, since
//! effects share parameters among them. Derivatives are the effects' own
//! ([`imu_model::effects::TriadEffect::regress`]), and the response is the simulator's
//! ([`imu_model::simulator::response`]). Gauss–Newton steps continue until they are below a thousandth of a standard
//! error: products of effects then equal the simulator's. A latency is found starting from the largest
//! cross-correlation. Clipped samples are found first and left out ([`clipping`]). Samples that the reference, shifted
//! by a delay, does not reach are left out as well.
//!
//! **Limits of the method.** Singular values of the whitened design with columns of length 1 show which parameters the
//! motion leaves open ([`confounding`]). If a direction is open, only the joint effect of its parameters is known; they
//! share it and have no interval. One triad's latency and an offset of the reference's clock cannot be separated
//! ([`clock`]). The sensor's bandwidth and boxcar act on the motion too; a reference has to have passed them, or they
//! are reported as latency.
//!
//! **Refused**: fewer than [`SAMPLES_MIN`] samples within the sensor's range and the reference, densities that are not
//! above 0.
//!
//! Validation: `round_trip.rs` simulates every effect under coloured noise and tests whether 95 % of the intervals
//! hold.

#[cfg(test)]
mod behaviour;
mod candidate;
mod clipping;
pub(crate) mod clock;
mod confounding;
mod design;
mod error;
mod filters;
mod noise_law;
mod normal;
mod report;
#[cfg(test)]
mod round_trip;
mod screen;
mod solution;
mod whitening;

pub use candidate::Candidate;
pub(crate) use candidate::is_alike;
pub use clipping::Clipping;
pub use clock::Clock;
pub use confounding::{Confounding, Openness};
pub use error::ResponseError;
pub use filters::{Filters, NO_FILTERS};
pub use noise_law::NoiseLaw;
pub use screen::{Extra, Screen, screen};

use design::{Design, State};
use imu_core::sample::Triad;
use imu_model::effects::triad::Axes;
use imu_model::effects::{EffectKind, TriadEffect};
use imu_model::simulator::Motion;
use solution::{Search, Solution};
use std::sync::Arc;
use whitening::Whitening;

/// The minimum number of samples in a record: more than its parameters.
pub const SAMPLES_MIN: usize = 64;
/// The names of the axes.
pub(crate) const AXES: [&str; 3] = ["x", "y", "z"];
/// The 97.5 % point of the normal distribution.
pub(crate) const NORMAL_95: f64 = 1.959_963_984_540_054;
/// How often the excluded stretches are determined again from the fitted response.
const CLIPPING_ROUNDS: usize = 4;
/// Part of the samples that may still change: whether a response is five standard deviations from the limit or a little
/// less.
const CLIPPING_SETTLED: f64 = 1e-3;

/// A triad's record beside its reference.
#[derive(Debug, Clone, Copy)]
pub struct Record<'a> {
    /// Samples per second.
    pub rate_hz: f64,
    /// Accelerometer or gyro.
    pub triad: Triad,
    /// x, y and z, U; without gaps, as many as there are motions.
    pub samples: [&'a [f64]; 3],
    /// The reference at each sample's time.
    pub reference: &'a [Motion],
    /// Temperature at each sample, °C. If it is given, a bias per kelvin of each axis is fitted beside all else. It has
    /// to be smoothed: a rounded temperature causes errors of its own.
    pub temperature_c: Option<&'a [f64]>,
    /// Whether each sample is missing or not noise; such samples are left out of all axes. Empty if there are none. The
    /// values of these samples are finite numbers.
    pub left_out: &'a [bool],
    /// The samples as they were sent, if a course was subtracted from `samples`: only these show what the sensor cuts
    /// off. Missing samples are not numbers here.
    pub sent: Option<[&'a [f64]; 3]>,
}

/// The known quantities and the effects to find.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// Effects that the model has. The fit of an effect that is also a candidate starts from it; others stay as they
    /// are.
    pub known: &'a [Arc<dyn TriadEffect>],
    /// The channels' own biases, U.
    pub level: Axes,
    /// Effects to fit.
    pub candidates: &'a [Candidate],
    /// The reference's clock.
    pub clock: Clock,
    /// The sensor's bandwidth: motion passes these filters on each axis. A fitted delay comes in addition to theirs.
    pub filters: &'a Filters,
}

/// A fitted parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// The effect: a temperature bias for dependence on temperature, a low pass for a cutoff; none for the reference's
    /// clock.
    pub effect: Option<EffectKind>,
    /// `x`, `xy`, `m[0][2]`, `seconds`; `offset_s`, `rate_error`; `x per_c`; `x ln_cutoff`, the addition to the
    /// logarithm of a cutoff.
    pub parameter: String,
    /// The fitted value, in the parameter's unit.
    pub value: f64,
    /// The value before the fit.
    pub known: f64,
    /// The standard error; `None` if the motion leaves the parameter open.
    pub standard_error: Option<f64>,
}

/// A fitted effect.
#[derive(Debug, Clone)]
pub struct Fitted {
    /// The effect with the fitted parameters. A latency that was fitted below 0 is 0 here.
    pub effect: Arc<dyn TriadEffect>,
    /// The places of the effect's parameters in [`Fit::estimates`]. None for a saturation, which is read off exactly.
    pub places: std::ops::Range<usize>,
}

/// The result of a fit.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The candidates in their order; a latency only if the reference's clock has no separate offset, a saturation only
    /// if the samples show one.
    pub fitted: Vec<Fitted>,
    /// Every parameter, then those of the clock and the temperature.
    pub estimates: Vec<Estimate>,
    /// Mean square of the whitened residual per axis: 1 if the noise follows its law and no effect is missing.
    pub misfit: Axes,
    /// The triad's mean output with all fitted effects, U.
    pub response: [Vec<f64>; 3],
    /// The sensor's range, if the samples show it.
    pub clipping: Option<Clipping>,
    /// The samples that are left out, per axis: clipped ones, and those whose motion is before the reference's start or
    /// after its end.
    pub stretches: [Vec<std::ops::Range<usize>>; 3],
    /// The parameters that this motion leaves open.
    pub confounded: Vec<Confounding>,
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
/// `round_trip.rs`: 95 % intervals of every effect's parameters under N, B and K over 60 seeds; over 500 seeds they held in
/// 94.4–95.0 % for every effect, alone and with others, clipped or not.
pub fn fit(record: &Record<'_>, law: &NoiseLaw, request: &Request<'_>) -> Result<Fit, ResponseError> {
    solved(record, law, request, |known, search, solution, clipping| {
        report::report(record, request, known, search, &solution, clipping)
    })
}

/// Returns the mean output of a triad with these effects in a motion, per axis, U.
pub fn expected(
    triad: Triad,
    rate_hz: f64,
    reference: &[Motion],
    known: &[Arc<dyn TriadEffect>],
    level: Axes,
) -> [Vec<f64>; 3] {
    let nothing = vec![0.0; reference.len()];
    let samples = std::array::from_fn(|_| nothing.as_slice());
    let record = Record { rate_hz, triad, samples, reference, temperature_c: None, left_out: &[], sent: None };
    let request = Request { known, level, candidates: &[], clock: Clock::Shared, filters: &NO_FILTERS };
    let (design, state) = Design::new(&record, &request);
    design.response(&state)
}

/// Returns a triad's own input in a motion.
pub(crate) fn input(triad: Triad, motion: &Motion) -> Axes {
    if triad == Triad::Gyro { motion.gyro_rad_s } else { motion.accel_m_s2 }
}

/// Runs a function on a problem's solution.
fn solved<T>(
    record: &Record<'_>,
    law: &NoiseLaw,
    request: &Request<'_>,
    then: impl FnOnce(&State, &mut Search<'_, '_>, Solution, Option<Clipping>) -> T,
) -> Result<T, ResponseError> {
    let (design, known) = Design::new(record, request);
    let input: Vec<Axes> = record.reference.iter().map(|motion| input(record.triad, motion)).collect();
    let clipping = Clipping::find_or_known(record.sent.unwrap_or(record.samples), &input, request.known);
    let limit = clipping.map(|clipping| clipping.limit);
    let whitening = Whitening::new(law);
    let mut search = Search { record, design: &design, whitening, clock: request.clock };
    search.leave_out(limit, None, &known)?;
    let start = search.start(&known);
    let mut left_out = search.leave_out(limit, Some(&design.response(&start)), &start)?;
    let mut solution = search.run(start);
    for _ in 1..CLIPPING_ROUNDS {
        if limit.is_none() {
            break;
        }
        let before = left_out;
        left_out = search.leave_out(limit, Some(&solution.response), &solution.state)?;
        solution = search.run(solution.state);
        let changed: usize = left_out.iter().zip(before).map(|(now, before)| now.abs_diff(before)).sum();
        if changed as f64 <= CLIPPING_SETTLED * left_out.iter().sum::<usize>() as f64 {
            break;
        }
    }
    Ok(then(&known, &mut search, solution, clipping))
}
