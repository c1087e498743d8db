//! Equivalent degrees of freedom of deviations, and the confidence intervals that follow from them.
//!
//! # Source
//! C. A. Greenhall and W. J. Riley, "Uncertainty of stability variances based on finite differences", PTTI 2003, equations
//! 7 to 13 and tables 1 to 3 (the algorithm of Stable32); Riley & Howe, NIST SP1065 (2008), table 7 for the total deviation.
//! Intervals: χ² quantiles, SP1065 equation 45.

use super::Estimator;
use imu_core::variants;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// The dominant kind of noise at an averaging time; α is the exponent of the rate's spectrum, S(f) ∝ f^α.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[derive(strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "snake_case")]
pub enum NoiseType {
    /// α = 2: white angle, Q.
    WhiteAngle,
    /// α = 1: flicker angle.
    FlickerAngle,
    /// α = 0: white rate, N.
    WhiteRate,
    /// α = −1: flicker rate, B.
    FlickerRate,
    /// α = −2: rate random walk, K (and anything steeper).
    RandomWalkRate,
}

impl NoiseType {
    /// All kinds, from α = 2 down.
    pub const ALL: [Self; 5] = variants();

    /// Returns the name in JSON and CSV.
    pub fn name(self) -> &'static str {
        self.into()
    }

    /// Returns the exponent of the spectrum.
    pub fn alpha(self) -> i32 {
        match self {
            Self::WhiteAngle => 2,
            Self::FlickerAngle => 1,
            Self::WhiteRate => 0,
            Self::FlickerRate => -1,
            Self::RandomWalkRate => -2,
        }
    }

    /// Returns the kind whose Allan variance is proportional to τ^`slope`: −2 angle noise, −1 white rate, 0 flicker, 1
    /// random walk.
    pub fn of_variance_slope(slope: f64) -> Self {
        match slope {
            slope if slope > 0.5 => Self::RandomWalkRate,
            slope if slope > -0.5 => Self::FlickerRate,
            slope if slope > -1.5 => Self::WhiteRate,
            _ => Self::WhiteAngle,
        }
    }
}

/// Longest basic sum that is computed in full; beyond it the paper's fits and interpolations are used.
const LONGEST_SUM: f64 = 100.0;

/// Returns the equivalent degrees of freedom of one deviation.
///
/// `phases` is the number of phases (samples + 1) of one segment. The result is at least 1 if the estimator has a term;
/// 0 if it has none.
///
/// # Validation
/// `equivalent_degrees_of_freedom_are_those_of_the_reference_table`: within 1e-3 of allantools' `edf_greenhall` at
/// 720,001 phases for every averaging factor and α of the table.
pub fn equivalent_degrees_of_freedom(estimator: Estimator, noise: NoiseType, m: usize, phases: u64) -> f64 {
    let edf = match estimator {
        Estimator::Adev => greenhall(noise, 2, m, phases, false, false),
        Estimator::Oadev => greenhall(noise, 2, m, phases, true, false),
        Estimator::Mdev => greenhall(noise, 2, m, phases, true, true),
        Estimator::Hdev => greenhall(noise, 3, m, phases, false, false),
        Estimator::Ohdev => greenhall(noise, 3, m, phases, true, false),
        Estimator::Totdev => total(noise, m, phases),
    };
    edf.map_or(0.0, |edf| edf.max(1.0))
}

/// Smallest averaging factor of the total variance's own table: below it hardly any term is reflected, and terms are
/// not as dense as the table assumes.
const TABLE_FROM: usize = 8;

/// Returns the degrees of NIST SP1065, table 7, from m = 8 on, and those of the overlapping estimator below. For angle
/// noise, which the table lacks, the equation for α = 2 of the overlapping estimator is used.
fn total(noise: NoiseType, m: usize, phases: u64) -> Option<f64> {
    // A segment of fewer samples than the averaging factor has no term.
    if m as u64 + 1 >= phases {
        return None;
    }
    if m < TABLE_FROM {
        return greenhall(noise, 2, m, phases, true, false);
    }
    let (n, m) = (phases as f64, m as f64);
    let (b, c) = match noise {
        NoiseType::WhiteRate => (1.50, 0.0),
        NoiseType::FlickerRate => (1.17, 0.22),
        NoiseType::RandomWalkRate => (0.93, 0.36),
        NoiseType::FlickerAngle => {
            let (blocks, terms) = ((n - 1.0) / (2.0 * m), (2.0 * m + 1.0) * (n - 1.0) / 4.0);
            return (blocks > 1.0).then(|| (blocks.ln() * terms.ln()).sqrt().exp());
        }
        NoiseType::WhiteAngle => return (n > 2.0 * m).then(|| (n + 1.0) * (n - 2.0 * m) / (2.0 * (n - m))),
    };
    Some(b * n / m - c)
}

