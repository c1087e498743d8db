//! Real recordings: the detectors have to find the known disturbances. The recordings are read from the folder that
//! `VN100D_REAL_DATA` names.

use super::*;
use std::io::Read as _;

fn text(path: &str) -> Option<String> {
    let file = std::fs::File::open(vn100_testkit::real_data(path)?).unwrap();
    let mut text = String::new();
    flate2::read::GzDecoder::new(file).read_to_string(&mut text).unwrap();
    Some(text)
}

fn column(text: &str, header: usize, index: usize) -> [Part; 1] {
    let number = |line: &str| line.split(['*', ',']).nth(index).unwrap().parse().unwrap();
    [Part { start_s: 0.0, values: text.lines().skip(header).map(number).collect() }]
}

fn fitted(channel: Channel, rate_hz: f64, parts: &[Part]) -> (NoiseParameters, Disturbances) {
    let sums = spectral_sums(parts, FixedPoint::for_channel(channel));
    let all = All::of(channel, rate_hz, &sums, None);
    Record::of(channel, rate_hz, parts.to_vec(), &Levels::new(rate_hz, 0), Company::Alone).alone(channel, rate_hz, &all)
}

fn lines_near(flags: &[Flag], frequency_hz: f64) -> bool {
    let frequency = |flag: &Flag| flag.note.split(' ').next().and_then(|text| text.parse::<f64>().ok());
    flags
        .iter()
        .filter(|flag| flag.kind == "line")
        .filter_map(frequency)
        .any(|found| (found - frequency_hz).abs() < 0.02)
}

#[test]
fn a_desk_recordings_disturbances_are_found_and_its_densities_remain() {
    let Some(text) = text("vn100-desk/live_capture.txt.gz") else { return };
    let mut flags = std::collections::BTreeMap::new();
    for (index, channel, density) in [
        (4, Channel::MagX, None),
        (6, Channel::MagZ, None),
        (7, Channel::AccelX, Some(0.00198)),
        (8, Channel::AccelY, Some(0.00189)),
        (9, Channel::AccelZ, Some(0.00277)),
        (10, Channel::GyroX, None),
        (11, Channel::GyroY, None),
        (12, Channel::GyroZ, Some(1.12e-4)),
    ] {
        let parts = column(&text, 0, index);
        let (found, about) = fitted(channel, 40.0, &parts);
        println!("{channel}: N {:?}, {:.1} s left out", found.n.value, about.excluded_s);
        found.flags.iter().for_each(|flag| println!("   {} {:?} {}", flag.kind, flag.from_s, flag.note));
        if let Some(density) = density {
            let ratio = found.n.value.unwrap() / density;
            assert!((0.95..1.05).contains(&ratio), "{channel}: {ratio}");
        }
        flags.insert(channel, found.flags);
    }
    let gyro = &flags[&Channel::GyroX];
    for time_s in [7.0, 79.0, 102.0, 137.0, 211.0, 366.0, 467.0] {
        let near = |flag: &&Flag| flag.from_s.is_some_and(|from| (from - time_s).abs() < 2.0 && flag.to_s.is_some());
        assert!(
            // A disturbance as short as a sample is a spike.
            gyro.iter().filter(near).any(|flag| matches!(flag.kind.as_str(), "knock" | "handling" | "spike")),
            "{time_s} s in {gyro:?}"
        );
    }
    let handled = |flag: &Flag| flag.kind == "handling" && flag.from_s < Some(742.0) && flag.to_s > Some(744.0);
    assert!(gyro.iter().any(handled), "{gyro:?}");
    assert!(flags[&Channel::AccelY].iter().any(|flag| flag.kind == "creep"));
    assert!(lines_near(gyro, 13.38) && lines_near(gyro, 13.99));
    assert!(lines_near(&flags[&Channel::AccelZ], 13.38));
    for channel in [Channel::MagX, Channel::MagZ] {
        assert!(lines_near(&flags[&channel], 19.98), "{:?}", flags[&channel]);
    }
}

#[test]
fn an_adis_recordings_line_is_found_in_every_accelerometer() {
    for file in ["adis16405/adis_16405_imu1.csv.gz", "adis16405/adis_16405_imu2.csv.gz"] {
        let Some(text) = text(file) else { return };
        for (index, channel) in [(3, Channel::AccelX), (4, Channel::AccelY), (5, Channel::AccelZ)] {
            let mut parts = column(&text, 1, index);
            parts[0].values.iter_mut().for_each(|g| *g *= imu_core::units::STANDARD_GRAVITY_M_S2);
            let found = examine(&parts, 100.0);
            println!(
                "{file} {channel}: {} events, lines {:?}",
                found.events.len(),
                found.lines.iter().map(|l| l.frequency_hz).collect::<Vec<_>>()
            );
            for frequency_hz in [0.566, 1.697] {
                let near = |line: &Line| (line.frequency_hz - frequency_hz).abs() < 0.01;
                assert!(found.lines.iter().any(near), "{file} {channel} {frequency_hz} Hz: {:?}", found.lines);
            }
        }
    }
}
