//! Model: computes the sensor model of a plan's samples at once, for a caller that waits.

use super::motion::at_rest;
use super::{JobError, Plan, SampleSource, direct, gridded};
use crate::store::{SOFTWARE, StoreError};
use imu_core::sample::Channel;
use imu_diagnosis::model_fit::{model_of, with_effects};
use imu_diagnosis::report::{Of, Place};
use imu_diagnosis::{Diagnosis, Verdict, Workers};
use imu_model::EffectKind;
use imu_model::simulator::SensorModel;
use imu_noise::NoiseReport;
use imu_noise::statistics::Moments;
use std::collections::BTreeMap;

/// A model of samples.
#[derive(Debug, Clone)]
pub struct Fitted {
    /// The model.
    pub model: SensorModel,
    /// The reason not to use it, if there is one.
    pub refusal: Option<String>,
}

impl Fitted {
    /// Returns the model as the simulator of a diagnosis, and a sentence for its notes if there is a reason not to use
    /// the model.
    ///
    /// # Errors
    /// [`JobError::InsufficientData`] if no channel has white noise and there is a reason for that.
    pub fn as_law(self) -> Result<(SensorModel, Option<String>), JobError> {
        let Some(why) = self.refusal else { return Ok((self.model, None)) };
        let name = &self.model.name;
        if self.model.channels.values().all(|of| of.n == 0.0) {
            let reason = format!("nothing can be compared with the simulator's recording {name}: {why}");
            return Err(JobError::InsufficientData(reason));
        }
        let note = format!("the simulator's recording {name} gives a law that may be wrong: {why}");
        Ok((self.model, Some(note)))
    }
}

/// Returns the model of a plan's samples at rest, named `name`, with the wanted effects, as far as they are found in
/// the part for which there is `room` ([`gridded`]).
///
/// # Errors
/// [`JobError::Diagnosis`] if effects are wanted and cannot be searched for, or the error that `source` reports.
pub fn fitted(
    source: &dyn SampleSource,
    plan: Plan,
    wanted: &[EffectKind],
    name: &str,
    room: u64,
    workers: &dyn Workers,
) -> Result<Fitted, JobError> {
    let at_rest = at_rest(source, plan, true, || Ok(()))?;
    let plan = &at_rest.plan;
    let levels = levels(source, plan)?;
    // If nothing is at rest, the report's refusal states it.
    let gridded = (!wanted.is_empty() && plan.has_rest()).then(|| gridded(source, plan, room)).transpose()?;
    let report = direct::noise_at_rest(source, at_rest)?;
    let plain = model_of(&report, &levels, name, SOFTWARE);
    let Some(gridded) = gridded else {
        return Ok(Fitted { model: plain, refusal: report.refusal(|_| true) });
    };
    let options =
        imu_diagnosis::Options { workers, effects: Some(wanted), believed: false, ..imu_diagnosis::Options::default() };
    let found = imu_diagnosis::diagnose(&gridded.recording, &plain, &options)?;
    let temperature_c = levels.get(&Channel::Temperature).copied();
    let model = with_effects(&plain, &found.augmented, wanted, gridded.recording.length_s(), temperature_c);
    let refusal = refusal(&report, &plain, &model, &found.diagnosis);
    Ok(Fitted { model, refusal })
}

/// Returns the reason not to use a model with effects, if there is one. The base of the effects is the law of the
/// diagnosis, which compares it with the record itself, unless something remains unexplained there. No noise can be
/// determined from a motion or from raw counts.
fn refusal(report: &NoiseReport, plain: &SensorModel, model: &SensorModel, found: &Diagnosis) -> Option<String> {
    let effects = |of: &SensorModel, channel| of.channels.get(&channel).map(|of| of.effects.clone());
    let remains = |channel: Channel| {
        let of_rest = |place: &Place| place.of == Of::Remainder && place.share > imu_diagnosis::MATERIAL;
        found.verdict == Verdict::UnknownEffect
            && found.r#where.iter().any(|place| of_rest(place) && place.channel == channel.name())
    };
    let has_n = |channel| report.channels.get(&channel).is_some_and(|of| of.n.value.is_some());
    report.refusal(|channel| !has_n(channel) || effects(model, channel) == effects(plain, channel) || remains(channel))
}

