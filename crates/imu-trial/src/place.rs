//! Places: where the effects of a case lie, and whether a diagnosis reports these places.
//!
//! A cause is placed if two conditions hold. Each channel that the cause shares with the effect has a place of the
//! cause that overlaps the effect's band and time there. No place of the cause lies on a channel without the effect.
//! For a line, a resonance, a step, a burst or a louder interval, the place must state the band or the time, and must
//! not be much wider. A place of a cause or of a remainder is false if it lies on a channel without an effect in which
//! sensor and model differ; places of parameters are never false. If a report does not state the owners of its places,
//! all of them may belong to any cause.

use super::class::Sense;
use super::fit::intervals;
use super::key::{Key, TrueEffect};
use super::kind::Kind;
use super::report::{Cause, Of, Place, entries};
use serde_json::Value;

/// Frequencies, Hz, or times, s, from and to.
type Stretch = [f64; 2];

/// A stretch with an effect, and the width of the widest place that counts as locating it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Reach(Stretch, f64);

/// The place of an effect on a channel; none means anywhere.
#[derive(Debug, Clone, Default, PartialEq)]
struct Lies {
    bands_hz: Vec<Reach>,
    times_s: Vec<Reach>,
}

/// Permitted error and extent of a line's place, in widths of a Fourier bin.
const BINS: f64 = 2.0;
const BINS_WIDE: f64 = 4.0;
/// Permitted ratio of a place's width to that of the true stretch.
const WIDER: f64 = 4.0;
/// Widths of a resonance on each side that belong to it.
const WIDTHS: f64 = 2.0;
/// Permitted error of a step's time, in samples and as a part of the record: a step takes up to 20 samples to rise.
const RISE_SAMPLES: f64 = 20.0;
const RISE_PART: f64 = 2e-3;
/// Permitted extent of a step's place on each side, as a part of the record.
const STEP_PART: f64 = 0.01;
/// Corners of a Gauss–Markov process below which it has 95 % of its power: (2/π) atan 12.7.
const CORNERS: f64 = 12.7;
/// Slow courses of the level lie below this part of the rate.
const SLOW: f64 = 0.02;

impl Lies {
    fn of(kind: Kind, entry: &Value, key: &Key) -> Self {
        let number = |name: &str| entry[name].as_f64();
        let length_s = key.samples as f64 / key.rate_hz;
        let about = |middle: f64, off: f64, widest: f64| Reach([middle - off, middle + off], widest);
        let (bin_hz, line_hz) = (BINS / length_s, 2.0 * BINS_WIDE / length_s);
        let mut lies = Self::default();
        match kind {
            Kind::Tone => lies.bands_hz.extend(number("frequency_hz").map(|hz| about(hz, bin_hz, line_hz))),
            Kind::Comb => {
                let count = entry["amplitudes"].as_array().map_or(0, Vec::len);
                let fundamental_hz = number("fundamental_hz").unwrap_or(f64::NAN);
                let line = |times: usize| about(times as f64 * fundamental_hz, bin_hz, line_hz);
                lies.bands_hz.extend((1..=count).map(line));
            }
            Kind::Resonance => {
                let wide_hz = number("bandwidth_hz").unwrap_or(0.0);
                let band = |hz| about(hz, WIDTHS * wide_hz + bin_hz, line_hz.max(WIDER * wide_hz));
                lies.bands_hz.extend(number("frequency_hz").map(band));
            }
            Kind::GaussMarkov => {
                let below = |tc: f64| Reach([0.0, CORNERS / (std::f64::consts::TAU * tc) + bin_hz], f64::INFINITY);
                lies.bands_hz.extend(number("tc_s").map(below));
            }
            Kind::RateRamp | Kind::WarmUp | Kind::TemperatureBias => {
                lies.bands_hz.push(Reach([0.0, SLOW * key.rate_hz], f64::INFINITY));
            }
            Kind::BiasStep => {
                let rise_s = RISE_SAMPLES / key.rate_hz;
                let (off, reach) = (rise_s.max(RISE_PART * length_s), rise_s.max(STEP_PART * length_s));
                lies.times_s.extend(number("at_s").map(|at| about(at, off, 2.0 * reach)));
            }
            Kind::VarianceInterval | Kind::Bursts => {
                let of = |[from, to]: Stretch| Reach([from, to], WIDER * (to - from));
                lies.times_s.extend(intervals(std::slice::from_ref(entry)).into_iter().map(of));
            }
            _ => {}
        }
        lies
    }

