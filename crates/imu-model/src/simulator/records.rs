//! Records: simulated samples in the form of a capture, with a gap wherever samples were lost.

use super::SimulatedSample;
use imu_core::sample::{ChannelSet, Gap, GapCause, Record, Sample, Segment, Timebase};

/// The sensor's clock at the first sample, ns: a stamp with jitter stays above 0.
const FIRST_NS: u64 = 1_000_000_000;

/// Turns samples into records, one after the other.
#[derive(Debug, Clone)]
pub struct Records {
    rate_hz: f64,
    channels: ChannelSet,
    /// The sensor's own ticks, or stamps if these deviate from the ticks.
    timebase: Timebase,
    started_utc_ns: i64,
    segment: u32,
    /// Number of samples that were not lost.
    received: u64,
    /// Stamp of the last sample that was not lost, and number of samples lost since.
    last_ns: Option<u64>,
    lost: u64,
    missing: u64,
}

impl Records {
    /// Creates a converter without samples. With `has_jitter`, stamps are not the sensor's ticks. The first sample is
    /// at `started_utc_ns`.
    pub fn new(rate_hz: f64, channels: ChannelSet, has_jitter: bool, started_utc_ns: i64) -> Self {
        let timebase = if has_jitter { Timebase::Stamps } else { Timebase::Device };
        Self {
            rate_hz,
            channels,
            timebase,
            started_utc_ns,
            segment: 0,
            received: 0,
            last_ns: None,
            lost: 0,
            missing: 0,
        }
    }

    /// Passes the records of a sample to `push`, in order.
    ///
    /// # Errors
    /// The errors of `push`.
    pub fn take<E>(&mut self, of: &SimulatedSample, mut push: impl FnMut(Record) -> Result<(), E>) -> Result<(), E> {
        if of.lost {
            self.lost += 1;
            return Ok(());
        }
        // Stamps of a sensor never run back.
        let earliest_ns = self.last_ns.map_or(0, |last| last + 1);
        let device_ns = ((FIRST_NS as f64 + 1e9 * of.time_s).round().max(0.0) as u64).max(earliest_ns);
        let utc_ns = |device_ns: u64| self.started_utc_ns + device_ns as i64 - FIRST_NS as i64;
        let begins = self.last_ns.is_none() || self.lost > 0;
        // Samples lost before the first one do not count.
        if let Some(last_ns) = self.last_ns.filter(|_| self.lost > 0) {
            self.missing += self.lost;
            push(Record::Gap(Gap {
                before_seq: self.received,
                from_utc_ns: utc_ns(last_ns),
                to_utc_ns: utc_ns(device_ns),
                device_ns: Some((last_ns, device_ns)),
                missing: self.lost,
                missing_exact: true,
                cause: GapCause::Source,
            }))?;
        }
        if begins {
            self.segment += 1;
            push(Record::Segment(Segment {
                number: self.segment,
                epoch: 1,
                first_seq: self.received,
                rate_hz: self.rate_hz,
                timebase: self.timebase,
                channels: self.channels,
                first_device_time_ns: Some(device_ns),
                first_utc_ns: utc_ns(device_ns),
                boot_id: None,
            }))?;
        }
        let mut sample = Sample::at(device_ns, utc_ns(device_ns));
        sample.device_time_ns = Some(device_ns);
        for channel in self.channels.iter() {
            sample.set(channel, of.values[channel as usize]);
        }
        push(Record::Sample { seq: self.received, segment: self.segment, sample })?;
        (self.received, self.last_ns, self.lost) = (self.received + 1, Some(device_ns), 0);
        Ok(())
    }

    /// Returns the number of samples that were not lost, and of those lost between them.
    pub fn counts(&self) -> (u64, u64) {
        (self.received, self.missing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_core::sample::Channel;
    use std::convert::Infallible;

    #[test]
    fn lost_samples_are_gaps_and_nothing_is_lost_besides() {
        let channels: ChannelSet = [Channel::GyroX].into_iter().collect();
        let mut records = Records::new(40.0, channels, false, 1_800_000_000_000_000_000);
        let mut seen = Vec::new();
        let lost = [0, 3, 4, 7, 19];
        for index in 0..20_u64 {
            let mut values = [0.0; Channel::COUNT];
            values[Channel::GyroX as usize] = index as f64;
            let sample = SimulatedSample { index, time_s: index as f64 / 40.0, lost: lost.contains(&index), values };
            let Ok(()) = records.take(&sample, |record| {
                seen.push(record);
                Ok::<_, Infallible>(())
            });
        }
        let values: Vec<f64> = seen
            .iter()
            .filter_map(|record| match record {
                Record::Sample { sample, .. } => sample.get(Channel::GyroX),
                _ => None,
            })
            .collect();
        assert_eq!(values, (0..20).filter(|index| !lost.contains(index)).map(|index| index as f64).collect::<Vec<_>>());
        let gaps: Vec<(u64, u64)> = seen
            .iter()
            .filter_map(|record| match record {
                Record::Gap(gap) => Some((gap.before_seq, gap.missing)),
                _ => None,
            })
            .collect();
        assert_eq!(gaps, [(2, 2), (4, 1)]);
        let segments = seen.iter().filter(|record| matches!(record, Record::Segment(_))).count();
        assert_eq!((segments, records.counts()), (3, (15, 3)));
    }
}
