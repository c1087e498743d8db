//! Change of variance: the white part's amplitude depends on time or temperature.

use super::described::described;
use super::spec::{ANY, FROM_ZERO, Form, Need, Parameter, above};
use super::{
    Effect, Extent, Moments, Record, Sampler, Stage, Stream, Temperature, USUAL_TEMPERATURE_C, WhiteMoments, profile,
};

/// A factor on the amplitude of the white part; the other noise stays unchanged.
///
/// The contribution to spectrum and Allan variance depends on N: `None`. [`Effect::white_moments`] has the factor's
/// mean square over a record, by which the white density grows.
#[derive(Debug, Clone, PartialEq)]
pub enum VarianceChange {
    /// A factor inside an interval, 1 outside.
    Interval {
        /// First instant inside, s after the start.
        from_s: f64,
        /// First instant after the interval, s.
        to_s: f64,
        /// Factor on the amplitude.
        factor: f64,
    },
    /// Factors at instants, linear between them and constant before the first and after the last.
    Profile(Vec<(f64, f64)>),
    /// exp(`per_c`·(T − `reference_c`)): for small changes, `per_c` is the relative growth per °C.
    PerDegree {
        /// Logarithmic growth per degree, 1/°C.
        per_c: f64,
        /// The temperature at which the factor is 1, °C.
        reference_c: f64,
    },
}

const fn in_form(name: &'static str, form: Form, unit: &'static str, meaning: &'static str) -> Parameter {
    Parameter::new(name, form, unit, meaning).needed(Need::InItsForm)
}

described! {
    VarianceChange: dyn Effect, 0, Stage::WhitePart;
    "a factor on the amplitude of the white part, in an interval, by a profile or by temperature";
    [
        in_form("from_s", Form::Time, "s", "begin of the interval, s after the start"),
        in_form("to_s", Form::Time, "s", "its end, s; after `from_s`"),
        in_form("factor", FROM_ZERO, "", "on the amplitude of the white part, inside"),
        in_form("profile", Form::Profile, "", "[t_s, factor], linear in between"),
        in_form("per_c", ANY, "1/°C", "the factor is exp(per_c·(T − reference_c)), 1/°C"),
        Parameter::new("reference_c", above(-273.15), "°C", "with `per_c`: the temperature at which the factor is 1, °C")
            .needed(Need::Default(USUAL_TEMPERATURE_C)),
    ],
    &[&["from_s", "to_s", "factor"], &["profile"], &["per_c", "reference_c"]];
    |values| if let Some(per_c) = values.optional("per_c") {
        VarianceChange::PerDegree { per_c, reference_c: values.number("reference_c") }
    } else if let Some(factor) = values.optional("factor") {
        VarianceChange::Interval { from_s: values.number("from_s"), to_s: values.number("to_s"), factor }
    } else {
        VarianceChange::Profile(values.pairs("profile"))
    },
    |of| match of {
        VarianceChange::Interval { from_s, to_s, factor } => {
            vec![("from_s", (*from_s).into()), ("to_s", (*to_s).into()), ("factor", (*factor).into())]
        }
        VarianceChange::Profile(points) => vec![("profile", profile::value(points))],
        VarianceChange::PerDegree { per_c, reference_c } => {
            vec![("per_c", (*per_c).into()), ("reference_c", (*reference_c).into())]
        }
    }
}

impl VarianceChange {
    /// Returns the factor at an instant.
    pub fn factor(&self, time_s: f64, temperature_c: f64) -> f64 {
        match self {
            Self::Interval { from_s, to_s, factor } => {
                if (*from_s..*to_s).contains(&time_s) {
                    *factor
                } else {
                    1.0
                }
            }
            Self::Profile(points) => profile::factor(points, time_s),
            Self::PerDegree { per_c, reference_c } => (per_c * (temperature_c - reference_c)).exp(),
        }
    }

    /// Returns the mean of the factor's `power`th power over `length_s`, without temperature.
    fn mean_power(&self, length_s: f64, power: i32) -> Option<f64> {
        let cuts = match self {
            Self::Interval { from_s, to_s, .. } => vec![*from_s, *to_s],
            Self::Profile(points) => points.iter().map(|point| point.0).collect(),
            Self::PerDegree { .. } => return None,
        };
        Some(profile::mean_power(cuts, length_s, power, |time_s| self.factor(time_s, 0.0)))
    }
}

