//! The last minute: what the sensor sent, for eyes, from memory and whether a capture runs or not.
//!
//! In: samples as they come. Out: least and greatest value of each quarter of a second, so that the picture of a minute
//! costs the same at 40 and at 800 Hz and no peak is lost.

use crate::sample::{Channel, ChannelSet, Sample};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

/// Length of a bucket, ns.
const BUCKET_NS: u64 = 250_000_000;
/// Buckets of the minute.
const BUCKETS: usize = 240;

/// What came within one quarter of a second.
#[derive(Debug, Clone, Copy)]
struct Bucket {
    /// Its number since the host's monotonic clock began.
    number: u64,
    channels: ChannelSet,
    ends: [[f64; 2]; Channel::COUNT],
    /// The last value of each channel.
    last: [f64; Channel::COUNT],
}

/// The last minute, as the reader of the port writes it.
#[derive(Debug, Default)]
pub struct Recent {
    buckets: VecDeque<Bucket>,
}

/// The last minute, shared with whoever looks at it.
#[derive(Debug, Clone, Default)]
pub struct SharedRecent(Arc<Mutex<Recent>>);

/// The last minute of one channel.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::exhaustive_structs, reason = "data")]
pub struct Trace {
    /// Whose.
    pub channel: Channel,
    /// Age in s of the middle of a stretch (0 is now), its least and its greatest value; oldest first.
    pub points: Vec<(f64, f64, f64)>,
    /// The latest value, channel's unit.
    pub last: f64,
}

impl Recent {
    /// Takes a sample.
    pub fn note(&mut self, sample: &Sample) {
        let number = sample.host_mono_ns / BUCKET_NS;
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

    /// The minute before `mono_ns` of every channel that came within it.
    #[must_use]
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

    /// [`Recent::traces`].
    #[must_use]
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
    fn it_holds_a_minute_however_fast_samples_come() {
        let mut recent = Recent::default();
        for at_ms in 0..200_000 {
            recent.note(&sample(at_ms, 1.0));
        }
        assert_eq!(recent.buckets.len(), BUCKETS);
        assert_eq!(recent.traces(200_000_000_000)[0].points.len(), BUCKETS - 1);
        // What is older than a minute is no longer shown.
        assert!(recent.traces(300_000_000_000).is_empty());
    }
}
