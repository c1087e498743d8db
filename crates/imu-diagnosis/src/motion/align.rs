//! Alignment: the reference at the record's instants.
//!
//! A reference that is as long as the record and was made on its clock lies beside it row by row. Any other reference
//! may begin at any time, before the record or within it, and may run a little faster or slower. Its start is the lag
//! at which the differences of both correlate most. The fit then finds the offset to a fraction of a sample, and the
//! rate ([`crate::response::Clock`]). Differences have no bias and little slow noise.

use super::reference::Reference;
use crate::error::DiagnosisError;
use crate::recording::Recording;
use crate::response::clock::latest;
use crate::response::input;
use imu_core::sample::Triad;
use imu_model::simulator::{Motion, SensorModel};
use realfft::num_complex::Complex;

/// Number of the record's periods by which the length of a reference on the same clock may differ.
const SAME: f64 = 1.5;
/// Maximum length of a reference: a multiple of the record's length, and an hour. It is searched at the record's rate.
const LONGER: f64 = 10.0;
const LONGER_S: f64 = 3600.0;
/// Minimum number of samples that both have in common.
pub const LEAST: usize = 1000;

/// A reference beside a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Aligned {
    /// The first sample of the record that the reference covers.
    pub from: usize,
    /// The motion at each sample from there on.
    pub motions: Vec<Motion>,
    /// Whether the reference counts as on the record's own clock.
    pub shared: bool,
    /// The time of the record's first sample in the reference, s.
    pub begins_s: f64,
    /// By how much slower the reference's time passes than the record's, s/s.
    pub gains: f64,
}

/// Brings a reference to the record's instants.
///
/// # Errors
/// [`DiagnosisError::Reference`] if both have too little in common.
pub fn align(
    real: &Recording,
    reference: &Reference,
    sim: &SensorModel,
    triads: &[Triad],
) -> Result<Aligned, DiagnosisError> {
    let rate_hz = real.rate_hz;
    let (n, length_s) = (real.len(), reference.length_s());
    let record_s = n.saturating_sub(1) as f64 / rate_hz;
    if length_s > LONGER * record_s + LONGER_S {
        return Err(DiagnosisError::ReferenceLong { found_s: length_s, record_s });
    }
    let shared = (record_s - length_s).abs() * rate_hz <= SAME;
    let begins_s = if shared { 0.0 } else { begin_s(real, reference, triads) };
    at(real, reference, sim, Lie { begins_s, gains: 0.0, shared })
}

/// The position of a reference beside a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lie {
    /// The time of the record's first sample in the reference, s.
    pub(super) begins_s: f64,
    /// By how much slower the reference's time passes than the record's, s/s.
    pub(super) gains: f64,
    pub(super) shared: bool,
}

/// Returns the reference at the record's instants, if its position in time is known.
pub(super) fn at(
    real: &Recording,
    reference: &Reference,
    sim: &SensorModel,
    lie: Lie,
) -> Result<Aligned, DiagnosisError> {
    let (rate_hz, n, length_s) = (real.rate_hz, real.len(), reference.length_s());
    let Lie { begins_s, gains, shared } = lie;
    // The sensor's boxcar over its own samples turns a motion into the mean of the last samples up to the instant.
    let window: Vec<f64> = match sim.sampling {
        Some(sampling) => (0..sampling.filter_window).map(|back| back as f64 / sampling.internal_rate_hz).collect(),
        None => vec![0.0],
    };
    let reach_s = window.last().copied().unwrap_or_default();
    let tolerance_s = if shared { (SAME + 1.0) / rate_hz + reach_s } else { 0.0 };
    let inside = |index: &usize| {
        let after_s = begins_s + *index as f64 / rate_hz * (1.0 - gains);
        after_s - reach_s >= -tolerance_s && after_s <= length_s + tolerance_s
    };
    let from = (0..n).find(inside).unwrap_or(n);
    let to = (0..n).rev().find(inside).map_or(from, |last| last + 1).max(from);
    if to - from < LEAST {
        return Err(DiagnosisError::Reference { common: to - from, least: LEAST });
    }
    let mut near = 0;
    let mut at = |index: usize| {
        let after_s = begins_s + index as f64 / rate_hz * (1.0 - gains);
        let mut mean = Motion::default();
        for back_s in &window {
            let one = reference.at((after_s - back_s).max(0.0), &mut near);
            for axis in 0..3 {
                mean.gyro_rad_s[axis] += one.gyro_rad_s[axis] / window.len() as f64;
                mean.accel_m_s2[axis] += one.accel_m_s2[axis] / window.len() as f64;
            }
            mean.temperature_c = mean.temperature_c.or(one.temperature_c);
        }
        mean
    };
    Ok(Aligned { from, motions: (from..to).map(&mut at).collect(), shared, begins_s, gains })
}

