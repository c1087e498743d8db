//! Rounds: the response to the motion and the law of the noise are fitted in turn until neither changes.

use super::align::{Aligned, Lie};
use super::lateness::{self, Delay};
use super::settle::{About, Settled, pricing};
use crate::diagnose::diagnose;
use crate::error::DiagnosisError;
use crate::options::Options;
use crate::outcome::Outcome;
use crate::prepare;
use crate::recording::Recording;
use crate::work::gathered;
use imu_core::sample::Triad;
use imu_model::effects::EffectKind;
use imu_model::simulator::SensorModel;
use std::collections::BTreeSet;

/// Maximum number of rounds; then the result is kept as it is.
const ROUNDS: usize = 4;
/// Part of the prices in the first round, whose noise is only declared.
const LENIENT: f64 = 0.5;
/// Maximum share of samples without a value on a channel. If more samples are at the sensor's limit, the instant is
/// left out of all channels.
const LACKING: f64 = 0.08;

/// The findings in a record of a motion.
#[derive(Debug)]
pub(super) struct Found {
    pub(super) triads: Vec<Settled>,
    /// The findings in the remainder.
    pub(super) rest: Outcome,
    pub(super) lateness: lateness::Verdict,
    /// Nats that a single number has to explain.
    pub(super) price_of_one: f64,
}

/// Finds both in turn.
pub(super) fn run(
    part: &Recording,
    aligned: &Aligned,
    sim: &SensorModel,
    triads: &[Triad],
    options: &Options<'_>,
) -> Result<Found, DiagnosisError> {
    let temperature_c = prepare::temperature(part).map(|(values, _)| values);
    let mut still = sim.clone();
    still.triads.clear();
    let mut noise_model = still.clone();
    let mut before = None;
    let mut round = 0;
    loop {
        let lenient = if round == 0 { LENIENT } else { 1.0 };
        let about = About { part, aligned, sim, noise_model: &noise_model, temperature_c: temperature_c.as_deref() };
        let settled = |index: usize| about.settle(triads[index], triads.len(), options, lenient);
        let settled = gathered(options.workers, triads.len(), settled).ok_or(DiagnosisError::CalledOff)?;
        let settled = settled.into_iter().collect::<Result<Vec<_>, _>>()?;
        let rest = diagnose(&remainder(part, &settled), &still, options)?;
        let now = signature(&settled, &rest.augmented);
        round += 1;
        if (round > 1 && before.as_ref() == Some(&now)) || round == ROUNDS {
            let delays: Vec<Delay> = settled.iter().filter_map(|of| of.delay).collect();
            let price_of_one = pricing(options, triads.len(), 1.0).price(1, 2);
            let lateness = lateness::separate(&delays, aligned.shared, price_of_one);
            return Ok(Found { triads: settled, rest, lateness, price_of_one });
        }
        before = Some(now);
        noise_model = rest.augmented;
    }
}

/// Returns the position of a reference on a separate clock beside a record, to a part of a sample, from the triad that
/// determines it best. Between samples of the record, a motion's corners are lost; between rows of a faster reference
/// they are kept.
pub(super) fn refined(
    part: &Recording,
    aligned: &Aligned,
    sim: &SensorModel,
    triads: &[Triad],
) -> Result<Option<Lie>, DiagnosisError> {
    let mut best: Option<(f64, Lie)> = None;
    let about = About { part, aligned, sim, noise_model: sim, temperature_c: None };
    let middle_s = 0.5 * part.len().saturating_sub(1) as f64 / part.rate_hz;
    for triad in triads {
        let fit = about.delayed(*triad)?;
        let of = |name: &str| fit.estimates.iter().find(|one| one.parameter == name);
        let estimate = of("offset_s").zip(of("rate_error")).and_then(|(offset, rate)| {
            Some((offset.standard_error?, offset.value, rate.standard_error.map_or(0.0, |_| rate.value)))
        });
        let Some((error_s, offset_s, gains)) = estimate else { continue };
        if best.as_ref().is_none_or(|(least_s, _)| error_s < *least_s) {
            // The offset refers to the middle of the part.
            let from_s = aligned.from as f64 / part.rate_hz;
            let begins_s = aligned.begins_s - offset_s + gains * (middle_s + from_s);
            best = Some((error_s, Lie { begins_s, gains, shared: false }));
        }
    }
    Ok(best.map(|(_, lie)| lie))
}

/// The start of a next round: the chosen effects, and the names of those that change the mean or the law's form.
type Signature = (Vec<Vec<usize>>, BTreeSet<(usize, EffectKind)>);

fn signature(settled: &[Settled], noise_model: &SensorModel) -> Signature {
    let names = settled.iter().flat_map(|of| of.triad.channels()).filter_map(|channel| {
        let effects = &noise_model.channels.get(&channel)?.effects;
        Some(effects.iter().map(move |effect| (channel as usize, effect.kind())))
    });
    (settled.iter().map(|of| of.choice.groups.clone()).collect(), names.flatten().collect())
}

/// Returns the record without the responses to the motion.
fn remainder(part: &Recording, settled: &[Settled]) -> Recording {
    let mut rest = part.clone();
    let n = part.len();
    rest.missing.resize(n, false);
    for of in settled {
        for (axis, channel) in of.triad.channels().into_iter().enumerate() {
            let Some((_, values)) = rest.channels.iter_mut().find(|(own, _)| *own == channel) else { continue };
            let sent = std::mem::replace(values, of.rest[axis].clone());
            rest.sent.push((channel, sent));
            let lacking = |t: &usize| !values[*t].is_finite() && !rest.missing[*t];
            let places: Vec<usize> = (0..n).filter(lacking).collect();
            if places.len() as f64 > LACKING * n as f64 {
                places.into_iter().for_each(|t| rest.missing[t] = true);
                // A stamp belongs to every place or to every present sample; stamps of missing samples do not count.
                if rest.time_s.len() != n {
                    rest.time_s.clear();
                }
            }
        }
    }
    rest
}
