//! Model: the sensor model of a plan's samples, at once, for whoever waits for it.

use super::{JobError, Plan, SampleSource, direct, gridded};
use crate::diagnosis::{self, Workers};
use crate::model_fit::{model_of, with_effects};
use crate::noise::statistics::Moments;
use crate::sample::Channel;
use crate::simulator::SensorModel;
use crate::store::{SOFTWARE, StoreError};
use std::collections::BTreeMap;

/// Samples read at a time.
const CHUNK: usize = 65_536;

/// The model of a plan's samples, called `name`, with the effects that are wanted, as far as they are found in the part that
/// there is `room` for ([`gridded`]); and why it should not be used, where that is so.
///
/// # Errors
/// [`JobError::Diagnosis`] where effects are wanted and cannot be looked for; what `source` says.
pub fn fitted(
    source: &dyn SampleSource,
    plan: Plan,
    wanted: &[&'static str],
    name: &str,
    room: u64,
    workers: &dyn Workers,
) -> Result<(SensorModel, Option<String>), JobError> {
    let levels = levels(source, &plan)?;
    let gridded = (!wanted.is_empty()).then(|| gridded(source, &plan, room)).transpose()?;
    let report = direct::noise(source, plan)?;
    let plain = model_of(&report, &levels, name, SOFTWARE);
    let Some(gridded) = gridded else { return Ok((plain, report.refusal(|_| true))) };
    let options =
        diagnosis::Options { workers, effects: Some(wanted), believed: false, ..diagnosis::Options::default() };
    let found = diagnosis::diagnose(&gridded.recording, &plain, &options)?;
    let temperature_c = levels.get(&Channel::Temperature).copied();
    let model = with_effects(&plain, &found.augmented, wanted, gridded.recording.length_s(), temperature_c);
    // What effects were added to is the law of the diagnosis, which holds it against the record itself. Nothing makes noise of a
    // motion or of raw counts.
    let effects = |of: &SensorModel, channel| of.channels.get(&channel).map(|of| of.effects.clone());
    let plainly = |channel| effects(&model, channel) == effects(&plain, channel);
    let has_n = |channel| report.channels.get(&channel).is_some_and(|of| of.n.value.is_some());
    let refusal = report.refusal(|channel| !has_n(channel) || plainly(channel));
    Ok((model, refusal))
}

/// Mean of every channel of a plan, and of the temperature where it was recorded.
fn levels(source: &dyn SampleSource, plan: &Plan) -> Result<BTreeMap<Channel, f64>, StoreError> {
    let channels: Vec<Channel> = plan.channels.iter().copied().chain([Channel::Temperature]).collect();
    let mut seen: Vec<Moments> = channels.iter().map(|_| Moments::default()).collect();
    let mut next_seq = 0;
    while next_seq < plan.end_seq {
        let chunk = plan.read_chunk(source, next_seq, CHUNK, &channels)?;
        for (moments, column) in seen.iter_mut().zip(&chunk.columns) {
            column.iter().filter(|value| value.is_finite()).for_each(|value| moments.add(*value));
        }
        next_seq = chunk.next_seq();
    }
    Ok(channels.into_iter().zip(seen).filter_map(|(channel, moments)| Some((channel, moments.mean()?))).collect())
}
