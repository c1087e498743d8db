//! Exports: noise parameters in the forms that simulators and filters read, one target per file.
//!
//! Every maker takes [`ImuNoise`] and gives text. What a target cannot express is said in the text itself; a parameter that
//! the data does not support is never written as if it were measured: where a target needs a number its 95 % upper limit
//! stands there, with a comment. Units are those of each target's public documentation, named in its file.

mod gazebo;
mod gnss_ins_sim;
mod kalibr;
mod matlab;
mod ros;
#[cfg(test)]
mod tests;

use crate::noise::NoiseReport;
use crate::noise::fit::{Estimate, NoiseParameters};
use crate::sample::{Channel, Triad};
use crate::simulator::SensorModel;
use serde::{Deserialize, Serialize};

/// Where parameters can go.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Target {
    /// Kalibr's `imu.yaml`.
    Kalibr,
    /// Covariances of `sensor_msgs/Imu`.
    Ros,
    /// Noise elements of an SDF IMU sensor.
    Gazebo,
    /// The `imu_err` dictionary of gnss-ins-sim.
    GnssInsSim,
    /// JSON for `loadparams` of MATLAB's `imuSensor`.
    Matlab,
}

impl Target {
    /// All.
    pub const ALL: [Self; 5] = [Self::Kalibr, Self::Ros, Self::Gazebo, Self::GnssInsSim, Self::Matlab];

    /// The name on the command line and in queries.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Kalibr => "kalibr",
            Self::Ros => "ros",
            Self::Gazebo => "gazebo",
            Self::GnssInsSim => "gnss-ins-sim",
            Self::Matlab => "matlab",
        }
    }

    /// The target of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|target| target.name() == name)
    }

    /// Media type of its text.
    #[must_use]
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Kalibr | Self::Ros => "application/yaml",
            Self::Gazebo => "application/xml",
            Self::GnssInsSim => "text/x-python; charset=utf-8",
            Self::Matlab => "application/json",
        }
    }

    /// The text.
    #[must_use]
    pub fn write(self, noise: &ImuNoise) -> String {
        match self {
            Self::Kalibr => kalibr::write(noise),
            Self::Ros => ros::write(noise),
            Self::Gazebo => gazebo::write(noise),
            Self::GnssInsSim => gnss_ins_sim::write(noise),
            Self::Matlab => matlab::write(noise),
        }
    }
}

/// One parameter as far as it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Known {
    /// Measured.
    Value(f64),
    /// Not supported by the data, but below this with 95 % confidence.
    Below(f64),
    /// Not known.
    Nothing,
}

impl Known {
    fn of(estimate: &Estimate) -> Self {
        match (estimate.value, estimate.upper_limit95) {
            (Some(value), _) if estimate.identified => Self::Value(value),
            (_, Some(limit)) => Self::Below(limit),
            _ => Self::Nothing,
        }
    }

    /// A number that is not too small: the value, else the limit.
    fn bound(self) -> Option<f64> {
        match self {
            Self::Value(value) | Self::Below(value) => Some(value),
            Self::Nothing => None,
        }
    }

    fn words(self) -> String {
        match self {
            Self::Value(value) => format!("{value:.4e}"),
            Self::Below(limit) => format!("< {limit:.4e}"),
            Self::Nothing => "unknown".to_owned(),
        }
    }
}

/// Noise of one axis, in the channel's unit U: N in U/√Hz (two-sided density N²), B in U, K in U/√s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// White noise.
    pub n: Known,
    /// Bias instability.
    pub b: Known,
    /// Rate random walk.
    pub k: Known,
    /// Gauss–Markov process: standard deviation and correlation time in s.
    pub gauss_markov: Option<(f64, f64)>,
}

impl Axis {
    /// Nothing known.
    pub const UNKNOWN: Self = Self { n: Known::Nothing, b: Known::Nothing, k: Known::Nothing, gauss_markov: None };

    fn of(parameters: &NoiseParameters) -> Self {
        let gauss_markov = parameters.gauss_markov.as_ref().and_then(|gm| gm.sigma.value.zip(gm.tc_s.value));
        Self { n: Known::of(&parameters.n), b: Known::of(&parameters.b), k: Known::of(&parameters.k), gauss_markov }
    }
}

/// What all makers write from.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuNoise {
    /// Where the parameters come from, and what of it no target can hold: one line for a comment.
    pub origin: String,
    /// Rate of the samples, Hz.
    pub rate_hz: f64,
    /// Length of the record, s.
    pub duration_s: f64,
    /// Accelerometer x, y, z in m/s².
    pub accel: [Axis; 3],
    /// Gyroscope x, y, z in rad/s.
    pub gyro: [Axis; 3],
    /// Magnetometer x, y, z in gauss.
    pub mag: [Axis; 3],
}

