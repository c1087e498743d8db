//! The comparison: per channel the density and the Allan minimum beside the printed figures, with a verdict.

use super::{Datasheet, Figures, FilterWindows, RateError, Sampling};
use crate::NoiseReport;
use imu_core::sample::{Channel, Triad};
use imu_core::units::{Dimension, Quantity};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The verdict on a figure or a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Not above the printed figure.
    Within,
    /// Above the figure, but by no more than filter window and output rate explain.
    ExplainedBySampling,
    /// The deviation still falls at the end of the record, so that there is no lowest point.
    TooShort,
    /// Above the figure, by more than sampling explains.
    Above,
    /// The sensor moved all the time.
    NotAtRest,
}

impl Verdict {
    /// Returns the verdict in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Within => "within",
            Self::ExplainedBySampling => "explained by sampling",
            Self::TooShort => "too short to tell",
            Self::NotAtRest => "not at rest",
            Self::Above => "above",
        }
    }
}

/// The measured values of one channel, in the channel's unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Measured {
    /// Noise density N with its 95 % interval; `None` if it is not identified.
    pub density: Option<(f64, [f64; 2])>,
    /// Lowest Allan deviation and its averaging time in s, with the lower end of its 68 % interval.
    pub minimum: Option<(f64, f64, f64)>,
    /// Time for which the sensor was at rest, s; `None` if unknown.
    pub at_rest_s: Option<f64>,
    /// Whether the sensor moved all the time.
    pub not_at_rest: bool,
}

impl Measured {
    /// Returns a report's values for a channel.
    pub fn of(report: &NoiseReport, channel: Channel) -> Self {
        let n = report.channels.get(&channel).map(|found| &found.n);
        let minimum = report.disturbances.get(&channel).and_then(|about| about.allan_minimum);
        Self {
            density: n.and_then(|n| n.value.zip(n.ci95)),
            minimum: minimum.map(|at| (at.deviation, at.tau_s, at.ci68_low)),
            at_rest_s: Some(report.at_rest_s.unwrap_or(report.duration_s)),
            not_at_rest: report
                .channels
                .get(&channel)
                .is_some_and(|found| found.flags.iter().any(|flag| flag.kind == "not_at_rest")),
        }
    }
}

/// Noise density, measured and printed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct DensityComparison {
    /// The measured density, in `unit`.
    pub measured: f64,
    /// The 95 % interval of `measured`.
    pub ci95: [f64; 2],
    /// The sensor's own density, as printed.
    pub datasheet: f64,
    /// The text in the datasheet.
    pub printed: String,
    /// Factor by which filter window and output rate change the density.
    pub sampling_factor: f64,
    /// The predicted density of this capture, if the printed density is two-sided (ARW = 60·D).
    pub predicted: f64,
    /// The predicted density if the printed density is one-sided: smaller by √2.
    pub predicted_one_sided: f64,
    /// The measured density over the printed one.
    pub ratio: f64,
    /// The measured density over the predicted one.
    pub ratio_to_predicted: f64,
    /// Unit of all densities.
    pub unit: String,
    /// The verdict.
    pub verdict: Verdict,
}

/// Bias stability in run, measured as the lowest Allan deviation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct BiasComparison {
    /// Lowest Allan deviation, in `unit`.
    pub allan_minimum: f64,
    /// Averaging time of the lowest deviation, s.
    pub tau_s: f64,
    /// The printed limit.
    pub datasheet: f64,
    /// The text in the datasheet.
    pub printed: String,
    /// The minimum without the white noise that sampling folded in.
    pub without_folded_noise: f64,
    /// Minimum over limit.
    pub ratio: f64,
    /// How long the sensor has to be at rest for a verdict, s, if the record is too short for one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub needed_s: Option<f64>,
    /// Unit of all deviations.
    pub unit: String,
    /// The verdict.
    pub verdict: Verdict,
}

/// The comparison of one channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ChannelComparison {
    /// The noise density; null if the capture does not show it.
    pub noise_density: Option<DensityComparison>,
    /// The bias stability; null if the capture does not show it or the datasheet does not have it.
    pub bias_stability: Option<BiasComparison>,
    /// The worse of the two.
    pub verdict: Verdict,
}

