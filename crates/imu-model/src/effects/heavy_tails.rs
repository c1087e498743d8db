//! Heavy tails: the white part follows Student's t distribution.

use super::described::effect;
use super::spec::above;
use super::{Effect, Moments, Record, Sampler, Stage, Stream, WhiteMoments, each};
use rand_distr::ChiSquared;

effect! {
    /// Gives the white part Student's t distribution and keeps its variance, and therefore spectrum and Allan variance.
    ///
    /// Each white value z becomes z·√((ν − 2)/χ²), with χ² drawn with ν degrees of freedom: t with ν degrees of
    /// freedom, scaled to the variance of z. Kurtosis 3 + 6/(ν − 4) for ν above 4, infinite below.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct HeavyTails: dyn Effect, 10, Stage::WhitePart, Samples;
    "the white part is Student t distributed, its variance kept";
    degrees_of_freedom: f64 = above(2.0), "", "of Student's t distribution";
}

impl Effect for HeavyTails {
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        Some(0.0)
    }
    fn allan_variance(&self, _m: u64, _record: Record) -> Option<f64> {
        Some(0.0)
    }
    fn white_moments(&self, _record: Record) -> Option<WhiteMoments> {
        let above = self.degrees_of_freedom - 4.0;
        Some(Moments { variance: 1.0, kurtosis: (above > 0.0).then(|| 3.0 + 6.0 / above) })
    }
    fn sampler(&self, _rate_hz: f64, _record_length_s: f64, mut stream: Stream) -> Box<dyn Sampler> {
        // Refused by `check` if it is not above 2; such a sampler leaves the values as they are.
        let law = ChiSquared::new(self.degrees_of_freedom).ok().filter(|_| self.degrees_of_freedom > 2.0);
        let excess = self.degrees_of_freedom - 2.0;
        each(move |value| {
            if let Some(law) = &law {
                *value *= (excess / stream.draw(law)).sqrt();
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    #[test]
    fn variance_spectrum_and_kurtosis_are_those_of_student_t() {
        check::agrees_with_its_closed_forms(&HeavyTails { degrees_of_freedom: 12.0 }, 40.0);
    }

    #[test]
    fn the_distribution_is_student_t() {
        // Share of |t| above the two-sided 5 % and 0.1 % quantiles of t with 4 degrees of freedom (2.776, 8.610), after
        // scaling to variance 1 by √(2/4).
        let values = check::draw_on_white(&HeavyTails { degrees_of_freedom: 4.0 }, 40.0, 1_000_000, 3);
        for (quantile, share) in [(2.776_445, 0.05), (8.610_302, 0.001)] {
            let beyond = values.iter().filter(|value| value.abs() > quantile * 0.5_f64.sqrt()).count() as f64 / 1e6;
            assert!((beyond - share).abs() < 5.0 * (share / 1e6_f64).sqrt(), "{quantile}: {beyond}");
        }
    }

    #[test]
    fn the_factors_are_value_stable() {
        let mut values = [1.0; 3];
        HeavyTails { degrees_of_freedom: 5.0 }.sampler(40.0, 1.0, check::stream(3)).apply(&mut values);
        assert_eq!(values, [0.6156795759486486, 1.226834689437512, 0.6228973259537627]);
    }

    #[test]
    fn two_degrees_of_freedom_have_no_variance_and_are_refused() {
        assert!(HeavyTails { degrees_of_freedom: 2.0 }.check(40.0).is_err());
        assert!(HeavyTails { degrees_of_freedom: f64::INFINITY }.check(40.0).is_err());
    }
}
