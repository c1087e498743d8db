//! Stamps: the written times of a case's samples, and samples that are lost on the way.

use super::columns::Columns;
use super::draw::Draw;
use serde::{Deserialize, Serialize};

/// How samples are stamped and sent. A record with stamps is read like a table: its rate follows from the stamps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Stamps {
    /// The first stamp, s.
    pub first_s: f64,
    /// Number of written decimals of a second; none writes all.
    pub decimals: Option<u8>,
    /// Mean of an exponential delay before a sample is stamped, s, as for a host's stamps of arrival. 0 for the
    /// sensor's own stamps.
    pub late_s: f64,
    /// Part of the samples that is lost.
    pub lost: f64,
}

/// Part of the stamped cases with each form; the others are exact.
const ROUNDED: f64 = 0.3;
const LATE: f64 = 0.25;
const LOSSY: f64 = 0.2;
/// Mean delays in periods, and shares of lost samples, each as a range.
const DELAY: [f64; 2] = [0.02, 0.4];
const LOST: [f64; 2] = [1e-4, 0.02];
/// Rates below which two decimals distinguish samples, Hz.
const TWO_DECIMALS_HZ: f64 = 80.0;

impl Stamps {
    /// Returns the exact stamps of the sensor.
    pub fn exact(first_s: f64) -> Self {
        Self { first_s, decimals: None, late_s: 0.0, lost: 0.0 }
    }

    /// Draws a form of stamps.
    pub fn draw(rate_hz: f64, device: &mut Draw) -> Self {
        let mut made = Self::exact(device.uniform(0.0, 5_000.0));
        let coarse = rate_hz < TWO_DECIMALS_HZ && device.chance(0.4);
        made.decimals = device.chance(ROUNDED).then_some(if coarse { 2 } else { 3 });
        let delay = device.log_uniform(DELAY[0], DELAY[1]) / rate_hz;
        made.late_s = if device.chance(LATE) { delay } else { 0.0 };
        let lost = device.log_uniform(LOST[0], LOST[1]);
        made.lost = if device.chance(LOSSY) { lost } else { 0.0 };
        made
    }

    /// Returns whether a named `timing` belongs to the delivery: it is neither an effect of the sensor nor spurious.
    pub fn deliver_late(self) -> bool {
        self.late_s > 0.0 || self.lost > 0.0
    }

    /// Writes the stamps of samples that the sensor took at these times, and loses samples.
    pub fn write(self, on: &mut Columns, draw: &mut Draw) {
        let (mut delays, mut losses) = (draw.split(), draw.split());
        if self.late_s > 0.0 {
            // A late sample delays those behind it.
            let mut last = f64::NEG_INFINITY;
            for stamp in &mut on.time_s {
                last = last.max(*stamp - self.late_s * (1.0 - delays.uniform(0.0, 1.0)).ln());
                *stamp = last;
            }
        }
        if let Some(decimals) = self.decimals {
            let scale = 10_f64.powi(decimals.into());
            on.time_s.iter_mut().for_each(|stamp| *stamp = (*stamp * scale).round() / scale);
        }
        if self.lost > 0.0 {
            let places = losses.events(self.lost, on.len().saturating_sub(1));
            on.lose(places);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns() -> Columns {
        let time_s = (0..40_000).map(|i| 3.0 + f64::from(i) / 50.0).collect();
        let column = super::super::columns::Column {
            channel: imu_core::sample::Channel::GyroX,
            values: vec![0.0; 40_000],
            white: vec![0.0; 40_000],
            scale: 1.0,
        };
        Columns { rate_hz: 50.0, columns: vec![column], temperature_c: Vec::new(), missing: Vec::new(), time_s }
    }

    #[test]
    fn late_stamps_are_in_order_and_late_by_their_mean() {
        let mut made = columns();
        let before = made.time_s.clone();
        let stamps = Stamps { late_s: 0.004, ..Stamps::exact(3.0) };
        stamps.write(&mut made, &mut Draw::device(1, 1, "stamps"));
        assert!(made.time_s.windows(2).all(|two| two[1] >= two[0]) && stamps.deliver_late());
        let mean = made.time_s.iter().zip(&before).map(|(now, then)| now - then).sum::<f64>() / 40_000.0;
        assert!((mean / 0.004 - 1.0).abs() < 0.05, "{mean}");
    }

    #[test]
    fn rounded_stamps_are_rounded_and_lost_samples_are_missing() {
        let mut made = columns();
        let stamps = Stamps { decimals: Some(2), lost: 0.01, ..Stamps::exact(3.0) };
        stamps.write(&mut made, &mut Draw::device(1, 1, "stamps"));
        assert!(made.time_s.iter().all(|stamp| ((stamp * 100.0).round() - stamp * 100.0).abs() < 1e-6));
        let lost = made.missing.iter().filter(|missing| **missing).count();
        assert!((300..500).contains(&lost) && !made.missing[0] && !made.missing[39_999], "{lost}");
    }
}
