//! The omnibus: whether a residual is white, normal and stationary, without reference to a particular alternative.

pub(super) mod component;
pub(super) mod crosstalk;
mod flashes;
mod rectangles;
mod sweep;

use super::plans;
use super::series::Series;
use super::tail::with_tails;
use super::tiles::{Tiles, excess, surprise};

with_tails! {
    /// A statistic of a residual: about −ln of the chance of a larger value, up to an offset that depends on the record's
    /// length.
    Statistic;
    /// Returns the property that the statistic tests, for people.
    meaning -> &'static str;
    /// Fourth moment of single samples.
    Kurtosis: "tails of single samples", [-0.5, -0.5, -0.5], 1.0;
    /// Third moment of single samples.
    Skewness: "asymmetry of single samples", [-0.4, -0.4, -0.4], 1.1;
    /// Variance in tiles of time and octave, in total.
    Tiles: "power that varies over time and frequency", [0.0, 0.0, 0.0], 1.15;
    /// Variance in the most conspicuous tile.
    Tile: "power in one stretch of one octave", [3.9, 4.2, 4.5], 1.1;
    /// Variance in the most conspicuous octave.
    Octave: "power in one octave", [2.7, 2.8, 3.4], 1.1;
    /// Variance in the most conspicuous stretch.
    Stretch: "power in one stretch of time", [3.5, 3.3, 3.3], 1.15;
    /// Fourth moment within octaves.
    OctaveKurtosis: "values of an octave that are not normal", [-0.3, -0.3, -0.2], 1.1;
    /// Clustering of the power within octaves.
    Clusters: "power of an octave that comes in bursts", [0.0, 0.4, 0.4], 1.65;
    /// Power in the most conspicuous of the finest bands.
    FineBand: "power in a narrow band", [2.9, 4.9, 7.2], 1.1;
    /// Power in the finest bands, in total.
    FineBands: "power in many narrow bands", [-0.5, -0.5, -0.5], 1.2;
    /// A period in the squares.
    Modulation: "noise whose level has a period", [8.1, 10.3, 12.8], 1.1;
    /// The greatest autocorrelation.
    Echo: "an echo: samples that resemble those a while before", [6.2, 8.3, 8.4], 1.1;
    /// Variance in the most conspicuous rectangle of time and frequency, of many sizes.
    Rectangle: "power that comes and goes or wanders in a band", [7.5, 9.8, 11.9], 1.15;
    /// Third and fourth moments of the most probable course of a spectral term of the law.
    Component: "what looks like a process by its spectrum is not normal: it jumps, or keeps its amplitude",
        [0.0, 0.0, 0.0], 1.3;
    /// A value that is far more frequent than its neighbours.
    Atom: "one value is met far more often than those beside it", [0.0, 0.0, 0.0], 1.0;
    /// Power along the most conspicuous straight line of a spectrogram.
    Sweep: "a line whose frequency moves", [9.5, 11.7, 13.9], 1.1;
    /// Power in a few coefficients of short stretches.
    Flashes: "short flashes of narrow bands", [1.2, 1.3, 1.5], 1.3;
    /// The greatest correlation with another channel some samples earlier or later.
    Crosstalk: "samples that resemble another channel's a while before", [7.1, 8.3, 8.6], 1.15;
}

impl Statistic {
    /// Returns whether stationary noise with parts that come, go or wander may show the statistic.
    pub fn is_of_changes(self) -> bool {
        !matches!(self, Self::Skewness | Self::Atom | Self::Crosstalk | Self::Echo)
    }

    /// Returns whether the statistic tests the distribution of single samples, which rounding, limits and tails change.
    pub fn is_marginal(self) -> bool {
        matches!(self, Self::Kurtosis | Self::OctaveKurtosis)
    }
}

