//! The properties of the Whittle fit, on small records; `examples/noise_monte_carlo.rs` is the large form.

use super::*;
use crate::allan::FixedPoint;
use crate::fit::assert_finite;
use imu_model::effects::{Effect, Flicker, RandomWalk, Stream, StreamId, White};

const RATE_HZ: f64 = 40.0;

fn stream(seed: u64, effect: u16) -> Stream {
    Stream::new(seed, StreamId { owner: 9, effect, instance: 7 })
}

fn record(n: f64, b: f64, k: f64, samples: usize, seed: u64) -> Vec<f64> {
    let mut values = vec![0.0; samples];
    let length_s = samples as f64 / RATE_HZ;
    for (number, effect) in (1..).zip([&White { n } as &dyn Effect, &Flicker { b }, &RandomWalk { k }]) {
        effect.sampler(RATE_HZ, length_s, stream(seed, number)).apply(&mut values);
    }
    values
}

/// Returns a Gauss–Markov process.
fn process(sigma: f64, tc_s: f64, samples: usize, seed: u64) -> Vec<f64> {
    let (mut noise, phi) = (stream(seed, 900), (-1.0 / (RATE_HZ * tc_s)).exp());
    let mut state = sigma * noise.normal();
    (0..samples)
        .map(|_| {
            let value = state;
            state = phi * state + sigma * (1.0 - phi * phi).sqrt() * noise.normal();
            value
        })
        .collect()
}

fn sums_of(segments: &[&[f64]]) -> DstSums {
    let mut transform = Transform::new();
    let mut estimator = DstEstimator::new(FixedPoint::for_range(0, 6).unwrap());
    for segment in segments {
        estimator.push(&mut transform, segment);
        estimator.break_segment(&mut transform);
    }
    estimator.into_sums(&mut transform)
}

fn of(samples: &[f64]) -> NoiseParameters {
    fit(&sums_of(&[samples]), RATE_HZ, Channel::GyroX, &[], None)
}

fn holds(estimate: &Estimate, truth: f64) -> bool {
    match (estimate.ci95, estimate.upper_limit95) {
        (Some([low, high]), None) => (low..=high).contains(&truth),
        (None, Some(limit)) => limit >= truth,
        other => panic!("neither interval nor limit, or both: {other:?}"),
    }
}

/// Twenty records of 25 min: intervals and limits hold as often as expected, and errors are those of the Fisher
/// information.
#[test]
fn intervals_hold_and_errors_are_near_the_bound() {
    const SEEDS: u64 = 20;
    let truth = [3.5e-3, 1e-3, 3e-4];
    let (mut held, mut errors) = ([0; 3], [0.0; 3]);
    let mut false_names = 0;
    for seed in 1..=SEEDS {
        let parameters = of(&record(truth[0], truth[1], truth[2], 60_000, seed));
        assert_eq!(parameters.fit.method, "whittle-dst");
        for (index, term) in [Term::N, Term::B, Term::K].into_iter().enumerate() {
            let estimate = parameters.estimate(term);
            held[index] += u32::from(holds(estimate, truth[index]));
            errors[index] += (estimate.value.unwrap_or(truth[index]) / truth[index] - 1.0).powi(2);
        }
        let others = [Term::Q, Term::R].map(|term| parameters.estimate(term).identified);
        false_names +=
            others.into_iter().filter(|named| *named).count() + usize::from(parameters.gauss_markov.is_some());
    }
    let rmse = errors.map(|sum| (sum / SEEDS as f64).sqrt());
    println!("held {held:?}, errors {rmse:?}, named falsely {false_names}");
    // Fewer than 16 of 20 at 95 %: once in four hundred for each.
    assert!(held.iter().all(|count| *count >= 16), "{held:?}");
    // The bound for N is 0.31 %, for B and K about 13 % and 25 %.
    assert!(rmse[0] < 0.005 && rmse[1] < 0.25 && rmse[2] < 0.5, "{rmse:?}");
    assert!(false_names <= 3, "{false_names}");
}

