//! Cases: a device with effects that its model lacks, its key, and recordings of it.

use super::columns::{Column, Columns};
use super::draw::Draw;
use super::ground::{as_read, flicker};
use super::impose::{Effect, ImposeError};
use super::key::{Key, TrueEffect};
use super::kind::{Class, Kind};
use super::recorded::Stretch;
use super::setting::{Part, Setting};
use crate::diagnosis::Recording;
use crate::sample::Channel;
use crate::simulator::SensorModel;
use serde_json::Value;

/// A sealed case. The same seed and number give the same device; the capture's number gives the realisation.
#[derive(Debug)]
pub struct Case {
    seed: u64,
    number: usize,
    capture: u32,
    setting: Setting,
    effects: Vec<Effect>,
    /// What it is made of, where somebody recorded it.
    stretch: Option<Stretch>,
}

impl Case {
    /// The case `number` of the sealed seed with these kinds, recorded for the `capture`th time (from 1).
    ///
    /// # Errors
    /// [`ImposeError`]: kinds that its device cannot have; a setting is drawn for the kinds, so that there is none for those
    /// of [`Kind::LIBRARY`] and [`Kind::OUTSIDE`].
    pub fn draw(seed: u64, number: usize, kinds: &[Kind], capture: u32) -> Result<Self, ImposeError> {
        Self::draw_of_length(seed, number, kinds, capture, None)
    }

    /// The same with so many samples instead of a drawn number.
    ///
    /// # Errors
    /// As [`Self::draw`], and [`ImposeError::TooShort`].
    pub fn draw_of_length(
        seed: u64,
        number: usize,
        kinds: &[Kind],
        capture: u32,
        samples: Option<usize>,
    ) -> Result<Self, ImposeError> {
        let mut setting = Setting::draw(kinds, &mut Draw::device(seed, number as u64, "setting"));
        setting.samples = samples.unwrap_or(setting.samples);
        Self::with(seed, number, kinds, capture, setting, None)
    }

    /// A case of a stretch that somebody recorded: the effects act on it.
    ///
    /// # Errors
    /// [`ImposeError`]: kinds that are not of [`Stretch::kinds`].
    pub fn draw_on(
        seed: u64,
        number: usize,
        kinds: &[Kind],
        capture: u32,
        stretch: Stretch,
    ) -> Result<Self, ImposeError> {
        let setting = stretch.setting(kinds, &mut Draw::device(seed, number as u64, "setting"));
        Self::with(seed, number, kinds, capture, setting, Some(stretch))
    }

    fn with(
        seed: u64,
        number: usize,
        kinds: &[Kind],
        capture: u32,
        setting: Setting,
        stretch: Option<Stretch>,
    ) -> Result<Self, ImposeError> {
        let case = number as u64;
        let mut kinds = kinds.to_vec();
        kinds.sort_by_key(|kind| kind.place());
        let effect = |(index, kind): (usize, &Kind)| {
            let purpose = format!("effect {index}");
            let device = Draw::device(seed, case, &purpose);
            Effect::draw(*kind, &setting, device, Draw::capture(seed, case, capture, &format!("events {index}")))
        };
        let effects = kinds.iter().enumerate().map(effect).collect::<Result<_, _>>()?;
        Ok(Self { seed, number, capture, setting, effects, stretch })
    }

    /// The device and its record's shape.
    #[must_use]
    pub fn setting(&self) -> &Setting {
        &self.setting
    }

    /// The effects, in the order in which they act.
    #[must_use]
    pub fn effects(&self) -> &[Effect] {
        &self.effects
    }

    /// The model that the diagnosis is given.
    #[must_use]
    pub fn model(&self) -> SensorModel {
        match &self.stretch {
            Some(stretch) => stretch.model_of(&self.setting, true),
            None => self.setting.model(),
        }
    }

    /// Where somebody recorded it: its channels with nothing imposed, and the model as it was fitted to them.
    #[must_use]
    pub fn as_it_is(&self) -> Option<(Recording, SensorModel)> {
        let stretch = self.stretch.as_ref()?;
        Some((stretch.as_it_is(&self.setting), stretch.model_of(&self.setting, false)))
    }

    /// The key; cheap, no sample is made.
    #[must_use]
    pub fn key(&self) -> Key {
        let name = |channel: &Channel| channel.name().to_owned();
        let effect = |effect: &Effect| TrueEffect {
            kind: effect.kind,
            effect: effect.kind.effect().map(str::to_owned),
            size: effect.size,
            over_limit: effect.over_limit,
            channels: effect.channels.iter().map(name).collect(),
            parameters: effect.parameters.clone(),
        };
        let kinds: Vec<Kind> = self.effects.iter().map(|effect| effect.kind).collect();
        Key {
            case: self.number,
            class: Class::of(&kinds),
            rate_hz: self.setting.rate_hz,
            samples: self.setting.samples,
            channels: self.setting.parts.iter().map(|part| name(&part.channel)).collect(),
            effects: self.effects.iter().map(effect).collect(),
            true_nbk: self.setting.parts.iter().map(|part| (name(&part.channel), part.true_nbk)).collect(),
            salt: self.stream("salt").salt(),
        }
    }

