//! Device clock: compares the sensor's clock with the host's, from arrival times. Pure.
//!
//! A measurement arrives late by its latency and never early, so that the true line lies under the points (device time,
//! arrival − device time). The estimate is the line under all points that is closest to them on average: the edge of
//! their lower convex hull over their mean time (the linear programme of Moon, Skelly and Towsley, INFOCOM 1999).
//! Memory is bounded: the least late arrival of each bin of time is kept, and bins are joined in pairs when there are
//! too many.
//!
//! The host's side is `CLOCK_BOOTTIME`, the clock of every `host_mono_ns`: NTP disciplines its rate, so that in the
//! long run it is the better clock of the two. While NTP slews (at most 500 ppm), the slew is part of the reported
//! skew. `CLOCK_MONOTONIC_RAW` would be free of slews, but permanently has the host crystal's own error, tens of ppm.

use serde::{Deserialize, Serialize};

/// The maximum number of bins.
const BINS: usize = 256;
/// The initial width of a bin, ns.
const BIN_NS: u64 = 500_000_000;
/// The rate of the sensor's clock is not estimated before it has run for this long, s.
const SPAN_S: f64 = 5.0;

/// The sensor's clock as the host sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ClockEstimate {
    /// How much faster the sensor's clock runs than the host's, ppm.
    pub skew_ppm: f64,
    /// Half of the interval that contains `skew_ppm`, from the scatter of the least late arrivals, ppm.
    pub skew_ppm_uncertainty: f64,
    /// Host monotonic time minus device time at the last measurement, without latency as far as the quickest arrivals
    /// show it, s.
    pub offset_s: f64,
    /// Mean latency of measurements beyond the quickest ones, ms.
    pub latency_mean_ms: f64,
    /// Maximum latency of measurements beyond the quickest ones, which a burst after a stall shows, ms.
    pub latency_max_ms: f64,
    /// Time of the sensor that the estimate is based on, s.
    pub span_s: f64,
}

/// The least late arrival of a bin: device time and arrival − device time, ns since the first measurement.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Point {
    device_ns: f64,
    delay_ns: f64,
}

/// Collects arrivals of one run of the sensor's clock.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DeviceClock {
    /// The run of the sensor's clock.
    run: (i64, u32),
    /// Device and host time of the first measurement.
    first: Option<(u64, u64)>,
    last_device_ns: u64,
    bin_ns: u64,
    /// Bins in order; the last one is being filled. Each has its number and its least late arrival.
    bins: Vec<(u64, Point)>,
    /// Sum and number of the delays, for their mean.
    sum_ns: f64,
    count: u64,
    /// The latest arrival so far.
    latest: Option<Point>,
}

impl DeviceClock {
    /// Takes a measurement of a run of the sensor's clock; another run begins a new estimate. The accounting determines
    /// the run ([`super::Accountant::epoch`]), combined with a number that distinguishes one capture from the next.
    pub fn note(&mut self, run: (i64, u32), device_ns: u64, host_mono_ns: u64) {
        if self.run != run {
            *self = Self { run, ..Self::default() };
        }
        // Repeated or late within its run: it does not show how quick an arrival can be.
        if self.first.is_some() && (device_ns.wrapping_sub(self.last_device_ns) as i64) <= 0 {
            return;
        }
        let (device_0, host_0) = *self.first.get_or_insert((device_ns, host_mono_ns));
        self.last_device_ns = device_ns;
        let elapsed_ns = device_ns.wrapping_sub(device_0);
        let point = Point {
            device_ns: elapsed_ns as f64,
            delay_ns: (host_mono_ns as i128 - i128::from(host_0) - i128::from(elapsed_ns)) as f64,
        };
        self.sum_ns += point.delay_ns;
        self.count += 1;
        if self.latest.is_none_or(|latest| point.delay_ns > latest.delay_ns) {
            self.latest = Some(point);
        }
        self.bin_ns = self.bin_ns.max(BIN_NS);
        let number = elapsed_ns / self.bin_ns;
        match self.bins.last_mut() {
            Some((last, least)) if *last == number => {
                if point.delay_ns < least.delay_ns {
                    *least = point;
                }
            }
            _ => self.bins.push((number, point)),
        }
        if self.bins.len() > BINS {
            self.join();
        }
    }

