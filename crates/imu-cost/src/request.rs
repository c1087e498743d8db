//! Requests: alignment, horizons, temperature, tolerances and a motion, checked and turned into samples.
//!
//! Refused with one sentence that names what was found and what is allowed ([`CostError`]): horizons that are not
//! positive or not in order, times without a sample or too long, unknown quantities and units in a tolerance, and models
//! without gyroscope and accelerometer.

use crate::weights::Span;
use imu_core::sample::Channel;
use imu_core::units::{RAD_PER_DEG, STANDARD_GRAVITY_M_S2, parse_duration};
use imu_model::effects::USUAL_TEMPERATURE_C;
use imu_model::motion::Temperatures;
use imu_model::simulator::{Motion, SensorModel, SimulatorError};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use strum::VariantArray as _;

/// The longest alignment and horizon together, in samples: 14 days at 800 Hz.
const SAMPLES_MAX: f64 = 1e9;
/// The most samples of one channel in all runs of a simulation: about ten minutes.
const WORK_MAX: f64 = 1e10;
/// The most rows of a motion: 13 hours at 40 Hz.
pub const MOTION_ROWS_MAX: usize = 2_000_000;
/// Runs of a Monte Carlo estimate: its standard deviation has a standard error of 3 %.
const RUNS: usize = 500;

/// An error quantity of unaided strapdown integration, x and y horizontal, z up. At rest a channel's axis is the world's;
/// along a motion the axes are those of the world.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    strum::Display,
    strum::EnumString,
    strum::VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Quantity {
    /// The integral of gyro_x's error, rad.
    AttitudeX,
    /// The integral of gyro_y's error, rad.
    AttitudeY,
    /// The integral of gyro_z's error, rad.
    Heading,
    /// The integral of accel_x's error and of g times `AttitudeY`, m/s.
    VelocityX,
    /// The integral of accel_y's error and of −g times `AttitudeX`, m/s.
    VelocityY,
    /// The integral of `VelocityX`, m.
    PositionX,
    /// The integral of `VelocityY`, m.
    PositionY,
}

/// A channel's part in a quantity: `factor` times the integral of `order` of its error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Share {
    pub channel: Channel,
    pub order: usize,
    pub factor: f64,
}

impl Quantity {
    /// Returns all quantities, in the order of a document.
    pub fn all() -> &'static [Self] {
        Self::VARIANTS
    }

    /// Returns the unit: `rad`, `m/s` or `m`.
    pub fn unit(self) -> &'static str {
        match self {
            Self::AttitudeX | Self::AttitudeY | Self::Heading => "rad",
            Self::VelocityX | Self::VelocityY => "m/s",
            Self::PositionX | Self::PositionY => "m",
        }
    }

    /// Returns the channels' parts: the own channel first, then the gyroscope that gravity couples in.
    pub(crate) fn shares(self) -> Vec<Share> {
        let own = |channel, order| Share { channel, order, factor: 1.0 };
        let tilt = |channel, order, sign: f64| Share { channel, order, factor: sign * STANDARD_GRAVITY_M_S2 };
        match self {
            Self::AttitudeX => vec![own(Channel::GyroX, 1)],
            Self::AttitudeY => vec![own(Channel::GyroY, 1)],
            Self::Heading => vec![own(Channel::GyroZ, 1)],
            Self::VelocityX => vec![own(Channel::AccelX, 1), tilt(Channel::GyroY, 2, 1.0)],
            Self::VelocityY => vec![own(Channel::AccelY, 1), tilt(Channel::GyroX, 2, -1.0)],
            Self::PositionX => vec![own(Channel::AccelX, 2), tilt(Channel::GyroY, 3, 1.0)],
            Self::PositionY => vec![own(Channel::AccelY, 2), tilt(Channel::GyroX, 3, -1.0)],
        }
    }

    /// Returns the quantities that a tolerance's name stands for: one by its own name, all axes of `attitude`,
    /// `velocity` and `position`.
    fn named(name: &str) -> Option<Vec<Self>> {
        match name {
            "attitude" => Some(vec![Self::AttitudeX, Self::AttitudeY]),
            "velocity" => Some(vec![Self::VelocityX, Self::VelocityY]),
            "position" => Some(vec![Self::PositionX, Self::PositionY]),
            _ => name.parse().ok().map(|own| vec![own]),
        }
    }

    /// Returns the size of a unit in the quantity's own.
    fn size_of(self, unit: &str) -> Option<f64> {
        match (self.unit(), unit) {
            ("rad", "rad") | ("m/s", "m/s") | ("m", "m") => Some(1.0),
            ("rad", "deg" | "°") => Some(RAD_PER_DEG),
            ("rad", "mrad") | ("m/s", "mm/s") | ("m", "mm") => Some(1e-3),
            ("m/s", "cm/s") | ("m", "cm") => Some(1e-2),
            ("m", "km") => Some(1e3),
            _ => None,
        }
    }

    /// Returns the units that a tolerance may have.
    fn units(self) -> &'static str {
        match self.unit() {
            "rad" => "deg, rad or mrad",
            "m/s" => "m/s, cm/s or mm/s",
            _ => "m, cm, mm or km",
        }
    }
}

