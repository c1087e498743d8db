//! Noise parameters of one channel in the form of docs/formats.md: with units, intervals, and the parameters that the
//! data does not support.

use super::term::Term;
use imu_core::sample::{Channel, Triad};
use imu_core::units::counted;
use imu_core::units::{
    MICROTESLA_PER_GAUSS as UT, RAD_PER_DEG, SECONDS_PER_HOUR, SQRT_SECONDS_PER_SQRT_HOUR as SQRT_HOUR,
    STANDARD_GRAVITY_M_S2,
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One parameter: identified, with value and interval, or not identified, with an upper limit if there is one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Estimate {
    /// The value in `unit`; null if the data does not support one.
    pub value: Option<f64>,
    /// 95 % interval of the value.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
    /// The upper limit of the value with 95 % confidence; only if it is not identified.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub upper_limit95: Option<f64>,
    /// Whether the data supports a value (1 % level, some terms stricter).
    pub identified: bool,
    /// Unit of value, interval and limit.
    pub unit: String,
    /// The value in commonly quoted units.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub also: BTreeMap<String, f64>,
    /// Only for N: the sensor's own density before its filter and decimation, if these are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub internal: Option<f64>,
    /// The source of the number if it is not the fit: `allan deviation` if the fit contradicts the measured curve.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
}

impl Estimate {
    /// Returns a value with its 95 % interval.
    pub fn identified(channel: Channel, term: Term, value: f64, ci95: [f64; 2]) -> Self {
        let also = quoted(channel, term).iter().map(|(unit, factor)| ((*unit).to_owned(), value * factor)).collect();
        Self {
            value: Some(value),
            ci95: Some(ci95),
            upper_limit95: None,
            identified: true,
            unit: unit(channel, term),
            also,
            internal: None,
            source: None,
        }
    }

    /// Returns a value with its 95 % interval in its own unit.
    pub fn of(unit: &str, value: f64, ci95: [f64; 2]) -> Self {
        Self {
            value: Some(value),
            ci95: Some(ci95),
            upper_limit95: None,
            identified: true,
            unit: unit.to_owned(),
            also: BTreeMap::new(),
            internal: None,
            source: None,
        }
    }

    /// Creates a parameter without a value, with an upper limit if the data sets one.
    pub fn unidentified(channel: Channel, term: Term, upper_limit95: Option<f64>) -> Self {
        Self {
            value: None,
            ci95: None,
            upper_limit95,
            identified: false,
            unit: unit(channel, term),
            also: BTreeMap::new(),
            internal: None,
            source: None,
        }
    }
}

/// A first-order Gauss–Markov process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct GaussMarkov {
    /// The standard deviation, in the channel's unit.
    pub sigma: Estimate,
    /// The correlation time, s.
    pub tc_s: Estimate,
}

/// The filter that keeps noise away from half the rate: a filter of the sensor or of the recording program.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Bandwidth {
    /// `moving_average`, `low_pass` or `other`.
    pub kind: String,
    /// The length, or the −3 dB frequency; null if an `other` shape does not fall that far.
    pub value: Option<f64>,
    /// Unit of value and interval: `samples`, `samples at the internal rate` or `Hz`.
    pub unit: String,
    /// Order of a low pass.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub order: Option<u32>,
    /// 95 % interval of the value; null for a whole number.
    pub ci95: Option<[f64; 2]>,
    /// Frequencies above this were not described and took no part in the fit, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up_to_hz: Option<f64>,
    /// Density of white noise that enters behind the filter, U/√Hz; a part of N.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub white_behind: Option<f64>,
    /// For a known sampling: the rate of the samples of a moving average, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub internal_rate_hz: Option<f64>,
    /// Whether a low pass of order 1 is an exponential average, y += a (x − y), rather than Butterworth's.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub exponential: bool,
    /// The source of this knowledge: a register, an option, or `fitted`.
    pub source: String,
}

/// The method of the fit, and whether the model describes the data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FitSummary {
    /// `whittle-dst`: the Whittle likelihood of the sine transform of the differences, for samples in memory;
    /// `wls-avar`: weighted least squares on Allan variances with the model's own covariance, for a running capture.
    pub method: String,
    /// Squared residuals in units of their covariance; null if no fit was possible.
    pub chi2: Option<f64>,
    /// Bands of frequency, or averaging times, whose correlations count through the covariance, less parameters.
    pub degrees_of_freedom: Option<usize>,
    /// How often residuals as large occur by chance.
    pub p_value: Option<f64>,
    /// The fitted Allan deviation and the contribution of each term.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub curve: Option<FittedCurve>,
}

