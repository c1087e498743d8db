//! Gridded: a plan's samples in the form that a diagnosis takes, on a regular grid with the missing ones marked.

use super::{JobError, Plan, SampleSource};
use imu_core::sample::Channel;
use imu_core::units::counted;
use imu_diagnosis::{Diagnosis, Recording};

/// Gaps longer than this end a record, s: noise cannot be determined across them.
const LONGEST_GAP_S: f64 = 60.0;

/// The longest part of a plan's samples without a long gap.
#[derive(Debug, Clone)]
pub struct Gridded {
    /// The recording.
    pub recording: Recording,
    /// The offset of its beginning from the plan's first sample, s.
    pub from_s: f64,
    /// The number of the plan's samples outside it.
    pub left_out: u64,
    /// Whether the part ends because the room is exhausted.
    pub full: bool,
}

impl Gridded {
    /// Adjusts a diagnosis of this part: its times become the plan's.
    pub fn adjust(&self, diagnosis: &mut Diagnosis) {
        if self.left_out > 0 {
            let why = if self.full {
                "as many as the daemon has room for (`vn100d diagnose` takes all)"
            } else {
                "the longest part without a gap of a minute"
            };
            diagnosis.notes.push(format!(
                "compared are {:.0} s from {:.0} s on, {why}; {} outside it",
                self.recording.length_s(),
                self.from_s,
                counted(self.left_out, "sample is", "samples are")
            ));
        }
        // Times in the report are the capture's, as everywhere; a model is run from its own beginning.
        if self.from_s > 0.0 {
            diagnosis.begins_at(self.from_s);
            diagnosis.notes.push(format!(
                "times are the capture's; those of the corrected model begin at its {:.1} s",
                self.from_s
            ));
        }
    }
}

/// Reads a plan's samples; of several captures the first one's. The grid has at most `room` places, missing samples
/// included. A longer record is divided into parts of that length, of which the first is taken.
///
/// # Errors
/// [`JobError::InsufficientData`] if there are none, or the error that `source` reports.
pub fn gridded(source: &dyn SampleSource, plan: &Plan, room: u64) -> Result<Gridded, JobError> {
    let Some(slice) = plan.slices.first() else {
        return Err(JobError::InsufficientData("there are no samples".to_owned()));
    };
    let missing = source.missing(slice.capture_id)?;
    let place = |seq: u64| seq - slice.samples.start + missing.up_to(seq - slice.samples.start);
    let mut channels: Vec<Channel> = plan.channels.clone();
    channels.push(Channel::Temperature);
    // Stretches of consecutive samples: first place, columns.
    let longest_gap = (LONGEST_GAP_S * plan.rate_hz) as u64;
    let (mut best, mut total): (Option<Part>, u64) = (None, 0);
    let (mut open, mut full): (Option<Part>, bool) = (None, false);
    for chunk in plan.chunks(source, slice.samples.clone(), &channels) {
        let chunk = chunk?;
        let stamps = source.stamps(slice.capture_id, chunk.first_seq - slice.samples.start, chunk.len())?;
        for (number, rows) in plan.runs(&chunk) {
            if number.is_none() {
                continue;
            }
            total += rows.len() as u64;
            if full {
                continue;
            }
            let first = place(chunk.first_seq + rows.start as u64);
            let goes_on = open.as_ref().is_some_and(|part| first >= part.end() && first - part.end() <= longest_gap);
            if !goes_on {
                best = longer(best, open.take());
                open = Some(Part::new(first, channels.len()));
            }
            for row in rows {
                let at = place(chunk.first_seq + row as u64);
                if open.as_ref().is_some_and(|part| at - part.first >= room) {
                    full = true;
                    break;
                }
                let Some(part) = &mut open else { break };
                part.push(at, chunk.columns.iter().map(|column| column[row]));
                part.stamps.push(stamps.get(row).copied().flatten());
            }
        }
        if full {
            // No other part is longer.
            total += slice.samples.end.saturating_sub(chunk.next_seq());
            break;
        }
    }
    // A full part continues beyond the room: it is the one to take.
    let Some(part) = (if full { open } else { longer(best, open) }) else {
        return Err(JobError::InsufficientData("there are no samples".to_owned()));
    };
    let left_out = total - part.there;
    let from_s = part.first as f64 / plan.rate_hz;
    let mut recording = Recording { sampling: plan.sampling.clone(), ..part.recording(plan.rate_hz, &channels) };
    if let (Some(begins_s), Some(origin_s)) = (&mut recording.begins_s, source.first_stamp_s(slice.capture_id)?) {
        *begins_s += origin_s;
    }
    Ok(Gridded { recording, from_s, left_out, full })
}

