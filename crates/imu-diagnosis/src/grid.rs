//! The grid: frequencies of a transformed record in bins that are narrow where a spectrum may be narrow.

use imu_model::effects::Frequencies;

/// Coefficients 1 to n − 1 of a record of n samples, in bins: single coefficients first, then bins of a constant ratio,
/// at most a 320th of the band wide, with finer bins around lines.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// The number of samples in the record.
    pub(super) samples: usize,
    /// First coefficient of each bin, and one past the last.
    pub(super) edges: Vec<usize>,
    /// The number of coefficients in each bin.
    pub(super) counts: Vec<f64>,
    frequencies: Frequencies,
}

/// A line that the grid has to resolve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Narrow {
    /// The line's centre, Hz.
    pub frequency_hz: f64,
    /// The line's full width, Hz.
    pub width_hz: f64,
}

impl Grid {
    /// Number of first coefficients with a bin of their own.
    const SINGLE: usize = 256;
    /// Bins per decade.
    const PER_DECADE: f64 = 28.0;
    /// Minimum number of bins over the whole band.
    const BAND: usize = 320;
    /// Number of line widths on each side of a line with finer bins, and number of bins per width.
    const AROUND: f64 = 25.0;
    const IN_WIDTH: f64 = 5.0;
    /// Minimum number of coefficients in a finer bin: a narrower line is a tone.
    const LEAST: usize = 4;
    /// From this coefficient on, this many are filled in at a time.
    const DENSE: usize = 4096;
    const RUN: usize = 8;

    /// Creates a grid for records of `samples` (at least 2) at `rate_hz`.
    pub fn new(samples: usize, rate_hz: f64, lines: &[Narrow]) -> Self {
        let n = samples.max(2);
        let first = Self::SINGLE.min(n - 1);
        let mut edges: Vec<usize> = (1..=first).collect();
        let ratio = 10f64.powf(1.0 / Self::PER_DECADE);
        let mut next = first as f64;
        while (next as usize) < n {
            next *= ratio;
            edges.push(next as usize);
        }
        edges.extend((first..n).step_by((n / Self::BAND).max(1)));
        for line in lines {
            let per_hz = 2.0 * n as f64 / rate_hz;
            let reach = Self::AROUND * line.width_hz;
            let step = ((line.width_hz * per_hz / Self::IN_WIDTH) as usize).max(Self::LEAST);
            let from = ((line.frequency_hz - reach) * per_hz).max(first as f64) as usize;
            let to = (((line.frequency_hz + reach) * per_hz).max(0.0) as usize).min(n - 1);
            edges.extend((from..to.max(from)).step_by(step));
        }
        edges.push(n);
        edges.sort_unstable();
        edges.dedup();
        edges.retain(|edge| (1..=n).contains(edge));
        let spans = edges.windows(2);
        let counts: Vec<f64> = spans.clone().map(|span| (span[1] - span[0]) as f64).collect();
        let middle = |span: &[usize]| 0.5 * (span[0] + span[1] - 1) as f64 * rate_hz / (2.0 * n as f64);
        let frequencies = Frequencies::new(spans.map(middle).collect(), rate_hz);
        Self { samples: n, edges, counts, frequencies }
    }

    /// Returns the samples per second.
    pub fn rate_hz(&self) -> f64 {
        self.frequencies.rate_hz()
    }

    /// Returns the mean frequency of each bin, Hz.
    pub fn frequencies_hz(&self) -> &[f64] {
        self.frequencies.hz()
    }

    /// Returns the mean frequencies with their trigonometry.
    pub fn frequencies(&self) -> &Frequencies {
        &self.frequencies
    }

    /// Returns the mean square of the coefficients in each bin.
    pub fn power(&self, coefficients: &[f64]) -> Vec<f64> {
        let mean = |span: &[usize]| {
            let of = coefficients.get(span[0]..span[1]).unwrap_or_default();
            of.iter().map(|c| c * c).sum::<f64>() / of.len().max(1) as f64
        };
        self.edges.windows(2).map(mean).collect()
    }

