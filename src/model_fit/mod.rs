//! Model fit: what a capture showed becomes a sensor model. Pure.
//!
//! In: a noise report, and of each channel its level and resolution. Out: a model with N, B, K and bias per channel, their
//! uncertainties, and the effects that were asked for, as far as the capture shows them ([`Feature`]). A parameter that the data does
//! not support is 0 in the model, and its upper limit stands in `uncertainty`.
//!
//! Models fitted from a capture are of what is seen at its rate: they have no `sampling`.

mod diff;
mod resolution;

pub use diff::{Difference, differences};
pub use resolution::Resolution;

use crate::effects;
use crate::noise::NoiseReport;
use crate::noise::fit::{Estimate, NoiseParameters};
use crate::noise::robust::{Disturbances, Line};
use crate::sample::Channel;
use crate::simulator::{ChannelModel, SensorModel};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;

/// An effect that a noise report and a look at the values can show.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[expect(missing_docs, reason = "the contract's names of effects, section 5")]
#[expect(clippy::exhaustive_enums, reason = "a new one has to be found somewhere: `features` below")]
pub enum Feature {
    QuantizationNoise,
    RateRamp,
    GaussMarkov,
    Tone,
    Resonance,
    TemperatureBias,
    WarmUp,
    Resolution,
}

impl Feature {
    /// All.
    pub const ALL: [Self; 8] = [
        Self::QuantizationNoise,
        Self::RateRamp,
        Self::GaussMarkov,
        Self::Tone,
        Self::Resonance,
        Self::TemperatureBias,
        Self::WarmUp,
        Self::Resolution,
    ];

    /// The effect's name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::QuantizationNoise => "quantization_noise",
            Self::RateRamp => "rate_ramp",
            Self::GaussMarkov => "gauss_markov",
            Self::Tone => "tone",
            Self::Resonance => "resonance",
            Self::TemperatureBias => "temperature_bias",
            Self::WarmUp => "warm_up",
            Self::Resolution => "resolution",
        }
    }

    /// The effects of a list of names, `all` being all of them.
    ///
    /// # Errors
    /// The name that is none, and the names there are.
    pub fn from_names(names: &str) -> Result<Vec<Self>, String> {
        if names == "all" {
            return Ok(Self::ALL.to_vec());
        }
        let named = |name: &str| {
            Self::ALL.into_iter().find(|feature| feature.name() == name).ok_or_else(|| {
                let allowed = Self::ALL.map(Self::name).join(", ");
                format!("a capture does not show `{name}` by itself; allowed are all, {allowed}")
            })
        };
        names.split(',').map(str::trim).map(named).collect()
    }
}

/// What a channel shows besides its noise.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(clippy::exhaustive_structs, reason = "an argument that callers write out")]
pub struct Level {
    /// Mean of all samples, U.
    pub mean: f64,
    /// The step that all values are multiples of, U, where there is one.
    pub step: Option<f64>,
}

/// The model of a capture. `levels`: of the channels known; those of the report without one get no bias. `software` and
/// `source` go into the provenance.
#[must_use]
pub fn model_of(
    report: &NoiseReport,
    levels: &BTreeMap<Channel, Level>,
    wanted: &[Feature],
    name: &str,
    software: &str,
) -> SensorModel {
    let temperature_c = levels.get(&Channel::Temperature).map(|level| level.mean);
    let channel = |(channel, found): (&Channel, &NoiseParameters)| {
        let level = levels.get(channel).copied();
        let about = report.disturbances.get(channel);
        let value = |estimate: &Estimate| estimate.value.unwrap_or(0.0);
        // What the temperature explains is no walk and no ramp as well.
        let apart = about.filter(|_| wanted.contains(&Feature::TemperatureBias));
        let k = apart.and_then(|about| about.k_without_temperature.clone()).unwrap_or_else(|| found.k.clone());
        let r = apart.and_then(|about| about.r_without_temperature.clone()).unwrap_or_else(|| found.r.clone());
        let n = match level.and_then(|level| level.step).filter(|_| wanted.contains(&Feature::Resolution)) {
            Some(step) => without_rounding(&found.n, step * step / (12.0 * report.rate_hz)),
            None => found.n.clone(),
        };
        let found = NoiseParameters { n, k, r, ..found.clone() };
        let shown = Shown { found: &found, about, level, temperature_c, record_s: report.duration_s, wanted };
        let effects: Vec<Arc<dyn effects::Effect>> = wanted.iter().flat_map(|of| shown.features(*of)).collect();
        let model = ChannelModel {
            n: value(&found.n),
            b: value(&found.b),
            k: value(&found.k),
            bias: level.map(|level| level.mean - mean_of(&effects, report.duration_s, temperature_c)),
            effects,
            uncertainty: Some(uncertainty(&found)),
        };
        (*channel, model)
    };
    SensorModel {
        name: name.to_owned(),
        rate_hz: report.rate_hz,
        channels: report.channels.iter().map(channel).collect(),
        provenance: Some(provenance(report, wanted, software)),
        ..SensorModel::default()
    }
}

/// What a capture shows of a channel.
struct Shown<'a> {
    found: &'a NoiseParameters,
    about: Option<&'a Disturbances>,
    level: Option<Level>,
    /// The sensor's mean temperature, °C.
    temperature_c: Option<f64>,
    record_s: f64,
    wanted: &'a [Feature],
}

