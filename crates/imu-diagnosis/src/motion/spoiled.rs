//! Spoiled: samples that no longer show the motion, because the sensor's range cut them off or because the row before was sent
//! again.
//!
//! Both look like something else beside a reference. Peaks that are cut off make scale factors smaller, and rows that repeat
//! make a sensor late. They are found before anything is fitted, by the values alone ([`crate::facts`]).

use super::rows::{Rows, rows};
use crate::facts;
use crate::recording::Recording;
use crate::report::{Hint, HintKind};
use imu_core::sample::{Channel, Triad};

/// A channel counts as cut off from this number of samples on: fewer do no harm.
const CUT_LEAST: usize = 8;
/// How many times as frequent as any of the values just inside a limit is, and the number of those.
const CUT_OVER: usize = 3;
const INSIDE: usize = 10;
/// Part of the rows that may repeat: fewer move a delay by less than its interval.
const REPEATED_MOST: f64 = 0.03;
/// Nats by which repeats have to be more than chance.
const REPEATED_NATS: f64 = 12.0;
/// Rows on either side of one that was cut off which are left out with it: the hole is then a gap, over which nothing is interpolated.
const BESIDE: usize = 2;

/// Returns the rows of these triads as [`rows`] does, without those in which the range cut the gyroscope off, and states where that is.
pub fn rows_in_range(real: &Recording, triads: &[Triad]) -> (Rows, Vec<Hint>) {
    let spoiled = Spoiled::of(real);
    let (all, out) = (rows(real, triads), spoiled.gyro(real.len()));
    let mut kept = Rows { triads: vec![Vec::new(); triads.len()], ..Rows::default() };
    for (at, place) in all.places.iter().enumerate().filter(|(_, place)| !out[**place]) {
        kept.time_s.push(all.time_s[at]);
        kept.places.push(*place);
        kept.triads.iter_mut().zip(&all.triads).for_each(|(kept, all)| kept.push(all[at]));
    }
    let is_of_gyro =
        |of: &Hint| of.kind == HintKind::Range && Triad::Gyro.channels().iter().any(|own| own.name() == of.about);
    (kept, spoiled.hints(real.len()).into_iter().filter(is_of_gyro).collect())
}

/// A channel that its range cut off.
#[derive(Debug, Clone, PartialEq)]
struct Cut {
    channel: Channel,
    /// The least and the greatest value, where these are limits.
    ends: [Option<f64>; 2],
    places: Vec<usize>,
}

/// Rows of a triad that repeat.
#[derive(Debug, Clone, PartialEq)]
struct Repeated {
    triad: Triad,
    share: f64,
    places: Vec<usize>,
}

/// The spoiled samples of a recording.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Spoiled {
    cut: Vec<Cut>,
    repeated: Vec<Repeated>,
}

impl Spoiled {
    /// Finds what is spoiled in the gyroscope and the accelerometer.
    pub(super) fn of(real: &Recording) -> Self {
        let mut found = Self::default();
        let there: Vec<usize> = (0..real.len()).filter(|place| !real.is_missing(*place)).collect();
        for triad in [Triad::Gyro, Triad::Accel] {
            let columns: Vec<(Channel, Vec<f64>)> = triad
                .channels()
                .into_iter()
                .filter_map(|channel| Some((channel, real.values(channel)?)))
                .map(|(channel, values)| (channel, there.iter().map(|place| values[*place]).collect()))
                .collect();
            if columns.iter().any(|(_, values)| values.iter().any(|value| !value.is_finite())) {
                continue;
            }
            found.cut.extend(columns.iter().filter_map(|(channel, values)| cut(*channel, values, &there)));
            found.repeated.extend(repeated(triad, &columns, &there));
        }
        found
    }

    /// Returns whether rows of a triad repeat.
    pub(super) fn repeats(&self, triad: Triad) -> bool {
        self.repeated.iter().any(|of| of.triad == triad)
    }

    /// Returns, for each place, whether its row is left out: it repeats, or the gyroscope was cut off there or nearby.
    pub(super) fn rows(&self, count: usize) -> Vec<bool> {
        let mut out = vec![false; count];
        self.repeated.iter().for_each(|of| of.held(&mut out));
        self.near(Triad::Gyro, &mut out);
        out
    }

    /// Returns, for each place, whether the gyroscope was cut off there or nearby.
    fn gyro(&self, count: usize) -> Vec<bool> {
        let mut out = vec![false; count];
        self.near(Triad::Gyro, &mut out);
        out
    }

    /// Returns, for each place, whether the accelerometer was cut off there or nearby.
    pub(super) fn accel(&self, count: usize) -> Vec<bool> {
        let mut out = vec![false; count];
        self.near(Triad::Accel, &mut out);
        out
    }

    fn near(&self, triad: Triad, out: &mut [bool]) {
        for place in self.cut.iter().filter(|of| triad.channels().contains(&of.channel)).flat_map(|of| &of.places) {
            let to = (place + BESIDE + 1).min(out.len());
            out[place.saturating_sub(BESIDE)..to].fill(true);
        }
    }

