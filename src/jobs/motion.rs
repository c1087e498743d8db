//! Motion: determines which samples of a plan were taken while the sensor moved. Like gaps, they are excluded from
//! every analysis of noise.
//!
//! One pass over the inertial channels before anything is summed. If a plan's samples are held in memory, the sums are
//! made from the samples of this pass, so that nothing is read twice. The result follows from the samples alone: a job
//! that continues after a kill finds the same motion.

use super::held::Held;
use super::raw_counts::RawCounts;
use super::{JobError, Plan, SampleSource};
use crate::store::Missing;
use imu_noise::robust::BLOCK;
use imu_noise::stillness::{MOTION_CHANNELS, Stillness};
use std::ops::Range;

/// A plan without the samples in motion, and the plan's samples if there is room for all.
#[derive(Debug)]
pub(super) struct AtRest {
    pub(super) plan: Plan,
    pub(super) held: Option<Held>,
}

/// Finds motion and excludes it from the plan; finds channels beyond their measuring range.
///
/// `hold`: whether to keep the samples. `go_on`: called after every chunk of a long capture; an error that it returns
/// ends the work. A short capture is read in one go, so that a job that is interrupted repeatedly still finishes.
pub(super) fn at_rest(
    source: &dyn SampleSource,
    mut plan: Plan,
    hold: bool,
    mut go_on: impl FnMut() -> Result<(), JobError>,
) -> Result<AtRest, JobError> {
    let mut held = if hold { Held::for_plan(&plan) } else { None };
    let mut channels = held.as_ref().map(|held| held.channels().to_vec()).unwrap_or_default();
    channels.extend(MOTION_CHANNELS.iter().filter(|channel| !held.as_ref().is_some_and(|held| held.has(**channel))));
    let at = MOTION_CHANNELS.map(|channel| channels.iter().position(|own| *own == channel));
    let long = plan.end_seq > BLOCK;
    let (mut moving, mut judged, mut beyond) = (Vec::new(), false, [(0, 0); 6]);
    for slice in plan.slices.clone() {
        let missing = source.missing(slice.capture_id)?;
        let samples = slice.samples.end - slice.samples.start;
        let mut stillness = Stillness::new(plan.rate_hz, samples);
        for chunk in plan.chunks(source, slice.samples.clone(), &channels) {
            let chunk = chunk?;
            for (number, rows) in plan.runs(&chunk) {
                if number.is_none() {
                    continue;
                }
                let own = chunk.first_seq + rows.start as u64 - slice.samples.start;
                let column = |at: Option<usize>| chunk.columns.get(at?)?.get(rows.clone());
                stillness.push(own + missing.up_to(own), at.map(|at| column(at).unwrap_or_default()));
            }
            if let Some(held) = &mut held {
                held.take(&chunk);
            }
            if long {
                go_on()?;
            }
        }
        for ((count, of), (own, own_of)) in beyond.iter_mut().zip(stillness.beyond()) {
            *count += own;
            *of += own_of;
        }
        // A capture of a few samples shows no motion, and does not affect the others.
        let Some(places) = stillness.settle() else { continue };
        judged = true;
        moving.extend(places.into_iter().map(|places| {
            let seq = |place: u64| slice.samples.start + first_at(place, samples, &missing);
            seq(places.start)..seq(places.end)
        }));
    }
    plan.raw_counts =
        MOTION_CHANNELS.into_iter().zip(beyond).find_map(|(channel, (count, of))| RawCounts::of(channel, count, of));
    if judged {
        plan.leave_out(moving.into_iter().filter(|range: &Range<u64>| !range.is_empty()).collect());
    }
    Ok(AtRest { plan, held })
}

/// Returns the first sample of `samples` whose place, missing ones included, is not before `place`.
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
    use crate::jobs::Extent;
    use crate::store::{Chunk, StoreError};
    use imu_core::sample::Channel;

    /// Recordings of gyro_x at 40 Hz, by their ids.
    struct Made(Vec<Vec<f64>>);

    impl SampleSource for Made {
        fn read_chunk(&self, id: i64, from: u64, limit: usize, channels: &[Channel]) -> Result<Chunk, StoreError> {
            let values = &self.0[id as usize][from as usize..];
            let values = values[..limit.min(values.len())].to_vec();
            let column =
                |of: &Channel| if *of == Channel::GyroX { values.clone() } else { vec![f64::NAN; values.len()] };
            Ok(Chunk {
                first_seq: from,
                segment: vec![1; values.len()],
                channels: channels.to_vec(),
                columns: channels.iter().map(column).collect(),
                times: None,
            })
        }
        fn missing(&self, _: i64) -> Result<Missing, StoreError> {
            Ok(Missing::of([]))
        }
        fn stamps(&self, _: i64, _: u64, _: usize) -> Result<Vec<Option<(u32, f64)>>, StoreError> {
            Ok(Vec::new())
        }
        fn extent(&self, id: i64, end_seq: u64) -> Result<Extent, StoreError> {
            let (samples, duration_s) = (end_seq, end_seq as f64 / 40.0);
            Ok(Extent {
                capture: id.to_string(),
                duration_s,
                samples,
                missing: 0,
                complete: true,
                captures: Vec::new(),
            })
        }
    }

    fn analysed(made: &Made) -> Plan {
        let plan = |(id, values): (i64, &Vec<f64>)| {
            let segment = 0..values.len();
            Plan::of_recording(id, "made", 40.0, &[Channel::GyroX], std::slice::from_ref(&segment)).unwrap()
        };
        let plans = (0..).zip(&made.0).map(plan);
        let whole = plans.reduce(|whole, plan| whole.followed_by(plan).unwrap()).unwrap();
        at_rest(made, whole, false, || Ok(())).unwrap().plan
    }

    #[test]
    fn a_capture_of_a_few_samples_does_not_hide_the_motion_of_another() {
        let turned = (0..4000).map(|i| if (1000..2000).contains(&i) { 0.5 } else { 1e-4 * f64::from(i % 7) }).collect();
        let plan = analysed(&Made(vec![vec![1e-4, 2e-4, 0.0], turned]));
        let moving_s = plan.shares(&(0..4003)).unwrap().moving_s;
        assert!((25.0..30.0).contains(&moving_s), "{moving_s}");
        assert_eq!(analysed(&Made(vec![vec![0.0; 3], vec![1e-4; 3]])).shares(&(0..6)), None);
    }

    #[test]
    fn a_place_is_that_of_the_first_sample_not_before_it() {
        let missing = Missing::of([(3, 10), (4, 2)]);
        let found: Vec<u64> = [0, 2, 3, 12, 13, 14, 16, 99].map(|place| first_at(place, 6, &missing)).to_vec();
        assert_eq!(found, [0, 2, 3, 3, 3, 4, 4, 6]);
        assert_eq!(first_at(u64::MAX, 6, &missing), 6);
    }
}
