//! Parameters of filters that take one white noise and one random walk of the bias for a triad of axes.
//!
//! All of them are written in the same way. The number is that of the largest axis, and a comment has each axis. A walk
//! or white noise that the record does not identify is written as its 95 % upper limit, with `<` in the comment: a
//! filter whose bias cannot walk does not follow one that does. The formats differ in their conventions, which each
//! [`Layout`] states with its source.

use super::form::{Entry, Form, Noise};
use super::{ImuNoise, Known, largest};
use imu_core::sample::Triad;
use std::fmt::Write as _;

/// The reason why published numbers of others are larger; a comment in every file for a filter, and beside the summary
/// of all programs.
pub(super) const INFLATED: &str = "These are the sensor's own at rest. Published values are often ten times as large, since they \
    also cover what a filter does not model (vibration, temperature, scale factors, discretisation, correlated noise) and keep it \
    consistent: enlarge them until its innovations are as large as it expects (NIS), and not because Allan values looked small.";

/// The rate at which a program draws its noise.
#[derive(Clone, Copy)]
pub(super) enum Step {
    /// No rate: the program takes densities, N in U/√Hz and K in U/√s.
    Continuous,
    /// Once per sample: N√rate in U, and K√rate in U/s.
    Sample,
    /// Once per step of the filter, which takes this many seconds.
    Filter(f64),
}

