//! Exports: samples in the formats that other programs read ([`samples`]), corrections in the forms of those who apply them
//! ([`calibration`]), and noise parameters in the formats that simulators and filters read, one target per file. Filters that take one white noise and one walk share `filter`.
//!
//! Every maker takes [`ImuNoise`] and returns its numbers in the program's convention (`form`), which the summary of
//! all programs ([`paste`]) shows too. It also returns text, which covers only the triads that the source has. A
//! comment states what a target cannot express. A parameter that the data does not support is never written as if it
//! were measured. A filter gets its 95 % upper limit, marked by a comment: a number for a filter is never too small. A
//! simulator then gets no walk: a number for a simulator is never larger than the measured one, except N, without which
//! there would be no noise at all. Units are those of each target's public documentation or code, named in its file.

pub mod calibration;
mod consistent;
mod filter;
mod form;
mod gazebo;
mod gnss_ins_sim;
mod isaac;
mod kalibr;
mod matlab;
pub mod paste;
mod robot_localization;
mod ros;
pub mod samples;
#[cfg(test)]
mod tests;

pub use consistent::FilterKind;
pub use form::Noise;

use form::Form;
use imu_core::sample::{Channel, Triad};
use imu_core::variants;
use imu_model::EffectKind;
use imu_model::simulator::{SensorModel, plateau};
use imu_noise::NoiseReport;
use imu_noise::fit::{Estimate, NoiseParameters};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use strum::EnumMessage as _;

/// The targets of parameters. The documentation of each is its description for the user.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[derive(strum::EnumMessage, strum::EnumString, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "kebab-case")]
pub enum Target {
    /// Kalibr's imu.yaml
    Kalibr,
    /// kalibr_imu_chain.yaml of OpenVINS
    Openvins,
    /// Configuration of VINS-Fusion and VINS-Mono
    VinsFusion,
    /// Settings of ORB-SLAM3
    OrbSlam3,
    /// params.yaml of LIO-SAM
    LioSam,
    /// Configuration of FAST-LIO
    FastLio,
    /// Covariances for robot_localization
    RobotLocalization,
    /// Parameters of PX4's EKF2
    Px4,
    /// Parameters of ArduPilot's EKF3
    Ardupilot,
    /// Covariances of sensor_msgs/Imu and MagneticField
    Ros,
    /// Noise elements of an SDF sensor
    Gazebo,
    /// Observation noise of Isaac Lab
    Isaac,
    /// The imu_err dictionary of gnss-ins-sim
    GnssInsSim,
    /// JSON for imuSensor's loadparams
    Matlab,
}

impl Target {
    /// All targets.
    pub const ALL: [Self; 14] = variants();

    /// Returns the name on the command line and in queries.
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// Returns a short description of the text that it writes.
    pub fn about(self) -> &'static str {
        self.get_documentation().unwrap_or_default()
    }

    /// Returns the target with that name.
    pub fn from_name(name: &str) -> Option<Self> {
        name.parse().ok()
    }

    /// Returns the media type of the text.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Gazebo => "application/xml",
            Self::GnssInsSim | Self::Isaac => "text/x-python; charset=utf-8",
            Self::Matlab => "application/json",
            Self::Px4 | Self::Ardupilot => "text/plain; charset=utf-8",
            _ => "application/yaml",
        }
    }

    /// Returns whether its text has numbers of a channel.
    pub fn holds(self, channel: Channel) -> bool {
        match channel.triad() {
            Some(Triad::Gyro | Triad::Accel) => true,
            Some(Triad::Mag) => matches!(self, Self::Ros | Self::Gazebo | Self::GnssInsSim | Self::Matlab),
            Some(Triad::Attitude) | None => false,
        }
    }

    /// Returns the reason why the parameters of a report should not be written: the channels that the text would
    /// contain and that are not usable, with their reasons. `None` if all of them are usable.
    pub fn refusal(self, report: &NoiseReport) -> Option<String> {
        report.refusal(|channel| self.holds(channel))
    }

    /// Returns the text of a report's parameters; a comment names those that are not usable.
    pub fn write_report(self, report: &NoiseReport) -> String {
        self.write(&ImuNoise::of_report(report, self.refusal(report)))
    }

    /// Returns the text with the parameters.
    pub fn write(self, noise: &ImuNoise) -> String {
        match self {
            Self::Kalibr => kalibr::write(noise),
            Self::Openvins => filter::write(noise, &filter::OPENVINS),
            Self::VinsFusion => filter::write(noise, &filter::VINS_FUSION),
            Self::OrbSlam3 => filter::write(noise, &filter::ORB_SLAM3),
            Self::LioSam => filter::write(noise, &filter::LIO_SAM),
            Self::FastLio => filter::write(noise, &filter::FAST_LIO),
            Self::Px4 => filter::write(noise, &filter::PX4),
            Self::Ardupilot => filter::write(noise, &filter::ARDUPILOT),
            Self::RobotLocalization => robot_localization::write(noise),
            Self::Ros => ros::write(noise),
            Self::Gazebo => gazebo::write(noise),
            Self::Isaac => isaac::write(noise),
            Self::GnssInsSim => gnss_ins_sim::write(noise),
            Self::Matlab => matlab::write(noise),
        }
    }

    /// Returns the numbers in the program's convention.
    fn form(self, noise: &ImuNoise) -> Form {
        match self {
            Self::Kalibr => filter::form(noise, &kalibr::LAYOUT),
            Self::Openvins => filter::form(noise, &filter::OPENVINS),
            Self::VinsFusion => filter::form(noise, &filter::VINS_FUSION),
            Self::OrbSlam3 => filter::form(noise, &filter::ORB_SLAM3),
            Self::LioSam => filter::form(noise, &filter::LIO_SAM),
            Self::FastLio => filter::form(noise, &filter::FAST_LIO),
            Self::Px4 => filter::form(noise, &filter::PX4),
            Self::Ardupilot => filter::form(noise, &filter::ARDUPILOT),
            Self::RobotLocalization => robot_localization::form(noise),
            Self::Ros => ros::form(noise),
            Self::Gazebo => gazebo::form(noise),
            Self::Isaac => isaac::form(noise),
            Self::GnssInsSim => gnss_ins_sim::form(noise),
            Self::Matlab => matlab::form(noise),
        }
    }
}

