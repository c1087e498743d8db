//! Arguments of `diagnose`.

use super::complete;
use super::{PartArgs, SamplingArgs, one_of, rate, share};
use crate::jobs::ReferenceAxis;
use clap::Args;
use clap::builder::TypedValueParser;
use std::path::PathBuf;

/// Arguments of `diagnose`.
#[derive(Debug, Args)]
#[command(after_help = crate::page::NATS)]
pub struct DiagnoseArgs {
    /// The recording: id, name, `latest`, or a file's path
    #[arg(long, value_name = "CAPTURE|FILE", add = complete::captures_and_files())]
    pub real: String,
    /// The simulator: a sensor model (.json), or a capture or file that a simulator made
    #[arg(long, value_name = "MODEL.json|CAPTURE|FILE", add = complete::simulators())]
    pub sim: String,
    /// The sensor's motion as another instrument measured it: a CSV with time_s, ref_gyro_x_rad_s … ref_accel_z_m_s2,
    /// or with poses (time_s, q_w … q_z, p_x_m …, also EuRoC, TUM, OptiTrack, Vicon), or with rates about one axis; the effects
    /// that a motion drives are diagnosed too
    #[arg(long, value_name = "MOTION.csv")]
    pub reference: Option<PathBuf>,
    /// The axis of a reference with `encoder_rpm`
    #[arg(long, value_name = "AXIS", value_parser = reference_axis(), requires = "reference")]
    pub reference_axis: Option<ReferenceAxis>,
    /// Rate of recordings without stamps in Hz
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate: Option<f64>,
    /// The part of the recording (--real)
    #[command(flatten)]
    pub part: PartArgs,
    /// The sampling of the recording
    #[command(flatten)]
    pub sampling: SamplingArgs,
    /// Measure chance findings in 300 simulated records like this one, instead of using the table; kept in
    /// $XDG_CACHE_HOME/vn100d
    #[arg(long)]
    pub calibrate: bool,
    /// Part of the gap, from 0 to 1, above which the unnamed remainder makes the verdict `unknown_effect`
    #[arg(long, value_name = "SHARE", value_parser = share, default_value_t = imu_diagnosis::MATERIAL)]
    pub unknown_above: f64,
    /// Write the model here, with corrected parameters and the missing effects
    #[arg(long, value_name = "OUT.json")]
    pub augmented_model: Option<PathBuf>,
    /// Write the diagnosis here as a page with spectra; it loads nothing from elsewhere
    #[arg(long, value_name = "OUT.html")]
    pub html: Option<PathBuf>,
    /// List every place of the gap, every sentence of evidence and every entry of a parameter
    #[arg(long)]
    pub verbose: bool,
    /// End with exit code 4 if a quantity is above its limit: gap, after_parameters, after in nats a sample, closed (what the
    /// model lacks), remainder as parts from 0 to 1, such as gap=0.001,closed=0.5 (docs/ci.md)
    #[arg(long, value_name = "NAME=LIMIT", value_delimiter = ',')]
    pub at_most: Vec<String>,
    /// End with exit code 4 if a quantity is below its limit, such as closed=0.9; names as for --at-most
    #[arg(long, value_name = "NAME=LIMIT", value_delimiter = ',')]
    pub at_least: Vec<String>,
    /// Write the limits and what was found as a JUnit report, which systems of continuous integration read
    #[arg(long, value_name = "OUT.xml")]
    pub junit: Option<PathBuf>,
    /// Replace existing files
    #[arg(long)]
    pub force: bool,
}

fn reference_axis() -> impl TypedValueParser<Value = ReferenceAxis> {
    one_of(ReferenceAxis::NAMED.map(|(name, axis)| (name.into(), axis)).to_vec())
}