/// Returns the time in the reference at which the record begins, s; below 0 if the record begins earlier.
fn begin_s(real: &Recording, reference: &Reference, triads: &[Triad]) -> f64 {
    let rate_hz = real.rate_hz;
    let rows = (reference.length_s() * rate_hz) as usize + 1;
    let mut near = 0;
    let motions: Vec<Motion> = (0..rows).map(|index| reference.at(index as f64 / rate_hz, &mut near)).collect();
    let length = (real.len() + rows).next_power_of_two();
    let axes = triads.iter().flat_map(|triad| triad.channels().into_iter().enumerate().map(move |of| (*triad, of)));
    let pairs = axes.filter_map(|(triad, (axis, channel))| {
        let shown = differences(real.values(channel).unwrap_or_default().iter().copied());
        let felt = differences(motions.iter().map(|motion| input(triad, motion)[axis]));
        let square: f64 = shown.iter().map(|value| value * value).sum();
        (square > 0.0).then_some((shown, felt, move |product: Complex<f64>| product / square.sqrt()))
    });
    // Lag: the record's sample index less the reference's row index at the same instant.
    let lags = -(rows as i64 - 1)..real.len() as i64;
    -(latest(length, pairs, lags) as f64) / rate_hz
}

/// Returns differences of neighbours; 0 beside values that are not numbers.
fn differences(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let values: Vec<f64> = values.collect();
    let step = |pair: &[f64]| Some(pair[1] - pair[0]).filter(|step| step.is_finite()).unwrap_or(0.0);
    values.windows(2).map(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(time_s: f64) -> Motion {
        Motion {
            gyro_rad_s: [(0.7 * time_s).sin(), (0.31 * time_s).cos(), (0.9 * time_s + 0.01 * time_s * time_s).sin()],
            ..Motion::default()
        }
    }

    #[test]
    fn a_reference_that_began_at_another_time_and_runs_at_another_rate_is_found() {
        let triads = [Triad::Gyro];
        for begun_s in [-12.34, 0.0, 25.67] {
            let values = |axis: usize| (0..2000).map(|i| at(50.0 + f64::from(i) / 40.0).gyro_rad_s[axis]).collect();
            let channels = Triad::Gyro.channels().into_iter().enumerate();
            let real = Recording {
                rate_hz: 40.0,
                channels: channels.map(|(axis, channel)| (channel, values(axis))).collect(),
                ..Recording::default()
            };
            let rows = (0..7000).map(|i| f64::from(i) / 100.0).map(|s| (1e6 + s, at(50.0 - begun_s + s)));
            let reference = Reference::new(rows).unwrap();
            let found = align(&real, &reference, &SensorModel::default(), &triads).unwrap();
            assert!(!found.shared && (found.begins_s - begun_s).abs() <= 1.0 / 40.0, "{begun_s}: {}", found.begins_s);
            assert_eq!(found.from, if begun_s < 0.0 { (-found.begins_s * 40.0).ceil() as usize } else { 0 });
        }
    }

    #[test]
    fn rows_of_the_same_clock_lie_beside_the_samples() {
        let channels = Triad::Gyro.channels().map(|channel| (channel, vec![0.0; 2000])).to_vec();
        let real = Recording { rate_hz: 40.0, channels, ..Recording::default() };
        let rows: Vec<(f64, Motion)> = (0..2000).map(|i| f64::from(i) / 40.0).map(|s| (s, at(s))).collect();
        let found =
            align(&real, &Reference::new(rows.clone()).unwrap(), &SensorModel::default(), &[Triad::Gyro]).unwrap();
        assert!(found.shared && found.from == 0 && found.motions.len() == 2000);
        for (motion, (_, row)) in found.motions.iter().zip(&rows) {
            assert!((motion.gyro_rad_s[2] - row.gyro_rad_s[2]).abs() < 1e-12);
        }
    }
}
