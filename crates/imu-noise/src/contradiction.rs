//! Contradiction: compares the prediction of a fit with the measured Allan deviation.
//!
//! A fit that departs from the measured curve is wrong, even if its own residuals are small. The responsible parameters
//! are then withheld. Values that the curve alone supports replace them and are marked.
//!
//! # Validation
//! `tests` below; `examples/noise_worlds.rs` counts how often a fit of the true law is refused; docs/validation.md has
//! the table.

use super::allan::{AllanCurve, AllanPoint, NoiseType, confidence_factors, first_fall};
use super::fit::{Bandwidth, Estimate, FittedCurve, Minimum, NoiseParameters, RecordNeeded, Term, response};
use super::needed::walk_shows_beyond_s;
use imu_core::sample::Channel;

/// The chance with which a true prediction may leave the measured curve at any averaging time.
const LEVEL: f64 = 0.01;
/// The error of the prediction itself, as a share of the deviation: smaller departures are ignored.
const TOLERANCE: f64 = 0.01;
/// A term is responsible if it makes up more than this of the predicted or the missing variance.
const SHARE: f64 = 0.1;
/// The mark of a value that the curve alone supports.
const SOURCE: &str = "allan deviation";
/// Maximum deviation from −½ of the slope between two octaves of white noise.
const SLOPE: f64 = 0.05;

/// An averaging time at which the prediction leaves the measured interval.
struct Place {
    tau_s: f64,
    measured: f64,
    interval: [f64; 2],
    predicted: f64,
    /// Index in the fitted curve.
    at: usize,
}

/// Compares the parameters with the measured points, and records the lowest point beside B, how long a record has to
/// be, and from which averaging time on a walk would show.
///
/// All averaging times together are one test at 1 %: each has its share (Bonferroni). `rate_hz` is finite and above 0.
/// `excluded_bands_hz` are bands in which samples were reduced to a background that is only partly known. The
/// contribution of white noise in these bands to the variance of an averaging time widens its interval.
pub fn hold_against(
    parameters: &mut NoiseParameters,
    points: &[AllanPoint],
    rate_hz: f64,
    channel: Channel,
    excluded_bands_hz: &[[f64; 2]],
) {
    contradict(parameters, points, rate_hz, channel, excluded_bands_hz);
    let usable = parameters.usable;
    let needed = || RecordNeeded::of(parameters, rate_hz);
    parameters.record_needed = if usable { needed() } else { RecordNeeded::default() };
    parameters.walk_shows_beyond_s = if usable { walk_shows_beyond_s(parameters) } else { None };
}

fn contradict(
    parameters: &mut NoiseParameters,
    points: &[AllanPoint],
    rate_hz: f64,
    channel: Channel,
    excluded_bands_hz: &[[f64; 2]],
) {
    // At short averaging times, a filter reduces all terms, so that the lowest point does not count there.
    let settled_s = parameters.bandwidth.as_ref().map_or(0.0, |of| settled_s(of, rate_hz));
    let settled: Vec<AllanPoint> =
        points.iter().filter(|point| point.m as f64 / rate_hz >= settled_s).copied().collect();
    parameters.minimum = AllanCurve::from_points(&settled, rate_hz, channel.unit())
        .minimum(5.0)
        .filter(|(_, deviation)| *deviation > 0.0)
        .map(|(tau_s, deviation)| Minimum { deviation, tau_s, over_0_664: deviation / 0.664 });
    // Frequencies that took no part are also unknown.
    let beyond = parameters.bandwidth.as_ref().and_then(|of| of.up_to_hz).map(|up_to_hz| [up_to_hz, rate_hz]);
    let unknown_hz: Vec<[f64; 2]> = excluded_bands_hz.iter().copied().chain(beyond).collect();
    let unknown = |tau_s: f64| share_of((tau_s * rate_hz).round() as usize, rate_hz, &unknown_hz);
    let found = places(parameters, points, rate_hz, unknown);
    let apart = |place: &Place| (place.predicted.max(f64::MIN_POSITIVE) / place.measured).ln().abs();
    let Some(worst) = found.iter().max_by(|a, b| apart(a).total_cmp(&apart(b))) else { return };
    let Place { tau_s, measured: seen, interval: [low, high], predicted, .. } = *worst;
    let unit = channel.unit();
    parameters.usable = false;
    parameters.reason = Some(format!(
        "the fitted noise predicts an Allan deviation of {predicted:.3e} {unit} at {tau_s:.4} s, where {seen:.3e} [{low:.2e}, \
         {high:.2e}] was measured: the model does not describe this record"
    ));
    withhold(parameters, &Supported::of(points, rate_hz), channel, &found);
    // A filter that was fitted with the parameters is withheld with them; a known filter stays.
    parameters.bandwidth = parameters.bandwidth.take().filter(|of| of.internal_rate_hz.is_some());
}

