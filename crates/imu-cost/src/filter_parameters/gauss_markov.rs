//! The family of white noise and a Gauss-Markov process: for each correlation time as for a walk, and the time searched for.
//!
//! In: moments of white noise, a setting, real covariances. Out: variances and correlation times. The density of the
//! process is smooth on octaves, for any correlation time.

use super::fit::{Family, Seen, Variances, golden};
use super::moments::{Moments, weigh};
use super::request::Grid;
use crate::quadrature::{Rule, octaves};
use imu_model::effects::{Effect as _, GaussMarkov};

/// Correlation times per decade that are tried, from this part of the shortest horizon to this multiple of the alignment
/// and the longest horizon.
const PER_DECADE: f64 = 6.0;
const FROM: f64 = 0.3;
const TO: f64 = 30.0;
/// Twice the divergence by which another correlation time must be closer, nats.
const CLOSER: f64 = 1e-9;

/// A process of one correlation time.
#[derive(Debug)]
struct Timed {
    log_tc: f64,
    family: Family,
}

/// All processes that a range of horizons tells apart.
#[derive(Debug)]
pub(crate) struct Processes<'a> {
    grid: &'a Grid,
    white: &'a [f64],
    rate_hz: f64,
    /// Frequencies, Hz.
    nodes: Vec<f64>,
    /// The weights of the nodes, by pair of horizons.
    weights: Vec<Vec<f64>>,
    tried: Vec<Timed>,
}

/// A process with white noise.
#[derive(Debug)]
pub(crate) struct Found {
    pub family: Family,
    pub seen: Seen,
    pub variances: Variances,
    pub tc_s: f64,
    /// Whether the correlation time is the first or last one that was tried.
    pub at_end: bool,
}

impl<'a> Processes<'a> {
    /// Creates the processes for a grid; `white` has the moments of white noise of 1 U/√Hz.
    pub(crate) fn new(grid: &'a Grid, white: &'a [f64], rate_hz: f64, align: u64) -> Self {
        let longest = (align + grid.horizons.last().copied().unwrap_or(1)) as f64;
        let shortest = grid.horizons.first().copied().unwrap_or(1) as f64;
        let (rule, panels) = (Rule::new(), octaves(rate_hz, longest, &[]));
        let mut weights = vec![Vec::new(); grid.pairs.len()];
        for panel in &panels {
            weigh(&rule, *panel, rate_hz, align, grid, |pair, own| weights[pair].extend(own));
        }
        let nodes = panels.iter().flat_map(|panel| rule.nodes(*panel)).collect();
        let mut own = Self { grid, white, rate_hz, nodes, weights, tried: Vec::new() };
        let [from, to] = [FROM * shortest / rate_hz, TO * longest / rate_hz].map(f64::ln);
        let steps = (PER_DECADE * (to - from) / std::f64::consts::LN_10).ceil();
        let times: Vec<f64> = (0..=steps as usize).map(|k| from + (to - from) * k as f64 / steps).collect();
        let timed = |log_tc: &f64| Some(Timed { log_tc: *log_tc, family: own.family(*log_tc)? });
        own.tried = times.iter().filter_map(timed).collect();
        own
    }

    /// Returns the family of a correlation time, given by its logarithm.
    fn family(&self, log_tc: f64) -> Option<Family> {
        let process = GaussMarkov { sigma: 1.0, tc_s: log_tc.exp() };
        let density: Vec<f64> = self.nodes.iter().map(|hz| process.psd(*hz, self.rate_hz).unwrap_or(0.0)).collect();
        let moment = |weights: &Vec<f64>| weights.iter().zip(&density).map(|(weight, density)| weight * density).sum();
        let moments: Moments = self.weights.iter().map(moment).collect();
        Family::new(self.grid, self.white, &moments)
    }

    /// Returns the closest process, or the closest that covers.
    pub(crate) fn closest(&self, real: &[f64], covers: bool) -> Option<Found> {
        let of = |family: &Family| {
            let seen = family.seen(self.grid, real);
            let closest = family.closest(&seen);
            let own = if covers { family.covering(closest, &seen) } else { closest };
            (family.distance(own, &seen), own, seen)
        };
        let distances: Vec<f64> = self.tried.iter().map(|tried| of(&tried.family).0).collect();
        // A larger correlation time has to be closer by more than rounding.
        let mut place = 0;
        for (other, distance) in distances.iter().enumerate() {
            if distance.is_finite() && (!distances[place].is_finite() || *distance < distances[place] - CLOSER) {
                place = other;
            }
        }
        let last = self.tried.len().checked_sub(1)?;
        let ends = [place.saturating_sub(1), (place + 1).min(last)].map(|place| self.tried[place].log_tc);
        let distance = |log_tc: f64| self.family(log_tc).map_or(f64::INFINITY, |family| of(&family).0);
        let refined = golden(ends[0], ends[1], distance);
        let better = distance(refined) < distances[place];
        let log_tc = if better { refined } else { self.tried[place].log_tc };
        let family = self.family(log_tc)?;
        let (_, variances, seen) = of(&family);
        let at_end = place == 0 || place == last;
        Some(Found { family, seen, variances, tc_s: log_tc.exp(), at_end })
    }
}
