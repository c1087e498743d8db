//! Tests on simulated motions, whose numbers are known, and on real recordings with a reference.

use crate::{
    Calibration, Estimate, External, PoseError, Poses, Stated, StatedSensor, Track, TriadFit, Unit, against_poses,
    against_rates, read,
};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use std::io::Read as _;
use std::path::Path;

const G: f64 = 9.806_65;

/// A sensor on a body that is turned and moved along sums of sines.
struct World {
    gyro: Matrix3<f64>,
    gyro_bias: Vector3<f64>,
    accel: Matrix3<f64>,
    accel_bias: Vector3<f64>,
    arm: Vector3<f64>,
    /// How much later gyroscope and accelerometer are than the reference.
    later_s: [f64; 2],
    gyro_sd: f64,
    accel_sd: f64,
    attitude_sd: f64,
    position_sd: f64,
    seconds: f64,
    /// The size of turns, rad.
    turn: f64,
    rate_hz: f64,
}

impl Default for World {
    fn default() -> Self {
        Self {
            gyro: Matrix3::identity(),
            gyro_bias: Vector3::zeros(),
            accel: Matrix3::identity(),
            accel_bias: Vector3::zeros(),
            arm: Vector3::zeros(),
            later_s: [0.0; 2],
            gyro_sd: 2e-3,
            accel_sd: 0.02,
            attitude_sd: 1e-4,
            position_sd: 2e-5,
            seconds: 60.0,
            turn: 1.2,
            rate_hz: 100.0,
        }
    }
}

impl World {
    fn attitude(&self, t: f64) -> UnitQuaternion<f64> {
        let turn = |axis: usize, size: f64, hz: f64| {
            UnitQuaternion::from_scaled_axis(Vector3::ith(
                axis,
                size * self.turn * (std::f64::consts::TAU * hz * t).sin(),
            ))
        };
        turn(2, 1.0, 0.11) * turn(1, 0.9, 0.17) * turn(0, 1.1, 0.23) * turn(2, 0.2, 0.71) * turn(0, 0.2, 0.93)
    }

    fn position(&self, t: f64) -> Vector3<f64> {
        Vector3::new(0.3 * (1.9 * t).sin(), 0.25 * (2.6 * t).sin(), 0.2 * (3.3 * t).cos())
    }

    fn made(&self, seed: u64) -> (Track, Poses) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut noise = |sd: f64| {
            Vector3::from_fn(|_, _| {
                sd * {
                    let of: f64 = StandardNormal.sample(&mut random);
                    of
                }
            })
        };
        let rate = |t: f64| (self.attitude(t - 1e-5).inverse() * self.attitude(t + 1e-5)).scaled_axis() / 2e-5;
        let force = |t: f64| {
            let h = 1e-3;
            let moved = (self.position(t + h) - 2.0 * self.position(t) + self.position(t - h)) / (h * h);
            self.attitude(t).inverse() * (moved + Vector3::z() * G)
        };
        let mut track = Track::default();
        for place in 0..(self.seconds * self.rate_hz) as usize {
            let t = place as f64 / self.rate_hz;
            track.time_s.push(t);
            track.gyro.push(self.gyro * rate(t - self.later_s[0]) + self.gyro_bias + noise(self.gyro_sd));
            track.accel.push(self.accel * force(t - self.later_s[1]) + self.accel_bias + noise(self.accel_sd));
        }
        let mut poses = Poses::default();
        for place in 0..(self.seconds * 120.0) as usize {
            let t = place as f64 / 120.0;
            let attitude = self.attitude(t);
            poses.time_s.push(t);
            poses.position_m.push(self.position(t) + attitude * self.arm + noise(self.position_sd));
            poses.attitude.push(attitude * UnitQuaternion::from_scaled_axis(noise(self.attitude_sd)));
        }
        (track, poses)
    }
}

/// Counts intervals that hold a number, of those that there are.
fn count(counts: &mut [usize; 2], of: Option<Estimate>, truth: f64) {
    if let Some(of) = of {
        counts[0] += usize::from(of.ci95[0] <= truth && truth <= of.ci95[1]);
        counts[1] += 1;
    }
}

