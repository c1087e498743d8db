//! Finds the point of the grid to which each stamp belongs. Pure.
//!
//! A stamp is the time of its grid point, rounded, with jitter, and sometimes late. Each sample has its own grid point,
//! later than that of the sample before. Let u be the stamp's distance from the first grid point in periods, less the
//! number of samples before. Then u is the number of missing samples so far, plus the stamp's error: a level that never
//! falls. A long step that the next short ones compensate leaves the level unchanged, and a missing sample raises it
//! for good.
//!
//! The levels are those of the most likely path (Viterbi). A sample costs the square of its error beyond the rounding,
//! and a rise of the level costs the improbability of a loss. A late stamp costs at most [`LATE_MOST`], because delays
//! are common and early stamps are not. Period and phase follow a slowly wandering clock by a loop of second order.

use super::StampGrid;
use std::collections::VecDeque;

/// The maximum cost of a late stamp, nats.
const LATE_MOST: f64 = 8.0;
/// [`LATE_MOST`] if deliveries are often late: less than a loss.
const LATE_CHEAP: f64 = 3.0;
/// The maximum cost of an early stamp, nats.
const EARLY_MOST: f64 = 60.0;
/// The cost of a loss, nats.
const LOSS: f64 = 4.0;
/// If single losses cannot be distinguished, a rise is at least this many times the errors' scale.
const RISE_LEAST: f64 = 8.0;
/// A path that costs this much more than the best one is dropped: fifty late stamps in a row are a loss.
const GIVEN_UP: f64 = 50.0 * LATE_MOST;
/// The maximum number of paths.
const PATHS_MAX: usize = 48;
/// The maximum number of samples that wait for their position.
pub(in crate::recording) const PENDING_MAX: usize = 4096;
/// Levels beyond this are invalid: a thousand years at 30 kHz.
const LEVEL_MOST: f64 = 1e15;
/// The interval in samples at which the common part of all paths is determined.
const LOOK_EVERY: usize = 64;
/// Gain of the loop that follows the phase; that of the one that follows the period is a quarter of its square.
pub(super) const GAIN: f64 = 1.0 / 256.0;
/// The number of stamps that determine the initial phase.
const BEGUN: u32 = 32;
/// A rise by this many periods, and by this long, makes the phase uncertain: it is determined again. Shorter rises may
/// be delayed deliveries.
pub(super) const HOLE: f64 = 64.0;
pub(super) const HOLE_LEAST_NS: f64 = 2e9;
/// After this many samples in a row that are off the grid by the same error, the phase is determined again.
const BESIDE: u32 = 32;
/// Errors that differ by less are equal, periods.
const ALIKE: f64 = 0.2;
/// Number of stamps whose centroid is an end of the line that gives the period.
const END: usize = 256;
/// [`END`] if losses are not resolved: they may lie among these stamps.
const END_UNRESOLVED: usize = 16;
/// Slack of the rounding if several samples share one stamp, periods.
const SLACK: f64 = 0.1;
/// A period this close to a whole number of ns is taken as that number.
const WHOLE_NS: f64 = 1e-4;
/// The least scale of errors, periods.
const SCALE_LEAST: f64 = 0.02;

/// The end of a path.
#[derive(Debug, Clone, Copy)]
struct Path {
    level: i64,
    cost: f64,
    /// Its index among the paths of the sample before.
    parent: u16,
}

/// A sample with its position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::recording) struct Placed {
    /// The number of empty grid points between the sample before and this one.
    pub(in crate::recording) missing: u64,
    /// The stamp's error in periods: positive if it is late.
    pub(in crate::recording) error: f64,
}

