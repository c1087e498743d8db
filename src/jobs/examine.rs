//! Disturbances of the captures of a plan: reads their samples once more, channel by channel, after the exact sums.
//!
//! Captures are examined one after the other; the sums of the remaining samples are fitted. Captures of a single block
//! ([`robust::BLOCK`] samples) are examined two channels at a time, and are not read again if their samples are held
//! ([`Held`]). If one is longer, all are read twice, block by block, one channel after the other: memory does not grow
//! with their length.

use super::JobError;
use super::held::Held;
use super::plan::{Plan, Slice};
use super::source::{CHUNK, SampleSource};
use super::threads::side_by_side;
use crate::store::{Chunk, Missing, chunks};
use imu_core::sample::Channel;
use imu_noise::NoiseParameters;
use imu_noise::allan::FixedPoint;
use imu_noise::fit::Flag;
use imu_noise::robust::{self, All, Company, Disturbances, Levels, Part, Portion, Record};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::convert::Infallible;
use std::ops::Range;

/// The result of examining the captures of a plan.
#[derive(Debug, Default)]
pub(super) struct Found {
    /// For each channel the parameters without disturbances, and the disturbances.
    pub(super) channels: BTreeMap<Channel, (NoiseParameters, Disturbances)>,
    /// For several captures the findings in each, in the plan's order.
    pub(super) captures: Vec<BTreeMap<Channel, (Vec<Flag>, Disturbances)>>,
}

impl Found {
    fn take(&mut self, channel: Channel, examined: Examined) {
        for (own, of) in self.captures.iter_mut().zip(examined.captures) {
            own.insert(channel, of);
        }
        self.channels.insert(channel, examined.parameters);
    }
}

/// The result of examining one channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Examined {
    /// The parameters without disturbances, and the disturbances.
    parameters: (NoiseParameters, Disturbances),
    /// For several captures the findings in each, in the plan's order.
    captures: Vec<(Vec<Flag>, Disturbances)>,
}

/// Receives the progress of an examination.
pub(super) trait Steps {
    /// Receives the share of the work done, 0–1; an error ends the work.
    fn go_on(&mut self, _done: f64) -> Result<(), JobError> {
        Ok(())
    }

    /// Returns what [`Self::keep`] received for a channel before the examination was interrupted.
    fn kept(&self, _channel: Channel) -> Option<Examined> {
        None
    }

    /// Receives the results for more channels and the share of the work done.
    fn keep(&mut self, _examined: &[(Channel, Examined)], _done: f64) -> Result<(), JobError> {
        Ok(())
    }
}

/// An examination that is not interrupted.
pub(super) struct InOneGo;

impl Steps for InOneGo {}

/// A capture's samples in blocks of equal length.
#[derive(Debug)]
struct Blocks<'a> {
    slice: &'a Slice,
    missing: Missing,
    count: usize,
    samples: u64,
}

impl<'a> Blocks<'a> {
    fn of(source: &dyn SampleSource, slice: &'a Slice) -> Result<Self, JobError> {
        let samples = slice.samples.end - slice.samples.start;
        let missing = source.missing(slice.capture_id)?;
        Ok(Self { slice, missing, count: robust::blocks_of(samples), samples })
    }

    /// Reads a block's samples from the source.
    fn read(
        &self,
        source: &dyn SampleSource,
        plan: &Plan,
        channels: &[Channel],
        block: usize,
    ) -> Result<Vec<Portion>, JobError> {
        let read = |seq, limit| Ok::<_, JobError>(plan.read_chunk(source, seq, limit, channels)?);
        self.portions(plan, channels, self.range(block), read)
    }

    /// Returns all samples of a channel that are held.
    fn held(&self, held: &Held, plan: &Plan, channel: Channel) -> Portion {
        let read = |seq, limit| Ok::<_, Infallible>(held.chunk(seq, limit, &[channel]));
        let Ok(portions) = self.portions(plan, &[channel], self.slice.samples.clone(), read);
        portions.into_iter().next().unwrap_or_default()
    }