fn counted(of: &TriadFit, matrix: &Matrix3<f64>, bias: &Vector3<f64>, later_s: f64, counts: &mut [usize; 2]) {
    for axis in 0..3 {
        count(counts, of.scale[axis], matrix[(axis, axis)] - 1.0);
        count(counts, of.bias[axis], bias[axis]);
    }
    for (at, (row, column)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
        count(counts, of.cross[at], matrix[(row, column)]);
    }
    count(counts, Some(of.later_s), later_s);
}

#[test]
fn intervals_hold_the_numbers_of_simulated_sensors_with_noisy_poses() {
    let symmetric = |scale: [f64; 3], [xy, xz, yz]: [f64; 3]| {
        Matrix3::new(1.0 + scale[0], xy, xz, xy, 1.0 + scale[1], yz, xz, yz, 1.0 + scale[2])
    };
    let mut counts = [0; 2];
    for (seed, noisy) in (0..10).map(|seed| (seed, 1.0)).chain((10..20).map(|seed| (seed, 20.0))) {
        let world = World {
            gyro: symmetric([0.004, -0.007, 0.002], [0.001, -0.002, 0.0005]),
            gyro_bias: Vector3::new(4e-3, -2e-3, 1e-3),
            accel: symmetric([0.003, 0.0, -0.004], [0.001, 0.0, -0.001]),
            accel_bias: Vector3::new(0.05, -0.03, 0.08),
            arm: Vector3::new(0.01, -0.02, 0.005),
            later_s: [4.1e-3, 2.7e-3],
            attitude_sd: 1e-4 * noisy,
            position_sd: 2e-5 * noisy,
            ..World::default()
        };
        let (track, poses) = world.made(seed);
        let found = against_poses(&track, &poses, &StatedSensor::default()).unwrap();
        assert!(found.gyro.frames.is_plain() && !found.inverse_quaternions && !found.world_down, "{found:?}");
        counted(&found.gyro, &world.gyro, &world.gyro_bias, world.later_s[0], &mut counts);
        let accel = found.accel.unwrap();
        counted(&accel, &world.accel, &world.accel_bias, world.later_s[1], &mut counts);
        for axis in 0..3 {
            count(&mut counts, found.arm_m.map(|arm| arm[axis]), world.arm[axis]);
        }
        let closed = |of: &TriadFit| {
            of.gap.iter().map(|of| of.explained).sum::<f64>() / of.gap.iter().map(|of| of.nats).sum::<f64>()
        };
        assert!(closed(&found.gyro) > 0.9 && closed(&accel) > 0.8, "{} {}", closed(&found.gyro), closed(&accel));
    }
    println!("{counts:?}");
    // Of 460 numbers; those of one record go together.
    assert!(counts[1] > 440 && counts[0] as f64 > 0.91 * counts[1] as f64, "{counts:?}");
}

#[test]
fn all_exchanges_of_axes_with_signs_units_and_clocks_are_named() {
    let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let units = [(1.0, Unit::Same, 1.0, Unit::Same), (57.295_78, Unit::Degrees, 1.0 / G, Unit::Gravities)];
    let mut number = 0;
    for order in orders {
        for signs in 0..8 {
            let exchange = Matrix3::from_fn(|row, column| {
                let sign = if signs & (1 << row) == 0 { 1.0 } else { -1.0 };
                if order[row] == column { sign } else { 0.0 }
            });
            let (of_gyro, gyro_unit, of_accel, accel_unit) = units[number % 2];
            let offset_s = [0.0, 10.0, -7.3, 0.4][number % 4];
            number += 1;
            // A reflected frame turns the other way round.
            let world =
                World { gyro: exchange * of_gyro, accel: exchange * of_accel, seconds: 40.0, ..World::default() };
            let (mut track, poses) =
                World { gyro_sd: 2e-3 * of_gyro, accel_sd: 0.02 * of_accel, ..world }.made(number as u64);
            track.time_s.iter_mut().for_each(|time_s| *time_s += offset_s);
            let found = against_poses(&track, &poses, &StatedSensor::default()).unwrap();
            for (of, unit) in [(&found.gyro, gyro_unit), (found.accel.as_ref().unwrap(), accel_unit)] {
                for row in 0..3 {
                    assert_eq!(of.frames.axes[row].axis, order[row], "{order:?} {signs} {:?}", of.frames);
                    assert_eq!(
                        of.frames.axes[row].negative,
                        signs & (1 << row) != 0,
                        "{order:?} {signs} {:?}",
                        of.frames
                    );
                }
                assert_eq!((of.frames.unit, of.frames.aligned), (unit, true));
                assert_eq!(of.frames.mirrored, exchange.determinant() < 0.0);
                assert!((of.later_s.value - offset_s).abs() < 2e-3, "{} {offset_s}", of.later_s.value);
            }
        }
    }
    assert_eq!(number, 48);
}

