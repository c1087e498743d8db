//! Places: where in time and frequency each cause, each parameter that is off and the remainder has its part of the
//! gap.

use super::evidence::Kind;
use super::found::{Attribution, Findings, Found};
use super::recording::Recording;
use super::report::{Cause, Of, Parameter, Place, Sense};
use imu_core::sample::Channel;
use imu_model::effects::spec::Nature;
use imu_model::effects::{Effect, EffectKind, Extent, Stage};

/// Half of a line's width, in units of 1 over the record's length.
const LINE: f64 = 2.0;

/// The remainder on a channel, and the chance that noise alone makes as large a one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Remnant {
    pub(super) channel: Channel,
    pub(super) nats: f64,
    pub(super) p_value: f64,
    /// Whether the nats are those of the gap itself, not those of the most conspicuous statistic.
    pub(super) is_gap: bool,
}

/// The place of an effect on a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Spot {
    band_hz: [f64; 2],
    time_s: [f64; 2],
    /// The part of the effect's gain, in any unit.
    weight: f64,
    /// Whether the effect makes samples differ more.
    is_louder: bool,
}

/// Returns the places of all causes, parameters and remainders, the heaviest first.
pub(super) fn places(
    found: &Found,
    attributions: &[Attribution],
    causes: &[Cause],
    parameters: &[Parameter],
    remnants: &[Remnant],
    real: &Recording,
) -> Vec<Place> {
    let mut places = Vec::new();
    for of in attributions {
        let same = |cause: &Cause| cause.effect == of.effect.kind() && cause.sense == of.sense;
        if let Some(index) = causes.iter().position(same) {
            of_cause(&mut places, of, Of::Cause(index), found, real);
        }
    }
    for of in parameters {
        let own = found.channels.iter().find(|own| own.prepared.channel.name() == of.channel);
        let level = ["N", "B", "K"].iter().position(|name| *name == of.parameter);
        let Some((own, band)) = own.zip(level).and_then(|(own, level)| Some((own, own.bands.levels[level]?))) else {
            continue;
        };
        let noisier = of.capture > of.model;
        let spot = Spot { band_hz: band.hz, time_s: [0.0, real.length_s()], weight: 1.0, is_louder: noisier };
        // By chance, twice the gain is χ² of one degree of freedom; three parameters on each channel are examined.
        let p_value = (3.0 * found.channels.len() as f64 * (-of.nats).exp()).min(1.0);
        places.push(place(own.prepared.channel, Of::Parameters, spot, of.nats, p_value, real));
    }
    for of in remnants {
        let own = found.channels.iter().find(|own| own.prepared.channel == of.channel);
        places.extend(own.map(|own| of_remnant(of, own, found, real)));
    }
    let total: f64 = places.iter().map(|place| place.nats).sum();
    places.iter_mut().for_each(|place| place.share = place.nats / total.max(f64::MIN_POSITIVE));
    places.sort_by(|a, b| b.nats.total_cmp(&a.nats));
    places
}

/// Creates a place whose share is not known yet.
fn place(channel: Channel, of: Of, spot: Spot, nats: f64, p_value: f64, real: &Recording) -> Place {
    let length_s = real.length_s();
    let [low, high] = spot.band_hz;
    let [from_s, to_s] = spot.time_s.map(|time_s| time_s.clamp(0.0, length_s));
    Place {
        of,
        channel: channel.name().to_owned(),
        band_hz: spot.band_hz,
        // An averaging time τ covers about 1/(2τ).
        tau_s: [0.5 / high, 0.5 / low].map(|tau_s| tau_s.min(length_s)),
        from_s,
        to_s,
        temperature_c: None,
        at: None,
        share: 0.0,
        nats,
        p_value,
        sign: if spot.is_louder { "real noisier" } else { "real quieter" }.into(),
    }
}

/// Adds the places of a cause on a channel, and of the model's own effect if that lies elsewhere.
fn of_cause(places: &mut Vec<Place>, of: &Attribution, index: Of, found: &Found, real: &Recording) {
    /// Maximum number of places per cause; the heaviest are kept.
    const MOST: usize = 16;
    let Some(own) = found.channels.iter().find(|own| own.prepared.channel == of.channel) else { return };
    let mut spots = spots(&*of.effect, own, real);
    match (of.sense, &of.declared) {
        // For another shape of the spectrum, the side on which it is louder is known.
        _ if is_shape(&*of.effect) => {}
        (Sense::Superfluous, _) => spots.iter_mut().for_each(|spot| spot.is_louder = !spot.is_louder),
        (Sense::Size, Some((_, declared))) => {
            let apart = |one: &Spot, other: &Spot| {
                let are = |a: [f64; 2], b: [f64; 2]| a[1] < b[0] || b[1] < a[0];
                are(one.band_hz, other.band_hz) || are(one.time_s, other.time_s)
            };
            let of_model = self::spots(&**declared, own, real);
            let elsewhere = of_model.into_iter().filter(|other| spots.iter().all(|spot| apart(spot, other)));
            let elsewhere: Vec<Spot> = elsewhere.map(|spot| Spot { is_louder: !spot.is_louder, ..spot }).collect();
            if elsewhere.is_empty() && is_weaker(&*of.effect, &**declared) {
                spots.iter_mut().for_each(|spot| spot.is_louder = !spot.is_louder);
            }
            spots.extend(elsewhere);
        }
        _ => {}
    }
    spots.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    spots.truncate(MOST);
    let by_temperature = of.effect.number("per_c").is_some();
    let all: f64 = spots.iter().map(|spot| spot.weight).sum();
    for spot in spots {
        let nats = of.gain * spot.weight / all.max(f64::MIN_POSITIVE);
        let mut place = place(of.channel, index, spot, nats, of.p_value, real);
        let [from_s, to_s] = spot.time_s;
        place.temperature_c = by_temperature.then(|| real.temperatures_between(from_s, to_s)).flatten();
        places.push(place);
    }
}

