//! Causes of inflation: which effect makes N and K of a filter larger than those of the Allan deviation.
//!
//! In: a channel's moments by cause. Out: the fitted pair without each cause and with each alone, and one sentence. A cause
//! is necessary if the pair is smaller without it. Two causes that each suffice are found by the pair with one alone.

use super::document::{Cause, Inflation};
use super::fit::Family;
use super::moments::{Moments, add};
use super::real::Real;
use super::request::Grid;

/// A parameter within this part of that of the Allan deviation is not inflated.
const INFLATED: f64 = 0.05;
/// A cause is named if it is this part of the logarithm of an inflation, and changes the parameter by more than
/// [`NAMED_FROM`].
const NAMED_SHARE: f64 = 0.15;
const NAMED_FROM: f64 = 0.03;
/// The most causes that a sentence names for a parameter.
const NAMED_MOST: usize = 3;

/// Returns N and K of the closest pair.
fn pair(family: &Family, grid: &Grid, real: &[f64]) -> [f64; 2] {
    let found = family.closest(&family.seen(grid, real));
    [found.white.sqrt(), found.second.sqrt()]
}

/// Returns what each cause beside white noise and walk adds to the closest pair.
pub(crate) fn causes(family: &Family, grid: &Grid, real: &Real) -> Vec<Cause> {
    let mut base: Moments = vec![0.0; grid.pairs.len()];
    real.parts.iter().filter(|part| part.is_known()).for_each(|part| add(&mut base, 1.0, &part.moments));
    let others = real.parts.iter().enumerate().filter(|(_, part)| !part.is_known());
    let one = |(place, part): (usize, &super::real::Part)| {
        let mut alone = base.clone();
        add(&mut alone, 1.0, &part.moments);
        Cause {
            cause: part.cause.clone(),
            without: pair(family, grid, &real.without(Some(place))),
            alone: pair(family, grid, &alone),
        }
    };
    others.map(one).collect()
}

/// Returns the inflation of a fitted pair with its causes, such as `N × 4.1: tone at 13.38 Hz; K × 12: warm_up`.
pub(crate) fn summary(fit: [f64; 2], inflation: Inflation, base: [f64; 2], causes: &[Cause]) -> String {
    let inflation = [inflation.n, inflation.k];
    let words = |place: usize| {
        let name = ["N", "K"][place];
        let size = match inflation[place] {
            Some(ratio) => format!("{name} × {}", rounded(ratio)),
            None if fit[place] > 0.0 => format!("{name} {:.2e} (Allan: 0 or unknown)", fit[place]),
            None => format!("{name} 0"),
        };
        let is_larger = inflation[place].map_or(fit[place] > 0.0, |ratio| ratio > 1.0 + INFLATED);
        let named = if is_larger { named(place, fit, base, causes) } else { Vec::new() };
        if named.is_empty() { size } else { format!("{size}: {}", named.join(", ")) }
    };
    format!("{}; {}", words(0), words(1))
}

/// Returns the causes of one parameter, the largest first.
fn named(place: usize, fit: [f64; 2], base: [f64; 2], causes: &[Cause]) -> Vec<String> {
    let all = (fit[place] / base[place]).ln().max(INFLATED);
    // A parameter that is 0 without a cause is all its own.
    let chosen = |gain: &dyn Fn(&Cause) -> f64| {
        let mut found: Vec<(f64, &Cause)> = causes.iter().map(|cause| (gain(cause), cause)).collect();
        found.retain(|(gain, _)| *gain > NAMED_FROM && (*gain >= NAMED_SHARE * all || all.is_infinite()));
        found.sort_by(|one, other| other.0.total_cmp(&one.0));
        let largest = found.first().map_or(0.0, |(gain, _)| *gain);
        found.retain(|(gain, _)| gain.is_infinite() || *gain >= NAMED_SHARE * largest);
        found.truncate(NAMED_MOST);
        found.iter().map(|(_, cause)| cause.cause.clone()).collect::<Vec<String>>()
    };
    let necessary = chosen(&|cause: &Cause| (fit[place] / cause.without[place]).ln());
    if necessary.is_empty() { chosen(&|cause: &Cause| (cause.alone[place] / base[place]).ln()) } else { necessary }
}

/// Returns a ratio with two significant digits.
fn rounded(ratio: f64) -> String {
    if ratio < 9.95 { format!("{ratio:.1}") } else { format!("{ratio:.0}") }
}
