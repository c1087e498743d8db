//! Recipes: the contents of a case.

use super::class::{Class, Sense};
use super::kind::Kind;

/// A case's class, and its effects with the sense of each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipe {
    /// The case's class.
    pub class: Class,
    /// The case's effects.
    pub effects: Vec<(Kind, Sense)>,
}

impl Recipe {
    /// Creates a recipe whose model lacks all of these kinds.
    pub fn lacking(kinds: &[Kind]) -> Self {
        let class = match kinds {
            [] => Class::None,
            [one] if one.is_kept() => Class::Kept,
            [one] if one.effect().is_none() => Class::Outside,
            [_] => Class::Single,
            [_, _] => Class::Pair,
            _ => Class::Several,
        };
        Self { class, effects: kinds.iter().map(|kind| (*kind, Sense::Missing)).collect() }
    }

    /// Creates a recipe whose model has this effect in this sense.
    pub fn of_model(kind: Kind, sense: Sense) -> Self {
        let class = match sense {
            Sense::Missing => return Self::lacking(&[kind]),
            Sense::Superfluous => Class::Superfluous,
            Sense::Size | Sense::Elsewhere => Class::Size,
            Sense::Known => Class::Known,
        };
        Self { class, effects: vec![(kind, sense)] }
    }

    /// Returns the kinds of the effects.
    pub fn kinds(&self) -> impl Iterator<Item = Kind> {
        self.effects.iter().map(|(kind, _)| *kind)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recipe_is_of_one_class() {
        assert_eq!(Recipe::lacking(&[]).class, Class::None);
        assert_eq!(Recipe::lacking(&[Kind::Tone]).class, Class::Single);
        assert_eq!(Recipe::lacking(&[Kind::Echo]).class, Class::Outside);
        assert_eq!(Recipe::lacking(&[Kind::Notch]).class, Class::Kept);
        assert_eq!(Recipe::lacking(&[Kind::Tone, Kind::Spikes]).class, Class::Pair);
        assert_eq!(Recipe::lacking(&[Kind::Tone, Kind::Spikes, Kind::BiasStep]).class, Class::Several);
        assert_eq!(Recipe::of_model(Kind::Tone, Sense::Superfluous).class, Class::Superfluous);
        assert_eq!(Recipe::of_model(Kind::Tone, Sense::Elsewhere).class, Class::Size);
    }
}
