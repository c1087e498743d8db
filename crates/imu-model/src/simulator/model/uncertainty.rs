//! The accuracy of a channel's parameters: entries for N, B, K and bias, and for the parameters of its effects, in a list beside
//! the list of effects.
//!
//! ```json
//! { "N": { "ci95": [1.1e-4, 1.3e-4] }, "K": { "upper_limit95": 3e-7 },
//!   "effects": [ { "frequency_hz": { "ci95": [11.39, 11.41] } }, {} ] }
//! ```
//!
//! Entries are read strictly, so that a misspelt interval does not count as unknown.

use super::place::{Place, one_of};
use super::{ChannelModel, EFFECTS, ModelError, UNCERTAIN_KEYS};
use crate::effects::Effect;
use serde_json::{Map, Value, json};
use std::sync::Arc;

/// The keys of an entry.
pub(super) const ENTRY_KEYS: [&str; 2] = [INTERVAL, LIMIT];
const INTERVAL: &str = "ci95";
const LIMIT: &str = "upper_limit95";

impl ChannelModel {
    /// Returns the 95 % interval of N, B, K or `bias`, from low to high, in the parameter's unit; `None` if none is
    /// stated.
    pub fn interval(&self, parameter: &str) -> Option<[f64; 2]> {
        ends(self.uncertainty.as_ref()?.get(parameter)?)
    }

    /// Returns the 95 % upper limit of N, B or K if the data does not support it; `None` if none is stated.
    pub fn upper_limit(&self, parameter: &str) -> Option<f64> {
        self.uncertainty.as_ref()?.get(parameter)?.get(LIMIT)?.as_f64()
    }

    /// Returns the 95 % interval of a parameter of the effect at `index` of [`ChannelModel::effects`], from low to
    /// high, in the parameter's unit; `None` if none is stated.
    pub fn effect_interval(&self, index: usize, parameter: &str) -> Option<[f64; 2]> {
        ends(self.uncertainty.as_ref()?.get(EFFECTS)?.get(index)?.get(parameter)?)
    }

    /// States the 95 % interval of N, B, K or `bias`, in the parameter's unit. A pair that is not an interval of finite numbers
    /// is ignored: a file could not hold it.
    pub fn set_interval(&mut self, parameter: &str, ci95: [f64; 2]) {
        if sound(ci95) {
            self.uncertainty.get_or_insert_default().insert(parameter.to_owned(), json!({ INTERVAL: ci95 }));
        }
    }

    /// States the 95 % interval of a parameter of the effect at `index` of [`ChannelModel::effects`], in the parameter's unit. A
    /// pair that is not an interval of finite numbers is ignored, and so is one for an absent effect.
    pub fn set_effect_interval(&mut self, index: usize, parameter: &str, ci95: [f64; 2]) {
        if !sound(ci95) || index >= self.effects.len() {
            return;
        }
        let known = self.uncertainty.get_or_insert_default().entry(EFFECTS).or_insert_with(|| json!([]));
        let Value::Array(list) = known else { return };
        list.resize(self.effects.len(), json!({}));
        if let Some(Value::Object(of)) = list.get_mut(index) {
            of.insert(parameter.to_owned(), json!({ INTERVAL: ci95 }));
        }
    }

    /// Adds an effect, with the 95 % intervals of its parameters as far as they are known, in the parameters' units.
    pub fn push_effect(&mut self, effect: Arc<dyn Effect>, ci95: &[(&str, [f64; 2])]) {
        self.effects.push(effect);
        for (parameter, ends) in ci95 {
            self.set_effect_interval(self.effects.len() - 1, parameter, *ends);
        }
    }

    /// Removes the effect at `index`, with its stated uncertainties; `None` if there is none.
    pub fn remove_effect(&mut self, index: usize) -> Option<Arc<dyn Effect>> {
        if index >= self.effects.len() {
            return None;
        }
        let known = self.uncertainty.as_mut().and_then(|known| known.get_mut(EFFECTS)?.as_array_mut());
        if let Some(list) = known.filter(|list| index < list.len()) {
            list.remove(index);
        }
        Some(self.effects.remove(index))
    }

    /// Returns the uncertainty as written: the list of the effects' entries is as long as that of the effects, after
    /// any additions and removals.
    pub(super) fn written_uncertainty(&self) -> Option<Map<String, Value>> {
        let mut known = self.uncertainty.clone()?;
        match known.get_mut(EFFECTS) {
            Some(Value::Array(list)) => list.resize(self.effects.len(), json!({})),
            Some(_) => drop(known.remove(EFFECTS)),
            None => {}
        }
        Some(known)
    }
}

fn sound([low, high]: [f64; 2]) -> bool {
    low.is_finite() && high.is_finite() && low <= high
}

fn ends(entry: &Value) -> Option<[f64; 2]> {
    let ends = entry.get(INTERVAL)?;
    Some([ends.get(0)?.as_f64()?, ends.get(1)?.as_f64()?])
}

/// Reads a channel's `uncertainty`, which must match the channel's effects.
pub(super) fn read(place: &Place<'_>, effects: &[Arc<dyn Effect>]) -> Result<Map<String, Value>, ModelError> {
    place.only_keys(&UNCERTAIN_KEYS)?;
    for of in place.entries("an object")? {
        if of.last_key() != EFFECTS {
            entry(&of)?;
            continue;
        }
        let items = of.items("a list with an object for every effect")?;
        if items.len() != effects.len() {
            return Err(of.refuse_as(
                format!("{} entries", items.len()),
                &format!("one for each of the channel's effects, {}", effects.len()),
            ));
        }
        for (item, effect) in items.iter().zip(effects) {
            let names: Vec<&str> = effect.parameters().into_iter().map(|(name, _)| name).collect();
            for of in item.entries(&format!("an object, {} in it", one_of(&names)))? {
                if !names.contains(&of.last_key()) {
                    return Err(of.refuse_key(&one_of(&names)));
                }
                entry(&of)?;
            }
        }
    }
    Ok(place.value.as_object().cloned().unwrap_or_default())
}

fn entry(place: &Place<'_>) -> Result<(), ModelError> {
    place.only_keys(&ENTRY_KEYS)?;
    if let Some(interval) = place.optional(INTERVAL) {
        let expected = "an interval, [low, high] with low ≤ high";
        let numbers: Vec<f64> = interval.items(expected)?.iter().filter_map(|end| end.value.as_f64()).collect();
        match (numbers.as_slice(), interval.value.as_array().map(Vec::len)) {
            ([low, high], Some(2)) if sound([*low, *high]) => {}
            _ => return Err(interval.refuse(expected)),
        }
    }
    match place.optional(LIMIT) {
        Some(limit) if limit.number()? < 0.0 => Err(limit.refuse("a number of 0 or more")),
        _ => Ok(()),
    }
}