    fn is_at(&self, place: &Place) -> bool {
        let meets = |own: &[Reach], stated: Option<Stretch>| {
            let meets = |Reach([begin, end], widest): &Reach| match stated {
                Some([from, to]) => from <= *end && to >= *begin && to - from <= *widest,
                None => widest.is_infinite(),
            };
            own.is_empty() || own.iter().any(meets)
        };
        meets(&self.bands_hz, place.band_hz) && meets(&self.times_s, place.time_s)
    }
}

/// Returns whether a place lies at the place of an effect; for an effect that both have at two places, either counts.
fn lies_at(truth: &TrueEffect, place: &Place, key: &Key) -> bool {
    let declared = truth.declared.iter().flatten();
    let mut on = truth.parameters.iter().chain(declared).filter(|(channel, _)| **channel == place.channel);
    on.any(|(_, entry)| entries(entry).iter().any(|one| Lies::of(truth.kind, one, key).is_at(place)))
}

/// Returns whether a cause that is this effect is placed; `None` if the effect has no channel, or the cause names no
/// channel.
pub fn is_placed(truth: &TrueEffect, cause: &Cause, places: &[Place], key: &Key) -> Option<bool> {
    let of_all = truth.kind.needs_stamps() || cause.channels.is_empty();
    if of_all {
        return None;
    }
    let own = |place: &&Place| place.of == Of::Cause(cause.index) || place.of == Of::Unstated;
    let on = |channel: &String| {
        places.iter().filter(own).any(|place| place.channel == *channel && lies_at(truth, place, key))
    };
    let here = cause.channels.iter().filter(|channel| truth.channels.contains(channel)).all(on);
    let mut own = places.iter().filter(|place| place.of == Of::Cause(cause.index));
    Some(here && own.all(|place| truth.channels.contains(&place.channel)))
}