/// Returns the averaging time from which on a filter passes the noise that the curve shows, s: a mean's length, half a
/// period of a cutoff.
fn settled_s(bandwidth: &Bandwidth, rate_hz: f64) -> f64 {
    match (bandwidth.kind.as_str(), bandwidth.value) {
        ("moving_average", Some(window)) => window / bandwidth.internal_rate_hz.unwrap_or(rate_hz),
        (_, Some(cutoff_hz)) if cutoff_hz > 0.0 => 0.5 / cutoff_hz,
        _ => 0.0,
    }
}

/// Returns the places where the prediction leaves the curve.
///
/// The degrees of freedom are those of the noise that the prediction has there: for a true prediction, the measured
/// slope would only add chance. `unknown` is the share of the variance that is only partly known, by averaging time.
fn places(
    parameters: &NoiseParameters,
    points: &[AllanPoint],
    rate_hz: f64,
    unknown: impl Fn(f64) -> f64,
) -> Vec<Place> {
    let Some(fitted) = &parameters.fit.curve else { return Vec::new() };
    let slopes = slopes(fitted);
    let pairs: Vec<(usize, &AllanPoint, f64)> = fitted
        .tau_s
        .iter()
        .zip(slopes)
        .enumerate()
        .filter_map(|(at, (tau_s, slope))| {
            let own = points.iter().find(|point| (point.m as f64 / rate_hz / tau_s - 1.0).abs() < 1e-6)?;
            let edf = own.edf(NoiseType::of_variance_slope(slope));
            (edf >= 1.0).then_some((at, own, edf))
        })
        .collect();
    let level = LEVEL / pairs.len().max(1) as f64;
    let place = |(at, own, edf): (usize, &AllanPoint, f64)| {
        let (seen, predicted) = (own.variance.sqrt(), *fitted.deviation.get(at)?);
        let factors = confidence_factors(edf, 1.0 - level)?;
        let unknown = unknown(*fitted.tau_s.get(at)?);
        let interval =
            [seen * factors.low * (1.0 - unknown).max(0.0).sqrt(), seen * factors.high * (1.0 + unknown).sqrt()];
        let inside = (interval[0] * (1.0 - TOLERANCE)..=interval[1] * (1.0 + TOLERANCE)).contains(&predicted);
        (!inside).then_some(Place { tau_s: *fitted.tau_s.get(at)?, measured: seen, interval, predicted, at })
    };
    pairs.into_iter().filter_map(place).collect()
}

/// Returns the slopes of the fitted Allan variance in double logarithms, at each of its averaging times.
fn slopes(fitted: &FittedCurve) -> Vec<f64> {
    let logs: Vec<(f64, f64)> = fitted
        .tau_s
        .iter()
        .zip(&fitted.deviation)
        .map(|(tau_s, deviation)| (tau_s.ln(), 2.0 * deviation.ln()))
        .collect();
    let at = |place: usize| {
        let (one, other) = (logs[place.saturating_sub(1)], logs[(place + 1).min(logs.len() - 1)]);
        let slope = (other.1 - one.1) / (other.0 - one.0);
        if slope.is_finite() { slope } else { -1.0 }
    };
    (0..logs.len()).map(at).collect()
}

