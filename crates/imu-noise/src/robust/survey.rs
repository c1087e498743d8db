//! The survey: examines a channel block by block, so that a record of any length needs the memory of one block.
//!
//! Lines, vibration and fast disturbances (spikes, knocks, handling) are found within a block. Slow ones (steps, drift) are found
//! in the levels of all blocks.

use super::event::merged;
use super::spectrum::Spectrum;
use super::{Examination, HeavyTails, Kind, Levels, Line, Portion, bridged};
use super::{bursts, drift, excise, lines, steps};

/// A channel's examination in progress.
#[derive(Debug)]
pub(super) struct Survey {
    rate_hz: f64,
    found: Examination,
    lines: Vec<Line>,
    levels: Levels,
}

impl Survey {
    /// Creates an examination for a record of `samples` samples.
    pub(super) fn new(rate_hz: f64, samples: u64) -> Self {
        Self { rate_hz, found: Examination::default(), lines: Vec::new(), levels: Levels::new(rate_hz, samples) }
    }

    /// Examines the next block.
    pub(super) fn look(&mut self, portion: &Portion) {
        let (rate_hz, found) = (self.rate_hz, &mut self.found);
        let (parts, continues) = (portion.parts.as_slice(), portion.continues);
        if let (Some(first), Some(last)) = (parts.first(), parts.last()) {
            let begin_s = found.span_s.map_or(first.start_s, |(begin_s, _)| begin_s);
            found.span_s = Some((begin_s, last.time_s(last.values.len(), rate_hz)));
        }
        let mut gains = None;
        if let Some(spectrum) = Spectrum::of(parts, rate_hz) {
            let mut of_block = lines::find(&spectrum, rate_hz);
            of_block.extend(lines::vibration(&spectrum, rate_hz));
            gains = excise::gains(&spectrum, &lines::quiet(&spectrum, &of_block), &of_block);
            self.lines.extend(of_block);
        }
        let quiet = gains.as_ref().map(|gains| excise::apply(parts.to_vec(), gains, excise::Short::LeftOut));
        found.gains.push(gains);
        let bursts = bursts::find(quiet.as_deref().unwrap_or(parts), rate_hz);
        let heavier = |one: HeavyTails, other: HeavyTails| if one.core < other.core { one } else { other };
        found.heavy_tails = found.heavy_tails.into_iter().chain(bursts.heavy_tails).reduce(heavier);
        let shaken = merged(bursts.events.iter().map(|event| (event.from_s, event.to_s)).collect());
        found.events.extend(bursts.events);
        match quiet {
            Some(quiet) => self.levels.push(&bridged(quiet, &shaken, rate_hz), continues),
            None if shaken.is_empty() => self.levels.push(parts, continues),
            None => self.levels.push(&bridged(parts.to_vec(), &shaken, rate_hz), continues),
        }
    }

    /// Returns all findings, and the levels without them.
    pub(super) fn settle(self) -> (Examination, Levels) {
        let (mut found, levels) = (self.found, self.levels);
        found.lines = lines::joined(self.lines, found.gains.len());
        found.excluded_bands_hz = merged(found.lines.iter().map(|line| (line.band_hz[0], line.band_hz[1])).collect());
        // A knock may leave a step behind: then the step is reported too.
        let steps = steps::find(levels.parts(), levels.rate_hz());
        found.events.extend(steps);
        found.drift = drift::find(levels.parts(), levels.rate_hz(), &found.steps_s());
        found.events.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
        found.excluded_intervals = merged(found.events.iter().map(|event| (event.from_s, event.to_s)).collect());
        (found, levels)
    }
}

impl Examination {
    /// Returns the times of the level's steps, s.
    pub(super) fn steps_s(&self) -> Vec<f64> {
        let steps = self.events.iter().filter(|event| event.kind == Kind::Step);
        steps.map(|event| 0.5 * (event.from_s + event.to_s)).collect()
    }

    /// Returns the times of steps and bumps, or those of all other events.
    pub(super) fn times(&self, of_levels: bool) -> Vec<(f64, f64)> {
        let chosen = self.events.iter().filter(|event| matches!(event.kind, Kind::Step | Kind::Bump) == of_levels);
        merged(chosen.map(|event| (event.from_s, event.to_s)).collect())
    }
}