#[test]
fn white_noise_has_n_and_limits_on_all_else() {
    let parameters = of(&record(1e-3, 0.0, 0.0, 120_000, 3));
    assert!((parameters.n.value.unwrap() / 1e-3 - 1.0).abs() < 6e-3, "{:?}", parameters.n);
    assert!(holds(&parameters.n, 1e-3));
    for term in [Term::B, Term::K, Term::Q, Term::R] {
        let estimate = parameters.estimate(term);
        assert!(
            !estimate.identified && estimate.upper_limit95.is_some_and(|limit| limit > 0.0),
            "{term:?} {estimate:?}"
        );
    }
    assert!(parameters.fit.p_value.unwrap() > 0.001 && parameters.flags.is_empty(), "{parameters:?}");
    let curve = parameters.fit.curve.unwrap();
    assert_eq!(curve.parts.keys().collect::<Vec<_>>(), ["N"]);
    assert!((curve.deviation[0] / (parameters.n.value.unwrap() * RATE_HZ.sqrt()) - 1.0).abs() < 1e-9);
}

#[test]
fn a_random_walk_alone_is_identified_and_flicker_is_not() {
    let parameters = of(&record(3.5e-3, 0.0, 3e-4, 120_000, 5));
    assert!(parameters.k.identified && holds(&parameters.k, 3e-4), "{:?}", parameters.k);
    assert!(!parameters.b.identified, "{:?}", parameters.b);
}

#[test]
fn a_gauss_markov_process_is_named_with_its_time() {
    const SEEDS: u64 = 8;
    let (mut sigma, mut tc_s) = (0, 0);
    for seed in 1..=SEEDS {
        let mut samples = record(3.5e-3, 0.0, 0.0, 240_000, seed);
        for (value, more) in samples.iter_mut().zip(process(2e-3, 60.0, 240_000, seed)) {
            *value += more;
        }
        let parameters = of(&samples);
        let found = parameters.gauss_markov.clone().expect("a process");
        sigma += u32::from(holds(&found.sigma, 2e-3));
        tc_s += u32::from(holds(&found.tc_s, 60.0));
        assert!(!parameters.b.identified && !parameters.k.identified, "{parameters:?}");
        assert_eq!((found.sigma.unit.as_str(), found.tc_s.unit.as_str()), ("rad/s", "s"));
        assert!(parameters.fit.curve.unwrap().parts.contains_key("gauss_markov"));
    }
    // Fewer than 6 of 8 at 95 %: once in two hundred for each.
    assert!(sigma >= 6 && tc_s >= 6, "{sigma} and {tc_s} of {SEEDS}");
}

/// It is not certain whether a process, or flicker and a walk, made the data: limits beside a process allow for both.
#[test]
fn limits_beside_a_process_hold_for_flicker_and_a_walk_in_its_place() {
    let mut samples = record(3.5e-3, 0.0, 0.0, 240_000, 1);
    for (value, more) in samples.iter_mut().zip(process(2e-3, 60.0, 240_000, 1)) {
        *value += more;
    }
    let likelihood = Likelihood::new(&sums_of(&[&samples]), RATE_HZ, &[]);
    let choice = choice::choose(&likelihood).unwrap();
    assert!(choice.model.terms.has_gauss_markov());
    let profile = Profile::new(&likelihood, &choice);
    let terms = likelihood::Terms::of(&[Term::N, Term::B, Term::K]);
    let plain = likelihood.maximise(terms, 1.0, likelihood::Held::Nothing, None).unwrap();
    for term in [Term::B, Term::K] {
        let Statement::Limited(Some(limit)) = profile.statement(term) else { panic!("{term:?} is named") };
        let in_its_place = plain.coefficient(term);
        let beside = profile.limit_in(choice.model.terms, term).unwrap();
        println!("{term:?} < {limit:.3e}; beside the process < {beside:.3e}, in its place {in_its_place:.3e}");
        assert!(limit >= in_its_place && limit >= beside, "{term:?}: {limit} {beside} {in_its_place}");
        // Beside the process alone, the limit of a walk is below that of a walk in its place.
        assert!(term == Term::B || beside < in_its_place, "{beside} {in_its_place}");
    }
}