/// The reason why a motion was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MotionRefusal {
    /// A motion has two rows or more, and not too many.
    #[error("the motion {name} has {found} rows up to the last horizon: expected from 2 to {MOTION_ROWS_MAX}")]
    Rows {
        /// The motion.
        name: String,
        /// Number of rows.
        found: usize,
    },
    /// A value is not a finite number.
    #[error("row {row} of the motion {name} has a value that is not a finite number")]
    Value {
        /// The motion.
        name: String,
        /// The row, from 1.
        row: usize,
    },
    /// The rate is not that of the model.
    #[error("{0}")]
    Rate(String),
    /// The motion does not begin with gravity alone.
    #[error("the motion {name} begins with a specific force of {found:.3} m/s²: expected 9.3 to 10.3 m/s², as at rest")]
    Start {
        /// The motion.
        name: String,
        /// Size of the first specific force, m/s².
        found: f64,
    },
    /// The motion ends before a time.
    #[error("the motion {name} ends after {length_s} s, before {found_s} s: expected a horizon within the motion")]
    Short {
        /// The motion.
        name: String,
        /// Its length, s.
        length_s: f64,
        /// The time, s.
        found_s: f64,
    },
    /// The simulation takes too long.
    #[error("{runs} simulations of {causes} causes over {found_s} s are too many: expected at most {most_s} s in all")]
    Work {
        /// The number of runs.
        runs: usize,
        /// The number of causes.
        causes: usize,
        /// Alignment and longest horizon, s.
        found_s: f64,
        /// The longest time for alignment and horizon, s.
        most_s: f64,
    },
    /// An error is not a finite number.
    #[error("{quantity} is no finite number along the motion: an effect or the motion is too large")]
    Infinite {
        /// The quantity.
        quantity: Quantity,
    },
}

