//! Dither: white noise that is added to samples, and that the law includes.

use super::averages::scale_of;
use super::filling::stream;
use super::prepared::Prepared;

/// Random stream of the added noise.
const DITHER: u16 = 6;

/// Adds as much white noise to samples as the excluded samples, or the ends, hide behind a filter with a zero. `there`
/// are the present samples, U; `white` is the declared deviation of the white noise before filters, U.
///
/// A filter's zero that goes as x⁴ near half the rate, known down to a density q, is q^¼ wide. An excluded sample has
/// an independent error at all frequencies. With m runs of such samples in n samples, the record therefore does not
/// show a density below about (m/n)⁴: neither its value, nor the values of the samples. Added noise of known density
/// removes both questions. The ends of a record, which the transform mirrors, raise the same questions for filters that
/// pass almost nothing over a good part of the band.
pub(super) fn dither(of: &mut Prepared, there: &[f64], white: f64) {
    const TIMES: f64 = 10.0;
    /// Below the smallest, the values that replace the samples are too far from the visible values for floating-point
    /// numbers.
    const SHARES: [f64; 2] = [1e-4, 1e-2];
    const BLOCK: usize = 8;
    /// If all samples at the ends of a record are present, the ends are known to this part of the noise before filters.
    const ENDS: f64 = 1e-11;
    let runs =
        of.outliers.iter().enumerate().filter(|(at, place)| *at == 0 || of.outliers[at - 1] + 1 != **place).count();
    // White noise before a filter is white at low frequencies.
    let means: Vec<f64> = there.chunks_exact(BLOCK).map(|block| block.iter().sum::<f64>() / BLOCK as f64).collect();
    let white = white.min((BLOCK as f64).sqrt() * scale_of(&means)) / of.scale;
    let share = match runs {
        0 => ENDS,
        _ => (TIMES * runs as f64 / of.samples.len() as f64).powi(4).clamp(SHARES[0], SHARES[1]),
    };
    let rounding = of.step.map_or(0.0, |step| (step / of.scale).powi(2) / 12.0);
    of.dither = (share * white * white - rounding).max(0.0);
    let mut stream = stream(of.samples.len(), of.channel as u32, DITHER);
    let deviation = of.dither.sqrt();
    for (place, sample) in of.samples.iter_mut().enumerate() {
        let added = deviation * stream.normal();
        if of.outliers.binary_search(&place).is_err() {
            *sample += added;
        }
    }
}