/// Returns the ratio of the expected total variance to the Allan variance, for segments of these numbers of phases
/// together.
///
/// # Source
/// C. A. Greenhall, D. A. Howe and D. B. Percival, "Total variance, an estimator of long-term frequency stability", IEEE
/// Trans. UFFC 46 (1999) 1183: 1 − a·τ/T.
pub(super) fn total_bias(noise: NoiseType, m: usize, phases: impl Iterator<Item = u64>) -> f64 {
    let a = match noise {
        NoiseType::FlickerRate => 1.0 / (3.0 * std::f64::consts::LN_2),
        NoiseType::RandomWalkRate => 0.75,
        _ => 0.0,
    };
    // A segment of T samples gives T − 1 terms.
    let (mut sum, mut weights) = (0.0, 0.0);
    for samples in phases.map(|phases| phases.saturating_sub(1) as f64).filter(|samples| *samples > m as f64) {
        sum += (samples - 1.0) * (1.0 - a * m as f64 / samples);
        weights += samples - 1.0;
    }
    if weights > 0.0 { sum / weights } else { 1.0 }
}

/// Computes the combined algorithm with d the order of the difference, S = m if overlapped, else 1, and F = 1 if
/// modified, else m. `None` without a term.
fn greenhall(noise: NoiseType, d: usize, m: usize, phases: u64, overlapping: bool, modified: bool) -> Option<f64> {
    let alpha = noise.alpha();
    let (n, averaging, order) = (phases as f64, m as f64, d as f64);
    let filter = if modified { 1.0 } else { averaging };
    let stride = if overlapping { averaging } else { 1.0 };
    let length = averaging / filter + averaging * order;
    if length > n {
        return None;
    }
    let terms = 1.0 + (stride * (n - length) / averaging).floor();
    let sum_length = terms.min((order + 1.0) * stride);
    let blocks = terms / stride;
    let short = sum_length <= LONGEST_SUM;
    let many = blocks > order + 1.0;
    let interpolated = LONGEST_SUM / blocks;
    let sum = |j: f64, count: f64, stride: f64, filter: f64| basic_sum(j, count, stride, filter, alpha, d);
    let centre = |filter: f64| sz(0.0, filter, alpha, d).powi(2);
    let inverse = if modified {
        if short {
            sum(sum_length, terms, stride, 1.0) / (centre(1.0) * terms)
        } else if many {
            let (a0, a1) = table_modified(alpha, d);
            (a0 - a1 / blocks) / blocks
        } else {
            sum(LONGEST_SUM, LONGEST_SUM, interpolated, 1.0) / (centre(1.0) * LONGEST_SUM)
        }
    } else if alpha <= 0 {
        if short {
            let filter = if averaging * (order + 1.0) <= LONGEST_SUM { averaging } else { f64::INFINITY };
            sum(sum_length, terms, stride, filter) / (centre(filter) * terms)
        } else if many {
            let (a0, a1) = table_unmodified(alpha, d);
            (a0 - a1 / blocks) / blocks
        } else {
            sum(LONGEST_SUM, LONGEST_SUM, interpolated, f64::INFINITY) / (centre(f64::INFINITY) * LONGEST_SUM)
        }
    } else if alpha == 1 {
        // Table 3: the centre grows with the logarithm of m.
        let (b0, b1) = if d == 2 { (15.23, 12.0) } else { (47.8, 40.0) };
        let growing = (b0 + b1 * averaging.ln()).powi(2);
        if short {
            sum(sum_length, terms, stride, averaging) / (centre(averaging) * terms)
        } else if many {
            let (a0, a1) = table_unmodified(alpha, d);
            (a0 - a1 / blocks) / (growing * blocks)
        } else {
            sum(LONGEST_SUM, LONGEST_SUM, interpolated, interpolated) / (growing * LONGEST_SUM)
        }
    } else {
        // White angle: differences share phases only at multiples of m (equation 13), computed in full with few blocks,
        // else in closed form.
        let (a0, a1) = if d == 2 { (35.0 / 18.0, 1.0) } else { (231.0 / 100.0, 1.5) };
        if blocks.ceil() <= order { shared_phases(d, blocks) / terms } else { (a0 - a1 / blocks) / terms }
    };
    (inverse.is_finite() && inverse > 0.0).then(|| 1.0 / inverse)
}