#[test]
fn inverse_quaternions_a_world_that_points_down_and_any_rotation_are_found() {
    let world = World { seconds: 40.0, ..World::default() };
    let (track, poses) = world.made(1);
    let inverse = Poses { attitude: poses.attitude.iter().map(UnitQuaternion::inverse).collect(), ..poses.clone() };
    let found = against_poses(&track, &inverse, &StatedSensor::default()).unwrap();
    assert!(found.inverse_quaternions && found.gyro.frames.is_plain());
    let over = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let down = Poses {
        attitude: poses.attitude.iter().map(|attitude| over * attitude).collect(),
        position_m: poses.position_m.iter().map(|position| over * position).collect(),
        ..poses.clone()
    };
    let found = against_poses(&track, &down, &StatedSensor::default()).unwrap();
    assert!(found.world_down && found.accel.unwrap().frames.is_plain());
    let turn = Rotation3::from_scaled_axis(Vector3::new(0.7, -0.6, 0.5)).into_inner();
    let (track, poses) = World { gyro: turn, accel: turn, seconds: 40.0, ..World::default() }.made(2);
    let found = against_poses(&track, &poses, &StatedSensor::default()).unwrap();
    assert!(
        !found.gyro.frames.aligned && found.gyro.scale.iter().flatten().all(|of| of.value.abs() < 5e-3),
        "{found:?}"
    );
}

#[test]
fn what_a_motion_does_not_determine_has_no_number() {
    // Turned about z alone.
    let rate = |t: f64| 1.5 * (0.9 * t).sin();
    let (mut track, mut poses, mut angle) = (Track::default(), Poses::default(), 0.0);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut normal = |sd: f64| {
        sd * {
            let of: f64 = StandardNormal.sample(&mut random);
            of
        }
    };
    for place in 0..6000 {
        let t = f64::from(place) * 0.01;
        track.time_s.push(t);
        track.gyro.push(Vector3::new(normal(2e-3), normal(2e-3), 1.01 * rate(t) + normal(2e-3)));
        poses.time_s.push(t);
        let noise = Vector3::new(normal(1e-4), normal(1e-4), normal(1e-4));
        poses
            .attitude
            .push(UnitQuaternion::from_scaled_axis(Vector3::z() * angle) * UnitQuaternion::from_scaled_axis(noise));
        angle += 0.01 * rate(t + 0.005);
    }
    let found = against_poses(&track, &poses, &StatedSensor::default()).unwrap();
    assert_eq!((found.gyro.scale[0], found.gyro.scale[1], found.gyro.cross[0]), (None, None, None));
    let z = found.gyro.scale[2].unwrap();
    assert!(z.ci95[0] < 0.01 && 0.01 < z.ci95[1] && z.half() < 0.015, "{z:?}");
    // At rest there is nothing to match.
    poses.attitude.iter_mut().for_each(|attitude| *attitude = UnitQuaternion::identity());
    assert!(matches!(against_poses(&track, &poses, &StatedSensor::default()), Err(PoseError::Still { .. })));
    // Another trial.
    let (_, other) = World::default().made(9);
    assert!(matches!(
        against_poses(&track, &other, &StatedSensor::default()),
        Err(PoseError::Unlike { .. } | PoseError::Bad { .. })
    ));
}

