//! Comparing: how far the numbers of a cause differ from those of the matching effect.

use super::fit::{intervals_of, stated_intervals};
use super::key::{Key, TrueEffect};
use super::kind::Kind;
use super::report::{Cause, entries};
use serde_json::Value;
use std::collections::BTreeMap;

/// Returns the stated number nearest to a true one, and its difference.
fn nearest(truth: f64, stated: impl IntoIterator<Item = f64>) -> Option<f64> {
    stated.into_iter().map(|stated| (stated - truth).abs()).min_by(f64::total_cmp)
}

/// Returns the numbers of this name in a list of entries.
fn numbers<'a>(entries: &'a [Value], name: &'a str) -> impl Iterator<Item = f64> + 'a {
    entries.iter().filter_map(move |entry| entry[name].as_f64())
}

/// Collects errors of place of a cause that matches an effect, by their kind: `frequency_bins`, `at_s`, `edge_s`.
pub(super) fn locate(truth: &TrueEffect, cause: &Cause, key: &Key, into: &mut BTreeMap<&'static str, Vec<f64>>) {
    let bins = key.samples as f64 / key.rate_hz;
    for (channel, parameters) in truth.meant(cause.sense) {
        let (truths, stated) = (entries(parameters), cause.entries(channel));
        if stated.is_empty() {
            continue;
        }
        for (name, place, unit) in [
            ("frequency_hz", "frequency_bins", bins),
            ("fundamental_hz", "frequency_bins", bins),
            ("at_s", "at_s", 1.0),
        ] {
            for one in numbers(truths, name) {
                into.entry(place).or_default().extend(nearest(one, numbers(stated, name)).map(|off| off * unit));
            }
        }
    }
    let (truths, stated) = (intervals_of(truth, cause), stated_intervals(cause));
    for [from, to] in truths {
        // Each end is compared with that of the nearest interval.
        let edges = [(from, 0), (to, 1)];
        let off =
            edges.into_iter().filter_map(|(time, end)| nearest(time, stated.iter().map(|interval| interval[end])));
        into.entry("edge_s").or_default().extend(off);
    }
}

/// Parameters that state a place or are free, and are not compared as sizes.
const NO_SIZES: [&str; 7] = ["frequency_hz", "fundamental_hz", "at_s", "from_s", "to_s", "reference_c", "order"];

/// Collects relative errors of a cause's parameters.
pub(super) fn compare(truth: &TrueEffect, cause: &Cause, key: &Key, into: &mut BTreeMap<String, Vec<f64>>) {
    let relative = |stated: f64, truth: f64| (truth != 0.0).then(|| (stated.abs() / truth.abs() - 1.0).abs());
    for (channel, parameters) in truth.meant(cause.sense) {
        for one in entries(parameters) {
            let stated = cause.entries(channel);
            let Some(stated) = alike(one, stated, key).map(|at| &stated[at]) else { continue };
            let Some(one) = one.as_object() else { continue };
            for (name, value) in one.iter().filter(|(name, _)| !NO_SIZES.contains(&name.as_str())) {
                let pairs: Vec<(f64, f64)> = match (value.as_f64(), value.as_array()) {
                    (Some(truth), _) => stated[name].as_f64().map(|stated| (stated, truth)).into_iter().collect(),
                    (None, Some(list)) if name == "amplitudes" => {
                        let stated = stated[name].as_array().map_or(&[][..], Vec::as_slice);
                        list.iter()
                            .zip(stated)
                            .filter_map(|(truth, stated)| stated.as_f64().zip(truth.as_f64()))
                            .collect()
                    }
                    _ => Vec::new(),
                };
                let errors = pairs.into_iter().filter_map(|(stated, truth)| relative(stated, truth));
                into.entry(name.clone()).or_default().extend(errors);
            }
        }
    }
    into.retain(|_, errors| !errors.is_empty());
}

/// Returns whether a number's interval is not compared with the truth, because the forms of cases differ: sizes of
/// spikes are spread evenly over another range, bursts and louder intervals have soft ends, and the temperature at
/// which an effect is zero is free.
fn is_of_another_form(kind: Kind, name: &str) -> bool {
    match kind {
        Kind::Spikes => name == "amplitude",
        Kind::Bursts => name == "sigma",
        Kind::VarianceInterval => name != "factor",
        _ => name == "reference_c",
    }
}

/// Returns how many intervals of a cause's numbers contain the true ones, and the number of intervals. A stated entry
/// is compared with the nearest true one, and only if it is also the nearest to that one.
pub(super) fn intervals_held(truth: &TrueEffect, cause: &Cause, key: &Key) -> [usize; 2] {
    let mut held = [0; 2];
    for (channel, parameters) in truth.meant(cause.sense) {
        let (truths, stated, intervals) =
            (entries(parameters), cause.entries(channel), entries(&cause.uncertainty[channel]));
        for (at, (one, intervals)) in stated.iter().zip(intervals).enumerate() {
            let Some(truth_of) = alike(one, truths, key).map(|at| &truths[at]) else { continue };
            if alike(truth_of, stated, key) != Some(at) {
                continue;
            }
            for (name, ends) in intervals.as_object().into_iter().flatten() {
                let ends = ends[0].as_f64().zip(ends[1].as_f64()).filter(|_| !is_of_another_form(truth.kind, name));
                if let (Some(value), Some((low, high))) = (truth_of[name].as_f64(), ends) {
                    // It cannot be determined which sign of a shared source is the positive one.
                    let other = (truth.kind == Kind::CommonMode).then_some(-value);
                    held[1] += 1;
                    held[0] += usize::from([Some(value), other].iter().flatten().any(|own| (low..=high).contains(own)));
                }
            }
        }
    }
    held
}

/// Distance of two frequencies of one line, in widths of a Fourier bin; for a resonance, its own width is added.
const BINS: f64 = 4.0;
/// Distance of two times of one step, as a part of the record.
const STEP_PART: f64 = 0.02;

/// Returns the place of the stated entry for this true one: the first one for effects without a place, or the nearest
/// in frequency or time.
fn alike(truth: &Value, stated: &[Value], key: &Key) -> Option<usize> {
    let place = ["frequency_hz", "fundamental_hz", "at_s", "from_s"].into_iter().find(|name| truth[*name].is_f64());
    let Some(place) = place else { return (!stated.is_empty()).then_some(0) };
    let wanted = truth[place].as_f64()?;
    let off = |(at, entry): (usize, &Value)| Some(((entry[place].as_f64()? - wanted).abs(), at));
    let best = stated.iter().enumerate().filter_map(off).min_by(|one, other| one.0.total_cmp(&other.0))?;
    // A line or a step that was not found is not compared with another one.
    let length_s = key.samples as f64 / key.rate_hz;
    let near = match place {
        "at_s" => STEP_PART * length_s,
        "from_s" => f64::INFINITY,
        _ => BINS / length_s + truth["bandwidth_hz"].as_f64().unwrap_or(0.0),
    };
    (best.0 <= near).then_some(best.1)
}
