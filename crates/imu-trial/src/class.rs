//! Classes: the property that a case tests, and the sense and the role in which an effect belongs to it.

use serde::{Deserialize, Serialize};

/// The property that a case tests.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Class {
    /// Only wrong parameters.
    None,
    /// One effect that the sensor has and the model states correctly.
    Known,
    /// One effect of the library that the model lacks.
    Single,
    /// Two such effects.
    Pair,
    /// Three or four such effects.
    Several,
    /// One effect that the model has and the sensor lacks.
    Superfluous,
    /// One effect that both have, at another size or at another place.
    Size,
    /// One effect that the library does not have, for which the diagnosis may be tuned.
    Outside,
    /// One effect that the library does not have, reserved for the published figure.
    Kept,
}

impl Class {
    /// All classes.
    pub const ALL: [Self; 9] = [
        Self::None,
        Self::Known,
        Self::Single,
        Self::Pair,
        Self::Several,
        Self::Superfluous,
        Self::Size,
        Self::Outside,
        Self::Kept,
    ];

    /// Returns the name of the class.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Known => "known",
            Self::Single => "single",
            Self::Pair => "pair",
            Self::Several => "several",
            Self::Superfluous => "superfluous",
            Self::Size => "size",
            Self::Outside => "outside",
            Self::Kept => "kept",
        }
    }

    /// Returns whether the class's cases have a gap that effects of the library explain.
    pub fn in_library(self) -> bool {
        matches!(self, Self::Single | Self::Pair | Self::Several | Self::Superfluous | Self::Size)
    }

    /// Returns whether the library lacks the effects of the class's cases.
    pub fn is_outside(self) -> bool {
        matches!(self, Self::Outside | Self::Kept)
    }

    /// Returns whether the class's cases have no effect to name.
    pub fn is_silent(self) -> bool {
        matches!(self, Self::None | Self::Known)
    }
}

/// How sensor and model differ in an effect.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sense {
    /// The sensor has it, the model lacks it.
    #[default]
    Missing,
    /// The model has it, the sensor lacks it.
    Superfluous,
    /// Both have it, at different sizes.
    Size,
    /// Both have it, at another frequency or time. Only in keys.
    Elsewhere,
    /// Both have it with the same numbers. Only in keys.
    Known,
}

impl Sense {
    /// Returns the sense that a diagnosis states, from the documented words; `None` for any other word.
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "missing" => Some(Self::Missing),
            "superfluous" => Some(Self::Superfluous),
            "size" => Some(Self::Size),
            _ => None,
        }
    }

    /// Returns whether a cause of sense `stated` is a true statement about an effect of this sense. For an effect that
    /// both have at two places, each of three statements is true: the model lacks the one, the sensor lacks the other,
    /// and the two differ.
    pub fn accepts(self, stated: Self) -> bool {
        match self {
            Self::Elsewhere => true,
            Self::Known => false,
            own => own == stated,
        }
    }

    /// Returns whether the sensor has the effect.
    pub fn is_in_sensor(self) -> bool {
        self != Self::Superfluous
    }

    /// Returns whether the model has the effect.
    pub fn is_in_model(self) -> bool {
        self != Self::Missing
    }
}

/// The role for which an effect is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Role {
    /// How sensor and model differ in the effect.
    pub sense: Sense,
    /// The number of effects in the case.
    pub of: usize,
}

impl Role {
    /// The only effect, which the model lacks.
    pub const ALONE: Self = Self { sense: Sense::Missing, of: 1 };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sense_accepts_its_own_word_alone() {
        let stated = ["missing", "superfluous", "size"].map(|name| Sense::from_name(name).unwrap());
        let accepted = |truth: Sense| stated.map(|one| truth.accepts(one));
        assert_eq!(accepted(Sense::Missing), [true, false, false]);
        assert_eq!(accepted(Sense::Superfluous), [false, true, false]);
        assert_eq!(accepted(Sense::Size), [false, false, true]);
        assert_eq!(accepted(Sense::Elsewhere), [true; 3]);
        assert_eq!(accepted(Sense::Known), [false; 3]);
        assert_eq!(Sense::from_name("more"), None);
    }
}
