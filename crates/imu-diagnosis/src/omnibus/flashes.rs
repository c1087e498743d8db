//! Flashes: power in a few coefficients of a short stretch, once or several times.

use crate::series::Series;
use crate::transform::Cosines;

/// Lengths of the stretches, samples.
const LENGTHS: [usize; 4] = [64, 192, 512, 2048];
/// Maximum number of summed flashes.
const MOST: usize = 64;

/// Returns how surprising the number of pairs of coefficients above the most conspicuous threshold is, nats (Berk and
/// Jones 1979, Z. Wahrsch. verw. Gebiete 47, for the tail alone).
pub(super) fn brightest(series: &Series<'_>) -> f64 {
    LENGTHS.into_iter().map(|length| of(&series.residual, length)).fold(0.0, f64::max)
}

fn of(residual: &[f64], length: usize) -> f64 {
    if residual.len() < 8 * length {
        return 0.0;
    }
    let mut transform = Cosines::new(length);
    // Chance exceeds this value in about a hundred places; smaller values are not worth a place in the list.
    let tiles = residual.len() as f64;
    let least = (0.01 * tiles).ln().max(2.0);
    let mut nats: Vec<f64> = Vec::new();
    for start in [0, length / 2] {
        for stretch in residual[start..].chunks_exact(length) {
            let mut values = stretch.to_vec();
            transform.forward(&mut values);
            let pairs = values[1..].chunks_exact(2);
            // The chance that two squares are above x is exp(−x/2).
            nats.extend(pairs.map(|pair| 0.5 * (pair[0] * pair[0] + pair[1] * pair[1])).filter(|nats| *nats > least));
        }
    }
    nats.sort_unstable_by(|a, b| b.total_cmp(a));
    let surprise = |(rank, nats): (usize, &f64)| {
        let (count, expected) = ((rank + 1) as f64, tiles * (-nats).exp());
        if count > expected { count * (count / expected).ln() - count + expected } else { 0.0 }
    };
    nats.iter().take(MOST).enumerate().map(surprise).fold(0.0, f64::max)
}
