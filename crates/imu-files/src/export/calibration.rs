//! Calibrations in the forms of those who apply them: register lines of a VN-100, Kalibr, `imu_tk`, `imu_calib`.
//!
//! A correction is x = C·(raw − B), in m/s², rad/s and gauss. A sensor shows C⁻¹·x + B.
//!
//! # Source
//! - VN-100: UM001, registers 23 (magnetometer), 25 (accelerometer), 84 (gyro): X = C·(raw − B), nine entries of C by rows, then B.
//! - Kalibr, `scale-misalignment`: accel = M·a + b, gyro = M·C_gyro_i·ω + A·a + b, with lower triangular M (Rehder and others 2016).
//! - `imu_tk`: x = T·K·(raw − B), T with ones on its diagonal, upper triangular for the accelerometer (Tedaldi and others 2014);
//!   files of nine entries of T, nine of K, three of B, as `CalibratedTriad::save` writes them.
//! - `imu_calib` (ROS): x = SM·raw − bias, YAML.

use imu_pose::Correction;
use nalgebra::{Matrix3, Vector3};
use std::fmt::Write as _;
use vn100_proto::{ChecksumKind, Command};

/// Corrections of a sensor's triads.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Corrections {
    /// Of the magnetometer, gauss.
    pub mag: Option<Correction>,
    /// Of the accelerometer, m/s².
    pub accel: Option<Correction>,
    /// Of the gyroscope, rad/s.
    pub gyro: Option<Correction>,
}

/// The registers of a VN-100 that hold corrections.
const MAGNETOMETER: u16 = 23;
const ACCELEROMETER: u16 = 25;
const GYROSCOPE: u16 = 84;

fn matrix(of: &Correction) -> Matrix3<f64> {
    Matrix3::from_fn(|row, column| of.matrix[row][column])
}

/// Returns Q and U of C = Q·U, with an upper triangular U whose diagonal is positive.
fn upper(of: &Matrix3<f64>) -> (Matrix3<f64>, Matrix3<f64>) {
    let (q, r) = of.qr().unpack();
    let signs = Matrix3::from_diagonal(&r.diagonal().map(f64::signum));
    (q * signs, signs * r)
}

/// Returns a number with six decimals, and no sign before zero.
fn six_decimals(number: f64) -> String {
    let text = format!("{number:.6}");
    if text.trim_start_matches(['-', '0', '.']).is_empty() { text.trim_start_matches('-').to_owned() } else { text }
}

impl Corrections {
    /// Returns `$VNWRG` lines with checksums, one for each triad. They replace what the registers hold.
    ///
    /// # Validation
    /// `tests`: the lines are read back, and correct the sensor's values.
    pub fn registers(&self) -> String {
        let triads = [(MAGNETOMETER, self.mag), (ACCELEROMETER, self.accel), (GYROSCOPE, self.gyro)];
        let lines = triads.into_iter().filter_map(|(register, of)| Some((register, of?))).map(|(register, of)| {
            let numbers = of.matrix.iter().flatten().chain(&of.bias);
            let values: Vec<String> = numbers.map(|number| six_decimals(*number)).collect();
            let bytes = Command::write(register, values.join(",")).to_bytes(ChecksumKind::Xor8);
            String::from_utf8_lossy(&bytes).trim_end().to_owned() + "\n"
        });
        lines.collect()
    }

    /// Returns the part of Kalibr's `imu.yaml` with the intrinsics, in axes in which the accelerometer's M is lower triangular.
    pub fn kalibr(&self) -> String {
        let mut text =
            "# Kalibr, model scale-misalignment: accel = M a + b, gyro = M C_gyro_i w + A a + b.\n".to_owned();
        let inverse = |of: Option<Correction>| of.and_then(|of| Some((matrix(&of).try_inverse()?, of.bias)));
        // A lower triangular M of the sensor: M = L·Q is (Qᵀ·Lᵀ)ᵀ.
        let lower = |of: &Matrix3<f64>| {
            let (q, r) = upper(&of.transpose());
            (r.transpose(), q.transpose())
        };
        let mut axes = Matrix3::identity();
        if let Some((sensor, bias)) = inverse(self.accel) {
            let (own, turned) = lower(&sensor);
            axes = turned;
            let _ = writeln!(text, "# bias b of the accelerometer, m/s^2: {}", row(bias));
            let _ = writeln!(text, "accelerometers:\n  M:\n{}", rows(&own));
        }
        if let Some((sensor, bias)) = inverse(self.gyro) {
            let (own, turned) = lower(&(sensor * axes.transpose()));
            let _ = writeln!(text, "# bias b of the gyroscope, rad/s: {}", row(bias));
            let _ = writeln!(text, "gyroscopes:\n  A:\n{}", rows(&Matrix3::zeros()));
            let _ = writeln!(text, "  C_gyro_i:\n{}\n  M:\n{}", rows(&turned), rows(&own));
        }
        text + "model: scale-misalignment\n"
    }

