//! Doubts: units that the values contradict. A doubt never causes a conversion: it is reported, with its reason and the
//! name that the column would have.
//!
//! The judgement uses known physical facts. Gravity is 9.8 m/s² wherever |a| hardly changes, and the Earth's field is
//! 0.25 to 0.65 gauss. A gyro turns as far as the accelerometer sees gravity turn, and at rest it is quieter than 0.03
//! rad/s. A doubt needs values that a right unit cannot have; without rest or turning there is none. Pure.

use super::findings::Doubt;
use super::info::Conversion;
use super::names::suffixes;
use super::values::{STD_OF_SPREAD, Values, median_and_spread};
use imu_core::sample::Triad;
use imu_core::units::{RAD_PER_DEG, STANDARD_GRAVITY_M_S2};
use std::ops::Range;

/// Fewer samples are not judged.
const LEAST_SAMPLES: usize = 32;
/// |a| is that of gravity if most samples lie this near the median.
const STEADY: f64 = 0.03;
/// The range of gravity that a sensor at rest may measure, relative to gravity.
const GRAVITY: Range<f64> = 0.85..1.15;
/// The range of the Earth's field from the equator to the poles, gauss.
const EARTH_FIELD_GAUSS: Range<f64> = 0.25..0.65;
/// The range of an indoor or uncalibrated field, gauss.
const FIELD_GAUSS: Range<f64> = 0.1..2.5;
/// At rest every axis of the accelerometer is steady to this share of gravity.
const REST: f64 = 0.01;
/// No gyro in use is noisier than this at rest, rad/s: an ADIS16405 has 0.016, a VN-100 0.001.
const REST_NOISE_RAD_S: f64 = 0.03;
/// A VN-100 measures up to 35 rad/s.
const RATE_MAX_RAD_S: f64 = 40.0;
/// The share of the samples that must exceed [`RATE_MAX_RAD_S`].
const FAST_SHARE: f64 = 0.01;
/// The minimum number of turns to compare, and how well their directions must agree.
const LEAST_TURNS: u64 = 5;
const AGREEMENT: f64 = 0.8;
/// A ratio within this factor of the expected one counts as equal to it.
const RATIO_WITHIN: f64 = 1.6;

/// Returns the units that these values contradict. `turned_s` is the time unit of the turning's angles, in s: the
/// period if there are no stamps, else 1 s.
pub(super) fn doubts(values: &Values, conversions: &[Conversion], turned_s: f64) -> Vec<Doubt> {
    [gravity(values, conversions), field(values, conversions), rotation(values, conversions, turned_s)]
        .into_iter()
        .flatten()
        .collect()
}

/// Returns the stated unit of a triad's columns, with its factor; `None` if they differ.
fn stated_unit(triad: Triad, conversions: &[Conversion]) -> Option<(&'static str, f64)> {
    let mut units = triad.channels().into_iter().map(|channel| {
        let converted = conversions.iter().find(|conversion| conversion.channel == channel);
        converted.map_or((channel.unit(), 1.0), |conversion| (conversion.original_unit, conversion.factor))
    });
    let first = units.next()?;
    units.all(|other| other == first).then_some(first)
}

/// Returns the lengths of a triad's vectors.
fn lengths(values: &Values, triad: Triad) -> Vec<f64> {
    let channels = triad.channels();
    let length = |sample: &imu_core::sample::Sample| {
        let squares: Option<f64> = channels.iter().map(|channel| sample.get(*channel).map(|value| value * value)).sum();
        squares.map(f64::sqrt)
    };
    // The square of a value that no sensor sends may be beyond all numbers.
    values.spread.iter().filter_map(length).filter(|length| length.is_finite()).collect()
}

/// Returns the unit, with its suffix, in which this number satisfies `fits` in the channel's unit.
fn fitting(triad: Triad, written: f64, fits: impl Fn(f64) -> bool) -> Option<(&'static str, &'static str)> {
    let [first, ..] = triad.channels();
    let found = suffixes(first).iter().find(|(_, _, factor)| fits(written * factor))?;
    Some((found.0, found.1))
}

fn gravity(values: &Values, conversions: &[Conversion]) -> Option<Doubt> {
    let (unit, factor) = stated_unit(Triad::Accel, conversions)?;
    let lengths = lengths(values, Triad::Accel);
    let count = lengths.len();
    let (length, spread) = median_and_spread(lengths).filter(|(length, _)| count >= LEAST_SAMPLES && *length > 0.0)?;
    let is_gravity = |length: f64| GRAVITY.contains(&(length / STANDARD_GRAVITY_M_S2));
    if is_gravity(length) || spread > STEADY * length {
        return None;
    }
    let written = length / factor;
    let found = fitting(Triad::Accel, written, is_gravity);
    let reason = format!(
        "|a| is {} {unit} and hardly changes (half of the samples within {:.1} %), where gravity is {} {unit}",
        shown(written),
        100.0 * spread / length,
        shown(STANDARD_GRAVITY_M_S2 / factor)
    );
    Some(Doubt::new("accel", unit, found, reason))
}

