//! Reports: from sums and moments to the documents of the contract, section 7.

use super::JobError;
use super::plan::Plan;
use crate::noise::allan::{AllanCurve, AllanPoint, AllanReport, AllanSums, Estimator};
use crate::noise::fit::{Flag, fit};
use crate::noise::statistics::Statistics;
use crate::noise::{NoiseParameters, NoiseReport};
use crate::sample::Channel;
use crate::store::Reader;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Statistics of a capture, as `GET /v1/captures/{id}/statistics` answers them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct StatisticsReport {
    /// [`StatisticsReport::FORMAT`].
    pub format: String,
    /// The capture's name.
    pub capture: String,
    /// Sample time covered, s.
    pub duration_s: f64,
    /// Samples received.
    pub samples: u64,
    /// Samples missing.
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

/// What a report says about the samples it is made of.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Extent {
    pub(super) capture: String,
    pub(super) duration_s: f64,
    pub(super) samples: u64,
    pub(super) missing: u64,
    pub(super) complete: bool,
}

impl Extent {
    /// The capture's samples below `end_seq`; `rate_hz` turns them into time where that is not all of an ended capture.
    pub(super) fn read(reader: &Reader, capture_id: i64, end_seq: u64) -> Result<Self, JobError> {
        let capture = reader.capture(capture_id)?;
        if !capture.state.is_open() && capture.samples == end_seq {
            return Ok(Self {
                capture: capture.name,
                duration_s: capture.duration_s,
                samples: capture.samples,
                missing: capture.missing,
                complete: true,
            });
        }
        let missing = reader.missing_before(capture_id, end_seq)?;
        let duration_s = capture.rate_hz.map_or(0.0, |rate_hz| (end_seq + missing) as f64 / rate_hz);
        Ok(Self { capture: capture.name, duration_s, samples: end_seq, missing, complete: false })
    }
}

/// Deviation curves of exact sums.
pub(super) fn allan(plan: &Plan, sums: &[(Channel, AllanSums)], extent: &Extent) -> AllanReport {
    let curves =
        sums.iter().map(|(channel, sums)| (*channel, AllanCurve::from_sums(sums, plan.rate_hz, channel.unit())));
    let mut report = AllanReport::new(Estimator::Oadev, plan.rate_hz, extent.complete, curves);
    report.samples = Some(extent.samples);
    report.warnings = warnings(plan, extent);
    for (channel, sums) in sums {
        report
            .warnings
            .extend(out_of_range(*channel, sums.out_of_range()).map(|flag| format!("{channel}: {}", flag.note)));
    }
    report
}

/// What a curve does not show: where its input was cut.
fn warnings(plan: &Plan, extent: &Extent) -> Vec<String> {
    let mut warnings = Vec::new();
    if plan.taken > 1 {
        warnings.push(format!(
            "{} segments ({} samples missing): each was analysed by itself, nothing is averaged across a gap or a reset",
            plan.taken, extent.missing
        ));
    }
    warnings.extend(other_rate(plan.rate_hz, plan.other_rate).map(|flag| flag.note));
    warnings
}

/// Noise parameters of exact sums.
pub(super) fn noise(plan: &Plan, sums: &[(Channel, AllanSums)], extent: Extent) -> NoiseReport {
    let channels = sums.iter().map(|(channel, sums)| {
        let mut parameters = fit(&sums.points(), plan.rate_hz, *channel);
        parameters.flags.extend(out_of_range(*channel, sums.out_of_range()));
        parameters.flags.extend(other_rate(plan.rate_hz, plan.other_rate));
        (*channel, parameters)
    });
    noise_report(extent, plan.rate_hz, channels.collect())
}

/// Noise parameters of octaves of a capture that still runs.
pub(super) fn noise_of_points(
    points: &BTreeMap<Channel, Vec<AllanPoint>>,
    rate_hz: f64,
    other: u64,
    extent: Extent,
) -> NoiseReport {
    let channels = points.iter().map(|(channel, octaves)| {
        let mut parameters = fit(octaves, rate_hz, *channel);
        parameters.flags.extend(other_rate(rate_hz, other));
        (*channel, parameters)
    });
    noise_report(extent, rate_hz, channels.collect())
}

fn noise_report(extent: Extent, rate_hz: f64, channels: BTreeMap<Channel, NoiseParameters>) -> NoiseReport {
    NoiseReport {
        format: NoiseReport::FORMAT.to_owned(),
        capture: extent.capture,
        rate_hz,
        duration_s: extent.duration_s,
        samples: extent.samples,
        missing: extent.missing,
        complete: extent.complete,
        channels,
        datasheet: None,
    }
}

/// Statistics of every channel.
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

fn out_of_range(channel: Channel, samples: u64) -> Option<Flag> {
    let note = || format!("{samples} values beyond what a {channel} can measure were left out; each ended a stretch");
    (samples > 0).then(|| Flag::whole("out_of_range", note()))
}

fn other_rate(rate_hz: f64, samples: u64) -> Option<Flag> {
    let note = || format!("{samples} samples at another rate than {rate_hz} Hz were left out");
    (samples > 0).then(|| Flag::whole("other_rate", note()))
}
