//! Statements that hold after selection: a term is named if the data requires it, and otherwise it has a limit. Both
//! statements hold as often as they claim among the records in which they are made.
//!
//! All statements use signed roots of likelihood ratios. r(c) = ±√(2 log L(ĉ)/L(c)), positive for c below the maximum,
//! is a standard normal number if c is true. The term is named if r(0) reaches a threshold. r(0) − r(c) is how far c
//! lies from 0, so that under c the term is named if r(c) reaches the threshold less that distance.
//!
//! # Source
//! G. J. Feldman, R. D. Cousins, Phys. Rev. D 57 (1998) 3873, for intervals whose coverage does not depend on their
//! content; H. Zhong, R. L. Prentice, Biostatistics 9 (2008) 621, for conditioning on having been selected.
//!
//! # Validation
//! `examples/noise_monte_carlo.rs`; docs/validation.md has the figures.

use statrs::distribution::{ContinuousCDF, Normal};

/// The coverage of intervals and limits.
const CONFIDENCE: f64 = 0.95;
/// A limit fails in no more than this share of all records, named or not. Without this, the limit of a term that was
/// almost named would be unbounded.
const FAILS_AT_MOST: f64 = 1e-3;
/// The limit of a term depends on few squares, whose sum has low values more often than a normal number. This number of
/// deviations accounts for that. Without it, limits of a walk that is usually named held in 84 % of the records that do
/// not name it.
const FEW_SQUARES: f64 = 0.3;
/// From this many deviations on, a term is named in any record.
const BEYOND_DOUBT: f64 = 8.0;
/// Roots are found to this share of the distance between two trials.
const PRECISION: f64 = 1e-4;
const TRIALS: usize = 60;

/// Returns whether c belongs to the interval of a term that is named; below 0 if it does.
///
/// Of the numbers for which the term is named, the 95 % closest to 0 support c.
fn named(r: f64, r_zero: f64, threshold: f64) -> Option<f64> {
    let normal = Normal::standard();
    // A term far beyond doubt is not selected: the difference of two large roots would only lose digits.
    let least = if r_zero < BEYOND_DOUBT { threshold.min(r_zero) - (r_zero - r) } else { f64::NEG_INFINITY };
    let closer = normal.cdf(r.abs()) - normal.cdf(least.max(-r.abs()));
    Some(closer.max(0.0) - CONFIDENCE * normal.sf(least)).filter(|excess| excess.is_finite())
}

/// Returns whether c lies above the limit of a term that is not named; above 0 if it does.
fn limited(r: f64, r_zero: f64, threshold: f64) -> Option<f64> {
    let normal = Normal::standard();
    let unnamed = normal.cdf(threshold - (r_zero - r));
    let allowed = ((1.0 - CONFIDENCE) * unnamed).max(FAILS_AT_MOST);
    // In logarithms, whose zero needs fewer trials.
    let below = normal.cdf(r + FEW_SQUARES).max(f64::MIN_POSITIVE);
    Some(allowed.ln() - below.ln()).filter(|excess| excess.is_finite())
}

/// Returns the 95 % interval of a named term of the value `value`, above 0; `root` is r(c); `r_zero` is r(0), infinite
/// if the term is beyond doubt.
pub(crate) fn interval(
    value: f64,
    r_zero: f64,
    threshold: f64,
    root: &impl Fn(f64) -> Option<f64>,
) -> Option<[f64; 2]> {
    let excess = |c: f64| named(root(c)?, r_zero, threshold);
    let near = value * 1e-3;
    let deviation = (near / (root(value - near)? - root(value + near)?).abs() * 2.0).clamp(1e-7 * value, value);
    let low = if named(r_zero, r_zero, threshold)? <= 0.0 {
        0.0
    } else {
        crossing(value, (value - 1.96 * deviation).max(0.5 * value), |c| 0.5 * c, &excess)?
    };
    let high = crossing(value, value + 1.96 * deviation, |c| c + (c - value).max(0.5 * deviation), &excess)?;
    Some([low, high])
}

/// Returns the 95 % upper limit of a term that is not named; `least` is a value far below any limit.
pub(crate) fn upper_limit(least: f64, r_zero: f64, threshold: f64, root: &impl Fn(f64) -> Option<f64>) -> Option<f64> {
    let excess = |c: f64| limited(root(c)?, r_zero.min(threshold), threshold);
    crossing(least, 2.0 * least, |c| 2.0 * c, &excess)
}

