//! The omnibus: whether a residual is white, normal and the same throughout, whatever it might be otherwise.

use super::series::Series;
use super::tiles::Tiles;
use realfft::RealFftPlanner;
use statrs::function::gamma::digamma;

/// A statistic of a residual, about −ln of the chance of as much, up to an offset that the record's length gives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[expect(clippy::exhaustive_enums, reason = "each has a null distribution in the table")]
pub enum Statistic {
    /// Fourth moment of single samples.
    Kurtosis,
    /// Third moment.
    Skewness,
    /// Variance in tiles of time and octave, in all.
    Tiles,
    /// In the most conspicuous tile.
    Tile,
    /// In the most conspicuous octave.
    Octave,
    /// In the most conspicuous stretch.
    Stretch,
    /// Fourth moment within octaves.
    OctaveKurtosis,
    /// Clustering of the power within octaves.
    Clusters,
    /// Power in the finest bands, the most conspicuous.
    FineBand,
    /// Power in the finest bands, in all.
    FineBands,
    /// A period in the squares.
    Modulation,
    /// The greatest autocorrelation.
    Echo,
}

impl Statistic {
    /// All.
    pub const ALL: [Self; 12] = [
        Self::Kurtosis,
        Self::Skewness,
        Self::Tiles,
        Self::Tile,
        Self::Octave,
        Self::Stretch,
        Self::OctaveKurtosis,
        Self::Clusters,
        Self::FineBand,
        Self::FineBands,
        Self::Modulation,
        Self::Echo,
    ];

    /// What it sees, for people.
    #[must_use]
    pub fn meaning(self) -> &'static str {
        match self {
            Self::Kurtosis => "tails of single samples",
            Self::Skewness => "asymmetry of single samples",
            Self::Tiles => "power that varies over time and frequency",
            Self::Tile => "power in one stretch of one octave",
            Self::Octave => "power in one octave",
            Self::Stretch => "power in one stretch of time",
            Self::OctaveKurtosis => "values of an octave that are not normal",
            Self::Clusters => "power of an octave that comes in bursts",
            Self::FineBand => "power in a narrow band",
            Self::FineBands => "power in many narrow bands",
            Self::Modulation => "noise whose level has a period",
            Self::Echo => "an echo: samples that resemble those a while before",
        }
    }

    /// Whether it looks at single samples' distribution, which rounding, limits and tails change.
    #[must_use]
    pub fn is_marginal(self) -> bool {
        matches!(self, Self::Kurtosis | Self::Skewness | Self::OctaveKurtosis)
    }
}

/// All statistics of a series' residual.
#[must_use]
pub fn statistics(series: &mut Series<'_>) -> Vec<(Statistic, f64)> {
    series.residual = series.scores().into_owned();
    let residual = series.residual.clone();
    let n = residual.len();
    let mut found = Vec::with_capacity(Statistic::ALL.len());
    let half_square = |z: f64| 0.5 * z * z;
    let (mut third, mut fourth) = (0.0, 0.0);
    for e in &residual {
        let e = e.clamp(-8.0, 8.0);
        third += e.powi(3);
        fourth += e.powi(4);
    }
    let count = n as f64;
    found.push((Statistic::Kurtosis, half_square((fourth / count - 3.0) * (count / 96.0).sqrt())));
    found.push((Statistic::Skewness, half_square(third / count * (count / 15.0).sqrt())));
    tiles(&Tiles::of(series), &mut found);
    octaves(series, &mut found);
    bands(series, &mut found);
    periodic(&residual, &mut found);
    found
}

/// A gain of n coefficients' own variance, less what chance gives on average.
pub(super) fn excess(ratio: f64, count: f64) -> f64 {
    let half = 0.5 * count;
    half * (ratio - 1.0 - ratio.max(1e-9).ln()) - half * (half.ln() - digamma(half))
}

fn tiles(tiles: &Tiles, found: &mut Vec<(Statistic, f64)>) {
    let stretches = tiles.edges_s.len() - 1;
    let bands = tiles.edges_hz.len() - 1;
    if bands == 0 {
        return;
    }
    let table = &tiles.excess;
    let spread = 0.5f64.sqrt();
    let normal = |sum: f64, count: f64| {
        let z = sum / (spread * count.sqrt());
        if z > 0.0 { 0.5 * z * z } else { 0.0 }
    };
    found.push((Statistic::Tiles, normal(table.iter().sum(), table.len() as f64)));
    found.push((Statistic::Tile, table.iter().copied().fold(0.0, f64::max)));
    let octave = |band: usize| normal((0..stretches).map(|block| table[block * bands + band]).sum(), stretches as f64);
    found.push((Statistic::Octave, (0..bands).map(octave).fold(0.0, f64::max)));
    let stretch = |block: usize| normal((0..bands).map(|band| table[block * bands + band]).sum(), bands as f64);
    found.push((Statistic::Stretch, (0..stretches).map(stretch).fold(0.0, f64::max)));
}

/// Octaves of the whitened coefficients: moments and clustering of what each makes in time.
fn octaves(series: &mut Series<'_>, found: &mut Vec<(Statistic, f64)>) {
    const LAGS: [usize; 3] = [4, 16, 64];
    let n = series.len();
    let mut residual = series.residual.clone();
    series.transform().forward(&mut residual);
    let whitened = residual;
    let (mut kurtosis, mut clusters) = (0.0f64, 0.0f64);
    let mut to = n;
    while to > 512 {
        let from = to / 2;
        // Half the band at its own rate: a transform of its own length brings it to the base band.
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

/// The finest bands of the whole record.
fn bands(series: &Series<'_>, found: &mut Vec<(Statistic, f64)>) {
    const WIDTH: usize = 64;
    let rows: Vec<f64> = series
        .whitened
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

/// A period of the squares, and the autocorrelation.
fn periodic(residual: &[f64], found: &mut Vec<(Statistic, f64)>) {
    const LAGS: usize = 20_000;
    let n = residual.len();
    let mut planner = RealFftPlanner::new();
    let forward = planner.plan_fft_forward(n);
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
        let backward = planner.plan_fft_inverse(n);
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
