//! Finds the period of the grid on which stamps lie, from the first stamps. Pure.
//!
//! In a stretch without a loss W steps take W periods, whatever single steps do. Jitter and rounding become W times
//! smaller, and a late stamp is compensated. So the most frequent length of W steps (half-sample mode), for every W,
//! proposes a period. The phases of longer and longer stretches then refine it (Rayleigh). Of all proposals the one is
//! taken under which the stamps' errors and the losses together cost the fewest nats.

use super::StampGrid;
use super::deliveries::{Deliveries, TOGETHER};
use super::track::{self, HOLE, HOLE_LEAST_NS, Tracker};

/// The maximum number of stamps that are examined.
pub(in crate::recording) const LOOK_AT: usize = 8192;
/// The maximum number of stamps on which a period is tried.
const TRY_ON: usize = 4096;
/// Numbers of steps whose length proposes a period: those of ten besides those of two, for stamps with few decimals.
const WINDOWS: [usize; 15] = [1, 2, 4, 5, 8, 10, 16, 20, 32, 64, 100, 200, 256, 500, 1024];
/// Lengths of stretches whose phases refine a period.
const STRETCHES: [usize; 5] = [64, 256, 1024, 4096, 8192];
/// The longest stretch if no phase is known yet: otherwise too many periods would have to be tried.
const STRETCHES_MOST: usize = 1024;
/// The maximum number of periods tried around a proposal. There are more if two neighbouring stamps proposed it by
/// chance.
const TRIES_MOST: i64 = 20_000;
/// The first search range around a proposal, relative to it.
const FIRST_WITHIN: f64 = 0.01;
/// Phases agree beyond chance if the square of their sum, divided by their number, is above this.
const PHASES_AGREE: f64 = 14.0;
/// Errors below this share of the mean step count as equal.
const ERROR_LEAST: f64 = 1e-3;
/// Errors below this share of the rounding count as equal. Otherwise errors of microseconds would weigh more than losses that are
/// as regular as rounding.
const ROUNDED_LEAST: f64 = 0.01;
/// Stamps are coarse from this share of the mean step on: several samples share one stamp.
const COARSE_FROM: f64 = 0.95;
/// A period that is this close to a whole number of the stamps' steps is taken as that number.
const EXACT: f64 = 1e-4;
/// At least this share of the samples that a period implies must be present: a fine enough grid would fit any steps.
const RECEIVED_LEAST: f64 = 0.45;
/// Deliveries are often late if this share of the stamps is late.
const LATE_OFTEN: f64 = 0.05;
/// The median step is at least this share of the mean step: in bursts most steps are short.
const MEDIAN_LEAST: f64 = 0.25;
/// Rounding below this part of the period counts as jitter.
const FINE: f64 = 0.1;
/// Above this number of samples per stamp their mean is used instead of a count.
const CELL_MOST: f64 = 16.0;
/// The cost of a period that is no whole number of the steps in which its stamps come, over the logarithm of their
/// number: about four losses.
const GUESS: f64 = 4.0;
/// The gain with which a period is tried: low enough not to follow losses.
const SLOW_GAIN: f64 = 1.0 / 2048.0;
/// At most this share of a loop's steps is neither one period nor a whole number of periods.
const LOOP_BESIDE: f64 = 2e-3;

/// The tried models of the clock behind the stamps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Clock {
    Steady,
    Wandering,
    Loop,
}

/// Points and stamps span the same time, within this share of it and this number of periods.
const BEYOND: f64 = 0.02;
const BEYOND_PERIODS: f64 = 32.0;
/// Jitters, in periods, with which a period is tried.
const JITTERS: [f64; 2] = [0.03, 0.25];

