//! Cases: a device with effects that its model lacks or has with other numbers, its key, and recordings of it.

use super::class::{Role, Sense};
use super::columns::{Column, Columns};
use super::declared::{self, declared, with};
use super::draw::Draw;
use super::ground::{as_read, flicker};
use super::impose::{Effect, ImposeError};
use super::key::{Key, TrueEffect};
use super::kind::Kind;
use super::recipe::Recipe;
use super::recorded::Stretch;
use super::report::entries;
use super::setting::{Part, Setting};
use imu_core::sample::Channel;
use imu_diagnosis::Recording;
use imu_model::simulator::SensorModel;
use serde_json::Value;
use std::collections::BTreeMap;

/// An effect of a case.
#[derive(Debug)]
struct Has {
    effect: Effect,
    sense: Sense,
    /// The model's statement of the effect, if there is one.
    declared: Option<BTreeMap<String, Value>>,
    over_limit: f64,
}

/// A sealed case. The same seed and number give the same device with the same events; the take's number determines the noise.
#[derive(Debug)]
pub struct Case {
    seed: u64,
    number: usize,
    take: u32,
    recipe: Recipe,
    setting: Setting,
    has: Vec<Has>,
    /// The model that the diagnosis receives.
    model: SensorModel,
    /// The recording that the case is based on, if there is one.
    stretch: Option<Stretch>,
}

impl Case {
    /// Returns the case `number` of the sealed seed whose model lacks these kinds.
    ///
    /// # Errors
    /// The errors of [`Self::make`].
    pub fn draw(seed: u64, number: usize, kinds: &[Kind]) -> Result<Self, ImposeError> {
        Self::make(seed, number, &Recipe::lacking(kinds), None)
    }

    /// Returns the case `number` of the sealed seed by this recipe, with `samples` samples if given, otherwise with a
    /// drawn number.
    ///
    /// # Errors
    /// [`ImposeError`] for kinds that the device cannot have. A setting is drawn for the kinds, so that only
    /// [`ImposeError::TooShort`] is possible, and [`ImposeError::Unstated`] for a sense that the kind cannot have.
    pub fn make(seed: u64, number: usize, recipe: &Recipe, samples: Option<usize>) -> Result<Self, ImposeError> {
        let kinds: Vec<Kind> = recipe.kinds().collect();
        let mut setting = Setting::draw(&kinds, &mut Draw::device(seed, number as u64, "setting"));
        setting.samples = samples.unwrap_or(setting.samples);
        Self::with(seed, number, recipe, setting, None)
    }

    /// Returns a case of a stretch of an existing recording: the effects act on it.
    ///
    /// # Errors
    /// [`ImposeError`] for kinds that are not among [`Stretch::kinds`].
    pub fn draw_on(seed: u64, number: usize, recipe: &Recipe, stretch: Stretch) -> Result<Self, ImposeError> {
        let kinds: Vec<Kind> = recipe.kinds().collect();
        let setting = stretch.setting(&kinds, &mut Draw::device(seed, number as u64, "setting"));
        Self::with(seed, number, recipe, setting, Some(stretch))
    }

    fn with(
        seed: u64,
        number: usize,
        recipe: &Recipe,
        setting: Setting,
        stretch: Option<Stretch>,
    ) -> Result<Self, ImposeError> {
        let case = number as u64;
        let mut recipe = recipe.clone();
        recipe.effects.sort_by_key(|(kind, _)| kind.place());
        let of = recipe.effects.len();
        let has = |(index, (kind, sense)): (usize, &(Kind, Sense))| {
            let device = |purpose: &str| Draw::device(seed, case, &format!("{purpose} {index}"));
            let effect = Effect::draw(*kind, &setting, Role { sense: *sense, of }, device("effect"), device("events"))?;
            let mut over_limit = effect.over_limit;
            let mut stated = None;
            if sense.is_in_model() {
                let unstated = ImposeError::Unstated { kind: *kind };
                let (declared, factor) = declared(&effect, *sense, &setting, &mut device("told")).ok_or(unstated)?;
                if *sense == Sense::Size {
                    over_limit = declared::over_limit(*kind, over_limit, factor);
                }
                stated = Some(declared);
            }
            Ok(Has { effect, sense: *sense, declared: stated, over_limit })
        };
        let has: Vec<Has> = recipe.effects.iter().enumerate().map(has).collect::<Result<_, _>>()?;
        let model = match &stretch {
            Some(stretch) => stretch.model_of(&setting, true),
            None => setting.model(),
        };
        let mut made = Self { seed, number, take: 1, recipe, setting, has, model, stretch };
        made.model = made.model_with_effects()?;
        Ok(made)
    }

