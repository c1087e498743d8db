//! Disturbances of the captures of a plan: their samples once more, channel by channel, after the exact sums.
//!
//! Captures are looked through one after the other; the sums of what is left are fitted. One of a single block
//! ([`robust::BLOCK`] samples) is read once, two channels at a time; with a longer one all are read twice, block by block, one
//! channel after the other: memory does not grow with their length.

use super::JobError;
use super::plan::{Plan, Slice};
use crate::noise::NoiseParameters;
use crate::noise::fit::Flag;
use crate::noise::robust::{self, Company, Disturbances, Levels, Part, Portion, Record};
use crate::sample::Channel;
use crate::store::{Missing, Reader};
use std::collections::BTreeMap;
use std::ops::Range;

/// Samples read at a time.
const CHUNK: usize = 65_536;

/// What looking through the captures of a plan has come to.
#[derive(Debug, Default)]
pub(super) struct Found {
    /// Parameters without disturbances, and these, of every channel.
    pub(super) channels: BTreeMap<Channel, (NoiseParameters, Disturbances)>,
    /// Of several captures what was found in each, in the plan's order.
    pub(super) captures: Vec<BTreeMap<Channel, (Vec<Flag>, Disturbances)>>,
}

/// A capture's samples in blocks of equal length.
#[derive(Debug)]
struct Blocks<'a> {
    slice: &'a Slice,
    missing: Missing,
    count: usize,
    samples: u64,
}

impl<'a> Blocks<'a> {
    fn of(reader: &Reader, slice: &'a Slice) -> Result<Self, JobError> {
        let samples = slice.samples.end - slice.samples.start;
        let missing = reader.missing(slice.capture_id)?;
        Ok(Self { slice, missing, count: robust::blocks_of(samples), samples })
    }

    fn read(&self, reader: &Reader, plan: &Plan, channels: &[Channel], block: usize) -> Result<Vec<Portion>, JobError> {
        portions(reader, plan, (self.slice, &self.missing), channels, self.range(block))
    }

    /// The plan's numbers of a block's samples.
    fn range(&self, block: usize) -> Range<u64> {
        let length = self.samples.div_ceil(self.count as u64);
        let from = self.slice.samples.start + block as u64 * length;
        from.min(self.slice.samples.end)..(from + length).min(self.slice.samples.end)
    }
}

/// Looks through every channel in `all`, capture by capture. `go_on`: asked between portions of long captures with how much of the
/// work is done, 0–1; an error that it answers ends the work. Captures of one block are done in one go, a second or two: a job
/// that is told to end again and again still comes to an end.
pub(super) fn examine(
    reader: &Reader,
    plan: &Plan,
    all: &BTreeMap<Channel, NoiseParameters>,
    mut go_on: impl FnMut(f64) -> Result<(), JobError>,
) -> Result<Found, JobError> {
    let captures: Vec<Blocks<'_>> =
        plan.slices.iter().map(|slice| Blocks::of(reader, slice)).collect::<Result<_, _>>()?;
    let company = if captures.len() > 1 { Company::Several } else { Company::Alone };
    let blocks: usize = captures.iter().map(|capture| capture.count).sum();
    let long = blocks > captures.len();
    let portions = (2 * blocks * all.len()).max(1) as f64;
    let mut portion = 0.0;
    let mut temperatures = Vec::new();
    for capture in &captures {
        let mut levels = Levels::new(plan.rate_hz, capture.samples);
        for block in 0..capture.count {
            let column = capture.read(reader, plan, &[Channel::Temperature], block)?;
            column.iter().for_each(|portion| levels.push(&portion.parts, portion.continues));
        }
        temperatures.push(levels);
    }
    let mut found = Found::default();
    if company == Company::Several {
        found.captures.resize_with(captures.len(), BTreeMap::new);
    }
    let channels: Vec<(Channel, &NoiseParameters)> = all.iter().map(|(channel, all)| (*channel, all)).collect();
    for group in channels.chunks(if long { 1 } else { 2 }) {
        let names: Vec<Channel> = group.iter().map(|(channel, _)| *channel).collect();
        let mut records: Vec<Vec<Record>> = names.iter().map(|_| Vec::new()).collect();
        for (capture, temperature) in captures.iter().zip(&temperatures) {
            let looked: Vec<Record> = if long {
                let mut read = |block: usize| {
                    portion += 1.0;
                    go_on(portion / portions)?;
                    let columns = capture.read(reader, plan, &names, block)?;
                    Ok::<_, JobError>(columns.into_iter().next().unwrap_or_default())
                };
                let extent = (capture.samples, capture.count);
                let of =
                    |channel: &Channel| Record::read(*channel, plan.rate_hz, extent, &mut read, temperature, company);
                names.iter().map(of).collect::<Result<_, _>>()?
            } else {
                let columns = capture.read(reader, plan, &names, 0)?;
                side_by_side(names.iter().zip(columns), |(channel, portion)| {
                    Record::of(*channel, plan.rate_hz, portion.parts, temperature, company)
                })
            };
            records.iter_mut().zip(looked).for_each(|(records, record)| records.push(record));
        }
        if company == Company::Several {
            for (channel, records) in names.iter().zip(&records) {
                for (own, record) in found.captures.iter_mut().zip(records) {
                    own.insert(*channel, (record.flags(*channel), record.disturbances(plan.rate_hz)));
                }
            }
        }
        let fitted =
            side_by_side(group.iter().zip(records), |((channel, all), mut records)| match (company, records.pop()) {
                (Company::Alone, Some(record)) => record.alone(*channel, plan.rate_hz, (*all).clone()),
                (_, last) => {
                    records.extend(last);
                    robust::parameters_together(*channel, plan.rate_hz, &records, (*all).clone())
                }
            });
        found.channels.extend(names.into_iter().zip(fitted));
    }
    Ok(found)
}