/// The format in which a program reads its numbers.
pub(super) struct Layout {
    /// The program's interpretation of the numbers and the code that reads them, as a comment.
    pub convention: &'static str,
    /// The source of the convention.
    pub source: &'static str,
    pub step: Step,
    /// Whether the program takes squares.
    pub squared: bool,
    /// The line above all keys, empty if there is none.
    pub head: &'static str,
    /// The text before and after a key.
    pub around: [&'static str; 2],
    /// The keys: accelerometer white and walk, gyroscope white and walk.
    pub keys: [[&'static str; 2]; 2],
    /// The key of the samples' rate, if there is one.
    pub rate: Option<&'static str>,
}

/// `OpenVINS`: continuous densities.
///
/// # Source
/// rpng/open_vins, `config/euroc_mav/kalibr_imu_chain.yaml`; `ov_msckf/src/state/Propagator.cpp`, `predict_and_compute`: the
/// variance of a sample is `sigma_w_2 / dt`, that of a step of the bias `sigma_wb_2 * dt`.
pub(super) const OPENVINS: Layout = Layout {
    convention: "For kalibr_imu_chain.yaml of OpenVINS, whose other keys stay. Continuous-time densities: \
                 ov_msckf/src/state/Propagator.cpp divides the squares of the noise by dt and multiplies those of the walk with it.",
    source: "rpng/open_vins, ov_msckf/src/state/Propagator.cpp",
    step: Step::Continuous,
    squared: false,
    head: "imu0:",
    around: ["  ", ": "],
    keys: [
        ["accelerometer_noise_density", "accelerometer_random_walk"],
        ["gyroscope_noise_density", "gyroscope_random_walk"],
    ],
    rate: Some("update_rate"),
};

/// `VINS-Fusion` and `VINS-Mono`: standard deviations of one sample.
///
/// # Source
/// HKUST-Aerial-Robotics/VINS-Fusion, `config/euroc/euroc_stereo_imu_config.yaml`;
/// `vins_estimator/src/factor/integration_base.h`, `midPointIntegration`: a step adds `V noise Vᵀ` with 0.5 dt for each
/// of the two samples at its ends and dt for the walks.
pub(super) const VINS_FUSION: Layout = Layout {
    convention: "For the configuration of VINS-Fusion and VINS-Mono. Standard deviations at this record's rate, N sqrt(rate) and K \
                 sqrt(rate), not densities: vins_estimator/src/factor/integration_base.h multiplies them with dt at every step. Each \
                 step counts half of its two samples as if no other step shared them, so that the covariance of white noise comes \
                 out half as large: sqrt(2) times acc_n and gyr_n make up for that.",
    source: "HKUST-Aerial-Robotics/VINS-Fusion, vins_estimator/src/factor/integration_base.h",
    step: Step::Sample,
    squared: false,
    head: "",
    around: ["", ": "],
    keys: [["acc_n", "acc_w"], ["gyr_n", "gyr_w"]],
    rate: None,
};

/// `ORB-SLAM3`: continuous densities.
///
/// # Source
/// UZ-SLAMLab/ORB_SLAM3, `Examples/Monocular-Inertial/EuRoC.yaml`; `src/Tracking.cc`: `IMU::Calib(Tbc, Ng*sf, Na*sf,
/// Ngw/sf, Naw/sf)` with `sf = sqrt(mImuFreq)`; `src/Settings.cc`, `readIMU`: all of them are floats.
pub(super) const ORB_SLAM3: Layout = Layout {
    convention: "For the settings of ORB-SLAM3. Continuous-time densities: src/Tracking.cc multiplies the noises with \
                 sqrt(IMU.Frequency) and divides the walks by it, so that IMU.Frequency has to be the true rate.",
    source: "UZ-SLAMLab/ORB_SLAM3, src/Tracking.cc",
    step: Step::Continuous,
    squared: false,
    head: "",
    around: ["", ": "],
    keys: [["IMU.NoiseAcc", "IMU.AccWalk"], ["IMU.NoiseGyro", "IMU.GyroWalk"]],
    rate: Some("IMU.Frequency"),
};

/// `LIO-SAM`: continuous densities.
///
/// # Source
/// TixiaoShan/LIO-SAM, `config/params.yaml`; `src/imuPreintegration.cpp`: squares of the noises become GTSAM's
/// `accelerometerCovariance` and `gyroscopeCovariance` (continuous; GTSAM divides them by dt), and the walks are multiplied with
/// `sqrt(deltaTij())`.
pub(super) const LIO_SAM: Layout = Layout {
    convention: "For config/params.yaml of LIO-SAM (ROS 2: below ros__parameters). Continuous-time densities: \
                 src/imuPreintegration.cpp hands their squares to GTSAM, which divides by dt, and multiplies the walks with the \
                 root of the time between two scans.",
    source: "TixiaoShan/LIO-SAM, src/imuPreintegration.cpp",
    step: Step::Continuous,
    squared: false,
    head: "lio_sam:",
    around: ["  ", ": "],
    keys: [["imuAccNoise", "imuAccBiasN"], ["imuGyrNoise", "imuGyrBiasN"]],
    rate: None,
};

/// `FAST-LIO`: variances of one sample.
///
/// # Source
/// hku-mars/FAST_LIO, `config/avia.yaml`; `src/IMU_Processing.hpp`, `UndistortPcl`: `Q` has the numbers on its diagonal;
/// `IKFoM_toolkit/esekfom/esekfom.hpp`, `predict`: a step adds `(dt f_w) Q (dt f_w)ᵀ`.
pub(super) const FAST_LIO: Layout = Layout {
    convention: "For the configuration of FAST-LIO and FAST-LIO2. Variances at this record's rate, N^2 rate and K^2 rate: \
                 IKFoM's predict adds dt^2 times them at every sample. Its own configurations have 0.1 and 0.0001.",
    source: "hku-mars/FAST_LIO, src/IMU_Processing.hpp; IKFoM_toolkit/esekfom/esekfom.hpp",
    step: Step::Sample,
    squared: true,
    head: "mapping:",
    around: ["  ", ": "],
    keys: [["acc_cov", "b_acc_cov"], ["gyr_cov", "b_gyr_cov"]],
    rate: None,
};

/// EKF2 of `PX4`: standard deviations at a step of the filter, 10 ms.
///
/// # Source
/// PX4/PX4-Autopilot, `src/modules/ekf2/EKF/covariance.cpp`, `predictCovariance`: a step adds `sq(dt * gyro_noise)` to
/// the angle and `sq(dt * gyro_bias_p_noise)` to the bias, the accelerometer's likewise; `EKF2_PREDICT_US`, 10000 by
/// default, is dt.
pub(super) const PX4: Layout = Layout {
    convention: "For EKF2 of PX4 (commands of its shell). Standard deviations at one step of the filter, N/sqrt(dt) and K/sqrt(dt), \
                 whatever the sensor's rate: EKF/covariance.cpp adds (dt times them)^2 per step, and samples are joined to steps \
                 of EKF2_PREDICT_US = 10000 us before. Its defaults cover a flying vehicle.",
    source: "PX4/PX4-Autopilot, src/modules/ekf2/EKF/covariance.cpp",
    step: Step::Filter(0.01),
    squared: false,
    head: "",
    around: ["param set ", " "],
    keys: [["EKF2_ACC_NOISE", "EKF2_ACC_B_NOISE"], ["EKF2_GYR_NOISE", "EKF2_GYR_B_NOISE"]],
    rate: None,
};

/// EKF3 of `ArduPilot`: standard deviations at a step of the filter, 12 ms.
///
/// # Source
/// ArduPilot/ardupilot, `libraries/AP_NavEKF3/AP_NavEKF3_core.cpp`, `CovariancePrediction`: a step adds
/// `sq(dt*_gyrNoise)` to the angle and `sq(sq(dt)*_gyroBiasProcessNoise)` to the bias times dt, the accelerometer's
/// likewise; `AP_NavEKF3_core.h`: `EKF_TARGET_DT` is 0.012 s, which is dt if the vehicle's loop is at least as fast.
pub(super) const ARDUPILOT: Layout = Layout {
    convention: "For EKF3 of ArduPilot (a parameter file). Standard deviations at one step of the filter, N/sqrt(dt) and K/sqrt(dt), \
                 whatever the sensor's rate: AP_NavEKF3_core.cpp adds (dt times them)^2 per step, and samples are joined to steps \
                 of EKF_TARGET_DT = 12 ms before (20 ms where the main loop is at 50 Hz). Its defaults cover a flying vehicle.",
    source: "ArduPilot/ardupilot, libraries/AP_NavEKF3/AP_NavEKF3_core.cpp",
    step: Step::Filter(0.012),
    squared: false,
    head: "",
    around: ["", " "],
    keys: [["EK3_ACC_P_NSE", "EK3_ABIAS_P_NSE"], ["EK3_GYRO_P_NSE", "EK3_GBIAS_P_NSE"]],
    rate: None,
};

/// Returns the numbers for a program with that layout.
pub(super) fn form(noise: &ImuNoise, layout: &Layout) -> Form {
    let (factor, step) = match layout.step {
        Step::Continuous => (1.0, String::new()),
        Step::Sample => (noise.rate_hz.sqrt(), format!("at {} Hz", imu_core::units::hertz(noise.rate_hz))),
        Step::Filter(dt_s) => (dt_s.sqrt().recip(), format!("at steps of {:.0} ms", 1e3 * dt_s)),
    };
    let takes = match (layout.step, layout.squared) {
        (Step::Continuous, _) => "densities: N, K".to_owned(),
        (Step::Sample, false) => format!("standard deviations {step}: N√rate, K√rate"),
        (Step::Sample, true) => format!("variances {step}: N² rate, K² rate"),
        (Step::Filter(_), _) => format!("standard deviations {step}: N/√dt, K/√dt"),
    };
    let (mut entries, sensors) = (
        Vec::new(),
        [(Triad::Accel, &noise.accel, ["m/s^2", "m/s^3"]), (Triad::Gyro, &noise.gyro, ["rad/s", "rad/s^2"])],
    );
    for ((triad, axes, units), keys) in sensors.into_iter().zip(layout.keys) {
        let Some(axes) = axes else { continue };
        for ((noise, unit), key) in Noise::ALL.into_iter().zip(units).zip(keys) {
            let unit = match (layout.step, layout.squared) {
                (Step::Continuous, _) => format!("{unit}/sqrt(Hz)"),
                (_, false) => unit.to_owned(),
                (_, true) => format!("({unit})^2"),
            };
            let own = |known: Known| known.map(|value| if layout.squared { value * value } else { value });
            let axes = axes.map(|axis| own(noise.of(&axis).scaled(factor)));
            entries.push(Entry { key, triad, noise, unit, axes });
        }
    }
    Form { takes, source: layout.source, each_axis: false, entries }
}

/// Returns the text for a program with that layout.
pub(super) fn write(noise: &ImuNoise, layout: &Layout) -> String {
    let mut text = super::comment("# ", &noise.origin_for(&[]));
    text += &super::comment("# ", layout.convention);
    text += &super::comment("# ", noise.note());
    let left = match &noise.enlarged {
        None => "Not expressible: bias instability B, a Gauss-Markov process.",
        Some(_) => "Bias instability B and other effects are in these numbers.",
    };
    text += &super::comment(
        "# ",
        &format!(
            "One number for three axes: the largest. `<`: not identified in this record, the 95 % upper limit stands. {left}"
        ),
    );
    // Writing to a text cannot fail.
    if !layout.head.is_empty() {
        let _ = writeln!(text, "{}", layout.head);
    }
    let [before, behind] = layout.around;
    for entry in form(noise, layout).entries {
        let Entry { key, unit, .. } = &entry;
        let (sensor, what, words) = (sensor(entry.triad), entry.noise.words(), entry.words());
        let _ = writeln!(text, "{}# {sensor}, {what}, {unit}; x, y, z: {words}", indent(before));
        let _ = match largest(entry.axes).bound() {
            Some(value) => writeln!(text, "{before}{key}{behind}{value:.6e}"),
            None => writeln!(text, "{}# {key}: unknown, take it from a longer record", indent(before)),
        };
    }
    if let Some(key) = layout.rate {
        let _ = writeln!(text, "{before}{key}{behind}{:?}", noise.rate_hz);
    }
    text
}

/// Returns the instrument of a triad.
pub(super) fn sensor(triad: Triad) -> &'static str {
    if triad == Triad::Gyro { "gyroscope" } else { "accelerometer" }
}

/// Returns the part of the text before a key that is only indentation.
fn indent(before: &str) -> &str {
    if before.trim().is_empty() { before } else { "" }
}
