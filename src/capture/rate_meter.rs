//! Rate meter: determines the output of a sensor and its rate, if the registers do not state them. Pure.

use super::output::is_binary;
use vn100_proto::{MeasurementKind, link};

/// The maximum deviation of a measured rate from one that the sensor supports.
const NEAR: f64 = 0.02;

/// Determines the output of a sensor and its rate, if the registers do not state them.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct RateMeter {
    kind: Option<MeasurementKind>,
    arrivals_ns: Vec<u64>,
    device_ns: Vec<u64>,
}

impl RateMeter {
    pub(super) fn note(&mut self, now_ns: u64, kind: MeasurementKind, device_ns: Option<u64>) {
        // Binary output has priority over ASCII: it carries time.
        if self.kind.is_none_or(|chosen| !is_binary(chosen) && is_binary(kind)) {
            *self = Self { kind: Some(kind), ..Self::default() };
        }
        if self.kind == Some(kind) {
            self.arrivals_ns.push(now_ns);
            self.device_ns.extend(device_ns);
        }
    }

    /// Returns the kind and its rate in Hz, by the sensor's own clock, else by the host's. The rate is rounded to one
    /// that a VN-100 supports if one is near (800 Hz / n for binary output, register 7's for messages).
    pub(super) fn result(&self) -> Option<(MeasurementKind, f64)> {
        let kind = self.kind?;
        let rate = |times: &[u64]| {
            let (first, last) = (times.first()?, times.last()?);
            (times.len() > 2 && last > first).then(|| (times.len() - 1) as f64 * 1e9 / (last - first) as f64)
        };
        let measured = if self.device_ns.len() == self.arrivals_ns.len() { rate(&self.device_ns) } else { None };
        let measured = measured.or_else(|| rate(&self.arrivals_ns))?;
        let near = if is_binary(kind) {
            let internal_hz = f64::from(link::INTERNAL_RATE_HZ);
            internal_hz / (internal_hz / measured).round().max(1.0)
        } else {
            let distance = |rate: &f64| (rate / measured).ln().abs();
            let rates = link::ASCII_RATES_HZ.into_iter().map(f64::from);
            rates.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(measured)
        };
        Some((kind, if (near / measured - 1.0).abs() < NEAR { near } else { measured }))
    }
}