/// A parameter: measured, only bounded, or unknown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Known {
    /// The measured value.
    Value(f64),
    /// The data does not support a value, but with 95 % confidence it is below this.
    Below(f64),
    /// The parameter is unknown.
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

    /// Returns the parameter if it is measured, else `Nothing`.
    fn measured(self) -> Self {
        if let Self::Value(_) = self { self } else { Self::Nothing }
    }

    /// Returns a number that is not too small: the value, else the limit.
    fn bound(self) -> Option<f64> {
        match self {
            Self::Value(value) | Self::Below(value) => Some(value),
            Self::Nothing => None,
        }
    }

    fn map(self, of: impl Fn(f64) -> f64) -> Self {
        match self {
            Self::Value(value) => Self::Value(of(value)),
            Self::Below(limit) => Self::Below(of(limit)),
            Self::Nothing => Self::Nothing,
        }
    }

    fn scaled(self, factor: f64) -> Self {
        self.map(|value| value * factor)
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
    /// The properties that are not noise.
    pub fixed: Fixed,
}

/// The effects of an axis on its values besides noise, in the channel's unit U; `None` if the source has none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fixed {
    /// A constant, U.
    pub bias: Option<f64>,
    /// The step that values are multiples of, U.
    pub resolution: Option<f64>,
    /// Slope, U/°C, and the temperature at which it has no effect, °C.
    pub temperature: Option<(f64, f64)>,
    /// The range: no value is beyond plus or minus this, U.
    pub range: Option<f64>,
    /// The sensitivity of a gyroscope to the acceleration of its own axis, (rad/s)/(m/s²).
    pub acceleration: Option<f64>,
}

/// A part of a sensor model that only some targets can hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    Bias,
    Resolution,
    Temperature,
    Range,
    Acceleration,
}

impl Axis {
    /// An axis without any known parameter.
    pub const UNKNOWN: Self = Self {
        n: Known::Nothing,
        b: Known::Nothing,
        k: Known::Nothing,
        gauss_markov: None,
        fixed: Fixed { bias: None, resolution: None, temperature: None, range: None, acceleration: None },
    };

    fn of(parameters: &NoiseParameters) -> Self {
        let gauss_markov = parameters.gauss_markov.as_ref().and_then(|gm| gm.sigma.value.zip(gm.tc_s.value));
        let [n, b, k] = [&parameters.n, &parameters.b, &parameters.k].map(Known::of);
        Self { n, b, k, gauss_markov, fixed: Fixed::default() }
    }
}

