//! Pairs: causes that one record cannot distinguish, and the measurement that would distinguish them. They are reported
//! as notes, and for lines as evidence.

use super::found::{Attribution, Found};
use super::recording::Recording;
use imu_core::sample::{Channel, Triad};
use imu_model::effects::{Effect, EffectKind};
use std::collections::BTreeSet;

/// Two courses with at least this correlation are one to a fit.
const SAME_COURSE: f64 = 0.98;
/// Mains frequencies and twice these frequencies, Hz.
const MAINS_HZ: [f64; 4] = [50.0, 60.0, 100.0, 120.0];
/// Mains wander by this part of their frequency.
const MAINS_WANDER: f64 = 1e-3;
/// Gravity, m/s²: an axis with at least this part of it does not feel a tilt.
const UPRIGHT: f64 = 9.0;

/// Returns the possible sources of a line: frequencies that sampling folds to it, and mains frequencies among them.
pub(super) fn of_line(channel: Channel, effect: &dyn Effect, rate_hz: f64) -> Option<String> {
    let frequency_hz = frequency_of(effect)?;
    let folded = [rate_hz - frequency_hz, rate_hz + frequency_hz, 2.0 * rate_hz - frequency_hz];
    let folded = folded.map(|hz| format!("{hz:.3}")).join(", ");
    let mains = mains(frequency_hz, rate_hz).map_or_else(String::new, |mains| format!("; {mains} would appear there"));
    Some(format!("{channel}: {frequency_hz:.3} Hz may be folded down from {folded} … Hz{mains}"))
}

/// Returns the mains that sampling folds to a frequency.
fn mains(frequency_hz: f64, rate_hz: f64) -> Option<String> {
    let near = |mains: &f64| {
        let seen_hz = (mains - (mains / rate_hz).round() * rate_hz).abs();
        *mains > 0.5 * rate_hz && (seen_hz - frequency_hz).abs() < MAINS_WANDER * mains
    };
    let found: Vec<String> = MAINS_HZ.iter().filter(|hz| near(hz)).map(f64::to_string).collect();
    (!found.is_empty()).then(|| format!("mains of {} Hz", found.join(" or ")))
}

/// Returns a sentence for each pair that the record leaves open.
pub(super) fn notes(found: &Found, attributions: &[Attribution], real: &Recording) -> Vec<String> {
    let mut notes = Vec::new();
    let with = |kinds: &[EffectKind]| -> Vec<&Attribution> {
        attributions.iter().filter(|one| kinds.contains(&one.effect.kind())).collect()
    };
    let lines = with(&[EffectKind::Tone, EffectKind::Comb, EffectKind::Resonance]);
    if !lines.is_empty() {
        notes.push(format!(
            "tone or folded tone: at {} Hz alone a line of higher frequency that folds down to one named here looks the same; \
             a record at another output rate tells: a true one stays, a folded one moves",
            (real.rate_hz * 1e4).round() / 1e4
        ));
        for one in &lines {
            let frequency_hz = frequency_of(&*one.effect);
            let Some(frequency_hz) = frequency_hz else { continue };
            if let Some(mains) = mains(frequency_hz, real.rate_hz) {
                notes.push(format!("{mains} would appear where {} has its line of {frequency_hz:.3} Hz", one.channel));
            }
        }
    }
    let drifts = with(&[EffectKind::TemperatureBias, EffectKind::RateRamp, EffectKind::WarmUp]);
    let time = [drifts.clone(), with(&[EffectKind::VarianceChange])].concat();
    let read = real.temperature_c.as_ref().filter(|read| read.len() == real.len());
    match read {
        None if !drifts.is_empty() => notes.push(format!(
            "{} or temperature on {}: the temperature was not recorded",
            effects(&drifts),
            channels(&drifts)
        )),
        Some(read) if !time.is_empty() => {
            if let Some((course, correlation)) = follows(read) {
                notes.push(format!(
                    "temperature or time on {}: the temperature follows {course} (correlation {correlation:.3}), so that \
                     temperature, ramp and warm-up look the same; a record with another course of temperature tells",
                    channels(&time)
                ));
            }
        }
        _ => {}
    }
    let level = |channel: Channel| {
        found.channels.iter().find(|of| of.prepared.channel == channel).map_or(0.0, |of| of.prepared.level)
    };
    let tilts = |one: &&Attribution| one.channel.triad() == Some(Triad::Accel) && level(one.channel).abs() < UPRIGHT;
    let tilted: Vec<&Attribution> =
        with(&[EffectKind::RateRamp, EffectKind::WarmUp, EffectKind::BiasStep]).into_iter().filter(tilts).collect();
    if !tilted.is_empty() {
        notes.push(format!(
            "{} or tilt on {}: a support that tilts by a ten-millionth of a turn moves these by 6e-6 m/s²; a record in \
             another place tells",
            effects(&tilted),
            channels(&tilted)
        ));
    }
    let shared = with(&[EffectKind::CommonMode]);
    if !shared.is_empty() {
        notes.push(format!(
            "common_mode or motion on {}: a support that shakes is seen by several axes alike; a record on another one tells",
            channels(&shared)
        ));
    }
    for one in with(&[EffectKind::Spikes]) {
        let white = found.channels.iter().find(|of| of.prepared.channel == one.channel).map_or(0.0, |of| of.white);
        let often = one.effect.number("rate_hz").is_some_and(|rate_hz| rate_hz > 0.002 * real.rate_hz);
        if often && one.effect.number("amplitude").is_some_and(|size| size < 6.0 * white) {
            notes.push(format!(
                "spikes or heavy_tails on {}: frequent ones that small are both; a longer record tells",
                one.channel
            ));
        }
    }
    notes
}