    /// Returns `imu_tk`'s file of the accelerometer, in axes in which T is upper triangular.
    pub fn imu_tk_accel(&self) -> Option<String> {
        let of = self.accel?;
        let (_, own) = upper(&matrix(&of));
        Some(imu_tk(&own, of.bias))
    }

    /// Returns `imu_tk`'s file of the gyroscope, in the axes of [`Self::imu_tk_accel`].
    pub fn imu_tk_gyro(&self) -> Option<String> {
        let of = self.gyro?;
        let axes = self.accel.map_or_else(Matrix3::identity, |of| upper(&matrix(&of)).0);
        Some(imu_tk(&(axes.transpose() * matrix(&of)), of.bias))
    }

    /// Returns the YAML file of `imu_calib`, which corrects accelerometers.
    pub fn imu_calib(&self) -> Option<String> {
        let of = self.accel?;
        let own = matrix(&of);
        let bias = own * Vector3::from(of.bias);
        let entries: Vec<f64> = of.matrix.iter().flatten().copied().collect();
        let list = |values: &[f64]| values.iter().map(|value| format!("  - {value:.9}\n")).collect::<String>();
        Some(format!("SM:\n{}bias:\n{}", list(&entries), list(bias.as_slice())))
    }
}

/// Returns T·K = `own`, and B.
fn imu_tk(own: &Matrix3<f64>, bias: [f64; 3]) -> String {
    let scale = Matrix3::from_diagonal(&own.diagonal());
    let misalignment = Matrix3::from_fn(|row, column| own[(row, column)] / own[(column, column)]);
    let lines = |of: &Matrix3<f64>| {
        of.row_iter().map(|row| format!("{:.9e} {:.9e} {:.9e}\n", row[0], row[1], row[2])).collect::<String>()
    };
    let bias: String = bias.iter().map(|value| format!("{value:.9e}\n")).collect();
    format!("{}\n{}\n{bias}\n", lines(&misalignment), lines(&scale))
}

fn row(of: [f64; 3]) -> String {
    format!("[{:.9}, {:.9}, {:.9}]", of[0], of[1], of[2])
}

