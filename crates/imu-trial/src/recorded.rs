//! Recorded: cases whose noise comes from an existing recording instead of the trial's own noise.
//!
//! A recording has its own lines, knocks and drifts, and not all of them are known. The trial therefore first searches
//! for them: a stretch is diagnosed unchanged, the findings are added to a model, and both steps are repeated until no
//! cause is named or the number of rounds is reached. A case has that model, with N, B and K a little wrong or far off
//! as in made-up cases. An effect is imposed only on channels on which the stretch has no similar effect, because the
//! two could not be separated. A cause that is also named for the same channels without imposed effects, under the
//! model with the same N, B and K, is the recording's own and is neither right nor spurious ([`super::judge`]).
//!
//! If the stretch has a resolution, rounding follows the imposed effects: each value is spread evenly over its step
//! first, and rounding reverses this exactly if no effect was imposed.

use super::setting::Own;

use super::columns::{Columns, around, scale};
use super::draw::Draw;
use super::ground::TemperatureCourse;
use super::impose::{Effect, SAMPLES_MIN};
use super::kind::Kind;
use super::setting::{Part, SIX, Setting, declared, is_of_another};
use super::stamps::Stamps;
use imu_core::sample::Channel;
use imu_diagnosis::Recording;
use imu_model::EffectKind;
use imu_model::simulator::{ChannelModel, SensorModel};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// A temperature that varies less than this, °C, carries no information about effects that depend on it.
const SPREAD_C: f64 = 0.5;
/// The temperature's readings are steps: effects that depend on it follow their mean over this time, s.
const SMOOTH_S: f64 = 60.0;
/// Flicker and walk of an initial model, in units of the white part per sample: those of the study's devices.
const FIRST: [f64; 2] = [0.063, 8e-4];

/// The properties of a recording that are known before cases are made from it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Survey {
    /// The number of stretches.
    pub stretches: usize,
    /// The kinds that can be imposed on every stretch.
    pub kinds: Vec<Kind>,
}

/// The reasons why there are no cases from a recording.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RecordedError {
    /// The recording is too short.
    #[error("the recording has {found} samples; a case takes {needed}")]
    TooShort {
        /// The minimum number of samples.
        needed: usize,
        /// The number of samples.
        found: usize,
    },
    /// No channel varies.
    #[error("no channel of the recording varies")]
    Constant,
}

/// A stretch of a recording with the model that has the recording's own effects.
#[derive(Debug, Clone, PartialEq)]
pub struct Stretch {
    /// The stretch.
    pub recording: Recording,
    /// N, B, K and the recording's own effects.
    pub model: SensorModel,
    /// The recording's own effects by channel, and those that are still named under the model.
    pub own: Own,
}

/// Cuts a recording into consecutive stretches of `samples`; a shorter recording is one stretch. The remainder at the
/// end is left out.
///
/// # Errors
/// [`RecordedError`] if no stretch is long enough, or if no channel varies.
pub fn cut(recording: &Recording, samples: usize) -> Result<Vec<Recording>, RecordedError> {
    cut_in(recording, samples, SAMPLES_MIN)
}

/// Cuts as [`cut`] does, into stretches that have at least `needed` samples.
///
/// # Errors
/// The errors of [`cut`].
pub fn cut_in(recording: &Recording, samples: usize, needed: usize) -> Result<Vec<Recording>, RecordedError> {
    let length = samples.min(recording.len());
    if length < needed {
        return Err(RecordedError::TooShort { needed, found: length });
    }
    let varies = |(_, values): &&(Channel, Vec<f64>)| scale(&filled(values)) > 0.0;
    let channels: Vec<&(Channel, Vec<f64>)> = recording.channels.iter().filter(varies).collect();
    if channels.is_empty() {
        return Err(RecordedError::Constant);
    }
    let part = |number: usize| {
        let places = number * length..(number + 1) * length;
        let missing = recording.missing.get(places.clone()).unwrap_or_default().to_vec();
        // Stamps are per place, or per present sample.
        let there = |until: usize| until - recording.missing.iter().take(until).filter(|missing| **missing).count();
        let stamps = if recording.time_s.len() == recording.len() {
            places.clone()
        } else {
            there(places.start)..there(places.end)
        };
        Recording {
            rate_hz: recording.rate_hz,
            channels: channels.iter().map(|(channel, values)| (*channel, values[places.clone()].to_vec())).collect(),
            missing: if missing.contains(&true) { missing } else { Vec::new() },
            temperature_c: recording.temperature_c.as_ref().map(|of| of[places.clone()].to_vec()),
            time_s: recording.time_s.get(stamps).unwrap_or_default().to_vec(),
            ..Recording::default()
        }
    };
    Ok((0..recording.len() / length).map(part).collect())
}

