//! Places: where the effects of a case lie, and whether a diagnosis says so.
//!
//! A cause is placed where each channel that it shares with the effect has a place of it that overlaps the effect's band and
//! time there, and no place of it lies on a channel without the effect. A place is false where nothing of the case is: of a
//! cause or of a remainder, on a channel without an effect; places of parameters are never false. A report that does not tell what its places are
//! of is held to what it says: all of them may be of any cause.

use super::key::{Key, TrueEffect};
use super::kind::Kind;
use super::report::{Cause, Of, Place, entries};
use serde_json::Value;

/// Frequencies, Hz, or times, s, from and to.
type Stretch = [f64; 2];

/// Where an effect lies on a channel; none is anywhere.
#[derive(Debug, Clone, Default, PartialEq)]
struct Lies {
    bands_hz: Option<Vec<Stretch>>,
    times_s: Option<Vec<Stretch>>,
}

/// Widths of a Fourier bin by which a line's place may be off.
const BINS: f64 = 2.0;
/// Widths of a resonance, to either side, that are its own.
const WIDTHS: f64 = 2.0;
/// Samples, and parts of the record, by which a step's time may be off: it takes up to 20 samples to rise.
const RISE_SAMPLES: f64 = 20.0;
const RISE_PART: f64 = 2e-3;
/// Slow courses of the level lie below this part of the rate.
const SLOW: f64 = 0.02;

impl Lies {
    fn of(kind: Kind, entry: &Value, key: &Key) -> Self {
        let number = |name: &str| entry[name].as_f64();
        let bin_hz = BINS * key.rate_hz / key.samples as f64;
        let line = |hz: f64| [hz - bin_hz, hz + bin_hz];
        let mut lies = Self::default();
        match kind {
            Kind::Tone => lies.bands_hz = number("frequency_hz").map(|hz| vec![line(hz)]),
            Kind::Comb => {
                let count = entry["amplitudes"].as_array().map_or(0, Vec::len);
                lies.bands_hz =
                    number("fundamental_hz").map(|hz| (1..=count).map(|times| line(times as f64 * hz)).collect());
            }
            Kind::Resonance => {
                let off = WIDTHS * number("bandwidth_hz").unwrap_or(0.0);
                lies.bands_hz = number("frequency_hz").map(|hz| vec![[hz - off - bin_hz, hz + off + bin_hz]]);
            }
            Kind::GaussMarkov => {
                // All but a twentieth of its power is below four times its corner.
                lies.bands_hz = number("tc_s").map(|tc| vec![[0.0, 4.0 / (std::f64::consts::TAU * tc) + bin_hz]]);
            }
            Kind::RateRamp | Kind::WarmUp | Kind::TemperatureBias => {
                lies.bands_hz = Some(vec![[0.0, SLOW * key.rate_hz]]);
            }
            Kind::BiasStep => {
                let off = (RISE_SAMPLES / key.rate_hz).max(RISE_PART * key.samples as f64 / key.rate_hz);
                lies.times_s = number("at_s").map(|at| vec![[at - off, at + off]]);
            }
            Kind::VarianceInterval => {
                lies.times_s = number("from_s").zip(number("to_s")).map(|(from, to)| vec![[from, to]]);
            }
            Kind::Bursts => {
                let list = entry["intervals"].as_array();
                lies.times_s =
                    list.map(|list| list.iter().filter_map(|one| Some([one[0].as_f64()?, one[1].as_f64()?])).collect());
            }
            _ => {}
        }
        lies
    }

    fn overlaps(&self, place: &Place) -> bool {
        let meets = |own: &Option<Vec<Stretch>>, told: Option<Stretch>| match (own, told) {
            (Some(own), Some([from, to])) => own.iter().any(|[begin, end]| from <= *end && to >= *begin),
            _ => true,
        };
        meets(&self.bands_hz, place.band_hz) && meets(&self.times_s, place.time_s)
    }
}

/// Whether a place lies where an effect does; of one that both have at two places either is its.
fn lies_at(truth: &TrueEffect, place: &Place, key: &Key) -> bool {
    let told = truth.told.iter().flatten();
    let mut on = truth.parameters.iter().chain(told).filter(|(channel, _)| **channel == place.channel);
    on.any(|(_, entry)| entries(entry).iter().any(|one| Lies::of(truth.kind, one, key).overlaps(place)))
}

/// Whether a cause that is this effect is placed. None of what has no channel of its own, and where no channel is told.
#[must_use]
pub fn is_placed(truth: &TrueEffect, cause: &Cause, places: &[Place], key: &Key) -> Option<bool> {
    let of_all = truth.kind.needs_stamps() || cause.channels.is_empty();
    if of_all {
        return None;
    }
    let own = |place: &&Place| place.of == Of::Cause(cause.index) || place.of == Of::Untold;
    let on = |channel: &String| {
        places.iter().filter(own).any(|place| place.channel == *channel && lies_at(truth, place, key))
    };
    let here = cause.channels.iter().filter(|channel| truth.channels.contains(channel)).all(on);
    let told = places.iter().filter(|place| place.of == Of::Cause(cause.index));
    Some(here && told.into_iter().all(|place| truth.channels.contains(&place.channel)))
}

/// Places on channels on which no effect of the case is.
pub fn false_places<'a>(places: &'a [Place], key: &'a Key) -> impl Iterator<Item = &'a Place> {
    let touched = |channel: &String| {
        key.effects.iter().any(|effect| effect.kind.needs_stamps() || effect.channels.contains(channel))
    };
    places.iter().filter(move |place| place.of != Of::Parameters && !touched(&place.channel))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trial::case::Case;
    use crate::trial::class::Sense;
    use crate::trial::recipe::Recipe;
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
        Place { channel: channel.to_owned(), of, band_hz, time_s, nats: None, p_value: None }
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
        assert_eq!(is_placed(truth, &cause, &at(hz - 0.005, Of::Untold), &key), Some(true));
        assert_eq!(is_placed(truth, &cause, &at(hz - 0.005, Of::Cause(1)), &key), Some(false));
        assert_eq!(is_placed(truth, &cause, &at(hz + 0.1, Of::Cause(0)), &key), Some(false));
        assert_eq!(is_placed(truth, &cause, &[], &key), Some(false));
    }

    #[test]
    fn a_place_on_a_clean_channel_is_false() {
        let (key, cause) = case(Kind::BiasStep);
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
