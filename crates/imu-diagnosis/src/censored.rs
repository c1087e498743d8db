//! Censored samples: samples at a limit. The law knows only that their values lie beyond the limit.

use super::filling::stream;
use super::series::{Censored, Series};
use imu_model::effects::Stream;
use statrs::distribution::{ContinuousCDF, Normal};

/// Random streams of the draws: one per purpose, so that no two are alike.
const BEYOND: u16 = 1;
const TRUNCATED: u16 = 4;

/// If a limit is this many standard deviations from a sample's mean given all others, it is out of reach.
const FAR: f64 = 4.5;

/// Returns the samples among `places` (in order) that are at a limit. `rest` are the samples less the explained part.
pub(super) fn at_limits(places: &[usize], samples: &[f64], rest: &[f64], limits: [Option<f64>; 2]) -> Vec<Censored> {
    let is = |place: usize, limit: f64| (samples[place] - limit).abs() < 1e-9 * limit.abs().max(1.0);
    let of = |place: &usize| {
        let [low, high] = limits.map(|limit| limit.is_some_and(|limit| is(*place, limit)));
        let sign = if low { -1.0 } else { 1.0 };
        (low || high).then(|| Censored { place: *place, bound: rest[*place], sign })
    };
    if limits == [None, None] { Vec::new() } else { places.iter().filter_map(of).collect() }
}

impl Series<'_> {
    /// Returns whether any samples are at a limit.
    pub(super) fn is_cut(&self) -> bool {
        !self.censored.is_empty()
    }

    /// Moves samples at a limit beyond it, where white noise about their neighbours' level would put them: a first
    /// guess.
    pub(super) fn guess_censored(&mut self, white: f64) {
        const NEAR: usize = 12;
        let n = self.rest.len();
        let mut stream = stream(n, self.setting().owner, BEYOND);
        for Censored { place, bound, sign } in self.censored.clone() {
            let near = place.saturating_sub(NEAR)..(place + NEAR + 1).min(n);
            let others = near.filter(|t| self.censored.binary_search_by_key(t, |of| of.place).is_err());
            let (sum, count) = others.fold((0.0, 0.0), |(sum, count), t| (sum + self.rest[t], count + 1.0));
            let level = if count > 0.0 { sum / count } else { bound };
            self.rest[place] = truncated(&mut stream, [level, white], bound, sign);
        }
    }

    /// Draws the samples at a limit from their distribution under the law, given all other samples and given that they lie beyond
    /// the limit. The method is Gibbs sampling (Geweke 1991, Computing Science and Statistics 23): each sample is drawn given all
    /// others, in several sweeps.
    ///
    /// The law's precision matrix is that of a cosine transform: a function of the distance, reflected at the ends.
    pub(super) fn draw_censored(&mut self) {
        const SWEEPS: usize = 12;
        const REACH: usize = 1024;
        /// Approximate number of pairs of samples that a sweep uses. If very many samples are cut off, it uses only
        /// near pairs.
        const PAIRS: usize = 40_000_000;
        /// Part of the kernel's sum of absolute values that may be left out.
        const LEFT: f64 = 1e-3;
        let (n, count) = (self.len(), self.censored.len());
        if count == 0 || count * 3 > n || self.spectrum.len() != n {
            return;
        }
        let mut kernel = self.kernel((PAIRS / (2 * count)).clamp(16, REACH));
        let mut left = kernel.iter().map(|value| value.abs()).sum::<f64>() * LEFT;
        while kernel.len() > 1 && left > kernel[kernel.len() - 1].abs() {
            left -= kernel.pop().unwrap_or_default().abs();
        }
        let at = |distance: usize| kernel.get(distance).copied().unwrap_or_default();
        let entry = |i: usize, j: usize| at(i.abs_diff(j)) + at(i + j + 1) + at(2 * n - 1 - i - j);
        let mut image = self.rest.clone();
        self.precise(&mut image);
        let mut gradient: Vec<f64> = self.censored.iter().map(|of| image[of.place]).collect();
        let mut stream = stream(n, self.setting().owner, TRUNCATED);
        for _ in 0..SWEEPS {
            for own in 0..count {
                let Censored { place, bound, sign } = self.censored[own];
                let precision = entry(place, place);
                if precision.is_nan() || precision <= 0.0 {
                    continue;
                }
                let now = self.rest[place];
                let spread = precision.sqrt().recip();
                let mean = now - gradient[own] / precision;
                if sign * (bound - mean) > FAR * spread {
                    // Given all others, this sample is not beyond the limit: the other samples have to move first.
                    continue;
                }
                let drawn = truncated(&mut stream, [mean, spread], bound, sign);
                let change = drawn - now;
                self.rest[place] = drawn;
                let first = self.censored[..own].partition_point(|of| of.place + kernel.len() <= place);
                let near = self.censored[first..].iter().take_while(|of| of.place < place + kernel.len());
                for (other, value) in near.zip(&mut gradient[first..]) {
                    *value += change * entry(place, other.place);
                }
            }
        }
    }

    /// Returns the law's precision matrix by distance, up to one below `reach`, in the middle of the record.
    pub(super) fn kernel(&mut self, reach: usize) -> Vec<f64> {
        let n = self.len();
        let mut impulse = vec![0.0; n];
        impulse[n / 2] = 1.0;
        self.precise(&mut impulse);
        impulse[n / 2..(n / 2 + reach).min(n)].to_vec()
    }

    /// Multiplies values by the law's precision matrix.
    pub(super) fn precise(&mut self, values: &mut [f64]) {
        self.transform.forward(values);
        values.iter_mut().zip(&self.spectrum).for_each(|(c, s)| *c /= s);
        self.transform.backward(values);
    }
}

/// Draws from a normal distribution (mean, standard deviation) beyond a bound.
fn truncated(stream: &mut Stream, [mean, spread]: [f64; 2], bound: f64, sign: f64) -> f64 {
    let normal = Normal::standard();
    let from = sign * (bound - mean) / spread;
    if from.is_nan() {
        return bound;
    }
    let below = normal.cdf(from);
    let share = below + (1.0 - below) * stream.uniform();
    let z = normal.inverse_cdf(share.clamp(1e-12, 1.0 - 1e-12)).max(from);
    mean + sign * spread * z
}