/// Faults outside the range of the first trial, each with a wrong number before it was mended.
#[test]
fn clocks_that_drift_rough_poses_and_slow_sensors_keep_their_intervals() {
    let worlds: [(&str, f64, World); 4] = [
        ("clocks 50 ppm apart", 5e-5, World { seconds: 150.0, ..World::default() }),
        ("attitudes of 1 degree", 0.0, World { attitude_sd: 0.0175, ..World::default() }),
        ("attitudes of 0.3 degrees", 0.0, World { attitude_sd: 0.005, ..World::default() }),
        ("40 Hz", 0.0, World { rate_hz: 40.0, turn: 2.0, ..World::default() }),
    ];
    for (what, drift, mut world) in worlds {
        world.later_s = [4.1e-3, 2.7e-3];
        let mut counts = [0; 2];
        for seed in 0..8 {
            let (mut track, poses) = world.made(100 + seed);
            let middle_s = 0.5 * world.seconds;
            track.time_s.iter_mut().for_each(|time_s| *time_s += drift * (*time_s - middle_s));
            let found = against_poses(&track, &poses, &StatedSensor::default()).unwrap();
            counted(&found.gyro, &world.gyro, &world.gyro_bias, world.later_s[0], &mut counts);
            counted(&found.accel.unwrap(), &world.accel, &world.accel_bias, world.later_s[1], &mut counts);
        }
        println!("{what}: {counts:?}");
        assert!(counts[1] > 100 && counts[0] as f64 > 0.9 * counts[1] as f64, "{what}: {counts:?}");
    }
}

#[test]
fn what_is_broken_is_refused_and_a_single_bad_pose_changes_nothing() {
    let world = World { seconds: 40.0, later_s: [4e-3, 2e-3], ..World::default() };
    let (track, poses) = world.made(4);
    let mut flipped = poses.clone();
    flipped.attitude[1000] *= UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 3.1);
    let found = against_poses(&track, &flipped, &StatedSensor::default()).unwrap();
    assert!((found.gyro.later_s.value - 4e-3).abs() < 1e-3 && found.gyro.frames.is_plain(), "{found:?}");
    assert!(found.gyro.scale.iter().flatten().all(|of| of.value.abs() < 0.01), "{found:?}");
    for (factor, last) in [(1e3, None), (1e6, None), (1.0, Some(1e18)), (1.0, Some(1e6))] {
        let mut far = poses.clone();
        far.time_s.iter_mut().for_each(|time_s| *time_s *= factor);
        if let Some(last) = last {
            *far.time_s.last_mut().unwrap() = last;
        }
        assert!(
            matches!(against_poses(&track, &far, &StatedSensor::default()), Err(PoseError::Long { .. })),
            "{factor} {last:?}"
        );
    }
    let mut dead = track.clone();
    dead.gyro.iter_mut().for_each(|rate| rate.x = 0.0);
    assert_eq!(
        against_poses(&dead, &poses, &StatedSensor::default()),
        Err(PoseError::Dead { channel: "gyro_x".to_owned() })
    );
    let mut dead = track.clone();
    dead.accel.iter_mut().for_each(|force| force.y = 1.0);
    let found = against_poses(&dead, &poses, &StatedSensor::default()).unwrap();
    assert!(found.accel.is_none() && found.without_accel.is_some());
    let mut half = track;
    half.gyro.iter_mut().for_each(|rate| *rate *= 0.4);
    assert!(matches!(against_poses(&half, &poses, &StatedSensor::default()), Err(PoseError::Ratio { .. })));
    // A motion that repeats itself has several offsets.
    let rate = |t: f64| 2.0 * (2.0 * t).sin();
    let (mut track, mut poses) = (Track::default(), Poses::default());
    for place in 0..6000 {
        let t = f64::from(place) * 0.01;
        let noise = 1e-3 * f64::from(place * 7919 % 13 - 6);
        track.time_s.push(t);
        track.gyro.push(Vector3::new(noise, -noise, rate(t)));
        poses.time_s.push(t + 3.0);
        poses.attitude.push(UnitQuaternion::from_scaled_axis(Vector3::z() * (1.0 - (2.0 * t).cos())));
    }
    let found = against_poses(&track, &poses, &StatedSensor::default()).unwrap();
    assert!(found.is_ambiguous && !found.gyro.is_timed);
}

