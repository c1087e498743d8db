//! The filter against derivatives, closed forms, and worlds whose noise it knows.

use crate::assumed::{assumed, channels};
use crate::filter::{
    ATTITUDE, Covariance, Density, Errors, Filter, Fix, Noise, POSITION, STATES, Sample, State, VELOCITY,
};
use crate::outage::{Aid, Outcome, Plan, aligned, outages};
use crate::score::score;
use imu_core::units::STANDARD_GRAVITY_M_S2;
use imu_cost::{Over, Quantity, Request, cost};
use imu_model::simulator::{SensorModel, Simulator};
use nalgebra::{UnitQuaternion, Vector3};

const RATE_HZ: f64 = 40.0;
const GYRO: Density = Density { n: 1.2e-4, k: 5e-6 };
const ACCEL: Density = Density { n: 2e-3, k: 1e-4 };
const NOISE: Noise = [GYRO, GYRO, GYRO, ACCEL, ACCEL, ACCEL];

fn plan(aid: Aid) -> Plan {
    let aid_sd = if aid == Aid::Position { 0.01 } else { 2e-3 };
    Plan { align_s: 10.0, aided_s: 30.0, interval_s: 1.0, outage_s: 20.0, aid, aid_sd, attitude_sd: 1e-4 }
}

/// A sensor of white noise and walks.
fn model() -> SensorModel {
    let of = |(channel, own): (_, Density)| format!(r#""{channel}": {{"N": {}, "K": {}}}"#, own.n, own.k);
    let all: Vec<String> = channels().into_iter().zip(NOISE).map(of).collect();
    let text = format!(
        r#"{{"format": "vn100d-sensor-model-1", "name": "t", "rate_hz": {RATE_HZ}, "channels": {{{}}}}}"#,
        all.join(", ")
    );
    SensorModel::from_json(&text, "t").unwrap()
}

fn simulated(seed: u64, length_s: f64) -> Vec<Sample> {
    let mut simulator = Simulator::new(&model(), seed, RATE_HZ, length_s).unwrap();
    let mut samples = Vec::new();
    while samples.len() < (length_s * RATE_HZ) as usize {
        let block = simulator.next_block().unwrap();
        let columns = channels().map(|channel| block.values(channel).unwrap());
        samples.extend((0..block.len()).map(|at| columns.map(|column| column[at])));
    }
    samples
}

fn scaled_n(factor: f64) -> Noise {
    NOISE.map(|of| Density { n: factor * of.n, ..of })
}

/// Each column of the transition is the difference of two nonlinear integrations from states a little apart, with a turn of
/// 1.2 rad/s and a force of 12 m/s². The force counts as that of the step's middle, which costs at most half of the step's turn.
#[test]
fn transitions_are_derivatives() {
    let gravity = -STANDARD_GRAVITY_M_S2 * Vector3::z();
    let sample = [0.7, -0.9, 0.4, 3.0, -5.0, 11.0];
    let state = State {
        attitude: UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.8, 1.1)),
        velocity: Vector3::new(1.0, 2.0, -0.5),
        position: Vector3::new(-3.0, 0.1, 7.0),
        gyro_bias: Vector3::new(0.02, 0.01, -0.03),
        accel_bias: Vector3::new(0.2, -0.1, 0.3),
    };
    for dt in [0.025, 0.0025] {
        let moved = |state: State, covariance: Covariance| {
            let mut filter = Filter::new(state, covariance, Noise::default(), gravity);
            filter.predict(&[sample], dt);
            filter
        };
        let (mut own, mut expected) = (Covariance::zeros(), Covariance::zeros());
        for column in 0..STATES {
            let mut errors = Errors::zeros();
            errors[column] = 1e-4;
            let [up, down] = [1.0, -1.0].map(|sign| moved(state.plus(&(sign * errors)), Covariance::zeros()).state);
            expected.set_column(column, &(up.minus(&down) / 2e-4));
            // The covariance of one error of size 1 is the product of a column of the transition with itself, and that column's
            // own element is 1.
            let product = moved(state, Covariance::from_diagonal(&(errors * 1e4))).covariance;
            own.set_column(column, &product.column(column));
        }
        for (row, column) in (0..STATES).step_by(3).flat_map(|row| (0..STATES).step_by(3).map(move |of| (row, of))) {
            let [own, expected] = [&own, &expected].map(|of| of.fixed_view::<3, 3>(row, column).into_owned());
            let tolerance = 0.6 * dt * expected.norm() + 1e-7 * dt;
            assert!((own - expected).norm() < tolerance, "{row} {column}: {own} {expected}");
        }
    }
}