/// Returns the share of the Allan variance of white noise at averaging factor `m` that lies in bands.
fn share_of(m: usize, rate_hz: f64, bands_hz: &[[f64; 2]]) -> f64 {
    const POINTS: usize = 4096;
    if bands_hz.is_empty() {
        return 0.0;
    }
    // The response has lobes of width 1/m: the grid covers the first few.
    let end = (8.0 / m as f64).min(0.5);
    let (mut inside, mut all) = (0.0, 0.0);
    for point in 0..POINTS {
        let u = (point as f64 + 0.5) / POINTS as f64 * end;
        let own = response(m, u);
        all += own;
        if bands_hz.iter().any(|[from, to]| (from..=to).contains(&&(u * rate_hz))) {
            inside += own;
        }
    }
    if all > 0.0 { inside / all } else { 0.0 }
}

/// Withholds the responsible parameters and replaces them with values that the curve alone supports.
fn withhold(parameters: &mut NoiseParameters, measured: &Supported, channel: Channel, found: &[Place]) {
    let lowest_s = parameters.minimum.map_or(f64::INFINITY, |minimum| minimum.tau_s);
    let share = |letter: &str, place: &Place| {
        let curve = parameters.fit.curve.as_ref()?;
        let own = *curve.parts.get(letter)?.get(place.at)?;
        Some((own / place.predicted).powi(2) > SHARE)
    };
    // The missing variance may belong to any term that is possible there: N and Q before the lowest point, the others
    // from it on.
    let lacks = |term: Term, place: &Place| {
        place.predicted < place.measured && (place.tau_s < lowest_s) == matches!(term, Term::N | Term::Q)
    };
    let blamed = |term: Term| found.iter().any(|place| share(term.letter(), place) == Some(true) || lacks(term, place));
    let terms: Vec<Term> = Term::ALL.into_iter().filter(|term| blamed(*term)).collect();
    let is_process = found.iter().any(|place| share("gauss_markov", place) == Some(true));
    for term in terms {
        let instead = match term {
            Term::N => white(measured).map(|(value, ci95)| Estimate {
                internal: parameters.n.internal.zip(parameters.n.value).map(|(internal, of)| value * internal / of),
                ..Estimate::identified(channel, term, value, ci95)
            }),
            // With the scatter of the curve, whose lowest point alone is often below the level of B.
            Term::B => {
                limit(measured, |_| 0.664 * 0.664).map(|limit| Estimate::unidentified(channel, term, Some(limit)))
            }
            Term::K => {
                limit(measured, |tau_s| tau_s / 3.0).map(|limit| Estimate::unidentified(channel, term, Some(limit)))
            }
            Term::R => limit(measured, |tau_s| tau_s * tau_s / 2.0)
                .map(|limit| Estimate::unidentified(channel, term, Some(limit))),
            Term::Q => None,
        };
        let instead = instead.map(|estimate| Estimate { source: Some(SOURCE.to_owned()), ..estimate });
        let instead = instead.unwrap_or_else(|| Estimate::unidentified(channel, term, None));
        *match term {
            Term::N => &mut parameters.n,
            Term::B => &mut parameters.b,
            Term::K => &mut parameters.k,
            Term::Q => &mut parameters.q,
            Term::R => &mut parameters.r,
        } = instead;
    }
    if is_process {
        parameters.gauss_markov = None;
    }
}

/// The measured curve with the smallest degrees of freedom that any noise leaves, because the noise of a withheld fit
/// is not reliable.
struct Supported {
    /// τ in s, deviation and degrees of freedom.
    rows: Vec<(f64, f64, f64)>,
}

impl Supported {
    fn of(points: &[AllanPoint], rate_hz: f64) -> Self {
        const KINDS: [NoiseType; 3] = [NoiseType::WhiteRate, NoiseType::FlickerRate, NoiseType::RandomWalkRate];
        let row = |point: &AllanPoint| {
            let edf = KINDS.iter().map(|kind| point.edf(*kind)).fold(f64::INFINITY, f64::min);
            (point.m as f64 / rate_hz, point.variance.sqrt(), edf)
        };
        Self { rows: points.iter().map(row).filter(|row| row.2 >= 1.0).collect() }
    }
}

