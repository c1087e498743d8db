//! Selection: finds the subset of effects that explains most nats less their prices.
//!
//! Effects are added, taken back and exchanged one at a time as long as that is better, beginning with none. If two
//! explain a record equally well, the simpler one, which stands first in the list, is kept.

use super::groups::Group;
use crate::response::Screen;

/// Nats below which two subsets are the same.
const SAME: f64 = 1e-6;
/// Maximum number of changes in a search.
const MOST: usize = 60;

/// A chosen subset.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Choice {
    /// Places of the chosen groups, in order.
    pub groups: Vec<usize>,
    /// Nats that the groups explain together beyond the base columns.
    pub gain: f64,
}

/// The data by which subsets are weighed.
#[derive(Debug, Clone, Copy)]
pub struct Weighing<'a> {
    screen: &'a Screen,
    /// Columns that are in every subset: the clock's, the temperature's.
    base: &'a [usize],
    groups: &'a [Group],
    without: f64,
}

impl<'a> Weighing<'a> {
    /// Weighs subsets of these groups.
    pub fn new(screen: &'a Screen, base: &'a [usize], groups: &'a [Group]) -> Self {
        Self { screen, base, groups, without: screen.gain(base).0 }
    }

    /// Returns the columns of a subset, the base columns first.
    pub fn columns(&self, subset: &[usize]) -> Vec<usize> {
        self.base.iter().copied().chain(subset.iter().flat_map(|place| self.groups[*place].columns.clone())).collect()
    }

    /// Returns the nats that a subset explains.
    pub fn gain(&self, subset: &[usize]) -> f64 {
        self.screen.gain(&self.columns(subset)).0 - self.without
    }

    /// Returns the nats that a subset explains, less the prices.
    pub fn score(&self, subset: &[usize]) -> f64 {
        self.gain(subset) - subset.iter().map(|place| self.groups[*place].price).sum::<f64>()
    }

    /// Returns the best subset.
    pub fn choose(&self) -> Choice {
        let mut own: Vec<usize> = Vec::new();
        let mut score = 0.0;
        for _ in 0..MOST {
            let mut best: Option<(f64, Vec<usize>)> = None;
            for next in self.neighbours(&own) {
                let of = self.score(&next);
                if of > best.as_ref().map_or(score, |(best, _)| *best) + SAME {
                    best = Some((of, next));
                }
            }
            let Some((better, next)) = best else { break };
            (score, own) = (better, next);
        }
        Choice { gain: self.gain(&own), groups: own }
    }

    /// Returns subsets that differ by one group, or by one group for another.
    fn neighbours(&self, own: &[usize]) -> Vec<Vec<usize>> {
        let absent: Vec<usize> = (0..self.groups.len()).filter(|place| !own.contains(place)).collect();
        let without = |place: usize| own.iter().copied().filter(move |of| *of != place);
        let ordered = |mut subset: Vec<usize>| {
            subset.sort_unstable();
            subset
        };
        let mut all: Vec<Vec<usize>> = own.iter().map(|place| without(*place).collect()).collect();
        all.extend(absent.iter().map(|place| ordered(own.iter().copied().chain([*place]).collect())));
        for place in own {
            all.extend(absent.iter().map(|other| ordered(without(*place).chain([*other]).collect())));
        }
        all
    }

    /// Returns by how much a subset is better than the best subset without one of its groups, nats less prices; and
    /// which group would replace it, if any would.
    pub fn margin(&self, own: &[usize], place: usize) -> (f64, Option<usize>) {
        let rest: Vec<usize> = own.iter().copied().filter(|of| *of != place).collect();
        let whole = self.score(own);
        let mut best = (self.score(&rest), None);
        for other in (0..self.groups.len()).filter(|other| !own.contains(other)) {
            let with: Vec<usize> = rest.iter().copied().chain([other]).collect();
            let score = self.score(&with);
            if score > best.0 {
                best = (score, Some(other));
            }
        }
        (whole - best.0, best.1)
    }
}
