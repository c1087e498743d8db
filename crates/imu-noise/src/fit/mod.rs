//! The fit: noise parameters from Allan variances.
//!
//! [`fit`] takes the points of a curve and returns N, B, K, Q and R with 95 % intervals that hold ("monte_carlo.rs" has
//! the figures). It also reports which parameters the data does not support, and whether the model describes the data
//! at all.
//!
//! # Validation
//! 300 records of 5 h at 40 Hz (`monte_carlo.rs`, whose generator is independent of the program's simulator), N 3.5e-3:
//!
//! | truth | root mean square error of N, B, K | 95 % intervals that hold | K named | residual p < 0.05 |
//! |---|---|---|---|---|
//! | B 1e-3, K 5e-5 | 0.09 %, 4.0 %, 23.8 % (bound 0.085 %, 3.8 %, 22 %) | 95.0 %, 93.3 %, 95.7 % with limits | 80 % | 6.7 % |
//! | B 0, K 5e-5 | 0.09 %, B named in 2.7 %, 11.3 % | 93.7 %, limits on B 100 %, 94.0 % | 100 % | 5.7 % |
//! | B 1e-3, K 1.5e-5 | 0.08 %, 3.6 %, not identifiable | 94.7 %, 94.0 %, limits on K 100 % | 6 % | 6.3 % |

mod covariance;
mod least_squares;
#[cfg(test)]
mod monte_carlo;
mod parameters;
mod report;
pub(crate) mod selection;
mod term;
mod variance_fit;

pub use parameters::{
    Bandwidth, Estimate, FitSummary, FittedCurve, Flag, GaussMarkov, Minimum, NoiseParameters, RecordNeeded,
    gauss_markov_variance, unit,
};
pub use report::NoiseReport;
pub use term::Term;
pub(crate) use term::response;

use crate::allan::AllanPoint;
use crate::whittle::{Filter, MISFIT, Sampling};
use imu_core::sample::Channel;
use variance_fit::{Choice, VarianceFit};

/// Name of the method in JSON.
pub const METHOD: &str = "wls-avar";
/// Maximum number of shortest averaging times that are left out if the model misfits with them.
const SHAPED: usize = 6;
/// Number of further averaging times that are then also left out.
const BEYOND: usize = 3;

/// Fits the noise parameters of a channel to its overlapping Allan variances; `rate_hz` is finite and above 0.
///
/// Points may come from any grid, of [`AllanSums::points`](crate::allan::AllanSums::points) or
/// [`LiveAllan::points`](crate::allan::LiveAllan::points). The function never fails: a parameter that cannot be
/// determined is not identified, and a flag states why.
pub fn fit(points: &[AllanPoint], rate_hz: f64, channel: Channel) -> NoiseParameters {
    fit_as_sampled(points, rate_hz, channel, None)
}

/// Fits as [`fit`] does, for samples with a known `sampling`: its boxcar is then part of the law.
pub fn fit_as_sampled(
    points: &[AllanPoint],
    rate_hz: f64,
    channel: Channel,
    sampling: Option<&Sampling>,
) -> NoiseParameters {
    let filter = sampling.and_then(|sampling| sampling.filter(rate_hz));
    let mut parameters = of_law(points, rate_hz, channel, filter.as_ref());
    parameters.bandwidth = sampling.filter(|_| filter.is_some()).map(Sampling::bandwidth);
    let factor = sampling.and_then(|sampling| sampling.density_factor(rate_hz));
    parameters.n.internal = parameters.n.value.zip(factor).map(|(density, factor)| density / factor);
    parameters
}