/// Without fixes the covariance is that of imu-cost, and for attitude that of docs/filters.md.
#[test]
fn unaided_covariance_is_the_closed_form() {
    let (align_s, rest) = (30.0, [0.0, 0.0, 0.0, 0.0, 0.0, STANDARD_GRAVITY_M_S2]);
    let mut filter = aligned(&vec![rest; (align_s * RATE_HZ) as usize], RATE_HZ, Vector3::z(), &NOISE);
    let horizons_s = vec![1.0, 10.0, 60.0, 300.0];
    let request = Request { align_s, horizons_s: horizons_s.clone(), ..Request::default() };
    let expected = cost(&model(), "t", &request).unwrap();
    let mut now_s = 0.0;
    for (place, horizon_s) in horizons_s.into_iter().enumerate() {
        while now_s < horizon_s {
            filter.predict(&[rest; 40], 1.0 / RATE_HZ);
            now_s += 1.0;
        }
        let variance = GYRO.n.powi(2) * (now_s + now_s * now_s / align_s)
            + GYRO.k.powi(2) * (now_s.powi(3) + now_s * now_s * align_s) / 3.0;
        assert!((filter.covariance[(0, 0)] / variance - 1.0).abs() < 1e-9);
        for (quantity, at) in [
            (Quantity::AttitudeX, ATTITUDE),
            (Quantity::Heading, ATTITUDE + 2),
            (Quantity::VelocityX, VELOCITY),
            (Quantity::VelocityY, VELOCITY + 1),
            (Quantity::PositionX, POSITION),
        ] {
            let (own, sd) = (filter.covariance[(at, at)].sqrt(), expected.quantities[&quantity].sd[place]);
            // A sample holds: the walk and the integral of its first period are those of 40 steps, 1 % at the first horizon.
            let tolerance = if now_s > 5.0 { 4e-3 } else { 0.02 };
            assert!((own / sd - 1.0).abs() < tolerance, "{quantity} after {now_s} s: {own}, expected {sd}");
        }
        assert!(filter.state.attitude.scaled_axis().norm() < 1e-12 && filter.state.position.norm() < 1e-6);
    }
}

/// A step over many samples at rest is as many steps over one.
#[test]
fn one_long_step_is_many_short_ones() {
    let samples = simulated(5, 12.0);
    let [mut long, mut short] = [(); 2].map(|()| aligned(&samples[..400], RATE_HZ, Vector3::z(), &NOISE));
    long.predict(&samples[400..480], 1.0 / RATE_HZ);
    samples[400..480].chunks(1).for_each(|own| short.predict(own, 1.0 / RATE_HZ));
    assert_eq!(long.state, short.state);
    for at in 0..STATES {
        let [own, other] = [&long, &short].map(|of| of.covariance[(at, at)]);
        assert!((own / other - 1.0).abs() < 1e-4, "{at}: {own} {other}");
    }
}

/// A fix of an error that is correlated with nothing: the product of two normal laws.
#[test]
fn a_fix_is_the_product_of_two_laws() {
    let rest = [0.0, 0.0, 0.0, 0.0, 0.0, STANDARD_GRAVITY_M_S2];
    let mut filter = aligned(&[rest; 40], RATE_HZ, Vector3::z(), &NOISE);
    filter.covariance = Covariance::identity() * 4.0;
    let nis = filter.fix(&Fix::Position(Vector3::new(3.0, 0.0, -1.0)), 1.0).unwrap();
    assert!((nis - 10.0 / 5.0).abs() < 1e-12);
    assert!((filter.state.position - Vector3::new(2.4, 0.0, -0.8)).norm() < 1e-12);
    assert!((filter.covariance[(6, 6)] - 0.8).abs() < 1e-12 && (filter.covariance[(3, 3)] - 4.0).abs() < 1e-12);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.5));
    filter.fix(&Fix::Attitude(turn), 2.0).unwrap();
    assert!((filter.state.attitude.angle_to(&turn) - 0.25).abs() < 1e-12, "{}", filter.state.attitude);
    filter.covariance = Covariance::zeros();
    let before = filter.state;
    assert!(filter.fix(&Fix::Velocity(Vector3::x()), 0.0).is_none() && filter.state == before);
}