/// The input of all makers.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuNoise {
    /// The source of the parameters: one line for a comment.
    pub origin: String,
    /// The reason why the numbers should not be used; `None` if they may be.
    pub caution: Option<String>,
    /// Channels behind a filter that shapes white noise, with a description of the filter: one sample of these deviates
    /// less than N√rate.
    pub behind: BTreeMap<Channel, String>,
    /// The reason why N and K are larger than the sensor's own, if they were replaced by consistent ones
    /// ([`ImuNoise::consistent`]).
    pub enlarged: Option<String>,
    /// The parts that no target can express, each by its name and its channel or triad.
    pub others: Vec<(String, String)>,
    /// Rate of the samples, Hz.
    pub rate_hz: f64,
    /// Length of the record, s.
    pub duration_s: f64,
    /// Accelerometer x, y, z in m/s²; none if the source has no axis of it.
    pub accel: Option<[Axis; 3]>,
    /// Gyroscope x, y, z in rad/s.
    pub gyro: Option<[Axis; 3]>,
    /// Magnetometer x, y, z in gauss.
    pub mag: Option<[Axis; 3]>,
}

impl ImuNoise {
    /// Returns the parameters of a report, with the reason why they should not be used, if there is one
    /// ([`Target::refusal`]).
    pub fn of_report(report: &NoiseReport, caution: Option<String>) -> Self {
        Self { caution, ..Self::of(report) }
    }

    /// Returns the parameters of a report, without a statement whether they may be used ([`Target::write_report`]).
    fn of(report: &NoiseReport) -> Self {
        let axes = |triad: Triad| {
            let known = |channel: Channel| report.channels.get(&channel);
            let there = triad.channels().into_iter().any(|channel| known(channel).is_some());
            there.then(|| triad.channels().map(|channel| known(channel).map_or(Axis::UNKNOWN, Axis::of)))
        };
        let (name, duration_s) = (harmless(&report.capture), report.duration_s);
        Self {
            origin: format!("Capture {name}: {} s at {} Hz", short(duration_s), imu_core::units::hertz(report.rate_hz)),
            caution: None,
            behind: report
                .channels
                .iter()
                .filter_map(|(own, of)| Some((*own, of.bandwidth.as_ref()?.words())))
                .collect(),
            enlarged: None,
            others: Vec::new(),
            rate_hz: report.rate_hz,
            duration_s: report.duration_s,
            accel: axes(Triad::Accel),
            gyro: axes(Triad::Gyro),
            mag: axes(Triad::Mag),
        }
    }