/// Returns an initial model: white noise from the differences between neighbours, flicker and walk as in a device.
pub fn first_model(recording: &Recording) -> SensorModel {
    let rate_hz = recording.rate_hz;
    let channel = |(channel, values): &(Channel, Vec<f64>)| {
        let white = scale(&filled(values));
        let (n, b, k) = (white / rate_hz.sqrt(), FIRST[0] * white, FIRST[1] * white * rate_hz.sqrt());
        (*channel, ChannelModel { n, b, k, ..ChannelModel::default() })
    };
    let channels = recording.channels.iter().map(channel).collect();
    SensorModel { name: "as it is".to_owned(), rate_hz, channels, ..SensorModel::default() }
}

impl Stretch {
    /// Creates a stretch with the causes that a diagnosis under the model still names: effect and channels.
    pub fn new(recording: Recording, model: SensorModel, named: &[(String, Vec<String>)]) -> Self {
        let mut own = Own::new();
        for (channel, of) in &model.channels {
            own.entry(*channel).or_default().extend(of.effects.iter().map(|effect| effect.name().to_owned()));
        }
        for (effect, channels) in named {
            for channel in channels.iter().filter_map(|name| Channel::from_name(name)) {
                own.entry(channel).or_default().insert(effect.clone());
            }
        }
        Self { recording, model, own }
    }

    /// Returns the kinds that can be imposed on the stretch.
    pub fn kinds(&self) -> Vec<Kind> {
        let temperature = self.temperature().is_some();
        let stamps = self.recording.missing.is_empty() && self.recording.time_s.len() == self.recording.len();
        let possible = |kind: &Kind| {
            self.free(*kind).len() >= kind.channels_min()
                && (temperature || !kind.needs_temperature())
                && (!kind.needs_stamps() || (stamps && self.free(*kind).len() == self.model.channels.len()))
        };
        Kind::all().filter(possible).collect()
    }

    /// Returns the channels without an effect similar to a kind.
    fn free(&self, kind: Kind) -> Vec<Channel> {
        let like = |channel: &Channel| {
            self.own.get(channel).is_some_and(|own| kind.like().iter().any(|effect| own.contains(effect.name())))
        };
        self.model.channels.keys().copied().filter(|channel| !like(channel)).collect()
    }