/// Works on each item in a thread of its own.
fn side_by_side<A: Send, T: Send>(items: impl Iterator<Item = A>, work: impl Fn(A) -> T + Sync) -> Vec<T> {
    std::thread::scope(|scope| {
        let work = &work;
        let threads: Vec<_> = items.map(|item| scope.spawn(move || work(item))).collect();
        let joined = threads.into_iter().map(|thread| thread.join());
        joined.map(|done| done.unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
    })
}

/// The samples of channels of a plan over one capture, cut at gaps and absent values, with the times at which they begin.
///
/// # Errors
/// [`JobError::Store`].
pub fn parts(reader: &Reader, plan: &Plan, channels: &[Channel]) -> Result<Vec<Vec<Part>>, JobError> {
    let Some(slice) = plan.slices.first() else { return Ok(vec![Vec::new(); channels.len()]) };
    let missing = reader.missing(slice.capture_id)?;
    let portions = portions(reader, plan, (slice, &missing), channels, slice.samples.clone())?;
    Ok(portions.into_iter().map(|portion| portion.parts).collect())
}

/// The same of a range of one of its captures; times count from that capture's first sample. Temperature, which may be sent more
/// seldom than the rest, is held until the next one.
fn portions(
    reader: &Reader,
    plan: &Plan,
    (slice, missing): (&Slice, &Missing),
    channels: &[Channel],
    range: Range<u64>,
) -> Result<Vec<Portion>, JobError> {
    let mut all: Vec<Portion> = channels.iter().map(|_| Portion::default()).collect();
    let mut last: Vec<Option<(u32, f64)>> = vec![None; channels.len()];
    // The sample before the range tells whether its first one continues a stretch.
    let mut from_seq = range.start.saturating_sub(1).max(slice.samples.start);
    while from_seq < range.end {
        let limit = CHUNK.min(usize::try_from(range.end - from_seq).unwrap_or(CHUNK));
        let chunk = plan.read_chunk(reader, from_seq, limit, channels)?;
        for (((channel, portion), column), last) in channels.iter().zip(&mut all).zip(&chunk.columns).zip(&mut last) {
            for (number, (segment, value)) in (chunk.first_seq..).zip(chunk.segment.iter().zip(column)) {
                let before = last.filter(|(of, _)| of == segment);
                let held = before.filter(|_| *channel == Channel::Temperature && !value.is_finite());
                let value = held.map_or(*value, |(_, value)| value);
                // An absent value ends a stretch as a gap does.
                *last = (value.is_finite() && plan.segment(*segment).is_some()).then_some((*segment, value));
                if last.is_none() || number < range.start {
                    continue;
                }
                if before.is_none() || portion.parts.is_empty() {
                    portion.continues |= before.is_some();
                    let seq = number - slice.samples.start;
                    let start_s = (seq + missing.up_to(seq)) as f64 / plan.rate_hz;
                    portion.parts.push(Part { start_s, values: Vec::new() });
                }
                if let Some(open) = portion.parts.last_mut() {
                    open.values.push(value);
                }
            }
        }
        from_seq = chunk.next_seq();
    }
    Ok(all)
}