#[test]
fn a_ramp_is_named_and_does_not_pass_for_a_random_walk() {
    let mut samples = record(3.5e-3, 0.0, 0.0, 100_000, 2);
    for (index, value) in samples.iter_mut().enumerate() {
        *value -= 1.6e-5 * index as f64 / RATE_HZ;
    }
    let parameters = of(&samples);
    // The ramp falls.
    assert!((parameters.r.value.unwrap() / -1.6e-5 - 1.0).abs() < 0.02 && holds(&parameters.r, -1.6e-5));
    assert!(!parameters.k.identified && !parameters.b.identified, "{parameters:?}");
    // Cut in two, the halves share the ramp.
    let (left, right) = samples.split_at(41_234);
    let cut = fit(&sums_of(&[left, right]), RATE_HZ, Channel::GyroX, &[], None);
    assert!((cut.r.value.unwrap() / -1.6e-5 - 1.0).abs() < 0.05 && holds(&cut.r, -1.6e-5), "{:?}", cut.r);
    // A rising ramp is the same with the other sign, and the curve has its size.
    samples.iter_mut().for_each(|value| *value = -*value);
    let risen = of(&samples);
    assert!((risen.r.value.unwrap() + parameters.r.value.unwrap()).abs() < 1e-9 && holds(&risen.r, 1.6e-5));
    let parts = [&parameters, &risen].map(|of| of.fit.curve.as_ref().unwrap().parts["R"].clone());
    assert!(parts[0].iter().zip(&parts[1]).all(|(fallen, risen)| *fallen > 0.0 && (fallen / risen - 1.0).abs() < 1e-6));
}

#[test]
fn white_angle_noise_is_named_q() {
    let mut angle = stream(8, 901);
    let mut last = 0.0;
    let samples: Vec<f64> = (0..100_000)
        .map(|_| {
            let next = angle.normal() * 1e-4;
            (next - std::mem::replace(&mut last, next)) * RATE_HZ
        })
        .collect();
    let parameters = of(&samples);
    assert!((parameters.q.value.unwrap() / 1e-4 - 1.0).abs() < 0.02, "{:?}", parameters.q);
}

#[test]
fn a_line_is_kept_out_of_n_by_excluding_its_band() {
    let mut samples = record(1e-3, 0.0, 0.0, 100_000, 4);
    for (index, value) in samples.iter_mut().enumerate() {
        *value += 2e-3 * (std::f64::consts::TAU * 11.37 * index as f64 / RATE_HZ).sin();
    }
    let sums = sums_of(&[&samples]);
    let with = fit_as_sampled(&sums, RATE_HZ, Channel::GyroX, None);
    assert!(with.flags.iter().any(|flag| flag.kind == "misfit") && with.n.value.unwrap() > 1.01e-3, "{:?}", with.n);
    let without = fit(&sums, RATE_HZ, Channel::GyroX, &[[11.3, 11.45]], None);
    assert!(without.flags.is_empty() && (without.n.value.unwrap() / 1e-3 - 1.0).abs() < 6e-3, "{:?}", without.n);
}

#[test]
fn captures_of_one_sensor_make_one_estimate() {
    let [one, two] = [21, 22].map(|seed| record(3.5e-3, 1e-3, 3e-4, 60_000, seed));
    let mut merged = sums_of(&[&one]);
    merged.merge(&sums_of(&[&two]));
    assert_eq!(merged.samples(), 120_000);
    let width = |parameters: &NoiseParameters| parameters.n.ci95.map(|[low, high]| high - low).unwrap();
    let together = fit(&merged, RATE_HZ, Channel::GyroX, &[], None);
    let ratio = width(&together) / width(&of(&one));
    assert!((ratio * 2f64.sqrt() - 1.0).abs() < 0.1, "{ratio}");
    assert!(holds(&together.n, 3.5e-3), "{:?}", together.n);
}