impl FitSummary {
    /// Creates the summary. `residual` has χ², its degrees of freedom and its p-value.
    pub(crate) fn of(method: &str, residual: Option<(f64, usize, f64)>, curve: Option<FittedCurve>) -> Self {
        Self {
            method: method.to_owned(),
            chi2: residual.map(|(chi2, ..)| chi2),
            degrees_of_freedom: residual.map(|(_, degrees, _)| degrees),
            p_value: residual.map(|(.., p_value)| p_value),
            curve,
        }
    }
}

/// The Allan deviation of a fitted model, for plots; all lists have one entry per averaging time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FittedCurve {
    /// Averaging times τ in s: octaves up to a quarter of the longest stretch.
    pub tau_s: Vec<f64>,
    /// Deviation of the whole model.
    pub deviation: Vec<f64>,
    /// Deviation of each term alone: `N`, `B`, `K`, `Q`, `R`, `gauss_markov`. The sum of their squares is the square of
    /// the whole.
    pub parts: BTreeMap<String, Vec<f64>>,
}

impl FittedCurve {
    /// Returns the averaging factors of a fitted curve.
    pub(crate) fn octaves(longest_s: f64, dt_s: f64) -> Vec<usize> {
        let quarter = longest_s / dt_s / 4.0;
        (0..48).map(|octave| 1usize << octave).take_while(|m| *m as f64 <= quarter.max(1.0)).collect()
    }

    /// Returns the curve of named variances as functions of the averaging factor, at these factors.
    pub(crate) fn at<'a>(
        factors: Vec<usize>,
        dt_s: f64,
        parts: impl Iterator<Item = (&'a str, Box<dyn Fn(usize) -> f64 + 'a>)>,
    ) -> Self {
        let mut variances = vec![0.0; factors.len()];
        let mut curve = Self {
            tau_s: factors.iter().map(|m| *m as f64 * dt_s).collect(),
            deviation: Vec::new(),
            parts: BTreeMap::new(),
        };
        for (name, variance) in parts {
            let own: Vec<f64> = factors.iter().map(|m| variance(*m)).collect();
            for (sum, own) in variances.iter_mut().zip(&own) {
                *sum += own;
            }
            curve.parts.insert(name.to_owned(), own.iter().map(|variance| variance.sqrt()).collect());
        }
        curve.deviation = variances.iter().map(|variance| variance.sqrt()).collect();
        curve
    }
}

/// Returns the Allan variance at averaging factor `m` of the samples of a Gauss–Markov process with σ = 1 whose
/// correlation time is 1/`decay` samples.
///
/// The samples are an AR(1) sequence with φ = e^(−decay). A sum of m of them has the variance m (1 + φ)/(1 − φ) − 2 φ
/// (1 − φᵐ)/(1 − φ)².
///
/// # Source
/// IEEE Std 952-1997, annex C, has the value for a process that is averaged without sampling: 2/3 of this at m = 1.
///
/// # Validation
/// `a_sampled_processs_variance_is_that_of_its_covariance`, by summing covariances.
pub fn gauss_markov_variance(m: usize, decay: f64) -> f64 {
    let count = m as f64;
    let (phi, rest) = ((-decay).exp(), -(-decay).exp_m1());
    let x = count * decay;
    if x < 1e-5 {
        // The variance of a random walk with the same steps, for which differences would lose their digits.
        return rest * (1.0 + phi) * (2.0 * count * count + 1.0) / (6.0 * count);
    }
    let sum = |count: f64| count * (1.0 + phi) / rest + 2.0 * phi * (-count * decay).exp_m1() / (rest * rest);
    (4.0 * sum(count) - sum(2.0 * count)) / (2.0 * count * count)
}

/// A remark about a channel's data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Flag {
    /// `insufficient`, `constant`, `misfit`, `out_of_range`, …
    pub kind: String,
    /// The start, s from the start of the capture; absent if the flag concerns the whole capture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_s: Option<f64>,
    /// The end, s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to_s: Option<f64>,
    /// The remark in one sentence.
    pub note: String,
}

impl Flag {
    /// Creates a flag that concerns the whole capture.
    pub fn whole(kind: &str, note: impl Into<String>) -> Self {
        Self { kind: kind.to_owned(), from_s: None, to_s: None, note: note.into() }
    }

    /// Returns the flag `out_of_range` if `samples` values were not measurements; `None` if there were none.
    pub fn out_of_range(channel: Channel, samples: u64) -> Option<Self> {
        let note = || {
            format!(
                "{} beyond what a {channel} can measure left out; each ended a stretch",
                counted(samples, "value", "values")
            )
        };
        (samples > 0).then(|| Self::whole("out_of_range", note()))
    }

    /// Returns the flag `other_rate` if `samples` samples came at another rate than the analysed one; `None` if there
    /// were none.
    pub fn other_rate(rate_hz: f64, samples: u64) -> Option<Self> {
        let note = || format!("{} at another rate than {rate_hz} Hz left out", counted(samples, "sample", "samples"));
        (samples > 0).then(|| Self::whole("other_rate", note()))
    }
}

