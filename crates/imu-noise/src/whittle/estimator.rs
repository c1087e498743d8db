//! The estimator: turns samples of one channel into spectral sums, stretch by stretch, in bounded memory.

use super::dst::{Transform, efficient_length};
use super::sums::{Bin, DstSums, edge, fine_edge, fine_index_of, index_of};
use crate::allan::FixedPoint;
use std::f64::consts::PI;

/// Folds the samples of one channel into [`DstSums`].
///
/// A stretch without a gap is transformed as a whole up to [`DstEstimator::CHUNK`] samples. It is cut only if its
/// length would transform slowly (less than 1 % is then transformed separately). A longer stretch is transformed chunk
/// by chunk for the frequencies that a chunk resolves, and as a whole, averaged over 64 samples or more, for the lowest
/// frequencies. Only for the lowest frequencies, the end of the stretch is lost: up to 2 % of it, for a length that
/// transforms fast, and the samples that do not fill the last mean. A channel needs at most 9.4 MB for any length.
#[derive(Debug, Clone)]
pub struct DstEstimator {
    sums: DstSums,
    /// Larger values are not measurements and end a stretch, as for Allan sums.
    range: f64,
    /// Samples of the open stretch that were not transformed yet.
    buffer: Vec<f64>,
    /// The averaged open stretch, once it is longer than a chunk.
    low: Option<Averaged>,
    /// Number of samples in the open stretch.
    open: u64,
}

impl DstEstimator {
    /// Number of samples transformed at a time: 7 h at 40 Hz, 22 min at 800 Hz.
    pub const CHUNK: usize = 1 << 20;
    /// Frequencies below this k of a chunk come from the averaged stretch.
    const FIRST_OF_CHUNK: usize = 16;
    /// Minimum length of a piece: shorter ones carry less information than their ends cost.
    const SHORTEST: usize = 16;

    /// Creates an estimator without samples; `scale` is that of the channel's Allan sums, so that both refuse the same
    /// values.
    pub fn new(scale: FixedPoint) -> Self {
        Self::resume(scale, DstSums::new())
    }

    /// Continues at the beginning of a stretch with the earlier result of [`Self::sums`]: samples of a stretch that was
    /// open then are pushed again.
    pub fn resume(scale: FixedPoint, sums: DstSums) -> Self {
        Self { sums, range: scale.range(), buffer: Vec::new(), low: None, open: 0 }
    }

    /// Returns the memory of a channel whose longest stretch has that many samples, in bytes.
    pub fn bytes(longest: usize) -> usize {
        let low = if longest > Self::CHUNK { 8 * Averaged::MOST } else { 0 };
        8 * longest.min(Self::CHUNK) + low
    }

    /// Reserves memory for a stretch of that many samples at once.
    pub fn reserve(&mut self, samples: usize) {
        self.buffer.reserve_exact(samples.min(Self::CHUNK).saturating_sub(self.buffer.len()));
    }

    /// Takes the next samples of the stretch, in the channel's unit; a sample that is not finite or out of range ends
    /// it.
    pub fn push(&mut self, transform: &mut Transform, samples: &[f64]) {
        let range = self.range;
        let refused = |value: &f64| value.is_nan() || value.abs() > range;
        for part in samples.split_inclusive(refused) {
            let (taken, ends) = match part.split_last() {
                Some((last, rest)) if refused(last) => (rest, true),
                _ => (part, false),
            };
            self.take(transform, taken);
            if ends {
                self.sums.count_out_of_range();
                self.break_segment(transform);
            }
        }
    }

    fn take(&mut self, transform: &mut Transform, mut samples: &[f64]) {
        self.open += samples.len() as u64;
        while !samples.is_empty() {
            if self.buffer.len() == Self::CHUNK {
                let low = self.low.get_or_insert_with(Averaged::new);
                low.push(&self.buffer);
                transform_piece(&mut self.sums, transform, &self.buffer, 1, Band::ABOVE);
                self.buffer.clear();
            }
            let (now, later) = samples.split_at(samples.len().min(Self::CHUNK - self.buffer.len()));
            self.buffer.extend_from_slice(now);
            samples = later;
        }
    }

    /// Ends the stretch: at a gap, or at data that no transform may span.
    pub fn break_segment(&mut self, transform: &mut Transform) {
        let band = match self.low.take() {
            Some(mut low) => {
                low.push(&self.buffer);
                let length = efficient_length(low.values.len());
                let values = low.values.get(..length).unwrap_or_default();
                transform_piece(&mut self.sums, transform, values, low.per_value, Band::BELOW);
                Band::ABOVE
            }
            None => Band::ALL,
        };
        let mut rest: &[f64] = &self.buffer;
        while rest.len() >= Self::SHORTEST {
            let (piece, left) = rest.split_at(efficient_length(rest.len()));
            transform_piece(&mut self.sums, transform, piece, 1, band);
            rest = left;
        }
        self.buffer.clear();
        self.sums.count_samples(self.open);
        self.open = 0;
    }