    /// Returns mean and spread of the temperature in the form of a course, if it varies enough.
    fn temperature(&self) -> Option<TemperatureCourse> {
        let celsius: Vec<f64> =
            self.recording.temperature_c.iter().flatten().copied().filter(|value| value.is_finite()).collect();
        let count = celsius.len().max(1) as f64;
        let mean = celsius.iter().sum::<f64>() / count;
        let spread = (celsius.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
        (spread >= SPREAD_C).then_some(TemperatureCourse { start_c: mean, rise_c: 0.0, settles: 0.2, wander_c: spread })
    }

    /// Returns some of the channels, enough for these kinds, with N, B and K of a model that is a little wrong or far
    /// off.
    pub fn setting(&self, kinds: &[Kind], device: &mut Draw) -> Setting {
        let (rate_hz, samples) = (self.recording.rate_hz, self.recording.len());
        let mut all: Vec<Channel> = self.model.channels.keys().copied().collect();
        let count = if all.len() >= 6 && device.chance(SIX) { 6 } else { all.len().min(2) };
        let mut chosen: BTreeSet<Channel> = BTreeSet::new();
        for kind in kinds {
            let mut free = self.free(*kind);
            device.shuffle(&mut free);
            chosen.extend(free.into_iter().take(kind.channels_min()));
        }
        device.shuffle(&mut all);
        for channel in all {
            if chosen.len() < count {
                chosen.insert(channel);
            }
        }
        let far = is_of_another(device);
        let part = |channel: &Channel| {
            let of = self.model.channels.get(channel)?;
            let values = filled(self.recording.values(*channel)?);
            let level = values.iter().sum::<f64>() / values.len() as f64;
            let n = if of.n > 0.0 { of.n } else { scale(&values) / rate_hz.sqrt() };
            let true_nbk = [n, of.b, of.k];
            let declared_nbk = declared(true_nbk, far, device);
            Some(Part { channel: *channel, level, true_nbk, declared_nbk, declared_bias: None })
        };
        let parts = chosen.iter().filter_map(part).collect();
        let stamped = self.recording.time_s.len() == samples;
        Setting {
            rate_hz,
            samples,
            parts,
            temperature: self.temperature(),
            stamps: self.recording.time_s.first().copied().filter(|_| stamped).map(Stamps::exact),
            own: self.own.clone(),
        }
    }

    /// Returns the model with these channels alone: as fitted, or as a case states it.
    pub fn model_of(&self, setting: &Setting, declared: bool) -> SensorModel {
        let mut model = self.model.clone();
        model.channels.retain(|channel, _| setting.parts.iter().any(|part| part.channel == *channel));
        for part in setting.parts.iter().filter(|_| declared) {
            if let Some(of) = model.channels.get_mut(&part.channel) {
                [of.n, of.b, of.k] = part.declared_nbk;
                of.uncertainty = None;
            }
        }
        model
    }

    /// Returns these channels unchanged.
    pub fn as_it_is(&self, setting: &Setting) -> Recording {
        let wanted = |channel: &Channel| setting.parts.iter().any(|part| part.channel == *channel);
        let channels = self.recording.channels.iter().filter(|(channel, _)| wanted(channel)).cloned().collect();
        let Recording { rate_hz, missing, temperature_c, time_s, .. } = &self.recording;
        Recording {
            rate_hz: *rate_hz,
            channels,
            missing: missing.clone(),
            temperature_c: temperature_c.clone(),
            time_s: time_s.clone(),
            ..Recording::default()
        }
    }

    /// Returns these channels with imposed effects; `stream` returns the draws for a purpose.
    pub fn with(&self, setting: &Setting, effects: &[(usize, &Effect)], stream: impl Fn(&str) -> Draw) -> Recording {
        let untouched = self.as_it_is(setting);
        if effects.is_empty() {
            return untouched;
        }
        let mut ready = untouched.clone();
        ready.channels.iter_mut().for_each(|(_, values)| *values = filled(values));
        let touched = |channel: Channel| effects.iter().any(|(_, effect)| effect.channels.contains(&channel));
        let steps: Vec<Option<f64>> =
            ready.channels.iter().map(|(channel, _)| self.step(*channel).filter(|_| touched(*channel))).collect();
        for ((channel, values), step) in ready.channels.iter_mut().zip(&steps) {
            let mut draw = stream(&format!("within the step of {channel}"));
            if let Some(step) = step {
                values.iter_mut().for_each(|value| *value += step * draw.uniform(-0.499, 0.499));
            }
        }
        let mut columns = Columns::of(&ready);
        if let Some(read) = &untouched.temperature_c {
            let window = ((SMOOTH_S * untouched.rate_hz) as usize).clamp(1, untouched.len() / 8);
            columns.temperature_c = around(&filled(read), window);
        }
        let mut rounded = false;
        for (index, effect) in effects {
            if effect.kind.place() > Kind::Resolution.place() && !rounded {
                round(&mut columns, &steps);
                rounded = true;
            }
            effect.impose(&mut columns, &mut stream(&format!("realisation {index}")));
        }
        if !rounded {
            round(&mut columns, &steps);
        }
        // Samples without a value before have none now.
        for (column, (_, values)) in columns.columns.iter_mut().zip(&untouched.channels) {
            let lost = column.values.iter_mut().zip(values).filter(|(_, value)| !value.is_finite());
            lost.for_each(|(value, _)| *value = f64::NAN);
        }
        columns.into_recording(untouched.temperature_c)
    }

    /// Returns the own resolution of a channel, U.
    fn step(&self, channel: Channel) -> Option<f64> {
        let effects = &self.model.channels.get(&channel)?.effects;
        let own = effects.iter().find(|effect| effect.kind() == EffectKind::Resolution)?;
        own.number("step")
    }
}

fn round(columns: &mut Columns, steps: &[Option<f64>]) {
    for (column, step) in columns.columns.iter_mut().zip(steps) {
        if let Some(step) = step {
            column.values.iter_mut().for_each(|value| *value = step * (*value / step).round());
        }
    }
}

/// Returns the values with gaps filled by the last value before, or by the first one after if there is none.
fn filled(values: &[f64]) -> Vec<f64> {
    let mut last = values.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0);
    let mut next = |value: &f64| {
        if value.is_finite() {
            last = *value;
        }
        last
    };
    values.iter().map(&mut next).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Case;
    use crate::recipe::Recipe;
    use serde_json::json;

