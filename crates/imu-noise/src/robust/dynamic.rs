//! Dynamic Allan deviation: the deviation hour by hour, and whether the hours agree.
//!
//! # Source
//! M. S. Bartlett, Proc. R. Soc. A 160 (1937) 268, for the test of equal variances; degrees of freedom are the equivalent
//! ones of the overlapping estimator for the noise of the local slope.

use super::Part;
use super::part::Seam;
use crate::allan::{AllanPoint, FixedPoint, Overlapping, TauGrid, noise_by_slope};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Length of a block if the record has at least [`LEAST`] of them, s.
const HOUR_S: f64 = 3600.0;
/// Blocks into which a shorter record is cut.
const LEAST: usize = 4;
/// Below this p-value a record is non-stationary.
const LEVEL: f64 = 0.01;
/// Longest averaging time as a fraction of a block: the test needs some ten degrees of freedom.
const FRACTION: usize = 16;

/// One block of the record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct DynamicBlock {
    /// Begin, s since the start of the capture.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
    /// Deviation at each averaging time; null if the block has too little data.
    pub deviation: Vec<Option<f64>>,
}

/// The deviation block by block, without excluded samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct DynamicAllan {
    /// Length of a block, s.
    pub block_s: f64,
    /// Averaging times, s.
    pub tau_s: Vec<f64>,
    /// The blocks in order.
    pub blocks: Vec<DynamicBlock>,
    /// Whether the blocks agree within chance; null if there is too little data.
    pub stationary: Option<bool>,
    /// How often blocks of stationary noise differ as much at any averaging time.
    pub p_value: Option<f64>,
    /// The averaging time at which they differ most, s.
    pub worst_tau_s: Option<f64>,
}

/// Computes the deviation; samples come in order of time.
#[derive(Debug)]
pub(super) struct Dynamic {
    begin_s: f64,
    block_s: f64,
    rate_hz: f64,
    scale: FixedPoint,
    grid: TauGrid,
    blocks: usize,
    /// Points of the completed blocks, and the current block.
    points: Vec<Vec<AllanPoint>>,
    open: Overlapping,
    seam: Seam,
}

impl Dynamic {
    /// Creates an accumulator for a record from `begin_s` to `end_s`, without samples; `None` if the record is too
    /// short.
    pub(super) fn new((begin_s, end_s): (f64, f64), rate_hz: f64, scale: FixedPoint) -> Option<Self> {
        let hours = ((end_s - begin_s) / HOUR_S).round() as usize;
        let blocks = if hours >= LEAST { hours } else { LEAST };
        let block_s = (end_s - begin_s) / blocks as f64;
        let longest = (block_s * rate_hz) as u64;
        let grid = TauGrid::octave(longest * 4 / FRACTION as u64).ok()?;
        let open = Overlapping::new(scale, grid.clone());
        Some(Self { begin_s, block_s, rate_hz, scale, grid, blocks, points: Vec::new(), open, seam: Seam::default() })
    }

    fn begin_of(&self, block: usize) -> f64 {
        self.begin_s + block as f64 * self.block_s
    }

    /// Takes the next samples; `continues` has the meaning of [`Portion::continues`](super::Portion::continues).
    pub(super) fn push(&mut self, parts: &[Part], continues: bool) {
        for (part, joins) in self.seam.joins(parts, continues, self.rate_hz) {
            if !joins {
                self.open.break_segment();
            }
            let mut from = 0;
            while from < part.values.len() {
                let until_s = self.begin_of(self.points.len() + 1);
                let to = ((until_s - part.start_s) * self.rate_hz - 1e-6).ceil().max(0.0) as usize;
                let last = self.points.len() + 1 >= self.blocks;
                let to = if last { part.values.len() } else { to.clamp(from, part.values.len()) };
                self.open.push(&part.values[from..to]);
                from = to;
                if from < part.values.len() {
                    self.end_block();
                }
            }
        }
    }

    fn end_block(&mut self) {
        let ended = std::mem::replace(&mut self.open, Overlapping::new(self.scale, self.grid.clone()));
        self.points.push(ended.into_sums().points());
    }

