//! Arguments of `calibrate`.

use super::complete;
use super::{PartArgs, rate};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// The form of the output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Form {
    /// A table for people
    Table,
    /// The document `vn100d-calibration-1`
    Json,
    /// Lines that write the compensation registers of a VN-100 (23, 25, 84), with checksums
    Registers,
    /// Kalibr's intrinsics, model scale-misalignment
    Kalibr,
    /// The accelerometer's file of imu_tk
    ImuTkAccel,
    /// The gyroscope's file of imu_tk
    ImuTkGyro,
    /// The accelerometer's YAML of ROS' imu_calib
    ImuCalib,
}

/// Arguments of `calibrate`.
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    /// The recording: id, name, `latest`, or a file's path. Without a reference it is a tumble: rest 2.5 s or longer in twelve poses
    /// or more, and turn the sensor between them. Columns may be in counts (`accel_x_counts`)
    #[arg(value_name = "CAPTURE|FILE", add = complete::captures_and_files())]
    pub real: String,
    /// Poses that another instrument measured (time_s, q_w … q_z, p_x_m …, also EuRoC, TUM, OptiTrack, Vicon), instead of gravity alone
    #[arg(long, value_name = "POSES.csv", conflicts_with = "gravity")]
    pub reference: Option<PathBuf>,
    /// Local gravity in m/s². Without it gravity is 9.80665 ± 0.025 m/s², and the interval of a scale factor is as wide as that
    #[arg(long, value_name = "M_S2", value_parser = gravity)]
    pub gravity: Option<f64>,
    /// Strength of the earth's field in gauss. Without it, hard iron and the shape of soft iron are reported, not its size
    #[arg(long, value_name = "GAUSS", value_parser = field)]
    pub field: Option<f64>,
    /// Rate of recordings without stamps in Hz
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// The part of the recording
    #[command(flatten)]
    pub part: PartArgs,
    /// Form of the output
    #[arg(long, value_enum, default_value = "table")]
    pub format: Form,
    /// Write here instead of standard output
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long)]
    pub force: bool,
}

fn gravity(text: &str) -> Result<f64, String> {
    within(text, [9.7, 9.9], "m/s² at a place on earth, such as 9.8129")
}

fn field(text: &str) -> Result<f64, String> {
    within(text, [0.1, 1.0], "gauss, such as 0.49")
}

fn within(text: &str, [least, most]: [f64; 2], what: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| (least..=most).contains(value));
    value.ok_or_else(|| format!("expected {least} to {most} {what}"))
}
