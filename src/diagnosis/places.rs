//! Places: where a gap lies, by channel, frequency, time and temperature.

use super::diagnose::{Findings, Found};
use super::named::{Named, is_fact};
use super::recording::Recording;
use super::report::{Place, Verdict};
use super::tiles::Rectangle;
use crate::sample::Channel;
use serde_json::Value;
use std::collections::BTreeMap;

/// Where it lies: per channel, the rectangle of time and frequency with most of it; of a line its own frequency.
pub(super) fn places(found: &Found, named: &[Named], real: &Recording, verdict: Verdict) -> Vec<Place> {
    /// Half of a line's width in parts of 1 over the record's length.
    const LINE: f64 = 2.0;
    let remaining = verdict == Verdict::UnknownEffect;
    let by_temperature = |channel: Channel| {
        let mut own = named.iter().filter(|of| of.channel == channel);
        own.any(|of| of.effect.parameters().iter().any(|(name, _)| *name == "per_c"))
    };
    let all: Vec<(&Findings, Rectangle, f64)> = found
        .channels
        .iter()
        .filter_map(|of| {
            let tiles = if remaining { &of.after } else { &of.before };
            let concerned = remaining || named.iter().any(|one| one.channel == of.prepared.channel);
            let rectangle = tiles.heaviest().filter(|_| concerned)?;
            Some((of, rectangle, tiles.total().max(rectangle.excess)))
        })
        .collect();
    let total: f64 = all.iter().map(|(.., total)| total.max(0.0)).sum();
    let mut places: Vec<Place> = all
        .into_iter()
        .filter(|(_, rectangle, _)| rectangle.excess > 0.02 * total && rectangle.excess > 8.0)
        .map(|(of, rectangle, _)| {
            let line = main_line(named, of.prepared.channel, rectangle.band_hz).filter(|_| !remaining);
            let [low, high] = line.map_or(rectangle.band_hz, |[hz, wide_hz]| {
                let half = wide_hz.max(LINE / real.length_s());
                [(hz - half).max(0.0), hz + half]
            });
            let [from_s, to_s] = rectangle.time_s;
            Place {
                channel: of.prepared.channel.name().to_owned(),
                band_hz: [low, high],
                // An averaging time sees about 1/(2τ).
                tau_s: [0.5 / high, 0.5 / low.max(1e-9)],
                from_s,
                to_s,
                temperature_c: by_temperature(of.prepared.channel)
                    .then(|| real.temperatures_between(from_s, to_s))
                    .flatten(),
                at: None,
                share: (rectangle.excess / total).min(1.0),
                sign: if rectangle.ratio >= 1.0 { "real noisier" } else { "real quieter" },
            }
        })
        .collect();
    places.sort_by(|a, b| b.share.total_cmp(&a.share));
    places
}

/// Frequency and half width of the strongest line or narrow band that was named on a channel inside a band, where that was
/// most of what was named there.
fn main_line(named: &[Named], channel: Channel, [low, high]: [f64; 2]) -> Option<[f64; 2]> {
    let own = named.iter().filter(|of| of.channel == channel && !is_fact(of));
    let strongest = own.max_by(|a, b| a.gain.total_cmp(&b.gain))?;
    let parameters: BTreeMap<&str, Value> = strongest.effect.parameters().into_iter().collect();
    let number = |name: &str| parameters.get(name).and_then(Value::as_f64);
    let line = match strongest.effect.name() {
        "tone" => Some([number("frequency_hz")?, 0.0]),
        "resonance" => Some([number("frequency_hz")?, number("bandwidth_hz")?]),
        _ => None,
    };
    line.filter(|[hz, _]| (low..=high).contains(hz))
}