/// The comparison of a capture with a datasheet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Comparison {
    /// Name of the datasheet.
    pub name: String,
    /// Edition and source of the datasheet.
    pub source: String,
    /// How the samples were made.
    pub sampling: Sampling,
    /// Every channel that capture and datasheet have.
    pub channels: BTreeMap<Channel, ChannelComparison>,
}

/// Compares a capture with a datasheet. Channels for which neither figure is known are left out.
pub fn compare(sheet: &Datasheet, sampling: Sampling, measured: &BTreeMap<Channel, Measured>) -> Comparison {
    let channels = measured.iter().filter_map(|(channel, measured)| {
        let triad = channel.triad()?;
        let factor = sampling.density_factor(triad);
        // From here on every quantity has the dimension of its triad.
        let compared = match triad {
            Triad::Gyro => of_channel(sheet.gyro.as_ref()?, measured, factor),
            Triad::Accel => of_channel(sheet.accel.as_ref()?, measured, factor),
            Triad::Mag => of_channel(sheet.mag.as_ref()?, measured, factor),
            Triad::Attitude => None,
        };
        Some((*channel, compared?))
    });
    Comparison { name: sheet.name.clone(), source: sheet.source.clone(), sampling, channels: channels.collect() }
}

/// Compares all channels of a report with a datasheet; `windows` are the sensor's filter windows (register 85), if
/// known.
///
/// # Errors
/// [`RateError`] if a sensor of this datasheet does not send at the report's rate.
pub fn compare_report(
    sheet: &Datasheet,
    report: &NoiseReport,
    windows: Option<FilterWindows>,
) -> Result<Comparison, RateError> {
    let measured = report.channels.keys().map(|channel| (*channel, Measured::of(report, *channel))).collect();
    Ok(compare(sheet, sheet.sampling(report.rate_hz, windows)?, &measured))
}

fn of_channel<D: Dimension>(figures: &Figures<D>, measured: &Measured, factor: f64) -> Option<ChannelComparison> {
    if measured.not_at_rest {
        return Some(ChannelComparison { noise_density: None, bias_stability: None, verdict: Verdict::NotAtRest });
    }
    let noise_density = density(figures, measured, factor);
    let bias_stability = bias(figures, measured, factor);
    let verdicts = [noise_density.as_ref().map(|of| of.verdict), bias_stability.as_ref().map(|of| of.verdict)];
    let verdict = verdicts.into_iter().flatten().max()?;
    Some(ChannelComparison { noise_density, bias_stability, verdict })
}

fn density<D: Dimension>(figures: &Figures<D>, measured: &Measured, factor: f64) -> Option<DensityComparison> {
    let (value, ci95) = measured.density?;
    let (own, limit) = figures.density.zip(figures.density_limit)?;
    let lowest = Quantity::<D>::held(ci95[0]).per_root_hertz();
    let verdict = if lowest <= limit {
        Verdict::Within
    } else if lowest <= limit.times(factor) {
        Verdict::ExplainedBySampling
    } else {
        Verdict::Above
    };
    let (datasheet, predicted) = (own.value(), own.times(factor).value());
    Some(DensityComparison {
        measured: value,
        ci95,
        datasheet,
        printed: figures.printed.0.clone(),
        sampling_factor: factor,
        predicted,
        predicted_one_sided: predicted * std::f64::consts::FRAC_1_SQRT_2,
        ratio: value / datasheet,
        ratio_to_predicted: value / predicted,
        unit: format!("{}/√Hz", D::UNIT),
        verdict,
    })
}

/// A lowest point counts if the record is at least this many times its averaging time. A deviation is determined up to
/// about a fifth of a record (five degrees of freedom), and within the last two octaves of that it may still be
/// falling.
const RECORD_TAUS_MIN: f64 = 16.0;

/// Returns how long a record has to be for a verdict on `limit`, s: long enough for white noise alone to fall to half
/// the limit's variance, but at least twice as long as this record determines. The lowest deviation counts as white
/// noise if the density is not known.
fn needed(measured: &Measured, limit: f64) -> f64 {
    let (minimum, tau_s, _) = measured.minimum.unwrap_or_default();
    let white = measured.density.map_or(minimum * minimum * tau_s, |(n, _)| n * n);
    let seconds = RECORD_TAUS_MIN * (2.0 * white / (limit * limit)).max(2.0 * tau_s);
    // Rounds up to whole minutes.
    (seconds / 60.0).ceil() * 60.0
}

