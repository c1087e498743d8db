//! Model fit: makes a sensor model from a capture's results. Pure.
//!
//! In: a noise report, the mean of each channel. Out: a model with N, B, K and bias per channel and their uncertainties
//! ([`model_of`]). A parameter that the data does not support is 0 in the model, with its upper limit in `uncertainty`.
//! If effects are requested, they are those that a diagnosis of the capture against that model finds; N, B and K are
//! then fitted beside them ([`with_effects`]).
//!
//! Models fitted from a capture describe the noise at the capture's rate. A filter that shapes the noise is in the
//! model: as `sampling` if all channels are known to lie behind the same boxcar, else as `moving_average` or `low_pass`
//! of the channel. The provenance names the channels behind filters that no effect describes.

mod bandwidth;
mod diff;

pub use diff::{Difference, differences};

use bandwidth::Front;
use imu_core::sample::Channel;
use imu_model::effects::{self, EffectKind};
use imu_model::simulator::{ChannelModel, SensorModel};
use imu_noise::NoiseReport;
use imu_noise::fit::{Estimate, NoiseParameters};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Returns the effects of a list of names; `all` stands for all that a capture at rest can show.
///
/// # Errors
/// The unknown name, and the known names.
pub fn effects_named(names: &str) -> Result<Vec<EffectKind>, String> {
    let known = crate::effects();
    if names == "all" {
        return Ok(known);
    }
    let named = |name: &str| {
        known.iter().copied().find(|own| own.name() == name).ok_or_else(|| {
            let known: Vec<&str> = known.iter().map(|own| own.name()).collect();
            format!("`{name}` is no effect that a capture at rest shows; allowed are all, {}", known.join(", "))
        })
    };
    names.split(',').map(str::trim).map(named).collect()
}

/// Returns the model of a capture. `levels` are the channels' means; channels of the report without a level get no
/// bias. `software` and `source` go into the provenance.
pub fn model_of(report: &NoiseReport, levels: &BTreeMap<Channel, f64>, name: &str, software: &str) -> SensorModel {
    let sampling = bandwidth::sampling(report);
    let mut left_out = Vec::new();
    let mut channel = |(channel, found): (&Channel, &NoiseParameters)| {
        let value = |estimate: &Estimate| estimate.value.unwrap_or(0.0);
        let front = match (&found.bandwidth, sampling) {
            (_, Some(sampling)) => Front { share: 1.0 / sampling.density_factor(report.rate_hz), filter: None },
            (Some(bandwidth), None) => Front::of(bandwidth, value(&found.n), report.rate_hz).unwrap_or_else(|| {
                left_out.push(channel.name());
                Front::OPEN
            }),
            (None, None) => Front::OPEN,
        };
        let mut model = ChannelModel {
            n: front.share * value(&found.n),
            b: value(&found.b),
            k: value(&found.k),
            bias: levels.get(channel).copied(),
            effects: Vec::new(),
            uncertainty: Some(uncertainty(found, front.share)),
        };
        if let Some(filter) = front.filter {
            // An exponential filter has another cutoff in the model than in the report.
            let known = found.bandwidth.as_ref().filter(|of| !of.exponential).and_then(|of| of.ci95);
            let known: Vec<_> = known.into_iter().map(|ends| ("cutoff_hz", ends)).collect();
            model.push_effect(filter, &known);
        }
        (*channel, model)
    };
    let channels = report.channels.iter().map(&mut channel).collect();
    let mut provenance = provenance(report, software);
    if !left_out.is_empty() {
        provenance.insert("filters_left_out".to_owned(), json!(left_out));
    }
    SensorModel {
        name: name.to_owned(),
        rate_hz: report.rate_hz,
        channels,
        sampling,
        provenance: Some(provenance),
        ..SensorModel::default()
    }
}