fn of_law(points: &[AllanPoint], rate_hz: f64, channel: Channel, filter: Option<&Filter>) -> NoiseParameters {
    let constant = !points.is_empty() && points.iter().all(|point| point.variance == 0.0);
    let of = |points: &[AllanPoint]| {
        VarianceFit::new(points, 1.0 / rate_hz, filter).and_then(|fit| Some((fit.choose()?, fit)))
    };
    let fitted = if rate_hz.is_finite() && rate_hz > 0.0 { of(points) } else { None };
    let misfits = fitted.as_ref().is_some_and(|(choice, _)| !choice.describes());
    // A filter inside the band only affects the shortest averaging times.
    let longer = || {
        let first =
            (1..=SHAPED).find(|from| points.get(*from..).and_then(of).is_some_and(|(choice, _)| choice.describes()))?;
        // The part that a filter removes halves from octave to octave: tests stop detecting it before it has vanished.
        let found = |from: usize| points.get(from..).and_then(of).map(|found| (from, found));
        (first..=first + BEYOND).rev().find_map(found)
    };
    if let Some((from, (choice, fit))) = misfits.then(longer).flatten() {
        let mut parameters = of_choice(&choice, &fit, channel);
        let from_s = points.get(from).map_or(0.0, |point| point.m as f64 / rate_hz);
        let note = format!(
            "averaging times below {from_s:.4} s took no part: a filter, or a vibration, shapes the noise there; the job that \
             follows the capture says which"
        );
        parameters.flags.push(Flag::whole("shaped_band", note));
        return parameters;
    }
    match fitted {
        Some((choice, fit)) => of_choice(&choice, &fit, channel),
        None if constant => {
            nothing(channel, METHOD, Flag::whole("constant", "every sample has the same value: no noise to be seen"))
        }
        None => {
            let needed = 4 << (VarianceFit::LEAST_POINTS - 1);
            let note = format!(
                "fewer than {} octaves of averaging time: record at least {needed} samples without a gap",
                VarianceFit::LEAST_POINTS
            );
            nothing(channel, METHOD, Flag::whole("insufficient", note))
        }
    }
}

fn of_choice(choice: &Choice, fit: &VarianceFit, channel: Channel) -> NoiseParameters {
    let intervals = fit.intervals(&choice.model, choice.widen);
    let estimate = |term: Term| {
        let found =
            choice.model.squares.iter().position(|(other, _)| *other == term).filter(|at| choice.identified[*at]);
        if let (Some(at), Some(intervals)) = (found, &intervals) {
            let (value, ci95) = (choice.model.squares[at].1.sqrt(), intervals[at]);
            if value.is_finite() && ci95.iter().all(|end| end.is_finite()) {
                return Estimate::identified(channel, term, value, ci95);
            }
        }
        let limit = fit.upper_limit(&choice.model, term, choice.widen).filter(|limit| limit.is_finite());
        Estimate::unidentified(channel, term, limit)
    };
    let mut flags = Vec::new();
    if let Some(residual) = choice.residual.filter(|residual| residual.p_value < MISFIT) {
        let note = format!(
            "white, flicker and random-walk noise do not describe the Allan deviation (χ² {:.0} at {} degrees of freedom); \
             intervals are widened by {:.1}",
            residual.chi2, residual.degrees_of_freedom, choice.widen
        );
        flags.push(Flag::whole("misfit", note));
    }
    let summary = FitSummary::of(
        METHOD,
        choice.residual.map(|of| (of.chi2, of.degrees_of_freedom, of.p_value)),
        Some(fit.curve(&choice.model)),
    );
    NoiseParameters::of(channel, estimate, summary, flags)
}

/// Returns the result if no parameter can be determined.
pub(crate) fn nothing(channel: Channel, method: &str, flag: Flag) -> NoiseParameters {
    let estimate = |term| Estimate::unidentified(channel, term, None);
    let reason = Some(flag.note.clone());
    let summary = FitSummary::of(method, None, None);
    NoiseParameters { usable: false, reason, ..NoiseParameters::of(channel, estimate, summary, vec![flag]) }
}

