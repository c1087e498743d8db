//! Filter parameters: the noise that a filter has to be told so that its covariance is that of the real errors.
//!
//! In: a sensor model, a range of horizons, an alignment, N and K of the Allan deviation. Out: for each channel the pair of
//! white noise and random walk (and of white noise and Gauss-Markov process) whose predicted errors are closest to the real
//! ones, the closest pair that covers them, the inflation over N and K, and its causes. Pure.
//!
//! The error is the integral of a channel after an alignment: an angle from a gyroscope, a velocity from an accelerometer.
//! The alignment stands for the filter's estimate of the bias when it begins to coast. Real and predicted errors have the
//! same one, and so a model of N and K alone gets its own N and K back:
//!
//! ```text
//! x(τ) = ∫ e dt from 0 to τ − (τ/T)·∫ e dt from −T to 0,   Var x = N²(τ + τ²/T) + K²(τ³/3 + τ²T/3)
//! ```
//!
//! The errors over five horizons per decade are taken jointly ([`moments`], [`real`]) and compared by the Kullback-Leibler
//! divergence ([`fit`]). A constant has no effect.
//!
//! # Example
//! ```
//! use imu_core::sample::Channel;
//! use imu_cost::{FilterRequest, filter_parameters};
//! use imu_model::simulator::SensorModel;
//!
//! let model = SensorModel::from_json(
//!     r#"{"format": "vn100d-sensor-model-1", "name": "desk", "rate_hz": 40,
//!         "channels": {"gyro_z": {"N": 1e-4, "K": 1e-6, "bias": 0.02}}}"#,
//!     "desk.json",
//! )?;
//! let found = filter_parameters(&model, "desk.json", &FilterRequest::default())?;
//! let pair = &found.channels[&Channel::GyroZ].white_and_walk.fit;
//! assert!((pair.n / 1e-4 - 1.0).abs() < 1e-6 && (pair.k.unwrap() / 1e-6 - 1.0).abs() < 1e-6);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod causes;
mod document;
mod fit;
mod gauss_markov;
mod moments;
mod real;
mod request;
#[cfg(test)]
mod tests;

pub use document::{
    Cause as InflationCause, ChannelParameters, FORMAT as FILTER_FORMAT, FilterParameters, Inflation, Pairs, Prediction,
};
pub use request::{FilterError, FilterRequest, Over, RecordFrom};

use crate::sources::{ChannelSources, Law};
use fit::{Family, Seen, Variances};
use gauss_markov::Processes;
use imu_core::sample::{Channel, Triad};
use imu_model::simulator::{SensorModel, Simulator};
use moments::{DENSE_MAX, WINDOWS_MAX};
use real::{Known, Real};
use request::{Asked, Grid};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Frequencies whose worst phases are among the horizons of a grid, at most.
const FEATURES_MAX: usize = 8;

/// Returns the filter parameters of a model, which the document calls `name`.
///
/// # Errors
/// [`FilterError`] for a request that makes no sense, and for a model that has neither gyroscope nor accelerometer or cannot
/// be simulated.
///
/// # Source
/// The divergence: Kullback and Leibler 1951, Ann. Math. Statist. 22. Consistency of a filter's covariance: Bar-Shalom, Li
/// and Kirubarajan 2001, Estimation with Applications to Tracking and Navigation, section 5.4.
///
/// # Validation
/// docs/filters.md: real variances against runs of the simulator, pairs against a search on a grid.
pub fn filter_parameters(
    model: &SensorModel,
    name: &str,
    request: &FilterRequest,
) -> Result<FilterParameters, FilterError> {
    let asked = Asked::new(request, model)?;
    // The simulator checks the whole model.
    Simulator::new(model, request.seed, model.rate_hz, asked.record_s).map_err(crate::CostError::from)?;
    let channels: Vec<Channel> = [Triad::Gyro, Triad::Accel].into_iter().flat_map(Triad::channels).collect();
    let sources: Vec<ChannelSources> =
        channels.iter().filter_map(|channel| ChannelSources::new(model, *channel)).collect();
    if sources.is_empty() {
        let expected = channels.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        return Err(FilterError::NoChannel { expected });
    }
    let features = narrow(&sources, model.rate_hz);
    let grid = Grid::new(asked.over, model.rate_hz, |horizon| phases(&features, horizon))?;
    let (known, errors) = real::errors(&asked, &grid, &sources)?;
    let processes = Processes::new(&grid, &known.white, model.rate_hz, asked.setting.align);
    let mut found = BTreeMap::new();
    for real in &errors {
        let allan = request.allan.get(&real.channel).copied().unwrap_or_default();
        let of = OfChannel { rate_hz: model.rate_hz, grid: &grid, known: &known, processes: &processes, allan };
        found.insert(real.channel, of.parameters(real)?);
    }
    Ok(FilterParameters {
        format: FILTER_FORMAT,
        model: name.to_owned(),
        over_s: [asked.over.from_s, asked.over.to_s],
        align_s: request.align_s,
        record_s: asked.record_s,
        record_from: asked.record_from,
        extrapolated: asked.extrapolated,
        horizons_s: grid.joint.iter().map(|place| grid.horizons[*place] as f64 / model.rate_hz).collect(),
        notes: notes(&asked, &sources, &found),
        channels: found,
    })
}

