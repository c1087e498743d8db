//! The last minute: the sensor's values for display, from memory, whether a capture runs or not.
//!
//! In: samples as they arrive. Out: least and greatest value of each quarter of a second, so that the picture of a
//! minute costs the same at 40 and at 800 Hz and shows every peak.

use imu_core::sample::{Channel, ChannelSet, Sample};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// Length of a bucket, ns.
const BUCKET_NS: u64 = 250_000_000;
/// The maximum by which a sample may raise the offset between the clocks, ns: 80 ppm at 40 Hz. The shift by a burst of
/// a thousand late samples is not visible.
const DRIFT_NS: i64 = 2_000;
/// Number of buckets in a minute.
const BUCKETS: usize = 240;

/// The values of a quarter of a second.
#[derive(Debug, Clone, Copy)]
struct Bucket {
    /// Its number, counted from the start of the host's monotonic clock.
    number: u64,
    channels: ChannelSet,
    ends: [[f64; 2]; Channel::COUNT],
    /// The last value of each channel.
    last: [f64; Channel::COUNT],
}

/// The last minute, as the port's reader writes it.
#[derive(Debug, Default)]
pub struct Recent {
    buckets: VecDeque<Bucket>,
    /// The last device time, and the offset of the host's clock from the device's, ns. Samples are read in bursts, and
    /// are nevertheless shown at equal distances.
    device: Option<(i64, i64)>,
}

/// The last minute, shared with its viewers.
#[derive(Debug, Clone, Default)]
pub struct SharedRecent(Arc<Mutex<Recent>>);

/// The last minute of one channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// The channel.
    pub channel: Channel,
    /// For each stretch the age of its middle in s (0 is now), the least and the greatest value; oldest first.
    pub points: Vec<(f64, f64, f64)>,
    /// The latest value in the channel's unit.
    pub last: f64,
}

impl Recent {
    /// Takes a sample.
    pub fn note(&mut self, sample: &Sample) {
        let number = self.at_ns(sample) / BUCKET_NS;
        if self.buckets.back().is_none_or(|bucket| bucket.number != number) {
            self.buckets.push_back(Bucket {
                number,
                channels: ChannelSet::EMPTY,
                ends: [[f64::INFINITY, f64::NEG_INFINITY]; Channel::COUNT],
                last: [0.0; Channel::COUNT],
            });
            if self.buckets.len() > BUCKETS {
                self.buckets.pop_front();
            }
        }
        let Some(bucket) = self.buckets.back_mut() else { return };
        for channel in sample.channels().iter() {
            let Some(value) = sample.get(channel) else { continue };
            let [low, high] = &mut bucket.ends[channel as usize];
            (*low, *high) = (low.min(value), high.max(value));
            bucket.last[channel as usize] = value;
            bucket.channels.insert(channel);
        }
    }

    /// Returns the time at which a sample was taken, ns of the host's monotonic clock. It follows the device's clock,
    /// aligned with the samples that arrived with the least delay, or the arrival if the sensor sends no time.
    fn at_ns(&mut self, sample: &Sample) -> u64 {
        let arrived_ns = sample.host_mono_ns;
        let Some(device_ns) = sample.device_time_ns.and_then(|ns| i64::try_from(ns).ok()) else { return arrived_ns };
        let ahead_ns = i64::try_from(arrived_ns).unwrap_or(i64::MAX).saturating_sub(device_ns);
        let kept_ns = match self.device {
            // The clock started again, or jumped.
            Some((last_ns, kept_ns))
                if device_ns < last_ns || ahead_ns.abs_diff(kept_ns) > BUCKETS as u64 * BUCKET_NS =>
            {
                ahead_ns
            }
            // Clocks drift apart slowly: later arrivals raise the offset slightly, earlier ones lower it at once.
            Some((_, kept_ns)) => ahead_ns.min(kept_ns.saturating_add(DRIFT_NS)),
            None => ahead_ns,
        };
        self.device = Some((device_ns, kept_ns));
        // Never back: points that were shown stay in place.
        let at_ns = u64::try_from(device_ns.saturating_add(kept_ns)).unwrap_or(arrived_ns);
        self.buckets.back().map_or(at_ns, |bucket| at_ns.max(bucket.number * BUCKET_NS))
    }

    /// Returns the minute before `mono_ns` of every channel that has values in it.
    pub fn traces(&self, mono_ns: u64) -> Vec<Trace> {
        let now = mono_ns / BUCKET_NS;
        let bucket_s = BUCKET_NS as f64 / 1e9;
        let within =
            || self.buckets.iter().filter(|bucket| bucket.number + BUCKETS as u64 > now && bucket.number <= now);
        let there = within().fold(ChannelSet::EMPTY, |all, bucket| all.union(bucket.channels));
        let of = |channel: Channel| {
            let own = || within().filter(|bucket| bucket.channels.contains(channel));
            let point = |bucket: &Bucket| {
                let [low, high] = bucket.ends[channel as usize];
                ((now - bucket.number) as f64 * bucket_s, low, high)
            };
            Some(Trace { channel, points: own().map(point).collect(), last: own().next_back()?.last[channel as usize] })
        };
        there.iter().filter_map(of).collect()
    }
}

impl SharedRecent {
    /// Takes a sample.
    pub fn note(&self, sample: &Sample) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).note(sample);
    }

    /// Returns the traces ([`Recent::traces`]).
    pub fn traces(&self, mono_ns: u64) -> Vec<Trace> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).traces(mono_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(at_ms: u64, value: f64) -> Sample {
        let mut sample = Sample::at(at_ms * 1_000_000, 0);
        sample.set(Channel::GyroX, value);
        sample
    }

    #[test]
    fn a_peak_is_kept_and_a_pause_is_none() {
        let mut recent = Recent::default();
        for at_ms in (0..1000).chain(2000..3000) {
            recent.note(&sample(at_ms, if at_ms == 2100 { 7.0 } else { f64::from(at_ms as u32 % 2) }));
        }
        let traces = recent.traces(2_999_000_000);
        assert_eq!(traces.len(), 1);
        assert_eq!((traces[0].points.len(), traces[0].last), (8, 1.0));
        assert_eq!(traces[0].points[4], (0.75, 0.0, 7.0));
        assert_eq!((traces[0].points[3].0, traces[0].points[7].0), (2.0, 0.0));
    }

    #[test]
    fn bursts_of_a_device_with_a_clock_are_a_line() {
        let mut recent = Recent::default();
        // Two seconds are read at once, every two seconds; the clock restarts after twenty.
        for index in 0_u64..1600 {
            let mut sample = sample(2000 * (index / 80 + 1), 1.0);
            sample.device_time_ns = Some(25_000_000 * (index % 800) + 3_600_000_000_000 * (1 - index / 800));
            recent.note(&sample);
        }
        let points = &recent.traces(40_000_000_000)[0].points;
        let steps = points.windows(2).filter(|of| (of[0].0 - of[1].0 - 0.25).abs() > 1e-9).count();
        assert!(points.len() > 140 && steps <= 1, "{} {steps}", points.len());
    }

    #[test]
    fn it_holds_a_minute_however_fast_samples_come() {
        let mut recent = Recent::default();
        for at_ms in 0..200_000 {
            recent.note(&sample(at_ms, 1.0));
        }
        assert_eq!(recent.buckets.len(), BUCKETS);
        assert_eq!(recent.traces(200_000_000_000)[0].points.len(), BUCKETS - 1);
        // Values older than a minute are no longer shown.
        assert!(recent.traces(300_000_000_000).is_empty());
    }
}
