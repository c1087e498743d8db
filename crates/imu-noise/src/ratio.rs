//! Ratios: how a noise parameter of one recording compares with that of another.
//!
//! In: two estimates of one parameter. Out: their ratio with a 95 % interval, and whether they differ. Pure.
//!
//! The interval is made of the two estimates' own intervals: on logarithms their distances from the values add in squares
//! (Zou and Donner 2008, "Construction of confidence limits about effect measures: a general approach"). It holds if the
//! recordings are independent. Of twenty equal pairs one differs by chance.

use crate::fit::Estimate;

/// The ratio of two values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ratio {
    /// The second value over the first.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: [f64; 2],
}

/// What two recordings say about the second value beside the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Difference {
    /// The intervals allow equal values.
    Same,
    /// The second value is smaller.
    Smaller,
    /// The second value is larger.
    Larger,
    /// The recordings cannot tell: a value is missing, or has another unit.
    Unknown,
}

/// Compares two estimates of one parameter; the ratio is `None` unless both have a value with an interval above 0.
pub fn compare(first: &Estimate, second: &Estimate) -> (Option<Ratio>, Difference) {
    if first.unit != second.unit {
        return (None, Difference::Unknown);
    }
    let difference = match (known(first), known(second)) {
        (Some(first), Some(second)) => {
            let ratio = ratio(first, second);
            let [low, high] = ratio.ci95;
            let difference = match (low > 1.0, high < 1.0) {
                (true, _) => Difference::Larger,
                (_, true) => Difference::Smaller,
                _ => Difference::Same,
            };
            return (Some(ratio), difference);
        }
        (Some((_, [low, _])), None) if second.upper_limit95.is_some_and(|limit| limit < low) => Difference::Smaller,
        (None, Some((_, [low, _]))) if first.upper_limit95.is_some_and(|limit| limit < low) => Difference::Larger,
        _ => Difference::Unknown,
    };
    (None, difference)
}

/// Returns the value and its interval, if all are above 0.
fn known(of: &Estimate) -> Option<(f64, [f64; 2])> {
    let (value, ends) = of.value.zip(of.ci95)?;
    [value, ends[0], ends[1]].into_iter().all(|of| of > 0.0 && of.is_finite()).then_some((value, ends))
}

fn ratio((first, [first_low, first_high]): (f64, [f64; 2]), (second, [low, high]): (f64, [f64; 2])) -> Ratio {
    let value = second / first;
    let below = (second / low).ln().hypot((first_high / first).ln());
    let above = (high / second).ln().hypot((first / first_low).ln());
    Ratio { value, ci95: [value * (-below).exp(), value * above.exp()] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Term;
    use imu_core::sample::Channel;

    fn of(value: f64, ci95: [f64; 2]) -> Estimate {
        Estimate::identified(Channel::GyroX, Term::N, value, ci95)
    }

    fn below(limit: f64) -> Estimate {
        Estimate { value: None, ci95: None, upper_limit95: Some(limit), identified: false, ..of(1.0, [1.0; 2]) }
    }

    #[test]
    fn a_ratio_has_an_interval_of_both_and_tells_what_differs() {
        let five_percent = |value: f64| of(value, [value / 1.05, value * 1.05]);
        let (ratio, difference) = compare(&five_percent(1e-4), &five_percent(1.05e-4));
        let ratio = ratio.unwrap();
        // Intervals that overlap by far may still differ; these do not: 1.05^√2 = 1.071.
        let factor = 1.05_f64.powf(2_f64.sqrt());
        assert!(
            (ratio.value - 1.05).abs() < 1e-12 && (ratio.ci95[1] / ratio.value - factor).abs() < 1e-12,
            "{ratio:?}"
        );
        assert_eq!(difference, Difference::Same);
        assert_eq!(compare(&five_percent(1e-4), &five_percent(1.08e-4)).1, Difference::Larger);
        assert_eq!(compare(&five_percent(1.08e-4), &five_percent(1e-4)).1, Difference::Smaller);
        // The interval of the inverse is the inverse of the interval, also of lopsided ones.
        let (one, two) = (of(1.0, [0.8, 1.1]), of(2.0, [1.9, 3.0]));
        let [there, back] = [compare(&one, &two), compare(&two, &one)].map(|(ratio, _)| ratio.unwrap());
        assert!(
            (there.ci95[0] * back.ci95[1] - 1.0).abs() < 1e-12 && (there.ci95[1] * back.ci95[0] - 1.0).abs() < 1e-12
        );
    }

    #[test]
    fn a_limit_tells_only_what_is_above_it() {
        let known = of(1e-4, [0.9e-4, 1.1e-4]);
        assert_eq!(compare(&known, &below(0.8e-4)), (None, Difference::Smaller));
        assert_eq!(compare(&below(0.8e-4), &known), (None, Difference::Larger));
        assert_eq!(compare(&known, &below(1e-4)), (None, Difference::Unknown));
        assert_eq!(compare(&below(1.0), &below(1e-9)), (None, Difference::Unknown));
        for odd in [of(0.0, [0.0, 1.0]), of(f64::NAN, [1.0, 2.0]), of(1.0, [0.0, 2.0])] {
            assert_eq!(compare(&odd, &known), (None, Difference::Unknown));
        }
        let other = Estimate { unit: "°/√h".to_owned(), ..known.clone() };
        assert_eq!(compare(&known, &other), (None, Difference::Unknown));
    }

    #[test]
    fn intervals_that_hold_give_a_ratio_whose_interval_holds() {
        // Two parameters with scatters of 3 and 10 % of a logarithm, as their intervals state.
        let (mut held, cases, z) = (0, 20_000, 1.959_964);
        let mut seed = 7_u64;
        let mut normal = || {
            let mut uniform = || {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                ((seed >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
            };
            (-2.0 * uniform().ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos()
        };
        for _ in 0..cases {
            let [one, two] = [(2.0, 0.03), (3.0, 0.1)].map(|(truth, scatter): (f64, f64)| {
                let value = truth * (scatter * normal()).exp();
                of(value, [value * (-z * scatter).exp(), value * (z * scatter).exp()])
            });
            let [low, high] = compare(&one, &two).0.unwrap().ci95;
            held += usize::from((low..=high).contains(&1.5));
        }
        let share = held as f64 / f64::from(cases);
        assert!((share - 0.95).abs() < 0.006, "{share}");
    }
}