#[test]
fn forms_of_references_are_recognised_and_faults_are_named_with_their_line() {
    let poses = |text: &str| match read(text, None) {
        Ok(Some(External::Poses(poses))) => poses,
        other => panic!("{other:?}"),
    };
    let ours = poses("time_s,q_w,q_x,q_y,q_z,p_x_m,p_y_m,p_z_m\n1.5,1,0,0,0,1,2,3\n1.6,0.7071,0.7071,0,0,1,2,3.5\n");
    assert_eq!((ours.time_s[1], ours.position_m[1].z), (1.6, 3.5));
    let euroc = poses(
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n\
         1500000000,1,2,3,1,0,0,0\n1600000000,1,2,3.5,0.7071,0.7071,0,0\n",
    );
    assert!((euroc.attitude[1].angle_to(&ours.attitude[1])) < 1e-9 && euroc.position_m == ours.position_m);
    let tum = poses("# timestamp tx ty tz qx qy qz qw\n1.5 1 2 3 0 0 0 1\n1.6 1 2 3.5 0.7071 0 0 0.7071\n");
    assert_eq!(tum, ours);
    let motive = poses(
        "Format Version,1.23,Take Name,a,Length Units,Millimeters\n\n,Type,Rigid Body,Rigid Body\n,Name,a,a\n,ID,1,1\n\
         ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position\nFrame,Time (Seconds),X,Y,Z,W,X,Y,Z\n\
         0,0.0,0,0,0,1,1000,3000,-2000\n1,0.01,0,0,0,1,1000,3000,-2000\n2,0.02,,,,,,,\n",
    );
    assert!(
        (motive.position_m[0] - Vector3::new(1.0, 2.0, 3.0)).norm() < 1e-9 && motive.time_s.len() == 2,
        "{motive:?}"
    );
    let Ok(Some(External::Rates(rates))) = read("time_s,encoder_rpm\n0,60\n0.1,30\n", Some(2)) else { panic!() };
    assert!((rates.rate_rad_s[0] - std::f64::consts::TAU).abs() < 1e-12 && rates.axis == 2);
    let Ok(Some(External::Rates(rates))) = read("time_s,ref_gyro_y_rad_s\n0,1\n0.1,2\n", None) else { panic!() };
    assert_eq!((rates.axis, rates.rate_rad_s[1]), (1, 2.0));
    let motion = "time_s,ref_gyro_x_rad_s,ref_gyro_y_rad_s,ref_gyro_z_rad_s,ref_accel_x_m_s2\n0,0,0,0,0\n";
    assert_eq!(read(motion, None), Ok(None));
    for (text, says) in [
        ("", "has the columns ``"),
        ("a,b\n1,2\n", "has the columns `a,b`"),
        ("time_s,encoder_rpm\n0,1\n", "--reference-axis x, y or z"),
        ("time_s,q_w,q_x,q_y,q_z\n0,1,0,0,0\n0,1,0,0,0\n", "line 3 of the reference is at 0 s"),
        ("time_s,q_w,q_x,q_y,q_z\n0,1,0,0,oops\n", "line 2 of the reference: found `oops`"),
        ("time_s,q_w,q_x,q_y,q_z\n0,NaN,0,0,0\n", "line 2 of the reference: found `NaN`"),
        ("time_s,q_w,q_x,q_y,q_z\n0,2,0,0,0\n", "has the norm 2.000"),
    ] {
        let error = read(text, None).unwrap_err().to_string();
        assert!(error.contains(says), "{text:?}: {error}");
    }
}

