//! Reports: converts sums and moments to the documents of docs/formats.md.

use super::JobError;
use super::examine::{Steps, examine};
use super::held::Held;
use super::plan::{Plan, Shares};
use super::raw_counts::RawCounts;
use super::source::{Extent, SampleSource};
use super::threads::side_by_side;
use imu_core::sample::Channel;
use imu_core::units::counted;
use imu_noise::allan::{AllanCurve, AllanReport, AllanSums, Estimator};
use imu_noise::fit::Flag;
use imu_noise::robust::All;
use imu_noise::statistics::Statistics;
use imu_noise::stillness::MOTION_CHANNELS;
use imu_noise::whittle::DstSums;
use imu_noise::{Contribution, NoiseParameters, NoiseReport};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Statistics of a capture, as returned by `GET /v1/captures/{id}/statistics`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct StatisticsReport {
    /// [`StatisticsReport::FORMAT`].
    pub format: String,
    /// The capture's name.
    pub capture: String,
    /// Sample time covered, s.
    pub duration_s: f64,
    /// Number of samples received.
    pub samples: u64,
    /// Number of samples missing.
    pub missing: u64,
    /// Whether the capture has ended.
    pub complete: bool,
    /// One entry per channel.
    pub channels: BTreeMap<Channel, Statistics>,
}

impl StatisticsReport {
    /// The name of this format.
    pub const FORMAT: &'static str = "vn100d-statistics-1";
}

impl Extent {
    /// Returns the extent of all captures of a plan together.
    pub(super) fn of_plan(source: &dyn SampleSource, plan: &Plan) -> Result<Self, JobError> {
        let mut whole: Option<Self> = None;
        for slice in &plan.slices {
            let mut extent = source.extent(slice.capture_id, slice.samples.end - slice.samples.start)?;
            if plan.slices.len() > 1 {
                let shares = plan.shares(&slice.samples);
                extent.captures.push(Contribution {
                    at_rest_s: shares.map(|of| of.at_rest_s),
                    moving_s: shares.map(|of| of.moving_s),
                    capture: extent.capture.clone(),
                    duration_s: extent.duration_s,
                    samples: extent.samples,
                    missing: extent.missing,
                    ..Contribution::default()
                });
            }
            whole = Some(match whole {
                None => extent,
                Some(whole) => whole.and(extent),
            });
        }
        whole.ok_or_else(|| JobError::InsufficientData("there is no capture".to_owned()))
    }

    fn and(mut self, other: Self) -> Self {
        self.captures.extend(other.captures);
        Self {
            capture: format!("{} + {}", self.capture, other.capture),
            duration_s: self.duration_s + other.duration_s,
            samples: self.samples + other.samples,
            missing: self.missing + other.missing,
            complete: self.complete && other.complete,
            captures: self.captures,
        }
    }
}

/// Converts exact sums to deviation curves.
pub(super) fn allan(plan: &Plan, sums: &[(Channel, AllanSums)], extent: &Extent) -> AllanReport {
    let curve =
        |(channel, sums): &(Channel, AllanSums)| (*channel, AllanCurve::from_sums(sums, plan.rate_hz, channel.unit()));
    let mut report = curves(plan, Estimator::Oadev, sums.iter().map(curve), extent);
    report.warnings.extend(report.stride_warning());
    for (channel, sums) in sums {
        report
            .warnings
            .extend(Flag::out_of_range(*channel, sums.out_of_range()).map(|flag| format!("{channel}: {}", flag.note)));
    }
    report
}

/// Makes a report of an estimator's deviation curves.
pub(super) fn curves(
    plan: &Plan,
    estimator: Estimator,
    curves: impl IntoIterator<Item = (Channel, AllanCurve)>,
    extent: &Extent,
) -> AllanReport {
    let mut report = AllanReport::new(estimator, plan.rate_hz, extent.complete, curves);
    report.samples = Some(extent.samples);
    report.missing = Some(extent.missing);
    report.captures.clone_from(&extent.captures);
    report.warnings = warnings(plan, extent);
    let shares = plan.shares(&(0..plan.end_seq));
    (report.at_rest_s, report.moving_s) = (shares.map(|of| of.at_rest_s), shares.map(|of| of.moving_s));
    report
}

/// Returns the warnings that a curve does not show: the places where its input was cut.
fn warnings(plan: &Plan, extent: &Extent) -> Vec<String> {
    let mut warnings = Vec::new();
    if plan.taken > 1 {
        warnings.push(format!(
            "{} segments ({} missing): each was analysed by itself, nothing is averaged across a gap or a reset",
            plan.taken,
            counted(extent.missing, "sample", "samples")
        ));
    }
    warnings.extend(Flag::other_rate(plan.rate_hz, plan.other_rate).map(|flag| flag.note));
    warnings.extend(motion(plan).map(|flag| flag.note));
    warnings
}

