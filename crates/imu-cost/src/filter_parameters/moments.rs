//! Joint moments of integrated errors: E x_i x_j of the integrals x over horizons i and j after one alignment.
//!
//! In: densities at the nodes of panels, lines, or samples of a record. Out: one moment per pair of a [`Grid`], in
//! (U·s)². Densities are integrated as variances are ([`crate::quadrature`]): a transform is a sum of at most three terms
//! with a delay each, and of a product each pair of terms turns with the difference of their delays.
//!
//! Validation: `joint_moments_are_those_of_the_listed_weights`, `a_record_has_the_moments_of_its_windows`.

use super::request::Grid;
use crate::quadrature::{NODES, Panel, Rule};
use crate::weights::{Angle, Smooth, Span, Term};
use imu_model::effects::Line;
use nalgebra::Complex;
use std::collections::HashMap;
use std::f64::consts::{PI, TAU};

/// One moment per pair of a grid, (U·s)².
pub(crate) type Moments = Vec<f64>;

/// The most windows of a record that a mean is taken over.
pub(crate) const WINDOWS_MAX: u64 = 4000;

/// The most samples of a record over which windows are dense: their sums take 8 bytes each.
pub(crate) const DENSE_MAX: u64 = 1 << 24;

/// Adds `factor` times moments to others.
pub(crate) fn add(sum: &mut [f64], factor: f64, other: &[f64]) {
    sum.iter_mut().zip(other).for_each(|(sum, other)| *sum += factor * other);
}

/// A part of a transform at the nodes of a panel.
struct Part {
    delay: i64,
    amplitudes: [Complex<f64>; NODES],
}

/// Passes for each pair the weights of a panel's nodes to `take`: a moment is Σ weight·density over all panels, with the
/// two-sided density in U²/Hz.
pub(crate) fn weigh(
    rule: &Rule,
    panel: Panel,
    rate_hz: f64,
    align: u64,
    grid: &Grid,
    mut take: impl FnMut(usize, [f64; NODES]),
) {
    let angles = rule.nodes(panel).map(|hz| Angle::new(TAU * hz / rate_hz));
    let highest = TAU * panel.to / rate_hz;
    let transforms: Vec<Vec<Part>> =
        grid.horizons.iter().map(|horizon| transform(&angles, highest, align, *horizon)).collect();
    let scale = 2.0 / (rate_hz * rate_hz);
    let mut turns: HashMap<i64, [Complex<f64>; NODES]> = HashMap::new();
    for (index, [one, other]) in grid.pairs.iter().enumerate() {
        let mut weights = [0.0; NODES];
        for left in &transforms[*one] {
            for right in &transforms[*other] {
                let delay = left.delay - right.delay;
                let size = delay.abs();
                let turn = turns.entry(size).or_insert_with(|| rule.oscillating(panel, rate_hz, size as f64));
                for (place, weight) in weights.iter_mut().enumerate() {
                    let product = left.amplitudes[place] * right.amplitudes[place].conj();
                    // A negative delay turns the other way; of the product only the real part counts.
                    let product = if delay < 0 { product.conj() } else { product };
                    *weight += scale * (product * turn[place]).re;
                }
            }
        }
        take(index, weights);
    }
}

/// Returns the parts of a horizon's transform at the nodes of a panel that ends at `highest` rad per sample.
fn transform(angles: &[Angle; NODES], highest: f64, align: u64, horizon: u64) -> Vec<Part> {
    let span = Span { align: align as f64, horizon: horizon as f64 };
    let smooth = Smooth::up_to(highest, span);
    let mut parts: Vec<Part> = Vec::with_capacity(3);
    let mut terms: Vec<Term> = Vec::with_capacity(3);
    for (place, angle) in angles.iter().enumerate() {
        angle.terms(1, span, smooth, &mut terms);
        for (index, term) in terms.iter().enumerate() {
            if parts.len() == index {
                let amplitudes = [Complex::from(0.0); NODES];
                parts.push(Part { delay: term.delay.round() as i64, amplitudes });
            }
            parts[index].amplitudes[place] = term.amplitude;
        }
    }
    parts
}

/// Returns the moments of densities, one list per panel's node each, on panels.
pub(crate) fn of_densities(
    rule: &Rule,
    panels: &[Panel],
    rate_hz: f64,
    align: u64,
    grid: &Grid,
    densities: &[Vec<f64>],
) -> Vec<Moments> {
    let mut all = vec![vec![0.0; grid.pairs.len()]; densities.len()];
    for (place, panel) in panels.iter().enumerate() {
        let nodes = place * NODES..(place + 1) * NODES;
        weigh(rule, *panel, rate_hz, align, grid, |pair, weights| {
            for (moments, density) in all.iter_mut().zip(densities) {
                let own = weights.iter().zip(&density[nodes.clone()]);
                moments[pair] += own.map(|(weight, density)| weight * density).sum::<f64>();
            }
        });
    }
    all
}