    /// Joins bins in pairs.
    fn join(&mut self) {
        self.bin_ns *= 2;
        let mut joined: Vec<(u64, Point)> = Vec::with_capacity(BINS);
        for (number, point) in self.bins.drain(..) {
            match joined.last_mut() {
                Some((last, least)) if *last == number / 2 => {
                    if point.delay_ns < least.delay_ns {
                        *least = point;
                    }
                }
                _ => joined.push((number / 2, point)),
            }
        }
        self.bins = joined;
    }

    /// Returns the present estimate; `None` before there is enough data.
    pub fn estimate(&self) -> Option<ClockEstimate> {
        let (device_0, host_0) = self.first?;
        let (first, last) = (self.bins.first()?.1, self.bins.last()?.1);
        let span_s = (last.device_ns - first.device_ns) / 1e9;
        if span_s < SPAN_S {
            return None;
        }
        let middle_ns = self.bins.iter().map(|(_, point)| point.device_ns).sum::<f64>() / self.bins.len() as f64;
        let hull = lower_hull(self.bins.iter().map(|(_, point)| *point));
        let (from, to) = hull.windows(2).find_map(|edge| match edge {
            [from, to] if to.device_ns >= middle_ns => Some((*from, *to)),
            _ => None,
        })?;
        let slope = (to.delay_ns - from.delay_ns) / (to.device_ns - from.device_ns);
        let line = |at: f64| from.delay_ns + slope * (at - from.device_ns);
        // The quickest arrivals of the bins lie above the line by the rest of their latency: a line through the ends of
        // that band would be steeper or flatter by this much.
        let mut above: Vec<f64> = self.bins.iter().map(|(_, point)| point.delay_ns - line(point.device_ns)).collect();
        above.sort_by(f64::total_cmp);
        let band_ns = above.get(above.len() * 9 / 10).copied().unwrap_or(0.0).max(1e3);
        let now_ns = self.last_device_ns.wrapping_sub(device_0) as f64;
        let mean_ns = self.sum_ns / self.count as f64 - line(now_ns / 2.0);
        let latest_ns = self.latest.map_or(0.0, |latest| latest.delay_ns - line(latest.device_ns));
        Some(ClockEstimate {
            // Slope is host per device: 1 + slope = 1 / (1 + skew).
            skew_ppm: (1.0 / (1.0 + slope) - 1.0) * 1e6,
            skew_ppm_uncertainty: 2.0 * band_ns / (span_s * 1e9) * 1e6,
            offset_s: (host_0 as f64 - device_0 as f64 + line(now_ns)) / 1e9,
            latency_mean_ms: mean_ns.max(0.0) / 1e6,
            latency_max_ms: latest_ns.max(0.0) / 1e6,
            span_s,
        })
    }
}