    /// Returns what comes before everything that was fitted.
    pub(super) fn hints(&self, samples: usize) -> Vec<Hint> {
        let cut = self.cut.iter().map(|of| {
            let ends: Vec<String> = of.ends.iter().flatten().map(|end| format!("{end:.4}")).collect();
            let (count, share) = (of.places.len(), 100.0 * of.places.len() as f64 / samples.max(1) as f64);
            Hint {
                about: of.channel.name().to_owned(),
                kind: HintKind::Range,
                text: format!(
                    "{} is cut off at {} {} ({count} samples, {share:.1} %): choose a larger range; what is near was left out",
                    of.channel.name(),
                    ends.join(" and "),
                    of.channel.unit()
                ),
            }
        });
        let repeated = self.repeated.iter().map(|of| Hint {
            about: of.triad.name().to_owned(),
            kind: HintKind::Repeats,
            text: format!(
                "{:.0} % of the {}'s rows repeat the row before: record at the sensor's own rate; the repeats were left out, and a delay \
                 has no number",
                100.0 * of.share,
                if of.triad == Triad::Gyro { "gyroscope" } else { "accelerometer" }
            ),
        });
        cut.chain(repeated).collect()
    }
}

impl Repeated {
    /// Marks the repeats, but one of each stretch that is twice as long as the share lets expect: there the sensor rested.
    fn held(&self, out: &mut [bool]) {
        let most = (2.0 / (1.0 - self.share).max(0.01)).ceil() as usize;
        let mut run = 0;
        let mut before = None;
        for place in &self.places {
            run = if before == place.checked_sub(1) { run + 1 } else { 1 };
            before = Some(*place);
            out[*place] |= run % most != 0;
        }
    }
}

/// Returns the channel's limits: values at its ends that are far more frequent than those just inside. A motion passes a value quickly, and
/// only a limit holds it there.
fn cut(channel: Channel, values: &[f64], there: &[usize]) -> Option<Cut> {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let counts: Vec<(f64, usize)> = sorted.chunk_by(|one, other| one == other).map(|of| (of[0], of.len())).collect();
    let limit = |inwards: &mut dyn Iterator<Item = &(f64, usize)>| {
        let (end, count) = *inwards.next()?;
        let inside = inwards.take(INSIDE).map(|(_, count)| *count).max()?;
        (count >= CUT_LEAST && count > CUT_OVER * inside).then_some(end)
    };
    let ends = [limit(&mut counts.iter()), limit(&mut counts.iter().rev())];
    let is_cut = |value: f64| ends.iter().flatten().any(|end| *end == value);
    let places: Vec<usize> =
        there.iter().zip(values).filter(|(_, value)| is_cut(**value)).map(|(place, _)| *place).collect();
    (!places.is_empty()).then_some(Cut { channel, ends, places })
}

fn repeated(triad: Triad, columns: &[(Channel, Vec<f64>)], there: &[usize]) -> Option<Repeated> {
    // One channel alone repeats whenever it is still and rounded.
    if columns.len() < 3 {
        return None;
    }
    let values: Vec<&[f64]> = columns.iter().map(|(_, values)| values.as_slice()).collect();
    let found = facts::repeats(&values);
    let share = found.sent_again() / there.len().max(1) as f64;
    let places = found.places.into_iter().filter_map(|at| there.get(at).copied()).collect();
    (share > REPEATED_MOST && found.gain > REPEATED_NATS).then_some(Repeated { triad, share, places })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a gyroscope that is turned and rests at the end, rounded to `step`.
    fn turned(step: f64) -> Recording {
        let value = |axis: usize, t: usize| {
            let (time_s, axis) = (t as f64 * 0.01, axis as f64);
            let moved = if t < 4000 { (1.1 + 0.3 * axis) * ((1.0 + 0.37 * axis) * time_s + axis).sin() } else { 0.0 };
            // A noise that never repeats: the fractional part of multiples of an irrational number.
            let noise = (((t * 3 + axis as usize) as f64 * 0.754_877_666).fract() - 0.5) * 4e-3;
            ((moved + noise) / step).round() * step
        };
        let channel = |(axis, channel)| (channel, (0..6000).map(|t| value(axis, t)).collect());
        let channels = Triad::Gyro.channels().into_iter().enumerate().map(channel).collect();
        Recording { rate_hz: 100.0, channels, ..Recording::default() }
    }

    #[test]
    fn a_turned_and_rounded_sensor_is_not_spoiled() {
        for step in [1e-9, 1e-3, 2e-3] {
            assert_eq!(Spoiled::of(&turned(step)), Spoiled::default(), "{step}");
        }
    }

    #[test]
    fn a_range_that_cuts_off_is_found_and_what_is_near_it_is_left_out() {
        let mut real = turned(1e-3);
        real.channels[1].1.iter_mut().for_each(|value| *value = value.clamp(-1.25, 1.25));
        let found = Spoiled::of(&real);
        assert_eq!(found.cut.len(), 1);
        assert_eq!((found.cut[0].channel, found.cut[0].ends), (Channel::GyroY, [Some(-1.25), Some(1.25)]));
        let rows = found.rows(6000);
        for place in &found.cut[0].places {
            assert!(rows[*place] && rows[place - 2] && rows[place + 2]);
        }
        let text = &found.hints(6000)[0].text;
        assert!(text.starts_with("gyro_y is cut off at -1.2500 and 1.2500 rad/s ("), "{text}");
    }

    #[test]
    fn rows_that_are_sent_again_are_found_and_left_out() {
        let mut real = turned(1e-9);
        for (_, values) in &mut real.channels {
            (0..6000).for_each(|place| values[place] = values[place - place % 3]);
        }
        let found = Spoiled::of(&real);
        assert!(found.repeats(Triad::Gyro) && found.cut.is_empty(), "{found:?}");
        let rows = found.rows(6000);
        assert_eq!(rows.iter().filter(|out| **out).count(), 4000);
        assert!(!rows[3] && rows[4] && rows[5] && !rows[6]);
        assert!(found.hints(6000)[0].text.starts_with("67 % of the gyroscope's rows repeat"));
    }
}