fn text(path: &Path) -> String {
    let mut text = String::new();
    flate2::read::MultiGzDecoder::new(std::fs::File::open(path).unwrap()).read_to_string(&mut text).unwrap();
    text
}

fn track(text: &str) -> Track {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let places = |names_of: [&str; 3]| names_of.map(|name| names.iter().position(|own| *own == name));
    let gyro = places(["gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s"]);
    let accel = places(["accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2"]);
    let mut found = Track::default();
    for line in lines {
        let row: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        let of = |places: [Option<usize>; 3]| Vector3::from_fn(|axis, _| places[axis].map_or(0.0, |at| row[at]));
        found.time_s.push(row[0]);
        found.gyro.push(of(gyro));
        if accel[0].is_some() {
            found.accel.push(of(accel));
        }
    }
    found
}

fn compared(recording: &str, reference: &str) -> Option<Result<Calibration, PoseError>> {
    let recording = vn100_testkit::real_data(recording)?;
    let name = recording.to_str().unwrap().replace(".csv.gz", reference);
    let track = track(&text(&recording));
    let external = read(&text(Path::new(&name)), Some(2)).unwrap().unwrap();
    Some(match external {
        External::Poses(poses) => against_poses(&track, &poses, &StatedSensor::default()),
        External::Rates(rates) => against_rates(&track, &rates, &Stated::default()),
    })
}

/// What stands in the recordings' README: numpy's numbers, with the scatter from trial to trial as tolerance.
#[test]
fn broad_with_its_optical_reference_has_the_published_delays_and_biases() {
    for (recording, bias) in [
        ("broad/02_undisturbed_slow_rotation_B.csv.gz", [4.0e-3, 2.3e-3, -4.2e-3]),
        ("broad/21_undisturbed_fast_combined.csv.gz", [3.4e-3, 2.4e-3, -4.4e-3]),
    ] {
        let Some(found) = compared(recording, ".optical.csv.gz") else { return };
        let found = found.unwrap();
        let accel = found.accel.as_ref().unwrap();
        assert!(found.gyro.frames.is_plain() && accel.frames.is_plain());
        assert!((found.gyro.later_s.value - 4.14e-3).abs() < 0.3e-3, "{:?}", found.gyro.later_s);
        assert!((accel.later_s.value - 2.67e-3).abs() < 0.5e-3, "{:?}", accel.later_s);
        for ((of, scale), bias) in found.gyro.bias.iter().zip(found.gyro.scale).zip(bias) {
            assert!((of.unwrap().value - bias).abs() < 0.7e-3, "{recording}: {of:?}");
            assert!(scale.unwrap().value.abs() < 4e-3, "{recording}: {scale:?}");
        }
        let closed = |of: &TriadFit| {
            of.gap.iter().map(|of| of.explained).sum::<f64>() / of.gap.iter().map(|of| of.nats).sum::<f64>()
        };
        assert!(closed(&found.gyro) > 0.9 && closed(accel) > 0.9);
    }
}

#[test]
fn a_stick_with_vicon_and_a_motor_with_its_encoder_have_the_published_numbers() {
    let Some(stick) = compared("repoimu/TStick_Test04_Trial1.csv.gz", ".vicon.csv.gz") else { return };
    let stick = stick.unwrap().gyro;
    assert!((stick.later_s.value - 4.9e-3).abs() < 1e-3, "{:?}", stick.later_s);
    assert!((stick.turned_deg[0].unwrap().value + 2.7).abs() < 0.15, "{:?}", stick.turned_deg);
    let Some(motor) = compared("asen3801/ango_GYRO_AUTO_F0pt2_C0pt5.csv.gz", ".encoder.csv.gz") else { return };
    let motor = motor.unwrap().gyro;
    let scale = motor.scale[2].unwrap().value;
    assert!(motor.frames.axes[2].negative && (0.12..0.13).contains(&-scale), "{scale}");
    assert!((-0.014..-0.012).contains(&motor.later_s.value), "{:?}", motor.later_s);
    // In a tenth of the time, the cameras saw another motion than the sensor.
    let bad = compared("repoimu/TStick_Test10_Trial1.csv.gz", ".vicon.csv.gz").unwrap();
    assert!(matches!(&bad, Err(PoseError::Bad { .. })), "{bad:?}");
}