fn rows(of: &Matrix3<f64>) -> String {
    let lines: Vec<String> = of.row_iter().map(|own| format!("  - {}", row([own[0], own[1], own[2]]))).collect();
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor() -> (Matrix3<f64>, Matrix3<f64>, Corrections) {
        let accel = Matrix3::new(1.004, 0.002, -0.003, 0.002, 0.994, 0.001, -0.003, 0.001, 1.008);
        let gyro = Matrix3::new(1.01, 0.004, -0.012, -0.003, 0.993, 0.005, 0.008, 0.002, 1.003);
        let correction = |of: &Matrix3<f64>, bias: [f64; 3]| {
            let inverse = of.try_inverse().unwrap();
            Correction { matrix: [0, 1, 2].map(|row| [0, 1, 2].map(|column| inverse[(row, column)])), bias }
        };
        let corrections = Corrections {
            mag: None,
            accel: Some(correction(&accel, [0.05, -0.12, 0.3])),
            gyro: Some(correction(&gyro, [0.02, -0.01, 0.005])),
        };
        (accel, gyro, corrections)
    }

    fn numbers(text: &str) -> Vec<f64> {
        text.split(|c: char| c.is_whitespace() || ",[]".contains(c)).filter_map(|word| word.parse().ok()).collect()
    }

    fn square(of: &[f64]) -> Matrix3<f64> {
        Matrix3::from_row_slice(&of[..9])
    }

    #[test]
    fn register_lines_have_checksums_and_correct_what_the_sensor_shows() {
        let (accel, _, corrections) = sensor();
        let text = corrections.registers();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2);
        assert!(lines[0].starts_with("$VNWRG,25,") && lines[1].starts_with("$VNWRG,84,"), "{text}");
        for line in &lines {
            let (body, checksum) = line[1..].split_once('*').unwrap();
            let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
            assert_eq!(checksum, format!("{sum:02X}"));
        }
        let values: Vec<f64> = lines[0][10..lines[0].len() - 3].split(',').map(|of| of.parse().unwrap()).collect();
        let felt = Vector3::new(1.0, -4.0, 8.9);
        let raw = accel * felt + Vector3::new(0.05, -0.12, 0.3);
        let corrected = square(&values) * (raw - Vector3::from_row_slice(&values[9..]));
        assert!((corrected - felt).norm() < 2e-5, "{corrected}");
    }

    /// The forms of other programs turn the axes, the same for both triads: lengths, and angles between both, stay.
    fn unchanged(accel: &dyn Fn(Vector3<f64>) -> Vector3<f64>, gyro: &dyn Fn(Vector3<f64>) -> Vector3<f64>) {
        let (own_accel, own_gyro, _) = sensor();
        let felt = [Vector3::new(1.0, -4.0, 8.9), Vector3::new(7.0, 3.0, -2.0), Vector3::new(-3.0, 8.0, 1.0)];
        let rates = [Vector3::new(0.3, -1.0, 2.0), Vector3::new(-2.0, 0.4, 0.1), Vector3::new(0.1, 2.0, 0.7)];
        let forces = felt.map(|felt| accel(own_accel * felt + Vector3::new(0.05, -0.12, 0.3)));
        let turned = rates.map(|rate| gyro(own_gyro * rate + Vector3::new(0.02, -0.01, 0.005)));
        for one in 0..3 {
            for other in 0..3 {
                assert!((forces[one].dot(&forces[other]) - felt[one].dot(&felt[other])).abs() < 1e-6);
                assert!((forces[one].dot(&turned[other]) - felt[one].dot(&rates[other])).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn imu_tks_files_correct_both_triads_in_one_frame() {
        let (_, _, corrections) = sensor();
        let [accel, gyro] = [corrections.imu_tk_accel(), corrections.imu_tk_gyro()].map(|of| numbers(&of.unwrap()));
        let apply = |of: &[f64], raw: Vector3<f64>| {
            square(of) * square(&of[9..]) * (raw - Vector3::from_row_slice(&of[18..21]))
        };
        assert_eq!((accel.len(), accel[3], accel[6], accel[7]), (21, 0.0, 0.0, 0.0));
        unchanged(&|raw| apply(&accel, raw), &|raw| apply(&gyro, raw));
    }

    #[test]
    fn kalibrs_intrinsics_are_those_of_the_sensor() {
        let (_, _, corrections) = sensor();
        let text = corrections.kalibr();
        // Comments hold the biases.
        let own: Vec<f64> = text.lines().filter(|line| !line.starts_with('#')).flat_map(numbers).collect();
        let (accel, rest) = own.split_at(9);
        assert_eq!((accel[1], accel[2], accel[5]), (0.0, 0.0, 0.0), "{text}");
        let (turned, gyro) = (square(&rest[9..]), square(&rest[18..]));
        let inverse = |of: Matrix3<f64>| of.try_inverse().unwrap();
        unchanged(&|raw| inverse(square(accel)) * (raw - Vector3::new(0.05, -0.12, 0.3)), &|raw| {
            inverse(gyro * turned) * (raw - Vector3::new(0.02, -0.01, 0.005))
        });
    }

    #[test]
    fn imu_calibs_file_corrects_the_accelerometer() {
        let (accel, _, corrections) = sensor();
        let text = corrections.imu_calib().unwrap();
        let values: Vec<f64> = text.lines().filter_map(|line| line.strip_prefix("  - ")?.parse().ok()).collect();
        let felt = Vector3::new(1.0, -4.0, 8.9);
        let raw = accel * felt + Vector3::new(0.05, -0.12, 0.3);
        let corrected = square(&values) * raw - Vector3::from_row_slice(&values[9..]);
        assert!((corrected - felt).norm() < 1e-6);
    }
}