/// Times at rest without a gap after which a parameter is known to ±20 % (95 %), s. Null if the record does not
/// identify the parameter, so that its size is unknown, and beyond 1000 h.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RecordNeeded {
    /// The time for bias instability.
    #[serde(rename = "B")]
    pub b: Option<f64>,
    /// The time for rate random walk.
    #[serde(rename = "K")]
    pub k: Option<f64>,
}

/// The noise parameters of one channel (docs/formats.md; names of IEEE Std 952).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct NoiseParameters {
    /// The channel's unit.
    pub unit: String,
    /// N: angle or velocity random walk.
    #[serde(rename = "N")]
    pub n: Estimate,
    /// B: bias instability, the coefficient of flicker noise, neither divided nor multiplied by 0.664.
    #[serde(rename = "B")]
    pub b: Estimate,
    /// K: rate random walk.
    #[serde(rename = "K")]
    pub k: Estimate,
    /// Q: quantization noise.
    #[serde(rename = "Q")]
    pub q: Estimate,
    /// R: rate ramp, with its sign; for a running capture, its size only.
    #[serde(rename = "R")]
    pub r: Estimate,
    /// Gauss–Markov process; null if there is none.
    pub gauss_markov: Option<GaussMarkov>,
    /// The filter that acts on B, K, Q, R and the process; null if noise is white up to half the rate.
    #[serde(default)]
    pub bandwidth: Option<Bandwidth>,
    /// Whether the parameters may be used: false if they contradict the measured deviation, or if there are none.
    #[serde(default = "yes")]
    pub usable: bool,
    /// Why they may not be used.
    #[serde(default)]
    pub reason: Option<String>,
    /// Lowest point of the measured Allan deviation; null if it is not known well enough.
    #[serde(default)]
    pub minimum: Option<Minimum>,
    /// How long the sensor has to be at rest, without a gap, until B and K are known to ±20 %, s.
    #[serde(default)]
    pub record_needed: RecordNeeded,
    /// If no walk is identified: the averaging time, s, from which on a walk as large as the limit of K would rise
    /// above the lowest deviation with a slope of +½.
    #[serde(default)]
    pub walk_shows_beyond_s: Option<f64>,
    /// The fit.
    pub fit: FitSummary,
    /// Further remarks.
    pub flags: Vec<Flag>,
}

impl NoiseParameters {
    /// Returns usable parameters with an estimate of each term, without values that are computed elsewhere.
    pub(crate) fn of(channel: Channel, estimate: impl Fn(Term) -> Estimate, fit: FitSummary, flags: Vec<Flag>) -> Self {
        Self {
            unit: channel.unit().to_owned(),
            n: estimate(Term::N),
            b: estimate(Term::B),
            k: estimate(Term::K),
            q: estimate(Term::Q),
            r: estimate(Term::R),
            gauss_markov: None,
            bandwidth: None,
            usable: true,
            reason: None,
            minimum: None,
            record_needed: RecordNeeded::default(),
            walk_shows_beyond_s: None,
            fit,
            flags,
        }
    }
}

/// Earlier documents do not have this key.
fn yes() -> bool {
    true
}

/// The lowest point of a measured Allan deviation beside B.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Minimum {
    /// The deviation, in the channel's unit.
    pub deviation: f64,
    /// The averaging time of the deviation, s.
    pub tau_s: f64,
    /// The deviation over 0.664. B is at most this, within the scatter of the curve, because the curve includes all
    /// other noise.
    pub over_0_664: f64,
}

impl NoiseParameters {
    /// Withholds the parameters for a reason, and clears the values that follow from them.
    pub fn refuse(&mut self, reason: String) {
        (self.usable, self.reason) = (false, Some(reason));
        (self.record_needed, self.walk_shows_beyond_s) = (RecordNeeded::default(), None);
    }

    /// Returns the estimate of a term.
    pub fn estimate(&self, term: Term) -> &Estimate {
        match term {
            Term::N => &self.n,
            Term::B => &self.b,
            Term::K => &self.k,
            Term::Q => &self.q,
            Term::R => &self.r,
        }
    }
}

/// Returns the unit of a term's coefficient.
pub fn unit(channel: Channel, term: Term) -> String {
    let u = channel.unit();
    match term {
        Term::N => format!("{u}/√Hz"),
        Term::B => u.to_owned(),
        Term::K => format!("{u}/√s"),
        Term::Q if channel.triad() == Some(Triad::Gyro) => "rad".to_owned(),
        Term::Q if channel.triad() == Some(Triad::Accel) => "m/s".to_owned(),
        Term::Q => format!("{u}·s"),
        Term::R => format!("{u}/s"),
    }
}

