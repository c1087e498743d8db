//! Filling: values that replace samples that are not noise.

use super::dot::dot;
use super::explanation::LOUD;
use super::preconditioner::Preconditioner;
use super::series::Series;
use imu_model::effects::{Stream, StreamId};
use std::collections::BTreeSet;

/// Random streams of the filled-in values: one per purpose, so that no two are alike.
const SIMPLE: u16 = 0;
const DRAWN: u16 = 3;

/// Returns a random stream. `owner` identifies the channel, so that values filled in at the same places of several
/// channels differ.
pub(super) fn stream(samples: usize, owner: u32, effect: u16) -> Stream {
    Stream::new(samples as u64, StreamId { owner, effect, instance: 0 })
}

impl Series<'_> {
    /// Returns the samples that are not noise, in order: those that are left out, and stretches that are much louder
    /// than the rest.
    pub(super) fn excluded(&self) -> Vec<usize> {
        let mut places = self.explanation.left_out(self.len(), self.reach()).into_owned();
        for loud in self.explanation.loud.iter().filter(|loud| loud.ratio > LOUD) {
            places.extend(self.spoilt(loud));
        }
        places.sort_unstable();
        places.dedup();
        places
    }

    /// Returns the samples that are replaced by draws of any size, in order. Samples at a limit are drawn beyond it, so that they
    /// stay evidence.
    pub(super) fn replaced(&self) -> Vec<usize> {
        let limits: BTreeSet<usize> = self.censored.iter().map(|of| of.place).collect();
        let mut places = self.excluded();
        places.retain(|place| !limits.contains(place));
        places
    }

    /// Returns places and residual of the samples that are not replaced.
    pub(super) fn there(&self) -> impl Iterator<Item = (usize, f64)> {
        let mut is_there = vec![true; self.len()];
        self.replaced().into_iter().for_each(|place| is_there[place] = false);
        let values = self.innovations().iter().copied().enumerate();
        values.zip(is_there).filter(|(_, is_there)| *is_there).map(|(of, _)| of)
    }

    /// Returns which samples are near a stretch that is replaced. A stretch may begin and end softly: what is left of it outside
    /// its ends looks like tails or spikes.
    pub(super) fn near_stretches(&self) -> Vec<bool> {
        /// Part of a stretch's length, and the least and greatest number of samples.
        const PART: usize = 4;
        const SAMPLES: (usize, usize) = (4, 256);
        let mut near = vec![false; self.len()];
        for loud in self.explanation.loud.iter().filter(|loud| loud.ratio > LOUD) {
            let margin = ((loud.to - loud.from) / PART).clamp(SAMPLES.0, SAMPLES.1);
            let to = (self.spoilt(loud).end + margin).min(near.len());
            near[loud.from.saturating_sub(margin)..to].fill(true);
        }
        near
    }

    /// Replaces excluded samples with a draw from the conditional distribution of the present law, given all other samples. The
    /// replaced samples then show no features of any effect.
    ///
    /// With a record drawn from the law, the difference of both is continued into the excluded places by conjugate gradients on
    /// the law's precision matrix (Hoffman and Ribak 1991, Astrophys. J. 380), preconditioned by its entries between near samples
    /// ([`Preconditioner`]). Samples at a limit are known to lie beyond it: they are drawn once more from there.
    pub(super) fn interpolate(&mut self) {
        const ROUNDS: usize = 200;
        /// The number of samples that all rounds together may transform. For a long record with a steep filter, this
        /// ends the rounds early.
        const WORK: usize = 60_000_000;
        /// Rounds end if none of this many in a row gains this many nats: behind a filter the matrix's eigenvalues are
        /// far apart.
        const ENOUGH: f64 = 1e-3;
        const IN_A_ROW: usize = 4;
        /// If a record has more excluded samples than this part, too little is left to determine its noise.
        const MOST: f64 = 0.9;
        let places = self.excluded();
        if places.is_empty() || places.len() as f64 > MOST * self.len() as f64 {
            return;
        }
        let n = self.len();
        let mut stream = stream(n, self.setting().owner, DRAWN);
        let mut drawn: Vec<f64> =
            self.spectrum.iter().map(|s| if s.is_finite() { s.sqrt() * stream.normal() } else { 0.0 }).collect();
        self.transform.backward(&mut drawn);
        // The known values of the difference, with a first guess of 0 in the excluded places.
        let mut difference: Vec<f64> = self.rest.iter().zip(&drawn).map(|(own, other)| own - other).collect();
        let guess = self.simple_guess(&difference, &places);
        for (place, value) in places.iter().zip(guess) {
            difference[*place] = value;
        }
        let kernel = self.kernel(n);
        let near = Preconditioner::of(&kernel, &places, n);
        // If the whole matrix was factored, a round gains half the square, apart from rounding.
        let is_known = near.as_ref().is_some_and(|near| near.is_whole);
        let nearly = |residual: &[f64]| near.as_ref().map_or_else(|| residual.to_vec(), |near| near.solve(residual));
        let mut precision = |values: &[f64]| -> Vec<f64> {
            let mut c = values.to_vec();
            self.precise(&mut c);
            places.iter().map(|place| c[*place]).collect()
        };
        let mut residual: Vec<f64> = precision(&difference).into_iter().map(|value| -value).collect();
        let mut direction = nearly(&residual);
        let mut square = dot(&residual, &direction);
        let mut spread = vec![0.0; n];
        let mut idle = 0;
        for _ in 0..ROUNDS.min(WORK / n) {
            if idle >= IN_A_ROW || square == 0.0 || (is_known && 0.5 * square < ENOUGH) {
                break;
            }
            for (place, value) in places.iter().zip(&direction) {
                spread[*place] = *value;
            }
            let image = precision(&spread);
            let curvature = dot(&direction, &image);
            if curvature <= 0.0 {
                break;
            }
            let step = square / curvature;
            idle = if 0.5 * step * square < ENOUGH { idle + 1 } else { 0 };
            for (at, place) in places.iter().enumerate() {
                difference[*place] += step * direction[at];
                residual[at] -= step * image[at];
            }
            let nearer = nearly(&residual);
            let next = dot(&residual, &nearer);
            let ratio = next / square;
            direction.iter_mut().zip(&nearer).for_each(|(d, r)| *d = r + ratio * *d);
            square = next;
        }
        for place in &places {
            self.rest[*place] = difference[*place] + drawn[*place];
        }
        self.draw_censored();
        self.centre();
    }

    /// Returns a course between the neighbours.
    fn simple_guess(&self, values: &[f64], places: &[usize]) -> Vec<f64> {
        let mut filled = values.to_vec();
        fill_in(&mut filled, places, 0.0, self.setting().owner);
        places.iter().map(|place| filled[*place]).collect()
    }
}