fn frequency_of(effect: &dyn Effect) -> Option<f64> {
    effect.number("frequency_hz").or(effect.number("fundamental_hz"))
}

fn effects(of: &[&Attribution]) -> String {
    let names: BTreeSet<&str> = of.iter().map(|one| one.effect.name()).collect();
    names.into_iter().collect::<Vec<_>>().join(", ")
}

fn channels(of: &[&Attribution]) -> String {
    let all: BTreeSet<Channel> = of.iter().map(|one| one.channel).collect();
    all.into_iter().map(Channel::name).collect::<Vec<_>>().join(", ")
}

/// Returns the function of time that a temperature follows, if there is one: a straight line or an exponential.
fn follows(read: &[f64]) -> Option<(&'static str, f64)> {
    /// Time constants that are tried, in lengths of the record.
    const CONSTANTS: [f64; 7] = [0.03, 0.06, 0.1, 0.2, 0.3, 0.5, 1.0];
    let n = read.len() as f64;
    let along = |course: &dyn Fn(f64) -> f64| {
        let (mut sums, mut count) = ([0.0; 5], 0.0);
        for (t, y) in read.iter().enumerate().filter(|(_, y)| y.is_finite()) {
            // Relative to the first reading, so that small changes keep their digits.
            let (x, y) = (course(t as f64 / n), y - read.iter().copied().find(|y| y.is_finite()).unwrap_or(0.0));
            for (sum, of) in sums.iter_mut().zip([x, y, x * x, y * y, x * y]) {
                *sum += of;
            }
            count += 1.0;
        }
        let [x, y, xx, yy, xy] = sums.map(|sum| sum / f64::max(count, 1.0));
        let (vx, vy) = (xx - x * x, yy - y * y);
        if vx > 0.0 && vy > 0.0 { ((xy - x * y) / (vx * vy).sqrt()).abs() } else { 0.0 }
    };
    let straight = ("time", along(&|x| x));
    let bent = CONSTANTS.map(|tau| ("an exponential of time", along(&|x| (-x / tau).exp())));
    let best = bent.into_iter().fold(straight, |best, one| if one.1 > best.1 + 0.005 { one } else { best });
    (best.1 > SAME_COURSE).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::Tone;

    #[test]
    fn a_temperature_that_follows_time_is_reported_and_one_with_a_course_of_its_own_is_not() {
        let read = |course: &dyn Fn(f64) -> f64| -> Vec<f64> {
            (0..5000).map(|t| (10.0 * course(f64::from(t) / 5000.0)).round() / 10.0).collect()
        };
        assert_eq!(follows(&read(&|x| 25.0 + 3.0 * x)).unwrap().0, "time");
        assert_eq!(follows(&read(&|x| 30.0 - 4.0 * (-8.0 * x).exp())).unwrap().0, "an exponential of time");
        assert_eq!(follows(&read(&|x| 25.0 + (9.0 * x).sin())), None);
        assert_eq!(follows(&read(&|_| 25.0)), None);
    }

    #[test]
    fn a_line_is_reported_with_what_folds_there() {
        let of = |frequency_hz: f64| of_line(Channel::MagX, &Tone { frequency_hz, amplitude: 1.0 }, 40.0).unwrap();
        let mains = of(19.98);
        assert!(mains.contains("20.020, 59.980, 60.020 … Hz; mains of 60 or 100 Hz would appear there"), "{mains}");
        assert!(!of(7.93).contains("mains"));
    }
}
