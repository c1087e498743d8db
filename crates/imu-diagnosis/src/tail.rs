//! Tail: the upper end of a value's distribution in records of noise alone, and the macro that lists what has one.

use serde::{Deserialize, Serialize};

/// The tail of a distribution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tail {
    /// The value at which the line meets a chance of 1, nats.
    pub offset: f64,
    /// Nats for a factor of e.
    pub scale: f64,
}

impl Tail {
    /// Fits the tail of values drawn by chance: the mean excess over the value that a share of 0.15 exceeds (an
    /// exponential tail; Davison and Smith 1990, J. R. Stat. Soc. B 52, with shape 0). `None` for fewer than 20 values,
    /// or if none is above 0.
    pub fn of(values: &[f64]) -> Option<Self> {
        const SHARE: f64 = 0.15;
        const LEAST: f64 = 1.0;
        let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
        if sorted.len() < 20 {
            return None;
        }
        sorted.sort_unstable_by(f64::total_cmp);
        let above = ((SHARE * sorted.len() as f64) as usize).max(3);
        let (rest, top) = sorted.split_at(sorted.len() - above);
        let threshold = rest.last().copied().unwrap_or_default().max(0.0);
        let scale = (top.iter().map(|value| (value - threshold).max(0.0)).sum::<f64>() / above as f64).max(LEAST);
        let share = above as f64 / sorted.len() as f64;
        Some(Self { offset: threshold + scale * share.ln(), scale })
    }

    /// Returns the value that is exceeded with a chance.
    pub fn beyond(&self, chance: f64) -> f64 {
        self.offset - self.scale * chance.ln()
    }

    /// Returns the chance of exceeding a value; more than 1 for usual values.
    pub fn chance(&self, value: f64) -> f64 {
        (-(value - self.offset) / self.scale).exp()
    }
}

/// Defines what a diagnosis examines: each with a property, and with the tail of its value in records of noise alone, as
/// offsets at the lengths of the shipped table, and a scale.
macro_rules! with_tails {
    ($(#[$about:meta])* $all:ident; $(#[$what:meta])* $property:ident -> $of:ty;
     $($(#[$meta:meta])* $one:ident: $value:expr, $offsets:expr, $scale:literal;)+) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum $all {
            $($(#[$meta])* $one,)+
        }

        impl $all {
            /// Lists all of them.
            pub const ALL: [Self; [$(stringify!($one)),+].len()] = [$(Self::$one),+];

            $(#[$what])*
            pub fn $property(self) -> $of {
                match self {
                    $(Self::$one => $value,)+
                }
            }

            /// Returns offsets and scale of the tail of the value in noise alone.
            pub(crate) fn tail(self) -> ([f64; 3], f64) {
                match self {
                    $(Self::$one => ($offsets, $scale),)+
                }
            }
        }
    };
}
pub(crate) use with_tails;