/// Panics if a number is not finite. JSON writes it as null, which cannot be read back in a list of numbers and
/// silently makes an optional number absent.
#[cfg(test)]
pub(crate) fn assert_finite(parameters: &NoiseParameters) {
    let text = serde_json::to_string(parameters).unwrap();
    let back: NoiseParameters = serde_json::from_str(&text).unwrap();
    // Detects null in place of a number: the text of the value that was read back has no other absent field.
    let absent = |of: &NoiseParameters| format!("{of:?}").matches("None").count();
    assert_eq!(absent(&back), absent(parameters), "{parameters:?}");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allan::{FixedPoint, LiveAllan, Overlapping, TauGrid};

    /// Returns the generator of NIST SP1065, less its mean: white noise of variance 1/12.
    fn white() -> impl Iterator<Item = f64> {
        let mut state = 1_234_567_890u64;
        std::iter::repeat_with(move || {
            let value = state as f64 / 2_147_483_647.0 - 0.5;
            state = 16_807 * state % 2_147_483_647;
            value
        })
    }

    fn of(samples: &[f64], grid: TauGrid) -> NoiseParameters {
        let mut estimator = Overlapping::new(FixedPoint::for_channel(Channel::GyroX), grid);
        estimator.push(samples);
        fit(&estimator.sums().points(), 40.0, Channel::GyroX)
    }

    /// Finding A1 while a capture runs: means of four at 800 Hz.
    #[test]
    fn a_filter_inside_the_band_costs_the_shortest_averaging_times_alone() {
        let mut live = LiveAllan::new(FixedPoint::for_channel(Channel::GyroX));
        let white: Vec<f64> = white().take(400_000).collect();
        let means: Vec<f64> = white.windows(4).map(|four| four.iter().sum::<f64>() / 4.0 * 1e-3).collect();
        live.push(&means);
        let found = fit(&live.points(), 800.0, Channel::GyroX);
        // The generator's density is 1e-3/√12 times the root of the period.
        let density = 1e-3 / (12.0f64 * 800.0).sqrt();
        assert!(found.n.ci95.is_some_and(|[low, high]| low < density && density < high), "{density} {:?}", found.n);
        assert!(found.flags.iter().any(|flag| flag.kind == "shaped_band"), "{:?}", found.flags);
        assert!(found.k.value.is_none() && found.b.value.is_none(), "{found:?}");
    }

    #[test]
    fn a_known_boxcar_is_part_of_the_law() {
        let mut live = LiveAllan::new(FixedPoint::for_channel(Channel::GyroX));
        let white: Vec<f64> = white().take(400_000).collect();
        let means: Vec<f64> = white.windows(4).map(|four| four.iter().sum::<f64>() / 4.0 * 1e-3).collect();
        live.push(&means);
        let sampling = Sampling { internal_rate_hz: 800.0, window: 4, source: "register 85".to_owned() };
        let found = fit_as_sampled(&live.points(), 800.0, Channel::GyroX, Some(&sampling));
        let density = 1e-3 / (12.0f64 * 800.0).sqrt();
        assert!(found.n.value.is_some_and(|n| (n / density - 1.0).abs() < 0.01), "{density} {:?}", found.n);
        assert!(
            found.n.ci95.is_some_and(|[low, high]| low < density && density < high && high / low < 1.03),
            "{found:?}"
        );
        assert!(found.flags.is_empty() && found.b.value.is_none() && found.k.value.is_none(), "{found:?}");
        assert_eq!(found.bandwidth.map(|of| (of.kind, of.value)), Some(("moving_average".to_owned(), Some(4.0))));
        // At a fifth of the internal rate, the boxcar of four leaves white noise white.
        assert_eq!(fit_as_sampled(&live.points(), 160.0, Channel::GyroX, Some(&sampling)).bandwidth, None);
    }

    #[test]
    fn white_noise_has_n_and_limits_on_all_else() {
        let samples: Vec<f64> = white().take(300_000).map(|value| value * 0.02).collect();
        let truth = 0.02 / 12f64.sqrt() / 40f64.sqrt();
        for grid in [TauGrid::octave(300_000), TauGrid::log(300_000)] {
            let parameters = of(&samples, grid.unwrap());
            let n = parameters.n.clone();
            assert!((n.value.unwrap() / truth - 1.0).abs() < 5e-3, "{n:?}");
            let [low, high] = n.ci95.unwrap();
            assert!(low < truth && truth < high && high / low < 1.02, "{n:?}");
            for term in [Term::B, Term::K, Term::Q, Term::R] {
                let estimate = parameters.estimate(term);
                assert!(!estimate.identified && estimate.value.is_none(), "{term:?} {estimate:?}");
                assert!(estimate.upper_limit95.is_some_and(|limit| limit > 0.0), "{term:?} {estimate:?}");
            }
            assert!(parameters.fit.p_value.unwrap() > 0.001 && parameters.flags.is_empty(), "{parameters:?}");
        }
    }

    /// Set (b) of the reference values: white noise, random walk and ramp of known size.
    #[test]
    fn white_walk_and_ramp_are_distinguished() {
        let mut stream = white();
        let mut walk = 0.0;
        let samples: Vec<f64> = (0..720_000)
            .map(|i| {
                let (white, step) = (stream.next().unwrap(), stream.next().unwrap());
                walk += step * 1e-5;
                white * 0.02 + walk + 1e-8 * f64::from(i)
            })
            .collect();
        let parameters = of(&samples, TauGrid::log(720_000).unwrap());
        for (term, truth) in [(Term::N, 9.128_709e-4), (Term::K, 1.825_742e-5)] {
            let estimate = parameters.estimate(term);
            let [low, high] = estimate.ci95.unwrap();
            assert!(low < truth && truth < high, "{term:?} {estimate:?}");
        }
        assert!((parameters.n.value.unwrap() / 9.128_709e-4 - 1.0).abs() < 3e-3);
        assert!(!parameters.b.identified, "{:?}", parameters.b);
    }

    #[test]
    fn a_strong_ramp_is_named() {
        let samples: Vec<f64> =
            white().take(100_000).enumerate().map(|(i, white)| white * 0.02 + 4e-7 * i as f64).collect();
        let parameters = of(&samples, TauGrid::octave(100_000).unwrap());
        let r = parameters.r.value.unwrap();
        assert!((r / 1.6e-5 - 1.0).abs() < 0.05, "{:?}", parameters.r);
    }

    #[test]
    fn white_angle_noise_is_named_q() {
        let mut last = 0.0;
        let samples: Vec<f64> = white()
            .take(100_000)
            .map(|angle| {
                let rate = (angle - last) * 40.0 * 1e-3;
                last = angle;
                rate
            })
            .collect();
        let parameters = of(&samples, TauGrid::octave(100_000).unwrap());
        let truth = 1e-3 / 12f64.sqrt();
        assert!((parameters.q.value.unwrap() / truth - 1.0).abs() < 0.02, "{:?}", parameters.q);
        assert_eq!(parameters.q.unit, "rad");
    }

    #[test]
    fn the_live_pyramid_gives_the_same_parameters() {
        let samples: Vec<f64> = white().take(200_000).map(|value| value * 0.02).collect();
        let mut live = LiveAllan::new(FixedPoint::for_channel(Channel::GyroX));
        live.push(&samples);
        let live = fit(&live.points(), 40.0, Channel::GyroX);
        let exact = of(&samples, TauGrid::octave(200_000).unwrap());
        assert!((live.n.value.unwrap() / exact.n.value.unwrap() - 1.0).abs() < 1e-4);
    }

    #[test]
    fn too_little_or_constant_data_is_reported_as_such_and_no_number_is_nan() {
        for (count, value, kind) in [(0, 0.0, "insufficient"), (20, 0.1, "insufficient"), (5000, 0.0, "constant")] {
            let samples: Vec<f64> = white().take(count).map(|white| 0.5 + white * value).collect();
            let grid = TauGrid::octave(5000).unwrap();
            let parameters = of(&samples, grid);
            assert_eq!(parameters.flags[0].kind, kind, "{count}");
            for term in Term::ALL {
                assert!(!parameters.estimate(term).identified);
            }
            assert_finite(&parameters);
        }
    }

    #[test]
    fn numbers_that_are_not_finite_are_seen_wherever_they_stand() {
        let samples: Vec<f64> = white().take(4000).collect();
        let whole = of(&samples, TauGrid::octave(4000).unwrap());
        assert_finite(&whole);
        let spoilt: [fn(&mut NoiseParameters); 5] = [
            |of| of.n.value = Some(f64::NAN),
            |of| of.k.upper_limit95 = Some(f64::INFINITY),
            |of| of.n.ci95 = Some([0.0, f64::INFINITY]),
            |of| of.fit.p_value = Some(f64::NAN),
            |of| of.fit.curve.as_mut().unwrap().deviation[0] = f64::NAN,
        ];
        for (number, spoil) in spoilt.into_iter().enumerate() {
            let mut parameters = whole.clone();
            spoil(&mut parameters);
            assert!(std::panic::catch_unwind(|| assert_finite(&parameters)).is_err(), "{number}");
        }
    }

    #[test]
    fn short_records_of_every_length_give_finite_numbers() {
        let samples: Vec<f64> = white().take(4000).collect();
        for count in (1..200).chain([500, 1000, 3999]) {
            let Ok(grid) = TauGrid::log(count as u64) else { continue };
            let parameters = of(&samples[..count], grid);
            assert_finite(&parameters);
            if let Some(n) = parameters.n.value {
                assert!((0.1..10.0).contains(&(n / (1.0 / 480f64.sqrt()))), "{count} samples: {:?}", parameters.n);
            }
        }
    }

    /// A VN-100 on a desk for 754 s, with knocks, creep and vibration (the densities are those that its accelerometer
    /// shows above them).
    #[test]
    fn a_desk_recording_has_the_densities_of_its_sensor() {
        use std::io::Read;
        let Some(path) = vn100_testkit::real_data("vn100-desk/live_capture.txt.gz") else { return };
        let mut text = String::new();
        flate2::read::GzDecoder::new(std::fs::File::open(path).unwrap()).read_to_string(&mut text).unwrap();
        let column = |index: usize| -> Vec<f64> {
            text.lines().map(|line| line.split(['*', ',']).nth(index).unwrap().parse().unwrap()).collect()
        };
        for (index, channel, density) in [
            (7, Channel::AccelX, 0.00198),
            (8, Channel::AccelY, 0.00189),
            (9, Channel::AccelZ, 0.00277),
            (10, Channel::GyroX, 1.18e-4),
            (11, Channel::GyroY, 1.16e-4),
            (12, Channel::GyroZ, 1.12e-4),
        ] {
            let samples = column(index);
            let grid = TauGrid::log(samples.len() as u64).unwrap();
            let mut estimator = Overlapping::new(FixedPoint::for_channel(channel), grid);
            estimator.push(&samples);
            let parameters = fit(&estimator.sums().points(), 40.0, channel);
            let n = &parameters.n;
            let misfit = parameters.flags.iter().any(|flag| flag.kind == "misfit");
            // Vibration at 13.38 Hz adds 6 % to the gyroscope's N, which Allan variances cannot separate from white
            // noise; if the fit is flagged, the interval is wide.
            let allowed = if misfit { 2.7 } else { 1.07 };
            let ratio = n.value.unwrap() / density;
            assert!((1.0 / allowed..allowed).contains(&ratio), "{channel}: {n:?}");
            let [low, high] = n.ci95.unwrap();
            assert!(low < high && high.is_finite(), "{channel}: {n:?}");
        }
    }
}