/// Returns the lower convex hull of points in the order of their device time (Andrew's monotone chain).
fn lower_hull(points: impl Iterator<Item = Point>) -> Vec<Point> {
    let mut hull: Vec<Point> = Vec::new();
    for point in points {
        while let [.., one, two] = hull[..] {
            let turn = (two.device_ns - one.device_ns) * (point.delay_ns - one.delay_ns)
                - (two.delay_ns - one.delay_ns) * (point.device_ns - one.device_ns);
            if turn > 0.0 {
                break;
            }
            hull.pop();
        }
        hull.push(point);
    }
    hull
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{Accountant, Channel, Record, Sample, Timebase};

    /// Returns a pseudo-random latency in ns: at least 0.2 ms, usually some milliseconds, sometimes a stall.
    fn latency_ns(index: u64) -> u64 {
        let mut bits = index.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (index >> 7);
        bits ^= bits >> 31;
        bits = bits.wrapping_mul(0xBF58_476D_1CE4_E5B9);
        bits ^= bits >> 29;
        let stall = if bits.is_multiple_of(1000) { 300_000_000 } else { 0 };
        200_000 + bits % 8_000_000 + stall
    }

    /// Simulates about an hour at 40 Hz: the sensor's clock is fast by `drift_ppm`, the host's by `slew_ppm`.
    fn run(seconds: u64, drift_ppm: f64, slew_ppm: f64) -> (ClockEstimate, f64, u64) {
        let (mut clock, mut accountant) = (DeviceClock::default(), Accountant::new(40.0, Timebase::Device));
        let mut out: Vec<Record> = Vec::new();
        for index in 0..seconds * 40 {
            let true_ns = index as f64 * 25e6;
            let device_ns = 7_000_000_000 + index * 25_000_000;
            let host_ns = 3_000_000_000_000
                + ((true_ns / (1.0 + drift_ppm * 1e-6) + latency_ns(index) as f64) * (1.0 + slew_ppm * 1e-6)) as u64;
            clock.note((1, 1), device_ns, host_ns);
            let mut sample = Sample::at(host_ns, 1_800_000_000_000_000_000 + host_ns as i64);
            sample.device_time_ns = Some(device_ns);
            sample.set(Channel::GyroX, 0.0);
            accountant.observe(sample, &mut out);
            out.clear();
        }
        let truth = ((1.0 + drift_ppm * 1e-6) / (1.0 + slew_ppm * 1e-6) - 1.0) * 1e6;
        (clock.estimate().unwrap(), truth, accountant.missing())
    }

    /// D2.
    #[test]
    fn the_rate_is_known_within_1_ppm_after_ten_minutes_of_slew_and_drift_and_no_gap_is_seen() {
        for (drift, slew) in [(100.0, 500.0), (-100.0, 500.0), (100.0, -500.0), (0.0, 0.0), (100.0, 0.0)] {
            let (estimate, truth, missing) = run(600, drift, slew);
            assert!((estimate.skew_ppm - truth).abs() < 1.0, "{estimate:?}, truth {truth}");
            assert!((estimate.skew_ppm - truth).abs() <= estimate.skew_ppm_uncertainty, "{estimate:?}, truth {truth}");
            assert!(estimate.skew_ppm_uncertainty < 5.0, "{estimate:?}");
            assert_eq!(missing, 0);
        }
    }

    #[test]
    fn a_night_keeps_its_memory_bounded_and_its_rate_sharper() {
        let (mut clock, skew) = (DeviceClock::default(), 30e-6);
        for index in 0..5 * 3600 * 40_u64 {
            let device_ns = index * 25_000_000;
            clock.note((1, 1), device_ns, (device_ns as f64 / (1.0 + skew)) as u64 + latency_ns(index));
        }
        assert!(clock.bins.len() <= BINS);
        let estimate = clock.estimate().unwrap();
        assert!((estimate.skew_ppm - 30.0).abs() < 0.05, "{estimate:?}");
        assert!((estimate.latency_mean_ms - 4.0).abs() < 1.0, "{estimate:?}");
        assert!((estimate.latency_max_ms - 300.0).abs() < 10.0, "{estimate:?}");
    }

    /// Simulates ten seconds of one run of the sensor's clock, then ten of another that begins at `again_ns`.
    fn two_runs(again_ns: u64) -> (Option<ClockEstimate>, u32) {
        let (mut clock, mut accountant) = (DeviceClock::default(), Accountant::new(40.0, Timebase::Device));
        let mut out = Vec::new();
        for index in 0..800_u64 {
            let host_ns = 1_000_000_000 + index * 25_000_000;
            let device_ns =
                if index < 400 { 50_000_000_000 + index * 25_000_000 } else { again_ns + (index - 400) * 25_000_000 };
            let mut sample = Sample::at(host_ns, 1_800_000_000_000_000_000 + host_ns as i64);
            sample.device_time_ns = Some(device_ns);
            sample.set(Channel::GyroX, 0.0);
            accountant.observe(sample, &mut out);
            clock.note((1, accountant.epoch()), device_ns, host_ns);
            out.clear();
        }
        (clock.estimate(), accountant.epoch())
    }

    /// Only the accounting decides where a run begins: back to zero, back by less than a second, or ahead by an hour.
    #[test]
    fn a_clock_that_starts_again_begins_a_new_estimate_where_the_accounting_decides() {
        for again_ns in [0, 59_500_000_000, 3_660_000_000_000] {
            let (estimate, epoch) = two_runs(again_ns);
            let estimate = estimate.unwrap();
            assert_eq!(epoch, 2);
            assert!(estimate.span_s < 10.0 && estimate.skew_ppm.abs() < 1.0, "{again_ns}: {estimate:?}");
        }
    }
}