    /// Returns the plan's numbers of a block's samples.
    fn range(&self, block: usize) -> Range<u64> {
        let length = self.samples.div_ceil(self.count as u64);
        let from = self.slice.samples.start + block as u64 * length;
        from.min(self.slice.samples.end)..(from + length).min(self.slice.samples.end)
    }

    /// Returns the samples of channels in a range of the plan's numbers, cut at gaps and absent values; times count
    /// from the capture's first sample. Temperature, which may be sent less often than the rest, keeps its value until
    /// the next one. `read` returns chunks of these channels.
    fn portions<E>(
        &self,
        plan: &Plan,
        channels: &[Channel],
        range: Range<u64>,
        read: impl Fn(u64, usize) -> Result<Chunk, E>,
    ) -> Result<Vec<Portion>, E> {
        let start = self.slice.samples.start;
        let mut all: Vec<Portion> = channels.iter().map(|_| Portion::default()).collect();
        let mut last: Vec<Option<(u32, f64)>> = vec![None; channels.len()];
        // The sample before the range shows whether its first one continues a stretch.
        let from_seq = range.start.saturating_sub(1).max(start);
        for chunk in chunks(from_seq..range.end, CHUNK, read) {
            let chunk = chunk?;
            // A value that the sums reject is no measurement here either.
            let ranges = channels.iter().map(|channel| FixedPoint::for_channel(*channel).range());
            let ranges: Vec<f64> = ranges.collect();
            for (taken, rows) in plan.runs(&chunk) {
                let Some(segment) = chunk.segment.get(rows.start) else { continue };
                let columns = channels.iter().zip(&mut all).zip(&chunk.columns).zip(&mut last).zip(&ranges);
                for ((((channel, portion), column), last), range_of_values) in columns {
                    let values = column.get(rows.clone()).unwrap_or_default();
                    for (number, value) in (chunk.first_seq + rows.start as u64..).zip(values) {
                        let before = last.filter(|(of, _)| of == segment);
                        let kept = before.filter(|_| *channel == Channel::Temperature && !value.is_finite());
                        let value = kept.map_or(*value, |(_, value)| value);
                        // An absent value ends a stretch as a gap does.
                        let is_there = value.abs() <= *range_of_values && taken.is_some();
                        *last = is_there.then_some((*segment, value));
                        if last.is_none() || number < range.start {
                            continue;
                        }
                        if before.is_none() || portion.parts.is_empty() {
                            portion.continues |= before.is_some();
                            let seq = number - start;
                            let start_s = (seq + self.missing.up_to(seq)) as f64 / plan.rate_hz;
                            portion.parts.push(Part { start_s, values: Vec::new() });
                        }
                        if let Some(open) = portion.parts.last_mut() {
                            open.values.push(value);
                        }
                    }
                }
            }
        }
        Ok(all)
    }
}