/// Returns the plain model of a capture with the effects that a diagnosis of the capture against it added: `augmented`.
/// Channels to which it added none keep the values of the noise report. `looked_for` are the effects that it looked
/// for. The record began `from_s` after the capture, lasted `record_s` and had a mean temperature of `temperature_c`.
pub fn with_effects(
    plain: &SensorModel,
    augmented: &SensorModel,
    looked_for: &[EffectKind],
    record_s: f64,
    temperature_c: Option<f64>,
) -> SensorModel {
    let mut model = plain.clone();
    for (channel, own) in &mut model.channels {
        let Some(found) = augmented.channels.get(channel).filter(|found| found.effects != own.effects) else {
            continue;
        };
        let level = own.bias.map(|level| level - mean_of(&found.effects, record_s, temperature_c));
        let limits = own.uncertainty.take().unwrap_or_default();
        *own = ChannelModel { bias: level, ..found.clone() };
        // A parameter that was not identified beside the effects is absent; the report's limit still holds.
        for (letter, value) in [("B", &mut own.b), ("K", &mut own.k)] {
            let known = own.uncertainty.as_ref().is_some_and(|of| of.contains_key(letter));
            if !known {
                *value = 0.0;
                let limit =
                    limits.get(letter).and_then(|of| of.get("upper_limit95").or_else(|| of.get("ci95")?.get(1)));
                if let Some(limit) = limit.and_then(Value::as_f64) {
                    let stated = own.uncertainty.get_or_insert_default();
                    stated.insert(letter.to_owned(), json!({ "upper_limit95": limit }));
                }
            }
        }
    }
    if let Some(provenance) = &mut model.provenance {
        provenance.insert("effects_looked_for".to_owned(), json!(looked_for));
    }
    model
}

/// Returns the mean contribution of the deterministic effects to the level over a record.
fn mean_of(effects: &[Arc<dyn effects::Effect>], record_s: f64, temperature_c: Option<f64>) -> f64 {
    const INSTANTS: u32 = 10_000;
    let temperature_c = temperature_c.unwrap_or(effects::USUAL_TEMPERATURE_C);
    let level = |instant: u32| -> f64 {
        let time_s = (f64::from(instant) + 0.5) / f64::from(INSTANTS) * record_s;
        let shifts = effects.iter().filter(|effect| effect.stage() == effects::Stage::Bias);
        shifts.map(|effect| effect.mean_response(0.0, effects::At { time_s, temperature_c })).sum()
    };
    (0..INSTANTS).map(level).sum::<f64>() / f64::from(INSTANTS)
}

/// Returns intervals of identified parameters and limits of the others; those of N are multiplied by `share`.
fn uncertainty(found: &NoiseParameters, share: f64) -> Map<String, Value> {
    let of = |estimate: &Estimate, share: f64| match (estimate.ci95, estimate.upper_limit95) {
        (Some(ci95), _) => Some(json!({ "ci95": ci95.map(|end| share * end) })),
        (None, Some(limit)) => Some(json!({ "upper_limit95": share * limit })),
        (None, None) => None,
    };
    let terms = [("N", &found.n, share), ("B", &found.b, 1.0), ("K", &found.k, 1.0)];
    terms.into_iter().filter_map(|(letter, estimate, share)| Some((letter.to_owned(), of(estimate, share)?))).collect()
}

fn provenance(report: &NoiseReport, software: &str) -> Map<String, Value> {
    let methods: BTreeMap<&str, &str> =
        report.channels.iter().map(|(channel, found)| (channel.name(), found.fit.method.as_str())).collect();
    let mut entries = Map::new();
    for (key, value) in [
        ("capture", json!(report.capture)),
        ("duration_s", json!(report.duration_s)),
        ("samples", json!(report.samples)),
        ("missing", json!(report.missing)),
        ("effects_looked_for", json!([])),
        ("methods", json!(methods)),
        ("software", json!(software)),
    ] {
        entries.insert(key.to_owned(), value);
    }
    entries
}