/// A stretch of more than one chunk loses almost no information: its lowest frequencies come from the averaged whole.
#[test]
fn a_long_stretch_is_as_good_in_chunks_as_whole() {
    let samples = record(3.5e-3, 0.0, 1e-5, DstEstimator::CHUNK * 5 / 2, 6);
    let chunked = sums_of(&[&samples]);
    let mut whole = DstSums::new();
    estimator::transform_whole(&mut whole, &mut Transform::new(), &samples);
    let count = |sums: &DstSums, below: f64| -> (f64, f64) {
        let bins = sums.filled().filter(|([_, high], _)| *high * RATE_HZ < below);
        bins.fold((0.0, 0.0), |(count, power), (_, bin)| (count + bin.count, power + bin.power / bin.walk * bin.count))
    };
    // 8e-5 Hz lies far below the resolution of a chunk: the same coefficients, one by one.
    let ((ours, ours_power), (theirs, theirs_power)) = (count(&chunked, 8e-5), count(&whole, 8e-5));
    assert!(ours == theirs && ours > 5.0, "{ours} {theirs}");
    assert!((ours_power / theirs_power - 1.0).abs() < 0.05, "{ours_power} {theirs_power}");
    let (chunked, whole) =
        (fit(&chunked, RATE_HZ, Channel::GyroX, &[], None), fit(&whole, RATE_HZ, Channel::GyroX, &[], None));
    let relative = |term| {
        let (one, other) = (chunked.estimate(term), whole.estimate(term));
        (one.value.unwrap() / other.value.unwrap() - 1.0, other.ci95.map(|[low, high]| high / low - 1.0).unwrap())
    };
    for term in [Term::N, Term::K] {
        let (difference, width) = relative(term);
        assert!(difference.abs() < 0.25 * width, "{term:?}: {difference} of {width}");
    }
}

#[test]
fn portions_do_not_matter_and_a_stretch_goes_on_after_a_kill() {
    let mut samples = record(3.5e-3, 1e-3, 3e-4, 5_000, 9);
    samples[1_234] = f64::NAN;
    samples[3_000] = 1e9;
    let whole = sums_of(&[&samples]);
    assert_eq!((whole.out_of_range(), whole.samples()), (2, 4_998));
    let scale = FixedPoint::for_range(0, 6).unwrap();
    for portion in [1, 7, 999] {
        let mut transform = Transform::new();
        let mut estimator = DstEstimator::new(scale);
        let mut at = 0;
        for part in samples.chunks(portion) {
            estimator.push(&mut transform, part);
            at += part.len();
            if portion > 1 {
                let kept = DstSums::from_bytes(&estimator.sums().to_bytes()).unwrap();
                let open = at - estimator.open_samples() as usize;
                estimator = DstEstimator::resume(scale, kept);
                estimator.push(&mut transform, &samples[open..at]);
            }
        }
        assert_eq!(estimator.into_sums(&mut transform), whole, "in portions of {portion}");
    }
}

#[test]
fn too_little_or_constant_data_is_reported_as_such_and_no_number_is_nan() {
    for (samples, kind) in
        [(vec![], "insufficient"), (record(1.0, 0.0, 0.0, 20, 1), "insufficient"), (vec![0.5; 5_000], "constant")]
    {
        let parameters = of(&samples);
        assert_eq!(parameters.flags[0].kind, kind);
        assert!(Term::ALL.into_iter().all(|term| !parameters.estimate(term).identified));
        assert_finite(&parameters);
    }
    let samples = record(1.0, 0.3, 0.2, 4_000, 1);
    for count in (50..200).step_by(7).chain([500, 1_000, 3_999]) {
        let parameters = of(&samples[..count]);
        assert_finite(&parameters);
        if let Some(n) = parameters.n.value {
            assert!((0.3..3.0).contains(&n), "{count} samples: {:?}", parameters.n);
        }
    }
}

#[test]
fn too_few_frequencies_are_not_called_too_few_samples() {
    let sums = sums_of(&[&record(1e-3, 0.0, 0.0, 2_000, 4)]);
    let excluded = fit(&sums, RATE_HZ, Channel::GyroX, &[[0.2, 20.0]], None);
    let flag = &excluded.flags[0];
    assert!(flag.kind == "insufficient" && flag.note.contains("of 1999 coefficients"), "{flag:?}");
    let short = of(&record(1e-3, 0.0, 0.0, 40, 4));
    assert!(short.flags[0].note.contains("fewer than 50 samples"), "{:?}", short.flags);
}