/// Returns 1 + 2 Σ (1 − k/r) ρₖ² over the k below ⌈r⌉, with ρₖ = C(2d, d − k)/C(2d, d): terms over degrees of freedom
/// if r `blocks` are at most d.
fn shared_phases(d: usize, blocks: f64) -> f64 {
    let correlation = if d == 2 { [4.0 / 6.0, 1.0 / 6.0] } else { [15.0 / 20.0, 6.0 / 20.0] };
    let shared = (1..).zip(correlation).take_while(|(k, _)| f64::from(*k) < blocks);
    1.0 + 2.0 * shared.map(|(k, rho): (u32, f64)| (1.0 - f64::from(k) / blocks) * rho * rho).sum::<f64>()
}

/// Returns a0 and a1 of table 1 (modified variances) for d = 2 and 3.
fn table_modified(alpha: i32, d: usize) -> (f64, f64) {
    match (alpha, d) {
        (2, 2) => (7.0 / 9.0, 0.5),
        (1, 2) => (0.997, 0.616),
        (0, 2) => (1.033, 0.607),
        (-1, 2) => (1.048, 0.534),
        (_, 2) => (1.302, 0.535),
        (2, _) => (22.0 / 25.0, 2.0 / 3.0),
        (1, _) => (1.141, 0.843),
        (0, _) => (1.184, 0.848),
        (-1, _) => (1.180, 0.816),
        _ => (1.175, 0.777),
    }
}

/// Returns a0 and a1 of table 2 (unmodified variances) for d = 2 and 3.
fn table_unmodified(alpha: i32, d: usize) -> (f64, f64) {
    match (alpha, d) {
        (1, 2) => (790.0, 410.0),
        (0, 2) => (2.0 / 3.0, 1.0 / 3.0),
        (-1, 2) => (0.852, 0.375),
        (_, 2) => (1.079, 0.368),
        (1, _) => (9950.0, 6520.0),
        (0, _) => (7.0 / 9.0, 0.5),
        (-1, _) => (0.997, 0.617),
        _ => (1.033, 0.607),
    }
}

/// Returns the generalised autocovariance of phase (equation 7).
fn sw(t: f64, alpha: i32) -> f64 {
    let t = t.abs();
    match alpha {
        2 => -t,
        0 => t.powi(3),
        -2 => t.powi(5),
        -4 => t.powi(7),
        _ if t == 0.0 => 0.0,
        1 => t.powi(2) * t.ln(),
        -1 => t.powi(4) * t.ln(),
        _ => t.powi(6) * t.ln(),
    }
}

/// Returns the autocovariance of phase averaged over `1/filter` (equation 8); `filter` is infinite in the limit of many samples.
fn sx(t: f64, filter: f64, alpha: i32) -> f64 {
    if filter.is_infinite() {
        return sw(t, alpha + 2);
    }
    filter * filter * (2.0 * sw(t, alpha) - sw(t - 1.0 / filter, alpha) - sw(t + 1.0 / filter, alpha))
}

/// Returns the autocovariance of the differences of order d (equation 9).
fn sz(t: f64, filter: f64, alpha: i32, d: usize) -> f64 {
    let sx = |t: f64| sx(t, filter, alpha);
    if d == 2 {
        6.0 * sx(t) - 4.0 * (sx(t - 1.0) + sx(t + 1.0)) + sx(t - 2.0) + sx(t + 2.0)
    } else {
        20.0 * sx(t) - 15.0 * (sx(t - 1.0) + sx(t + 1.0)) + 6.0 * (sx(t - 2.0) + sx(t + 2.0))
            - sx(t - 3.0)
            - sx(t + 3.0)
    }
}