#[test]
fn vicons_export_with_quaternions_is_read_and_one_with_angles_is_refused() {
    let text = "Objects\n200\n,,Wand:Wand,,,,,,\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm\n\
                1,0,0,0,0.6,0.8,100,-200,300\n2,0,,,,,,,\n3,0,0,0,0,1,101,-200,300\n\nTrajectories\n200\n";
    let Ok(Some(External::Poses(poses))) = read(text, None) else { panic!("{:?}", read(text, None)) };
    assert_eq!(poses.time_s, [0.005, 0.015]);
    assert!((poses.position_m[0] - Vector3::new(0.1, -0.2, 0.3)).norm() < 1e-12);
    assert!((poses.attitude[0].scaled_axis() - Vector3::new(0.0, 0.0, 2.0 * 0.6_f64.asin())).norm() < 1e-12);
    let angles =
        "Segments\n100\n,,Body:Body,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,deg,deg,deg,mm,mm,mm\n1,0,1,2,3,4,5,6\n";
    assert_eq!(read(angles, None), Err(PoseError::Angles { line: 4 }));
}

/// Each of the 48 exchanges of axes with signs, in one of two pairs of units and with one of seven offsets of the clocks, of a minute of each
/// of three recordings: named right. `cargo test -p imu-pose -- --ignored --nocapture exchanges_on_real` takes some minutes.
#[test]
#[ignore = "takes some minutes"]
fn exchanges_on_real_recordings_are_named() {
    const OFFSETS_S: [f64; 7] = [0.0, 10.0, -10.0, 3.7, -6.2, 0.8, -1.3];
    let mut right = 0;
    let mut all = 0;
    for name in ["02_undisturbed_slow_rotation_B", "06_undisturbed_fast_rotation_A", "21_undisturbed_fast_combined"] {
        let Some(recording) = vn100_testkit::real_data(&format!("broad/{name}.csv.gz")) else { return };
        let poses = recording.with_file_name(format!("{name}.optical.csv.gz"));
        let whole = track(&text(&recording));
        let External::Poses(poses) = read(&text(&poses), None).unwrap().unwrap() else { unreachable!() };
        let within = |time_s: f64| (60.0..120.0).contains(&time_s);
        for (number, exchange) in crate::frames::exchanges().enumerate() {
            let offset_s = OFFSETS_S[number % OFFSETS_S.len()];
            let [rate, force] = if number % 2 == 0 { [1.0, 1.0] } else { [180.0 / std::f64::consts::PI, 1.0 / G] };
            let mut part = Track::default();
            for place in (0..whole.time_s.len()).filter(|place| within(whole.time_s[*place])) {
                part.time_s.push(whole.time_s[place] + offset_s);
                part.gyro.push(exchange * whole.gyro[place] * rate);
                part.accel.push(exchange * whole.accel[place] * force);
            }
            let found = against_poses(&part, &poses, &StatedSensor::default());
            all += 1;
            let is_right = found.as_ref().is_ok_and(|found| {
                let matches = |of: &crate::Frames, units: [Unit; 2]| {
                    let unit = units[number % 2];
                    (of.matrix() - exchange).norm() < 1e-9 && of.unit == unit
                };
                let accel = found.accel_frames.as_ref().is_some_and(|of| matches(of, [Unit::Same, Unit::Gravities]));
                let later_s = found.gyro.later_s.value - offset_s;
                matches(&found.gyro.frames, [Unit::Same, Unit::Degrees]) && accel && (0.0..0.02).contains(&later_s)
            });
            right += usize::from(is_right);
            if !is_right {
                println!("{name} {number}: {found:?}");
            }
        }
    }
    println!("{right} of {all}");
    assert_eq!(right, all);
}