/// Returns all statistics of a series' residual; `atom` is that of its values as they were sent, `parts` are those whose courses
/// must look normal.
pub(super) fn statistics(series: &mut Series<'_>, atom: f64, parts: &[component::Part]) -> Vec<(Statistic, f64)> {
    let mut found = Vec::with_capacity(Statistic::ALL.len());
    found.push((Statistic::Atom, atom));
    found.push((Statistic::Skewness, skewness(series.innovations())));
    found.push((Statistic::Component, component::worst(parts)));
    series.residual = series.scores().into_owned();
    let residual = series.residual.clone();
    let count = residual.len() as f64;
    let fourth: f64 = residual.iter().map(|e| e.clamp(-8.0, 8.0).powi(4)).sum();
    found.push((Statistic::Kurtosis, half_square((fourth / count - 3.0) * (count / 96.0).sqrt())));
    tiles(&Tiles::of(series), &mut found);
    found.push((Statistic::Rectangle, rectangles::heaviest(series)));
    found.push((Statistic::Sweep, sweep::steepest(series)));
    found.push((Statistic::Flashes, flashes::brightest(series)));
    octaves(series, &mut found);
    bands(series, &mut found);
    periodic(&residual, &mut found);
    found
}

fn half_square(z: f64) -> f64 {
    0.5 * z * z
}

/// Returns whether values on one side of 0 are larger than on the other, for any symmetric distribution: the sum of a
/// cubic that is orthogonal to the values, over the root of its sum of squares.
fn skewness(residual: &[f64]) -> f64 {
    const LARGEST: f64 = 5.0;
    let limited = || residual.iter().map(|e| e.clamp(-LARGEST, LARGEST));
    let (second, fourth) = limited().fold((0.0, 0.0), |(s, f), e| (s + e * e, f + e.powi(4)));
    let slope = fourth / second.max(f64::MIN_POSITIVE);
    let cubic = |e: f64| e.powi(3) - slope * e;
    let (sum, square) = limited().map(cubic).fold((0.0, 0.0), |(s, q), c| (s + c, q + c * c));
    if square > 0.0 { half_square(sum / square.sqrt()) } else { 0.0 }
}

fn tiles(tiles: &Tiles, found: &mut Vec<(Statistic, f64)>) {
    let stretches = tiles.edges_s.len() - 1;
    let bands = tiles.edges_hz.len() - 1;
    if bands == 0 {
        return;
    }
    let table = &tiles.excess;
    // An excess is half of a square, less its mean.
    let sum = |of: &mut dyn Iterator<Item = usize>| {
        let (square, count) = of.fold((0.0, 0.0), |(s, c), at| (s + 2.0 * table[at] + 1.0, c + 1.0));
        surprise(square, count)
    };
    found.push((Statistic::Tiles, sum(&mut (0..table.len()))));
    found.push((Statistic::Tile, table.iter().copied().fold(0.0, f64::max)));
    let octave = |band: usize| sum(&mut (0..stretches).map(|block| block * bands + band));
    found.push((Statistic::Octave, (0..bands).map(octave).fold(0.0, f64::max)));
    let stretch = |block: usize| sum(&mut (0..bands).map(|band| block * bands + band));
    found.push((Statistic::Stretch, (0..stretches).map(stretch).fold(0.0, f64::max)));
}

