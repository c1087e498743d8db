//! Prices: the distribution of each effect's gain and of each omnibus statistic in records of noise alone.
//!
//! Tails are exponential: the chance of more than x nats is about exp(−(x − offset)/scale). [`Tails::shipped`] has the
//! tails of simulated records at three lengths (`cargo run --release --example null_tails`); [`super::calibration`]
//! finds them for a record's own length and model.

use super::evidence::Kind;
use super::omnibus::Statistic;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

pub use super::tail::Tail;

/// The tails of all statistics and kinds that a diagnosis examines.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tails {
    /// Gains of effects.
    pub kinds: BTreeMap<Kind, Tail>,
    /// Statistics of the remainder.
    pub statistics: BTreeMap<Statistic, Tail>,
}

/// Lengths of the shipped table, samples.
const LENGTHS: [f64; 3] = [8193.0, 65_536.0, 720_000.0];

/// Interpolates linearly in ln of the samples between the table's lengths, and extrapolates beyond them.
fn between(offsets: [f64; LENGTHS.len()], samples: usize) -> f64 {
    let x = (samples.max(2) as f64).ln();
    let at = LENGTHS[1..LENGTHS.len() - 1].iter().filter(|length| x > length.ln()).count();
    let (from, to) = (LENGTHS[at].ln(), LENGTHS[at + 1].ln());
    offsets[at] + (x - from) / (to - from) * (offsets[at + 1] - offsets[at])
}

impl Tails {
    /// Returns the tails of the table, for records of `samples`.
    pub fn shipped(samples: usize) -> Self {
        let tail = |(offsets, scale)| Tail { offset: between(offsets, samples), scale };
        Self {
            kinds: Kind::ALL.into_iter().map(|kind| (kind, tail(kind.tail()))).collect(),
            statistics: Statistic::ALL.into_iter().map(|of| (of, tail(of.tail()))).collect(),
        }
    }

    /// Returns whether there is a tail for every kind and statistic.
    pub fn is_whole(&self) -> bool {
        Kind::ALL.iter().all(|kind| self.kinds.contains_key(kind))
            && Statistic::ALL.iter().all(|of| self.statistics.contains_key(of))
    }

    /// Returns the chance that noise alone exceeds a value of a statistic; more than 1 for usual values.
    pub fn chance(&self, statistic: Statistic, value: f64) -> f64 {
        self.statistics.get(&statistic).map_or(1.0, |tail| tail.chance(value))
    }
}

/// The gain that each searched kind needs before it is named, nats.
#[derive(Debug, Clone, PartialEq)]
pub struct Prices(BTreeMap<Kind, f64>);

impl Prices {
    /// Computes prices from tails, for `channels` examined channels: chance names a kind in a part `level` of records
    /// of noise alone, all kinds and channels counted.
    pub fn new(tails: &Tails, channels: usize, level: f64, wanted: impl Fn(Kind) -> bool) -> Self {
        const LEAST: f64 = 6.0;
        let level = level / (channels.max(1) * Kind::ALL.len()) as f64;
        let kinds = tails.kinds.iter().filter(|(kind, _)| wanted(**kind));
        Self(kinds.map(|(kind, tail)| (*kind, tail.beyond(level).max(LEAST))).collect())
    }

    /// Returns the price of a kind; infinite if it is not looked for.
    pub fn of(&self, kind: Kind) -> f64 {
        self.0.get(&kind).copied().unwrap_or(f64::INFINITY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exponential_tail_is_found_and_prices_follow_from_it() {
        // Quantiles of 2 + 1.5·Exp(1).
        let values: Vec<f64> = (0..1000).map(|i| 2.0 - 1.5 * (1.0 - (f64::from(i) + 0.5) / 1000.0).ln()).collect();
        let tail = Tail::of(&values).unwrap();
        assert!((tail.offset - 2.0).abs() < 0.05 && (tail.scale - 1.5).abs() < 0.03, "{tail:?}");
        assert!((tail.chance(tail.beyond(1e-3)) - 1e-3).abs() < 1e-9);
        assert_eq!(Tail::of(&values[..10]), None);
        let tails = Tails::shipped(65_536);
        let prices = Prices::new(&tails, 2, 0.005, |kind| kind != Kind::Tone);
        assert_eq!(prices.of(Kind::Tone), f64::INFINITY);
        assert!(prices.of(Kind::BiasStep) > prices.of(Kind::RateRamp) + 3.0);
    }

    #[test]
    fn every_kind_and_statistic_has_a_tail_at_any_length() {
        for samples in [1000, 8193, 100_000, 5_000_000] {
            let tails = Tails::shipped(samples);
            assert!(Kind::ALL.iter().all(|kind| tails.kinds.contains_key(kind)));
            assert!(Statistic::ALL.iter().all(|of| tails.statistics.contains_key(of)));
        }
    }
}