fn longer(one: Option<Part>, other: Option<Part>) -> Option<Part> {
    match (one, other) {
        (Some(one), Some(other)) => Some(if other.there > one.there { other } else { one }),
        (one, other) => one.or(other),
    }
}

/// Samples on a grid from a first place on.
struct Part {
    first: u64,
    /// Samples that are present.
    there: u64,
    missing: Vec<bool>,
    columns: Vec<Vec<f64>>,
    /// One per present sample: the run of the device's clock, and the time in that run in s.
    stamps: Vec<Option<(u32, f64)>>,
}

impl Part {
    fn new(first: u64, columns: usize) -> Self {
        Self { first, there: 0, missing: Vec::new(), columns: vec![Vec::new(); columns], stamps: Vec::new() }
    }
    fn end(&self) -> u64 {
        self.first + self.missing.len() as u64
    }
    fn push(&mut self, place: u64, values: impl Iterator<Item = f64>) {
        let until = (place - self.first) as usize;
        self.missing.resize(until, true);
        self.columns.iter_mut().for_each(|column| column.resize(until, f64::NAN));
        self.missing.push(false);
        self.there += 1;
        self.columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
    }
    /// Returns the samples' stamps, if all are of one run of one clock.
    fn time_s(&self) -> Vec<f64> {
        let Some(Some((run, begin_s))) = self.stamps.first().copied() else { return Vec::new() };
        let times = self.stamps.iter().map(|stamp| stamp.filter(|(own, _)| *own == run).map(|(_, s)| s - begin_s));
        times.collect::<Option<Vec<f64>>>().unwrap_or_default()
    }
    fn recording(self, rate_hz: f64, channels: &[Channel]) -> Recording {
        let time_s = self.time_s();
        let begins_s =
            self.stamps.first().copied().flatten().map(|(_, begin_s)| begin_s).filter(|_| !time_s.is_empty());
        let mut recording = Recording { rate_hz, missing: self.missing, time_s, begins_s, ..Recording::default() };
        for (channel, values) in channels.iter().zip(self.columns) {
            let there = values.iter().filter(|value| value.is_finite()).count();
            if *channel == Channel::Temperature {
                recording.temperature_c = (there > 0).then_some(values);
                continue;
            }
            // A channel that sometimes lacks a value has no value there.
            if (there as u64) * 10 >= self.there * 9 {
                recording.channels.push((*channel, values));
            }
        }
        recording
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_that_no_sample_has_are_missing() {
        let mut part = Part::new(10, 2);
        part.push(10, [1.0, 20.0].into_iter());
        part.push(13, [2.0, f64::NAN].into_iter());
        for (second, times) in [(Some((1, 7.075)), vec![0.0, 0.075]), (Some((2, 7.075)), vec![]), (None, vec![])] {
            part.stamps = vec![Some((1, 7.0)), second];
            let found = part.time_s();
            assert!(found.len() == times.len() && found.iter().zip(&times).all(|(a, b)| (a - b).abs() < 1e-12));
        }
        let recording = part.recording(40.0, &[Channel::GyroX, Channel::Temperature]);
        assert_eq!(recording.missing, [false, true, true, false]);
        assert_eq!(recording.values(Channel::GyroX).unwrap()[3], 2.0);
        assert_eq!(recording.temperature_c.unwrap()[0], 20.0);
    }
}
