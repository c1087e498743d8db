//! Again: whether the result of a diagnosis holds on unseen data.
//!
//! For a case with a gap, the same device is recorded again and diagnosed under the given model and under the corrected
//! one. The corrected model is also simulated with a new seed, and that simulation is diagnosed under the corrected and
//! under the given model.

use super::fit::is_of_delivery;
use super::key::Key;
use super::report::{Cause, Report};
use imu_diagnosis::Recording;
use imu_model::simulator::{SensorModel, Simulator, SimulatorError};
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The tolerance between `closed` on the second record and the stated value.
pub const WITHIN: f64 = 0.03;

/// Four more diagnoses of a case: reports, or the reason why there is none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Diagnoses {
    /// The second record under the given model; none if there can be no second record.
    pub second: Option<Result<Value, String>>,
    /// The second record under the corrected model.
    pub second_corrected: Option<Result<Value, String>>,
    /// A simulation of the corrected model under the corrected model.
    pub itself: Result<Value, String>,
    /// The simulation of the corrected model under the given model.
    pub returns: Result<Value, String>,
}

/// The results of the further diagnoses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Again {
    /// Part of the gap that the corrected model closes on the second record.
    pub closed: Option<f64>,
    /// Whether the second record shows no gap under the corrected model, except in parameters.
    pub second_clean: Option<bool>,
    /// Whether the corrected model explains its own simulation.
    pub itself_clean: bool,
    /// Whether the first named cause, other than the delivery's, is named again for the corrected model's simulation
    /// under the given model; none if no cause was named.
    pub returns: Option<bool>,
}

impl Again {
    /// Evaluates the diagnosis of a case with this key, and the four that followed.
    pub fn of(diagnosis: &Report, then: &Diagnoses, key: &Key) -> Self {
        let report = |of: &Result<Value, String>| of.as_ref().ok().and_then(|value| Report::of(value).ok());
        let clean = |of: &Result<Value, String>| {
            report(of).is_some_and(|report| matches!(report.verdict.as_str(), "no_gap" | "parameters"))
        };
        let second = then.second.as_ref().and_then(|of| of.as_ref().ok());
        let corrected = then.second_corrected.as_ref().and_then(|of| of.as_ref().ok());
        let same = |first: &Cause| {
            let same = |other: &Cause| {
                let shared = |channel: &String| first.channels.contains(channel);
                other.effect == first.effect
                    && other.sense == first.sense
                    && (other.channels.iter().any(shared) || first.channels.is_empty())
            };
            report(&then.returns).is_some_and(|report| report.causes.iter().any(same))
        };
        Self {
            closed: second.zip(corrected).and_then(|(second, corrected)| closed_under(second, corrected)),
            second_clean: then.second_corrected.as_ref().map(clean),
            itself_clean: clean(&then.itself),
            returns: diagnosis.causes.iter().find(|cause| !is_of_delivery(cause, key)).map(same),
        }
    }
}

/// Returns the part of a diagnosis's gap that another model closes: the same discrepancy under that model. `None` if
/// there was no gap to close.
pub fn closed_under(report: &Value, other: &Value) -> Option<f64> {
    let of = |report: &Value, name: &str| report["discrepancy"][name].as_f64();
    let (before, floor) = (of(report, "after_parameters")?, of(report, "floor")?);
    // The other model's parameters are about right: refitting them improves the result only by chance, and may make it
    // worse.
    let after = of(other, "after_parameters")?.min(of(other, "before")?);
    of(report, "closed").filter(|_| before > floor).map(|_| (before - after) / (before - floor))
}

/// Returns a simulation of a model as long as a recording, at its temperature and with its channels; with stamps if the
/// recording has some.
///
/// # Errors
/// [`SimulatorError`] if the model cannot be run.
pub fn simulated(model: &SensorModel, like: &Recording, seed: u64) -> Result<Recording, SimulatorError> {
    let (rate_hz, samples) = (model.rate_hz, like.len());
    let mut simulator = Simulator::new(model, seed, rate_hz, samples as f64 / rate_hz)?;
    if let Some(course) = like.temperature_c.clone() {
        let last = course.len().saturating_sub(1);
        let at = move |time_s: f64| course.get(((time_s * rate_hz) as usize).min(last)).copied().unwrap_or(25.0);
        simulator = simulator.with_temperature(at);
    }
    let channels = like.channels.iter().map(|(channel, _)| (*channel, Vec::with_capacity(samples))).collect();
    let mut made = Recording { rate_hz, channels, temperature_c: like.temperature_c.clone(), ..Recording::default() };
    let (stamped, mut missing) = (!like.time_s.is_empty(), Vec::with_capacity(samples));
    for _ in 0..samples {
        let Some(sample) = simulator.next_sample() else { break };
        made.channels.iter_mut().for_each(|(channel, values)| values.push(sample.values[*channel as usize]));
        missing.push(sample.lost);
        if stamped {
            made.time_s.push(sample.time_s);
        }
    }
    if missing.contains(&true) {
        made.missing = missing;
    }
    Ok(made)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Case;
    use crate::kind::Kind;
    use crate::recipe::Recipe;
    use crate::stamps::Stamps;
    use serde_json::json;

    fn report(verdict: &str, effects: &[&str], before: f64) -> Value {
        let causes: Vec<Value> = effects.iter().map(|of| json!({"effect": of, "channels": ["gyro_x"]})).collect();
        json!({"verdict": verdict, "causes": causes, "discrepancy":
            {"before": before, "after_parameters": before, "floor": 0.1, "after": 0.1, "closed": 1.0}})
    }

    #[test]
    fn what_holds_on_a_second_record_is_counted() {
        let then = Diagnoses {
            second: Some(Ok(report("effects", &["tone"], 1.1))),
            second_corrected: Some(Ok(report("no_gap", &[], 0.2))),
            itself: Ok(report("parameters", &[], 0.1)),
            returns: Ok(report("effects", &["spikes", "tone"], 1.0)),
        };
        let key = |late_s| Key {
            stamps: Some(Stamps { late_s, ..Stamps::exact(0.0) }),
            ..Case::make(5, 1, &Recipe::lacking(&[Kind::Tone]), Some(10_000)).unwrap().key()
        };
        let diagnosis = Report::of(&report("effects", &["timing", "tone"], 1.0)).unwrap();
        assert_eq!(Again::of(&diagnosis, &then, &key(0.0)).returns, Some(false));
        let again = Again::of(&diagnosis, &then, &key(0.01));
        assert!((again.closed.unwrap() - 0.9).abs() < 1e-12);
        assert_eq!((again.second_clean, again.itself_clean, again.returns), (Some(true), true, Some(true)));
        let refused = Diagnoses { second: None, second_corrected: None, itself: Err("constant".to_owned()), ..then };
        let again = Again::of(&Report::of(&report("effects", &["comb"], 1.0)).unwrap(), &refused, &key(0.0));
        assert_eq!(again, Again { returns: Some(false), ..Again::default() });
    }

    #[test]
    fn a_simulation_is_as_long_as_its_recording_and_has_its_channels() {
        let case = Case::make(5, 1, &Recipe::lacking(&[Kind::TemperatureBias]), Some(10_000)).unwrap();
        let (record, model) = (case.record(), case.model());
        let made = simulated(&model, &record, 3).unwrap();
        assert_eq!((made.len(), made.channels.len()), (record.len(), record.channels.len()));
        assert_eq!(made, simulated(&model, &record, 3).unwrap());
        assert_ne!(made, simulated(&model, &record, 4).unwrap());
    }
}