/// Finds the grid of these stamps, ns, in the order of their samples; `None` if they do not advance.
///
/// Across a hole the number of periods is a guess, so the period is taken from the longest stretch without a hole.
pub(in crate::recording) fn find(stamps: &[i64]) -> Option<StampGrid> {
    let stamps = &stamps[..stamps.len().min(LOOK_AT)];
    let mut steps: Vec<f64> = stamps.windows(2).map(|two| two[1].saturating_sub(two[0]) as f64).collect();
    let typical_ns = steps.iter().sum::<f64>() / steps.len().max(1) as f64;
    let hole_ns = (HOLE * median(&mut steps)?.max(MEDIAN_LEAST * typical_ns)).max(HOLE_LEAST_NS);
    let stretches = || stamps.chunk_by(|one, other| (other.saturating_sub(*one) as f64) < hole_ns);
    // Of equals the first.
    let longest = stretches().rev().max_by_key(|of| of.len())?;
    let first = stretches().next()?;
    let Some(mut grid) = find_in(longest) else { return find_in(stamps) };
    if grid.resolved && first.len() < longest.len() {
        (grid.start_ns, grid.first_late) = start(&since_first(first), grid.period_ns, 0.5 * grid.rounding_ns as f64)?;
    }
    Some(grid)
}

fn since_first(stamps: &[i64]) -> Vec<f64> {
    let first = stamps.first().copied().unwrap_or(0);
    stamps.iter().map(|stamp_ns| stamp_ns.saturating_sub(first) as f64).collect()
}

fn find_in(stamps: &[i64]) -> Option<StampGrid> {
    let (first, last) = (*stamps.first()?, *stamps.last()?);
    let span_ns = last.checked_sub(first).filter(|span_ns| *span_ns > 0)? as f64;
    let at_ns = since_first(stamps);
    let mean_ns = span_ns / (stamps.len() - 1) as f64;
    let rounding_ns = rounding(stamps);
    let deliveries = Deliveries::of(&at_ns, rounding_ns);
    if deliveries.hide_the_grid(mean_ns) {
        return unresolved(&at_ns, rounding_ns);
    }
    let windows = WINDOWS.iter().filter(|window| 4 * **window < stamps.len() || **window == 1);
    let lengths = |window: usize| -> Vec<f64> {
        at_ns.windows(window + 1).map(|of| (of[window] - of[0]) / window as f64).collect()
    };
    let overall_ns = windows.clone().next_back().and_then(|window| median(&mut lengths(*window))).unwrap_or(mean_ns);
    let proposals = windows.filter_map(|window| {
        let mut lengths = lengths(*window);
        lengths.retain(|length_ns| *length_ns > RECEIVED_LEAST * overall_ns);
        mode(&mut lengths)
    });
    let mut tried: Vec<f64> = Vec::new();
    if rounding_ns as f64 > COARSE_FROM * mean_ns {
        if (rounding_ns as f64) < CELL_MOST * mean_ns {
            tried.extend(line(&at_ns));
            tried.extend(whole_cells(stamps, rounding_ns));
            tried.extend(proposals);
        }
    } else {
        let mut looked: Vec<f64> = Vec::new();
        for proposal in proposals.chain([overall_ns]) {
            if looked.iter().any(|looked| (proposal / looked - 1.0).abs() < 0.5 * FIRST_WITHIN) {
                continue;
            }
            looked.push(proposal);
            // Few stamps have too few phases.
            let sharp = if stamps.len() < STRETCHES[0] { Some(proposal) } else { sharpened(&at_ns, proposal) };
            tried.extend(sharp);
            tried.extend(sharp.and_then(|period_ns| mirrored(period_ns, rounding_ns)));
        }
    }
    // If most samples share their stamp, there is no usable most frequent length.
    tried.retain(|period_ns| period_ns.is_finite() && *period_ns > 0.0);
    let with = |period_ns: f64, jitter: f64, clock: Clock| {
        tried_with(stamps, &at_ns, &deliveries, rounding_ns, period_ns, jitter, clock)
    };
    let likelier = |best: Option<(f64, StampGrid)>, other: Option<(f64, StampGrid)>| match (best, other) {
        (Some(best), Some(other)) => Some(if other.0 < best.0 { other } else { best }),
        (best, other) => best.or(other),
    };
    let is_new = |place: &usize| tried[..*place].iter().all(|before| (tried[*place] / before - 1.0).abs() >= 1e-6);
    let periods = (0..tried.len()).filter(is_new).map(|place| tried[place]);
    let mut best =
        periods.flat_map(|period_ns| JITTERS.map(|jitter| with(period_ns, jitter, Clock::Steady))).fold(None, likelier);
    // A clock that wanders is tracked as it will be later, so that its errors do not count as jitter.
    if let Some(period_ns) = best.as_ref().map(|(_, grid)| grid.period_ns) {
        // Rounding this coarse hides which steps are short.
        let is_fine = (rounding_ns as f64) < 0.12 * period_ns;
        let clocks = [Clock::Wandering, Clock::Loop].into_iter().take(1 + usize::from(is_fine));
        best = clocks.flat_map(|clock| JITTERS.map(|jitter| with(period_ns, jitter, clock))).fold(best, likelier);
    }
    let resolved = best.map(|(_, grid)| grid).filter(|grid| grid.jitter_ns < UNRESOLVED * grid.period_ns);
    resolved.or_else(|| unresolved(&at_ns, rounding_ns))
}

