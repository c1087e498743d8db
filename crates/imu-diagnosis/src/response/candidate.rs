//! Candidates: which effects a fit may add, their parameters, and effects made of fitted values.

use imu_core::sample::Triad;
use imu_model::effects::triad::{
    Axes, Bias, CrossAxisSensitivity, GSensitivity, Latency, Misalignment, Rectification, Saturation, ScaleFactor,
    ScaleFactorNonlinearity, TemperatureScale,
};
use imu_model::effects::{EffectKind, TriadEffect, USUAL_TEMPERATURE_C};
use std::sync::Arc;

/// A standard error of a fraction or an angle above which a motion carries no information about it. Sensors are made to 1–2 %,
/// and beyond a tenth an effect of first order has no meaning.
const UNSEEN_FRACTION: f64 = 0.1;

/// An effect to fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Candidate {
    /// [`Bias`].
    Bias,
    /// [`ScaleFactor`].
    ScaleFactor,
    /// [`ScaleFactorNonlinearity`].
    ScaleFactorNonlinearity {
        /// F, U; the fitted fractions refer to it.
        full_scale: f64,
        /// ω·|ω| instead of ω².
        signed: bool,
    },
    /// [`Misalignment`].
    Misalignment,
    /// [`CrossAxisSensitivity`].
    CrossAxisSensitivity,
    /// [`GSensitivity`] of a gyroscope.
    GSensitivity,
    /// [`Rectification`].
    Rectification,
    /// [`TemperatureScale`].
    TemperatureScale {
        /// The temperature at which it vanishes, °C.
        reference_c: f64,
    },
    /// [`Latency`].
    Latency,
    /// [`Saturation`]. Clipped samples are found and left out in any case; as a candidate it is among the effects found.
    Saturation,
}

/// Returns whether two effects are of one kind and form.
pub(crate) fn is_alike(one: &dyn TriadEffect, other: &dyn TriadEffect) -> bool {
    one.kind() == other.kind() && one.parameter("form") == other.parameter("form")
}

impl Candidate {
    /// Returns all candidates that make sense on `triad`, nonlinearity in both forms with this full scale (U).
    pub fn all(triad: Triad, full_scale: f64) -> Vec<Self> {
        let all = [
            Self::Bias,
            Self::ScaleFactor,
            Self::ScaleFactorNonlinearity { full_scale, signed: false },
            Self::ScaleFactorNonlinearity { full_scale, signed: true },
            Self::Misalignment,
            Self::CrossAxisSensitivity,
            Self::GSensitivity,
            Self::Rectification,
            Self::TemperatureScale { reference_c: USUAL_TEMPERATURE_C },
            Self::Latency,
            Self::Saturation,
        ];
        all.into_iter().filter(|candidate| candidate.make(&[]).triads().contains(&triad)).collect()
    }

    /// Returns the kind of the effect.
    pub fn kind(self) -> EffectKind {
        self.make(&[]).kind()
    }

