//! The reference values of `tests/golden/allan`, within the tolerance that their sources allow.

use super::edf::equivalent_degrees_of_freedom;
use super::identify::Lag1;
use super::*;
use imu_core::sample::Channel;
use serde_json::Value;

macro_rules! golden {
    ($name:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/golden/allan/", $name))
    };
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap_or_else(|| panic!("{value} is no list")).iter().map(|v| v.as_f64().unwrap()).collect()
}

fn rows(text: &str) -> impl Iterator<Item = Vec<&str>> {
    text.lines().skip(1).filter(|line| !line.is_empty()).map(|line| line.split(',').collect())
}

/// The generator of NIST SP1065, section 12.4.
struct Lcg(u64);

impl Iterator for Lcg {
    type Item = f64;
    fn next(&mut self) -> Option<f64> {
        let value = self.0 as f64 / 2_147_483_647.0;
        self.0 = 16_807 * self.0 % 2_147_483_647;
        Some(value)
    }
}

fn lcg() -> Lcg {
    Lcg(1_234_567_890)
}

fn white_walk_ramp(count: usize) -> Vec<f64> {
    let mut stream = lcg();
    let mut walk = 0.0;
    (0..count)
        .map(|i| {
            let (white, step) = (stream.next().unwrap(), stream.next().unwrap());
            walk += (step - 0.5) * 1e-5;
            (white - 0.5) * 0.02 + walk + 1e-8 * i as f64
        })
        .collect()
}

fn close(found: f64, expected: f64, relative: f64, what: &str) {
    let error = (found / expected - 1.0).abs();
    assert!(error <= relative, "{what}: {found} instead of {expected}, relative error {error:.1e}");
}

fn exact(samples: &[f64], factors: impl IntoIterator<Item = usize>, scale: FixedPoint) -> AllanSums {
    let mut estimator = Overlapping::new(scale, TauGrid::custom(factors).unwrap());
    estimator.push(samples);
    estimator.into_sums()
}

/// Values within ±2, no decimals: the finest scale.
fn unit_range() -> FixedPoint {
    FixedPoint::for_range(0, 1).unwrap()
}

#[test]
fn nbs14_ten_points_have_their_published_deviations() {
    let reference = json(golden!("nbs14_10point.json"));
    let rates = numbers(&reference["freq"]);
    let phases = Phases::integrate(&rates).unwrap();
    for (name, estimator) in [
        ("adev", Estimator::Adev),
        ("oadev", Estimator::Oadev),
        ("mdev", Estimator::Mdev),
        ("hdev", Estimator::Hdev),
        ("ohdev", Estimator::Ohdev),
        ("totdev (SP1065, doubly reflected)", Estimator::Totdev),
    ] {
        for (m, expected) in [1, 2].into_iter().zip(numbers(&reference["dev"][name])) {
            close(phases.deviation(estimator, m).unwrap(), expected, 1e-6, name);
        }
    }
    let sums = exact(&rates, [1, 2], FixedPoint::for_range(0, 10).unwrap());
    for (index, expected) in numbers(&reference["dev"]["oadev"]).into_iter().enumerate() {
        close(sums.variance(index).unwrap().sqrt(), expected, 1e-6, "exact oadev");
    }
}

#[test]
fn sp1065_thousand_points_have_their_published_deviations() {
    let reference = json(golden!("sp1065_1000point.json"));
    let rates: Vec<f64> = lcg().take(1000).collect();
    let phases = Phases::integrate(&rates).unwrap();
    let factors: Vec<usize> = numbers(&reference["m"]).into_iter().map(|m| m as usize).collect();
    for (name, estimator) in [
        ("adev", Estimator::Adev),
        ("oadev", Estimator::Oadev),
        ("mdev", Estimator::Mdev),
        ("hdev", Estimator::Hdev),
        ("ohdev", Estimator::Ohdev),
        ("totdev (SP1065)", Estimator::Totdev),
    ] {
        for (m, expected) in factors.iter().zip(numbers(&reference["dev"][name])) {
            close(phases.deviation(estimator, *m).unwrap(), expected, 1e-6, name);
        }
        if let Some(full) = reference["independent_recompute_full_precision"].get(name) {
            for (m, expected) in factors.iter().zip(numbers(full)) {
                close(phases.deviation(estimator, *m).unwrap(), expected, 1e-12, name);
            }
        }
    }
    let sums = exact(&rates, factors, unit_range());
    let full = numbers(&reference["independent_recompute_full_precision"]["oadev"]);
    for (index, expected) in full.into_iter().enumerate() {
        close(sums.variance(index).unwrap().sqrt(), expected, 1e-12, "exact oadev");
    }
}