/// Jitter from this share of the period on hides single losses.
const UNRESOLVED: f64 = 0.6;

/// Returns the grid of stamps whose errors are as large as the period: its period is their mean step.
fn unresolved(at_ns: &[f64], rounding_ns: u64) -> Option<StampGrid> {
    let period_ns = line(at_ns)?;
    let half_ns = 0.5 * rounding_ns as f64;
    let start_ns = median(&mut starts(at_ns, period_ns, half_ns))?;
    let mut errors: Vec<f64> =
        at_ns.iter().enumerate().map(|(index, at)| at - start_ns - index as f64 * period_ns).collect();
    // A hole shifts everything behind it: the spread is taken from short stretches.
    let mut spreads: Vec<f64> = errors
        .chunks_mut(64)
        .filter_map(|of| {
            let center = median(of)?;
            of.iter_mut().for_each(|error| *error = (*error - center).abs());
            median(of)
        })
        .collect();
    let jitter_ns = 1.4826 * median(&mut spreads)?;
    Some(StampGrid {
        period_ns,
        rounding_ns,
        jitter_ns,
        start_ns,
        first_late: 0,
        is_loop: false,
        late_often: false,
        resolved: false,
    })
}

/// Returns the slope of the line of stamps over their number.
fn line(at_ns: &[f64]) -> Option<f64> {
    let middle = 0.5 * (at_ns.len() as f64 - 1.0);
    let from_middle = || at_ns.iter().enumerate().map(|(index, at)| (index as f64 - middle, at));
    let (products, squares) =
        from_middle().fold((0.0, 0.0), |(products, squares), (x, at)| (products + x * at, squares + x * x));
    Some(products / squares).filter(|slope| *slope > 0.0)
}