    /// Returns a spectrum's value at every coefficient 0 to n − 1 from its logarithms at the bins' frequencies, by
    /// linear interpolation in both logarithms. The value of the constant is infinite, because a record's mean is
    /// unknown.
    pub fn fill(&self, logarithms: &[f64]) -> Vec<f64> {
        self.fill_first(logarithms, self.samples)
    }

    /// Returns the values of [`Grid::fill`] at the first `count` coefficients.
    pub fn fill_first(&self, logarithms: &[f64], count: usize) -> Vec<f64> {
        let n = count.min(self.samples);
        let mut values = vec![f64::INFINITY; n];
        let places: Vec<f64> = self.edges.windows(2).map(|span| 0.5 * (span[0] + span[1] - 1) as f64).collect();
        let mut bin = 0;
        let mut k = 1;
        while k < n {
            if bin + 1 < places.len() && self.counts[bin] == 1.0 && self.edges[bin] == k {
                values[k] = logarithms[bin].exp();
                bin += usize::from(self.edges[bin + 1] == k + 1 && self.counts[bin + 1] == 1.0);
                k += 1;
                continue;
            }
            while bin + 2 < places.len() && places[bin + 1] < k as f64 {
                bin += 1;
            }
            let next = (bin + 1).min(places.len() - 1);
            let (from, to) = (places[bin], places[next]);
            let slope = if to > from { (logarithms[next] - logarithms[bin]) / (to / from).ln() } else { 0.0 };
            let last = 1.5 * (logarithms[next] - logarithms[bin]);
            let at = |k: usize| {
                let rise = slope * (k as f64 / from).ln();
                logarithms[bin] + if rise.abs() > last.abs() { last } else { rise }
            };
            let whole = k >= Self::DENSE && k + Self::RUN <= n && (k + Self::RUN) as f64 <= to;
            if whole {
                // Interpolation in k is accurate enough in place of ln k over so small a range.
                let start = at(k);
                let step = ((at(k + Self::RUN) - start) / Self::RUN as f64).exp();
                let mut value = start.exp();
                for place in &mut values[k..k + Self::RUN] {
                    *place = value;
                    value *= step;
                }
                k += Self::RUN;
            } else {
                values[k] = at(k).exp();
                k += 1;
            }
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_hold_every_coefficient_once() {
        for n in [2usize, 3, 10, 257, 1000, 65_537] {
            let line = Narrow { frequency_hz: 13.4, width_hz: 0.02 };
            let grid = Grid::new(n, 40.0, &[line]);
            assert_eq!((grid.edges[0], *grid.edges.last().unwrap()), (1, n));
            assert_eq!(grid.counts.iter().sum::<f64>(), (n - 1) as f64);
            let coefficients: Vec<f64> = (0..n).map(|k| k as f64).collect();
            let total: f64 = grid.power(&coefficients).iter().zip(grid.counts).map(|(p, c)| p * c).sum();
            let expected: f64 = coefficients.iter().map(|c| c * c).sum();
            assert!((total / expected - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_power_law_is_filled_in_exactly() {
        for n in [300usize, 5001, 65_536] {
            let grid = Grid::new(n, 40.0, &[Narrow { frequency_hz: 3.0, width_hz: 0.5 }]);
            let logarithms: Vec<f64> = grid.frequencies_hz().iter().map(|f| -2.0 * f.ln() + 1.0).collect();
            for (k, value) in grid.fill(&logarithms).into_iter().enumerate().skip(1) {
                let expected = (k as f64 * 40.0 / (2 * n) as f64).powi(-2) * 1f64.exp();
                assert!((value / expected - 1.0).abs() < 2e-6, "n {n} k {k}: {value} {expected}");
            }
        }
    }
}