/// Twelve seeds, each with 40 outages, both aids, three triads of errors: 72 averages, each in its bounds with 95 %. Fewer than 60
/// have a probability of 1e-4 if all are independent; triads of one run are not. Five times too large or too small an N is found
/// in all.
#[test]
fn a_filter_that_knows_its_noise_is_consistent() {
    let mut consistent = 0;
    for seed in 0..12 {
        let samples = simulated(seed, 2400.0);
        for aid in [Aid::ZeroVelocity, Aid::Position] {
            let of = |noise: &Noise| outages(&samples, RATE_HZ, Vector3::z(), noise, &plan(aid), seed);
            let [right, bold, shy] = [1.0, 0.2, 5.0].map(|factor| of(&scaled_n(factor)));
            assert_eq!(right.len(), 40);
            for at in [ATTITUDE, VELOCITY, POSITION] {
                let triad = |of: &[Outcome]| score(of, at..at + 3).unwrap();
                let [right, bold, shy] = [&right, &bold, &shy].map(|of| triad(of));
                consistent += usize::from(right.is_consistent());
                assert!((0.6..1.5).contains(&right.nees) && right.coverage > 0.88, "{aid:?} {at}: {right:?}");
                assert!(bold.nees > bold.bounds[1] && shy.nees < shy.bounds[0], "{aid:?} {at}: {bold:?} {shy:?}");
                assert!(right.log_score < bold.log_score.min(shy.log_score), "{aid:?} {at}");
            }
        }
    }
    assert!(consistent >= 60, "{consistent} of 72");
}

/// The bounds are those of a table of χ² for 150 degrees of freedom: 117.985 and 185.800.
#[test]
fn scores_of_known_errors() {
    let mut outcome = Outcome { errors: nalgebra::SVector::zeros(), covariance: nalgebra::SMatrix::identity() * 4.0 };
    outcome.errors[1] = 3.0;
    outcome.errors[2] = 4.0;
    let found = score(&vec![outcome; 50], 0..3).unwrap();
    assert!((found.nees - 25.0 / 12.0).abs() < 1e-12 && !found.is_consistent());
    assert!((found.bounds[0] * 150.0 - 117.985).abs() < 1e-3 && (found.bounds[1] * 150.0 - 185.800).abs() < 1e-3);
    assert!((found.coverage - 2.0 / 3.0).abs() < 1e-12);
    let expected = 0.5 * (25.0 / 12.0 + (std::f64::consts::TAU * 4.0).ln());
    assert!((found.log_score - expected).abs() < 1e-12, "{} {expected}", found.log_score);
    assert!(score(&[], 0..3).is_none());
}

#[test]
fn the_pairs_of_a_sensor_of_white_noise_and_walks_are_its_own() {
    let plan = Plan { outage_s: 60.0, ..plan(Aid::Position) };
    let request = plan.request(20.0);
    assert_eq!((request.over, request.align_s), (Some(Over { from_s: 20.0, to_s: 60.0 }), 40.0));
    let [datasheet, allan, ten, closest, covering] = assumed(&model(), &NOISE, &request).unwrap();
    for (own, expected) in closest.iter().chain(&covering).zip(NOISE.iter().cycle()) {
        assert!((own.n / expected.n - 1.0).abs() < 1e-3 && (own.k / expected.k - 1.0).abs() < 1e-3, "{own:?}");
    }
    assert!((datasheet[0].n - 6.109e-5).abs() < 1e-8 && (datasheet[3].n - 1.373e-3).abs() < 1e-6);
    assert!(allan == NOISE && ten[4] == Density { n: 10.0 * ACCEL.n, k: 10.0 * ACCEL.k });
}
