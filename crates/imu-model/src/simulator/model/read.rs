//! Reading: turns JSON into a model; every refusal states its place.

use super::place::{Place, one_of};
use super::{
    CHANNEL_KEYS, ChannelModel, FORMAT, KEYS, ModelError, SAMPLING_KEYS, Sampling, SensorModel, TRIAD_KEYS, TRIADS,
    TriadModel,
};
use crate::effects::{CHANNEL, Definition, TRIAD, registry};
use imu_core::sample::{Channel, Triad};
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Rates of a model's output: from a sample in a quarter of an hour to more than inertial sensors give.
pub(super) const RATES_HZ: std::ops::RangeInclusive<f64> = 0.001..=100_000.0;

impl SensorModel {
    /// Reads a model from JSON text; `file` names it in messages.
    ///
    /// # Errors
    /// [`ModelError`] with the place and the values allowed there.
    pub fn from_json(text: &str, file: &str) -> Result<Self, ModelError> {
        let parsed =
            super::unique::parse(text).map_err(|source| ModelError::Syntax { file: file.to_owned(), source })?;
        let value = parsed.map_err(|twice| ModelError::Content {
            file: file.to_owned(),
            path: twice.path,
            found: format!("`{}` a second time", twice.key),
            expected: "every key once".to_owned(),
        })?;
        Self::from_value(&value, file)
    }

    /// Reads a model from parsed JSON, such as a part of a request; `file` names it in messages. Keys that occurred
    /// twice can no longer be detected.
    ///
    /// # Errors
    /// [`ModelError`] with the place and the values allowed there.
    pub fn from_value(value: &Value, file: &str) -> Result<Self, ModelError> {
        let root = Place::root(file, value);
        root.only_keys(&KEYS)?;
        let format = root.key("format", "the format's name")?;
        if format.value.as_str() != Some(FORMAT) {
            return Err(format.refuse(&format!("\"{FORMAT}\"")));
        }
        let name = root.key("name", "a name")?;
        let name = name.value.as_str().ok_or_else(|| name.refuse("a text"))?.to_owned();
        let rate = root.key("rate_hz", "the output rate in Hz")?;
        let rate_hz = rate.number()?;
        if !RATES_HZ.contains(&rate_hz) {
            return Err(rate.refuse(&format!("a rate from {} to {} Hz", RATES_HZ.start(), RATES_HZ.end())));
        }
        let sampling = root.optional("sampling").map(|place| sampling(&place)).transpose()?;
        let places = root.key("channels", "an object of channels")?;
        let mut channels = BTreeMap::new();
        for place in places.entries("an object of channels")? {
            let Some(channel) = Channel::from_name(place.last_key()) else {
                return Err(place.refuse_key(&one_of(&Channel::ALL.map(Channel::name))));
            };
            channels.insert(channel, channel_model(&place)?);
        }
        let triads = root.optional("triads").map_or_else(|| Ok(BTreeMap::new()), |place| triads(&place))?;
        let provenance = root.optional("provenance").map(|place| object(&place)).transpose()?;
        let model = Self { name, rate_hz, channels, triads, sampling, provenance };
        model.check(rate_hz).map_err(|fault| ModelError::Content {
            file: file.to_owned(),
            path: fault.path,
            found: fault.found,
            expected: fault.expected,
        })?;
        Ok(model)
    }
}

fn object(place: &Place<'_>) -> Result<Map<String, Value>, ModelError> {
    place.value.as_object().cloned().ok_or_else(|| place.refuse("an object"))
}

fn sampling(place: &Place<'_>) -> Result<Sampling, ModelError> {
    place.only_keys(&SAMPLING_KEYS)?;
    let window = place.key("filter_window", "internal samples that are averaged, from 1")?;
    let filter_window = window.value.as_u64().ok_or_else(|| window.refuse("a whole number from 1"))?;
    let internal_rate_hz = place.key("internal_rate_hz", "the sensor's own rate in Hz")?.number()?;
    Ok(Sampling { internal_rate_hz, filter_window })
}

fn channel_model(place: &Place<'_>) -> Result<ChannelModel, ModelError> {
    place.only_keys(&CHANNEL_KEYS)?;
    let number = |key| place.optional(key).map(|place| place.number()).transpose();
    let effects = place.optional("effects").map(|place| effects(&place, &CHANNEL)).transpose()?;
    let effects = effects.unwrap_or_default();
    let uncertainty = place.optional("uncertainty");
    let uncertainty = uncertainty.map(|place| super::uncertainty::read(&place, &effects)).transpose()?;
    Ok(ChannelModel {
        n: number("N")?.unwrap_or(0.0),
        b: number("B")?.unwrap_or(0.0),
        k: number("K")?.unwrap_or(0.0),
        bias: number("bias")?,
        effects,
        uncertainty,
    })
}

fn triads(places: &Place<'_>) -> Result<BTreeMap<Triad, TriadModel>, ModelError> {
    let mut triads = BTreeMap::new();
    for place in places.entries("an object of triads")? {
        let Some(triad) = TRIADS.into_iter().find(|known| known.name() == place.last_key()) else {
            return Err(place.refuse_key(&one_of(&TRIADS.map(Triad::name))));
        };
        place.only_keys(&TRIAD_KEYS)?;
        let list = place.optional("effects").map(|place| effects(&place, &TRIAD)).transpose()?;
        triads.insert(triad, TriadModel { effects: list.unwrap_or_default() });
    }
    Ok(triads)
}

/// Returns a list of effects of these kinds.
fn effects<E: ?Sized>(list: &Place<'_>, kinds: &'static [&'static Definition<E>]) -> Result<Vec<Arc<E>>, ModelError> {
    list.items("a list of effects")?.iter().map(|place| effect(place, kinds)).collect()
}

fn effect<E: ?Sized>(place: &Place<'_>, kinds: &'static [&'static Definition<E>]) -> Result<Arc<E>, ModelError> {
    let mut entry = object(place)?;
    let name = place.key("effect", &one_of(&registry::names(kinds)))?;
    let kind = name.value.as_str().and_then(|name| registry::find(kinds, name));
    let kind = kind.ok_or_else(|| name.refuse(&one_of(&registry::names(kinds))))?;
    entry.remove("effect");
    kind.read(&entry).map_err(|refusal| ModelError::Content {
        file: place.file.to_owned(),
        path: format!("{}.{}", place.path, refusal.parameter),
        found: refusal.found,
        expected: refusal.allowed,
    })
}
