//! Spikes: single samples that are far off.

use super::described::effect;
use super::spec::{FROM_ZERO, Form, Need, Range};
use super::{Effect, Moments, Record, Refusal, Sampler, Stage, Stream, each};

effect! {
    /// Single samples that are off by about `amplitude`, at random times.
    ///
    /// Each sample has a spike with probability `rate_hz`/rate, with random sign and a size spread evenly over half to
    /// one and a half times `amplitude` (mean and median are `amplitude`). The spectrum is white.
    ///
    /// With `cluster` above 1, spikes come on neighbouring samples. At every sample a cluster begins with the same
    /// probability s, and a cluster continues with probability q = 1 − 1/`cluster`. The number of spikes in a cluster
    /// is therefore geometric with that mean (except for clusters that touch). `rate_hz` stays the mean number of
    /// spikes, not of clusters: s = π(1 − q)/(1 − πq) with π = `rate_hz`/rate. Sizes and signs are independent, so that
    /// the spectrum stays white.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Spikes: dyn Effect, 9, Stage::Noise, Samples;
    "single samples far off, at random times and with random sign";
    rate_hz: f64 = FROM_ZERO, "Hz", "spikes per second on average; up to the rate at which they act";
    amplitude: f64 = FROM_ZERO, "U", "typical size, U; sizes spread evenly from half of it to one and a half";
    cluster: f64 = Form::Number(Range::From(1.0)), "",
        "mean number of spikes in one cluster, on neighbouring samples", Need::Unwritten(1.0);
}

/// Mean square and fourth moment of a number spread evenly over 0.5 … 1.5.
const SQUARE: f64 = 13.0 / 12.0;
const FOURTH: f64 = 1.5125;

impl Spikes {
    /// Creates spikes that come one by one, `rate_hz` per second and of typical size `amplitude` in U.
    pub const fn new(rate_hz: f64, amplitude: f64) -> Self {
        Self { rate_hz, amplitude, cluster: 1.0 }
    }

    /// Returns the variance of a sample at `rate_hz`.
    fn variance(&self, rate_hz: f64) -> f64 {
        SQUARE * self.amplitude * self.amplitude * self.rate_hz / rate_hz
    }
}

impl Effect for Spikes {
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        if self.rate_hz <= rate_hz {
            return Ok(());
        }
        let allowed = format!("at most {rate_hz} spikes per second, one for every sample");
        Err(Self::SPEC.refuse("rate_hz", format!("{} Hz", self.rate_hz), allowed))
    }
    fn psd(&self, _frequency_hz: f64, rate_hz: f64) -> Option<f64> {
        Some(self.variance(rate_hz) / rate_hz)
    }
    fn allan_variance(&self, m: u64, record: Record) -> Option<f64> {
        Some(self.variance(record.rate_hz) / m as f64)
    }
    fn moments(&self, record: Record) -> Option<Moments> {
        let kurtosis = FOURTH / (SQUARE * SQUARE) * record.rate_hz / self.rate_hz;
        Some(Moments { variance: self.variance(record.rate_hz), kurtosis: kurtosis.is_finite().then_some(kurtosis) })
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        let share = self.rate_hz / rate_hz;
        let goes_on = 1.0 - 1.0 / self.cluster;
        // With single spikes, all three are `share`, to the last bit.
        let begins = share * (1.0 - goes_on) / (1.0 - share * goes_on);
        let again = if goes_on > 0.0 { goes_on + (1.0 - goes_on) * begins } else { begins };
        // The probability of a spike on the next sample is `again` after a sample with one, else `begins`.
        let (amplitude, mut next) = (self.amplitude, share);
        each(move |value| {
            let is_one = stream.uniform() < next;
            next = if is_one { again } else { begins };
            if is_one {
                let size = amplitude * (0.5 + stream.uniform());
                *value += if stream.uniform() < 0.5 { size } else { -size };
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn spectrum_allan_variance_and_moments_are_those_of_spikes() {
        check::agrees_with_its_closed_forms(&Spikes::new(0.7, 5.0), 40.0);
    }

    #[test]
    fn their_number_and_median_size_are_the_parameters() {
        let values = check::draw(&Spikes::new(0.5, 3.0), 100.0, 1_000_000, 4);
        let mut sizes: Vec<f64> = values.iter().filter(|value| **value != 0.0).map(|value| value.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        // 5000 expected; five standard deviations are 353.
        assert!((sizes.len() as f64 - 5000.0).abs() < 353.0, "{}", sizes.len());
        assert!((sizes[sizes.len() / 2] - 3.0).abs() < 0.11);
        assert!(sizes[0] >= 1.5 && sizes[sizes.len() - 1] <= 4.5);
        let positive = values.iter().filter(|value| **value > 0.0).count() as f64;
        assert!((positive / sizes.len() as f64 - 0.5).abs() < 5.0 * 0.0071);
    }

    #[test]
    fn spikes_in_clusters_have_the_same_closed_forms() {
        check::agrees_with_its_closed_forms(&Spikes { cluster: 3.5, ..Spikes::new(0.7, 5.0) }, 40.0);
    }

    #[test]
    fn clusters_hold_as_many_as_they_should() {
        let of = Spikes { cluster: 4.0, ..Spikes::new(0.5, 3.0) };
        let is_one: Vec<bool> = check::draw(&of, 100.0, 1_000_000, 4).iter().map(|value| *value != 0.0).collect();
        let count = is_one.iter().filter(|is_one| **is_one).count() as f64;
        let clusters = is_one.windows(2).filter(|pair| pair[1] && !pair[0]).count() as f64;
        // 5000 spikes in 1250 clusters, each number with a standard deviation of √12.
        assert!((count / 5000.0 - 1.0).abs() < 5.0 * 0.037, "{count}");
        assert!((count / clusters / 4.0 - 1.0).abs() < 5.0 * 0.025, "{clusters}");
    }

    /// Single spikes have the same values as before clusters were added.
    #[test]
    fn single_spikes_are_value_stable() {
        let values = check::draw(&Spikes::new(2.0, 1.0), 40.0, 400, 1);
        let mut stream = check::stream(1);
        for value in values {
            let mut expected = 0.0;
            if stream.uniform() < 2.0 / 40.0 {
                let size = 0.5 + stream.uniform();
                expected = if stream.uniform() < 0.5 { size } else { -size };
            }
            assert_eq!(value, expected);
        }
    }

    #[test]
    fn more_spikes_than_samples_are_refused() {
        assert!(Spikes::new(41.0, 1.0).check(40.0).is_err());
        assert!(Spikes::new(1.0, -1.0).check(40.0).is_err());
        assert!(Spikes { cluster: 0.9, ..Spikes::new(1.0, 1.0) }.check(40.0).is_err());
        assert_eq!(Spikes { cluster: 1.0, ..Spikes::new(1.0, 1.0) }.check(40.0), Ok(()));
    }
}