/// Replaces samples (in order) by a course between their neighbours plus white noise: a gap that is filled without
/// noise looks like a filter.
pub(super) fn fill_in(values: &mut [f64], places: &[usize], white: f64, owner: u32) {
    const NEAR: usize = 8;
    let n = values.len();
    let mut at = 0;
    let mut stream = stream(n, owner, SIMPLE);
    let mut is_out = vec![false; if places.is_empty() { 0 } else { n }];
    places.iter().for_each(|place| is_out[*place] = true);
    while at < places.len() {
        let mut end = at + 1;
        // A run, together with the good samples inside it, which are too few to determine a level.
        while end < places.len() && places[end] <= places[end - 1] + 1 {
            end += 1;
        }
        let (from, to) = (places[at], places[end - 1] + 1);
        let level = |range: std::ops::Range<usize>| {
            let inside = range.clone().filter(|t| !is_out[*t]);
            let (sum, count) = inside.fold((0.0, 0), |(sum, count), t| (sum + values[t], count + 1));
            (count > 0).then(|| sum / f64::from(count))
        };
        let before = level(from.saturating_sub(NEAR)..from);
        let after = level(to..(to + NEAR).min(n));
        let (before, after) = (before.or(after).unwrap_or(0.0), after.or(before).unwrap_or(0.0));
        for (step, value) in values[from..to].iter_mut().enumerate() {
            let share = (step + 1) as f64 / (to - from + 1) as f64;
            *value = before + share * (after - before) + white * stream.normal();
        }
        at = end;
    }
}