#[test]
fn stable32_intervals_of_the_thousand_points_are_met() {
    let rates: Vec<f64> = lcg().take(1000).collect();
    let phases = Phases::integrate(&rates).unwrap();
    let mut checked = 0;
    for row in rows(golden!("stable32_ci_tables.csv")) {
        // Time deviation is m/√3 times the modified one, intervals included.
        let (name, time) = if row[1] == "tdev" { ("mdev", true) } else { (row[1], false) };
        let Some(estimator) = name.parse::<Estimator>().ok().filter(|_| row[0] == "phasedat") else { continue };
        let m: usize = row[2].parse().unwrap();
        let value = |column: usize| row[column].parse::<f64>().unwrap();
        let unit = if time { m as f64 / 3f64.sqrt() } else { 1.0 };
        assert_eq!(row[5], "0", "white rate noise");
        let sum = phases.square_sum(estimator, m);
        assert_eq!(sum.terms.to_string(), row[4], "{row:?}");
        let sigma = sum.deviation().unwrap() * unit;
        close(sigma, value(7), 1e-4, &format!("{row:?}"));
        let edf = equivalent_degrees_of_freedom(estimator, NoiseType::WhiteRate, m, 1001);
        let factors = confidence_factors(edf, CONFIDENCE_68).unwrap();
        if estimator == Estimator::Totdev && m < 8 {
            // Here Stable32 uses SP1065's table beyond its range: its interval holds in 55 % at m = 1 (`coverage`).
            assert!(sigma * factors.low < value(6) && sigma * factors.high > value(8), "{row:?}");
            continue;
        }
        close(sigma * factors.low, value(6), 1e-3, &format!("low {row:?}"));
        close(sigma * factors.high, value(8), 1e-3, &format!("high {row:?}"));
        checked += 1;
    }
    assert!(checked >= 53, "{checked} rows");
}

#[test]
fn equivalent_degrees_of_freedom_are_those_of_the_reference_table() {
    let mut checked = 0;
    for row in rows(golden!("edf_greenhall_720001.csv")) {
        let phases: u64 = row[0].parse().unwrap();
        let m: usize = row[1].parse().unwrap();
        let alpha: i32 = row[2].parse().unwrap();
        let noise = NoiseType::ALL.into_iter().find(|noise| noise.alpha() == alpha).unwrap();
        let value = |column: usize| row[column].parse::<f64>().unwrap();
        for (column, estimator) in [(4, Estimator::Oadev), (5, Estimator::Ohdev), (6, Estimator::Mdev)] {
            // The reference has no formula for white angle noise with fewer blocks than the order.
            if value(column).is_nan() {
                continue;
            }
            let edf = equivalent_degrees_of_freedom(estimator, noise, m, phases);
            close(edf, value(column), 1e-3, &format!("{estimator:?} {row:?}"));
            checked += 1;
        }
        let edf = equivalent_degrees_of_freedom(Estimator::Oadev, noise, m, phases);
        for (confidence, low, high) in [(CONFIDENCE_68, 7, 8), (CONFIDENCE_95, 9, 10)] {
            let factors = confidence_factors(edf, confidence).unwrap();
            close(factors.low, value(low), 1e-3, &format!("low {row:?}"));
            close(factors.high, value(high), 1e-3, &format!("high {row:?}"));
        }
    }
    assert!(checked > 190, "{checked} values");
}

