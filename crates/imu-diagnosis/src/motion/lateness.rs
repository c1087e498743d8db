//! Lateness: determines which of two triads' delays is a latency, and which is an offset of the reference's clock.
//!
//! On one clock, a delay is a latency, unless both triads have the same delay or one delay is negative: then the stamps of record
//! and reference differ. On a separate clock, the smaller of two delays is that clock's offset, and the excess of the other is
//! its latency. One triad alone determines neither.

use crate::response::Estimate;
use imu_core::sample::Triad;

/// A delay, s, with its standard error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Delay {
    pub(super) triad: Triad,
    pub(super) seconds: f64,
    pub(super) error_s: f64,
}

impl Delay {
    pub(super) fn of(triad: Triad, estimates: &[Estimate]) -> Option<Self> {
        let one = estimates.iter().find(|one| matches!(one.parameter.as_str(), "seconds" | "offset_s"))?;
        // An effect that the model has already is not missing.
        let seconds = one.value - if one.parameter == "seconds" { one.known } else { 0.0 };
        Some(Self { triad, seconds, error_s: one.standard_error? }).filter(|of| of.error_s > 0.0)
    }

    fn nats(self) -> f64 {
        0.5 * (self.seconds / self.error_s).powi(2)
    }
}

/// The conclusions from the delays.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Verdict {
    /// Latencies, each with the nats that it explains.
    pub(super) latencies: Vec<(Delay, f64)>,
    /// By how much the reference is early for all triads, s.
    pub(super) offset_s: Option<f64>,
    /// Whether the latency and the clock's offset could not be separated.
    pub(super) open: bool,
}

/// Separates latencies from the clock's offset. A difference counts if it gains at least `price` nats.
pub(super) fn separate(delays: &[Delay], shared: bool, price: f64) -> Verdict {
    let (gyro, accel) = match delays {
        [] => return Verdict::default(),
        [one] => {
            return match (shared && one.seconds > 0.0, one.nats() > price) {
                (_, false) if shared => Verdict::default(),
                (true, _) => Verdict { latencies: vec![(*one, one.nats())], ..Verdict::default() },
                _ => Verdict { offset_s: Some(one.seconds), open: true, ..Verdict::default() },
            };
        }
        [one, other, ..] => (*one, *other),
    };
    let (early, late) = if gyro.seconds <= accel.seconds { (gyro, accel) } else { (accel, gyro) };
    let more =
        Delay { triad: late.triad, seconds: late.seconds - early.seconds, error_s: early.error_s.hypot(late.error_s) };
    let differ = more.nats() > price;
    let weights = [gyro, accel].map(|of| of.error_s.powi(-2));
    let agreed_s = (weights[0] * gyro.seconds + weights[1] * accel.seconds) / (weights[0] + weights[1]);
    if !shared {
        return match differ {
            true => Verdict { latencies: vec![(more, more.nats())], offset_s: Some(early.seconds), open: false },
            false => Verdict { offset_s: Some(agreed_s), ..Verdict::default() },
        };
    }
    let real = |of: &Delay| of.nats() > price;
    match (real(&early), real(&late)) {
        (false, false) => Verdict::default(),
        // The reference is late, as far as one triad can determine this.
        (false, true) if late.seconds < 0.0 => {
            Verdict { offset_s: Some(late.seconds), open: true, ..Verdict::default() }
        }
        // One of them is late, and no evidence shows that the other is late.
        (false, true) => Verdict { latencies: vec![(late, late.nats())], ..Verdict::default() },
        // The reference itself is late.
        (true, _) if early.seconds < 0.0 => Verdict {
            latencies: if differ { vec![(more, more.nats())] } else { Vec::new() },
            offset_s: Some(if differ { early.seconds } else { agreed_s }),
            open: false,
        },
        (true, true) if differ => {
            Verdict { latencies: vec![(late, late.nats()), (early, early.nats())], ..Verdict::default() }
        }
        (true, true) => Verdict { offset_s: Some(agreed_s), open: true, ..Verdict::default() },
        // The other delay is not known well enough to decide.
        (true, false) => Verdict { latencies: vec![(early, early.nats())], ..Verdict::default() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(gyro: (f64, f64), accel: (f64, f64), shared: bool) -> Verdict {
        let delay = |triad, (seconds, error_s)| Delay { triad, seconds, error_s };
        separate(&[delay(Triad::Gyro, gyro), delay(Triad::Accel, accel)], shared, 8.0)
    }

    #[test]
    fn on_one_clock_a_delay_is_a_latency_unless_both_have_it() {
        let found = of((0.02, 1e-4), (0.0, 1e-3), true);
        assert_eq!((found.latencies.len(), found.latencies[0].0.triad, found.offset_s), (1, Triad::Gyro, None));
        // One is known too poorly to decide, one is known well.
        assert_eq!(of((0.02, 1e-4), (0.0, 1.0), true).latencies[0].0.triad, Triad::Gyro);
        let both = of((0.02, 1e-4), (0.0201, 1e-3), true);
        assert!(both.latencies.is_empty() && both.open && (both.offset_s.unwrap() - 0.02).abs() < 1e-4);
        let early = of((-0.1, 1e-4), (-0.1, 1e-3), true);
        assert!(early.latencies.is_empty() && early.offset_s.unwrap() < -0.09);
        assert_eq!(of((1e-4, 1e-4), (1e-3, 1e-3), true), Verdict::default());
        assert_eq!(of((0.02, 1e-4), (0.05, 1e-3), true).latencies.len(), 2);
        let late = of((-0.02, 1e-4), (-0.05, 0.1), true);
        assert!(late.latencies.is_empty() && late.offset_s == Some(-0.02), "{late:?}");
    }

    #[test]
    fn on_a_clock_of_its_own_only_what_one_has_more_is_a_latency() {
        let found = of((0.32, 1e-4), (0.30, 1e-3), false);
        assert_eq!((found.latencies[0].0.triad, found.offset_s), (Triad::Gyro, Some(0.30)));
        assert!((found.latencies[0].0.seconds - 0.02).abs() < 1e-12);
        assert!(of((0.3, 1e-4), (0.3005, 1e-3), false).latencies.is_empty());
        let one = [Delay { triad: Triad::Gyro, seconds: 0.3, error_s: 1e-4 }];
        assert!(separate(&one, false, 8.0).open && separate(&one, false, 8.0).latencies.is_empty());
        assert_eq!(separate(&one, true, 8.0).latencies.len(), 1);
    }
}