/// Returns `raw_counts` if the values are raw counts. Otherwise returns `in_motion` if the sensor moved for a part of
/// the time, `not_at_rest` if it moved all the time, and `None` if it did not move.
fn motion(plan: &Plan) -> Option<Flag> {
    if let Some(raw) = plan.raw_counts {
        return Some(Flag::whole("raw_counts", raw.to_string()));
    }
    let Shares { at_rest_s, moving_s } = plan.shares(&(0..plan.end_seq)).filter(|of| of.moving_s > 0.0)?;
    Some(if at_rest_s > 0.0 {
        let whole_s = at_rest_s + moving_s;
        let note = format!("the sensor moved for {moving_s:.1} s of {whole_s:.1} s: these are left out");
        Flag::whole("in_motion", note)
    } else {
        let note =
            format!("the sensor was not at rest: it moved for all {moving_s:.1} s, and noise is measured at rest");
        Flag::whole("not_at_rest", note)
    })
}

/// Returns the noise parameters of spectral sums, with and without disturbances; `held` and `steps` as in [`examine`].
pub(super) fn noise(
    source: &dyn SampleSource,
    plan: &Plan,
    sums: &[(Channel, DstSums)],
    held: Option<Held>,
    steps: &mut dyn Steps,
) -> Result<NoiseReport, JobError> {
    let motion = motion(plan);
    let fitted = side_by_side(
        sums.iter(),
        || (),
        |(), (channel, sums)| {
            let mut all = All::of(*channel, plan.rate_hz, sums, plan.sampling(*channel));
            all.parameters.flags.extend(Flag::out_of_range(*channel, sums.out_of_range()));
            all.parameters.flags.extend(Flag::other_rate(plan.rate_hz, plan.other_rate));
            all.parameters.flags.extend(motion.clone());
            (*channel, all)
        },
    );
    let (mut channels, mut disturbances) = (BTreeMap::new(), BTreeMap::new());
    let mut extent = Extent::of_plan(source, plan)?;
    let found = examine(source, plan, &fitted.into_iter().collect(), held, steps)?;
    for (channel, (mut parameters, disturbance)) in found.channels {
        let counted = sums.iter().find(|(own, _)| *own == channel);
        let beyond = counted.map_or((0, 0), |(_, sums)| (sums.out_of_range(), sums.out_of_range() + sums.samples()));
        // In that case the units of the other channels are unknown, and so is whether the sensor was at rest.
        let of_all = plan.raw_counts.filter(|_| MOTION_CHANNELS.contains(&channel) || !plan.has_rest());
        if let Some(raw) = of_all.or_else(|| RawCounts::of(channel, beyond.0, beyond.1)) {
            parameters.refuse(raw.to_string());
        } else if let Some(flag) = parameters.flags.iter().find(|flag| flag.kind == "not_at_rest") {
            parameters.refuse(flag.note.clone());
        }
        channels.insert(channel, parameters);
        disturbances.insert(channel, disturbance);
    }
    for (contribution, of_capture) in extent.captures.iter_mut().zip(found.captures) {
        for (channel, (flags, disturbances)) in of_capture {
            contribution.flags.insert(channel, flags);
            contribution.disturbances.insert(channel, disturbances);
        }
    }
    let shares = plan.shares(&(0..plan.end_seq));
    Ok(NoiseReport {
        disturbances,
        at_rest_s: shares.map(|of| of.at_rest_s),
        moving_s: shares.map(|of| of.moving_s),
        ..noise_report(extent, plan.rate_hz, channels)
    })
}

/// Makes a report of the noise parameters of every channel.
pub(super) fn noise_report(extent: Extent, rate_hz: f64, channels: BTreeMap<Channel, NoiseParameters>) -> NoiseReport {
    NoiseReport {
        format: NoiseReport::FORMAT.to_owned(),
        capture: extent.capture,
        captures: extent.captures,
        rate_hz,
        duration_s: extent.duration_s,
        at_rest_s: None,
        moving_s: None,
        samples: extent.samples,
        missing: extent.missing,
        complete: extent.complete,
        channels,
        disturbances: BTreeMap::new(),
        datasheet: None,
    }
}

/// Makes a report of the statistics of every channel.
pub(super) fn statistics(channels: BTreeMap<Channel, Statistics>, extent: Extent) -> StatisticsReport {
    StatisticsReport {
        format: StatisticsReport::FORMAT.to_owned(),
        capture: extent.capture,
        duration_s: extent.duration_s,
        samples: extent.samples,
        missing: extent.missing,
        complete: extent.complete,
        channels,
    }
}