/// Finds the positions of stamps, one after another.
#[derive(Debug)]
pub(in crate::recording) struct Tracker {
    grid: StampGrid,
    /// Half of the rounding and the jitter, ns.
    half_ns: f64,
    scale_ns: f64,
    period_ns: f64,
    /// The origin of the stamps.
    origin_ns: i64,
    /// Index, level and time of the last known grid point.
    base: (u64, i64, f64),
    /// The number of stamps that determined the phase.
    settled: u32,
    /// Stamps in a row that are off the grid by the same error, and the error of the last.
    beside: (u32, f64),
    /// Up to this sample the phase behind a hole is uncertain.
    loose_until: u64,
    /// Paths at the sample read last, increasing in level and decreasing in cost.
    paths: Vec<Path>,
    spare: Vec<Path>,
    /// The waiting stamps, and the paths at each.
    waiting: VecDeque<f64>,
    trellis: VecDeque<Vec<Path>>,
    read: u64,
    placed: VecDeque<Placed>,
    level: i64,
    begun: bool,
    line: Line,
    /// How often the phase was determined again because stamps ran ahead of the grid.
    pub(in crate::recording) slips: u64,
    gain: f64,
    late_most: f64,
    /// The least rise of the level that counts.
    rise_least: i64,
}

impl Tracker {
    /// Creates a tracker that has seen no stamp yet.
    pub(in crate::recording) fn new(grid: &StampGrid) -> Self {
        Self::with_gain(grid, GAIN)
    }

    /// Creates a tracker with another gain of the loop.
    pub(super) fn with_gain(grid: &StampGrid, gain: f64) -> Self {
        // If several samples share a stamp, the first one's place among them is a guess.
        let coarse = grid.rounding_ns as f64 > grid.period_ns;
        Self {
            grid: grid.clone(),
            half_ns: 0.5 * grid.rounding_ns as f64 + if coarse { SLACK * grid.period_ns } else { 0.0 },
            scale_ns: grid.jitter_ns.max(SCALE_LEAST * grid.period_ns),
            period_ns: grid.period_ns,
            origin_ns: 0,
            base: (0, 0, 0.0),
            settled: BEGUN,
            beside: (0, 0.0),
            loose_until: 0,
            paths: Vec::new(),
            spare: Vec::new(),
            waiting: VecDeque::new(),
            trellis: VecDeque::new(),
            read: 0,
            placed: VecDeque::new(),
            level: 0,
            begun: false,
            line: Line {
                end: match grid.resolved {
                    // The first and the last stamp determine the slope.
                    true if grid.is_loop => 1,
                    true => END,
                    false => END_UNRESOLVED,
                },
                coarse: grid.rounding_ns as f64 > 2.0 * grid.period_ns,
                ..Line::default()
            },
            slips: 0,
            gain,
            late_most: if grid.late_often { LATE_CHEAP } else { LATE_MOST },
            rise_least: if grid.resolved {
                1
            } else {
                ((RISE_LEAST * grid.jitter_ns + grid.rounding_ns as f64) / grid.period_ns).ceil().max(1.0) as i64
            },
        }
    }

    /// Takes the next stamp, ns.
    pub(in crate::recording) fn push(&mut self, stamp_ns: i64) {
        if self.read == 0 {
            self.origin_ns = stamp_ns;
            self.begin();
        }
        let at_ns = stamp_ns.saturating_sub(self.origin_ns) as f64;
        let index = self.read;
        self.read += 1;
        if self.grid.is_loop {
            self.step(index, at_ns);
            return;
        }
        if let ([only], true) = (self.paths.as_slice(), self.waiting.is_empty()) {
            let error = self.error(index, only.level, at_ns);
            if error.abs() < self.near() {
                self.place(index, only.level, at_ns);
                return;
            }
        }
        self.extend(index, at_ns);
        if index + 1 == self.loose_until {
            // Behind a hole the phase is that of the best path, which the others have not.
            self.finish();
        } else if self.paths.len() == 1 {
            self.settle(self.waiting.len());
        } else if self.waiting.len() > PENDING_MAX {
            self.finish();
        } else if self.waiting.len().is_multiple_of(LOOK_EVERY) {
            self.settle(self.common());
        }
    }