/// Returns whether an effect shapes the spectrum, so that its band was measured against the model's.
fn is_shape(effect: &dyn Effect) -> bool {
    let is_coloured = effect.spec().nature == Nature::Coloured || effect.kind() == EffectKind::PowerLaw;
    is_coloured || effect.stage() == Stage::Bandwidth
}

/// Returns whether an effect makes less of a difference than another of its name.
fn is_weaker(one: &dyn Effect, other: &dyn Effect) -> bool {
    const SIZES: [&str; 12] = [
        "per_c2",
        "per_c_per_s",
        "amplitude",
        "sigma",
        "R",
        "size",
        "per_c",
        "step",
        "factor",
        "probability",
        "jitter_s",
        "degrees_of_freedom",
    ];
    if one.kind() == EffectKind::Comb {
        let power = |of: &dyn Effect| of.lines().iter().map(|line| line.power).sum::<f64>();
        return power(one) < power(other);
    }
    let sizes = SIZES.iter().find_map(|name| Some((*name, one.number(name)?, other.number(name)?)));
    sizes.is_some_and(|(name, one, other)| (one.abs() < other.abs()) != (name == "degrees_of_freedom"))
}

/// Returns the places of an effect: the parts of the record in which it acts (for a step, the samples about it), over
/// all frequencies or in the band in which likelihood is gained.
fn spots(effect: &dyn Effect, own: &Findings, real: &Recording) -> Vec<Spot> {
    let (length_s, half_hz) = (real.length_s(), 0.5 * real.rate_hz);
    let kinds = Kind::ALL.into_iter().filter(|kind| kind.effect() == effect.kind());
    let gains = kinds.filter_map(|kind| own.bands.kinds.get(&kind)).next();
    let factor = effect.number("factor").unwrap_or(f64::INFINITY);
    let is_louder = match effect.kind() {
        EffectKind::Saturation | EffectKind::HeldSamples => false,
        _ => gains.map_or(factor > 1.0, |band| band.is_louder),
    };
    let whole =
        Spot { band_hz: gains.map_or([0.0, half_hz], |band| band.hz), time_s: [0.0, length_s], weight: 1.0, is_louder };
    let spot = |extent: Extent| {
        let mut spot = Spot { weight: extent.weight, ..whole };
        if let Some([frequency_hz, width_hz]) = extent.band_hz {
            let half = width_hz.max(LINE / length_s);
            spot.band_hz = [(frequency_hz - half).max(0.0), (frequency_hz + half).min(half_hz)];
            spot.is_louder = true;
        }
        match extent.time_s {
            Some([at_s, to_s]) if at_s == to_s => {
                // A step is compared over as many samples as its noise requires, at least five.
                let size = extent.weight.sqrt().max(f64::MIN_POSITIVE);
                let half_s = (11.0 * (own.white / size).powi(2)).max(5.0) / real.rate_hz;
                spot.time_s = [(at_s - half_s).max(0.0), (at_s + half_s).min(length_s)];
            }
            Some([from_s, to_s]) => spot.time_s = [from_s, to_s],
            None => {}
        }
        spot
    };
    let extents = effect.extents();
    if extents.is_empty() { vec![whole] } else { extents.into_iter().map(spot).collect() }
}

/// Returns the place on a channel where something remains: the rectangle of time and frequency that holds most of it,
/// if chance rarely makes such a rectangle; otherwise the whole channel.
fn of_remnant(of: &Remnant, own: &Findings, found: &Found, real: &Recording) -> Place {
    /// Noise makes a rectangle that is a place at most this rarely.
    const RARE: f64 = 0.01;
    let channels = found.channels.len() as f64;
    let heaviest = own.after.heaviest().filter(|one| channels * one.p_value < RARE);
    let (spot, nats, p_value) = match heaviest {
        Some(one) => {
            let spot = Spot { band_hz: one.band_hz, time_s: one.time_s, weight: 1.0, is_louder: one.ratio >= 1.0 };
            (spot, if of.is_gap { of.nats } else { one.excess }, channels * one.p_value)
        }
        None => {
            let (band_hz, time_s) = ([0.0, 0.5 * real.rate_hz], [0.0, real.length_s()]);
            (Spot { band_hz, time_s, weight: 1.0, is_louder: true }, of.nats, of.p_value)
        }
    };
    place(of.channel, Of::Remainder, spot, nats, p_value, real)
}