/// The reference set of white noise, random walk and ramp of known sizes (NIST SP1065's generator).
#[test]
fn white_walk_and_ramp_of_the_reference_set_are_distinguished() {
    let mut state = 1_234_567_890u64;
    let mut next = move || {
        let value = state as f64 / 2_147_483_647.0 - 0.5;
        state = 16_807 * state % 2_147_483_647;
        value
    };
    let mut walk = 0.0;
    let samples: Vec<f64> = (0..720_000)
        .map(|i| {
            let (white, step) = (next(), next());
            walk += step * 1e-5;
            white * 0.02 + walk + 1e-8 * f64::from(i)
        })
        .collect();
    let parameters = of(&samples);
    for (term, truth) in [(Term::N, 9.128_709e-4), (Term::K, 1.825_742e-5), (Term::B, 0.0), (Term::R, 4e-7)] {
        let estimate = parameters.estimate(term);
        // One fixed record: its K happens to lie 2.3 deviations high, so that 95 % would not suffice.
        let within = match (estimate.value, estimate.ci95) {
            (Some(value), Some([low, high])) => {
                let sign = value.signum();
                let beyond = [value - 1.6 * (value - low), value + 1.6 * (high - value)];
                (beyond[0]..=beyond[1]).contains(&(sign * truth))
            }
            _ => holds(estimate, truth),
        };
        assert!(within, "{term:?} {truth} {estimate:?}");
    }
    assert!((parameters.n.value.unwrap() / 9.128_709e-4 - 1.0).abs() < 3e-3);
    assert!(!parameters.b.identified, "{:?}", parameters.b);
}

/// Small versions of the worlds of `examples/noise_worlds.rs`: N behind filters that the fit does not know, whole and
/// with one sample in a hundred lost.
mod filters {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_distr::{Distribution as _, StandardNormal};

    /// White noise's standard deviation: N is that over √rate.
    const SIGMA: f64 = 0.05;

    /// Returns white noise behind taps or a recursion y += a (x − y).
    fn filtered(taps: &[f64], a: f64, samples: usize, seed: u64) -> Vec<f64> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let white: Vec<f64> = (0..samples + taps.len()).map(|_| StandardNormal.sample(&mut rng)).collect();
        let sums = white.windows(taps.len()).map(|of| of.iter().zip(taps).map(|(x, tap)| x * tap).sum::<f64>());
        let mut y = 0.0;
        sums.skip(1)
            .map(|x| {
                y += a * (x - y);
                SIGMA * y
            })
            .collect()
    }

    /// Returns the stretches between lost samples.
    fn lossy(samples: &[f64], loss: f64, seed: u64) -> Vec<&[f64]> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        samples.split(|_| rng.random_bool(loss)).filter(|stretch| !stretch.is_empty()).collect()
    }

    #[test]
    fn n_holds_behind_filters_also_where_samples_are_lost() {
        let fir: Vec<f64> = [1.0, 3.0, 6.0, 3.0, 1.0].iter().map(|tap| tap / 14.0).collect();
        let filters: [(&[f64], f64); 5] =
            [(&[0.25; 4], 1.0), (&[0.125; 8], 1.0), (&[1.0], 0.5), (&[1.0], 0.2), (&fir, 1.0)];
        let truth = SIGMA / RATE_HZ.sqrt();
        for loss in [0.0, 0.003, 0.01] {
            let (mut held, mut named, mut drift) = (0, 0, 0.0);
            for seed in 0..8 {
                for (taps, a) in filters {
                    let samples = filtered(taps, a, 120_000, seed);
                    let found = fit(&sums_of(&lossy(&samples, loss, seed)), RATE_HZ, Channel::MagX, &[], None);
                    let ([low, high], value) = (found.n.ci95.unwrap(), found.n.value.unwrap());
                    assert!(found.bandwidth.is_some() && (high - low) / truth < 0.08, "{found:?}");
                    held += u32::from(low <= truth && truth <= high);
                    named += u32::from(found.b.identified || found.k.identified);
                    drift += (value - truth) / (high - low) * 3.92;
                }
            }
            // Of 40: 38 on average. The mean error is that of 40, in standard errors.
            assert!(held >= 34, "{held} of 40 hold with {loss} lost");
            assert!(named <= 4, "{named} of 40 name what is not there with {loss} lost");
            assert!((drift / 40.0).abs() < 0.6, "{} standard errors with {loss} lost", drift / 40.0);
        }
    }
}
