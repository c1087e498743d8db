//! Checking: whether a model can be simulated at a rate. All models from files, requests and code are checked here.

use super::{ChannelModel, Sampling, SensorModel};
use crate::effects::{Effect, LARGEST, Refusal, Scope};
use imu_core::sample::{Channel, Triad};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The part of a model that cannot be simulated.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{path}: found {found}; expected {expected}")]
pub struct Fault {
    /// The place inside the model, such as `channels.gyro_x.N`.
    pub path: String,
    /// The value that was found.
    pub found: String,
    /// The values that are allowed.
    pub expected: String,
}

impl Fault {
    fn new(path: impl Into<String>, found: impl ToString, expected: impl Into<String>) -> Self {
        Self { path: path.into(), found: found.to_string(), expected: expected.into() }
    }
    fn of(place: &str, refusal: Refusal) -> Self {
        Self::new(format!("{place}.{}", refusal.parameter), refusal.found, refusal.allowed)
    }
}

/// A shared effect: its name, the triad that shares it (else the whole sensor), and its index among several.
type Shared<'a> = (&'a str, Option<Triad>, usize);

impl SensorModel {
    /// Checks whether the model can be simulated with an output of `rate_hz`.
    ///
    /// # Errors
    /// The first [`Fault`].
    pub fn check(&self, rate_hz: f64) -> Result<(), Fault> {
        if let Some(sampling) = &self.sampling {
            sampling.check(rate_hz)?;
        }
        if self.channels.is_empty() {
            return Err(Fault::new("channels", "{}", "at least one channel"));
        }
        for (channel, parameters) in &self.channels {
            parameters.check(&format!("channels.{channel}"), self.internal_rate_hz(rate_hz), rate_hz)?;
        }
        for (triad, model) in &self.triads {
            let place = format!("triads.{}", triad.name());
            if !model.effects.is_empty() && !self.channels.keys().any(|channel| channel.triad() == Some(*triad)) {
                let expected = "effects on triads whose channels the model has";
                return Err(Fault::new(place, format!("no {} channel in the model", triad.name()), expected));
            }
            for (index, effect) in model.effects.iter().enumerate() {
                effect.check(*triad).map_err(|refusal| Fault::of(&format!("{place}.effects[{index}]"), refusal))?;
            }
        }
        self.check_shared()
    }

    /// Checks that channels agree about the effects that they share.
    fn check_shared(&self) -> Result<(), Fault> {
        let mut shared: BTreeMap<Shared<'_>, (Channel, &Arc<dyn Effect>)> = BTreeMap::new();
        for (channel, parameters) in &self.channels {
            let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
            for (index, effect) in parameters.effects.iter().enumerate() {
                let triad = match effect.scope() {
                    Scope::Triad if channel.triad().is_some() => channel.triad(),
                    // Channels share only the source of common mode: each one has its own share of it.
                    Scope::Sensor if effect.timing().is_some() => None,
                    _ => continue,
                };
                let instance = counts.entry(effect.name()).or_default();
                let (first, known) = shared.entry((effect.name(), triad, *instance)).or_insert((*channel, effect));
                *instance += 1;
                if *known != effect {
                    let parameters = |effect: &dyn Effect| {
                        let named = |(name, value): (&str, _)| format!("{name} {value}");
                        effect.parameters().into_iter().map(named).collect::<Vec<_>>().join(", ")
                    };
                    let who = triad.map_or("the sensor", Triad::name);
                    let expected =
                        format!("{} as on {first}, because it concerns all of {who}", parameters(known.as_ref()));
                    let place = format!("channels.{channel}.effects[{index}]");
                    return Err(Fault::new(place, parameters(effect.as_ref()), expected));
                }
            }
        }
        Ok(())
    }
}

impl Sampling {
    /// The longest boxcar.
    const WINDOW_MAX: u64 = crate::effects::MovingAverage::WINDOW_MAX;

    fn check(&self, rate_hz: f64) -> Result<(), Fault> {
        if self.decimation(rate_hz).is_none() {
            let expected = format!("a whole multiple of the output's rate, {rate_hz} Hz");
            return Err(Fault::new("sampling.internal_rate_hz", format!("{} Hz", self.internal_rate_hz), expected));
        }
        if (1..=Self::WINDOW_MAX).contains(&self.filter_window) {
            return Ok(());
        }
        let expected = format!("a whole number from 1 to {}", Self::WINDOW_MAX);
        Err(Fault::new("sampling.filter_window", self.filter_window, expected))
    }

    /// Returns the internal samples per sample of the output at `rate_hz`; `None` if that is not a whole number.
    pub fn decimation(&self, rate_hz: f64) -> Option<usize> {
        let ratio = self.internal_rate_hz / rate_hz;
        let whole = ratio.round();
        let fits = (1.0..=1e6).contains(&whole) && (ratio / whole - 1.0).abs() < 1e-9;
        fits.then_some(whole as usize)
    }
}

/// Writes numbers far from 1 in powers of ten: 1e300 would otherwise have three hundred digits.
fn shown(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 || (1e-6..1e15).contains(&size) { value.to_string() } else { format!("{value:e}") }
}

impl ChannelModel {
    fn check(&self, place: &str, internal_rate_hz: f64, rate_hz: f64) -> Result<(), Fault> {
        for (key, value) in [("N", self.n), ("B", self.b), ("K", self.k)] {
            if !(0.0..=LARGEST).contains(&value) {
                let expected = if value > LARGEST {
                    format!("a number from 0 to {LARGEST:e}")
                } else {
                    "a number of 0 or more".to_owned()
                };
                return Err(Fault::new(format!("{place}.{key}"), shown(value), expected));
            }
        }
        if let Some(bias) = self.bias.filter(|bias| bias.is_nan() || bias.abs() > LARGEST) {
            return Err(Fault::new(
                format!("{place}.bias"),
                shown(bias),
                format!("a number from -{LARGEST:e} to {LARGEST:e}"),
            ));
        }
        for (index, effect) in self.effects.iter().enumerate() {
            let acts_at_hz = if effect.stage().is_internal() { internal_rate_hz } else { rate_hz };
            effect.check(acts_at_hz).map_err(|refusal| Fault::of(&format!("{place}.effects[{index}]"), refusal))?;
        }
        Ok(())
    }
}