/// Returns the five power laws that the README lists, of 4096 samples each.
fn power_laws() -> [(&'static str, Vec<f64>); 5] {
    const COUNT: usize = 4096;
    let v: Vec<f64> = lcg().take(COUNT + 1).map(|u| u - 0.5).collect();
    let mut h = vec![1.0];
    for k in 1..=COUNT {
        h.push(h[k - 1] * (k as f64 - 0.5) / k as f64);
    }
    let flicker: Vec<f64> = (0..=COUNT).map(|i| (0..=i).map(|j| h[i - j] * v[j]).sum()).collect();
    let steps = |values: &[f64]| values.windows(2).map(|pair| pair[1] - pair[0]).collect::<Vec<f64>>();
    let walk = v.iter().scan(0.0, |sum, v| {
        *sum += v;
        Some(*sum)
    });
    [
        ("white_angle", steps(&v)),
        ("flicker_angle", steps(&flicker)),
        ("white_rate", v[..COUNT].to_vec()),
        ("flicker_rate", flicker[..COUNT].to_vec()),
        ("random_walk_rate", walk.take(COUNT).collect()),
    ]
}

#[test]
fn lag_1_autocorrelations_are_those_of_allantools() {
    let laws = power_laws();
    let mut checked = 0;
    for row in rows(golden!("lag1_noise_id.csv")) {
        let samples = &laws.iter().find(|(name, _)| *name == row[0]).unwrap().1;
        let mut phases = vec![0.0];
        phases.extend(samples.iter().scan(0.0, |sum, value| {
            *sum += value;
            Some(*sum)
        }));
        let picked: Vec<f64> = phases.into_iter().step_by(row[1].parse().unwrap()).collect();
        assert_eq!(picked.len().to_string(), row[2]);
        let found = Lag1::of([picked]).unwrap();
        let value = |column: usize| row[column].parse::<f64>().unwrap();
        assert_eq!(f64::from(found.differences), value(5), "{row:?}");
        close(found.rho, value(6), 1e-6, &format!("rho {row:?}"));
        close(found.alpha, value(4), 1e-6, &format!("alpha {row:?}"));
        checked += 1;
    }
    assert_eq!(checked, 45);
}

#[test]
fn seven_hundred_thousand_samples_have_allantools_deviations() {
    let reference = json(golden!("lcg_long_reference.json"));
    let white: Vec<f64> = lcg().take(720_000).collect();
    let mixed = white_walk_ramp(720_000);
    assert_eq!(white[719_999], 0.583_359_047_576_486_6);
    close(mixed[719_999], 0.006_939_863_758_121_263, 1e-9, "last of the mixed set");
    for (name, samples) in [("lcg_white_720000_fs40", &white), ("lcg_white_rw_ramp_720000_fs40", &mixed)] {
        let phases = Phases::integrate(samples).unwrap();
        let devs = &reference[name]["devs"];
        for estimator in [Estimator::Adev, Estimator::Oadev, Estimator::Mdev, Estimator::Hdev, Estimator::Ohdev] {
            let expected = &devs[estimator.name()];
            let columns = numbers(&expected["m"]).into_iter().zip(numbers(&expected["dev"]));
            for ((m, deviation), terms) in columns.zip(numbers(&expected["n_terms"])) {
                let sum = phases.square_sum(estimator, m as usize);
                let what = format!("{name} {} m = {m}", estimator.name());
                assert_eq!(sum.terms as f64, terms, "{what}");
                close(sum.deviation().unwrap(), deviation, 1e-9, &what);
            }
        }
        let oadev = &devs["oadev"];
        let sums = exact(samples, numbers(&oadev["m"]).into_iter().map(|m| m as usize), unit_range());
        for (index, (deviation, terms)) in
            numbers(&oadev["dev"]).into_iter().zip(numbers(&oadev["n_terms"])).enumerate()
        {
            let what = format!("{name} exact oadev m = {}", sums.grid().factors()[index]);
            assert_eq!(sums.terms()[index] as f64, terms, "{what}");
            close(sums.variance(index).unwrap().sqrt(), deviation, 2e-12, &what);
        }
    }
    // Gravity on the channel does not change the result, also not with the channel's own scale.
    let offset: Vec<f64> = mixed.iter().map(|value| value + 9.80665).collect();
    let expected = &reference["same_plus_offset_9.80665"]["devs"]["oadev"];
    let factors = numbers(&expected["m"]).into_iter().map(|m| m as usize);
    let sums = exact(&offset, factors, FixedPoint::for_channel(Channel::AccelZ));
    for (index, deviation) in numbers(&expected["dev"]).into_iter().enumerate() {
        close(sums.variance(index).unwrap().sqrt(), deviation, 1e-9, "with an offset");
    }
}

#[test]
fn a_hundred_averaging_times_have_allantools_deviations() {
    let white: Vec<f64> = lcg().take(720_000).collect();
    let mixed = white_walk_ramp(720_000);
    let reference: Vec<Vec<&str>> = rows(golden!("lcg_720000_oadev_log100.csv")).collect();
    let factors: Vec<usize> = reference.iter().map(|row| row[0].parse().unwrap()).collect();
    assert!(factors.len() > 100);
    for (column, samples) in [(2, &white), (4, &mixed)] {
        let sums = exact(samples, factors.iter().copied(), FixedPoint::for_channel(Channel::GyroX));
        let curve = AllanCurve::from_sums(&sums, 40.0, "rad/s");
        for (index, row) in reference.iter().enumerate() {
            close(curve.tau_s[index], row[1].parse().unwrap(), 1e-12, "tau");
            assert_eq!(curve.n[index].to_string(), row[3]);
            close(curve.deviation[index], row[column].parse().unwrap(), 1e-9, &format!("{row:?}"));
        }
    }
}

/// Compares with a big reference. `full_overlap` is the binary logarithm of the largest factor with full overlap; the
/// reference has full overlap throughout.
fn big_reference(name: &str, count: usize, full_overlap: u8) {
    let reference = json(golden!("lcg_big_reference.json"));
    let expected = &reference[name]["devs"]["oadev"];
    let factors = numbers(&expected["m"]).into_iter().map(|m| m as usize);
    let grid = TauGrid::with_full_overlap(factors, full_overlap).unwrap();
    assert!(!grid.beyond_full_overlap().is_empty());
    let mut estimator = Overlapping::new(unit_range(), grid);
    let mut stream = lcg();
    for _ in 0..count / 100_000 {
        let chunk: Vec<f64> = stream.by_ref().take(100_000).collect();
        estimator.push(&chunk);
    }
    let points = estimator.into_sums().points();
    assert_eq!(points.len(), numbers(&expected["m"]).len());
    let columns = numbers(&expected["dev"]).into_iter().zip(numbers(&expected["n_terms"]));
    for (point, (deviation, terms)) in points.iter().zip(columns) {
        let what = format!("{name} m = {}", point.m);
        if point.stride == 1 {
            assert_eq!(point.terms as f64, terms);
            close(point.variance.sqrt(), deviation, 1e-9, &what);
        } else {
            assert_eq!(point.terms as f64, (terms - 1.0) - (terms - 1.0) % point.stride as f64 + 1.0, "{what}");
            close(point.variance.sqrt(), deviation, 0.02, &what);
        }
    }
}

#[test]
fn millions_of_samples_in_chunks_have_allantools_deviations() {
    big_reference("lcg_white_3600000_fs200", 3_600_000, 17);
}

/// Run with `cargo test --release --lib fourteen_million -- --ignored`.
#[test]
#[ignore = "takes some seconds without optimisation"]
fn fourteen_million_samples_in_chunks_have_allantools_deviations() {
    big_reference("lcg_white_14400000_fs800", 14_400_000, 20);
}

/// A desk recording whose author published the overlapping deviations of its gyroscope, with tau in samples.
#[test]
fn a_desk_recording_has_its_authors_deviations() {
    use std::io::Read;
    let Some(folder) = vn100_testkit::real_data("vn100-desk") else { return };
    let read = |name: &str| {
        let file = std::fs::File::open(folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let mut text = String::new();
        flate2::read::GzDecoder::new(file).read_to_string(&mut text).unwrap();
        text
    };
    let lines = read("live_capture.txt.gz");
    let records: Vec<Vec<&str>> =
        lines.lines().map(|line| line.split('*').next().unwrap_or("").split(',').collect()).collect();
    assert_eq!(records.len(), 30_178);
    for (axis, (channel, name)) in
        [(Channel::GyroX, "x"), (Channel::GyroY, "y"), (Channel::GyroZ, "z")].into_iter().enumerate()
    {
        let rates: Vec<f64> = records[187..=30_176].iter().map(|fields| fields[10 + axis].parse().unwrap()).collect();
        let published = read(&format!("oadev_gyro_{name}.csv.gz"));
        let published: Vec<(usize, f64)> =
            rows(&published).map(|row| (row[0].parse::<f64>().unwrap() as usize, row[1].parse().unwrap())).collect();
        assert_eq!(published.len(), 14_994);
        let sums = exact(&rates, published.iter().map(|(m, _)| *m), FixedPoint::for_channel(channel));
        for (index, (m, deviation)) in published.iter().enumerate() {
            assert_eq!(sums.grid().factors()[index], *m);
            close(sums.variance(index).unwrap().sqrt(), *deviation, 1e-9, &format!("gyro {name} m = {m}"));
        }
    }
}