/// Returns the grid with about this period and jitter, and the cost of stamps and losses under it, nats per sample.
fn tried_with(
    stamps: &[i64],
    at_ns: &[f64],
    deliveries: &Deliveries,
    rounding_ns: u64,
    period_ns: f64,
    jitter: f64,
    clock: Clock,
) -> Option<(f64, StampGrid)> {
    let (stamps, at_ns) = (&stamps[..stamps.len().min(TRY_ON)], &at_ns[..at_ns.len().min(TRY_ON)]);
    let mean_ns = at_ns.last()? / (at_ns.len() - 1) as f64;
    // A period of whole steps is always rounded alike, that is, not at all.
    let steps = period_ns / rounding_ns.max(1) as f64;
    let rounding_ns = if (steps - steps.round()).abs() < EXACT && steps > 0.5 { 0 } else { rounding_ns };
    let half_ns = 0.5 * rounding_ns as f64;
    let (start_ns, first_late) = start(at_ns, period_ns, half_ns)?;
    let jitter_ns = jitter * period_ns;
    let is_loop = clock == Clock::Loop;
    let mut grid = StampGrid {
        period_ns,
        rounding_ns,
        jitter_ns,
        start_ns,
        first_late,
        is_loop,
        late_often: false,
        resolved: true,
    };
    let mut nats = None;
    let gain = if clock == Clock::Steady { SLOW_GAIN } else { track::GAIN };
    for _ in 0..2 {
        let mut tracker = Tracker::with_gain(&grid, gain);
        stamps.iter().for_each(|stamp_ns| tracker.push(*stamp_ns));
        tracker.finish();
        let (mut errors, mut missing) = (Vec::with_capacity(stamps.len()), 0);
        while let Some(placed) = tracker.next() {
            errors.push(placed.error * grid.period_ns);
            missing += placed.missing;
        }
        let count = errors.len() as f64;
        // Steps of one and a half periods do not come from a loop but from deliveries.
        let beside = errors.iter().filter(|error| error.abs() > 0.35 * grid.period_ns).count();
        if is_loop && beside as f64 > LOOP_BESIDE * count {
            return None;
        }
        let center = center(&mut errors.clone(), half_ns, grid.period_ns)?;
        let beyond = |error: &f64| ((error - center).abs() - half_ns).max(0.0);
        // Delays only make stamps late, so the early ones show the jitter.
        let mut early: Vec<f64> = errors.iter().filter(|error| **error <= center).map(beyond).collect();
        let typical = 1.4826 * median(&mut early)? + 1e-3 * grid.period_ns;
        let squares: f64 = early.iter().map(|error| error.min(5.0 * typical).powi(2)).sum();
        grid.jitter_ns = (squares / early.len() as f64).sqrt();
        let late = errors.iter().filter(|error| **error - center > 0.75 * grid.period_ns + half_ns).count();
        grid.late_often = late as f64 > LATE_OFTEN * count;
        // Of coarse stamps the errors are all that distinguishes the periods.
        let is_coarse = rounding_ns as f64 > COARSE_FROM * mean_ns;
        let least_ns = if is_coarse { 0.0 } else { ROUNDED_LEAST * rounding_ns as f64 };
        let scale = grid.jitter_ns + ERROR_LEAST * mean_ns + least_ns;
        // A late stamp costs the logarithm of its delay.
        let errors: f64 = errors.iter().map(|error| (beyond(error) / scale).ln_1p()).sum();
        let points = count + missing as f64;
        let lost = missing as f64 / points;
        // The points must span the same time as the stamps, and there must be no more samples than points.
        let beyond_ns = (points - 1.0) * grid.period_ns - at_ns.last()?;
        let fits = beyond_ns.abs() <= BEYOND * at_ns.last()? + BEYOND_PERIODS * grid.period_ns;
        if !fits || lost > 1.0 - RECEIVED_LEAST || deliveries.explain(missing, count, &grid) {
            return None;
        }
        let entropy = if lost > 0.0 { -(lost * lost.ln() + (1.0 - lost) * (1.0 - lost).ln()) } else { 0.0 };
        // Rounding that hides the period explains any steps: the period must then explain many losses.
        let guess = if is_coarse { GUESS * count.ln() / count } else { 0.0 };
        nats = Some(guess + scale.ln() + errors / count + entropy * points / count + 0.05 * tracker.slips as f64);
        let mean = tracker.mean_period_ns().filter(|mean| (mean / grid.period_ns - 1.0).abs() < 0.01);
        grid.period_ns = mean.unwrap_or(grid.period_ns);
        (grid.start_ns, grid.first_late) = start(at_ns, grid.period_ns, half_ns)?;
    }
    nats.filter(|nats| nats.is_finite()).map(|nats| (nats, grid))
}