/// The reason why a cost was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CostError {
    /// A horizon is not a time above 0.
    #[error("a horizon of {found} s: expected a time above 0, such as 10s")]
    Horizon {
        /// The given time, s.
        found: f64,
    },
    /// There is no horizon.
    #[error("no horizon: expected one or more times, such as 1s,10s,1min")]
    NoHorizon,
    /// Horizons are not in order.
    #[error("a horizon of {found} s after one of {before} s: expected times in increasing order")]
    Order {
        /// The horizon before, s.
        before: f64,
        /// The given horizon, s.
        found: f64,
    },
    /// The alignment is not a time above 0.
    #[error("an alignment of {found} s: expected a time above 0, such as 30s")]
    Align {
        /// The given time, s.
        found: f64,
    },
    /// A time is shorter than a sample.
    #[error("{found} s is shorter than a sample at {rate_hz} Hz: expected at least {least_s} s")]
    Short {
        /// The given time, s.
        found: f64,
        /// The model's rate, Hz.
        rate_hz: f64,
        /// The shortest time, s.
        least_s: f64,
    },
    /// Alignment and horizon have too many samples.
    #[error("{found} s at {rate_hz} Hz are too long: expected at most {most_s} s for alignment and horizon together")]
    Long {
        /// The given time, s.
        found: f64,
        /// The rate of the sensor's own samples, Hz.
        rate_hz: f64,
        /// The longest time, s.
        most_s: f64,
    },
    /// The model has too many effects to be computed beside other work.
    #[error(
        "the model has {found} effects with {lines} lines: expected at most {effects_max} with {lines_max} here; \
         use `vn100d cost --model`"
    )]
    Size {
        /// Effects.
        found: usize,
        /// Lines of combs, and one for each other effect.
        lines: usize,
        /// The most effects.
        effects_max: usize,
        /// The most lines.
        lines_max: usize,
    },
    /// A tolerance cannot be read.
    #[error("the tolerance `{found}`: expected {expected}")]
    Tolerance {
        /// The given text.
        found: String,
        /// What is allowed.
        expected: String,
    },
    /// A line of a file of tolerances cannot be read.
    #[error("line {line}: {error}")]
    Line {
        /// The line's number, from 1.
        line: usize,
        /// What is wrong with it.
        #[source]
        error: Box<CostError>,
    },
    /// A file of tolerances has none.
    #[error("there is no tolerance: expected a line such as heading=1deg/10min")]
    NoTolerance,
    /// A tolerance names a quantity that the model does not have.
    #[error("a tolerance of {quantity}, which the model does not have: expected one of {present}")]
    Absent {
        /// The quantity.
        quantity: Quantity,
        /// The quantities of the model.
        present: String,
    },
    /// The model has neither gyroscope nor accelerometer.
    #[error("the model has no channel that an integration uses: expected some of {expected}")]
    NoChannel {
        /// The channels.
        expected: String,
    },
    /// What has to be simulated takes too long.
    #[error(
        "{effect} has no closed form, and {runs} simulations of {found_s} s are too many: expected at most {most_s} s"
    )]
    Work {
        /// The effect and its channel.
        effect: String,
        /// The number of runs.
        runs: usize,
        /// Alignment and longest horizon, s.
        found_s: f64,
        /// The longest time for alignment and horizon, s.
        most_s: f64,
    },
    /// An effect has no closed form, and the request excludes simulations.
    #[error("{effect} has no closed form, and nothing is simulated here: expected an effect with one (docs/cost.md)")]
    NoClosedForm {
        /// The effect and its channel.
        effect: String,
    },
    /// The time since switch-on is negative or not a number.
    #[error("an alignment that begins at {found} s: expected a time from 0 s on, such as 600s")]
    Begin {
        /// The given time, s.
        found: f64,
    },
    /// The model cannot be simulated.
    #[error(transparent)]
    Model(#[from] SimulatorError),
    /// The motion cannot be used.
    #[error(transparent)]
    Motion(#[from] MotionRefusal),
}

/// A limit on a quantity's 95 % band at a horizon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// The quantity.
    pub quantity: Quantity,
    /// The largest 95 % band, in the quantity's unit.
    pub limit: f64,
    /// Time since the alignment's end, s.
    pub horizon_s: f64,
}

impl Tolerance {
    /// Reads `NAME=LIMIT/HORIZON`, such as `heading=1deg/10min`, several separated by commas. `attitude`, `velocity`
    /// and `position` are limits on each of two axes.
    ///
    /// # Errors
    /// [`CostError::Tolerance`] with the text and what is allowed.
    pub fn parse(text: &str) -> Result<Vec<Self>, CostError> {
        let lists: Vec<Vec<Self>> = text.split(',').map(Self::parse_one).collect::<Result<_, _>>()?;
        Ok(lists.concat())
    }