    /// Returns a simulated case in the form of an existing recording, with one channel in steps, and with gaps.
    fn stretch() -> Stretch {
        let made = (0..).map(|number| Case::make(5, number, &Recipe::lacking(&[]), Some(20_000)).unwrap());
        let case = made.into_iter().find(|case| case.setting().parts.len() == 2).unwrap();
        let mut recording = case.record();
        recording.time_s = Vec::new();
        recording.temperature_c = None;
        let step = 0.7 * scale(&recording.channels[0].1);
        recording.channels[0].1.iter_mut().for_each(|value| *value = step * (*value / step).round());
        recording.missing = (0..recording.len()).map(|i| i % 5000 == 4999).collect();
        for place in (4999..recording.len()).step_by(5000) {
            recording.channels.iter_mut().for_each(|(_, values)| values[place] = f64::NAN);
        }
        let mut model = serde_json::to_value(first_model(&recording)).unwrap();
        let first = recording.channels[0].0.name();
        model["channels"][first]["effects"] = json!([{"effect": "resolution", "step": step}]);
        let model = SensorModel::from_value(&model, "test").unwrap();
        Stretch::new(recording, model, &[("tone".to_owned(), vec![first.to_owned()])])
    }

    #[test]
    fn what_a_recording_has_of_itself_is_not_imposed_where_it_has_it() {
        let stretch = stretch();
        let [first, second] = [0, 1].map(|at| stretch.recording.channels[at].0);
        assert_eq!(stretch.free(Kind::Resolution), [second]);
        assert_eq!(stretch.free(Kind::Comb), [second]);
        assert_eq!(stretch.free(Kind::Spikes), [first, second]);
        let kinds = stretch.kinds();
        assert!(kinds.contains(&Kind::Tone) && kinds.contains(&Kind::CommonMode));
        for lacking in [Kind::Timing, Kind::TemperatureBias, Kind::VariancePerC, Kind::Hysteresis] {
            assert!(!kinds.contains(&lacking), "{lacking}");
        }
        for number in 0..30 {
            let case = Case::draw_on(9, number, &Recipe::lacking(&[Kind::Tone]), stretch.clone()).unwrap();
            assert_eq!(case.effects().next().unwrap().channels, [second]);
        }
    }

    #[test]
    fn every_kind_changes_its_channels_alone_and_keeps_steps_and_gaps() {
        let stretch = stretch();
        let step = stretch.step(stretch.recording.channels[0].0).unwrap();
        for (number, kind) in stretch.kinds().into_iter().enumerate() {
            let case = Case::draw_on(9, number, &Recipe::lacking(&[kind]), stretch.clone()).unwrap();
            let recording = case.record();
            assert_eq!(recording.missing, stretch.recording.missing, "{kind}");
            for (channel, values) in &recording.channels {
                let before = stretch.recording.values(*channel).unwrap();
                let same = |(now, then): (&f64, &f64)| now == then || (now.is_nan() && then.is_nan());
                let changed = !values.iter().zip(before).all(same);
                assert_eq!(changed, case.effects().next().unwrap().channels.contains(channel), "{kind} on {channel}");
                assert!(values.iter().zip(before).all(|(now, then)| now.is_nan() == then.is_nan()), "{kind}");
            }
            let first = &recording.channels[0].1;
            let on_step = |value: &f64| value.is_nan() || ((value / step).round() - value / step).abs() < 1e-6;
            assert!(first.iter().all(on_step), "{kind}");
        }
    }

