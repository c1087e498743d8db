//! Tiles: where in time and frequency a residual is louder or quieter than expected.

use super::series::Series;
use super::transform::Cosines;
use statrs::function::gamma::{digamma, gamma_ur};

/// Stretches of time, and bands whose upper edges grow by half.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Tiles {
    /// Edges of the bands, Hz.
    pub edges_hz: Vec<f64>,
    /// Edges of the stretches, s.
    pub edges_s: Vec<f64>,
    /// Nats beyond the average of chance: stretch by stretch, band after band.
    pub excess: Vec<f64>,
    /// Variance over the expected variance.
    pub ratio: Vec<f64>,
}

/// A rectangle of tiles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    /// Frequencies, Hz.
    pub band_hz: [f64; 2],
    /// Times, s.
    pub time_s: [f64; 2],
    /// Nats in the rectangle.
    pub excess: f64,
    /// Mean ratio of the tiles.
    pub ratio: f64,
    /// A bound on the chance that noise alone makes as heavy a rectangle anywhere: the chance of its tiles' sum of
    /// squares, times the number of rectangles.
    pub p_value: f64,
}

/// Returns the gain of n coefficients' own variance, less the average gain by chance.
pub(super) fn excess(ratio: f64, count: f64) -> f64 {
    let half = 0.5 * count;
    half * (ratio - 1.0 - ratio.max(1e-9).ln()) - half * (half.ln() - digamma(half))
}

/// Returns −ln of the chance that a sum of `count` squares of standard normal values is above `square`.
pub(super) fn surprise(square: f64, count: f64) -> f64 {
    if square > 0.0 && square.is_finite() { -gamma_ur(0.5 * count, 0.5 * square).max(1e-300).ln() } else { 0.0 }
}

/// Calls `tile` with the ratio of each tile's mean square to its expected value, and its coefficients. `edges` are in
/// coefficients of a stretch; the order is stretch by stretch, band after band.
pub(super) fn each(series: &Series<'_>, stretches: usize, edges: &[usize], mut tile: impl FnMut(f64, usize)) {
    let size = series.len() / stretches;
    let mut transform = Cosines::new(size);
    // A change of variance concerns the white part alone: its share of each band.
    let white = series.white().powi(2);
    let share = |span: &[usize]| {
        let of = series.spectrum.get(span[0] * stretches..span[1] * stretches).unwrap_or_default();
        of.iter().map(|s| (white / s).min(1.0)).sum::<f64>() / of.len().max(1) as f64
    };
    let changes = !series.variance.is_empty() && series.equaliser.is_none();
    let shares: Vec<f64> = edges.windows(2).map(|span| if changes { share(span) } else { 0.0 }).collect();
    for stretch in 0..stretches {
        let range = stretch * size..(stretch + 1) * size;
        let mut values = series.residual[range.clone()].to_vec();
        let variance = series.variance.get(range).filter(|_| changes);
        if let Some(variance) = variance {
            values.iter_mut().zip(variance).for_each(|(e, v)| *e *= v.sqrt());
        }
        transform.forward(&mut values);
        let change = variance.map_or(0.0, |of| of.iter().sum::<f64>() / of.len().max(1) as f64 - 1.0);
        for (span, share) in edges.windows(2).zip(&shares) {
            let of = &values[span[0]..span[1]];
            let mean = of.iter().map(|c| c * c).sum::<f64>() / of.len().max(1) as f64 / (1.0 + share * change);
            tile(mean, of.len());
        }
    }
}

impl Tiles {
    const STRETCHES: usize = 32;

    /// Returns the tiles of a series' residual.
    pub fn of(series: &Series<'_>) -> Self {
        let rate_hz = series.setting().rate_hz;
        let size = series.len() / Self::STRETCHES;
        let mut edges = vec![1usize];
        while edges.last().is_some_and(|edge| *edge < size) {
            let next = edges.last().map_or(size, |edge| (edge * 3 / 2).max(edge + 4)).min(size);
            edges.push(next);
        }
        let (mut excess, mut ratio) = (Vec::new(), Vec::new());
        each(series, Self::STRETCHES, &edges, |mean, count| {
            excess.push(self::excess(mean, count as f64));
            ratio.push(mean);
        });
        let hz = |edge: usize| edge as f64 * rate_hz / (2.0 * size.max(1) as f64);
        let s = |edge: usize| (edge * size) as f64 / rate_hz;
        Self {
            edges_hz: edges.iter().map(|edge| hz(*edge)).collect(),
            edges_s: (0..=Self::STRETCHES).map(s).collect(),
            excess,
            ratio,
        }
    }

    /// Returns the rectangle of tiles that holds most of the excess for its size.
    pub fn heaviest(&self) -> Option<Rectangle> {
        let bands = self.edges_hz.len().checked_sub(1).filter(|bands| *bands > 0)?;
        let stretches = self.edges_s.len() - 1;
        // A tile of chance has a standard deviation of 0.7 nats: each tile costs a little.
        const COST: f64 = 1.0;
        let of_band = |band: usize, times: &std::ops::Range<usize>| -> f64 {
            times.clone().map(|stretch| self.excess[stretch * bands + band] - COST).sum()
        };
        let mut best: Option<(f64, std::ops::Range<usize>, std::ops::Range<usize>)> = None;
        for from in 0..stretches {
            for to in from + 1..=stretches {
                let times = from..to;
                // The best run of bands.
                let (mut sum, mut start) = (0.0, 0);
                for band in 0..bands {
                    if sum <= 0.0 {
                        (sum, start) = (0.0, band);
                    }
                    sum += of_band(band, &times);
                    if best.as_ref().is_none_or(|best| sum > best.0) {
                        best = Some((sum, times.clone(), start..band + 1));
                    }
                }
            }
        }
        let (_, times, band) = best?;
        let (mut excess, mut ratio, mut weight) = (0.0, 0.0, 0.0);
        for stretch in times.clone() {
            for at in band.clone() {
                excess += self.excess[stretch * bands + at];
                let width = self.edges_hz[at + 1] - self.edges_hz[at];
                ratio += width * self.ratio[stretch * bands + at];
                weight += width;
            }
        }
        let tiles = (times.len() * band.len()) as f64;
        let rectangles = (stretches * (stretches + 1) / 2 * (bands * (bands + 1) / 2)) as f64;
        // An excess is half of a square less its mean.
        let surprise = surprise(2.0 * excess + tiles, tiles);
        Some(Rectangle {
            p_value: (rectangles * (-surprise).exp()).min(1.0),
            band_hz: [self.edges_hz[band.start], self.edges_hz[band.end]],
            time_s: [self.edges_s[times.start], self.edges_s[times.end]],
            excess,
            ratio: ratio / weight,
        })
    }
}