    /// Reads a file's text: a line for each limit (or several, as [`Self::parse`]), `#` before a remark.
    ///
    /// # Errors
    /// [`CostError::Line`] with the first line that cannot be read, [`CostError::NoTolerance`] if there is none.
    pub fn parse_lines(text: &str) -> Result<Vec<Self>, CostError> {
        let mut all = Vec::new();
        for (index, line) in text.trim_start_matches('\u{FEFF}').lines().enumerate() {
            let line = line.split('#').next().unwrap_or_default().trim();
            if !line.is_empty() {
                let refuse = |error| CostError::Line { line: index + 1, error: Box::new(error) };
                all.extend(Self::parse(line).map_err(refuse)?);
            }
        }
        if all.is_empty() { Err(CostError::NoTolerance) } else { Ok(all) }
    }

    fn parse_one(text: &str) -> Result<Vec<Self>, CostError> {
        let refuse = |expected: String| CostError::Tolerance { found: text.trim().to_owned(), expected };
        let form = || refuse("NAME=LIMIT/HORIZON, such as heading=1deg/10min or position=1m/10s".to_owned());
        let (name, rest) = text.trim().split_once('=').ok_or_else(form)?;
        let (limit, horizon) = rest.rsplit_once('/').ok_or_else(form)?;
        let quantities = Quantity::named(name.trim()).ok_or_else(|| {
            let names: Vec<String> = Quantity::all().iter().map(ToString::to_string).collect();
            refuse(format!("a quantity out of attitude, velocity, position, {}", names.join(", ")))
        })?;
        let horizon_s = parse_duration(horizon).map_err(|error| refuse(error.to_string()))?.as_secs_f64();
        let one = |quantity: &Quantity| {
            let units = || refuse(format!("a limit above 0 in {}", quantity.units()));
            let number = limit.trim().trim_end_matches(|c: char| c.is_alphabetic() || c == '/' || c == '°');
            let size = quantity.size_of(limit.trim()[number.len()..].trim()).ok_or_else(units)?;
            let value: f64 = number.trim().parse().map_err(|_| units())?;
            let limit = value * size;
            if !(limit.is_finite() && limit > 0.0) {
                return Err(units());
            }
            Ok(Self { quantity: *quantity, limit, horizon_s })
        };
        quantities.iter().map(one).collect()
    }
}

/// A motion along which errors grow.
#[derive(Debug, Clone, PartialEq)]
pub struct Along {
    /// The motion, as the caller names it.
    pub name: String,
    /// Rows per second: those of the model's samples, or of the sensor's own.
    pub rate_hz: f64,
    /// Angular rate in rad/s and specific force in m/s², in the sensor's axes, at most [`MOTION_ROWS_MAX`].
    pub rows: Arc<[Motion]>,
}

/// A request for a model's cost.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// Time from switch-on to the begin of the alignment, s: the model's own time there.
    pub begin_s: f64,
    /// Time over which the bias is taken as a mean, s; it ends at t = 0.
    pub align_s: f64,
    /// Times since the alignment's end, s, increasing.
    pub horizons_s: Vec<f64>,
    /// The sensor's temperature from switch-on on; without it, the temperature channel's bias, or 25 °C.
    pub temperature: Option<Temperatures>,
    /// Limits.
    pub tolerances: Vec<Tolerance>,
    /// The motion after the alignment; without one the sensor stays at rest.
    pub motion: Option<Along>,
    /// Whether what has no closed form is simulated. If not, its quantities are left out, and a note states why.
    pub simulate: bool,
    /// Runs of a Monte Carlo estimate, if an effect has no closed form.
    pub runs: usize,
    /// The seed of the first run.
    pub seed: u64,
}

impl Default for Request {
    fn default() -> Self {
        Self {
            begin_s: 0.0,
            align_s: 30.0,
            horizons_s: vec![1.0, 10.0, 60.0, 600.0, 3600.0],
            temperature: None,
            tolerances: Vec::new(),
            motion: None,
            simulate: true,
            runs: RUNS,
            seed: 1,
        }
    }
}

