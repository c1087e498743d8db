//! Findings: notable properties of a recording's times and values, as figures.

use imu_core::sample::Channel;
use std::collections::BTreeMap;

/// The figures of a first pass.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize)]
pub struct Findings {
    /// Number of steps from stamp to stamp.
    pub steps: u64,
    /// The median step, s.
    pub median_step_s: Option<f64>,
    /// The number of steps over their time, Hz; below the rate if samples are missing.
    pub mean_rate_hz: Option<f64>,
    /// Number of grid points without a sample.
    pub missing: u64,
    /// Number of gaps that contain them.
    pub gaps: u64,
    /// Time from sample to sample across the longest gap, s.
    pub longest_gap_s: Option<f64>,
    /// The start of that gap, UTC ns; `None` if stamps do not show the time of day.
    pub longest_gap_utc_ns: Option<i64>,
    /// Number of stamps that are late by half a period or more, beyond their rounding: the next ones compensate this.
    pub delayed: u64,
    /// The longest delay, s.
    pub longest_delay_s: Option<f64>,
    /// How often stamps left the grid because the clock was set or the rate changed.
    pub off_grid: u64,
    /// Number of steps below a tenth of the median step, or of the long one of pairs.
    pub short_steps: u64,
    /// The two alternating steps, if stamps come in pairs.
    pub pairs: Option<Pairs>,
    /// Number of stamps that repeat that of the sample before; rejected as duplicates.
    pub frozen_stamps: u64,
    /// Number of runs of such stamps.
    pub frozen_runs: u64,
    /// Number of repetitions in the longest run.
    pub longest_frozen_run: u64,
    /// Number of stamps before that of the sample before: out of order; rejected as duplicates.
    pub late_stamps: u64,
    /// The largest distance, s.
    pub latest_by_s: Option<f64>,
    /// The line (a bag's message) of the first of them.
    pub first_late_line: Option<u64>,
    /// Number of stamps far ahead of those that follow, or of another clock; rejected as malformed.
    pub stray_stamps: u64,
    /// Number of samples that repeat the one before in every channel.
    pub repeated_samples: u64,
    /// The rate in use, Hz, if a comment in the file states it.
    pub commented_rate_hz: Option<f64>,
    /// How often the sensor's own clock restarted. The number of samples missed there is unknown.
    pub restarts: u64,
    /// For each channel that lacks values, the number of samples in which it has no finite value.
    pub absent: BTreeMap<Channel, u64>,
    /// Number of samples with a magnetic field above 25 gauss: the assumed unit is wrong.
    pub strong_fields: u64,
    /// The step of each channel's values, if one is found.
    pub quantisation: BTreeMap<Channel, Quantisation>,
    /// Units that the values contradict. Nothing was converted because of them.
    pub doubts: Vec<Doubt>,
}

/// Stamps that come two at a time.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Pairs {
    /// The median step within a pair, s.
    pub short_s: f64,
    /// The median step from pair to pair, s.
    pub long_s: f64,
}

/// The smallest step of which nearly all values of a channel are multiples.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Quantisation {
    /// The step in the channel's unit.
    pub step: f64,
    /// The step in the file's unit.
    pub original_step: f64,
    /// The file's unit.
    pub original_unit: String,
}

/// A unit that the values contradict.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Doubt {
    /// The triad: `accel`, `gyro` or `mag`.
    pub triad: &'static str,
    /// The unit that the file or its form states.
    pub unit: &'static str,
    /// The unit that would fit, if one is known.
    pub looks_like: Option<&'static str>,
    /// The suffix of a CSV column with that unit.
    pub suffix: Option<&'static str>,
    /// The reason, with figures.
    pub reason: String,
}

impl Doubt {
    /// Creates a doubt. `found` is the suffix and the unit that would fit.
    pub(super) fn new(
        triad: &'static str,
        unit: &'static str,
        found: Option<(&'static str, &'static str)>,
        reason: String,
    ) -> Self {
        Self { triad, unit, looks_like: found.map(|(_, unit)| unit), suffix: found.map(|(suffix, _)| suffix), reason }
    }
}
