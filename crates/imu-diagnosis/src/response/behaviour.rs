//! The properties of the fit besides intervals that hold: the response is the simulator's, parameters that a motion leaves open
//! are named, clock offsets are separated from latencies, and results do not depend on units or lengths.

use super::round_trip::{Case, FULL_SCALE, RATE_HZ, motion, nonlinearity, rate_table, simulated, tumble};
use super::*;
use imu_model::effects::EffectKind;
use imu_model::motion::{Course, Kind, Site};
use imu_model::simulator::{ChannelModel, SensorModel};

fn request(candidates: &[Candidate]) -> Request<'_> {
    Request { known: &[], level: [0.0; 3], candidates, clock: Clock::Shared, filters: &NO_FILTERS }
}

fn slices(samples: &[Vec<f64>; 3]) -> [&[f64]; 3] {
    samples.each_ref().map(Vec::as_slice)
}

/// Returns the number of samples that are left out, per axis.
fn left_out(found: &Fit) -> [usize; 3] {
    found.stretches.each_ref().map(|axis| axis.iter().map(std::ops::Range::len).sum())
}

/// Asserts that all values that the fit returns are numbers.
fn assert_finite(found: &Fit) {
    let numbers = found.estimates.iter().flat_map(|one| [one.value, one.known].into_iter().chain(one.standard_error));
    assert!(numbers.into_iter().all(f64::is_finite), "{:?}", found.estimates);
    assert!(found.response.iter().flatten().copied().chain(found.misfit).all(f64::is_finite));
}

#[test]
fn the_response_is_the_simulators_without_noise() {
    for (triad, mut candidates) in
        [(Triad::Gyro, Candidate::all(Triad::Gyro, FULL_SCALE)), (Triad::Accel, Candidate::all(Triad::Accel, 20.0))]
    {
        candidates.retain(|one| *one != Candidate::Saturation);
        let value = |candidate: &Candidate, place: usize| match candidate {
            Candidate::Latency => 0.137,
            _ => 1e-3 * (place as f64 - 1.3),
        };
        let truth: Vec<(Candidate, Vec<f64>)> = candidates
            .iter()
            .map(|one| (*one, (0..one.parameters().len()).map(|place| value(one, place)).collect()))
            .collect();
        let mut case = Case::new(triad, rate_table(), &truth);
        for channel in case.model.channels.values_mut() {
            *channel = ChannelModel { bias: Some(0.01), ..ChannelModel::default() };
        }
        let shown = case.samples(1);
        let effects: Vec<Arc<dyn TriadEffect>> = truth.iter().map(|(one, values)| one.make(values)).collect();
        let record = Record {
            rate_hz: RATE_HZ,
            triad,
            samples: slices(&shown),
            reference: &case.reference,
            temperature_c: None,
            left_out: &[],
            sent: None,
        };
        // Once with all effects known and kept, then with all as candidates at their known values.
        for candidates in [&[][..], &candidates] {
            let known =
                Request { known: &effects, level: [0.01; 3], candidates, clock: Clock::Shared, filters: &NO_FILTERS };
            let (design, state) = Design::new(&record, &known);
            for (response, shown) in design.response(&state).iter().zip(&shown) {
                for (response, shown) in response.iter().zip(shown) {
                    assert!((response - shown).abs() < 1e-12, "{} {response} {shown}", triad.name());
                }
            }
        }
    }
}

