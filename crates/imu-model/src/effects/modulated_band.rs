//! Modulated band: a resonance that grows and fades along a profile.

use super::spec::{Form, Kind, Need, Parameter, Range, number};
use super::stream::number as streams;
use super::{Effect, Moments, Record, Refusal, Resonance, Sampler, Spec, Stage, Stream, profile};
use serde_json::Value;
use std::sync::Arc;

/// Narrow-band noise as that of [`Resonance`], times a factor that follows a profile.
///
/// Spectrum and Allan variance vary over time, and over a record depend on the profile's position in it: `None`. While the factor
/// is constant they are the resonance's times its square.
#[derive(Debug, Clone, PartialEq)]
pub struct ModulatedBand {
    /// The resonance at times at which the factor is 1.
    pub band: Resonance,
    /// Time in s after the start, factor on the amplitude; linear in between, constant beyond.
    pub level: Vec<(f64, f64)>,
}

static SPEC: Spec = Spec {
    name: "modulated_band",
    stream: streams::MODULATED_BAND,
    stage: Stage::Noise,
    parameters: &[
        number("frequency_hz", Range::Above(0.0), "centre, Hz; below half the rate at which it acts"),
        number("bandwidth_hz", Range::Above(0.0), "full width at half power, Hz"),
        number("sigma", Range::FromZero, "root mean square where the factor is 1, U"),
        Parameter {
            name: "level",
            form: Form::Profile,
            need: Need::Always,
            meaning: "[t_s, factor on the amplitude], linear in between",
        },
    ],
    forms: &[],
    meaning: "noise in a narrow band that grows and fades along a profile",
};
pub(super) static KIND: Kind<dyn Effect> = Kind {
    spec: &SPEC,
    make: |values| {
        Arc::new(ModulatedBand {
            band: Resonance::new(values.number("frequency_hz"), values.number("bandwidth_hz"), values.number("sigma")),
            level: values.pairs("level"),
        })
    },
};

impl Effect for ModulatedBand {
    fn spec(&self) -> &'static Spec {
        &SPEC
    }
    fn parameters(&self) -> Vec<(&'static str, Value)> {
        let mut parameters = self.band.parameters();
        parameters.push(("level", profile::value(&self.level)));
        parameters
    }
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        SPEC.below_nyquist("frequency_hz", self.band.frequency_hz, rate_hz)
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        None
    }
    fn stationary(&self, record: Record) -> Option<Arc<dyn Effect>> {
        let square = profile::mean_power_of(&self.level, record.length_s(), 2);
        Some(Arc::new(Resonance { sigma: self.band.sigma * square.sqrt(), ..self.band }))
    }
    fn allan_variance(&self, _m: u64, _record: Record) -> Option<f64> {
        None
    }
    fn moments(&self, record: Record) -> Option<Moments> {
        Some(profile::moments(self.band.sigma * self.band.sigma, &self.level, record.length_s()))
    }
    fn sampler(&self, rate_hz: f64, record_length_s: f64, stream: Stream) -> Box<dyn Sampler> {
        let band = self.band.sampler(rate_hz, record_length_s, stream);
        Box::new(profile::Weighted::new(band, profile::Course::new(&self.level, rate_hz)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;

    fn modulated(level: &[(f64, f64)]) -> ModulatedBand {
        let band = Resonance::new(7.3, 2.0, 0.4);
        ModulatedBand { band, level: level.to_vec() }
    }

    #[test]
    fn moments_are_the_resonances_times_the_profiles() {
        check::agrees_with_its_closed_forms(&modulated(&[(50.0, 0.5), (200.0, 2.0), (300.0, 0.1)]), 40.0);
    }

    #[test]
    fn a_constant_factor_is_the_resonance_that_much_louder() {
        let of = modulated(&[(0.0, 3.0), (1.0, 3.0)]);
        let draw = |seed| check::draw(&of, 40.0, check::SAMPLES, seed);
        let psd = |f| 9.0 * of.band.psd(f, 40.0).unwrap();
        check::spectrum_agrees("modulated_band", check::Window::Hann, draw, 40.0, psd);
        let plain = check::draw(&of.band, 40.0, 1000, 5);
        let louder = check::draw(&of, 40.0, 1000, 5);
        assert!(plain.iter().zip(louder).all(|(plain, louder)| (3.0 * plain - louder).abs() < 1e-12));
    }

    #[test]
    fn senseless_parameters_are_refused() {
        assert!(modulated(&[(0.0, 1.0)]).check(40.0).is_err());
        assert!(modulated(&[(0.0, 1.0), (1.0, -1.0)]).check(40.0).is_err());
        assert!(modulated(&[(0.0, 1.0), (1.0, 1.0)]).check(14.0).is_err());
        assert_eq!(modulated(&[(0.0, 1.0), (1.0, 1.0)]).check(40.0), Ok(()));
    }
}