    /// Returns the number of samples in the stretch that has not ended.
    pub fn open_samples(&self) -> u64 {
        self.open
    }

    /// Returns the sums of the stretches that have ended.
    pub fn sums(&self) -> &DstSums {
        &self.sums
    }

    /// Ends the stretch and returns the sums.
    pub fn into_sums(mut self, transform: &mut Transform) -> DstSums {
        self.break_segment(transform);
        self.sums
    }
}

/// The frequencies of a piece that are used: u above the first and up to the second.
#[derive(Debug, Clone, Copy)]
struct Band(f64, f64);

impl Band {
    const SPLIT: f64 = DstEstimator::FIRST_OF_CHUNK as f64 / (2 * DstEstimator::CHUNK) as f64;
    const ALL: Self = Self(0.0, 0.5);
    const ABOVE: Self = Self(Self::SPLIT, 0.5);
    const BELOW: Self = Self(0.0, Self::SPLIT);
}

/// Returns the ratio of flicker's variance of z_k to λ_k = 4 sin²(πu)·S: the spectrum of flicker's differences rises
/// with f, not f², and leakage from higher frequencies is not compensated at the first few k.
///
/// # Source
/// The ratio of ∫ x (1 ∓ cos πx) / (x² − k²)² dx to its value for white noise (x²); the series' first term is 2/(π²k).
fn flicker_leakage(k: usize) -> f64 {
    match k {
        1 => 0.773_70,
        2 => 0.902_82,
        3 => 0.931_09,
        4 => 0.949_94,
        _ => 1.0 - 2.0 / (PI * PI * k as f64),
    }
}

/// Adds a piece whose values are means over `per_value` samples.
fn transform_piece(sums: &mut DstSums, transform: &mut Transform, values: &[f64], per_value: usize, band: Band) {
    let n = values.len();
    let (length, per) = (2.0 * n as f64 * per_value as f64, per_value as f64);
    let (mut index, mut upper, mut bin) = (usize::MAX, 0.0, Bin::default());
    let (mut fine_index, mut fine_upper, mut fine) = (usize::MAX, 0.0, Bin::default());
    // The spectrum of means is the same at low frequencies, their sampling interval is longer, and the ramp climbs more
    // from one mean to the next.
    transform.differences(values, |k, z, sine_squared, constant| {
        let u = k as f64 / length;
        if u <= band.0 || u > band.1 {
            return;
        }
        // k ascends.
        if u > upper {
            sums.add(index, &bin);
            index = index_of(u);
            (upper, bin) = (edge(index), Bin::default());
        }
        if u > fine_upper {
            sums.add_fine(fine_index, &fine);
            let next = fine_index_of(u);
            (fine_index, fine) = (next.unwrap_or(usize::MAX), Bin::default());
            fine_upper = fine_edge(next.map_or(0, |next| next + 1));
        }
        let walk = 1.0 / (4.0 * sine_squared);
        let own = if per_value == 1 { 4.0 * sine_squared } else { (2.0 * PI * u).powi(2) };
        let one = Bin {
            count: 1.0,
            power: z * z * walk * per,
            flicker: flicker_leakage(k) / (2.0 * PI * u),
            walk: 1.0 / own,
            angle: own,
            ends: 2.0 / length,
            cross: z * constant * walk * per * per,
            ramp: constant * constant * walk * per * per * per,
        };
        bin.add(&one);
        fine.add(&one);
    });
    sums.add(index, &bin);
    sums.add_fine(fine_index, &fine);
}

/// Transforms a stretch of any length at once, for comparison.
#[cfg(test)]
pub(super) fn transform_whole(sums: &mut DstSums, transform: &mut Transform, values: &[f64]) {
    transform_piece(sums, transform, values, 1, Band::ALL);
}

/// A long stretch, averaged over so many samples that it stays short.
#[derive(Debug, Clone)]
struct Averaged {
    per_value: usize,
    values: Vec<f64>,
    sum: f64,
    count: usize,
}

impl Averaged {
    /// Number of samples in the first mean: the wanted frequencies lie a thousand times below half the means' rate.
    const FIRST: usize = 64;
    /// Maximum number of means; then two become one.
    const MOST: usize = 1 << 17;

    fn new() -> Self {
        Self { per_value: Self::FIRST, values: Vec::new(), sum: 0.0, count: 0 }
    }

    fn push(&mut self, samples: &[f64]) {
        for sample in samples {
            self.sum += sample;
            self.count += 1;
            if self.count == self.per_value {
                self.values.push(self.sum / self.per_value as f64);
                (self.sum, self.count) = (0.0, 0);
                if self.values.len() == Self::MOST {
                    self.values = self.values.chunks_exact(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
                    self.per_value *= 2;
                }
            }
        }
    }
}