#[test]
fn what_is_known_already_gains_nothing_and_what_is_lacking_gains() {
    let scale = (Candidate::ScaleFactor, vec![2e-3, -1e-3, 5e-4]);
    let case = Case::new(Triad::Gyro, rate_table(), std::slice::from_ref(&scale));
    let samples = case.samples(3);
    let record = Record {
        rate_hz: RATE_HZ,
        triad: Triad::Gyro,
        samples: slices(&samples),
        reference: &case.reference,
        temperature_c: None,
        left_out: &[],
        sent: None,
    };
    let both = [Candidate::ScaleFactor, Candidate::Misalignment];
    let known = [scale.0.make(&scale.1)];
    let from_known = fit(&record, &case.law, &Request { known: &known, ..request(&both) }).unwrap();
    let kept = fit(&record, &case.law, &Request { known: &known, ..request(&[]) }).unwrap();
    // Six parameters that are 0 gain 3 nats on average, and more than 14 nats once in 10⁴ records.
    let gain = case.gain(&from_known, &kept);
    assert!(gain < 14.0, "{gain}");
    let from_nothing = fit(&record, &case.law, &request(&both)).unwrap();
    let nothing = fit(&record, &case.law, &request(&[])).unwrap();
    assert!(case.gain(&from_nothing, &nothing) > 100.0);
    for (one, other) in from_known.estimates.iter().zip(&from_nothing.estimates) {
        let error = one.standard_error.unwrap();
        assert!((one.value - other.value).abs() < 1e-2 * error, "{one:?} {other:?}");
    }
}

#[test]
fn products_of_large_effects_are_as_the_simulator_makes_them() {
    let truth = [
        (Candidate::ScaleFactor, vec![0.2, -0.1, 0.1]),
        (Candidate::Misalignment, vec![0.05, -0.1, 0.02]),
        (nonlinearity(FULL_SCALE, true), vec![0.05, 0.02, -0.05]),
        (Candidate::Bias, vec![0.3, -0.2, 0.1]),
    ];
    let case = Case::new(Triad::Gyro, rate_table(), &truth);
    let found = case.fit(5, &truth.each_ref().map(|(one, _)| *one));
    for (fitted, (_, values)) in found.fitted.iter().zip(&truth) {
        for (index, truth) in fitted.places.clone().zip(values) {
            let one = &found.estimates[index];
            let apart = (one.value - truth).abs() / one.standard_error.unwrap();
            assert!(apart < 4.0, "{one:?}: {truth}");
        }
    }
}

#[test]
fn a_tumble_has_no_information_about_what_a_turn_about_y_would_show() {
    let case = Case::new(Triad::Gyro, tumble(), &[]);
    let found = case.fit(1, &[Candidate::Bias, Candidate::ScaleFactor, Candidate::GSensitivity]);
    let sentences: Vec<&str> = found.confounded.iter().map(|one| one.sentence.as_str()).collect();
    assert_eq!(
        sentences[0],
        "this motion says nothing about scale_factor y: it never turns about y; a turn about y would tell"
    );
    let open: Vec<&str> =
        found.estimates.iter().filter(|one| one.standard_error.is_none()).map(|one| one.parameter.as_str()).collect();
    assert_eq!(open, ["y"]);
    assert_finite(&found);
}

#[test]
fn a_still_record_distinguishes_no_scale_factor_from_a_bias() {
    let case = Case::new(Triad::Accel, motion(Kind::Still, 801, RATE_HZ), &[]);
    let found = case.fit(1, &Candidate::all(Triad::Accel, 20.0));
    for one in &found.confounded {
        println!("{:?}: {}", one.openness, one.sentence);
    }
    let assert_sentence = |openness, words: &str| {
        let of = found.confounded.iter().filter(|one| one.openness == openness);
        assert!(of.clone().any(|one| one.sentence.contains(words)), "{words} in {:?}", of.collect::<Vec<_>>());
    };
    assert_sentence(
        Openness::Confounded,
        "cannot tell apart bias z, scale_factor z, unsigned scale_factor_nonlinearity z and signed \
         scale_factor_nonlinearity z: the specific force along z never changes; rests with z up and down would tell",
    );
    assert_sentence(Openness::Confounded, "bias x, misalignment y and cross_axis_sensitivity xz");
    assert_sentence(Openness::Unseen, "scale_factor (x, y): there is never a specific force along x or y");
    assert_sentence(Openness::Unseen, "latency seconds: nothing changes by which a delay would show");
    assert!(found.estimates.iter().all(|one| one.standard_error.is_none()));
    // Their joint effect is known: the response is at the record's level.
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let mut both = case.samples(1).into_iter().zip(&found.response);
    assert!(both.all(|(shown, response)| (mean(&shown) - mean(response)).abs() < 5e-3));
    assert_finite(&found);
}