fn bias<D: Dimension>(figures: &Figures<D>, measured: &Measured, factor: f64) -> Option<BiasComparison> {
    let limit = figures.bias_stability?;
    let (minimum, tau_s, low) = measured.minimum?;
    // The share (1 − 1/factor²) of N²/τ is folded noise.
    let folded = measured.density.map_or(0.0, |(n, _)| n * n / tau_s * (1.0 - 1.0 / (factor * factor)).max(0.0));
    let less = |deviation: f64| (deviation * deviation - folded).max(0.0).sqrt();
    let needed_s = measured.at_rest_s.filter(|at_rest_s| tau_s * RECORD_TAUS_MIN > *at_rest_s);
    let needed_s = needed_s.map(|_| needed(measured, limit.value()));
    let verdict = if Quantity::<D>::held(low) <= limit {
        Verdict::Within
    } else if Quantity::<D>::held(less(low)) <= limit {
        Verdict::ExplainedBySampling
    } else if needed_s.is_some() {
        Verdict::TooShort
    } else {
        Verdict::Above
    };
    Some(BiasComparison {
        needed_s: needed_s.filter(|_| verdict == Verdict::TooShort),
        allan_minimum: minimum,
        tau_s,
        datasheet: limit.value(),
        printed: figures.printed.1.clone(),
        without_folded_noise: less(minimum),
        ratio: minimum / limit.value(),
        unit: D::UNIT.to_owned(),
        verdict,
    })
}

#[cfg(test)]
mod tests {
    use super::super::vn_100;
    use super::*;

    fn verdict(channel: Channel, measured: Measured, rate_hz: f64) -> ChannelComparison {
        let measured = BTreeMap::from([(channel, measured)]);
        compare(&vn_100(), Sampling::new(rate_hz, None), &measured).channels[&channel].clone()
    }

    #[test]
    fn twice_the_density_at_forty_hertz_is_explained_and_at_two_hundred_is_not() {
        let measured = Measured { density: Some((1.18e-4, [1.16e-4, 1.20e-4])), minimum: None, ..Measured::default() };
        let forty = verdict(Channel::GyroX, measured, 40.0);
        assert_eq!(forty.verdict, Verdict::ExplainedBySampling);
        let density = forty.noise_density.unwrap();
        assert!((density.predicted - 1.366e-4).abs() < 1e-7 && (density.sampling_factor - 2.236).abs() < 1e-3);
        assert_eq!(density.unit, "rad/s/√Hz");
        assert_eq!(verdict(Channel::GyroX, measured, 200.0).verdict, Verdict::Above);
        let fine = Measured { density: Some((6.1e-5, [6.0e-5, 6.2e-5])), minimum: None, ..Measured::default() };
        assert_eq!(verdict(Channel::GyroX, fine, 40.0).verdict, Verdict::Within);
    }

    /// A printed density is two-sided or one-sided: at 40 Hz with a window of 4, this gives 1.37e-4 or 9.7e-5
    /// rad/s/√Hz, and a deviation of one sample of 8.6e-4 or 6.1e-4 rad/s. The latter is D·√(800/2W).
    #[test]
    fn both_readings_of_a_printed_density_are_predicted() {
        let measured = Measured { density: Some((1.18e-4, [1.16e-4, 1.20e-4])), minimum: None, ..Measured::default() };
        let density = verdict(Channel::GyroX, measured, 40.0).noise_density.unwrap();
        assert!((density.predicted - 1.366e-4).abs() < 1e-7, "{density:?}");
        assert!((density.predicted_one_sided - 9.66e-5).abs() < 1e-7, "{density:?}");
        let sample = |predicted: f64| predicted * 40f64.sqrt();
        assert!((sample(density.predicted) - 8.64e-4).abs() < 1e-6, "{density:?}");
        assert!((sample(density.predicted_one_sided) - 6.11e-4).abs() < 1e-6, "{density:?}");
        let of_the_reference = density.datasheet * (800.0f64 / (2.0 * 4.0)).sqrt();
        assert!((sample(density.predicted_one_sided) / of_the_reference - 1.0).abs() < 1e-9, "{density:?}");
        // The verdict uses the two-sided reading: this measurement lies between both.
        assert!(density.predicted_one_sided < density.ci95[0] && density.verdict == Verdict::ExplainedBySampling);
    }

