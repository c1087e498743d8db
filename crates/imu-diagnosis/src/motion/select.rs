//! Selection: of all subsets of effects the one that explains most nats less their prices.
//!
//! Effects are added, taken back and exchanged one at a time as long as that is better, from none on. If two explain a record
//! alike, the simpler one stands first in the list, and stays.

use super::groups::Group;
use crate::response::Screen;

/// Nats below which two subsets are the same.
const SAME: f64 = 1e-6;
/// Changes after which the search is given up.
const MOST: usize = 60;

/// A chosen subset.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Choice {
    /// Places of its groups, in order.
    pub groups: Vec<usize>,
    /// Nats that they explain together beyond what is always there.
    pub gain: f64,
}

/// How subsets are weighed.
#[derive(Debug, Clone, Copy)]
pub struct Weighing<'a> {
    screen: &'a Screen,
    /// Columns that are in every subset: the clock's, the temperature's.
    base: &'a [usize],
    groups: &'a [Group],
    without: f64,
}

impl<'a> Weighing<'a> {
    /// Of these groups.
    pub fn new(screen: &'a Screen, base: &'a [usize], groups: &'a [Group]) -> Self {
        Self { screen, base, groups, without: screen.gain(base).0 }
    }

    /// The columns of a subset, those that are always there first.
    pub fn columns(&self, subset: &[usize]) -> Vec<usize> {
        self.base.iter().copied().chain(subset.iter().flat_map(|place| self.groups[*place].columns.clone())).collect()
    }

    /// Nats that a subset explains.
    pub fn gain(&self, subset: &[usize]) -> f64 {
        self.screen.gain(&self.columns(subset)).0 - self.without
    }

    /// The same less the prices.
    pub fn score(&self, subset: &[usize]) -> f64 {
        self.gain(subset) - subset.iter().map(|place| self.groups[*place].price).sum::<f64>()
    }

    /// The best subset.
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

    /// Subsets that differ by one group, or by one for another.
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

    /// By how much a subset is better than the best subset without one of its groups, nats less prices; and which group would
    /// replace it, if any would.
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
