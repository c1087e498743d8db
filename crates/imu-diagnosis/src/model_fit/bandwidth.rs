//! Bandwidth: the filter that a noise report found becomes the effect of a model, or its sampling.
//!
//! A model's N lies in front of its filters; `imu-noise` has the plateau, which includes noise that enters behind them. The
//! simulation of the model has the recorded spectrum (`tests` below; `cargo test --test it a_filter_of_a_record`).

use imu_model::effects::{Effect, EffectKind, LowPass, MovingAverage};
use imu_model::simulator::Sampling;
use imu_noise::NoiseReport;
use imu_noise::fit::Bandwidth;
use imu_noise::whittle;
use std::f64::consts::PI;
use std::sync::Arc;

/// N in front of a channel's filter relative to the plateau, and the filter.
#[derive(Debug, Clone)]
pub(super) struct Front {
    /// N over the plateau.
    pub(super) share: f64,
    /// None if noise is white up to half the rate.
    pub(super) filter: Option<Arc<dyn Effect>>,
}

impl Front {
    /// All of N and no filter.
    pub(super) const OPEN: Self = Self { share: 1.0, filter: None };

    /// Returns the front of a channel with this bandwidth and plateau `n`, U/√Hz, at `rate_hz`. `None` if no effect has
    /// that shape.
    pub(super) fn of(bandwidth: &Bandwidth, n: f64, rate_hz: f64) -> Option<Self> {
        let behind = bandwidth.white_behind.unwrap_or(0.0).min(n);
        let front = (n * n - behind * behind).sqrt();
        let of = |front: f64, filter: Arc<dyn Effect>| {
            Some(Self { share: if n > 0.0 { front / n } else { 1.0 }, filter: Some(filter) })
        };
        match (EffectKind::from_name(&bandwidth.kind)?, bandwidth.value?) {
            (EffectKind::MovingAverage, window) => {
                // Every R-th mean of W samples is the mean of W/R of the sent samples, if R divides W.
                let every = bandwidth.internal_rate_hz.map_or(1.0, |internal_hz| (internal_hz / rate_hz).round());
                let window = window / every;
                let whole = window.fract() == 0.0 && window >= 1.0;
                whole.then_some(())?;
                of(front, Arc::new(MovingAverage { window: window as u64, white_behind: behind }))
            }
            (EffectKind::LowPass, cutoff_hz) if bandwidth.exponential => {
                // y += a (x − y) passes the same as the bilinear low pass of first order with a part T² behind it. T is
                // the tangent of its half angle, (1 − b)/(1 + b), b = 1 − a.
                let back = 1.0 - whittle::exponential_weight(cutoff_hz / rate_hz);
                let t = (1.0 - back) / (1.0 + back);
                let white_behind = (t * front).hypot(behind);
                let cutoff_hz = t.atan() / PI * rate_hz;
                of(front * (1.0 - t * t).sqrt(), Arc::new(LowPass { cutoff_hz, order: 1, white_behind }))
            }
            (EffectKind::LowPass, cutoff_hz) => {
                let order = u64::from(bandwidth.order.unwrap_or(1));
                of(front, Arc::new(LowPass { cutoff_hz, order, white_behind: behind }))
            }
            _ => None,
        }
    }
}

