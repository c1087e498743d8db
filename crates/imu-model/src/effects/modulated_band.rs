//! Modulated band: a resonance that grows and fades along a profile.

use super::described::described;
use super::spec::{FROM_ZERO, Form, Parameter, above};
use super::{Effect, Extent, Moments, Record, Refusal, Resonance, Sampler, Stage, Stream, profile};
use std::sync::Arc;

/// The narrow-band noise of a [`Resonance`], times a factor that follows a profile.
///
/// Spectrum and Allan variance vary over time, and depend on the profile's position in the record: `None`. While the
/// factor is constant, they are those of the resonance times its square.
#[derive(Debug, Clone, PartialEq)]
pub struct ModulatedBand {
    /// The resonance at times at which the factor is 1.
    pub band: Resonance,
    /// Time in s after the start, factor on the amplitude; linear in between, constant beyond.
    pub level: Vec<(f64, f64)>,
}

described! {
    ModulatedBand: dyn Effect, 20, Stage::Noise;
    "noise in a narrow band that grows and fades along a profile"
        => "a band of vibration at {frequency_hz:.2} Hz, {bandwidth_hz:.2} Hz wide, whose level changes{more}";
    [
        Parameter::new("frequency_hz", above(0.0), "Hz", "centre, Hz; below half the rate at which it acts"),
        Parameter::new("bandwidth_hz", above(0.0), "Hz", "full width at half power, Hz"),
        Parameter::new("sigma", FROM_ZERO, "U", "root mean square where the factor is 1, U"),
        Parameter::new("level", Form::Profile, "", "[t_s, factor on the amplitude], linear in between"),
    ];
    |values| ModulatedBand {
        band: Resonance::new(values.number("frequency_hz"), values.number("bandwidth_hz"), values.number("sigma")),
        level: values.pairs("level"),
    },
    |of| {
        let mut parameters = of.band.parameters();
        parameters.push(("level", profile::value(&of.level)));
        parameters
    }
}

impl Effect for ModulatedBand {
    fn check_at(&self, rate_hz: f64) -> Result<(), Refusal> {
        Self::SPEC.below_nyquist("frequency_hz", self.band.frequency_hz, rate_hz)
    }
    fn extents(&self) -> Vec<Extent> {
        self.band.extents()
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