/// Examines octaves of the whitened coefficients: the moments and the clustering of each one's course in time.
fn octaves(series: &mut Series<'_>, found: &mut Vec<(Statistic, f64)>) {
    const LAGS: [usize; 3] = [4, 16, 64];
    let n = series.len();
    let mut residual = series.residual.clone();
    series.transform.forward(&mut residual);
    let whitened = residual;
    let (mut kurtosis, mut clusters) = (0.0f64, 0.0f64);
    let mut to = n;
    while to > 512 {
        let from = to / 2;
        // Half the band at its own rate: a transform of shorter length brings the octave to the base band.
        let mut values = whitened[from..to].to_vec();
        let mut own = super::transform::Cosines::new(values.len());
        own.backward(&mut values);
        let count = values.len() as f64;
        let variance = values.iter().map(|x| x * x).sum::<f64>() / count;
        let fourth = values.iter().map(|x| (x * x / variance).min(36.0).powi(2)).sum::<f64>() / count;
        kurtosis = kurtosis.max(0.5 * ((fourth - 3.0) * (count / 96.0).sqrt()).powi(2));
        let squares: Vec<f64> = values.iter().map(|x| (x * x / variance).min(25.0)).collect();
        let mean = squares.iter().sum::<f64>() / count;
        let spread = squares.iter().map(|q| (q - mean).powi(2)).sum::<f64>() / count;
        let mut sums = vec![0.0; squares.len() + 1];
        for (at, square) in squares.iter().enumerate() {
            sums[at + 1] = sums[at] + square - mean;
        }
        for lag in LAGS {
            if squares.len() > 8 * lag {
                let runs = squares.len() / lag;
                let of = (0..runs).map(|run| (sums[(run + 1) * lag] - sums[run * lag]).powi(2)).sum::<f64>();
                let z = (of / (runs * lag) as f64 / spread - 1.0) * (0.5 * runs as f64).sqrt();
                if z > 0.0 {
                    clusters = clusters.max(0.5 * z * z);
                }
            }
        }
        to = from;
    }
    found.push((Statistic::OctaveKurtosis, kurtosis));
    found.push((Statistic::Clusters, clusters));
}

/// Examines the finest bands of the whole record.
fn bands(series: &mut Series<'_>, found: &mut Vec<(Statistic, f64)>) {
    const WIDTH: usize = 64;
    // A louder part would otherwise count for more.
    let whitened = if series.variance.is_empty() {
        series.whitened.clone()
    } else {
        let mut values = series.residual.clone();
        series.transform.forward(&mut values);
        values
    };
    let rows: Vec<f64> = whitened
        .get(1..)
        .unwrap_or_default()
        .chunks_exact(WIDTH)
        .skip(4)
        .map(|of| excess(of.iter().map(|c| c * c).sum::<f64>() / WIDTH as f64, WIDTH as f64))
        .collect();
    if rows.is_empty() {
        return;
    }
    found.push((Statistic::FineBand, rows.iter().copied().fold(0.0, f64::max)));
    let z = rows.iter().sum::<f64>() / (0.5 * rows.len() as f64).sqrt();
    found.push((Statistic::FineBands, if z > 0.0 { 0.5 * z * z } else { 0.0 }));
}

/// Examines periods of the squares, and the autocorrelation.
fn periodic(residual: &[f64], found: &mut Vec<(Statistic, f64)>) {
    const LAGS: usize = 20_000;
    let n = residual.len();
    let forward = plans::forward(n);
    let (mut input, mut output) = (forward.make_input_vec(), forward.make_output_vec());
    let squares = residual.iter().map(|e| (e * e).min(12.0));
    let mean = squares.clone().sum::<f64>() / n as f64;
    input.iter_mut().zip(squares).for_each(|(own, square)| *own = square - mean);
    let variance = input.iter().map(|q| q * q).sum::<f64>() / n as f64;
    if forward.process(&mut input, &mut output).is_ok() && variance > 0.0 {
        let greatest = output.iter().skip(3).map(|q| q.norm_sqr()).fold(0.0, f64::max);
        found.push((Statistic::Modulation, greatest / (n as f64 * variance)));
    }
    input.copy_from_slice(residual);
    if forward.process(&mut input, &mut output).is_ok() {
        let backward = plans::backward(n);
        for value in &mut output {
            *value = (value.norm_sqr()).into();
        }
        if backward.process(&mut output, &mut input).is_ok() {
            let scale = input[0].max(f64::MIN_POSITIVE);
            let lags = input.iter().take((n / 4).min(LAGS)).skip(3);
            let greatest = lags.map(|sum| (sum / scale).abs()).fold(0.0, f64::max);
            found.push((Statistic::Echo, 0.5 * greatest * greatest * n as f64));
        }
    }
}
