//! Sweep: power along straight lines of a spectrogram, as from a line of moving frequency.

use crate::series::Series;
use crate::tiles::{self, surprise};

/// Stretches of the spectrogram, a power of 2.
const STRETCHES: usize = 256;
/// How often neighbouring frequencies are pooled, so that steeper lines show.
const POOLINGS: usize = 5;

/// Returns −ln of the chance of the most conspicuous line, without the number of lines.
pub(super) fn steepest(series: &Series<'_>) -> f64 {
    let size = series.len() / STRETCHES;
    if size < 64 {
        return 0.0;
    }
    let edges: Vec<usize> = (1..=size).collect();
    let mut bands = size - 1;
    let mut picture: Vec<f64> = Vec::with_capacity(STRETCHES * bands);
    tiles::each(series, STRETCHES, &edges, |square, _| picture.push(square.min(40.0) - 1.0));
    let mut pooled = 1;
    let mut worst = 0.0f64;
    for _ in 0..POOLINGS {
        let backward: Vec<f64> = picture.chunks_exact(bands).flat_map(|row| row.iter().rev().copied()).collect();
        let most = greatest(&picture, bands).max(greatest(&backward, bands));
        let squares = (STRETCHES * pooled) as f64;
        worst = worst.max(surprise(most + squares, squares));
        if bands < 32 {
            break;
        }
        picture =
            picture.chunks_exact(bands).flat_map(|row| row.chunks_exact(2).map(|pair| pair[0] + pair[1])).collect();
        bands /= 2;
        pooled *= 2;
    }
    worst
}

/// Returns the greatest sum along a line that rises by 0 to one band less than the picture has rows: a discrete Radon
/// transform by halves (Brady 1998, SIAM J. Comput. 27). Points beyond the picture add 0.
fn greatest(picture: &[f64], bands: usize) -> f64 {
    let rows = picture.len() / bands;
    // Sums of strips of `high` rows: for each strip and rise the bands one after the other.
    let mut sums = picture.to_vec();
    let mut high = 1;
    while high < rows {
        let mut next = Vec::with_capacity(sums.len());
        for strips in sums.chunks_exact(2 * high * bands) {
            let (first, second) = strips.split_at(high * bands);
            for rise in 0..2 * high {
                let (half, up) = (rise / 2, rise.div_ceil(2));
                let (a, b) = (&first[half * bands..(half + 1) * bands], &second[half * bands..(half + 1) * bands]);
                let shifted = b.iter().skip(up).copied().chain(std::iter::repeat_n(0.0, up.min(bands)));
                next.extend(a.iter().zip(shifted).map(|(a, b)| a + b));
            }
        }
        sums = next;
        high *= 2;
    }
    sums.into_iter().fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_any_rise_is_summed_whole() {
        let (rows, bands) = (16, 40);
        for rise in [0usize, 1, 7, 15] {
            let mut picture = vec![0.0; rows * bands];
            // Draws the lines of the transform: each half rises by half.
            fn draw(picture: &mut [f64], bands: usize, row: usize, high: usize, band: usize, rise: usize) {
                if high == 1 {
                    picture[row * bands + band] = 1.0;
                } else {
                    draw(picture, bands, row, high / 2, band, rise / 2);
                    draw(picture, bands, row + high / 2, high / 2, band + rise.div_ceil(2), rise / 2);
                }
            }
            draw(&mut picture, bands, 0, rows, 3, rise);
            assert_eq!(greatest(&picture, bands), 16.0, "{rise}");
        }
    }
}