/// Returns the density of white noise from the longest run of octaves whose slope is −½, with the range of their 95 %
/// intervals. These reach down to the value at which flicker makes the whole lowest point.
fn white(measured: &Supported) -> Option<(f64, [f64; 2])> {
    let rows = measured.rows.iter().copied();
    let all: Vec<(f64, f64, f64)> = rows.filter(|(_, deviation, edf)| *deviation > 0.0 && *edf >= 5.0).collect();
    let is_white = |pair: &&[(f64, f64, f64)]| match pair {
        [(one_s, one, edf_one), (two_s, two, edf_two)] => {
            let slope = (two / one).ln() / (two_s / one_s).ln();
            // The standard error of a logarithm of a deviation is 1/√(2 edf).
            let error = (0.5 / edf_one + 0.5 / edf_two).sqrt() / (two_s / one_s).ln();
            error < SLOPE && (slope + 0.5).abs() < SLOPE
        }
        _ => false,
    };
    let mut best: Option<(usize, usize)> = None;
    let mut from = 0;
    for at in 0..=all.len() {
        let goes_on = all.get(at..at + 2).is_some_and(|pair| is_white(&pair));
        if !goes_on {
            if at > from && best.is_none_or(|(start, end)| at - from > end - start) {
                best = Some((from, at));
            }
            from = at + 1;
        }
    }
    let (from, to) = best?;
    let run = all.get(from..=to)?;
    let density = |(tau_s, deviation, _): &(f64, f64, f64)| deviation * tau_s.sqrt();
    let weight: f64 = run.iter().map(|row| row.2).sum();
    let value = run.iter().map(|row| density(row) * row.2).sum::<f64>() / weight;
    // All of the curve's lowest point may be noise that reduces the white noise.
    let lowest = all.iter().fold(f64::INFINITY, |lowest, row| lowest.min(row.1));
    let ends = run.iter().filter_map(|row| {
        let factors = confidence_factors(row.2, 0.95)?;
        let alone = (row.1 * factors.low).powi(2) - lowest * lowest;
        Some([(alone.max(0.0) * row.0).sqrt(), density(row) * factors.high])
    });
    let ci95 = ends.fold([f64::INFINITY, 0.0f64], |[low, high], [l, h]| [low.min(l), high.max(h)]);
    Some((value, ci95))
}