impl Effect for VarianceChange {
    fn check_at(&self, _rate_hz: f64) -> Result<(), super::Refusal> {
        match self {
            Self::Interval { from_s, to_s, .. } if from_s >= to_s => {
                Err(Self::SPEC.refuse("to_s", format!("{to_s} s"), format!("a time after `from_s`, {from_s} s")))
            }
            _ => Ok(()),
        }
    }
    fn extents(&self) -> Vec<Extent> {
        // A profile acts where its factor differs from 1 by more than half of its largest deviation.
        let [from_s, to_s] = match self {
            Self::Interval { from_s, to_s, .. } => [*from_s, *to_s],
            Self::Profile(points) => {
                let far = |point: &(f64, f64)| point.1.ln().abs();
                let most = points.iter().map(far).fold(0.0, f64::max);
                let mut loud = points.iter().filter(|point| far(point) >= 0.5 * most).map(|point| point.0);
                let first = loud.next().unwrap_or_default();
                [first, loud.next_back().unwrap_or(first)]
            }
            Self::PerDegree { .. } => return Vec::new(),
        };
        if from_s < to_s { vec![Extent::time(from_s, to_s, 1.0)] } else { Vec::new() }
    }
    fn psd(&self, _frequency_hz: f64, _rate_hz: f64) -> Option<f64> {
        None
    }
    fn allan_variance(&self, _m: u64, _record: Record) -> Option<f64> {
        None
    }
    fn white_moments(&self, record: Record) -> Option<WhiteMoments> {
        let variance = self.mean_power(record.length_s(), 2)?;
        let fourth = 3.0 * self.mean_power(record.length_s(), 4)?;
        Some(Moments { variance, kurtosis: (variance > 0.0).then(|| fourth / (variance * variance)) })
    }
    fn sampler(&self, rate_hz: f64, _record_length_s: f64, _stream: Stream) -> Box<dyn Sampler> {
        Box::new(ChangeSampler { change: self.clone(), rate_hz, index: 0 })
    }
}

#[derive(Debug)]
struct ChangeSampler {
    change: VarianceChange,
    rate_hz: f64,
    index: u64,
}

impl Sampler for ChangeSampler {
    fn act(&mut self, values: &mut [f64], temperature: Temperature<'_>) {
        for (place, value) in values.iter_mut().enumerate() {
            *value *= self.change.factor(self.index as f64 / self.rate_hz, temperature.at(place));
            self.index += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::check;
    use super::*;
    use serde_json::json;

    #[test]
    fn the_white_part_grows_by_the_stated_factor() {
        let interval = VarianceChange::Interval { from_s: 100.0, to_s: 200.0, factor: 3.0 };
        let profile = VarianceChange::Profile(vec![(50.0, 0.5), (200.0, 2.0), (300.0, 1.0)]);
        for change in [interval, profile] {
            check::agrees_with_its_closed_forms(&change, 40.0);
        }
    }

    #[test]
    fn the_factor_follows_interval_profile_and_temperature() {
        let interval = VarianceChange::Interval { from_s: 1.0, to_s: 2.0, factor: 3.0 };
        assert_eq!([0.9, 1.0, 1.9, 2.0].map(|t| interval.factor(t, 0.0)), [1.0, 3.0, 3.0, 1.0]);
        let profile = VarianceChange::Profile(vec![(1.0, 1.0), (3.0, 2.0)]);
        assert_eq!([0.0, 1.0, 2.0, 3.0, 9.0].map(|t| profile.factor(t, 0.0)), [1.0, 1.0, 1.5, 2.0, 2.0]);
        let warm = VarianceChange::PerDegree { per_c: 0.02, reference_c: 25.0 };
        assert!((warm.factor(0.0, 35.0) - 0.2_f64.exp()).abs() < 1e-15);
        let mut values = [1.0, 1.0];
        warm.sampler(1.0, 1.0, check::stream(1)).act(&mut values, Temperature::Series(&[25.0, 26.0]));
        assert_eq!(values, [1.0, 0.02_f64.exp()]);
    }

    #[test]
    fn the_forms_are_not_mixed() {
        let read = |entry: serde_json::Value| {
            VarianceChange::DEFINITION.read(entry.as_object().unwrap()).map_err(|refusal| refusal.found)
        };
        assert!(read(json!({"per_c": 0.01})).is_ok());
        assert!(read(json!({"per_c": 0.01, "reference_c": 20.0})).is_ok());
        assert_eq!(read(json!({"reference_c": 20.0})).unwrap_err(), "`reference_c`");
        assert_eq!(
            read(json!({"profile": [[0, 1], [1, 2]], "reference_c": 20.0})).unwrap_err(),
            "`profile`, `reference_c`"
        );
        assert_eq!(read(json!({})).unwrap_err(), "no parameter");
    }

    #[test]
    fn an_interval_that_ends_before_it_begins_is_refused() {
        assert!(VarianceChange::Interval { from_s: 2.0, to_s: 1.0, factor: 1.0 }.check(40.0).is_err());
        assert!(VarianceChange::Profile(vec![(0.0, 1.0)]).check(40.0).is_err());
        assert!(VarianceChange::Profile(vec![(1.0, 1.0), (1.0, 2.0)]).check(40.0).is_err());
    }
}