    /// Returns the parameters of a sensor model. Of an axis' effects one Gauss–Markov process, `resolution` and
    /// `temperature_bias` are used. Of a triad's effects its bias, its range, and the diagonal of `g_sensitivity` are
    /// used, the latter if there is nothing beside it. All others are reported as omitted. A magnetometer's level is
    /// the local field, not a bias.
    pub fn of_model(model: &SensorModel) -> Self {
        let (mut others, mut behind) = (Vec::new(), BTreeMap::new());
        let mut axis = |channel: Channel| {
            let Some(of) = model.channels.get(&channel) else { return Axis::UNKNOWN };
            let (mut gauss_markov, mut fixed) = (None, Fixed::default());
            for effect in &of.effects {
                let number = |key: &str| effect.number(key);
                if let filter @ (EffectKind::LowPass | EffectKind::MovingAverage) = effect.kind() {
                    behind.insert(channel, format!("a {}", filter.name().replace('_', " ")));
                }
                // The first of a kind; no target accepts two of them.
                let held = match effect.kind() {
                    EffectKind::GaussMarkov => first(&mut gauss_markov, number("sigma").zip(number("tc_s"))),
                    EffectKind::Resolution => first(&mut fixed.resolution, number("step")),
                    EffectKind::TemperatureBias => {
                        first(&mut fixed.temperature, number("per_c").zip(number("reference_c")))
                    }
                    _ => false,
                };
                if !held {
                    others.push((effect.name().to_owned(), channel.name().to_owned()));
                } else if effect.kind() == EffectKind::TemperatureBias
                    && ["per_c2", "play_c", "per_c_per_s"].into_iter().any(|key| number(key).is_some())
                {
                    others.push(("temperature_bias beyond its slope".to_owned(), channel.name().to_owned()));
                }
            }
            let level = of.bias.filter(|bias| *bias != 0.0);
            if channel.triad() == Some(Triad::Mag) {
                others.extend(level.map(|_| ("field in the bias".to_owned(), channel.name().to_owned())));
            } else {
                fixed.bias = level;
            }
            let known = |value: f64, key: &str| match of.upper_limit(key) {
                Some(limit) if value == 0.0 => Known::Below(limit),
                _ => Known::Value(value),
            };
            // Noise faster than half the output's rate folds into it; slow noise is unchanged. N is the visible noise,
            // including noise behind a filter or beside the white noise, except rounding, which has a separate place.
            let folded = model.sampling.map_or(1.0, |sampling| sampling.density_factor(model.rate_hz));
            let n = match known(of.n, "N") {
                Known::Value(_) => {
                    let mut unrounded = model.clone();
                    unrounded.channels.retain(|own, _| *own == channel);
                    unrounded.channels.values_mut().for_each(|of| of.effects.retain(|of| of.name() != "resolution"));
                    Known::Value(plateau(&unrounded, channel, (model.rate_hz * 3600.0) as u64))
                }
                below => below.scaled(folded),
            };
            Axis { n, b: known(of.b, "B"), k: known(of.k, "K"), gauss_markov, fixed }
        };
        const PLACES: [Triad; 3] = [Triad::Accel, Triad::Gyro, Triad::Mag];
        let mut triads = PLACES.map(|triad| {
            let there = triad.channels().into_iter().any(|channel| model.channels.contains_key(&channel));
            there.then(|| triad.channels().map(&mut axis))
        });
        for (triad, of) in &model.triads {
            let place = PLACES.iter().position(|other| other == triad);
            for effect in &of.effects {
                let axes = place.and_then(|place| triads.get_mut(place)).and_then(Option::as_mut);
                if !axes.is_some_and(|axes| of_triad(axes, effect.name(), &effect.parameters())) {
                    others.push((effect.name().to_owned(), triad.name().to_owned()));
                }
            }
        }
        let mut origin = format!("Sensor model {} at {} Hz", harmless(&model.name), model.rate_hz);
        if let Some(sampling) = model.sampling {
            let (own_hz, window) = (sampling.internal_rate_hz, sampling.filter_window);
            origin = format!("{origin}, N with what folds from {own_hz} Hz through means of {window}");
            // The means overlap.
            if window as f64 * model.rate_hz > own_hz * (1.0 + 1e-3) {
                let inertial = [Triad::Accel, Triad::Gyro].into_iter().flat_map(Triad::channels);
                let there = inertial.filter(|channel| model.channels.contains_key(channel));
                behind.extend(there.map(|channel| (channel, format!("means of {window} at {own_hz} Hz"))));
            }
        }
        let stated_s = model.provenance.as_ref().and_then(|of| of.get("duration_s")?.as_f64());
        let caution = model.provenance.as_ref().and_then(|of| Some(of.get("not_usable")?.as_str()?.to_owned()));
        let [accel, gyro, mag] = triads;
        // Without a record: a day, over which its walks would be visible.
        let duration_s = stated_s.unwrap_or(86_400.0);
        let (enlarged, rate_hz) = (None, model.rate_hz);
        Self { origin, caution, behind, enlarged, others, rate_hz, duration_s, accel, gyro, mag }
    }

    /// Returns the channels behind filters, as the end of a sentence; empty if there are none.
    fn filters(&self) -> String {
        let mut filters: Vec<(&str, Vec<&str>)> = Vec::new();
        for (channel, words) in &self.behind {
            match filters.iter_mut().find(|(other, _)| other == words) {
                Some((_, all)) => all.push(channel.name()),
                None => filters.push((words, vec![channel.name()])),
            }
        }
        filters.iter().map(|(words, whose)| format!("; {} behind {words}", whose.join(" "))).collect()
    }

    /// Returns the meaning of a number at the sensor's rate: the noise of one sample, unless a filter in front of it
    /// makes that smaller.
    fn of_one_sample(&self, of: &[Triad]) -> String {
        if self.behind.keys().any(|channel| channel.triad().is_some_and(|triad| of.contains(&triad))) {
            format!(
                "at {} Hz (a single sample deviates less behind its filter; this keeps the density, which is what integrates)",
                short(self.rate_hz)
            )
        } else {
            format!("of one sample at {} Hz", short(self.rate_hz))
        }
    }

