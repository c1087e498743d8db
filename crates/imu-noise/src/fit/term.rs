//! The terms of a rate's noise: the contribution of each to the Allan variance and to the spectrum of sampled data.
//!
//! # Source
//! IEEE Std 952-1997, annex C, for the spectra and their Allan variances; the sampled forms follow from
//! σ²(m) = ∫ S(f) · 2 sin⁴(πfmΔt) / (m² sin²(πfΔt)) df between minus and plus half the rate.

use imu_core::variants;
use serde::{Deserialize, Serialize};
use std::f64::consts::{LN_2, PI};
use std::sync::OnceLock;

/// One of the terms in whose squared coefficients an Allan variance is linear.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Hash,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    utoipa::ToSchema,
    strum::IntoStaticStr,
    strum::VariantArray,
)]
pub enum Term {
    /// Angle or velocity random walk: white rate noise, two-sided density N².
    N,
    /// Bias instability: flicker, B²/(2πf).
    B,
    /// Rate random walk, (K/2πf)².
    K,
    /// Quantization noise: white angle of variance Q² per sample at intervals dt, Q² dt (2πf)² at low frequencies.
    Q,
    /// Rate ramp: deterministic.
    R,
}

impl Term {
    /// All five terms.
    pub const ALL: [Self; 5] = variants();

    /// Returns the letter in JSON.
    pub fn letter(self) -> &'static str {
        self.into()
    }

    /// Returns the Allan variance at averaging factor `m` of sampled data for a coefficient of 1; `dt_s` is the
    /// sampling interval.
    ///
    /// # Validation
    /// `every_terms_variance_is_its_spectrums_integral`: the closed forms against the integral, 1e-3 or better.
    pub fn allan_variance(self, m: usize, dt_s: f64) -> f64 {
        let factor = m as f64;
        let tau_s = factor * dt_s;
        match self {
            Self::N => 1.0 / tau_s,
            Self::B => flicker_variance(m),
            Self::K => dt_s * (2.0 * factor * factor + 1.0) / (6.0 * factor),
            Self::Q => 3.0 / (tau_s * tau_s),
            Self::R => tau_s * tau_s / 2.0,
        }
    }

    /// Returns the two-sided spectrum of the sampled rate for a coefficient of 1 at `u` = f·dt in (0, 1/2]; 0 for the
    /// ramp.
    pub fn spectrum(self, u: f64, dt_s: f64) -> f64 {
        let sine = 2.0 * (PI * u).sin();
        match self {
            Self::N => 1.0,
            Self::B => dt_s / (2.0 * PI * u),
            Self::K => (dt_s / sine).powi(2),
            Self::Q => sine * sine / dt_s,
            Self::R => 0.0,
        }
    }
}

/// Returns the two-sided response of the Allan variance of averaging factor `m` at u = f·dt: σ² = ∫ S · response df.
pub(crate) fn response(m: usize, u: f64) -> f64 {
    let m = m as f64;
    2.0 * (PI * u * m).sin().powi(4) / (m * (PI * u).sin()).powi(2)
}

/// Returns the Allan variance of flicker noise that ends at half the sampling rate, for B = 1.
///
/// It is (2 ln 2)/π for large m, and higher at small m, by 19 % at m = 1: the response of sampled differences does not
/// fall towards half the rate as the continuous one does.
fn flicker_variance(m: usize) -> f64 {
    /// Beyond this the deviation from the limit falls as 1/m².
    const EXACT: usize = 64;
    static TABLE: OnceLock<[f64; EXACT + 1]> = OnceLock::new();
    let limit = 2.0 * LN_2 / PI;
    let table = TABLE.get_or_init(|| std::array::from_fn(|m| if m == 0 { limit } else { flicker_integral(m) }));
    match table.get(m) {
        Some(variance) => *variance,
        None => limit + (table[EXACT] - limit) * (EXACT as f64 / m as f64).powi(2),
    }
}

/// Returns 2 ∫₀^½ response(u) / (2πu) du by Simpson's rule, with 64 panels per lobe.
fn flicker_integral(m: usize) -> f64 {
    let panels = 64 * m.max(4);
    let step = 0.5 / panels as f64;
    let at = |index: usize| {
        let u = index as f64 * step;
        // The response is proportional to u² near 0.
        if index == 0 { 0.0 } else { response(m, u) / (PI * u) }
    };
    let inner: f64 = (1..panels).map(|index| if index % 2 == 1 { 4.0 } else { 2.0 } * at(index)).sum();
    (at(0) + inner + at(panels)) * step / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn integral(term: Term, m: usize, dt_s: f64) -> f64 {
        let panels = 200_000;
        let step = 0.5 / f64::from(panels);
        // Uses midpoints: the random walk's integrand is finite at 0 but not computable there.
        (0..panels)
            .map(|panel| (f64::from(panel) + 0.5) * step)
            .map(|u| 2.0 * term.spectrum(u, dt_s) * response(m, u) * step / dt_s)
            .sum()
    }

    #[test]
    fn every_terms_variance_is_its_spectrums_integral() {
        for dt_s in [0.025, 1.0 / 800.0] {
            for term in [Term::N, Term::B, Term::K, Term::Q] {
                for m in [1, 2, 3, 10, 64, 100, 1000] {
                    let (closed, integral) = (term.allan_variance(m, dt_s), integral(term, m, dt_s));
                    assert!((closed / integral - 1.0).abs() < 1e-4, "{term:?} m = {m}: {closed} {integral}");
                }
            }
        }
    }

    #[test]
    fn flickers_flat_level_is_two_ln_two_over_pi() {
        assert!((Term::B.allan_variance(100_000, 0.025).sqrt() - 0.664_28).abs() < 1e-5);
        let (inside, outside) = (Term::B.allan_variance(64, 1.0), Term::B.allan_variance(65, 1.0));
        assert!((inside / outside - 1.0).abs() < 1e-5);
        assert!((Term::B.allan_variance(1, 1.0) / Term::B.allan_variance(100_000, 1.0) - 1.189).abs() < 1e-3);
    }
}