    /// Returns the suffix that distinguishes the candidate from others of its name, with a space.
    pub(crate) fn form(self) -> &'static str {
        match self {
            Self::ScaleFactorNonlinearity { signed: true, .. } => "signed ",
            Self::ScaleFactorNonlinearity { signed: false, .. } => "unsigned ",
            _ => "",
        }
    }

    /// Returns the effect with these coefficients, in the order of [`TriadEffect::coefficients`]; missing ones are 0. A
    /// latency is never below 0. A saturation's one coefficient is its range.
    pub fn make(self, coefficients: &[f64]) -> Arc<dyn TriadEffect> {
        let at = |place: usize| coefficients.get(place).copied().unwrap_or(0.0);
        let axes: Axes = std::array::from_fn(at);
        match self {
            Self::Bias => Arc::new(Bias { axes }),
            Self::ScaleFactor => Arc::new(ScaleFactor { axes }),
            Self::ScaleFactorNonlinearity { full_scale, signed } => {
                Arc::new(ScaleFactorNonlinearity { axes, full_scale, signed })
            }
            Self::Misalignment => Arc::new(Misalignment { rotation: axes }),
            Self::CrossAxisSensitivity => Arc::new(CrossAxisSensitivity { xy: at(0), xz: at(1), yz: at(2) }),
            Self::GSensitivity => {
                let row = |row: usize| std::array::from_fn(|column| at(3 * row + column));
                Arc::new(GSensitivity { m: std::array::from_fn(row) })
            }
            Self::Rectification => Arc::new(Rectification { axes }),
            Self::TemperatureScale { reference_c } => Arc::new(TemperatureScale { axes, reference_c }),
            Self::Latency => Arc::new(Latency { seconds: at(0).max(0.0) }),
            Self::Saturation => Arc::new(Saturation { range: at(0) }),
        }
    }

    /// Returns the names of the coefficients: `x`, `xy`, `m[0][2]`, `seconds`.
    pub fn parameters(self) -> Vec<String> {
        match self {
            Self::GSensitivity => (0..9).map(|place| format!("m[{}][{}]", place / 3, place % 3)).collect(),
            _ => {
                let effect = self.make(&[]);
                let count = effect.coefficients().len().max(1);
                effect.parameters().into_iter().take(count).map(|(name, _)| name.to_owned()).collect()
            }
        }
    }

    /// Returns whether a regression fits the candidate: the response without memory is linear in its coefficients.
    pub(super) fn is_linear(self) -> bool {
        !matches!(self, Self::Latency | Self::Saturation)
    }

    /// Returns the coefficients that a known effect gives this candidate; `None` if it is another effect.
    pub(super) fn coefficients_of(self, known: &dyn TriadEffect) -> Option<Vec<f64>> {
        is_alike(known, &*self.make(&[])).then_some(())?;
        let mut coefficients = known.coefficients();
        if let Self::ScaleFactorNonlinearity { full_scale, .. } = self {
            // x·ω²/F is the same deviation for x·F'/F at F'.
            let of = known.number("full_scale").unwrap_or(full_scale);
            coefficients.iter_mut().for_each(|coefficient| *coefficient *= full_scale / of);
        }
        Some(coefficients)
    }

    /// Returns the standard error from which on a record carries no information about one of the coefficients.
    pub(super) fn unseen(self) -> f64 {
        match self {
            Self::ScaleFactor
            | Self::ScaleFactorNonlinearity { .. }
            | Self::Misalignment
            | Self::CrossAxisSensitivity
            | Self::TemperatureScale { .. } => UNSEEN_FRACTION,
            // In the triad's own units, no size is too large to make sense.
            Self::Bias | Self::GSensitivity | Self::Rectification => f64::INFINITY,
            Self::Latency | Self::Saturation => Latency::SECONDS_MAX,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use imu_model::effects::TRIAD;

    #[test]
    fn every_effect_on_a_triad_is_a_candidate() {
        let found: Vec<EffectKind> =
            Candidate::all(Triad::Gyro, 35.0).iter().map(|candidate| candidate.kind()).collect();
        for kind in TRIAD.iter().map(|of| of.spec.kind) {
            let forms = if kind == EffectKind::ScaleFactorNonlinearity { 2 } else { 1 };
            assert_eq!(found.iter().filter(|own| **own == kind).count(), forms, "{kind}");
        }
        assert!(!Candidate::all(Triad::Accel, 157.0).contains(&Candidate::GSensitivity));
    }

    #[test]
    fn effects_are_made_of_their_coefficients_and_give_them_back() {
        for candidate in Candidate::all(Triad::Gyro, 35.0).into_iter().filter(|candidate| candidate.is_linear()) {
            let names = candidate.parameters();
            let values: Vec<f64> = (0..names.len()).map(|place| 1e-3 * (place as f64 + 1.0)).collect();
            let effect = candidate.make(&values);
            assert_eq!(effect.coefficients(), values, "{}", effect.name());
            assert_eq!(candidate.coefficients_of(effect.as_ref()), Some(values));
            assert_eq!(Candidate::Latency.coefficients_of(effect.as_ref()), None);
        }
        assert_eq!(Candidate::Latency.parameters(), ["seconds"]);
        assert_eq!(Candidate::CrossAxisSensitivity.parameters(), ["xy", "xz", "yz"]);
        assert_eq!(Candidate::GSensitivity.parameters()[5], "m[1][2]");
    }

    #[test]
    fn a_nonlinearity_of_another_full_scale_is_the_same_deviation() {
        let at = |full_scale| Candidate::ScaleFactorNonlinearity { full_scale, signed: true };
        let known = at(20.0).make(&[1e-3, 0.0, 0.0]);
        assert_eq!(at(40.0).coefficients_of(known.as_ref()), Some(vec![2e-3, 0.0, 0.0]));
        let other = Candidate::ScaleFactorNonlinearity { full_scale: 40.0, signed: false };
        assert_eq!(other.coefficients_of(known.as_ref()), None);
    }
}