/// Returns the frequencies, rad per sample, of narrow bands as they are sent. Lines are bounded at their worst phase
/// anyway.
fn narrow(sources: &[ChannelSources], rate_hz: f64) -> Vec<f64> {
    let own = sources.iter().flat_map(|of| &of.sources).filter(|source| source.effect.lines().is_empty());
    let folded = own.filter_map(|source| source.effect.number("frequency_hz")).map(|hz| {
        let within = hz.rem_euclid(rate_hz);
        2.0 * PI * within.min(rate_hz - within) / rate_hz
    });
    let mut all: Vec<f64> = folded.filter(|omega| *omega > 1e-6).collect();
    all.sort_by(f64::total_cmp);
    all.dedup_by(|one, other| (*one - *other).abs() < 1e-3 * *other);
    all.truncate(FEATURES_MAX);
    all
}

/// Returns for each frequency the horizon from `horizon` on, within two periods, at which a wave is farthest from where it
/// began.
fn phases(features: &[f64], horizon: u64) -> Vec<u64> {
    let farthest = |omega: &f64| {
        let last = horizon + (4.0 * PI / omega).ceil().min(1e4) as u64;
        let cosine = |samples: &u64| (omega * *samples as f64).cos();
        (horizon..=last).min_by(|one, other| cosine(one).total_cmp(&cosine(other)))
    };
    features.iter().filter_map(farthest).collect()
}

/// Returns what a reader has to know.
fn notes(
    asked: &Asked<'_>,
    sources: &[ChannelSources],
    channels: &BTreeMap<Channel, ChannelParameters>,
) -> Vec<String> {
    let mut notes = Vec::new();
    if asked.extrapolated {
        notes.push(format!(
            "extrapolation: {} s of alignment and horizon are longer than the record of the model",
            asked.setting.record_s()
        ));
    }
    let comes_and_goes = |of: &&ChannelSources| of.sources.iter().any(|source| matches!(source.law, Law::Gated { .. }));
    if asked.record.samples() > DENSE_MAX {
        for of in sources.iter().filter(comes_and_goes) {
            notes.push(format!(
                "{}: lines that are present for less than {:.0} s may be missed in so long a record; --record shortens it",
                of.channel,
                asked.record_s / WINDOWS_MAX as f64
            ));
        }
    }
    for (channel, of) in channels.iter().filter(|(_, of)| !of.simulated.is_empty()) {
        notes.push(format!("{channel}: Monte Carlo, because of {}", of.simulated.join(", ")));
    }
    notes
}

/// A channel whose parameters are computed.
struct OfChannel<'a> {
    rate_hz: f64,
    grid: &'a Grid,
    known: &'a Known,
    processes: &'a Processes<'a>,
    /// N and K of the Allan deviation.
    allan: [Option<f64>; 2],
}

