//! Rectangles: runs of stretches and bands, whose sides are powers of 2, in which a residual is louder or quieter than
//! expected.

use crate::series::Series;
use crate::tiles::{self, excess, surprise};
use statrs::function::gamma::digamma;

/// Coefficients in a tile.
const WIDE: usize = 16;
/// Numbers of stretches into which a record is cut.
const STRETCHES: [usize; 2] = [32, 256];
/// Widest rectangle, bands.
const BANDS: usize = 256;

/// Returns −ln of the chance of the most conspicuous rectangle, without the number of rectangles: all whose sides are
/// powers of 2 times a tile's.
pub(super) fn heaviest(series: &Series<'_>) -> f64 {
    STRETCHES.into_iter().map(|stretches| of(series, stretches)).fold(0.0, f64::max)
}

fn of(series: &Series<'_>, stretches: usize) -> f64 {
    let size = series.len() / stretches;
    let bands = size / WIDE;
    if bands < 2 {
        return 0.0;
    }
    let edges: Vec<usize> = (0..=bands).map(|band| (band * WIDE).max(1)).collect();
    // Twice the nats of a tile are about a square of a standard normal value, with this factor (Bartlett).
    let half = 0.5 * WIDE as f64;
    let mean = half * (half.ln() - digamma(half));
    let mut squares: Vec<f64> = Vec::with_capacity(stretches * bands);
    tiles::each(series, stretches, &edges, |ratio, count| {
        squares.push((excess(ratio, count as f64) + mean).max(0.0) / mean);
    });
    let (mut rows, mut columns) = (stretches, bands);
    let mut worst = 0.0f64;
    let mut high = 1;
    let mut by_time = squares;
    loop {
        let mut by_band = by_time.clone();
        let (mut wide, mut across) = (1, columns);
        loop {
            let most = by_band.iter().copied().fold(0.0, f64::max);
            worst = worst.max(surprise(most, (high * wide) as f64));
            if across < 2 || wide >= BANDS {
                break;
            }
            by_band = by_band
                .chunks_exact(across)
                .flat_map(|row| row.chunks_exact(2).map(|pair| pair[0] + pair[1]))
                .collect();
            across /= 2;
            wide *= 2;
        }
        if rows < 2 {
            return worst;
        }
        by_time = by_time
            .chunks_exact(2 * columns)
            .flat_map(|pair| {
                let (first, second) = pair.split_at(columns);
                first.iter().zip(second).map(|(a, b)| a + b).collect::<Vec<f64>>()
            })
            .collect();
        rows /= 2;
        high *= 2;
        columns = columns.max(1);
    }
}
