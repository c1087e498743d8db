//! Writing: turns a model into JSON that reads back as the same model.

use super::{ChannelModel, FORMAT, Sampling, SensorModel, TriadModel};
use crate::effects::{Effect, TriadEffect};
use serde::ser::{Serialize, SerializeMap, Serializer};
use serde_json::Value;
use std::sync::Arc;

/// An effect's entry: its name, then its parameters.
struct Entry(&'static str, Vec<(&'static str, Value)>);

impl Serialize for Entry {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("effect", self.0)?;
        for (name, value) in &self.1 {
            map.serialize_entry(name, value)?;
        }
        map.end()
    }
}

fn channel_entries(effects: &[Arc<dyn Effect>]) -> Vec<Entry> {
    effects.iter().map(|effect| Entry(effect.name(), effect.parameters())).collect()
}

fn triad_entries(effects: &[Arc<dyn TriadEffect>]) -> Vec<Entry> {
    effects.iter().map(|effect| Entry(effect.name(), effect.parameters())).collect()
}

impl Serialize for ChannelModel {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("N", &self.n)?;
        map.serialize_entry("B", &self.b)?;
        map.serialize_entry("K", &self.k)?;
        if let Some(bias) = self.bias {
            map.serialize_entry("bias", &bias)?;
        }
        if !self.effects.is_empty() {
            map.serialize_entry("effects", &channel_entries(&self.effects))?;
        }
        if let Some(uncertainty) = self.written_uncertainty() {
            map.serialize_entry("uncertainty", &uncertainty)?;
        }
        map.end()
    }
}

impl Serialize for TriadModel {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("effects", &triad_entries(&self.effects))?;
        map.end()
    }
}

impl Serialize for Sampling {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("internal_rate_hz", &self.internal_rate_hz)?;
        map.serialize_entry("filter_window", &self.filter_window)?;
        map.end()
    }
}

impl Serialize for SensorModel {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("format", FORMAT)?;
        map.serialize_entry("name", &self.name)?;
        map.serialize_entry("rate_hz", &self.rate_hz)?;
        if let Some(sampling) = &self.sampling {
            map.serialize_entry("sampling", sampling)?;
        }
        map.serialize_entry("channels", &self.channels)?;
        if !self.triads.is_empty() {
            map.serialize_entry("triads", &self.triads)?;
        }
        if let Some(provenance) = &self.provenance {
            map.serialize_entry("provenance", provenance)?;
        }
        map.end()
    }
}