    /// Places all waiting stamps: none follows.
    pub(in crate::recording) fn finish(&mut self) {
        let best = self.best().and_then(|best| self.paths.get(best).copied());
        self.settle(self.waiting.len());
        self.paths = best.into_iter().collect();
    }

    /// Returns the next sample's position, once it is known.
    pub(in crate::recording) fn next(&mut self) -> Option<Placed> {
        self.placed.pop_front()
    }

    /// Returns the period that the stamps placed so far have on average, ns.
    pub(in crate::recording) fn mean_period_ns(&self) -> Option<f64> {
        // Among stamps that are equally late, such as many in batches, none is near its point. The line of stamps that
        // jump back and forth may fall, which is not a period.
        let slope = self.line.slope().filter(|slope| slope.is_finite() && *slope > 0.0).unwrap_or(self.period_ns);
        // Stamps are whole ns, and so are most periods.
        Some(if (slope - slope.round()).abs() < WHOLE_NS { slope.round() } else { slope })
    }

    /// Begins with the grid point that the stamps behind the first one show: the first may itself be late.
    fn begin(&mut self) {
        self.base = (0, 0, self.grid.start_ns);
        let lowest = self.grid.first_late;
        let levels = lowest.max(-(PATHS_MAX as i64) / 2)..=0;
        self.paths = levels.map(|level| Path { level, cost: 0.0, parent: 0 }).collect();
        if let Some(first) = self.paths.first_mut() {
            first.level = lowest;
        }
    }

    /// Returns a stamp's error, periods.
    fn error(&self, index: u64, level: i64, at_ns: f64) -> f64 {
        let (base_index, base_level, base_ns) = self.base;
        let points = index.wrapping_sub(base_index) as i64 + level - base_level;
        (at_ns - base_ns) / self.period_ns - points as f64
    }

    /// Returns the distance from its point within which a stamp needs no other explanation.
    fn near(&self) -> f64 {
        let near = (self.half_ns + 2.0 * self.scale_ns) / self.period_ns;
        if self.grid.resolved { near.min(0.4) } else { 2.0 * near }
    }

    fn cost(&self, index: u64, error: f64) -> f64 {
        let beyond = (error.abs() * self.period_ns - self.free_ns(index)).max(0.0) / self.scale_ns;
        let most = if error > 0.0 { self.late_most + error.ln_1p() } else { EARLY_MOST };
        (0.5 * beyond * beyond).min(most)
    }

    /// Returns how far a stamp may be from its point at no cost, ns: by any distance right behind a hole.
    fn free_ns(&self, index: u64) -> f64 {
        if index < self.loose_until { self.half_ns.max(0.5 * self.period_ns) } else { self.half_ns }
    }

