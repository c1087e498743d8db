//! Costs along motions whose errors are worked by hand, and against the cost at rest.

use super::path::{Path, USED};
use super::{composed, courses, noise, samples_of};
use crate::request::{Along, Setting};
use crate::{Cost, CostError, Method, MotionRefusal, Quantity, Request, Tolerance, cost};
use imu_core::units::STANDARD_GRAVITY_M_S2 as G;
use imu_model::motion::{Course, Kind, Site, Temperatures};
use imu_model::simulator::{Motion, SensorModel};
use std::f64::consts::FRAC_PI_2;

const RATE_HZ: f64 = 40.0;
const ALIGN_S: f64 = 10.0;

fn model(channels: &str, more: &str) -> SensorModel {
    let text = format!(
        r#"{{"format": "vn100d-sensor-model-1", "name": "t", "rate_hz": 40, "channels": {{{channels}}}{more}}}"#
    );
    SensorModel::from_json(&text, "t.json").unwrap()
}

/// All six axes alike, and effects on the triads.
fn six(gyro: &str, accel: &str, triads: &str) -> SensorModel {
    let axes = |triad: &str, of: &str| ["x", "y", "z"].map(|axis| format!(r#""{triad}_{axis}": {of}"#)).join(", ");
    let channels = format!("{}, {}", axes("gyro", gyro), axes("accel", accel));
    model(&channels, &format!(r#", "triads": {{{triads}}}"#))
}

fn triad(name: &str, effect: &str) -> String {
    format!(r#""{name}": {{"effects": [{effect}]}}"#)
}

fn quiet(triads: &str) -> SensorModel {
    six("{}", "{}", triads)
}

/// A motion of a level sensor, z up, at each row's time.
fn rows(seconds: f64, at: impl Fn(f64) -> ([f64; 3], [f64; 3])) -> Along {
    let row = |index: usize| {
        let (gyro_rad_s, accel_m_s2) = at(index as f64 / RATE_HZ);
        Motion { gyro_rad_s, accel_m_s2, temperature_c: None }
    };
    let rows = (0..(seconds * RATE_HZ).round() as usize).map(row).collect();
    Along { name: "motion.csv".to_owned(), rate_hz: RATE_HZ, rows }
}

fn at_rest(seconds: f64) -> Along {
    rows(seconds, |_| ([0.0; 3], [0.0, 0.0, G]))
}

/// From 1 s on a turn about z.
fn turning(seconds: f64, rate: f64) -> Along {
    rows(seconds, |time_s| ([0.0, 0.0, if time_s < 1.0 { 0.0 } else { rate }], [0.0, 0.0, G]))
}

/// A quarter turn about an axis from 1 s to 2 s, at rest before and after.
fn quarter(seconds: f64, axis: usize) -> Along {
    rows(seconds, |time_s| {
        let turned = FRAC_PI_2 * (time_s - 1.0).clamp(0.0, 1.0);
        let mut rate = [0.0; 3];
        if (1.0..2.0).contains(&time_s) {
            rate[axis] = FRAC_PI_2;
        }
        let (sine, cosine) = turned.sin_cos();
        let force = [[0.0, sine, cosine], [-sine, 0.0, cosine], [0.0, 0.0, 1.0]][axis];
        (rate, force.map(|part| part * G))
    })
}

/// The sensor of the simulator's tumble, z down, with the turn of the Earth.
fn tumble(seconds: f64) -> Along {
    let course = Course::new(Kind::Tumble, seconds, Site::default()).unwrap();
    let rows = course.sampled(RATE_HZ).take((seconds * RATE_HZ) as usize).collect();
    Along { name: "tumble".to_owned(), rate_hz: RATE_HZ, rows }
}

fn request(motion: Along, horizons_s: &[f64]) -> Request {
    let horizons_s = horizons_s.to_vec();
    Request { align_s: ALIGN_S, horizons_s, motion: Some(motion), runs: 200, ..Request::default() }
}

fn costs(model: &SensorModel, motion: Along, horizons_s: &[f64]) -> Cost {
    cost(model, "t.json", &request(motion, horizons_s)).unwrap()
}

/// Compares the mean of a quantity at the first horizon.
fn mean_is(found: &Cost, quantity: Quantity, expected: f64, share: f64) {
    let mean = found.quantities[&quantity].mean[0];
    let off = (mean - expected).abs();
    assert!(off <= share * expected.abs(), "{quantity}: {mean}, expected {expected}\n{:?}", found.quantities);
}

#[test]
fn a_scale_factor_makes_its_part_of_a_turn() {
    let effect = triad("gyro", r#"{"effect": "scale_factor", "x": 0.3, "y": 0.2, "z": 2e-3}"#);
    let found = costs(&six(r#"{"bias": 0.02}"#, "{}", &effect), turning(5.0, -0.7), &[5.0]);
    mean_is(&found, Quantity::Heading, 2e-3 * -0.7 * 4.0, 1e-6);
    let heading = &found.quantities[&Quantity::Heading];
    assert_eq!((heading.method, heading.sd[0]), (Method::ClosedForm, 0.0));
    assert!((heading.band95[0] / heading.mean[0].abs() - 1.0).abs() < 1e-12);
    assert_eq!(found.motion.as_deref(), Some("motion.csv"));
    let causes: Vec<String> =
        found.causes.iter().filter(|of| of.quantity == Quantity::Heading).map(|of| of.channel.to_string()).collect();
    assert_eq!(causes, ["gyro_z"]);
    assert_eq!(found.quantities[&Quantity::AttitudeX].band95, [0.0]);
}

#[test]
fn a_misaligned_gyroscope_tilts_as_it_turns() {
    let effect = triad("gyro", r#"{"effect": "misalignment", "x": 0, "y": 1e-5, "z": 0}"#);
    let found = costs(&quiet(&effect), turning(5.0, 0.4), &[5.0]);
    // x shows 1e-5 of the rate about z, along a direction that turns with the sensor.
    let angle = 0.4_f64 * 4.0;
    mean_is(&found, Quantity::AttitudeX, 1e-5 * angle.sin(), 1e-4);
    mean_is(&found, Quantity::AttitudeY, 1e-5 * (1.0 - angle.cos()), 1e-4);
    assert!(found.quantities[&Quantity::Heading].mean[0].abs() < 1e-9);
}

#[test]
fn a_delay_lacks_what_happened_during_it() {
    let late = |name: &str, seconds: f64| triad(name, &format!(r#"{{"effect": "latency", "seconds": {seconds}}}"#));
    for delay_s in [0.05, 0.031] {
        let ahead = rows(5.0, |time_s| ([0.0; 3], [if time_s < 1.0 { 0.0 } else { 1.5 }, 0.0, G]));
        let found = costs(&quiet(&late("accel", delay_s)), ahead, &[5.0]);
        mean_is(&found, Quantity::VelocityX, -1.5 * delay_s, 1e-9);
        mean_is(&found, Quantity::PositionX, -1.5 * delay_s * (4.0 - delay_s / 2.0), 1e-2);
        let found = costs(&quiet(&late("gyro", delay_s)), turning(5.0, 0.8), &[5.0]);
        mean_is(&found, Quantity::Heading, -0.8 * delay_s, 1e-9);
    }
}

#[test]
fn a_motion_at_rest_costs_what_rest_costs() {
    let still = |model: &SensorModel| {
        let request = Request { runs: 500, ..request(at_rest(60.0), &[2.0, 20.0, 60.0]) };
        let rest = Request { motion: None, ..request.clone() };
        (cost(model, "t", &request).unwrap(), cost(model, "t", &rest).unwrap())
    };
    let gyro = r#"{"N": 1e-4, "B": 3e-5, "K": 1e-5, "effects": [{"effect": "tone", "frequency_hz": 0.31, "amplitude": 1e-3}]}"#;
    let (along, rest) =
        still(&six(gyro, r#"{"N": 2e-3, "K": 1e-4, "effects": [{"effect": "common_mode", "sigma": 1e-2}]}"#, ""));
    for (quantity, own) in &along.quantities {
        assert_eq!((own.method, own.runs), (Method::MonteCarlo, Some(500)));
        for (place, (sd, expected)) in own.sd.iter().zip(&rest.quantities[quantity].sd).enumerate() {
            // Five standard errors of a standard deviation.
            assert!((sd / expected - 1.0).abs() < 5.0 / 1000.0_f64.sqrt(), "{quantity} {place}: {sd} {expected}");
            let band = own.band95[place] / rest.quantities[quantity].band95[place];
            assert!((band - 1.0).abs() < 0.25, "{quantity} {place}: {band}");
        }
    }
    // Small, since the full strapdown turns what the formulas at rest add up.
    let channels = r#""gyro_y": {"effects": [{"effect": "warm_up", "amplitude": 1e-7, "tau_s": 30}]}, "gyro_x": {}, "gyro_z": {},
        "accel_x": {"effects": [{"effect": "rate_ramp", "R": 1e-6}]}, "accel_y": {}, "accel_z": {}"#;
    let (along, rest) = still(&model(channels, ""));
    for quantity in [Quantity::AttitudeY, Quantity::VelocityX, Quantity::PositionX] {
        for (mean, expected) in along.quantities[&quantity].mean.iter().zip(&rest.quantities[&quantity].mean) {
            assert!(*expected != 0.0 && (mean / expected - 1.0).abs() < 1e-8, "{quantity}: {mean} {expected}");
        }
    }
}

#[test]
fn an_error_acts_on_the_axis_that_the_sensor_has_been_turned_to() {
    let step = r#"{"effects": [{"effect": "bias_step", "at_s": 12, "size": 1e-5}]}"#;
    let channels = format!(r#""gyro_x": {step}, "gyro_y": {{}}, "gyro_z": {{}}, "accel_x": {{}}, "accel_y": {{}}"#);
    let found = costs(&model(&channels, ""), quarter(12.0, 2), &[12.0]);
    // The sensor's x axis is along y.
    mean_is(&found, Quantity::AttitudeY, 1e-5 * 10.0, 1e-6);
    mean_is(&found, Quantity::VelocityX, G * 1e-5 * 50.0, 1e-6);
    mean_is(&found, Quantity::PositionX, G * 1e-5 * 1000.0 / 6.0, 1e-6);
    assert!(found.quantities[&Quantity::AttitudeX].mean[0].abs() < 1e-12);
    assert!(found.quantities[&Quantity::VelocityY].mean[0].abs() < 1e-9);
    let turned = |of: &crate::Cause| of.quantity == Quantity::VelocityX && of.channel.to_string() == "gyro_x";
    assert!(found.causes.iter().any(|of| turned(of) && (of.share[0] - 1.0).abs() < 1e-9));
    assert!(found.notes.iter().any(|note| note.contains("no accel_z")), "{:?}", found.notes);
}

#[test]
fn constants_and_other_sensors_change_nothing() {
    let plain = six(r#"{"N": 1e-4}"#, r#"{"N": 1e-3}"#, "");
    let mut rich = six(
        r#"{"N": 1e-4, "bias": 0.123}"#,
        r#"{"N": 1e-3, "bias": -0.3}"#,
        &triad("gyro", r#"{"effect": "bias", "x": 0.1, "y": 0, "z": 0.01}"#),
    );
    let others = model(r#""mag_x": {"N": 1, "bias": 3}, "pressure": {"K": 1}"#, "");
    rich.channels.extend(others.channels);
    let [plain, rich] = [plain, rich].map(|model| costs(&model, tumble(120.0), &[10.0, 100.0]));
    for (quantity, own) in &rich.quantities {
        assert_eq!(own.mean, [0.0; 2], "{quantity}");
        for (sd, expected) in own.sd.iter().zip(&plain.quantities[quantity].sd) {
            assert!((sd / expected - 1.0).abs() < 1e-9, "{quantity}: {sd} {expected}");
        }
    }
}

#[test]
fn an_alignment_takes_the_errors_of_its_pose_and_no_other() {
    let effect = r#"{"effect": "scale_factor", "x": 1e-3, "y": 1e-3, "z": 2e-3},
        {"effect": "misalignment", "x": 1e-3, "y": 3e-3, "z": 0}"#;
    let sensor = quiet(&triad("accel", effect));
    let level = costs(&sensor, at_rest(10.0), &[10.0]);
    assert!(level.quantities.values().all(|of| of.band95 == [0.0]), "{:?}", level.quantities);
    // About y: z ahead, x down. What z showed of gravity is gone, and its bias remains; x shows gravity of its own.
    let found = costs(&sensor, quarter(10.0, 1), &[4.0, 10.0]);
    let rate = |quantity: Quantity| {
        let mean = &found.quantities[&quantity].mean;
        (mean[1] - mean[0]) / 6.0
    };
    // Second order: z shows −3e-3 of x, which is scaled by 2e-3.
    let ahead = -2e-3 * G + 3e-3 * G * (1.0 + 2e-3);
    assert!((rate(Quantity::VelocityX) / ahead - 1.0).abs() < 1e-6, "{} {ahead}", rate(Quantity::VelocityX));
    assert!((rate(Quantity::VelocityY) / (1e-3 * G * 1.001) - 1.0).abs() < 1e-6, "{}", rate(Quantity::VelocityY));
}

#[test]
fn gravity_on_a_gyroscope_acts_once_the_pose_has_changed() {
    let effect = triad("gyro", r#"{"effect": "g_sensitivity", "m": [[0, 0, 0], [0, 0, 0], [0, 0, 1e-6]]}"#);
    assert_eq!(costs(&quiet(&effect), at_rest(9.0), &[9.0]).quantities[&Quantity::Heading].band95, [0.0]);
    // About x: z is along −y, and lacks the gravity of the alignment.
    let found = costs(&quiet(&effect), quarter(9.0, 0), &[3.0, 9.0]);
    let mean = &found.quantities[&Quantity::AttitudeY].mean;
    assert!(((mean[1] - mean[0]) / (6.0 * 1e-6 * G) - 1.0).abs() < 1e-6, "{mean:?}");
}

#[test]
fn a_perfect_sensor_has_no_error_under_the_turning_earth() {
    let found = costs(&quiet(""), tumble(120.0), &[10.0, 119.0]);
    assert!(found.quantities.values().all(|of| of.band95 == [0.0; 2] && of.method == Method::ClosedForm));
    assert!(found.causes.is_empty() && found.notes.is_empty(), "{:?}", found.notes);
    let scaled = quiet(&triad("gyro", r#"{"effect": "scale_factor", "x": 1e-3, "y": 1e-3, "z": 1e-3}"#));
    let still = Course::new(Kind::Still, 100.0, Site::default()).unwrap().sampled(RATE_HZ).take(4000).collect();
    let still = Along { name: "still".to_owned(), rate_hz: RATE_HZ, rows: still };
    assert!(costs(&scaled, still, &[100.0]).quantities.values().all(|of| of.band95[0] < 1e-9));
}

/// Values of the sensor that exceed its range are lost in each run alike.
#[test]
fn a_limit_that_a_turn_reaches_is_simulated() {
    let sensor = six(r#"{"N": 1e-6}"#, "{}", &triad("gyro", r#"{"effect": "saturation", "range": 0.5}"#));
    let found = costs(&sensor, turning(5.0, 0.8), &[5.0]);
    mean_is(&found, Quantity::Heading, -0.3 * 4.0, 1e-4);
    let heading = &found.quantities[&Quantity::Heading];
    assert_eq!((heading.method, heading.simulated[0].as_str()), (Method::MonteCarlo, "saturation on gyro_z"));
    let own: Vec<_> = found.causes.iter().filter(|of| of.quantity == Quantity::Heading).collect();
    assert!((own[0].share[0] - 1.0).abs() < 1e-3 && own[0].cause == "saturation", "{own:?}");
    assert!((own.iter().map(|of| of.share[0]).sum::<f64>() - 1.0).abs() < 1e-9);
    let far = six(r#"{"N": 1e-6}"#, "{}", &triad("gyro", r#"{"effect": "saturation", "range": 1.5}"#));
    let found = costs(&far, turning(5.0, 0.8), &[5.0]);
    assert_eq!(found.quantities[&Quantity::Heading].simulated, ["the motion"]);
}

#[test]
fn shares_sum_to_one_and_a_cause_taken_out_leaves_what_the_rest_does() {
    let gyro = r#"{"N": 3e-4, "K": 1e-5, "effects": [{"effect": "low_pass", "cutoff_hz": 3, "white_behind": 1e-4},
        {"effect": "variance_change", "from_s": 0, "to_s": 30, "factor": 2}, {"effect": "resolution", "step": 1e-4}]}"#;
    let scale = r#"{"effect": "scale_factor", "x": 1e-3, "y": -2e-3, "z": 3e-3}"#;
    let late = r#"{"effect": "latency", "seconds": 0.02}"#;
    let sensor = six(gyro, r#"{"N": 1e-3}"#, &triad("gyro", &format!("{scale}, {late}")));
    let found = costs(&sensor, tumble(120.0), &[20.0, 110.0]);
    for (quantity, growth) in &found.quantities {
        for place in 0..2 {
            let own = found.causes.iter().filter(|cause| cause.quantity == *quantity);
            let sum: f64 = own.map(|cause| cause.share[place]).sum();
            assert!((sum - 1.0).abs() < 1e-9, "{quantity} {place}: {sum}");
            assert!(growth.band95[place] > growth.sd[place], "{quantity}");
        }
    }
    let without = costs(&six(gyro, r#"{"N": 1e-3}"#, &triad("gyro", late)), tumble(120.0), &[20.0, 110.0]);
    // All of the heading's scale factors are taken out one by one: those of the others hardly matter at 20 s.
    let named = |cause: &str, channel: &str| {
        let is_own = |of: &&crate::Cause| {
            of.quantity == Quantity::AttitudeX && of.cause == cause && of.channel.to_string() == channel
        };
        found.causes.iter().find(is_own).unwrap_or_else(|| panic!("{cause} on {channel}"))
    };
    let [left, band] =
        [named("scale_factor", "gyro_x").band95_without[0], without.quantities[&Quantity::AttitudeX].band95[0]];
    assert!((left / band - 1.0).abs() < 1e-3, "{left} {band}");
    for cause in ["N", "K", "low_pass", "variance_change", "resolution", "latency"] {
        assert_eq!(named(cause, "gyro_y").share.len(), 2);
    }
}

/// Each run of the sum over the causes is a run of the whole sensor.
#[test]
fn noise_of_the_causes_sums_to_the_noise_of_the_whole() {
    let gyro = r#"{"N": 1e-4, "B": 1e-4, "K": 1e-5, "effects": [{"effect": "low_pass", "cutoff_hz": 5, "white_behind": 1e-4},
        {"effect": "tone", "frequency_hz": 0.3, "amplitude": 1e-3}, {"effect": "tone", "frequency_hz": 1.3, "amplitude": 1e-3},
        {"effect": "common_mode", "sigma": 1e-3}, {"effect": "heavy_tails", "degrees_of_freedom": 5},
        {"effect": "variance_change", "from_s": 15, "to_s": 30, "factor": 4}]}"#;
    for more in ["", r#", "sampling": {"internal_rate_hz": 80, "filter_window": 3}"#] {
        let mut sensor = six(gyro, gyro, "");
        sensor.sampling = model(r#""gyro_x": {}"#, more).sampling;
        let request = Request { runs: 3, begin_s: 2.0, ..request(tumble(80.0), &[0.5, 80.0]) };
        let along = request.motion.clone().unwrap();
        let setting = Setting::new(&request, &sensor).unwrap();
        let path = Path::new(&setting, &along, samples_of(&along, &sensor).unwrap().0, true).unwrap();
        let restricted = crate::sources::restricted(&sensor, &USED);
        let courses = courses::courses(&path, &setting, &restricted).unwrap();
        let noises = noise::noises(&path, &setting, &restricted, &courses).unwrap();
        assert!(noises.nonlinear.is_empty() && noises.all.len() == 6 * 7, "{:?}", noises.nonlinear);
        let all: Vec<_> = noises.all.iter().map(|noise| noise.runs(&path, &setting).unwrap()).collect();
        for (run, whole) in noise::whole(&path, &setting, &restricted).unwrap().iter().enumerate() {
            for (horizon, whole) in whole.iter().enumerate() {
                for (place, whole) in whole.iter().enumerate() {
                    let parts: Vec<f64> = all.iter().map(|of| of[run][horizon][place]).collect();
                    let size = parts.iter().map(|part| part * part).sum::<f64>().sqrt();
                    let off = parts.iter().sum::<f64>() + courses.mean[horizon][place] - whole;
                    assert!(off.abs() < 0.03 * size, "run {run}, {place} at {horizon}: {off} of {size}");
                }
            }
        }
    }
}

#[test]
fn a_mean_over_the_sensors_own_samples_is_late_by_half_of_it() {
    let mut sensor = quiet("");
    sensor.sampling =
        model(r#""gyro_x": {}"#, r#", "sampling": {"internal_rate_hz": 80, "filter_window": 8}"#).sampling;
    let found = costs(&sensor, turning(5.0, 0.8), &[5.0]);
    // Between the rows of the file the rate rises evenly, half a period of 80 Hz before the second of them.
    mean_is(&found, Quantity::Heading, -0.8 * (3.5 / 80.0), 0.15);
    assert!(found.causes.iter().all(|of| of.cause == "sampling"), "{:?}", found.causes);
    let own = Along { rate_hz: 80.0, ..turning(10.0, 0.8) };
    let found = costs(&sensor, own, &[4.0]);
    mean_is(&found, Quantity::Heading, -0.8 * (3.5 / 80.0), 0.15);
}

#[test]
fn the_temperature_of_the_motion_counts_unless_another_is_given() {
    let sensor = six(r#"{"effects": [{"effect": "temperature_bias", "per_c": 1e-5, "reference_c": 25}]}"#, "{}", "");
    let mut warm = at_rest(20.0);
    let heated = |(index, row): (usize, &Motion)| Motion { temperature_c: Some(25.0 + index as f64 / 40.0), ..*row };
    warm.rows = warm.rows.iter().enumerate().map(heated).collect();
    let found = costs(&sensor, warm.clone(), &[20.0]);
    // A degree per second.
    mean_is(&found, Quantity::Heading, 1e-5 * 200.0, 1e-2);
    let constant = Request { temperature: Some(Temperatures::constant(30.0)), ..request(warm, &[20.0]) };
    let found = cost(&sensor, "t", &constant).unwrap();
    assert_eq!(found.quantities[&Quantity::Heading].band95, [0.0]);
}

#[test]
fn what_is_no_motion_or_too_short_is_refused_with_what_is_allowed() {
    let sensor = six(r#"{"N": 1e-4}"#, r#"{"N": 1e-3}"#, "");
    let refusal = |request: &Request| match cost(&sensor, "t", request).unwrap_err() {
        CostError::Motion(refusal) => refusal,
        other => panic!("{other}"),
    };
    let short = refusal(&request(at_rest(5.0), &[6.0])).to_string();
    assert!(short.contains("motion.csv ends after 5 s, before 6 s"), "{short}");
    let tolerances = Tolerance::parse("heading=1deg/10s").unwrap();
    let limit = refusal(&Request { tolerances, ..request(at_rest(5.0), &[1.0]) });
    assert!(matches!(limit, MotionRefusal::Short { found_s: 10.0, .. }));
    let one = Along { rows: at_rest(5.0).rows[..1].into(), ..at_rest(5.0) };
    assert!(matches!(refusal(&request(one, &[0.025])), MotionRefusal::Rows { found: 1, .. }));
    for value in [f64::NAN, f64::INFINITY] {
        let broken = rows(5.0, |time_s| ([0.0; 3], [if time_s == 3.0 { value } else { 0.0 }, 0.0, G]));
        assert!(matches!(refusal(&request(broken, &[1.0])), MotionRefusal::Value { row: 121, .. }));
    }
    let falling = refusal(&request(rows(5.0, |_| ([0.0; 3], [0.0, 0.0, 3.0])), &[1.0])).to_string();
    assert!(falling.contains("3.000 m/s²") && falling.contains("at rest"), "{falling}");
    let other = Along { rate_hz: 50.0, ..at_rest(5.0) };
    assert!(refusal(&request(other, &[1.0])).to_string().contains("50 rows per second"));
    let wild = rows(5.0, |time_s| ([0.0; 3], [if time_s < 1.0 { 0.0 } else { 1e308 }, 0.0, G]));
    assert!(matches!(refusal(&request(wild, &[5.0])), MotionRefusal::Infinite { .. }));
    let many = Request { runs: 10_000_000, ..request(at_rest(5.0), &[5.0]) };
    assert!(matches!(refusal(&many), MotionRefusal::Work { .. }));
    // Setting checks the rest.
    assert!(matches!(cost(&sensor, "t", &request(at_rest(5.0), &[f64::NAN])), Err(CostError::Horizon { .. })));
    assert!(composed(&request(at_rest(5.0), &[1.0]), &at_rest(5.0), &sensor, &[Quantity::Heading]).is_ok());
}

#[test]
fn horizons_beyond_the_motion_are_left_out_and_notes_say_what_is_missing() {
    let gyro = model(r#""gyro_x": {"N": 1e-4}, "gyro_z": {"N": 1e-4}"#, "");
    let found = costs(&gyro, rows(5.0, |_| ([0.0, 0.0, 0.1], [0.0, 0.0, G])), &[1.0, 5.0, 5.1, 60.0]);
    assert_eq!(found.horizons_s, [1.0, 5.0]);
    assert_eq!(found.quantities.keys().copied().collect::<Vec<_>>(), [Quantity::AttitudeX, Quantity::Heading]);
    assert!(found.quantities.values().all(|of| of.band95.len() == 2));
    let notes = found.notes.join("; ");
    for words in
        ["ends after 5 s: no horizon of 5.1 s, 60 s", "attitude only", "no gyro_y", "turn of (0, 0, 0.100) rad/s"]
    {
        assert!(notes.contains(words), "{words:?} is not in {notes}");
    }
}

/// z down, as a VN-100: y is opposite to the sensor's, and so is the sign of the heading.
#[test]
fn axes_are_those_of_the_world_with_z_up() {
    let steps = |axis: &str| {
        let step = r#"{"effects": [{"effect": "bias_step", "at_s": 10, "size": 1e-5}]}"#;
        let channels = ["x", "y", "z"].map(|own| format!(r#""gyro_{own}": {}"#, if own == axis { step } else { "{}" }));
        let down = rows(4.0, |_| ([0.0; 3], [0.0, 0.0, -G]));
        let found = costs(&model(&channels.join(", "), ""), down, &[4.0]);
        [Quantity::AttitudeX, Quantity::AttitudeY, Quantity::Heading]
            .map(|of| (found.quantities[&of].mean[0] / 4e-5).round())
    };
    assert_eq!([steps("x"), steps("y"), steps("z")], [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]);
}