impl OfChannel<'_> {
    fn parameters(&self, real: &Real) -> Result<ChannelParameters, FilterError> {
        let all = real.without(None);
        let family = self.family()?;
        let seen = family.seen(self.grid, &all);
        let walk = |of: Variances| {
            let own = self.prediction(&family, &seen, of);
            let inflation = Inflation { k: over(of.second, self.allan[1]), ..own.inflation };
            Prediction { k: Some(of.second.sqrt()), inflation, ..own }
        };
        let closest = family.closest(&seen);
        let white = |of: Variances| self.prediction(&family, &seen, of);
        let fit = walk(closest);
        let causes = causes::causes(&family, self.grid, real);
        let known =
            Variances { white: self.allan[0].unwrap_or(0.0).powi(2), second: self.allan[1].unwrap_or(0.0).powi(2) };
        let base = [known.white.sqrt(), known.second.sqrt()];
        let fitted = [closest.white.sqrt(), closest.second.sqrt()];
        Ok(ChannelParameters {
            unit: if real.channel.triad() == Some(Triad::Gyro) { "rad" } else { "m/s" },
            real_sd: self.at_joint(&self.joint_variances(&all)),
            allan: self.allan[0].map(|_| walk(known)),
            summary: causes::summary(fitted, fit.inflation, base, &causes),
            white_and_walk: Pairs { fit, cover: walk(family.covering(closest, &seen)) },
            gauss_markov: Pairs { fit: self.process(&all, false)?, cover: self.process(&all, true)? },
            white: Pairs { fit: white(family.white_alone(&seen)), cover: white(family.covering_white(&seen)) },
            causes,
            simulated: real.simulated.iter().map(ToString::to_string).collect(),
        })
    }

    /// Returns the family of white noise and a random walk.
    fn family(&self) -> Result<Family, FilterError> {
        Family::new(self.grid, &self.known.white, &self.known.walk).ok_or_else(|| self.too_fine())
    }

    /// Returns the refusal of a range whose horizons do not differ in floating-point numbers.
    fn too_fine(&self) -> FilterError {
        let [from_s, to_s] = [self.grid.horizons.first(), self.grid.horizons.last()]
            .map(|of| of.copied().unwrap_or(1) as f64 / self.rate_hz);
        FilterError::Range {
            found: format!("{from_s}s..{to_s}s"),
            expected: "horizons that lie closer together".to_owned(),
        }
    }

    /// Returns the closest process with white noise.
    fn process(&self, real: &[f64], covers: bool) -> Result<Prediction, FilterError> {
        let found = self.processes.closest(real, covers).ok_or_else(|| self.too_fine())?;
        let own = self.prediction(&found.family, &found.seen, found.variances);
        let sigma = found.variances.second.sqrt();
        // Without a process there is no correlation time either.
        let tc = (sigma > 0.0).then_some(found.tc_s);
        Ok(Prediction { sigma: Some(sigma), tc_s: tc, tc_at_end: tc.map(|_| found.at_end), ..own })
    }

    /// Returns what a filter predicts with these variances.
    fn prediction(&self, family: &Family, seen: &Seen, of: Variances) -> Prediction {
        let (ratio, place) = family.shortfall(of, seen);
        Prediction {
            n: of.white.sqrt(),
            k: None,
            sigma: None,
            tc_s: None,
            tc_at_end: None,
            inflation: Inflation { n: over(of.white, self.allan[0]), k: None },
            predicted_sd: self.at_joint(&family.predicted(of)),
            worst_ratio: Some(ratio.sqrt()).filter(|ratio| ratio.is_finite()),
            worst_at_s: self.grid.horizons[place] as f64 / self.rate_hz,
            divergence: family.divergence(of, seen),
        }
    }

    /// Returns the variances at the horizons of the grid, of which those of the joint ones are exact.
    fn joint_variances(&self, real: &[f64]) -> Vec<f64> {
        let mut all = real[self.grid.joint_pairs()..].to_vec();
        for (pair, moment) in self.grid.pairs.iter().zip(real).take(self.grid.joint_pairs()) {
            if pair[0] == pair[1] {
                all[pair[0]] = *moment;
            }
        }
        all
    }

    /// Returns the standard deviations at the jointly fitted horizons.
    fn at_joint(&self, variances: &[f64]) -> Vec<f64> {
        self.grid.joint.iter().map(|place| variances[*place].max(0.0).sqrt()).collect()
    }
}

/// Returns the root of a variance over a value of the Allan deviation, if that is above 0.
fn over(variance: f64, allan: Option<f64>) -> Option<f64> {
    let allan = allan.filter(|allan| *allan > 0.0)?;
    Some(variance.sqrt() / allan)
}