/// Returns the value at which `excess` becomes positive on the way from `inside` through `trial` and the further trials
/// that `further` derives from it.
fn crossing(
    inside: f64,
    trial: f64,
    further: impl Fn(f64) -> f64,
    excess: &impl Fn(f64) -> Option<f64>,
) -> Option<f64> {
    let (mut inside, mut at_inside) = (inside, excess(inside)?);
    if at_inside > 0.0 {
        return Some(inside);
    }
    let (mut outside, mut at_outside) = (trial, excess(trial)?);
    for _ in 0..TRIALS {
        if at_outside > 0.0 {
            break;
        }
        (inside, at_inside) = (outside, at_outside);
        outside = further(outside);
        at_outside = excess(outside)?;
    }
    if at_outside <= 0.0 {
        return None;
    }
    // The Illinois form of the secant, which keeps the zero between its ends.
    let (width, mut last) = ((outside - inside).abs(), 0);
    for _ in 0..TRIALS {
        let span = (outside - inside).abs();
        if span <= PRECISION * width || span <= 1e-9 * outside.abs() {
            break;
        }
        let share = (at_inside / (at_inside - at_outside)).clamp(0.01, 0.99);
        let middle = inside + share * (outside - inside);
        let at_middle = excess(middle)?;
        if at_middle > 0.0 {
            (outside, at_outside) = (middle, at_middle);
            if last == 1 {
                at_inside *= 0.5;
            }
            last = 1;
        } else {
            (inside, at_inside) = (middle, at_middle);
            if last == -1 {
                at_outside *= 0.5;
            }
            last = -1;
        }
    }
    Some(0.5 * (inside + outside))
}

#[cfg(test)]
mod tests {
    use super::*;

    const THRESHOLD: f64 = 2.326;

    /// Returns the statement for one measurement of c = `truth` in units of its standard deviation.
    fn statement(measured: f64) -> (Option<[f64; 2]>, Option<f64>) {
        let r_zero = measured.max(0.0);
        // The likelihood's maximum over c ≥ 0.
        let root = |c: f64| {
            let square = (measured - c).powi(2) - (measured - r_zero).powi(2);
            Some(square.max(0.0).sqrt() * (r_zero - c).signum())
        };
        if r_zero >= THRESHOLD {
            (interval(measured, r_zero, THRESHOLD, &root), None)
        } else {
            (None, upper_limit(1e-3, r_zero, THRESHOLD, &root))
        }
    }

    #[test]
    fn both_statements_hold_wherever_the_truth_lies() {
        for truth in [0.0, 0.5, 1.0, 1.5, 2.3, 3.0, 3.5, 4.0, 5.0, 8.0] {
            let (mut named, mut within, mut limited, mut below) = (0.0, 0.0, 0.0, 0.0);
            let steps = 4000;
            for step in 0..steps {
                let z = -6.0 + 12.0 * (f64::from(step) + 0.5) / f64::from(steps);
                let density = (-0.5 * z * z).exp();
                match statement(truth + z) {
                    (Some([low, high]), None) => {
                        named += density;
                        within += if (low..=high).contains(&truth) { density } else { 0.0 };
                    }
                    (None, Some(limit)) => {
                        limited += density;
                        below += if limit >= truth { density } else { 0.0 };
                    }
                    other => panic!("{other:?} at {truth} + {z}"),
                }
            }
            let all = named + limited;
            println!(
                "truth {truth}: named {:.4}, holds {:.4}; limits hold {:.4}",
                named / all,
                within / named,
                below / limited
            );
            assert!((within / named - 0.95).abs() < 0.005, "{truth}: {}", within / named);
            if limited / all > 0.02 {
                assert!(below / limited > 0.945, "{truth}: {}", below / limited);
            }
            assert!((limited - below) / all < 1.1e-3 || limited / all > 0.02);
        }
    }

    #[test]
    fn a_limit_has_bounds_however_close_the_term_came_to_being_named() {
        let (_, limit) = statement(THRESHOLD - 1e-9);
        assert!((limit.unwrap() - THRESHOLD - 3.09 - FEW_SQUARES).abs() < 0.01, "{limit:?}");
        let (_, limit) = statement(0.0);
        assert!(limit.unwrap() < 2.0 + FEW_SQUARES, "{limit:?}");
    }

    #[test]
    fn beyond_doubt_the_interval_is_the_usual_one() {
        let (interval, _) = statement(20.0);
        let [low, high] = interval.unwrap();
        assert!((low - 18.04).abs() < 2e-3 && (high - 21.96).abs() < 2e-3, "{low} {high}");
    }
}