fn field(values: &Values, conversions: &[Conversion]) -> Option<Doubt> {
    let (unit, factor) = stated_unit(Triad::Mag, conversions)?;
    let lengths = lengths(values, Triad::Mag);
    let count = lengths.len();
    let (length, _) = median_and_spread(lengths).filter(|_| count >= LEAST_SAMPLES)?;
    if FIELD_GAUSS.contains(&length) {
        return None;
    }
    let written = length / factor;
    let found = fitting(Triad::Mag, written, |gauss| EARTH_FIELD_GAUSS.contains(&gauss))?;
    let reason = format!(
        "|m| is {} {unit}, where the Earth's field is {} to {} {unit}",
        shown(written),
        shown(EARTH_FIELD_GAUSS.start / factor),
        shown(EARTH_FIELD_GAUSS.end / factor)
    );
    Some(Doubt::new("mag", unit, Some(found), reason))
}

fn rotation(values: &Values, conversions: &[Conversion], turned_s: f64) -> Option<Doubt> {
    let (unit, factor) = stated_unit(Triad::Gyro, conversions)?;
    let degrees = Some(("_deg_s", "deg/s"));
    let is_near = |ratio: f64, expected: f64| (ratio / expected).ln().abs() < RATIO_WITHIN.ln();
    let turns = &values.turning.turns;
    let compared = turns.ratio().filter(|(_, agreement)| turns.count >= LEAST_TURNS && *agreement > AGREEMENT);
    let ratio = compared.map(|(ratio, _)| ratio / turned_s).filter(|ratio| *ratio > 0.0);
    let turned = |ratio: f64| {
        let seen = if ratio < 1.0 {
            format!("{} times less", shown(1.0 / ratio))
        } else {
            format!("{} times more", shown(ratio))
        };
        format!("in {} turns gravity's direction turned {seen} than the gyro says in {unit}", turns.count)
    };
    if factor == 1.0 {
        if let Some(ratio) = ratio.filter(|ratio| is_near(*ratio, RAD_PER_DEG)) {
            return Some(Doubt::new("gyro", unit, degrees, turned(ratio)));
        }
        // A gyro that agrees with gravity is right, however large its values.
        if ratio.is_some_and(|ratio| is_near(ratio, 1.0)) {
            return None;
        }
        let fast = |sample: &imu_core::sample::Sample| {
            Triad::Gyro
                .channels()
                .into_iter()
                .any(|axis| sample.get(axis).is_some_and(|rate| rate.abs() > RATE_MAX_RAD_S))
        };
        let share =
            values.spread.iter().filter(|sample| fast(sample)).count() as f64 / values.spread.len().max(1) as f64;
        if values.spread.len() >= LEAST_SAMPLES && share > FAST_SHARE {
            let reason = format!(
                "{:.0} % of the samples are above {RATE_MAX_RAD_S} rad/s, more than a VN-100 can tell",
                100.0 * share
            );
            return Some(Doubt::new("gyro", unit, degrees, reason));
        }
        let noise = noise_at_rest(values)?;
        let reason = format!("at rest its noise is {} {unit}, more than any such gyro has", shown(noise));
        return (noise > REST_NOISE_RAD_S).then(|| Doubt::new("gyro", unit, degrees, reason));
    }
    let ratio = ratio.filter(|ratio| is_near(*ratio, 1.0 / RAD_PER_DEG))?;
    Some(Doubt::new("gyro", unit, Some(("_rad_s", "rad/s")), turned(ratio)))
}

/// Returns the gyro's noise, rad/s, if the accelerometer shows that the sensor rests most of the time. The sensor may
/// still turn about the vertical. So noise is the disagreement of three neighbouring samples, on the median axis.
fn noise_at_rest(values: &Values) -> Option<f64> {
    let spreads = |triad: Triad| -> Option<Vec<(f64, f64)>> {
        let of = |channel| Some(values.of(channel)).filter(|of| of.len() >= LEAST_SAMPLES).and_then(median_and_spread);
        triad.channels().into_iter().map(of).collect()
    };
    let accel = spreads(Triad::Accel)?;
    let length = accel.iter().map(|(median, _)| median * median).sum::<f64>().sqrt();
    if length == 0.0 || !length.is_finite() || accel.iter().any(|(_, spread)| *spread > REST * length) {
        return None;
    }
    let mut axes = [0, 1, 2].map(|axis| {
        let bends: Vec<f64> = values.bends.iter().flatten().map(|bend| bend[axis].abs()).collect();
        (bends.len() >= LEAST_SAMPLES).then(|| median_and_spread(bends)).flatten().map_or(0.0, |(median, _)| median)
    });
    axes.sort_unstable_by(f64::total_cmp);
    // The variance of x − 2y + z is six times that of each.
    Some(STD_OF_SPREAD * axes[1] / 6_f64.sqrt())
}

/// Returns a number with four digits, for display.
pub(super) fn shown(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let magnitude = value.abs().log10().floor() as i32;
    if !(-3..7).contains(&magnitude) {
        let text = format!("{value:.3e}");
        return match text.split_once('e') {
            Some((digits, exponent)) => format!("{}e{exponent}", without_zeros(digits)),
            None => text,
        };
    }
    let decimals = usize::try_from(3 - magnitude).unwrap_or(0);
    without_zeros(&format!("{value:.decimals$}")).to_owned()
}

fn without_zeros(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}
