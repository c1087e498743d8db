//! Deliveries: determines whether the empty points of a grid are losses, or whether the grid is that of a port's
//! deliveries. Pure.
//!
//! Losses come at random. So a stretch of W steps is longer by as many periods as it has lost, with a variance of at
//! least their mean. A port that delivers at steps of its own clock leaves points empty at regular intervals: no
//! stretch differs from the next by more than a delivery. With a latency timer of 16 ms, 50 samples a second lie on a
//! grid of 62.5 Hz, of which every fifth point is empty.

use super::StampGrid;

/// Steps shorter than this share of the period belong to one delivery.
pub(super) const TOGETHER: f64 = 0.3;
/// Steps per stretch whose length is compared.
const STRETCH: usize = 256;
/// The variance of shorter stretches is chance.
const STRETCH_LEAST: usize = 32;
/// Missing points are no losses if their numbers vary by less than this share of what chance produces.
const REGULAR: f64 = 0.5;
/// The variance of fewer losses is chance.
const MISSING_LEAST: u64 = 40;
/// A smaller share may be lost at regular intervals, for example if a logger drops each hundredth sample.
const SHARE_LEAST: f64 = 0.03;
/// From this share of the period on, jitter is that of a host's clock. A sensor's own clock may lose samples at regular
/// intervals.
const JITTER_OF_HOSTS: f64 = 1e-3;
/// Jitter cannot be seen if the period has fewer steps of the rounding.
const STEPS_LEAST: f64 = 2.5;
/// From this share of short steps on, samples come in batches.
const BATCHES: f64 = 0.2;
/// From this share of short steps on, batches are so large that they hide the grid.
const LARGE_BATCHES: f64 = 0.8;

/// The stamps' properties that show deliveries.
pub(super) struct Deliveries<'a> {
    at_ns: &'a [f64],
    /// All stamps are multiples of this.
    rounding_ns: u64,
    /// Steps of a stretch, and the variance of its length; `None` if there are too few.
    stretch: Option<(usize, f64)>,
}

impl<'a> Deliveries<'a> {
    /// Examines stamps, ns since the first, which are multiples of `rounding_ns`.
    pub(super) fn of(at_ns: &'a [f64], rounding_ns: u64) -> Self {
        let steps = STRETCH.min(at_ns.len() / 32);
        let lengths = || at_ns.iter().zip(at_ns.get(steps..).unwrap_or_default()).map(|(from, to)| to - from);
        let count = lengths().count() as f64;
        let mean = lengths().sum::<f64>() / count;
        let variance_ns2 = lengths().map(|length| (length - mean).powi(2)).sum::<f64>() / count;
        Self { at_ns, rounding_ns, stretch: (steps >= STRETCH_LEAST).then_some((steps, variance_ns2)) }
    }

    /// Returns the share of steps that are far shorter than a period.
    fn together(&self, period_ns: f64) -> f64 {
        let short = self.at_ns.windows(2).filter(|two| two[1] - two[0] < TOGETHER * period_ns);
        short.count() as f64 / self.at_ns.len() as f64
    }

    /// Returns whether most samples share their delivery with others, so that only the mean rate is known. Rounding may
    /// have the same effect: then most stamps are one rounding step apart.
    pub(super) fn hide_the_grid(&self, mean_ns: f64) -> bool {
        let apart = || self.at_ns.windows(2).map(|two| two[1] - two[0]).filter(|step| *step > 0.0);
        let next = apart().filter(|step| *step == self.rounding_ns as f64).count();
        self.together(mean_ns) > LARGE_BATCHES && 2 * next <= apart().count()
    }

    /// Returns whether deliveries explain the `missing` empty points of a grid beside `count` samples, so that they are
    /// no losses.
    pub(super) fn explain(&self, missing: u64, count: f64, grid: &StampGrid) -> bool {
        let Some((steps, variance_ns2)) = self.stretch.filter(|_| missing >= MISSING_LEAST) else { return false };
        let (missing, period_ns) = (missing as f64, grid.period_ns);
        let of_a_host =
            grid.jitter_ns > JITTER_OF_HOSTS * period_ns || period_ns < STEPS_LEAST * self.rounding_ns as f64;
        let delivered = self.together(period_ns) > BATCHES || (of_a_host && missing > SHARE_LEAST * (count + missing));
        delivered && variance_ns2 < REGULAR * missing / count * steps as f64 * period_ns * period_ns
    }
}
