//! Robustness: the disturbances of a channel while its noise was recorded, and the parameters with and without them.
//!
//! [`examine`] finds spectral lines and vibration. With these reduced to the background, it finds spikes, knocks and
//! handling by time, and then steps, bumps and drift of the level. A [`Record`] holds the sums of the remaining
//! samples, and the deviation hour by hour; parameters are fitted with and without the disturbances. A record is
//! examined twice, block by block ([`BLOCK`]): memory does not grow with its length. All findings are reported as flags
//! of docs/formats.md.
//!
//! # Validation
//! The test of each detector has a synthetic case; `recordings.rs` has the real ones; `false_alarms.rs` counts the
//! findings in pure noise.

mod blocks;
mod bursts;
mod drift;
mod dynamic;
mod event;
mod excise;
#[cfg(test)]
mod false_alarms;
mod lines;
mod part;
mod record;
#[cfg(test)]
mod recordings;
mod rest;
mod scale;
mod spectrum;
mod steps;
mod survey;
#[cfg(test)]
mod synthetic;
mod temperature;

pub use bursts::HeavyTails;
pub use drift::Drift;
pub use dynamic::{DynamicAllan, DynamicBlock};
pub use event::{Event, Kind};
pub use lines::Line;
pub use part::{Levels, Part, Portion, bridged, samples_of, without_intervals};
pub use record::{All, Company, Record, parameters_together};
pub use temperature::TemperatureDependence;

use crate::allan::{AllanCurve, AllanPoint, FixedPoint};
use crate::fit::{Estimate, Flag, NoiseParameters};
use crate::whittle::{DstEstimator, DstSums, Transform};
use imu_core::sample::Channel;
use serde::{Deserialize, Serialize};
use survey::Survey;

/// Samples of a block: 7 h at 40 Hz, 22 min at 800 Hz. A block takes about a hundred bytes per sample while it is
/// examined.
pub const BLOCK: u64 = 1 << 20;

/// Returns the number of blocks in which a record of that many samples is examined. The blocks are of equal length,
/// because a short one would carry little information.
pub fn blocks_of(samples: u64) -> usize {
    usize::try_from(samples.div_ceil(BLOCK)).unwrap_or(usize::MAX).max(1)
}

/// The findings in a channel, and the samples to leave out for its noise alone.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Examination {
    /// Disturbances by time.
    pub events: Vec<Event>,
    /// Lines and bands of vibration.
    pub lines: Vec<Line>,
    /// Warm-up or creep.
    pub drift: Option<Drift>,
    /// Samples far outside the noise, if they are too many to be events.
    pub heavy_tails: Option<HeavyTails>,
    /// Times to leave out, s since the start of the capture, sorted and disjoint.
    pub excluded_intervals: Vec<(f64, f64)>,
    /// Frequencies to leave out of a fit to the spectrum, Hz, sorted and disjoint.
    pub excluded_bands_hz: Vec<(f64, f64)>,
    /// Begin and end of the record, s since the start of the capture; `None` without samples.
    span_s: Option<(f64, f64)>,
    /// Per block, the gain per bin that reduces its bands to the background.
    gains: Vec<Option<Vec<f64>>>,
}

impl Examination {
    /// Returns whether the samples are pure noise, as far as can be determined.
    pub fn is_clean(&self) -> bool {
        self.excluded_intervals.is_empty() && self.gains.iter().all(Option::is_none) && self.drift.is_none()
    }