#[test]
fn a_record_without_any_motion_leaves_numbers() {
    let case = Case::new(Triad::Gyro, vec![Motion::default(); 65], &[]);
    let found = case.fit(2, &Candidate::all(Triad::Gyro, FULL_SCALE));
    let seen: Vec<Option<EffectKind>> =
        found.estimates.iter().filter(|one| one.standard_error.is_some()).map(|one| one.effect).collect();
    assert_eq!(seen, [Some(EffectKind::Bias); 3]);
    assert_finite(&found);
    let nothing = case.fit(2, &[]);
    assert!(nothing.estimates.is_empty());
    assert_finite(&nothing);
}

#[test]
fn records_of_any_length_are_fitted() {
    let whole = motion(Kind::RateTable, 2187, RATE_HZ);
    let scale = (Candidate::ScaleFactor, vec![2e-3, -1e-3, 5e-4]);
    for samples in [64, 65, 97, 641, 1009, 1536, 2187] {
        let case = Case::new(Triad::Gyro, whole[2187 - samples..].to_vec(), std::slice::from_ref(&scale));
        let found = case.fit(7, &[Candidate::ScaleFactor, Candidate::Bias]);
        assert_finite(&found);
        for (one, truth) in found.estimates.iter().zip(&scale.1) {
            let apart = one.standard_error.map_or(0.0, |error| (one.value - truth).abs() / error);
            assert!(apart < 4.0, "{samples}: {one:?}");
        }
    }
}

#[test]
fn nothing_depends_on_the_size_of_the_unit() {
    let candidates = [Candidate::ScaleFactor, Candidate::Misalignment, Candidate::Bias];
    let case = Case::new(Triad::Accel, tumble(), &[(Candidate::ScaleFactor, vec![2e-3, -1e-3, 5e-4])]);
    let samples = case.samples(4);
    let usual = case.fit_to(&samples, &candidates, Clock::Shared);
    for unit in [1e-12, 1e9] {
        let mut other = Case::new(Triad::Accel, tumble(), &[]);
        for motion in &mut other.reference {
            motion.accel_m_s2 = motion.accel_m_s2.map(|force| force * unit);
        }
        for of in other.model.channels.values_mut() {
            (of.n, of.b, of.k) = (of.n * unit, of.b * unit, of.k * unit);
        }
        other.law = NoiseLaw::of_model(&other.model, Triad::Accel, RATE_HZ, samples[0].len()).unwrap();
        let scaled = samples.clone().map(|axis| axis.into_iter().map(|value| value * unit).collect());
        let found = other.fit_to(&scaled, &candidates, Clock::Shared);
        assert!(found.misfit.iter().zip(usual.misfit).all(|(one, other)| (one / other - 1.0).abs() < 1e-6));
        for (one, other) in found.estimates.iter().zip(&usual.estimates) {
            let scale = if one.effect == Some(EffectKind::Bias) { unit } else { 1.0 };
            let apart = (one.value / scale - other.value).abs() / other.standard_error.unwrap();
            assert!(apart < 1e-3, "{unit}: {one:?} {other:?}");
        }
    }
}

/// Returns the rate table on a sensor's clock, and a reference whose clock is ahead and fast.
fn on_two_clocks(offset_s: f64, rate_error: f64) -> (Vec<Motion>, Vec<Motion>) {
    let samples = 2187;
    let length_s = samples as f64 / RATE_HZ;
    let course = Course::new(Kind::RateTable, length_s, Site::default()).unwrap();
    let time_s = |index: usize| index as f64 / RATE_HZ;
    let ahead = |time_s: f64| time_s + offset_s + rate_error * (time_s - 0.5 * length_s);
    ((0..samples).map(|i| course.at(time_s(i))).collect(), (0..samples).map(|i| course.at(ahead(time_s(i)))).collect())
}