/// Returns the mean at rest of every channel of a plan, and of the temperature if it was recorded.
fn levels(source: &dyn SampleSource, plan: &Plan) -> Result<BTreeMap<Channel, f64>, StoreError> {
    let channels: Vec<Channel> = plan.channels.iter().copied().chain([Channel::Temperature]).collect();
    let mut seen: Vec<Moments> = channels.iter().map(|_| Moments::default()).collect();
    for chunk in plan.chunks(source, 0..plan.end_seq, &channels) {
        let chunk = chunk?;
        for (_, rows) in plan.runs(&chunk).into_iter().filter(|(number, _)| number.is_some()) {
            for (moments, column) in seen.iter_mut().zip(&chunk.columns) {
                let values = column.get(rows.clone()).unwrap_or_default();
                values.iter().filter(|value| value.is_finite()).for_each(|value| moments.add(*value));
            }
        }
    }
    Ok(channels.into_iter().zip(seen).filter_map(|(channel, moments)| Some((channel, moments.mean()?))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::TwoThreads;
    use imu_model::simulator::ChannelModel;
    use imu_noise::fit::Estimate;

    fn model(n: f64) -> SensorModel {
        let channels = [(Channel::GyroX, ChannelModel { n, ..ChannelModel::default() })].into();
        SensorModel { name: "sim".to_owned(), rate_hz: 40.0, channels, ..SensorModel::default() }
    }

    #[test]
    fn a_law_that_should_not_be_used_comes_with_its_reason_and_none_at_all_is_refused() {
        let fitted = |n, refusal: Option<&str>| Fitted { model: model(n), refusal: refusal.map(str::to_owned) };
        assert_eq!(fitted(1e-4, None).as_law().unwrap().1, None);
        let (_, note) = fitted(1e-4, Some("gyro_x: it moved")).as_law().unwrap();
        assert!(note.is_some_and(|note| note.contains("recording sim") && note.ends_with("gyro_x: it moved")));
        let error = fitted(0.0, Some("gyro_x: it moved")).as_law().unwrap_err();
        assert!(matches!(&error, JobError::InsufficientData(reason) if reason.ends_with("it moved")), "{error}");
    }

    /// An effect excuses a channel that contradicts its curve, but not while something remains unexplained on it.
    #[test]
    fn what_effects_leave_unexplained_is_refused() {
        let mut state = 1u64;
        let mut noise = || {
            state = 16_807 * state % 2_147_483_647;
            1e-3 * (state as f64 / 2_147_483_647.0 - 0.5)
        };
        let values = (0..2000).map(|_| noise()).collect();
        let recording = imu_diagnosis::Recording {
            rate_hz: 40.0,
            missing: vec![false; 2000],
            channels: vec![(Channel::GyroX, values)],
            ..imu_diagnosis::Recording::default()
        };
        let plain = model(4.6e-5);
        let mut found = imu_diagnosis::diagnose(
            &recording,
            &plain,
            &imu_diagnosis::Options { workers: &TwoThreads, ..Default::default() },
        )
        .unwrap()
        .diagnosis;
        let mut own = imu_noise::fit::fit(&[], 40.0, Channel::GyroX);
        own.n = Estimate::of("rad/s/√Hz", 4.6e-5, [4e-5, 5e-5]);
        own.refuse("it contradicts the curve".to_owned());
        let mut report: NoiseReport = serde_json::from_value(
            serde_json::json!({"format": "", "capture": "", "rate_hz": 40, "duration_s": 50, "samples": 2000,
            "missing": 0, "complete": true, "channels": {}, "datasheet": null}),
        )
        .unwrap();
        report.channels.insert(Channel::GyroX, own);
        let mut model = plain.clone();
        assert!(refusal(&report, &plain, &model, &found).is_some(), "no effect was added");
        let tone = SensorModel::from_value(
            &serde_json::json!({"format": "vn100d-sensor-model-1", "name": "m", "rate_hz": 40, "channels": {"gyro_x":
                {"effects": [{"effect": "tone", "frequency_hz": 3, "amplitude": 1e-3}]}}}),
            "m",
        );
        model.channels.clone_from(&tone.unwrap().channels);
        // Even noise is not normal: that is handled elsewhere.
        assert!(refusal(&report, &plain, &model, &found).is_some(), "something remains");
        let remainder = std::mem::take(&mut found.r#where);
        assert!(remainder.iter().any(|place| place.of == Of::Remainder));
        assert_eq!(refusal(&report, &plain, &model, &found), None);
        found.verdict = Verdict::UnknownEffect;
        found.r#where = remainder;
        assert!(refusal(&report, &plain, &model, &found).is_some(), "something remains");
    }
}