    /// Returns the deviation of every block.
    pub(super) fn finish(mut self) -> DynamicAllan {
        while self.points.len() < self.blocks {
            self.end_block();
        }
        let factors = self.grid.factors();
        let block = |(block, points): (usize, &Vec<AllanPoint>)| {
            let deviation = |m: &usize| points.iter().find(|point| point.m == *m).map(|point| point.variance.sqrt());
            let deviation = factors.iter().map(deviation).collect();
            DynamicBlock { from_s: self.begin_of(block), to_s: self.begin_of(block + 1), deviation }
        };
        let tests: Vec<(usize, f64)> = factors.iter().filter_map(|m| Some((*m, bartlett(&self.points, *m)?))).collect();
        let worst = tests.iter().min_by(|a, b| a.1.total_cmp(&b.1));
        let p_value = worst.map(|(_, p)| (p * tests.len() as f64).min(1.0));
        DynamicAllan {
            block_s: self.block_s,
            tau_s: factors.iter().map(|m| *m as f64 / self.rate_hz).collect(),
            blocks: self.points.iter().enumerate().map(block).collect(),
            stationary: p_value.map(|p| p >= LEVEL),
            p_value,
            worst_tau_s: worst.map(|(m, _)| *m as f64 / self.rate_hz),
        }
    }
}

/// Returns how often the variances at `m` of equal noise differ as much as those of the blocks.
fn bartlett(blocks: &[Vec<AllanPoint>], m: usize) -> Option<f64> {
    let of_block = |points: &Vec<AllanPoint>| {
        let index = points.iter().position(|point| point.m == m)?;
        let (point, noise) = (points[index], *noise_by_slope(points).get(index)?);
        Some((point.variance, point.edf(noise))).filter(|(variance, edf)| *variance > 0.0 && *edf >= 2.0)
    };
    let known: Vec<(f64, f64)> = blocks.iter().filter_map(of_block).collect();
    if known.len() < LEAST - 1 {
        return None;
    }
    let degrees: f64 = known.iter().map(|(_, edf)| edf).sum();
    let pooled = known.iter().map(|(variance, edf)| variance * edf).sum::<f64>() / degrees;
    let spread = degrees * pooled.ln() - known.iter().map(|(variance, edf)| edf * variance.ln()).sum::<f64>();
    let groups = known.len() as f64 - 1.0;
    let correction = 1.0 + (known.iter().map(|(_, edf)| 1.0 / edf).sum::<f64>() - 1.0 / degrees) / (3.0 * groups);
    let p = ChiSquared::new(groups).ok()?.sf((spread / correction).max(0.0));
    p.is_finite().then_some(p)
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::Noise;
    use super::*;

    fn dynamic(values: Vec<f64>) -> DynamicAllan {
        let span_s = (0.0, values.len() as f64 / 10.0);
        let mut dynamic = Dynamic::new(span_s, 10.0, FixedPoint::for_range(6, 7).unwrap()).unwrap();
        for (index, chunk) in values.chunks(7_777).enumerate() {
            dynamic.push(&[Part { start_s: index as f64 * 777.7, values: chunk.to_vec() }], true);
        }
        dynamic.finish()
    }

    #[test]
    fn five_hours_have_five_blocks_and_a_noisy_one_is_seen() {
        let mut values = Noise::new(51).sensor(180_000, 10.0, 1e-2, 1e-3, 0.0);
        let calm = dynamic(values.clone());
        assert_eq!((calm.blocks.len(), calm.block_s, calm.stationary), (5, 3600.0, Some(true)));
        for value in &mut values[72_000..108_000] {
            *value *= 1.2;
        }
        let shaken = dynamic(values);
        assert_eq!(shaken.stationary, Some(false), "{:?}", shaken.p_value);
        assert!(shaken.blocks[2].deviation[0] > shaken.blocks[1].deviation[0]);
    }

    #[test]
    fn stationary_noise_is_called_so() {
        let wrong = (0..100).filter(|seed| {
            let values = Noise::new(2000 + seed).sensor(20_000, 10.0, 1e-2, 3e-3, 3e-4);
            dynamic(values).stationary == Some(false)
        });
        let wrong = wrong.count();
        assert!(wrong <= 4, "{wrong} of 100");
    }
}