/// Returns the places on channels on which sensor and model do not differ in an effect.
pub fn false_places<'a>(places: &'a [Place], key: &'a Key) -> impl Iterator<Item = &'a Place> {
    let touched = |channel: &String| {
        let mut differing = key.effects.iter().filter(|effect| effect.sense != Sense::Known);
        differing.any(|effect| effect.kind.needs_stamps() || effect.channels.contains(channel))
    };
    places.iter().filter(move |place| place.of != Of::Parameters && !touched(&place.channel))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Case;
    use crate::class::Sense;
    use crate::recipe::Recipe;
    use serde_json::json;

    fn case(kind: Kind) -> (Key, Cause) {
        let made = (0..).map(|number| Case::make(21, number, &Recipe::lacking(&[kind]), Some(20_000)).unwrap().key());
        let key = made.into_iter().find(|key| key.effects[0].channels.len() < key.channels.len()).unwrap();
        let truth = &key.effects[0];
        let cause = Cause {
            effect: kind.name().to_owned(),
            channels: truth.channels.clone(),
            confidence: None,
            parameters: json!({}),
            sense: Sense::Missing,
            uncertainty: Value::Null,
            index: 0,
        };
        (key, cause)
    }
    fn place(channel: &str, of: Of, band_hz: Option<Stretch>, time_s: Option<Stretch>) -> Place {
        Place { channel: channel.to_owned(), of, band_hz, time_s }
    }

    #[test]
    fn a_line_is_placed_at_its_frequency_alone() {
        let (key, cause) = case(Kind::Tone);
        let truth = &key.effects[0];
        let hz = truth.parameters[&truth.channels[0]]["frequency_hz"].as_f64().unwrap();
        let at = |from: f64, of: Of| -> Vec<Place> {
            truth.channels.iter().map(|channel| place(channel, of, Some([from, from + 0.01]), None)).collect()
        };
        assert_eq!(is_placed(truth, &cause, &at(hz - 0.005, Of::Cause(0)), &key), Some(true));
        assert_eq!(is_placed(truth, &cause, &at(hz - 0.005, Of::Unstated), &key), Some(true));
        assert_eq!(is_placed(truth, &cause, &at(hz - 0.005, Of::Cause(1)), &key), Some(false));
        assert_eq!(is_placed(truth, &cause, &at(hz + 0.1, Of::Cause(0)), &key), Some(false));
        assert_eq!(is_placed(truth, &cause, &[], &key), Some(false));
    }

    #[test]
    fn a_place_on_a_clean_channel_is_false() {
        let (key, cause) = case(Kind::Spikes);
        let truth = &key.effects[0];
        let clean = key.channels.iter().find(|channel| !truth.channels.contains(channel)).unwrap();
        let of = |of| place(clean, of, None, None);
        let mut places: Vec<Place> =
            truth.channels.iter().map(|channel| place(channel, Of::Cause(0), None, None)).collect();
        assert_eq!((is_placed(truth, &cause, &places, &key), false_places(&places, &key).count()), (Some(true), 0));
        places.extend([of(Of::Cause(0)), of(Of::Parameters), of(Of::Remainder)]);
        assert_eq!((is_placed(truth, &cause, &places, &key), false_places(&places, &key).count()), (Some(false), 2));
    }

    #[test]
    fn a_place_on_what_the_model_has_as_the_sensor_is_false() {
        let recipe = Recipe::of_model(Kind::Tone, Sense::Known);
        let key = Case::make(21, 1, &recipe, Some(20_000)).unwrap().key();
        let places = [place(&key.effects[0].channels[0], Of::Remainder, None, None)];
        assert_eq!(false_places(&places, &key).count(), 1);
    }

    #[test]
    fn the_truth_is_placed_and_what_is_much_wider_is_not() {
        for kind in Kind::LIBRARY.iter().copied().filter(|kind| !kind.needs_stamps()) {
            let (key, cause) = case(kind);
            let truth = &key.effects[0];
            let length_s = key.samples as f64 / key.rate_hz;
            let bin_hz = 1.0 / length_s;
            let near = |value: &Value, wide: f64| value.as_f64().map(|at| [at - 0.5 * wide, at + 0.5 * wide]);
            let of = |entry: &Value| {
                let harmonics = entry["amplitudes"].as_array().map_or(0, Vec::len);
                let wide_hz = entry["bandwidth_hz"].as_f64().unwrap_or(bin_hz);
                let mut bands: Vec<Stretch> = near(&entry["frequency_hz"], wide_hz).into_iter().collect();
                bands.extend(
                    (1..=harmonics)
                        .filter_map(|times| near(&(times as f64 * entry["fundamental_hz"].as_f64()?).into(), bin_hz)),
                );
                let mut times = intervals(std::slice::from_ref(entry));
                times.extend(near(&entry["at_s"], 10.0 / key.rate_hz));
                (bands, times)
            };
            let (mut right, mut wide) = (Vec::new(), Vec::new());
            for (channel, entry) in &truth.parameters {
                for (bands, times) in entries(entry).iter().map(of) {
                    right.extend(bands.into_iter().map(|band| place(channel, Of::Cause(0), Some(band), None)));
                    right.extend(times.into_iter().map(|time| place(channel, Of::Cause(0), None, Some(time))));
                }
                wide.push(place(channel, Of::Cause(0), Some([0.0, 0.5 * key.rate_hz]), Some([0.0, length_s])));
            }
            // An effect with neither a band nor a time is anywhere.
            let has_place = !right.is_empty();
            let right = if has_place { right } else { wide.clone() };
            assert_eq!(is_placed(truth, &cause, &right, &key), Some(true), "{kind}");
            let longest = entries(&truth.parameters[&truth.channels[0]]).iter().flat_map(|one| of(one).1);
            if longest.map(|[from, to]| to - from).fold(0.0, f64::max) < 0.25 * length_s {
                assert_eq!(is_placed(truth, &cause, &wide, &key), Some(!has_place), "{kind}");
            }
            let unstated: Vec<Place> =
                wide.iter().map(|one| Place { band_hz: None, time_s: None, ..one.clone() }).collect();
            assert_eq!(is_placed(truth, &cause, &unstated, &key), Some(!has_place), "{kind}");
        }
    }

    #[test]
    fn a_step_is_placed_at_its_time() {
        let (key, cause) = case(Kind::BiasStep);
        let truth = &key.effects[0];
        let at = truth.parameters[&truth.channels[0]][0]["at_s"].as_f64().unwrap();
        let of = |from: f64, to: f64| -> Vec<Place> {
            truth.channels.iter().map(|channel| place(channel, Of::Cause(0), None, Some([from, to]))).collect()
        };
        assert_eq!(is_placed(truth, &cause, &of(at - 0.1, at + 0.1), &key), Some(true));
        let elsewhere = key.samples as f64 / key.rate_hz + 99.0;
        assert_eq!(is_placed(truth, &cause, &of(elsewhere, elsewhere + 1.0), &key), Some(false));
    }
}