/// A checked request in samples of a model.
#[derive(Debug)]
pub(crate) struct Setting<'a> {
    pub model: &'a SensorModel,
    pub temperature: Temperatures,
    pub temperature_is_constant: bool,
    /// Rate of the sent samples, and of the sensor's own, Hz.
    pub rate_hz: f64,
    pub internal_hz: f64,
    /// Samples before the alignment.
    pub begin: u64,
    /// Samples of the alignment.
    pub align: u64,
    /// Samples of each horizon, increasing: those of the request and of its tolerances.
    pub horizons: Vec<u64>,
    pub simulate: bool,
    pub runs: usize,
    pub seed: u64,
}

impl<'a> Setting<'a> {
    /// Checks the request against the model.
    pub(crate) fn new(request: &Request, model: &'a SensorModel) -> Result<Self, CostError> {
        let positive = |value: f64| value.is_finite() && value > 0.0;
        if !(request.begin_s.is_finite() && request.begin_s >= 0.0) {
            return Err(CostError::Begin { found: request.begin_s });
        }
        if !positive(request.align_s) {
            return Err(CostError::Align { found: request.align_s });
        }
        if request.horizons_s.is_empty() {
            return Err(CostError::NoHorizon);
        }
        let limits_s = request.tolerances.iter().map(|tolerance| tolerance.horizon_s);
        let all_s = request.horizons_s.iter().copied().chain(limits_s);
        if let Some(found) = all_s.clone().find(|horizon_s| !positive(*horizon_s)) {
            return Err(CostError::Horizon { found });
        }
        if let Some(pair) = request.horizons_s.windows(2).find(|pair| pair[0] >= pair[1]) {
            return Err(CostError::Order { before: pair[0], found: pair[1] });
        }
        let (rate_hz, internal_hz) = (model.rate_hz, model.internal_rate_hz(model.rate_hz));
        let longest_s = all_s.clone().fold(0.0, f64::max) + request.align_s + request.begin_s;
        if longest_s * internal_hz > SAMPLES_MAX {
            let most_s = SAMPLES_MAX / internal_hz;
            return Err(CostError::Long { found: longest_s, rate_hz: internal_hz, most_s });
        }
        let samples = |time_s: f64| match (time_s * rate_hz).round() {
            count if count >= 1.0 => Ok(count as u64),
            _ => Err(CostError::Short { found: time_s, rate_hz, least_s: 1.0 / rate_hz }),
        };
        let mut horizons: Vec<u64> = all_s.map(samples).collect::<Result<_, _>>()?;
        horizons.sort_unstable();
        horizons.dedup();
        let rest_c = model.channels.get(&Channel::Temperature).and_then(|channel| channel.bias);
        let temperature = request
            .temperature
            .clone()
            .unwrap_or_else(|| Temperatures::constant(rest_c.unwrap_or(USUAL_TEMPERATURE_C)));
        Ok(Self {
            model,
            temperature_is_constant: request.temperature.is_none() || temperature.is_constant(),
            temperature,
            rate_hz,
            internal_hz,
            begin: (request.begin_s * rate_hz).round() as u64,
            align: samples(request.align_s)?,
            horizons,
            simulate: request.simulate,
            runs: request.runs.max(2),
            seed: request.seed,
        })
    }

    /// Returns the samples of alignment and longest horizon.
    pub(crate) fn samples(&self) -> u64 {
        self.align + self.horizons.last().copied().unwrap_or(1)
    }

    /// Checks whether an effect on a channel can be simulated in a bearable time.
    ///
    /// # Errors
    /// [`CostError::Work`] with the longest time that can.
    pub(crate) fn check_work(&self, effect: &str, channel: Channel) -> Result<(), CostError> {
        self.check_runs(effect, channel, self.runs)
    }