    #[test]
    fn a_small_effect_shows_through_a_coarse_step() {
        // On average, a tenth of the step remains after rounding, because values are first spread over their steps.
        let stretch = stretch();
        let (channel, step) = (stretch.recording.channels[0].0, stretch.step(stretch.recording.channels[0].0).unwrap());
        let of = |number| Case::draw_on(9, number, &Recipe::lacking(&[Kind::BiasStep]), stretch.clone()).unwrap();
        // All steps are over before the examined end.
        let early = |case: &Case| {
            let effect = case.effects().next().unwrap();
            let of =
                effect.parameters.get(channel.name()).and_then(|list| list.as_array().cloned()).unwrap_or_default();
            let over = |one: &serde_json::Value| one["at_s"].as_f64().unwrap() * stretch.recording.rate_hz < 18_500.0;
            !of.is_empty() && of.iter().all(over)
        };
        let case = (0..).map(of).find(early).unwrap();
        let steps = case.effects().next().unwrap().parameters[channel.name()].as_array().unwrap().clone();
        let sum: f64 = steps.iter().map(|one| one["size"].as_f64().unwrap()).sum();
        let last = |values: &[f64]| {
            let end: Vec<f64> = values[19_000..].iter().copied().filter(|value| value.is_finite()).collect();
            end.iter().sum::<f64>() / end.len() as f64
        };
        let found = last(case.record().values(channel).unwrap()) - last(stretch.recording.values(channel).unwrap());
        assert!((found - sum).abs() < 0.05 * step, "{found} for {sum}, step {step}");
    }

    #[test]
    fn a_case_without_effects_is_the_recording_under_a_model_that_is_a_little_wrong_or_far_off() {
        let stretch = stretch();
        let mut far_off = 0;
        for number in 0..40 {
            let case = Case::draw_on(9, number, &Recipe::lacking(&[]), stretch.clone()).unwrap();
            assert_eq!(case.record().len(), stretch.recording.len());
            let off = |(channel, of): (&Channel, &ChannelModel)| {
                let fitted = &stretch.model.channels[channel];
                assert_eq!(of.effects.len(), fitted.effects.len());
                assert!(of.n != fitted.n);
                [of.n / fitted.n, of.b / fitted.b, of.k / fitted.k]
            };
            let off: Vec<[f64; 3]> = case.model().channels.iter().map(off).collect();
            let a_little = off
                .iter()
                .all(|[n, b, k]| (n - 1.0).abs() <= 0.05 && (b - 1.0).abs() <= 0.25 && (k - 1.0).abs() <= 0.4);
            far_off += usize::from(!a_little);
            let within = |factor: f64, most: f64| (1.0 / most..=most).contains(&factor);
            assert!(off.iter().all(|[n, b, k]| within(*n, 3.0) && within(*b, 30.0) && within(*k, 30.0)), "{off:?}");
            assert_eq!(case.as_it_is().unwrap().1, stretch.model);
            let channel = stretch.recording.channels[0].0;
            assert_eq!(case.key().true_nbk[channel.name()][0], stretch.model.channels[&channel].n);
        }
        assert!((6..=22).contains(&far_off), "{far_off} of 40");
    }

    #[test]
    fn a_long_recording_is_cut_and_a_short_one_is_refused() {
        let values: Vec<f64> = (0..50_000).map(|i| f64::from(i % 7)).collect();
        let constant = vec![1.0; values.len()];
        let recording = Recording {
            rate_hz: 40.0,
            channels: vec![(Channel::GyroX, values), (Channel::GyroY, constant)],
            missing: (0..50_000).map(|i| i == 3).collect(),
            temperature_c: None,
            time_s: (0..49_999).map(f64::from).collect(),
            ..Recording::default()
        };
        let parts = cut(&recording, 20_000).unwrap();
        assert_eq!(parts.len(), 2);
        assert_eq!((parts[0].time_s.len(), parts[1].time_s.len(), parts[1].time_s[0]), (19_999, 20_000, 19_999.0));
        assert!(parts[0].missing[3] && parts[1].missing.is_empty());
        assert!(parts.iter().all(|part| part.channels.len() == 1 && part.len() == 20_000));
        assert_eq!(cut(&recording, 80_000).unwrap()[0].len(), 50_000);
        assert!(matches!(cut(&parts[0], 5_000), Err(RecordedError::TooShort { needed: 10_000, found: 5_000 })));
        let still = Recording { channels: vec![recording.channels[1].clone()], ..recording };
        assert_eq!(cut(&still, 20_000), Err(RecordedError::Constant));
    }
}