/// Examines every channel in `all`, capture by capture. `held` contains all samples, if they are held; otherwise they
/// are read again. `steps` is called between captures and portions of long ones, and after each of their channels. A
/// single capture of one block is done in one go, a second or two, so that a job that is stopped repeatedly still
/// finishes.
pub(super) fn examine(
    source: &dyn SampleSource,
    plan: &Plan,
    all: &BTreeMap<Channel, All<'_>>,
    held: Option<Held>,
    steps: &mut dyn Steps,
) -> Result<Found, JobError> {
    let captures: Vec<Blocks<'_>> =
        plan.slices.iter().map(|slice| Blocks::of(source, slice)).collect::<Result<_, _>>()?;
    let company = if captures.len() > 1 { Company::Several } else { Company::Alone };
    let blocks: usize = captures.iter().map(|capture| capture.count).sum();
    let long = blocks > captures.len();
    let held = held.as_ref().filter(|_| !long);
    // One capture of one block is a second or two: it is done in one go.
    let passes = if long { 2 * blocks * all.len() } else { captures.len() * all.len() };
    let share = 1.0 / passes.max(1) as f64;
    let mut done = 0.0;
    let mut temperatures = Vec::new();
    for capture in &captures {
        let mut levels = Levels::new(plan.rate_hz, capture.samples);
        for block in 0..capture.count {
            let column = match held {
                Some(held) => vec![capture.held(held, plan, Channel::Temperature)],
                None => capture.read(source, plan, &[Channel::Temperature], block)?,
            };
            column.iter().for_each(|portion| levels.push(&portion.parts, portion.continues));
        }
        temperatures.push(levels);
    }
    let mut found = Found::default();
    if company == Company::Several {
        found.captures.resize_with(captures.len(), BTreeMap::new);
    }
    let (count, mut channels) = (all.len(), Vec::new());
    for (channel, all) in all {
        match steps.kept(*channel) {
            Some(examined) => {
                done += 1.0 / count as f64;
                found.take(*channel, examined);
            }
            None => channels.push((*channel, all)),
        }
    }
    // Of one capture that is held two channels at a time are examined, whatever the group.
    let is_one = held.is_some() && company == Company::Alone;
    let group_size = if is_one { channels.len().max(1) } else { 2 - usize::from(long) };
    for group in channels.chunks(group_size) {
        let names: Vec<Channel> = group.iter().map(|(channel, _)| *channel).collect();
        let mut records: Vec<Vec<Record>> = names.iter().map(|_| Vec::new()).collect();
        for (capture, temperature) in captures.iter().zip(&temperatures) {
            let looked: Vec<Record> = if long {
                let mut read = |block: usize| {
                    done += share;
                    steps.go_on(done)?;
                    let columns = capture.read(source, plan, &names, block)?;
                    Ok::<_, JobError>(columns.into_iter().next().unwrap_or_default())
                };
                let extent = (capture.samples, capture.count);
                let of =
                    |channel: &Channel| Record::read(*channel, plan.rate_hz, extent, &mut read, temperature, company);
                names.iter().map(of).collect::<Result<_, _>>()?
            } else {
                if captures.len() > 1 {
                    steps.go_on(done)?;
                    done += share * names.len() as f64;
                }
                let columns = match held {
                    Some(_) => names.iter().map(|_| Portion::default()).collect(),
                    None => capture.read(source, plan, &names, 0)?,
                };
                side_by_side(
                    names.iter().zip(columns),
                    || (),
                    |(), (channel, column)| {
                        let portion = held.map_or(column, |held| capture.held(held, plan, *channel));
                        Record::of(*channel, plan.rate_hz, portion.parts, temperature, company)
                    },
                )
            };
            records.iter_mut().zip(looked).for_each(|(records, record)| records.push(record));
        }
        let examined = side_by_side(
            group.iter().zip(records),
            || (),
            |(), ((channel, all), mut records)| match (company, records.pop()) {
                (Company::Alone, Some(record)) => {
                    Examined { parameters: record.alone(*channel, plan.rate_hz, all), captures: Vec::new() }
                }
                (_, last) => {
                    records.extend(last);
                    let of = |record: &Record| (record.flags(*channel), record.disturbances(plan.rate_hz));
                    let captures = match company {
                        Company::Several => records.iter().map(of).collect(),
                        Company::Alone => Vec::new(),
                    };
                    Examined {
                        parameters: robust::parameters_together(*channel, plan.rate_hz, &records, all),
                        captures,
                    }
                }
            },
        );
        let examined: Vec<(Channel, Examined)> = names.into_iter().zip(examined).collect();
        // A single capture of one block is not interrupted.
        if passes > count {
            steps.keep(&examined, done)?;
        }
        examined.into_iter().for_each(|(channel, examined)| found.take(channel, examined));
    }
    Ok(found)
}