    /// Extends all paths to the next stamp.
    fn extend(&mut self, index: u64, at_ns: f64) {
        // A stamp's error at level 0 is the level that it shows.
        let shown = self.error(index, 0, at_ns).clamp(-LEVEL_MOST, LEVEL_MOST);
        let half = self.half_ns / self.period_ns;
        let lowest = self.paths.first().map_or(0, |path| path.level);
        let highest = self.paths.last().map_or(0, |path| path.level);
        if shown - highest as f64 >= self.hole() {
            self.loose_until = index + u64::from(BEGUN);
        }
        let near = if half > 1.0 { (shown - half).ceil() } else { shown.round() };
        // A period of length zero gives an unbounded level.
        let near = near.clamp(-LEVEL_MOST, LEVEL_MOST) as i64;
        let mut levels: Vec<i64> = self.paths.iter().map(|path| path.level).collect();
        levels.extend((near - 1..=near + 1).filter(|level| *level >= lowest + self.rise_least));
        levels.sort_unstable();
        levels.dedup();
        let mut next = std::mem::take(&mut self.spare);
        next.clear();
        for level in levels {
            let from = self.paths.iter().enumerate();
            let from = from.filter(|(_, path)| path.level == level || path.level + self.rise_least <= level);
            let ways = from.map(|(place, path)| (path.cost + loss(level - path.level), place));
            let Some((cost, place)) = ways.min_by(|one, other| one.0.total_cmp(&other.0)) else { continue };
            let cost = cost + self.cost(index, shown - level as f64);
            // A higher level is kept only if it could not be reached later at a lower cost.
            let dominated = next.iter().any(|path: &Path| path.cost + loss(level - path.level) <= cost);
            if !dominated {
                next.push(Path { level, cost, parent: u16::try_from(place).unwrap_or(0) });
            }
        }
        let best = next.iter().map(|path| path.cost).fold(f64::INFINITY, f64::min);
        next.retain(|path| path.cost <= best + GIVEN_UP);
        while next.len() > PATHS_MAX {
            let worst = (0..next.len()).max_by(|one, other| next[*one].cost.total_cmp(&next[*other].cost));
            next.remove(worst.unwrap_or(0));
        }
        for path in &mut next {
            path.cost -= best;
        }
        self.waiting.push_back(at_ns);
        self.trellis.push_back(next.clone());
        self.spare = std::mem::replace(&mut self.paths, next);
    }

    fn best(&self) -> Option<usize> {
        // Of equals the lowest: no sample is assumed missing without need.
        (0..self.paths.len()).min_by(|one, other| self.paths[*one].cost.total_cmp(&self.paths[*other].cost))
    }

    /// Returns, for each waiting stamp, the index of the path that ends at `end`.
    fn trace(&self, end: usize) -> Vec<usize> {
        let mut places = vec![0; self.trellis.len()];
        let mut at = end;
        for (place, paths) in places.iter_mut().zip(&self.trellis).rev() {
            *place = at;
            at = usize::from(paths[at].parent);
        }
        places
    }

    /// Returns the number of waiting stamps on which all paths agree.
    fn common(&self) -> usize {
        let mut alive: Vec<usize> = (0..self.paths.len()).collect();
        for at in (0..self.trellis.len()).rev() {
            if alive.len() == 1 {
                return at + 1;
            }
            alive = alive.iter().map(|place| usize::from(self.trellis[at][*place].parent)).collect();
            alive.sort_unstable();
            alive.dedup();
        }
        0
    }

    /// Places this many of the waiting stamps: all paths agree on them.
    fn settle(&mut self, count: usize) {
        if count == 0 {
            return;
        }
        let places = self.trace(self.best().unwrap_or(0));
        let first = self.read - self.waiting.len() as u64;
        for (index, place) in (first..).zip(places.into_iter().take(count)) {
            let Some((paths, at_ns)) = self.trellis.pop_front().zip(self.waiting.pop_front()) else { break };
            let level = paths.get(place).map_or(self.level, |path| path.level);
            self.place(index, level, at_ns);
        }
    }

    /// Places a loop's stamp relative to the one before: none is late, and a step of two periods is a loss.
    fn step(&mut self, index: u64, at_ns: f64) {
        let (_, _, before_ns) = self.base;
        let beyond = if index == 0 { 0.0 } else { (at_ns - before_ns) / self.period_ns - 1.0 };
        let rise = beyond.clamp(0.0, LEVEL_MOST).round();
        self.level = self.level.saturating_add(rise as i64).min(i64::MAX / 4);
        self.base = (index, self.level, at_ns);
        self.line.add((index as i64 + self.level) as f64, at_ns);
        self.placed.push_back(Placed { missing: rise as u64, error: beyond - rise });
    }

    fn place(&mut self, index: u64, level: i64, at_ns: f64) {
        if !self.begun {
            self.begun = true;
            self.level = level;
        }
        let rise = level - self.level;
        self.level = level;
        let error = self.error(index, level, at_ns);
        self.follow(index, level, error, rise);
        if error.abs() <= self.gate(index) || !self.grid.resolved {
            self.line.add((index as i64 + level) as f64, at_ns);
        }
        self.placed.push_back(Placed { missing: rise.max(0) as u64, error });
    }

