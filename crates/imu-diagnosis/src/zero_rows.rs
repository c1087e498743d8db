//! Zero rows: rows that are not measurements, because the writer of the recording filled them with zeros.

use super::averages::{median, scale_of};
use super::facts;
use super::recording::Recording;
use std::borrow::Cow;

/// Finds rows that hold exactly 0 on every channel, if a channel's values beside them are so far from 0 that neither noise nor a slow
/// course leads there.
pub(super) fn rows(real: &Recording) -> Vec<usize> {
    /// Minimum distance of the neighbours from 0, in standard deviations of the white noise and in steps.
    const FAR: f64 = 8.0;
    let is_blank =
        |t: &usize| !real.is_missing(*t) && real.channels.iter().all(|(_, values)| values.get(*t) == Some(&0.0));
    let rows: Vec<usize> = (0..real.len()).filter(is_blank).collect();
    if rows.is_empty() || rows.len() * 2 >= real.len() {
        return Vec::new();
    }
    let is_far = |values: &[f64]| {
        let is_there = |t: &usize| values[*t].is_finite() && rows.binary_search(t).is_err();
        let places: Vec<usize> = (0..values.len()).filter(is_there).collect();
        if places.len() < 3 {
            return false;
        }
        let there: Vec<f64> = places.iter().map(|t| values[*t]).collect();
        let nearest = |row: &usize| {
            let after = places.partition_point(|t| t < row);
            let beside = there[after.saturating_sub(1)..(after + 1).min(there.len())].iter();
            beside.fold(f64::INFINITY, |least, value| least.min(value.abs()))
        };
        let mut nearest: Vec<f64> = rows.iter().map(nearest).collect();
        median(&mut nearest) > FAR * scale_of(&there).max(facts::of(&there).step.unwrap_or_default())
    };
    if real.channels.iter().any(|(_, values)| is_far(values)) { rows } else { Vec::new() }
}

/// Marks these rows as missing.
pub(super) fn without<'a>(real: &'a Recording, rows: &[usize]) -> Cow<'a, Recording> {
    if rows.is_empty() {
        return Cow::Borrowed(real);
    }
    let mut other = real.clone();
    if other.time_s.len() != other.len() {
        // Stamps belong to the present samples.
        let there: Vec<usize> = (0..real.len()).filter(|t| !real.is_missing(*t)).collect();
        let kept = there.iter().zip(&real.time_s).filter(|(t, _)| rows.binary_search(t).is_err());
        other.time_s = kept.map(|(_, time_s)| *time_s).collect();
    }
    other.missing.resize(other.len(), false);
    rows.iter().for_each(|row| other.missing[*row] = true);
    Cow::Owned(other)
}

/// Returns a note with their number, the place of the first, and the action taken; `None` if there is none.
pub(super) fn note(rows: &[usize], rate_hz: f64) -> Option<String> {
    let first_s = *rows.first()? as f64 / rate_hz;
    let count = rows.len();
    let (rows, hold, count_as) = if count == 1 { ("row", "holds", "counts") } else { ("rows", "hold", "count") };
    Some(format!(
        "{count} {rows} {hold} 0 on every channel, the first at {first_s:.2} s: no sensor at its level sends that, so {} {count_as} as missing",
        if count == 1 { "it" } else { "they" }
    ))
}