    /// Returns the origin, and the parts of it that a target which holds these parts omits.
    fn origin_for(&self, held: &[Part]) -> String {
        let mut left: Vec<(&str, Vec<&str>)> = Vec::new();
        let mut leave = |name, whose| match left.iter_mut().find(|(other, _)| *other == name) {
            Some((_, all)) => all.push(whose),
            None => left.push((name, vec![whose])),
        };
        for (triad, axes) in [(Triad::Accel, &self.accel), (Triad::Gyro, &self.gyro), (Triad::Mag, &self.mag)] {
            for (channel, Axis { fixed, .. }) in triad.channels().iter().zip(axes.iter().flatten()) {
                for (part, there, name) in [
                    (Part::Bias, fixed.bias.is_some(), "bias"),
                    (Part::Resolution, fixed.resolution.is_some(), "resolution"),
                    (Part::Temperature, fixed.temperature.is_some(), "temperature_bias"),
                    (Part::Range, fixed.range.is_some(), "saturation"),
                    (Part::Acceleration, fixed.acceleration.is_some(), "g_sensitivity"),
                ] {
                    if there && !held.contains(&part) {
                        leave(name, channel.name());
                    }
                }
            }
        }
        self.others.iter().for_each(|(name, whose)| leave(name, whose));
        let caution = self.caution.as_ref().map(|why| format!(". NOT USABLE, written because it was asked for: {why}"));
        let origin = format!("{}{}{}", self.origin, self.filters(), caution.unwrap_or_default());
        if left.is_empty() {
            return origin;
        }
        let left: Vec<String> = left.iter().map(|(name, whose)| format!("{name} of {}", whose.join(" "))).collect();
        format!("{origin}. Left out here: {}", left.join(", "))
    }
}

/// Stores the value if it is the first; returns whether it is.
fn first<T>(place: &mut Option<T>, found: Option<T>) -> bool {
    let fits = place.is_none() && found.is_some();
    if fits {
        *place = found;
    }
    fits
}

/// Returns whether an effect of a triad can be expressed axis by axis; if so, it is stored.
fn of_triad(axes: &mut [Axis; 3], name: &str, parameters: &[(&'static str, Value)]) -> bool {
    let of = |key: &str| parameters.iter().find(|(name, _)| *name == key).map(|(_, value)| value);
    let number = |key: &str| of(key).and_then(Value::as_f64);
    match name {
        "bias" => {
            for (axis, key) in axes.iter_mut().zip(["x", "y", "z"]) {
                let more = number(key).filter(|more| *more != 0.0);
                axis.fixed.bias = more.map(|more| more + axis.fixed.bias.unwrap_or(0.0)).or(axis.fixed.bias);
            }
            true
        }
        // Of several limits the tightest is used.
        "saturation" => number("range").is_some_and(|range| {
            axes.iter_mut()
                .for_each(|axis| axis.fixed.range = Some(axis.fixed.range.map_or(range, |old| old.min(range))));
            true
        }),
        "g_sensitivity" => {
            let m: Vec<Vec<f64>> = of("m").and_then(|m| serde_json::from_value(m.clone()).ok()).unwrap_or_default();
            let entry = |row: usize, column: usize| m.get(row).and_then(|row| row.get(column)).copied().unwrap_or(0.0);
            let beside = (0..3).any(|row| (0..3).any(|column| row != column && entry(row, column) != 0.0));
            if beside || axes.iter().any(|axis| axis.fixed.acceleration.is_some()) {
                return false;
            }
            axes.iter_mut().enumerate().for_each(|(row, axis)| axis.fixed.acceleration = Some(entry(row, row)));
            true
        }
        _ => false,
    }
}

/// Returns a comment in lines of at most a hundred characters, each after `mark`.
fn comment(mark: &str, text: &str) -> String {
    const WIDTH: usize = 100;
    let (mut lines, mut line) = (String::new(), String::new());
    for word in text.split_whitespace() {
        if !line.is_empty() && mark.chars().count() + line.chars().count() + 1 + word.chars().count() > WIDTH {
            lines.push_str(&format!("{mark}{line}\n"));
            line.clear();
        }
        line.push_str(if line.is_empty() { "" } else { " " });
        line.push_str(word);
    }
    lines + mark + &line + "\n"
}

/// Returns a rate or a time in words, to the thousandth.
fn short(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

/// Returns a name that does not end a comment.
fn harmless(name: &str) -> String {
    name.chars().map(|c| if c.is_control() || "<>-\"'".contains(c) { '_' } else { c }).collect()
}

/// Returns `x, y, z` of a parameter in words.
fn each(axes: [Known; 3]) -> String {
    axes.map(Known::words).join(", ")
}

/// Returns the addition to a comment if a number is a limit; empty if all are measured.
fn limits(axes: [Known; 3]) -> String {
    let limited = ["x", "y", "z"].into_iter().zip(axes).filter(|(_, known)| matches!(known, Known::Below(_)));
    let letters: Vec<&str> = limited.map(|(letter, _)| letter).collect();
    if letters.is_empty() {
        return String::new();
    }
    format!("; {}: not identified, from the 95 % upper limit", letters.join(", "))
}

/// Returns the largest of the axes, limits included.
fn largest(axes: [Known; 3]) -> Known {
    let larger = |one: Known, other: Known| if other.bound() > one.bound() { other } else { one };
    axes.into_iter().fold(Known::Nothing, larger)
}