/// Returns the basic sum (equation 10).
fn basic_sum(j: f64, terms: f64, stride: f64, filter: f64, alpha: i32, d: usize) -> f64 {
    let square = |lag: f64| sz(lag / stride, filter, alpha, d).powi(2);
    let inner: f64 = (1..j as u64).map(|lag| 2.0 * (1.0 - lag as f64 / terms) * square(lag as f64)).sum();
    square(0.0) + (1.0 - j / terms) * square(j) + inner
}

/// Two-sided interval of a deviation as factors on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConfidenceFactors {
    /// Lower end over the deviation, below 1.
    pub low: f64,
    /// Upper end over the deviation, above 1.
    pub high: f64,
}

/// The confidence of one standard deviation, erf(1/√2).
pub const CONFIDENCE_68: f64 = 0.682_689_492_137_085_9;
/// The confidence of 95 %.
pub const CONFIDENCE_95: f64 = 0.95;

/// Returns the interval that contains a deviation's true value with probability `confidence`, given `edf` degrees of
/// freedom; `None` if there are none.
///
/// # Source
/// NIST SP1065, equation 45. Above 10^5 degrees the quantiles are those of Wilson and Hilferty (relative error below 1e-9).
pub fn confidence_factors(edf: f64, confidence: f64) -> Option<ConfidenceFactors> {
    let tail = (1.0 - confidence) / 2.0;
    let factor = |probability: f64| Some((edf / chi_squared_quantile(probability, edf)?).sqrt());
    let (low, high) = (factor(1.0 - tail)?, factor(tail)?);
    (low.is_finite() && high.is_finite()).then_some(ConfidenceFactors { low, high })
}

/// Returns the value at which the χ² distribution reaches `probability`.
pub(crate) fn chi_squared_quantile(probability: f64, degrees: f64) -> Option<f64> {
    const LARGE: f64 = 1e5;
    if !(degrees.is_finite() && degrees > 0.0) {
        return None;
    }
    if degrees > LARGE {
        let normal = statrs::distribution::Normal::standard().inverse_cdf(probability);
        let spread = 2.0 / (9.0 * degrees);
        return Some(degrees * (1.0 - spread + normal * spread.sqrt()).powi(3));
    }
    let quantile = ChiSquared::new(degrees).ok()?.inverse_cdf(probability);
    quantile.is_finite().then_some(quantile)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_term_has_no_degrees_and_few_have_at_least_one() {
        for noise in NoiseType::ALL {
            assert_eq!(equivalent_degrees_of_freedom(Estimator::Oadev, noise, 10, 20), 0.0);
            for phases in [21, 22, 25, 30, 31, 45] {
                for estimator in [Estimator::Oadev, Estimator::Adev, Estimator::Ohdev, Estimator::Mdev] {
                    let edf = equivalent_degrees_of_freedom(estimator, noise, 10, phases);
                    assert!(
                        edf == 0.0 || (1.0..=phases as f64).contains(&edf),
                        "{noise:?} {estimator:?} {phases}: {edf}"
                    );
                }
            }
        }
    }

    #[test]
    fn quantiles_join_without_a_step() {
        for probability in [0.025, 0.158_655, 0.841_345, 0.975] {
            let below = chi_squared_quantile(probability, 99_999.999).unwrap();
            let above = chi_squared_quantile(probability, 100_000.001).unwrap();
            assert!(((above - below) / below).abs() < 1e-7, "{probability}: {below} {above}");
        }
        assert_eq!(chi_squared_quantile(0.5, 0.0), None);
        assert_eq!(chi_squared_quantile(0.5, f64::NAN), None);
    }

    #[test]
    fn a_noise_has_one_name() {
        for noise in NoiseType::ALL {
            assert_eq!(serde_json::to_value(noise).unwrap(), noise.name());
        }
    }

    #[test]
    fn a_slope_names_its_noise() {
        let named: Vec<_> = [-2.0, -1.0, 0.0, 1.0, 2.0].into_iter().map(NoiseType::of_variance_slope).collect();
        assert_eq!(
            named,
            [
                NoiseType::WhiteAngle,
                NoiseType::WhiteRate,
                NoiseType::FlickerRate,
                NoiseType::RandomWalkRate,
                NoiseType::RandomWalkRate
            ]
        );
    }
}
