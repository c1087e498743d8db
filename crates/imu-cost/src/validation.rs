//! Costs against formulas worked by hand in continuous time, and against runs of the simulator.

use crate::request::Setting;
use crate::{Cost, CostError, Method, Quantity, Request, Tolerance, cost, monte_carlo};
use imu_core::units::STANDARD_GRAVITY_M_S2;
use imu_model::motion::Temperatures;
use imu_model::simulator::SensorModel;
use std::f64::consts::{PI, TAU};

const ALIGN_S: f64 = 30.0;

fn model(channels: &str) -> SensorModel {
    model_with(channels, "")
}

fn model_with(channels: &str, more: &str) -> SensorModel {
    let text = format!(
        r#"{{"format": "vn100d-sensor-model-1", "name": "t", "rate_hz": 40, "channels": {{{channels}}}{more}}}"#
    );
    SensorModel::from_json(&text, "t.json").unwrap()
}

fn with(effect: &str, channel: &str) -> SensorModel {
    model(&format!(r#""{channel}": {{"effects": [{effect}]}}"#))
}

fn request(horizons_s: &[f64]) -> Request {
    Request { align_s: ALIGN_S, horizons_s: horizons_s.to_vec(), ..Request::default() }
}

const HORIZONS_S: [f64; 4] = [10.0, 60.0, 600.0, 3600.0];

fn costs(model: &SensorModel) -> Cost {
    cost(model, "t.json", &request(&HORIZONS_S)).unwrap()
}

/// Compares a quantity's standard deviation with a formula of the horizon.
fn sd_is(model: &SensorModel, quantity: Quantity, share: f64, formula: impl Fn(f64) -> f64) {
    let cost = costs(model);
    let found = &cost.quantities[&quantity];
    assert_eq!(found.method, Method::ClosedForm);
    for ((horizon_s, sd), mean) in HORIZONS_S.iter().zip(&found.sd).zip(&found.mean) {
        let expected = formula(*horizon_s);
        assert!((sd / expected - 1.0).abs() < share, "{quantity} at {horizon_s} s: {sd}, expected {expected}");
        assert_eq!(*mean, 0.0);
    }
}

/// Compares a quantity's mean with a formula of the horizon.
fn mean_is(model: &SensorModel, quantity: Quantity, share: f64, formula: impl Fn(f64) -> f64) {
    let cost = costs(model);
    let found = &cost.quantities[&quantity];
    for ((horizon_s, mean), band) in HORIZONS_S.iter().zip(&found.mean).zip(&found.band95) {
        let expected = formula(*horizon_s);
        assert!((mean / expected - 1.0).abs() < share, "{quantity} at {horizon_s} s: {mean}, expected {expected}");
        assert!((band / mean.abs() - 1.0).abs() < 1e-9);
    }
}

#[test]
fn white_noise_grows_as_random_walks_and_their_integrals() {
    let gyro = model(r#""gyro_y": {"N": 2e-4}, "gyro_z": {"N": 2e-4}, "accel_x": {}"#);
    let n = 2e-4;
    sd_is(&gyro, Quantity::Heading, 1e-9, |t| n * (t + t * t / ALIGN_S).sqrt());
    sd_is(&gyro, Quantity::AttitudeY, 1e-9, |t| n * (t + t * t / ALIGN_S).sqrt());
    let g = STANDARD_GRAVITY_M_S2;
    sd_is(&gyro, Quantity::VelocityX, 1e-4, |t| g * n * (t.powi(3) / 3.0 + t.powi(4) / 4.0 / ALIGN_S).sqrt());
    sd_is(&gyro, Quantity::PositionX, 1e-4, |t| g * n * (t.powi(5) / 20.0 + t.powi(6) / 36.0 / ALIGN_S).sqrt());
    let accel = model(r#""accel_y": {"N": 2e-3}"#);
    sd_is(&accel, Quantity::VelocityY, 1e-9, |t| 2e-3 * (t + t * t / ALIGN_S).sqrt());
    sd_is(&accel, Quantity::PositionY, 1e-4, |t| 2e-3 * (t.powi(3) / 3.0 + t.powi(4) / 4.0 / ALIGN_S).sqrt());
}

#[test]
fn a_rate_random_walk_grows_as_its_integrals() {
    let walk = model(r#""gyro_z": {"K": 1e-5}, "accel_x": {"K": 1e-5}"#);
    let square = |t: f64| (t.powi(3) + t * t * ALIGN_S) / 3.0;
    // At 10 s, the walk of a sample shifts by half a period.
    sd_is(&walk, Quantity::Heading, 4e-3, |t| 1e-5 * square(t).sqrt());
    sd_is(&walk, Quantity::VelocityX, 4e-3, |t| 1e-5 * square(t).sqrt());
    sd_is(&walk, Quantity::PositionX, 4e-3, |t| 1e-5 * (t.powi(5) / 20.0 + t.powi(4) / 4.0 * ALIGN_S / 3.0).sqrt());
}

#[test]
fn exponentially_correlated_noise_has_its_closed_form() {
    let (sigma, tc) = (3e-4, 20.0);
    let noise = with(r#"{"effect": "gauss_markov", "sigma": 3e-4, "tc_s": 20}"#, "gyro_z");
    let gathered = |x: f64| 2.0 * (x + (-x).exp_m1());
    let seen = |x: f64| -(-x).exp_m1();
    sd_is(&noise, Quantity::Heading, 1e-4, |t| {
        let (own, level, ratio) = (t / tc, ALIGN_S / tc, t / ALIGN_S);
        let square = gathered(own) + ratio * ratio * gathered(level) - 2.0 * ratio * seen(own) * seen(level);
        sigma * tc * square.sqrt()
    });
}

#[test]
fn a_tone_swings_between_bounds_and_its_band_is_the_arcsine_laws() {
    let tone = with(r#"{"effect": "tone", "frequency_hz": 0.0137, "amplitude": 1e-3}"#, "gyro_z");
    let turn = TAU * 0.0137;
    let peak = |t: f64| {
        let part = |from: f64, to: f64| {
            [(turn * to).sin() - (turn * from).sin(), (turn * from).cos() - (turn * to).cos()].map(|x| x / turn)
        };
        let (own, level) = (part(0.0, t), part(-ALIGN_S, 0.0));
        1e-3 * f64::hypot(own[0] - t / ALIGN_S * level[0], own[1] - t / ALIGN_S * level[1])
    };
    sd_is(&tone, Quantity::Heading, 1e-4, |t| peak(t) / 2.0_f64.sqrt());
    for (horizon_s, band) in HORIZONS_S.iter().zip(&costs(&tone).quantities[&Quantity::Heading].band95) {
        let expected = peak(*horizon_s) * (0.475 * PI).sin();
        assert!((band / expected - 1.0).abs() < 0.006, "{band} {expected}");
    }
}

#[test]
fn courses_have_their_means() {
    let ramp = model(
        r#""gyro_z": {"effects": [{"effect": "rate_ramp", "R": 1e-7}]}, "accel_x": {},
           "gyro_y": {"effects": [{"effect": "rate_ramp", "R": 1e-7}]}"#,
    );
    mean_is(&ramp, Quantity::Heading, 3e-3, |t| 1e-7 * t * (t + ALIGN_S) / 2.0);
    let g = STANDARD_GRAVITY_M_S2;
    mean_is(&ramp, Quantity::PositionX, 3e-3, |t| g * 1e-7 * (t.powi(4) / 24.0 + t.powi(3) * ALIGN_S / 12.0));
    let (a, tau) = (-2e-3, 300.0);
    let warm = with(r#"{"effect": "warm_up", "amplitude": -2e-3, "tau_s": 300}"#, "gyro_x");
    mean_is(&warm, Quantity::AttitudeX, 3e-3, |t| {
        let level = tau / ALIGN_S * -(-ALIGN_S / tau).exp_m1();
        a * (tau * (-ALIGN_S / tau).exp() * -(-t / tau).exp_m1() - t * level)
    });
    // Ten seconds after the alignment begins.
    let step = with(r#"{"effect": "bias_step", "at_s": 10, "size": 1e-4}"#, "gyro_z");
    mean_is(&step, Quantity::Heading, 1e-9, |t| 1e-4 * t / 3.0);
}

#[test]
fn a_course_of_temperature_is_followed_from_the_alignments_begin_on() {
    let bias = with(r#"{"effect": "temperature_bias", "per_c": 1e-4, "reference_c": 25}"#, "gyro_z");
    let constant = Request { temperature: Some(Temperatures::constant(40.0)), ..request(&HORIZONS_S) };
    let heading = |request: &Request| cost(&bias, "t", request).unwrap().quantities[&Quantity::Heading].clone();
    assert_eq!(heading(&constant).band95, [0.0; 4]);
    // One degree in 100 s.
    let rising = Temperatures::read("time_s,temperature_c\n0,20\n10000,120\n".as_bytes(), "t.csv").unwrap();
    let found = heading(&Request { temperature: Some(rising), ..request(&[10.0]) }).mean[0];
    assert!((found / (1e-4 * 0.01 * 10.0 * 40.0 / 2.0) - 1.0).abs() < 3e-3, "{found}");
}

#[test]
fn what_does_not_act_on_the_integration_changes_nothing() {
    let plain = r#""gyro_x": {"N": 1e-4}, "accel_y": {"N": 1e-3, "bias": 0.3}"#;
    let noise = r#"{"N": 1, "B": 1, "K": 1, "effects": [{"effect": "tone", "frequency_hz": 1, "amplitude": 3}]}"#;
    let rich = model_with(
        &format!(r#"{plain}, "mag_x": {noise}, "pressure": {noise}, "accel_z": {noise}"#),
        r#", "triads": {"gyro": {"effects": [{"effect": "bias", "x": 0.1, "y": 0, "z": 0}]}}"#,
    );
    assert_eq!(costs(&rich).quantities, costs(&model(plain)).quantities);
    let quiet = costs(&model(r#""gyro_x": {"bias": 0.123}, "accel_y": {"bias": -9.7}"#));
    for growth in quiet.quantities.values() {
        assert_eq!((&growth.mean, &growth.band95), (&vec![0.0; 4], &vec![0.0; 4]));
    }
    assert!(serde_json::to_string(&quiet).unwrap().contains("vn100d-cost-1"));
}

#[test]
fn shares_sum_to_one_and_a_cause_taken_out_leaves_what_is_said() {
    let both = r#"{"N": 1e-4, "K": 3e-6, "effects": [{"effect": "rate_ramp", "R": 2e-7},
                   {"effect": "warm_up", "amplitude": -3e-5, "tau_s": 600}]}"#;
    let cost = costs(&model(&format!(r#""gyro_z": {both}, "gyro_y": {both}, "accel_x": {{"N": 1e-2}}"#)));
    for (quantity, growth) in &cost.quantities {
        for place in 0..HORIZONS_S.len() {
            let own = cost.causes.iter().filter(|cause| cause.quantity == *quantity);
            let sum: f64 = own.map(|cause| cause.share[place]).sum();
            assert!((sum - 1.0).abs() < 1e-9, "{quantity} {place}: {sum}");
        }
        assert!(growth.band95.windows(2).all(|pair| pair[0] < pair[1]));
    }
    let without = both.replace(r#""K": 3e-6, "#, "");
    let without = costs(&model(&format!(r#""gyro_z": {without}"#)));
    let cause = cost.causes.iter().find(|cause| cause.cause == "K" && cause.quantity == Quantity::Heading).unwrap();
    for (left, band) in cause.band95_without.iter().zip(&without.quantities[&Quantity::Heading].band95) {
        assert!((left / band - 1.0).abs() < 1e-6);
    }
}

#[test]
fn limits_are_judged_by_the_band_with_the_cause_that_decides() {
    let model = model(r#""gyro_z": {"N": 1e-4, "effects": [{"effect": "warm_up", "amplitude": 1e-3, "tau_s": 300}]}"#);
    let tolerances = Tolerance::parse("heading=1deg/10min,heading=1deg/1s").unwrap();
    let found = cost(&model, "t", &Request { tolerances, ..request(&[10.0]) }).unwrap();
    assert_eq!(found.quantities[&Quantity::Heading].band95.len(), 1);
    let [late, early] = &found.tolerances[..] else { panic!("{:?}", found.tolerances) };
    assert!(!late.pass && late.deciding == "warm_up on gyro_z" && late.ratio > 1.0, "{late:?}");
    assert!(early.pass && early.deciding == "N on gyro_z", "{early:?}");
}

#[test]
fn senseless_requests_are_refused_with_what_is_allowed() {
    let plain = model(r#""gyro_z": {"N": 1e-4}"#);
    let refusal = |request: Request| cost(&plain, "t", &request).unwrap_err();
    assert!(matches!(refusal(request(&[0.0])), CostError::Horizon { .. }));
    assert!(matches!(refusal(request(&[-1.0])), CostError::Horizon { .. }));
    assert!(matches!(refusal(request(&[f64::NAN])), CostError::Horizon { .. }));
    assert!(matches!(refusal(request(&[10.0, 1.0])), CostError::Order { .. }));
    assert!(matches!(refusal(request(&[])), CostError::NoHorizon));
    assert!(matches!(refusal(request(&[1e-3])), CostError::Short { .. }));
    assert!(matches!(refusal(request(&[1e9])), CostError::Long { .. }));
    let limited = model(r#""gyro_z": {"N": 1e-4, "effects": [{"effect": "saturation", "low": -1e-3, "high": 2e-4}]}"#);
    assert!(cost(&limited, "t", &Request { runs: 3, ..request(&[1e5]) }).is_ok());
    let long = cost(&limited, "t", &request(&[1e6])).unwrap_err();
    assert!(matches!(long, CostError::Work { most_s: 500_000.0, .. }), "{long}");
    assert!(matches!(refusal(Request { align_s: 0.0, ..request(&[1.0]) }), CostError::Align { .. }));
    let tolerances = Tolerance::parse("position=1m/10s").unwrap();
    let absent = refusal(Request { tolerances, ..request(&[1.0]) }).to_string();
    assert!(absent.contains("position_x") && absent.contains("one of heading"), "{absent}");
    assert!(matches!(cost(&model(r#""mag_x": {}"#), "t", &request(&[1.0])), Err(CostError::NoChannel { .. })));
}

#[test]
fn models_that_lack_channels_say_so() {
    let attitude = costs(&model(r#""gyro_x": {"N": 1e-4}"#));
    assert_eq!(attitude.quantities.keys().copied().collect::<Vec<_>>(), [Quantity::AttitudeX]);
    assert_eq!(attitude.notes, ["the model has no horizontal accelerometer: attitude only"]);
    let notes = costs(&model(r#""gyro_x": {}, "gyro_z": {}, "accel_x": {}, "accel_y": {}"#)).notes;
    assert_eq!(notes, ["the model has no gyro_y: no attitude_y; velocity_x, position_x leave out its error"]);
}

#[test]
fn horizons_beyond_the_record_are_extrapolations_with_the_walks_upper_limit() {
    let channels = r#""gyro_z": {"N": 1e-4, "uncertainty": {"K": {"upper_limit95": 1e-5}}}"#;
    let fitted = model_with(channels, r#", "provenance": {"duration_s": 300}"#);
    let found = costs(&fitted);
    assert_eq!(found.extrapolated, Some(vec![false, false, true, true]));
    let heading = &found.quantities[&Quantity::Heading];
    let upper = heading.band95_upper.as_ref().unwrap();
    assert!(upper[3] > 3.0 * heading.band95[3], "{heading:?}");
    assert_eq!(costs(&model(channels)).extrapolated, None);
}

/// Compares all quantities of a model with `runs` of the simulator: standard deviation and mean within five standard
/// errors, the share of errors inside the band within five of its own. Returns the root mean squares of the relative
/// deviations of standard deviations, and of the standard errors of these.
fn agrees_with_the_simulator(name: &str, model: &SensorModel, request: &Request) -> [f64; 2] {
    let found = cost(model, "t", request).unwrap();
    // Simulated quantities are compared with other runs.
    let again = Request { seed: request.seed + 1_000_000, ..request.clone() };
    let setting = Setting::new(&again, model).unwrap();
    let quantities: Vec<Quantity> = found.quantities.keys().copied().collect();
    let runs = setting.runs as f64;
    let (mut squares, mut count) = ([0.0; 2], 0.0);
    for (quantity, values) in quantities.iter().zip(monte_carlo::quantities(&setting, &quantities).unwrap()) {
        let growth = &found.quantities[quantity];
        for (place, values) in values.iter().enumerate() {
            let at = format!("{name}: {quantity} at {} s", request.horizons_s[place]);
            let (sd, band) = (growth.sd[place], growth.band95[place]);
            let mean = values.iter().sum::<f64>() / runs;
            let moment = |power: i32| values.iter().map(|value| (value - mean).powi(power)).sum::<f64>() / runs;
            let simulated = moment(2).sqrt();
            let size = simulated.max(growth.mean[place].abs());
            assert!((mean - growth.mean[place]).abs() <= 5.0 * sd / runs.sqrt() + 1e-6 * size, "{at}: mean {mean}");
            if size == 0.0 || simulated < 1e-6 * size {
                assert!(sd <= 1e-6 * size, "{at}: sd {sd}");
                continue;
            }
            // The standard error of a standard deviation, from the fourth moment.
            let error = ((moment(4) / moment(2).powi(2) - 1.0).max(0.1) / runs).sqrt() / 2.0;
            let off = simulated / sd - 1.0;
            squares = [squares[0] + off * off, squares[1] + error * error];
            count += 1.0;
            assert!(off.abs() < 5.0 * error, "{at}: sd {sd}, simulated {simulated} ± {error:.3}");
            let inside = values.iter().filter(|value| value.abs() <= band).count() as f64 / runs;
            assert!((inside - 0.95).abs() < 5.0 * (0.05 * 0.95 / runs).sqrt(), "{at}: {inside} inside {band}");
        }
    }
    squares.map(|square| (square / f64::max(count, 1.0)).sqrt())
}

/// Models of one effect or a few on a gyroscope and an accelerometer, with their names.
fn worlds() -> Vec<(&'static str, SensorModel)> {
    let white = r#"{"N": 1e-4, "effects": ["#;
    [
        ("N", r#"{"N": 1e-4}"#.to_owned()),
        ("B", r#"{"B": 1e-4}"#.to_owned()),
        ("K", r#"{"K": 1e-5}"#.to_owned()),
        ("quantization_noise", effect(r#"{"effect": "quantization_noise", "Q": 1e-5}"#)),
        ("gauss_markov", effect(r#"{"effect": "gauss_markov", "sigma": 1e-3, "tc_s": 3}"#)),
        ("tone", effect(r#"{"effect": "tone", "frequency_hz": 0.31, "amplitude": 1e-3}"#)),
        ("comb", effect(r#"{"effect": "comb", "fundamental_hz": 0.21, "amplitudes": [1e-3, 0, 4e-4]}"#)),
        ("resonance", effect(r#"{"effect": "resonance", "frequency_hz": 7.3, "bandwidth_hz": 0.4, "sigma": 1e-3}"#)),
        ("spikes", effect(r#"{"effect": "spikes", "rate_hz": 0.2, "amplitude": 0.01, "cluster": 2}"#)),
        ("heavy_tails", format!(r#"{white}{{"effect": "heavy_tails", "degrees_of_freedom": 5}}]}}"#)),
        (
            "variance_change",
            format!(
                r#"{white}{{"effect": "variance_change", "profile": [[0, 0.5], [8, 4]]}},
                {{"effect": "variance_change", "from_s": 7, "to_s": 9, "factor": 3}}]}}"#
            ),
        ),
        ("bursts", format!(r#"{white}{{"effect": "bursts", "intervals": [[1, 2], [6, 8]], "sigma": 2e-3}}]}}"#)),
        ("common_mode", format!(r#"{white}{{"effect": "common_mode", "sigma": 1e-3}}]}}"#)),
        ("power_law", effect(r#"{"effect": "power_law", "alpha": 1.4, "at_hz": 1, "density": 1e-8}"#)),
        ("spectrum", effect(r#"{"effect": "spectrum", "density": [[0.5, 1e-8], [2, 4e-8], [9, 1e-9]]}"#)),
        (
            "tone inside intervals",
            effect(
                r#"{"effect": "intermittent", "of": {"effect": "tone", "frequency_hz": 3.1, "amplitude": 1e-3},
                    "intervals": [[4, 7.3], [9, 12]]}"#,
            ),
        ),
        (
            "wandering_line",
            effect(
                r#"{"effect": "wandering_line", "frequency_hz": 3, "amplitude": 1e-3, "frequency_sigma_hz": 0.3,
                    "frequency_tc_s": 0.5, "amplitude_sigma": 0.2, "amplitude_tc_s": 1}"#,
            ),
        ),
        (
            "low_pass",
            format!(r#"{white}{{"effect": "low_pass", "cutoff_hz": 9, "order": 2, "white_behind": 2e-5}}]}}"#),
        ),
        ("moving_average", format!(r#"{white}{{"effect": "moving_average", "window": 8}}]}}"#)),
        ("held_samples", format!(r#"{white}{{"effect": "held_samples", "probability": 0.4}}]}}"#)),
        ("resolution", format!(r#"{white}{{"effect": "resolution", "step": 5e-4}}]}}"#)),
        (
            "rate_ramp, warm_up and bias_step",
            format!(
                r#"{white}{{"effect": "rate_ramp", "R": 1e-5}}, {{"effect": "bias_step", "at_s": 7, "size": 1e-4}},
                {{"effect": "warm_up", "amplitude": 1e-3, "tau_s": 9}},
                {{"effect": "low_pass", "cutoff_hz": 9}}]}}"#
            ),
        ),
    ]
    .map(|(name, channel)| (name, model(&format!(r#""gyro_x": {channel}, "accel_y": {channel}"#))))
    .into()
}

fn effect(text: &str) -> String {
    format!(r#"{{"effects": [{text}]}}"#)
}

#[test]
fn closed_forms_agree_with_the_simulator() {
    let request =
        Request { align_s: 5.0, horizons_s: vec![0.1, 1.0, 3.0, 12.0], runs: 1000, seed: 7, ..Request::default() };
    for (name, model) in worlds() {
        let found = cost(&model, "t", &request).unwrap();
        assert!(found.quantities.values().all(|growth| growth.method == Method::ClosedForm), "{name}");
        agrees_with_the_simulator(name, &model, &request);
        let sampling = Some(imu_model::simulator::Sampling { internal_rate_hz: 160.0, filter_window: 3 });
        agrees_with_the_simulator(name, &SensorModel { sampling, ..model }, &request);
    }
}

#[test]
fn what_has_no_closed_form_is_simulated_and_says_so() {
    let request = Request { align_s: 5.0, runs: 200, ..request(&[1.0, 10.0]) };
    for (effect, runs) in [
        (r#"{"effect": "saturation", "low": -1e-3, "high": 2e-4}"#, true),
        (r#"{"effect": "saturation", "low": -1, "high": 1}"#, false),
        (r#"{"effect": "resolution", "step": 2e-3}"#, true),
        (r#"{"effect": "resolution", "step": 1e-4}"#, false),
        (
            r#"{"effect": "modulated_band", "frequency_hz": 3, "bandwidth_hz": 1, "sigma": 1e-3,
                "level": [[0, 1], [10, 3]]}"#,
            true,
        ),
        (
            r#"{"effect": "intermittent", "of": {"effect": "tone", "frequency_hz": 0.2, "amplitude": 1e-2},
                "on_s": 3, "off_s": 6}"#,
            true,
        ),
    ] {
        let model = model(&format!(r#""gyro_z": {{"N": 1e-4, "effects": [{effect}]}}, "gyro_x": {{"N": 1e-4}}"#));
        let found = cost(&model, "t", &request).unwrap();
        let heading = &found.quantities[&Quantity::Heading];
        assert_eq!(heading.method == Method::MonteCarlo, runs, "{effect}");
        assert_eq!((heading.runs, heading.simulated.len()), (runs.then_some(200), usize::from(runs)), "{effect}");
        assert_eq!(found.quantities[&Quantity::AttitudeX].method, Method::ClosedForm);
        let own = found.causes.iter().filter(|cause| cause.quantity == Quantity::Heading);
        assert!((own.map(|cause| cause.share[1]).sum::<f64>() - 1.0).abs() < 1e-9, "{effect}");
        agrees_with_the_simulator(effect, &model, &request);
    }
}

/// A sample that is sent again is the noise of another time.
#[test]
fn repeated_samples_of_changing_noise_are_simulated() {
    let request = Request { align_s: 5.0, runs: 500, ..request(&[1.0, 10.0]) };
    for effect in [
        r#"{"effect": "bursts", "intervals": [[0, 1e5]], "sigma": 1e-3}"#,
        r#"{"effect": "intermittent", "of": {"effect": "tone", "frequency_hz": 3.1, "amplitude": 1e-3}, "intervals": [[0, 1e5]]}"#,
    ] {
        let held = r#"{"effect": "held_samples", "probability": 0.4}"#;
        let model = model(&format!(r#""gyro_z": {{"N": 1e-6, "effects": [{effect}, {held}]}}"#));
        let found = cost(&model, "t", &request).unwrap();
        assert_eq!(found.quantities[&Quantity::Heading].method, Method::MonteCarlo, "{effect}");
        agrees_with_the_simulator(effect, &model, &request);
    }
}

/// The order of causes is that of the last horizon of the document, not that of a limit.
#[test]
fn a_limits_horizon_does_not_change_the_order_of_causes() {
    let model = model(r#""gyro_z": {"N": 1e-4, "effects": [{"effect": "warm_up", "amplitude": 1e-3, "tau_s": 300}]}"#);
    let tolerances = Tolerance::parse("heading=100deg/1h").unwrap();
    let found = cost(&model, "t", &Request { tolerances, ..request(&[1.0]) }).unwrap();
    assert_eq!(found.causes[0].cause, "N");
}

#[test]
fn numbers_below_the_smallest_square_cost_nothing() {
    let tone = with(r#"{"effect": "tone", "frequency_hz": 0.0137, "amplitude": 1e-160}"#, "gyro_z");
    assert!(costs(&tone).quantities[&Quantity::Heading].band95.iter().all(|band| *band < 1e-150));
}

/// The figures of docs/cost.md: `cargo test -p imu-cost -- --ignored --nocapture thousand_runs`. `RUNS=4000 ONLY=held` runs the models
/// whose name contains `held` with other seeds and more runs.
#[test]
#[ignore = "minutes; prints the table of docs/cost.md"]
fn a_thousand_runs_agree_at_twelve_horizons() {
    let horizons_s = vec![1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 3600.0];
    let runs: usize = std::env::var("RUNS").map_or(1000, |runs| runs.parse().unwrap());
    let only = std::env::var("ONLY").unwrap_or_default();
    let request = Request { runs, seed: if only.is_empty() { 100 } else { 1_000_100 }, ..request(&horizons_s) };
    println!("| model | deviation | standard error |\n|---|---|---|");
    let worlds = worlds();
    let row = |name: &str, model: &SensorModel| {
        if !name.contains(&only) {
            return;
        }
        let [off, error] = agrees_with_the_simulator(name, model, &request).map(|share| 100.0 * share);
        println!("| {name} | {off:.1} % | {error:.1} % |");
    };
    worlds.iter().for_each(|(name, model)| row(name, model));
    for mixture in 0..10 {
        let [one, two, three] = [0, 7, 13].map(|step| &worlds[(mixture + step) % worlds.len()]);
        let mut model = one.1.clone();
        for (channel, own) in &mut model.channels {
            own.effects.extend([two, three].iter().flat_map(|other| other.1.channels[channel].effects.clone()));
            (own.n, own.b, own.k) = (1e-4, 2e-5, 1e-7);
        }
        row(&format!("N, B, K, {}, {}, {}", one.0, two.0, three.0), &model);
    }
}

/// The figure of docs/cost.md: `cargo test --release -p imu-cost -- --ignored --nocapture less_than_a_second`.
#[test]
#[ignore = "measures time"]
fn nine_channels_of_twenty_effects_take_less_than_a_second() {
    let horizons_s = vec![1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 3600.0];
    for sampling in [None, Some(imu_model::simulator::Sampling { internal_rate_hz: 800.0, filter_window: 4 })] {
        let effects: Vec<_> = worlds()
            .iter()
            .flat_map(|(_, model)| model.channels.values().next())
            .collect::<Vec<_>>()
            .into_iter()
            .flat_map(|channel| channel.effects.clone())
            .filter(|effect| !["resolution", "moving_average", "held_samples"].contains(&effect.name()))
            .collect();
        let own = imu_model::simulator::ChannelModel { n: 1e-4, b: 1e-5, k: 1e-7, effects, ..Default::default() };
        let channels = imu_core::sample::Channel::ALL.into_iter().skip(3).take(9).map(|channel| (channel, own.clone()));
        let model = SensorModel { rate_hz: 40.0, sampling, channels: channels.collect(), ..SensorModel::default() };
        let start = std::time::Instant::now();
        let found = cost(&model, "t", &request(&horizons_s)).unwrap();
        let methods: Vec<Method> = found.quantities.values().map(|growth| growth.method).collect();
        assert!(methods.iter().all(|method| *method == Method::ClosedForm), "{methods:?}");
        println!("{} effects, {:?}: {:?}", own.effects.len(), model.sampling, start.elapsed());
    }
}