    /// Regression test for a report that took m/s² for mg: 0.28e-3 m/s² is 0.029 mg, well within 0.04 mg, although 0.28
    /// is above 0.04.
    #[test]
    fn an_acceleration_is_compared_as_an_acceleration() {
        let measured = Measured { density: None, minimum: Some((2.8e-4, 100.0, 2.6e-4)), ..Measured::default() };
        let found = verdict(Channel::AccelZ, measured, 40.0);
        assert_eq!(found.verdict, Verdict::Within);
        assert!((found.bias_stability.unwrap().ratio - 0.714).abs() < 1e-2);
        let measured = Measured { density: None, minimum: Some((6e-4, 100.0, 5.8e-4)), ..Measured::default() };
        assert_eq!(verdict(Channel::AccelZ, measured, 40.0).verdict, Verdict::Above);
    }

    /// 68 s of a sensor at rest: white noise still falls at 13 s. In an hour, the same lowest point counts.
    #[test]
    fn a_record_of_68_seconds_is_too_short_and_its_verdict_states_the_length_needed() {
        let n = 1.2e-4;
        let deviation = n / 12.8f64.sqrt();
        let measured = Measured {
            density: Some((n, [n, n])),
            minimum: Some((3.0 * deviation, 12.8, 2.6 * deviation)),
            at_rest_s: Some(68.0),
            ..Measured::default()
        };
        let found = verdict(Channel::GyroX, measured, 800.0).bias_stability.unwrap();
        assert_eq!((found.verdict, found.verdict.words()), (Verdict::TooShort, "too short to tell"));
        let needed_s = found.needed_s.unwrap();
        assert!((400.0..3600.0).contains(&needed_s), "{needed_s}");
        for at_rest_s in [Some(3600.0), Some(needed_s), None] {
            let long = verdict(Channel::GyroX, Measured { at_rest_s, ..measured }, 800.0).bias_stability.unwrap();
            assert_eq!((long.verdict, long.needed_s), (Verdict::Above, None));
        }
        // A value that is already within the limit stays within it.
        let quiet = Measured { minimum: Some((1e-6, 12.8, 0.9e-6)), ..measured };
        assert_eq!(verdict(Channel::GyroX, quiet, 800.0).bias_stability.unwrap().verdict, Verdict::Within);
    }

    #[test]
    fn what_was_not_at_rest_is_not_compared() {
        let moved = Measured { not_at_rest: true, ..Measured::default() };
        let found = verdict(Channel::GyroX, moved, 40.0);
        assert_eq!((found.verdict, found.verdict.words()), (Verdict::NotAtRest, "not at rest"));
        assert!(found.noise_density.is_none() && found.bias_stability.is_none());
    }

    #[test]
    fn folded_white_noise_explains_a_minimum_it_makes() {
        // White noise alone: N²/τ at 40 s is (5.4e-4)², of which four fifths are folded noise.
        let n = 3.4e-3;
        let measured = Measured {
            density: Some((n, [n, n])),
            minimum: Some((n / 40f64.sqrt(), 40.0, n / 40f64.sqrt())),
            ..Measured::default()
        };
        let found = verdict(Channel::AccelX, measured, 40.0);
        assert_eq!(found.bias_stability.unwrap().verdict, Verdict::ExplainedBySampling);
    }

    #[test]
    fn a_magnetometer_has_no_printed_stability_and_nothing_known_is_left_out() {
        let measured = Measured {
            density: Some((2e-4, [1.9e-4, 2.1e-4])),
            minimum: Some((1e-4, 10.0, 1e-4)),
            ..Measured::default()
        };
        assert!(verdict(Channel::MagX, measured, 40.0).bias_stability.is_none());
        let nothing = BTreeMap::from([(Channel::GyroX, Measured::default()), (Channel::Yaw, measured)]);
        assert!(compare(&vn_100(), Sampling::new(40.0, None), &nothing).channels.is_empty());
    }
}
