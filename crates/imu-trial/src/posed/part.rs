//! Parts: stretches of a recording with their models and the numbers that poses show of the sensor in them.

use crate::motion::Kind;
use crate::motion::kind::Planned;
use imu_core::sample::Triad;
use imu_diagnosis::{CERTAIN, Recording};
use imu_model::simulator::SensorModel;
use imu_pose::{Calibration, Estimate, TriadFit};
use serde::{Deserialize, Serialize};

/// A number with half of its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Number {
    /// The value.
    pub value: f64,
    /// Half of the interval's width.
    pub half: f64,
}

impl Number {
    fn of(estimate: &Estimate) -> Self {
        Self { value: estimate.value, half: estimate.half() }
    }

    /// Returns by how much the number has to change before the diagnosis names it.
    pub fn limit(&self) -> f64 {
        CERTAIN * self.half
    }
}

/// The numbers of a triad; what the motion does not determine is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Numbers {
    /// Scale factors of x, y, z.
    pub scale: [Option<Number>; 3],
    /// Cross-axis sensitivity of xy, xz, yz.
    pub cross: [Option<Number>; 3],
    /// Bias of x, y, z.
    pub bias: [Option<Number>; 3],
    /// Latency, s; `None` if sensor and reference are on two clocks.
    pub latency: Option<Number>,
}

impl Numbers {
    fn of(fit: &TriadFit, is_one_clock: bool) -> Self {
        let all = |of: &[Option<Estimate>; 3]| of.map(|one| one.as_ref().map(Number::of));
        Self {
            scale: all(&fit.scale),
            cross: all(&fit.cross),
            bias: all(&fit.bias),
            latency: (is_one_clock && fit.is_timed).then(|| Number::of(&fit.later_s)),
        }
    }

    /// Returns the numbers that an effect of a kind changes.
    pub fn of_kind(&self, kind: Kind) -> Vec<Option<Number>> {
        match kind {
            Kind::ScaleFactor => self.scale.to_vec(),
            Kind::CrossAxisSensitivity => self.cross.to_vec(),
            Kind::Bias => self.bias.to_vec(),
            Kind::Latency => vec![self.latency],
            _ => Vec::new(),
        }
    }
}

/// What a part shows without any imposed effect.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Own {
    /// The numbers of the gyroscope.
    pub gyro: Numbers,
    /// The numbers of the accelerometer, if it can be compared.
    pub accel: Option<Numbers>,
    /// The verdict under the part's model.
    pub verdict: String,
    /// The causes that are named under it nevertheless, in the form of a diagnosis.
    pub named: Vec<serde_json::Value>,
}

impl Own {
    /// Creates what a part shows of itself.
    pub fn new(found: &Calibration, verdict: String, named: Vec<serde_json::Value>) -> Self {
        let is_one_clock = found.gyro.is_timed && found.is_one_clock(CERTAIN);
        Self {
            gyro: Numbers::of(&found.gyro, is_one_clock),
            accel: found.accel.as_ref().map(|fit| Numbers::of(fit, is_one_clock)),
            verdict,
            named,
        }
    }

    /// Returns the numbers of a triad.
    pub fn of(&self, triad: Triad) -> Option<&Numbers> {
        if triad == Triad::Gyro { Some(&self.gyro) } else { self.accel.as_ref() }
    }

    /// Returns the effects that can be imposed: those with at least one number that the poses determine.
    pub fn possible(&self) -> Vec<Planned> {
        const KINDS: [Kind; 4] = [Kind::Bias, Kind::ScaleFactor, Kind::CrossAxisSensitivity, Kind::Latency];
        let on = |kind: Kind| {
            let has =
                move |triad: &Triad| self.of(*triad).is_some_and(|of| of.of_kind(kind).iter().any(Option::is_some));
            [Triad::Gyro, Triad::Accel].into_iter().filter(has).map(move |triad| (kind, triad))
        };
        KINDS.into_iter().flat_map(on).collect()
    }
}

/// A part of a recording.
#[derive(Debug, Clone)]
pub struct Part {
    /// The samples.
    pub recording: Recording,
    /// The model under test: it has what the diagnosis names in the untouched part.
    pub model: SensorModel,
    /// What the part shows of itself.
    pub own: Own,
}