/// Returns the sampling that all channels of a report share, if all are known to lie behind the same boxcar and it
/// shapes them all. The sampling's rate is the whole multiple of the report's rate that agrees with the known one
/// within the clocks' difference, because a model allows no other.
pub(super) fn sampling(report: &NoiseReport) -> Option<Sampling> {
    let of = |bandwidth: Option<&Bandwidth>| {
        let bandwidth =
            bandwidth.filter(|bandwidth| EffectKind::from_name(&bandwidth.kind) == Some(EffectKind::MovingAverage))?;
        Some((bandwidth.internal_rate_hz?, bandwidth.value?))
    };
    let mut all = report.channels.values().map(|found| of(found.bandwidth.as_ref()));
    let (internal_rate_hz, window) = all.next()??;
    let same = all.all(|other| other == Some((internal_rate_hz, window)));
    let known = whittle::Sampling { internal_rate_hz, window: window as u32, source: String::new() };
    let internal_rate_hz = f64::from(known.every(report.rate_hz).filter(|_| same)?) * report.rate_hz;
    Some(Sampling { internal_rate_hz, filter_window: window as u64 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_core::sample::Channel;

    fn bandwidth(kind: &str, value: f64) -> Bandwidth {
        Bandwidth {
            kind: kind.to_owned(),
            value: Some(value),
            unit: String::new(),
            order: None,
            ci95: None,
            up_to_hz: None,
            white_behind: None,
            internal_rate_hz: None,
            exponential: false,
            source: String::new(),
        }
    }

    /// Returns |H|² of all parts of a channel of plateau 1.
    fn gain(front: &Front, frequency_hz: f64, rate_hz: f64) -> f64 {
        let filter = front.filter.as_ref().unwrap();
        front.share.powi(2) * filter.power_gain(frequency_hz, rate_hz) + filter.psd(frequency_hz, rate_hz).unwrap()
    }

    #[test]
    fn an_exponential_average_is_a_low_pass_with_noise_behind_it() {
        for cutoff_hz in [2.0, 8.0] {
            let own = Bandwidth { exponential: true, ..bandwidth("low_pass", cutoff_hz) };
            let front = Front::of(&own, 1.0, 40.0).unwrap();
            assert!((gain(&front, cutoff_hz, 40.0) - 0.5).abs() < 1e-9);
            let c = 1.0 - (2.0 * PI * cutoff_hz / 40.0).cos();
            let a = (c * c + 2.0 * c).sqrt() - c;
            for frequency_hz in [1e-6, 1.0, 5.0, 12.0, 19.0] {
                let turn = (2.0 * PI * frequency_hz / 40.0).cos();
                let exact = a * a / (1.0 - 2.0 * (1.0 - a) * turn + (1.0 - a).powi(2));
                assert!((gain(&front, frequency_hz, 40.0) - exact).abs() < 1e-9, "{cutoff_hz} {frequency_hz}");
            }
        }
    }

    #[test]
    fn the_plateau_stays_whatever_lies_behind_the_filter() {
        for own in [bandwidth("moving_average", 4.0), bandwidth("low_pass", 7.0)] {
            for behind in [0.0, 0.3] {
                let front = Front::of(&Bandwidth { white_behind: Some(behind), ..own.clone() }, 1.0, 40.0).unwrap();
                assert!((gain(&front, 1e-6, 40.0) - 1.0).abs() < 1e-9);
            }
        }
        assert!(Front::of(&bandwidth("other", 7.0), 1.0, 40.0).is_none());
    }

    #[test]
    fn a_sampling_is_one_that_a_model_may_have() {
        let mut found = imu_noise::fit::fit(&[], 40.0, Channel::GyroX);
        found.bandwidth = Some(Bandwidth { internal_rate_hz: Some(800.0), ..bandwidth("moving_average", 4.0) });
        let mut report: NoiseReport = serde_json::from_value(
            serde_json::json!({"format": "", "capture": "", "rate_hz": 40, "duration_s": 50, "samples": 2000,
            "missing": 0, "complete": true, "channels": {}, "datasheet": null}),
        )
        .unwrap();
        report.channels.insert(Channel::GyroX, found);
        for (rate_hz, every) in [(40.0, Some(20)), (39.9926, Some(20)), (39.5, None)] {
            report.rate_hz = rate_hz;
            assert_eq!(sampling(&report).map(|of| of.decimation(rate_hz)), every.map(Some), "{rate_hz}");
        }
    }

    #[test]
    fn a_known_boxcar_is_the_mean_of_what_is_sent_where_the_rates_allow_it() {
        let at = |rate_hz: f64, window: f64| {
            let own = Bandwidth { internal_rate_hz: Some(800.0), ..bandwidth("moving_average", window) };
            let front = Front::of(&own, 1.0, rate_hz)?;
            front.filter?.parameters().first().and_then(|(_, value)| value.as_u64())
        };
        assert_eq!((at(800.0, 4.0), at(400.0, 4.0), at(400.0, 3.0)), (Some(4), Some(2), None));
    }
}