#[test]
fn a_clocks_offset_and_rate_are_no_latency_and_what_one_triad_has_more_is() {
    let (offset_s, rate_error, latency_s) = (0.237, 3e-4, 0.04);
    let (felt, reference) = on_two_clocks(offset_s, rate_error);
    let mut delays = Vec::new();
    for (triad, seconds) in [(Triad::Gyro, 0.0), (Triad::Accel, latency_s)] {
        let mut case = Case::new(triad, felt.clone(), &[(Candidate::Latency, vec![seconds])]);
        let samples = case.samples(11);
        case.reference = reference.clone();
        let found = case.fit_to(&samples, &[Candidate::Bias, Candidate::Latency], Clock::Separate);
        let of = |name: &str| found.estimates.iter().find(|one| one.parameter == name).unwrap().clone();
        let (delay, rate) = (of("offset_s"), of("rate_error"));
        println!("{}: {delay:?} {rate:?}", triad.name());
        assert!((delay.value - offset_s - seconds).abs() < 4.0 * delay.standard_error.unwrap() + 1e-4, "{delay:?}");
        assert!((rate.value - rate_error).abs() < 4.0 * rate.standard_error.unwrap() + 1e-6, "{rate:?}");
        assert!(found.fitted.iter().all(|one| one.effect.kind() != EffectKind::Latency));
        assert!(found.confounded.iter().any(|one| one.sentence.contains("clock offset_s")));
        delays.push(delay);
    }
    let excess_s = delays[1].value - delays[0].value;
    let error_s = delays[0].standard_error.unwrap().hypot(delays[1].standard_error.unwrap());
    assert!((excess_s - latency_s).abs() < 4.0 * error_s + 1e-4, "{excess_s} ± {error_s}");
}

#[test]
fn a_reference_that_began_seconds_apart_is_found_and_what_it_does_not_reach_is_left_out() {
    let at = |time_s: f64| Motion {
        gyro_rad_s: [(0.7 * time_s).sin(), (0.31 * time_s).cos(), (0.9 * time_s + 0.01 * time_s * time_s).sin()],
        ..Motion::default()
    };
    let motion = |ahead_s: f64| (0..1301).map(|index| at(f64::from(index) / RATE_HZ + ahead_s)).collect::<Vec<_>>();
    for offset_s in [7.31, -4.04] {
        let mut case = Case::new(Triad::Gyro, motion(0.0), &[(Candidate::ScaleFactor, vec![0.01, -0.01, 0.02])]);
        let samples = case.samples(13);
        case.reference = motion(offset_s);
        let found = case.fit_to(&samples, &[Candidate::ScaleFactor, Candidate::Bias], Clock::Separate);
        let beyond = (offset_s.abs() * RATE_HZ) as usize;
        assert!(left_out(&found).iter().all(|out| (beyond..beyond + 6).contains(out)), "{:?}", found.stretches);
        for (one, truth) in found.estimates.iter().zip([0.01, -0.01, 0.02, 0.0, 0.0, 0.0, offset_s, 0.0]) {
            assert!((one.value - truth).abs() < 4.0 * one.standard_error.unwrap() + 1e-5, "{one:?}: {truth}");
        }
        assert!(found.misfit.iter().all(|square| (square - 1.0).abs() < 0.2), "{:?}", found.misfit);
    }
}

#[test]
fn a_reference_that_is_late_gives_a_negative_delay() {
    let (felt, reference) = on_two_clocks(-0.3, 0.0);
    let mut case = Case::new(Triad::Gyro, felt, &[]);
    let samples = case.samples(12);
    case.reference = reference;
    let found = case.fit_to(&samples, &[Candidate::Latency], Clock::Shared);
    let delay = &found.estimates[0];
    assert!((delay.value + 0.3).abs() < 4.0 * delay.standard_error.unwrap() + 1e-4, "{delay:?}");
    // An effect cannot know the future.
    assert_eq!(found.fitted[0].effect.delay_s(), 0.0);
}

