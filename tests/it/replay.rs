//! A real recording through the terminal into the database.

use crate::world::World;
use imu_core::sample::Channel;
use imu_noise::allan::{FixedPoint, Overlapping, TauGrid};
use std::io::Read;
use std::time::Duration;
use vn100_testkit::real_data;

fn unzip(path: &std::path::Path) -> String {
    let mut text = String::new();
    flate2::read::GzDecoder::new(std::fs::File::open(path).unwrap()).read_to_string(&mut text).unwrap();
    text
}

#[test]
fn a_desk_recording_arrives_whole_with_its_decimals_and_its_published_deviations() {
    let Some(recording) = real_data("vn100-desk/live_capture.txt.gz") else { return };
    let world = World::new();
    let _sensor = world.emulate(&["--replay", recording.to_str().unwrap(), "--speed", "50"]);
    let daemon = world.daemon("[sensor]\noutput = \"keep\"\n", &["--speed", "50", "--capture", "754450ms"]);
    let ended = || world.try_get("/v1/captures/latest").filter(|capture| capture["state"] == "complete");
    let capture = world.until("the recording is over", Duration::from_secs(90), ended, &daemon);
    assert_eq!((capture["samples"].as_u64(), capture["missing"].as_u64()), (Some(30_178), Some(0)));

    let columns = "yaw, pitch, roll, mag_x, mag_y, mag_z, accel_x, accel_y, accel_z, gyro_x, gyro_y, gyro_z";
    let rows = world.query(&format!("SELECT {columns} FROM sample WHERE capture_id = 1 ORDER BY seq"));
    let text = unzip(&recording);
    assert_eq!(rows.len(), text.lines().count());
    let mut gyro = [const { Vec::new() }; 3];
    for (row, line) in rows.iter().zip(text.lines()) {
        let fields: Vec<f64> =
            line.split('*').next().unwrap().split(',').skip(1).map(|field| field.parse().unwrap()).collect();
        let values: Vec<f64> = row
            .iter()
            .map(|value| match value {
                rusqlite::types::Value::Real(value) => *value,
                other => panic!("{other:?}"),
            })
            .collect();
        assert_eq!(values, fields, "{line}");
        for axis in 0..3 {
            gyro[axis].push(values[9 + axis]);
        }
    }

    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let published = unzip(&real_data(&format!("vn100-desk/oadev_gyro_{name}.csv.gz")).unwrap());
        let pairs: Vec<(usize, f64)> = published
            .lines()
            .skip(1)
            .map(|line| line.split_once(',').unwrap())
            .map(|(tau, deviation)| (tau.parse::<f64>().unwrap() as usize, deviation.parse().unwrap()))
            .collect();
        let grid = TauGrid::custom(pairs.iter().map(|(m, _)| *m)).unwrap();
        let mut estimator = Overlapping::new(FixedPoint::for_channel(Channel::GyroX), grid);
        estimator.push(&gyro[axis][187..=30_176]);
        let points = estimator.sums().points();
        assert_eq!(points.len(), pairs.len());
        for (point, (m, deviation)) in points.iter().zip(&pairs) {
            assert_eq!(point.m, *m);
            let found = point.variance.sqrt();
            assert!((found / deviation - 1.0).abs() < 1e-9, "gyro {name} m {m}: {found} instead of {deviation}");
        }
    }
}