    /// Returns the model with the effects that it states.
    fn model_with_effects(&self) -> Result<SensorModel, ImposeError> {
        let key = self.key();
        let level = |channel: &str| {
            self.setting.parts.iter().find(|part| part.channel.name() == channel).map(|part| part.level)
        };
        key.effects.iter().try_fold(self.model.clone(), |model, effect| {
            let declared = effect.declared.as_ref().map(|declared| (effect, declared));
            with(&model, declared, level).ok_or(ImposeError::Unstated { kind: effect.kind })
        })
    }

    /// Returns the same device recorded again: the same effects at the same times, with other noise. `None` for an
    /// existing recording, and for limits that follow from the samples, because they would differ.
    pub fn again(self) -> Option<Self> {
        let same = self.stretch.is_none() && self.recipe.kinds().all(|kind| kind != Kind::Saturation);
        same.then_some(Self { take: self.take + 1, ..self })
    }

    /// Returns the device and its record's shape.
    pub fn setting(&self) -> &Setting {
        &self.setting
    }

    /// Returns the effects, in the order in which they act.
    pub fn effects(&self) -> impl Iterator<Item = &Effect> {
        self.has.iter().map(|has| &has.effect)
    }

    /// Returns the model that the diagnosis receives.
    pub fn model(&self) -> SensorModel {
        self.model.clone()
    }

    /// Returns whether the recording is read as a table, so that its rate follows from its stamps.
    pub fn is_table(&self) -> bool {
        self.stretch.is_none() && self.setting.stamps.is_some()
    }

    /// For an existing recording, returns its channels without imposed effects, and the model with the case's N, B and
    /// K; for a case without effects, the model fitted to the channels.
    pub fn as_it_is(&self) -> Option<(Recording, SensorModel)> {
        let stretch = self.stretch.as_ref()?;
        Some((stretch.as_it_is(&self.setting), stretch.model_of(&self.setting, !self.has.is_empty())))
    }

    /// Returns the key, without computing any samples.
    pub fn key(&self) -> Key {
        let name = |channel: &Channel| channel.name().to_owned();
        let effect = |has: &Has| TrueEffect {
            kind: has.effect.kind,
            effect: has.effect.kind.effect().map(|effect| effect.name().to_owned()),
            sense: has.sense,
            size: has.effect.size,
            over_limit: has.over_limit,
            channels: has.effect.channels.iter().map(name).collect(),
            parameters: has.effect.parameters.clone(),
            declared: has.declared.clone(),
        };
        Key {
            case: self.number,
            class: self.recipe.class,
            rate_hz: self.setting.rate_hz,
            samples: self.setting.samples,
            channels: self.setting.parts.iter().map(|part| name(&part.channel)).collect(),
            effects: self.has.iter().map(effect).collect(),
            true_nbk: self.setting.parts.iter().map(|part| (name(&part.channel), part.true_nbk)).collect(),
            stamps: self.setting.stamps,
            salt: Draw::capture(self.seed, self.number as u64, 1, "salt").salt(),
        }
    }

    /// Returns the recording.
    pub fn record(&self) -> Recording {
        let imposed: Vec<(usize, &Effect)> = self
            .has
            .iter()
            .enumerate()
            .filter(|(_, has)| has.sense.is_in_sensor())
            .map(|(at, has)| (at, &has.effect))
            .collect();
        if let Some(stretch) = &self.stretch {
            return stretch.with(&self.setting, &imposed, |purpose| self.stream(purpose));
        }
        let (samples, rate_hz) = (self.setting.samples, self.setting.rate_hz);
        let mut warmth = self.stream("temperature");
        let temperature_c =
            self.setting.temperature.map(|course| course.samples(samples, &mut warmth)).unwrap_or_default();
        let read = self.setting.temperature.map(|_| as_read(&temperature_c, &mut warmth));
        let times = |first: f64| (0..samples).map(|index| first + index as f64 / rate_hz).collect();
        let mut columns = Columns {
            rate_hz,
            columns: self.setting.parts.iter().map(|part| self.column(part)).collect(),
            temperature_c,
            missing: Vec::new(),
            time_s: self.setting.stamps.map(|stamps| times(stamps.first_s)).unwrap_or_default(),
        };
        for (index, effect) in imposed {
            effect.impose(&mut columns, &mut self.stream(&format!("realisation {index}")));
        }
        if let Some(stamps) = self.setting.stamps {
            stamps.write(&mut columns, &mut self.stream("stamps"));
        }
        columns.into_recording(read)
    }

    /// Returns level, white noise, flicker and random walk.
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
        Draw::capture(self.seed, self.number as u64, self.take, purpose)
    }
}