    /// Checks whether an effect on a channel can be simulated that often in a bearable time.
    ///
    /// # Errors
    /// [`CostError::Work`] with the longest time that can.
    pub(crate) fn check_runs(&self, effect: &str, channel: Channel, runs: usize) -> Result<(), CostError> {
        if !self.simulate {
            return Err(CostError::NoClosedForm { effect: format!("{effect} on {channel}") });
        }
        let samples = (self.begin + self.samples()) as f64 * self.ratio() as f64 * runs as f64;
        if samples <= WORK_MAX {
            return Ok(());
        }
        let found_s = self.record_s();
        Err(CostError::Work {
            effect: format!("{effect} on {channel}"),
            runs,
            found_s,
            most_s: (found_s * WORK_MAX / samples).floor(),
        })
    }

    /// Returns the time from switch-on to the end of the longest horizon, s.
    pub(crate) fn record_s(&self) -> f64 {
        (self.begin + self.samples()) as f64 / self.rate_hz
    }

    /// Returns the samples of alignment and horizon, for each horizon.
    pub(crate) fn spans(&self) -> Vec<Span> {
        let of = |horizon: &u64| Span { align: self.align as f64, horizon: *horizon as f64 };
        self.horizons.iter().map(of).collect()
    }

    /// Returns the place of a horizon among [`Setting::horizons`].
    pub(crate) fn place(&self, horizon_s: f64) -> usize {
        let samples = (horizon_s * self.rate_hz).round() as u64;
        self.horizons.partition_point(|horizon| *horizon < samples).min(self.horizons.len() - 1)
    }

    /// Returns the sensor's own samples per sent one.
    pub(crate) fn ratio(&self) -> usize {
        self.model.sampling.and_then(|sampling| sampling.decimation(self.rate_hz)).unwrap_or(1)
    }

    /// Returns the number of the sensor's own samples that a sent one averages.
    pub(crate) fn window(&self) -> u64 {
        self.model.sampling.map_or(1, |sampling| sampling.filter_window.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(text: &str) -> String {
        Tolerance::parse(text).unwrap_err().to_string()
    }

    #[test]
    fn tolerances_are_read_with_their_units() {
        let read = Tolerance::parse("heading=1deg/10min, velocity=5cm/s/1m").unwrap();
        let (own, limit, horizon_s) = (Quantity::Heading, RAD_PER_DEG, 600.0);
        assert_eq!(read[0], Tolerance { quantity: own, limit, horizon_s });
        assert_eq!(read[1], Tolerance { quantity: Quantity::VelocityX, limit: 0.05, horizon_s: 60.0 });
        assert_eq!((read.len(), read[2].quantity), (3, Quantity::VelocityY));
        assert_eq!(Tolerance::parse("position_y=1.5km/1h").unwrap()[0].limit, 1500.0);
    }

    #[test]
    fn a_file_has_a_limit_per_line_and_errors_have_the_line() {
        let read = Tolerance::parse_lines("# hold\r\nheading=1deg/10min # of the robot\n\nposition=1m/10s\n").unwrap();
        assert_eq!(read.len(), 3);
        let error = Tolerance::parse_lines("heading=1deg/10min\n\nyaw=1deg/1s").unwrap_err().to_string();
        assert!(error.starts_with("line 3: the tolerance `yaw=1deg/1s`"), "{error}");
        assert_eq!(Tolerance::parse_lines("# none\n"), Err(CostError::NoTolerance));
    }

    #[test]
    fn what_is_no_tolerance_is_refused_with_what_is_allowed() {
        assert!(refusal("yaw=1deg/10min").contains("attitude, velocity, position, attitude_x"));
        assert!(refusal("heading=1m/10min").contains("in deg, rad or mrad"));
        assert!(refusal("heading=-1deg/10min").contains("above 0"));
        assert!(refusal("heading=1deg").contains("heading=1deg/10min"));
        assert!(refusal("heading").contains("NAME=LIMIT/HORIZON"));
        assert!(refusal("heading=1deg/10").contains("not a duration"));
        assert!(refusal("heading=deg/10s").contains("above 0"));
    }
}