    /// The recording.
    #[must_use]
    pub fn record(&self) -> Recording {
        if let Some(stretch) = &self.stretch {
            return stretch.with(&self.setting, &self.effects, |purpose| self.stream(purpose));
        }
        let (samples, rate_hz) = (self.setting.samples, self.setting.rate_hz);
        let mut warmth = self.stream("temperature");
        let temperature_c =
            self.setting.temperature.map(|course| course.samples(samples, &mut warmth)).unwrap_or_default();
        let read = self.setting.temperature.map(|_| as_read(&temperature_c, &mut warmth));
        let stamp = |first: f64| (0..samples).map(|index| first + index as f64 / rate_hz).collect();
        let mut columns = Columns {
            rate_hz,
            columns: self.setting.parts.iter().map(|part| self.column(part)).collect(),
            temperature_c,
            missing: Vec::new(),
            time_s: self.setting.first_stamp_s.map(stamp).unwrap_or_default(),
        };
        for (index, effect) in self.effects.iter().enumerate() {
            effect.impose(&mut columns, &mut self.stream(&format!("realisation {index}")));
        }
        columns.into_recording(read)
    }

    /// Level, white noise, flicker and random walk.
    fn column(&self, part: &Part) -> Column {
        let (samples, rate_hz) = (self.setting.samples, self.setting.rate_hz);
        let mut draw = self.stream(part.channel.name());
        let (scale, step) = (part.white(rate_hz), part.walk(rate_hz));
        let white: Vec<f64> = (0..samples).map(|_| scale * draw.normal()).collect();
        let mut values = flicker(samples, part.true_nbk[1], &mut draw.split());
        let mut walk = part.level;
        for (value, white) in values.iter_mut().zip(&white) {
            walk += step * draw.normal();
            *value += walk + white;
        }
        Column { channel: part.channel, values, white, scale }
    }

    fn stream(&self, purpose: &str) -> Draw {
        Draw::capture(self.seed, self.number as u64, self.capture, purpose)
    }
}

/// The model that has what the key says: true N, B and K, and the effects in the contract's form; `None` where the model
/// format cannot say it: what is outside the library, limits that follow from the samples, and filters, which have a little noise
/// behind them that no parameter describes.
///
/// `told` is the model that the diagnosis was given; levels stay its own, since a mean is not compared.
#[must_use]
pub fn true_model(key: &Key, told: &SensorModel) -> Option<SensorModel> {
    let mut value = serde_json::to_value(told).ok()?;
    for (channel, nbk) in &key.true_nbk {
        let entry = value.get_mut("channels")?.get_mut(channel)?.as_object_mut()?;
        for (name, parameter) in ["N", "B", "K"].into_iter().zip(nbk) {
            entry.insert(name.to_owned(), (*parameter).into());
        }
        // A recording's own effects are told, and are true.
        let mut effects = entry.get("effects").and_then(Value::as_array).cloned().unwrap_or_default();
        for effect in &key.effects {
            if !can_be_said(effect.kind) {
                return None;
            }
            let name = effect.effect.as_ref()?;
            let Some(told) = effect.parameters.get(channel) else { continue };
            for one in told.as_array().map_or_else(|| std::slice::from_ref(told), Vec::as_slice) {
                let mut one = one.as_object()?.clone();
                one.insert("effect".to_owned(), name.as_str().into());
                effects.push(Value::Object(one));
            }
        }
        if !effects.is_empty() {
            entry.insert("effects".to_owned(), effects.into());
        }
    }
    SensorModel::from_value(&value, "key").ok()
}

/// Whether a model has all that an effect of this kind does.
fn can_be_said(kind: Kind) -> bool {
    kind.effect().is_some() && !matches!(kind, Kind::Saturation | Kind::LowPass | Kind::MovingAverage)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_case_is_the_same_every_time_and_never_has_a_value_that_is_no_number() {
        for (number, kind) in Kind::LIBRARY.into_iter().chain(Kind::OUTSIDE).enumerate() {
            let made = || Case::draw(11, number, &[kind], 1).unwrap().record();
            let once = made();
            assert!(once.channels.iter().all(|(_, values)| values.iter().all(|value| value.is_finite())), "{kind}");
            assert!(once.channels.iter().all(|(_, values)| values.len() == once.len()));
            if number % 8 == 0 {
                assert_eq!(once, made(), "{kind}");
            }
        }
    }

    #[test]
    fn a_second_capture_has_the_same_device_and_other_noise() {
        let of = |capture| Case::draw(11, 4, &[Kind::Tone, Kind::Bursts], capture).unwrap();
        let (first, second) = (of(1), of(2));
        assert_eq!(first.setting(), second.setting());
        assert_eq!(first.effects()[0].parameters, second.effects()[0].parameters);
        assert_ne!(first.effects()[1].parameters, second.effects()[1].parameters);
        assert_ne!(first.record().channels, second.record().channels);
    }

    #[test]
    fn the_ground_has_its_white_noise() {
        let case = Case::draw(12, 0, &[], 1).unwrap();
        let recording = case.record();
        for (part, (_, values)) in case.setting().parts.iter().zip(&recording.channels) {
            let steps = values.windows(2).map(|two| (two[1] - two[0]).powi(2)).sum::<f64>();
            let white = (0.5 * steps / (values.len() - 1) as f64).sqrt();
            assert!((white / part.white(recording.rate_hz) - 1.0).abs() < 0.02);
        }
    }

    #[test]
    fn the_truth_is_a_model_where_a_model_can_say_it() {
        for kind in Kind::LIBRARY {
            let case = Case::draw(13, 1, &[kind], 1).unwrap();
            let found = true_model(&case.key(), &case.model());
            assert_eq!(found.is_some(), can_be_said(kind), "{kind}");
            let effects =
                found.iter().flat_map(|model| model.channels.values()).map(|of| of.effects.len()).sum::<usize>();
            assert!(found.is_none() || effects >= case.effects()[0].channels.len(), "{kind}");
        }
        let outside = Case::draw(13, 1, &[Kind::Chirp], 1).unwrap();
        assert_eq!(true_model(&outside.key(), &outside.model()), None);
    }
}