#[test]
fn clipping_is_found_beside_a_regression_and_its_samples_are_bridged() {
    let truth = [(Candidate::Saturation, vec![3.0]), (Candidate::ScaleFactor, vec![0.01, -0.02, 0.005])];
    let case = Case::new(Triad::Gyro, rate_table(), &truth);
    let found = case.fit(1, &truth.each_ref().map(|(one, _)| *one));
    let clipping = found.clipping.unwrap();
    assert_eq!(clipping.limit, 3.0);
    assert_eq!(found.fitted[0].effect.range(), Some(3.0));
    assert!(left_out(&found).iter().zip(clipping.ties).all(|(out, ties)| *out >= ties && ties > 50), "{clipping:?}");
    for ((shown, response), out) in case.samples(1).iter().zip(&found.response).zip(&found.stretches) {
        let inside = |index: &usize| !out.iter().any(|stretch| stretch.contains(index));
        assert!((0..shown.len()).filter(inside).all(|index| (shown[index] - response[index]).abs() < 0.01));
    }
    assert_finite(&found);
    let refused = Case::new(Triad::Gyro, rate_table(), &[(Candidate::Saturation, vec![1e-4])]);
    let samples = refused.samples(1);
    let record = Record {
        rate_hz: RATE_HZ,
        triad: Triad::Gyro,
        samples: slices(&samples),
        reference: &refused.reference,
        temperature_c: None,
        left_out: &[],
        sent: None,
    };
    let error = fit(&record, &refused.law, &request(&[Candidate::Bias])).unwrap_err();
    assert!(matches!(error, ResponseError::LeftOut { needed: SAMPLES_MIN, .. }), "{error}");
}

#[test]
fn a_bias_that_goes_with_the_temperature_is_taken_beside_the_motions() {
    let case = Case::new(Triad::Accel, tumble(), &[(Candidate::ScaleFactor, vec![2e-3, -1e-3, 5e-4])]);
    let mut samples = case.samples(9);
    let temperature_c: Vec<f64> = (0..1575).map(|index| 20.0 + 5.0 * (0.01 * f64::from(index)).sin()).collect();
    for (value, temperature_c) in samples[1].iter_mut().zip(&temperature_c) {
        *value += 0.01 * temperature_c;
    }
    let record = Record {
        rate_hz: RATE_HZ,
        triad: Triad::Accel,
        samples: slices(&samples),
        reference: &case.reference,
        temperature_c: Some(&temperature_c),
        left_out: &[],
        sent: None,
    };
    let found = fit(&record, &case.law, &request(&[Candidate::ScaleFactor, Candidate::Bias])).unwrap();
    for (name, truth) in [("x per_c", 0.0), ("y per_c", 0.01), ("z per_c", 0.0)] {
        let one = found.estimates.iter().find(|one| one.parameter == name).unwrap();
        assert!((one.value - truth).abs() < 4.0 * one.standard_error.unwrap(), "{one:?}");
    }
}

#[test]
fn a_sensor_with_a_boxcar_has_a_law_too() {
    let mut model: SensorModel = super::round_trip::sensor(Triad::Gyro, &[]);
    model.sampling = Some(imu_model::simulator::Sampling { internal_rate_hz: 80.0, filter_window: 4 });
    let reference = rate_table();
    let law = NoiseLaw::of_model(&model, Triad::Gyro, RATE_HZ, reference.len()).unwrap();
    // The sensor is still, so that the motion need not pass the boxcar.
    let still = vec![Motion::default(); 4 * reference.len()];
    let samples = simulated(&model, Triad::Gyro, &still, RATE_HZ, 3);
    let reference = vec![Motion::default(); samples[0].len()];
    let record = Record {
        rate_hz: RATE_HZ,
        triad: Triad::Gyro,
        samples: slices(&samples),
        reference: &reference,
        temperature_c: None,
        left_out: &[],
        sent: None,
    };
    let found = fit(&record, &law, &request(&[Candidate::Bias])).unwrap();
    assert!(found.misfit.iter().all(|square| (square - 1.0).abs() < 0.15), "{:?}", found.misfit);
}
