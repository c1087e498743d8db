//! Whitened: a series whose residual is whitened by the spectrum of its time.

use super::{gates, left_out, spectrum_at};
use crate::series::Series;
use std::collections::BTreeSet;

impl Series<'_> {
    /// Returns the series with a residual that is whitened by the spectrum of its time: with the bands that are present then, and
    /// without the others. `None` if no band comes and goes.
    pub(crate) fn whitened_by_time(&self) -> Option<Self> {
        /// Samples that are replaced have the mean spectrum.
        const REPLACED: u8 = 1 << 7;
        /// Samples on either side of an end, and the largest usual value there.
        const NEAR: usize = 16;
        const USUAL: f64 = 2.0;
        let gates = gates(self);
        if gates.is_empty() {
            return None;
        }
        let mut states: Vec<u8> = left_out(self).into_iter().map(|of| if of { REPLACED } else { 0 }).collect();
        for (at, gate) in gates.iter().enumerate() {
            for range in &gate.ranges {
                let there = states[range.clone()].iter_mut().filter(|state| **state != REPLACED);
                there.for_each(|state| *state |= 1 << at);
            }
        }
        let mut residual = vec![0.0; self.len()];
        let mut series = self.clone();
        for state in states.iter().copied().collect::<BTreeSet<u8>>() {
            let spectrum = match state {
                REPLACED => self.spectrum.clone(),
                _ => spectrum_at(self, &gates, |at| state & (1 << at) != 0),
            };
            let mut own: Vec<f64> = self.coefficients.iter().zip(&spectrum).map(|(c, s)| c / s.sqrt()).collect();
            series.transform.backward(&mut own);
            let here = states.iter().enumerate().filter(|(_, own)| **own == state);
            here.for_each(|(t, _)| residual[t] = own[t]);
        }
        // About the ends of a stay neither spectrum holds.
        for end in gates.iter().flat_map(|gate| &gate.ranges).flat_map(|range| [range.start, range.end]) {
            let near = end.saturating_sub(NEAR)..(end + NEAR).min(residual.len());
            residual[near].iter_mut().for_each(|value| *value = value.clamp(-USUAL, USUAL));
        }
        series.whitened.clone_from(&residual);
        series.transform.forward(&mut series.whitened);
        series.set_residual(residual);
        Some(series)
    }
}