/// Returns the model that corresponds to the key: true N, B and K, and the effects as the sensor has them. `None` if
/// the model format cannot state it: effects outside the library, and limits that follow from the samples.
///
/// `declared` is the model that the diagnosis was given; it keeps its own levels, because means are not compared.
pub fn true_model(key: &Key, declared: &SensorModel) -> Option<SensorModel> {
    if key.effects.iter().any(|effect| !is_expressible(effect.kind)) {
        return None;
    }
    let mut value = serde_json::to_value(declared).ok()?;
    for (channel, nbk) in &key.true_nbk {
        let entry = value.get_mut("channels")?.get_mut(channel)?.as_object_mut()?;
        for (name, parameter) in ["N", "B", "K"].into_iter().zip(nbk) {
            entry.insert(name.to_owned(), (*parameter).into());
        }
        // The model's list begins with the recording's own effects, which are true; those of the case follow.
        if let Some(list) = entry.get_mut("effects").and_then(Value::as_array_mut) {
            let of_case = |declared: &BTreeMap<String, Value>| {
                declared.get(channel).map_or(0, |declared| entries(declared).len())
            };
            let all: usize = key.effects.iter().filter_map(|effect| effect.declared.as_ref()).map(of_case).sum();
            list.truncate(list.len().saturating_sub(all));
        }
    }
    let plain = SensorModel::from_value(&value, "key").ok()?;
    let has = key.effects.iter().filter(|effect| effect.sense.is_in_sensor());
    with(&plain, has.map(|effect| (effect, &effect.parameters)), |_| None)
}

/// Returns whether a model covers every property of an effect of this kind.
fn is_expressible(kind: Kind) -> bool {
    kind.effect().is_some() && kind != Kind::Saturation
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_case_is_the_same_every_time_and_never_has_a_value_that_is_no_number() {
        for (number, kind) in Kind::all().enumerate() {
            let made = || Case::make(11, number, &Recipe::lacking(&[kind]), Some(30_000)).unwrap().record();
            let once = made();
            assert!(once.channels.iter().all(|(_, values)| values.iter().all(|value| value.is_finite())), "{kind}");
            assert!(once.channels.iter().all(|(_, values)| values.len() == once.len()));
            if number % 8 == 0 {
                assert_eq!(once, made(), "{kind}");
            }
        }
    }

    #[test]
    fn a_second_take_has_the_same_device_and_events_and_other_noise() {
        let first = Case::draw(11, 4, &[Kind::Tone, Kind::Bursts]).unwrap();
        let (key, record) = (first.key(), first.record());
        let second = first.again().unwrap();
        assert_eq!(key, second.key());
        assert_ne!(record.channels, second.record().channels);
        assert!(Case::draw(11, 4, &[Kind::Saturation]).unwrap().again().is_none());
    }

    #[test]
    fn what_is_superfluous_is_in_the_model_alone() {
        let of = |sense| Case::make(14, 3, &Recipe::of_model(Kind::Spikes, sense), Some(20_000)).unwrap();
        let most = |case: &Case| {
            let channel = case.effects().next().unwrap().channels[0];
            let recording = case.record();
            let values = recording.values(channel).unwrap();
            let scale = super::super::columns::scale(values);
            values.iter().map(|value| (value - values[0]).abs() / scale).fold(0.0, f64::max)
        };
        let effects = |case: &Case| case.model().channels.values().map(|of| of.effects.len()).sum::<usize>();
        let (missing, superfluous) = (of(Sense::Missing), of(Sense::Superfluous));
        assert!(most(&missing) > most(&superfluous));
        assert_eq!(effects(&missing), 0);
        assert!(effects(&superfluous) > 0 && true_model(&superfluous.key(), &superfluous.model()).is_some());
    }

    #[test]
    fn the_ground_has_its_white_noise() {
        let case = (0..).map(|number| Case::draw(12, number, &[]).unwrap()).find(|case| !case.is_table()).unwrap();
        let recording = case.record();
        for (part, (_, values)) in case.setting().parts.iter().zip(&recording.channels) {
            let steps = values.windows(2).map(|two| (two[1] - two[0]).powi(2)).sum::<f64>();
            let white = (0.5 * steps / (values.len() - 1) as f64).sqrt();
            assert!((white / part.white(recording.rate_hz) - 1.0).abs() < 0.02);
        }
    }

    #[test]
    fn the_truth_is_a_model_where_a_model_can_express_it() {
        for kind in Kind::LIBRARY.iter().copied() {
            let case = Case::draw(13, 1, &[kind]).unwrap();
            let found = true_model(&case.key(), &case.model());
            assert_eq!(found.is_some(), is_expressible(kind), "{kind}");
            let effects =
                found.iter().flat_map(|model| model.channels.values()).map(|of| of.effects.len()).sum::<usize>();
            assert!(found.is_none() || effects >= case.effects().next().unwrap().channels.len(), "{kind}");
        }
        let outside = Case::draw(13, 1, &[Kind::Chirp]).unwrap();
        assert_eq!(true_model(&outside.key(), &outside.model()), None);
    }
}