/// Returns the position of the errors that no delay caused: their mode, or the middle of the densest stretch as long as
/// the rounding.
fn center(errors: &mut [f64], half_ns: f64, period_ns: f64) -> Option<f64> {
    if 2.0 * half_ns < FINE * period_ns {
        errors.sort_unstable_by(f64::total_cmp);
        // Half of them may be late by the same time, as in pairs.
        let lower = errors.len().div_ceil(2);
        return mode(&mut errors[..lower]);
    }
    densest(errors, 2.02 * half_ns)
}

/// Returns the middle of the densest stretch of this length.
fn densest(values: &mut [f64], length: f64) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let (mut to, mut best) = (0, (0, 0.0));
    for (from, first) in values.iter().enumerate() {
        while values.get(to).is_some_and(|last| last - first <= length) {
            to += 1;
        }
        if to - from > best.0 {
            best = (to - from, 0.5 * (first + values[to - 1]));
        }
    }
    (best.0 > 0).then_some(best.1)
}

/// Returns the largest power of ten of which all steps are multiples, ns; 0 if that is below a microsecond.
pub(in crate::recording) fn rounding(stamps: &[i64]) -> u64 {
    let greatest = |of: &mut dyn Iterator<Item = u64>| {
        of.fold(0_u64, |mut one, mut other| {
            while other != 0 {
                (one, other) = (other, one % other);
            }
            one
        })
    };
    let common = greatest(&mut stamps.windows(2).map(|two| two[1].abs_diff(two[0])));
    let powers = std::iter::successors(Some(1000_u64), |power| power.checked_mul(10));
    powers.take_while(|power| common > 0 && common % power == 0).last().unwrap_or(0)
}

/// Returns the period if samples come in mostly complete cells that share one stamp: the cell over the number of its
/// samples.
fn whole_cells(stamps: &[i64], rounding_ns: u64) -> Option<f64> {
    let mut counts: Vec<u64> = Vec::new();
    let mut run = 1;
    // The first cell and the last one may be cut.
    for two in stamps.windows(2) {
        if two[0] == two[1] {
            run += 1;
        } else {
            counts.push(run);
            run = 1;
        }
    }
    counts.first()?;
    counts.remove(0);
    let most = *counts.iter().max()?;
    // A count that hardly ever occurs is an error.
    let share = |of: u64| counts.iter().filter(|count| **count == of).count() as f64 / counts.len() as f64;
    let most = (1..=most).rev().find(|count| share(*count) > 0.02)?;
    (share(most) > 0.3).then(|| rounding_ns as f64 / most as f64)
}

/// Returns the grid point of the first stamp, ns since it, and by how many periods that stamp is late at most.
fn start(at_ns: &[f64], period_ns: f64, half_ns: f64) -> Option<(f64, i64)> {
    if 2.0 * half_ns > 0.5 * period_ns {
        // Several samples share a stamp: the middle of the possible range.
        return Some((center(&mut starts(at_ns, period_ns, half_ns), half_ns, period_ns)?, 0));
    }
    let looked = &at_ns[..at_ns.len().min(256)];
    let mut phases: Vec<f64> = looked.iter().map(|at_ns| (at_ns / period_ns).rem_euclid(1.0)).collect();
    // The phases are repeated around the circle: a mode may lie at its seam.
    let around: Vec<f64> = phases.iter().map(|phase| phase + 1.0).collect();
    phases.extend(around);
    // Phases of rounded stamps are spread over the rounding: their densest part may be at an end of it.
    let phase = match 2.0 * half_ns < FINE * period_ns {
        true => mode(&mut phases)?,
        false => densest(&mut phases, 2.02 * half_ns / period_ns)?,
    };
    let phase = phase - phase.round();
    let offset = |(index, at_ns): (usize, &f64)| (at_ns / period_ns - phase - index as f64).round() as i64;
    let lowest = at_ns.iter().take(1024).enumerate().map(offset).min()?;
    Some((phase * period_ns, lowest.min(0)))
}