impl ImuNoise {
    /// The parameters of a report.
    #[must_use]
    pub fn of(report: &NoiseReport) -> Self {
        let axes = |triad: Triad| {
            triad.channels().map(|channel: Channel| report.channels.get(&channel).map_or(Axis::UNKNOWN, Axis::of))
        };
        let (name, duration_s) = (harmless(&report.capture), report.duration_s);
        Self {
            origin: format!("VN-100 capture {name}: {duration_s} s at {} Hz", report.rate_hz),
            rate_hz: report.rate_hz,
            duration_s: report.duration_s,
            accel: axes(Triad::Accel),
            gyro: axes(Triad::Gyro),
            mag: axes(Triad::Mag),
        }
    }

    /// The parameters of a sensor model. A Gauss–Markov process counts where an axis has one; all other effects, and how the
    /// sensor samples, are named as left out.
    #[must_use]
    pub fn of_model(model: &SensorModel) -> Self {
        let mut omitted = Vec::new();
        let mut axis = |channel: Channel| {
            let Some(of) = model.channels.get(&channel) else { return Axis::UNKNOWN };
            let mut gauss_markov = None;
            for effect in &of.effects {
                let number = |key: &str| {
                    let found = effect.parameters().into_iter().find(|(name, _)| *name == key);
                    found.and_then(|(_, value)| value.as_f64())
                };
                let process = number("sigma").zip(number("tc_s")).filter(|_| effect.name() == "gauss_markov");
                match (process, gauss_markov) {
                    (Some(process), None) => gauss_markov = Some(process),
                    _ => omitted.push(format!("{} of {channel}", effect.name())),
                }
            }
            omitted.extend(of.bias.filter(|bias| *bias != 0.0).map(|_| format!("bias of {channel}")));
            let known = |value: f64, key: &str| {
                let limit = of.uncertainty.as_ref().and_then(|of| of.get(key)?.get("upper_limit95")?.as_f64());
                match limit {
                    Some(limit) if value == 0.0 => Known::Below(limit),
                    _ => Known::Value(value),
                }
            };
            // What is faster than half the output's rate folds into it; slow noise is left as it is.
            let folded = model.sampling.map_or(1.0, |sampling| sampling.density_factor(model.rate_hz));
            Axis { n: scaled(known(of.n, "N"), folded), b: known(of.b, "B"), k: known(of.k, "K"), gauss_markov }
        };
        let [accel, gyro, mag] = [Triad::Accel, Triad::Gyro, Triad::Mag].map(|triad| triad.channels().map(&mut axis));
        for (triad, of) in &model.triads {
            omitted.extend(of.effects.iter().map(|effect| format!("{} of {}", effect.name(), triad.name())));
        }
        let mut origin = format!("Sensor model {} at {} Hz", harmless(&model.name), model.rate_hz);
        if let Some(sampling) = model.sampling {
            let (own_hz, window) = (sampling.internal_rate_hz, sampling.filter_window);
            origin = format!("{origin}, N with what folds from {own_hz} Hz through means of {window}");
        }
        if !omitted.is_empty() {
            origin = format!("{origin}. Left out here: {}", omitted.join(", "));
        }
        let told = model.provenance.as_ref().and_then(|of| of.get("duration_s")?.as_f64());
        // Where no record is behind it: a day, over which its walks would be seen.
        Self { origin, rate_hz: model.rate_hz, duration_s: told.unwrap_or(86_400.0), accel, gyro, mag }
    }

    fn has_mag(&self) -> bool {
        self.mag.iter().any(|axis| axis.n != Known::Nothing)
    }
}

fn scaled(known: Known, factor: f64) -> Known {
    match known {
        Known::Value(value) => Known::Value(value * factor),
        Known::Below(value) => Known::Below(value * factor),
        Known::Nothing => Known::Nothing,
    }
}

/// A name goes into comments: it must not end them.
fn harmless(name: &str) -> String {
    name.chars().map(|c| if c.is_control() || "<>-\"'".contains(c) { '_' } else { c }).collect()
}

/// `x, y, z` of a parameter in words.
fn each(axes: &[Axis; 3], of: impl Fn(&Axis) -> Known, factor: f64) -> String {
    axes.iter().map(|axis| scaled(of(axis), factor).words()).collect::<Vec<_>>().join(", ")
}

/// What to add to a comment where a number stands for a limit; empty where all are measured.
fn limits(axes: &[Axis; 3], of: impl Fn(&Axis) -> Known) -> String {
    let limited = ["x", "y", "z"].into_iter().zip(axes).filter(|(_, axis)| matches!(of(axis), Known::Below(_)));
    let letters: Vec<&str> = limited.map(|(letter, _)| letter).collect();
    if letters.is_empty() {
        return String::new();
    }
    format!("; {}: not identified, from the 95 % upper limit", letters.join(", "))
}

/// The largest of the axes, limits included; `None` where nothing is known.
fn worst(axes: &[Axis; 3], of: impl Fn(&Axis) -> Known) -> Option<f64> {
    axes.iter().filter_map(|axis| of(axis).bound()).reduce(f64::max)
}