/// Returns the commonly quoted units with their factors from the SI unit.
fn quoted(channel: Channel, term: Term) -> &'static [(&'static str, f64)] {
    const DEG: f64 = 1.0 / RAD_PER_DEG;
    const MG: f64 = 1e3 / STANDARD_GRAVITY_M_S2;
    const UG: f64 = 1e6 / STANDARD_GRAVITY_M_S2;
    match (channel.triad(), term) {
        (Some(Triad::Gyro), Term::N) => &[("deg/√h", DEG * SQRT_HOUR), ("deg/s/√Hz", DEG)],
        (Some(Triad::Gyro), Term::B) => &[("deg/h", DEG * SECONDS_PER_HOUR)],
        (Some(Triad::Gyro), Term::K) => &[("deg/h/√h", DEG * SECONDS_PER_HOUR * SQRT_HOUR)],
        (Some(Triad::Gyro), Term::Q) => &[("arcsec", DEG * 3600.0)],
        (Some(Triad::Gyro), Term::R) => &[("deg/h/h", DEG * SECONDS_PER_HOUR * SECONDS_PER_HOUR)],
        (Some(Triad::Accel), Term::N) => &[("m/s/√h", SQRT_HOUR), ("µg/√Hz", UG)],
        (Some(Triad::Accel), Term::B) => &[("mg", MG)],
        (Some(Triad::Accel), Term::K) => &[("mg/√h", MG * SQRT_HOUR)],
        (Some(Triad::Accel), Term::R) => &[("mg/h", MG * SECONDS_PER_HOUR)],
        (Some(Triad::Mag), Term::N) => &[("µT/√Hz", UT), ("µgauss/√Hz", 1e6)],
        (Some(Triad::Mag), Term::B) => &[("µT", UT)],
        _ => &[],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sampled_processs_variance_is_that_of_its_covariance() {
        for decay in [1e-7, 1e-5, 1e-3, 0.02, 0.3, 2.0] {
            for m in [1_usize, 2, 7, 64] {
                let weight = |at: usize| if at < m { -1.0 } else { 1.0 };
                let mut sum = 0.0;
                for one in 0..2 * m {
                    for other in 0..2 * m {
                        // Less the variance itself, which the weights cancel, so that digits are kept.
                        sum += weight(one) * weight(other) * (-(one.abs_diff(other) as f64) * decay).exp_m1();
                    }
                }
                let expected = sum / (2.0 * (m * m) as f64);
                let found = gauss_markov_variance(m, decay);
                assert!((found / expected - 1.0).abs() < 2e-5, "{decay} {m}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn an_identified_parameter_is_written_as_documented() {
        let estimate = Estimate::identified(Channel::GyroX, Term::N, 1.2e-4, [1.19e-4, 1.21e-4]);
        let written = serde_json::to_value(&estimate).unwrap();
        assert_eq!(written["value"], 1.2e-4);
        assert_eq!(written["ci95"], serde_json::json!([1.19e-4, 1.21e-4]));
        assert_eq!(written["identified"], true);
        assert_eq!(written["unit"], "rad/s/√Hz");
        let quoted = written["also"]["deg/√h"].as_f64().unwrap();
        assert!((quoted - 0.4125).abs() < 1e-3, "{quoted}");
        assert!(written.get("upper_limit95").is_none());
    }

    #[test]
    fn an_unidentified_parameter_is_null_with_a_limit() {
        assert_eq!(
            serde_json::to_value(Estimate::unidentified(Channel::GyroX, Term::K, Some(3e-7))).unwrap(),
            serde_json::json!({ "value": null, "upper_limit95": 3e-7, "identified": false, "unit": "rad/s/√s" })
        );
    }

    #[test]
    fn quoted_units_are_those_of_the_handbooks() {
        let also = |channel, term, value: f64| Estimate::identified(channel, term, value, [0.0, 1.0]).also;
        // Bias instability of 5.36 °/h, 210 µg/√Hz, 0.112 mg, 1 (deg/h)/√h.
        assert!((also(Channel::GyroX, Term::B, 2.6e-5)["deg/h"] - 5.363).abs() < 1e-3);
        assert!((also(Channel::AccelX, Term::N, 0.0021)["µg/√Hz"] - 214.14).abs() < 1e-2);
        assert!((also(Channel::AccelX, Term::N, 0.0021)["m/s/√h"] - 0.126).abs() < 1e-12);
        assert!((also(Channel::AccelX, Term::B, 0.0011)["mg"] - 0.112_17).abs() < 1e-5);
        let k = RAD_PER_DEG / 3600.0 / 60.0;
        assert!((also(Channel::GyroX, Term::K, k)["deg/h/√h"] - 1.0).abs() < 1e-12);
        assert!((also(Channel::MagX, Term::N, 140e-6)["µgauss/√Hz"] - 140.0).abs() < 1e-9);
    }
}
