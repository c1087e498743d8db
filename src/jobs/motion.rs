//! Motion: which samples of a plan were taken while the sensor moved. They leave every analysis of noise as a gap does.
//!
//! One pass over the inertial channels before anything is summed. Where a plan's samples are held in memory, the sums are made of
//! what this pass has read, so that nothing is read twice. It follows from the samples alone: a job that goes on after a kill finds
//! the motion it found before.

use super::held::Held;
use super::runner::CHUNK;
use super::{JobError, Plan, SampleSource};
use crate::noise::robust::BLOCK;
use crate::noise::stillness::Stillness;
use crate::sample::Channel;
use crate::store::Missing;
use std::ops::Range;

/// What tells motion.
const TELLING: [Channel; 6] =
    [Channel::GyroX, Channel::GyroY, Channel::GyroZ, Channel::AccelX, Channel::AccelY, Channel::AccelZ];

/// A plan without what moved, and its samples where there is room for all.
#[derive(Debug)]
pub(super) struct AtRest {
    pub(super) plan: Plan,
    pub(super) held: Option<Held>,
}

/// Finds out what moved and leaves it out of the plan. `hold`: whether the samples are wanted. `go_on`: asked after every chunk of a
/// long capture; an error that it answers ends the work. A short one is done in one go, so that a job that is told to end again and
/// again still comes to an end.
pub(super) fn at_rest(
    source: &dyn SampleSource,
    mut plan: Plan,
    hold: bool,
    mut go_on: impl FnMut() -> Result<(), JobError>,
) -> Result<AtRest, JobError> {
    let mut held = if hold { Held::for_plan(&plan) } else { None };
    let mut channels = held.as_ref().map(|held| held.channels().to_vec()).unwrap_or_default();
    channels.extend(TELLING.iter().filter(|channel| !held.as_ref().is_some_and(|held| held.has(**channel))));
    let at = TELLING.map(|channel| channels.iter().position(|own| *own == channel));
    let long = plan.end_seq > BLOCK;
    let (mut moving, mut judged) = (Vec::new(), true);
    for slice in plan.slices.clone() {
        let missing = source.missing(slice.capture_id)?;
        let samples = slice.samples.end - slice.samples.start;
        let mut stillness = Stillness::new(plan.rate_hz, samples + missing.up_to(samples));
        let mut next_seq = slice.samples.start;
        while next_seq < slice.samples.end {
            let limit = CHUNK.min(usize::try_from(slice.samples.end - next_seq).unwrap_or(CHUNK));
            let chunk = plan.read_chunk(source, next_seq, limit, &channels)?;
            for (number, rows) in plan.runs(&chunk) {
                if number.is_none() {
                    continue;
                }
                let own = chunk.first_seq + rows.start as u64 - slice.samples.start;
                let column = |at: Option<usize>| chunk.columns.get(at?)?.get(rows.clone());
                stillness.push(own + missing.up_to(own), at.map(|at| column(at).unwrap_or_default()));
            }
            next_seq = chunk.next_seq();
            if let Some(held) = &mut held {
                held.take(&chunk);
            }
            if long {
                go_on()?;
            }
        }
        match stillness.settle() {
            Some(places) => moving.extend(places.into_iter().map(|places| {
                let seq = |place: u64| slice.samples.start + first_at(place, samples, &missing);
                seq(places.start)..seq(places.end)
            })),
            None => judged = false,
        }
    }
    if judged {
        plan.leave_out(moving.into_iter().filter(|range: &Range<u64>| !range.is_empty()).collect());
    }
    Ok(AtRest { plan, held })
}

/// The first sample of `samples` whose place, missing ones counted, is not before `place`.
fn first_at(place: u64, samples: u64, missing: &Missing) -> u64 {
    let (mut from, mut to) = (0, samples);
    while from < to {
        let middle = from.midpoint(to);
        if middle + missing.up_to(middle) < place {
            from = middle + 1;
        } else {
            to = middle;
        }
    }
    from
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_that_of_the_first_sample_not_before_it() {
        let missing = Missing::of([(3, 10), (4, 2)]);
        let found: Vec<u64> = [0, 2, 3, 12, 13, 14, 16, 99].map(|place| first_at(place, 6, &missing)).to_vec();
        assert_eq!(found, [0, 2, 3, 3, 3, 4, 4, 6]);
        assert_eq!(first_at(u64::MAX, 6, &missing), 6);
    }
}