    /// Returns all findings as flags of the document, in order of time.
    pub fn flags(&self, channel: Channel) -> Vec<Flag> {
        let unit = channel.unit();
        let mut flags: Vec<Flag> = self.events.iter().map(Event::flag).collect();
        flags.extend(self.lines.iter().map(|line| {
            let kind = if line.broad { "vibration" } else { "line" };
            let [low, high] = line.band_hz;
            let lasts = if line.persistent { "" } else { ", not all the time" };
            let mains: Vec<String> = line.may_be_mains_hz.iter().map(f64::to_string).collect();
            let mains = match mains.join(" or ") {
                mains if mains.is_empty() => mains,
                mains => format!("; mains of {mains} Hz would appear there"),
            };
            let note = format!(
                "{:.3} Hz ({low:.3} to {high:.3}), amplitude {:.2e} {unit}, {:.1} times the background{lasts}{mains}",
                line.frequency_hz, line.amplitude, line.ratio
            );
            Flag::whole(kind, note)
        }));
        if let Some(drift) = &self.drift {
            flags.push(match drift.tau_s {
                Some(tau_s) => {
                    let note = format!(
                        "the level settles by {:.2e} {unit} with a time constant of {tau_s:.0} s",
                        drift.change
                    );
                    Flag { kind: "warm_up".into(), from_s: Some(0.0), to_s: Some((3.0 * tau_s).round()), note }
                }
                None => Flag::whole(
                    "creep",
                    format!(
                        "the level creeps by {:.2e} {unit} over the record, which no random walk does",
                        drift.change
                    ),
                ),
            });
        }
        if let Some(HeavyTails { share, .. }) = self.heavy_tails {
            let note = format!(
                "{:.2} % of the samples are too far out for normal noise: the interval of N reaches from noise without them to noise \
                 with them",
                100.0 * share
            );
            flags.push(Flag::whole("heavy_tails", note));
        }
        flags
    }
}

/// Examines a channel in one block. `parts` are its samples without gaps, in order of time, in the channel's unit;
/// `rate_hz` is above 0.
pub fn examine(parts: &[Part], rate_hz: f64) -> Examination {
    let mut survey = Survey::new(rate_hz, parts.iter().map(|part| part.values.len() as u64).sum());
    survey.look(&Portion { parts: parts.to_vec(), continues: false });
    survey.settle().0
}

/// Returns the spectral sums of parts: the input of the Whittle fit.
pub fn spectral_sums(parts: &[Part], scale: FixedPoint) -> DstSums {
    let mut transform = Transform::new();
    let mut estimator = DstEstimator::new(scale);
    for part in parts {
        estimator.push(&mut transform, &part.values);
        estimator.break_segment(&mut transform);
    }
    estimator.into_sums(&mut transform)
}

/// The statements about a channel beside its parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Disturbances {
    /// Parameters of all samples, disturbances included; null if no finding is left out or separated from noise. A
    /// creep alone counts, although nothing is left out for it: these parameters then equal those of the channel.
    pub with_disturbances: Option<NoiseParameters>,
    /// Excluded time, s.
    pub excluded_s: f64,
    /// Excluded intervals, s since the start of the capture.
    pub excluded_intervals_s: Vec<[f64; 2]>,
    /// Excluded frequencies, Hz.
    pub excluded_bands_hz: Vec<[f64; 2]>,
    /// Lines and bands of vibration.
    pub lines: Vec<Line>,
    /// Warm-up or creep; null if there is none.
    pub drift: Option<Drift>,
    /// Dependence on temperature; null if it is not recorded or hardly changes.
    pub temperature: Option<TemperatureDependence>,
    /// Rate random walk without the temperature's part; null without a significant one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k_without_temperature: Option<Estimate>,
    /// Rate ramp without the temperature's part.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub r_without_temperature: Option<Estimate>,
    /// Deviation hour by hour; null if the record is too short.
    pub dynamic: Option<DynamicAllan>,
    /// Lowest point of the Allan deviation without excluded samples; null if no point has five degrees of freedom.
    pub allan_minimum: Option<AllanMinimum>,
}

/// The lowest point of an Allan deviation, which datasheets call bias stability in run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AllanMinimum {
    /// The deviation, in the channel's unit.
    pub deviation: f64,
    /// Lower end of the deviation's 68.3 % interval.
    pub ci68_low: f64,
    /// Averaging time, s.
    pub tau_s: f64,
}

impl AllanMinimum {
    fn of(points: &[AllanPoint], rate_hz: f64) -> Option<Self> {
        let curve = AllanCurve::from_points(points, rate_hz, "");
        let (tau_s, deviation) = curve.minimum(5.0)?;
        let at = curve.tau_s.iter().position(|tau| *tau == tau_s)?;
        Some(Self { deviation, ci68_low: *curve.ci68_low.get(at)?, tau_s })
    }
}
