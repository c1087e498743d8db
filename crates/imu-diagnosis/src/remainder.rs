//! The remainder: the part of the gap that no known effect explains, how large it is, and whether it is material.

use super::report::{Of, Place, Remainder, Verdict};
use std::collections::BTreeSet;

/// If the remainder exceeds this part of the gap, the verdict is `unknown_effect`, unless the caller chooses another
/// part.
pub const MATERIAL: f64 = 0.02;

impl Remainder {
    /// Creates the remainder from the places of a record. `all` is the number of its samples on all channels; `is_fact` holds for
    /// places of effects that values and stamps show without inference: their nats are counts of samples, and no part of the gap.
    /// `None` if nothing remains.
    pub(super) fn of(
        places: &[Place],
        what: BTreeSet<String>,
        all: f64,
        is_fact: impl Fn(&Place) -> bool,
    ) -> Option<Self> {
        let own = || places.iter().filter(|place| place.of == Of::Remainder);
        let channels: BTreeSet<&str> = own().map(|place| place.channel.as_str()).collect();
        let nats: f64 = own().map(|place| place.nats).sum();
        let gap: f64 = places.iter().filter(|place| !is_fact(place)).map(|place| place.nats).sum();
        (!channels.is_empty()).then(|| Self {
            share: nats / gap.max(f64::MIN_POSITIVE),
            nats: nats / all.max(1.0),
            channels: channels.into_iter().map(str::to_owned).collect(),
            what: what.into_iter().collect(),
        })
    }
}

/// Returns the verdict: unknown only if the remainder exceeds a part of the gap.
pub(super) fn verdict(remainder: Option<&Remainder>, above: f64, has_causes: bool, has_parameters: bool) -> Verdict {
    match (remainder.is_some_and(|of| of.share > above), has_causes, has_parameters) {
        (true, ..) => Verdict::UnknownEffect,
        (false, true, _) => Verdict::Effects,
        (false, false, true) => Verdict::Parameters,
        (false, false, false) => Verdict::NoGap,
    }
}

/// Returns the nats of a likelihood ratio whose local value is half of a square z²: n/2·ln(1 + z²/n), as for one
/// regressor among `samples` normal values (Seber & Lee 2003, Linear Regression Analysis, 4.3). Moments grow without
/// bound; a likelihood does not.
pub(super) fn bounded(half_square: f64, samples: f64) -> f64 {
    // A value that is not a number counts as 0; an infinite value counts as a finite maximum.
    let half_square = if half_square.is_nan() { 0.0 } else { half_square.min(0.25 * f64::MAX) };
    0.5 * samples * (2.0 * half_square / samples).ln_1p()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_material_remainder_is_unknown() {
        let of = |share| {
            let fact = Place::in_tests(Of::Cause(1), 1e3);
            let places = [fact, Place::in_tests(Of::Cause(0), 1.0 - share), Place::in_tests(Of::Remainder, share)];
            Remainder::of(&places, [].into(), 1e4, |place| place.of == Of::Cause(1))
        };
        let decide = |share: f64| verdict(of(share).as_ref(), MATERIAL, share < 1.0, false);
        assert_eq!(decide(0.5), Verdict::UnknownEffect);
        assert_eq!(decide(0.019), Verdict::Effects);
        assert_eq!(decide(1.0), Verdict::UnknownEffect);
        assert_eq!(verdict(of(0.019).as_ref(), MATERIAL, false, true), Verdict::Parameters);
        assert_eq!(verdict(None, MATERIAL, false, false), Verdict::NoGap);
        let remainder = of(0.5).unwrap();
        assert_eq!((remainder.share, remainder.nats, remainder.channels), (0.5, 0.05, vec!["gyro_x".to_owned()]));
        assert_eq!(Remainder::of(&[Place::in_tests(Of::Cause(0), 1.0)], ["x".to_owned()].into(), 1.0, |_| false), None);
    }

    #[test]
    fn a_moment_is_worth_its_square_when_small_and_its_logarithm_when_large() {
        assert!((bounded(30.0, 65_536.0) - 30.0).abs() < 0.05);
        assert!(bounded(4e9, 40_000.0) < 3e5);
        assert!(bounded(f64::INFINITY, 40_000.0).is_finite());
        assert!(bounded(f64::NAN, 40_000.0).abs() < f64::EPSILON);
    }
}