/// Returns the coefficient above which a term of variance `square`(τ) alone would exceed the measured curve, with 97.5
/// % confidence: the lowest coefficient over all averaging times, each of which has its share of the remaining
/// probability.
fn limit(measured: &Supported, square: impl Fn(f64) -> f64) -> Option<f64> {
    let octaves =
        measured.rows.first().zip(measured.rows.last()).map_or(0.0, |(first, last)| (last.0 / first.0).log2());
    let level = 0.05 / (octaves + 1.0);
    // At shorter averaging times, a filter may have removed most of the term.
    let from = first_fall(measured.rows.iter().map(|(_, deviation, edf)| (*deviation, *edf)));
    let limits = measured.rows.iter().skip(from).filter_map(|(tau_s, deviation, edf)| {
        Some(deviation * confidence_factors(*edf, 1.0 - level)?.high / square(*tau_s).sqrt())
    });
    limits.filter(|limit| limit.is_finite() && *limit > 0.0).min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::super::NoiseParameters;
    use super::super::robust::{All, Company, Levels, Part, Record, spectral_sums};
    use super::*;
    use crate::allan::FixedPoint;
    use rand::SeedableRng as _;
    use rand_distr::{Distribution as _, StandardNormal};

    const RATE_HZ: f64 = 100.0;

    fn white(count: usize, density: f64, seed: u64) -> Vec<f64> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let sigma = density * RATE_HZ.sqrt();
        (0..count)
            .map(|_| {
                let unit: f64 = StandardNormal.sample(&mut rng);
                sigma * unit
            })
            .collect()
    }

    fn fitted(values: Vec<f64>) -> (NoiseParameters, Vec<AllanPoint>) {
        let parts = vec![Part { start_s: 0.0, values }];
        let sums = spectral_sums(&parts, FixedPoint::for_channel(Channel::GyroX));
        let all = All::of(Channel::GyroX, RATE_HZ, &sums, None);
        let record = Record::of(Channel::GyroX, RATE_HZ, parts, &Levels::new(RATE_HZ, 0), Company::Alone);
        let points = record.points().to_vec();
        (record.alone(Channel::GyroX, RATE_HZ, &all).0, points)
    }

    #[test]
    fn bands_that_are_known_in_part_widen_what_they_touch() {
        // The whole band has the whole variance; the upper half matters at one sample and hardly at sixteen.
        assert!((share_of(1, RATE_HZ, &[[0.0, 50.0]]) - 1.0).abs() < 1e-12);
        let (short, long) = (share_of(1, RATE_HZ, &[[25.0, 50.0]]), share_of(16, RATE_HZ, &[[25.0, 50.0]]));
        assert!(short > 0.7 && short < 0.95 && long < 0.05, "{short} {long}");
    }

    #[test]
    fn a_true_fit_is_usable_and_has_its_lowest_point_beside_it() {
        let (parameters, _) = fitted(white(60_000, 1e-3, 1));
        assert!(parameters.usable && parameters.reason.is_none(), "{:?}", parameters.reason);
        let lowest = parameters.minimum.unwrap();
        assert!((lowest.over_0_664 * 0.664 / lowest.deviation - 1.0).abs() < 1e-12 && lowest.tau_s > 10.0);
    }

    /// Returns y += a (x − y) of white noise of that density, plus a walk.
    fn smoothed(count: usize, a: f64, density: f64, walk: f64, seed: u64) -> Vec<f64> {
        let (mut y, mut drift) = (0.0, 0.0);
        let steps = white(count, walk / RATE_HZ, seed + 1);
        let sum = |(x, step): (f64, f64)| {
            y += a * (x - y);
            drift += step;
            y + drift
        };
        white(count, density, seed).into_iter().zip(steps).map(sum).collect()
    }

    /// The part that a filter removes at short averaging times was mistaken for the lowest deviation, and B had to be
    /// below it.
    #[test]
    fn what_a_filter_takes_is_no_lowest_point() {
        let (parameters, points) = fitted(smoothed(120_000, 0.05, 1e-3, 2e-4, 3));
        assert_eq!(parameters.bandwidth.as_ref().map(|of| of.kind.as_str()), Some("low_pass"), "{parameters:?}");
        let (lowest, shortest) = (parameters.minimum.unwrap(), points[0].variance.sqrt());
        assert!(lowest.tau_s > 0.5 && lowest.deviation > 1.1 * shortest, "{lowest:?} {shortest}");
        // A walk that hides the fall of the filtered noise has the same result.
        let (parameters, points) = fitted(smoothed(120_000, 0.05, 1e-3, 1e-3, 5));
        let (lowest, shortest) = (parameters.minimum.unwrap(), points[0].variance.sqrt());
        assert!(lowest.tau_s > 0.5 && lowest.deviation > 2.0 * shortest, "{lowest:?} {shortest}");
        // For white noise, and for a walk alone, all averaging times count.
        assert!(fitted(white(4000, 1e-3, 4)).0.minimum.unwrap().tau_s > 1.0);
        assert_eq!(first_fall([(1.0, 1000.0), (2.0, 500.0), (2.9, 20.0), (2.8, 5.0)].into_iter()), 0);
    }

    /// Filters were only searched in a record with a knock if a process describes the record as well.
    #[test]
    fn a_process_in_place_of_white_noise_is_a_filter_in_a_clean_record_too() {
        for seed in 0..4 {
            let (parameters, _) = fitted(smoothed(120_000, 0.06, 1e-3, 0.0, 100 * seed));
            assert!(parameters.bandwidth.is_some() && parameters.gauss_markov.is_none(), "{parameters:?}");
            let [low, high] = parameters.n.ci95.unwrap();
            assert!(low < 1e-3 && 1e-3 < high && high < 1.1e-3, "{:?}", parameters.n);
        }
    }

    /// N lay between the value without spikes and the value with them, and its interval contained neither.
    #[test]
    fn spikes_too_many_to_be_events_widen_the_interval_of_n() {
        for (every, size) in [(700, 0.2), (500, 0.2), (200, 1.0)] {
            let mut values = white(60_000, 1e-3, 7);
            let mut state = 1u64;
            for value in &mut values {
                state = 48_271 * state % 2_147_483_647;
                if state.is_multiple_of(every) {
                    *value += if state.is_multiple_of(2 * every) { size } else { -size };
                }
            }
            let (parameters, _) = fitted(values);
            assert!(parameters.flags.iter().any(|flag| flag.kind == "heavy_tails"), "{:?}", parameters.flags);
            let [low, high] = parameters.n.ci95.unwrap();
            let with = (1e-6 + size * size / every as f64 / RATE_HZ).sqrt();
            assert!(low < 1e-3 && 0.9 * with < high, "{every} {size}: {:?}", parameters.n);
        }
    }

    #[test]
    fn true_fits_are_refused_no_more_often_than_the_test_states() {
        // None of 600 is refused: the prediction follows the record with which it is compared.
        let refused = (0..600).filter(|seed| !fitted(white(4000, 1e-3, 100 + seed)).0.usable).count();
        assert!(refused <= 2, "{refused}");
    }

    #[test]
    fn a_fit_that_leaves_the_curve_is_withheld_and_the_curve_speaks_instead() {
        let (mut parameters, points) = fitted(white(60_000, 1e-3, 2));
        // As if a walk had been fitted in place of the sensor's filter: finding A1.
        let tau_s: Vec<f64> = (0..12).map(|octave| f64::from(1 << octave) / RATE_HZ).collect();
        let walk: Vec<f64> = tau_s.iter().map(|tau_s| 0.05 * (tau_s / 3.0).sqrt()).collect();
        let parts = [("K".to_owned(), walk.clone())].into();
        parameters.fit.curve = Some(FittedCurve { tau_s, deviation: walk, parts });
        parameters.n = Estimate::unidentified(Channel::GyroX, Term::N, Some(1e-5));
        parameters.k = Estimate::identified(Channel::GyroX, Term::K, 0.05, [0.049, 0.051]);
        (parameters.walk_shows_beyond_s, parameters.record_needed.b) = (Some(1.0), Some(1.0));
        parameters.bandwidth = Some(
            serde_json::from_value(serde_json::json!({"kind": "low_pass", "value": 9.0,
            "unit": "Hz", "order": 1, "ci95": null, "white_behind": null, "source": "fitted"}))
            .unwrap(),
        );
        hold_against(&mut parameters, &points, RATE_HZ, Channel::GyroX, &[]);
        assert!(!parameters.usable, "{parameters:?}");
        assert!(parameters.reason.as_ref().unwrap().contains("was measured"), "{:?}", parameters.reason);
        // No value that follows from the fit remains.
        assert_eq!((parameters.bandwidth.as_ref(), parameters.walk_shows_beyond_s), (None, None));
        assert_eq!(parameters.record_needed, RecordNeeded::default());
        let n = &parameters.n;
        assert_eq!(n.source.as_deref(), Some("allan deviation"));
        assert!(
            n.ci95.is_some_and(|[low, high]| low < 1e-3 && 1e-3 < high) && (n.value.unwrap() / 1e-3 - 1.0).abs() < 0.02,
            "{n:?}"
        );
        let k = &parameters.k;
        assert!(k.value.is_none() && k.upper_limit95.unwrap() < 5e-4, "{k:?}");
    }
}