/// Returns the first grid point according to each of the first stamps, if nothing is missing.
fn starts(at_ns: &[f64], period_ns: f64, half_ns: f64) -> Vec<f64> {
    let few = 32.max((4.0 * half_ns / period_ns) as usize).min(at_ns.len());
    at_ns[..few].iter().enumerate().map(|(index, at_ns)| at_ns - index as f64 * period_ns).collect()
}

/// Returns the nearby period under which the phases of longer and longer stretches agree best; `None` if they do not
/// agree.
fn sharpened(at_ns: &[f64], proposal_ns: f64) -> Option<f64> {
    // Stamps delivered together have one phase whatever the period: only the first of them counts.
    let mut before = f64::NEG_INFINITY;
    let apart: Vec<f64> =
        at_ns.iter().copied().filter(|at| *at - std::mem::replace(&mut before, *at) > TOGETHER * proposal_ns).collect();
    let (mut period_ns, mut within, mut sharp) = (proposal_ns, FIRST_WITHIN, false);
    for stretch in STRETCHES {
        let stamps = &apart[..apart.len().min(stretch)];
        let (Some(first), Some(last)) = (stamps.first(), stamps.last()) else { return None };
        let step = 0.25 * period_ns / (last - first).max(period_ns);
        let tries = (within / step).ceil() as i64;
        if tries > TRIES_MOST {
            return None;
        }
        let power = |factor: f64| {
            let turn = std::f64::consts::TAU / (period_ns * factor);
            let (sine, cosine) = stamps.iter().fold((0.0, 0.0), |(sine, cosine), at_ns| {
                let (s, c) = (at_ns * turn).sin_cos();
                (sine + s, cosine + c)
            });
            (sine * sine + cosine * cosine) / stamps.len() as f64
        };
        let factors = (-tries..=tries).map(|place| 1.0 + place as f64 * step);
        let best = factors.map(|factor| (power(factor), factor)).max_by(|one, other| one.0.total_cmp(&other.0))?;
        if best.0 >= PHASES_AGREE {
            period_ns *= best.1;
            within = 2.0 * step;
            sharp = true;
        } else if stretch >= STRETCHES_MOST {
            break;
        }
        if stamps.len() < stretch {
            break;
        }
    }
    sharp.then_some(period_ns)
}

/// Returns the other period near this one under which rounded stamps have the same phases, in the opposite sense: stamps that are
/// multiples of R cannot distinguish the rates f and m/R − f.
fn mirrored(period_ns: f64, rounding_ns: u64) -> Option<f64> {
    let rounding = rounding_ns as f64 / period_ns;
    let multiple = (2.0 * rounding).round();
    let other_ns = period_ns / (multiple / rounding - 1.0);
    let is_near = multiple > 0.0 && (other_ns / period_ns - 1.0).abs() < 2.0 * FIRST_WITHIN;
    is_near.then_some(other_ns)
}

fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Returns the half-sample mode (Robertson and Cryer 1974): the densest half of the densest half, and so on; of equals
/// the lowest.
fn mode(values: &mut [f64]) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    let mut of: &[f64] = values;
    while of.len() > 3 {
        let half = of.len().div_ceil(2);
        let from = (0..=of.len() - half)
            .min_by(|one, other| (of[one + half - 1] - of[*one]).total_cmp(&(of[other + half - 1] - of[*other])))?;
        of = &of[from..from + half];
    }
    match of {
        [] => None,
        [one] => Some(*one),
        [one, two] => Some(0.5 * (one + two)),
        [one, two, three] if two - one <= three - two => Some(0.5 * (one + two)),
        [_, two, three, ..] => Some(0.5 * (two + three)),
    }
}