impl Shown<'_> {
    /// The effects of a kind.
    fn features(&self, feature: Feature) -> Vec<Arc<dyn effects::Effect>> {
        let one = |effect: Option<Arc<dyn effects::Effect>>| effect.into_iter().collect();
        let found = self.found;
        match feature {
            Feature::QuantizationNoise => one(found.q.value.map(|q| Arc::new(effects::QuantizationNoise { q }) as _)),
            Feature::RateRamp => one(found.r.value.map(|r| Arc::new(effects::RateRamp { r }) as _)),
            Feature::GaussMarkov => one(found.gauss_markov.as_ref().and_then(|process| {
                let (sigma, tc_s) = (process.sigma.value?, process.tc_s.value?);
                Some(Arc::new(effects::GaussMarkov { sigma, tc_s }) as _)
            })),
            Feature::Tone => self.lines(false).map(|line| tone(line)).collect(),
            Feature::Resonance => self.lines(true).filter_map(|band| self.resonance(band)).collect(),
            Feature::TemperatureBias => one(self.about.and_then(|about| {
                let depends = about.temperature.as_ref().filter(|depends| depends.significant)?;
                let middle_c = 0.5 * (depends.range_c[0] + depends.range_c[1]);
                let reference_c = self.temperature_c.unwrap_or(middle_c);
                Some(Arc::new(effects::TemperatureBias { per_c: depends.per_c, reference_c }) as _)
            })),
            Feature::WarmUp => one(self.about.and_then(|about| {
                let drift = about.drift.as_ref()?;
                let tau_s = drift.tau_s?;
                // The report has the change from the record's beginning to its end.
                let amplitude = drift.change / (-self.record_s / tau_s).exp_m1();
                Some(Arc::new(effects::WarmUp { amplitude, tau_s }) as _)
            })),
            Feature::Resolution => {
                one(self.level.and_then(|level| Some(Arc::new(effects::Resolution { step: level.step? }) as _)))
            }
        }
    }

    fn lines(&self, broad: bool) -> impl Iterator<Item = &Line> {
        self.about.into_iter().flat_map(move |about| about.lines.iter().filter(move |line| line.broad == broad))
    }

    /// What a band of vibration holds besides the lines in it that are tones already; None where that is hardly anything.
    fn resonance(&self, band: &Line) -> Option<Arc<dyn effects::Effect>> {
        /// Least share of a band's power that is worth an effect.
        const LEAST: f64 = 0.1;
        let power = 0.5 * band.amplitude * band.amplitude;
        let inside = |line: &&Line| (band.band_hz[0]..=band.band_hz[1]).contains(&line.frequency_hz);
        let of_tones: f64 = match self.wanted.contains(&Feature::Tone) {
            true => self.lines(false).filter(inside).map(|line| 0.5 * line.amplitude * line.amplitude).sum(),
            false => 0.0,
        };
        let rest = power - of_tones;
        if rest < LEAST * power {
            return None;
        }
        // The peak of such a process is sigma²/(π bandwidth) above the white noise.
        let n = self.found.n.value?;
        let width_hz = power / (std::f64::consts::PI * (band.ratio - 1.0) * n * n);
        let bandwidth_hz = width_hz.min(band.band_hz[1] - band.band_hz[0]);
        // The strongest line in it tells where it is better than the band's middle.
        let strongest = self.lines(false).filter(inside).max_by(|a, b| a.amplitude.total_cmp(&b.amplitude));
        let frequency_hz = strongest.map_or(band.frequency_hz, |line| line.frequency_hz);
        let sound = bandwidth_hz.is_finite() && bandwidth_hz > 0.0;
        sound.then(|| Arc::new(effects::Resonance { frequency_hz, bandwidth_hz, sigma: rest.sqrt() }) as _)
    }
}

fn tone(line: &Line) -> Arc<dyn effects::Effect> {
    Arc::new(effects::Tone { frequency_hz: line.frequency_hz, amplitude: line.amplitude })
}

/// White noise without the part that rounding adds, `density` in U²/Hz.
fn without_rounding(n: &Estimate, density: f64) -> Estimate {
    let less = |value: f64| (value * value - density).max(0.0).sqrt();
    Estimate { value: n.value.map(less), ci95: n.ci95.map(|ends| ends.map(less)), ..n.clone() }
}

/// Mean over a record of what deterministic effects add to the level.
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

/// Intervals of what is identified, limits of what is not.
fn uncertainty(found: &NoiseParameters) -> Map<String, Value> {
    let of = |estimate: &Estimate| match (estimate.ci95, estimate.upper_limit95) {
        (Some(ci95), _) => Some(json!({ "ci95": ci95 })),
        (None, Some(limit)) => Some(json!({ "upper_limit95": limit })),
        (None, None) => None,
    };
    let terms = [("N", &found.n), ("B", &found.b), ("K", &found.k)];
    terms.into_iter().filter_map(|(letter, estimate)| Some((letter.to_owned(), of(estimate)?))).collect()
}

fn provenance(report: &NoiseReport, wanted: &[Feature], software: &str) -> Map<String, Value> {
    let effects: Vec<&str> = wanted.iter().map(|feature| feature.name()).collect();
    let methods: BTreeMap<&str, &str> =
        report.channels.iter().map(|(channel, found)| (channel.name(), found.fit.method.as_str())).collect();
    let mut entries = Map::new();
    for (key, value) in [
        ("capture", json!(report.capture)),
        ("duration_s", json!(report.duration_s)),
        ("samples", json!(report.samples)),
        ("missing", json!(report.missing)),
        ("effects_looked_for", json!(effects)),
        ("methods", json!(methods)),
        ("software", json!(software)),
    ] {
        entries.insert(key.to_owned(), value);
    }
    entries
}
