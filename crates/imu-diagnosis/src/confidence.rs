//! Confidence: how often causes of a given kind were right in sealed cases of the wide trial (docs/validation.md).
//!
//! The search knows by how many nats a cause leads over the next best reading. It cannot know about effects outside the
//! library. Such effects show in three ways: in a remainder beside a cause, in a small share of the gap, and in few
//! independent values of a narrow band. A line that wanders or comes and goes also has few independent values.

use super::report::{Cause, Of, Place};
use imu_core::sample::Channel;
use imu_model::effects::EffectKind;
use serde_json::Value;
use std::collections::BTreeSet;
use std::f64::consts::TAU;

/// The share of right causes among those that make a large part of the gap and beside which nothing remains.
const RIGHT_LARGE: f64 = 0.98;
/// The share of right causes that make a smaller part.
const RIGHT_SMALLER: f64 = 0.93;
/// The share of right causes that make a small part.
const RIGHT_SMALL: f64 = 0.85;
/// The share of right narrow bands.
const RIGHT_NARROW: f64 = 0.75;
/// The share of right causes on a channel on which something remains.
const RIGHT_BESIDE: f64 = 0.5;
/// The limits of a large and a small part of the gap.
const LARGE: f64 = 0.1;
const SMALL: f64 = 0.01;
/// Independent values of a band, below which it is narrow.
const NARROW: f64 = 120.0;

/// The evidence by which a cause is judged besides its lead.
#[derive(Debug)]
pub(super) struct Surroundings<'a> {
    pub(super) places: &'a [Place],
    /// The channels on which something remains.
    pub(super) remains: &'a BTreeSet<Channel>,
    pub(super) length_s: f64,
}

impl Surroundings<'_> {
    /// Returns how often a cause like this one, the `index`th, was right.
    pub(super) fn right(&self, index: usize, cause: &Cause) -> f64 {
        let own = self.places.iter().filter(|place| place.of == Of::Cause(index));
        let share: f64 = own.map(|place| place.share).sum();
        let by_share = match share {
            share if share >= LARGE => RIGHT_LARGE,
            share if share >= SMALL => RIGHT_SMALLER,
            _ => RIGHT_SMALL,
        };
        let narrow = if cause.effect == EffectKind::Resonance && self.is_narrow(cause) { RIGHT_NARROW } else { 1.0 };
        let remainder = if cause.is_on(self.remains) { RIGHT_BESIDE } else { 1.0 };
        by_share.min(narrow).min(remainder)
    }

    fn is_narrow(&self, cause: &Cause) -> bool {
        let entries =
            cause.parameters.values().flat_map(|of| of.as_array().map_or(std::slice::from_ref(of), Vec::as_slice));
        let width_hz = |of: &Value| of["bandwidth_hz"].as_f64();
        entries.filter_map(width_hz).any(|width_hz| TAU * width_hz * self.length_s < NARROW)
    }
}

/// Returns the confidence that is stated for a lead of this many nats over the next best reading.
pub(super) fn confidence(margin: f64) -> f64 {
    1.0 / (1.0 + (-margin.clamp(-30.0, 30.0)).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::collections::BTreeMap;

    #[test]
    fn what_surrounds_a_cause_lowers_it() {
        let cause = |effect: EffectKind, bandwidth_hz: f64| Cause {
            parameters: BTreeMap::from([("gyro_x".to_owned(), json!([{"bandwidth_hz": bandwidth_hz}]))]),
            ..Cause::in_tests(effect)
        };
        let place = |share: f64| Place::in_tests(Of::Cause(0), share);
        let right = |share: f64, remains: bool, cause: &Cause| {
            let remains: BTreeSet<Channel> = remains.then_some(Channel::GyroX).into_iter().collect();
            Surroundings { places: &[place(share)], remains: &remains, length_s: 1000.0 }.right(0, cause)
        };
        let wide = cause(EffectKind::Resonance, 0.5);
        assert_eq!([0.5, 0.05, 0.001].map(|share| right(share, false, &wide)), [0.98, 0.93, 0.85]);
        assert_eq!(right(0.5, true, &wide), 0.5);
        assert_eq!(right(0.5, false, &cause(EffectKind::Resonance, 0.005)), 0.75);
        assert_eq!(right(0.5, false, &cause(EffectKind::GaussMarkov, 0.005)), 0.98);
    }
}