    fn hole(&self) -> f64 {
        HOLE.max(HOLE_LEAST_NS / self.period_ns)
    }

    /// Returns the error beyond which a stamp is delayed, periods.
    fn gate(&self, index: u64) -> f64 {
        ((self.free_ns(index) + 4.0 * self.scale_ns) / self.period_ns).max(0.1)
    }

    /// Adjusts period and phase.
    fn follow(&mut self, index: u64, level: i64, error: f64, rise: i64) {
        let gate = self.gate(index);
        if rise as f64 >= self.hole() {
            self.settled = 0;
        }
        let (_, _, base_ns) = self.base;
        let points = index.wrapping_sub(self.base.0) as i64 + level - self.base.1;
        let mut at_ns = base_ns + points as f64 * self.period_ns;
        // Behind a hole, or after the clock was set, all stamps are off the grid by the same error.
        let alike = error.abs() > gate && error < 1.0 && (error - self.beside.1).abs() <= gate.min(ALIKE);
        self.beside = if alike || error < -gate.max(0.75) { (self.beside.0 + 1, error) } else { (0, error) };
        if self.beside.0 >= BESIDE && self.grid.resolved {
            self.beside.0 = 0;
            self.settled = BEGUN;
            self.slips += u64::from(error.abs() > 0.5);
            at_ns += error * self.period_ns;
        } else if error.abs() <= gate {
            self.settled = self.settled.saturating_add(1);
            let gain = self.gain.max(1.0 / (f64::from(self.settled) + 2.0));
            at_ns += gain * error * self.period_ns;
            if f64::from(self.settled) > 2.0 / self.gain {
                self.period_ns *= 1.0 + 0.25 * self.gain * self.gain * error;
            }
        }
        self.base = (index, level, at_ns);
    }
}

/// Returns the cost of a rise of the level, nats.
fn loss(rise: i64) -> f64 {
    if rise > 0 { LOSS + (rise as f64).ln() } else { 0.0 }
}

/// The line from the first stamps to the last ones. Its slope is the mean period, whatever the clock did in between.
#[derive(Debug, Default)]
struct Line {
    first: Vec<(f64, f64)>,
    last: VecDeque<(f64, f64)>,
    /// Stamps at each end.
    end: usize,
    /// Whether many samples share one stamp: then all of them are needed.
    coarse: bool,
    /// Sums: number, means, squares of points, products.
    fit: (f64, f64, f64, f64, f64),
}

impl Line {
    fn add(&mut self, point: f64, at_ns: f64) {
        let (count, mean_point, mean_ns, squares, products) = &mut self.fit;
        *count += 1.0;
        let (from_point, from_ns) = (point - *mean_point, at_ns - *mean_ns);
        *mean_point += from_point / *count;
        *mean_ns += from_ns / *count;
        *squares += from_point * (point - *mean_point);
        *products += from_point * (at_ns - *mean_ns);
        if self.first.len() < self.end {
            self.first.push((point, at_ns));
        }
        if self.last.len() == self.end {
            self.last.pop_front();
        }
        self.last.push_back((point, at_ns));
    }

    fn slope(&self) -> Option<f64> {
        let (count, _, _, squares, products) = self.fit;
        if self.coarse || count < 4.0 * self.end as f64 {
            return (squares > 0.0).then(|| products / squares);
        }
        let size = self.end as f64;
        let centroid = |points: &mut dyn Iterator<Item = &(f64, f64)>| {
            points.fold((0.0, 0.0), |(point, ns), next| (point + next.0 / size, ns + next.1 / size))
        };
        let (from, to) = (centroid(&mut self.first.iter()), centroid(&mut self.last.iter()));
        (to.0 > from.0).then(|| (to.1 - from.1) / (to.0 - from.0))
    }
}