/// Returns the moments of a line of random phase as it is sent. Of a horizon with itself outside the joint pairs they are
/// an upper bound that holds at every longer horizon too: the line at its worst phase.
pub(crate) fn of_line(line: Line, rate_hz: f64, align: u64, grid: &Grid) -> Moments {
    let omega = TAU * line.frequency_hz / rate_hz;
    if omega <= 0.0 {
        return vec![0.0; grid.pairs.len()];
    }
    let scale = line.power / (rate_hz * rate_hz);
    let whole: Vec<Complex<f64>> = grid
        .horizons
        .iter()
        .map(|horizon| {
            let span = Span { align: align as f64, horizon: *horizon as f64 };
            let mut terms = Vec::with_capacity(3);
            Angle::new(omega).terms(1, span, Smooth::up_to(omega, span), &mut terms);
            terms.iter().map(|term| term.amplitude * Complex::cis(-omega * term.delay)).sum()
        })
        .collect();
    let largest = |horizon: f64| {
        let level = horizon / align as f64 * (2.0 * (0.5 * omega * align as f64).sin()).abs();
        (2.0 + level) / (2.0 * (0.5 * omega).sin())
    };
    let joint = grid.joint_pairs();
    let moment = |(index, [one, other]): (usize, &[usize; 2])| {
        let horizon = grid.horizons[*one] as f64;
        // From half a period on.
        if index >= joint && omega * horizon >= PI {
            return scale * largest(horizon).powi(2);
        }
        scale * (whole[*one] * whole[*other].conj()).re
    };
    grid.pairs.iter().enumerate().map(moment).collect()
}

/// Windows of an alignment and the horizons after it, spread over a record.
#[derive(Debug)]
pub(crate) struct Windows {
    align: u64,
    starts: Vec<u64>,
    /// The places in the record, in samples, up to which sums are needed; increasing. Empty if all are.
    places: Vec<u64>,
    /// The samples that all windows need.
    samples: u64,
}

impl Windows {
    /// Creates the windows of a record of `samples`.
    pub(crate) fn new(samples: u64, align: u64, grid: &Grid) -> Self {
        let longest = align + grid.horizons.last().copied().unwrap_or(1);
        let last = samples.saturating_sub(longest);
        let count = WINDOWS_MAX.min(last + 1);
        let start = |k: u64| if count == 1 { 0 } else { (k as f64 * last as f64 / (count - 1) as f64).round() as u64 };
        let starts: Vec<u64> = (0..count).map(start).collect();
        let offsets: Vec<u64> = [0, align].into_iter().chain(grid.horizons.iter().map(|of| align + of)).collect();
        let mut places: Vec<u64> = starts.iter().flat_map(|start| offsets.iter().map(move |of| start + of)).collect();
        places.sort_unstable();
        places.dedup();
        let samples = places.last().copied().unwrap_or(0);
        Self { align, starts, places, samples }
    }

    /// Creates windows of a record of `samples` that begin at most `stride` samples apart, so that what lasts for a short time is
    /// in as many of them as in the record's. A record of more than [`DENSE_MAX`] samples gets those of [`Self::new`].
    pub(crate) fn dense(samples: u64, align: u64, grid: &Grid, stride: u64) -> Self {
        let longest = align + grid.horizons.last().copied().unwrap_or(1);
        let last = samples.saturating_sub(longest);
        if samples.max(longest) > DENSE_MAX || last / stride.max(1) < WINDOWS_MAX {
            return Self::new(samples, align, grid);
        }
        let starts = (0..=last).step_by(stride.max(1) as usize).collect();
        Self { align, starts, places: Vec::new(), samples: last + longest }
    }

    /// Returns the samples that all windows need.
    pub(crate) fn samples(&self) -> u64 {
        self.samples
    }

    /// Returns the mean over the windows of the products of integrals of a record's samples.
    pub(crate) fn moments(&self, rate_hz: f64, grid: &Grid, mut next: impl FnMut() -> f64) -> Moments {
        let all_places = 0..=self.samples;
        let is_dense = self.places.is_empty();
        let places = self.places.iter().copied().chain(all_places.take_while(|_| is_dense));
        let mut sums = Vec::with_capacity(self.places.len());
        let (mut sum, mut taken, mut first) = (0.0, 0_u64, None);
        for place in places {
            while taken < place {
                let value = next();
                // Relative to the first sample, so that a constant cancels exactly.
                sum += value - *first.get_or_insert(value);
                taken += 1;
            }
            sums.push(sum);
        }
        let index = |place: u64| if is_dense { Some(place as usize) } else { self.places.binary_search(&place).ok() };
        let at = |place: u64| index(place).and_then(|index| sums.get(index)).copied();
        let mut all = vec![0.0; grid.pairs.len()];
        let mut integrals = vec![0.0; grid.horizons.len()];
        let (weight, align) = (1.0 / (self.starts.len() as f64 * rate_hz * rate_hz), self.align);
        for start in &self.starts {
            let [begin, aligned] = [*start, start + align].map(|place| at(place).unwrap_or_default());
            let level = (aligned - begin) / align as f64;
            for (integral, horizon) in integrals.iter_mut().zip(&grid.horizons) {
                let end = at(start + align + horizon).unwrap_or_default();
                *integral = end - aligned - *horizon as f64 * level;
            }
            for (moment, [one, other]) in all.iter_mut().zip(&grid.pairs) {
                *moment += weight * integrals[*one] * integrals[*other];
            }
        }
        all
    }
}
