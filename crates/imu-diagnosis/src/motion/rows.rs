//! Rows: the samples of triads with their stamps, without those that are missing.

use crate::recording::Recording;
use imu_core::sample::Triad;
use nalgebra::Vector3;

/// No sensor shows a value beyond this, in any unit or in counts: such a value is damaged.
const LARGEST: f64 = 1e12;

/// Samples at increasing stamps, s. Each triad has a value at each stamp.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rows {
    /// The stamps, s.
    pub time_s: Vec<f64>,
    /// The place of each among the recording's samples.
    pub places: Vec<usize>,
    /// The values of each triad that was asked for, in the recording's unit.
    pub triads: Vec<Vec<Vector3<f64>>>,
}

/// Returns the rows in which all of these triads have values that a sensor can show. A channel that the recording lacks is 0.
pub fn rows(real: &Recording, triads: &[Triad]) -> Rows {
    let columns: Vec<[Option<&[f64]>; 3]> =
        triads.iter().map(|triad| triad.channels().map(|channel| real.values(channel))).collect();
    let begins_s = real.begins_s.unwrap_or(0.0);
    let mut found = Rows { triads: vec![Vec::new(); triads.len()], ..Rows::default() };
    let mut there = 0;
    for place in 0..real.len() {
        if real.is_missing(place) {
            continue;
        }
        let stamp = if real.time_s.len() == real.len() { place } else { there };
        let time_s = begins_s + real.time_s.get(stamp).copied().unwrap_or(place as f64 / real.rate_hz);
        there += 1;
        let at = |of: &[Option<&[f64]>; 3]| Vector3::from_fn(|axis, _| of[axis].map_or(0.0, |values| values[place]));
        let values: Vec<Vector3<f64>> = columns.iter().map(at).collect();
        let is_later = found.time_s.last().is_none_or(|last| time_s > *last);
        if is_later && values.iter().flatten().all(|value| value.abs() < LARGEST) {
            found.time_s.push(time_s);
            found.places.push(place);
            found.triads.iter_mut().zip(values).for_each(|(of, value)| of.push(value));
        }
    }
    found
}
